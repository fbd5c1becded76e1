//! What control leaves for a report: the history of the run, its goal, and where the frames of the cell were.

use crate::config::{Config, Source};
use crate::geometry::Pose;
use crate::mission::{LockstepRun, Mission};
use crate::process::report_folder::{GOAL, MEASUREMENTS, POSES, TRACE};
use crate::process::{Membership, ProcessError, ReportFolder};
use crate::report::history::{PostureFacts, RunHistory};
use crate::servo::SetPoint;
use crate::time::SpanNs;
use nalgebra::{DMatrix, SMatrix, SVector, Vector3};
use std::fmt::Write;
use tracing::error;

/// What a run may go on for beyond its latest end: the arm comes to rest. Chosen by hand: of a run that brakes
/// for longer every second tick is kept, nothing worse.
const MARGIN: SpanNs = SpanNs(2_000_000_000);

/// Room for the history of a run.
pub(super) fn history<const N: usize>(config: &Config, mission: &Mission<N>) -> RunHistory {
    let ids: Vec<&[u32]> = mission.set_points().map(SetPoint::ids).collect();
    let plays_once = matches!(config.camera.source, Source::Replay { repeat: false, .. });
    let has_end = !config.serve && !plays_once;
    let longest = if has_end { SpanNs(config.duration.0.saturating_add(MARGIN.0)) } else { SpanNs(i64::MAX) };
    RunHistory::new(N, &ids, longest, config.camera.rate_hz)
}

/// Writes all files. A failure is reported and changes nothing: the run is over, and the arm is at rest.
pub(super) fn write<const N: usize>(
    folder: &ReportFolder,
    config: &Config,
    run: &LockstepRun<N>,
    history: &RunHistory,
    membership: &Membership,
) {
    for (name, text) in texts(config, run, history) {
        // A long history takes its time, and the supervisor wants signs of life.
        membership.beat();
        let text = text();
        membership.beat();
        if let Err(ProcessError::Write { path, cause }) = folder.write(name, text) {
            error!("report: {} cannot be written: {cause}", path.display());
        }
    }
}

/// Name of a file, and what makes its text.
type FileText<'a> = (&'static str, Box<dyn Fn() -> String + 'a>);

/// The files with what makes their texts.
pub(super) fn texts<'a, const N: usize>(
    config: &'a Config,
    run: &'a LockstepRun<N>,
    history: &'a RunHistory,
) -> [FileText<'a>; 4] {
    let robot = &run.controller().arm().robot;
    let places = move |q: &[f64]| {
        let X_BE = robot.forward(&joints(q));
        let X_BC = config.camera.mount.X_BC(robot, &joints(q));
        let (p, r) = (X_BC.translation.vector, X_BC.rotation.coords);
        PostureFacts {
            p_BE: X_BE.translation.vector.into(),
            X_BC: [p.x, p.y, p.z, r.x, r.y, r.z, r.w],
            min_singular_value: min_singular_value(config.camera.mount.camera(robot, &joints(q)).1.matrix()),
        }
    };
    [
        (TRACE, Box::new(move || history.trace_csv(places))),
        (MEASUREMENTS, Box::new(|| history.measurements_csv())),
        (GOAL, Box::new(|| goal(config, run))),
        (POSES, Box::new(|| poses(config, run, history))),
    ]
}

/// Of a Jacobian, 6 x N.
fn min_singular_value<const N: usize>(J: &SMatrix<f64, 6, N>) -> f64 {
    DMatrix::from_column_slice(6, N, J.as_slice()).singular_values().min()
}

fn joints<const N: usize>(q: &[f64]) -> SVector<f64, N> {
    SVector::from_fn(|i, _| q.get(i).copied().unwrap_or(0.0))
}

/// Where each point of each target is to be in the image, by its last goal.
fn goal<const N: usize>(config: &Config, run: &LockstepRun<N>) -> String {
    let mut out = String::from("point,u_px,v_px,target_number\n");
    for set_point in run.mission.set_points() {
        for (id, s) in set_point.ids().iter().zip(set_point.features()) {
            let px = config.camera.model.pixel_of(s);
            // a String takes everything
            let _ = writeln!(out, "{},{:.3},{:.3},{}", id + 1, px.x, px.y, set_point.target());
        }
    }
    out
}

