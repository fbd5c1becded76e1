//! The tables of the drive.

use super::start::load;
use crate::config::check::Validation;
use crate::config::frame_source::SourceKind;
use crate::config::raw::{DriveKind, RawConfig, RawSimulated, SchemeKind, Task, TorquePart};
use crate::config::{DriveProgram, DriveSettings, SimulatedArm};
use crate::drive::{
    CommandMode, HardFriction, InnerServo, Jam, MAX_DELAY, Push, ShakingBase, Surroundings, TorqueContents,
    TorqueRipple, Wall,
};
use crate::input::used;
use crate::robot::{Inertia, RobotDescription};
use crate::time::SpanNs;
use nalgebra::{Unit, Vector3};

/// Checks `[drive]`; where the robot is not known, lists are not expanded to its joints.
pub(super) fn drive(
    raw: &RawConfig,
    robot: Option<&RobotDescription>,
    check: &mut Validation<'_>,
) -> DriveSettings {
    let (d, s) = (&raw.drive, &raw.drive.simulated);
    let joints = robot.map(RobotDescription::joint_count);
    let simulated = SimulatedArm {
        substeps: check.count("drive.simulated.substeps", s.substeps, 1..=100),
        friction: s.friction,
        hard_friction: hard_friction(s, check),
        untold_coulomb_share: check.range(
            "drive.simulated.untold_coulomb_share",
            s.untold_coulomb_share,
            0.0..=0.5,
        ),
        friction_spread: check.range("drive.simulated.friction_spread", s.friction_spread, 0.0..=0.9),
        untold_rotor_share: check.range(
            "drive.simulated.untold_rotor_share",
            s.untold_rotor_share,
            0.0..=100.0,
        ),
        wind_up: Some(check.range(
            "drive.simulated.joint_wind_up_rad_or_m",
            s.joint_wind_up_rad_or_m,
            0.0..=0.1,
        ))
        .filter(|wind_up| *wind_up > 0.0),
        ripple: ripple(s, check),
        base: base(s, check),
        effort_limits: s.effort_limits,
        tells_torque: s.tells_torque,
        command_delay_ticks: check.count(
            "drive.simulated.command_delay_ticks",
            s.command_delay_ticks,
            0..=MAX_DELAY as u32,
        ) as usize,
        encoder_step: list("drive.simulated.encoder_step_rad_or_m", &s.encoder_step_rad_or_m, joints, check),
        encoder_noise_sd: list(
            "drive.simulated.encoder_noise_sd_rad_or_m",
            &s.encoder_noise_sd_rad_or_m,
            joints,
            check,
        ),
        velocity_filter_hz: check.range(
            "drive.simulated.velocity_filter_hz",
            s.velocity_filter_hz,
            1.0..=10_000.0,
        ),
        payload: payload(s, check),
        servo: InnerServo {
            natural_frequency_rad_s: check.range(
                "drive.simulated.servo_natural_frequency_rad_s",
                s.servo_natural_frequency_rad_s,
                1.0..=300.0,
            ),
        },
        surroundings: surroundings(s, joints, check),
    };
    let answer_timeout_s =
        check.range("drive.external.answer_timeout_s", d.external.answer_timeout_s, 0.1..=3600.0);
    let connect_timeout_s =
        check.range("drive.external.connect_timeout_s", d.external.connect_timeout_s, 0.1..=3600.0);
    if d.kind == DriveKind::External {
        let e = &d.external;
        check.program("drive.external.command", &e.command, "drive.external.folder", &e.folder);
        if !raw.camera.source.closes_the_loop() {
            check.wrong("drive.kind", "replayed images do not show the arm: no external drive can be moved");
        }
    }
    let external = DriveProgram {
        command: d.external.command.clone(),
        folder: d.external.folder.clone(),
        answer_timeout: SpanNs::from_s(answer_timeout_s),
        connect_timeout: SpanNs::from_s(connect_timeout_s),
    };
    let mode = mode(raw, check);
    DriveSettings {
        kind: d.kind,
        mode,
        period: None,
        torque_contains: torque_contains(raw, mode, check),
        simulated,
        external,
        recording: d.replay.recording.clone(),
    }
}

