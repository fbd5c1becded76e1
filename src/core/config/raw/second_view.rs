//! `[second_view]`.

use super::{RawObject, RawPose, RawTarget};
use serde::{Deserialize, Serialize};

table! {
    /// What the second of two cameras sees and is to see, where both control the arm.
    RawSecondView {
        /// `[second_view.target]`: its target, with the keys of `[target]`
        target: RawTarget = RawTarget::default(),
        /// `[second_view.object]`: where that is in a simulated scene, with the keys of `[scene.object]`
        object: RawObject = RawObject::default(),
        /// `[second_view.desired]`: the pose that it shall have in this camera
        desired: RawPose = RawPose::default(),
        /// Weight of what this camera asks for; that of the first one is 1.
        weight: f64 = 1.0,
    }
}
