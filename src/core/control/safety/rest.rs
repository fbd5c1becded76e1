//! Standstill detection: over 100 ticks no joint moves faster than a small speed, by its positions and by the mean of
//! its measured velocities, except for what the noise of the encoders explains. An oscillating arm is not at rest.
//!
//! The numbers here were chosen by hand, except for the quantiles of noise. The tests below bound them with arms that stand, with coarse
//! and noisy encoders, and with arms that move at 0.03 rad/s or oscillate.

use crate::drive::DriveState;
use crate::time::TICK;
use nalgebra::SVector;

/// An arm slower than this is at rest, rad/s or m/s.
pub(in crate::control) const REST_SPEED: f64 = 0.02;
/// Ticks over which its speed is judged.
const WINDOW: usize = 100;
/// Share of that speed that is allowed at the end of the window: the arm may gain speed until the last command acts.
const SLOWING_SHARE: f64 = 0.5;
/// Share of that speed that is allowed between the means of the first and the last third of the window, which contain little noise.
const DRIFT_SHARE: f64 = 0.6;
const PART: usize = WINDOW / 3;
/// The difference of two such means is allowed so many of its standard deviations: by noise alone it exceeds 4 once in 16 000 cases.
const MEAN_SPREAD: f64 = 4.0;
/// Ticks at the end of the window that are judged by themselves.
const LAST: usize = 4;
/// The range of 100 readings is allowed so many standard deviations of a reading: for normal noise its mean is 5.0 and its standard
/// deviation 0.6.
const NOISE_SPREAD: f64 = 6.0;

/// The last joint states, and whether the arm moved in them.
#[derive(Debug, Clone)]
pub struct RestWatch<const N: usize> {
    q: [SVector<f64, N>; WINDOW],
    qd: [SVector<f64, N>; WINDOW],
    /// Where the next state goes; `None` before the first.
    next: Option<usize>,
}

impl<const N: usize> Default for RestWatch<N> {
    fn default() -> Self {
        Self { q: [SVector::zeros(); WINDOW], qd: [SVector::zeros(); WINDOW], next: None }
    }
}

impl<const N: usize> RestWatch<N> {
    /// Takes in the measured state of a tick.
    pub fn note(&mut self, state: &DriveState<N>) {
        // The arm is assumed to have been in the first state before.
        let Some(next) = self.next else {
            (self.q, self.qd, self.next) = ([state.q; WINDOW], [state.qd; WINDOW], Some(1));
            return;
        };
        if let (Some(q), Some(qd)) = (self.q.get_mut(next), self.qd.get_mut(next)) {
            (*q, *qd) = (state.q, state.qd);
        }
        self.next = Some((next + 1) % WINDOW);
    }

