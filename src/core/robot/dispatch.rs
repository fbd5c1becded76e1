//! From the number of joints in a file to the const generic: once, at start.

/// Builds the arm of a [`RobotDescription`](crate::robot::RobotDescription) with the number of joints that it states
/// and evaluates the body with it: `Result<T, RobotError>`.
///
/// ```
/// # use vservo_core as vservo;
/// let description = vservo::robot::load("scara")?;
/// let effort = vservo::dispatch_robot!(description, |robot| robot.limits().iter().map(|l| l.effort).sum::<f64>())?;
/// assert!(effort > 0.0);
/// # Ok::<(), vservo::robot::RobotError>(())
/// ```
#[macro_export]
macro_rules! dispatch_robot {
    ($description:expr, |$robot:ident| $body:expr) => {{
        let description: &$crate::robot::RobotDescription = &$description;
        match description.joint_count() {
            3 => description.build::<3>().map(|$robot| $body),
            4 => description.build::<4>().map(|$robot| $body),
            5 => description.build::<5>().map(|$robot| $body),
            6 => description.build::<6>().map(|$robot| $body),
            7 => description.build::<7>().map(|$robot| $body),
            // Any other number but two fails here with the message that says so.
            _ => description.build::<2>().map(|$robot| $body),
        }
    }};
}
