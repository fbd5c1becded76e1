//! Bounds the torque on a joint that does not move.
//!
//! The error of a joint that is blocked (a jam, an engaged brake, an obstacle) grows with every tick, and a stiff feedback, or the
//! disturbance estimate, would push it with the whole effort of the drive. The torque that the model predicts is not bounded: gravity,
//! friction, and the acceleration of the reference as long as the reference is not far ahead. The remaining torque `x` is bounded to a
//! neighbourhood of `x_0`, its value when the joint last moved:
//!
//! ```text
//! |x - x_0| <= share * effort + F_c       as long as |q - q_0| <= band
//! ```
//! Torque that brakes a joint that is to rest is let through in proportion to its speed: a joint that swings by a few `band` is not blocked, and without its damping
//! it swings for ever (a stiff SCARA after a run with too high a gain: 3 mrad at 14 Hz with its full effort). On the way the bound stays: where rotors and a payload are not known
//! yet, brakes with all of the effort are taken for a contact (of 100 runs 96 came home without them, 95 with brakes after a rest of 0.2 s, 92 with brakes at any rest, 89 with brakes on the way too).
//!
//! An arm with a load that is not in its model first gives way: the joint then has moved, and `x_0` follows.

use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::SVector;

/// Share of the effort limit. An arm that carries its rated load unknown to its model needs more than that, and gets it as it gives way; to
/// begin to move it needs the torque for its acceleration alone. A UR10 pushes by 50 N m instead of 330 against a held shoulder.
const SHARE: f64 = 0.15;
/// Displacement up to which a joint counts as blocked, rad or m. Chosen by hand, about ten times what a resting arm moves by itself.
const BAND: f64 = 1e-3;
/// Encoder steps that do not count as motion: a reading that alternates between two neighbouring steps, with one to spare.
const STEPS: f64 = 2.0;
/// Time constant of the mean `x_0`, s. Chosen by hand: long against the tick of 1 ms, so that the torque peak of a joint that is stopped
/// within a tick hardly enters it, and short against the 0.1 s in which a load that sinks moves the joint by 2 mrad (tested).
const MEAN_S: f64 = 0.02;
/// Speed from which on a joint may be braked with all of its effort, rad/s or m/s: less than that of a joint that goes through `BAND` within `MEAN_S` by five times, and
/// of coarse encoders a step in [`STEP_S`]. Measured over 800 runs with gains up to 60 1/s, late images, and rotors and payloads that no file tells: with a braking torque of 15 % of
/// the effort at 0.02 rad/s, beside the bound about `x_0`, three SCARAs with heavy rotors still swung for ever; with this none of 400.
const BRAKED: f64 = 0.01;
/// How far a reference may go while its joint is to rest, rad or m. Chosen by hand, three times [`BAND`]: one that follows the view of a joint that swings by that swings with it.
const RESTS: f64 = 3e-3;
/// Time for which it must have rested before, s. Chosen by hand: where rotors or a payload are found, references rest for moments.
const RESTED_S: f64 = 0.2;
/// Time between two encoder steps below which a joint moves, s. Chosen by hand: ten ticks, in which the noise of a step is no more than one.
const STEP_S: f64 = 0.01;
/// The acceleration of the reference is fed forward until the reference is so many times [`BAND`] ahead of a joint that has not moved.
/// Chosen by hand: an arm that follows begins to move when its reference is less than one `BAND` ahead.
const AHEAD: f64 = 3.0;

/// Where each joint last moved, and the torque that was requested there.
#[derive(Debug, Clone)]
pub(super) struct StallGuard<const N: usize> {
    last: Option<[Moved; N]>,
    /// For how long each reference has rested, s, and how far it has gone meanwhile, rad or m.
    rested: [(f64, f64); N],
}

/// A joint where it last moved.
#[derive(Debug, Clone, Copy)]
struct Moved {
    q: f64,
    /// Torque beyond the expected one about there, N m or N.
    beyond: f64,
    /// Time since, s.
    since_s: f64,
    /// How far the reference has gone since, rad or m.
    ahead: f64,
}

impl<const N: usize> Default for StallGuard<N> {
    fn default() -> Self {
        Self { last: None, rested: [(0.0, 0.0); N] }
    }
}

