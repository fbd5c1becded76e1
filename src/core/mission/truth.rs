//! The ground truth of a simulated cell, for the reported errors. Control does not use it.

use super::errors::TrueGoal;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::robot::{Mount, Robot};
use crate::scene::SceneMotion;
use crate::servo::SetPoint;
use crate::time::SpanNs;
use nalgebra::{Point3, SVector, Vector2};

/// The true simulated cell.
#[derive(Debug, Clone)]
pub struct Truth<const N: usize> {
    /// The arm.
    pub robot: Robot<N>,
    /// The true mount of the camera.
    pub mount: Mount,
    /// Where each target is at the first tick, in the frame in which it rests, and how it moves from there, by the targets' numbers.
    pub objects: Vec<(Pose, SceneMotion)>,
    /// What the camera truly shows of them; `None` where nobody asks for it.
    pub sight: Option<TrueSight>,
}

/// The true lens beside the one that is believed, and the points of the targets in their true places.
#[derive(Debug, Clone)]
pub struct TrueSight {
    /// The true lens.
    pub camera: CameraModel,
    /// The one of the run file, by which features are normalized.
    pub believed: CameraModel,
    /// Of each target its points, m, by the targets' numbers.
    pub points: Vec<Vec<Point3<f64>>>,
}

impl TrueSight {
    /// The goal as it truly is, where it is an image ([`SetPoint::in_truth`]), and the focal lengths of the true lens, px.
    pub(super) fn goal(&self, goal: &SetPoint) -> Option<TrueGoal> {
        let points = self.points.get(goal.target() as usize)?;
        let i = self.camera.intrinsics();
        Some((goal.in_truth(&self.believed, &self.camera, points)?, Vector2::new(i.fx_px, i.fy_px)))
    }
}

impl<const N: usize> Truth<N> {
    /// The pose in the camera of an arm with joints at `q` of the target with this number, the given time after the first tick; `None` where there is none.
    #[must_use]
    pub fn X_CT(&self, target: u32, q: &SVector<f64, N>, since: SpanNs) -> Option<Pose> {
        let (X_WO, motion) = self.objects.get(target as usize)?;
        Some(self.mount.X_WC(&self.robot, q).inv_mul(&motion.object_at(X_WO, since)))
    }
}

/// The goal as the true lens has it, where it is an image and `truth` is known.
pub(super) fn true_goal<const N: usize>(truth: Option<&Truth<N>>, goal: &SetPoint) -> Option<TrueGoal> {
    truth?.sight.as_ref()?.goal(goal)
}
