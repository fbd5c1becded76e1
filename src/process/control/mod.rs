//! The control process. In real time a FIFO thread ticks and never touches shared memory, while a companion thread
//! carries measurements in and records out; in lockstep one thread does both, because its time is simulated.

#[cfg(test)]
mod broken_services;
mod camera_watch;
mod commands;
mod deadlines;
mod drive_rings;
mod drive_words;
mod event_log;
mod external_drive;
mod load;
mod lockstep;
mod motion_reader;
mod realtime;
mod realtime_thread;
mod recorded;
mod recorded_drive;
mod recorded_part;
mod recorder_pace;
mod requests;
mod restart_watch;
mod run_files;
mod stops;

pub use recorded::recorded_results;
pub use recorded_part::RecordedResults;

use super::{Membership, ProcessError, ReportFolder, StopFlag, second_vision};
use crate::calibration::load::LoadRecording;
use crate::calibration::{KnownCell, Recording, stamp_offset};
use crate::config::Config;
use crate::config::assemble::{
    before_drive, contradicted_lag, control_loop, control_loop_with, q_start, require_controllable,
};
use crate::config::{Clock, Task};
use crate::control::outcome::{Finish, Outcome};
use crate::control::trace::Trace;
use crate::drive::{DriveProperties, ExternalDrive, StandstillDrive};
use crate::ipc::{Instance, QuietSender, Receiver, Role, Sender, TICKS_ARE_OVER, WakeListener};
use crate::messages::{CameraId, JointState, Measurement, RequestMsg, Status, TraceMsg};
use crate::mission::{Hindsight, LockstepRun};
use crate::report::history::RunHistory;
use crate::report::statistics::RunStatistics;
use crate::report::summary::{
    ContactReport, RealtimeReport, SafetyReport, SecondCameraReport, StampCalibration, Summary, TickTimes,
};
use crate::robot::Robot;
use crate::rt::now;
use crate::sim::preflight::Preflight;
use crate::time::SpanNs;
use camera_watch::CameraWatch;
use commands::Commands;
use external_drive::DrivePorts;
use nalgebra::Vector2;
use std::collections::BTreeMap;
use std::time::Duration;
use stops::Stops;
use tracing::{debug_span, info, warn};

/// Of a run whose last trace does not say how it ended: there is no such run.
const WITHOUT_AN_END: Finish = Finish { outcome: Outcome::Stopped, reason: "the run ended without a reason" };
/// Time that recorders have to read the last records of a run, because these vanish with their sender. Chosen by hand: four of the 50 ms after which
/// a waiting reader looks again; each run with a recorder takes so much longer.
const TRACE_FAREWELL: Duration = Duration::from_millis(200);
/// Longest time that control may take, with the arm at rest, to find out what the run has told. Chosen by hand: a fit of forty views takes a second where nothing fits, and twenty times that on
/// a machine that is busy with other things.
const LONGEST_FIT: SpanNs = SpanNs(20_000_000_000);

/// Runs control to the end of the run, and leaves its history in the folder `report`, where there is one.
///
/// # Errors
/// When the configuration, shared memory, the instance or the scheduling fails.
pub fn run(
    config: &Config,
    instance: &Instance,
    stop: &StopFlag,
    report: Option<&ReportFolder>,
) -> Result<Summary, ProcessError> {
    crate::dispatch_robot!(config.robot, |robot| run_robot(config, robot, instance, stop, report))?
}

/// Who else hears of each tick and measurement beside the statistics; here, because the real-time thread has no time for them.
struct Listeners<const N: usize> {
    /// What a calibration is to remember.
    calibration: Option<Recording<N>>,
    /// What a calibration of the load is to remember.
    load: Option<LoadRecording<N>>,
    /// What a report is made of.
    history: Option<RunHistory>,
}

impl<const N: usize> Listeners<N> {
    fn note_measurement(&mut self, m: &Measurement) {
        if let Some(recording) = &mut self.calibration {
            recording.note_measurement(m);
        }
        // A report is of the first camera.
        if let Some(history) = self.history.as_mut().filter(|_| m.camera == u32::from(CameraId::FIRST)) {
            history.note_measurement(m);
        }
    }

