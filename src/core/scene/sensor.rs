//! From exact grey levels to the bytes of a sensor: vignetting, noise, rounding, in 16-bit fixed point.
//!
//! ```text
//! byte = clamp((gain(x, y) * level + noise) rounded),   gain = 1 - fall-off (r / r_corner)^2
//! ```
//! The gain is a row's value minus a column's, so that no table of pixels is needed. Noise comes from one table of Gaussian samples, which each
//! row of each frame reads from a hashed place on. The arithmetic is that of integers: the bytes are the same on every
//! machine, whichever instructions are used.

use super::error::{SceneError, in_range};
use crate::camera_model::Region;
use crate::imaging::simd::has_avx2;
use crate::linalg::Random;
use std::ops::RangeInclusive;

/// Longest side of an image that can be rendered, px: chosen above every camera that a loop is closed with, so that tables of a row have a
/// bound.
pub const MAX_SIDE_PX: u32 = 4096;

/// Fraction bits of a grey level: eight bits of level and seven of fraction must fit a signed word of 16, in which noise is added.
pub(super) const LEVEL_BITS: u32 = 7;
/// Samples of noise. Chosen by hand: an image in VGA needs five times as many, but begins at another place for each row, so that two rows are alike
/// by chance alone.
const TABLE: usize = 1 << 16;
/// Samples that are appended to the table, so that a row can begin anywhere in it: as many as the longest row has pixels.
const LONGEST_ROW: usize = MAX_SIDE_PX as usize;

/// What the sensor and the optics add to an ideal image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorModel {
    /// Standard deviation of the additive noise of each pixel, grey levels, [`Self::NOISE_SD_LEVELS`].
    pub noise_sd_levels: f64,
    /// Standard deviation of the optics' Gaussian blur, px, [`Self::BLUR_SD_PX`].
    pub blur_sd_px: f64,
    /// How much darker the corners are than the centre, [`Self::VIGNETTING`].
    pub vignetting: f64,
    /// Noise of different seeds is independent.
    pub seed: u64,
}

impl Default for SensorModel {
    /// A good industrial camera: 2 levels of noise, 0.5 px of blur, 10 % darker corners.
    fn default() -> Self {
        Self { noise_sd_levels: 2.0, blur_sd_px: 0.5, vignetting: 0.1, seed: 0 }
    }
}

impl SensorModel {
    /// What [`Self::noise_sd_levels`] may be. Four of the largest deviations fit the table's words of 16 bits with
    /// their seven of fraction, so that hardly a sample is cut off.
    pub const NOISE_SD_LEVELS: RangeInclusive<f64> = 0.0..=64.0;
    /// What [`Self::blur_sd_px`] may be. Chosen, since bands about edges grow with it, and an image so blurred has no small dots any more.
    pub const BLUR_SD_PX: RangeInclusive<f64> = 0.0..=8.0;
    /// What [`Self::vignetting`] may be: a share of the light that is lost, since no lens gives any.
    pub const VIGNETTING: RangeInclusive<f64> = 0.0..=1.0;

    /// Neither noise, nor blur, nor vignetting.
    #[must_use]
    pub fn ideal() -> Self {
        Self { noise_sd_levels: 0.0, blur_sd_px: 0.0, vignetting: 0.0, seed: 0 }
    }

    pub(super) fn check(&self) -> Result<(), SceneError> {
        in_range("noise_sd_levels", self.noise_sd_levels, &Self::NOISE_SD_LEVELS)?;
        in_range("blur_sd_px", self.blur_sd_px, &Self::BLUR_SD_PX)?;
        in_range("vignetting", self.vignetting, &Self::VIGNETTING)
    }
}

/// Tables of one sensor.
#[derive(Debug, Clone)]
pub(super) struct Sensor {
    seed: u64,
    noise: Vec<i16>,
    row_gain: Vec<u16>,
    column_loss: Vec<u16>,
    #[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
    wide: bool,
}

impl Sensor {
    /// The tables for an image of `(columns, rows)`, of which the part `read` is read out. The loss of light is that about the middle of the whole
    /// image.
    pub(super) fn new(model: &SensorModel, (width, height): (u32, u32), read: &Region) -> Self {
        let (cx, cy) = (0.5 * (f64::from(width) - 1.0), 0.5 * (f64::from(height) - 1.0));
        let corner2 = (cx * cx + cy * cy).max(1.0);
        // rounded down: the two losses of a corner must not exceed the whole
        let loss = |d: f64| (model.vignetting * d * d / corner2 * 65535.0).floor() as u16;
        Self {
            seed: model.seed,
            noise: noise_table(model.noise_sd_levels, model.seed),
            row_gain: (0..read.height_px).map(|y| 65535 - loss(f64::from(y + read.y_px) - cy)).collect(),
            column_loss: (0..read.width_px).map(|x| loss(f64::from(x + read.x_px) - cx)).collect(),
            wide: has_avx2(),
        }
    }

    /// Turns the exact levels of row `y` (fixed point, [`LEVEL_BITS`]) into bytes.
    pub(super) fn expose(&self, frame_id: u64, y: usize, levels: &[u16], out: &mut [u8]) {
        let place = hash(self.seed ^ hash(frame_id ^ hash(y as u64))) as usize % TABLE;
        let Some(noise) = self.noise.get(place..place + out.len()) else { return };
        let gain = self.row_gain.get(y).copied().unwrap_or(0);
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                expose_wide(gain, &self.column_loss, levels, noise, out);
            }
            return;
        }
        expose_row(gain, &self.column_loss, levels, noise, out);
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn expose_wide(gain: u16, loss: &[u16], levels: &[u16], noise: &[i16], out: &mut [u8]) {
    expose_row(gain, loss, levels, noise, out);
}

