//! The choices of the depth in closed loops, against a simulation of the text's equations with dense matrices.

use super::{seen, square};
use crate::geometry::{Pose, integrate_body_twist};
use crate::messages::measurement_flag;
use crate::robot::{Mount, Robot};
use crate::servo::*;
use crate::sim::perfect_measurement;
use crate::time::MonoNs;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix4, Point3, Vector3, Vector4, Vector6};

const PERIOD_S: f64 = 0.04;
const FRAMES: i64 = 100;
/// z for [`DepthSource::Constant`], m.
const CONSTANT_M: f64 = 0.45;

fn X_DO() -> Pose {
    Pose::new([-0.04, -0.05, 0.6].into(), [0.2, -0.1, 0.3].into())
}

fn start() -> Pose {
    Pose::new([0.02, -0.09, 0.85].into(), [-0.15, 0.25, -0.35].into())
}

/// The poses of the object in a camera that moves as `law` says, held between frames.
fn flight(law: Law, known: bool) -> Vec<Matrix4<f64>> {
    let robot: Robot<4> = crate::robot::load("scara").unwrap().build().unwrap();
    let set_point = SetPoint::from_pose(&X_DO(), &square()).unwrap();
    let mount = Mount::EyeToHand { X_BC: Pose::identity() };
    let mut servo =
        VisualServo::new(ServoSettings::new(law.clone(), UpdatePolicy::Frame, mount), set_point.clone());
    let q = Vector4::new(0.1, 1.5, 0.4, -0.7);
    let mut X_CO = start();
    let mut poses = vec![X_CO.to_homogeneous()];
    for k in 0..FRAMES {
        let now = MonoNs(k * 40_000_000);
        servo.note_arm(now, &q, &Vector4::zeros());
        assert!(
            servo
                .add_measurement(now, &perfect_measurement(&square(), &X_CO, now).unwrap(), &robot)
                .is_used()
        );
        let V = if known {
            // a camera in a hand has no place in a scene: the true pose is put into the view
            match law.task(&set_point, &seen(&X_CO, &square()).with_known(Some(X_CO))).unwrap() {
                Task::Twist(task) => task.twist(1.0).unwrap(),
                Task::Wrench(_) => panic!("a velocity law"),
            }
        } else {
            servo.camera_law_output().unwrap()
        };
        X_CO = integrate_body_twist(&Pose::identity(), &V, PERIOD_S).inverse() * X_CO;
        poses.push(X_CO.to_homogeneous());
    }
    poses
}

/// Which depth the simulation takes.
#[derive(Clone, Copy, PartialEq)]
enum Depth {
    Desired,
    Constant,
    Initial,
    True,
}

/// The depth of point i at pose T: z_d, a number, that of the start, or the true one.
fn depth_m(depth: Depth, T: &Matrix4<f64>, i: usize) -> f64 {
    let z = |T: &Matrix4<f64>| (T * square()[i].to_homogeneous())[2];
    match depth {
        Depth::Desired => z(&X_DO().to_homogeneous()),
        Depth::Constant => CONSTANT_M,
        Depth::Initial => z(&start().to_homogeneous()),
        Depth::True => z(T),
    }
}

fn image(T: &Matrix4<f64>, p: &Point3<f64>) -> [f64; 2] {
    let p = T * p.to_homogeneous();
    [p[0] / p[2], p[1] / p[2]]
}

/// (10.91) with (10.26) by singular values.
fn scheme_d(T: &Matrix4<f64>, depth: Depth) -> Vector6<f64> {
    let goal = X_DO().to_homogeneous();
    let (mut L, mut e) = (DMatrix::zeros(8, 6), DVector::zeros(8));
    for (i, p) in square().iter().enumerate() {
        let ([x, y], [x_d, y_d], z) = (image(T, p), image(&goal, p), depth_m(depth, T, i));
        let rows =
            [[-1.0 / z, 0.0, x / z, x * y, -1.0 - x * x, y], [0.0, -1.0 / z, y / z, 1.0 + y * y, -x * y, -x]];
        for (k, row) in rows.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                L[(2 * i + k, j)] = *entry;
            }
        }
        (e[2 * i], e[2 * i + 1]) = (x_d - x, y_d - y);
    }
    let V = L.svd(true, true).solve(&e, 1e-12).unwrap();
    Vector6::from_column_slice(V.as_slice())
}

