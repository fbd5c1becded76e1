//! One piece of an edge: its offset from the assumed position, by a fit to all grey levels about it.
//!
//! ```text
//! I(p) = inside (1 - Phi((d - delta) / s)) + outside Phi((d - delta) / s)      d: distance of pixel p from the assumed edge, outward
//! ```
//! Phi is the normal distribution: the image of a step behind a lens of Gaussian blur, with the pixel's own square in it. Offset
//! and both levels are fitted to each piece, in one step from an offset of 0; the correction of the blur s is summed over all pieces. Every
//! pixel belongs to one piece, so that their errors are independent.

use crate::imaging::ImageView;
use crate::linalg::{Ldlt, normal};
use nalgebra::Vector2;

/// Most pixels of a piece; of more the rest is left out. Chosen by hand, since it bounds the buffer: a piece of 20 px, under the strongest blur
/// 22 px wide, has 440.
pub(super) const MAX_PIXELS: usize = 4096;
/// Fewest pixels of a piece. Chosen by hand: three numbers are fitted to them, so that five remain for the noise; with four it would be one.
const FEWEST_PIXELS: usize = 8;

/// A piece of the edge at its assumed position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    /// Arc length of its middle along the outline, and the part of the outline it belongs to.
    pub(super) arc: f64,
    pub(super) part: usize,
    /// Its middle, px.
    pub(super) middle: Vector2<f64>,
    /// Unit vectors along it and outward.
    pub(super) along: Vector2<f64>,
    pub(super) outward: Vector2<f64>,
    /// Length of its chord, and sag: distance of its middle outside of the chord, px.
    pub(super) length_px: f64,
    pub(super) sag_px: f64,
    /// Width of the window inside and outside of the edge, px.
    pub(super) width_px: [f64; 2],
    /// Free distance to the next edge, inside and outside, px.
    pub(super) room_px: [f64; 2],
}

/// Result of the fit of one piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EdgeEstimate {
    /// Offset of the edge outward from the assumed position, px.
    pub(super) offset_px: f64,
    /// Variance of the offset for noise of variance 1 level^2, px^2.
    pub(super) unit_variance: f64,
    /// Levels inside and outside.
    pub(super) levels: [f64; 2],
    /// Variance of the pixels about the fit, levels^2.
    pub(super) noise: f64,
    /// Normal equation of the blur, where all else is fitted: curvature and slope.
    pub(super) blur: [f64; 2],
}

/// Bilinearly interpolated level; `None` outside the image.
pub(super) fn level(image: &ImageView<'_>, p: &Vector2<f64>) -> Option<f64> {
    if !(p.x >= 0.0 && p.y >= 0.0) {
        return None;
    }
    let (x, y) = (p.x.floor(), p.y.floor());
    let (a, b) = (p.x - x, p.y - y);
    let at = |y: usize, x: usize| image.row(y).get(x).map(|&level| f64::from(level));
    let (i, j) = (x as usize, y as usize);
    let top = at(j, i)? * (1.0 - a) + at(j, i + 1)? * a;
    let bottom = at(j + 1, i)? * (1.0 - a) + at(j + 1, i + 1)? * a;
    Some(top * (1.0 - b) + bottom * b)
}

