//! What visual servoing is made of. What changes while it goes on, goal and pace, is none of it.

use super::{Law, ObjectDynamics, VisibilityGuard};
use crate::geometry::Pose;
use crate::robot::Mount;
use crate::time::SpanNs;
use serde::{Deserialize, Serialize};

/// When the servo law is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UpdatePolicy {
    /// Once for each measurement; the law output is held.
    Frame,
    /// At every tick with the newest joint positions; the feature error is held.
    Tick,
    /// At every tick for the view of that tick, carried there from the last exposure by the arm's own motion.
    Predict,
}

/// What visual servoing is made of.
#[derive(Debug, Clone)]
pub struct ServoSettings {
    /// Law and gains.
    pub law: Law,
    /// When the law is computed.
    pub update: UpdatePolicy,
    /// Where the camera sits.
    pub mount: Mount,
    /// The object in the frame W in which it rests, where a simulation knows it; for the true depth only.
    pub X_WO: Option<Pose>,
    /// Smooth start: rate at which the first velocity is let in, 1/s; `None` starts at once.
    pub smooth_start_1_s: Option<f64>,
    /// Secondary task: gain of the motion away from joint limits, 1/s.
    pub limit_avoidance_1_s: Option<f64>,
    /// Keeps features in the image.
    pub visibility: Option<VisibilityGuard>,
    /// Estimates the object's own motion: `predict` then carries views by it too, and velocity laws follow it. `None`
    /// for an object at rest.
    pub object: Option<ObjectDynamics>,
    /// Age of what the law would work with if it were held between measurements: latency and, in the mean, half of a frame's
    /// period, at most a whole one. What `predict` asks for is quicker by so much as such a law would be for it.
    pub held_lag: SpanNs,
    /// Gain to which a higher one falls near the goal, where encoders and noise would make the arm tremble, 1/s.
    pub gain_at_goal_1_s: f64,
    /// Goes back to where the whole target was seen last when it is lost.
    pub returns: bool,
    /// Whether views are compared for motion that coarse encoders do not tell ([`super::Drift`]).
    pub watches_drift: bool,
    /// How much later the arm moves as it is told: the lag of a drive. `predict` looks so far ahead.
    pub lead: SpanNs,
}

impl ServoSettings {
    /// Settings without smooth start and secondary task.
    #[must_use]
    pub fn new(law: Law, update: UpdatePolicy, mount: Mount) -> Self {
        Self {
            law,
            update,
            mount,
            X_WO: None,
            smooth_start_1_s: None,
            limit_avoidance_1_s: None,
            visibility: None,
            object: None,
            held_lag: SpanNs::ZERO,
            gain_at_goal_1_s: f64::INFINITY,
            returns: false,
            watches_drift: false,
            lead: SpanNs::ZERO,
        }
    }
}
