//! Where the arm starts, and what the camera sees from there.

use crate::camera_model::CameraModel;
use crate::config::check::Validation;
use crate::config::raw::{RawConfig, RawTool};
use crate::config::servo::{tilted, uses_dimension};
use crate::config::{Camera, Scene};
use crate::geometry::Pose;
use crate::robot::{self, Inertia, Mount, POSITION_RAD_OR_M, RobotDescription, RobotError};
use crate::scene::{PointVisibility, Visibility};
use crate::servo::GoalPath;
use crate::target::Target;
use nalgebra::{Matrix3, SVector, Vector3};

/// Heaviest tool, kg, and its farthest centre of mass from the flange, m. Chosen by hand, beyond what any arm of two to seven joints is rated for.
const MOST_KG: f64 = 1e3;
const FARTHEST_M: f64 = 2.0;
/// Largest moment of inertia of a load, kg m^2. Derived: the heaviest tool with half of its mass at the farthest place on each side.
const MOST_KG_M2: f64 = MOST_KG * FARTHEST_M * FARTHEST_M;
/// Where it is told that the target is not in the image at the start.
pub(in crate::config) const START: &str = "robot.q_start_rad_or_m";
/// Most hidden points that are listed. Chosen by hand, for a readable line.
const TOLD: usize = 8;

/// The robot, with a start inside its limits.
pub(super) fn arm(raw: &RawConfig, check: &mut Validation<'_>) -> Option<RobotDescription> {
    let robot = match robot::load(&raw.robot.model) {
        Ok(robot) => robot,
        Err(e) => {
            check.wrong("robot.model", e.to_string());
            return None;
        }
    };
    for note in &robot.notes {
        check.doubtful("robot.model", note.clone());
    }
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
    Some(robot.carrying(&tool(raw, check)))
}

/// The tool on the flange.
pub(super) fn tool(raw: &RawConfig, check: &mut Validation<'_>) -> Inertia {
    let RawTool { mass_kg, com_m, inertia_kg_m2 } = raw.tool;
    let before = check.count_problems();
    let mass = check.range("tool.mass_kg", mass_kg, 0.0..=MOST_KG);
    let com = com_m.map(|x| check.range("tool.com_m", x, -FARTHEST_M..=FARTHEST_M));
    if check.count_problems() > before {
        return Inertia::ZERO;
    }
    load(mass, com.into(), ("tool.inertia_kg_m2", &inertia_kg_m2), check)
}

/// A body of `mass` kg with its centre of mass at `com`, m, and the moments xx, yy, zz, xy, xz, yz about it, kg m^2.
pub(super) fn body(mass: f64, com: Vector3<f64>, [xx, yy, zz, xy, xz, yz]: [f64; 6]) -> Inertia {
    Inertia { mass, com, about_com: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) }
}

/// A load of `mass` kg at `com`, m, with the moments xx, yy, zz, xy, xz, yz about it, kg m^2, which stand under their key; none where no body can have them.
pub(super) fn load(
    mass: f64,
    com: Vector3<f64>,
    (key, moments): (&str, &[f64; 6]),
    check: &mut Validation<'_>,
) -> Inertia {
    let before = check.count_problems();
    let moments = moments.map(|x| check.range(key, x, -MOST_KG_M2..=MOST_KG_M2));
    if check.count_problems() > before {
        return Inertia::ZERO;
    }
    let load = body(mass, com, moments);
    if let Err(problem) = load.check_load() {
        check.wrong(key, problem.to_string());
        return Inertia::ZERO;
    }
    load
}

/// A point that the camera does not see.
pub(super) struct HiddenPoint {
    /// Which, from 1.
    pub(super) point: usize,
    /// Where it is instead.
    pub(super) why: &'static str,
    /// How far its mark is beyond which border, and what else is hidden, in words.
    pub(super) how_far: String,
}

