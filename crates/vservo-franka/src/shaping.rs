//! From what is wanted to commands that the robot takes: a first-order low-pass, then limits of velocity, acceleration and jerk, as the maker's documentation asks
//! of commands.
//!
//! ```text
//! position   v = qd_r + k e,  |k e| no more than can be braked from;  e = q_r + qd_r age - q_d
//! velocity   v = qd_r
//! hold       v = 0
//!            v' = v_d + g (v - v_d),  g = T / (T + 1 / (2 pi f))                      f = 100 Hz, T = 1 ms
//!            a  = (v' - v_d) / T,  |a| <= a_max,  |a| <= fade (v_max(q_d) - v_d),  |a - a_d| <= jerk T
//!            v_d += a T,  q_d += v_d T                                                what is commanded
//! torque     the same low-pass, then the rise and the torques themselves are limited
//! ```
//! `q_d`, `v_d`, `a_d` are what the robot says it was commanded last. Where that is what was sent, up to single precision, the numbers that were sent are used, for
//! rounding alone would be 240 rad/s3 of jerk. So it is where commands were lost and the robot went on by itself, with the accelerations that it had; where it says
//! something else, that is believed.

use crate::limits::{JointLimit, JointLimits, MAX_ACCELERATION, MAX_JERK, MAX_TORQUE, MAX_TORQUE_RATE};
use crate::wire::RobotState;
use crate::{CYCLE_S, JOINTS, Joints};

/// Cut-off of the low-pass, Hz: the maker's default.
pub const CUT_OFF_HZ: f64 = 100.0;
/// Share of each limit that is used: a tenth of a per mille is left for rounding.
const SHARE: f64 = 0.9999;
/// Gain of the position loop, 1/s. Chosen by hand: a tenth of what the low-pass lets through (2 pi 100 Hz), so that the two do not swing.
const GAIN: f64 = 60.0;
/// Deceleration that the position loop counts on, rad/s2. Chosen by hand: 0.6 of the limit leave room for jerk and low-pass.
const BRAKES: f64 = 0.6 * MAX_ACCELERATION;
/// Deceleration before the ends of a joint, rad/s2, where the robot's own is not less. Chosen by hand: so that jerk is left for the fade, `FADE * 4 = 1000` rad/s3 of it.
const BRAKES_AT_END: f64 = 4.0;
/// Rate with which accelerations fade towards the limits of velocity, 1/s. Chosen by hand: half of jerk over acceleration, 2500 rad/s3 with all of the acceleration.
const FADE: f64 = 0.5 * MAX_JERK / MAX_ACCELERATION;
/// What single precision may make of a number: 4.7 rad have steps of 4.8e-7, velocities and accelerations likewise.
const ROUNDING: [f64; 3] = [1e-6, 1e-6, 2e-6];

/// What a motion is commanded now: positions, velocities, accelerations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Course {
    /// rad.
    pub q: Joints,
    /// rad/s.
    pub qd: Joints,
    /// rad/s2.
    pub qdd: Joints,
}

/// What is wanted of a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wanted {
    /// To stand.
    Rest,
    /// To be at these positions now, and to move on with these velocities.
    Position {
        /// rad.
        q: Joints,
        /// rad/s.
        qd: Joints,
    },
    /// To have these velocities.
    Velocity(Joints),
}

/// What is left of a signal of the cycle before, for a cut-off.
fn share() -> f64 {
    CYCLE_S / (CYCLE_S + 1.0 / (std::f64::consts::TAU * CUT_OFF_HZ))
}

impl Course {
    /// At rest.
    #[must_use]
    pub fn at(q: Joints) -> Self {
        Self { q, qd: [0.0; JOINTS], qdd: [0.0; JOINTS] }
    }

    /// So many cycles later without commands: the robot holds accelerations.
    #[must_use]
    pub fn unattended(self, cycles: u64) -> Self {
        let mut next = self;
        // Chosen by hand: more than the robot goes on for.
        for _ in 0..cycles.min(50) {
            for ((q, v), a) in next.q.iter_mut().zip(&mut next.qd).zip(&next.qdd) {
                *v += a * CYCLE_S;
                *q += *v * CYCLE_S;
            }
        }
        next
    }

    /// Whether this is what a state says, up to its precision.
    #[must_use]
    pub fn is_told(&self, state: &RobotState) -> bool {
        let [q, qd, qdd] = ROUNDING;
        let near = |a: &Joints, b: &Joints, within: f64| {
            a.iter().zip(b).all(|(a, b)| (a - b).abs() <= within * a.abs().max(1.0))
        };
        near(&self.q, &state.q_d, q) && near(&self.qd, &state.dq_d, qd) && near(&self.qdd, &state.ddq_d, qdd)
    }

