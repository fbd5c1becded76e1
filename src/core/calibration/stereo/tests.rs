//! A simulated pair with known truth.

use super::super::camera::BoardPoint;
use super::*;
use crate::camera_model::{Distortion, Intrinsics};
use crate::linalg::Random;
use nalgebra::{Matrix2, Point3, UnitQuaternion, Vector3};

const NOISE_PX: f64 = 0.15;

fn camera(f: f64, cx_px: f64) -> CameraModel {
    let i = Intrinsics { fx_px: f, fy_px: f, cx_px, cy_px: 236.0, width_px: 640, height_px: 480 };
    CameraModel::new(i, Distortion { k1: -0.2, k2: 0.08, ..Distortion::default() }).unwrap()
}

fn corner(id: u32) -> Point3<f64> {
    Point3::new(f64::from(id % 9) * 0.03, f64::from(id / 9) * 0.03, 0.0)
}

fn poses(count: usize, sees: impl Fn(&Pose) -> bool, random: &mut Random) -> Vec<Pose> {
    let mut all = Vec::new();
    while all.len() < count {
        let mut any =
            |s: f64| Vector3::new(random.between(-s, s), random.between(-s, s), random.between(-s, s));
        let R = UnitQuaternion::from_scaled_axis(any(0.6));
        let p = any(0.12) + Vector3::z() * 0.5 - R * Vector3::new(0.12, 0.075, 0.0);
        let X = Pose::from_parts(p.into(), R);
        if sees(&X) {
            all.push(X);
        }
    }
    all
}

/// The board as a camera sees it, with noise.
fn seen(camera: &CameraModel, X: &Pose, random: &mut Random) -> BoardView {
    let point = |id: u32| {
        let noise = Vector2::new(random.gaussian(), random.gaussian()) * NOISE_PX;
        let px = camera.project(&(X * corner(id))).unwrap() + noise;
        BoardPoint { id, p_O: corner(id), px, covariance_px2: Matrix2::zeros() }
    };
    (0..54).map(point).collect()
}

/// Errors of X_LR over trials against its covariance: chi-square with six degrees of freedom.
#[test]
fn pair_is_found_as_certainly_as_is_told() {
    let (left, right) = (camera(560.0, 315.0), camera(575.0, 330.0));
    let X_LR = Pose::from_parts(
        Vector3::new(0.1, 0.004, -0.01).into(),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.01, -0.08, 0.03)),
    );
    let X_RL = X_LR.inverse();
    let in_image = |camera: &CameraModel, X: &Pose| {
        (0..54).all(|id| camera.project(&(X * corner(id))).is_some_and(|px| camera.contains(&px, 2.0)))
    };
    let mut random = Random::new(6);
    let poses = poses(12, |X| in_image(&left, X) && in_image(&right, &(X_RL * X)), &mut random);
    let mut view = |camera: &CameraModel, X: &Pose| seen(camera, X, &mut random);
    const TRIALS: u32 = 60;
    let (mut chi_square, mut rms) = (0.0, 0.0);
    for trial in 0..TRIALS {
        let mut lefts: Vec<_> = poses.iter().map(|X| view(&left, X)).collect();
        let rights: Vec<_> = poses.iter().map(|X| view(&right, &(X_RL * X))).collect();
        if trial == 0 {
            lefts[4].clear();
        }
        let found =
            calibrate_stereo(&lefts, &rights, ((640, 480), (640, 480)), &CalibrationSettings::default())
                .unwrap();
        if trial == 0 {
            assert!(matches!(found.left.views[4].unused, Some(Unused::TooFewPoints { given: 0 })));
            assert_eq!(found.right.views[4].unused, Some(Unused::Other));
            assert_eq!(found.left.views_used(), 11);
        }
        let v = found.X_LR.translation.vector - X_LR.translation.vector;
        let w = (found.X_LR.rotation * X_LR.rotation.inverse()).scaled_axis();
        let off = nalgebra::Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
        chi_square += off.dot(&(found.covariance.try_inverse().unwrap() * off)) / f64::from(TRIALS);
        rms += found.rms_px / f64::from(TRIALS);
        assert!(
            (found.X_LR.translation.vector.norm() - X_LR.translation.vector.norm()).abs()
                < 5.0 * found.baseline_sd_m()
        );
        // rows of both images are noisy
        assert!((found.rows_rms_px.unwrap() / (NOISE_PX * 2f64.sqrt()) - 1.0).abs() < 0.15);
    }
    assert!((chi_square - 6.0).abs() < 1.5, "{chi_square}");
    assert!((rms - NOISE_PX * 2f64.sqrt()).abs() < 0.01, "{rms}");
}

#[test]
fn unequal_numbers_are_refused() {
    let sizes = ((640, 480), (640, 480));
    let error = calibrate_stereo(&[Vec::new()], &[], sizes, &CalibrationSettings::default()).unwrap_err();
    assert_eq!(error, CameraCalibrationError::Pairs { left: 1, right: 0 });
    assert!(error.to_string().contains("in pairs"));
}

/// The same images twice, and images of one camera that stood still: there is no pair, and the sentence names why.
#[test]
fn one_camera_is_no_pair() {
    let one = camera(560.0, 315.0);
    let mut random = Random::new(61);
    let in_image =
        |X: &Pose| (0..54).all(|id| one.project(&(X * corner(id))).is_some_and(|px| one.contains(&px, 2.0)));
    let poses = poses(10, in_image, &mut random);
    let mut taken = || -> Vec<BoardView> { poses.iter().map(|X| seen(&one, X, &mut random)).collect() };
    let (first, again) = (taken(), taken());
    for second in [&first, &again] {
        let sizes = ((640, 480), (640, 480));
        let error = calibrate_stereo(&first, second, sizes, &CalibrationSettings::default()).unwrap_err();
        assert!(matches!(error, CameraCalibrationError::NoBaseline { .. }), "{error}");
        assert!(error.to_string().contains("the same files"), "{error}");
    }
}

/// The right camera's images one place later than the left one's: no pair shows one board at one instant. The first image given twice leaves all others right.
#[test]
fn images_in_another_order_are_told() {
    let (left, right) = (camera(560.0, 315.0), camera(575.0, 330.0));
    let X_RL = Pose::new(Vector3::new(-0.1, 0.0, 0.0), Vector3::new(0.0, 0.05, 0.0));
    let sees = |camera: &CameraModel, X: &Pose| {
        (0..54).all(|id| camera.project(&(X * corner(id))).is_some_and(|px| camera.contains(&px, 2.0)))
    };
    let mut random = Random::new(77);
    let poses = poses(12, |X| sees(&left, X) && sees(&right, &(X_RL * X)), &mut random);
    let mut view = |camera: &CameraModel, X: &Pose| seen(camera, X, &mut random);
    let lefts: Vec<_> = poses.iter().map(|X| view(&left, X)).collect();
    let mut rights: Vec<_> = poses.iter().map(|X| view(&right, &(X_RL * X))).collect();
    let calibrated = |rights: &[BoardView]| {
        calibrate_stereo(&lefts, rights, ((640, 480), (640, 480)), &CalibrationSettings::default())
    };
    let mut twice = rights.clone();
    twice[1] = rights[0].clone();
    assert_eq!(calibrated(&twice).unwrap().left.views_used(), 11);
    rights.rotate_left(1);
    let refusal = calibrated(&rights).unwrap_err();
    assert!(matches!(refusal, CameraCalibrationError::Astray { astray: 9.., pairs: 12 }), "{refusal}");
}
