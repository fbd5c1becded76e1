use super::*;
use crate::features::{EllipseFeature, FeatureStack, SegmentFeature, StackError, solve_twist};
use crate::geometry::{Pose, integrate_body_twist};
use crate::imaging::Moments;
use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion};
use proptest::prelude::*;

const H: f64 = 1e-5;
const ARROW: [[f64; 2]; 7] = [
    [-0.05, -0.012],
    [0.01, -0.012],
    [0.01, -0.03],
    [0.05, 0.0],
    [0.01, 0.036],
    [0.01, 0.012],
    [-0.05, 0.012],
];

/// The image of a polygon in the plane z = 0 of its frame.
fn image(X_CO: &Pose, corners: &[[f64; 2]]) -> Vec<Vector2<f64>> {
    let project = |c: &[f64; 2]| {
        let p = X_CO * Point3::new(c[0], c[1], 0.0);
        Vector2::new(p.x, p.y) / p.z
    };
    corners.iter().map(project).collect()
}

/// `[A, B, C]` of the object's plane.
fn plane(X_CO: &Pose) -> Vector3<f64> {
    let n = X_CO.rotation * Vector3::z();
    n / n.dot(&X_CO.translation.vector)
}

fn pose(at: [f64; 3], turn: [f64; 3]) -> Pose {
    let R = Rotation3::from_scaled_axis(Vector3::from(turn));
    Pose::from_parts(Translation3::from(at), UnitQuaternion::from_rotation_matrix(&R))
}

fn differences<const K: usize>(X_CO: &Pose, s: impl Fn(&Pose) -> SVector<f64, K>) -> SMatrix<f64, K, 6> {
    let moved = |j: usize, t: f64| {
        let mut V = Vector6::zeros();
        V[j] = 1.0;
        s(&(integrate_body_twist(&Pose::identity(), &V, t).inverse() * X_CO))
    };
    SMatrix::from_fn(|k, j| {
        let mut off = moved(j, H)[k] - moved(j, -H)[k];
        // angles may wrap between the two
        if off.abs() > 1.0 {
            off = wrap_rad(off);
        }
        off / (2.0 * H)
    })
}

prop_compose! {
    fn view()(x in -0.2..0.2f64, y in -0.2..0.2f64, z in 0.4..1.2f64, tilt in prop::array::uniform2(-0.6..0.6f64),
        roll in -3.0..3.0f64) -> Pose {
        pose([x, y, z], [tilt[0], tilt[1], 0.0]) * pose([0.0; 3], [0.0, 0.0, roll])
    }
}

/// The corners in turn about their mean, which lies within: no side crosses another.
fn star(mut corners: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    let count = corners.len() as f64;
    let mean = corners.iter().map(|c| Vector2::from(*c)).sum::<Vector2<f64>>() / count;
    let angle = |c: &[f64; 2]| (c[1] - mean.y).atan2(c[0] - mean.x);
    corners.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    corners
}

