//! The image Jacobian of a cell of which nothing is known but the arm: learnt from how the features move when the arm moves.
//!
//! Of each point the estimate is its place `s` where the camera was last (the anchor A), and the rows `M` (2 x 6) by which the camera's displacement
//! moves it. What is called camera here is the frame at which the run file believes the camera: as it is rigidly joined to the true one, `M` is the
//! true interaction matrix times a constant matrix, whatever mount, lens and target are, and `M J(q)` is the Jacobian `ds/dq` of the joints:
//!
//! ```text
//! s(X) = s_A + M xi,   xi = log(X_WA^-1 X_WC)      measurement: z = s(X) + v,  var v = sd^2
//! anchor moved on before:  s_A += M xi,   var s_A += bent^2,   bent = NONLINEAR d (|M xi| + BENDS d),   var M += DRIFT^2 ((D + d)^2 - D^2) diag(c_v^2, c_w^2)
//! d = |xi_w| + |xi_v| c_v / c_w                    motion that changes M by about as much of itself
//! ```
//! `c_v`, `c_w` are the root mean square entries of M for translation and rotation, so that `c_w / c_v` is about the target's distance. It is a Kalman filter
//! of seven numbers a coordinate, with one covariance for both coordinates of a point: recursive least squares after Jagersand et al. (1997) and Piepmeier and Lipkin (2003), with
//! a forgetting that goes by the arm's motion instead of by time. During a motion that comes back to where it began the anchor is held, and `bent` is noise of the measurement.
//!
//! The law minimizes the expected square of the error that a displacement leaves, `|e - M xi|^2 + xi^T (2 P_M) xi` summed over the points: what is uncertain of M
//! damps the directions in which it is uncertain.

use super::{FeatureKind, SetPoint, TwistTask};
use crate::geometry::Pose;
use crate::messages::MAX_FEATURES;
use nalgebra::{Matrix2x6, Matrix6, SMatrix, SVector, Vector2, Vector3, Vector6};

/// Standard deviation of an entry of M before anything is known, normalized per m or rad: a target at a tenth of a metre moves by 10 per metre. Chosen by hand above
/// what any cell has; ten times as much changes nothing but digits.
const UNKNOWN: f64 = 20.0;
/// By how much of itself M changes with the motion d of about one radian, or of the target's distance. Derived: entries of the interaction matrix of a point are
/// `1/z`, `x/z`, `1 + x^2`, which change by 1 to 2 of themselves.
const DRIFT: f64 = 1.0;
/// Motion D over which the change of M keeps its direction, from where M was learnt. Chosen by hand: a tenth of a radian, so that the variance after one radian is a
/// fifth of its square.
const CORRELATED: f64 = 0.1;
/// Error of a prediction by M as a share of motion times displacement. Derived: the second-order term of the interaction matrix, half of [`DRIFT`].
const NONLINEAR: f64 = 0.5;
/// The same of a motion that moves the image little, because what its parts do to it is nearly opposite, normalized per radian. Chosen by hand.
const BENDS: f64 = 0.3;
/// Smallest standard deviation of a coordinate, as a share of the focal length: 0.02 px of a lens of 800 px, so that stated deviations that are too small do not
/// make the filter certain of what it cannot know.
const MIN_SD: f64 = 2.5e-5;
/// Standard deviation by which a point at rest may move from frame to frame, as a share of the focal length: a hundredth of a pixel of such a lens, so that the
/// estimated place follows what changes slowly. Chosen by hand: of a still view about five frames count.
const WANDERS: f64 = 1.25e-5;
/// Mean square of the innovations over their variance from which on a frame does not fit. Chosen by hand: five standard deviations of all points at once.
const GATE: f64 = 25.0;
/// After so many frames in a row that do not fit, the target has moved, or M is wrong: both become uncertain. Chosen by hand, as for a steady misfit of vision.
const MOVED_AFTER: u32 = 3;
/// Standard deviation that M then has, as a share of its own size. Chosen by hand: what a third of its size may be wrong leads to the goal all the same.
const DOUBT: f64 = 0.3;
/// Distance of the target that is assumed before M tells it, and its bounds, m. Chosen by hand: they hold every arm's work.
const DISTANCE_M: (f64, f64, f64) = (0.5, 0.05, 10.0);

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;

