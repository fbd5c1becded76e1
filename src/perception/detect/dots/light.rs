//! Illumination of the plate: one quadric, fitted to the samples of all dots' rings.
//!
//! ```text
//! P(u, v) = c0 + c1 u + c2 v + c3 u^2 + c4 u v + c5 v^2      u, v: from the dots' middle, in units of their extent
//! ```
//! For small dots a plane, since curvature does not shift their centroids. Outliers (a neighbour, the plate's edge, a shadow) are left out. The
//! residuals are the noise of the plate; their first harmonic around a dot is light that the quadric does not follow.

mod samples;

pub(super) use samples::Samples;

use super::ring::{RING, Ring};
use crate::imaging::MAX_LEVEL;
use crate::linalg::Ldlt;
use nalgebra::{Matrix3, Vector2, Vector3};
use samples::{LightResidual, LightSums, ring_rest};

/// From this half axis on the light's curvature matters, px. Chosen by hand: a slope that a plane leaves over moves rims, and so a centroid, in
/// proportion to the axis. The test `centres_are_true_in_any_light` has dots of 5, 10 and 25 px.
const QUADRIC_FROM_PX: f64 = 9.0;
/// What light may leave over that is still followed: so many standard deviations of samples, and beside these, a share of its level. Chosen by
/// hand: noise alone leaves one deviation; 0.4 % is one level of a bright plate, and a shadow's edge leaves many levels.
const SMOOTH_SDS: f64 = 2.0;
const SMOOTH_SHARE: f64 = 0.004;
/// Greatest change of light from a dot's middle outwards, and along one pixel. Chosen by hand: light that halves within
/// 35 px; twice of it lets what a shadow's edge makes of the fit move the centroids.
const MAX_RELATIVE: f64 = 0.4;
const STEEPEST: f64 = 0.02;
/// Share of the light that may be lost in an image's corners: what curvature is expected. Chosen by hand: cos^4 of 28 degrees, a usual lens's;
/// it is only a prior, which many samples overrule.
const LOSS: f64 = 0.4;
/// Inliers: their greatest distance from the first guess, as a share of the level. Chosen by hand: the guess, a plane through
/// the dots' own levels, misses a curved light by less, and the darkness of a neighbour is far beyond.
const FAR_SHARE: f64 = 0.1;
/// Their greatest distance from the fit, in standard deviations, and beside these, levels. Derived: of 96 normal samples one in twenty frames is
/// further off; the level is for rounding.
const FAR_SDS: f64 = 3.5;
const FAR_LEVELS: f64 = 1.0;
/// Fewest samples for a plane and for a quadric. Chosen by hand: half a ring for three numbers, and most of two for six; with fewer, noise
/// and outliers dominate.
const MIN_PLANE: usize = 12;
const MIN_QUADRIC: usize = 40;

/// Standard deviation of the level that no light makes, levels: a camera's black level, or what glass and air add. Chosen by hand: 8-bit cameras have
/// 0 to 8. It counts where the light is measured on what is dark.
const BLACK_LEVELS: f64 = 4.0;

/// The light as fitted, in grey levels of the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LightFit {
    middle: Vector2<f64>,
    /// One over the extent, 1/px.
    unit: f64,
    c: [f64; 6],
    /// Variance of the residuals, levels^2, and the number of samples.
    pub(super) variance: f64,
    pub(super) samples: usize,
    /// Largest residual of a sample that counts, levels.
    limit: f64,
    /// Standard deviation of how much the fit rises from a dot's middle to its rim, levels.
    pub(super) deviation: f64,
}

impl LightFit {
    /// Even light.
    pub(super) fn even(level: f64) -> Self {
        let c = [level, 0.0, 0.0, 0.0, 0.0, 0.0];
        Self {
            middle: Vector2::zeros(),
            unit: 1.0,
            c,
            variance: 0.0,
            samples: 0,
            limit: f64::INFINITY,
            deviation: 0.0,
        }
    }

