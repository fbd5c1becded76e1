//! All corners of all views at once: least squares in pixels over the camera, the board, small corrections of the robot's poses
//! and the time between the stamps of robot and camera.
//!
//! ```text
//! sum rho(|px - camera(P_C)|^2 / sd^2)  +  sum (|t_i|^2 / sd_t^2 + |phi_i|^2 / sd_phi^2)
//! ```
//! `t_i`, `phi_i`: correction of the flange's pose in view i, expressed in E, with the standard deviations along each axis that the
//! robot's maker or a measurement states. Gauss-Newton with Levenberg's damping; each view's correction is eliminated from the
//! normal equations (Schur), so that time grows with the number of views and no more.

use super::rows::{
    ALL, ArmAt, BOARD, GLOBAL, HandEyeUnknowns, TIME, ViewRows, correction, moved, moved_inside,
};
use super::{CameraMount, HandEyeError, HandEyeView};
use crate::camera_model::CameraModel;
use crate::features::NormalEquations;
use crate::geometry::{Pose, Twist};
use crate::linalg::{Ldlt, damping};
use crate::pose::Loss;
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// So that a start from which nothing converges ends.
const MAX_ITERATIONS: u32 = 100;
/// Steps below this (m, rad, s) are the last. Chosen by hand: rounding in sums over all corners of all views allows no more digits.
const LAST_STEP: f64 = 1e-11;
/// The promised fall, relative to the loss by degree of freedom, that ends it. Derived: the promise over that is the square of the step in standard
/// deviations, so that the last step is less than a thousandth of one. Much less cannot be asked for: a corner at 1000 px is rounded by 1e-13 px, so that
/// the loss of corners that fit to 0.001 px is known to 1e-11 of it, and whether it falls is chance below that.
const LAST_GAIN: f64 = 1e-7;
/// A loss by degree of freedom that is none, what rounding leaves of exact data: residuals of 1e-5 standard deviations.
const NOTHING: f64 = 1e-10;
/// Chosen by hand, and a thousand times less than in other problems; what speaks for that is not known.
const FIRST_DAMPING: f64 = 1e-6;

/// How far the robot's poses may be off, one standard deviation along each axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotSd {
    /// Of the flange's rotation, rad.
    pub rotation_rad: f64,
    /// Of its position, m.
    pub translation_m: f64,
}

impl Default for RobotSd {
    /// What an industrial arm that nobody has calibrated is off within its workspace: 0.05 degrees and 0.3 mm.
    fn default() -> Self {
        Self { rotation_rad: 0.05_f64.to_radians(), translation_m: 0.3e-3 }
    }
}

/// How the views are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointSettings {
    /// Where the camera is.
    pub place: CameraMount,
    /// Deviations of the robot's poses; zeros: they are exact.
    pub robot: RobotSd,
    /// What the error of a corner counts.
    pub loss: Loss,
    /// Whether the time between the stamps is an unknown; needs views in motion with known twists.
    pub time_offset: bool,
    /// Whether the board's pose is known: it stays where the fit starts, and one view is enough.
    pub known_board: bool,
}

impl JointSettings {
    /// Squares of all errors, with nothing known of the board and nothing sought of the time.
    #[must_use]
    pub fn least_squares(place: CameraMount, robot: RobotSd) -> Self {
        Self { place, robot, loss: Loss::Squares, time_offset: false, known_board: false }
    }

    /// Whether this one of the global unknowns keeps its value.
    fn holds(&self, unknown: usize) -> bool {
        if unknown == TIME { !self.time_offset } else { unknown >= BOARD && self.known_board }
    }
}

