use super::*;
use crate::sim::perfect_measurement;
use nalgebra::Point3;
use std::f64::consts::TAU;

const POINTS: [(f64, f64); 4] = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)];

/// What is said of a camera that goes by `step` (m) and turns by `turn` (rad) in each of 40 images, and is believed to be turned otherwise about itself
/// by `wrong`, while the object goes by `away` (m): whether it is judged, and how the mount is wrong.
fn judged(step: [f64; 3], turn: [f64; 3], wrong: [f64; 3], away: [f64; 3]) -> (bool, Option<CameraError>) {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    let mount = Pose::new(Vector3::zeros(), wrong.into());
    let mut agreement = MotionAgreement::default();
    agreement.begin();
    for k in 0..40i64 {
        let by = |a: [f64; 3]| Vector3::from(a) * k as f64;
        let camera = Pose::new(by(step), by(turn));
        let object = Pose::new(by(away), Vector3::zeros()) * goal;
        let time = MonoNs(k * 40_000_000);
        let seen = perfect_measurement(&points, &camera.inv_mul(&object), MonoNs::ZERO).unwrap();
        // The true camera is turned by the opposite against the one that is believed.
        agreement.note(time, &View::of(&seen, &set_point).unwrap(), &(camera * mount), &set_point);
    }
    (agreement.is_judged(), agreement.error())
}

#[test]
fn cameras_that_are_mounted_turned_are_told() {
    for (step, turn) in [
        ([0.003, 0.001, 0.0], [0.0; 3]),
        ([-0.001, 0.004, 0.003], [0.0, 0.01, 0.01]),
        ([0.001, 0.001, -0.004], [0.004, -0.01, 0.0]),
    ] {
        for (degrees, quarters) in
            [(-180.0, 2), (-120.0, 1), (-90.0, 1), (90.0, 3), (150.0, 2), (180.0f64, 2)]
        {
            let wrong = [0.0, 0.0, degrees.to_radians()];
            let told = Some(CameraError::Turned(quarters));
            assert_eq!(judged(step, turn, wrong, [0.0; 3]), (true, told), "{degrees} {step:?}");
        }
        for degrees in [-50.0, -20.0, 0.0, 5.0, 40.0, 60.0f64] {
            let wrong = [0.0, 0.0, degrees.to_radians()];
            assert_eq!(judged(step, turn, wrong, [0.0; 3]).1, None, "{degrees} {step:?}");
        }
    }
    assert_eq!(judged([0.0, 0.003, 0.0], [0.0; 3], [0.3, -0.3, 0.2], [0.0; 3]).1, None);
}

#[test]
fn cameras_with_other_axes_are_told() {
    for (step, turn) in [([0.001, 0.003, 0.002], [0.0; 3]), ([-0.001, 0.004, 0.003], [0.004, 0.01, 0.01])] {
        for wrong in [[90.0, 0.0, 0.0], [0.0, -90.0, 0.0], [180.0, 0.0, 0.0], [0.0, 180.0, 0.0f64]] {
            let wrong = wrong.map(f64::to_radians);
            let told = judged(step, turn, wrong, [0.0; 3]);
            assert_eq!(told, (true, Some(CameraError::OtherAxes)), "{wrong:?} {step:?}");
        }
    }
}

/// A target that is larger or smaller than it is believed: the way of the camera is another part of its distance.
#[test]
fn wrong_depths_are_no_turns() {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    for scale in [0.2, 0.5, 2.0, 5.0] {
        for (step, turn) in [
            ([0.003, 0.001, 0.0], [0.0, 0.003, 0.0]),
            ([0.003, 0.001, 0.0], [0.0, -0.006, 0.0]),
            ([-0.001, 0.004, 0.003], [0.01, 0.01, 0.02]),
            ([0.002, 0.002, -0.004], [-0.004, 0.004, 0.0]),
        ] {
            let mut agreement = MotionAgreement::default();
            agreement.begin();
            for k in 0..40i64 {
                let by = |a: [f64; 3]| Vector3::from(a) * k as f64;
                let time = MonoNs(k * 40_000_000);
                let camera = Pose::new(by(step), by(turn));
                let seen = perfect_measurement(&points, &camera.inv_mul(&goal), MonoNs::ZERO).unwrap();
                let believed = Pose::new(by(step) * scale, by(turn));
                agreement.note(time, &View::of(&seen, &set_point).unwrap(), &believed, &set_point);
            }
            assert_eq!(agreement.error(), None, "{scale} {step:?} {turn:?}");
        }
    }
}

#[test]
fn motion_along_the_optical_axis_tells_nothing_of_turns() {
    assert_eq!(judged([0.0, 0.0, 0.004], [0.0, 0.0, 0.01], [0.0, 0.0, 3.0], [0.0; 3]), (true, None));
}

