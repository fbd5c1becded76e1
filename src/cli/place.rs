//! `vservo place [CONFIG] --out FILE.toml`: a start and a goal for an arm and a target, tried in a simulated run, as a run file.

use super::{PlaceArguments, check_writable, json, shown, write_result};
use crate::config::ANGLES_DEG;
use crate::config::Draft;
use crate::config::SetPointKind;
use crate::geometry::{Pose, roll_pitch_yaw};
use crate::input::printable;
use crate::process::ProcessError;
use crate::rt::tell;
use crate::sim::place::{Look, PlaceError, PlaceRequest, Placement, place as find};
use crate::sim::preflight::Preflight;
use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;
use toml::{Table, Value};

/// Keys whose values are paths that count from the run file's folder.
const PATHS: [&str; 16] = [
    "camera.external.folder",
    "camera.lens.file",
    "camera.replay.folder",
    "camera.replay.recording",
    "cameras.*.external.folder",
    "cameras.*.lens.file",
    "cameras.*.replay.folder",
    "cameras.*.replay.recording",
    "drive.external.folder",
    "drive.replay.recording",
    "goals.*.file",
    "postures.*.file",
    "robot.model",
    "scene.arm.model",
    "servo.set_point.file",
    "stereo.taught_file",
];

/// What `--json` prints.
#[derive(Serialize)]
struct PlaceAnswer<'a> {
    q_start: &'a [f64],
    q_goal: &'a [f64],
    settling_time_s: Option<f64>,
    preflight: &'a Preflight,
}

/// # Errors
/// When the run file is wrong or no place is found.
pub(super) fn place(arguments: &PlaceArguments) -> Result<u8, ProcessError> {
    let request = match request(arguments) {
        Ok(request) => request,
        Err(message) => {
            tell(format_args!("vservo: {}", printable(&message)));
            return Ok(2);
        }
    };
    if let Some(path) = &arguments.out {
        check_writable(path)?;
    }
    // without a file only what differs from the defaults is to be written
    let draft = match &arguments.config {
        Some(path) => Draft::load(Some(path), &arguments.set)?,
        None => Draft::parse("embedded default configuration", "", Path::new("."), &arguments.set)?,
    };
    let placement = match find(&draft, &request) {
        Ok(placement) => placement,
        Err(PlaceError::Config(error)) => return Err(error.into()),
        Err(PlaceError::Robot(error)) => return Err(error.into()),
        Err(error @ (PlaceError::Nowhere { .. } | PlaceError::NoRun { .. })) => {
            tell(format_args!("vservo: {}", printable(&error.to_string())));
            return Ok(5);
        }
        Err(error) => {
            tell(format_args!("vservo: {}", printable(&error.to_string())));
            return Ok(3);
        }
    };
    let text = run_file(&draft, &placement);
    let Some(path) = &arguments.out else {
        return Ok(shown(&if arguments.json { answer(&placement) } else { text }, 0));
    };
    let code = write_result(path, text, 0);
    if code != 0 {
        return Ok(code);
    }
    let told = if arguments.json { answer(&placement) } else { words(path, &placement) };
    Ok(shown(&told, 0))
}

fn answer(placement: &Placement) -> String {
    json(&PlaceAnswer {
        q_start: &placement.q_start,
        q_goal: &placement.q_goal,
        settling_time_s: placement.run.settling_time_s,
        preflight: &placement.preflight,
    })
}

fn words(path: &Path, placement: &Placement) -> String {
    let path = printable(&path.display().to_string());
    let mut text = format!("{path}: a simulated run from its start converges");
    if let Some(settling_s) = placement.run.settling_time_s {
        let _ = write!(text, ", within 2 % after {settling_s:.2} s");
    }
    text.push('\n');
    for line in placement.preflight.lines() {
        let _ = writeln!(text, "{}", printable(&line));
    }
    let _ = writeln!(text, "now: vservo view {path} --out view.png; vservo run {path}");
    text
}

fn request(arguments: &PlaceArguments) -> Result<PlaceRequest, String> {
    let object = arguments.object.as_deref().map(|text| {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
        let of = |message: &str| {
            format!(
                "--object {text}: {message}: X,Y,Z in m, and where it is turned too ROLL,PITCH,YAW in deg"
            )
        };
        let numbers = numbers.map_err(|_| of("is no list of numbers"))?;
        // The ranges of the run file's keys, since these numbers are written to one.
        if !numbers.iter().all(|n| ANGLES_DEG.contains(n)) || numbers.iter().take(3).any(|m| m.abs() > 100.0)
        {
            return Err(of("is out of range, allowed are 100 m and 361 deg"));
        }
        match *numbers.as_slice() {
            [x, y, z] => Ok((Vector3::new(x, y, z), None)),
            [x, y, z, roll, pitch, yaw] => {
                let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_radians);
                let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
                Ok((Vector3::new(x, y, z), Some(rotation)))
            }
            _ => Err(of("has neither 3 nor 6 numbers")),
        }
    });
    if let Some(distance_m) = arguments.distance_m.filter(|d| !(0.01..=100.0).contains(d)) {
        return Err(format!("--distance-m {distance_m}: is out of range, allowed is 0.01 to 100 m"));
    }
    let is_turned = matches!(&object, Some(Ok((_, Some(_)))));
    if is_turned && !matches!(arguments.look.map(Look::from), None | Some(Look::Any)) {
        return Err(
            "--look: the camera looks where --object is turned to; leave out one of them, or ROLL,PITCH,YAW"
                .into(),
        );
    }
    Ok(PlaceRequest {
        look: arguments.look.map(Look::from),
        object: object.transpose()?,
        distance_m: arguments.distance_m,
    })
}

