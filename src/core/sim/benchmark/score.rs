//! One run of one law or entrant, and what it is worth, by the truth of the simulation.
//!
//! With the true pixels u_i(t) of the n points of the target and u_i* those at the true goal, e(t) = sqrt(sum |u_i - u_i*|^2 / n), s(t) the arc of a curve:
//!
//! | score | equation |
//! | --- | --- |
//! | settling | the last time at which e enters the tolerance, where it then stays for `hold_s` |
//! | path excess in the image | sum of the arcs of u_i up to settling, over the sum of their straight lines, less 1 |
//! | path excess in space | arc of the camera about the object up to settling less the straight line, m |
//! | least image margin | least distance of any u_i from the border, px |
//! | final error | root mean square of e, and of the camera's pose, over the last 0.2 s |
//! | energy | integral of sum_j abs(tau_j qd_j) dt over the run, J |

use super::entrant::EntrantCommander;
use super::suite::settings;
use super::{BenchmarkError, BenchmarkScenario, BenchmarkSuite, BenchmarkTask, EntrantLink, RunTruth};
use crate::config::{Config, ConfigError, Scene};
use crate::control::outcome::Outcome;
use crate::control::trace::Trace;
use crate::geometry::{Pose, rotation_angle};
use crate::mission::truth::Truth;
use crate::robot::Robot;
use crate::sim::{Drives, Moment, SimError, SystemRun, simulate_commanded, simulate_system_with};
use crate::time::{MonoNs, TICK};
use nalgebra::{Point3, SVector, Vector2, Vector3};
use serde::Serialize;
use std::ops::ControlFlow::{self, Break, Continue};

/// Ticks between two points of a path. Chosen by hand: 10 ms, below which the trembling of an arm at rest would count as a way.
const PATH_TICKS: u64 = 10;
/// Over how long the final error is taken, s. Chosen by hand: five frames of a camera of 25 Hz, and within the hold.
const REST_S: f64 = 0.2;

/// What one run is worth; `None` where there is nothing to tell: times and paths of runs that did not arrive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunScores {
    /// Whether the goal was reached and held.
    pub converged: bool,
    /// When, s.
    pub settling_s: Option<f64>,
    /// The same by the arm's least time.
    pub settling_by_least: Option<f64>,
    /// Path excess in the image, 0 for straight lines.
    pub image_path_excess: Option<f64>,
    /// Path excess in space, m.
    pub space_path_excess_m: Option<f64>,
    /// Least distance of a point from the image's border, px; negative outside, by the image's width at most.
    pub margin_px: f64,
    /// Error at the start, px.
    pub first_error_px: f64,
    /// Error at the end, px.
    pub final_error_px: f64,
    /// Distance of the camera from its goal at the end, m.
    pub final_error_m: f64,
    /// Angle of the camera from its goal at the end, rad.
    pub final_error_rad: f64,
    /// Work of the joints, J.
    pub energy_j: f64,
    /// How often the target was lost.
    pub target_lost: u64,
    /// How long it was simulated, s.
    pub duration_s: f64,
    /// How it ended, in words; of an entrant that failed, how.
    pub end: String,
    /// Over every joint state, hexadecimal.
    pub state_hash: String,
}

/// Who takes part in a run.
pub enum Participant<'a> {
    /// The law of the suite with this number.
    Law(usize),
    /// A program that is not vservo's.
    Entrant(&'a mut dyn EntrantLink),
}

/// The run of `participant` in a scenario, with `drives`; `truth` gets what was true of it, where it is wanted. An entrant that fails ends its run, which is scored like any
/// other, with the reason.
///
/// # Errors
/// [`BenchmarkError`] where the run file does not take the law, or cannot be simulated.
pub fn run_scenario(
    suite: &BenchmarkSuite,
    scenario: &BenchmarkScenario,
    participant: Participant<'_>,
    drives: &mut impl Drives,
    mut truth: Option<&mut RunTruth>,
) -> Result<RunScores, BenchmarkError> {
    let law = match &participant {
        Participant::Law(law) => Some(*law),
        Participant::Entrant(_) => None,
    };
    let config = suite.run_file(scenario, law)?;
    let task = suite.task_of(scenario)?;
    let Some(scene) = &config.scene else {
        return Err(BenchmarkError::task(task, "needs a simulated scene"));
    };
    let mut commander = match participant {
        Participant::Law(_) => None,
        Participant::Entrant(link) => {
            Some(EntrantCommander::new(link, &config, task).map_err(|e| BenchmarkError::task(task, e))?)
        }
    };
    let run = crate::dispatch_robot!(scene.arm, |robot| {
        if let Some(truth) = &mut truth {
            truth.begin(task, scene, &scenario.X_DO, robot.limits().len());
        }
        let mut judge = Judgement::new(task, scene, robot, scenario.X_DO);
        judge.table = truth;
        let watch = &mut |moment: &Moment<'_>| judge.watch(moment);
        let run = match &mut commander {
            None => simulate_system_with(&config, drives, watch),
            Some(commander) => simulate_commanded(&config, drives, commander, watch),
        };
        run.map(|run| judge.scores(&run, scenario.least_time_s))
    });
    let failed = |cause: SimError| BenchmarkError::Run { task: task.name.clone(), cause: cause.into() };
    let mut scores = run.map_err(|e| failed(e.into()))?.map_err(failed)?;
    if let Some(why) = commander.and_then(EntrantCommander::end) {
        scores.end = format!("the entrant {why}");
    }
    Ok(scores)
}

