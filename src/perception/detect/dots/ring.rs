//! The ring of a dot: samples of the plate on an ellipse around it.

use crate::imaging::ImageView;
use nalgebra::Vector2;

/// Points that are sampled. Chosen by hand: one every 15 degrees, so that the middle half of them are twelve; fewer leave noise in the plate's
/// level, more take time on each dot of each frame.
pub(super) const RING: usize = 24;

/// Cosine and sine of every 15 degrees.
static DIRECTIONS: [(f64, f64); RING] = {
    // derived: cosines of 15, 30, 45, 60 and 75 degrees
    const A: f64 = 0.965_925_826_289_068_3;
    const B: f64 = 0.866_025_403_784_438_6;
    const C: f64 = std::f64::consts::FRAC_1_SQRT_2;
    const D: f64 = 0.5;
    const E: f64 = 0.258_819_045_102_520_74;
    [
        (1.0, 0.0),
        (A, E),
        (B, D),
        (C, C),
        (D, B),
        (E, A),
        (0.0, 1.0),
        (-E, A),
        (-D, B),
        (-C, C),
        (-B, D),
        (-A, E),
        (-1.0, 0.0),
        (-A, -E),
        (-B, -D),
        (-C, -C),
        (-D, -B),
        (-E, -A),
        (0.0, -1.0),
        (E, -A),
        (D, -B),
        (C, -C),
        (B, -D),
        (A, -E),
    ]
};

/// The directions of a ring's points before the ellipse's shape is put on them.
pub(super) fn directions() -> impl Iterator<Item = Vector2<f64>> {
    DIRECTIONS.iter().map(|&(cos, sin)| Vector2::new(cos, sin))
}

/// Pixels that make a point where there is room: it and its eight neighbours, since [`cluster`] sums a square of three.
const CLUSTER: usize = 9;

/// Pixels around a dot, in turn: each quantity on its own, as loops over them want it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ring {
    /// Columns and rows.
    pub(super) x: [f64; RING],
    pub(super) y: [f64; RING],
    /// Levels; what lies outside of the image has NaN.
    pub(super) level: [f64; RING],
    /// Variance of the pixels within each point, levels^2; 0 where points are single pixels.
    pub(super) variance: [f64; RING],
    /// Sums over the pixels of the first points, those in the image.
    sums: [u16; RING],
    inside: usize,
    /// Pixels of a point: [`CLUSTER`], or 1 about small dots.
    pub(super) pixels: usize,
}

impl Ring {
    /// The pixels nearest to points of the ellipse `S = [xx, xy, yy]` about a centre, or with their neighbours.
    pub(super) fn of(
        image: &ImageView<'_>,
        (cx, cy): (f64, f64),
        [xx, xy, yy]: &[f64; 3],
        clustered: bool,
    ) -> Self {
        // points on the ellipse: L (cos, sin) with S = L L^T
        let l11 = xx.max(0.0).sqrt();
        let l21 = if l11 > 0.0 { xy / l11 } else { 0.0 };
        let l22 = (yy - l21 * l21).max(0.0).sqrt();
        let pixels = if clustered { CLUSTER } else { 1 };
        let (mut x, mut y) = ([0.0; RING], [0.0; RING]);
        for (&(cos, sin), (x, y)) in DIRECTIONS.iter().zip(x.iter_mut().zip(&mut y)) {
            (*x, *y) = (cx + l11 * cos + 0.5, cy + l21 * cos + l22 * sin + 0.5);
        }
        let mut seen = [None; RING];
        let (mut sums, mut inside) = ([0; RING], 0);
        for (seen, (x, y)) in seen.iter_mut().zip(x.iter_mut().zip(&mut y)) {
            // rounded by a cast: `round` is a call on the baseline processor. NaN is nowhere
            let (column, row) = (*x as i32, *y as i32);
            if *x >= 0.0 && *y >= 0.0 {
                let at = (column as usize, row as usize);
                *seen = if clustered {
                    cluster(image, at.0, at.1)
                } else {
                    image.row(at.1).get(at.0).map(|&p| (u16::from(p), 0))
                };
            }
            if let (Some((sum, _)), Some(slot)) = (*seen, sums.get_mut(inside)) {
                *slot = sum;
                inside += 1;
            }
            (*x, *y) = (f64::from(column), f64::from(row));
        }
        let (scale, spread) = (1.0 / pixels as f64, 1.0 / (pixels * (pixels - 1).max(1)) as f64);
        let level = seen.map(|seen| seen.map_or(f64::NAN, |(sum, _)| f64::from(sum) * scale));
        let variance = seen.map(|seen| seen.map_or(0.0, |(_, rough)| f64::from(rough as i32) * spread));
        Self { x, y, level, variance, sums, inside, pixels }
    }

