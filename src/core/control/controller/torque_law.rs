//! The motion that a torque law gives an arm within its limits: where its damping is quick, the velocity at which it balances what attracts.
//!
//! ```text
//! u = g + h - D qd                    the law (10.74), (10.84): h attracts to the goal, D damps
//! B qdd = u - C qd - g                the law as it is, which limits cut joint by joint
//! (D + B / T) qd = h                  where D is too stiff for a tick, or for the jerk: the velocity to which it settles, as a velocity law's
//! ```
//! Limits that cut each joint's acceleration by itself turn the motion into another direction, which heavy arms bear: a light wrist is accelerated as much as the heavy shoulder, and
//! swings ever farther about its goal. Where the damping settles within a tick, inertia shows in nothing that the limits let through. What is left of the law is the velocity at which damping and
//! attraction balance, and that is slowed down as a whole, so that the arm can brake before its goal, and the camera keeps its way. `B / T` bounds it where little damps.

use crate::control::behaviour::ArmModel;
use crate::linalg::Ldlt;
use crate::motion::MotionLimits;
use crate::robot::CameraJacobian;
use crate::servo::{TwistTask, seek_null_motion};
use crate::time::TICK;
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// Damping within a tick, as share of the inertia, from which on the law cannot be followed tick by tick. Derived: `qd -> (1 - share) qd` overshoots from 1 on and
/// grows from 2 on; half of the first.
const TOO_STIFF: f64 = 0.5;
/// The same within the time in which an acceleration builds up. Chosen by hand: with accelerations of 10 rad/s^2 and jerks of 10 to 500 rad/s^3 the laws of the SCARA's files, which have 0.6 to 1 at 500, swing
/// ever farther from 100 (C) and from 50 (A) down, with 3 to 5 and 6 to 10, and at 200 they do not.
const TOO_STIFF_FOR_JERK: f64 = 3.0;
/// Time in which an arm gains a velocity that nothing damps, s. Chosen by hand: ten times the braking of the shipped arms, so that it counts only where the damping does not; with 0.2 s the laws of the text's gains,
/// which damp a UR5 in 0.1 s, take twice as long.
const GAINED_IN_S: f64 = 2.0;
/// Rate at which motions of the joints that do not move the camera are damped, 1/s. Chosen by hand: they fall to 5 % in 0.6 s, as quickly as the shipped arms settle.
const STILL_1_S: f64 = 5.0;

