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
use super::corner_model::{CornerJacobian, CornerModel, RESIDUAL};
use crate::imaging::ImageView;
use crate::imaging::simd::has_avx2;
use crate::linalg::{Eight, Ldlt};
use nalgebra::Vector2;
use window::CornerWindow;

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
/// The same with derivatives that are not those of the place: what remains is a tenth, again a thousandth of a pixel.
const LAST_NEAR_STEP_PX: f64 = 0.01;
/// After a step that moves, turns and blurs edges by less the derivatives stay as they are for the next one, px: over a sixth of a usual blur they
/// change by a sixth at most, and so does a step that is small by then. Chosen by hand: half asks for whole steps more often.
const NEAR_PX: f64 = 0.08;
/// Greatest shift from sums over quadrants that is believed, px. Chosen by hand: ring corners are off by less, and a shift by more leaves the window.
const MOST_SHIFT_PX: f64 = 1.2;
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
    window: CornerWindow,
    rows: [CornerJacobian; BLOCKS],
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
        Self { window: CornerWindow::default(), rows: [[Eight::ZERO; COUNT + 1]; BLOCKS], wide: has_avx2() }
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
        let mut middle = self.window.load(image, guess.px, half, [normal_u, normal_v], bounds)?;
        (p[X], p[Y]) = (guess.px.x - middle[0], guess.px.y - middle[1]);
        let about = self.window.quadrants([p[X], p[Y]], [normal_u, normal_v]);
        if !waves && about.shift_px.iter().all(|shift| shift.abs() < MOST_SHIFT_PX) {
            (p[MIDDLE], p[AMPLITUDE]) = (about.middle, about.amplitude);
            (p[X], p[Y]) = (p[X] + about.shift_px[0], p[Y] + about.shift_px[1]);
        } else {
            let [same, other] = about.means;
            // blur takes off about a third of the contrast
            (p[MIDDLE], p[AMPLITUDE]) = (0.5 * (same + other), 0.7 * (same - other));
        }
        let mut reloads = 0;
        let (mut part, mut previous, mut changed_px) = (1.0, [0.0; 2], f64::INFINITY);
        let mut normal = CornerEquations { matrix: [[0.0; COUNT]; COUNT], right: [0.0; COUNT], squares: 0.0 };
        for step in 0..MAX_STEPS {
            let at = Vector2::new(p[X] + middle[0], p[Y] + middle[1]);
            // where a pattern is nearly a wave, some parameters are hardly determined, and derivatives of elsewhere lead nowhere
            let mut near = changed_px < NEAR_PX && !waves;
            // half a pixel, and some more so that it must not alternate
            if p[X].abs().max(p[Y].abs()) > 0.8 && reloads < 3 {
                (reloads, near) = (reloads + 1, false);
                middle = self.window.load(image, at, half, [normal_u, normal_v], bounds)?;
                (p[X], p[Y]) = (at.x - middle[0], at.y - middle[1]);
            }
            // the next edges matter where their blur reaches into the window
            let seen = f64::from(half) * 1.5 + 3.0 * p[BLUR];
            let next_px = [(next[0], longer[0]), (next[1], longer[1])]
                .map(|(l, d)| (l < seen).then_some([l - d, l + d].map(|l| l as f32)));
            self.equations(&CornerModel::new(&p, next_px), near, &mut normal);
            let free = (self.window.count() as f64 - COUNT as f64).max(1.0);
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
            // of the edges at the window's end, and of their width
            let turned = f64::from(half) * delta[TURN_U].abs().max(delta[TURN_V].abs());
            // twice for the width, by which the stated deviations go, too
            changed_px = size.max(turned).max(2.0 * delta[BLUR].abs());
            let px = Vector2::new(p[X] + middle[0], p[Y] + middle[1]);
            if !((px - guess.px).norm() <= reach_px) {
                return None;
            }
            let last_px = if near { LAST_NEAR_STEP_PX } else { LAST_STEP_PX };
            if size < last_px && step > 0 {
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

    /// The equations of the model. `near`: with the derivatives that were computed last, which hardly differ.
    fn equations(&mut self, model: &CornerModel, near: bool, out: &mut CornerEquations) {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                self.equations_avx2(model, near, out);
            }
            return;
        }
        self.equations_with(model, near, out);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn equations_avx2(&mut self, model: &CornerModel, near: bool, out: &mut CornerEquations) {
        self.equations_with(model, near, out);
    }

    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // matrix indices read better
    fn equations_with(&mut self, model: &CornerModel, near: bool, out: &mut CornerEquations) {
        let pixels = self.window.blocks();
        let Some(rows) = self.rows.get_mut(..pixels.len()) else { return };
        if near {
            for (pixels, row) in pixels.iter().zip(rows.iter_mut()) {
                row[RESIDUAL] = model.at(pixels)[RESIDUAL];
            }
        } else {
            for (pixels, row) in pixels.iter().zip(rows.iter_mut()) {
                *row = model.at(pixels);
            }
        }
        // one sum in a loop, of columns known to be some: compilers make vectors of that
        let mut products = [[0.0; COUNT + 1]; COUNT + 1];
        for i in (if near { RESIDUAL } else { 0 })..=RESIDUAL {
            for k in 0..=i {
                let mut sum = Eight::ZERO;
                for row in &*rows {
                    sum = sum + row[i] * row[k];
                }
                products[i][k] = f64::from(sum.sum());
            }
        }
        if !near {
            for i in 0..COUNT {
                for k in 0..=i {
                    (out.matrix[i][k], out.matrix[k][i]) = (products[i][k], products[i][k]);
                }
            }
        }
        out.right.copy_from_slice(&products[RESIDUAL][..COUNT]);
        out.squares = products[RESIDUAL][RESIDUAL];
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
mod window;
