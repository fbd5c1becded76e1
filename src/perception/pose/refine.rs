//! Least squares on the reprojection error (10.36), Gauss-Newton with Levenberg's damping when a step fails.
//!
//! The unknown is the twist `[v; w]` of the object's centroid relative to the camera, expressed in C, so that
//! the Jacobian is the image Jacobian (10.21) of a point with `r_o_C = R_CO r`. Units: m, rad, normalized image.

use super::points::{centroid, check};
use super::{Correspondence, Correspondence3, PointSource, PoseError};
use crate::features::PointRows;
use crate::geometry::{Pose, skew};
use crate::linalg::{F2, Lanes, Ldlt};
use nalgebra::{Matrix3, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Steps (rad, and relative to the distance) below 1e-7 are the last: convergence is quadratic or nearly so, so that what is left is rounding.
/// Half and twice of it change no unit test, nor do those of [`LAST_GAIN`].
const LAST_STEP_SQUARED: f64 = 1e-14;
/// A step that promises less than this part of the cost is the last: gain over cost is the square of the step in standard deviations of the
/// pose, over the degrees of freedom, so that it moves the pose by about 1e-6 of its standard deviation.
const LAST_GAIN: f64 = 1e-12;
/// So that a start from which nothing converges ends; on exact points the tests see less than 12.
const MAX_ITERATIONS: u32 = 100;

/// A pose at the minimum of the reprojection error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedPose {
    /// Pose of the object in the camera.
    pub X_CO: Pose,
    /// Root mean square over the points of the reprojection error, normalized units.
    pub rms: f64,
    /// Covariance of the twist `[v; w]` of O relative to C, expressed in C (m, rad).
    pub covariance: Matrix6<f64>,
    /// Gauss-Newton steps taken.
    pub iterations: u32,
}

/// The pose of least reprojection error near `X_CO`, for planar points.
///
/// `sd`: standard deviation of each image coordinate, normalized units; it scales the covariance only.
/// At least three points, not collinear.
///
/// # Errors
/// Every variant of [`PoseError`]: too few points, numbers that are not finite, a degenerate set, points behind the
/// camera at the start, or no convergence within 100 steps.
pub fn refine(X_CO: &Pose, points: &[Correspondence], sd: f64) -> Result<RefinedPose, PoseError> {
    refine_points(X_CO, points, sd)
}

/// The pose of least reprojection error near `X_CO`, for points in space; otherwise as [`refine`].
///
/// # Errors
/// As [`refine`].
pub fn refine_3d(X_CO: &Pose, points: &[Correspondence3], sd: f64) -> Result<RefinedPose, PoseError> {
    refine_points(X_CO, points, sd)
}

fn refine_points<P: PointSource>(X_CO: &Pose, points: &[P], sd: f64) -> Result<RefinedPose, PoseError> {
    check(points, 3)?;
    if sd < 0.0 || !sd.is_finite() {
        return Err(PoseError::BadGuess);
    }
    let center = centroid(points);
    let start = PoseState::at(X_CO, &center).ok_or(PoseError::BadGuess)?;
    let end = minimise::<F2, P>(start, points, &center)?;
    if !end.converged {
        return Err(PoseError::NotConverged { iterations: end.iterations });
    }
    let inverse = Ldlt::new(&end.normal.matrix(), &[0.0; 6]).ok_or(PoseError::Degenerate)?.inverse();
    // From the centroid to O: v_O = v - S(d) w with d = p_O - p_centroid.
    let mut A = Matrix6::identity();
    let d = end.state.rotation() * Vector3::from(center) * -1.0;
    A.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&d));
    let covariance = A * Matrix6::from(inverse) * A.transpose() * (sd * sd);
    let covariance = (covariance + covariance.transpose()) * 0.5; // rounding leaves it not quite symmetric
    Ok(RefinedPose {
        X_CO: end.state.pose(&center),
        rms: end.normal.rms(points.len()),
        covariance,
        iterations: end.iterations,
    })
}

/// A pose as unit quaternion (w, x, y, z) and position of the object's centroid in C.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseState {
    q: [f64; 4],
    p: [f64; 3],
}

impl PoseState {
    /// `None` when the pose is not finite.
    #[inline(always)]
    pub(super) fn at(X_CO: &Pose, center: &[f64; 3]) -> Option<Self> {
        let q = X_CO.rotation.quaternion();
        let p = X_CO.translation.vector + X_CO.rotation * Vector3::from(*center);
        let state = Self { q: [q.w, q.i, q.j, q.k], p: [p.x, p.y, p.z] };
        state.q.iter().chain(&state.p).all(|x| x.is_finite()).then_some(state)
    }

