//! How a controller turns instructions into a reference of the joints, cycle by cycle.
//!
//! ```text
//! servoj  s' = (q_d - s)/lookahead,  r' = gain/8 (s - r)        lags by lookahead + 8/gain: 34 ms with 0.03 s and 2000
//! speedj  v' towards v_d, all joints arriving together, |v'| <= a
//! stopj   v' towards 0 in the same way
//! direct_torque   no reference: what the joints do under the torques
//! ```
//! The maker publishes no equations of `servoj`: these two lags have its parameters' roles (smoothing, and a proportional gain), and the lag that
//! users measure with the quickest parameters.

use super::core::Torque;
use crate::program::RATE_OF_GAIN;
use crate::{JOINTS, Joints};
use std::fmt;

/// Fastest reference that the safety system lets pass, rad/s: the maker's data sheet has 180 degrees a second, with 2 % to spare.
const FASTEST_RAD_S: f64 = 1.02 * std::f64::consts::PI;
/// Largest change of the reference's velocity that is no sudden change of the target, rad/s2. Chosen by hand: four times what `speedj` is allowed.
const SUDDEN_RAD_S2: f64 = 160.0;
/// Deceleration of a stop by the safety system, and of a program that ends, rad/s2. Chosen by hand: 1 rad/s within 50 ms.
const SAFETY_STOP_RAD_S2: f64 = 20.0;
/// A velocity below which a stop is over, rad/s. Chosen by hand: far below what is measured.
const STANDS_RAD_S: f64 = 1e-6;

/// What the safety system does not let pass, by the number under which the maker's documentation has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Violation {
    pub(super) code: i32,
    pub(super) argument: i32,
    pub(super) text: &'static str,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "C{}A{}: {}", self.code, self.argument, self.text)
    }
}

const TOO_FAST: Violation = Violation { code: 153, argument: 0, text: "a joint's speed is beyond its limit" };
const SUDDEN: Violation =
    Violation { code: 204, argument: 3, text: "path sanity check failed, sudden change in target position" };

/// An instruction that moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Motion {
    Hold,
    Servo { q: Joints, lookahead_s: f64, gain: f64 },
    Speed { qd: Joints, acceleration: f64 },
    Stop { deceleration: f64 },
    Push(Torque),
}

/// The reference of the joints.
#[derive(Debug, Clone)]
pub(super) struct Reference {
    pub(super) q: Joints,
    pub(super) qd: Joints,
    smoothed: Joints,
    motion: Motion,
}

impl Reference {
    pub(super) fn at(q: Joints) -> Self {
        Self { q, qd: [0.0; JOINTS], smoothed: q, motion: Motion::Hold }
    }

    /// Begins an instruction.
    pub(super) fn obey(&mut self, motion: Motion) {
        if !matches!((self.motion, motion), (Motion::Servo { .. }, Motion::Servo { .. })) {
            self.smoothed = self.q;
        }
        self.motion = motion;
    }

    pub(super) fn safety_stop(&mut self) {
        self.obey(Motion::Stop { deceleration: SAFETY_STOP_RAD_S2 });
    }

    pub(super) fn stands(&self) -> bool {
        self.qd.iter().all(|v| v.abs() < STANDS_RAD_S)
    }

    /// The torques, where these are commanded.
    pub(super) fn torque(&self) -> Option<Torque> {
        if let Motion::Push(torque) = self.motion { Some(torque) } else { None }
    }

    /// One cycle under torques, after which the joints are there.
    pub(super) fn follow(&mut self, q: &Joints, qd: &Joints) -> Result<(), Violation> {
        (self.q, self.qd, self.smoothed) = (*q, *qd, *q);
        self.watch_speed()
    }

    fn watch_speed(&self) -> Result<(), Violation> {
        let is_fast = self.qd.iter().any(|v| !(v.abs() <= FASTEST_RAD_S));
        if is_fast { Err(TOO_FAST) } else { Ok(()) }
    }

