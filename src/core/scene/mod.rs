//! What a synthetic camera sees: a target, what may lie in front of it, and a renderer of their grey image.
//!
//! ```text
//! dots on a plain background, one sheet before them:
//!   X_CO, Target --> View: lines of the plate and the occluder, conics of the dots, bands of pixels near an edge
//!   View, Rays, EdgeProfile --> levels of one row (flat spans are filled, edge pixels are evaluated)
//! any other scene:
//!   X_CO, Scenery --> Layers: outlines as edges of the image, layer by layer; Backdrop: texture and clutter
//!   Layers, Kernel --> Ink: coverage of a row --> levels of one row, painted from the background to the front
//! both: levels x vignetting + noise --> bytes
//! ```

mod arm_history;
mod backdrop;
mod bands;
mod error;
mod ink;
mod layers;
mod look;
mod motion;
mod occluder;
mod outline;
mod profile;
mod rays;
mod renderer;
mod scenery;
mod schedule;
mod sensor;
mod synthetic_camera;
mod view;
mod visibility;

pub use arm_history::ArmHistory;
pub use backdrop::Backdrop;
pub use error::SceneError;
pub use ink::{BorderSegment, Ink, PixelKernel};
pub use look::SceneLook;
pub use motion::SceneMotion;
pub use occluder::Occluder;
pub use renderer::Renderer;
pub use scenery::Bystander;
pub use schedule::{FrameSchedule, Irregularity};
pub use sensor::{MAX_SIDE_PX, SensorModel};
pub use synthetic_camera::{Exposure, SyntheticCamera};
#[cfg(test)]
pub(crate) use visibility::MAX_SIGHT_ANGLE_RAD;
pub use visibility::{Overhang, PointVisibility, Visibility, is_edge_on, is_front, sight_angle_rad};
