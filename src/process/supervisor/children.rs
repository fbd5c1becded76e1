//! The processes of a run, which end in order however the supervisor ends: control first, because it brings the arm to rest,
//! then the others.

use super::child::{Child, ProcessEnd};
use super::hang_watch::Heart;
use super::{RunOutputs, Watch};
use crate::config::Config;
use crate::config::{CameraProgram, Clock, DriveKind, DriveProgram, Source};
use crate::ipc::{Instance, Role};
use crate::process::drive_guard::GRACE_OF_DRIVE;
use crate::process::guardian::{self, OUTLIVES};
use crate::process::{ProcessError, seeing_cameras, seeing_roles};
use crate::report::summary::{ProcessUsage, Summary};
use crate::rt::{now, tell};
use crate::time::{MonoNs, SpanNs};
use std::collections::BTreeMap;
use std::fs::File;
use std::time::Duration;
use tracing::warn;

/// Time that control may take to end, beside braking. Chosen by hand: 3 s until an arm that does not rest is given up, the farewell to the drive,
/// and the summary, with room for a loaded machine.
const SHUTDOWN_OF_CONTROL: SpanNs = SpanNs(8_000_000_000);
/// Factor by which a lockstep run may be slower than its simulated clock. Chosen by hand: a simulator on a loaded machine; with less its arm
/// is killed while it brakes, with more an end that hangs is noticed later.
const SLOWEST_DRIVE: f64 = 10.0;
/// Time in which the other processes end: they notice a stop within 50 ms. Chosen by hand; those that do not are killed.
const SHUTDOWN_OF_OTHERS: SpanNs = SpanNs(600_000_000);
/// The same of the guardian: as long as it waits for the arm's rest, and time for itself, chosen by hand.
const SHUTDOWN_OF_GUARDIAN: SpanNs = SpanNs(OUTLIVES.0 + 500_000_000);
/// The same of a drive's program: what its guard gives it, and time for the guard, chosen by hand.
const SHUTDOWN_OF_DRIVE: SpanNs = SpanNs(GRACE_OF_DRIVE.0 + 200_000_000);
/// The same where vision has images to write. Chosen by hand: hundreds of PNG files on a slow disk.
const SHUTDOWN_WITH_IMAGES: SpanNs = SpanNs(15_000_000_000);
/// The same of a recorder. Chosen by hand: what may wait for a disk is 64 MB, which a slow one writes in that time.
const SHUTDOWN_OF_RECORDER: SpanNs = SpanNs(10_000_000_000);
/// Longest wait for a guardian that starts, after which control is started without it. Chosen by hand: it takes some hundredths of a second, and a busy machine its
/// time; one that never comes ends the run.
const GUARDIAN_JOINS: SpanNs = SpanNs(10_000_000_000);
/// Longest wait for a recorder that starts, after which the run begins without it. Chosen by hand: it takes a fraction of a second, and a busy
/// machine its time.
const RECORDER_JOINS: SpanNs = SpanNs(10_000_000_000);
/// Period of the messages while a stop takes long. Chosen by hand, for people.
const REPORT_EVERY: SpanNs = SpanNs(2_000_000_000);

/// Control and the processes around it.
pub(super) struct Children<'a> {
    pub(super) control: Child,
    pub(super) others: Vec<Child>,
    recorders: Vec<Child>,
    ended_recorders: Vec<Child>,
    instance: &'a Instance,
    written: &'a File,
    outputs: RunOutputs<'a>,
    longest_stop: SpanNs,
    shutdown_of_others: SpanNs,
    is_down: bool,
}

impl<'a> Children<'a> {
    /// Starts the processes of a run, which read the effective configuration from the file `written`. What they have to tell beside
    /// the summary goes where `outputs` says.
    pub(super) fn start(
        config: &Config,
        instance: &'a Instance,
        written: &'a File,
        outputs: RunOutputs<'a>,
    ) -> Result<Self, ProcessError> {
        let longest_stop = longest_stop(config);
        let shutdown_of_others =
            if outputs.report.is_some() { SHUTDOWN_WITH_IMAGES } else { SHUTDOWN_OF_OTHERS };
        let mut recorders = Vec::new();
        if outputs.recording.is_some() {
            let heart = Heart::of(Role::Recorder, instance, now());
            let mut child = Child::spawn(Role::Recorder, instance, written, outputs)?;
            wait_for_recorder(&mut child, instance, heart);
            recorders.push(child);
        }
        if outputs.black_box.is_some() {
            // It keeps what comes late, so that nobody waits for it.
            recorders.push(Child::spawn(Role::BlackBox, instance, written, outputs)?);
        }
        let mut guardian = guardian::is_wanted(config)
            .then(|| Child::spawn(Role::Guardian, instance, written, outputs))
            .transpose()?;
        if let Some(guardian) = &mut guardian {
            wait_for_guardian(guardian, instance);
        }
        let control = Child::spawn(Role::Control, instance, written, outputs)?;
        // From here on whatever fails ends what was started in order.
        let mut children = Self {
            control,
            others: guardian.into_iter().collect(),
            recorders,
            ended_recorders: Vec::new(),
            instance,
            written,
            outputs,
            longest_stop,
            shutdown_of_others,
            is_down: false,
        };
        for role in seeing_roles(config) {
            children.others.push(Child::spawn(role, instance, written, outputs)?);
        }
        if config.drive.kind == DriveKind::External {
            let DriveProgram { command, folder, .. } = &config.drive.external;
            children.others.extend(Child::spawn_program(Role::Drive, command, folder, instance)?);
        }
        for camera in seeing_cameras(config) {
            if let Source::External(CameraProgram { command, folder, .. }) = &camera.source {
                let role = Role::CameraProgram(camera.id);
                children.others.extend(Child::spawn_program(role, command, folder, instance)?);
            }
        }
        Ok(children)
    }

