//! Robust least squares in pixels, through the lens, with a covariance of each point.
//!
//! `sum rho(e^T C^-1 e)`, e the measured pixel minus the predicted one (5.45), C its covariance. Gauss-Newton steps on the squares
//! weighted by rho' (iteratively reweighted), damped by Levenberg and Marquardt's rule when one fails. The unknown is the
//! twist `[v; w]` of the object's centroid relative to the camera, expressed in C, as in [`super::refine`].

use super::points::{centroid, check};
use super::refine::PoseState;
use super::{PointSource, PoseError};
use crate::camera_model::CameraModel;
use crate::features::{NormalEquations, point_image_jacobian};
use crate::geometry::{Pose, skew};
use crate::linalg::{Ldlt, damping};
use nalgebra::{Matrix2, Matrix6, Point3, SMatrix, Vector2, Vector3, Vector6};

/// So that a start from which nothing converges ends.
const MAX_ITERATIONS: u32 = 100;
/// Steps (rad, and relative to the distance) below this are the last, squared: what Gauss and Newton leave after a step of 1e-8 is rounding.
const LAST_STEP_SQUARED: f64 = 1e-16;
/// Share of the loss below which a fall that a step foretells is rounding, which alone then decides whether the loss falls. Derived: a pixel of a thousand is computed to 2e-13, and beside an error
/// of half a pixel that is a share of 1e-12. Such a step is a millionth of the pose's deviation.
const ROUNDING: f64 = 1e-12;

/// A point of the object and its measured pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelCorrespondence {
    /// Position in the object frame, m.
    pub r: Point3<f64>,
    /// Its measured position in the distorted image, px.
    pub px: Vector2<f64>,
    /// Covariance of `px`, px^2.
    pub covariance_px2: Matrix2<f64>,
}

impl PointSource for PixelCorrespondence {
    fn object(&self) -> [f64; 3] {
        self.r.into()
    }
    fn image(&self) -> [f64; 2] {
        self.px.into()
    }
}

/// Loss rho of an error, by its size k in standard deviations (Mahalanobis distance of both coordinates).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// `k^2`: least squares.
    Squares,
    /// `k^2` up to the threshold, linear beyond: the influence of outliers is bounded.
    Huber(f64),
    /// `c^2 ln(1 + k^2 / c^2)`: the influence of far outliers decreases to zero.
    Cauchy(f64),
    /// Tukey's biweight: no influence beyond the threshold. Needs a start near the solution.
    Tukey(f64),
}

impl Loss {
    /// rho and its derivative at the squared size.
    #[must_use]
    pub fn at(self, k2: f64) -> (f64, f64) {
        match self {
            Self::Squares => (k2, 1.0),
            Self::Huber(c) if k2 > c * c => {
                let k = k2.sqrt();
                (c * (2.0 * k - c), c / k)
            }
            Self::Huber(_) => (k2, 1.0),
            Self::Cauchy(c) => {
                let x = k2 / (c * c);
                (c * c * x.ln_1p(), 1.0 / (1.0 + x))
            }
            Self::Tukey(c) => {
                let rest = (1.0 - k2 / (c * c)).max(0.0);
                (c * c / 3.0 * (1.0 - rest * rest * rest), rest * rest)
            }
        }
    }

    /// Whether its width is a positive number.
    pub fn is_valid(self) -> bool {
        match self {
            Self::Squares => true,
            Self::Huber(c) | Self::Cauchy(c) | Self::Tukey(c) => c > 0.0 && c.is_finite(),
        }
    }
}

/// A pose at the minimum of the loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedPixelPose {
    /// Pose of the object in the camera.
    pub X_CO: Pose,
    /// Covariance of the twist `[v; w]` of O relative to C, expressed in C (m, rad): the inverse of the weighted normal
    /// equations, in which a down-weighted point counts as one with more noise.
    pub covariance: Matrix6<f64>,
    /// Sum of `e^T C^-1 e`, without the loss: chi-square with 2 n - 6 degrees of freedom when the covariances are right and
    /// nothing is an outlier.
    pub chi_square: f64,
    /// Steps taken.
    pub iterations: u32,
}

