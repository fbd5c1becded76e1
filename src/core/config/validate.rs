//! Validation of a run file: conditions on single values and on combinations; all violations are reported, not only the first one.

mod camera;
mod drive;
mod faults;
mod held_torque;
mod law_strength;
mod lens;
mod motion;
mod mount;
mod names;
mod no_effect;
mod scene_motion;
mod start;
mod truth;
mod workspace;

use super::check::Validation;
use super::estimation::is_asked_for;
use super::raw::{
    Carrier, Clock, DriveKind, MountKind, RawConfig, RealtimePolicy, SchemeKind, SetPointKind, Task,
};
use super::selection::doubtful_features;
use super::servo::{doubtful_dimension, doubtful_held_gain, servo};
use super::stereo::stereo;
use super::target::target;
use super::targets::further_targets;
use super::{Camera, Config, Document, GoalTolerance, Problem, Realtime, RealtimeRequest, Safety, Start};
use crate::control::safety::ContactReaction;
use crate::drive::CommandMode;
use crate::mission::requests::{HOLD_S, TOLERANCE_PX};
use crate::robot::RobotDescription;
use crate::scene::SceneMotion;
use crate::servo::ServoSettings;
use crate::time::{SpanNs, TICK};
use crate::vision::{PoseApproach, VisionSettings};
pub(super) use start::START;
use std::ops::RangeInclusive;

/// Bytes of frames that may be on their way at once, so that a lockstep run leaves room in a usual /dev/shm. Chosen.
const MAX_FRAME_BYTES_IN_FLIGHT: f64 = 512e6;

/// Chosen by hand: no measurement could meet less than a tick, 1 ms, and an arm that waits for a minute is taken for one that stands.
const MEASUREMENT_TIMEOUT_MS: RangeInclusive<f64> = 1.0..=60_000.0;
/// Chosen by hand: a guardian asks after 5 ms whether control is suspended or dead, and looks each millisecond; upwards as for measurements.
const GUARDIAN_TIMEOUT_MS: RangeInclusive<f64> = 8.0..=60_000.0;
/// Cores that the kernel's set of them has places for.
const MAX_CPUS: u32 = 1024;
/// Distance of a joint from its reference at which a run ends, rad or m, before a drive without a lag. Chosen by hand: ten times what loads and friction do to a good loop.
const MAX_TRACKING_ERROR_RAD_OR_M: f64 = 0.1;

