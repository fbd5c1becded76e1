//! From a place in a suite to a scenario: what is true and what is believed of it, a start from which the target is in view and the goal within reach, and
//! the least time from there.
//!
//! A start turns and shifts the target about its middle m before the camera at the goal:
//! `X_SO = T(m + d) R_roll R_tilt T(-m) X_DO`, with the tilt's axis in the plane of the image and d sideways each in a random direction.

use super::least_time::{is_there, least_time_s};
use super::suite::{BenchmarkCase, float, settings};
use super::{BenchmarkError, BenchmarkPlace, BenchmarkSuite, BenchmarkTask};
use crate::config::{Config, Scene, assemble};
use crate::geometry::{Pose, roll_pitch_yaw};
use crate::linalg::Random;
use crate::robot::Robot;
use crate::scene::{SceneMotion, Visibility};
use crate::servo::{PostureSearch, SetPoint, nearest_limit};
use crate::target::Target;
use nalgebra::{SVector, UnitQuaternion, Vector3};
use serde::Serialize;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use toml::Value;

/// Draws until a start is in view and within reach. Chosen by hand: where one in a hundred is, all fail in 1e-9 of the cases.
const DRAWS: usize = 2000;
/// Searches for a posture at the goal, chosen by hand, as in the preflight check.
const GOAL_SEARCHES: usize = 60;
/// Least distance of the marks from the image's border at the start, px. Chosen by hand, as for random starts elsewhere.
const ROOM_PX: f64 = 12.0;
/// Distances of the target from the camera at the start, m. Chosen by hand: a little more than the dots of every shipped target allow.
const DISTANCE_M: std::ops::Range<f64> = 0.12..1.5;
/// Least distance of each joint from an end of its range at start and goal, rad or m. Chosen by hand: a start at the very end is a fault of the task.
const ROOM_OF_JOINTS: f64 = 0.02;

/// One start of one case: what every law gets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchmarkScenario {
    /// Where it is in the suite.
    #[serde(skip)]
    pub place: BenchmarkPlace,
    /// Which case of the task.
    pub case: BTreeMap<String, Value>,
    /// The `--set` values that every law gets, truth and belief.
    pub set: Vec<String>,
    /// Start of the joints, rad or m.
    pub q_start: Vec<f64>,
    /// The desired pose of the camera: the object in it, position m and rotation x, y, z, w.
    pub goal_position_m: [f64; 3],
    /// See above.
    pub goal_rotation_xyzw: [f64; 4],
    /// The least time in which the arm can be there, s; `None` for a target that moves.
    pub least_time_s: Option<f64>,
    /// The same goal.
    #[serde(skip)]
    pub(super) X_DO: Pose,
}

/// The sequence of random numbers of a start: the same for all cases of its task, so that they differ in what they are about alone.
fn random_of(suite: &BenchmarkSuite, task: &BenchmarkTask, start: u32) -> Random {
    let named = task.name.bytes().fold(suite.seed, |seed, byte| Random::new(seed ^ u64::from(byte)).bits());
    Random::new(named ^ u64::from(start))
}

/// The scenario of a place.
///
/// # Errors
/// [`BenchmarkError::Task`] where the run file does not take the values of the task, or no start is found.
pub fn scenario(suite: &BenchmarkSuite, place: BenchmarkPlace) -> Result<BenchmarkScenario, BenchmarkError> {
    let missing = || suite.has_no(&format!("{place:?}"));
    let task = suite.tasks.get(place.task).ok_or_else(missing)?;
    let cases = task.cases();
    let case = cases.get(place.case).ok_or_else(missing)?;
    let of_task = |e: String| BenchmarkError::task(task, e);
    let mut random = random_of(suite, task, place.start);
    let mut set = vec![
        "run.clock=lockstep".to_owned(),
        format!("run.duration_s={:?}", task.duration_s),
        // whether it is at the goal is judged here, by the truth: no run ends by itself
        format!("goal.hold_s={:?}", task.duration_s),
        // run.seed has 63 bits
        format!("run.seed={}", random.bits() >> 1),
    ];
    for table in ["world", "asked"] {
        set.extend(settings(&task.drawn(table, case, &mut random)));
    }
    let world = suite.config(task, &set, false).map_err(|e| of_task(e.to_string()))?;
    let (Some(scene), Some(X_DO)) = (world.scene.clone(), world.set_point.X_DO().copied()) else {
        let cause = "needs a run file with a simulated scene and a desired pose (servo.desired)";
        return Err(of_task(cause.into()));
    };
    let believed = believed(task, case, &world, &mut random).map_err(of_task)?;
    if !believed.is_empty() {
        set.extend(believed);
        // a goal that was shown: what the true camera sees there, as the believed one reads it
        let config = suite.config(task, &set, false).map_err(|e| of_task(e.to_string()))?;
        let shown = |p_O| Some(config.camera.model.normalized_of(&scene.camera.project(&(X_DO * p_O))?));
        let shown: Option<Vec<_>> = scene.target.points().iter().map(|point| shown(point.p_O)).collect();
        let shown = shown.ok_or_else(|| of_task("the goal lies behind the camera".into()))?;
        let numbers: Vec<[f64; 2]> = shown.into_iter().map(Into::into).collect();
        set.push("servo.set_point.kind=\"features\"".into());
        set.push(format!("servo.set_point.features={numbers:?}"));
    }
    let drawn = crate::dispatch_robot!(scene.arm, |robot| {
        StartSearch { task, case, config: &world, scene: &scene, robot: &robot, X_DO }.start(&mut random)
    });
    let (q_start, least_time_s) = drawn.map_err(|e| of_task(e.to_string()))?.map_err(of_task)?;
    set.push(format!("robot.q_start_rad_or_m={q_start:?}"));
    let c = X_DO.rotation.coords;
    Ok(BenchmarkScenario {
        place,
        case: case.iter().map(|((table, name), value)| (format!("{table}.{name}"), value.clone())).collect(),
        set,
        q_start,
        goal_position_m: X_DO.translation.vector.into(),
        goal_rotation_xyzw: [c.x, c.y, c.z, c.w],
        least_time_s: least_time_s.filter(|_| scene.motion == SceneMotion::Still),
        X_DO,
    })
}

