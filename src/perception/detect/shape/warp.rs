//! Maps from the outline's plane to normalized image coordinates: a homography, or, for an ellipse, the affine map of the unit circle.

use nalgebra::{SMatrix, SVector, Vector2};

/// A map of the plane with `N` parameters.
pub(super) trait Warp<const N: usize>: Copy {
    /// The parameters.
    fn parameters(&self) -> SVector<f64, N>;
    /// The map with these parameters.
    fn of(parameters: SVector<f64, N>) -> Self;
    /// The image of `u`.
    fn at(&self, u: &Vector2<f64>) -> Vector2<f64>;
    /// Derivative of the image of `u` by the parameters.
    fn derivative(&self, u: &Vector2<f64>) -> SMatrix<f64, 2, N>;
    /// Whether a camera could produce the map about the outline, whose points lie within the distance `reach` of the origin.
    fn is_plausible(&self, reach: f64) -> bool;
}

/// `(a x + b y + c, d x + e y + f) / (g x + h y + 1)`, parameters `a` to `h`; the homography (10.7) up to its scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Projective(pub(super) SVector<f64, 8>);

/// Greatest change of the denominator over the outline, from its middle on: depth differs by no more. Chosen by hand: the far side is then four
/// times as far as the near one; half refuses shapes near a wide lens, and from 1 on a part lies behind the camera.
const MAX_PERSPECTIVE: f64 = 0.6;

impl Warp<8> for Projective {
    fn parameters(&self) -> SVector<f64, 8> {
        self.0
    }

    fn of(parameters: SVector<f64, 8>) -> Self {
        Self(parameters)
    }

    #[inline]
    fn at(&self, u: &Vector2<f64>) -> Vector2<f64> {
        let [a, b, c, d, e, f, g, h] = self.0.data.0[0];
        let w = 1.0 / (g * u.x + h * u.y + 1.0);
        Vector2::new((a * u.x + b * u.y + c) * w, (d * u.x + e * u.y + f) * w)
    }

    fn derivative(&self, u: &Vector2<f64>) -> SMatrix<f64, 2, 8> {
        let s = self.at(u);
        let w = 1.0 / (self.0[6] * u.x + self.0[7] * u.y + 1.0);
        let (x, y) = (u.x * w, u.y * w);
        SMatrix::<f64, 2, 8>::from_row_slice(&[
            x,
            y,
            w,
            0.0,
            0.0,
            0.0,
            -s.x * x,
            -s.x * y, //
            0.0,
            0.0,
            0.0,
            x,
            y,
            w,
            -s.y * x,
            -s.y * y,
        ])
    }

    fn is_plausible(&self, reach: f64) -> bool {
        let [a, b, c, d, e, f, g, h] = self.0.data.0[0];
        // the sign of the derivative's determinant is that of the matrix's: no mirror
        let det = a * (e - f * h) - b * (d - f * g) + c * (d * h - e * g);
        g.hypot(h) * reach < MAX_PERSPECTIVE && det > 0.0 && self.0.iter().all(|p| p.is_finite())
    }
}

/// `m + S u` with symmetric S, parameters `m_x, m_y, S_xx, S_xy, S_yy`: every ellipse is the image of the unit circle by exactly one
/// such map with a positive definite S.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Oval(pub(super) SVector<f64, 5>);

impl Warp<5> for Oval {
    fn parameters(&self) -> SVector<f64, 5> {
        self.0
    }

    fn of(parameters: SVector<f64, 5>) -> Self {
        Self(parameters)
    }

    fn at(&self, u: &Vector2<f64>) -> Vector2<f64> {
        let [x, y, xx, xy, yy] = self.0.data.0[0];
        Vector2::new(x + xx * u.x + xy * u.y, y + xy * u.x + yy * u.y)
    }

    fn derivative(&self, u: &Vector2<f64>) -> SMatrix<f64, 2, 5> {
        SMatrix::<f64, 2, 5>::from_row_slice(&[1.0, 0.0, u.x, u.y, 0.0, 0.0, 1.0, 0.0, u.x, u.y])
    }

    fn is_plausible(&self, _: f64) -> bool {
        let [.., xx, xy, yy] = self.0.data.0[0];
        xx > 0.0 && xx * yy > xy * xy && self.0.iter().all(|p| p.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn differences<const N: usize, W: Warp<N>>(warp: &W, u: &Vector2<f64>) -> f64 {
        let h = 1e-6;
        let mut off = 0.0f64;
        for j in 0..N {
            let moved = |by: f64| {
                let mut p = warp.parameters();
                p[j] += by;
                W::of(p).at(u)
            };
            off = off.max(((moved(h) - moved(-h)) / (2.0 * h) - warp.derivative(u).column(j)).norm());
        }
        off
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_differences(
            p in prop::array::uniform8(-0.4..0.4f64), x in -1.0..1.0f64, y in -1.0..1.0f64
        ) {
            let u = Vector2::new(x, y);
            prop_assert!(differences(&Projective::of(SVector::from(p)), &u) < 1e-6);
            prop_assert!(differences(&Oval::of(SVector::<f64, 5>::from_column_slice(&p[..5])), &u) < 1e-6);
        }
    }

    #[test]
    fn mirrors_and_horizons_are_implausible() {
        let of = |p: [f64; 8]| Projective::of(SVector::from(p));
        assert!(of([1.0, 0.0, 3.0, 0.0, 1.0, 2.0, 0.2, 0.1]).is_plausible(1.0));
        assert!(!of([1.0, 0.0, 3.0, 0.0, -1.0, 2.0, 0.0, 0.0]).is_plausible(1.0));
        assert!(!of([1.0, 0.0, 3.0, 0.0, 1.0, 2.0, 0.9, 0.0]).is_plausible(1.0));
        assert!(!of([f64::NAN, 0.0, 3.0, 0.0, 1.0, 2.0, 0.0, 0.0]).is_plausible(1.0));
    }
}
