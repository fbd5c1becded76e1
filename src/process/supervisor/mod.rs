//! The supervisor: one command that starts the three processes, watches them, ends them in order and tells how it went.
//!
//! ```text
//! lock ─► configuration into shared memory ─► camera, vision, control ─► watch ─┬─ control is done
//!                                    camera or vision is started anew (restarts) ◄┤  in real time, when it died or hangs (hang_watch)
//!                                                                             ├─ another process died, or hangs
//!                                                                             └─ SIGINT, SIGTERM
//!        remove leftovers ◄─ reap ◄─ kill what hangs ◄─ the others end ◄─ control has brought the arm to rest ◄┘
//! ```

pub(super) mod child;
mod children;
mod hang_watch;
mod latch_signal;
mod progress;
mod reap;
mod restarts;

use super::recorder::BlackBoxSettings;
use super::{ProcessError, ReportFolder, StopFlag, shape_of, watched_roles};
use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::input::printable;
use crate::ipc::{
    Instance, InstanceError, Receiver, Role, SPACE_BESIDE_FRAMES_BYTES, SPACE_OF_MEASUREMENTS_BYTES, Services,
};
use crate::messages::{DRIVE_TEXT_BYTES, Status};
use crate::report::summary::Summary;
use crate::rt::{ServiceWatchdog, now, tell_service_manager};
use crate::time::SpanNs;
use child::{Child, ProcessEnd};
use children::Children;
use hang_watch::HangWatch;
use latch_signal::LatchSignal;
use progress::Progress;
use restarts::{Reaction, Restarts};
use std::fs::File;
use std::path::Path;
use std::time::Duration;
use tracing::error;

/// Time that the children of a supervisor that was just killed have to bring the arm to rest and end. Chosen by hand: braking takes less than
/// 2 s within the limits of the shipped arms, and a drive's program may take 4 s after it.
const PREDECESSOR: SpanNs = SpanNs(7_000_000_000);
/// Time from the orderly end of an external drive's program to that of control, and the period at which the children are watched. Chosen by hand:
/// control looks for a silent drive after 0.5 s and then ends, and the rest is for a loaded machine; a user does not notice a hundredth of a second.
const DRIVE_LEAVES: SpanNs = SpanNs(2_000_000_000);
const WATCH_PERIOD: Duration = Duration::from_millis(10);

/// What a run leaves beside its summary.
#[derive(Debug, Clone, Copy, Default)]
pub struct RunOutputs<'a> {
    /// The folder of its report.
    pub report: Option<&'a ReportFolder>,
    /// The file of its recording.
    pub recording: Option<&'a Path>,
    /// The black box, which keeps what was sent before a fault.
    pub black_box: Option<&'a BlackBoxSettings>,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub struct FinishedRun {
    /// What there is to tell.
    pub summary: Summary,
    /// The exit code that says it.
    pub exit_code: u8,
}

/// Runs camera, vision and control to the end of the run. With the folder of a report control and vision leave there what it is
/// made of; that of an earlier run is gone. With a recording a recorder is there before them and goes after them.
///
/// # Errors
/// When the run cannot be started.
pub fn run(
    config: &Config,
    instance: &Instance,
    stop: &StopFlag,
    outputs: RunOutputs<'_>,
) -> Result<FinishedRun, ProcessError> {
    let (_place, written) = InstanceGuard::take(config, instance)?;
    supervise(config, &written, instance, stop, outputs)
}

/// The instance's place in shared memory, cleaned up when dropped.
pub(super) struct InstanceGuard {
    instance: Instance,
    lock: Option<crate::ipc::RoleLock>,
}

impl InstanceGuard {
    /// With the effective configuration, as it was written.
    pub(super) fn take(config: &Config, instance: &Instance) -> Result<(Self, File), ProcessError> {
        let lock = instance.lock(Role::Supervisor)?;
        // Children of a supervisor that was just killed need a moment to end.
        let deadline = now() + PREDECESSOR;
        // A recorder may have come first, so as to miss nothing.
        let disturbs = |role: &Role| *role != Role::Supervisor && !role.only_records();
        let other = || Role::all().find(|role| disturbs(role) && instance.is_running(*role));
        while let Some(role) = other() {
            if now() > deadline {
                return Err(InstanceError::Taken { instance: instance.to_string(), role }.into());
            }
            std::thread::sleep(WATCH_PERIOD);
        }
        let place = Self { instance: instance.clone(), lock: Some(lock) };
        instance.remove_leftovers(Some(Role::Supervisor));
        // All of it is reserved before the arm moves: the kernel has no milder way than SIGBUS to say later that there is none.
        let frames = config.cameras().map(|camera| shape_of(camera, config.clock).space_bytes());
        let second = if config.second_view.is_some() { SPACE_OF_MEASUREMENTS_BYTES } else { 0 };
        instance.require_space(frames.sum::<u64>() + SPACE_BESIDE_FRAMES_BYTES + second)?;
        let written = instance.write_config(&config.to_toml()?)?;
        Ok((place, written))
    }
}

