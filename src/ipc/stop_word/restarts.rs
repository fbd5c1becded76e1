//! What the supervisor says of camera and vision on the page of the stop word: how often it lost them, and how often it started them anew.
//!
//! ```text
//! offset 72  4 bytes each, little endian: losses, restarts of cameras, restarts of vision
//! ```

use super::StopWord;
use std::sync::atomic::{AtomicU32, Ordering};

/// How often the processes that see for control were lost and started anew since the begin of the run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RestartCounts {
    /// Processes that had joined and then died, or hung.
    pub losses: u32,
    /// Starts of camera processes after the first ones, also those that came to nothing.
    pub camera: u32,
    /// The same of vision.
    pub vision: u32,
}

/// The same as it lies in memory.
#[repr(C)]
pub(super) struct RestartCounters {
    losses: AtomicU32,
    camera: AtomicU32,
    vision: AtomicU32,
    reserved: AtomicU32,
}

impl StopWord {
    /// For the supervisor, which alone writes here.
    pub fn tell_restarts(&self, counts: RestartCounts) {
        let counters = self.restart_counters();
        counters.camera.store(counts.camera, Ordering::Relaxed);
        counters.vision.store(counts.vision, Ordering::Relaxed);
        counters.losses.store(counts.losses, Ordering::Release);
    }

    /// For control. Three loads, no system call.
    #[must_use]
    pub fn restarts(&self) -> RestartCounts {
        let counters = self.restart_counters();
        RestartCounts {
            losses: counters.losses.load(Ordering::Acquire),
            camera: counters.camera.load(Ordering::Relaxed),
            vision: counters.vision.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ipc::{Halt, Instance, Role};

    #[test]
    fn restarts_are_told_beside_the_stops() {
        let instance: Instance = format!("u-again-{}", std::process::id()).parse().unwrap();
        let lock = instance.lock(Role::Control).unwrap();
        let control = instance.make_stop_word().unwrap();
        let supervisor = instance.open_stop_word().unwrap().unwrap();
        assert_eq!(control.restarts(), RestartCounts::default());
        let counts = RestartCounts { losses: 3, camera: 2, vision: 7 };
        supervisor.tell_restarts(counts);
        assert_eq!(control.restarts(), counts);
        assert!(Halt::ALL.into_iter().all(|halt| control.asked(halt).is_none()));
        drop(lock);
        instance.remove_leftovers(None);
    }
}
