//! The recorder: writes down everything that the processes of an instance send, without real-time priority, and in nobody's way: what it does
//! not take in time is overwritten, and counted by its numbers. In lockstep, whose clock can wait, control waits for it.

mod black_box;
mod disk;
mod kept_blocks;
mod taps;

pub use black_box::{BlackBoxSettings, keep_the_last};
pub use taps::ServiceCount;

use super::{Membership, ProcessError, StopFlag, priority};
use crate::config::{Clock, Config};
use crate::ipc::{Instance, Role};
use crate::record::{FAILURE, RUN_FILE, RecordingWriter};
use crate::rt::{now, unix_origin};
use crate::time::{MonoNs, SpanNs};
use disk::DiskQueue;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use taps::ServiceTap;
use tracing::info;

/// Longest chunk, and so what is lost at most where a recorder is killed. Chosen by hand: 1 s is promised, and writing takes a part of it.
const MAX_CHUNK: SpanNs = SpanNs(500_000_000);
/// Bytes after which a chunk ends, whatever its time. Chosen by hand: half a second of a VGA camera at 25 Hz, so that lockstep, which may be fifty times
/// faster, needs no more memory.
const MAX_CHUNK_BYTES: usize = 4 << 20;
/// Pause after a look. Chosen by hand, against the smallest buffer, of 150 ms of frames: 100 looks a second take a part of a per cent of a core.
const PAUSE: Duration = Duration::from_millis(10);
/// The same in lockstep. Chosen by hand, because its clock is up to fifty times as fast; control waits where that is too slow.
const LOCKSTEP_PAUSE: Duration = Duration::from_micros(500);
/// How long a recording that was asked to end goes on where more and more comes. Derived: it may lag a second behind control.
const LAGS_AT_MOST: SpanNs = SpanNs(1_000_000_000);
/// Period at which it looks whether anybody is left. Chosen by hand: it costs a dozen system calls.
const PRESENCE_PERIOD: SpanNs = SpanNs(250_000_000);

/// A file that goes into a recording beside the messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedFile {
    /// Its name there.
    pub name: String,
    /// What it is, as the web calls it.
    pub media_type: &'static str,
    /// What is in it.
    pub data: Vec<u8>,
}

/// What a recording came to.
#[derive(Debug)]
pub struct FinishedRecording {
    /// The file.
    pub path: PathBuf,
    /// Length of the recording by the machine's clock.
    pub wall: SpanNs,
    /// What was recorded and lost, by service.
    pub services: Vec<ServiceCount>,
    /// Why it ended before its time.
    pub failure: Option<ProcessError>,
}

impl FinishedRecording {
    /// For people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!("recorded {:.1} s to {}\n", self.wall.as_s(), self.path.display());
        for ServiceCount { service, counter } in self.services.iter().filter(|s| s.counter.recorded > 0) {
            // a String takes everything
            let _ = writeln!(text, "  {service:<22} {:>9} recorded, {} lost", counter.recorded, counter.lost);
        }
        if self.failure.is_some() {
            text += "  of these the last second or more is not in the file, which could not be written any more\n";
        }
        text
    }

    fn facts(&self) -> BTreeMap<String, String> {
        let counts = self.services.iter().flat_map(|ServiceCount { service, counter }| {
            [
                (format!("{service}: recorded"), counter.recorded.to_string()),
                (format!("{service}: lost"), counter.lost.to_string()),
                (format!("{service}: restarts"), counter.restarts.to_string()),
            ]
        });
        counts.collect()
    }
}

