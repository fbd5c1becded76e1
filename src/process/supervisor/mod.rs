//! The supervisor: one command that starts the three processes, watches them, ends them in order and tells how it went.
//!
//! ```text
//! lock ─► configuration into shared memory ─► camera, vision, control ─► watch ─┬─ control is done
//!                                                                             ├─ a process died
//!                                                                             └─ SIGINT, SIGTERM
//!        remove leftovers ◄─ reap ◄─ kill what hangs ◄─ camera, vision end ◄─ control ends ◄┘
//! ```

mod child;
mod progress;
mod reap;

use super::{ProcessError, StopFlag, frame_shape};
use crate::config::Config;
use crate::config::raw::DriveKind;
use crate::ipc::{Instance, InstanceError, Role, Services};
use crate::rt::now;
use crate::summary::{Outcome, Summary};
use crate::time::{MonoNs, SpanNs};
use child::{Child, End};
use progress::Progress;
use std::fs::File;
use std::time::Duration;
use tracing::{error, warn};

/// Time in which all processes must have ended; what still runs then is killed.
const SHUTDOWN: SpanNs = SpanNs(1_800_000_000);
/// Share of it for control alone, which brings the arm to rest first.
const SHUTDOWN_OF_CONTROL: SpanNs = SpanNs(1_200_000_000);
/// From the orderly end of an external drive's program to that of control.
const PLANT_LEAVES: SpanNs = SpanNs(2_000_000_000);
/// What all that is not a frame takes in shared memory from the first second on, bytes.
const LEAST_SPACE_BESIDE_FRAMES: u64 = 256 * 1024;
const WATCH_PERIOD: Duration = Duration::from_millis(10);

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub struct RunEnd {
    /// What there is to tell.
    pub summary: Summary,
    /// The exit code that says it.
    pub exit_code: u8,
}

/// Runs camera, vision and control to the end of the run.
///
/// # Errors
/// When the run cannot be started.
pub fn run(config: &Config, instance: &Instance, stop: &StopFlag) -> Result<RunEnd, ProcessError> {
    let (_place, written) = Place::take(config, instance)?;
    supervise(config, &written, instance, stop)
}

/// The instance's place in shared memory, cleaned up when dropped.
struct Place {
    instance: Instance,
    lock: Option<crate::ipc::RoleLock>,
}

impl Place {
    /// With the effective configuration, as it was written.
    fn take(config: &Config, instance: &Instance) -> Result<(Self, File), ProcessError> {
        let lock = instance.lock(Role::Supervisor)?;
        // Children of a supervisor that was just killed need a moment to end.
        let deadline = now() + SHUTDOWN;
        let other = || Role::ALL.into_iter().find(|r| *r != Role::Supervisor && instance.is_running(*r));
        while let Some(role) = other() {
            if now() > deadline {
                return Err(InstanceError::Taken { instance: instance.to_string(), role }.into());
            }
            std::thread::sleep(WATCH_PERIOD);
        }
        let place = Self { instance: instance.clone(), lock: Some(lock) };
        instance.remove_leftovers(Some(Role::Supervisor));
        // The kernel has no milder way than SIGBUS to say later that there is none.
        instance.require_space(frame_shape(config).bytes as u64 + LEAST_SPACE_BESIDE_FRAMES)?;
        let written = instance.write_config(&config.to_toml()?)?;
        Ok((place, written))
    }
}

impl Drop for Place {
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
) -> Result<RunEnd, ProcessError> {
    let start = now();
    let spawn = |role| Child::spawn(role, instance, written);
    let mut control = spawn(Role::Control)?;
    let mut others = vec![spawn(Role::Vision)?, spawn(Role::Camera)?];
    if config.drive.kind == DriveKind::External {
        others.extend(Child::spawn_plant(&config.drive.external, instance)?);
    }

    let failure = watch(instance, &mut control, &mut others, stop);
    let end = shut_down(&mut control, &mut others);
    let summary = control.take_output().and_then(|text| serde_json::from_str::<Summary>(&text).ok());
    let mut end = conclude(config, failure, end, summary, now() - start);
    // All are waited for: what a process used is known only after its end.
    for child in &mut others {
        child.wait();
    }
    let children = others.iter().chain([&control]);
    end.summary.processes = children.filter_map(|c| Some((c.role().to_string(), c.usage()?))).collect();
    Ok(end)
}

