//! `vservo replay`.

use super::shown;
use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::process::ProcessError;
use crate::record::{ABOUT, RUN_FILE, RecordingError, RecordingReader};
use crate::replay::{self, CommandDeviation, How, MeasuredAgain, RecordedRun, ReplayError, Replayed};
use crate::robot;
use clap::{Args, ValueEnum};
use std::fmt::Write as _;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// The exit code of a replay that is not what was recorded. Chosen: that of a goal which was not reached.
const DIFFERS: u8 = 5;

/// What is done again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ReplayFrom {
    /// Vision, on the recorded frames
    Frames,
    /// Control, on the recorded measurements and joint states
    Measurements,
}

/// Arguments of `vservo replay`.
#[derive(Debug, Args)]
pub struct ReplayArguments {
    /// The recording
    #[arg(value_name = "RUN.mcap")]
    pub recording: PathBuf,
    /// What goes in again
    #[arg(long, value_enum, default_value = "measurements")]
    pub from: ReplayFrom,
    /// Change one value of the recorded run file: tells how far commands would have been from the recorded ones; may be repeated
    #[arg(long, value_name = "key.path=value")]
    pub set: Vec<String>,
}

/// Replays a recording; the exit code.
pub(super) fn replay(arguments: &ReplayArguments) -> Result<u8, ProcessError> {
    let path = &arguments.recording;
    let wrong = |cause: ReplayError| ProcessError::Replay { path: path.clone(), cause: Box::new(cause) };
    let recording = OpenRecording::open(path, &arguments.set)?;
    let (mut reader, config) = (recording.reader, &recording.config);
    let (text, is_same) = match arguments.from {
        ReplayFrom::Frames => {
            let found = replay::measure_again(&mut reader, config).map_err(wrong)?;
            (frames_text(&found), found.difference.is_none() && found.frames > 0)
        }
        ReplayFrom::Measurements => {
            let how = if arguments.set.is_empty() { How::Exactly } else { How::WithOtherSettings };
            let mut run = RecordedRun::new(reader).map_err(wrong)?;
            let found = replay::replay(&mut run, config, how).map_err(wrong)?;
            let is_same = found.difference.is_none() && found.deviations.is_empty() && found.gap.is_none();
            (control_text(&found, how) + recording.other_version.as_deref().unwrap_or_default(), is_same)
        }
    };
    Ok(shown(&text, if is_same { 0 } else { DIFFERS }))
}

/// A recording with the run file and the robot files that are in it.
pub(super) struct OpenRecording {
    pub(super) reader: RecordingReader<BufReader<File>>,
    pub(super) config: Config,
    /// A word about the version that recorded it, where that is another one.
    pub(super) other_version: Option<String>,
}

impl OpenRecording {
    /// Opens it, and changes its settings by `set`.
    pub(super) fn open(path: &Path, set: &[String]) -> Result<Self, ProcessError> {
        let wrong = |cause: ReplayError| ProcessError::Replay { path: path.into(), cause: Box::new(cause) };
        let reader = Self::reader_of(path).map_err(wrong)?;
        let robots = RobotFiles::of(&reader)?;
        let settings: Vec<_> = robots.settings.iter().chain(set).cloned().collect();
        let config = replay::recorded_config(&reader, &settings).map_err(wrong)?;
        let version = reader.metadata().get(ABOUT).and_then(|about| about.get("version"));
        let this = env!("CARGO_PKG_VERSION");
        let other_version = version.filter(|version| *version != this).map(|version| {
            format!("recorded by version {version}, replayed by {this}: what differs may be the program\n")
        });
        Ok(Self { reader, config, other_version })
    }

    /// Its reader alone.
    pub(super) fn reader_of(path: &Path) -> Result<RecordingReader<BufReader<File>>, ReplayError> {
        let file = File::open(path).map_err(RecordingError::from)?;
        Ok(RecordingReader::open(BufReader::new(file))?)
    }
}

/// The robot files of a recording where this machine has not the same, in a folder that goes when they have been read.
struct RobotFiles {
    folder: PathBuf,
    settings: Vec<String>,
}