/// The end of a refinement.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFit {
    /// The camera in the frame that bears it.
    pub X_MC: Pose,
    /// The board in the frame in which it rests.
    pub X_WO: Pose,
    /// What has to be added to the camera's stamps, s, as `camera.stamp_offset_ms` is; 0 where it was not asked for.
    pub offset_s: f64,
    /// Covariance of the error `[v; w]` of `X_MC` (m, rad), with the deviations as stated: the camera is at `p + v`, turned by
    /// `exp(w) R`, with `v` and `w` along the axes of M (the flange's in hand, the base's beside the arm). `v` is the change of
    /// the camera's own position, not the velocity at M's origin that a twist of a rigid body may mean.
    pub covariance_X_MC: Matrix6<f64>,
    /// The same of `X_WO`, along the axes of W; zero of a board whose pose is known.
    pub covariance_X_WO: Matrix6<f64>,
    /// Standard deviation of `offset_s`, s; `None` where it was not asked for.
    pub offset_sd_s: Option<f64>,
    /// Corrections of the flange's poses, `[t; phi]` in E, m and rad.
    pub corrections: Vec<Vector6<f64>>,
    /// The flange's poses with them.
    pub arm: Vec<Pose>,
    /// `sum |e|^2 / sd^2` of corners and of corrections, each without loss.
    pub chi_square: [f64; 2],
    /// Root mean square over all corners of the distance between corner and image, corrected poses, px.
    pub rms_px: f64,
    /// Steps taken.
    pub iterations: u32,
}

/// The best fit near the camera `X_MC` and the board `X_WO`.
///
/// # Errors
/// [`HandEyeError::Setting`], [`HandEyeError::NotFinite`], [`HandEyeError::Behind`] at the start, [`HandEyeError::Undetermined`],
/// [`HandEyeError::NotConverged`].
pub fn refine_jointly(
    views: &[&HandEyeView],
    camera: &CameraModel,
    settings: &JointSettings,
    X_MC: &Pose,
    X_WO: &Pose,
) -> Result<JointFit, HandEyeError> {
    check(views, settings)?;
    let problem = RefinementProblem { views, camera, settings };
    let arm = views.iter().map(|view| view.X_BE).collect();
    let mut state = HandEyeUnknowns { X_MC: *X_MC, X_WO: *X_WO, offset_s: 0.0, arm };
    let mut here = problem.sums(&state)?;
    let mut damping = 0.0;
    for iterations in 1..=MAX_ITERATIONS {
        let Some(step) = here.step(damping, settings) else {
            // without a rank where it begins there is none nearby
            return Err(here.undetermined(settings));
        };
        let candidate = state.after(&step);
        // A strongly damped step is short because of the damping, so that it does not show convergence.
        let last = damping < 1e-3 && here.is_last(&step);
        // one so long that the board comes behind the camera fails
        match problem.sums(&candidate) {
            Ok(next) if next.loss <= here.loss => {
                (state, here) = (candidate, next);
                damping = damping::eased(damping);
            }
            // at the minimum rounding alone decides whether the loss falls
            _ if last => {}
            _ => damping = damping::raised(damping, FIRST_DAMPING),
        }
        if last {
            return problem.end(&state, &here, iterations);
        }
    }
    Err(HandEyeError::NotConverged { iterations: MAX_ITERATIONS })
}

fn check(views: &[&HandEyeView], settings: &JointSettings) -> Result<(), HandEyeError> {
    let RobotSd { rotation_rad, translation_m } = settings.robot;
    for (what, value) in [
        ("the robot's rotation deviation", rotation_rad),
        ("the robot's translation deviation", translation_m),
    ] {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(HandEyeError::Setting { what });
        }
    }
    if !settings.loss.is_valid() {
        return Err(HandEyeError::Setting { what: "the loss" });
    }
    views.iter().try_for_each(|view| view.check())
}

type Global = SVector<f64, GLOBAL>;

/// What the views and settings are throughout.
struct RefinementProblem<'a> {
    views: &'a [&'a HandEyeView],
    camera: &'a CameraModel,
    settings: &'a JointSettings,
}

/// One view's part of the normal equations.
struct ViewSums {
    /// Between the global unknowns and the view's correction.
    mixed: SMatrix<f64, GLOBAL, 6>,
    own: Matrix6<f64>,
    right: Vector6<f64>,
}

struct JointEquations {
    matrix: SMatrix<f64, GLOBAL, GLOBAL>,
    right: Global,
    /// Empty where the robot's poses are exact.
    views: Vec<ViewSums>,
    loss: f64,
    chi_square: [f64; 2],
    squares_px2: f64,
    corners: usize,
}

