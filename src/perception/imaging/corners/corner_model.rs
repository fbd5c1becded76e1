//! Model of the image of a point where four squares meet.
//!
//! Two straight edges through the corner `c`, with unit normals `n_u`, `n_v`, split the plane; `u = n_u (p - c) / sigma` and `v` are
//! the distances in deviations of the blur. A blurred product of signs is an orthant probability of two normal deviates with
//! correlation `rho = n_u n_v` (Mehler's series), and light that varies is a factor, linear within the window:
//!
//! ```text
//! P = E(u) E(v) + sum_n rho^n / n! H_n(u) H_n(v)      E = erf(u / sqrt 2), H_n = He_{n-1}(u) dE/du
//! I = (m + a P) (1 + k_x x + k_y y) + a sigma^2 (k_x dP/dx + k_y dP/dy)
//! ```
//! (the last term because the lens blurs what is lit).
//! Where squares are small, the next edge on either side, a square's side away, belongs to `E` and `H`. The blur includes the
//! pixel's own square: its variance of 1/12 px^2, and its kurtosis, which the tail of a sharp edge shows.

use crate::linalg::Eight;

/// What is fitted, by index.
pub(super) mod parameter {
    /// Corner, px from the window's middle.
    pub(in super::super) const X: usize = 0;
    /// Corner, px from the window's middle.
    pub(in super::super) const Y: usize = 1;
    /// Level between light and dark, grey levels.
    pub(in super::super) const MIDDLE: usize = 2;
    /// Half the contrast, grey levels; negative where the quadrant of positive `u` and `v` is dark.
    pub(in super::super) const AMPLITUDE: usize = 3;
    /// Direction of `n_u`, rad.
    pub(in super::super) const TURN_U: usize = 4;
    /// Direction of `n_v`, rad.
    pub(in super::super) const TURN_V: usize = 5;
    /// Deviation of the blur, px.
    pub(in super::super) const BLUR: usize = 6;
    /// Light's relative change in x, 1/px.
    pub(in super::super) const LIGHT_X: usize = 7;
    /// Light's relative change in y, 1/px.
    pub(in super::super) const LIGHT_Y: usize = 8;
    /// How many.
    pub(in super::super) const COUNT: usize = 9;
}
use parameter::{AMPLITUDE, BLUR, COUNT, LIGHT_X, LIGHT_Y, MIDDLE, TURN_U, TURN_V, X, Y};

/// Terms of Mehler's series. Chosen by hand: what is left falls as `rho^5 / 120` of its fifth, edges 60 degrees apart have `rho` = 1/2.
const TERMS: usize = 4;

/// Eight pixels: where, how light, and whether they count.
#[derive(Debug, Clone, Copy)]
pub(super) struct CornerPixels {
    pub(super) x: Eight,
    pub(super) y: Eight,
    pub(super) level: Eight,
    /// 1, or 0 for pixels that are left out.
    pub(super) weight: Eight,
}

/// Derivatives of the model at eight pixels by index, and behind them the residuals.
pub(super) type CornerJacobian = [Eight; COUNT + 1];
/// Index of the residuals.
pub(super) const RESIDUAL: usize = COUNT;

/// One edge and its neighbours, as all pixels need it.
#[derive(Debug, Clone, Copy)]
struct BlurredEdge {
    normal: [f32; 2],
    /// 1 / sigma, 1/px.
    inverse_blur: f32,
    /// To the next parallel edges before and behind, in deviations; none where they are out of sight.
    next: Option<[f32; 2]>,
    /// Of the pixel's square, `kappa_4 / (24 sigma^4)`.
    kurtosis: f32,
}

/// `E`, `H_1` to `H_5` and the distance along the edge, px.
struct Profile {
    step: Eight,
    h: [Eight; TERMS + 1],
    along: Eight,
}