/// What is believed wrongly, as `--set` values: the run file's own numbers become those of the scene, and others take their place.
fn believed(
    task: &BenchmarkTask,
    case: &BenchmarkCase,
    world: &Config,
    random: &mut Random,
) -> Result<Vec<String>, String> {
    let mut set = Vec::new();
    let i = world.camera.model.full_intrinsics();
    let mut mount = None;
    let X = *world.camera.mount.pose();
    for (name, value) in task.drawn("believed", case, random) {
        let value = float(&value).unwrap_or_default();
        let mut differ = |key: &str, truth: f64, believed: f64| {
            set.push(format!("scene.{key}={truth:?}"));
            set.push(format!("{key}={believed:?}"));
        };
        match name.as_str() {
            "focal_times" => {
                differ("camera.lens.fx_px", i.fx_px, i.fx_px * value);
                differ("camera.lens.fy_px", i.fy_px, i.fy_px * value);
            }
            "centre_off_px" => {
                let (sin, cos) = random.between(0.0, TAU).sin_cos();
                differ("camera.lens.cx_px", i.cx_px, i.cx_px + value * cos);
                differ("camera.lens.cy_px", i.cy_px, i.cy_px + value * sin);
            }
            "size_times" => {
                let target = &world.effective.target;
                if !matches!(world.target, Target::FourDots(_)) {
                    return Err("believed.size_times is for target.kind = \"four_dots\"".into());
                }
                let sizes = [
                    ("target.side_m", target.side_m),
                    ("target.radius_m", target.radius_m),
                    ("target.radius_p1_m", target.radius_p1_m),
                    ("target.margin_m", target.margin_m),
                ];
                for (key, truth) in sizes {
                    differ(key, truth, truth * value);
                }
                // what is so much larger looks the same from so much farther away
                let [x, y, z] = world.effective.servo.desired.position_m.map(|p| p * value);
                set.push(format!("servo.desired.position_m=[{x:?}, {y:?}, {z:?}]"));
            }
            "mount_turn_deg" => {
                let turn = UnitQuaternion::from_scaled_axis(direction(random) * value.to_radians());
                mount.get_or_insert(X).rotation *= turn;
            }
            _ => mount.get_or_insert(X).translation.vector += direction(random) * value,
        }
    }
    if let Some(mount) = mount {
        for (begin, X) in [("scene.camera", X), ("camera", mount)] {
            let (p, r): ([f64; 3], _) =
                (X.translation.vector.into(), roll_pitch_yaw(&X.rotation.to_rotation_matrix()));
            set.push(format!("{begin}.mount.position_m={p:?}"));
            set.push(format!("{begin}.mount.rotation_rpy_rad={r:?}"));
        }
    }
    Ok(set)
}

/// A unit vector in any direction.
fn direction(random: &mut Random) -> Vector3<f64> {
    let v = Vector3::from_fn(|_, _| random.gaussian());
    v.try_normalize(1e-9).unwrap_or_else(Vector3::x)
}

/// The arm, as it is, before its goal.
struct StartSearch<'a, const N: usize> {
    task: &'a BenchmarkTask,
    case: &'a BenchmarkCase,
    config: &'a Config,
    scene: &'a Scene,
    robot: &'a Robot<N>,
    X_DO: Pose,
}

