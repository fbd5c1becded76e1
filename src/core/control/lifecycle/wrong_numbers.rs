//! What the numbers of a certain request must be, in words.

use super::{Refusal, Request};

impl Refusal {
    /// As [`Self::describe`], of `request`: of numbers that are none it tells the bounds of that request alone.
    #[must_use]
    pub fn describe_for(self, request: Request) -> &'static str {
        match (self, request) {
            (Self::WrongNumbers, Request::Goal) => {
                "its numbers are none of a goal: all must be finite, a position within 100 m with a quaternion of length 1, a feature within 57"
            }
            (Self::WrongNumbers, Request::Goto) => {
                "its numbers are none of a posture, which needs one for each joint, all of them finite"
            }
            (Self::WrongNumbers, Request::Jog) => {
                "its numbers are none of a jog, which needs one for each joint or six of the camera, all of them finite"
            }
            (Self::WrongNumbers, Request::Velocity) => {
                "its numbers are none of a velocity, which needs one for each joint or six of the camera and the time for which it holds (0.01 to 1 s), \
                 all of them finite, and a velocity at most 30 rad/s or m/s"
            }
            (Self::WrongNumbers, Request::Set) => {
                "its number is out of bounds: a gain 0.001 to 100 1/s, a tolerance 0.000001 to 100 px, a hold 0 to 60 s"
            }
            (other, _) => other.describe(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_numbers_are_told_by_their_request_alone() {
        let of = |request| Refusal::WrongNumbers.describe_for(request);
        let all = [Request::Goal, Request::Goto, Request::Jog, Request::Velocity, Request::Set].map(of);
        assert!(!all.contains(&Refusal::WrongNumbers.describe()), "each has words of its own");
        assert!(!of(Request::Set).contains("joint") && !of(Request::Set).contains("quaternion"));
        assert_eq!(Refusal::NoFault.describe_for(Request::Set), Refusal::NoFault.describe());
    }
}
