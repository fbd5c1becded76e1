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
use crate::drive::{DriveState, DriveTiming};
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
pub const ABSURD_SPEED: f64 = 10.0;
/// The same above which one is implausible even where the arm was seen to come to it. Chosen by hand: pushes of 450 N on wrists of 0.1 kg m^2 made 35 times their limits; far below the numbers whose squares overflow.
const FLUNG_SPEED: f64 = 100.0;
/// Share of a speed that a joint must have had in the state before, and by which its displacement may differ from what both speeds make, to be believed at a speed that is implausible by itself. Chosen by
/// hand: a push that flings a wrist within 6 ms adds a sixth in a tick, and a reading that leaps comes from far less.
const GOES_ON: f64 = 0.5;
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
    /// The joints that were seen to become faster than any arm: where they are tells nothing against a reading.
    flung: [bool; N],
    /// The last positions and velocities that were reported, and when.
    reported: (MonoNs, SVector<f64, N>, SVector<f64, N>),
    /// The last positions and their times, the oldest at `next`.
    recent: [(MonoNs, SVector<f64, N>); SPEED_WINDOW],
    next: usize,
    /// How many of them there are since the last restart.
    filled: usize,
    /// The displacement by the velocities.
    glide: Glide<N>,
    follow: Follow<N>,
    swing: SwingWatch<N>,
}

impl<const N: usize> Default for ArmWatch<N> {
    fn default() -> Self {
        let recent = [(MonoNs::ZERO, SVector::zeros()); SPEED_WINDOW];
        let glide = Glide::begin(MonoNs::ZERO, SVector::zeros(), SVector::zeros());
        Self {
            last: None,
            flung: [false; N],
            reported: (MonoNs::ZERO, SVector::zeros(), SVector::zeros()),
            recent,
            next: 0,
            filled: 0,
            glide,
            follow: Follow::default(),
            swing: SwingWatch::default(),
        }
    }
}

impl<const N: usize> ArmWatch<N> {
    /// Takes in the drive's state at `now`, what is [believed](super::EncoderWatch) of it, and whether it is a new one; returns its fault. An implausible state is not remembered.
    pub fn note(
        &mut self,
        now: MonoNs,
        reported: &DriveState<N>,
        state: &DriveState<N>,
        limits: &MotionLimits<N>,
        timing: DriveTiming,
    ) -> Option<Fault> {
        // Where none comes for long, what there is tells nothing of how joints follow.
        if timing.tells_nothing() {
            self.restart();
        }
        if !reported.q.iter().chain(reported.qd.iter()).all(|x| x.is_finite()) {
            return Some(Fault::DriveStateNotFinite);
        }
        let Some((since, last)) = self.last else {
            if !limits.is_plausible(&reported.q, &reported.qd, ABSURD_SPEED) {
                return Some(Fault::DriveStateImplausible);
            }
            (self.last, self.reported) = (Some((now, state.q)), (now, reported.q, reported.qd));
            self.recent = [(now, state.q); SPEED_WINDOW];
            self.glide = Glide::begin(now, state.q, state.qd);
            return None;
        };
        let passed = (now - since).max(TICK);
        let farthest = |i: usize| ABSURD_SPEED * limits.speed(i) * passed.as_s() + JITTER;
        // An encoder that was frozen leaps to where its joint is believed to be.
        let (then, before_q, before_qd) = self.reported;
        let leap = |i: usize| (reported.q[i] - last[i]).abs().min((reported.q[i] - before_q[i]).abs());
        // An arm that something flings away has to be braked by its states, whatever its speed.
        let since_s = (now - then).as_s();
        let mut is_flung = false;
        for i in 0..N {
            let (qd, before) = (reported.qd[i], before_qd[i]);
            let is_fast = qd.abs() > ABSURD_SPEED * limits.speed(i);
            let way = 0.5 * (before + qd) * since_s;
            let goes_on = qd * before > 0.0
                && before.abs() >= GOES_ON * qd.abs()
                && (reported.q[i] - before_q[i] - way).abs() <= GOES_ON * way.abs()
                && qd.abs() <= FLUNG_SPEED * limits.speed(i);
            self.flung[i] |= is_fast && goes_on;
            is_flung |= is_fast;
            let is_right = goes_on || !(is_fast || leap(i) > farthest(i));
            if !is_right || !(self.flung[i] || limits.is_near_range(i, reported.q[i])) {
                return Some(Fault::DriveStateImplausible);
            }
        }
        self.reported = (now, reported.q, reported.qd);
        if state.q != last {
            self.last = Some((now, state.q));
            if passed > LATE {
                // The displacement took longer than a tick, so that it does not measure a speed.
                self.filled = 0;
            }
        }
        if !timing.is_old() && self.glide.contradicts(now, state) {
            return Some(Fault::DriveStateImplausible);
        }
        let place = self.recent.get_mut(self.next)?;
        let (then, oldest) = std::mem::replace(place, (now, state.q));
        self.next = (self.next + 1) % SPEED_WINDOW;
        self.filled = (self.filled + 1).min(SPEED_WINDOW + 1);
        if self.filled <= SPEED_WINDOW {
            return is_flung.then_some(Fault::TooFast);
        }
        let window_s = (now - then).as_s();
        let farthest = |i: usize| FASTEST * limits.velocity[i] * window_s + JITTER;
        let is_too_fast = is_flung || (0..N).any(|i| (state.q[i] - oldest[i]).abs() > farthest(i));
        is_too_fast.then_some(Fault::TooFast)
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
    pub fn swing(
        &mut self,
        q: &SVector<f64, N>,
        way: &SVector<f64, N>,
        timing: DriveTiming,
    ) -> Option<Fault> {
        self.swing.note(q, way, timing.is_old()).then_some(Fault::Oscillates)
    }

    /// Restarts the supervision: the arm begins to move, or its reference was reset.
    pub fn restart(&mut self) {
        self.follow = Follow::default();
        self.swing.restart();
        (self.filled, self.flung) = (0, [false; N]);
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
    /// How far the reference went on its side of a joint that did not follow it, rad or m: what the joint moves counts as a way of `1 / FOLLOWS` times as much that was followed.
    /// A reference that creeps never goes far in the time of the parts.
    left_behind: SVector<f64, N>,
    /// For how many parts that has been too much.
    parts_behind: SVector<u32, N>,
}

impl<const N: usize> Default for Follow<N> {
    fn default() -> Self {
        Self {
            done: [None; FOLLOW_PARTS],
            part: 0,
            ticks: 0,
            now: None,
            lag: SVector::zeros(),
            left_behind: SVector::zeros(),
            parts_behind: SVector::zeros(),
        }
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
            self.left_behind.zip_zip_apply(&gone, &moved, |way, gone, moved| {
                let sum = *way + gone;
                *way = sum - sum.signum() * sum.abs().min(moved.abs() / FOLLOWS);
            });
            (gone.abs(), moved.abs())
        });
        self.parts_behind.zip_apply(&self.left_behind, |parts, way| {
            *parts = if way.abs() > FOLLOW_WAY { parts.saturating_add(1) } else { 0 };
        });
        // As long as the parts together, so that a drive that obeys late has begun to.
        if self.parts_behind.iter().any(|parts| *parts as usize >= FOLLOW_PARTS) {
            return true;
        }
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
mod tests;
