//! The measurement of one frame: `vision/N/measurement`. The numbers here are those of the protocol.

use super::MAX_FEATURES;
use super::layout::{named_codes, record};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

named_codes! {
    /// Bits of [`Measurement::flags`] beside those of [`super::frame_flag`]: part of the protocol, from 8 on because those below are the frame's.
    pub mod measurement_flag {
        /// `pose` and `pose_covariance` are valid.
        pub const POSE: u32 = 1 << 8;
        /// Found in predicted windows; without this bit the whole frame was searched.
        pub const TRACKED: u32 = 1 << 9;
        /// A second pose explains the image almost as well (planar ambiguity).
        pub const AMBIGUOUS: u32 = 1 << 10;
        /// Some of the target's points are occluded, or were left out as outliers.
        pub const PARTIAL: u32 = 1 << 11;
        /// The points fit no pose within noise, but steadily so: the description of lens, target or shutter is not exact. The stated uncertainties contain it.
        pub const MODEL_ERROR: u32 = 1 << 12;
    }
}

/// Result of the detection of the target in one frame.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum TargetStatus {
    /// Found, with its points identified: all of them, or as many as are needed ([`measurement_flag::PARTIAL`]).
    Found = 0,
    /// The frame has no contrast: covered lens, no light, over-exposed.
    #[default]
    NoContrast = 1,
    /// There are fewer candidate regions than features.
    TooFewRegions = 2,
    /// There are enough regions, but none of their combinations has the target's geometry.
    NoMatch = 3,
    /// The geometry fits in more than one way: the features cannot be identified.
    Ambiguous = 4,
    /// The frame does not have the size of the configured camera.
    WrongSize = 5,
    /// The features were detected, but no pose explains them within their stated standard deviations. Rejected.
    Inconsistent = 6,
    /// Of two cameras: the other one has no frame with the same stamp.
    NoPair = 7,
    /// Of two cameras: fewer than three taught points are in both images.
    TooFewShared = 8,
    /// The frame contains more candidates for parts of the target than one search examines.
    GivenUp = 9,
    /// Tags were read, but none that belongs to the target.
    OtherTags = 10,
    /// The target is not in the frame, but in the mirrored frame it is: the camera, or the program that gives the frames, mirrors them.
    Mirrored = 11,
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
            7 => Self::NoPair,
            8 => Self::TooFewShared,
            9 => Self::GivenUp,
            10 => Self::OtherTags,
            11 => Self::Mirrored,
            _ => Self::NoMatch,
        }
    }

    /// A short clause for messages.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::NoContrast => "no contrast in the frame",
            Self::TooFewRegions => {
                "fewer marks than the target has: a part is hidden, out of view or too dim"
            }
            Self::NoMatch => "nothing with the target's geometry",
            Self::Ambiguous => "the target's points cannot be told apart",
            Self::WrongSize => "frame of another size than the camera's",
            Self::Inconsistent => "points do not fit one pose: shadow, glare, something in front?",
            Self::NoPair => "no frame of the other camera at this instant",
            Self::TooFewShared => "fewer than three taught points in both images",
            Self::GivenUp => "the search was given up: too much in the frame looks like a part of the target",
            Self::OtherTags => "tags of other ids than the target's",
            Self::Mirrored => "the target is there, but mirrored: the camera's frames are flipped",
        }
    }
}

record! {
    "vservo.FeaturePoint.v2",
    /// One feature point.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct FeaturePoint {
        /// Which point of the target.
        pub id: u64,
        /// Column of the feature in the frame (distorted), px; pixel centres are integers.
        pub u_px: f64,
        /// Row of the feature in the frame, px.
        pub v_px: f64,
        /// X of the feature in normalized coordinates, undistorted (10.3).
        pub x: f64,
        /// Y of the feature in normalized coordinates.
        pub y: f64,
        /// One standard deviation of `u_px` and `v_px`, px.
        pub sd_px: f64,
    }
}

record! {
    "vservo.Measurement.v4",
    /// Features, pose and status that vision measured in one frame.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Measurement {
        /// The frame it was taken from.
        pub frame_id: u64,
        /// Middle of that frame's exposure.
        pub exposure: MonoNs,
        /// When the camera sent the frame.
        pub frame_sent: MonoNs,
        /// When vision began to process it.
        pub vision_start: MonoNs,
        /// When vision had processed it.
        pub vision_end: MonoNs,
        /// Frames that vision has received since its start.
        pub frames_received: u64,
        /// Frames that the camera sent and vision did not process.
        pub frames_dropped: u64,
        /// How often a target that had been detected was lost.
        pub target_lost: u64,
        /// Which camera.
        pub camera: u32,
        /// Code of a [`TargetStatus`].
        pub status: u32,
        /// Bits of [`super::frame_flag`] and [`measurement_flag`].
        pub flags: u32,
        /// How many entries of `features` are valid; their ids rise.
        pub feature_count: u32,
        /// Which target was looked for: its number in the run file, as in [`super::JointState::target_number`].
        pub target_number: u32,
        /// Zero.
        pub reserved: u32,
        /// The features.
        pub features: [FeaturePoint; MAX_FEATURES],
        /// `X_CO` as position in m and quaternion `x y z w`.
        pub pose: [f64; 7],
        /// Covariance of the pose, row by row: m and rad, as twist `[v; w]` of O expressed in C.
        pub pose_covariance: [f64; 36],
        /// Reprojection error of the best pose, root mean square, px; also of a rejected measurement.
        pub reprojection_rms_px: f64,
        /// Until when vision knew where the arm was, by which it predicted the target; zero where it did not.
        pub arm_stamp: MonoNs,
    }
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
            target_number: 0,
            reserved: 0,
            features: [FeaturePoint::default(); MAX_FEATURES],
            pose: [0.0; 7],
            pose_covariance: [0.0; 36],
            reprojection_rms_px: 0.0,
            arm_stamp: MonoNs::ZERO,
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

    /// Stores `X_CO` and sets [`measurement_flag::POSE`].
    pub fn set_pose(&mut self, X_CO: &crate::geometry::Pose) {
        let (p, r) = (&X_CO.translation, &X_CO.rotation);
        self.pose = [p.x, p.y, p.z, r.i, r.j, r.k, r.w];
        self.flags |= measurement_flag::POSE;
    }
}
