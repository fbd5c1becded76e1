//! Schemes A and B: position-based laws, (10.68)-(10.77), as a task for the camera's twist.
//!
//! Data flow: the pose `X_CO` of the view (or one from its image points: for m = 4, or up to scale by a homography) and the desired pose `X_DO` give the operational space error x~; scheme A
//! makes a wrench of it, scheme B a twist, both expressed in C.
//!
//! With the camera's twist expressed in C instead of B, (10.71) reads `x~_dot = -E V_WC_C`,
//! `E = T_A^-1(phi_dc) diag(R_DC, R_DC)`, and `J_Ad = E J` is (10.73). Both mounts and m = 4 follow from J alone.

use super::{
    Displacement, GainMatrix, OrientationError, SetPoint, TwistTask, View, WrenchTask, fit_similarity,
};
use crate::features::NormalEquations;
use crate::geometry::{Pose, rotation_z};
use nalgebra::{Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};

/// Gains of x, y, z and of the three numbers of the orientation error, 6 x 6.
pub type PoseGains = GainMatrix<6>;

/// The diagonal `{x, y, z, alpha}` of m = 4 for all three numbers of the orientation.
#[must_use]
pub fn pose_gains_4(gains: &[f64; 4]) -> PoseGains {
    let [x, y, z, alpha] = *gains;
    Vector6::new(x, y, z, alpha, alpha, alpha).into()
}

/// Where the pose of a position-based law comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OperationalSpace {
    /// m = 6: the pose that comes with the view.
    Six,
    /// m = 4, (10.33): x, y, z and a rotation about the optical axis, from two and more image points of a plane that is
    /// parallel to the image. The optimum of (10.36) in closed form.
    Four,
    /// m = 6, up to scale, by the closing remark of Sect. 10.8: the displacement from the desired camera, by the homography between the desired image and this one. Lengths
    /// are those of the desired pose, whatever the object's size: the position error is too large or too small by the ratio of both, and zero at the goal.
    Homography,
}

/// By what an arm with fewer than six joints before the camera, which cannot follow each twist of scheme B, follows one as nearly as it can.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TwistWeights {
    /// By the six numbers of the twist alike, m/s and rad/s: a pseudo-inverse of (10.73).
    #[default]
    Unit,
    /// By the motion of the target's image that the twist causes. A tilt of the measured pose comes with a displacement of the camera, by the distance of the target times the
    /// angle, and both together hardly move the image. An arm that cannot tilt its camera would follow the displacement alone, and what is wrong with the measured tilt
    /// would move the image by as much as the tilt does not.
    Image,
}

/// The operational space error of (10.69).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OperationalSpaceError {
    /// x~ = -[p_DC_D; phi_dc], m and rad.
    pub x: Vector6<f64>,
    /// Orientation of the camera in the desired frame.
    pub R_DC: Rotation3<f64>,
    orientation: OrientationError,
}

impl OperationalSpaceError {
    /// x~ of (10.68), (10.69) for an object at `X_CO` with the desired pose `X_DO`.
    #[must_use]
    pub fn new(X_DO: &Pose, X_CO: &Pose, orientation: OrientationError) -> Self {
        let R_DC = X_DO.rotation.to_rotation_matrix() * X_CO.rotation.to_rotation_matrix().inverse();
        let p = X_DO.translation.vector - R_DC * X_CO.translation.vector;
        let phi = orientation.of(&R_DC);
        Self { x: -Vector6::new(p.x, p.y, p.z, phi.x, phi.y, phi.z), R_DC, orientation }
    }

    fn phi_dc(&self) -> Vector3<f64> {
        Vector3::new(-self.x[3], -self.x[4], -self.x[5])
    }

    /// E, 6 x 6, with `x~_dot = -E V_WC_C`, (10.71), so that `J_Ad = E J`, (10.73). `None` where the orientation error has
    /// no rate ([`OrientationError::inverse_rate`]).
    #[must_use]
    pub fn rate(&self) -> Option<Matrix6<f64>> {
        let mut E = Matrix6::zeros();
        E.fixed_view_mut::<3, 3>(0, 0).copy_from(self.R_DC.matrix());
        let angular = self.orientation.inverse_rate(&self.phi_dc(), &self.R_DC)? * self.R_DC;
        E.fixed_view_mut::<3, 3>(3, 3).copy_from(&angular);
        Some(E)
    }

