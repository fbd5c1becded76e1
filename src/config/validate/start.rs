//! Where the arm starts, and what the camera sees from there.

use crate::camera_model::CameraModel;
use crate::config::check::Check;
use crate::config::raw::RawConfig;
use crate::config::servo::{tilted, uses_dimension};
use crate::config::{Camera, Scene};
use crate::geometry::Pose;
use crate::robot::{self, POSITION_RAD_OR_M, RobotDescription, RobotError};
use crate::target::Target;
use nalgebra::SVector;

/// The robot, with a start inside its limits.
pub(super) fn arm(raw: &RawConfig, check: &mut Check<'_>) -> Option<RobotDescription> {
    let robot = match robot::load(&raw.robot.model) {
        Ok(robot) => robot,
        Err(e) => {
            check.wrong("robot.model", e.to_string());
            return None;
        }
    };
    let joints = robot.joint_count();
    let q = &raw.robot.q_start_rad_or_m;
    if q.len() == joints {
        for (i, (q, joint)) in q.iter().zip(&robot.joints).enumerate() {
            let (lower, upper) = (joint.limits.lower, joint.limits.upper);
            let allowed = lower.max(-POSITION_RAD_OR_M)..=upper.min(POSITION_RAD_OR_M);
            check.range(&format!("robot.q_start_rad_or_m[{i}]"), *q, allowed);
        }
    } else {
        check.wrong(
            "robot.q_start_rad_or_m",
            format!("has {} entries, {} has {joints} joints", q.len(), robot.name),
        );
    }
    Some(robot)
}

/// The first dot (from 1) that the camera does not see when the target lies at `X_CO`, and why; where so many are hidden that the
/// target cannot be found.
pub(super) fn hidden_dot(
    target: &Target,
    camera: &CameraModel,
    X_CO: &Pose,
) -> Option<(usize, &'static str)> {
    let hidden = |p_O| match camera.project(&(X_CO * p_O)) {
        None => Some("behind the camera"),
        Some(px) if !camera.contains(&px, 0.0) => Some("outside the image"),
        Some(_) => None,
    };
    let all = target.points();
    let seen = all.iter().filter(|point| hidden(point.p_O).is_none()).count();
    if seen >= target.least_to_find() {
        return None;
    }
    all.iter().enumerate().find_map(|(i, point)| Some((i + 1, hidden(point.p_O)?)))
}

/// What the camera sees before the arm moves, and what the controller believes that it sees.
pub(super) fn view(
    raw: &RawConfig,
    robot: &RobotDescription,
    camera: &Camera,
    scene: &Scene,
    check: &mut Check<'_>,
) {
    let q = &raw.robot.q_start_rad_or_m;
    let q_true: Vec<f64> = q.iter().zip(&scene.q_offset).map(|(q, offset)| q + offset).collect();
    match (flange(robot, q), flange(&scene.arm, &q_true)) {
        (Ok(X_BE), Ok(true_X_BE)) => {
            let believed = camera.mount.X_WC(&X_BE).inv_mul(&scene.X_WO);
            if raw.servo.dimension == 4 && uses_dimension(raw.servo.scheme) && tilted(&believed) {
                let message = "is 4, but the target is tilted against the image at the start";
                check.wrong("servo.dimension", message);
            }
            let seen = scene.mount.X_WC(&true_X_BE).inv_mul(&scene.X_WO);
            if let Some((dot, why)) = hidden_dot(&scene.target, &scene.camera, &seen) {
                let message = format!(
                    "point {dot} of the target lies {why} at the start; move scene.object or the start position"
                );
                check.wrong("robot.q_start_rad_or_m", message);
            }
        }
        (Err(e), _) => check.wrong("robot.model", e.to_string()),
        (_, Err(e)) => check.wrong("scene.arm", e.to_string()),
    }
}

fn flange(robot: &RobotDescription, q: &[f64]) -> Result<Pose, RobotError> {
    crate::dispatch_robot!(robot, |arm| arm.forward(&SVector::from_column_slice(q)))
}