/// Checks everything; `None` only where something is so wrong that a part cannot be built. `views`: also whether the target is in the
/// image at start and goal.
pub(super) fn validate(
    mut raw: RawConfig,
    document: &Document,
    views: bool,
    problems: &mut Vec<Problem>,
) -> Option<Config> {
    let mut check = Validation::new(document, problems);
    let check = &mut check;

    let duration = SpanNs::from_s(check.range("run.duration_s", raw.run.duration_s, 0.01..=86_400.0));
    let goal = GoalTolerance {
        feature_error_px: check.range("goal.feature_error_px", raw.goal.feature_error_px, TOLERANCE_PX),
        hold: SpanNs::from_s(check.range("goal.hold_s", raw.goal.hold_s, HOLD_S)),
        is_taught: raw.servo.set_point.kind == SetPointKind::Taught,
        measurements: raw.servo.set_point.measurements,
    };
    let (mut camera, mut further_cameras) = camera::cameras(&mut raw, document, check)
        .map_or((None, Vec::new()), |(first, rest)| (Some(first), rest));
    let target = target("target", &raw.target, check);
    let object = &raw.scene.object;
    let carrier = match raw.camera.mount.kind {
        MountKind::EyeInHand => Carrier::Base,
        MountKind::EyeToHand => Carrier::Flange,
    };
    if raw.camera.source.is_simulated() && object.on != carrier {
        check.wrong(
            "scene.object.on",
            "eye_in_hand needs a target on the `base`, eye_to_hand one on the `flange`: otherwise the arm would run away",
        );
    }
    if let Some(why) = raw.camera.source.timing().refusal(raw.run.clock) {
        check.wrong("run.clock", why);
    }
    let scene_motion = scene_motion::scene_motion("scene.motion", &raw.scene.motion, check);
    if raw.run.serve && raw.run.task != Task::Servo {
        check.wrong("run.serve", "needs run.task = \"servo\"");
    }
    if raw.run.serve && !raw.camera.source.closes_the_loop() {
        check.wrong("run.serve", "needs a camera that sees the arm's own motion: camera.source is `replay`");
    }
    let obeys = !matches!(raw.drive.kind, DriveKind::None | DriveKind::Replay);
    let moves_an_arm = raw.camera.source.closes_the_loop() && obeys;
    if !raw.servo.path.poses.is_empty() && !moves_an_arm {
        check.wrong("servo.path", "needs an arm that moves, and a camera that sees its motion");
    }
    if raw.servo.scheme == SchemeKind::LookAndMove && !moves_an_arm {
        check.wrong(
            "servo.scheme",
            "look_and_move has no law whose output could be shown: it needs an arm that moves, and a camera that sees its motion",
        );
    }
    if raw.drive.kind == DriveKind::None {
        drive::without_arm(&raw, check);
    }
    if raw.drive.kind == DriveKind::Replay {
        drive::with_recorded_arm(&raw, check);
    }
    if raw.run.task != Task::Servo {
        if !raw.camera.source.closes_the_loop() {
            check.wrong(
                "camera.source",
                "is `replay`: to calibrate, the camera must see the arm's own motion",
            );
        }
        if scene_motion != SceneMotion::Still {
            check.wrong("scene.motion.kind", "must be `still` during a calibration");
        }
    }
    let desired = &raw.servo.desired;
    let X_DO = check.pose("servo.desired", desired.position_m, desired.rotation_rpy_rad);
    let stereo = stereo(&raw, (camera.as_ref(), &further_cameras), (target.as_ref(), &X_DO), check);
    let servo = target.as_ref().and_then(|target| servo(&raw, (target, camera.as_ref()), &X_DO, check));
    let first_law = servo.as_ref().map(|(servo, _)| &servo.law);
    let further_targets = further_targets(&raw, (&X_DO, first_law), check);
    let safety = Safety {
        measurement_timeout: check.span_ms(
            "safety.measurement_timeout_ms",
            raw.safety.measurement_timeout_ms,
            MEASUREMENT_TIMEOUT_MS,
        ),
        slow_down_from: check.range("safety.slow_down_from", raw.safety.slow_down_from, 0.0..=1.0),
        max_missed_in_a_row: check
            .count(
                "safety.max_missed_deadlines_in_a_row",
                raw.safety.max_missed_deadlines_in_a_row,
                1..=60_000,
            )
            .into(),
        drive_timeout: check.span_ms("safety.drive_timeout_ms", raw.safety.drive_timeout_ms, 2.0..=10_000.0),
        max_tracking_error: check.range(
            "safety.max_tracking_error_rad_or_m",
            raw.safety.max_tracking_error_rad_or_m.unwrap_or(MAX_TRACKING_ERROR_RAD_OR_M),
            1e-4..=10.0,
        ),
        contact: raw.safety.contact,
        reduced_speed_share: check.range(
            "safety.reduced_speed_share",
            raw.safety.reduced_speed_share,
            0.01..=1.0,
        ),
        resume: raw.safety.resume,
        guardian: raw.safety.guardian,
        guardian_timeout: check.span_ms(
            "safety.guardian_timeout_ms",
            raw.safety.guardian_timeout_ms.unwrap_or_else(|| guardian_timeout_ms(&raw)),
            GUARDIAN_TIMEOUT_MS,
        ),
    };
    if let Some(cpu) = raw.realtime.cpu {
        check.count("realtime.cpu", cpu, 0..=MAX_CPUS - 1);
    }
    let vision = VisionSettings {
        track: raw.vision.track,
        model_sd_px: check.range("vision.model_sd_px", raw.vision.model_sd_px, 0.0..=10.0),
        pose: raw.vision.pose,
        lens_is_known: !is_asked_for(&raw),
        response: camera.as_ref().map(|camera| camera.response).unwrap_or_default(),
        ..VisionSettings::default()
    };
    if let Some(target) = target.as_ref().filter(|target| !target.is_flat()) {
        if raw.vision.pose == PoseApproach::Analytical {
            let message = format!(
                "is `analytical`, by the homography of a plane: the {} points of this target do not lie in one; use `both` or `iterative`",
                target.points().len()
            );
            check.wrong("vision.pose", message);
        }
        if raw.run.task != Task::Servo {
            check
                .wrong("target.kind", "is `points`: to calibrate, the camera must see a target in one plane");
        }
    }
    let priority = check.count("realtime.priority", raw.realtime.priority, 1..=98);
    let spin_us = raw.realtime.spin_us.map(|us| check.range("realtime.spin_us", us, 0.0..=500.0));
    let start_tolerance =
        check.range("robot.start_tolerance_rad_or_m", raw.robot.start_tolerance_rad_or_m, 1e-6..=10.0);
    let before_arm = check.count_problems();
    let robot = start::arm(&raw, check);
    if let (Some((servo, set_point)), Some(robot)) = (&servo, &robot) {
        let all = robot.joint_count();
        let joints = camera.as_ref().map_or(all, |camera| camera.mount.moving_joints(all));
        doubtful_features(&servo.law, set_point, joints, check);
        if raw.stereo.is_none() && raw.servo.scheme != SchemeKind::LookAndMove {
            doubtful_dimension(&servo.law, set_point, joints, check);
        }
        if let Some(camera) = &camera {
            mount::beyond_the_camera(&raw, (&camera.mount, robot), (&servo.law, set_point), check);
        }
    }
    let drive = drive::drive(&raw, robot.as_ref(), check);
    names::named_goals(&raw, robot.as_ref().map(RobotDescription::joint_count), check);
    let faults = faults::faults(&raw, robot.as_ref().map(RobotDescription::joint_count), check);
    faults::give(&faults, raw.run.seed, camera.iter_mut().chain(&mut further_cameras));
    if safety.contact == ContactReaction::Float && drive.mode != CommandMode::Torque {
        let message = format!(
            "is `float`: a drive that obeys {} cannot let the arm be moved by hand; use `release`",
            drive.mode
        );
        check.wrong("safety.contact", message);
    }
    let motion = motion::motion(&raw, (drive.mode, &drive.simulated), robot.as_ref(), check);
    let mount = camera.as_ref().map(|camera| &camera.mount);
    let workspace = workspace::workspace(&raw, robot.as_ref(), mount, check);
    let arm_is_good = check.count_problems() == before_arm;
    if let (Some(robot), Some(workspace), true) = (&robot, &workspace, arm_is_good && views) {
        workspace::start(&raw, robot, workspace, check);
    }
    let believed = (camera.as_ref(), target.as_ref(), robot.as_ref());
    let scene = truth::scene(&raw, believed, further_targets.as_deref(), scene_motion, check);
    if let (Some(target), Some(camera), false) = (&target, &camera, check.misses_a_pose()) {
        // A learnt Jacobian goes by a taught view alone.
        let taught = is_asked_for(&raw);
        if let Some(hidden) = start::hidden(target, &camera.model, &X_DO).filter(|_| views && !taught) {
            let message = format!(
                "point {} would lie {} in the desired view{}",
                hidden.point, hidden.why, hidden.how_far
            );
            check.wrong("servo.desired", message);
        }
        if let Some(path) = servo.as_ref().and_then(|(servo, _)| servo.path.as_ref()).filter(|_| views) {
            start::path_view(target, &camera.model, path, check);
        }
        if let (Some(robot), Some(scene), true) = (&robot, &scene, arm_is_good) {
            start::view(&raw, robot, (camera, scene), views, check);
        }
        timing(&raw, camera, check);
        if let Some((servo, _)) = &servo {
            doubtful_held_gain(servo, &raw.servo, camera, check);
            if let (Some(robot), true) = (&robot, arm_is_good) {
                let arm = (robot, raw.robot.q_start_rad_or_m.as_slice());
                held_torque::doubtful_held_damping(servo, arm, camera, check);
                law_strength::doubtful_strength(&servo.law, &raw.servo.pd, arm, camera, check);
            }
        }
    }

    doubtful_hold(&raw, check);
    no_effect::without_effect(&raw, check);

    let (servo, set_point) = servo?;
    let mut servo = ServoSettings {
        X_WO: scene.iter().flat_map(|scene| scene.places().map(|(X_WO, _)| X_WO)).collect(),
        watches_drift: motion.encoder_step.iter().any(|step| *step > 0.0),
        ..servo
    };
    let before_camera = camera.as_ref()?.mount.moving_joints(robot.as_ref()?.joint_count());
    if before_camera < 6 {
        servo.law.weigh_by_image();
    }
    if let Some(guard) = &mut servo.visibility {
        let radii = further_targets.iter().flatten().map(|further| further.target.dot_radius_m());
        guard.mark_radius_m = radii.fold(guard.mark_radius_m, f64::max);
        guard.acceleration.iter_mut().zip(&motion.max_acceleration).for_each(|(own, limit)| *own = *limit);
    }
    Some(Config {
        task: raw.run.task,
        clock: raw.run.clock,
        duration,
        seed: raw.run.seed,
        goal,
        robot: robot?,
        tool: start::body(raw.tool.mass_kg, raw.tool.com_m.into(), raw.tool.inertia_kg_m2),
        serve: raw.run.serve,
        start: Start {
            q: raw.robot.q_start_rad_or_m.clone(),
            tolerance: start_tolerance,
            elsewhere: raw.robot.start_elsewhere,
        },
        camera: camera?,
        further_cameras,
        stereo,
        second_view: None, // which is made of all of this
        target: target?,
        further_targets: further_targets?,
        scene,
        vision,
        servo,
        set_point,
        motion,
        workspace,
        drive,
        safety,
        faults,
        realtime: Realtime {
            policy: raw.realtime.policy,
            request: RealtimeRequest {
                priority,
                cpu: raw.realtime.cpu,
                lock_memory: raw.realtime.lock_memory && raw.realtime.policy != RealtimePolicy::Off,
            },
            spin: spin_us.map(|us| SpanNs::from_s(us * 1e-6)),
        },
        warnings: check.take_warnings(),
        effective: raw,
    })
}

