//! Bias of a dot's centroid: the projection of its centre is not the centroid of its image.
//!
//! Under perspective the near half of a tilted disc covers more pixels than the far half, and the lens distorts both;
//! the centroid lies off the centre's image by up to some tenths of a pixel, large dots seen from near by 10 px. Without a lens the image is an ellipse, and its
//! centre is that of the conic: with the disc's centre `p`, its radius `r` and the plate's axes `e`, `f`, in the camera's frame,
//!
//! ```text
//! D = p p' - r^2 (e e' + f f')          centre of the ellipse: (D_xz, D_yz) / D_zz
//! ```
//! With a lens the centroid is an integral over the disc, `c = int px(r) J(r) dr / int J(r) dr`, with `J` the area of a pixel on the plate,
//! inverted: `J ~ det(d px / d s) / z^3`. A rule of seven points is exact to the fifth degree; by what it misses without the lens its result is
//! corrected, since perspective is what varies most over a large dot.

use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use nalgebra::{Matrix2, Point3, Vector2};

/// Nearest depth of a point in view, m: what is nearer lies in the camera's plane but for rounding.
const NEAREST_M: f64 = 1e-6;

/// Centroid of the image of a disc in the object plane less the image of its centre, px (distorted image).
/// `centre` in the object plane (m), `radius_m` of the disc. Zero where the disc is not in view.
#[must_use]
pub fn centre_offset(
    X_CO: &Pose,
    camera: &CameraModel,
    centre: &Vector2<f64>,
    radius_m: f64,
) -> Vector2<f64> {
    let R = X_CO.rotation.to_rotation_matrix();
    let (ex, ey) = (R.matrix().column(0) * radius_m, R.matrix().column(1) * radius_m);
    let p = X_CO * Point3::new(centre.x, centre.y, 0.0);
    let s = Vector2::new(p.x / p.z, p.y / p.z);
    let middle = camera.pixel_of(&s);
    let D = |a: usize, b: usize| p[a] * p[b] - ex[a] * ex[b] - ey[a] * ey[b];
    // the nearest point of the disc lies where `D_zz` is still positive
    if !(p.z > NEAREST_M && D(2, 2) > NEAREST_M * NEAREST_M) {
        return Vector2::zeros();
    }
    let ellipse = Vector2::new(D(0, 2), D(1, 2)) / D(2, 2);
    let offset = if camera.lens().is_ideal() {
        camera.pixel_of(&ellipse) - middle
    } else {
        // derived for a disc of radius 1: weight 1/4 in the middle, 1/8 each at radius sqrt(2/3), every 60 degrees; B is half of A
        const A: f64 = 0.816_496_580_927_726;
        const B: f64 = 0.408_248_290_463_863;
        const C: f64 = std::f64::consts::FRAC_1_SQRT_2;
        let mut seen = (Vector2::zeros(), 2.0 * weight(camera, &s, p.z));
        // the same without the lens, in normalized coordinates
        let mut plain = (Vector2::zeros(), 2.0 / (p.z * p.z * p.z));
        for (x, y) in [(A, 0.0), (-A, 0.0), (B, C), (-B, -C), (B, -C), (-B, C)] {
            let q = p + ex * x + ey * y;
            let at = Vector2::new(q.x / q.z, q.y / q.z);
            let (w, w_plain) = (weight(camera, &at, q.z), 1.0 / (q.z * q.z * q.z));
            seen = (seen.0 + (camera.pixel_of(&at) - middle) * w, seen.1 + w);
            plain = (plain.0 + (at - s) * w_plain, plain.1 + w_plain);
        }
        let missed = ellipse - s - plain.0 / plain.1;
        seen.0 / seen.1 + camera.pixel_jacobian(&s) * missed
    };
    if offset.x.is_finite() && offset.y.is_finite() { offset } else { Vector2::zeros() }
}

#[inline]
fn weight(camera: &CameraModel, s: &Vector2<f64>, z: f64) -> f64 {
    camera.pixel_jacobian(s).determinant() / (z * z * z)
}

/// Covariance `[xx, xy, yy]` (px^2) of a point uniform in the image of a disc, and the image's area (px^2), to first
/// order. `None` where the centre is not in front of the camera.
#[must_use]
pub fn dot_covariance_px2(
    X_CO: &Pose,
    camera: &CameraModel,
    centre: &Vector2<f64>,
    radius_m: f64,
) -> Option<([f64; 3], f64)> {
    let p = X_CO * Point3::new(centre.x, centre.y, 0.0);
    if p.z.is_nan() || p.z <= NEAREST_M {
        return None;
    }
    let s = Vector2::new(p.x / p.z, p.y / p.z);
    let R = X_CO.rotation.to_rotation_matrix();
    let m = R.matrix();
    let by_plane =
        Matrix2::new(m.m11 - s.x * m.m31, m.m12 - s.x * m.m32, m.m21 - s.y * m.m31, m.m22 - s.y * m.m32)
            / p.z;
    Some(disc_moments(&(camera.pixel_jacobian(&s) * by_plane), radius_m))
}

