use super::super::testing::{SQUARE, gap, gauss, grid, poses, see, see_3d, tilted};
use super::super::{refine_3d, reprojection_rms};
use super::*;
use crate::geometry::Twist;
use crate::linalg::Portable;
use nalgebra::{Isometry3, Vector6};
use proptest::prelude::*;

/// The pose moved by the twist `[v; w]` of O relative to C, expressed in C.
fn moved(X_CO: &Pose, d: &Twist) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(d.fixed_rows::<3>(3).into_owned());
    Isometry3::from_parts((X_CO.translation.vector + d.fixed_rows::<3>(0)).into(), turn * X_CO.rotation)
}

/// The twist that [`moved`] undoes.
fn between(from: &Pose, to: &Pose) -> Twist {
    let w = (to.rotation * from.rotation.inverse()).scaled_axis();
    let v = to.translation.vector - from.translation.vector;
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

fn cube() -> Vec<[f64; 3]> {
    let at = |bit: usize| if bit == 0 { 0.0 } else { 0.1 };
    (0..8).map(|i| [at(i & 1), at(i & 2), at(i & 4)]).collect()
}

proptest! {
    #[test]
    fn near_guesses_reach_the_truth(X in poses(1.2), d in prop::array::uniform6(-0.02..0.02f64), n in 2..6_usize) {
        let guess = moved(&X, &Vector6::from(d));
        // Beside a frontal view lies the mirrored tilt, whose minimum may be nearer: planar points need some tilt.
        let cosine = (X.rotation * Vector3::z()).dot(&X.translation.vector.normalize());
        if cosine.abs() < 0.95 {
            let planar = refine(&guess, &see(&X, &grid(n), || 0.0), 1e-4).unwrap();
            prop_assert!(gap(&planar.X_CO, &X) < 1e-9, "{}", gap(&planar.X_CO, &X));
        }
        let spatial = refine_3d(&guess, &see_3d(&X, &cube(), || 0.0), 1e-4).unwrap();
        prop_assert!(gap(&spatial.X_CO, &X) < 1e-9, "{}", gap(&spatial.X_CO, &X));
        prop_assert!(spatial.rms < 1e-12 && spatial.iterations < 12);
    }

    #[test]
    fn normal_equations_are_the_derivatives(X in poses(1.0), d in prop::array::uniform6(-0.02..0.02f64), n in 2..5_usize) {
        let points = see(&moved(&X, &Vector6::from(d)), &grid(n), || 0.0);
        let center = centroid(&points);
        let state = PoseState::at(&X, &center).unwrap();
        let normal = Normal::evaluate::<F2, _>(&state, &points, &center).unwrap();
        let cost = |step: [f64; 6]| {
            Normal::evaluate::<F2, _>(&state.moved(&step), &points, &center).unwrap().cost
        };
        let h = 1e-5;
        for i in 0..6 {
            let mut step = [0.0; 6];
            step[i] = h;
            let slope = (cost(step) - cost(step.map(|x| -x))) / (2.0 * h);
            prop_assert!((slope + 2.0 * normal.gradient[i]).abs() < 1e-6 * (1.0 + slope.abs()));
        }
        // Without residuals J^T J is half of the cost's second derivative.
        let exact = see(&X, &grid(n), || 0.0);
        let matrix = Normal::evaluate::<F2, _>(&state, &exact, &center).unwrap().matrix();
        let cost = |step: [f64; 6]| {
            Normal::evaluate::<F2, _>(&state.moved(&step), &exact, &center).unwrap().cost
        };
        for i in 0..6 {
            for j in 0..6 {
                let at = |a: f64, b: f64| {
                    let mut step = [0.0; 6];
                    step[i] += a * 1e-4;
                    step[j] += b * 1e-4;
                    cost(step)
                };
                let second = (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / 4e-8;
                let size = (matrix[i][i] * matrix[j][j]).sqrt();
                prop_assert!((0.5 * second - matrix[i][j]).abs() < 1e-3 * size + 1e-6, "{i} {j}");
            }
        }
    }

    #[test]
    fn both_kinds_of_lanes_and_of_points_give_the_same_bits(X in poses(1.0), n in 2..6_usize) {
        let mut noise = gauss(n as u64);
        let points = see(&X, &grid(n), || 1e-4 * noise());
        let center = centroid(&points);
        let start = PoseState::at(&X, &center).unwrap();
        let fast = minimise::<F2, _>(start, &points, &center).unwrap();
        let slow = minimise::<Portable, _>(start, &points, &center).unwrap();
        prop_assert_eq!(fast.state.q.map(f64::to_bits), slow.state.q.map(f64::to_bits));
        prop_assert_eq!(fast.state.p.map(f64::to_bits), slow.state.p.map(f64::to_bits));
        prop_assert_eq!(fast.normal.cost.to_bits(), slow.normal.cost.to_bits());
        let lifted: Vec<_> = points.iter()
            .map(|c| Correspondence3 { r: nalgebra::Point3::new(c.r.x, c.r.y, 0.0), s: c.s })
            .collect();
        prop_assert_eq!(refine(&X, &points, 1e-4), refine_3d(&X, &lifted, 1e-4));
    }

    #[test]
    fn the_end_is_a_minimum(X in poses(0.9), d in prop::array::uniform6(-1.0..1.0f64)) {
        let mut noise = gauss(17);
        let points = see(&X, &grid(3), || 1e-3 * noise());
        if let Ok(end) = refine(&X, &points, 1e-3) {
            let step = Vector6::from(d) * 1e-3;
            prop_assert!((reprojection_rms(&end.X_CO, &points) - end.rms).abs() < 1e-12);
            prop_assert!(reprojection_rms(&moved(&end.X_CO, &step), &points) >= end.rms);
        }
    }
}

#[test]
fn covariance_agrees_with_monte_carlo() {
    // The object's origin lies beside its points, so that the transport from the centroid matters.
    let plane: Vec<_> = grid(3).iter().map(|r| [r[0] + 0.3, r[1] - 0.1]).collect();
    let X = tilted([-0.2, 0.1, 0.6], 0.5, 0.7, 0.3);
    let sd = 1e-4;
    let mut noise = gauss(23);
    let count = 4000;
    let mut measured = Matrix6::zeros();
    for _ in 0..count {
        let end = refine(&X, &see(&X, &plane, || sd * noise()), sd).unwrap();
        let d = between(&X, &end.X_CO);
        measured += d * d.transpose() / f64::from(count);
    }
    let predicted = refine(&X, &see(&X, &plane, || 0.0), sd).unwrap().covariance;
    assert_eq!(predicted, predicted.transpose());
    for i in 0..6 {
        for j in 0..6 {
            let size = (predicted[(i, i)] * predicted[(j, j)]).sqrt();
            let off = (measured[(i, j)] - predicted[(i, j)]).abs();
            assert!(off < 0.1 * size, "({i}, {j}): {} for {}", measured[(i, j)], predicted[(i, j)]);
        }
    }
}

#[test]
fn three_points_are_enough_near_the_truth() {
    let X = tilted([0.02, 0.01, 0.4], 1.0, 0.6, 0.2);
    let guess = moved(&X, &(Vector6::new(1.0, -1.0, 2.0, 5.0, -4.0, 3.0) * 1e-3));
    let points = see(&X, &SQUARE[..3], || 0.0);
    assert!(gap(&refine(&guess, &points, 1e-4).unwrap().X_CO, &X) < 1e-9);
}

#[test]
fn bad_input_is_refused() {
    let X = tilted([0.0, 0.0, 0.5], 0.4, 0.5, 0.0);
    let points = see(&X, &SQUARE, || 0.0);
    assert_eq!(refine(&X, &points[..2], 1e-4), Err(PoseError::TooFewPoints { needed: 3, given: 2 }));
    assert_eq!(refine(&X, &points, f64::NAN), Err(PoseError::BadGuess));
    assert_eq!(refine(&X, &points, -1.0), Err(PoseError::BadGuess));
    let lost = Pose::translation(f64::NAN, 0.0, 1.0);
    assert_eq!(refine(&lost, &points, 1e-4), Err(PoseError::BadGuess));
    let behind = Pose::translation(0.0, 0.0, -0.5);
    assert_eq!(refine(&behind, &points, 1e-4), Err(PoseError::BehindCamera));
    let mut bad = points.clone();
    bad[3].s.x = f64::NAN;
    assert_eq!(refine(&X, &bad, 1e-4), Err(PoseError::NotFinite { index: 3 }));
    let line: Vec<_> = (0..5).map(|i| [0.02 * f64::from(i), 0.0]).collect();
    assert_eq!(refine(&X, &see(&X, &line, || 0.0), 1e-4), Err(PoseError::Degenerate));
    assert_eq!(refine(&X, &see(&X, &[[0.01, 0.02]; 5], || 0.0), 1e-4), Err(PoseError::Degenerate));
}

#[test]
fn reprojection_error_of_a_shifted_image() {
    let X = tilted([0.0, 0.0, 0.5], 0.4, 0.5, 0.0);
    let mut points = see(&X, &SQUARE, || 0.0);
    assert!(reprojection_rms(&X, &points) < 1e-15);
    points[0].s.x += 0.02;
    assert!((reprojection_rms(&X, &points) - 0.01).abs() < 1e-12);
    assert_eq!(reprojection_rms(&Pose::translation(0.0, 0.0, -1.0), &points), f64::INFINITY);
}