/// One point: `[s_A, M]` of both coordinates, and the covariance that they share.
#[derive(Debug, Clone, Copy)]
struct PointEstimate {
    s: Vector2<f64>,
    M: Matrix2x6<f64>,
    P: Matrix7,
    /// Whether it has been seen.
    seen: bool,
}

impl PointEstimate {
    fn unknown() -> Self {
        let mut P = Matrix7::identity() * (UNKNOWN * UNKNOWN);
        P[(0, 0)] = 0.0;
        Self { s: Vector2::zeros(), M: Matrix2x6::zeros(), P, seen: false }
    }

    /// Covariance of a row of M.
    fn P_M(&self) -> Matrix6<f64> {
        self.P.fixed_view::<6, 6>(1, 1).into_owned()
    }
}

/// What the estimator made of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// Mean square of the innovations over their variance; 1 in the mean where the estimate's covariance is right. Zero without one.
    pub normalized: f64,
    /// Whether the frame was taken: it was not where it does not fit.
    pub taken: bool,
}

/// The estimate of all points.
#[derive(Debug, Clone)]
pub struct JacobianEstimator {
    points: Vec<PointEstimate>,
    anchor: Option<Pose>,
    /// Whether the anchor stays where it is: during a motion that comes back to it.
    is_held: bool,
    misfits: u32,
    /// Motion d since the anchor was released.
    travelled: f64,
}

impl JacobianEstimator {
    /// An estimator of `count` points of which nothing is known. Memory is taken here, and not later.
    #[must_use]
    pub fn new(count: usize) -> Self {
        let points = vec![PointEstimate::unknown(); count.min(MAX_FEATURES)];
        Self { points, anchor: None, is_held: false, misfits: 0, travelled: 0.0 }
    }

    /// Forgets everything.
    pub fn forget(&mut self) {
        self.points.iter_mut().for_each(|point| *point = PointEstimate::unknown());
        (self.anchor, self.is_held, self.misfits, self.travelled) = (None, false, 0, 0.0);
    }

    /// Holds the anchor where it is, for a motion about it; it is set by the next frame where there is none. With `doubt` what is known counts less.
    pub fn hold_anchor(&mut self, doubt: bool) {
        self.is_held = true;
        if doubt {
            self.add_doubt(DOUBT * DOUBT);
        }
    }

    /// The anchor follows the camera again.
    pub fn release_anchor(&mut self) {
        (self.is_held, self.travelled) = (false, 0.0);
    }

