//! `vservo camera check`: what the camera of a run file does wrong, measured.

use crate::cli::camera_arguments::CameraCheckArguments;
use crate::cli::{json, seen_by, shown};
use crate::config::{CameraProgram, Config, Source};
use crate::input::printable;
use crate::ipc::{Instance, Role};
use crate::messages::CameraId;
use crate::process::camera::SharedImages;
use crate::process::drive_guard::CAMERA_VARIABLE;
use crate::process::{Membership, ProcessError, StopFlag};
use crate::rt::{kill_with_group, now, tell};
use crate::source::v4l2::{Probe, SourceCheck, Spread};
use crate::source::{self, AnySource, FreeRunningSource};
use crate::time::SpanNs;
use serde::Serialize;
use std::os::fd::AsFd;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};

/// Longest wait for the first image of a program. Chosen by hand: one in Python takes seconds to load its libraries.
const FIRST_IMAGE: SpanNs = SpanNs(15_000_000_000);

const NOTHING_TO_CHECK: ProcessError =
    ProcessError::NoRealCamera { instead: "\"external\" or \"v4l2\", with the table of that name" };

/// The answer, for programs.
#[derive(Debug, Serialize)]
struct CheckedSource {
    #[serde(flatten)]
    check: SourceCheck,
    wrong: Vec<String>,
}

/// Measures the camera, and tells what it does wrong; exit code 3 where there is something.
pub(super) fn check(arguments: &CameraCheckArguments) -> Result<u8, ProcessError> {
    super::require_duration(arguments.duration_s)?;
    let config = Config::load(arguments.config.as_deref(), &arguments.set)?;
    let config = seen_by(arguments.camera, config)?;
    let stop = StopFlag::on_signals()?;
    let measured = match &config.camera.source {
        Source::Synthetic { .. } | Source::Replay { .. } => return Err(NOTHING_TO_CHECK),
        Source::V4l2(_) => match source::open(&config)? {
            AnySource::FreeRunning(mut camera) => {
                measure(&config, camera.as_mut(), &mut CheckedProgram::default(), (arguments, &stop))?
            }
            AnySource::Scheduled(_) => return Err(NOTHING_TO_CHECK),
        },
        Source::External(program) => external(&config, program, arguments, &stop)?,
    };
    let wrong = wrongs(&measured, &config);
    let code = if wrong.is_empty() { 0 } else { 3 };
    let text = if arguments.json {
        json(&CheckedSource { check: measured, wrong })
    } else {
        described(&measured, &wrong)
    };
    Ok(shown(&text, code))
}

/// The program of an external camera, through the instance that a run would have.
fn external(
    config: &Config,
    program: &CameraProgram,
    arguments: &CameraCheckArguments,
    stop: &StopFlag,
) -> Result<SourceCheck, ProcessError> {
    let instance: Instance = arguments.instance.parse()?;
    let id = config.camera.id;
    let membership = Membership::join(&instance, Role::Camera(id), config)?;
    let services = membership.services();
    let link = SharedImages { ports: services.image_ports(id)?, services };
    let mut camera = source::open_external(config, link);
    let mut started = CheckedProgram::start(program, &instance, id)?;
    let measured = measure(config, camera.as_mut(), &mut started, (arguments, stop));
    drop(started);
    drop(camera);
    drop(membership);
    instance.remove_leftovers(None);
    if instance.directory().exists() {
        let name = printable(&instance.to_string());
        tell(format_args!(
            "vservo: a camera program of instance `{name}` goes on, with its files in /dev/shm: what it leaves there the next run or check of this instance removes"
        ));
    }
    measured
}

/// The program of an external camera while it is measured, if it was started here; ended when dropped.
#[derive(Debug, Default)]
struct CheckedProgram(Option<(String, Child)>);

