//! Whether the mean of the feature error meets the goal, where single measurements scatter beyond it.
//!
//! Of `n` measurements in a row with the errors `e_k` of `p` points, px, mean `m` and scatter `S = sum |e_k - m|^2 / (n - 1) / p`:
//!
//! | the goal is met when | because |
//! | --- | --- |
//! | `abs(m) / sqrt(p) + q sqrt(S / n)` is within the tolerance | `q^2` is the 99 % quantile of chi-square over its `2 p` degrees of freedom: the mean of the true error lies within the tolerance, too |
//! | the means of the older and of the newer half of the measurements are within the tolerance of each other | an error that passes through the goal, or creeps away from it, has a mean there, too |
//! | `S - N` is within twice the tolerance, squared | `N` is the noise of the measurements: what else scatters is the arm, which trembles within what a goal that was reached allows |
//! | `S - D` is within the tolerance, squared, but for chance | `D` is half of the mean square of the differences of successive measurements: what changes more slowly than from one to the next is an arm that swings |
//!
//! `N` is the lesser of what vision states and of `D`, because vision may state more where lens or target are not as described. The measurements are those of the last `t` seconds, for any `t` from twice the time of holding on, as far back as the sums reach: the
//! more noise, the longer. They are summed in blocks, the older half of which becomes coarser as they fill.

use crate::messages::MAX_FEATURES;
use crate::servo::{SetPoint, View};
use crate::time::{MonoNs, SpanNs};
use nalgebra::Vector2;

/// Blocks of sums. Chosen by hand: when they are full, pairs become one, so that windows differ by a sixteenth in length at most, and the sums take 34 kB.
const BLOCKS: usize = 32;
/// Measurements in a row that a mean needs at least. Derived: of four points they leave 72 degrees of freedom, which tell the scatter to 17 %.
const FEWEST: u32 = 10;
/// Standard normal quantile of the confidence, 99 %.
const QUANTILE: f64 = 2.326;
/// A goal that was reached counts as left when the error exceeds its tolerance so many times, and what is left of scatter without the noise may be as much. Chosen by hand: with 1, an error that
/// noise keeps about the tolerance would be reported at every measurement; with more, an arm that was pushed away would be reported late.
pub(super) const LEFT_AT: f64 = 2.0;

/// Standard deviations by which noise may look like a swing. Derived: 2 % of the windows of mere noise exceed two.
const SWING_SDS: f64 = 2.0;

/// Sums over measurements in a row, px and px^2.
#[derive(Debug, Clone, Copy)]
struct ErrorSums {
    count: u32,
    /// Of the errors, point by point.
    errors: [Vector2<f64>; MAX_FEATURES],
    /// Of their squared norms, of those of the differences of successive ones, and of the variances that vision states, over all points.
    squares: f64,
    differences: f64,
    stated: f64,
    /// When the first one came.
    since: MonoNs,
}

impl ErrorSums {
    const NONE: Self = Self {
        count: 0,
        errors: [Vector2::new(0.0, 0.0); MAX_FEATURES],
        squares: 0.0,
        differences: 0.0,
        stated: 0.0,
        since: MonoNs::ZERO,
    };

    /// Adds sums over what came before.
    fn add_earlier(&mut self, earlier: &Self) {
        self.count += earlier.count;
        for (sum, other) in self.errors.iter_mut().zip(&earlier.errors) {
            *sum += other;
        }
        self.squares += earlier.squares;
        self.differences += earlier.differences;
        self.stated += earlier.stated;
        self.since = earlier.since;
    }

    /// Mean square distance, px^2, over `points` points, between the mean of those of these errors that are in `newer` and the mean of the others.
    fn halves_apart_px2(&self, newer: &Self, points: f64) -> f64 {
        let (n, m) = (f64::from(newer.count), f64::from(self.count - newer.count));
        let sums = self.errors.iter().zip(&newer.errors);
        sums.map(|(all, new)| (new / n - (all - new) / m).norm_squared()).sum::<f64>() / points
    }

