//! What is known of a run that is watched: the newest records, and what is kept of those before.

use crate::control::safety::Fault;
use crate::control::trace::event_words;
use crate::messages::{
    CameraHealth, CameraId, CameraState, ControlState, DriveCommandMsg, DriveStateMsg, DriveTextMsg,
    Measurement, RequestMsg, RobotState, Status, TargetStatus, TraceMsg, status_flag, trace_flag,
};
use crate::report::histogram::SpanHistogram;
use crate::report::run_page::JointSummary;
use crate::time::{MonoNs, SpanNs};
use std::collections::{BTreeMap, VecDeque};

/// Errors that are kept: a minute at 25 Hz, chosen by hand; more than a terminal has columns of dots.
const MOST_ERRORS: usize = 1500;
/// Places of each point that are kept for its trail: two seconds at 25 Hz, chosen by hand, so that a trail shows where the point came from, and no cloud.
const MOST_PLACES: usize = 50;
/// Events that are kept. Chosen by hand: as many as a tall terminal has rows.
const MOST_EVENTS: usize = 100;
/// Silence of a service that is told. Chosen by hand: 25 records of the status, which comes 50 times a second.
pub(super) const SILENT: SpanNs = SpanNs(500_000_000);
/// Frames that may be missing before that is told. Chosen by hand: control itself looks ahead over some.
const MISSING_FRAMES: f64 = 5.0;

/// What does not change in a run.
#[derive(Debug, Clone, Default)]
pub struct CellFacts {
    /// The name of the instance.
    pub instance: String,
    /// Whether time is simulated.
    pub lockstep: bool,
    /// Whether the run serves requests.
    pub serves: bool,
    /// Whether who watches has the monitor's keys.
    pub has_keys: bool,
    /// The joints, with their limits.
    pub joints: Vec<JointSummary>,
    /// Columns and rows of the image.
    pub image_px: [f64; 2],
    /// Names of the targets, by their numbers.
    pub targets: Vec<String>,
    /// Feature error below which the goal is reached, px.
    pub goal_error_px: f64,
    /// For how long it must be held, s.
    pub hold_s: f64,
    /// Frames per second that are asked for.
    pub rate_hz: f64,
}

