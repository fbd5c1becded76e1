//! Intrinsic parameters and the map between directions and pixels.

use super::error::{LONGEST_FOCAL_PX, MAX_NUMBER};
use super::{CameraModelError, Lens, Region};
use nalgebra::{Matrix2, Point3, Vector2};

/// Nearest depth that is projected, m: no lens has a point a micrometre before its centre in focus, and at depth zero there is no projection
/// at all, so that closer points count as behind the camera.
const NEAREST_M: f64 = 1e-6;

/// Omega of (5.45) and the image's size. `fx_px = f alpha_x`, `cx_px = X_0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Focal length in columns, px.
    pub fx_px: f64,
    /// Focal length in rows, px.
    pub fy_px: f64,
    /// Column of the principal point, px.
    pub cx_px: f64,
    /// Row of the principal point, px.
    pub cy_px: f64,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
}

/// A camera whose every pixel belongs to exactly one direction; checked at construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    intrinsics: Intrinsics,
    /// What part of the whole image, of this size, is the image.
    region: Region,
    full_size_px: (u32, u32),
    lens: Lens,
    /// Normalized radius beyond which the lens turns back: such points are not in the image.
    fold_radius: f64,
    ideal: bool,
}

impl CameraModel {
    /// Checks the parameters. The principal point may lie outside the image (a cropped sensor).
    ///
    /// # Errors
    /// [`CameraModelError`] names the parameter, or the pixel at which the distortion has no inverse.
    pub fn new(intrinsics: Intrinsics, lens: impl Into<Lens>) -> Result<Self, CameraModelError> {
        let lens = lens.into();
        let Intrinsics { fx_px, fy_px, cx_px, cy_px, width_px, height_px } = intrinsics;
        let numbers = [("fx_px", fx_px), ("fy_px", fy_px), ("cx_px", cx_px), ("cy_px", cy_px)];
        for (name, value) in numbers.into_iter().chain(lens.coefficients()) {
            let is_focal_length = name == "fx_px" || name == "fy_px";
            if !value.is_finite() || (value.abs() > MAX_NUMBER && !is_focal_length) {
                return Err(CameraModelError::NotFinite { name, value });
            }
        }
        for (name, value_px) in [("fx_px", fx_px), ("fy_px", fy_px)] {
            if value_px <= 0.0 || value_px > LONGEST_FOCAL_PX {
                return Err(CameraModelError::FocalLength { name, value_px });
            }
        }
        if !(1..=65536).contains(&width_px) || !(1..=65536).contains(&height_px) {
            return Err(CameraModelError::ImageSize { width_px, height_px });
        }
        let region = Region::whole(width_px, height_px);
        let model = Self {
            intrinsics,
            region,
            full_size_px: (width_px, height_px),
            lens,
            fold_radius: lens.fold_radius(),
            ideal: lens.is_ideal(),
        };
        model.check_inverse()?;
        Ok(model)
    }

    /// Focal lengths, principal point and size.
    #[must_use]
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// The lens.
    #[must_use]
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The part of the whole image that is this camera's image, in pixels of the whole.
    #[must_use]
    pub fn region(&self) -> &Region {
        &self.region
    }

    /// Columns and rows of the whole image.
    #[must_use]
    pub fn full_size_px(&self) -> (u32, u32) {
        self.full_size_px
    }

    /// Focal lengths, principal point and size of the whole image.
    #[must_use]
    pub fn full_intrinsics(&self) -> Intrinsics {
        Intrinsics {
            cx_px: self.intrinsics.cx_px + f64::from(self.region.x_px),
            cy_px: self.intrinsics.cy_px + f64::from(self.region.y_px),
            width_px: self.full_size_px.0,
            height_px: self.full_size_px.1,
            ..self.intrinsics
        }
    }

    /// The camera that reads a part of the whole image: the same lens, about the same axis, hence with the same coefficients;
    /// the principal point is counted from the part's corner.
    ///
    /// # Errors
    /// [`CameraModelError::Region`] when the region is empty, or not inside the whole image.
    pub fn cropped(&self, region: &Region) -> Result<Self, CameraModelError> {
        let full = self.full_intrinsics();
        if !region.lies_in(full.width_px, full.height_px) {
            let (width_px, height_px) = self.full_size_px;
            return Err(CameraModelError::Region { region: *region, width_px, height_px });
        }
        let intrinsics = Intrinsics {
            cx_px: full.cx_px - f64::from(region.x_px),
            cy_px: full.cy_px - f64::from(region.y_px),
            width_px: region.width_px,
            height_px: region.height_px,
            ..full
        };
        // every pixel of the whole has its direction, hence every one of the part
        Ok(Self { intrinsics, region: *region, ..*self })
    }

