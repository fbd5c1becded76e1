//! Taught goals, and poses from Python's numbers.

use crate::arrays::matrix;
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use std::path::PathBuf;
use vservo_cores::config::GoalFile;
use vservo_cores::geometry::{Pose, closest_rotation};
use vservo_cores::nalgebra::{Matrix3, Quaternion, Unit, UnitQuaternion, Vector3};
use vservo_cores::rt::write_file;

/// How far the products of a rotation's columns may be from those of unit vectors: three decimals are off by 5e-4 each, four in a sum by 2e-3.
const ROUNDING: f64 = 2e-3;

/// A taught goal: what the camera sees there, and the posture of the arm. `Goal.load(path)` reads a file of `vservo teach`.
#[pyclass(frozen)]
pub struct Goal {
    pub file: GoalFile,
}

#[pymethods]
impl Goal {
    /// Goal.load(path) -> Goal: of a file of `vservo teach`, of `vservo ctl teach --save` or of `save`.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        GoalFile::load(&path).map(|file| Self { file }).map_err(PyValueError::new_err)
    }

    /// save(path): writes it for `vservo ctl goal`, `vservo ctl goto` and `servo.set_point.file`.
    pub fn save(&self, path: PathBuf) -> PyResult<()> {
        let failed = |cause| PyOSError::new_err(format!("{}: cannot be written: {cause}", path.display()));
        write_file(&path, self.file.to_toml()).map_err(failed)
    }

    /// The kind of target.
    #[getter]
    fn target(&self) -> &str {
        &self.file.target
    }

    /// The name of the target in the run file it was taught with; None where the file does not tell: it is of the first one.
    #[getter]
    fn target_name(&self) -> Option<&str> {
        self.file.target_name.as_deref()
    }

    /// Which points of the target (n,).
    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray1::from_vec(py, self.file.features.iter().map(|feature| feature.id).collect())
    }

    /// Their desired normalized coordinates (n, 2).
    #[getter]
    fn normalized<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, 2, &self.file.features.iter().flat_map(|feature| feature.s).collect::<Vec<_>>())
    }

    /// The posture in which it was taught (joints,), rad or m; None where the file has none.
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let q = &self.file.q_rad_or_m;
        (!q.is_empty()).then(|| PyArray1::from_slice(py, q))
    }

    fn __repr__(&self) -> String {
        format!("Goal({}, {} points)", self.file.target, self.file.features.len())
    }
}

/// `M` numbers.
pub fn fixed<const M: usize>(name: &str, numbers: &[f64]) -> PyResult<[f64; M]> {
    numbers
        .try_into()
        .map_err(|_| PyValueError::new_err(format!("{name}: has {} numbers, {M} are needed", numbers.len())))
}

/// A rotation from roll, pitch and yaw in deg, or a quaternion; none is the identity.
pub fn rotation(rpy_deg: Option<Vec<f64>>, xyzw: Option<Vec<f64>>) -> PyResult<UnitQuaternion<f64>> {
    match (rpy_deg, xyzw) {
        (Some(_), Some(_)) => Err(PyValueError::new_err(
            "rotation_xyzw: says what rotation_rpy_deg says too: leave out one of them",
        )),
        (Some(rpy_deg), None) => {
            let [roll, pitch, yaw] = fixed("rotation_rpy_deg", &rpy_deg)?.map(f64::to_radians);
            Ok(UnitQuaternion::from_euler_angles(roll, pitch, yaw))
        }
        // What is no unit quaternion is refused by control, as its numbers tell.
        (None, Some(xyzw)) => {
            let [x, y, z, w] = fixed("rotation_xyzw", &xyzw)?;
            Ok(Unit::new_unchecked(Quaternion::new(w, x, y, z)))
        }
        (None, None) => Ok(UnitQuaternion::identity()),
    }
}

/// A pose from a homogeneous matrix (4, 4).
pub fn pose(name: &str, rows: &[Vec<f64>]) -> PyResult<Pose> {
    let wrong = |what: &str| PyValueError::new_err(format!("{name}: {what}"));
    let rows: Vec<[f64; 4]> = rows.iter().map(|row| fixed(name, row)).collect::<PyResult<_>>()?;
    let [x, y, z, last] = rows[..] else { return Err(wrong("has another shape than (4, 4)")) };
    if last != [0.0, 0.0, 0.0, 1.0] {
        return Err(wrong("its last row is not [0, 0, 0, 1]"));
    }
    let top = [x, y, z];
    let R = Matrix3::from_fn(|i, j| top[i][j]);
    let off = (R.transpose() * R - Matrix3::identity()).amax();
    let closest = if off <= ROUNDING && R.determinant() > 0.0 { closest_rotation(&R) } else { None };
    let closest = closest.ok_or_else(|| wrong("its upper left 3 x 3 is no rotation"))?;
    let p = Vector3::new(x[3], y[3], z[3]);
    Ok(Pose::from_parts(p.into(), UnitQuaternion::from_rotation_matrix(&closest)))
}