/// The silence of a control that runs after which a guardian stops the arm, ms: as long as control itself may miss deadlines.
fn guardian_timeout_ms(raw: &RawConfig) -> f64 {
    let missed = TICK.as_s() * 1e3 * f64::from(raw.safety.max_missed_deadlines_in_a_row);
    missed.clamp(*GUARDIAN_TIMEOUT_MS.start(), *GUARDIAN_TIMEOUT_MS.end())
}

/// Warns of a goal that must be held for longer than the run lasts: an arm that follows a path arrives with its end at the earliest.
fn doubtful_hold(raw: &RawConfig, check: &mut Validation<'_>) {
    let (hold_s, duration_s) = (raw.goal.hold_s, raw.run.duration_s);
    let arrives_s = raw.servo.path.poses.last().map_or(0.0, |pose| pose.t_s);
    let ends_by_goal = raw.run.task == Task::Servo && !raw.run.serve && raw.camera.source.closes_the_loop();
    let has_arm = !matches!(raw.drive.kind, DriveKind::None | DriveKind::Replay);
    if ends_by_goal && has_arm && arrives_s < duration_s && arrives_s + hold_s >= duration_s {
        let message = format!(
            "{hold_s} s are not over before run.duration_s, {duration_s} s{}: the run can never converge; hold the goal for less, or let the run last longer",
            if arrives_s > 0.0 {
                format!(", with the path that ends at {arrives_s} s")
            } else {
                String::new()
            }
        );
        check.doubtful("goal.hold_s", message);
    }
}

