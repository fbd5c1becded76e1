//! From a driver's stamp to the middle of the exposure.
//!
//! ```text
//!                 start of the exposure                        last pixel received
//! global shutter    ├─────── exposure ───────┤├── readout ──┤        middle = start + exposure / 2
//!                               ▲                           ▲ end           = end - readout - exposure / 2
//!
//! rolling shutter   ├─────── exposure ───────┤              first row
//!                          ├─────── exposure ───────┤       middle row: its middle counts
//!                   ├─readout─┤ later: the last row ├────┤  middle = start + readout / 2 + exposure / 2
//!                                                                   = end - readout / 2 - exposure / 2
//! ```
//! The kernel says which of the two a stamp is, and by what clock. A driver that says nothing, copies the stamp of somebody else, or says
//! what cannot be (a time that stands still, goes back, or is more than a second from now) is not believed: then the image's arrival
//! counts as its end, which is late by what the bus takes. `vservo calibrate latency` finds the constant part of such errors.
//!
//! What cannot be is left out first, as a frame that is lost: buffers that were filled before this process was held up are old and right.
//! Only more of them than there are buffers speak against the clock.

use crate::config::Shutter;
use crate::time::{MonoNs, SpanNs};
use serde::Serialize;

/// Largest distance of a stamp from the arrival of its frame. Chosen by hand: a frame that old is useless, and another clock is off by far more.
const FARTHEST: SpanNs = SpanNs(1_000_000_000);

/// By what clock a driver stamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StampClock {
    /// `CLOCK_MONOTONIC`.
    Monotonic,
    /// Nobody knows.
    Unknown,
    /// That of whoever gave the image to an output device.
    Copied,
}

/// What a driver says of an image's time, and when it came.
#[derive(Debug, Clone, Copy)]
pub(super) struct DriverStamp {
    pub(super) stamp: MonoNs,
    pub(super) clock: StampClock,
    pub(super) at_start: bool,
    pub(super) arrival: MonoNs,
}

/// Why a driver's stamps are not believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StampDoubt {
    /// It does not say by what clock.
    UnknownClock,
    /// They are of another program.
    Copied,
    /// They do not go on.
    NotIncreasing,
    /// They are too far from now.
    FarOff,
}

impl StampDoubt {
    /// For people.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::UnknownClock => "the driver does not say by what clock it stamps",
            Self::Copied => "the driver's stamps are copies of somebody else's",
            Self::NotIncreasing => "the driver's stamps stand still or go back",
            Self::FarOff => "the driver's stamps are more than a second from now: of another clock",
        }
    }

    /// The same of a program that gives images.
    pub(super) fn of_program(self) -> String {
        match self {
            Self::UnknownClock => "its images have no stamps".into(),
            other => other.describe().replace("the driver's", "its"),
        }
    }
}

/// What becomes of an image by its stamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dated {
    /// The middle of its exposure.
    Mid(MonoNs),
    /// Its time is unknown: it is lost.
    Undated,
}

/// Judges and converts the stamps of a stream.
#[derive(Debug, Clone)]
pub(super) struct Stamps {
    shutter: Shutter,
    readout: SpanNs,
    /// Impossible stamps in a row that may be of images from before a pause.
    patience: u32,
    impossible: u32,
    last: Option<MonoNs>,
    doubt: Option<StampDoubt>,
    clamped: u64,
}

impl Stamps {
    /// For a stream through so many buffers.
    pub(super) fn new(shutter: Shutter, readout: SpanNs, buffers: u32) -> Self {
        Self { shutter, readout, patience: buffers, impossible: 0, last: None, doubt: None, clamped: 0 }
    }

    /// The stream begins anew: what was wrong with the one before is open again.
    pub(super) fn restart(&mut self) {
        (self.impossible, self.last, self.doubt) = (0, None, None);
    }

