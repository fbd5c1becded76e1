//! Which limit acts on which joint, now and for how long.

use crate::robot::joint_in_words;
use crate::time::{MonoNs, SpanNs};

/// A limit that acts for so long is reported. Chosen by hand: a start or a reversal within the usual limits takes less, so that it is not.
const LONG: SpanNs = SpanNs(1_000_000_000);

/// The limits that can hold a joint back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// The end of its range.
    Position = 0,
    /// Its largest speed.
    Velocity = 1,
    /// Its largest acceleration.
    Acceleration = 2,
    /// Its largest jerk.
    Jerk = 3,
    /// Its largest torque or force.
    Effort = 4,
    /// A singular posture near by: the whole arm is damped.
    Singularity = 5,
    /// A view that is old or uncertain: the whole arm is slowed down.
    View = 6,
    /// A joint that does not move: it gets only a little more torque than the model predicts.
    Stall = 7,
    /// A limit in space: the whole arm is slowed down, held, or goes another way.
    Workspace = 8,
}

impl Limit {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Position,
        Self::Velocity,
        Self::Acceleration,
        Self::Jerk,
        Self::Effort,
        Self::Singularity,
        Self::View,
        Self::Stall,
        Self::Workspace,
    ];

    /// Its bit in `Status::limits`.
    #[must_use]
    pub fn bit(self) -> u32 {
        1 << self as u32
    }

    fn describe(self) -> &'static str {
        match self {
            Self::Position => "the end of the range holds back",
            Self::Velocity => "the velocity limit slows down",
            Self::Acceleration => "the acceleration limit slows down",
            Self::Jerk => "the jerk limit slows down",
            Self::Effort => "the effort limit cuts the torque of",
            Self::Singularity => "a singular posture near by slows down",
            Self::View => "an old or uncertain view slows down",
            Self::Workspace => "a limit in space ([workspace]) holds back",
            Self::Stall => "no more than a gentle push is given to what does not move,",
        }
    }
}

/// The limits that act in one tick, as a mask of joints for each (bit 0 is the first joint).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ActingLimits([u8; Limit::ALL.len()]);

impl ActingLimits {
    /// Notes that `limit` acts on `joint`, counted from 0.
    pub fn set(&mut self, limit: Limit, joint: usize) {
        self.add(limit, 1u8.checked_shl(joint as u32).unwrap_or(0));
    }

    /// Notes that `limit` acts on the joints of a mask.
    pub fn add(&mut self, limit: Limit, joints: u8) {
        if let Some(mask) = self.0.get_mut(limit as usize) {
            *mask |= joints;
        }
    }

    /// The limits of both.
    #[must_use]
    pub fn with(mut self, others: &Self) -> Self {
        for (mask, other) in self.0.iter_mut().zip(others.0) {
            *mask |= other;
        }
        self
    }

    /// The same without `limit`.
    #[must_use]
    pub fn without(mut self, limit: Limit) -> Self {
        if let Some(mask) = self.0.get_mut(limit as usize) {
            *mask = 0;
        }
        self
    }

    /// The joints on which `limit` acts.
    #[must_use]
    pub fn joints(&self, limit: Limit) -> u8 {
        self.0.get(limit as usize).copied().unwrap_or(0)
    }

    /// Whether any limit acts.
    #[must_use]
    pub fn any(&self) -> bool {
        *self != Self::default()
    }

    /// The limits that act, as [`Limit::bit`]s.
    #[must_use]
    pub fn kinds(&self) -> u32 {
        Limit::ALL.iter().filter(|l| self.joints(**l) != 0).map(|l| l.bit()).sum()
    }

    /// The joints on which any limit acts.
    #[must_use]
    pub fn all_joints(&self) -> u8 {
        self.0.iter().fold(0, |all, mask| all | mask)
    }
}

/// A limit that has acted for long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LongActing {
    /// Which.
    pub limit: Limit,
    /// On which joints, as a mask.
    pub joints: u8,
}

impl LongActing {
    /// The description for people, of an arm whose joints have these `names`.
    #[must_use]
    pub fn describe(&self, names: &[String]) -> String {
        let what = self.limit.describe();
        if matches!(self.limit, Limit::Singularity | Limit::View | Limit::Workspace) {
            return format!("{what} the arm for {:.0} s now", LONG.as_s());
        }
        let joints: Vec<String> =
            (0..8).filter(|i| self.joints >> i & 1 == 1).map(|i| joint_in_words(names, i)).collect();
        format!("{what} {} for {:.0} s now", joints.join(", "), LONG.as_s())
    }
}

/// Counts acting limits and notices those that act for long.
#[derive(Debug, Clone, Copy, Default)]
pub struct LimitWatch {
    since: [Option<MonoNs>; Limit::ALL.len()],
    told: [bool; Limit::ALL.len()],
    ticks: [u64; Limit::ALL.len()],
}

impl LimitWatch {
    /// Takes in the limits of a tick; calls `tell` with each limit that has now acted for long.
    pub fn note(&mut self, now: MonoNs, acting: &ActingLimits, mut tell: impl FnMut(LongActing)) {
        let places = self.since.iter_mut().zip(&mut self.told).zip(&mut self.ticks);
        for (limit, ((since, told), ticks)) in Limit::ALL.into_iter().zip(places) {
            let joints = acting.joints(limit);
            if joints == 0 {
                (*since, *told) = (None, false);
                continue;
            }
            *ticks += 1;
            let start = *since.get_or_insert(now);
            if !*told && now - start >= LONG {
                *told = true;
                tell(LongActing { limit, joints });
            }
        }
    }

    /// Ticks in which `limit` acted.
    #[must_use]
    pub fn ticks(&self, limit: Limit) -> u64 {
        self.ticks.get(limit as usize).copied().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_tell_limit_and_joint() {
        let mut a = ActingLimits::default();
        assert!(!a.any());
        a.set(Limit::Jerk, 0);
        a.set(Limit::Jerk, 6);
        a.set(Limit::Effort, 2);
        assert_eq!(a.joints(Limit::Jerk), 0b100_0001);
        assert_eq!(a.kinds(), Limit::Jerk.bit() | Limit::Effort.bit());
        assert_eq!(a.all_joints(), 0b100_0101);
        a.set(Limit::Position, 99);
        assert_eq!(a.joints(Limit::Position), 0, "there is no such joint");
    }

    #[test]
    fn long_action_is_told_once_and_again_after_a_pause() {
        let mut watch = LimitWatch::default();
        let mut acting = ActingLimits::default();
        acting.set(Limit::Velocity, 1);
        let mut told = Vec::new();
        for ms in 0..3000 {
            let now = MonoNs(ms * 1_000_000);
            let acting = if ms == 1500 { ActingLimits::default() } else { acting };
            watch.note(now, &acting, |long| told.push((ms, long)));
        }
        assert_eq!(told.iter().map(|t| t.0).collect::<Vec<_>>(), [1000, 2501]);
        let names = ["base".to_owned(), "elbow".to_owned()];
        assert_eq!(told[0].1.describe(&names), "the velocity limit slows down joint \"elbow\" for 1 s now");
        assert_eq!(watch.ticks(Limit::Velocity), 2999);
        assert_eq!(watch.ticks(Limit::Jerk), 0);
    }
}