impl<const N: usize> StallGuard<N> {
    /// The part of the reference's accelerations that the joints are expected to make.
    pub(super) fn expected(&self, u: &SVector<f64, N>) -> SVector<f64, N> {
        self.last.as_ref().map_or(*u, |last| {
            SVector::from_fn(|i, _| if last[i].ahead.abs() > AHEAD * BAND { 0.0 } else { u[i] })
        })
    }

    /// Bounds `beyond`, the torque beyond the one that the model predicts, of joints at `q` with the velocities `qd` that are to move with `velocity`. Returns
    /// the bounded torque and, as a mask, the joints where it is less. `steps` are those of the encoders.
    pub(super) fn bound(
        &mut self,
        robot: &Robot<N>,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        velocity: &SVector<f64, N>,
        steps: &SVector<f64, N>,
        beyond: &SVector<f64, N>,
    ) -> (SVector<f64, N>, u8) {
        let begin =
            || std::array::from_fn(|i| Moved { q: q[i], beyond: beyond[i], since_s: 0.0, ahead: 0.0 });
        let (mut bounded, mut stalled) = (*beyond, 0);
        for ((rested_s, way), velocity) in self.rested.iter_mut().zip(velocity) {
            let gone = *way + velocity * TICK.as_s();
            (*rested_s, *way) = if gone.abs() < RESTS { (*rested_s + TICK.as_s(), gone) } else { (0.0, 0.0) };
        }
        let joints = self.last.get_or_insert_with(begin).iter_mut().zip(robot.limits()).zip(robot.friction());
        for (i, ((last, limit), friction)) in joints.enumerate() {
            if (q[i] - last.q).abs() > BAND.max(STEPS * steps[i]) {
                let share = 1.0 - (-(last.since_s + TICK.as_s()) / MEAN_S).exp();
                let beyond = last.beyond + (beyond[i] - last.beyond) * share;
                *last = Moved { q: q[i], beyond, since_s: 0.0, ahead: 0.0 };
                continue;
            }
            last.since_s += TICK.as_s();
            last.ahead += velocity[i] * TICK.as_s();
            let reach = SHARE * limit.effort + friction.coulomb;
            let (mut least, mut most) = (last.beyond - reach, last.beyond + reach);
            let speed = (qd[i] / BRAKED.max(steps[i] / STEP_S)).clamp(-1.0, 1.0);
            let moves = if self.rested[i].0 >= RESTED_S { speed } else { 0.0 };
            if moves > 0.0 {
                least += moves * (-limit.effort - least).min(0.0);
            } else {
                most -= moves * (limit.effort - most).max(0.0);
            }
            // Not `clamp`, which panics where a torque of an arm that has gone wild is no number.
            bounded[i] = beyond[i].max(least).min(most);
            if bounded[i] != beyond[i] {
                stalled |= 1 << i;
            }
        }
        (bounded, stalled)
    }

