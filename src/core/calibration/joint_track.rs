//! The joints over a whole calibration: position and velocity at any time of it.

use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// All states of `N` joints, in the order of time. Unlike `JointHistory`, which is bounded for the real-time thread, it
/// grows, and is smooth in time.
#[derive(Debug, Clone, Default)]
pub struct JointTrack<const N: usize> {
    states: Vec<StampedJoints<N>>,
}

#[derive(Debug, Clone, Copy)]
struct StampedJoints<const N: usize> {
    stamp: MonoNs,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
}

impl<const N: usize> JointTrack<N> {
    /// Appends a state, rad or m and per second; one that is not newer than the last is left out.
    pub fn push(&mut self, stamp: MonoNs, q: SVector<f64, N>, qd: SVector<f64, N>) {
        if self.states.last().is_none_or(|last| stamp > last.stamp) {
            self.states.push(StampedJoints { stamp, q, qd });
        }
    }

    /// How many states there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.states.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.states.is_empty()
    }

    /// Leaves out all but the newest `count` states.
    pub fn keep_newest(&mut self, count: usize) {
        self.states.drain(..self.states.len().saturating_sub(count));
    }

    /// Positions and velocities `offset_s` after `stamp`, by cubic Hermite interpolation between the neighbouring states.
    /// Before the first and after the last state the arm stands; `None` without any state.
    #[must_use]
    pub fn at(&self, stamp: MonoNs, offset_s: f64) -> Option<(SVector<f64, N>, SVector<f64, N>)> {
        let until_s = |state: &StampedJoints<N>| (state.stamp - stamp).as_s() - offset_s;
        let after = self.states.partition_point(|state| until_s(state) <= 0.0);
        let (a, b) = match (after.checked_sub(1).and_then(|i| self.states.get(i)), self.states.get(after)) {
            (Some(a), Some(b)) => (a, b),
            (Some(end), None) | (None, Some(end)) => return Some((end.q, SVector::zeros())),
            (None, None) => return None,
        };
        let span: SpanNs = b.stamp - a.stamp;
        let h = span.as_s();
        let u = -until_s(a) / h;
        let (way, v) = (1.0 - u, b.q - a.q);
        // Hermite in the form a + u v + u (1 - u) (...), which keeps its digits.
        let (start, end) = (a.qd * h - v, b.qd * h - v);
        let bend = start * way - end * u;
        let q = a.q + v * u + bend * (u * way);
        let qd = (v + bend * (1.0 - 2.0 * u) - (start + end) * (u * way)) / h;
        Some((q, qd))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn motion(t: f64) -> (Vector2<f64>, Vector2<f64>) {
        (Vector2::new((5.0 * t).sin(), t * t * t - t), Vector2::new(5.0 * (5.0 * t).cos(), 3.0 * t * t - 1.0))
    }

    fn track(step_ms: i64) -> JointTrack<2> {
        let mut track = JointTrack::default();
        for k in 0..=(1000 / step_ms) {
            let stamp = MonoNs(k * step_ms * 1_000_000);
            let (q, qd) = motion(stamp.0 as f64 * 1e-9);
            track.push(stamp, q, qd);
        }
        track
    }

    proptest! {
        #[test]
        fn a_smooth_motion_is_found_between_its_states(at_ms in 1.0..999.0f64, offset_s in -0.2..0.2f64) {
            let t = at_ms * 1e-3 + offset_s;
            prop_assume!((0.0..1.0).contains(&t));
            let (q, qd) = motion(t);
            for (step_ms, close, close_qd) in [(1, 1e-8, 1e-6), (20, 1e-5, 2e-3)] {
                let (got, got_qd) = track(step_ms).at(MonoNs((at_ms * 1e6) as i64), offset_s).unwrap();
                prop_assert!((got - q).norm() < close, "{got} {q}");
                prop_assert!((got_qd - qd).norm() < close_qd, "{got_qd} {qd}");
                prop_assert!((got[1] - q[1]).abs() < 1e-8, "a cubic is exact, but for the rounding of the stamp");
            }
        }
    }

    #[test]
    fn outside_of_its_states_the_arm_stands() {
        let track = track(10);
        let (q, qd) = track.at(MonoNs(0), -0.1).unwrap();
        assert_eq!((q, qd), (motion(0.0).0, Vector2::zeros()));
        let (q, qd) = track.at(MonoNs(1_000_000_000), 0.1).unwrap();
        assert_eq!((q, qd), (motion(1.0).0, Vector2::zeros()));
        assert!(JointTrack::<2>::default().at(MonoNs(0), 0.0).is_none());
    }

    #[test]
    fn repeated_states_are_left_out_and_old_ones_forgotten() {
        let mut track = track(10);
        let all = track.len();
        track.push(MonoNs(5), Vector2::zeros(), Vector2::zeros());
        assert_eq!(track.len(), all);
        track.keep_newest(2);
        assert_eq!(track.len(), 2);
        assert!((track.at(MonoNs(0), 0.0).unwrap().0 - motion(0.99).0).norm() < 1e-12);
    }
}
