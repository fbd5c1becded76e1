//! One joint on its way to rest: the braking that jerk and acceleration limits allow, in closed form.
//!
//! Braking takes the shortest time from velocity `v` and acceleration `a` to `v = a = 0`: jerk `-J` until the
//! acceleration is `-p`, a while at `-p = -A` if that is reached, jerk `+J` until it is zero (all signs turned where
//! the joint moves backwards). With `v + a |a| / 2J > 0` the peak is `p = min(A, sqrt(J v + a^2 / 2))`.

/// Relative slack of the velocity limit: at the limit itself the sums are off by some units of rounding, 2e-16 each.
const SLACK: f64 = 1e-12;

/// Share of the acceleration and jerk limits with which the braking distance is computed. Chosen by hand: the distance to the goal is an
/// estimate of the law, so that the rest must be left for its errors. With 1 an error of the distance becomes overshoot; with half of
/// this value braking over the same distance takes up to `sqrt 2` times as long.
const SHARE: f64 = 0.7;

/// Position, velocity, acceleration of a joint; rad or m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct JointMotionState {
    pub(super) q: f64,
    pub(super) v: f64,
    pub(super) a: f64,
}

/// The limits of a joint.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(super) lower: f64,
    pub(super) upper: f64,
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) jerk: f64,
}

/// The limit that a joint would exceed while braking.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Breach {
    Position,
    Velocity,
}

impl JointMotionState {
    /// After `t` seconds of constant jerk.
    pub(super) fn after(self, jerk: f64, t: f64) -> Self {
        Self {
            q: self.q + t * (self.v + t * (self.a / 2.0 + t * jerk / 6.0)),
            v: self.v + t * (self.a + t * jerk / 2.0),
            a: self.a + t * jerk,
        }
    }

    /// The point at `share` of the way to another one.
    pub(super) fn towards(self, other: Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + share * (b - a);
        Self { q: mix(self.q, other.q), v: mix(self.v, other.v), a: mix(self.a, other.a) }
    }

    /// The velocity once a jerk of this size has brought the acceleration to zero: braking goes against its sign.
    fn settled(self, jerk: f64) -> f64 {
        self.v + self.a * self.a.abs() / (2.0 * jerk)
    }
}

/// The three phases of braking: jerk and duration.
fn phases(s: JointMotionState, b: &Bounds) -> [(f64, f64); 3] {
    let (J, A) = (b.jerk, b.acceleration);
    let side = s.settled(J);
    if side == 0.0 {
        return [(0.0, 0.0), (0.0, 0.0), (-s.a.signum() * J, s.a.abs() / J)];
    }
    let sign = side.signum();
    let (v, a) = (s.v * sign, s.a * sign);
    let square = J * v + a * a / 2.0;
    let p = square.max(0.0).sqrt().min(A);
    let hold = ((square - p * p) / (J * p)).max(0.0);
    let hold = if hold.is_finite() { hold } else { 0.0 };
    [(-J * sign, ((a + p) / J).max(0.0)), (0.0, hold), (J * sign, p / J)]
}

/// How long braking takes.
pub(super) fn braking_time_s(s: JointMotionState, b: &Bounds) -> f64 {
    phases(s, b).iter().map(|(_, duration)| duration).sum()
}

/// The state after braking for `t` seconds; at rest once braking is complete.
pub(super) fn braked(s: JointMotionState, b: &Bounds, t: f64) -> JointMotionState {
    let (mut at, mut left) = (s, t);
    for (jerk, duration) in phases(s, b) {
        let part = duration.min(left);
        at = at.after(jerk, part);
        left -= part;
        if left <= 0.0 {
            return at;
        }
    }
    JointMotionState { q: at.q, v: 0.0, a: 0.0 }
}

/// The limit that braking from `s` would exceed, if any. A joint that is already outside its range may not move farther out.
pub(super) fn breach(s: JointMotionState, b: &Bounds, q_now: f64) -> Option<Breach> {
    let (lower, upper) = (b.lower.min(q_now), b.upper.max(q_now));
    if !(peak_speed(s, b) <= b.velocity * (1.0 + SLACK)) {
        return Some(Breach::Velocity);
    }
    let (least, most) = extent(s, b);
    (!(least >= lower && most <= upper)).then_some(Breach::Position)
}

