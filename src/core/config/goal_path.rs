//! `[servo.path]`: the desired pose over time.

use super::check::Validation;
use super::raw::{RawConfig, RawServo, SchemeKind, SetPointKind, Task};
use crate::geometry::Pose;
use crate::servo::{GoalPath, UpdatePolicy};
use std::ops::RangeInclusive;

/// Times of a path, s: from ten ticks on, to the longest run. Chosen by hand.
const TIME_S: RangeInclusive<f64> = 0.01..=86_400.0;
/// Poses of a path. Chosen by hand, more than anybody writes.
const MAX_POSES: usize = 1000;
/// Largest turn from one pose to the next: near half a turn it is not clear which way round. Chosen.
const MAX_TURN_DEG: f64 = 150.0;

/// Angles above this, deg, are written for a turn on the way there, not for an orientation. Derived: half a turn, and what rounding to three decimals of a radian adds.
const HALF_TURN_DEG: f64 = 180.1;

/// What the numbers of a pose say of a turn that its orientation does not have: a path takes the shortest way from pose to pose. `before_rad` and `after_rad` are
/// roll, pitch and yaw; `vector_rad` is a rotation vector, where the later pose is written so.
fn lost_turn(before_rad: [f64; 3], after_rad: [f64; 3], vector_rad: Option<&[f64]>) -> Option<String> {
    let vector_deg = vector_rad.map_or(0.0, |v| v.iter().map(|x| x * x).sum::<f64>().sqrt().to_degrees());
    if vector_deg > HALF_TURN_DEG {
        return Some(format!("is written as a turn by {vector_deg:.0} degrees"));
    }
    let pairs = ["roll", "pitch", "yaw"].into_iter().zip(before_rad).zip(after_rad);
    let mut pairs = pairs.map(|((name, before), after)| (name, before.to_degrees(), after.to_degrees()));
    // from 170 to -170 degrees is a turn by 20
    pairs.find_map(|(name, before, after)| {
        let goes_round =
            before.abs().max(after.abs()) > HALF_TURN_DEG || (after - before).abs() > 2.0 * 179.9;
        let is_lost = (after - before).abs() > HALF_TURN_DEG && goes_round;
        is_lost.then(|| format!("has its {name} go from {before:.0} to {after:.0} degrees"))
    })
}

