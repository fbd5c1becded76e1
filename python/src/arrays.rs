//! numpy arrays in and out, with words where one has the wrong shape.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vservo_cores::nalgebra::{Matrix4, Point2, Vector2};
use vservo_cores::prelude::Pose;

/// Pairs of numbers: an array of shape (n, 2).
pub fn pairs(name: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Vector2<f64>>> {
    let view = array.as_array();
    if view.ncols() != 2 {
        let shape = view.shape();
        return Err(PyValueError::new_err(format!("{name}: has shape {shape:?}, (n, 2) is needed")));
    }
    let pairs: Vec<_> = view.rows().into_iter().map(|row| Vector2::new(row[0], row[1])).collect();
    if let Some(wrong) = pairs.iter().position(|p| !(p.x.is_finite() && p.y.is_finite())) {
        return Err(PyValueError::new_err(format!("{name}[{wrong}]: is not finite")));
    }
    Ok(pairs)
}

/// An array of shape (rows, columns) from numbers row by row.
pub fn matrix<'py>(py: Python<'py>, columns: usize, numbers: &[f64]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = if columns == 0 { 0 } else { numbers.len() / columns };
    PyArray1::from_slice(py, numbers).reshape([rows, columns])
}

/// A homogeneous matrix, shape (4, 4).
pub fn homogeneous<'py>(py: Python<'py>, X: &Pose) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let m: Matrix4<f64> = X.to_homogeneous();
    matrix(py, 4, m.transpose().as_slice())
}

/// Points as an array of shape (n, 2).
pub fn points<'py>(
    py: Python<'py>,
    points: impl Iterator<Item = Point2<f64>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    matrix(py, 2, &points.flat_map(|p| [p.x, p.y]).collect::<Vec<_>>())
}