    /// One cycle; what the safety system does not let pass.
    pub(super) fn step(&mut self, dt_s: f64) -> Result<(), Violation> {
        let before = self.qd;
        match self.motion {
            Motion::Hold | Motion::Push(_) => self.qd = [0.0; JOINTS],
            Motion::Servo { q, lookahead_s, gain } => {
                let (smooth, follow) = (share(dt_s / lookahead_s), share(dt_s * gain * RATE_OF_GAIN));
                let joints = self.smoothed.iter_mut().zip(&mut self.qd).zip(q.iter().zip(&self.q));
                for ((smoothed, qd), (goal, q)) in joints {
                    *smoothed += smooth * (goal - *smoothed);
                    *qd = follow * (*smoothed - q) / dt_s;
                }
            }
            Motion::Speed { qd, acceleration } => self.approach(&qd, acceleration * dt_s),
            Motion::Stop { deceleration } => self.approach(&[0.0; JOINTS], deceleration * dt_s),
        }
        for (q, qd) in self.q.iter_mut().zip(&self.qd) {
            *q += qd * dt_s;
        }
        let braking = matches!(self.motion, Motion::Stop { .. } | Motion::Hold);
        self.watch_speed()?;
        let jump = before.iter().zip(&self.qd).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if !braking && jump > SUDDEN_RAD_S2 * dt_s {
            return Err(SUDDEN);
        }
        Ok(())
    }

    /// Velocities go towards `to` by at most `most` each, all arriving together.
    fn approach(&mut self, to: &Joints, most: f64) {
        let furthest = to.iter().zip(&self.qd).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let part = if furthest > most { most / furthest } else { 1.0 };
        for (v, to) in self.qd.iter_mut().zip(to) {
            *v += part * (to - *v);
        }
    }
}

/// What a first-order lag makes of a step within this share of its time constant.
fn share(x: f64) -> f64 {
    1.0 - (-x).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Behind a ramp, `servoj` stays by its stated lag: derived as the area between a ramp and its answer.
    #[test]
    fn servoj_lags_by_what_is_stated() {
        for (lookahead_s, gain, lag_s) in [(0.03, 2000.0, 0.034), (0.1, 300.0, 0.1 + 8.0 / 300.0)] {
            let mut reference = Reference::at([0.0; JOINTS]);
            let (dt_s, speed) = (2e-3, 0.5);
            let mut target = 0.0;
            for _ in 0..2000 {
                target += speed * dt_s;
                reference.obey(Motion::Servo { q: [target; JOINTS], lookahead_s, gain });
                reference.step(dt_s).unwrap();
            }
            let lag = (target - reference.q[0]) / speed;
            // A cycle's length is what discrete lags may differ by.
            assert!((lag - lag_s).abs() < dt_s, "{lag} s instead of {lag_s}");
        }
    }

    #[test]
    fn speedj_and_stopj_keep_their_acceleration() {
        let mut reference = Reference::at([1.0; JOINTS]);
        let qd = [0.6, -0.3, 0.1, 0.0, 0.0, 0.0];
        reference.obey(Motion::Speed { qd, acceleration: 2.0 });
        for k in 1..=150 {
            reference.step(2e-3).unwrap();
            assert!((reference.qd[0] - 0.004 * f64::from(k)).abs() < 1e-9);
            assert!((reference.qd[1] * 2.0 + reference.qd[0]).abs() < 1e-9);
        }
        assert_eq!(reference.qd, qd);
        reference.obey(Motion::Stop { deceleration: 4.0 });
        for _ in 0..75 {
            reference.step(2e-3).unwrap();
        }
        assert!(reference.stands());
    }

    #[test]
    fn a_jump_is_a_sudden_change() {
        let mut reference = Reference::at([0.0; JOINTS]);
        reference.obey(Motion::Servo { q: [0.2; JOINTS], lookahead_s: 0.03, gain: 2000.0 });
        assert!(reference.step(2e-3).unwrap_err().text.contains("sudden"));
        reference.obey(Motion::Speed { qd: [4.0; JOINTS], acceleration: 40.0 });
        let mut told = Ok(());
        for _ in 0..200 {
            told = told.and(reference.step(2e-3));
        }
        assert!(told.unwrap_err().text.contains("speed"));
    }
}
