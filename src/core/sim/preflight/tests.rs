use super::{Preflight, Reach};
use crate::config::Config;
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::linalg::Random;
use crate::scene::{Renderer, SceneLook, SensorModel, Visibility};
use crate::vision::{Vision, VisionSettings};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};

fn shipped(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config").join(file)
}

fn preflight(file: &str, set: &[&str]) -> Preflight {
    let set: Vec<_> = set.iter().map(ToString::to_string).collect();
    Preflight::of(&Config::load(Some(&shipped(file)), &set).unwrap()).unwrap()
}

/// What is said of the goal is what the posture shows, for cameras in the hand and beside the arm.
#[test]
fn the_posture_of_the_goal_shows_the_goal() {
    for file in ["default.toml", "ur5.toml", "panda.toml", "pan_tilt.toml", "scara-eye-to-hand.toml"] {
        let config = Config::load(Some(&shipped(file)), &[]).unwrap();
        let Reach::Within(posture) = preflight(file, &[]).reach else { panic!("{file}") };
        let X_WC = crate::dispatch_robot!(config.robot, |arm| {
            config.camera.mount.X_WC(&arm, &nalgebra::SVector::from_column_slice(&posture.q))
        })
        .unwrap();
        let X_CO = X_WC.inv_mul(&config.X_WO().unwrap());
        let off = X_CO.inv_mul(config.set_point.X_DO().unwrap());
        assert!(off.translation.vector.norm() < 1e-4 && off.rotation.angle() < 1e-4, "{file}: {off}");
    }
}

#[test]
fn goals_out_of_reach_are_told_with_what_holds_the_arm() {
    for (file, set, words) in [
        ("ur5.toml", "servo.desired.position_m=[-0.05,-0.05,0.9]", "mm and"),
        ("default.toml", "servo.desired.rotation_rpy_deg=[5,0,-60]", "5.00 deg off"),
        ("default.toml", "servo.desired.position_m=[-0.05,-0.05,1.6]", "`joint_3` at its lower end"),
        ("pan_tilt.toml", "servo.desired.position_m=[-0.05,-0.05,0.7]", "100.0 mm"),
        ("scara-eye-to-hand.toml", "servo.desired.rotation_rpy_deg=[0,8,0]", "as far as 4 joints can"),
    ] {
        let preflight = preflight(file, &[set]);
        let [(key, message)] = &preflight.faults()[..] else {
            panic!("{file} {set}: {:?}", preflight.faults())
        };
        assert_eq!(*key, "servo.desired");
        assert!(message.contains(words), "{file} {set}: {message}");
        assert!(preflight.way.is_none());
    }
}

/// `check` names the depth that the law really takes, and none for laws without.
#[test]
fn the_depth_of_the_law_is_told() {
    for (file, set, words) in [
        ("default.toml", &[][..], "L_s takes the depths that vision estimates"),
        ("scara-d.toml", &["servo.depth=initial"], "L_s keeps the depths of the first measurement"),
        ("scara-d.toml", &["servo.depth=constant", "servo.constant_depth_m=0.7"], "L_s takes 0.7 m"),
        ("scara-d.toml", &["servo.depth=known", "servo.interaction=desired"], "of the desired features"),
        ("scara-c.toml", &["servo.depth=desired"], "L_s takes the depths of the desired pose"),
        ("scara-hybrid.toml", &["servo.depth=estimated"], "J_p takes z_d of the desired pose"),
        ("scara-hybrid.toml", &["servo.depth=initial"], "J_p keeps the depth of the first measurement"),
        ("scara-hybrid.toml", &["servo.depth=constant"], "J_p takes 0.6 m for z_d"),
    ] {
        let lines = preflight(file, set).lines();
        assert!(lines.iter().any(|line| line.contains(words)), "{file} {set:?}: {lines:?}");
    }
    for file in ["scara-b.toml", "scara-a.toml"] {
        assert_eq!(preflight(file, &["servo.depth=initial"]).depth, None);
    }
}

