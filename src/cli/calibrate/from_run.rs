//! `vservo calibrate from`: a recording or a report -> what it tells of lens, mount, stamps, target and load.

use super::super::{check_writable, json, shown, write_result};
use super::CalibrateError;
use crate::calibration::from_run::{RunCell, RunRefinement, RunViews, SeenPoint, SeenView, fit_run};
use crate::calibration::load::{LoadEstimate, LoadRecording, fit_load};
use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::drive::CommandMode;
use crate::explain::RunEvidence;
use crate::geometry::Pose;
use crate::input::{printable, used};
use crate::messages::{JointState, MAX_JOINTS, Measurement, TraceMsg};
use crate::process::{OpenRecording, ProcessError, recorded_report};
use crate::record::RecordingReader;
use crate::replay::ReplayError;
use crate::report::summary::LoadCalibration;
use crate::robot::Robot;
use crate::scene::SceneMotion;
use crate::time::{MonoNs, SpanNs};
use clap::Args;
use nalgebra::{Quaternion, SVector, Translation3, UnitQuaternion, Vector2};
use serde::Serialize;
use std::collections::HashMap;
use std::io::Read;
use std::path::PathBuf;

/// Arguments of `vservo calibrate from`.
#[derive(Debug, Args)]
pub struct CalibrateFromArguments {
    /// The recording of a run, or the folder of its report
    #[arg(value_name = "RUN.mcap|DIR")]
    pub run: PathBuf,
    /// Write the whole run file with what was refined to this file
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Refines, and tells it; the exit code.
///
/// # Errors
/// When the run cannot be read, or a file not be written.
pub(in crate::cli) fn from_run(arguments: &CalibrateFromArguments) -> Result<u8, ProcessError> {
    let path = &arguments.run;
    used::note_path(path);
    if let Some(out) = &arguments.out {
        check_writable(out)?;
    }
    let (config, found) = if path.is_dir() {
        let RunEvidence { config, trace, measurements, .. } = recorded_report::evidence_of_report(path)?;
        let found = crate::dispatch_robot!(config.robot, |robot| refined(&config, &robot, |run| {
            report_views(&config, &trace, &measurements, &mut run.views);
            report_torques(&trace, &mut run.load);
            Ok(())
        }))?;
        (config, found)
    } else {
        let OpenRecording { reader, config, .. } = OpenRecording::open(path, &[])?;
        let found = crate::dispatch_robot!(config.robot, |robot| refined(&config, &robot, |run| {
            recorded_views(&config, reader, run)
        }))?;
        (config, found)
    };
    let wrong = |cause| ProcessError::Replay { path: path.clone(), cause: Box::new(cause) };
    let found = match found.map_err(wrong)? {
        Ok(found) => found,
        Err(refusal) => return Ok(refusal.tell()),
    };
    let mut exit_code = if arguments.json { shown(&json(&found), 0) } else { shown(&found.to_text(), 0) };
    if let Some(out) = &arguments.out {
        let head = format!("# vservo calibrate from {}\n", printable(&path.display().to_string()));
        exit_code = write_result(
            out,
            head + &config.refined_toml(&found.refinement, found.estimate.as_ref())?,
            exit_code,
        );
    }
    Ok(exit_code)
}

/// What a run has seen.
#[derive(Default)]
struct SeenRun<const N: usize> {
    views: RunViews<N>,
    load: LoadRecording<N>,
}

/// What it tells.
#[derive(Serialize)]
struct RunFindings {
    #[serde(flatten)]
    refinement: RunRefinement,
    /// What the flange carries; `null` where the run does not tell.
    load: Option<LoadCalibration>,
    /// Why it does not, and what would show it.
    load_unseen: Option<String>,
    #[serde(skip)]
    estimate: Option<LoadEstimate>,
}

impl RunFindings {
    fn to_text(&self) -> String {
        let mut text = self.refinement.to_text();
        if let Some(load) = &self.load {
            let [told, unseen] = [load.describe(), load.unseen.join("; ")];
            text += &format!("load: {told}\n");
            if !unseen.is_empty() {
                text += &format!("load, not seen by this run: {unseen}\n");
            }
            if load.is_there {
                text += &load.to_toml();
            }
        }
        if let Some(why) = &self.load_unseen {
            text += &format!("load: not seen by this run: {why}\n");
        }
        text
    }
}

/// The load by the torques of a run, or why they do not tell it, and what would.
fn carried<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    recording: &LoadRecording<N>,
) -> Result<LoadEstimate, String> {
    // Torques that are computed beside a position or a velocity do not act.
    if config.drive.mode != CommandMode::Torque && !recording.is_measured() {
        let why = "the joints were commanded no torques, and nothing measured them here; a run with drive.mode = \"torque\", or with a drive that measures torques, and its recording, shows it";
        return Err(why.into());
    }
    fit_load(robot, &config.tool, recording)
        .map_err(|e| format!("{e}; `vservo calibrate load` moves the joints so that it shows"))
}

/// Why nothing can be learnt of a run of this configuration.
fn refusal(config: &Config) -> Option<&'static str> {
    if config.stereo.is_some() || !config.further_cameras.is_empty() {
        Some(
            "the run has several cameras: `vservo calibrate stereo` calibrates a pair, runs of one camera are refined",
        )
    } else if !config.closes_the_loop() {
        Some("no arm moved in this run: what a mount and a size are shows by its joints alone")
    } else if config.scene.as_ref().is_some_and(|scene| scene.motion != SceneMotion::Still) {
        Some("the target moved in this run: it must rest on what it is fixed to")
    } else {
        None
    }
}