impl<const N: usize> StartSearch<'_, N> {
    /// The start, and the least time from there, s.
    fn start(&self, random: &mut Random) -> Result<(Vec<f64>, Option<f64>), String> {
        let search = PostureSearch { robot: self.robot, mount: &self.scene.mount };
        let limits = assemble::motion_limits(self.config, self.robot).map_err(|e| e.to_string())?;
        let of_file = assemble::q_start::<N>(self.config).map_err(|e| e.to_string())?;
        let X_WD = self.scene.X_WO * self.X_DO.inverse();
        let q_goal = self.goal(&search, &of_file, &X_WD)?;
        let q_start = if self.task.start.is_empty() {
            of_file
        } else {
            (0..DRAWS).find_map(|_| self.drawn(&search, &q_goal, random)).ok_or_else(|| {
                format!(
                    "none of {DRAWS} starts is in view and within reach: narrow the ranges of [tasks.start], or move scene.object"
                )
            })?
        };
        let q_start = q_start.map(|q| (q * 1e6).round() * 1e-6);
        // a joint error moves the arm as it believes, and the camera as it is
        let arrives = is_there(&search, &q_goal, &X_WD);
        let least = arrives.then(|| least_time_s(&search, &limits, &q_start, &q_goal, &X_WD));
        Ok((q_start.as_slice().to_vec(), least))
    }

    /// A posture at the goal with room for all joints.
    fn goal(
        &self,
        search: &PostureSearch<'_, N>,
        of_file: &SVector<f64, N>,
        X_WD: &Pose,
    ) -> Result<SVector<f64, N>, String> {
        let points: Vec<_> = self.scene.target.points().iter().map(|point| point.p_O).collect();
        let set_point = SetPoint::from_pose(&self.X_DO, &points).ok_or("the goal lies behind the camera")?;
        let i = self.scene.camera.intrinsics();
        let f_px = nalgebra::Vector2::new(i.fx_px, i.fy_px);
        let mut random = Random::new(1);
        for k in 0..=GOAL_SEARCHES {
            let from = if k == 0 { *of_file } else { search.anywhere(&mut random) };
            for q in search.postures_from(&from, (&self.scene.X_WO, X_WD), &set_point) {
                let X_CO = search.X_WC(&q).inv_mul(&self.scene.X_WO);
                // chosen by hand: a hundredth of what counts as there
                let near = set_point.error_rms_px_at(&X_CO, &f_px) <= 0.01 * self.task.tolerance_px;
                if near && self.room(&q) > ROOM_OF_JOINTS {
                    return Ok(q);
                }
            }
        }
        Err("the arm cannot reach the goal: move scene.object or servo.desired".into())
    }

    fn room(&self, q: &SVector<f64, N>) -> f64 {
        nearest_limit(&self.scene.arm, q.as_slice()).map_or(f64::INFINITY, |(_, room)| room)
    }

    /// One draw; `None` where it is out of view or reach.
    fn drawn(
        &self,
        search: &PostureSearch<'_, N>,
        q_goal: &SVector<f64, N>,
        random: &mut Random,
    ) -> Option<SVector<f64, N>> {
        let values = self.task.drawn("start", self.case, random);
        let of = |name: &str| values.get(name).and_then(float);
        let mut side = || {
            let (sin, cos) = random.between(0.0, TAU).sin_cos();
            Vector3::new(cos, sin, 0.0)
        };
        let (tilt_axis, aside) = (side(), side());
        let roll = Vector3::z() * of("roll_deg").unwrap_or(0.0).to_radians();
        let tilt = tilt_axis * of("tilt_deg").unwrap_or(0.0).to_radians();
        let offset = aside * of("aside_m").unwrap_or(0.0) + Vector3::z() * of("ahead_m").unwrap_or(0.0);
        let plate = self.scene.target.plate();
        let middle_O = (plate.low_m + plate.high_m) * 0.5;
        let middle = (self.X_DO * nalgebra::Point3::new(middle_O.x, middle_O.y, 0.0)).coords;
        let turn = UnitQuaternion::from_scaled_axis(roll) * UnitQuaternion::from_scaled_axis(tilt);
        let turned = Pose::from_parts((middle + offset).into(), turn)
            * Pose::from_parts((-middle).into(), UnitQuaternion::identity());
        let X_WS = self.scene.X_WO * (turned * self.X_DO).inverse();
        let q = search.towards(q_goal, &X_WS);
        let near_an_end = of("near_limit_rad_or_m").is_none_or(|near| self.room(&q) <= near);
        if !is_there(search, &q, &X_WS) || !(self.room(&q) > ROOM_OF_JOINTS) || !near_an_end {
            return None;
        }
        let X_CO = search.X_WC(&q).inv_mul(&self.scene.X_WO);
        let seen = Visibility::of(&self.scene.target, &self.scene.camera, &X_CO);
        let whole = seen.front && seen.whole == seen.points.len() && seen.room_px >= ROOM_PX;
        (whole && DISTANCE_M.contains(&X_CO.translation.z)).then_some(q)
    }
}
