//! Random images for tests of kernels: any size, any gap between rows, noise or flat areas with steps.

use super::ImageView;
use proptest::prelude::*;

/// Bytes and how to look at them.
#[derive(Debug, Clone)]
pub(crate) struct TestImage {
    bytes: Vec<u8>,
    width: usize,
    height: usize,
    stride: usize,
}

impl TestImage {
    pub(crate) fn new(width: usize, height: usize, gap: usize, kind: u8, seed: u64) -> Self {
        let stride = width + gap;
        let mut random = crate::linalg::Random::new(seed);
        let (mut level, mut bytes) = (0, Vec::with_capacity(stride * height));
        for i in 0..stride * height {
            level = match kind {
                // noise of all bits; of few; steps of any height; black and white
                0 => random.bits() as u8,
                1 => 100 + (random.bits() % 8) as u8,
                2 if random.bits().is_multiple_of(9) => random.bits() as u8,
                2 if i >= stride && random.bits().is_multiple_of(2) => bytes[i - stride],
                2 => level,
                _ => [0, 255][(random.bits() % 2) as usize],
            };
            bytes.push(level);
        }
        Self { bytes, width, height, stride }
    }

    pub(crate) fn view(&self) -> ImageView<'_> {
        ImageView::with_stride(&self.bytes, self.width, self.height, self.stride).unwrap()
    }

    /// The nearest pixel's level, as whole number.
    pub(crate) fn at(&self, x: i64, y: i64) -> i64 {
        let (x, y) = (x.clamp(0, self.width as i64 - 1), y.clamp(0, self.height as i64 - 1));
        i64::from(self.bytes[y as usize * self.stride + x as usize])
    }
}

/// Images of up to 150 x 12 px.
pub(crate) fn any_image() -> impl Strategy<Value = TestImage> {
    (1usize..150, 1usize..12, 0usize..5, 0u8..4, any::<u64>())
        .prop_map(|(width, height, gap, kind, seed)| TestImage::new(width, height, gap, kind, seed))
}

/// Grey levels by 15 x 15 points a pixel: `light` where the scene is lit; blurred, with noise, rounded.
pub(crate) struct SyntheticImage {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) dark: f64,
    pub(crate) light: f64,
    pub(crate) blur_px: f64,
    pub(crate) noise_levels: f64,
}

impl SyntheticImage {
    /// `distance` from the light's rim, px, less than 0 where it is dark; beyond 1 px nothing is sampled.
    pub(crate) fn render(
        &self,
        random: &mut crate::linalg::Random,
        distance: impl Fn(f64, f64) -> f64,
    ) -> Vec<u8> {
        let (w, h) = (self.width as i64, self.height as i64);
        let share = |x: i64, y: i64| {
            let d = distance(x as f64, y as f64);
            if d.abs() > 1.0 {
                return f64::from(u8::from(d > 0.0));
            }
            let mut lit = 0;
            for j in 0..15 {
                for i in 0..15 {
                    let (u, v) = (f64::from(i - 7) / 15.0, f64::from(j - 7) / 15.0);
                    lit += u32::from(distance(x as f64 + u, y as f64 + v) > 0.0);
                }
            }
            f64::from(lit) / 225.0
        };
        let mut image: Vec<f64> = (0..w * h).map(|i| share(i % w, i / w)).collect();
        if self.blur_px > 0.0 {
            let radius = (4.0 * self.blur_px).ceil() as i64;
            let gaussian: Vec<f64> =
                (-radius..=radius).map(|k| (-0.5 * (k as f64 / self.blur_px).powi(2)).exp()).collect();
            let sum: f64 = gaussian.iter().sum();
            for (dx, dy) in [(1, 0), (0, 1)] {
                image = (0..w * h)
                    .map(|i| {
                        let at = |k: i64| {
                            let (x, y) = ((i % w + k * dx).clamp(0, w - 1), (i / w + k * dy).clamp(0, h - 1));
                            image[(y * w + x) as usize]
                        };
                        (-radius..=radius).zip(&gaussian).map(|(k, b)| b * at(k)).sum::<f64>() / sum
                    })
                    .collect();
            }
        }
        let level = |s: &f64| self.dark + (self.light - self.dark) * s;
        image
            .iter()
            .map(|s| (level(s) + self.noise_levels * random.gaussian()).round().clamp(0.0, 255.0) as u8)
            .collect()
    }
}
