//! How delay between exposure and use limits the gain of schemes B and D, for the update policies `frame` and `predict`.
//!
//! Vision at 25 Hz, control at 1 kHz. The arm is an ideal positioning device, (10.75), or follows the reference rate
//! with a first-order lag. With the ideal arm, T = 0.04 s and a delay of d frames, `frame` gives
//! `e[k+1] = e[k] - K T e[k-d]`: stable up to K T = 2, 1, 0.618 for d = 0, 1, 2.
//!
//! `predict` is judged at one gain: the quickest that stays well stable when stamps or depths are wrong (it may then
//! take four times as long as the best `frame`). That gain must do as well when frames are lost or late.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

mod closed_loop;

pub use closed_loop::{DelayedLoop, Disturbance};

use super::findings::Findings;
use super::plot::{Panel, Series, Symbol, figure};
use super::schemes::Scheme;
use super::{Cell, ExperimentError, Options};
use crate::servo::UpdatePolicy;
use closed_loop::{GAINS_1_S, TICK_S};
use serde::Serialize;

/// Delays of the study, ms.
pub const DELAYS_MS: [usize; 3] = [0, 40, 80];
/// Lag of the second kind of arm, s.
const LAG_S: f64 = 0.02;
/// Stamp errors that `predict` has to bear, ms.
const STAMP_ERRORS_MS: [i64; 2] = [-10, 10];
/// Depths that it has to bear, as multiples of the true ones.
const DEPTH_SCALES: [f64; 2] = [0.8, 1.2];
/// Irregular cameras: jitter in ms, share of lost frames, and how many such cameras.
const JITTER_MS: usize = 10;
const LOSS: f64 = 0.1;
const CAMERAS: u64 = 20;
/// With wrong stamps or depths `predict` may take so many times as long as the best `frame` takes without.
const WRONG_MAY_TAKE: f64 = 4.0;
/// Gains tried up to the largest stable one, evenly in their logarithm.
const GAINS: u32 = 60;
/// Least gain tried, 1/s.
const MIN_GAIN_1_S: f64 = 2.0;

/// A gain and how quickly the loop settles with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Best {
    /// 1/s.
    pub gain_1_s: f64,
    /// To 2 %, s.
    pub settling_time_s: f64,
}

/// What the study finds out about one scheme, arm and delay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Finding {
    /// Largest stable gain under `frame`, 1/s.
    pub frame_largest_stable_gain_1_s: f64,
    /// The quickest gain of `frame`.
    pub frame: Best,
    /// Largest stable gain under `predict`, 1/s, without model errors; values of 4000 and more are not distinguished.
    pub predict_largest_stable_gain_1_s: f64,
    /// The quickest gain of `predict` that bears every wrong stamp and depth too.
    pub predict: Best,
    /// How many times quicker `predict` settles.
    pub speed_up: f64,
    /// The same with the gain of `predict`, frames lost and late: mean over irregular cameras.
    pub irregular_settling_time_s: f64,
    /// How many times quicker than `frame` that is, whose camera stays regular.
    pub irregular_speed_up: f64,
    /// Slowest settling with the same gain under wrong stamps and depths, s.
    pub wrong_settling_time_s: f64,
}

/// Every stamp and depth error that `predict` has to bear.
#[must_use]
pub fn errors_to_bear() -> Vec<Disturbance> {
    let stamps = STAMP_ERRORS_MS.map(|stamp_error_ms| Disturbance { stamp_error_ms, ..Disturbance::NONE });
    let depths = DEPTH_SCALES.map(|depth_scale| Disturbance { depth_scale, ..Disturbance::NONE });
    stamps.into_iter().chain(depths).collect()
}

fn irregular_cameras() -> impl Iterator<Item = Disturbance> {
    (1..=CAMERAS).map(|seed| Disturbance { jitter_ms: JITTER_MS, loss: LOSS, seed, ..Disturbance::NONE })
}

