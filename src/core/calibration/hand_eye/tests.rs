//! Both closed forms and the refinement against simulated truth.

use super::testing::{SimulatedCell, around, camera, gap, pose};
use super::*;
use crate::linalg::Random;
use crate::pose::normalized_error;
use nalgebra::Vector3;
use proptest::prelude::*;

const PLACES: [CameraMount; 2] = [CameraMount::EyeInHand, CameraMount::EyeToHand];

fn settings(cell: &SimulatedCell) -> JointSettings {
    JointSettings::least_squares(cell.place, cell.robot)
}

fn all(views: &[HandEyeView]) -> Vec<&HandEyeView> {
    views.iter().collect()
}

proptest! {
    #[test]
    fn exact_motions_give_the_truth(seed in any::<u64>(), count in 3..12usize) {
        for place in PLACES {
            let mut random = Random::new(seed);
            let cell = SimulatedCell::new(place, &mut random);
            let samples: Vec<_> = (0..count).map(|_| cell.sample(&around(&mut random))).collect();
            let spread = rotation_spread(&samples).unwrap();
            prop_assume!(spread.across_rad > 0.1);
            prop_assert!(spread.mismatch_rad < 1e-7);
            let first = separate_solution(&samples).unwrap();
            prop_assert!(gap(&first, &cell.X_MC) < 1e-9, "{}", gap(&first, &cell.X_MC));
            let second = dual_quaternion_solution(&samples, &first.rotation).unwrap();
            prop_assert!(gap(&second, &cell.X_MC) < 1e-9, "{}", gap(&second, &cell.X_MC));
            let scatter = loop_scatter(&samples, &cell.X_MC).unwrap();
            prop_assert!(gap(&scatter.X_WO, &cell.X_WO) < 1e-9 && scatter.position_m < 1e-9 && scatter.rotation_rad < 1e-7);
        }
    }

    /// Turns by any angle, half turns among them, whose quaternions have two signs.
    #[test]
    fn half_turns_are_turns(seed in any::<u64>(), x in prop::array::uniform6(-1.0..1.0f64)) {
        let mut random = Random::new(seed);
        let (X, Z) = (pose(x), pose([0.3, 0.1, 0.2, 0.5, -0.4, 1.0]));
        let any = |random: &mut Random| Vector3::from_fn(|_, _| random.between(-3.0, 3.0));
        let mut samples: Vec<_> = (0..6)
            .map(|_| Pose::new(any(&mut random) * 0.3, any(&mut random)))
            .map(|X_CO| LoopSample { X_WM: Z * X_CO.inverse() * X.inverse(), X_CO })
            .collect();
        let first = samples[0];
        let X_CO = Pose::rotation(Vector3::x() * std::f64::consts::PI) * first.X_CO;
        samples.push(LoopSample { X_WM: Z * X_CO.inverse() * X.inverse(), X_CO });
        let found = separate_solution(&samples).unwrap();
        prop_assert!(gap(&found, &X) < 1e-8, "{}", gap(&found, &X));
        let found = dual_quaternion_solution(&samples, &found.rotation).unwrap();
        prop_assert!(gap(&found, &X) < 1e-8, "{}", gap(&found, &X));
    }

    #[test]
    fn exact_corners_give_the_truth_from_afar(seed in any::<u64>(), count in 4..9usize) {
        for place in PLACES {
            let mut random = Random::new(seed);
            let cell = SimulatedCell::new(place, &mut random);
            let views = cell.views(count, &mut random);
            let start = pose([0.02, -0.01, 0.015, 0.05, -0.08, 0.06]) * cell.X_MC;
            let board = cell.X_WO * pose([-0.02, 0.01, 0.015, 0.04, 0.03, -0.06]);
            for robot in [RobotSd { rotation_rad: 0.0, translation_m: 0.0 }, RobotSd::default()] {
                let fit = refine_jointly(&all(&views), &camera(), &JointSettings { robot, ..settings(&cell) }, &start, &board);
                let fit = fit.unwrap();
                prop_assert!(gap(&fit.X_MC, &cell.X_MC) < 1e-9, "{robot:?} {} {}", gap(&fit.X_MC, &cell.X_MC), fit.iterations);
                prop_assert!(gap(&fit.X_WO, &cell.X_WO) < 1e-9 && fit.rms_px < 1e-6);
            }
        }
    }

    #[test]
    fn the_whole_way_from_corners(seed in any::<u64>()) {
        for place in PLACES {
            let mut random = Random::new(seed);
            let cell = SimulatedCell::new(place, &mut random);
            let views = cell.views(8, &mut random);
            let report = calibrate_hand_eye(&views, &camera(), &HandEyeSettings::of(place)).unwrap();
            prop_assert!(gap(&report.X_MC(), &cell.X_MC) < 1e-9, "{}", gap(&report.X_MC(), &cell.X_MC));
            let held = report.held_out.unwrap();
            prop_assert!(held.rms_px < 1e-6 && held.position_m < 1e-9);
        }
    }
}

