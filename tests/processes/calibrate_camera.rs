//! Calibration of cameras: OpenCV's photographs against OpenCV's figures, and the commands as real processes.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests
#![allow(non_snake_case)] // X as in the text

use crate::common::{Instance, kill, vservo, wait_until};
use nalgebra::{Matrix2, Point3, Vector2};
use serde_json::Value;
use std::path::{Path, PathBuf};
use vservo::calibration::camera::{
    BoardPoint, BoardView, CalibrationSettings, CameraCalibration, calibrate_camera,
};
use vservo::calibration::stereo::calibrate_stereo;
use vservo::camera_model::LensModel;
use vservo::camera_model::camera_info::CameraInfo;
use vservo::detect::chessboard::ChessboardFinder;
use vservo::imaging::ImageView;
use vservo::ipc::Role;
use vservo::messages::CameraId;
use vservo::pose::{Correspondence, Loss, PixelCorrespondence, planar_pose, refine_pixels};

const REFERENCE: &str = include_str!("../fixtures/opencv_chessboard_corners.csv");
const SIZE: (u32, u32) = (640, 480);

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/opencv-stereo-chessboard")
}

fn photographs(side: &str) -> Vec<PathBuf> {
    let paths = (1..=9).map(|n| folder().join(format!("{side}{n:02}.jpg")));
    paths.filter(|path| path.exists()).collect()
}

/// Unit squares.
fn point(id: u32, px: Vector2<f64>, covariance_px2: Matrix2<f64>) -> BoardPoint {
    let p_O = Point3::new(f64::from(id % 9), f64::from(id / 9), 0.0);
    BoardPoint { id, p_O, px, covariance_px2 }
}

/// Corners as OpenCV found them, all alike.
fn opencv_corners(side: &str) -> Vec<BoardView> {
    let view = |n: i32| {
        let name = format!("{side}{n:02}");
        let lines = REFERENCE.lines().filter(|l| l.split(',').next() == Some(&name));
        let fields = lines.map(|l| l.split(',').skip(1).map(|x| x.parse().unwrap()).collect::<Vec<f64>>());
        fields.map(|f| point(f[0] as u32, Vector2::new(f[1], f[2]), Matrix2::zeros())).collect()
    };
    (1..=9).map(view).collect()
}

fn own_corners(side: &str) -> Vec<BoardView> {
    let mut finder = ChessboardFinder::new(9, 6, 640, 480);
    let mut view = |path: PathBuf| {
        let image = image::open(path).unwrap().to_luma8();
        let mut found = Vec::new();
        finder.search(&ImageView::new(image.as_raw(), 640, 480).unwrap(), &mut found).unwrap();
        let covariances = finder.covariances_px2().map(|(_, [xx, xy, yy])| Matrix2::new(xx, xy, xy, yy));
        found.iter().zip(covariances).map(|(f, C)| point(f.id, f.px, C)).collect()
    };
    photographs(side).into_iter().map(&mut view).collect()
}

/// Everything free, nothing left out: as OpenCV does it.
fn plain() -> CalibrationSettings {
    CalibrationSettings { drop_untold: false, outlier_sd: f64::INFINITY, ..CalibrationSettings::default() }
}

fn without_k3() -> CalibrationSettings {
    let model = LensModel::PlumbBob;
    CalibrationSettings { freedom: plain().freedom.without(model, "k3"), ..plain() }
}

fn parameters(found: &CameraCalibration) -> [f64; 4] {
    let i = found.camera.intrinsics();
    [i.fx_px, i.fy_px, i.cx_px, i.cy_px]
}