fn timing(raw: &RawConfig, camera: &Camera, check: &mut Validation<'_>) {
    let period_s = 1.0 / camera.rate_hz;
    let (timeout_ms, key) = (raw.safety.measurement_timeout_ms, "safety.measurement_timeout_ms");
    if !MEASUREMENT_TIMEOUT_MS.contains(&timeout_ms) {
        return; // which has been reported
    }
    // Between two measurements the newest view grows this old; one lost frame adds a period.
    let age_ms = (period_s + camera.latency.as_s()) * 1e3;
    let age_after_loss_ms = age_ms + (period_s + camera.schedule.jitter().as_s()) * 1e3;
    if timeout_ms <= age_ms {
        let message = format!(
            "{timeout_ms} ms is shorter than a frame period and its latency together ({age_ms:.1} ms): the arm would stop at \
             every frame; raise it above {age_after_loss_ms:.0} ms, where a lost frame does no harm, or raise camera.rate_hz"
        );
        check.wrong(key, message);
    } else if timeout_ms <= age_after_loss_ms {
        let message = format!(
            "{timeout_ms} ms is shorter than two frame periods, latency and jitter together ({age_after_loss_ms:.1} ms): the arm \
             holds whenever a frame is lost or late; raise it above that, or raise camera.rate_hz"
        );
        check.doubtful(key, message);
    } else if raw.safety.slow_down_from * timeout_ms < age_ms {
        let message = format!(
            "{} of {timeout_ms} ms is shorter than a frame period and its latency together ({age_ms:.1} ms): the arm slows down \
             ahead of every frame; raise it or {key}",
            raw.safety.slow_down_from
        );
        check.doubtful("safety.slow_down_from", message);
    }
    if camera.exposure.as_s() > period_s {
        check
            .wrong("camera.exposure_ms", format!("is longer than a frame period ({:.3} ms)", period_s * 1e3));
    }
    if raw.run.clock == Clock::Lockstep {
        let i = camera.model.intrinsics();
        let in_flight = camera.schedule.in_flight() as f64;
        if in_flight * f64::from(i.width_px) * f64::from(i.height_px) > MAX_FRAME_BYTES_IN_FLIGHT {
            let message = "in lockstep, the frames in flight would take more than 512 MB: lower the latency, rate or size";
            check.wrong("camera.latency_ms", message);
        }
    }
}
