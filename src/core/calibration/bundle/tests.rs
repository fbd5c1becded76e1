//! The bordered equations against their definition.

use super::equations::BundleSums;
use super::*;
use crate::camera_model::{Distortion, Intrinsics, LensModel};
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::pose::Loss;
use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};

/// Two cameras, three views, a bent board, corners with covariances, no noise.
fn rig() -> (BundleProblem, BundleState) {
    let mut random = Random::new(4);
    let optics = |f: f64| Optics {
        intrinsics: Intrinsics {
            fx_px: f,
            fy_px: f + 9.0,
            cx_px: 300.0,
            cy_px: 250.0,
            width_px: 640,
            height_px: 480,
        },
        lens: Distortion { k1: -0.2, k2: 0.05, p1: 1e-3, p2: 2e-3, k3: 0.01 }.into(),
    };
    let state = BundleState {
        optics: vec![optics(600.0), optics(640.0)],
        X_j0: vec![Pose::from_parts(
            Vector3::new(-0.1, 0.01, 0.02).into(),
            UnitQuaternion::from_scaled_axis(Vector3::new(0.02, 0.1, -0.03)),
        )],
        warp_m: Vector2::new(2e-3, -1e-3),
        poses: (0..3)
            .map(|_| {
                let mut any = |s: f64| {
                    Vector3::new(random.between(-s, s), random.between(-s, s), random.between(-s, s))
                };
                let p = any(0.1) + Vector3::z() * 0.8;
                Pose::from_parts(p.into(), UnitQuaternion::from_scaled_axis(any(0.6)))
            })
            .collect(),
    };
    let point = |i: usize| BundlePoint {
        r: Vector3::new((i % 5) as f64 * 0.05 - 0.1, (i / 5) as f64 * 0.05 - 0.1, 0.0),
        lift: Vector2::new(
            1.0 - ((i % 5) as f64 - 2.0).powi(2) / 4.0,
            1.0 - ((i / 5) as f64 - 2.0).powi(2) / 4.0,
        ),
        px: Vector2::zeros(),
        whitening: Matrix2::new(2.0, 0.0, 0.3, 1.5),
    };
    let freedom = Freedom::of(LensModel::PlumbBob);
    let mut problem = BundleProblem {
        freedom: vec![freedom, Freedom { fixed_aspect: true, ..freedom.without(LensModel::PlumbBob, "k3") }],
        warp: true,
        views: (0..3)
            .map(|_| {
                (0..2)
                    .map(|camera| BoardObservation { camera, points: (0..25).map(point).collect() })
                    .collect()
            })
            .collect(),
    };
    for (i, view) in problem.views.iter_mut().enumerate() {
        for observation in view {
            for p in &mut observation.points {
                p.px = state.image(observation.camera, i, p).unwrap().px;
            }
        }
    }
    (problem, state)
}

fn step(problem: &BundleProblem, random: &mut Random, size: f64) -> (Vec<f64>, Vec<[f64; 6]>) {
    let shared = (0..problem.shared())
        .map(|i| {
            // pixels move by about the same
            let of_camera = |j: usize| i.checked_sub(problem.optics_from(j)).is_some_and(|k| k < 4 - j);
            size * random.gaussian() * if of_camera(0) || of_camera(1) { 100.0 } else { 1.0 }
        })
        .collect();
    let poses = (0..3).map(|_| [(); 6].map(|()| size * random.gaussian())).collect();
    (shared, poses)
}

/// The loss along any step is the quadratic of the equations: this checks every block at once.
#[test]
fn equations_are_the_quadratic_of_the_loss() {
    let (problem, state) = rig();
    assert_eq!(problem.shared(), 9 + 7 + 6 + 2);
    let sums = BundleSums::at(&problem, &state, Loss::Squares).unwrap();
    assert!(sums.chi_square < 1e-18);
    let mut random = Random::new(9);
    for _ in 0..50 {
        let (shared, poses) = step(&problem, &mut random, 1e-6);
        let moved = problem.moved(&state, &shared, &poses);
        let there = BundleSums::at(&problem, &moved, Loss::Squares).unwrap();
        // the Gauss-Newton step back is the step that was taken
        let back = there.step(0.0).unwrap();
        let off = shared
            .iter()
            .zip(&back.shared)
            .map(|(a, b)| (a + b).abs() / (1e-6 + a.abs()))
            .fold(0.0, f64::max);
        assert!(off < 0.1, "{off}");
        // half of what the step promises is all of the loss
        assert!(
            (back.promise / there.chi_square - 1.0).abs() < 1e-3,
            "{} {}",
            back.promise,
            there.chi_square
        );
        let again = problem.moved(&moved, &back.shared, &back.poses);
        let end = BundleSums::at(&problem, &again, Loss::Squares).unwrap();
        assert!(end.chi_square < 1e-6 * there.chi_square);
    }
}

#[test]
fn refinement_comes_back_and_tells_what_cannot_be_told() {
    let (problem, state) = rig();
    let (shared, poses) = step(&problem, &mut Random::new(1), 0.01);
    let end = adjust(&problem, problem.moved(&state, &shared, &poses), Loss::Squares).unwrap();
    assert!(end.sums.chi_square < 1e-12, "{}", end.sums.chi_square);
    assert!((end.state.X_j0[0].translation.vector - state.X_j0[0].translation.vector).norm() < 1e-6);
    assert!((end.state.warp_m - state.warp_m).norm() < 1e-6);
    // one view of the second camera alone does not tell its lens
    let mut poor = problem.clone();
    for view in &mut poor.views {
        view.retain(|s| s.camera == 0);
    }
    assert!(matches!(adjust(&poor, state.clone(), Loss::Squares), Err(BundleFailure::Degenerate)));
    // behind the camera
    let mut behind = state;
    behind.poses[0].translation.z = -1.0;
    assert!(matches!(adjust(&problem, behind, Loss::Squares), Err(BundleFailure::BadStart)));
}
