//! The last thing before the drive: whatever happened before it, what passes is finite and within the limits on position,
//! velocity, acceleration, jerk, effort and effort rate.
//!
//! ```text
//! reference ─► may it go there from where it was, and brake from there? ─► q_r, qd_r ─► drive
//!              no: a reference of the gate's own goes after it
//! torque ────► finite? within effort and effort rate? ───────────────────► tau
//! ```
//! What comes from a reference and a joint controller passes as it is; a command that has to be changed is a defect before
//! the gate, or an arm that does what its model does not know. It is counted, and told where it does not stop.
//!
//! Nobody steps what has passed. Before a drive that obeys torques a reference may be put on an arm that stands elsewhere, or be that of
//! an arm under a law that outputs torques: `q_r`, `qd_r` then come to it within the limits, and tell a drive what to hold.

use super::safety::Fault;
use crate::drive::{CommandMode, DriveCommand};
use crate::motion::{MotionLimits, Reference, ReferenceState};
use crate::time::TICK;
use nalgebra::SVector;

/// Commands in a row that had to be changed in what the drive obeys, before that is a fault.
const PATIENCE: u32 = 100;
/// Rate at which what passes comes to a reference that it may not follow at once, 1/s: as quickly as a law of the default gain lets
/// its error die out, so that the acceleration of 10 rad/s^2 suffices from up to 0.1 rad away without passing by.
const CATCH_UP_1_S: f64 = 10.0;

/// What the gate holds commands to, beside the limits of motion.
#[derive(Debug, Clone, PartialEq)]
pub struct GateSettings<const N: usize> {
    /// Largest torque or force of each joint, N m or N.
    pub effort: SVector<f64, N>,
    /// Its largest change in a second.
    pub effort_rate: SVector<f64, N>,
    /// What the drive obeys.
    pub mode: CommandMode,
}

/// The gate.
#[derive(Debug, Clone)]
pub struct Gate<const N: usize> {
    settings: GateSettings<N>,
    /// What has passed.
    reference: Reference<N>,
    /// Torque that has passed; `None` while the brakes hold.
    tau: Option<SVector<f64, N>>,
    changed: u64,
    in_a_row: u32,
}

/// What passed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed<const N: usize> {
    /// For the drive.
    pub command: DriveCommand<N>,
    /// The joints whose torque was cut, as a mask.
    pub cut: u8,
    /// What is wrong with what comes before the gate.
    pub fault: Option<Fault>,
}

impl<const N: usize> Gate<N> {
    /// A gate through which nothing has passed, before an arm that stands in `q`.
    #[must_use]
    pub fn new(settings: GateSettings<N>, limits: MotionLimits<N>, q: SVector<f64, N>) -> Self {
        Self { settings, reference: Reference::new(limits, q), tau: None, changed: 0, in_a_row: 0 }
    }

    /// Commands that had to be changed.
    #[must_use]
    pub fn changed(&self) -> u64 {
        self.changed
    }

