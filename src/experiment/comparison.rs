//! The comparison of Sect. 10.9 with Example 10.6, and Problems 10.8 to 10.11 in the same operating conditions.

use super::findings::Findings;
use super::metrics::Metrics;
use super::plot::{Drawing, Panel, Series, Symbol, figure};
use super::schemes::{
    Estimator, PoseFeature, SCHEMES, Scheme, SchemeController, segment_selection, set_point,
};
use super::simulate::{SPAN_S, simulate};
use super::{
    CameraKind, Cell, CellGoal, ExperimentError, FeatureSource, Options, RenderedFeatures, Trajectory,
};
use crate::report::chart::same_axes;
use crate::servo::{Damping, Interaction, Law, OperationalSpace};

/// K_Ps = k_P I of Problem 10.10, for which the text gives no gains: chosen by hand.
const SEGMENT_STIFFNESS: f64 = 300.0;
/// K_D of Problem 10.10: N m s, N m s, N s/m, N m s.
///
/// Scheme C's K_Ds = 330 I is unstable at 25 Hz on `[x y L alpha]`: the angle alone would damp joint 4, of 1 kg m^2, with
/// 330 N m s, where a torque held for 0.04 s bears 50. No scalar suits the camera's height and its angle at once, so the
/// damping acts on the joints (Sect. 10.8.1 names this choice), by its own inertia.
const SEGMENT_DAMPING: [f64; 4] = [400.0, 250.0, 30.0, 20.0];

fn source(options: &Options<'_>) -> Result<FeatureSource, ExperimentError> {
    Ok(match options.camera {
        CameraKind::Ideal => FeatureSource::Ideal,
        CameraKind::Rendered => FeatureSource::Rendered(Box::new(RenderedFeatures::new(1)?)),
    })
}

/// One scheme of the comparison over the textbook's eight seconds.
///
/// # Errors
/// [`ExperimentError::Cell`].
pub fn run_scheme(
    cell: &Cell,
    scheme: Scheme,
    source: &mut FeatureSource,
) -> Result<Trajectory, ExperimentError> {
    let mut controller = SchemeController::textbook(cell, scheme)?;
    Ok(simulate(cell, scheme.name(), source, SPAN_S, |frame| controller.control(frame)))
}

/// A, B, C, D and hybrid in one set.
pub(super) fn comparison(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    schemes(options, &SCHEMES)
}

/// The hybrid scheme alone, by a homography of the form of Example 10.5 as in the comparison, and by any homography of the four points (10.58).
pub(super) fn example_10_6(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let cell = Cell::textbook()?;
    (options.progress)("hybrid, by the homography of Example 10.5, then by any");
    let by_form = run_scheme(&cell, Scheme::Hybrid, &mut source(options)?)?;
    let mut law = Scheme::Hybrid.law();
    if let Law::Hybrid { space, .. } = &mut law {
        *space = OperationalSpace::Six;
    }
    let goal = set_point(&cell.X_DO, Scheme::Hybrid.selection())?;
    let mut controller = SchemeController::new(&cell, law, goal, None);
    let any = simulate(&cell, "homography", &mut source(options)?, SPAN_S, |frame| controller.control(frame));
    report(&[by_form, any], &cell.goal()?)
}

fn schemes(options: &Options<'_>, schemes: &[Scheme]) -> Result<Findings, ExperimentError> {
    let cell = Cell::textbook()?;
    let mut runs = Vec::new();
    for scheme in schemes {
        (options.progress)(&format!("scheme {}", scheme.name()));
        runs.push(run_scheme(&cell, *scheme, &mut source(options)?)?);
    }
    report(&runs, &cell.goal()?)
}

/// Problem 10.8 to 10.11 beside the scheme that they vary.
pub(super) fn segment_problem(options: &Options<'_>, scheme: Scheme) -> Result<Findings, ExperimentError> {
    let cell = Cell::textbook()?;
    (options.progress)(&format!("scheme {} on the points, then on the segment", scheme.name()));
    let points = run_scheme(&cell, scheme, &mut source(options)?)?;
    let mut controller = segment_controller(&cell, scheme)?;
    let name = format!("{}-segment", scheme.name());
    let segment = simulate(&cell, &name, &mut source(options)?, SPAN_S, |frame| controller.control(frame));
    let mut outcome = report(&[segment, points], &cell.goal()?)?;
    if scheme == Scheme::C {
        outcome
            .metric("gains", serde_json::json!({ "k_P": SEGMENT_STIFFNESS, "K_D_joints": SEGMENT_DAMPING }));
    }
    Ok(outcome)
}

