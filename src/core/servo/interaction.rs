//! At which features and depths the interaction matrix L_s of an image-based law is evaluated, as it enters (10.84), (10.89) and (10.91).
//!
//! The law's estimate of L_s may use the current or the desired features, or the mean of both matrices ([`InteractionAt`]), and depths from several
//! sources ([`DepthSource`]). None of these moves the goal; they change the path and the stability ([`super::StabilityMargin`]).

use crate::geometry::Pose;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// Which depth goes into the interaction matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthSource {
    /// That of the desired pose (the textbook's choice).
    Desired,
    /// That of the measured pose; that of the desired pose where a view has none.
    Estimated,
    /// That of the true pose of a simulation; that of the desired pose where there is none.
    Known,
    /// That of the pose in the first measurement of the run that has one, kept from then on; that of the desired pose before it.
    Initial,
    /// A constant for all features at all times, m.
    Constant(f64),
}

/// The third row of a pose `X_CO`, which gives the depth of each point of the object.
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

    /// Depth z of the point `p_O` (object frame, m) in C, m.
    #[must_use]
    #[inline(always)]
    pub fn depth_m(&self, p_O: &Point3<f64>) -> f64 {
        let [x, y, z, t] = self.0;
        x * p_O.x + y * p_O.y + z * p_O.z + t
    }
}

/// At which features the interaction matrix is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InteractionAt {
    /// The current features.
    Current,
    /// The desired features, at their own depths.
    Desired,
    /// The mean of the matrices at current and desired features.
    Mean,
    /// None that is computed: the image Jacobian is learnt from the arm's motion. Where a matrix is asked for all the same, it is the mean.
    Estimated,
}

/// Choice of the interaction matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interaction {
    /// At which features.
    pub at: InteractionAt,
    /// Depths of the current features. At the desired features it is the depth of the desired pose, unless constant.
    pub depth: DepthSource,
}

impl Interaction {
    /// L_s(s, z_d): current features at the desired depth, as in Sect. 10.9.
    pub const TEXTBOOK: Self = Self { at: InteractionAt::Current, depth: DepthSource::Desired };
}
