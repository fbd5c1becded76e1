//! Waiting for a deadline more punctually than the kernel wakes a thread: asleep until shortly before it, and spinning
//! on the clock for the rest.
//!
//! ```text
//! ── sleep ──► timer ──► woken ── spin ──► deadline
//!              └───────── spin_us ────────────┘        a wake-up that takes longer than this is late as before
//! ```

use super::{now, sleep_until};
use crate::time::{MonoNs, SpanNs};

/// Waits for deadlines, and knows how long it spun.
#[derive(Debug, Clone, Copy, Default)]
pub struct DeadlineWait {
    spin: SpanNs,
    spun: SpanNs,
}

impl DeadlineWait {
    /// Spins at most the last `spin` before each deadline; sleeps all the way where it is zero or less.
    #[must_use]
    pub fn new(spin: SpanNs) -> Self {
        Self { spin, spun: SpanNs::ZERO }
    }

    /// Waits until `deadline` and tells the time then, which is never earlier. Makes no system call but the sleep.
    pub fn until(&mut self, deadline: MonoNs) -> MonoNs {
        if self.spin <= SpanNs::ZERO {
            sleep_until(deadline);
            return now();
        }
        sleep_until(deadline - self.spin);
        let woken = now();
        let mut time = woken;
        while time < deadline {
            std::hint::spin_loop();
            time = now();
        }
        self.spun = SpanNs(self.spun.0.saturating_add((time - woken).0));
        time
    }

    /// How long it spun so far: what this punctuality has cost of a core.
    #[must_use]
    pub fn spun(&self) -> SpanNs {
        self.spun
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_wait_ends_before_its_deadline() {
        for spin_us in [0, 1, 50, 500, 5_000] {
            let mut wait = DeadlineWait::new(SpanNs(spin_us * 1_000));
            for _ in 0..5 {
                let deadline = now() + SpanNs::MILLISECOND;
                let told = wait.until(deadline);
                assert!(told >= deadline, "{told:?} before {deadline:?} with {spin_us} us");
            }
        }
    }

    #[test]
    fn only_the_time_between_waking_and_the_deadline_counts_as_spun() {
        let mut sleeping = DeadlineWait::new(SpanNs::ZERO);
        sleeping.until(now() + SpanNs::MILLISECOND);
        assert_eq!(sleeping.spun(), SpanNs::ZERO);
        let mut late = DeadlineWait::new(SpanNs::MILLISECOND);
        late.until(now() - SpanNs::MILLISECOND);
        assert_eq!(late.spun(), SpanNs::ZERO, "what has passed is not waited for");
        // All of the way is spun, because it is shorter than the spin.
        let mut spinning = DeadlineWait::new(SpanNs(5_000_000));
        let began = now();
        let told = spinning.until(began + SpanNs::MILLISECOND);
        assert!(spinning.spun() > SpanNs::ZERO && spinning.spun() <= told - began, "{spinning:?}");
    }
}
