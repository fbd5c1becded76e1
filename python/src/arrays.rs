//! numpy arrays in and out, with words where one has the wrong shape.

use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArrayLike2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vservo_cores::imaging::ImageView;
use vservo_cores::nalgebra::{Matrix4, Point2, Vector2};
use vservo_cores::prelude::Pose;

/// Numbers of two axes: an array, or lists of lists.
pub type Numbers2<'py> = PyArrayLike2<'py, f64, AllowTypeChange>;

/// The pixels of a grey image; rows that lie apart, as those of a part of a larger image, are put together.
pub struct Grey {
    pixels: Vec<u8>,
    width: usize,
    height: usize,
}

impl Grey {
    pub fn view(&self) -> PyResult<ImageView<'_>> {
        ImageView::new(&self.pixels, self.width, self.height)
            .map_err(|e| PyValueError::new_err(e.to_string()))
    }
}

/// The same of an array (height, width).
pub fn grey(image: &PyReadonlyArray2<'_, u8>) -> PyResult<Grey> {
    let view = image.as_array();
    let (height, width) = view.dim();
    Ok(Grey { pixels: view.iter().copied().collect(), width, height })
}

/// Pairs of numbers: an array of shape (n, 2).
pub fn pairs(name: &str, array: &Numbers2<'_>) -> PyResult<Vec<Vector2<f64>>> {
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
    let rows = numbers.len().checked_div(columns).unwrap_or(0);
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
