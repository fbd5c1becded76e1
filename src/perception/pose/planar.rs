//! Pose of a plane from four or more points, with both solutions that a plane can have.
//!
//! A small or distant plane looks nearly the same when its tilt is mirrored about the visual ray. The homography
//! determines the derivative of the map at the centroid, which fits exactly two rotations. Both are refined on the
//! reprojection error and ranked by it.

use super::minima::{axes, everywhere};
use super::points::centroid;
use super::refine::{Minimum, PoseState, minimise};
use super::{Correspondence, PoseError, PoseSolution, homography, pose_from_homography};
use crate::geometry::Pose;
use crate::linalg::F2;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Two rotations nearer than this (rad) are one solution: they meet where the plane is viewed along its normal, as roots of tilts squared,
/// so that rounding of 1e-16 parts them by 1e-8.
const SAME_RAD: f64 = 1e-4;

/// The solutions of the planar problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarPose {
    /// The one of least reprojection error.
    pub best: PoseSolution,
    /// The second local minimum, where there is one. When its `rms` is near that of `best`, the image alone does not
    /// determine which is true: use the previous pose.
    pub other: Option<PoseSolution>,
}

impl PlanarPose {
    /// The solution whose rotation is nearer to that of `X_CO`, for example of the pose one frame before.
    #[must_use]
    pub fn nearest(&self, X_CO: &Pose) -> PoseSolution {
        let angle = |solution: &PoseSolution| solution.X_CO.rotation.angle_to(&X_CO.rotation);
        match self.other {
            Some(other) if angle(&other) < angle(&self.best) => other,
            _ => self.best,
        }
    }
}

/// Pose of a plane z = 0 from at least four of its points, no three collinear when there are just four.
///
/// A refinement that has not converged after 100 steps (flat minima under strong noise) is used as it is, since each step
/// has reduced its error.
///
/// ```
/// use nalgebra::Vector2;
/// # use vservo_perception as vservo;
/// use vservo::pose::{Correspondence, planar_pose};
///
/// // The square of Example 10.1 seen from 0.5 m, turned by 45 degrees about y (coordinates of four digits).
/// let corners = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]];
/// let images = [[0.0, 0.0], [0.1647, 0.0], [0.1647, 0.2329], [0.0, 0.2]];
/// let points: [Correspondence; 4] =
///     std::array::from_fn(|i| Correspondence { r: Vector2::from(corners[i]), s: Vector2::from(images[i]) });
/// let solved = planar_pose(&points)?;
/// assert!((solved.best.X_CO.translation.z - 0.5).abs() < 1e-3);
/// assert!((solved.best.X_CO.rotation.angle().to_degrees() - 45.0).abs() < 0.1);
/// assert!(solved.other.is_some_and(|mirrored| mirrored.rms > solved.best.rms));
/// # Ok::<(), vservo::pose::PoseError>(())
/// ```
///
/// # Errors
/// Those of [`homography`]; [`PoseError::Degenerate`] or [`PoseError::BehindCamera`] when no start can be refined.
pub fn planar_pose(points: &[Correspondence]) -> Result<PlanarPose, PoseError> {
    let H = match homography(points) {
        // Noise can bring a point of the fitted homography behind the camera; a pose has its points in front.
        Err(PoseError::BehindCamera) => return from_all_rotations(points),
        other => other?,
    };
    let center = centroid(points);
    let solution =
        |end: &Minimum| PoseSolution { X_CO: end.state.pose(&center), rms: end.normal.rms(points.len()) };
    let refined = |R: Rotation3<f64>| {
        let start = start_at(R, points, &center).ok_or(PoseError::Degenerate)?;
        minimise::<F2, _>(start, points, &center)
    };
    let Some(tilts) = Tilts::new(&H, &center) else {
        let X = pose_from_homography(&H).ok_or(PoseError::Degenerate)?;
        let start = PoseState::at(&X, &center).ok_or(PoseError::Degenerate)?;
        let end = minimise::<F2, _>(start, points, &center)?;
        return Ok(PlanarPose { best: solution(&end), other: None });
    };
    let first = refined(tilts.rotation(1.0));
    if tilts.is_frontal() {
        return first.map(|end| PlanarPose { best: solution(&end), other: None });
    }
    let apart =
        |a: &Minimum, b: &Minimum| solution(a).X_CO.rotation.angle_to(&solution(b).X_CO.rotation) > SAME_RAD;
    let (a, b) = match (first, refined(tilts.rotation(-1.0))) {
        (Ok(a), Ok(b)) if apart(&a, &b) => (a, Some(b)),
        // Both starts have come to one end, or one of them to none: the other minimum, if there is one, lies about where
        // that end's plane is tilted to the other side.
        (Ok(only), _) | (Err(_), Ok(only)) => {
            let mirrored = refined(mirrored(&solution(&only).X_CO, &center)).ok();
            (only, mirrored.filter(|other| apart(&only, other)))
        }
        (Err(_), Err(_)) => return from_all_rotations(points),
    };
    match b {
        Some(b) if b.normal.cost < a.normal.cost => {
            Ok(PlanarPose { best: solution(&b), other: Some(solution(&a)) })
        }
        b => Ok(PlanarPose { best: solution(&a), other: b.as_ref().map(solution) }),
    }
}