/// calibrateCamera and stereoCalibrate of OpenCV 5.0.0 on the same corners, to the last step; the second with CALIB_FIX_K3.
#[test]
fn opencv_corners_give_what_opencv_has() {
    let (left, right) = (opencv_corners("left"), opencv_corners("right"));
    let found = calibrate_camera(&left, SIZE, &plain()).unwrap();
    assert!((found.rms_px - 0.199_000_56).abs() < 1e-5, "{}", found.rms_px);
    let expected = [533.228_992, 533.452_364, 341.656_352, 235.687_539];
    assert!(
        parameters(&found).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-2),
        "{:?}",
        parameters(&found)
    );
    let sd = [0.555_895, 0.593_861, 0.621_454, 0.602_231];
    assert!(found.deviations().zip(sd).all(|((_, a), b)| (a / b - 1.0).abs() < 0.01));
    // OpenCV's lens with k3 of the right camera shows two directions in the image's corners: it is fitted, told and refused
    let found = calibrate_camera(&right, SIZE, &plain()).unwrap();
    assert_eq!(found.dropped.len(), 1);
    assert!((found.dropped[0].rms_px - 0.203_075_64).abs() < 1e-5 && found.dropped[0].sd.is_none());
    for (views, rms_px) in [(&left, 0.199_000_98), (&right, 0.205_353_61)] {
        let found = calibrate_camera(views, SIZE, &without_k3()).unwrap();
        assert!((found.rms_px - rms_px).abs() < 1e-5, "{} {rms_px}", found.rms_px);
    }
    let pair = calibrate_stereo(&left, &right, (SIZE, SIZE), &without_k3()).unwrap();
    assert!((pair.rms_px - 0.219_240_87).abs() < 1e-5, "{}", pair.rms_px);
    // OpenCV tells the left camera in the right one
    let p = pair.X_LR.inverse().translation.vector;
    let expected = nalgebra::Vector3::new(-3.327_011, 0.036_844_5, -0.000_770_3);
    assert!((p - expected).norm() < 1e-3, "{p}");
}

/// Error of an image that took no part, after its pose is fitted.
fn held_back_px2(found: &CameraCalibration, view: &BoardView) -> f64 {
    let flat: Vec<_> = (view.iter())
        .map(|p| Correspondence { r: p.p_O.coords.xy(), s: found.camera.normalized_of(&p.px) })
        .collect();
    let points: Vec<_> = (view.iter())
        .map(|p| PixelCorrespondence { r: p.p_O, px: p.px, covariance_px2: Matrix2::identity() })
        .collect();
    let start = planar_pose(&flat).unwrap().best.X_CO;
    let end = refine_pixels(&start, &points, &found.camera, Loss::Squares).unwrap();
    end.chi_square / view.len() as f64
}

#[test]
fn own_corners_fit_better() {
    if photographs("left").len() + photographs("right").len() < 18 {
        println!("skipped: no ../shared");
        return;
    }
    let sides = ["left", "right"].map(own_corners);
    let opencv = [[533.229, 533.452, 341.656, 235.688], [537.528, 537.308, 327.309, 249.385]];
    let opencv_sd = [[0.556, 0.594, 0.621, 0.602], [0.606, 0.617, 0.675, 0.594]];
    for (i, views) in sides.iter().enumerate() {
        let found = calibrate_camera(views, SIZE, &CalibrationSettings::default()).unwrap();
        let left_out = found.views.iter().flat_map(|v| &v.points).filter(|p| !p.used).count();
        println!("{}: rms {:.4} px, {left_out} corners left out", ["left", "right"][i], found.rms_px);
        assert_eq!((found.views_used(), left_out), (9, 0));
        assert!(found.rms_px < [0.180, 0.175][i], "{}", found.rms_px);
        for ((value, opencv), sd) in parameters(&found).iter().zip(opencv[i]).zip(opencv_sd[i]) {
            assert!((value - opencv).abs() < 2.0 * sd, "{value} {opencv} {sd}");
        }
        let held_back: f64 = (0..9)
            .map(|k| {
                let mut others = views.clone();
                let view = others.remove(k);
                held_back_px2(
                    &calibrate_camera(&others, SIZE, &CalibrationSettings::default()).unwrap(),
                    &view,
                ) / 9.0
            })
            .sum();
        println!("held back: {:.4} px", held_back.sqrt());
        assert!(held_back.sqrt() < [0.19, 0.185][i], "{}", held_back.sqrt());
    }
    let pair = calibrate_stereo(&sides[0], &sides[1], (SIZE, SIZE), &CalibrationSettings::default()).unwrap();
    println!("pair: rms {:.4} px, rows {:.4} px", pair.rms_px, pair.rows_rms_px.unwrap());
    assert!(pair.rms_px < 0.195, "{}", pair.rms_px);
    assert!((pair.X_LR.translation.vector.norm() - 3.327).abs() < 0.01);
}

struct Ended {
    code: Option<i32>,
    out: String,
    err: String,
}

