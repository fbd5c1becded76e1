//! The black box: a recorder that keeps what was sent lately in memory, and writes it down when something has gone wrong.
//!
//! ```text
//! services ─► taps ─► blocks of half a second, the oldest go ──a fault, control that died, Ctrl-C──► thread: FOLDER/INSTANCE/TIME.mcap
//! ```
//! Nothing is written before that, and nobody waits for it: in lockstep, whose clock is faster, it would miss most.

use super::kept_blocks::{self, KeptServices};
use super::taps::{self, RunState};
use super::{MAX_CHUNK, PAUSE, Presence, RecordedFile, about};
use crate::config::Config;
use crate::ipc::{Instance, Role};
use crate::process::run_place::utc_name;
use crate::process::{Membership, ProcessError, StopFlag, priority};
use crate::record::{KEPT_BECAUSE, RUN_FILE};
use crate::rt::{now, unix_origin};
use crate::time::{MonoNs, SpanNs};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use tracing::{error, info, warn};

/// Memory for frames, bytes. Chosen by hand: eight seconds of a VGA camera at 25 Hz whose noise does not compress.
const ROOM_OF_FRAMES: usize = 64 << 20;
/// Memory for everything else, bytes. Measured: a minute of a UR5 takes 42 MB.
const ROOM_OF_RECORDS: usize = 256 << 20;
/// How long it goes on after a fault, so that the way to rest is in it. Chosen by hand: arms come to rest within a second.
const AFTERWARDS: SpanNs = SpanNs(1_500_000_000);
/// Files that are kept of an instance, so that an arm that faults again and again fills no disk. Chosen by hand.
const FILES: usize = 10;

/// What it is written for, in the words of its file.
const A_FAULT: &str = "there was a fault";
const CONTROL_DIED: &str = "the control process died";

/// What a black box keeps, and where.
#[derive(Debug, Clone)]
pub struct BlackBoxSettings {
    /// How much it keeps.
    pub last: SpanNs,
    /// The folder, in which each instance has one of its own.
    pub folder: PathBuf,
    /// Whether it writes down what it has when it is told to end.
    pub writes_at_stop: bool,
}

/// Keeps the last of what is sent in `instance` until a stop is requested or nobody is left, and writes it down, with `files` beside the messages, at each fault.
///
/// # Errors
/// When it cannot begin, or shared memory fails. A file that cannot be written is told, and ends nothing.
pub fn keep_the_last(
    config: &Config,
    instance: &Instance,
    stop: &StopFlag,
    settings: &BlackBoxSettings,
    files: Vec<RecordedFile>,
) -> Result<(), ProcessError> {
    let membership = Membership::join(instance, Role::BlackBox, config)?;
    priority::prefer(config);
    let folder = settings.folder.join(instance.to_string());
    std::fs::create_dir_all(&folder).map_err(|cause| ProcessError::Write { path: folder.clone(), cause })?;
    let run_file = config.to_toml()?.into_bytes();
    let mut all =
        vec![RecordedFile { name: RUN_FILE.into(), media_type: "application/toml", data: run_file }];
    all.extend(files);
    let start = now();
    let (frames, records) =
        taps::open(config, membership.services())?.into_iter().partition(|tap| tap.takes_frames());
    let mut tracks = [
        KeptServices::new(records, (settings.last, ROOM_OF_RECORDS), start)?,
        KeptServices::new(frames, (settings.last, ROOM_OF_FRAMES), start)?,
    ];
    membership.services().require_room_for_peers()?;
    info!(
        "black box: the last {:.0} s are kept in memory, and written to {} at a fault",
        settings.last.as_s(),
        folder.display()
    );
    let mut files = Files { folder, about: about(config, instance), attached: all, writing: None };
    let mut presence = Presence::new(instance, start);
    let mut watch = FaultWatch::default();
    let mut block_end = start + MAX_CHUNK;
    loop {
        membership.beat();
        let is_stopped = stop.is_requested();
        // In this order, as in a recording: what control sent before it went is taken after this.
        let has_control = instance.is_running(Role::Control);
        let is_over = presence.is_over();
        for track in &mut tracks {
            track.take_all()?;
        }
        let time = now();
        let state = tracks.iter().flat_map(KeptServices::taps).find_map(|tap| tap.run_state());
        watch.look(state, has_control, time);
        let ends = is_stopped || is_over;
        let why =
            watch.due(time, ends).or((is_stopped && settings.writes_at_stop).then_some("it was asked to"));
        if why.is_some() || time >= block_end {
            tracks.iter_mut().try_for_each(|track| track.end_block(time))?;
            block_end = time + MAX_CHUNK;
        }
        if let Some(why) = why {
            files.write(why, &tracks);
        }
        files.look();
        if ends {
            files.wait();
            return Ok(());
        }
        std::thread::sleep(PAUSE);
    }
}