    /// The scatter, px^2, of errors of `points` points whose mean meets a goal within `tolerance_px`; `None` where it does not.
    fn scatter_that_meets(&self, tolerance_px: f64, points: f64) -> Option<f64> {
        let n = f64::from(self.count);
        let mean = self.errors.iter().map(Vector2::norm_squared).sum::<f64>() / (n * n * points);
        let scatter = (self.squares / (n * points) - mean).max(0.0) * n / (n - 1.0);
        let quick = self.differences / (2.0 * n * points);
        let noise = (self.stated / (n * points)).min(quick);
        let surely_px = mean.sqrt() + (chi_square_over_freedom(2.0 * points) * scatter / n).sqrt();
        let trembles = scatter - noise > (LEFT_AT * tolerance_px).powi(2);
        // Of noise the difference of the two has this standard deviation, and no mean.
        let chance = scatter * (3.0 / (2.0 * points * n)).sqrt();
        let swings = scatter - quick - SWING_SDS * chance > tolerance_px * tolerance_px;
        (surely_px <= tolerance_px && !trembles && !swings).then_some(scatter)
    }
}

/// The 99 % quantile of chi-square of so many degrees of `freedom`, over them, by the approximation of Wilson and Hilferty (within 1 % from two on).
fn chi_square_over_freedom(freedom: f64) -> f64 {
    let variance = 2.0 / (9.0 * freedom);
    (1.0 - variance + QUANTILE * variance.sqrt()).powi(3)
}

/// A goal that is met in the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MetInMean {
    /// Since when.
    pub(super) since: MonoNs,
    /// Mean square by which single errors scatter, px^2.
    pub(super) scatter_px2: f64,
}

/// Errors of the measurements in a row that are of the same points.
#[derive(Debug, Clone)]
pub(super) struct GoalMean {
    /// Sums, the oldest first; the last one is open.
    blocks: [ErrorSums; BLOCKS],
    used: usize,
    /// Measurements in a full block.
    length: u32,
    /// The last error of each point, px, NaN where it is hidden.
    last: [Vector2<f64>; MAX_FEATURES],
    points: usize,
}

impl Default for GoalMean {
    fn default() -> Self {
        let last = [Vector2::repeat(f64::NAN); MAX_FEATURES];
        Self { blocks: [ErrorSums::NONE; BLOCKS], used: 0, length: 1, last, points: 0 }
    }
}

impl GoalMean {
    /// What came before counts no more.
    pub(super) fn begin_anew(&mut self) {
        (self.used, self.length, self.points) = (0, 1, 0);
    }

    /// Takes in the errors of a `view` at `now` against `set_point`, by a lens of focal lengths `f_px`; `stated_px2` is the variance of a point's place, both coordinates
    /// together, that vision states. A view of other points begins anew.
    pub(super) fn note(
        &mut self,
        now: MonoNs,
        view: &View,
        (set_point, f_px): (&SetPoint, &Vector2<f64>),
        stated_px2: f64,
    ) {
        let mut errors = [Vector2::repeat(f64::NAN); MAX_FEATURES];
        let mut points = 0;
        for ((error, s), s_d) in errors.iter_mut().zip(view.features()).zip(set_point.features()) {
            *error = (s_d - s).component_mul(f_px);
            points += usize::from(!error.x.is_nan());
        }
        let same = errors.iter().zip(&self.last).all(|(a, b)| a.x.is_nan() == b.x.is_nan());
        if !same || points != self.points {
            self.begin_anew();
        }
        let is_first = self.used == 0;
        (self.points, self.last, errors) = (points, errors, self.last);
        let before = errors;
        let length = self.length;
        let is_full = self.blocks[..self.used].last().is_none_or(|block| block.count >= length);
        if is_full {
            self.open(now);
        }
        let Some(block) = self.blocks[..self.used].last_mut() else { return };
        for ((sum, error), before) in block.errors.iter_mut().zip(&self.last).zip(&before) {
            if !error.x.is_nan() {
                *sum += error;
                block.squares += error.norm_squared();
                block.differences += if is_first { 0.0 } else { (error - before).norm_squared() };
            }
        }
        block.count += 1;
        block.stated += stated_px2 * points as f64;
    }

