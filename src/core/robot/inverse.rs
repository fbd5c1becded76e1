//! From a wanted twist to joint velocities by damped least squares, inside the joints' limits.
//!
//! `qd = qd_p + argmin |V - J qd|^2 + lambda^2 |qd - qd_p|^2`, where `qd_p` is a preferred velocity. It acts only on motions that
//! the twist does not determine. The damping rises as the arm nears a singular posture, by
//! `s = tr((J J^T)^-1)^(-1/2)`, which lies between the least singular value over sqrt(6) and that value, and costs
//! one small factorisation: `lambda^2 = lambda_max^2 (1 - (s/s_0)^2)` for `s < s_0`, else zero.

use super::model::Robot;
use crate::geometry::Twist;
use crate::linalg::Ldlt;
use nalgebra::{Matrix6, SMatrix, SVector};

/// How [`Robot::damped_velocity`] treats singular postures and limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseOptions {
    /// Damping starts where the measure `s` of the least singular value falls below this (m and rad mixed).
    pub singular_below: f64,
    /// The damping in a singular posture, in the units of `s`.
    pub damping_max: f64,
    /// No joint may be on course to reach its limit sooner than this, s: it slows down ahead of the limit.
    pub limit_horizon_s: f64,
}

impl Default for InverseOptions {
    /// Both 0.05, so that a singular direction answers with about `s / s_0^2`: no more than the `1 / s_0` = 20 at which the damping begins,
    /// and steadily less down to nothing in the singular posture.
    fn default() -> Self {
        Self { singular_below: 0.05, damping_max: 0.05, limit_horizon_s: 0.1 }
    }
}

/// The outcome of [`Robot::damped_velocity`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointVelocity<const N: usize> {
    /// The joint velocities, rad/s or m/s; inside the velocity limits and leading into no position limit.
    pub qd: SVector<f64, N>,
    /// The measure `s` of the least singular value over the joints that were free.
    pub min_singular_value: f64,
    /// The damping `lambda` that was used; zero away from singular postures.
    pub damping: f64,
    /// Joints that a position limit holds back.
    pub at_limit: [bool; N],
    /// The common factor (0 to 1] that brought the fastest joint to its velocity limit.
    pub scale: f64,
}

impl<const N: usize> Robot<N> {
    /// Joint velocities for the wanted twist `V` at the posture `q`, given the Jacobian `J` in the twist's frame.
    ///
    /// A joint that would run into its position limit is held at the speed that it may still have, and the others take over as far as
    /// they can. Velocity limits scale all joints alike, so that the path is kept and only the speed falls. Input that is
    /// not finite gives zero velocity and a `scale` of zero.
    #[must_use]
    pub fn damped_velocity(
        &self,
        q: &SVector<f64, N>,
        J: &SMatrix<f64, 6, N>,
        V: &Twist,
        preferred_qd: &SVector<f64, N>,
        options: &InverseOptions,
    ) -> JointVelocity<N> {
        let mut at_limit = [false; N];
        let mut held = SVector::<f64, N>::zeros();
        let mut solution = free_velocity(J, V, preferred_qd, &held, &at_limit, options);
        // Each round holds one more joint, so N rounds are enough.
        for _ in 0..N {
            let Some((joint, bound)) = self.worst_breach(q, &solution.0, &at_limit, options) else { break };
            at_limit[joint] = true;
            held[joint] = bound;
            solution = free_velocity(J, V, preferred_qd, &held, &at_limit, options);
        }
        let (mut qd, min_singular_value, damping) = solution;
        let mut scale: f64 = 1.0;
        for (qd, limit) in qd.iter().zip(&self.limits) {
            if qd.abs() > limit.velocity {
                scale = scale.min(limit.velocity / qd.abs());
            }
        }
        qd *= scale;
        let finite = |values: &[f64]| values.iter().all(|x| x.is_finite());
        let inputs = [q.as_slice(), J.as_slice(), V.as_slice(), preferred_qd.as_slice()];
        if !(inputs.into_iter().all(finite) && finite(qd.as_slice())) {
            (qd, scale) = (SVector::zeros(), 0.0);
        }
        JointVelocity { qd, min_singular_value, damping, at_limit, scale }
    }