    /// Pixel of a point in camera coordinates (m). `None` for points behind the camera, in its focal
    /// plane, or so far aside that the lens folds them back.
    #[must_use]
    pub fn project(&self, p_C: &Point3<f64>) -> Option<Vector2<f64>> {
        if p_C.z.is_nan() || p_C.z <= NEAREST_M {
            return None;
        }
        let s = Vector2::new(p_C.x / p_C.z, p_C.y / p_C.z);
        (s.norm() < self.fold_radius).then(|| self.pixel_of(&s))
    }

    /// Pixel of the normalized coordinates `s` (5.45), through the lens.
    #[must_use]
    #[inline]
    pub fn pixel_of(&self, s: &Vector2<f64>) -> Vector2<f64> {
        let i = &self.intrinsics;
        let d = if self.ideal { *s } else { self.lens.apply(s) };
        Vector2::new(i.fx_px * d.x + i.cx_px, i.fy_px * d.y + i.cy_px)
    }

    /// Normalized, undistorted coordinates of a pixel: the inverse of [`Self::pixel_of`] to 1e-12 anywhere in
    /// the image. Far outside of it there may be no inverse; the last approximation is returned.
    #[must_use]
    pub fn normalized_of(&self, px: &Vector2<f64>) -> Vector2<f64> {
        let d = self.plane_of(px);
        if self.ideal { d } else { self.lens.undistort(&d, self.fold_radius).0 }
    }

    /// Derivative of [`Self::pixel_of`], px.
    #[must_use]
    pub fn pixel_jacobian(&self, s: &Vector2<f64>) -> Matrix2<f64> {
        let i = &self.intrinsics;
        let d = if self.ideal { Matrix2::identity() } else { self.lens.jacobian(s) };
        Matrix2::new(i.fx_px * d.m11, i.fx_px * d.m12, i.fy_px * d.m21, i.fy_px * d.m22)
    }

    /// Whether `px` lies in the image, at least `margin_px` from its border; NaN does not.
    #[must_use]
    pub fn contains(&self, px: &Vector2<f64>, margin_px: f64) -> bool {
        let (w, h) = (f64::from(self.intrinsics.width_px), f64::from(self.intrinsics.height_px));
        let low = margin_px - 0.5;
        px.x >= low && px.y >= low && px.x <= w - 1.0 - low && px.y <= h - 1.0 - low
    }

    /// Distorted normalized coordinates of a pixel.
    fn plane_of(&self, px: &Vector2<f64>) -> Vector2<f64> {
        let i = &self.intrinsics;
        Vector2::new((px.x - i.cx_px) / i.fx_px, (px.y - i.cy_px) / i.fy_px)
    }

    /// The inverse must exist, on the right side of the fold, along the border and over a grid inside.
    fn check_inverse(&self) -> Result<(), CameraModelError> {
        if self.ideal {
            return Ok(());
        }
        // A fold is a circle, or as the tangential part bends it: a grid of a thirty-second of the image finds it at the border or not at
        // all. Chosen.
        const STEPS: u32 = 32;
        let (w, h) = (f64::from(self.intrinsics.width_px), f64::from(self.intrinsics.height_px));
        for j in 0..=STEPS {
            for i in 0..=STEPS {
                let (a, b) = (f64::from(i) / f64::from(STEPS), f64::from(j) / f64::from(STEPS));
                let px = Vector2::new(w * a - 0.5, h * b - 0.5);
                let d = self.plane_of(&px);
                let (s, rest) = self.lens.undistort(&d, self.fold_radius);
                // 1e-11 of a focal length is 1e-8 px, far above rounding: with a larger residual the iteration has not converged.
                if !(rest <= 1e-11) || s.norm() >= self.fold_radius || !self.lens.tells_apart(&s) {
                    let finite = self.fold_radius.is_finite();
                    let fold_radius = if finite { self.lens.radius(self.fold_radius) } else { f64::INFINITY };
                    return Err(CameraModelError::Folded {
                        u_px: px.x,
                        v_px: px.y,
                        radius: d.norm(),
                        fold_radius,
                    });
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