    /// Scheme B: the camera twist `E^-1 K x~` of (10.76), expressed in C, m/s and rad/s. `None` where there is no
    /// angular velocity for the error's rate ([`OrientationError::rate`]).
    #[must_use]
    pub fn twist(&self, K_1_s: &PoseGains) -> Option<Vector6<f64>> {
        let y = K_1_s.times(&self.x);
        let R_CD = self.R_DC.transpose();
        let v = R_CD * y.fixed_rows::<3>(0);
        let w = R_CD * (self.orientation.rate(&self.phi_dc(), &self.R_DC)? * y.fixed_rows::<3>(3));
        Some(Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z))
    }

    /// Scheme B as a task for the joints: [`OperationalSpaceError::twist`] with the weights `matrix` of its directions, 6 x 6: the identity, or [`image_weights`].
    #[must_use]
    pub fn twist_task(&self, K_1_s: &PoseGains, matrix: Matrix6<f64>) -> Option<TwistTask> {
        Some(TwistTask { matrix, vector: matrix * self.twist(K_1_s)?, error: self.x.norm() })
    }

    /// Scheme A: wrench `E^T K_P x~` and damping `E^T K_D E` of (10.74). Gains in N/m, N m/rad and N s/m, N m s/rad.
    ///
    /// `None` as for [`OperationalSpaceError::rate`].
    #[must_use]
    pub fn wrench(&self, K_P: &PoseGains, K_D: &PoseGains) -> Option<WrenchTask> {
        let E = self.rate()?;
        Some(WrenchTask { wrench: E.tr_mul(&K_P.times(&self.x)), damping: E.tr_mul(&(K_D.matrix() * E)) })
    }
}

/// The pose `X_CO` that a position-based law works with; `None` when the view does not give it.
#[must_use]
pub fn operational_pose(set_point: &SetPoint, view: &View, space: OperationalSpace) -> Option<Pose> {
    if view.features().len() != set_point.features().len() {
        return None;
    }
    match space {
        OperationalSpace::Six => view.X_CO().copied(),
        OperationalSpace::Four => planar_pose_4(set_point, view),
        OperationalSpace::Homography => displaced_pose(set_point, view),
    }
}

/// `X_CO = X_CD X_DO` with the displacement `X_CD` of the camera from the homography, in units of the distance of the plane from the desired camera, which the
/// desired pose tells.
fn displaced_pose(set_point: &SetPoint, view: &View) -> Option<Pose> {
    let displacement = Displacement::new(set_point, view, OperationalSpace::Homography)?;
    let i = set_point.selection().points().find(|i| view.feature(*i).is_some())?;
    let (s_d, z_d) = (set_point.features().get(i)?, set_point.depths_m().get(i)?);
    let d_d = z_d * displacement.n_D.dot(&s_d.push(1.0));
    let R_CD = UnitQuaternion::from_rotation_matrix(&displacement.R_CD);
    let X_CD = Pose::from_parts((displacement.p_CD_C_over_d * d_d).into(), R_CD);
    Some(X_CD * set_point.X_DO()?)
}

/// The sum of `L^T L` over `points_O`, which stand at `X_CO` before the camera, with the interaction matrices L of (10.27), 6 x 6: the squared motion of the image that
/// twists cause. `None` where a point is not before the camera.
#[must_use]
pub fn image_weights(points_O: &[Point3<f64>], X_CO: &Pose) -> Option<Matrix6<f64>> {
    let mut equations = NormalEquations::<6>::new();
    for p_O in points_O {
        let p_C = X_CO * p_O;
        // The comparison also catches NaN.
        if !(p_C.z > 0.0) {
            return None;
        }
        equations.add_point(&(p_C.coords.xy() / p_C.z), p_C.z, &Vector2::zeros(), 1.0);
    }
    Some(equations.matrix())
}

/// `X_CO` with `R_CO = Rz(alpha)` from the visible points of the selection, which must have one height over O.
fn planar_pose_4(set_point: &SetPoint, view: &View) -> Option<Pose> {
    let point = |i: usize| Some((*set_point.points().get(i)?, *view.feature(i)?));
    let seen = set_point.selection().points().filter_map(point);
    let height_m = seen.clone().next()?.0.z;
    // A nanometre: heights that are written equal differ by rounding alone.
    if !seen.clone().all(|(p, _)| (p.z - height_m).abs() <= 1e-9) {
        return None;
    }
    let pairs = seen.map(|(p, s)| (p.coords.xy(), s));
    let fit = fit_similarity(pairs)?;
    let z_m = 1.0 / fit.scale;
    Some(Pose::from_parts(
        Translation3::new(fit.offset.x * z_m, fit.offset.y * z_m, z_m - height_m),
        UnitQuaternion::from_rotation_matrix(&rotation_z(fit.angle_rad)),
    ))
}
