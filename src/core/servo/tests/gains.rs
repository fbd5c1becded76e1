//! Gain matrices: in closed loops errors fall as `exp(-K t)`, (10.77), (10.88), (10.93), against the exponential of the matrix itself;
//! where there are more numbers than motions, against the text's formula with dense matrices.

use super::{goal, pose, seen, square};
use crate::features::point_rows;
use crate::geometry::Pose;
use crate::messages::Measurement;
use crate::robot::{CameraJacobian, Mount, Robot};
use crate::servo::*;
use crate::sim::perfect_measurement;
use crate::time::MonoNs;
use nalgebra::{
    DMatrix, DVector, Matrix3, Matrix4, Matrix6, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3,
    Vector4, Vector6,
};
use proptest::prelude::*;

const TIME_S: f64 = 0.5;
const STEPS: usize = 250;
const ESTIMATED: Interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };

/// Symmetric and positive definite, eigenvalues from 0.5 on.
fn spd<const M: usize>(a: &[f64]) -> SMatrix<f64, M, M> {
    let A = SMatrix::<f64, M, M>::from_column_slice(&a[..M * M]);
    let K = A * A.transpose() * (1.5 / M as f64) + SMatrix::identity() * 0.5;
    (K + K.transpose()) * 0.5
}

fn entries() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-1.0..1.0f64, 64)
}

/// y after [`TIME_S`] for `y' = rate(y)`: the classical method of Runge and Kutta.
fn integrated<const R: usize, const C: usize>(
    mut y: SMatrix<f64, R, C>,
    rate: impl Fn(&SMatrix<f64, R, C>) -> SMatrix<f64, R, C>,
) -> SMatrix<f64, R, C> {
    let h = TIME_S / STEPS as f64;
    for _ in 0..STEPS {
        let a = rate(&y);
        let b = rate(&(y + a * (0.5 * h)));
        let c = rate(&(y + b * (0.5 * h)));
        let d = rate(&(y + c * h));
        y += (a + b * 2.0 + c * 2.0 + d) * (h / 6.0);
    }
    y
}

fn pose_of(T: &Matrix4<f64>) -> Pose {
    let R = Rotation3::from_matrix_unchecked(T.fixed_view::<3, 3>(0, 0).into_owned());
    Pose::from_parts(T.fixed_view::<3, 1>(0, 3).into_owned().into(), UnitQuaternion::from_rotation_matrix(&R))
}

/// The object's pose in a free camera that has moved as the law asks.
fn flown(law: &Law, set_point: &SetPoint, start: &Pose) -> Pose {
    let points = set_point.points().to_vec();
    let T = integrated(start.to_homogeneous(), |T| {
        let Task::Twist(task) = law.task(set_point, &seen(&pose_of(T), &points)).unwrap() else {
            panic!("a velocity law")
        };
        let V = task.twist(1.0).unwrap();
        let twist = Matrix4::new(
            0.0, -V[5], V[4], V[0], V[5], 0.0, -V[3], V[1], -V[4], V[3], 0.0, V[2], 0.0, 0.0, 0.0, 0.0,
        );
        -twist * T
    });
    pose_of(&T)
}

fn start() -> (Pose, Pose) {
    let X_DO = Pose::new([-0.04, -0.05, 0.6].into(), [0.2, -0.1, 0.3].into());
    (X_DO, Pose::new([-0.01, -0.07, 0.66].into(), [0.12, 0.03, 0.15].into()))
}

fn image_error_of<const K: usize>(set_point: &SetPoint, X_CO: &Pose) -> SVector<f64, K> {
    let e: Vec<f64> = set_point
        .points()
        .iter()
        .zip(set_point.features())
        .flat_map(|(p, s_d)| {
            let p = X_CO * p;
            [s_d.x - p.x / p.z, s_d.y - p.y / p.z]
        })
        .collect();
    SVector::from_column_slice(&e)
}

