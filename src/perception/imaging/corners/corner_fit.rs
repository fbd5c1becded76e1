//! Where exactly four squares meet: least squares of the blurred corner in a small window.
//!
//! One model serves every blur, which is measured with the corner: under strong blur it is a saddle, at a sharp corner two edges.
//! The covariance is the fit's own: residual variance times the inverse normal matrix.
//!
//! The edges of the model are straight. A lens bends them, and a bent edge draws the fit to its hollow side. By how much follows from the
//! fit's own equations: where the edge `u = 0` lies at `u = b a^2`, `a` px along it, levels differ by `d_u b a^2`, `d_u` their derivative by a
//! shift of the edge, so that
//!
//! ```text
//! fitted - true = b N^-1 J' (d_u a^2)       N = J' J with what is known beforehand
//! ```
//! The bend is known once the neighbours are ([`CornerFit::unbent`]).

use super::corner_model::parameter::{
    AMPLITUDE, BLUR, COUNT, LIGHT_X, LIGHT_Y, MIDDLE, TURN_U, TURN_V, X, Y,
};
use super::corner_model::{CornerJacobian, CornerModel, CornerPixels};
use crate::imaging::ImageView;
use crate::imaging::simd::has_avx2;
use crate::linalg::{Eight, Ldlt};
use nalgebra::Vector2;

/// Greatest half side of a window, px; of a sharp one, where more pixels add little. Chosen by hand: time grows with the square.
const MAX_HALF_PX: i32 = 8;
const SHARP_HALF_PX: i32 = 5;
/// Between both, the half side in standard deviations of the blur. Chosen by hand: in a smaller window blur and contrast can hardly be distinguished.
const WINDOW_BLURS: f64 = 4.5;
/// Least half side, px.
const MIN_HALF_PX: i32 = 2;
/// Blocks of eight pixels in the greatest window, which follows from its side.
const BLOCKS: usize = ((2 * MAX_HALF_PX as usize + 1).pow(2)).div_ceil(8);
/// Most Gauss-Newton steps. Chosen by hand: a bound; a small step ends them earlier.
const MAX_STEPS: usize = 12;
/// Smallest part of a step that is taken. Chosen by hand, so that the iteration must come to an end.
const MIN_PART: f64 = 0.2;
/// A step this small is the last, px. Chosen by hand: what remains is a twentieth of it, a thousandth of a pixel.
const LAST_STEP_PX: f64 = 0.02;
/// Bounds of the blur, px. Derived: the pixel alone has `1 / sqrt 12` = 0.29. The upper bound was chosen by hand.
const BLURS_PX: std::ops::RangeInclusive<f64> = 0.25..=5.0;
/// What is known beforehand of directions (rad) and of light's change (1/px), as deviations. Squares smaller than `WAVES` deviations of the
/// blur are waves, which tell little of directions. Chosen by hand: half binds fits to their guesses, twice lets waves turn them.
const PRIOR_TURN_RAD: f64 = 0.1;
const PRIOR_TURN_WAVES_RAD: f64 = 0.03;
const WAVES: f64 = 4.5;
const PRIOR_LIGHT: f64 = 0.02;
/// Greatest believed change of a step, as part of it. Chosen by hand: more is a neighbour that is wrong, and perspective hardly.
const MAX_CHANGE: f64 = 0.15;
/// Error that next edges in sight make where they are not parallel, in changes of a step. Chosen from views of boards.
const CONVERGENCE: f64 = 0.04;
/// Variance of rounding to whole grey levels: no residual is believed to be less.
const ROUNDING: f64 = 1.0 / 12.0;

/// Where a corner should be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CornerGuess {
    /// Position, px.
    pub px: Vector2<f64>,
    /// To the next corners along both directions of the board, px: directions and sides of the squares.
    pub steps_px: [Vector2<f64>; 2],
    /// How much longer these are than the mean of the steps on both sides, under perspective, px.
    pub changes_px: [Vector2<f64>; 2],
    /// Deviation of the blur, pixel included, px.
    pub blur_px: f64,
    /// Relative uncertainty of that: one deviation.
    pub blur_spread: f64,
    /// Whether the pattern goes on behind the next corner: along `-steps[0]`, `+steps[0]`, `-steps[1]`, `+steps[1]`.
    pub goes_on: [bool; 4],
}

