//! A joint that was on its way and stands, while its reference goes on: something holds it.
//!
//! Torques tell this late, because a controller that finds a joint too slow takes it for friction at first; a drive's lag tells it as late as a load would. That the joint
//! stands is plain: friction and loads slow a joint down, and what stops it in motion is a brake, a jam, or something in its way. A joint that sticks as it begins to move, or
//! as it turns back, stands too, and is none of this: only one is told that moved the way that its reference went on. Nor is one that swings, which turns ahead of its reference
//! and waits for it there: one that is held is behind.

use crate::time::TICK;
use nalgebra::SVector;

/// A joint that stays within this stands, rad or m, beside the steps of its encoder. Chosen by hand: what a gear of 30 kN m/rad yields under 15 N m.
const STANDS: f64 = 5e-4;
/// Steps of the encoder within which a joint stands. Derived: a flicker by one to each side, and noise of a step beside it.
const STEPS: f64 = 4.0;
/// Slower than this neither joint nor reference is on its way, rad/s or m/s. Chosen by hand: the speed from which on a joint has to follow its reference (`arm.rs`).
const ON_ITS_WAY: f64 = 0.05;
/// How far the reference goes on until the joint counts as held, rad or m. Chosen by hand: as far as a lag is a load's (`motion/drive_lag.rs`), and three times as far as the reference is
/// ahead of a joint that starts behind a drive of 34 ms, with 10 rad/s^2.
const HELD: f64 = 0.02;
/// Ticks for which it must stand at least. Chosen by hand: a joint that swings with 10 Hz and more stands for less where it turns. Without it the wrist of an xArm7
/// that swings because its commands come 5 ms late was told as held after 10 ms.
const LEAST_TICKS: u32 = 30;

/// Watches `N` joints.
#[derive(Debug, Clone)]
pub(super) struct StoppedJointWatch<const N: usize> {
    joints: [Option<StandingJoint>; N],
}

/// One joint, since it was last seen to move.
#[derive(Debug, Clone, Copy)]
struct StandingJoint {
    /// Where that was, rad or m.
    at: f64,
    /// Ticks since then.
    ticks: u32,
    /// Which way it moved: 1, -1; 0 when it was not on its way, or its reference did not go on.
    way: f64,
    /// How far the reference went on since, rad or m.
    gone: f64,
    /// How far it is ahead of the joint, rad or m.
    ahead: f64,
}

impl StandingJoint {
    fn at(q: f64, way: f64) -> Self {
        Self { at: q, ticks: 0, way, gone: 0.0, ahead: 0.0 }
    }
}

impl<const N: usize> Default for StoppedJointWatch<N> {
    fn default() -> Self {
        Self { joints: [None; N] }
    }
}

