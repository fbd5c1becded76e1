//! How the targets of a simulated scene move: `[scene.motion]`, `[scene.objects.NAME.motion]`.

use super::super::check::Validation;
use super::super::raw::{RawSceneMotion, SceneMotionKind};
use crate::scene::SceneMotion;
use crate::time::SpanNs;
use nalgebra::{UnitVector3, Vector3};

/// Largest cosine between axis and radius of a circle: rounding of numbers that are written with three digits.
const SQUARE: f64 = 1e-3;

/// The motion that the table at `at_key` says.
pub(super) fn scene_motion(at_key: &str, motion: &RawSceneMotion, check: &mut Validation<'_>) -> SceneMotion {
    warn_of_other_kinds(at_key, motion, check);
    for (key, list) in [
        ("velocity_m_s", &motion.velocity_m_s),
        ("amplitude_m", &motion.amplitude_m),
        ("radius_m", &motion.radius_m),
        ("axis", &motion.axis),
        ("displacement_m", &motion.displacement_m),
    ] {
        for (i, v) in list.iter().enumerate() {
            check.range(&format!("{at_key}.{key}[{i}]"), *v, -10.0..=10.0);
        }
    }
    let frequency_hz = check.range(&format!("{at_key}.frequency_hz"), motion.frequency_hz, 0.0..=10.0);
    // A tick at least, and no longer than any run.
    let [moving, resting, at] =
        [("moving_s", motion.moving_s), ("resting_s", motion.resting_s), ("at_s", motion.at_s)]
            .map(|(key, s)| SpanNs::from_s(check.range(&format!("{at_key}.{key}"), s, 1e-3..=1e5)));
    match motion.kind {
        SceneMotionKind::Still => SceneMotion::Still,
        SceneMotionKind::Conveyor => SceneMotion::Conveyor { velocity_m_s: motion.velocity_m_s.into() },
        SceneMotionKind::Pendulum => {
            SceneMotion::Pendulum { amplitude_m: motion.amplitude_m.into(), frequency_hz }
        }
        SceneMotionKind::Circle => {
            let radius_m = Vector3::from(motion.radius_m);
            let axis = UnitVector3::try_new(motion.axis.into(), 0.0);
            let square = axis.filter(|axis| axis.dot(&radius_m).abs() <= SQUARE * radius_m.norm());
            if square.is_none() {
                let message = format!(
                    "must not be zero, and at right angles to {at_key}.radius_m, which leads from the target to the centre"
                );
                check.wrong(&format!("{at_key}.axis"), message);
            }
            SceneMotion::Circle { radius_m, axis: square.unwrap_or_else(Vector3::z_axis), frequency_hz }
        }
        SceneMotionKind::StopAndGo => {
            SceneMotion::StopAndGo { velocity_m_s: motion.velocity_m_s.into(), moving, resting }
        }
        SceneMotionKind::Jump => SceneMotion::Jump { displacement_m: motion.displacement_m.into(), at },
    }
}

/// Warns of what is written for another kind of motion, unless it is the default: a run file may list all.
fn warn_of_other_kinds(at_key: &str, motion: &RawSceneMotion, check: &mut Validation<'_>) {
    use SceneMotionKind::{Circle, Conveyor, Jump, Pendulum, StopAndGo};
    let usual = RawSceneMotion::default();
    let by_velocity = (&[Conveyor, StopAndGo][..], "\"conveyor\" or \"stop_and_go\"");
    let by_frequency = (&[Pendulum, Circle][..], "\"pendulum\" or \"circle\"");
    let (pendulum, circle) = ((&[Pendulum][..], "\"pendulum\""), (&[Circle][..], "\"circle\""));
    let (by_turns, jump) = ((&[StopAndGo][..], "\"stop_and_go\""), (&[Jump][..], "\"jump\""));
    for (key, differs, (kinds, words)) in [
        ("velocity_m_s", motion.velocity_m_s != usual.velocity_m_s, by_velocity),
        ("amplitude_m", motion.amplitude_m != usual.amplitude_m, pendulum),
        ("frequency_hz", motion.frequency_hz != usual.frequency_hz, by_frequency),
        ("radius_m", motion.radius_m != usual.radius_m, circle),
        ("axis", motion.axis != usual.axis, circle),
        ("moving_s", motion.moving_s != usual.moving_s, by_turns),
        ("resting_s", motion.resting_s != usual.resting_s, by_turns),
        ("displacement_m", motion.displacement_m != usual.displacement_m, jump),
        ("at_s", motion.at_s != usual.at_s, jump),
    ] {
        let key = format!("{at_key}.{key}");
        if differs && !kinds.contains(&motion.kind) && check.is_written(&key) {
            check.doubtful(&key, format!("has no effect here, only with {at_key}.kind = {words}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    fn warnings(set: &[&str]) -> Vec<String> {
        let set: Vec<_> = set.iter().map(ToString::to_string).collect();
        let warnings = Config::load(None, &set).unwrap().warnings;
        warnings.iter().map(ToString::to_string).filter(|told| told.contains("has no effect")).collect()
    }

    #[test]
    fn what_another_motion_needs_is_told_as_idle() {
        for (kind, key, needs) in [
            ("pendulum", "velocity_m_s=[0.1,0,0]", "\"conveyor\" or \"stop_and_go\""),
            ("still", "frequency_hz=0.5", "\"pendulum\" or \"circle\""),
            ("conveyor", "radius_m=[0,0.2,0]", "\"circle\""),
            ("circle", "moving_s=2", "\"stop_and_go\""),
            ("stop_and_go", "at_s=3", "\"jump\""),
        ] {
            let set = [format!("scene.motion.kind={kind}"), format!("scene.motion.{key}")];
            let told = warnings(&set.each_ref().map(String::as_str));
            let [told] = &told[..] else { panic!("{kind} {key}: {told:?}") };
            let key = key.split('=').next().unwrap();
            assert!(told.contains(&format!("scene.motion.{key}: has no effect")), "{told}");
            assert!(told.ends_with(&format!("only with scene.motion.kind = {needs}")), "{told}");
        }
        for good in [
            &["scene.motion.kind=pendulum", "scene.motion.frequency_hz=0.5"][..],
            &["scene.motion.kind=stop_and_go", "scene.motion.velocity_m_s=[0.1,0,0]"],
            &["scene.motion.velocity_m_s=[0.0,0.05,0.0]"],
        ] {
            assert_eq!(warnings(good), Vec::<String>::new(), "{good:?}");
        }
    }
}
