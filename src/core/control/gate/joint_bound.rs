//! The gate of one joint: whether a command is admissible, and the command that replaces it if not. It shares no code with the reference
//! that it checks, neither for reaching a velocity nor for the condition of being able to brake.
//!
//! From velocity `v >= 0` and no acceleration the shortest stop takes the distance
//! ```text
//! d_0(v) = v sqrt(v / J)             v <= A^2 / J: the acceleration goes to -sqrt(J v) and back
//!          v / 2 (v / A + A / J)     beyond: it stays at -A for a while
//! ```
//! An acceleration `a` is on that curve, shifted: bringing `a` to zero leads to `v + a^2 / 2J` and takes `v a / J + a^3 / 3 J^2`, and so
//! does, backwards in time, an `a < 0` from braking that has begun. Of both
//! ```text
//! d(v, a) = v a / J + a^3 / 3 J^2 + d_0(v + a^2 / 2J),    a > 0 or v >= a^2 / 2J;   else the joint turns, and the same holds of -v, -a
//! ```

/// Tolerance for rounding of positions (rad or m), velocities and accelerations. Chosen by hand: far above rounding, below any encoder step.
const ROUNDING: f64 = 1e-6;
/// Rate at which a joint approaches a command that it cannot follow at once, 1/s: about as fast as the error of a law of the default gain
/// decays, so that an acceleration of 10 rad/s^2 suffices from up to 0.1 rad away without overshoot.
const CATCH_UP_1_S: f64 = 10.0;
/// Share of a velocity error that is corrected in a tick. Derived: below `6 - sqrt 32 = 0.34` the acceleration does not oscillate
/// (`LAST_GAIN` in `motion/reference.rs`).
const TICK_SHARE: f64 = 0.3;
/// Bisections in search of the largest part of a step from which the joint can stop. Chosen by hand: found to one part in 64.
const HALVINGS: u32 = 6;

/// Where a joint is, rad or m, and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct JointMotion {
    pub(super) q: f64,
    pub(super) v: f64,
    pub(super) a: f64,
}

/// The limits of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct JointBound {
    /// Ends of its range, rad or m.
    pub(super) range: (f64, f64),
    /// Largest velocity, acceleration and jerk; positive.
    pub(super) v: f64,
    pub(super) a: f64,
    pub(super) j: f64,
}

impl JointMotion {
    /// After `t` seconds of the jerk `j`.
    fn after(self, j: f64, t: f64) -> Self {
        let Self { q, v, a } = self;
        Self { q: q + t * (v + t * (a / 2.0 + t * j / 6.0)), v: v + t * (a + t * j / 2.0), a: a + t * j }
    }

    /// The same motion with the opposite sign.
    fn mirrored(self) -> Self {
        Self { q: -self.q, v: -self.v, a: -self.a }
    }
}

impl JointBound {
    /// Whether a joint at `now` may be at `next` a tick of `dt` seconds later: within the limits in between, and able to stop from there.
    pub(super) fn admits(&self, now: JointMotion, next: JointMotion, dt: f64) -> bool {
        let change = self.j * dt;
        // Every comparison with NaN is false, so that NaN is not admissible.
        next.a.abs() <= self.a + ROUNDING * self.a
            && (next.a - now.a).abs() <= change + ROUNDING * (1.0 + change)
            && (next.v - now.v - dt * (now.a + next.a) / 2.0).abs() <= dt * (change / 2.0 + ROUNDING)
            && (next.q - now.q - dt * (now.v + next.v) / 2.0).abs() <= dt * (dt * change + ROUNDING)
            && self.can_stop(next, now.q, ROUNDING)
    }

    /// The next motion of a joint that is at `now` and is to approach `wanted`, whose numbers may be anything, NaN and infinity included.
    pub(super) fn approach(&self, now: JointMotion, wanted: JointMotion, dt: f64) -> JointMotion {
        let velocity = wanted.v + CATCH_UP_1_S * (wanted.q - now.q);
        let velocity = if velocity.is_finite() { velocity.clamp(-self.v, self.v) } else { 0.0 };
        let error = velocity - now.v;
        // An acceleration from which the jerk still brings it to zero when the velocity is reached.
        let most = self.a.min((1.6 * self.j * error.abs()).sqrt()).min(TICK_SHARE * error.abs() / dt);
        let jerk = ((most.copysign(error) - now.a) / dt).clamp(-self.j, self.j);
        let (step, stop) = (now.after(jerk, dt), self.stopping(now, dt));
        if self.can_stop(step, now.q, 0.0) {
            return step;
        }
        let (mut best, mut low, mut high) = (stop, 0.0, 1.0);
        for _ in 0..HALVINGS {
            let share = 0.5 * (low + high);
            let mix = |a: f64, b: f64| a + share * (b - a);
            let part = JointMotion { q: mix(stop.q, step.q), v: mix(stop.v, step.v), a: mix(stop.a, step.a) };
            if self.can_stop(part, now.q, 0.0) {
                (best, low) = (part, share);
            } else {
                high = share;
            }
        }
        best
    }

