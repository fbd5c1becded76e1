//! What the arm carries beyond its model, and what is not known of it.

use super::JointController;
use crate::motion::payload_estimator::{PayloadEstimator, PayloadFound};
use crate::motion::rotor_estimator::RotorEstimator;
use crate::robot::Robot;
use nalgebra::SVector;

/// What is left in a tick of the share of the acceleration limits that the reference may use, while it asks for more torque than the joints have. Chosen by hand: half of it within
/// 23 ms, in which an arm that lacks 5 rad/s^2 falls behind by 1.3 mrad.
const LESS: f64 = 0.97;
/// The least that is left. Chosen by hand: an arm that begins with a fifth of its accelerations still begins.
const LEAST: f64 = 0.2;
/// What it gains in any other tick. Chosen by hand: all of it in 0.4 s, as long as the shipped arms accelerate.
const MORE: f64 = 0.002;

/// The share of the acceleration limits after a tick in which the torque for the reference `exceeds` the efforts, or does not.
pub(super) fn share_after(share: f64, exceeds: bool) -> f64 {
    if exceeds { (share * LESS).max(LEAST) } else { (share + MORE).min(1.0) }
}

impl<const N: usize> JointController<N> {
    /// The same controller of the arm `bare`, which estimates a payload that `bare` does not have and controls the arm with it from then on;
    /// `acceleration` are the acceleration limits of its reference, rad/s^2 or m/s^2; `is_laden`: `bare` carries a payload that was told.
    #[must_use]
    pub fn with_payload_estimator(
        mut self,
        bare: Robot<N>,
        acceleration: SVector<f64, N>,
        is_laden: bool,
    ) -> Self {
        (self.acceleration, self.is_laden) = (acceleration, is_laden);
        self.rotors = Some(Box::new(RotorEstimator::new(&bare, self.observer.inertia())));
        self.payload = Some(Box::new(PayloadEstimator::new(bare)));
        self
    }

    /// The payload that was found; `None` where there is none.
    #[must_use]
    pub fn payload(&self) -> Option<PayloadFound> {
        self.payload.as_ref()?.payload()
    }

    /// The share of the acceleration limits for which the efforts of the arm suffice, with the payload that was found and for what its reference asked of them lately.
    #[must_use]
    pub fn acceleration_share(&self) -> f64 {
        self.acceleration_share.min(self.effort_share)
    }

    /// The share of velocities with which the arm may move on: less than 1 where its efforts hardly suffice to hold its payload, 0 where they do not.
    #[must_use]
    pub fn strength(&self) -> f64 {
        self.strength
    }

    /// The arm with what it was found to carry; `robot` where nothing was.
    #[must_use]
    pub fn carrying<'a>(&'a self, robot: &'a Robot<N>) -> &'a Robot<N> {
        self.payload.as_deref().map_or(robot, PayloadEstimator::robot)
    }

    /// What gravity takes more, N m or N, in a model that has changed since this was asked last.
    pub fn take_model_change(&mut self) -> Option<SVector<f64, N>> {
        self.model_change.take()
    }

    /// The inertia of rotors that was found beyond the model's, as each joint feels it, and its standard deviation, kg m^2 or kg: 0 for joints whose torques may be a payload's; `None`
    /// where none was.
    #[must_use]
    pub fn rotors(&self) -> Option<[SVector<f64, N>; 2]> {
        let payload = self.payload.as_ref()?.unmodelled();
        let rotors = self.rotors.as_ref()?.sure(&payload, self.observer.inertia());
        Some(rotors).filter(|[inertia, _]| inertia.amax() > 0.0)
    }

    /// The last motion took another time than a tick: what payload and rotors were to be estimated from meanwhile is left out.
    pub fn skip_window(&mut self) {
        self.payload.iter_mut().for_each(|payload| payload.skip());
        self.rotors.iter_mut().for_each(|rotors| rotors.skip());
    }

    /// The state that is observed next came before: between two states of a slower drive nothing is known of its motion.
    pub fn hear_old_state(&mut self) {
        self.hears_old = true;
    }

    /// The variances of the inertia of rotors, (kg m^2)^2 or kg^2.
    #[must_use]
    pub fn rotor_doubt(&self) -> SVector<f64, N> {
        self.rotors.as_ref().map_or(SVector::zeros(), |rotors| rotors.variance())
    }

    /// What was added to the inertia of rotors since this was asked last, kg m^2 or kg.
    pub fn take_rotor_change(&mut self) -> Option<SVector<f64, N>> {
        self.rotor_change.take()
    }

    /// The variance of what a payload takes that is not known, beyond what it has taken lately, for each joint, (N m)^2 or N^2.
    #[must_use]
    pub fn payload_doubt(&self) -> SVector<f64, N> {
        self.payload.as_ref().map_or(SVector::zeros(), |payload| *payload.doubt())
    }

    /// Positions and velocities at the last tick, and the accelerations that the command makes until the next (rad, rad/s, rad/s^2 or m, m/s, m/s^2); `None` while none acts.
    #[must_use]
    pub fn expected_motion(&self) -> Option<(SVector<f64, N>, SVector<f64, N>, SVector<f64, N>)> {
        let (q, mut qd, mut qdd) = self.observer.expected_motion()?;
        if self.braked_at.is_some() {
            // What is believed of a joint whose encoder says nothing would drift off with the others' motion.
            let unheard = self.observer.unheard();
            for i in (0..N).filter(|i| unheard[*i]) {
                (qd[i], qdd[i]) = (0.0, 0.0);
            }
        }
        Some((q, qd, qdd))
    }

    /// Learns nothing more from joints whose encoders are not trusted, and forgets what was learnt since their readings last changed.
    pub fn distrust(&mut self, joints: [bool; N]) {
        self.observer.distrust(joints);
    }

    /// Inertia of each joint while the others are free, about, kg m^2 or kg.
    #[must_use]
    pub fn inertia(&self) -> &SVector<f64, N> {
        self.observer.inertia()
    }

    /// Steps of the encoders, rad or m.
    #[must_use]
    pub fn encoder_step(&self) -> &SVector<f64, N> {
        self.observer.encoder_step()
    }

    /// How far the observer's positions are behind an acceleration that it does not know, for each rad/s^2 or m/s^2: s^2.
    #[must_use]
    pub fn position_lag_by_steps(&self) -> SVector<f64, N> {
        self.observer.position_lag_by_steps()
    }

    /// The torque that coarse encoders hide in a mean over `ticks`, as a standard deviation, N m or N.
    #[must_use]
    pub fn hidden_torque(&self, ticks: u32) -> SVector<f64, N> {
        self.observer.hidden_torque(ticks)
    }

    /// What `act` does with this controller and the arm with what it was found to carry.
    pub(super) fn of_carrying<T>(
        &mut self,
        robot: &Robot<N>,
        act: impl FnOnce(&mut Self, &Robot<N>) -> T,
    ) -> T {
        let payload = self.payload.take();
        let result = act(self, payload.as_deref().map_or(robot, PayloadEstimator::robot));
        self.payload = payload;
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_that_asks_too_much_is_slowed_and_comes_back() {
        let after =
            |share: f64, ticks: u32, exceeds: bool| (0..ticks).fold(share, |s, _| share_after(s, exceeds));
        assert!((after(1.0, 23, true) - 0.5).abs() < 0.01);
        assert_eq!(after(1.0, 1000, true), LEAST);
        assert_eq!(after(LEAST, 401, false), 1.0);
    }
}
