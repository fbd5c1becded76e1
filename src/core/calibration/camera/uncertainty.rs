//! How far a pixel may be off: the noise of corners carried through the whole calibration.
//!
//! What counts is not by how much cx is off: an error of cx and a turned camera look the same. So the question is put as a user of
//! the camera meets it: **a point stands fixed among the boards of the calibration, at a depth d; the camera's own pose is fitted
//! again, with the parameters as they are, to all corners of those boards; how far from its true pixel does the point appear?**
//!
//! ```text
//! px(i + di, exp(x) p) - px(i, p) = J_i(p) di + J_p(p) x        di: error of the parameters, covariance Sigma
//! x minimises the sum of squares over all corners of all boards:  x = -A^-1 B di,  A = sum J_p' J_p,  B = sum J_p' J_i
//! M(p) = J_i(p) - J_p(p) A^-1 B,    covariance of the pixel = M Sigma M'
//! ```
//! The free pose is hereby removed once, for the whole image, by the data that the calibration rests on; a part of the image without
//! corners does not pull at it. Depth d is along the optical axis. px, m.

use super::CameraCalibration;
use crate::calibration::bundle::{Freedom, Optics, PointImage};
use crate::camera_model::CameraModel;
use crate::geometry::{Pose, skew};
use crate::linalg::Ldlt;
use nalgebra::{
    DMatrix, Isometry3, Matrix2, Matrix2x6, Matrix2xX, Matrix6, Matrix6xX, Point3, Translation3,
    UnitQuaternion, Vector2, Vector3, Vector6,
};

/// Shallowest and farthest depth at which a pixel is asked for, m: chosen wider than any work of an arm; beyond, the answer is that at the bound.
const DEPTHS_M: std::ops::RangeInclusive<f64> = 1e-3..=1e6;

/// The uncertainty of pixels at one depth.
#[derive(Debug, Clone)]
pub struct ProjectionUncertainty {
    camera: CameraModel,
    optics: Optics,
    freedom: Freedom,
    covariance: DMatrix<f64>,
    gauge: Gauge,
    distance_m: f64,
}

/// The free pose: the middle about which it turns, and `-A^-1 B`.
#[derive(Debug, Clone)]
struct Gauge {
    middle: Vector3<f64>,
    refit: Matrix6xX<f64>,
}

/// Derivative of a pixel by the twist of the scene about `middle`.
fn by_twist(image: &PointImage, p: &Vector3<f64>, middle: &Vector3<f64>) -> Matrix2x6<f64> {
    let mut J = Matrix2x6::zeros();
    J.fixed_columns_mut::<3>(0).copy_from(&image.by_point);
    J.fixed_columns_mut::<3>(3).copy_from(&(image.by_point * -skew(&(p - middle))));
    J
}

fn by_parameters(freedom: &Freedom, optics: &Optics, image: &PointImage) -> Matrix2xX<f64> {
    Matrix2xX::from_columns(&freedom.reduced(optics, &image.by_optics).collect::<Vec<_>>())
}

fn middle_of(points: &[Point3<f64>]) -> Vector3<f64> {
    points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / points.len().max(1) as f64
}

impl ProjectionUncertainty {
    /// At depth `distance_m` (clamped to 1 mm .. 1000 km). `None` when the corners do not fix a pose, which a calibration's do.
    #[must_use]
    pub fn new(calibration: &CameraCalibration, distance_m: f64) -> Option<Self> {
        let optics = Optics::from(&calibration.camera);
        let freedom = calibration.unknown;
        let points: Vec<_> = calibration.points_used().map(|p| p.p_C).collect();
        let middle = middle_of(&points);
        let (mut A, mut B) = (Matrix6::zeros(), Matrix6xX::zeros(freedom.count()));
        for p in &points {
            let image = PointImage::new(&optics, &p.coords)?;
            let J = by_twist(&image, &p.coords, &middle);
            A += J.tr_mul(&J);
            B.gemm_tr(1.0, &J, &by_parameters(&freedom, &optics, &image), 1.0);
        }
        let factor = Ldlt::of(&A)?;
        for mut column in B.column_iter_mut() {
            let solved = factor.solve(&std::array::from_fn(|i| -column[i]));
            column.copy_from_slice(&solved);
        }
        Some(Self {
            camera: calibration.camera,
            optics,
            freedom,
            covariance: calibration.covariance.clone(),
            gauge: Gauge { middle, refit: B },
            distance_m: distance_m.clamp(*DEPTHS_M.start(), *DEPTHS_M.end()),
        })
    }

