//! The tasks of a run beside servoing, in which the arm follows a plan: the plan is made here and sent to control.

use super::LookAndMove;
use crate::calibration::hand_eye::{TourCell, TourError, TourPlanner};
use crate::calibration::image_reach;
use crate::calibration::load::{LoadTour, LoadTourCell};
use crate::camera_model::CameraModel;
use crate::control::order::ControlOrder;
use crate::control::outcome::{Finish, Outcome};
use crate::control::trace::Event;
use crate::messages::{Measurement, TargetStatus};
use crate::motion::{ExcitationMotion, MotionLimits, Workspace};
use crate::robot::{Mount, Robot};
use crate::time::SpanNs;
use nalgebra::{Point3, SVector};

const EXCITATION_OVER: Finish =
    Finish { outcome: Outcome::Finished, reason: "the calibration motion is over" };
/// What is lost of the motion would be missing in what is found.
const TARGET_LOST: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "the target was lost while the arm moved: start with the target near the middle of the picture, and see to \
             its light",
};
// The motion takes 8 s (`motion/excitation_motion.rs`); start and rest need some seconds more, and 15 leaves room.
const EXCITATION_TOO_SHORT: &str =
    "run.duration_s is over before the calibration motion was: raise it to 15 or more";

const TOUR_OVER: Finish =
    Finish { outcome: Outcome::Finished, reason: "all views of the board have been visited" };
const TOO_FEW: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "too few views of the board are within reach: start with the board in the middle of the picture and small in it, and \
             with the joints away from the ends of their ranges",
};
const ONE_AXIS: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "this arm turns the camera about one axis only: the camera's position along it cannot show",
};
const NOTHING_SEEN: &str =
    "the board was not seen where the arm starts: bring it into the picture, and check [target]";
const LOAD_TOUR_OVER: Finish =
    Finish { outcome: Outcome::Finished, reason: "all postures of the load calibration have been visited" };
const NO_ROOM: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "too few postures about the start are within reach: start with the joints away from the ends of their ranges, and away from the \
             limits of [workspace]",
};
const TOUR_TOO_SHORT: &str = "run.duration_s is over before all postures were visited";

/// The nominal cell, in which motions are planned.
#[derive(Debug, Clone)]
pub struct BelievedCell<const N: usize> {
    /// The arm.
    pub robot: Robot<N>,
    /// Limits of its motion.
    pub limits: MotionLimits<N>,
    /// The nominal mount of its camera.
    pub mount: Mount,
    /// The lens.
    pub camera: CameraModel,
    /// The target's points in O, m.
    pub points: Vec<Point3<f64>>,
}

/// The task of a run.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // one in a run
pub enum RunTask<const N: usize> {
    /// Visual servoing to the goal.
    Servo,
    /// One look, one motion, and another look, until the goal is held.
    LookAndMove(LookAndMove<N>),
    /// The excitation motion in view of the target, once the whole target is in view.
    Excitation {
        /// The cell.
        cell: BelievedCell<N>,
        /// The motion that is still to be sent.
        order: Option<ControlOrder<N>>,
        /// Whether it was planned.
        planned: bool,
    },
    /// A calibration tour of views of a board, once the board is in view.
    Tour {
        /// The cell.
        cell: BelievedCell<N>,
        /// The plan in the making.
        planner: Option<TourPlanner<N>>,
        /// The result: the number of postures, or why there are none.
        planned: Option<Result<usize, TourError>>,
    },
    /// Postures about the start, whose torques show what the flange carries.
    LoadTour {
        /// The cell.
        cell: BelievedCell<N>,
        /// Its limits in space.
        space: Option<Box<Workspace<N>>>,
        /// The plan in the making.
        planner: Option<LoadTour<N>>,
        /// The number of postures.
        planned: Option<usize>,
    },
}

impl<const N: usize> RunTask<N> {
    /// The excitation motion in `cell`.
    #[must_use]
    pub fn excitation(cell: BelievedCell<N>) -> Self {
        Self::Excitation { cell, order: None, planned: false }
    }

    /// A tour of `cell`.
    #[must_use]
    pub fn tour(cell: BelievedCell<N>) -> Self {
        Self::Tour { cell, planner: None, planned: None }
    }

    /// Postures about where `cell` stands, within `space`.
    #[must_use]
    pub fn load_tour(cell: BelievedCell<N>, space: Option<Workspace<N>>) -> Self {
        Self::LoadTour { cell, space: space.map(Box::new), planner: None, planned: None }
    }

