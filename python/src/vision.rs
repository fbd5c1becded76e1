//! A target in image after image.

use crate::arrays::grey;
use crate::camera::Camera;
use crate::measurement::Measurement;
use numpy::PyReadonlyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vservo_cores::messages::{FeaturePoint, Measurement as Record};
use vservo_cores::prelude::{
    CameraModel, Distortion, Frame, FrameHeader, Intrinsics, MonoNs, Prior, SpanNs, TargetStatus,
    VisionSettings,
};
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
        let settings = VisionSettings { track, ..VisionSettings::default() };
        let core = core(camera.model, target, settings)?;
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
        let pixels = grey(&image)?;
        let image = pixels.view()?;
        let (width, height) = (image.width(), image.height());
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

/// Standard deviation of the errors of real lenses and targets against their description, px, as for `vservo detect`.
const MODEL_SD_PX: f64 = 0.2;

/// detect(image, target, camera=None) -> Measurement
///
/// Looks for a target in one image (grey, uint8, (height, width)), as `vservo detect`: every kind that `Vision` takes. Without a camera
/// there are the points in px alone: `normalized` is nan, and `pose` None.
#[pyfunction]
#[pyo3(signature = (image, target, camera = None))]
pub fn detect(
    image: PyReadonlyArray2<'_, u8>,
    target: &str,
    camera: Option<&Camera>,
) -> PyResult<Measurement> {
    let settings = VisionSettings { track: false, model_sd_px: MODEL_SD_PX, ..VisionSettings::default() };
    if let Some(camera) = camera {
        let mut vision = Vision { core: core(camera.model, target, settings)?, frames: 0, now: MonoNs::ZERO };
        return vision.process(image, 0.04);
    }
    let pixels = grey(&image)?;
    let view = pixels.view()?;
    // About 45 degrees wide: where nothing is known, good enough to tell points apart.
    let f_px = 1.2 * view.width().max(view.height()) as f64;
    let middle = |length: usize| 0.5 * (length as f64 - 1.0);
    let (width_px, height_px) = (view.width() as u32, view.height() as u32);
    let (cx_px, cy_px) = (middle(view.width()), middle(view.height()));
    let i = Intrinsics { fx_px: f_px, fy_px: f_px, cx_px, cy_px, width_px, height_px };
    let camera =
        CameraModel::new(i, Distortion::default()).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let mut record = Record::default();
    match core(camera, target, settings)?.points_of(&view) {
        Err(status) => record.status = status as u32,
        Ok(seen) => {
            record.status = TargetStatus::Found as u32;
            let (x, y) = (f64::NAN, f64::NAN);
            for ((place, found), px) in record.features.iter_mut().zip(seen.found).zip(seen.px) {
                *place =
                    FeaturePoint { id: found.id.into(), u_px: px.x, v_px: px.y, x, y, sd_px: found.sd_px };
                record.feature_count += 1;
            }
        }
    }
    Ok(Measurement { record })
}

fn core(
    camera: CameraModel,
    target: &str,
    settings: VisionSettings,
) -> PyResult<vservo_cores::prelude::Vision> {
    let kind: Kind =
        target.parse().map_err(|e: vservo_cores::target::KindError| PyValueError::new_err(e.to_string()))?;
    Ok(vservo_cores::prelude::Vision::new(camera, kind.target, settings))
}
