use super::*;
use crate::geometry::integrate_body_twist;
use crate::linalg::Random;
use crate::servo::SetPoint;
use nalgebra::{Point3, UnitQuaternion};
use proptest::prelude::*;

/// A camera somewhere on the arm, with a focal length relative to the one that is believed, before points of unknown places.
struct UnknownCell {
    X_EC: Pose,
    f: f64,
    points: [Point3<f64>; 5],
    X_WO: Pose,
}

impl UnknownCell {
    fn drawn(random: &mut Random) -> Self {
        let mut any = |most: f64| Vector3::from_fn(|_, _| random.between(-most, most));
        let rotation = UnitQuaternion::from_scaled_axis(any(1.8));
        let X_EC = Pose::from_parts(any(0.1).into(), rotation);
        let X_CO = Pose::new(any(0.05) + Vector3::new(0.0, 0.0, 0.5), any(0.4));
        let points = std::array::from_fn(|_| Point3::from(any(0.06)));
        let f = 2f64.powf(any(1.0).x);
        Self { X_EC, f, points, X_WO: X_EC * X_CO }
    }

    /// Where the points are seen, in the normalized coordinates of the believed lens, with the flange at `X_WE`.
    fn seen(&self, X_WE: &Pose) -> [Vector2<f64>; 5] {
        let X_CO = (X_WE * self.X_EC).inv_mul(&self.X_WO);
        self.points.map(|p| X_CO * p).map(|p| p.coords.xy() / p.z * self.f)
    }

    /// The derivative of point `i` by the flange's twist, by finite differences.
    fn rows(&self, i: usize, X_WE: &Pose) -> Matrix2x6<f64> {
        let h = 1e-6;
        let mut rows = Matrix2x6::zeros();
        for j in 0..6 {
            let mut V = Vector6::zeros();
            V[j] = 1.0;
            let (a, b) = (integrate_body_twist(X_WE, &V, h), integrate_body_twist(X_WE, &V, -h));
            rows.set_column(j, &((self.seen(&a)[i] - self.seen(&b)[i]) / (2.0 * h)));
        }
        rows
    }
}

fn frame(seen: [Vector2<f64>; 5], sd: f64) -> impl Iterator<Item = (usize, Vector2<f64>, f64)> + Clone {
    seen.into_iter().enumerate().map(move |(i, s)| (i, s, sd))
}

fn normal(random: &mut Random) -> f64 {
    (0..12).map(|_| random.between(-0.5, 0.5)).sum()
}

/// About a pose with the anchor held: fifty frames of a motion by some hundredths, to both sides.
fn learnt(cell: &UnknownCell, random: &mut Random, noise: f64, free: usize) -> JacobianEstimator {
    let mut estimator = JacobianEstimator::new(5);
    estimator.hold_anchor(false);
    for k in 0..50 {
        let mut xi = Vector6::from_fn(|i, _| if i < free { random.between(-0.01, 0.01) } else { 0.0 });
        if k == 0 {
            xi = Vector6::zeros();
        }
        let seen = cell.seen(&integrate_body_twist(&Pose::identity(), &xi, 1.0));
        let seen = seen.map(|s| s + Vector2::new(normal(random), normal(random)) * noise);
        assert!(estimator.observe(frame(seen, noise), &Pose::identity().mul_twist(&xi)).taken, "{k}");
    }
    estimator.release_anchor();
    estimator
}

trait MulTwist {
    fn mul_twist(self, xi: &Vector6<f64>) -> Pose;
}

impl MulTwist for Pose {
    fn mul_twist(self, xi: &Vector6<f64>) -> Pose {
        integrate_body_twist(&self, xi, 1.0)
    }
}

