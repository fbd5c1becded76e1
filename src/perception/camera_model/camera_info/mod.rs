//! The calibration file of ROS (`camera_info`, YAML) <-> a camera.
//!
//! ```text
//! image_width, image_height, camera_name
//! camera_matrix            3 x 3   fx 0 cx / 0 fy cy / 0 0 1
//! distortion_model         plumb_bob (k1 k2 p1 p2, k3), rational_polynomial (k1 k2 p1 p2 k3 k4 k5 k6), equidistant (k1 k2 k3 k4)
//! distortion_coefficients  1 x 4, 5 or 8; OpenCV's 12 and 14, where those of a thin prism and a tilted sensor are zero
//! rectification_matrix     3 x 3   of a stereo pair; the unit matrix for one camera
//! projection_matrix        3 x 4   of the rectified image; the camera matrix for one camera
//! ```
//! Everything else in a file is passed over. Angles between the axes of pixels (skew) are not known here, and refused.

mod pair;
mod xml;
mod yaml;

use super::{CameraModel, CameraModelError, Intrinsics, Lens, LensModel};
pub use pair::PairInfo;
use std::fmt::Write;
use thiserror::Error;
use yaml::Entries;

/// Longest name of a camera, characters: it comes into messages and files, which it must not fill. Chosen.
const LONGEST_NAME: usize = 200;

/// Coefficients of OpenCV's rational lens. As many as OpenCV says, in its documentation of `calibrateCamera`.
const RATIONAL: usize = 8;
/// The same with a thin prism, and with a tilted sensor too. As OpenCV says there.
const WITH_PRISM_AND_TILT: [usize; 2] = [12, 14];

/// A calibration file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("line {line}: {message}")]
pub struct CameraInfoError {
    /// Where, from 1; the last line for what is missing.
    pub line: usize,
    /// The key and what is wrong with it.
    pub message: String,
}

/// What a calibration file says.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraInfo {
    /// What the camera is called.
    pub camera_name: String,
    /// Camera matrix and size.
    pub intrinsics: Intrinsics,
    /// Distortion model and coefficients.
    pub lens: Lens,
    /// Rotation to the rectified image of a stereo pair, row by row.
    pub rectification: [f64; 9],
    /// Projection of the rectified image, row by row.
    pub projection: [f64; 12],
}

impl CameraInfo {
    /// What the file of a camera that stands alone says: of the whole image, where the camera reads a region.
    #[must_use]
    pub fn new(camera_name: &str, camera: &CameraModel) -> Self {
        Self::of(camera_name, camera.full_intrinsics(), *camera.lens())
    }

    fn of(camera_name: &str, intrinsics: Intrinsics, lens: impl Into<Lens>) -> Self {
        Self {
            camera_name: camera_name.chars().take(LONGEST_NAME).collect(),
            intrinsics,
            lens: lens.into(),
            rectification: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            projection: projection_of(&intrinsics),
        }
    }

    /// The camera.
    ///
    /// # Errors
    /// [`CameraModelError`] when the numbers describe no usable camera.
    pub fn camera(&self) -> Result<CameraModel, CameraModelError> {
        CameraModel::new(self.intrinsics, self.lens)
    }

    /// Reads a calibration file. The matrices of stereo pairs and the name may be missing; the lens may be called `fisheye`
    /// instead of `equidistant`, and a plumb-bob lens may lack k3. Files of OpenCV (YAML and XML) and of ViSP (XML) are read too.
    ///
    /// # Errors
    /// [`CameraInfoError`] says the line, the key and what is wrong.
    pub fn read(text: &str) -> Result<Self, CameraInfoError> {
        if xml::is_xml(text) {
            return xml::read(text);
        }
        let entries = Entries::read(text)?;
        let side = |key| {
            let side: u32 = entries.number(key, "a whole number of pixels")?;
            if (1..=65536).contains(&side) {
                return Ok(side);
            }
            Err(entries.wrong(key, format!("is {side}, allowed is 1 to 65536")))
        };
        let (width_px, height_px) = (side("image_width")?, side("image_height")?);
        let k: [f64; 9] =
            entries.matrix("camera_matrix", 3)?.ok_or_else(|| entries.missing("camera_matrix"))?;
        let [fx_px, skew, cx_px, zero, fy_px, cy_px, bottom @ ..] = k;
        if skew != 0.0 || zero != 0.0 || bottom != [0.0, 0.0, 1.0] {
            let message = "is not of the form fx 0 cx / 0 fy cy / 0 0 1: calibrate without skew";
            return Err(entries.wrong("camera_matrix", message));
        }
        let intrinsics = Intrinsics { fx_px, fy_px, cx_px, cy_px, width_px, height_px };
        let lens = read_lens(&entries)?;
        let unit = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        Ok(Self {
            camera_name: entries
                .text("camera_name")?
                .unwrap_or("camera")
                .chars()
                .take(LONGEST_NAME)
                .collect(),
            intrinsics,
            lens,
            rectification: entries.matrix("rectification_matrix", 3)?.unwrap_or(unit),
            projection: entries.matrix("projection_matrix", 3)?.unwrap_or(projection_of(&intrinsics)),
        })
    }

