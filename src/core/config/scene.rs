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
    /// The further targets in their true size.
    pub further_targets: Vec<SceneObject>,
    /// The arm.
    pub arm: RobotDescription,
    /// True joint positions less what the encoders read, rad or m; as many as the robot has joints.
    pub q_offset: Vec<f64>,
}

/// A further target of a simulated scene.
#[derive(Debug, Clone)]
pub struct SceneObject {
    /// The target.
    pub target: Target,
    /// Its pose at the first tick, as [`Scene::X_WO`].
    pub X_WO: Pose,
    /// Its motion from there.
    pub motion: SceneMotion,
}

impl Scene {
    /// Where all targets are at the first tick, by their numbers, each with its motion.
    pub fn places(&self) -> impl Iterator<Item = (Pose, SceneMotion)> + '_ {
        let further = self.further_targets.iter().map(|object| (object.X_WO, object.motion));
        std::iter::once((self.X_WO, self.motion)).chain(further)
    }

    /// The further targets, each with its pose in the frame of the first one, at the first tick.
    pub fn further_in_first(&self) -> impl Iterator<Item = (&Target, Pose)> {
        self.further_targets.iter().map(|object| (&object.target, self.X_WO.inv_mul(&object.X_WO)))
    }
}

impl Config {
    /// Where the object is in the simulated scene at the start, in the frame in which it rests; `None` without one.
    #[must_use]
    pub fn X_WO(&self) -> Option<Pose> {
        self.scene.as_ref().map(|scene| scene.X_WO)
    }
}
