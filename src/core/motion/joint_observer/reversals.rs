//! Whether the references of joints jitter, and when they last turned back: Coulomb friction changes its sign then, and a command that is late meets it with the wrong one.
//!
//! Each reversal leaves the disturbance a residual of twice the Coulomb friction for as many ticks as commands are late, and of a light wrist with much friction a twentieth of that friction
//! is already an error of a milliradian. A reference that jitters about a goal, because its view is noisy, turns back again and again, and what is learnt from that makes the joint swing.
//! So does Coulomb friction that the observer believes compensated for the velocity at which an error should decay. It is for joints that stick alone, and, where a reference jitters, a tenth of it for the others (`joint_control/sticking.rs`); there the observer counts
//! on no more. Where no reference jitters it counts on it for all joints, and what a contact leaves is learnt as it always was.

use super::JointObserver;
use crate::time::TICK;

/// Ticks after a reversal in which nothing is learnt of a reference that jitters. Derived: commands are up to 5 ticks late in what arms are tested with, and the tick itself. Measured on 42 runs of xArm7s with 0.1 and 0.3 px of noise in
/// the image, with friction 0.2 to 1.3 times the file's, loads of 2 kg, commands 3 ms late and encoder steps (seeds 301 to 303, 40 s): with 0 ticks 30 reach their goals, with 3 35 and 2 fault, with 6 42, with 10 41.
const LATE_TICKS: u32 = 6;
/// Ticks that lie at least between two reversals of a reference that jitters. Derived: views come at most every 10 ms.
const APART_TICKS: u32 = 8;
/// What a reversal leaves of the number of those before it that comes sooner. Chosen by hand: the reference of an arm that gives way goes with the arm and turns back in each tick; what makes that arm sag is to be
/// learnt, and it is forgotten within 20 ticks that it jittered before. A single one is not to forget all: of 40 runs of xArm7s with 0.05 to 0.3 px of noise (seeds 201 to 205, 40 s) 33 reach their goals then, with this all.
const SOONER: f64 = 0.9;
/// Speed that a reference which jitters has between two reversals, rad/s or m/s. Chosen by hand: noise of 0.01 px in the image, at a focal length of 800 px and a gain of 15 1/s, is ten times that.
const JITTERS: f64 = 2e-5;
/// Time constant in which reversals are forgotten, s.
/// Derived: with the two numbers below a reference begins to jitter that turns back every 1.4 s, and goes on where it does every 2.2 s. One that follows a circle of two seconds jitters too.
const FORGOTTEN_S: f64 = 2.0;
/// The number of reversals from which on a reference jitters. Chosen by hand: of the same 40 runs all reach their goals with 3, too, where reversals are forgotten in half of the time.
const BEGINS: f64 = 2.0;
/// The number down to which it goes on to jitter. Chosen by hand: three seconds after the last of two reversals.
const ENDS: f64 = 0.5;

/// One joint's reference.
#[derive(Debug, Clone, Copy, Default)]
struct JointReversals {
    /// The sign of its velocity, the greatest speed since it changed, rad/s or m/s, and the ticks since then.
    sign: f64,
    most: f64,
    ticks: u32,
    /// How many reversals there were lately.
    count: f64,
    jitters: bool,
}

/// The velocities that are requested of each joint.
#[derive(Debug, Clone)]
pub(super) struct Reversals<const N: usize>([JointReversals; N]);

impl<const N: usize> Default for Reversals<N> {
    fn default() -> Self {
        Self([JointReversals { ticks: LATE_TICKS, ..JointReversals::default() }; N])
    }
}

impl<const N: usize> Reversals<N> {
    /// Takes in the velocity that was requested of joint `i`, counted from 0, rad/s or m/s; whether its reference jitters and has just turned back.
    pub(super) fn note(&mut self, i: usize, velocity: f64) -> bool {
        let joint = &mut self.0[i];
        joint.count *= 1.0 - TICK.as_s() / FORGOTTEN_S;
        joint.ticks = joint.ticks.saturating_add(1);
        joint.most = joint.most.max(velocity.abs());
        if velocity * joint.sign < 0.0 {
            joint.count = match joint.ticks {
                ..APART_TICKS => SOONER * joint.count,
                _ if joint.most < JITTERS => joint.count,
                _ => joint.count + 1.0,
            };
            (joint.ticks, joint.most) = (0, velocity.abs());
        }
        if velocity != 0.0 {
            joint.sign = velocity.signum();
        }
        joint.jitters = joint.count >= if joint.jitters { ENDS } else { BEGINS };
        joint.jitters && joint.ticks < LATE_TICKS
    }
}

impl<const N: usize> JointObserver<N> {
    /// The joints whose references jitter.
    pub(in crate::motion) fn jitters(&self) -> [bool; N] {
        std::array::from_fn(|i| self.reversals.0[i].jitters)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of ticks in which a reference of this speed, rad/s, turns back after so many: how many it jitters in, and how many are recent.
    fn watched(speed: f64, period: u32, ticks: u32) -> (u32, u32) {
        let mut reversals = Reversals::<1>::default();
        let (mut jitters, mut recent) = (0, 0);
        for k in 0..ticks {
            recent +=
                u32::from(reversals.note(0, if (k / period).is_multiple_of(2) { speed } else { -speed }));
            jitters += u32::from(reversals.0[0].jitters);
        }
        (jitters, recent)
    }

    #[test]
    fn only_what_turns_back_again_and_again_jitters() {
        assert_eq!(watched(0.1, 2500, 20_000), (0, 0), "it turns back every 2.5 s");
        assert_eq!(watched(1e-6, 40, 2000), (0, 0), "it stands");
        assert_eq!(watched(0.1, 1, 2000), (0, 0), "it turns back in each tick");
        let (jitters, recent) = watched(1e-3, 80, 4000);
        assert!((3700..3800).contains(&jitters), "{jitters} of 4000 ticks: all from the third reversal on");
        assert!(recent.abs_diff(jitters * LATE_TICKS / 80) <= LATE_TICKS, "{recent} of {jitters}");
    }

    #[test]
    fn what_jittered_is_forgotten_when_it_moves_on_or_gives_way() {
        let mut jittered = Reversals::<1>::default();
        (0..2000_u32)
            .for_each(|k| _ = jittered.note(0, if (k / 40).is_multiple_of(2) { 1e-3 } else { -1e-3 }));
        assert!(jittered.0[0].jitters);
        let left = |velocity: fn(u32) -> f64| {
            let mut reversals = jittered.clone();
            let goes_on = |k: &u32| {
                reversals.note(0, velocity(*k));
                reversals.0[0].jitters
            };
            (0..20_000).take_while(goes_on).count()
        };
        let moves = left(|_| 1e-3);
        assert!((8000..10_000).contains(&moves), "of 33 reversals within the time constant: {moves} ms");
        let gives_way = left(|k| if u32::is_multiple_of(k, 2) { 1e-3 } else { -1e-3 });
        assert!(gives_way < 60, "{gives_way} ms");
    }
}
