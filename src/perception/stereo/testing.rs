//! Scenes for the tests of this folder.

use super::Conjugates;
use crate::geometry::Pose;
use crate::linalg::Random;
use nalgebra::{Point3, Vector2};

/// Camera 2 beside camera 1, turned inwards.
pub(super) fn camera_pose() -> Pose {
    Pose::new([0.3, -0.05, 0.1].into(), [0.05, -0.25, 0.1].into())
}

/// Points 1 to 3 m ahead of camera 1, with their images.
pub(super) fn scene(X_12: &Pose, count: usize, seed: u64) -> Vec<(Conjugates, Point3<f64>)> {
    let mut random = Random::new(seed);
    let one = || {
        let z = random.between(1.0, 3.0);
        let p = Point3::new(random.between(-0.4, 0.4) * z, random.between(-0.3, 0.3) * z, z);
        let q = X_12.inverse() * p;
        (Conjugates { s_1: p.xy().coords / p.z, s_2: q.xy().coords / q.z }, p)
    };
    std::iter::repeat_with(one).take(count).collect()
}

/// The images with noise of standard deviation `sd`.
pub(super) fn noisy(scene: &[(Conjugates, Point3<f64>)], sd: f64, random: &mut Random) -> Vec<Conjugates> {
    let mut noise = || Vector2::new(random.gaussian(), random.gaussian()) * sd;
    scene.iter().map(|(pair, _)| Conjugates { s_1: pair.s_1 + noise(), s_2: pair.s_2 + noise() }).collect()
}
