use super::super::{Correspondence, homography};
use super::*;
use crate::geometry::rotation_z;
use proptest::prelude::*;
use std::f64::consts::FRAC_PI_3;

fn compose(R: &Rotation3<f64>, p: &Vector3<f64>, n: &Vector3<f64>) -> Matrix3<f64> {
    R.matrix() + p * n.transpose()
}

fn distance(a: &HomographySolution, R: &Rotation3<f64>, p: &Vector3<f64>, n: &Vector3<f64>) -> f64 {
    (a.R_12.matrix() - R.matrix()).norm() + (a.p_12_1_over_d2 - p).norm() + (a.n_2 - n).norm()
}

fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-size..size).prop_map(Vector3::from)
}

proptest! {
    #[test]
    fn one_solution_is_the_truth_and_all_rebuild_h(
        w in vector(1.0), p in vector(0.5), tilt in prop::array::uniform2(-0.6..0.6f64), scale in 0.1..10.0f64
    ) {
        let (R, n) = (Rotation3::from_scaled_axis(w), Vector3::new(tilt[0], tilt[1], 1.0).normalize());
        let H = compose(&R, &p, &n);
        prop_assume!(H.determinant() > 0.05); // camera 1 on the same side
        prop_assume!(p.norm() > 0.05);
        for scale in [scale, -scale] {
            let solved = decompose_homography(&(H * scale)).unwrap();
            let all = [Some(solved.first), solved.second];
            let best = all.iter().flatten().map(|s| distance(s, &R, &p, &n)).fold(f64::INFINITY, f64::min);
            // Square roots of rounding errors where p is nearly parallel to n.
            prop_assert!(best < 1e-6, "{best}");
            for s in all.iter().flatten() {
                prop_assert!((compose(&s.R_12, &s.p_12_1_over_d2, &s.n_2) - H).norm() < 1e-9);
                prop_assert!((s.R_12.matrix().determinant() - 1.0).abs() < 1e-9);
                prop_assert!((s.R_12.matrix() * s.R_12.matrix().transpose() - Matrix3::identity()).norm() < 1e-9);
                prop_assert!((s.n_2.norm() - 1.0).abs() < 1e-12 && s.n_2.z >= 0.0);
            }
            prop_assert!(distance(&solved.nearest_normal(&n), &R, &p, &n) < 1e-6);
        }
    }

    #[test]
    fn pure_rotation(w in vector(1.5)) {
        let R = Rotation3::from_scaled_axis(w);
        let solved = decompose_homography(R.matrix()).unwrap();
        prop_assert!((solved.first.R_12.matrix() - R.matrix()).norm() < 1e-7);
        prop_assert!(solved.first.p_12_1_over_d2.norm() < 1e-7);
    }

    #[test]
    fn motion_along_the_normal_has_one_solution(angle in -3.0..3.0f64, gain in -0.7..2.0f64) {
        prop_assume!(gain.abs() > 1e-3);
        let (R, n) = (rotation_z(angle), Vector3::z());
        let solved = decompose_homography(&compose(&R, &(n * gain), &n)).unwrap();
        prop_assert!(solved.second.is_none());
        prop_assert!(distance(&solved.first, &R, &(n * gain), &n) < 1e-6);
    }
}

#[test]
fn example_10_5() {
    let s1 = [[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]];
    let s2 = [[-0.1667, 0.1667], [-0.0833, 0.0223], [0.0610, 0.1057], [-0.0223, 0.2500]];
    let points: Vec<_> =
        s1.iter().zip(s2).map(|(s, r)| Correspondence { r: r.into(), s: (*s).into() }).collect();
    let H = homography(&points).unwrap();
    let printed = Matrix3::new(0.3015, -0.5222, 0.1373, 0.5222, 0.3015, 0.0368, 0.0, 0.0, 0.5025).normalize();
    assert!((H - printed).abs().max() < 4e-3, "{H}"); // from coordinates of four digits
    let seen: Vec<_> = points.iter().map(|p| p.r).collect();
    let solved = decompose_homography_seen(&H, &seen).unwrap();
    let s = solved.nearest_normal(&Vector3::z());
    assert!((s.R_12.matrix() - rotation_z(FRAC_PI_3).matrix()).norm() < 1e-2, "{s:?}");
    // The third component is h33 - 1 = -0.1667; the text prints -0.0667.
    assert!((s.p_12_1_over_d2 - Vector3::new(0.2277, 0.0610, -0.1667)).norm() < 1e-2, "{s:?}");
    assert!((s.n_2 - Vector3::z()).norm() < 1e-2);
    let without = decompose_homography(&H).unwrap().nearest_normal(&Vector3::z());
    assert_eq!(without, s);

    // The same at full precision: images of the four points through the exact H agree with the printed ones.
    let (R, p, n) = (rotation_z(FRAC_PI_3), Vector3::new(0.2277, 0.0610, -1.0 / 6.0), Vector3::z());
    let back = compose(&R, &p, &n).try_inverse().unwrap();
    let exact: Vec<_> = points
        .iter()
        .map(|c| {
            let r = back * Vector3::new(c.s.x, c.s.y, 1.0);
            Correspondence { r: r.xy() / r.z, ..*c }
        })
        .collect();
    assert!(exact.iter().zip(&points).all(|(a, b)| (a.r - b.r).norm() < 1e-3), "{exact:?}");
    let solved = decompose_homography(&homography(&exact).unwrap()).unwrap();
    assert!(distance(&solved.nearest_normal(&n), &R, &p, &n) < 1e-9);
}

#[test]
fn points_choose_the_sign_and_drop_what_they_cannot_have_seen() {
    // A plane seen at the left edge only: its normal has n_z < 0, which the optical axis would not choose.
    let n = Vector3::new(-1.0, 0.0, -0.1).normalize();
    let (R, p) = (Rotation3::from_scaled_axis(Vector3::new(0.1, 0.2, -0.1)), Vector3::new(0.1, 0.3, 0.1));
    let H = compose(&R, &p, &n);
    let solved = decompose_homography_seen(&H, &[Vector2::new(-0.5, 0.0), Vector2::new(-0.6, 0.1)]).unwrap();
    let all = [Some(solved.first), solved.second];
    assert!(all.iter().flatten().any(|s| distance(s, &R, &p, &n) < 1e-9));
    assert!(all.iter().flatten().all(|s| s.sees(&Vector2::new(-0.5, 0.0))));
    // Far points in all directions: no plane shows them all.
    let around = [[9.0, 0.0], [-9.0, 0.0], [0.0, 9.0], [0.0, -9.0]].map(Vector2::from);
    assert_eq!(decompose_homography_seen(&H, &around), Err(PoseError::BehindCamera));
}

#[test]
fn bad_matrices_are_refused() {
    assert_eq!(
        decompose_homography(&Matrix3::from_element(f64::NAN)),
        Err(PoseError::NotFinite { index: 0 })
    );
    assert_eq!(decompose_homography(&Matrix3::zeros()), Err(PoseError::Degenerate));
    assert_eq!(decompose_homography(&Matrix3::from_element(1.0)), Err(PoseError::Degenerate));
}
