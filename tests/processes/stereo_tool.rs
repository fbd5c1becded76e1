//! `vservo stereo` as a real process, on scenes in closed form: a textured plane before two cameras that squint, points in space, and
//! Example 10.5's kind of homography.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests
#![allow(non_snake_case)] // X, R, F, H as in the text

use crate::process_image::ended;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use serde_json::Value;
use std::path::Path;
use vservo::linalg::Random;

const F_PX: f64 = 600.0;
const SIZE: (u32, u32) = (320, 240);
const CENTRE: [f64; 2] = [159.5, 119.5];
/// Depth of the plane in camera 1, m.
const DEPTH_M: f64 = 0.5;

/// Camera 2 to the right, turned inwards and a little about its axis.
fn squinting() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, -0.08, 0.02));
    Isometry3::from_parts(Translation3::new(0.06, 0.004, -0.003), turn)
}

fn pixel(p: &Point3<f64>) -> Vector2<f64> {
    p.coords.xy() / p.z * F_PX + Vector2::from(CENTRE)
}

/// Grey level of the plane: waves of many lengths, 6 to 25 px in the image, so that no place is like another.
fn texture(x: f64, y: f64) -> u8 {
    let mut sum = 0.0;
    for k in 0..14 {
        let k = f64::from(k);
        let (angle, wave_m) = (k * 2.399, 0.005 + 0.0011 * k);
        sum += (std::f64::consts::TAU * (x * angle.cos() + y * angle.sin()) / wave_m + 1.7 * k * k).sin();
    }
    (128.0 + 22.0 * sum).clamp(0.0, 255.0).round() as u8
}

/// The plane through a camera at `X_1C`.
fn image(X_1C: &Isometry3<f64>) -> image::GrayImage {
    image::GrayImage::from_fn(SIZE.0, SIZE.1, |u, v| {
        let ray = Vector3::new((f64::from(u) - CENTRE[0]) / F_PX, (f64::from(v) - CENTRE[1]) / F_PX, 1.0);
        let (ray, o) = (X_1C.rotation * ray, X_1C.translation.vector);
        let p = o + ray * ((DEPTH_M - o.z) / ray.z);
        image::Luma([texture(p.x, p.y)])
    })
}