    /// The depth, m.
    #[must_use]
    pub fn distance_m(&self) -> f64 {
        self.distance_m
    }

    /// `M` of a pixel: how it moves with the free parameters, 2 x their number.
    pub(crate) fn map(&self, px: &Vector2<f64>) -> Option<Matrix2xX<f64>> {
        let p = self.camera.normalized_of(px).push(1.0) * self.distance_m;
        let image = PointImage::new(&self.optics, &p)?;
        let mut M = by_parameters(&self.freedom, &self.optics, &image);
        M += by_twist(&image, &p, &self.gauge.middle) * &self.gauge.refit;
        Some(M)
    }

    /// Covariance of a pixel, px^2. Of one that the camera does not have: infinite.
    #[must_use]
    pub fn covariance_px2(&self, px: &Vector2<f64>) -> Matrix2<f64> {
        let unknown = Matrix2::from_diagonal_element(f64::INFINITY);
        self.map(px).map_or(unknown, |M| carried(&M, &self.covariance))
    }

    /// Standard deviation of a pixel in its worst direction, px.
    #[must_use]
    pub fn sd_px(&self, px: &Vector2<f64>) -> f64 {
        worst_sd(&self.covariance_px2(px))
    }

    /// The greatest deviation on a grid over the middle of the image, so much of its width and height: 1 is all of it.
    #[must_use]
    pub fn worst_px(&self, share: f64) -> f64 {
        let (i, n) = (self.camera.intrinsics(), 16);
        grid((i.width_px, i.height_px), share, (n, n)).map(|px| self.sd_px(&px)).fold(0.0, f64::max)
    }
}

/// `M Sigma M'`.
pub(crate) fn carried(M: &Matrix2xX<f64>, covariance: &DMatrix<f64>) -> Matrix2<f64> {
    (M * covariance) * M.transpose()
}

/// The standard deviation along the longest axis of a covariance.
#[must_use]
pub(crate) fn worst_sd(C: &Matrix2<f64>) -> f64 {
    let (half, difference) = (0.5 * (C.m11 + C.m22), 0.5 * (C.m11 - C.m22));
    (half + (difference * difference + C.m12 * C.m12).sqrt()).sqrt()
}

/// Pixels over the middle of an image, borders included, row by row; `count` steps in each direction.
pub(crate) fn grid(
    (width, height): (u32, u32),
    share: f64,
    (columns, rows): (u32, u32),
) -> impl Iterator<Item = Vector2<f64>> + Clone {
    let at = move |i: u32, n: u32, side: u32| {
        let middle = 0.5 * (f64::from(side) - 1.0);
        middle + (f64::from(i) / f64::from(n) - 0.5) * share * (f64::from(side) - 1.0)
    };
    (0..=rows).flat_map(move |j| {
        (0..=columns).map(move |i| Vector2::new(at(i, columns, width), at(j, rows, height)))
    })
}

/// The motion of the scene after which camera `to` shows `points` as nearly as it can where `from` does: the free pose, fitted
/// without linearising.
pub(crate) fn refitted(from: &Optics, to: &Optics, points: &[Point3<f64>]) -> Option<Pose> {
    let middle = middle_of(points);
    let seen: Vec<_> = points.iter().map(|p| PointImage::new(from, &p.coords)).collect::<Option<_>>()?;
    let mut X = Isometry3::identity();
    for _ in 0..10 {
        let (mut A, mut b) = (Matrix6::zeros(), Vector6::zeros());
        let now = (X * Point3::from(middle)).coords;
        for (p, seen) in points.iter().zip(&seen) {
            let p = (X * p).coords;
            let image = PointImage::new(to, &p)?;
            let J = by_twist(&image, &p, &now);
            A += J.tr_mul(&J);
            b += J.tr_mul(&(seen.px - image.px));
        }
        let [vx, vy, vz, wx, wy, wz] = Ldlt::of(&A)?.solve(&b.into());
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(wx, wy, wz));
        let about = Translation3::from(now + Vector3::new(vx, vy, vz)) * turn * Translation3::from(-now);
        X = about * X;
        // Newton's method is quadratic: what follows a step so short is rounding.
        if turn.angle() < 1e-10 && Vector3::new(vx, vy, vz).norm() < 1e-10 * now.norm() {
            break;
        }
    }
    Some(X)
}