    /// Whether the arm has stood for 100 ms.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let window_s = WINDOW as f64 * TICK.as_s();
        let (least, most, mean_speed) = self.extent();
        let sd = self.noise_sd();
        let apart = self.mean_position(WINDOW - PART) - self.mean_position(0);
        let apart_s = (WINDOW - PART) as f64 * TICK.as_s();
        // An oscillating joint can have a small mean velocity: the velocity at the end must be small too.
        let end = Self::sum(self.states(&self.qd).skip(WINDOW - LAST)) / LAST as f64;
        let end_s = LAST as f64 * TICK.as_s();
        (0..N).all(|i| {
            let noise = NOISE_SPREAD * sd[i];
            let noise_of_means = MEAN_SPREAD * sd[i] * (2.0 / PART as f64).sqrt();
            most[i] - least[i] <= REST_SPEED * window_s + noise
                && apart[i].abs() <= DRIFT_SHARE * REST_SPEED * apart_s + noise_of_means
                && mean_speed[i].abs() <= REST_SPEED + noise / window_s
                && end[i].abs() <= SLOWING_SHARE * REST_SPEED + noise / end_s
        })
    }

    /// Least and greatest position in the window, and the mean of the measured velocities.
    fn extent(&self) -> (SVector<f64, N>, SVector<f64, N>, SVector<f64, N>) {
        let mut least: SVector<f64, N> = SVector::repeat(f64::INFINITY);
        let mut most: SVector<f64, N> = SVector::repeat(f64::NEG_INFINITY);
        for q in &self.q {
            (least, most) = (least.inf(q), most.sup(q));
        }
        (least, most, Self::sum(self.qd.iter()) / WINDOW as f64)
    }

    /// The window's states, the oldest first.
    fn states<'a>(&self, states: &'a [SVector<f64, N>; WINDOW]) -> impl Iterator<Item = &'a SVector<f64, N>> {
        let (newer, older) = states.split_at(self.next.unwrap_or(0));
        older.iter().chain(newer)
    }

    fn sum<'a>(states: impl Iterator<Item = &'a SVector<f64, N>>) -> SVector<f64, N> {
        states.fold(SVector::zeros(), |sum, state| sum + state)
    }

    /// Mean position over a third of the window, from its `from`-th state on.
    fn mean_position(&self, from: usize) -> SVector<f64, N> {
        Self::sum(self.states(&self.q).skip(from).take(PART)) / PART as f64
    }

    /// Standard deviation of the noise of each joint's encoder, from the second differences of its positions, whose variance is
    /// `(1 + 4 + 1)` times that of a reading. Those of the arm's motion, `qdd T^2`, are far smaller.
    fn noise_sd(&self) -> SVector<f64, N> {
        let mut squares = SVector::<f64, N>::zeros();
        let mut before = [SVector::<f64, N>::zeros(); 2];
        for (k, q) in self.states(&self.q).enumerate() {
            let difference = q - before[1] * 2.0 + before[0];
            if k >= before.len() {
                squares += difference.component_mul(&difference);
            }
            before = [before[1], *q];
        }
        squares.map(|squares| (squares / (6.0 * (WINDOW - 2) as f64)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    fn state(q: f64, qd: f64) -> DriveState<2> {
        DriveState { q: Vector2::new(q, 0.5), qd: Vector2::new(qd, 0.0), truth: None }
    }

    /// Whether the arm stands after the states of `states`.
    fn rests(states: impl Iterator<Item = DriveState<2>>) -> bool {
        let mut watch = RestWatch::default();
        states.for_each(|state| watch.note(&state));
        watch.is_at_rest()
    }

    #[test]
    fn an_arm_that_stood_from_the_first_state_on_is_at_rest_at_once() {
        assert!(rests([state(0.1, 0.0)].into_iter()));
    }

    #[test]
    fn a_moving_arm_is_at_rest_one_window_after_it_stops() {
        // Moves at 0.3 rad/s for 100 ticks, then stands.
        let at = |k: i32| state(0.1 + 0.3e-3 * f64::from(k.min(100)), if k < 100 { 0.3 } else { 0.0 });
        let first = (10..500).find(|last| rests((0..*last).map(at))).unwrap();
        assert!((100..=100 + WINDOW as i32 + 1).contains(&first), "{first}");
    }

    #[test]
    fn steps_and_noise_of_encoders_are_no_motion() {
        let flips = |k: usize| if k.is_multiple_of(2) { state(0.0, 0.2) } else { state(5e-4, -0.2) };
        assert!(rests((0..2 * WINDOW).map(flips)));
    }

    #[test]
    fn a_noisy_encoder_does_not_hide_a_motion_nor_make_one() {
        for (speed, at_rest) in [(0.0, true), (0.1, false)] {
            let mut random = Random::new(7);
            let noisy = (0..4 * WINDOW).map(|k| {
                let noise = 1e-3 * random.gaussian();
                state(speed * 1e-3 * k as f64 + noise, speed + 300.0 * noise)
            });
            assert_eq!(rests(noisy), at_rest, "{speed}");
        }
    }

    #[test]
    fn a_coarse_encoder_does_not_hide_a_slow_motion() {
        for (speed, at_rest) in [(0.0, true), (0.03, false), (0.05, false)] {
            let mut random = Random::new(3);
            let coarse = (0..4 * WINDOW).map(|k| {
                let q = speed * 1e-3 * k as f64 + 8e-5 * random.gaussian();
                state((q / 4.6e-4).round() * 4.6e-4, 0.0)
            });
            assert_eq!(rests(coarse), at_rest, "{speed}");
        }
    }

    /// Slower than what the range of the positions allows, and faster than its means may go.
    #[test]
    fn a_slow_drift_under_little_noise_is_a_motion() {
        for (speed, at_rest) in [(0.008, true), (0.016, false)] {
            let mut random = Random::new(5);
            let drift =
                (0..4 * WINDOW).map(|k| state(speed * 1e-3 * k as f64 + 2e-5 * random.gaussian(), 0.0));
            assert_eq!(rests(drift), at_rest, "{speed}");
        }
    }

    /// Second differences of readings that alternate by `2 x` are all `4 x`.
    #[test]
    fn noise_is_told_from_second_differences() {
        let mut watch = RestWatch::default();
        (0..WINDOW).for_each(|k| watch.note(&state(if k.is_multiple_of(2) { 1e-3 } else { -1e-3 }, 0.0)));
        let sd = watch.noise_sd();
        assert!((sd[0] - 1e-3 * (16.0_f64 / 6.0).sqrt()).abs() < 1e-12 && sd[1] == 0.0, "{sd}");
    }

    /// An arm that begins to move at the end of the window: its last four velocities count by themselves.
    #[test]
    fn an_arm_that_begins_to_move_is_not_at_rest() {
        for (speed, at_rest) in [(0.009, true), (0.011, false), (-0.011, false)] {
            let late = |k: usize| state(0.1, if k < 3 * WINDOW - LAST { 0.0 } else { speed });
            assert_eq!(rests((0..3 * WINDOW).map(late)), at_rest, "{speed}");
        }
        let just_before = |k: usize| state(0.1, if k == 3 * WINDOW - LAST - 1 { 0.1 } else { 0.0 });
        assert!(rests((0..3 * WINDOW).map(just_before)), "the one before them does not");
    }

    /// Noise allows as much more as it makes of means: of 33 positions little, and nothing beyond.
    #[test]
    fn noise_excuses_what_it_explains_and_no_more() {
        let noisy = |sd: f64, drift: f64, qd: f64| {
            let mut random = Random::new(11);
            rests((0..4 * WINDOW).map(|k| state(drift * 1e-3 * k as f64 + sd * random.gaussian(), qd)))
        };
        assert!(!noisy(2e-4, 0.019, 0.0), "a drift of 1.3 mm between means of 0.05 mm");
        // Positions that are off by 0.1 mm make a mean velocity of 6 mm/s over the window, at six standard deviations.
        assert!(noisy(1e-4, 0.0, 0.023) && !noisy(1e-4, 0.0, 0.03));
    }

    #[test]
    fn an_arm_that_swings_or_reports_a_velocity_is_not_at_rest() {
        assert!(!rests((0..2100).map(|k| state(0.01 * (30.0 * f64::from(k) * 1e-3).sin(), 0.0))));
        assert!(!rests((0..2100).map(|_| state(0.0, 0.3))));
        // Three periods in a third of the window: its means tell nothing, and no velocity is reported.
        let period = PART as f64 / 3.0;
        let swing = |k: i32| 5e-3 * (std::f64::consts::TAU * f64::from(k) / period).sin();
        assert!(!rests((0..2100).map(|k| state(swing(k), 0.0))));
    }
}
