//! The image of a tag without samples: what an area gives a pixel is an integral along the area's border.
//!
//! With the pixel's square and the blur `k(x) k(y)`, and `K` the integral of `k`, Green's theorem says of an area `A` about a pixel `p`
//!
//! ```text
//! integral over A of k(x - p_x) k(y - p_y) = integral along the border of A of K(x - p_x) k(y - p_y) dy
//! ```
//! Along a straight edge that is smooth, and five places of Gauss and Legendre in each half deviation of the blur give it to 1e-6.

use super::{Canvas, Look, Map, cdf};
use vservo::target::{TagCell, TagFamily};

/// Gauss and Legendre's places and weights in -1 to 1.
const PLACES: [(f64, f64); 5] = [
    (0.0, 128.0 / 225.0),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
    (0.906_179_845_938_664, 0.236_926_885_056_189_1),
    (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
];

impl Canvas {
    /// Draws a tag that rests with its margin, exactly; true corners, px, in the order of the library.
    pub(crate) fn draw_exact(
        &mut self,
        family: TagFamily,
        id: u32,
        map: &Map,
        look: &Look,
    ) -> [(f64, f64); 4] {
        let n = family.cells_per_side() as i32;
        let dark = |column: i32, row: i32| {
            let inside = (0..n).contains(&column) && (0..n).contains(&row);
            inside && family.cell(id, column, row) != Some(TagCell::White)
        };
        let mut plate = Coverage::of(self, look.blur_px);
        let (low, high) = (-look.margin_cells, f64::from(n) + look.margin_cells);
        let ends = [(low, low), (high, low), (high, high), (low, high)];
        for (i, from) in ends.iter().enumerate() {
            plate.edge(map.at(from.0, from.1), map.at(ends[(i + 1) % 4].0, ends[(i + 1) % 4].1));
        }
        let mut ink = Coverage::of(self, look.blur_px);
        for a in 0..=n {
            for b in 0..n {
                let at = |x: i32, y: i32| map.at(f64::from(x), f64::from(y));
                // columns downward, rows to the left: with the dark cell on the left, as along the plate's border
                match (dark(a - 1, b), dark(a, b)) {
                    (true, false) => ink.edge(at(a, b), at(a, b + 1)),
                    (false, true) => ink.edge(at(a, b + 1), at(a, b)),
                    _ => {}
                }
                match (dark(b, a - 1), dark(b, a)) {
                    (true, false) => ink.edge(at(b + 1, a), at(b, a)),
                    (false, true) => ink.edge(at(b, a), at(b + 1, a)),
                    _ => {}
                }
            }
        }
        for ((level, plate), ink) in self.levels.iter_mut().zip(&plate.share).zip(&ink.share) {
            *level += plate * (look.light - *level) + ink * (look.dark - look.light);
        }
        [0, 1, 2, 3].map(|corner| {
            let (x, y) = family.corner(corner);
            map.at(f64::from(x), f64::from(y))
        })
    }
}

/// What areas have of each pixel.
struct Coverage {
    width: usize,
    share: Vec<f64>,
    blur: f64,
}

impl Coverage {
    fn of(canvas: &Canvas, blur: f64) -> Self {
        Self { width: canvas.width, share: vec![0.0; canvas.levels.len()], blur }
    }

    /// `k`: a pixel's square blurred by a normal distribution.
    fn density(&self, x: f64) -> f64 {
        cdf((x + 0.5) / self.blur) - cdf((x - 0.5) / self.blur)
    }

    /// `K`.
    fn below(&self, x: f64) -> f64 {
        let ramp = |x: f64| {
            let z = x / self.blur;
            x * cdf(z) + self.blur * (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()
        };
        ramp(x + 0.5) - ramp(x - 0.5)
    }

    /// Adds an edge of an area that goes clockwise as the image shows it, `y` downward.
    fn edge(&mut self, from: (f64, f64), to: (f64, f64)) {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let reach = 0.5 + 5.5 * self.blur;
        let pieces = (dx.hypot(dy) / (0.5 * self.blur.max(0.1))).ceil().max(1.0);
        let height = self.share.len() / self.width;
        for piece in 0..pieces as usize {
            for (place, weight) in PLACES {
                let t = (piece as f64 + 0.5 + 0.5 * place) / pieces;
                let (x, y) = (from.0 + t * dx, from.1 + t * dy);
                let by = 0.5 * weight / pieces * dy;
                let rows =
                    (y - reach).ceil().max(0.0) as usize..((y + reach).max(0.0) as usize + 1).min(height);
                let first = (x - reach).ceil().clamp(0.0, self.width as f64) as usize;
                let behind = ((x + reach).max(0.0) as usize + 1).min(self.width);
                let shares: Vec<f64> = (first..behind).map(|u| self.below(x - u as f64)).collect();
                for row in rows {
                    let by = by * self.density(y - row as f64);
                    let start = row * self.width;
                    // what lies far to the left of the edge sees all of it, what lies far to the right none
                    for share in &mut self.share[start..start + first] {
                        *share += by;
                    }
                    for (share, below) in self.share[start + first..start + behind].iter_mut().zip(&shares) {
                        *share += by * below;
                    }
                }
            }
        }
    }
}
