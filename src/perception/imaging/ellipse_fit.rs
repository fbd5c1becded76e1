//! Ellipses through edge points: the direct least squares fit, and its refinement with covariance.
//!
//! Direct (Fitzgibbon, Pilu, Fisher 1999, in the numerically stable form of Halir and Flusser 1998): the conic
//! `a x^2 + b x y + c y^2 + d x + e y + f = 0` of least algebraic error with `4 a c - b^2 = 1`; always an ellipse, a little too small
//! on short arcs. Refinement: distances to the conic over their deviations, reweighted until they stand, with points far off left
//! out. Parameters are the centre and the matrix `S = [xx, xy, yy]` of `(x - centre)^T S^-1 (x - centre) = 1`, which has no
//! preferred axes: a circle is as good as any ellipse.

use super::{EdgePoint, Ellipse};
use crate::linalg::{Ldlt, Random, symmetric_eigen};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Residual, in standard deviations, above which a point is left out. Chosen by hand: by noise alone one point in 16 000 lies beyond 4.
const CUT: f64 = 4.0;
/// Most reweighted solutions. Chosen by hand: a bound; they converge earlier.
const ROUNDS: usize = 12;

/// Points of one attempt of [`Ellipse::fit`], attempts (derived: with a third of the points wrong, `(2/3)^6` = 9 % are free of them), and points that
/// judge one.
const SAMPLE: usize = 6;
const SAMPLES: usize = 100;
const JUDGES: usize = 64;

/// An ellipse with what it was fitted to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseFit {
    /// The ellipse.
    pub ellipse: Ellipse,
    /// Covariance of centre x, y (px) and of `xx`, `xy`, `yy` of the shape (px^2).
    pub covariance: SMatrix<f64, 5, 5>,
    /// Squared residuals over their variances, per degree of freedom: 1 when these are stated correctly.
    pub chi2: f64,
    /// Number of points that were used.
    pub used: usize,
}

impl EllipseFit {
    /// Covariance of the centre, px^2.
    #[must_use]
    pub fn centre_covariance_px2(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }
}

impl Ellipse {
    /// Direct least squares fit of at least five points; their deviations do not enter. `None` where they determine no ellipse.
    #[must_use]
    pub fn fit_direct(points: &[EdgePoint]) -> Option<Self> {
        let (middle, scale) = frame(points)?;
        let (mut quadratic, mut mixed, mut linear) = (Matrix3::zeros(), Matrix3::zeros(), Matrix3::zeros());
        for p in points {
            let q = (p.px - middle) / scale;
            let (u, v) = (Vector3::new(q.x * q.x, q.x * q.y, q.y * q.y), Vector3::new(q.x, q.y, 1.0));
            quadratic += u * u.transpose();
            mixed += u * v.transpose();
            linear += v * v.transpose();
        }
        let back = linear.try_inverse()? * mixed.transpose() * -1.0;
        // scatter of the quadratic part alone; a touch more, so that points without any error are no singular case
        let mut M = quadratic + mixed * back;
        M = (M + M.transpose()) * 0.5;
        M += Matrix3::identity() * (1e-13 * quadratic.trace());
        // M a = l C a with C of 4 a c - b^2, as the symmetric problem L^-1 C L^-T w = w / l
        let L_inverse = nalgebra::Cholesky::new(M)?.l().try_inverse()?;
        let C = Matrix3::new(0.0, 0.0, 2.0, 0.0, -1.0, 0.0, 2.0, 0.0, 0.0);
        let (values, vectors) = symmetric_eigen(&(L_inverse * C * L_inverse.transpose()))?;
        if !(values[0] > 0.0) {
            return None;
        }
        let a = L_inverse.transpose() * vectors.column(0);
        let b = back * a;
        // a x^2 + b x y + c y^2 + d x + e y + f
        Self::of_conic(&[a[0], 0.5 * a[1], a[2], 0.5 * b[0], 0.5 * b[1], b[2]])?.placed(&middle, scale)
    }