/// The segment in place of the points, in the estimator or in the law itself.
fn segment_controller(cell: &Cell, scheme: Scheme) -> Result<SchemeController<'_>, ExperimentError> {
    if scheme.is_position_based() {
        let goal = set_point(&cell.X_DO, scheme.selection())?;
        return Ok(SchemeController::new(
            cell,
            scheme.law(),
            goal,
            Some(Estimator::new(PoseFeature::Segment)),
        ));
    }
    let law = match scheme {
        Scheme::C => Law::ImageTorque {
            K_Ps: SEGMENT_STIFFNESS.into(),
            damping: Damping::Joints(std::array::from_fn(|i| SEGMENT_DAMPING.get(i).copied().unwrap_or(0.0))),
            interaction: Interaction::TEXTBOOK,
        },
        other => other.law(),
    };
    Ok(SchemeController::new(cell, law, set_point(&cell.X_DO, segment_selection()?)?, None))
}

/// Tables, metrics and the figures of Sect. 10.9 for some runs.
fn report(runs: &[Trajectory], goal: &CellGoal) -> Result<Findings, ExperimentError> {
    let mut out = Findings::default();
    let mut measured = Vec::new();
    for run in runs {
        let metrics = Metrics::of(run, goal)?;
        measured.push((run.name.as_str(), metrics.z_overshoot_percent, metrics.settling_time_s.features));
        let seconds = |t: Option<f64>| t.map_or("-".into(), |t| format!("{t:.2}"));
        out.lines.push(format!(
            "{:10} {:9} z overshoot {:6.1} %, camera path {:5.3} off its line, settled after {} s / {} s / {} s",
            run.name,
            metrics.end,
            (10.0 * metrics.z_overshoot_percent).round() / 10.0 + 0.0, // no -0.0
            metrics.camera_path_deviation,
            seconds(metrics.settling_time_s.position),
            seconds(metrics.settling_time_s.orientation),
            seconds(metrics.settling_time_s.features),
        ));
        out.table(&run.name, run.to_csv());
        out.metric(&run.name, metrics);
        let about = format!("scheme {}", run.name);
        out.figure(
            &format!("{}-pose", run.name),
            format!("Camera position and orientation, {about}; dashed: desired (Figs. 10.18 to 10.27)."),
            pose_figure(run, goal),
        );
        out.figure(
            &format!("{}-features", run.name),
            format!(
                "Features over time and paths in the image, {about}; dashed and circles: desired (Figs. 10.19 to 10.28)."
            ),
            feature_figure(run, goal),
        );
    }
    if runs.len() > 1 {
        out.telling_figure(
            "side-by-side",
            "The schemes side by side, all with the same axes: paths in the image, and the camera's position over time.",
            compared(&measured),
            side_by_side(runs, goal),
        );
    }
    out.figure(
        "camera-paths",
        "Paths of the camera's origin (Figs. 10.26 and 10.29). The z axis points down, to the object: smaller z is retreat.",
        path_figure(runs, goal),
    );
    Ok(out)
}

fn pose_figure(run: &Trajectory, goal: &CellGoal) -> Drawing {
    let end = run.rows.last().map_or(0.0, |row| row.time_s);
    let mut position = Panel::new("camera position", "t [s]", "position [m]");
    for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
        position.push(Series::line(i, run.series(|row| row.x_c[i])).label(name));
        position.push(Series::new(Symbol::Dashed, i, [(0.0, goal.x_c[i]), (end, goal.x_c[i])]));
    }
    let orientation = Panel::new("camera orientation", "t [s]", "alpha [rad]")
        .with(Series::line(3, run.series(|row| row.x_c.w)).label("alpha"))
        .with(Series::new(Symbol::Dashed, 3, [(0.0, goal.x_c.w), (end, goal.x_c.w)]));
    figure(2, [position, orientation])
}