/// The largest speed on the way to rest: that of now, or that to which an acceleration still leads.
pub(super) fn peak_speed(s: JointMotionState, b: &Bounds) -> f64 {
    s.v.abs().max(s.settled(b.jerk).abs())
}

/// The lowest and the highest position on the way to rest.
pub(super) fn extent(s: JointMotionState, b: &Bounds) -> (f64, f64) {
    let J = b.jerk;
    let sign = if s.settled(J) < 0.0 { -1.0 } else { 1.0 };
    let (v, a) = (s.v * sign, s.a * sign);
    let [first, second, third] = phases(s, b);
    let end = s.after(first.0, first.1).after(second.0, second.1).after(third.0, third.1).q;
    // A joint that still moves the other way turns on the way.
    let turn = if v < 0.0 && a > 0.0 {
        let t = (a - (a * a + 2.0 * J * v).max(0.0).sqrt()) / J;
        s.after(-J * sign, t).q
    } else {
        s.q
    };
    (s.q.min(end).min(turn), s.q.max(end).max(turn))
}

/// The speed towards a goal at the distance `now.q` (not negative) from which braking ends there at rest. From zero
/// acceleration the braking distance is `d = v^1.5 / sqrt(J)` while the acceleration limit is not reached, and
/// `d = v (v / A + A / J) / 2` otherwise. The distance that the joint covers while its present acceleration is reduced to zero is
/// subtracted first.
pub(super) fn braking_speed(now: JointMotionState, bounds: &Bounds) -> f64 {
    let (A, J) = (SHARE * bounds.acceleration, SHARE * bounds.jerk);
    let (a, v) = (now.a.max(0.0), now.v.max(0.0));
    let distance = (now.q - a / J * (v + a * a / (3.0 * J))).max(0.0);
    if distance * J * J <= A * A * A {
        (distance * J.sqrt()).powf(2.0 / 3.0)
    } else {
        let half = A * A / (2.0 * J);
        (half * half + 2.0 * A * distance).sqrt() - half
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const B: Bounds = Bounds { lower: -1.0, upper: 1.0, velocity: 2.0, acceleration: 5.0, jerk: 40.0 };

    /// Fine steps along the braking against the closed forms of its end and its extremes.
    fn walked(s: JointMotionState) -> Result<(), TestCaseError> {
        let JointMotionState { q, v, .. } = s;
        let total: f64 = braking_time_s(s, &B);
        let (mut least, mut most, mut fastest) = (q, q, v.abs());
        for i in 0..=2000 {
            let at = braked(s, &B, total * f64::from(i) / 2000.0);
            (least, most, fastest) = (least.min(at.q), most.max(at.q), fastest.max(at.v.abs()));
            prop_assert!(at.a.abs() <= B.acceleration + 1e-9);
        }
        let end = braked(s, &B, total * (1.0 - 1e-12));
        prop_assert!(end.v.abs() < 1e-6 && end.a.abs() < 1e-4, "{end:?}");
        let told = extent(s, &B);
        prop_assert!(
            (told.0 - least).abs() < 1e-5 && (told.1 - most).abs() < 1e-5,
            "{told:?} {least} {most}"
        );
        let peak = peak_speed(s, &B);
        prop_assert!(peak >= fastest - 1e-9 && peak < fastest + 1e-3, "{peak} {fastest}");
        let inside = least >= B.lower && most <= B.upper && fastest <= B.velocity;
        let margin = (least - B.lower).min(B.upper - most).min(B.velocity - fastest).abs();
        prop_assume!(margin > 1e-5);
        prop_assert_eq!(breach(s, &B, q).is_none(), inside, "{} {} {}", least, most, fastest);
        Ok(())
    }

    proptest! {
        #[test]
        fn braking_ends_at_rest_and_its_extremes_are_known(v in -2.0..2.0f64, a in -5.0..5.0f64, q in -1.0..1.0f64) {
            walked(JointMotionState { q, v, a })?;
        }

        /// One that still moves the other way, and near an end of its range: where it turns decides.
        #[test]
        fn a_joint_that_turns_first_is_seen_where_it_turns(share in 0.1..1.0f64, a in 1.0..5.0f64, room in 0.0..1.0f64, side in prop_oneof![Just(1.0), Just(-1.0)]) {
            let v = share * a * a / (2.0 * B.jerk);
            // In the time in which its acceleration is gone it goes back by no more than `v a / J`.
            let q = B.upper - room * v * a / B.jerk;
            walked(JointMotionState { q: side * q, v: side * v, a: -side * a })?;
        }

        /// Braking followed tick by tick is the same braking.
        #[test]
        fn braking_can_be_taken_up_again(v in -2.0..2.0f64, a in -5.0..5.0f64) {
            let s = JointMotionState { q: 0.0, v, a };
            let mut at = s;
            for _ in 0..700 { at = braked(at, &B, 1e-3); }
            let once = braked(s, &B, 0.7);
            prop_assert!((at.q - once.q).abs() < 1e-9, "{at:?} {once:?}");
        }
    }

    /// Where braking by the shares of the limits ends from the speed that is told, walked by its phases; a present acceleration is worked off on the way.
    #[test]
    fn the_speed_towards_a_goal_is_one_from_which_it_brakes() {
        let shared = Bounds { acceleration: SHARE * B.acceleration, jerk: SHARE * B.jerk, ..B };
        let (mut short, mut long) = (0, 0);
        for k in 1..60 {
            let d = 1e-4 * 1.2_f64.powi(k);
            let told = braking_speed(JointMotionState { q: d, v: 0.0, a: 0.0 }, &B);
            let from = JointMotionState { q: 0.0, v: told, a: 0.0 };
            let (_, end) = extent(from, &shared);
            assert!((end / d - 1.0).abs() < 1e-9, "{d}: {end}");
            let is_short = phases(from, &shared)[1].1 < 1e-9;
            (short, long) = (short + u32::from(is_short), long + u32::from(!is_short));
            for (v, a) in [(0.3, 2.0), (0.0, 1.5), (0.7, 0.0)] {
                let now = JointMotionState { q: 0.0, v, a };
                let way = now.after(-shared.jerk, a / shared.jerk).q;
                let same = braking_speed(JointMotionState { q: d + way, v, a }, &B);
                assert!((same / told - 1.0).abs() < 1e-9, "{d} {v} {a}: {same} {told}");
            }
            // What drives it away from the goal is no way towards it.
            assert_eq!(braking_speed(JointMotionState { q: d, v: -0.4, a: -2.0 }, &B), told);
        }
        assert!(short > 5 && long > 5, "{short} {long}");
        assert_eq!(braking_speed(JointMotionState { q: 1e-3, v: 1.0, a: 3.0 }, &B), 0.0, "it is past it");
    }

    /// A joint whose acceleration alone is left rests when that is worked off: 4 rad/s2 by 40 rad/s3.
    #[test]
    fn the_end_of_braking_lasts_as_long_as_its_acceleration() {
        for side in [1.0, -1.0] {
            let s = JointMotionState { q: 0.1, v: -0.2 * side, a: 4.0 * side };
            assert_eq!(s.settled(B.jerk), 0.0);
            assert!((braking_time_s(s, &B) - 0.1).abs() < 1e-12);
            let end = braked(s, &B, 0.1 - 1e-9);
            assert!(end.v.abs() < 1e-6 && end.a.abs() < 1e-6, "{end:?}");
            let half = braked(s, &B, 0.05);
            assert!((half.a - 2.0 * side).abs() < 1e-9, "{half:?}");
        }
    }

    #[test]
    fn a_share_of_the_way_is_one_of_each_number() {
        let (from, to) =
            (JointMotionState { q: 1.0, v: -2.0, a: 3.0 }, JointMotionState { q: 3.0, v: 2.0, a: -5.0 });
        assert_eq!(from.towards(to, 0.25), JointMotionState { q: 1.5, v: -1.0, a: 1.0 });
    }

    #[test]
    fn rest_stays_rest() {
        let s = JointMotionState { q: 0.3, v: 0.0, a: 0.0 };
        assert_eq!(braked(s, &B, 1e-3), s);
        assert_eq!(breach(s, &B, 0.3), None);
    }
}