impl<const N: usize> StoppedJointWatch<N> {
    /// Takes in positions of a tick, rad or m, with encoders of these steps, and the reference in it, rad or m and rad/s or m/s; of a drive that obeys velocities the
    /// positions are `None`, because they are taken from the arm again and again.
    pub(super) fn note(
        &mut self,
        q: &SVector<f64, N>,
        step: &SVector<f64, N>,
        (q_r, qd_r): (Option<&SVector<f64, N>>, &SVector<f64, N>),
    ) {
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let joint = joint.get_or_insert(StandingJoint::at(q[i], 0.0));
            joint.ticks = joint.ticks.saturating_add(1);
            let moved = q[i] - joint.at;
            if moved.abs() > STANDS.max(STEPS * step[i]) {
                let is_on_its_way = moved.abs() > ON_ITS_WAY * TICK.as_s() * f64::from(joint.ticks);
                let way = if is_on_its_way { moved.signum() } else { 0.0 };
                *joint = StandingJoint::at(q[i], way);
            }
            if qd_r[i] * joint.way < ON_ITS_WAY {
                (joint.way, joint.gone) = (0.0, 0.0);
            }
            joint.gone += qd_r[i] * joint.way * TICK.as_s();
            joint.ahead = q_r.map_or(joint.gone, |q_r| (q_r[i] - joint.at) * joint.way);
        }
    }

    /// The joint that is held, from 0.
    pub(super) fn held(&self) -> Option<usize> {
        let is_held =
            |joint: &StandingJoint| joint.ticks >= LEAST_TICKS && joint.gone.min(joint.ahead) > HELD;
        self.joints.iter().position(|joint| joint.as_ref().is_some_and(is_held))
    }

    /// Nothing is known of what was before.
    pub(super) fn restart(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector1;

    /// Follows `reference` (rad by ms) `delay` ticks late until `stop`; when the joint counts as held.
    fn held(reference: impl Fn(f64) -> f64, delay: u32, step: f64, noise: f64, stop: u32) -> Option<u32> {
        let (mut watch, mut random) = (StoppedJointWatch::<1>::default(), Random::new(4));
        (0..6000_u32).find(|&k| {
            let at = |k: u32| reference(f64::from(k));
            let q = at(k.min(stop).saturating_sub(delay)) + noise * random.gaussian();
            let q = if step > 0.0 { (q / step).round() * step } else { q };
            let qd_r = (at(k + 1) - at(k)) * 1e3;
            let reference = (Some(&Vector1::new(at(k + 1))), &Vector1::new(qd_r));
            watch.note(&Vector1::new(q), &Vector1::new(step), reference);
            watch.held().is_some()
        })
    }

    #[test]
    fn a_joint_that_is_stopped_in_motion_is_told() {
        for (speed, within) in [(0.1, 230), (0.3, 80), (1.0, 35), (2.0, 35)] {
            for (delay, step) in [(0, 0.0), (5, 1e-4), (20, 1e-3)] {
                let told = held(|ms| -speed * 1e-3 * ms, delay, step, 0.0, 1000);
                let after = told.unwrap() - 1000;
                assert!(after <= within, "{speed} {delay} {step}: {after}");
            }
        }
    }

    #[test]
    fn joints_that_follow_late_stop_and_go_or_turn_back_are_free() {
        let swings = |ms: f64| 0.2 * (ms * 6e-3).sin();
        // Half a second of motion with 0.4 rad/s and half a second of rest, in turns.
        let stops_and_goes = |ms: f64| {
            let (whole, rest) = ((ms / 1000.0).floor(), ms % 1000.0);
            0.2 * whole + 4e-4 * rest.min(500.0)
        };
        for delay in [0, 8, 34, 100] {
            for (step, noise) in [(0.0, 0.0), (1e-5, 1e-5), (1e-3, 2e-4)] {
                assert_eq!(held(swings, delay, step, noise, u32::MAX), None, "{delay} {step}");
                assert_eq!(held(stops_and_goes, delay, step, noise, u32::MAX), None, "{delay} {step}");
            }
        }
    }

    #[test]
    fn a_joint_that_sticks_before_it_moves_is_free() {
        let mut watch = StoppedJointWatch::<1>::default();
        for k in 0..1000 {
            let reference = (Some(&Vector1::new(0.3 + 4e-4 * f64::from(k))), &Vector1::new(0.4));
            watch.note(&Vector1::new(0.3), &Vector1::new(1e-5), reference);
            assert_eq!(watch.held(), None);
        }
    }

    /// What was asked of a joint whose drive obeys velocities counts while it is asked, and no longer.
    #[test]
    fn before_a_drive_that_obeys_velocities_the_way_alone_counts() {
        for (asked_ticks, told) in [(20, None), (60, Some(Some(0)))] {
            let (mut watch, mut q) = (StoppedJointWatch::<1>::default(), 0.0);
            let mut held = Vec::new();
            for k in 0..200 {
                q += if k < 50 { 1.2e-3 } else { 0.0 };
                let qd_r = Vector1::new(if k < 50 + asked_ticks { 1.2 } else { 0.0 });
                watch.note(&Vector1::new(q), &Vector1::new(1e-5), (None, &qd_r));
                held.push(watch.held());
            }
            assert_eq!(held.iter().find(|held| held.is_some()).copied(), told, "{asked_ticks}");
            assert_eq!(held.last().copied().flatten(), None, "it is asked for nothing any more");
        }
    }

    /// It leaps ahead of its reference by 40 mrad, sticks there until it is nearly reached, and leaps again.
    #[test]
    fn a_joint_that_swings_ahead_of_its_reference_is_free() {
        let (mut watch, mut q) = (StoppedJointWatch::<1>::default(), 0.0);
        for k in 0..3000 {
            let q_r = 5e-4 * f64::from(k);
            q += if q - q_r < 0.01 { 0.03 } else { 0.0 };
            let reference = (Some(&Vector1::new(q_r)), &Vector1::new(0.5));
            watch.note(&Vector1::new(q), &Vector1::new(1e-5), reference);
            assert_eq!(watch.held(), None, "{k}");
        }
    }
}