/// What commanded torques contain: all that the arm needs, unless a robot adds some of it by itself.
fn torque_contains(raw: &RawConfig, mode: CommandMode, check: &mut Validation<'_>) -> TorqueContents {
    let told = &raw.drive.torque_contains;
    let contents = TorqueContents {
        gravity: told.contains(&TorquePart::Gravity),
        friction: told.contains(&TorquePart::Friction),
    };
    let is_taken = raw.drive.kind == DriveKind::External && mode == CommandMode::Torque;
    if contents != TorqueContents::WHOLE && !is_taken {
        check.wrong(
            "drive.torque_contains",
            "only an external drive in mode torque adds torques by itself: leave it out, or set drive.kind = \"external\" and drive.mode = \"torque\"",
        );
    }
    contents
}

/// The load of the simulated arm.
fn payload(s: &RawSimulated, check: &mut Validation<'_>) -> Inertia {
    let before = check.count_problems();
    let mass = check.range("drive.simulated.payload_kg", s.payload_kg, 0.0..=1000.0);
    let com = Vector3::from_fn(|i, _| {
        let key = format!("drive.simulated.payload_com_m[{i}]");
        s.payload_com_m.get(i).map_or(0.0, |v| check.range(&key, *v, -10.0..=10.0))
    });
    if check.count_problems() > before {
        return Inertia::ZERO;
    }
    load(mass, com, ("drive.simulated.payload_inertia_kg_m2", &s.payload_inertia_kg_m2), check)
}

/// Torque ripple, where it is requested.
fn ripple(s: &RawSimulated, check: &mut Validation<'_>) -> Option<TorqueRipple> {
    let share = check.range("drive.simulated.torque_ripple_share", s.torque_ripple_share, 0.0..=0.5);
    let per_rad_or_m =
        check.range("drive.simulated.torque_ripples_per_rad_or_m", s.torque_ripples_per_rad_or_m, 0.1..=1e4);
    (share > 0.0).then_some(TorqueRipple { share, per_rad_or_m, seed: 0 })
}

/// A base that shakes, where it is requested.
fn base(s: &RawSimulated, check: &mut Validation<'_>) -> Option<ShakingBase> {
    let amplitude_B = Vector3::from_fn(|i, _| {
        let key = format!("drive.simulated.base_acceleration_m_s2[{i}]");
        s.base_acceleration_m_s2.get(i).map_or(0.0, |v| check.range(&key, *v, -50.0..=50.0))
    });
    let frequency_hz = check.range("drive.simulated.base_frequency_hz", s.base_frequency_hz, 0.01..=200.0);
    (amplitude_B.amax() > 0.0).then_some(ShakingBase { amplitude_B, frequency_hz, seed: 0 })
}

/// Stick-slip friction, where it is requested.
fn hard_friction(s: &RawSimulated, check: &mut Validation<'_>) -> Option<HardFriction> {
    let hard = HardFriction {
        static_ratio: check.range(
            "drive.simulated.static_friction_ratio",
            s.static_friction_ratio,
            1.0..=3.0,
        ),
        stribeck_speed: check.range(
            "drive.simulated.stribeck_speed_rad_s_or_m_s",
            s.stribeck_speed_rad_s_or_m_s,
            1e-4..=1.0,
        ),
    };
    s.hard_friction.then_some(hard)
}

/// `[drive.simulated.wall]`, `push` and `jam`.
fn surroundings(s: &RawSimulated, joints: Option<usize>, check: &mut Validation<'_>) -> Surroundings {
    let mut vector = |key: &str, value: &[f64; 3], most: f64| {
        Vector3::from_fn(|i, _| check.range(&format!("drive.simulated.{key}[{i}]"), value[i], -most..=most))
    };
    let wall = s.wall.as_ref().map(|wall| {
        let point_B = vector("wall.point_m", &wall.point_m, 100.0);
        (point_B, vector("wall.normal", &wall.normal, 1e3))
    });
    let force_B = s.push.as_ref().map(|push| vector("push.force_n", &push.force_n, 1e4));
    let mut range =
        |key: &str, value, allowed| check.range(&format!("drive.simulated.{key}"), value, allowed);
    let wall = s.wall.as_ref().zip(wall).map(|(raw, (point_B, normal))| Wall {
        point_B,
        normal_B: Unit::new_normalize(normal),
        stiffness: range("wall.stiffness_n_m", raw.stiffness_n_m, 1.0..=1e5),
        damping: range("wall.damping_n_s_m", raw.damping_n_s_m, 0.0..=1e3),
    });
    let push = s.push.as_ref().zip(force_B).map(|(push, force_B)| Push {
        force_B,
        during_s: (
            range("push.from_s", push.from_s, 0.0..=1e5),
            range("push.until_s", push.until_s, push.from_s..=1e5),
        ),
    });
    let jam = s
        .jam
        .as_ref()
        .map(|jam| Jam { joint: jam.joint as usize, from_s: range("jam.from_s", jam.from_s, 0.0..=1e5) });
    if wall.is_some_and(|wall| !wall.normal_B.iter().all(|x| x.is_finite())) {
        check.wrong("drive.simulated.wall.normal", "has no direction");
    }
    if let (Some(jam), Some(joints)) = (jam, joints)
        && jam.joint >= joints
    {
        check.wrong("drive.simulated.jam.joint", format!("the arm's joints are 0 to {}", joints - 1));
    }
    Surroundings { wall, push, jam }
}

