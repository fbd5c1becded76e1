//! The scene of one instant as the camera sees it: implicit curves for exact coverage, and the bands around them.
//!
//! With `H = [r1 r2 p]` of `X_CO`, `(a, b, w) = H^-1 s~` are the plane coordinates of a direction times `w`, the
//! inverse depth. A plate edge is linear in them, `a - x_min w >= 0`, and stays exact where the plate passes
//! behind the camera; a dot is `L1^2 + L2^2 - L3^2 <= 0` with `L1 = a - cx w`, `L2 = b - cy w`, `L3 = R w`.
//! Along any straight line a conic is a quadratic, so the distance of a pixel from an edge, along the normal, has
//! a closed form; the distortion is taken as affine within one pixel.

use super::bands::Bands;
use super::look::Paint;
use super::occluder::Occluder;
use super::outline::OutlinePainter;
use super::profile::{EdgeProfile, LANES, cast};
use super::rays::{Ray, RowOfRays};
use super::sensor::LEVEL_BITS;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::target::Target;
use nalgebra::{Matrix3, Point3, Vector2, Vector3};

/// Bits of the four plate edges in a band's mask; the dots follow, of many several to a bit; the last bit is the occluder's: what a word of 64
/// bits has to hold follows from that.
const EDGES: u64 = 0x0f;
const DOT_SHIFT: u32 = 4;
const DOT_BITS: usize = 59;
const OCCLUDER: u64 = 1 << 63;
const ALL: u64 = u64::MAX;

/// Pixels evaluated together, and their columns from the middle one, as follows from four lanes.
const CENTRE_LANE: f64 = 1.5;
const FROM_CENTRE: [f32; LANES] = [-1.5, -0.5, 0.5, 1.5];
/// No level is larger, since levels with their fraction bits are words of 16 bits.
const MAX_LEVEL: f32 = 65535.0;

/// A linear form of the pixel (ideal camera) or of the normalized direction: `x a + y b + c`.
type Form = Vector3<f64>;

/// One instant of the scene.
#[derive(Debug, Clone)]
pub(super) struct SceneView {
    visible: bool,
    /// Whether the camera sees the side with the dots.
    front: bool,
    depth: Form,
    edges: [Form; 4],
    dots: Vec<[Form; 3]>,
    /// Edges of the occluder, and its level.
    cover: Option<([Form; 4], f64)>,
    bands: Bands,
}

impl SceneView {
    /// A view for images of this size and `dots` dots.
    pub(super) fn new(width: usize, height: usize, dots: usize) -> Self {
        Self {
            visible: false,
            front: false,
            depth: Form::zeros(),
            edges: [Form::zeros(); 4],
            dots: Vec::with_capacity(dots),
            cover: None,
            bands: Bands::new(width, height),
        }
    }

    /// The bands of pixels near an edge.
    pub(super) fn bands(&self) -> &Bands {
        &self.bands
    }

