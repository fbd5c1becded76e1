//! Drives of robots in C and C++: the functions of `include/vservo_drive.h`, which says what each promises, over the transport that drives in Rust use.
//!
//! ```text
//! maker's program ─ vservo_drive.h ─► lib.rs: pointers checked, no panic out ─► drive.rs: ports, counts, checks ─► vservo::ipc
//! ```
//! It allocates when a handle is opened and where something fails; what the transport allocates in a send is counted by a test (`tests/allocations.rs`).

// A C ABI is pointers of a caller: this crate alone of the workspace besides those of the transport itself has reason for it, told at each block.
#![allow(unsafe_code)]

mod drive;
mod failure;

use drive::DrivePorts;
pub use failure::ErrorCode;
use failure::{Failure, guarded, last_words, text_of, utf8_of};
use std::cell::UnsafeCell;
use std::ffi::CString;
use std::os::raw::c_char;
use std::os::unix::ffi::OsStrExt;
use std::ptr::{null, null_mut};
use std::slice;
use std::thread::ThreadId;
use vservo::messages::{DriveCommandMsg, DriveStateMsg, MAX_JOINTS};
use vservo::rt::{now, sleep_until};
use vservo::time::MonoNs;

/// Behind `vservo_drive`.
#[derive(Debug)]
pub struct DriveHandle {
    /// Ports belong to the thread that made them.
    owner: ThreadId,
    config: CString,
    /// Changed by the owner alone, in one call at a time.
    ports: UnsafeCell<DrivePorts>,
}

/// Uses the handle of a caller: a code for it, also where there is none, where it is another thread's, and after a panic, which leaves the handle unusable.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed.
unsafe fn with_drive(
    drive: *const DriveHandle,
    work: impl FnOnce(&mut DrivePorts) -> Result<i32, Failure>,
) -> i32 {
    let used = || {
        // SAFETY: the caller promises that it is null or alive. What is read of it here by any thread never changes.
        let handle = unsafe { drive.as_ref() }.ok_or_else(|| Failure::argument("the handle is NULL"))?;
        if std::thread::current().id() != handle.owner {
            let words = "a handle is used by the thread that opened it, and by no other".into();
            return Err(Failure { code: ErrorCode::Thread, words });
        }
        // SAFETY: this is the owner's thread, and no function here calls another one back, so that nobody else has the ports now.
        unsafe { &mut *handle.ports.get() }.used(work)
    };
    guarded(used, |code| code as i32)
}

/// # Safety
/// `record` is null, or leads to such a record.
unsafe fn record_of<T: Copy>(record: *const T, what: &str) -> Result<T, Failure> {
    if record.is_null() || !record.is_aligned() {
        return Err(Failure::argument(format!("the {what} is NULL, or not aligned")));
    }
    // SAFETY: it is neither null nor misaligned, and holds numbers alone, for which every content is valid; the caller promises the rest.
    Ok(unsafe { record.read() })
}

/// Why the last function that failed in this thread did.
#[unsafe(no_mangle)]
pub extern "C" fn vservo_drive_last_error() -> *const c_char {
    last_words()
}

/// Joins an instance.
///
/// # Safety
/// `instance` is null or a text; the others are texts or null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_open_with(
    instance: *const c_char,
    command_type: *const c_char,
    state_type: *const c_char,
    text_type: *const c_char,
) -> *mut DriveHandle {
    let open = || {
        // SAFETY: the caller promises texts, or null, which is refused.
        let types = unsafe {
            (
                utf8_of(command_type, "command_type")?,
                utf8_of(state_type, "state_type")?,
                utf8_of(text_type, "text_type")?,
            )
        };
        drive::require_types(types.0, types.1, types.2)?;
        // SAFETY: the caller promises a text, or null.
        let instance = unsafe { instance_named(instance) }?;
        let config = CString::new(instance.config_path().as_os_str().as_bytes()).unwrap_or_default();
        let ports = UnsafeCell::new(DrivePorts::open(instance)?);
        Ok(Box::into_raw(Box::new(DriveHandle { owner: std::thread::current().id(), config, ports })))
    };
    guarded(open, |_| null_mut())
}

/// # Safety
/// `instance` is null or a text.
unsafe fn instance_named(instance: *const c_char) -> Result<vservo::ipc::Instance, Failure> {
    if instance.is_null() {
        return drive::instance_of(None);
    }
    // SAFETY: it is not null, and the caller promises a text.
    drive::instance_of(Some(unsafe { utf8_of(instance, "the instance") }?))
}

/// Leaves, and frees the handle.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_close(drive: *mut DriveHandle) -> i32 {
    // SAFETY: the caller promises what is needed there.
    let answer = unsafe { with_drive(drive, |_| Ok(0)) };
    if answer != 0 {
        return answer;
    }
    let close = || {
        // SAFETY: made by `Box::into_raw` in `vservo_drive_open_with`, not null, of this thread, and by the caller's promise not closed before.
        unsafe { Box::from_raw(drive) }.ports.into_inner().close();
        Ok(0)
    };
    guarded(close, |code| code as i32)
}

/// Path of the run file in effect.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_config_path(drive: *const DriveHandle) -> *const c_char {
    // SAFETY: the caller promises that it is null or alive; the path never changes, so that any thread may read it.
    unsafe { drive.as_ref() }.map_or(null(), |drive| drive.config.as_ptr())
}

/// Waits for a command.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_wait(drive: *mut DriveHandle, longest_ns: i64) -> i32 {
    // SAFETY: the caller promises what is needed there.
    unsafe { with_drive(drive, |drive| Ok(drive.wait(longest_ns)?.into())) }
}

