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
mod tests;