impl BlurredEdge {
    fn new(turn: f32, blur: f32, next_px: Option<[f32; 2]>) -> Self {
        let (s, c) = turn.sin_cos();
        let fourth = |v: f32| v * v * v * v;
        let inverse_blur = 1.0 / blur;
        Self {
            normal: [c, s],
            inverse_blur,
            next: next_px.map(|both| both.map(|l| l * inverse_blur)),
            kurtosis: -(fourth(c) + fourth(s)) / 120.0 / 24.0 * fourth(inverse_blur),
        }
    }

    #[inline(always)]
    fn profile(&self, dx: Eight, dy: Eight) -> Profile {
        let [nx, ny] = self.normal;
        let z = (dx * nx + dy * ny) * self.inverse_blur;
        let mut out = Profile { step: Eight::ZERO, h: [Eight::ZERO; TERMS + 1], along: dy * nx - dx * ny };
        self.add(&mut out, z, 1.0);
        if let Some([before, behind]) = self.next {
            self.add(&mut out, z + before, -1.0);
            self.add(&mut out, z + (-behind), -1.0);
        }
        out
    }

    /// One edge at distance `z` deviations.
    #[inline(always)]
    fn add(&self, out: &mut Profile, z: Eight, sign: f32) {
        let (step, slope) = z.step_and_slope();
        let slope = slope * sign;
        let z2 = z * z;
        let he3 = (z2 + (-3.0)) * z;
        let he4 = (z2 + (-6.0)) * z2 + 3.0;
        out.step = out.step + step * sign - slope * he3 * self.kurtosis;
        let [h1, h2, h3, h4, h5] = &mut out.h;
        *h1 = *h1 + slope + slope * he4 * self.kurtosis;
        *h2 = *h2 + slope * z;
        *h3 = *h3 + slope * (z2 + (-1.0));
        *h4 = *h4 + slope * he3;
        *h5 = *h5 + slope * he4;
    }
}

/// The model at one set of parameters.
#[derive(Debug, Clone, Copy)]
pub(super) struct CornerModel {
    parameters: [f32; COUNT],
    u: BlurredEdge,
    v: BlurredEdge,
    /// Cosine between the normals, and its derivatives by both turns.
    rho: f32,
    rho_by_turns: [f32; 2],
    /// `rho^n / n!`, and its derivatives.
    mehler: [f32; TERMS],
    powers: [f32; TERMS],
}

impl CornerModel {
    /// With the distances of the next edges before and behind in `u` and `v`, px, where they are to be seen.
    pub(super) fn new(parameters: &[f64; COUNT], next_px: [Option<[f32; 2]>; 2]) -> Self {
        let parameters = parameters.map(|p| p as f32);
        let [u, v] = [(TURN_U, next_px[0]), (TURN_V, next_px[1])]
            .map(|(turn, next)| BlurredEdge::new(get(&parameters, turn), get(&parameters, BLUR), next));
        let rho = u.normal[0] * v.normal[0] + u.normal[1] * v.normal[1];
        let sine = u.normal[0] * v.normal[1] - u.normal[1] * v.normal[0];
        let mehler = [rho, rho * rho / 2.0, rho * rho * rho / 6.0, rho * rho * rho * rho / 24.0];
        let powers = [1.0, rho, rho * rho / 2.0, rho * rho * rho / 6.0];
        Self { parameters, u, v, rho, rho_by_turns: [sine, -sine], mehler, powers }
    }

