//! The textbook's closed forms and the damped inverse. Consistency of the algorithms with each other, on every shipped
//! robot, is in tests/cores/robot_consistency.rs.

use super::*;
use crate::geometry::{Pose, rotation_z};
use nalgebra::{Matrix4, SMatrix, SVector, Vector3, Vector4};
use proptest::prelude::*;

fn scara() -> Robot<4> {
    load("scara").unwrap().build().unwrap()
}

fn joints(bound: f64) -> impl Strategy<Value = Vector4<f64>> {
    prop::array::uniform4(-bound..bound).prop_map(|a| Vector4::from_row_slice(&a))
}

/// B(q) of the two-link arm of Example 7.2 with the load of Sect. 10.9, written out.
fn scara_mass_matrix(q: &Vector4<f64>) -> Matrix4<f64> {
    let (a, l, m, I, k, I_m, m_m) = (1.0, 0.5, 50.0, 10.0, 100.0, 0.01, 5.0);
    let (m3, I4) = (2.0, 1.0);
    let c2 = q[1].cos();
    let b11 = I
        + m * l * l
        + k * k * I_m
        + I
        + m * (a * a + l * l + 2.0 * a * l * c2)
        + I_m
        + m_m * a * a
        + m3 * (2.0 * a * a + 2.0 * a * a * c2)
        + I4;
    let b12 = I + m * (l * l + a * l * c2) + k * I_m + m3 * (a * a + a * a * c2) + I4;
    let b22 = I + m * l * l + k * k * I_m + m3 * a * a + I4;
    Matrix4::new(b11, b12, 0.0, I4, b12, b22, 0.0, I4, 0.0, 0.0, m3, 0.0, I4, I4, 0.0, I4)
}

proptest! {
    #[test]
    fn scara_follows_its_closed_forms(q in joints(2.5)) {
        let robot = scara();
        let X = robot.forward(&q);
        let (a1, a2) = (q[0], q[0] + q[1]);
        let p = Vector3::new(a1.cos() + a2.cos(), a1.sin() + a2.sin(), q[2]);
        prop_assert!((X.translation.vector - p).norm() < 1e-13);
        let R = rotation_z(q[0] + q[1] + q[3]);
        prop_assert!((X.rotation.to_rotation_matrix().matrix() - R.matrix()).norm() < 1e-13);
        let B = scara_mass_matrix(&q);
        prop_assert!((robot.mass_matrix(&q) - B).norm() < 1e-12 * B.norm());
        let g = Vector4::new(0.0, 0.0, -2.0 * 9.81, 0.0);
        prop_assert!((robot.gravity(&q) - g).norm() < 1e-12);
    }

    #[test]
    fn coriolis_terms_follow_from_the_inertia_matrix(q in joints(2.5), qd in joints(2.0)) {
        // c_i = sum_jk (dB_ij/dq_k - dB_jk/dq_i / 2) qd_j qd_k, with central differences of the closed form.
        let h = 1e-5;
        let dB: Vec<Matrix4<f64>> = (0..4)
            .map(|k| {
                let mut step = Vector4::zeros();
                step[k] = h;
                (scara_mass_matrix(&(q + step)) - scara_mass_matrix(&(q - step))) / (2.0 * h)
            })
            .collect();
        let robot = scara().with_gravity(Vector3::zeros());
        let bias = robot.inverse_dynamics(&q, &qd, &Vector4::zeros());
        for i in 0..4 {
            let mut c = 0.0;
            for j in 0..4 {
                for k in 0..4 {
                    c += (dB[k][(i, j)] - 0.5 * dB[i][(j, k)]) * qd[j] * qd[k];
                }
            }
            prop_assert!((bias[i] - c).abs() < 1e-6, "{} {}", bias[i], c);
        }
    }
}

#[test]
fn a_reachable_twist_is_reached() {
    let robot = scara();
    let q = Vector4::new(0.2, 1.3, 0.4, -0.5);
    let wanted = Vector4::new(0.1, -0.2, 0.05, 0.3);
    let J = robot.jacobian(&q);
    let result = robot.damped_velocity(&q, &J, &(J * wanted), &Vector4::zeros(), &InverseOptions::default());
    assert!((result.qd - wanted).norm() < 1e-12);
    assert_eq!((result.damping, result.scale, result.at_limit), (0.0, 1.0, [false; 4]));
}

