//! What most programs that use the cores need: `use vservo::prelude::*;`.
//!
//! ```
//! use vservo::prelude::*;
//!
//! // Four points 0.6 m away shall look as from 0.5 m: the camera approaches.
//! let points: Vec<_> = FourDots::default().points_O().into();
//! let goal = SetPoint::from_pose(&Pose::translation(-0.05, -0.05, 0.5), &points).ok_or("behind the camera")?;
//! let now = SetPoint::from_pose(&Pose::translation(-0.05, -0.05, 0.6), &points).ok_or("behind the camera")?;
//! let view = View::new(now.features().iter().copied(), None).ok_or("no features")?;
//! let V_BC_C = image_task(&goal, &view, Interaction::TEXTBOOK).and_then(|task| task.twist(1.0)).ok_or("singular")?;
//! assert!(V_BC_C.z > 0.08 && V_BC_C.xy().norm() < 1e-9);
//! # Ok::<(), &str>(())
//! ```
//! `examples/law.rs`, `examples/pose.rs` and `examples/own_drive.rs` are whole programs.

pub use crate::camera_model::{CameraModel, Distortion, Intrinsics, Lens};
pub use crate::config::{Config, assemble};
pub use crate::control::control_loop::ControlLoop;
pub use crate::detect::{Detection, Finder, PredictedPoint};
pub use crate::drive::{CommandMode, Drive, DriveCommand, DriveState};
pub use crate::features::{
    AreaFeature, EllipseFeature, Feature, FeatureStack, ImageMoments, MomentFeature, PointFeature,
    SegmentFeature, solve_twist,
};
pub use crate::geometry::Pose;
pub use crate::imaging::ImageView;
pub use crate::messages::{FrameHeader, JointState, Measurement, TargetStatus};
pub use crate::mission::{LockstepRun, Mission};
pub use crate::pose::{Correspondence, PlanarPose, planar_pose, pnp, refine};
pub use crate::robot::Robot;
pub use crate::scene::{Exposure, SyntheticCamera};
pub use crate::servo::{Gain, Interaction, Law, Selection, SetPoint, View, image_task};
pub use crate::sim::simulate_system;
pub use crate::target::{Chessboard, DotGrid, FourDots, Shape, Tags, Target};
pub use crate::time::{MonoNs, SpanNs, TICK};
pub use crate::vision::{Frame, Prior, Vision, VisionSettings};
pub use nalgebra;