    /// Why they are not believed; `None` while they are.
    pub(super) fn doubt(&self) -> Option<StampDoubt> {
        self.doubt
    }

    /// How many images would have been exposed in the future, by their stamps.
    pub(super) fn clamped(&self) -> u64 {
        self.clamped
    }

    /// When the image was exposed.
    pub(super) fn date(&mut self, driver: &DriverStamp, exposure: SpanNs) -> Dated {
        if self.doubt.is_none() {
            self.doubt = match driver.clock {
                StampClock::Monotonic => None,
                StampClock::Unknown => Some(StampDoubt::UnknownClock),
                StampClock::Copied => Some(StampDoubt::Copied),
            };
        }
        if self.doubt.is_none() {
            let impossible = self.why_impossible(driver);
            self.impossible = if impossible.is_some() { self.impossible + 1 } else { 0 };
            if impossible.is_some() && self.impossible <= self.patience {
                return Dated::Undated;
            }
            self.doubt = impossible;
        }
        let mid = if self.doubt.is_some() {
            self.mid(driver.arrival, false, exposure)
        } else {
            self.last = Some(driver.stamp);
            self.mid(driver.stamp, driver.at_start, exposure)
        };
        if mid > driver.arrival {
            self.clamped += 1;
        }
        Dated::Mid(mid.min(driver.arrival))
    }

    fn why_impossible(&self, driver: &DriverStamp) -> Option<StampDoubt> {
        if (driver.stamp - driver.arrival).0.saturating_abs() > FARTHEST.0 {
            return Some(StampDoubt::FarOff);
        }
        self.last.is_some_and(|last| driver.stamp <= last).then_some(StampDoubt::NotIncreasing)
    }

