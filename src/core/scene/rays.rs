//! Directions of pixels: undistorted normalized coordinates and their derivative, fast enough for every edge
//! pixel of a frame.
//!
//! A coarse grid of exact directions gives a start within a tenth of a pixel; one Newton step on the distortion
//! polynomial, whose derivative is needed anyway, makes it exact (error below 1e-5 px). Rational lenses, which bend more, get two;
//! for equidistant ones, whose normalized coordinates are far from even, the camera's own inverse is taken.

use crate::camera_model::{CameraModel, Distortion, Lens, RationalPolynomial};
use nalgebra::{Matrix2, Vector2};

/// Side of a cell of the grid of exact directions, px: chosen, so that the start within a cell is near enough for one step of Newton's method.
/// `rays_are_the_cameras_inverse` is the test of it.
const CELL_PX: f64 = 16.0;

/// Direction of a pixel: `s` and the derivative of `s` by the pixel, row by row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) m11: f64,
    pub(super) m12: f64,
    pub(super) m21: f64,
    pub(super) m22: f64,
}

/// Directions of some pixels of one row, worked out side by side: each part of [`Ray`] for all of them.
#[derive(Debug, Clone, Default)]
pub(super) struct RowOfRays {
    u: Vec<f64>,
    x: Vec<f64>,
    y: Vec<f64>,
    m11: Vec<f64>,
    m12: Vec<f64>,
    m21: Vec<f64>,
    m22: Vec<f64>,
    count: usize,
}

impl RowOfRays {
    /// Room for `most` pixels.
    pub(super) fn new(most: usize) -> Self {
        let room = || vec![0.0; most];
        Self { u: room(), x: room(), y: room(), m11: room(), m12: room(), m21: room(), m22: room(), count: 0 }
    }

    /// Forgets all pixels.
    #[inline(always)]
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds the pixel in column `u`; none beyond the room there is.
    #[inline(always)]
    pub(super) fn push(&mut self, u: f64) {
        if let Some(place) = self.u.get_mut(self.count) {
            *place = u;
            self.count += 1;
        }
    }

    /// Directions of the pixels, in the order in which they were added.
    #[inline(always)]
    pub(super) fn iter(&self) -> impl Iterator<Item = Ray> {
        let (x, y) = (self.x.iter().take(self.count), self.y.iter());
        let m = self.m11.iter().zip(&self.m12).zip(self.m21.iter().zip(&self.m22));
        x.zip(y).zip(m).map(|((&x, &y), ((&m11, &m12), (&m21, &m22)))| Ray { x, y, m11, m12, m21, m22 })
    }
}

/// A lens that bends normalized coordinates by a formula without branches.
trait Bends {
    fn bend(&self, s: &Vector2<f64>) -> Vector2<f64>;
    fn bend_slope(&self, s: &Vector2<f64>) -> Matrix2<f64>;
}

macro_rules! bends {
    ($lens:ty) => {
        impl Bends for $lens {
            #[inline(always)]
            fn bend(&self, s: &Vector2<f64>) -> Vector2<f64> {
                self.apply(s)
            }
            #[inline(always)]
            fn bend_slope(&self, s: &Vector2<f64>) -> Matrix2<f64> {
                self.jacobian(s)
            }
        }
    };
}

bends!(Distortion);
bends!(RationalPolynomial);

/// Directions of all pixels of one camera.
#[derive(Debug, Clone)]
pub(super) struct Rays {
    camera: CameraModel,
    ideal: bool,
    inv_fx: f64,
    inv_fy: f64,
    cx: f64,
    cy: f64,
    nodes: Vec<Vector2<f64>>,
    columns: usize,
    rows: usize,
    cells_per_px_x: f64,
    cells_per_px_y: f64,
}

impl Rays {
    pub(super) fn new(camera: &CameraModel) -> Self {
        let i = camera.intrinsics();
        let (w, h) = (f64::from(i.width_px - 1).max(1.0), f64::from(i.height_px - 1).max(1.0));
        let (columns, rows) = ((w / CELL_PX).ceil() as usize, (h / CELL_PX).ceil() as usize);
        let (step_x, step_y) = (w / columns as f64, h / rows as f64);
        let ideal = camera.lens().is_ideal();
        let mut nodes = Vec::new();
        if !ideal {
            for y in 0..=rows {
                for x in 0..=columns {
                    nodes.push(camera.normalized_of(&Vector2::new(x as f64 * step_x, y as f64 * step_y)));
                }
            }
        }
        Self {
            camera: *camera,
            ideal,
            inv_fx: 1.0 / i.fx_px,
            inv_fy: 1.0 / i.fy_px,
            cx: i.cx_px,
            cy: i.cy_px,
            nodes,
            columns,
            rows,
            cells_per_px_x: 1.0 / step_x,
            cells_per_px_y: 1.0 / step_y,
        }
    }