    /// The ellipse that most of the points lie on, with up to a third of them anywhere: the direct fit of all, or where that does not
    /// go with their deviations of few at a time, and its refinement. `None` as for these.
    #[must_use]
    pub fn fit(points: &[EdgePoint]) -> Option<EllipseFit> {
        let misfit = |e: &Self, points: &[EdgePoint]| {
            super::robust::spread(points, |p| e.distance_px(&p.px) / p.sd_px)
        };
        let mut start = Self::fit_direct(points).map(|e| (misfit(&e, points), e));
        // chosen by hand: honest deviations give 1, and one point in three that is elsewhere far more
        if !start.is_some_and(|(misfit, _)| misfit < 3.0) {
            let mut random = Random::new(points.len() as u64);
            let none = EdgePoint { px: Vector2::zeros(), sd_px: 1.0 };
            let mut judges = [none; JUDGES];
            let step = points.len().div_ceil(JUDGES).max(1);
            let count = judges.iter_mut().zip(points.iter().step_by(step)).map(|(j, p)| *j = *p).count();
            let judges = judges.get(..count)?;
            start = None;
            for _ in 0..SAMPLES {
                let mut sample = [none; SAMPLE];
                for s in &mut sample {
                    *s = *points.get((random.bits() % points.len().max(1) as u64) as usize)?;
                }
                let Some(e) = Self::fit_direct(&sample) else { continue };
                let m = misfit(&e, judges);
                if start.is_none_or(|(best, _)| m < best) {
                    start = Some((m, e));
                }
            }
        }
        start?.1.refine(points)
    }

    /// Of `A x^2 + 2 B x y + C y^2 + 2 D x + 2 E y + F = 0`.
    pub(super) fn of_conic(&[a, b, c, d, e, f]: &[f64; 6]) -> Option<Self> {
        let Q = Matrix2::new(a, b, b, c);
        let inverse = Q.try_inverse()?;
        let linear = Vector2::new(d, e);
        let centre_px = -(inverse * linear);
        let k = -f - linear.dot(&centre_px);
        let S = inverse * k;
        let ellipse = Self { centre_px, shape_px2: [S[(0, 0)], S[(0, 1)], S[(1, 1)]] };
        ellipse.is_real().then_some(ellipse)
    }

    /// From the frame in which it was fitted to pixels.
    fn placed(&self, middle: &Vector2<f64>, scale: f64) -> Option<Self> {
        let ellipse = Self {
            centre_px: self.centre_px * scale + middle,
            shape_px2: self.shape_px2.map(|s| s * scale * scale),
        };
        ellipse.is_real().then_some(ellipse)
    }

    /// The ellipse of least squared distances over their variances, near `self`; points off by more than 4 deviations, or by more
    /// than the robust spread of all tells, are left out. `None` where fewer than six are left, or they determine no ellipse.
    #[must_use]
    pub fn refine(&self, points: &[EdgePoint]) -> Option<EllipseFit> {
        let (middle, scale) = (self.centre_px, self.axes_px().0);
        if !self.is_real() {
            return None;
        }
        let mut ellipse =
            Self { centre_px: Vector2::zeros(), shape_px2: self.shape_px2.map(|s| s / (scale * scale)) };
        let local = |p: &EdgePoint| (p.px - middle) / scale;
        let mut last = None;
        for round in 0..ROUNDS {
            // those at the start may be far off: the robust spread lets them in
            let spread = super::robust::spread(points, |p| ellipse.distance_px(&local(p)) * scale / p.sd_px);
            let (mut N, mut r) = (SMatrix::<f64, 5, 5>::zeros(), SVector::<f64, 5>::zeros());
            let (mut chi2, mut used) = (0.0, 0);
            for p in points {
                let q = local(p);
                let g = ellipse.gradient(&(q - ellipse.centre_px)).norm();
                let sd = p.sd_px / scale;
                let distance = ellipse.distance_px(&q) / sd;
                // what is not less is not a number either
                if !(distance.abs() < CUT * spread) {
                    continue;
                }
                // F = phi . theta - 1 over its gradient is the distance
                let w = (g * sd).powi(-2);
                let phi = SVector::<f64, 5>::new(q.x * q.x, 2.0 * q.x * q.y, q.y * q.y, 2.0 * q.x, 2.0 * q.y);
                N += phi * phi.transpose() * w;
                r += phi * w;
                chi2 += distance * distance;
                used += 1;
            }
            if used < 6 {
                return None;
            }
            let factors = Ldlt::of(&N)?;
            let theta = SVector::<f64, 5>::from(factors.solve(&r.into()));
            let next = Self::of_conic(&[theta[0], theta[1], theta[2], theta[3], theta[4], -1.0])?;
            let moved = (next.centre_px - ellipse.centre_px).norm()
                + next.shape_px2.iter().zip(&ellipse.shape_px2).map(|(a, b)| (a - b).abs()).sum::<f64>();
            // weights were those of gradients that belong to the conic before, whose scale is another
            ellipse = next;
            last = Some((theta, used, chi2));
            // in units of the points' extent: a few digits above rounding
            if moved < 1e-10 && round > 1 {
                break;
            }
        }
        let (theta, used, chi2) = last?;
        let chi2 = chi2 / (used - 5) as f64;
        let mut fit = EllipseFit { ellipse, covariance: SMatrix::zeros(), chi2, used };
        fit.covariance =
            self.covariance_of(points, &fit, &theta, middle, scale)? * super::robust::growth(chi2, used - 5);
        fit.ellipse = fit.ellipse.placed(&middle, scale)?;
        Some(fit)
    }

