//! The plain records that flow between the cores, and between the processes over shared memory.
//!
//! Each is `repr(C)` without pointers and carries a versioned type name: a peer in another language binds by
//! that name, and shared memory is read as it lies. Whoever changes a field raises the version in the name and
//! mends the layout tests below. Enumerations travel as codes: shared memory may hold a value that no variant has.
//!
//! ```text
//! camera --FrameHeader + [u8]--> vision --Measurement--> control --JointState--> camera
//!                                                        │  └------Status--> supervisor, views
//!                                                        └-DriveCommandMsg--> external drive --DriveStateMsg--> control
//! ```

mod drive;

pub use drive::{DriveCommandMsg, DriveStateMsg, drive_flag};

use crate::time::MonoNs;
use iceoryx2::prelude::ZeroCopySend;

/// Most joints that an arm may have.
pub const MAX_JOINTS: usize = 7;

/// Most features that one measurement carries.
pub const MAX_FEATURES: usize = 16;

/// Stamps and shape of a grey frame; travels as user header of a `[u8]` payload.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("vservo.FrameHeader.v1")]
pub struct FrameHeader {
    /// Counts the camera's exposures from 0; a gap is a frame that the camera itself lost.
    pub frame_id: u64,
    /// Middle of the exposure.
    pub exposure: MonoNs,
    /// When the frame was handed over.
    pub sent: MonoNs,
    /// Length of the exposure, ns.
    pub exposure_span_ns: u64,
    /// Exposures since the start that the camera itself lost.
    pub lost: u64,
    /// Which camera.
    pub camera: u32,
    /// Columns, px.
    pub width_px: u32,
    /// Rows, px.
    pub height_px: u32,
    /// Bits of [`frame_flag`].
    pub flags: u32,
}

/// Bits of [`FrameHeader::flags`] and [`Measurement::flags`].
pub mod frame_flag {
    /// The source ends with this frame (replay, played once).
    pub const LAST: u32 = 1;
}

/// Bits of [`Measurement::flags`] beside those of [`frame_flag`].
pub mod measurement_flag {
    /// `pose` and `pose_covariance` are valid.
    pub const POSE: u32 = 1 << 8;
    /// Found in predicted windows; without this bit the whole frame was searched.
    pub const TRACKED: u32 = 1 << 9;
    /// A second pose explains the picture almost as well (planar ambiguity).
    pub const AMBIGUOUS: u32 = 1 << 10;
}

/// What became of the target in one frame.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum TargetStatus {
    /// All features were found and told apart.
    Found = 0,
    /// The frame has no contrast: covered lens, no light, over-exposed.
    #[default]
    NoContrast = 1,
    /// There are fewer candidate regions than features.
    TooFewRegions = 2,
    /// There are enough regions, but no choice of them has the target's geometry.
    NoMatch = 3,
    /// The geometry fits in more than one way: features cannot be told apart.
    Ambiguous = 4,
    /// The frame does not have the size of the configured camera.
    WrongSize = 5,
    /// The features were found, but are disturbed: no pose explains them within their stated deviations. Refused.
    Inconsistent = 6,
}

impl TargetStatus {
    /// The status of a code in a message. A code that this version does not know counts as [`Self::NoMatch`]:
    /// shared memory may hold anything.
    #[must_use]
    pub fn from_code(code: u32) -> Self {
        match code {
            0 => Self::Found,
            1 => Self::NoContrast,
            2 => Self::TooFewRegions,
            4 => Self::Ambiguous,
            5 => Self::WrongSize,
            6 => Self::Inconsistent,
            _ => Self::NoMatch,
        }
    }

    /// A short clause for people.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::NoContrast => "no contrast in the frame",
            Self::TooFewRegions => "fewer dark regions than dots",
            Self::NoMatch => "no regions with the target's geometry",
            Self::Ambiguous => "dots cannot be told apart",
            Self::WrongSize => "frame of another size than the camera's",
            Self::Inconsistent => "dots do not fit one pose: shadow, glare, something in front?",
        }
    }
}

/// One feature point.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("vservo.FeaturePoint.v1")]
pub struct FeaturePoint {
    /// Column of the feature in the frame (distorted), px; pixel centres are integers.
    pub u_px: f64,
    /// Row of the feature in the frame, px.
    pub v_px: f64,
    /// X of the feature in normalized coordinates, undistorted (10.3).
    pub x: f64,
    /// Y of the feature in normalized coordinates.
    pub y: f64,
    /// One standard deviation of `u_px` and `v_px`, px.
    pub sigma_px: f64,
}

