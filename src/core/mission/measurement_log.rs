//! The log of the measurements that reached control, for the goal, the status and the reason of an end.

use super::model_error::ModelErrorLog;
use crate::control::trace::{Event, Events, LatencyStages};
use crate::messages::Measurement;
use crate::servo::{MeasurementVerdict, NoTask};
use crate::time::SpanNs;
use serde::{Deserialize, Serialize};

/// Counts of the measurements that reached control, by verdict.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VerdictCounts {
    /// Used by the servo law.
    pub used: u64,
    /// Likewise, although their stamps lay in the future.
    pub used_from_future: u64,
    /// Without a target.
    pub no_target: u64,
    /// Of the used ones: those in which a part of the target was hidden.
    #[serde(default)]
    pub degraded: u64,
    /// Refused: none of the set-point's features.
    #[serde(default)]
    pub refused_features: u64,
    /// Refused: of another target than the goal, just after the target was changed.
    #[serde(default)]
    pub refused_target: u64,
    /// Refused: so much of the target was hidden that the law had no answer.
    #[serde(default)]
    pub refused_too_few: u64,
    /// Refused: the law needs a pose, and there was none.
    #[serde(default)]
    pub refused_no_pose: u64,
    /// Refused: the visible features do not determine a motion.
    #[serde(default)]
    pub refused_singular: u64,
    /// Refused: an impossible pose.
    #[serde(default)]
    pub refused_pose: u64,
    /// Refused by vision: the points do not fit one pose.
    #[serde(default)]
    pub refused_inconsistent: u64,
    /// Refused: repeated, or overtaken by a newer one.
    pub refused_not_newer: u64,
    /// Refused: too far in the future.
    pub refused_from_future: u64,
    /// Refused: older than the joint history.
    pub refused_too_old: u64,
}

/// What vision counts by itself, from its start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct VisionCounts {
    /// Frames that it received.
    pub frames: u64,
    /// Frames that it skipped.
    pub frames_dropped: u64,
    /// How often it lost the target.
    pub target_lost: u64,
}

impl VisionCounts {
    fn of(m: &Measurement) -> Self {
        Self { frames: m.frames_received, frames_dropped: m.frames_dropped, target_lost: m.target_lost }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            frames: self.frames.saturating_add(other.frames),
            frames_dropped: self.frames_dropped.saturating_add(other.frames_dropped),
            target_lost: self.target_lost.saturating_add(other.target_lost),
        }
    }
}

/// The measurements of a run.
#[derive(Debug, Clone)]
pub struct MeasurementLog {
    count: u64,
    verdict: VerdictCounts,
    last: Option<Measurement>,
    /// Counts of vision processes before the one that sent the last measurement.
    earlier: VisionCounts,
    last_found: Option<Measurement>,
    error_px: f64,
    latency: LatencyStages,
    degraded: bool,
    model_error: ModelErrorLog,
}

impl MeasurementLog {
    pub(super) fn new() -> Self {
        Self {
            count: 0,
            verdict: VerdictCounts::default(),
            last: None,
            earlier: VisionCounts::default(),
            last_found: None,
            error_px: f64::NAN,
            latency: LatencyStages::default(),
            degraded: false,
            model_error: ModelErrorLog::new(),
        }
    }

    /// Takes in a measurement; `error_px` is its feature error, or NaN where it has none.
    pub(super) fn note(
        &mut self,
        m: &Measurement,
        verdict: Option<MeasurementVerdict>,
        error_px: f64,
        events: &mut Events,
    ) {
        self.count += 1;
        // A count that falls is that of a vision process that was started anew.
        if let Some(last) = self.last.filter(|last| m.frames_received < last.frames_received) {
            self.earlier = self.earlier.plus(VisionCounts::of(&last));
        }
        self.last = Some(*m);
        if !error_px.is_nan() {
            self.last_found = Some(*m);
            self.error_px = error_px;
        }
        // The description that it is held against is that of the first target.
        if m.found() && m.target_number == 0 {
            self.model_error.note(m);
        }
        if let Some(verdict) = verdict {
            self.taken(verdict, events);
        }
    }

    /// The goal is another one: the error is not that of it.
    pub(super) fn forget_error(&mut self) {
        self.error_px = f64::NAN;
    }

    /// What was seen before is of another target than the goal.
    pub(super) fn forget_view(&mut self) {
        (self.last_found, self.error_px) = (None, f64::NAN);
    }

