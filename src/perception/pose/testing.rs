//! Scenes for the tests of this folder.

use super::{Correspondence, Correspondence3};
use crate::geometry::Pose;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;

/// The square of Example 10.1, side 0.1 m.
pub(super) const SQUARE: [[f64; 2]; 4] = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]];

/// Images of planar points; `noise` is added to the image coordinates in turn.
pub(super) fn see(X_CO: &Pose, plane: &[[f64; 2]], noise: impl FnMut() -> f64) -> Vec<Correspondence> {
    let spatial: Vec<_> = plane.iter().map(|r| [r[0], r[1], 0.0]).collect();
    let planar = |c: Correspondence3| Correspondence { r: Vector2::new(c.r.x, c.r.y), s: c.s };
    see_3d(X_CO, &spatial, noise).into_iter().map(planar).collect()
}

/// Images of points in space.
pub(super) fn see_3d(
    X_CO: &Pose,
    points: &[[f64; 3]],
    mut noise: impl FnMut() -> f64,
) -> Vec<Correspondence3> {
    let image = |r: &[f64; 3]| {
        let r = Point3::from(*r);
        let c = X_CO * r;
        Correspondence3 { r, s: Vector2::new(c.x / c.z + noise(), c.y / c.z + noise()) }
    };
    points.iter().map(image).collect()
}

/// Standard normal numbers from a fixed seed (sums of uniform numbers from a xorshift register).
pub(super) fn gauss(mut seed: u64) -> impl FnMut() -> f64 {
    move || {
        let mut sum = -6.0;
        for _ in 0..12 {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            sum += (seed >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    }
}

/// A grid of `n` x `n` points that fills the square of side 0.1 m around the origin.
pub(super) fn grid(n: usize) -> Vec<[f64; 2]> {
    let at = |i: usize| 0.1 * (i as f64 / (n - 1) as f64 - 0.5);
    (0..n * n).map(|i| [at(i % n), at(i / n)]).collect()
}

/// The pose at `p` whose plane is tilted by `tilt` rad about the axis at `azimuth` in the image, then spun by `spin`.
pub(super) fn tilted(p: [f64; 3], azimuth: f64, tilt: f64, spin: f64) -> Pose {
    let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt;
    let R = UnitQuaternion::from_scaled_axis(axis) * UnitQuaternion::from_euler_angles(0.0, 0.0, spin);
    Isometry3::from_parts(Vector3::from(p).into(), R)
}

/// Poses 0.3 to 1.5 m away, tilted by up to `tilt` rad.
pub(super) fn poses(tilt: f64) -> impl Strategy<Value = Pose> {
    (-0.3..0.3f64, -0.3..0.3f64, 0.3..1.5f64, -3.2..3.2f64, 0.0..tilt, -3.2..3.2f64)
        .prop_map(|(x, y, z, azimuth, tilt, spin)| tilted([x * z, y * z, z], azimuth, tilt, spin))
}

/// Distance between poses: metres plus radians.
pub(super) fn gap(a: &Pose, b: &Pose) -> f64 {
    (a.translation.vector - b.translation.vector).norm() + a.rotation.angle_to(&b.rotation)
}
