//! Image model of a tag: grey levels of pixels and their derivatives by all parameters, for eight pixels at a time.
//!
//! With `W` the share of white at a point of the tag (1 on paper, 0 on ink), smoothed by the blur:
//!
//! ```text
//! I(p) = (1 + k_x x + k_y y) (ink + contrast f(W) + sum_i ground_i O_i)
//!            O_i: share of the ground beyond the margin on side i; f: W itself, or bent by a gamma ([`LevelCurve`])
//! W = exp(S_cr d/dc d/dr) sum_ij white_ij P_i(c) P_j(r)                   S: the blur's covariance at (c, r), in cells
//! ```
//! `P_i(c)` is the share of a normal distribution about `c` that falls into column `i`. The exponential, Mehler's series, accounts for a blur whose axes
//! are not those of the cells, as in a tilted tag. The blur contains the pixel's own square. A step of
//! the homography is a displacement field of eight parameters ([`field`]).

use super::clipped::clipped_residual;
use super::level_curve::{CurveValues, LevelCurve};
use super::pattern::CellPattern;
use super::plane_map::PlaneMap;
use crate::imaging::MAX_LEVEL;
use crate::imaging::simd::kernel;
use crate::linalg::Eight;
use nalgebra::{Matrix2, Vector2};

/// What is fitted, by its first index: geometry at 0, covariance of the blur (xx, xy, yy), ink, contrast, slopes of the light, grounds. Each index
/// follows from the one before and the number of its parameters.
pub(super) const BLUR: usize = 8;
pub(super) const INK: usize = 11;
pub(super) const CONTRAST: usize = 12;
pub(super) const LIGHT: usize = 13;
pub(super) const GROUND: usize = 15;
/// So many are always fitted: it follows from `GROUND` and the four grounds.
pub(super) const COUNT: usize = 19;
/// Column of the gamma's logarithm, behind that of the residuals; it is fitted where the camera's response is not known.
pub(super) const GAMMA: usize = COUNT + 1;
/// Column of the logarithm of the light of paper over that of ink; it is fitted where these levels may not tell it, because the camera subtracts a black level.
pub(super) const RATIO: usize = GAMMA + 1;
/// All that is fitted; the logarithms of the camera's gamma and of the ratio of light are the last.
pub(super) const UNKNOWNS: usize = COUNT + 2;
/// Column of the root of a pixel's weight: 1, or less where it is clipped.
const WEIGHT: usize = RATIO + 1;
/// Columns: those of all that is fitted and of the residuals, and as many more as are needed because they are summed by fours.
pub(super) const COLUMNS: usize = 24;

/// A blur reaches so many deviations: beyond lies less than a thousandth, 7e-4, as the normal distribution has it. Half would cut off 5 %, the double
/// doubles the cells that each pixel needs.
const REACH: f64 = 3.2;
/// Most cells on either side of its own one that contribute to a pixel: with [`REACH`] a blur of 3 / 3.2 = 0.94 cells, beyond which neighbouring cells are so mixed
/// that bits cannot be read. Chosen by hand: half refuses tags that are read, the double takes more time for none.
const MAX_BESIDE: i32 = 3;
const MAX_SEEN: usize = 2 * MAX_BESIDE as usize + 1;
/// Pixels of which the products are summed at once, in eights. Chosen by hand: the derivatives of 16 eights are 12 KiB, so that they stay in a first cache of
/// 32 KiB, and sums of so few stay exact enough in single precision; half has more overhead, the double fills the cache.
const CHUNK: usize = 16;

/// Eight pixels: positions relative to the origin (px), levels, and weights, 1 where they count, else 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct TagPixels {
    pub(super) x: Eight,
    pub(super) y: Eight,
    pub(super) level: Eight,
    pub(super) weight: Eight,
}

impl TagPixels {
    pub(super) const NONE: Self =
        Self { x: Eight::ZERO, y: Eight::ZERO, level: Eight::ZERO, weight: Eight::ZERO };
}

/// Derivatives of eight pixels' levels by the parameters; at [`COUNT`] the residuals, at [`GAMMA`] and [`RATIO`] the
/// derivatives by these logarithms.
pub(super) type TagJacobian = [Eight; COLUMNS];

