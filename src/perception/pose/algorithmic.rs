//! The textbook's pose estimation by integration, Sect. 10.3.3: (10.33), (10.36), (10.38), (10.40)-(10.42); from points,
//! or from the parameters of a line segment (10.28).
//!
//! `x = [p_CO_C; phi]`: m, and rad. For m = 6 phi holds the angles about z, y, x of `R_CO = Rz Ry Rx`, in this order,
//! as in Example 10.1; for m = 4 the one angle alpha about z.

use super::points::check;
use super::{PointSource, PoseError};
use crate::features::{
    Feature, NormalEquations, SegmentFeature, analytical_image_jacobian_4, euler_zyx_rate,
    point_image_jacobian,
};
use crate::geometry::{rotation_x, rotation_y, rotation_z};
use nalgebra::{Matrix3, Point3, Rotation3, SMatrix, SVector, Vector2, Vector3, Vector4, Vector6};

/// The state after one Euler step, and the error before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlgorithmicStep<const M: usize> {
    /// The new estimate of x.
    pub x: SVector<f64, M>,
    /// Norm of e_s, (10.36), at the estimate that the step started from, normalized units.
    pub error: f64,
}

/// `Rz(phi[0]) Ry(phi[1]) Rx(phi[2])`, rad.
#[must_use]
pub fn euler_zyx_rotation(phi: &Vector3<f64>) -> Rotation3<f64> {
    rotation_z(phi.x) * rotation_y(phi.y) * rotation_x(phi.z)
}

/// One Euler step of (10.42), (10.41) for m = 6 with K_s = `gain_1_s` I.
///
/// At least three points (square for three, the left pseudo-inverse beyond).
///
/// # Errors
/// [`PoseError::TooFewPoints`], [`PoseError::NotFinite`], [`PoseError::BehindCamera`] for the estimate, and
/// [`PoseError::Degenerate`] when L_s is rank-deficient or the middle Euler angle is at +-pi/2.
pub fn algorithmic_step<P: PointSource>(
    x: &Vector6<f64>,
    points: &[P],
    gain_1_s: f64,
    dt_s: f64,
) -> Result<AlgorithmicStep<6>, PoseError> {
    check(points, 3)?;
    let phi = Vector3::new(x[3], x[4], x[5]);
    let (V, error) = relative_twist::<P, 6>(&euler_zyx_rotation(&phi), x, points, gain_1_s, |J| *J)?;
    Ok(AlgorithmicStep { x: x + pose_rate(&phi, &V)? * dt_s, error })
}

/// The rate of x for the twist of O relative to C, (10.41): `phi_dot = T(phi)^-1 w`.
pub(super) fn pose_rate(phi: &Vector3<f64>, V: &Vector6<f64>) -> Result<Vector6<f64>, PoseError> {
    let T: Matrix3<f64> = euler_zyx_rate(phi);
    let phi_dot = match T.try_inverse() {
        // det T is the cosine of the middle angle up to sign: 1e-9 rad from the singular one the rates would be seven digits of rounding.
        Some(inverse) if T.determinant().abs() > 1e-9 => inverse * V.fixed_rows::<3>(3),
        _ => return Err(PoseError::Degenerate),
    };
    Ok(Vector6::new(V[0], V[1], V[2], phi_dot.x, phi_dot.y, phi_dot.z))
}

/// One Euler step for m = 4, (10.33): object and image planes parallel, T_A = I. At least two points.
///
/// # Errors
/// As [`algorithmic_step`].
pub fn algorithmic_step_4<P: PointSource>(
    x: &Vector4<f64>,
    points: &[P],
    gain_1_s: f64,
    dt_s: f64,
) -> Result<AlgorithmicStep<4>, PoseError> {
    check(points, 2)?;
    let (rate, error) = relative_twist::<P, 4>(&rotation_z(x[3]), x, points, gain_1_s, |J| {
        SMatrix::from_columns(&[J.column(0), J.column(1), J.column(2), J.column(5)])
    })?;
    Ok(AlgorithmicStep { x: x + rate * dt_s, error })
}

/// One Euler step of (10.38) for m = 4 with the parameters `s = [x y L alpha]` of the line segment, (10.28), between
/// the two points `ends_O` of the object (m).
///
/// The error in alpha is taken the short way round.
///
/// # Errors
/// [`PoseError::NotFinite`], [`PoseError::BehindCamera`] for the estimate, and [`PoseError::Degenerate`] when the
/// Jacobian is singular: the segment has no length.
pub fn algorithmic_step_segment(
    x: &Vector4<f64>,
    ends_O: &[Point3<f64>; 2],
    s: &Vector4<f64>,
    gain_1_s: f64,
    dt_s: f64,
) -> Result<AlgorithmicStep<4>, PoseError> {
    if !s.iter().all(|s| s.is_finite()) {
        return Err(PoseError::NotFinite { index: 0 });
    }
    let (R, p) = (rotation_z(x[3]), x.xyz());
    let ends = ends_O.map(|r| R * r.coords + p);
    if !ends.iter().all(|p| p.z > 0.0) {
        return Err(PoseError::BehindCamera);
    }
    let segment = SegmentFeature { s: ends.map(|p| p.xy() / p.z), z_m: ends.map(|p| p.z) };
    let e = segment.error(s);
    let J = analytical_image_jacobian_4(&segment.interaction().ok_or(PoseError::Degenerate)?, &p);
    let rate = J.lu().solve(&(e * gain_1_s)).ok_or(PoseError::Degenerate)?;
    Ok(AlgorithmicStep { x: x + rate * dt_s, error: e.norm() })
}

/// The least-squares twist of O relative to C for the desired feature rate K_s e_s.
///
/// J_s = L_s Gamma(-p), so that `Gamma(p) (L^T L)^-1 L^T K e` of (10.42) solves the same normal equations.
fn relative_twist<P: PointSource, const M: usize>(
    R_CO: &Rotation3<f64>,
    x: &SVector<f64, M>,
    points: &[P],
    gain_1_s: f64,
    columns: impl Fn(&SMatrix<f64, 2, 6>) -> SMatrix<f64, 2, M>,
) -> Result<(SVector<f64, M>, f64), PoseError> {
    let p = Vector3::new(x[0], x[1], x[2]);
    let mut equations = NormalEquations::<M>::new();
    let mut error2 = 0.0;
    for point in points {
        let r_o_C = R_CO * Vector3::from(point.object());
        let r_c = r_o_C + p;
        if r_c.z <= 0.0 || r_c.z.is_nan() {
            return Err(PoseError::BehindCamera);
        }
        let s = Vector2::new(r_c.x / r_c.z, r_c.y / r_c.z);
        let e = Vector2::from(point.image()) - s;
        error2 += e.norm_squared();
        let J = columns(&point_image_jacobian(&s, r_c.z, &r_o_C));
        equations.add_rows(&J, &(e * gain_1_s), 1.0);
    }
    let solution = equations.solve(0.0).ok_or(PoseError::Degenerate)?;
    Ok((solution.twist, error2.sqrt()))
}

#[cfg(test)]
mod tests;
