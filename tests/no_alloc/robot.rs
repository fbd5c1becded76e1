//! Nothing that runs at 1 kHz allocates: every method of `Robot`, for every number of joints that is shipped.

#![allow(non_snake_case, clippy::unwrap_used)] // helpers of tests are tests

use assert_no_alloc::assert_no_alloc;
use nalgebra::{SVector, Vector3};
use std::hint::black_box;
use vservo::dispatch_robot;
use vservo::geometry::{Pose, Twist};
use vservo::robot::{ExpressedIn, InverseOptions, Robot, SHIPPED, load};

fn exercise<const N: usize>(robot: &Robot<N>) {
    let X_EC = Pose::translation(0.1, 0.0, 0.05);
    let options = InverseOptions::default();
    // Bent, stretched, far outside the limits, and not a number: no path may allocate.
    for bend in [0.7, 0.0, 1e9, f64::NAN] {
        let q = SVector::<f64, N>::from_fn(|i, _| bend * (1.0 + 0.1 * i as f64));
        let qd = SVector::<f64, N>::repeat(0.4);
        assert_no_alloc(|| {
            let J = robot.jacobian(&q);
            black_box(robot.forward(&q));
            black_box(robot.jacobian_of_frame(&q, &X_EC, ExpressedIn::Moving));
            black_box(robot.inverse_dynamics(&q, &qd, &qd));
            black_box(robot.gravity(&q));
            black_box(robot.mass_matrix(&q));
            black_box(robot.forward_dynamics(&q, &qd, &qd));
            black_box(robot.kinetic_energy(&q, &qd) + robot.potential_energy(&q));
            black_box(robot.damped_velocity(&q, &J, &Twist::repeat(9.0), &qd, &options));
            black_box(robot.outside_limits(&q));
        });
    }
}

#[test]
fn no_method_allocates() {
    for name in SHIPPED {
        let description = load(name).unwrap();
        dispatch_robot!(description, |robot| {
            let loaded = robot.clone().with_payload(1.0, &Vector3::new(0.0, 0.0, 0.1));
            exercise(&robot);
            exercise(&loaded);
        })
        .unwrap();
    }
}