    /// Sets the view up for the pose `X_CO`. `half_px`: reach of an edge.
    pub(super) fn set(
        &mut self,
        X_CO: &Pose,
        camera: &CameraModel,
        target: &Target,
        occluder: Option<&Occluder>,
        half_px: f64,
    ) {
        self.bands.clear();
        self.dots.clear();
        self.visible = false;
        self.cover = None;
        let R = X_CO.rotation.to_rotation_matrix();
        let p = X_CO.translation.vector;
        let facing = R.matrix().column(2).dot(&p);
        // a plate that is seen edge-on is a line without width, and rounding would determine its normal
        if !facing.is_finite() || facing.abs() < 1e-9 {
            return;
        }
        let Some([a, b, w]) = forms(X_CO, 0.0, camera) else { return };
        self.visible = true;
        self.front = facing > 0.0;
        let plate = target.plate();
        self.depth = w;
        self.edges = rectangle(&[a, b, w], &plate.low_m, &plate.high_m);
        self.dots.extend(
            target
                .discs()
                .iter()
                .map(|mark| [a - w * mark.centre_m.x, b - w * mark.centre_m.y, w * mark.radius_m]),
        );
        let outline = OutlinePainter::new(X_CO, camera, half_px + 0.5);
        outline.rectangle(&plate.low_m, &plate.high_m, 0.0, [1, 2, 4, 8], &mut self.bands);
        if self.front {
            for (i, mark) in target.discs().iter().enumerate() {
                let centre = Point3::new(mark.centre_m.x, mark.centre_m.y, 0.0);
                outline.circle(&centre, mark.radius_m, dot_bit(i), &mut self.bands);
            }
        }
        if let Some(occluder) = occluder
            && let Some(forms) = forms(X_CO, occluder.height_m, camera)
        {
            let (low, high) = occluder.corners_m();
            self.cover = Some((rectangle(&forms, &low, &high), occluder.level));
            outline.rectangle(&low, &high, -occluder.height_m, [OCCLUDER; 4], &mut self.bands);
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
        if let Some((edges, level)) = &self.cover
            && edges.iter().all(|edge| value(edge) >= 0.0)
        {
            return *level;
        }
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
        mask: u64,
        paint: &Paint<'_>,
        directions: &mut impl Iterator<Item = Ray>,
        levels: &mut [u16],
    ) {
        let Paint { rays, profile, look } = paint;
        let (background, plate, dots) = (look.background as f32, look.plate as f32, look.dots as f32);
        let scale = f32::from(1u16 << LEVEL_BITS);
        // behind the edge of the occluder there may be any surface, so that all edges are evaluated
        let mask = if mask & OCCLUDER == 0 { mask } else { ALL };
        for (chunk, levels) in levels.chunks_mut(LANES).enumerate() {
            let u = middle(u0, chunk);
            let place = if rays.ideal() {
                FormPlace::Ideal(u, v)
            } else {
                FormPlace::Ray(directions.next().unwrap_or_else(|| rays.at(u, v)))
            };
            let mut cover = [1.0f32; LANES];
            for edge in chosen(&self.edges, mask & EDGES) {
                let part = line_coverage(place.apply(edge), profile);
                cover.iter_mut().zip(part).for_each(|(c, p)| *c *= p);
            }
            let mut sum = cover.map(|c| background + (plate - background) * c);
            if self.front {
                for dot in sharing(&self.dots, (mask & !OCCLUDER) >> DOT_SHIFT) {
                    let part = dot_coverage(&place, dot, profile);
                    sum.iter_mut().zip(part).for_each(|(s, p)| *s += (dots - plate) * p);
                }
            }
            if let Some((edges, level)) = &self.cover {
                let mut cover = [1.0f32; LANES];
                for edge in edges {
                    let part = line_coverage(place.apply(edge), profile);
                    cover.iter_mut().zip(part).for_each(|(c, p)| *c *= p);
                }
                sum.iter_mut().zip(cover).for_each(|(s, c)| *s += (*level as f32 - *s) * c);
            }
            let exact = sum.map(|s| cast(s * scale + 0.5, MAX_LEVEL) as u16);
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
fn chosen<T>(all: &[T; 4], mut mask: u64) -> impl Iterator<Item = &T> {
    std::iter::from_fn(move || {
        let next = all.get(mask.trailing_zeros() as usize)?;
        mask &= mask.wrapping_sub(1);
        Some(next)
    })
}

/// The dots whose bits are set: bit `i` stands for dot `i` and for each [`DOT_BITS`] later.
#[inline(always)]
fn sharing<T>(all: &[T], mut mask: u64) -> impl Iterator<Item = &T> {
    let mut next = usize::MAX;
    std::iter::from_fn(move || {
        loop {
            if let Some(dot) = all.get(next) {
                next += DOT_BITS;
                return Some(dot);
            }
            if mask == 0 {
                return None;
            }
            next = mask.trailing_zeros() as usize;
            mask &= mask - 1;
        }
    })
}

/// The bit of a dot.
fn dot_bit(i: usize) -> u64 {
    1 << ((i % DOT_BITS) as u32 + DOT_SHIFT)
}

/// The rows of `H^-1` as forms of the pixel, or of the direction when the lens distorts; `H = [r1 r2 p]` of the plane
/// `height_m` above the object's, towards the side that shows the dots. `None` where the camera lies in that plane.
fn forms(X_CO: &Pose, height_m: f64, camera: &CameraModel) -> Option<[Form; 3]> {
    let R = X_CO.rotation.to_rotation_matrix();
    let (m, p) = (R.matrix(), X_CO.translation.vector);
    let p = if height_m == 0.0 { p } else { p - m.column(2) * height_m };
    let inverse = Matrix3::from_columns(&[m.column(0).into(), m.column(1).into(), p]).try_inverse()?;
    Some([0, 1, 2].map(|row| {
        let f = Vector3::new(inverse[(row, 0)], inverse[(row, 1)], inverse[(row, 2)]);
        if !camera.lens().is_ideal() {
            return f;
        }
        let i = camera.intrinsics();
        let (x, y) = (f.x / i.fx_px, f.y / i.fy_px);
        Vector3::new(x, y, f.z - x * i.cx_px - y * i.cy_px)
    }))
}

/// Forms that are positive inside of a rectangle along the plane's axes; nowhere behind the camera.
fn rectangle([a, b, w]: &[Form; 3], low: &Vector2<f64>, high: &Vector2<f64>) -> [Form; 4] {
    [a - w * low.x, w * high.x - a, b - w * low.y, w * high.y - b]
}

/// Where forms are evaluated.
enum FormPlace {
    /// Forms of the pixel itself.
    Ideal(f64, f64),
    /// Forms of the direction.
    Ray(Ray),
}

impl FormPlace {
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
fn dot_coverage(place: &FormPlace, [f1, f2, f3]: &[Form; 3], profile: &EdgeProfile) -> [f32; LANES] {
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