/// Errors of the joint fit over its stated covariance: chi-square with six degrees of freedom, for camera and board.
#[test]
fn covariances_are_honest() {
    for place in PLACES {
        let (mut camera_error, mut board_error, mut chi, count) = (0.0, 0.0, [0.0; 2], 400);
        for seed in 0..count {
            let mut random = Random::new(1000 + seed);
            let mut cell = SimulatedCell::new(place, &mut random);
            cell.corner_sd_px = 0.1;
            cell.robot = RobotSd { rotation_rad: 1e-3, translation_m: 1e-3 };
            let views = cell.views(10, &mut random);
            let fit =
                refine_jointly(&all(&views), &camera(), &settings(&cell), &cell.X_MC, &cell.X_WO).unwrap();
            camera_error += normalized_error(&fit.X_MC, &fit.covariance_X_MC, &cell.X_MC).unwrap();
            board_error += normalized_error(&fit.X_WO, &fit.covariance_X_WO, &cell.X_WO).unwrap();
            chi[0] += fit.chi_square[0];
            chi[1] += fit.chi_square[1];
        }
        let n = count as f64;
        let (camera_error, board_error, both) = (camera_error / n, board_error / n, (chi[0] + chi[1]) / n);
        // standard error of a mean of 400: 0.17; 1080 + 60 equations, 12 + 60 unknowns: 1068, standard error 2.3
        assert!((camera_error - 6.0).abs() < 0.7, "{camera_error}");
        assert!((board_error - 6.0).abs() < 0.7, "{board_error}");
        assert!((both - 1068.0).abs() < 9.0, "{both}");
    }
}

#[test]
fn corners_true_to_a_thousandth_of_a_pixel_converge() {
    for seed in 0..200 {
        for (place, corner_sd_px) in PLACES.into_iter().zip([1e-3, 1e-4]) {
            let mut random = Random::new(seed);
            let mut cell = SimulatedCell::new(place, &mut random);
            cell.corner_sd_px = corner_sd_px;
            let views = cell.views(12, &mut random);
            let settings = JointSettings { robot: RobotSd::default(), ..settings(&cell) };
            let start = pose([1e-3, -1e-3, 1e-3, 2e-3, -2e-3, 1e-3]) * cell.X_MC;
            let fit = refine_jointly(&all(&views), &camera(), &settings, &start, &cell.X_WO);
            assert!(gap(&fit.unwrap().X_MC, &cell.X_MC) < 1e-4, "{seed}");
        }
    }
}

/// The refinement beats both closed forms where the corners are the error, and tells by how much the robot is off where it is that.
#[test]
fn the_refinement_is_better_than_the_closed_forms() {
    let mut squares = [0.0; 3];
    for seed in 0..60 {
        let mut random = Random::new(seed);
        let mut cell = SimulatedCell::new(CameraMount::EyeInHand, &mut random);
        cell.corner_sd_px = 0.5;
        let views = cell.views(8, &mut random);
        let settings = HandEyeSettings { robot: cell.robot, ..HandEyeSettings::of(cell.place) };
        let report = calibrate_hand_eye(&views, &camera(), &settings).unwrap();
        let [separate, dual] = [0, 1].map(|form: usize| report.closed_forms[form].X_MC);
        for (sum, X) in squares.iter_mut().zip([report.X_MC(), separate, dual]) {
            *sum += (X.translation.vector - cell.X_MC.translation.vector).norm_squared();
        }
    }
    let [joint, separate, dual] = squares.map(|s| (s / 60.0f64).sqrt() * 1e3);
    assert!(joint < 0.8 * separate && joint < 0.8 * dual, "{joint} {separate} {dual} mm");
}

