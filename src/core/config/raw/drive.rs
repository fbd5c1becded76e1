//! `[drive]`: what drives the arm, and what the simulated one has that the controller does not know of.

use crate::drive::CommandMode;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

word! {
    /// Kind of drive.
    DriveKind {
        /// Rigid-body dynamics.
        Simulated,
        /// The joints follow the reference exactly.
        Ideal,
        /// An external process: a simulator, or the driver of a robot.
        External,
        /// An arm that was recorded, for a dry run: it is where it was, whatever it is told.
        Replay,
        /// No arm: nothing moves, and the run reports the twist that the law requests of the camera.
        None,
    }
}

word! {
    /// A part of the torques that an arm needs.
    TorquePart {
        /// What holds the arm's weight.
        Gravity,
        /// What makes up for the friction of the joints.
        Friction,
    }
}

table! {
    /// The arm's drive.
    RawDrive {
        /// Kind of drive.
        kind: DriveKind = DriveKind::Simulated,
        /// What the drive is commanded by; where it is left out: `torque`, for the ideal drive `position`.
        mode: Option<CommandMode> = None,
        /// External drives in mode torque: what the commanded torques contain; the robot adds the rest by itself.
        torque_contains: Vec<TorquePart> = vec![TorquePart::Gravity, TorquePart::Friction],
        /// `[drive.simulated]`
        simulated: RawSimulated = RawSimulated::default(),
        /// `[drive.external]`
        external: RawExternal = RawExternal::default(),
        /// `[drive.replay]`
        replay: RawRecordedDrive = RawRecordedDrive::default(),
    }
}

table! {
    /// Imperfections of the simulated arm that the controller does not know of.
    RawSimulated {
        /// Integration steps (Runge-Kutta of fourth order) in a tick of 1 ms.
        substeps: u32 = 1,
        /// Whether the friction of the robot file acts.
        friction: bool = true,
        /// Whether joints that stand are held until static friction is overcome, and jerk then; else friction changes its sign smoothly.
        hard_friction: bool = false,
        /// Of hard friction: static over Coulomb friction.
        static_friction_ratio: f64 = 1.2,
        /// Of hard friction: speed over which the one becomes the other (Stribeck), rad/s or m/s.
        stribeck_speed_rad_s_or_m_s: f64 = 0.05,
        /// Coulomb friction beyond that of the robot file, as a share of each joint's effort limit.
        untold_coulomb_share: f64 = 0.0,
        /// Spread of the friction over the joints: each has its own times 1 - spread to 1 + spread, by the seed.
        friction_spread: f64 = 0.0,
        /// Inertia of rotors beyond that of the robot file, as a share of each joint's inertia about its axis at the start.
        untold_rotor_share: f64 = 0.0,
        /// Angle or way by which each joint yields to its largest effort, rad or m; 0: the joints are rigid.
        joint_wind_up_rad_or_m: f64 = 0.0,
        /// Amplitude of the ripple of the motors' torques, as a share of each joint's effort limit.
        torque_ripple_share: f64 = 0.0,
        /// Its periods in a radian or metre of the joint.
        torque_ripples_per_rad_or_m: f64 = 30.0,
        /// Amplitude of the acceleration of the base, with target and camera on it, along the axes of B, m/s^2.
        base_acceleration_m_s2: [f64; 3] = [0.0; 3],
        /// Its frequency, Hz.
        base_frequency_hz: f64 = 5.0,
        /// Whether torques are cut at the effort limits of the robot file.
        effort_limits: bool = true,
        /// Whether its states tell the torques of its motors, as those of a drive that measures them do.
        tells_torque: bool = false,
        /// Ticks from the writing of a command to its effect, beside the one in which it is computed.
        command_delay_ticks: u32 = 0,
        /// Step of the joint encoders, rad or m; one value stands for all joints, 0 is exact.
        encoder_step_rad_or_m: Vec<f64> = vec![0.0],
        /// Standard deviation of the encoders' noise, rad or m; one value stands for all joints.
        encoder_noise_sd_rad_or_m: Vec<f64> = vec![0.0],
        /// With steps or noise, velocity is the difference of positions behind a low-pass with this cut-off, Hz.
        velocity_filter_hz: f64 = 100.0,
        /// A load at the flange, kg.
        payload_kg: f64 = 0.0,
        /// Its centre of mass in the flange frame, m.
        payload_com_m: [f64; 3] = [0.0, 0.0, 0.05],
        /// Its moments of inertia about the centre of mass, along the flange's axes: xx, yy, zz, xy, xz, yz, kg m^2.
        payload_inertia_kg_m2: [f64; 6] = [0.0; 6],
        /// Poles of the drive's own servo in the modes velocity and position, rad/s.
        servo_natural_frequency_rad_s: f64 = 60.0,
        /// `[drive.simulated.wall]`
        #[serde(skip_serializing_if = "Option::is_none")]
        wall: Option<RawWall> = None,
        /// `[drive.simulated.push]`
        #[serde(skip_serializing_if = "Option::is_none")]
        push: Option<RawPush> = None,
        /// `[drive.simulated.jam]`
        #[serde(skip_serializing_if = "Option::is_none")]
        jam: Option<RawJam> = None,
    }
}

table! {
    /// A wall before the flange of the simulated arm.
    RawWall {
        /// A point of its surface in the frame of the base, m.
        point_m: [f64; 3] = [0.0; 3],
        /// The direction out of it, of any length.
        normal: [f64; 3] = [0.0, 0.0, 1.0],
        /// Its stiffness, N/m.
        stiffness_n_m: f64 = 3e4,
        /// Its damping, N s/m.
        damping_n_s_m: f64 = 100.0,
    }
}

table! {
    /// A force on the flange of the simulated arm.
    RawPush {
        /// In the frame of the base, N.
        force_n: [f64; 3] = [0.0; 3],
        /// When it begins, s after the start.
        from_s: f64 = 0.5,
        /// When it ends.
        until_s: f64 = 1.0,
    }
}

table! {
    /// A joint of the simulated arm that jams.
    RawJam {
        /// Which one, from 0.
        joint: u32 = 0,
        /// When, s after the start.
        from_s: f64 = 0.5,
    }
}

table! {
    /// A drive in another process.
    RawExternal {
        /// Program and arguments that `vservo run` starts as the drive; empty where it is started by other means.
        command: Vec<String> = Vec::new(),
        /// Folder in which it is started; that of the run file where it is left out.
        folder: PathBuf = PathBuf::new(),
        /// In lockstep: time without an answer to a command after which the drive counts as hanging, s.
        answer_timeout_s: f64 = 10.0,
        /// Time within which a drive started by the run must have connected, and any drive have answered the start, s.
        connect_timeout_s: f64 = 30.0,
    }
}

table! {
    /// A recorded arm.
    RawRecordedDrive {
        /// The recording whose joint states are played.
        recording: PathBuf = PathBuf::new(),
    }
}
