//! Examples 10.1, 10.4 and 10.5, Problems 10.4 and 10.5: pose and homography from features.
//!
//! The numbers here are the textbook's, where it has any, and else chosen settings of the simulation.

use super::ExperimentError;
use super::cell::{POINTS, desired_object, pose_of, project};
use super::findings::Findings;
use super::plot::{Panel, Series, Symbol, figure};
use crate::features::segment_features;
use crate::geometry::{Pose, rotation_angle, rotation_y};
use crate::pose::{
    Correspondence, HomographySolution, HomographySolutions, algorithmic_step, algorithmic_step_4,
    algorithmic_step_segment, decompose_homography_seen, euler_zyx_rotation, homography, planar_pose,
    pose_from_homography,
};
use nalgebra::{Matrix3, SVector, UnitQuaternion, Vector2, Vector3, Vector4, Vector6};
use std::f64::consts::{FRAC_PI_4, PI};
use std::fmt::Write as _;

/// K_s = 160 I, 1/s.
const GAIN_1_S: f64 = 160.0;
/// Integration step, s.
const STEP_S: f64 = 1e-3;
const AXES: [&str; 3] = ["x", "y", "z"];

pub(super) fn fail(experiment: &'static str) -> impl Fn(&dyn std::fmt::Display) -> ExperimentError {
    move |cause| ExperimentError::Computation { experiment, cause: cause.to_string() }
}

/// The pose of Example 10.1.
pub(super) fn example_pose() -> Pose {
    Pose::from_parts(
        Vector3::new(0.0, 0.0, 0.5).into(),
        UnitQuaternion::from_rotation_matrix(&rotation_y(FRAC_PI_4)),
    )
}

pub(super) fn correspondences(s: &[Vector2<f64>; 4]) -> [Correspondence; 4] {
    let mut out = [Correspondence { r: Vector2::zeros(), s: Vector2::zeros() }; 4];
    for ((slot, p), s) in out.iter_mut().zip(&POINTS).zip(s) {
        *slot = Correspondence { r: p.coords.xy(), s: *s };
    }
    out
}

fn flat(s: &[Vector2<f64>]) -> Vec<f64> {
    s.iter().flat_map(|s| [s.x, s.y]).collect()
}

fn rows(m: &Matrix3<f64>) -> Vec<Vec<f64>> {
    m.row_iter().map(|r| r.iter().copied().collect()).collect()
}

fn transform(X: &Pose) -> Vec<Vec<f64>> {
    X.to_homogeneous().row_iter().map(|r| r.iter().copied().collect()).collect()
}