/// The pose of least loss near `X_CO`. At least three points, not collinear.
///
/// # Errors
/// [`PoseError::TooFewPoints`], [`PoseError::NotFinite`], [`PoseError::BadGuess`] for a start, a loss or a covariance (which
/// must be positive definite) that cannot be, [`PoseError::Degenerate`], [`PoseError::BehindCamera`] at the start (beyond the
/// lens's fold too), [`PoseError::NotConverged`].
pub fn refine_pixels(
    X_CO: &Pose,
    points: &[PixelCorrespondence],
    camera: &CameraModel,
    loss: Loss,
) -> Result<RefinedPixelPose, PoseError> {
    check(points, 3)?;
    let definite = |C: &Matrix2<f64>| {
        let finite = C.iter().all(|x| x.is_finite());
        finite
            && C.m11 > 0.0
            && C.m11 * C.m22 - C.m21 * C.m12 > 0.0
            // Symmetric to far more than the noise of any covariance, and to less than its rounding.
            && (C.m12 - C.m21).abs() <= 1e-9 * C.norm()
    };
    if !loss.is_valid() || !points.iter().all(|p| definite(&p.covariance_px2)) {
        return Err(PoseError::BadGuess);
    }
    let center = centroid(points);
    let mut state = PoseState::at(X_CO, &center).ok_or(PoseError::BadGuess)?;
    let mut here =
        PixelEquations::at(&state, points, &center, camera, loss).ok_or(PoseError::BehindCamera)?;
    let mut damping = 0.0;
    for iterations in 1..=MAX_ITERATIONS {
        let matrix = here.equations.matrix();
        let diagonal = std::array::from_fn(|i| damping * matrix[(i, i)]);
        let factors = Ldlt::new(&matrix.data.0, &diagonal).ok_or(PoseError::Degenerate)?;
        let step = factors.solve(&here.equations.vector().into());
        let [vx, vy, vz, wx, wy, wz] = step;
        let depth2 = state.depth() * state.depth();
        let short = vx * vx + vy * vy + vz * vz < LAST_STEP_SQUARED * depth2
            && wx * wx + wy * wy + wz * wz < LAST_STEP_SQUARED;
        // Undamped, the step is up to 1 + damping times as long, and foretells as much more.
        let foretold = Vector6::from(step).dot(&here.equations.vector()) * (1.0 + damping);
        if foretold <= ROUNDING * here.loss {
            return here.end(&state, &center, iterations);
        }
        let candidate = state.moved(&step);
        match PixelEquations::at(&candidate, points, &center, camera, loss) {
            Some(next) if next.loss <= here.loss => {
                (state, here) = (candidate, next);
                damping = damping::eased(damping);
            }
            // At the minimum rounding alone decides whether the loss falls.
            _ if short && damping < 1.0 => {}
            _ => {
                damping = damping::raised(damping, damping::FIRST);
                continue;
            }
        }
        // A step that is damped much is short by force: it proves nothing.
        if short && damping < 1.0 || here.loss == 0.0 {
            return here.end(&state, &center, iterations);
        }
    }
    Err(PoseError::NotConverged { iterations: MAX_ITERATIONS })
}

/// Weighted normal equations at some pose.
struct PixelEquations {
    equations: NormalEquations<6>,
    loss: f64,
    chi_square: f64,
}

impl PixelEquations {
    /// `None` when some point is behind the camera or beyond the lens's fold.
    fn at(
        state: &PoseState,
        points: &[PixelCorrespondence],
        center: &[f64; 3],
        camera: &CameraModel,
        loss: Loss,
    ) -> Option<Self> {
        let mut sums = Self { equations: NormalEquations::new(), loss: 0.0, chi_square: 0.0 };
        let (R, p) = (state.rotation(), state.position());
        for point in points {
            let q = R * (point.r.coords - Vector3::from(*center));
            let r = q + p;
            let seen = camera.project(&Point3::from(r))?;
            let s = r.xy() / r.z;
            // C = [a b; b c] = L L^T; rows of L^-1 make the errors independent, of standard deviation one.
            let C = &point.covariance_px2;
            let first = 1.0 / C.m11.sqrt();
            let slope = C.m21 / C.m11;
            let second = 1.0 / (C.m22 - slope * C.m21).sqrt();
            let white = Matrix2::new(first, 0.0, -slope * second, second);
            let e = white * (point.px - seen);
            let J: SMatrix<f64, 2, 6> = white * camera.pixel_jacobian(&s) * point_image_jacobian(&s, r.z, &q);
            let k2 = e.norm_squared();
            let (rho, weight) = loss.at(k2);
            sums.loss += rho;
            sums.chi_square += k2;
            sums.equations.add_rows(&J, &e, weight);
        }
        sums.loss.is_finite().then_some(sums)
    }

    fn end(
        &self,
        state: &PoseState,
        center: &[f64; 3],
        iterations: u32,
    ) -> Result<RefinedPixelPose, PoseError> {
        let inverse = Ldlt::of(&self.equations.matrix()).ok_or(PoseError::Degenerate)?.inverse();
        // From the centroid to O: v_O = v - S(d) w with d = p_O - p_centroid.
        let mut A = Matrix6::identity();
        let d = state.rotation() * Vector3::from(*center) * -1.0;
        A.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&d));
        let covariance = A * Matrix6::from(inverse) * A.transpose();
        Ok(RefinedPixelPose {
            X_CO: state.pose(center),
            covariance: (covariance + covariance.transpose()) * 0.5,
            chi_square: self.chi_square,
            iterations,
        })
    }
}