/// Notices what is to be written down.
#[derive(Debug, Default)]
struct FaultWatch {
    before: Option<RunState>,
    /// Whether there was a control process, or a trace of it, whose end is not told yet.
    control_ran: bool,
    /// Why, and when.
    due: Option<(&'static str, MonoNs)>,
}

impl FaultWatch {
    /// Takes in where the run stands at `time`, and whether there was a control process just before.
    fn look(&mut self, state: Option<RunState>, has_control: bool, time: MonoNs) {
        let had_fault = self.before.is_some_and(|before| before.has_fault);
        if state.is_some_and(|state| state.has_fault) && !had_fault {
            self.due.get_or_insert((A_FAULT, time + AFTERWARDS));
        }
        let is_over = state.is_some_and(|state| state.is_over);
        if !has_control && std::mem::take(&mut self.control_ran) && !is_over {
            self.due.get_or_insert((CONTROL_DIED, time));
        }
        // One that begins to count its traces has come after that look, and may be gone at the next; later numbers may be what a dead one left.
        let begins = state.is_some_and(|s| self.before.is_none_or(|before| s.sequence < before.sequence));
        self.control_ran |= has_control || begins;
        self.before = state;
    }

    /// Why to write at `time`, once; where it `ends`, at once.
    fn due(&mut self, time: MonoNs, ends: bool) -> Option<&'static str> {
        let (why, _) = self.due.take_if(|(_, at)| ends || time >= *at)?;
        Some(why)
    }
}

/// The files that are written.
struct Files {
    folder: PathBuf,
    about: BTreeMap<String, String>,
    attached: Vec<RecordedFile>,
    writing: Option<JoinHandle<()>>,
}

impl Files {
    /// Begins to write what the tracks keep, because of `why`; after what is being written.
    fn write(&mut self, why: &'static str, tracks: &[KeptServices]) {
        self.wait();
        let path = free_path(&self.folder);
        let blocks = tracks.iter().flat_map(KeptServices::kept).cloned().collect();
        let lost = tracks.iter().flat_map(KeptServices::taps).map(|tap| tap.count());
        let lost = lost.map(|count| (format!("{}: lost", count.service), count.counter.lost.to_string()));
        let end = lost.chain([(KEPT_BECAUSE.to_owned(), why.to_owned())]).collect();
        let (about, attached) = (self.about.clone(), self.attached.clone());
        let write = move || {
            match kept_blocks::write(&path, &about, &attached, blocks, end) {
                Ok(()) => warn!("black box: {why}: what was before is in {}", path.display()),
                Err(error) => error!("black box: {why}, and what was before is lost: {error}"),
            }
            path.parent().into_iter().for_each(remove_oldest);
        };
        match std::thread::Builder::new().name("black-box-file".into()).spawn(write) {
            Ok(thread) => self.writing = Some(thread),
            Err(error) => error!("black box: {why}, and no thread can be had to write it down: {error}"),
        }
    }

    /// Forgets a thread that is done.
    fn look(&mut self) {
        if self.writing.as_ref().is_some_and(JoinHandle::is_finished) {
            self.wait();
        }
    }

    /// Waits until all is written.
    fn wait(&mut self) {
        if self.writing.take().is_some_and(|thread| thread.join().is_err()) {
            error!("black box: the thread that writes it down panicked");
        }
    }
}