/// The first point whose centre the camera does not see when the target lies at `X_CO`; where so many are hidden that the target
/// cannot be found.
pub(super) fn hidden(target: &Target, camera: &CameraModel, X_CO: &Pose) -> Option<HiddenPoint> {
    let visibility = Visibility::of(target, camera, X_CO);
    let why = |point: &PointVisibility| match point.px {
        _ if point.turned_away => Some("on a face that is turned away"),
        None => Some("behind the camera"),
        Some(px) if !camera.contains(&px.into(), 0.0) => Some("outside the image"),
        Some(_) => None,
    };
    let hidden: Vec<_> = visibility.points.iter().filter_map(|point| Some((point, why(point)?))).collect();
    if visibility.points.len() - hidden.len() >= visibility.needed {
        return None;
    }
    let (first, why) = hidden.first()?;
    if let Some(too_large) = visibility.too_large_in_words() {
        return Some(HiddenPoint { point: first.point, why, how_far: format!(" ({too_large})") });
    }
    let mut how_far = Vec::new();
    if !first.outside.is_none() {
        how_far.push(first.outside.describe());
    }
    if hidden.len() > 1 {
        let others = hidden.iter().skip(1).take(TOLD).map(|(point, _)| point.point.to_string());
        let more = if hidden.len() > TOLD + 1 { " ..." } else { "" };
        how_far.push(format!("hidden too: {}{more}", others.collect::<Vec<_>>().join(", ")));
    }
    let how_far = if how_far.is_empty() { String::new() } else { format!(" ({})", how_far.join("; ")) };
    Some(HiddenPoint { point: first.point, why, how_far })
}

/// Places between two poses of a path at which the view is looked at. Chosen by hand: for 4 degrees and a few centimetres each on usual paths.
const VIEWS_BETWEEN: u32 = 8;

/// Checks that the target is in the image all along the path of the goal.
pub(super) fn path_view(target: &Target, camera: &CameraModel, path: &GoalPath, check: &mut Validation<'_>) {
    let mut from_s = 0.0;
    // The first pose is servo.desired, which has been looked at.
    for (i, (t_s, _)) in path.poses().skip(1).enumerate() {
        let places =
            (1..=VIEWS_BETWEEN).map(|k| from_s + (t_s - from_s) * f64::from(k) / f64::from(VIEWS_BETWEEN));
        let first = places.filter_map(|t_s| Some((t_s, hidden(target, camera, &path.at(t_s).X_DO)?))).next();
        if let Some((t_s, hidden)) = first {
            let message = format!(
                "point {} would lie {} in the desired view at {t_s:.2} s{}",
                hidden.point, hidden.why, hidden.how_far
            );
            check.wrong(&format!("servo.path.poses[{i}]"), message);
        }
        from_s = t_s;
    }
}

/// Checks that the target is in the image before the arm moves, for the true scene and for the controller's model.
pub(super) fn view(
    raw: &RawConfig,
    robot: &RobotDescription,
    (camera, scene): (&Camera, &Scene),
    views: bool,
    check: &mut Validation<'_>,
) {
    let q = &raw.robot.q_start_rad_or_m;
    let q_true: Vec<f64> = q.iter().zip(&scene.q_offset).map(|(q, offset)| q + offset).collect();
    match (camera_at(robot, &camera.mount, q), camera_at(&scene.arm, &scene.mount, &q_true)) {
        (Ok(X_WC), Ok(true_X_WC)) => {
            let believed = X_WC.inv_mul(&scene.X_WO);
            if raw.servo.dimension == 4 && uses_dimension(raw.servo.scheme) && tilted(&believed) {
                let message = "is 4, but the target is tilted against the image at the start";
                check.wrong("servo.dimension", message);
            }
            let seen = true_X_WC.inv_mul(&scene.X_WO);
            if let Some(HiddenPoint { point, why, how_far }) =
                hidden(&scene.target, &scene.camera, &seen).filter(|_| views)
            {
                let message = format!(
                    "point {point} of the target lies {why} at the start{how_far}; move scene.object or the start position, see `vservo \
                     view`"
                );
                // Of two cameras that both control the arm one is enough: `second_view` looks at both.
                if raw.second_view.is_some() {
                    check.doubtful(START, message);
                } else {
                    check.wrong(START, message);
                }
            }
        }
        (Err(e), _) => check.wrong("robot.model", e.to_string()),
        (_, Err(e)) => check.wrong("scene.arm", e.to_string()),
    }
}

/// The camera in the frame of the object.
fn camera_at(robot: &RobotDescription, mount: &Mount, q: &[f64]) -> Result<Pose, RobotError> {
    crate::dispatch_robot!(robot, |arm| mount.X_WC(&arm, &SVector::from_column_slice(q)))
}
