//! `vservo calibrate points`: a camera from points in space whose places are known, and where one image shows them; the end of Sect. 10.5.

use super::super::{check_writable, json, shown, write_result};
use super::CalibrateError;
use super::answer::{CameraOut, PlaceOut};
use crate::calibration::camera::{PointInSpace, PointLens, SpaceCalibration, calibrate_in_space};
use crate::camera_model::camera_info::CameraInfo;
use crate::control::outcome::Outcome;
use crate::input::file;
use crate::process::ProcessError;
use crate::report::csv_table::CsvTable;
use clap::{Args, ValueEnum};
use nalgebra::{Point3, Vector2};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Longest file of points, bytes. Chosen by hand, far more than any object has.
const LARGEST: u64 = 16 << 20;
const COLUMNS: &str = "id,x_m,y_m,z_m,u_px,v_px,sd_px";

/// Arguments of `vservo calibrate points`.
#[derive(Debug, Args)]
#[command(after_help = "Columns: id,x_m,y_m,z_m,u_px,v_px,sd_px; id and sd_px may be left out.\n\
                  Example: vservo calibrate points corners.csv --size 1280x720 --sd 0.2 --out camera.yaml")]
pub struct CalibratePointsArguments {
    /// CSV file of points, not of one plane: where they are on the object, and where they are seen
    #[arg(value_name = "POINTS.csv")]
    pub points: PathBuf,
    /// Size of the image
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    pub size: String,
    /// Which coefficients of the lens are estimated
    #[arg(long, value_enum, default_value = "pinhole")]
    pub lens: PointLensArgument,
    /// Standard deviation of each coordinate where the file states none, px; left out: as the errors have it
    #[arg(long, value_name = "PX")]
    pub sd: Option<f64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// File to write: the calibration as ROS has it (camera_info, YAML)
    #[arg(long, value_name = "FILE.yaml")]
    pub out: Option<PathBuf>,
    /// Name of the camera in that file
    #[arg(long, default_value = "camera")]
    pub name: String,
}

/// Coefficients of the lens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum PointLensArgument {
    /// None
    Pinhole,
    /// k1
    K1,
    /// k1 and k2
    #[value(name = "k1_k2")]
    K1K2,
    /// k1, k2, p1 and p2
    PlumbBob,
}

impl PointLensArgument {
    fn lens(self) -> PointLens {
        match self {
            Self::Pinhole => PointLens::Pinhole,
            Self::K1 => PointLens::Radial1,
            Self::K1K2 => PointLens::Radial2,
            Self::PlumbBob => PointLens::PlumbBob,
        }
    }
}

#[derive(Serialize)]
struct PointsAnswer {
    camera: CameraOut,
    /// Of the parameters that were estimated, by name.
    sd: BTreeMap<&'static str, f64>,
    /// The object in the camera.
    #[serde(rename = "X_CO")]
    pose: ObjectOut,
    points: Vec<PointOut>,
    rms_px: f64,
    /// `null` where no deviation is stated.
    chi_square: Option<f64>,
    degrees_of_freedom: usize,
    usable: bool,
    verdict: String,
}

#[derive(Serialize)]
struct ObjectOut {
    #[serde(flatten)]
    place: PlaceOut,
    /// Of `[v; w]`, row by row: the position is off by `v`, m, the rotation by `exp(w)` from the left, rad.
    covariance: Vec<f64>,
    position_sd_m: [f64; 3],
    rotation_sd_rad: [f64; 3],
}

#[derive(Serialize)]
struct PointOut {
    id: u64,
    error_px: [f64; 2],
}