/// A point of the paths.
struct PathPoint {
    px: Vec<Vector2<f64>>,
    p_OC: Vector3<f64>,
}

/// What watches a run.
struct Judgement<'a, const N: usize> {
    task: &'a BenchmarkTask,
    scene: &'a Scene,
    truth: Truth<N>,
    X_DO: Pose,
    points: Vec<Point3<f64>>,
    goal_px: Vec<Option<Vector2<f64>>>,
    /// Of each tick: error px, m, rad.
    errors: Vec<[f64; 3]>,
    path: Vec<PathPoint>,
    margin_px: f64,
    energy_j: f64,
    /// Ticks in a row within the tolerance.
    within: u64,
    /// What was true of each tick, where that is wanted.
    table: Option<&'a mut RunTruth>,
}

impl<'a, const N: usize> Judgement<'a, N> {
    fn new(task: &'a BenchmarkTask, scene: &'a Scene, robot: Robot<N>, X_DO: Pose) -> Self {
        let points: Vec<_> = scene.target.points().iter().map(|point| point.p_O).collect();
        let goal_px = points.iter().map(|p| scene.camera.project(&(X_DO * p))).collect();
        let (errors, path) = (Vec::new(), Vec::new());
        Self {
            task,
            scene,
            truth: Truth { robot, mount: scene.mount, objects: scene.places().collect(), sight: None },
            X_DO,
            points,
            goal_px,
            errors,
            path,
            margin_px: f64::INFINITY,
            energy_j: 0.0,
            within: 0,
            table: None,
        }
    }

    fn watch(&mut self, moment: &Moment<'_>) -> ControlFlow<()> {
        let Moment::Tick(trace, _) = moment else { return Continue(()) };
        self.note(trace);
        // whoever has come to stay has done what was asked
        let stays = self.within as f64 * TICK.as_s() > self.task.hold_s;
        if stays { Break(()) } else { Continue(()) }
    }

    fn note(&mut self, trace: &Trace) {
        let js = &trace.joint_state;
        // What encoders with steps and offsets report is not where the arm is.
        let q = SVector::<f64, N>::from_fn(|i, _| js.q_true.get(i).copied().unwrap_or_default());
        let Some(X_CO) = self.truth.X_CT(0, &q, trace.time - MonoNs::ZERO) else { return };
        let px: Vec<Option<Vector2<f64>>> =
            self.points.iter().map(|p| self.scene.camera.project(&(X_CO * p))).collect();
        let squares = px
            .iter()
            .zip(&self.goal_px)
            .map(|(px, goal)| px.zip(*goal).map_or(f64::INFINITY, |(a, b)| (a - b).norm_squared()));
        let error_px = (squares.sum::<f64>() / self.points.len() as f64).sqrt();
        let off = X_CO * self.X_DO.inverse();
        let X_DC = self.X_DO * X_CO.inverse();
        self.errors.push([
            error_px,
            X_DC.translation.vector.norm(),
            rotation_angle(&off.rotation.to_rotation_matrix()),
        ]);
        self.within = if error_px <= self.task.tolerance_px { self.within + 1 } else { 0 };
        let i = self.scene.camera.intrinsics();
        let (w, h) = (f64::from(i.width_px) - 0.5, f64::from(i.height_px) - 0.5);
        for px in &px {
            let room = px.map_or(f64::NEG_INFINITY, |u| (u.x + 0.5).min(u.y + 0.5).min(w - u.x).min(h - u.y));
            // far outside is as bad as behind the camera
            self.margin_px = self.margin_px.min(room.max(-w));
        }
        if let Some(table) = &mut self.table {
            let [qd, tau] = [&js.qd_true, &trace.command.tau].map(|all| all.get(..N).unwrap_or_default());
            table.note((trace.time - MonoNs::ZERO).as_s(), &X_CO, qd, tau);
        }
        let power = trace.command.tau.iter().zip(&js.qd_true).take(N).map(|(tau, qd)| (tau * qd).abs());
        self.energy_j += power.sum::<f64>() * TICK.as_s();
        if (self.errors.len() as u64 - 1).is_multiple_of(PATH_TICKS)
            && let Some(px) = px.into_iter().collect()
        {
            self.path.push(PathPoint { px, p_OC: X_CO.inverse().translation.vector });
        }
    }

