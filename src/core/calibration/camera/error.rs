//! Why there is no calibration, and why an image takes no part in one.

use crate::calibration::bundle::{BundleFailure, Misfit};
use crate::camera_model::CameraModelError;
use std::fmt;
use thiserror::Error;

/// Why images make no calibration.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum CameraCalibrationError {
    /// Nothing to calibrate from.
    #[error(
        "calibration: {usable} usable images, at least {needed} are needed; take more images with the board in view"
    )]
    TooFewViews {
        /// Images with enough corners.
        usable: usize,
        /// How many it takes.
        needed: usize,
    },
    /// A setting, or the size of the image, that cannot be.
    #[error("calibration: {name} is {value}; give {wanted}")]
    Setting {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it should be.
        wanted: &'static str,
    },
    /// No start was found from which all boards lie before the camera.
    #[error(
        "calibration: no camera explains the images even roughly; check that corners have the right ids and that the \
         board is the one that was named"
    )]
    NoStart,
    /// The images do not tell every parameter.
    #[error(
        "calibration: the images do not tell all parameters; tilt the board by 30 degrees and more, to all sides, or fix \
         parameters (principal point, aspect, k3)"
    )]
    Degenerate,
    /// The refinement did not settle.
    #[error(
        "calibration: no convergence in {iterations} iterations; add images with the board tilted and near the corners \
         of the image"
    )]
    NotConverged {
        /// Iterations spent.
        iterations: u32,
    },
    /// The lens that fits best is none.
    #[error(
        "calibration: the lens that fits the corners best is none: {0}; cover the corners of the image, or fix k3"
    )]
    Camera(CameraModelError),
    /// The two cameras do not see the board in the same instants often enough.
    #[error(
        "calibration: {left} images of the left camera and {right} of the right one were given; give as many of each, in \
         pairs"
    )]
    Pairs {
        /// Of the left camera.
        left: usize,
        /// Of the right one.
        right: usize,
    },
    /// The images of most pairs were not taken at one instant, or are not in the same order.
    #[error(
        "calibration: {astray} of {pairs} pairs of images put the right camera elsewhere than the others do, although a pair is rigid: \
         give --left and --right their images in the same order, and take both images of a pair at the same instant"
    )]
    Astray {
        /// Pairs that agree with no pose of the right camera.
        astray: usize,
        /// Pairs in all.
        pairs: usize,
    },
    /// The two cameras would stand in one place: no pair does.
    #[error(
        "calibration: the base line between the cameras is {baseline_mm:.4} mm, which is not told from none (standard deviation \
         {sd_mm:.4} mm): left and right are images of the same camera, or the same files; give the left camera's to --left and the \
         right one's to --right"
    )]
    NoBaseline {
        /// Length of the base line, mm.
        baseline_mm: f64,
        /// Its standard deviation in the worst direction, mm.
        sd_mm: f64,
    },
}

impl From<BundleFailure> for CameraCalibrationError {
    fn from(failure: BundleFailure) -> Self {
        match failure {
            BundleFailure::BadStart => Self::NoStart,
            BundleFailure::Degenerate => Self::Degenerate,
            BundleFailure::NotConverged { iterations } => Self::NotConverged { iterations },
        }
    }
}

/// Why an image takes no part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Unused {
    /// Too few corners to say anything.
    TooFewPoints {
        /// Corners seen.
        given: usize,
    },
    /// A number that is none, or a covariance that cannot be.
    NotFinite {
        /// Place of the first such corner in the list.
        index: usize,
    },
    /// No pose of the board explains the corners: they lie on one line, or are mixed up.
    NoPose,
    /// Its corners fit so many times worse than those of the other images.
    Worse {
        /// In standard deviations.
        ratio: f64,
    },
    /// Most of its corners are outliers.
    MostCorners,
    /// In a pair: the other camera's image is of no use.
    Other,
}

impl From<Misfit> for Unused {
    fn from(misfit: Misfit) -> Self {
        match misfit {
            Misfit::Worse(ratio) => Self::Worse { ratio },
            Misfit::MostCorners => Self::MostCorners,
        }
    }
}

impl fmt::Display for Unused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFewPoints { given } => {
                write!(f, "{given} corners seen, at least {} are needed", super::MIN_POINTS)
            }
            Self::NotFinite { index } => {
                write!(f, "corner {index} of the list is not finite, or its covariance is none")
            }
            Self::NoPose => f.write_str("no pose of the board explains its corners"),
            Self::Worse { ratio } => write!(
                f,
                "its corners fit {ratio:.1} times worse than those of the others: the board or the camera moved, or it was bent"
            ),
            Self::MostCorners => f.write_str("most of its corners are outliers"),
            Self::Other => f.write_str("the other camera's image of the pair is of no use"),
        }
    }
}