/// Takes the next command.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed; `command` is null, or leads to room for a record.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_receive(drive: *mut DriveHandle, command: *mut DriveCommandMsg) -> i32 {
    let receive = |drive: &mut DrivePorts| {
        if command.is_null() || !command.is_aligned() {
            return Err(Failure::argument("the command is NULL, or not aligned"));
        }
        let Some(received) = drive.receive()? else { return Ok(0) };
        // SAFETY: it is neither null nor misaligned, and the caller promises room for a record, whose size its compiler has held against vservo.h.
        unsafe { command.write(received) };
        Ok(1)
    };
    // SAFETY: the caller promises what is needed there.
    unsafe { with_drive(drive, receive) }
}

/// Whether a drive of so many joints may obey the command.
///
/// # Safety
/// `command` is null, or leads to a record.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_is_valid_command(command: *const DriveCommandMsg, joints: u32) -> i32 {
    // SAFETY: the caller promises what is needed there.
    let check = || Ok(drive::is_valid_command(&unsafe { record_of(command, "command") }?, joints).into());
    guarded(check, |code| code as i32)
}

/// Sends a state.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed; `state` is null, or leads to a record.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_send(drive: *mut DriveHandle, state: *const DriveStateMsg) -> i32 {
    // SAFETY: the caller promises what is needed in both.
    unsafe { with_drive(drive, |drive| drive.send(record_of(state, "state")?).map(|()| 0)) }
}

/// Tells the names of the joints.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed; `names` is null, or leads to `joints` texts, each of which may be null; `signs` and `zero_offsets` are
/// null, or lead to `joints` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_send_joint_names(
    drive: *mut DriveHandle,
    names: *const *const c_char,
    joints: u32,
    signs: *const f64,
    zero_offsets: *const f64,
) -> i32 {
    let send = |drive: &mut DrivePorts| {
        let n = joints as usize;
        if names.is_null() || n == 0 || n > MAX_JOINTS {
            return Err(Failure::argument(format!(
                "names of {n} joints, or NULL; there are 1 to {MAX_JOINTS}"
            )));
        }
        let mut texts = [""; MAX_JOINTS];
        // SAFETY: it is not null, and the caller promises so many texts; `n` was bounded.
        for (to, from) in texts.iter_mut().zip(unsafe { slice::from_raw_parts(names, n) }) {
            // SAFETY: the caller promises a text, or null, which is refused.
            *to = unsafe { utf8_of(*from, "the name of a joint") }?;
        }
        // SAFETY: null is taken for none, and the caller promises so many numbers.
        let numbers = |list: *const f64| (!list.is_null()).then(|| unsafe { slice::from_raw_parts(list, n) });
        let texts = texts.get(..n).unwrap_or_default();
        drive.send_joint_names(texts, numbers(signs), numbers(zero_offsets)).map(|()| 0)
    };
    // SAFETY: the caller promises what is needed there.
    unsafe { with_drive(drive, send) }
}

/// Tells what the drive is.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed; `effort_rates` is null, or leads to `joints` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_send_properties(
    drive: *mut DriveHandle,
    period_ns: i64,
    watchdog_ns: i64,
    lag_ns: i64,
    effort_rates: *const f64,
    joints: u32,
) -> i32 {
    let send = |drive: &mut DrivePorts| {
        let n = joints as usize;
        let rates = if effort_rates.is_null() {
            &[]
        } else if n == 0 || n > MAX_JOINTS {
            return Err(Failure::argument(format!("rates of {n} joints; there are 1 to {MAX_JOINTS}")));
        } else {
            // SAFETY: it is not null, and the caller promises so many numbers; `n` was bounded.
            unsafe { slice::from_raw_parts(effort_rates, n) }
        };
        drive.send_properties(period_ns, watchdog_ns, lag_ns, rates).map(|()| 0)
    };
    // SAFETY: the caller promises what is needed there.
    unsafe { with_drive(drive, send) }
}

/// Tells the maker's words.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed; `words` is null or a text.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_send_robot_text(
    drive: *mut DriveHandle,
    robot_state: u32,
    robot_code: u32,
    words: *const c_char,
) -> i32 {
    let send = |drive: &mut DrivePorts| {
        // SAFETY: the caller promises a text, or null, which is refused.
        let words = unsafe { text_of(words, "the text") }?.to_string_lossy();
        drive.send_robot_text(robot_state, robot_code, &words).map(|()| 0)
    };
    // SAFETY: the caller promises what is needed there.
    unsafe { with_drive(drive, send) }
}

/// Whether the guardian's stop stands.
///
/// # Safety
/// `drive` is null, or of [`vservo_drive_open_with`] and not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_is_stopped_by_guardian(drive: *mut DriveHandle) -> i32 {
    // SAFETY: the caller promises what is needed there.
    unsafe { with_drive(drive, |drive| Ok(drive.is_stopped_by_guardian().into())) }
}

/// Leaves the reason of an end.
///
/// # Safety
/// `instance` and `reason` are null or texts.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vservo_drive_leave_reason(instance: *const c_char, reason: *const c_char) -> i32 {
    let leave = || {
        // SAFETY: the caller promises texts, or null, which is refused of a reason.
        let (instance, reason) = unsafe { (instance_named(instance)?, text_of(reason, "the reason")?) };
        drive::leave_reason(&instance, &reason.to_string_lossy()).map(|()| 0)
    };
    guarded(leave, |code| code as i32)
}

/// The time of all stamps.
#[unsafe(no_mangle)]
pub extern "C" fn vservo_drive_now_ns() -> i64 {
    now().0
}

/// Sleeps until then.
#[unsafe(no_mangle)]
pub extern "C" fn vservo_drive_sleep_until_ns(deadline_ns: i64) {
    sleep_until(MonoNs(deadline_ns));
}
