//! Pose, homography and servo-law timings; goals (medians) in brackets.
//!
//! divan prints fastest, slowest, median and mean; tails over single calls come at the end.
#![allow(non_snake_case)] // monogram notation

use divan::{Bencher, black_box};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector2, Vector3};
use vservo::features::NormalEquations;
use vservo::geometry::Pose;
use vservo::pose::{
    Correspondence, Correspondence3, decompose_homography, dlt_pose, homography, planar_pose, refine,
    refine_3d,
};

/// Image noise of the scenes, normalized units: 0.05 px at a focal length of 800 px.
const SIGMA: f64 = 6e-5;

fn main() {
    divan::main();
    tails();
}

fn pose() -> Pose {
    let q = UnitQuaternion::from_euler_angles(0.5, -0.35, 0.7);
    Pose::from_parts(Vector3::new(0.03, -0.02, 0.6).into(), q)
}

/// A pose as the frame before would give it.
fn near() -> Pose {
    let q = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, -0.02, 0.015));
    let X = pose();
    Pose::from_parts((X.translation.vector + Vector3::new(0.004, 0.003, -0.006)).into(), q * X.rotation)
}

/// A fixed sequence that looks like noise, from -1 to 1.
fn noise(i: usize) -> f64 {
    ((i as f64 * 12.9898).sin() * 1.7) % 1.0
}

fn image(r: &Point3<f64>, i: usize) -> Vector2<f64> {
    let p = pose() * r;
    Vector2::new(p.x / p.z + SIGMA * noise(2 * i), p.y / p.z + SIGMA * noise(2 * i + 1))
}

fn plane(count: usize) -> Vec<Correspondence> {
    let side = (count as f64).sqrt().ceil() as usize;
    let at = |i: usize| 0.1 * (i as f64 / (side - 1) as f64 - 0.5);
    let one = |i: usize| {
        let r = Vector2::new(at(i % side), at(i / side));
        Correspondence { r, s: image(&Point3::new(r.x, r.y, 0.0), i) }
    };
    (0..count).map(one).collect()
}

fn space(count: usize) -> Vec<Correspondence3> {
    let lift = |(i, c): (usize, Correspondence)| {
        let r = Point3::new(c.r.x, c.r.y, 0.05 * noise(7 * i));
        Correspondence3 { r, s: image(&r, i) }
    };
    plane(count).into_iter().enumerate().map(lift).collect()
}

/// Both solutions, refined and ranked [4: 2 us].
#[divan::bench(args = [4, 16, 54])]
fn planar_both_solutions(bencher: Bencher, count: usize) {
    let points = plane(count);
    bencher.bench_local(|| planar_pose(black_box(&points)));
}

/// [4: 1 us, 16: 3 us, 64: 10 us].
#[divan::bench(args = [4, 16, 64])]
fn refine_planar(bencher: Bencher, count: usize) {
    let (points, start) = (plane(count), near());
    bencher.bench_local(|| refine(black_box(&start), black_box(&points), SIGMA));
}

/// Points in space [as above].
#[divan::bench(args = [4, 16, 64])]
fn refine_spatial(bencher: Bencher, count: usize) {
    let (points, start) = (space(count), near());
    bencher.bench_local(|| refine_3d(black_box(&start), black_box(&points), SIGMA));
}

/// [4: 2 us, 50: 15 us].
#[divan::bench(args = [4, 50])]
fn homography_dlt(bencher: Bencher, count: usize) {
    let points = plane(count);
    bencher.bench_local(|| homography(black_box(&points)));
}

/// Points in space, linear solution.
#[divan::bench(args = [6, 16, 64])]
fn dlt_spatial(bencher: Bencher, count: usize) {
    let points = space(count);
    bencher.bench_local(|| dlt_pose(black_box(&points)));
}

/// [0.5 us].
#[divan::bench]
fn decompose(bencher: Bencher) {
    let R = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3).to_rotation_matrix();
    let H: Matrix3<f64> =
        R.matrix() + Vector3::new(0.2, -0.1, 0.15) * Vector3::new(0.1, 0.2, 0.97).transpose();
    bencher.bench_local(|| decompose_homography(black_box(&H)));
}

/// Rows (10.27), normal equations and twist (10.91) [4: 0.3 us, 16: 1.0 us].
#[divan::bench(args = [4, 16])]
fn servo_law(bencher: Bencher, count: usize) {
    let points = plane(count);
    bencher.bench_local(|| law(black_box(&points)));
}

fn law(points: &[Correspondence]) -> Option<[f64; 6]> {
    let mut equations = NormalEquations::<6>::new();
    for point in points {
        equations.add_point(&point.s, 0.6, &((point.r - point.s) * 2.0), 1.0);
    }
    equations.solve(0.0).map(|solution| solution.twist.into())
}

/// Medians and tails over single calls; the clock's own cost (about 20 ns) is included.
#[allow(clippy::disallowed_methods, clippy::print_stdout)] // a bench reads the clock and prints
fn tails() {
    fn report(name: &str, mut work: impl FnMut()) {
        let mut times: Vec<u128> = (0..20_000)
            .map(|_| {
                let start = std::time::Instant::now();
                work();
                start.elapsed().as_nanos()
            })
            .collect();
        times.sort_unstable();
        let at = |q: f64| times[(q * (times.len() - 1) as f64) as usize];
        println!("{name:32} p50 {:6} ns   p99 {:6} ns   p99.9 {:6} ns", at(0.5), at(0.99), at(0.999));
    }
    if std::env::args().any(|arg| arg == "--test" || arg == "--list") {
        return;
    }
    let (four, sixteen, start) = (plane(4), plane(16), near());
    report("planar pose, 4 points", || {
        black_box(planar_pose(black_box(&four))).ok();
    });
    report("refine, 4 points", || {
        black_box(refine(black_box(&start), black_box(&four), SIGMA)).ok();
    });
    report("refine, 16 points", || {
        black_box(refine(black_box(&start), black_box(&sixteen), SIGMA)).ok();
    });
    report("servo law, 4 points", || {
        black_box(law(black_box(&four)));
    });
}
