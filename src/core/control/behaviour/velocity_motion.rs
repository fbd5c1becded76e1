//! Velocities that a client commands in a running loop, such as those of a law of its own: each is held for the time that came with it, and a client that is
//! silent for longer leaves an arm that brakes and rests.
//!
//! What is commanded goes the way of every motion: through the limits of the reference, those in space, and the gate.

use super::posture_motion::RESTS;
use super::{ArmModel, CommandedMotion, MotionCommand};
use crate::drive::DriveState;
use crate::robot::Mount;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// The motion by the velocities of a client.
#[derive(Debug)]
pub struct VelocityMotion<const N: usize> {
    commanded: Option<(CommandedMotion<N>, SpanNs)>,
    /// Until when the last one holds; from the first tick after it came on.
    until: Option<MonoNs>,
    /// Ticks for which the arm has rested before its first motion; `None` once it may move.
    rested: Option<u32>,
}

impl<const N: usize> Default for VelocityMotion<N> {
    fn default() -> Self {
        Self { commanded: None, until: None, rested: Some(0) }
    }
}

impl<const N: usize> VelocityMotion<N> {
    /// The next velocity, which holds for `hold` from the next tick on.
    pub fn command(&mut self, motion: CommandedMotion<N>, hold: SpanNs) {
        self.commanded = Some((motion, hold));
        self.until = None;
    }

    /// Nothing is commanded any more.
    pub fn end(&mut self) {
        *self = Self::default();
    }

    /// Whether something is commanded, or the arm still brakes from it.
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.commanded.is_some()
    }

    /// Whether the first velocity has come, and no tick has moved by it.
    #[must_use]
    pub fn is_new(&self) -> bool {
        self.commanded.is_some() && self.until.is_none() && self.rested == Some(0)
    }

    /// The motion command of the tick at `now`, for a camera on `mount` and a reference that `rests` or not; `ready` says whether the arm may leave its rest.
    pub fn motion_command(
        &mut self,
        now: MonoNs,
        state: &DriveState<N>,
        (rests, ready): (bool, bool),
        (arm, mount): (&ArmModel<N>, &Mount),
    ) -> MotionCommand<N> {
        let Some((motion, hold)) = self.commanded else { return MotionCommand::Stand };
        let until = *self.until.get_or_insert(now + hold);
        if let Some(rested) = &mut self.rested {
            // An arm that moves already goes on from what it does.
            *rested = if rests && !ready { 0 } else { *rested + 1 };
            if !rests || *rested > RESTS {
                self.rested = None;
            }
        }
        if self.rested.is_some() || now >= until {
            return MotionCommand::Joints(SVector::zeros());
        }
        let qd = motion.joint_velocity(&state.q, mount, &arm.robot);
        MotionCommand::Joints(within(&qd, &arm.limits.velocity))
    }

    /// Whether the last velocity has held as long as it may at `now`, and the reference `rests`.
    #[must_use]
    pub fn is_over(&self, now: MonoNs, rests: bool) -> bool {
        rests && self.until.is_some_and(|until| now >= until)
    }
}

/// `qd` in the same direction, and no joint faster than its limit, rad/s or m/s.
fn within<const N: usize>(qd: &SVector<f64, N>, limit: &SVector<f64, N>) -> SVector<f64, N> {
    let excess = qd.zip_map(limit, |qd, limit| qd.abs() / limit).max();
    if excess > 1.0 { qd / excess } else { *qd }
}
