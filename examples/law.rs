//! A law from four points: the velocity of a camera that shall see them elsewhere, and where it ends when it obeys.
//!
//! ```text
//! cargo run --release --example law
//! ```

#![allow(clippy::print_stdout, non_snake_case)] // a program for a terminal; frames are named as in the library

use vservo::geometry::integrate_body_twist;
use vservo::prelude::*;

fn main() -> Result<(), &'static str> {
    let points: Vec<_> = FourDots::default().points_O().into();
    let X_DO = Pose::translation(-0.05, -0.05, 0.5);
    let goal = SetPoint::from_pose(&X_DO, &points).ok_or("a point lies behind the camera")?;
    let mut X_CO = Pose::new([-0.15, 0.02, 0.7].into(), [0.1, -0.2, 0.6].into());
    for step in 0..=100 {
        // what a camera would measure
        let seen = SetPoint::from_pose(&X_CO, &points).ok_or("a point lies behind the camera")?;
        let view = View::new(seen.features().iter().copied(), Some(X_CO)).ok_or("no features")?;
        let task = image_task(&goal, &view, Interaction::TEXTBOOK).ok_or("no interaction matrix")?;
        let V_BC_C = task.twist(2.0).ok_or("the points do not fix the camera's motion")?;
        if step % 20 == 0 {
            println!(
                "{:4.1} s  error {:.5}  V {:+.4}",
                0.04 * f64::from(step),
                task.error,
                V_BC_C.transpose()
            );
        }
        // the object, as seen from a camera that moves so for 40 ms
        X_CO = integrate_body_twist(&Pose::identity(), &V_BC_C, 0.04).inverse() * X_CO;
    }
    let off = X_DO.inverse() * X_CO;
    println!(
        "{:.3} mm and {:.4} rad from the goal",
        off.translation.vector.norm() * 1e3,
        off.rotation.angle()
    );
    Ok(())
}