impl Piece {
    /// The strongest step from inside to outside within `reach_px` of the assumed place, of at least `least` levels; `rise` is 1 where the
    /// outside is lighter, -1 where it is darker.
    pub(super) fn search(&self, image: &ImageView<'_>, reach_px: f64, rise: f64, least: f64) -> Option<f64> {
        // half pixels, since a Gauss-Newton step follows; 46 px and half a profile on either side are 195 of them
        const STEP: f64 = 0.5;
        const MOST: usize = 2 * 96 + 17;
        // chosen by hand: a fifth of the room is left, else the next edge would be in the profile
        let reach = [0, 1].map(|i| reach_px.min(0.8 * self.room_px[i]).clamp(0.0, 46.0));
        // half the profile from which the step is measured
        let half = self.room_px[0].min(self.room_px[1]).clamp(1.0, 2.5);
        let count = |px: f64| (px / STEP).round() as usize;
        let (inside, outside, window) = (count(reach[0] + half), count(reach[1] + half), count(half));
        let total = (inside + outside + 1).min(MOST);
        let mut profile = [f64::NAN; MOST];
        for (k, value) in profile.iter_mut().enumerate().take(total) {
            let d = (k as f64 - inside as f64) * STEP;
            let mut sum = 0.0;
            for side in [-0.3, 0.0, 0.3] {
                let p = self.middle + self.outward * d + self.along * (side * self.length_px);
                sum += level(image, &p)?;
            }
            *value = sum / 3.0;
        }
        let mean = |from: usize, to: usize| {
            let part = profile.get(from..to).unwrap_or(&[]);
            part.iter().sum::<f64>() / part.len().max(1) as f64
        };
        let mut best = (0.0, None);
        for k in window..total.saturating_sub(window) {
            let step = rise * (mean(k + 1, k + window + 1) - mean(k - window, k));
            let d = (k as f64 - inside as f64) * STEP;
            // prefer the nearer one of nearly equal steps
            let score = step * (1.0 - 0.3 * d.abs() / (reach_px + 1.0));
            if step >= least && score > best.0 {
                best = (score, Some(d));
            }
        }
        best.1
    }

    /// Fits offset and levels for an edge of blur `blur_px`. `None` where there are too few pixels, or part of it lies outside the image.
    pub(super) fn fit(
        &self,
        image: &ImageView<'_>,
        blur_px: f64,
        pixels: &mut Vec<[f64; 4]>,
    ) -> Option<EdgeEstimate> {
        self.gather(image, blur_px, pixels)?;
        // levels alone
        let (mut aa, mut ab, mut bb, mut a, mut b) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for [level, above, ..] in pixels.iter() {
            let below = 1.0 - above;
            aa += below * below;
            ab += below * above;
            bb += above * above;
            a += below * level;
            b += above * level;
        }
        let det = aa * bb - ab * ab;
        // otherwise all pixels lie on one side, and the other's level is unknown
        if !(det > 1e-6 * aa * bb) {
            return None;
        }
        let (inside, outside) = ((bb * a - ab * b) / det, (aa * b - ab * a) / det);
        let rise = outside - inside;
        if !(rise.abs() > 1.0) {
            return None;
        }
        // and what is left of them by the offset
        let (mut m, mut r, mut blur) = ([[0.0; 3]; 3], [0.0; 3], [[0.0; 3], [0.0; 3]]);
        let mut squares = 0.0;
        for [level, above, density, z] in pixels.iter() {
            let slope = rise * density / blur_px;
            let (row, by_blur) = ([-slope, 1.0 - above, *above], -slope * z);
            let rest = level - inside * (1.0 - above) - outside * above;
            squares += rest * rest;
            for i in 0..3 {
                r[i] += row[i] * rest;
                blur[0][i] += row[i] * by_blur;
                for j in 0..=i {
                    m[j][i] += row[i] * row[j];
                    m[i][j] = m[j][i];
                }
            }
            blur[1][0] += by_blur * by_blur;
            blur[1][1] += by_blur * rest;
        }
        let factors = Ldlt::new(&m, &[0.0; 3])?;
        let x = factors.solve(&r);
        let c = factors.solve(&blur[0]);
        let dot = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let free = pixels.len() as f64 - 3.0;
        let unit_variance = factors.solve(&[1.0, 0.0, 0.0])[0];
        Some(EdgeEstimate {
            offset_px: x[0],
            unit_variance,
            levels: [inside + x[1], outside + x[2]],
            noise: ((squares - dot(&x, &r)) / free).max(0.0),
            blur: [blur[1][0] - dot(&c, &blur[0]), blur[1][1] - dot(&c, &r)],
        })
    }

