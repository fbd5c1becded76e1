//! Two images side by side, with what was found in them.
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

use crate::cli::detect::overlay::line;
use crate::source::encode_png;
use image::{ExtendedColorType, GrayImage, Rgb, RgbImage};
use nalgebra::{Vector2, Vector3};

/// Half the length of a cross, px.
const CROSS_PX: f64 = 5.0;

pub(super) struct SideBySide {
    out: RgbImage,
    left_width: f64,
    right: (f64, f64),
}

impl SideBySide {
    pub(super) fn new(left: &GrayImage, right: &GrayImage) -> Self {
        let (w, h) = left.dimensions();
        let (w2, h2) = right.dimensions();
        let out = RgbImage::from_fn(w + w2, h.max(h2), |x, y| {
            let pixel = if x < w { left.get_pixel_checked(x, y) } else { right.get_pixel_checked(x - w, y) };
            Rgb([pixel.map_or(0, |p| p.0[0]); 3])
        });
        Self { out, left_width: w.into(), right: (w2.into(), h2.into()) }
    }

    /// A cross in the left (0) or right (1) image.
    pub(super) fn cross(&mut self, side: usize, px: &Vector2<f64>, colour: [u8; 3]) {
        let at = px + Vector2::new(if side == 0 { 0.0 } else { self.left_width }, 0.0);
        for arm in [Vector2::x(), Vector2::y()] {
            line(&mut self.out, at - arm * CROSS_PX, at + arm * CROSS_PX, Rgb(colour));
        }
    }

    /// The part of a line `l . (u, v, 1) = 0` within the right image.
    pub(super) fn right_line(&mut self, l: &Vector3<f64>, colour: [u8; 3]) {
        let (w, h) = self.right;
        // walked along the axis that the line follows more
        let place = |t: f64| {
            if l.y.abs() > l.x.abs() {
                Vector2::new(t * (w - 1.0), -(l.x * t * (w - 1.0) + l.z) / l.y)
            } else {
                Vector2::new(-(l.y * t * (h - 1.0) + l.z) / l.x, t * (h - 1.0))
            }
        };
        let inside = |p: &Vector2<f64>| p.x >= 0.0 && p.y >= 0.0 && p.x < w && p.y < h;
        const STEPS: u32 = 400;
        let places: Vec<_> = (0..=STEPS).map(|i| place(f64::from(i) / f64::from(STEPS))).collect();
        let offset = Vector2::new(self.left_width, 0.0);
        for (a, b) in places.iter().zip(places.iter().skip(1)) {
            if inside(a) && inside(b) {
                line(&mut self.out, a + offset, b + offset, Rgb(colour));
            }
        }
    }

    /// A row through both images.
    pub(super) fn row(&mut self, y: f64, colour: [u8; 3]) {
        let end = f64::from(self.out.width()) - 1.0;
        line(&mut self.out, Vector2::new(0.0, y), Vector2::new(end, y), Rgb(colour));
    }

    pub(super) fn png(&self) -> Option<Vec<u8>> {
        encode_png(self.out.as_raw(), self.out.width(), self.out.height(), ExtendedColorType::Rgb8).ok()
    }
}
