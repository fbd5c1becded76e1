//! Displacement of a camera from the homography between two images of a plane, (10.58)-(10.61).
//!
//! `H = R_12 + (1/d_2) p_12_1 n_2^T`, (10.59): frames 1 and 2 are two poses of the camera, the plane has the unit
//! normal n_2 and the distance d_2 > 0 in frame 2, and `p_1 = H p_2` for its points. Lengths come out in units of d_2.

use super::PoseError;
use crate::linalg::symmetric_eigen;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

/// One solution of the decomposition of a homography.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomographySolution {
    /// Rotation of frame 2 in frame 1.
    pub R_12: Rotation3<f64>,
    /// Position of frame 2 from frame 1, expressed in 1, divided by the distance d_2 of the plane.
    pub p_12_1_over_d2: Vector3<f64>,
    /// Unit normal of the plane in frame 2, pointing away from the camera.
    pub n_2: Vector3<f64>,
}

impl HomographySolution {
    /// Whether the plane is in front of camera 2 where it shows the point `s_2` (normalized).
    #[must_use]
    pub fn sees(&self, s_2: &Vector2<f64>) -> bool {
        self.n_2.x * s_2.x + self.n_2.y * s_2.y + self.n_2.z > 0.0
    }
}

/// One or two solutions; the order has no meaning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomographySolutions {
    /// Always there.
    pub first: HomographySolution,
    /// The second solution, unless it coincides with the first or has points behind the camera.
    pub second: Option<HomographySolution>,
}

impl HomographySolutions {
    /// The solution whose normal is nearest to `n_2`, e.g. the one known from the frame before.
    #[must_use]
    pub fn nearest_normal(&self, n_2: &Vector3<f64>) -> HomographySolution {
        match self.second {
            Some(second) if second.n_2.dot(n_2) > self.first.n_2.dot(n_2) => second,
            _ => self.first,
        }
    }

    /// The solution whose base line points most along `direction` (in frame 1), for a motion whose direction is known roughly.
    #[must_use]
    pub fn nearest_direction(&self, direction: &Vector3<f64>) -> HomographySolution {
        let along = |s: &HomographySolution| {
            let p = s.p_12_1_over_d2;
            p.dot(direction) / p.norm().max(f64::MIN_POSITIVE)
        };
        match self.second {
            Some(second) if along(&second) > along(&self.first) => second,
            _ => self.first,
        }
    }
}

/// The solutions of (10.59) for a homography given up to a factor (of either sign).
///
/// The factor follows from the middle singular value, which is one, and from `det H = d_1 / d_2 > 0`: both images
/// show the same side of the plane. The normal's sign is chosen for a plane that meets the optical axis in front of
/// camera 2 (n_z >= 0). For a pure rotation the normal is arbitrary and the position zero.
///
/// # Errors
/// [`PoseError::NotFinite`] (index 0) and [`PoseError::Degenerate`] for a singular matrix.
pub fn decompose_homography(H: &Matrix3<f64>) -> Result<HomographySolutions, PoseError> {
    readings(H).map(|(a, b)| HomographySolutions { first: a, second: different(&a, b) })
}

/// As [`decompose_homography`], but the normal's sign and the choice of solutions come from points that camera 2 sees.
///
/// `points_2`: their normalized coordinates in image 2.
///
/// # Errors
/// As [`decompose_homography`], and [`PoseError::BehindCamera`] when no solution has all points in front.
pub fn decompose_homography_seen(
    H: &Matrix3<f64>,
    points_2: &[Vector2<f64>],
) -> Result<HomographySolutions, PoseError> {
    let (a, b) = readings(H)?;
    let turned =
        |s: HomographySolution| HomographySolution { p_12_1_over_d2: -s.p_12_1_over_d2, n_2: -s.n_2, ..s };
    let seen = |s: HomographySolution| {
        [s, turned(s)].into_iter().find(|s| points_2.iter().all(|point| s.sees(point)))
    };
    match (seen(a), seen(b)) {
        (Some(a), Some(b)) => Ok(HomographySolutions { first: a, second: different(&a, b) }),
        (Some(only), None) | (None, Some(only)) => Ok(HomographySolutions { first: only, second: None }),
        (None, None) => Err(PoseError::BehindCamera),
    }
}

/// `b`, unless it is `a` up to rounding. The threshold is wide because the solutions hold square roots of differences that vanish where they
/// meet: rounding of 1e-15 becomes 3e-8 there.
fn different(a: &HomographySolution, b: HomographySolution) -> Option<HomographySolution> {
    let gap = (a.R_12.matrix() - b.R_12.matrix()).norm() + (a.p_12_1_over_d2 - b.p_12_1_over_d2).norm();
    // Solutions that coincide differ by the square root of rounding, 1e-8, because they are roots of a double eigenvalue.
    (gap > 1e-6).then_some(b)
}

fn readings(H: &Matrix3<f64>) -> Result<(HomographySolution, HomographySolution), PoseError> {
    let size = H.norm();
    if !size.is_finite() {
        return Err(PoseError::NotFinite { index: 0 });
    }
    let H = H / size;
    let det = H.determinant();
    // H has unit norm. Otherwise the camera would be nearer to the plane than 1e-12 of the other distance, or H is not the homography of a plane.
    if det.abs() <= 1e-12 || det.is_nan() {
        return Err(PoseError::Degenerate);
    }
    let (d, V) = symmetric_eigen(&(H.transpose() * H)).ok_or(PoseError::Degenerate)?;
    let H = H * (det.signum() / d.y.sqrt());
    let (s1, s3) = (d.x / d.y, d.z / d.y); // squares of the singular values around 1
    let (v1, v2) = (V.column(0).into_owned(), V.column(1).into_owned());
    let v3 = v1.cross(&v2); // right-handed
    // H keeps the length of vectors in two planes through v2. Each is orthogonal to one of the normals.
    let spread = s1 - s3;
    // Equal to rounding: H is a rotation, for which any normal serves, since nothing was translated.
    let (a, b) = if spread > 1e-14 {
        let x = ((1.0 - s3) / spread).max(0.0).sqrt();
        (x, ((s1 - 1.0) / spread).max(0.0).sqrt())
    } else {
        (1.0, 0.0)
    };
    let Hv2 = H * v2;
    let reading = |u: Vector3<f64>| {
        let n = v2.cross(&u);
        let Hu = H * u;
        let Hn = Hv2.cross(&Hu);
        let R = Hv2 * v2.transpose() + Hu * u.transpose() + Hn * n.transpose();
        let p = (H - R) * n;
        let sign = if n.z < 0.0 { -1.0 } else { 1.0 };
        HomographySolution {
            R_12: Rotation3::from_matrix_unchecked(R),
            p_12_1_over_d2: p * sign,
            n_2: n * sign,
        }
    };
    Ok((reading(v1 * a + v3 * b), reading(v1 * a - v3 * b)))
}

#[cfg(test)]
mod tests;
