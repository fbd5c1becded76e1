//! An ellipse from the gradients of its rim, without edge points (Ouellet and Hébert 2009): the dual conic.
//!
//! The gradient of each pixel near the rim defines a line through the pixel, across the gradient: `l = (g_x, g_y, -(g_x x + g_y y))`. Lines
//! along an ellipse touch it: `l^T C* l = 0` with
//!
//! ```text
//! C* = | c c^T - S   c |      centre c, shape S
//!      |    c^T      1 |
//! ```
//! which is linear in the five unknowns; lines count with the square of their gradient. Pixels on both sides of the rim make up for
//! each other. The covariance is that of the pixels' noise carried through gradients and solution to first order, neighbours' shared
//! pixels included, with a floor for what sharp images hide between their pixels. The half axes come out too small by what blur and
//! gradient smooth, 0.02 to 0.04 px at a radius of 10 px; the covariance of the shape does not count that. The centre is free of it.

use super::{Ellipse, EllipseFit, ImageView, Window};
use crate::linalg::Ldlt;
use nalgebra::{SMatrix, SVector, Vector2};

type V5 = SVector<f64, 5>;
type M5 = SMatrix<f64, 5, 5>;

/// What noise does not explain of a pixel of rim: pixels are squares; px. Chosen by hand: without it sharp images without noise would state nothing.
const FLOOR_PX: f64 = 0.0125;
/// Largest part of an image that is used, px^2. Chosen by hand: it bounds time and memory, and a dot of 1000 px is larger than any in use.
const MAX_PIXELS: usize = 1 << 20;

/// The fit. Owns its buffer.
#[derive(Debug, Clone, Default)]
pub struct DualConic {
    /// What one grey level more in a pixel changes in the sums.
    influence: Vec<V5>,
}

impl DualConic {
    /// Fits an ellipse to the gradients within `band_px` of `start`, in an image whose noise has a standard deviation of `noise_levels`.
    /// `None` where there is too little gradient, the start is no ellipse or lies outside, or its window has more than 2^20 px.
    #[must_use]
    pub fn fit(
        &mut self,
        image: &ImageView<'_>,
        start: &Ellipse,
        band_px: f64,
        noise_levels: f64,
    ) -> Option<EllipseFit> {
        if !start.is_real() || !(band_px > 0.0) || image.width() < 3 || image.height() < 3 {
            return None;
        }
        let [xx, _, yy] = start.shape_px2;
        let c = start.centre_px;
        let around = Window::around(c.x, c.y, xx.sqrt() + band_px, yy.sqrt() + band_px, image);
        // the operator needs a neighbour on each side
        let (x0, y0) = (around.x0.max(1), around.y0.max(1));
        let (x1, y1) = (around.x1.min(image.width() - 1), around.y1.min(image.height() - 1));
        let (width, height) = (x1.saturating_sub(x0), y1.saturating_sub(y0));
        let size = (width + 2).checked_mul(height + 2)?;
        if width == 0 || height == 0 || size > MAX_PIXELS {
            return None;
        }
        // positions about the centre in units of the axis, so that all unknowns are of one size
        let unit = start.axes_px().0;
        let line_of = |x: usize, y: usize| {
            let d = Vector2::new(x as f64, y as f64) - c;
            if start.distance_px(&(c + d)).abs() > band_px {
                return None;
            }
            let (gx, gy) = sobel(image, x, y)?;
            Some((Vector2::new(gx, gy), d / unit))
        };
        let (mut N, mut r, mut used, mut squares) = (M5::zeros(), V5::zeros(), 0, 0.0);
        for y in y0..y1 {
            for x in x0..x1 {
                let Some((g, d)) = line_of(x, y) else { continue };
                let (a, w) = row(&g, &d);
                N += a * a.transpose();
                r -= a * (w * w);
                squares += w.powi(4);
                used += 1;
            }
        }
        if used < 8 || !(squares >= 0.0) {
            return None;
        }
        let theta = V5::from(Ldlt::of(&N)?.solve(&r.into()));
        let inverse = M5::from(Ldlt::of(&N)?.inverse());
        // d theta = -N^-1 sum (da e + a de): spread over the pixels of each gradient
        self.influence.clear();
        self.influence.resize(size, V5::zeros());
        for y in y0..y1 {
            for x in x0..x1 {
                let Some((g, d)) = line_of(x, y) else { continue };
                let (a, w) = row(&g, &d);
                let e = a.dot(&theta) + w * w;
                let change = |da: V5, dw: f64| da * e + a * (da.dot(&theta) + 2.0 * w * dw);
                let by_x = change(V5::new(2.0 * g.x, g.y, 0.0, w - g.x * d.x, -g.y * d.x), -d.x);
                let by_y = change(V5::new(0.0, g.x, 2.0 * g.y, -g.x * d.y, w - g.y * d.y), -d.y);
                for (j, row) in SOBEL.iter().enumerate() {
                    for (i, weight) in row.iter().enumerate() {
                        let at = (y - y0 + j) * (width + 2) + x - x0 + i;
                        if let Some(sum) = self.influence.get_mut(at) {
                            *sum += by_x * *weight + by_y * SOBEL[i][j];
                        }
                    }
                }
            }
        }
        let scatter = self.influence.iter().fold(M5::zeros(), |sum, v| sum + v * v.transpose());
        let theta_covariance = inverse * scatter * inverse * (noise_levels * noise_levels);
        let [a, b, cc, d, e] = theta.into();
        let (cx, cy) = (0.5 * d, 0.5 * e);
        let shape = [cx * cx - a, cx * cy - 0.5 * b, cy * cy - cc];
        #[rustfmt::skip]
        let J = M5::new(
            0.0, 0.0, 0.0, 0.5, 0.0,
            0.0, 0.0, 0.0, 0.0, 0.5,
            -1.0, 0.0, 0.0, cx, 0.0,
            0.0, -0.5, 0.0, 0.5 * cy, 0.5 * cx,
            0.0, 0.0, -1.0, 0.0, cy,
        );
        let to_px = M5::from_diagonal(&V5::new(unit, unit, unit * unit, unit * unit, unit * unit));
        let J = to_px * J;
        let ellipse =
            Ellipse { centre_px: c + Vector2::new(cx, cy) * unit, shape_px2: shape.map(|s| s * unit * unit) };
        let mut covariance = J * theta_covariance * J.transpose();
        // as if each pixel of the rim, of about pi (a + b), were off by that much
        let (a, b) = ellipse.axes_px();
        let floor = 2.0 * FLOOR_PX * FLOOR_PX / (std::f64::consts::PI * (a + b));
        for i in 0..5 {
            covariance[(i, i)] += floor * if i < 2 { 1.0 } else { 4.0 * a * b };
        }
        // the residuals are no noise: lines beside the rim do not touch it
        ellipse.is_real().then_some(EllipseFit { ellipse, covariance, chi2: 1.0, used })
    }
}

