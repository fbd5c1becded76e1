//! The scene of one instant as the camera sees it: implicit curves for exact coverage, and the bands around them.
//!
//! With `H = [r1 r2 p]` of `X_CO`, `(a, b, w) = H^-1 s~` are the plane coordinates of a direction times `w`, the
//! inverse depth. A plate edge is linear in them, `a - x_min w >= 0`, and stays exact where the plate passes
//! behind the camera; a dot is `L1^2 + L2^2 - L3^2 <= 0` with `L1 = a - cx w`, `L2 = b - cy w`, `L3 = R w`.
//! Along any straight line a conic is a quadratic, so the distance of a pixel from an edge, along the normal, has
//! a closed form; the distortion is taken as affine within one pixel.

use super::bands::Bands;
use super::look::Paint;
use super::profile::{EdgeProfile, LANES, cast};
use super::rays::{Ray, RowOfRays};
use super::sensor::LEVEL_BITS;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::target::DotTarget;
use nalgebra::{Matrix3, Point3, Vector2, Vector3};

/// Bits of the four plate edges in a band's mask; the dots follow.
const EDGES: u8 = 0x0f;
const DOT_SHIFT: u32 = 4;

/// Pixels evaluated together, and their columns from the middle one.
const CENTRE_LANE: f64 = 1.5;
const FROM_CENTRE: [f32; LANES] = [-1.5, -0.5, 0.5, 1.5];
/// No level is larger.
const LARGEST_LEVEL: f32 = 65535.0;

/// A linear form of the pixel (ideal camera) or of the normalized direction: `x a + y b + c`.
type Form = Vector3<f64>;

/// One instant of the scene.
#[derive(Debug, Clone)]
pub(super) struct View {
    visible: bool,
    /// Whether the camera sees the side with the dots.
    front: bool,
    depth: Form,
    edges: [Form; 4],
    dots: [[Form; 3]; 4],
    bands: Bands,
}