/// What the law believes is right: all margins are 1. A camera turned in the hand shows in the joints alone, a depth in both.
#[test]
fn margins_tell_what_the_law_believes_wrong() {
    let margins = |set: &[&str]| {
        let set: Vec<_> = ["servo.interaction=current"].iter().chain(set).copied().collect();
        let found = preflight("ur5.toml", &set).stability.unwrap();
        let goal = found.goal.unwrap();
        [found.start.camera, found.start.joints, goal.camera, goal.joints].map(|m| [m.definite, m.slowest])
    };
    let off = |m: &[f64; 2]| (m[0] - 1.0).abs().max((m[1] - 1.0).abs());
    assert!(margins(&[]).iter().all(|m| off(m) < 1e-5), "{:?}", margins(&[]));
    let turned = margins(&["scene.camera.mount.rotation_rpy_rad=[0.0, 0.0, 0.3]"]);
    assert!(off(&turned[2]) < 1e-5 && off(&turned[3]) > 0.01 && turned[3][1] > 0.5, "{turned:?}");
    for depth_m in ["0.3", "1.2"] {
        let depth = format!("servo.constant_depth_m={depth_m}");
        let wrong = margins(&["servo.depth=constant", &depth]);
        assert!(wrong.iter().all(|m| m[0] < 0.99 && m[1] > 0.1), "{wrong:?}");
    }
    // The mean of two matrices is that of the features at the goal alone.
    let mean = preflight("ur5.toml", &[]).stability.unwrap();
    assert!(
        (mean.goal.unwrap().joints.slowest - 1.0).abs() < 1e-5
            && (0.3..0.9).contains(&mean.start.joints.slowest)
    );
    assert_eq!(preflight("scara-b.toml", &[]).stability, None);
    let told = preflight("ur5.toml", &["servo.interaction=current"]).lines();
    assert!(
        told.iter().any(|line| line.contains("smallest eigenvalue 1.000 at the start, 1.000 at the goal")),
        "{told:?}"
    );
    assert!(preflight("ur5.toml", &[]).doubts().is_empty());
}

/// An error of the mount beyond a right angle: the goal is unstable, and `check` says so.
#[test]
fn an_unstable_goal_is_doubtful() {
    let mut found = preflight("ur5.toml", &[]);
    assert!(!found.stability.unwrap().is_doubtful());
    let mut stability = found.stability.unwrap();
    stability.goal.as_mut().unwrap().joints.slowest = -0.1;
    found.stability = Some(stability);
    let doubts = found.doubts();
    assert!(
        matches!(&doubts[..], [(key, message)] if key == "servo.depth" && message.contains("unstable") && message.contains("-0.100")),
        "{doubts:?}"
    );
}

/// Start and goal differ in a joint of the wrist alone, which passes the middle, where two axes of the wrist are one.
#[test]
fn a_way_past_a_singular_posture_is_doubtful() {
    let robot = crate::robot::load("ur5").unwrap().build::<6>().unwrap();
    let X_EC = Pose::translation(0.0, 0.0, 0.05);
    let way = |from: f64, to: f64| {
        let posture = |wrist: f64| [-0.02, -1.6, 1.95, -1.9, wrist, 0.0];
        let X_WC = |wrist: f64| robot.forward(&posture(wrist).into()) * X_EC;
        let X_WO = X_WC(0.5 * (from + to)) * Pose::translation(-0.05, -0.05, 0.6);
        let draft = crate::config::Draft::load(Some(&shipped("ur5.toml")), &[]).unwrap();
        let placed = draft.placed(&posture(from), &X_WO, &X_WC(to).inv_mul(&X_WO));
        Preflight::of(&placed.validate().unwrap()).unwrap()
    };
    let past = way(-0.15, 0.15);
    let doubts = past.doubts();
    assert!(doubts.iter().any(|(_, m)| m.contains("near a singular posture")), "{doubts:?}");
    let way_there = past.way.unwrap();
    assert!(
        (way_there.nearest_at - 0.5).abs() < 0.1 && way_there.dexterity[2] < 1e-2,
        "{:?}",
        way_there.dexterity
    );
    assert_eq!(way(-1.5, -1.2).doubts(), vec![]);
}