/// The path from `X_DO` on; `None` for a goal at rest, or where something is wrong.
pub(super) fn path(raw: &RawConfig, X_DO: &Pose, check: &mut Validation<'_>) -> Option<GoalPath> {
    let RawServo { path, scheme, update, set_point, .. } = &raw.servo;
    if path.poses.is_empty() {
        return None;
    }
    let before = check.count_problems();
    let mut wrong = |message: &str| check.wrong("servo.path", message);
    let follows = matches!(
        scheme,
        SchemeKind::PositionResolvedVelocity | SchemeKind::ImageResolvedVelocity | SchemeKind::Hybrid
    );
    if !follows {
        wrong(
            "needs a law of joint velocities: servo.scheme = \"position_resolved_velocity\", \"image_resolved_velocity\" or \"hybrid\"",
        );
    }
    if *update != UpdatePolicy::Predict {
        wrong("needs servo.update = \"predict\": the others do not look ahead");
    }
    if set_point.kind != SetPointKind::Pose {
        wrong("needs servo.set_point.kind = \"pose\": the other goals have no pose to begin from");
    }
    if raw.stereo.is_some() {
        wrong("needs a single camera: a pair follows the points of its taught view");
    }
    if raw.run.task != Task::Servo {
        wrong("needs run.task = \"servo\"");
    }
    if path.poses.len() > MAX_POSES {
        wrong(&format!("has {} poses, at most {MAX_POSES} are allowed", path.poses.len()));
        return None;
    }
    let mut poses = vec![(0.0, *X_DO)];
    let mut rpy_before = raw.servo.desired.rotation_rpy_rad;
    for (i, pose) in path.poses.iter().enumerate() {
        let key = format!("servo.path.poses[{i}]");
        let t_s = check.range(&format!("{key}.t_s"), pose.t_s, TIME_S);
        let X = check.pose(&key, pose.position_m, pose.rotation_rpy_rad);
        let (before_s, before) = poses.last().copied().unwrap_or((0.0, *X_DO));
        let is_time = TIME_S.contains(&t_s);
        if is_time && t_s < before_s + TIME_S.start() {
            let message =
                format!("{t_s} s is not later than {before_s} s before it, by {} s", TIME_S.start());
            check.wrong(&format!("{key}.t_s"), message);
        }
        let turn_deg = before.rotation.angle_to(&X.rotation).to_degrees();
        if turn_deg > MAX_TURN_DEG {
            let message = format!(
                "turns by {turn_deg:.0} degrees from the pose before it: above {MAX_TURN_DEG} it is not clear which way round; put a pose between"
            );
            check.wrong(&key, message);
        } else {
            let vector = check.written_list(&format!("{key}.rotation_vector_rad"));
            if let Some(what) = lost_turn(rpy_before, pose.rotation_rpy_rad, vector.as_deref()) {
                let message = format!(
                    "{what}, and a path takes the shortest way from pose to pose, which is a turn by {turn_deg:.0} degrees: put poses between, each less than \
                     {MAX_TURN_DEG} degrees from the one before it; where the short way is meant, write the angles of that"
                );
                check.wrong(&key, message);
            }
        }
        rpy_before = pose.rotation_rpy_rad;
        poses.push((if is_time { t_s } else { before_s }, X));
    }
    let end_s = poses.last().map_or(0.0, |(t_s, _)| *t_s);
    if !raw.run.serve && TIME_S.contains(&raw.run.duration_s) && raw.run.duration_s <= end_s {
        let message = format!("{} s are over before the path is, at {end_s} s", raw.run.duration_s);
        check.wrong("run.duration_s", message);
    }
    if check.count_problems() > before {
        return None;
    }
    GoalPath::new(&poses, path.feed_forward)
}

#[cfg(test)]
mod tests {
    use super::lost_turn;
    use crate::config::{Config, ConfigError};

    fn load(file: &str, set: &[&str]) -> Result<Config, ConfigError> {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config").join(file);
        Config::load(Some(&path), &set.iter().map(ToString::to_string).collect::<Vec<_>>())
    }

    #[test]
    fn what_is_no_path_is_told_by_its_key() {
        let poses = |poses: &str| format!("servo.path.poses=[{poses}]");
        let told = |set: &[&str]| load("ur5.toml", set).unwrap_err().to_string();
        let there = "position_m = [-0.05, -0.05, 0.4]";
        let one = poses(&format!("{{ t_s = 2, {there} }}"));
        assert!(load("ur5.toml", &[&one]).unwrap().servo.path.is_some());
        for (key, word, set) in [
            ("servo.path.poses[0].t_s", "out of range", poses(&format!("{{ {there} }}"))),
            (
                "servo.path.poses[1].t_s",
                "not later",
                poses(&format!("{{ t_s = 2, {there} }}, {{ t_s = 1, {there} }}")),
            ),
            (
                "servo.path.poses[0]",
                "170 degrees",
                poses(&format!("{{ t_s = 2, {there}, rotation_rpy_deg = [0, 0, 170] }}")),
            ),
            (
                "servo.path.poses[0]",
                "yaw go from 0 to 360 degrees",
                poses(&format!("{{ t_s = 2, {there}, rotation_rpy_deg = [0, 0, 360] }}")),
            ),
            (
                "servo.path.poses[1]",
                "a turn by 90 degrees",
                poses(&format!(
                    "{{ t_s = 2, {there} }}, {{ t_s = 4, {there}, rotation_rpy_deg = [0, 0, 270] }}"
                )),
            ),
            (
                "servo.path.poses[0]",
                "written as a turn by 360 degrees",
                poses(&format!("{{ t_s = 2, {there}, rotation_vector_rad = [0, 0, 6.2832] }}")),
            ),
            (
                "servo.path.poses[0].rotation_xyzw",
                "has length",
                poses(&format!("{{ t_s = 2, {there}, rotation_xyzw = [0, 0, 0, 1.05] }}")),
            ),
            (
                "servo.path.poses[0].position_m[0]",
                "out of range",
                poses("{ t_s = 2, position_m = [200, 0, 0.4] }"),
            ),
            (
                "servo.path.poses[0]",
                "outside the image in the desired view at",
                poses("{ t_s = 2, position_m = [0.4, 0, 0.4] }"),
            ),
            ("run.duration_s", "before the path is", poses(&format!("{{ t_s = 30, {there} }}"))),
        ] {
            let told = told(&[&set]);
            assert!(told.contains(&format!("{key}: ")) && told.contains(word), "{key} {word}: {told}");
        }
        for (set, word) in [
            ("servo.update=frame", "servo.update"),
            ("servo.scheme=position_pd", "joint velocities"),
            ("servo.set_point.kind=taught", "set_point.kind"),
            ("drive.kind=none", "an arm that moves"),
        ] {
            let told = told(&[&one, set]);
            assert!(told.contains("servo.path: ") && told.contains(word), "{set}: {told}");
        }
    }

