//! Supervision of the measured arm: faults of its state, of its speed, and of following its reference.
//!
//! | fault | by |
//! | --- | --- |
//! | the state is not finite | its numbers |
//! | the state is implausible | positions and speeds far outside range and limit; a jump that no speed explains |
//! | positions and velocities contradict each other: one of them is frozen | their displacements over 300 ms of states that are not late |
//! | a joint is too fast | its displacement over some ticks, against its velocity limit |
//! | a joint does not follow | its displacement over some ticks, against that of its reference |
//! | a joint oscillates | the signs of its velocity error ([`super::swing`]) |
//!
//! Speeds are computed from displacements, because quantized or noisy encoders report velocities that the joint does not have.
//!
//! The numbers here were chosen by hand. The tests below bound them from both sides: with motions that must be reported, and within how
//! long, and with motions of healthy arms with coarse, noisy or late encoders, that must not. `tests/cores/hostile.rs` adds
//! the random states of a hostile drive.

use super::Fault;
use super::swing::SwingWatch;
use crate::drive::DriveState;
use crate::motion::MotionLimits;
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// Ticks over which the speed of a joint is judged. A fault at 2.5 times the limit of 2 rad/s is then reported within 22 ms.
const SPEED_WINDOW: usize = 20;
/// Positions of a moving joint that stay the same for longer arrived late.
const LATE: SpanNs = SpanNs(2 * TICK.0);
/// Factor of the velocity limit above which a joint is too fast: an arm that lags a little behind catches up.
const FASTEST: f64 = 1.5;
/// Factor of the velocity limit above which a single reading is implausible.
const ABSURD_SPEED: f64 = 10.0;
/// Displacements below this are encoder noise, rad or m. In the speed window it allows 0.25 rad/s more.
const JITTER: f64 = 5e-3;
/// Time over which positions and velocities are compared.
const GLIDE: SpanNs = SpanNs(300_000_000);
/// Longest time without a new state over which the velocity is taken for the mean of those before and after. At 10 rad/s2 a joint may have gone 6 mrad further,
/// less than half of what [`CONTRADICTION`] allows; after more time the comparison begins anew.
const GLIDE_GAP: SpanNs = SpanNs(50_000_000);
/// Positions and velocities contradict each other when their displacements differ by more than this, rad or m, plus this share of the
/// larger of them. In the comparison's 0.3 s this allows a velocity offset of 0.05 rad/s.
const CONTRADICTION: f64 = 0.015;
const CONTRADICTING_SHARE: f64 = 0.4;
/// Ticks of one part, and the number of parts, over which the distances of a joint and its reference are summed: 0.4 s.
const FOLLOW_PART: usize = 100;
const FOLLOW_PARTS: usize = 4;
/// Distance of the reference in that time from which on a joint has to follow, rad or m: 0.05 rad/s.
const FOLLOW_WAY: f64 = 0.02;
/// Share of that distance that a joint must have moved.
const FOLLOWS: f64 = 0.2;
/// Share of what a joint moves by which its lag in sum shrinks: a drive whose velocities are up to a third wrong comes to no sum. Chosen by hand.
const FORGIVEN: f64 = 0.5;

/// Watches the measured arm.
#[derive(Debug, Clone)]
pub struct ArmWatch<const N: usize> {
    /// The last positions that differed from the ones before, and when they arrived.
    last: Option<(MonoNs, SVector<f64, N>)>,
    /// The last positions that were reported.
    reported: SVector<f64, N>,
    /// The last positions and their times, the oldest at `next`.
    recent: [(MonoNs, SVector<f64, N>); SPEED_WINDOW],
    next: usize,
    /// How many of them there are since the last restart.
    filled: usize,
    /// The displacement by the velocities.
    glide: Glide<N>,
    /// The next state is one that came before.
    is_late: bool,
    follow: Follow<N>,
    swing: SwingWatch<N>,
}

impl<const N: usize> Default for ArmWatch<N> {
    fn default() -> Self {
        let recent = [(MonoNs::ZERO, SVector::zeros()); SPEED_WINDOW];
        let glide = Glide::begin(MonoNs::ZERO, SVector::zeros(), SVector::zeros());
        Self {
            last: None,
            reported: SVector::zeros(),
            recent,
            next: 0,
            filled: 0,
            glide,
            is_late: false,
            follow: Follow::default(),
            swing: SwingWatch::default(),
        }
    }
}