    /// The file's text.
    #[must_use]
    pub fn write(&self) -> String {
        let Intrinsics { fx_px, fy_px, cx_px, cy_px, width_px, height_px } = self.intrinsics;
        let coefficients: Vec<f64> = self.lens.coefficients().into_iter().map(|(_, value)| value).collect();
        let mut text = format!(
            "image_width: {width_px}\nimage_height: {height_px}\ncamera_name: {}\n",
            yaml::word(&self.camera_name)
        );
        let matrix = |text: &mut String, key: &str, rows: usize, data: &[f64]| {
            let numbers = data.iter().map(|value| yaml::number(*value)).collect::<Vec<_>>().join(", ");
            let cols = data.len() / rows;
            // a String takes everything
            let _ = write!(text, "{key}:\n  rows: {rows}\n  cols: {cols}\n  data: [{numbers}]\n");
        };
        let k = [fx_px, 0.0, cx_px, 0.0, fy_px, cy_px, 0.0, 0.0, 1.0];
        matrix(&mut text, "camera_matrix", 3, &k);
        let _ = writeln!(text, "distortion_model: {}", self.lens.model().name());
        matrix(&mut text, "distortion_coefficients", 1, &coefficients);
        matrix(&mut text, "rectification_matrix", 3, &self.rectification);
        matrix(&mut text, "projection_matrix", 3, &self.projection);
        text
    }
}

fn projection_of(i: &Intrinsics) -> [f64; 12] {
    [i.fx_px, 0.0, i.cx_px, 0.0, 0.0, i.fy_px, i.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0]
}

fn read_lens(entries: &Entries) -> Result<Lens, CameraInfoError> {
    const MODEL: &str = "distortion_model";
    const COEFFICIENTS: &str = "distortion_coefficients";
    let mut values = entries.row(COEFFICIENTS)?.ok_or_else(|| entries.missing(COEFFICIENTS))?;
    if WITH_PRISM_AND_TILT.contains(&values.len()) {
        if values.iter().skip(RATIONAL).any(|value| *value != 0.0) {
            let message = format!(
                "has {} entries, of which those after the eighth bend the image as a thin prism or a tilted sensor (s1 to s4, tau_x, tau_y), which is not known here: calibrate without \
                 CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL",
                values.len()
            );
            return Err(entries.wrong(COEFFICIENTS, message));
        }
        values.truncate(RATIONAL);
    }
    let word = match (entries.text(MODEL)?, values.len()) {
        (Some(word), _) => word,
        // OpenCV names no model: these numbers of coefficients are those of one alone.
        (None, 5) => "plumb_bob",
        (None, 8) => "rational_polynomial",
        (None, count) => {
            let message = format!(
                "has {count} entries, which tell no model: add `{MODEL}: plumb_bob` (k1, k2, p1, p2), or equidistant for a fisheye lens"
            );
            return Err(entries.wrong(COEFFICIENTS, message));
        }
    };
    let called =
        |model: &LensModel| model.name() == word || (*model == LensModel::Equidistant && word == "fisheye");
    let model = LensModel::ALL.into_iter().find(called).ok_or_else(|| {
        let known = LensModel::ALL.map(LensModel::name).join(", ");
        entries.wrong(MODEL, format!("is `{word}`, known are {known}"))
    })?;
    if model == LensModel::PlumbBob && values.len() == 4 {
        values.push(0.0);
    }
    let names = model.coefficients();
    // Of OpenCV's longer rows what such a lens does not have is zero.
    if model == LensModel::PlumbBob && values.iter().skip(names.len()).all(|value| *value == 0.0) {
        values.truncate(names.len());
    }
    if values.len() != names.len() {
        let message = format!(
            "has {} entries, a {} lens has {}: {}",
            values.len(),
            model.name(),
            names.len(),
            names.join(", ")
        );
        return Err(entries.wrong(COEFFICIENTS, message));
    }
    Ok(Lens::of(model, |name| {
        names.iter().zip(&values).find(|(n, _)| **n == name).map_or(0.0, |(_, value)| *value)
    }))
}

#[cfg(test)]
mod tests;
