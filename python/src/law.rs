//! A law and a pose from image points.

use crate::arrays::{Numbers2, homogeneous, pairs};
use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArrayLike1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vservo_cores::prelude::{Correspondence, FeatureStack, PointFeature, solve_twist};

/// Rows of the stack: 64 points.
const ROWS: usize = 128;

/// camera_velocity(s, s_desired, depths_m, gain_1_s=1.0) -> array [vx vy vz wx wy wz], m/s and rad/s, in the camera's frame
///
/// Scheme D of the text, (10.89): the velocity of a camera that shall see the points `s` (n, 2) at `s_desired` (n, 2), in normalized
/// coordinates; `depths_m` (n,) are their distances along the optical axis. Three points fix it but for singular views.
#[pyfunction]
#[pyo3(signature = (s, s_desired, depths_m, gain_1_s = 1.0))]
pub fn camera_velocity<'py>(
    py: Python<'py>,
    s: Numbers2<'py>,
    s_desired: Numbers2<'py>,
    depths_m: PyArrayLike1<'py, f64, AllowTypeChange>,
    gain_1_s: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (s, s_d) = (pairs("s", &s)?, pairs("s_desired", &s_desired)?);
    let depths = depths_m.as_array();
    if s.len() != s_d.len() || s.len() != depths.len() {
        let message = format!(
            "s has {} points, s_desired {}, depths_m {}: as many are needed",
            s.len(),
            s_d.len(),
            depths.len()
        );
        return Err(PyValueError::new_err(message));
    }
    let mut stack = FeatureStack::<ROWS>::new();
    for ((s, s_d), z_m) in s.iter().zip(&s_d).zip(depths.iter()) {
        let point = PointFeature { s: *s, z_m: *z_m };
        stack.push(&point, s_d, 1.0).map_err(|e| PyValueError::new_err(e.to_string()))?;
    }
    let solution = solve_twist(&stack, gain_1_s, 0.0);
    let solution =
        solution.ok_or_else(|| PyValueError::new_err("these points do not fix the camera's motion"))?;
    Ok(PyArray1::from_slice(py, solution.twist.as_slice()))
}

/// planar_pose(points_m, s) -> [(X_CO, rms), ...]
///
/// Poses of a plane from four or more of its points: `points_m` (n, 2) in the object's frame, `s` (n, 2) in normalized coordinates. The
/// better one comes first; where a second one explains the image too (the planar ambiguity), it follows. `rms` is in normalized units.
#[pyfunction]
pub fn planar_pose<'py>(
    py: Python<'py>,
    points_m: Numbers2<'py>,
    s: Numbers2<'py>,
) -> PyResult<Vec<(Bound<'py, PyArray2<f64>>, f64)>> {
    let (r, s) = (pairs("points_m", &points_m)?, pairs("s", &s)?);
    if r.len() != s.len() {
        let message = format!("points_m has {} points, s {}: as many are needed", r.len(), s.len());
        return Err(PyValueError::new_err(message));
    }
    let pairs: Vec<_> = r.into_iter().zip(s).map(|(r, s)| Correspondence { r, s }).collect();
    let found =
        vservo_cores::prelude::planar_pose(&pairs).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let all = std::iter::once(found.best).chain(found.other);
    all.map(|solution| Ok((homogeneous(py, &solution.X_CO)?, solution.rms))).collect()
}
