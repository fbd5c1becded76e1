//! Every interaction matrix and Jacobian of this folder against central differences.

use super::*;
use crate::geometry::{Pose, integrate_body_twist, rotation_x, rotation_y, rotation_z};
use nalgebra::{Point3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3, Vector4, Vector6};
use proptest::prelude::*;

const H: f64 = 1e-5;

fn project(p: &Point3<f64>) -> Vector2<f64> {
    Vector2::new(p.x / p.z, p.y / p.z)
}

fn point() -> impl Strategy<Value = Point3<f64>> {
    (-0.4..0.4f64, -0.4..0.4f64, 0.5..2.0f64).prop_map(|(x, y, z)| Point3::new(x, y, z))
}

/// The six columns of ds/dt for unit camera twists, object at rest.
fn camera_difference<const K: usize>(s: impl Fn(&Pose) -> SVector<f64, K>) -> SMatrix<f64, K, 6> {
    let column = |j: usize, t: f64| {
        let mut V = Vector6::zeros();
        V[j] = 1.0;
        s(&integrate_body_twist(&Pose::identity(), &V, t).inverse())
    };
    SMatrix::from_fn(|k, j| (column(j, H)[k] - column(j, -H)[k]) / (2.0 * H))
}

proptest! {
    #[test]
    fn interaction_matrix_of_a_point(p in point()) {
        let feature = PointFeature { s: project(&p), z_m: p.z };
        let difference = camera_difference(|X| project(&(X * p)));
        prop_assert!((feature.interaction().unwrap() - difference).norm() < 1e-7);
    }

    #[test]
    fn interaction_matrix_of_a_segment(a in point(), b in point()) {
        let at = |X: &Pose| segment_features(&[project(&(X * a)), project(&(X * b))]);
        prop_assume!(at(&Pose::identity()).z > 0.05);
        prop_assume!(at(&Pose::identity()).w.abs() < 3.1); // differences do not wrap
        let feature = SegmentFeature { s: [project(&a), project(&b)], z_m: [a.z, b.z] };
        let L = feature.interaction().unwrap();
        prop_assert!((L - camera_difference(at)).norm() < 1e-5 * L.norm());
        // midpoint, length and angle are those of the ends
        let [x, y, length, alpha] = feature.value().into();
        let (mean, half) = (Vector2::new(x, y), Vector2::new(alpha.cos(), alpha.sin()) * (0.5 * length));
        prop_assert!((mean - half - feature.s[0]).norm() + (mean + half - feature.s[1]).norm() < 1e-12);
    }

    #[test]
    fn image_jacobian_of_a_point(r in point(), o in point(), w in prop::array::uniform3(-0.3..0.3f64)) {
        // The object turns about O and moves with it: (10.16), (10.17).
        let R = Rotation3::from_scaled_axis(Vector3::from(w));
        let r_o_C = R * (r.coords - Vector3::z());
        let at = |V: &Vector6<f64>, t: f64| {
            let turn = Rotation3::from_scaled_axis(V.fixed_rows::<3>(3) * t);
            project(&Point3::from(turn * r_o_C + o.coords + Vector3::z() * 0.7 + V.fixed_rows::<3>(0) * t))
        };
        let c = Point3::from(r_o_C + o.coords + Vector3::z() * 0.7);
        prop_assume!(c.z > 0.3);
        let J = point_image_jacobian(&project(&c), c.z, &r_o_C);
        for j in 0..6 {
            let mut V = Vector6::zeros();
            V[j] = 1.0;
            let difference = (at(&V, H) - at(&V, -H)) / (2.0 * H);
            prop_assert!((J.column(j) - difference).norm() < 1e-6);
        }
        let by_gamma = image_jacobian(&point_rows(&project(&c), c.z), &(c.coords - r_o_C));
        prop_assert!((by_gamma - J).norm() < 1e-12 * (1.0 + J.norm()));
    }

    #[test]
    fn analytical_jacobians(r in point(), x in prop::array::uniform6(-0.4..0.4f64)) {
        let r = r - Vector3::z();
        let x = Vector6::from(x) + Vector6::new(0.0, 0.0, 1.9, 0.0, 0.0, 0.0);
        let in_camera = |x: &Vector6<f64>| {
            let R = rotation_z(x[3]) * rotation_y(x[4]) * rotation_x(x[5]);
            R * r + x.fixed_rows::<3>(0)
        };
        let c = in_camera(&x);
        let p = x.fixed_rows::<3>(0).into_owned();
        let J = analytical_image_jacobian(&point_rows(&project(&c), c.z), &p, &x.fixed_rows::<3>(3).into_owned());
        for j in 0..6 {
            let mut d = Vector6::zeros();
            d[j] = H;
            let difference = (project(&in_camera(&(x + d))) - project(&in_camera(&(x - d)))) / (2.0 * H);
            prop_assert!((J.column(j) - difference).norm() < 1e-6);
        }
        // m = 4: the same with phi_y = phi_x = 0, where the angle about z is phi's first.
        let y = Vector6::new(x[0], x[1], x[2], x[3], 0.0, 0.0);
        let c = in_camera(&y);
        let L = point_rows(&project(&c), c.z);
        let J4: SMatrix<f64, 2, 4> = analytical_image_jacobian_4(&L, &p);
        let J6 = analytical_image_jacobian(&L, &p, &Vector3::new(x[3], 0.0, 0.0));
        prop_assert!((J4 - J6.fixed_columns::<4>(0)).norm() < 1e-12 * J6.norm());
    }

    #[test]
    fn euler_rate_gives_the_angular_velocity(phi in prop::array::uniform3(-1.4..1.4f64), rate in prop::array::uniform3(-1.0..1.0f64)) {
        let (phi, rate) = (Vector3::from(phi), Vector3::from(rate));
        let R = |t: f64| {
            let a = phi + rate * t;
            rotation_z(a.x) * rotation_y(a.y) * rotation_x(a.z)
        };
        let turn = UnitQuaternion::from_rotation_matrix(&(R(H) * R(-H).inverse())).scaled_axis() / (2.0 * H);
        prop_assert!((euler_zyx_rate(&phi) * rate - turn).norm() < 1e-7);
    }

    #[test]
    fn wrapped_angles_stay_in_range(a in -20.0..20.0f64) {
        let w = wrap_rad(a);
        prop_assert!(w > -std::f64::consts::PI && w <= std::f64::consts::PI);
        prop_assert!((w.sin() - a.sin()).abs() + (w.cos() - a.cos()).abs() < 1e-12);
    }
}

#[test]
fn example_10_2_null_space() {
    let s = Vector2::new(0.3, -0.2);
    let L = point_rows(&s, 0.8);
    assert!((L * Vector6::new(s.x, s.y, 1.0, 0.0, 0.0, 0.0)).norm() < 1e-15);
    assert!((L * Vector6::new(0.0, 0.0, 0.0, s.x, s.y, 1.0)).norm() < 1e-15);
    assert_eq!(L.rank(1e-9), 2); // hence four dimensions in all
}

#[test]
fn segment_error_wraps() {
    let segment = SegmentFeature { s: [Vector2::zeros(), Vector2::new(-0.1, 0.001)], z_m: [1.0; 2] };
    let desired = Vector4::new(0.0, 0.0, 0.1, -std::f64::consts::PI + 0.01);
    assert!(segment.error(&desired).w.abs() < 0.05);
}
