//! Representations of a pose in a run file, which are all converted to position and roll, pitch, yaw.
//!
//! | key | what |
//! |---|---|
//! | `rotation_rpy_rad` | `R = Rz(yaw) Ry(pitch) Rx(roll)`, about fixed axes |
//! | `rotation_rpy_deg` | the same in degrees |
//! | `rotation_xyzw` | unit quaternion |
//! | `rotation_vector_rad` | axis times angle |
//! | `matrix` | 4 x 4, row by row; instead of `position_m` too |
//!
//! One of them stands in a table. What `--set` gives takes the place of what the file has.

use super::keys::PoseTable;
use super::raw::RawConfig;
use super::{Document, Problem};
use crate::geometry::{closest_rotation, roll_pitch_yaw};
use crate::input::number;
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use std::ops::RangeInclusive;

const RPY_RAD: &str = "rotation_rpy_rad";
const RPY_DEG: &str = "rotation_rpy_deg";
const XYZW: &str = "rotation_xyzw";
const VECTOR_RAD: &str = "rotation_vector_rad";
const MATRIX: &str = "matrix";
const POSITION: &str = "position_m";
const ALL: [&str; 5] = [RPY_RAD, RPY_DEG, XYZW, VECTOR_RAD, MATRIX];

/// A turn and some, as for `rotation_rpy_rad`; ranges wider than any use, chosen, so that a slip is reported.
pub const DEG: RangeInclusive<f64> = -361.0..=361.0;
const RAD: RangeInclusive<f64> = -6.3..=6.3;
const POSITION_M: RangeInclusive<f64> = -100.0..=100.0;
/// Tolerance of the norm of a quaternion and of the products of a matrix's columns. Derived: three decimals are off by 5e-4 each, and four
/// of them in a sum of products by up to 2e-3.
const ROUNDING: f64 = 2e-3;

/// Whether `key` is, or lies in, one of the forms that are turned into another.
pub(super) fn is_form(key: &str) -> bool {
    let form = |name: &str| key.rsplit('.').next().is_some_and(|last| last.starts_with(name));
    ALL.iter().skip(1).any(|name| form(name))
}

/// Makes position and roll, pitch, yaw of every pose, however it is written.
pub(super) fn resolve(raw: &mut RawConfig, document: &Document, problems: &mut Vec<Problem>) {
    let mut one = |key: &str, table: &mut dyn PoseTable| resolve_one(key, table, document, problems);
    one("camera.mount", &mut raw.camera.mount);
    for (i, camera) in raw.cameras.iter_mut().enumerate() {
        one(&format!("cameras[{i}].mount"), &mut camera.mount);
    }
    let further = raw.targets.iter_mut().map(|(name, target)| (format!("targets.{name}"), target));
    let second = raw.second_view.iter_mut().map(|second| ("second_view.target".into(), &mut second.target));
    for (key, target) in std::iter::once(("target".into(), &mut raw.target)).chain(further).chain(second) {
        for (i, face) in target.points.tags.iter_mut().enumerate() {
            one(&format!("{key}.points.tags[{i}]"), face);
        }
        for (i, face) in target.points.faces.iter_mut().enumerate() {
            one(&format!("{key}.points.faces[{i}]"), face);
        }
    }
    one("scene.object", &mut raw.scene.object);
    if let Some(second) = &mut raw.second_view {
        one("second_view.object", &mut second.object);
        one("second_view.desired", &mut second.desired);
    }
    for (name, object) in &mut raw.scene.objects {
        one(&format!("scene.objects.{name}"), object);
    }
    one("scene.camera.mount", &mut raw.scene.camera.mount);
    one("servo.desired", &mut raw.servo.desired);
    for (i, pose) in raw.servo.path.poses.iter_mut().enumerate() {
        one(&format!("servo.path.poses[{i}]"), pose);
    }
    if let Some(X) = raw.stereo.as_mut().and_then(|stereo| stereo.right_in_left.as_mut()) {
        one("stereo.right_in_left", X);
    }
}

/// The same of the pose in the table at `key`.
pub(super) fn resolve_one(
    key: &str,
    table: &mut dyn PoseTable,
    document: &Document,
    problems: &mut Vec<Problem>,
) {
    let mut wrong = |name: &str, message: String| {
        problems.push(document.problem(&format!("{key}.{name}"), message));
    };
    let forms = table.take_forms();
    let Some(form) = the_one(key, document, &mut wrong) else { return };
    let rotation = match form {
        RPY_DEG => forms.rpy_deg.and_then(|rpy| of_degrees(rpy, &mut wrong)),
        XYZW => forms.xyzw.and_then(|xyzw| of_quaternion(xyzw, &mut wrong)),
        VECTOR_RAD => forms.vector_rad.and_then(|vector| of_vector(vector, &mut wrong)),
        MATRIX => forms.matrix.and_then(|rows| {
            let (position_m, R) = of_matrix(&rows, &mut wrong)?;
            table.set_position_m(position_m);
            Some(roll_pitch_yaw(&R))
        }),
        _ => None,
    };
    if let Some(rpy_rad) = rotation {
        table.set_rotation_rpy_rad(rpy_rad);
    }
}