/// What vision saw in one frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("vservo.Measurement.v1")]
pub struct Measurement {
    /// The frame it was taken from.
    pub frame_id: u64,
    /// Middle of that frame's exposure.
    pub exposure: MonoNs,
    /// When the camera handed the frame over.
    pub frame_sent: MonoNs,
    /// When vision began to work on it.
    pub vision_start: MonoNs,
    /// When vision was done.
    pub vision_end: MonoNs,
    /// Frames that vision has received since its start.
    pub frames_received: u64,
    /// Frames that the camera sent and vision never worked on.
    pub frames_dropped: u64,
    /// How often a target that had been found was lost.
    pub target_lost: u64,
    /// Which camera.
    pub camera: u32,
    /// Code of a [`TargetStatus`].
    pub status: u32,
    /// Bits of [`frame_flag`] and [`measurement_flag`].
    pub flags: u32,
    /// How many entries of `features` are valid, in the order of the target's points.
    pub feature_count: u32,
    /// The features.
    pub features: [FeaturePoint; MAX_FEATURES],
    /// `X_CO` as position in m and quaternion `x y z w`.
    pub pose: [f64; 7],
    /// Covariance of the pose, row by row: m and rad, as twist `[v; w]` of O expressed in C.
    pub pose_covariance: [f64; 36],
    /// Root mean square distance between seen features and those of the best pose, px; also of a refused measurement.
    pub reprojection_rms_px: f64,
}

impl Default for Measurement {
    fn default() -> Self {
        Self {
            frame_id: 0,
            exposure: MonoNs::ZERO,
            frame_sent: MonoNs::ZERO,
            vision_start: MonoNs::ZERO,
            vision_end: MonoNs::ZERO,
            frames_received: 0,
            frames_dropped: 0,
            target_lost: 0,
            camera: 0,
            status: TargetStatus::default() as u32,
            flags: 0,
            feature_count: 0,
            features: [FeaturePoint::default(); MAX_FEATURES],
            pose: [0.0; 7],
            pose_covariance: [0.0; 36],
            reprojection_rms_px: 0.0,
        }
    }
}

impl Measurement {
    /// The valid features.
    #[must_use]
    pub fn features(&self) -> &[FeaturePoint] {
        self.features.get(..self.feature_count as usize).unwrap_or(&self.features)
    }

    /// Whether the target was found.
    #[must_use]
    pub fn found(&self) -> bool {
        self.target_status() == TargetStatus::Found
    }

    /// Whether the target was found, else why not.
    #[must_use]
    pub fn target_status(&self) -> TargetStatus {
        TargetStatus::from_code(self.status)
    }

    /// The pose `X_CO`, where one was found.
    #[must_use]
    pub fn pose(&self) -> Option<crate::geometry::Pose> {
        if self.flags & measurement_flag::POSE == 0 {
            return None;
        }
        let [x, y, z, i, j, k, w] = self.pose;
        Some(crate::geometry::Pose::from_parts(
            nalgebra::Translation3::new(x, y, z),
            nalgebra::UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(w, i, j, k)),
        ))
    }

    /// Stores `X_CO` and says so in the flags.
    pub fn set_pose(&mut self, X_CO: &crate::geometry::Pose) {
        let (p, r) = (&X_CO.translation, &X_CO.rotation);
        self.pose = [p.x, p.y, p.z, r.i, r.j, r.k, r.w];
        self.flags |= measurement_flag::POSE;
    }
}

/// The arm at one tick.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("vservo.JointState.v1")]
pub struct JointState {
    /// Number of the control tick.
    pub tick: u64,
    /// When the drive was read.
    pub stamp: MonoNs,
    /// Joints in use.
    pub joints: u32,
    /// Bits of [`joint_flag`].
    pub flags: u32,
    /// Measured positions, rad or m.
    pub q: [f64; MAX_JOINTS],
    /// Measured velocities, rad/s or m/s.
    pub qd: [f64; MAX_JOINTS],
    /// Torques or forces applied at the previous tick, N m or N.
    pub tau: [f64; MAX_JOINTS],
    /// Reference positions.
    pub q_r: [f64; MAX_JOINTS],
    /// Reference velocities.
    pub qd_r: [f64; MAX_JOINTS],
    /// True positions of a simulated arm; what a synthetic camera renders.
    pub q_true: [f64; MAX_JOINTS],
    /// True velocities of a simulated arm.
    pub qd_true: [f64; MAX_JOINTS],
}

/// Bits of [`JointState::flags`].
pub mod joint_flag {
    /// `q_true` and `qd_true` are valid.
    pub const TRUTH: u32 = 1;
}

/// What the control process is doing.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum ControlState {
    /// No measurement yet: the arm holds its place.
    #[default]
    Waiting = 0,
    /// The servo law moves the arm.
    Servoing = 1,
    /// Measurements stopped: the arm slows down and holds.
    Holding = 2,
    /// The goal has been reached and held.
    Converged = 3,
    /// The run is over.
    Stopped = 4,
    /// A fault: the arm slows down and the run ends.
    Fault = 5,
}