struct RefinementStep {
    global: Global,
    views: Vec<Vector6<f64>>,
    /// Largest entry.
    size: f64,
    /// What the loss should fall by.
    gain: f64,
}

impl HandEyeUnknowns {
    fn after(&self, step: &RefinementStep) -> Self {
        let none = Vector6::zeros();
        let steps = step.views.iter().chain(std::iter::repeat(&none));
        Self {
            X_MC: moved(&self.X_MC, &step.global.fixed_rows::<6>(0).into_owned()),
            X_WO: moved(&self.X_WO, &step.global.fixed_rows::<6>(BOARD).into_owned()),
            offset_s: self.offset_s + step.global[TIME],
            arm: self.arm.iter().zip(steps).map(|(X_BE, d)| moved_inside(X_BE, d)).collect(),
        }
    }
}

impl RefinementProblem<'_> {
    fn arm_at(&self, view: &HandEyeView, X_BE: &Pose) -> ArmAt {
        let V_BE_E = view.V_BE_E.filter(|_| self.settings.time_offset).unwrap_or_else(Twist::zeros);
        ArmAt { place: self.settings.place, X_BE: *X_BE, V_BE_E }
    }

    fn sums(&self, state: &HandEyeUnknowns) -> Result<JointEquations, HandEyeError> {
        let RobotSd { rotation_rad, translation_m } = self.settings.robot;
        let exact = rotation_rad == 0.0 && translation_m == 0.0;
        // a deviation of one kind alone holds the other firmly, by a weight that still leaves digits: 0 would leave none
        let weight = |sd: f64| 1.0 / sd.max(1e-9).powi(2);
        let prior = Vector6::from_fn(|i, _| weight(if i < 3 { translation_m } else { rotation_rad }));
        let mut sums = JointEquations {
            matrix: SMatrix::zeros(),
            right: SVector::zeros(),
            views: Vec::new(),
            loss: 0.0,
            chi_square: [0.0; 2],
            squares_px2: 0.0,
            corners: 0,
        };
        for (view, X_BE) in self.views.iter().zip(&state.arm) {
            let rows = ViewRows::new(&state.X_MC, &state.X_WO, self.arm_at(view, X_BE), state.offset_s);
            let mut equations = NormalEquations::<ALL>::new();
            for corner in &view.corners {
                let Some(at) = rows.rows(corner, self.camera) else {
                    return Err(HandEyeError::Behind { view: view.name.clone() });
                };
                let weight = 1.0 / (corner.sd_px * corner.sd_px);
                let e = corner.px - at.px;
                let k2 = e.norm_squared() * weight;
                let (rho, slope) = self.settings.loss.at(k2);
                equations.add_rows(&at.by, &e, weight * slope);
                sums.loss += rho;
                sums.chi_square[0] += k2;
                sums.squares_px2 += e.norm_squared();
                sums.corners += 1;
            }
            let (matrix, right) = (equations.matrix(), equations.vector());
            sums.matrix += matrix.fixed_view::<GLOBAL, GLOBAL>(0, 0);
            sums.right += right.fixed_rows::<GLOBAL>(0);
            if exact {
                continue;
            }
            let mut part = ViewSums {
                mixed: matrix.fixed_view::<GLOBAL, 6>(0, GLOBAL).into_owned(),
                own: matrix.fixed_view::<6, 6>(GLOBAL, GLOBAL).into_owned(),
                right: right.fixed_rows::<6>(GLOBAL).into_owned(),
            };
            let (d, slope) = correction(&view.X_BE, X_BE);
            let weighted = Matrix6::from_diagonal(&prior);
            part.own += slope.transpose() * weighted * slope;
            part.right -= slope.transpose() * weighted * d;
            let cost = d.component_mul(&prior).dot(&d);
            sums.loss += cost;
            sums.chi_square[1] += cost;
            sums.views.push(part);
        }
        if sums.loss.is_finite() { Ok(sums) } else { Err(HandEyeError::NotConverged { iterations: 0 }) }
    }

    fn end(
        &self,
        state: &HandEyeUnknowns,
        sums: &JointEquations,
        iterations: u32,
    ) -> Result<JointFit, HandEyeError> {
        let settings = self.settings;
        let factors = sums.factors(0.0, settings).ok_or_else(|| sums.undetermined(settings))?;
        let mut covariance = SMatrix::<f64, GLOBAL, GLOBAL>::from(factors.1.inverse());
        for held in (0..GLOBAL).filter(|i| settings.holds(*i)) {
            covariance.fill_row(held, 0.0);
            covariance.fill_column(held, 0.0);
        }
        Ok(JointFit {
            X_MC: state.X_MC,
            X_WO: state.X_WO,
            offset_s: state.offset_s,
            covariance_X_MC: covariance.fixed_view::<6, 6>(0, 0).into_owned(),
            covariance_X_WO: covariance.fixed_view::<6, 6>(BOARD, BOARD).into_owned(),
            offset_sd_s: settings.time_offset.then(|| covariance[(TIME, TIME)].sqrt()),
            corrections: self.views.iter().zip(&state.arm).map(|(v, X)| correction(&v.X_BE, X).0).collect(),
            arm: state.arm.clone(),
            chi_square: sums.chi_square,
            rms_px: (sums.squares_px2 / sums.corners.max(1) as f64).sqrt(),
            iterations,
        })
    }
}