    fn note(&mut self, trace: &Trace) {
        if let Some(recording) = &mut self.calibration {
            recording.note_state(&trace.joint_state);
        }
        if let Some(recording) = &mut self.load {
            recording.note(&trace.joint_state, trace.measured_torque.as_ref());
        }
        if let Some(history) = &mut self.history {
            history.note(trace);
        }
    }
}

/// Control's ports.
struct Ports<'a> {
    membership: &'a Membership,
    measurements: Receiver<Measurement>,
    wake_listener: WakeListener,
    /// Those of a second camera that controls the arm, too.
    second: Option<(Receiver<Measurement>, WakeListener)>,
    joint_state: Sender<JointState>,
    status: Sender<Status>,
    trace: QuietSender<TraceMsg>,
    requests: QuietSender<RequestMsg>,
}

impl<'a> Ports<'a> {
    fn open(membership: &'a Membership, config: &Config) -> Result<Self, ProcessError> {
        let services = membership.services();
        let (measurements, wake_listener) = services.measurement_receiver(config.camera.id)?;
        let second = second_vision(config).map(|id| services.measurement_receiver(id)).transpose()?;
        let (joint_state, status) = (services.joint_state_sender()?, services.status_sender()?);
        let (trace, requests) = (services.trace_sender()?, services.request_sender()?);
        Ok(Self { membership, measurements, wake_listener, second, joint_state, status, trace, requests })
    }

    /// Records vanish with their sender: gives the readers time to take the last ones.
    fn farewell(&self) {
        if self.trace.is_heard() {
            std::thread::sleep(TRACE_FAREWELL);
        }
    }
}

/// How a run went by the clock.
struct Pace {
    missed_deadlines: u64,
    skipped_ticks: u64,
    tick_us: TickTimes,
    realtime: Option<RealtimeReport>,
    /// Ticks that the report did not see, because the companion did not come round.
    lost_traces: u64,
    /// Commands that the companion could not take.
    lost_commands: u64,
    /// Why no frames come, where the camera is away at the end.
    camera_is_away: Option<String>,
    /// What the drive says of a robot that does not obey at the end.
    robot_words: Option<String>,
}

impl Pace {
    /// Of a run in simulated time.
    fn without_deadlines() -> Self {
        Self {
            missed_deadlines: 0,
            skipped_ticks: 0,
            tick_us: TickTimes::default(),
            realtime: None,
            lost_traces: 0,
            lost_commands: 0,
            camera_is_away: None,
            robot_words: None,
        }
    }
}

/// Control and mission, or what they are made of once a drive is connected.
enum Assembly<const N: usize> {
    Done(Box<LockstepRun<N>>),
    AwaitsDrive(Box<ExternalDrive<N>>, Box<Robot<N>>),
}