    /// Takes in where the arm is, rad or m, once it is `at_rest`.
    pub(super) fn note_rest(&mut self, q: &SVector<f64, N>, at_rest: bool) {
        if let Self::LoadTour { cell, space, planner, planned: None } = self
            && at_rest
            && planner.is_none()
        {
            let cell = LoadTourCell { robot: &cell.robot, limits: &cell.limits, space: space.as_deref() };
            *planner = Some(LoadTour::new(q, &cell));
        }
    }

    /// Takes in a measurement; the arm is in `q`, rad or m.
    pub(super) fn note(&mut self, m: &Measurement, q: &SVector<f64, N>) {
        match self {
            Self::Servo | Self::LookAndMove(_) | Self::LoadTour { .. } => {}
            Self::Excitation { cell, order, planned } => {
                if !*planned && m.found() && m.features().len() == cell.points.len() {
                    let BelievedCell { robot, limits, mount, camera, points } = cell;
                    let reach = image_reach(robot, mount, camera, points, limits, q, m);
                    *order =
                        reach.map(|reach| ControlOrder::Excite(ExcitationMotion::new(q, &reach, limits)));
                    *planned = order.is_some();
                }
            }
            Self::Tour { planner, planned, .. } => {
                if planned.is_none() && planner.is_none() && m.found() {
                    *planner = m.pose().map(|X_CO| TourPlanner::new(q, &X_CO));
                }
            }
        }
    }

    /// Plans one view of a tour, or tries one start of a search for a posture, a tick, so that the thread can carry messages in between; returns the next order to control.
    pub(super) fn next_orders(&mut self) -> impl Iterator<Item = ControlOrder<N>> + use<N> {
        let (mut one, mut all) = (None, None);
        match self {
            Self::Servo | Self::LoadTour { .. } => {}
            Self::LookAndMove(task) => one = task.next_waypoint().map(ControlOrder::Waypoint),
            Self::Excitation { order, .. } => one = order.take(),
            Self::Tour { cell, planner, planned } => {
                let BelievedCell { robot, limits, mount, camera, points } = cell;
                let cell = TourCell { robot, mount, camera, points, limits };
                if let Some(plan) = planner.as_mut().and_then(|planner| planner.next_view(&cell)) {
                    *planned = Some(plan.as_ref().map(Vec::len).map_err(|why| *why));
                    (*planner, all) = (None, plan.ok());
                }
            }
        }
        if let Self::LoadTour { cell, space, planner, planned } = self {
            let cell = LoadTourCell { robot: &cell.robot, limits: &cell.limits, space: space.as_deref() };
            if let Some(postures) = planner.as_mut().and_then(|planner| planner.next_posture(&cell)) {
                (*planner, *planned) = (None, Some(postures.len()));
                all = Some(postures);
            }
        }
        one.into_iter().chain(all.into_iter().flatten().map(ControlOrder::Waypoint))
    }

    /// Takes in an event; the end that it causes.
    pub(super) fn hear(&mut self, event: Event) -> Option<Finish> {
        match (self, event) {
            (Self::LookAndMove(task), Event::MotionOver) => {
                task.arrived();
                None
            }
            (Self::Excitation { .. }, Event::Holding) => Some(TARGET_LOST),
            (Self::Excitation { .. }, Event::MotionOver) => Some(EXCITATION_OVER),
            (Self::Tour { .. }, Event::MotionOver) => Some(TOUR_OVER),
            (Self::LoadTour { .. }, Event::MotionOver) => Some(LOAD_TOUR_OVER),
            _ => None,
        }
    }

    /// The end where there is no plan.
    pub(super) fn refused(&self) -> Option<Finish> {
        match self {
            Self::LookAndMove(task) => task.refused(),
            Self::Tour { planned: Some(Err(TourError::TooFewViews)), .. } => Some(TOO_FEW),
            Self::Tour { planned: Some(Err(TourError::OneAxis)), .. } => Some(ONE_AXIS),
            Self::LoadTour { planned: Some(0), .. } => Some(NO_ROOM),
            _ => None,
        }
    }

    /// Why the time of the run was too short, where the task knows; by the age and the status of the `last` measurement. One that is older than `timeout` is out of date.
    pub(super) fn when_late(
        &self,
        last: Option<(SpanNs, TargetStatus)>,
        timeout: SpanNs,
    ) -> Option<&'static str> {
        match self {
            Self::Excitation { planned: true, .. } => Some(EXCITATION_TOO_SHORT),
            Self::LoadTour { planned: Some(_), .. } => Some(TOUR_TOO_SHORT),
            Self::Servo | Self::Excitation { .. } | Self::LoadTour { .. } => None,
            Self::LookAndMove(task) => task.when_late(last, timeout),
            Self::Tour { planned: Some(_), .. } => Some(TOUR_TOO_SHORT),
            Self::Tour { planned: None, .. } => Some(NOTHING_SEEN),
        }
    }
}
