//! Watchdog of the processes of a run: a process that hangs neither ends nor reports anything.
//!
//! The numbers here were chosen by hand, so that a process that is kept from its core by load is reported before it ends the run.
//!
//! | sign of life | of | by |
//! | --- | --- | --- |
//! | its heartbeat, in the file of its role's lock | camera, vision, control | its main loop |
//! | `control/status` goes on | control's real-time thread | its ticks, from the first to the last |

use crate::config::Clock;
use crate::ipc::{Instance, Role, TICKS_ARE_OVER};
use crate::messages::Status;
use crate::process::silence::Silence;
use crate::time::{MonoNs, SpanNs};
use tracing::warn;

/// Period of the checks.
const PERIOD: SpanNs = SpanNs(100_000_000);
/// A silence that is reported.
const REPORT_AFTER: SpanNs = SpanNs(2_000_000_000);
/// A silence that ends the run.
const GIVE_UP_AFTER: SpanNs = SpanNs(6_000_000_000);
/// A silence of a process that can be started anew. The arm holds already, so that a mistake costs no more than that start; a driver of a camera that is opened anew may
/// take a second or two.
const START_ANEW_AFTER: SpanNs = SpanNs(3_000_000_000);
/// The same of one that the kernel tells to be suspended by a signal, as by `kill -STOP`: it is not slow, and a second after the signal another one is there.
const SUSPENDED_FOR: SpanNs = SpanNs(400_000_000);
/// From the start of a process to its first sign: a busy machine may take its time.
const START_UP: SpanNs = SpanNs(20_000_000_000);
/// Heartbeats after which the main loop of a process has come round: the first one comes when it joins.
const WORKS: u32 = 2;

/// The signs of life of a run's processes.
pub(super) struct HangWatch {
    instance: Instance,
    clock: Clock,
    next_look: MonoNs,
    heartbeats: Vec<Heart>,
    ticks: Sign,
    /// Whether control has measured a frame: all who see for it have come round, whatever their heartbeats have told yet.
    measures: bool,
}

/// The heartbeats of a process.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heart {
    role: Role,
    sign: Sign,
    /// The last one of the process that played the role before: it is none of this one.
    stale: Option<MonoNs>,
    /// How many different ones were seen of this process.
    beats: u32,
    /// Whether there is no process now.
    is_away: bool,
}

impl Heart {
    /// Of a process that is about to be started.
    pub(super) fn of(role: Role, instance: &Instance, now: MonoNs) -> Self {
        Self { role, sign: Sign::new(now), stale: instance.last_heartbeat(role), beats: 0, is_away: false }
    }

    /// Looks for a new one.
    pub(super) fn listen(&mut self, instance: &Instance, now: MonoNs) {
        let heartbeat = instance.last_heartbeat(self.role).filter(|last| self.stale != Some(*last));
        if let Some(heartbeat) = heartbeat
            && self.sign.seen(heartbeat.0, now)
        {
            self.beats = self.beats.saturating_add(1);
        }
    }

    /// Whether its main loop comes round.
    pub(super) fn works(&self) -> bool {
        self.beats >= WORKS && !self.is_away
    }
}

impl HangWatch {
    /// Over control and those that see for it, before they are started.
    pub(super) fn new(instance: &Instance, clock: Clock, seeing: Vec<Role>, now: MonoNs) -> Self {
        let roles = std::iter::once(Role::Control).chain(seeing);
        let heartbeats = roles.map(|role| Heart::of(role, instance, now)).collect();
        let ticks = Sign::new(now);
        Self { instance: instance.clone(), clock, next_look: now, heartbeats, ticks, measures: false }
    }

    /// The process of `role` is about to be started anew.
    pub(super) fn begin_anew(&mut self, role: Role, now: MonoNs) {
        if let Some(heart) = self.heartbeats.iter_mut().find(|heart| heart.role == role) {
            *heart = Heart::of(role, &self.instance, now);
        }
    }

    /// The process of `role` has ended: it is not waited for. Whether it had joined the instance.
    pub(super) fn ended(&mut self, role: Role, now: MonoNs) -> bool {
        let Some(heart) = self.heartbeats.iter_mut().find(|heart| heart.role == role) else { return false };
        if !std::mem::replace(&mut heart.is_away, true) {
            heart.listen(&self.instance, now);
        }
        heart.beats > 0
    }