impl ControlState {
    /// The state of a code in a message; an unknown one counts as [`Self::Fault`].
    #[must_use]
    pub fn from_code(code: u32) -> Self {
        match code {
            0 => Self::Waiting,
            1 => Self::Servoing,
            2 => Self::Holding,
            3 => Self::Converged,
            4 => Self::Stopped,
            _ => Self::Fault,
        }
    }

    /// A word for people.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Servoing => "servoing",
            Self::Holding => "holding",
            Self::Converged => "converged",
            Self::Stopped => "stopped",
            Self::Fault => "fault",
        }
    }
}

/// Where the run stands; flat, so that plotting tools can show every field.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("vservo.Status.v1")]
pub struct Status {
    /// Number of the control tick.
    pub tick: u64,
    /// Time of that tick.
    pub stamp: MonoNs,
    /// Time since the first tick, s.
    pub time_s: f64,
    /// Root mean square feature error in the image, px; NaN before the first measurement.
    pub feature_error_px: f64,
    /// Distance of the camera from its desired place, m; NaN where unknown.
    pub position_error_m: f64,
    /// Angle of the camera from its desired orientation, rad; NaN where unknown.
    pub orientation_error_rad: f64,
    /// Exposure to command of the newest measurement, us; NaN before the first.
    pub exposure_to_command_us: f64,
    /// Exposure to hand-over of its frame, us; NaN where the two have different clocks (lockstep).
    pub exposure_to_frame_us: f64,
    /// Hand-over to the start of vision's work on it, us.
    pub frame_to_vision_us: f64,
    /// Vision's work on it, us.
    pub vision_us: f64,
    /// Finished measurement to the command that used it, us; NaN in lockstep.
    pub measurement_to_command_us: f64,
    /// Measurements used.
    pub measurements: u64,
    /// Frames that vision received.
    pub frames: u64,
    /// Frames that vision skipped.
    pub frames_dropped: u64,
    /// How often the target was lost.
    pub target_lost: u64,
    /// Deadlines missed.
    pub missed_deadlines: u64,
    /// Code of a [`ControlState`]: what control does.
    pub state: u32,
    /// Code of a [`TargetStatus`]: what vision said last.
    pub target: u32,
    /// The limits that acted since the last status: bits of [`crate::motion::Limit`].
    pub limits: u32,
    /// The joints on which they acted: bit 0 is the first.
    pub limited_joints: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    fn layouts_are_fixed() {
        assert_eq!((size_of::<FrameHeader>(), align_of::<FrameHeader>()), (56, 8));
        assert_eq!(offset_of!(FrameHeader, flags), 52);
        assert_eq!(size_of::<FeaturePoint>(), 40);
        assert_eq!((size_of::<Measurement>(), align_of::<Measurement>()), (1072, 8));
        assert_eq!(offset_of!(Measurement, camera), 64);
        assert_eq!(offset_of!(Measurement, features), 80);
        assert_eq!(offset_of!(Measurement, pose), 720);
        assert_eq!(offset_of!(Measurement, reprojection_rms_px), 1064);
        assert_eq!((size_of::<JointState>(), align_of::<JointState>()), (416, 8));
        assert_eq!(offset_of!(JointState, q), 24);
        assert_eq!(offset_of!(JointState, q_true), 304);
        assert_eq!((size_of::<Status>(), align_of::<Status>()), (144, 8));
        assert_eq!(offset_of!(Status, state), 128);
    }

    #[test]
    #[allow(unsafe_code)]
    fn type_names_carry_their_version() {
        use iceoryx2::prelude::ZeroCopySend;
        // SAFETY: the names are only read.
        for (name, wanted) in [
            (unsafe { FrameHeader::type_name() }, "vservo.FrameHeader.v1"),
            (unsafe { Measurement::type_name() }, "vservo.Measurement.v1"),
            (unsafe { JointState::type_name() }, "vservo.JointState.v1"),
            (unsafe { Status::type_name() }, "vservo.Status.v1"),
        ] {
            assert_eq!(name, wanted);
        }
    }

    #[test]
    fn codes_survive_the_message() {
        for code in 0..8 {
            let status = TargetStatus::from_code(code);
            assert!(status as u32 == code || (status == TargetStatus::NoMatch && code > 6));
            let state = ControlState::from_code(code);
            assert!(state as u32 == code || (state == ControlState::Fault && code > 5));
        }
    }

    #[test]
    fn pose_survives_the_message() {
        let X_CO = crate::geometry::Pose::new([0.1, -0.2, 0.6].into(), [0.3, -1.0, 2.0].into());
        let mut m = Measurement::default();
        assert!(m.pose().is_none());
        m.set_pose(&X_CO);
        assert_eq!(m.pose(), Some(X_CO));
    }
}
