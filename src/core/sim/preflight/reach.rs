//! Whether the arm can bring the camera to the goal, and what lies on the straight path there: ends of ranges and singular postures.

use crate::config::{Config, Task};
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::robot::{Mount, Robot};
use crate::servo::{PostureSearch, SetPoint, nearest_limit};
use nalgebra::{SVector, Vector2};
use serde::Serialize;

/// Random postures from which the inverse kinematics is restarted. Chosen by hand: if one
/// start in ten finds one, 60 fail together in 0.2 % of the cases (0.9^60).
const STARTS: usize = 60;
/// Steps of the straight path. Chosen by hand: about a centimetre each for a path of half a metre.
const WAY_STEPS: u32 = 60;
/// An arm that is farther from the path than this has left it, m and rad. Chosen by hand: above what the inverse kinematics leaves at a posture
/// within reach, and below what a user sees; it only leads to a remark.
const BESIDE: f64 = 2e-3;
/// A posture counts as nearly singular when its dexterity is below this share of that at both ends of the path, or below this number. Chosen
/// by hand; it only leads to a remark, and the arm is slowed down there anyway.
const SINGULAR_SHARE: f64 = 0.25;
const SINGULAR: f64 = 0.02;
/// Weight of a radian in metres where the nearest of several poses is chosen. Chosen by hand: a point 0.3 m away moves by as much.
const M_PER_RAD: f64 = 0.3;

/// Whether the goal is within reach.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Reach {
    /// It does not say, or nothing asks for it.
    Unasked {
        /// Why.
        why: &'static str,
    },
    /// Some posture shows what the goal asks for.
    Within(Posture),
    /// No posture does, by all that was tried.
    Beyond {
        /// The one that comes nearest.
        nearest: Posture,
        /// How far its camera is from the wanted place, m.
        off_m: f64,
        /// How far its camera is turned against the wanted orientation, rad.
        off_rad: f64,
        /// Joints at an end of their ranges there: name, and `upper` or `lower`.
        at_limits: Vec<(String, &'static str)>,
    },
}

/// A posture at the goal, or as near to it as can be.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Posture {
    /// Joint positions, rad or m.
    pub q: Vec<f64>,
    /// Root mean square feature error there, px.
    pub error_px: f64,
    /// The joint nearest to an end of its range, and how far it is from it, rad or m; `None` where no joint has ends.
    pub nearest_limit: Option<(String, f64)>,
}

/// The straight way of the camera from the start to the goal, relative to the object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraPath {
    /// How far the arm is from a singular posture at the start, at the goal and where it is nearest to one: the measure of the least
    /// singular value of the camera's Jacobian, m and rad mixed.
    pub dexterity: [f64; 3],
    /// Where on the way that is, 0 to 1.
    pub nearest_at: f64,
    /// Whether that is near a singular posture.
    pub singular: bool,
    /// Joints that meet an end of their range on the way: name, and `upper` or `lower`.
    pub limits: Vec<(String, &'static str)>,
    /// Where on the way, 0 to 1, the arm can follow it no farther in one motion; `None`: it follows to the goal.
    pub leaves_at: Option<f64>,
    /// The camera relative to the object on the way: what it sees.
    #[serde(skip)]
    pub X_CO: Vec<Pose>,
    /// The joints on the way, rad or m.
    #[serde(skip)]
    pub postures: Vec<Vec<f64>>,
}

/// Why nobody asks whether the goal is within reach; `None` where it is asked.
pub(super) fn unasked(config: &Config) -> Option<&'static str> {
    if config.task != Task::Servo {
        Some("a calibration finds its postures by itself")
    } else if !config.closes_the_loop() {
        Some("no arm moves in this run")
    } else if config.goal.is_taught {
        Some("the goal is what the camera sees at the start")
    } else if config.servo.estimation.is_some() {
        Some("the image Jacobian is learnt: which posture shows the goal is not known")
    } else if config.scene.is_none() {
        Some("where the object lies is known when the camera sees it")
    } else {
        None
    }
}

/// The cell as it truly is to a goal that is an image: where the camera gets that sees it so is a matter of lens, mount and target, and not of what the run file
/// believes of them. `None` of a goal that is a pose, and without a scene.
pub(super) fn in_truth(config: &Config) -> Option<Config> {
    let scene = config.scene.as_ref().filter(|_| config.stereo.is_none())?;
    let points: Vec<_> = scene.target.features().map(|point| point.p_O).collect();
    let set_point = config.set_point.in_truth(&config.camera.model, &scene.camera, &points)?;
    let mut truth = Config { set_point, target: scene.target.clone(), ..config.clone() };
    (truth.camera.model, truth.camera.mount) = (scene.camera, scene.mount);
    Some(truth)
}

/// What is asked: the arm, the camera on it, and the goal.
pub(super) struct ReachProblem<'a, const N: usize> {
    pub(super) config: &'a Config,
    pub(super) robot: &'a Robot<N>,
    pub(super) q_start: SVector<f64, N>,
    pub(super) set_point: &'a SetPoint,
    pub(super) X_WO: Pose,
    pub(super) X_DO: Pose,
}

