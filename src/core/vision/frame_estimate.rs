//! From the detections of one frame to features, pose and covariance, and whether these are accepted.
//!
//! Data flow: the points of the finder are corrected for the offset of their centres at the known pose, two candidate poses of the plane are computed and
//! one is chosen and refined; corrections and pose are repeated. Points that do not fit are left out. The estimate is accepted where the reprojection
//! errors fit the stated variances ([`PoseEstimator::believes`]), and is then written into the measurement.
//!
//! "Dot" stands here for a point of any target.

use super::expectation::find;
use super::misfit::{self, ENOUGH_TO_CHOOSE, Growth, MAX_MISFIT};
use super::pose_approach::{PoseApproach, analytical_pose, start};
use super::steady_misfit::Errors;
use super::{Prior, VisionSettings};
use crate::camera_model::CameraModel;
use crate::detect::{Detection, Finder, PredictedPoint};
use crate::geometry::Pose;
use crate::messages::{FeaturePoint, MAX_FEATURES, Measurement, TargetStatus, measurement_flag};
use crate::pose::{Correspondence, Correspondence3, PlanarPose, RefinedPose, refine_3d};
use crate::target::Target;
use nalgebra::{Matrix6, Vector2};

/// Changes of the centres' offsets below this need no second iteration, px. Chosen by hand: an iteration leaves a few hundredths of the change, 0.002 px.
const SMALL_CHANGE_PX: f64 = 0.05;
/// Largest offset of a centre that is corrected before the pose is estimated, in standard deviations of the
/// points of the dot's disc (half of its radius). Chosen by hand: offsets of centres are tenths of a pixel, a quarter of the radius only an absurd prediction
/// has. Half may skip the correction of small tilted dots, so that only the first of two poses is less exact; the double lets wrong predictions in.
const MAX_OFFSET: f64 = 0.5;
/// Largest shift of one dot's centroid by something dark beside it, px: two dots at the edge of a shadow may shift in a way that a pose
/// explains. Chosen by hand: half leaves out dots beside harmless shadows, the double lets a shadow shift dots by a pixel.
const MAX_DISTURBANCE_PX: f64 = 0.5;

/// A point whose distance from its prediction exceeds this many robust standard deviations is left out. Chosen by hand: by noise alone,
/// two coordinates exceed five once in 270 000 cases (`exp(-12.5)`).
const STRAY: f64 = 5.0;
/// Median of chi-square with 2 degrees of freedom, 2 ln 2.
const MEDIAN_SQUARE: f64 = 1.386;

/// A point of a body is left out where its standard deviation is so many times that of the surest one. Chosen by hand: with a few such points among
/// many the pose of least error is a little less exact than one that weighs them, and not a wrong one.
const SURE_ENOUGH: f64 = 4.0;

/// Three dots cannot contradict each other: their surroundings may shift them by this, px, and their contrast change by this share. Both chosen by hand.
const LONE_DISTURBANCE_PX: f64 = 0.1;
const LONE_CONTRAST: f64 = 0.2;

/// The detections of one frame, and features and pose that were computed from them.
#[derive(Debug, Clone, Default)]
pub(super) struct FrameEstimate {
    /// Detections, ids rising.
    pub(super) dots: Vec<Detection>,
    /// Images of the points' centres, px, in the same order.
    pub(super) px: Vec<Vector2<f64>>,
    /// The points of the object and in the image, likewise.
    pub(super) pairs: Vec<Correspondence3>,
    /// The same of a plane, while a solution for planes has them.
    plane: Vec<Correspondence>,
    /// Of three dots only a guess, with which their centres are put right: they leave up to four poses.
    pub(super) pose: Option<RefinedPose>,
    pub(super) ambiguous: bool,
    /// Where the pose is ambiguous: the other pose, and the logarithm of the likelihood ratio of the first to it.
    pub(super) other: Option<(RefinedPose, f64)>,
    /// Reprojection error of the pose of least error, by which it is judged whether one pose explains the dots; infinite without one.
    pub(super) rms_px: f64,
    /// Whether dots without redundancy look as they did in the last frame.
    plausible: bool,
}

impl FrameEstimate {
    pub(super) fn with_room_for(count: usize) -> Self {
        // one more: the prediction of a hidden dot may take part in the first pose
        Self {
            dots: Vec::with_capacity(count),
            px: Vec::with_capacity(count),
            pairs: Vec::with_capacity(count + 1),
            plane: Vec::with_capacity(count + 1),
            ..Self::default()
        }
    }

