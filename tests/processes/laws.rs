//! Every servo law in the real processes, in lockstep, on rendered images.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::common::{Run, assert_accurate, number, run};
use std::path::Path;

fn lockstep(file: &str, set: &[&str]) -> Run {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let mut arguments = vec![path.to_str().unwrap(), "--clock", "lockstep", "--anyway"];
    for s in set {
        arguments.extend(["--set", s]);
    }
    run("laws", &arguments)
}

fn converges(file: &str, scheme: &str, set: &[&str]) {
    let r = lockstep(file, set);
    assert_accurate(&r);
    assert_eq!(r.summary["scheme"], scheme);
    assert_eq!(
        r.summary["safety"]["events"].as_array().map(Vec::len),
        Some(0),
        "{file} {set:?}: {}",
        r.text()
    );
}

#[test]
fn a_on_the_scara() {
    converges("scara-a.toml", "position_pd", &[]);
    // Torques that are not computed for the view of now bear the text's gains.
    let text = "textbook/scara-a.toml";
    for update in ["predict", "tick", "frame"] {
        let latency = ["camera.latency_ms=20", "camera.exposure_ms=4"];
        converges(text, "position_pd", &[&format!("servo.update={update}"), latency[0], latency[1]]);
    }
    let joints = "servo.pd.joint_damping_nms_rad_or_ns_m=[300, 300, 10, 10]";
    converges(text, "position_pd", &["servo.update=predict", "servo.pd.damping=joints", joints]);
}

/// The runs of Sect. 10.9 as they stand there: held between frames, with the text's gains.
#[test]
fn the_runs_of_the_text_converge() {
    for (name, scheme) in [
        ("a", "position_pd"),
        ("b", "position_resolved_velocity"),
        ("c", "image_pd"),
        ("d", "image_resolved_velocity"),
        ("hybrid", "hybrid"),
    ] {
        converges(&format!("textbook/scara-{name}.toml"), scheme, &[]);
    }
    converges("textbook/problem-10-10.toml", "image_pd", &[]);
}

/// A z_d that is wrong changes how the hybrid law goes to its goal, and not where that is.
#[test]
fn the_hybrid_law_takes_a_constant_depth() {
    let hash = |depth_m: &str| {
        let r = lockstep(
            "scara-hybrid.toml",
            &["servo.depth=constant", &format!("servo.constant_depth_m={depth_m}")],
        );
        assert_accurate(&r);
        r.summary["state_hash"].clone()
    };
    assert_ne!(hash("0.45"), hash("0.6"));
}

/// Every choice of the depth is a run of its own, and all end at the goal.
#[test]
fn each_depth_is_another_run() {
    for file in ["scara-d.toml", "scara-hybrid.toml"] {
        let mut hashes = Vec::new();
        for depth in ["servo.depth=constant", "servo.depth=known", "servo.depth=initial"] {
            let r = lockstep(file, &[depth, "servo.constant_depth_m=0.45"]);
            assert_accurate(&r);
            hashes.push(r.summary["state_hash"].to_string());
        }
        hashes.sort();
        hashes.dedup();
        assert_eq!(hashes.len(), 3, "{file}");
    }
}

#[test]
fn b_on_the_scara() {
    for update in ["predict", "tick", "frame"] {
        converges("scara-b.toml", "position_resolved_velocity", &[&format!("servo.update={update}")]);
    }
}

#[test]
fn c_on_the_scara() {
    converges("scara-c.toml", "image_pd", &[]);
    let text = "textbook/scara-c.toml";
    for update in ["predict", "tick", "frame"] {
        let latency = ["camera.latency_ms=20", "camera.exposure_ms=4"];
        converges(text, "image_pd", &[&format!("servo.update={update}"), latency[0], latency[1]]);
    }
    converges(text, "image_pd", &["servo.update=predict", "servo.points=[]", "servo.interaction=mean"]);
}

#[test]
fn d_on_the_scara() {
    for set in [
        ["servo.update=predict", "servo.depth=desired"],
        ["servo.update=tick", "servo.depth=known"],
        ["servo.update=frame", "servo.depth=constant"],
        ["servo.interaction=mean", "servo.depth=estimated"],
        ["servo.interaction=desired", "servo.points=[1, 3, 4]"],
        ["servo.points=[]", "servo.segments=[[1, 2]]"],
        ["servo.segments=[[3, 4]]", "servo.weights=[1.0, 0.5, 2.0]"],
        ["servo.smooth_start_1_s=3", "servo.adaptive_gain.at_zero=3"],
        ["servo.gain_1_s=[1.0, 2.0, 1.5, 1.0]", "servo.adaptive_gain.at_zero=2"],
    ] {
        converges("scara-d.toml", "image_resolved_velocity", &set);
    }
}