    /// The free joint that exceeds the speed allowed by its position limit the most, and that speed.
    fn worst_breach(
        &self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        at_limit: &[bool; N],
        options: &InverseOptions,
    ) -> Option<(usize, f64)> {
        let mut worst: Option<(usize, f64, f64)> = None;
        for i in (0..N).filter(|&i| !at_limit[i]) {
            let limit = &self.limits[i];
            // Outside the limits already: no farther out; coming back is free.
            let least = ((limit.lower - q[i]) / options.limit_horizon_s).min(0.0);
            let most = ((limit.upper - q[i]) / options.limit_horizon_s).max(0.0);
            let bound = qd[i].max(least).min(most);
            let breach = (qd[i] - bound).abs();
            // A relative margin, or a joint held at its bound would be found again by rounding.
            if breach > 1e-12 * bound.abs() && worst.is_none_or(|(_, _, other)| breach > other) {
                worst = Some((i, bound, breach));
            }
        }
        worst.map(|(i, bound, _)| (i, bound))
    }
}

/// Damped least squares over the joints that are not held: velocities, measure `s`, damping.
fn free_velocity<const N: usize>(
    J: &SMatrix<f64, 6, N>,
    V: &Twist,
    preferred_qd: &SVector<f64, N>,
    held: &SVector<f64, N>,
    is_held: &[bool; N],
    options: &InverseOptions,
) -> (SVector<f64, N>, f64, f64) {
    let mut start = *preferred_qd;
    let mut J_free = *J;
    for i in 0..N {
        if is_held[i] {
            start[i] = held[i];
            J_free.column_mut(i).fill(0.0);
        }
    }
    let rest = V - J * start;
    // A joint beyond the camera, whose column is zero, does nothing for the twist: it goes by its preferred velocity.
    let idle: [bool; N] = std::array::from_fn(|i| J_free.column(i).iter().all(|x| *x == 0.0));
    let free = idle.iter().filter(|&&idle| !idle).count();
    let (step, s, damping) = if free < 6 {
        // Fewer joints than directions: the normal matrix over the joints has full rank; ones stand in for the idle.
        let mut G = J_free.transpose() * J_free;
        for i in 0..N {
            if idle[i] {
                G[(i, i)] = 1.0;
            }
        }
        let (step, s, damping) = damped_solve(&G, &(J_free.transpose() * rest), N - free, options);
        (step, s, damping)
    } else {
        let G: Matrix6<f64> = J_free * J_free.transpose();
        let (y, s, damping) = damped_solve(&G, &rest, 0, options);
        (J_free.transpose() * y, s, damping)
    };
    let mut qd = start + step;
    for i in 0..N {
        if is_held[i] {
            qd[i] = held[i];
        }
    }
    (qd, s, damping)
}

/// Solves `(G + lambda^2 1) x = b`; `ones` entries of the diagonal are placeholders and do not count in `s`.
fn damped_solve<const M: usize>(
    G: &SMatrix<f64, M, M>,
    b: &SVector<f64, M>,
    ones: usize,
    options: &InverseOptions,
) -> (SVector<f64, M>, f64, f64) {
    let factors = Ldlt::of(G);
    let trace = factors.as_ref().map_or(f64::INFINITY, Ldlt::inverse_trace) - ones as f64;
    let s = if trace > 0.0 { trace.sqrt().recip() } else { f64::INFINITY };
    let ratio = s / options.singular_below;
    if ratio >= 1.0
        && let Some(factors) = factors
    {
        return (factors.solve(&(*b).into()).into(), s, 0.0);
    }
    let damping2 = options.damping_max * options.damping_max * (1.0 - ratio * ratio).max(0.0);
    // With no damping allowed in a singular posture there is no answer: stand still.
    let damped = Ldlt::new(&G.data.0, &[damping2; M]);
    let x = damped.map_or_else(SVector::zeros, |factors| factors.solve(&(*b).into()).into());
    (x, s, damping2.sqrt())
}
