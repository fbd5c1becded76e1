//! What is true in a simulated cell: errors are told against it. Nothing that control does depends on it.

use crate::geometry::Pose;
use crate::robot::{Mount, Robot};
use crate::scene::SceneMotion;
use crate::time::SpanNs;
use nalgebra::SVector;

/// The simulated cell as it is.
#[derive(Debug, Clone)]
pub struct Truth<const N: usize> {
    /// The arm.
    pub robot: Robot<N>,
    /// Where the camera sits.
    pub mount: Mount,
    /// Where the object is at the first tick, in the frame in which it rests.
    pub X_WO: Pose,
    /// How it moves from there.
    pub motion: SceneMotion,
}

impl<const N: usize> Truth<N> {
    /// The object before the camera of an arm whose joints are at `q`, so long after the first tick.
    #[must_use]
    pub fn X_CO(&self, q: &SVector<f64, N>, since: SpanNs) -> Pose {
        self.mount.X_WC(&self.robot.forward(q)).inv_mul(&self.motion.object_at(&self.X_WO, since))
    }
}
