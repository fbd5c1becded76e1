//! Sources of frames, each behind one of two traits, so that one can be replaced without a change behind it.
//!
//! ```text
//! arm states (1 kHz) ─► synthetic ─┐  scheduled: triggered
//! images, recording  ─► replay    ─┴─► expose(exposure, buffer in shared memory)
//!                                      free-running: tells when it did
//! another program    ─► external ┐
//! a real camera      ─► v4l2 ────┴────────────► wait() ─► Captured { mid, span, sequence, lost }, fill(buffer in shared memory)
//! ```

mod count;
mod dated;
pub mod external;
mod image_file;
mod linear;
mod recording;
mod replay;
mod stamp;
pub mod v4l2;

pub use crate::scene::Exposure;
use dated::DatedCamera;
pub use image_file::{encode_png, load_image};
use linear::Linearized;
pub use recording::{RecordedCamera, RecordedTopic};
pub use replay::Replay;
use v4l2::{CaptureRequest, V4l2Error};

use crate::config::assemble::{self, AssembleError};
use crate::config::{self, Config};
use crate::ipc::IpcError;
use crate::messages::{CameraState, JointState};
use crate::robot::{Robot, RobotError};
use crate::scene::SyntheticCamera;
use crate::time::{MonoNs, SpanNs};
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;

/// What became of a frame that was to be exposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exposed {
    /// The image is there.
    Image,
    /// No image is left: the frame is as it was.
    End,
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
    /// A recording cannot be played.
    #[error("camera.replay.recording: {file}: {what}", file = file.display())]
    Recording {
        /// The recording.
        file: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// An external camera gives images that are none.
    #[error("camera.source `external`: {0}")]
    ExternalImage(String),
    /// An external camera needs a run.
    #[error(
        "camera.source `external`: images come through an instance; use `vservo serve` or `vservo camera check`"
    )]
    NeedsInstance,
    /// The transport of an external camera's images fails.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// A camera cannot be used.
    #[error(transparent)]
    V4l2(#[from] V4l2Error),
    /// The arm that carries the camera cannot be built.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The configuration does not fit the arm.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
}

impl SourceError {
    /// Whether no change of a file would help.
    #[must_use]
    pub fn is_internal(&self) -> bool {
        matches!(self, Self::Ipc(_)) || matches!(self, Self::V4l2(error) if error.is_internal())
    }

    fn image(file: &Path, cause: image::ImageError) -> Self {
        Self::Image { file: file.into(), cause }
    }
}

/// When a triggered source has its next frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NextInstant {
    /// Whenever it is told to.
    Any,
    /// At this instant.
    At(MonoNs),
    /// Never more.
    Never,
}

/// A source of frames whose exposures are triggered.
pub trait ScheduledSource {
    /// Tells where the arm is; in the order of time.
    fn arm(&mut self, state: &JointState);

    /// Fills `out` (columns times rows of the camera, row by row) with the frame of `exposure`.
    ///
    /// # Errors
    /// [`SourceError`]; the source cannot go on after it.
    fn expose(&mut self, exposure: &Exposure, out: &mut [u8]) -> Result<Exposed, SourceError>;

    /// Whether its images are the same whenever they are exposed, so that frames can be filled before they are due.
    fn is_known_ahead(&self) -> bool {
        false
    }

    /// When it has its next frame, by the clock of the run; asked for in real time alone.
    fn next_instant(&self) -> NextInstant {
        NextInstant::Any
    }

    /// The middle of `exposure`, which was the last one, as the source knows it: of a frame that is a duplicate that of the one before.
    fn stamped(&self, exposure: &Exposure) -> MonoNs {
        exposure.mid
    }
}

/// A frame that a free-running source has exposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Captured {
    /// Middle of its exposure.
    pub mid: MonoNs,
    /// Length of its exposure.
    pub span: SpanNs,
    /// Counts the source's exposures; a gap is as many frames that it lost.
    pub sequence: u64,
    /// Frames since the start that the source lost beside those gaps: damaged ones, for instance.
    pub lost: u64,
}

/// What became of a frame that was to be filled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Filled {
    /// The image is there.
    Image,
    /// It turned out to be damaged: it is lost.
    Damaged,
}

/// How a free-running source stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceHealth {
    /// What it is doing.
    pub state: CameraState,
    /// Since when.
    pub since: MonoNs,
    /// Damaged frames.
    pub corrupt: u64,
    /// Frames that were older than another one that was there too.
    pub superseded: u64,
    /// Frames of unknown time.
    pub undated: u64,
    /// How often it was opened anew.
    pub reopened: u64,
    /// How often its stream was begun anew.
    pub restarted: u64,
    /// Frames whose stamps lay in the future.
    pub stamps_clamped: u64,
    /// Frames per second that it really exposes; `None` while unknown.
    pub rate_hz: Option<f64>,
    /// Whether frames are dated by their arrival, because the device's stamps are not believed.
    pub stamps_are_doubted: bool,
    /// Whether it gives fewer frames than it was asked for.
    pub rate_is_missed: bool,
    /// Of an external camera: what its headers say against the contract, though their images are used.
    pub odd_headers: OddHeaders,
}

