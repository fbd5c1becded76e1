//! The motion that a torque law gives an arm within its limits: where joints are light, less of the law, in its own direction.
//!
//! ```text
//! u = g + h - D qd                               the law (10.74), (10.84): h attracts to the goal, D damps
//! qdd = B^-1 (u - C qd - g)                      the law as it is; limits cut it joint by joint
//! qdd = (B + T D)^-1 (s h - D qd - C qd)         where D is too stiff for a tick or for T: s h, 0 <= s <= 1, attracts as much as every joint can obey
//! ```
//! Limits that cut each joint's acceleration by itself turn the motion into another direction, which heavy arms bear: a light wrist is accelerated as much as the heavy shoulder, and
//! swings ever farther about its goal. The attraction is lessened as a whole instead, as by a law that is less stiff, and the damping stays. `T D` is the damping at the end of the
//! time T in which an acceleration builds up within the limits of jerk: what is damped more quickly would be braked beyond standstill.

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
/// Longest time in which the acceleration of such a law builds up, s: where limits of jerk take longer, less acceleration is used. Chosen by hand: with 0.1 the law of scara-c still
/// swings away at a jerk of 10 rad/s^3, with 0.05 all nine arms and laws come to their goals.
const LONGEST_BUILD_UP_S: f64 = 0.05;
/// Time before its velocity limit in which a joint is accelerated less and less, s. Chosen by hand: twice the 20 ms in which the acceleration of the shipped run files falls
/// to zero within their jerk.
const SLOWS_DOWN_S: f64 = 0.04;
/// Rate at which motions of the joints that do not move the camera are damped, 1/s. Chosen by hand: they fall to 5 % in 0.6 s, as quickly as the shipped arms settle.
const STILL_1_S: f64 = 5.0;

