//! A step edge measured along a row or a column of pixels.
//!
//! Levels `A`, `B` are the means of `PLATEAU` pixels before and behind the `2 h + 1` pixels in the middle; the edge is where a sharp
//! one would have to be to give the same sum there:
//!
//! ```text
//! position = c + ((A + B) (2 h + 1) / 2 - sum) / (B - A)
//! ```
//! For a straight edge in even light this has no bias, whatever the blur and the angle, and noise enters through known weights. Scans
//! of different rows share no pixel, so their errors are independent.

use super::ImageView;

/// Pixels on either side whose mean is the level there. Chosen by hand: more would average better and need more room beside the edge.
const PLATEAU: usize = 3;

/// Pixels of the widest scan, which follows from the largest reach, margins and plateaus.
const MAX_LEVELS: usize = 2 * (64 + 8 + PLATEAU + 8 + 3) + 1;

/// Along what is scanned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanAxis {
    /// Along a row: the position is a column.
    Row,
    /// Along a column: the position is a row.
    Column,
}

/// How edges are scanned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeScan {
    /// Half of the pixels over which the edge spreads, `h`: 1 for sharp images, 2 for a blur of up to 1 px (default), at most 8.
    pub half_px: usize,
    /// How far from the predicted place the edge is looked for, px, at most 64.
    pub search_px: usize,
    /// Least step, grey levels.
    pub min_step: f32,
}

impl Default for EdgeScan {
    fn default() -> Self {
        Self { half_px: 2, search_px: 3, min_step: 12.0 }
    }
}

/// One crossing of a scan line and an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Position along the scan line, px.
    pub position_px: f64,
    /// Standard deviation of the position for noise of 1 grey level, px.
    pub sd_px_per_level: f64,
    /// Level before the edge, in the order of columns or rows.
    pub before: f64,
    /// Level behind it.
    pub behind: f64,
    /// Squared deviations of both sides' pixels from their levels, grey levels^2; of as many degrees of freedom as there are
    /// pixels, less the two levels.
    pub scatter: f64,
    /// Variance of the blur along the scan line, px^2, the pixel's own included; of one crossing a rough number.
    pub blur_px2: f64,
}

impl EdgeScan {
    /// The edge nearest to the predicted place of those strong enough: along `axis` in line `line` (a row's or column's number), near
    /// `predicted_px`; `rising` where the light lies behind. `None` where there is no such edge, or the image ends too near.
    #[must_use]
    pub fn cross(
        &self,
        image: &ImageView<'_>,
        axis: ScanAxis,
        line: i64,
        predicted_px: f64,
        rising: bool,
    ) -> Option<Crossing> {
        let (half, search) = (self.half_px.min(8), self.search_px.min(64));
        let line = usize::try_from(line).ok()?;
        let (length, lines) = match axis {
            ScanAxis::Row => (image.width(), image.height()),
            ScanAxis::Column => (image.height(), image.width()),
        };
        // no place of any image, else the sums below could overflow
        if line >= lines || !(predicted_px > -1e6 && predicted_px < 1e9) {
            return None;
        }
        let reach = (half + PLATEAU) as i64;
        let middle = (predicted_px + 0.5).floor() as i64;
        // what can be looked at, side by side: a column's pixels lie far from each other
        let around = search as i64 + reach + half as i64 + 3;
        let (from, to) =
            ((middle - around).max(0) as usize, (middle + around + 1).clamp(0, length as i64) as usize);
        if from >= to {
            return None;
        }
        let mut levels = [0u8; MAX_LEVELS];
        let levels = levels.get_mut(..to - from)?;
        match axis {
            ScanAxis::Row => levels.copy_from_slice(image.row(line).get(from..to)?),
            ScanAxis::Column => {
                for (level, y) in levels.iter_mut().zip(from..to) {
                    *level = image.row(y).get(line).copied()?;
                }
            }
        }
        let at = |i: usize| levels.get(i.wrapping_sub(from)).map_or(0, |&l| i32::from(l));
        // the steepest place, over four pixels; nearer ones win by a level a pixel
        let low = (middle - search as i64).max(2);
        let high = (middle + search as i64).min(length as i64 - 3);
        let sign = if rising { 1 } else { -1 };
        let mut best = (0, middle);
        if low < high {
            let mut steepest = (0, 0.0f64);
            for i in low..=high {
                let i = i as usize;
                let step = sign * (at(i + 1) + at(i + 2) - at(i - 1) - at(i - 2));
                let cost = (i as f64 - predicted_px).abs();
                if f64::from(step) - cost > steepest.1 {
                    steepest = (i, f64::from(step) - cost);
                    best = (step, i as i64);
                }
            }
        } else {
            best.0 = i32::MAX;
        }
        if (best.0 as f32) < self.min_step {
            return None;
        }
        // the window is centred on the edge: one step more where it is nearer to a neighbour
        let mut centre = best.1;
        for _ in 0..3 {
            if centre - reach < from as i64 || centre + reach >= to as i64 {
                return None;
            }
            let crossing = measure(at, centre as usize, half)?;
            if f64::from(sign) * (crossing.behind - crossing.before) < f64::from(self.min_step) {
                return None;
            }
            let off = crossing.position_px - centre as f64;
            // Half a pixel, and some more so that it must not alternate between two.
            if off.abs() <= 0.6 {
                return Some(crossing);
            }
            if off.abs() > half as f64 + 1.0 {
                return None;
            }
            centre += off.round() as i64;
        }
        None
    }
}

