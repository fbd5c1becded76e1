use super::super::refine_3d;
use super::super::testing::{gap, gauss, poses, see_3d, tilted};
use super::*;
use proptest::prelude::*;

fn cloud(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut x = gauss(seed);
    (0..count).map(|_| [0.03 * x(), 0.03 * x(), 0.03 * x()]).collect()
}

proptest! {
    #[test]
    fn exact_points_give_the_pose(X in poses(3.0), n in 6..20_usize, seed in 1..1000_u64) {
        let X = Pose::translation(0.0, 0.0, 0.5) * X;
        let points = see_3d(&X, &cloud(n, seed), || 0.0);
        let solved = dlt_pose(&points).unwrap();
        prop_assert!(gap(&solved, &X) < 1e-6, "{}", gap(&solved, &X));
        let refined = refine_3d(&solved, &points, 1e-4).unwrap();
        prop_assert!(gap(&refined.X_CO, &X) < 1e-9);
    }
}

#[test]
fn noise_leaves_a_start_that_refines() {
    let X = tilted([0.05, -0.05, 0.6], 0.4, 2.5, 0.3);
    let mut noise = gauss(4);
    for seed in 1..50 {
        let points = see_3d(&X, &cloud(20, seed), || 1e-4 * noise());
        let start = dlt_pose(&points).unwrap();
        let end = refine_3d(&start, &points, 1e-4).unwrap();
        assert!(gap(&end.X_CO, &X) < 0.004, "{}", gap(&end.X_CO, &X));
        assert!(gap(&start, &X) < 0.03, "{}", gap(&start, &X));
    }
}

#[test]
fn bad_sets_are_refused() {
    let X = tilted([0.0, 0.0, 0.5], 0.4, 0.5, 0.0);
    let mut points = see_3d(&X, &cloud(8, 3), || 0.0);
    assert_eq!(dlt_pose(&points[..5]), Err(PoseError::TooFewPoints { needed: 6, given: 5 }));
    points[7].r.z = f64::NAN;
    assert_eq!(dlt_pose(&points), Err(PoseError::NotFinite { index: 7 }));
    let flat: Vec<_> = cloud(9, 5).iter().map(|r| [r[0], r[1], 0.3 * r[0] - 0.2 * r[1]]).collect();
    assert_eq!(dlt_pose(&see_3d(&X, &flat, || 0.0)), Err(PoseError::Degenerate));
    assert_eq!(dlt_pose(&see_3d(&X, &[[0.0, 0.0, 0.1]; 7], || 0.0)), Err(PoseError::Degenerate));
}
