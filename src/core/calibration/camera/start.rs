//! A first camera from homographies of a plane, (10.64)-(10.67), and first poses from (10.8).
//!
//! ```text
//! H' = Omega [r1 r2 p] zeta,   B = Omega^-T Omega^-1:   h1' B h2 = 0,   h1' B h1 = h2' B h2        (10.65), (10.66)
//!
//!         b11  0   b13            X0 = -b13/b11,  Y0 = -b23/b22,  gamma = b33 - b13^2/b11 - b23^2/b22
//! B ~      0  b22  b23            fx = sqrt(gamma/b11),  fy = sqrt(gamma/b22)                       (10.67)
//!         b13 b23  b33
//! ```
//! gamma is the one that (10.67) leads to, not the printed sum. Without skew two views tell all four; of fewer, or where noise
//! and lens make nonsense of them, the principal point is taken to be the middle and pixels to be square: then
//! `b11 = b22 = 1/f^2` is a single unknown. Pixels are counted from the middle in image widths, for good numbers.

use crate::calibration::bundle::{Freedom, Optics, median};
use crate::camera_model::{CameraModel, Intrinsics, Lens, LensModel};
use crate::geometry::Pose;
use crate::linalg::symmetric_eigen;
use crate::pose::{Correspondence, homography, planar_pose};
use nalgebra::{Matrix3, SMatrix, SVector, Vector2};

/// Focal lengths that a camera may have, in image widths: views of 150 to 3 degrees, as follows from tan of half of them. Beyond, what
/// homographies tell is noise.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.13..=20.0;
/// Focal lengths to begin with where homographies do not tell them, in image widths: each about 1.4 to 1.8 times the one before, so that the
/// nearest is never off by more than a third. The best end counts.
const GUESSES: [f64; 8] = [0.25, 0.35, 0.5, 0.7, 1.0, 1.5, 2.2, 4.0];

/// A plane's points with their pixels.
pub(crate) type PlaneView = Vec<(Vector2<f64>, Vector2<f64>)>;

/// A camera with the poses that it gives each view.
#[derive(Debug, Clone)]
pub(crate) struct CameraStart {
    pub(crate) optics: Optics,
    pub(crate) poses: Vec<Option<Pose>>,
}

/// The start that explains the views best.
pub(crate) fn start(
    views: &[PlaneView],
    size: (u32, u32),
    model: LensModel,
    freedom: &Freedom,
) -> Option<CameraStart> {
    let (width, height) = (f64::from(size.0), f64::from(size.1));
    let middle = Vector2::new(0.5 * (width - 1.0), 0.5 * (height - 1.0));
    let scaled = |(r, px): &(Vector2<f64>, Vector2<f64>)| Correspondence { r: *r, s: (px - middle) / width };
    let planes: Vec<Matrix3<f64>> = (views.iter())
        .filter_map(|view| homography(&view.iter().map(scaled).collect::<Vec<_>>()).ok())
        .collect();
    let mut starts = Vec::new();
    if !freedom.fixed_aspect && !freedom.fixed_center {
        starts.extend(from_planes(&planes).filter(plausible));
    }
    starts.extend(focal_from_planes(&planes).map(|f| [f, f, 0.0, 0.0]).filter(plausible));
    if starts.is_empty() || model == LensModel::Equidistant {
        starts.extend(GUESSES.map(|f| [f, f, 0.0, 0.0]));
    }
    let judged = starts.into_iter().filter_map(|[fx, fy, x, y]| {
        let intrinsics = Intrinsics {
            fx_px: fx * width,
            fy_px: fy * width,
            cx_px: middle.x + x * width,
            cy_px: middle.y + y * width,
            width_px: size.0,
            height_px: size.1,
        };
        let lens = Lens::of(model, |_| 0.0);
        let camera = CameraModel::new(intrinsics, lens).ok()?;
        let (poses, rms_px): (Vec<_>, Vec<_>) = views.iter().map(|view| pose(&camera, view)).unzip();
        let rms_px = median(rms_px);
        rms_px.is_finite().then_some((rms_px, CameraStart { optics: Optics { intrinsics, lens }, poses }))
    });
    judged.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, start)| start)
}

/// Pose of a plane in a camera, and the root mean square of its errors in about px; infinite without a pose.
pub(crate) fn pose(camera: &CameraModel, view: &PlaneView) -> (Option<Pose>, f64) {
    let points: Vec<_> =
        view.iter().map(|(r, px)| Correspondence { r: *r, s: camera.normalized_of(px) }).collect();
    match planar_pose(&points) {
        Ok(found) => {
            // errors of far directions count less in the image of a wide lens
            let error = |p: &Correspondence| {
                let r = nalgebra::Point3::new(p.r.x, p.r.y, 0.0);
                let seen = camera.project(&(found.best.X_CO * r));
                seen.map_or(f64::INFINITY, |px| (px - camera.pixel_of(&p.s)).norm_squared())
            };
            let sum: f64 = points.iter().map(error).sum();
            (Some(found.best.X_CO), (sum / points.len().max(1) as f64).sqrt())
        }
        Err(_) => (None, f64::INFINITY),
    }
}

fn plausible([fx, fy, x, y]: &[f64; 4]) -> bool {
    PLAUSIBLE.contains(fx)
        && PLAUSIBLE.contains(fy)
        && (0.5..2.0).contains(&(fx / fy))
        && x.abs().max(y.abs()) < 0.5
}

