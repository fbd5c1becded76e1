//! CLOCK_MONOTONIC, read and slept on.

use crate::time::{MonoNs, SpanNs};
use rustix::io::Errno;
use rustix::thread::{ClockId as SleepClock, clock_nanosleep_absolute};
use rustix::time::{ClockId, Timespec, clock_gettime};

/// Nanoseconds in a second, as the kernel's timespec has them.
const NS_PER_S: i64 = 1_000_000_000;

/// The time now.
#[must_use]
pub fn now() -> MonoNs {
    let t = clock_gettime(ClockId::Monotonic);
    MonoNs(t.tv_sec * NS_PER_S + t.tv_nsec)
}

/// The time of day at the origin of the monotonic clock, as nanoseconds since 1970: what turns stamps into dates.
#[must_use]
pub fn unix_origin() -> SpanNs {
    let t = clock_gettime(ClockId::Realtime);
    MonoNs(t.tv_sec * NS_PER_S + t.tv_nsec) - now()
}

/// Sleeps until `deadline`; returns at once when it has passed. A signal does not cut the sleep short.
pub fn sleep_until(deadline: MonoNs) {
    let t = Timespec { tv_sec: deadline.0.div_euclid(NS_PER_S), tv_nsec: deadline.0.rem_euclid(NS_PER_S) };
    while clock_nanosleep_absolute(SleepClock::Monotonic, &t) == Err(Errno::INTR) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeping_ends_after_the_deadline() {
        let deadline = now() + SpanNs::MILLISECOND;
        sleep_until(deadline);
        assert!(now() >= deadline);
        sleep_until(MonoNs(1));
    }
}
