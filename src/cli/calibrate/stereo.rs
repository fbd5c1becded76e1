//! `vservo calibrate stereo`.
//!
//! ```text
//! --out pair.yaml:  pair.yaml        X_LR with its covariance
//!                   pair_left.yaml   camera_info of the left camera, with the rotation to the rectified image
//!                   pair_right.yaml  the same of the right one; its projection holds -fx times the base line
//! ```

use super::super::{CalibrateStereoArguments, check_writable, json, shown, write_result};
use super::CalibrateError;
use super::answer::{CameraAnswer, Examined, PlaceOut, lines};
use super::boards::{Boards, board};
use super::camera::{explained, section};
use super::stage::stage;
use crate::calibration::camera::CameraCalibrationError;
use crate::calibration::stereo::{StereoCalibration, calibrate_stereo};
use crate::camera_model::CameraModel;
use crate::camera_model::camera_info::CameraInfo;
use crate::control::outcome::Outcome;
use crate::process::ProcessError;
use crate::report::calibration_page::document;
use crate::rt::tell;
use crate::stereo::Rectification;
use nalgebra::{Point3, Rotation3, Vector3};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The pair as JSON.
#[derive(Serialize)]
struct PairAnswer {
    left: CameraAnswer,
    right: CameraAnswer,
    X_LR: RelativePoseOut,
    rms_px: f64,
    rows_rms_px: Option<f64>,
    baseline_m: f64,
    baseline_sd_m: f64,
}

#[derive(Serialize)]
struct RelativePoseOut {
    #[serde(flatten)]
    place: PlaceOut,
    covariance: Vec<f64>,
}

struct CalibratedPair {
    found: StereoCalibration,
    examined: [Examined; 2],
    boards: [Boards; 2],
}

/// Calibrates, tells, and writes; the exit code.
pub(in crate::cli) fn stereo(arguments: &CalibrateStereoArguments) -> Result<u8, ProcessError> {
    let files = [beside(&arguments.out, "_left"), beside(&arguments.out, "_right")];
    for path in files.iter().chain([&arguments.out]).chain(arguments.board.report.as_ref()) {
        check_writable(path)?;
    }
    let pair = match pair(arguments) {
        Ok(pair) => pair,
        Err(refusal) => return Ok(refusal.tell()),
    };
    let CalibratedPair { found, examined: [left, right], boards } = &pair;
    if stands_left(&found.X_LR.translation.vector) {
        tell(
            "vservo: warning: the right camera stands left of the left one: --left and --right may be exchanged",
        );
    }
    let text = if arguments.board.json { json(&answer(&pair)) } else { told(&pair) };
    let usable = left.verdict.is_usable() && right.verdict.is_usable();
    let mut exit_code = shown(&text, if usable { 0 } else { Outcome::NotConverged.exit_code() });
    for (path, info) in files.iter().zip(infos(found)) {
        exit_code = write_result(path, info.write(), exit_code);
    }
    exit_code = write_result(&arguments.out, pose_file(found, &files), exit_code);
    if let Some(path) = &arguments.board.report {
        let [left_boards, right_boards] = boards;
        let sections = [section(left, left_boards, "left"), section(right, right_boards, "right")];
        exit_code = write_result(path, document("Calibration of a stereo pair", &sections), exit_code);
    }
    Ok(exit_code)
}

fn pair(arguments: &CalibrateStereoArguments) -> Result<CalibratedPair, CalibrateError> {
    let board = board(&arguments.board)?;
    if board.symmetry().turns > 1 {
        return Err(CalibrateError::usage(
            "--target: this board looks the same when it is turned, so that the cameras may number its corners differently; take one \
             with an even and an odd number of corners, such as 9x6",
        ));
    }
    let (left, right) = (arguments.left.len(), arguments.right.len());
    if left != right {
        return Err(CameraCalibrationError::Pairs { left, right }.into());
    }
    let boards = stage("boards", || {
        Ok::<_, CalibrateError>([
            Boards::find(&arguments.left, &board)?,
            Boards::find(&arguments.right, &board)?,
        ])
    })?;
    let [left, right] = &boards;
    let settings = arguments.board.settings();
    let found =
        stage("fit", || calibrate_stereo(&left.views, &right.views, (left.size, right.size), &settings))
            .map_err(|error| {
                explained(error, if left.misses.iter().any(Option::is_some) { left } else { right })
            })?;
    let points: Vec<Point3<f64>> = board.points().iter().map(|p| p.p_O).collect();
    let examine = |calibration: &crate::calibration::camera::CameraCalibration, boards: &Boards| {
        Examined::new(calibration.clone(), boards, &points, arguments.board.distance_m)
            .ok_or(CameraCalibrationError::Degenerate)
    };
    let examined = stage("verdict", || {
        Ok::<_, CameraCalibrationError>([examine(&found.left, left)?, examine(&found.right, right)?])
    })?;
    Ok(CalibratedPair { found, examined, boards })
}

