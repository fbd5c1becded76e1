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
