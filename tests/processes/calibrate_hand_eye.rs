//! `vservo calibrate hand-eye` as a real process: a Franka's images and poses, the same the other way round, and what is told of files
//! that do not fit.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use crate::common::vservo;
use serde_json::Value;
use std::f64::consts::PI;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use vservo::calibration::hand_eye::read_visp_pose;
use vservo::camera_model::camera_info::CameraInfo;
use vservo::config::Config;
use vservo::config::assemble::renderer;
use vservo::geometry::Pose;
use vservo::robot::Mount;

struct Ended {
    code: Option<i32>,
    out: String,
    err: String,
}

fn ended(arguments: &[String]) -> Ended {
    let output = vservo().args(["calibrate", "hand-eye"]).args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(!err.contains("panicked"), "{err}");
    Ended { code: output.status.code(), out, err }
}

/// The factory's numbers of the Franka's camera.
const CAMERA: &str = "image_width: 640\nimage_height: 480\ncamera_name: franka\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
data: [607.5931396484375, 0, 323.46282958984375, 0, 607.574951171875, 243.25529479980469, 0, 0, 1]\n\
distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n";

struct Set {
    folder: PathBuf,
    work: tempfile::TempDir,
}

impl Set {
    fn open() -> Option<Self> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/visp-handeye-in-hand");
        if !folder.exists() {
            println!("skipped: no ../shared");
            return None;
        }
        let work = tempfile::tempdir().unwrap();
        std::fs::write(work.path().join("camera.yaml"), CAMERA).unwrap();
        Some(Self { folder, work })
    }

    fn image(&self, n: usize) -> String {
        self.folder.join(format!("franka_image-{n}.png")).display().to_string()
    }

    fn pose(&self, n: usize) -> String {
        self.folder.join(format!("franka_pose_rPe_{n}.yaml")).display().to_string()
    }

    fn file(&self, name: &str) -> String {
        self.work.path().join(name).display().to_string()
    }

    /// The poses as a table.
    fn table(&self, name: &str, of: impl Fn(&Pose) -> Pose) -> String {
        let mut text = String::from("image,x_m,y_m,z_m,qx,qy,qz,qw\n");
        for n in 1..=8 {
            let X = of(&read_visp_pose(&std::fs::read_to_string(self.pose(n)).unwrap()).unwrap());
            let (p, q) = (X.translation, X.rotation.coords);
            writeln!(text, "franka_image-{n}.png,{},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z, q.w)
                .unwrap();
        }
        std::fs::write(self.work.path().join(name), text).unwrap();
        self.file(name)
    }

    fn run(&self, images: &[usize], poses: &[String], more: &[&str]) -> Ended {
        let mut all: Vec<String> = images.iter().map(|n| self.image(*n)).collect();
        all.push("--poses".into());
        all.extend(poses.iter().cloned());
        all.extend(["--camera".into(), self.file("camera.yaml")]);
        if !more.contains(&"--target") {
            all.extend(["--target".into(), "chessboard:9x6:0.0236".into()]);
        }
        all.extend(more.iter().map(|word| (*word).to_owned()));
        ended(&all)
    }
}

const ALL: [usize; 8] = [1, 2, 3, 4, 5, 6, 7, 8];

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

fn position(answer: &Value, name: &str) -> [f64; 3] {
    [0, 1, 2].map(|i| number(&answer[name]["position_m"][i]))
}

