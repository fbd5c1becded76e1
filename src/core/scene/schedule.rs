//! Which frame is exposed when, and when its measurement may be used: the one rule that the camera and a lockstep
//! control share. Irregular cameras are part of it, so that even lost and late frames repeat.

use crate::faults::FrameFaults;
use crate::time::{SpanNs, TICK};
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// How irregular a simulated camera is.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Irregularity {
    /// Largest delay of a frame; delays are uniformly distributed.
    pub jitter: SpanNs,
    /// Share of the frames that are lost, 0 to 1.
    pub loss: f64,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Times of exposure of a camera with a constant rate, frame 0 at time 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameSchedule {
    period_ns: f64,
    latency: SpanNs,
    irregularity: Irregularity,
    faults: FrameFaults,
}

impl FrameSchedule {
    /// A schedule for `rate_hz`, which must be positive; above 1 kHz frames would share ticks. `latency` lies between
    /// the middle of the exposure and the hand-over of the frame.
    #[must_use]
    pub fn new(rate_hz: f64, latency: SpanNs, irregularity: Irregularity) -> Self {
        Self { period_ns: 1e9 / rate_hz, latency, irregularity, faults: FrameFaults::default() }
    }

    /// The same with faults, which count their time from the exposure of frame 0.
    #[must_use]
    pub fn with_faults(self, faults: FrameFaults) -> Self {
        Self { faults, ..self }
    }

    /// The faults of its frames.
    #[must_use]
    pub fn faults(&self) -> FrameFaults {
        self.faults
    }

    /// Middle of the exposure of frame `id`, from that of frame 0.
    #[must_use]
    pub fn exposure(&self, id: u64) -> SpanNs {
        SpanNs((id as f64 * self.period_ns).round() as i64)
    }

    /// Middle of the exposure of frame `id` to its hand-over.
    #[must_use]
    pub fn latency(&self, id: u64) -> SpanNs {
        let late = self.faults.delay(self.exposure(id), id);
        SpanNs(self.latency.0 + (self.random(id, 1) * self.irregularity.jitter.0 as f64) as i64 + late.0)
    }

    /// By how much a frame may be late beyond its latency.
    #[must_use]
    pub fn jitter(&self) -> SpanNs {
        self.irregularity.jitter
    }

    /// Whether the camera loses frame `id`.
    #[must_use]
    pub fn is_lost(&self, id: u64) -> bool {
        self.random(id, 2) < self.irregularity.loss || self.faults.drops(self.exposure(id), id)
    }

    /// The first tick at or after the exposure of frame `id`: the one whose state a lockstep camera shows.
    #[must_use]
    pub fn exposure_tick(&self, id: u64) -> u64 {
        ceil_ticks(self.exposure(id))
    }

    /// The frame that belongs to `tick`, if any; it may be a lost one.
    #[must_use]
    pub fn frame_at(&self, tick: u64) -> Option<u64> {
        let near = (tick as f64 * TICK.0 as f64 / self.period_ns).floor() as u64;
        (near.saturating_sub(1)..=near.saturating_add(1)).find(|id| self.exposure_tick(*id) == tick)
    }

    /// The first tick after `tick` to which a frame belongs.
    #[must_use]
    pub fn next_exposure_tick(&self, tick: u64) -> u64 {
        let near = (tick as f64 * TICK.0 as f64 / self.period_ns).floor() as u64;
        // The next frame is this one or one of those after it, several where frames are faster than ticks. Numbers far beyond any run are not
        // exact any more: then no frame is found.
        let reach = 2 + (TICK.0 as f64 / self.period_ns).ceil() as u64;
        let mut ticks = (near..near.saturating_add(reach)).map(|id| self.exposure_tick(id));
        ticks.find(|exposure| *exposure > tick).unwrap_or(u64::MAX)
    }

    /// The first tick that may use the measurement of frame `id`. Frames do not overtake one another.
    #[must_use]
    pub fn usable_tick(&self, id: u64) -> u64 {
        // A later frame is handed over no earlier than those before it. By jitter and faults, so many earlier frames can be later than this one.
        let late = self.irregularity.jitter.0 + self.faults.longest_delay().0;
        let reach = (late as f64 / self.period_ns).ceil() as u64;
        let tick = |i| self.exposure_tick(i) + ceil_ticks(self.latency(i));
        (id.saturating_sub(reach)..=id).map(tick).max().unwrap_or(0)
    }

