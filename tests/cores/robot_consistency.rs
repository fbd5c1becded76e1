//! The algorithms against each other and against finite differences, on every shipped robot, over random states.

#![allow(non_snake_case, clippy::unwrap_used)] // helpers of tests are tests

use nalgebra::{SVector, Vector3};
use proptest::prelude::*;
use vservo::dispatch_robot;
use vservo::geometry::{Pose, Twist, integrate_body_twist, rotate_twist};
use vservo::robot::{ExpressedIn, InverseOptions, Robot, SHIPPED, load};

type Numbers = [f64; 7];

fn vector<const N: usize>(numbers: &Numbers, scale: f64) -> SVector<f64, N> {
    SVector::from_fn(|i, _| numbers[i] * scale)
}

fn jacobians<const N: usize>(robot: &Robot<N>, a: &Numbers, b: &Numbers) {
    let (q, qd): (SVector<f64, N>, SVector<f64, N>) = (vector(a, 3.0), vector(b, 1.0));
    let h = 1e-6;
    let X_EC = Pose::new(Vector3::new(b[0], b[1], b[2]) * 0.2, Vector3::new(a[0], a[1], b[3]));
    let (X, J) = robot.forward_and_jacobian_of_frame(&q, &X_EC, ExpressedIn::Moving);
    let ahead = (robot.forward(&(q + qd * h)) * X_EC).to_homogeneous();
    let behind = (robot.forward(&(q - qd * h)) * X_EC).to_homogeneous();
    let V = J * qd;
    let predicted =
        integrate_body_twist(&X, &V, h).to_homogeneous() - integrate_body_twist(&X, &V, -h).to_homogeneous();
    assert!((ahead - behind - predicted).amax() / (2.0 * h) < 1e-8, "{}", robot.name());
    let in_base = robot.jacobian_of_frame(&q, &X_EC, ExpressedIn::Base) * qd;
    assert!((rotate_twist(&X.rotation.to_rotation_matrix(), &V) - in_base).amax() < 1e-12);
}

fn dynamics<const N: usize>(robot: &Robot<N>, a: &Numbers, b: &Numbers, c: &Numbers) {
    let (q, qd, qdd): (SVector<f64, N>, SVector<f64, N>, SVector<f64, N>) =
        (vector(a, 3.0), vector(b, 2.0), vector(c, 5.0));
    let tau = robot.inverse_dynamics(&q, &qd, &qdd);
    let scale = tau.amax().max(1.0);
    let sum = robot.mass_matrix(&q) * qdd + robot.inverse_dynamics(&q, &qd, &SVector::zeros());
    assert!((tau - sum).amax() < 1e-12 * scale, "{}", robot.name());
    assert!((robot.forward_dynamics(&q, &qd, &tau) - qdd).amax() < 1e-10 * qdd.amax().max(1.0));
    // g(q) is the slope of the potential energy, and the power of tau goes into the energy.
    let h = 1e-5;
    let slope = SVector::<f64, N>::from_fn(|i, _| {
        let mut step = SVector::<f64, N>::zeros();
        step[i] = h;
        (robot.potential_energy(&(q + step)) - robot.potential_energy(&(q - step))) / (2.0 * h)
    });
    assert!((robot.gravity(&q) - slope).amax() < 1e-6 * scale, "{}", robot.name());
    let energy = |t: f64| {
        let (q, qd) = (q + qd * t + qdd * (0.5 * t * t), qd + qdd * t);
        robot.kinetic_energy(&q, &qd) + robot.potential_energy(&q)
    };
    let power = (energy(h) - energy(-h)) / (2.0 * h);
    assert!((power - tau.dot(&qd)).abs() < 1e-5 * scale, "{}: {power} {}", robot.name(), tau.dot(&qd));
}

fn payload<const N: usize>(robot: &Robot<N>, a: &Numbers, b: &Numbers) {
    let (q, qd): (SVector<f64, N>, SVector<f64, N>) = (vector(a, 3.0), vector(b, 2.0));
    let (mass, com_E) = (1.3, Vector3::new(b[4], b[5], b[6]) * 0.3);
    let g_B = Vector3::new(1.0, -2.0, -9.0);
    let robot = robot.clone().with_gravity(g_B);
    let loaded = robot.clone().with_payload(mass, &com_E);
    let X_EP = Pose::translation(com_E.x, com_E.y, com_E.z);
    let (X_BP, J) = robot.forward_and_jacobian_of_frame(&q, &X_EP, ExpressedIn::Base);
    let v = (J * qd).fixed_rows::<3>(0).into_owned();
    let kinetic = loaded.kinetic_energy(&q, &qd) - robot.kinetic_energy(&q, &qd);
    assert!((kinetic - 0.5 * mass * v.norm_squared()).abs() < 1e-10 * (1.0 + robot.kinetic_energy(&q, &qd)));
    let potential = loaded.potential_energy(&q) - robot.potential_energy(&q);
    assert!((potential + mass * g_B.dot(&X_BP.translation.vector)).abs() < 1e-10);
}

