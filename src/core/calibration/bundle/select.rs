//! Joint least squares on what agrees: corners and whole images that do not are left out, and named.
//!
//! The noise of corners is not known beforehand (lens model, paper and blur add to it), so errors are held against their own
//! median: of `k^2 = e^T C^-1 e` that of chi-square with two degrees of freedom is 1.386.

use super::adjust::{BundleEnd, BundleFailure, adjust, approach};
use super::problem::{BoardObservation, BundleProblem, BundleState};
use crate::geometry::Pose;
use crate::pose::Loss;

/// Errors of exact data, squared and in standard deviations: rounding is no outlier.
const EXACT: f64 = 1e-12;
/// Median of chi-square with two degrees of freedom, 2 ln 2.
const CHI_SQUARE_MEDIAN: f64 = 1.386;
/// An image is left out as a whole when its corners fit this many times worse than those of the others, in standard deviations. Chosen by
/// hand: with a hundred corners noise makes no image a quarter worse; half leaves out images that the lens's model fits a little worse.
const WORSE: f64 = 4.0;
/// Scale of the robust loss, in standard deviations.
const ROBUST: f64 = 2.0;
/// Steps with each scale: outliers need not be fitted to the last digit.
const ROBUST_STEPS: u32 = 8;
const ROUNDS: usize = 5;

/// Why an image was left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Misfit {
    /// Its corners fit so many times worse than those of the others.
    Worse(f64),
    /// Most of its corners are outliers.
    MostCorners,
}

/// What agrees, and what it tells.
#[derive(Debug, Clone)]
pub(crate) struct Selected {
    /// The problem that is left.
    pub(crate) problem: BundleProblem,
    /// Its minimum.
    pub(crate) end: BundleEnd,
    /// Which view of the whole problem each of its views is.
    pub(crate) views: Vec<usize>,
    /// Of the whole problem, by view: why it was left out.
    pub(crate) misfits: Vec<Option<Misfit>>,
    /// Of the whole problem, by view, observation and corner: used.
    pub(crate) kept: Vec<Vec<Vec<bool>>>,
}

impl Selected {
    /// Poses of all views of the whole problem: those of views that were left out are as they were in `before`.
    pub(crate) fn all_poses(&self, before: &BundleState) -> Vec<Pose> {
        merged(before, &self.end.state, &self.views).poses
    }

    /// Factor on all variances that the errors tell: chi-square by degree of freedom.
    pub(crate) fn variance_factor(&self) -> f64 {
        self.end.sums.chi_square / self.problem.degrees_of_freedom().max(1) as f64
    }
}

