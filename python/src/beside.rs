//! Calls that wait: the interpreter is free meanwhile, and Ctrl-C comes through.

use crate::errors::{Error, raised};
use pyo3::prelude::*;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;
use vservo_cores::process::{ProcessError, StopFlag};

/// Looks for Ctrl-C lie so far apart.
const LOOK_FOR_SIGNALS: Duration = Duration::from_millis(50);

/// Does `work` in a thread beside; Ctrl-C requests `interrupted`, which ends the work.
pub fn beside<T: Send>(
    py: Python<'_>,
    interrupted: &StopFlag,
    work: impl FnOnce() -> Result<T, ProcessError> + Send,
) -> PyResult<T> {
    let (tell, mut told) = sync_channel(1);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let _ = tell.send(work());
        });
        let mut signal = None;
        loop {
            let (back, end) = py.detach(move || {
                let end = told.recv_timeout(LOOK_FOR_SIGNALS);
                (told, end)
            });
            told = back;
            match end {
                Ok(end) => return signal.map_or_else(|| end.map_err(raised), Err),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Error::new_err("internal error: the call panicked; please report this"));
                }
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(error) = py.check_signals() {
                        interrupted.request();
                        signal = Some(error);
                    }
                }
            }
        }
    })
}
