//! Secondary tasks in the null space of the servo task: motions of the joints that the features do not see.
//!
//! There are some with seven joints, and wherever the features fix fewer motions than there are joints.

use super::{CameraJacobian, TwistTask};
use crate::robot::JointLimits;
use nalgebra::{SMatrix, SVector};

/// Squared singular values of the task in joint space, as share of the largest, up to which a motion counts as free.
const FREE_DIRECTION: f64 = 1e-9;
/// Share of half a joint's range, from its middle, in which limit avoidance leaves it alone.
const QUIET_SHARE: f64 = 0.5;

/// The part of the joint velocity `wanted` (rad/s or m/s) that does not move the features of `task`.
///
/// `None` when the task leaves nothing free, or something is not finite.
#[must_use]
pub fn seek_null_motion<const N: usize>(
    task: &TwistTask,
    J: &CameraJacobian<N>,
    wanted: &SVector<f64, N>,
) -> Option<SVector<f64, N>> {
    let J = J.matrix();
    let normal = J.tr_mul(&(task.matrix * J));
    let (values, vectors) = symmetric_eigen(normal)?;
    let largest = values.amax();
    let mut motion = SVector::zeros();
    let mut free = false;
    for (i, direction) in vectors.column_iter().enumerate() {
        if values[i] <= FREE_DIRECTION * largest {
            motion += direction * direction.dot(wanted);
            free = true;
        }
    }
    (free && motion.iter().all(|x| x.is_finite())).then_some(motion)
}

/// A joint velocity away from the ends of the joints' ranges: none in the inner half of a range, and up to
/// `gain_1_s` times a quarter of the range at its end. Joints without limits stand.
#[must_use]
pub fn away_from_limits<const N: usize>(
    q: &SVector<f64, N>,
    limits: &[JointLimits; N],
    gain_1_s: f64,
) -> SVector<f64, N> {
    SVector::from_fn(|i, _| {
        let limit = &limits[i];
        let (middle, half) = (0.5 * (limit.lower + limit.upper), 0.5 * (limit.upper - limit.lower));
        if !(half > 0.0 && half < f64::INFINITY) {
            return 0.0;
        }
        let away = q[i] - middle;
        -gain_1_s * (away.abs() - QUIET_SHARE * half).max(0.0) * away.signum()
    })
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by cyclic Jacobi rotations.
fn symmetric_eigen<const N: usize>(
    mut A: SMatrix<f64, N, N>,
) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>)> {
    let mut V = SMatrix::<f64, N, N>::identity();
    let size = A.norm();
    if !size.is_finite() {
        return None;
    }
    for _ in 0..30 {
        let mut off = 0.0;
        for i in 0..N {
            for j in 0..i {
                off += A[(i, j)] * A[(i, j)];
            }
        }
        if off.sqrt() <= 1e-15 * size {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                if A[(p, q)] == 0.0 {
                    continue;
                }
                let theta = (A[(q, q)] - A[(p, p)]) / (2.0 * A[(p, q)]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let c = 1.0 / t.hypot(1.0);
                let s = t * c;
                for k in 0..N {
                    let (a, b) = (A[(k, p)], A[(k, q)]);
                    A[(k, p)] = c * a - s * b;
                    A[(k, q)] = s * a + c * b;
                }
                for k in 0..N {
                    let (a, b) = (A[(p, k)], A[(q, k)]);
                    A[(p, k)] = c * a - s * b;
                    A[(q, k)] = s * a + c * b;
                    let (a, b) = (V[(k, p)], V[(k, q)]);
                    V[(k, p)] = c * a - s * b;
                    V[(k, q)] = s * a + c * b;
                }
            }
        }
    }
    Some((A.diagonal(), V))
}
