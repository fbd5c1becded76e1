use super::super::testing::{SQUARE, see, tilted};
use super::*;
use crate::features::segment_features;
use crate::geometry::Pose;
use nalgebra::UnitQuaternion;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

const GAIN_1_S: f64 = 160.0;
const DT_S: f64 = 1e-3;

fn truth() -> Vector6<f64> {
    Vector6::new(0.0, 0.0, 0.5, 0.0, FRAC_PI_4, 0.0)
}

fn square_seen() -> Vec<super::super::Correspondence> {
    see(&tilted([0.0, 0.0, 0.5], FRAC_PI_2, FRAC_PI_4, 0.0), &SQUARE, || 0.0)
}

fn run(mut x: Vector6<f64>, steps: usize) -> (Vector6<f64>, Vec<f64>) {
    let points = square_seen();
    let mut errors = Vec::new();
    for _ in 0..steps {
        let step = algorithmic_step(&x, &points, GAIN_1_S, DT_S).unwrap();
        errors.push(step.error);
        x = step.x;
    }
    (x, errors)
}

#[test]
fn example_10_4() {
    let start = Vector6::new(0.0, 0.0, 1.0, 0.0, PI / 32.0, 0.0);
    let (x, errors) = run(start, 100);
    assert!((x - truth()).norm() < 1e-6, "{x}");
    // The first Euler step is too long and raises the error once; from then on it shrinks by 1 - 0.16 per step.
    assert!(errors[1] > errors[0]);
    for pair in errors[5..40].windows(2) {
        assert!((pair[1] / pair[0] - 0.84).abs() < 0.03, "{pair:?}");
    }
    let (x, _) = run(start, 30);
    assert!((x - truth()).norm() < 0.05, "{x}");
}

#[test]
fn a_start_with_opposite_tilt_ends_in_the_false_minimum() {
    let (x, errors) = run(Vector6::new(0.0, 0.0, 1.0, 0.0, -PI / 32.0, 0.0), 400);
    assert!((x - truth()).norm() > 0.3, "{x}");
    assert!(errors[399] > 1e-3 && (errors[399] - errors[398]).abs() < 1e-9);
}

#[test]
fn three_points_make_the_jacobian_square() {
    let points = &square_seen()[..3];
    let mut x = truth() + Vector6::new(0.01, -0.01, 0.02, 0.05, -0.04, 0.03);
    for _ in 0..120 {
        x = algorithmic_step(&x, points, GAIN_1_S, DT_S).unwrap().x;
    }
    assert!((x - truth()).norm() < 1e-6, "{x}");
}

#[test]
fn two_points_fix_four_coordinates() {
    let x_true = Vector4::new(0.02, -0.05, 0.5, 0.7);
    let q = UnitQuaternion::from_euler_angles(0.0, 0.0, x_true[3]);
    let points = see(&Pose::from_parts(x_true.xyz().into(), q), &SQUARE[..2], || 0.0);
    let mut x = Vector4::new(0.0, 0.0, 0.6, 0.3);
    let mut last = f64::INFINITY;
    for _ in 0..150 {
        let step = algorithmic_step_4(&x, &points, GAIN_1_S, DT_S).unwrap();
        assert!(step.error <= last + 1e-12); // square and regular: exponential
        last = step.error;
        x = step.x;
    }
    assert!((x - x_true).norm() < 1e-9, "{x}");
}

#[test]
fn a_segment_fixes_four_coordinates() {
    let x_true = Vector4::new(0.02, -0.05, 0.5, 2.9);
    let ends = [Point3::origin(), Point3::new(0.1, 0.0, 0.0)];
    let R = rotation_z(x_true[3]);
    let s = segment_features(&ends.map(|p| R * p.coords + x_true.xyz()).map(|p| p.xy() / p.z));
    let mut x = Vector4::new(0.0, 0.0, 0.6, -2.9); // alpha the short way, through pi
    let mut last = f64::INFINITY;
    for _ in 0..150 {
        let step = algorithmic_step_segment(&x, &ends, &s, GAIN_1_S, DT_S).unwrap();
        assert!(step.error <= last + 1e-12);
        last = step.error;
        x = step.x;
    }
    assert!((x + Vector4::new(0.0, 0.0, 0.0, 2.0 * PI) - x_true).norm() < 1e-9, "{x}");
    let point = [Point3::origin(); 2];
    assert_eq!(algorithmic_step_segment(&x, &point, &s, GAIN_1_S, DT_S), Err(PoseError::Degenerate));
    let behind = Vector4::new(0.0, 0.0, -0.6, 0.0);
    assert_eq!(algorithmic_step_segment(&behind, &ends, &s, GAIN_1_S, DT_S), Err(PoseError::BehindCamera));
    let nan = Vector4::repeat(f64::NAN);
    assert_eq!(
        algorithmic_step_segment(&x, &ends, &nan, GAIN_1_S, DT_S),
        Err(PoseError::NotFinite { index: 0 })
    );
}

#[test]
fn bad_input_is_refused() {
    let points = square_seen();
    let few = algorithmic_step(&truth(), &points[..2], GAIN_1_S, DT_S);
    assert_eq!(few, Err(PoseError::TooFewPoints { needed: 3, given: 2 }));
    let few = algorithmic_step_4(&Vector4::new(0.0, 0.0, 1.0, 0.0), &points[..1], GAIN_1_S, DT_S);
    assert_eq!(few, Err(PoseError::TooFewPoints { needed: 2, given: 1 }));
    let behind = Vector6::new(0.0, 0.0, -0.5, 0.0, 0.0, 0.0);
    assert_eq!(algorithmic_step(&behind, &points, GAIN_1_S, DT_S), Err(PoseError::BehindCamera));
    let lost = Vector6::from_element(f64::NAN);
    assert_eq!(algorithmic_step(&lost, &points, GAIN_1_S, DT_S), Err(PoseError::BehindCamera));
    let gimbal = Vector6::new(0.0, 0.0, 0.5, 0.3, FRAC_PI_2, 0.0);
    assert_eq!(algorithmic_step(&gimbal, &points, GAIN_1_S, DT_S), Err(PoseError::Degenerate));
    let line = see(&tilted([0.0, 0.0, 0.5], 0.0, 0.0, 0.0), &[[0.0, 0.0], [0.05, 0.0], [0.1, 0.0]], || 0.0);
    let flat = Vector6::new(0.0, 0.0, 0.5, 0.0, 0.0, 0.0);
    assert_eq!(algorithmic_step(&flat, &line, GAIN_1_S, DT_S), Err(PoseError::Degenerate));
}