/// (10.92), with the sign of (10.93), and (10.97), phi as axis times angle, z_d in J_p as `depth` has it.
fn hybrid(T: &Matrix4<f64>, depth: Depth, [k_p, k_o]: [f64; 2]) -> Vector6<f64> {
    let goal = X_DO().to_homogeneous();
    let R_CD: Matrix3<f64> = T.fixed_view::<3, 3>(0, 0) * goal.fixed_view::<3, 3>(0, 0).transpose();
    let angle = ((R_CD.trace() - 1.0) * 0.5).clamp(-1.0, 1.0).acos();
    let skew =
        Vector3::new(R_CD[(2, 1)] - R_CD[(1, 2)], R_CD[(0, 2)] - R_CD[(2, 0)], R_CD[(1, 0)] - R_CD[(0, 1)]);
    // r sin(angle) = skew / 2
    let phi = if angle < 1e-9 { skew * 0.5 } else { skew * (angle / (2.0 * angle.sin())) };
    let w = phi * k_o; // T phi = phi: a rotation leaves its axis where it is
    let p = square()[0];
    let ([x, y], [x_d, y_d]) = (image(T, &p), image(&goal, &p));
    let rho = depth_m(Depth::True, T, 0) / depth_m(Depth::Desired, T, 0);
    let z_c = match depth {
        Depth::Constant => rho * CONSTANT_M,
        Depth::Desired => rho * depth_m(Depth::Desired, T, 0),
        other => depth_m(other, T, 0),
    };
    let J_p = Matrix3::new(-1.0, 0.0, x, 0.0, -1.0, y, 0.0, 0.0, -1.0) / z_c;
    let J_o = Matrix3::new(x * y, -1.0 - x * x, y, 1.0 + y * y, -x * y, -x, -y, x, 0.0);
    let e_p = Vector3::new(x_d - x, y_d - y, -rho.ln());
    let v = J_p.lu().solve(&(e_p * k_p - J_o * w)).unwrap();
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// The same flight by the exponential of the twist as a 4 x 4 matrix.
fn simulated(twist: impl Fn(&Matrix4<f64>) -> Vector6<f64>) -> Vec<Matrix4<f64>> {
    let mut T = start().to_homogeneous();
    let mut poses = vec![T];
    for _ in 0..FRAMES {
        let V = twist(&T) * PERIOD_S;
        let moved = Matrix4::new(
            0.0, -V[5], V[4], V[0], V[5], 0.0, -V[3], V[1], -V[4], V[3], 0.0, V[2], 0.0, 0.0, 0.0, 0.0,
        );
        T = (-moved).exp() * T;
        poses.push(T);
    }
    poses
}

fn farthest(a: &[Matrix4<f64>], b: &[Matrix4<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max)
}

const DEPTHS: [(Depth, DepthSource); 4] = [
    (Depth::Desired, DepthSource::Desired),
    (Depth::Constant, DepthSource::Constant(CONSTANT_M)),
    (Depth::Initial, DepthSource::Initial),
    (Depth::True, DepthSource::Known),
];

/// Compares the flights of all depths with their simulations, and with each other; those in `alike` are one.
fn compare(
    law: impl Fn(DepthSource) -> Law,
    twist: impl Fn(&Matrix4<f64>, Depth) -> Vector6<f64>,
    alike: &[Depth],
) {
    let mut flights: Vec<(Depth, Vec<Matrix4<f64>>)> = Vec::new();
    for (depth, source) in DEPTHS {
        let flown = flight(law(source), source == DepthSource::Known);
        let by_text = simulated(|T| twist(T, depth));
        let off = farthest(&flown, &by_text);
        assert!(off < 1e-8, "{source:?}: {off}");
        for (other, before) in &flights {
            let apart = farthest(&flown, before);
            let one = alike.contains(other) && alike.contains(&depth);
            assert!(one == (apart < 1e-3), "{source:?}: {apart}");
        }
        flights.push((depth, flown));
    }
}

#[test]
fn scheme_d_flies_as_the_text_with_every_depth() {
    let law = |depth| Law::ImageVelocity {
        K_s: 1.0.into(),
        gain: Gain::Constant(1.0),
        interaction: Interaction { at: InteractionAt::Current, depth },
    };
    compare(law, scheme_d, &[]);
}

/// With the exact homography z_d rho_z is the true depth, so that the two are one.
#[test]
fn the_hybrid_law_flies_as_the_text_with_every_depth() {
    let law = |depth| Law::Hybrid {
        gains: HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(2.0).into() },
        gain: Gain::Constant(1.0),
        orientation: OrientationError::AngleAxis,
        space: OperationalSpace::Six,
        depth,
    };
    compare(law, |T, depth| hybrid(T, depth, [1.0, 2.0]), &[Depth::Desired, Depth::True]);
}

/// Another goal, or a view without a pose, does not begin anew; before the first pose it is z_d.
#[test]
fn the_first_pose_of_the_run_is_kept() {
    let robot: Robot<4> = crate::robot::load("scara").unwrap().build().unwrap();
    let law = Law::ImageVelocity {
        K_s: 1.0.into(),
        gain: Gain::Constant(1.0),
        interaction: Interaction { at: InteractionAt::Current, depth: DepthSource::Initial },
    };
    let mount = Mount::EyeToHand { X_BC: Pose::identity() };
    let set_point = SetPoint::from_pose(&X_DO(), &square()).unwrap();
    let mut servo = VisualServo::new(ServoSettings::new(law, UpdatePolicy::Frame, mount), set_point);
    let q = Vector4::new(0.1, 1.5, 0.4, -0.7);
    let take = |servo: &mut VisualServo<4>, k: i64, X_CO: &Pose, has_pose: bool| {
        let now = MonoNs(k * 40_000_000);
        servo.note_arm(now, &q, &Vector4::zeros());
        let mut measurement = perfect_measurement(&square(), X_CO, now).unwrap();
        if !has_pose {
            measurement.flags &= !measurement_flag::POSE;
        }
        assert!(servo.add_measurement(now, &measurement, &robot).is_used());
        servo.camera_law_output().unwrap()
    };
    let later = Pose::new([0.0, -0.07, 0.7].into(), [0.0, 0.1, 0.0].into());
    let T = |X_CO: &Pose| X_CO.to_homogeneous();
    let close = |V: Vector6<f64>, by_text: Vector6<f64>| (V - by_text).norm() < 1e-8;
    let first = take(&mut servo, 0, &later, false);
    assert!(close(first, scheme_d(&T(&later), Depth::Desired)), "{first}");
    take(&mut servo, 1, &start(), true);
    for (k, has_pose) in [(2, true), (3, false)] {
        let V = take(&mut servo, k, &later, has_pose);
        assert!(close(V, scheme_d(&T(&later), Depth::Initial)), "{k} {V}");
    }
    servo.set_goal(servo.set_point().clone());
    servo.restart();
    let V = take(&mut servo, 4, &later, true);
    assert!(close(V, scheme_d(&T(&later), Depth::Initial)), "{V}");
}
