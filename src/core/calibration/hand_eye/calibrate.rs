//! The whole way from corners to a camera pose that says how good it is.

use super::board_pose::{CORNER_LOSS, board_pose, model_sd_px};
use super::dual_quaternion::dual_quaternion_solution;
use super::joint::{JointFit, JointSettings, RobotSd, refine_jointly};
use super::known_board::{BoardAsSeen, by_known_board, scatter_about};
use super::leave_one_out::leave_one_out;
use super::observability::{RotationSpread, rotation_spread};
use super::report::{HandEyeReport, ViewResidual};
use super::scatter::{ClosedFormCamera, loop_scatter};
use super::separate::separate_solution;
use super::settled::{is_settled, view_speed_px_s};
use super::{CameraMount, HandEyeError, HandEyeView, LoopSample, MAX_VIEWS, MIN_VIEWS};
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::pose::Loss;

/// Most rounds in which the standard deviations of robot and corners are adjusted. Chosen by hand: a bound; `SETTLED` ends them earlier.
const ROUNDS: u32 = 12;
/// Standard deviations are raised where chi-square lies this many of its own standard deviations above its mean.
const SURE: f64 = 3.0;
/// A standard deviation that changes by less than this share has converged. Chosen by hand: it is itself known to some per cent only.
const SETTLED: f64 = 0.01;
/// The camera is said to be mounted in the other place (eye-in-hand or eye-to-hand) when the views fit that this many times better, and fit the
/// stated one worse than this, m. Chosen by hand: a wrong place misses by as much as the arm moves.
const OTHER_PLACE: f64 = 5.0;
const OTHER_PLACE_M: f64 = 2e-3;

/// What is known beside the views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandEyeSettings {
    /// Where the camera is.
    pub place: CameraMount,
    /// Deviations of the robot's poses; raised where the views contradict them.
    pub robot: RobotSd,
    /// Whether the time between the stamps of robot and camera is sought; without it views in motion are left out.
    pub time_offset: bool,
    /// The board in the frame in which it rests, where that is known: it is held there.
    pub X_WO: Option<Pose>,
}

impl HandEyeSettings {
    /// The usual ones.
    #[must_use]
    pub fn of(place: CameraMount) -> Self {
        Self { place, robot: RobotSd::default(), time_offset: false, X_WO: None }
    }
}