#[test]
fn a_frankas_camera_is_found() {
    let Some(set) = Set::open() else { return };
    let poses: Vec<_> = ALL.iter().map(|n| set.pose(*n)).collect();
    let out = set.file("hand_eye.toml");
    let ended = set.run(&ALL, &poses, &["--json", "--out", &out]);
    // this Franka's poses are off by millimetres, where 0.3 are stated: it is told, written, and said by the code
    assert_eq!(ended.code, Some(5), "{}", ended.err);
    let answer: Value = serde_json::from_str(&ended.out).unwrap();
    let errors = |of: &Value| (number(&of["rotation_error_deg"]), number(&of["position_error_mm"]));
    for closed in answer["closed_forms"].as_array().unwrap() {
        let (deg, mm) = errors(closed);
        println!("{}: {deg:.4} deg, {mm:.3} mm", closed["method"]);
    }
    let ((deg, mm), held) = (errors(&answer), errors(&answer["leave_one_out"]));
    println!(
        "joint: {deg:.4} deg, {mm:.3} mm, rms {} px, corrected {} px",
        answer["rms_px"], answer["rms_corrected_px"]
    );
    println!("leave-one-out: {:.4} deg, {:.3} mm, {} px", held.0, held.1, answer["leave_one_out"]["rms_px"]);
    println!("{:#}\n{:#}\n{:#}", answer["sd"], answer["robot_sd_seen"], answer["verdict"]);
    for view in answer["views"].as_array().unwrap() {
        println!("{} {} {} {}", view["image"], view["rms_px"], view["rms_corrected_px"], view["held_out"]);
        // the finder leaves two of image 4 out
        assert!(view["used"] == true && view["corners"].as_u64().unwrap() >= 52, "{view}");
    }
    // ViSP's own: 0.4559 deg, 5.412 mm; the robot's poses leave no less
    assert!((0.44..0.462).contains(&deg) && (5.30..5.44).contains(&mm), "{deg} {mm}");
    assert!(held.0 < 0.75 && held.1 < 7.0, "{held:?}");
    // what is written is what a run file takes
    let text = std::fs::read_to_string(&out).unwrap();
    let config = Config::parse("hand_eye.toml", &text, Path::new("."), &[]).unwrap();
    let Mount::EyeInHand { X_EC } = config.camera.mount else { panic!("{:?}", config.camera.mount) };
    let p = position(&answer, "X_EC");
    assert!((X_EC.translation.vector - nalgebra::Vector3::from(p)).norm() < 1e-8, "{X_EC} {p:?}");
    let q = [0, 1, 2, 3].map(|i| number(&answer["X_EC"]["rotation_xyzw"][i]));
    assert!((X_EC.rotation.coords.dot(&nalgebra::Vector4::from(q)).abs() - 1.0).abs() < 1e-9);
}

/// The arm's poses inverted are those of an arm that carries the board before a fixed camera: the same camera in the frame that bears it.
#[test]
fn the_eye_beside_the_arm_is_the_same_with_inverted_poses() {
    let Some(set) = Set::open() else { return };
    let there = set.table("there.csv", |X| *X);
    let back = set.table("back.csv", Pose::inverse);
    let in_hand = set.run(&ALL, &[there], &["--json"]);
    let beside = set.run(&ALL, std::slice::from_ref(&back), &["--json", "--eye-to-hand"]);
    assert_eq!((in_hand.code, beside.code), (Some(5), Some(5)), "{} {}", in_hand.err, beside.err);
    let in_hand: Value = serde_json::from_str(&in_hand.out).unwrap();
    let beside: Value = serde_json::from_str(&beside.out).unwrap();
    assert_eq!((&in_hand["place"], &beside["place"]), (&"eye_in_hand".into(), &"eye_to_hand".into()));
    let (a, b) = (position(&in_hand, "X_EC"), position(&beside, "X_BC"));
    let off = (nalgebra::Vector3::from(a) - nalgebra::Vector3::from(b)).norm();
    // the corrections are along other axes, of which all are alike; their lever is not
    println!("apart by {:.3} mm", off * 1e3);
    assert!(off < 3e-3, "{a:?} {b:?}");
    let close = |a: &Value, b: &Value| (number(a) - number(b)).abs() < 1e-6;
    assert!(close(
        &in_hand["closed_forms"][0]["position_error_mm"],
        &beside["closed_forms"][0]["position_error_mm"]
    ));
    // and without the word for it the mistake is named
    let mistaken = set.run(&ALL, &[back], &["--json"]);
    assert!(
        mistaken.code == Some(5) && mistaken.err.contains("--eye-to-hand"),
        "{:?} {}",
        mistaken.code,
        mistaken.err
    );
    assert!(mistaken.out.is_empty());
}