/// The factors of each view's own block, and those of what is left for the global unknowns.
type Factors = (Vec<Ldlt<6>>, Ldlt<GLOBAL>);

impl JointEquations {
    /// Damped by `damping` of the diagonal. `None` where something is not determined.
    fn factors(&self, damping: f64, settings: &JointSettings) -> Option<Factors> {
        let mut left = self.matrix;
        for i in 0..GLOBAL {
            left[(i, i)] *= 1.0 + damping;
        }
        let mut own = Vec::with_capacity(self.views.len());
        for view in &self.views {
            let diagonal = std::array::from_fn(|i| damping * view.own[(i, i)]);
            let factors = Ldlt::new(&view.own.data.0, &diagonal)?;
            left -= view.mixed * Matrix6::from(factors.inverse()) * view.mixed.transpose();
            own.push(factors);
        }
        for held in (0..GLOBAL).filter(|i| settings.holds(*i)) {
            left.fill_row(held, 0.0);
            left.fill_column(held, 0.0);
            left[(held, held)] = 1.0;
        }
        Some((own, Ldlt::of(&left)?))
    }

    fn step(&self, damping: f64, settings: &JointSettings) -> Option<RefinementStep> {
        let (own, left) = self.factors(damping, settings)?;
        let mut right = self.right;
        for (view, factors) in self.views.iter().zip(&own) {
            right -= view.mixed * Vector6::from(factors.solve(&view.right.into()));
        }
        for held in (0..GLOBAL).filter(|i| settings.holds(*i)) {
            right[held] = 0.0;
        }
        let global = Global::from(left.solve(&right.into()));
        let of_view = |(view, factors): (&ViewSums, &Ldlt<6>)| {
            Vector6::from(factors.solve(&(view.right - view.mixed.transpose() * global).into()))
        };
        let views: Vec<_> = self.views.iter().zip(&own).map(of_view).collect();
        let size = views.iter().map(|d| d.amax()).fold(global.amax(), f64::max);
        let of_views: f64 = self.views.iter().zip(&views).map(|(view, d)| view.right.dot(d)).sum();
        let gain = self.right.dot(&global) + of_views;
        size.is_finite().then_some(RefinementStep { global, views, size, gain })
    }

    fn is_last(&self, step: &RefinementStep) -> bool {
        step.size < LAST_STEP || step.gain <= LAST_GAIN * self.loss_by_freedom()
    }

    /// A correction of the arm's pose is an unknown and an observation, so that it counts as neither.
    fn loss_by_freedom(&self) -> f64 {
        (self.loss / (2 * self.corners).saturating_sub(GLOBAL).max(1) as f64).max(NOTHING)
    }

    fn undetermined(&self, settings: &JointSettings) -> HandEyeError {
        let at_rest = JointSettings { time_offset: false, ..*settings };
        let what = if settings.time_offset && self.factors(0.0, &at_rest).is_some() {
            "the time offset"
        } else {
            "the camera's pose"
        };
        HandEyeError::Undetermined { what }
    }
}
