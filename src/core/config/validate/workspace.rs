//! `[workspace]`: limits in space.
//!
//! The ranges and numbers here were chosen by hand, wider than any cell, so that slips of units are found.

use super::motion::joint_list;
use crate::config::check::Validation;
use crate::config::raw::{MountKind, RawConfig, RawWorkspace};
use crate::motion::{HalfSpace, SpaceLimit, Workspace, WorkspaceSettings};
use crate::robot::{Mount, RobotDescription};
use nalgebra::{SVector, Vector3};
use std::ops::RangeInclusive;

const PLACE_M: RangeInclusive<f64> = -100.0..=100.0;
const RADIUS_M: RangeInclusive<f64> = 0.0..=1.0;

/// The limits in space; `None` where the run file sets none. `mount` is that of the camera.
pub(super) fn workspace(
    raw: &RawConfig,
    robot: Option<&RobotDescription>,
    mount: Option<&Mount>,
    check: &mut Validation<'_>,
) -> Option<WorkspaceSettings> {
    let w = &raw.workspace;
    let joints = robot.map(RobotDescription::joint_count);
    let key = |name: &str| format!("workspace.{name}");
    let before = check.count_problems();
    let mut speed = |name: &str, value: Option<f64>| {
        value.map_or(f64::INFINITY, |value| check.range(&key(name), value, 1e-3..=100.0))
    };
    let camera_speed_m_s = speed("camera_speed_m_s", w.camera_speed_m_s);
    let camera_turn_rad_s = speed("camera_turn_rad_s", w.camera_turn_rad_s);
    let flange_speed_m_s = speed("flange_speed_m_s", w.flange_speed_m_s);
    if raw.camera.mount.kind == MountKind::EyeToHand {
        for (name, value) in
            [("camera_speed_m_s", w.camera_speed_m_s), ("camera_turn_rad_s", w.camera_turn_rad_s)]
        {
            if value.is_some() {
                check.wrong(
                    &key(name),
                    "the camera stands beside the arm (camera.mount.kind): limit the flange (workspace.flange_speed_m_s)",
                );
            }
        }
    }
    if let Some(Mount::EyeOnLink { .. }) = mount {
        on_a_link(w, check);
    }
    let margin_m = check.range(&key("margin_m"), w.margin_m, 1e-3..=0.5);
    let link_radius_m = joint_list(&key("link_radius_m"), &w.link_radius_m, joints, RADIUS_M, check);
    let camera_radius_m = check.range(&key("camera_radius_m"), w.camera_radius_m, RADIUS_M);
    let tool_radius_m = check.range(&key("tool_radius_m"), w.tool_radius_m, RADIUS_M);
    let tool = w.tool_m.map(|p| {
        let p = Vector3::from_fn(|i, _| check.range(&format!("workspace.tool_m[{i}]"), p[i], -5.0..=5.0));
        (p, tool_radius_m)
    });
    if w.self_collision && !w.links {
        check.wrong(&key("self_collision"), "needs the links: set workspace.links = true");
    }
    let sides = sides(w, check);
    let camera = match mount {
        Some(Mount::EyeInHand { X_EC }) => Some((X_EC.translation.vector, camera_radius_m)),
        _ => None,
    };
    let is_fast = [camera_speed_m_s, camera_turn_rad_s, flange_speed_m_s].iter().all(|v| v.is_infinite());
    if check.count_problems() > before || (is_fast && sides.is_empty() && !w.self_collision) {
        return None;
    }
    Some(WorkspaceSettings {
        camera_speed_m_s,
        camera_turn_rad_s,
        flange_speed_m_s,
        margin_m,
        sides,
        link_radius_m: if w.links { link_radius_m } else { Vec::new() },
        camera,
        tool,
        self_collision: w.self_collision,
    })
}

