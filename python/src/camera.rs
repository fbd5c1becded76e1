//! A camera's lens.

use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use std::path::PathBuf;
use vservo_cores::camera_model::camera_info::CameraInfo;
use vservo_cores::camera_model::{Lens, LensModel};
use vservo_cores::prelude::{CameraModel, Intrinsics};

/// Longest calibration file, bytes: real ones have a thousand.
const LONGEST_FILE: u64 = 1 << 20;

/// Camera(width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion=(), model="plumb_bob"): a lens as ROS and OpenCV describe it.
///
/// `distortion` has the coefficients of the model in their order, the last may be left out: "plumb_bob" k1, k2, p1, p2, k3;
/// "rational_polynomial" k1, k2, p1, p2, k3, k4, k5, k6; "equidistant" (fisheye) k1, k2, k3, k4. The centre of the first pixel is (0, 0).
#[pyclass(frozen)]
pub struct Camera {
    pub model: CameraModel,
}

/// A model by its name.
pub fn lens_model(name: &str) -> PyResult<LensModel> {
    let name = if name == "fisheye" { "equidistant" } else { name };
    LensModel::ALL.into_iter().find(|model| model.name() == name).ok_or_else(|| {
        let names = LensModel::ALL.map(LensModel::name).join(", ");
        PyValueError::new_err(format!("model: `{name}` is none; there are {names}"))
    })
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion = Vec::new(), model = "plumb_bob"))]
    #[allow(clippy::too_many_arguments)] // they are those of Python
    fn new(
        width_px: u32,
        height_px: u32,
        fx_px: f64,
        fy_px: f64,
        cx_px: f64,
        cy_px: f64,
        distortion: Vec<f64>,
        model: &str,
    ) -> PyResult<Self> {
        let model = lens_model(model)?;
        let names = model.coefficients();
        if distortion.len() > names.len() {
            let message = format!(
                "distortion: has {} coefficients, {} has {}",
                distortion.len(),
                model.name(),
                names.len()
            );
            return Err(PyValueError::new_err(message));
        }
        let value = |name: &str| {
            names.iter().zip(&distortion).find(|(own, _)| **own == name).map_or(0.0, |(_, v)| *v)
        };
        let intrinsics = Intrinsics { fx_px, fy_px, cx_px, cy_px, width_px, height_px };
        let model = CameraModel::new(intrinsics, Lens::of(model, value))
            .map_err(|e| PyValueError::new_err(e.to_string()))?;
        Ok(Self { model })
    }

    /// Camera.load(path) -> Camera: of a calibration file of ROS (YAML), as `vservo calibrate camera` writes it.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let wrong = |what: String| PyValueError::new_err(format!("{}: {what}", path.display()));
        if std::fs::metadata(&path)?.len() > LONGEST_FILE {
            return Err(wrong("is too long for a calibration file".into()));
        }
        let text = std::fs::read_to_string(&path)?;
        let info = CameraInfo::read(&text).map_err(|e| wrong(e.to_string()))?;
        Ok(Self { model: info.camera().map_err(|e| wrong(e.to_string()))? })
    }

    /// save(path, name="camera"): writes a calibration file of ROS, for `camera.lens.file` of a run file.
    #[pyo3(signature = (path, name = "camera"))]
    fn save(&self, path: PathBuf, name: &str) -> PyResult<()> {
        let failed = |cause| PyOSError::new_err(format!("{}: cannot be written: {cause}", path.display()));
        vservo_cores::rt::write_file(&path, CameraInfo::new(name, &self.model).write()).map_err(failed)
    }

    /// (width, height), px.
    #[getter]
    fn size_px(&self) -> (u32, u32) {
        let i = self.model.intrinsics();
        (i.width_px, i.height_px)
    }

    /// (fx, fy), px.
    #[getter]
    fn f_px(&self) -> (f64, f64) {
        let i = self.model.intrinsics();
        (i.fx_px, i.fy_px)
    }

    /// The principal point (cx, cy), px.
    #[getter]
    fn c_px(&self) -> (f64, f64) {
        let i = self.model.intrinsics();
        (i.cx_px, i.cy_px)
    }

    /// The name of the model.
    #[getter]
    fn model(&self) -> &'static str {
        self.model.lens().model().name()
    }

    /// Its coefficients, in its order.
    #[getter]
    fn distortion(&self) -> Vec<f64> {
        self.model.lens().coefficients().into_iter().map(|(_, value)| value).collect()
    }

    fn __repr__(&self) -> String {
        let i = self.model.intrinsics();
        format!("Camera({} x {} px, fx {} px, fy {} px)", i.width_px, i.height_px, i.fx_px, i.fy_px)
    }
}