/// Calibrates, tells, and writes; the exit code.
pub(in crate::cli) fn points(arguments: &CalibratePointsArguments) -> Result<u8, ProcessError> {
    if let Some(path) = &arguments.out {
        check_writable(path)?;
    }
    let (ids, found) = match calibrated(arguments) {
        Ok(done) => done,
        Err(refusal) => return Ok(refusal.tell()),
    };
    let answer = answer(&ids, &found);
    let text = if arguments.json { json(&answer) } else { told(&answer) };
    let mut exit_code = shown(&text, if answer.usable { 0 } else { Outcome::NotConverged.exit_code() });
    if let Some(path) = &arguments.out {
        let info = CameraInfo::new(&arguments.name, &found.camera);
        let head = format!("# vservo calibrate points: {}\n", answer.verdict);
        exit_code = write_result(path, head + &info.write(), exit_code);
    }
    Ok(exit_code)
}

fn calibrated(a: &CalibratePointsArguments) -> Result<(Vec<u64>, SpaceCalibration), CalibrateError> {
    let size = size_of(&a.size).map_err(CalibrateError::usage)?;
    if a.sd.is_some_and(|sd| !(sd > 0.0 && sd.is_finite())) {
        return Err(CalibrateError::usage("--sd: a standard deviation is greater than 0"));
    }
    let (ids, points) = read(&a.points, size, a.sd).map_err(CalibrateError::input)?;
    let found = calibrate_in_space(&points, size, a.lens.lens())
        .map_err(|e| CalibrateError::with_code(Outcome::NotConverged.exit_code(), e.to_string()))?;
    Ok((ids, found))
}

fn size_of(text: &str) -> Result<(u32, u32), String> {
    let of = |text: &str| text.trim().parse().ok().filter(|side| (16..=65536).contains(side));
    text.split_once('x').and_then(|(w, h)| Some((of(w)?, of(h)?))).ok_or_else(|| {
        format!("--size {text}: the image's columns and rows are expected, as 640x480, each from 16 to 65536")
    })
}

fn read(path: &Path, size: (u32, u32), sd: Option<f64>) -> Result<(Vec<u64>, Vec<PointInSpace>), String> {
    let named = |e: String| format!("{}: {e}", path.display());
    let text = file::read(path, LARGEST).map_err(|e| named(e.to_string()))?;
    parse(&text, size, sd).map_err(named)
}

fn parse(
    text: &str,
    (width, height): (u32, u32),
    sd: Option<f64>,
) -> Result<(Vec<u64>, Vec<PointInSpace>), String> {
    let table = CsvTable::parse(text);
    let has = |name: &str| table.names().iter().any(|own| own == name);
    for name in ["x_m", "y_m", "z_m", "u_px", "v_px"] {
        if !has(name) {
            return Err(format!(
                "there is no column `{name}`; the first line names the columns, as {COLUMNS}"
            ));
        }
    }
    let (mut ids, mut points) = (Vec::new(), Vec::new());
    for row in 0..table.rows() {
        let number = |name: &str| {
            let value = table.number(name, row);
            value
                .is_finite()
                .then_some(value)
                .ok_or_else(|| format!("line {}: `{name}` is no number", row + 2))
        };
        let px = Vector2::new(number("u_px")?, number("v_px")?);
        // Pixel centres are integers.
        let inside = |x: f64, side: u32| (-0.5..f64::from(side) - 0.5).contains(&x);
        if !inside(px.x, width) || !inside(px.y, height) {
            return Err(format!(
                "line {}: ({}, {}) px lies outside of the image of {width} x {height} px of --size",
                row + 2,
                px.x,
                px.y
            ));
        }
        let sd_px = if has("sd_px") { Some(number("sd_px")?) } else { sd };
        if sd_px.is_some_and(|sd| !(sd > 0.0)) {
            return Err(format!("line {}: a standard deviation is greater than 0", row + 2));
        }
        let id = table.number("id", row);
        ids.push(if id >= 0.0 { id as u64 } else { row as u64 });
        let p_O = Point3::new(number("x_m")?, number("y_m")?, number("z_m")?);
        points.push(PointInSpace { p_O, px, sd_px });
    }
    Ok((ids, points))
}

