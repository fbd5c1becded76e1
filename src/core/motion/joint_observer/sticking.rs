//! Which joints stick: those that stand although the error is to decay. Smooth friction lets a joint creep under any torque; what sticks does not move at all.
//!
//! An encoder that is frozen for a while looks the same, until its reading leaps to where the joint has gone meanwhile: farther than the torque that acted can move it in a tick. Such a
//! joint did not stick.
//!
//! What a joint that sticks gets beside the law's torque is a stiff spring with late commands, and its inertia may not be known: with a payload off its axis a wrist has 50 times that of its model. Where it makes a joint
//! run ahead of its reference, forth and back, it is halved.

use super::breakaway::Breakaway;
use crate::time::TICK;
use nalgebra::SVector;

/// A joint stands still that is slower than this, rad/s or m/s, for [`STILL_TICKS`], while its error is to decay with at least the speed [`PULLED`]: all three are chosen by hand, and were not varied.
/// Smooth friction lets a joint creep with 1e-6 rad/s and more under any torque.
const STILL: f64 = 1e-9;
const PULLED: f64 = 1e-4;
const STILL_TICKS: u32 = 20;
/// Between two steps of its encoder a joint seems to move as its model does. It stands there whose reading has stayed the same while the error would have decayed by so many
/// steps, and for so many ticks. Measured on 84 draws of `tests/cores/everything_at_once.rs` in which UR5, Panda and xArm7 had hunted: with 1, 2 and 4 steps 29, 29 and 32 of them converge,
/// with 20, 50 and 150 ticks 27, 29 and 23; without this 9. (Before the way was a sum with signs, and with the whole stiffness.)
const SAME_STEPS: f64 = 4.0;
const SAME_TICKS: u32 = 50;
/// The coarsest step behind which that tells of a joint that may have stiffness, rad or m: an arm that swings about its goal by less than a step looks the same. Behind coarser ones it gets its Coulomb friction
/// towards its reference alone, which falls where it swings. Measured (`tests/cores/everything_at_once.rs`, with steps of 2e-4 and 5e-4 rad): of 145 draws 49 come home without that, 73 with it. Measured, too: a UR5 with steps of 3e-4 rad, a load and late commands is calmed and comes home without stiffness, and swings on with it (`tests/cores/arm_unlike_model.rs`); of the campaign's arms with steps above 1e-4 rad as many converge with and without.
const COARSEST_STEP: f64 = 1e-4;
/// Steps of an encoder by which a reading changes as a joint comes loose, beside twice the way that the torque explains: one, a flicker, and one more. Chosen by hand.
const LEAP_STEPS: f64 = 3.0;
/// Share of the stiffness for joints that stick which one has that seems to, by readings that stay the same. Measured on 240 draws of the same campaign: with all of it SCARAs hunt whose smooth friction
/// lets them creep (53 of 60 converge, 57 with a half or a quarter); of the others 115, 117 and 116 of 180 converge with all, a half and a quarter.
const STIFFNESS_OF_SAME: f64 = 0.5;
/// Speed by which a joint that runs ahead of its reference swings, rad/s or m/s. Chosen by hand, and not varied: twice what joints that stick and slip about a goal reach.
const SWINGS: f64 = 0.4;
/// What is left of what it gets, each time that it swings back. Measured (`tests/cores/everything_at_once.rs`, 178 xArm7s under torque, of which 103 came home and 53 ended with a fault without this): 119 and 35.
const CALMS: f64 = 0.5;

/// A tick of a joint.
#[derive(Debug, Clone, Copy)]
pub(super) struct StandingTick {
    /// Its reading, rad or m, and the step of its encoder.
    pub(super) reading: f64,
    pub(super) step: f64,
    /// Its believed speed, and the one with which its error is to decay, rad/s or m/s.
    pub(super) speed: f64,
    pub(super) slip: f64,
    /// How much faster it is than its reference, rad/s or m/s.
    pub(super) lead: f64,
    /// Whether its friction has a Coulomb part.
    pub(super) has_coulomb: bool,
    /// Largest acceleration of a joint that comes loose under the torque that acts, rad/s^2 or m/s^2.
    pub(super) loose: f64,
}

