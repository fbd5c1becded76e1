//! Samples of the plate's level, and the inner loops of the light's fit over them: each quantity in its own array, four samples at a time.

use super::LightFit;
use crate::detect::dots::ring::{RING, Ring};
use crate::imaging::simd::kernel;

/// Samples that are summed side by side: as many as AVX2 has lanes of `f64`.
const LANES: usize = 4;

/// Positions and levels. A level that is NaN is missing.
#[derive(Debug, Clone, Default)]
pub(in crate::detect::dots) struct Samples {
    x: Vec<f64>,
    y: Vec<f64>,
    level: Vec<f64>,
}

impl Samples {
    /// With room for so many.
    pub(in crate::detect::dots) fn with_capacity(most: usize) -> Self {
        let room = || Vec::with_capacity(most.next_multiple_of(LANES));
        Self { x: room(), y: room(), level: room() }
    }

    pub(in crate::detect::dots) fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.level.clear();
    }

    pub(in crate::detect::dots) fn push(&mut self, x: f64, y: f64, level: f64) {
        self.x.push(x);
        self.y.push(y);
        self.level.push(level);
    }

    /// Every `step`-th point of a ring.
    pub(in crate::detect::dots) fn take(&mut self, ring: &Ring, step: usize) {
        for (to, from) in [(&mut self.x, &ring.x), (&mut self.y, &ring.y), (&mut self.level, &ring.level)] {
            if step == 1 {
                to.extend_from_slice(from);
            } else {
                to.extend(from.iter().step_by(step));
            }
        }
    }

    pub(in crate::detect::dots) fn len(&self) -> usize {
        self.level.len()
    }

    /// Places and levels one by one.
    pub(super) fn iter(&self) -> impl Iterator<Item = [f64; 3]> {
        self.x.iter().zip(&self.y).zip(&self.level).map(|((x, y), level)| [*x, *y, *level])
    }

    fn columns(&self) -> [&[f64]; 3] {
        [&self.x, &self.y, &self.level]
    }
}

/// Sums over what a light explains, in units of its extent: see [`LightSums::A`] and [`LightSums::b`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct LightSums {
    pub(super) count: f64,
    /// `u^i v^j`: 1: u, v, uu, uv, vv, uuu, uuv, uvv, vvv, uuuu, uuuv, uuvv, uvvv, vvvv.
    moments: [f64; 14],
    /// Levels times 1, u, v, uu, uv, vv.
    pub(super) b: [f64; 6],
}

impl LightSums {
    /// Over the samples that `light` explains.
    pub(super) fn of(samples: &Samples, light: &LightFit) -> Self {
        let mut sums = [0.0; 21];
        sum_explained(samples.columns(), light, &mut sums);
        let [count, moments @ .., b0, b1, b2, b3, b4, b5] = sums;
        Self { count, moments, b: [b0, b1, b2, b3, b4, b5] }
    }

    /// The normal matrix of a quadric: rows and columns by 1, u, v, uu, uv, vv.
    pub(super) fn A(&self) -> [[f64; 6]; 6] {
        let n = self.count;
        let [u, v, uu, uv, vv, uuu, uuv, uvv, vvv, uuuu, uuuv, uuvv, uvvv, vvvv] = self.moments;
        [
            [n, u, v, uu, uv, vv],
            [u, uu, uv, uuu, uuv, uvv],
            [v, uv, vv, uuv, uvv, vvv],
            [uu, uuu, uuv, uuuu, uuuv, uuvv],
            [uv, uuv, uvv, uuuv, uuvv, uvvv],
            [vv, uvv, vvv, uuvv, uvvv, vvvv],
        ]
    }
}

/// Residuals of a light over the samples that it explains.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct LightResidual {
    /// Sum of squares, levels^2.
    pub(super) square: f64,
    pub(super) count: f64,
    /// Greatest distance, levels.
    pub(super) greatest: f64,
}

impl LightResidual {
    pub(super) fn of(samples: &Samples, light: &LightFit) -> Self {
        let mut rest = [0.0; 3];
        sum_rest(samples.columns(), light, &mut rest);
        let [square, count, greatest] = rest;
        Self { square, count, greatest }
    }
}

kernel!(
    /// Count, moments and right-hand side: see [`LightSums`].
    fn sum_explained(columns: [&[f64]; 3], light: &LightFit, out: &mut [f64; 21]) = sum_explained_body
);

kernel!(
    /// See [`LightResidual`].
    fn sum_rest(columns: [&[f64]; 3], light: &LightFit, out: &mut [f64; 3]) = sum_rest_body
);

kernel!(
    /// Residuals of a ring's levels: level less light; NaN for outliers.
    pub(super) fn ring_rest(ring: &Ring, light: &LightFit, out: &mut [f64; RING]) = ring_rest_body
);

#[inline(always)]
fn ring_rest_body(ring: &Ring, light: &LightFit, out: &mut [f64; RING]) {
    for (i, out) in out.iter_mut().enumerate() {
        let [u, v] = light.scaled(ring.x[i], ring.y[i]);
        let off = ring.level[i] - light.at_scaled(u, v);
        *out = if off.abs() <= light.limit { off } else { f64::NAN };
    }
}

