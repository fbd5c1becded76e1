//! Where the interaction matrix of an image-based law is taken: features, and their depths.

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
    /// The same for all features at all times, m.
    Constant(f64),
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