    /// The pose of O.
    #[inline(always)]
    pub(super) fn pose(&self, center: &[f64; 3]) -> Pose {
        let [w, x, y, z] = self.q;
        let p = Vector3::from(self.p) - self.rotation() * Vector3::from(*center);
        Pose::from_parts(Translation3::from(p), UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)))
    }

    /// Depth of the centroid, m.
    pub(super) fn depth(&self) -> f64 {
        self.p[2]
    }

    /// Position of the centroid, m.
    pub(super) fn position(&self) -> Vector3<f64> {
        Vector3::from(self.p)
    }

    #[inline(always)]
    pub(super) fn rotation(&self) -> Matrix3<f64> {
        let [w, x, y, z] = self.q;
        let (x2, y2, z2) = (x + x, y + y, z + z);
        let (xx, yy, zz, xy, xz, yz) = (x * x2, y * y2, z * z2, x * y2, x * z2, y * z2);
        let (wx, wy, wz) = (w * x2, w * y2, w * z2);
        Matrix3::new(
            1.0 - yy - zz,
            xy - wz,
            xz + wy,
            xy + wz,
            1.0 - xx - zz,
            yz - wx,
            xz - wy,
            yz + wx,
            1.0 - xx - yy,
        )
    }

    /// The pose after the step `[v; w]`; to first order the exponential map, and always a rotation.
    #[inline(always)]
    pub(super) fn moved(&self, step: &[f64; 6]) -> Self {
        let [vx, vy, vz, wx, wy, wz] = *step;
        let (a, b, c) = (0.5 * wx, 0.5 * wy, 0.5 * wz);
        let [w, x, y, z] = self.q;
        let q = [
            w - a * x - b * y - c * z,
            x + a * w + b * z - c * y,
            y + b * w + c * x - a * z,
            z + c * w + a * y - b * x,
        ];
        let scale = 1.0 / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
        Self { q: q.map(|x| x * scale), p: [self.p[0] + vx, self.p[1] + vy, self.p[2] + vz] }
    }
}

/// `J^T J`, `J^T e` and `e^T e` at some pose. The entries that are zero or equal by structure are not stored.
#[derive(Debug, Clone, Copy)]
pub(super) struct Normal {
    aa: f64,
    /// Rows 0 and 1, columns 2..6.
    top: [[f64; 4]; 2],
    /// Lower triangle of rows and columns 2..6.
    low: [[f64; 4]; 4],
    gradient: [f64; 6],
    pub(super) cost: f64,
}

impl Normal {
    /// Root mean square error per point.
    #[inline(always)]
    pub(super) fn rms(&self, count: usize) -> f64 {
        (self.cost / count as f64).sqrt()
    }

    /// The lower triangle of `J^T J`, mirrored.
    #[inline(always)]
    fn matrix(&self) -> [[f64; 6]; 6] {
        let (a, t, l) = (self.aa, &self.top, &self.low);
        [
            [a, 0.0, t[0][0], t[0][1], t[0][2], t[0][3]],
            [0.0, a, t[1][0], t[1][1], t[1][2], t[1][3]],
            [t[0][0], t[1][0], l[0][0], l[1][0], l[2][0], l[3][0]],
            [t[0][1], t[1][1], l[1][0], l[1][1], l[2][1], l[3][1]],
            [t[0][2], t[1][2], l[2][0], l[2][1], l[2][2], l[3][2]],
            [t[0][3], t[1][3], l[3][0], l[3][1], l[3][2], l[3][3]],
        ]
    }