    #[test]
    fn a_hold_that_no_run_is_long_enough_for_is_told() {
        let path = "servo.path.poses=[{ t_s = 25, position_m = [-0.05, -0.05, 0.4] }]";
        for (set, is_told) in [
            (&["goal.hold_s=40", "run.duration_s=30"][..], true),
            (&["goal.hold_s=6", "run.duration_s=30", path], true),
            (&["goal.hold_s=4", "run.duration_s=30", path], false),
            (&["goal.hold_s=40", "run.duration_s=30", "run.serve=true"], false),
            (&["goal.hold_s=40", "run.duration_s=50"], false),
        ] {
            let told: Vec<_> =
                load("ur5.toml", set).unwrap().warnings.iter().map(ToString::to_string).collect();
            assert_eq!(told.iter().any(|told| told.contains("goal.hold_s: ")), is_told, "{set:?}: {told:?}");
            assert!(!is_told || told[0].contains("never converge"), "{told:?}");
        }
    }

    #[test]
    fn a_whole_turn_by_poses_between_is_a_path() {
        let pose = |i: i32| {
            let (t_s, deg) = (i * 2, i * 120);
            format!("{{ t_s = {t_s}, position_m = [0, 0, 0.55], rotation_rpy_deg = [0, 0, {deg}] }}")
        };
        let set = format!("servo.path.poses=[{}]", [1, 2, 3].map(pose).join(", "));
        let path =
            load("ur5.toml", &[&set, "servo.desired.position_m=[0, 0, 0.55]"]).unwrap().servo.path.unwrap();
        assert_eq!(path.poses().count(), 4);
        assert_eq!(
            lost_turn([0.0, 0.0, 2.97], [0.0, 0.0, -2.97], None),
            None,
            "the short way over half a turn"
        );
    }

    #[test]
    fn the_forms_of_a_pose_are_one() {
        let of = |rotation: &str| {
            let set =
                format!("servo.path.poses=[{{ t_s = 2, position_m = [-0.05, -0.05, 0.4], {rotation} }}]");
            *load("ur5.toml", &[&set]).unwrap().servo.path.unwrap().poses().last().unwrap().1
        };
        let (deg, vector) =
            (of("rotation_rpy_deg = [0, 0, 30]"), of("rotation_vector_rad = [0, 0, 0.5235987755982988]"));
        assert!((deg.to_homogeneous() - vector.to_homogeneous()).norm() < 1e-12, "{deg} {vector}");
    }
}