#[test]
fn a_robot_worse_than_stated_is_found_out() {
    let (mut position, mut rotation, mut error) = (0.0, 0.0, 0.0);
    for seed in 0..40 {
        let mut random = Random::new(90 + seed);
        let mut cell = SimulatedCell::new(CameraMount::EyeInHand, &mut random);
        cell.corner_sd_px = 0.05;
        cell.robot = RobotSd { rotation_rad: 5e-3, translation_m: 3e-3 };
        let views = cell.views(15, &mut random);
        let report = calibrate_hand_eye(&views, &camera(), &HandEyeSettings::of(cell.place)).unwrap();
        position += report.robot_seen.translation_m / 40.0;
        rotation += report.robot_seen.rotation_rad / 40.0;
        error += normalized_error(&report.fit.X_MC, &report.fit.covariance_X_MC, &cell.X_MC).unwrap() / 40.0;
        assert!(report.verdict.contains("the robot's poses"), "{}", report.verdict);
    }
    assert!((position - 3e-3).abs() < 0.3e-3 && (rotation - 5e-3).abs() < 0.5e-3, "{position} {rotation}");
    // the deviations are estimates themselves: a little more than 6
    assert!(error > 4.5 && error < 9.5, "{error}");
}

#[test]
fn the_time_between_the_stamps_is_found() {
    for place in PLACES {
        let mut squares = 0.0;
        for seed in 0..30 {
            let mut random = Random::new(seed);
            let mut cell = SimulatedCell::new(place, &mut random);
            cell.offset_s = random.between(-0.05, 0.05);
            for (noise, sd_px) in [(false, 0.0), (true, 0.1)] {
                cell.corner_sd_px = sd_px;
                cell.robot = RobotSd { rotation_rad: 2e-4, translation_m: 2e-4 };
                if !noise {
                    cell.robot = RobotSd { rotation_rad: 0.0, translation_m: 0.0 };
                }
                let views: Vec<_> = (0..10)
                    .map(|_| {
                        let V = Twist::from_fn(|_, _| random.between(-0.2, 0.2));
                        let X_CO = around(&mut random);
                        cell.view(&X_CO, Some(V), &mut random)
                    })
                    .collect();
                let settings =
                    HandEyeSettings { time_offset: true, robot: cell.robot, ..HandEyeSettings::of(place) };
                let report = calibrate_hand_eye(&views, &camera(), &settings).unwrap();
                let off = report.fit.offset_s - cell.offset_s;
                if noise {
                    squares += (off / report.fit.offset_sd_s.unwrap()).powi(2) / 30.0;
                } else {
                    assert!(off.abs() < 1e-9 && gap(&report.X_MC(), &cell.X_MC) < 1e-9, "{off}");
                }
            }
        }
        assert!(squares > 0.5 && squares < 1.8, "{squares}");
    }
}

#[test]
fn views_in_motion_are_left_out_unless_the_time_is_sought() {
    let mut random = Random::new(4);
    let mut cell = SimulatedCell::new(CameraMount::EyeInHand, &mut random);
    cell.offset_s = 0.05;
    let mut views: Vec<_> = (0..8)
        .map(|i| {
            let V = if i < 2 { Twist::repeat(0.1) } else { Twist::repeat(1e-4) };
            let X_CO = around(&mut random);
            cell.view(&X_CO, Some(V), &mut random)
        })
        .collect();
    let report = calibrate_hand_eye(&views, &camera(), &HandEyeSettings::of(cell.place)).unwrap();
    let used: Vec<_> = report.views.iter().map(|view| view.used).collect();
    assert_eq!(used, [false, false, true, true, true, true, true, true]);
    assert!(report.views[0].reason.as_ref().unwrap().contains("in motion"), "{:?}", report.views[0]);
    assert!(gap(&report.X_MC(), &cell.X_MC) < 1e-4);
    for view in &mut views {
        view.V_BE_E = Some(Twist::repeat(0.1));
    }
    let refused = calibrate_hand_eye(&views, &camera(), &HandEyeSettings::of(cell.place));
    assert_eq!(refused.unwrap_err(), HandEyeError::TooFewViews { given: 0, needed: 3 });
}