    fn taken(&mut self, verdict: MeasurementVerdict, events: &mut Events) {
        let counts = &mut self.verdict;
        let first_from_future = counts.used_from_future + counts.refused_from_future == 0;
        let first_impossible = counts.refused_pose == 0;
        let first_inconsistent = counts.refused_inconsistent == 0;
        *match verdict {
            MeasurementVerdict::Used => &mut counts.used,
            MeasurementVerdict::UsedFromFuture => &mut counts.used_from_future,
            MeasurementVerdict::NoTarget => &mut counts.no_target,
            MeasurementVerdict::NoTask(NoTask::NoPose) => &mut counts.refused_no_pose,
            MeasurementVerdict::NoTask(NoTask::TooFew) => &mut counts.refused_too_few,
            MeasurementVerdict::NoTask(NoTask::Singular) => &mut counts.refused_singular,
            MeasurementVerdict::OtherFeatures => &mut counts.refused_features,
            MeasurementVerdict::OtherTarget => &mut counts.refused_target,
            MeasurementVerdict::TooFewFeatures => &mut counts.refused_too_few,
            MeasurementVerdict::ImpossiblePose => &mut counts.refused_pose,
            MeasurementVerdict::Inconsistent => &mut counts.refused_inconsistent,
            MeasurementVerdict::NotNewer => &mut counts.refused_not_newer,
            MeasurementVerdict::RefusedFromFuture => &mut counts.refused_from_future,
            MeasurementVerdict::TooOld => &mut counts.refused_too_old,
        } += 1;
        if first_from_future
            && matches!(verdict, MeasurementVerdict::UsedFromFuture | MeasurementVerdict::RefusedFromFuture)
        {
            events.push(Event::StampFromFuture);
        }
        if first_impossible && verdict == MeasurementVerdict::ImpossiblePose {
            events.push(Event::ImpossiblePose);
        }
        if first_inconsistent && verdict == MeasurementVerdict::Inconsistent {
            events.push(Event::Inconsistent);
        }
    }

    /// Whether a part of the target was hidden in a measurement that was used.
    pub(super) fn note_degraded(&mut self, degraded: bool, events: &mut Events) {
        self.verdict.degraded += u64::from(degraded);
        if degraded != self.degraded {
            self.degraded = degraded;
            events.push(if degraded { Event::Degraded } else { Event::WholeAgain });
        }
    }

    /// Whether features were hidden in the last one that was used.
    pub(super) fn is_degraded(&self) -> bool {
        self.degraded
    }

    /// The command that used the last one was written.
    pub(super) fn commanded(&mut self, latency: Option<LatencyStages>) {
        self.latency = latency.unwrap_or(self.latency);
    }

    /// Whether the last one that was used was older than `timeout` when it acted.
    pub(super) fn are_older_than(&self, timeout: SpanNs) -> bool {
        self.latency.exposure_to_command.is_some_and(|age| age > timeout)
    }

    /// Measurements that fit the description only with a model error.
    pub fn model_error(&self) -> &ModelErrorLog {
        &self.model_error
    }

    /// Good and bad measurements that reached control.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The counts by verdict.
    pub fn verdicts(&self) -> &VerdictCounts {
        &self.verdict
    }

    /// The newest one.
    pub fn last(&self) -> Option<&Measurement> {
        self.last.as_ref()
    }

    /// What vision counted since the begin of the run, over all its processes.
    pub fn vision_counts(&self) -> VisionCounts {
        self.earlier.plus(self.last.as_ref().map(VisionCounts::of).unwrap_or_default())
    }

    /// The newest one with a feature error.
    pub(super) fn last_found(&self) -> Option<&Measurement> {
        self.last_found.as_ref()
    }

    /// Root mean square feature error of that one, px; NaN before the first.
    pub(super) fn error_px(&self) -> f64 {
        self.error_px
    }

    /// The stages of the newest measurement that was commanded.
    pub(super) fn latency(&self) -> &LatencyStages {
        &self.latency
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_go_on_over_a_vision_that_began_anew() {
        let mut measurements = MeasurementLog::new();
        assert_eq!(measurements.vision_counts(), VisionCounts::default());
        for (received, dropped, lost) in [(1, 0, 0), (7, 2, 1), (1, 0, 0), (3, 1, 0), (3, 1, 0), (1, 0, 2)] {
            let m = Measurement {
                frames_received: received,
                frames_dropped: dropped,
                target_lost: lost,
                ..Measurement::default()
            };
            measurements.note(&m, None, f64::NAN, &mut Events::default());
        }
        let counts = measurements.vision_counts();
        assert_eq!((counts.frames, counts.frames_dropped, counts.target_lost), (7 + 3 + 1, 2 + 1, 1 + 2));
    }

    #[test]
    fn refused_measurements_are_counted_and_told_once() {
        let mut measurements = MeasurementLog::new();
        let mut events = Events::default();
        let (inconsistent, pose) = (MeasurementVerdict::Inconsistent, MeasurementVerdict::ImpossiblePose);
        for verdict in [inconsistent, inconsistent, pose, inconsistent, MeasurementVerdict::NoTarget, pose] {
            measurements.note(&Measurement::default(), Some(verdict), f64::NAN, &mut events);
        }
        let counts = VerdictCounts {
            no_target: 1,
            refused_pose: 2,
            refused_inconsistent: 3,
            ..VerdictCounts::default()
        };
        assert_eq!(*measurements.verdicts(), counts);
        assert_eq!(events.iter().collect::<Vec<_>>(), [Event::Inconsistent, Event::ImpossiblePose]);
    }
}