#[test]
fn what_does_not_fit_is_told() {
    let Some(set) = Set::open() else { return };
    let yaml = |n: &[usize]| n.iter().map(|n| set.pose(*n)).collect::<Vec<_>>();
    let table = set.table("poses.csv", |X| *X);
    let short = set.file("short.csv");
    std::fs::write(&short, "image,x_m,y_m,z_m,qx,qy,qz,qw\nfranka_image-1.png,0,0,0,0,0,0,1\n").unwrap();
    let broken = set.file("broken.csv");
    std::fs::write(&broken, "franka_image-1.png,0,0,0,0,0,0,2\n").unwrap();
    for (images, poses, more, code, told) in [
        (&ALL[..2], yaml(&[1, 2]), &[][..], 5, "at least 3"),
        (&ALL[..3], yaml(&[1, 2]), &[], 3, "2 files for 3 images"),
        (&ALL[..3], vec![short], &[], 3, "no line for"),
        (&ALL[..3], vec![broken], &[], 3, "line 1"),
        (&ALL[..3], vec![set.file("none.csv")], &[], 3, "none.csv"),
        (&ALL[..3], vec![table.clone(), set.pose(1)], &[], 3, "one table"),
        (&ALL[..4], yaml(&[1, 2, 3, 4]), &["--target", "chessboard:8x6:0.0236"], 2, "even"),
        (&ALL[..4], yaml(&[1, 2, 3, 4]), &["--target", "cheese"], 2, "no kind"),
        (&ALL[..4], yaml(&[1, 2, 3, 4]), &["--robot-sd-mm", "nan"], 2, "--robot-sd-mm"),
        (&ALL[..4], yaml(&[1, 2, 3, 4]), &["--time-offset"], 5, "velocity"),
        // one image many times
        (&[1, 1, 1][..], yaml(&[1, 1, 1]), &[], 5, "hardly turned"),
        // poses of other images
        (&ALL[..6], yaml(&[2, 3, 5, 6, 4, 1]), &[], 5, "angles"),
    ] {
        let ended = set.run(images, &poses, more);
        assert!(
            ended.code == Some(code) && ended.err.contains(told),
            "{told}: {:?} {}",
            ended.code,
            ended.err
        );
        assert!(ended.out.is_empty(), "{}", ended.out);
    }
    // lines for people
    let own = ["--robot-sd-mm", "6", "--robot-sd-deg", "0.6"];
    let ended = set.run(&ALL, std::slice::from_ref(&table), &own);
    assert_eq!(ended.code, Some(0), "{}", ended.out);
    assert!(
        ended.out.contains("[camera.mount]") && ended.out.contains("predicted by the others"),
        "{}",
        ended.out
    );
}

/// Quaternions in the other order are named, with a robot stated as it is; squares of another size contradict it, which the code says.
#[test]
fn the_order_of_quaternions_and_wrong_squares_are_told() {
    let Some(set) = Set::open() else { return };
    let own = ["--robot-sd-mm", "6", "--robot-sd-deg", "0.6"];
    let right = set.table("right.csv", |X| *X);
    let text = std::fs::read_to_string(&right).unwrap();
    let mut other = String::new();
    for line in text.lines() {
        let cells: Vec<_> = line.split(',').collect();
        if line.starts_with("image") {
            writeln!(other, "{line}").unwrap();
        } else {
            writeln!(other, "{},{},{},{},{}", cells[..4].join(","), cells[7], cells[4], cells[5], cells[6])
                .unwrap();
        }
    }
    let wrong = set.file("wrong.csv");
    std::fs::write(&wrong, other).unwrap();
    // whether the robot is stated as it is, or as the default has it
    for stated in [&own[..], &[]] {
        let ended = set.run(&ALL, std::slice::from_ref(&wrong), stated);
        assert_eq!(ended.code, Some(5), "{} {}", ended.out, ended.err);
        assert!(ended.err.contains("w x y z") && ended.err.contains("qx,qy,qz,qw"), "{}", ended.err);
        assert!(ended.out.is_empty(), "{}", ended.out);
    }
    // a camera in the hand that is said to be beside the arm
    let beside = set.run(&ALL, std::slice::from_ref(&right), &[&own[..], &["--eye-to-hand"]].concat());
    assert!(beside.code == Some(5) && beside.err.contains("leave --eye-to-hand out"), "{}", beside.err);
    // squares twice too large: what the images say of distances is not what the robot says
    let mut large = own.to_vec();
    large.extend(["--target", "chessboard:9x6:0.05"]);
    let ended = set.run(&ALL, &[right], &large);
    assert_eq!(ended.code, Some(5), "{} {}", ended.out, ended.err);
    assert!(ended.out.contains("contradict each other"), "{}", ended.out);
}

