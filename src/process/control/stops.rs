//! What brings the arm to rest from outside of the cores: signals, and the stop word.

use crate::control::control_loop::ControlLoop;
use crate::control::lifecycle::{Refusal, Request};
use crate::ipc::{Halt, StopWord};
use crate::messages::ControlState;
use crate::process::StopFlag;
use crate::process::stop::STOP_REASON;
use std::sync::Arc;

/// The signals of this process and the stop word of its instance, for all threads of control.
#[derive(Debug, Clone)]
pub(super) struct Stops {
    flag: StopFlag,
    word: Arc<StopWord>,
    /// A run that is served stays after a stop; any other ends by it.
    served: bool,
}

fn request(halt: Halt) -> Request {
    match halt {
        Halt::Stop => Request::Stop,
        Halt::Shutdown => Request::Shutdown,
    }
}

impl Stops {
    pub(super) fn new(flag: StopFlag, word: StopWord, served: bool) -> Self {
        Self { flag, word: Arc::new(word), served }
    }

    /// Does at a tick what is asked for. No system call, no allocation.
    pub(super) fn obey<const N: usize>(&self, control: &mut ControlLoop<N>) {
        if self.flag.is_requested() {
            control.stop(STOP_REASON);
        }
        for halt in Halt::ALL {
            if let Some(number) = self.word.asked(halt) {
                // Refused only where the run ends anyway.
                let _ = control.halt(request(halt));
                self.word.take(halt, number, control.controller().state().told());
            }
        }
    }

    /// Whether a wait between two ticks is to end: the next tick obeys.
    pub(super) fn are_asked(&self) -> bool {
        self.flag.is_requested() || self.word.is_asked()
    }

    /// Looks before the first tick; whether the run is to end.
    pub(super) fn end_the_start(&self) -> bool {
        for halt in Halt::ALL {
            if let Some(number) = self.word.asked(halt) {
                let _ = self.early(request(halt)); // neither is refused
                self.word.take(halt, number, ControlState::Idle);
            }
        }
        self.flag.is_requested()
    }

    /// A request before the first tick: nothing moves, so that a stop is met already.
    pub(super) fn early(&self, request: Request) -> Result<(), Refusal> {
        match request {
            Request::Stop if self.served => Ok(()),
            Request::Stop | Request::Shutdown => {
                self.flag.request();
                Ok(())
            }
            _ => Err(Refusal::NotReady),
        }
    }
}
