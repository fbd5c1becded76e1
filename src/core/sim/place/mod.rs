//! Proposes where an object may lie before an arm, from where a run may start, and how the object is to look in the end.
//!
//! ```text
//! postures anywhere ─► camera turned as requested ─► away from limits and singular postures, room for the object ─► the best few
//!        each: object before the camera (X_WO = X_WC X_DO) ─► a start beside it ─► Preflight without doubt ─► a run that converges
//! ```
//! The object is put where the camera looks, and not the camera where the object is: so that arms of few joints get a goal too. Of
//! obstacles, and of whether the arm meets itself, only what `[workspace]` says is known.

mod stand;
mod start;

use crate::config::{Config, ConfigError, Draft};
use crate::control::outcome::Outcome;
use crate::geometry::{Pose, roll_pitch_yaw};
use crate::motion::Workspace;
use crate::robot::{Mount, RobotError};
use crate::scene::Visibility;
use crate::servo::PostureSearch;
use crate::sim::preflight::Preflight;
use crate::sim::system::{SimError, SystemRun, simulate_system};
use nalgebra::SVector;
use stand::Stand;
use std::ops::ControlFlow;
use thiserror::Error;

/// Number of the best places that are tried in a simulated run each. Chosen by hand: a run takes about a tenth of a second, so that
/// the search ends within a second or two.
const TRIED: usize = 8;
/// Margin around the marks at the goal, as a share of the image's shorter side. Chosen by hand: the target then takes about half of the
/// image, and a start beside it keeps it in view.
const FREE_SHARE: f64 = 0.24;
/// Resolution of the proposed numbers, 1/m and 1/rad. Chosen by hand: a micrometre is far below what a place can be measured to.
const DECIMALS: f64 = 1e6;

/// Where the camera is to look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Along gravity, at something on a table.
    Down,
    /// Level, at something on a wall.
    Level,
    /// Against gravity.
    Up,
    /// As suits the arm.
    Any,
}

/// What is requested of a proposal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceRequest {
    /// Where the camera is to look; `None`: down where the arm can, else as suits it.
    pub look: Option<Look>,
    /// Where the object lies in the frame in which it rests; `None`: where it suits. Without an orientation its z goes where the camera
    /// is to look.
    pub object: Option<(nalgebra::Vector3<f64>, Option<nalgebra::UnitQuaternion<f64>>)>,
    /// From the camera to the target's plane at the goal, m; `None`: so that the target fills a good part of the image.
    pub distance_m: Option<f64>,
}

/// A start and a goal between which a run converges.
#[derive(Debug, Clone)]
pub struct Placement {
    /// Joint positions at the start, rad or m.
    pub q_start: Vec<f64>,
    /// Joint positions at the goal, rad or m.
    pub q_goal: Vec<f64>,
    /// The object where it rests.
    pub X_WO: Pose,
    /// The object in the desired camera.
    pub X_DO: Pose,
    /// What a run has before it.
    pub preflight: Preflight,
    /// How the run ended that was simulated.
    pub run: SystemRun,
}

/// Why there is no proposal.
#[derive(Debug, Error)]
pub enum PlaceError {
    /// The run file is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The arm cannot be built.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// A run cannot be simulated.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// Nothing says what the camera would see.
    #[error(
        "camera.source: only `synthetic` can be tried before it is proposed; set it for this command, and take start and goal over"
    )]
    NoScene,
    /// No place suits.
    #[error(
        "no posture has the camera before such a place, away from limits and singular postures: {tried} postures were tried; \
         let it look elsewhere (--look any), leave out --object, or change --distance-m"
    )]
    Nowhere {
        /// How many postures.
        tried: usize,
    },
    /// There are such places, and the limits in space keep the arm from all of them.
    #[error(
        "[workspace] keeps the arm from each of the {found} postures that suit; at the best of them, {clearance}: look at its limits, or give --object, --look or --distance-m"
    )]
    Excluded {
        /// How many postures.
        found: usize,
        /// What is beyond which limit there.
        clearance: String,
    },
    /// From no place near a goal does a run converge.
    #[error("none of {tried} places gives a run that converges; the last one: {reason}")]
    NoRun {
        /// How many places.
        tried: usize,
        /// Why not.
        reason: String,
    },
    /// The target does not fit into the image from anywhere.
    #[error(
        "--distance-m: from {distance_m} m the target is not in the image as a whole; it is {size_m:.3} m large"
    )]
    Distance {
        /// How far.
        distance_m: f64,
        /// The plate's diagonal, m.
        size_m: f64,
    },
}

/// Proposes start and goal for the run of `draft`.
///
/// # Errors
/// [`PlaceError`].
pub fn place(draft: &Draft, request: &PlaceRequest) -> Result<Placement, PlaceError> {
    let robot = crate::robot::load(draft.robot_model())
        .map_err(|e| draft.error(vec![("robot.model", e.to_string())]))?;
    crate::dispatch_robot!(robot, |arm| Search::new(draft, &robot, arm).and_then(|s| s.run(request)))?
}

/// An arm that looks for a place.
struct Search<'a, const N: usize> {
    draft: &'a Draft,
    arm: crate::robot::Robot<N>,
    /// Camera, target and settings; start and goal of it are stand-ins.
    config: Config,
    /// Its limits in space, where there are some.
    space: Option<Workspace<N>>,
    /// Where gravity goes in B, of length 1; z down where there is none.
    down: nalgebra::Vector3<f64>,
}

