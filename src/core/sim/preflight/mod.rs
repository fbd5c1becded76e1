//! What a run has before it: where the camera is and looks at the start and at the goal, what it sees there, whether the arm can get
//! there, and by which way.
//!
//! ```text
//!            ┌─ Visibility   whole marks and plate in the image, at start and goal
//! Config ────┼─ Reach   inverse kinematics with limits: the goal's posture, or the nearest one
//!            ├─ Way     the straight way of the camera: singular postures, ends of ranges
//!            └─ Path    of a goal that moves: speeds, reach of each pose
//! ```
//! All of it is geometry: what an object, a hand or the light do later is not known here. The start is as the simulated cell really is,
//! the goal as it is believed.

mod bound;
mod law;
mod named_goals;
mod occlusion;
mod path;
mod reach;
mod space;
mod stability;
mod targets;
mod words;

pub use bound::BoundAhead;
pub use named_goals::NamedGoalAhead;
pub use path::{GoalPathAhead, OverspeedJoint};
pub use reach::{CameraPath, Posture, Reach};
pub use space::SpaceAhead;
pub use targets::FurtherTargetAhead;

use crate::config::{Config, Scene};
use crate::config::{SetPointKind, Task};
use crate::drive::CommandMode;
use crate::geometry::Pose;
use crate::robot::{JointDescription, Mount, Robot, RobotError};
use crate::scene::{SceneMotion, Visibility};
use crate::servo::Stability;
use nalgebra::{Point3, SVector, Vector3};
use reach::{ReachProblem, in_truth, unasked};
use serde::Serialize;
use std::borrow::Cow;

/// With fewer points no target is tracked, since an affine motion of the plane needs three.
const MIN_TRACKED: usize = 3;

/// What a run has before it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Preflight {
    /// What the camera has before it when the run starts; `None` where no scene says where the object is.
    pub start: Option<Viewpoint>,
    /// What it has before it at the goal; `None` for a goal that is taught on the spot.
    pub goal: Option<Viewpoint>,
    /// Whether the arm gets there.
    pub reach: Reach,
    /// The straight way there; `None` where there is none to look at.
    pub way: Option<CameraPath>,
    /// How near to the goal the camera will be known to be; `None` of a goal that is no pose.
    pub bound: Option<BoundAhead>,
    /// The path of a goal that moves; `None` for one at rest, or where nobody asks for its reach.
    pub path: Option<GoalPathAhead>,
    /// Where the depths in the law's matrix come from; `None` for a law without depths.
    pub depth: Option<String>,
    /// How far the law is from instability with what it believes of lens, mount, target and depth, (10.91); `None` for laws other than scheme
    /// D, and without a scene.
    pub stability: Option<Stability>,
    /// Where the arm is within its limits in space; `None` where no place is limited.
    pub space: Option<SpaceAhead>,
    /// Which points of the target something covers through the whole run, where that leaves too few to find it.
    pub covered: Option<String>,
    /// Where gravity takes more of a joint than its effort limit, so that the arm cannot hold itself.
    pub overload: Option<String>,
    /// Joints whose rotor inertia the robot file does not tell, with what it is likely to be; `None` where nothing is missing, and for drives that are not commanded
    /// by torques.
    pub rotors: Option<String>,
    /// The further targets, by their numbers.
    pub targets: Vec<FurtherTargetAhead>,
    /// The goals that the run file has names for.
    pub goals: Vec<NamedGoalAhead>,
    /// Postures to which the arm is not sent: name, and why.
    #[serde(skip)]
    pub postures: Vec<(String, String)>,
    /// What was left out, and why.
    pub notes: Vec<String>,
    /// Whether another camera controls the arm, too, and may do so while this one does not see its target.
    #[serde(skip)]
    pub has_another_view: bool,
    /// The key of the goal that the run goes by.
    #[serde(skip)]
    pub goal_key: &'static str,
    /// Whether the object rests, so that what is seen now stays true.
    pub object_rests: bool,
}

