//! Camera and vision of a run in real time are started anew when they die or hang; the arm holds meanwhile, because its measurements grow old. So is the guardian,
//! without which a run goes on.
//!
//! ```text
//!            dies, or hangs and is killed            its time has come            its main loop comes round
//!   Working ──────────────────────────────► Down ───────────────────► Starting ────────────────────────────► Working
//!                                            ▲                           │ dies, or hangs and is killed
//!                                            └───────────────────────────┘
//! ```
//! Control is never started anew, since an arm may move, and neither is a drive; a process of a lockstep run is not, since that run must be the same to the last bit.
//! Not mended either: a process whose main loop has never come round in this run (what is wrong with it was so from the start), a camera that is away for longer than
//! its `give_up_s`, and one that reads files and has ended by itself.

use super::child::ProcessEnd;
use crate::config::{Clock, Config, Source};
use crate::ipc::{Instance, RestartCounts, Role, StopWord};
use crate::process::watched_roles;
use crate::time::{MonoNs, SpanNs};
use std::collections::BTreeMap;
use tracing::{info, warn};

/// From the second death in a row to the next start; each further one doubles it. Chosen by hand: what may be mended by itself in a moment, such as a lock, has that moment.
const SECOND_TRY: SpanNs = SpanNs(250_000_000);
/// Longest time between two tries. Chosen by hand, for people: who has plugged a camera in again waits a minute at most.
const LONGEST_PAUSE: SpanNs = SpanNs(60_000_000_000);
/// A process that worked for so long has not died in a row with the one before. Chosen by hand: longer than the six seconds after which a silent camera gives up.
const STEADY: SpanNs = SpanNs(10_000_000_000);
/// Exit code of a camera that stayed away. Derived: that which `ProcessError::exit_code` gives it.
const CAMERA_STAYED_AWAY: u8 = 4;

/// How long to wait before a process is started anew.
#[derive(Debug, Clone, Copy, Default)]
struct BackOff {
    in_a_row: u32,
}

impl BackOff {
    /// After a death, when it had worked for `worked`: the first time at once, then ever longer.
    fn pause(&mut self, worked: SpanNs) -> SpanNs {
        if worked >= STEADY {
            self.in_a_row = 0;
        }
        let doublings = self.in_a_row.checked_sub(1);
        self.in_a_row = self.in_a_row.saturating_add(1);
        // Eight doublings are more than the longest pause.
        doublings.map_or(SpanNs(0), |n| SpanNs((SECOND_TRY.0 << n.min(8)).min(LONGEST_PAUSE.0)))
    }
}

/// Where a process stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RestartPhase {
    /// Its main loop has not come round yet.
    Starting,
    /// It has, first at this time.
    Working(MonoNs),
    /// It is dead, and is started anew at this time.
    Down(MonoNs),
}

/// One process.
#[derive(Debug)]
struct RestartPlace {
    role: Role,
    phase: RestartPhase,
    back_off: BackOff,
    /// How long it was silent before it was killed for that.
    hung: Option<SpanNs>,
    /// Whether its main loop has come round in this run.
    has_worked: bool,
    /// When it died; `None` once it is back.
    died: Option<MonoNs>,
    restarts: u32,
    /// Tries since it died.
    tries: u32,
}

/// What is to be done about the end of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reaction {
    /// Nothing: it is started anew when its time has come.
    StartsAnew,
    /// The run ends.
    EndsTheRun,
}

/// Those that see for control, and the guardian.
pub(super) struct Restarts {
    instance: Instance,
    places: Vec<RestartPlace>,
    /// Whether cameras read files, which do not change.
    reads_files: bool,
    losses: u32,
    told: RestartCounts,
    word: Option<StopWord>,
}

impl Restarts {
    /// Of a run of `config`; nothing in lockstep.
    pub(super) fn new(config: &Config, instance: &Instance) -> Self {
        let roles = if config.clock == Clock::Realtime { watched_roles(config) } else { Vec::new() };
        let place = |role| RestartPlace {
            role,
            phase: RestartPhase::Starting,
            back_off: BackOff::default(),
            hung: None,
            has_worked: false,
            died: None,
            restarts: 0,
            tries: 0,
        };
        Self {
            instance: instance.clone(),
            places: roles.into_iter().map(place).collect(),
            reads_files: matches!(config.camera.source, Source::Replay { .. }),
            losses: 0,
            told: RestartCounts::default(),
            word: None,
        }
    }

    fn place(&mut self, role: Role) -> Option<&mut RestartPlace> {
        self.places.iter_mut().find(|place| place.role == role)
    }

    /// The main loop of `role` comes round.
    pub(super) fn works(&mut self, role: Role, now: MonoNs) {
        let Some(place) = self.place(role).filter(|place| place.phase == RestartPhase::Starting) else {
            return;
        };
        (place.phase, place.has_worked) = (RestartPhase::Working(now), true);
        if let Some(died) = place.died.take() {
            place.tries = 0;
            info!(
                restarts = place.restarts,
                "the {role} process is back, {:.2} s after it died",
                (now - died).as_s()
            );
        }
    }

