//! The least-squares problem: thirteen unknowns, by Gauss-Newton on all residuals in pixels.
//!
//! ```text
//! tau, xi_O, xi_C:   X_WO exp(xi_O),   X_EC exp(xi_C)  (or X_BC, beside the arm)
//! ds/dtau = L_s J qd,   ds/dxi_C = L_s  (10.27),   ds/dxi_O: (10.21) with the twist expressed in O
//! ```
//! The camera's own pose is held near that of the run file by a prior of 20 mm and 3 degrees, because not every arm's motion
//! shows all of it. Without this freedom an error of the hand-eye pose would not move the offset much, but make it look
//! uncertain. Huber's weights make outliers count less, because some frames are always off.
//!
//! The standard deviation takes each frame as one draw (the sandwich of `H^-1` and the frames' gradients), because an
//! error of a stamp moves all points of its frame together; it is at least the one that takes each point as a draw,
//! because a sandwich of few frames is thin.

use super::KnownCell;
use crate::calibration::{Recording, TargetDetection};
use crate::features::{point_image_jacobian, point_rows};
use crate::geometry::{Pose, Twist, integrate_body_twist};
use crate::linalg::Ldlt;
use crate::robot::Mount;
use nalgebra::{Point3, SMatrix, SVector, Vector2, Vector3};

/// Residuals beyond so many standard deviations count less.
const HUBER: f64 = 2.0;
/// Prior standard deviations of the camera's pose in the run file, m and rad. Chosen by hand: measured with a ruler, 20 mm and 3 degrees.
const PRIOR_SD: [f64; 6] = [0.02, 0.02, 0.02, 0.05, 0.05, 0.05];
/// Lower bound of vision's standard deviations, px. Chosen by hand: a smaller one would let a few points dominate the weighted fit.
const MIN_SD_PX: f64 = 0.01;
/// Median of the length of two unit normal residuals, that of the Rayleigh distribution: sqrt(2 ln 2), since their square is chi-square.
const RAYLEIGH_MEDIAN: f64 = 1.1774;
/// A step halved so often is 1 / 4096 of what was asked for: what is still no better is rounding, or a model that is wrong there.
const MAX_HALVINGS: u32 = 12;
/// The last step: s, and rad or m. A hundredth of a microsecond must be less than any stamp tells.
const LAST_STEP: f64 = 1e-8;
/// A step that makes nothing better although it is so short is one of rounding.
const ROUNDING_STEP: f64 = 1e-6;

/// tau, the twist of O, and that of C: 1 + 6 + 6 follows.
const UNKNOWNS: usize = 13;
type Unknowns = SVector<f64, UNKNOWNS>;
type Hessian = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Values of the unknowns.
#[derive(Debug, Clone, Copy)]
pub(super) struct LatencyUnknowns {
    pub(super) tau_s: f64,
    X_WO: Pose,
    /// Twist from the camera's pose in the run file to the true one, expressed in C.
    xi_C: Twist,
}

impl LatencyUnknowns {
    pub(super) fn with_offset(&self, tau_s: f64) -> Self {
        Self { tau_s, ..*self }
    }

    fn moved(&self, step: &Unknowns, share: f64) -> Self {
        let (xi_O, xi_C): (Twist, Twist) = (step.fixed_rows::<6>(1).into(), step.fixed_rows::<6>(7).into());
        Self {
            tau_s: self.tau_s + share * step[0],
            X_WO: integrate_body_twist(&self.X_WO, &xi_O, share),
            xi_C: self.xi_C + xi_C * share,
        }
    }

    fn mount(&self, mount: &Mount) -> Mount {
        mount.with_pose(integrate_body_twist(mount.pose(), &self.xi_C, 1.0))
    }
}

/// Which unknowns may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Free {
    /// All.
    All,
    /// All but tau.
    Poses,
}

/// Where a descent came to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Descent {
    pub(super) state: LatencyUnknowns,
    pub(super) converged: bool,
}

/// A residual in standard deviations of its point, with its derivatives.
struct PointResidual {
    r: Vector2<f64>,
    J: SMatrix<f64, 2, UNKNOWNS>,
    /// What one is in px.
    sd_px: f64,
}

/// The problem.
#[derive(Clone, Copy)]
pub(super) struct LatencyProblem<'a, const N: usize> {
    cell: &'a KnownCell<'a, N>,
    recording: &'a Recording<N>,
    /// Takes every n-th frame.
    stride: usize,
}

impl<'a, const N: usize> LatencyProblem<'a, N> {
    pub(super) fn new(cell: &'a KnownCell<'a, N>, recording: &'a Recording<N>) -> Self {
        Self { cell, recording, stride: 1 }
    }

    /// The same with about `frames` frames at most.
    pub(super) fn thinned(self, frames: usize) -> Self {
        Self { stride: self.frames().div_ceil(frames).max(1), ..self }
    }

