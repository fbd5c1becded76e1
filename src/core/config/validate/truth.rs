//! `[scene]`: the true parameters of a simulated cell, from the nominal ones and the deviations in the file.
//!
//! The numbers here are ranges wider than any use, chosen, so that a slip of the pen is reported; `tests/cores/plausible_numbers.rs` tries their ends.

use super::scene_motion::scene_motion;
use super::{lens, mount};
use crate::camera_model::{CameraModel, Intrinsics, Lens};
use crate::config::check::{Validation, pose};
use crate::config::raw::{
    DriveKind, RawBackdrop, RawBystander, RawConfig, RawOccluder, RawScene, RawSceneMotion,
};
use crate::config::target::{LENGTH_M, RawTarget, made};
use crate::config::{Camera, FurtherTarget, Scene, SceneObject};
use crate::robot::{self, Mount, RobotDescription};
use crate::scene::{Backdrop, Bystander, Occluder, SceneLook, SceneMotion};
use crate::target::{Kind, Target};
use crate::time::SpanNs;
use nalgebra::Vector2;
use std::ops::RangeInclusive;

/// Ranges of factors between truth and model. Chosen by hand: they contain every error that is worth a simulation.
const SCALE: RangeInclusive<f64> = 0.01..=100.0;
const MASS_SCALE: RangeInclusive<f64> = 0.1..=10.0;
const FRICTION_SCALE: RangeInclusive<f64> = 0.0..=10.0;
/// Range of encoder offsets, rad or m. Chosen by hand: no joint that was ever referenced is farther off.
const OFFSET_RAD_OR_M: RangeInclusive<f64> = -1.0..=1.0;

/// Checks all of `[scene]`; the scene of a run whose images are rendered, where camera, target and robot are good.
pub(super) fn scene(
    raw: &RawConfig,
    (camera, believed_target, robot): (Option<&Camera>, Option<&Target>, Option<&RobotDescription>),
    further: Option<&[FurtherTarget]>,
    motion: SceneMotion,
    check: &mut Validation<'_>,
) -> Option<Scene> {
    let object = &raw.scene.object;
    let X_WO = check.pose("scene.object", object.position_m, object.rotation_rpy_rad);
    let further_targets = further_objects(raw, further, check);
    let lens = true_lens(raw, camera, check);
    let mount = true_mount(raw, camera, check);
    let target = true_target(raw, believed_target, check);
    let arm = true_arm(raw, robot, check);
    let q_offset = q_offset(raw, robot, check);
    let occluders = occluders(&raw.scene, check);
    let backdrop = backdrop(&raw.scene.backdrop, raw.run.seed, check);
    let bystanders = bystanders(&raw.scene.bystanders, check);
    camera.filter(|c| c.source.kind().is_simulated())?;
    Some(Scene {
        camera: lens?,
        mount,
        target: target?,
        X_WO,
        motion,
        occluders,
        backdrop,
        bystanders: bystanders?,
        further_targets: further_targets?,
        arm: arm?,
        q_offset: q_offset?,
    })
}

/// Where the further targets are and how they move, each beside its target.
fn further_objects(
    raw: &RawConfig,
    further: Option<&[FurtherTarget]>,
    check: &mut Validation<'_>,
) -> Option<Vec<SceneObject>> {
    let before = check.count_problems();
    let mut poses = std::collections::BTreeMap::new();
    for (name, object) in &raw.scene.objects {
        let key = format!("scene.objects.{name}");
        if object.on != raw.scene.object.on {
            check.wrong(&format!("{key}.on"), "must be that of scene.object");
        }
        let X_WO = check.pose(&key, object.position_m, object.rotation_rpy_rad);
        let still = RawSceneMotion::default();
        let motion = scene_motion(&format!("{key}.motion"), object.motion.as_ref().unwrap_or(&still), check);
        poses.insert(name.as_str(), (X_WO, motion));
    }
    if raw.scene.object.motion.is_some() {
        check.wrong(
            "scene.object.motion",
            "is that of further targets ([scene.objects.NAME.motion]): this one moves as [scene.motion] says",
        );
    }
    if check.count_problems() > before {
        return None;
    }
    let object = |of: &FurtherTarget| {
        let (X_WO, motion) = *poses.get(of.name.as_str())?;
        Some(SceneObject { target: of.target.clone(), X_WO, motion })
    };
    further?.iter().map(object).collect()
}