    /// Vision has sent measurements of frames to control: all have worked in this run, whatever their heartbeats have told yet.
    pub(super) fn all_work(&mut self, now: MonoNs) {
        let sees = |place: &&RestartPlace| place.role != Role::Guardian;
        let waiting =
            self.places.iter().filter(sees).filter(|place| !place.has_worked).map(|place| place.role);
        for role in waiting.collect::<Vec<_>>() {
            self.works(role, now);
        }
    }

    /// Whether `role`, which has been silent for so long, is to be killed so that it can be started anew.
    pub(super) fn is_hanging(&mut self, role: Role, silent: SpanNs) -> bool {
        let Some(place) = self.place(role).filter(|place| place.has_worked) else { return false };
        if place.hung.is_none() {
            warn!("the {role} process hangs, no sign of life for {:.1} s, and is killed", silent.as_s());
            place.hung = Some(silent);
        }
        true
    }

    /// What is to be done about the `end` of `role`, of which `joined` says whether it had joined the instance. To be asked again and again as long as it is dead.
    pub(super) fn ended(&mut self, role: Role, end: ProcessEnd, joined: bool, now: MonoNs) -> Reaction {
        let reads_files = self.reads_files;
        let Some(place) = self.place(role) else { return Reaction::EndsTheRun };
        let worked = match place.phase {
            RestartPhase::Down(_) => return Reaction::StartsAnew,
            RestartPhase::Starting => SpanNs(0),
            RestartPhase::Working(since) => now - since,
        };
        let is_final = match end.exit_code().filter(|_| worked.0 > 0) {
            Some(CAMERA_STAYED_AWAY) => true,
            Some(_) => reads_files && matches!(role, Role::Camera(_)),
            None => false,
        };
        if is_final || !place.has_worked {
            return Reaction::EndsTheRun;
        }
        let pause = place.back_off.pause(worked);
        place.phase = RestartPhase::Down(now + pause);
        place.died.get_or_insert(now);
        let (hung, tries, restarts) = (place.hung.take(), place.tries, place.restarts);
        let what = match (hung, worked.0 > 0) {
            (Some(silent), _) => format!("hung for {:.1} s and was killed", silent.as_s()),
            (None, true) => format!("died ({end})"),
            (None, false) => format!("did not start again ({end})"),
        };
        let when = if pause.0 == 0 { "at once".into() } else { format!("in {:.2} s", pause.as_s()) };
        warn!(
            restarts,
            "the {role} process {what}: control goes on without it, try {} to start it anew comes {when}",
            tries + 1
        );
        // Of the guardian nothing is lost that the arm would have to be held for.
        if joined && role != Role::Guardian {
            self.losses = self.losses.wrapping_add(1);
        }
        self.tell();
        Reaction::StartsAnew
    }

    /// A process whose time has come.
    pub(super) fn due(&self, now: MonoNs) -> Option<Role> {
        let is_due = |place: &&RestartPlace| matches!(place.phase, RestartPhase::Down(at) if now >= at);
        self.places.iter().find(is_due).map(|place| place.role)
    }

    /// `role` was started anew, or could not be, for this reason.
    pub(super) fn started(&mut self, role: Role, refusal: Option<&dyn std::fmt::Display>, now: MonoNs) {
        let Some(place) = self.place(role) else { return };
        place.restarts = place.restarts.saturating_add(1);
        place.tries = place.tries.saturating_add(1);
        match refusal {
            None => place.phase = RestartPhase::Starting,
            Some(why) => {
                let pause = place.back_off.pause(SpanNs(0));
                place.phase = RestartPhase::Down(now + pause);
                let tries = place.tries + 1;
                warn!("the {role} process: {why}; try {tries} comes in {:.2} s", pause.as_s());
            }
        }
        self.tell();
    }

    fn counts(&self) -> RestartCounts {
        let of = |is_meant: fn(Role) -> bool| {
            self.places.iter().filter(|place| is_meant(place.role)).map(|place| place.restarts).sum()
        };
        RestartCounts {
            losses: self.losses,
            camera: of(|role| matches!(role, Role::Camera(_))),
            vision: of(|role| matches!(role, Role::Vision(_))),
        }
    }

    /// Tells control what it has not heard yet, as soon as it has the page for that.
    pub(super) fn tell(&mut self) {
        let counts = self.counts();
        if counts == self.told {
            return;
        }
        if self.word.is_none() {
            self.word = self.instance.open_stop_word().ok().flatten();
        }
        if let Some(word) = &self.word {
            word.tell_restarts(counts);
            self.told = counts;
        }
    }

    /// Which process is dead now, for the reason of a run that ends so.
    pub(super) fn absent(&self) -> Option<String> {
        let place = self.places.iter().find(|place| place.died.is_some())?;
        Some(format!("the {} process did not come back in {} tries", place.role, place.tries))
    }

