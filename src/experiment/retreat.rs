//! The camera's retreat under scheme D when all that is asked is a turn about the optical axis.
//!
//! The four points lie symmetrically about the axis. On straight image paths their distance from the centre shrinks to
//! `cos(theta/2)` of what it was, so that with the true depth in the interaction matrix the camera must draw back to
//! `z / z_0 = 1 / cos(theta/2)`. The law is computed at every millisecond: the effect is the law's, not the sampling's.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

use super::findings::Findings;
use super::plot::{Panel, Series, Symbol, figure};
use super::schemes::{SchemeController, set_point};
use super::simulate::{STEP_S, simulate_at};
use super::{Cell, ExperimentError, FeatureSource, Options, Trajectory, TrajectoryEnd};
use crate::geometry::Pose;
use crate::servo::{DepthSource, Gain, Interaction, InteractionAt, Law, Selection};
use nalgebra::Vector3;
use serde_json::json;

/// Rotations asked for, degrees.
pub const ROTATIONS_DEG: [f64; 7] = [30.0, 60.0, 90.0, 120.0, 150.0, 170.0, 179.0];
/// Distance of the object at start and goal, m.
const DISTANCE_M: f64 = 0.5;
const SPAN_S: f64 = 12.0;

/// A run of scheme D for a pure rotation of `angle_rad` about the optical axis.
///
/// # Errors
/// [`ExperimentError::Cell`].
pub fn pure_rotation(angle_rad: f64, depth: DepthSource) -> Result<Trajectory, ExperimentError> {
    let mut cell = Cell::textbook()?;
    let centred = Pose::translation(-0.05, -0.05, 0.0);
    let X_CO = Pose::translation(0.0, 0.0, DISTANCE_M) * centred;
    cell.X_BO = cell.arm.forward(&cell.q_start) * X_CO;
    cell.X_DO = Pose::new(Vector3::new(0.0, 0.0, DISTANCE_M), Vector3::new(0.0, 0.0, angle_rad)) * centred;
    let interaction = Interaction { at: InteractionAt::Current, depth };
    let law = Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction };
    let goal = set_point(&cell.X_DO, Selection::all_points(4))?;
    let mut controller = SchemeController::new(&cell, law, goal, None).knowing_depth();
    let name = format!("{:.0}deg", angle_rad.to_degrees());
    Ok(simulate_at(1, &cell, &name, &mut FeatureSource::Ideal, SPAN_S, |frame| controller.control(frame)))
}

/// Greatest distance of the object over the first one.
#[must_use]
pub fn retreat_of(run: &Trajectory) -> f64 {
    let z_start = run.rows.first().map_or(f64::NAN, |row| row.x_c.z);
    run.rows.iter().map(|row| (DISTANCE_M + z_start - row.x_c.z) / DISTANCE_M).fold(1.0, f64::max)
}

pub(super) fn retreat(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let mut out = Findings::default();
    let mut table = String::from("rotation_deg,z_ratio_desired_depth,z_ratio_true_depth,one_over_cos_half\n");
    let mut peaks = [Vec::new(), Vec::new()];
    let mut panels = Vec::new();
    for (k, (depth, title)) in
        [(DepthSource::Desired, "depth z_d"), (DepthSource::Known, "true depth")].into_iter().enumerate()
    {
        let mut panel = Panel::new(title, "t [s]", "distance / first distance [-]").log_y();
        for (i, degrees) in ROTATIONS_DEG.into_iter().enumerate() {
            (options.progress)(&format!("{title}, {degrees} degrees"));
            let run = pure_rotation(degrees.to_radians(), depth)?;
            let z_start = run.rows.first().map_or(f64::NAN, |row| row.x_c.z);
            let ratio = run.series(|row| (DISTANCE_M + z_start - row.x_c.z) / DISTANCE_M);
            panel.push(Series::line(i, ratio.take((8.0 / STEP_S) as usize)).label(format!("{degrees} deg")));
            let end = match &run.end {
                TrajectoryEnd::Finished => "finished".to_string(),
                TrajectoryEnd::Stopped { time_s, reason } => format!("stopped at {time_s:.3} s: {reason}"),
            };
            if let Some(list) = peaks.get_mut(k) {
                list.push((degrees, retreat_of(&run), end));
            }
        }
        panels.push(panel);
    }
    let [desired, known] = peaks;
    let mut entries = Vec::new();
    for ((degrees, z_d, end_d), (_, z_true, end_true)) in desired.iter().zip(&known) {
        let ideal = 1.0 / (0.5 * degrees.to_radians()).cos();
        table += &format!("{degrees},{z_d:.9},{z_true:.9},{ideal:.9}\n");
        out.lines.push(format!("{degrees:5} deg: z/z0 {z_d:8.4} with z_d, {z_true:8.4} with the true z, 1/cos(theta/2) = {ideal:8.4}"));
        entries.push(json!({
            "rotation_deg": degrees, "one_over_cos_half": ideal,
            "desired_depth": { "z_ratio": z_d, "end": end_d }, "true_depth": { "z_ratio": z_true, "end": end_true },
        }));
    }
    out.metric("rotations", entries);
    out.table("retreat", table);
    let line = |i: usize, list: &[(f64, f64, String)]| {
        Series::line(i, list.iter().map(|(degrees, ratio, _)| (*degrees, *ratio)).collect::<Vec<_>>())
    };
    let theory = (0..=179).map(|d| (f64::from(d), 1.0 / (0.5 * f64::from(d).to_radians()).cos()));
    panels.push(
        Panel::new("greatest distance", "rotation [deg]", "distance / first distance [-]")
            .log_y()
            .with(line(0, &desired).label("z_d"))
            .with(line(1, &known).label("true z"))
            .with(Series::new(Symbol::Dashed, 6, theory).label("1/cos(theta/2)")),
    );
    out.figure(
        "retreat",
        "Scheme D draws the camera back when a turn about the optical axis is asked for.",
        figure(3, panels),
    );
    Ok(out)
}