/// Where the camera sits, by all views that are fit to tell it.
///
/// # Errors
/// Every variant of [`HandEyeError`].
pub fn calibrate_hand_eye(
    views: &[HandEyeView],
    camera: &CameraModel,
    settings: &HandEyeSettings,
) -> Result<HandEyeReport, HandEyeError> {
    if views.len() > MAX_VIEWS {
        return Err(HandEyeError::TooManyViews { given: views.len() });
    }
    for view in views {
        view.check()?;
    }
    if settings.time_offset && views.iter().all(|view| view.V_BE_E.is_none()) {
        return Err(HandEyeError::Setting {
            what: "the velocity of at least one view, where the time offset is sought,",
        });
    }
    let mut residuals = Vec::with_capacity(views.len());
    let (mut used, mut boards, mut chi_square) = (Vec::new(), Vec::new(), 0.0);
    for view in views {
        let (X_CO, squares) = board_pose(view, camera, None, Loss::Squares)?;
        let speed_px_s = view_speed_px_s(view, camera, &X_CO);
        let moving = speed_px_s.filter(|speed| !settings.time_offset && !is_settled(*speed));
        residuals.push(ViewResidual::new(view, speed_px_s, moving));
        if moving.is_none() {
            used.push(view.clone());
            boards.push(X_CO);
            chi_square += squares;
        }
    }
    let fewest = if settings.X_WO.is_some() { 1 } else { MIN_VIEWS };
    if used.len() < fewest {
        return Err(HandEyeError::TooFewViews { given: used.len(), needed: fewest });
    }
    if settings.X_WO.iter().any(|X| !X.to_homogeneous().iter().all(|x| x.is_finite())) {
        return Err(HandEyeError::NotFinite { view: "all".into(), what: "the board's pose" });
    }
    let model_sd_px = model_sd_px(&used, chi_square);
    let mut samples = Vec::with_capacity(used.len());
    for (view, near) in used.iter_mut().zip(&boards) {
        for corner in &mut view.corners {
            corner.sd_px = corner.sd_px.hypot(model_sd_px);
        }
        let (X_CO, _) = board_pose(view, camera, Some(near), CORNER_LOSS)?;
        samples.push(LoopSample { X_WM: settings.place.X_WM(&view.X_BE), X_CO });
    }
    let spread = rotation_spread(&samples);
    let closed = match &settings.X_WO {
        None => {
            spread.as_ref().ok_or(HandEyeError::NoStart)?.check(settings.place)?;
            Some(closed_forms(settings.place, &samples)?)
        }
        Some(_) => enough_by_themselves(settings.place, &samples, spread.as_ref()),
    };
    let stated = JointSettings {
        place: settings.place,
        robot: settings.robot,
        loss: CORNER_LOSS,
        time_offset: settings.time_offset,
        known_board: settings.X_WO.is_some(),
    };
    let mut joint = stated;
    let mut forms: Vec<_> = closed.iter().flatten().copied().collect();
    let (fit, board_as_seen) = match (&settings.X_WO, &closed) {
        (None, Some([separate, _])) => {
            (fitted(&used, camera, &mut joint, &separate.X_MC, &separate.scatter.X_WO)?, None)
        }
        (None, None) => return Err(HandEyeError::NoStart),
        (Some(X_WO), _) => {
            let start = by_known_board(&samples, X_WO).ok_or(HandEyeError::NoStart)?;
            forms.insert(0, start);
            let fit = fitted(&used, camera, &mut joint, &start.X_MC, X_WO)?;
            // What the views make of the board by themselves; where they make nothing of it, they do not contradict it.
            let mut free = JointSettings { known_board: false, ..stated };
            let seen = closed.and_then(|[separate, _]| {
                let by_views =
                    fitted(&used, camera, &mut free, &separate.X_MC, &separate.scatter.X_WO).ok()?;
                BoardAsSeen::of(X_WO, &by_views, free.robot)
            });
            (fit, seen)
        }
    };
    let views: Vec<_> = used.iter().collect();
    let held_out = leave_one_out(&views, &samples, camera, &joint, &fit);
    let scatter = match &settings.X_WO {
        Some(X_WO) => Some(scatter_about(&samples, &fit.X_MC, X_WO)),
        None => loop_scatter(&samples, &fit.X_MC),
    };
    let mut report = HandEyeReport {
        place: settings.place,
        closed_forms: forms,
        scatter: scatter.ok_or(HandEyeError::NoStart)?,
        board_as_seen,
        known_board: stated.known_board,
        held_out,
        robot_stated: settings.robot,
        robot_seen: joint.robot,
        model_sd_px,
        spread,
        views: residuals,
        rms_px: 0.0,
        distance: super::report::at_distance(&fit, &views, &samples),
        fit,
        verdict: String::new(),
    };
    report.tell_residuals(&views, camera, &joint);
    report.verdict = super::verdict::verdict(&report);
    Ok(report)
}

/// The two closed forms without the board's pose.
fn closed_forms(place: CameraMount, samples: &[LoopSample]) -> Result<[ClosedFormCamera; 2], HandEyeError> {
    let separate = separate_solution(samples).ok_or(HandEyeError::NoStart)?;
    let dual = dual_quaternion_solution(samples, &separate.rotation).ok_or(HandEyeError::NoStart)?;
    let start = loop_scatter(samples, &separate).ok_or(HandEyeError::NoStart)?;
    other_place(place, samples, start.position_m)?;
    let scatter = loop_scatter(samples, &dual).unwrap_or(start);
    Ok([
        ClosedFormCamera { method: "rotation, then position", X_MC: separate, scatter: start },
        ClosedFormCamera { method: "dual quaternions", X_MC: dual, scatter },
    ])
}