    /// Whether it can stop from `at` within range and velocity, to `slack` of both. Outside of its range it may not go farther out than `q_now`.
    fn can_stop(&self, at: JointMotion, q_now: f64, slack: f64) -> bool {
        let (lower, upper) = (self.range.0.min(q_now) - slack, self.range.1.max(q_now) + slack);
        // Its velocity once its acceleration is zero.
        let fastest = at.v + at.a * at.a.abs() / (2.0 * self.j);
        // At the velocity limit itself the sums above are off by some units of rounding, 2e-16 each.
        let limit = self.v * (1.0 + slack.max(1e-12));
        let (low, high) = self.extent(at);
        at.v.abs() <= limit && fastest.abs() <= limit && low >= lower && high <= upper
    }

    /// The lowest and the highest position while stopping.
    fn extent(&self, at: JointMotion) -> (f64, f64) {
        let j = self.j;
        if at.v + at.a * at.a.abs() / (2.0 * j) < 0.0 {
            let (low, high) = self.extent(at.mirrored());
            return (-high, -low);
        }
        let JointMotion { q, v, a } = at;
        let peak = v + a * a / (2.0 * j);
        let d_0 = if peak <= self.a * self.a / j {
            peak * (peak / j).sqrt()
        } else {
            peak / 2.0 * (peak / self.a + self.a / j)
        };
        let end = q + v * a / j + a * a * a / (3.0 * j * j) + d_0;
        // One that still moves the other way turns first, where v + a t - J t^2 / 2 is zero.
        let turn = if v < 0.0 {
            let t = (a - (a * a + 2.0 * j * v).max(0.0).sqrt()) / j;
            q + t * (v + t * (a / 2.0 - t * j / 6.0))
        } else {
            q
        };
        (q.min(end).min(turn), q.max(end).max(turn))
    }

