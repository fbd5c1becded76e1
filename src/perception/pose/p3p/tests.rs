use super::super::testing::{gap, poses, see_3d};
use super::super::{Correspondence3, reprojection_rms};
use super::*;
use crate::linalg::Random;
use nalgebra::{Point3, Vector2};
use proptest::prelude::*;

fn three(points: &[Correspondence3]) -> [Correspondence3; 3] {
    [points[0], points[1], points[2]]
}

/// All solutions by brute force: the depths along the first ray are scanned, those of the others follow from the two
/// sides that meet in the first point, and the sign changes of the third side are bisected.
fn scanned(points: &[Correspondence3; 3]) -> Vec<[f64; 3]> {
    let s = points.map(|p| Vector3::new(p.s.x, p.s.y, 1.0));
    let side = |i: usize, j: usize| (points[i].r - points[j].r).norm_squared();
    let second = |x: f64, j: usize, sign: f64| {
        let (n, c, m) = (s[j].norm_squared(), s[0].dot(&s[j]), s[0].norm_squared());
        let root = (c * c * x * x - n * (m * x * x - side(0, j))).sqrt();
        (c * x + sign * root) / n
    };
    let mut found = Vec::new();
    for (a, b) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let rest = |x: f64| {
            let (y, z) = (second(x, 1, a), second(x, 2, b));
            (s[1] * y - s[2] * z).norm_squared() - side(1, 2)
        };
        let most = 3.0;
        let steps = 20_000;
        let at = |i: usize| most * i as f64 / f64::from(steps);
        for i in 1..steps as usize {
            let (mut low, mut high) = (at(i), at(i + 1));
            if rest(low) * rest(high) <= 0.0 {
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if rest(low) * rest(middle) <= 0.0 { high = middle } else { low = middle }
                }
                let z = [low, second(low, 1, a), second(low, 2, b)];
                if z.iter().all(|z| *z > 0.0) && rest(low).abs() < 1e-9 {
                    found.push(z);
                }
            }
        }
    }
    found
}

proptest! {
    #[test]
    fn the_truth_is_among_them_and_all_fit(X in poses(1.5), r in prop::array::uniform9(-0.1..0.1f64)) {
        let object: Vec<_> = r.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        let points = three(&see_3d(&X, &object, || 0.0));
        let n = (points[0].r - points[1].r).cross(&(points[0].r - points[2].r)).norm();
        prop_assume!(n > 1e-4 && points.iter().all(|p| (X * p.r).z > 0.05));
        let found = p3p(&points).unwrap();
        let best = found.as_slice().iter().map(|P| gap(P, &X)).fold(f64::INFINITY, f64::min);
        prop_assert!(best < 1e-5, "{best}");
        for P in found.as_slice() {
            prop_assert!(reprojection_rms(P, &points) < 1e-8, "{}", reprojection_rms(P, &points));
        }
    }

    #[test]
    fn never_panics(x in prop::array::uniform15(-1.0..1.0f64)) {
        let points: [_; 3] = std::array::from_fn(|i| Correspondence3 {
            r: Point3::new(x[5 * i], x[5 * i + 1], x[5 * i + 2]),
            s: Vector2::new(x[5 * i + 3], x[5 * i + 4]),
        });
        if let Ok(found) = p3p(&points) {
            prop_assert!(!found.as_slice().is_empty());
            for P in found.as_slice() {
                prop_assert!(reprojection_rms(P, &points) < 1e-6);
            }
        }
    }
}

#[test]
fn a_million_random_triangles_keep_their_truth() {
    let mut random = Random::new(3);
    let (mut worst, mut lost, mut bad) = (0.0_f64, 0, 0);
    let count = 100_000;
    for _ in 0..count {
        let mut p =
            || Vector3::new(random.between(-1.0, 1.0), random.between(-1.0, 1.0), random.between(0.1, 2.0));
        let c = [p(), p(), p()];
        let X = Pose::new(p(), p());
        let points = c.map(|c| Correspondence3 { r: X.inverse() * Point3::from(c), s: c.xy() / c.z });
        let n = (c[0] - c[1]).cross(&(c[0] - c[2])).norm();
        let Ok(found) = p3p(&points) else {
            lost += i32::from(n > 1e-3);
            continue;
        };
        let best = found.as_slice().iter().map(|P| gap(P, &X)).fold(f64::INFINITY, f64::min);
        worst = worst.max(if n > 1e-3 { best } else { 0.0 });
        bad += i32::from(best > 1e-6);
    }
    assert!(lost == 0 && bad <= 3, "{lost} lost, {bad} of {count} worse than 1e-6, worst {worst:e}");
}

#[test]
fn as_many_as_a_scan_of_the_depths_finds() {
    let mut random = Random::new(11);
    let mut counts = [0; 5];
    for _ in 0..60 {
        let mut p =
            || Vector3::new(random.between(-0.5, 0.5), random.between(-0.5, 0.5), random.between(0.4, 1.6));
        let c = [p(), p(), p()];
        let points = c.map(|c| Correspondence3 { r: Point3::from(c), s: c.xy() / c.z });
        let expected = scanned(&points);
        let found = p3p(&points).unwrap();
        counts[found.as_slice().len()] += 1;
        let depth = |P: &Pose| points.map(|p| (P * p.r).z);
        for z in &expected {
            let hit = found.as_slice().iter().any(|P| (0..3).all(|i| (depth(P)[i] - z[i]).abs() < 1e-5));
            assert!(hit, "{z:?} is missing");
        }
        assert!(found.as_slice().len() >= expected.len());
    }
    assert!(counts[2] > 10 && counts[4] > 1, "{counts:?}");
}

#[test]
fn symmetric_triangles() {
    // Equilateral, seen along its normal: three further solutions by symmetry. Isosceles, seen from its plane of symmetry.
    let h = 0.75_f64.sqrt();
    for tilt in [0.0, 0.2, 0.5, 0.9] {
        for object in [
            [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.05, 0.1 * h, 0.0]],
            [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]],
            [[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.2, 0.0]],
        ] {
            let center = [0, 1].map(|k| -object.iter().map(|r| r[k]).sum::<f64>() / 3.0);
            let X = Pose::translation(0.0, 0.0, 0.3)
                * Pose::rotation(Vector3::x() * tilt)
                * Pose::translation(center[0], center[1], 0.0);
            let points = three(&see_3d(&X, &object, || 0.0));
            let found = p3p(&points).unwrap();
            let best = found.as_slice().iter().map(|P| gap(P, &X)).fold(f64::INFINITY, f64::min);
            assert!(best < 1e-6, "{tilt} {object:?}: {best}");
        }
    }
}

#[test]
fn bad_input_is_refused() {
    let X = Pose::translation(0.0, 0.0, 0.5);
    let mut points = three(&see_3d(&X, &[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]], || 0.0));
    assert_eq!(p3p(&points), Err(PoseError::Degenerate));
    points[2].r = points[1].r;
    assert_eq!(p3p(&points), Err(PoseError::Degenerate));
    points[2].r.y = f64::NAN;
    assert_eq!(p3p(&points), Err(PoseError::NotFinite { index: 2 }));
    // All on one ray.
    points[2].r = Point3::new(0.0, 0.1, 0.0);
    assert!(p3p(&points.map(|p| Correspondence3 { s: Vector2::zeros(), ..p })).is_err());
}
