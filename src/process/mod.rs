//! The processes: thin loops around the cores. Each joins an instance under its role, works until a stop is requested,
//! and takes its run files with it.

#[cfg(feature = "cli")]
pub mod camera;
#[cfg(feature = "cli")]
pub mod control;
#[cfg(feature = "cli")]
pub mod drive_check;
#[cfg(feature = "cli")]
pub mod drive_franka;
#[cfg(feature = "cli")]
pub mod drive_guard;
#[cfg(feature = "cli")]
mod drive_payload;
#[cfg(feature = "cli")]
mod drive_robot;
#[cfg(feature = "cli")]
pub mod drive_ur;
#[cfg(feature = "cli")]
mod drive_weights;
mod error;
#[cfg(feature = "cli")]
pub mod guardian;
mod leftovers;
#[cfg(feature = "cli")]
mod membership;
#[cfg(feature = "cli")]
mod open_recording;
#[cfg(feature = "cli")]
mod priority;
#[cfg(feature = "cli")]
mod process_faults;
#[cfg(feature = "cli")]
pub mod recorded_report;
#[cfg(feature = "cli")]
pub mod recorder;
#[cfg(feature = "cli")]
mod report_folder;
#[cfg(feature = "cli")]
mod report_images;
#[cfg(feature = "cli")]
mod run_place;
#[cfg(feature = "cli")]
pub mod run_report;
#[cfg(feature = "cli")]
mod seeing;
#[cfg(feature = "cli")]
mod signals;
#[cfg(feature = "cli")]
mod silence;
#[cfg(feature = "cli")]
pub mod stereo_vision;
mod stop;
#[cfg(feature = "cli")]
pub mod supervisor;
#[cfg(feature = "cli")]
pub mod vision;

#[cfg(feature = "cli")]
pub use drive_payload::DrivePayload;
#[cfg(feature = "cli")]
pub use drive_robot::DriveJoining;
pub use error::ProcessError;
pub(crate) use leftovers::LeftoversGuard;
#[cfg(feature = "cli")]
pub use membership::Membership;
#[cfg(feature = "cli")]
pub use open_recording::OpenRecording;
#[cfg(feature = "cli")]
pub use report_folder::{NewReport, ReportFolder};
#[cfg(feature = "cli")]
pub use seeing::frame_shape;
#[cfg(feature = "cli")]
use seeing::{
    FILLED_AHEAD, LONGEST_SPIN, LONGEST_WAIT, WAKE_AHEAD, second_vision, seeing_cameras, seeing_roles,
    shape_of, watched_roles,
};
#[cfg(feature = "cli")]
pub use signals::follow_parent;
#[cfg(feature = "cli")]
use stop::STOP_REASON;
pub use stop::StopFlag;
