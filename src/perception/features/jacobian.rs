//! From interaction matrices to image Jacobians: (10.21), (10.32), (10.35).

use crate::geometry::gamma;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// The image Jacobian `J_s = L_s Gamma(-p_CO_C)`, (10.21): `s_dot = J_s V` for the twist of O relative to C, (10.17).
#[must_use]
pub fn image_jacobian<const K: usize>(L_s: &SMatrix<f64, K, 6>, p_CO_C: &Vector3<f64>) -> SMatrix<f64, K, 6> {
    L_s * gamma(&-p_CO_C)
}

/// T(phi) with `w = T phi_dot` for the angles phi = (about z, y, x) of `R = Rz Ry Rx`, rad; singular at y = +-pi/2.
#[must_use]
pub fn euler_zyx_rate(phi: &Vector3<f64>) -> Matrix3<f64> {
    let ((sz, cz), (sy, cy)) = (phi.x.sin_cos(), phi.y.sin_cos());
    Matrix3::new(0.0, -sz, cz * cy, 0.0, cz, sz * cy, 1.0, 0.0, -sy)
}

/// The analytical image Jacobian `J_A = L_s Gamma(-p) T_A(phi)`, (10.35), for `x = [p_CO_C; phi]`, phi as in
/// [`euler_zyx_rate`].
#[must_use]
pub fn analytical_image_jacobian<const K: usize>(
    L_s: &SMatrix<f64, K, 6>,
    p_CO_C: &Vector3<f64>,
    phi: &Vector3<f64>,
) -> SMatrix<f64, K, 6> {
    let mut J = image_jacobian(L_s, p_CO_C);
    let angular = J.fixed_columns::<3>(3) * euler_zyx_rate(phi);
    J.fixed_columns_mut::<3>(3).copy_from(&angular);
    J
}

/// The analytical image Jacobian for m = 4, `x = [p_CO_C; alpha]`, (10.33): columns x, y, z and rotation about z of
/// J_s, as T_A is the identity.
#[must_use]
pub fn analytical_image_jacobian_4<const K: usize>(
    L_s: &SMatrix<f64, K, 6>,
    p_CO_C: &Vector3<f64>,
) -> SMatrix<f64, K, 4> {
    planar_columns(&image_jacobian(L_s, p_CO_C))
}

/// Columns x, y, z and rotation about z: the motions of a SCARA arm's camera.
#[must_use]
pub fn planar_columns<const K: usize>(L: &SMatrix<f64, K, 6>) -> SMatrix<f64, K, 4> {
    SMatrix::from_columns(&[L.column(0), L.column(1), L.column(2), L.column(5)])
}
