//! `A X = X B` in two steps, rotation and then position (after Park and Martin 1994, and Tsai and Lenz 1989).
//!
//! ```text
//! n_A = R_X n_B        the axes of any two views' motion: closest rotation to sum n_A n_B^T, (10.12)
//! (R_A - I) p_X = R_X p_B - p_A       least squares
//! ```
//! Of each rotation the vector part of its quaternion is taken, `sin(angle / 2)` times the axis: unlike the rotation vector it is
//! as sure near half turns as elsewhere, but for its sign, which the rest tells.

use super::{LoopSample, motions};
use crate::geometry::{Pose, closest_rotation};
use crate::linalg::Ldlt;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Turns beyond this angle have no sure sign at first, rad.
const SURE_RAD: f64 = 2.6;

/// The camera's pose `X_MC` that closes the loop over all pairs of views; at least three views, with turns about two axes.
/// `None` where they do not fix it.
#[must_use]
pub fn separate_solution(samples: &[LoopSample]) -> Option<Pose> {
    let sure = (0.5 * SURE_RAD).cos();
    let all_wide = !motions(samples).any(|(A, _)| axis(&A.rotation).1 > sure);
    let first =
        rotation(samples, |a, b, scalar| if all_wide || scalar > sure { Some((*a, *b)) } else { None })?;
    // now the signs of half turns show
    let R_MC = rotation(samples, |a, b, _| Some((*a, signed(&first, a, b))))?;
    let p_MC = position(samples, &R_MC)?;
    Some(Pose::from_parts(Translation3::from(p_MC), UnitQuaternion::from_rotation_matrix(&R_MC)))
}

/// `b` or `-b`, whichever is nearer to `a` seen through `R`.
fn signed(R: &Rotation3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
    if a.dot(&(R * b)) < 0.0 { -b } else { *b }
}

/// Vector part with the sign that makes the scalar part positive, and that part.
fn axis(q: &UnitQuaternion<f64>) -> (Vector3<f64>, f64) {
    if q.w < 0.0 { (-q.imag(), -q.w) } else { (q.imag(), q.w) }
}

type Pair = (Vector3<f64>, Vector3<f64>);

fn rotation(
    samples: &[LoopSample],
    pick: impl Fn(&Vector3<f64>, &Vector3<f64>, f64) -> Option<Pair>,
) -> Option<Rotation3<f64>> {
    let mut sum = Matrix3::zeros();
    for (A, B) in motions(samples) {
        let ((a, scalar), (b, _)) = (axis(&A.rotation), axis(&B.rotation));
        if let Some((a, b)) = pick(&a, &b, scalar) {
            sum += a * b.transpose();
        }
    }
    closest_rotation(&sum)
}

/// The position that fits the rotation `R_MC` best, m.
fn position(samples: &[LoopSample], R_MC: &Rotation3<f64>) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (A, B) in motions(samples) {
        let C = A.rotation.to_rotation_matrix().matrix() - Matrix3::identity();
        normal += C.transpose() * C;
        right += C.transpose() * (R_MC * B.translation.vector - A.translation.vector);
    }
    let p = Vector3::from(Ldlt::of(&normal)?.solve(&right.into()));
    p.iter().all(|x| x.is_finite()).then_some(p)
}
