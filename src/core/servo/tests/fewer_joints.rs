//! Scheme B with m = 6 before arms that cannot follow its twist: weighted by the motion of the image.

use super::{goal, pose, seen, square};
use crate::geometry::{Pose, integrate_body_twist};
use crate::robot::CameraJacobian;
use crate::servo::*;
use nalgebra::{DMatrix, DVector, Point3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use proptest::prelude::*;

fn scheme_b(weights: TwistWeights) -> Law {
    Law::PositionVelocity {
        K: PoseGains::repeat(1.0),
        gain: Gain::Constant(1.0),
        orientation: OrientationError::AngleAxis,
        space: OperationalSpace::Six,
        weights,
    }
}

/// What the law asks of the joints of an arm with the Jacobian `J`, 6 x `N`, expressed in C.
fn asked<const N: usize>(
    weights: TwistWeights,
    (X_DO, X_CO): (&Pose, &Pose),
    J: SMatrix<f64, 6, N>,
) -> SVector<f64, N> {
    let law = scheme_b(weights);
    let arm = Arm { J: CameraJacobian::of_moving_camera(J), qd: SVector::zeros(), gravity: SVector::zeros() };
    let task = law.task(&goal(X_DO), &seen(X_CO, &square())).unwrap();
    match law.output(&task, &arm).unwrap() {
        LawOutput::Velocity(qd) => qd,
        LawOutput::Torque(_) => panic!("B commands velocities"),
    }
}

/// The image velocities of the square at `X_CO` for a unit of each component of the camera's twist, by differences of its projection, 8 x 6.
fn by_differences(X_CO: &Pose) -> DMatrix<f64> {
    let image = |V: &Vector6<f64>| {
        let X_CnowO = integrate_body_twist(&Pose::identity(), V, 1.0).inverse() * X_CO;
        let project = move |p: &Point3<f64>| {
            let p = X_CnowO * p;
            [p.x / p.z, p.y / p.z]
        };
        DVector::from_vec(square().iter().flat_map(project).collect())
    };
    // Rounding of 1e-16 leaves 1e-10 of a central difference, the third derivative 1e-11.
    let h = 1e-6;
    let column = |i| {
        let V = Vector6::ith(i, h);
        (image(&V) - image(&-V)) / (2.0 * h)
    };
    DMatrix::from_columns(&std::array::from_fn::<_, 6, _>(column))
}

/// A SCARA's motions of its camera: three displacements and a turn about the optical axis.
fn level_arm() -> SMatrix<f64, 6, 4> {
    SMatrix::from_fn(|i, j| f64::from(u8::from(i == if j == 3 { 5 } else { j })))
}

/// A head's: turns about the camera's x and y.
fn head() -> SMatrix<f64, 6, 2> {
    SMatrix::from_fn(|i, j| f64::from(u8::from(i == j + 3)))
}

proptest! {
    /// Of all joint velocities it is the one whose image motion is nearest to that of the twist, by a dense solution.
    #[test]
    fn the_image_moves_as_nearly_as_it_can(
        now in pose(), X_DO in pose(), entries in prop::array::uniform32(-1.0..1.0f64)
    ) {
        let J = SMatrix::<f64, 6, 4>::from_fn(|i, j| entries[4 * i + j]);
        let V = OperationalSpaceError::new(&X_DO, &now, OrientationError::AngleAxis).twist(&PoseGains::repeat(1.0));
        let L = by_differences(&now);
        let L_J = &L * DMatrix::from_column_slice(6, 4, J.as_slice());
        let svd = L_J.svd(true, true);
        prop_assume!(svd.singular_values.min() > 1e-2 * svd.singular_values.max());
        let wanted = svd.solve(&(L * DVector::from_column_slice(V.unwrap().as_slice())), 0.0).unwrap();
        let qd = asked(TwistWeights::Image, (&X_DO, &now), J);
        let difference = DVector::from_column_slice(qd.as_slice()) - &wanted;
        prop_assert!(difference.norm() < 1e-5 * (1.0 + wanted.norm()), "{qd} {wanted}");
    }

    /// An arm that can follow the twist follows it, whatever the weights.
    #[test]
    fn an_arm_of_six_joints_moves_as_before(now in pose(), X_DO in pose()) {
        let J = SMatrix::<f64, 6, 6>::identity();
        let [unit, image] = [TwistWeights::Unit, TwistWeights::Image].map(|w| asked(w, (&X_DO, &now), J));
        // Four points leave 1e-4 of the weights' largest direction at least: 1e-16 over that, twice.
        prop_assert!((unit - image).norm() < 1e-6 * (1.0 + unit.norm()), "{unit} {image}");
    }

    /// A goal that the arm can reach is where it comes to rest: a displacement within its motions is followed to the last bit of the twist.
    #[test]
    fn what_the_arm_can_reach_is_asked_for(X_DO in pose(), by in prop::array::uniform4(-0.05..0.05f64)) {
        let J = level_arm();
        let V = J * SVector::from(by);
        let X_CO = integrate_body_twist(&Pose::identity(), &V, 1.0).inverse() * X_DO;
        let qd = asked(TwistWeights::Image, (&X_DO, &X_CO), J);
        let V = OperationalSpaceError::new(&X_DO, &X_CO, OrientationError::AngleAxis).twist(&PoseGains::repeat(1.0)).unwrap();
        prop_assert!((J * qd - V).norm() < 1e-6 * (1.0 + V.norm()), "{qd} {V}");
    }
}

/// How far, in px of a lens of 800 px, the image would go from its goal by what a tilt of the measured pose by a milliradian asks of the arm.
fn moved_px<const N: usize>(weights: TwistWeights, J: SMatrix<f64, 6, N>) -> f64 {
    let X_DO = Pose::new([-0.05, -0.05, 0.6].into(), [0.0; 3].into());
    let mut worst: f64 = 0.0;
    for axis in [Vector3::x_axis(), Vector3::y_axis()] {
        // About the middle of the square, which is where it is measured.
        let tilt = UnitQuaternion::from_axis_angle(&axis, 1e-3);
        let X_CO = Pose::rotation_wrt_point(
            tilt,
            Point3::from(X_DO.translation.vector + Vector3::new(0.05, 0.05, 0.0)),
        ) * X_DO;
        let V = J * asked(weights, (&X_DO, &X_CO), J);
        let motion = by_differences(&X_CO) * DVector::from_column_slice(V.as_slice()) * 800.0;
        worst = worst.max(motion.norm() / 2.0);
    }
    worst
}

/// A wrong tilt of the measured pose displaces the camera, by the distance of the target times the angle: 0.8 px before a square 0.6 m away. With the image's weights it hardly does.
#[test]
fn a_wrong_tilt_hardly_moves_the_arm() {
    let [unit, image] = [TwistWeights::Unit, TwistWeights::Image].map(|w| moved_px(w, level_arm()));
    assert!(unit > 0.7, "{unit}");
    assert!(image < 0.01, "{image}");
    let [unit, image] = [TwistWeights::Unit, TwistWeights::Image].map(|w| moved_px(w, head()));
    assert!(unit > 0.7, "{unit}");
    assert!(image < 0.01, "{image}");
}
