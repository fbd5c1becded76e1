//! What is estimated of one camera, (5.45) with a lens, and the derivatives of a pixel by it.

use crate::camera_model::{CameraModel, Intrinsics, Lens, LensModel};
use nalgebra::{DMatrix, Matrix2, Matrix2x3, Vector2, Vector3};

/// Focal lengths and principal point, which are four, and the coefficients of the lens: the count follows from the camera model.
pub(crate) const MAX_PARAMETERS: usize = 4 + Lens::MAX_COEFFICIENTS;
/// Points nearer than this to the focal plane have no image, m, because at depth zero there is no projection; no lens has them in focus.
const NEAREST_M: f64 = 1e-6;

/// A camera while it is being estimated: not checked, as [`CameraModel`] is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    /// Focal lengths, principal point, size.
    pub intrinsics: Intrinsics,
    /// The lens.
    pub lens: Lens,
}

impl From<&CameraModel> for Optics {
    fn from(camera: &CameraModel) -> Self {
        Self { intrinsics: *camera.intrinsics(), lens: *camera.lens() }
    }
}

/// Which parameters of a camera are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Freedom {
    /// fy / fx stays as it starts.
    pub fixed_aspect: bool,
    /// The principal point stays as it starts: in the middle of the image.
    pub fixed_center: bool,
    /// Which coefficients of the lens, in the order of its model; the others stay zero.
    pub coefficients: [bool; Lens::MAX_COEFFICIENTS],
}

impl Freedom {
    /// All parameters of a camera with such a lens.
    #[must_use]
    pub fn of(model: LensModel) -> Self {
        let count = model.coefficients().len();
        Self { fixed_aspect: false, fixed_center: false, coefficients: std::array::from_fn(|i| i < count) }
    }

    /// The same without the coefficient of this name.
    #[must_use]
    pub fn without(mut self, model: LensModel, name: &str) -> Self {
        for (free, own) in self.coefficients.iter_mut().zip(model.coefficients()) {
            *free &= *own != name;
        }
        self
    }

    /// Places of the free parameters in the list fx, fy, cx, cy, coefficients. With a fixed aspect fx stands for both focal
    /// lengths.
    pub(crate) fn places(&self) -> impl Iterator<Item = usize> {
        let free = [true, !self.fixed_aspect, !self.fixed_center, !self.fixed_center];
        free.into_iter().chain(self.coefficients).enumerate().filter_map(|(i, free)| free.then_some(i))
    }

    /// A covariance of these parameters among those of `all`; what is not free here is certain.
    pub(crate) fn covariance_within(&self, all: &Self, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let own: Vec<usize> = self.places().collect();
        let column: Vec<Option<usize>> =
            all.places().map(|place| own.iter().position(|own| *own == place)).collect();
        DMatrix::from_fn(column.len(), column.len(), |i, j| match (column[i], column[j]) {
            (Some(i), Some(j)) => covariance[(i, j)],
            _ => 0.0,
        })
    }

    /// How many parameters are free.
    #[must_use]
    pub fn count(&self) -> usize {
        self.places().count()
    }

    /// Names of the free parameters, as in files and answers.
    #[must_use]
    pub fn names(&self, model: LensModel) -> Vec<&'static str> {
        let all = ["fx_px", "fy_px", "cx_px", "cy_px"];
        let all: Vec<_> = all.iter().chain(model.coefficients()).copied().collect();
        self.places().filter_map(|i| all.get(i).copied()).collect()
    }

    /// Derivatives by the free parameters from those by all.
    pub(crate) fn reduced(
        &self,
        optics: &Optics,
        all: &[Vector2<f64>; MAX_PARAMETERS],
    ) -> impl Iterator<Item = Vector2<f64>> {
        let ratio = optics.intrinsics.fy_px / optics.intrinsics.fx_px;
        let along = if self.fixed_aspect { all[1] * ratio } else { Vector2::zeros() };
        let all = *all;
        self.places().map(move |i| if i == 0 { all[0] + along } else { all[i] })
    }

    /// The camera after a step of the free parameters.
    pub(crate) fn moved(&self, optics: &Optics, step: &[f64]) -> Optics {
        let mut full = [0.0; MAX_PARAMETERS];
        for (place, by) in self.places().zip(step) {
            full[place] = *by;
        }
        let [dfx, dfy, dcx, dcy, by_coefficient @ ..] = full;
        let i = optics.intrinsics;
        let fx_px = i.fx_px + dfx;
        let fy_px = if self.fixed_aspect { i.fy_px * (fx_px / i.fx_px) } else { i.fy_px + dfy };
        let intrinsics = Intrinsics { fx_px, fy_px, cx_px: i.cx_px + dcx, cy_px: i.cy_px + dcy, ..i };
        let coefficients = optics.lens.coefficients();
        let lens = Lens::of(optics.lens.model(), |name| {
            let of = |((own, value), by): (&(&str, f64), f64)| (*own == name).then_some(value + by);
            coefficients.iter().zip(by_coefficient).find_map(of).unwrap_or(0.0)
        });
        Optics { intrinsics, lens }
    }
}

