//! Minimal and global solvers of Sect. 10.3 and 10.4; goals (medians) in brackets.
#![allow(non_snake_case)] // monogram notation
#![allow(clippy::unwrap_used)] // scenes that exist

use divan::{Bencher, black_box};
use nalgebra::{Point3, Vector2, Vector3};
use vservo::geometry::Pose;
use vservo::linalg::Random;
use vservo::pose::{ConsensusSettings, Correspondence3, PoseConsensus, p3p, pnp};
use vservo::stereo::{
    Conjugates, RelativeConsensus, Triangulator, absolute_orientation, essential_5_point, essential_8_point,
    plane_motion, refine_relative, triangulate_linear,
};

fn main() {
    divan::main();
}

/// Noise of a scene, normalized units: 0.5 px at a focal length of 800 px.
const SIGMA: f64 = 6e-4;

/// A cloud within 0.1 m, or a plane, 0.7 m away.
fn object_seen(random: &mut Random, count: usize, depth_m: f64) -> Vec<Correspondence3> {
    let mut vector = |size: f64| Vector3::from([(); 3].map(|()| random.between(-size, size)));
    let X_CO = Pose::new(Vector3::new(0.0, 0.0, 0.7) + vector(0.1), vector(1.0));
    let cloud: Vec<_> =
        (0..count).map(|_| vector(0.1).component_mul(&Vector3::new(1.0, 1.0, depth_m / 0.1))).collect();
    let mut see = |r: Vector3<f64>| {
        let p = X_CO * Point3::from(r);
        let noise = Vector2::new(random.gaussian(), random.gaussian()) * SIGMA;
        Correspondence3 { r: r.into(), s: p.xy().coords / p.z + noise }
    };
    cloud.into_iter().map(&mut see).collect()
}

/// Sets that follow each other, so that branches are not learned by heart.
fn in_turn<T, O>(bencher: Bencher, sets: &[T], work: impl Fn(&T) -> O) {
    let mut turn = 0;
    bencher.bench_local(|| {
        turn = (turn + 1) % sets.len();
        work(black_box(&sets[turn]))
    });
}

/// [250 ns].
#[divan::bench(sample_size = 64)]
fn p3p_all_solutions(bencher: Bencher) {
    let mut random = Random::new(1);
    let sets: Vec<[Correspondence3; 3]> =
        (0..64).map(|_| object_seen(&mut random, 3, 0.1).try_into().unwrap()).collect();
    in_turn(bencher, &sets, p3p);
}

/// The global minimum, refined [16: 10 us].
#[divan::bench(args = [4, 6, 16, 64])]
fn pnp_cloud(bencher: Bencher, count: usize) {
    let mut random = Random::new(2);
    let sets: Vec<_> = (0..64).map(|_| object_seen(&mut random, count, 0.1)).collect();
    in_turn(bencher, &sets, |points| pnp(points));
}

/// Both solutions of a plane.
#[divan::bench(args = [4, 16, 64])]
fn pnp_plane(bencher: Bencher, count: usize) {
    let mut random = Random::new(3);
    let sets: Vec<_> = (0..64).map(|_| object_seen(&mut random, count, 0.0)).collect();
    in_turn(bencher, &sets, |points| pnp(points));
}

/// 50 points, of which 15 are wrong.
#[divan::bench]
fn pose_consensus(bencher: Bencher) {
    let mut random = Random::new(4);
    let mut sets: Vec<_> = (0..16).map(|_| object_seen(&mut random, 50, 0.1)).collect();
    for point in sets.iter_mut().flat_map(|set| set.iter_mut().take(15)) {
        point.s = Vector2::new(random.between(-0.4, 0.4), random.between(-0.3, 0.3));
    }
    let mut search = PoseConsensus::with_capacity(64);
    let mut turn = 0;
    bencher.bench_local(|| {
        turn = (turn + 1) % sets.len();
        search.search(black_box(&sets[turn]), &ConsensusSettings::default(), SIGMA)
    });
}

/// Camera 2 beside camera 1, turned inwards.
fn second_camera() -> Pose {
    Pose::new([0.3, -0.05, 0.1].into(), [0.05, -0.25, 0.1].into())
}

