//! What brings the arm to rest from outside of the cores: signals, and the stop word.

use crate::control::control_loop::ControlLoop;
use crate::control::lifecycle::{Refusal, Request};
use crate::control::safety::Fault;
use crate::ipc::{Halt, RestartCounts, StopWord};
use crate::messages::ControlState;
use crate::process::StopFlag;
use crate::process::stop::STOP_REASON;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// The signals of this process and the stop word of its instance, for all threads of control.
#[derive(Debug, Clone)]
pub(super) struct Stops {
    flag: StopFlag,
    word: Arc<StopWord>,
    /// A run that is served stays after a stop; any other ends by it.
    served: bool,
    /// The newest request for each stop of [`LATCHED`] that was there while it stood.
    met: Arc<[AtomicU64; LATCHED.len()]>,
}

/// Stops that stand until they are reset: anybody's, and the guardian's.
const LATCHED: [Halt; 2] = [Halt::Latch, Halt::Guardian];

fn request(halt: Halt) -> Request {
    match halt {
        Halt::Shutdown => Request::Shutdown,
        Halt::Stop | Halt::Latch | Halt::Guardian => Request::Stop,
    }
}

impl Stops {
    pub(super) fn new(flag: StopFlag, word: StopWord, served: bool) -> Self {
        Self { flag, word: Arc::new(word), served, met: Arc::default() }
    }

    /// Does at a tick what is asked for. No system call, no allocation.
    pub(super) fn obey<const N: usize>(&self, control: &mut ControlLoop<N>) {
        if self.flag.is_requested() {
            control.stop(STOP_REASON);
        }
        for (halt, met) in LATCHED.into_iter().zip(&*self.met) {
            self.latch(halt, met, control);
        }
        for halt in [Halt::Stop, Halt::Shutdown] {
            if let Some(number) = self.word.asked(halt) {
                // Refused only where the run ends anyway.
                let _ = control.halt(request(halt));
                self.word.take(halt, number, control.controller().state().told());
            }
        }
    }

    /// A latched stop is a fault from when it is asked for until that is reset; a request that comes after the reset is another one.
    fn latch<const N: usize>(&self, halt: Halt, met: &AtomicU64, control: &mut ControlLoop<N>) {
        let Some(number) = self.word.asked(halt) else { return };
        if self.word.begun(halt).is_some() {
            if control.controller().fault().is_some() {
                met.store(number, Ordering::Relaxed);
                return;
            }
            // The next step takes the fault in, so that there is none here only after a reset.
            // With the state of a page on which nothing has begun, for the next one.
            self.word.take(halt, met.load(Ordering::Relaxed), ControlState::default());
            if self.word.asked(halt).is_none() {
                return;
            }
        }
        met.store(number, Ordering::Relaxed);
        control.fail(Fault::StopLatched);
        self.word.begin(halt, ControlState::Fault);
    }

    /// What the supervisor says of camera and vision.
    pub(super) fn restarts(&self) -> RestartCounts {
        self.word.restarts()
    }

    /// Whether a wait between two ticks is to end: the next tick obeys.
    pub(super) fn are_asked(&self) -> bool {
        let latches = LATCHED
            .into_iter()
            .any(|halt| self.word.asked(halt).is_some() && self.word.begun(halt).is_none());
        let halts = [Halt::Stop, Halt::Shutdown].into_iter().any(|halt| self.word.asked(halt).is_some());
        self.flag.is_requested() || halts || latches
    }