/// What a run's services send to who watches it.
#[derive(Debug, Clone, Copy)]
pub enum WatchedRecord<'a> {
    /// A state of the run.
    Status(&'a Status),
    /// A tick of control.
    Tick(&'a TraceMsg),
    /// A measurement of the first camera.
    Measurement(&'a Measurement),
    /// How a real camera stands.
    Health(CameraId, &'a CameraHealth),
    /// A request of a client, and its answer.
    Request(&'a RequestMsg),
    /// A command to an external drive.
    DriveCommand(&'a DriveCommandMsg),
    /// A state of an external drive.
    DriveState(&'a DriveStateMsg),
    /// Words of an external drive.
    DriveText(&'a DriveTextMsg),
}

/// A record, and when it came by the watcher's own clock.
#[derive(Debug, Clone, Copy)]
pub(super) struct Newest<T> {
    pub(super) record: T,
    pub(super) came: MonoNs,
}

/// Everything that the screen shows.
#[derive(Debug, Clone, Default)]
pub struct RunView {
    pub(super) facts: CellFacts,
    pub(super) status: Option<Newest<Status>>,
    pub(super) trace: Option<TraceMsg>,
    pub(super) measurement: Option<Newest<Measurement>>,
    pub(super) health: BTreeMap<u32, CameraHealth>,
    /// What the robot is beside its joints, as control heard it last.
    pub(super) robot: RobotState,
    /// The maker's code for a state, as the drive told it last.
    pub(super) robot_code: Option<(RobotState, u32)>,
    /// The maker's words for a state, likewise.
    pub(super) robot_text: Option<(RobotState, String)>,
    /// Where each point of the goal is to be, px, by its number.
    pub(super) goal_px: BTreeMap<u32, [f64; 2]>,
    /// Where each point was.
    pub(super) trails: BTreeMap<u64, VecDeque<[f64; 2]>>,
    /// Feature errors, oldest first: when, s, and px.
    pub(super) errors: VecDeque<(f64, f64)>,
    /// How many there were, those counted that are no longer kept.
    pub(super) errors_seen: u64,
    /// When something happened, s, and what.
    pub(super) events: VecDeque<(f64, String)>,
    /// How many there were.
    pub(super) events_seen: u64,
    /// Deadline of a tick to its command.
    pub(super) tick_times: SpanHistogram,
    /// Exposure to command.
    pub(super) latencies: SpanHistogram,
    /// What became of the last request of this user.
    pub(super) word: String,
    /// Why nothing comes any more.
    pub(super) ended: Option<String>,
    /// The stamp at the run's time 0.
    origin: Option<MonoNs>,
    sequence: Option<u64>,
    /// Ticks that this watcher did not see.
    pub(super) unseen: u64,
}

impl RunView {
    /// Of a run of which nothing came yet.
    #[must_use]
    pub fn new(facts: CellFacts) -> Self {
        Self { facts, ..Self::default() }
    }

    /// Takes in what came at `now` of the watcher's clock. Whether the goal may be another one than the known one.
    pub fn take(&mut self, record: &WatchedRecord<'_>, now: MonoNs) -> bool {
        match record {
            WatchedRecord::Status(status) => return self.status(status, now),
            WatchedRecord::Tick(tick) => self.tick(tick),
            WatchedRecord::Measurement(measurement) => self.measurement(measurement, now),
            WatchedRecord::Health(camera, health) => self.health(*camera, health),
            WatchedRecord::DriveState(state) => self.drive_state(state),
            WatchedRecord::DriveText(text) => self.drive_text(text),
            // What came of requests stands in the state and in the events of ticks, commands too.
            WatchedRecord::Request(_) | WatchedRecord::DriveCommand(_) => {}
        }
        false
    }

    /// Takes in a state of the run that came at `now` of the watcher's clock. Whether the goal may be another one than the known one.
    pub fn status(&mut self, record: &Status, now: MonoNs) -> bool {
        let before = self.status.replace(Newest { record: *record, came: now }).map(|newest| newest.record);
        self.origin = Some(record.stamp - SpanNs::from_s(record.time_s));
        let camera = |status: &Status| CameraState::from_code(status.camera_state);
        let restarts = [
            ("camera", before.map(|b| b.camera_restarts), record.camera_restarts),
            ("vision", before.map(|b| b.vision_restarts), record.vision_restarts),
        ];
        for (who, before, now) in restarts {
            if before.is_some_and(|before| before != now) {
                self.event(record.time_s, format!("{who} was started anew, {now} times by now"));
            }
        }
        if before.as_ref().is_some_and(|b| camera(b) != camera(record)) {
            self.event(record.time_s, format!("camera {}", camera(record).as_str()));
        }
        before.is_none_or(|b| b.goal != record.goal)
    }

    /// Takes in a tick.
    pub fn tick(&mut self, record: &TraceMsg) {
        let time_s = self.origin.map_or(f64::NAN, |origin| (record.stamp - origin).as_s());
        if let Some(next) = self.sequence.map(|sequence| sequence + 1) {
            self.unseen += record.sequence.saturating_sub(next);
        }
        self.sequence = Some(record.sequence);
        let robot = RobotState::from_code(TraceMsg::robot_state_of(record.flags));
        if std::mem::replace(&mut self.robot, robot) != robot {
            self.event(
                time_s,
                format!(
                    "robot: {}",
                    self.robot_row().map_or("its drive does not tell".into(), |row| row.words)
                ),
            );
        }
        let before = self.trace.replace(*record);
        if let Some(before) = before.filter(|b| b.state != record.state) {
            let [from, to] = [before.state, record.state].map(|code| ControlState::from_code(code).as_str());
            self.event(time_s, format!("{from} -> {to}"));
        }
        if let Some(fault) =
            Fault::from_code(record.fault).filter(|_| before.is_none_or(|b| b.fault != record.fault))
        {
            self.event(time_s, format!("fault: {}", fault.describe()));
        }
        for word in event_words(record.events).filter(|word| *word != "fault") {
            self.event(time_s, word.replace('_', " "));
        }
        if !self.facts.lockstep {
            self.tick_times.record(record.commanded - record.stamp);
        }
        if record.flags & trace_flag::MEASUREMENT != 0 {
            self.latencies.record(record.commanded - record.exposure);
            if record.feature_error_px.is_finite() {
                keep(&mut self.errors, (time_s, record.feature_error_px), MOST_ERRORS);
                self.errors_seen += 1;
            }
        }
    }

    /// Name of the target with this number, of a run with several.
    pub(super) fn target_name(&self, number: u32) -> Option<&str> {
        let several = self.facts.targets.len() > 1;
        self.facts.targets.get(number as usize).filter(|_| several).map(String::as_str)
    }

    /// Takes in a measurement that came at `now` of the watcher's clock.
    pub fn measurement(&mut self, record: &Measurement, now: MonoNs) {
        let before = self.measurement.replace(Newest { record: *record, came: now });
        let (before, number) = before.map_or((TargetStatus::Found, 0), |newest| {
            (newest.record.target_status(), newest.record.target_number)
        });
        if number != record.target_number {
            // Points of one target are not on the way of another's.
            self.trails.clear();
        }
        if (before, number) != (record.target_status(), record.target_number) {
            let time_s = self.origin.map_or(f64::NAN, |origin| (record.exposure - origin).as_s());
            let name = self.target_name(record.target_number).unwrap_or("target").to_owned();
            self.event(time_s, format!("{name}: {}", record.target_status().as_str()));
        }
        // A point that is not seen has no trail any more.
        let seen = record.features();
        self.trails.retain(|id, _| seen.iter().any(|feature| feature.id == *id));
        for feature in seen {
            keep(self.trails.entry(feature.id).or_default(), [feature.u_px, feature.v_px], MOST_PLACES);
        }
    }

    /// Takes in how a real camera stands.
    pub fn health(&mut self, camera: CameraId, record: &CameraHealth) {
        self.health.insert(u32::from(camera.0), *record);
    }

    /// How often camera and vision were started anew.
    pub(super) fn restarts(&self) -> [u32; 2] {
        self.status.map_or([0; 2], |newest| [newest.record.camera_restarts, newest.record.vision_restarts])
    }

    /// Takes in where the points of the goal are to be, px.
    pub fn goal(&mut self, points_px: impl IntoIterator<Item = (u32, [f64; 2])>) {
        self.goal_px = points_px.into_iter().collect();
    }

    /// Where each point of the goal is to be, px, by its number.
    #[must_use]
    pub fn goal_px(&self) -> &BTreeMap<u32, [f64; 2]> {
        &self.goal_px
    }

    /// What became of a request of this user.
    pub fn say(&mut self, word: impl Into<String>) {
        self.word = word.into();
    }

    /// An answer to a request of this user; among the events, so that a long one has room.
    pub fn answered(&mut self, word: &str) {
        let time_s = self.status.map_or(f64::NAN, |newest| newest.record.time_s);
        self.event(time_s, word.to_owned());
        self.say(word);
    }

    /// The run is over, or cannot be reached any more; the last that was known stays.
    pub fn end(&mut self, why: impl Into<String>) {
        self.ended = Some(why.into());
    }

    fn event(&mut self, time_s: f64, what: String) {
        keep(&mut self.events, (time_s, what), MOST_EVENTS);
        self.events_seen += 1;
    }

    /// The state of control.
    pub(super) fn state(&self) -> Option<ControlState> {
        let code = self.status.map(|newest| newest.record.state);
        code.or(self.trace.map(|trace| trace.state)).map(ControlState::from_code)
    }

    /// What the run waits for, or what it does, in words; and whether that is in order.
    pub(super) fn waits_for(&self, now: MonoNs) -> (String, bool) {
        if let Some(why) = &self.ended {
            return (why.clone(), false);
        }
        let Some(Newest { record: s, came }) = self.status else {
            return ("waits for control's first word".into(), false);
        };
        if now - came > SILENT {
            let for_s = (now - came).as_s();
            return (
                format!("nothing came from control for {for_s:.1} s: it hangs, or the machine is too busy"),
                false,
            );
        }
        let camera = CameraState::from_code(s.camera_state);
        let target = TargetStatus::from_code(s.target);
        let view = if camera.is_away() {
            format!("the camera, which is {} for {:.1} s", camera.as_str(), s.camera_state_s)
        } else if self.measurement.is_none() {
            "the first frame".into()
        } else {
            let name = self.target_name(s.target_number).map_or(String::new(), |name| format!(" {name}"));
            format!("a view of the target{name}: {}", target.as_str())
        };
        let start = if self.facts.has_keys { ": s" } else { "" };
        let tolerance = format!("{} px for {} s", self.facts.goal_error_px, self.facts.hold_s);
        match ControlState::from_code(s.state) {
            ControlState::Waiting => (format!("waits for {view}"), false),
            ControlState::Servoing if s.at_goal_s.is_finite() => {
                (format!("at the goal for {:.1} s", s.at_goal_s), true)
            }
            ControlState::Servoing => (format!("moves to the goal, which is {tolerance}"), true),
            ControlState::Holding => (format!("stands, and waits for {view}"), false),
            ControlState::Returning if s.flags & status_flag::SEARCHING != 0 => {
                (format!("looks around for its target, and waits for {view}"), false)
            }
            ControlState::Returning => {
                (format!("returns to where it saw the target, and waits for {view}"), false)
            }
            ControlState::Converged => ("the goal was reached and held".into(), true),
            ControlState::Stopped => ("the run is over".into(), true),
            ControlState::Fault => {
                let fault = self.trace.and_then(|trace| Fault::from_code(trace.fault));
                let after = match (self.facts.serves, self.facts.has_keys) {
                    (false, _) => "",
                    (true, true) => "; see to its cause, then r",
                    (true, false) => "; see to its cause, then `vservo ctl reset`",
                };
                (fault.map_or("a fault", Fault::describe).to_owned() + after, false)
            }
            ControlState::Idle => (format!("waits for a start{start}"), true),
            ControlState::Teaching => (format!("takes the present view as its goal; waits for {view}"), true),
            ControlState::Stopping => ("comes to rest".into(), true),
            ControlState::Held => (format!("held on request; waits for a start{start}"), true),
            ControlState::Moving => ("moves to a posture that was asked for".into(), true),
        }
    }

    /// How long no measurement came, s, where that is too long.
    pub(super) fn blind_for_s(&self, now: MonoNs) -> Option<f64> {
        let for_s = (now - self.measurement?.came).as_s();
        (for_s > (MISSING_FRAMES / self.facts.rate_hz).max(SILENT.as_s())).then_some(for_s)
    }
}

fn keep<T>(queue: &mut VecDeque<T>, entry: T, most: usize) {
    if queue.len() >= most {
        queue.pop_front();
    }
    queue.push_back(entry);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::safety::Fault;

    #[test]
    fn what_is_kept_is_bounded_and_changes_become_events() {
        let mut view = RunView::new(CellFacts { lockstep: false, ..CellFacts::default() });
        let at = |ms: i64| MonoNs(ms * 1_000_000);
        let status = Status { stamp: at(1000), time_s: 1.0, goal: 2, ..Status::default() };
        assert!(view.status(&status, at(0)), "the goal is not known yet");
        assert!(!view.status(&status, at(20)));
        assert!(view.status(&Status { goal: 3, ..status }, at(40)));
        for k in 0..5000_u64 {
            let trace = TraceMsg {
                sequence: k,
                stamp: at(1000 + k as i64),
                commanded: at(1000 + k as i64) + SpanNs(70_000),
                exposure: at(980 + k as i64),
                flags: trace_flag::MEASUREMENT,
                feature_error_px: k as f64,
                state: if k % 2 == 0 { 0 } else { 1 },
                ..TraceMsg::default()
            };
            view.tick(&trace);
            let mut m = Measurement { status: 0, feature_count: 1, ..Measurement::default() };
            m.features[0].u_px = k as f64;
            view.measurement(&m, at(0));
        }
        assert_eq!((view.errors.len(), view.errors_seen), (MOST_ERRORS, 5000));
        let (time_s, px) = *view.errors.back().unwrap();
        assert!((time_s - 5.999).abs() < 1e-9 && px == 4999.0, "{time_s} s, {px} px");
        assert_eq!((view.events.len(), view.trails[&0].len()), (MOST_EVENTS, MOST_PLACES));
        assert_eq!(view.events.back().unwrap().1, "waiting -> servoing");
        assert!((view.events.back().unwrap().0 - 5.999).abs() < 1e-9, "times of the run");
        assert_eq!((view.tick_times.count(), view.unseen), (5000, 0));
        assert!((view.latencies.quantile_ns(0.5) as f64 / 20.07e6 - 1.0).abs() < 0.04);
        let fault =
            TraceMsg { sequence: 5010, fault: Fault::TrackingError.code(), state: 5, ..TraceMsg::default() };
        view.tick(&fault);
        view.tick(&TraceMsg { sequence: 5011, ..fault });
        assert_eq!(view.unseen, 10);
        let told = view.events.iter().filter(|(_, what)| what.starts_with("fault: a joint")).count();
        assert_eq!(told, 1, "once");
        view.measurement(&Measurement::default(), at(0));
        assert!(view.trails.is_empty() && view.events.back().unwrap().1.contains("no contrast"));
    }

    #[test]
    fn it_says_what_a_run_waits_for() {
        let facts = CellFacts {
            targets: vec!["target".into()],
            goal_error_px: 0.05,
            hold_s: 0.5,
            rate_hz: 25.0,
            has_keys: true,
            ..CellFacts::default()
        };
        let mut view = RunView::new(facts);
        assert!(view.waits_for(MonoNs(0)).0.contains("first word"));
        let word = |view: &mut RunView, status: Status| {
            view.status(&status, MonoNs(0));
            view.waits_for(MonoNs(1)).0
        };
        let s = Status { at_goal_s: f64::NAN, ..Status::default() };
        assert_eq!(word(&mut view, s), "waits for the first frame");
        view.measurement(&Measurement { status: 2, ..Measurement::default() }, MonoNs(0));
        assert!(
            word(&mut view, Status { target: 2, ..s })
                .starts_with("waits for a view of the target: fewer marks")
        );
        let mut of_two =
            RunView::new(CellFacts { targets: vec!["target".into(), "bin".into()], ..CellFacts::default() });
        of_two.measurement(&Measurement { status: 2, target_number: 1, ..Measurement::default() }, MonoNs(0));
        assert!(of_two.events.back().is_some_and(|(_, what)| what.starts_with("bin: fewer marks")));
        let told = word(&mut of_two, Status { target: 2, target_number: 1, ..s });
        assert!(told.starts_with("waits for a view of the target bin: fewer marks"), "{told}");
        let gone = Status { state: 2, camera_state: 5, camera_state_s: 3.2, ..s };
        assert_eq!(word(&mut view, gone), "stands, and waits for the camera, which is unplugged for 3.2 s");
        assert_eq!(
            word(&mut view, Status { state: 1, ..s }),
            "moves to the goal, which is 0.05 px for 0.5 s"
        );
        assert_eq!(word(&mut view, Status { state: 1, at_goal_s: 2.0, ..s }), "at the goal for 2.0 s");
        assert!(word(&mut view, Status { state: 6, ..s }).contains("start: s"));
        assert!(view.waits_for(MonoNs(3_000_000_000)).0.contains("nothing came from control for 3.0 s"));
        assert_eq!(view.blind_for_s(MonoNs(100_000_000)), None);
        assert_eq!(view.blind_for_s(MonoNs(2_000_000_000)), Some(2.0));
        view.end("the run has ended");
        assert_eq!(view.waits_for(MonoNs(0)).0, "the run has ended");
    }
}