    /// Level, distribution, density and normalized distance of each pixel.
    fn gather(&self, image: &ImageView<'_>, blur_px: f64, pixels: &mut Vec<[f64; 4]>) -> Option<()> {
        pixels.clear();
        let [inside, outside] = self.width_px;
        let half = 0.5 * self.length_px;
        let (mut low, mut high) = (self.middle, self.middle);
        for (t, d) in [(-half, -inside), (half, -inside), (-half, outside), (half, outside)] {
            let corner = self.middle + self.along * t + self.outward * d;
            low = low.inf(&corner);
            high = high.sup(&corner);
        }
        let (width, height) = (image.width() as f64, image.height() as f64);
        if !(low.x >= 0.0 && low.y >= 0.0 && high.x <= width - 1.0 && high.y <= height - 1.0) {
            return None;
        }
        for y in low.y.ceil() as usize..=high.y.floor() as usize {
            let row = image.row(y);
            for x in low.x.ceil() as usize..=high.x.floor() as usize {
                let p = Vector2::new(x as f64, y as f64) - self.middle;
                let t = p.dot(&self.along);
                // middle lies on the curve: the chord's ends are inside of it by the sag
                let bent = self.sag_px * (2.0 * t / self.length_px).powi(2);
                let d = p.dot(&self.outward) + bent;
                if t >= -half && t < half && d >= -inside && d <= outside && pixels.len() < MAX_PIXELS {
                    let z = d / blur_px;
                    let (above, density) = normal(z);
                    let level = row.get(x).copied().unwrap_or(0);
                    pixels.push([f64::from(level), above, density, z]);
                }
            }
        }
        (pixels.len() >= FEWEST_PIXELS).then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;

    /// A straight edge, by its definition: each pixel is the mean of 9 x 9 points of the blurred step.
    fn image(offset: f64, angle: f64, blur: f64, noise: f64, seed: u64) -> Vec<u8> {
        let n = Vector2::new(angle.cos(), angle.sin());
        let mut random = Random::new(seed);
        (0..60 * 60)
            .map(|i| {
                let p = Vector2::new(f64::from(i % 60) - 30.0, f64::from(i / 60) - 30.0);
                let mut sum = 0.0;
                for k in 0..81 {
                    let q = Vector2::new(f64::from(k % 9) - 4.0, f64::from(k / 9) - 4.0) / 9.0;
                    sum += normal(((p + q).dot(&n) - offset) / blur).0;
                }
                (50.0 + 120.0 * sum / 81.0 + noise * random.gaussian()).round() as u8
            })
            .collect()
    }

    #[test]
    fn offsets_and_their_deviations_are_those_of_the_edge() {
        let (mut squares, mut count) = (0.0, 0.0);
        for seed in 0..300 {
            let mut random = Random::new(seed);
            let (angle, offset, blur) = (
                random.between(0.0, std::f64::consts::TAU),
                random.between(-0.3, 0.3),
                random.between(0.5, 1.5),
            );
            let pixels = image(offset, angle, blur, 2.0, seed);
            let image = ImageView::new(&pixels, 60, 60).unwrap();
            let outward = Vector2::new(angle.cos(), angle.sin());
            let piece = Piece {
                arc: 0.0,
                part: 0,
                middle: Vector2::repeat(30.0),
                along: Vector2::new(-outward.y, outward.x),
                outward,
                length_px: 10.0,
                sag_px: 0.0,
                width_px: [4.5; 2],
                room_px: [20.0; 2],
            };
            let with_pixel = (blur * blur + 1.0 / 12.0).sqrt();
            let mut buffer = Vec::new();
            let edge = piece.fit(&image, with_pixel, &mut buffer).unwrap();
            squares += (edge.offset_px - offset).powi(2) / (edge.noise * edge.unit_variance);
            count += 1.0;
            assert!((piece.search(&image, 5.0, 1.0, 20.0).unwrap() - offset).abs() < 1.0);
            assert_eq!(piece.search(&image, 5.0, -1.0, 20.0), None);
        }
        let chi2 = squares / count;
        assert!((0.75..1.35).contains(&chi2), "{chi2}");
    }
}