    /// The light that fits samples about some dots, whose own places and levels give a first guess. Samples are means of `pixels`, each
    /// with this `noise`. `largest_px`: half axis of the largest dot; `half_diagonal_px`: of the image.
    pub(super) fn fit(
        dots: &Samples,
        samples: &Samples,
        pixels: f64,
        noise: f64,
        largest_px: f64,
        half_diagonal_px: f64,
    ) -> Self {
        let n = dots.len() as f64;
        let level = dots.iter().map(|[.., level]| level).sum::<f64>() / n;
        if !level.is_finite() {
            return Self::even(0.0);
        }
        let middle = dots.iter().map(|[x, y, _]| Vector2::new(x, y)).sum::<Vector2<f64>>() / n;
        let away = |x: f64, y: f64| (x - middle.x).hypot(y - middle.y);
        let extent = dots.iter().map(|[x, y, _]| away(x, y)).fold(largest_px.max(1.0), f64::max);
        let mut light = Self { middle, unit: 1.0 / extent, ..Self::even(level) };
        if dots.len() >= 3 {
            light.take_plane(dots);
        }
        light.limit = (FAR_SHARE * level).max(FAR_SDS * noise + FAR_LEVELS);
        let quadric = largest_px >= QUADRIC_FROM_PX && dots.len() >= 3;
        // curvature as a lens's loss of light towards the corners may make it; it is a prior, against which samples count by their noise
        let curvature = LOSS * level * (extent / half_diagonal_px).powi(2);
        let variance = noise * noise / pixels;
        let stiffness = variance / (curvature * curvature);
        for _ in 0..3 {
            let before = (light.samples, light.limit);
            let known = light;
            if quadric {
                light.take_quadric(samples, stiffness)
            } else {
                light.take_plane(samples)
            };
            if light.c.iter().any(|c| !c.is_finite()) {
                light = known;
            }
            let LightResidual { square, count, greatest } = LightResidual::of(samples, &light);
            let free = count - if quadric { 6.0 } else { 3.0 };
            (light.variance, light.samples) = (square / free.max(1.0), count as usize);
            let limit = FAR_SDS * light.variance.sqrt() + FAR_LEVELS;
            light.limit = limit.min(light.limit);
            if greatest <= light.limit || (light.samples, light.limit) == before {
                break;
            }
        }
        // what no smooth light explains is a shadow, or another thing on the plate
        let smooth = SMOOTH_SDS * variance.sqrt() + SMOOTH_SHARE * level;
        if light.variance > smooth * smooth {
            return Self { variance: light.variance, samples: light.samples, ..Self::even(level) };
        }
        if quadric {
            // four dots on a circle determine its curvature only by their rings, and by the prior
            let seen = 6.0 * variance / light.samples.max(1) as f64;
            let known = 2.0 * (curvature * largest_px / extent).powi(2);
            light.deviation = (seen * known / (seen + known)).sqrt();
        }
        light
    }

    /// The same with the deviation that a light has which was measured on the darker of plate and dots, at samples with this `variance`, because the
    /// lighter is clipped: by their noise, and by what is dark without less light. Nobody knows the slope where it could not be measured.
    pub(super) fn of_the_darker(
        mut self,
        samples: &Samples,
        variance: f64,
        largest_px: f64,
        half_diagonal_px: f64,
    ) -> Self {
        let [level, c1, c2, ..] = self.c;
        let level = level.max(1.0);
        let away = |[x, y, _]: [f64; 3]| (x - self.middle.x).powi(2) + (y - self.middle.y).powi(2);
        let spread: f64 = samples.iter().map(away).sum();
        // relative rises over the largest dot; the spread of the samples is half along each direction
        let lost = LOSS * largest_px / half_diagonal_px;
        let slope = if self.is_even() {
            lost
        } else {
            let unsure = largest_px * (2.0 * variance / spread).sqrt() / level;
            unsure.hypot(c1.hypot(c2) * self.unit * largest_px * BLACK_LEVELS / (level * level))
        };
        self.deviation = MAX_LEVEL * slope;
        self
    }

    /// Whether it has no slope.
    fn is_even(&self) -> bool {
        self.c.iter().skip(1).all(|c| *c == 0.0)
    }

    /// A place in units of the extent, from the dots' middle.
    #[inline(always)]
    fn scaled(&self, x: f64, y: f64) -> [f64; 2] {
        [(x - self.middle.x) * self.unit, (y - self.middle.y) * self.unit]
    }

    /// The plate's level at such a place.
    #[inline(always)]
    fn at_scaled(&self, u: f64, v: f64) -> f64 {
        let [c0, c1, c2, c3, c4, c5] = self.c;
        c0 + u * (c1 + c3 * u + c4 * v) + v * (c2 + c5 * v)
    }

    /// The plate's level there.
    #[inline]
    pub(super) fn at(&self, x: f64, y: f64) -> f64 {
        let [u, v] = self.scaled(x, y);
        self.at_scaled(u, v)
    }

    /// Residuals of a ring's levels; NaN for outliers.
    pub(super) fn rest_of(&self, ring: &Ring) -> [f64; RING] {
        let mut rest = [f64::NAN; RING];
        ring_rest(ring, self, &mut rest);
        rest
    }

    /// Reciprocal of the light about a place, relative to it: `1 + [x, y, xx, xy, yy]`, to second order, for use within
    /// `reach` px. Even where there is none, or where it changes more than light does.
    pub(super) fn relative(&self, x: f64, y: f64, reach: f64) -> [f64; 5] {
        let (u, v) = ((x - self.middle.x) * self.unit, (y - self.middle.y) * self.unit);
        let [_, c1, c2, c3, c4, c5] = self.c;
        let level = self.at(x, y);
        if !(level > 1.0) {
            return [0.0; 5];
        }
        let k = self.unit / level;
        let (gx, gy) = (k * (c1 + 2.0 * c3 * u + c4 * v), k * (c2 + c4 * u + 2.0 * c5 * v));
        let k = k * self.unit;
        let relative = [-gx, -gy, gx * gx - k * c3, 2.0 * gx * gy - k * c4, gy * gy - k * c5];
        let [x, y, xx, xy, yy] = relative.map(f64::abs);
        // no illumination varies so fast: the fit has followed something else
        let steep = (x + y + (xx + xy + yy) * reach) * reach > MAX_RELATIVE || x > STEEPEST;
        if steep { [0.0; 5] } else { relative }
    }