/// An object that somebody moves by hand, and an arm that follows it with a lag: for a moment the image is where a camera that is turned by 180 degrees would have it.
#[test]
fn an_object_that_is_followed_is_no_turned_camera() {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    for speed_m_s in [0.01, 0.03, 0.1, 0.3] {
        for lag_s in [0.05, 0.07, 0.1, 0.2, 0.5] {
            for (rate_hz, jump_m) in [(25, 0.0), (100, 0.0), (25, 0.03), (100, 0.01)] {
                let mut agreement = MotionAgreement::default();
                agreement.begin();
                for k in 0..2 * rate_hz {
                    let t = k as f64 / rate_hz as f64 - 0.3;
                    let s = t.max(0.0);
                    let at = speed_m_s * s + if t >= 0.0 { jump_m } else { 0.0 };
                    let decay = (-s / lag_s).exp();
                    let camera = speed_m_s * (s - lag_s * (1.0 - decay)) + jump_m * (1.0 - decay);
                    let camera = Pose::new(Vector3::x() * camera, Vector3::zeros());
                    let object = Pose::new(Vector3::x() * at, Vector3::zeros()) * goal;
                    let time = MonoNs(k * 1_000_000_000 / rate_hz);
                    let seen = perfect_measurement(&points, &camera.inv_mul(&object), time).unwrap();
                    agreement.note(time, &View::of(&seen, &set_point).unwrap(), &camera, &set_point);
                }
                assert_eq!(agreement.error(), None, "{speed_m_s} m/s, {lag_s} s, {rate_hz} Hz, {jump_m} m");
            }
        }
    }
}

/// What is moved by hand while the arm waits says nothing of the mount, before or after; one that has agreed stays so.
#[test]
fn an_object_that_is_put_elsewhere_before_a_start_hides_nothing() {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    let mut agreement = MotionAgreement::default();
    let mut k = 0;
    let mut see = |agreement: &mut MotionAgreement, object: f64, camera: f64, turn: f64| {
        let camera = Pose::new(Vector3::x() * camera, Vector3::zeros());
        let object = Pose::new(Vector3::y() * object, Vector3::zeros()) * goal;
        let time = MonoNs(k * 40_000_000);
        k += 1;
        let seen = perfect_measurement(&points, &camera.inv_mul(&object), time).unwrap();
        let believed = camera * Pose::new(Vector3::zeros(), Vector3::z() * turn);
        agreement.note(time, &View::of(&seen, &set_point).unwrap(), &believed, &set_point);
    };
    for wrong in [TAU / 2.0, 0.0] {
        for i in 0..10 {
            see(&mut agreement, 0.01 * f64::from(i), 0.0, wrong);
            assert!(agreement.interrupt() && !agreement.is_judged());
        }
        agreement.begin();
        (0..10).for_each(|i| see(&mut agreement, 0.09, 2e-3 * f64::from(i), wrong));
        let told = (wrong > 0.0).then_some(CameraError::Turned(2));
        assert_eq!((agreement.is_judged(), agreement.error()), (true, told), "{wrong}");
        assert_eq!(agreement.interrupt(), wrong > 0.0);
    }
    (0..10).for_each(|i| see(&mut agreement, 0.01 * f64::from(i), 0.0, 0.0));
    assert!(agreement.is_judged() && agreement.error().is_none() && !agreement.interrupt());
}

#[test]
fn an_arm_at_rest_and_an_object_that_moves_contradict_nothing() {
    assert_eq!(judged([0.0; 3], [0.0; 3], [0.0; 3], [0.02, 0.0, 0.0]), (true, None));
    assert_eq!(judged([0.001, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.02, 0.0, 0.0]).1, None);
    assert_eq!(judged([0.001, 0.0, 0.0], [0.0, 0.002, 0.0], [0.0; 3], [0.003, 0.02, 0.01]).1, None);
    // Stamps that are late: the image has hardly moved yet.
    assert_eq!(judged([0.01, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0099, 0.0, 0.0]), (true, None));
}

/// A camera whose images are mirrored, before a target that is the same in a mirror. Along the image's plane alone a mirrored motion is one that is seen by a camera that is turned, too.
#[test]
fn mirrored_images_are_told() {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    for (step, turn) in [([3e-4, 6e-4, 0.0], [0.0, 0.0, 2e-3]), ([5e-4, -5e-4, 3e-4], [1e-3, 1e-3, -1e-3])] {
        for axis in [None, Some(0), Some(1)] {
            let mut agreement = MotionAgreement::default();
            agreement.begin();
            for k in 0..40i64 {
                let by = |a: [f64; 3]| Vector3::from(a) * k as f64;
                let camera = Pose::new(by(step), by(turn));
                let X_CO = camera.inv_mul(&goal);
                let mut seen = perfect_measurement(&points, &X_CO, MonoNs::ZERO).unwrap();
                // Each feature where the mirror shows it; which is which is judged by nobody here.
                let count = seen.feature_count as usize;
                for point in seen.features.iter_mut().take(count) {
                    match axis {
                        Some(0) => point.x = -point.x,
                        Some(_) => point.y = -point.y,
                        None => {}
                    }
                }
                agreement.note(
                    MonoNs(k * 40_000_000),
                    &View::of(&seen, &set_point).unwrap(),
                    &camera,
                    &set_point,
                );
            }
            assert_eq!(
                (agreement.is_judged(), agreement.error().is_some()),
                (true, axis.is_some()),
                "{step:?} {turn:?} {axis:?}"
            );
        }
    }
}