/// Where a camera is, where it looks and what it sees.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Viewpoint {
    /// The object in the camera.
    #[serde(skip)]
    pub X_CO: Pose,
    /// Position of the object in the camera, m.
    pub object_position_m: [f64; 3],
    /// Orientation of the object in the camera.
    pub object_rotation_xyzw: [f64; 4],
    /// The camera in the base frame, where that is known.
    pub camera: Option<CameraPlace>,
    /// Where the optical axis goes; `None` where it does not meet the target's plane.
    pub axis: Option<AxisFoot>,
    /// The target in the image.
    pub visibility: Visibility,
}

/// A camera in the base frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraPlace {
    /// Position in B, m.
    pub position_m: [f64; 3],
    /// Orientation in B.
    pub rotation_xyzw: [f64; 4],
    /// Direction of the optical axis in B.
    pub looks: [f64; 3],
    /// Angle from straight down, rad; `None` for an arm without gravity.
    pub from_down_rad: Option<f64>,
}

/// Where the optical axis meets the plane of the target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AxisFoot {
    /// Along x and y of the target, m.
    pub place_m: [f64; 2],
    /// How far from the camera, m.
    pub ahead_m: f64,
    /// How far from the middle of the target's plate, m.
    pub beside_m: f64,
}

impl Preflight {
    /// What the run of `config` has before it.
    ///
    /// # Errors
    /// [`RobotError`] when an arm cannot be built.
    pub fn of(config: &Config) -> Result<Self, RobotError> {
        crate::dispatch_robot!(config.robot, |robot| Self::of_goal(config, &robot))?
    }

    /// The same with the further targets, and the goals and postures that the run file has names for, which a run itself need not know.
    ///
    /// # Errors
    /// As for [`Self::of`].
    pub fn with_names(self, config: &Config) -> Result<Self, RobotError> {
        crate::dispatch_robot!(config.robot, |robot| {
            let postures = named_goals::postures_outside(config, &robot);
            let targets = FurtherTargetAhead::all(config, &robot)?;
            Ok(Self { targets, goals: NamedGoalAhead::all(config, &robot)?, postures, ..self })
        })?
    }