fn run_robot<const N: usize>(
    config: &Config,
    robot: Robot<N>,
    instance: &Instance,
    stop: &StopFlag,
    report: Option<&ReportFolder>,
) -> Result<Summary, ProcessError> {
    let _span = debug_span!("run", clock = config.clock_name(), scheme = config.scheme_name()).entered();
    let membership = Membership::join(instance, Role::Control, config)?;
    let stops = Stops::new(stop.clone(), instance.make_stop_word()?, config.serve);
    let stability = Preflight::of(config).ok().and_then(|preflight| preflight.stability);
    require_controllable(config)?;
    // Before the ports: camera and vision begin with those. An external drive tells what its torques may do when it is connected, so that its control is assembled after that.
    let recorded = recorded_drive::open::<N>(config)?;
    let (assembly, mut drive) = match (external_drive::open::<N>(config, &membership)?, recorded) {
        (Some((drive, ports)), _) => (Assembly::AwaitsDrive(Box::new(drive), Box::new(robot)), Some(ports)),
        (None, Some(drive)) => {
            (Assembly::Done(Box::new(control_loop_with(config, robot, Box::new(drive))?)), None)
        }
        (None, None) => (Assembly::Done(Box::new(control_loop(config, robot)?)), None),
    };
    let ports = Ports::open(&membership, config)?;
    let mut commands = Commands::new(membership.services().command_server()?, config.serve);
    let camera = CameraWatch::open(membership.services(), config)?;
    if config.clock == Clock::Lockstep {
        lockstep::wait_for_peers(&membership, config, &stops)?;
    }
    membership.services().require_room_for_peers()?;
    if let Some(drive) = &mut drive {
        // What cannot be assembled is told before the robot is powered for it.
        if let Assembly::AwaitsDrive(_, robot) = &assembly {
            let nothing = StandstillDrive::new(q_start::<N>(config)?);
            control_loop_with(config, Robot::clone(robot), Box::new(nothing))?;
        }
        drive.connect(config, &stops, &mut commands)?;
    }
    let mut control = match assembly {
        Assembly::Done(control) => *control,
        Assembly::AwaitsDrive(external, robot) => {
            let told = drive.as_ref().map(DrivePorts::properties);
            let config_of_drive = told.map(|told| before_told_drive(config, &robot, told));
            control_loop_with(config_of_drive.as_ref().unwrap_or(config), *robot, external)?
        }
    };
    if let Some(stability) = &stability {
        control.mission.set_stability(stability.slowest());
    }
    instance.reserve()?;
    let start = now();
    let mut listeners = Listeners {
        calibration: (config.task == Task::CalibrateLatency).then(Recording::default),
        load: (config.task == Task::CalibrateLoad).then(LoadRecording::default),
        history: report.map(|_| run_files::history(config, &control.mission)),
    };
    let (control, statistics, pace) = match config.clock {
        Clock::Realtime => {
            let messages = (drive, commands, camera);
            realtime::run(config, control, &ports, messages, &mut listeners, stops)?
        }
        Clock::Lockstep => lockstep::run(config, control, &ports, (drive, commands), &mut listeners, &stops)?,
    };
    let wall = now() - start;
    membership.tell_progress(TICKS_ARE_OVER);
    ports.farewell();
    let summary = membership.beat_during(LONGEST_FIT, || {
        let mut summary = summary(config, &control, &statistics, pace, wall);
        summary.stability = stability;
        if let Some(recording) = listeners.calibration.filter(|_| summary.outcome == Outcome::Finished) {
            calibrate(config, &control, &recording, &mut summary);
        }
        if let Some(recording) = listeners.load.filter(|_| summary.outcome == Outcome::Finished) {
            load::find(config, &control, &recording, &mut summary);
        }
        summary
    });
    if let (Some(folder), Some(history)) = (report, &listeners.history) {
        run_files::write(folder, config, &control, history, &membership);
    }
    Ok(summary)
}

/// The configuration before a drive that told this of itself; where torques rise more slowly by it, that is logged.
fn before_told_drive<const N: usize>(config: &Config, robot: &Robot<N>, told: &DriveProperties) -> Config {
    let (of_drive, share) = before_drive(config, robot, told);
    let rates = of_drive.motion.effort_rates.iter().map(ToString::to_string).collect::<Vec<_>>();
    if !rates.is_empty() {
        info!("torques rise by no more than the drive takes: {} N m/s or N/s", rates.join(", "));
    }
    if let Some(lag) = told.lag.filter(|_| config.effective.servo.lead_ms.is_none()) {
        info!("the drive's arm is {:.0} ms behind its commands: laws look so far ahead", lag.as_s() * 1e3);
    }
    let most = of_drive.safety.max_tracking_error;
    if most > config.safety.max_tracking_error {
        info!(
            "for the drive's lag a joint may be {most:.2} rad or m from its reference: safety.max_tracking_error_rad_or_m says another bound"
        );
    }
    contradicted_lag(config, robot, told).iter().for_each(|words| warn!("{words}"));
    if share < 1.0 {
        warn!(
            "the drive takes torques slowly: the reference moves with {:.0} % of motion.max_jerk_rad_s3_or_m_s3",
            100.0 * share
        );
    }
    of_drive
}

