//! Moves from posture to posture and rests in each. The postures come from the mission: nothing is planned here.
//!
//! Between two postures all joints follow `q(t) = q_a + (q_b - q_a) s(t / T)`, `s(u) = 10 u^3 - 15 u^4 + 6 u^5`: velocity and acceleration
//! begin and end with zero, and T is such that at most a quarter of each joint's limits is used. The motion command is a velocity; the
//! posture that was reached is read from the encoders at rest.

use super::MotionCommand;
use crate::motion::MotionLimits;
use crate::time::{SpanNs, TICK};
use nalgebra::SVector;

/// Share of a joint's limits on velocity, acceleration and jerk that the motion uses. Chosen by hand, so that the reference, which may
/// use all of them, never cuts the motion. Twice the share halves the time of long legs.
pub const LIMIT_SHARE: f64 = 0.25;
/// Largest velocity, acceleration and jerk of s(u), which follows from its derivatives: `s'(1/2) = 15/8`,
/// `s''((3 - sqrt 3) / 6) = 10 / sqrt 3`, `s'''(0) = 60`.
const PEAKS: [f64; 3] = [1.875, 5.7735, 60.0];
/// Shortest motion, s. Chosen by hand; it bounds the velocity where two postures are nearly the same.
const SHORTEST_S: f64 = 0.2;
/// Rest in each posture. Chosen by hand: 30 frames of a camera at 25 Hz, of which the last show an arm that has settled.
const REST: SpanNs = SpanNs(1_200_000_000);
/// Postures that can wait to be visited. A calibration tour has 14, so that it needs this capacity, rounded up to a power of two.
const MAX_WAYPOINTS: usize = 16;

/// A list of postures, of which one after the other is visited.
#[derive(Debug, Default)]
pub struct Waypoints<const N: usize> {
    /// Still to come, the next one at `next`.
    list: [Option<SVector<f64, N>>; MAX_WAYPOINTS],
    next: usize,
    left: usize,
    leg: Option<Leg<N>>,
    rested: SpanNs,
    /// Whether there has been any.
    begun: bool,
    /// Whether postures are still wanted after the arm was held or stopped on the way.
    passing: bool,
}

/// On the way between two postures.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg<const N: usize> {
    way: SVector<f64, N>,
    duration_s: f64,
    elapsed: SpanNs,
}

impl<const N: usize> Leg<N> {
    pub(super) fn new(way: SVector<f64, N>, limits: &MotionLimits<N>) -> Self {
        let [v, a, j] = PEAKS;
        let mut duration_s = SHORTEST_S;
        for (i, way) in way.iter().map(|way| way.abs()).enumerate() {
            duration_s = duration_s
                .max(v * way / (LIMIT_SHARE * limits.velocity[i]))
                .max((a * way / (LIMIT_SHARE * limits.acceleration[i])).sqrt())
                .max((j * way / (LIMIT_SHARE * limits.jerk[i])).cbrt());
        }
        Self { way, duration_s, elapsed: SpanNs(0) }
    }

    /// The velocity of the next tick, before limits in space; `None` at the end. Of the tick the part `pace` counts, 0 to 1.
    pub(super) fn advance(&mut self, pace: f64) -> Option<SVector<f64, N>> {
        // the velocity in the middle of the tick: its sum over the ticks is then the displacement, by the midpoint rule
        let u = (self.elapsed.as_s() + 0.5 * TICK.as_s() * pace) / self.duration_s;
        let step = SpanNs((TICK.0 as f64 * pace) as i64);
        self.elapsed = SpanNs(self.elapsed.0.saturating_add(step.0));
        (u < 1.0).then(|| self.way * (30.0 * u * u * (1.0 - u) * (1.0 - u) / self.duration_s))
    }

    /// The part of the way that remains, rad or m.
    pub(super) fn remaining(&self) -> SVector<f64, N> {
        let u = (self.elapsed.as_s() / self.duration_s).min(1.0);
        self.way * (1.0 - u * u * u * (10.0 - 15.0 * u + 6.0 * u * u))
    }

    /// How long its end is ago; negative before.
    pub(super) fn ended_for_s(&self) -> f64 {
        self.elapsed.as_s() - self.duration_s
    }
}

impl<const N: usize> Waypoints<N> {
    /// A list of postures that are forgotten where the arm is held or stopped: each is worth as much as the look at the target that it was
    /// planned from.
    #[must_use]
    pub fn passing() -> Self {
        Self { passing: true, ..Self::default() }
    }

    /// The arm does not move by this behaviour at this tick.
    pub(super) fn interrupt(&mut self) {
        if self.passing && self.begun {
            *self = Self::passing();
        }
    }

