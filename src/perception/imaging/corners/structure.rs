//! Corners of any kind by the structure tensor: where gradients of two directions meet.
//!
//! Over a window of `(2 h + 1)^2` pixels about each pixel, with the gradient `g` by Sobel's masks:
//!
//! ```text
//! N = sum g g^T,   t = sum g g^T p,   strength = det N / trace N  (Förstner's; about the smaller eigenvalue)
//! corner c = N^-1 t                   the point nearest to all edges, each across its own direction
//! covariance = s^2 N^-1,              s^2 = sum (g (p - c))^2 / (pixels - 2)
//! ```

use crate::imaging::ImageView;

/// Half side of the window that the tensor sums over, px.
const HALF: usize = 2;
/// A corner is the strongest within this many pixels in x and y. Chosen by hand: half the window and one more, so that two corners do not share one.
const ALONE_PX: usize = 3;
/// Pixels at the rim without a whole window and a neighbourhood.
const RIM: usize = HALF + 2;
/// Half side of the window for the position of a corner, px. Chosen by hand: a larger one averages more noise and needs more room.
const PLACE_HALF: usize = 3;

/// A corner by the structure tensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StructureCorner {
    /// Position, px.
    pub x: f64,
    /// Position, px.
    pub y: f64,
    /// Covariance `[xx, xy, yy]` of the position, px^2.
    pub covariance_px2: [f64; 3],
    /// Determinant over trace of the tensor, squared grey levels per px^2.
    pub strength: f32,
}

/// Finds corners by the structure tensor. Owns its buffers.
#[derive(Debug, Clone)]
pub struct StructureDetector {
    /// Sums along rows of `g_x^2`, `g_x g_y`, `g_y^2`, a ring of `2 h + 1` rows.
    ring: Vec<[i32; 3]>,
    products: Vec<[i32; 3]>,
    strength: Vec<f32>,
    width: usize,
    corners: Vec<StructureCorner>,
    limit: usize,
}

impl StructureDetector {
    /// For images of up to `width x height` pixels and at most `limit` corners; allocated at once, larger images make it grow.
    #[must_use]
    pub fn new(width: usize, height: usize, limit: usize) -> Self {
        Self {
            ring: Vec::with_capacity(width * (2 * HALF + 1)),
            products: Vec::with_capacity(width),
            strength: Vec::with_capacity(width.saturating_mul(height)),
            width: 0,
            corners: Vec::with_capacity(limit),
            limit,
        }
    }

    /// The corners found last, the strongest first.
    #[must_use]
    pub fn corners(&self) -> &[StructureCorner] {
        &self.corners
    }

    /// Finds corners of at least `least` strength (squared grey levels per px^2, at most one corner within 3 px); of too many the
    /// strongest.
    pub fn find(&mut self, image: &ImageView<'_>, least: f32) -> &[StructureCorner] {
        self.corners.clear();
        self.width = image.width();
        if self.limit == 0 || image.width() < 2 * RIM + 1 || image.height() < 2 * RIM + 1 {
            return &self.corners;
        }
        self.measure(image);
        let least = least.max(f32::MIN_POSITIVE);
        for y in RIM..image.height() - RIM {
            for x in RIM..image.width() - RIM {
                let value = self.at(x, y);
                if value >= least && self.is_peak(x, y, value) {
                    self.keep(image, x, y, value);
                }
            }
        }
        &self.corners
    }

    fn at(&self, x: usize, y: usize) -> f32 {
        self.strength.get(y * self.width + x).copied().unwrap_or(0.0)
    }

