//! Where a camera is mounted: flange, link or base; and what a camera on a link leaves of the rest of the run file.

use crate::config::check::Validation;
use crate::config::place::RawMount;
use crate::config::raw::{MountKind, RawConfig, SchemeKind, Task};
use crate::geometry::Pose;
use crate::robot::{self, Mount, RobotDescription};
use crate::servo::{InteractionAt, Law, OperationalSpace, SetPoint};

/// Key of the link below that of the mount.
const LINK: &str = "link";

/// The camera at the pose `X` as the table `at` has it.
pub(super) fn mount(
    raw: &RawConfig,
    (written, X, at): (&RawMount, Pose, &str),
    check: &mut Validation<'_>,
) -> Mount {
    let key = format!("{at}.{LINK}");
    match (written.kind, &written.link) {
        (MountKind::EyeInHand, None) => Mount::EyeInHand { X_EC: X },
        (MountKind::EyeToHand, None) => Mount::EyeToHand { X_BC: X },
        (MountKind::EyeToHand, Some(_)) => {
            check.wrong(&key, "is for a camera on the arm, and kind is `eye_to_hand`: leave out one of them");
            Mount::EyeToHand { X_BC: X }
        }
        (MountKind::EyeInHand, Some(name)) => {
            on_link(&raw.robot.model, (name, X, &key), check).unwrap_or(Mount::EyeInHand { X_EC: X })
        }
    }
}

/// The true mount of a simulated camera, which is believed at `believed`: on the same link, unless `link` names another one of the true arm.
pub(super) fn true_mount(
    raw: &RawConfig,
    (link, X): (Option<&String>, Pose),
    believed: &Mount,
    check: &mut Validation<'_>,
) -> Mount {
    const KEY: &str = "scene.camera.mount.link";
    let Some(name) = link else { return believed.with_pose(X) };
    if raw.camera.mount.kind == MountKind::EyeToHand {
        check.wrong(KEY, "is for a camera on the arm, and camera.mount.kind is `eye_to_hand`: leave it out");
        return believed.with_pose(X);
    }
    let model = raw.scene.arm.model.as_ref().unwrap_or(&raw.robot.model);
    on_link(model, (name, X, KEY), check).unwrap_or(believed.with_pose(X))
}

/// A camera at `X` on the link `name` of a robot file; `None` where there is no such link, or no such file, which is told at its own key.
fn on_link(model: &str, (name, X, key): (&str, Pose, &str), check: &mut Validation<'_>) -> Option<Mount> {
    let robot = robot::load(model).ok()?;
    let Some(joints) = robot.joints_to_link(name) else {
        let known: Vec<_> = robot
            .joints
            .iter()
            .map(|joint| format!("\"{}\" (joint \"{}\")", joint.link, joint.name))
            .collect();
        check.wrong(
            key,
            format!("{} has no link or joint \"{name}\"; it has the links {}", robot.name, known.join(", ")),
        );
        return None;
    };
    Some(Mount::EyeOnLink { joints, X_LC: X })
}

/// Refuses what does not go with joints beyond the camera, and tells where the law asks for more than the joints before it can do.
pub(super) fn beyond_the_camera(
    raw: &RawConfig,
    (mount, robot): (&Mount, &RobotDescription),
    (law, set_point): (&Law, &SetPoint),
    check: &mut Validation<'_>,
) {
    const KEY: &str = "camera.mount.link";
    let Mount::EyeOnLink { .. } = mount else { return };
    if raw.run.task == Task::CalibrateHandEye {
        check.wrong(
            KEY,
            "run.task = \"calibrate_hand_eye\" is for a camera on the flange or beside the arm: give `vservo calibrate hand-eye` the poses of the link \
             instead of the flange's, or refine it from a run (`vservo calibrate from`)",
        );
    }
    let (all, joints) = (robot.joint_count(), mount.moving_joints(robot.joint_count()));
    if joints == all {
        return;
    }
    let names: Vec<_> = robot.joints.iter().skip(joints).map(|joint| joint.name.as_str()).collect();
    let beyond = names.join(", ");
    if law.is_torque() {
        check.wrong(
            KEY,
            format!(
                "the schemes A and C command torques by the motion of the camera alone, and nothing would hold {beyond} beyond it: use a resolved-velocity \
                 scheme (B, D, hybrid), or a camera on the flange"
            ),
        );
    }
    if raw.servo.interaction == InteractionAt::Estimated {
        check.wrong(
            KEY,
            format!(
                "servo.interaction is \"estimated\", which learns by every joint, and {beyond} do not move the camera: let the Jacobian be computed"
            ),
        );
    }
    let asked = match law {
        Law::PositionTorque { space, .. }
        | Law::PositionVelocity { space, .. }
        | Law::Hybrid { space, .. } => match space {
            OperationalSpace::Four => 4,
            OperationalSpace::Six | OperationalSpace::Homography => 6,
        },
        _ => 6.min(2 * set_point.selection().points().count()),
    };
    if raw.servo.scheme != SchemeKind::LookAndMove && asked > joints {
        check.doubtful(
            KEY,
            format!(
                "the law asks for {asked} degrees of freedom, and {joints} joints move the camera: only goals that these reach are met, others as well as \
                 least squares allow ({beyond} beyond the camera rest)"
            ),
        );
    }
}
