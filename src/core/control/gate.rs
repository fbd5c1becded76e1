//! The last stage before the drive: whatever happened before it, the command is finite and within the limits on position,
//! velocity, acceleration, jerk, effort and effort rate.
//!
//! ```text
//! reference ─► may each joint go there from where it was, and stop from there? ─► q_r, qd_r ─► drive
//!              no: it comes to it within the limits (`joint_bound`)
//! torque ────► finite? does it drive a measured joint that is too fast or too far? (`arm_bound`)
//!              within effort and effort rate? ─────────────────────────────────► tau
//! ```
//! The gate checks each joint separately. It shares no code with the reference that it checks, and its bounds are checked once, in
//! [`Gate::new`]. Commands of a correct reference and joint controller pass unchanged. A command that must be changed reveals a defect before
//! the gate, or an arm that deviates from its model. It is counted, and it becomes a fault when it persists.
//!
//! What has passed never jumps. With a drive in torque mode the reference may be reset to an arm that stands elsewhere, or be that of
//! an arm under a law that outputs torques: `q_r` and `qd_r` then approach it within the limits, and are what the drive is to hold.

mod arm_bound;
mod joint_bound;
mod space_bound;

pub use space_bound::SpaceBound;

use super::safety::Fault;
use crate::drive::{CommandMode, DriveCommand, DriveState};
use crate::motion::{MotionLimits, ReferenceState};
use crate::time::TICK;
use arm_bound::{ArmBound, Overspeed, not_driving};
use joint_bound::{JointBound, JointMotion};
use nalgebra::SVector;

/// Commands in a row that the gate had to change before that is a fault: 100 ms. Chosen by hand: single changes are counted and do not
/// stop the arm, because what passes is within the limits either way.
const PATIENCE: u32 = 100;
/// Replaces a limit that is not positive or not a number. Chosen by hand: not zero, because the gate divides by it, and so small
/// that the joint hardly moves and the changed commands become a fault.
const NO_LIMIT: f64 = 1e-9;

/// The limits of the gate beside those of motion.
#[derive(Debug, Clone, PartialEq)]
pub struct GateSettings<const N: usize> {
    /// Largest torque or force of each joint, N m or N.
    pub effort: SVector<f64, N>,
    /// Its largest change in a second.
    pub effort_rate: SVector<f64, N>,
    /// What the drive obeys.
    pub mode: CommandMode,
    /// How far a measured joint may leave its range, rad or m.
    pub max_excess: f64,
}

/// The gate.
#[derive(Debug, Clone)]
pub struct Gate<const N: usize> {
    settings: GateSettings<N>,
    bounds: [JointBound; N],
    arm_bounds: [ArmBound; N],
    /// What has passed, and the torque, which is `None` while the brakes hold.
    passed: [JointMotion; N],
    tau: Option<SVector<f64, N>>,
    changed: u64,
    in_a_row: u32,
    overspeed: Overspeed,
}

/// What passed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed<const N: usize> {
    /// For the drive.
    pub command: DriveCommand<N>,
    /// The joints whose torque was cut, as a mask.
    pub cut: u8,
    /// The fault of what comes before the gate.
    pub fault: Option<Fault>,
}

impl<const N: usize> Gate<N> {
    /// A gate before its first command, for an arm at rest in `q`. An invalid limit keeps its joint still.
    #[must_use]
    pub fn new(settings: GateSettings<N>, limits: &MotionLimits<N>, q: &SVector<f64, N>) -> Self {
        let limit = |x: f64| if x > 0.0 { x } else { NO_LIMIT };
        let finite = |x: f64| if x.is_finite() { limit(x) } else { NO_LIMIT };
        // In this form NaN is no effort.
        let effort = |x: f64| if x >= 0.0 { x } else { 0.0 };
        let settings = GateSettings {
            effort: settings.effort.map(effort),
            effort_rate: settings.effort_rate.map(effort),
            mode: settings.mode,
            max_excess: effort(settings.max_excess),
        };
        let bounds: [_; N] = std::array::from_fn(|i| JointBound {
            range: (limits.lower[i], limits.upper[i]),
            v: limit(limits.velocity[i]),
            a: finite(limits.acceleration[i]),
            j: finite(limits.jerk[i]),
        });
        let arm_bounds = bounds.map(|JointBound { range: (lower, upper), v, .. }| ArmBound {
            range: (lower - settings.max_excess, upper + settings.max_excess),
            v,
        });
        Self {
            settings,
            bounds,
            arm_bounds,
            passed: standing(q),
            tau: None,
            changed: 0,
            in_a_row: 0,
            overspeed: Overspeed::default(),
        }
    }

