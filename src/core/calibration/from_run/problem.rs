//! The least-squares problem: nineteen unknowns with priors, by Gauss-Newton on all points in standard deviations.
//!
//! Derivatives are differences, since no run is that long. Huber's weights make outliers count less. Where points are farther off than they state, all count
//! less, by their spread; where they are nearer, nothing counts more.

use super::refinement::{RunRefinement, RunRefinementError};
use super::unknowns::{OBJECT, PRIOR, RunUnknowns, SIZE, STAMPS, UNKNOWNS, lens_of, mount_of};
use super::views::{RunCell, RunViews, SeenView};
use crate::calibration::JointTrack;
use crate::geometry::{Pose, integrate_body_twist};
use crate::linalg::Ldlt;
use nalgebra::{Point3, SMatrix, SVector, Vector2};

/// Steps of the differences: chosen by hand, 0.01 px to 0.1 px of usual views, far above rounding and far below what bends.
pub(super) const STEP: f64 = 1e-5;
/// Smallest standard deviation of a point, px: a hundredth, because no finder measures real images better.
const MIN_SD_PX: f64 = 0.01;
/// Of points that state none, px. Chosen by hand, above what rendered marks have: spreads below it are not believed.
const UNKNOWN_SD_PX: f64 = 0.05;
/// Residuals beyond so many standard deviations count less. Chosen by hand: one of a hundred does that is right.
const HUBER: f64 = 3.0;
/// Fewest views of a refinement. Chosen by hand: twice as many equations as unknowns with four points each, and a motion.
const LEAST: usize = 6;
/// Most steps. Chosen by hand, so that the search must come to an end: a small step ends it earlier.
const ITERATIONS: usize = 60;
/// Most halvings of a step. Chosen by hand: a four-thousandth of it that is no better leads nowhere.
const HALVINGS: u32 = 12;
/// The step in standard deviations of the prior that ends the search. Chosen by hand: no estimate is that sure.
const LAST_STEP: f64 = 1e-6;
/// The fall of the cost that ends the search. Chosen by hand: the cost is half of a chi-square, so that a step that lowers it by so little is a thousandth of a standard deviation long.
const LAST_FALL: f64 = 1e-6;
/// Root mean square of what is left, px, beyond which nothing that is refined explains it. Chosen by hand: an arm whose flange is 3 mm from where its file says is off by
/// so much half a metre before a usual lens, and points of a target that moved are off by hundreds.
const MOST_RMS_PX: f64 = 5.0;
/// The same in standard deviations of the points, where it is more than [`SMALL_PX`]. Chosen by hand: a board that was pushed by 1 mm in a run leaves 40 of them, a lens whose second
/// radial coefficient is not told a few.
const MOST_SPREAD: f64 = 10.0;
/// Standard deviations by which the square of a spread may be above one by chance. Chosen by hand: normal noise does it once in 700 runs. That of a spread by the median of `n` points is
/// about `sqrt(2 * 2 / n)`: of `2 n` numbers it is `sqrt(2 / (2 n))`, and a median knows it half as well.
const CHANCE_SDS: f64 = 3.0;
/// What may be left of points whatever they state, px. Chosen by hand: what tangential and higher coefficients of usual lenses leave.
const SMALL_PX: f64 = 0.2;

pub(super) type RunInformation = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// What fits a run best.
pub struct RunFit<'a, const N: usize> {
    problem: RunProblem<'a, N>,
    repeated: usize,
    /// The pose of the target from which its unknowns count.
    pub(super) first: Pose,
    pub(super) at: RunUnknowns,
    pub(super) covariance: RunInformation,
    /// What remains, root mean square, px.
    pub(super) rms_px: f64,
}

impl<const N: usize> RunFit<'_, N> {
    /// The target in the camera with joints at `q`, for unknowns `at`.
    pub(super) fn X_CO(&self, q: &SVector<f64, N>, at: &RunUnknowns) -> Pose {
        let cell = &self.problem.cell;
        mount_of(cell.mount, at).X_WC(cell.robot, q).inv_mul(&object_of(&self.first, at))
    }

    /// The description of the cell as the run has it.
    ///
    /// # Errors
    /// [`RunRefinementError`] when there are too few views, or no lens is left.
    pub fn refinement(&self) -> Result<RunRefinement, RunRefinementError> {
        let (problem, cell) = (&self.problem, &self.problem.cell);
        if problem.views.len() < LEAST {
            return Err(RunRefinementError::TooFewViews { found: problem.views.len(), needed: LEAST });
        }
        let lens = lens_of(cell.camera, &self.at).ok_or(RunRefinementError::NoFit)?;
        let before = problem.best_pose_alone(&self.first).and_then(|at| problem.residuals(&self.first, &at));
        let rms = (before.map_or(f64::NAN, |r| problem.rms_px(&r)), self.rms_px);
        let views = (problem.views.len(), self.repeated);
        Ok(RunRefinement::new(cell, (&self.at, &self.covariance), &lens, views, rms))
    }
}

