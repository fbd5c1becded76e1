//! The image of a corner of one view, and how it moves with everything unknown.
//!
//! ```text
//! P_W = X_WO p_O        P_M: seen from the frame that bears the camera        P_C = X_MC^-1 P_M        px = camera(P_C)
//!
//! in hand:        P_M = exp(V tau)^-1 X_BE'^-1 P_W           X_BE' = X_BE D_i: the flange as it really was
//! beside the arm: P_M = X_BE' exp(V tau) P_W                 V: its twist in E; tau: what is to be added to the camera's stamp
//! ```
//! Small changes are `[v; w]`: of `X_MC` position and left rotation along the axes of M, `p + v` and `exp(w) R`; of `X_WO` the same along
//! those of W; of `X_BE'` a twist in E (from the right).

use super::{BoardCorner, CameraMount};
use crate::camera_model::CameraModel;
use crate::geometry::{Pose, Twist, integrate_body_twist, skew};
use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3};

/// Unknowns of all views together: `X_MC`, `X_WO`, tau; 6 + 6 + 1, and tau's place follows.
pub(super) const GLOBAL: usize = 13;
pub(super) const TIME: usize = GLOBAL - 1;
/// The place of `X_WO`. Derived: it follows the six of `X_MC`.
pub(super) const BOARD: usize = 6;
/// With those of one view: the twist of its `X_BE'`, which needs six.
pub(super) const ALL: usize = GLOBAL + 6;

/// Everything unknown.
#[derive(Debug, Clone)]
pub(super) struct HandEyeUnknowns {
    pub X_MC: Pose,
    pub X_WO: Pose,
    /// What has to be added to the camera's stamps, s: the image shows the flange where it is so much after the stated pose.
    pub offset_s: f64,
    /// The flange in the base as it really was, view by view.
    pub arm: Vec<Pose>,
}

/// What is known of the arm in one view.
#[derive(Debug, Clone, Copy)]
pub(super) struct ArmAt {
    pub place: CameraMount,
    /// Its corrected pose.
    pub X_BE: Pose,
    pub V_BE_E: Twist,
}

/// `[v; w]` from the left: p + v, exp(w) R.
pub(super) fn moved(X: &Pose, d: &SVector<f64, 6>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(d.fixed_rows::<3>(3).into_owned());
    let mut rotation = turn * X.rotation;
    rotation.renormalize();
    Pose::from_parts(Translation3::from(X.translation.vector + d.fixed_rows::<3>(0)), rotation)
}

/// `[v; w]` from the right: X (v, exp(w)).
pub(super) fn moved_inside(X: &Pose, d: &SVector<f64, 6>) -> Pose {
    let mut next = X * moved(&Pose::identity(), d);
    next.rotation.renormalize();
    next
}

/// The correction `D = X_BE^-1 X_BE'` as position and rotation vector, and its derivative by a twist of `X_BE'` from the right.
pub(super) fn correction(X_BE: &Pose, X_true: &Pose) -> (SVector<f64, 6>, Matrix6<f64>) {
    let D = X_BE.inv_mul(X_true);
    let turn = D.rotation.scaled_axis();
    let mut d = SVector::<f64, 6>::zeros();
    d.fixed_rows_mut::<3>(0).copy_from(&D.translation.vector);
    d.fixed_rows_mut::<3>(3).copy_from(&turn);
    let mut slope = Matrix6::zeros();
    slope.fixed_view_mut::<3, 3>(0, 0).copy_from(D.rotation.to_rotation_matrix().matrix());
    slope.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation_vector_slope(&turn));
    (d, slope)
}

/// Derivative of the rotation vector by a small turn from the right: `I + S/2 + (1/t^2 - (1 + cos t) / (2 t sin t)) S^2`.
fn rotation_vector_slope(turn: &Vector3<f64>) -> Matrix3<f64> {
    let (S, t2) = (skew(turn), turn.norm_squared());
    let t = t2.sqrt();
    // Below, the third term of the series, t^4 / 30240, is 3e-13, and the closed form would have lost as many digits to cancellation.
    let c = if t < 1e-2 { 1.0 / 12.0 + t2 / 720.0 } else { 1.0 / t2 - (1.0 + t.cos()) / (2.0 * t * t.sin()) };
    Matrix3::identity() + S * 0.5 + S * S * c
}

