//! The end of a run: decided by goal, time, request, fault or last frame, with the reason why the goal was missed. That the arm is at rest before the
//! last command is ensured by [`ControlLoop`](crate::control::control_loop::ControlLoop).

use super::measurement_log::MeasurementLog;
use crate::control::outcome::{Finish, Outcome};
use crate::messages::{ControlState, TargetStatus};
use crate::target::PointKind;
use crate::time::SpanNs;

/// The end that was decided.
#[derive(Debug, Clone, Default)]
pub(crate) struct RunEnd {
    decided: Option<Finish>,
}

impl RunEnd {
    /// Decides the end of the run. The first decision counts, except that a fault replaces any other.
    pub(crate) fn decide(&mut self, finish: Finish) {
        let has_failed = self.decided.is_some_and(|f| f.outcome == Outcome::Fault);
        if self.decided.is_none() || (finish.outcome == Outcome::Fault && !has_failed) {
            self.decided = Some(finish);
        }
    }

    /// What was decided.
    pub(crate) fn decided(&self) -> Option<Finish> {
        self.decided
    }
}

/// The end of a run whose time is over.
pub(crate) fn time_is_up(
    closed_loop: bool,
    state: ControlState,
    when_late: Option<&'static str>,
    (measurements, points): (&MeasurementLog, PointKind),
) -> Finish {
    if !closed_loop {
        return Finish { outcome: Outcome::Finished, reason: "run.duration_s is over" };
    }
    let reason = when_late.unwrap_or_else(|| why_late(state, measurements, points));
    Finish { outcome: Outcome::NotConverged, reason }
}

/// The end of an open loop whose frames are over.
pub(super) const LAST_FRAME: Finish =
    Finish { outcome: Outcome::Finished, reason: "the last frame was used" };
/// The end of a closed loop whose camera has no more frames.
pub(super) const NO_MORE_FRAMES: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "the camera said that its last frame has come, before the goal was reached",
};
/// The end of a run whose arm was recorded.
pub(super) const MOTION_OVER: Finish =
    Finish { outcome: Outcome::Finished, reason: "the recorded motion of the arm is over" };

/// The reason of a run that a limit in space keeps from its goal.
pub(crate) const HELD_OFF: &str = "run.duration_s is over: a limit of [workspace] keeps the arm off its goal; the summary names it (safety.held_by)";
/// A limit in space that acted within this time before the end is its reason. Chosen by hand: the arm stands before it for as long as the run lasts, and noise of the view
/// lets it act now and then.
pub(crate) const LATELY: SpanNs = SpanNs(500_000_000);

/// The reason of a run whose target is found, in exposures that are too old to act on.
pub(super) const OLD_EXPOSURES: &str = "run.duration_s is over: the target was found, but each exposure was older than safety.measurement_timeout_ms when it arrived; check the camera's clock, \
                             camera.latency_ms and camera.stamp_offset_ms";

const NO_PAIR: &str = "run.duration_s is over: frames of the two cameras do not pair; see to both cameras and their trigger, or set \
                       cameras[1].stamp_offset_ms and stereo.pair_tolerance_ms";

/// The same words for each kind of target: what comes before its points, and after.
macro_rules! of_points {
    ($points:expr, $before:literal, $after:literal) => {
        match $points {
            PointKind::Dots => concat!($before, "the target's dots", $after),
            PointKind::BoardCorners => concat!($before, "the chessboard's corners", $after),
            PointKind::TagCorners => concat!($before, "the tag's corners", $after),
            PointKind::Outline => concat!($before, "the outline's points", $after),
        }
    };
}