/// Records the run of `instance` into `path` until a stop is requested or nobody is left, with `files` beside the messages. A disk that is full or
/// too slow ends the recording, and is told in what it came to.
///
/// # Errors
/// When the recording cannot begin, or shared memory fails.
pub fn run(
    config: &Config,
    instance: &Instance,
    stop: &StopFlag,
    path: &Path,
    files: &[RecordedFile],
) -> Result<FinishedRecording, ProcessError> {
    let membership = Membership::join(instance, Role::Recorder, config)?;
    let lockstep = config.clock == Clock::Lockstep;
    priority::prefer(config);
    let disk = DiskQueue::create(path, lockstep)?;
    let writing = disk.state();
    let mut writer = RecordingWriter::new(disk, &about(config, instance))?;
    writer.attach(RUN_FILE, "application/toml", config.to_toml()?.as_bytes())?;
    for file in files {
        writer.attach(&file.name, file.media_type, &file.data)?;
    }
    let mut taps = taps::open(config, membership.services())?;
    taps.iter_mut().try_for_each(|tap| tap.begin(&mut writer))?;
    membership.services().require_room_for_peers()?;
    // Topics and files stand in the file before the first message.
    writer.end_chunk()?;
    info!("recording to {}", path.display());
    let (start, pause) = (now(), if lockstep { LOCKSTEP_PAUSE } else { PAUSE });
    let mut presence = Presence::new(instance, start);
    let (mut chunk_end, mut asked_to_end) = (start + MAX_CHUNK, None);
    let failure = loop {
        membership.beat();
        // In this order: what was sent before the end is taken after it.
        let ends = stop.is_requested() || presence.is_over();
        let found = match take_all(&mut taps, &mut writer) {
            Ok(found) => found,
            Err(error) => break Some(error),
        };
        if let Some(ticks) = taps.iter().find_map(|tap| tap.ticks()).filter(|_| lockstep && found) {
            membership.tell_progress(ticks);
        }
        let time = now();
        if time >= chunk_end || writer.waiting_bytes() > MAX_CHUNK_BYTES {
            writer.end_chunk()?;
            chunk_end = time + MAX_CHUNK;
        }
        let failure = writing.failure();
        // All that was there when it was to end; of a run that goes on something is there at each look.
        let is_all = ends && (!found || time - *asked_to_end.get_or_insert(time) > LAGS_AT_MOST);
        if failure.is_some() || is_all {
            break failure;
        }
        // By the clock a second look would find the few records of the time that the first one took.
        if !found || !lockstep {
            std::thread::sleep(pause);
        }
    };
    let services = taps.iter().map(|tap| tap.count()).collect();
    let mut end = FinishedRecording { path: path.into(), wall: now() - start, services, failure };
    let mut facts = end.facts();
    // What control cannot know: it was told to end.
    facts.extend(instance.words_of_supervisor().map(|words| (FAILURE.to_owned(), words)));
    let closed = writer.finish(&facts)?.close();
    end.failure = end.failure.or(closed.err());
    Ok(end)
}

fn take_all<W: Write>(
    taps: &mut [Box<dyn ServiceTap<W>>],
    writer: &mut RecordingWriter<W>,
) -> Result<bool, ProcessError> {
    let mut found = false;
    for tap in taps {
        found |= tap.take_all(writer)?;
    }
    Ok(found)
}

fn about(config: &Config, instance: &Instance) -> BTreeMap<String, String> {
    let origin = match config.clock {
        Clock::Realtime => unix_origin(),
        Clock::Lockstep => SpanNs::ZERO,
    };
    let facts = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("instance", instance.to_string()),
        ("clock", config.clock_name().to_owned()),
        // what stamps count from, as time of day
        ("unix_time_of_zero_ns", origin.0.to_string()),
        ("machine", std::env::consts::ARCH.to_owned()),
    ];
    facts.map(|(key, value)| (key.to_owned(), value)).into()
}

/// Whether anybody else is in the instance.
struct Presence<'a> {
    instance: &'a Instance,
    seen: bool,
    next_look: MonoNs,
}

impl<'a> Presence<'a> {
    fn new(instance: &'a Instance, time: MonoNs) -> Self {
        Self { instance, seen: false, next_look: time }
    }

    /// Somebody was there, and nobody is any more.
    fn is_over(&mut self) -> bool {
        let time = now();
        if time < self.next_look {
            return false;
        }
        self.next_look = time + PRESENCE_PERIOD;
        let is_there = Role::all().any(|role| !role.only_records() && self.instance.is_running(role));
        self.seen |= is_there;
        self.seen && !is_there
    }
}
