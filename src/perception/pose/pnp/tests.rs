use super::super::testing::{gap, gauss, poses, see_3d};
use super::super::{Correspondence3, refine_3d, reprojection_rms};
use super::*;
use crate::geometry::Pose;
use crate::linalg::Random;
use nalgebra::{Point3, UnitQuaternion};
use proptest::prelude::*;

proptest! {
    #[test]
    fn poses_come_back(X in poses(1.5), n in 4..20_usize, seed in 0..1000_u64, flat in 0..3) {
        let mut random = Random::new(seed);
        // A cloud, a plane anywhere in the object's frame, or nearly a plane.
        let R = UnitQuaternion::from_euler_angles(random.uniform(), random.uniform(), random.uniform());
        let thickness = [0.1, 0.0, 1e-4][flat as usize];
        let object: Vec<[f64; 3]> = (0..n).map(|_| {
            let r = nalgebra::Vector3::new(random.between(-0.1, 0.1), random.between(-0.1, 0.1), thickness * random.between(-1.0, 1.0));
            (R * r).into()
        }).collect();
        let points = see_3d(&X, &object, || 0.0);
        prop_assume!(points.iter().all(|p| (X * p.r).z > 0.05));
        let found = pnp(&points).unwrap();
        prop_assert!(found.as_slice().iter().any(|s| gap(&s.X_CO, &X) < 1e-6), "{found:?}");
        prop_assert!(found.best().rms < 1e-10);
    }

    #[test]
    fn never_panics(x in prop::collection::vec(prop::array::uniform5(-1.0..1.0f64), 0..9)) {
        let points: Vec<_> = x.iter()
            .map(|[a, b, c, d, e]| Correspondence3 { r: Point3::new(*a, *b, *c), s: Vector2::new(*d, *e) })
            .collect();
        if let Ok(found) = pnp(&points) {
            prop_assert!(found.as_slice().is_sorted_by(|a, b| a.rms <= b.rms));
            for solution in found.as_slice() {
                prop_assert!((reprojection_rms(&solution.X_CO, &points) - solution.rms).abs() < 1e-9 * (1.0 + solution.rms));
            }
        }
    }
}

#[test]
fn no_minimum_is_lower_than_the_first() {
    for n in [4, 5, 6, 8, 16] {
        let mut random = Random::new(n as u64);
        for k in 0..40 {
            let mut noise = gauss(1 + k);
            let object: Vec<[f64; 3]> =
                (0..n).map(|_| [(); 3].map(|()| random.between(-0.15, 0.15))).collect();
            let q = UnitQuaternion::from_scaled_axis(nalgebra::Vector3::from(
                [(); 3].map(|()| random.between(-3.0, 3.0)),
            ));
            let X = Pose::from_parts([0.05, -0.04, random.between(0.5, 1.5)].into(), q);
            let points = see_3d(&X, &object, || 2.5e-3 * noise());
            let found = pnp(&points).unwrap();
            // Refinements from rotations all over, at the position that puts the points in front.
            let mut least = f64::INFINITY;
            for _ in 0..100 {
                let w = nalgebra::Vector3::from([(); 3].map(|()| random.between(-3.2, 3.2)));
                let start = Pose::from_parts(X.translation, UnitQuaternion::from_scaled_axis(w));
                if let Ok(end) = refine_3d(&start, &points, 1e-3) {
                    least = least.min(end.rms);
                }
            }
            assert!(found.best().rms <= least * (1.0 + 1e-6), "{n} {k}: {} {least}", found.best().rms);
        }
    }
}

#[test]
fn three_points_give_all_solutions() {
    let object = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.05, 0.08, 0.0]];
    let X = Pose::new([-0.03, -0.02, 0.4].into(), [0.3, -0.2, 0.5].into());
    let found = pnp(&see_3d(&X, &object, || 0.0)).unwrap();
    assert!(found.as_slice().len() >= 2 && found.as_slice().iter().all(|s| s.rms < 1e-10));
    assert!(gap(&found.nearest(&X).X_CO, &X) < 1e-8);
}

#[test]
fn bad_input_is_refused() {
    let X = Pose::translation(0.0, 0.0, 0.5);
    let line: Vec<_> = (0..5).map(|i| [0.02 * f64::from(i), 0.01 * f64::from(i), 0.0]).collect();
    let points = see_3d(&X, &line, || 0.0);
    assert_eq!(pnp(&points), Err(PoseError::Degenerate));
    assert_eq!(pnp(&points[..2]), Err(PoseError::TooFewPoints { needed: 3, given: 2 }));
    let cloud = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [0.1, 0.1, 0.05]];
    let points = see_3d(&X, &cloud, || 0.0);
    let one_ray: Vec<_> =
        points.iter().map(|p| Correspondence3 { s: Vector2::new(0.1, 0.1), ..*p }).collect();
    assert_eq!(pnp(&one_ray), Err(PoseError::Degenerate));
    let mut bad = points.clone();
    bad[4].r.z = f64::INFINITY;
    assert_eq!(pnp(&bad), Err(PoseError::NotFinite { index: 4 }));
}

#[test]
fn three_of_four_points_on_a_line_in_a_plane() {
    // No homography, but a pose.
    let X = Pose::new([-0.03, -0.02, 0.4].into(), [0.3, -0.2, 0.5].into());
    let points = see_3d(&X, &[[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.1, 0.0, 0.0], [0.03, 0.08, 0.0]], || 0.0);
    let found = pnp(&points).unwrap();
    assert!(found.as_slice().iter().any(|s| gap(&s.X_CO, &X) < 1e-7), "{found:?}");
}

#[test]
fn example_10_1_to_rounding() {
    let object = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]];
    let quarter = std::f64::consts::FRAC_PI_4;
    let X = Pose::new([0.0, 0.0, 0.5].into(), [0.0, quarter, 0.0].into());
    let points = see_3d(&X, &object, || 0.0);
    let printed = [[0.0, 0.0], [0.1647, 0.0], [0.1647, 0.2329], [0.0, 0.2]];
    assert!(points.iter().zip(printed).all(|(p, s)| (p.s - Vector2::from(s)).abs().max() < 5e-5));
    assert!(gap(&pnp(&points).unwrap().best().X_CO, &X) < 1e-9);
    // Any three of its corners have the truth among their solutions.
    for skip in 0..4 {
        let three: Vec<_> = (0..4).filter(|i| *i != skip).map(|i| points[i]).collect();
        let found = pnp(&three).unwrap();
        assert!(gap(&found.nearest(&X).X_CO, &X) < 1e-9, "{skip}: {found:?}");
    }
}