/// Fits all unknowns to what `run` has seen, be it a single view: what that does not tell stays as the prior has it.
///
/// # Errors
/// [`RunRefinementError`] when nothing was seen, or nothing explains it.
pub fn fit_run<'a, const N: usize>(
    cell: &RunCell<'a, N>,
    run: &'a RunViews<N>,
) -> Result<RunFit<'a, N>, RunRefinementError> {
    let problem = RunProblem { cell: *cell, track: &run.track, views: run.thinned() };
    let first = problem.first_guess().ok_or(RunRefinementError::TooFewViews { found: 0, needed: LEAST })?;
    let mut at = RunUnknowns::zeros();
    let (mut spread, mut previous) = (1.0_f64, f64::INFINITY);
    let mut covariance = None;
    for _ in 0..4 {
        (at, covariance) = problem.descend(&first, at, spread);
        let residuals = problem.residuals(&first, &at).ok_or(RunRefinementError::NoFit)?;
        spread = spread_of(&residuals, UNKNOWNS).max(1.0);
        // Chosen by hand: a thousandth of a standard deviation is not worth another round.
        if (spread / previous - 1.0).abs() < 1e-3 {
            break;
        }
        previous = spread;
    }
    let mut covariance = covariance.ok_or(RunRefinementError::NoFit)?;
    let after = problem.residuals(&first, &at).ok_or(RunRefinementError::NoFit)?;
    let rms_px = problem.rms_px(&after);
    if !(rms_px < MOST_RMS_PX) || (spread > MOST_SPREAD && rms_px > SMALL_PX) {
        return Err(RunRefinementError::Unexplained { rms_px });
    }
    let (H, _) = problem
        .normal(&first, &at, (&after, together(spread, after.len())))
        .ok_or(RunRefinementError::NoFit)?;
    if let Some(factors) = Ldlt::of(&H).filter(|_| spread > 1.0) {
        covariance = factors.inverse().into();
    }
    Ok(RunFit { problem, repeated: run.repeated, first, at, covariance, rms_px })
}

/// The target in the frame in which it rests.
fn object_of(first: &Pose, at: &RunUnknowns) -> Pose {
    integrate_body_twist(first, &at.fixed_rows::<6>(OBJECT).into(), 1.0)
}

/// The spread of residuals with which they count in the covariance. What is left beyond the points' own errors is no chance: a target that creeps, an arm that is not where its encoders say
/// or a lens of another kind shifts the points of a view together, and those of the next view alike. That share of `points` points tells no more than one number for each unknown.
fn together(spread: f64, points: usize) -> f64 {
    let by_chance = 1.0 + CHANCE_SDS * (2.0 * 2.0 / points as f64).sqrt();
    let share = (1.0 - by_chance / (spread * spread)).max(0.0);
    let alike = (2.0 * points as f64 / UNKNOWNS as f64).max(1.0);
    spread * (1.0 + share * (alike - 1.0)).sqrt()
}

/// Spread of residuals in standard deviations, from their median: outliers do not move it. The median length of two unit normal numbers is sqrt(2 ln 2).
fn spread_of(residuals: &[Vector2<f64>], unknowns: usize) -> f64 {
    let mut lengths: Vec<f64> = residuals.iter().map(Vector2::norm).collect();
    let middle = lengths.len() / 2;
    let (_, median, _) = lengths.select_nth_unstable_by(middle, f64::total_cmp);
    let numbers = 2.0 * residuals.len() as f64;
    let freedom = (numbers - unknowns as f64).max(1.0);
    *median / (2.0 * 2.0_f64.ln()).sqrt() * (numbers / freedom).sqrt()
}

pub(super) struct RunProblem<'a, const N: usize> {
    cell: RunCell<'a, N>,
    track: &'a JointTrack<N>,
    views: Vec<&'a SeenView>,
}