proptest! {
    #[test]
    fn moments_of_polygons_are_those_of_imaging(
        corners in prop::collection::vec(prop::array::uniform2(-0.5..0.5f64), 3..9)
    ) {
        let corners = star(corners);
        let ours = ImageMoments::of_polygon(&corners.iter().map(|c| Vector2::from(*c)).collect::<Vec<_>>());
        prop_assume!(ours.area() > 1e-3);
        let theirs = Moments::of_polygon(&corners).unwrap();
        let c = Central::of(&ours, &Vector3::z());
        let [a, b] = c.skew(&ours, &Vector3::z());
        let pairs = [
            (c.area.value, theirs.m00), (c.x.value, theirs.x), (c.y.value, theirs.y), (c.mu20.value, theirs.mu20),
            (c.mu11.value, theirs.mu11), (c.mu02.value, theirs.mu02),
        ];
        for (ours, theirs) in pairs {
            prop_assert!((ours - theirs).abs() < 1e-9, "{ours} {theirs}");
        }
        prop_assert!((a.value.hypot(b.value) - theirs.asymmetry()).abs() < 1e-9 * (1.0 + theirs.asymmetry()));
    }

    #[test]
    fn rates_of_moments_to_third_order(
        X_CO in view(), (i, j) in (0usize..4).prop_flat_map(|i| (Just(i), 0..4 - i))
    ) {
        let m = |X: &Pose| ImageMoments::of_polygon(&image(X, &ARROW));
        let rates = m(&X_CO).rates(i, j, &plane(&X_CO));
        let d = differences(&X_CO, |X| SVector::<f64, 1>::new(m(X).get(i, j)));
        prop_assert!((d.transpose() - rates).norm() < 1e-6 * (1e-3 + rates.norm()), "{d} {rates}");
    }

    #[test]
    fn interaction_matrices_of_moment_features(
        X_CO in view(), lengths in prop::array::uniform7(0.5..1.5f64)
    ) {
        // random polygons are not symmetric
        let corners: Vec<[f64; 2]> =
            ARROW.iter().zip(lengths).map(|(c, by)| [c[0] * by, c[1] * by]).collect();
        let area = |X: &Pose| AreaFeature::new(ImageMoments::of_polygon(&image(X, &corners)), plane(X));
        let full = |X: &Pose| MomentFeature::new(area(X), 0.02);
        // where the senses of the axis, or the axes, can hardly be distinguished, the features have a step
        let s = full(&X_CO).value();
        let c = Central::of(&area(&X_CO).moments, &plane(&X_CO));
        let elongation = (c.mu20.value - c.mu02.value).hypot(2.0 * c.mu11.value) / (c.mu20.value + c.mu02.value);
        prop_assume!(s[3] < -0.02 && elongation > 0.1);
        let L = full(&X_CO).interaction().unwrap();
        let d = differences(&X_CO, |X| full(X).value());
        prop_assert!((d - L).norm() < 1e-5 * L.norm(), "{d} {L}");
        let L = area(&X_CO).interaction().unwrap();
        let d = differences(&X_CO, |X| area(X).value());
        prop_assert!((d - L).norm() < 1e-5 * L.norm(), "{d} {L}");
    }

    #[test]
    fn interaction_matrix_of_an_ellipse(X_CO in view(), a in 0.02..0.08f64, b in 0.02..0.08f64) {
        let corners: Vec<[f64; 2]> = (0..2000)
            .map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 2000.0).sin_cos();
                [a * cos, b * sin]
            })
            .collect();
        let of = |X: &Pose| {
            let flat: Vec<[f64; 2]> = image(X, &corners).iter().map(|p| [p.x, p.y]).collect();
            let m = Moments::of_polygon(&flat).unwrap();
            let n = [m.mu20, m.mu11, m.mu02].map(|mu| mu / m.m00);
            let moments = ImageMoments::of_second_order(1.0, &Vector2::new(m.x, m.y), n);
            EllipseFeature::of_area(&AreaFeature::new(moments, plane(X)))
        };
        let L = of(&X_CO).interaction().unwrap();
        let d: SMatrix<f64, 5, 6> = differences(&X_CO, |X| of(X).value());
        prop_assert!((d - L).norm() < 1e-4 * L.norm(), "{d} {L}");
    }
}

proptest! {
    #[test]
    fn second_moments_of_any_area_move_by_their_interaction_matrix(X_CO in view()) {
        let of = |X: &Pose| {
            let moments = ImageMoments::of_polygon(&image(X, &ARROW));
            EllipseFeature::of_area(&AreaFeature::new(moments, plane(X)))
        };
        let L = of(&X_CO).interaction().unwrap();
        let d: SMatrix<f64, 5, 6> = differences(&X_CO, |X| of(X).value());
        prop_assert!((d - L).norm() < 1e-5 * L.norm(), "{d} {L}");
    }
}

#[test]
fn ellipses_by_their_axes() {
    let e = EllipseFeature::new(Vector2::new(0.1, 0.2), [0.04, 0.02], 0.5, Vector3::z());
    let [x, y, n20, n11, n02] = e.value().into();
    let n = nalgebra::Matrix2::new(n20, n11, n11, n02);
    let axis = Vector2::new(0.5f64.cos(), 0.5f64.sin());
    assert!((n * axis - axis * 0.0004).norm() < 1e-12);
    assert!((Vector2::new(x, y) - Vector2::new(0.1, 0.2)).norm() < 1e-15);
    let behind = EllipseFeature::new(Vector2::new(0.1, 0.2), [0.04, 0.02], 0.5, -Vector3::z());
    assert!(behind.interaction().is_none());
    let flat = EllipseFeature::new(Vector2::new(0.1, 0.2), [0.04, 0.0], 0.5, Vector3::z());
    assert!(flat.interaction().is_none());
}

