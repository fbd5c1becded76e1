//! `vservo replay`.

use super::shown;
use crate::control::outcome::Outcome;
use crate::process::{OpenRecording, ProcessError};
use crate::replay::{self, CommandDeviation, How, MeasuredAgain, RecordedRun, ReplayError, Replayed};
use crate::robot::joint_in_words;
use clap::{Args, ValueEnum};
use std::fmt::Write as _;
use std::path::PathBuf;

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
            (
                control_text(&found, how, &config.robot.joint_names())
                    + recording.other_version.as_deref().unwrap_or_default(),
                is_same,
            )
        }
    };
    Ok(shown(&text, if is_same { 0 } else { DIFFERS }))
}

fn frames_text(found: &MeasuredAgain) -> String {
    let MeasuredAgain { frames, without_frame, difference } = found;
    let mut text = match difference {
        None if *frames == 0 => {
            "no measurement has its frame in the recording: there is nothing to compare\n".to_owned()
        }
        None => format!("identical: {frames} measurements\n"),
        Some(difference) => format!("differs after {} measurements: {difference}\n", frames - 1),
    };
    if *without_frame > 0 {
        // a String takes everything
        let _ = writeln!(text, "{without_frame} measurements have no frame in the recording");
    }
    text
}

fn control_text(found: &Replayed, how: How, names: &[String]) -> String {
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
            "  {field} of {} at tick {tick}: {replayed:.6}, recorded {recorded:.6}",
            joint_in_words(names, joint - 1)
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