impl<const N: usize> ArmWatch<N> {
    /// Takes in the drive's state at `now`, and what is [believed](super::EncoderWatch) of it; returns its fault. An implausible state is not remembered.
    pub fn note(
        &mut self,
        now: MonoNs,
        reported: &DriveState<N>,
        state: &DriveState<N>,
        limits: &MotionLimits<N>,
    ) -> Option<Fault> {
        let was_late = std::mem::take(&mut self.is_late);
        if !reported.q.iter().chain(reported.qd.iter()).all(|x| x.is_finite()) {
            return Some(Fault::DriveStateNotFinite);
        }
        if !limits.is_plausible(&reported.q, &reported.qd, ABSURD_SPEED) {
            return Some(Fault::DriveStateImplausible);
        }
        let Some((since, last)) = self.last else {
            (self.last, self.reported) = (Some((now, state.q)), reported.q);
            self.recent = [(now, state.q); SPEED_WINDOW];
            self.glide = Glide::begin(now, state.q, state.qd);
            return None;
        };
        let passed = (now - since).max(TICK);
        let farthest = |i: usize| ABSURD_SPEED * limits.speed(i) * passed.as_s() + JITTER;
        // An encoder that was frozen leaps to where its joint is believed to be.
        let leap = |i: usize| (reported.q[i] - last[i]).abs().min((reported.q[i] - self.reported[i]).abs());
        if (0..N).any(|i| leap(i) > farthest(i)) {
            return Some(Fault::DriveStateImplausible);
        }
        self.reported = reported.q;
        if state.q != last {
            self.last = Some((now, state.q));
            if passed > LATE {
                // The displacement took longer than a tick, so that it does not measure a speed.
                self.filled = 0;
            }
        }
        if !was_late && self.glide.contradicts(now, state) {
            return Some(Fault::DriveStateImplausible);
        }
        let place = self.recent.get_mut(self.next)?;
        let (then, oldest) = std::mem::replace(place, (now, state.q));
        self.next = (self.next + 1) % SPEED_WINDOW;
        self.filled = (self.filled + 1).min(SPEED_WINDOW + 1);
        if self.filled <= SPEED_WINDOW {
            return None;
        }
        let window_s = (now - then).as_s();
        let farthest = |i: usize| FASTEST * limits.velocity[i] * window_s + JITTER;
        (0..N).any(|i| (state.q[i] - oldest[i]).abs() > farthest(i)).then_some(Fault::TooFast)
    }

    /// Takes in the joint positions and the displacement of their reference in this tick, rad or m; `Some` when a joint does not follow.
    pub fn follow(&mut self, q: &SVector<f64, N>, way: &SVector<f64, N>) -> Option<Fault> {
        self.follow.note(q, way).then_some(Fault::DoesNotFollow)
    }

    /// Displacement by which the joints did less, or more, than their reference, in sum, rad or m: the largest of all joints. What a joint does moves it towards zero, so
    /// that a drive that is a few percent off does not come to a sum.
    #[must_use]
    pub fn lag(&self) -> f64 {
        self.follow.lag.amax()
    }

    /// Takes in the joint positions and the displacement of their reference in this tick, rad or m; `Some` when a joint oscillates.
    pub fn swing(&mut self, q: &SVector<f64, N>, way: &SVector<f64, N>) -> Option<Fault> {
        self.swing.note(q, way).then_some(Fault::Oscillates)
    }

    /// The next state is an old one, since no new one has come in time: nothing is told by it of how joints follow.
    pub fn late(&mut self) {
        self.restart();
        self.is_late = true;
    }

    /// Restarts the supervision: the arm begins to move, or its reference was reset.
    pub fn restart(&mut self) {
        self.follow = Follow::default();
        self.swing.restart();
        self.filled = 0;
    }
}

/// The displacement by integrated velocities.
#[derive(Debug, Clone)]
struct Glide<const N: usize> {
    /// So far, rad or m.
    way: SVector<f64, N>,
    /// When and where it began.
    since: MonoNs,
    from: SVector<f64, N>,
    /// When it was last added to, and the velocity at that time.
    until: MonoNs,
    qd: SVector<f64, N>,
}

impl<const N: usize> Glide<N> {
    fn begin(now: MonoNs, q: SVector<f64, N>, qd: SVector<f64, N>) -> Self {
        Self { way: SVector::zeros(), since: now, from: q, until: now, qd }
    }