    fn mid(&self, stamp: MonoNs, at_start: bool, exposure: SpanNs) -> MonoNs {
        let half = SpanNs(exposure.0 / 2);
        match (self.shutter, at_start) {
            (Shutter::Global, true) => stamp + half,
            (Shutter::Global, false) => stamp - self.readout - half,
            (Shutter::Rolling, true) => stamp + SpanNs(self.readout.0 / 2) + half,
            (Shutter::Rolling, false) => stamp - SpanNs(self.readout.0 / 2) - half,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: i64 = 1_000_000;

    fn at(stamp_ms: i64, at_start: bool, arrival_ms: i64) -> DriverStamp {
        DriverStamp {
            stamp: MonoNs(stamp_ms * MS),
            clock: StampClock::Monotonic,
            at_start,
            arrival: MonoNs(arrival_ms * MS),
        }
    }

    fn stamps(shutter: Shutter, readout_ms: i64) -> Stamps {
        Stamps::new(shutter, SpanNs(readout_ms * MS), 4)
    }

    fn mid_ms(dated: Dated) -> i64 {
        let Dated::Mid(mid) = dated else { panic!("the image has a time") };
        mid.0 / MS
    }

    /// An exposure of 10 ms from 100 ms on and a readout of 6 ms, told by each kind of stamp.
    #[test]
    fn both_ends_give_the_same_middle() {
        let exposure = SpanNs(10 * MS);
        for (shutter, middle) in [(Shutter::Global, 105), (Shutter::Rolling, 108)] {
            let from_start = stamps(shutter, 6).date(&at(100, true, 130), exposure);
            let from_end = stamps(shutter, 6).date(&at(116, false, 130), exposure);
            assert_eq!((mid_ms(from_start), mid_ms(from_end)), (middle, middle), "{shutter:?}");
        }
        assert_eq!(mid_ms(stamps(Shutter::Rolling, 0).date(&at(110, false, 130), exposure)), 105);
    }

    #[test]
    fn no_image_is_of_the_future() {
        let mut s = stamps(Shutter::Rolling, 0);
        let dated = s.date(&at(135, false, 100), SpanNs(4 * MS));
        assert_eq!((dated, s.clamped()), (Dated::Mid(MonoNs(100 * MS)), 1));
        s.date(&at(175, false, 180), SpanNs(4 * MS));
        assert_eq!((s.clamped(), s.doubt()), (1, None), "35 ms ahead are a habit of drivers, no other clock");
    }

    #[test]
    fn without_a_known_clock_arrival_counts() {
        for (clock, doubt) in
            [(StampClock::Unknown, StampDoubt::UnknownClock), (StampClock::Copied, StampDoubt::Copied)]
        {
            let mut s = stamps(Shutter::Global, 2);
            let dated = s.date(&DriverStamp { clock, ..at(7, true, 500) }, SpanNs(6 * MS));
            assert_eq!((mid_ms(dated), s.doubt()), (495, Some(doubt)), "arrival, readout, half the exposure");
        }
    }

    #[test]
    fn stale_frames_after_a_pause_are_dropped() {
        let mut s = stamps(Shutter::Rolling, 0);
        s.date(&at(0, false, 1), SpanNs::ZERO);
        // This process stood still for five seconds; four buffers were filled at its beginning.
        for k in 1..=4 {
            assert_eq!(s.date(&at(40 * k, false, 5_000), SpanNs::ZERO), Dated::Undated);
        }
        assert_eq!(mid_ms(s.date(&at(5_030, false, 5_031), SpanNs::ZERO)), 5_030);
        assert_eq!(s.doubt(), None);
    }

    #[test]
    fn another_clock_and_one_that_stands_are_found_out() {
        let mut far = stamps(Shutter::Rolling, 0);
        let mut standing = stamps(Shutter::Rolling, 0);
        let mut back = stamps(Shutter::Rolling, 0);
        assert_eq!(mid_ms(standing.date(&at(10, false, 10), SpanNs::ZERO)), 10);
        assert_eq!(mid_ms(back.date(&at(900, false, 905), SpanNs::ZERO)), 900);
        for k in 1..=10_i64 {
            let wall = at(1_700_000_000_000 + 40 * k, false, 40 * k);
            let dated = [
                far.date(&wall, SpanNs::ZERO),
                standing.date(&at(10, false, 40 * k), SpanNs::ZERO),
                back.date(&at(100 + 40 * k, false, 905 + 40 * k), SpanNs::ZERO),
            ];
            let waits = k <= 4;
            assert!(dated.iter().all(|d| (*d == Dated::Undated) == waits), "{k}: {dated:?}");
        }
        assert_eq!(far.doubt(), Some(StampDoubt::FarOff));
        assert_eq!(standing.doubt(), Some(StampDoubt::NotIncreasing));
        assert_eq!(back.doubt(), Some(StampDoubt::NotIncreasing));
        back.restart();
        assert_eq!((mid_ms(back.date(&at(600, false, 610), SpanNs::ZERO)), back.doubt()), (600, None));
    }

    proptest! {
        /// Whatever a driver says, no image is dated later than it came, and the count of doubtful ones is bounded.
        #[test]
        fn any_stamps_are_survived(
            said in proptest::collection::vec((any::<i64>(), 0..3_u8, any::<bool>(), 0..200_i64), 1..50),
            exposure in 0..1_000_000_000_i64,
        ) {
            let mut s = stamps(Shutter::Rolling, 5);
            let (mut arrival, mut undated) = (MonoNs(1_000_000_000), 0);
            for (stamp, clock, at_start, ms) in said {
                arrival = arrival + SpanNs(ms * MS);
                let clock = [StampClock::Monotonic, StampClock::Unknown, StampClock::Copied][usize::from(clock)];
                match s.date(&DriverStamp { stamp: MonoNs(stamp), clock, at_start, arrival }, SpanNs(exposure)) {
                    Dated::Mid(mid) => { prop_assert!(mid <= arrival); undated = 0; }
                    Dated::Undated => undated += 1,
                }
                prop_assert!(undated <= 4);
            }
        }
    }
}