    /// Commands that had to be changed.
    #[must_use]
    pub fn changed(&self) -> u64 {
        self.changed
    }

    /// Whether a command has passed the gate.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.tau.is_some()
    }

    /// Sets the posture `q` of an arm at rest, from which the commands begin. Once a command has passed, the next ones continue from it: this
    /// then does nothing, and neither for a `q` that is not finite.
    pub fn begin_at(&mut self, q: &SVector<f64, N>) {
        if !self.is_open() && q.iter().all(|q| q.is_finite()) {
            self.passed = standing(q);
        }
    }

    /// Sets the position of the command to the measured `q` and keeps its velocity, for a drive that obeys velocities alone. For any other drive
    /// the positions are those that have passed: this then does nothing, and neither for a `q` that is not finite.
    pub fn relocate(&mut self, q: &SVector<f64, N>) {
        if self.settings.mode == CommandMode::Velocity && q.iter().all(|q| q.is_finite()) {
            for ((passed, bound), q) in self.passed.iter_mut().zip(&self.bounds).zip(q) {
                passed.q = q.max(bound.range.0).min(bound.range.1);
            }
        }
    }

    /// Passes the reference and the torque of a tick, changed as far as the limits require. The measured arm is in the state `arm`, and
    /// the torques of `gravity` carry it there.
    pub fn pass(
        &mut self,
        reference: &ReferenceState<N>,
        tau: &SVector<f64, N>,
        arm: &DriveState<N>,
        gravity: impl FnOnce() -> SVector<f64, N>,
    ) -> Passed<N> {
        let dt = TICK.as_s();
        let wanted: [_; N] =
            std::array::from_fn(|i| JointMotion { q: reference.q[i], v: reference.qd[i], a: reference.a[i] });
        let mut moved = false;
        for ((passed, bound), wanted) in self.passed.iter_mut().zip(&self.bounds).zip(wanted) {
            let admitted = bound.admits(*passed, wanted, dt);
            *passed = if admitted { wanted } else { bound.approach(*passed, wanted, dt) };
            moved |= !admitted;
        }
        let forbidden = self.forbidden(arm);
        let carrying = if forbidden == [0.0; N] { SVector::zeros() } else { gravity() };
        let (mut held, mut cut) = (SVector::zeros(), 0u8);
        for i in 0..N {
            let last = self.tau.map(|tau| tau[i]);
            // Where the brakes held so far, the first torque carries the arm's weight at once.
            let rise = last.map_or(f64::INFINITY, |_| self.settings.effort_rate[i] * dt);
            let last = last.unwrap_or(0.0);
            let wanted = if tau[i].is_finite() { tau[i] } else { last };
            let wanted = not_driving(forbidden[i], wanted, carrying[i]);
            let effort = self.settings.effort[i];
            held[i] = wanted.max(last - rise).min(last + rise).clamp(-effort, effort);
            cut |= u8::from(held[i] != tau[i]) << i;
        }
        self.tau = Some(held);
        let changed = if self.settings.mode == CommandMode::Torque { cut != 0 } else { moved };
        self.changed += u64::from(changed);
        self.in_a_row = if changed { self.in_a_row.saturating_add(1) } else { 0 };
        let numbers = reference.q.iter().chain(&reference.qd).chain(tau).all(|x| x.is_finite());
        let is_too_fast = self.settings.mode == CommandMode::Torque
            && self.arm_bounds.iter().zip(&arm.qd).any(|(bound, qd)| bound.is_too_fast(*qd));
        let fault = if self.overspeed.note(is_too_fast) {
            Some(Fault::TooFast)
        } else {
            (!numbers || self.in_a_row > PATIENCE).then_some(Fault::CommandsRefused)
        };
        Passed { command: self.passed(), cut, fault }
    }

    /// The direction of each joint in which a torque may not drive the measured arm; before a drive that obeys references there is none.
    fn forbidden(&self, arm: &DriveState<N>) -> [f64; N] {
        if self.settings.mode != CommandMode::Torque {
            return [0.0; N];
        }
        std::array::from_fn(|i| self.arm_bounds[i].forbidden(arm.q[i], arm.qd[i]))
    }

    /// The command that a drive is to hold when no other follows: the one that passed last, with a velocity of zero. The command of an arm that
    /// has come to rest has at most the velocity of two ticks of its jerk. After a defect it may have any, and a drive that obeys velocities
    /// would keep that one for ever.
    #[must_use]
    pub fn last(&self) -> DriveCommand<N> {
        DriveCommand { qd_r: SVector::zeros(), qdd_r: SVector::zeros(), ..self.passed() }
    }

    /// The last command that has passed.
    #[must_use]
    pub fn passed(&self) -> DriveCommand<N> {
        let of = |part: fn(&JointMotion) -> f64| SVector::from_iterator(self.passed.iter().map(part));
        let tau = self.tau.unwrap_or_else(SVector::zeros);
        DriveCommand { tau, q_r: of(|m| m.q), qd_r: of(|m| m.v), qdd_r: of(|m| m.a) }
    }
}