#[test]
fn a_stretched_arm_is_damped() {
    let robot = scara();
    let q = Vector4::new(0.0, 0.0, 0.4, 0.0);
    let V = crate::geometry::Twist::new(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let result =
        robot.damped_velocity(&q, &robot.jacobian(&q), &V, &Vector4::zeros(), &InverseOptions::default());
    assert!(result.damping > 0.04 && result.qd.norm() < 1e-9, "{result:?}");
}

#[test]
fn a_joint_at_its_limit_is_held_and_the_others_take_over() {
    let robot = scara();
    let q = Vector4::new(0.2, 1.0, robot.limits()[2].upper, 0.0);
    let J = robot.jacobian(&q);
    let V = J * Vector4::new(0.1, -0.1, 0.5, 0.0);
    let result = robot.damped_velocity(&q, &J, &V, &Vector4::zeros(), &InverseOptions::default());
    assert_eq!(result.at_limit, [false, false, true, false]);
    assert!((result.qd - Vector4::new(0.1, -0.1, 0.0, 0.0)).norm() < 1e-12, "{}", result.qd);
}

#[test]
fn input_that_is_not_finite_gives_no_motion() {
    let robot = scara();
    let q = Vector4::new(f64::NAN, 1.0, 0.0, 0.0);
    let J = robot.jacobian(&q);
    let V = crate::geometry::Twist::repeat(1.0);
    let result = robot.damped_velocity(&q, &J, &V, &Vector4::zeros(), &InverseOptions::default());
    assert_eq!((result.qd, result.scale), (Vector4::zeros(), 0.0));
    assert_eq!(robot.outside_limits(&q), Some(0));
}

#[test]
fn friction_slope_is_the_derivative() {
    let robot = scara().with_friction([Friction { viscous: 2.0, coulomb: 1.0 }; 4]);
    for scale in [0.0, 2e-4, 1e-3, 0.3] {
        let qd = Vector4::new(1.0, -0.7, 0.4, 2.0) * scale;
        let h = Vector4::repeat(1e-8);
        let measured = (robot.friction_torque(&(qd + h)) - robot.friction_torque(&(qd - h))) / 2e-8;
        assert!((measured - robot.friction_slope(&qd)).amax() < 1e-3, "{measured}");
    }
}

#[test]
fn friction_opposes_motion() {
    let robot = scara().with_friction([Friction { viscous: 2.0, coulomb: 1.0 }; 4]);
    let qd = Vector4::new(0.5, -0.5, 0.0, 2.0);
    assert!((robot.friction_torque(&qd) - Vector4::new(2.0, -2.0, 0.0, 5.0)).norm() < 1e-12);
    let (q, tau) = (Vector4::new(0.1, 0.9, 0.2, 0.0), Vector4::new(1.0, 2.0, 3.0, 4.0));
    let with = robot.forward_dynamics(&q, &qd, &(tau - robot.friction_torque(&qd)));
    assert!((robot.inverse_dynamics(&q, &qd, &with) + robot.friction_torque(&qd) - tau).norm() < 1e-10);
}

#[test]
fn redundant_arms_follow_the_preferred_null_space_motion() {
    // Two coaxial joints in a row: only their sum shows, so the preferred velocity decides their difference.
    let J = SMatrix::<f64, 6, 7>::from_fn(|i, j| f64::from(u8::from(i == j || (i == 5 && j == 6))));
    let text = (0..7).map(|i| {
        format!(
            "[[dh.joint]]\nname = \"j{i}\"\ntype = \"continuous\"\na_m = 0.3\nalpha_rad = 1.0\n\
        limits = {{ velocity_rad_s = 9.0, effort_n_m = 9.0 }}\n\
        link = {{ mass_kg = 1.0, inertia_kg_m2 = {{ xx = 1.0, yy = 1.0, zz = 1.0 }} }}\n"
        )
    });
    let file = tempfile::Builder::new().suffix(".toml").tempfile().unwrap();
    let text = format!("name = \"seven\"\n[dh]\nconvention = \"standard\"\n{}", text.collect::<String>());
    std::fs::write(file.path(), text).unwrap();
    let robot: Robot<7> = load(file.path().to_str().unwrap()).unwrap().build().unwrap();
    let V = crate::geometry::Twist::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.5);
    let mut preferred = SVector::<f64, 7>::zeros();
    preferred[5] = 1.0;
    let result = robot.damped_velocity(&SVector::zeros(), &J, &V, &preferred, &InverseOptions::default());
    assert!((J * result.qd - V).norm() < 1e-12);
    assert!((result.qd[5] - result.qd[6] - 1.0).abs() < 1e-12, "{}", result.qd);
}

/// The links one by one, as files of robots place them, against the chain with which everything is computed.
#[test]
fn links_one_by_one_lead_to_the_flange() {
    for name in ["ur5", "scara", "panda"] {
        let description = load(name).unwrap();
        let q = |i: usize| 0.3 - 0.17 * i as f64;
        let links = description.joints.iter().enumerate().map(|(i, joint)| joint.X_PL(q(i)));
        let X_BE = links.fold(Pose::identity(), |X_BP, X_PL| X_BP * X_PL) * description.X_LE;
        let wanted = crate::dispatch_robot!(description, |robot| robot
            .forward(&SVector::from_fn(|i, _| q(i))))
        .unwrap();
        assert!((X_BE.to_homogeneous() - wanted.to_homogeneous()).norm() < 1e-12, "{name}");
    }
}

/// `ur5.urdf` with every place `scale` times as far away.
fn ur5_scaled(scale: f64) -> Result<RobotDescription, RobotError> {
    let text = include_str!("../../../config/robot/ur5.urdf");
    let mut scaled = String::new();
    for (i, part) in text.split("xyz=\"").enumerate() {
        let (list, rest) = if i == 0 { ("", part) } else { part.split_once('"').unwrap() };
        if i > 0 {
            // of an axis only the direction counts
            let numbers = list.split_whitespace().map(|x| (x.parse::<f64>().unwrap() * scale).to_string());
            scaled += &format!("xyz=\"{}\"", numbers.collect::<Vec<_>>().join(" "));
        }
        scaled += rest;
    }
    super::file::parse_urdf(&scaled, "ur5", "ur5.urdf", Some("tool0"))
}

#[test]
fn a_file_in_millimetres_is_told() {
    let refused = ur5_scaled(1000.0).unwrap_err().to_string();
    assert!(refused.contains("out of range") && refused.contains("millimetres"), "{refused}");
    let small = ur5_scaled(150.0).unwrap().notes.join("; ");
    assert!(small.contains("m long") && small.contains("millimetres"), "{small}");
    assert!(!ur5_scaled(1.0).unwrap().notes.join("; ").contains("millimetres"));
}