/// The flange at the time of the image, and the board in the camera.
pub(super) fn board_in_camera(X_MC: &Pose, X_WO: &Pose, arm: &ArmAt, offset_s: f64) -> Pose {
    let X_BE = integrate_body_twist(&arm.X_BE, &arm.V_BE_E, offset_s);
    (arm.place.X_WM(&X_BE) * X_MC).inv_mul(X_WO)
}

/// What all corners of a view share.
pub(super) struct ViewRows {
    arm: ArmAt,
    X_WO: Pose,
    X_CM: Pose,
    p_MC_M: Vector3<f64>,
    /// exp(V tau).
    on_the_way: Pose,
    /// From W to M.
    X_MW: Pose,
    R_CM: Matrix3<f64>,
    R_MW: Matrix3<f64>,
    /// What turns a twist of `X_BE'` into M.
    R_ME: Matrix3<f64>,
}

/// A corner's predicted image, and its derivatives by the global unknowns and, behind them, by the twist of `X_BE'`.
pub(super) struct CornerRows {
    pub px: Vector2<f64>,
    pub by: SMatrix<f64, 2, ALL>,
}

impl ViewRows {
    pub(super) fn new(X_MC: &Pose, X_WO: &Pose, arm: ArmAt, offset_s: f64) -> Self {
        let on_the_way = integrate_body_twist(&Pose::identity(), &arm.V_BE_E, offset_s);
        let X_MW = arm.place.X_WM(&(arm.X_BE * on_the_way)).inverse();
        let X_CM = X_MC.inverse();
        let R = |X: &Pose| *X.rotation.to_rotation_matrix().matrix();
        let R_ME = match arm.place {
            CameraMount::EyeInHand => R(&on_the_way).transpose(),
            CameraMount::EyeToHand => R(&arm.X_BE),
        };
        let (R_CM, R_MW, p_MC_M) = (R(&X_CM), R(&X_MW), X_MC.translation.vector);
        Self { arm, X_WO: *X_WO, X_CM, p_MC_M, on_the_way, X_MW, R_CM, R_MW, R_ME }
    }

    /// The predicted image alone; `None` behind the camera, or beyond the lens's fold.
    pub(super) fn image(&self, corner: &BoardCorner, camera: &CameraModel) -> Option<Vector2<f64>> {
        camera.project(&(self.X_CM * (self.X_MW * (self.X_WO * corner.p_O))))
    }

