//! Friction that the robot file does not tell: which joints resist their first motion, and the friction that is then looked for.
//!
//! A file without Coulomb friction is taken at its word until a joint stays where it is while its reference moves on. Then each such joint gets a
//! nominal friction, of which nothing is compensated before it is [probed](super::confirmed_friction).

use crate::robot::{Friction, Robot};
use crate::time::TICK;
use nalgebra::SVector;

/// Nominal Coulomb friction of a joint whose file tells none, as a share of its effort limit: twice of it are found, so up to 12 % of the effort,
/// more than the 10 % with which arms are tested (`tests/cores/untold_friction.rs`).
const NOMINAL: f64 = 0.06;
/// Way of a reference from rest after which its joint is judged, rad or m. Chosen by hand: it is reached after 23 ms
/// at the default limit of jerk, when a joint whose commands are 5 ms late has gone 0.48 of it.
const WAY: f64 = 1e-3;
/// Encoder steps that count beside it. Chosen by hand: two readings are off by a step each, and noise comes beside that.
const STEPS: f64 = 4.0;
/// Share of that way below which a joint resists. Chosen by hand: half of what late commands leave.
const FOLLOWS: f64 = 0.25;

/// Watches first motions.
#[derive(Debug, Clone)]
pub(super) struct UntoldFriction<const N: usize> {
    /// Way of each reference since the arm stood, and where the joint was then; rad or m.
    way: SVector<f64, N>,
    from: SVector<f64, N>,
    is_judged: [bool; N],
    /// Whether a joint was found to resist.
    resists: bool,
    /// Whether the reference is still to be set to the arm, before joints are probed.
    is_new: bool,
}

impl<const N: usize> Default for UntoldFriction<N> {
    fn default() -> Self {
        Self {
            way: SVector::zeros(),
            from: SVector::zeros(),
            is_judged: [false; N],
            resists: false,
            is_new: false,
        }
    }
}

impl<const N: usize> UntoldFriction<N> {
    /// The joints of `robot` whose Coulomb friction is not told.
    pub(super) fn joints(robot: &Robot<N>) -> [bool; N] {
        std::array::from_fn(|i| robot.friction()[i].coulomb == 0.0)
    }

    /// The friction of joint `i`, counted from 0: that of the file, and where joints resist without any the nominal one.
    pub(super) fn friction(&self, robot: &Robot<N>, i: usize) -> Friction {
        let told = robot.friction()[i];
        let is_nominal = self.resists && told.coulomb == 0.0;
        if is_nominal { Friction { coulomb: NOMINAL * robot.limits()[i].effort, ..told } } else { told }
    }

    /// Takes in the velocities of the reference (rad/s or m/s) and the positions of the joints (rad or m); whether a joint has just been found
    /// to resist. `steps` are those of the encoders.
    pub(super) fn note(
        &mut self,
        robot: &Robot<N>,
        velocity: &SVector<f64, N>,
        q: &SVector<f64, N>,
        steps: &SVector<f64, N>,
    ) -> bool {
        if self.resists {
            return false;
        }
        if velocity.iter().all(|v| *v == 0.0) {
            *self = Self { from: *q, ..Self::default() };
            return false;
        }
        self.way += velocity * TICK.as_s();
        for (i, friction) in robot.friction().iter().enumerate() {
            let way = self.way[i].abs();
            if friction.coulomb > 0.0 || self.is_judged[i] || !(way > WAY + STEPS * steps[i]) {
                continue;
            }
            self.is_judged[i] = true;
            let moved = (q[i] - self.from[i]) * self.way[i].signum();
            self.resists |= moved < FOLLOWS * way;
        }
        self.is_new = self.resists;
        self.resists
    }

    /// Whether joints have begun to be probed anew: true once.
    pub(super) fn take_new(&mut self) -> bool {
        std::mem::take(&mut self.is_new)
    }
}