/// Moments of an area, in every image-based scheme. The triangle of three dots has an axis, the square of four has none.
#[test]
fn areas_in_place_of_points() {
    let triangle = "servo.outline=[1, 2, 3]";
    for area in ["servo.area=area", "servo.area=moments"] {
        let velocity = "image_resolved_velocity";
        converges("scara-d.toml", velocity, &["servo.points=[]", area, triangle]);
        converges("scara-d.toml", velocity, &["servo.points=[]", area, triangle, "servo.interaction=mean"]);
        let beside = ["servo.scheme=image_resolved_velocity", "servo.points=[]", area, triangle];
        converges("scara-eye-to-hand.toml", velocity, &beside);
    }
    converges("default.toml", "image_pd", &["servo.scheme=image_pd", "servo.area=area", triangle]);
    converges("scara-hybrid.toml", "hybrid", &["servo.area=area"]);
    converges("shape-moments.toml", "image_resolved_velocity", &[]);
    assert_accurate(&lockstep("shape-moments.toml", &["servo.interaction=desired"]));
    let doubtful = lockstep("scara-d.toml", &["servo.points=[]", "servo.area=area", "run.duration_s=0.1"]);
    assert!(doubtful.text().contains("no longest axis"), "{}", doubtful.text());
    let few = lockstep("shape-moments.toml", &["servo.area=area", "run.duration_s=0.1"]);
    assert!(few.text().contains("4 directions at the goal, the arm has 6"), "{}", few.text());
    for outline in ["[1, 2]", "[1, 2, 2]", "[1, 2, 9]"] {
        let r = lockstep("scara-d.toml", &["servo.area=area", &format!("servo.outline={outline}")]);
        assert_eq!(r.output.status.code(), Some(3), "{outline}: {}", r.text());
        assert!(r.text().contains("servo.outline"), "{}", r.text());
    }
}

#[test]
fn hybrid_on_the_scara() {
    for update in ["predict", "tick", "frame"] {
        converges("scara-hybrid.toml", "hybrid", &[&format!("servo.update={update}")]);
    }
    converges("scara-hybrid.toml", "hybrid", &["servo.dimension=6"]);
}

#[test]
fn a_camera_beside_the_arm() {
    for (scheme, more) in [
        ("image_resolved_velocity", "servo.dimension=6"),
        ("position_resolved_velocity", "servo.dimension=4"),
        ("hybrid", "servo.dimension=4"),
        ("position_pd", "servo.dimension=4"),
        ("image_pd", "servo.points=[1, 2]"),
    ] {
        converges("scara-eye-to-hand.toml", scheme, &[&format!("servo.scheme={scheme}"), more]);
    }
    let r = lockstep("scara-eye-to-hand.toml", &["camera.mount.kind=eye_in_hand"]);
    assert_eq!(r.output.status.code(), Some(3), "the other sign is refused: {}", r.text());
    assert!(r.text().contains("scene.object.on"), "{}", r.text());
}

#[test]
fn six_joints() {
    converges("ur5.toml", "image_resolved_velocity", &[]);
    converges("ur5-b.toml", "position_resolved_velocity", &[]);
    converges("ur5-b.toml", "position_resolved_velocity", &["servo.orientation_error=euler_zyx"]);
    converges("ur5-hybrid.toml", "hybrid", &[]);
}

#[test]
fn a_taught_goal_and_given_features() {
    let taught = lockstep("scara-d.toml", &["servo.set_point.kind=taught"]);
    assert_accurate(&taught);
    assert!(number(&taught.summary, &["duration_s"]) < 2.0, "it is there already: {}", taught.summary);
    // What X_DO of the default file shows, to the digits of the text and beyond.
    let features = "servo.set_point.features=[[-0.166666667, 0.166666667], [-0.083333333, 0.022329099], \
                    [0.061004234, 0.105662433], [-0.022329099, 0.25]]";
    converges("scara-b.toml", "position_resolved_velocity", &["servo.set_point.kind=features", features]);
}

#[test]
fn laws_that_cannot_work_are_refused_at_the_start() {
    for (file, set, key) in [
        ("scara-a.toml", &["drive.kind=ideal"][..], "servo.scheme"),
        ("scara-a.toml", &["drive.mode=velocity"], "servo.scheme"),
        ("scara-b.toml", &["servo.dimension=5"], "servo.dimension"),
        ("ur5-b.toml", &["servo.dimension=4"], "servo.dimension"),
        ("scara-b.toml", &["servo.gain_1_s=[1, 2]"], "servo.gain_1_s"),
        ("scara-d.toml", &["servo.gain_1_s=[1, 2, 3]"], "servo.gain_1_s"),
        ("scara-d.toml", &["servo.points=[1, 5]"], "servo.points"),
        ("scara-d.toml", &["servo.segments=[[2, 2]]"], "servo.segments"),
        ("scara-d.toml", &["servo.weights=[1]"], "servo.weights"),
        ("ur5-hybrid.toml", &["servo.points=[1, 2, 3]"], "servo.points"),
        ("scara-d.toml", &["servo.set_point.kind=features"], "servo.set_point.features"),
        ("scara-d.toml", &["servo.depth=known", "scene.motion.kind=conveyor"], "servo.depth"),
        ("scara-d.toml", &["scene.object.on=flange"], "scene.object.on"),
    ] {
        let r = lockstep(file, set);
        assert_eq!(r.output.status.code(), Some(3), "{file} {set:?}: {}", r.text());
        assert!(r.text().contains(key), "{file} {set:?}: {}", r.text());
    }
}