/// A UR5 whose run file has the camera 2 degrees and 10 mm from where it is visits views of a chessboard, and finds it.
#[test]
fn an_arm_finds_its_own_camera() {
    let work = tempfile::tempdir().unwrap();
    let out = work.path().join("hand_eye.toml").display().to_string();
    let run = |more: &[&str]| {
        let mut all: Vec<String> =
            ["--drive", "config/chessboard.toml", "--json", "--out", &out].map(String::from).into();
        for set in ["scene.occluder.until_s=0", "scene.camera.mount.position_m=[0.006, -0.006, 0.055]"] {
            all.extend(["--set".into(), set.to_owned()]);
        }
        all.extend(["--set".into(), "scene.camera.mount.rotation_rpy_rad=[0.02, -0.02, 0.02]".into()]);
        for set in more {
            all.extend(["--set".into(), (*set).to_owned()]);
        }
        ended(&all)
    };
    let found = run(&[]);
    assert_eq!(found.code, Some(0), "{}", found.err);
    let answer: Value = serde_json::from_str(&found.out).unwrap();
    println!("{:#}\n{:#}\n{:#}", answer["driven"], answer["sd"], answer["verdict"]);
    let off = &answer["driven"];
    assert!(
        number(&off["from_run_file"]["position_mm"]) > 8.0
            && number(&off["from_run_file"]["rotation_deg"]) > 1.5
    );
    let truth = &off["from_truth"];
    let (mm, deg) = (number(&truth["position_mm"]), number(&truth["rotation_deg"]));
    let (sd_mm, sd_deg) = (number(&answer["sd"]["camera_mm"]), number(&answer["sd"]["camera_deg"]));
    println!("off the truth by {mm:.3} mm, {deg:.4} deg; stated {sd_mm:.3} mm, {sd_deg:.4} deg");
    assert!(mm < 0.5 && deg < 0.05, "{mm} {deg}");
    assert!(mm < 4.0 * sd_mm && deg < 4.0 * sd_deg, "more than is stated");
    assert!(answer["views"].as_array().unwrap().len() >= 8);
    let text = std::fs::read_to_string(&out).unwrap();
    assert!(Config::parse("hand_eye.toml", &text, Path::new("."), &[]).is_ok());
    // a board that is not there
    let blind = run(&["scene.object.position_m=[5.0, 5.0, 0.0]", "run.duration_s=3"]);
    assert!(blind.code != Some(0) && blind.out.is_empty(), "{}", blind.err);
}

/// A SCARA turns its camera about one axis: that is told before anything moves.
#[test]
fn an_arm_that_cannot_says_so() {
    let all: Vec<String> = ["--drive", "config/default.toml", "--json"].map(String::from).into();
    let ended = ended(&all);
    assert!(ended.code == Some(5) && ended.err.contains("one axis"), "{:?} {}", ended.code, ended.err);
}

/// The tour is planned beside the real-time thread, and followed by it.
#[test]
fn an_arm_visits_views_of_its_board_by_the_clock() {
    let arguments = ["chessboard", "--clock", "realtime", "--set", "run.task=calibrate_hand_eye"];
    let short = [&arguments[..], &["--set", "run.duration_s=8"]].concat();
    let run = crate::common::run("tour", &short);
    assert_eq!(run.summary["outcome"], "not_converged", "{}", run.text());
    // It knows so once the postures are found, and only then.
    assert_eq!(
        run.summary["reason"],
        "run.duration_s is over before all postures were visited",
        "{}",
        run.text()
    );
    assert_eq!(run.summary["safety"]["state"], "stopped", "{}", run.text());
}

