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
    /// Nobody told: levels are taken as light, and finders of tags look for what the camera makes of that.
    Unknown,
    /// IEC 61966-2-1: most images in files, webcams nearly so.
    Srgb,
    /// `level = light^(1 / gamma)`.
    Gamma(f64),
    /// As it was measured.
    Table(LightTable),
}

/// The light of equally spaced levels, from the least to the greatest, with straight lines between; scaled to 0..=1, which moves no edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightTable {
    light: [f32; Self::MAX],
    count: usize,
}

impl LightTable {
    /// Most entries: between 33 a gamma of 2.2 bends by 3.2e-4 of the greatest light at most (rms 2e-4), which follows from the second derivative
    /// of the power; with half of them by four times as much. A grey level is 4e-3.
    const MAX: usize = 33;

    /// Of two to 33 rising numbers; `None` of others.
    #[must_use]
    pub fn new(light: &[f64]) -> Option<Self> {
        let (first, last) = (*light.first()?, *light.last()?);
        let rising = light.windows(2).all(|pair| matches!(pair, [a, b] if a < b));
        if !rising || !(2..=Self::MAX).contains(&light.len()) || !(last - first).is_finite() {
            return None;
        }
        let mut scaled = [0.0; Self::MAX];
        scaled.iter_mut().zip(light).for_each(|(to, l)| *to = ((l - first) / (last - first)) as f32);
        Some(Self { light: scaled, count: light.len() })
    }

    fn entries(&self) -> &[f32] {
        self.light.get(..self.count).unwrap_or_default()
    }

    /// Entries before and after place `i`, the first and last ones beyond the ends.
    fn pair(&self, i: usize) -> (f64, f64) {
        match self.entries().get(i..).unwrap_or_default() {
            [a, b, ..] => (f64::from(*a), f64::from(*b)),
            _ => (0.0, 1.0),
        }
    }

    fn light(&self, level: f64) -> f64 {
        let place = level.clamp(0.0, 1.0) * (self.count - 1) as f64;
        let i = (place as usize).min(self.count - 2);
        let (a, b) = self.pair(i);
        a + (b - a) * (place - i as f64)
    }

    fn level(&self, light: f64) -> f64 {
        let light = light.clamp(0.0, 1.0);
        let above = self.entries().partition_point(|l| f64::from(*l) <= light);
        let i = above.clamp(1, self.count - 1) - 1;
        let (a, b) = self.pair(i);
        (i as f64 + (light - a) / (b - a)) / (self.count - 1) as f64
    }
}

impl Response {
    /// What a gamma may be: those of displays and cameras are 0.45 to 2.6; at five the lower half of the levels would hold
    /// a thirty-second of the light, and 256 of them would not tell it any more.
    pub const GAMMA: RangeInclusive<f64> = 0.2..=5.0;

    /// The light of a level.
    #[must_use]
    pub fn light(&self, level: f64) -> f64 {
        match self {
            Self::Linear | Self::Unknown => level,
            // The standard's own figures, here and in `level`.
            Self::Srgb if level <= 0.040_45 => level / 12.92,
            Self::Srgb => ((level + 0.055) / 1.055).powf(2.4),
            Self::Gamma(gamma) => level.max(0.0).powf(*gamma),
            Self::Table(table) => table.light(level),
        }
    }

    /// The level of a light.
    #[must_use]
    pub fn level(&self, light: f64) -> f64 {
        match self {
            Self::Linear | Self::Unknown => light,
            // IEC 61966-2-1 again.
            Self::Srgb if light <= 0.003_130_8 => 12.92 * light,
            // IEC 61966-2-1, like the line above.
            Self::Srgb => 1.055 * light.powf(1.0 / 2.4) - 0.055,
            Self::Gamma(gamma) => light.max(0.0).powf(1.0 / gamma),
            Self::Table(table) => table.level(light),
        }
    }

    /// What makes of images of this response such as a camera of response `other` would have taken.
    #[must_use]
    pub fn to(&self, other: &Self) -> LevelTable {
        let bent = |level: usize| other.level(self.light(level as f64 / 255.0));
        LevelTable(std::array::from_fn(|level| (255.0 * bent(level)).round().clamp(0.0, 255.0) as u8))
    }

    /// What makes levels of images of this response proportional to light; `None` where they are, or nothing else is known.
    #[must_use]
    pub fn linearization(&self) -> Option<LevelTable> {
        (!matches!(self, Self::Linear | Self::Unknown)).then(|| self.to(&Self::Linear))
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
            None if text == "unknown" => Some(Self::Unknown),
            None if text == "srgb" => Some(Self::Srgb),
            Some(("gamma", number)) => {
                number.parse().ok().filter(|gamma| Self::GAMMA.contains(gamma)).map(Self::Gamma)
            }
            Some(("table", numbers)) => {
                let light: Option<Vec<f64>> = numbers.split(',').map(|n| n.trim().parse().ok()).collect();
                light.and_then(|light| LightTable::new(&light)).map(Self::Table)
            }
            _ => None,
        };
        let (least, greatest) = (Self::GAMMA.start(), Self::GAMMA.end());
        response.ok_or_else(|| {
            let shown: String = text.chars().take(60).collect();
            format!(
                "must be linear, unknown, srgb, gamma:G with G from {least} to {greatest}, or table:L,L,... with the light of 2 to {} \
                 equally spaced levels, rising; not {shown:?}",
                LightTable::MAX
            )
        })
    }
}

impl fmt::Display for Response {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Linear => f.write_str("linear"),
            Self::Unknown => f.write_str("unknown"),
            Self::Srgb => f.write_str("srgb"),
            Self::Gamma(gamma) => write!(f, "gamma:{gamma}"),
            Self::Table(table) => {
                let light: Vec<_> = table.entries().iter().map(f32::to_string).collect();
                write!(f, "table:{}", light.join(","))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_and_light_undo_each_other() {
        for text in
            ["linear", "unknown", "srgb", "gamma:0.5", "gamma:2.2", "table:0,0.05,0.25,0.5,1", "table:0,1"]
        {
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
        assert_eq!([Response::Linear, Response::Unknown].map(|r| r.linearization()), [None, None]);
    }

    #[test]
    fn a_table_is_the_curve_it_was_taken_from() {
        let curve = |i: u32, scale: f64| (scale * (f64::from(i) / 32.0).powf(2.2) - 3.0).to_string();
        for scale in [1.0, 4095.0] {
            let text = (0..33).map(|i| curve(i, scale)).collect::<Vec<_>>().join(", ");
            let table: Response = format!("table:{text}").parse().unwrap();
            let (ours, truth) = (table.to(&Response::Linear), Response::Gamma(2.2).to(&Response::Linear));
            assert!(ours.0.iter().zip(truth.0).all(|(a, b)| a.abs_diff(b) <= 1), "{ours:?}");
        }
    }

    #[test]
    fn nonsense_is_refused() {
        for text in [
            "",
            "Linear",
            "gamma",
            "gamma:",
            "gamma:0",
            "gamma:nan",
            "gamma:inf",
            "gamma:9",
            "srgb:2",
            "table",
            "table:",
            "table:1",
            "table:0,1,1",
            "table:0,nan,1",
            "table:0,inf",
            "table:1,0",
            "table:-1e308,0,1e308",
        ] {
            assert!(text.parse::<Response>().unwrap_err().contains("gamma:G"), "{text}");
        }
    }
}