    /// A tick of `dt` seconds along the shortest way to rest.
    fn stopping(&self, at: JointMotion, dt: f64) -> JointMotion {
        let j = self.j;
        let side = at.v + at.a * at.a.abs() / (2.0 * j);
        if side < 0.0 {
            return self.stopping(at.mirrored(), dt).mirrored();
        }
        // Down to -p, on at -p, and up to zero.
        let square = (j * at.v + at.a * at.a / 2.0).max(0.0);
        let p = square.sqrt().min(self.a);
        let hold = if p > 0.0 { ((square - p * p) / (j * p)).max(0.0) } else { 0.0 };
        let (mut motion, mut left) = (at, dt);
        for (jerk, lasts) in [(-j, ((at.a + p) / j).max(0.0)), (0.0, hold), (j, p / j)] {
            let part = lasts.min(left);
            motion = motion.after(jerk, part);
            left -= part;
        }
        if left > 0.0 { JointMotion { q: motion.q, v: 0.0, a: 0.0 } } else { motion }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A tick, s: derived from the control rate of 1 kHz.
    const DT: f64 = 1e-3;

    fn bound(range: (f64, f64)) -> JointBound {
        JointBound { range, v: 2.0, a: 10.0, j: 500.0 }
    }

    fn motion(q: f64, v: f64, a: f64) -> JointMotion {
        JointMotion { q, v, a }
    }

    /// The way to rest, walked in small steps whose positions are summed by the trapezoidal rule: it holds the limits on acceleration and jerk, ends, and goes as far
    /// as `extent` says.
    fn walked(from: JointMotion) -> Result<(), TestCaseError> {
        let b = bound((-9.0, 9.0));
        let dt = 1e-5;
        let (mut at, mut sum) = (from, from.q);
        let (mut low, mut high, mut steps) = (from.q, from.q, 0);
        while at.v != 0.0 || at.a != 0.0 {
            let next = b.stopping(at, dt);
            prop_assert!(next.a.abs() <= b.a.max(from.a.abs()) + 1e-9, "{next:?}");
            let rests = next.v == 0.0 && next.a == 0.0;
            prop_assert!((next.a - at.a).abs() <= b.j * dt * (1.0 + 1e-6) || rests, "{at:?} {next:?}");
            sum += 0.5 * dt * (at.v + next.v);
            (at, low, high) = (next, low.min(sum), high.max(sum));
            steps += 1;
            prop_assert!(steps < 100_000, "no end");
        }
        let told = b.extent(from);
        prop_assert!((told.0 - low).abs() < 1e-6 && (told.1 - high).abs() < 1e-6, "{told:?} {low} {high}");
        prop_assert!((at.q - sum).abs() < 1e-6);
        // One step is as many small ones.
        for ticks in [20_u32, 100, 300] {
            let once = b.stopping(from, f64::from(ticks) * DT);
            let many = (0..ticks).fold(from, |at, _| b.stopping(at, DT));
            prop_assert!(
                (once.q - many.q).abs() < 1e-8 && (once.v - many.v).abs() < 1e-8,
                "{once:?} {many:?}"
            );
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn the_way_to_rest_is_that_of_its_limits(q in -1.0..1.0f64, v in -2.0..2.0f64, a in -10.0..10.0f64) {
            walked(motion(q, v, a))?;
        }

        /// One that still moves against its acceleration, and turns before it rests.
        #[test]
        fn the_way_to_rest_of_a_joint_that_turns(q in -1.0..1.0f64, share in 0.1..1.0f64, a in 2.0..10.0f64, side in prop_oneof![Just(1.0), Just(-1.0)]) {
            let v = -share * a * a / (2.0 * 500.0);
            walked(motion(q, side * v, side * a))?;
        }

        /// From the edge of what is admitted the joint stops within its range: walked in small steps, on which its speed is looked at too.
        #[test]
        fn what_can_stop_stays_in_its_range(q in -1.0..1.0f64, v in -2.0..2.0f64, a in -10.0..10.0f64) {
            let b = bound((-0.4, 0.6));
            let mut at = motion(q, v, a);
            let may = b.can_stop(at, q, 0.0);
            let (mut low, mut high, mut fastest, mut steps) = (q, q, v.abs(), 0);
            while at.v != 0.0 || at.a != 0.0 {
                at = b.stopping(at, 1e-4);
                (low, high, fastest) = (low.min(at.q), high.max(at.q), fastest.max(at.v.abs()));
                steps += 1;
                prop_assert!(steps < 10_000, "no end");
            }
            let inside = low >= b.range.0.min(q) - 1e-5 && high <= b.range.1.max(q) + 1e-5 && fastest <= b.v + 1e-9;
            prop_assert!(!may || inside, "{low} {high} {fastest}");
            // Between two steps the speed may be 1e-3 rad/s more: a step of the largest acceleration.
            let clearly = low > b.range.0 + 1e-5 && high < b.range.1 - 1e-5 && fastest < b.v - 2e-3;
            prop_assert!(may || !clearly, "{low} {high} {fastest}");
        }
    }

    /// A position that does not follow from the velocity, a velocity that does not follow from the acceleration, an acceleration that leaps: each is refused, and what
    /// a jerk within its limit makes of them is admitted.
    #[test]
    fn what_does_not_follow_is_not_admitted() {
        let b = bound((-9.0, 9.0));
        for side in [1.0, -1.0] {
            let now = motion(0.3, 0.7 * side, 2.0 * side);
            for jerk in [-b.j, 0.0, b.j] {
                let next = now.after(jerk, DT);
                assert!(b.admits(now, next, DT), "{jerk}");
                // Jerk times tick is 0.5 rad/s2: half of it over a tick is 2.5e-4 rad/s, and all of it over two 5e-7 rad.
                for off in [3.5e-4, -3.5e-4] {
                    assert!(!b.admits(now, JointMotion { v: next.v + off, ..next }, DT), "{jerk} {off}");
                }
                for off in [6.5e-7, -6.5e-7] {
                    assert!(!b.admits(now, JointMotion { q: next.q + off, ..next }, DT), "{jerk} {off}");
                }
            }
            let next = now.after(0.0, DT);
            for share in [0.8, -0.8] {
                assert!(b.admits(now, JointMotion { v: next.v + share * 2.5e-4, ..next }, DT), "{share}");
                assert!(b.admits(now, JointMotion { q: next.q + share * 5e-7, ..next }, DT), "{share}");
            }
            for off in [0.51, -0.51] {
                assert!(!b.admits(
                    now,
                    JointMotion { a: next.a + off, v: next.v + DT * off / 2.0, ..next },
                    DT
                ));
            }
        }
        // Rounding is a millionth of an acceleration, and of how it may change in a tick.
        let leaps = |off: f64| {
            let (now, a) = (motion(0.3, 0.2, 1.0), 1.5 + off);
            b.admits(now, JointMotion { a, ..now.after(b.j, DT) }, DT)
        };
        assert!(leaps(1.4e-6) && !leaps(1.6e-6));
        let fast = motion(0.0, 0.0, 10.0);
        assert!(!b.admits(fast, fast.after(1.0, DT), DT), "beyond the largest acceleration");
    }
}