impl Drop for InstanceGuard {
    fn drop(&mut self) {
        self.lock = None;
        self.instance.remove_leftovers(None);
    }
}

fn supervise(
    config: &Config,
    written: &File,
    instance: &Instance,
    stop: &StopFlag,
    outputs: RunOutputs<'_>,
) -> Result<FinishedRun, ProcessError> {
    let start = now();
    if stop.is_requested() {
        return Ok(stopped_before_the_start(config, now() - start));
    }
    let latch = LatchSignal::handled(instance);
    let hang_watch = HangWatch::new(instance, config.clock, watched_roles(config), now());
    let mut children = Children::start(config, instance, written, outputs)?;
    let (failure, absent, restarts, end) = {
        let services = Services::join(instance).ok();
        let status = services.as_ref().and_then(|s| s.status_receiver().ok());
        let mut watch = Watch {
            instance: instance.clone(),
            status,
            progress: Progress::new(config.serve),
            hang_watch,
            restarts: Restarts::new(config, instance),
            last_tick: None,
            service_watchdog: ServiceWatchdog::from_environment(),
            latch,
        };
        let failure = watch.until_the_end(&mut children, stop);
        let absent = watch.restarts.absent();
        let end = children.shut_down(Some(&mut watch));
        if end.1.is_none() && stop.is_requested() && !watch.hang_watch.has_ticked() {
            // A stop that came while control was still starting: nothing has moved yet.
            return Ok(stopped_before_the_start(config, now() - start));
        }
        (failure, absent, watch.restarts.by_role(), end)
    };
    let mut end = conclude(config, failure, end, now() - start);
    // Control may have ended first: then it knows that the drive has left, but not why.
    if let Some(words) = instance.words_of_drive().filter(|_| end.summary.outcome == Outcome::Fault) {
        let words = printable(&words).to_string();
        // Those that came to control by messages may be cut.
        let begin = words.get(..words.floor_char_boundary(DRIVE_TEXT_BYTES / 2)).unwrap_or_default();
        if !end.summary.reason.contains(begin) {
            end.summary.reason = format!("{}: {words}", end.summary.reason);
        }
    }
    // Why the arm was stopped comes before what came of it.
    if let Some(words) = instance.words_of_guardian().filter(|_| end.summary.outcome == Outcome::Fault) {
        end.summary.reason = format!("{}: {}", printable(&words), end.summary.reason);
    }
    if let Some(absent) = absent.filter(|_| end.summary.outcome == Outcome::NotConverged) {
        end.summary.reason = format!("{}: {absent}", end.summary.reason);
    }
    end.summary.processes = children.usages();
    end.summary.restarts = restarts;
    Ok(end)
}

fn stopped_before_the_start(config: &Config, wall: SpanNs) -> FinishedRun {
    let mut summary = Summary::without_control(config, wall);
    summary.outcome = Outcome::Stopped;
    summary.reason = "a stop was requested before the loop began".into();
    FinishedRun { exit_code: summary.outcome.exit_code_of(config.awaits_its_end()), summary }
}

/// A process that ended before its time, or hangs.
#[derive(Debug)]
struct Failure {
    how: String,
    exit_code: Option<u8>,
}

impl Failure {
    fn ended(role: Role, end: ProcessEnd, words: Option<String>) -> Self {
        let why = words.map_or(String::new(), |words| format!(": {}", printable(&words)));
        let how = format!("the {role} process ended in the middle of the run: {end}{why}");
        Self { how, exit_code: end.exit_code() }
    }

    fn hangs(role: Role, silent: SpanNs) -> Self {
        let how = format!("the {role} process hangs: no sign of life for {:.0} s", silent.as_s());
        Self { how, exit_code: None }
    }
}

/// What is seen of a run while it goes on.
struct Watch {
    instance: Instance,
    status: Option<Receiver<Status>>,
    progress: Progress,
    hang_watch: HangWatch,
    restarts: Restarts,
    /// The last tick of control that it told.
    last_tick: Option<u64>,
    service_watchdog: ServiceWatchdog,
    latch: LatchSignal,
}