    /// Those whose main loop comes round.
    pub(super) fn working(&self) -> impl Iterator<Item = Role> {
        self.heartbeats.iter().filter(|heart| heart.works()).map(|heart| heart.role)
    }

    /// Control said where the run stands.
    pub(super) fn note(&mut self, status: &Status, now: MonoNs) {
        self.ticks.seen(status.tick as i64, now);
        self.measures |= status.frames > 0;
    }

    /// Whether control has ticked at all.
    pub(super) fn has_ticked(&self) -> bool {
        self.ticks.last.is_some()
    }

    /// Checks at `now`; returns the process that has been silent for too long, and for how long. `is_suspended` says of which one the kernel tells that.
    pub(super) fn look(
        &mut self,
        now: MonoNs,
        is_suspended: impl Fn(Role) -> bool,
    ) -> Option<(Role, SpanNs)> {
        if now < self.next_look {
            return None;
        }
        self.next_look = now + PERIOD;
        let mut hangs = None;
        for heart in self.heartbeats.iter_mut().filter(|heart| !heart.is_away) {
            heart.listen(&self.instance, now);
            let can_be_mended = heart.role != Role::Control && self.clock == Clock::Realtime;
            let then = "it is started anew";
            let patience = if !can_be_mended || !(heart.works() || self.measures) {
                ENDS_THE_RUN
            } else if is_suspended(heart.role) {
                Patience { silence: SUSPENDED_FOR, then }
            } else {
                Patience { silence: START_ANEW_AFTER, then }
            };
            hangs = heart.sign.judge(heart.role, "shows no sign of life", patience, now).or(hangs);
        }
        // In lockstep control's ticks wait for camera and vision; then its heartbeat alone is a sign, as it is while control works out what the run has told.
        let ticks = self.clock == Clock::Realtime
            && self.ticks.last.is_some()
            && self.instance.progress(Role::Control) != Some(TICKS_ARE_OVER);
        if ticks {
            hangs = self.ticks.judge(Role::Control, "does not tick", ENDS_THE_RUN, now).or(hangs);
        }
        hangs
    }
}

/// How long a silence may last.
#[derive(Debug, Clone, Copy)]
struct Patience {
    silence: SpanNs,
    then: &'static str,
}

const ENDS_THE_RUN: Patience = Patience { silence: GIVE_UP_AFTER, then: "the run ends" };

/// A value that changes while its process lives.
#[derive(Debug, Clone, Copy)]
struct Sign {
    last: Option<i64>,
    silence: Silence,
    told: bool,
}

impl Sign {
    fn new(now: MonoNs) -> Self {
        Self { last: None, silence: Silence::begin(now), told: false }
    }

    /// Whether it is another value than before.
    fn seen(&mut self, value: i64, now: MonoNs) -> bool {
        let is_new = self.last != Some(value);
        if is_new {
            *self = Self { last: Some(value), ..Self::new(now) };
        }
        is_new
    }

