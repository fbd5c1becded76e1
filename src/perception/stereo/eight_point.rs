//! Fundamental and essential matrix from eight conjugate points or more, linear in whitened coordinates (Hartley 1997).

use super::StereoError;
use super::epipolar::{Conjugates, check};
use crate::linalg::symmetric_eigen;
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

/// Second-least eigenvalue of the normal equations over the greatest, below which the matrix is not unique: points on a plane,
/// or no base line. Chosen by hand: some fifty times what rounding of their sums leaves of a zero; points with noise are far above.
const UNIQUE: f64 = 1e-14;

/// The fundamental matrix of (10.46) for pixels, of rank two and unit Frobenius norm; its sign has no meaning.
///
/// Normalized coordinates do as well.
///
/// # Errors
/// [`StereoError::TooFewPoints`], [`StereoError::NotFinite`], [`StereoError::Degenerate`] for points that coincide or lie on
/// one plane, and for views from one place.
pub fn fundamental_8_point(pairs: &[Conjugates]) -> Result<Matrix3<f64>, StereoError> {
    let (F, [T_1, T_2]) = linear(pairs)?;
    let (_, V) = symmetric_eigen(&F.tr_mul(&F)).ok_or(StereoError::Degenerate)?;
    let v = V.column(2).into_owned();
    let F = T_1.transpose() * (F - (F * v) * v.transpose()) * T_2;
    Ok(F / F.norm())
}

/// The essential matrix of (10.46), with singular values 1, 1, 0; its sign has no meaning.
///
/// A start for [`super::refine_relative`].
///
/// # Errors
/// As [`fundamental_8_point`].
pub fn essential_8_point(pairs: &[Conjugates]) -> Result<Matrix3<f64>, StereoError> {
    let (F, [T_1, T_2]) = linear(pairs)?;
    closest_essential(&(T_1.transpose() * F * T_2)).ok_or(StereoError::Degenerate)
}

/// The matrix of singular values 1, 1, 0 that is closest to a multiple of `E`.
pub(super) fn closest_essential(E: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let E = E / E.norm();
    let (_, V) = symmetric_eigen(&E.tr_mul(&E))?;
    let (v1, v2) = (V.column(0).into_owned(), V.column(1).into_owned());
    let u1 = (E * v1).normalize();
    let u2 = E * v2;
    let u2 = (u2 - u1 * u1.dot(&u2)).normalize();
    let E = u1 * v1.transpose() + u2 * v2.transpose();
    E.iter().all(|x| x.is_finite()).then_some(E)
}

/// The matrix of least squares in whitened coordinates, and the whitening of both images.
fn linear(pairs: &[Conjugates]) -> Result<(Matrix3<f64>, [Matrix3<f64>; 2]), StereoError> {
    check(pairs, 8)?;
    let whitening = |place: &dyn Fn(&Conjugates) -> Vector2<f64>| {
        let over = 1.0 / pairs.len() as f64;
        let mean: Vector2<f64> = pairs.iter().map(place).sum::<Vector2<f64>>() * over;
        let spread: f64 = pairs.iter().map(|p| (place(p) - mean).norm_squared()).sum::<f64>() * over;
        let scale = (2.0 / spread).sqrt();
        let T = Matrix3::new(scale, 0.0, -scale * mean.x, 0.0, scale, -scale * mean.y, 0.0, 0.0, 1.0);
        scale.is_finite().then_some(T).ok_or(StereoError::Degenerate)
    };
    let (T_1, T_2) = (whitening(&|p| p.s_1)?, whitening(&|p| p.s_2)?);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for pair in pairs {
        let (s1, s2) = pair.homogeneous();
        let (a, b): (Vector3<f64>, Vector3<f64>) = (T_1 * s1, T_2 * s2);
        let row = [
            a.x * b.x,
            a.x * b.y,
            a.x, //
            a.y * b.x,
            a.y * b.y,
            a.y, //
            b.x,
            b.y,
            1.0,
        ];
        for i in 0..9 {
            for j in 0..=i {
                normal[(i, j)] += row[i] * row[j];
            }
        }
    }
    normal.fill_upper_triangle_with_lower_triangle();
    let (d, V) = symmetric_eigen(&normal).ok_or(StereoError::Degenerate)?;
    if !(d[7] > UNIQUE * d[0]) {
        return Err(StereoError::Degenerate);
    }
    Ok((Matrix3::from_row_slice(V.column(8).as_slice()), [T_1, T_2]))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, noisy, scene};
    use super::super::{essential_matrix, sampson_error2};
    use super::*;
    use crate::geometry::Pose;
    use crate::linalg::Random;

    fn up_to_sign(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
        let (a, b) = (a / a.norm(), b / b.norm());
        (a - b).norm().min((a + b).norm())
    }

    #[test]
    fn exact_points_give_the_matrix() {
        let E = essential_matrix(&camera_pose());
        for count in [8, 9, 20] {
            let pairs: Vec<_> = scene(&camera_pose(), count, 4).iter().map(|p| p.0).collect();
            assert!(up_to_sign(&essential_8_point(&pairs).unwrap(), &E) < 1e-9);
            // In pixels.
            let px = |s: &Vector2<f64>| Vector2::new(800.0 * s.x + 320.0, 790.0 * s.y + 240.0);
            let pixels: Vec<_> =
                pairs.iter().map(|p| Conjugates { s_1: px(&p.s_1), s_2: px(&p.s_2) }).collect();
            let F = fundamental_8_point(&pixels).unwrap();
            assert!(F.determinant().abs() < 1e-12 && (F.norm() - 1.0).abs() < 1e-12);
            let worst = pixels.iter().map(|p| sampson_error2(&F, p).sqrt()).fold(0.0, f64::max);
            assert!(worst < 1e-6, "{worst}");
        }
    }

    #[test]
    fn noise_of_a_pixel_moves_it_by_a_little() {
        let mut random = Random::new(1);
        let all = scene(&camera_pose(), 60, 5);
        let E = essential_8_point(&noisy(&all, 1.0 / 800.0, &mut random)).unwrap();
        assert!(up_to_sign(&E, &essential_matrix(&camera_pose())) < 0.1);
        let singular = E.singular_values();
        assert!(
            (singular[0] - 1.0).abs() < 1e-12 && (singular[1] - 1.0).abs() < 1e-12 && singular[2] < 1e-12
        );
    }

    #[test]
    fn bad_input_is_refused() {
        let pairs: Vec<_> = scene(&camera_pose(), 9, 6).iter().map(|p| p.0).collect();
        assert_eq!(essential_8_point(&pairs[..7]), Err(StereoError::TooFewPoints { needed: 8, given: 7 }));
        let mut bad = pairs.clone();
        bad[3].s_2.x = f64::NAN;
        assert_eq!(fundamental_8_point(&bad), Err(StereoError::NotFinite { index: 3 }));
        assert_eq!(essential_8_point(&[pairs[0]; 8]), Err(StereoError::Degenerate));
        // No base line.
        let still = Pose::new([0.0; 3].into(), [0.1, 0.2, 0.0].into());
        let pairs: Vec<_> = scene(&still, 20, 6).iter().map(|p| p.0).collect();
        assert_eq!(essential_8_point(&pairs), Err(StereoError::Degenerate));
    }
}
