//! Where the time goes from light to command: histograms of the stages of all measurements.

use crate::control::trace::LatencyStages;
use crate::report::histogram::SpanHistogram;
use crate::report::summary::Latencies;
use crate::time::SpanNs;

/// Histograms of all stages of a run.
#[derive(Debug, Clone, Default)]
pub struct LatencyTable {
    exposure_to_frame: SpanHistogram,
    frame_to_vision: SpanHistogram,
    vision: SpanHistogram,
    frame_to_measurement: SpanHistogram,
    measurement_to_command: SpanHistogram,
    exposure_to_command: SpanHistogram,
}

impl LatencyTable {
    /// Counts a measurement whose command was written.
    pub fn record(&mut self, stages: &LatencyStages) {
        let whole_of_vision = stages.frame_to_vision.zip(stages.vision).map(|(a, b)| SpanNs(a.0 + b.0));
        for (histogram, span) in [
            (&mut self.exposure_to_frame, stages.exposure_to_frame),
            (&mut self.frame_to_vision, stages.frame_to_vision),
            (&mut self.vision, stages.vision),
            (&mut self.frame_to_measurement, whole_of_vision),
            (&mut self.measurement_to_command, stages.measurement_to_command),
            (&mut self.exposure_to_command, stages.exposure_to_command),
        ] {
            if let Some(span) = span {
                histogram.record(span);
            }
        }
    }

    /// Quantiles of all stages, us.
    #[must_use]
    pub fn quantiles_us(&self) -> Latencies {
        Latencies {
            exposure_to_command: self.exposure_to_command.quantiles_us(),
            exposure_to_frame: self.exposure_to_frame.quantiles_us(),
            frame_to_vision: self.frame_to_vision.quantiles_us(),
            vision: self.vision.quantiles_us(),
            frame_to_measurement: self.frame_to_measurement.quantiles_us(),
            measurement_to_command: self.measurement_to_command.quantiles_us(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::trace::FrameStamps;
    use crate::messages::Measurement;
    use crate::time::MonoNs;

    fn measurement() -> Measurement {
        Measurement {
            exposure: MonoNs(1_000),
            frame_sent: MonoNs(21_000),
            vision_start: MonoNs(24_000),
            vision_end: MonoNs(31_000),
            ..Measurement::default()
        }
    }

    #[test]
    fn stages_add_up_to_the_whole() {
        let s = LatencyStages::of(&FrameStamps::of(&measurement()), MonoNs(40_000), true);
        let parts = [s.exposure_to_frame, s.frame_to_vision, s.vision, s.measurement_to_command];
        let sum: i64 = parts.iter().map(|p| p.unwrap().0).sum();
        assert_eq!(sum, s.exposure_to_command.unwrap().0);
        let mut table = LatencyTable::default();
        table.record(&s);
        let q = table.quantiles_us();
        assert_eq!((q.exposure_to_command.max, q.frame_to_measurement.max), (39.0, 10.0));
    }

    #[test]
    fn spans_across_two_clocks_are_not_counted() {
        let mut table = LatencyTable::default();
        table.record(&LatencyStages::of(&FrameStamps::of(&measurement()), MonoNs(20_001_000), false));
        let q = table.quantiles_us();
        assert_eq!((q.exposure_to_frame.max, q.measurement_to_command.max), (0.0, 0.0));
        assert_eq!((q.exposure_to_command.max, q.vision.max), (20_000.0, 7.0));
    }

    #[test]
    fn stamps_that_no_clock_has_are_not_counted() {
        let mut table = LatencyTable::default();
        for wild in [i64::MIN, -9_000_000_000_000_000_000, 9_000_000_000_000_000_000, i64::MAX] {
            let m = Measurement { exposure: MonoNs(wild), vision_end: MonoNs(wild), ..measurement() };
            table.record(&LatencyStages::of(&FrameStamps::of(&m), MonoNs(40_000), true));
        }
        let q = table.quantiles_us();
        assert_eq!((q.exposure_to_command.max, q.vision.max, q.frame_to_vision.max), (0.0, 0.0, 3.0));
    }
}
