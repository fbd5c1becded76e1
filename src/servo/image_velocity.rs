//! Image-based resolved velocity, (10.89)-(10.91): the joint velocity for which the features move as `s' = K_s e_s`.
//!
//! The k x 6 interaction matrix is never formed: each feature adds its rows to the 6 x 6 normal equations
//! `(L^T L) V = L^T K e`, and (10.90) brings them into joint space as `(J^T L^T L J) qd = J^T L^T K e`. With six
//! joints this is (10.90) after (10.91); with fewer it is the least-squares solution among the motions that the arm can
//! make, which for the SCARA and two points is (10.87) itself.

use super::{SetPoint, View};
use crate::features::{Ldlt, NormalEquations};
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// Conditioning below which directions are damped: the smaller of two squared ratios, the share of a column that the
/// others do not explain, and the smallest column against the largest.
const WEAKEST_DIRECTION: f64 = 1e-10;
/// Damping at a singularity, as share of the largest diagonal entry of the normal matrix.
const DAMPING: f64 = 1e-6;

/// Which depth goes into the interaction matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthSource {
    /// That of the desired pose.
    Desired,
    /// That of the estimated pose; of the desired one where a view has no pose.
    Estimated,
}

/// The normal equations of one view, for unit gain: all that the law needs of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageTask {
    /// L_s^T L_s.
    matrix: Matrix6<f64>,
    /// L_s^T e_s.
    vector: Vector6<f64>,
}

impl ImageTask {
    /// The task of bringing the features of `view` to the set-point, with the interaction matrix of the current
    /// features. `None` when the view does not have the set-point's features.
    #[must_use]
    pub fn new(set_point: &SetPoint, view: &View, depth: DepthSource) -> Option<Self> {
        if view.features().len() != set_point.features().len() {
            return None;
        }
        let mut normal = NormalEquations::<6>::new();
        let desired = set_point.features().iter().zip(set_point.depths_m()).zip(set_point.points());
        for (s, ((s_d, z_d), p_O)) in view.features().iter().zip(desired) {
            let z_m = match depth {
                DepthSource::Desired => *z_d,
                DepthSource::Estimated => view.depth_m(p_O, *z_d),
            };
            normal.add_point(s, z_m, &(s_d - s), 1.0);
        }
        Some(Self { matrix: normal.matrix(), vector: normal.vector() })
    }
}

/// The joint velocity of (10.90), (10.91) with K_s = `gain_1_s` I, rad/s or m/s, given the camera's Jacobian `J_C`
/// (`V_BC_C = J_C qd`).
///
/// Near a singularity of the features or of the arm the weak directions are damped, so that the velocity stays bounded.
/// `None` when even that has no finite solution.
#[must_use]
pub fn joint_velocity<const N: usize>(
    task: &ImageTask,
    gain_1_s: f64,
    J_C: &SMatrix<f64, 6, N>,
) -> Option<SVector<f64, N>> {
    unit_joint_velocity(task, J_C).map(|qd| qd * gain_1_s)
}

fn unit_joint_velocity<const N: usize>(
    task: &ImageTask,
    J_C: &SMatrix<f64, 6, N>,
) -> Option<SVector<f64, N>> {
    if N > 6 {
        return redundant_joint_velocity(task, J_C);
    }
    let AJ = task.matrix * J_C;
    let b = J_C.tr_mul(&task.vector);
    let mut matrix = [[0.0; N]; N];
    for (i, row) in matrix.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate().take(i + 1) {
            *entry = J_C.column(i).dot(&AJ.column(j));
        }
    }
    solve_damped(&matrix, &b.into()).map(SVector::from)
}

/// More joints than the task: the camera twist of (10.91), and the smallest joint velocity that gives it.
fn redundant_joint_velocity<const N: usize>(
    task: &ImageTask,
    J_C: &SMatrix<f64, 6, N>,
) -> Option<SVector<f64, N>> {
    let V = solve_damped(&lower(&task.matrix), &task.vector.into())?;
    let y = solve_damped(&lower(&(J_C * J_C.transpose())), &V)?;
    Some(J_C.tr_mul(&Vector6::from(y)))
}

