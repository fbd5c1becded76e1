//! Faults of a simulated arm: what its encoders report, and what its motors do.

use super::FaultWindow;
use crate::linalg::Random;
use crate::time::{SpanNs, TICK};
use nalgebra::SVector;

/// What is wrong with a joint, or with the states of the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointFault {
    /// Its encoder is off by so much, rad or m, one way or the other by chance; the speed that is reported is not.
    Spike(f64),
    /// Its encoder stays where it was, and reports no speed.
    Freeze,
    /// Its encoder is off by so much, rad or m.
    Offset(f64),
    /// Its motor lacks this share of its torque or force.
    TorqueLoss(f64),
    /// The state of the whole arm is the one before once more.
    StaleState,
    /// Commands do not come to the arm: it does what it was told before.
    LostCommand,
}

/// Faults of an arm of `N` joints.
#[derive(Debug, Clone)]
pub struct JointFaults<const N: usize> {
    list: Vec<(JointFault, usize, FaultWindow)>,
    /// Positions and speeds that were reported last.
    last: Option<(SVector<f64, N>, SVector<f64, N>)>,
}

impl<const N: usize> JointFaults<N> {
    /// Those of `list`, drawn by `seed`.
    #[must_use]
    pub fn new(list: &[(JointFault, usize, FaultWindow)], seed: u64) -> Self {
        let seeded = |(i, (fault, joint, window)): (u64, &(_, usize, FaultWindow))| {
            (*fault, *joint, window.seeded(seed.rotate_left(32), i))
        };
        Self { list: (0..).zip(list).map(seeded).collect(), last: None }
    }

    /// What acts at `time` since the first state, with its joint.
    fn acting(&self, time: SpanNs) -> impl Iterator<Item = (JointFault, usize, Random)> {
        // A drive is read near to the beginning of each tick.
        let tick = time.0.saturating_add(TICK.0 / 2).div_euclid(TICK.0).unsigned_abs();
        let acts = move |(_, joint, window): &&(_, usize, FaultWindow)| *joint < N && window.acts(time, tick);
        self.list.iter().filter(acts).map(move |(fault, joint, window)| {
            let mut random = window.random(tick);
            random.bits(); // which has said whether it acts
            (*fault, *joint, random)
        })
    }

    /// What is reported at `time` in place of the positions `q` and speeds `qd` of the encoders.
    pub fn reported(
        &mut self,
        time: SpanNs,
        (q, qd): (SVector<f64, N>, SVector<f64, N>),
    ) -> (SVector<f64, N>, SVector<f64, N>) {
        if self.list.is_empty() {
            return (q, qd);
        }
        let (q_before, qd_before) = self.last.unwrap_or((q, qd));
        let (mut q, mut qd) = (q, qd);
        let mut is_stale = false;
        // A spike is of one reading: what is frozen or stale afterwards is what it would have been without.
        let mut spikes = SVector::<f64, N>::zeros();
        for (fault, j, mut random) in self.acting(time) {
            match fault {
                JointFault::Spike(size) => spikes[j] += if random.bits() & 1 == 0 { size } else { -size },
                JointFault::Freeze => (q[j], qd[j]) = (q_before[j], 0.0),
                JointFault::Offset(size) => q[j] += size,
                JointFault::StaleState => is_stale = true,
                JointFault::TorqueLoss(_) | JointFault::LostCommand => {}
            }
        }
        if is_stale {
            (q, qd) = (q_before, qd_before);
        }
        self.last = Some((q, qd));
        (q + spikes, qd)
    }

    /// Whether a command that comes at `time` is lost.
    #[must_use]
    pub fn loses_command(&self, time: SpanNs) -> bool {
        self.acting(time).any(|(fault, ..)| fault == JointFault::LostCommand)
    }

    /// Takes from the torques or forces `tau` what motors lack at `time`.
    pub fn weaken(&self, time: SpanNs, tau: &mut SVector<f64, N>) {
        for (fault, j, _) in self.acting(time) {
            if let JointFault::TorqueLoss(share) = fault {
                tau[j] *= 1.0 - share;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    fn state(ms: i64) -> (Vector2<f64>, Vector2<f64>) {
        (Vector2::new(1e-3 * ms as f64, -2e-3 * ms as f64), Vector2::new(1.0, -2.0))
    }

    /// States of 10 ms with a fault of joint 1 from 4 ms to 6 ms.
    fn reported(fault: JointFault, probability: f64) -> Vec<(Vector2<f64>, Vector2<f64>)> {
        let window = FaultWindow { from: SpanNs(4_000_000), until: SpanNs(7_000_000), probability, seed: 0 };
        let mut faults = JointFaults::<2>::new(&[(fault, 1, window)], 1);
        (0..10).map(|ms| faults.reported(SpanNs(1_000_000 * ms), state(ms))).collect()
    }

    #[test]
    fn faults_of_encoders_act_in_their_time_alone() {
        for fault in
            [JointFault::Spike(0.5), JointFault::Freeze, JointFault::Offset(0.5), JointFault::StaleState]
        {
            for (ms, seen) in (0..).zip(reported(fault, 1.0)) {
                assert_eq!(seen == state(ms), !(4..7).contains(&ms), "{fault:?} at {ms} ms");
                assert!(seen.0[0] == state(ms).0[0] || fault == JointFault::StaleState, "the other joint");
            }
            let never = reported(fault, 0.0);
            assert!((0..).zip(never).all(|(ms, seen)| seen == state(ms)), "{fault:?}");
        }
    }

    #[test]
    fn what_is_reported_is_what_each_fault_says() {
        let freeze = reported(JointFault::Freeze, 1.0);
        assert!((4..7).all(|ms| freeze[ms].0[1] == state(3).0[1] && freeze[ms].1[1] == 0.0));
        let stale = reported(JointFault::StaleState, 1.0);
        assert!((4..7).all(|ms| stale[ms] == state(3)));
        for (fault, ms) in [(JointFault::Offset(0.5), 4), (JointFault::Spike(0.5), 5)] {
            let off = reported(fault, 1.0)[ms].0[1] - state(ms as i64).0[1];
            assert!((off.abs() - 0.5).abs() < 1e-12, "{fault:?}: {off}");
        }
    }

    #[test]
    fn torque_is_lost_in_its_joint_and_time_alone() {
        let window = FaultWindow { from: SpanNs(0), until: SpanNs(2_000_000), probability: 1.0, seed: 0 };
        let faults = JointFaults::<2>::new(&[(JointFault::TorqueLoss(0.4), 1, window)], 1);
        let weakened = |ms: i64| {
            let mut tau = Vector2::new(10.0, 10.0);
            faults.weaken(SpanNs(1_000_000 * ms), &mut tau);
            tau
        };
        let faults = JointFaults::<2>::new(&[(JointFault::LostCommand, 0, window)], 1);
        let lost = [0, 1, 2].map(|ms| faults.loses_command(SpanNs(1_000_000 * ms)));
        assert_eq!(lost, [true, true, false]);
        assert_eq!(weakened(1), Vector2::new(10.0, 6.0));
        assert_eq!(weakened(2), Vector2::new(10.0, 10.0));
    }
}