    /// Whether anything has passed.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.tau.is_some()
    }

    /// The arm stands in `q`: what passes begins there. Once something has passed it goes on from that, and this does nothing.
    pub fn begin_at(&mut self, q: &SVector<f64, N>) {
        if !self.is_open() {
            self.reference.reset_to_measured(q, &SVector::zeros());
        }
    }

    /// The arm is in `q`, before a drive that obeys velocities alone; what passes keeps its velocity. Before any other drive positions are
    /// those that have passed, and this does nothing.
    pub fn relocate(&mut self, q: &SVector<f64, N>) {
        if self.settings.mode == CommandMode::Velocity {
            self.reference.relocate(q);
        }
    }

    /// Lets the reference and the torque of a tick through, as far as they may.
    pub fn pass(&mut self, reference: &ReferenceState<N>, tau: &SVector<f64, N>) -> Passed<N> {
        let moved = !self.reference.admit(reference, TICK);
        if moved {
            let behind = reference.q - self.reference.state().q;
            self.reference.advance(&(reference.qd + behind * CATCH_UP_1_S), TICK);
        }
        let (mut held, mut cut) = (SVector::zeros(), 0u8);
        for i in 0..N {
            let last = self.tau.map(|tau| tau[i]);
            // Where the brakes held so far, the first torque carries the arm's weight at once.
            let rise = last.map_or(f64::INFINITY, |_| self.settings.effort_rate[i] * TICK.as_s());
            let last = last.unwrap_or(0.0);
            let wanted = if tau[i].is_finite() { tau[i] } else { last };
            let effort = self.settings.effort[i];
            held[i] = wanted.max(last - rise).min(last + rise).clamp(-effort, effort);
            cut |= u8::from(held[i] != tau[i]) << i;
        }
        self.tau = Some(held);
        let changed = if self.settings.mode == CommandMode::Torque { cut != 0 } else { moved };
        self.changed += u64::from(changed);
        self.in_a_row = if changed { self.in_a_row + 1 } else { 0 };
        let numbers = reference.q.iter().chain(&reference.qd).chain(tau).all(|x| x.is_finite());
        let fault = (!numbers || self.in_a_row > PATIENCE).then_some(Fault::CommandsRefused);
        let passed = self.reference.state();
        Passed { command: DriveCommand { tau: held, q_r: passed.q, qd_r: passed.qd }, cut, fault }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ActingLimits;
    use crate::time::SpanNs;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn limits() -> MotionLimits<2> {
        MotionLimits {
            lower: Vector2::new(-1.0, -0.1),
            upper: Vector2::new(1.0, 0.2),
            velocity: Vector2::new(2.0, 0.3),
            acceleration: Vector2::new(10.0, 2.0),
            jerk: Vector2::new(500.0, 100.0),
        }
    }

    fn settings(mode: CommandMode) -> GateSettings<2> {
        let (effort, effort_rate) = (Vector2::new(150.0, 28.0), Vector2::new(15_000.0, 2_800.0));
        GateSettings { effort, effort_rate, mode }
    }

    fn gate(mode: CommandMode) -> Gate<2> {
        Gate::new(settings(mode), limits(), Vector2::zeros())
    }

    /// Checks by itself what has passed.
    #[derive(Default)]
    struct Judge {
        last: Option<(DriveCommand<2>, Vector2<f64>)>,
    }

    impl Judge {
        fn judge(&mut self, c: &DriveCommand<2>) -> Result<(), TestCaseError> {
            let (l, s) = (limits(), settings(CommandMode::Torque));
            for i in 0..2 {
                prop_assert!(
                    c.q_r[i] >= l.lower[i] - 1e-5 && c.q_r[i] <= l.upper[i] + 1e-5,
                    "position {}",
                    c.q_r
                );
                prop_assert!(c.qd_r[i].abs() <= l.velocity[i] * (1.0 + 1e-5), "velocity {}", c.qd_r);
                prop_assert!(c.tau[i].abs() <= s.effort[i], "effort {}", c.tau);
            }
            let mut qdd = Vector2::zeros();
            if let Some((before, qdd_before)) = &self.last {
                qdd = (c.qd_r - before.qd_r) / 1e-3;
                for i in 0..2 {
                    prop_assert!(qdd[i].abs() <= l.acceleration[i] * (1.0 + 1e-5), "acceleration {qdd}");
                    // Means over a tick of an acceleration that changes by at most jerk times tick.
                    let jerk = (qdd[i] - qdd_before[i]) / 1e-3;
                    prop_assert!(jerk.abs() <= 1.51 * l.jerk[i], "jerk {jerk} of joint {i}");
                    let rate = (c.tau[i] - before.tau[i]).abs() / 1e-3;
                    prop_assert!(rate <= s.effort_rate[i] * (1.0 + 1e-9), "effort rate {rate}");
                    let way = c.q_r[i] - before.q_r[i] - 0.5e-3 * (c.qd_r[i] + before.qd_r[i]);
                    prop_assert!(way.abs() < 1e-6, "the position does not go with the velocity: {way}");
                }
            }
            self.last = Some((*c, qdd));
            Ok(())
        }
    }

    fn any_bits() -> impl Strategy<Value = f64> {
        prop_oneof![any::<u64>().prop_map(f64::from_bits), -3.0..3.0f64, -400.0..400.0f64]
    }

    fn point(q: Vector2<f64>, qd: Vector2<f64>, a: Vector2<f64>) -> ReferenceState<2> {
        ReferenceState { q, qd, qdd: Vector2::zeros(), a, limits: ActingLimits::default() }
    }

    proptest! {
        /// Whatever is commanded, of whatever bits: no limit is passed, and nothing is no number.
        #[test]
        fn nothing_beyond_the_limits_passes(
            commands in prop::collection::vec(prop::array::uniform8(any_bits()), 1..200), repeat in 1usize..50
        ) {
            let mut gate = gate(CommandMode::Torque);
            let mut judge = Judge::default();
            let zero = Vector2::zeros();
            judge.judge(&gate.pass(&point(zero, zero, zero), &zero).command)?;
            for c in commands {
                let pair = |i: usize| Vector2::new(c[i], c[i + 1]);
                for _ in 0..repeat {
                    let passed = gate.pass(&point(pair(2), pair(4), pair(6)), &pair(0));
                    judge.judge(&passed.command)?;
                    let numbers = c[..6].iter().all(|x| x.is_finite());
                    prop_assert!(numbers || passed.fault == Some(Fault::CommandsRefused));
                }
            }
        }

        /// What a reference makes passes as it is, of motion commands for velocities and for accelerations.
        #[test]
        fn a_reference_passes_unchanged(
            requests in prop::collection::vec((-5.0..5.0f64, -5.0..5.0f64, 1usize..200, any::<bool>()), 1..12)
        ) {
            let mut gate = gate(CommandMode::Position);
            let mut r = Reference::new(limits(), Vector2::zeros());
            for (a, b, ticks, by_acceleration) in requests {
                for _ in 0..ticks {
                    let requested_qd = Vector2::new(a, b);
                    if by_acceleration {
                        r.accelerate(&requested_qd, SpanNs::MILLISECOND);
                    } else {
                        r.advance(&requested_qd, SpanNs::MILLISECOND);
                    }
                    let passed = gate.pass(r.state(), &Vector2::zeros());
                    prop_assert_eq!(gate.changed(), 0, "{:?} {:?}", r.state(), passed);
                    prop_assert_eq!((passed.command.q_r, passed.command.qd_r), (r.state().q, r.state().qd));
                }
            }
        }
    }

    #[test]
    fn only_repeated_wrong_commands_are_a_fault() {
        let mut gate = gate(CommandMode::Torque);
        let rest = point(Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
        let mut command = |tau| gate.pass(&rest, &Vector2::new(tau, 0.0)).fault;
        assert_eq!(command(0.0), None);
        assert_eq!(command(400.0), None);
        assert_eq!(command(10.0), None);
        let faults = (0..110).filter(|_| command(400.0).is_some()).count();
        assert_eq!(faults, 10);
        assert_eq!(gate.changed(), 111);
    }
}
