//! The simulated scene: the true parameters, as distinct from the controller's model.

use super::Config;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::robot::{Mount, RobotDescription};
use crate::scene::{Backdrop, Bystander, Occluder, SceneMotion};
use crate::target::Target;

/// True parameters of a simulated cell. Camera, target and arm of the [`Config`] are the controller's model; where
/// the run file does not say otherwise, both are the same.
#[derive(Debug, Clone)]
pub struct Scene {
    /// True lens of the camera.
    pub camera: CameraModel,
    /// True mount of the camera.
    pub mount: Mount,
    /// The target in its true size.
    pub target: Target,
    /// Its pose: in the base frame, or on the flange for eye-to-hand.
    pub X_WO: Pose,
    /// Its motion.
    pub motion: SceneMotion,
    /// Occluders between it and the camera, each in front of those before it.
    pub occluders: Vec<Occluder>,
    /// The backdrop around its plate.
    pub backdrop: Backdrop,
    /// Other targets beside it, which are not to be detected.
    pub bystanders: Vec<Bystander>,
    /// The further targets in their true size, each with its pose as [`Self::X_WO`], where they rest.
    pub further_targets: Vec<(Target, Pose)>,
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
