use super::super::Config;
use crate::geometry::{Pose, rotation_x, rotation_y, rotation_z};
use nalgebra::UnitQuaternion;
use proptest::prelude::*;
use std::path::Path;

fn desired(keys: &str, set: &[String]) -> Result<[f64; 6], String> {
    let text = format!("[servo.desired]\n{keys}\n");
    let config = Config::parse("run.toml", &text, Path::new("."), set).map_err(|e| e.to_string())?;
    let desired = config.effective.servo.desired;
    let ([x, y, z], [roll, pitch, yaw]) = (desired.position_m, desired.rotation_rpy_rad);
    Ok([x, y, z, roll, pitch, yaw])
}

fn rotation([roll, pitch, yaw]: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&(rotation_z(yaw) * rotation_y(pitch) * rotation_x(roll)))
}

/// Every way to write the pose, as TOML.
fn forms(X: &Pose, rpy: [f64; 3], decimals: usize) -> [String; 5] {
    let list = |v: &[f64]| {
        format!("[{}]", v.iter().map(|x| format!("{x:.decimals$}")).collect::<Vec<_>>().join(", "))
    };
    let p = format!("position_m = {}\n", list(X.translation.vector.as_slice()));
    let M = X.to_homogeneous();
    let rows: Vec<_> = (0..4).map(|i| list(&[M[(i, 0)], M[(i, 1)], M[(i, 2)], M[(i, 3)]])).collect();
    [
        format!("{p}rotation_rpy_rad = {}", list(&rpy)),
        format!("{p}rotation_rpy_deg = {}", list(&rpy.map(f64::to_degrees))),
        format!("{p}rotation_xyzw = {}", list(X.rotation.coords.as_slice())),
        format!("{p}rotation_vector_rad = {}", list(X.rotation.scaled_axis().as_slice())),
        format!("matrix = [{}]", rows.join(", ")),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]
    /// The same pose in every form is the same pose, to what the decimals leave of it.
    #[test]
    fn every_form_is_the_same_pose(roll in -0.2..0.2f64, pitch in -0.2..0.2f64, yaw in -3.0..3.0f64) {
        let rpy = [roll, pitch, yaw];
        let X = Pose::from_parts([-0.02, 0.01, 0.6].into(), rotation(rpy));
        for (decimals, allowed) in [(15, 1e-12), (3, 3e-3)] {
            for form in forms(&X, rpy, decimals) {
                let [x, y, z, roll, pitch, yaw] = desired(&form, &[]).map_err(TestCaseError::fail)?;
                let found = Pose::from_parts([x, y, z].into(), rotation([roll, pitch, yaw]));
                let off = found.inv_mul(&X);
                prop_assert!(off.translation.vector.norm() < allowed && off.rotation.angle() < allowed, "{form}: {off}");
            }
        }
    }
}

#[test]
fn what_is_no_pose_is_told_with_its_place() {
    let eye = "[1, 0, 0, 0], [0, 1, 0, 0]";
    for (keys, wanted) in [
        ("rotation_xyzw = [0.0, 0.0, 0.0, 0.5]", "run.toml:2:1: servo.desired.rotation_xyzw: has length 0.5"),
        (
            "rotation_xyzw = [0.0, 0.0, 1e308, 0.5]",
            "run.toml:2:28: servo.desired.rotation_xyzw[2]: 1e308 is out",
        ),
        ("rotation_xyzw = [0.0, 0.0, 1.0]", "servo.desired.rotation_xyzw: invalid length 3"),
        (
            "rotation_rpy_rad = [0.0, 0.0, 1.0]\nrotation_rpy_deg = [0.0, 0.0, 1.0]",
            "run.toml:3:1: servo.desired.rotation_rpy_deg: says what rotation_rpy_rad says too",
        ),
        (
            "rotation_rpy_deg = [0.0, 0.0, 400.0]",
            "run.toml:2:31: servo.desired.rotation_rpy_deg[2]: 400 is out",
        ),
        ("rotation_vector_rad = [0.0, 0.0, -1e308]", "rotation_vector_rad[2]: -1e308 is out"),
        (
            &format!("position_m = [0.0, 0.0, 0.5]\nmatrix = [{eye}, [0, 0, 1, 0.6], [0, 0, 0, 1]]"),
            "run.toml:3:1: servo.desired.matrix: has the position too",
        ),
        (&format!("matrix = [{eye}, [0, 0, 2, 0.6], [0, 0, 0, 1]]"), "matrix: is no rotation"),
        (&format!("matrix = [{eye}, [0, 0, -1, 0.6], [0, 0, 0, 1]]"), "matrix: is a mirror image"),
        (&format!("matrix = [{eye}, [0, 0, 1, 600.0], [0, 0, 0, 1]]"), "matrix[2][3]: 600 is out of range"),
        (&format!("matrix = [{eye}, [0, 0, 1, 0], [0, 0, 0.6, 1]]"), "matrix[3]: is not [0, 0, 0, 1]"),
        (&format!("matrix = [{eye}, [0, 0, nan, 0.6], [0, 0, 0, 1]]"), "matrix: is no rotation"),
    ] {
        let error = desired(keys, &[]).unwrap_err();
        assert!(error.contains(wanted), "{keys}: {error}");
        assert!(!error.contains("point "), "no word of a view that nobody asked for: {error}");
    }
}

#[test]
fn what_is_set_takes_the_place_of_what_is_written() {
    let written = "position_m = [-0.02, 0.01, 0.6]\nrotation_rpy_rad = [0.0, 0.0, 0.4]";
    let set = |s: &str| desired(written, &[format!("servo.desired.{s}")]);
    let turned = set("rotation_rpy_deg=[0, 0, -30]").unwrap();
    assert_eq!(turned[..3], [-0.02, 0.01, 0.6]);
    assert!((turned[5] + 30f64.to_radians()).abs() < 1e-15);
    let whole = set("matrix=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]").unwrap();
    assert_eq!(whole, [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]);
}

/// A form takes the place of the default rotation and leaves the default position.
#[test]
fn a_rotation_alone_leaves_the_position() {
    let text = "[scene.object]\nrotation_xyzw = [0.0, 0.0, 0.3826834, 0.9238795]\n";
    let object = Config::parse("run.toml", text, Path::new("."), &[]).unwrap().effective.scene.object;
    assert_eq!(object.position_m, [1.0; 3]);
    let [roll, pitch, yaw] = object.rotation_rpy_rad;
    assert!((roll, pitch) == (0.0, 0.0) && (yaw - std::f64::consts::FRAC_PI_4).abs() < 1e-6, "{yaw}");
}