    /// Covariance of centre and shape, in px, from the normal equations of the conic `theta` in the local frame.
    fn covariance_of(
        &self,
        points: &[EdgePoint],
        fit: &EllipseFit,
        theta: &SVector<f64, 5>,
        middle: Vector2<f64>,
        scale: f64,
    ) -> Option<SMatrix<f64, 5, 5>> {
        let parameters = |theta: &SVector<f64, 5>| {
            let e = Self::of_conic(&[theta[0], theta[1], theta[2], theta[3], theta[4], -1.0])?;
            let [xx, xy, yy] = e.shape_px2;
            Some(SVector::<f64, 5>::new(e.centre_px.x, e.centre_px.y, xx, xy, yy))
        };
        // dF / dtheta over |dF / dx| of the conic itself: F = phi . theta - 1
        let [a, b, c, d, e] = (*theta).into();
        let mut N = SMatrix::<f64, 5, 5>::zeros();
        for p in points {
            let q = (p.px - middle) / scale;
            let sd = p.sd_px / scale;
            let g = Vector2::new(a * q.x + b * q.y + d, b * q.x + c * q.y + e) * 2.0;
            if fit.ellipse.distance_px(&q).abs() < CUT * sd * fit.chi2.max(1.0).sqrt() {
                let phi = SVector::<f64, 5>::new(q.x * q.x, 2.0 * q.x * q.y, q.y * q.y, 2.0 * q.x, 2.0 * q.y);
                N += phi * phi.transpose() / (g.norm() * sd).powi(2);
            }
        }
        let inverse = SMatrix::<f64, 5, 5>::from(Ldlt::of(&N)?.inverse());
        let mut J = SMatrix::<f64, 5, 5>::zeros();
        for k in 0..5 {
            let mut step = SVector::<f64, 5>::zeros();
            step[k] = 1e-6;
            let column = (parameters(&(theta + step))? - parameters(&(theta - step))?) / 2e-6;
            J.set_column(k, &column);
        }
        let unit = SVector::<f64, 5>::new(scale, scale, scale * scale, scale * scale, scale * scale);
        let J = SMatrix::<f64, 5, 5>::from_diagonal(&unit) * J;
        Some(J * inverse * J.transpose())
    }
}

