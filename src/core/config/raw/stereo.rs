//! `[stereo]`, and the file with a taught view.

use super::RawPose;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

table! {
    /// Two cameras as a stereo pair.
    RawStereo {
        /// Largest difference of the exposure stamps of a pair of frames, ms.
        pair_tolerance_ms: f64 = 2.0,
        /// Pose of the right camera in the left one, from a calibration of the pair; left out: from the mounts.
        right_in_left: Option<RawPose> = None,
        /// File with the taught points; they take its place.
        taught_file: Option<PathBuf> = None,
        /// `[[stereo.points]]`
        #[serde(skip_serializing_if = "Vec::is_empty")]
        points: Vec<RawTaughtPoint> = Vec::new(),
    }
}

table! {
    /// A point of the taught view.
    RawTaughtPoint {
        /// Its id.
        id: u32 = 0,
        /// Its position in the left camera, m.
        position_m: [f64; 3] = [0.0; 3],
        /// Covariance of that: xx, xy, xz, yy, yz, zz, m^2.
        covariance_m2: [f64; 6] = [0.0; 6],
    }
}

table! {
    /// A file with a taught view, which is read and not kept.
    #[allow(unreachable_pub)] // as all tables are
    RawTaughtView {
        /// `[[points]]`
        points: Vec<RawTaughtPoint> = Vec::new(),
    }
}
