//! Where the interaction matrix of an image-based law is taken: features, and their depths.

use crate::geometry::Pose;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// Which depth goes into the interaction matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthSource {
    /// That of the desired pose (the textbook's choice).
    Desired,
    /// That of the estimated pose; of the desired one where a view has no pose.
    Estimated,
    /// That of the object's place as a simulation knows it; of the desired pose where it is not known.
    Known,
    /// That of the pose in the first measurement of the run that has one, kept from then on; that of the desired pose before it.
    Initial,
    /// The same for all features at all times, m.
    Constant(f64),
}

/// The depths that a pose `X_CO` gives to the points of an object: its third row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthRow([f64; 4]);

impl DepthRow {
    /// The third row of `X_CO`.
    #[must_use]
    pub fn of(X_CO: &Pose) -> Self {
        let R = X_CO.rotation.to_rotation_matrix();
        let row = R.matrix().row(2);
        Self([row[0], row[1], row[2], X_CO.translation.z])
    }

    /// Depth of the point `p_O`, m.
    #[must_use]
    #[inline(always)]
    pub fn depth_m(&self, p_O: &Point3<f64>) -> f64 {
        let [x, y, z, t] = self.0;
        x * p_O.x + y * p_O.y + z * p_O.z + t
    }
}

/// Which features go into the interaction matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InteractionAt {
    /// The current ones.
    Current,
    /// The desired ones, at their own depths.
    Desired,
    /// The mean of the two matrices.
    Mean,
}

/// Choice of the interaction matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interaction {
    /// Features.
    pub at: InteractionAt,
    /// Depths of the current features. At the desired features it is the depth of the desired pose, unless constant.
    pub depth: DepthSource,
}

impl Interaction {
    /// L_s(s, z_d): current features at the desired depth, as in Sect. 10.9.
    pub const TEXTBOOK: Self = Self { at: InteractionAt::Current, depth: DepthSource::Desired };
}