/// Normal equations: sums of products of the columns of [`TagJacobian`], of which the lower triangle is valid, and the number of pixels.
#[derive(Debug, Clone)]
pub(super) struct RowProducts {
    pub(super) products: [[f64; COLUMNS]; COLUMNS],
    pub(super) count: f64,
}

/// Displacement of the point `q` (relative to the origin, in radii) by a unit of each of the eight parameters of a projective motion.
pub(super) fn field(q: Vector2<f64>) -> [Vector2<f64>; 8] {
    let (x, y, v) = (q.x, q.y, Vector2::new);
    [v(1.0, 0.0), v(x, 0.0), v(y, 0.0), v(0.0, 1.0), v(0.0, x), v(0.0, y), v(x * x, x * y), v(x * y, y * y)]
}

/// The parameters of a tag's image at one step of the fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct TagImage {
    /// Homography from pixels to cells.
    pub(super) back: PlaneMap,
    /// Origin of the pixels' positions, and the radius by which they are normalized, px.
    pub(super) origin: Vector2<f64>,
    pub(super) radius: f64,
    /// Covariance of the blur `[xx, xy, yy]`, px^2.
    pub(super) blur: [f64; 3],
    pub(super) ink: f64,
    pub(super) contrast: f64,
    /// Relative slope of the illumination, per radius.
    pub(super) light: [f64; 2],
    /// Level of the ground beyond the margin less that of the paper: left, right, above, below.
    pub(super) ground: [f64; 4],
    /// Deviation of the noise, levels, by which pixels at the last level are weighed ([`clipped_residual`]); `None` where these are levels like others.
    pub(super) clipped_noise: Option<f64>,
    /// Logarithm of the camera's gamma where it is unknown; `None` where levels are proportional to light.
    pub(super) log_gamma: Option<f64>,
    /// Logarithm of the light of paper over that of ink where it is a parameter of its own; `None` where their levels tell it.
    pub(super) log_ratio: Option<f64>,
}

impl TagImage {
    /// The logarithm of the light of paper over that of ink as their levels and a gamma tell it, for a camera that subtracts no black level.
    pub(super) fn told_log_ratio(&self, log_gamma: f64) -> f64 {
        let ink = self.ink.max(1.0);
        log_gamma.exp() * ((ink + self.contrast) / ink).max(1.0).ln()
    }
}

/// The parameters in single precision, prepared for the evaluation of pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct TagModel<'a> {
    pattern: &'a CellPattern,
    back: [f32; 9],
    per_radius: f32,
    blur: [f32; 3],
    ink: f32,
    contrast: f32,
    /// Derivatives of the logarithm of the ratio of light by ink, contrast, the gamma's logarithm, and itself where it is a parameter.
    log_ratio_by: [f32; 4],
    light: [f32; 2],
    ground: [f32; 4],
    /// Response of the camera, where a gamma is fitted.
    curve: Option<LevelCurve>,
    /// Number of cells on either side that contribute to a pixel, along columns and rows.
    beside: [i32; 2],
    /// Residuals whose square is larger do not count.
    max_square: f32,
    /// Deviation of the noise where pixels may be clipped.
    clipped_noise: Option<f64>,
}

/// Along one direction of the tag: the first contributing cell, and twice the share of each cell with its three derivatives by position.
struct CellShares {
    first: [i32; 8],
    shares: [[Eight; 4]; MAX_SEEN],
}

/// Share of white `W` and its derivatives by column and row, in cells.
struct White {
    value: Eight,
    by_c: Eight,
    by_r: Eight,
    by_cc: Eight,
    by_cr: Eight,
    by_rr: Eight,
}

