//! What a synthetic camera sees: a target, what may lie in front of it, and a renderer of their grey image.
//!
//! ```text
//! X_CO, Target --> View: lines of the plate and the occluder, conics of the dots, bands of pixels near an edge
//! View, Rays, EdgeProfile --> levels of one row (flat spans are filled, edge pixels are evaluated)
//! levels x vignetting + noise --> bytes
//! ```

mod arm_history;
mod bands;
mod error;
mod look;
mod motion;
mod occluder;
mod outline;
mod profile;
mod rays;
mod renderer;
mod schedule;
mod sensor;
mod synthetic_camera;
mod view;

pub use arm_history::ArmHistory;
pub use error::SceneError;
pub use look::SceneLook;
pub use motion::SceneMotion;
pub use occluder::Occluder;
pub use renderer::{LARGEST_SIDE_PX, Renderer};
pub use schedule::{FrameSchedule, Irregularity};
pub use sensor::SensorModel;
pub use synthetic_camera::{Exposure, SyntheticCamera};