    /// Mean variance of the points in each coordinate, px^2.
    pub(super) fn variance_px2(&self) -> f64 {
        self.dots.iter().map(|d| d.sd_px * d.sd_px).sum::<f64>() / self.dots.len().max(1) as f64
    }

    /// Extent of the target in the image: root mean square distance of its points from their centre, px.
    pub(super) fn extent_px(&self) -> f64 {
        let count = self.px.len().max(1) as f64;
        let centre = self.px.iter().sum::<Vector2<f64>>() / count;
        (self.px.iter().map(|px| (px - centre).norm_squared()).sum::<f64>() / count).sqrt()
    }

    /// By how much the covariances of points and pose are larger than stated with noise of the variance `noise_px2`, px^2, according to the misfit.
    pub(super) fn growth(&self, noise_px2: f64) -> Growth {
        let variance = self.dots.iter().map(|d| d.sd_px * d.sd_px + noise_px2).sum::<f64>();
        let count = self.dots.len() as f64;
        Growth::of(self.dots.len(), count * count * self.rms_px * self.rms_px / variance)
    }
}

/// Camera, target and settings, with which the pose of a frame is estimated and checked.
#[derive(Debug, Clone)]
pub(super) struct PoseEstimator {
    pub(super) camera: CameraModel,
    pub(super) target: Target,
    pub(super) settings: VisionSettings,
    /// Whether all of the target's points lie in one plane.
    pub(super) is_flat: bool,
    /// Points that serve as features, by id.
    serves: Box<[bool]>,
    /// Root mean square reprojection error, px, that a known model error explains ([`super::steady_misfit`]).
    pub(super) allowance_px: f64,
    /// Variance of each coordinate, px^2, beyond what the finder states ([`super::noise_level`]).
    pub(super) noise_px2: f64,
}

impl PoseEstimator {
    pub(super) fn new(camera: CameraModel, target: Target, settings: VisionSettings) -> Self {
        let mut serves: Box<[bool]> = target.points().iter().map(|_| false).collect();
        for point in target.features() {
            if let Some(serves) = serves.get_mut(point.id as usize) {
                *serves = true;
            }
        }
        Self {
            is_flat: target.is_flat(),
            camera,
            target,
            settings,
            serves,
            allowance_px: 0.0,
            noise_px2: 0.0,
        }
    }

    /// Computes features and pose from the detections in `estimate`. `last` is the last accepted estimate, `expected` the predictions by which the
    /// dots were found.
    pub(super) fn describe(
        &self,
        estimate: &mut FrameEstimate,
        finder: &Finder,
        prior: &Prior,
        last: Option<&FrameEstimate>,
        expected: &[PredictedPoint],
    ) {
        if !self.is_flat {
            // All points count alike in a pose, and corners of a face that is seen edge-on are found to pixels.
            let least = estimate.dots.iter().map(|dot| dot.sd_px).fold(f64::INFINITY, f64::min);
            estimate.dots.retain(|dot| dot.sd_px <= SURE_ENOUGH * least);
        }
        if estimate.dots.len() >= ENOUGH_TO_CHOOSE {
            let (count, dots) = (estimate.dots.len(), &mut estimate.dots);
            let good = |d: &Detection| d.disturbance_px <= MAX_DISTURBANCE_PX;
            if dots.iter().filter(|d| good(d)).count() >= (2 * count).div_ceil(3) {
                dots.retain(good);
            }
        }
        let most = estimate.dots.len() / 3;
        for left_out in 0..=most {
            self.solve(estimate, finder, prior, last, expected);
            // dots and their places in the image belong together: none is left out without another solution
            if left_out == most || estimate.dots.len() < ENOUGH_TO_CHOOSE || self.believes(estimate) {
                break;
            }
            // leave out the dot with the largest error
            let Some(pose) = &estimate.pose else { break };
            let misfit = |(i, dot): (usize, &Detection)| {
                let (pair, px) = (estimate.pairs.get(i)?, estimate.px.get(i)?);
                let seen = self.camera.project(&(pose.X_CO * pair.r))?;
                // so that a finder that states no error does not divide by zero
                Some((seen - px).norm() / dot.sd_px.max(1e-6))
            };
            let of = |entry: &(usize, &Detection)| misfit(*entry).unwrap_or(f64::INFINITY);
            let worst =
                estimate.dots.iter().enumerate().max_by(|a, b| of(a).total_cmp(&of(b))).map(|(i, _)| i);
            let Some(worst) = worst else { break };
            estimate.dots.remove(worst);
        }
    }

