//! `[servo]`: from keys to a servo law, its gains and its set-point.

use super::Camera;
use super::check::Validation;
use super::estimation::{estimation, is_asked_for};
use super::gains::{GAIN_1_S, law};
use super::goal_path::path;
use super::raw::{
    Depth, DriveKind, Gains, PoseFrom, RawConfig, RawServo, SceneMotionKind, SchemeKind, SetPointKind,
};
use super::selection::selection;
use crate::drive::CommandMode;
use crate::geometry::Pose;
use crate::messages::MAX_JOINTS;
use crate::servo::{
    Law, ObjectDynamics, OperationalSpace, Selection, ServoSettings, SetPoint, UpdatePolicy, VisibilityGuard,
};
use crate::target::Target;
use crate::time::SpanNs;
use nalgebra::{Vector2, Vector3};

/// Mean delay of a law output that is held between measurements, frames: between half and a whole one, as
/// [`ServoSettings::held_lag`] says. Chosen.
const HELD_FOR: f64 = 0.75;

/// Least bound on the first motion, m/s. Chosen by hand: its centimetre takes a third of a run of 30 s.
const SLOWEST_FIRST_MOTION_M_S: f64 = 0.001;

/// How far a rotation may tilt the target against the image with m = 4: angles that a file has with six decimals must pass.
const TILT: f64 = 1e-6;