/// Whether each joint has been found to stick.
#[derive(Debug, Clone)]
pub(super) struct Sticking<const N: usize> {
    still_ticks: [u32; N],
    readings: SVector<f64, N>,
    same_ticks: [u32; N],
    /// By how much the error of each should have decayed meanwhile, rad or m.
    ways: SVector<f64, N>,
    /// The share of the stiffness for joints that stick which each has; none where it was not found to stick.
    stiffness: SVector<f64, N>,
    /// The same as it was when its reading changed last.
    before: SVector<f64, N>,
    /// Joints that seem to stick behind coarse steps.
    coarse: [bool; N],
    /// The share of what joints that stick get that is left to each, and the sign of its last swing.
    calm: SVector<f64, N>,
    swung: SVector<f64, N>,
    breakaway: Breakaway<N>,
}

impl<const N: usize> Default for Sticking<N> {
    fn default() -> Self {
        Self {
            still_ticks: [0; N],
            readings: SVector::repeat(f64::NAN),
            same_ticks: [0; N],
            ways: SVector::zeros(),
            stiffness: SVector::zeros(),
            before: SVector::zeros(),
            coarse: [false; N],
            calm: SVector::repeat(1.0),
            swung: SVector::zeros(),
            breakaway: Breakaway::default(),
        }
    }
}

impl<const N: usize> Sticking<N> {
    /// The share of the stiffness for joints that stick which each may have; none for joints that do not.
    pub(super) fn stiffness(&self) -> SVector<f64, N> {
        self.stiffness.component_mul(&self.calm)
    }

    /// The share of the torque against an error's decay that each joint that sticks may have; none for joints that do not.
    pub(super) fn slip_share(&self) -> SVector<f64, N> {
        self.calm.zip_map(&self.stiffness, |calm, stiffness| if stiffness > 0.0 { calm } else { 0.0 })
    }

    /// The share of its Coulomb friction that each joint gets towards its reference; `None` for joints that do not stick.
    pub(super) fn coulomb_share(&self) -> [Option<f64>; N] {
        std::array::from_fn(|i| self.sticks(i).then(|| self.calm[i] * self.breakaway.share(i)))
    }

    fn sticks(&self, i: usize) -> bool {
        self.stiffness[i] > 0.0 || self.coarse[i]
    }