fn why_late(state: ControlState, measurements: &MeasurementLog, points: PointKind) -> &'static str {
    match (state, measurements.last()) {
        (_, None) => "run.duration_s is over: no measurement ever came",
        (ControlState::Waiting, Some(m)) => match m.target_status() {
            TargetStatus::NoContrast => "run.duration_s is over: the frames have no contrast",
            TargetStatus::TooFewRegions => {
                "run.duration_s is over: the target was never seen, too few dark regions"
            }
            TargetStatus::Ambiguous if points == PointKind::TagCorners => {
                "run.duration_s is over: the target's tags are in view more than once each; cover the others, or print tags of other ids"
            }
            TargetStatus::Ambiguous => {
                of_points!(points, "run.duration_s is over: ", " could not be told apart")
            }
            TargetStatus::OtherTags => {
                "run.duration_s is over: the tags in view have other ids than the target's, which vision's log names; set target.tags.first_id"
            }
            TargetStatus::Mirrored => {
                "run.duration_s is over: the target is in the frames, but mirrored; switch the mirroring of the camera off (of V4L2 the control \
                 `horizontal_flip`), or of the program that gives the frames"
            }
            TargetStatus::WrongSize => "run.duration_s is over: frames have another size than the camera's",
            TargetStatus::Inconsistent => {
                of_points!(
                    points,
                    "run.duration_s is over: ",
                    " never fitted one pose; look for a shadow, glare or something in front, check [camera.lens] and [target], or allow for more \
                     (vision.model_sd_px)"
                )
            }
            TargetStatus::NoMatch => "run.duration_s is over: the target was never found",
            TargetStatus::GivenUp => {
                "run.duration_s is over: too much in the frames looks like a part of the target, its search was given up each time"
            }
            TargetStatus::NoPair => NO_PAIR,
            TargetStatus::TooFewShared => {
                "run.duration_s is over: the two cameras never saw three taught points together"
            }
            TargetStatus::Found if measurements.is_degraded() => {
                "run.duration_s is over: a part of the target was hidden all the time, and all of it is needed"
            }
            TargetStatus::Found => why_not_used(measurements).unwrap_or(
                "run.duration_s is over: the target was found, but its place too uncertain \
                 (servo.object.max_uncertainty_m)",
            ),
        },
        (ControlState::Holding | ControlState::Returning, Some(m)) if m.found() => {
            why_not_used(measurements).unwrap_or("run.duration_s is over: the target was lost")
        }
        (ControlState::Holding | ControlState::Returning, Some(m))
            if m.target_status() == TargetStatus::Inconsistent =>
        {
            of_points!(
                points,
                "run.duration_s is over: ",
                " fit no pose any more; look for a shadow, glare or something in front"
            )
        }
        (ControlState::Holding | ControlState::Returning, Some(m))
            if m.target_status() == TargetStatus::NoPair =>
        {
            NO_PAIR
        }
        (ControlState::Holding | ControlState::Returning, _) => "run.duration_s is over: the target was lost",
        (ControlState::Held, _) => {
            "run.duration_s is over: the arm was held, on request or since camera or vision was lost (safety.resume = \"manual\"), and nobody started it again"
        }
        _ => "run.duration_s is over before the goal was reached",
    }
}