impl CheckedProgram {
    fn start(program: &CameraProgram, instance: &Instance, camera: CameraId) -> Result<Self, ProcessError> {
        let [name, arguments @ ..] = program.command.as_slice() else { return Ok(Self::default()) };
        let failed = |cause| ProcessError::ForeignProgram {
            key: "camera.external.command",
            program: name.clone(),
            folder: program.folder.clone(),
            cause,
        };
        let child = Command::new(name)
            .args(arguments)
            .current_dir(&program.folder)
            .envs(instance.environment())
            .env(CAMERA_VARIABLE, camera.to_string())
            .stdin(Stdio::null())
            // So that all that it starts, as a script does, ends with it; Ctrl-C comes to this process, which ends it.
            .process_group(0)
            // stdout belongs to the answer
            .stdout(std::io::stderr().as_fd().try_clone_to_owned().map_err(failed)?)
            .spawn()
            .map_err(failed)?;
        Ok(Self(Some((name.clone(), child))))
    }

    /// The error that it has ended, and how; `None` while it runs.
    fn ended(&mut self) -> Option<ProcessError> {
        let (program, child) = self.0.as_mut()?;
        let status = child.try_wait().ok().flatten()?;
        Some(ProcessError::CameraProgramEnded { program: program.clone(), status })
    }
}

impl Drop for CheckedProgram {
    fn drop(&mut self) {
        if let Some((_, child)) = &mut self.0 {
            kill_with_group(child);
        }
    }
}

fn measure(
    config: &Config,
    camera: &mut dyn FreeRunningSource,
    program: &mut CheckedProgram,
    (arguments, stop): (&CameraCheckArguments, &StopFlag),
) -> Result<SourceCheck, ProcessError> {
    let i = config.camera.model.intrinsics();
    let pixels = i.width_px as usize * i.height_px as usize;
    let mut probe = Probe::new(config.camera.rate_hz, pixels, now());
    let (mut begin, duration) = (now(), SpanNs::from_s(arguments.duration_s));
    let none = |waited: SpanNs| ProcessError::NoFrame {
        device: format!("camera {}", config.camera.id),
        waited_s: waited.as_s(),
    };
    while !stop.is_requested() {
        let first = probe.frames() == 0;
        // Looked for before: the last image of one that has ended may wait.
        let ended = program.ended();
        probe.take(camera, &mut now)?;
        let past = now() - begin;
        match (first, probe.frames() == 0) {
            (true, false) => begin = now(),
            (true, true) => match ended {
                Some(ended) => return Err(ended),
                None if past > FIRST_IMAGE => return Err(none(past)),
                None => {}
            },
            // What gives nothing any more is not measured to the end.
            (false, _) if past > duration || ended.is_some() && camera.health().state.is_away() => break,
            _ => {}
        }
    }
    probe.check(&camera.health(), now()).ok_or_else(|| none(now() - begin))
}