    /// Opens a block, for which pairs of full ones become one where all are in use.
    fn open(&mut self, now: MonoNs) {
        if self.used == BLOCKS {
            for k in 0..BLOCKS / 2 {
                let mut pair = self.blocks[2 * k + 1];
                pair.add_earlier(&self.blocks[2 * k]);
                self.blocks[k] = pair;
            }
            (self.used, self.length) = (BLOCKS / 2, 2 * self.length);
        }
        self.blocks[self.used] = ErrorSums { since: now, ..ErrorSums::NONE };
        self.used += 1;
    }

    /// Since when the mean has met a goal within `tolerance_px`, if it does for twice the time `hold` or more.
    pub(super) fn met(&self, now: MonoNs, tolerance_px: f64, hold: SpanNs) -> Option<MetInMean> {
        let mut sums = ErrorSums::NONE;
        for (k, block) in self.blocks[..self.used].iter().rev().enumerate() {
            sums.add_earlier(block);
            if sums.count < FEWEST || now - sums.since < SpanNs(2 * hold.0) {
                continue;
            }
            let points = self.points as f64;
            let met = sums.scatter_that_meets(tolerance_px, points);
            let is_steady = || {
                let mut newer = ErrorSums::NONE;
                self.blocks[..self.used]
                    .iter()
                    .rev()
                    .take(k.div_ceil(2))
                    .for_each(|block| newer.add_earlier(block));
                sums.halves_apart_px2(&newer, points) <= tolerance_px * tolerance_px
            };
            if let Some(scatter_px2) = met.filter(|_| is_steady()) {
                return Some(MetInMean { since: sums.since, scatter_px2 });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::linalg::Random;
    use nalgebra::Point3;

    const F_PX: Vector2<f64> = Vector2::new(800.0, 800.0);
    const HOLD: SpanNs = SpanNs(500_000_000);
    /// As in the shipped run files.
    const TOLERANCE_PX: f64 = 0.05;

    fn set_point() -> SetPoint {
        let square = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]].map(|[x, y]| Point3::new(x, y, 0.0));
        SetPoint::from_pose(&Pose::translation(-0.05, -0.05, 0.4), &square).unwrap()
    }

    /// A number that is nearly Gaussian, of the standard deviation 1.
    fn gauss(random: &mut Random) -> f64 {
        (0..12).map(|_| random.between(-0.5, 0.5)).sum()
    }

    /// When errors of `true_px(t)` in both coordinates of each point, with noise of `sd_px`, meet the goal within `until_s`, s; vision states `stated_px`.
    fn met_s(
        seed: u64,
        true_px: impl Fn(f64) -> f64,
        sd_px: f64,
        stated_px: f64,
        until_s: f64,
    ) -> Option<f64> {
        let (set_point, mut mean, mut random) = (set_point(), GoalMean::default(), Random::new(seed));
        for k in 0..(until_s * 25.0) as i64 {
            let (now, t) = (MonoNs(k * 40_000_000), 0.04 * k as f64);
            let error = |random: &mut Random| (true_px(t) + sd_px * gauss(random)) / 800.0;
            let seen: Vec<_> = set_point
                .features()
                .iter()
                .map(|s| s + Vector2::new(error(&mut random), error(&mut random)))
                .collect();
            let view = View::new(seen.into_iter(), None).unwrap();
            mean.note(now, &view, (&set_point, &F_PX), 2.0 * stated_px * stated_px);
            if mean.met(now, TOLERANCE_PX, HOLD).is_some() {
                return Some(t);
            }
        }
        None
    }

    #[test]
    fn a_goal_within_noise_is_met_the_later_the_more_noise_there_is() {
        for (sd_px, from_s, until_s) in
            [(0.001, 1.0, 1.1), (0.05, 1.0, 1.5), (0.2, 2.0, 12.0), (0.6, 15.0, 120.0)]
        {
            for seed in 0..10 {
                let at = met_s(seed, |_| 0.0, sd_px, sd_px, 200.0).unwrap();
                assert!((from_s - 0.05..until_s).contains(&at), "{sd_px} px, {seed}: {at} s");
            }
        }
    }

    /// An error of 1.2 tolerances, root mean square over points: noise seldom lets it seem a goal, though it is asked at each measurement.
    #[test]
    fn an_error_beyond_the_tolerance_is_no_goal() {
        let each_px = 1.2 * TOLERANCE_PX / 2.0_f64.sqrt();
        for sd_px in [0.0, 0.02, 0.1, 0.3] {
            let met =
                (0..200).filter(|seed| met_s(1000 + seed, |_| each_px, sd_px, sd_px, 20.0).is_some()).count();
            assert!(met <= 2, "{sd_px} px: {met} of 200");
        }
    }

    #[test]
    fn an_arm_that_swings_about_its_goal_has_not_met_it() {
        let swings = |hz: f64| move |t: f64| 0.15 * (std::f64::consts::TAU * hz * t).sin();
        for hz in [0.3, 1.0, 4.0] {
            assert_eq!(met_s(1, swings(hz), 0.02, 0.02, 20.0), None, "{hz} Hz");
            assert_eq!(met_s(1, swings(hz), 0.02, 5.0, 20.0), None, "{hz} Hz, and vision states too much");
        }
        // Twelve times in a second it looks like noise, but for what vision states.
        assert_eq!(met_s(1, swings(12.0), 0.02, 0.02, 20.0), None);
        assert!(met_s(1, swings(1.0), 0.2, 0.2, 60.0).is_none_or(|t| t > 8.0));
    }

    #[test]
    fn an_error_that_passes_through_the_goal_is_seen_not_to_stay() {
        for (speed_px_s, sd_px) in [(0.02, 0.001), (0.05, 0.001), (0.05, 0.05), (0.1, 0.02), (0.2, 0.1)] {
            for seed in 0..20 {
                let passes = |t: f64| speed_px_s * (t - 10.0);
                if let Some(at) = met_s(seed, passes, sd_px, sd_px, 20.0) {
                    let error_px = 2.0_f64.sqrt() * passes(at).abs();
                    assert!(
                        error_px <= 1.5 * TOLERANCE_PX,
                        "{speed_px_s} px/s, {sd_px} px: {error_px} px at {at} s"
                    );
                }
            }
        }
    }

    #[test]
    fn an_error_that_falls_is_met_by_each_measurement_first() {
        for rate_1_s in [2.0, 5.0, 15.0] {
            let falls = |t: f64| 2.0 * f64::exp(-rate_1_s * t);
            let within_s = f64::ln(2.0 * 2.0_f64.sqrt() / TOLERANCE_PX) / rate_1_s;
            let at = met_s(1, falls, 0.005, 0.005, 20.0).unwrap();
            assert!(at > within_s + HOLD.as_s(), "{rate_1_s}: {at}, each measurement from {within_s} s on");
        }
    }

    #[test]
    fn other_points_and_a_new_beginning_forget_what_was() {
        let (set_point, mut mean) = (set_point(), GoalMean::default());
        let whole = View::new(set_point.features().to_vec().into_iter(), None).unwrap();
        let at = |k: i64| MonoNs(k * 40_000_000);
        (0..40).for_each(|k| mean.note(at(k), &whole, (&set_point, &F_PX), 1e-4));
        let met = mean.met(at(39), TOLERANCE_PX, HOLD).unwrap();
        assert!(met.scatter_px2 < 1e-20 && at(39) - met.since >= SpanNs(2 * HOLD.0), "{met:?}");
        assert!(mean.met(at(39), TOLERANCE_PX, SpanNs(1_000_000_000)).is_none(), "not for two seconds");
        mean.begin_anew();
        assert!(mean.met(at(39), TOLERANCE_PX, HOLD).is_none());
        // 2 ^ k measurements, and all of them count
        (0..1000).for_each(|k| mean.note(at(k), &whole, (&set_point, &F_PX), 1e-4));
        let counted: u32 = mean.blocks[..mean.used].iter().map(|block| block.count).sum();
        assert_eq!(counted, 1000);
    }

    #[test]
    fn the_quantile_is_that_of_tables() {
        for (freedom, quantile) in [(2.0, 9.21), (8.0, 20.09), (30.0, 50.89), (100.0, 135.81)] {
            let ours: f64 = chi_square_over_freedom(freedom) * freedom;
            assert!((ours / quantile - 1.0).abs() < 0.01, "{freedom}: {ours}");
        }
    }
}