/// The joint velocity (rad/s or m/s) to which an arm at `q` and `qd` settles under the torques `tau` (N m or N) of a law with the damping of the joints `damping` (N m s/rad or
/// N s/m). `None` where it settles slowly enough to be followed tick by tick.
pub(super) fn settled_velocity<const N: usize>(
    ArmModel { robot, limits }: &ArmModel<N>,
    (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
    tau: &SVector<f64, N>,
    damping: &SMatrix<f64, N, N>,
) -> Option<SVector<f64, N>> {
    let B = robot.mass_matrix(q);
    let slowest_s = slowest_s(limits);
    if (0..N).all(|i| damping[(i, i)] * slowest_s <= B[(i, i)]) {
        return None;
    }
    let factors = Ldlt::of(&(damping + B / GAINED_IN_S))?;
    let attraction = tau - robot.gravity(q) + damping * qd;
    Some(factors.solve(&attraction.into()).into())
}

/// Least time constant of a damping that can be followed, s.
fn slowest_s<const N: usize>(limits: &MotionLimits<N>) -> f64 {
    let builds_up_s = (0..N).map(|i| limits.acceleration[i] / limits.jerk[i]).fold(TICK.as_s(), f64::max);
    (TICK.as_s() / TOO_STIFF).max(builds_up_s / TOO_STIFF_FOR_JERK)
}

/// The acceleration (rad/s^2 or m/s^2) that damps what the joints do at `qd` beside moving the camera, of which a law knows nothing: those of more than six joints.
pub(super) fn stilled<const N: usize>(qd: &SVector<f64, N>, J: &CameraJacobian<N>) -> SVector<f64, N> {
    if J.moving_joints() <= 6 {
        return SVector::zeros();
    }
    let all = TwistTask { matrix: Matrix6::identity(), vector: Vector6::zeros(), error: 0.0 };
    seek_null_motion(&all, J, qd).map_or_else(SVector::zeros, |free| free * -STILL_1_S)
}

/// Mean time for which a joint under a torque law is at most assumed to have accelerated, s: its mean speed over the 0.4 s in which joints must
/// follow (`control/safety/arm.rs`) is, from rest, the acceleration times half of that time.
const START_S: f64 = 0.2;

/// The speeds that joints should have which a torque law pushes and which stand, rad/s or m/s. A law whose view is noisy pushes forth and back, and each push begins anew: taken for pushes of 0.2 s, those of
/// 1 px made free joints of scara-a and scara-c ones that do not follow.
#[derive(Debug, Clone)]
pub(super) struct Pushes<const N: usize>(SVector<f64, N>);

impl<const N: usize> Default for Pushes<N> {
    fn default() -> Self {
        Self(SVector::zeros())
    }
}

impl<const N: usize> Pushes<N> {
    /// Takes in the accelerations of a tick, rad/s^2 or m/s^2, 0 of joints that are not pushed or move; the displacement that each joint should make in it, rad or m.
    pub(super) fn way(&mut self, pushed: &SVector<f64, N>) -> SVector<f64, N> {
        self.0.zip_apply(pushed, |speed, pushed| {
            let begun = if *speed * pushed > 0.0 { speed.abs() } else { 0.0 };
            let most = pushed.abs() * START_S;
            *speed = pushed.signum() * (begun + pushed.abs() * TICK.as_s()).min(most);
        });
        self.0 * TICK.as_s()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Mount, Robot};
    use proptest::prelude::*;

    fn panda() -> (ArmModel<7>, Mount) {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/panda.toml");
        let config = crate::config::Config::load(Some(&path), &[]).unwrap();
        let robot: Robot<7> = config.robot.build().unwrap();
        let limits = crate::config::assemble::motion_limits(&config, &robot).unwrap();
        (ArmModel { robot, limits }, config.camera.mount)
    }

    fn vector(values: [f64; 7]) -> SVector<f64, 7> {
        values.into()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// It is where the arm comes to under the law itself without limits, the time constants of the damping later, but for what inertia adds; and it does not depend on how fast the arm is.
        #[test]
        fn the_velocity_is_the_one_at_which_the_law_balances(
            dq in prop::array::uniform7(-0.4..0.4_f64),
            qd in prop::array::uniform7(-0.6..0.6_f64),
            wrench in prop::array::uniform6(-300.0..300.0_f64),
            stiffness in 300.0..3000.0_f64,
        ) {
            let (arm, mount) = panda();
            let q = vector([0.0, -0.5, 0.0, -2.1, 0.0, 1.6, 0.8]) + vector(dq);
            let qd = vector(qd);
            let (_, J) = mount.camera(&arm.robot, &q);
            let J = J.matrix();
            let damping = J.tr_mul(&(J * stiffness));
            let attraction = J.tr_mul(&Vector6::from(wrench));
            let law = |qd: &SVector<f64, 7>| arm.robot.gravity(&q) + attraction - damping * qd;
            let settled = settled_velocity(&arm, (&q, &qd), &law(&qd), &damping).unwrap();
            let resting = SVector::zeros();
            let from_rest = settled_velocity(&arm, (&q, &resting), &law(&resting), &damping).unwrap();
            prop_assert!((settled - from_rest).norm() < 1e-6 * (1.0 + settled.norm()));
            // The camera goes as fast as its damping lets it: D V = w in directions that the damping rules.
            let left = attraction - damping * settled;
            let inertial = arm.robot.mass_matrix(&q) * settled / GAINED_IN_S;
            prop_assert!((left - inertial).norm() < 1e-9 * attraction.norm().max(1.0), "{left} {inertial}");
        }

        #[test]
        fn what_does_not_move_the_camera_is_stilled(qd in prop::array::uniform7(-1.0..1.0_f64)) {
            let (arm, mount) = panda();
            let q = vector([0.1, -0.5, 0.2, -2.1, 0.3, 1.6, 0.8]);
            let (_, J) = mount.camera(&arm.robot, &q);
            let still = stilled(&vector(qd), &J);
            prop_assert!((J.matrix() * still).norm() < 1e-4 * still.norm(), "the camera is left alone");
            prop_assert!(still.dot(&vector(qd)) <= 0.0);
        }
    }

    #[test]
    fn pushes_forth_and_back_move_little() {
        let farthest = |period: u32| {
            let (mut pushes, mut gone, mut most) = (Pushes::<1>::default(), 0.0, 0.0_f64);
            for k in 0..400 {
                let sign = if (k / period).is_multiple_of(2) { 1.0 } else { -1.0 };
                gone += pushes.way(&SVector::repeat(2.0 * sign))[0];
                most = most.max(gone.abs());
            }
            most
        };
        assert!((farthest(40) - 0.5 * 2.0 * 0.04_f64.powi(2)).abs() < 1e-4, "a push of 40 ms");
        // From rest to the speed after 0.2 s, and on with that.
        assert!((farthest(400) - (0.04 + 0.4 * 0.2)).abs() < 1e-3);
        let mut pushes = Pushes::<1>::default();
        (0..100).for_each(|_| _ = pushes.way(&SVector::repeat(2.0)));
        assert_eq!(pushes.way(&SVector::zeros())[0], 0.0, "one that moves or is let go");
    }

    #[test]
    fn a_law_that_ticks_can_follow_stays_as_it_is() {
        let (arm, mount) = panda();
        let q = vector([0.1, -0.5, 0.2, -2.1, 0.3, 1.6, 0.8]);
        let qd = vector([0.01; 7]);
        let (_, J) = mount.camera(&arm.robot, &q);
        let damping = J.matrix().tr_mul(&(J.matrix() * 0.01));
        let tau = arm.robot.gravity(&q) + J.matrix().tr_mul(&Vector6::repeat(0.01)) - damping * qd;
        assert_eq!(settled_velocity(&arm, (&q, &qd), &tau, &damping), None);
    }
}