/// Which form the table at `key` takes; `None` where it has none, or several.
fn the_one(key: &str, document: &Document, wrong: &mut impl FnMut(&str, String)) -> Option<&'static str> {
    let written = |name: &str| document.get(&format!("{key}.{name}")).is_some();
    let argued = |name: &str| document.is_argument(&format!("{key}.{name}"));
    let mut forms: Vec<&'static str> = ALL.into_iter().filter(|name| written(name)).collect();
    if forms.iter().any(|name| argued(name)) {
        forms.retain(|name| argued(name));
    }
    match *forms.as_slice() {
        [] => None,
        [MATRIX] if written(POSITION) && argued(POSITION) >= argued(MATRIX) => {
            wrong(MATRIX, format!("has the position too: leave out {POSITION}, or write the rotation alone"));
            None
        }
        [form] => Some(form),
        [first, second, ..] => {
            wrong(second, format!("says what {first} says too: leave out one of them"));
            None
        }
    }
}

/// Whether all of `values` lie in `allowed`; reports those that do not.
fn within(
    name: &str,
    values: &[f64],
    allowed: &RangeInclusive<f64>,
    wrong: &mut impl FnMut(&str, String),
) -> bool {
    let mut good = true;
    for (i, value) in values.iter().enumerate().filter(|(_, value)| !allowed.contains(value)) {
        let (low, high) = (number(*allowed.start()), number(*allowed.end()));
        let message = format!("{} is out of range, allowed is {low} to {high}", number(*value));
        wrong(&format!("{name}[{i}]"), message);
        good = false;
    }
    good
}

fn of_degrees(rpy_deg: [f64; 3], wrong: &mut impl FnMut(&str, String)) -> Option<[f64; 3]> {
    within(RPY_DEG, &rpy_deg, &DEG, wrong).then(|| rpy_deg.map(f64::to_radians))
}

fn of_vector(vector_rad: [f64; 3], wrong: &mut impl FnMut(&str, String)) -> Option<[f64; 3]> {
    let R = || Rotation3::from_scaled_axis(Vector3::from(vector_rad));
    within(VECTOR_RAD, &vector_rad, &RAD, wrong).then(|| roll_pitch_yaw(&R()))
}

fn of_quaternion([x, y, z, w]: [f64; 4], wrong: &mut impl FnMut(&str, String)) -> Option<[f64; 3]> {
    if !within(XYZW, &[x, y, z, w], &(-1.1..=1.1), wrong) {
        return None;
    }
    let q = Quaternion::new(w, x, y, z);
    if !((q.norm() - 1.0).abs() <= ROUNDING) {
        let message = format!(
            "has length {}: a rotation's quaternion has length 1; the order is x, y, z, w, the real part last",
            number((q.norm() * 1e4).round() / 1e4)
        );
        wrong(XYZW, message);
        return None;
    }
    Some(roll_pitch_yaw(&UnitQuaternion::from_quaternion(q).to_rotation_matrix()))
}

fn of_matrix(
    rows: &[[f64; 4]; 4],
    wrong: &mut impl FnMut(&str, String),
) -> Option<([f64; 3], Rotation3<f64>)> {
    let [top @ .., last] = rows;
    let mut good = true;
    for (i, [.., position_m]) in top.iter().enumerate() {
        if !POSITION_M.contains(position_m) {
            let message = format!("{} is out of range, allowed is -100 to 100 m", number(*position_m));
            wrong(&format!("{MATRIX}[{i}][3]"), message);
            good = false;
        }
    }
    // The last row is written as whole numbers: anything above rounding would do.
    if !last.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(found, wanted)| (found - wanted).abs() <= 1e-6) {
        let message = "is not [0, 0, 0, 1]: the rows of the transformation are wanted, with the position in the last column, m";
        wrong(&format!("{MATRIX}[3]"), message.into());
        good = false;
    }
    let R = Matrix3::from_fn(|i, j| top[i][j]);
    let off = (R.transpose() * R - Matrix3::identity()).amax();
    let closest = if off <= ROUNDING && R.determinant() > 0.0 { closest_rotation(&R) } else { None };
    let Some(closest) = closest else {
        let message = if off <= ROUNDING {
            "is a mirror image, no rotation: one of the columns of its upper left 3 x 3 has the wrong sign"
        } else {
            "is no rotation: the columns of its upper left 3 x 3 must have length 1 and be square to each other"
        };
        wrong(MATRIX, message.into());
        return None;
    };
    good.then(|| (top.map(|[.., position_m]| position_m), closest))
}

#[cfg(test)]
mod tests;