    /// Sums over all points, two at a time; `None` when some point is not in front of the camera.
    #[inline(always)]
    fn evaluate<L: Lanes, P: PointSource>(
        state: &PoseState,
        points: &[P],
        center: &[f64; 3],
    ) -> Option<Self> {
        let R = state.rotation();
        let rotation: [[L; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| L::splat(R[(i, j)])));
        let p = state.p.map(L::splat);
        let c = center.map(L::splat);
        let zero = L::splat(0.0);
        let (mut aa, mut cost) = (zero, zero);
        let (mut top, mut low, mut gradient) = ([[zero; 4]; 2], [[zero; 4]; 4], [zero; 6]);
        let mut in_front = true;
        let mut add = |a: &P, b: &P, weight: L| {
            let ([ax, ay, az], [bx, by, bz]) = (a.object(), b.object());
            let o = [L::new(ax, bx) - c[0], L::new(ay, by) - c[1], L::new(az, bz) - c[2]];
            let ([aX, aY], [bX, bY]) = (a.image(), b.image());
            let [x, y, z]: [L; 3] = std::array::from_fn(|i| {
                rotation[i][0] * o[0] + rotation[i][1] * o[1] + rotation[i][2] * o[2]
            });
            let depth = z + p[2];
            let [d0, d1] = depth.get();
            in_front &= d0 > 0.0 && d1 > 0.0;
            let inverse = L::splat(1.0) / depth;
            let (X, Y) = ((x + p[0]) * inverse, (y + p[1]) * inverse);
            let (ex, ey) = ((L::new(aX, bX) - X) * weight, (L::new(aY, bY) - Y) * weight);
            // All entries have the factor 1/z_c, which takes the weight along.
            let PointRows { d: a, x: jx, y: jy } =
                PointRows::image_jacobian([X, Y], inverse * weight, [x, y, z]);
            aa = aa + a * a;
            cost = cost + (ex * ex + ey * ey);
            gradient[0] = gradient[0] + a * ex;
            gradient[1] = gradient[1] + a * ey;
            for i in 0..4 {
                top[0][i] = top[0][i] + a * jx[i];
                top[1][i] = top[1][i] + a * jy[i];
                gradient[2 + i] = gradient[2 + i] + (jx[i] * ex + jy[i] * ey);
                for j in 0..=i {
                    low[i][j] = low[i][j] + (jx[i] * jx[j] + jy[i] * jy[j]);
                }
            }
        };
        let (pairs, rest) = points.as_chunks::<2>();
        for [a, b] in pairs {
            add(a, b, L::splat(1.0));
        }
        if let [last] = rest {
            add(last, last, L::new(1.0, 0.0));
        }
        let sum4 = |row: [L; 4]| row.map(L::sum);
        in_front.then(|| Self {
            aa: aa.sum(),
            top: top.map(sum4),
            low: low.map(sum4),
            gradient: gradient.map(L::sum),
            cost: cost.sum(),
        })
    }
}

/// Where a minimisation ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    pub(super) state: PoseState,
    pub(super) normal: Normal,
    pub(super) iterations: u32,
    pub(super) converged: bool,
}

/// Gauss-Newton steps from `start` until one is tiny; damped by Levenberg and Marquardt's rule when one fails.
#[inline(always)]
pub(super) fn minimise<L: Lanes, P: PointSource>(
    start: PoseState,
    points: &[P],
    center: &[f64; 3],
) -> Result<Minimum, PoseError> {
    let mut state = start;
    let mut normal = Normal::evaluate::<L, P>(&state, points, center).ok_or(PoseError::BehindCamera)?;
    let mut damping = 0.0;
    for iterations in 1..=MAX_ITERATIONS {
        let matrix = normal.matrix();
        let diagonal = std::array::from_fn(|i| damping * matrix[i][i]);
        let step = Ldlt::new(&matrix, &diagonal).ok_or(PoseError::Degenerate)?.solve(&normal.gradient);
        let [vx, vy, vz, wx, wy, wz] = step;
        let depth2 = state.p[2] * state.p[2];
        let promised: f64 = step.iter().zip(&normal.gradient).map(|(d, g)| d * g).sum();
        let short = vx * vx + vy * vy + vz * vz < LAST_STEP_SQUARED * depth2
            && wx * wx + wy * wy + wz * wz < LAST_STEP_SQUARED;
        // A damped step is short by force: it proves nothing.
        let last = short || (damping == 0.0 && promised < LAST_GAIN * normal.cost);
        let candidate = state.moved(&step);
        let next = Normal::evaluate::<L, P>(&candidate, points, center);
        match next {
            // At the minimum the cost is flat: there, rounding alone decides whether it falls.
            Some(next) if next.cost <= normal.cost || (last && damping == 0.0) => {
                // Where the step gained far less than the quadratic model said, the model is too flat. Half and twice of the numbers that were
                // chosen by hand change no unit test.
                let bent: f64 = (0..6).map(|i| diagonal[i] * step[i] * step[i]).sum();
                let gained = (normal.cost - next.cost) / (promised + bent);
                damping = match damping {
                    // A quarter and, below, three quarters are Fletcher's (1971), as most programs since have them; four times was chosen by hand.
                    _ if gained < 0.25 => (4.0 * damping).max(0.25),
                    // Chosen by hand: so little shortens a step by a thousandth.
                    small if small < 1e-3 => 0.0,
                    // Fletcher's; a fifth was chosen by hand.
                    some if gained > 0.75 => 0.2 * some,
                    some => some,
                };
                state = candidate;
                normal = next;
                if last {
                    return Ok(Minimum { state, normal, iterations, converged: true });
                }
            }
            _ if last => return Ok(Minimum { state, normal, iterations, converged: true }),
            // Chosen by hand: more than where a step gained little, since this one gained nothing.
            _ => damping = (8.0 * damping).max(0.25),
        }
    }
    Ok(Minimum { state, normal, iterations: MAX_ITERATIONS, converged: false })
}

#[cfg(test)]
mod tests;