    /// How often each was started anew.
    pub(super) fn by_role(&self) -> BTreeMap<String, u32> {
        let restarted = self.places.iter().filter(|place| place.restarts > 0);
        restarted.map(|place| (place.role.to_string(), place.restarts)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::CameraId;
    use std::os::unix::process::ExitStatusExt;

    const CAMERA: Role = Role::Camera(CameraId::FIRST);
    const VISION: Role = Role::Vision(CameraId::FIRST);

    fn restarts(set: &[&str]) -> Restarts {
        let set: Vec<String> = set.iter().map(|set| (*set).to_owned()).collect();
        Restarts::new(&Config::load(None, &set).unwrap(), &"u-restarts".parse().unwrap())
    }

    fn at(ms: i64) -> MonoNs {
        MonoNs(ms * 1_000_000)
    }

    fn killed() -> ProcessEnd {
        ProcessEnd::from(std::process::ExitStatus::from_raw(9))
    }

    fn exited(code: i32) -> ProcessEnd {
        ProcessEnd::from(std::process::ExitStatus::from_raw(code << 8))
    }

    #[test]
    fn pauses_double_to_a_minute_and_begin_anew_after_steady_work() {
        let mut back_off = BackOff::default();
        let mut pause_ms = |worked| back_off.pause(worked).0 / 1_000_000;
        let pauses: Vec<_> = (0..12).map(|_| pause_ms(SpanNs(1_000_000))).collect();
        assert_eq!(pauses, [0, 250, 500, 1000, 2000, 4000, 8000, 16_000, 32_000, 60_000, 60_000, 60_000]);
        assert_eq!((pause_ms(STEADY), pause_ms(SpanNs(0))), (0, 250));
    }

    #[test]
    fn a_dead_process_is_due_after_its_pause_and_counted() {
        let mut r = restarts(&[]);
        r.works(VISION, at(0));
        assert_eq!(r.ended(VISION, killed(), true, at(1_000)), Reaction::StartsAnew);
        assert_eq!(r.due(at(1_000)), Some(VISION));
        r.started(VISION, None, at(1_000));
        assert_eq!((r.due(at(9_000)), r.absent().is_some()), (None, true));
        // it does not come up again
        assert_eq!(r.ended(VISION, exited(3), false, at(1_100)), Reaction::StartsAnew);
        assert_eq!(r.ended(VISION, exited(3), false, at(1_110)), Reaction::StartsAnew, "asked again");
        assert_eq!((r.due(at(1_349)), r.due(at(1_350))), (None, Some(VISION)));
        r.started(VISION, Some(&"no memory"), at(1_350));
        assert_eq!((r.due(at(1_849)), r.due(at(1_850))), (None, Some(VISION)));
        r.started(VISION, None, at(1_850));
        r.works(VISION, at(2_000));
        assert_eq!(r.absent(), None);
        assert_eq!(r.by_role(), BTreeMap::from([("vision".to_owned(), 3)]));
        assert_eq!(r.counts(), RestartCounts { losses: 1, camera: 0, vision: 3 });
    }

    #[test]
    fn a_guardian_is_started_anew_and_holds_no_arm() {
        let mut r = restarts(&["drive.kind=external"]);
        r.all_work(at(0));
        assert!(!r.is_hanging(Role::Guardian, STEADY), "that measurements come says nothing of it");
        r.works(Role::Guardian, at(0));
        assert_eq!(r.ended(Role::Guardian, killed(), true, at(1_000)), Reaction::StartsAnew);
        assert_eq!((r.due(at(1_000)), r.counts()), (Some(Role::Guardian), RestartCounts::default()));
        let mut without = restarts(&[]);
        without.works(Role::Guardian, at(0));
        assert_eq!(without.ended(Role::Guardian, killed(), true, at(1_000)), Reaction::EndsTheRun);
    }

    #[test]
    fn what_cannot_be_mended_ends_the_run() {
        let ends = |r: &mut Restarts, role, end| r.ended(role, end, true, at(5_000)) == Reaction::EndsTheRun;
        for end in [killed(), exited(1), exited(3)] {
            assert!(ends(&mut restarts(&[]), CAMERA, end), "it never worked");
            assert!(!restarts(&[]).is_hanging(CAMERA, SpanNs(0)));
        }
        for (source, end, is_final) in [
            ("synthetic", exited(1), false),
            ("synthetic", exited(4), true),
            ("synthetic", killed(), false),
            ("replay", exited(3), true),
            ("replay", killed(), false),
        ] {
            let mut r = restarts(&[&format!("camera.source={source}"), "camera.replay.folder=."]);
            r.works(CAMERA, at(0));
            assert_eq!(ends(&mut r, CAMERA, end), is_final, "{source} {end}");
        }
        let mut early = restarts(&[]);
        early.all_work(at(0));
        assert!(
            !ends(&mut early, CAMERA, killed()) && !ends(&mut early, VISION, killed()),
            "control has measurements"
        );
        let mut lockstep = restarts(&["run.clock=lockstep"]);
        lockstep.works(VISION, at(0));
        assert!(ends(&mut lockstep, VISION, killed()) && !lockstep.is_hanging(VISION, STEADY));
        let mut r = restarts(&[]);
        for role in [Role::Control, Role::Drive] {
            r.works(role, at(0));
            assert!(ends(&mut r, role, killed()), "{role}");
        }
    }
}
