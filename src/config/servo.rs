//! `[servo]`: from words and lists to a law and its goal.

use super::Camera;
use super::check::Validation;
use super::raw::{
    DampingOn, Depth, DriveKind, FeatureGain, Gains, RawConfig, RawServo, SceneMotionKind, SchemeKind,
    SetPointKind,
};
use super::selection::selection;
use crate::drive::CommandMode;
use crate::geometry::Pose;
use crate::messages::MAX_JOINTS;
use crate::servo::{
    Damping, DepthSource, FeatureGains, Gain, HybridGains, Interaction, Law, ObjectDynamics,
    OperationalSpace, PoseGains, ServoSettings, SetPoint, UpdatePolicy, VisibilityGuard,
};
use crate::target::Target;
use crate::time::SpanNs;
use nalgebra::{Vector2, Vector3};
use std::ops::RangeInclusive;

/// Ranges wider than any use, chosen, so that a slip is told; `tests/cores/plausible_numbers.rs` tries their ends.
/// Ranges of gains. Chosen by hand: outside of them a number has another unit; whether a gain is stable is a matter of the run.
const GAIN_1_S: RangeInclusive<f64> = 1e-3..=100.0;
const PD_GAIN: RangeInclusive<f64> = 0.0..=1e6;

/// Mean delay of a law output that is held between measurements, frames: between half and a whole one, as
/// [`ServoSettings::held_lag`] says. Chosen.
const HELD_FOR: f64 = 0.75;

/// How far a rotation may tilt the target against the image with m = 4: angles that a file has with six decimals must pass.
const TILT: f64 = 1e-6;

/// The law and the goal, as far as the scene and the joints do not matter; `None` when they cannot be built.
pub(super) fn servo(
    raw: &RawConfig,
    (target, camera): (&Target, Option<&Camera>),
    X_DO: &Pose,
    check: &mut Validation<'_>,
) -> Option<(ServoSettings, SetPoint)> {
    let s = &raw.servo;
    let before = check.count_problems();
    let law = law(s, check);
    let (points, ids): (Vec<_>, Vec<_>) = target.features().map(|point| (point.p_O, point.id)).unzip();
    let selection = selection(s, points.len(), check);
    features_in_view(s, check);
    let set_point = match s.set_point.kind {
        SetPointKind::Pose | SetPointKind::Taught => SetPoint::from_pose(X_DO, &points),
        SetPointKind::Features => {
            let s_d: Vec<_> = s.set_point.features.iter().copied().map(Vector2::from).collect();
            if s_d.len() != points.len() {
                let message = format!("has {} points, the target has {}", s_d.len(), points.len());
                check.wrong("servo.set_point.features", message);
                return None;
            }
            let found = SetPoint::from_features(&s_d, &points, s.constant_depth_m);
            if found.as_ref().is_none_or(|found| found.X_DO().is_none()) {
                check.wrong(
                    "servo.set_point.features",
                    "no pose of the target looks like this: check the order",
                );
            }
            found
        }
    };
    check.count("servo.set_point.measurements", s.set_point.measurements, 1..=10_000);
    if s.dimension == 4 && tilted(X_DO) && uses_dimension(s.scheme) {
        check.wrong("servo.dimension", "is 4, which needs servo.desired to be turned about z only");
    }
    let torque_drive =
        raw.drive.kind != DriveKind::Ideal && raw.drive.mode.is_none_or(|m| m == CommandMode::Torque);
    if law.is_torque() && !torque_drive {
        check.wrong(
            "servo.scheme",
            "position_pd and image_pd command torques: they need drive.mode = \"torque\"",
        );
    }
    let scene_is_known = raw.camera.source.is_simulated() && raw.scene.motion.kind == SceneMotionKind::Still;
    if s.depth == Depth::Known && !scene_is_known {
        check.wrong("servo.depth", "`known` needs a simulated scene with a target at rest");
    }
    let lead_ms = check.range("servo.lead_ms", s.lead_ms, 0.0..=500.0);
    let smooth = check.range("servo.smooth_start_1_s", s.smooth_start_1_s, 0.0..=1000.0);
    let avoid = check.range("servo.limit_avoidance_1_s", s.limit_avoidance_1_s, 0.0..=100.0);
    let object = object(s, check);
    let visibility = visibility(s, target, camera, check);
    let calm = check.range("servo.gain_at_goal_1_s", s.gain_at_goal_1_s, GAIN_1_S);
    if check.count_problems() > before {
        return None;
    }
    let (camera, set_point) = (camera?, set_point?.with_ids(&ids)?.with_selection(selection?)?);
    let settings = ServoSettings {
        gain_at_goal_1_s: calm,
        smooth_start_1_s: (smooth > 0.0).then_some(smooth),
        lead: SpanNs::from_s(lead_ms * 1e-3),
        limit_avoidance_1_s: (avoid > 0.0).then_some(avoid),
        returns: s.return_to_last_seen,
        visibility,
        object,
        held_lag: SpanNs::from_s(camera.latency.as_s() + HELD_FOR / camera.rate_hz),
        ..ServoSettings::new(law, s.update, camera.mount)
    };
    Some((settings, set_point))
}

