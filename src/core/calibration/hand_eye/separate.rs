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

/// Rotations by more than this angle have no reliable sign at first, rad: a rotation by 180 degrees has two axes. Chosen by hand: 149 degrees, which
/// leaves half a radian for errors.
const SURE_RAD: f64 = 2.6;

/// The camera's pose `X_MC` that closes the loop over all pairs of views; at least three views, with turns about two axes.
/// `None` where they do not fix it.
#[must_use]
pub fn separate_solution(samples: &[LoopSample]) -> Option<Pose> {
    let first = first_rotation(samples)?;
    // now the signs of half turns show
    let R_MC = rotation(samples, |a, b, _| Some((*a, signed(&first, a, b))))?;
    let p_MC = position(samples, &R_MC)?;
    Some(Pose::from_parts(Translation3::from(p_MC), UnitQuaternion::from_rotation_matrix(&R_MC)))
}

/// A rotation that tells the signs of half turns: that of the turns whose sign is sure or, where these go about one axis alone, the one
/// of two wide turns, with the signs that fit all turns best.
fn first_rotation(samples: &[LoopSample]) -> Option<Rotation3<f64>> {
    let sure = (0.5 * SURE_RAD).cos();
    let sum = scatter(samples, |a, b, scalar| (scalar > sure).then_some((*a, *b)));
    if goes_about_two_axes(&sum) {
        return closest_rotation(&sum);
    }
    let turns = || motions(samples).map(|(A, B)| (axis(&A.rotation), axis(&B.rotation).0));
    let greater = |x: &f64, y: &f64| x.total_cmp(y);
    let ((a, _), b) = turns().max_by(|x, y| greater(&x.0.0.norm(), &y.0.0.norm()))?;
    let ((c, _), d) = turns().max_by(|x, y| greater(&a.cross(&x.0.0).norm(), &a.cross(&y.0.0).norm()))?;
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let candidates = signs.into_iter().filter_map(|(s, t)| {
        let R = closest_rotation(&(a * b.transpose() * s + c * d.transpose() * t))?;
        let misfit = turns().map(|((a, scalar), b)| {
            let off = a - R * if scalar > sure { b } else { signed(&R, &a, &b) };
            off.norm_squared()
        });
        Some((misfit.sum::<f64>(), R))
    });
    candidates.min_by(|x, y| greater(&x.0, &y.0)).map(|(_, R)| R)
}

/// Whether the second singular value of `M` is no less than a twentieth of the first.
fn goes_about_two_axes(M: &Matrix3<f64>) -> bool {
    let G = M.transpose() * M;
    let (first, all) = (G.trace(), (G * G).trace());
    // sums over the squares of the singular values: of all, and of products of two
    0.5 * (first * first - all) > first * first / 400.0
}

/// `b` or `-b`, whichever is nearer to `a` seen through `R`.
fn signed(R: &Rotation3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
    if a.dot(&(R * b)) < 0.0 { -b } else { *b }
}

/// Vector part with the sign that makes the scalar part positive, and that part.
fn axis(q: &UnitQuaternion<f64>) -> (Vector3<f64>, f64) {
    if q.w < 0.0 { (-q.imag(), -q.w) } else { (q.imag(), q.w) }
}

type VectorPair = (Vector3<f64>, Vector3<f64>);

fn rotation(
    samples: &[LoopSample],
    pick: impl Fn(&Vector3<f64>, &Vector3<f64>, f64) -> Option<VectorPair>,
) -> Option<Rotation3<f64>> {
    closest_rotation(&scatter(samples, pick))
}

/// The sum of `n_A n_B^T`.
fn scatter(
    samples: &[LoopSample],
    pick: impl Fn(&Vector3<f64>, &Vector3<f64>, f64) -> Option<VectorPair>,
) -> Matrix3<f64> {
    let mut sum = Matrix3::zeros();
    for (A, B) in motions(samples) {
        let ((a, scalar), (b, _)) = (axis(&A.rotation), axis(&B.rotation));
        if let Some((a, b)) = pick(&a, &b, scalar) {
            sum += a * b.transpose();
        }
    }
    sum
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

#[cfg(test)]
mod tests {
    use super::super::rotation_spread;
    use super::super::testing::{SimulatedCell, around, gap};
    use super::*;
    use crate::calibration::hand_eye::CameraMount;
    use crate::linalg::Random;
    use proptest::prelude::*;

    proptest! {
        /// Three views with wide turns between them: few signs are sure, or none.
        #[test]
        fn a_few_wide_turns_are_enough(seed in any::<u64>(), count in 3..6usize) {
            let mut random = Random::new(seed);
            let cell = SimulatedCell::new(CameraMount::EyeInHand, &mut random);
            let samples: Vec<_> = (0..count).map(|i| {
                let wide = Pose::rotation(Vector3::new(random.between(-0.7, 0.7), random.between(-0.7, 0.7), 2.9 * (i % 2) as f64));
                let X_CO = around(&mut random) * wide;
                cell.sample(&X_CO)
            }).collect();
            prop_assume!(rotation_spread(&samples).unwrap().across_rad > 0.1);
            // exact half turns alone have two solutions
            let scalars = |a: &LoopSample, b: &LoopSample| (a.X_CO.inverse() * b.X_CO).rotation.w.abs();
            prop_assume!(samples.iter().enumerate().all(|(i, a)| samples.iter().skip(i + 1).all(|b| scalars(a, b) > 1e-3)));
            let found = separate_solution(&samples).unwrap();
            prop_assert!(gap(&found, &cell.X_MC) < 1e-7, "{}", gap(&found, &cell.X_MC));
        }
    }
}
