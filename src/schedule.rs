//! Which frame is exposed when: the one rule that the camera and a lockstep control share.

use crate::time::SpanNs;

/// Length of a control tick.
pub const TICK: SpanNs = SpanNs::MILLISECOND;

/// Times of exposure of a camera with a constant rate, frame 0 at time 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameSchedule {
    period_ns: f64,
}

impl FrameSchedule {
    /// A schedule for `rate_hz`, which must be positive; above 1 kHz frames would share ticks.
    #[must_use]
    pub fn new(rate_hz: f64) -> Self {
        Self { period_ns: 1e9 / rate_hz }
    }

    /// Middle of the exposure of frame `id`, from that of frame 0.
    #[must_use]
    pub fn exposure(&self, id: u64) -> SpanNs {
        SpanNs((id as f64 * self.period_ns).round() as i64)
    }

    /// The first tick at or after the exposure of frame `id`: the one whose state a lockstep camera shows.
    #[must_use]
    pub fn exposure_tick(&self, id: u64) -> u64 {
        ceil_ticks(self.exposure(id))
    }

    /// The frame that belongs to `tick`, if any.
    #[must_use]
    pub fn frame_at(&self, tick: u64) -> Option<u64> {
        let near = (tick as f64 * TICK.0 as f64 / self.period_ns).floor() as u64;
        (near.saturating_sub(1)..=near + 1).find(|id| self.exposure_tick(*id) == tick)
    }

    /// The first tick that may use the measurement of frame `id` after `latency`.
    #[must_use]
    pub fn usable_tick(&self, id: u64, latency: SpanNs) -> u64 {
        self.exposure_tick(id) + ceil_ticks(latency)
    }

    /// How many frames can be on their way at once in lockstep, with one to spare.
    #[must_use]
    pub fn in_flight(&self, latency: SpanNs) -> usize {
        (latency.0 as f64 / self.period_ns).ceil() as usize + 2
    }
}

fn ceil_ticks(span: SpanNs) -> u64 {
    span.0.max(0).unsigned_abs().div_ceil(TICK.0.unsigned_abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_frame_has_one_tick(rate_hz in 0.1..1000.0f64, id in 0u64..5_000) {
            let s = FrameSchedule::new(rate_hz);
            let tick = s.exposure_tick(id);
            prop_assert_eq!(s.frame_at(tick), Some(id));
            prop_assert!(s.exposure_tick(id + 1) > tick);
            prop_assert!(s.exposure(id).0 <= tick as i64 * TICK.0);
            prop_assert!(tick as i64 * TICK.0 - s.exposure(id).0 < TICK.0);
        }
    }

    #[test]
    fn whole_ratios_are_exact() {
        let s = FrameSchedule::new(25.0);
        assert_eq!((0..4).map(|i| s.exposure_tick(i)).collect::<Vec<_>>(), [0, 40, 80, 120]);
        assert_eq!(s.frame_at(39), None);
        assert_eq!(s.usable_tick(1, SpanNs(20_000_000)), 60);
        assert_eq!(s.usable_tick(1, SpanNs(20_000_001)), 61);
        assert_eq!(FrameSchedule::new(1000.0).frame_at(17), Some(17));
    }

    #[test]
    fn frames_in_flight_cover_the_latency() {
        assert_eq!(FrameSchedule::new(25.0).in_flight(SpanNs(20_000_000)), 3);
        assert_eq!(FrameSchedule::new(1000.0).in_flight(SpanNs(20_000_000)), 22);
    }
}
