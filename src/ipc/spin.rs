//! A short spin before a wait: where the awaited message comes within some microseconds, going to sleep and being woken by
//! another process takes longer than the message itself.
//!
//! It is bounded, it is done only where the process may use another core beside its own, and it gives itself up where it does
//! not help: after each unsuccessful spin twice as many waits are made without one, and a success resets that. On a busy machine
//! nearly all waits sleep at once.

use crate::rt::now;
use crate::time::SpanNs;

/// Most waits without a spin between two attempts, so that spins that never help cost a sixty-fourth. Chosen by hand: with
/// more it takes longer to notice that they help again.
const LONGEST_PAUSE: u32 = 64;
/// The thread looks for the message every few nanoseconds. If the clock has advanced by this much in between, another thread must have run
/// in its place, so that there is no free core. Chosen by hand: less than a time slice of the scheduler, and longer than an interrupt.
const INTERRUPTED: SpanNs = SpanNs(500_000);

/// Decides for one reader whether and how long to spin.
#[derive(Debug, Clone)]
pub struct Spin {
    longest: SpanNs,
    /// Waits without a spin after the next unsuccessful spin.
    pause: u32,
    /// Waits still to be made without one.
    left: u32,
}

impl Spin {
    /// Spins at most `longest` before a wait; never where the process has a single core.
    #[must_use]
    pub fn new(longest: SpanNs) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Self::on_cores(cores, longest)
    }

    fn on_cores(cores: usize, longest: SpanNs) -> Self {
        Self { longest: if cores > 1 { longest } else { SpanNs::ZERO }, pause: 1, left: 0 }
    }

    /// Spins until `ready` says so; false when it is time to sleep.
    ///
    /// # Errors
    /// That of `ready`, which ends the spin.
    pub fn until<E>(&mut self, mut ready: impl FnMut() -> Result<bool, E>) -> Result<bool, E> {
        if ready()? {
            return Ok(true);
        }
        if self.longest <= SpanNs::ZERO {
            return Ok(false);
        }
        if self.left > 0 {
            self.left -= 1;
            return Ok(false);
        }
        let start = now();
        let mut last = start;
        loop {
            std::hint::spin_loop();
            if ready()? {
                self.pause = 1;
                return Ok(true);
            }
            let time = now();
            let interrupted = time - last > INTERRUPTED;
            if interrupted || time - start > self.longest {
                self.left = self.pause;
                self.pause = if interrupted { LONGEST_PAUSE } else { (self.pause * 2).min(LONGEST_PAUSE) };
                return Ok(false);
            }
            last = time;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    const LONG: SpanNs = SpanNs(60_000_000_000);

    /// How often a spin looks after the message, which is there at the look number `there`; 0 means never.
    fn looks(spin: &mut Spin, there: u32) -> (u32, bool) {
        let mut looks = 0;
        let came = spin.until(|| {
            looks += 1;
            Ok::<_, Infallible>(looks == there)
        });
        (looks, came.unwrap())
    }

    #[test]
    fn what_comes_soon_is_met_without_a_sleep() {
        let mut spin = Spin::on_cores(2, LONG);
        assert_eq!(looks(&mut spin, 1), (1, true), "what is there already needs no spin");
        assert_eq!(looks(&mut spin, 3), (3, true));
    }

    #[test]
    fn a_single_core_belongs_to_whoever_is_waited_for() {
        let mut spin = Spin::on_cores(1, LONG);
        assert_eq!((looks(&mut spin, 5), looks(&mut spin, 1)), ((1, false), (1, true)));
        assert_eq!(looks(&mut Spin::on_cores(8, SpanNs::ZERO), 5), (1, false));
    }

    #[test]
    fn spins_in_vain_become_rare_and_a_success_starts_anew() {
        let mut spin = Spin::on_cores(2, SpanNs(1));
        let vain = |spin: &mut Spin| looks(spin, 0).0 > 1;
        let spun: Vec<usize> = (0..400).filter(|_| vain(&mut spin)).collect();
        // After the first one wait without, then 2, 4, ... up to 64; where the machine took the core away, 64 at once.
        let pauses: Vec<usize> = spun.windows(2).map(|pair| pair[1] - pair[0] - 1).collect();
        assert!(pauses.is_sorted() && pauses.iter().all(|p| *p <= LONGEST_PAUSE as usize), "{pauses:?}");
        assert_eq!(pauses.last(), Some(&(LONGEST_PAUSE as usize)), "{pauses:?}");
        spin.longest = LONG;
        while looks(&mut spin, 2) != (2, true) {}
        assert_eq!((looks(&mut spin, 2), spin.pause), ((2, true), 1));
    }

    #[test]
    fn an_error_ends_the_spin() {
        let mut spin = Spin::on_cores(2, LONG);
        let mut left = 3;
        let result = spin.until(|| {
            left -= 1;
            if left == 0 { Err("broken") } else { Ok(false) }
        });
        assert_eq!(result, Err("broken"));
    }
}