/// For points whose homography is unusable: the two best of all minima.
#[cold]
fn from_all_rotations(points: &[Correspondence]) -> Result<PlanarPose, PoseError> {
    let (axes, flat) = axes(points)?;
    let found = everywhere(points, &axes, flat)?;
    Ok(PlanarPose { best: found.best(), other: found.as_slice().get(1).copied() })
}

/// The rotation of the plane that looks the same from far away: mirrored at the plane normal to the centroid's ray.
fn mirrored(X_CO: &Pose, center: &[f64; 3]) -> Rotation3<f64> {
    let ray = (X_CO * Point3::from(*center)).coords.normalize();
    let R = X_CO.rotation.to_rotation_matrix();
    let turned = R.matrix() - ray * (ray.transpose() * R.matrix()) * 2.0;
    let columns = [turned.column(0).into_owned(), turned.column(1).into_owned(), -turned.column(2)];
    Rotation3::from_matrix_unchecked(Matrix3::from_columns(&columns))
}

/// The two rotations that fit a homography's derivative at the centroid.
///
/// With R_v the rotation that carries z to the centroid's ray, `R_CO = R_v R_t`; the derivative gives the upper left
/// 2 x 2 block of R_t up to the distance, whose greatest singular value must be one. Orthonormal columns then give
/// the third row up to its sign.
struct Tilts {
    to_ray: Matrix3<f64>,
    block: [[f64; 2]; 2],
    third: [f64; 2],
}