    fn of_goal<const N: usize>(config: &Config, robot: &Robot<N>) -> Result<Self, RobotError> {
        let q_start = SVector::<f64, N>::from_fn(|i, _| config.start.q.get(i).copied().unwrap_or_default());
        let start = config.scene.as_ref().map(|scene| start(config, scene, &q_start)).transpose()?;
        let taught = config.goal.is_taught;
        let X_WO = config.X_WO();
        let truth = in_truth(config);
        let cell = truth.as_ref().unwrap_or(config);
        let X_DO = match config.task {
            Task::Servo if !taught && config.servo.estimation.is_none() => cell.set_point.X_DO().copied(),
            _ => None,
        };
        let goal = X_DO.map(|X_DO| {
            let X_BC = match cell.camera.mount {
                Mount::EyeInHand { .. } | Mount::EyeOnLink { .. } => X_WO.map(|X_WO| X_WO * X_DO.inverse()),
                Mount::EyeToHand { X_BC } => Some(X_BC),
            };
            let visibility = Visibility::of(&cell.target, &cell.camera.model, &X_DO);
            Viewpoint::new(cell, X_DO, X_BC, visibility)
        });
        let covered = config.scene.as_ref().zip(start.as_ref());
        let covered = covered.and_then(|(scene, start)| occlusion::covered(config, scene, start));
        let mut preflight = Self {
            start,
            goal,
            reach: Reach::Unasked { why: "" },
            way: None,
            bound: None,
            path: None,
            depth: law::depth(config),
            stability: None,
            space: None,
            covered,
            overload: None,
            rotors: rotors(config),
            targets: Vec::new(),
            goals: Vec::new(),
            postures: Vec::new(),
            notes: notes(config),
            goal_key: if config.set_point.is_seen() { "servo.set_point" } else { "servo.desired" },
            // The cell of a second camera has the run file of both.
            has_another_view: config.effective.second_view.is_some(),
            object_rests: config.scene.as_ref().is_none_or(|scene| scene.motion == SceneMotion::Still),
        };
        let mut q_goal = None;
        preflight.reach = match (unasked(config), X_WO, X_DO) {
            (Some(why), ..) => Reach::Unasked { why },
            (None, Some(X_WO), Some(X_DO)) => {
                let question =
                    ReachProblem { config: cell, robot, q_start, set_point: &cell.set_point, X_WO, X_DO };
                let (reach, found) = question.reach();
                // What lies on the way of a motion that does not look is not asked.
                preflight.way = found.filter(|_| !config.looks_and_moves()).map(|_| question.way());
                preflight.bound = preflight.way.as_ref().and_then(|way| BoundAhead::of(config, robot, way));
                preflight.path = found
                    .zip(config.servo.path.as_ref())
                    .map(|(q, path)| GoalPathAhead::of(path, &ReachProblem { q_start: q, ..question }));
                q_goal = found;
                reach
            }
            _ => Reach::Unasked { why: "the desired features fix no pose of the camera" },
        };
        let postures = [("start", Some(&q_start)), ("goal", q_goal.as_ref())];
        let mut overloads = postures.into_iter().filter_map(|(place, q)| overload(robot, place, q?));
        // A drive that is not commanded by torques holds the arm in its own way, with efforts that are limited all the same.
        preflight.overload = if config.closes_the_loop() { overloads.next() } else { None };
        preflight.space = SpaceAhead::of(config, robot, &q_start, q_goal.as_ref());
        preflight.stability = stability::stability(config, robot, &q_start, q_goal.as_ref())?;
        Ok(preflight)
    }

    /// That the target is not in view at the start: key and message.
    fn unseen_at_the_start(&self) -> Option<(&'static str, String)> {
        let fault = self.start.as_ref()?.visibility.fault()?;
        let message =
            format!("{fault} at the start; move scene.object or the start position, or see `vservo view`");
        Some(("robot.q_start_rad_or_m", message))
    }

    /// What makes the run futile: key and message.
    #[must_use]
    pub fn faults(&self) -> Vec<(Cow<'static, str>, String)> {
        let mut faults: Vec<(&'static str, String)> =
            self.unseen_at_the_start().filter(|_| !self.has_another_view).into_iter().collect();
        if let Some((message, true)) = self.cut_at_the_goal() {
            faults.push((self.goal_key, message));
        }
        if let Some(message) = words::out_of_reach(self) {
            faults.push((self.goal_key, message));
        }
        let held_off = self.space.iter().filter_map(SpaceAhead::held_off);
        faults.extend(held_off.filter(|(_, futile)| *futile).map(|(message, _)| (self.goal_key, message)));
        faults.extend(self.path.iter().filter_map(|path| Some(("servo.path", path.fault()?))));
        faults.into_iter().map(|(key, message)| (key.into(), message)).collect()
    }

    /// What is allowed, but hardly meant: key and message.
    #[must_use]
    pub fn doubts(&self) -> Vec<(Cow<'static, str>, String)> {
        let cut = self.cut_at_the_goal().filter(|(_, futile)| !futile).map(|(message, _)| message);
        let way = self.way.iter().flat_map(words::doubts);
        let held_off = self.space.iter().filter_map(SpaceAhead::held_off).filter(|(_, futile)| !futile);
        let cut = cut.into_iter().chain(held_off.map(|(message, _)| message));
        let unstable = self.stability.iter().filter(|stability| stability.is_doubtful());
        let unstable = unstable.map(|stability| ("servo.depth", words::unstable(stability)));
        let overload = self.overload.clone().map(|message| ("robot.model", message));
        let doubts = cut.chain(way).map(|message| (self.goal_key, message));
        // Each where it stands itself: several have one table above them, which stands where the first one does.
        let of_goal = |goal: &NamedGoalAhead| {
            let told = |doubt: &String| (format!("goals.{}", goal.name).into(), doubt.clone());
            goal.doubts.iter().map(told).collect::<Vec<_>>()
        };
        let named = self.goals.iter().flat_map(of_goal);
        let of_posture = |(name, why): &(String, String)| (format!("postures.{name}").into(), why.clone());
        let postures = self.postures.iter().map(of_posture);
        let path = self.path.iter().filter_map(|path| Some(("servo.path", path.doubt()?)));
        let covered = self.covered.iter().map(|message| ("scene", message.clone()));
        doubts
            .chain(unstable)
            .chain(overload)
            .chain(path)
            .chain(covered)
            .map(|(key, message)| (key.into(), message))
            .chain(named)
            .chain(postures)
            .collect()
    }

    /// What is wrong with the view at the goal, and whether that makes the run futile: a target that is tracked already goes on with
    /// some of its points.
    fn cut_at_the_goal(&self) -> Option<(String, bool)> {
        let visibility = &self.goal.as_ref()?.visibility;
        let message = format!("{} in the desired view; see `vservo view`", visibility.fault()?);
        let shows_nothing = !visibility.front || visibility.is_edge_on();
        Some((message, shows_nothing || visibility.whole < MIN_TRACKED))
    }

    /// All of it in words, a line each.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        words::lines(self)
    }
}

