//! The first motion before a camera is slow, until the image was seen to move as it should ([`super::motion_agreement`]), or a decimetre is over: what is wrong about the mount is found out before the arm is fast.

use crate::geometry::Pose;
use crate::robot::CameraJacobian;
use nalgebra::SVector;

/// Displacement of the camera from which on its motion is not slowed down any more, once it was seen, m. Chosen by hand: ten times what a wrong mount is told by where nothing is hidden and
/// nothing leaps; a target that is so far away that its image has not moved by then is none that the arm comes to soon.
pub(super) const WAY_M: f64 = 0.1;
/// The same of its turn, rad. Derived: it moves the image as much as [`WAY_M`] does at [`REACH_M`].
const TURN: f64 = 0.2;
/// Distance at which a turn of the camera counts as much as its way, m. Chosen by hand: where targets mostly are.
pub(super) const REACH_M: f64 = 0.5;

/// Whether the first motion is over, and where it began.
#[derive(Debug, Clone, Default)]
pub(super) struct FirstMotion {
    from: Option<Pose>,
    is_over: bool,
}

impl FirstMotion {
    /// Takes in where the camera was at the exposure of a view.
    pub(super) fn note(&mut self, X_WC: &Pose) {
        if let Some(from) = self.from {
            let gone = from.inv_mul(X_WC);
            self.is_over |= gone.translation.vector.norm() > WAY_M || gone.rotation.angle() > TURN;
        }
    }

    /// The share of the joint velocity `qd` (rad/s or m/s) at which the camera, at `X_WC` with the Jacobian `J`, is no faster than `speed_m_s`; 1 once the first motion is over, of which `is_judged` is
    /// the earlier end.
    pub(super) fn share<const N: usize>(
        &mut self,
        qd: &SVector<f64, N>,
        (X_WC, J): (&Pose, &CameraJacobian<N>),
        speed_m_s: f64,
        is_judged: bool,
    ) -> f64 {
        self.from.get_or_insert(*X_WC);
        self.is_over |= is_judged;
        if self.is_over {
            return 1.0;
        }
        let V = J.matrix() * qd;
        let speed = V.fixed_rows::<3>(0).norm().max(V.fixed_rows::<3>(3).norm() * REACH_M);
        if speed > speed_m_s { speed_m_s / speed } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, Vector3, Vector6};

    #[test]
    fn the_first_decimetre_is_slow_and_what_is_judged_is_not() {
        let J = CameraJacobian::of_moving_camera(Matrix6::identity());
        let at = |m: f64| Pose::new(Vector3::x() * m, Vector3::zeros());
        let (fast, turns) =
            (Vector6::new(0.0, 0.3, 0.4, 0.0, 0.0, 0.0), Vector6::new(0.0, 0.0, 0.0, 0.4, 0.0, 0.3));
        let mut first = FirstMotion::default();
        assert_eq!(first.share(&fast, (&at(0.5), &J), 0.05, false), 0.1);
        assert_eq!(first.share(&(fast * 0.05), (&at(0.5), &J), 0.05, false), 1.0);
        assert_eq!(first.share(&turns, (&at(0.59), &J), 0.05, false), 0.2);
        let mut judged = first.clone();
        assert_eq!(judged.share(&fast, (&at(0.5), &J), 0.05, true), 1.0);
        assert_eq!(judged.share(&fast, (&at(0.5), &J), 0.05, false), 1.0);
        first.note(&at(0.59));
        assert_eq!(first.share(&fast, (&at(0.6), &J), 0.05, false), 0.1);
        first.note(&at(0.61));
        assert_eq!(first.share(&fast, (&at(0.5), &J), 0.05, false), 1.0);
    }
}
