//! How much of a pixel lies on one side of an edge, after the optics' blur.
//!
//! A straight edge at signed distance `d` (px, positive: the pixel's centre is inside) with unit normal
//! `(a, b)` covers the mean over the pixel's square of `Phi((d + a x + b y) / sigma)`. That depends on `d` and
//! on the smaller of `|a|`, `|b|`: a table of both is interpolated.

use std::sync::{Arc, Mutex, PoisonError};

/// Blur is cut off beyond this many standard deviations: 0.07 % of the step is lost, so that the edge of a band lies a quarter of a level off
/// at most, and bands stay narrow, which determines the time that a frame takes.
const CUT_SIGMA: f64 = 3.2;
/// Steps of the table: the nearest entry is off by at most 0.003, as `coverage_agrees_with_brute_force` shows.
const ORIENTATIONS: usize = 16;
const DISTANCES: usize = 1024;
const STRIDE: usize = DISTANCES + 1;

/// Pixels that are evaluated together, as many single-precision numbers as a register of SSE2 has, so that one instruction does.
pub(super) const LANES: usize = 4;

/// Tables that are kept for further renderers. Chosen by hand: more cameras than a process has, and with 35 kB each still a quarter of a
/// megabyte.
const KEPT: usize = 8;

/// Tables of earlier renderers by the bits of their blur, the newest last: one takes a million integrals, and whoever simulates many runs
/// makes a renderer of the same camera for each.
static EARLIER: Mutex<Vec<(u64, Arc<[u16]>)>> = Mutex::new(Vec::new());

/// Table of pixel coverage.
#[derive(Debug, Clone)]
pub(super) struct EdgeProfile {
    /// Coverage in units of 1/65535.
    table: Arc<[u16]>,
    half_px: f32,
    bins_per_px: f32,
    /// Variance of one pixel's point spread along any direction, px^2.
    spread_px2: f32,
}

impl EdgeProfile {
    /// The table for a Gaussian blur with the standard deviation `sigma` px.
    pub(super) fn new(sigma: f64) -> Self {
        let half_px = half_px(sigma);
        let table = earlier(sigma).unwrap_or_else(|| {
            let table = Arc::from(table(sigma));
            keep(sigma, &table);
            table
        });
        Self {
            table,
            half_px: half_px as f32,
            bins_per_px: (DISTANCES as f64 / (2.0 * half_px)) as f32,
            spread_px2: (1.0 / 12.0 + sigma * sigma) as f32,
        }
    }

    /// Distance from an edge at which it no longer matters, px.
    pub(super) fn half_px(&self) -> f64 {
        f64::from(self.half_px)
    }

    /// Variance of one pixel's point spread along any direction, px^2.
    pub(super) fn spread_px2(&self) -> f32 {
        self.spread_px2
    }

    /// Row of the table for an edge whose unit normal has the components `nx`, `ny`.
    #[inline(always)]
    pub(super) fn row(nx: f32, ny: f32) -> i32 {
        let (x, y) = (nx.abs(), ny.abs());
        let minor = if x < y { x } else { y };
        cast(minor * (ORIENTATIONS as f32 * std::f32::consts::SQRT_2) + 0.5, ORIENTATIONS as f32)
            * STRIDE as i32
    }

    /// Coverages 0..1 at the distances `d` px, positive inside, for edges with the given rows of the table.
    #[inline(always)]
    pub(super) fn coverage(&self, d: [f32; LANES], rows: [i32; LANES]) -> [f32; LANES] {
        let mut places = [0i32; LANES];
        for ((place, d), row) in places.iter_mut().zip(d).zip(rows) {
            *place = row + cast((d + self.half_px) * self.bins_per_px + 0.5, DISTANCES as f32);
        }
        places.map(|place| f32::from(self.table.get(place as usize).copied().unwrap_or(0)) * (1.0 / 65535.0))
    }
}

/// Distance from an edge at which a blur no longer matters, px.
fn half_px(sigma: f64) -> f64 {
    std::f64::consts::FRAC_1_SQRT_2 + CUT_SIGMA * sigma
}

