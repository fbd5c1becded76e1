//! The search for a target that is not where the arm saw it last: the camera looks around that place.
//!
//! ```text
//! s_d(a) = pitch a / 2 pi (cos a, sin a)        where the place is shown in the image, normalized: from the middle outwards, a turn each `pitch`
//! ```
//! The pattern waits for the arm, which goes with a quarter of its velocity limits at most. It is the same at every run, and needs no plan.

use super::Controller;
use crate::control::behaviour::{LIMIT_SHARE, MotionCommand};
use crate::drive::DriveState;
use crate::messages::TargetStatus;
use crate::servo::Convergence;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::{SVector, Vector2};
use std::f64::consts::TAU;

/// Growth of the pattern's radius in a turn, normalized. Chosen by hand: less than what a usual image shows beside a usual target, so that turns overlap.
const PITCH: f64 = 0.2;
/// Radius at which the search is over, normalized. Chosen by hand: 31 degrees, behind which the image of a usual lens shows 50.
const WIDEST: f64 = 0.6;
/// Speed of the place in the image, 1/s: a frame of 25 Hz moves it by 16 px of a lens with 800 px, which is no blur at a hundredth of a second.
const SPEED_1_S: f64 = 0.5;
/// Distance of the place from the pattern at which that waits for the arm, normalized; the nearer, the faster it goes on. Chosen by hand: a tenth of a usual image.
const BEHIND: f64 = 0.05;
/// Rate of the motion, by which the arm brakes at the end of a joint's range, 1/s. Chosen by hand: that of the way back.
const RATE_1_S: f64 = 2.0;

/// How far a search is.
#[derive(Debug, Clone, Copy)]
pub(super) struct SearchMotion {
    until: MonoNs,
    angle: f64,
    /// How far the place is from where it is to be shown, normalized.
    behind: f64,
}

impl SearchMotion {
    pub(super) fn new(now: MonoNs, longest: SpanNs) -> Self {
        Self { until: now + longest, angle: 0.0, behind: BEHIND }
    }

    /// Whether it goes on at `now`.
    pub(super) fn goes_on(&self, now: MonoNs) -> bool {
        now < self.until && self.radius() < WIDEST
    }

    fn radius(&self) -> f64 {
        PITCH * self.angle / TAU
    }

    /// Where the place is shown, and how that moves for a radian of the pattern.
    fn shown(&self) -> (Vector2<f64>, Vector2<f64>) {
        let (sin, cos) = self.angle.sin_cos();
        let (out, along) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        (out * self.radius(), out * (PITCH / TAU) + along * self.radius())
    }
}

/// Whether a measurement of this status says that the target is elsewhere: not where the camera is covered or blinded, or what is there fits no pose.
pub(super) fn is_elsewhere(status: TargetStatus) -> bool {
    matches!(status, TargetStatus::TooFewRegions | TargetStatus::NoMatch | TargetStatus::OtherTags)
}

impl<const N: usize> Controller<N> {
    /// The motion of a search at this tick; rest where there is none.
    pub(super) fn search(&mut self, state: &DriveState<N>) -> MotionCommand<N> {
        let Some(search) = self.returning.search_mut() else { return MotionCommand::Stand };
        let (s_d, along) = search.shown();
        let turn_1_s = SPEED_1_S / along.norm() * (1.0 - search.behind / BEHIND).max(0.0);
        let wanted = self.servo.look_around(&self.arm.robot, &state.q, (&s_d, &(along * turn_1_s)));
        let Some((qd, behind)) = wanted else { return MotionCommand::Stand };
        let share = within_share(&qd, &self.arm.limits.velocity);
        search.angle += turn_1_s * share * TICK.as_s();
        search.behind = behind;
        MotionCommand::Velocity(qd * share, Convergence::at(RATE_1_S))
    }
}

/// The share of `qd` that is within a quarter of the velocity limits, 0 to 1.
pub(super) fn within_share<const N: usize>(qd: &SVector<f64, N>, limits: &SVector<f64, N>) -> f64 {
    let over = qd.iter().zip(limits).map(|(qd, limit)| qd.abs() / (LIMIT_SHARE * limit));
    over.fold(1.0, f64::max).recip()
}
