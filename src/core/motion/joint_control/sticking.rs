//! What joints that stick get beside the law's torque: more against an error, so that they come loose before it has grown, and damping when they slip.

use super::JointController;
use super::law::{Feedback, InverseDynamicsControl};
use crate::robot::Friction;
use nalgebra::SVector;

/// Times the rate of the law at which an error is to decay against viscous friction. A joint that sticks is freed by the torque that this adds, and with
/// once the rate it waits until the disturbance estimate has grown past its static friction, and leaps. Measured on an xArm7 with hard friction
/// (static friction 1.2 times the sliding one): with 4 it creeps about its goal at 0.001 to 0.06 rad/s instead of chattering at 0.1 to 0.2. Smooth arms must not have it: it triples their jerk at the plant.
const SLIP_GAIN: f64 = 4.0;
/// Share of the confirmed viscous friction that is given back as damping of the velocity error, because compensated friction does not
/// damp: half, so that the loop gain stays below that of the joint's own friction, with which late commands are still stable; and the
/// largest velocity error that is damped so, rad/s or m/s, which bounds the torque of a wrong velocity.
const DAMPING_SHARE: f64 = 0.5;
/// Largest velocity error that is damped so, rad/s or m/s. Chosen by hand: what sticks and slips about a goal reaches 0.2.
const DAMPED: f64 = 0.2;

/// Stiffness and damping beyond those of the law, as multiples of them, of joints that stick where the viscous friction that is known is too little to be of use: the first as above, so that joints come
/// loose before the error has grown; the second so that the damping ratio stays near to 1. Measured: where joints with viscous friction had it too, an xArm7 with double friction faulted.
const STIFFER: f64 = 2.0;
/// Derived: with three times the stiffness and 1.5 times the damping the ratio is 0.87 of the law's; with half of both, 2 and 1.25 times, 0.88.
const DAMPED_MORE: f64 = 0.5;

/// Speed of its reference at which nothing more of the Coulomb friction of a joint that sticks is compensated by its error, rad/s or m/s; below it fades. Chosen by hand: that of an arm at rest, and far above the one
/// at which smooth models change its sign.
const CREEPS: f64 = 0.02;
/// Step of an encoder from which on an error counts less for that, rad or m. Derived: at 40 rad/s friction changes its sign by an error of 25 urad, half of this; where steps are coarser, by half of theirs, within which a
/// reading tells nothing. Measured (`tests/cores/everything_at_once.rs`, with steps of 2e-4 and 5e-4 rad): of 145 draws 73 come home with this, 64 without.
const FINE_STEP: f64 = 5e-5;

/// What of the Coulomb friction of a joint that sticks, N m or N, is compensated by its error, which is to decay with `slip`, beside that by its reference's `velocity`, rad/s or m/s. Its encoder has this `step`, rad or m.
pub(super) fn towards_reference(joint: &Friction, velocity: f64, slip: f64, step: f64) -> f64 {
    let near = (1.0 - velocity.abs() / CREEPS).max(0.0);
    let counts = FINE_STEP / step.max(FINE_STEP);
    near * beyond_reference(joint, velocity, counts * slip)
}

/// The Coulomb friction of a joint, N m or N, by a velocity that is `slip` beyond that of its reference, less what it is by the reference's `velocity`, rad/s or m/s.
pub(super) fn beyond_reference(joint: &Friction, velocity: f64, slip: f64) -> f64 {
    joint.coulomb_part(velocity + slip, 0.0) - joint.coulomb_part(velocity, 0.0)
}

/// Share of the velocity at which an error is to decay that counts for the Coulomb friction of joints that do not stick and whose references jitter. Friction that is less than is believed drives such a joint by the sign of its
/// error, so it must be little. Measured on 42 runs of xArm7s with 0.1 and 0.3 px of noise in the image, with friction 0.2 to 1.3 times the file's, loads of 2 kg, commands 3 ms late and encoder steps (seeds 301 to 303, 40 s): 30 reach
/// their goals and 12 fault with all of the decay, 41 and 1 with 0.3 of it, 42 with 0.1, 41 with none. With none, loads and friction that nobody told leave light wrists off their goals
/// without noise, too (six tests of `tests/cores`: `untold_friction`, `untold_rotors`, `friction`, ...).
const SMOOTH: f64 = 0.1;
/// Step of an encoder from which on it counts less. Derived: friction changes its sign by an error of 0.25 mrad at 40 rad/s, within which a reading should tell something.
const FINE_FOR_SMOOTH: f64 = 2.5e-4;