/// A corner that was fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CornerFit {
    /// Position, px.
    pub px: Vector2<f64>,
    /// Its covariance `[xx, xy, yy]`, px^2.
    pub covariance_px2: [f64; 3],
    /// Deviation of the blur, pixel included, px.
    pub blur_px: f64,
    /// Level between light and dark, grey levels.
    pub middle_level: f64,
    /// Half the contrast, grey levels; negative where the square between `steps[0]` and `steps[1]` is dark.
    pub half_contrast: f64,
    /// Standard deviation of the residuals, grey levels.
    pub residual_levels: f64,
    /// How far the position is drawn to the hollow side of edges that are bent, for a bend of 1 / px of either edge, px^2.
    pub drawn_by_bend_px2: [Vector2<f64>; 2],
}

/// Unit normals of the edges along `steps[1]` and along `steps[0]`, pointing along `steps[0]` and `steps[1]`.
fn edge_normals([su, sv]: [Vector2<f64>; 2]) -> [Vector2<f64>; 2] {
    let side = (su.x * sv.y - su.y * sv.x).signum();
    [Vector2::new(sv.y, -sv.x) * (side / sv.norm()), Vector2::new(-su.y, su.x) * (side / su.norm())]
}

impl CornerFit {
    /// The position with the edges as bent as they are: with steps to the next corners and half the second differences of corners along
    /// both directions, px, an edge runs as `t step + t^2 half difference`.
    #[must_use]
    pub fn unbent(
        &self,
        steps_px: [Vector2<f64>; 2],
        half_differences_px: [Vector2<f64>; 2],
    ) -> Vector2<f64> {
        let drawn_px = |normal: Vector2<f64>, step: Vector2<f64>, half_difference: Vector2<f64>| {
            // of two edges the one with this normal: the fit may have had a turned board
            let [p, q] = self.drawn_by_bend_px2;
            let drawn = if p.dot(&normal).abs() > q.dot(&normal).abs() { p } else { q };
            drawn * drawn.dot(&normal).signum() * (normal.dot(&half_difference) / step.norm_squared())
        };
        let ([along, across], [su, sv], [cu, cv]) = (edge_normals(steps_px), steps_px, half_differences_px);
        self.px - drawn_px(along, sv, cv) - drawn_px(across, su, cu)
    }
}

/// Fits corners. Owns its buffers.
#[derive(Debug, Clone)]
pub struct CornerFitter {
    pixels: [CornerPixels; BLOCKS],
    rows: [CornerJacobian; BLOCKS],
    /// Blocks in use, and pixels that count.
    blocks: usize,
    count: usize,
    #[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
    wide: bool,
}

type NormalMatrix = [[f64; COUNT]; COUNT];
type Vector = [f64; COUNT];

/// Normal matrix, right side, sum of squares.
#[derive(Debug, Clone, Copy)]
struct CornerEquations {
    matrix: NormalMatrix,
    right: Vector,
    squares: f64,
}

impl Default for CornerFitter {
    fn default() -> Self {
        let zero = Eight::ZERO;
        Self {
            pixels: [CornerPixels { x: zero, y: zero, level: zero, weight: zero }; BLOCKS],
            rows: [CornerJacobian { residual: zero, derivative: [zero; COUNT] }; BLOCKS],
            blocks: 0,
            count: 0,
            wide: has_avx2(),
        }
    }
}

/// How much of the next step to go. What is not quite the model, like squares that touch over more than a point, sends whole steps to and
/// fro: there, Aitken's part of it, which ends a sequence whose errors fall, or rise, by one ratio.
fn part_of_step(part: f64, before: [f64; 2], now: [f64; 2]) -> f64 {
    let back = before[0] * now[0] + before[1] * now[1];
    if back >= 0.0 {
        return (2.0 * part).min(1.0);
    }
    let square = before[0].powi(2) + before[1].powi(2);
    let apart = square - 2.0 * back + now[0].powi(2) + now[1].powi(2);
    (part * (square - back) / apart).clamp(MIN_PART, 1.0)
}