    /// What a state says.
    #[must_use]
    pub fn told(state: &RobotState) -> Self {
        Self { q: state.q_d, qd: state.dq_d, qdd: state.ddq_d }
    }

    /// A cycle later.
    #[must_use]
    pub fn step(&self, wanted: &Wanted, limits: &JointLimits) -> Self {
        let mut next = *self;
        let share = share();
        for i in 0..JOINTS {
            let (q, v, a) = (self.q[i], self.qd[i], self.qdd[i]);
            let wish = match wanted {
                Wanted::Rest => 0.0,
                Wanted::Velocity(to) => to[i],
                Wanted::Position { q: to, qd } => qd[i] + approach(to[i] - q),
            };
            let wish = v + share * (if wish.is_finite() { wish } else { 0.0 } - v);
            let limit =
                JointLimit { deceleration: limits.0[i].deceleration.min(BRAKES_AT_END), ..limits.0[i] };
            // The fade lags behind limits that shrink by 1 / FADE: so they are taken where the joint is by then.
            next.qdd[i] = limited(wish, (v, a), limit.velocities(q + v / FADE));
            next.qd[i] = v + next.qdd[i] * CYCLE_S;
            next.q[i] = q + next.qd[i] * CYCLE_S;
        }
        next
    }

    /// Whether nothing moves.
    #[must_use]
    pub fn rests(&self) -> bool {
        // Chosen by hand: 0.5 mrad/s, above what single precision makes of a position that stands, 4.8e-7 rad in a cycle.
        self.qd.iter().all(|v| v.abs() < 5e-4)
    }
}

/// Velocity towards a position that is `e` away: in proportion, and farther away as fast as it can be braked from.
fn approach(e: f64) -> f64 {
    let linear = BRAKES / (GAIN * GAIN);
    if e.abs() <= linear { GAIN * e } else { (2.0 * BRAKES * (e.abs() - 0.5 * linear)).sqrt().copysign(e) }
}

/// The acceleration of the next cycle that comes nearest to a velocity. What is limited last is jerk, which a robot forgives least.
fn limited(wish: f64, (v, a): (f64, f64), (slowest, fastest): (f64, f64)) -> f64 {
    let (jerk, most) = (SHARE * MAX_JERK * CYCLE_S, SHARE * MAX_ACCELERATION);
    let up = (FADE * (SHARE * fastest - v)).clamp(-most, most);
    let down = (FADE * (SHARE * slowest - v)).clamp(-most, most);
    let wished = ((wish - v) / CYCLE_S).min(up).max(down);
    a + (wished - a).clamp(-jerk, jerk)
}

/// Torques a cycle later than `last`, within the limits of their rise and of the joints.
#[must_use]
pub fn limited_torques(wanted: &Joints, last: &Joints) -> Joints {
    let (share, rise) = (share(), SHARE * MAX_TORQUE_RATE * CYCLE_S);
    std::array::from_fn(|i| {
        let (wanted, last, most) = (wanted[i], last[i], SHARE * MAX_TORQUE[i]);
        let wanted = if wanted.is_finite() { wanted } else { 0.0 };
        let smoothed = last + share * (wanted - last);
        (last + (smoothed - last).clamp(-rise, rise)).clamp(-most, most)
    })
}

/// Torques that the last ones are continued from: those that were sent, or what the state says instead.
#[must_use]
pub fn torques_as_told(sent: &Joints, state: &RobotState) -> Joints {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-6 * a.abs().max(1.0);
    if sent.iter().zip(&state.tau_d).all(near) { *sent } else { state.tau_d }
}

#[cfg(test)]
mod tests {
    use super::*;

    const Q: Joints = [0.1, -0.5, 0.0, -2.1, 0.1, 1.8, 0.2];

    /// Derivatives of what is commanded, over a course.
    fn largest(course: &[Course]) -> (f64, f64, f64) {
        let mut most = (0.0_f64, 0.0_f64, 0.0_f64);
        for pair in course.windows(2) {
            for i in 0..JOINTS {
                let v = (pair[1].q[i] - pair[0].q[i]) / CYCLE_S;
                let a = (v - pair[0].qd[i]) / CYCLE_S;
                let j = (a - pair[0].qdd[i]) / CYCLE_S;
                most = (most.0.max(v.abs()), most.1.max(a.abs()), most.2.max(j.abs()));
            }
        }
        most
    }

    fn run(wanted: impl Fn(usize) -> Wanted, cycles: usize) -> Vec<Course> {
        let limits = JointLimits::fr3();
        let mut course = vec![Course::at(Q)];
        for k in 0..cycles {
            let next = course[k].step(&wanted(k), &limits);
            course.push(next);
        }
        course
    }