fn feature_figure(run: &Trajectory, goal: &CellGoal) -> Drawing {
    let end = run.rows.last().map_or(0.0, |row| row.time_s);
    let mut over_time = Panel::new("feature parameters", "t [s]", "X, Y [-]");
    let mut paths = Panel::new("paths in the image plane", "X [-]", "Y [-]").equal_scales();
    let of = |row: &super::TrajectoryRow, i: usize| row.s.get(i).map_or((f64::NAN, f64::NAN), |s| (s.x, s.y));
    for i in 0..2 {
        let s_d = goal.s.get(i).map_or((f64::NAN, f64::NAN), |s| (s.x, s.y));
        over_time.push(Series::line(2 * i, run.series(|row| of(row, i).0)).label(format!("X{}", i + 1)));
        over_time.push(Series::new(Symbol::Dashed, 2 * i, [(0.0, s_d.0), (end, s_d.0)]));
        over_time.push(Series::line(2 * i + 1, run.series(|row| of(row, i).1)).label(format!("Y{}", i + 1)));
        over_time.push(Series::new(Symbol::Dashed, 2 * i + 1, [(0.0, s_d.1), (end, s_d.1)]));
    }
    for i in 0..goal.s.len() {
        paths.push(Series::line(i, run.rows.iter().map(|row| of(row, i))).label(format!("P{}", i + 1)));
    }
    let start: Vec<_> = (0..goal.s.len()).filter_map(|i| run.rows.first().map(|row| of(row, i))).collect();
    let desired: Vec<_> = goal.s.iter().map(|s| (s.x, s.y)).collect();
    let paths =
        paths.with(Series::new(Symbol::Cross, 6, start)).with(Series::new(Symbol::Circle, 6, desired));
    figure(2, [over_time, paths])
}

fn path_figure(runs: &[Trajectory], goal: &CellGoal) -> Drawing {
    let mut above = Panel::new("from above", "x [m]", "y [m]").equal_scales();
    let mut side = Panel::new("from the side", "x [m]", "z [m], down").equal_scales();
    for (i, run) in runs.iter().enumerate() {
        above.push(Series::line(i, run.rows.iter().map(|r| (r.x_c.x, r.x_c.y))).label(&run.name));
        side.push(Series::line(i, run.rows.iter().map(|r| (r.x_c.x, r.x_c.z))).label(&run.name));
    }
    let start = runs.iter().find_map(|run| run.rows.first()).map(|row| row.x_c);
    let cross = |a: usize, b: usize| Series::new(Symbol::Cross, 6, start.map(|x| (x[a], x[b])));
    let circle = |a: usize, b: usize| Series::new(Symbol::Circle, 6, [(goal.x_c[a], goal.x_c[b])]);
    let panels = [above.with(cross(0, 1)).with(circle(0, 1)), side.with(cross(0, 2)).with(circle(0, 2))];
    figure(2, panels)
}

/// Which scheme does best and worst, in a sentence: names, retreat beyond the goal, %, and settling of the features, s.
fn compared(measured: &[(&str, f64, Option<f64>)]) -> String {
    let by_retreat = |a: &&(&str, f64, Option<f64>), b: &&(&str, f64, Option<f64>)| a.1.total_cmp(&b.1);
    let (most, least) = (measured.iter().max_by(by_retreat), measured.iter().min_by(by_retreat));
    let mut text = most.zip(least).map_or_else(String::new, |(most, least)| {
        let percent = |run: &(&str, f64, Option<f64>)| format!("{} ({:.1} %)", run.0, run.1.max(0.0));
        format!(
            "The camera retreats beyond its goal most under {} and least under {}",
            percent(most),
            percent(least)
        )
    });
    let mut settled: Vec<(&str, f64)> = measured.iter().filter_map(|run| Some((run.0, run.2?))).collect();
    settled.sort_by(|a, b| a.1.total_cmp(&b.1));
    if let (Some(first), Some(last)) = (settled.first(), settled.last()) {
        text += &format!(
            "; {} settles first in the image ({:.2} s), {} last ({:.2} s)",
            first.0, first.1, last.0, last.1
        );
    }
    if settled.len() < measured.len() {
        text += &format!("; {} of {} never settle", measured.len() - settled.len(), measured.len());
    }
    text + "."
}

fn side_by_side(runs: &[Trajectory], goal: &CellGoal) -> Drawing {
    let of = |row: &super::TrajectoryRow, i: usize| row.s.get(i).map_or((f64::NAN, f64::NAN), |s| (s.x, s.y));
    let mut paths: Vec<Panel> = Vec::new();
    let mut places: Vec<Panel> = Vec::new();
    for run in runs {
        let mut panel = Panel::new(run.name.as_str(), "X [-]", "Y [-]").equal_scales();
        for i in 0..goal.s.len() {
            panel.push(Series::line(i, run.rows.iter().map(|row| of(row, i))).label(format!("P{}", i + 1)));
        }
        paths.push(panel.with(Series::new(Symbol::Circle, 6, goal.s.iter().map(|s| (s.x, s.y)))));
        let mut panel = Panel::new(run.name.as_str(), "t [s]", "position of the camera [m]");
        for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
            panel.push(Series::line(i, run.series(|row| row.x_c[i])).label(name));
        }
        places.push(panel);
    }
    same_axes(&mut paths);
    same_axes(&mut places);
    figure(runs.len(), [paths, places].concat())
}