    /// Strength of all pixels.
    fn measure(&mut self, image: &ImageView<'_>) {
        let (width, height) = (image.width(), image.height());
        let rows = 2 * HALF + 1;
        self.strength.clear();
        self.strength.resize(width * height, 0.0);
        self.ring.clear();
        self.ring.resize(width * rows, [0; 3]);
        // Sobel's masks are 8 times the gradient
        let scale = 1.0 / (64.0 * (rows * rows) as f32);
        for y in 1..height - 1 {
            self.products.clear();
            self.products.resize(width, [0; 3]);
            let (above, here, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
            let triples = above.windows(3).zip(here.windows(3)).zip(below.windows(3));
            for (out, ((a, b), c)) in self.products.iter_mut().skip(1).zip(triples) {
                if let ([a0, a1, a2], [b0, _, b2], [c0, c1, c2]) = (a, b, c) {
                    let i = |v: &u8| i32::from(*v);
                    let gx = i(a2) + 2 * i(b2) + i(c2) - i(a0) - 2 * i(b0) - i(c0);
                    let gy = i(c0) + 2 * i(c1) + i(c2) - i(a0) - 2 * i(a1) - i(a2);
                    *out = [gx * gx, gx * gy, gy * gy];
                }
            }
            let slot = y % rows;
            let sums = self.ring.get_mut(slot * width + HALF..(slot + 1) * width - HALF);
            for (sum, part) in sums.into_iter().flatten().zip(self.products.windows(rows)) {
                *sum = part.iter().fold([0; 3], |s, p| [s[0] + p[0], s[1] + p[1], s[2] + p[2]]);
            }
            if y < rows {
                continue;
            }
            let middle = (y - HALF) * width;
            let Some(out) = self.strength.get_mut(middle..middle + width) else { return };
            for (x, out) in out.iter_mut().enumerate() {
                let mut n = [0.0f32; 3];
                for row in 0..rows {
                    if let Some(sum) = self.ring.get(row * width + x) {
                        n.iter_mut().zip(sum).for_each(|(n, s)| *n += *s as f32);
                    }
                }
                let [xx, xy, yy] = n;
                let trace = xx + yy;
                *out = if trace > 0.0 { (xx * yy - xy * xy).max(0.0) / trace * scale } else { 0.0 };
            }
        }
    }

    /// Whether no pixel nearby is stronger; of equal ones the first in reading order counts.
    fn is_peak(&self, x: usize, y: usize, value: f32) -> bool {
        (y.saturating_sub(ALONE_PX)..=y + ALONE_PX).all(|v| {
            (x.saturating_sub(ALONE_PX)..=x + ALONE_PX).all(|u| {
                // beyond the right rim lies the next row: it does not count
                let other = if u < self.width { self.at(u, v) } else { 0.0 };
                other < value || (other == value && (v, u) >= (y, x))
            })
        })
    }

    /// Keeps a corner in its place by strength.
    fn keep(&mut self, image: &ImageView<'_>, x: usize, y: usize, strength: f32) {
        let at = self.corners.partition_point(|c| c.strength >= strength);
        if at >= self.limit {
            return;
        }
        if let Some(corner) = place(image, x, y, strength) {
            if self.corners.len() == self.limit {
                self.corners.pop();
            }
            self.corners.insert(at, corner);
        }
    }
}

/// The point nearest to all edges about a pixel; it may lie at most the window's half beside it.
fn place(image: &ImageView<'_>, x: usize, y: usize, strength: f32) -> Option<StructureCorner> {
    let (mut mx, mut my) = (x, y);
    for round in 0..4 {
        let (mut n, mut t, mut squares, mut count) = ([0.0f64; 3], [0.0f64; 2], 0.0, 0.0);
        for v in my.checked_sub(PLACE_HALF)?..=my + PLACE_HALF {
            for u in mx.checked_sub(PLACE_HALF)?..=mx + PLACE_HALF {
                let level =
                    |du: usize, dv: usize| image.row(v + dv - 1).get(u + du - 1).map(|&p| f64::from(p));
                if u == 0 || v == 0 {
                    return None;
                }
                // least noise for an exact gradient of quadratics: Sobel's masks
                let gx = level(2, 0)? + 2.0 * level(2, 1)? + level(2, 2)?
                    - level(0, 0)?
                    - 2.0 * level(0, 1)?
                    - level(0, 2)?;
                let gy = level(0, 2)? + 2.0 * level(1, 2)? + level(2, 2)?
                    - level(0, 0)?
                    - 2.0 * level(1, 0)?
                    - level(2, 0)?;
                let (dx, dy) = (u as f64 - mx as f64, v as f64 - my as f64);
                let across = gx * dx + gy * dy;
                n = [n[0] + gx * gx, n[1] + gx * gy, n[2] + gy * gy];
                t = [t[0] + gx * across, t[1] + gy * across];
                squares += across * across;
                count += 1.0;
            }
        }
        let [xx, xy, yy] = n;
        let det = xx * yy - xy * xy;
        // otherwise all edges run one way to a thousandth, and along them the place is unknown
        if !(det > 1e-6 * (xx + yy) * (xx + yy)) {
            return None;
        }
        let c = [(yy * t[0] - xy * t[1]) / det, (xx * t[1] - xy * t[0]) / det];
        let off = c[0].abs().max(c[1].abs());
        if off > PLACE_HALF as f64 {
            return None;
        }
        // half a pixel, and some more so that it must not alternate between two
        if off > 0.6 && round < 3 {
            // about the nearer pixel once more
            mx = mx.checked_add_signed(c[0].round() as isize)?;
            my = my.checked_add_signed(c[1].round() as isize)?;
            continue;
        }
        let variance = (squares - c[0] * t[0] - c[1] * t[1]).max(0.0) / (count - 2.0);
        return Some(StructureCorner {
            x: mx as f64 + c[0],
            y: my as f64 + c[1],
            covariance_px2: [yy * variance / det, -xy * variance / det, xx * variance / det],
            strength,
        });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A turned square, sampled 8 x 8 to the pixel.
    fn square(turn: f64, middle: (f64, f64), half: f64) -> Vec<u8> {
        let (s, c) = turn.sin_cos();
        (0..64 * 64)
            .map(|i| {
                let inside = |k: usize| {
                    let (dx, dy) = ((k % 8) as f64 / 8.0 - 0.4375, (k / 8) as f64 / 8.0 - 0.4375);
                    let (x, y) = ((i % 64) as f64 + dx - middle.0, (i / 64) as f64 + dy - middle.1);
                    (c * x + s * y).abs() < half && (c * y - s * x).abs() < half
                };
                let share = (0..64).filter(|k| inside(*k)).count() as f64 / 64.0;
                (40.0 + 160.0 * share).round() as u8
            })
            .collect()
    }

    #[test]
    fn corners_of_a_square() {
        let mut detector = StructureDetector::new(64, 64, 50);
        for turn in [0.0, 0.3, 0.785, 1.2] {
            let middle = (31.3, 32.6);
            let pixels = square(turn, middle, 14.0);
            let image = ImageView::new(&pixels, 64, 64).unwrap();
            let corners = detector.find(&image, 30.0);
            assert_eq!(corners.len(), 4, "{turn} {corners:?}");
            let (s, c) = turn.sin_cos();
            for (a, b) in [(-14.0, -14.0), (14.0, -14.0), (14.0, 14.0), (-14.0, 14.0)] {
                let truth = (middle.0 + c * a - s * b, middle.1 + s * a + c * b);
                let off = |k: &StructureCorner| (k.x - truth.0).hypot(k.y - truth.1);
                let nearest = corners.iter().map(off).fold(f64::INFINITY, f64::min);
                // the pixels round the tip off
                assert!(nearest < 0.25, "{turn} {nearest}");
            }
        }
    }

    #[test]
    fn nothing_without_two_directions_and_bounded() {
        let mut detector = StructureDetector::new(64, 64, 7);
        let edge: Vec<u8> = (0..64 * 64).map(|i| if i % 64 < 30 { 20 } else { 200 }).collect();
        assert!(detector.find(&ImageView::new(&edge, 64, 64).unwrap(), 1.0).is_empty());
        let mut state = 5u64;
        let noise: Vec<u8> = (0..64 * 64)
            .map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8
            })
            .collect();
        let few = detector.find(&ImageView::new(&noise, 64, 64).unwrap(), 1.0).to_vec();
        assert!(few.len() == 7 && few.windows(2).all(|w| w[0].strength >= w[1].strength));
        for (w, h) in [(1, 1), (64, 1), (9, 9), (8, 64), (13, 10)] {
            detector.find(&ImageView::new(&noise[..w * h], w, h).unwrap(), 0.0);
        }
        // the strength is the definition's
        let image = ImageView::new(&noise, 64, 64).unwrap();
        detector.find(&image, 1.0);
        let at = |x: usize, y: usize| f64::from(image.row(y)[x]);
        for (x, y) in [(20, 30), (4, 4), (59, 59)] {
            let mut n = [0.0; 3];
            for v in y - 2..=y + 2 {
                for u in x - 2..=x + 2 {
                    let gx = (at(u + 1, v - 1) - at(u - 1, v - 1)) / 8.0
                        + (at(u + 1, v) - at(u - 1, v)) / 4.0
                        + (at(u + 1, v + 1) - at(u - 1, v + 1)) / 8.0;
                    let gy = (at(u - 1, v + 1) - at(u - 1, v - 1)) / 8.0
                        + (at(u, v + 1) - at(u, v - 1)) / 4.0
                        + (at(u + 1, v + 1) - at(u + 1, v - 1)) / 8.0;
                    n = [n[0] + gx * gx / 25.0, n[1] + gx * gy / 25.0, n[2] + gy * gy / 25.0];
                }
            }
            let wanted = (n[0] * n[2] - n[1] * n[1]) / (n[0] + n[2]);
            assert!((f64::from(detector.at(x, y)) / wanted - 1.0).abs() < 1e-4);
        }
    }
}