/// The same where the board's pose is known, if the views would be enough without.
fn enough_by_themselves(
    place: CameraMount,
    samples: &[LoopSample],
    spread: Option<&RotationSpread>,
) -> Option<[ClosedFormCamera; 2]> {
    let is_enough = samples.len() >= MIN_VIEWS && spread.is_some_and(|spread| spread.check(place).is_ok());
    is_enough.then(|| closed_forms(place, samples).ok()).flatten()
}

/// The joint fit with deviations of the robot, in `joint`, that the views do not contradict.
fn fitted(
    views: &[HandEyeView],
    camera: &CameraModel,
    joint: &mut JointSettings,
    X_MC: &Pose,
    X_WO: &Pose,
) -> Result<JointFit, HandEyeError> {
    let all: Vec<_> = views.iter().collect();
    let stated = joint.robot;
    let (mut way, mut turn) = (Excess::default(), Excess::default());
    let mut start = (*X_MC, *X_WO);
    for round in 1.. {
        let fit = refine_jointly(&all, camera, joint, &start.0, &start.1)?;
        start = (fit.X_MC, fit.X_WO);
        let RobotSd { rotation_rad, translation_m } = joint.robot;
        let (mut way_squares, mut turn_squares) = (0.0, 0.0);
        for d in &fit.corrections {
            // an arm said to be exact has a deviation of 0, and would divide by it
            way_squares += d.fixed_rows::<3>(0).norm_squared() / translation_m.max(1e-12).powi(2);
            // as above: else a division by 0
            turn_squares += d.fixed_rows::<3>(3).norm_squared() / rotation_rad.max(1e-12).powi(2);
        }
        // the images tell each view's pose well: of 6 corrections a view 12 go into X_MC and X_WO, 6 of them where the board is known
        let freedom = 3.0 * all.len() as f64 - if joint.known_board { 3.0 } else { 6.0 };
        let changed = way.raise(way_squares, freedom).max(turn.raise(turn_squares, freedom));
        if changed < SETTLED || round == ROUNDS {
            return Ok(fit);
        }
        joint.robot = RobotSd {
            rotation_rad: stated.rotation_rad * turn.factor,
            translation_m: stated.translation_m * way.factor,
        };
    }
    Err(HandEyeError::NotConverged { iterations: ROUNDS })
}

/// What a stated deviation is multiplied by.
struct Excess {
    factor: f64,
}

impl Default for Excess {
    fn default() -> Self {
        Self { factor: 1.0 }
    }
}

impl Excess {
    /// Follows `chi_square` of `freedom` degrees of freedom, which is relative to the deviation as it is now, where it contradicts the one
    /// stated; by which share it changes.
    fn raise(&mut self, chi_square: f64, freedom: f64) -> f64 {
        let before = self.factor;
        let (freedom, mean) = (freedom.max(1.0), chi_square / freedom.max(1.0));
        if self.factor > 1.0 || mean > 1.0 + SURE * (2.0 / freedom).sqrt() {
            self.factor = (self.factor * mean.sqrt()).max(1.0);
        }
        (self.factor / before - 1.0).abs()
    }
}

/// Refuses views that are those of an eye of the other place.
fn other_place(place: CameraMount, samples: &[LoopSample], here_m: f64) -> Result<(), HandEyeError> {
    let inverted: Vec<_> =
        samples.iter().map(|s| LoopSample { X_WM: s.X_WM.inverse(), X_CO: s.X_CO }).collect();
    let there = separate_solution(&inverted).and_then(|X| loop_scatter(&inverted, &X));
    match there {
        Some(there) if here_m > OTHER_PLACE_M && here_m > OTHER_PLACE * there.position_m => {
            Err(HandEyeError::OtherPlace {
                here: place.words(),
                there: place.other().words(),
                here_mm: here_m * 1e3,
                there_mm: there.position_m * 1e3,
            })
        }
        _ => Ok(()),
    }
}