    /// The same of all detections, without leaving out any that does not fit.
    pub(super) fn describe_all(
        &self,
        estimate: &mut FrameEstimate,
        finder: &Finder,
        prior: &Prior,
        last: Option<&FrameEstimate>,
    ) {
        self.solve(estimate, finder, prior, last, &[]);
    }

    /// Reprojection errors of the estimate's points by their ids, px; none without a pose.
    pub(super) fn errors(&self, estimate: &FrameEstimate, errors: &mut Errors) {
        errors.clear();
        let Some(pose) = &estimate.pose else { return };
        let points = estimate.dots.iter().zip(&estimate.px).zip(&estimate.pairs);
        errors.extend(points.filter_map(|((dot, px), pair)| {
            Some((dot.id, self.camera.project(&(pose.X_CO * pair.r))? - px))
        }));
    }

    /// Leaves out outliers: points whose reprojection error exceeds [`STRAY`] robust standard deviations, up to a third of them.
    pub(super) fn leave_out_strays(&self, estimate: &mut FrameEstimate, finder: &Finder) {
        for _ in 0..estimate.dots.len() / 3 {
            if estimate.dots.len() < ENOUGH_TO_CHOOSE {
                break;
            }
            let Some(pose) = &estimate.pose else { break };
            let square = |((dot, px), pair): ((&Detection, &Vector2<f64>), &Correspondence3)| {
                let seen = self.camera.project(&(pose.X_CO * pair.r));
                let variance = dot.sd_px * dot.sd_px;
                // so that a finder that states no error does not divide by zero
                seen.map_or(f64::INFINITY, |seen| (seen - px).norm_squared() / variance.max(1e-12))
            };
            let squares: Vec<f64> =
                estimate.dots.iter().zip(&estimate.px).zip(&estimate.pairs).map(square).collect();
            let mut sorted = squares.clone();
            sorted.sort_unstable_by(f64::total_cmp);
            let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
            let worst = squares.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
            let Some((at, worst)) = worst else { break };
            if *worst <= STRAY * STRAY * (median / MEDIAN_SQUARE).max(1.0) {
                break;
            }
            estimate.dots.remove(at);
            self.solve(estimate, finder, &Prior::default(), None, &[]);
        }
    }

    fn solve(
        &self,
        estimate: &mut FrameEstimate,
        finder: &Finder,
        prior: &Prior,
        last: Option<&FrameEstimate>,
        expected: &[PredictedPoint],
    ) {
        let method = self.settings.pose;
        self.solve_by(method, estimate, finder, prior, last, expected);
        if method == PoseApproach::Iterative && !self.believes(estimate) {
            self.solve_by(PoseApproach::Both, estimate, finder, prior, last, expected);
        }
    }