    /// Whether positions and integrated velocities disagree: then one of them is frozen in the drive.
    fn contradicts(&mut self, now: MonoNs, state: &DriveState<N>) -> bool {
        if now - self.until > GLIDE_GAP {
            *self = Self::begin(now, state.q, state.qd);
            return false;
        }
        self.way += (self.qd + state.qd) * (0.5 * (now - self.until).as_s());
        (self.until, self.qd) = (now, state.qd);
        if now - self.since < GLIDE {
            return false;
        }
        let (integrated, gone) = (self.way, state.q - self.from);
        *self = Self::begin(now, state.q, state.qd);
        (0..N).any(|i| {
            let way = gone[i].abs().max(integrated[i].abs());
            (gone[i] - integrated[i]).abs() > CONTRADICTION + CONTRADICTING_SHARE * way
        })
    }
}

/// Whether joints follow their reference, by parts of the last 400 ms.
#[derive(Debug, Clone)]
struct Follow<const N: usize> {
    /// Ways of reference and joints in each part, the oldest at `part`.
    done: [Option<(SVector<f64, N>, SVector<f64, N>)>; FOLLOW_PARTS],
    part: usize,
    ticks: usize,
    /// Where the joints were when this part began, and how far the reference went since.
    now: Option<(SVector<f64, N>, SVector<f64, N>)>,
    /// Displacement of the reference less that of the joints, with what motion forgives, rad or m.
    lag: SVector<f64, N>,
}

impl<const N: usize> Default for Follow<N> {
    fn default() -> Self {
        Self { done: [None; FOLLOW_PARTS], part: 0, ticks: 0, now: None, lag: SVector::zeros() }
    }
}