    /// Starts the process of `role`, which has ended, anew.
    pub(super) fn start_anew(&mut self, role: Role) -> Result<(), ProcessError> {
        if let Some(place) = self.others.iter_mut().find(|child| child.role() == role) {
            let child = Child::spawn(role, self.instance, self.written, self.outputs)?;
            *place = child.in_place_of(place);
        }
        Ok(())
    }

    /// Ends the process of `role` at once.
    pub(super) fn kill(&mut self, role: Role) {
        self.others.iter_mut().filter(|child| child.role() == role).for_each(Child::kill);
    }

    /// Ends control, which brings the arm to rest as long as that takes, then the others; kills what does not end in time.
    /// Control's end, and its summary.
    pub(super) fn shut_down(&mut self, watch: Option<&mut Watch>) -> (ProcessEnd, Option<Summary>) {
        self.is_down = true;
        self.control.terminate();
        self.wait_for_rest(watch);
        if self.control.poll().is_none() {
            warn!("the control process does not end and is killed");
            self.control.kill();
        }
        // The guardian waits for the arm's rest, and nothing may take the drive away before.
        let guardians = self.others.partition_point(|child| child.role() == Role::Guardian);
        let (guardian, others) = self.others.split_at_mut(guardians);
        end_all(guardian, SHUTDOWN_OF_GUARDIAN);
        end_all(others, self.shutdown_of_others);
        end_all(&mut self.recorders, SHUTDOWN_OF_RECORDER);
        let end = self.control.wait();
        (end, self.control.take_output().and_then(|text| serde_json::from_str(&text).ok()))
    }

    /// Waits until control has ended, as long as it shows signs of life.
    fn wait_for_rest(&mut self, mut watch: Option<&mut Watch>) {
        let start = now();
        let mut told: MonoNs = start;
        while self.control.poll().is_none() {
            let time = now();
            if time - start > self.longest_stop {
                return;
            }
            if let Some(watch) = &mut watch
                && let Some((Role::Control, _)) = watch.look(&[])
            {
                return;
            }
            if time - told > REPORT_EVERY {
                told = time;
                tell(format_args!(
                    "stopping: waiting for the arm to come to rest, for {:.0} s now",
                    (time - start).as_s()
                ));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Tells of recorders that have ended before the run.
    pub(super) fn tell_of_recorders(&mut self) {
        for recorder in self.recorders.extract_if(.., |recorder| recorder.poll().is_some()) {
            warn!(
                "the {} has ended before the run, which goes on: nothing is kept any more",
                recorder.role()
            );
            self.ended_recorders.push(recorder);
        }
    }

    /// What each process used; known after the shut-down.
    pub(super) fn usages(&self) -> BTreeMap<String, ProcessUsage> {
        let all =
            self.others.iter().chain([&self.control]).chain(&self.recorders).chain(&self.ended_recorders);
        all.filter_map(|c| Some((c.role().to_string(), c.usage()?))).collect()
    }
}

impl Drop for Children<'_> {
    /// On an error or a panic: the arm comes to rest first, as always.
    fn drop(&mut self) {
        if !self.is_down {
            let _ = self.shut_down(None);
        }
    }
}

/// Asks `children` to end, and kills those that have not after `patience`, of a drive's program after its own.
fn end_all(children: &mut [Child], patience: SpanNs) {
    children.iter_mut().for_each(Child::terminate);
    let start = now();
    let patience_with = |child: &Child| match child.role() {
        Role::Drive => patience.max(SHUTDOWN_OF_DRIVE),
        _ => patience,
    };
    while children.iter_mut().any(|c| c.poll().is_none() && now() - start < patience_with(c)) {
        std::thread::sleep(Duration::from_millis(2));
    }
    for child in children {
        if child.poll().is_none() {
            warn!("the {} process does not end and is killed", child.role());
            child.kill();
        }
        // All are waited for: what a process used is known only after its end.
        child.wait();
    }
}

/// Waits until the recorder misses nothing any more: until its main loop comes round.
fn wait_for_recorder(recorder: &mut Child, instance: &Instance, mut heart: Heart) {
    let start = now();
    while recorder.poll().is_none() && !heart.works() {
        if now() - start > RECORDER_JOINS {
            return warn!("the recorder does not come: the recording may lack the beginning of the run");
        }
        std::thread::sleep(Duration::from_millis(2));
        heart.listen(instance, now());
    }
}

/// Waits until the guardian misses nothing any more.
fn wait_for_guardian(guardian: &mut Child, instance: &Instance) {
    let start = now();
    while guardian.poll().is_none() && instance.progress(Role::Guardian).is_none_or(|steps| steps == 0) {
        if now() - start > GUARDIAN_JOINS {
            return warn!("the guardian does not come: nothing but control itself stops the arm as yet");
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// How long control may take to end when it is asked to.
fn longest_stop(config: &Config) -> SpanNs {
    let braking_s =
        crate::dispatch_robot!(config.robot, |robot| crate::config::assemble::motion_limits(config, &robot)
            .map_or(0.0, |limits| limits.longest_braking_s()))
        .unwrap_or(0.0);
    let slowest = if config.clock == Clock::Lockstep { SLOWEST_DRIVE } else { 1.0 };
    let braking = SpanNs::from_s((braking_s * slowest).min(MAX_BRAKING_S));
    SpanNs(SHUTDOWN_OF_CONTROL.0 + braking.0)
}

/// Bound of the braking time: an hour, whatever the limits of the robot file say. Chosen by hand: somebody waits for the end of the run, and limits
/// near zero would make it infinite.
const MAX_BRAKING_S: f64 = 3600.0;