/// Where a point is seen, and the derivatives of that.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PointImage {
    /// The pixel.
    pub(crate) px: Vector2<f64>,
    /// By the point's place in the camera, px/m.
    pub(crate) by_point: Matrix2x3<f64>,
    /// By fx, fy, cx, cy and the coefficients.
    pub(crate) by_optics: [Vector2<f64>; MAX_PARAMETERS],
}

impl PointImage {
    /// Of a point in camera coordinates, m; `None` behind the camera.
    #[inline]
    pub(crate) fn new(optics: &Optics, p_C: &Vector3<f64>) -> Option<Self> {
        if !(p_C.z > NEAREST_M) {
            return None;
        }
        let Intrinsics { fx_px, fy_px, cx_px, cy_px, .. } = optics.intrinsics;
        let inverse = 1.0 / p_C.z;
        let s = p_C.xy() * inverse;
        let d = optics.lens.apply(&s);
        let D: Matrix2<f64> = optics.lens.jacobian(&s);
        let (a, b) = (fx_px * inverse, fy_px * inverse);
        let (m11, m12, m21, m22) = (a * D.m11, a * D.m12, b * D.m21, b * D.m22);
        let by_point = Matrix2x3::new(m11, m12, -(m11 * s.x + m12 * s.y), m21, m22, -(m21 * s.x + m22 * s.y));
        let mut by_optics = [Vector2::zeros(); MAX_PARAMETERS];
        by_optics[0].x = d.x;
        by_optics[1].y = d.y;
        by_optics[2].x = 1.0;
        by_optics[3].y = 1.0;
        for (out, column) in by_optics.iter_mut().skip(4).zip(optics.lens.by_coefficients(&s)) {
            *out = Vector2::new(fx_px * column.x, fy_px * column.y);
        }
        let px = Vector2::new(fx_px * d.x + cx_px, fy_px * d.y + cy_px);
        Some(Self { px, by_point, by_optics })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;

    fn camera(model: LensModel) -> Optics {
        let intrinsics = Intrinsics {
            fx_px: 600.0,
            fy_px: 620.0,
            cx_px: 310.0,
            cy_px: 250.0,
            width_px: 640,
            height_px: 480,
        };
        let value = |name: &str| match name {
            "k1" => -0.2,
            "k2" => 0.05,
            "p1" => 1e-3,
            "k4" => 0.02,
            _ => -2e-3,
        };
        Optics { intrinsics, lens: Lens::of(model, value) }
    }

    /// Against differences: of the point, and of each free parameter for every choice of what is fixed.
    #[test]
    fn derivatives_are_those_of_differences() {
        let mut random = Random::new(3);
        for (model, pick) in LensModel::ALL.into_iter().flat_map(|m| (0..4).map(move |i| (m, i))) {
            let optics = camera(model);
            let freedom = Freedom {
                fixed_aspect: pick & 1 == 1,
                fixed_center: pick & 2 == 2,
                ..Freedom::of(model).without(model, "k2")
            };
            assert_eq!(freedom.names(model).len(), freedom.count());
            for _ in 0..20 {
                let p = Vector3::new(
                    random.between(-0.4, 0.4),
                    random.between(-0.3, 0.3),
                    random.between(0.6, 1.2),
                );
                let image = PointImage::new(&optics, &p).unwrap();
                for axis in 0..3 {
                    let h = Vector3::ith(axis, 1e-6);
                    let at = |p: Vector3<f64>| PointImage::new(&optics, &p).unwrap().px;
                    let difference = (at(p + h) - at(p - h)) / 2e-6;
                    assert!((difference - image.by_point.column(axis)).norm() < 1e-4);
                }
                for (i, column) in freedom.reduced(&optics, &image.by_optics).enumerate() {
                    let at = |by: f64| {
                        let mut step = vec![0.0; freedom.count()];
                        step[i] = by;
                        PointImage::new(&freedom.moved(&optics, &step), &p).unwrap().px
                    };
                    let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
                    assert!((difference - column).norm() < 1e-5 * (1.0 + column.norm()), "{model:?} {i}");
                }
            }
        }
        assert!(PointImage::new(&camera(LensModel::PlumbBob), &Vector3::new(0.0, 0.0, -1.0)).is_none());
    }
}