proptest! {
    /// Whatever camera, mount and target: what is learnt is the derivative of the image by the flange's twist.
    #[test]
    fn the_estimate_comes_to_the_image_jacobian(seed in 0u64..1_000_000) {
        let mut random = Random::new(seed);
        let cell = UnknownCell::drawn(&mut random);
        let estimator = learnt(&cell, &mut random, 4e-5, 6);
        for i in 0..5 {
            let (found, true_rows) = (estimator.rows(i).unwrap(), cell.rows(i, &Pose::identity()));
            let error = (found - true_rows).norm() / true_rows.norm();
            prop_assert!(error < 0.03, "{i}: {error}");
        }
        prop_assert!(displacement(&Pose::identity(), &Pose::identity()).norm() == 0.0);
    }

    /// The displacement is the twist that makes it in unit time.
    #[test]
    fn displacement_is_the_twist_that_makes_it(xi in prop::array::uniform6(-0.05..0.05f64)) {
        let xi = Vector6::from(xi);
        let found = displacement(&Pose::identity(), &Pose::identity().mul_twist(&xi));
        prop_assert!((found - xi).norm() < 1e-8, "{}", (found - xi).norm());
    }
}

/// In a cell where the image is linear in the motion, errors of M and innovations are as large as the covariance says.
#[test]
fn stated_covariance_is_that_of_the_errors() {
    let mut random = Random::new(7);
    let (mut of_M, mut of_innovations, mut innovations) = (0.0, 0.0, 0.0);
    let runs = 100;
    for _ in 0..runs {
        let M = Matrix2x6::from_fn(|_, _| random.between(-2.0, 2.0));
        let mut estimator = JacobianEstimator::new(1);
        estimator.hold_anchor(false);
        for k in 0..60 {
            // so small that it does not bend
            let xi =
                if k == 0 { Vector6::zeros() } else { Vector6::from_fn(|_, _| random.between(-2e-3, 2e-3)) };
            let s = M * xi + Vector2::new(normal(&mut random), normal(&mut random)) * 1e-4;
            let seen = [(0, s, 1e-4)].into_iter();
            let innovation = estimator.observe(seen, &Pose::identity().mul_twist(&xi));
            if k > 15 {
                (of_innovations, innovations) = (of_innovations + innovation.normalized, innovations + 1.0);
            }
        }
        let P = estimator.covariance(0).unwrap().try_inverse().unwrap();
        let error = estimator.rows(0).unwrap() - M;
        of_M += (error * P * error.transpose()).trace() / 12.0;
    }
    let (of_M, of_innovations) = (of_M / f64::from(runs), of_innovations / innovations);
    // chi-square of 1200 numbers: within a tenth; what is allowed for bending makes both smaller
    assert!((0.7..1.12).contains(&of_M) && (0.7..1.12).contains(&of_innovations), "{of_M} {of_innovations}");
}

#[test]
fn one_bad_frame_is_left_out_and_a_moved_target_followed() {
    let mut random = Random::new(3);
    let cell = UnknownCell::drawn(&mut random);
    let mut estimator = learnt(&cell, &mut random, 4e-5, 6);
    let at_rest = cell.seen(&Pose::identity());
    let moved = at_rest.map(|s| s + Vector2::new(0.05, -0.02));
    assert!(estimator.observe(frame(at_rest, 4e-5), &Pose::identity()).taken);
    assert!(!estimator.observe(frame(moved, 4e-5), &Pose::identity()).taken, "a leap of 40 px");
    assert!(estimator.observe(frame(at_rest, 4e-5), &Pose::identity()).taken);
    let taken = [(); 3].map(|()| estimator.observe(frame(moved, 4e-5), &Pose::identity()).taken);
    assert_eq!(taken, [false, false, true]);
    assert!((estimator.predicted(2, &Pose::identity()).unwrap() - moved[2]).norm() < 1e-3);
}

/// An arm of four joints shows four directions of the camera's motion; the law asks for no other.
#[test]
fn directions_that_were_never_seen_are_not_asked_for() {
    let mut random = Random::new(11);
    let cell = UnknownCell::drawn(&mut random);
    let estimator = learnt(&cell, &mut random, 4e-5, 4);
    let there = cell.seen(&Pose::identity().mul_twist(&Vector6::new(0.01, -0.02, 0.01, 0.02, 0.0, 0.0)));
    let goal = SetPoint::from_features(&there, &cell.points, 0.5).unwrap();
    let task = estimator.task(&goal, &Pose::identity()).unwrap();
    let xi = task.task.twist(1.0).unwrap();
    assert!(xi.fixed_rows::<2>(4).norm() < 1e-3 * xi.norm(), "{xi}");
    assert!(task.share_left(&xi) < 0.1, "{} of {xi}", task.share_left(&xi));
}
