//! What is seen of the plate on an ellipse around a dot.

use super::light::Sample;
use crate::imaging::ImageView;
use nalgebra::Vector2;

/// Points that are sampled.
pub(super) const RING: usize = 24;

/// Cosine and sine of every 15 degrees.
static DIRECTIONS: [(f64, f64); RING] = {
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

/// Pixels that make a point where there is room.
const CLUSTER: usize = 9;

/// Pixels around a dot, in turn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ring {
    /// Column and row; what lies outside of the image has none.
    places: [(u32, u32); RING],
    /// Sums over the pixels of each point.
    levels: [u16; RING],
    /// Sums of squared deviations in each point, times the number of its pixels.
    rough: [u32; RING],
    inside: u32,
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
        let mut ring =
            Self { places: [(0, 0); RING], levels: [0; RING], rough: [0; RING], inside: 0, pixels };
        let width = image.width();
        for (i, &(cos, sin)) in DIRECTIONS.iter().enumerate() {
            // rounded by a cast: `round` is a call on the baseline processor
            let (x, y) = (cx + l11 * cos + 0.5, cy + l21 * cos + l22 * sin + 0.5);
            let (column, row) = (x as u32 as usize, y as u32 as usize);
            if !(x >= 0.0 && y >= 0.0) || column >= width {
                continue;
            }
            let seen = if clustered {
                cluster(image, column, row)
            } else {
                image.row(row).get(column).map(|&p| (u16::from(p), 0))
            };
            if let Some((level, rough)) = seen {
                (ring.places[i], ring.levels[i], ring.rough[i]) = ((column as u32, row as u32), level, rough);
                ring.inside |= 1 << i;
            }
        }
        ring
    }

    /// Every point, `None` outside of the image.
    pub(super) fn all(&self) -> impl Iterator<Item = Option<Sample>> {
        let scale = 1.0 / self.pixels as f64;
        let points = (0..).zip(self.places.iter().zip(&self.levels));
        points.map(move |(i, (&(x, y), &level))| {
            let sample = Sample { x: f64::from(x), y: f64::from(y), level: f64::from(level) * scale };
            (self.inside >> i & 1 == 1).then_some(sample)
        })
    }

    /// Variance of the pixels within each point that is in the image, levels^2; nothing where points are single pixels.
    pub(super) fn variances(&self) -> impl Iterator<Item = f64> {
        let scale = 1.0 / (self.pixels * (self.pixels - 1).max(1)) as f64;
        let points = (0..).zip(&self.rough).filter(|(i, _)| self.pixels > 1 && self.inside >> i & 1 == 1);
        points.map(move |(_, &rough)| f64::from(rough) * scale)
    }

    /// The points in the image.
    pub(super) fn samples(&self) -> impl Iterator<Item = Sample> {
        self.all().flatten()
    }

    /// Least and greatest level of the points in the image.
    pub(super) fn range(&self) -> (f64, f64) {
        let (mut least, mut greatest) = (u16::MAX, 0);
        for (i, &level) in self.levels.iter().enumerate() {
            if self.inside >> i & 1 == 1 {
                (least, greatest) = (least.min(level), greatest.max(level));
            }
        }
        let scale = 1.0 / self.pixels as f64;
        (f64::from(least) * scale, f64::from(greatest) * scale)
    }

    /// Mean of the middle half: neighbours and the plate's edge do not matter.
    pub(super) fn level(&self) -> Option<f64> {
        let (mut sorted, mut used) = ([0u16; RING], 0);
        for (i, &level) in self.levels.iter().enumerate() {
            if self.inside >> i & 1 == 1
                && let Some(slot) = sorted.get_mut(used)
            {
                *slot = level;
                used += 1;
            }
        }
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
    let (left, top) = (x.checked_sub(1)?, y.checked_sub(1)?);
    let (mut sum, mut squares) = (0u32, 0u32);
    for row in top..top + 3 {
        let part: &[u8; 3] = image.row(row).get(left..).and_then(|p| p.first_chunk())?;
        for p in part.map(u32::from) {
            sum += p;
            squares += p * p;
        }
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
            assert_eq!(ring.samples().count(), RING);
            for (sample, u) in ring.samples().zip(directions()) {
                let (dx, dy) = (sample.x - 20.3, sample.y - 15.8);
                // L L^T = S
                assert!((dx - 12.0 * u.x).abs() <= 0.5 + 1e-9);
                assert!((dy - 2.5 * u.x - (64.0f64 - 6.25).sqrt() * u.y).abs() <= 0.5 + 1e-9);
                assert!((sample.level - sample.x - sample.y).abs() < 1e-9);
            }
            // x + y in a square of nine: deviations 0, 1, 2
            assert!(ring.variances().all(|v| (v - 12.0 / 8.0).abs() < 1e-9));
            assert_eq!(ring.variances().count(), if clustered { RING } else { 0 });
            let cut = Ring::of(&image, (0.0, 0.0), &[100.0, 0.0, 100.0], clustered);
            assert!((4..=8).contains(&cut.samples().count()), "{}", cut.samples().count());
            assert_eq!(Ring::of(&image, (-90.0, 900.0), &[9.0, 0.0, 9.0], clustered).level(), None);
            assert_eq!(Ring::of(&image, (f64::NAN, 9.0), &[9.0, 0.0, 9.0], clustered).level(), None);
        }
    }
}