/// Squared sizes of errors by view, observation and corner; infinite behind the camera.
fn sizes(problem: &BundleProblem, state: &BundleState) -> Vec<Vec<Vec<f64>>> {
    let of = |view: usize, observation: &BoardObservation| {
        let size = |point| {
            let image = state.image(observation.camera, view, point);
            image.map_or(f64::INFINITY, |image| (point.whitening * (point.px - image.px)).norm_squared())
        };
        observation.points.iter().map(size).collect()
    };
    problem.views.iter().enumerate().map(|(i, view)| view.iter().map(|s| of(i, s)).collect()).collect()
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// A decision on what takes part.
#[derive(PartialEq, Clone)]
struct ObservationSelection {
    misfits: Vec<Option<Misfit>>,
    kept: Vec<Vec<Vec<bool>>>,
}

fn judge(sizes: &[Vec<Vec<f64>>], limit_sd: f64, left_out: &[Option<Misfit>]) -> ObservationSelection {
    let taking_part = || sizes.iter().zip(left_out).filter(|(_, out)| out.is_none()).map(|(view, _)| view);
    let scale2 = median(taking_part().flatten().flatten().copied().collect()) / CHI_SQUARE_MEDIAN;
    let limit = limit_sd * limit_sd * scale2.max(EXACT);
    let medians: Vec<f64> =
        sizes.iter().map(|view| median(view.iter().flatten().copied().collect())).collect();
    let usual =
        median(medians.iter().zip(left_out).filter(|(_, out)| out.is_none()).map(|(m, _)| *m).collect());
    let kept: Vec<Vec<Vec<bool>>> =
        sizes.iter().map(|v| v.iter().map(|s| s.iter().map(|k2| *k2 <= limit).collect()).collect()).collect();
    let mut misfits: Vec<Option<Misfit>> = (medians.iter().zip(&kept).zip(left_out))
        .map(|((m, kept), out)| {
            let all = kept.iter().flatten().count();
            let outliers = kept.iter().flatten().filter(|kept| !**kept).count();
            let ratio = (m / usual.max(EXACT)).sqrt();
            match out {
                Some(misfit) => Some(*misfit),
                None if ratio > WORSE => Some(Misfit::Worse(ratio)),
                None if 2 * outliers > all => Some(Misfit::MostCorners),
                None => None,
            }
        })
        .collect();
    // where half of all images would go, nothing says which half is right
    if 2 * misfits.iter().flatten().count() >= misfits.len() {
        misfits = left_out.to_vec();
    }
    ObservationSelection { misfits, kept }
}

/// The part of the problem that takes part, with its state, and which views those are.
fn part(
    problem: &BundleProblem,
    state: &BundleState,
    verdict: &ObservationSelection,
) -> (BundleProblem, BundleState, Vec<usize>) {
    let views: Vec<usize> =
        verdict.misfits.iter().enumerate().filter(|(_, out)| out.is_none()).map(|(i, _)| i).collect();
    let reduced = views.iter().filter_map(|&i| {
        let (view, kept) = (problem.views.get(i)?, verdict.kept.get(i)?);
        let observation = |(s, kept): (&BoardObservation, &Vec<bool>)| BoardObservation {
            camera: s.camera,
            points: s.points.iter().zip(kept).filter(|(_, kept)| **kept).map(|(p, _)| *p).collect(),
        };
        Some(view.iter().zip(kept).map(observation).collect())
    });
    let problem = BundleProblem { views: reduced.collect(), ..problem.clone() };
    let poses = views.iter().filter_map(|&i| state.poses.get(i).copied()).collect();
    (problem, BundleState { poses, ..state.clone() }, views)
}

/// The whole state, with the part's results put in.
fn merged(whole: &BundleState, part: &BundleState, views: &[usize]) -> BundleState {
    let mut poses = whole.poses.clone();
    for (&i, X) in views.iter().zip(&part.poses) {
        if let Some(pose) = poses.get_mut(i) {
            *pose = *X;
        }
    }
    BundleState { poses, ..part.clone() }
}

/// The minimum over all corners within `limit_sd` standard deviations; infinite: over all.
pub(crate) fn adjust_selected(
    problem: &BundleProblem,
    start: &BundleState,
    limit_sd: f64,
) -> Result<Selected, BundleFailure> {
    let everything = ObservationSelection {
        misfits: vec![None; problem.views.len()],
        kept: problem.views.iter().map(|v| v.iter().map(|s| vec![true; s.points.len()]).collect()).collect(),
    };
    let all = adjust(problem, start.clone(), Loss::Squares);
    let whole = |end: BundleEnd| Selected {
        problem: problem.clone(),
        end,
        views: (0..problem.views.len()).collect(),
        misfits: everything.misfits.clone(),
        kept: everything.kept.clone(),
    };
    if limit_sd.is_infinite() {
        return all.map(whole);
    }
    let mut state = match all {
        Ok(end) => {
            if judge(&sizes(problem, &end.state), limit_sd, &everything.misfits) == everything {
                return Ok(whole(end));
            }
            end.state
        }
        Err(BundleFailure::NotConverged { .. }) => start.clone(),
        Err(error) => return Err(error),
    };
    // outliers pull less and less, as the scale falls to that of the others
    for _ in 0..3 {
        let all = sizes(problem, &state).into_iter().flatten().flatten().collect();
        // of corners without any noise the scale would be 0, and nothing would weigh anything
        let scale = (median(all) / CHI_SQUARE_MEDIAN).sqrt().clamp(1e-9, 1e9);
        state = approach(problem, state, Loss::Cauchy(ROBUST * scale), ROBUST_STEPS)?;
    }
    let mut verdict = judge(&sizes(problem, &state), limit_sd, &everything.misfits);
    let mut round = 0;
    loop {
        let (reduced, from, views) = part(problem, &state, &verdict);
        let end = adjust(&reduced, from, Loss::Squares)?;
        state = merged(&state, &end.state, &views);
        let next = judge(&sizes(problem, &state), limit_sd, &verdict.misfits);
        round += 1;
        if next == verdict || round == ROUNDS {
            return Ok(Selected {
                problem: reduced,
                end,
                views,
                misfits: verdict.misfits,
                kept: verdict.kept,
            });
        }
        verdict = next;
    }
}