/// Normalized coordinates are tangents: those of a camera that sees farther to the side than 89 degrees are beyond 57.
fn features_in_view(s: &RawServo, check: &mut Validation<'_>) {
    for (i, feature) in s.set_point.features.iter().enumerate() {
        for (j, coordinate) in feature.iter().enumerate() {
            check.range(&format!("servo.set_point.features[{i}][{j}]"), *coordinate, -57.0..=57.0);
        }
    }
}

fn visibility(
    s: &RawServo,
    target: &Target,
    camera: Option<&Camera>,
    check: &mut Validation<'_>,
) -> Option<VisibilityGuard> {
    let (margin_px, rate_1_s) = (
        check.range("servo.visibility.margin_px", s.visibility.margin_px, 0.0..=1000.0),
        check.range("servo.visibility.rate_1_s", s.visibility.rate_1_s, 0.1..=100.0),
    );
    let guard = VisibilityGuard {
        camera: camera?.model,
        margin_px,
        mark_radius_m: target.discs().iter().map(|disc| disc.radius_m).fold(0.0, f64::max),
        rate_1_s,
    };
    s.visibility.guard.then_some(guard)
}

fn object(s: &RawServo, check: &mut Validation<'_>) -> Option<ObjectDynamics> {
    let acceleration = 1e-4..=100.0;
    let dynamics = ObjectDynamics {
        acceleration_m_s2: check.range(
            "servo.object.acceleration_m_s2",
            s.object.acceleration_m_s2,
            acceleration.clone(),
        ),
        acceleration_rad_s2: check.range(
            "servo.object.acceleration_rad_s2",
            s.object.acceleration_rad_s2,
            acceleration,
        ),
        largest_sd_m: check.range("servo.object.max_uncertainty_m", s.object.max_uncertainty_m, 1e-4..=10.0),
    };
    if s.object.moves && s.update != UpdatePolicy::Predict {
        check.wrong("servo.object.moves", "needs servo.update = \"predict\": the others do not look ahead");
    }
    s.object.moves.then_some(dynamics)
}

/// Whether the scheme is computed with m = 4 or 6 by `servo.dimension`; the image-based ones follow the joints.
pub(super) fn uses_dimension(scheme: SchemeKind) -> bool {
    !matches!(scheme, SchemeKind::ImagePd | SchemeKind::ImageResolvedVelocity)
}

/// Whether the pose shows the target's plane tilted against the image.
pub(super) fn tilted(X_CO: &Pose) -> bool {
    (X_CO.rotation * Vector3::z() - Vector3::z()).norm() > TILT
}

fn law(s: &RawServo, check: &mut Validation<'_>) -> Law {
    let orientation = s.orientation_error;
    let space = match s.dimension {
        4 => OperationalSpace::Four,
        6 => OperationalSpace::Six,
        other => {
            check.wrong("servo.dimension", format!("{other} is neither 4 nor 6"));
            OperationalSpace::Six
        }
    };
    let constant_depth_m = check.range("servo.constant_depth_m", s.constant_depth_m, 1e-3..=1e3);
    let pd = pd_gains(s, check);
    let (K, gain) = velocity_gains(s, check);
    let interaction = Interaction {
        at: s.interaction,
        depth: match s.depth {
            Depth::Desired => DepthSource::Desired,
            Depth::Estimated => DepthSource::Estimated,
            Depth::Known => DepthSource::Known,
            Depth::Initial => DepthSource::Initial,
            Depth::Constant => DepthSource::Constant(constant_depth_m),
        },
    };
    match s.scheme {
        SchemeKind::PositionPd => {
            let damping = match s.pd.damping {
                DampingOn::Task => Damping::Task(pd.K_D),
                DampingOn::Joints => Damping::Joints(pd.joints),
            };
            Law::PositionTorque { K_P: pd.K_P, damping, orientation, space }
        }
        SchemeKind::PositionResolvedVelocity => Law::PositionVelocity { K, gain, orientation, space },
        SchemeKind::ImagePd if s.pd.feature_gain == FeatureGain::Preconditioned => {
            let damping = match s.pd.damping {
                DampingOn::Task => Damping::Task(pd.K_D),
                DampingOn::Joints => Damping::Joints(pd.joints),
            };
            let K_Ps = FeatureGains { K_P: pd.K_P, rest: pd.k_P };
            Law::PreconditionedTorque { K_Ps, damping, interaction }
        }
        SchemeKind::ImagePd => {
            let damping = match s.pd.damping {
                DampingOn::Task => Damping::Task(pd.k_D),
                DampingOn::Joints => Damping::Joints(pd.joints),
            };
            Law::ImageTorque { k_P: pd.k_P, damping, interaction }
        }
        SchemeKind::ImageResolvedVelocity => {
            if matches!(s.gain_1_s, Gains::Each(_)) {
                check.wrong("servo.gain_1_s", "image_resolved_velocity takes one gain; see servo.weights");
            }
            Law::ImageVelocity { gain: scaled(gain, K[0]), interaction }
        }
        SchemeKind::Hybrid => {
            let gains = HybridGains { K_p: K.fixed_rows::<3>(0).into(), K_o: K.fixed_rows::<3>(3).into() };
            Law::Hybrid { gains, gain, orientation, space, depth: interaction.depth }
        }
    }
}