/// Weights of the derivative along x, rows from above; along y they are its transpose.
const SOBEL: [[f64; 3]; 3] = [[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]];

/// Both derivatives at a pixel that has all neighbours.
fn sobel(image: &ImageView<'_>, x: usize, y: usize) -> Option<(f64, f64)> {
    let row = |y: usize| image.row(y).get(x.checked_sub(1)?..x + 2)?.first_chunk::<3>();
    let [a, b, c] = [row(y.checked_sub(1)?)?, row(y)?, row(y + 1)?].map(|r| r.map(i32::from));
    let gx = a[2] + 2 * b[2] + c[2] - a[0] - 2 * b[0] - c[0];
    let gy = c[0] + 2 * c[1] + c[2] - a[0] - 2 * a[1] - a[2];
    Some((f64::from(gx), f64::from(gy)))
}

/// The equation of one line: coefficients of the unknowns, and the root of the constant.
fn row(g: &Vector2<f64>, d: &Vector2<f64>) -> (V5, f64) {
    let w = -g.dot(d);
    (V5::new(g.x * g.x, g.x * g.y, g.y * g.y, g.x * w, g.y * w), w)
}

#[cfg(test)]
mod tests {
    use super::super::test_image::{SyntheticImage, any_image};
    use super::*;
    use crate::linalg::Random;
    use proptest::prelude::*;

    #[test]
    fn centre_and_covariance_on_rendered_ellipses() {
        let mut random = Random::new(12);
        for (radius, blur_px) in [(5.0, 0.0), (10.0, 0.5), (10.0, 0.0), (10.0, 1.0), (20.0, 0.5)] {
            let (mut squares, mut chi2, mut size) = (0.0, 0.0, 0.0);
            let n = 250;
            for _ in 0..n {
                let half = radius as usize + 8;
                let place = || half as f64;
                let centre = Vector2::new(place() + random.uniform(), place() + random.uniform());
                let b = radius * random.between(0.6, 1.0);
                let truth = Ellipse::new(centre, radius, b, random.between(0.0, 3.0));
                let image = SyntheticImage {
                    width: 2 * half + 1,
                    height: 2 * half + 1,
                    dark: 40.0,
                    light: 200.0,
                    blur_px,
                    noise_levels: 2.0,
                };
                let bytes = image.render(&mut random, |x, y| truth.distance_px(&Vector2::new(x, y)));
                let view = ImageView::new(&bytes, image.width, image.height).unwrap();
                let start = Ellipse::new(
                    centre + Vector2::new(random.between(-0.3, 0.3), 0.2),
                    radius + 0.2,
                    b + 0.1,
                    truth.angle_rad(),
                );
                let noise = (4.0f64 + 1.0 / 12.0).sqrt();
                let fit = DualConic::default().fit(&view, &start, 3.0, noise).unwrap();
                let e = fit.ellipse.centre_px - centre;
                squares += e.norm_squared() / 2.0 / f64::from(n);
                chi2 += (e.transpose() * fit.centre_covariance_px2().try_inverse().unwrap() * e)[0]
                    / 2.0
                    / f64::from(n);
                size += (fit.ellipse.axes_px().0 - radius) / f64::from(n);
            }
            assert!(size.abs() < 0.05, "{radius} {blur_px} {size}");
            if radius >= 10.0 {
                assert!(squares.sqrt() < 0.01, "{radius} {blur_px} {}", squares.sqrt());
                assert!((0.75..1.3).contains(&chi2), "{radius} {blur_px} {chi2}");
            }
        }
    }

    proptest! {
        #[test]
        fn any_image_is_taken(image in any_image(), x in -20.0..160.0f64, y in -20.0..30.0f64, a in 0.1..90.0f64, band in -1.0..9.0f64) {
            let start = Ellipse::new(Vector2::new(x, y), a, 0.7 * a, 0.3);
            if let Some(fit) = DualConic::default().fit(&image.view(), &start, band, 2.0) {
                prop_assert!(fit.ellipse.is_real());
            }
        }
    }
}