#[test]
fn what_is_parallel_moves_each_feature_by_itself() {
    let X = pose([0.0, 0.0, 0.5], [0.0; 3]);
    let moments = ImageMoments::of_polygon(&image(&X, &ARROW));
    let feature = MomentFeature::new(AreaFeature::new(moments, plane(&X)), 0.5 * moments.area().sqrt());
    let L = feature.interaction().unwrap();
    assert!((L.fixed_view::<3, 3>(0, 0) + nalgebra::Matrix3::identity()).norm() < 1e-9);
    assert!(L.fixed_view::<3, 3>(3, 0).norm() < 1e-9);
    assert!((L[(5, 5)] + 1.0).abs() < 1e-9 && L[(3, 5)].abs() < 1e-9 && L[(4, 5)].abs() < 1e-9);
}

#[test]
fn a_free_camera_converges_on_the_moments_of_a_polygon_alone() {
    let goal = pose([0.0, 0.0, 0.4], [0.0; 3]);
    let wanted = ImageMoments::of_polygon(&image(&goal, &ARROW));
    let reference_m = 0.4 * wanted.area().sqrt();
    let of = |X: &Pose| {
        let area = AreaFeature::new(ImageMoments::of_polygon(&image(X, &ARROW)), plane(X));
        MomentFeature::new(area, reference_m)
    };
    let desired = of(&goal).value();
    for (at, tilt, roll) in [
        ([0.08, -0.05, 0.6], [0.15, -0.1, 0.0], 0.6),
        ([-0.1, 0.06, 0.5], [-0.2, 0.15, 0.0], -2.0),
        ([0.02, 0.1, 0.8], [0.0, 0.3, 0.0], 3.0),
    ] {
        let mut X_CO = pose(at, tilt) * pose([0.0; 3], [0.0, 0.0, roll]);
        let mut last = f64::INFINITY;
        for _ in 0..600 {
            let mut stack = FeatureStack::<6>::new();
            stack.push(&of(&X_CO), &desired, 1.0).unwrap();
            let V = solve_twist(&stack, 1.0, 0.0).unwrap().twist;
            X_CO = integrate_body_twist(&Pose::identity(), &V, 0.04).inverse() * X_CO;
            last = of(&X_CO).error(&desired).norm();
        }
        let off = goal.inverse() * X_CO;
        assert!(last < 1e-8, "{last}");
        assert!(off.translation.vector.norm() < 1e-4 && off.rotation.angle() < 1e-4, "{off}");
    }
}

#[test]
fn moments_and_segments_stack_and_no_feature_has_no_rows() {
    let X = pose([0.05, 0.0, 0.5], [0.1, 0.0, 0.2]);
    let moments = ImageMoments::of_polygon(&image(&X, &ARROW));
    let area = AreaFeature::new(moments, plane(&X));
    let segment = SegmentFeature { s: [Vector2::zeros(), Vector2::new(0.1, 0.0)], z_m: [0.5; 2] };
    let mut stack = FeatureStack::<8>::new();
    stack.push(&area, &area.value(), 1.0).unwrap();
    stack.push(&segment, &segment.value(), 1.0).unwrap();
    assert!(solve_twist(&stack, 1.0, 0.0).unwrap().twist.norm() < 1e-9);
    let mut stack = FeatureStack::<8>::new();
    let empty = AreaFeature::new(ImageMoments::default(), plane(&X));
    assert_eq!(stack.push(&empty, &Vector4::zeros(), 1.0), Err(StackError::Singular));
}

#[test]
fn a_figure_without_senses_errs_by_half_turns_at_most() {
    let square: Vec<_> = [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]].map(Vector2::from).into();
    let feature = AreaFeature::new(ImageMoments::of_polygon(&square), Vector3::z());
    let mut desired = feature.value();
    desired.w += 3.0;
    assert!((feature.error(&desired).w - (3.0 - std::f64::consts::PI)).abs() < 1e-9);
}

#[test]
fn a_flat_triangle_has_its_sense_from_the_goal() {
    let triangle = [[-0.1, 0.0], [0.1, 0.0], [0.0, 0.07]];
    let of = |turn: f64, tilt: f64| {
        let X = pose([0.02, 0.01, 0.5], [tilt, 0.0, 0.0]) * pose([0.0; 3], [0.0, 0.0, turn]);
        AreaFeature::new(ImageMoments::of_polygon(&image(&X, &triangle)), plane(&X))
    };
    let goal = of(0.3, 0.0);
    for turn in (-15..=15).map(|k| 0.2 * f64::from(k)) {
        for tilt in [-0.02, 0.0, 0.02] {
            let e = of(0.3 + turn, tilt).in_sense_of(&goal).error(&goal.value());
            assert!((e.w + turn).abs() < 0.02, "{turn} {tilt}: {e}");
        }
    }
}