/// Images of points 1 to 3 m ahead.
fn conjugates(random: &mut Random, count: usize) -> Vec<Conjugates> {
    let back = second_camera().inverse();
    let mut one = || {
        let z = random.between(1.0, 3.0);
        let p = Point3::new(random.between(-0.4, 0.4) * z, random.between(-0.3, 0.3) * z, z);
        let q = back * p;
        let mut noise = || Vector2::new(random.gaussian(), random.gaussian()) * SIGMA;
        let (a, b) = (noise(), noise());
        Conjugates { s_1: p.xy().coords / p.z + a, s_2: q.xy().coords / q.z + b }
    };
    (0..count).map(|_| one()).collect()
}

/// [5.5 us].
#[divan::bench(sample_size = 64)]
fn essential_five_points(bencher: Bencher) {
    let mut random = Random::new(5);
    let sets: Vec<[Conjugates; 5]> =
        (0..64).map(|_| conjugates(&mut random, 5).try_into().unwrap()).collect();
    in_turn(bencher, &sets, essential_5_point);
}

#[divan::bench(args = [8, 50])]
fn essential_eight_points(bencher: Bencher, count: usize) {
    let mut random = Random::new(6);
    let sets: Vec<_> = (0..64).map(|_| conjugates(&mut random, count)).collect();
    in_turn(bencher, &sets, |pairs| essential_8_point(pairs));
}

/// 50 matches, of which 15 are wrong [300 us].
#[divan::bench]
fn relative_consensus(bencher: Bencher) {
    let mut random = Random::new(7);
    let mut sets: Vec<_> = (0..16).map(|_| conjugates(&mut random, 50)).collect();
    for pair in sets.iter_mut().flat_map(|set| set.iter_mut().take(15)) {
        pair.s_2 = Vector2::new(random.between(-0.4, 0.4), random.between(-0.3, 0.3));
    }
    let mut search = RelativeConsensus::with_capacity(64);
    let mut turn = 0;
    bencher.bench_local(|| {
        turn = (turn + 1) % sets.len();
        search.search(black_box(&sets[turn]), &ConsensusSettings::default(), SIGMA)
    });
}

#[divan::bench]
fn relative_refinement_50(bencher: Bencher) {
    let mut random = Random::new(8);
    let sets: Vec<_> = (0..16).map(|_| conjugates(&mut random, 50)).collect();
    in_turn(bencher, &sets, |pairs| refine_relative(&second_camera(), pairs, SIGMA));
}

/// The optimal position with its covariance, 50 points [5 us].
#[divan::bench]
fn triangulate_50(bencher: Bencher) {
    let pairs = conjugates(&mut Random::new(9), 50);
    let both = Triangulator::new(&second_camera()).unwrap();
    bencher.bench_local(|| {
        for pair in &pairs {
            black_box(both.point(black_box(pair))).ok();
        }
    });
}

#[divan::bench]
fn triangulate_linear_50(bencher: Bencher) {
    let pairs = conjugates(&mut Random::new(9), 50);
    bencher.bench_local(|| {
        for pair in &pairs {
            black_box(triangulate_linear(&second_camera(), black_box(pair))).ok();
        }
    });
}

#[divan::bench]
fn orientation_50(bencher: Bencher) {
    let mut random = Random::new(10);
    let X = second_camera();
    let mut point = || Point3::from([(); 3].map(|()| random.between(-1.0, 1.0)));
    let pairs: Vec<_> = (0..50).map(|_| point()).map(|p| (X * p, p)).collect();
    bencher.bench_local(|| absolute_orientation(black_box(&pairs)));
}

/// Homography of 64 pairs at the least error, decomposed.
#[divan::bench]
fn plane_motion_64(bencher: Bencher) {
    let mut random = Random::new(11);
    let n = Vector3::new(0.2, -0.1, 1.0).normalize();
    let one = |random: &mut Random| {
        let s_2 = Vector2::new(random.between(-0.3, 0.3), random.between(-0.3, 0.3));
        let p = second_camera() * Point3::from(s_2.push(1.0) / n.dot(&s_2.push(1.0)));
        let noise = Vector2::new(random.gaussian(), random.gaussian()) * SIGMA;
        Conjugates { s_1: p.xy().coords / p.z + noise, s_2 }
    };
    let pairs: Vec<_> = (0..64).map(|_| one(&mut random)).collect();
    bencher.bench_local(|| plane_motion(black_box(&pairs)));
}