/// fx, fy, X0, Y0 in the units of the homographies, which must be two or more.
fn from_planes(planes: &[Matrix3<f64>]) -> impl Iterator<Item = [f64; 4]> {
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    for H in planes {
        let row = |i: usize, j: usize| {
            let (a, b) = (H.column(i), H.column(j));
            let mixed = |k: usize| a[k] * b[2] + a[2] * b[k];
            SVector::<f64, 5>::new(a[0] * b[0], a[1] * b[1], mixed(0), mixed(1), a[2] * b[2])
        };
        let size = H.column(0).norm_squared() + H.column(1).norm_squared();
        for row in [row(0, 1), (row(0, 0) - row(1, 1)) * 0.5].map(|row| row / size) {
            normal += row * row.transpose();
        }
    }
    let solved = (planes.len() >= 2).then(|| symmetric_eigen(&normal)).flatten();
    let of = |b: SVector<f64, 5>| {
        let gamma = b[4] - b[2] * b[2] / b[0] - b[3] * b[3] / b[1];
        [(gamma / b[0]).sqrt(), (gamma / b[1]).sqrt(), -b[2] / b[0], -b[3] / b[1]]
    };
    solved.map(|(_, V)| of(V.column(4).into())).into_iter()
}

/// The focal length of square pixels about the middle.
fn focal_from_planes(planes: &[Matrix3<f64>]) -> Option<f64> {
    let (mut squares, mut mixed) = (0.0, 0.0);
    for H in planes {
        let (a, b) = (H.column(0), H.column(1));
        let size = a.norm_squared() + b.norm_squared();
        let rows = [
            (a[0] * b[0] + a[1] * b[1], a[2] * b[2]),
            (
                0.5 * (a[0] * a[0] + a[1] * a[1] - b[0] * b[0] - b[1] * b[1]),
                0.5 * (a[2] * a[2] - b[2] * b[2]),
            ),
        ];
        for (of_b, constant) in rows {
            squares += of_b * of_b / (size * size);
            mixed += of_b * constant / (size * size);
        }
    }
    let b = -mixed / squares;
    (b > 0.0).then(|| b.sqrt().recip())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, UnitQuaternion, Vector3};

    fn seen(camera: &CameraModel, tilts: &[[f64; 3]]) -> Vec<PlaneView> {
        let view = |w: &[f64; 3]| {
            let X = Pose::from_parts(
                Vector3::new(-0.04, -0.03, 0.5).into(),
                UnitQuaternion::from_scaled_axis(Vector3::from(*w)),
            );
            let corner = |i: usize| Vector2::new((i % 5) as f64 * 0.03, (i / 5) as f64 * 0.03);
            let px = |r: &Vector2<f64>| camera.project(&(X * Point3::new(r.x, r.y, 0.0))).unwrap();
            (0..20).map(corner).map(|r| (r, px(&r))).collect()
        };
        tilts.iter().map(view).collect()
    }

    fn camera(lens: Lens) -> CameraModel {
        let i = Intrinsics {
            fx_px: 610.0,
            fy_px: 590.0,
            cx_px: 335.0,
            cy_px: 228.0,
            width_px: 640,
            height_px: 480,
        };
        CameraModel::new(i, lens).unwrap()
    }

    #[test]
    fn two_ideal_views_tell_the_camera() {
        let camera = camera(Lens::default());
        let tilts = [[0.5, 0.1, 0.2], [-0.2, 0.6, -0.4]];
        let views = seen(&camera, &tilts);
        let found =
            start(&views, (640, 480), LensModel::PlumbBob, &Freedom::of(LensModel::PlumbBob)).unwrap();
        let (a, b) = (found.optics.intrinsics, camera.intrinsics());
        let off = [a.fx_px - b.fx_px, a.fy_px - b.fy_px, a.cx_px - b.cx_px, a.cy_px - b.cy_px];
        assert!(off.iter().all(|x| x.abs() < 1e-6), "{off:?}");
        for (X, w) in found.poses.iter().zip(tilts) {
            assert!((X.unwrap().rotation.scaled_axis() - Vector3::from(w)).norm() < 1e-8);
        }
    }

    #[test]
    fn one_view_tells_the_focal_length_and_a_frontal_one_not() {
        let intrinsics = Intrinsics {
            fx_px: 700.0,
            fy_px: 700.0,
            cx_px: 319.5,
            cy_px: 239.5,
            width_px: 640,
            height_px: 480,
        };
        let camera = CameraModel::new(intrinsics, Lens::default()).unwrap();
        let of = |w: [f64; 3]| {
            let views = seen(&camera, &[w]);
            start(&views, (640, 480), LensModel::PlumbBob, &Freedom::of(LensModel::PlumbBob)).unwrap()
        };
        assert!((of([0.5, 0.2, 0.0]).optics.intrinsics.fx_px - 700.0).abs() < 1e-5);
        // any focal length explains it: one of the guesses
        let flat = of([0.0, 0.0, 0.3]).optics.intrinsics.fx_px / 640.0;
        assert!(PLAUSIBLE.contains(&flat));
    }

    #[test]
    fn a_wide_lens_starts_near() {
        let lens = Lens::of(LensModel::Equidistant, |_| 0.0);
        let i = Intrinsics { fx_px: 275.0, fy_px: 275.0, ..*camera(Lens::default()).intrinsics() };
        let camera = CameraModel::new(i, lens).unwrap();
        let views = seen(&camera, &[[0.5, 0.1, 0.2], [-0.2, 0.6, -0.4], [0.1, -0.5, 0.4]]);
        let found =
            start(&views, (640, 480), LensModel::Equidistant, &Freedom::of(LensModel::Equidistant)).unwrap();
        assert!((180.0..350.0).contains(&found.optics.intrinsics.fx_px), "{:?}", found.optics);
    }
}
