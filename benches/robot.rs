//! Kinematics and dynamics of the UR5 (6 joints), one state per call out of 64 random ones; divan prints the median.
//!
//! Pinocchio on the same kind of machine: inverse dynamics 623 ns, B(q) 820 ns, Jacobian 237 ns.

#![allow(non_snake_case, clippy::unwrap_used)]

use divan::{Bencher, black_box};
use nalgebra::{Vector3, Vector6};
use vservo::geometry::{Pose, Twist};
use vservo::robot::{ExpressedIn, InverseOptions, Robot, load};

fn main() {
    divan::main();
}

struct Bench {
    robot: Robot<6>,
    states: Vec<[Vector6<f64>; 3]>,
    at: usize,
}

impl Bench {
    fn new() -> Self {
        let mut seed = 1u64;
        let mut number = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        let mut vector = |bound: f64| Vector6::from_fn(|_, _| number() * bound);
        let states = (0..64).map(|_| [vector(3.0), vector(2.0), vector(5.0)]).collect();
        Self { robot: load("ur5").unwrap().build().unwrap(), states, at: 0 }
    }

    fn run<T>(mut self, bencher: Bencher, work: impl Fn(&Robot<6>, &[Vector6<f64>; 3]) -> T) {
        bencher.bench_local(|| {
            self.at = (self.at + 1) % 64;
            work(black_box(&self.robot), black_box(&self.states[self.at]))
        });
    }
}

#[divan::bench]
fn jacobian(bencher: Bencher) {
    Bench::new().run(bencher, |robot, [q, ..]| robot.jacobian(q));
}

#[divan::bench]
fn forward(bencher: Bencher) {
    Bench::new().run(bencher, |robot, [q, ..]| robot.forward(q));
}

#[divan::bench]
fn forward_and_jacobian_of_camera(bencher: Bencher) {
    let X_EC = Pose::new(Vector3::new(0.05, 0.0, 0.08), Vector3::new(0.1, 0.2, 1.5));
    Bench::new()
        .run(bencher, |robot, [q, ..]| robot.forward_and_jacobian_of_frame(q, &X_EC, ExpressedIn::Moving));
}

#[divan::bench]
fn inverse_dynamics(bencher: Bencher) {
    Bench::new().run(bencher, |robot, [q, qd, qdd]| robot.inverse_dynamics(q, qd, qdd));
}

#[divan::bench]
fn gravity(bencher: Bencher) {
    Bench::new().run(bencher, |robot, [q, ..]| robot.gravity(q));
}

#[divan::bench]
fn mass_matrix(bencher: Bencher) {
    Bench::new().run(bencher, |robot, [q, ..]| robot.mass_matrix(q));
}

#[divan::bench]
fn forward_dynamics(bencher: Bencher) {
    Bench::new().run(bencher, |robot, [q, qd, tau]| robot.forward_dynamics(q, qd, tau));
}

#[divan::bench]
fn damped_velocity(bencher: Bencher) {
    let options = InverseOptions::default();
    Bench::new().run(bencher, |robot, [q, qd, V]| {
        let J = robot.jacobian(q);
        robot.damped_velocity(q, &J, &Twist::from(V * 0.1), &(qd * 0.0), &options)
    });
}