/// A name in `folder` that is the time of day in UTC, and that no file has yet.
fn free_path(folder: &Path) -> PathBuf {
    let name = utc_name((now() + unix_origin()).0.div_euclid(SpanNs::MILLISECOND.0 * 1000));
    let numbered =
        |n: u32| folder.join(if n == 1 { format!("{name}.mcap") } else { format!("{name}-{n}.mcap") });
    (1..).map(numbered).find(|path| !path.exists()).unwrap_or_else(|| numbered(1))
}

/// Removes the oldest files of a black box in `folder` beyond those that are kept.
fn remove_oldest(folder: &Path) {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut ours: Vec<_> = entries.map(|e| e.path()).filter(|path| is_ours(path)).collect();
    ours.sort();
    let count = ours.len().saturating_sub(FILES);
    for path in ours.into_iter().take(count) {
        let _ = std::fs::remove_file(path); // one that stays is removed after the next fault
    }
}

/// Whether a file has such a name as [`free_path`] gives.
fn is_ours(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let form = utc_name(0);
    let begin = name.get(..form.len()).unwrap_or_default();
    let is_time = begin.len() == form.len()
        && begin
            .chars()
            .zip(form.chars())
            .all(|(c, f)| if f.is_ascii_digit() { c.is_ascii_digit() } else { c == f });
    is_time && name.ends_with(".mcap")
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: MonoNs = MonoNs(5_000_000_000);

    fn state(has_fault: bool, is_over: bool) -> Option<RunState> {
        Some(RunState { sequence: 7, has_fault, is_over })
    }

    #[test]
    fn each_fault_is_written_down_once_and_with_its_end() {
        let mut watch = FaultWatch::default();
        let late = T + AFTERWARDS;
        watch.look(None, false, T);
        watch.look(state(false, false), true, T);
        assert_eq!(watch.due(late, false), None);
        watch.look(state(true, false), true, T);
        assert_eq!(watch.due(T, false), None, "the arm still brakes");
        watch.look(state(true, false), true, late);
        assert_eq!((watch.due(late, false), watch.due(late, false)), (Some("there was a fault"), None));
        // After a reset another one.
        watch.look(state(false, false), true, late);
        watch.look(state(true, false), true, late);
        assert_eq!(watch.due(late, true), Some("there was a fault"), "the run ends before");
    }

    #[test]
    fn control_that_goes_before_its_end_died() {
        for (is_over, why) in [(true, None), (false, Some("the control process died"))] {
            let mut watch = FaultWatch::default();
            watch.look(state(false, is_over), true, T);
            watch.look(state(false, is_over), false, T);
            assert_eq!(watch.due(T, false), why);
            watch.look(state(false, is_over), false, T);
            assert_eq!(watch.due(T, false), None, "told once");
        }
    }

    #[test]
    fn control_that_came_and_went_between_two_looks_died() {
        let mut watch = FaultWatch::default();
        let trace = |sequence| Some(RunState { sequence, has_fault: false, is_over: false });
        watch.look(None, false, T);
        for life in 0..2 {
            watch.look(trace(3), false, T);
            assert_eq!(watch.due(T, false), None, "{life}: it came after the look");
            watch.look(trace(8), false, T);
            assert_eq!(watch.due(T, false), Some("the control process died"), "{life}");
            watch.look(trace(9), false, T);
            watch.look(trace(9), false, T);
            assert_eq!(watch.due(T, false), None, "{life}: what it left is no other one");
        }
    }

    #[test]
    fn the_newest_files_stay_and_those_of_others() {
        let folder = tempfile::tempdir().unwrap();
        let named = |name: &str| folder.path().join(name);
        let made: Vec<_> =
            (0..FILES as i64 + 3).map(|day| format!("{}.mcap", utc_name(day * 86_400))).collect();
        for name in made.iter().map(String::as_str).chain(["mine.mcap", "0000-notes.mcap"]) {
            std::fs::write(named(name), "").unwrap();
        }
        remove_oldest(folder.path());
        let (gone, kept) = made.split_at(3);
        assert!(
            gone.iter().all(|name| !named(name).exists()) && kept.iter().all(|name| named(name).exists())
        );
        assert!(named("mine.mcap").exists() && named("0000-notes.mcap").exists());
        let first = free_path(folder.path());
        std::fs::write(&first, "").unwrap();
        assert!(is_ours(&first) && free_path(folder.path()) != first);
    }
}
