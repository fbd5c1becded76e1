//! A target in image after image.

use crate::camera::Camera;
use crate::measurement::Measurement;
use numpy::PyReadonlyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vservo_cores::prelude::{Frame, FrameHeader, ImageView, MonoNs, Prior, SpanNs, VisionSettings};
use vservo_cores::target::Kind;

/// Vision(camera, target="four_dots", track=True): finds a target, and tracks it.
///
/// Targets as on the command line: four_dots[:SIDE_M], dots:COLSxROWS:PITCH_M, chessboard:COLSxROWS:SQUARE_M, tag:FAMILY:SIZE_M:ID,
/// polygon:X_M,Y_M;..., all described in docs/targets.md.
#[pyclass]
pub struct Vision {
    core: vservo_cores::prelude::Vision,
    frames: u64,
    now: MonoNs,
}

#[pymethods]
impl Vision {
    #[new]
    #[pyo3(signature = (camera, target = "four_dots", track = true))]
    fn new(camera: &Camera, target: &str, track: bool) -> PyResult<Self> {
        let kind: Kind = target
            .parse()
            .map_err(|e: vservo_cores::target::KindError| PyValueError::new_err(e.to_string()))?;
        let settings = VisionSettings { track, ..VisionSettings::default() };
        let core = vservo_cores::prelude::Vision::new(camera.model, kind.target, settings);
        Ok(Self { core, frames: 0, now: MonoNs::ZERO })
    }

    /// process(image, after_s=0.04) -> Measurement
    ///
    /// `image` is grey, uint8, (height, width), of the camera's size; `after_s` is the time since the image before.
    #[pyo3(signature = (image, after_s = 0.04))]
    fn process(&mut self, image: PyReadonlyArray2<'_, u8>, after_s: f64) -> PyResult<Measurement> {
        if !(after_s > 0.0 && after_s <= 3600.0) {
            return Err(PyValueError::new_err("after_s: must be more than 0 and at most 3600"));
        }
        let view = image.as_array();
        let (height, width) = view.dim();
        // rows that lie apart, as those of a part of a larger image, are put together
        let pixels = view.as_standard_layout();
        let pixels = pixels.as_slice().ok_or_else(|| PyValueError::new_err("image: has no rows"))?;
        let image =
            ImageView::new(pixels, width, height).map_err(|e| PyValueError::new_err(e.to_string()))?;
        self.now = self.now + SpanNs::from_s(after_s);
        let header = FrameHeader {
            frame_id: self.frames,
            exposure: self.now,
            width_px: width as u32,
            height_px: height as u32,
            ..FrameHeader::default()
        };
        self.frames += 1;
        Ok(Measurement { record: self.core.process(&Frame { header, image }, &Prior::default()) })
    }
}