    fn judge(&mut self, role: Role, what: &str, patience: Patience, now: MonoNs) -> Option<(Role, SpanNs)> {
        let silent = self.silence.look(now);
        let limit = if self.last.is_some() { patience.silence } else { START_UP };
        if silent > REPORT_AFTER && silent <= limit && !std::mem::replace(&mut self.told, true) {
            warn!(
                "the {role} process {what} for {:.0} s; {} after {:.0} s",
                silent.as_s(),
                patience.then,
                limit.as_s()
            );
        }
        (silent > limit).then_some((role, silent))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::CameraId;

    #[test]
    fn a_sign_that_does_not_change_is_told_then_given_up() {
        let at = |ms: i64| MonoNs(ms * 1_000_000);
        let mut sign = Sign::new(at(0));
        let mut given_up = None;
        for ms in (0..40_000).step_by(100) {
            if ms < 3_000 {
                sign.seen(ms, at(ms));
            }
            if sign.judge(Role::Vision(CameraId::FIRST), "is silent", ENDS_THE_RUN, at(ms)).is_some() {
                given_up.get_or_insert(ms);
            } else {
                assert_eq!(given_up, None);
            }
            assert_eq!(sign.told, ms > 2_900 + 2_000, "{ms}");
        }
        assert_eq!(given_up, Some(2_900 + 6_100));
    }

    #[test]
    fn a_process_works_from_its_second_own_heartbeat_on() {
        let instance: Instance = format!("u-hearts-{}", std::process::id()).parse().unwrap();
        let role = Role::Vision(CameraId::FIRST);
        let mut time = crate::rt::now();
        let mut look = |watch: &mut HangWatch| {
            time = time + PERIOD;
            assert_eq!(watch.look(time, |_| false), None);
            watch.working().count()
        };
        let lock = instance.lock(role).unwrap();
        let _ = lock.heartbeat().unwrap();
        let mut watch = HangWatch::new(&instance, Clock::Realtime, vec![role], crate::rt::now());
        assert_eq!(look(&mut watch), 0, "that was one before");
        let _ = lock.heartbeat().unwrap();
        assert_eq!(look(&mut watch), 0, "it has joined");
        let _ = lock.heartbeat().unwrap();
        assert_eq!(look(&mut watch), 1);
        assert!(watch.ended(role, crate::rt::now()));
        assert_eq!(look(&mut watch), 0);
        watch.begin_anew(role, crate::rt::now());
        assert_eq!(look(&mut watch), 0);
        assert!(!watch.ended(role, crate::rt::now()), "it died before it joined");
        drop(lock);
        instance.remove_leftovers(None);
    }

    /// Nobody waits for six seconds because a camera was suspended as soon as its first frame was measured.
    #[test]
    fn what_has_measured_is_mended_before_its_second_heartbeat() {
        let instance: Instance = format!("u-early-{}", std::process::id()).parse().unwrap();
        let role = Role::Camera(CameraId::FIRST);
        let lock = instance.lock(role).unwrap();
        for (frames, is_suspended, silent_ms) in [(0, true, 6_000), (1, true, 400), (1, false, 3_000)] {
            let mut time = crate::rt::now();
            let mut watch = HangWatch::new(&instance, Clock::Realtime, vec![role], time);
            let _ = lock.heartbeat().unwrap();
            let hangs = (0..100).find_map(|tick| {
                time = time + PERIOD;
                watch.note(&Status { tick, frames, ..Status::default() }, time);
                watch.look(time, |_| is_suspended)
            });
            let ((who, silent), after) = (hangs.unwrap(), SpanNs(silent_ms * 1_000_000));
            assert!(
                who == role && silent > after && silent <= SpanNs(after.0 + 2 * PERIOD.0),
                "{frames} {silent:?}"
            );
        }
        drop(lock);
        instance.remove_leftovers(None);
    }

    #[test]
    fn ticks_are_waited_for_until_they_are_over() {
        let instance: Instance = format!("u-ticks-{}", std::process::id()).parse().unwrap();
        let lock = instance.lock(Role::Control).unwrap();
        for (progress, silent_s) in [(0, Some(6)), (TICKS_ARE_OVER, None)] {
            let mut time = crate::rt::now();
            let mut watch = HangWatch::new(&instance, Clock::Realtime, Vec::new(), time);
            watch.note(&Status::default(), time);
            let hangs = (0..100).find_map(|_| {
                time = time + PERIOD;
                lock.heartbeat().unwrap().tell_progress(progress);
                watch.look(time, |_| false)
            });
            assert_eq!(
                hangs.map(|(role, silent)| (role, silent.as_s() as i64)),
                silent_s.map(|s| (Role::Control, s))
            );
        }
        drop(lock);
        instance.remove_leftovers(None);
    }

    #[test]
    fn a_start_may_take_longer() {
        let mut sign = Sign::new(MonoNs(0));
        let first = (0..400).map(|k| k * 100).find(|ms| {
            sign.judge(Role::Camera(CameraId::FIRST), "is silent", ENDS_THE_RUN, MonoNs(ms * 1_000_000))
                .is_some()
        });
        assert_eq!(first, Some(20_100));
    }
}