impl CornerFitter {
    /// Fits the corner near `guess`. `None` where there is none: out of the image, no convergence within `reach_px`, no contrast.
    pub fn fit(&mut self, image: &ImageView<'_>, guess: &CornerGuess, reach_px: f64) -> Option<CornerFit> {
        let [su, sv] = guess.steps_px;
        let (len_u, len_v) = (su.norm(), sv.norm());
        let area = su.x * sv.y - su.y * sv.x; // of the parallelogram; over a side: distance between parallel edges
        let next = [(area / len_v).abs(), (area / len_u).abs()];
        // between edges there must be a pixel; no image has the other
        if !(next[0] > 2.0 && next[1] > 2.0 && len_u < 1e4 && len_v < 1e4) {
            return None;
        }
        let most = ((WINDOW_BLURS * guess.blur_px) as i32).clamp(SHARP_HALF_PX, MAX_HALF_PX);
        let half = ((0.75 * next[0].min(next[1])) as i32).clamp(MIN_HALF_PX, most);
        let [normal_u, normal_v] = edge_normals(guess.steps_px);
        // little, or the guess is bad
        let [cu, cv] = guess.changes_px;
        let longer = [normal_u.dot(&cu) / next[0], normal_v.dot(&cv) / next[1]]
            .map(|part| if part.abs() < MAX_CHANGE { part } else { 0.0 });
        let longer = [longer[0] * next[0], longer[1] * next[1]];
        let mut p = [0.0; COUNT];
        p[TURN_U] = normal_u.y.atan2(normal_u.x);
        p[TURN_V] = normal_v.y.atan2(normal_v.x);
        p[BLUR] = guess.blur_px.clamp(*BLURS_PX.start(), *BLURS_PX.end());
        let before = p;
        let waves = next[0].min(next[1]) < WAVES * p[BLUR];
        let spread = [if waves { PRIOR_TURN_WAVES_RAD } else { PRIOR_TURN_RAD }, guess.blur_spread];
        let bounds = self.bounds(guess, next, p[BLUR]);
        let mut middle = self.load(image, guess.px, half, [normal_u, normal_v], bounds)?;
        (p[X], p[Y]) = (guess.px.x - middle[0], guess.px.y - middle[1]);
        self.first_levels(&mut p, [normal_u, normal_v]);
        let mut reloads = 0;
        let (mut part, mut previous) = (1.0, [0.0; 2]);
        for step in 0..MAX_STEPS {
            let at = Vector2::new(p[X] + middle[0], p[Y] + middle[1]);
            // half a pixel, and some more so that it must not alternate
            if p[X].abs().max(p[Y].abs()) > 0.8 && reloads < 3 {
                reloads += 1;
                middle = self.load(image, at, half, [normal_u, normal_v], bounds)?;
                (p[X], p[Y]) = (at.x - middle[0], at.y - middle[1]);
            }
            // the next edges matter where their blur reaches into the window
            let seen = f64::from(half) * 1.5 + 3.0 * p[BLUR];
            let next_px = [(next[0], longer[0]), (next[1], longer[1])]
                .map(|(l, d)| (l < seen).then_some([l - d, l + d].map(|l| l as f32)));
            let normal = self.normal(&CornerModel::new(&p, next_px));
            let free = (self.count as f64 - COUNT as f64).max(1.0);
            let variance = (normal.squares / free).max(ROUNDING);
            let (mut weights, right) = with_prior(&normal, &p, &before, spread, variance);
            if waves && step == 0 {
                // the contrast first: of waves far less is seen than there is, and steps would be far too long
                for index in [X, Y, TURN_U, TURN_V, BLUR] {
                    weights[index] += 1e3 * normal.matrix[index][index];
                }
            }
            let factor = Ldlt::new(&normal.matrix, &weights)?;
            let mut delta = factor.solve(&right);
            let size = delta[X].hypot(delta[Y]);
            if !size.is_finite() {
                return None;
            }
            part = part_of_step(part, previous, [delta[X], delta[Y]]);
            previous = [delta[X], delta[Y]];
            let most = 0.7 * p[BLUR].max(0.7); // chosen by hand: far from the corner a whole step may lead astray
            let shorter = (most / size.max(1e-9)).min(0.5 * p[BLUR] / delta[BLUR].abs().max(1e-9)).min(part); // else 0 / 0
            for (p, delta) in p.iter_mut().zip(&mut delta) {
                *delta *= shorter;
                *p += *delta;
            }
            p[BLUR] = p[BLUR].clamp(*BLURS_PX.start(), *BLURS_PX.end());
            let px = Vector2::new(p[X] + middle[0], p[Y] + middle[1]);
            if !((px - guess.px).norm() <= reach_px) {
                return None;
            }
            if size < LAST_STEP_PX && step > 0 {
                // what the last step still takes off the sum of squares
                let less: f64 = delta.iter().zip(&normal.right).map(|(d, r)| d * r).sum();
                let squares = normal.squares - less;
                let variance = (squares / free).max(ROUNDING);
                let unit = |index: usize| std::array::from_fn(|i| f64::from(u8::from(i == index)));
                let (by_x, by_y) = (factor.solve(&unit(X)), factor.solve(&unit(Y)));
                // lines that converge are modelled as parallel
                let bent = next_px.iter().zip([cu, cv]).filter(|(next, _)| next.is_some());
                let floor = bent.map(|(_, c)| CONVERGENCE * CONVERGENCE * c.norm_squared()).sum::<f64>();
                let [xx, xy, yy] = [by_x[X], by_x[Y], by_y[Y]].map(|c| c * variance);
                let covariance = [xx + floor, xy, yy + floor];
                return covariance.iter().all(|c| c.is_finite()).then_some(CornerFit {
                    px,
                    covariance_px2: covariance,
                    blur_px: p[BLUR],
                    middle_level: p[MIDDLE],
                    half_contrast: p[AMPLITUDE],
                    residual_levels: variance.sqrt(),
                    drawn_by_bend_px2: self.drawn_by_bend(&p).map(|right| {
                        let drawn = factor.solve(&right);
                        Vector2::new(drawn[X], drawn[Y])
                    }),
                });
            }
        }
        None
    }