fn decayed<const M: usize>(K: &SMatrix<f64, M, M>, e: &SVector<f64, M>) -> SVector<f64, M> {
    let K = DMatrix::from_column_slice(M, M, K.as_slice());
    let after = (K * -TIME_S).exp() * DVector::from_column_slice(e.as_slice());
    SVector::from_column_slice(after.as_slice())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// D with three points: six numbers, six motions; each error has its own rate, or they are mixed.
    #[test]
    fn image_errors_fall_as_their_matrix_says(a in entries(), k in prop::array::uniform6(0.5..4.0f64)) {
        // A wide triangle, upright below the camera, which so stays away from the cylinder through the corners: on it three points are
        // singular. Rates that differ much make detours, so that the way is short.
        let points = square().map(|p| p * 4.0);
        let X_DO = Pose::new([-0.22, -0.18, 0.6].into(), [0.02, -0.03, 0.3].into());
        let now = Pose::new([-0.214, -0.183, 0.609].into(), [0.023, -0.027, 0.285].into());
        let set_point = SetPoint::from_pose(&X_DO, &points[..3]).unwrap();
        let K = spd::<6>(&a);
        let full = FeatureMatrix::full(&DMatrix::from_column_slice(6, 6, K.as_slice())).unwrap();
        let list = FeatureMatrix::diagonal(&k).unwrap();
        let diagonal = Matrix6::from_diagonal(&Vector6::from(k));
        for (K_s, K) in [(full, K), (list, diagonal), (2.5.into(), Matrix6::identity() * 2.5)] {
            let law = Law::ImageVelocity { K_s, gain: Gain::Constant(1.0), interaction: ESTIMATED };
            let after = image_error_of::<6>(&set_point, &flown(&law, &set_point, &now));
            let wanted = decayed(&K, &image_error_of(&set_point, &now));
            prop_assert!((after - wanted).norm() < 1e-8, "{K} {after} {wanted}");
        }
    }

    /// D on the SCARA with two points: (10.87) with a square J_L.
    #[test]
    fn image_errors_fall_so_on_an_arm(a in entries()) {
        let robot: Robot<4> = crate::robot::load("scara").unwrap().build().unwrap();
        let mount = Mount::EyeInHand { X_EC: Pose::identity() };
        let X_DO = Pose::new([-0.05, -0.04, 0.6].into(), [0.0, 0.0, -0.5].into());
        let q_d = Vector4::new(0.1, 1.5, 0.4, -0.7);
        let X_WO = robot.forward(&q_d) * X_DO;
        let points = &square()[..2];
        let set_point = SetPoint::from_pose(&X_DO, points).unwrap();
        let K = spd::<4>(&a);
        let K_s = FeatureMatrix::full(&DMatrix::from_column_slice(4, 4, K.as_slice())).unwrap();
        let law = Law::ImageVelocity { K_s, gain: Gain::Constant(1.0), interaction: ESTIMATED };
        let error = |q: &Vector4<f64>| image_error_of::<4>(&set_point, &robot.forward(q).inv_mul(&X_WO));
        let q = q_d + Vector4::new(0.03, -0.05, 0.05, 0.2);
        let after = integrated(q, |q| {
            let view = seen(&robot.forward(q).inv_mul(&X_WO), points);
            let arm = Arm { J: mount.camera(&robot, q).1, qd: Vector4::zeros(), gravity: Vector4::zeros() };
            match law.output(&law.task(&set_point, &view).unwrap(), &arm) {
                Some(LawOutput::Velocity(qd)) => qd,
                other => panic!("{other:?}"),
            }
        });
        let wanted = decayed(&K, &error(&q));
        prop_assert!((error(&after) - wanted).norm() < 1e-8, "{} {wanted}", error(&after));
    }

    /// B: position and orientation coupled by K, every orientation error.
    #[test]
    fn pose_errors_fall_as_their_matrix_says(a in entries()) {
        let (X_DO, now) = start();
        let (set_point, K) = (goal(&X_DO), spd::<6>(&a));
        for orientation in OrientationError::ALL {
            let law = Law::PositionVelocity {
                K: PoseGains::full(K).unwrap(),
                gain: Gain::Constant(1.0),
                orientation,
                space: OperationalSpace::Six,
                weights: TwistWeights::Unit,
            };
            let error = |X_CO: &Pose| OperationalSpaceError::new(&X_DO, X_CO, orientation).x;
            let after = error(&flown(&law, &set_point, &now));
            let wanted = decayed(&K, &error(&now));
            prop_assert!((after - wanted).norm() < 1e-8, "{orientation:?} {after} {wanted}");
        }
    }

    /// Hybrid: e_p by K_p, phi by K_o.
    #[test]
    fn hybrid_errors_fall_as_their_matrices_say(a in entries(), b in entries()) {
        let (X_DO, now) = start();
        let (set_point, K_p, K_o) = (goal(&X_DO), spd::<3>(&a), spd::<3>(&b));
        let law = Law::Hybrid {
            gains: HybridGains { K_p: GainMatrix::full(K_p).unwrap(), K_o: GainMatrix::full(K_o).unwrap() },
            gain: Gain::Constant(1.0),
            orientation: OrientationError::AngleAxis,
            space: OperationalSpace::Six,
            depth: DepthSource::Desired,
        };
        let errors = |X_CO: &Pose| {
            let (p, p_D) = (X_CO * square()[0], X_DO * square()[0]);
            let e_p = Vector3::new(p_D.x / p_D.z - p.x / p.z, p_D.y / p_D.z - p.y / p.z, -(p.z / p_D.z).ln());
            (e_p, (X_CO.rotation * X_DO.rotation.inverse()).scaled_axis())
        };
        let ((e_p, phi), after) = (errors(&now), errors(&flown(&law, &set_point, &now)));
        prop_assert!((after.0 - decayed(&K_p, &e_p)).norm() < 1e-8, "{} {}", after.0, decayed(&K_p, &e_p));
        prop_assert!((after.1 - decayed(&K_o, &phi)).norm() < 1e-8, "{} {}", after.1, decayed(&K_o, &phi));
    }

    /// (10.91) with weights and a matrix for eight numbers; of hidden points rows and columns are missing.
    #[test]
    fn more_numbers_than_motions(
        now in pose(), X_DO in pose(), a in entries(), w in prop::array::uniform4(0.2..3.0f64)
    ) {
        let selection = Selection::new((0..4).map(FeatureKind::Point).zip(w)).unwrap();
        let set_point = goal(&X_DO).with_selection(selection).unwrap();
        let K = spd::<8>(&a);
        let K_s = FeatureMatrix::full(&DMatrix::from_column_slice(8, 8, K.as_slice())).unwrap();
        let whole = perfect_measurement(&square(), &now, MonoNs::ZERO).unwrap();
        let mut partial: Measurement = whole;
        (partial.features[1], partial.features[2]) = (whole.features[2], whole.features[3]);
        partial.feature_count = 3;
        for (measurement, seen) in [(whole, &[0, 1, 2, 3][..]), (partial, &[0, 2, 3])] {
            let view = View::of(&measurement, &set_point).unwrap();
            let n = 2 * seen.len();
            let (mut L, mut W, mut e) = (DMatrix::zeros(n, 6), DMatrix::zeros(n, n), DVector::zeros(n));
            for (k, i) in seen.iter().enumerate() {
                let p = now * square()[*i];
                let s = p.coords.xy() / p.z;
                L.view_mut((2 * k, 0), (2, 6)).copy_from(&point_rows(&s, p.z));
                e.rows_mut(2 * k, 2).copy_from(&(set_point.features()[*i] - s));
                W.view_mut((2 * k, 2 * k), (2, 2)).fill_diagonal(w[*i]);
            }
            let at = |k: usize| 2 * seen[k / 2] + k % 2;
            let K = DMatrix::from_fn(n, n, |i, j| K[(at(i), at(j))]);
            let task = image_task_by(&set_point, &view, ESTIMATED, &K_s).unwrap();
            let (A, b) = (L.transpose() * &W * &L, L.transpose() * &W * &K * &e);
            prop_assert!((DMatrix::from_column_slice(6, 6, task.matrix.as_slice()) - &A).norm() < 1e-9 * (1.0 + A.norm()));
            prop_assert!((DVector::from_column_slice(task.vector.as_slice()) - &b).norm() < 1e-9 * (1.0 + b.norm()));
            prop_assert!((task.error - e.norm()).abs() < 1e-12);
            // scheme C, where the weights have no part
            let wrench = image_wrench_by(&set_point, &view, ESTIMATED, &K_s, Some(&K_s)).unwrap();
            let (h, D) = (L.transpose() * &K * &e, L.transpose() * &K * &L);
            prop_assert!((DVector::from_column_slice(wrench.wrench.as_slice()) - &h).norm() < 1e-9 * (1.0 + h.norm()));
            prop_assert!((DMatrix::from_column_slice(6, 6, wrench.damping.as_slice()) - &D).norm() < 1e-9 * (1.0 + D.norm()));
        }
        let other = FeatureMatrix::diagonal(&[1.0; 6]).unwrap();
        let view = seen(&now, &square());
        prop_assert!(image_task_by(&set_point, &view, ESTIMATED, &other).is_none(), "six gains for eight numbers");
    }

    /// (10.74) and (10.84) with full matrices, as the torque of an arm.
    #[test]
    fn torques_of_full_matrices(now in pose(), X_DO in pose(), a in entries(), b in entries(), qd in prop::array::uniform6(-1.0..1.0f64)) {
        let (qd, g) = (Vector6::from(qd), Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
        let arm = Arm { J: CameraJacobian::of_moving_camera(Matrix6::identity() * 0.8), qd, gravity: g };
        let J = Matrix6::identity() * 0.8;
        let (set_point, view) = (goal(&X_DO), seen(&now, &square()));
        let torque = |law: &Law| match law.output(&law.task(&set_point, &view).unwrap(), &arm) {
            Some(LawOutput::Torque(tau)) => tau,
            other => panic!("{other:?}"),
        };
        let orientation = OrientationError::AngleAxis;
        let error = OperationalSpaceError::new(&X_DO, &now, orientation);
        if let Some(E) = error.rate() {
            let (K_P, K_D) = (spd::<6>(&a), spd::<6>(&b));
            let law = Law::PositionTorque {
                K_P: PoseGains::full(K_P).unwrap(),
                damping: Damping::Task(PoseGains::full(K_D).unwrap()),
                orientation,
                space: OperationalSpace::Six,
            };
            let u = g + J.transpose() * E.transpose() * (K_P * error.x - K_D * E * J * qd);
            prop_assert!((torque(&law) - u).norm() < 1e-9 * (1.0 + u.norm()));
        }
        let (K_P, K_D) = (spd::<8>(&a), spd::<8>(&b));
        let feature = |K: &SMatrix<f64, 8, 8>| FeatureMatrix::full(&DMatrix::from_column_slice(8, 8, K.as_slice())).unwrap();
        let mut L = SMatrix::<f64, 8, 6>::zeros();
        for (i, p) in square().iter().enumerate() {
            let p = now * p;
            L.fixed_view_mut::<2, 6>(2 * i, 0).copy_from(&point_rows(&(p.coords.xy() / p.z), p.z));
        }
        let e = image_error_of::<8>(&set_point, &now);
        let spring = g + J.transpose() * L.transpose() * K_P * e;
        let mut joints = [0.0; crate::messages::MAX_JOINTS];
        joints[..6].fill(2.0);
        let task = Law::ImageTorque { K_Ps: feature(&K_P), damping: Damping::Task(feature(&K_D)), interaction: ESTIMATED };
        let number = Law::ImageTorque { K_Ps: feature(&K_P), damping: Damping::Task(3.0.into()), interaction: ESTIMATED };
        let on_joints = Law::ImageTorque { K_Ps: feature(&K_P), damping: Damping::Joints(joints), interaction: ESTIMATED };
        for (law, u) in [
            (task, spring - J.transpose() * L.transpose() * K_D * L * J * qd),
            (number, spring - J.transpose() * L.transpose() * L * J * qd * 3.0),
            (on_joints, spring - qd * 2.0),
        ] {
            prop_assert!((torque(&law) - u).norm() < 1e-9 * (1.0 + u.norm()), "{law:?}");
        }
    }
}

/// The rate by which an arm's way to its goal is judged is that of the quickest direction.
#[test]
fn the_rate_is_that_of_the_quickest_direction() {
    let K_o = Matrix3::new(2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 1.0);
    let law = Law::Hybrid {
        gains: HybridGains { K_p: GainMatrix::repeat(1.5), K_o: GainMatrix::full(K_o).unwrap() },
        gain: Gain::Constant(2.0),
        orientation: OrientationError::AngleAxis,
        space: OperationalSpace::Six,
        depth: DepthSource::Desired,
    };
    let (X_DO, now) = start();
    let task = law.task(&goal(&X_DO), &seen(&now, &square())).unwrap();
    assert!((law.rate_1_s(&task) - 6.0).abs() < 1e-12);
}