#[test]
fn what_does_not_determine_the_camera_is_named() {
    for place in PLACES {
        let mut random = Random::new(8);
        let cell = SimulatedCell::new(place, &mut random);
        let run = |views: &[HandEyeView]| calibrate_hand_eye(views, &camera(), &HandEyeSettings::of(place));
        let views = cell.views(3, &mut random);
        assert!(matches!(run(&views[..2]), Err(HandEyeError::TooFewViews { given: 2, .. })));
        let three = run(&views).unwrap();
        assert!(gap(&three.X_MC(), &cell.X_MC) < 1e-9 && three.held_out.is_none());
        assert!(three.verdict.contains("more views"), "{}", three.verdict);
        // shifted, never turned
        let shifted: Vec<_> = (0..6)
            .map(|i| {
                let X_CO =
                    Pose::translation(0.01 * f64::from(i) - 0.1, -0.06, 0.5 + 0.02 * f64::from(i * i % 4));
                cell.view(&X_CO, None, &mut random)
            })
            .collect();
        let refused = run(&shifted).unwrap_err();
        assert!(matches!(refused, HandEyeError::NoRotation { .. }), "{refused}");
        // turned about one axis of the camera's
        let axis_C = Vector3::new(0.0, 0.2, 1.0).normalize();
        let turned: Vec<_> = (0..6)
            .map(|i| {
                let turn = Pose::rotation(axis_C * (0.3 * f64::from(i)));
                let X_CO = Pose::translation(0.0, 0.0, 0.5 + 0.02 * f64::from(i))
                    * turn
                    * Pose::translation(-0.1, -0.06, 0.0);
                cell.view(&X_CO, None, &mut random)
            })
            .collect();
        match run(&turned) {
            Err(HandEyeError::OneAxis { axis, .. }) => {
                let axis_M = cell.X_MC.rotation * axis_C;
                assert!(axis_M.cross(&Vector3::from(axis)).norm() < 1e-3, "{axis:?} {axis_M}");
            }
            other => panic!("{other:?}"),
        }
        // three views of which two are one
        let twice = [views[0].clone(), views[1].clone(), views[1].clone()];
        assert!(matches!(run(&twice), Err(HandEyeError::OneAxis { .. })));
        // the poses of other images
        let mut mixed = cell.views(6, &mut random);
        let first = mixed[0].X_BE;
        for i in 0..5 {
            mixed[i].X_BE = mixed[i + 1].X_BE;
        }
        mixed[5].X_BE = first;
        let refused = run(&mixed).unwrap_err();
        assert!(matches!(refused, HandEyeError::Contradiction { .. }), "{refused}");
        let mut bad = views.clone();
        bad[1].X_BE.translation.x = f64::NAN;
        assert!(matches!(run(&bad), Err(HandEyeError::NotFinite { .. })));
        let mut bad = views.clone();
        bad[1].corners.truncate(2);
        assert!(matches!(run(&bad), Err(HandEyeError::BoardPose { .. })));
    }
}

/// An axis that is turned about only a little is told, and its uncertainty is large.
#[test]
fn a_weak_axis_is_told() {
    let mut random = Random::new(3);
    let mut cell = SimulatedCell::new(CameraMount::EyeInHand, &mut random);
    cell.corner_sd_px = 0.05;
    let views: Vec<_> = (0..8)
        .map(|i| {
            let tilt =
                Vector3::new(random.between(-0.06, 0.06), random.between(-0.06, 0.06), 0.3 * f64::from(i));
            let X_CO = Pose::new(Vector3::new(0.0, 0.0, 0.5), tilt) * Pose::translation(-0.1, -0.06, 0.0);
            cell.view(&X_CO, None, &mut random)
        })
        .collect();
    let report = calibrate_hand_eye(&views, &camera(), &HandEyeSettings::of(cell.place)).unwrap();
    assert!(report.verdict.contains("tilt"), "{}", report.verdict);
}

