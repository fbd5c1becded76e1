//! `vservo calibrate`: what is found from pictures that exist already.

mod hand_eye;

pub use hand_eye::HandEyeArguments;
pub(super) use hand_eye::hand_eye;
