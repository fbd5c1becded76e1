//! `camera.lens.file`: the lens comes from a calibration file of ROS instead of from keys. The numbers take the place of the file's
//! name, so that the effective configuration needs no file.

use super::raw::{RawCamera, RawConfig};
use super::{Document, Problem};
use crate::camera_model::LensModel;
use crate::camera_model::camera_info::CameraInfo;
use crate::input::file;
use std::path::Path;
use toml::Table;

/// Longest calibration file, bytes, so that a hostile one takes no memory: real ones have a thousand.
const MAX_FILE: u64 = 1 << 20;

/// Puts the lens of each camera right: that of its file, or the coefficients that its model has. `absolute` makes a path of the run file
/// absolute.
pub(super) fn resolve(
    raw: &mut RawConfig,
    document: &Document,
    absolute: impl Fn(&str, &Path) -> std::path::PathBuf,
    problems: &mut Vec<Problem>,
) {
    let written =
        |table: Option<&toml::Value>| table.and_then(toml::Value::as_table).cloned().unwrap_or_default();
    let single = written(document.table.get("camera"));
    one(&mut raw.camera, "camera", &single, document, &absolute, problems);
    let list = document.table.get("cameras").and_then(toml::Value::as_array);
    for (i, camera) in raw.cameras.iter_mut().enumerate() {
        let table = written(list.and_then(|list| list.get(i)));
        one(camera, &format!("cameras[{i}]"), &table, document, &absolute, problems);
    }
}

fn one(
    camera: &mut RawCamera,
    at: &str,
    written: &Table,
    document: &Document,
    absolute: &impl Fn(&str, &Path) -> std::path::PathBuf,
    problems: &mut Vec<Problem>,
) {
    let nothing = Table::new();
    let keys = written.get("lens").and_then(toml::Value::as_table).unwrap_or(&nothing);
    let Some(file) = camera.lens.file.take() else {
        // The defaults are those of a plumb-bob lens.
        if LensModel::from(camera.lens.model) != LensModel::PlumbBob {
            for (name, _) in camera.lens.coefficients() {
                if let Some(place) = camera.lens.coefficient_mut(name).filter(|_| !keys.contains_key(name)) {
                    *place = 0.0;
                }
            }
        }
        return;
    };
    let mut wrong =
        |key: &str, message: String| problems.push(document.problem(&format!("{at}.{key}"), message));
    for key in keys.keys().filter(|key| *key != "file") {
        wrong(&format!("lens.{key}"), format!("is in {at}.lens.file already: leave out one of them"));
    }
    let path = absolute(&format!("{at}.lens.file"), &file);
    let read = file::read(&path, MAX_FILE).map_err(|e| format!("{} cannot be read: {e}", path.display()));
    let info = read.and_then(|text| {
        CameraInfo::read(&text)
            .map_err(|e| format!("{}: {e}; a calibration file of ROS is expected", path.display()))
    });
    let info = match info {
        Ok(info) => info,
        Err(message) => return wrong("lens.file", message),
    };
    let i = info.intrinsics;
    for (key, given, found) in
        [("width_px", &mut camera.width_px, i.width_px), ("height_px", &mut camera.height_px, i.height_px)]
    {
        if written.contains_key(key) && *given != found {
            let message = format!(
                "is {given}, but the calibration in {} is of an image with {found}: leave {key} out, or calibrate at that size; \
                 for a part of the image use [{at}.roi]",
                path.display()
            );
            wrong(key, message);
        }
        *given = found;
    }
    let lens = &mut camera.lens;
    (lens.fx_px, lens.fy_px) = (i.fx_px, i.fy_px);
    (lens.cx_px, lens.cy_px) = (Some(i.cx_px), Some(i.cy_px));
    lens.model = info.lens.model().into();
    for (name, _) in lens.coefficients() {
        let value =
            info.lens.coefficients().iter().find(|(n, _)| *n == name).map_or(0.0, |(_, value)| *value);
        if let Some(place) = lens.coefficient_mut(name) {
            *place = value;
        }
    }
}