    /// How many frames show the whole target.
    pub(super) fn frames(&self) -> usize {
        self.observations().count()
    }

    fn observations(&self) -> impl Iterator<Item = &TargetDetection> {
        let points = self.cell.points.len();
        self.recording.observations.iter().filter(move |s| s.points().len() == points).step_by(self.stride)
    }

    /// Root mean square motion of the points about their mean places, px.
    pub(super) fn motion_px(&self) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for j in 0..self.cell.points.len() {
            let px = |s: &TargetDetection| Some(s.points().get(j)?.s.component_mul(&self.cell.f_px));
            let frames = self.frames() as f64;
            let mean = self.observations().filter_map(px).sum::<Vector2<f64>>() / frames;
            sum += self.observations().filter_map(px).map(|p| (p - mean).norm_squared()).sum::<f64>();
            count += frames;
        }
        (sum / count).sqrt()
    }

    /// The pose that the first frame with one tells, the arm still at rest: whatever its stamp says.
    pub(super) fn first_guess(&self) -> Option<LatencyUnknowns> {
        let (stamp, X_CO) = self.observations().find_map(|s| Some((s.stamp, s.X_CO?)))?;
        let (q, _) = self.recording.track.at(stamp, 0.0)?;
        let X_WO = self.cell.mount.X_WC(self.cell.robot, &q) * X_CO;
        Some(LatencyUnknowns { tau_s: 0.0, X_WO, xi_C: Twist::zeros() })
    }

    /// The residuals of one frame; none of a point that would lie behind the camera.
    fn residuals(
        &self,
        observation: &TargetDetection,
        at: &LatencyUnknowns,
        mut each: impl FnMut(&PointResidual),
    ) {
        let KnownCell { robot, mount, f_px, points } = self.cell;
        let Some((q, qd)) = self.recording.track.at(observation.stamp, at.tau_s) else { return };
        let (X_WC, J_C) = at.mount(mount).camera(robot, &q);
        let V_WC_C: Twist = J_C.matrix() * qd;
        let X_CO = X_WC.inv_mul(&at.X_WO);
        let R_CO = X_CO.rotation.to_rotation_matrix();
        for (p_O, seen) in points.iter().zip(observation.points()) {
            let p_C: Point3<f64> = X_CO * p_O;
            if !(p_C.z > 0.0) {
                continue;
            }
            let s = p_C.coords.xy() / p_C.z;
            let r_o_C: Vector3<f64> = R_CO * p_O.coords;
            let (L_s, J_O) = (point_rows(&s, p_C.z), point_image_jacobian(&s, p_C.z, &r_o_C));
            let sd_px = if seen.sd_px > 0.0 { seen.sd_px.max(MIN_SD_PX) } else { 1.0 };
            let scale = f_px / sd_px;
            let mut J = SMatrix::<f64, 2, UNKNOWNS>::zeros();
            J.set_column(0, &(L_s * V_WC_C));
            // The object's twist is expressed in O.
            J.fixed_columns_mut::<3>(1).copy_from(&(J_O.fixed_columns::<3>(0) * R_CO.matrix()));
            J.fixed_columns_mut::<3>(4).copy_from(&(J_O.fixed_columns::<3>(3) * R_CO.matrix()));
            J.fixed_columns_mut::<6>(7).copy_from(&L_s);
            for mut column in J.column_iter_mut() {
                column.component_mul_assign(&scale);
            }
            each(&PointResidual { r: (s - seen.s).component_mul(&scale), J, sd_px });
        }
    }

    fn each_residual(&self, at: &LatencyUnknowns, mut each: impl FnMut(&PointResidual)) {
        self.observations().for_each(|observation| self.residuals(observation, at, &mut each));
    }

    /// Standard deviation of the residuals, from their median: outliers do not move it.
    fn spread(&self, at: &LatencyUnknowns) -> f64 {
        let mut lengths = Vec::with_capacity(self.frames() * self.cell.points.len());
        self.each_residual(at, |e| lengths.push(e.r.norm()));
        if lengths.is_empty() {
            return f64::NAN;
        }
        let middle = lengths.len() / 2;
        let (_, median, _) = lengths.select_nth_unstable_by(middle, f64::total_cmp);
        (*median / RAYLEIGH_MEDIAN).max(f64::MIN_POSITIVE)
    }

    /// Huber's cost, for residuals of standard deviation `spread`, and that of the prior.
    fn cost(&self, at: &LatencyUnknowns, spread: f64) -> f64 {
        let (mut sum, knee) = (0.0, HUBER * spread);
        self.each_residual(at, |e| {
            let r = e.r.norm();
            sum += if r <= knee { 0.5 * r * r } else { knee * (r - 0.5 * knee) };
        });
        let prior = at.xi_C.component_div(&Twist::from(PRIOR_SD)).norm_squared();
        sum + 0.5 * spread * spread * prior
    }

    /// Normal equations `H step = -g` at `at`, with Huber's weights.
    fn normal_equations(&self, at: &LatencyUnknowns, spread: f64) -> (Hessian, Unknowns) {
        let mut H = Self::prior(spread);
        let mut g = Unknowns::zeros();
        g.fixed_rows_mut::<6>(7).copy_from(&(H.fixed_view::<6, 6>(7, 7) * at.xi_C));
        self.each_residual(at, |e| {
            let weight = huber_weight(e, spread);
            H += e.J.transpose() * e.J * weight;
            g += e.J.transpose() * e.r * weight;
        });
        (H, g)
    }

    /// What the prior adds to the normal equations.
    fn prior(spread: f64) -> Hessian {
        let mut H = Hessian::zeros();
        for (i, sd) in PRIOR_SD.iter().enumerate() {
            H[(7 + i, 7 + i)] = (spread / sd).powi(2);
        }
        H
    }

    /// Down from `start`, by at most so many steps.
    pub(super) fn descend(&self, start: LatencyUnknowns, free: Free, iterations: u32) -> Descent {
        let mut state = start;
        for _ in 0..iterations {
            let spread = self.spread(&state);
            let (mut H, mut g) = self.normal_equations(&state, spread);
            if free == Free::Poses {
                H.row_mut(0).fill(0.0);
                H.column_mut(0).fill(0.0);
                (H[(0, 0)], g[0]) = (1.0, 0.0);
            }
            let Some(inverse) = inverse(&H) else { break };
            let step = inverse * -g;
            let before = self.cost(&state, spread);
            let (mut share, mut halvings) = (1.0, 0);
            while !(self.cost(&state.moved(&step, share), spread) <= before) && halvings < MAX_HALVINGS {
                share *= 0.5;
                halvings += 1;
            }
            if halvings == MAX_HALVINGS {
                return Descent { state, converged: step.amax() < ROUNDING_STEP };
            }
            state = state.moved(&step, share);
            if step.amax() * share < LAST_STEP {
                return Descent { state, converged: true };
            }
        }
        Descent { state, converged: false }
    }

    /// Sum of the residuals' lengths: comparable between states without a common spread, and robust against outliers.
    pub(super) fn sum_of_lengths(&self, at: &LatencyUnknowns) -> f64 {
        let mut sum = 0.0;
        self.each_residual(at, |e| sum += e.r.norm());
        sum
    }

    /// Root mean square distance of the points from where they should be, px.
    pub(super) fn rms_px(&self, at: &LatencyUnknowns) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        self.each_residual(at, |e| {
            sum += e.r.norm_squared() * e.sd_px * e.sd_px;
            count += 1.0;
        });
        (sum / count).sqrt()
    }

    /// Standard deviation of tau, s; infinite where nothing fixes it. The larger one of two: frames, or points as draws.
    pub(super) fn sd_s(&self, at: &LatencyUnknowns) -> f64 {
        let spread = self.spread(at);
        // The second derivative of Huber's cost: beyond the knee a residual pulls with constant strength. The weights of the
        // descent would make everything look a little more certain.
        let mut H = Self::prior(spread);
        self.each_residual(at, |e| {
            let weight = huber_weight(e, spread);
            let along = if weight < 1.0 { e.r.normalize() } else { Vector2::zeros() };
            let across = e.J - along * (along.transpose() * e.J);
            H += across.transpose() * across * weight;
        });
        let Some(inverse) = inverse(&H) else { return f64::INFINITY };
        let (mut by_frames, mut frames) = (0.0, 0.0);
        let (mut squares, mut numbers) = (0.0, 0.0);
        for observation in self.observations() {
            let mut g = Unknowns::zeros();
            self.residuals(observation, at, |e| {
                g += e.J.transpose() * e.r * huber_weight(e, spread);
                squares += e.r.norm_squared() * huber_weight(e, spread).powi(2);
                numbers += 2.0;
            });
            by_frames += (inverse.row(0) * g).x.powi(2);
            frames += 1.0;
        }
        let free = numbers - UNKNOWNS as f64;
        let by_frames = by_frames * numbers / free * frames / (frames - 1.0);
        let by_points = inverse[(0, 0)] * squares / free;
        by_frames.max(by_points).sqrt()
    }
}

fn huber_weight(e: &PointResidual, spread: f64) -> f64 {
    (HUBER * spread / e.r.norm().max(f64::MIN_POSITIVE)).min(1.0)
}

/// The inverse of a positive definite matrix.
fn inverse(H: &Hessian) -> Option<Hessian> {
    Some(Ldlt::of(H)?.inverse().into())
}
