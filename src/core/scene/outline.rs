//! The rims of what lies in the image, as bands of pixels: straight edges and circles through perspective and lens.

use super::bands::Bands;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use nalgebra::{Point3, Vector2, Vector3};

/// Draws the outlines of the scene into bands: polylines that follow the true curves within 0.2 px.
pub(super) struct OutlinePainter<'a> {
    X_CO: &'a Pose,
    camera: &'a CameraModel,
    margin_px: f64,
    /// Normalized radius of the image's farthest corner, with a little more: nothing beyond is drawn.
    reach: f64,
    focal_px: f64,
    ideal: bool,
}

impl<'a> OutlinePainter<'a> {
    pub(super) fn new(X_CO: &'a Pose, camera: &'a CameraModel, margin_px: f64) -> Self {
        let i = camera.intrinsics();
        let (w, h) = (f64::from(i.width_px) - 0.5, f64::from(i.height_px) - 0.5);
        let mut reach = 0.0f64;
        for (u, v) in [(-0.5, -0.5), (w, -0.5), (-0.5, h), (w, h)] {
            reach = reach.max(camera.normalized_of(&Vector2::new(u, v)).norm());
        }
        let ideal = camera.lens().is_ideal();
        let reach = reach + (margin_px + 4.0) / i.fx_px.min(i.fy_px);
        Self { X_CO, camera, margin_px, reach, focal_px: i.fx_px.max(i.fy_px), ideal }
    }

    /// Pieces of at most 24 px that a straight edge is cut into: a lens bends that by less than 0.3 px.
    fn pieces(&self, length: f64) -> u32 {
        ((length * self.focal_px / 24.0) as u32 + 1).min(512)
    }

    /// Clips a segment to what lies in front of the camera.
    fn in_front(&self, from: &Point3<f64>, to: &Point3<f64>) -> Option<[Vector2<f64>; 2]> {
        // m, as in `layers`, because at depth zero there is no projection.
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
    fn line(&self, from: &Point3<f64>, to: &Point3<f64>, mask: u64, bands: &mut Bands) {
        let Some([a, b]) = self.in_front(from, to) else { return };
        // the part within the circle of radius `reach`: |a + t d|^2 = reach^2
        let d = b - a;
        let (A, B, C) = (d.norm_squared(), a.dot(&d), a.norm_squared() - self.reach * self.reach);
        let root = B * B - A * C;
        // A length of 1e-12 in normalized coordinates is a point: the roots would be rounding.
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

    /// The rim of a rectangle at `z_m` over the object's plane; bits of its sides at least and greatest x, at least and greatest y.
    pub(super) fn rectangle(
        &self,
        low: &Vector2<f64>,
        high: &Vector2<f64>,
        z_m: f64,
        bits: [u64; 4],
        bands: &mut Bands,
    ) {
        let corner = |x: f64, y: f64| Point3::new(x, y, z_m);
        let corners =
            [corner(low.x, low.y), corner(low.x, high.y), corner(high.x, low.y), corner(high.x, high.y)];
        for (bit, [i, j]) in bits.into_iter().zip([[0, 1], [2, 3], [0, 2], [1, 3]]) {
            if let (Some(from), Some(to)) = (corners.get(i), corners.get(j)) {
                self.line(from, to, bit, bands);
            }
        }
    }

    /// The rim of a dot: 8 arcs, each halved until its middle lies within half a px of its chord; the two chords to
    /// the middle are then four times as close.
    pub(super) fn circle(&self, centre: &Point3<f64>, radius: f64, mask: u64, bands: &mut Bands) {
        // Chosen by hand: arcs of 45 degrees, which are halved further where the projection needs it.
        const ARCS: u32 = 8;
        let at = |i: u32| 2.0 * std::f64::consts::PI * f64::from(i) / f64::from(ARCS);
        let rim = |angle: f64| centre + Vector3::new(angle.cos(), angle.sin(), 0.0) * radius;
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
        mask: u64,
        bands: &mut Bands,
    ) {
        let angle = 0.5 * (from.0 + to.0);
        let middle = (angle, rim(angle));
        let place = |p: &Point3<f64>| {
            let c = self.X_CO * p;
            // because at depth zero there is no projection; no lens has it in focus
            (c.z > 1e-6).then(|| Vector2::new(c.x / c.z, c.y / c.z))
        };
        match (place(&from.1), place(&middle.1), place(&to.1)) {
            (None, None, None) => return,
            (Some(a), Some(m), Some(b)) => {
                let far = |s: &Vector2<f64>| s.norm() > 1.5 * self.reach; // chosen by hand, with the bound below
                let apart = (a - b).norm();
                // all three outside, and too close together to reach the image between them: a rim would have to bend by 0.5 between
                // places 0.2 apart
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