impl View {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self {
            visible: false,
            front: false,
            depth: Form::zeros(),
            edges: [Form::zeros(); 4],
            dots: [[Form::zeros(); 3]; 4],
            bands: Bands::new(width, height),
        }
    }

    /// The bands of pixels near an edge.
    pub(super) fn bands(&self) -> &Bands {
        &self.bands
    }

    /// Sets the view up for the pose `X_CO`. `half_px`: reach of an edge.
    pub(super) fn set(&mut self, X_CO: &Pose, camera: &CameraModel, target: &DotTarget, half_px: f64) {
        self.bands.clear();
        self.visible = false;
        let R = X_CO.rotation.to_rotation_matrix();
        let p = X_CO.translation.vector;
        let H = Matrix3::from_columns(&[R.matrix().column(0).into(), R.matrix().column(1).into(), p]);
        let facing = R.matrix().column(2).dot(&p);
        // edge-on the plate is a line without width
        if !facing.is_finite() || facing.abs() < 1e-9 {
            return;
        }
        let Some(inverse) = H.try_inverse() else { return };
        self.visible = true;
        self.front = facing > 0.0;
        let form = |row: usize| self_form(&inverse, row, camera);
        let (a, b, w) = (form(0), form(1), form(2));
        let (low, high) = target.plate_range_m();
        self.depth = w;
        self.edges = [a - w * low, w * high - a, b - w * low, w * high - b];
        let radii = target.radii_m();
        for ((dot, centre), radius) in self.dots.iter_mut().zip(target.points()).zip(radii) {
            *dot = [a - w * centre.x, b - w * centre.y, w * radius];
        }
        let outline = Outline::new(X_CO, camera, half_px + 0.5);
        let corners = [
            Point3::new(low, low, 0.0),
            Point3::new(low, high, 0.0),
            Point3::new(high, low, 0.0),
            Point3::new(high, high, 0.0),
        ];
        for (bit, [i, j]) in [[0, 1], [2, 3], [0, 2], [1, 3]].into_iter().enumerate() {
            if let (Some(from), Some(to)) = (corners.get(i), corners.get(j)) {
                outline.line(from, to, 1 << bit, &mut self.bands);
            }
        }
        if self.front {
            for (i, (centre, radius)) in target.points_O().iter().zip(radii).enumerate() {
                outline.circle(centre, radius, 1 << (i as u32 + DOT_SHIFT), &mut self.bands);
            }
        }
        self.bands.finish();
    }

    /// Exact grey level at a pixel far from all edges.
    pub(super) fn flat_level(&self, u: f64, v: f64, &Paint { rays, look, .. }: &Paint<'_>) -> f64 {
        if !self.visible {
            return look.background;
        }
        let ray = rays.at(u, v);
        let (x, y) = if rays.ideal() { (u, v) } else { (ray.x, ray.y) };
        let value = |form: &Form| form.x * x + form.y * y + form.z;
        if value(&self.depth) <= 0.0 || self.edges.iter().any(|edge| value(edge) < 0.0) {
            return look.background;
        }
        let in_dot = |[f1, f2, f3]: &[Form; 3]| {
            let (l1, l2, l3) = (value(f1), value(f2), value(f3));
            l1 * l1 + l2 * l2 < l3 * l3
        };
        if self.front && self.dots.iter().any(in_dot) { look.dots } else { look.plate }
    }

    /// Exact grey levels of the pixels `u0..` of row `v`, all near the edges in `mask`, in the sensor's fixed point.
    /// Four pixels at a time, in which the lens is taken as affine: the directions of their middles come from `directions`, see
    /// [`Self::add_middles`].
    #[inline(always)]
    pub(super) fn edge_levels(
        &self,
        u0: usize,
        v: f64,
        mask: u8,
        paint: &Paint<'_>,
        directions: &mut impl Iterator<Item = Ray>,
        levels: &mut [u16],
    ) {
        let Paint { rays, profile, look } = paint;
        let (background, plate, dots) = (look.background as f32, look.plate as f32, look.dots as f32);
        let scale = f32::from(1u16 << LEVEL_BITS);
        for (chunk, levels) in levels.chunks_mut(LANES).enumerate() {
            let u = middle(u0, chunk);
            let place = if rays.ideal() {
                Place::Ideal(u, v)
            } else {
                Place::Ray(directions.next().unwrap_or_else(|| rays.at(u, v)))
            };
            let mut cover = [1.0f32; LANES];
            for edge in chosen(&self.edges, mask & EDGES) {
                let part = line_coverage(place.apply(edge), profile);
                cover.iter_mut().zip(part).for_each(|(c, p)| *c *= p);
            }
            let mut sum = cover.map(|c| background + (plate - background) * c);
            for dot in chosen(&self.dots, mask >> DOT_SHIFT) {
                let part = dot_coverage(&place, dot, profile);
                sum.iter_mut().zip(part).for_each(|(s, p)| *s += (dots - plate) * p);
            }
            let exact = sum.map(|s| cast(s * scale + 0.5, LARGEST_LEVEL) as u16);
            if let [a, b, c, d] = levels {
                [*a, *b, *c, *d] = exact;
            } else {
                levels.iter_mut().zip(exact).for_each(|(level, exact)| *level = exact);
            }
        }
    }

    /// Adds the pixels at which [`Self::edge_levels`] wants directions for the pixels `from..to`.
    #[inline(always)]
    pub(super) fn add_middles(from: usize, to: usize, directions: &mut RowOfRays) {
        for chunk in 0..to.saturating_sub(from).div_ceil(LANES) {
            directions.push(middle(from, chunk));
        }
    }
}

/// Column of the middle of a chunk of pixels from column `u0` on.
#[inline(always)]
fn middle(u0: usize, chunk: usize) -> f64 {
    (u0 + chunk * LANES) as f64 + CENTRE_LANE
}

/// The entries whose bits are set, in their order.
#[inline(always)]
fn chosen<T>(all: &[T; 4], mut mask: u8) -> impl Iterator<Item = &T> {
    std::iter::from_fn(move || {
        let next = all.get(mask.trailing_zeros() as usize)?;
        mask &= mask.wrapping_sub(1);
        Some(next)
    })
}

/// Row of `H^-1` as a form of the pixel, or of the direction when the lens distorts.
fn self_form(inverse: &Matrix3<f64>, row: usize, camera: &CameraModel) -> Form {
    let f = Vector3::new(inverse[(row, 0)], inverse[(row, 1)], inverse[(row, 2)]);
    if !camera.distortion().is_none() {
        return f;
    }
    let i = camera.intrinsics();
    let (x, y) = (f.x / i.fx_px, f.y / i.fy_px);
    Vector3::new(x, y, f.z - x * i.cx_px - y * i.cy_px)
}

/// Where forms are evaluated.
enum Place {
    /// Forms of the pixel itself.
    Ideal(f64, f64),
    /// Forms of the direction.
    Ray(Ray),
}

impl Place {
    /// Value of a form and its derivative by the pixel.
    #[inline(always)]
    fn apply(&self, form: &Form) -> (f64, f64, f64) {
        match self {
            Self::Ideal(u, v) => (form.x * u + form.y * v + form.z, form.x, form.y),
            Self::Ray(ray) => (
                form.x * ray.x + form.y * ray.y + form.z,
                form.x * ray.m11 + form.y * ray.m21,
                form.x * ray.m12 + form.y * ray.m22,
            ),
        }
    }
}

