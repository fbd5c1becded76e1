//! The pose solvers do not allocate for up to 64 points.

#![allow(clippy::unwrap_used)] // helpers beside the tests
#![allow(non_snake_case)] // X as in the text

use assert_no_alloc::assert_no_alloc;
use nalgebra::{Point3, Vector2};
use vservo::geometry::Pose;
use vservo::linalg::Random;
use vservo::pose::{ConsensusSettings, Correspondence3, PoseConsensus, p3p, pnp, refine_3d};
use vservo::stereo::{
    Conjugates, RelativeConsensus, Triangulator, essential_5_point, essential_8_point, refine_relative,
};

#[test]
fn poses_of_up_to_64_points() {
    let mut random = Random::new(1);
    let X = Pose::new([0.03, -0.02, 0.6].into(), [0.4, -0.3, 0.9].into());
    for (count, depth_m) in [(3, 0.1), (4, 0.0), (4, 0.1), (16, 0.1), (64, 0.0), (64, 0.1)] {
        let points: Vec<_> = (0..count)
            .map(|_| {
                let r = Point3::new(
                    random.between(-0.1, 0.1),
                    random.between(-0.1, 0.1),
                    depth_m * random.uniform(),
                );
                let p = X * r;
                let noise = Vector2::new(random.gaussian(), random.gaussian()) * 5e-4;
                Correspondence3 { r, s: p.xy().coords / p.z + noise }
            })
            .collect();
        let mut search = PoseConsensus::with_capacity(64);
        assert_no_alloc(|| {
            let best = pnp(&points).unwrap().nearest(&X);
            refine_3d(&best.X_CO, &points, 5e-4).unwrap();
            if let [a, b, c, d, ..] = points[..] {
                p3p(&[a, b, c]).ok();
                p3p(&[b, c, d]).ok();
                search.search(&points, &ConsensusSettings::default(), 5e-4).ok();
            }
        });
    }
}

#[test]
fn displacements_of_up_to_64_pairs() {
    let mut random = Random::new(2);
    let X = Pose::new([0.3, -0.05, 0.1].into(), [0.05, -0.25, 0.1].into());
    let pairs: Vec<_> = (0..64)
        .map(|_| {
            let z = random.between(1.0, 3.0);
            let p = Point3::new(random.between(-0.4, 0.4) * z, random.between(-0.3, 0.3) * z, z);
            let q = X.inverse() * p;
            Conjugates { s_1: p.xy().coords / p.z, s_2: q.xy().coords / q.z + Vector2::repeat(1e-4) }
        })
        .collect();
    let five = std::array::from_fn(|i| pairs[i]);
    let both = Triangulator::new(&X).unwrap();
    let mut search = RelativeConsensus::with_capacity(64);
    assert_no_alloc(|| {
        essential_5_point(&five).unwrap();
        essential_8_point(&pairs).unwrap();
        refine_relative(&X, &pairs, 1e-4).unwrap();
        search.search(&pairs, &ConsensusSettings::default(), 1e-4).unwrap();
        assert!(pairs.iter().all(|pair| both.point(pair).is_ok()));
    });
}