    /// Whether pixels and normalized coordinates are an affine map of each other.
    pub(super) fn ideal(&self) -> bool {
        self.ideal
    }

    /// Direction of the pixel `(u, v)`, which lies in the image.
    #[inline(always)]
    pub(super) fn at(&self, u: f64, v: f64) -> Ray {
        let (dx, dy) = ((u - self.cx) * self.inv_fx, (v - self.cy) * self.inv_fy);
        if self.ideal {
            return Ray { x: dx, y: dy, m11: self.inv_fx, m12: 0.0, m21: 0.0, m22: self.inv_fy };
        }
        let s = self.start(u, v).unwrap_or_else(|| Vector2::new(dx, dy));
        match self.camera.lens() {
            Lens::PlumbBob(lens) => self.improve(lens, s, dx, dy),
            Lens::RationalPolynomial(lens) => self.improve_twice(lens, s, dx, dy),
            Lens::Equidistant(_) => self.exact(u, v),
        }
    }

    /// [`Self::at`] of each pixel of a row, to the bit, under a lens that distorts.
    #[inline(always)]
    pub(super) fn at_each(&self, row: &mut RowOfRays, v: f64) {
        let n = row.count;
        let (Some(u), Some(x), Some(y)) = (row.u.get(..n), row.x.get_mut(..n), row.y.get_mut(..n)) else {
            return;
        };
        let dy = (v - self.cy) * self.inv_fy;
        for ((&u, x), y) in u.iter().zip(&mut *x).zip(&mut *y) {
            let s = self.start(u, v).unwrap_or_else(|| Vector2::new((u - self.cx) * self.inv_fx, dy));
            (*x, *y) = (s.x, s.y);
        }
        let (Some(m11), Some(m12), Some(m21), Some(m22)) =
            (row.m11.get_mut(..n), row.m12.get_mut(..n), row.m21.get_mut(..n), row.m22.get_mut(..n))
        else {
            return;
        };
        let m = m11.iter_mut().zip(m12).zip(m21.iter_mut().zip(m22));
        let pixels = u.iter().zip(x).zip(y).zip(m);
        let fill = |ray: Ray, x: &mut f64, y: &mut f64, m: [&mut f64; 4]| {
            let [m11, m12, m21, m22] = m;
            (*x, *y, *m11, *m12, *m21, *m22) = (ray.x, ray.y, ray.m11, ray.m12, ray.m21, ray.m22);
        };
        match self.camera.lens() {
            Lens::PlumbBob(lens) => {
                for (((&u, x), y), ((m11, m12), (m21, m22))) in pixels {
                    let ray = self.improve(lens, Vector2::new(*x, *y), (u - self.cx) * self.inv_fx, dy);
                    fill(ray, x, y, [m11, m12, m21, m22]);
                }
            }
            Lens::RationalPolynomial(lens) => {
                for (((&u, x), y), ((m11, m12), (m21, m22))) in pixels {
                    let ray = self.improve_twice(lens, Vector2::new(*x, *y), (u - self.cx) * self.inv_fx, dy);
                    fill(ray, x, y, [m11, m12, m21, m22]);
                }
            }
            Lens::Equidistant(_) => {
                for (((&u, x), y), ((m11, m12), (m21, m22))) in pixels {
                    fill(self.exact(u, v), x, y, [m11, m12, m21, m22]);
                }
            }
        }
    }

    /// By the camera's own inverse.
    fn exact(&self, u: f64, v: f64) -> Ray {
        let s = self.camera.normalized_of(&Vector2::new(u, v));
        let J = self.camera.pixel_jacobian(&s);
        let inverse = 1.0 / (J.m11 * J.m22 - J.m12 * J.m21);
        Ray {
            x: s.x,
            y: s.y,
            m11: J.m22 * inverse,
            m12: -J.m12 * inverse,
            m21: -J.m21 * inverse,
            m22: J.m11 * inverse,
        }
    }

    #[inline(always)]
    fn improve_twice(&self, lens: &impl Bends, s: Vector2<f64>, dx: f64, dy: f64) -> Ray {
        let ray = self.improve(lens, s, dx, dy);
        self.improve(lens, Vector2::new(ray.x, ray.y), dx, dy)
    }

