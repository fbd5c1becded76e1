//! Requests to control and its answers: `control/command`.

use super::MAX_JOINTS;
use super::layout::record;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

record! {
    "vservo.ControlCommand.v1",
    /// A request to control.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
    pub struct ControlCommand {
        /// Code of a [`crate::control::lifecycle::Request`]; 0 asks for the answer alone, and every other code is refused.
        pub request: u32,
        /// Which arm: 0; a request for any other is refused.
        pub arm: u32,
    }
}

record! {
    "vservo.ControlAnswer.v3",
    /// The answer to a request, with the state of the run.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct ControlAnswer {
        /// The request that this answers.
        pub request: u32,
        /// Code of a [`crate::control::lifecycle::Refusal`]; 0: it was accepted.
        pub refusal: u32,
        /// Code of a [`super::ControlState`].
        pub state: u32,
        /// Code of a [`crate::control::safety::Fault`]; 0: none.
        pub fault: u32,
        /// Code of the [`super::TargetStatus`] of the last measurement.
        pub target: u32,
        /// Joints in use.
        pub joints: u32,
        /// Bits of [`answer_flag`].
        pub flags: u32,
        /// Which arm.
        pub arm: u32,
        /// Code of a [`super::CameraState`] of a real camera.
        pub camera_state: u32,
        /// Number of the goal in the run: 0 is that of the run file, each new one has the next number.
        pub goal: u32,
        /// Number of the control tick.
        pub tick: u64,
        /// Time since the first tick, s.
        pub time_s: f64,
        /// Root mean square feature error, px; NaN before the first measurement.
        pub feature_error_px: f64,
        /// Distance of the camera from its desired position, m; NaN where unknown.
        pub position_error_m: f64,
        /// Angle of the camera from its desired orientation, rad; NaN where unknown.
        pub orientation_error_rad: f64,
        /// For how long the camera has been in its state, s; NaN where unknown.
        pub camera_state_s: f64,
        /// For how long the goal has been reached and held, s; NaN where it is not, or was left again.
        pub at_goal_s: f64,
        /// Measured joint positions, rad or m.
        pub q: [f64; MAX_JOINTS],
        /// Measured joint velocities, rad/s or m/s.
        pub qd: [f64; MAX_JOINTS],
    }
}

/// Bits of [`ControlAnswer::flags`].
pub mod answer_flag {
    /// The run serves requests, and ends on request.
    pub const SERVED: u32 = 1;
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    #[allow(unsafe_code)]
    fn layouts_are_fixed_and_named() {
        assert_eq!((size_of::<ControlCommand>(), align_of::<ControlCommand>()), (8, 4));
        assert_eq!((size_of::<ControlAnswer>(), align_of::<ControlAnswer>()), (208, 8));
        assert_eq!(offset_of!(ControlAnswer, tick), 40);
        assert_eq!(offset_of!(ControlAnswer, q), 96);
        // SAFETY: the names are only read.
        let names = unsafe { (ControlCommand::type_name(), ControlAnswer::type_name()) };
        assert_eq!(names, ("vservo.ControlCommand.v1", "vservo.ControlAnswer.v3"));
    }
}