fn standing<const N: usize>(q: &SVector<f64, N>) -> [JointMotion; N] {
    std::array::from_fn(|i| JointMotion { q: q[i], v: 0.0, a: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{ActingLimits, Reference};
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
        GateSettings { effort, effort_rate, mode, max_excess: 0.05 }
    }

    fn gate(mode: CommandMode) -> Gate<2> {
        Gate::new(settings(mode), &limits(), &Vector2::zeros())
    }

    /// Independent check of what has passed.
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

    /// Past the gate, with an arm that does as it is told, of joints without weight.
    fn pass(gate: &mut Gate<2>, reference: &ReferenceState<2>, tau: &Vector2<f64>) -> Passed<2> {
        gate.pass(reference, tau, &at(Vector2::zeros(), Vector2::zeros()), Vector2::zeros)
    }

    fn at(q: Vector2<f64>, qd: Vector2<f64>) -> DriveState<2> {
        DriveState { q, qd, truth: None }
    }

    fn any_bits() -> impl Strategy<Value = f64> {
        prop_oneof![any::<u64>().prop_map(f64::from_bits), -3.0..3.0f64, -400.0..400.0f64]
    }

    fn point(q: Vector2<f64>, qd: Vector2<f64>, a: Vector2<f64>) -> ReferenceState<2> {
        ReferenceState { q, qd, qdd: Vector2::zeros(), a, limits: ActingLimits::default() }
    }

    proptest! {
        /// For commands of arbitrary bits: no limit is exceeded, and everything is finite.
        #[test]
        fn nothing_beyond_the_limits_passes(
            commands in prop::collection::vec(prop::array::uniform8(any_bits()), 1..200), repeat in 1usize..50
        ) {
            let mut gate = gate(CommandMode::Torque);
            let mut judge = Judge::default();
            let zero = Vector2::zeros();
            judge.judge(&pass(&mut gate, &point(zero, zero, zero), &zero).command)?;
            for c in commands {
                let pair = |i: usize| Vector2::new(c[i], c[i + 1]);
                for _ in 0..repeat {
                    let passed = pass(&mut gate, &point(pair(2), pair(4), pair(6)), &pair(0));
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
                    let passed = pass(&mut gate, r.state(), &Vector2::zeros());
                    prop_assert_eq!(gate.changed(), 0, "{:?} {:?}", r.state(), passed);
                    prop_assert_eq!((passed.command.q_r, passed.command.qd_r), (r.state().q, r.state().qd));
                }
            }
        }
    }

    #[test]
    fn limits_that_are_none_hold_a_joint_still() {
        let bad = [f64::NAN, -1.0, 0.0, f64::NEG_INFINITY];
        for bad in bad {
            let limits = MotionLimits {
                velocity: Vector2::repeat(bad),
                acceleration: Vector2::repeat(bad),
                jerk: Vector2::repeat(bad),
                ..limits()
            };
            let settings = GateSettings { effort: Vector2::repeat(bad), ..settings(CommandMode::Position) };
            let mut gate = Gate::new(settings, &limits, &Vector2::zeros());
            for _ in 0..1000 {
                let wanted = point(Vector2::new(0.1, 0.1), Vector2::new(0.5, 0.1), Vector2::zeros());
                let command = pass(&mut gate, &wanted, &Vector2::new(5.0, 5.0)).command;
                assert_eq!(command.tau, Vector2::zeros());
                assert!(command.q_r.amax() < 1e-6 && command.qd_r.amax() < 1e-6, "{bad}: {command:?}");
            }
        }
    }

    #[test]
    fn what_it_may_not_follow_at_once_is_come_to_and_reached() {
        let mut gate = gate(CommandMode::Torque);
        let wanted = point(Vector2::new(0.1, 0.05), Vector2::zeros(), Vector2::zeros());
        let mut passed = pass(&mut gate, &wanted, &Vector2::zeros()).command;
        let mut farthest = Vector2::zeros();
        for _ in 0..3000 {
            passed = pass(&mut gate, &wanted, &Vector2::zeros()).command;
            farthest = farthest.sup(&passed.q_r);
        }
        assert!((passed.q_r - wanted.q).amax() < 1e-5 && passed.qd_r.amax() < 1e-4, "{passed:?}");
        assert!((farthest - wanted.q).max() < 0.02, "it does not pass by: {farthest}");
        assert_eq!(gate.last(), DriveCommand { qd_r: Vector2::zeros(), ..passed });
    }

    #[test]
    fn no_torque_drives_an_arm_that_is_too_fast_or_too_far() {
        let gravity = Vector2::new(20.0, -5.0);
        let rest = point(Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
        // what comes out after the effort rate let it
        let torque = |mode, q: [f64; 2], qd: [f64; 2], tau: [f64; 2]| {
            let mut gate = gate(mode);
            let mut through =
                || gate.pass(&rest, &tau.into(), &at(q.into(), qd.into()), || gravity).command.tau.into();
            (0..100).map(|_| through()).last().unwrap()
        };
        let by_torque = |q, qd, tau| -> [f64; 2] { torque(CommandMode::Torque, q, qd, tau) };
        // as fast as the limits allow, and a little more: all passes
        assert_eq!(by_torque([0.0; 2], [2.2, -0.33], [50.0, -20.0]), [50.0, -20.0]);
        // too fast: what would drive it is down to its weight, what brakes passes
        assert_eq!(by_torque([0.0; 2], [2.6, -0.4], [50.0, -20.0]), [20.0, -5.0]);
        assert_eq!(by_torque([0.0; 2], [2.6, -0.4], [-50.0, 20.0]), [-50.0, 20.0]);
        // out of its range and going farther; where it stands it may be held, on its way back braked
        assert_eq!(by_torque([1.06, -0.16], [0.1, -0.1], [50.0, -20.0]), [20.0, -5.0]);
        assert_eq!(by_torque([1.06, -0.16], [0.01, -0.01], [50.0, -20.0]), [50.0, -20.0]);
        assert_eq!(by_torque([1.06, -0.16], [-0.1, 0.1], [50.0, -20.0]), [50.0, -20.0]);
        assert_eq!(by_torque([1.04, -0.14], [0.1, -0.1], [50.0, -20.0]), [50.0, -20.0]);
        // no numbers forbid nothing, and drives that obey references bound themselves
        assert_eq!(by_torque([f64::NAN; 2], [f64::NAN; 2], [50.0, -20.0]), [50.0, -20.0]);
        let by_position: [f64; 2] = torque(CommandMode::Position, [0.0; 2], [2.6, -0.4], [50.0, -20.0]);
        assert_eq!(by_position, [50.0, -20.0]);
    }

    #[test]
    fn an_arm_that_trembles_too_fast_is_a_fault() {
        let rest = point(Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
        let zero = Vector2::zeros();
        // the fault that comes within `ticks` where every `period`-th one shows the second joint at `qd`, to and fro
        let fault = |mode, qd: f64, period: u32, ticks: u32| {
            let mut gate = gate(mode);
            (0..ticks).find_map(|k| {
                let side = if k.is_multiple_of(2 * period) { 1.0 } else { -1.0 };
                let qd = Vector2::new(0.0, if k.is_multiple_of(period) { side * qd } else { 0.0 });
                gate.pass(&rest, &zero, &at(zero, qd), || zero).fault
            })
        };
        let by_torque = |qd, period, ticks| fault(CommandMode::Torque, qd, period, ticks);
        assert_eq!(by_torque(0.4, 3, 500), Some(Fault::TooFast));
        assert_eq!(by_torque(0.4, 1, 99), None);
        assert_eq!(by_torque(0.4, 1, 101), Some(Fault::TooFast));
        // as fast as the limit and a little more, or seldom
        assert_eq!(by_torque(0.37, 1, 2000), None);
        assert_eq!(by_torque(0.4, 12, 5000), None);
        assert_eq!(by_torque(f64::NAN, 1, 2000), None);
        assert_eq!(fault(CommandMode::Velocity, 0.4, 1, 2000), None);
    }

    #[test]
    fn only_repeated_wrong_commands_are_a_fault() {
        let mut gate = gate(CommandMode::Torque);
        let rest = point(Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
        let mut command = |tau| pass(&mut gate, &rest, &Vector2::new(tau, 0.0)).fault;
        assert_eq!(command(0.0), None);
        assert_eq!(command(400.0), None);
        assert_eq!(command(10.0), None);
        let faults = (0..110).filter(|_| command(400.0).is_some()).count();
        assert_eq!(faults, 10);
        assert_eq!(gate.changed(), 111);
    }
}