    fn scores(self, run: &SystemRun, least_time_s: Option<f64>) -> RunScores {
        let held_s = self.within as f64 * TICK.as_s();
        let converged = held_s > self.task.hold_s;
        let settled_at = self.errors.len() as u64 - self.within;
        let settling_s = converged.then(|| settled_at as f64 * TICK.as_s());
        let rest = (REST_S / TICK.as_s()) as usize;
        let rest = self.errors.get(self.errors.len().saturating_sub(rest)..).unwrap_or_default();
        let final_error =
            |k: usize| (rest.iter().map(|e| e[k] * e[k]).sum::<f64>() / rest.len().max(1) as f64).sqrt();
        let until = usize::try_from(settled_at / PATH_TICKS).unwrap_or(usize::MAX).saturating_add(2);
        let path = self.path.get(..until.min(self.path.len())).unwrap_or_default();
        let end = if converged { "at the goal" } else { ending(run) };
        RunScores {
            converged,
            settling_s,
            settling_by_least: settling_s
                .zip(least_time_s)
                .map(|(s, least)| s / least)
                .filter(|x| x.is_finite()),
            image_path_excess: converged.then(|| image_excess(path)).flatten(),
            space_path_excess_m: converged.then(|| space_excess_m(path)).flatten(),
            margin_px: self.margin_px,
            first_error_px: self.errors.first().map_or(f64::NAN, |e| e[0]),
            final_error_px: final_error(0),
            final_error_m: final_error(1),
            final_error_rad: final_error(2),
            energy_j: self.energy_j,
            target_lost: run.target_lost,
            duration_s: self.errors.len() as f64 * TICK.as_s(),
            end: end.into(),
            state_hash: run.state_hash.clone(),
        }
    }
}

/// Why a run did not arrive, in words.
fn ending(run: &SystemRun) -> &'static str {
    match run.finish.outcome {
        Outcome::NotConverged if run.target_lost > 0 => "lost the target, and was not there in time",
        Outcome::NotConverged => "not there in time",
        _ => run.finish.reason,
    }
}

/// Arcs of all points by their straight lines, less 1.
fn image_excess(path: &[PathPoint]) -> Option<f64> {
    let (first, last) = (path.first()?, path.last()?);
    let between =
        |a: &PathPoint, b: &PathPoint| a.px.iter().zip(&b.px).map(|(a, b)| (b - a).norm()).sum::<f64>();
    let arc: f64 = path.windows(2).map(|w| between(&w[0], &w[1])).sum();
    let straight = between(first, last);
    // of no way there is no excess
    (straight > 0.0).then(|| arc / straight - 1.0)
}

/// Arc of the camera less the straight line, m.
fn space_excess_m(path: &[PathPoint]) -> Option<f64> {
    let (first, last) = (path.first()?, path.last()?);
    let arc: f64 = path.windows(2).map(|w| (w[1].p_OC - w[0].p_OC).norm()).sum();
    Some(arc - (last.p_OC - first.p_OC).norm())
}

impl BenchmarkSuite {
    /// The task of a scenario.
    ///
    /// # Errors
    /// [`BenchmarkError::Suite`] where it is of another suite.
    pub fn task_of(&self, scenario: &BenchmarkScenario) -> Result<&BenchmarkTask, BenchmarkError> {
        self.tasks.get(scenario.place.task).ok_or_else(|| self.has_no(&format!("{:?}", scenario.place)))
    }

    pub(super) fn has_no(&self, what: &str) -> BenchmarkError {
        BenchmarkError::Suite { suite: self.name.clone(), cause: format!("has no {what}") }
    }

    /// The run file of the law number `law` in a scenario, as it is simulated; `None`: of who goes by none of its laws.
    ///
    /// # Errors
    /// [`BenchmarkError::Task`] where the run file does not take it.
    pub fn run_file(
        &self,
        scenario: &BenchmarkScenario,
        law: Option<usize>,
    ) -> Result<Config, BenchmarkError> {
        let task = self.task_of(scenario)?;
        let Some(law) = law else {
            return self.config(task, &scenario.set, true).map_err(|e| BenchmarkError::task(task, e));
        };
        let law = self.laws.get(law).ok_or_else(|| self.has_no(&format!("law {law}")))?;
        let set: Vec<String> = scenario.set.iter().cloned().chain(settings(&law.set)).collect();
        let of_law = |e: ConfigError| BenchmarkError::task(task, format!("law `{}`: {e}", law.name));
        self.config(task, &set, true).map_err(of_law)
    }
}