#[test]
fn what_is_not_asked_is_not_looked_at() {
    let unasked = |file: &str, set: &[&str]| match preflight(file, set).reach {
        Reach::Unasked { why } => why,
        other => panic!("{other:?}"),
    };
    assert!(unasked("real-cell.toml", &[]).contains("when the camera sees it"));
    assert!(unasked("hand-held.toml", &[]).contains("no arm moves"));
    assert!(unasked("default.toml", &["servo.set_point.kind=taught"]).contains("at the start"));
    let calibrates = ["run.task=calibrate_latency", "run.clock=realtime"];
    assert!(unasked("ur5.toml", &calibrates).contains("calibration"));
    let moving = preflight("default.toml", &["scene.motion.kind=pendulum"]);
    assert!(!moving.object_rests && moving.notes.iter().any(|note| note.contains("moves")));
}

/// Whole marks, not centres alone: what `Visibility` says can be found is found in the rendered image, and what it says cannot is not.
#[test]
fn what_can_be_found_is_found_and_nothing_else() {
    let config = Config::load(None, &[]).unwrap();
    let camera = config.camera.model;
    let i = *camera.intrinsics();
    let (width, height) = (i.width_px as usize, i.height_px as usize);
    let mut renderer =
        Renderer::new(camera, config.target.clone(), SceneLook::default(), SensorModel::default()).unwrap();
    let mut vision =
        Vision::new(camera, config.target.clone(), VisionSettings { track: false, ..config.vision });
    let mut random = Random::new(5);
    let mut pixels = vec![0; width * height];
    let (mut tried, mut cut, mut found, mut wrong) = (0, 0, 0, Vec::new());
    while tried < 384 {
        let tilt = Vector3::new(random.between(-0.5, 0.5), random.between(-0.5, 0.5), 0.0);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * random.between(-3.0, 3.0));
        let place =
            Vector3::new(random.between(-0.3, 0.3), random.between(-0.2, 0.2), random.between(0.3, 0.8));
        let X_CO = Pose::from_parts(place.into(), UnitQuaternion::from_scaled_axis(tilt) * turn);
        let visibility = Visibility::of(&config.target, &camera, &X_CO);
        // as the run file's own check takes it: by the centres
        let centres =
            visibility.points.iter().all(|p| p.px.is_some_and(|px| camera.contains(&px.into(), 0.0)));
        if !centres {
            continue;
        }
        tried += 1;
        renderer.render(&[X_CO], tried, &mut pixels);
        let seen = vision.process_image(&ImageView::new(&pixels, width, height).unwrap()).is_ok();
        found += usize::from(seen);
        cut += usize::from(!visibility.can_be_found());
        if seen != visibility.can_be_found() {
            wrong.push((seen, visibility.room_px));
        }
    }
    // a dot that lacks less than a pixel may be found all the same; one that is whole is found
    let clear = wrong.iter().all(|(seen, room_px)| *seen && *room_px > -1.0);
    assert!(clear && wrong.len() <= 5, "of {tried}: {found} found, {cut} said to be cut: {wrong:?}");
    assert!(cut > 20 && found > 200, "{cut} cut, {found} found");
}

/// Far off the axis the image plane makes anything large; it is too large where it does not fit in the middle either.
#[test]
fn a_target_beside_the_view_is_not_too_large() {
    let config = Config::load(None, &[]).unwrap();
    let says = |direction: Vector3<f64>, distance_m: f64| {
        let X_CO = Pose::from_parts((direction.normalize() * distance_m).into(), UnitQuaternion::identity());
        let visibility = Visibility::of(&config.target, &config.camera.model, &X_CO);
        visibility.too_large_px.is_some()
    };
    let ahead = Vector3::z();
    for off in [Vector3::x(), Vector3::y(), Vector3::new(-1.0, 1.0, 0.0)] {
        assert!(!says(ahead * 0.18 + off, 0.6), "80 degrees off: {off:?}");
        assert!(says(ahead + off * 0.02, 0.1), "too near: {off:?}");
    }
    assert!(!says(ahead, 0.6));
}