/// Works out what a calibration run was for. Without a result the run counts as one that did not reach its goal.
fn calibrate<const N: usize>(
    config: &Config,
    run: &LockstepRun<N>,
    recording: &Recording<N>,
    summary: &mut Summary,
) {
    let i = config.camera.model.intrinsics();
    let cell = KnownCell {
        robot: &run.controller().arm().robot,
        mount: &config.camera.mount,
        f_px: Vector2::new(i.fx_px, i.fy_px),
        points: run.mission.goal().set_point.points(),
    };
    match debug_span!("stage", name = "fit").in_scope(|| stamp_offset(&cell, recording)) {
        Ok(found) => {
            let configured_ms = config.effective.camera.stamp_offset_ms;
            summary.calibration = Some(StampCalibration::new(&found, configured_ms));
        }
        Err(error) => {
            summary.outcome = Outcome::NotConverged;
            summary.reason = error.to_string();
        }
    }
}

fn summary<const N: usize>(
    config: &Config,
    run: &LockstepRun<N>,
    statistics: &RunStatistics,
    pace: Pace,
    wall: SpanNs,
) -> Summary {
    let LockstepRun { control, mission } = run;
    let Hindsight { accuracy, contradicted } = mission.hindsight();
    let measurement_log = mission.measurements();
    let joint_control = control.controller().joint_control();
    let (rotors, joint_names) = (joint_control.rotors(), config.robot.joint_names());
    let finish = mission.finish().unwrap_or(WITHOUT_AN_END);
    let vision = measurement_log.vision_counts();
    let lockstep = config.clock == Clock::Lockstep;
    let reason = match (finish.outcome, pace.camera_is_away, pace.robot_words) {
        (Outcome::NotConverged, Some(away), _) => format!("run.duration_s is over: {away}"),
        (Outcome::Fault, _, Some(words)) => format!("{}: {words}", finish.reason),
        _ => finish.reason.into(),
    };
    let unknown = control.unknown_joint().map(|joint| joint.in_words(&joint_names));
    let reason = [Some(reason), unknown].into_iter().flatten().collect::<Vec<_>>().join("; ");
    Summary {
        outcome: finish.outcome,
        reason,
        clock: config.clock_name().into(),
        scheme: config.scheme_name().into(),
        seed: config.seed,
        duration_s: mission.duration_s(),
        wall_s: Some(wall.as_s()),
        ticks: control.ticks(),
        missed_deadlines: pace.missed_deadlines,
        skipped_ticks: pace.skipped_ticks,
        frames: vision.frames,
        measurements: measurement_log.count(),
        intake: *measurement_log.verdicts(),
        frames_dropped: vision.frames_dropped,
        target_lost: vision.target_lost,
        late_drive_states: control.late_drive_states(),
        settling_time_s: statistics.settling_time_s(),
        final_errors: mission.final_errors(),
        accuracy,
        contradicted,
        latency_us: statistics.latencies(),
        tick_us: pace.tick_us,
        realtime: pace.realtime,
        processes: BTreeMap::new(),
        restarts: BTreeMap::new(),
        safety: SafetyReport {
            held_by: config.workspace.as_ref().map_or_else(Vec::new, |space| statistics.held_by(space)),
            ..statistics.safety_report(mission.state())
        },
        lost_traces: pace.lost_traces,
        lost_commands: pace.lost_commands,
        gated_commands: control.controller().gated(),
        payload: joint_control.payload().map(Into::into),
        rotors_kg_m2_or_kg: rotors.iter().flat_map(|[inertia, _]| inertia.iter().copied()).collect(),
        rotors_sd_kg_m2_or_kg: rotors.iter().flat_map(|[_, sd]| sd.iter().copied()).collect(),
        model_error: measurement_log.model_error().report(&config.camera.model, &config.target),
        contact: control.controller().contact().map(|contact| ContactReport::new(&contact, &joint_names)),
        joint_names,
        untrusted_encoders: control.controller().untrusted_encoders().collect(),
        state_hash: lockstep.then(|| statistics.state_hash()),
        calibration: None,
        load: None,
        stability: None,
        path: mission.path_tracking(),
        second_camera: config.second_view.as_ref().zip(mission.second_goal()).map(|(second, goal)| {
            let (errors, log) = (mission.second_errors().unwrap_or_default(), goal.measurements());
            SecondCameraReport::new(&second.cell.camera.name, log, errors)
        }),
    }
}