fn notes(config: &Config) -> Vec<String> {
    let mut notes: Vec<String> = Vec::new();
    if config.stereo.is_some() {
        notes.push("of the pair of cameras only the left one is looked at".into());
    }
    if config.start.elsewhere {
        notes.push(
            "the arm may start elsewhere (robot.start_elsewhere): the start is that of the run file".into(),
        );
    }
    let moving = config.camera.mount.moving_joints(config.robot.joint_count());
    if let Some(first) = config.robot.joints.get(moving) {
        let names: Vec<_> =
            config.robot.joints.iter().skip(moving).map(|joint| joint.name.as_str()).collect();
        notes.push(format!(
            "the camera sits before joint \"{}\" (camera.mount.link): {} do not change the image and rest, unless servo.limit_avoidance_1_s moves them",
            first.name,
            names.join(", ")
        ));
    }
    if config.looks_and_moves() {
        notes.push("look_and_move: the arm goes there in the space of its joints, without looking; the goal is met as well as lens, mount and \
                    arm are known".into());
    }
    if config.effective.servo.set_point.kind == SetPointKind::Features {
        notes.push(
            "the goal is the pose from which the points look most like servo.set_point.features".into(),
        );
    }
    if let Some(scene) = &config.scene {
        if scene.places().skip(1).any(|(_, motion)| motion != SceneMotion::Still) {
            notes.push("further targets move: what is told of them is of where they are at the start".into());
        }
        if scene.motion != SceneMotion::Still {
            notes.push("the object moves: all this is of where it is at the start".into());
        }
        if !scene.occluders.is_empty() {
            notes.push("what comes between target and camera (scene.occluder) is left out".into());
        }
    }
    notes
}

/// The rotor inertias that are missing in the robot file. They matter where torques are commanded: a light joint may have many times the inertia of its links.
fn rotors(config: &Config) -> Option<String> {
    let missing = |joint: &&JointDescription| joint.armature == 0.0 && joint.motor.is_none();
    let likely = |joint: &JointDescription| format!("{} {:.2}", joint.name, joint.limits.likely_rotor());
    let joints: Vec<_> = config.robot.joints.iter().filter(missing).map(likely).collect();
    let matters = config.closes_the_loop() && config.drive.mode == CommandMode::Torque && !joints.is_empty();
    matters.then(|| {
        format!(
            "the robot file tells no rotor inertia, and torques are planned without any; give armature_kg_m2 in [[urdf.joint]], or a motor. Likely from the effort and \
             velocity limits, within a factor of 2.5 (kg m^2 or kg): {}",
            joints.join(", ")
        )
    })
}

