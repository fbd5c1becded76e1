//! The lens of a camera: one of the models of ROS.

use super::{Distortion, Equidistant, RationalPolynomial};
use nalgebra::{Matrix2, Vector2};

/// Least slope of the distorted radius: one pixel of the image is spread over a hundred there, so that a detection's tenth of a pixel
/// would be ten.
const MIN_SLOPE: f64 = 0.01;
/// Smallest area in the image of a unit of area in directions. It follows from `MIN_SLOPE`: that slope, with the other direction a tenth of what it
/// is on the axis.
const MIN_AREA: f64 = 1e-3;

/// How a lens bends directions: a model with its coefficients, which have no units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lens {
    /// ROS `plumb_bob`.
    PlumbBob(Distortion),
    /// ROS `rational_polynomial`.
    RationalPolynomial(RationalPolynomial),
    /// ROS `equidistant`.
    Equidistant(Equidistant),
}

/// Which model a lens is described by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensModel {
    /// ROS `plumb_bob`.
    PlumbBob,
    /// ROS `rational_polynomial`.
    RationalPolynomial,
    /// ROS `equidistant`.
    Equidistant,
}

impl LensModel {
    /// All models.
    pub const ALL: [Self; 3] = [Self::PlumbBob, Self::RationalPolynomial, Self::Equidistant];

    /// The word for it, here and in ROS.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PlumbBob => "plumb_bob",
            Self::RationalPolynomial => "rational_polynomial",
            Self::Equidistant => "equidistant",
        }
    }

    /// Its coefficients, in the order of ROS and OpenCV.
    #[must_use]
    pub fn coefficients(self) -> &'static [&'static str] {
        match self {
            Self::PlumbBob => &["k1", "k2", "p1", "p2", "k3"],
            Self::RationalPolynomial => &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            Self::Equidistant => &["k1", "k2", "k3", "k4"],
        }
    }
}

impl Default for Lens {
    fn default() -> Self {
        Self::PlumbBob(Distortion::default())
    }
}

impl From<Distortion> for Lens {
    fn from(distortion: Distortion) -> Self {
        Self::PlumbBob(distortion)
    }
}

impl From<RationalPolynomial> for Lens {
    fn from(lens: RationalPolynomial) -> Self {
        Self::RationalPolynomial(lens)
    }
}

impl From<Equidistant> for Lens {
    fn from(lens: Equidistant) -> Self {
        Self::Equidistant(lens)
    }
}

impl Lens {
    /// As many coefficients has the model that has most.
    pub const MAX_COEFFICIENTS: usize = 8;

    /// The lens with these coefficients, each asked for by its name.
    #[must_use]
    pub fn of(model: LensModel, coefficient: impl Fn(&str) -> f64) -> Self {
        let c = coefficient;
        match model {
            LensModel::PlumbBob => {
                Self::PlumbBob(Distortion { k1: c("k1"), k2: c("k2"), p1: c("p1"), p2: c("p2"), k3: c("k3") })
            }
            LensModel::RationalPolynomial => Self::RationalPolynomial(RationalPolynomial {
                k1: c("k1"),
                k2: c("k2"),
                p1: c("p1"),
                p2: c("p2"),
                k3: c("k3"),
                k4: c("k4"),
                k5: c("k5"),
                k6: c("k6"),
            }),
            LensModel::Equidistant => {
                Self::Equidistant(Equidistant { k1: c("k1"), k2: c("k2"), k3: c("k3"), k4: c("k4") })
            }
        }
    }

    /// Its model.
    #[must_use]
    pub fn model(&self) -> LensModel {
        match self {
            Self::PlumbBob(_) => LensModel::PlumbBob,
            Self::RationalPolynomial(_) => LensModel::RationalPolynomial,
            Self::Equidistant(_) => LensModel::Equidistant,
        }
    }

    /// Its coefficients with their names, in the order of ROS and OpenCV.
    #[must_use]
    pub fn coefficients(&self) -> Vec<(&'static str, f64)> {
        let values = match *self {
            Self::PlumbBob(Distortion { k1, k2, p1, p2, k3 }) => vec![k1, k2, p1, p2, k3],
            Self::RationalPolynomial(RationalPolynomial { k1, k2, p1, p2, k3, k4, k5, k6 }) => {
                vec![k1, k2, p1, p2, k3, k4, k5, k6]
            }
            Self::Equidistant(Equidistant { k1, k2, k3, k4 }) => vec![k1, k2, k3, k4],
        };
        self.model().coefficients().iter().copied().zip(values).collect()
    }

    /// Whether pixels are a linear map of normalized coordinates.
    #[must_use]
    pub fn is_ideal(&self) -> bool {
        match self {
            Self::PlumbBob(lens) => lens.is_none(),
            Self::RationalPolynomial(lens) => *lens == RationalPolynomial::default(),
            Self::Equidistant(_) => false,
        }
    }

