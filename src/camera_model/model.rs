//! Intrinsic parameters and the map between directions and pixels.

use super::{CameraModelError, Distortion};
use nalgebra::{Matrix2, Point3, Vector2};

/// Nearest depth that is projected, m: closer points are as good as in the image plane's pole.
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
    distortion: Distortion,
    /// Normalized radius beyond which the polynomial turns back: such points are not in the image.
    fold_radius: f64,
    ideal: bool,
}

impl CameraModel {
    /// Checks the parameters. The principal point may lie outside the image (a cropped sensor).
    ///
    /// # Errors
    /// [`CameraModelError`] names the parameter, or the pixel at which the distortion has no inverse.
    pub fn new(intrinsics: Intrinsics, distortion: Distortion) -> Result<Self, CameraModelError> {
        let Intrinsics { fx_px, fy_px, cx_px, cy_px, width_px, height_px } = intrinsics;
        let Distortion { k1, k2, p1, p2, k3 } = distortion;
        for (name, value) in [
            ("fx_px", fx_px),
            ("fy_px", fy_px),
            ("cx_px", cx_px),
            ("cy_px", cy_px),
            ("k1", k1),
            ("k2", k2),
            ("p1", p1),
            ("p2", p2),
            ("k3", k3),
        ] {
            if !value.is_finite() {
                return Err(CameraModelError::NotFinite { name, value });
            }
        }
        for (name, value_px) in [("fx_px", fx_px), ("fy_px", fy_px)] {
            if value_px <= 0.0 {
                return Err(CameraModelError::FocalLength { name, value_px });
            }
        }
        if !(1..=65536).contains(&width_px) || !(1..=65536).contains(&height_px) {
            return Err(CameraModelError::ImageSize { width_px, height_px });
        }
        let fold_radius = distortion.fold_radius();
        let model = Self { intrinsics, distortion, fold_radius, ideal: distortion.is_none() };
        model.check_inverse()?;
        Ok(model)
    }