/// A plate of four dots looks nearly alike from two sides. A run from the wrong side ends where the error of the image has a local minimum, and that is
/// told; laws that compare poses get from the same start to the goal. What really is out of reach keeps its reason: four joints before a
/// tilted plate, and a lens that bends more than the law believes, where features have no motion left that brings them nearer, either.
#[test]
fn a_local_minimum_is_told() {
    let position = "servo.desired.position_m=[0.0,0.0,0.45]";
    let far_side = [
        "run.duration_s=8",
        "servo.interaction=current",
        position,
        "servo.desired.rotation_rpy_rad=[0.35,0.0,0.0]",
    ];
    let r = lockstep("ur5.toml", &far_side);
    let reason = r.summary["reason"].as_str().unwrap();
    assert!(reason.contains("local minimum") && !reason.contains("cannot be reached"), "{reason}");
    assert_eq!(r.output.status.code(), Some(5));
    // Far from the goal, on the other side of the plate.
    assert!((5.0..10.0).contains(&number(&r.summary, &["final", "feature_error_px"])), "{}", r.summary);
    assert!(number(&r.summary, &["final", "orientation_error_rad"]) > 0.5, "{}", r.summary);
    for scheme in ["position_resolved_velocity", "hybrid"] {
        let scheme = format!("servo.scheme={scheme}");
        assert_accurate(&lockstep("ur5.toml", &[&far_side[..], &[&scheme]].concat()));
    }

    let tilted = ["run.duration_s=8", "scene.object.rotation_rpy_rad=[0.1,0.1,0.78]"];
    let near_side = ["run.duration_s=8", position, "servo.desired.rotation_rpy_rad=[-0.35,0.0,0.0]"];
    let lens = ["scene.camera.lens.k1=-0.05", "vision.model_sd_px=3"];
    for (file, set) in [("default.toml", &tilted[..]), ("ur5.toml", &[&near_side[..], &lens].concat())] {
        let r = lockstep(file, set);
        let reason = r.summary["reason"].as_str().unwrap();
        assert!(reason.contains("cannot be reached") && !reason.contains("local"), "{file}: {reason}");
    }
}

/// What `check` refuses because the arm cannot get there is not run, unless it is meant.
#[test]
fn a_goal_out_of_reach_is_run_only_if_it_is_meant() {
    let run = |more: &[&str]| {
        let instance = crate::common::Instance::new("laws-reach");
        let mut command = crate::common::vservo();
        command.args([
            "run",
            "--clock",
            "lockstep",
            "--instance",
            &instance.name,
            "--set",
            "run.duration_s=1",
        ]);
        command.args(["--set", "scene.object.rotation_rpy_rad=[0.1,0.1,0.78]"]);
        let output = command.args(more).output().unwrap();
        instance.assert_gone();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, told) = run(&[]);
    assert_eq!(code, Some(3), "{told}");
    for word in ["servo.desired: the arm cannot bring the camera there", "vservo run --anyway"] {
        assert!(told.contains(word), "{word}: {told}");
    }
    let (code, told) = run(&["--anyway"]);
    assert_eq!(code, Some(5), "{told}");
    assert!(told.contains("warning: ") && told.contains("the arm cannot bring the camera there"), "{told}");
}

/// Each way of writing the orientation error leads B and the hybrid law on six joints home, and A on four.
#[test]
fn each_orientation_error_leads_home() {
    for orientation in ["euler_zyx", "euler_xyz", "angle_axis", "r_sin", "quaternion"] {
        let set = format!("servo.orientation_error={orientation}");
        for file in ["ur5-b.toml", "ur5-hybrid.toml", "scara-a.toml"] {
            assert_accurate(&lockstep(file, &[&set]));
        }
    }
}

/// Control tells in its status and in its summary how far the law is from instability, as `vservo check` does.
#[test]
fn the_stability_of_a_run_is_told() {
    let r = lockstep("ur5.toml", &["run.duration_s=2", "scene.camera.lens.fx_px=790"]);
    let check = crate::common::vservo()
        .args(["check", "ur5", "--json", "--set", "scene.camera.lens.fx_px=790"])
        .output()
        .unwrap();
    let check: serde_json::Value = serde_json::from_slice(&check.stdout).unwrap();
    let told = &r.summary["stability"];
    assert!(told["start"]["joints"]["slowest"].is_f64(), "{}", r.summary);
    let find = |v: &serde_json::Value| v["stability"].clone();
    assert_eq!(*told, find(&check), "{check}");
    assert_eq!(lockstep("ur5-b.toml", &["run.duration_s=2"]).summary["stability"], serde_json::Value::Null);
}
