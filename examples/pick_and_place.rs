//! Pick and place with two goals and a gripper, by a client of a running instance:
//!
//! ```sh
//! vservo serve --instance cell &
//! cargo run --release --example pick_and_place
//! ```

use vservo::client::{Client, WaitFor};
use vservo::geometry::Pose;

/// Servoes to both goals by turns; `gripper` is told what to do there.
pub fn pick_and_place(
    cell: &Client,
    gripper: &mut dyn FnMut(&str),
) -> Result<(), Box<dyn std::error::Error>> {
    let pick = Pose::new([-0.1, 0.1, 0.6].into(), [0.0, 0.0, -1.05].into());
    let place = Pose::new([-0.04, 0.03, 0.55].into(), [0.0, 0.0, -0.35].into());
    for (goal, what) in [(&pick, "close"), (&place, "open")] {
        let answer = cell.goal_pose(goal)?;
        if let Some(reason) = answer.reason {
            return Err(reason.into());
        }
        if answer.state != "servoing" {
            cell.start()?;
        }
        let end = cell.wait(WaitFor::Converged, 60.0)?;
        if !end.is_reached {
            return Err(end.reason.into());
        }
        gripper(what);
    }
    cell.hold()?;
    Ok(())
}

#[allow(dead_code, clippy::print_stdout)] // a test has it without its main; an example prints
fn main() -> Result<(), Box<dyn std::error::Error>> {
    pick_and_place(&Client::connect("cell")?, &mut |what| println!("gripper: {what}"))
}