/// Coverage of four pixels by the positive side of a line.
#[inline(always)]
fn line_coverage((value, gx, gy): (f64, f64, f64), profile: &EdgeProfile) -> [f32; LANES] {
    let (value, gx, gy) = (value as f32, gx as f32, gy as f32);
    let inverse = 1.0 / ((gx * gx + gy * gy).sqrt() + 1e-30);
    let (value, nx, ny) = (value * inverse, gx * inverse, gy * inverse);
    profile.coverage(FROM_CENTRE.map(|d| value + nx * d), [EdgeProfile::row(nx, ny); LANES])
}

/// Coverage of four pixels by a dot.
#[inline(always)]
fn dot_coverage(place: &Place, [f1, f2, f3]: &[Form; 3], profile: &EdgeProfile) -> [f32; LANES] {
    let ((l1, x1, y1), (l2, x2, y2), (l3, x3, y3)) = (place.apply(f1), place.apply(f2), place.apply(f3));
    // In units of the radius' form at the middle: then single precision is enough, 1e-6 of a radius.
    let unit = 1.0 / (l3.abs() + 1e-300);
    let scale = |v: f64| (v * unit) as f32;
    let (x1, x2, x3, y1, y2, y3) = (scale(x1), scale(x2), scale(x3), scale(y1), scale(y2), scale(y3));
    let (l1, l2, l3) = (scale(l1), scale(l2), scale(l3));
    // all halved: q / 2, its gradient and second derivatives
    let (hxx, hxy, hyy) =
        (x1 * x1 + x2 * x2 - x3 * x3, x1 * y1 + x2 * y2 - x3 * y3, y1 * y1 + y2 * y2 - y3 * y3);
    let spread = profile.spread_px2();
    let (mut distance, mut rows) = ([0.0f32; LANES], [0i32; LANES]);
    for ((d, row), at) in distance.iter_mut().zip(&mut rows).zip(FROM_CENTRE) {
        let (l1, l2, l3) = (l1 + x1 * at, l2 + x2 * at, l3 + x3 * at);
        let q = 0.5 * (l1 * l1 + l2 * l2 - l3 * l3);
        let gx = l1 * x1 + l2 * x2 - l3 * x3;
        let gy = l1 * y1 + l2 * y2 - l3 * y3;
        let g = (gx * gx + gy * gy).sqrt();
        let inverse = 1.0 / (g + 1e-30);
        let (nx, ny) = (gx * inverse, gy * inverse);
        *row = EdgeProfile::row(nx, ny);
        let mixed = 2.0 * nx * ny * hxy;
        let along = nx * nx * hxx + mixed + ny * ny * hyy;
        let across = ny * ny * hxx - mixed + nx * nx * hyy;
        // q + g t + along t^2 / 2 = 0 along the outward normal: t is the distance to the edge, positive inside
        let square = g * g - 2.0 * q * along;
        let root = if square > 0.0 { square } else { 0.0 }.sqrt();
        // the edge curves away from its tangent within the pixel
        let curvature = (across * inverse).clamp(-0.5, 0.5);
        *d = -2.0 * q / (g + root + 1e-30) - 0.5 * curvature * spread;
    }
    profile.coverage(distance, rows)
}

/// Draws the outlines of the scene into bands: polylines that follow the true curves within 0.2 px.
struct Outline<'a> {
    X_CO: &'a Pose,
    camera: &'a CameraModel,
    margin_px: f64,
    /// Normalized radius of the image's farthest corner, with a little more: nothing beyond is drawn.
    reach: f64,
    focal_px: f64,
    ideal: bool,
}

impl<'a> Outline<'a> {
    fn new(X_CO: &'a Pose, camera: &'a CameraModel, margin_px: f64) -> Self {
        let i = camera.intrinsics();
        let (w, h) = (f64::from(i.width_px) - 0.5, f64::from(i.height_px) - 0.5);
        let mut reach = 0.0f64;
        for (u, v) in [(-0.5, -0.5), (w, -0.5), (-0.5, h), (w, h)] {
            reach = reach.max(camera.normalized_of(&Vector2::new(u, v)).norm());
        }
        let ideal = camera.distortion().is_none();
        let reach = reach + (margin_px + 4.0) / i.fx_px.min(i.fy_px);
        Self { X_CO, camera, margin_px, reach, focal_px: i.fx_px.max(i.fy_px), ideal }
    }

