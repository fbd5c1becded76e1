//! The general pose solver against the maximum-likelihood floor: a refinement that starts at the truth.
//!
//! 1000 random scenes a cell, VGA, f = 800 px. A cell is a number of points and an image noise.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers beside the tests
#![allow(non_snake_case)] // X as in the text

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use vservo::geometry::Pose;
use vservo::linalg::Random;
use vservo::pose::{Correspondence3, RefinedPose, normalized_error, pnp, refine_3d};

const FOCAL_PX: f64 = 800.0;
const TRIALS: usize = 1000;

#[derive(Clone, Copy, PartialEq)]
enum Object {
    /// Side 0.1 m.
    Square,
    Cloud(usize),
}

/// A scene with the whole object in the image, and its image without noise.
fn scene(object: Object, random: &mut Random) -> (Pose, Vec<Correspondence3>) {
    loop {
        let mut vector = |size: f64| Vector3::from([(); 3].map(|()| random.between(-size, size)));
        let points: Vec<_> = match object {
            Object::Square => [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]
                .map(|[x, y]| Point3::new(x, y, 0.0))
                .to_vec(),
            Object::Cloud(n) => (0..n).map(|_| Point3::from(vector(0.1))).collect(),
        };
        let w = vector(1.0);
        let X = match object {
            // Up to 70 degrees from facing the camera, turned about its normal by anything.
            Object::Square => {
                let (azimuth, tilt) = (random.between(-3.2, 3.2), random.between(0.0, 1.22));
                let tilted =
                    UnitQuaternion::from_scaled_axis(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt);
                let p = Vector3::new(
                    random.between(-0.2, 0.2),
                    random.between(-0.15, 0.15),
                    random.between(0.3, 0.7),
                );
                Pose::from_parts(
                    p.into(),
                    tilted * UnitQuaternion::from_scaled_axis(Vector3::z() * random.between(-3.2, 3.2)),
                )
            }
            Object::Cloud(_) => {
                let p = Vector3::new(
                    random.between(-0.2, 0.2),
                    random.between(-0.15, 0.15),
                    random.between(0.4, 1.2),
                );
                Pose::from_parts(
                    p.into(),
                    UnitQuaternion::from_scaled_axis(w.normalize() * random.between(0.0, 3.1)),
                )
            }
        };
        let seen = points.iter().map(|r| {
            let p = X * r;
            Correspondence3 { r: *r, s: Vector2::new(p.x / p.z, p.y / p.z) }
        });
        let seen: Vec<_> = seen.collect();
        let inside = |c: &Correspondence3| c.s.x.abs() * FOCAL_PX < 320.0 && c.s.y.abs() * FOCAL_PX < 240.0;
        // Clouds that are nearly a line or, of four, nearly a plane are other problems.
        if seen.iter().all(inside) {
            return (X, seen);
        }
    }
}

fn errors(found: &Pose, truth: &Pose) -> (f64, f64) {
    (found.rotation.angle_to(&truth.rotation), (found.translation.vector - truth.translation.vector).norm())
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Ratios of the median errors to the floor's, and counts.
struct Cell {
    rotation: f64,
    position: f64,
    failures: usize,
    /// The first solution is not the one that a refinement from the truth finds.
    other_branch: usize,
    /// That one is not among the solutions.
    missing: usize,
}

fn cell(object: Object, noise_px: f64) -> Cell {
    let mut random = Random::new(17 + (noise_px * 8.0) as u64);
    let sigma = noise_px / FOCAL_PX;
    let mut all: [Vec<f64>; 4] = Default::default();
    let (mut failures, mut other_branch, mut missing) = (0, 0, 0);
    for _ in 0..TRIALS {
        let (X, mut points) = scene(object, &mut random);
        for point in &mut points {
            point.s += Vector2::new(random.gaussian(), random.gaussian()) * sigma;
        }
        // The floor does not exist where noise has taken its minimum away.
        let Ok(RefinedPose { X_CO: floor, .. }) = refine_3d(&X, &points, sigma) else { continue };
        let Ok(found) = pnp(&points) else {
            failures += 1;
            continue;
        };
        let same = |a: &Pose| errors(a, &floor).0 < 1e-3;
        other_branch += usize::from(!same(&found.best().X_CO));
        missing += usize::from(!found.as_slice().iter().any(|s| same(&s.X_CO)));
        let (r, p) = errors(&found.best().X_CO, &X);
        let (fr, fp) = errors(&floor, &X);
        for (values, value) in all.iter_mut().zip([r, p, fr, fp]) {
            values.push(value);
        }
    }
    let [r, p, fr, fp] = all.each_mut().map(|values| median(values));
    let ratio = |a: f64, b: f64| if b < 1e-9 && a < 1e-9 { 1.0 } else { a / b };
    Cell { rotation: ratio(r, fr), position: ratio(p, fp), failures, other_branch, missing }
}

#[test]
fn median_errors_are_at_the_floor() {
    let objects = [4, 6, 8, 16, 64].map(Object::Cloud);
    for (name, object) in
        ["4", "6", "8", "16", "64", "square"].iter().zip(objects.iter().chain(&[Object::Square]))
    {
        for noise_px in [0.0, 0.1, 0.5, 1.0, 2.0] {
            let cell = cell(*object, noise_px);
            println!(
                "{name:>6} points, {noise_px} px: rotation {:.4}, position {:.4} of the floor; {} failures, {} other branch, {} missing",
                cell.rotation, cell.position, cell.failures, cell.other_branch, cell.missing
            );
            assert!(cell.failures == 0);
            if *object == Object::Square {
                assert!(cell.missing == 0 && cell.other_branch <= TRIALS / 20);
            }
            assert!(cell.rotation < 1.02 && cell.position < 1.02);
        }
    }
}

#[test]
fn covariances_are_honest() {
    for (object, noise_px) in
        [(Object::Square, 0.1), (Object::Cloud(6), 0.5), (Object::Cloud(16), 1.0), (Object::Cloud(64), 2.0)]
    {
        let mut random = Random::new(5);
        let sigma = noise_px / FOCAL_PX;
        let mut normalized = Vec::new();
        for _ in 0..TRIALS {
            let (X, mut points) = scene(object, &mut random);
            for point in &mut points {
                point.s += Vector2::new(random.gaussian(), random.gaussian()) * sigma;
            }
            let best = pnp(&points).unwrap().nearest(&X);
            let end = refine_3d(&best.X_CO, &points, sigma).unwrap();
            normalized.push(normalized_error(&end.X_CO, &end.covariance, &X).unwrap());
        }
        let mean = normalized.iter().sum::<f64>() / TRIALS as f64;
        let within = normalized.iter().filter(|x| **x < 12.592).count(); // 95 % of chi-square with six degrees
        let middle = median(&mut normalized);
        println!("{noise_px} px: mean {mean:.2}, median {middle:.2}, {within} within 95 %");
        assert!((5.0..7.2).contains(&mean) && (930..970).contains(&within), "{mean} {within}");
        assert!((5.0..5.8).contains(&middle), "{middle}");
    }
}