    /// Distorted normalized coordinates of `s`.
    #[must_use]
    #[inline]
    pub fn apply(&self, s: &Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::PlumbBob(lens) => lens.apply(s),
            other => other.apply_rare(s),
        }
    }

    /// The lenses that are less common stay out of the way of the one that is.
    #[inline(never)]
    fn apply_rare(&self, s: &Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::PlumbBob(lens) => lens.apply(s),
            Self::RationalPolynomial(lens) => lens.apply(s),
            Self::Equidistant(lens) => lens.apply(s),
        }
    }

    /// Derivative of [`Self::apply`] with respect to `s`.
    #[must_use]
    #[inline]
    pub fn jacobian(&self, s: &Vector2<f64>) -> Matrix2<f64> {
        match self {
            Self::PlumbBob(lens) => lens.jacobian(s),
            other => other.jacobian_rare(s),
        }
    }

    #[inline(never)]
    fn jacobian_rare(&self, s: &Vector2<f64>) -> Matrix2<f64> {
        match self {
            Self::PlumbBob(lens) => lens.jacobian(s),
            Self::RationalPolynomial(lens) => lens.jacobian(s),
            Self::Equidistant(lens) => lens.jacobian(s),
        }
    }

    /// Derivative of [`Self::apply`] with respect to each coefficient, in the order of [`Self::coefficients`]; zero beyond the
    /// last.
    #[must_use]
    #[inline]
    pub fn by_coefficients(&self, s: &Vector2<f64>) -> [Vector2<f64>; Self::MAX_COEFFICIENTS] {
        let mut all = [Vector2::zeros(); Self::MAX_COEFFICIENTS];
        let mut put = |some: &[Vector2<f64>]| all.iter_mut().zip(some).for_each(|(a, b)| *a = *b);
        match self {
            Self::PlumbBob(_) => put(&Distortion::by_coefficients(s)),
            Self::RationalPolynomial(lens) => put(&lens.by_coefficients(s)),
            Self::Equidistant(_) => put(&Equidistant::by_coefficients(s)),
        }
        all
    }

    /// Distorted radius of the radial part alone.
    pub(super) fn radius(&self, r: f64) -> f64 {
        match self {
            Self::PlumbBob(lens) => lens.radius(r),
            Self::RationalPolynomial(lens) => lens.radius(r),
            Self::Equidistant(lens) => lens.radius(r),
        }
    }

    /// The first radius at which the radial part stops growing, or infinity.
    pub(super) fn fold_radius(&self) -> f64 {
        match self {
            Self::PlumbBob(lens) => lens.fold_radius(),
            Self::RationalPolynomial(lens) => lens.fold_radius(),
            Self::Equidistant(lens) => lens.fold_radius(),
        }
    }

    /// Whether neighbouring directions at `s` can be distinguished in the image.
    pub(super) fn tells_apart(&self, s: &Vector2<f64>) -> bool {
        let r = s.norm();
        match self {
            Self::PlumbBob(lens) => {
                lens.radius_slope(r) >= MIN_SLOPE && lens.jacobian(s).determinant() >= MIN_AREA
            }
            Self::RationalPolynomial(lens) => {
                lens.radius_slope(r) >= MIN_SLOPE && lens.jacobian(s).determinant() >= MIN_AREA
            }
            Self::Equidistant(lens) => lens.slope_by_angle(r) >= MIN_SLOPE,
        }
    }

    /// The direction whose distorted one is `d`, short of `fold_radius`, and the residual that is left.
    pub(super) fn undistort(&self, d: &Vector2<f64>, fold_radius: f64) -> (Vector2<f64>, f64) {
        match self {
            Self::PlumbBob(lens) => newton(d, fold_radius, |s| lens.apply(s), |s| lens.jacobian(s)),
            Self::RationalPolynomial(lens) => newton(d, fold_radius, |s| lens.apply(s), |s| lens.jacobian(s)),
            Self::Equidistant(lens) => lens.undistort(d, fold_radius),
        }
    }
}

/// Newton with step halving on `apply(s) = d`; the second value is the residual that is left.
/// It starts at `d`: for a barrel (concave) or pincushion (convex) polynomial the steps then approach from
/// one side and never pass the fold.
#[inline]
fn newton(
    d: &Vector2<f64>,
    fold_radius: f64,
    apply: impl Fn(&Vector2<f64>) -> Vector2<f64>,
    jacobian: impl Fn(&Vector2<f64>) -> Matrix2<f64>,
) -> (Vector2<f64>, f64) {
    let mut s = *d;
    let mut rest = apply(&s) - d;
    let mut size = rest.norm_squared();
    for _ in 0..50 {
        // The square of 3e-16: rounding of coordinates about one, so that no step finds anything nearer.
        if size < 1e-31 {
            break;
        }
        let J = jacobian(&s);
        let det = J.m11 * J.m22 - J.m12 * J.m21;
        // On the fold there is no inverse; the step as if there were no lens is halved until it serves, or none does.
        let inverse = if det.abs() > 1e-12 { 1.0 / det } else { 1.0 };
        let step = Vector2::new(
            inverse * (J.m22 * rest.x - J.m12 * rest.y),
            inverse * (J.m11 * rest.y - J.m21 * rest.x),
        );
        let mut factor = 1.0;
        let mut better = false;
        for _ in 0..12 {
            let next = s - step * factor;
            let next_rest = apply(&next) - d;
            let next_size = next_rest.norm_squared();
            if next_size < size && next.norm() < fold_radius {
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
