//! A camera's lens.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vservo_cores::prelude::{CameraModel, Distortion, Intrinsics};

/// Camera(width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion=(k1, k2, p1, p2, k3)): a lens as `plumb_bob` of ROS describes it.
/// The centre of the first pixel is (0, 0).
#[pyclass(frozen)]
pub struct Camera {
    pub model: CameraModel,
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion = (0.0, 0.0, 0.0, 0.0, 0.0)))]
    fn new(
        width_px: u32,
        height_px: u32,
        fx_px: f64,
        fy_px: f64,
        cx_px: f64,
        cy_px: f64,
        distortion: (f64, f64, f64, f64, f64),
    ) -> PyResult<Self> {
        let intrinsics = Intrinsics { fx_px, fy_px, cx_px, cy_px, width_px, height_px };
        let (k1, k2, p1, p2, k3) = distortion;
        let lens = Distortion { k1, k2, p1, p2, k3 };
        let model = CameraModel::new(intrinsics, lens).map_err(|e| PyValueError::new_err(e.to_string()))?;
        Ok(Self { model })
    }

    fn __repr__(&self) -> String {
        let i = self.model.intrinsics();
        format!("Camera({} x {} px, fx {} px, fy {} px)", i.width_px, i.height_px, i.fx_px, i.fy_px)
    }
}
