//! The small counts of a stream: the driver's sequence numbers, pauses between attempts, the rate that is really obtained.

use crate::time::{MonoNs, SpanNs};

/// Largest step of the driver's count; a larger one means that the count has restarted. Chosen by hand: a million frames are ten hours at 25 Hz.
const MAX_GAP: u32 = 1 << 20;

/// From the driver's count of 32 bits, which wraps and begins anew with each stream, to one that goes on.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SequenceCount {
    last: Option<u32>,
    number: u64,
    stands: bool,
}

impl SequenceCount {
    /// The number of the frame that the driver numbers `raw`. A gap in the driver's count is one in ours; a count that stands still
    /// or begins anew goes on by one.
    pub(super) fn number(&mut self, raw: u32) -> u64 {
        let first = self.last.is_none() && self.number == 0;
        self.stands = self.last.is_some_and(|last| !(1..=MAX_GAP).contains(&raw.wrapping_sub(last)));
        let step = match self.last.map(|last| raw.wrapping_sub(last)) {
            Some(step @ 1..=MAX_GAP) => u64::from(step),
            Some(_) => 1,
            None => u64::from(!first),
        };
        self.number += step;
        self.last = Some(raw);
        self.number
    }

    /// Whether the last frame had a number that does not go on from the one before.
    pub(super) fn stands(&self) -> bool {
        self.stands
    }

    /// A new stream begins: what was lost meanwhile nobody knows.
    pub(super) fn restart(&mut self) {
        if self.last.take().is_some() && self.number == 0 {
            self.number = 1;
        }
    }
}

/// Pauses that grow.
#[derive(Debug, Clone, Copy)]
pub(super) struct Backoff {
    next: SpanNs,
}

impl Backoff {
    // Chosen by hand: a device that was just plugged in is usable within some tenths of a second, and one attempt a second costs nothing.
    const FIRST: SpanNs = SpanNs(100_000_000);
    const LONGEST: SpanNs = SpanNs(1_000_000_000);

    pub(super) fn new() -> Self {
        Self { next: Self::FIRST }
    }

    /// How long to wait this time.
    pub(super) fn pause(&mut self) -> SpanNs {
        let pause = self.next;
        self.next = SpanNs(pause.0 * 3 / 2).min(Self::LONGEST);
        pause
    }
}

/// The rate at which a device really exposes, from its own count and stamps.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RateMeter {
    begin: Option<(MonoNs, u64)>,
    measured_hz: Option<f64>,
}

impl RateMeter {
    /// Over how long it is measured.
    const SPAN: SpanNs = SpanNs(2_000_000_000);

    /// Takes a frame in; true when there is a new measurement.
    pub(super) fn note(&mut self, mid: MonoNs, sequence: u64) -> bool {
        let Some((begin, first)) = self.begin else {
            self.begin = Some((mid, sequence));
            return false;
        };
        let (span, frames) = (mid - begin, sequence.saturating_sub(first));
        if span < Self::SPAN || frames < 2 {
            return false;
        }
        self.measured_hz = Some(frames as f64 / span.as_s());
        self.begin = Some((mid, sequence));
        true
    }

    /// The stream was interrupted.
    pub(super) fn restart(&mut self) {
        self.begin = None;
    }

    /// Frames per second; `None` before the first measurement.
    pub(super) fn measured_hz(&self) -> Option<f64> {
        self.measured_hz
    }
}

/// When the exposure of a device in automatic mode is read again: so rarely that it takes no more than a share of the time, because the request
/// may go to the camera and back.
#[derive(Debug, Clone, Copy)]
pub(super) struct ReadingPlan {
    every: u32,
    left: u32,
}

impl ReadingPlan {
    // Chosen by hand: at most every 8th frame, since automatic exposure changes over many frames, and at most 1 % of the time.
    const MAX_OFTEN: u32 = 8;
    const MAX_SHARE: f64 = 0.01;

    pub(super) fn new() -> Self {
        Self { every: Self::MAX_OFTEN, left: Self::MAX_OFTEN }
    }

    /// A frame has passed; true when it is time to read.
    pub(super) fn is_due(&mut self) -> bool {
        self.left = self.left.saturating_sub(1);
        if self.left > 0 {
            return false;
        }
        self.left = self.every;
        true
    }

    /// Reading took `cost`, where frames are `period` apart.
    pub(super) fn took(&mut self, cost: SpanNs, period: SpanNs) {
        // a stream that says no period must not divide by 0
        let frames = cost.as_s() / (Self::MAX_SHARE * period.as_s().max(1e-6));
        self.every = (frames.ceil() as u32).clamp(Self::MAX_OFTEN, 10_000);
        self.left = self.every;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn gaps_count_and_wraps_do_not() {
        let mut count = SequenceCount::default();
        let raw = [u32::MAX - 2, u32::MAX - 1, 0, 1, 5, 5, 5, 2, 3];
        let mut stands = Vec::new();
        let numbers = raw.map(|n| {
            let number = count.number(n);
            stands.push(count.stands());
            number
        });
        assert_eq!(numbers, [0, 1, 3, 4, 8, 9, 10, 11, 12]);
        assert_eq!(stands, [false, false, false, false, false, true, true, true, false]);
        count.restart();
        assert_eq!([700, 701].map(|n| count.number(n)), [13, 14]);
    }

    #[test]
    fn a_stream_that_ends_after_its_first_frame_has_counted_it() {
        let mut count = SequenceCount::default();
        assert_eq!(count.number(9), 0);
        count.restart();
        assert_eq!([0, 1].map(|n| count.number(n)), [1, 2].map(|n: u64| n + 1));
    }

    #[test]
    fn pauses_grow_to_a_second() {
        let mut backoff = Backoff::new();
        let pauses: Vec<_> = (0..12).map(|_| backoff.pause().0 / 1_000_000).collect();
        assert_eq!(pauses[..3], [100, 150, 225]);
        assert!(pauses.windows(2).all(|w| w[0] <= w[1]) && pauses[11] == 1000);
    }

    #[test]
    fn the_rate_is_the_device_rate_including_lost_frames() {
        let mut meter = RateMeter::default();
        let mut told = 0;
        for k in (0..400_u64).filter(|k| k % 3 != 1) {
            told += u32::from(meter.note(MonoNs(k as i64 * 11_111_111), k));
        }
        assert!((meter.measured_hz().unwrap() - 90.0).abs() < 0.01 && told == 2, "{meter:?} {told}");
    }

    #[test]
    fn a_dear_reading_is_rare() {
        let mut plan = ReadingPlan::new();
        assert_eq!((0..8).filter(|_| plan.is_due()).count(), 1);
        plan.took(SpanNs(4_000_000), SpanNs(40_000_000)); // a tenth of a period
        assert_eq!((0..100).filter(|_| plan.is_due()).count(), 10);
        plan.took(SpanNs(10_000), SpanNs(40_000_000));
        assert_eq!((0..80).filter(|_| plan.is_due()).count(), 10);
    }

    proptest! {
        #[test]
        fn numbers_only_grow(raw in proptest::collection::vec(any::<u32>(), 1..100), restart in 0..100_usize) {
            let mut count = SequenceCount::default();
            let mut before = None;
            for (k, n) in raw.into_iter().enumerate() {
                if k == restart {
                    count.restart();
                }
                let number = count.number(n);
                prop_assert!(before.is_none_or(|b| number > b));
                before = Some(number);
            }
        }
    }
}
