//! Energy over 8 s of free motion, without torque and friction: what a wrong Coriolis term would show.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests are tests

use nalgebra::{SVector, Vector3};
use vservo::dispatch_robot;
use vservo::robot::{Robot, SHIPPED, load};

const STEP_S: f64 = 1e-4;
const STEPS: usize = 80_000;

/// UnobservedMotion of the total energy over the greatest kinetic energy on the way.
fn drift<const N: usize>(robot: &Robot<N>) -> f64 {
    let mut q = SVector::<f64, N>::from_fn(|i, _| 0.3 + 0.4 * i as f64);
    let mut qd = SVector::<f64, N>::from_fn(|i, _| if i % 2 == 0 { 0.5 } else { -0.3 });
    let start = robot.kinetic_energy(&q, &qd) + robot.potential_energy(&q);
    let (mut worst, mut scale) = (0.0f64, 0.0f64);
    for k in 0..STEPS {
        (q, qd) = robot.integrate(&q, &qd, &SVector::zeros(), STEP_S);
        if k % 50 == 0 || k + 1 == STEPS {
            let kinetic = robot.kinetic_energy(&q, &qd);
            scale = scale.max(kinetic);
            worst = worst.max((kinetic + robot.potential_energy(&q) - start).abs());
        }
    }
    worst / scale
}

#[test]
fn shipped_robots_conserve_energy() {
    for name in SHIPPED {
        let description = load(name).unwrap();
        let drift = dispatch_robot!(description, |robot| {
            // A base that leans and a load that is off the axis: nothing may hide behind symmetry.
            let leaning = robot.with_gravity(Vector3::new(2.0, -3.0, -9.0));
            drift(&leaning.with_payload(0.4, &Vector3::new(0.05, 0.1, 0.1)))
        })
        .unwrap();
        println!("{name}: {drift:.1e}");
        // Obtained: 2.5e-9 for the xArm, whose light wrists turn fast, 4e-11 for the Panda, 2e-12 and less for the others.
        let most = if *name == "xarm7" { 1e-8 } else { 2e-10 };
        assert!(drift < most, "{name}: energy drifts by {drift:e}");
    }
}

#[test]
fn motors_and_gears_conserve_energy() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/robot/chain_5_motors.toml");
    let robot: Robot<5> = load(path).unwrap().build().unwrap();
    let drift = drift(&robot);
    println!("motors: {drift:.1e}");
    assert!(drift < 1e-12, "energy drifts by {drift:e}");
}
