//! Time stamps: nanoseconds of the monotonic clock, or of the simulated clock in lockstep.
//!
//! Every message and every core uses this one type, so that a stamp from the wall clock, or one in other
//! units, does not compile. Reading a clock is not done here (see `rt::clock`): cores are told the time.

#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;
use std::ops::{Add, Sub};

/// A point in monotonic (or simulated) time, in nanoseconds since that clock's origin.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[cfg_attr(feature = "transport", derive(ZeroCopySend))]
pub struct MonoNs(pub i64);

/// A span of time in nanoseconds; may be negative (a stamp from the future).
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[cfg_attr(feature = "transport", derive(ZeroCopySend))]
pub struct SpanNs(pub i64);

/// Length of a control tick: 1 kHz.
pub const TICK: SpanNs = SpanNs::MILLISECOND;

impl MonoNs {
    /// The clock's origin; as a stamp it means "never".
    pub const ZERO: Self = Self(0);
}

impl SpanNs {
    /// No time at all.
    pub const ZERO: Self = Self(0);
    /// A thousandth of a second, which follows from the unit.
    pub const MILLISECOND: Self = Self(1_000_000);

    /// The nearest span to `seconds`; saturates at the ends of the range.
    #[must_use]
    pub fn from_s(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// The span in seconds.
    #[must_use]
    pub fn as_s(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// The span in microseconds.
    #[must_use]
    pub fn as_us(self) -> f64 {
        self.0 as f64 * 1e-3
    }
}

impl Sub for MonoNs {
    type Output = SpanNs;
    fn sub(self, earlier: Self) -> SpanNs {
        SpanNs(self.0.saturating_sub(earlier.0))
    }
}

impl Add<SpanNs> for MonoNs {
    type Output = Self;
    fn add(self, span: SpanNs) -> Self {
        Self(self.0.saturating_add(span.0))
    }
}

impl Sub<SpanNs> for MonoNs {
    type Output = Self;
    fn sub(self, span: SpanNs) -> Self {
        Self(self.0.saturating_sub(span.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_and_sums_are_inverse() {
        let a = MonoNs(1_500);
        let b = MonoNs(4_000);
        assert_eq!(b - a, SpanNs(2_500));
        assert_eq!(a + (b - a), b);
        assert_eq!(b - (b - a), a);
    }

    #[test]
    fn seconds_round_to_the_nearest_nanosecond() {
        assert_eq!(SpanNs::from_s(0.001), SpanNs::MILLISECOND);
        assert_eq!(SpanNs::from_s(1e-9 * 0.6), SpanNs(1));
        assert!((SpanNs(40_000_000).as_s() - 0.04).abs() < 1e-15);
    }
}