    /// Takes in the places of points (index, normalized coordinates, standard deviation) at an exposure with the camera at `X_WC`.
    pub fn observe(
        &mut self,
        seen: impl Iterator<Item = (usize, Vector2<f64>, f64)> + Clone,
        X_WC: &Pose,
    ) -> Innovation {
        let anchor = *self.anchor.get_or_insert(*X_WC);
        let mut xi = displacement(&anchor, X_WC);
        let mut d = self.motion(&xi);
        if !self.is_held {
            self.move_anchor(&xi, d);
            (self.anchor, xi, d) = (Some(*X_WC), Vector6::zeros(), 0.0);
        }
        let h = Vector7::from_fn(|i, _| if i == 0 { 1.0 } else { xi[i - 1] });
        let variance = |point: &PointEstimate, sd: f64| {
            let bent = NONLINEAR * d * ((point.M * xi).norm() + BENDS * d);
            sd.max(MIN_SD).powi(2) + bent * bent
        };
        let (mut sum, mut count) = (0.0, 0.0);
        for (i, z, sd) in seen.clone() {
            let Some(point) = self.points.get(i).filter(|point| point.seen) else { continue };
            let S = h.dot(&(point.P * h)) + variance(point, sd);
            sum += (z - point.s - point.M * xi).norm_squared() / S;
            count += 2.0;
        }
        let normalized = if count > 0.0 { sum / count } else { 0.0 };
        if !(normalized <= GATE) {
            self.misfits += 1;
            if self.misfits < MOVED_AFTER {
                return Innovation { normalized, taken: false };
            }
            // The points are where they are seen now, and M is less certain.
            self.points.iter_mut().for_each(|point| point.seen = false);
            self.anchor = Some(*X_WC);
            self.add_doubt(DOUBT * DOUBT);
            return Innovation { taken: self.observe(seen, X_WC).taken, normalized };
        }
        self.misfits = 0;
        for (i, z, sd) in seen {
            let Some(point) = self.points.get_mut(i) else { continue };
            let R = variance(point, sd);
            if !point.seen {
                // `s_A = z - M xi`, with what is uncertain of M
                (point.seen, point.s) = (true, z - point.M * xi);
                let P_M = point.P_M();
                let across = -P_M * xi;
                point.P.fixed_view_mut::<6, 1>(1, 0).copy_from(&across);
                point.P.fixed_view_mut::<1, 6>(0, 1).copy_from(&across.transpose());
                point.P[(0, 0)] = R + xi.dot(&(P_M * xi));
                continue;
            }
            let Ph = point.P * h;
            let S = h.dot(&Ph) + R;
            let gain = Ph / S;
            let nu = z - point.s - point.M * xi;
            point.s += nu * gain[0];
            point.M += nu * gain.fixed_rows::<6>(1).transpose();
            // (1 - K h') P (1 - K h')' + K R K' keeps the covariance positive whatever rounding does.
            let A = Matrix7::identity() - gain * h.transpose();
            point.P = A * point.P * A.transpose() + gain * gain.transpose() * R;
        }
        Innovation { normalized, taken: true }
    }

    /// Moves the anchor on by the displacement `xi`.
    fn move_anchor(&mut self, xi: &Vector6<f64>, d: f64) {
        let mut F = Matrix7::identity();
        F.fixed_view_mut::<1, 6>(0, 1).copy_from(&xi.transpose());
        for point in &mut self.points {
            let bent = NONLINEAR * d * ((point.M * xi).norm() + BENDS * d);
            point.s += point.M * xi;
            point.P = F * point.P * F.transpose();
            point.P[(0, 0)] += bent * bent + WANDERS * WANDERS;
        }
        self.add_doubt(DRIFT * DRIFT * (d * d + 2.0 * d * self.travelled.min(CORRELATED)));
        self.travelled += d;
    }

    /// Adds a variance to M, as a `share2` of the mean square of its entries.
    fn add_doubt(&mut self, share2: f64) {
        let (c_v, c_w) = self.sizes();
        for point in &mut self.points {
            for i in 1..7 {
                let c = if i < 4 { c_v } else { c_w };
                // what is unknown stays so
                let room = (UNKNOWN * UNKNOWN - point.P[(i, i)]).max(0.0);
                point.P[(i, i)] += (share2 * c * c).min(room);
            }
        }
    }

    /// Root mean square entries of M for translation and for rotation.
    fn sizes(&self) -> (f64, f64) {
        let (mut sums, mut count) = ((0.0, 0.0), 0.0);
        for point in self.points.iter().filter(|point| point.seen) {
            sums.0 += point.M.fixed_view::<2, 3>(0, 0).norm_squared();
            sums.1 += point.M.fixed_view::<2, 3>(0, 3).norm_squared();
            count += 6.0;
        }
        if count > 0.0 { (f64::sqrt(sums.0 / count), f64::sqrt(sums.1 / count)) } else { (0.0, 0.0) }
    }

    /// The motion d of a displacement or twist: rad, or shares of the target's distance.
    #[must_use]
    pub fn motion(&self, xi: &Vector6<f64>) -> f64 {
        let (c_v, c_w) = self.sizes();
        let (assumed_m, nearest_m, farthest_m) = DISTANCE_M;
        let known = c_v > 0.0 && c_w > 0.0;
        let distance_m = if known { (c_w / c_v).clamp(nearest_m, farthest_m) } else { assumed_m };
        xi.fixed_rows::<3>(3).norm() + xi.fixed_rows::<3>(0).norm() / distance_m
    }