fn answer(pair: &CalibratedPair) -> PairAnswer {
    let CalibratedPair { found, examined: [left, right], boards: [left_boards, right_boards] } = pair;
    PairAnswer {
        left: CameraAnswer::new(left, left_boards),
        right: CameraAnswer::new(right, right_boards),
        X_LR: RelativePoseOut {
            place: (&found.X_LR).into(),
            // symmetric: by rows is by columns
            covariance: found.covariance.iter().copied().collect(),
        },
        rms_px: found.rms_px,
        rows_rms_px: found.rows_rms_px,
        baseline_m: found.X_LR.translation.vector.norm(),
        baseline_sd_m: found.baseline_sd_m(),
    }
}

/// Whether a right camera at `p` (m) in the left one is on its wrong side; cameras above each other have no sides.
fn stands_left(p: &Vector3<f64>) -> bool {
    -p.x > p.y.abs().max(p.z.abs())
}

/// For people.
fn told(pair: &CalibratedPair) -> String {
    let CalibratedPair { found, examined: [left, right], boards: [left_boards, right_boards] } = pair;
    let p = found.X_LR.translation.vector;
    let turn = found.X_LR.rotation.angle().to_degrees();
    let rows = found.rows_rms_px.map_or_else(String::new, |rows| {
        format!(", rows of the rectified images differ by {rows:.3} px (rms)")
    });
    format!(
        "left: {}right: {}right camera at ({:.5}, {:.5}, {:.5}) m of the left one, turned by {turn:.3} degrees\n\
         base line {:.5} +- {:.5} m, rms of both {:.3} px{rows}\n",
        lines(left, left_boards),
        lines(right, right_boards),
        p.x,
        p.y,
        p.z,
        p.norm(),
        found.baseline_sd_m(),
        found.rms_px
    )
}

/// `pair.yaml` -> `pair_left.yaml`.
fn beside(path: &Path, ending: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map_or_else(|| "yaml".into(), |e| e.to_string_lossy());
    path.with_file_name(format!("{stem}{ending}.{extension}"))
}

/// The calibrations as ROS has them, rectified where the cameras stand so that they can be.
fn infos(found: &StereoCalibration) -> [CameraInfo; 2] {
    let (left, right) = (&found.left.camera, &found.right.camera);
    let Ok(rectified) = Rectification::new(left, right, &found.X_LR) else {
        tell("vservo: warning: the cameras look along their base line: their images cannot be rectified");
        return [CameraInfo::new("left", left), CameraInfo::new("right", right)];
    };
    let info = |name: &str, camera: &CameraModel, R: &Rotation3<f64>, offset_m: f64| {
        let i = rectified.camera.intrinsics();
        let mut info = CameraInfo::new(name, camera);
        let rows = R.matrix().transpose();
        info.rectification.iter_mut().zip(rows.iter()).for_each(|(out, x)| *out = *x);
        let (f, g) = (i.fx_px, i.fy_px);
        info.projection = [f, 0.0, i.cx_px, -f * offset_m, 0.0, g, i.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0];
        info
    };
    [info("left", left, &rectified.R_R1, 0.0), info("right", right, &rectified.R_R2, rectified.baseline_m)]
}

/// The pose between the cameras, YAML.
fn pose_file(found: &StereoCalibration, files: &[PathBuf; 2]) -> String {
    let place = PlaceOut::from(&found.X_LR);
    let list = |numbers: &[f64]| numbers.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ");
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let [left, right] = files;
    format!(
        "# vservo calibrate stereo: pose of the right camera in the left one, rms {:.4} px\n\
         left: {:?}\nright: {:?}\nX_LR:\n  position_m: [{}]\n  rotation_xyzw: [{}]\n  covariance: [{}]\n",
        found.rms_px,
        name(left),
        name(right),
        list(&place.position_m),
        list(&place.rotation_xyzw),
        list(found.covariance.as_slice())
    )
}
