//! Between the supervisor and the program of an external drive or camera: the program must not end before the arm is at rest, also when
//! the supervisor is killed.
//!
//! ```text
//! supervisor ─ starts ─► guard ─ starts ─► program
//!     dies, or asks for the end ─► guard waits until control has ended, and the guardian ─► TERM, and after a while KILL ─► program
//! ```

use super::guardian::OUTLIVES;
use super::{ProcessError, StopFlag, follow_parent};
use crate::ipc::{Instance, Role};
use crate::rt::{now, tell};
use crate::time::SpanNs;
use rustix::process::{Pid, Signal, getpid, kill_process, set_parent_process_death_signal};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::PathBuf;
use std::process::{Command, ExitStatus};
use std::time::Duration;

/// Time that a camera's program has to end by itself on request, before it is killed. Chosen by hand: less than the 0.6 s that a supervisor gives
/// its own children, and enough to close files.
const GRACE: SpanNs = SpanNs(400_000_000);
/// The same of a drive's program, which may still wait for its arm's rest. Chosen by hand: `vservo-drive-ur` waits 3 s for that, and then ends its program on
/// the robot; a robot whose states come slowly took 0.5 s.
pub(super) const GRACE_OF_DRIVE: SpanNs = SpanNs(4_000_000_000);
/// Longest time for which the guardian, which waits for the arm's rest, keeps the program from being ended after control has. Derived: a guardian that is well ends
/// before, and one that is suspended must not keep it for ever.
const GUARDED: SpanNs = SpanNs(OUTLIVES.0 + 1_000_000_000);
/// Period at which the program is looked at. Chosen by hand: a user does not notice a hundredth of a second.
const PERIOD: Duration = Duration::from_millis(5);

/// Tells the program of an external camera which one it is.
pub const CAMERA_VARIABLE: &str = "VSERVO_CAMERA";

/// The key of the run file that names the program.
pub(super) fn program_key(of_camera: bool) -> &'static str {
    if of_camera { "camera.external.command" } else { "drive.external.command" }
}

/// Runs `command` in this process's folder until it ends, or until a stop is requested and control has ended; its exit code.
///
/// # Errors
/// When the program cannot be started.
pub fn run(
    command: &[String],
    instance: &Instance,
    parent: i32,
    stop: &StopFlag,
) -> Result<u8, ProcessError> {
    follow_parent(parent, stop);
    let [program, arguments @ ..] = command else { return Ok(0) };
    let of_camera = std::env::var_os(CAMERA_VARIABLE).is_some();
    let key = program_key(of_camera);
    let grace = if of_camera { GRACE } else { GRACE_OF_DRIVE };
    let folder = std::env::current_dir().unwrap_or_default();
    let failed = |cause| ProcessError::ForeignProgram { key, program: program.clone(), folder, cause };
    let mut command = Command::new(beside_this_program(program));
    command.args(arguments);
    end_with_parent(&mut command);
    let mut child = command.spawn().map_err(failed)?;
    let (mut asked, mut over, mut told) = (None, None, false);
    loop {
        if let Ok(Some(status)) = child.try_wait() {
            // Without a supervisor whoever leaves last cleans up.
            instance.remove_leftovers(None);
            return Ok(like(status));
        }
        // Control comes to rest by itself when the supervisor dies; whoever ends the drive before ends the arm's brake.
        let is_over = stop.is_requested() && !instance.is_running(Role::Control);
        let mut guarded =
            || instance.is_running(Role::Guardian) && now() - *over.get_or_insert_with(now) < GUARDED;
        if is_over && (asked.is_some() || !guarded()) {
            let pid = Pid::from_child(&child);
            match asked {
                None => {
                    asked = Some(now());
                    let _ = kill_process(pid, Signal::TERM);
                }
                Some(at) if now() - at > grace => {
                    if !std::mem::replace(&mut told, true) {
                        tell(format_args!(
                            "{program}: does not end within {} s, and is killed",
                            grace.as_s()
                        ));
                    }
                    let _ = kill_process(pid, Signal::KILL);
                }
                Some(_) => {}
            }
        }
        std::thread::sleep(PERIOD);
    }
}

/// A program without a path that lies beside this one is meant, as `vservo-drive-ur` does wherever it is installed; others are looked for by PATH.
fn beside_this_program(program: &str) -> PathBuf {
    let own = std::env::current_exe().ok();
    let beside = own.and_then(|own| Some(own.parent()?.join(program)));
    beside.filter(|path| !program.contains('/') && path.is_file()).unwrap_or_else(|| program.into())
}

/// Ends as the program did, so that the supervisor tells the truth about it.
fn like(status: ExitStatus) -> u8 {
    if let Some(signal) = status.signal() {
        if signal == Signal::KILL.as_raw() {
            let _ = kill_process(getpid(), Signal::KILL);
        }
        return u8::try_from(128 + signal).unwrap_or(1);
    }
    status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(1)
}

/// Makes the kernel end the program when this process dies.
#[allow(unsafe_code)]
fn end_with_parent(command: &mut Command) {
    let armed = || set_parent_process_death_signal(Some(Signal::KILL)).map_err(std::io::Error::from);
    // SAFETY: between fork and exec the closure makes one system call and neither allocates nor takes a lock.
    unsafe { command.pre_exec(armed) };
}