    /// Where point `i` is seen from a camera at `X_WC`, normalized; `None` where it has not been seen.
    #[must_use]
    pub fn predicted(&self, i: usize, X_WC: &Pose) -> Option<Vector2<f64>> {
        let (point, anchor) = (self.points.get(i).filter(|point| point.seen)?, self.anchor.as_ref()?);
        Some(point.s + point.M * displacement(anchor, X_WC))
    }

    /// The rows M of point `i`, normalized per m and rad; `None` where it has not been seen.
    #[must_use]
    pub fn rows(&self, i: usize) -> Option<&Matrix2x6<f64>> {
        self.points.get(i).filter(|point| point.seen).map(|point| &point.M)
    }

    /// Covariance of each of the two rows M of point `i`.
    #[must_use]
    pub fn covariance(&self, i: usize) -> Option<Matrix6<f64>> {
        self.points.get(i).filter(|point| point.seen).map(PointEstimate::P_M)
    }

    /// The task of the points that `set_point` selects, for a camera at `X_WC`: normal equations `sum (M^T M + 2 P_M)` and `sum M^T e`, and beside them
    /// `sum M^T M` alone. `None` before a point was seen.
    #[must_use]
    pub fn task(&self, set_point: &SetPoint, X_WC: &Pose) -> Option<CautiousTask> {
        let anchor = self.anchor.as_ref()?;
        let xi = displacement(anchor, X_WC);
        let (mut certain, mut doubt) = (Matrix6::zeros(), Matrix6::zeros());
        let (mut vector, mut error2, mut weighted2) = (Vector6::zeros(), 0.0, 0.0);
        for &(kind, weight) in set_point.selection().features() {
            let FeatureKind::Point(i) = kind else { continue };
            let (Some(point), Some(s_d)) = (self.points.get(i), set_point.features().get(i)) else {
                continue;
            };
            if !point.seen {
                continue;
            }
            let e = s_d - point.s - point.M * xi;
            certain += point.M.tr_mul(&point.M) * weight;
            doubt += point.P_M() * (2.0 * weight);
            vector += point.M.tr_mul(&e) * weight;
            error2 += e.norm_squared();
            weighted2 += e.norm_squared() * weight;
        }
        (error2.is_finite() && certain.trace() > 0.0).then(|| CautiousTask {
            task: TwistTask { matrix: certain + doubt, vector, error: error2.sqrt() },
            certain,
            weighted2,
        })
    }
}

/// A task with the damping that the uncertainty of M calls for.
#[derive(Debug, Clone, Copy)]
pub struct CautiousTask {
    /// Damped normal equations.
    pub task: TwistTask,
    /// Their matrix without damping.
    pub certain: Matrix6<f64>,
    /// Weighted square of the error.
    pub weighted2: f64,
}

impl CautiousTask {
    /// Share of the error that the displacement `xi` leaves, root mean square: `|e - M xi| / |e|`. 1 where nothing is gained, 0 where all is met.
    #[must_use]
    pub fn share_left(&self, xi: &Vector6<f64>) -> f64 {
        let left2 = self.weighted2 - 2.0 * self.task.vector.dot(xi) + xi.dot(&(self.certain * xi));
        (left2.max(0.0) / self.weighted2).sqrt()
    }
}

/// The displacement `[v; w]` of the camera from `X_WA` to `X_WC`, as the constant twist that makes it in unit time, expressed in A: m and rad.
fn displacement(X_WA: &Pose, X_WC: &Pose) -> Vector6<f64> {
    let X_AC = X_WA.inv_mul(X_WC);
    let (p, w) = (X_AC.translation.vector, X_AC.rotation.scaled_axis());
    // Inverse of the integral of the rotation, to the second order of a small one.
    let v: Vector3<f64> = p - w.cross(&p) * 0.5 + w.cross(&w.cross(&p)) / 12.0;
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

#[cfg(test)]
mod tests;
