//! Where the arm starts, and what the camera sees from there.

use crate::config::Camera;
use crate::config::check::Check;
use crate::config::raw::RawConfig;
use crate::config::servo::{tilted, uses_dimension};
use crate::geometry::Pose;
use crate::robot::{self, POSITION_RAD_OR_M, RobotDescription};
use crate::target::DotTarget;
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

/// The first dot (from 1) that the camera does not see when the target lies at `X_CO`, and why.
pub(super) fn hidden_dot(target: &DotTarget, camera: &Camera, X_CO: &Pose) -> Option<(usize, &'static str)> {
    target.points_O().iter().enumerate().find_map(|(i, p_O)| match camera.model.project(&(X_CO * p_O)) {
        None => Some((i + 1, "behind the camera")),
        Some(px) if !camera.model.contains(&px, 0.0) => Some((i + 1, "outside the image")),
        Some(_) => None,
    })
}

/// What the camera sees before the arm moves.
pub(super) fn view(
    raw: &RawConfig,
    robot: &RobotDescription,
    target: &DotTarget,
    camera: &Camera,
    X_WO: &Pose,
    check: &mut Check<'_>,
) {
    let q = &raw.robot.q_start_rad_or_m;
    match crate::dispatch_robot!(robot, |arm| arm.forward(&SVector::from_column_slice(q))) {
        Ok(X_BE) => {
            let X_CO = camera.mount.X_WC(&X_BE).inv_mul(X_WO);
            if raw.servo.dimension == 4 && uses_dimension(raw.servo.scheme) && tilted(&X_CO) {
                let message = "is 4, but the target is tilted against the image at the start";
                check.wrong("servo.dimension", message);
            }
            if let Some((dot, why)) = hidden_dot(target, camera, &X_CO) {
                let message = format!(
                    "dot {dot} of the target lies {why} at the start; move scene.object or the start position"
                );
                check.wrong("robot.q_start_rad_or_m", message);
            }
        }
        Err(e) => check.wrong("robot.model", e.to_string()),
    }
}