/// Coverages for one blur, in units of 1/65535.
fn table(sigma: f64) -> Vec<u16> {
    let half_px = half_px(sigma);
    let bins_per_px = DISTANCES as f64 / (2.0 * half_px);
    let mut table = Vec::with_capacity((ORIENTATIONS + 1) * STRIDE);
    for orientation in 0..=ORIENTATIONS {
        let b = orientation as f64 / ORIENTATIONS as f64 * std::f64::consts::FRAC_1_SQRT_2;
        let a = (1.0 - b * b).sqrt();
        for bin in 0..=DISTANCES {
            // the ends are exact: a pixel out of reach is not touched
            let c = match bin {
                0 => 0.0,
                DISTANCES => 1.0,
                _ => coverage(bin as f64 / bins_per_px - half_px, a, b, sigma).clamp(0.0, 1.0),
            };
            table.push((c * 65535.0).round() as u16);
        }
    }
    table
}

/// The table of an earlier renderer with this blur.
fn earlier(sigma: f64) -> Option<Arc<[u16]>> {
    let kept = EARLIER.lock().unwrap_or_else(PoisonError::into_inner);
    kept.iter().find(|(bits, _)| *bits == sigma.to_bits()).map(|(_, table)| table.clone())
}

/// Keeps a table, in the place of the oldest one where there are many.
fn keep(sigma: f64, table: &Arc<[u16]>) {
    let mut kept = EARLIER.lock().unwrap_or_else(PoisonError::into_inner);
    if kept.len() >= KEPT {
        kept.remove(0);
    }
    kept.push((sigma.to_bits(), table.clone()));
}

/// The integer part of `x`, kept in `0..=limit`; 0 for NaN.
#[inline(always)]
#[allow(unsafe_code)]
pub(super) fn cast(x: f32, limit: f32) -> i32 {
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < limit { x } else { limit };
    // SAFETY: x lies in 0..=limit, and is no NaN: a comparison with NaN is false, so it became 0. All limits are small.
    unsafe { x.to_int_unchecked() }
}

/// Mean over the unit square of the blurred step, `a >= b >= 0`.
pub(super) fn coverage(d: f64, a: f64, b: f64, sigma: f64) -> f64 {
    // The midpoint rule errs by the square of a step, so that 32 leave a thousandth of what one would.
    const STEPS: u32 = 32;
    let ramp = |d: f64| {
        if sigma <= 0.0 {
            (d / a + 0.5).clamp(0.0, 1.0)
        } else {
            (integral(d + 0.5 * a, sigma) - integral(d - 0.5 * a, sigma)) / a
        }
    };
    if b == 0.0 {
        // the same everywhere across the square
        return ramp(d);
    }
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

    fn one(profile: &EdgeProfile, d: f64, nx: f64, ny: f64) -> f64 {
        f64::from(profile.coverage([d as f32; LANES], [EdgeProfile::row(nx as f32, ny as f32); LANES])[2])
    }

    /// Two of one blur are one table, which is that of no other blur; whoever comes after many others has its own as well.
    #[test]
    fn a_kept_profile_is_the_one_that_was_made() {
        let first = EdgeProfile::new(0.71);
        assert!(Arc::ptr_eq(&first.table, &EdgeProfile::new(0.71).table));
        for k in 0..2 * KEPT {
            let sigma = 0.72 + 0.01 * k as f64;
            let (made, kept) = (EdgeProfile::new(sigma), EdgeProfile::new(sigma));
            assert_eq!(made.table, kept.table);
            assert_eq!(*made.table, *table(sigma));
        }
        assert_eq!(first.table, EdgeProfile::new(0.71).table);
        assert!(EARLIER.lock().unwrap().len() <= KEPT);
    }

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
                let got = one(&profile, d, nx, ny);
                assert!((got - wanted).abs() < 0.008, "{degrees} deg, {d}: {got} instead of {wanted}");
            }
        }
    }

    #[test]
    fn blurred_profile_is_a_distribution() {
        let profile = EdgeProfile::new(0.8);
        let mut last = -1.0;
        for step in -400..=400 {
            let d = f64::from(step) * 0.01;
            let c = one(&profile, d, 0.6, 0.8);
            assert!(c >= last - 1e-6 && (0.0..=1.0 + 1e-6).contains(&c));
            assert!((c + one(&profile, -d, 0.6, 0.8) - 1.0).abs() < 0.006);
            last = c;
        }
        // half-way up one effective standard deviation: sqrt(1/12 + 0.64) = 0.85
        assert!((one(&profile, 0.85, 0.6, 0.8) - 0.8413).abs() < 0.01);
    }
}