/// A payload that is told and that the shoulder cannot hold against gravity: the joint, the place and both numbers.
#[test]
fn gravity_beyond_an_effort_limit_is_told() {
    assert_eq!(preflight("ur5.toml", &[]).overload, None);
    let heavy = preflight("ur5.toml", &["tool.mass_kg=60", "tool.com_m=[0.0, 0.0, 0.1]"]);
    let message = heavy.overload.clone().unwrap();
    assert!(message.contains("at the start gravity needs") && message.contains("shoulder_lift"), "{message}");
    assert!(message.contains("effort limit is 150"), "{message}");
    assert!(heavy.doubts().iter().any(|(key, told)| *key == "robot.model" && *told == message));
}

/// What is missing is told with the key that gives it, and only where it matters. The figures by hand: 0.02 s times the effort over the speed.
#[test]
fn rotors_that_no_file_tells_are_told() {
    let told = preflight("ur5.toml", &[]).rotors.unwrap();
    assert!(told.contains("armature_kg_m2") && told.contains("shoulder_pan_joint 0.95"), "{told}");
    assert!(told.contains("wrist_3_joint 0.18"), "{told}");
    assert_eq!(preflight("ur5.toml", &["drive.mode=position"]).rotors, None);
}

/// Goals that have names are looked at like the one of the run, each with its own target where that lies.
#[test]
fn goals_and_postures_with_names_are_looked_at() {
    let bin = [
        "targets.bin.kind=tags",
        "targets.bin.tags={size_m=0.06,first_id=7}",
        "scene.objects.bin={position_m=[1.12,1.24,1.0],rotation_rpy_deg=[0,0,45]}",
    ];
    let names = [
        "goals.near={position_m=[-0.05,-0.05,0.5],rotation_rpy_deg=[0,0,-60]}",
        "goals.far={position_m=[-0.05,-0.05,1.6],rotation_rpy_deg=[0,0,-60]}",
        "goals.bin={target=\"bin\",position_m=[0,0,0.5],rotation_rpy_deg=[0,0,-60]}",
        "goals.bin_tilted={target=\"bin\",position_m=[0,0,0.5],rotation_rpy_deg=[10,0,0]}",
        "goals.beside={target=\"bin\",position_m=[0.6,0,0.5]}",
        "postures.home={q_rad_or_m=[0,1.5,0.4,0]}",
        "postures.beyond={q_rad_or_m=[0,1.5,40,0]}",
    ];
    let set: Vec<_> = bin.into_iter().chain(names).map(ToOwned::to_owned).collect();
    let config = Config::load(Some(&shipped("default.toml")), &set).unwrap();
    let preflight = Preflight::of(&config).unwrap().with_names(&config).unwrap();
    let named = |name: &str| preflight.goals.iter().find(|goal| goal.name == name).unwrap();
    // The posture of a goal shows that goal: by the arm's own kinematics, at where the target of it lies.
    for (name, X_WO) in
        [("near", config.X_WO().unwrap()), ("bin", config.scene.as_ref().unwrap().further_targets[0].X_WO)]
    {
        let Reach::Within(posture) = &named(name).reach else { panic!("{name}: {:?}", named(name)) };
        let X_WC = crate::dispatch_robot!(config.robot, |arm| {
            config.camera.mount.X_WC(&arm, &nalgebra::SVector::from_column_slice(&posture.q))
        })
        .unwrap();
        let X_CO = X_WC.inv_mul(&X_WO);
        let wanted = Pose::new(
            [if name == "near" { -0.05 } else { 0.0 }, if name == "near" { -0.05 } else { 0.0 }, 0.5].into(),
            [0.0, 0.0, -60.0_f64.to_radians()].into(),
        );
        let off = X_CO.inv_mul(&wanted);
        assert!(off.translation.vector.norm() < 1e-4 && off.rotation.angle() < 1e-4, "{name}: {off}");
        assert!(named(name).doubts.is_empty(), "{:?}", named(name));
    }
    for (name, words) in [
        ("far", "the arm cannot bring the camera there"),
        ("bin_tilted", "10.00 deg off"),
        ("beside", "in the desired view"),
    ] {
        let told = named(name).doubts.join("; ");
        assert!(told.contains(words), "{name}: {told}");
    }
    let doubts = preflight.doubts();
    let is_told = |name: &str| doubts.iter().any(|(key, _)| *key == name);
    assert!(is_told("goals.far") && is_told("postures.beyond"), "{doubts:?}");
    assert!(!is_told("goals.near") && !is_told("postures.home"), "{doubts:?}");
    assert!(preflight.faults().is_empty(), "{:?}", preflight.faults());
}

