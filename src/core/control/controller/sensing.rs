//! From what the drive reports to the state that is believed.

use super::Controller;
use crate::control::safety::{EncoderTraits, ExpectedMotion, Fault};
use crate::control::trace::Event;
use crate::drive::{CommandMode, DriveState};
use crate::time::MonoNs;
use nalgebra::SVector;

/// Velocity error up to which a drive that reported impossible values is trusted again, rad/s or m/s. Chosen by hand: the position must
/// agree too, and noisy encoders report velocity errors of tenths of a rad/s.
const EXPECTED_SPEED: f64 = 1.0;

impl<const N: usize> Controller<N> {
    /// Takes in the joint torques that the drive's state carries, N m or N; `None` where it measures none.
    pub fn hear_torque(&mut self, measured: Option<SVector<f64, N>>) {
        self.measured_torque = measured.filter(|tau| tau.iter().all(|tau| tau.is_finite()));
    }

    /// The state of the drive, if it is plausible.
    pub(super) fn sense(&mut self, now: MonoNs, drive: &DriveState<N>) -> Option<DriveState<N>> {
        let is_repeated = self.repeats.note(drive, self.joint_control.encoder_step().amax());
        self.timing.note(std::mem::take(&mut self.is_state_old) || is_repeated);
        if self.timing.is_old() {
            self.joint_control.hear_old_state();
        }
        let believed = self.without_wrong_encoders(now, drive);
        let wrong = self.watch.note(now, drive, &believed, &self.arm.limits, self.timing);
        if let Some(fault) = wrong {
            self.fail(fault);
        }
        if wrong.is_some_and(Fault::blinds) || self.is_blind(drive) {
            self.encoder_watch.skip();
            return None;
        }
        self.rest_watch.note(drive);
        if !std::mem::replace(&mut self.start.is_checked, true) {
            if (drive.q - self.start.q).amax() > self.start.tolerance {
                self.events.push(Event::StartsElsewhere);
                if !self.start.elsewhere {
                    self.fail(Fault::StartsElsewhere);
                }
            }
            self.reset_to_measured(drive);
        }
        Some(believed)
    }

    /// The joints, from 0, that are not where their encoders say.
    pub fn untrusted_encoders(&self) -> impl Iterator<Item = usize> + use<N> {
        let distrusted = self.encoder_watch.distrusted();
        (0..N).filter(move |i| distrusted[*i])
    }

    /// Whether no state of the drive is used. One that has reported an impossible state is trusted again once its states agree with the reference.
    fn is_blind(&self, drive: &DriveState<N>) -> bool {
        let r = self.reference.state();
        let disagrees =
            (drive.q - r.q).amax() > self.max_tracking_error || (drive.qd - r.qd).amax() > EXPECTED_SPEED;
        self.failure.is_some_and(Fault::blinds) || (self.fault.is_some_and(Fault::blinds) && disagrees)
    }

    /// The state, in which joints whose encoders say what no motion explains are believed to do what they were told.
    fn without_wrong_encoders(&mut self, now: MonoNs, drive: &DriveState<N>) -> DriveState<N> {
        if self.mode != CommandMode::Torque || !self.obeys {
            let commanded = self.gate.passed().qd_r;
            let steps = self.joint_control.encoder_step();
            self.encoder_watch.note((now, self.timing), drive, &commanded, steps);
            return *drive;
        }
        let expected = self.joint_control.expected_motion().filter(|_| self.gate.is_open());
        let expected = expected.map(|(q, qd, qdd)| ExpectedMotion { q, qd, qdd });
        let friction = self.arm.robot.friction();
        let traits = EncoderTraits {
            step: *self.joint_control.encoder_step(),
            inertia: *self.joint_control.inertia(),
            coulomb: SVector::from_fn(|i, _| friction[i].coulomb),
            lag: self.joint_control.position_lag_by_steps(),
        };
        let (believed, fault) = self.encoder_watch.take(
            (now, self.timing),
            drive,
            &self.reference.state().q,
            expected.as_ref(),
            &traits,
        );
        if let Some(fault) = fault {
            self.fail(fault);
        }
        believed
    }

    /// The same fault in other words, where a joint that is told to move has a reading that stays the same: nothing tells a frozen encoder from a joint that is held.
    pub(super) fn of_stuck_readings(&self, now: MonoNs, fault: Fault) -> Fault {
        let steps = self.joint_control.encoder_step();
        let touched = self.contact.map(|contact| contact.joint);
        let may_be = |i: usize| match fault {
            Fault::Contact => touched == Some(i),
            Fault::DoesNotFollow | Fault::TrackingError => true,
            _ => false,
        };
        let is_stuck = (0..N).any(|i| may_be(i) && self.encoder_watch.is_stuck(i, now, steps[i]));
        if is_stuck { Fault::StuckReading } else { fault }
    }

    /// The state that is believed of an arm that is in `state` when it comes into `fault`: what seems to be blocked may have an encoder that is frozen.
    pub(super) fn distrust_encoders(&mut self, fault: Fault, state: &DriveState<N>) -> DriveState<N> {
        let may_be = matches!(
            fault,
            Fault::Contact
                | Fault::StuckReading
                | Fault::DoesNotFollow
                | Fault::TrackingError
                | Fault::Oscillates
                | Fault::TooFast
        );
        if !may_be || self.mode != CommandMode::Torque {
            return *state;
        }
        self.encoder_watch.distrust_still(state, self.reference.state(), self.joint_control.encoder_step())
    }
}