    /// One Newton step from `s` towards the direction whose distorted one is `(dx, dy)`.
    #[inline(always)]
    fn improve(&self, lens: &impl Bends, s: Vector2<f64>, dx: f64, dy: f64) -> Ray {
        let rest = lens.bend(&s) - Vector2::new(dx, dy);
        let J = lens.bend_slope(&s);
        let inverse = 1.0 / (J.m11 * J.m22 - J.m12 * J.m21);
        let (i11, i12, i21, i22) = (J.m22 * inverse, -J.m12 * inverse, -J.m21 * inverse, J.m11 * inverse);
        Ray {
            x: s.x - (i11 * rest.x + i12 * rest.y),
            y: s.y - (i21 * rest.x + i22 * rest.y),
            m11: i11 * self.inv_fx,
            m12: i12 * self.inv_fy,
            m21: i21 * self.inv_fx,
            m22: i22 * self.inv_fy,
        }
    }

    /// Bilinear start between the nodes around the pixel.
    #[inline(always)]
    fn start(&self, u: f64, v: f64) -> Option<Vector2<f64>> {
        let (gx, gy) = (u * self.cells_per_px_x, v * self.cells_per_px_y);
        let (ix, iy) = ((gx as usize).min(self.columns - 1), (gy as usize).min(self.rows - 1));
        let (fx, fy) = (gx - ix as f64, gy - iy as f64);
        let stride = self.columns + 1;
        let at = iy * stride + ix;
        let [n00, n01]: &[_; 2] = self.nodes.get(at..at + 2)?.first_chunk()?;
        let [n10, n11]: &[_; 2] = self.nodes.get(at + stride..at + stride + 2)?.first_chunk()?;
        let (top, bottom) = (n00 + (n01 - n00) * fx, n10 + (n11 - n10) * fx);
        Some(top + (bottom - top) * fy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Equidistant, Intrinsics};

    #[test]
    fn rays_are_the_cameras_inverse() {
        let intrinsics = Intrinsics {
            fx_px: 350.0,
            fy_px: 360.0,
            cx_px: 310.0,
            cy_px: 250.0,
            width_px: 640,
            height_px: 480,
        };
        let rational =
            RationalPolynomial { k1: 0.5, k2: 0.02, p1: 0.002, k4: 0.6, k5: 0.01, ..Default::default() };
        for lens in [
            Lens::default(),
            Distortion { k1: -0.2, k2: 0.05, p1: 0.002, p2: -0.001, k3: 0.0 }.into(),
            Distortion { k1: 0.1, ..Distortion::default() }.into(),
            rational.into(),
            Equidistant { k1: -0.02, k2: 0.005, ..Equidistant::default() }.into(),
        ] {
            let camera = CameraModel::new(intrinsics, lens).unwrap();
            let rays = Rays::new(&camera);
            // side by side they are the same to the bit
            let mut row = RowOfRays::new(7);
            for v in [0.0, 200.0, 479.0] {
                row.clear();
                let columns = [1.5, 5.5, 9.5, 320.5, 639.5, 641.5, 17.25];
                columns.into_iter().chain([3.0]).for_each(|u| row.push(u));
                rays.at_each(&mut row, v);
                let bits = |r: Ray| [r.x, r.y, r.m11, r.m12, r.m21, r.m22].map(f64::to_bits);
                let alone: Vec<_> = columns.iter().map(|u| bits(rays.at(*u, v))).collect();
                let together: Vec<_> = row.iter().map(bits).collect();
                assert!(rays.ideal() || together == alone, "row {v}");
                assert_eq!(together.len(), 7, "no more than there is room for");
            }
            for (u, v) in
                [(0.0, 0.0), (639.0, 479.0), (639.0, 0.0), (13.0, 400.0), (320.0, 240.0), (500.5, 77.25)]
            {
                let ray = rays.at(u, v);
                let s = camera.normalized_of(&Vector2::new(u, v));
                assert!((ray.x - s.x).abs() < 1e-7 && (ray.y - s.y).abs() < 1e-7, "{u} {v}: {ray:?} {s}");
                let J = camera.pixel_jacobian(&s);
                let unit = J * nalgebra::Matrix2::new(ray.m11, ray.m12, ray.m21, ray.m22);
                assert!((unit - nalgebra::Matrix2::identity()).norm() < 1e-3, "{unit}");
            }
        }
    }
}
