//! `servo.interaction = "estimated"`: what a law with a learnt image Jacobian needs, and the keys that `vservo run --uncalibrated` sets for it.

use super::Camera;
use super::check::Validation;
use super::raw::{DriveKind, Gains, RawConfig, SchemeKind, SetPointKind, Task};
use crate::servo::{EstimationSettings, InteractionAt, Selection, UpdatePolicy};
use nalgebra::Vector2;

/// The keys that `--uncalibrated` sets, before those of `--set`: the Jacobian is learnt; no pose is asked for that lens and target would have to explain; the target is sought in the
/// whole image, because windows go by the mount; the gain leaves frames enough to learn on the way.
pub const UNCALIBRATED: [&str; 13] = [
    "servo.interaction=estimated",
    "servo.scheme=image_resolved_velocity",
    "servo.update=predict",
    "servo.gain_1_s=2",
    "servo.points=[]",
    "servo.segments=[]",
    "servo.area=none",
    "servo.weights=[]",
    "servo.limit_avoidance_1_s=0",
    "servo.visibility.guard=true",
    "vision.model_sd_px=10",
    "vision.track=false",
    "run.duration_s=90",
];

/// Whether the run file asks for a learnt Jacobian.
pub(super) fn is_asked_for(raw: &RawConfig) -> bool {
    raw.servo.interaction == InteractionAt::Estimated
}

/// The settings of a learnt Jacobian, where the run file asks for one; refuses what it cannot serve.
pub(super) fn estimation(
    raw: &RawConfig,
    camera: Option<&Camera>,
    selection: Option<&Selection>,
    check: &mut Validation<'_>,
) -> Option<EstimationSettings> {
    if !is_asked_for(raw) {
        return None;
    }
    let s = &raw.servo;
    let estimated = "servo.interaction = \"estimated\"";
    if s.scheme != SchemeKind::ImageResolvedVelocity {
        check.wrong("servo.scheme", format!("must be \"image_resolved_velocity\" with {estimated}"));
    }
    if s.update != UpdatePolicy::Predict {
        check.wrong("servo.update", format!("must be \"predict\" with {estimated}"));
    }
    if !matches!(s.gain_1_s, Gains::One(_)) {
        check.wrong("servo.gain_1_s", format!("must be one number with {estimated}"));
    }
    if s.set_point.kind == SetPointKind::Pose {
        let message = format!(
            "is \"pose\", which {estimated} cannot see without lens and target: take the arm to where the target looks as it should, write \
             down the view with `vservo teach CONFIG --uncalibrated --out goal.toml`, and name it in servo.set_point.file"
        );
        check.wrong("servo.set_point.kind", message);
    }
    if !s.segments.is_empty() || selection.is_some_and(Selection::needs_outline) {
        check.wrong(
            "servo.segments",
            format!("{estimated} learns of points alone: leave out segments and area"),
        );
    }
    if selection.is_some_and(|selection| selection.points().count() < 3) {
        check.wrong("servo.points", format!("{estimated} needs three points or more"));
    }
    for (key, is_set) in [
        ("servo.object.moves", s.object.moves),
        ("servo.path", !s.path.poses.is_empty()),
        ("servo.limit_avoidance_1_s", s.limit_avoidance_1_s > 0.0),
        ("stereo", raw.stereo.is_some()),
    ] {
        if is_set {
            check.wrong(key, format!("does not go with {estimated}: leave out one of them"));
        }
    }
    if matches!(raw.drive.kind, DriveKind::None | DriveKind::Replay) || !raw.camera.source.closes_the_loop() {
        check.wrong(
            "servo.interaction",
            "is \"estimated\", which learns from an arm that moves before the camera",
        );
    }
    if raw.run.task != Task::Servo {
        check.wrong("servo.interaction", "is \"estimated\": a calibration needs a law that is computed");
    }
    let i = camera?.model.intrinsics();
    Some(EstimationSettings {
        f_px: Vector2::new(i.fx_px, i.fy_px),
        size_px: Vector2::new(f64::from(i.width_px), f64::from(i.height_px)),
        tolerance_px: raw.goal.feature_error_px,
    })
}