impl<const N: usize> Follow<N> {
    /// Whether a joint has not followed. Distances are summed without sign, because a joint that lags behind a reversing reference moves
    /// in the opposite direction for a while.
    fn note(&mut self, q: &SVector<f64, N>, way: &SVector<f64, N>) -> bool {
        let (_, gone) = self.now.get_or_insert((*q, SVector::zeros()));
        *gone += way;
        self.ticks += 1;
        if self.ticks < FOLLOW_PART {
            return false;
        }
        self.ticks = 0;
        let ways = self.now.take().map(|(from, gone)| {
            let moved = q - from;
            self.lag.zip_zip_apply(&gone, &moved, |lag, gone, moved| {
                let sum = *lag + gone - moved;
                *lag = sum - sum.signum() * sum.abs().min(FORGIVEN * moved.abs());
            });
            (gone.abs(), moved.abs())
        });
        if let Some(place) = self.done.get_mut(self.part) {
            *place = ways;
        }
        self.part = (self.part + 1) % FOLLOW_PARTS;
        if !self.done.iter().all(Option::is_some) {
            return false;
        }
        let zero = (SVector::<f64, N>::zeros(), SVector::<f64, N>::zeros());
        let ways = self.done.iter().flatten().fold(zero, |sum, part| (sum.0 + part.0, sum.1 + part.1));
        (0..N).any(|i| ways.0[i] > FOLLOW_WAY && ways.1[i] < FOLLOWS * ways.0[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    fn limits() -> MotionLimits<2> {
        MotionLimits {
            lower: Vector2::repeat(-3.0),
            upper: Vector2::repeat(3.0),
            velocity: Vector2::new(2.0, 3.0),
            acceleration: Vector2::repeat(10.0),
            jerk: Vector2::repeat(500.0),
        }
    }

    fn at(ms: i32) -> MonoNs {
        MonoNs(i64::from(ms) * 1_000_000)
    }

    fn state(q: f64, qd: f64) -> DriveState<2> {
        DriveState { q: Vector2::new(q, 0.0), qd: Vector2::new(qd, 0.0), truth: None }
    }

    fn note(watch: &mut ArmWatch<2>, ms: i32, state: &DriveState<2>) -> Option<Fault> {
        watch.note(at(ms), state, state, &limits())
    }

    #[test]
    fn what_no_arm_does_is_told_at_once() {
        for (q, qd, fault) in [
            (f64::NAN, 0.0, Fault::DriveStateNotFinite),
            (0.0, f64::INFINITY, Fault::DriveStateNotFinite),
            (0.0, 1e200, Fault::DriveStateImplausible),
            (0.0, 25.0, Fault::DriveStateImplausible),
            (0.5, 0.0, Fault::DriveStateImplausible),
        ] {
            let mut watch = ArmWatch::default();
            assert_eq!(note(&mut watch, 0, &state(0.0, 0.0)), None);
            assert_eq!(note(&mut watch, 1, &state(q, qd)), Some(fault), "{q} {qd}");
            assert_eq!(note(&mut watch, 2, &state(0.0, 0.0)), None, "a state that was refused is forgotten");
        }
    }

    #[test]
    fn overspeed_is_reported_in_its_window_and_limit_speed_is_not() {
        for (speed, within) in [(2.0, None), (2.9, None), (3.6, Some(24)), (5.0, Some(22))] {
            let mut watch = ArmWatch::default();
            let told = (0..400).find(|k| {
                let q = speed * 1e-3 * f64::from(*k) - 0.5;
                note(&mut watch, *k, &state(q, speed)) == Some(Fault::TooFast)
            });
            assert_eq!(told.is_some(), within.is_some(), "{speed}");
            assert!(told.unwrap_or(0) <= within.unwrap_or(0), "{speed}: {told:?}");
        }
    }

    #[test]
    fn positions_that_come_late_are_no_speed() {
        let mut watch = ArmWatch::default();
        for k in 0..400 {
            let q = 2.0 * 1e-3 * f64::from(k / 15 * 15);
            assert_eq!(note(&mut watch, k, &state(q, 1.9)), None, "{k}");
        }
    }

    /// A state that is held because none comes says nothing of where the joint is now.
    #[test]
    fn states_that_come_late_contradict_nothing() {
        for (period, fresh) in [(8, 1), (40, 10), (300, 100)] {
            let (mut watch, mut held) = (ArmWatch::default(), state(0.0, 2.0));
            for k in 0..6000 {
                let t = f64::from(k) * 1e-3;
                if k % period < fresh {
                    held = state(0.5 * (4.0 * t).sin(), 2.0 * (4.0 * t).cos());
                } else {
                    watch.late();
                }
                assert_eq!(note(&mut watch, k, &held), None, "{period}: {k}");
            }
        }
    }

    #[test]
    fn a_frozen_position_with_a_reported_velocity_is_a_fault() {
        let mut watch = ArmWatch::default();
        let told = (0..1000).find(|k| {
            let q = 0.2e-3 * f64::from((*k).min(300));
            note(&mut watch, *k, &state(q, 0.2)) == Some(Fault::DriveStateImplausible)
        });
        assert!((400..=900).contains(&told.unwrap()), "{told:?}");
    }

    #[test]
    fn coarse_and_noisy_encoders_are_no_speed() {
        let mut watch = ArmWatch::default();
        let mut random = Random::new(3);
        for k in 0..5000 {
            let t = f64::from(k) * 1e-3;
            let q = 1.9 * t.sin() + 3e-4 * random.gaussian();
            let steps = (q / 1e-3).round() * 1e-3;
            let state = state(steps, 1.9 * t.cos() + 0.3 * random.gaussian());
            assert_eq!(note(&mut watch, k, &state), None);
        }
    }

    #[test]
    fn a_blocked_joint_is_reported_within_a_second() {
        for speed in [0.06, 0.3, 2.0] {
            let mut watch = ArmWatch::<2>::default();
            let mut told = None;
            for k in 0..3000 {
                let q = if k < 1000 { speed * 1e-3 * f64::from(k) } else { speed };
                let moving = Vector2::new(q, 0.0);
                if watch.follow(&moving, &Vector2::new(speed * 1e-3, 0.0)).is_some() {
                    told.get_or_insert(k);
                }
            }
            let after = told.unwrap() - 1000;
            assert!((0..=600).contains(&after), "{speed}: {after}");
        }
    }

    /// A joint that stands while it is told to creep is too slow a way for the distances of 0.4 s; its lag tells.
    #[test]
    fn a_standing_joint_comes_to_a_sum_of_lag_and_a_slow_drive_not() {
        for (share, least, most) in [(0.0, 0.09, 0.11), (0.75, 0.0, 0.02), (1.3, 0.0, 0.02)] {
            let mut watch = ArmWatch::<2>::default();
            for k in 0..5000 {
                let q = 0.02e-3 * f64::from(k);
                watch.follow(&Vector2::new(share * q, 0.0), &Vector2::new(0.02e-3, 0.0));
            }
            assert!((least..most).contains(&watch.lag()), "{share}: {}", watch.lag());
        }
    }

    #[test]
    fn a_joint_that_lags_or_creeps_follows() {
        let mut watch = ArmWatch::<2>::default();
        let mut q = 0.0;
        for k in 0..5000 {
            let r = 0.3 * (f64::from(k) * 2e-3).sin();
            let r_next = 0.3 * (f64::from(k + 1) * 2e-3).sin();
            q += (r - q) * 0.02;
            let told = watch.follow(&Vector2::new(q, 0.0), &Vector2::new(r_next - r, 1e-5));
            assert_eq!(told, None, "{k}");
        }
    }
}