/// The quickest gain up to `largest` with which `studied` settles and which `admits` lets pass.
fn quickest(
    cell: &Cell,
    studied: &DelayedLoop,
    largest: f64,
    mut admits: impl FnMut(f64) -> Result<bool, ExperimentError>,
) -> Result<Best, ExperimentError> {
    let mut best = Best { gain_1_s: f64::NAN, settling_time_s: f64::INFINITY };
    for i in 1..=GAINS {
        let gain_1_s = MIN_GAIN_1_S * (largest / MIN_GAIN_1_S).powf(f64::from(i) / f64::from(GAINS));
        if let Some(settling_time_s) = studied.settling_time(cell, gain_1_s)?
            && settling_time_s < best.settling_time_s
            && admits(gain_1_s)?
        {
            best = Best { gain_1_s, settling_time_s };
        }
    }
    Ok(best)
}

/// Studies `scheme` (B or D) with an arm of lag `lag_s` (s) and `delay_ms` from exposure to use.
///
/// # Errors
/// [`ExperimentError::Cell`].
pub fn study(cell: &Cell, scheme: Scheme, lag_s: f64, delay_ms: usize) -> Result<Finding, ExperimentError> {
    let nominal = |update| DelayedLoop { scheme, update, delay_ms, lag_s, disturbance: Disturbance::NONE };
    let (frame, predict) = (nominal(UpdatePolicy::Frame), nominal(UpdatePolicy::Predict));
    let frame_largest = frame.largest_stable_gain(cell)?;
    let predict_largest = predict.largest_stable_gain(cell)?;
    let frame_best = quickest(cell, &frame, frame_largest, |_| Ok(true))?;
    let best = quickest(cell, &predict, predict_largest, |gain| {
        errors_to_bear().into_iter().try_fold(true, |all, wrong| {
            let settled = predict.disturbed(wrong).settling_time(cell, gain)?;
            Ok(all && settled.is_some_and(|t| t <= WRONG_MAY_TAKE * frame_best.settling_time_s))
        })
    })?;
    let settling = |disturbance| -> Result<f64, ExperimentError> {
        Ok(predict.disturbed(disturbance).settling_time(cell, best.gain_1_s)?.unwrap_or(f64::INFINITY))
    };
    let mut irregular = 0.0;
    for camera in irregular_cameras() {
        irregular += settling(camera)? / CAMERAS as f64;
    }
    let mut wrong_settling_time_s = 0.0_f64;
    for wrong in errors_to_bear() {
        wrong_settling_time_s = wrong_settling_time_s.max(settling(wrong)?);
    }
    Ok(Finding {
        frame_largest_stable_gain_1_s: frame_largest,
        frame: frame_best,
        predict_largest_stable_gain_1_s: predict_largest,
        predict: best,
        speed_up: frame_best.settling_time_s / best.settling_time_s,
        irregular_settling_time_s: irregular,
        irregular_speed_up: frame_best.settling_time_s / irregular,
        wrong_settling_time_s,
    })
}

#[derive(Serialize)]
struct DelayResult {
    arm: &'static str,
    scheme: &'static str,
    delay_ms: usize,
    #[serde(flatten)]
    finding: Finding,
}