    /// Looks before the first tick; whether the run is to end.
    pub(super) fn end_the_start(&self) -> bool {
        // A stop that is latched before the first tick is met by the first one.
        for halt in [Halt::Stop, Halt::Shutdown] {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, assemble};
    use crate::ipc::{Instance, Role};
    use crate::time::{MonoNs, TICK};
    use std::os::unix::fs::FileExt;

    /// Any program latches a stop by the documented place in the documented file. The tick that looks at it brakes, no start gets past it, and a reset is its end.
    #[test]
    fn a_number_in_the_file_latches_a_stop_until_it_is_reset() {
        let instance: Instance = format!("u-latch-{}", std::process::id()).parse().unwrap();
        let lock = instance.lock(Role::Control).unwrap();
        let stops = Stops::new(StopFlag::default(), instance.make_stop_word().unwrap(), true);
        let config = Config::load(None, &["run.serve=true".into()]).unwrap();
        let robot = config.robot.build::<4>().unwrap();
        let drive = assemble::drive(&config, &robot).unwrap();
        let mut control = assemble::control_loop_with::<4>(&config, robot, drive).unwrap().control;
        let mut k = 0_i32;
        let mut tick = |control: &mut ControlLoop<4>| {
            let now = MonoNs(TICK.0 * i64::from(k));
            control.sense(u64::from(k.unsigned_abs()), now);
            stops.obey(control);
            k += 1;
            control.act(now, None).state
        };
        assert_eq!(tick(&mut control), ControlState::Idle);
        control.request(Request::Start).unwrap();
        assert_eq!(tick(&mut control), ControlState::Waiting);
        let file = std::fs::OpenOptions::new().write(true).open(instance.directory().join("stop")).unwrap();
        file.write_all_at(&1_u64.to_le_bytes(), 48).unwrap();
        assert!(stops.are_asked());
        let state = tick(&mut control);
        assert_eq!(state, ControlState::Fault, "in the tick that looked");
        for _ in 0..300 {
            tick(&mut control);
        }
        assert_eq!(
            (tick(&mut control), control.controller().fault()),
            (ControlState::Fault, Some(Fault::StopLatched))
        );
        assert_eq!(control.request(Request::Start), Err(Refusal::InFault));
        file.write_all_at(&2_u64.to_le_bytes(), 48).unwrap();
        assert_eq!(tick(&mut control), ControlState::Fault, "asked for once more, it is the same");
        control.request(Request::Reset).unwrap();
        assert_eq!(tick(&mut control), ControlState::Idle);
        assert_eq!(tick(&mut control), ControlState::Idle, "it is taken");
        file.write_all_at(&3_u64.to_le_bytes(), 48).unwrap();
        let state = tick(&mut control);
        assert_eq!(state, ControlState::Fault, "and works again");
        let drive = instance.open_stop_word().unwrap().unwrap();
        assert!(!drive.is_stopped_by_guardian(), "nobody but the guardian has the drive brake by itself");
        let _ = instance.open_stop_word().unwrap().unwrap().ask(Halt::Guardian);
        for _ in 0..300 {
            tick(&mut control);
        }
        assert!(drive.is_stopped_by_guardian(), "one reset is the end of both");
        control.request(Request::Reset).unwrap();
        assert_eq!(tick(&mut control), ControlState::Idle);
        assert_eq!((tick(&mut control), drive.is_stopped_by_guardian()), (ControlState::Idle, false));
        // Stops and resets within one tick, in either order.
        file.write_all_at(&4_u64.to_le_bytes(), 48).unwrap();
        (0..300).for_each(|_| assert_eq!(tick(&mut control), ControlState::Fault));
        control.request(Request::Reset).unwrap();
        file.write_all_at(&5_u64.to_le_bytes(), 48).unwrap();
        (0..300).for_each(|_| assert_eq!(tick(&mut control), ControlState::Fault, "after the reset"));
        control.request(Request::Reset).unwrap();
        assert_eq!(tick(&mut control), ControlState::Idle);
        control.fail(Fault::TrackingError);
        (0..300).for_each(|_| assert_eq!(tick(&mut control), ControlState::Fault));
        file.write_all_at(&6_u64.to_le_bytes(), 48).unwrap();
        let now = MonoNs(TICK.0 * i64::from(k));
        control.sense(u64::from(k.unsigned_abs()), now);
        stops.obey(&mut control);
        control.request(Request::Reset).unwrap();
        let state = control.act(now, None).state;
        assert_eq!(state, ControlState::Fault, "before the reset, which cannot have meant it");
        assert_eq!(control.controller().fault(), Some(Fault::StopLatched));
        drop(lock);
        instance.remove_leftovers(None);
    }
}