/// Of a joint that does not stick: the velocity for which its Coulomb friction is compensated beyond that of its reference, rad/s or m/s; its error is to decay with `slip`, its encoder has this `step`, rad or m.
fn smooth_slip(slip: f64, step: f64) -> f64 {
    SMOOTH * FINE_FOR_SMOOTH / step.max(FINE_FOR_SMOOTH) * slip
}

impl<const N: usize> JointController<N> {
    /// Of joints that do not stick and whose references jitter: the velocity beyond that of the reference for which Coulomb friction is compensated, rad/s or m/s.
    pub(super) fn smooth_slips(&self, feedback: &Feedback<N>) -> [Option<f64>; N] {
        let (sticks, jitters) = (self.observer.coulomb_share(), self.observer.jitters());
        let steps = self.observer.encoder_step();
        std::array::from_fn(|i| {
            let is_smooth = sticks[i].is_none() && jitters[i] && !self.soft;
            is_smooth.then(|| smooth_slip(feedback.slip[i], steps[i]))
        })
    }
}

/// Torques of joints that stick, N m or N, with their inertia (kg m^2 or kg, 0 for the others), against the errors of position and velocity.
pub(super) fn torque<const N: usize>(
    inertia: &SVector<f64, N>,
    control: &InverseDynamicsControl,
    (e, ed): (&SVector<f64, N>, &SVector<f64, N>),
) -> SVector<f64, N> {
    let InverseDynamicsControl { omega_rad_s, zeta } = control;
    let stiffness = STIFFER * omega_rad_s * omega_rad_s;
    inertia.component_mul(&(e * stiffness + ed * (DAMPED_MORE * 2.0 * zeta * omega_rad_s)))
}

/// Velocities for which viscous friction of joints that stick, which have these `shares` of [`SLIP_GAIN`], is compensated beyond those of the reference and of the error's decay, rad/s or m/s;
/// zero for the others. The joints move with `qd`.
pub(super) fn extra_velocity<const N: usize>(
    shares: &SVector<f64, N>,
    qd: &SVector<f64, N>,
    feedback: &Feedback<N>,
) -> SVector<f64, N> {
    SVector::from_fn(|i, _| {
        let lead = (qd[i] - feedback.velocity[i]).clamp(-DAMPED, DAMPED);
        let extra = (SLIP_GAIN - 1.0) * shares[i] * feedback.slip[i] - DAMPING_SHARE * lead;
        if shares[i] > 0.0 { extra } else { 0.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FRICTION: Friction = Friction { viscous: 0.5, coulomb: 2.0 };

    #[test]
    fn a_reference_at_rest_frees_by_the_sign_of_the_error() {
        let at_rest = |slip, step| towards_reference(&FRICTION, 0.0, slip, step);
        assert!((at_rest(8e-3, 1e-5) - 2.0).abs() < 1e-3 && (at_rest(-8e-3, 1e-5) + 2.0).abs() < 1e-3);
        assert_eq!(at_rest(0.0, 1e-5), 0.0);
        // An error of half a coarse step is less than all of it.
        let half_a_step = at_rest(40.0 * 2.5e-4, 5e-4);
        assert!((half_a_step / 2.0 - 1.0_f64.tanh()).abs() < 1e-12, "{half_a_step}");
        assert_eq!(towards_reference(&FRICTION, CREEPS, -8e-3, 1e-5), 0.0, "one that is on its way");
    }

    proptest! {
        /// Beside what the velocity of the reference compensates it is never more than the friction that there is, and never away from the reference.
        #[test]
        fn no_more_than_all_friction_and_never_away(
            velocity in -0.05..0.05_f64,
            slip in -0.1..0.1_f64,
            step in 0.0..1e-3_f64,
        ) {
            let more = towards_reference(&FRICTION, velocity, slip, step);
            prop_assert!(more * slip >= 0.0);
            let sum = FRICTION.coulomb_part(velocity, 0.0) + more;
            prop_assert!(sum.abs() <= FRICTION.coulomb * (1.0 + 1e-12), "{sum}");
        }
    }
}