impl<const N: usize> ReachProblem<'_, N> {
    fn mount(&self) -> &Mount {
        &self.config.camera.mount
    }

    pub(super) fn search(&self) -> PostureSearch<'_, N> {
        PostureSearch { robot: self.robot, mount: self.mount() }
    }

    fn error_px(&self, q: &SVector<f64, N>) -> f64 {
        let i = self.config.camera.model.intrinsics();
        let X_CO = self.search().X_WC(q).inv_mul(&self.X_WO);
        self.set_point.error_rms_px_at(&X_CO, &Vector2::new(i.fx_px, i.fy_px))
    }

    /// Whether a posture shows the goal, the first from the start that does; or the one that comes nearest.
    pub(super) fn reach(&self) -> (Reach, Option<SVector<f64, N>>) {
        let search = self.search();
        let X_WD = self.X_WO * self.X_DO.inverse();
        let mut random = Random::new(1);
        let mut nearest: Option<(f64, SVector<f64, N>)> = None;
        for start in 0..=STARTS {
            let from = if start == 0 { self.q_start } else { self.resting(search.anywhere(&mut random)) };
            for q in search.postures_from(&from, (&self.X_WO, &X_WD), self.set_point) {
                if self.error_px(&q) <= self.config.goal.feature_error_px {
                    return (Reach::Within(self.posture(&q)), Some(q));
                }
                let off = search.X_WC(&q).inv_mul(&X_WD);
                let far = off.translation.vector.norm() + M_PER_RAD * off.rotation.angle();
                if nearest.is_none_or(|(least, _)| far < least) {
                    nearest = Some((far, q));
                }
            }
        }
        let q = nearest.map_or(self.q_start, |(_, q)| q);
        let off = search.X_WC(&q).inv_mul(&X_WD);
        let beyond = Reach::Beyond {
            nearest: self.posture(&q),
            off_m: off.translation.vector.norm(),
            off_rad: off.rotation.angle(),
            at_limits: search.at_limits(&q).map(|(i, upper)| self.end(i, upper)).collect(),
        };
        (beyond, None)
    }

    /// `q` with the joints that do not move the camera where they are at the start.
    fn resting(&self, q: SVector<f64, N>) -> SVector<f64, N> {
        let moving = self.mount().moving_joints(N);
        SVector::from_fn(|i, _| if i < moving { q[i] } else { self.q_start[i] })
    }

    fn posture(&self, q: &SVector<f64, N>) -> Posture {
        let nearest = nearest_limit(&self.config.robot, q.as_slice());
        Posture {
            q: q.as_slice().to_vec(),
            error_px: self.error_px(q),
            nearest_limit: nearest.map(|(i, room)| (self.name(i), room)),
        }
    }

    pub(super) fn name(&self, joint: usize) -> String {
        self.robot.joint_names().get(joint).cloned().unwrap_or_default()
    }

    fn end(&self, joint: usize, upper: bool) -> (String, &'static str) {
        (self.name(joint), if upper { "upper" } else { "lower" })
    }

    /// The straight way from the start, followed to the goal in one motion.
    pub(super) fn way(&self) -> CameraPath {
        let search = self.search();
        let (X_WS, X_WD) = (search.X_WC(&self.q_start), self.X_WO * self.X_DO.inverse());
        let mut q = self.q_start;
        let mut limits: Vec<(String, &'static str)> = Vec::new();
        let start = search.dexterity(&q);
        let (mut least, mut nearest_at, mut leaves_at) = (start, 0.0, None);
        let mut X_CO = vec![X_WS.inv_mul(&self.X_WO)];
        let mut postures = vec![q.as_slice().to_vec()];
        for k in 1..=WAY_STEPS {
            let share = f64::from(k) / f64::from(WAY_STEPS);
            let wanted = between(&X_WS, &X_WD, share);
            q = search.towards_within(&q, &wanted, 30);
            X_CO.push(wanted.inv_mul(&self.X_WO));
            postures.push(q.as_slice().to_vec());
            let dexterity = search.dexterity(&q);
            if dexterity < least {
                (least, nearest_at) = (dexterity, share);
            }
            for (i, upper) in search.at_limits(&q) {
                let end = self.end(i, upper);
                if !limits.contains(&end) {
                    limits.push(end);
                }
            }
            let off = search.X_WC(&q).inv_mul(&wanted);
            let beside = off.translation.vector.norm().max(off.rotation.angle()) > BESIDE;
            // an arm of few joints has a way of its own, and must only arrive
            if beside && leaves_at.is_none() && (self.mount().moving_joints(N) >= 6 || k == WAY_STEPS) {
                leaves_at = Some(share);
            }
        }
        if leaves_at == Some(1.0) && self.arrives(&q) {
            leaves_at = None;
        }
        let goal = search.dexterity(&q);
        let singular = least < SINGULAR.min(start).min(goal) || least < SINGULAR_SHARE * start.min(goal);
        CameraPath {
            dexterity: [start, goal, least],
            nearest_at,
            singular,
            limits,
            leaves_at,
            X_CO,
            postures,
        }
    }

    /// Whether the features are where they should be near `q`.
    fn arrives(&self, q: &SVector<f64, N>) -> bool {
        let q = self.search().features_from(q, &self.X_WO, self.set_point);
        self.error_px(&q) <= self.config.goal.feature_error_px
    }
}

/// On the straight way from `from` to `to`: the share of the path, and of the turn.
fn between(from: &Pose, to: &Pose, share: f64) -> Pose {
    let p = from.translation.vector.lerp(&to.translation.vector, share);
    let turn = from.rotation.rotation_to(&to.rotation).scaled_axis() * share;
    let rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * from.rotation;
    Pose::from_parts(p.into(), rotation)
}