impl<const N: usize> RunProblem<'_, N> {
    /// X_WO by the view in the middle of the run.
    fn first_guess(&self) -> Option<Pose> {
        let view = self.views.get(self.views.len() / 2)?;
        let (q, _) = self.track.at(view.stamp, 0.0)?;
        Some(self.cell.mount.X_WC(self.cell.robot, &q) * view.X_CO)
    }

    fn sd_px(sd_px: f64) -> f64 {
        if sd_px > 0.0 { sd_px.max(MIN_SD_PX) } else { UNKNOWN_SD_PX }
    }

    /// All residuals in standard deviations; `None` where a point would lie behind the camera.
    fn residuals(&self, first: &Pose, at: &RunUnknowns) -> Option<Vec<Vector2<f64>>> {
        let lens = lens_of(self.cell.camera, at)?;
        let mount = mount_of(self.cell.mount, at);
        let X_WO = object_of(first, at);
        let size = at[SIZE].exp();
        let mut all = Vec::new();
        for view in &self.views {
            let (q, _) = self.track.at(view.stamp, at[STAMPS])?;
            let X_CO = mount.X_WC(self.cell.robot, &q).inv_mul(&X_WO);
            for point in &view.points {
                let p_C = X_CO * Point3::from(point.p_O.coords * size);
                all.push((lens.project(&p_C)? - point.px) / Self::sd_px(point.sd_px));
            }
        }
        Some(all)
    }

    /// Root mean square of the distances, px.
    fn rms_px(&self, residuals: &[Vector2<f64>]) -> f64 {
        let sds = self.views.iter().flat_map(|view| view.points.iter().map(|p| Self::sd_px(p.sd_px)));
        let sum: f64 = residuals.iter().zip(sds).map(|(r, sd)| r.norm_squared() * sd * sd).sum();
        (sum / residuals.len().max(1) as f64).sqrt()
    }

    fn cost(residuals: &[Vector2<f64>], at: &RunUnknowns, spread: f64) -> f64 {
        let of = |r: &Vector2<f64>| {
            let r = r.norm() / spread;
            if r <= HUBER { 0.5 * r * r } else { HUBER * (r - 0.5 * HUBER) }
        };
        let prior = at.component_div(&RunUnknowns::from(PRIOR)).norm_squared();
        residuals.iter().map(of).sum::<f64>() + 0.5 * prior
    }

    /// Information matrix and gradient of the cost.
    fn normal(
        &self,
        first: &Pose,
        at: &RunUnknowns,
        (residuals, spread): (&[Vector2<f64>], f64),
    ) -> Option<(RunInformation, RunUnknowns)> {
        let mut columns = Vec::with_capacity(UNKNOWNS);
        for k in 0..UNKNOWNS {
            let mut there = *at;
            there[k] += STEP;
            columns.push(self.residuals(first, &there)?);
        }
        let prior = RunUnknowns::from(PRIOR).map(|sd| sd.powi(-2));
        let mut H = RunInformation::from_diagonal(&prior);
        let mut g = prior.component_mul(at);
        for (i, r) in residuals.iter().enumerate() {
            let weight = (HUBER * spread / r.norm().max(f64::MIN_POSITIVE)).min(1.0) / (spread * spread);
            let J = SMatrix::<f64, 2, UNKNOWNS>::from_fn(|row, k| (columns[k][i][row] - r[row]) / STEP);
            H += J.transpose() * J * weight;
            g += J.transpose() * r * weight;
        }
        Some((H, g))
    }

    /// Down from `at`; the covariance there.
    fn descend(
        &self,
        first: &Pose,
        mut at: RunUnknowns,
        spread: f64,
    ) -> (RunUnknowns, Option<RunInformation>) {
        let mut covariance = None;
        for _ in 0..ITERATIONS {
            let Some(residuals) = self.residuals(first, &at) else { break };
            let Some((H, g)) = self.normal(first, &at, (&residuals, spread)) else { break };
            let Some(factors) = Ldlt::of(&H) else { break };
            covariance = Some(RunInformation::from(factors.inverse()));
            let step = -RunUnknowns::from(factors.solve(&g.into()));
            let before = Self::cost(&residuals, &at, spread);
            let lower = |share: f64| {
                let there = at + step * share;
                let cost = self.residuals(first, &there).map(|r| Self::cost(&r, &there, spread))?;
                (cost <= before).then_some((there, cost))
            };
            let Some((there, cost)) = (0..HALVINGS).find_map(|k| lower(0.5_f64.powi(k as i32))) else {
                break;
            };
            at = there;
            let is_small = step.component_div(&RunUnknowns::from(PRIOR)).amax() < LAST_STEP;
            if is_small || before - cost < LAST_FALL {
                break;
            }
        }
        (at, covariance)
    }

    /// The unknowns of the run file, but for the pose of the target.
    fn best_pose_alone(&self, first: &Pose) -> Option<RunUnknowns> {
        let mut at = RunUnknowns::zeros();
        // A linear problem nearly: three steps leave less than the points' errors.
        for _ in 0..3 {
            let residuals = self.residuals(first, &at)?;
            let (H, g) = self.normal(first, &at, (&residuals, spread_of(&residuals, 6).max(1.0)))?;
            let of_object = H.fixed_view::<6, 6>(OBJECT, OBJECT).into_owned();
            let step = Ldlt::of(&of_object)?.solve(&g.fixed_rows::<6>(OBJECT).into_owned().into());
            for (k, step) in step.iter().enumerate() {
                at[OBJECT + k] -= step;
            }
        }
        Some(at)
    }
}