    /// Observed less predicted, and the derivatives of what is predicted.
    #[inline(always)]
    pub(super) fn at(&self, pixels: &CornerPixels) -> CornerJacobian {
        let [x, y, middle, amplitude, _, _, blur, light_x, light_y] = self.parameters;
        let (dx, dy) = (pixels.x + (-x), pixels.y + (-y));
        let (u, v) = (self.u.profile(dx, dy), self.v.profile(dx, dy));
        let (mut p, mut by_u, mut by_v) = (u.step * v.step, u.h[0] * v.step, u.step * v.h[0]);
        let mut by_rho = Eight::ZERO;
        for ((pair, factor), before) in u.h.windows(2).zip(v.h.windows(2)).zip(self.mehler).zip(self.powers) {
            if let ([hu, next_u], [hv, next_v]) = pair {
                let both = *hu * *hv;
                p = p + both * factor;
                by_rho = by_rho + both * before;
                by_u = by_u - *next_u * *hv * factor;
                by_v = by_v - *hu * *next_v * factor;
            }
        }
        let light = (pixels.x * light_x + pixels.y * light_y + 1.0) * pixels.weight;
        let level = p * amplitude + middle;
        let scale = light * (amplitude / blur);
        let (along_u, along_v) = (by_u * scale, by_v * scale);
        let mut derivative = [Eight::ZERO; COUNT + 1];
        derivative[X] = -(along_u * self.u.normal[0] + along_v * self.v.normal[0]);
        derivative[Y] = -(along_u * self.u.normal[1] + along_v * self.v.normal[1]);
        derivative[MIDDLE] = light;
        derivative[AMPLITUDE] = p * light;
        // by the angle between the edges too
        let [rho_by_u, rho_by_v] = self.rho_by_turns;
        let by_rho = by_rho * light;
        derivative[TURN_U] = along_u * u.along + by_rho * (amplitude * rho_by_u);
        derivative[TURN_V] = along_v * v.along + by_rho * (amplitude * rho_by_v);
        // blurring more is diffusion: the second derivatives
        let mut curved = by_rho * (2.0 * self.rho) - (u.h[1] * v.step + u.step * v.h[1]) * light;
        for ((hu, hv), factor) in u.h.windows(3).zip(v.h.windows(3)).zip(self.mehler) {
            if let ([hu, _, hu2], [hv, _, hv2]) = (hu, hv) {
                curved = curved + (*hu2 * *hv + *hu * *hv2) * light * factor;
            }
        }
        derivative[BLUR] = curved * (amplitude / blur);
        derivative[LIGHT_X] = level * pixels.x * pixels.weight;
        derivative[LIGHT_Y] = level * pixels.y * pixels.weight;
        let lit = (derivative[X] * light_x + derivative[Y] * light_y) * (blur * blur);
        derivative[RESIDUAL] = (pixels.level * pixels.weight) - level * light + lit;
        derivative
    }
}

/// A parameter; all indices are constants below the length.
fn get(parameters: &[f32; COUNT], index: usize) -> f32 {
    parameters.get(index).copied().unwrap_or(f32::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges up to 30 degrees from square, next edges in sight or not, in even light. Farther from square the last term of the series counts,
    /// which has no share in the derivative by the blur: a tenth of it is missing at 40 degrees.
    #[test]
    fn derivatives_are_those_of_the_model() {
        let pixels = CornerPixels {
            x: Eight([-3.0, -1.0, 0.0, 1.0, 2.0, 0.0, 3.0, -2.0]),
            y: Eight([1.0, -2.0, 0.0, 1.0, -1.0, 3.0, 2.0, -3.0]),
            level: Eight([0.0; 8]),
            weight: Eight([1.0; 8]),
        };
        for skew in [-0.5, -0.3, 0.0, 0.4] {
            for (blur, next) in [(0.8, None), (1.5, None), (1.2, Some([5.0, 6.0]))] {
                let p =
                    [0.2, -0.3, 120.0, 60.0, 0.3, 0.3 + std::f64::consts::FRAC_PI_2 + skew, blur, 0.0, 0.0];
                let row = CornerModel::new(&p, [next; 2]).at(&pixels);
                for k in [X, Y, MIDDLE, AMPLITUDE, TURN_U, TURN_V, BLUR] {
                    let h = 1e-2;
                    let by = |h: f64| {
                        let mut moved = p;
                        moved[k] += h;
                        CornerModel::new(&moved, [next; 2]).at(&pixels)[RESIDUAL].0
                    };
                    let largest = row[k].0.iter().fold(0.0, |m: f32, d| m.max(d.abs()));
                    for ((d, before), behind) in row[k].0.iter().zip(by(-h)).zip(by(h)) {
                        let told = (before - behind) / (2.0 * h as f32);
                        // the series' last term has no share in the derivative by the blur
                        assert!((d - told).abs() < 0.05 * largest, "{skew} {blur} {k}: {d} {told}");
                    }
                }
            }
        }
    }
}