    /// How many points are in the image.
    pub(super) fn count(&self) -> usize {
        self.inside
    }

    /// Levels of the points in the image.
    pub(super) fn levels(&self) -> impl Iterator<Item = f64> {
        self.level.iter().copied().filter(|level| !level.is_nan())
    }

    /// Least and greatest level of the points in the image.
    pub(super) fn range(&self) -> (f64, f64) {
        // NaN is neither
        let least = self.level.iter().fold(f64::INFINITY, |least, level| level.min(least));
        (least, self.level.iter().fold(f64::NEG_INFINITY, |greatest, level| level.max(greatest)))
    }

    /// Mean of the middle half: neighbours and the plate's edge do not matter.
    pub(super) fn level(&self) -> Option<f64> {
        let (mut sorted, used) = (self.sums, self.inside);
        let sorted = sorted.get_mut(..used)?;
        sorted.sort_unstable();
        let middle = sorted.get(used / 4..used - used / 4)?;
        let sum: u32 = middle.iter().map(|&p| u32::from(p)).sum();
        (!middle.is_empty()).then(|| f64::from(sum) / (middle.len() * self.pixels) as f64)
    }
}

/// Sum over a pixel and its eight neighbours, and nine times the sum of their squared deviations; `None` at the border.
#[inline]
fn cluster(image: &ImageView<'_>, x: usize, y: usize) -> Option<(u16, u32)> {
    let (mut sum, mut squares) = (0u32, 0u32);
    for row in image.square(x.checked_sub(1)?, y.checked_sub(1)?)? {
        let [a, b, c] = row.map(u32::from);
        sum += a + b + c;
        squares += a * a + b * b + c * c;
    }
    Some((sum as u16, CLUSTER as u32 * squares - sum * sum))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_on_the_ellipse_and_in_the_image() {
        let pixels: Vec<u8> = (0..60 * 50).map(|i| (i % 60 + i / 60) as u8).collect();
        let image = ImageView::new(&pixels, 60, 50).unwrap();
        for clustered in [false, true] {
            let ring = Ring::of(&image, (20.3, 15.8), &[144.0, 30.0, 64.0], clustered);
            assert_eq!(ring.count(), RING);
            for (i, u) in directions().enumerate() {
                let (dx, dy) = (ring.x[i] - 20.3, ring.y[i] - 15.8);
                // L L^T = S
                assert!((dx - 12.0 * u.x).abs() <= 0.5 + 1e-9);
                assert!((dy - 2.5 * u.x - (64.0f64 - 6.25).sqrt() * u.y).abs() <= 0.5 + 1e-9);
                assert!((ring.level[i] - ring.x[i] - ring.y[i]).abs() < 1e-9);
                // x + y in a square of nine: deviations 0, 1, 2
                let variance = if clustered { 12.0 / 8.0 } else { 0.0 };
                assert!((ring.variance[i] - variance).abs() < 1e-9);
            }
            let cut = Ring::of(&image, (0.0, 0.0), &[100.0, 0.0, 100.0], clustered);
            assert!((4..=8).contains(&cut.count()) && cut.levels().count() == cut.count(), "{cut:?}");
            assert!(cut.range().0 >= 0.0 && cut.range().1 < 30.0);
            assert_eq!(Ring::of(&image, (-90.0, 900.0), &[9.0, 0.0, 9.0], clustered).level(), None);
            assert_eq!(Ring::of(&image, (f64::NAN, 9.0), &[9.0, 0.0, 9.0], clustered).level(), None);
        }
    }
}
