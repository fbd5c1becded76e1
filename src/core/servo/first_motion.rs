//! The first motion before a camera is slow, until the image was seen to move as it should ([`super::motion_agreement`]): what is wrong about the mount is found out before the arm is fast.

use crate::robot::CameraJacobian;
use nalgebra::SVector;

/// Distance at which a point moves at the bounded speed by a turn of the camera, m. Chosen by hand: where targets mostly are.
const REACH_M: f64 = 0.5;

/// The share of the joint velocity `qd` (rad/s or m/s) at which a camera with the Jacobian `J` is no faster than `speed_m_s`.
pub(super) fn slow_share<const N: usize>(qd: &SVector<f64, N>, J: &CameraJacobian<N>, speed_m_s: f64) -> f64 {
    let V = J.matrix() * qd;
    let speed = V.fixed_rows::<3>(0).norm().max(V.fixed_rows::<3>(3).norm() * REACH_M);
    if speed > speed_m_s { speed_m_s / speed } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, Vector6};

    #[test]
    fn the_camera_is_no_faster_and_turns_no_faster_than_it_may() {
        let J = CameraJacobian::of_moving_camera(Matrix6::identity());
        let fast = Vector6::new(0.0, 0.3, 0.4, 0.0, 0.0, 0.0);
        let turns = Vector6::new(0.0, 0.0, 0.0, 0.4, 0.0, 0.3);
        assert_eq!(slow_share(&fast, &J, 0.05), 0.1);
        assert_eq!(slow_share(&(fast * 0.05), &J, 0.05), 1.0);
        assert_eq!(slow_share(&turns, &J, 0.05), 0.2);
    }
}