/// The arithmetic of every path; the compiler widens it to whatever the caller may use.
#[inline(always)]
fn expose_row(gain: u16, loss: &[u16], levels: &[u16], noise: &[i16], out: &mut [u8]) {
    let n = out.len().min(loss.len()).min(levels.len()).min(noise.len());
    let (Some(out), Some(loss), Some(levels), Some(noise)) =
        (out.get_mut(..n), loss.get(..n), levels.get(..n), noise.get(..n))
    else {
        return;
    };
    for (((out, &loss), &level), &noise) in out.iter_mut().zip(loss).zip(levels).zip(noise) {
        let gain = gain.wrapping_sub(loss);
        let value = ((u32::from(gain) * u32::from(level)) >> 16) as i16;
        *out = (value.saturating_add(noise) >> LEVEL_BITS).clamp(0, 255) as u8;
    }
}

/// Gaussian samples (Box-Muller) in fixed point, with the half that makes the final shift round.
fn noise_table(sd_levels: f64, seed: u64) -> Vec<i16> {
    let scale = f64::from(1 << LEVEL_BITS);
    let unit = |i: u64| Random::new(seed.wrapping_add(i)).uniform();
    let mut table = Vec::with_capacity(TABLE + LONGEST_ROW);
    for i in 0..(TABLE / 2) as u64 {
        let radius = (-2.0 * (1.0 - unit(2 * i)).ln()).sqrt() * sd_levels;
        let (sin, cos) = (2.0 * std::f64::consts::PI * unit(2 * i + 1)).sin_cos();
        for sample in [radius * cos, radius * sin] {
            // the bounds of a word, since no more than four of the largest deviations fit it
            table.push(((sample + 0.5) * scale).round().clamp(-32768.0, 32767.0) as i16);
        }
    }
    table.extend_from_within(..LONGEST_ROW);
    table
}

/// Well-mixed bits of `x`.
fn hash(x: u64) -> u64 {
    Random::new(x).bits()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn noise_has_the_asked_deviation_and_no_bias() {
        let model = SensorModel { noise_sd_levels: 4.0, blur_sd_px: 0.0, vignetting: 0.0, seed: 7 };
        let sensor = Sensor::new(&model, (640, 480), &Region::whole(640, 480));
        let levels = vec![120 << LEVEL_BITS; 640];
        let (mut sum, mut sum2, mut neighbours) = (0.0, 0.0, 0.0);
        let mut row = vec![0; 640];
        for y in 0..480 {
            sensor.expose(3, y, &levels, &mut row);
            for pair in row.windows(2) {
                let (a, b) = (f64::from(pair[0]) - 120.0, f64::from(pair[1]) - 120.0);
                sum += a;
                sum2 += a * a;
                neighbours += a * b;
            }
        }
        let n = 639.0 * 480.0;
        let (mean, sd) = (sum / n, (sum2 / n).sqrt());
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((sd - 4.0).abs() < 0.05, "{sd}");
        assert!((neighbours / n / 16.0).abs() < 0.02);
    }

    #[test]
    fn rows_and_frames_differ_and_repeat() {
        let model = SensorModel { noise_sd_levels: 3.0, ..SensorModel::default() };
        let sensor = Sensor::new(&model, (64, 64), &Region::whole(64, 64));
        let levels = vec![100 << LEVEL_BITS; 64];
        let row = |frame, y| {
            let mut out = vec![0; 64];
            sensor.expose(frame, y, &levels, &mut out);
            out
        };
        assert_eq!(row(1, 5), row(1, 5));
        assert_ne!(row(1, 5), row(2, 5));
        assert_ne!(row(1, 5), row(1, 6));
    }

    #[test]
    fn corners_are_darker_by_the_vignetting() {
        let model = SensorModel { noise_sd_levels: 0.0, blur_sd_px: 0.0, vignetting: 0.5, seed: 0 };
        let sensor = Sensor::new(&model, (101, 81), &Region::whole(101, 81));
        let levels = vec![200 << LEVEL_BITS; 101];
        let mut row = vec![0; 101];
        sensor.expose(0, 0, &levels, &mut row);
        assert_eq!((row[0], row[100]), (100, 100));
        sensor.expose(0, 40, &levels, &mut row);
        assert_eq!(row[50], 200);
    }

    proptest! {
        #[test]
        fn wide_and_narrow_agree(
            gain in 32768u16.., pixels in prop::collection::vec((0u16..32768, 0u16..32640, any::<i16>()), 0..200),
        ) {
            let loss: Vec<_> = pixels.iter().map(|p| p.0).collect();
            let levels: Vec<_> = pixels.iter().map(|p| p.1).collect();
            let noise: Vec<_> = pixels.iter().map(|p| p.2).collect();
            let mut narrow = vec![0; pixels.len()];
            expose_row(gain, &loss, &levels, &noise, &mut narrow);
            for (i, &byte) in narrow.iter().enumerate() {
                let exact = (i64::from(gain - loss[i]) * i64::from(levels[i]) / 65536 + i64::from(noise[i]))
                    .clamp(-32768, 32767)
                    .div_euclid(128)
                    .clamp(0, 255);
                prop_assert_eq!(i64::from(byte), exact);
            }
            #[cfg(target_arch = "x86_64")]
            if has_avx2() {
                let mut wide = vec![0; pixels.len()];
                // SAFETY: the feature was just detected.
                #[allow(unsafe_code)]
                unsafe { expose_wide(gain, &loss, &levels, &noise, &mut wide) };
                prop_assert_eq!(narrow, wide);
            }
        }
    }
}