/// A conveyor that ran before the arm began, and an arm that is slower, as fast, or half as fast: at half its speed the image goes the way on which a camera that is turned by 180 degrees would see it.
#[test]
fn an_object_that_moved_before_the_arm_did_is_no_turned_camera() {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    let mut told = 0;
    for object in [[0.05, 0.0, 0.0], [0.0, -0.08, 0.0], [0.01, 0.01, 0.0f64]] {
        for share in [0.3, 0.5, 0.55, 1.0] {
            for (rate_hz, stood) in [(25, 3), (100, 12), (25, 0)] {
                let mut agreement = MotionAgreement::default();
                for k in -stood..rate_hz {
                    let t = k as f64 / rate_hz as f64;
                    let way = Vector3::from(object);
                    let camera = Pose::new(way * share * t.max(0.0), Vector3::zeros());
                    let object = Pose::new(way * t, Vector3::zeros()) * goal;
                    let time = MonoNs(1_000_000_000 + k * 1_000_000_000 / rate_hz);
                    let seen = perfect_measurement(&points, &camera.inv_mul(&object), time).unwrap();
                    if k == 0 {
                        agreement.begin();
                    }
                    agreement.note(time, &View::of(&seen, &set_point).unwrap(), &camera, &set_point);
                }
                if stood == 0 {
                    told += u32::from(agreement.error().is_some());
                } else {
                    assert_eq!(agreement.error(), None, "{object:?} {share} {rate_hz} Hz");
                }
            }
        }
    }
    // Without a view before the arm moves nothing tells the two apart.
    assert!(told > 0);
}

/// The same conveyor before a camera whose mount is wrong: what it does explains nothing.
#[test]
fn a_wrong_mount_is_told_before_an_object_that_had_moved() {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    let mut agreement = MotionAgreement::default();
    for k in -5..40 {
        let t = f64::from(k) * 0.04;
        let camera = Pose::new(Vector3::x() * (0.05 * t.max(0.0)), Vector3::zeros());
        let object = Pose::new(Vector3::y() * (0.05 * (t + 0.04).min(0.0)), Vector3::zeros()) * goal;
        let time = MonoNs(1_000_000_000 + i64::from(k) * 40_000_000);
        let seen = perfect_measurement(&points, &camera.inv_mul(&object), time).unwrap();
        if k == 0 {
            agreement.begin();
        }
        let believed = camera * Pose::new(Vector3::zeros(), Vector3::z() * (TAU / 2.0));
        agreement.note(time, &View::of(&seen, &set_point).unwrap(), &believed, &set_point);
    }
    assert_eq!(agreement.error(), Some(CameraError::Turned(2)));
}

/// Without a view before its motion an arm that may pause stands until it is seen what moves: an object that goes twice as fast as the arm, or the image by a mount that is turned. One that never stands is
/// believed to be seen by a wrong mount after a second.
#[test]
fn an_arm_that_pauses_tells_an_object_from_a_mount() {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    let set_point = SetPoint::from_pose(&goal, &points).unwrap();
    let turned = Some(CameraError::Turned(2));
    for (object_m_s, turn, obeys, told) in
        [(0.06, 0.0, true, None), (0.0, TAU / 2.0, true, turned), (0.06, 0.0, false, turned)]
    {
        for (rate_hz, lag_s) in [(25, 0.03), (5, 0.1), (100, 0.1)] {
            let mut agreement = MotionAgreement::new(true);
            agreement.begin();
            let (h, mut at_m, mut speed, mut paused) = (1.0 / f64::from(rate_hz), 0.0, 0.03, 0);
            for k in 0..2 * rate_hz {
                let t = f64::from(k) * h;
                let camera = Pose::new(Vector3::x() * at_m, Vector3::zeros());
                let object = Pose::new(Vector3::x() * (object_m_s * t), Vector3::zeros()) * goal;
                let time = MonoNs(1_000_000_000 + i64::from(k) * 1_000_000_000 / i64::from(rate_hz));
                let seen = perfect_measurement(&points, &camera.inv_mul(&object), time).unwrap();
                let believed = camera * Pose::new(Vector3::zeros(), Vector3::z() * turn);
                agreement.note(time, &View::of(&seen, &set_point).unwrap(), &believed, &set_point);
                let wanted = if agreement.pauses() && obeys { 0.0 } else { 0.03 };
                paused += i32::from(agreement.pauses());
                speed = wanted + (speed - wanted) * (-h / lag_s).exp();
                speed = if speed < 1e-4 { 0.0 } else { speed };
                at_m += speed * h;
            }
            let what = (agreement.is_judged(), agreement.error(), paused > 0, agreement.pauses());
            assert_eq!(what, (true, told, true, false), "{object_m_s} m/s, {rate_hz} Hz");
        }
    }
}