/// Both calibration files and that of the pair, as `vservo calibrate stereo` writes them.
fn pair(folder: &Path, X_12: &Isometry3<f64>) -> String {
    let camera = format!(
        "image_width: {}\nimage_height: {}\ncamera_name: one\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [{F_PX}, 0.0, {}, 0.0, {F_PX}, {}, 0.0, 0.0, 1.0]\n\
         distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.0, 0.0, 0.0, 0.0, 0.0]\n",
        SIZE.0, SIZE.1, CENTRE[0], CENTRE[1]
    );
    std::fs::write(folder.join("camera.yaml"), camera).unwrap();
    let (p, q) = (X_12.translation.vector, X_12.rotation.coords);
    let text = format!(
        "left: \"camera.yaml\"\nright: \"camera.yaml\"\nX_LR:\n  position_m: [{:?}, {:?}, {:?}]\n  rotation_xyzw: [{:?}, {:?}, {:?}, {:?}]\n",
        p.x, p.y, p.z, q.x, q.y, q.z, q.w
    );
    let path = folder.join("pair.yaml");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn images(folder: &Path) -> [String; 2] {
    [("left.png", Isometry3::identity()), ("right.png", squinting())].map(|(name, X)| {
        let path = folder.join(name);
        image(&X).save(&path).unwrap();
        path.to_str().unwrap().to_owned()
    })
}

/// Points in space, not of one plane.
fn points() -> Vec<Point3<f64>> {
    (0..14)
        .map(|k| {
            let k = f64::from(k);
            Point3::new(0.1 * (1.9 * k).sin(), 0.08 * (2.3 * k + 1.0).cos(), 0.5 + 0.12 * (3.1 * k).sin())
        })
        .collect()
}

fn pairs_file(folder: &Path, name: &str, X_12: &Isometry3<f64>, points: &[Point3<f64>]) -> String {
    let mut text = String::from("id,u1_px,v1_px,u2_px,v2_px\n");
    for (id, p) in points.iter().enumerate() {
        let (a, b) = (pixel(p), pixel(&(X_12.inverse() * p)));
        text += &format!("{id},{:?},{:?},{:?},{:?}\n", a.x, a.y, b.x, b.y);
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn json(arguments: &[&str]) -> Value {
    let (code, out, err) = ended(&[&["stereo"], arguments, &["--json"]].concat());
    assert_eq!(code, 0, "{err}");
    serde_json::from_str(&out).unwrap()
}

fn list(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn matrix(value: &Value) -> Matrix3<f64> {
    Matrix3::from_row_iterator(value.as_array().unwrap().iter().flat_map(list))
}

#[test]
fn conjugates_are_found_along_their_lines() {
    let folder = tempfile::tempdir().unwrap();
    let ([left, right], pair) = (images(folder.path()), pair(folder.path(), &squinting()));
    let overlay = folder.path().join("lines.png");
    let wanted = [[90.0, 60.0], [160.0, 120.0], [220.0, 170.0], [140.0, 190.0]];
    let text = wanted.map(|[u, v]| format!("{u},{v}")).join(";");
    let depths = ["--nearest-m", "0.3", "--farthest-m", "1"];
    let arguments =
        [&["match", &left, &right, "--pair", &pair, "--points", &text], depths.as_slice()].concat();
    let answer = json(&[arguments.as_slice(), &["--overlay", overlay.to_str().unwrap()]].concat());
    for (found, [u, v]) in answer["matches"].as_array().unwrap().iter().zip(wanted) {
        let p = Point3::new((u - CENTRE[0]) / F_PX * DEPTH_M, (v - CENTRE[1]) / F_PX * DEPTH_M, DEPTH_M);
        let truth = pixel(&(squinting().inverse() * p));
        let own = list(&found["right_px"]);
        let off = (own[0] - truth.x).hypot(own[1] - truth.y);
        assert!(off < 0.15, "{found}, wanted {truth}");
        assert!((found["depth_m"].as_f64().unwrap() - DEPTH_M).abs() < 2e-3, "{found}");
        // the true place lies on the line that is told, and so does the match
        let line = list(&found["epipolar_line"]);
        assert!((line[0] * truth.x + line[1] * truth.y + line[2]).abs() < 1e-9, "{found}");
        let back = list(&found["left_epipolar_line"]);
        assert!((back[0] * u + back[1] * v + back[2]).abs() < 1e-3, "{found}");
        assert!(found["line_distance_px"].as_f64().unwrap() < 1e-6, "{found}");
    }
    let drawn = image::open(&overlay).unwrap();
    assert_eq!((drawn.width(), drawn.height()), (2 * SIZE.0, SIZE.1));

    // without points: corners, as CSV that the other commands read
    let arguments =
        [&["stereo", "match", &left, &right, "--pair", &pair, "--corners", "30"], depths.as_slice()].concat();
    let (code, csv, err) = ended(&arguments);
    assert_eq!(code, 0, "{err}");
    assert!(csv.lines().count() > 10, "{csv}");
    let matches = folder.path().join("matches.csv");
    std::fs::write(&matches, csv).unwrap();
    let places = json(&["triangulate", matches.to_str().unwrap(), "--pair", &pair]);
    let depths: Vec<f64> =
        places["points"].as_array().unwrap().iter().map(|p| list(&p["position_m"])[2]).collect();
    let good = depths.iter().filter(|z| (**z - DEPTH_M).abs() < 3e-3).count();
    assert!(good * 10 >= depths.len() * 9, "{depths:?}");
}

#[test]
fn positions_come_back_by_every_method() {
    let folder = tempfile::tempdir().unwrap();
    let (pair, points) = (pair(folder.path(), &squinting()), points());
    let file = pairs_file(folder.path(), "pairs.csv", &squinting(), &points);
    for method in ["optimal", "linear", "parallel"] {
        let answer = json(&["triangulate", &file, "--pair", &pair, "--method", method]);
        for (own, p) in answer["points"].as_array().unwrap().iter().zip(&points) {
            let off = (Vector3::from_vec(list(&own["position_m"])) - p.coords).norm();
            assert!(off < 1e-9, "{method}: {own} against {p}");
            assert!(own["rms"].as_f64().unwrap() < 1e-10 && own["covariance"].is_null());
        }
    }
    let (code, csv, _) = ended(&["stereo", "triangulate", &file, "--pair", &pair]);
    assert!(code == 0 && csv.lines().count() == points.len() + 1, "{csv}");
}

#[test]
fn the_deviation_of_a_depth_is_that_of_its_disparity() {
    // parallel cameras: z = f b / d, so that sd(z) = z^2 sqrt(2) sd / (f b) in the middle between them
    let folder = tempfile::tempdir().unwrap();
    let X_12 = Isometry3::translation(0.1, 0.0, 0.0);
    let pair = pair(folder.path(), &X_12);
    let file = pairs_file(folder.path(), "pairs.csv", &X_12, &[Point3::new(0.05, 0.0, 0.8)]);
    let answer = json(&["triangulate", &file, "--pair", &pair, "--sd", "0.2"]);
    let covariance = list(&answer["points"][0]["covariance"]);
    let wanted = 0.8f64.powi(2) * 2f64.sqrt() * 0.2 / (F_PX * 0.1);
    assert!((covariance[8].sqrt() / wanted - 1.0).abs() < 1e-6, "{covariance:?} against {wanted}");
}

#[test]
fn rectified_images_have_conjugates_in_one_row() {
    let folder = tempfile::tempdir().unwrap();
    let ([left, right], pair) = (images(folder.path()), pair(folder.path(), &squinting()));
    let out = folder.path().join("rectified");
    let answer = json(&["rectify", &left, &right, "--pair", &pair, "--out", out.to_str().unwrap()]);
    let (R_1, R_2) = (matrix(&answer["R_R1"]), matrix(&answer["R_R2"]));
    let number = |name: &str| answer["camera"][name].as_f64().unwrap();
    let (f, c) = (number("fx_px"), Vector2::new(number("cx_px"), number("cy_px")));
    let seen = |p: Vector3<f64>| p.xy() / p.z * f + c;
    let baseline = answer["baseline_m"].as_f64().unwrap();
    assert!((baseline - squinting().translation.vector.norm()).abs() < 1e-12);
    for p in points() {
        let (p_R, second) = (R_1 * p.coords, R_2 * (squinting().inverse() * p).coords);
        let (a, b) = (seen(p_R), seen(second));
        assert!((a.y - b.y).abs() < 1e-9, "{a} {b}");
        assert!((a.x - b.x - f * baseline / p_R.z).abs() < 1e-9, "{a} {b}");
    }
    // the pictures are those of the turned cameras
    for (name, R, o) in [
        ("left.png", R_1, Vector3::zeros()),
        (
            "right.png",
            R_2 * squinting().rotation.inverse().to_rotation_matrix(),
            squinting().translation.vector,
        ),
    ] {
        let picture = image::open(out.join(name)).unwrap().into_luma8();
        let (mut sum, mut count) = (0.0, 0.0);
        for (u, v, level) in picture.enumerate_pixels().filter(|(u, v, _)| u % 7 == 3 && v % 5 == 2) {
            let ray = Vector3::new((f64::from(u) - c.x) / f, (f64::from(v) - c.y) / f, 1.0);
            let ray = R.transpose() * ray;
            let p = o + ray * ((DEPTH_M - o.z) / ray.z);
            // where the camera saw nothing the picture is black
            if level.0[0] > 0 {
                sum += (f64::from(level.0[0]) - f64::from(texture(p.x, p.y))).abs();
                count += 1.0;
            }
        }
        assert!(count > 800.0 && sum / count < 8.0, "{name}: {} levels over {count} pixels", sum / count);
    }
    assert!(out.join("rows.png").exists());
}

#[test]
fn the_displacement_comes_back_from_points() {
    let folder = tempfile::tempdir().unwrap();
    let _ = pair(folder.path(), &squinting());
    let camera = folder.path().join("camera.yaml");
    let camera = camera.to_str().unwrap();
    let file = pairs_file(folder.path(), "pairs.csv", &squinting(), &points());
    let direction = squinting().translation.vector.normalize();
    let truth = squinting().rotation;
    let is_truth = |s: &Value| {
        let q = list(&s["rotation_xyzw"]);
        let own = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[3], q[0], q[1], q[2]));
        let along = Vector3::from_vec(list(&s["direction"])).normalize().dot(&direction);
        own.angle_to(&truth) < 1e-6 && along > 1.0 - 1e-9
    };
    for method in ["five_point", "eight_point", "consensus"] {
        let answer = json(&["motion", &file, "--camera", camera, "--method", method, "--sd", "0.2"]);
        let first = &answer["solutions"][0];
        assert!(is_truth(first) && answer["ambiguous"] == false, "{method}: {first}");
        assert_eq!(first["in_front"], 14, "{first}");
        // the epipolar constraint in pixels, and the epipole as the image of the other camera
        let F = matrix(&first["fundamental"]);
        for p in points() {
            let (a, b) = (pixel(&p).push(1.0), pixel(&(squinting().inverse() * p)).push(1.0));
            assert!(a.dot(&(F * b)).abs() < 1e-6 * a.norm() * b.norm(), "{method}");
        }
        let epipole = list(&first["epipole_1"]);
        let o = squinting().translation.vector;
        assert!((epipole[0] - o.x / o.z).abs() < 1e-3 * (o.x / o.z).abs(), "{first}");
    }
    // two pairs of fourteen wrong
    let text = std::fs::read_to_string(&file).unwrap();
    let wrong = folder.path().join("wrong.csv");
    std::fs::write(&wrong, format!("{text}14,30,200,290,20\n15,300,30,20,230\n")).unwrap();
    let answer = json(&["motion", wrong.to_str().unwrap(), "--camera", camera, "--sd", "0.2"]);
    let first = &answer["solutions"][0];
    assert!(is_truth(first), "{first}");
    assert_eq!(list(&first["inliers"]), (0..14).map(f64::from).collect::<Vec<_>>());
    assert_eq!(list(&first["covariance"]).len(), 25);
    // pixels alone give F
    let answer = json(&["motion", &file, "--method", "eight_point"]);
    assert!(answer["fundamental"]["rms_px"].as_f64().unwrap() < 1e-6, "{answer}");
    let (code, _, err) = ended(&["stereo", "motion", &file, "--method", "five_point"]);
    assert!(code == 2 && err.contains("--method eight_point"), "{err}");
    let five = folder.path().join("five.csv");
    std::fs::write(&five, text.lines().take(6).map(|line| format!("{line}\n")).collect::<String>()).unwrap();
    let answer = json(&["motion", five.to_str().unwrap(), "--camera", camera, "--method", "five_point"]);
    assert!(answer["solutions"].as_array().unwrap().iter().any(is_truth), "{answer}");
}

/// With noise a refinement may come to the opposite base line, which explains the images as well and has no point in front.
#[test]
fn five_points_and_more_tell_the_side_of_the_base_line() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random::new(7);
    let mut write = |name: &str, X_12: &Isometry3<f64>, pairs: u32| {
        let mut text = String::from("X1,Y1,X2,Y2\n");
        for _ in 0..pairs {
            let z = random.between(0.5, 1.0);
            let p = Point3::new(random.between(-0.4, 0.4) * z, random.between(-0.3, 0.3) * z, z);
            let q = X_12.inverse() * p;
            let noise = [0; 4].map(|_| random.between(-1.7e-4, 1.7e-4));
            let (x1, y1) = (p.x / p.z + noise[0], p.y / p.z + noise[1]);
            text += &format!("{x1},{y1},{},{}\n", q.x / q.z + noise[2], q.y / q.z + noise[3]);
        }
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let turn = UnitQuaternion::from_euler_angles(0.03, -0.15, 0.03);
    let beside = Isometry3::from_parts(Vector3::new(0.12, 0.004, -0.006).into(), turn);
    let mut ambiguous = 0;
    for k in 0..40 {
        let answer = json(&["motion", &write("pairs.csv", &beside, 20), "--method", "five_point"]);
        let first = &answer["solutions"][0];
        let along = Vector3::from_vec(list(&first["direction"])).dot(&beside.translation.vector.normalize());
        assert!(along > 0.999 && first["in_front"] == 20, "{k}: {first}");
        ambiguous += u32::from(answer["ambiguous"] == true);
    }
    assert_eq!(ambiguous, 0);
    // A camera that turned alone has none, whatever the method.
    let turned = write("turned.csv", &Isometry3::from_parts(Vector3::zeros().into(), turn), 60);
    for method in ["five_point", "eight_point", "consensus", "plane"] {
        let answer = json(&["motion", &turned, "--method", method]);
        let reason = answer["reason"].as_str().unwrap();
        assert!(answer["ambiguous"] == true && reason.contains("turned alone"), "{method}: {answer}");
    }
    let answer = json(&["motion", "--homography", "1,0,0,0,1,0,0,0,1"]);
    assert!(answer["ambiguous"] == true && answer["plane"]["readings"][0]["normal_2"].is_null(), "{answer}");
}

#[test]
fn both_readings_of_a_plane_and_what_tells_them_apart() {
    let folder = tempfile::tempdir().unwrap();
    let R = Rotation3::from_scaled_axis(Vector3::new(0.05, 0.3, -0.1));
    let (o, n, d) = (Vector3::new(0.2, -0.05, 0.1), Vector3::new(0.2, -0.3, 1.0).normalize(), 0.8);
    let H = R.matrix() + o * n.transpose() / d;
    let text = H.transpose().iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(",");
    let is_truth = |r: &Value| {
        (matrix(&r["rotation"]) - R.matrix()).norm() < 1e-9
            && (Vector3::from_vec(list(&r["position_over_distance"])) - o / d).norm() < 1e-9
            && (Vector3::from_vec(list(&r["normal_2"])) - n).norm() < 1e-9
    };
    let readings = |arguments: &[&str]| json(arguments)["plane"]["readings"].as_array().unwrap().clone();
    let both = readings(&["motion", "--homography", &text]);
    assert!(both.len() == 2 && both.iter().filter(|r| is_truth(r)).count() == 1, "{both:?}");
    for known in [["--normal", "0,-0.2,1"], ["--direction", "1,0,0.4"]] {
        let one = readings(&[&["motion", "--homography", &text], known.as_slice()].concat());
        assert!(one.len() == 1 && is_truth(&one[0]), "{known:?}: {one:?}");
    }
    // a hint as far from the one as from the other tells nothing, and one without a direction is none
    let [a, b] = [0, 1].map(|i| Vector3::from_vec(list(&both[i]["normal_2"])));
    let between = (a + b).iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(",");
    assert_eq!(readings(&["motion", "--homography", &text, "--normal", &between]).len(), 2);
    let (code, _, err) = ended(&["stereo", "motion", "--homography", &text, "--normal", "0,0,0"]);
    assert!(code == 2 && err.contains("has no direction"), "{err}");
    // from points of the plane n . p = d in camera 2, seen from camera 1 and from a third place
    let on_plane: Vec<_> = [[-0.2, -0.1], [0.25, -0.15], [0.2, 0.2], [-0.15, 0.15], [0.05, 0.02]]
        .map(|[x, y]| {
            let ray = Vector3::new(x, y, 1.0);
            ray * (d / n.dot(&ray))
        })
        .into();
    let write = |name: &str, X_i2: &Isometry3<f64>| {
        let mut text = String::from("X1,Y1,X2,Y2\n");
        for p in &on_plane {
            let (a, b) = ((X_i2 * Point3::from(*p)).coords, p);
            text += &format!("{:?},{:?},{:?},{:?}\n", a.x / a.z, a.y / a.z, b.x / b.z, b.y / b.z);
        }
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let X_12 = Isometry3::from_parts(Translation3::from(o), UnitQuaternion::from_rotation_matrix(&R));
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(-0.2, 0.1, 0.05));
    let X_32 = Isometry3::from_parts(Translation3::new(-0.1, 0.15, 0.05), turn);
    let (first, third) = (write("first.csv", &X_12), write("third.csv", &X_32));
    let both = readings(&["motion", &first, "--method", "plane"]);
    assert!(both.iter().any(is_truth), "{both:?}");
    let one = readings(&["motion", &first, "--method", "plane", "--third", &third]);
    assert!(one.len() == 1 && is_truth(&one[0]), "{one:?}");
}