fn ended(arguments: &[&str]) -> Ended {
    let output = vservo().args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(!err.contains("panicked"), "{err}");
    Ended { code: output.status.code(), out, err }
}

fn words(paths: &[PathBuf]) -> Vec<String> {
    paths.iter().map(|p| p.to_str().unwrap().to_string()).collect()
}

fn camera_in(path: &Path) -> CameraInfo {
    CameraInfo::read(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn camera_from_files() {
    let photographs = words(&photographs("left"));
    if photographs.is_empty() {
        println!("skipped: no ../shared");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (out, report) = (folder.path().join("camera.yaml"), folder.path().join("report.html"));
    // an image without a board among them
    let blank = folder.path().join("blank <b>.png");
    image::GrayImage::from_pixel(640, 480, image::Luma([90])).save(&blank).unwrap();
    let mut arguments = vec!["calibrate", "camera"];
    arguments.extend(photographs.iter().map(String::as_str));
    let tail = ["--target", "chessboard:9x6:0.025", "--out", out.to_str().unwrap()];
    arguments.extend([blank.to_str().unwrap()].into_iter().chain(tail));
    let mut with_json = arguments.clone();
    with_json.extend(["--json", "--report", report.to_str().unwrap()]);
    let done = ended(&with_json);
    assert_eq!(done.code, Some(0), "{}", done.err);
    let answer: Value = serde_json::from_str(&done.out).unwrap();
    let number =
        |path: &str| answer.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path}"));
    assert!(number("/rms_px") < 0.195 && (number("/camera/fx_px") - 533.2).abs() < 1.2);
    assert_eq!(answer["camera"]["model"], "plumb_bob");
    assert_eq!(answer["camera"]["distortion"].as_array().unwrap().len(), 5);
    assert!(number("/sd/fx_px") < 1.0 && number("/uncertainty_px/center") < number("/uncertainty_px/corner"));
    let views = answer["views"].as_array().unwrap();
    assert_eq!(views.len(), 10);
    assert!(views[..9].iter().all(|v| v["used"] == true && v["reason"].is_null() && v["rms_px"].is_f64()));
    assert!(views[9]["used"] == false && views[9]["reason"].is_string() && views[9]["rms_px"].is_null());
    assert!(answer["verdict"].as_str().unwrap().contains(" px in the middle"), "{}", answer["verdict"]);
    assert!(answer["next_view"]["words"].as_str().unwrap().starts_with("hold the board"));
    // what is written is what is told, and `detect` takes it
    let info = camera_in(&out);
    assert_eq!(info.intrinsics.fx_px, number("/camera/fx_px"));
    assert_eq!(info.camera().unwrap().lens().model(), LensModel::PlumbBob);
    let page = std::fs::read_to_string(&report).unwrap();
    assert!(page.matches("<svg").count() == 4 && page.matches("</svg>").count() == 4);
    assert!(page.contains("blank &lt;b&gt;.png") && !page.contains("http-equiv") && !page.contains("src="));
    let seen = ended(&[
        "detect",
        &photographs[0],
        "--target",
        "chessboard:9x6:0.025",
        "--camera",
        out.to_str().unwrap(),
        "--json",
    ]);
    let seen: Value = serde_json::from_str(&seen.out).unwrap();
    assert!(seen["reprojection_rms_px"].as_f64().unwrap() < 0.3, "{seen}");
    // for people; fisheye; what is fixed
    let told = ended(&arguments);
    assert!(
        told.code == Some(0) && told.out.contains("fx_px") && told.out.contains("next: hold"),
        "{}",
        told.out
    );
    let mut fisheye = arguments.clone();
    fisheye.extend(["--model", "equidistant", "--fix-aspect", "--json"]);
    let done = ended(&fisheye);
    assert_eq!(done.code, Some(0), "{}", done.err);
    let answer: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(answer["camera"]["fx_px"], answer["camera"]["fy_px"]);
    assert!(answer["rms_px"].as_f64().unwrap() < 0.25, "{answer}");
    assert_eq!(camera_in(&out).camera().unwrap().lens().model(), LensModel::Equidistant);
}

#[test]
fn pair_from_files() {
    let (left, right) = (words(&photographs("left")), words(&photographs("right")));
    if left.is_empty() || right.is_empty() {
        println!("skipped: no ../shared");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("pair.yaml");
    let mut arguments = vec!["calibrate", "stereo", "--left"];
    arguments.extend(left.iter().map(String::as_str));
    arguments.push("--right");
    arguments.extend(right.iter().map(String::as_str));
    let report = folder.path().join("pair.html");
    arguments.extend(["--target", "chessboard:9x6:0.025", "--out", out.to_str().unwrap(), "--json"]);
    arguments.extend(["--report", report.to_str().unwrap()]);
    let done = ended(&arguments);
    assert_eq!(done.code, Some(0), "{}", done.err);
    let answer: Value = serde_json::from_str(&done.out).unwrap();
    assert!(answer["rms_px"].as_f64().unwrap() < 0.216);
    let baseline_m = answer["baseline_m"].as_f64().unwrap();
    assert!((baseline_m - 3.327 * 0.025).abs() < 1e-3, "{baseline_m}");
    assert_eq!(answer["X_LR"]["covariance"].as_array().unwrap().len(), 36);
    // rectified rows agree, by the files alone
    let (l, r) =
        (camera_in(&folder.path().join("pair_left.yaml")), camera_in(&folder.path().join("pair_right.yaml")));
    assert!(l.projection[3] == 0.0 && (r.projection[3] / r.projection[0] + baseline_m).abs() < 1e-4);
    let rectified = |info: &CameraInfo, p: &BoardPoint| {
        let s = info.camera().unwrap().normalized_of(&p.px).push(1.0);
        let q = nalgebra::Matrix3::from_row_slice(&info.rectification) * s;
        Vector2::new(
            info.projection[0] * q.x / q.z + info.projection[2],
            info.projection[5] * q.y / q.z + info.projection[6],
        )
    };
    let corners = opencv_corners("left").concat().into_iter().zip(opencv_corners("right").concat());
    let apart: Vec<_> = corners.map(|(a, b)| rectified(&l, &a) - rectified(&r, &b)).collect();
    let rms = (apart.iter().map(|d| d.y * d.y).sum::<f64>() / apart.len() as f64).sqrt();
    assert!(rms < 0.25 && apart.iter().all(|d| d.x > 0.0), "{rms}");
    assert_eq!(std::fs::read_to_string(&report).unwrap().matches("<svg").count(), 8);
    assert!(std::fs::read_to_string(&out).unwrap().contains("rotation_xyzw"));
}

/// Files written, but a word that left may be right; with right images in another order nothing is written.
#[test]
fn exchanged_and_shifted_sides_are_told() {
    let (left, right) = (words(&photographs("left")), words(&photographs("right")));
    if left.is_empty() || right.is_empty() {
        println!("skipped: no ../shared");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("pair.yaml").display().to_string();
    let calibrated = |left: &[String], right: &[String]| {
        let mut arguments = vec!["calibrate", "stereo", "--left"];
        arguments.extend(left.iter().map(String::as_str));
        arguments.push("--right");
        arguments.extend(right.iter().map(String::as_str));
        arguments.extend(["--target", "chessboard:9x6:0.025", "--out", &out]);
        ended(&arguments)
    };
    let mut shifted = right.clone();
    shifted.rotate_left(1);
    let done = calibrated(&left, &shifted);
    assert!(done.code == Some(5) && done.err.contains("in the same order"), "{}", done.err);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let done = calibrated(&right, &left);
    assert!(done.code == Some(0) && done.err.contains("may be exchanged"), "{}", done.err);
}

/// A slip of the file names: no pair of files is written.
#[test]
fn the_same_images_twice_are_no_pair() {
    let photographs = words(&photographs("left"));
    if photographs.is_empty() {
        println!("skipped: no ../shared");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("pair.yaml").display().to_string();
    let mut arguments = vec!["calibrate", "stereo", "--left"];
    arguments.extend(photographs.iter().map(String::as_str));
    arguments.push("--right");
    arguments.extend(photographs.iter().map(String::as_str));
    arguments.extend(["--target", "chessboard:9x6:0.025", "--out", &out]);
    let done = ended(&arguments);
    assert_eq!(done.code, Some(5), "{} {}", done.out, done.err);
    assert!(done.err.contains("the same files"), "{}", done.err);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn what_cannot_be_done_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (out, blank, text) = (path("camera.yaml"), path("blank.png"), path("text.png"));
    image::GrayImage::from_pixel(320, 240, image::Luma([90])).save(&blank).unwrap();
    std::fs::write(&text, "no image").unwrap();
    let board = "chessboard:9x6:0.025";
    let camera = |image: &str, target: &str, more: &[&str]| {
        let mut arguments = vec!["calibrate", "camera", image, "--target", target, "--out", &out];
        arguments.extend(more);
        ended(&arguments)
    };
    for (done, code, word) in [
        (camera(&blank, board, &[]), 5, "blank.png"),
        (camera(&text, board, &[]), 3, "text.png"),
        (camera(&path("missing.png"), board, &[]), 3, "missing.png"),
        (camera(&blank, "dots:7x5:0.02", &[]), 2, "chessboard:COLSxROWS"),
        (camera(&blank, "board", &[]), 2, "--target"),
        (camera(&blank, "chessboard:9x6:25", &[]), 2, "did you mean 25 mm? that is chessboard:9x6:0.025"),
        (camera(&blank, "chessboard:9x6:0.00025", &[]), 2, "squares of 0.00025 m"),
        (camera(&blank, board, &["--outlier-sd", "0.5"]), 2, "outlier_sd"),
        (camera(&blank, board, &["--out-of-order"]), 2, "--out-of-order"),
        (
            ended(&[
                "calibrate",
                "stereo",
                "--left",
                &blank,
                &blank,
                "--right",
                &blank,
                "--target",
                board,
                "--out",
                &out,
            ]),
            2,
            "pairs",
        ),
    ] {
        assert_eq!(done.code, Some(code), "{} {}", done.out, done.err);
        assert!(done.err.contains(word), "{word}: {}", done.err);
    }
    assert!(!Path::new(&out).exists());
    let unwritable =
        ended(&["calibrate", "camera", &blank, "--target", board, "--out", &path("no/such/folder.yaml")]);
    assert_eq!(unwritable.code, Some(3), "{}", unwritable.err);
}

/// A camera process plays the photographs, each for five frames, again and again: each is taken once. Two of the nine are too alike.
#[test]
fn images_are_taken_from_a_running_camera() {
    let photographs = photographs("left");
    if photographs.is_empty() {
        println!("skipped: no ../shared");
        return;
    }
    let work = tempfile::tempdir().unwrap();
    let images = work.path().join("images");
    std::fs::create_dir(&images).unwrap();
    for (n, path) in photographs.iter().enumerate() {
        for k in 0..5 {
            std::fs::copy(path, images.join(format!("{n:02}_{k}.jpg"))).unwrap();
        }
    }
    let run_file = work.path().join("camera.toml");
    let text = format!(
        "[camera]\nsource = \"replay\"\nrate_hz = 25.0\n[camera.replay]\nfolder = \"{}\"\nrepeat = true\n",
        images.display()
    );
    std::fs::write(&run_file, text).unwrap();
    let instance = Instance::new("live");
    let out = work.path().join("camera.yaml");
    let live = || {
        let output = vservo()
            .args(["calibrate", "camera", "--target", "chessboard:9x6:0.025", "--json", "--views", "8"])
            .args(["--instance", &instance.name, "--live"])
            .args([&run_file])
            .arg("--out")
            .arg(&out)
            .output()
            .unwrap();
        let [answer, told] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        (output.status.code(), answer, told)
    };
    let (code, _, told) = live();
    assert!(code == Some(5) && told.contains("no camera process runs"), "{told}");

    let mut camera =
        vservo().arg("camera").arg(&run_file).args(["--instance", &instance.name]).spawn().unwrap();
    let joined: vservo::ipc::Instance = instance.name.parse().unwrap();
    wait_until("the camera", || joined.is_running(Role::Camera(CameraId::FIRST)));
    let (code, answer, told) = live();
    kill(camera.id() as i32, "TERM");
    assert!(camera.wait().unwrap().success());
    assert_eq!(code, Some(0), "{told}");
    let answer: Value = serde_json::from_str(&answer).unwrap();
    let rms_px = answer["rms_px"].as_f64().unwrap();
    assert!(answer["views"].as_array().unwrap().len() == 8 && rms_px < 0.195, "{answer}");
    assert!(told.contains("8 of 8 images") && told.contains("next:"), "{told}");
    assert!(CameraInfo::read(&std::fs::read_to_string(&out).unwrap()).is_ok());
    instance.assert_gone();
}