/// Settings that are not available where `drive.kind` is `none`.
pub(super) fn without_arm(raw: &RawConfig, check: &mut Validation<'_>) {
    if raw.run.serve {
        check.wrong("run.serve", "has nothing to tell an arm: drive.kind is `none`; use vservo run");
    }
    if raw.run.task != Task::Servo {
        check.wrong("drive.kind", "is `none`: to calibrate, an arm must move");
    }
    if matches!(raw.servo.scheme, SchemeKind::PositionPd | SchemeKind::ImagePd) {
        check.wrong(
            "servo.scheme",
            "commands torques, which say nothing without an arm: with drive.kind = \"none\" use \
             position_resolved_velocity, image_resolved_velocity or hybrid",
        );
    }
}

/// What a recorded arm needs, and what is not available with it, since it obeys nothing.
pub(super) fn with_recorded_arm(raw: &RawConfig, check: &mut Validation<'_>) {
    let recording = &raw.drive.replay.recording;
    if recording.as_os_str().is_empty() {
        check.wrong(
            "drive.replay.recording",
            "is missing: name the recording whose joint states are replayed",
        );
    } else if !recording.is_file() {
        check.wrong("drive.replay.recording", format!("{} is not a file", recording.display()));
    } else {
        used::note_path(recording);
    }
    if raw.run.serve {
        check.wrong("run.serve", "has nothing to tell an arm: drive.kind is `replay`; use vservo run");
    }
    if raw.run.task != Task::Servo {
        check.wrong("drive.kind", "is `replay`: to calibrate, an arm must move as it is told");
    }
    let cameras = if raw.cameras.is_empty() { vec![&raw.camera] } else { raw.cameras.iter().collect() };
    for camera in cameras {
        let is_recorded = !camera.replay.recording.as_os_str().is_empty();
        match camera.source {
            SourceKind::Synthetic => {}
            SourceKind::Replay if is_recorded => {
                if camera.replay.repeat {
                    check.wrong("camera.replay.repeat", "the arm of drive.kind = \"replay\" moves once");
                }
            }
            _ => check.wrong(
                "camera.source",
                "does not show the motion of the recorded arm (drive.kind = \"replay\"): use `replay` with \
                 camera.replay.recording, or `synthetic`",
            ),
        }
    }
}

/// The requested command mode, if the kind of drive supports it. An external drive reports the modes that it supports when
/// it is connected.
fn mode(raw: &RawConfig, check: &mut Validation<'_>) -> CommandMode {
    let ideal = raw.drive.kind == DriveKind::Ideal;
    let default = if ideal { CommandMode::Position } else { CommandMode::Torque };
    let mode = raw.drive.mode.unwrap_or(default);
    if ideal && mode == CommandMode::Torque {
        check.wrong(
            "drive.mode",
            "an ideal drive has no dynamics and takes no torque: use position or velocity, or drive.kind = \"simulated\"",
        );
    }
    let measures = raw.drive.kind == DriveKind::External;
    if raw.run.task == Task::CalibrateLoad && mode != CommandMode::Torque && !measures {
        let message = format!(
            "is `{}`: no torques are commanded, and this drive measures none, so that the load does not show; use torque, or an external drive \
             whose states carry torques",
            mode.as_str()
        );
        check.wrong("drive.mode", message);
    }
    mode
}

fn list(key: &str, values: &[f64], joints: Option<usize>, check: &mut Validation<'_>) -> Vec<f64> {
    for (i, v) in values.iter().enumerate() {
        check.range(&format!("{key}[{i}]"), *v, 0.0..=0.1);
    }
    match (values, joints) {
        ([one], Some(joints)) => vec![*one; joints],
        (list, Some(joints)) if list.len() != joints => {
            check.wrong(key, format!("has {} entries, needs 1 or {joints}", list.len()));
            Vec::new()
        }
        (list, _) => list.to_vec(),
    }
}
