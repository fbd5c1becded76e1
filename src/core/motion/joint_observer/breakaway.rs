//! How much of its Coulomb friction a joint that sticks gets towards its reference.
//!
//! Friction is compensated by the velocity of the reference, and that is next to none near a goal: what frees the joint is stiffness against its error alone. A UR5 whose joints stick came loose when
//! they were 0.2 to 0.5 mrad off, on either side, and each correction of the camera waited for seconds until the reference had gone through all of that. So a joint that was found to stick gets a share `c` of its
//! Coulomb friction by the sign of its error as well, which frees it at a fraction of that, and brakes it as soon as it has slipped through its reference.
//!
//! Where friction is less than is believed, or commands are late, such a joint goes to and fro about its reference. Each time that it has gone through, `c` falls; while it stands off, `c` grows again.

use crate::time::TICK;
use nalgebra::SVector;

/// What is left of the share each time that a joint has gone through its reference. Measured (`tests/cores/everything_at_once.rs`, 320 draws under torque, 218 of which came home without any share): 250 with 0.8, 244 with 0.7. With the same
/// share for ever they are 224, 236 and 226, for a half, 0.7 and all of it.
const FALLS: f64 = 0.8;
/// How much the share grows in a second in which the joint stands off. Measured on the same draws: 234 come home with a share that begins with 0.7 and only falls, 250 with one that begins with all of it and grows so.
const GROWS_1_S: f64 = 0.2;
/// Largest share. Measured on the same draws: with 1.4, and growing by 0.5 in a second, 246.
const MOST: f64 = 1.0;
/// A joint is off whose error is to decay with more than this, rad/s or m/s. Derived: where smooth friction models have changed their sign.
const OFF: f64 = 1e-3;
/// Ticks for which a reading has stayed the same from which on a joint stands. Chosen by hand, and not varied: a joint that creeps through fine steps does not.
const STANDS_TICKS: u32 = 20;

/// The share of each joint.
#[derive(Debug, Clone)]
pub(super) struct Breakaway<const N: usize> {
    share: SVector<f64, N>,
    sides: [OffSide; N],
}

/// On which side of its reference a joint was last off.
#[derive(Debug, Clone, Copy, Default)]
struct OffSide {
    /// Sign of the way to the reference; 0 before the first.
    sign: f64,
    /// Its reading when it came there, rad or m.
    reading: f64,
}

impl<const N: usize> Default for Breakaway<N> {
    fn default() -> Self {
        Self { share: SVector::repeat(MOST), sides: [OffSide::default(); N] }
    }
}

impl<const N: usize> Breakaway<N> {
    /// The share of joint `i`, counted from 0.
    pub(super) fn share(&self, i: usize) -> f64 {
        self.share[i]
    }

    /// Takes in the `reading` of joint `i`, rad or m, which has stayed the same for `same_ticks`, and the velocity with which its error is to decay, rad/s or m/s.
    pub(super) fn note(&mut self, i: usize, reading: f64, same_ticks: u32, slip: f64) {
        if !(slip.abs() > OFF) {
            return;
        }
        let OffSide { sign, reading: from } = self.sides[i];
        if slip * sign <= 0.0 {
            // The joint has gone through its reference, not the reference through it.
            if (reading - from) * sign > 0.0 {
                self.share[i] *= FALLS;
            }
            self.sides[i] = OffSide { sign: slip.signum(), reading };
        }
        if same_ticks > STANDS_TICKS {
            self.share[i] = (self.share[i] + GROWS_1_S * TICK.as_s()).min(MOST);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The share after a joint has been at each of `places` (reading and slip) for `ticks`.
    fn share_after(places: &[(f64, f64)], ticks: u32) -> f64 {
        let mut breakaway = Breakaway::<1>::default();
        for (reading, slip) in places {
            (0..ticks).for_each(|same| breakaway.note(0, *reading, same, *slip));
        }
        breakaway.share(0)
    }

    #[test]
    fn what_goes_through_its_reference_gets_less_each_time() {
        let swings = [(0.0, 4e-3), (2e-4, -4e-3), (0.0, 4e-3), (2e-4, -4e-3)];
        assert!((share_after(&swings, 10) - FALLS.powi(3)).abs() < 1e-12);
        let short_of_it = swings.map(|(reading, slip)| (reading, 0.2 * slip));
        assert_eq!(share_after(&short_of_it, 10), MOST, "about where friction changes its sign");
    }

    #[test]
    fn a_reference_that_goes_through_a_joint_takes_nothing() {
        let stands = [(0.0, 4e-3), (0.0, -4e-3), (0.0, 4e-3)];
        assert_eq!(share_after(&stands, 10), MOST);
        let is_left_behind = [(0.0, 4e-3), (-2e-4, -4e-3), (0.0, 4e-3)];
        assert_eq!(share_after(&is_left_behind, 10), MOST);
    }

    #[test]
    fn what_stands_off_gets_more_and_what_is_there_keeps_it() {
        let swings = [(0.0, 4e-3), (2e-4, -4e-3)];
        let (long, before) = (share_after(&[swings[0], swings[1], swings[1]], 520), FALLS);
        assert!((long - before - GROWS_1_S * 1.0).abs() < 0.01, "{long}");
        let there = share_after(&[swings[0], swings[1], (2e-4, 0.0), (2e-4, 0.0)], 20);
        assert_eq!(there, FALLS);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn shares_stay_within_all_and_none(
            places in prop::collection::vec((-1e-3..1e-3_f64, prop_oneof![-0.1..0.1_f64, Just(f64::NAN)]), 1..40),
            ticks in 1..60_u32,
        ) {
            let share = share_after(&places, ticks);
            prop_assert!(share > 0.0 && share <= MOST, "{share}");
        }
    }
}