/// Squared Mahalanobis distance of the twist that leads from `from` to `to` (of O relative to C, expressed in C).
///
/// For an estimate `from` with its covariance and the truth `to`: chi-square with six degrees of freedom where the covariance
/// is honest. `None` for a covariance that is singular.
#[must_use]
pub fn normalized_error(from: &Pose, covariance: &Matrix6<f64>, to: &Pose) -> Option<f64> {
    let w = (to.rotation * from.rotation.inverse()).scaled_axis();
    let v = to.translation.vector - from.translation.vector;
    let d = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
    let solved = Ldlt::of(covariance)?.solve(&d.into());
    Some(d.dot(&Vector6::from(solved)))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{gap, gauss};
    use super::super::{Correspondence3, pnp};
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};
    use crate::geometry::integrate_body_twist;

    /// Where the loss is large, rounding hides whether a short step makes it fall: such a minimum is one nevertheless. A far square, one of whose corners is wrong.
    #[test]
    fn a_minimum_beside_a_large_misfit_is_found() {
        let intrinsics = Intrinsics {
            fx_px: 1000.0,
            fy_px: 1000.0,
            cx_px: 500.0,
            cy_px: 500.0,
            width_px: 1001,
            height_px: 1001,
        };
        let camera = CameraModel::new(intrinsics, Distortion::default()).unwrap();
        let seen = [
            ([0.0, 0.0], [0.078344913, -0.003614975]),
            ([0.03, 0.0], [0.115867156, 0.001823007]),
            ([0.03, 0.03], [0.111428154, 0.034000438]),
            ([0.0, 0.03], [0.079291389, 0.034253266]),
        ];
        let points = seen.map(|([x, y], s)| PixelCorrespondence {
            r: Point3::new(x, y, 0.0),
            px: camera.pixel_of(&s.into()),
            covariance_px2: Matrix2::identity() * 0.25,
        });
        let spatial = points.map(|p| Correspondence3 { r: p.r, s: camera.normalized_of(&p.px) });
        let poses = pnp(&spatial).unwrap();
        assert_eq!(poses.as_slice().len(), 2);
        for pose in poses.as_slice() {
            let refined = refine_pixels(&pose.X_CO, &points, &camera, Loss::Squares).unwrap();
            // The gradient vanishes, by differences of the loss along the pose.
            let loss = |i: usize, h: f64| {
                let twist = Vector6::ith(i, h);
                let moved = integrate_body_twist(&Pose::identity(), &twist, 1.0) * refined.X_CO;
                let error = |p: &PixelCorrespondence| (camera.project(&(moved * p.r)).unwrap() - p.px) / 0.5;
                points.iter().map(|p| error(p).norm_squared()).sum::<f64>()
            };
            for i in 0..6 {
                let h = 1e-6;
                let (slope, bend) = (
                    (loss(i, h) - loss(i, -h)) / (2.0 * h),
                    (loss(i, h) + loss(i, -h) - 2.0 * loss(i, 0.0)) / (h * h),
                );
                assert!((slope / bend).abs() < 1e-6, "{i}: {slope} {bend}");
            }
        }
    }

    fn camera() -> CameraModel {
        let intrinsics = Intrinsics {
            fx_px: 800.0,
            fy_px: 790.0,
            cx_px: 325.0,
            cy_px: 235.0,
            width_px: 640,
            height_px: 480,
        };
        let lens = Distortion { k1: -0.2, k2: 0.05, p1: 1e-3, p2: -5e-4, k3: 0.0 };
        CameraModel::new(intrinsics, lens).unwrap()
    }

    fn truth() -> Pose {
        Pose::new([0.05, -0.03, 0.6].into(), [0.4, -0.3, 0.7].into())
    }

    /// A grid of 5 x 5 with a bump; each point with a covariance of its own, in proportion to `sd_px` squared.
    fn scene(sd_px: f64, noise: &mut impl FnMut() -> f64) -> Vec<PixelCorrespondence> {
        let one = |i: usize| {
            let (x, y) = (i % 5, i / 5);
            let r = Point3::new(0.05 * x as f64 - 0.1, 0.05 * y as f64 - 0.1, 0.03 * ((x * y) % 3) as f64);
            let (long, short, angle) = (2.0 + (i % 3) as f64, 0.5, i as f64);
            let turn = nalgebra::Rotation2::new(angle);
            let axes = turn.matrix() * Matrix2::new(long, 0.0, 0.0, short) * sd_px;
            let px = camera().project(&(truth() * r)).unwrap() + axes * Vector2::new(noise(), noise());
            PixelCorrespondence { r, px, covariance_px2: axes * axes.transpose() }
        };
        (0..25).map(one).collect()
    }

    fn guess() -> Pose {
        truth() * Pose::new([0.01, -0.02, 0.015].into(), [0.03, -0.02, 0.05].into())
    }

    #[test]
    fn the_truth_comes_back_through_the_lens() {
        let exact: Vec<_> = scene(0.0, &mut || 0.0)
            .into_iter()
            .map(|p| PixelCorrespondence { covariance_px2: Matrix2::identity(), ..p })
            .collect();
        for loss in [Loss::Squares, Loss::Huber(2.0), Loss::Cauchy(2.0)] {
            let end = refine_pixels(&guess(), &exact, &camera(), loss).unwrap();
            assert!(gap(&end.X_CO, &truth()) < 1e-9 && end.chi_square < 1e-12, "{loss:?} {end:?}");
        }
        let near = truth() * Pose::new([1e-4, 0.0, 0.0].into(), [0.0, 1e-4, 0.0].into());
        let end = refine_pixels(&near, &exact, &camera(), Loss::Tukey(5.0)).unwrap();
        assert!(gap(&end.X_CO, &truth()) < 1e-9);
    }

    #[test]
    fn covariances_are_honest() {
        let mut noise = gauss(3);
        let count = 1000;
        let (mut errors, mut chi, mut robust) = (0.0, 0.0, 0.0);
        for _ in 0..count {
            let points = scene(0.5, &mut noise);
            let end = refine_pixels(&truth(), &points, &camera(), Loss::Squares).unwrap();
            errors += normalized_error(&end.X_CO, &end.covariance, &truth()).unwrap() / f64::from(count);
            chi += end.chi_square / f64::from(count);
            let end = refine_pixels(&truth(), &points, &camera(), Loss::Huber(2.5)).unwrap();
            robust += normalized_error(&end.X_CO, &end.covariance, &truth()).unwrap() / f64::from(count);
        }
        // Means of chi-square with 6 and with 44 degrees of freedom: standard errors 0.11 and 0.3.
        assert!((errors - 6.0).abs() < 0.4, "{errors}");
        assert!((chi - 44.0).abs() < 1.0, "{chi}");
        assert!(robust < 6.4 && robust > 4.5, "{robust}");
    }

    #[test]
    fn outliers_do_not_pull_a_robust_loss() {
        let mut noise = gauss(5);
        let mut points = scene(0.1, &mut noise);
        for i in [3, 11, 20] {
            points[i].px += Vector2::new(15.0, -25.0);
        }
        let off = |loss| gap(&refine_pixels(&guess(), &points, &camera(), loss).unwrap().X_CO, &truth());
        let clean: Vec<_> = scene(0.1, &mut gauss(5));
        let best = gap(&refine_pixels(&guess(), &clean, &camera(), Loss::Squares).unwrap().X_CO, &truth());
        let (squares, huber, cauchy) = (off(Loss::Squares), off(Loss::Huber(2.0)), off(Loss::Cauchy(2.0)));
        assert!(
            squares > 10.0 * best && huber < 0.2 * squares && cauchy < 2.0 * best,
            "{best} {squares} {huber} {cauchy}"
        );
        let start = refine_pixels(&guess(), &points, &camera(), Loss::Cauchy(2.0)).unwrap().X_CO;
        let end = refine_pixels(&start, &points, &camera(), Loss::Tukey(6.0)).unwrap();
        assert!(gap(&end.X_CO, &truth()) < 3.0 * best);
    }

    #[test]
    fn bad_input_is_refused() {
        let points = scene(0.5, &mut || 0.0);
        let run = |X: &Pose, points: &[PixelCorrespondence], loss| {
            refine_pixels(X, points, &camera(), loss).map(|_| ())
        };
        assert_eq!(
            run(&truth(), &points[..2], Loss::Squares),
            Err(PoseError::TooFewPoints { needed: 3, given: 2 })
        );
        assert_eq!(run(&truth(), &points, Loss::Huber(0.0)), Err(PoseError::BadGuess));
        let behind = Pose::translation(0.0, 0.0, -1.0);
        assert_eq!(run(&behind, &points, Loss::Squares), Err(PoseError::BehindCamera));
        assert_eq!(
            run(&Pose::translation(f64::NAN, 0.0, 1.0), &points, Loss::Squares),
            Err(PoseError::BadGuess)
        );
        let mut bad = points.clone();
        bad[1].covariance_px2 = Matrix2::new(1.0, 2.0, 2.0, 1.0);
        assert_eq!(run(&truth(), &bad, Loss::Squares), Err(PoseError::BadGuess));
        bad[1].px.x = f64::NAN;
        assert_eq!(run(&truth(), &bad, Loss::Squares), Err(PoseError::NotFinite { index: 1 }));
    }
}