impl<'a> TagModel<'a> {
    /// The model of a tag with the corners `corners` (px); `None` where the blur reaches across too many cells.
    pub(super) fn new(
        tag_image: &TagImage,
        pattern: &'a CellPattern,
        corners: &[Vector2<f64>; 4],
        max_square: f64,
    ) -> Option<Self> {
        let [xx, xy, yy] = tag_image.blur;
        let blur = Matrix2::new(xx, xy, xy, yy);
        let mut most = Vector2::zeros();
        for corner in corners {
            let (_, slope) = tag_image.back.at_with_slope(*corner);
            let spread = slope * blur * slope.transpose();
            most = Vector2::sup(&most, &Vector2::new(spread.m11, spread.m22));
        }
        let beside = [most.x, most.y].map(|variance| (REACH * variance.sqrt()).ceil());
        if !beside.iter().all(|b| *b >= 1.0 && *b <= f64::from(MAX_BESIDE)) {
            return None;
        }
        let told = tag_image.told_log_ratio(tag_image.log_gamma.unwrap_or(0.0));
        // a level of ink below one tells no ratio
        let ink = tag_image.ink.max(1.0);
        let paper = ink + tag_image.contrast;
        let gamma = tag_image.log_gamma.unwrap_or(0.0).exp();
        let log_ratio_by = match tag_image.log_ratio {
            Some(_) => [0.0, 0.0, 0.0, 1.0],
            None => [gamma * (1.0 / paper - 1.0 / ink), gamma / paper, told, 0.0],
        };
        Some(Self {
            pattern,
            back: tag_image.back.about(tag_image.origin).map(|v| v as f32),
            per_radius: (1.0 / tag_image.radius) as f32,
            blur: tag_image.blur.map(|v| v as f32),
            ink: tag_image.ink as f32,
            contrast: tag_image.contrast as f32,
            light: tag_image.light.map(|v| v as f32),
            ground: tag_image.ground.map(|v| v as f32),
            curve: tag_image.log_gamma.map(|log| LevelCurve::new(log, tag_image.log_ratio.unwrap_or(told))),
            log_ratio_by: log_ratio_by.map(|by| by as f32),
            beside: beside.map(|b| b as i32),
            // infinite before the first step: any finite number above 255^2 would do
            max_square: max_square.min(1e12) as f32,
            clipped_noise: tag_image.clipped_noise,
        })
    }

    /// Derivatives of the levels and residuals (level less prediction); all 0 where a pixel does not count.
    #[inline(always)]
    fn at(&self, p: &TagPixels) -> TagJacobian {
        let [a, b, c, d, e, f, g, h, i] = self.back;
        let w = (p.x * g + p.y * h + i).each(|w| 1.0 / w);
        let (column, row) = ((p.x * a + p.y * b + c) * w, (p.x * d + p.y * e + f) * w);
        let (cx, cy) = ((-(column * g) + a) * w, (-(column * h) + b) * w);
        let (rx, ry) = ((-(row * g) + d) * w, (-(row * h) + e) * w);
        let [xx, xy, yy] = self.blur;
        let spread_c = cx * cx * xx + cx * cy * (2.0 * xy) + cy * cy * yy;
        let spread_r = rx * rx * xx + rx * ry * (2.0 * xy) + ry * ry * yy;
        let aslant = cx * rx * xx + (cx * ry + cy * rx) * xy + cy * ry * yy;
        let (per_c, per_r) = (spread_c.each(|s| 1.0 / s.sqrt()), spread_r.each(|s| 1.0 / s.sqrt()));
        let columns = seen(column, per_c, self.beside[0]);
        let rows = seen(row, per_r, self.beside[1]);
        let white = self.white(&columns, &rows, aslant);

        let n = self.pattern.cells as f32;
        let (sides, ends) = (beyond(column, per_c, n), beyond(row, per_r, n));
        // the ground beyond a corner is counted once
        let between = -(sides.share[0] + sides.share[1]) + 1.0;
        let [before, behind, above, below] = self.ground;
        let beyond = [sides.share[0], sides.share[1], ends.share[0] * between, ends.share[1] * between];
        // the response acts after the blur: derivatives of W by position and blur are multiplied by its slope
        let shown = match &self.curve {
            Some(curve) => curve.at(white.value),
            None => CurveValues {
                value: white.value,
                slope: Eight([1.0; 8]),
                by_log_gamma: Eight::ZERO,
                by_log_light: Eight::ZERO,
            },
        };
        let (slope, by_ratio) = (shown.slope * self.contrast, shown.by_log_light * self.contrast);
        let [by_ink, by_contrast, by_gamma, by_itself] = self.log_ratio_by;
        let mut raw = shown.value * self.contrast + self.ink;
        for (share, ground) in beyond.iter().zip(self.ground) {
            raw = raw + *share * ground;
        }
        let by_c = white.by_c * slope + sides.by[1] * behind - sides.by[0] * before;
        let by_r = white.by_r * slope + ends.by[1] * below - ends.by[0] * above;
        let by_cc = white.by_cc * slope + sides.twice[0] * before + sides.twice[1] * behind;
        let by_rr = white.by_rr * slope + ends.twice[0] * above + ends.twice[1] * below;
        let by_cr = white.by_cr * slope;
        let (x, y) = (p.x * self.per_radius, p.y * self.per_radius);
        let lit = x * self.light[0] + y * self.light[1] + 1.0;
        let mut residual = p.level - lit * raw;
        let mut weight = p.weight;
        if let Some(noise) = self.clipped_noise {
            clipped_lanes(p, noise, &mut residual, &mut weight);
        }
        let fits = residual.each(|r| f32::from(u8::from(r * r <= self.max_square)));
        let weight = weight * fits;
        let lit = lit * weight;

        let half = lit * 0.5;
        // the image moves by the field, and levels change by minus the gradient times it. That the field would stretch the blur too is left to
        // the blur's own parameters
        let gx = -((by_c * cx + by_r * rx) * lit);
        let gy = -((by_c * cy + by_r * ry) * lit);
        let radial = gx * x + gy * y;
        let raw = raw * weight;
        let [left, right, above, below] = beyond.map(|share| share * lit);
        [
            gx,
            gx * x,
            gx * y,
            gy,
            gy * x,
            gy * y,
            radial * x,
            radial * y,
            (by_cc * cx * cx + by_cr * cx * rx * 2.0 + by_rr * rx * rx) * half,
            (by_cc * cx * cy + by_cr * (cx * ry + cy * rx) + by_rr * rx * ry) * lit,
            (by_cc * cy * cy + by_cr * cy * ry * 2.0 + by_rr * ry * ry) * half,
            lit * (by_ratio * by_ink + 1.0),
            lit * (by_ratio * by_contrast + shown.value),
            raw * x,
            raw * y,
            left,
            right,
            above,
            below,
            residual * weight,
            lit * (shown.by_log_gamma * self.contrast + by_ratio * by_gamma),
            lit * by_ratio * by_itself,
            weight,
            Eight::ZERO,
        ]
    }

