//! Control's connection to an arm that was recorded.
//!
//! ```text
//! lockstep:   recording ─► MotionReader ─► RecordedDrive::read
//! real time:  recording ─► MotionReader ─► thread ─ring─► RecordedDrive::read
//! ```

use super::motion_reader::MotionReader;
use crate::config::{Clock, Config, DriveKind};
use crate::drive::{NextState, RecordedDrive, RecordedMotion};
use crate::process::open_recording::warning_of_cut;
use crate::process::{OpenRecording, ProcessError};
use crate::replay::ReplayError;
use nalgebra::SVector;
use rtrb::{Consumer, Producer, RingBuffer};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// States that are read ahead: two seconds, so that a disk that is slow for a moment makes none late. Chosen by hand.
const AHEAD: usize = 2048;
/// Pause of the thread that reads ahead, where its ring is full. Chosen by hand: a hundredth of what the ring holds.
const PAUSE: Duration = Duration::from_millis(20);
/// The same before the first tick, until it has read ahead. Chosen by hand: a moment that nobody notices.
const FIRST_PAUSE: Duration = Duration::from_millis(1);
/// So often at most: a disk that hangs for five seconds is told by late states, and stops no run from being ended. Chosen by hand.
const FIRST_PAUSES: u32 = 5000;

type Reader = MotionReader<BufReader<File>>;

/// The drive of a configuration whose arm was recorded; `None` where it is another one.
pub(super) fn open<const N: usize>(config: &Config) -> Result<Option<RecordedDrive<N>>, ProcessError> {
    if config.drive.kind != DriveKind::Replay {
        return Ok(None);
    }
    let motion = motion(config, &config.drive.recording)?;
    let motion: Box<dyn RecordedMotion> = match config.clock {
        Clock::Lockstep => Box::new(motion),
        Clock::Realtime => Box::new(ReadAhead::begin(motion)?),
    };
    let q_start: SVector<f64, N> = crate::config::assemble::q_start(config)?;
    Ok(Some(RecordedDrive::new(motion, q_start)))
}

/// The motion in the recording at `path`, whose arm must be that of the run.
fn motion(config: &Config, path: &Path) -> Result<Reader, ProcessError> {
    let wrong =
        |cause: ReplayError| ProcessError::DriveRecording { path: path.into(), what: cause.to_string() };
    let told = |what: String| ProcessError::DriveRecording { path: path.into(), what };
    let ours: Vec<&str> = config.robot.joints.iter().map(|joint| joint.name.as_str()).collect();
    // A run file of another version tells no names: then the number of joints is compared alone.
    let reader = match OpenRecording::open(path, &[]) {
        Ok(recording) => {
            let theirs: Vec<&str> =
                recording.config.robot.joints.iter().map(|joint| joint.name.as_str()).collect();
            if theirs != ours {
                let (theirs, ours) = (theirs.join(", "), ours.join(", "));
                return Err(told(format!(
                    "its arm has the joints {theirs}; that of the run file has {ours}: name the recorded arm in robot.model"
                )));
            }
            recording.reader
        }
        Err(_) => OpenRecording::reader_of(path).map_err(wrong)?.telling_of_cut(warning_of_cut(path)),
    };
    let motion = MotionReader::new(reader).map_err(wrong)?;
    let motion =
        motion.ok_or_else(|| told("has no /control/joint_state: the arm's motion is not in it".into()))?;
    if motion.joints() as usize != ours.len() {
        let (theirs, ours) = (motion.joints(), ours.len());
        return Err(told(format!(
            "its arm has {theirs} joints, that of the run file {ours}: name the recorded arm in robot.model"
        )));
    }
    Ok(motion)
}

/// What a thread of its own reads ahead, so that the real-time thread touches no file.
struct ReadAhead {
    states: Consumer<NextState>,
    is_over: bool,
}

impl ReadAhead {
    /// Reads ahead before it returns, so that the first ticks miss nothing.
    fn begin(motion: Reader) -> Result<Self, ProcessError> {
        let (read, states) = RingBuffer::new(AHEAD);
        let thread =
            thread::Builder::new().name("drive-recording".into()).spawn(move || read_on(motion, read));
        let thread: JoinHandle<()> = thread
            .map_err(|cause| ProcessError::Start { what: "the reader of the arm's recording", cause })?;
        for _ in 0..FIRST_PAUSES {
            if states.slots() == AHEAD || thread.is_finished() {
                break;
            }
            thread::sleep(FIRST_PAUSE);
        }
        Ok(Self { states, is_over: false })
    }
}

/// Reads to the end of the recording, or until nobody wants any more of it.
fn read_on(mut motion: Reader, mut states: Producer<NextState>) {
    loop {
        let next = motion.next_state();
        while states.is_full() {
            if states.is_abandoned() {
                return;
            }
            thread::sleep(PAUSE);
        }
        let _ = states.push(next); // there is room
        if next == NextState::Over || states.is_abandoned() {
            return;
        }
    }
}

impl RecordedMotion for ReadAhead {
    fn next_state(&mut self) -> NextState {
        if self.is_over {
            return NextState::Over;
        }
        let next = self.states.pop().unwrap_or(NextState::Late);
        self.is_over = next == NextState::Over;
        next
    }
}