/// The run file: what was written, with the placement in its place.
/// What is written in `draft`, independent of where the new file stands.
pub(super) fn run_file_table(draft: &Draft) -> Table {
    let mut table = draft.written().clone();
    for key in PATHS.iter().filter(|key| !draft.is_argument(key)) {
        make_absolute(&mut table, key, draft.folder());
    }
    table
}

fn run_file(draft: &Draft, placement: &Placement) -> String {
    let mut table = run_file_table(draft);
    let pose = |X: &Pose| {
        let list = |v: [f64; 3]| {
            Value::Array(v.into_iter().map(|x| Value::Float((x * 1e6).round() / 1e6 + 0.0)).collect())
        };
        let rpy = roll_pitch_yaw(&X.rotation.to_rotation_matrix());
        [("position_m", list(X.translation.vector.into())), ("rotation_rpy_rad", list(rpy))]
    };
    let q_start = placement.q_start.iter().map(|q| Value::Float(*q)).collect();
    let q_start = Value::Array(q_start);
    change(&mut table, &["robot"], &mut |robot| {
        robot.insert("model".into(), Value::String(draft.robot_model().into()));
        robot.insert("q_start_rad_or_m".into(), q_start.clone());
    });
    for (path, X) in [(["scene", "object"], &placement.X_WO), (["servo", "desired"], &placement.X_DO)] {
        change(&mut table, &path, &mut |place| {
            place.retain(|key, _| key == "on");
            place.extend(pose(X).map(|(key, value)| (key.to_string(), value)));
        });
    }
    if draft.set_point_kind() != SetPointKind::Pose {
        change(&mut table, &["servo", "set_point"], &mut |set_point| {
            set_point.retain(|key, _| key != "file" && key != "features");
            set_point.insert("kind".into(), Value::String("pose".into()));
        });
    }
    let mut text = String::from(
        "# Start and goal as `vservo place` proposes them: a simulated run from here converges. Frames: docs/frames.md\n#\n",
    );
    for line in placement.preflight.lines() {
        let _ = writeln!(text, "# {}", printable(line.trim_end()));
    }
    text.push('\n');
    text + &toml::to_string(&table).unwrap_or_default()
}

/// Calls `change` with the table at `path`, which is made where it is not there.
pub(super) fn change(table: &mut Table, path: &[&str], then: &mut dyn FnMut(&mut Table)) {
    let Some((first, rest)) = path.split_first() else { return then(table) };
    let entry = table.entry(*first).or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(inner) = entry {
        change(inner, rest, then);
    }
}

/// Makes the path at `key` independent of where the new file stands.
fn make_absolute(table: &mut Table, key: &str, folder: &Path) {
    match key.split_once('.') {
        Some((name, inner)) => {
            let each = inner.strip_prefix("*.");
            for inside in tables_of(table.get_mut(name), each.is_some()) {
                make_absolute(inside, each.unwrap_or(inner), folder);
            }
        }
        None => {
            if let Some(Value::String(path)) = table.get_mut(key)
                && path.contains(['.', '/'])
                && let Ok(absolute) = std::path::absolute(folder.join(&*path))
            {
                *path = absolute.display().to_string();
            }
        }
    }
}

/// A table, or, of those in it or in a list, each.
fn tables_of(value: Option<&mut Value>, each: bool) -> Vec<&mut Table> {
    match (value, each) {
        (Some(Value::Table(table)), true) => {
            table.iter_mut().filter_map(|(_, inner)| inner.as_table_mut()).collect()
        }
        (Some(Value::Array(list)), true) => list.iter_mut().filter_map(Value::as_table_mut).collect(),
        (Some(Value::Table(table)), false) => vec![table],
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_file_of_a_run_file_keeps_its_place() {
        for key in PATHS {
            let text = match key.split_once(".*.") {
                Some((list @ "cameras", inner)) => {
                    format!("[[{list}]]\nname = \"a\"\n[[{list}]]\n{inner} = \"files/a.toml\"\n")
                }
                Some((tables, inner)) => format!("[{tables}.part]\n{inner} = \"files/a.toml\"\n"),
                None => format!("{key} = \"files/a.toml\"\n"),
            };
            let mut table: Table = text.parse().unwrap();
            make_absolute(&mut table, key, Path::new("/cell"));
            assert!(toml::to_string(&table).unwrap().contains("\"/cell/files/a.toml\""), "{key}: {table}");
        }
        let named: Table = "robot.model = \"ur5\"".parse().unwrap();
        let mut same = named.clone();
        make_absolute(&mut same, "robot.model", Path::new("/cell"));
        assert_eq!(same, named, "a name is no file");
    }
}
