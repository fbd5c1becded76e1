//! How a camera turns light into grey levels, and back: the light that falls on a pixel is proportional to its area under the edge, a
//! level that a response has bent is not, and edges seem to lie where they do not.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// From the light that falls on a pixel to its grey level; both are shares of the greatest, 0..=1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Response {
    /// Levels are light: industrial cameras as they come.
    #[default]
    Linear,
    /// IEC 61966-2-1: most images in files, webcams nearly so.
    Srgb,
    /// `level = light^(1 / gamma)`.
    Gamma(f64),
}

impl Response {
    /// What a gamma may be.
    pub const GAMMA: RangeInclusive<f64> = 0.2..=5.0;

    /// The light of a level.
    #[must_use]
    pub fn light(&self, level: f64) -> f64 {
        match self {
            Self::Linear => level,
            Self::Srgb if level <= 0.040_45 => level / 12.92,
            Self::Srgb => ((level + 0.055) / 1.055).powf(2.4),
            Self::Gamma(gamma) => level.max(0.0).powf(*gamma),
        }
    }

    /// The level of a light.
    #[must_use]
    pub fn level(&self, light: f64) -> f64 {
        match self {
            Self::Linear => light,
            Self::Srgb if light <= 0.003_130_8 => 12.92 * light,
            Self::Srgb => 1.055 * light.powf(1.0 / 2.4) - 0.055,
            Self::Gamma(gamma) => light.max(0.0).powf(1.0 / gamma),
        }
    }

    /// What makes of images of this response such as a camera of response `other` would have taken.
    #[must_use]
    pub fn to(&self, other: &Self) -> LevelTable {
        let bent = |level: usize| other.level(self.light(level as f64 / 255.0));
        LevelTable(std::array::from_fn(|level| (255.0 * bent(level)).round().clamp(0.0, 255.0) as u8))
    }

    /// What makes levels of images of this response proportional to light; `None` where they are.
    #[must_use]
    pub fn linearization(&self) -> Option<LevelTable> {
        (*self != Self::Linear).then(|| self.to(&Self::Linear))
    }
}

/// A new level for each of the 256.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LevelTable([u8; 256]);

impl LevelTable {
    /// The same, and `next` after it.
    #[must_use]
    pub fn then(mut self, next: &Self) -> Self {
        next.apply(&mut self.0);
        self
    }

    /// Puts the new levels in the place of an image's.
    pub fn apply(&self, pixels: &mut [u8]) {
        for level in pixels {
            // 256 entries: there is one for each byte
            *level = self.0.get(usize::from(*level)).copied().unwrap_or(*level);
        }
    }
}

impl FromStr for Response {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let response = match text.split_once(':') {
            None if text == "linear" => Some(Self::Linear),
            None if text == "srgb" => Some(Self::Srgb),
            Some(("gamma", number)) => {
                number.parse().ok().filter(|gamma| Self::GAMMA.contains(gamma)).map(Self::Gamma)
            }
            _ => None,
        };
        let (least, greatest) = (Self::GAMMA.start(), Self::GAMMA.end());
        response.ok_or_else(|| {
            format!("must be linear, srgb or gamma:G with G from {least} to {greatest}, not {text:?}")
        })
    }
}

impl fmt::Display for Response {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Linear => f.write_str("linear"),
            Self::Srgb => f.write_str("srgb"),
            Self::Gamma(gamma) => write!(f, "gamma:{gamma}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_and_light_undo_each_other() {
        for text in ["linear", "srgb", "gamma:0.5", "gamma:2.2"] {
            let response: Response = text.parse().unwrap();
            assert_eq!(response.to_string(), text);
            for i in 0..=100 {
                let x = f64::from(i) / 100.0;
                assert!((response.level(response.light(x)) - x).abs() < 1e-6, "{text} {x}");
            }
            assert!((response.light(0.0)).abs() < 1e-12 && (response.light(1.0) - 1.0).abs() < 1e-12);
        }
        // IEC 61966-2-1: mid grey of 128 is a light of 21.6 %
        assert!((Response::Srgb.light(128.0 / 255.0) - 0.215_86).abs() < 1e-4);
    }

    #[test]
    fn tables_bend_images_and_straighten_them() {
        let mut pixels: Vec<u8> = (0..=255).collect();
        let table = Response::Gamma(2.0).to(&Response::Linear);
        table.apply(&mut pixels);
        // 255 (x / 255)^2
        assert_eq!([pixels[0], pixels[128], pixels[255]], [0, 64, 255]);
        let there_and_back = Response::Linear.to(&Response::Srgb).then(&Response::Srgb.to(&Response::Linear));
        let mut pixels: Vec<u8> = (0..=255).collect();
        there_and_back.apply(&mut pixels);
        assert!(pixels.iter().zip(0..=255u8).all(|(a, b)| a.abs_diff(b) <= 1));
        assert_eq!(Response::Linear.linearization(), None);
    }

    #[test]
    fn nonsense_is_refused() {
        for text in
            ["", "Linear", "gamma", "gamma:", "gamma:0", "gamma:nan", "gamma:inf", "gamma:9", "srgb:2"]
        {
            assert!(text.parse::<Response>().unwrap_err().contains("gamma:G"), "{text}");
        }
    }
}