fn lower(m: &Matrix6<f64>) -> [[f64; 6]; 6] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// Solves with the lower triangle of a symmetric matrix; the nearer it is to singular, the more it is damped.
fn solve_damped<const M: usize>(matrix: &[[f64; M]; M], b: &[f64; M]) -> Option<[f64; M]> {
    let diagonal = || matrix.iter().enumerate().filter_map(|(i, row)| row.get(i));
    let largest = diagonal().copied().fold(0.0, f64::max);
    let scale = diagonal().copied().fold(f64::INFINITY, f64::min) / largest;
    let plain = Ldlt::new(matrix, &[0.0; M]);
    let conditioning = plain.as_ref().map_or(0.0, Ldlt::least_ratio).min(scale);
    let factors = match plain {
        Some(factors) if conditioning >= WEAKEST_DIRECTION => factors,
        _ => {
            let distance = 1.0 - conditioning.max(0.0) / WEAKEST_DIRECTION;
            Ldlt::new(matrix, &[DAMPING * largest * distance * distance; M])?
        }
    };
    let x = factors.solve(b);
    x.iter().all(|x| x.is_finite()).then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::point_rows;
    use crate::geometry::Pose;
    use nalgebra::{DMatrix, DVector, Matrix6, Point3, Vector2};
    use proptest::prelude::*;

    fn square() -> [Point3<f64>; 4] {
        [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0))
    }

    fn view(X_CO: &Pose, points: &[Point3<f64>]) -> View {
        View::new(points.iter().map(|p| (X_CO * p).coords).map(|p| p.xy() / p.z), Some(*X_CO)).unwrap()
    }

    fn pose() -> impl Strategy<Value = Pose> {
        prop::array::uniform6(-0.3..0.3f64).prop_map(|a| {
            Pose::new([a[0] * 0.5, a[1] * 0.5, 0.7 + a[2]].into(), [a[3], a[4], a[5] * 4.0].into())
        })
    }

    proptest! {
        /// Against the equations as they are printed, with dense matrices.
        #[test]
        fn six_joints_give_the_two_steps_of_the_textbook(
            now in pose(), goal in pose(), j in prop::collection::vec(-1.0..1.0f64, 36)
        ) {
            let J = Matrix6::from_column_slice(&j) * 0.3 + Matrix6::identity() * 2.5;
            let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
            let seen = view(&now, &square());
            let task = ImageTask::new(&set_point, &seen, DepthSource::Estimated).unwrap();
            let mut L = DMatrix::zeros(8, 6);
            let mut Ke = DVector::zeros(8);
            for (i, s) in seen.features().iter().enumerate() {
                L.view_mut((2 * i, 0), (2, 6)).copy_from(&point_rows(s, (now * square()[i]).z));
                Ke.rows_mut(2 * i, 2).copy_from(&((set_point.features()[i] - s) * 2.0));
            }
            let (Q, R) = L.qr().unpack();
            // Squaring costs digits; views that are hardly fixed are the damping's business.
            prop_assume!(R.diagonal().amin() > 1e-3 * R.diagonal().amax());
            let V = R.solve_upper_triangular(&(Q.transpose() * &Ke)).unwrap();
            let qd = J.lu().solve(&Vector6::from_column_slice(V.as_slice())).unwrap();
            let got = joint_velocity(&task, 2.0, &J).unwrap();
            prop_assert!((got - qd).norm() < 1e-6 * (1.0 + qd.norm()), "{got} {qd}");
        }

        #[test]
        fn seven_joints_give_the_twist_with_the_least_motion(
            now in pose(), goal in pose(), j in prop::collection::vec(-1.0..1.0f64, 42)
        ) {
            let mut J = SMatrix::<f64, 6, 7>::from_column_slice(&j) * 0.3;
            for i in 0..6 { J[(i, i)] += 2.5; }
            let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
            let task = ImageTask::new(&set_point, &view(&now, &square()), DepthSource::Desired).unwrap();
            let qd = joint_velocity(&task, 1.0, &J).unwrap();
            let V = joint_velocity(&task, 1.0, &Matrix6::identity()).unwrap();
            prop_assert!((J * qd - V).norm() < 1e-6 * (1.0 + V.norm()));
            let null = J.transpose() * (J * J.transpose()).try_inverse().unwrap() * (J * qd) - qd;
            prop_assert!(null.norm() < 1e-6 * (1.0 + qd.norm()));
        }

        /// An Euler step along the law brings every feature closer, whatever the pose.
        #[test]
        fn features_move_towards_their_goal(goal in pose(), d in prop::array::uniform6(-0.05..0.05f64)) {
            let now = Pose::new([d[0] * 0.3, d[1] * 0.3, d[2] * 0.3].into(), [d[3], d[4], d[5]].into()) * goal;
            let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
            let task = ImageTask::new(&set_point, &view(&now, &square()), DepthSource::Estimated).unwrap();
            let V = joint_velocity(&task, 1.0, &Matrix6::identity()).unwrap();
            let h = 0.01;
            let X_CCnext = crate::geometry::integrate_body_twist(&Pose::identity(), &V, h);
            let f = Vector2::new(1.0, 1.0);
            let before = set_point.error_rms_px_at(&now, &f);
            let after = set_point.error_rms_px_at(&(X_CCnext.inverse() * now), &f);
            prop_assert!(after < before * (1.0 - 0.5 * h) + 1e-12, "{before} -> {after}");
        }
    }

    #[test]
    fn near_a_singularity_the_velocity_stays_bounded() {
        let goal = Pose::translation(0.0, 0.0, 0.6);
        let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
        let seen = view(&(Pose::translation(0.02, 0.0, 0.0) * goal), &square());
        let task = ImageTask::new(&set_point, &seen, DepthSource::Desired).unwrap();
        let mut J = Matrix6::identity();
        J[(0, 0)] = 1e-9; // the arm can hardly move along x
        let qd = joint_velocity(&task, 1.0, &J).unwrap();
        assert!(qd.norm() < 10.0, "{qd}");
    }

    #[test]
    fn a_view_of_other_features_is_refused() {
        let goal = Pose::translation(0.0, 0.0, 0.6);
        let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
        assert!(ImageTask::new(&set_point, &view(&goal, &square()), DepthSource::Desired).is_some());
        assert!(ImageTask::new(&set_point, &view(&goal, &square()[..3]), DepthSource::Desired).is_none());
    }
}