/// Middle of the points and their spread, px.
fn frame(points: &[EdgePoint]) -> Option<(Vector2<f64>, f64)> {
    let n = points.len() as f64;
    let middle = points.iter().map(|p| p.px).sum::<Vector2<f64>>() / n;
    let scale = (points.iter().map(|p| (p.px - middle).norm_squared()).sum::<f64>() / n).sqrt();
    (points.len() >= 5 && scale > 0.0 && scale.is_finite()).then_some((middle, scale))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(
        random: &mut Random,
        e: &Ellipse,
        count: usize,
        sd_px: f64,
        arc: f64,
        wrong: usize,
    ) -> Vec<EdgePoint> {
        (0..count)
            .map(|i| {
                let (p, n) = e.rim(1.0 + arc * i as f64 / count as f64);
                let off = if i < wrong { random.between(1.0, 4.0) } else { sd_px * random.gaussian() };
                EdgePoint { px: p + n * off, sd_px: sd_px.max(1e-6) }
            })
            .collect()
    }

    proptest! {
        #[test]
        fn exact_points_give_the_ellipse(
            x in -50.0..900.0f64, y in -50.0..900.0f64, a in 2.0..400.0f64, ratio in 0.1..1.0f64, angle in -3.0..3.0f64,
            arc in 3.0..6.2f64,
        ) {
            let truth = Ellipse::new(Vector2::new(x, y), a, a * ratio, angle);
            let points = points(&mut Random::new(1), &truth, 40, 0.0, arc, 0);
            let direct = Ellipse::fit_direct(&points).unwrap();
            let close = |e: &Ellipse, tolerance: f64| (e.centre_px - truth.centre_px).norm() < tolerance * a
                && e.shape_px2.iter().zip(&truth.shape_px2).all(|(p, q)| (p - q).abs() < tolerance * a * a);
            prop_assert!(close(&direct, 1e-4), "{:?}", direct);
            let fit = direct.refine(&points).unwrap();
            prop_assert!(close(&fit.ellipse, 1e-6), "{:?}", fit.ellipse);
            prop_assert!((truth.axes_px().0 - a).abs() < 1e-9 * a && truth.distance_px(&points[3].px).abs() < 1e-9 * a);
            for row in [false, true] {
                let line = if row { y } else { x } + 0.3 * a * ratio;
                for at in truth.crossings(line, row).unwrap() {
                    let p = if row { Vector2::new(at, line) } else { Vector2::new(line, at) };
                    prop_assert!(truth.distance_px(&p).abs() < 1e-9 * a);
                }
            }
        }

        #[test]
        fn any_points_are_taken(p in prop::collection::vec((-9.0..9.0f64, -9.0..9.0f64), 0..12), same in any::<bool>()) {
            let points: Vec<_> = p.iter().map(|&(x, y)| EdgePoint { px: Vector2::new(x, if same { x } else { y }), sd_px: 0.1 }).collect();
            if let Some(e) = Ellipse::fit_direct(&points) {
                prop_assert!(e.is_real());
                if let Some(fit) = e.refine(&points) {
                    prop_assert!(fit.ellipse.is_real() && fit.covariance.iter().all(|c| c.is_finite()));
                }
            }
        }
    }

    #[test]
    fn covariance_is_what_errors_show() {
        let mut random = Random::new(3);
        for (arc, wrong) in [(6.2, 0), (3.5, 0), (6.2, 12)] {
            let (mut centre, mut all) = (0.0, 0.0);
            let n = 1000;
            for _ in 0..n {
                let a = random.between(8.0, 60.0);
                let truth = Ellipse::new(
                    Vector2::new(random.between(0.0, 600.0), random.between(0.0, 400.0)),
                    a,
                    a * random.between(0.4, 1.0),
                    random.between(0.0, 3.0),
                );
                let points = points(&mut random, &truth, 60, 0.04, arc, wrong);
                let fit = Ellipse::fit(&points).unwrap();
                let e = SVector::<f64, 5>::from_fn(|i, _| match i {
                    0 | 1 => fit.ellipse.centre_px[i] - truth.centre_px[i],
                    _ => fit.ellipse.shape_px2[i - 2] - truth.shape_px2[i - 2],
                });
                let c = e.fixed_rows::<2>(0).into_owned();
                centre += (c.transpose() * fit.centre_covariance_px2().try_inverse().unwrap() * c)[0]
                    / 2.0
                    / f64::from(n);
                all += (e.transpose() * fit.covariance.try_inverse().unwrap() * e)[0] / 5.0 / f64::from(n);
            }
            assert!(
                (0.8..1.25).contains(&centre) && (0.8..1.25).contains(&all),
                "{arc} {wrong} {centre} {all}"
            );
        }
    }
}