fn true_lens(raw: &RawConfig, camera: Option<&Camera>, check: &mut Validation<'_>) -> Option<CameraModel> {
    let before = check.count_problems();
    let believed = camera.map(|c| (c.model.full_intrinsics(), *c.model.lens()));
    // Without a nominal lens its numbers do not matter; those that are given are checked all the same.
    let nothing = Intrinsics { fx_px: 1.0, fy_px: 1.0, cx_px: 0.0, cy_px: 0.0, width_px: 16, height_px: 16 };
    let instead = believed.unwrap_or((nothing, Lens::default()));
    let (intrinsics, true_lens) = lens::true_one(&raw.scene.camera.lens, instead, check);
    if believed.is_none() || check.count_problems() > before {
        return None;
    }
    let read = camera.map(|c| *c.model.region());
    let made = CameraModel::new(intrinsics, true_lens);
    let made = made.and_then(|whole| read.map_or(Ok(whole), |region| whole.cropped(&region)));
    made.map_err(|e| check.wrong("scene.camera.lens", e.to_string())).ok()
}

fn true_mount(raw: &RawConfig, camera: Option<&Camera>, check: &mut Validation<'_>) -> Mount {
    let (mount, believed) = (&raw.scene.camera.mount, &raw.camera.mount);
    // Only what is given here is this table's to answer for.
    let given = |list: Option<[f64; 3]>| list.unwrap_or_default();
    check.pose("scene.camera.mount", given(mount.position_m), given(mount.rotation_rpy_rad));
    let X = pose(
        mount.position_m.unwrap_or(believed.position_m),
        mount.rotation_rpy_rad.unwrap_or(believed.rotation_rpy_rad),
    );
    // Without a camera there is no scene either: only its own keys are checked.
    let nominal = camera.map_or(Mount::EyeInHand { X_EC: X }, |camera| camera.mount);
    mount::true_mount(raw, (mount.link.as_ref(), X), &nominal, check)
}

fn true_target(raw: &RawConfig, believed: Option<&Target>, check: &mut Validation<'_>) -> Option<Target> {
    let (t, b) = (&raw.scene.target, &raw.target);
    let before = check.count_problems();
    let scale = t.scale.map_or(1.0, |scale| check.range("scene.target.scale", scale, SCALE));
    for (key, given) in [
        ("side_m", t.side_m),
        ("radius_m", t.radius_m),
        ("radius_p1_m", t.radius_p1_m),
        ("radius_p2_m", t.radius_p2_m),
        ("margin_m", t.margin_m),
    ] {
        if let Some(length_m) = given {
            check.range(&format!("scene.target.{key}"), length_m, LENGTH_M);
        }
    }
    believed?;
    if check.count_problems() > before {
        return None;
    }
    let all = b.scaled(scale);
    let truth = RawTarget {
        side_m: t.side_m.unwrap_or(all.side_m),
        radius_m: t.radius_m.unwrap_or(all.radius_m),
        radius_p1_m: t.radius_p1_m.unwrap_or(all.radius_p1_m),
        radius_p2_m: t.radius_p2_m.or(all.radius_p2_m),
        margin_m: t.margin_m.unwrap_or(all.margin_m),
        ..all
    };
    made("scene.target", &truth, check)
}

/// `[scene.occluder]`, then `[[scene.occluders]]`.
fn occluders(raw: &RawScene, check: &mut Validation<'_>) -> Vec<Occluder> {
    let first = occluder("scene.occluder", &raw.occluder, check);
    let others: Vec<_> = (0..)
        .zip(&raw.occluders)
        .filter_map(|(i, raw): (usize, _)| occluder(&format!("scene.occluders[{i}]"), raw, check))
        .collect();
    first.into_iter().chain(others).collect()
}

/// `[scene.backdrop]`.
fn backdrop(raw: &RawBackdrop, seed: u64, check: &mut Validation<'_>) -> Backdrop {
    let mut range = |key: &str, value, allowed| check.range(&format!("scene.backdrop.{key}"), value, allowed);
    let (texture_levels, texture_size_m, clutter_size_m, clutter_reach_m) = (
        range("texture_levels", raw.texture_levels, Backdrop::TEXTURE_LEVELS),
        range("texture_size_m", raw.texture_size_m, Backdrop::SIZE_M),
        range("clutter_size_m", raw.clutter_size_m, Backdrop::SIZE_M),
        range("clutter_reach_m", raw.clutter_reach_m, Backdrop::SIZE_M),
    );
    let clutter = check.count("scene.backdrop.clutter", raw.clutter, 0..=Backdrop::MAX_CLUTTER);
    Backdrop { texture_levels, texture_size_m, clutter, clutter_size_m, clutter_reach_m, seed }
}

