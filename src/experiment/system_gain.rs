//! Gain and delay in the whole system: what `gain-delay` studies near the goal with a bare arm, from the start of the
//! default run, with rendered images, the arm's dynamics and its limits.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

use super::findings::Findings;
use super::plot::{Panel, Series, figure};
use super::{ExperimentError, Options};
use crate::config::Config;
use crate::control::outcome;
use crate::sim::simulate_system;
use serde_json::json;
use std::ops::ControlFlow;

const LATENCIES_MS: [u32; 2] = [40, 80];
const UPDATES: [&str; 3] = ["frame", "tick", "predict"];
const GAINS_1_S: [f64; 14] = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 40.0, 70.0, 100.0];

/// The settling time of the default run, s; `None` where it does not converge within ten seconds.
fn settling_time_s(latency_ms: u32, update: &str, gain_1_s: f64) -> Result<Option<f64>, ExperimentError> {
    let settings = [
        "run.clock=lockstep".into(),
        "run.duration_s=10".into(),
        format!("camera.latency_ms={latency_ms}"),
        // What the delay does, and not what keeps the target in the image.
        "servo.visibility.guard=false".into(),
        format!("servo.update={update}"),
        format!("servo.gain_1_s={gain_1_s}"),
    ];
    let config = Config::load(None, &settings).map_err(|e| ExperimentError::Cell { cause: e.to_string() })?;
    let run = simulate_system(&config, &mut |_| ControlFlow::Continue(()))?;
    Ok(run.settling_time_s.filter(|_| run.finish.outcome == outcome::Outcome::Converged))
}

pub(super) fn system_gain(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let mut out = Findings::default();
    let mut table = String::from("latency_ms,update,gain_1_s,settling_time_s\n");
    let (mut entries, mut panels) = (Vec::new(), Vec::new());
    for latency_ms in LATENCIES_MS {
        let title = format!("{latency_ms} ms from exposure to use");
        let mut panel = Panel::new(title, "gain [1/s]", "settling time [s]").y_range(0.0, 5.0);
        for (i, update) in UPDATES.into_iter().enumerate() {
            (options.progress)(&format!("{latency_ms} ms, {update}"));
            let mut settled = Vec::new();
            for gain in GAINS_1_S {
                let time_s = settling_time_s(latency_ms, update, gain)?;
                table += &format!(
                    "{latency_ms},{update},{gain},{}\n",
                    time_s.map_or(String::new(), |t| format!("{t:.3}"))
                );
                settled.extend(time_s.map(|t| (gain, t)));
            }
            let best = settled.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1));
            let largest = settled.iter().map(|(gain, _)| *gain).fold(0.0, f64::max);
            let (gain, time_s) = best.unwrap_or((f64::NAN, f64::NAN));
            out.lines.push(format!(
                "{latency_ms} ms {update:8}: best {time_s:.2} s at {gain} 1/s, converges up to {largest} 1/s of {} tried",
                GAINS_1_S.iter().copied().fold(0.0, f64::max)
            ));
            entries.push(json!({
                "latency_ms": latency_ms, "update": update, "best_gain_1_s": gain, "best_settling_time_s": time_s,
                "largest_converging_gain_1_s": largest,
            }));
            // A logarithm of the gain on a linear axis would hide its numbers: the interesting part is below 20.
            let shown = settled.into_iter().filter(|(gain, _)| *gain <= 20.0);
            panel.push(Series::line(i, shown).label(update));
        }
        panels.push(panel);
    }
    out.table("gain-system", table);
    out.metric("loops", entries);
    out.figure(
        "gain-system",
        "Settling time of the default run against the gain; a line ends where the run converges no more (gains up to 20 are \
         shown). `predict` comes to the time that the arm's acceleration allows, and stays there.",
        figure(2, panels),
    );
    Ok(out)
}