    /// How many frames can be on their way at once in lockstep, with one to spare.
    #[must_use]
    pub fn in_flight(&self) -> usize {
        let longest = self.latency.0 + self.irregularity.jitter.0 + self.faults.longest_delay().0;
        (longest as f64 / self.period_ns).ceil() as usize + 2
    }

    /// A uniform random number in [0, 1) of frame `id`, the same in every process.
    fn random(&self, id: u64, purpose: u64) -> f64 {
        let seed = self.irregularity.seed ^ purpose.rotate_right(8);
        (xxh3_64_with_seed(&id.to_le_bytes(), seed) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn ceil_ticks(span: SpanNs) -> u64 {
    span.0.max(0).unsigned_abs().div_ceil(TICK.0.unsigned_abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LATENCY: SpanNs = SpanNs(20_000_000);

    /// Such ticks come from a broken or hostile program; who asks for the next frame after them is answered at once.
    #[test]
    fn ticks_that_no_run_comes_to_have_an_answer_too() {
        for rate_hz in [0.1, 25.0, 60.0, 999.0] {
            for tick in [1 << 53, 1 << 62, u64::MAX - 1, u64::MAX] {
                let s = regular(rate_hz);
                assert!(s.next_exposure_tick(tick) >= tick);
                let _ = s.frame_at(tick);
            }
        }
    }

    fn regular(rate_hz: f64) -> FrameSchedule {
        FrameSchedule::new(rate_hz, LATENCY, Irregularity::default())
    }

    proptest! {
        #[test]
        fn the_next_exposure_is_the_next_tick_with_a_frame(rate_hz in 0.5..1000.0f64, tick in 0u64..100_000) {
            let s = regular(rate_hz);
            let next = s.next_exposure_tick(tick);
            prop_assert_eq!((tick + 1..).find(|t| s.frame_at(*t).is_some()), Some(next));
        }

        #[test]
        fn every_frame_has_one_tick(rate_hz in 0.1..1000.0f64, id in 0u64..5_000) {
            let s = regular(rate_hz);
            let tick = s.exposure_tick(id);
            prop_assert_eq!(s.frame_at(tick), Some(id));
            prop_assert!(s.exposure_tick(id + 1) > tick);
            prop_assert!(s.exposure(id).0 <= tick as i64 * TICK.0);
            prop_assert!(tick as i64 * TICK.0 - s.exposure(id).0 < TICK.0);
        }

        #[test]
        fn late_frames_stay_in_order_and_within_the_jitter(rate_hz in 1.0..1000.0f64, id in 0u64..2_000, seed: u64) {
            let jitter = SpanNs(30_000_000);
            let s = FrameSchedule::new(rate_hz, LATENCY, Irregularity { jitter, loss: 0.1, seed });
            let usable = s.usable_tick(id);
            prop_assert!(usable <= s.usable_tick(id + 1));
            prop_assert!(usable >= s.exposure_tick(id) + 20);
            prop_assert!(usable <= s.exposure_tick(id) + 50);
            prop_assert_eq!(usable, s.usable_tick(id), "the same to whoever asks");
        }
    }

    #[test]
    fn whole_ratios_are_exact() {
        let s = regular(25.0);
        assert_eq!((0..4).map(|i| s.exposure_tick(i)).collect::<Vec<_>>(), [0, 40, 80, 120]);
        assert_eq!(s.frame_at(39), None);
        assert_eq!(s.usable_tick(1), 60);
        let odd = FrameSchedule::new(25.0, SpanNs(20_000_001), Irregularity::default());
        assert_eq!(odd.usable_tick(1), 61);
        assert_eq!(regular(1000.0).frame_at(17), Some(17));
    }

    #[test]
    fn frames_in_flight_cover_the_latency() {
        assert_eq!(regular(25.0).in_flight(), 3);
        assert_eq!(regular(1000.0).in_flight(), 22);
    }

    #[test]
    fn the_configured_share_of_frames_is_lost_and_seeds_differ() {
        let lost = |seed| {
            let s = FrameSchedule::new(25.0, LATENCY, Irregularity { jitter: SpanNs(0), loss: 0.1, seed });
            (0..10_000).filter(|id| s.is_lost(*id)).collect::<Vec<_>>()
        };
        assert!((900..1100).contains(&lost(1).len()), "{}", lost(1).len());
        assert_ne!(lost(1), lost(2));
        assert!((0..1000).all(|id| !regular(25.0).is_lost(id)));
    }
}