/// The acceleration (rad/s^2 or m/s^2) of an arm at `q` and `qd` under the torques `tau` (N m or N) of a law with the damping of the joints `damping` (N m s/rad or
/// N s/m). It exceeds the limits only where what brakes the arm does by itself.
pub(super) fn law_acceleration<const N: usize>(
    ArmModel { robot, limits }: &ArmModel<N>,
    (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
    tau: &SVector<f64, N>,
    damping: &SMatrix<f64, N, N>,
) -> SVector<f64, N> {
    let B = robot.mass_matrix(q);
    let T_s = (0..N).map(|i| limits.acceleration[i] / limits.jerk[i]).fold(TICK.as_s(), f64::max);
    let slowest_s = (TICK.as_s() / TOO_STIFF).max(T_s / TOO_STIFF_FOR_JERK);
    let T_s = T_s.min(LONGEST_BUILD_UP_S);
    let is_slow = (0..N).all(|i| damping[(i, i)] * slowest_s <= B[(i, i)]);
    let damped = if is_slow { None } else { Ldlt::of(&(B + damping * T_s)) };
    let Some(factors) = damped else { return robot.forward_dynamics(q, qd, tau) };
    let bounds: [_; N] = std::array::from_fn(|i| bounds(limits, qd[i], i));
    let solve = |torque: SVector<f64, N>| SVector::from(factors.solve(&torque.into()));
    let (gravity, damped) = (robot.gravity(q), damping * qd);
    let attracted = solve(tau - gravity + damped);
    let kept = solve(gravity - robot.inverse_dynamics(q, qd, &SVector::zeros()) - damped);
    let shares = bounds.iter().zip(attracted.iter().zip(kept.iter())).map(share);
    attracted * shares.fold(1.0, f64::min) + kept
}

/// The acceleration (rad/s^2 or m/s^2) that damps what the joints do at `qd` beside moving the camera, of which a law knows nothing: those of more than six joints.
pub(super) fn stilled<const N: usize>(qd: &SVector<f64, N>, J: &CameraJacobian<N>) -> SVector<f64, N> {
    if J.moving_joints() <= 6 {
        return SVector::zeros();
    }
    let all = TwistTask { matrix: Matrix6::identity(), vector: Vector6::zeros(), error: 0.0 };
    seek_null_motion(&all, J, qd).map_or_else(SVector::zeros, |free| free * -STILL_1_S)
}

/// From where to where the acceleration of joint `i` may be at its velocity `qd`.
fn bounds<const N: usize>(limits: &MotionLimits<N>, qd: f64, i: usize) -> (f64, f64) {
    let most = limits.acceleration[i].min(limits.jerk[i] * LONGEST_BUILD_UP_S);
    let fastest = limits.velocity[i];
    let to = |sign: f64| most.min((fastest - sign * qd) / SLOWS_DOWN_S);
    (-to(-1.0), to(1.0))
}

/// The share of what attracts a joint with which, beside what is `kept`, its acceleration stays within its bounds; what is kept may exceed them by itself.
fn share(((from, to), (attracted, kept)): (&(f64, f64), (&f64, &f64))) -> f64 {
    let room = if *attracted > 0.0 { to - kept } else { kept - from };
    let share = room / attracted.abs();
    // nothing attracts: 0 / 0
    if share.is_nan() { 1.0 } else { share.max(0.0) }
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

        /// The damping as it is, and of the attraction one share for all joints, as much as the first of them can obey.
        #[test]
        fn what_attracts_is_lessened_and_not_turned(
            dq in prop::array::uniform7(-0.4..0.4_f64),
            qd in prop::array::uniform7(-0.6..0.6_f64),
            wrench in prop::array::uniform6(-300.0..300.0_f64),
            stiffness in 1.0..500.0_f64,
        ) {
            let (arm, mount) = panda();
            let q = vector([0.0, -0.5, 0.0, -2.1, 0.0, 1.6, 0.8]) + vector(dq);
            let qd = vector(qd);
            let (_, J) = mount.camera(&arm.robot, &q);
            let J = J.matrix();
            let damping = J.tr_mul(&(J * stiffness));
            let attraction = J.tr_mul(&Vector6::from(wrench));
            let tau = arm.robot.gravity(&q) + attraction - damping * qd;
            let found = law_acceleration(&arm, (&q, &qd), &tau, &damping);
            let exact = arm.robot.forward_dynamics(&q, &qd, &tau);
            if found == exact {
                return Ok(());
            }
            // B qdd + C qd + D (qd + T qdd) is a share of what attracts.
            let T_s = arm.limits.acceleration[0] / arm.limits.jerk[0];
            let left = arm.robot.inverse_dynamics(&q, &qd, &found) - arm.robot.gravity(&q)
                + damping * (qd + found * T_s);
            let share = left.dot(&attraction) / attraction.norm_squared();
            prop_assert!((left - attraction * share).norm() < 1e-6 * attraction.norm(), "{left} {attraction}");
            prop_assert!((-1e-9..1.0 + 1e-9).contains(&share), "{share}");
            // Either all of it, or one joint at a bound, or braking by itself beyond one.
            let at_bound = (0..7).any(|i| {
                let (from, to) = bounds(&arm.limits, qd[i], i);
                found[i] >= to - 1e-6 || found[i] <= from + 1e-6
            });
            prop_assert!(share > 1.0 - 1e-9 || at_bound, "{share} {found}");
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
    fn a_law_that_ticks_can_follow_stays_as_it_is() {
        let (arm, mount) = panda();
        let q = vector([0.1, -0.5, 0.2, -2.1, 0.3, 1.6, 0.8]);
        let qd = vector([0.01; 7]);
        let (_, J) = mount.camera(&arm.robot, &q);
        let damping = J.matrix().tr_mul(&(J.matrix() * 0.01));
        let tau = arm.robot.gravity(&q) + J.matrix().tr_mul(&Vector6::repeat(0.01)) - damping * qd;
        let exact = arm.robot.forward_dynamics(&q, &qd, &tau);
        assert_eq!(law_acceleration(&arm, (&q, &qd), &tau, &damping), exact);
    }
}