#[test]
fn the_other_place_of_the_eye_is_suspected() {
    let mut random = Random::new(6);
    let mut cell = SimulatedCell::new(CameraMount::EyeToHand, &mut random);
    cell.corner_sd_px = 0.1;
    let views = cell.views(8, &mut random);
    match calibrate_hand_eye(&views, &camera(), &HandEyeSettings::of(CameraMount::EyeInHand)) {
        Ok(report) => assert!(report.verdict.contains("beside the arm"), "{}", report.verdict),
        Err(error) => assert!(error.to_string().contains("eye"), "{error}"),
    }
}

/// One corner in forty far off: the loss leaves it where it is.
#[test]
fn wrong_corners_do_not_pull() {
    let mut random = Random::new(12);
    let mut cell = SimulatedCell::new(CameraMount::EyeInHand, &mut random);
    cell.corner_sd_px = 0.05;
    let mut views = cell.views(8, &mut random);
    for (i, view) in views.iter_mut().enumerate() {
        view.corners[7 * i % 54].px.x += 12.0;
    }
    let settings = HandEyeSettings { robot: cell.robot, ..HandEyeSettings::of(cell.place) };
    let report = calibrate_hand_eye(&views, &camera(), &settings).unwrap();
    assert!(gap(&report.X_MC(), &cell.X_MC) < 1e-3, "{}", gap(&report.X_MC(), &cell.X_MC));
}

#[test]
fn motion_is_seen_by_poses_and_by_corners() {
    let V = Twist::new(0.1, 0.0, 0.05, 0.2, -0.1, 0.0);
    assert!(!is_settled(flange_speed_px_s(&camera(), &V, 0.5)));
    assert!(is_settled(flange_speed_px_s(&camera(), &(V * 1e-2), 0.5)) && !is_settled(f64::NAN));
    let found = |id: u32, u: f64| crate::detect::Detection {
        id,
        px: nalgebra::Vector2::new(u, 50.0),
        sd_px: 0.05,
        area_px2: 0.0,
        covariance_px2: [0.0; 3],
        dark_level: 0.0,
        plate_level: 0.0,
        disturbance_px: 0.0,
    };
    let before = [found(0, 10.0), found(1, 30.0), found(5, 50.0)];
    let speed = corner_speed_px_s(&before, &[found(1, 32.0), found(5, 52.0)], 0.04).unwrap();
    assert!((speed - 50.0).abs() < 0.1, "{speed}");
    assert_eq!(corner_speed_px_s(&before, &[found(1, 30.05), found(5, 49.95)], 0.04), Some(0.0));
    assert_eq!(corner_speed_px_s(&before, &[found(9, 1.0)], 0.04), None);
}

