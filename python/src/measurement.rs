//! What was seen in an image.

use crate::arrays::{homogeneous, matrix, points};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use vservo_cores::messages::{Measurement as Record, measurement_flag};
use vservo_cores::nalgebra::Point2;

/// What was seen of a target in an image.
#[pyclass(frozen)]
pub struct Measurement {
    pub record: Record,
}

#[pymethods]
impl Measurement {
    /// Whether the target was found.
    #[getter]
    fn found(&self) -> bool {
        self.record.found()
    }

    /// "found", or why it was not.
    #[getter]
    fn status(&self) -> &'static str {
        self.record.target_status().as_str()
    }

    /// Which points of the target were seen.
    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        PyArray1::from_vec(py, self.record.features().iter().map(|f| f.id).collect())
    }

    /// Their places in the image (n, 2), px; the centre of the first pixel is (0, 0).
    #[getter]
    fn px<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, self.record.features().iter().map(|f| Point2::new(f.u_px, f.v_px)))
    }

    /// The same in normalized coordinates, without distortion (n, 2).
    #[getter]
    fn normalized<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, self.record.features().iter().map(|f| Point2::new(f.x, f.y)))
    }

    /// One standard deviation of each coordinate (n,), px.
    #[getter]
    fn sd_px<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_vec(py, self.record.features().iter().map(|f| f.sd_px).collect())
    }

    /// X_CO, the target in the camera's frame (4, 4), or None.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.record.pose().map(|X_CO| homogeneous(py, &X_CO)).transpose()
    }

    /// Covariance of the pose (6, 6), m and rad, as twist [v; w] of O expressed in C; or None.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.record.pose().map(|_| matrix(py, 6, &self.record.pose_covariance)).transpose()
    }

    /// Whether a second pose explains the image almost as well.
    #[getter]
    fn ambiguous(&self) -> bool {
        self.record.flags & measurement_flag::AMBIGUOUS != 0
    }

    /// Root mean square distance between the points and those of the pose, px.
    #[getter]
    fn reprojection_rms_px(&self) -> f64 {
        self.record.reprojection_rms_px
    }

    fn __repr__(&self) -> String {
        format!("Measurement({}, {} points)", self.status(), self.record.features().len())
    }
}