/// Moments of a disc's image under the linear map `A`, px per m.
pub(super) fn disc_moments(A: &Matrix2<f64>, radius_m: f64) -> ([f64; 3], f64) {
    let k = 0.25 * radius_m * radius_m;
    let covariance = [
        k * (A.m11 * A.m11 + A.m12 * A.m12),
        k * (A.m11 * A.m21 + A.m12 * A.m22),
        k * (A.m21 * A.m21 + A.m22 * A.m22),
    ];
    (covariance, std::f64::consts::PI * radius_m * radius_m * A.determinant().abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};
    use nalgebra::{Translation3, UnitQuaternion};

    /// Against a fine grid over the image: which pixels' directions hit the disc.
    #[test]
    fn offset_and_moments_agree_with_brute_force() {
        let intrinsics = Intrinsics {
            fx_px: 600.0,
            fy_px: 600.0,
            cx_px: 320.0,
            cy_px: 240.0,
            width_px: 640,
            height_px: 480,
        };
        for k1 in [0.0, -0.2] {
            let camera =
                CameraModel::new(intrinsics, Distortion { k1, p1: 0.1 * k1 * k1, ..Distortion::default() })
                    .unwrap();
            for (tilt, x, z) in [(0.0, 0.0, 0.4), (0.5, 0.1, 0.3), (-0.9, -0.12, 0.35), (1.0, 0.05, 0.25)] {
                let X_CO = Pose::from_parts(
                    Translation3::new(x, 0.02, z),
                    UnitQuaternion::from_euler_angles(tilt, 0.3 * tilt, 0.4),
                );
                let (centre, radius) = (Vector2::new(0.01, -0.02), 0.015);
                let truth = camera.project(&(X_CO * Point3::new(centre.x, centre.y, 0.0))).unwrap();
                let X_OC = X_CO.inverse();
                let (mut n, mut sum, mut sum2) = (0.0, Vector2::zeros(), Matrix2::zeros());
                for i in 0..1000 {
                    for j in 0..1000 {
                        let d = Vector2::new(f64::from(i) - 499.5, f64::from(j) - 499.5) * 0.1;
                        let s = camera.normalized_of(&(truth + d));
                        let ray = X_OC.rotation * nalgebra::Vector3::new(s.x, s.y, 1.0);
                        let o = X_OC.translation.vector;
                        let r = (o - ray * (o.z / ray.z)).xy();
                        if (r - centre).norm() < radius {
                            n += 1.0;
                            sum += d;
                            sum2 += d * d.transpose();
                        }
                    }
                }
                let mean = sum / n;
                let got = centre_offset(&X_CO, &camera, &centre, radius);
                assert!((got - mean).norm() < 0.004, "{got} instead of {mean}");
                let (covariance, area) = dot_covariance_px2(&X_CO, &camera, &centre, radius).unwrap();
                let wanted = sum2 / n - mean * mean.transpose();
                assert!((area / (n * 0.01) - 1.0).abs() < 0.03, "{area} {n}");
                let off = Matrix2::new(covariance[0], covariance[1], covariance[1], covariance[2]) - wanted;
                assert!(off.norm() < 0.04 * wanted.norm(), "{off} {wanted}");
            }
        }
    }

    /// Centroid of the image of a disc less the image of its centre, px, from a polygon of many corners.
    fn of_polygon(X_CO: &Pose, camera: &CameraModel, centre: &Vector2<f64>, radius: f64) -> Vector2<f64> {
        let seen =
            |x: f64, y: f64| camera.project(&(X_CO * Point3::new(centre.x + x, centre.y + y, 0.0))).unwrap();
        let middle = seen(0.0, 0.0);
        let corner = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 4000.0).sin_cos();
            seen(radius * cos, radius * sin) - middle
        };
        let (mut area, mut sum) = (0.0, Vector2::zeros());
        for i in 0..4000 {
            let (a, b) = (corner(i), corner(i + 1));
            area += a.perp(&b);
            sum += (a + b) * a.perp(&b);
        }
        sum / (3.0 * area)
    }

    /// Large dots seen from near at a steep angle, as no rule of few points has them to thousandths of a pixel.
    #[test]
    fn offsets_of_large_steep_dots_are_exact() {
        for (k1, most_px) in [(0.0, 2e-5), (-0.2, 2e-3)] {
            let i = Intrinsics {
                fx_px: 600.0,
                fy_px: 600.0,
                cx_px: 320.0,
                cy_px: 240.0,
                width_px: 640,
                height_px: 480,
            };
            let camera = CameraModel::new(i, Distortion { k1, ..Distortion::default() }).unwrap();
            let mut most = 0.0f64;
            for (tilt_deg, z) in
                [(0.0, 0.15), (55.0, 0.15), (60.0, 0.12), (65.0, 0.1), (70.0, 0.1), (70.0, 0.4)]
            {
                let tilt = f64::to_radians(tilt_deg);
                let X_CO = Pose::from_parts(
                    Translation3::new(0.01, -0.01, z),
                    UnitQuaternion::from_euler_angles(tilt, 0.0, 0.7),
                );
                let (centre, radius) = (Vector2::new(0.005, -0.01), 0.015);
                let wanted = of_polygon(&X_CO, &camera, &centre, radius);
                most = most.max((centre_offset(&X_CO, &camera, &centre, radius) - wanted).norm());
            }
            assert!(most < most_px, "{most} px at k1 {k1}");
        }
    }
}
