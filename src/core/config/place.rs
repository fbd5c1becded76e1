//! Poses of the camera and of the target, and how that moves: `[camera.mount]`, `[scene.object]`, `[scene.motion]`.

use serde::{Deserialize, Serialize};

word! {
    /// Where the camera is mounted.
    MountKind {
        /// On the arm: on the flange, or on a link.
        EyeInHand,
        /// Fixed in the base frame; the flange carries the target.
        EyeToHand,
    }
}

pose_table! {
    /// Pose of the camera: in the flange frame or in that of a link, or in the base frame for `eye_to_hand`.
    RawMount {
        /// Kind.
        kind: MountKind = MountKind::EyeInHand,
        /// The link of the arm that carries the camera, by its name or that of the joint before it; left out: the flange.
        #[serde(skip_serializing_if = "Option::is_none")]
        link: Option<String> = None,
        /// Position, m.
        position_m: [f64; 3] = [0.0; 3],
        /// Roll, pitch, yaw, rad.
        rotation_rpy_rad: [f64; 3] = [0.0; 3],
    }
}

word! {
    /// What carries the target.
    Carrier {
        /// It rests in the base frame.
        Base,
        /// It is fixed to the flange.
        Flange,
    }
}

word! {
    /// How the target moves by itself.
    SceneMotionKind {
        /// Not at all.
        Still,
        /// With constant velocity.
        Conveyor,
        /// To and fro.
        Pendulum,
        /// On a circle.
        Circle,
        /// By turns with constant velocity and at rest.
        StopAndGo,
        /// One leap to another place.
        Jump,
    }
}

table! {
    /// Motion of the target in a simulated scene.
    RawSceneMotion {
        /// Kind of motion.
        kind: SceneMotionKind = SceneMotionKind::Still,
        /// Conveyor, and stop and go while it moves: velocity in the base frame, m/s.
        velocity_m_s: [f64; 3] = [0.0, 0.05, 0.0],
        /// Pendulum: largest displacement in the base frame, m.
        amplitude_m: [f64; 3] = [0.0, 0.05, 0.0],
        /// Pendulum and circle: swings or turns per second.
        frequency_hz: f64 = 0.2,
        /// Circle: from the target's first place to the centre, in the base frame, m.
        radius_m: [f64; 3] = [0.0, 0.1, 0.0],
        /// Circle: axis in the base frame about which the target goes, at right angles to the radius.
        axis: [f64; 3] = [0.0, 0.0, 1.0],
        /// Stop and go: how long it moves, s.
        moving_s: f64 = 1.0,
        /// Stop and go: how long it rests after each motion, s.
        resting_s: f64 = 1.0,
        /// Jump: displacement in the base frame, m.
        displacement_m: [f64; 3] = [0.0, 0.05, 0.0],
        /// Jump: when, s after the first tick.
        at_s: f64 = 2.0,
    }
}

pose_table! {
    /// Where the target is.
    RawObject {
        /// In which frame it rests; must suit `camera.mount.kind`.
        on: Carrier = Carrier::Base,
        /// Position, m.
        position_m: [f64; 3] = [1.0, 1.0, 1.0],
        /// Roll, pitch, yaw, rad.
        rotation_rpy_rad: [f64; 3] = [0.0, 0.0, std::f64::consts::FRAC_PI_4],
        /// `[scene.objects.NAME.motion]`: how a further target moves; that of `[scene.object]` stands in `[scene.motion]`.
        #[serde(skip_serializing_if = "Option::is_none")]
        motion: Option<RawSceneMotion> = None,
    }
}

table! {
    /// Something in front of the target for a while, in a simulated scene: a sheet parallel to its plane.
    RawOccluder {
        /// Start time, s.
        from_s: f64 = 0.0,
        /// End time, s; it never appears where that is not later.
        until_s: f64 = 0.0,
        /// Its middle along the target's x and y, m.
        center_m: [f64; 2] = [0.0, 0.0],
        /// Its sides along the target's x and y, m.
        size_m: [f64; 2] = [0.05, 0.05],
        /// How far in front of the target's plane it lies, m.
        height_m: f64 = 0.01,
        /// Its grey level.
        level: f64 = 140.0,
    }
}

table! {
    /// What lies in the target's plane around its plate, in a simulated scene.
    RawBackdrop {
        /// Largest deviation of a mottled surface from `background_level`, grey levels; 0: plain.
        texture_levels: f64 = 0.0,
        /// Size of its largest spots, m.
        texture_size_m: f64 = 0.05,
        /// How many shapes lie about that are no targets.
        clutter: u32 = 0,
        /// Their size, m.
        clutter_size_m: f64 = 0.02,
        /// How far from the plate's edge they may lie, m.
        clutter_reach_m: f64 = 0.3,
    }
}

table! {
    /// Another target beside the one that is looked for, in a simulated scene.
    RawBystander {
        /// What it is, as `--target` of the commands takes it.
        target: String = "four_dots".into(),
        /// Its origin along the target's x and y, m.
        position_m: [f64; 2] = [0.2, 0.0],
        /// From the target's x towards its y to its own x, rad.
        turn_rad: f64 = 0.0,
    }
}