pub(super) fn gain_delay(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let cell = Cell::textbook()?;
    let mut out = Findings::default();
    let mut table = String::from(
        "arm,scheme,delay_ms,frame_largest_stable_gain_1_s,frame_best_gain_1_s,frame_settling_time_s,\
         predict_largest_stable_gain_1_s,predict_gain_1_s,predict_settling_time_s,speed_up,\
         irregular_settling_time_s,irregular_speed_up,wrong_settling_time_s\n",
    );
    let mut entries = Vec::new();
    let mut limits = Panel::new("largest stable gain", "delay [ms]", "K [1/s]").log_y();
    let mut times = Panel::new("settling time", "delay [ms]", "t [s]").log_y();
    let mut responses = Panel::new("scheme D, lagged arm", "t [s]", "error [m + rad]");
    for (arm, lag_s, mark) in [("ideal", 0.0, Symbol::Dashed), ("lag 20 ms", LAG_S, Symbol::Line)] {
        for (i, scheme) in [Scheme::B, Scheme::D].into_iter().enumerate() {
            let mut curves = [const { Vec::new() }; 4];
            for (k, delay_ms) in DELAYS_MS.into_iter().enumerate() {
                (options.progress)(&format!("{arm} arm, scheme {}, {delay_ms} ms", scheme.name()));
                let f = study(&cell, scheme, lag_s, delay_ms)?;
                table += &row(arm, scheme, delay_ms, &f);
                out.lines.push(line(arm, scheme, delay_ms, &f));
                entries.push(DelayResult { arm, scheme: scheme.name(), delay_ms, finding: f });
                let values = [
                    f.frame_largest_stable_gain_1_s,
                    f.predict_largest_stable_gain_1_s,
                    f.frame.settling_time_s,
                    f.predict.settling_time_s,
                ];
                for (curve, value) in curves.iter_mut().zip(values) {
                    curve.push((delay_ms as f64, value));
                }
                if lag_s > 0.0 && scheme == Scheme::D {
                    for (update, best, mark, name) in [
                        (UpdatePolicy::Frame, f.frame, Symbol::Dashed, "frame"),
                        (UpdatePolicy::Predict, f.predict, Symbol::Line, "predict"),
                    ] {
                        let studied =
                            DelayedLoop { scheme, update, delay_ms, lag_s, disturbance: Disturbance::NONE };
                        let errors = studied.run(&cell, best.gain_1_s)?;
                        let points = errors.into_iter().take(1000).enumerate();
                        let points = points.map(|(t, e)| (t as f64 * TICK_S, e));
                        responses.push(Series::new(mark, k, points).label(format!("{name} {delay_ms} ms")));
                    }
                }
            }
            for (j, curve) in curves.into_iter().enumerate() {
                let name = if j % 2 == 0 { "frame" } else { "predict" };
                let series =
                    Series::new(mark, 2 * i + j % 2, curve).label(format!("{} {name}, {arm}", scheme.name()));
                if j < 2 {
                    limits.push(series)
                } else {
                    times.push(series)
                };
            }
        }
    }
    out.table("gain-delay", table);
    out.metric("loops", entries);
    out.figure(
        "gain-delay",
        "Largest stable gain, and 2 % settling time at the best gain of `frame` and at the quickest gain of `predict` \
         that bears 10 ms of stamp error and 20 % of depth error; dashed: ideal arm. Under `predict` an object at rest is \
         reached as soon as its first image has come, however old that is.",
        figure(3, [limits, times, responses]),
    );
    Ok(out)
}

fn row(arm: &str, scheme: Scheme, delay_ms: usize, f: &Finding) -> String {
    format!(
        "{arm},{},{delay_ms},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{:.4},{:.3},{:.3}\n",
        scheme.name(),
        f.frame_largest_stable_gain_1_s,
        f.frame.gain_1_s,
        f.frame.settling_time_s,
        f.predict_largest_stable_gain_1_s,
        f.predict.gain_1_s,
        f.predict.settling_time_s,
        f.speed_up,
        f.irregular_settling_time_s,
        f.irregular_speed_up,
        f.wrong_settling_time_s,
    )
}

fn line(arm: &str, scheme: Scheme, delay_ms: usize, f: &Finding) -> String {
    let beyond = if f.predict_largest_stable_gain_1_s >= GAINS_1_S.1 { " and beyond" } else { "" };
    format!(
        "{arm:9} {} {delay_ms:2} ms: frame stable to {:.1} 1/s, best {:.3} s at {:.1} 1/s; predict stable to {:.0} 1/s{beyond}, \
         {:.3} s at {:.1} 1/s: {:.1} times quicker; lost and late frames {:.3} s: {:.1} times; wrong stamps, depths {:.3} s",
        scheme.name(),
        f.frame_largest_stable_gain_1_s,
        f.frame.settling_time_s,
        f.frame.gain_1_s,
        f.predict_largest_stable_gain_1_s,
        f.predict.settling_time_s,
        f.predict.gain_1_s,
        f.speed_up,
        f.irregular_settling_time_s,
        f.irregular_speed_up,
        f.wrong_settling_time_s,
    )
}