/// A process that ended before its time.
struct Failure {
    role: Role,
    end: End,
}

/// Waits until control is done, another process dies, or a stop is requested.
fn watch(instance: &Instance, control: &mut Child, others: &mut [Child], stop: &StopFlag) -> Option<Failure> {
    // Attached after the children were started: a process must not fork once it has joined the transport.
    let services = Services::join(instance).ok();
    let status = services.as_ref().and_then(|s| s.status_receiver().ok());
    let mut progress = Progress::new();
    let mut plant_left = None;
    loop {
        if let Some(Ok(Some(status))) = status.as_ref().map(|s| s.receive_newest()) {
            progress.show(&status);
        }
        if control.poll().is_some() {
            progress.end();
            return None;
        }
        let ended = others.iter_mut().filter_map(|c| c.poll().map(|end| (c.role(), end)));
        // A plant may leave as soon as it was told that the run is over; control has yet to say how it went.
        let mut ended = ended.filter(|(role, end)| {
            let leaves = *role == Role::Drive && end.exit_code() == Some(0);
            !leaves || now() - *plant_left.get_or_insert_with(now) > PLANT_LEAVES
        });
        if let Some((role, end)) = ended.next() {
            progress.end();
            error!("the {role} process ended in the middle of the run: {end}");
            return Some(Failure { role, end });
        }
        if stop.is_requested() {
            progress.end();
            return None;
        }
        std::thread::sleep(WATCH_PERIOD);
    }
}

/// Ends control, which brings the arm to rest, then the others; kills what does not end in time. Control's end.
fn shut_down(control: &mut Child, others: &mut [Child]) -> End {
    let start = now();
    control.terminate();
    wait_for(std::slice::from_mut(control), start + SHUTDOWN_OF_CONTROL);
    others.iter_mut().for_each(Child::terminate);
    wait_for(others, start + SHUTDOWN);
    for child in others.iter_mut().chain([&mut *control]) {
        if child.poll().is_none() {
            warn!("the {} process does not end and is killed", child.role());
            child.kill();
        }
    }
    control.wait()
}

fn wait_for(children: &mut [Child], deadline: MonoNs) {
    while children.iter_mut().any(|c| c.poll().is_none()) && now() < deadline {
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// What the run came to, given what control says and what went wrong around it.
fn conclude(
    config: &Config,
    failure: Option<Failure>,
    control: End,
    summary: Option<Summary>,
    wall: SpanNs,
) -> RunEnd {
    let broken = |reason: String, exit_code: u8, summary: Option<Summary>| {
        let mut summary = summary.unwrap_or_else(|| Summary::without_control(config, wall));
        summary.outcome = Outcome::Fault;
        summary.reason = reason;
        RunEnd { summary, exit_code }
    };
    match (failure, summary) {
        (Some(Failure { role, end }), summary) => {
            let exit_code =
                end.exit_code().filter(|c| *c == 3 || *c == 1).unwrap_or(Outcome::Fault.exit_code());
            broken(format!("the {role} process ended in the middle of the run: {end}"), exit_code, summary)
        }
        (None, Some(summary)) => RunEnd { exit_code: summary.outcome.exit_code(), summary },
        (None, None) => {
            let exit_code = control.exit_code().filter(|c| *c != 0).unwrap_or(Outcome::Fault.exit_code());
            broken(format!("the control process ended without a result: {control}"), exit_code, None)
        }
    }
}