    /// Adds one, which must be finite, where there is room for it; whether it did.
    pub(super) fn add(&mut self, q: &SVector<f64, N>) -> bool {
        let place = self.list.get_mut((self.next + self.left) % MAX_WAYPOINTS);
        let Some(place) = place.filter(|place| place.is_none() && q.iter().all(|q| q.is_finite())) else {
            return false;
        };
        *place = Some(*q);
        self.left += 1;
        self.begun = true;
        true
    }

    /// 1 once there is a waypoint: the motion does not depend on a view.
    pub(super) fn confidence(&self) -> f64 {
        if self.begun { 1.0 } else { 0.0 }
    }

    pub(super) fn motion_command(
        &mut self,
        q: &SVector<f64, N>,
        pace: f64,
        limits: &MotionLimits<N>,
    ) -> MotionCommand<N> {
        if let Some(qd) = self.leg.as_mut().and_then(|leg| leg.advance(pace)) {
            return MotionCommand::Joints(qd);
        }
        if self.leg.take().is_some() {
            self.rested = SpanNs(0);
        }
        self.rested = SpanNs(self.rested.0.saturating_add(TICK.0));
        if self.rested >= REST
            && let Some(next) = self.list.get_mut(self.next).and_then(Option::take)
        {
            self.leg = Some(Leg::new(next - q, limits));
            self.next = (self.next + 1) % MAX_WAYPOINTS;
            self.left -= 1;
        }
        MotionCommand::Joints(SVector::zeros())
    }

    pub(super) fn is_over(&self) -> bool {
        self.begun && self.left == 0 && self.leg.is_none() && self.rested >= REST
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    fn limits() -> MotionLimits<2> {
        MotionLimits {
            lower: Vector2::repeat(-3.0),
            upper: Vector2::repeat(3.0),
            velocity: Vector2::new(2.0, 3.0),
            acceleration: Vector2::repeat(10.0),
            jerk: Vector2::repeat(500.0),
        }
    }

    #[test]
    fn each_posture_is_reached_within_the_limits_and_rested_in() {
        let postures = [Vector2::new(0.5, -0.2), Vector2::new(-0.4, 1.0), Vector2::new(-0.4, 1.0)];
        let mut waypoints = Waypoints::<2>::default();
        assert_eq!((waypoints.confidence(), waypoints.is_over()), (0.0, false));
        assert!(postures.iter().all(|q| waypoints.add(q)));
        let (mut q, mut before, mut rests, mut visited) = (Vector2::zeros(), Vector2::zeros(), 0, Vec::new());
        while !waypoints.is_over() {
            let qd = waypoints.motion_command(&q, 1.0, &limits()).velocity();
            assert!((0..2).all(|i| qd[i].abs() <= 0.2501 * limits().velocity[i]), "{qd}");
            let qdd = (qd - before) / 1e-3;
            assert!((0..2).all(|i| qdd[i].abs() <= 0.26 * limits().acceleration[i]), "{qdd}");
            (q, before) = (q + qd * 1e-3, qd);
            rests = if qd == Vector2::zeros() { rests + 1 } else { 0 };
            if rests == 1000 {
                visited.push(q);
            }
        }
        assert_eq!(visited.len(), 1 + postures.len(), "the first rest is where it began");
        for (there, wanted) in visited[1..].iter().zip(&postures) {
            assert!((there - wanted).amax() < 1e-5, "{there} {wanted}");
        }
    }

    /// An interrupted tour goes on; a posture that is worth one look is given up.
    #[test]
    fn an_interruption_forgets_what_is_passing() {
        let mut tour = Waypoints::<2>::default();
        let mut passing = Waypoints::<2>::passing();
        for waypoints in [&mut tour, &mut passing] {
            waypoints.interrupt();
            assert!(waypoints.add(&Vector2::new(0.5, 0.5)));
            let moves = |w: &mut Waypoints<2>| {
                w.motion_command(&Vector2::zeros(), 1.0, &limits()).velocity() != Vector2::zeros()
            };
            assert!((0..2000).any(|_| moves(waypoints)));
            waypoints.interrupt();
        }
        assert_eq!((tour.confidence(), passing.confidence()), (1.0, 0.0));
        assert_eq!(passing.motion_command(&Vector2::zeros(), 1.0, &limits()).velocity(), Vector2::zeros());
        assert!(!passing.is_over());
    }

    #[test]
    fn a_full_list_and_what_is_no_posture_are_refused() {
        let mut waypoints = Waypoints::<2>::default();
        assert!(!waypoints.add(&Vector2::new(0.0, f64::NAN)));
        assert!((0..MAX_WAYPOINTS).all(|_| waypoints.add(&Vector2::zeros())));
        assert!(!waypoints.add(&Vector2::zeros()));
    }
}