    /// Forgets all joints, because control takes the arm over again.
    pub(super) fn forget(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    fn robot() -> Robot<6> {
        crate::robot::load("ur5").unwrap().build().unwrap()
    }

    /// Pushes joint 1 for `ticks` by what `ask` tells, while it stands where `place` tells; what is left of it, and the mask.
    fn push(
        guard: &mut StallGuard<6>,
        ticks: usize,
        ask: impl Fn(usize) -> f64,
        place: impl Fn(usize) -> f64,
    ) -> (f64, u8) {
        let robot = robot();
        let joint_1 = |value| Vector6::new(0.0, value, 0.0, 0.0, 0.0, 0.0);
        let mut last = (0.0, 0);
        for tick in 0..ticks {
            let (beyond, mask) = guard.bound(
                &robot,
                (&joint_1(place(tick)), &Vector6::zeros()),
                &joint_1(0.1),
                &Vector6::zeros(),
                &joint_1(ask(tick)),
            );
            last = (beyond[1], mask);
        }
        last
    }

    #[test]
    fn what_does_not_move_is_pushed_gently_whatever_is_asked_for() {
        let robot = robot();
        let reach = SHARE * robot.limits()[1].effort + robot.friction()[1].coulomb;
        let (beyond, mask) = push(&mut StallGuard::default(), 1000, |tick| 10.0 * tick as f64, |_| 0.0);
        assert_eq!((beyond, mask), (reach, 0b10));
        // A joint that is stopped in full motion: the torque of the shock is not what it may be pushed with from then on.
        let mut guard = StallGuard::default();
        push(&mut guard, 200, |_| 0.0, |tick| 2e-3 * tick as f64);
        let (beyond, _) = push(&mut guard, 1, |_| 900.0, |_| 0.4 + 2e-3);
        assert_eq!(beyond, 900.0, "it moves");
        let (beyond, mask) = push(&mut guard, 1000, |_| 900.0, |_| 0.4 + 2e-3);
        assert!(beyond < reach + 0.1 * 900.0 && mask == 0b10, "{beyond} of {reach}");
    }

    #[test]
    fn what_moves_or_gives_way_gets_all_that_is_asked_for() {
        let (beyond, mask) = push(&mut StallGuard::default(), 300, |_| 900.0, |tick| 2e-3 * tick as f64);
        assert_eq!((beyond, mask), (900.0, 0));
        // A load that sinks by 2 mrad in 0.1 s, time and again, while all is asked for to hold it.
        let mut guard = StallGuard::default();
        let (beyond, _) = push(&mut guard, 2000, |_| -200.0, |tick| 2e-5 * tick as f64);
        assert!((beyond + 200.0).abs() < 1.0, "{beyond}");
    }

    #[test]
    fn a_joint_that_moves_is_braked_and_not_pushed() {
        let robot = robot();
        let reach = SHARE * robot.limits()[1].effort + robot.friction()[1].coulomb;
        let joint_1 = |value| Vector6::new(0.0, value, 0.0, 0.0, 0.0, 0.0);
        let at = |guard: &mut StallGuard<6>, qd, ask| {
            let place = (&Vector6::zeros(), &joint_1(qd));
            guard.bound(&robot, place, &Vector6::zeros(), &Vector6::zeros(), &joint_1(ask)).0[1]
        };
        let mut guard = StallGuard::default();
        at(&mut guard, 0.0, 0.0);
        assert_eq!(at(&mut guard, 7.0 * BRAKED, -900.0), -reach, "its reference moved a moment ago");
        (0..201).for_each(|_| _ = at(&mut guard, 0.0, 0.0));
        let effort = robot.limits()[1].effort;
        for (speed, braked) in [(0.5, reach + 0.5 * (effort - reach)), (1.0, effort), (7.0, effort)] {
            let qd = speed * BRAKED;
            assert_eq!((at(&mut guard, qd, 900.0), at(&mut guard, -qd, -900.0)), (reach, -reach));
            assert_eq!((at(&mut guard, qd, -900.0), at(&mut guard, -qd, 900.0)), (-braked, braked));
        }
    }

    #[test]
    fn an_acceleration_that_has_no_effect_stops_being_expected() {
        let u = Vector6::repeat(5.0);
        let mut guard = StallGuard::default();
        assert_eq!(guard.expected(&u), u);
        push(&mut guard, 20, |_| 0.0, |_| 0.0);
        assert_eq!(guard.expected(&u), u, "2 mrad ahead");
        push(&mut guard, 20, |_| 0.0, |_| 0.0);
        assert_eq!(guard.expected(&u), Vector6::new(5.0, 0.0, 5.0, 5.0, 5.0, 5.0), "4 mrad ahead");
        push(&mut guard, 1, |_| 0.0, |_| 2e-3);
        assert_eq!(guard.expected(&u), u, "it has moved");
        guard.forget();
        assert_eq!(guard.expected(&u), u);
    }

    /// Torques of an arm that has gone wild are no numbers; the tick goes on all the same, and the gate makes a fault of them.
    #[test]
    fn torques_that_are_no_numbers_do_not_panic() {
        let mut guard = StallGuard::<6>::default();
        for ask in [0.0, f64::NAN, f64::INFINITY, 1.0, f64::NAN] {
            push(&mut guard, 3, |_| ask, |_| 0.0);
        }
        let mut guard = StallGuard::<6>::default();
        push(&mut guard, 3, |_| f64::NAN, |_| 0.0);
    }
}
