//! Pose from any three points or more, planar or not (perspective-n-point): the global minimum of the reprojection error, and local minima close to it.
//!
//! Three points: [`super::p3p`]. Four or more in a plane: [`super::planar_pose`] in that plane, with both solutions. All
//! others: every minimum that comes close, found over all rotations ([`super::minima`]). Planes whose homography does not
//! exist (three of four points on a line, or nearly so under noise) are solved the same way.

use super::minima::{PnpPoses, axes, everywhere, pose_of_axes};
use super::points::check;
use super::rotation_form::Axes;
use super::{Correspondence, PlanarPose, PointSource, PoseError, PoseSolution, p3p, planar_pose};
use nalgebra::{Vector2, Vector3};

/// Most points that are solved without the heap, because a measurement holds no more ([`crate::messages::MAX_FEATURES`]): more, and
/// planar ones are copied to it.
const ON_STACK: usize = crate::messages::MAX_FEATURES;

impl From<PlanarPose> for PnpPoses {
    fn from(planar: PlanarPose) -> Self {
        let mut all = Self::none();
        all.insert(planar.best);
        if let Some(other) = planar.other {
            all.insert(other);
        }
        all
    }
}

/// The pose of least reprojection error of three points or more in any arrangement, and others whose error is close.
///
/// Three points give up to four exact solutions, in no order. For four and more the first solution is the global minimum;
/// further ones are local minima whose rms is at most five times the least plus 0.001 (normalized units), and the second
/// solution of a plane however large its error. Up to 64 points nothing is allocated.
///
/// ```
/// use nalgebra::{Point3, Vector2};
/// # use vservo_perception as vservo;
/// use vservo::pose::{Correspondence3, pnp};
///
/// // Corners of a cube of 0.1 m, 0.5 m ahead.
/// let corner = |i: u8| Point3::from([0, 1, 2].map(|k| 0.1 * f64::from(i >> k & 1)));
/// let points: Vec<_> = (0..8)
///     .map(|i| {
///         let r = corner(i);
///         Correspondence3 { r, s: Vector2::new(r.x / (r.z + 0.5), r.y / (r.z + 0.5)) }
///     })
///     .collect();
/// let pose = pnp(&points)?.best();
/// assert!((pose.X_CO.translation.z - 0.5).abs() < 1e-9 && pose.X_CO.rotation.angle() < 1e-9);
/// # Ok::<(), vservo::pose::PoseError>(())
/// ```
///
/// # Errors
/// [`PoseError::TooFewPoints`], [`PoseError::NotFinite`], [`PoseError::Degenerate`] for collinear points or points on one
/// visual ray, [`PoseError::BehindCamera`] when no solution has all points in front.
pub fn pnp<P: PointSource>(points: &[P]) -> Result<PnpPoses, PoseError> {
    check(points, 3)?;
    if let [a, b, c] = points {
        let found = p3p(&[*a, *b, *c])?;
        let mut all = PnpPoses::none();
        for X_CO in found.as_slice() {
            all.insert(PoseSolution { X_CO: *X_CO, rms: super::reprojection_rms(X_CO, points) });
        }
        return Ok(all);
    }
    let (axes, flat) = axes(points)?;
    if flat && let Ok(found) = in_plane(points, &axes) {
        return Ok(found);
    }
    everywhere(points, &axes, flat)
}

/// The planar solver in the plane of the points.
fn in_plane<P: PointSource>(points: &[P], axes: &Axes) -> Result<PnpPoses, PoseError> {
    let place = |point: &P| {
        let d = Vector3::from(point.object()) - Vector3::from(axes.mean);
        let [x, y, _] = axes.rows.map(|row| Vector3::from(row).dot(&d));
        Correspondence { r: Vector2::new(x, y), s: Vector2::from(point.image()) }
    };
    let mut stack = [Correspondence { r: Vector2::zeros(), s: Vector2::zeros() }; ON_STACK];
    let heap: Vec<_>;
    let planar = if let Some(copies) = stack.get_mut(..points.len()) {
        for (copy, point) in copies.iter_mut().zip(points) {
            *copy = place(point);
        }
        &*copies
    } else {
        heap = points.iter().map(place).collect();
        &heap
    };
    let found = planar_pose(planar)?;
    let back = |solution: PoseSolution| {
        let R = solution.X_CO.rotation.to_rotation_matrix();
        PoseSolution { X_CO: pose_of_axes(axes, R.matrix(), &solution.X_CO.translation.vector), ..solution }
    };
    Ok(PnpPoses::from(PlanarPose { best: back(found.best), other: found.other.map(back) }))
}

#[cfg(test)]
mod tests;
