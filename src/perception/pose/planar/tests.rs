use super::super::testing::{SQUARE, gap, gauss, grid, poses, see, tilted};
use super::super::{refine, reprojection_rms};
use super::*;
use nalgebra::Vector2;
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

proptest! {
    #[test]
    fn poses_come_back(X_CO in poses(1.2), n in 2..7_usize) {
        let solved = planar_pose(&see(&X_CO, &grid(n), || 0.0)).unwrap();
        prop_assert!(gap(&solved.best.X_CO, &X_CO) < 1e-9, "{}", gap(&solved.best.X_CO, &X_CO));
        prop_assert!(solved.best.rms < 1e-12);
    }

    #[test]
    fn any_quadrangle_will_do(X_CO in poses(1.0), corners in prop::array::uniform8(-0.018..0.018f64)) {
        let plane: Vec<_> = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]
            .iter().zip(corners.chunks(2)).map(|(r, d)| [r[0] + d[0], r[1] + d[1]]).collect();
        let solved = planar_pose(&see(&X_CO, &plane, || 0.0)).unwrap();
        prop_assert!(gap(&solved.best.X_CO, &X_CO) < 1e-9, "{}", gap(&solved.best.X_CO, &X_CO));
    }

    #[test]
    fn the_object_may_lie_far_from_its_origin(X_CO in poses(1.0), shift in prop::array::uniform2(-20.0..20.0f64)) {
        let plane: Vec<_> = grid(3).iter().map(|r| [r[0] + shift[0], r[1] + shift[1]]).collect();
        // The frame is moved so that the points stay in view.
        let X_CO = X_CO * Pose::translation(-shift[0], -shift[1], 0.0);
        let solved = planar_pose(&see(&X_CO, &plane, || 0.0)).unwrap();
        prop_assert!(gap(&solved.best.X_CO, &X_CO) < 1e-7, "{}", gap(&solved.best.X_CO, &X_CO));
    }

    #[test]
    fn never_panics(x in prop::collection::vec(prop::array::uniform4(-1.0..1.0f64), 0..9)) {
        let points: Vec<_> = x.iter()
            .map(|[a, b, c, d]| Correspondence { r: Vector2::new(*a, *b), s: Vector2::new(*c, *d) })
            .collect();
        if let Ok(solved) = planar_pose(&points) {
            prop_assert!(solved.best.X_CO.translation.vector.iter().all(|x| x.is_finite()));
            prop_assert!((reprojection_rms(&solved.best.X_CO, &points) - solved.best.rms).abs() < 1e-9);
            prop_assert!(solved.other.is_none_or(|other| other.rms >= solved.best.rms));
        }
    }
}

#[test]
fn example_10_1() {
    let s = [[0.0, 0.0], [0.1647, 0.0], [0.1647, 0.2329], [0.0, 0.2]];
    let one = |(r, s): (&[f64; 2], [f64; 2])| Correspondence { r: Vector2::from(*r), s: s.into() };
    let points: Vec<_> = SQUARE.iter().zip(s).map(one).collect();
    let truth = tilted([0.0, 0.0, 0.5], FRAC_PI_2, FRAC_PI_4, 0.0);
    let solved = planar_pose(&points).unwrap();
    assert!(gap(&solved.best.X_CO, &truth) < 2e-3, "{solved:?}"); // the text prints four digits
    let exact = planar_pose(&see(&truth, &SQUARE, || 0.0)).unwrap();
    assert!(gap(&exact.best.X_CO, &truth) < 1e-12);
}

#[test]
fn tilts_up_to_80_degrees() {
    let mut noise = gauss(3);
    for tilt_deg in (0..=80).step_by(5) {
        for k in 0..24 {
            let azimuth = f64::from(k) * 0.26;
            let X = tilted([0.05, -0.03, 0.5], azimuth, f64::from(tilt_deg).to_radians(), 0.4);
            let exact = planar_pose(&see(&X, &grid(2), || 0.0)).unwrap();
            assert!(gap(&exact.best.X_CO, &X) < 1e-9, "{tilt_deg} deg: {exact:?}");
            // 0.03 px at f = 800 px.
            let seen = planar_pose(&see(&X, &grid(2), || 4e-5 * noise())).unwrap();
            // Seen from the front a tilt hardly shows.
            let most = if tilt_deg < 15 { 0.01 } else { 0.004 };
            assert!(gap(&seen.best.X_CO, &X) < most, "{tilt_deg} deg: {}", gap(&seen.best.X_CO, &X));
        }
    }
}

#[test]
fn frontal_view_has_no_second_solution() {
    for spin in [-2.0, 0.0, 0.3, 1.5] {
        let X = tilted([0.0, 0.0, 0.5], 0.0, 0.0, spin);
        let solved = planar_pose(&see(&X, &grid(2), || 0.0)).unwrap();
        assert!(solved.other.is_none(), "{solved:?}");
        assert!(gap(&solved.best.X_CO, &X) < 1e-9);
    }
}

