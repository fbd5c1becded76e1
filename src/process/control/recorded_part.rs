//! What there is to tell of a recording that begins after its run, as that of a black box does: what its records say, without running anything again.

use super::{Pace, run_files, summary};
use crate::config::assemble::control_loop;
use crate::config::{Clock, Config};
use crate::control::lifecycle::Request;
use crate::control::outcome::Outcome;
use crate::control::safety::Fault;
use crate::control::trace::Trace;
use crate::messages::CameraId;
use crate::replay::{RecordedRun, RecordedTick, ReplayError};
use crate::report::statistics::RunStatistics;
use crate::report::summary::{RECORDING_ENDS, Summary};
use crate::robot::Robot;
use std::io::Read;

/// What a run left.
pub struct RecordedResults {
    /// Its summary, without what only its processes knew: their use of the machine, wake-ups.
    pub summary: Summary,
    /// The files of its report that control writes, with their names.
    pub files: Vec<(&'static str, String)>,
    /// The last fault that was recorded.
    pub(super) last_fault: Option<Fault>,
}

/// Results of a part of a run of `config`. Without what only control and mission knew: accuracy, settling, what was estimated of arm and load.
pub(super) fn of_part<R: Read, const N: usize>(
    recorded: &mut RecordedRun<R>,
    config: &Config,
    robot: Robot<N>,
) -> Result<RecordedResults, ReplayError> {
    // Of a run that never begins: robot and goals are those of the run file.
    let run = control_loop(config, robot)?;
    let mut history = run_files::history(config, &run.mission);
    let mut statistics = RunStatistics::new(config.robot.joint_names());
    let mut part = Part::default();
    while let Some(RecordedTick { trace: record, measurement }) = recorded.next_tick()? {
        let trace = Trace::of_record(&record, config.clock == Clock::Realtime);
        if part.ticks == 0 {
            let begin = format!(
                "the recording begins at tick {} of the run: this is what its records tell",
                record.tick
            );
            statistics.note_event(trace.time, begin);
        }
        while let Some(request) = recorded.request_until(trace.time) {
            if let Some(asked) = Request::from_code(request.request).filter(|_| request.refusal == 0) {
                statistics.note_event(request.stamp, format!("{} on request", asked.as_str()));
            }
        }
        if let Some(m) = measurement.filter(|m| m.camera == u32::from(CameraId::FIRST)) {
            history.note_measurement(&m);
            part.measurements += 1;
        }
        history.note(&trace);
        statistics.note(&trace);
        part.note(trace);
    }
    let Some((first, last)) = part.first.zip(part.last) else { return Err(ReplayError::NoTicks) };
    let wall = last.time - first.time;
    let mut summary = summary(config, &run, &statistics, Pace::without_deadlines(), wall);
    summary.outcome = if part.fault.is_some() { Outcome::Fault } else { Outcome::Stopped };
    summary.reason = match (part.fault, recorded.gap().or(recorded.cut_off())) {
        (Some(fault), _) => fault.describe().into(),
        (None, Some(why)) => format!("{RECORDING_ENDS}: {why}"),
        (None, None) if last.over => "the run ended, and this recording does not tell why".into(),
        (None, None) => RECORDING_ENDS.into(),
    };
    (summary.duration_s, summary.ticks) = (wall.as_s(), part.ticks);
    summary.measurements = part.measurements;
    summary.final_errors.feature_error_px = part.error_px;
    summary.safety.state = last.state.as_str().into();
    summary.state_hash = None;
    let files = run_files::texts(config, &run, &history).map(|(name, text)| (name, text()));
    Ok(RecordedResults { summary, files: files.into(), last_fault: part.fault })
}

/// What is counted of a part.
#[derive(Default)]
struct Part {
    first: Option<Trace>,
    last: Option<Trace>,
    ticks: u64,
    measurements: u64,
    /// The last fault.
    fault: Option<Fault>,
    error_px: Option<f64>,
}

impl Part {
    fn note(&mut self, trace: Trace) {
        self.ticks += 1;
        self.first.get_or_insert(trace);
        self.fault = trace.fault.or(self.fault);
        let error_px = trace.measurement_record.map(|measurement| measurement.error_px);
        self.error_px = error_px.filter(|px| px.is_finite()).or(self.error_px);
        self.last = Some(trace);
    }
}