/// A camera on a link is no part of the arm that is kept off planes, and its speed is not limited by itself.
fn on_a_link(w: &RawWorkspace, check: &mut Validation<'_>) {
    for (name, value) in
        [("camera_speed_m_s", w.camera_speed_m_s), ("camera_turn_rad_s", w.camera_turn_rad_s)]
    {
        if value.is_some() {
            check.wrong(
                &format!("workspace.{name}"),
                "the camera sits on a link (camera.mount.link): limit the flange (workspace.flange_speed_m_s)",
            );
        }
    }
    if !w.planes.is_empty() || !w.boxes.is_empty() || w.self_collision {
        check.doubtful(
            "camera.mount.link",
            "a camera on a link is not kept off planes, boxes and links by itself: make workspace.link_radius_m of its link so large that it holds the camera",
        );
    }
}

/// The half spaces of planes and boxes.
fn sides(w: &RawWorkspace, check: &mut Validation<'_>) -> Vec<HalfSpace> {
    let mut sides = Vec::new();
    let count = w.planes.len() + 6 * w.boxes.len();
    if count > SpaceLimit::MAX_SIDES {
        let message = format!(
            "has {} planes and {} boxes of six each, together at most {} are possible",
            w.planes.len(),
            w.boxes.len(),
            SpaceLimit::MAX_SIDES
        );
        check.wrong("workspace", message);
        return sides;
    }
    let place = |key: &str, p: &[f64; 3], check: &mut Validation<'_>| {
        Vector3::from_fn(|i, _| check.range(&format!("{key}[{i}]"), p[i], PLACE_M))
    };
    for (k, plane) in w.planes.iter().enumerate() {
        let at = format!("workspace.planes[{k}]");
        let name = named(&plane.name, &at, check);
        let point = place(&format!("{at}.point_m"), &plane.point_m, check);
        let normal =
            Vector3::from_fn(|i, _| check.range(&format!("{at}.normal[{i}]"), plane.normal[i], -1e3..=1e3));
        // A direction below this is a slip of the unit; chosen by hand.
        match normal.try_normalize(1e-6) {
            Some(normal) => sides.push(HalfSpace { name, normal, offset_m: normal.dot(&point) }),
            None => check.wrong(&format!("{at}.normal"), "has no direction"),
        }
    }
    for (k, one) in w.boxes.iter().enumerate() {
        let at = format!("workspace.boxes[{k}]");
        let name = named(&one.name, &at, check);
        let low = place(&format!("{at}.min_m"), &one.min_m, check);
        let high = place(&format!("{at}.max_m"), &one.max_m, check);
        for i in 0..3 {
            if !(low[i] < high[i]) {
                check.wrong(&format!("{at}.max_m[{i}]"), format!("is not above {at}.min_m[{i}]"));
            }
            let axis = Vector3::from_fn(|k, _| if k == i { 1.0 } else { 0.0 });
            sides.push(HalfSpace { name: name.clone(), normal: axis, offset_m: low[i] });
            sides.push(HalfSpace { name: name.clone(), normal: -axis, offset_m: -high[i] });
        }
    }
    sides
}

/// What messages call it: what the file says, else its key.
fn named(name: &str, at: &str, check: &mut Validation<'_>) -> String {
    // Longer ones make no readable line; chosen by hand.
    if name.chars().count() > 40 || name.chars().any(char::is_control) {
        check
            .wrong(&format!("{at}.name"), "is longer than 40 letters, or has letters that cannot be printed");
    }
    if name.is_empty() { at.trim_start_matches("workspace.").to_owned() } else { name.to_owned() }
}

/// Checks that the arm starts inside.
pub(super) fn start(
    raw: &RawConfig,
    robot: &RobotDescription,
    settings: &WorkspaceSettings,
    check: &mut Validation<'_>,
) {
    let q = &raw.robot.q_start_rad_or_m;
    let beyond = crate::dispatch_robot!(robot, |arm| {
        let q = SVector::from_fn(|i, _| q.get(i).copied().unwrap_or_default());
        Workspace::new(arm, settings.clone()).beyond(&q)
    });
    if let Ok(Some(beyond)) = beyond {
        let message = format!(
            "{}: start elsewhere, or correct [workspace]; an arm that stands there already is brought back by `vservo ctl goto` or `jog` of a served run \
             with robot.start_elsewhere = true",
            beyond.describe()
        );
        check.wrong("robot.q_start_rad_or_m", message);
    }
}