/// The joints that gravity turns away against their whole effort in `q`, at the `place` of the run, the worst first.
fn overload<const N: usize>(robot: &Robot<N>, place: &str, q: &SVector<f64, N>) -> Option<String> {
    let gravity = robot.gravity(q);
    let share = |i: &usize| gravity[*i].abs() / robot.limits()[*i].effort;
    let mut over: Vec<usize> = (0..N).filter(|i| share(i) > 1.0).collect();
    over.sort_by(|a, b| share(b).total_cmp(&share(a)));
    let told = over.iter().map(|i| {
        let (name, needs, effort) = (&robot.joint_names()[*i], gravity[*i].abs(), robot.limits()[*i].effort);
        format!("{needs:.4} N m or N of joint \"{name}\", whose effort limit is {effort}")
    });
    let told = told.collect::<Vec<_>>().join(", and ");
    (!over.is_empty()).then(|| {
        format!(
            "at the {place} gravity needs {told}: the arm cannot hold itself; correct the limit, the masses or gravity_m_s2"
        )
    })
}

/// What the camera really sees before the arm moves.
fn start<const N: usize>(
    config: &Config,
    scene: &Scene,
    q_start: &SVector<f64, N>,
) -> Result<Viewpoint, RobotError> {
    let q =
        SVector::<f64, N>::from_fn(|i, _| q_start[i] + scene.q_offset.get(i).copied().unwrap_or_default());
    let arm = scene.arm.build::<N>()?;
    let X_CO = scene.mount.X_WC(&arm, &q).inv_mul(&scene.X_WO);
    let X_BC = scene.mount.X_BC(&arm, &q);
    let visibility = Visibility::of(&scene.target, &scene.camera, &X_CO);
    Ok(Viewpoint::new(config, X_CO, Some(X_BC), visibility))
}

impl Viewpoint {
    fn new(config: &Config, X_CO: Pose, X_BC: Option<Pose>, visibility: Visibility) -> Self {
        let xyzw = |X: &Pose| {
            let c = X.rotation.coords;
            [c.x, c.y, c.z, c.w]
        };
        let camera = X_BC.map(|X_BC| {
            let looks = X_BC.rotation * Vector3::z();
            let down = config.robot.gravity_B;
            CameraPlace {
                position_m: X_BC.translation.vector.into(),
                rotation_xyzw: xyzw(&X_BC),
                looks: looks.into(),
                from_down_rad: (down.norm() > 0.0).then(|| looks.angle(&down)),
            }
        });
        let plate = config.target.plate();
        let middle = (plate.low_m + plate.high_m) * 0.5;
        Self {
            object_position_m: X_CO.translation.vector.into(),
            object_rotation_xyzw: xyzw(&X_CO),
            camera,
            axis: axis_foot(&X_CO).map(|(foot, ahead_m)| AxisFoot {
                place_m: [foot.x, foot.y],
                ahead_m,
                beside_m: (foot.coords.xy() - middle).norm(),
            }),
            visibility,
            X_CO,
        }
    }
}

/// Where the optical axis meets the plane z_O = 0, in O, and how far from the camera, m.
fn axis_foot(X_CO: &Pose) -> Option<(Point3<f64>, f64)> {
    let normal = X_CO.rotation * Vector3::z();
    let ahead_m = normal.dot(&X_CO.translation.vector) / normal.z;
    let foot = X_CO.inverse_transform_point(&Point3::new(0.0, 0.0, ahead_m));
    // chosen by hand: an axis that meets the plane a kilometre away runs along it, for a reader
    (ahead_m.is_finite() && ahead_m > 0.0 && ahead_m < 1e3).then_some((foot, ahead_m))
}

#[cfg(test)]
mod tests;
