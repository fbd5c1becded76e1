//! Velocity corrections from a camera: the joint displacement between two exposures in excess of the estimated one, divided by the time
//! between them, is a velocity error. Corrections that were applied since those exposures are subtracted, because the images could not
//! show them yet.

use crate::servo::UnobservedMotion;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;

/// T in the gain `span / (span + T)` of a correction over the time `span` between two exposures, s. Chosen by hand: for cameras slower
/// than 100 Hz most of an error is corrected at once. With half of it `a_drift_dies_out_without_swinging_whatever_the_latency` fails.
const TIME_S: f64 = 0.01;
/// Rate at which a velocity correction also enters the disturbance, 1/s. Chosen by hand: it must be far below the rate of the velocity
/// correction, 1 / (span + T), 20 1/s for a camera at 25 Hz; otherwise the two oscillate.
pub(super) const RATE_1_S: f64 = 1.25;
/// Share by which each correction moves the trust in the camera towards 1, and the time constant of its decay, s. Chosen by hand: at 25 Hz
/// the two balance at a trust of 0.91, and without images it is lost within seconds.
const GAIN_OF_TRUST: f64 = 0.3;
const TRUST_LASTS_S: f64 = 1.0;
/// Corrections that are remembered: as many as come within 160 ms from a camera at 100 Hz, so that latencies of up to 150 ms are covered
/// (tested below). From faster cameras the surplus is skipped.
const REMEMBERED: usize = 16;

/// The last corrections, each with its time.
#[derive(Debug, Clone)]
pub(super) struct CameraCorrection<const N: usize> {
    corrections: [(MonoNs, SVector<f64, N>); REMEMBERED],
    next: usize,
    /// How much the velocity of each joint relies on the camera, 0 to 1.
    trust: SVector<f64, N>,
}

impl<const N: usize> Default for CameraCorrection<N> {
    fn default() -> Self {
        let none = (MonoNs::ZERO, SVector::zeros());
        Self { corrections: [none; REMEMBERED], next: 0, trust: SVector::zeros() }
    }
}

impl<const N: usize> CameraCorrection<N> {
    /// The correction of the velocities, rad/s or m/s, that `drift` requires at `now`. A displacement of more than an encoder `step` is
    /// visible to the encoder itself, and so is a motion of the reference with `velocity` that produces steps often enough: neither is corrected.
    pub(super) fn correction(
        &mut self,
        drift: &UnobservedMotion<N>,
        now: MonoNs,
        step: &SVector<f64, N>,
        velocity: &SVector<f64, N>,
    ) -> SVector<f64, N> {
        let span_s = drift.span.as_s();
        // A correction that no image shows yet must stay remembered: a drift that would overwrite one is skipped.
        let (oldest, _) = self.corrections[self.next % REMEMBERED];
        if drift.span <= SpanNs::ZERO || oldest > drift.from + drift.span {
            return SVector::zeros();
        }
        let since = self.since(drift);
        let gain = span_s / (span_s + TIME_S);
        let dv = SVector::from_fn(|i, _| {
            let (dq, step) = (drift.dq[i], step[i]);
            let slow = 1.0 - velocity[i].abs() * span_s / step;
            // The comparison is false for joints without encoder steps and for NaN, which are not corrected.
            if !(dq.abs() < step && slow > 0.0) {
                return 0.0;
            }
            self.trust[i] += (1.0 - self.trust[i]) * GAIN_OF_TRUST * slow;
            gain * slow * (dq / span_s - since[i])
        });
        self.corrections[self.next % REMEMBERED] = (now, dv);
        self.next += 1;
        dv
    }

    /// Lets trust decay by one tick; how much the velocity of each joint relies on the camera, 0 to 1.
    pub(super) fn trust(&mut self) -> &SVector<f64, N> {
        self.trust *= 1.0 - TICK.as_s() / TRUST_LASTS_S;
        &self.trust
    }

    /// The sum of the corrections since the exposures of `drift`, averaged over the time between them.
    fn since(&self, drift: &UnobservedMotion<N>) -> SVector<f64, N> {
        self.corrections.iter().fold(SVector::zeros(), |sum, (at, dv)| {
            let share = (*at - drift.from).as_s() / drift.span.as_s();
            sum + dv * share.clamp(0.0, 1.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;
    use std::collections::VecDeque;

    const MS: i64 = 1_000_000;

    /// An arm that moves at 1 mrad/s is estimated to stand: the velocity errors after each of `frames`, whose measurements arrive `latency` ms
    /// after their exposures, every `period` ms.
    fn left_after(frames: i64, period: i64, latency: i64) -> Vec<f64> {
        let mut seen = CameraCorrection::<1>::default();
        let (mut error, mut errors) = (1e-3, vec![]);
        let mut history = vec![error];
        let mut under_way: VecDeque<(i64, UnobservedMotion<1>)> = VecDeque::new();
        for ms in 1..frames * period {
            history.push(error);
            if ms % period == 0 {
                let from = ms - period;
                let dq: f64 = history[from as usize..ms as usize].iter().sum::<f64>() * 1e-3;
                let drift = UnobservedMotion {
                    dq: Vector1::new(dq),
                    from: MonoNs(from * MS),
                    span: SpanNs(period * MS),
                };
                under_way.push_back((ms + latency, drift));
            }
            while let Some((_, drift)) = under_way.pop_front_if(|(at, _)| *at <= ms) {
                let (step, rest) = (Vector1::new(5e-4), Vector1::zeros());
                error -= seen.correction(&drift, MonoNs(ms * MS), &step, &rest)[0];
                errors.push(error);
            }
        }
        errors
    }

    #[test]
    fn a_drift_dies_out_without_swinging_whatever_the_latency() {
        for period in [1, 2, 10, 40, 100] {
            for latency in [1, 20, 80, 150] {
                // As long as with the slowest camera and the longest latency, so that all have the time.
                let errors = left_after((60 * 40 / period).max(60), period, latency);
                assert!(errors.iter().all(|e| (-5e-5..=1e-3).contains(e)), "{period} {latency}: {errors:?}");
                assert!(errors.last().unwrap().abs() < 2e-5, "{period} {latency}: {errors:?}");
            }
        }
    }

    #[test]
    fn exact_encoders_moving_joints_and_leaps_are_left_alone() {
        let drift = UnobservedMotion { dq: Vector1::new(1e-4), from: MonoNs::ZERO, span: SpanNs(40 * MS) };
        let ask = |drift: UnobservedMotion<1>, step: f64, velocity: f64| {
            let (step, velocity) = (Vector1::new(step), Vector1::new(velocity));
            CameraCorrection::default().correction(&drift, MonoNs(60 * MS), &step, &velocity)[0]
        };
        assert!(ask(drift, 5e-4, 0.0) > 1e-3);
        assert_eq!(ask(drift, 0.0, 0.0), 0.0);
        assert_eq!(ask(drift, 5e-4, 0.02), 0.0);
        assert_eq!(ask(drift, 1e-5, 0.0), 0.0);
        assert_eq!(ask(UnobservedMotion { dq: Vector1::new(f64::NAN), ..drift }, 5e-4, 0.0), 0.0);
        assert_eq!(ask(UnobservedMotion { span: SpanNs::ZERO, ..drift }, 5e-4, 0.0), 0.0);
    }
}
