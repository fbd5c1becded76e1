//! A recording as control saw it: tick by tick, each with the measurement that was taken at it. Records of one instant stand within a few seconds of
//! each other in a file, so that a run of hours needs no more memory than one of seconds.

use super::ReplayError;
use crate::config::assemble::before_drive;
use crate::config::{Config, DriveKind};
use crate::control::trace::FrameStamps;
use crate::drive::DriveProperties;
use crate::messages::{DriveTextMsg, Measurement, RequestMsg, TraceMsg, text_kind, trace_flag};
use crate::record::{END, RUN_FILE, RecordingReader};
use crate::robot::Robot;
use crate::time::MonoNs;
use std::collections::{BTreeMap, VecDeque};
use std::io::Read;
use std::path::Path;

/// Ticks that are read ahead, so that what belongs to one has been read, wherever in the file it stands. Derived: the longest queue on the way into a
/// recording holds 1024 ticks, and twice of it can lie between two services that are read by turns; twice of that for what comes late from clients.
const AHEAD: usize = 4096;

/// One tick with what control took at it.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedTick {
    /// Its record.
    pub trace: TraceMsg,
    /// The measurement that was taken.
    pub measurement: Option<Measurement>,
}

/// Reads a recording for control.
pub struct RecordedRun<R: Read> {
    reader: RecordingReader<R>,
    traces: VecDeque<TraceMsg>,
    measurements: VecDeque<Measurement>,
    requests: VecDeque<RequestMsg>,
    /// What an external drive told of itself, before control was made.
    drive: Option<DriveProperties>,
    /// Number of the next record of control.
    next: u64,
    /// Of a recording that begins after its run, from which nothing can be run again: what is missing in between ends nothing.
    is_part: bool,
    /// Whether the last record of the run was given.
    is_over: bool,
    /// Why there is no more, where the file goes on.
    gap: Option<String>,
}

/// The run file in a recording with settings `set`, and its text. Paths in it are absolute.
///
/// # Errors
/// When there is none, or not one of this version.
pub fn recorded_config<R: Read>(reader: &RecordingReader<R>, set: &[String]) -> Result<Config, ReplayError> {
    let text = reader.attachments().get(RUN_FILE).ok_or(ReplayError::NoRunFile)?;
    Ok(Config::parse(RUN_FILE, &String::from_utf8_lossy(text), Path::new("/"), set)?)
}

impl<R: Read> RecordedRun<R> {
    /// Of a recording from whose messages nothing was taken yet.
    ///
    /// # Errors
    /// When it has no tick, or not the first one.
    pub fn new(reader: RecordingReader<R>) -> Result<Self, ReplayError> {
        let run = Self::of_any(reader)?;
        if run.is_part { Err(ReplayError::NoBegin(run.next)) } else { Ok(run) }
    }

    /// The same, also of one that begins after its run ([`Self::is_part`]).
    ///
    /// # Errors
    /// When it has no tick.
    pub fn of_any(reader: RecordingReader<R>) -> Result<Self, ReplayError> {
        let mut run = Self {
            reader,
            traces: VecDeque::new(),
            measurements: VecDeque::new(),
            requests: VecDeque::new(),
            drive: None,
            next: 0,
            is_part: false,
            is_over: false,
            gap: None,
        };
        run.fill()?;
        run.next = run.traces.front().ok_or(ReplayError::NoTicks)?.sequence;
        run.is_part = run.next > 0;
        Ok(run)
    }

    /// Whether it begins after its run, as that of a black box: what control knew by then is not in it, and ticks may be missing.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.is_part
    }

    /// Reads until enough ticks lie ahead, or to the end.
    fn fill(&mut self) -> Result<(), ReplayError> {
        while self.traces.len() < AHEAD {
            let Some(message) = self.reader.next_message()? else { break };
            match message.topic() {
                "/control/trace" => self.traces.push_back(message.record()?),
                "/control/request" => self.requests.push_back(message.record()?),
                "/drive/text" => {
                    let text: DriveTextMsg = message.record()?;
                    if text.kind == text_kind::PROPERTIES && self.drive.is_none() {
                        self.drive = DriveProperties::parse(&text.text()).ok();
                    }
                }
                topic if topic.starts_with("/vision/") => self.measurements.push_back(message.record()?),
                _ => {}
            }
        }
        Ok(())
    }

    /// The next tick; `None` at the end, and where something is missing ([`Self::gap`]).
    ///
    /// # Errors
    /// When the file cannot be read, or has records of another version.
    pub fn next_tick(&mut self) -> Result<Option<RecordedTick>, ReplayError> {
        self.fill()?;
        let Some(trace) = self.traces.pop_front().filter(|_| self.gap.is_none()) else { return Ok(None) };
        if self.is_part && trace.sequence > self.next {
            self.next = trace.sequence;
        }
        if trace.sequence != self.next {
            self.gap = Some(match trace.sequence {
                0 => format!("another run begins after tick {} of control", self.next),
                later => format!("{} ticks are missing before tick {}", later - self.next, trace.tick),
            });
            return Ok(None);
        }
        self.next += 1;
        self.is_over = trace.flags & trace_flag::LAST != 0;
        let mut measurement = None;
        if trace.flags & trace_flag::MEASUREMENT != 0 {
            let found =
                self.measurements.iter().position(|m| FrameStamps::of(m) == FrameStamps::of_record(&trace));
            if found.is_none() && self.is_part {
                return Ok(Some(RecordedTick { trace, measurement }));
            }
            let Some(at) = found else {
                self.gap = Some(format!(
                    "the measurement of frame {} is missing, which control took at tick {}",
                    trace.frame_id, trace.tick
                ));
                return Ok(None);
            };
            measurement = self.measurements.remove(at);
            // Those of its camera before it were overtaken.
            let mut place = 0..;
            let is_before = |place: Option<usize>| place.is_some_and(|place| place < at);
            self.measurements.retain(|m| !is_before(place.next()) || m.camera != trace.camera);
        }
        Ok(Some(RecordedTick { trace, measurement }))
    }

    /// The configuration with which control was made of `config` before the drive of the recording.
    #[must_use]
    pub fn config_before_drive<const N: usize>(&self, config: &Config, robot: &Robot<N>) -> Config {
        match &self.drive {
            Some(told) if config.drive.kind == DriveKind::External => before_drive(config, robot, told).0,
            _ => config.clone(),
        }
    }

    /// The next request that was answered by `time`, of those that have been read.
    pub fn request_until(&mut self, time: MonoNs) -> Option<RequestMsg> {
        self.requests.pop_front_if(|request| request.stamp <= time)
    }

    /// The requests that have been read, in the order of their answers.
    pub(super) fn requests(&mut self) -> impl Iterator<Item = RequestMsg> {
        self.requests.drain(..)
    }

    /// What the file tells of its end; reads on to there.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn end(&mut self) -> Result<BTreeMap<String, String>, ReplayError> {
        while self.reader.next_message()?.is_some() {}
        Ok(self.reader.metadata().get(END).cloned().unwrap_or_default())
    }

    /// What is missing, where the run cannot be followed any further.
    #[must_use]
    pub fn gap(&self) -> Option<&str> {
        self.gap.as_deref()
    }

    /// Why the file has no end of its own, where the run has none either.
    #[must_use]
    pub fn cut_off(&self) -> Option<&str> {
        self.reader.cut_off().filter(|_| !self.is_over)
    }
}