/// Samples four at a time; the last four are filled up with missing ones.
#[inline(always)]
fn by_lanes([x, y, level]: [&[f64]; 3]) -> impl Iterator<Item = [[f64; LANES]; 3]> {
    let ((xs, x), (ys, y), (levels, level)) = (x.as_chunks(), y.as_chunks(), level.as_chunks());
    let mut last = [[0.0; LANES], [0.0; LANES], [f64::NAN; LANES]];
    for (to, from) in last.iter_mut().zip([x, y, level]) {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
    }
    let whole = xs.iter().zip(ys).zip(levels).map(|((x, y), level)| [*x, *y, *level]);
    whole.chain((!level.is_empty()).then_some(last))
}

#[inline(always)]
fn sum_explained_body(columns: [&[f64]; 3], light: &LightFit, out: &mut [f64; 21]) {
    let mut sums = [[0.0; LANES]; 21];
    for [x, y, level] in by_lanes(columns) {
        for i in 0..LANES {
            let [u, v] = light.scaled(x[i], y[i]);
            let explained = (level[i] - light.at_scaled(u, v)).abs() <= light.limit;
            // what is not explained is nothing at the middle
            let pick = |value: f64| if explained { value } else { 0.0 };
            let (one, u, v, level) = (pick(1.0), pick(u), pick(v), pick(level[i]));
            let (uu, uv, vv) = (u * u, u * v, v * v);
            let terms = [
                one,
                u,
                v,
                uu,
                uv,
                vv,
                uu * u,
                uu * v,
                u * vv,
                vv * v,
                uu * uu,
                uu * uv,
                uu * vv,
                uv * vv,
                vv * vv,
                level,
                level * u,
                level * v,
                level * uu,
                level * uv,
                level * vv,
            ];
            for (sum, term) in sums.iter_mut().zip(terms) {
                sum[i] += term;
            }
        }
    }
    for (out, [a, b, c, d]) in out.iter_mut().zip(sums) {
        *out = (a + b) + (c + d);
    }
}

#[inline(always)]
fn sum_rest_body(columns: [&[f64]; 3], light: &LightFit, out: &mut [f64; 3]) {
    let mut sums = [[0.0; LANES]; 3];
    for [x, y, level] in by_lanes(columns) {
        for i in 0..LANES {
            let [u, v] = light.scaled(x[i], y[i]);
            let off = (level[i] - light.at_scaled(u, v)).abs();
            let explained = off <= light.limit;
            let off = if explained { off } else { 0.0 };
            sums[0][i] += off * off;
            sums[1][i] += if explained { 1.0 } else { 0.0 };
            sums[2][i] = if off > sums[2][i] { off } else { sums[2][i] };
        }
    }
    let [square, count, greatest] = sums;
    let sum = |[a, b, c, d]: [f64; LANES]| (a + b) + (c + d);
    *out = [sum(square), sum(count), greatest.into_iter().fold(0.0, f64::max)];
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against the definition, sample by sample; some are not seen, some not explained.
        #[test]
        fn sums_are_those_of_the_definition(
            seen in prop::collection::vec((0.0..640.0f64, 0.0..480.0f64, 60.0..140.0f64, 0..9u8), 0..60),
            c in prop::array::uniform5(-9.0..9.0f64), limit in 5.0..60.0f64,
        ) {
            let mut light = LightFit::even(100.0);
            (light.c, light.limit) = ([100.0, c[0], c[1], c[2], c[3], c[4]], limit);
            (light.middle, light.unit) = ([300.0, 200.0].into(), 0.004);
            let mut samples = Samples::with_capacity(60);
            let (mut A, mut b, mut rest) = ([[0.0; 6]; 6], [0.0; 6], LightResidual::default());
            for &(x, y, level, kind) in &seen {
                let level = if kind == 0 { f64::NAN } else { level };
                samples.push(x, y, level);
                let off = (level - light.at(x, y)).abs();
                if off.is_nan() || off > limit {
                    continue;
                }
                let (u, v) = ((x - 300.0) * 0.004, (y - 200.0) * 0.004);
                let row = [1.0, u, v, u * u, u * v, v * v];
                for i in 0..6 {
                    (0..6).for_each(|j| A[i][j] += row[i] * row[j]);
                    b[i] += row[i] * level;
                }
                rest.square += off * off;
                rest.count += 1.0;
                rest.greatest = rest.greatest.max(off);
            }
            let sums = LightSums::of(&samples, &light);
            let got = LightResidual::of(&samples, &light);
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * (1.0 + b.abs());
            prop_assert!(sums.A().iter().flatten().zip(A.iter().flatten()).all(|(a, b)| close(*a, *b)));
            prop_assert!(sums.b.iter().zip(&b).all(|(a, b)| close(*a, *b)));
            prop_assert!(close(got.square, rest.square) && got.count == rest.count && close(got.greatest, rest.greatest));
        }
    }
}