    #[inline(always)]
    #[allow(clippy::indexing_slicing)] // constants below the lengths
    fn white(&self, columns: &CellShares, rows: &CellShares, s: Eight) -> White {
        let count = |beside: i32| (2 * beside + 1) as usize;
        let mut w = [[Eight::ZERO; 4]; 4];
        for (j, by_row) in (0..).zip(rows.shares.iter().take(count(self.beside[1]))) {
            let mut bits = [0u32; 8];
            for ((bits, i), first) in bits.iter_mut().zip(columns.first).zip(rows.first) {
                *bits = self.pattern.bits_at(i, first + j);
            }
            let mut t = [Eight::ZERO; 4];
            for (i, by_column) in columns.shares.iter().enumerate().take(count(self.beside[0])) {
                let white = Eight(bits.map(|bits| (bits >> i & 1) as f32));
                for (t, share) in t.iter_mut().zip(by_column) {
                    *t = *t + white * *share;
                }
            }
            for (w, t) in w.iter_mut().zip(t) {
                for (w, share) in w.iter_mut().zip(by_row) {
                    *w = *w + t * *share;
                }
            }
        }
        // shares were doubled in both directions
        let s1 = s * 0.25;
        let s2 = s1 * s * 0.5;
        let s3 = s2 * s * (1.0 / 3.0);
        White {
            value: w[0][0] * 0.25 + w[1][1] * s1 + w[2][2] * s2 + w[3][3] * s3,
            by_c: w[1][0] * 0.25 + w[2][1] * s1 + w[3][2] * s2,
            by_r: w[0][1] * 0.25 + w[1][2] * s1 + w[2][3] * s2,
            by_cc: w[2][0] * 0.25 + w[3][1] * s1,
            by_cr: w[1][1] * 0.25 + w[2][2] * s1 + w[3][3] * s2,
            by_rr: w[0][2] * 0.25 + w[1][3] * s1,
        }
    }
}

/// Shares of the ground before and behind the `n` cells with their margin of one cell, and their first and second derivatives outward.
struct OutsideShares {
    share: [Eight; 2],
    by: [Eight; 2],
    twice: [Eight; 2],
}

