//! The simulated scene: what is true, apart from what the controller believes.

use super::Config;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::robot::{Mount, RobotDescription};
use crate::scene::{Backdrop, Bystander, Occluder, SceneMotion};
use crate::target::Target;

/// What is true in a simulated cell. Camera, target and arm of the [`Config`] are what the controller believes; where
/// the run file does not say otherwise, they are the same.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The lens that the camera has.
    pub camera: CameraModel,
    /// Where it sits.
    pub mount: Mount,
    /// The target, as large as it is.
    pub target: Target,
    /// Where it is: in the base frame, or on the flange with a camera beside the arm.
    pub X_WO: Pose,
    /// How it moves there.
    pub motion: SceneMotion,
    /// What comes between it and the camera, each over those before it.
    pub occluders: Vec<Occluder>,
    /// What lies around its plate.
    pub backdrop: Backdrop,
    /// Other targets beside it, which are not looked for.
    pub bystanders: Vec<Bystander>,
    /// The arm.
    pub arm: RobotDescription,
    /// True joint positions less what the encoders read, rad or m; as many as the robot has joints.
    pub q_offset: Vec<f64>,
}

impl Config {
    /// Where the object is in the simulated scene at the start, in the frame in which it rests; `None` without one.
    #[must_use]
    pub fn X_WO(&self) -> Option<Pose> {
        self.scene.as_ref().map(|scene| scene.X_WO)
    }
}