    /// Takes in a tick of joint `i`, counted from 0, which is not `probing`.
    pub(super) fn note(&mut self, i: usize, probing: bool, tick: &StandingTick) {
        let same = if tick.reading == self.readings[i] { self.same_ticks[i].saturating_add(1) } else { 0 };
        if same == 0 {
            let leap = (tick.reading - self.readings[i]).abs();
            if self.same_ticks[i] > 0 && leap > LEAP_STEPS * tick.step + tick.loose * TICK.as_s().powi(2) {
                (self.stiffness[i], self.coarse[i]) = (self.before[i], false);
            }
            self.before[i] = self.stiffness[i];
        }
        (self.readings[i], self.same_ticks[i]) = (tick.reading, same);
        self.ways[i] = if same > 0 { self.ways[i] + TICK.as_s() * tick.slip } else { 0.0 };
        if self.sticks(i) && !probing {
            self.breakaway.note(i, tick.reading, same, tick.slip);
        }
        if self.sticks(i) && tick.lead.abs() > SWINGS {
            let swings_back = tick.lead * self.swung[i] < 0.0;
            self.calm[i] *= if swings_back { CALMS } else { 1.0 };
            self.swung[i] = tick.lead.signum();
        }
        // Of steps that nobody told, and that were not found yet, nothing is known.
        let stays = same > SAME_TICKS && self.ways[i].abs() > SAME_STEPS * tick.step;
        let is_same = stays && tick.step > 0.0 && tick.step <= COARSEST_STEP;
        self.coarse[i] |= stays && tick.step > COARSEST_STEP && tick.has_coulomb && !probing;
        let is_still = tick.speed.abs() < STILL;
        let is_held = tick.has_coulomb && (is_still || is_same) && tick.slip.abs() > PULLED;
        self.still_ticks[i] = if is_held && !probing { self.still_ticks[i] + 1 } else { 0 };
        if self.still_ticks[i] >= STILL_TICKS {
            let share = if is_still { 1.0 } else { STIFFNESS_OF_SAME };
            self.stiffness[i] = self.stiffness[i].max(share);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The stiffness of a joint with an encoder of `step`, of which nobody knows where `is_known` is not set, that creeps with `speed` for two seconds, while its error is to decay with `slip`: none where it is not found to stick.
    fn stiffness(speed: f64, encoder: (f64, bool), slip: f64) -> f64 {
        watched(speed, encoder, slip).stiffness()[0]
    }

    fn watched(speed: f64, (step, is_known): (f64, bool), slip: f64) -> Sticking<1> {
        let mut sticking = Sticking::<1>::default();
        for k in 0..2000 {
            let q = speed * f64::from(k) * TICK.as_s();
            let reading = if step > 0.0 { step * (q / step).round() } else { q };
            // Behind a coarse encoder its model believes that it moves.
            let believed = if step > 0.0 { 1e-4 } else { speed };
            let step = if is_known { step } else { 0.0 };
            sticking.note(
                0,
                false,
                &StandingTick {
                    reading,
                    step,
                    speed: believed,
                    slip,
                    lead: 0.0,
                    has_coulomb: true,
                    loose: 0.0,
                },
            );
        }
        sticking
    }

    #[test]
    fn what_sticks_behind_coarse_encoders_gets_friction_alone() {
        let share = |speed, encoder, slip| watched(speed, encoder, slip).coulomb_share()[0];
        for step in [0.0, 1e-5, 1e-4, 2e-4, 1e-3] {
            assert_eq!(share(0.0, (step, true), 4e-3), Some(1.0), "{step}");
            assert_eq!(share(3e-3, (step, true), 4e-3), None, "{step}: one that moves");
            assert_eq!(share(0.0, (step, true), 5e-5), None, "{step}: one that is to stand");
        }
        assert_eq!(share(0.0, (1e-3, false), 4e-3), None, "an encoder that is taken for exact");
    }

    #[test]
    fn a_joint_that_stands_sticks_behind_coarse_encoders_too() {
        for (step, share) in [(0.0, 1.0), (1e-5, 0.5), (1e-4, 0.5)] {
            assert_eq!(stiffness(0.0, (step, true), 4e-3), share, "{step}");
            assert_eq!(stiffness(3e-3, (step, true), 4e-3), 0.0, "{step}: one that moves");
            assert_eq!(stiffness(0.0, (step, true), 5e-5), 0.0, "{step}: one that is to stand");
        }
        assert_eq!(stiffness(0.0, (2e-4, true), 4e-3), 0.0, "between two steps it may swing");
        assert_eq!(stiffness(0.0, (1e-4, false), 4e-3), 0.0, "an encoder that is taken for exact");
        assert_eq!(stiffness(1e-6, (0.0, true), 4e-3), 0.0, "one that creeps");
    }

    /// What is left to a joint that was found to stick and then runs ahead by `lead`, forth and back, four times.
    fn left_after_swings(lead: f64) -> [f64; 2] {
        let mut sticking = Sticking::<1>::default();
        let mut at = |speed: f64, lead: f64| {
            let tick = StandingTick {
                reading: 1e-3,
                step: 0.0,
                speed,
                slip: 4e-3,
                lead,
                has_coulomb: true,
                loose: 0.0,
            };
            sticking.note(0, false, &tick);
        };
        (0..30).for_each(|_| at(0.0, 0.0));
        for sign in [1.0, -1.0, 1.0, -1.0] {
            (0..10).for_each(|_| at(lead, sign * lead));
        }
        [sticking.stiffness()[0], sticking.slip_share()[0]]
    }

    #[test]
    fn a_joint_that_swings_gets_less_each_time_it_swings_back() {
        assert_eq!(left_after_swings(0.5), [0.125, 0.125]);
        assert_eq!(left_after_swings(0.2), [1.0, 1.0], "one that sticks and slips");
        assert_eq!(Sticking::<1>::default().slip_share()[0], 0.0, "one that was not found to stick");
    }

    /// What was seen to stand for 50 ms and is then found elsewhere had a frozen encoder; what comes loose leaps as far as the torque lets it.
    #[test]
    fn a_frozen_encoder_that_comes_back_makes_no_joint_stick() {
        let loose = 100.0;
        let ends = |leap: f64| {
            let mut sticking = Sticking::<1>::default();
            let mut at = |reading: f64, speed: f64| {
                let tick = StandingTick {
                    reading,
                    step: 0.0,
                    speed,
                    slip: 4e-3,
                    lead: 0.0,
                    has_coulomb: true,
                    loose,
                };
                sticking.note(0, false, &tick);
                sticking.stiffness()[0]
            };
            for k in 0..100 {
                assert_eq!(at(f64::from(k) * 1e-5, 1e-2), 0.0);
            }
            let held = (0..50).map(|_| at(1e-3, 0.0)).last().unwrap();
            (held, at(1e-3 + leap, 1e-2))
        };
        assert_eq!(ends(1e-3), (1.0, 0.0));
        assert_eq!(ends(-1e-3), (1.0, 0.0));
        assert_eq!(ends(0.5e-4), (1.0, 1.0));
    }
}
