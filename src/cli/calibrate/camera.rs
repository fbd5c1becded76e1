//! `vservo calibrate camera`.

use super::super::{CalibrateCameraArguments, check_writable, json, shown, write_result};
use super::CalibrateError;
use super::answer::{CameraAnswer, Examined, lines, reasons};
use super::boards::{Boards, board};
use super::live;
use super::stage::stage;
use crate::calibration::camera::{CameraCalibrationError, calibrate_camera};
use crate::camera_model::camera_info::CameraInfo;
use crate::control::outcome::Outcome;
use crate::process::ProcessError;
use crate::report::calibration_page::{CalibrationPage, document};
use nalgebra::Point3;

/// Calibrates, tells, and writes; the exit code.
pub(in crate::cli) fn camera(arguments: &CalibrateCameraArguments) -> Result<u8, ProcessError> {
    for path in [Some(&arguments.out), arguments.board.report.as_ref()].into_iter().flatten() {
        check_writable(path)?;
    }
    let (examined, boards) = match examined(arguments) {
        Ok(done) => done,
        Err(refusal) => return Ok(refusal.tell()),
    };
    let answer = CameraAnswer::new(&examined, &boards);
    let text = if arguments.board.json { json(&answer) } else { lines(&examined, &boards) };
    let usable = examined.verdict.is_usable();
    let mut exit_code = shown(&text, if usable { 0 } else { Outcome::NotConverged.exit_code() });
    let info = CameraInfo::new(&arguments.name, &examined.calibration.camera);
    let head = format!("# vservo calibrate camera: {}\n", examined.verdict);
    exit_code = write_result(&arguments.out, head + &info.write(), exit_code);
    if let Some(path) = &arguments.board.report {
        let title = format!("Calibration of {}", arguments.name);
        exit_code =
            write_result(path, document(&title, &[section(&examined, &boards, &arguments.name)]), exit_code);
    }
    Ok(exit_code)
}

fn examined(arguments: &CalibrateCameraArguments) -> Result<(Examined, Boards), CalibrateError> {
    let board = board(&arguments.board)?;
    let boards = match &arguments.live {
        Some(run_file) => stage("boards", || live::watch(run_file, arguments, &board))?,
        None => stage("boards", || Boards::find(&arguments.images, &board))?,
    };
    let settings = arguments.board.settings();
    let calibration = stage("fit", || calibrate_camera(&boards.views, boards.size, &settings))
        .map_err(|error| explained(error, &boards))?;
    let points: Vec<Point3<f64>> = board.points().iter().map(|p| p.p_O).collect();
    let distance_m = arguments.board.distance_m;
    let examined = stage("verdict", || Examined::new(calibration, &boards, &points, distance_m))
        .ok_or(CameraCalibrationError::Degenerate)?;
    Ok((examined, boards))
}

/// An error with what the images lack, where that is why.
pub(super) fn explained(error: CameraCalibrationError, boards: &Boards) -> CalibrateError {
    let mut refusal = CalibrateError::from(error);
    let misses =
        boards.names.iter().zip(&boards.misses).filter_map(|(name, miss)| Some((name, miss.as_ref()?)));
    for (name, miss) in misses.take(5) {
        refusal.message += &format!("; {name}: {miss}");
    }
    refusal
}

/// The section of one camera on the page.
pub(super) fn section(examined: &Examined, boards: &Boards, name: &str) -> String {
    CalibrationPage {
        name,
        images: &boards.names,
        reasons: reasons(&examined.calibration, boards).collect(),
        calibration: &examined.calibration,
        uncertainty: &examined.uncertainty,
        halves: examined.halves.as_ref(),
        coverage: &examined.coverage,
        next: examined.next.as_ref(),
        verdict: &examined.verdict,
    }
    .section()
}