/// An image of labelled points: crosses at the first, circles at the second set.
fn image_panel(title: &str, from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Panel {
    let xy = |s: &[Vector2<f64>]| s.iter().map(|s| (s.x, s.y)).collect::<Vec<_>>();
    Panel::new(title, "X [-]", "Y [-]")
        .equal_scales()
        .with(Series::new(Symbol::Cross, 6, xy(from)).label("start"))
        .with(Series::new(Symbol::Circle, 6, xy(to)).label("end"))
}

/// Example 10.1: features of the square, homography, pose.
///
/// # Errors
/// [`ExperimentError::Computation`].
pub(super) fn example_10_1() -> Result<Findings, ExperimentError> {
    let fail = fail("example-10-1");
    let truth = example_pose();
    let s = project(&truth).ok_or_else(|| fail(&"a point lies behind the camera"))?;
    let points = correspondences(&s);
    let H = homography(&points).map_err(|e| fail(&e))?;
    let X_CO = pose_from_homography(&H).ok_or_else(|| fail(&"the homography is degenerate"))?;
    let planar = planar_pose(&points).map_err(|e| fail(&e))?;
    let error = |X: &Pose| (X.to_homogeneous() - truth.to_homogeneous()).norm();
    let mut out = Findings::default();
    out.metric("s", flat(&s));
    out.metric("H", rows(&H));
    out.metric("zeta", 1.0 / H.column(0).norm());
    out.metric("T_co", transform(&X_CO));
    out.metric("T_co_refined", transform(&planar.best.X_CO));
    out.metric("error", error(&X_CO));
    out.metric("error_refined", error(&planar.best.X_CO));
    out.lines.push(format!("T_o^c recovered from the homography to {:.1e}", error(&X_CO)));
    let mut table = String::from("point,rx_m,ry_m,X,Y\n");
    for (i, p) in points.iter().enumerate() {
        let _ = writeln!(table, "P{},{},{},{:.12},{:.12}", i + 1, p.r.x, p.r.y, p.s.x, p.s.y);
    }
    out.table("features", table);
    let corner = |r: &[Vector2<f64>]| r.iter().chain(r.first()).map(|p| (p.x, p.y)).collect::<Vec<_>>();
    let square: Vec<Vector2<f64>> = points.iter().map(|p| p.r).collect();
    let panel = |title: &str, x: &str, y: &str, p: &[Vector2<f64>]| {
        Panel::new(title, x, y)
            .equal_scales()
            .with(Series::line(0, corner(p)))
            .with(Series::new(Symbol::Circle, 1, p.iter().map(|p| (p.x, p.y))).label("P1 ... P4"))
    };
    let panels = [
        panel("object", "x_o [m]", "y_o [m]", &square),
        panel("normalized image plane", "X [-]", "Y [-]", &s),
    ];
    let says = format!(
        "The homography of the four points gives the pose back to {:.1e} (norm of the difference of the matrices), refinement to {:.1e}.",
        error(&X_CO),
        error(&planar.best.X_CO)
    );
    let caption = "The square of four points and its image (Fig. 10.6).";
    out.telling_figure("square", caption, says, figure(2, panels));
    Ok(out)
}

/// A run of the integration algorithm.
struct Estimation<const M: usize> {
    x: Vec<SVector<f64, M>>,
    error: Vec<f64>,
}

fn estimate<const M: usize, E: std::fmt::Display>(
    start: SVector<f64, M>,
    steps: usize,
    step: impl Fn(&SVector<f64, M>) -> Result<crate::pose::AlgorithmicStep<M>, E>,
) -> Result<Estimation<M>, E> {
    let mut run = Estimation { x: vec![start], error: Vec::with_capacity(steps) };
    let mut x = start;
    for _ in 0..steps {
        let next = step(&x)?;
        run.error.push(next.error);
        x = next.x;
        run.x.push(x);
    }
    Ok(run)
}

/// Figures 10.8 and 10.9: error, image paths, position and orientation over time.
fn estimation_figures<const M: usize>(
    out: &mut Findings,
    run: &Estimation<M>,
    truth: &SVector<f64, M>,
    seen: impl Fn(&SVector<f64, M>) -> Option<Vec<Vector2<f64>>>,
    angles: &[&str],
) {
    let time = |i: usize| i as f64 * STEP_S;
    let shown = 61.min(run.x.len());
    let errors = || run.error.iter().take(shown).enumerate().map(|(i, e)| (time(i), *e));
    let error = Panel::new("feature error", "t [s]", "||e_s|| [-]").with(Series::line(0, errors()));
    let logarithmic = Panel::new("feature error", "t [s]", "||e_s|| [-]")
        .log_y()
        .with(Series::line(0, run.error.iter().enumerate().map(|(i, e)| (time(i), e.max(1e-15)))));
    let views: Vec<_> = run.x.iter().filter_map(&seen).collect();
    let (Some(first), Some(last)) = (views.first(), views.last()) else { return };
    let mut image = image_panel("image plane", first, last);
    for i in 0..first.len() {
        let path = views.iter().filter_map(|v| v.get(i)).map(|s| (s.x, s.y));
        image.push(Series::line(i, path).label(format!("P{}", i + 1)));
    }
    let mut position = Panel::new("position", "t [s]", "position [m]");
    let mut orientation = Panel::new("orientation", "t [s]", "angle [rad]");
    let end = time(shown - 1);
    for i in 0..M {
        let path = run.x.iter().take(shown).enumerate().map(|(k, x)| (time(k), x[i]));
        let goal = Series::new(Symbol::Dashed, i, [(0.0, truth[i]), (end, truth[i])]);
        let (panel, name) = match AXES.get(i) {
            Some(axis) => (&mut position, *axis),
            None => (&mut orientation, angles.get(i - 3).copied().unwrap_or("angle")),
        };
        panel.push(Series::line(i, path).label(name));
        panel.push(goal);
    }
    let drawing = figure(3, [error, logarithmic, image]);
    out.figure(
        "error",
        "Norm of the feature error, and the paths of the points in the image (Fig. 10.8).",
        drawing,
    );
    out.figure(
        "estimate",
        "Estimated position and orientation; dashed: the truth (Fig. 10.9).",
        figure(2, [position, orientation]),
    );
}

fn estimation_table<const M: usize>(run: &Estimation<M>, names: &[&str]) -> String {
    let mut table = format!("time_s,error,{}\n", names.join(","));
    for (i, x) in run.x.iter().enumerate() {
        let error = run.error.get(i).map_or(String::new(), |e| format!("{e:.10e}"));
        let _ = write!(table, "{:.3},{error}", i as f64 * STEP_S);
        for value in x.iter() {
            let _ = write!(table, ",{value:.10}");
        }
        table.push('\n');
    }
    table
}

/// Example 10.4: pose of the square by integration with the pseudo-inverse of the interaction matrix.
///
/// # Errors
/// [`ExperimentError::Computation`].
pub(super) fn example_10_4() -> Result<Findings, ExperimentError> {
    let fail = fail("example-10-4");
    let truth = Vector6::new(0.0, 0.0, 0.5, 0.0, FRAC_PI_4, 0.0);
    let s = project(&example_pose()).ok_or_else(|| fail(&"a point lies behind the camera"))?;
    let points = correspondences(&s);
    let start = Vector6::new(0.0, 0.0, 1.0, 0.0, PI / 32.0, 0.0);
    let run =
        estimate(start, 250, |x| algorithmic_step(x, &points, GAIN_1_S, STEP_S)).map_err(|e| fail(&e))?;
    let seen = |x: &Vector6<f64>| {
        let R = euler_zyx_rotation(&x.fixed_rows::<3>(3).into_owned());
        let X = Pose::from_parts(
            x.fixed_rows::<3>(0).into_owned().into(),
            UnitQuaternion::from_rotation_matrix(&R),
        );
        project(&X).map(|s| s.to_vec())
    };
    let mut out = Findings::default();
    let error = |k: usize| run.x.get(k).map_or(f64::NAN, |x| (x - truth).norm());
    out.metric("x_final", run.x.last().map(|x| x.as_slice().to_vec()));
    out.metric("error_after_30_steps", error(30));
    out.metric("error_after_250_steps", error(250));
    out.metric("feature_error", &run.error);
    out.lines.push(format!("after 30 steps of 1 ms: {:.4}; after 250: {:.1e}", error(30), error(250)));
    out.table(
        "estimate",
        estimation_table(&run, &["x_m", "y_m", "z_m", "phi_z_rad", "phi_y_rad", "phi_x_rad"]),
    );
    estimation_figures(&mut out, &run, &truth, seen, &["about z", "about y", "about x"]);
    Ok(out)
}

/// Example 10.5: planar homography between two views, and the displacement of the camera.
///
/// # Errors
/// [`ExperimentError::Computation`].
pub(super) fn example_10_5() -> Result<Findings, ExperimentError> {
    let fail = fail("example-10-5");
    let behind = || fail(&"a point lies behind the camera");
    let s1 = project(&Pose::translation(0.0, 0.0, 0.5)).ok_or_else(behind)?;
    let s2 = project(&pose_of(&desired_object())).ok_or_else(behind)?;
    let mut pairs = correspondences(&s1);
    pairs.iter_mut().zip(&s2).for_each(|(pair, s2)| pair.r = *s2);
    let zeta_H = homography(&pairs).map_err(|e| fail(&e))?;
    let zeta = 1.0 / zeta_H.column(0).norm();
    let H = zeta_H * zeta;
    // The text's short cut: the normal is known, the rotation is about z.
    let beta = H.m21.atan2(H.m11);
    let displacement = Vector3::new(H.m13, H.m23, H.m33 - 1.0);
    // The general decomposition, without either assumption.
    let solutions = decompose_homography_seen(&zeta_H, &s2).map_err(|e| fail(&e))?;
    let known_normal = Vector3::z();
    let general = solutions.nearest_normal(&known_normal);
    let mut out = Findings::default();
    out.metric("s1", flat(&s1));
    out.metric("s2", flat(&s2));
    out.metric("zeta_H", rows(&zeta_H));
    out.metric("zeta", zeta);
    out.metric("H", rows(&H));
    out.metric("beta_rad", beta);
    out.metric("displacement_over_d2", displacement.as_slice());
    out.metric("decomposition", solution_json(&general, true));
    out.lines.push(format!(
        "zeta = {zeta:.4}, beta = {beta:.6} rad, o/d2 = [{:.4} {:.4} {:.4}]",
        displacement.x, displacement.y, displacement.z
    ));
    both_solutions(&mut out, &solutions, &general, &H, &pairs);
    let image = image_panel("two views of the square", &s1, &s2);
    let says = format!(
        "Between the views the camera turns by {beta:.4} rad about its axis and moves by [{:.4} {:.4} {:.4}] times the distance of the plane.",
        displacement.x, displacement.y, displacement.z
    );
    let caption = "Two views of the square; the points at t' (crosses) and at t'' (circles).";
    out.telling_figure("views", caption, says, figure(1, [image]));
    Ok(out)
}

fn solution_json(found: &HomographySolution, is_true: bool) -> serde_json::Value {
    serde_json::json!({
        "R_12": rows(found.R_12.matrix()), "angle_rad": rotation_angle(&found.R_12),
        "displacement_over_d2": found.p_12_1_over_d2.as_slice(), "n_2": found.n_2.as_slice(),
        "is_true": is_true,
    })
}

/// Every solution of Example 10.5 that has all points in front of both cameras, the true one first, and what decides between them.
fn both_solutions(
    out: &mut Findings,
    solutions: &HomographySolutions,
    truth: &HomographySolution,
    H: &Matrix3<f64>,
    pairs: &[Correspondence; 4], // s in image 1, r in image 2
) {
    let other = [Some(solutions.first), solutions.second].into_iter().flatten().find(|s| s != truth);
    let mut table = String::from("solution,is_true,angle_rad,nx,ny,nz,ox,oy,oz,rebuilds_H_to,least_depth\n");
    let mut entries = Vec::new();
    for (i, found) in [Some(*truth), other].into_iter().flatten().enumerate() {
        let (is_true, p, n) = (i == 0, found.p_12_1_over_d2, found.n_2);
        let rebuilt = (found.R_12.matrix() + p * n.transpose() - H).norm();
        // With d_2 = 1, of every point in front of both cameras: 1 / n_2^T s~_2, and the third component of H p_2.
        let depths = pairs.iter().flat_map(|pair| {
            let s_2 = Vector3::new(pair.r.x, pair.r.y, 1.0);
            let p_2 = s_2 / n.dot(&s_2);
            [p_2.z, (H * p_2).z]
        });
        let least = depths.fold(f64::INFINITY, f64::min);
        let angle = rotation_angle(&found.R_12);
        let [nx, ny, nz, ox, oy, oz] = [n.x, n.y, n.z, p.x, p.y, p.z];
        let _ = writeln!(
            table,
            "{},{is_true},{angle:.10},{nx:.10},{ny:.10},{nz:.10},{ox:.10},{oy:.10},{oz:.10},{rebuilt:.1e},{least:.10}",
            i + 1
        );
        out.lines.push(format!(
            "solution {}{}: R_2^1 turns by {angle:.4} rad, n2 = [{nx:.4} {ny:.4} {nz:.4}], o/d2 = [{ox:.4} {oy:.4} {oz:.4}]; it rebuilds H to \
             {rebuilt:.1e}, and no point is nearer than {least:.3} d2 to either camera",
            i + 1,
            if is_true { ", the true one" } else { "" }
        ));
        entries.push(solution_json(&found, is_true));
    }
    out.lines.push(
        "both show all points in front of both cameras, so that the two images do not tell which is true: the normal does, which the example \
         knows (0, 0, 1); and so would a third view, a point outside the plane, or the direction in which the camera moved"
            .into(),
    );
    out.metric("solutions", entries);
    out.table("solutions", table);
}

/// Problem 10.4: pose of the object from P1 and P2, four coordinates.
///
/// # Errors
/// [`ExperimentError::Computation`].
pub(super) fn problem_10_4() -> Result<Findings, ExperimentError> {
    let fail = fail("problem-10-4");
    two_point_problem(&fail, |x, points| {
        algorithmic_step_4(x, points, GAIN_1_S, STEP_S).map_err(|e| e.to_string())
    })
}

/// Problem 10.5: the same from the segment P1 P2, (10.28).
///
/// # Errors
/// [`ExperimentError::Computation`].
pub(super) fn problem_10_5() -> Result<Findings, ExperimentError> {
    let fail = fail("problem-10-5");
    two_point_problem(&fail, |x, [p, r]| {
        let s = segment_features(&[p.s, r.s]);
        let ends = [p.r, r.r].map(|r| [r.x, r.y, 0.0].into());
        algorithmic_step_segment(x, &ends, &s, GAIN_1_S, STEP_S).map_err(|e| e.to_string())
    })
}

fn two_point_problem(
    fail: &dyn Fn(&dyn std::fmt::Display) -> ExperimentError,
    step: impl Fn(&Vector4<f64>, &[Correspondence; 2]) -> Result<crate::pose::AlgorithmicStep<4>, String>,
) -> Result<Findings, ExperimentError> {
    let truth = desired_object();
    let X_DO = pose_of(&truth);
    let [a, b, _, _] =
        correspondences(&project(&X_DO).ok_or_else(|| fail(&"a point lies behind the camera"))?);
    let start = Vector4::new(0.0, 0.0, 0.5, 0.0);
    let run = estimate(start, 250, |x| step(x, &[a, b])).map_err(|e| fail(&e))?;
    // The digits that the problem prints lead to a pose beside the exact one.
    let digit = |p: Correspondence, x, y| Correspondence { s: Vector2::new(x, y), ..p };
    let printed = [digit(a, -0.1667, 0.1667), digit(b, -0.0833, 0.0223)];
    let from_digits = estimate(start, 250, |x| step(x, &printed)).map_err(|e| fail(&e))?;
    let (Some(x), Some(y)) = (run.x.last(), from_digits.x.last()) else {
        return Err(fail(&"no step was made"));
    };
    let mut out = Findings::default();
    out.metric("x_final", x.as_slice());
    out.metric("T_co", transform(&pose_of(x)));
    out.metric("error", (x - truth).norm());
    out.metric("T_co_from_printed_digits", transform(&pose_of(y)));
    out.metric("feature_error", &run.error);
    out.lines.push(format!(
        "x = [{:.6} {:.6} {:.6}] m, {:.6} rad, {:.1e} from the truth",
        x.x,
        x.y,
        x.z,
        x.w,
        (x - truth).norm()
    ));
    out.table("estimate", estimation_table(&run, &["x_m", "y_m", "z_m", "alpha_rad"]));
    let seen = |x: &Vector4<f64>| project(&pose_of(x)).map(|s| s.iter().take(2).copied().collect());
    estimation_figures(&mut out, &run, &truth, seen, &["alpha"]);
    Ok(out)
}