/// The law and the set-point, as far as they do not depend on scene and joints; `None` when they cannot be built.
pub(super) fn servo(
    raw: &RawConfig,
    (target, camera): (&Target, Option<&Camera>),
    X_DO: &Pose,
    check: &mut Validation<'_>,
) -> Option<(ServoSettings, SetPoint)> {
    let s = &raw.servo;
    let before = check.count_problems();
    let (points, ids): (Vec<_>, Vec<_>) = target.features().map(|point| (point.p_O, point.id)).unzip();
    let selection = selection(s, points.len(), check);
    let law = law(s, selection.as_ref().map(Selection::numbers), check);
    features_in_view(s, check);
    if !target.is_flat() {
        in_space(raw, selection.as_ref(), check);
    }
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
            let needs_pose = !is_asked_for(raw);
            if found.as_ref().is_none_or(|found| needs_pose && found.X_DO().is_none()) {
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
    let further = raw.scene.objects.values().filter_map(|object| object.motion.as_ref());
    let at_rest = further.chain([&raw.scene.motion]).all(|motion| motion.kind == SceneMotionKind::Still);
    if s.depth == Depth::Known && !(raw.camera.source.is_simulated() && at_rest) {
        check.wrong("servo.depth", "`known` needs a simulated scene with targets at rest");
    }
    let lead_ms = s.lead_ms.map_or(0.0, |ms| check.range("servo.lead_ms", ms, 0.0..=500.0));
    let smooth = check.range("servo.smooth_start_1_s", s.smooth_start_1_s, 0.0..=1000.0);
    let first = check.range("servo.first_motion_m_s", s.first_motion_m_s, 0.0..=10.0);
    if first > 0.0 && first < SLOWEST_FIRST_MOTION_M_S {
        check.wrong(
            "servo.first_motion_m_s",
            "must be 0, for no bound, or at least 0.001 m/s: a centimetre takes 10 s then",
        );
    }
    let avoid = check.range("servo.limit_avoidance_1_s", s.limit_avoidance_1_s, 0.0..=100.0);
    let object = object(s, check);
    let visibility = visibility(s, target, camera, check);
    let path = path(raw, X_DO, check);
    let estimation = estimation(raw, camera, selection.as_ref(), check);
    let search_s = check.range("servo.search_s", s.search_s, 0.0..=60.0);
    let calm = check.range("servo.gain_at_goal_1_s", s.gain_at_goal_1_s, GAIN_1_S);
    if check.count_problems() > before {
        return None;
    }
    let (camera, set_point) = (camera?, set_point?.with_ids(&ids)?.with_selection(selection?)?);
    let settings = ServoSettings {
        gain_at_goal_1_s: calm,
        smooth_start_1_s: (smooth > 0.0).then_some(smooth),
        first_motion_m_s: (first > 0.0).then_some(first),
        lead: SpanNs::from_s(lead_ms * 1e-3),
        limit_avoidance_1_s: (avoid > 0.0).then_some(avoid),
        returns: s.return_to_last_seen,
        search: (search_s > 0.0).then(|| SpanNs::from_s(search_s)),
        visibility,
        object,
        path,
        estimation,
        held_lag: SpanNs::from_s(camera.latency.as_s() + HELD_FOR / camera.rate_hz),
        ..ServoSettings::new(law, s.update, camera.mount)
    };
    Some((settings, set_point))
}

/// What takes a target in one plane, of a target with points in space.
fn in_space(raw: &RawConfig, selection: Option<&Selection>, check: &mut Validation<'_>) {
    let s = &raw.servo;
    const FLAT: &str = "needs a target whose points lie in one plane, not target.kind = \"points\"";
    if s.scheme == SchemeKind::Hybrid {
        check.wrong("servo.scheme", format!("`hybrid` goes by the homography of a plane, and {FLAT}"));
    } else if s.dimension == 4 && uses_dimension(s.scheme) {
        check.wrong("servo.dimension", format!("is 4, which {FLAT}"));
    }
    if s.pose_from == PoseFrom::Homography {
        check.wrong("servo.pose_from", format!("is `homography`, which {FLAT}"));
    }
    if selection.is_some_and(Selection::needs_outline) {
        check.wrong("servo.area", FLAT);
    }
    if s.set_point.kind == SetPointKind::Features && !is_asked_for(raw) {
        check.wrong("servo.set_point.kind", format!("`features` {FLAT}; use `pose` or `taught`"));
    }
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
        mark_radius_m: target.dot_radius_m(),
        rate_1_s,
        acceleration: [f64::INFINITY; MAX_JOINTS], // the arm is validated later
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

/// Product of a held law's gain and the age of its views above which it is doubtful: latency and a whole frame under `frame`, three quarters of one under `tick`. `e' = -k e(t - d)` overshoots from
/// `k d = 1/e` on, and limits of acceleration add to the delay. Measured with 465 runs of UR5, Panda, xArm7 and SCARA (240 on a grid, gain 1.5 to 15, latency 0 to 80 ms, 25 and 60 Hz; 145 drawn ones, 15 to 90 Hz, to
/// 120 ms; 80 at short latencies): up to it none overshot by more than 9 %, from 0.31 on an xArm7 by 30 to 50 %, from 0.42 on all arms of six joints by 28 % and more.
const HELD_GAIN: f64 = 0.3;
/// The product that is advised. Chosen by hand, a little below.
const HELD_GAIN_ADVISED: f64 = 0.25;

/// Warns of a gain that is too high for a law that is not computed for the view of now.
pub(super) fn doubtful_held_gain(
    servo: &ServoSettings,
    s: &RawServo,
    camera: &Camera,
    check: &mut Validation<'_>,
) {
    let (Gains::One(gain_1_s), false, false) =
        (&s.gain_1_s, servo.update == UpdatePolicy::Predict, servo.law.is_torque())
    else {
        return;
    };
    let frames = if servo.update == UpdatePolicy::Frame { 1.0 } else { HELD_FOR };
    let age_s = camera.latency.as_s() + frames / camera.rate_hz;
    if gain_1_s * age_s > HELD_GAIN {
        let message = format!(
            "{gain_1_s} 1/s is too much for views that are {:.0} ms old, as they are where servo.update is not predict: the arm may \
             overshoot by a tenth of its way and more, or swing; take servo.update = \"predict\", or a gain of {:.2} 1/s",
            age_s * 1e3,
            HELD_GAIN_ADVISED / age_s
        );
        check.doubtful("servo.gain_1_s", message);
    }
}

/// Warns of torques by a pose in six numbers before an arm of fewer joints: what is wrong with its measured tilt, which the arm cannot follow, the law takes for
/// a displacement of the camera, by the distance of the target times it. Resolved velocities go by the image instead (`TwistWeights::Image`).
pub(super) fn doubtful_dimension(law: &Law, set_point: &SetPoint, joints: usize, check: &mut Validation<'_>) {
    let six = matches!(law, Law::PositionTorque { space: OperationalSpace::Six, .. });
    let level = set_point.X_DO().is_some_and(|X_DO| !tilted(X_DO));
    if six && level && (4..6).contains(&joints) {
        let message = format!(
            "is 6, and the arm has {joints} joints: it cannot follow the tilt of the measured pose, and what is wrong with that moves the camera aside, \
             by the distance of the target times the angle; with 4 the tilt is not estimated"
        );
        check.doubtful("servo.dimension", message);
    }
}

/// Whether the scheme is computed with m = 4 or 6 by `servo.dimension`; the image-based ones follow the joints.
pub(super) fn uses_dimension(scheme: SchemeKind) -> bool {
    !matches!(scheme, SchemeKind::ImagePd | SchemeKind::ImageResolvedVelocity)
}

/// Whether the pose shows the target's plane tilted against the image.
pub(super) fn tilted(X_CO: &Pose) -> bool {
    (X_CO.rotation * Vector3::z() - Vector3::z()).norm() > TILT
}