    #[allow(clippy::too_many_arguments)] // those of `solve`, and the method
    fn solve_by(
        &self,
        method: PoseApproach,
        estimate: &mut FrameEstimate,
        finder: &Finder,
        prior: &Prior,
        last: Option<&FrameEstimate>,
        expected: &[PredictedPoint],
    ) {
        let FrameEstimate { dots, px, pairs, plane, pose, ambiguous, other, rms_px, plausible } = estimate;
        (*pose, *ambiguous, *rms_px, *plausible) = (None, false, f64::INFINITY, true);
        *other = None;
        px.clear();
        px.extend(dots.iter().map(|dot| dot.px));
        pairs.clear();
        let place = |id: u32| self.target.points().get(id as usize).map(|point| point.p_O);
        let pair = |id: u32, px: &Vector2<f64>| {
            Some(Correspondence3 { r: place(id)?, s: self.camera.normalized_of(px) })
        };
        let known = prior.predicted_X_CO.or_else(|| last?.pose.map(|pose| pose.X_CO));
        // three dots leave up to four poses: for the first pose the hidden dot is taken to be at its prediction
        let hidden = expected.iter().find(|e| dots.len() == 3 && find(dots, e.id).is_none());
        // a predicted pose is good enough to correct the centroids
        if let Some(known) = known.filter(|_| hidden.is_none()) {
            for (px, dot) in px.iter_mut().zip(dots.iter()) {
                let offset = finder.bias_px(dot.id, &known);
                let [xx, _, yy] = dot.covariance_px2;
                // a predicted pose from outside may be absurd or not finite: no centre has such an offset
                if offset.norm_squared() <= MAX_OFFSET * MAX_OFFSET * xx.max(yy) {
                    *px = dot.px - offset;
                }
            }
        }
        pairs.extend(dots.iter().zip(px.iter()).filter_map(|(dot, px)| pair(dot.id, px)));
        if pairs.len() != dots.len() || dots.is_empty() {
            return; // an id that the target does not have
        }
        let i = self.camera.intrinsics();
        let f = (i.fx_px * i.fy_px).sqrt();
        let count = dots.len() as f64;
        let sd_px = (dots.iter().map(|d| d.sd_px * d.sd_px).sum::<f64>() / count + self.noise_px2).sqrt();
        pairs.extend(hidden.and_then(|hidden| pair(hidden.id, &hidden.px)));
        let method = if hidden.is_some() { PoseApproach::Both } else { method };
        let both = start(method, self.is_flat, pairs, known.as_ref(), plane);
        pairs.truncate(dots.len());
        let Ok(both) = both else { return };
        let mut X_CO = if hidden.is_some() {
            known.map_or(both.best.X_CO, |known| both.nearest(&known).X_CO)
        } else {
            let chosen;
            // A known model error does not choose either.
            let model_sd_px = self.allowance_px * std::f64::consts::FRAC_1_SQRT_2;
            (chosen, *ambiguous) = self.choose(&both, known.as_ref(), count, sd_px.hypot(model_sd_px) / f);
            chosen
        };
        if method == PoseApproach::Iterative {
            // Where centres lie off their points is asked at this frame's pose, not at the last one's.
            X_CO = refine_3d(&X_CO, pairs, sd_px / f).map_or(X_CO, |refined| refined.X_CO);
        }
        let mut fitting = None;
        // the offsets depend on the pose, and it on them: each turn leaves a few hundredths of what was wrong
        for _ in 0..2 {
            let mut greatest = 0.0f64;
            for ((px, pair), dot) in px.iter_mut().zip(pairs.iter_mut()).zip(dots.iter()) {
                let before = *px;
                *px = dot.px - finder.bias_px(dot.id, &X_CO);
                pair.s = self.camera.normalized_of(px);
                greatest = greatest.max((*px - before).norm_squared());
            }
            let refined = if hidden.is_some() {
                Ok(RefinedPose { X_CO, rms: 0.0, covariance: Matrix6::zeros(), iterations: 0 })
            } else {
                refine_3d(&X_CO, pairs, sd_px / f)
            };
            let Ok(refined) = refined else { break };
            X_CO = refined.X_CO;
            fitting = Some(X_CO);
            *pose = if method == PoseApproach::Analytical {
                let found = analytical_pose(pairs, sd_px / f, plane);
                found.map(|(X_CO, covariance)| RefinedPose { X_CO, covariance, ..refined })
            } else {
                Some(refined)
            };
            if greatest < SMALL_CHANGE_PX * SMALL_CHANGE_PX {
                break;
            }
        }
        let (Some(pose), Some(fitting)) = (pose, fitting) else { return };
        if *ambiguous && let Some(second) = both.other {
            // the one of both that was not chosen
            let apart = |X: &Pose| X.rotation.angle_to(&pose.X_CO.rotation);
            let start_of_other =
                if apart(&second.X_CO) > apart(&both.best.X_CO) { second.X_CO } else { both.best.X_CO };
            let sd = sd_px / f;
            *other = refine_3d(&start_of_other, pairs, sd).ok().map(|second| {
                let squares = count * (second.rms * second.rms - pose.rms * pose.rms);
                // so that a finder that states no error does not divide by zero
                (second, 0.5 * squares / (sd * sd).max(1e-30))
            });
        }
        let squares = pairs.iter().zip(px.iter()).map(|(pair, px)| {
            let seen = self.camera.project(&(fitting * pair.r));
            seen.map_or(f64::INFINITY, |seen| (seen - px).norm_squared())
        });
        *rms_px = (squares.sum::<f64>() / count).sqrt();
        if dots.len() < 4 {
            *plausible = Self::is_plausible(dots, last);
        }
    }

    /// Whether three dots, which have no redundancy, have the contrast of the last frame and nothing dark beside them.
    fn is_plausible(dots: &[Detection], last: Option<&FrameEstimate>) -> bool {
        let contrast = |dot: &Detection| dot.plate_level - dot.dark_level;
        let alike = |dot: &Detection| {
            // a dot that was hidden is compared with another one of the last frame
            let before = last.and_then(|last| find(&last.dots, dot.id).or(last.dots.first()));
            dot.disturbance_px <= LONE_DISTURBANCE_PX
                && before.is_some_and(|old| (contrast(dot) / contrast(old) - 1.0).abs() <= LONE_CONTRAST)
        };
        dots.len() == 3 && dots.iter().all(alike)
    }

    /// Whether the estimate is accepted: one pose explains the points within their variances, and nothing dark beside a dot shifts it.
    pub(super) fn believes(&self, estimate: &FrameEstimate) -> bool {
        self.believes_with(self.noise_px2, estimate)
    }

