//! Look-and-move beside visual servoing in a cell that is not as it is described (Sect. 10.1.1): the open loop ends as far from the goal as the
//! calibration is wrong, the closed ones do not. The whole system, rendered images, a UR5.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

use super::findings::Findings;
use super::plot::{Panel, Series, Symbol, figure};
use super::{ExperimentError, Options};
use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::control::trace::Event;
use crate::sim::{Moment, simulate_system};
use serde_json::json;
use std::ops::ControlFlow;
use std::path::Path;

/// The run file, and the laws that are compared: key and name in words.
const CELL: &str = "ur5";
const SCHEMES: [(&str, &str); 3] = [
    ("look_and_move", "look-and-move"),
    ("position_resolved_velocity", "scheme B"),
    ("image_resolved_velocity", "scheme D"),
];
/// How far the camera is turned on the flange against its description, about its x axis, degrees.
const MOUNT_DEG: [f64; 6] = [0.0, 0.5, 1.0, 2.0, 5.0, 10.0];
/// Zero of the second joint against its encoder, degrees.
const JOINT_DEG: [f64; 4] = [0.5, 1.0, 2.0, 5.0];

/// One run.
struct ComparedRun {
    converged: bool,
    /// Motions of look-and-move that were complete.
    motions: u32,
    /// Feature error after the first motion, px; of a law that always looks: none.
    after_one_look_px: Option<f64>,
    settling_time_s: Option<f64>,
    at_end_px: Option<f64>,
}

fn run(scheme: &str, error: &str) -> Result<ComparedRun, ExperimentError> {
    let set = ["run.clock=lockstep".into(), format!("servo.scheme={scheme}"), error.to_owned()];
    let config = Config::load(Some(Path::new(CELL)), &set)
        .map_err(|e| ExperimentError::Cell { cause: e.to_string() })?;
    let (mut motions, mut after_one_look_px) = (0, None);
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, errors) = moment
            && trace.events.iter().any(|event| event == Event::MotionOver)
        {
            motions += 1;
            after_one_look_px = after_one_look_px.or(errors.believed.feature_error_px);
        }
        ControlFlow::Continue(())
    })?;
    let converged = run.finish.outcome == Outcome::Converged;
    let at_end_px = run.errors.believed.feature_error_px;
    if scheme == SCHEMES[0].0 && converged {
        // The goal was held while the arm rested after its last motion.
        (motions, after_one_look_px) = (motions + 1, after_one_look_px.or(at_end_px));
    }
    let settling_time_s = run.settling_time_s.filter(|_| converged);
    Ok(ComparedRun { converged, motions, after_one_look_px, settling_time_s, at_end_px })
}

pub(super) fn look_and_move(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let mut out = Findings::default();
    let mut table =
        String::from("error,degrees,scheme,converged,motions,after_one_look_px,settling_time_s,at_end_px\n");
    let mount: Vec<_> = MOUNT_DEG
        .map(|deg| {
            let key = "scene.camera.mount.rotation_rpy_rad";
            ("mount turned", deg, format!("{key}=[{}, 0.0, 0.0]", deg.to_radians()))
        })
        .into();
    let joint = JOINT_DEG.map(|deg| {
        let key = "scene.arm.q_offset_rad_or_m";
        ("joint 2 off", deg, format!("{key}=[0.0, {}, 0.0, 0.0, 0.0, 0.0]", deg.to_radians()))
    });
    let mut entries = Vec::new();
    let mut first =
        Panel::new("mount turned: after the first motion", "error of the mount [deg]", "feature error [px]");
    let mut times = Panel::new("mount turned: settling", "error of the mount [deg]", "settling time [s]");
    for (i, (scheme, name)) in SCHEMES.into_iter().enumerate() {
        (options.progress)(name);
        let (mut after_one, mut settled) = (Vec::new(), Vec::new());
        for (what, deg, setting) in mount.iter().chain(&joint) {
            let run = run(scheme, setting)?;
            let number = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.4}"));
            table += &format!(
                "{what},{deg},{scheme},{},{},{},{},{}\n",
                run.converged,
                run.motions,
                number(run.after_one_look_px),
                number(run.settling_time_s),
                number(run.at_end_px)
            );
            let look = run
                .after_one_look_px
                .map(|px| format!("{px:6.2} px after one look, {} looks, ", run.motions));
            let end = match run.settling_time_s {
                Some(time_s) => format!("settles in {time_s:.2} s"),
                None => format!("does not converge, {:.2} px at the end", run.at_end_px.unwrap_or(f64::NAN)),
            };
            out.lines.push(format!("{what:12} {deg:4} deg {name:13}: {}{end}", look.unwrap_or_default()));
            entries.push(json!({
                "error": what, "degrees": deg, "scheme": scheme, "converged": run.converged, "motions": run.motions,
                "after_one_look_px": run.after_one_look_px, "settling_time_s": run.settling_time_s,
                "at_end_px": run.at_end_px,
            }));
            if *what == "mount turned" {
                after_one.extend(run.after_one_look_px.map(|px| (*deg, px)));
                settled.extend(run.settling_time_s.map(|time_s| (*deg, time_s)));
            }
        }
        if !after_one.is_empty() {
            first.push(Series::new(Symbol::Line, i, after_one).label(name));
        }
        times.push(Series::new(Symbol::Line, i, settled).label(name));
    }
    out.table("look-and-move", table);
    out.metric("runs", entries);
    out.figure(
        "look-and-move",
        "Look-and-move against visual servoing with a camera that is turned on the flange against its description. The one look leaves an \
         error that grows with it, and each further look takes most of that away; laws that look while the arm moves settle as before.",
        figure(2, vec![first, times]),
    );
    Ok(out)
}
