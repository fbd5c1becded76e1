use super::super::testing::{SQUARE, gap, gauss, grid, poses, see, tilted};
use super::*;
use nalgebra::Vector2;
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// H = [r1 r2 p] of (10.8) with unit norm.
fn truth(X: &Pose) -> Matrix3<f64> {
    let R = X.rotation.to_rotation_matrix();
    let columns =
        [R.matrix().column(0).into_owned(), R.matrix().column(1).into_owned(), X.translation.vector];
    Matrix3::from_columns(&columns).normalize()
}

fn pair(r: [f64; 2], s: [f64; 2]) -> Correspondence {
    Correspondence { r: Vector2::from(r), s: Vector2::from(s) }
}

proptest! {
    #[test]
    fn exact_points_give_the_homography(X in poses(1.2), n in 2..8_usize) {
        let H = homography(&see(&X, &grid(n), || 0.0)).unwrap();
        prop_assert!((H - truth(&X)).norm() < 1e-11, "{}", (H - truth(&X)).norm());
        prop_assert!((H.norm() - 1.0).abs() < 1e-14);
        prop_assert!(gap(&pose_from_homography(&H).unwrap(), &X) < 1e-9);
    }

    #[test]
    fn four_points_are_met_exactly(x in prop::array::uniform16(-1.0..1.0f64)) {
        let points: Vec<_> = x.chunks(4).map(|c| pair([c[0], c[1]], [c[2], c[3]])).collect();
        if let Ok(H) = homography(&points) {
            for p in &points {
                let image = H * Vector3::new(p.r.x, p.r.y, 1.0);
                prop_assert!(image.z > 0.0);
                let off = (image.x - p.s.x * image.z).abs() + (image.y - p.s.y * image.z).abs();
                prop_assert!(off < 1e-13, "{off}"); // algebraic error, as image.z may be tiny
            }
        }
    }

    #[test]
    fn rotation_is_the_closest_one(h in prop::array::uniform9(-1.0..1.0f64)) {
        let H = Matrix3::from_row_slice(&h);
        let columns = H.fixed_columns::<2>(0).into_owned();
        let singular = columns.svd(false, false).singular_values;
        prop_assume!(singular[1] > 0.05);
        let zeta = 2.0 / (singular[0] + singular[1]);
        let (r1, r2) = (columns.column(0) * zeta, columns.column(1) * zeta);
        let Q = Matrix3::from_columns(&[r1.into_owned(), r2.into_owned(), r1.cross(&r2)]);
        let X = pose_from_homography(&H).unwrap();
        let R = X.rotation.to_rotation_matrix();
        prop_assert!((R.matrix() - closest_rotation(&Q).unwrap().matrix()).norm() < 1e-10);
        prop_assert!((X.translation.vector - H.column(2) * zeta).norm() < 1e-12);
    }

    #[test]
    fn pixels_serve_as_well(X in poses(1.0), n in 2..5_usize) {
        // (10.64), (10.65): H' = Omega H.
        let Omega = Matrix3::new(800.0, 0.0, 320.0, 0.0, 810.0, 240.0, 0.0, 0.0, 1.0);
        let mut points = see(&X, &grid(n), || 0.0);
        for p in &mut points {
            p.s = Vector2::new(800.0 * p.s.x + 320.0, 810.0 * p.s.y + 240.0);
        }
        let expected = (Omega * truth(&X)).normalize();
        prop_assert!((homography(&points).unwrap() - expected).norm() < 1e-10);
    }
}

#[test]
fn example_10_1_up_to_scale() {
    let X = tilted([0.0, 0.0, 0.5], FRAC_PI_2, FRAC_PI_4, 0.0);
    let H = homography(&see(&X, &SQUARE, || 0.0)).unwrap();
    // The text has the opposite sign, before it is chosen for the object in front.
    let printed = -Matrix3::new(-0.4714, 0.0, 0.0, 0.0, -0.6667, 0.0, 0.4714, 0.0, -0.3333);
    assert!((H - printed).abs().max() < 1e-4, "{H}");
    assert!((1.0 / H.column(0).norm() - 1.5).abs() < 1e-9); // zeta
}