impl Watch {
    /// Takes what control says and looks at everybody's signs of life; who has been silent for too long.
    fn look(&mut self, children: &[Child]) -> Option<(Role, SpanNs)> {
        self.latch.look();
        if let Some(Ok(Some(status))) = self.status.as_ref().map(Receiver::receive_newest) {
            let before = self.last_tick.replace(status.tick);
            if before.is_none() {
                tell_service_manager("READY=1");
            }
            if before != Some(status.tick) {
                self.service_watchdog.feed(now());
            }
            if status.frames > 0 {
                self.restarts.all_work(now());
            }
            self.progress.show(&status);
            self.hang_watch.note(&status, now());
        }
        let child_of = |role| children.iter().find(|child| child.role() == role);
        self.hang_watch.look(now(), |role| child_of(role).is_some_and(Child::is_suspended))
    }

    /// Starts anew what died, when its time has come, and takes note of what is back.
    fn mend(&mut self, children: &mut Children<'_>) {
        self.restarts.tell();
        for role in self.hang_watch.working() {
            self.restarts.works(role, now());
        }
        while let Some(role) = self.restarts.due(now()) {
            self.hang_watch.begin_anew(role, now());
            let refusal = children.start_anew(role).err();
            self.restarts.started(role, refusal.as_ref().map(|e| e as &dyn std::fmt::Display), now());
            if refusal.is_some() {
                self.hang_watch.ended(role, now());
            }
        }
    }

    /// Waits until control is done, a stop is requested, or a process dies or hangs that is not started anew.
    fn until_the_end(&mut self, children: &mut Children<'_>, stop: &StopFlag) -> Option<Failure> {
        let mut drive_left = None;
        let failure = loop {
            let silent = self.look(&children.others);
            if children.control.poll().is_some() || stop.is_requested() {
                break None;
            }
            self.mend(children);
            children.tell_of_recorders();
            let ended = children.others.iter_mut().filter_map(|c| c.poll().map(|end| (c.role(), end)));
            let (restarts, hang_watch) = (&mut self.restarts, &mut self.hang_watch);
            let ended = ended.filter(|(role, end)| {
                let joined = hang_watch.ended(*role, now());
                restarts.ended(*role, *end, joined, now()) == Reaction::EndsTheRun
            });
            // A drive may leave as soon as it was told that the run is over; control has yet to say how it went.
            let mut ended = ended.filter(|(role, end)| {
                let leaves = *role == Role::Drive && end.exit_code() == Some(0);
                !leaves || now() - *drive_left.get_or_insert_with(now) > DRIVE_LEAVES
            });
            if let Some((role, end)) = ended.next() {
                let words = if role == Role::Drive { self.instance.words_of_drive() } else { None };
                break Some(Failure::ended(role, end, words));
            }
            if let Some((role, silent)) = silent {
                if self.restarts.is_hanging(role, silent) {
                    children.kill(role);
                    continue;
                }
                break Some(Failure::hangs(role, silent));
            }
            std::thread::sleep(WATCH_PERIOD);
        };
        tell_service_manager("STOPPING=1");
        self.progress.end();
        if let Some(failure) = &failure {
            error!("{}", failure.how);
            self.instance.leave_words_of_supervisor(&failure.how); // for the recorder, which ends last
        }
        failure
    }
}

/// What the run came to, given how control ended, what it says, and what went wrong around it.
fn conclude(
    config: &Config,
    failure: Option<Failure>,
    control: (ProcessEnd, Option<Summary>),
    wall: SpanNs,
) -> FinishedRun {
    let broken = |reason: String, exit_code: u8, summary: Option<Summary>| {
        let mut summary = summary.unwrap_or_else(|| Summary::without_control(config, wall));
        summary.outcome = Outcome::Fault;
        summary.reason = reason;
        FinishedRun { summary, exit_code }
    };
    match (failure, control) {
        (Some(Failure { how, exit_code, .. }), (_, summary)) => {
            let exit_code = exit_code.filter(|c| *c == 3 || *c == 1).unwrap_or(Outcome::Fault.exit_code());
            broken(how, exit_code, summary)
        }
        (None, (_, Some(summary))) => {
            FinishedRun { exit_code: summary.outcome.exit_code_of(config.awaits_its_end()), summary }
        }
        (None, (end, None)) => {
            let exit_code = end.exit_code().filter(|c| *c != 0).unwrap_or(Outcome::Fault.exit_code());
            broken(format!("the control process ended without a result: {end}"), exit_code, None)
        }
    }
}