/// The target was found, and the measurements could not be used: the most frequent reason for refusing them.
fn why_not_used(measurements: &MeasurementLog) -> Option<&'static str> {
    let verdicts = measurements.verdicts();
    let reasons = [
        (
            verdicts.refused_features,
            "run.duration_s is over: measurements carry other features than the set-point: camera, vision and control need the \
             same run file",
        ),
        (
            verdicts.refused_too_few,
            "run.duration_s is over: too much of the target was hidden for the law to go on",
        ),
        (
            verdicts.refused_no_pose,
            "run.duration_s is over: the law goes by the target's pose, and what was seen of it gave none: use a target of four points or more \
             in one plane, or servo.scheme = \"image_resolved_velocity\"",
        ),
        (
            verdicts.refused_singular,
            "run.duration_s is over: what was seen of the target fixes no motion of the camera: its points lie on a line or on each other",
        ),
        (
            verdicts.refused_pose,
            "run.duration_s is over: measurements carry poses that no object before a camera has: see to the vision process",
        ),
        (
            verdicts.refused_not_newer,
            "run.duration_s is over: the target was found, but in images or measurements that had come before; see to the camera, its driver and its clock",
        ),
        (
            verdicts.refused_from_future,
            "run.duration_s is over: exposure stamps lie too far in the future to be used; set camera.stamp_offset_ms",
        ),
        (
            verdicts.refused_too_old,
            "run.duration_s is over: exposures are too old to be used; check camera.latency_ms and \
             camera.stamp_offset_ms",
        ),
    ];
    reasons
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .max_by_key(|(count, _)| *count)
        .map(|(_, reason)| reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::safety::Fault;
    use crate::control::trace::Events;
    use crate::messages::Measurement;
    use crate::servo::{MeasurementVerdict, NoTask};

    const DONE: Finish = Finish { outcome: Outcome::Stopped, reason: "asked for" };

    /// The target is found and the law has no task for it: the end gives the reason.
    #[test]
    fn a_law_without_a_task_is_told() {
        let found = Measurement { status: TargetStatus::Found as u32, ..Measurement::default() };
        for (why, word) in [
            (NoTask::NoPose, "by the target's pose"),
            (NoTask::TooFew, "too much of the target was hidden"),
            (NoTask::Singular, "fixes no motion"),
        ] {
            let mut log = MeasurementLog::new();
            log.note(&found, Some(MeasurementVerdict::NoTask(why)), 1.0, &mut Events::default());
            let finish = time_is_up(true, ControlState::Waiting, None, (&log, PointKind::Dots));
            assert_eq!(finish.outcome, Outcome::NotConverged);
            assert!(finish.reason.contains(word), "{why:?}: {}", finish.reason);
        }
    }

    #[test]
    fn a_target_in_images_that_come_again_is_not_lost() {
        let found = Measurement { status: TargetStatus::Found as u32, ..Measurement::default() };
        let mut log = MeasurementLog::new();
        let reason = |log: &MeasurementLog| {
            time_is_up(true, ControlState::Holding, None, (log, PointKind::Dots)).reason
        };
        log.note(&found, Some(MeasurementVerdict::Used), 1.0, &mut Events::default());
        assert!(reason(&log).contains("the target was lost"));
        log.note(&found, Some(MeasurementVerdict::NotNewer), 1.0, &mut Events::default());
        assert!(reason(&log).contains("that had come before"), "{}", reason(&log));
    }

    #[test]
    fn an_arm_that_was_held_is_told() {
        let mut log = MeasurementLog::new();
        let found = Measurement { status: TargetStatus::Found as u32, ..Measurement::default() };
        log.note(&found, Some(MeasurementVerdict::Used), 1.0, &mut Events::default());
        let reason = time_is_up(true, ControlState::Held, None, (&log, PointKind::Dots)).reason;
        assert!(reason.contains("the arm was held"), "{reason}");
    }

    #[test]
    fn a_target_is_called_what_it_is() {
        for (points, status, word) in [
            (PointKind::Dots, TargetStatus::Inconsistent, "the target's dots never fitted"),
            (PointKind::TagCorners, TargetStatus::Inconsistent, "the tag's corners never fitted"),
            (PointKind::TagCorners, TargetStatus::Ambiguous, "in view more than once"),
            (PointKind::BoardCorners, TargetStatus::Ambiguous, "the chessboard's corners could not"),
            (PointKind::TagCorners, TargetStatus::OtherTags, "other ids"),
            (PointKind::TagCorners, TargetStatus::Mirrored, "mirrored"),
        ] {
            let seen = Measurement { status: status as u32, ..Measurement::default() };
            let mut log = MeasurementLog::new();
            log.note(&seen, None, 1.0, &mut Events::default());
            let reason = time_is_up(true, ControlState::Waiting, None, (&log, points)).reason;
            assert!(
                reason.contains(word) && !(points != PointKind::Dots && reason.contains("dots")),
                "{reason}"
            );
        }
    }

    #[test]
    fn a_fault_is_the_last_word() {
        let mut end = RunEnd::default();
        end.decide(DONE);
        end.decide(Finish { outcome: Outcome::Converged, reason: "too late" });
        assert_eq!(end.decided(), Some(DONE));
        end.decide(Finish::fault(Fault::TrackingError));
        end.decide(Finish::fault(Fault::DeadlinesMissed));
        assert_eq!(end.decided(), Some(Finish::fault(Fault::TrackingError)));
    }
}