impl Tilts {
    /// `None` when the derivative is singular or not finite (the plane passes through the camera's centre).
    #[inline]
    fn new(H: &Matrix3<f64>, center: &[f64; 3]) -> Option<Self> {
        let h = H * Vector3::new(center[0], center[1], 1.0);
        let scale = 1.0 / h.z;
        let (p, q) = (h.x * scale, h.y * scale);
        let j = [
            [(H.m11 - p * H.m31) * scale, (H.m12 - p * H.m32) * scale],
            [(H.m21 - q * H.m31) * scale, (H.m22 - q * H.m32) * scale],
        ];
        let lz = 1.0 / (1.0 + p * p + q * q).sqrt();
        let (lx, ly) = (p * lz, q * lz);
        let k = 1.0 / (1.0 + lz);
        let to_ray = Matrix3::new(
            1.0 - lx * lx * k,
            -lx * ly * k,
            lx,
            -lx * ly * k,
            1.0 - ly * ly * k,
            ly,
            -lx,
            -ly,
            lz,
        );
        // B = [1 0 -p; 0 1 -q] R_v; its third column vanishes. Its determinant is 1 / lz.
        let b = [[to_ray.m11 + p * lx, to_ray.m12 + p * ly], [to_ray.m21 + q * lx, to_ray.m22 + q * ly]];
        let d = 1.0 / (b[0][0] * b[1][1] - b[0][1] * b[1][0]);
        let a = [
            [(b[1][1] * j[0][0] - b[0][1] * j[1][0]) * d, (b[1][1] * j[0][1] - b[0][1] * j[1][1]) * d],
            [(b[0][0] * j[1][0] - b[1][0] * j[0][0]) * d, (b[0][0] * j[1][1] - b[1][0] * j[0][1]) * d],
        ];
        let (aa, bb) = (a[0][0] * a[0][0] + a[1][0] * a[1][0], a[0][1] * a[0][1] + a[1][1] * a[1][1]);
        let ab = a[0][0] * a[0][1] + a[1][0] * a[1][1];
        // Greatest eigenvalue of A^T A.
        let greatest = 0.5 * (aa + bb + ((aa - bb) * (aa - bb) + 4.0 * ab * ab).sqrt());
        if !(greatest > 0.0 && greatest < f64::INFINITY) {
            return None;
        }
        let inverse = 1.0 / greatest;
        let root = inverse.sqrt();
        let t0 = (1.0 - aa * inverse).max(0.0).sqrt();
        let t1 = (1.0 - bb * inverse).max(0.0).sqrt();
        let third = [t0, if ab > 0.0 { -t1 } else { t1 }];
        Some(Self { to_ray, block: a.map(|row| row.map(|x| x * root)), third })
    }

    /// Whether both tilts are zero up to rounding: the plane is viewed along its normal. They are roots of differences that round to 1e-16, so
    /// that rounding alone makes them 1e-8.
    fn is_frontal(&self) -> bool {
        // The square root of rounding, 1e-8, with a margin: nearer to it the two solutions cannot be computed apart.
        self.third[0].abs() + self.third[1].abs() < 1e-7
    }

    #[inline]
    fn rotation(&self, sign: f64) -> Rotation3<f64> {
        let c1 = Vector3::new(self.block[0][0], self.block[1][0], sign * self.third[0]);
        let c2 = Vector3::new(self.block[0][1], self.block[1][1], sign * self.third[1]);
        Rotation3::from_matrix_unchecked(self.to_ray * Matrix3::from_columns(&[c1, c2, c1.cross(&c2)]))
    }
}

/// The start with rotation `R`: its position solves `X (q_z + t_z) = q_x + t_x`, and the same for Y, with `q = R r`.
#[inline]
fn start_at(R: Rotation3<f64>, points: &[Correspondence], center: &[f64; 3]) -> Option<PoseState> {
    let R = R.matrix();
    let count = points.len() as f64;
    let (mut sx, mut sy, mut bx, mut by) = (0.0, 0.0, 0.0, 0.0);
    let (mut square, mut mixed) = (0.0, 0.0);
    for point in points {
        let (x, y) = (point.r.x - center[0], point.r.y - center[1]);
        let qz = R.m31 * x + R.m32 * y;
        let bxi = point.s.x * qz - (R.m11 * x + R.m12 * y);
        let byi = point.s.y * qz - (R.m21 * x + R.m22 * y);
        sx += point.s.x;
        sy += point.s.y;
        bx += bxi;
        by += byi;
        square += point.s.x * point.s.x + point.s.y * point.s.y;
        mixed += point.s.x * bxi + point.s.y * byi;
    }
    // t_x - X t_z = b_x is a regression line in X with slope -t_z common to both axes.
    let tz = -(count * mixed - sx * bx - sy * by) / (count * square - sx * sx - sy * sy);
    let t = Vector3::new((bx + sx * tz) / count, (by + sy * tz) / count, tz);
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*R));
    PoseState::at(&Pose::from_parts(Translation3::from(t), q), &[0.0; 3])
}

#[cfg(test)]
mod tests;