    /// The predicted image with its derivatives.
    pub(super) fn rows(&self, corner: &BoardCorner, camera: &CameraModel) -> Option<CornerRows> {
        let turned_O = self.X_WO.rotation * corner.p_O.coords;
        let P_W = self.X_WO * corner.p_O;
        let P_M = self.X_MW * P_W;
        let P_C: Point3<f64> = self.X_CM * P_M;
        let px = camera.project(&P_C)?;
        let s = P_C.coords.xy() / P_C.z;
        let plane = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -s.x, 0.0, 1.0, -s.y) / P_C.z;
        // by P_C, by P_M and by P_W
        let by_C = camera.pixel_jacobian(&s) * plane;
        let by_M = by_C * self.R_CM;
        let by_W = by_M * self.R_MW;
        let by_E = by_M * self.R_ME;
        let mut by = SMatrix::<f64, 2, ALL>::zeros();
        by.fixed_view_mut::<2, 3>(0, 0).copy_from(&-by_M);
        by.fixed_view_mut::<2, 3>(0, 3).copy_from(&(by_M * skew(&(P_M.coords - self.p_MC_M))));
        by.fixed_view_mut::<2, 3>(0, 6).copy_from(&by_W);
        by.fixed_view_mut::<2, 3>(0, 9).copy_from(&(by_W * -skew(&turned_O)));
        let V = &self.arm.V_BE_E;
        let (v, w) = (Vector3::new(V[0], V[1], V[2]), Vector3::new(V[3], V[4], V[5]));
        let flow = |P: &Vector3<f64>| v + w.cross(P);
        // Q: the point in E at the robot's stamp
        let (sign, Q) = match self.arm.place {
            CameraMount::EyeInHand => {
                // P_M = exp(V tau)^-1 Q, Q = X_BE'^-1 P_W
                by.set_column(TIME, &(by_M * -flow(&P_M.coords)));
                (-1.0, self.on_the_way * P_M)
            }
            CameraMount::EyeToHand => {
                // P_M = X_BE' Q, Q = exp(V tau) P_W
                let Q = self.on_the_way * P_W;
                by.set_column(TIME, &(by_E * flow(&Q.coords)));
                (1.0, Q)
            }
        };
        by.fixed_view_mut::<2, 3>(0, GLOBAL).copy_from(&(by_E * sign));
        by.fixed_view_mut::<2, 3>(0, GLOBAL + 3).copy_from(&(by_E * skew(&Q.coords) * -sign));
        Some(CornerRows { px, by })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera, pose};
    use super::*;
    use proptest::prelude::*;

    fn image(X: &Pose, Z: &Pose, arm: &ArmAt, offset_s: f64, p_O: &Point3<f64>) -> Vector2<f64> {
        camera().project(&(board_in_camera(X, Z, arm, offset_s) * p_O)).unwrap()
    }

    proptest! {
        /// Every column against central differences of the chain of poses, for both places of the eye.
        #[test]
        fn rows_are_derivatives(
            x in prop::array::uniform6(-0.6..0.6f64), h in prop::array::uniform6(-1.0..1.0f64),
            c in prop::array::uniform6(-0.2..0.2f64), v in prop::array::uniform6(-0.5..0.5f64),
            offset_s in -0.05..0.05f64, beside in any::<bool>()
        ) {
            let place = if beside { CameraMount::EyeToHand } else { CameraMount::EyeInHand };
            let (X, X_BE) = (pose(x), pose(h));
            let arm = ArmAt { place, X_BE, V_BE_E: Twist::from_row_slice(&v) };
            let X_CO = Pose::translation(0.0, 0.0, 0.8) * pose(c);
            let now = integrate_body_twist(&X_BE, &arm.V_BE_E, offset_s);
            let Z = place.X_WM(&now) * X * X_CO;
            let corner = BoardCorner { p_O: Point3::new(0.05, -0.03, 0.01), px: Vector2::zeros(), sd_px: 1.0 };
            let rows = ViewRows::new(&X, &Z, arm, offset_s).rows(&corner, &camera()).unwrap();
            prop_assert!((rows.px - image(&X, &Z, &arm, offset_s, &corner.p_O)).norm() < 1e-8);
            let step = 1e-6;
            let both = |of: &dyn Fn(f64) -> Vector2<f64>| (of(step) - of(-step)) / (2.0 * step);
            for k in 0..6 {
                let d = |a: f64| SVector::<f64, 6>::from_fn(|i, _| if i == k { a } else { 0.0 });
                let by_X = both(&|a| image(&moved(&X, &d(a)), &Z, &arm, offset_s, &corner.p_O));
                let by_Z = both(&|a| image(&X, &moved(&Z, &d(a)), &arm, offset_s, &corner.p_O));
                let by_arm = both(&|a| {
                    let arm = ArmAt { X_BE: moved_inside(&X_BE, &d(a)), ..arm };
                    image(&X, &Z, &arm, offset_s, &corner.p_O)
                });
                prop_assert!((rows.by.column(k) - by_X).norm() < 1e-4 * (1.0 + by_X.norm()), "X {k}");
                prop_assert!((rows.by.column(6 + k) - by_Z).norm() < 1e-4 * (1.0 + by_Z.norm()), "Z {k}");
                prop_assert!((rows.by.column(GLOBAL + k) - by_arm).norm() < 1e-4 * (1.0 + by_arm.norm()), "arm {k}");
            }
            let by_time = both(&|a| image(&X, &Z, &arm, offset_s + a, &corner.p_O));
            prop_assert!((rows.by.column(TIME) - by_time).norm() < 1e-4 * (1.0 + by_time.norm()), "tau");
        }

        #[test]
        fn corrections_are_told_with_their_derivative(h in prop::array::uniform6(-1.0..1.0f64), d in prop::array::uniform6(-0.4..0.4f64)) {
            let X = pose(h);
            let there = moved_inside(&X, &SVector::from_row_slice(&d));
            let (found, slope) = correction(&X, &there);
            prop_assert!((found - SVector::<f64, 6>::from_row_slice(&d)).norm() < 1e-12);
            for k in 0..6 {
                let at = |a: f64| {
                    let d = SVector::<f64, 6>::from_fn(|i, _| if i == k { a } else { 0.0 });
                    correction(&X, &moved_inside(&there, &d)).0
                };
                let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
                prop_assert!((numeric - slope.column(k)).norm() < 1e-7, "{k}");
            }
        }
    }
}
