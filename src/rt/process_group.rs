//! The end of a process with all that it has started.

use rustix::process::{Pid, Signal, kill_process_group};
use std::process::Child;

/// Kills `child`, which was started as the first of a process group of its own, with all of that group, and waits until it is gone.
pub fn kill_with_group(child: &mut Child) {
    if let Some(group) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) {
        let _ = kill_process_group(group, Signal::KILL); // none is left of a group that has ended
    }
    let _ = child.wait();
}