/// Follows one wanted twist for a second from a posture inside the limits: whatever it is, the limits hold, and
/// where the motion is not the one asked for, the result says why.
fn limits_hold<const N: usize>(robot: &Robot<N>, a: &Numbers, v: &[f64; 6]) {
    let options = InverseOptions::default();
    let mut q = SVector::<f64, N>::from_fn(|i, _| {
        let limit = robot.limits()[i];
        limit.lower + (limit.upper - limit.lower) * (0.5 + 0.5 * a[i])
    });
    let V = Twist::from_row_slice(v);
    for _ in 0..200 {
        let J = robot.jacobian(&q);
        let result = robot.damped_velocity(&q, &J, &V, &SVector::zeros(), &options);
        for (qd, limit) in result.qd.iter().zip(robot.limits()) {
            assert!(qd.abs() <= limit.velocity * (1.0 + 1e-12));
        }
        let reached = (J * result.qd - V).amax() < 1e-6 * (1.0 + V.amax());
        let free = result.damping == 0.0 && result.scale == 1.0 && result.at_limit == [false; N];
        // An arm of fewer than six joints does its best without a reason to report.
        assert!(reached || !free || N < 6, "{}: unreported {result:?}", robot.name());
        q += result.qd * 0.005;
        assert_eq!(robot.outside_limits(&q), None, "{}: {q} {result:?}", robot.name());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    #[test]
    fn every_shipped_robot(
        a in prop::array::uniform7(-1.0..1.0f64), b in prop::array::uniform7(-1.0..1.0f64),
        c in prop::array::uniform7(-1.0..1.0f64), v in prop::array::uniform6(-2.0..2.0f64)
    ) {
        for name in SHIPPED {
            dispatch_robot!(load(name).unwrap(), |robot| {
                jacobians(&robot, &a, &b);
                dynamics(&robot, &a, &b, &c);
                payload(&robot, &a, &b);
                limits_hold(&robot, &a, &v);
            }).unwrap();
        }
    }
}

/// The Panda's published modified Denavit-Hartenberg table, with links of no importance.
fn panda_table() -> String {
    let quarter = std::f64::consts::FRAC_PI_2;
    let rows = [
        (0.0, 0.0, 0.333),
        (0.0, -quarter, 0.0),
        (0.0, quarter, 0.316),
        (0.0825, quarter, 0.0),
        (-0.0825, -quarter, 0.384),
        (0.0, quarter, 0.0),
        (0.088, quarter, 0.0),
    ];
    let mut text =
        "name = \"table\"\n[tool]\nposition_m = [0.0, 0.0, 0.107]\n[dh]\nconvention = \"modified\"\n"
            .to_owned();
    for (i, (a, alpha, d)) in rows.into_iter().enumerate() {
        text += &format!(
            "[[dh.joint]]\nname = \"j{i}\"\ntype = \"continuous\"\na_m = {a:?}\nalpha_rad = {alpha:?}\nd_m = {d:?}\n\
             limits = {{ velocity_rad_s = 2.0, effort_n_m = 9.0 }}\n\
             link = {{ mass_kg = 1.0, inertia_kg_m2 = {{ xx = 1.0, yy = 1.0, zz = 1.0 }} }}\n"
        );
    }
    text
}

#[test]
fn a_modified_table_gives_the_same_arm_as_the_urdf() {
    let file = tempfile::Builder::new().suffix(".toml").tempfile().unwrap();
    std::fs::write(file.path(), panda_table()).unwrap();
    let table: Robot<7> = load(file.path().to_str().unwrap()).unwrap().build().unwrap();
    let urdf: Robot<7> = load("panda").unwrap().build().unwrap();
    for k in 0..20 {
        let q = SVector::<f64, 7>::from_fn(|i, _| (f64::from(k) * 1.7 + i as f64 * 0.9).sin() * 3.0);
        assert!((table.jacobian(&q) - urdf.jacobian(&q)).amax() < 1e-12);
        assert!((table.forward(&q).to_homogeneous() - urdf.forward(&q).to_homogeneous()).amax() < 1e-12);
    }
}
