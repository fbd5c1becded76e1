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
    /// Where the object is at the first tick, in the frame in which it rests.
    pub X_WO: Pose,
    /// The same of the further targets, which rest.
    pub further_X_WO: Vec<Pose>,
    /// How it moves from there.
    pub motion: SceneMotion,
}

impl<const N: usize> Truth<N> {
    /// The pose in the camera of the target with this number, 0 being [`Self::X_CO`]'s; `None` where there is none.
    #[must_use]
    pub fn X_CT(&self, target: u32, q: &SVector<f64, N>, since: SpanNs) -> Option<Pose> {
        let Some(further) = (target as usize).checked_sub(1) else { return Some(self.X_CO(q, since)) };
        Some(self.mount.X_WC(&self.robot, q).inv_mul(self.further_X_WO.get(further)?))
    }

    /// The pose of the object in the camera of an arm with joints at `q`, the given time after the first tick.
    #[must_use]
    pub fn X_CO(&self, q: &SVector<f64, N>, since: SpanNs) -> Pose {
        self.mount.X_WC(&self.robot, q).inv_mul(&self.motion.object_at(&self.X_WO, since))
    }
}