/// Gains of the torque laws A and C.
struct PdGains {
    K_P: PoseGains,
    K_D: PoseGains,
    k_P: f64,
    k_D: f64,
    joints: [f64; MAX_JOINTS],
}

/// All of them, whichever law is used: a wrong number is reported before it is needed.
fn pd_gains(s: &RawServo, check: &mut Validation<'_>) -> PdGains {
    let pd = &s.pd;
    PdGains {
        K_P: pose_gains(
            check,
            ("servo.pd.position_stiffness_n_m", &pd.position_stiffness_n_m),
            ("servo.pd.orientation_stiffness_nm_rad", &pd.orientation_stiffness_nm_rad),
        ),
        K_D: pose_gains(
            check,
            ("servo.pd.position_damping_ns_m", &pd.position_damping_ns_m),
            ("servo.pd.orientation_damping_nms_rad", &pd.orientation_damping_nms_rad),
        ),
        k_P: check.range("servo.pd.feature_stiffness_nm", pd.feature_stiffness_nm, PD_GAIN),
        k_D: check.range("servo.pd.feature_damping_nms", pd.feature_damping_nms, PD_GAIN),
        joints: joint_damping(s, check),
    }
}

/// The gain times `factor`.
fn scaled(gain: Gain, factor: f64) -> Gain {
    match gain {
        Gain::Constant(gain) => Gain::Constant(gain * factor),
        Gain::Adaptive { at_zero_1_s, at_infinity_1_s, slope_1_s } => Gain::Adaptive {
            at_zero_1_s: at_zero_1_s * factor,
            at_infinity_1_s: at_infinity_1_s * factor,
            slope_1_s: slope_1_s * factor,
        },
    }
}

/// Component gains, and the common factor: the adaptive one, or 1.
fn velocity_gains(s: &RawServo, check: &mut Validation<'_>) -> (PoseGains, Gain) {
    let K = match &s.gain_1_s {
        Gains::One(gain) => PoseGains::repeat(check.range("servo.gain_1_s", *gain, GAIN_1_S)),
        Gains::Each(list) => {
            for (i, gain) in list.iter().enumerate() {
                check.range(&format!("servo.gain_1_s[{i}]"), *gain, GAIN_1_S);
            }
            match *list.as_slice() {
                [x, y, z, alpha] => PoseGains::new(x, y, z, alpha, alpha, alpha),
                [x, y, z, a, b, c] => PoseGains::new(x, y, z, a, b, c),
                _ => {
                    check.wrong("servo.gain_1_s", format!("has {} entries, needs 1, 4 or 6", list.len()));
                    PoseGains::repeat(1.0)
                }
            }
        }
    };
    let gain = s.adaptive_gain.as_ref().map_or(Gain::Constant(1.0), |a| Gain::Adaptive {
        at_zero_1_s: check.range("servo.adaptive_gain.at_zero", a.at_zero, 1e-3..=100.0),
        at_infinity_1_s: check.range("servo.adaptive_gain.at_infinity", a.at_infinity, 1e-3..=100.0),
        slope_1_s: check.range("servo.adaptive_gain.slope", a.slope, 0.0..=1e4),
    });
    (K, gain)
}

fn pose_gains(
    check: &mut Validation<'_>,
    position: (&str, &Gains),
    orientation: (&str, &Gains),
) -> PoseGains {
    let mut three = |(key, gains): (&str, &Gains)| match gains {
        Gains::One(gain) => Vector3::repeat(check.range(key, *gain, PD_GAIN)),
        Gains::Each(list) => {
            for (i, gain) in list.iter().enumerate() {
                check.range(&format!("{key}[{i}]"), *gain, PD_GAIN);
            }
            match *list.as_slice() {
                [x, y, z] => Vector3::new(x, y, z),
                _ => {
                    check.wrong(key, format!("has {} entries, needs 1 or 3", list.len()));
                    Vector3::zeros()
                }
            }
        }
    };
    let (p, o) = (three(position), three(orientation));
    PoseGains::new(p.x, p.y, p.z, o.x, o.y, o.z)
}

fn joint_damping(s: &RawServo, check: &mut Validation<'_>) -> [f64; MAX_JOINTS] {
    let key = "servo.pd.joint_damping_nms_rad_or_ns_m";
    let mut damping = [0.0; MAX_JOINTS];
    match &s.pd.joint_damping_nms_rad_or_ns_m {
        Gains::One(gain) => damping = [check.range(key, *gain, PD_GAIN); MAX_JOINTS],
        Gains::Each(list) if list.len() > MAX_JOINTS => {
            check.wrong(key, format!("has {} entries, more than {MAX_JOINTS} joints", list.len()));
        }
        Gains::Each(list) => {
            for (i, (place, gain)) in damping.iter_mut().zip(list).enumerate() {
                *place = check.range(&format!("{key}[{i}]"), *gain, PD_GAIN);
            }
        }
    }
    damping
}
