//! `vservo calibrate points` as a real process: a camera from points in space, its file, and what is refused in words.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::vservo;
use nalgebra::{Isometry3, Point3, Vector3};
use serde_json::Value;
use std::path::Path;
use std::process::Output;
use vservo::camera_model::camera_info::CameraInfo;

const F_PX: [f64; 2] = [812.0, 806.0];
const CENTRE_PX: [f64; 2] = [331.0, 236.0];

fn object_in_camera() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.05, -0.02, 0.9), Vector3::new(0.3, -0.5, 0.2))
}

/// Points of a box; `flat`: of one plane.
fn write(folder: &Path, name: &str, count: u32, flat: bool, k1: f64) -> String {
    let mut text = String::from("id,x_m,y_m,z_m,u_px,v_px\n");
    for id in 0..count {
        let t = |rate: f64, size: f64| size * (rate * f64::from(id) + rate).sin();
        let r = Point3::new(t(2.1, 0.12), t(3.7, 0.1), if flat { 0.05 } else { t(5.3, 0.12) });
        let p = object_in_camera() * r;
        let (x, y) = (p.x / p.z, p.y / p.z);
        let bend = 1.0 + k1 * (x * x + y * y);
        let [u, v] = [F_PX[0] * x * bend + CENTRE_PX[0], F_PX[1] * y * bend + CENTRE_PX[1]];
        text += &format!("{id},{:?},{:?},{:?},{u:?},{v:?}\n", r.x, r.y, r.z);
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

fn points(arguments: &[&str]) -> Output {
    vservo().args(["calibrate", "points"]).args(arguments).output().unwrap()
}

#[test]
fn points_in_space_give_a_camera() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("camera.yaml").display().to_string();
    for (lens, k1) in [("pinhole", 0.0), ("k1", -0.12)] {
        let file = write(folder.path(), "points.csv", 24, false, k1);
        let all = [&file, "--size", "640x480", "--lens", lens, "--sd", "0.2", "--out", &out, "--name", "box"];
        let done = points(&[&all[..], &["--json"]].concat());
        assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
        let answer: Value = serde_json::from_slice(&done.stdout).unwrap();
        let number = |value: &Value| value.as_f64().unwrap();
        let camera = &answer["camera"];
        for (key, true_px) in
            [("fx_px", F_PX[0]), ("fy_px", F_PX[1]), ("cx_px", CENTRE_PX[0]), ("cy_px", CENTRE_PX[1])]
        {
            assert!((number(&camera[key]) - true_px).abs() < 1e-4, "{lens} {key}: {camera}");
            assert!((1e-3..50.0).contains(&number(&answer["sd"][key])), "{}", answer["sd"]);
        }
        assert!((number(&camera["distortion"][0]) - k1).abs() < 1e-6, "{camera}");
        let p = [0, 1, 2].map(|i| number(&answer["X_CO"]["position_m"][i]));
        assert!((Vector3::from(p) - object_in_camera().translation.vector).norm() < 1e-6, "{p:?}");
        assert!(answer["usable"] == true && answer["points"].as_array().unwrap().len() == 24);
        // the file is one that every command takes
        let written = std::fs::read_to_string(&out).unwrap();
        let info = CameraInfo::read(&written).unwrap();
        assert!((info.camera().unwrap().intrinsics().fx_px - F_PX[0]).abs() < 1e-3, "{written}");
        assert!(written.starts_with("# vservo calibrate points: usable"), "{written}");
        let words = points(&all);
        let words = String::from_utf8_lossy(&words.stdout).into_owned();
        assert!(words.contains("fx_px") && words.contains("+-") && words.contains("object at"), "{words}");
    }
}

#[test]
fn points_that_make_no_camera_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, count, flat| write(folder.path(), name, count, flat, 0.0);
    let (good, few) = (write("good.csv", 12, false), write("few.csv", 5, false));
    let (six, flat) = (write("six.csv", 6, false), write("flat.csv", 20, true));
    for (arguments, code, what) in [
        (vec![&*few, "--size", "640x480"], 5, "at least 6"),
        (vec![&*six, "--size", "640x480", "--lens", "plumb_bob"], 5, "at least 10"),
        (vec![&*flat, "--size", "640x480"], 5, "one plane"),
        (vec![&*good, "--size", "64x48"], 3, "outside of the image"),
        (vec![&*good, "--size", "large"], 2, "--size large"),
        (vec![&*good, "--size", "640x480", "--sd", "0"], 2, "--sd"),
        (vec!["none.csv", "--size", "640x480"], 3, "none.csv"),
    ] {
        let refused = points(&arguments);
        let err = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(refused.status.code() == Some(code) && err.contains(what), "{arguments:?}: {err}");
        assert!(refused.stdout.is_empty());
    }
}
