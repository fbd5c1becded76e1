//! What a calibration run is to remember: where the joints were, and what the camera saw of the target.

use super::JointTrack;
use crate::geometry::Pose;
use crate::messages::{JointState, MAX_FEATURES, Measurement};
use crate::time::MonoNs;
use nalgebra::{SVector, Vector2};

/// Number of joint states that are kept before the target is first in view. Chosen by hand: 2 s, more than any offset that is searched.
const STATES_BEFORE: usize = 2000;

/// The target in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetDetection {
    /// What the camera says of the middle of the exposure.
    pub stamp: MonoNs,
    /// The object's pose, where vision found it.
    pub X_CO: Option<Pose>,
    points: [DetectedPoint; MAX_FEATURES],
    count: usize,
}

/// One point of it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DetectedPoint {
    /// Normalized coordinates, undistorted.
    pub s: Vector2<f64>,
    /// Standard deviation of each coordinate, px; 0 where it is not known.
    pub sd_px: f64,
}

impl TargetDetection {
    /// The target of a measurement; `None` where there is none, or not a finite one.
    #[must_use]
    pub fn of(m: &Measurement) -> Option<Self> {
        let mut points = [DetectedPoint::default(); MAX_FEATURES];
        let mut count = 0;
        for (point, f) in points.iter_mut().zip(m.features()).filter(|_| m.found()) {
            *point = DetectedPoint { s: Vector2::new(f.x, f.y), sd_px: f.sd_px };
            count += 1;
        }
        let finite = points.iter().all(|p| p.s.iter().all(|c| c.is_finite()) && p.sd_px.is_finite());
        (count > 0 && finite).then(|| Self { stamp: m.exposure, X_CO: m.pose(), points, count })
    }

    /// The points, in the order of the target's.
    #[must_use]
    pub fn points(&self) -> &[DetectedPoint] {
        self.points.get(..self.count).unwrap_or(&self.points)
    }

    #[cfg(test)]
    pub(super) fn with_sd_px(mut self, sd_px: f64) -> Self {
        self.points.iter_mut().for_each(|p| p.sd_px = sd_px);
        self
    }
}

/// Joint states and detections of the target in one run.
#[derive(Debug, Clone, Default)]
pub struct Recording<const N: usize> {
    /// The joints.
    pub track: JointTrack<N>,
    /// The target, in the order in which measurements came.
    pub observations: Vec<TargetDetection>,
}

impl<const N: usize> Recording<N> {
    /// Takes in where the encoders saw the joints. What a simulation knows beyond is left aside.
    pub fn note_state(&mut self, state: &JointState) {
        if self.observations.is_empty() && self.track.len() >= STATES_BEFORE {
            self.track.keep_newest(STATES_BEFORE / 2);
        }
        let joints = |all: &[f64]| SVector::from_fn(|i, _| all.get(i).copied().unwrap_or_default());
        self.track.push(state.stamp, joints(&state.q), joints(&state.qd));
    }

    /// Takes in what the camera saw.
    pub fn note_measurement(&mut self, m: &Measurement) {
        self.observations.extend(TargetDetection::of(m));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::TargetStatus;

    fn found() -> Measurement {
        let mut m =
            Measurement { feature_count: 4, status: TargetStatus::Found as u32, ..Measurement::default() };
        m.features[1].x = 0.25;
        m
    }

    #[test]
    fn only_a_finite_target_is_a_detection() {
        assert_eq!(TargetDetection::of(&found()).unwrap().points().len(), 4);
        assert_eq!(TargetDetection::of(&found()).unwrap().points()[1].s.x, 0.25);
        assert!(TargetDetection::of(&Measurement { feature_count: 4, ..Measurement::default() }).is_none());
        let mut broken = found();
        broken.features[3].y = f64::NAN;
        assert!(TargetDetection::of(&broken).is_none());
    }

    #[test]
    fn waiting_for_the_target_fills_no_memory() {
        let mut recording = Recording::<4>::default();
        let note = |recording: &mut Recording<4>, ms: i64| {
            recording.note_state(&JointState { stamp: MonoNs(ms * 1_000_000), ..JointState::default() });
        };
        (0..10_000).for_each(|ms| note(&mut recording, ms));
        assert!((STATES_BEFORE / 2..=STATES_BEFORE).contains(&recording.track.len()));
        recording.note_measurement(&found());
        let before = recording.track.len();
        (10_000..15_000).for_each(|ms| note(&mut recording, ms));
        assert_eq!(recording.track.len(), before + 5_000, "from then on every state counts");
    }
}
