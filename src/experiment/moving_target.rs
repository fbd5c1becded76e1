//! A target that moves by itself, followed with the feed-forward of its estimated velocity and without: the whole system,
//! rendered images, 25 Hz, 40 ms from exposure to use.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

use super::findings::Findings;
use super::plot::{Panel, Series, Symbol, figure};
use super::{ExperimentError, Options};
use crate::config::Config;
use crate::sim::{Moment, SystemRun, simulate_system};
use crate::time::MonoNs;
use serde_json::json;
use std::ops::ControlFlow;

/// Motions: name, and the settings of `[scene.motion]`.
const MOTIONS: [(&str, [&str; 2]); 2] = [
    // Across the reach of the arm, so that no singularity comes near.
    ("conveyor, 0.2 m/s", ["scene.motion.kind=conveyor", "scene.motion.velocity_m_s=[-0.14, -0.14, 0.0]"]),
    ("pendulum, 0.05 m, 0.2 Hz", ["scene.motion.kind=pendulum", "scene.motion.frequency_hz=0.2"]),
];
/// Cameras: name, and the settings that make it so. The irregular one loses a tenth of its frames, and the others are late by
/// up to 10 ms.
const CAMERAS: [(&str, [&str; 2]); 2] = [
    ("regular", ["camera.synthetic.frame_loss=0", "camera.synthetic.latency_jitter_ms=0"]),
    ("irregular", ["camera.synthetic.frame_loss=0.1", "camera.synthetic.latency_jitter_ms=10"]),
];
const FIXED: [&str; 6] = [
    "run.clock=lockstep",
    "run.duration_s=5",
    "camera.latency_ms=40",
    "servo.gain_1_s=4",
    "servo.depth=estimated",
    "goal.hold_s=60",
];
/// The part of a run that counts as steady, s.
const STEADY_FROM_S: f64 = 3.0;

/// The feature error against truth behind a moving target, px, at each millisecond; and how the run went.
fn behind_a_moving_target(
    motion: &[&str],
    camera: &[&str],
    follows: bool,
) -> Result<(Vec<(f64, f64)>, SystemRun), ExperimentError> {
    let moves = format!("servo.object.moves={follows}");
    let all = FIXED.iter().chain(motion).chain(camera).map(ToString::to_string).chain([moves]);
    let config = Config::load(None, &all.collect::<Vec<_>>())
        .map_err(|e| ExperimentError::Cell { cause: e.to_string() })?;
    let mut errors = Vec::new();
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, errors_now) = moment {
            errors
                .push(((trace.time - MonoNs::ZERO).as_s(), errors_now.feature_error_px.unwrap_or(f64::NAN)));
        }
        ControlFlow::Continue(())
    })?;
    Ok((errors, run))
}

pub(super) fn moving_target(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let mut out = Findings::default();
    let mut table = String::from("motion,camera,feed_forward,steady_rms_px,steady_max_px,target_lost\n");
    let (mut entries, mut panels) = (Vec::new(), Vec::new());
    for (motion, settings) in MOTIONS {
        let mut panel = Panel::new(motion, "t [s]", "feature error [px]").log_y();
        for (i, (camera, irregularity)) in CAMERAS.into_iter().enumerate() {
            for follows in [true, false] {
                let with = if follows { "with" } else { "without" };
                (options.progress)(&format!("{motion}, camera {camera}, {with} feed-forward"));
                let (errors, run) = behind_a_moving_target(&settings, &irregularity, follows)?;
                let steady: Vec<f64> =
                    errors.iter().filter(|(t, _)| *t >= STEADY_FROM_S).map(|(_, e)| *e).collect();
                let rms = (steady.iter().map(|e| e * e).sum::<f64>() / steady.len().max(1) as f64).sqrt();
                let max = steady.iter().copied().fold(0.0, f64::max);
                table +=
                    &format!("\"{motion}\",\"{camera}\",{follows},{rms:.4},{max:.4},{}\n", run.target_lost);
                out.lines.push(format!(
                    "{motion:24} {camera:9} camera, {with:7} feed-forward: {rms:8.3} px rms, {max:8.3} px at most{}",
                    if run.target_lost > 0 { ", the target is lost" } else { "" }
                ));
                entries.push(json!({
                    "motion": motion, "camera": camera, "feed_forward": follows,
                    "steady_rms_px": rms, "steady_max_px": max, "target_lost": run.target_lost,
                }));
                let mark = if follows { Symbol::Line } else { Symbol::Dashed };
                let every_10_ms = errors.into_iter().step_by(10);
                panel.push(Series::new(mark, i, every_10_ms).label(format!("{with}, {camera}")));
            }
        }
        panels.push(panel);
    }
    out.table("moving-target", table);
    out.metric("runs", entries);
    out.figure(
        "moving-target",
        "Feature error against truth behind a target that moves; dashed: its motion is not estimated. The irregular camera loses a \
         tenth of its frames, the others are late by up to 10 ms.",
        figure(2, panels),
    );
    Ok(out)
}