fn refined<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    fill: impl FnOnce(&mut SeenRun<N>) -> Result<(), ReplayError>,
) -> Result<Result<RunFindings, CalibrateError>, ReplayError> {
    if let Some(why) = refusal(config) {
        return Ok(Err(CalibrateError::input(why)));
    }
    let mut run = SeenRun::default();
    fill(&mut run)?;
    let cell = RunCell { robot, mount: &config.camera.mount, camera: &config.camera.model };
    let not_found = |e: crate::calibration::from_run::RunRefinementError| {
        CalibrateError::with_code(Outcome::NotConverged.exit_code(), format!("nothing was refined: {e}"))
    };
    let refinement = fit_run(&cell, &run.views).and_then(|fit| fit.refinement()).map_err(not_found);
    Ok(refinement.map(|refinement| {
        let (estimate, load_unseen) = match carried(config, robot, &run.load) {
            Ok(found) => (Some(found), None),
            Err(why) => (None, Some(why)),
        };
        let names = config.robot.joint_names();
        let load = estimate.as_ref().map(|found| LoadCalibration::new(found, &config.tool, &names));
        RunFindings { refinement, load, load_unseen, estimate }
    }))
}

/// The joints with their torques, and the views of a recording.
fn recorded_views<R: Read, const N: usize>(
    config: &Config,
    mut reader: RecordingReader<R>,
    run: &mut SeenRun<N>,
) -> Result<(), ReplayError> {
    let measurements = format!("/vision/{}/measurement", config.camera.id.0);
    let (mut states, mut measured) = (Vec::<JointState>::new(), HashMap::<u64, [f64; MAX_JOINTS]>::new());
    while let Some(message) = reader.next_message()? {
        match message.topic() {
            "/control/joint_state" => {
                let state = message.record::<JointState>()?;
                run.views.note_state(&state);
                states.push(state);
            }
            "/control/trace" => {
                let trace = message.record::<TraceMsg>()?;
                if trace.measured_torque.iter().take(N).all(|tau| tau.is_finite()) {
                    measured.insert(trace.tick, trace.measured_torque);
                }
            }
            topic if topic == measurements => {
                let measurement: Measurement = message.record()?;
                SeenView::of(&measurement, &config.target)
                    .into_iter()
                    .for_each(|view| run.views.note_view(view));
            }
            _ => {}
        }
    }
    // A trace may come before or after the state of its tick.
    states.iter().for_each(|state| run.load.note(state, measured.get(&state.tick)));
    Ok(())
}

/// The joints and views of a report, whose points have no standard deviations.
fn report_views<const N: usize>(
    config: &Config,
    trace: &crate::report::csv_table::CsvTable,
    measurements: &crate::report::csv_table::CsvTable,
    run: &mut RunViews<N>,
) {
    let stamp = |s: f64| MonoNs(SpanNs::from_s(s).0);
    let joints = |column: &str, row: usize| {
        SVector::<f64, N>::from_fn(|i, _| trace.number(&format!("{column}_{}", i + 1), row))
    };
    for row in 0..trace.rows() {
        let (q, qd) = (joints("q", row), joints("qd", row));
        if q.iter().chain(qd.iter()).all(|x| x.is_finite()) {
            run.track.push(stamp(trace.number("time_s", row)), q, qd);
        }
    }
    for row in 0..measurements.rows() {
        let of = |name: &str| measurements.number(name, row);
        let q = Quaternion::new(of("CO_qw"), of("CO_qx"), of("CO_qy"), of("CO_qz"));
        let p = Translation3::new(of("CO_x_m"), of("CO_y_m"), of("CO_z_m"));
        let posed = q.norm() > 0.5 && p.vector.iter().all(|x| x.is_finite());
        if !posed || measurements.word("status", row) != "Found" {
            continue;
        }
        let points = config.target.points().iter().filter_map(|point| {
            let axis = |axis: &str| of(&format!("{axis}_{}_px", point.id + 1));
            let px = Vector2::new(axis("u"), axis("v"));
            px.iter().all(|x| x.is_finite()).then_some(SeenPoint { p_O: point.p_O, px, sd_px: 0.0 })
        });
        let points: Vec<_> = points.collect();
        if points.len() >= 4 {
            let X_CO = Pose::from_parts(p, UnitQuaternion::from_quaternion(q));
            run.note_view(SeenView { stamp: stamp(of("exposure_s")), points, X_CO });
        }
    }
}

/// The torques of a report, which stand in the row of the tick from which on they acted.
fn report_torques<const N: usize>(trace: &crate::report::csv_table::CsvTable, load: &mut LoadRecording<N>) {
    let joints = |column: &str, row: usize| {
        SVector::<f64, N>::from_fn(|i, _| trace.number(&format!("{column}_{}", i + 1), row))
    };
    for row in 1..trace.rows() {
        let (q, tau) = (joints("q", row), joints("tau", row - 1));
        if q.iter().chain(tau.iter()).all(|x| x.is_finite()) {
            load.push(MonoNs(SpanNs::from_s(trace.number("time_s", row)).0), q, tau, None);
        }
    }
}