/// A target that is covered from the first tick to the last is never found; one that is free at some time, or at one of its sides, may be.
#[test]
fn a_target_that_stays_covered_is_told() {
    let occluder =
        |text: &str| format!("scene.occluder={{center_m=[0.05,0.05], size_m=[0.14,0.14], {text}}}");
    let told = |set: &str| preflight("ur5.toml", &[set]).covered;
    let message = told(&occluder("from_s=0, until_s=90, height_m=0.0")).unwrap();
    assert!(message.contains("leave 0 of the target's 4 points"), "{message}");
    // near the camera, before one dot: four are needed
    let near =
        "scene.occluder={center_m=[0.0,0.0], size_m=[0.02,0.02], from_s=0, until_s=30, height_m=0.001}";
    assert!(told(near).unwrap().contains("leave 3 of the target's 4 points"));
    for free in ["from_s=0, until_s=29, height_m=0.0", "from_s=1, until_s=90, height_m=0.0"] {
        assert_eq!(told(&occluder(free)), None, "{free}");
    }
    assert_eq!(told("scene.occluder={center_m=[0.5,0.05], size_m=[0.1,0.1], from_s=0, until_s=90}"), None);
    // a sheet behind the camera is before nothing
    assert_eq!(told(&occluder("from_s=0, until_s=90, height_m=5.0")), None);
}

/// A turn of the camera about its axis by 120 degrees in half a second is one of the last joint: with a cubic it peaks at 1.5 times the mean, 6.28 rad/s.
#[test]
fn a_path_that_no_joint_can_follow_is_told() {
    let path = |s: f64| {
        let pose = |t_s: f64, deg: f64| {
            format!("{{ t_s = {t_s}, position_m = [0, 0, 0.55], rotation_rpy_deg = [0, 0, {deg}] }}")
        };
        format!("servo.path.poses=[{}, {}]", pose(2.0, 0.0), pose(2.0 + s, 120.0))
    };
    let start = "servo.desired={ position_m = [0, 0, 0.55], rotation_rpy_deg = [0, 0, 0] }";
    let ahead = |s: f64| preflight("ur5.toml", &[start, &path(s)]);
    let quick = ahead(0.5);
    let told = quick.path.clone().and_then(|path| path.overspeed).unwrap();
    assert!(told.joint == "wrist_3_joint" && told.needs > 5.5 && told.needs < 6.4, "{told:?}");
    assert!(told.limit < told.needs && (2.0..2.5).contains(&told.at_s), "{told:?}");
    assert!(quick.doubts().iter().any(|(key, told)| *key == "servo.path" && told.contains("wrist_3_joint")));
    let slow = ahead(5.0);
    assert!(
        slow.path.clone().is_some_and(|path| path.overspeed.is_none() && path.beyond.is_none()),
        "{:?}",
        slow.path
    );
}
