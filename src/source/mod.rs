//! Producers of frames, each behind the same trait: whoever replaces one changes nothing behind it.
//!
//! ```text
//! arm states (1 kHz) ─► synthetic ─┐
//! folder of images   ─► replay    ─┴─► expose(frame, buffer in shared memory)
//! ```

mod image_file;
mod replay;

pub use crate::scene::Exposure;
pub use replay::Replay;

use crate::config::assemble::{self, AssembleError};
use crate::config::{self, Config};
use crate::messages::JointState;
use crate::robot::{Robot, RobotError};
use crate::scene::SyntheticCamera;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Whether more frames follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Position {
    /// They do.
    Running,
    /// This was the last one.
    Last,
}

/// A source of frames cannot start or go on.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The folder cannot be listed.
    #[error("camera.replay.folder: {folder}: cannot be read: {cause}", folder = folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// The system's word for it.
        cause: std::io::Error,
    },
    /// The folder holds no image.
    #[error("camera.replay.folder: {} holds no .png, .pgm, .jpg or .jpeg file", .0.display())]
    NoImages(PathBuf),
    /// A file is not an image, or a damaged one.
    #[error("{file}: cannot be decoded: {cause}; repair or remove the file", file = file.display())]
    Image {
        /// The file.
        file: PathBuf,
        /// The decoder's word for it.
        cause: image::ImageError,
    },
    /// A file ends before its image does.
    #[error("{}: cannot be decoded: it ends before its image does; repair or remove the file", .0.display())]
    Damaged(PathBuf),
    /// Something with the name of an image is no file.
    #[error("{file}: is {kind}, not a file; remove it from the folder", file = file.display())]
    NotAFile {
        /// Its path.
        file: PathBuf,
        /// What it is.
        kind: &'static str,
    },
    /// A file is larger than an image of the camera's size can be.
    #[error(
        "{file}: has {mib} MiB, an image of the camera's size at most {largest_mib} MiB; remove the file",
        file = file.display()
    )]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// Its size.
        mib: u64,
        /// What is allowed.
        largest_mib: u64,
    },
    /// A file has another size than the camera.
    #[error(
        "{file}: is {found_width}x{found_height} px, the camera is {width}x{height} px; set camera.width_px and \
         camera.height_px to the images' size, or remove the file",
        file = file.display()
    )]
    Size {
        /// The file.
        file: PathBuf,
        /// Its columns.
        found_width: u32,
        /// Its rows.
        found_height: u32,
        /// The camera's columns.
        width: u32,
        /// The camera's rows.
        height: u32,
    },
    /// The arm that carries the camera cannot be built.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The configuration does not fit the arm.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
}

impl SourceError {
    fn image(file: &Path, cause: image::ImageError) -> Self {
        Self::Image { file: file.into(), cause }
    }
}

/// A producer of frames.
pub trait Source {
    /// Tells where the arm is; in the order of time.
    fn arm(&mut self, state: &JointState);

    /// Fills `out` (columns times rows of the camera, row by row) with the frame of `exposure`.
    ///
    /// # Errors
    /// [`SourceError`]; the source cannot go on after it.
    fn expose(&mut self, exposure: &Exposure, out: &mut [u8]) -> Result<Position, SourceError>;
}

/// The source that a configuration names.
///
/// # Errors
/// [`SourceError`] when it cannot start; files are looked at now, not in the middle of the run.
pub fn open(config: &Config) -> Result<Box<dyn Source>, SourceError> {
    match &config.camera.source {
        config::Source::Synthetic { .. } => crate::dispatch_robot!(config.robot, |robot| {
            Ok(Box::new(synthetic_camera_of(&robot, config)?) as _)
        })?,
        config::Source::Replay { folder, repeat } => {
            let i = config.camera.model.intrinsics();
            Ok(Box::new(Replay::open(folder, i.width_px, i.height_px, *repeat)?))
        }
    }
}

/// The synthetic camera of a configuration whose arm has as many joints as `_robot`.
fn synthetic_camera_of<const N: usize>(
    _robot: &Robot<N>,
    config: &Config,
) -> Result<SyntheticCamera<N>, AssembleError> {
    assemble::synthetic_camera(config)
}

impl<const N: usize> Source for SyntheticCamera<N> {
    fn arm(&mut self, state: &JointState) {
        Self::arm(self, state);
    }

    fn expose(&mut self, exposure: &Exposure, out: &mut [u8]) -> Result<Position, SourceError> {
        Self::expose(self, exposure, out);
        Ok(Position::Running)
    }
}