    #[test]
    fn whatever_is_wanted_the_limits_are_kept() {
        let mut far = Q;
        far[0] += 1.5;
        far[3] -= 0.6;
        // Steps of position, of velocity, back and forth faster than can be followed, beyond every end, and no numbers.
        let swing = |k: usize| if (k / 40).is_multiple_of(2) { 3.0 } else { -3.0 };
        let wishes: [&dyn Fn(usize) -> Wanted; 6] = [
            &|_| Wanted::Position { q: far, qd: [0.0; JOINTS] },
            &|_| Wanted::Velocity([9.0; JOINTS]),
            &|k| Wanted::Velocity([swing(k); JOINTS]),
            &|k| Wanted::Position { q: [swing(k); JOINTS], qd: [swing(k + 7); JOINTS] },
            &|k| if k % 3 == 0 { Wanted::Rest } else { Wanted::Velocity([swing(k); JOINTS]) },
            &|_| Wanted::Velocity([f64::NAN; JOINTS]),
        ];
        for (number, wanted) in wishes.iter().enumerate() {
            let course = run(wanted, 4000);
            let (v, a, j) = largest(&course);
            // Two differences of double precision leave 1e-4 of a jerk.
            assert!(v <= 5.26 && a <= 10.0 + 1e-6 && j <= 5000.1, "{number}: {v} {a} {j}");
            for c in &course {
                for ((q, v), limit) in c.q.iter().zip(&c.qd).zip(&JointLimits::fr3().0) {
                    assert!((limit.lower..=limit.upper).contains(q), "{number}: {q}");
                    let (slowest, fastest) = limit.velocities(*q);
                    assert!(*v <= fastest + 1e-9 && *v >= slowest - 1e-9, "{number}: {v} at {q}");
                }
            }
        }
    }

    #[test]
    fn a_far_position_is_reached_without_overshoot() {
        let mut far = Q;
        far[0] += 1.0;
        far[5] += 0.02;
        let course = run(|_| Wanted::Position { q: far, qd: [0.0; JOINTS] }, 3000);
        let end = course.last().unwrap();
        for i in 0..JOINTS {
            assert!((end.q[i] - far[i]).abs() < 1e-6, "{}", end.q[i] - far[i]);
            let beyond =
                course.iter().map(|c| (c.q[i] - far[i]) * (far[i] - Q[i]).signum()).fold(0.0, f64::max);
            assert!(beyond < 1e-3, "joint {i}: {beyond} rad");
        }
        assert!(end.rests());
    }

    /// Behind a smooth motion the commands stay by a small part of a cycle, for the position loop makes up for the low-pass.
    #[test]
    fn a_moving_reference_is_followed_without_lag() {
        let at = |k: usize| 0.3 * (1.0 - (std::f64::consts::PI * k as f64 * CYCLE_S).cos());
        let speed = |k: usize| 0.3 * std::f64::consts::PI * (std::f64::consts::PI * k as f64 * CYCLE_S).sin();
        let wanted = |k: usize| {
            let (mut q, mut qd) = (Q, [0.0; JOINTS]);
            (q[1], qd[1]) = (q[1] + at(k), speed(k));
            Wanted::Position { q, qd }
        };
        let course = run(wanted, 2000);
        let off = course.iter().enumerate().map(|(k, c)| (c.q[1] - Q[1] - at(k)).abs()).fold(0.0, f64::max);
        assert!(off < 0.3e-3 * 0.3 * std::f64::consts::PI, "{off} rad");
    }

    #[test]
    fn torques_rise_no_faster_than_they_may() {
        let mut tau = [0.0; JOINTS];
        for _ in 0..200 {
            let next = limited_torques(&[100.0, -100.0, f64::NAN, 0.5, 100.0, 0.0, -11.0], &tau);
            for (a, b) in next.iter().zip(&tau) {
                assert!((a - b).abs() <= 1.0);
            }
            tau = next;
        }
        let expected = [86.9913, -86.9913, 0.0, 0.5, 11.9988, 0.0, -11.0];
        for (a, b) in tau.iter().zip(expected) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn what_was_sent_is_continued_unless_the_robot_says_otherwise() {
        let sent = run(|_| Wanted::Velocity([0.4; JOINTS]), 37).pop().unwrap();
        let mut state = RobotState::at(sent.q);
        (state.dq_d, state.ddq_d) = (sent.qd, sent.qdd);
        let state = RobotState::decode(&state.encode()).unwrap();
        assert_ne!(state.q_d, sent.q, "single precision");
        assert!(sent.is_told(&state));
        let mut other = state;
        other.q_d[2] += 1e-4;
        assert!(!sent.is_told(&other));
        assert_eq!(Course::told(&other).q, other.q_d);
        let later = sent.unattended(2);
        assert!((later.qd[0] - sent.qd[0] - 2e-3 * sent.qdd[0]).abs() < 1e-12);
        assert!(!later.is_told(&state));
    }
}
