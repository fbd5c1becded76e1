//! Calibration of cameras, one thread: medians against the goals of the design.

#![allow(clippy::unwrap_used)] // a bench that cannot be set up should say so at once
#![allow(non_snake_case)] // X as in the text

use divan::Bencher;
use nalgebra::{Matrix2, Point3, UnitQuaternion, Vector2, Vector3};
use vservo::calibration::camera::{
    BoardPoint, BoardView, CalibrationSettings, ProjectionUncertainty, calibrate_camera, cross_validation,
    next_view,
};
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::geometry::Pose;
use vservo::linalg::Random;

const SIZE: (u32, u32) = (640, 480);

fn main() {
    divan::main();
}

fn board() -> Vec<Point3<f64>> {
    (0..54).map(|i| Point3::new(f64::from(i % 9) * 0.03, f64::from(i / 9) * 0.03, 0.0)).collect()
}

/// Views of a 9x6 board at random, with noise of 0.2 px.
fn views(count: usize) -> Vec<BoardView> {
    let i = Intrinsics {
        fx_px: 530.0,
        fy_px: 530.0,
        cx_px: 325.0,
        cy_px: 235.0,
        width_px: SIZE.0,
        height_px: SIZE.1,
    };
    let camera = CameraModel::new(i, Distortion { k1: -0.28, k2: 0.1, ..Distortion::default() }).unwrap();
    let mut random = Random::new(1);
    let mut views = Vec::new();
    while views.len() < count {
        let mut any =
            |s: f64| Vector3::new(random.between(-s, s), random.between(-s, s), random.between(-s, s));
        let R = UnitQuaternion::from_scaled_axis(any(0.6));
        let p = any(0.1) + Vector3::z() * 0.45 - R * Vector3::new(0.12, 0.075, 0.0);
        let X = Pose::from_parts(p.into(), R);
        let seen: Option<Vec<_>> =
            board().iter().map(|p| camera.project(&(X * p)).filter(|px| camera.contains(px, 2.0))).collect();
        let Some(seen) = seen else { continue };
        let point = |(id, (p_O, px)): (u32, (Point3<f64>, Vector2<f64>))| {
            let noise = Vector2::new(random.gaussian(), random.gaussian()) * 0.2;
            BoardPoint { id, p_O, px: px + noise, covariance_px2: Matrix2::zeros() }
        };
        views.push((0u32..).zip(board().into_iter().zip(seen)).map(point).collect());
    }
    views
}

/// Goal 3 ms for ten.
#[divan::bench(args = [10, 20, 40])]
fn calibrate(bencher: Bencher, count: usize) {
    let (views, settings) = (views(count), CalibrationSettings::default());
    bencher.bench_local(|| calibrate_camera(&views, SIZE, &settings).unwrap());
}

/// Goal 1 s: the map of uncertainty over 40 x 30 cells, and the next view.
#[divan::bench]
fn map_and_next_view_of_20(bencher: Bencher) {
    let found = calibrate_camera(&views(20), SIZE, &CalibrationSettings::default()).unwrap();
    let board = board();
    bencher.bench_local(|| {
        let uncertainty = ProjectionUncertainty::new(&found, 0.5).unwrap();
        let pixels = (0..1200).map(|i| Vector2::new(f64::from(i % 40) * 16.0, f64::from(i / 40) * 16.0));
        let worst = pixels.map(|px| uncertainty.sd_px(&px)).fold(0.0, f64::max);
        (worst, next_view(&board, &found, &uncertainty))
    });
}

#[divan::bench]
fn halves_of_20(bencher: Bencher) {
    let views = views(20);
    let found = calibrate_camera(&views, SIZE, &CalibrationSettings::default()).unwrap();
    let uncertainty = ProjectionUncertainty::new(&found, 0.5).unwrap();
    bencher.bench_local(|| cross_validation(&views, &found, &uncertainty));
}