#[test]
fn both_planar_solutions_ranked_right_at_low_noise() {
    let mut noise = gauss(11);
    let mut pairs = 0;
    for k in 0..200 {
        let tilt = 0.4 + 0.003 * f64::from(k);
        let X = tilted([0.02, 0.03, 0.6], f64::from(k), tilt, 0.2);
        let points = see(&X, &grid(2), || 2e-5 * noise());
        let solved = planar_pose(&points).unwrap();
        assert!(solved.best.X_CO.rotation.angle_to(&X.rotation) < 2e-3);
        if let Some(other) = solved.other {
            pairs += 1;
            assert!(other.rms > solved.best.rms);
            assert_eq!(solved.nearest(&other.X_CO), other);
            assert_eq!(solved.nearest(&X), solved.best);
            // The second is a minimum of its own: a refinement started there stays.
            let stays = refine(&other.X_CO, &points, 1e-5).unwrap();
            assert!(gap(&stays.X_CO, &other.X_CO) < 1e-4);
            // It shows the plane tilted the other way: far from the first, normals on both sides of the ray.
            assert!(other.X_CO.rotation.angle_to(&X.rotation) > 0.3);
            let ray = X.translation.vector.normalize();
            let normal = |P: &Pose| P.rotation * Vector3::z();
            let (a, b) = (normal(&solved.best.X_CO), normal(&other.X_CO));
            let side = |n: Vector3<f64>| n - ray * n.dot(&ray);
            assert!(side(a).dot(&side(b)) < 0.0);
        }
    }
    assert!(pairs > 195, "{pairs}");
}

#[test]
fn never_worse_than_a_refinement_from_the_truth() {
    for (n, distance) in [(2, 0.4), (2, 1.5), (2, 5.0), (4, 1.5)] {
        for sd in [1e-5, 1e-4, 1e-3] {
            let mut noise = gauss(5);
            for k in 0..100 {
                let tilt = 0.012 * f64::from(k % 100);
                let X = tilted([0.05, -0.02, distance], f64::from(k) * 0.7, tilt, f64::from(k));
                let points = see(&X, &grid(n), || sd * noise());
                let Ok(reference) = refine(&X, &points, sd) else { continue };
                let Ok(solved) = planar_pose(&points) else {
                    assert!(sd * distance > 1e-3, "refused at sd {sd}, {distance} m");
                    continue;
                };
                assert!(solved.best.rms <= reference.rms * (1.0 + 1e-6), "{n} {distance} {sd} {k}");
            }
        }
    }
}

#[test]
fn bad_input_is_refused() {
    let X = tilted([0.0, 0.0, 0.5], 0.3, 0.6, 0.0);
    let mut points = see(&X, &SQUARE, || 0.0);
    assert_eq!(planar_pose(&points[..3]), Err(PoseError::TooFewPoints { needed: 4, given: 3 }));
    points[2].s.y = f64::NAN;
    assert_eq!(planar_pose(&points), Err(PoseError::NotFinite { index: 2 }));
    points[2] = points[1];
    assert_eq!(planar_pose(&points), Err(PoseError::Degenerate));
}

#[test]
fn nine_points_with_collinear_triplets_are_fine() {
    let X = tilted([0.01, 0.02, 0.4], 1.0, 0.7, 0.5);
    let solved = planar_pose(&see(&X, &grid(3), || 0.0)).unwrap();
    assert!(gap(&solved.best.X_CO, &X) < 1e-10);
}

#[test]
fn every_minimum_near_a_frontal_view_is_one_of_the_two() {
    let (mut pairs, mut tried) = (0, 0);
    for (n, distance) in [(2, 0.5), (2, 1.0), (3, 0.5)] {
        for k in 0..120 {
            let mut noise = gauss(100 + k);
            let X = tilted([0.03, -0.02, distance], k as f64, 0.002 * k as f64, 0.5 * k as f64);
            let points = see(&X, &grid(n), || 6e-4 * noise());
            let solved = planar_pose(&points).unwrap();
            let known =
                |P: &Pose| [Some(solved.best), solved.other].iter().flatten().any(|s| gap(&s.X_CO, P) < 2e-3);
            for j in 0..16 {
                // Tilts all around, up to half a right angle.
                let start = tilted(X.translation.vector.into(), j as f64, 0.05 * j as f64, 0.0);
                let q = start.rotation * UnitQuaternion::from_euler_angles(0.0, 0.0, 0.5 * k as f64);
                let start = Pose::from_parts(X.translation, q);
                let Ok(end) = refine(&start, &points, 1e-4) else { continue };
                // Ridges between two minima are no minima: a start that ends there is pushed off.
                let pushed = tilted([0.0; 3], j as f64, 0.01, 0.0);
                let pushed = Pose::from_parts(end.X_CO.translation, pushed.rotation * end.X_CO.rotation);
                let Ok(end) = refine(&pushed, &points, 1e-4) else { continue };
                tried += 1;
                assert!(known(&end.X_CO), "{n} {distance} {k}: {solved:?} and {end:?}");
            }
            pairs += i32::from(solved.other.is_some());
        }
    }
    assert!(pairs > 20 && tried > 4000, "{pairs} {tried}");
}
