//! How much of a pixel lies on one side of an edge, after the optics' blur.
//!
//! A straight edge at signed distance `d` (px, positive: the pixel's centre is inside) with unit normal
//! `(a, b)` covers the mean over the pixel's square of `Phi((d + a x + b y) / sigma)`. That depends on `d` and
//! on the smaller of `|a|`, `|b|`: a table of both is interpolated.

/// Blur is cut off beyond this many standard deviations (0.07 % of the step is lost).
const CUT_SIGMA: f64 = 3.2;
const ORIENTATIONS: usize = 16;
const DISTANCES: usize = 384;
const STRIDE: usize = DISTANCES + 2;

/// Table of pixel coverage.
#[derive(Debug, Clone)]
pub(super) struct EdgeProfile {
    table: Vec<f32>,
    half_px: f64,
    bins_per_px: f64,
    /// Variance of one pixel's point spread along any direction, px^2.
    spread_px2: f64,
}

impl EdgeProfile {
    /// Table for a Gaussian blur of `sigma` px.
    pub(super) fn new(sigma: f64) -> Self {
        let half_px = std::f64::consts::FRAC_1_SQRT_2 + CUT_SIGMA * sigma;
        let bins_per_px = DISTANCES as f64 / (2.0 * half_px);
        let mut table = Vec::with_capacity((ORIENTATIONS + 2) * STRIDE);
        for orientation in 0..ORIENTATIONS + 2 {
            let b = (orientation as f64 / ORIENTATIONS as f64).min(1.0) * std::f64::consts::FRAC_1_SQRT_2;
            let a = (1.0 - b * b).sqrt();
            for bin in 0..STRIDE {
                let d = (bin.min(DISTANCES) as f64) / bins_per_px - half_px;
                table.push(coverage(d, a, b, sigma) as f32);
            }
        }
        Self { table, half_px, bins_per_px, spread_px2: 1.0 / 12.0 + sigma * sigma }
    }

    /// Distance from an edge at which it no longer matters, px.
    pub(super) fn half_px(&self) -> f64 {
        self.half_px
    }

    /// Variance of one pixel's point spread along any direction, px^2.
    pub(super) fn spread_px2(&self) -> f64 {
        self.spread_px2
    }

    /// Coverage 0..1 at distance `d` px for an edge whose unit normal has the components `nx`, `ny`.
    #[inline]
    pub(super) fn coverage(&self, d: f64, nx: f64, ny: f64) -> f64 {
        let minor = nx.abs().min(ny.abs()) * (ORIENTATIONS as f64 * std::f64::consts::SQRT_2);
        let place = (d.clamp(-self.half_px, self.half_px) + self.half_px) * self.bins_per_px;
        let (row, bin) = (minor as usize, place as usize);
        let (fy, fx) = ((minor - row as f64) as f32, (place - bin as f64) as f32);
        let at = row.min(ORIENTATIONS) * STRIDE + bin.min(DISTANCES);
        let Some(&[t00, t01]) = self.table.get(at..at + 2).and_then(|t| t.first_chunk()) else { return 0.0 };
        let Some(&[t10, t11]) = self.table.get(at + STRIDE..at + STRIDE + 2).and_then(|t| t.first_chunk())
        else {
            return 0.0;
        };
        let (low, high) = (t00 + (t01 - t00) * fx, t10 + (t11 - t10) * fx);
        f64::from(low + (high - low) * fy)
    }
}

/// Mean over the unit square of the blurred step, `a >= b >= 0`.
fn coverage(d: f64, a: f64, b: f64, sigma: f64) -> f64 {
    const STEPS: u32 = 32;
    let ramp = |d: f64| {
        if sigma <= 0.0 {
            (d / a + 0.5).clamp(0.0, 1.0)
        } else {
            (integral(d + 0.5 * a, sigma) - integral(d - 0.5 * a, sigma)) / a
        }
    };
    let sum: f64 = (0..STEPS).map(|i| ramp(d + b * ((f64::from(i) + 0.5) / f64::from(STEPS) - 0.5))).sum();
    sum / f64::from(STEPS)
}

/// Integral of the Gaussian distribution from minus infinity to `x`.
fn integral(x: f64, sigma: f64) -> f64 {
    let z = x / sigma;
    let density = (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
    x * distribution(z) + sigma * density
}

/// Distribution of the unit normal, to 1e-7 (Abramowitz and Stegun 26.2.17).
fn distribution(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let poly = t
        * (0.319_381_530
            + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let tail = poly * (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
    if z < 0.0 { tail } else { 1.0 - tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Brute force: the pixel is cut into 200 x 200 squares.
    #[test]
    fn coverage_agrees_with_brute_force() {
        let profile = EdgeProfile::new(0.0);
        for degrees in [0.0f64, 7.0, 20.0, 33.0, 45.0, 60.0, 90.0, 135.0, 200.0] {
            let (ny, nx) = degrees.to_radians().sin_cos();
            for step in -8..=8 {
                let d = f64::from(step) * 0.1;
                let mut inside = 0;
                for i in 0..200 {
                    for j in 0..200 {
                        let (x, y) = ((f64::from(i) + 0.5) / 200.0 - 0.5, (f64::from(j) + 0.5) / 200.0 - 0.5);
                        inside += i32::from(d + nx * x + ny * y > 0.0);
                    }
                }
                let wanted = f64::from(inside) / 40_000.0;
                let got = profile.coverage(d, nx, ny);
                assert!((got - wanted).abs() < 0.005, "{degrees} deg, {d}: {got} instead of {wanted}");
            }
        }
    }

    #[test]
    fn blurred_profile_is_a_distribution() {
        let profile = EdgeProfile::new(0.8);
        let mut last = -1.0;
        for step in -400..=400 {
            let d = f64::from(step) * 0.01;
            let c = profile.coverage(d, 0.6, 0.8);
            assert!(c >= last - 1e-6 && (0.0..=1.0 + 1e-6).contains(&c));
            assert!((c + profile.coverage(-d, 0.6, 0.8) - 1.0).abs() < 1e-3);
            last = c;
        }
        // half-way up one effective standard deviation: sqrt(1/12 + 0.64) = 0.85
        assert!((profile.coverage(0.85, 0.6, 0.8) - 0.8413).abs() < 0.01);
    }
}
