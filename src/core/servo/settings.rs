//! Settings of visual servoing that are fixed for a run. What changes during a run, the set-point and the share of the gain, is not part of them.

use super::{EstimationSettings, GoalPath, Law, ObjectDynamics, VisibilityGuard};
use crate::geometry::Pose;
use crate::robot::Mount;
use crate::time::SpanNs;
use serde::{Deserialize, Serialize};

/// When the servo law is computed, and for which view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UpdatePolicy {
    /// Once for each measurement; the law output is held.
    Frame,
    /// At every tick with the newest joint positions; the feature error is held.
    Tick,
    /// At every tick, for the view predicted at that tick from the last exposure by the known motion of the arm.
    Predict,
}

/// Settings of visual servoing that are fixed for a run.
#[derive(Debug, Clone)]
pub struct ServoSettings {
    /// Law and gains.
    pub law: Law,
    /// When the law is computed.
    pub update: UpdatePolicy,
    /// Where the camera is mounted: eye-in-hand or eye-to-hand.
    pub mount: Mount,
    /// True poses of the targets in the frame W in which they rest, by the targets' numbers, where a simulation has them; used for
    /// [`DepthSource::Known`](super::DepthSource::Known) alone.
    pub X_WO: Vec<Pose>,
    /// Smooth start: rate at which the first velocity is faded in, 1/s; `None` applies it at once.
    pub smooth_start_1_s: Option<f64>,
    /// Speed of the camera in its first motion, until the image was seen to move as it should, m/s; `None` for no bound.
    pub first_motion_m_s: Option<f64>,
    /// Secondary task: gain of the motion away from joint limits, 1/s.
    pub limit_avoidance_1_s: Option<f64>,
    /// Keeps the features in the image by modifying the law output.
    pub visibility: Option<VisibilityGuard>,
    /// Dynamics for the estimate of the object's own motion: `predict` then predicts views by it too, and velocity laws add its feed-forward. `None`
    /// for an object at rest.
    pub object: Option<ObjectDynamics>,
    /// The path of the goal, from the first law output on; `None` for a goal at rest.
    pub path: Option<GoalPath>,
    /// Age of the view that a law held between measurements would use: latency and, in the mean, half of a frame's period, at most a whole one.
    /// The gain under `predict` is raised so that the error falls as fast as it would under such a held law.
    pub held_lag: SpanNs,
    /// Gain near the goal, 1/s, to which a higher one is reduced where encoder steps and noise would move the arm.
    pub gain_at_goal_1_s: f64,
    /// Whether the arm returns to the posture of the last complete view when the target is lost.
    pub returns: bool,
    /// For how long at most an arm that does not see the target from there looks around; `None`: not at all.
    pub search: Option<SpanNs>,
    /// Whether consecutive views are compared to estimate joint motion that coarse encoders do not show ([`super::UnobservedMotion`]).
    pub watches_drift: bool,
    /// Lag of the drive: by how much later the arm follows its commands. `predict` predicts the view that far ahead.
    pub lead: SpanNs,
    /// The image Jacobian is learnt from the arm's motion, and neither lens, mount, target nor pose is used; `None` for one that is computed from them.
    pub estimation: Option<EstimationSettings>,
}

impl ServoSettings {
    /// Settings without smooth start and secondary task.
    #[must_use]
    pub fn new(law: Law, update: UpdatePolicy, mount: Mount) -> Self {
        Self {
            law,
            update,
            mount,
            X_WO: Vec::new(),
            smooth_start_1_s: None,
            first_motion_m_s: None,
            limit_avoidance_1_s: None,
            visibility: None,
            object: None,
            path: None,
            held_lag: SpanNs::ZERO,
            gain_at_goal_1_s: f64::INFINITY,
            returns: false,
            search: None,
            watches_drift: false,
            lead: SpanNs::ZERO,
            estimation: None,
        }
    }
}