    fn take_plane(&mut self, samples: &Samples) {
        let sums = LightSums::of(samples, self);
        // three dots make a plane; less than a few samples of many are chance
        if sums.count < MIN_PLANE.min(samples.len()) as f64 {
            return;
        }
        let (whole, [b0, b1, b2, ..]) = (sums.A(), sums.b);
        let (A, b) = (Matrix3::from_fn(|i, j| whole[i][j]), Vector3::new(b0, b1, b2));
        // otherwise samples lie on a line but for 1 % of their extent, and do not determine the slope across it
        if let Some(c) = A.try_inverse().map(|inverse| inverse * b)
            // since `A / A_00` holds mean squares in units of the extent
            && A.determinant() > 1e-4 * A[(0, 0)].powi(3)
        {
            self.c = [c.x, c.y, c.z, 0.0, 0.0, 0.0];
        }
    }

    fn take_quadric(&mut self, samples: &Samples, stiffness: f64) {
        let sums = LightSums::of(samples, self);
        if sums.count < MIN_QUADRIC as f64 {
            return self.take_plane(samples);
        }
        // what samples do not determine (rings on one conic) stays small
        let (small, stiff) = (1e-6 * sums.count, 1e-6 * sums.count + stiffness);
        match Ldlt::new(&sums.A(), &[small, small, small, stiff, stiff, stiff]) {
            Some(ldlt) => self.c = ldlt.solve(&sums.b),
            None => self.take_plane(samples),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;

    /// Rings of 24 samples about four dots, under a light, with noise; some samples are of something else.
    fn rings(light: impl Fn(f64, f64) -> f64, noise: f64, wrong: f64) -> (Samples, Samples) {
        let mut random = Random::new(3);
        let (mut dots, mut samples) = (Samples::default(), Samples::default());
        for (x, y, r) in
            [(200.0, 150.0, 30.0), (400.0, 170.0, 20.0), (390.0, 360.0, 20.0), (190.0, 350.0, 20.0)]
        {
            dots.push(x, y, light(x, y));
            for k in 0..24 {
                let (sin, cos) = (f64::from(k) * 0.2618).sin_cos();
                let (x, y) = (x + r * cos, y + r * sin);
                let good = light(x, y) + noise * random.gaussian();
                let level = if random.uniform() < wrong { 40.0 } else { good };
                samples.push(x, y, level);
            }
        }
        (dots, samples)
    }

    #[test]
    fn a_quadric_is_found_among_what_is_not_the_plate() {
        let light = |x: f64, y: f64| {
            180.0 + 0.1 * (x - 300.0) - 0.05 * (y - 250.0) - 2e-4 * (x - 320.0) * (x - 300.0)
        };
        let (dots, samples) = rings(light, 0.0, 0.1);
        let fit = LightFit::fit(&dots, &samples, 1.0, 0.5, 30.0, 400.0);
        for (x, y) in [(170.0, 150.0), (300.0, 250.0), (410.0, 380.0)] {
            assert!((fit.at(x, y) - light(x, y)).abs() < 0.05, "{} {}", fit.at(x, y), light(x, y));
            let relative = fit.relative(x, y, 12.0);
            for (dx, dy) in [(10.0, 0.0), (0.0, 10.0), (-7.0, 7.0)] {
                let wanted = light(x, y) / light(x + dx, y + dy);
                let [a, b, c, d, e] = relative;
                let got = 1.0 + a * dx + b * dy + c * dx * dx + d * dx * dy + e * dy * dy;
                assert!((got - wanted).abs() < 5e-5, "{got} {wanted}");
            }
        }
        let (dots, samples) = rings(light, 3.0, 0.1);
        let sd = LightFit::fit(&dots, &samples, 1.0, 3.0, 30.0, 400.0).variance.sqrt();
        assert!((2.3..3.6).contains(&sd), "{sd}");
    }

    #[test]
    fn few_or_no_samples_are_no_hindrance() {
        let none = Samples::default();
        assert_eq!(LightFit::fit(&none, &none, 1.0, 1.0, 10.0, 400.0).relative(3.0, 4.0, 9.0), [0.0; 5]);
        let mut one = Samples::default();
        one.push(5.0, 5.0, 100.0);
        let light = LightFit::fit(&one, &one, 1.0, 1.0, 10.0, 400.0);
        assert!((light.at(9.0, 9.0) - 100.0).abs() < 1e-9);
        // four dots in line
        let mut dots = Samples::default();
        [0.0, 10.0, 20.0, 30.0].iter().for_each(|x| dots.push(*x, 2.0 * x, 100.0 + x));
        assert!(LightFit::fit(&dots, &dots, 1.0, 1.0, 4.0, 400.0).at(15.0, 30.0).is_finite());
    }
}
