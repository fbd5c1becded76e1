//! What a run leaves, from its recording: it is replayed, and counted and remembered as it was while it ran. Of a recording that begins after its run, what its records tell.

use super::deadlines::Deadlines;
use super::recorded_part::{RecordedResults, of_part};
use super::{Pace, run_files, summary};
use crate::config::{Clock, Config};
use crate::control::outcome::Outcome;
use crate::messages::CameraId;
use crate::mission::LockstepRun;
use crate::record::{FAILURE, KEPT_BECAUSE};
use crate::replay::{ControlAgain, How, RecordedRun, ReplayError};
use crate::report::summary::{RECORDING_ENDS, TickTimes};
use crate::robot::Robot;
use crate::sim::preflight::Preflight;
use crate::time::{MonoNs, SpanNs};
use std::io::Read;

/// Of a recording that is complete and has no end of its run.
const NO_END: &str = "no end of it was recorded: control was gone before it told one (was it killed?), or the recorder was ended first";

/// Results of a recorded run of `config`, or of the part of it that is recorded.
///
/// # Errors
/// When the recording cannot be replayed, or not to the bit.
pub fn recorded_results<R: Read>(
    recorded: &mut RecordedRun<R>,
    config: &Config,
) -> Result<RecordedResults, ReplayError> {
    let mut results = if recorded.is_part() {
        crate::dispatch_robot!(config.robot, |robot| of_part(recorded, config, robot))??
    } else {
        crate::dispatch_robot!(config.robot, |robot| of_robot(recorded, config, robot))??
    };
    let end = recorded.end()?;
    // Of a run that was told to end control does not know why; and a black box holds a part of a run, which is about its last fault.
    let of_box = end
        .get(KEPT_BECAUSE)
        .map(|why| results.last_fault.map_or_else(|| why.clone(), |fault| fault.describe().into()));
    if let Some(why) = end.get(FAILURE).cloned().or(of_box) {
        (results.summary.outcome, results.summary.reason) = (Outcome::Fault, why);
    }
    Ok(results)
}

fn of_robot<R: Read, const N: usize>(
    recorded: &mut RecordedRun<R>,
    config: &Config,
    robot: Robot<N>,
) -> Result<RecordedResults, ReplayError> {
    let mut again = ControlAgain::new(&recorded.config_before_drive(config, &robot), robot, How::Exactly)?;
    let mut history = run_files::history(config, &again.mission);
    let mut deadlines: Option<Deadlines> = None;
    let mut span = (MonoNs::ZERO, MonoNs::ZERO);
    let mut last_fault = None;
    let replayed = again.run(recorded, &mut |trace, measurement| {
        measurement
            .filter(|m| m.camera == u32::from(CameraId::FIRST))
            .into_iter()
            .for_each(|m| history.note_measurement(m));
        history.note(trace);
        last_fault = trace.fault.or(last_fault);
        let deadlines = deadlines.get_or_insert_with(|| {
            span.0 = trace.time;
            Deadlines::new(trace.time)
        });
        // Of the waking nothing is recorded.
        deadlines.woken(trace.time);
        deadlines.done(trace.commanded);
        span.1 = trace.commanded;
    })?;
    if let Some(difference) = replayed.difference {
        return Err(ReplayError::Differs(difference));
    }
    let pace = match (config.clock, deadlines) {
        (Clock::Realtime, Some(deadlines)) => Pace {
            missed_deadlines: deadlines.missed(),
            skipped_ticks: deadlines.skipped(),
            tick_us: TickTimes {
                wake: TickTimes::default().wake,
                step: TickTimes::default().step,
                ..deadlines.times()
            },
            ..Pace::without_deadlines()
        },
        _ => Pace::without_deadlines(),
    };
    let ControlAgain { control, mission, statistics, .. } = again;
    let run = LockstepRun { control, mission };
    let wall: SpanNs = span.1 - span.0;
    let mut summary = summary(config, &run, &statistics, pace, wall);
    summary.stability = Preflight::of(config).ok().and_then(|preflight| preflight.stability);
    if config.clock == Clock::Lockstep {
        // How long it took is not recorded.
        summary.wall_s = None;
    }
    let no_end = run.mission.finish().is_none().then(|| NO_END.to_owned());
    if let Some(why) = replayed.gap.or(replayed.cut_off).or(no_end) {
        summary.reason = format!("{RECORDING_ENDS}: {why}");
    }
    let files = run_files::texts(config, &run, &history).map(|(name, text)| (name, text()));
    Ok(RecordedResults { summary, files: files.into(), last_fault })
}
