//! How a camera is calibrated.

use super::CameraCalibrationError;
use crate::calibration::bundle::Freedom;
use crate::camera_model::LensModel;

/// How a camera is calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationSettings {
    /// The model of the lens.
    pub model: LensModel,
    /// Which of its parameters are estimated.
    pub freedom: Freedom,
    /// Coefficients of the highest orders are fixed at zero where the corners do not tell them from that: free, they would bend the
    /// image's corners.
    pub drop_untold: bool,
    /// The board may be bent: a parabola along each side is estimated with the camera.
    pub warp: bool,
    /// What lens model, paper and print may be wrong by beside the corners' own noise, px: a floor, so that very sharp corners do
    /// not decide everything.
    pub model_sd_px: f64,
    /// Corners with errors beyond so many standard deviations are left out; infinite: none.
    pub outlier_sd: f64,
}

impl CalibrationSettings {
    /// All parameters of a lens model, a flat board, corners within 5 standard deviations.
    #[must_use]
    pub fn of(model: LensModel) -> Self {
        Self {
            model,
            freedom: Freedom::of(model),
            drop_untold: true,
            warp: false,
            model_sd_px: 0.1,
            outlier_sd: 5.0,
        }
    }

    pub(crate) fn check(&self, (width, height): (u32, u32)) -> Result<(), CameraCalibrationError> {
        let refused = |name, value, wanted| Err(CameraCalibrationError::Setting { name, value, wanted });
        if !(1e-6..=1e3).contains(&self.model_sd_px) {
            return refused("model_sd_px", self.model_sd_px, "a number from 1e-6 to 1000");
        }
        if !(self.outlier_sd >= 2.0) {
            return refused("outlier_sd", self.outlier_sd, "a number of at least 2, or infinity");
        }
        for (name, side) in [("the image's width", width), ("the image's height", height)] {
            if !(16..=65536).contains(&side) {
                return refused(name, f64::from(side), "a size from 16 to 65536 px");
            }
        }
        Ok(())
    }
}

impl Default for CalibrationSettings {
    fn default() -> Self {
        Self::of(LensModel::PlumbBob)
    }
}