#[inline(always)]
fn beyond(place: Eight, per: Eight, n: f32) -> OutsideShares {
    let off = place + (-0.5 * n);
    let behind = off.each(|off| f32::from(u8::from(off > 0.0)));
    let before = -behind + 1.0;
    let z = (off.each(f32::abs) + (-0.5 * n - 1.0)) * per;
    let (step, slope) = z.step_and_slope();
    let share = step * 0.5 + 0.5;
    let by = slope * per * 0.5;
    let twice = -(z * per * by);
    OutsideShares {
        share: [share * before, share * behind],
        by: [by * before, by * behind],
        twice: [twice * before, twice * behind],
    }
}

/// The cells that contribute at position `place` (cells), for the reciprocal `per` of the blur's deviation (1/cells).
#[inline(always)]
fn seen(place: Eight, per: Eight, beside: i32) -> CellShares {
    // adding 1.5 * 2^23 rounds to the nearest whole number, because a number of single precision has 23 bits behind its first one
    const MAGIC: f32 = 12_582_912.0;
    let first = place.each(|p| ((p - 0.5) + MAGIC) - MAGIC - beside as f32);
    let one = Eight([1.0; 8]);
    let mut before = [-one, Eight::ZERO, Eight::ZERO, Eight::ZERO];
    let mut shares = [[Eight::ZERO; 4]; MAX_SEEN];
    let last = 2 * beside as usize;
    for (k, share) in shares.iter_mut().enumerate().take(last + 1) {
        let end = if k == last {
            [one, Eight::ZERO, Eight::ZERO, Eight::ZERO]
        } else {
            let z = (first - place + (k as f32 + 1.0)) * per;
            let (step, slope) = z.step_and_slope();
            let by = -(slope * per);
            [step, by, z * per * by, (z * z + (-1.0)) * per * per * by]
        };
        for ((share, end), before) in share.iter_mut().zip(end).zip(before) {
            *share = end - before;
        }
        before = end;
    }
    CellShares { first: first.0.map(|f| f as i32), shares }
}

/// Residuals and roots of weights of those of eight pixels that are at the last level.
#[allow(clippy::indexing_slicing)] // indices below eight
fn clipped_lanes(p: &TagPixels, noise: f64, residual: &mut Eight, weight: &mut Eight) {
    for i in 0..8 {
        if p.level.0[i] >= MAX_LEVEL as f32 {
            let meant = f64::from(p.level.0[i] - residual.0[i]);
            let (left, root) = clipped_residual(meant, noise);
            residual.0[i] = left as f32;
            weight.0[i] *= root as f32;
        }
    }
}

kernel!(
    /// Adds the normal equations of all pixels to `sums`. `rows`: room for the derivatives of as many pixels, which is filled.
    pub(super) fn accumulate(model: &TagModel<'_>, pixels: &[TagPixels], rows: &mut [TagJacobian], sums: &mut RowProducts) = accumulate_body
);

#[inline(always)]
#[allow(clippy::indexing_slicing)] // indices below the lengths of arrays
fn accumulate_body(
    model: &TagModel<'_>,
    pixels: &[TagPixels],
    rows: &mut [TagJacobian],
    sums: &mut RowProducts,
) {
    for (chunk, rows) in pixels.chunks(CHUNK).zip(rows.chunks_mut(CHUNK)) {
        let mut counted = Eight::ZERO;
        for (row, pixels) in rows.iter_mut().zip(chunk) {
            *row = model.at(pixels);
            counted = counted + row[WEIGHT] * row[WEIGHT];
        }
        sums.count += f64::from(counted.sum());
        let rows = &rows[..chunk.len()];
        // eight independent sums at once, so that additions need not wait for each other
        let last = if model.curve.is_some() { RATIO } else { COUNT };
        for i in (0..=last).step_by(2) {
            for k in (0..=i).step_by(4) {
                let mut block = [[Eight::ZERO; 4]; 2];
                for row in rows {
                    let right = [row[k], row[k + 1], row[k + 2], row[k + 3]];
                    for (sums, left) in block.iter_mut().zip([row[i], row[i + 1]]) {
                        for (sum, right) in sums.iter_mut().zip(right) {
                            *sum = *sum + left * right;
                        }
                    }
                }
                for (products, sums) in sums.products[i..].iter_mut().zip(&block) {
                    for (product, sum) in products[k..].iter_mut().zip(sums) {
                        *product += f64::from(sum.sum());
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