    /// How far pixels may lie from the corner along `-u`, `+u`, `-v`, `+v`, px: where the pattern ends, nothing is known of what
    /// lies behind the outer square.
    fn bounds(&self, guess: &CornerGuess, next: [f64; 2], blur: f64) -> [f64; 4] {
        let mut bounds = [f64::INFINITY; 4];
        for (i, (bound, goes_on)) in bounds.iter_mut().zip(guess.goes_on).enumerate() {
            if !goes_on {
                *bound = (next.get(i / 2).copied().unwrap_or(0.0) - 2.2 * blur).max(1.6); // chosen by hand: a pixel must be left
            }
        }
        bounds
    }

    /// Takes the pixels about a point; the window's middle. `None` when too few are in the image.
    fn load(
        &mut self,
        image: &ImageView<'_>,
        about: Vector2<f64>,
        half: i32,
        normals: [Vector2<f64>; 2],
        bounds: [f64; 4],
    ) -> Option<[f64; 2]> {
        let (mx, my) = (about.x.round(), about.y.round());
        let fits = |m: f64, size: usize| m >= 2.0 && m <= size as f64 - 3.0;
        if !(fits(mx, image.width()) && fits(my, image.height())) {
            return None;
        }
        let (left, top) = (mx as i64, my as i64);
        let bounded = bounds.iter().any(|b| b.is_finite());
        let [low_u, high_u, low_v, high_v] = bounds.map(|b| b as f32);
        let [nu, nv] = normals.map(|n| [n.x as f32, n.y as f32]);
        let (ax, ay) = ((about.x - mx) as f32, (about.y - my) as f32);
        let side = (2 * half + 1) as usize;
        let (mut at, mut count) = (0, 0);
        self.blocks = (side * side).div_ceil(8);
        for dy in -half..=half {
            let row = usize::try_from(top + i64::from(dy)).map_or(&[][..], |y| image.row(y));
            for dx in -half..=half {
                let level = usize::try_from(left + i64::from(dx)).ok().and_then(|x| row.get(x));
                let (x, y) = (dx as f32, dy as f32);
                let mut counts = level.is_some();
                if bounded {
                    let u = nu[0] * (x - ax) + nu[1] * (y - ay);
                    let v = nv[0] * (x - ax) + nv[1] * (y - ay);
                    counts &= -low_u <= u && u <= high_u && -low_v <= v && v <= high_v;
                }
                let pixels = self.pixels.get_mut(at / 8)?;
                for (eight, value) in [
                    (&mut pixels.x, x),
                    (&mut pixels.y, y),
                    (&mut pixels.level, level.map_or(0.0, |&l| f32::from(l))),
                    (&mut pixels.weight, f32::from(u8::from(counts))),
                ] {
                    if let Some(slot) = eight.0.get_mut(at % 8) {
                        *slot = value;
                    }
                }
                count += usize::from(counts);
                at += 1;
            }
        }
        // the rest of the last block
        if let Some(pixels) = self.pixels.get_mut(self.blocks - 1) {
            let used = (at - 1) % 8 + 1;
            pixels.weight.0.iter_mut().skip(used).for_each(|w| *w = 0.0);
        }
        self.count = count;
        (count >= 2 * COUNT).then_some([mx, my])
    }

