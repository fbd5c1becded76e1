//! What the arm was found to carry.

use serde::{Deserialize, Serialize};

/// A payload that was estimated from the torques of the joints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FoundPayload {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the flange's frame, m; nearer to the flange than it is where that is not sure.
    pub com_m: [f64; 3],
}