/// The equation of the module's head around pixel `centre`; all pixels needed exist.
fn measure(at: impl Fn(usize) -> i32, centre: usize, half: usize) -> Option<Crossing> {
    let plateau = |from: usize| {
        let (mut sum, mut squares) = (0, 0);
        for i in from..from + PLATEAU {
            sum += at(i);
            squares += at(i) * at(i);
        }
        let mean = f64::from(sum) / PLATEAU as f64;
        (mean, f64::from(squares) - mean * f64::from(sum))
    };
    let start = centre.checked_sub(half + PLATEAU)?;
    let ((a, scatter_a), (b, scatter_b)) = (plateau(start), plateau(centre + half + 1));
    let count = (2 * half + 1) as f64;
    let (mut sum, mut first, mut previous, mut moment) = (0, 0.0, a, 0.0);
    for k in 0..2 * half + 2 {
        let level = if k <= 2 * half { at(centre - half + k) } else { 0 };
        if k <= 2 * half {
            sum += level;
        }
        // differences of neighbours, half-way between them
        let value = if k <= 2 * half { f64::from(level) } else { b };
        let x = k as f64 - half as f64 - 0.5;
        first += x * (value - previous);
        moment += x * x * (value - previous);
        previous = value;
    }
    let step = b - a;
    if step == 0.0 {
        return None;
    }
    let off = (f64::from(sum) - 0.5 * (a + b) * count) / -step;
    let (before, behind) = (0.5 * count + off, 0.5 * count - off);
    let weights = count + (before * before + behind * behind) / PLATEAU as f64;
    let mean = first / step;
    Some(Crossing {
        position_px: centre as f64 + off,
        sd_px_per_level: weights.sqrt() / step.abs(),
        before: a,
        behind: b,
        scatter: scatter_a.max(0.0) + scatter_b.max(0.0),
        // the difference of two pixels is one pixel wide itself
        blur_px2: moment / step - mean * mean - 1.0 / 12.0,
    })
}

#[cfg(test)]
mod tests {
    use super::super::test_image::any_image;
    use super::*;
    use crate::linalg::Random;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_image_and_place_is_taken(
            image in any_image(), line in -5i64..200, place in -50.0..300.0f64, half in 0usize..12, search in 0usize..99,
            row in any::<bool>(), rising in any::<bool>(),
        ) {
            let scan = EdgeScan { half_px: half, search_px: search, min_step: 5.0 };
            let axis = if row { ScanAxis::Row } else { ScanAxis::Column };
            if let Some(c) = scan.cross(&image.view(), axis, line, place, rising) {
                prop_assert!((c.behind > c.before) == rising && c.sd_px_per_level > 0.0);
                prop_assert!((c.position_px - place).abs() < search as f64 + 4.0);
            }
        }
    }

    #[test]
    fn a_straight_edge_has_no_bias_and_noise_is_as_told() {
        let mut random = Random::new(4);
        let (mut squares, mut bias, mut blur) = (0.0, 0.0, 0.0);
        let n = 2000;
        for k in 0..n {
            let place = 20.0 + random.uniform();
            let noise = if k % 2 == 0 { 2.0 } else { 0.0 };
            // a sharp edge, seen by pixels of 1 px
            let row: Vec<u8> = (0..40)
                .map(|i| {
                    let share = (f64::from(i) + 0.5 - place).clamp(0.0, 1.0);
                    (200.0 - 160.0 * share + noise * random.gaussian()).round() as u8
                })
                .collect();
            let bytes = row.repeat(5);
            let view = ImageView::new(&bytes, 40, 5).unwrap();
            let c = EdgeScan::default()
                .cross(&view, ScanAxis::Row, 2, place + random.between(-2.0, 2.0), false)
                .unwrap();
            if noise == 0.0 {
                // levels are rounded
                assert!((c.position_px - place).abs() < 0.005, "{} {place}", c.position_px);
            } else {
                let z = (c.position_px - place) / (c.sd_px_per_level * (4.0f64 + 1.0 / 12.0).sqrt());
                squares += z * z;
                bias += z;
                blur += c.blur_px2;
            }
        }
        let half = f64::from(n) / 2.0;
        assert!(
            (squares / half - 1.0).abs() < 0.15 && (bias / half).abs() < 0.1,
            "{} {}",
            squares / half,
            bias / half
        );
        // a sharp edge seen by pixels
        assert!((blur / half - 1.0 / 12.0).abs() < 0.05, "{}", blur / half);
    }
}
