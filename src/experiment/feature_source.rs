//! The camera of an experiment: projected points, a camera whose calibration is wrong, or rendered images.

use super::ExperimentError;
use crate::camera_model::{CameraModel, Distortion, Intrinsics};
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::messages::FrameHeader;
use crate::scene::{Renderer, SceneLook, SensorModel};
use crate::target::FourDots;
use crate::time::MonoNs;
use crate::vision::{Frame, Prior, Vision, VisionSettings};
use nalgebra::Vector2;

/// Time between two frames, as the chapter has it: T = 0.04 s.
const FRAME_NS: i64 = 40_000_000;

/// The lens of the rendered runs and of the calibration experiment: 800 px, VGA, no distortion.
///
/// # Errors
/// [`ExperimentError::Cell`] never in practice: the values are constants.
pub(super) fn camera() -> Result<CameraModel, ExperimentError> {
    let intrinsics =
        Intrinsics { fx_px: 800.0, fy_px: 800.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
    CameraModel::new(intrinsics, Distortion::default()).map_err(cell)
}

fn cell(e: impl std::fmt::Display) -> ExperimentError {
    ExperimentError::Cell { cause: e.to_string() }
}

/// What the program believes of the camera, against what the camera is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Miscalibration {
    /// Believed focal length over the true one.
    pub focal_ratio: f64,
    /// Believed principal point minus the true one, px.
    pub principal_px: Vector2<f64>,
    /// True focal length, px.
    pub f_px: f64,
}

impl Miscalibration {
    /// The normalized coordinates that the program computes for a point truly seen at `s`, (5.41)-(5.45).
    #[must_use]
    pub fn believed(&self, s: &Vector2<f64>) -> Vector2<f64> {
        (s * self.f_px - self.principal_px) / (self.f_px * self.focal_ratio)
    }
}

/// A source of image features.
#[derive(Debug)]
pub enum FeatureSource {
    /// The points as the pin-hole model projects them.
    Ideal,
    /// The same through a wrong calibration.
    Miscalibrated(Miscalibration),
    /// Pixels, through renderer and detection.
    Rendered(Box<RenderedFeatures>),
}

/// Renderer and vision core of one run.
#[derive(Debug)]
pub struct RenderedFeatures {
    renderer: Renderer,
    vision: Vision,
    pixels: Vec<u8>,
}

impl RenderedFeatures {
    /// A camera of 640 x 480 px with noise, blur and vignetting; the target has dots at P1 ... P4.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`] when a part refuses its constants.
    pub fn new(seed: u64) -> Result<Self, ExperimentError> {
        let camera = camera()?;
        let target = FourDots::new(0.1, 0.015, 0.010, 0.030).map_err(cell)?;
        let sensor = SensorModel { seed, ..SensorModel::default() };
        let renderer = Renderer::new(camera, target, SceneLook::default(), sensor).map_err(cell)?;
        let vision = Vision::new(camera, target, VisionSettings::default());
        let i = camera.intrinsics();
        let pixels = vec![0; i.width_px as usize * i.height_px as usize];
        Ok(Self { renderer, vision, pixels })
    }
}

impl FeatureSource {
    /// What is measured of P1 ... P4 (normalized) of an object at `X_CO`, truly seen at `s`.
    ///
    /// # Errors
    /// Why there is no measurement.
    pub fn look(
        &mut self,
        X_CO: &Pose,
        s: &[Vector2<f64>; 4],
        index: usize,
    ) -> Result<[Vector2<f64>; 4], String> {
        match self {
            Self::Ideal => Ok(*s),
            Self::Miscalibrated(m) => Ok(s.map(|s| m.believed(&s))),
            Self::Rendered(source) => source.look(X_CO, index),
        }
    }
}

impl RenderedFeatures {
    fn look(&mut self, X_CO: &Pose, index: usize) -> Result<[Vector2<f64>; 4], String> {
        self.renderer.render(&[*X_CO], index as u64, &mut self.pixels);
        let i = *self.renderer.camera().intrinsics();
        let header = FrameHeader {
            frame_id: index as u64,
            exposure: MonoNs(index as i64 * FRAME_NS),
            width_px: i.width_px,
            height_px: i.height_px,
            ..FrameHeader::default()
        };
        let image = ImageView::new(&self.pixels, i.width_px as usize, i.height_px as usize)
            .map_err(|e| e.to_string())?;
        let m = self.vision.process(&Frame { header, image }, &Prior::default());
        match m.features() {
            [a, b, c, d] if m.found() => Ok([a, b, c, d].map(|f| Vector2::new(f.x, f.y))),
            _ => Err(format!("vision found no target: {:?}", m.target_status())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::cell::{desired_object, pose_of, project};
    use super::*;

    #[test]
    fn rendered_points_are_the_projected_ones() {
        let X_CO = pose_of(&desired_object());
        let s = project(&X_CO).unwrap();
        let mut source = FeatureSource::Rendered(Box::new(RenderedFeatures::new(1).unwrap()));
        let seen = source.look(&X_CO, &s, 0).unwrap();
        for (a, b) in seen.iter().zip(&s) {
            assert!((a - b).norm() * 800.0 < 0.1, "{a} {b}");
        }
        let away = pose_of(&(desired_object() + nalgebra::Vector4::new(3.0, 0.0, 0.0, 0.0)));
        assert!(source.look(&away, &s, 1).is_err());
    }

    #[test]
    fn a_wrong_calibration_scales_and_shifts() {
        let wrong = Miscalibration { focal_ratio: 1.1, principal_px: Vector2::new(20.0, 0.0), f_px: 800.0 };
        let seen = wrong.believed(&Vector2::new(0.1, -0.2));
        assert!((seen - Vector2::new(60.0 / 880.0, -160.0 / 880.0)).norm() < 1e-15);
    }
}