    /// Pieces of at most 24 px that a straight edge is cut into: a lens bends that by less than 0.3 px.
    fn pieces(&self, length: f64) -> u32 {
        ((length * self.focal_px / 24.0) as u32 + 1).min(512)
    }

    /// Clips a segment to what lies in front of the camera.
    fn in_front(&self, from: &Point3<f64>, to: &Point3<f64>) -> Option<[Vector2<f64>; 2]> {
        const NEAR: f64 = 1e-6;
        let (mut a, mut b) = (self.X_CO * from, self.X_CO * to);
        if (a.z + b.z).is_nan() || a.z.max(b.z) <= NEAR {
            return None;
        }
        if a.z < NEAR {
            a += (b - a) * ((NEAR - a.z) / (b.z - a.z));
        } else if b.z < NEAR {
            b += (a - b) * ((NEAR - b.z) / (a.z - b.z));
        }
        Some([Vector2::new(a.x / a.z, a.y / a.z), Vector2::new(b.x / b.z, b.y / b.z)])
    }

    /// A straight edge between two points of the object frame.
    fn line(&self, from: &Point3<f64>, to: &Point3<f64>, mask: u8, bands: &mut Bands) {
        let Some([a, b]) = self.in_front(from, to) else { return };
        // the part within the circle of radius `reach`: |a + t d|^2 = reach^2
        let d = b - a;
        let (A, B, C) = (d.norm_squared(), a.dot(&d), a.norm_squared() - self.reach * self.reach);
        let root = B * B - A * C;
        let (start, end) = if A < 1e-24 {
            if C > 0.0 {
                return;
            }
            (0.0, 0.0)
        } else {
            if root.is_nan() || root <= 0.0 {
                return;
            }
            let root = root.sqrt();
            (((-B - root) / A).max(0.0), ((-B + root) / A).min(1.0))
        };
        if start > end {
            return;
        }
        let pieces = if self.ideal { 1 } else { self.pieces((b - a).norm() * (end - start)) };
        let point = |i: u32| {
            let t = start + (end - start) * f64::from(i) / f64::from(pieces);
            let px = self.camera.pixel_of(&(a + d * t));
            [px.x, px.y]
        };
        let mut last = point(0);
        for i in 1..=pieces {
            let next = point(i);
            bands.add_segment(last, next, self.margin_px, mask);
            last = next;
        }
    }

    /// The rim of a dot: 8 arcs, each halved until its middle lies within half a px of its chord; the two chords to
    /// the middle are then four times as close.
    fn circle(&self, centre: &Point3<f64>, radius: f64, mask: u8, bands: &mut Bands) {
        const ARCS: u32 = 8;
        let at = |i: u32| 2.0 * std::f64::consts::PI * f64::from(i) / f64::from(ARCS);
        let rim = |angle: f64| centre + nalgebra::Vector3::new(angle.cos(), angle.sin(), 0.0) * radius;
        let mut from = (0.0, rim(0.0));
        for i in 1..=ARCS {
            let to = (at(i), rim(at(i)));
            self.arc(&rim, from, to, 6, mask, bands);
            from = to;
        }
    }

    fn arc(
        &self,
        rim: &impl Fn(f64) -> Point3<f64>,
        from: (f64, Point3<f64>),
        to: (f64, Point3<f64>),
        depth: u32,
        mask: u8,
        bands: &mut Bands,
    ) {
        let angle = 0.5 * (from.0 + to.0);
        let middle = (angle, rim(angle));
        let place = |p: &Point3<f64>| {
            let c = self.X_CO * p;
            (c.z > 1e-6).then(|| Vector2::new(c.x / c.z, c.y / c.z))
        };
        match (place(&from.1), place(&middle.1), place(&to.1)) {
            (None, None, None) => return,
            (Some(a), Some(m), Some(b)) => {
                let far = |s: &Vector2<f64>| s.norm() > 1.5 * self.reach;
                let apart = (a - b).norm();
                // all three outside, and too close together to reach the image between them
                if far(&a) && far(&m) && far(&b) && apart < 0.2 * self.reach {
                    return;
                }
                let sag = ((a + b) * 0.5 - m).norm() * self.focal_px;
                if !far(&a) && !far(&b) && sag < 0.5 || depth == 0 {
                    self.line(&from.1, &middle.1, mask, bands);
                    self.line(&middle.1, &to.1, mask, bands);
                    return;
                }
            }
            _ if depth == 0 => {
                self.line(&from.1, &middle.1, mask, bands);
                self.line(&middle.1, &to.1, mask, bands);
                return;
            }
            _ => {}
        }
        self.arc(rim, from, middle, depth - 1, mask, bands);
        self.arc(rim, middle, to, depth - 1, mask, bands);
    }
}