impl<'a, const N: usize> Search<'a, N> {
    fn new(
        draft: &'a Draft,
        robot: &crate::robot::RobotDescription,
        arm: crate::robot::Robot<N>,
    ) -> Result<Self, PlaceError> {
        // Any posture, with the target before the camera: the rest of the file is then judged as it is.
        let middle = |joint: &crate::robot::JointDescription| {
            let (low, high) = (joint.limits.lower, joint.limits.upper);
            if low.is_finite() && high.is_finite() { 0.5 * (low + high) } else { 0.0 }
        };
        let q: Vec<f64> = robot.joints.iter().map(middle).collect();
        let X_WC = draft.mount(robot).X_WC(&arm, &SVector::from_column_slice(&q));
        let far = Pose::translation(0.0, 0.0, 10.0);
        let stand_in = draft.clone().simulated().placed(&q, &(X_WC * far), &far);
        // Where the arm may be is asked of what is proposed.
        let config = stand_in.validate_whatever_is_seen()?;
        if config.scene.is_none() {
            return Err(PlaceError::NoScene);
        }
        let g = robot.gravity_B;
        let down = if g.norm() > 0.0 { g.normalize() } else { -nalgebra::Vector3::z() };
        let space = config.workspace.clone().map(|space| Workspace::new(arm.clone(), space));
        Ok(Self { draft, arm, config, space, down })
    }

    fn mount(&self) -> &Mount {
        &self.config.camera.mount
    }

    fn posture(&self) -> PostureSearch<'_, N> {
        PostureSearch { robot: &self.arm, mount: self.mount() }
    }

    fn run(&self, request: &PlaceRequest) -> Result<Placement, PlaceError> {
        let X_DO = self.desired(request)?;
        let stands = self.stands(request, &X_DO);
        if stands.is_empty() {
            return Err(self
                .excluded(request, &X_DO)
                .unwrap_or(PlaceError::Nowhere { tried: stand::POSTURES }));
        }
        let mut reason = "there is no start beside it from which the whole target is seen".to_string();
        let tried = stands.len().min(TRIED);
        for stand in stands.iter().take(TRIED) {
            for q_start in self.starts(stand) {
                match self.tried(&q_start, stand)? {
                    Ok(placement) => return Ok(placement),
                    Err(why) => reason = why,
                }
            }
        }
        Err(PlaceError::NoRun { tried, reason })
    }

    /// That nothing but limits in space is in the way, where that is so.
    fn excluded(&self, request: &PlaceRequest, X_DO: &Pose) -> Option<PlaceError> {
        let space = self.space.as_ref()?;
        let (arm, config) = (self.arm.clone(), self.config.clone());
        let stands = Self { arm, config, space: None, ..*self }.stands(request, X_DO);
        let clearance = space.nearest(&stands.first()?.q)?.describe();
        Some(PlaceError::Excluded { found: stands.len(), clearance })
    }

    /// The target in its middle and square to the camera, as large in the image as is good.
    fn desired(&self, request: &PlaceRequest) -> Result<Pose, PlaceError> {
        let plate = self.config.target.plate();
        let middle = (plate.low_m + plate.high_m) * 0.5;
        let size_m = (plate.high_m - plate.low_m).norm();
        let at = |z: f64| Pose::translation(-middle.x, -middle.y, z);
        let camera = &self.config.camera.model;
        let room_px = |z: f64| {
            let visibility = Visibility::of(&self.config.target, camera, &at(z));
            if visibility.is_whole() { visibility.room_px } else { f64::NEG_INFINITY }
        };
        if let Some(distance_m) = request.distance_m {
            if room_px(distance_m) > 0.0 {
                return Ok(at(distance_m));
            }
            return Err(PlaceError::Distance { distance_m, size_m });
        }
        let i = camera.intrinsics();
        let free_px = FREE_SHARE * f64::from(i.width_px.min(i.height_px));
        let distances = (0..200).map(|k| 0.2 * size_m * 1.03f64.powi(k));
        let fits = distances.filter(|z| room_px(*z) >= free_px).min_by(f64::total_cmp);
        let distance_m = (fits.unwrap_or(4.0 * size_m) * 1e3).ceil() * 1e-3;
        Ok(at(distance_m))
    }

    /// A run from `q_start` to the goal of `stand`: the placement, or why it is none.
    fn tried(
        &self,
        q_start: &SVector<f64, N>,
        stand: &Stand<N>,
    ) -> Result<Result<Placement, String>, PlaceError> {
        let q_start: Vec<f64> = q_start.iter().map(|q| rounded(*q)).collect();
        let (X_WO, X_DO) = (rounded_pose(&stand.X_WO), rounded_pose(&stand.X_DO));
        let config = match self.draft.clone().simulated().placed(&q_start, &X_WO, &X_DO).validate() {
            Ok(config) => config,
            Err(e) => return Ok(Err(e.to_string())),
        };
        let preflight = Preflight::of(&config)?;
        if let Some((_, why)) = preflight.faults().into_iter().chain(preflight.doubts()).next() {
            return Ok(Err(why));
        }
        let run = simulate_system(&config, &mut |_| ControlFlow::Continue(()))?;
        if run.finish.outcome != Outcome::Converged {
            return Ok(Err(run.finish.reason.to_string()));
        }
        if run.target_lost > 0 {
            return Ok(Err("the target is lost on the way".into()));
        }
        let q_goal = stand.q.as_slice().to_vec();
        Ok(Ok(Placement { q_start, q_goal, X_WO, X_DO, preflight, run }))
    }
}

fn rounded(value: f64) -> f64 {
    (value * DECIMALS).round() / DECIMALS + 0.0
}

/// The pose that the rounded numbers of a file give.
fn rounded_pose(X: &Pose) -> Pose {
    let [roll, pitch, yaw] = roll_pitch_yaw(&X.rotation.to_rotation_matrix()).map(rounded);
    let p = X.translation.vector.map(rounded);
    Pose::from_parts(p.into(), nalgebra::UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}

#[cfg(test)]
mod tests;