impl RobotFiles {
    fn of<R: std::io::Read>(reader: &RecordingReader<R>) -> Result<Self, ProcessError> {
        let folder = std::env::temp_dir().join(format!("vservo-replay-{}", std::process::id()));
        let mut robots = Self { folder, settings: Vec::new() };
        let text = reader.attachments().get(RUN_FILE).cloned().unwrap_or_default();
        // what is wrong with it is told when it is validated
        let table = toml::Value::Table(String::from_utf8_lossy(&text).parse().unwrap_or_default());
        for (name, keys) in [("robot", &["robot", "model"][..]), ("scene.arm", &["scene", "arm", "model"])] {
            let model = keys.iter().try_fold(&table, |at, key| at.get(*key)).and_then(toml::Value::as_str);
            let Some(model) = model else { continue };
            let prefix = format!("{name}/");
            let recorded: Vec<_> = reader
                .attachments()
                .iter()
                .filter_map(|(file, data)| Some((file.strip_prefix(&prefix)?, data)))
                .filter(|(file, _)| !file.contains('/') && *file != "..")
                .collect();
            let here = robot::files(model).unwrap_or_default();
            let is_here = |(file, data): &(&str, &Vec<u8>)| {
                here.iter().any(|(name, text)| name == file && text.as_bytes() == data.as_slice())
            };
            if recorded.iter().all(is_here) {
                continue;
            }
            let place = robots.folder.join(name);
            let write = |path: &Path, data: &[u8]| {
                std::fs::write(path, data).map_err(|cause| ProcessError::Write { path: path.into(), cause })
            };
            std::fs::create_dir_all(&place)
                .map_err(|cause| ProcessError::Write { path: place.clone(), cause })?;
            recorded.iter().try_for_each(|(file, data)| write(&place.join(file), data))?;
            let file = model.rsplit('/').next().unwrap_or(model);
            let file = if robot::SHIPPED.contains(&file) { format!("{file}.toml") } else { file.to_owned() };
            robots.settings.push(format!("{}={:?}", keys.join("."), place.join(file).display().to_string()));
        }
        Ok(robots)
    }
}

impl Drop for RobotFiles {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder); // mostly there is none
    }
}

fn frames_text(found: &MeasuredAgain) -> String {
    let MeasuredAgain { frames, without_frame, difference } = found;
    let mut text = match difference {
        None => format!("identical: {frames} measurements\n"),
        Some(difference) => format!("differs after {} measurements: {difference}\n", frames - 1),
    };
    if *without_frame > 0 {
        // a String takes everything
        let _ = writeln!(text, "{without_frame} measurements have no frame in the recording");
    }
    text
}

fn control_text(found: &Replayed, how: How) -> String {
    let Replayed { ticks, state_hash, difference, deviations, gap, cut_off, outcomes } = found;
    let mut text = match (difference, how) {
        (Some(difference), _) => format!("differs after {} ticks: {difference}\n", ticks - 1),
        (None, How::Exactly) => format!("identical: {ticks} ticks, state_hash {state_hash}\n"),
        (None, How::WithOtherSettings) if deviations.is_empty() => {
            format!("the same commands in {ticks} ticks\n")
        }
        (None, How::WithOtherSettings) => {
            let first = deviations.iter().map(|d| d.first_tick).min().unwrap_or_default();
            format!("other commands in {ticks} ticks, from tick {first} on; where they deviate most:\n")
        }
    };
    // a String takes everything
    for CommandDeviation { field, tick, joint, recorded, replayed, .. } in deviations {
        let _ = writeln!(
            text,
            "  {field} of joint {joint} at tick {tick}: {replayed:.6}, recorded {recorded:.6}"
        );
    }
    let word = |code: u32| Outcome::from_code(code).map_or("goes on", Outcome::as_str);
    if how == How::WithOtherSettings && outcomes[0] != outcomes[1] {
        let _ = writeln!(text, "the end: {}, recorded: {}", word(outcomes[1]), word(outcomes[0]));
    }
    if let Some(gap) = gap {
        let _ = writeln!(text, "the recording cannot be followed any further: {gap}");
    }
    if let Some(why) = cut_off {
        let _ = writeln!(text, "the recording ends there, before its run: {why}");
    }
    text
}