    /// Levels and contrast from the means of the quadrants.
    fn first_levels(&self, p: &mut Vector, normals: [Vector2<f64>; 2]) {
        let (mut same, mut other) = ([0.0f64; 2], [0.0f64; 2]);
        for pixels in self.pixels.iter().take(self.blocks) {
            let each = pixels.x.0.iter().zip(&pixels.y.0).zip(pixels.level.0.iter().zip(&pixels.weight.0));
            for ((x, y), (level, weight)) in each {
                let d = Vector2::new(f64::from(*x) - p[X], f64::from(*y) - p[Y]);
                let uv = normals[0].dot(&d) * normals[1].dot(&d);
                let [sum, n] = if uv > 0.0 { &mut same } else { &mut other };
                *sum += f64::from(level * weight);
                *n += f64::from(*weight);
            }
        }
        let (a, b) = (same[0] / same[1].max(1.0), other[0] / other[1].max(1.0));
        p[MIDDLE] = 0.5 * (a + b);
        // blur takes off about a third of it
        p[AMPLITUDE] = 0.7 * (a - b);
    }

    fn normal(&mut self, model: &CornerModel) -> CornerEquations {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            return unsafe { self.normal_avx2(model) };
        }
        self.normal_with(model)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn normal_avx2(&mut self, model: &CornerModel) -> CornerEquations {
        self.normal_with(model)
    }

    #[inline(always)]
    fn normal_with(&mut self, model: &CornerModel) -> CornerEquations {
        let (pixels, rows) = (self.pixels.get(..self.blocks), self.rows.get_mut(..self.blocks));
        let (Some(pixels), Some(rows)) = (pixels, rows) else {
            return CornerEquations { matrix: [[0.0; COUNT]; COUNT], right: [0.0; COUNT], squares: 0.0 };
        };
        for (pixels, row) in pixels.iter().zip(rows.iter_mut()) {
            *row = model.at(pixels);
        }
        let rows = &*rows;
        let product = |a: &dyn Fn(&CornerJacobian) -> Eight, b: &dyn Fn(&CornerJacobian) -> Eight| {
            let mut sum = Eight::ZERO;
            for row in rows {
                sum = sum + a(row) * b(row);
            }
            f64::from(sum.sum())
        };
        let mut out = CornerEquations { matrix: [[0.0; COUNT]; COUNT], right: [0.0; COUNT], squares: 0.0 };
        for i in 0..COUNT {
            for j in i..COUNT {
                let mut sum = Eight::ZERO;
                for row in rows {
                    sum = sum + row.derivative[i] * row.derivative[j];
                }
                let sum = f64::from(sum.sum());
                (out.matrix[i][j], out.matrix[j][i]) = (sum, sum);
            }
            out.right[i] = product(&|r| r.derivative[i], &|r| r.residual);
        }
        out.squares = product(&|r| r.residual, &|r| r.residual);
        out
    }
}

/// What was known before, weighed by the residual variance: to be added to the diagonal, and the whole right side.
fn with_prior(
    normal: &CornerEquations,
    p: &Vector,
    before: &Vector,
    [turn, blur]: [f64; 2],
    variance: f64,
) -> (Vector, Vector) {
    let (mut weights, mut right) = ([0.0; COUNT], normal.right);
    for (index, sd) in [
        (TURN_U, turn),
        (TURN_V, turn),
        (BLUR, blur.max(1e-3) * before[BLUR]), // not 0, else it would weigh infinitely
        (LIGHT_X, PRIOR_LIGHT),
        (LIGHT_Y, PRIOR_LIGHT),
    ] {
        let weight = variance / (sd * sd);
        weights[index] = weight;
        right[index] += weight * (before[index] - p[index]);
    }
    (weights, right)
}

mod bend;
#[cfg(test)]
mod tests;
