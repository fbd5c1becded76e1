//! The ground truth of a simulated cell, for the reported errors. Control does not use it.

use crate::geometry::Pose;
use crate::robot::{Mount, Robot};
use crate::scene::SceneMotion;
use crate::time::SpanNs;
use nalgebra::SVector;

/// The true simulated cell.
#[derive(Debug, Clone)]
pub struct Truth<const N: usize> {
    /// The arm.
    pub robot: Robot<N>,
    /// The true mount of the camera.
    pub mount: Mount,
    /// Where each target is at the first tick, in the frame in which it rests, and how it moves from there, by the targets' numbers.
    pub objects: Vec<(Pose, SceneMotion)>,
}

impl<const N: usize> Truth<N> {
    /// The pose in the camera of an arm with joints at `q` of the target with this number, the given time after the first tick; `None` where there is none.
    #[must_use]
    pub fn X_CT(&self, target: u32, q: &SVector<f64, N>, since: SpanNs) -> Option<Pose> {
        let (X_WO, motion) = self.objects.get(target as usize)?;
        Some(self.mount.X_WC(&self.robot, q).inv_mul(&motion.object_at(X_WO, since)))
    }
}