    /// Focal lengths, principal point and size.
    #[must_use]
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Lens distortion.
    #[must_use]
    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// Pixel of a point in camera coordinates (m). `None` for points behind the camera, in its focal
    /// plane, or so far aside that the distortion polynomial folds them back.
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
        let d = if self.ideal { *s } else { self.distortion.apply(s) };
        Vector2::new(i.fx_px * d.x + i.cx_px, i.fy_px * d.y + i.cy_px)
    }

    /// Normalized, undistorted coordinates of a pixel: the inverse of [`Self::pixel_of`] to 1e-12 anywhere in
    /// the image. Far outside of it there may be no inverse; the last approximation is returned.
    #[must_use]
    pub fn normalized_of(&self, px: &Vector2<f64>) -> Vector2<f64> {
        let d = self.plane_of(px);
        if self.ideal { d } else { self.undistort(&d).0 }
    }

    /// Derivative of [`Self::pixel_of`], px.
    #[must_use]
    pub fn pixel_jacobian(&self, s: &Vector2<f64>) -> Matrix2<f64> {
        let i = &self.intrinsics;
        let d = if self.ideal { Matrix2::identity() } else { self.distortion.jacobian(s) };
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

    /// Newton with step halving on `apply(s) = d`; the second value is the residual that is left.
    /// It starts at `d`: for a barrel (concave) or pincushion (convex) polynomial the steps then approach from
    /// one side and never pass the fold.
    fn undistort(&self, d: &Vector2<f64>) -> (Vector2<f64>, f64) {
        let mut s = *d;
        let mut rest = self.distortion.apply(&s) - d;
        let mut size = rest.norm_squared();
        for _ in 0..50 {
            if size < 1e-31 {
                break;
            }
            let J = self.distortion.jacobian(&s);
            let det = J.m11 * J.m22 - J.m12 * J.m21;
            let inverse = if det.abs() > 1e-12 { 1.0 / det } else { 1.0 };
            let step = Vector2::new(
                inverse * (J.m22 * rest.x - J.m12 * rest.y),
                inverse * (J.m11 * rest.y - J.m21 * rest.x),
            );
            let mut factor = 1.0;
            let mut better = false;
            for _ in 0..12 {
                let next = s - step * factor;
                let next_rest = self.distortion.apply(&next) - d;
                let next_size = next_rest.norm_squared();
                if next_size < size && next.norm() < self.fold_radius {
                    (s, rest, size, better) = (next, next_rest, next_size, true);
                    break;
                }
                factor *= 0.5;
            }
            if !better {
                break;
            }
        }
        (s, size.sqrt())
    }

    /// The inverse must exist, on the right side of the fold, along the border and over a grid inside.
    fn check_inverse(&self) -> Result<(), CameraModelError> {
        if self.ideal {
            return Ok(());
        }
        const STEPS: u32 = 32;
        let (w, h) = (f64::from(self.intrinsics.width_px), f64::from(self.intrinsics.height_px));
        let fold_radius = self.distortion.radius(self.fold_radius.min(1e6));
        for j in 0..=STEPS {
            for i in 0..=STEPS {
                let (a, b) = (f64::from(i) / f64::from(STEPS), f64::from(j) / f64::from(STEPS));
                let px = Vector2::new(w * a - 0.5, h * b - 0.5);
                let d = self.plane_of(&px);
                let (s, rest) = self.undistort(&d);
                let J = self.distortion.jacobian(&s);
                // a slope of a hundredth: beyond that one pixel is spread over a hundred
                if rest > 1e-11
                    || s.norm() >= self.fold_radius
                    || self.distortion.radius_slope(s.norm()) < 0.01
                    || J.determinant() < 1e-3
                {
                    let fold_radius = if self.fold_radius.is_finite() { fold_radius } else { f64::INFINITY };
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    const VGA: Intrinsics =
        Intrinsics { fx_px: 600.0, fy_px: 610.0, cx_px: 322.5, cy_px: 238.0, width_px: 640, height_px: 480 };

    fn ideal() -> CameraModel {
        CameraModel::new(VGA, Distortion::default()).unwrap()
    }

    #[test]
    fn ideal_camera_is_5_45() {
        let px = ideal().project(&Point3::new(0.1, -0.05, 0.5)).unwrap();
        assert!((px - Vector2::new(322.5 + 120.0, 238.0 - 61.0)).norm() < 1e-12);
        assert!(ideal().project(&Point3::new(0.1, 0.0, -0.5)).is_none());
        assert!(ideal().project(&Point3::new(0.1, 0.0, 0.0)).is_none());
        assert!(ideal().project(&Point3::new(0.1, 0.0, f64::NAN)).is_none());
    }

    /// Value computed by hand from the definition in OpenCV's documentation.
    #[test]
    fn distortion_follows_the_plumb_bob_definition() {
        let d = Distortion { k1: -0.2, k2: 0.05, p1: 0.001, p2: -0.002, k3: 0.01 };
        let s = d.apply(&Vector2::new(0.3, -0.4));
        let radial = 1.0 - 0.2 * 0.25 + 0.05 * 0.0625 + 0.01 * 0.015625;
        let x = 0.3 * radial + 2.0 * 0.001 * 0.3 * -0.4 - 0.002 * (0.25 + 2.0 * 0.09);
        let y = -0.4 * radial + 0.001 * (0.25 + 2.0 * 0.16) + 2.0 * -0.002 * 0.3 * -0.4;
        assert!((s - Vector2::new(x, y)).norm() < 1e-15);
    }

    #[test]
    fn folding_distortion_is_refused_with_the_pixel() {
        let d = Distortion { k1: -0.9, ..Distortion::default() };
        let error = CameraModel::new(Intrinsics { fx_px: 300.0, fy_px: 300.0, ..VGA }, d).unwrap_err();
        assert!(
            matches!(error, CameraModelError::Folded { fold_radius, .. } if (fold_radius - 0.4057).abs() < 1e-3),
            "{error}"
        );
        // the same lens is fine on a camera that sees only its middle
        assert!(CameraModel::new(Intrinsics { fx_px: 1500.0, fy_px: 1500.0, ..VGA }, d).is_ok());
        // strong tangential parts fold too
        let d = Distortion { p1: 0.9, ..Distortion::default() };
        assert!(CameraModel::new(VGA, d).is_err());
    }

    #[test]
    fn points_beyond_the_fold_are_not_in_the_image() {
        let d = Distortion { k1: -0.2, ..Distortion::default() };
        let model = CameraModel::new(VGA, d).unwrap();
        // r = 2.236 is a zero of 1 + k1 r^2: the polynomial alone would put it on the principal point
        assert!(model.project(&Point3::new(5f64.sqrt(), 0.0, 1.0)).is_none());
        assert!(model.project(&Point3::new(0.5, 0.0, 1.0)).is_some());
    }

    #[test]
    fn nonsense_is_refused() {
        for bad in [
            Intrinsics { fx_px: f64::NAN, ..VGA },
            Intrinsics { fy_px: 0.0, ..VGA },
            Intrinsics { fx_px: -600.0, ..VGA },
            Intrinsics { cx_px: f64::INFINITY, ..VGA },
            Intrinsics { width_px: 0, ..VGA },
            Intrinsics { height_px: 70_000, ..VGA },
        ] {
            assert!(CameraModel::new(bad, Distortion::default()).is_err(), "{bad:?}");
        }
        assert!(CameraModel::new(VGA, Distortion { k3: f64::NAN, ..Distortion::default() }).is_err());
    }

    #[test]
    fn contains_counts_from_the_outer_edges() {
        let m = ideal();
        assert!(m.contains(&Vector2::new(-0.5, -0.5), 0.0));
        assert!(!m.contains(&Vector2::new(-0.6, 0.0), 0.0));
        assert!(m.contains(&Vector2::new(639.5, 479.5), 0.0));
        assert!(!m.contains(&Vector2::new(639.5, 479.5), 1.0));
        assert!(!m.contains(&Vector2::new(f64::NAN, 3.0), 0.0));
    }

    proptest! {
        #[test]
        fn normalized_of_inverts_pixel_of(
            u in -0.5..639.5f64, v in -0.5..479.5f64,
            k1 in -0.3..0.3f64, k2 in -0.1..0.1f64, p1 in -0.005..0.005f64, p2 in -0.005..0.005f64, k3 in -0.05..0.05f64,
        ) {
            let model = CameraModel::new(VGA, Distortion { k1, k2, p1, p2, k3 });
            prop_assume!(model.is_ok());
            let model = model.unwrap();
            let px = Vector2::new(u, v);
            let s = model.normalized_of(&px);
            prop_assert!((model.pixel_of(&s) - px).norm() < 1e-9);
            // the other way round, in normalized units
            prop_assert!((model.normalized_of(&model.pixel_of(&s)) - s).norm() < 1e-12);
        }

        #[test]
        fn jacobian_agrees_with_finite_differences(
            x in -0.6..0.6f64, y in -0.5..0.5f64,
            k1 in -0.3..0.3f64, k2 in -0.1..0.1f64, p1 in -0.01..0.01f64, p2 in -0.01..0.01f64, k3 in -0.05..0.05f64,
        ) {
            let model = CameraModel { distortion: Distortion { k1, k2, p1, p2, k3 }, ideal: false, ..ideal() };
            let s = Vector2::new(x, y);
            let J = model.pixel_jacobian(&s);
            let h = 1e-6;
            for (column, axis) in [(0, Vector2::x()), (1, Vector2::y())] {
                let difference = (model.pixel_of(&(s + axis * h)) - model.pixel_of(&(s - axis * h))) / (2.0 * h);
                prop_assert!((difference - J.column(column)).norm() < 1e-5, "{difference} {J}");
            }
        }

        #[test]
        fn wild_parameters_never_panic(
            k1 in -1e3..1e3f64, k2 in -1e3..1e3f64, p1 in -10.0..10.0f64, p2 in -10.0..10.0f64, k3 in -1e3..1e3f64,
            u in -1e6..1e6f64, v in -1e6..1e6f64,
        ) {
            if let Ok(model) = CameraModel::new(VGA, Distortion { k1, k2, p1, p2, k3 }) {
                let _ = model.normalized_of(&Vector2::new(u, v));
            }
        }
    }
}