#[test]
fn noise_averages_out_over_many_points() {
    let X = tilted([0.02, -0.01, 0.5], 0.4, 0.5, 1.0);
    let (mut few, mut many, mut noise) = (0.0, 0.0, gauss(1));
    for _ in 0..50 {
        few += (homography(&see(&X, &grid(2), || 1e-4 * noise())).unwrap() - truth(&X)).norm();
        many += (homography(&see(&X, &grid(8), || 1e-4 * noise())).unwrap() - truth(&X)).norm();
    }
    assert!(few / 50.0 < 0.007 && many < 0.5 * few, "{few} {many}");
}

#[test]
fn degenerate_sets_are_refused() {
    let X = tilted([0.0, 0.0, 0.5], 0.3, 0.6, 0.0);
    let solve = |plane: &[[f64; 2]]| homography(&see(&X, plane, || 0.0));
    // Three of four on a line; a repeated point; all on a line; four of five on a line.
    assert_eq!(solve(&[[0.0, 0.0], [0.05, 0.05], [0.1, 0.1], [0.0, 0.1]]), Err(PoseError::Degenerate));
    assert_eq!(solve(&[[0.0, 0.0], [0.0, 0.0], [0.1, 0.1], [0.0, 0.1]]), Err(PoseError::Degenerate));
    let line: Vec<_> = (0..7).map(|i| [0.01 * f64::from(i), 0.02 * f64::from(i)]).collect();
    assert_eq!(solve(&line), Err(PoseError::Degenerate));
    let mut almost = line[..4].to_vec();
    almost.push([0.1, -0.05]);
    assert_eq!(solve(&almost), Err(PoseError::Degenerate));
    assert_eq!(solve(&[[0.01, 0.02]; 6]), Err(PoseError::Degenerate));
    // Three of five on a line leave the solution unique.
    assert!(solve(&[[0.0, 0.0], [0.05, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]).is_ok());
    // The image may be the degenerate part: all points on one ray.
    let point = pair([0.0, 0.0], [0.1, 0.1]);
    let stuck: Vec<_> = SQUARE.iter().map(|r| Correspondence { r: Vector2::from(*r), ..point }).collect();
    assert_eq!(homography(&stuck), Err(PoseError::Degenerate));
    assert!(pose_from_homography(&Matrix3::zeros()).is_none());
    assert!(pose_from_homography(&Matrix3::from_element(f64::NAN)).is_none());
}

#[test]
fn counts_and_numbers_are_checked() {
    let X = tilted([0.0, 0.0, 0.5], 0.3, 0.6, 0.0);
    let mut points = see(&X, &grid(3), || 0.0);
    assert_eq!(homography(&points[..3]), Err(PoseError::TooFewPoints { needed: 4, given: 3 }));
    assert_eq!(homography(&[]), Err(PoseError::TooFewPoints { needed: 4, given: 0 }));
    points[5].r.x = f64::INFINITY;
    assert_eq!(homography(&points), Err(PoseError::NotFinite { index: 5 }));
}

#[test]
fn points_on_both_sides_of_the_camera_are_refused() {
    // The plane z = 1 + 12 x cuts the camera's own plane between the points.
    let image = |r: [f64; 2]| {
        let z = 1.0 + 12.0 * r[0];
        pair(r, [r[0] / z, r[1] / z])
    };
    let corners = [[-0.2, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.2, 0.1]];
    assert_eq!(homography(&corners.map(image)), Err(PoseError::BehindCamera));
    let more = [[-0.2, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.2, 0.1], [0.0, 0.03], [0.05, -0.02]];
    assert_eq!(homography(&more.map(image)), Err(PoseError::BehindCamera));
}