/// The definition of the covariance, held against a simulation of its own: matrices multiplied out here, corners projected by a pinhole
/// written here, the error composed here as position change and left rotation, for camera and board and both places of the eye. The
/// rigid-body twist about the outer frame's origin, which the same words may mean, fails where the camera is far from it: beside
/// the arm.
#[test]
fn covariances_are_of_position_change_and_left_rotation() {
    use crate::camera_model::{CameraModel, Distortion, Intrinsics};
    use nalgebra::{Matrix3, Point3, Rotation3, Vector2, Vector6};
    type Rigid = (Matrix3<f64>, Vector3<f64>);
    let turn = |w: Vector3<f64>| Rotation3::from_scaled_axis(w).into_inner();
    let times = |a: &Rigid, b: &Rigid| -> Rigid { (a.0 * b.0, a.0 * b.1 + a.1) };
    let back = |a: &Rigid| -> Rigid { (a.0.transpose(), -(a.0.transpose() * a.1)) };
    let pose = |a: &Rigid| {
        let R = Rotation3::from_matrix_unchecked(a.0);
        Pose::from_parts(a.1.into(), nalgebra::UnitQuaternion::from_rotation_matrix(&R))
    };
    let (f, c) = (800.0, Vector2::new(319.5, 239.5));
    let intrinsics = Intrinsics { fx_px: f, fy_px: f, cx_px: c.x, cy_px: c.y, width_px: 640, height_px: 480 };
    let camera = CameraModel::new(intrinsics, Distortion::default()).unwrap();
    let (sd_px, sd_m, sd_rad) = (0.15, 0.8e-3, 1.2e-3);
    const TRIALS: u32 = 300;
    for place in PLACES {
        let (mut position_left, mut about_origin) = ([0.0; 2], 0.0);
        for trial in 0..TRIALS {
            let mut random = Random::new(70_000 + u64::from(trial));
            let mut any = |s: f64| Vector3::from_fn(|_, _| random.between(-s, s));
            // where the camera and the board are: M is the flange or the base, W the other one
            let (X_MC, X_WO): (Rigid, Rigid) = match place {
                CameraMount::EyeInHand => {
                    ((turn(any(0.5)), any(0.1)), (turn(any(0.4)), Vector3::new(0.6, 0.2, 0.0)))
                }
                CameraMount::EyeToHand => (
                    (turn(Vector3::new(0.2, -1.8, 0.1) + any(0.2)), Vector3::new(1.4, 0.3, 0.5)),
                    (turn(any(0.9)), any(0.1)),
                ),
            };
            let mut views = Vec::new();
            for _ in 0..12 {
                let mut any = |s: f64| Vector3::from_fn(|_, _| random.between(-s, s));
                let X_CO: Rigid = {
                    let R = turn(any(0.55)) * turn(Vector3::z() * any(1.2).x);
                    let middle = Vector3::new(0.08, 0.05, 0.0);
                    (R, any(0.04) + Vector3::z() * 0.55 - R * middle)
                };
                // the loop: X_WM X_MC X_CO = X_WO
                let X_WM = times(&times(&X_WO, &back(&X_CO)), &back(&X_MC));
                let truth = match place {
                    CameraMount::EyeInHand => X_WM,
                    CameraMount::EyeToHand => back(&X_WM),
                };
                let mut gauss = |s: f64| Vector3::from_fn(|_, _| random.gaussian() * s);
                let off: Rigid = (turn(gauss(sd_rad)), gauss(sd_m));
                let corners = (0..54)
                    .map(|i| {
                        let p_O = Point3::new(f64::from(i % 9) * 0.02, f64::from(i / 9) * 0.02, 0.0);
                        let p_C = X_CO.0 * p_O.coords + X_CO.1;
                        let noise = Vector2::new(random.gaussian(), random.gaussian()) * sd_px;
                        BoardCorner { p_O, px: p_C.xy() / p_C.z * f + c + noise, sd_px }
                    })
                    .collect();
                let X_BE = pose(&times(&truth, &off));
                views.push(HandEyeView { name: "view".into(), X_BE, V_BE_E: None, corners });
            }
            let robot = RobotSd { rotation_rad: sd_rad, translation_m: sd_m };
            let settings = JointSettings::least_squares(place, robot);
            let fit = refine_jointly(&all(&views), &camera, &settings, &pose(&X_MC), &pose(&X_WO)).unwrap();
            let found = [(fit.X_MC, fit.covariance_X_MC, X_MC), (fit.X_WO, fit.covariance_X_WO, X_WO)];
            for ((found, covariance, truth), sum) in found.into_iter().zip(&mut position_left) {
                let R = found.rotation.to_rotation_matrix().into_inner();
                // small turns: the antisymmetric part is the rotation vector
                let D = truth.0 * R.transpose();
                let w =
                    Vector3::new(D[(2, 1)] - D[(1, 2)], D[(0, 2)] - D[(2, 0)], D[(1, 0)] - D[(0, 1)]) * 0.5;
                let v = truth.1 - found.translation.vector;
                let size = |v: Vector3<f64>| {
                    let d = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
                    d.dot(&(covariance.try_inverse().unwrap() * d)) / f64::from(TRIALS)
                };
                *sum += size(v);
                if place == CameraMount::EyeToHand && truth == X_MC {
                    about_origin += size(v - w.cross(&truth.1));
                }
            }
        }
        // 6 degrees of freedom: standard error of the mean of 300 is 0.2
        assert!(position_left.iter().all(|chi| (chi - 6.0).abs() < 0.8), "{place:?} {position_left:?}");
        assert!(place == CameraMount::EyeInHand || about_origin > 12.0, "{about_origin}");
    }
}