/// `[[scene.bystanders]]`.
fn bystanders(raw: &[RawBystander], check: &mut Validation<'_>) -> Option<Vec<Bystander>> {
    let mut all = Vec::new();
    for (i, one) in raw.iter().enumerate() {
        let at = format!("scene.bystanders[{i}]");
        for (k, m) in one.position_m.iter().enumerate() {
            check.range(&format!("{at}.position_m[{k}]"), *m, -100.0..=100.0);
        }
        let turn_rad = check.range(&format!("{at}.turn_rad"), one.turn_rad, -6.3..=6.3);
        match one.target.parse::<Kind>() {
            Ok(Kind { target, .. }) => {
                all.push(Bystander { target, position_m: one.position_m.into(), turn_rad });
            }
            Err(e) => check.wrong(&format!("{at}.target"), e.to_string()),
        }
    }
    (all.len() == raw.len()).then_some(all)
}

fn occluder(at: &str, raw: &RawOccluder, check: &mut Validation<'_>) -> Option<Occluder> {
    let [from_s, until_s] = [("from_s", raw.from_s), ("until_s", raw.until_s)]
        .map(|(key, s)| check.range(&format!("{at}.{key}"), s, 0.0..=1e6));
    let pair = |key: &str, values: [f64; 2], least: f64, check: &mut Validation<'_>| {
        for (i, m) in values.iter().enumerate() {
            check.range(&format!("{at}.{key}[{i}]"), *m, least..=100.0);
        }
        Vector2::from(values)
    };
    let occluder = Occluder {
        centre_m: pair("center_m", raw.center_m, -100.0, check),
        size_m: pair("size_m", raw.size_m, 1e-6, check),
        height_m: check.range(&format!("{at}.height_m"), raw.height_m, 0.0..=100.0),
        level: check.range(&format!("{at}.level"), raw.level, SceneLook::LEVEL),
        from: SpanNs::from_s(from_s),
        until: SpanNs::from_s(until_s),
    };
    if until_s <= from_s && from_s > 0.0 {
        let message = format!(
            "{until_s} s is not later than from_s, {from_s} s: what goes before it comes never comes"
        );
        check.doubtful(&format!("{at}.until_s"), message);
    }
    (until_s > from_s).then_some(occluder)
}

fn true_arm(
    raw: &RawConfig,
    believed: Option<&RobotDescription>,
    check: &mut Validation<'_>,
) -> Option<RobotDescription> {
    let arm = &raw.scene.arm;
    if raw.drive.kind == DriveKind::External {
        for (key, given) in [
            ("scene.arm.model", arm.model.is_some()),
            ("scene.arm.mass_scale", arm.mass_scale.is_some()),
            ("scene.arm.friction_scale", arm.friction_scale.is_some()),
            ("scene.arm.q_offset_rad_or_m", !arm.q_offset_rad_or_m.is_empty()),
        ] {
            if given {
                check.wrong(key, "the arm of an external drive is the drive's own: change it there");
            }
        }
    }
    let mass = arm.mass_scale.map_or(1.0, |s| check.range("scene.arm.mass_scale", s, MASS_SCALE));
    let friction =
        arm.friction_scale.map_or(1.0, |s| check.range("scene.arm.friction_scale", s, FRICTION_SCALE));
    let other = match &arm.model {
        None => None,
        Some(model) => match robot::load(model) {
            Ok(robot) => Some(robot.carrying(&super::start::tool(raw, check))),
            Err(e) => {
                check.wrong("scene.arm.model", e.to_string());
                return None;
            }
        },
    };
    let believed = believed?;
    if let Some(other) = &other {
        let kinds = |robot: &RobotDescription| robot.joints.iter().map(|j| j.kind).collect::<Vec<_>>();
        if kinds(other) != kinds(believed) {
            let message = format!(
                "{} has {} joints that are not of the same kinds as the {} of {}: an arm with small differences is meant",
                other.name,
                other.joint_count(),
                believed.joint_count(),
                believed.name
            );
            check.wrong("scene.arm.model", message);
            return None;
        }
    }
    Some(other.unwrap_or_else(|| believed.clone()).scaled(mass, friction))
}

fn q_offset(
    raw: &RawConfig,
    robot: Option<&RobotDescription>,
    check: &mut Validation<'_>,
) -> Option<Vec<f64>> {
    let (key, list) = ("scene.arm.q_offset_rad_or_m", &raw.scene.arm.q_offset_rad_or_m);
    for (i, offset) in list.iter().enumerate() {
        check.range(&format!("{key}[{i}]"), *offset, OFFSET_RAD_OR_M);
    }
    let joints = robot?.joint_count();
    match list.as_slice() {
        [] => Some(vec![0.0; joints]),
        [one] => Some(vec![*one; joints]),
        list if list.len() != joints => {
            check.wrong(key, format!("has {} entries, needs 1 or {joints}", list.len()));
            None
        }
        list => Some(list.to_vec()),
    }
}