    /// The same with noise of this variance, px^2, beyond what the finder states.
    pub(super) fn believes_with(&self, noise_px2: f64, estimate: &FrameEstimate) -> bool {
        let count = estimate.dots.len() as f64;
        let model_px2 = self.settings.model_sd_px * self.settings.model_sd_px;
        let variance = estimate.variance_px2() + model_px2 + misfit::LEARNT_SHARE * noise_px2;
        estimate.pose.is_some()
            && estimate.plausible
            // three points have six coordinates, as a pose has unknowns, so that nothing is left to judge
            && (count < 4.0
                || count * (estimate.rms_px * estimate.rms_px - self.allowance_px * self.allowance_px)
                    <= largest_misfit(estimate.dots.len()) * variance)
            && Self::is_undisturbed(estimate)
    }

    /// Whether nothing dark beside a dot shifts it.
    pub(super) fn is_undisturbed(estimate: &FrameEstimate) -> bool {
        estimate.dots.iter().all(|d| d.disturbance_px <= MAX_DISTURBANCE_PX)
    }

    /// Chooses between the two poses of a plane: the better one, or, where both explain the image of `count` points almost equally well
    /// (ambiguity), the one nearer to the `known` pose. Returns it, and whether the pose is ambiguous. `sd`: of a feature, normalized.
    fn choose(&self, both: &PlanarPose, known: Option<&Pose>, count: f64, sd: f64) -> (Pose, bool) {
        let PlanarPose { best, other } = both;
        let Some(other) = other else { return (best.X_CO, false) };
        // rms is over the points; the criterion is the difference of the sums of squares
        let limit = self.settings.ambiguity_sds * sd;
        if count * (other.rms * other.rms - best.rms * best.rms) > limit * limit {
            return (best.X_CO, false);
        }
        (known.map_or(best.X_CO, |known| both.nearest(known).X_CO), true)
    }

    /// Writes features, pose, covariance and flags into the measurement.
    pub(super) fn fill(&self, estimate: &FrameEstimate, tracked: bool, m: &mut Measurement) {
        m.status = TargetStatus::Found as u32;
        // A model error that is known is more uncertain than the noise of the points.
        let growth = if self.allowance_px > 0.0 { estimate.growth(self.noise_px2) } else { Growth::NONE };
        let seen = estimate.dots.iter().zip(&estimate.px).zip(&estimate.pairs);
        let features = seen.filter(|((dot, _), _)| self.serves.get(dot.id as usize) == Some(&true));
        let mut count = 0;
        for (place, ((dot, px), pair)) in m.features.iter_mut().zip(features) {
            let sd_px = (dot.sd_px * dot.sd_px + self.noise_px2).sqrt() * growth.points.sqrt();
            let id = u64::from(dot.id);
            *place = FeaturePoint { id, u_px: px.x, v_px: px.y, x: pair.s.x, y: pair.s.y, sd_px };
            count += 1;
        }
        m.feature_count = count.min(MAX_FEATURES as u32);
        let mut say = |flag: u32, so: bool| m.flags |= if so { flag } else { 0 };
        say(measurement_flag::TRACKED, tracked);
        say(measurement_flag::AMBIGUOUS, estimate.ambiguous);
        say(measurement_flag::PARTIAL, estimate.dots.len() < self.target.points().len());
        say(measurement_flag::MODEL_ERROR, growth != Growth::NONE);
        let Some(pose) = estimate.pose.as_ref().filter(|_| estimate.dots.len() > 3) else { return };
        m.set_pose(&pose.X_CO);
        for (row, values) in m.pose_covariance.chunks_exact_mut(6).zip(pose.covariance.row_iter()) {
            row.iter_mut().zip(values.iter()).for_each(|(slot, value)| *slot = *value * growth.pose);
        }
        m.reprojection_rms_px = estimate.rms_px;
    }
}

/// Largest misfit of `count` dots, four or more.
fn largest_misfit(count: usize) -> f64 {
    if count <= 4 { MAX_MISFIT } else { misfit::largest(2.0 * count as f64 - 6.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_of_the_misfit_grows_with_the_degrees_of_freedom() {
        // 1 - 1/22000 quantiles from tables of chi-square, 2, 10 and 64 degrees of freedom: 20.0, 37.5, 118.1
        for (count, quantile) in [(4, 20.0), (8, 37.5), (35, 118.1)] {
            let ratio = largest_misfit(count) / quantile;
            assert!((2.2..2.8).contains(&ratio), "{count}: {ratio}");
        }
    }
}