fn answer(ids: &[u64], found: &SpaceCalibration) -> PointsAnswer {
    let C = &found.covariance_X_CO;
    let sd = |from: usize| [0, 1, 2].map(|i| C[(from + i, from + i)].max(0.0).sqrt());
    let share = 100.0 * found.focal_share();
    let usable = found.is_told();
    let verdict = if usable {
        format!("usable: {} points, rms {:.3} px, focal length to {share:.2} %", ids.len(), found.rms_px)
    } else {
        format!(
            "not usable: the points tell the focal length to {share:.0} % only; take more of them, at depths that differ more, over the whole image"
        )
    };
    let point = |(id, e): (&u64, &Vector2<f64>)| PointOut { id: *id, error_px: [e.x, e.y] };
    PointsAnswer {
        camera: (&found.camera).into(),
        sd: found.deviations().collect(),
        pose: ObjectOut {
            place: (&found.X_CO).into(),
            // symmetric: by rows is by columns
            covariance: C.iter().copied().collect(),
            position_sd_m: sd(0),
            rotation_sd_rad: sd(3),
        },
        points: ids.iter().zip(&found.errors_px).map(point).collect(),
        rms_px: found.rms_px,
        chi_square: found.chi_square,
        degrees_of_freedom: found.degrees_of_freedom,
        usable,
        verdict,
    }
}

/// For people.
fn told(answer: &PointsAnswer) -> String {
    let mut text = String::new();
    for (name, value) in answer.camera.parameters() {
        let digits = if name.ends_with("_px") { 2 } else { 5 };
        let _ = match answer.sd.get(name) {
            Some(sd) => writeln!(text, "  {name:6}{value:>11.digits$} +- {sd:.digits$}"),
            None => writeln!(text, "  {name:6}{value:>11.digits$}    fixed"),
        };
    }
    let [x, y, z] = answer.pose.place.position_m;
    let [a, b, c] = answer.pose.position_sd_m.map(|sd| sd * 1e3);
    let [i, j, k, w] = answer.pose.place.rotation_xyzw;
    let [roll, pitch, yaw] = answer.pose.rotation_sd_rad.map(f64::to_degrees);
    let _ = writeln!(
        text,
        "object at ({x:.5}, {y:.5}, {z:.5}) m, sd ({a:.2}, {b:.2}, {c:.2}) mm, rotation ({i:.5}, {j:.5}, {k:.5}, {w:.5}), sd ({roll:.3}, {pitch:.3}, {yaw:.3}) deg"
    );
    if let Some(chi_square) = answer.chi_square {
        let _ =
            writeln!(text, "chi-square {chi_square:.1} of {} degrees of freedom", answer.degrees_of_freedom);
    }
    let _ = writeln!(text, "{}", answer.verdict);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_sizes_and_places_are_checked() {
        let refusal = |text: &str| parse(text, (640, 480), None).unwrap_err();
        assert!(refusal("x_m,y_m,u_px,v_px\n").contains("no column `z_m`"));
        assert!(refusal("x_m,y_m,z_m,u_px,v_px\n0,0,0,1,two\n").contains("line 2: `v_px`"));
        assert!(refusal("x_m,y_m,z_m,u_px,v_px\n0,0,0,1,1\n0,0,0,1,480\n").contains("line 3: (1, 480) px"));
        assert!(refusal("x_m,y_m,z_m,u_px,v_px,sd_px\n0,0,0,1,1,0\n").contains("greater than 0"));
        let (ids, points) =
            parse("id,x_m,y_m,z_m,u_px,v_px\n7,0.1,0.2,0.3,5,6\n", (640, 480), Some(0.3)).unwrap();
        assert_eq!((ids, points[0].sd_px, points[0].p_O), (vec![7], Some(0.3), Point3::new(0.1, 0.2, 0.3)));
        assert_eq!(size_of("1280x720"), Ok((1280, 720)));
        assert!(size_of("1280").is_err() && size_of("8x8").is_err() && size_of("axb").is_err());
    }
}