/// Images whose headers have values that no camera can mean.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct OddHeaders {
    /// Their numbers stand still, go back or leap: images that were lost before them are not seen.
    pub sequence: u64,
    /// Their exposures are longer than a period.
    pub exposure: u64,
    /// They set what is kept for later versions.
    pub reserved: u64,
}

impl Default for SourceHealth {
    fn default() -> Self {
        Self {
            state: CameraState::Unknown,
            since: MonoNs::ZERO,
            corrupt: 0,
            superseded: 0,
            undated: 0,
            reopened: 0,
            restarted: 0,
            stamps_clamped: 0,
            rate_hz: None,
            stamps_are_doubted: false,
            rate_is_missed: false,
            odd_headers: OddHeaders::default(),
        }
    }
}

/// A producer of frames that exposes by its own clock and says when it did.
pub trait FreeRunningSource {
    /// Waits for the next frame, at most for `longest`; `None` when none came. Frames that came meanwhile and are older
    /// than it are lost. A source that can find its device again gives none meanwhile, and says so in [`Self::health`].
    ///
    /// # Errors
    /// [`SourceError`]; the source cannot go on after it.
    fn wait(&mut self, longest: Duration) -> Result<Option<Captured>, SourceError>;

    /// Fills `out` (columns times rows of the camera, row by row) with the grey levels of the frame that
    /// [`Self::wait`] gave last, from wherever and in whatever form the source has it. A damaged one is not to be used.
    ///
    /// # Errors
    /// [`SourceError`]; the source cannot go on after it.
    fn fill(&mut self, out: &mut [u8]) -> Result<Filled, SourceError>;

    /// How it stands.
    fn health(&self) -> SourceHealth;
}

/// A source of either kind.
pub enum AnySource {
    /// Told when to expose.
    Scheduled(Box<dyn ScheduledSource>),
    /// Tells when it did.
    FreeRunning(Box<dyn FreeRunningSource>),
}

/// The source that a configuration names.
///
/// # Errors
/// [`SourceError`] when it cannot start; files are looked at now, not in the middle of the run.
pub fn open(config: &Config) -> Result<AnySource, SourceError> {
    let table = config.camera.response.linearization();
    let scheduled = |source| AnySource::Scheduled(source);
    let free_running = |source| AnySource::FreeRunning(source);
    Ok(match &config.camera.source {
        config::Source::Synthetic { .. } => scheduled(crate::dispatch_robot!(config.robot, |robot| {
            synthetic_camera_of(&robot, config).map(|camera| Box::new(camera) as Box<dyn ScheduledSource>)
        })??),
        config::Source::Replay { images, repeat, strict } => {
            let i = config.camera.model.intrinsics();
            let (repeat, strict, size_px) = (*repeat, *strict, (i.width_px, i.height_px));
            let source: Box<dyn ScheduledSource> = match images {
                config::ReplayImages::Folder(folder) => {
                    Box::new(Replay::open(folder, i.width_px, i.height_px, repeat, strict)?)
                }
                config::ReplayImages::Recording { file, topic } => {
                    let (topic, camera) = (topic.as_deref(), config.camera.id);
                    let wanted = RecordedTopic { topic, camera, size_px, repeat, strict };
                    // Beside a recorded arm each image is shown when it was taken.
                    match config.drive.kind {
                        config::DriveKind::Replay => Box::new(DatedCamera::open(file, &wanted)?),
                        _ => Box::new(RecordedCamera::open(file, &wanted)?),
                    }
                }
            };
            match table {
                Some(table) => scheduled(Box::new(Linearized { table, source })),
                None => scheduled(source),
            }
        }
        config::Source::V4l2(settings) => {
            let request = CaptureRequest::of(&config.camera, settings);
            let source: Box<dyn FreeRunningSource> = Box::new(v4l2::open(request)?);
            match table {
                Some(table) => free_running(Box::new(Linearized { table, source })),
                None => free_running(source),
            }
        }
        config::Source::External(_) => return Err(SourceError::NeedsInstance),
    })
}

/// The external camera of a configuration, whose images come over `link`.
pub fn open_external<'a, L: external::ImageLink + 'a>(
    config: &Config,
    link: L,
) -> Box<dyn FreeRunningSource + 'a> {
    let source: Box<dyn FreeRunningSource + 'a> =
        Box::new(external::ExternalCamera::new(link, &config.camera));
    match config.camera.response.linearization() {
        Some(table) => Box::new(Linearized { table, source }),
        None => source,
    }
}

/// The synthetic camera of a configuration whose arm has as many joints as `_robot`.
fn synthetic_camera_of<const N: usize>(
    _robot: &Robot<N>,
    config: &Config,
) -> Result<SyntheticCamera<N>, AssembleError> {
    assemble::synthetic_camera(config)
}

impl<const N: usize> ScheduledSource for SyntheticCamera<N> {
    fn arm(&mut self, state: &JointState) {
        Self::arm(self, state);
    }

    fn expose(&mut self, exposure: &Exposure, out: &mut [u8]) -> Result<Exposed, SourceError> {
        Self::expose(self, exposure, out);
        Ok(Exposed::Image)
    }

    fn stamped(&self, _exposure: &Exposure) -> MonoNs {
        Self::stamped(self)
    }
}