/// Images of the board of `config/chessboard.toml` from these places of it in the camera, and the flange's poses; the camera 50 mm ahead of the flange.
fn rendered(work: &Path, places: &[[f64; 6]]) -> Vec<String> {
    let config = Config::load(Some(Path::new("config/chessboard.toml")), &[]).unwrap();
    let model = config.camera.model;
    let size = (model.intrinsics().width_px, model.intrinsics().height_px);
    let info = CameraInfo::new("chessboard", &model).write();
    let file = |name: &str| work.join(name).display().to_string();
    std::fs::write(file("camera.yaml"), info).unwrap();
    let pose = |[x, y, z, roll, pitch, yaw]: [f64; 6]| {
        let turn = nalgebra::UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        Pose::from_parts(nalgebra::Translation3::new(x, y, z), turn)
    };
    let X_BO = pose([0.51, 0.17, -0.1, PI, 0.0, -0.5 * PI]);
    let X_EC = Pose::translation(0.0, 0.0, 0.05);
    let mut renderer = renderer(&config).unwrap();
    let mut table = String::from("image,x_m,y_m,z_m,qx,qy,qz,qw\n");
    let mut arguments = Vec::new();
    for (n, place) in places.iter().enumerate() {
        let X_CO = pose(*place);
        let mut image = image::GrayImage::new(size.0, size.1);
        renderer.render(&[X_CO], n as u64, &mut image);
        let name = format!("view{n}.png");
        image.save(file(&name)).unwrap();
        let X_BE = X_BO * X_CO.inverse() * X_EC.inverse();
        let (p, q) = (X_BE.translation, X_BE.rotation.coords);
        writeln!(table, "{name},{},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z, q.w).unwrap();
        arguments.push(file(&name));
    }
    std::fs::write(file("poses.csv"), table).unwrap();
    let more = ["--poses", &file("poses.csv"), "--camera", &file("camera.yaml"), "--json"];
    arguments.extend(more.map(String::from));
    arguments.extend(["--target".into(), "chessboard:9x6:0.02".into()]);
    arguments
}

/// (10.63): one image of a board whose pose is known tells where the camera sits; several check that pose.
#[test]
fn one_image_is_enough_where_the_board_is_known() {
    let work = tempfile::tempdir().unwrap();
    let run = |places: &[[f64; 6]], board: &str| {
        ended(&[rendered(work.path(), places), vec!["--board-pose".into(), board.into()]].concat())
    };
    let places = [
        [-0.08, -0.05, 0.4, 0.35, 0.2, 0.1],
        [-0.09, -0.04, 0.42, -0.4, 0.1, 0.5],
        [-0.07, -0.06, 0.38, 0.1, -0.45, -0.4],
        [-0.08, -0.05, 0.41, -0.2, 0.4, 1.0],
    ];
    let right = "0.51,0.17,-0.1,180,0,-90";
    for count in [1, 4] {
        let found = run(&places[..count], right);
        assert_eq!(found.code, Some(0), "{} {}", found.out, found.err);
        let answer: Value = serde_json::from_str(&found.out).unwrap();
        let off = (nalgebra::Vector3::from(position(&answer, "X_EC"))
            - nalgebra::Vector3::new(0.0, 0.0, 0.05))
        .norm();
        let (sd_mm, verdict) = (number(&answer["sd"]["camera_mm"]), answer["verdict"].to_string());
        println!("{count} views: {:.3} mm off, stated {sd_mm:.3} mm; {verdict}", off * 1e3);
        assert!(off < 1e-3 && off * 1e3 < 4.0 * sd_mm, "{off} {sd_mm}");
        assert_eq!(verdict.contains("One view"), count == 1, "{verdict}");
        assert_eq!(answer["closed_forms"][0]["method"], "known board, mean of the views");
        assert_eq!(answer["X_BO"]["covariance"].as_array().unwrap().iter().filter(|c| **c != 0.0).count(), 0);
        assert_eq!(answer["board_as_seen"].is_null(), count == 1);
    }
    // 8 mm beside where it is said to be
    let wrong = run(&places, "0.518,0.17,-0.1,180,0,-90");
    assert_eq!(wrong.code, Some(5), "{} {}", wrong.out, wrong.err);
    let answer: Value = serde_json::from_str(&wrong.out).unwrap();
    let board = &answer["board_as_seen"];
    assert!(
        board["contradicted"] == true && (number(&board["position_error_mm"]) - 8.0).abs() < 1.0,
        "{board}"
    );
    assert!(answer["verdict"].to_string().contains("contradict the board's pose"), "{}", answer["verdict"]);
    let short = run(&places[..1], "0.5,0.2");
    assert!(short.code == Some(2) && short.err.contains("six numbers"), "{}", short.err);
}