/// What is wrong, and how to mend it.
fn wrongs(c: &SourceCheck, config: &Config) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut say = |is_so: bool, text: String| {
        if is_so {
            wrong.push(text);
        }
    };
    let (expected, camera) = (c.frames + c.lost, &config.camera);
    let elsewhere = c.lost.saturating_sub(c.corrupt + c.superseded + c.undated);
    let silent = c.silent.min(elsewhere);
    say(
        c.lost > 0,
        format!(
            "{} of {expected} frames were lost: {} damaged or of another kind, {} together with a newer one, {} without a \
             possible stamp, {} missing in the source's own count, {silent} in a silence at the end",
            c.lost,
            c.corrupt,
            c.superseded,
            c.undated,
            elsewhere - silent
        ),
    );
    if let Some(away) = c.away {
        let s = c.silent as f64 / c.asked_hz;
        say(
            true,
            format!(
                "it has stopped: it is {away}, and gave no usable frame for the last {s:.1} of {:.1} s",
                c.duration_s
            ),
        );
    }
    let odd = &c.odd_headers;
    for (count, why) in [
        (
            odd.sequence,
            "a `sequence` that stands still, goes back or leaps, by which lost images are not seen: it counts exposures",
        ),
        (
            odd.exposure,
            "an `exposure_span_ns` longer than a period: it is the length of the exposure in ns, or 0",
        ),
        (
            odd.reserved,
            "`flags` or `reserved` that are not zero, which a later version may give a meaning: set them to 0",
        ),
    ] {
        say(count > 0, format!("{count} images have {why}"));
    }
    say(
        // chosen by hand, as a running camera tells it
        (c.obtained_hz - c.asked_hz).abs() > 0.05 * c.asked_hz,
        format!(
            "it gives {:.1} frames a second, camera.rate_hz says {}; set the one or the other",
            c.obtained_hz, c.asked_hz
        ),
    );
    say(
        c.stamps_clamped > 0,
        format!(
            "{} stamps lie in the future: a stamp is the middle of the exposure, by CLOCK_MONOTONIC",
            c.stamps_clamped
        ),
    );
    say(
        c.stamps_doubted,
        "its stamps cannot be used (missing, going back, or of another clock): frames are dated by their arrival; \
         `vservo calibrate latency` finds the constant part of that error"
            .into(),
    );
    say(c.interrupted > 0, format!("it was silent and came back, {} times", c.interrupted));
    let period_ms = 1e3 / c.asked_hz;
    // Chosen by hand: with half a period frames change places in time.
    say(
        c.jitter.p99_ms > 0.5 * period_ms,
        format!("its stamps jitter by {:.1} ms; a period has {period_ms:.1} ms", c.jitter.p99_ms),
    );
    // A frame's arrival decides when the loop is told to be blind: one period more than expected is what check allows for.
    let expected_ms = camera.latency.as_s() * 1e3;
    say(
        c.latency.p50_ms > expected_ms + period_ms,
        format!(
            "frames are {:.1} ms old when they come, camera.latency_ms says {expected_ms}; set it to what is measured",
            c.latency.p50_ms
        ),
    );
    wrong
}

fn described(c: &SourceCheck, wrong: &[String]) -> String {
    let spread = |s: &Spread| {
        format!("{:.2} ms, 99 of 100 within {:.2} ms, at most {:.2} ms", s.p50_ms, s.p99_ms, s.max_ms)
    };
    let mut lines = vec![
        format!("rate     {:.2} Hz; camera.rate_hz {}", c.obtained_hz, c.asked_hz),
        format!("frames   {} in {:.1} s, lost {}", c.frames, c.duration_s, c.lost),
        format!("jitter   {}", spread(&c.jitter)),
        format!("latency  {}", spread(&c.latency)),
    ];
    if wrong.is_empty() {
        lines.push("nothing is wrong".into());
    }
    lines.extend(wrong.iter().map(|line| format!("wrong: {line}")));
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;

    #[test]
    fn what_a_camera_script_has_started_ends_with_the_check() {
        let folder = tempfile::tempdir().unwrap();
        let (begun, acted) = (folder.path().join("begun"), folder.path().join("acted"));
        let script = format!(
            "(echo $$ > {begun}; sleep 1; echo acts > {acted}) & wait",
            begun = begun.display(),
            acted = acted.display()
        );
        let command = ["sh".to_owned(), "-c".to_owned(), script].to_vec();
        let give_up = SpanNs::from_s(1.0);
        let program = CameraProgram { command, folder: folder.path().to_owned(), give_up };
        let instance: Instance = format!("check-group-{}", std::process::id()).parse().unwrap();
        let mut started = CheckedProgram::start(&program, &instance, CameraId::FIRST).unwrap();
        while !begun.exists() {
            assert!(started.ended().is_none());
            std::thread::sleep(Duration::from_millis(5));
        }
        drop(started);
        std::thread::sleep(Duration::from_millis(1500));
        assert!(!acted.exists(), "a grandchild went on");
    }
}