/// Frames of the cell in B at the first tick and at the last, and the origins of the joints' frames: O and D of the first target, `O1`, `D1` and so on of the
/// further ones, and each O as it is seen from its D (`O_in_D`). Without an arm that moves the camera: the desired camera in the frame of the object.
fn poses<const N: usize>(config: &Config, run: &LockstepRun<N>, history: &RunHistory) -> String {
    let mut out = String::from("frame,x_m,y_m,z_m,qx,qy,qz,qw\n");
    let X_DO = run.mission.set_points().next().and_then(|goal| goal.X_DO().copied());
    if !config.has_an_arm() {
        pose(&mut out, "O", &Pose::identity());
        if let Some(X_DO) = X_DO {
            pose(&mut out, "D", &X_DO.inverse());
        }
        return out;
    }
    let Some((first, last, span)) = history.ends() else { return out };
    pose(&mut out, "B", &Pose::identity());
    let robot = &run.controller().arm().robot;
    let mut objects = Vec::new();
    for (when, q, at) in [("start", first, SpanNs::ZERO), ("end", last, span)] {
        let q = joints(q);
        let X_BE = robot.forward(&q);
        let X_BC = config.camera.mount.X_BC(robot, &q);
        pose(&mut out, &format!("E_{when}"), &X_BE);
        pose(&mut out, &format!("C_{when}"), &X_BC);
        for (i, p) in robot.joint_origins(&q).into_iter().enumerate() {
            pose(&mut out, &format!("joint_{}_{when}", i + 1), &place(p));
        }
        let object = |number: u32| {
            let X_WO = config.scene.as_ref().map(|scene| {
                scene.places().nth(number as usize).map(|(X_WO, motion)| motion.object_at(&X_WO, at))
            });
            match (X_WO, config.camera.mount.is_on_arm()) {
                (Some(X_WO), true) => X_WO,
                (Some(X_WO), false) => X_WO.map(|X_WO| X_BE * X_WO),
                // As the last measurement has it, of an arm that rests by then; what was looked for before was seen from elsewhere.
                (None, _) => history.last_pose(number).filter(|_| when == "end").map(|X_CO| X_BC * X_CO),
            }
        };
        objects = run.mission.set_points().map(|goal| (goal, object(goal.target()))).collect();
        for (goal, X_BO) in &objects {
            if let Some(X_BO) = X_BO {
                pose(&mut out, &format!("O{}_{when}", suffix(goal)), X_BO);
            }
        }
    }
    for (goal, X_BO) in objects {
        // Beside a true object stands the camera that truly sees it so.
        let true_goal = run.mission.in_truth(goal);
        if let (Some(X_BO), Some(X_DO)) = (X_BO, true_goal.as_ref().unwrap_or(goal).X_DO()) {
            pose(&mut out, &format!("D{}", suffix(goal)), &(X_BO * X_DO.inverse()));
        }
        if let Some(X_DO) = goal.X_DO() {
            pose(&mut out, &format!("O{}_in_D", suffix(goal)), X_DO);
        }
    }
    out
}

/// What the frames of the target of `goal` end with: its number, of the first one nothing.
fn suffix(goal: &SetPoint) -> String {
    if goal.target() == 0 { String::new() } else { goal.target().to_string() }
}

fn place(p: Vector3<f64>) -> Pose {
    Pose::from_parts(p.into(), nalgebra::UnitQuaternion::identity())
}

fn pose(out: &mut String, frame: &str, X: &Pose) {
    let (p, r) = (X.translation.vector, X.rotation.coords);
    let _ =
        writeln!(out, "{frame},{:.9},{:.9},{:.9},{:.9},{:.9},{:.9},{:.9}", p.x, p.y, p.z, r.x, r.y, r.z, r.w);
}
