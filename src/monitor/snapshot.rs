//! A run at one moment, as the page of `vservo watch` is told it: numbers in the units that stand in their names; what is not known is `null`.

use super::draw::{EDGES_US, tick_counts};
use super::robot_row::RobotRow;
use super::run_view::RunView;
use crate::control::outcome::Outcome;
use crate::control::safety::Fault;
use crate::messages::{CameraState, ControlState, TargetStatus, health_flag, status_flag};
use crate::motion::Limit;
use crate::time::MonoNs;
use serde::Serialize;
use std::collections::VecDeque;

/// Places of all trails together. Chosen by hand: sixteen points with half of what is kept of each, so that a grid of 64 points makes no
/// message of 40 kB ten times a second.
const MOST_TRAIL_PLACES: usize = 400;

/// What does not change in a run, and is told once.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunFacts {
    /// The name of the instance.
    pub instance: String,
    /// Whether time is simulated.
    pub lockstep: bool,
    /// Whether the run serves requests.
    pub serves: bool,
    /// Columns and rows of the image.
    pub image_px: [f64; 2],
    /// Feature error below which the goal is reached.
    pub tolerance_px: f64,
    /// Upper edges of the classes of [`DeadlineTimes::counts`] but the last, which has none.
    pub edges_us: Vec<f64>,
}

/// A joint between its limits.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointRow {
    /// Its name.
    pub name: String,
    /// Its position in `unit`.
    pub position: f64,
    /// `deg`, or `mm` of a joint that slides.
    pub unit: &'static str,
    /// Its least position, `null` where it has none.
    pub lower: f64,
    /// Its greatest position.
    pub upper: f64,
    /// Its speed as a share of its largest.
    pub speed_share: f64,
    /// Its torque or force as a share of its largest.
    pub effort_share: f64,
    /// The limits that act on it.
    pub limits: Vec<&'static str>,
}

/// Where the time of a measurement goes, ms; quantiles are of exposure to command.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StageTimes {
    /// From exposure to the sending of the frame.
    pub exposure_ms: f64,
    /// From there to the begin of vision.
    pub wait_ms: f64,
    /// In vision.
    pub vision_ms: f64,
    /// From vision to the command.
    pub control_ms: f64,
    /// Median.
    pub p50_ms: f64,
    /// 99 of 100 are at most this.
    pub p99_ms: f64,
    /// Largest.
    pub max_ms: f64,
}

/// From the deadline of a tick to its command.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DeadlineTimes {
    /// Median.
    pub p50_us: f64,
    /// 99 of 100 are at most this.
    pub p99_us: f64,
    /// Largest.
    pub max_us: f64,
    /// Ticks in the classes of [`RunFacts::edges_us`]; empty in simulated time.
    pub counts: Vec<u64>,
    /// Deadlines that were missed.
    pub missed: u64,
    /// Ticks whose records this watcher did not get.
    pub unseen: u64,
}

/// How a real camera stands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HealthRow {
    /// Its number.
    pub camera: u32,
    /// Its state in a word.
    pub state: &'static str,
    /// Whether it gives no frames.
    pub is_away: bool,
    /// Frames per second that it exposes.
    pub rate_hz: f64,
    /// Frames that were lost.
    pub lost: u64,
    /// What is doubtful of it.
    pub doubts: Vec<&'static str>,
}

/// A process of the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProcessRow {
    /// Its role, or its program.
    pub role: String,
    /// Its number.
    pub pid: u32,
    /// What it took of one core since the last look; `null` at the first.
    pub core_share: Option<f64>,
    /// Its resident memory.
    pub memory_mb: f64,
}

/// A run at one moment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunSnapshot {
    /// The state of control in a word.
    pub state: &'static str,
    /// What it waits for, or does.
    pub waits_for: String,
    /// Whether that is in order.
    pub is_good: bool,
    /// Whether the run is over.
    pub ended: bool,
    /// How it ended, once it has.
    pub outcome: Option<&'static str>,
    /// Why.
    pub reason: Option<&'static str>,
    /// Time of the run.
    pub time_s: f64,
    /// Root mean square feature error.
    pub feature_error_px: f64,
    /// Distance of the camera from its goal.
    pub position_error_mm: f64,
    /// Angle of the camera from its goal.
    pub orientation_error_deg: f64,
    /// Number of the goal.
    pub goal: u32,
    /// Name of its target, of a run with several.
    pub target_name: Option<String>,
    /// Whether a part of the target is hidden.
    pub is_degraded: bool,
    /// Where the time of a measurement goes.
    pub stages: StageTimes,
    /// Deadline to command.
    pub ticks: DeadlineTimes,
    /// Frames that vision received.
    pub frames: u64,
    /// Frames that it skipped.
    pub frames_dropped: u64,
    /// How often the target was lost.
    pub target_lost: u64,
    /// What the last measurement shows of the target.
    pub target: Option<&'static str>,
    /// Misfit of its points.
    pub reprojection_rms_px: f64,
    /// How long no measurement came, where that is too long.
    pub blind_for_s: Option<f64>,
    /// How often camera and vision were started anew.
    pub restarts: [u32; 2],
    /// What the robot is beside its joints, where its drive tells.
    pub robot: Option<RobotRow>,
    /// The real cameras.
    pub health: Vec<HealthRow>,
    /// The joints.
    pub joints: Vec<JointRow>,
    /// The points that are seen: number, column and row, px.
    pub features: Vec<(u64, f64, f64)>,
    /// Where the points of the goal are to be.
    pub goal_points: Vec<(u32, f64, f64)>,
    /// Where each point came from, oldest first.
    pub trails: Vec<Vec<[f64; 2]>>,
    /// The processes.
    pub processes: Vec<ProcessRow>,
    /// Feature errors so far; those that are kept are told apart from this.
    pub errors_seen: u64,
    /// Events so far.
    pub events_seen: u64,
}

/// To a tenth of a pixel, which is more than a screen shows.
fn tenth(x: f64) -> f64 {
    (x * 10.0).round() / 10.0
}

fn limit_name(limit: Limit) -> &'static str {
    match limit {
        Limit::Position => "end of range",
        Limit::Velocity => "velocity",
        Limit::Acceleration => "acceleration",
        Limit::Jerk => "jerk",
        Limit::Effort => "effort",
        Limit::Singularity => "singularity",
        Limit::View => "view",
        Limit::Stall => "stall",
        Limit::Workspace => "workspace",
    }
}

impl RunView {
    /// What does not change in the run.
    #[must_use]
    pub fn run_facts(&self) -> RunFacts {
        let facts = &self.facts;
        RunFacts {
            instance: facts.instance.clone(),
            lockstep: facts.lockstep,
            serves: facts.serves,
            image_px: facts.image_px,
            tolerance_px: facts.goal_error_px,
            edges_us: EDGES_US.to_vec(),
        }
    }

    /// The feature errors that are kept, oldest first: when, s, and px.
    #[must_use]
    pub fn kept_errors(&self) -> &VecDeque<(f64, f64)> {
        &self.errors
    }

    /// The events that are kept, oldest first: when, s, and what.
    #[must_use]
    pub fn kept_events(&self) -> &VecDeque<(f64, String)> {
        &self.events
    }

    /// The run at `now` by the watcher's clock.
    #[must_use]
    pub fn snapshot(&self, now: MonoNs, processes: Vec<ProcessRow>) -> RunSnapshot {
        let s = self.status.map(|newest| newest.record).unwrap_or_default();
        let known = |x: f64| if self.status.is_some() { x } else { f64::NAN };
        let (waits_for, is_good) = self.waits_for(now);
        let outcome = self.trace.and_then(|trace| Outcome::from_code(trace.outcome));
        let measurement = self.measurement.map(|newest| newest.record);
        let seen = measurement.filter(|m| m.target_status() == TargetStatus::Found);
        let features = seen.iter().flat_map(|m| m.features());
        RunSnapshot {
            state: self.state().map_or("unknown", ControlState::as_str),
            waits_for,
            is_good,
            ended: self.ended.is_some(),
            outcome: outcome.map(Outcome::as_str),
            reason: outcome.map(|outcome| self.reason(outcome)),
            time_s: known(s.time_s),
            feature_error_px: known(s.feature_error_px),
            position_error_mm: known(s.position_error_m * 1e3),
            orientation_error_deg: known(s.orientation_error_rad.to_degrees()),
            goal: s.goal,
            target_name: self.target_name(s.target_number).map(str::to_owned),
            is_degraded: s.flags & status_flag::DEGRADED != 0,
            stages: self.stage_times(),
            ticks: self.tick_times(),
            frames: s.frames,
            frames_dropped: s.frames_dropped,
            target_lost: s.target_lost,
            target: measurement.map(|m| m.target_status().as_str()),
            reprojection_rms_px: measurement.map_or(f64::NAN, |m| m.reprojection_rms_px),
            blind_for_s: self.blind_for_s(now).filter(|_| self.ended.is_none()),
            restarts: self.restarts(),
            robot: self.robot_row(),
            health: self.health_rows(),
            joints: self.joint_rows(),
            features: features.map(|f| (f.id, tenth(f.u_px), tenth(f.v_px))).collect(),
            goal_points: self.goal_px.iter().map(|(id, [u, v])| (*id, tenth(*u), tenth(*v))).collect(),
            trails: self.thinned_trails(),
            processes,
            errors_seen: self.errors_seen,
            events_seen: self.events_seen,
        }
    }

    fn reason(&self, outcome: Outcome) -> &'static str {
        match outcome {
            Outcome::Converged => "the goal was reached and held",
            Outcome::NotConverged => "the time of the run was over before the goal was reached",
            Outcome::Finished => "the motion was completed",
            Outcome::Stopped => "the end was requested",
            Outcome::Fault => {
                self.trace.and_then(|trace| Fault::from_code(trace.fault)).map_or("a fault", Fault::describe)
            }
        }
    }

    fn stage_times(&self) -> StageTimes {
        let s = self.status.map(|newest| newest.record);
        let ms = |us: Option<f64>| us.map_or(f64::NAN, |us| us * 1e-3);
        let quantile = |q| {
            let is_known = self.latencies.count() > 0;
            if is_known { self.latencies.quantile_ns(q) as f64 * 1e-6 } else { f64::NAN }
        };
        StageTimes {
            exposure_ms: ms(s.map(|s| s.exposure_to_frame_us)),
            wait_ms: ms(s.map(|s| s.frame_to_vision_us)),
            vision_ms: ms(s.map(|s| s.vision_us)),
            control_ms: ms(s.map(|s| s.measurement_to_command_us)),
            p50_ms: quantile(0.5),
            p99_ms: quantile(0.99),
            max_ms: quantile(1.0),
        }
    }

    fn tick_times(&self) -> DeadlineTimes {
        let times = &self.tick_times;
        let has_any = times.count() > 0;
        let quantile = |q| if has_any { times.quantile_ns(q) as f64 * 1e-3 } else { f64::NAN };
        DeadlineTimes {
            p50_us: quantile(0.5),
            p99_us: quantile(0.99),
            max_us: quantile(1.0),
            counts: if has_any { tick_counts(times).to_vec() } else { Vec::new() },
            missed: self.status.map_or(0, |newest| newest.record.missed_deadlines),
            unseen: self.unseen,
        }
    }

    fn health_rows(&self) -> Vec<HealthRow> {
        let doubts = [
            (health_flag::STAMPS_DOUBTED, "stamps doubted"),
            (health_flag::RATE_MISSED, "other rate than asked"),
        ];
        let row = |(camera, health): (&u32, &crate::messages::CameraHealth)| {
            let state = CameraState::from_code(health.state);
            let is_set = |(flag, word): &(u32, &'static str)| (health.flags & flag != 0).then_some(*word);
            HealthRow {
                camera: *camera,
                state: state.as_str(),
                is_away: state.is_away(),
                rate_hz: health.rate_hz,
                lost: health.lost,
                doubts: doubts.iter().filter_map(is_set).collect(),
            }
        };
        self.health.iter().map(row).collect()
    }

    fn joint_rows(&self) -> Vec<JointRow> {
        let Some(trace) = &self.trace else { return Vec::new() };
        let row = |(i, joint): (usize, &crate::report::run_page::JointSummary)| {
            let at = |values: &[f64]| values.get(i).copied().unwrap_or(f64::NAN);
            let shown = |x: f64| if joint.slides { x * 1e3 } else { x.to_degrees() };
            let acts = |limit: &Limit| {
                let mask = trace.limits.get(*limit as usize).copied().unwrap_or(0);
                mask.checked_shr(i as u32).unwrap_or(0) & 1 == 1
            };
            JointRow {
                name: joint.name.clone(),
                position: shown(at(&trace.q)),
                unit: if joint.slides { "mm" } else { "deg" },
                lower: shown(joint.lower),
                upper: shown(joint.upper),
                speed_share: at(&trace.qd).abs() / joint.velocity,
                effort_share: at(&trace.tau).abs() / joint.effort,
                limits: Limit::ALL
                    .iter()
                    .filter(|limit| acts(limit))
                    .map(|limit| limit_name(*limit))
                    .collect(),
            }
        };
        self.facts.joints.iter().enumerate().map(row).collect()
    }

    /// The trails, with every n-th place where all of them are too many.
    fn thinned_trails(&self) -> Vec<Vec<[f64; 2]>> {
        let places: usize = self.trails.values().map(VecDeque::len).sum();
        let step = places.div_ceil(MOST_TRAIL_PLACES).max(1);
        let thin = |trail: &VecDeque<[f64; 2]>| {
            let mut kept: Vec<[f64; 2]> = trail.iter().rev().step_by(step).map(|p| p.map(tenth)).collect();
            kept.reverse();
            kept
        };
        self.trails.values().map(thin).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Measurement, Status, TraceMsg};
    use crate::monitor::CellFacts;
    use crate::report::run_page::JointSummary;

    fn joint() -> JointSummary {
        JointSummary {
            name: "turn".into(),
            lower: -1.0,
            upper: f64::INFINITY,
            velocity: 2.0,
            effort: 10.0,
            slides: false,
        }
    }

    #[test]
    fn what_is_not_known_is_null() {
        let view = RunView::new(CellFacts { joints: vec![joint()], ..CellFacts::default() });
        let told = serde_json::to_value(view.snapshot(MonoNs(0), Vec::new())).unwrap();
        for key in ["time_s", "feature_error_px", "position_error_mm", "outcome", "reprojection_rms_px"] {
            assert!(told[key].is_null(), "{key}: {}", told[key]);
        }
        assert_eq!(told["state"], "unknown");
        assert_eq!(told["waits_for"], "waits for control's first word");
        assert!(told["stages"]["p50_ms"].is_null() && told["ticks"]["counts"][0].is_null());
    }

    #[test]
    fn a_joint_at_its_limit_says_which_one_acts() {
        let mut view = RunView::new(CellFacts { joints: vec![joint()], ..CellFacts::default() });
        let mut trace = TraceMsg { outcome: Outcome::Fault.code(), ..TraceMsg::default() };
        (trace.q[0], trace.qd[0], trace.tau[0]) = (1.0, -1.0, 5.0);
        trace.limits[Limit::Velocity as usize] = 1;
        trace.fault = Fault::TrackingError.code();
        view.tick(&trace);
        let told = view.snapshot(MonoNs(0), Vec::new());
        let row = &told.joints[0];
        assert!((row.position - 57.296).abs() < 1e-3 && row.unit == "deg", "{row:?}");
        assert_eq!((row.speed_share, row.effort_share), (0.5, 0.5));
        assert_eq!(row.limits, ["velocity"]);
        assert_eq!(told.outcome, Some("fault"));
        assert_eq!(told.reason, Some(Fault::TrackingError.describe()));
        assert!(serde_json::to_value(&told).unwrap()["joints"][0]["upper"].is_null(), "it has none");
    }

    #[test]
    fn trails_of_many_points_are_thinned_and_end_at_the_newest() {
        let mut view = RunView::new(CellFacts::default());
        view.status(&Status::default(), MonoNs(0));
        for k in 0..50 {
            let mut m = Measurement { status: 0, feature_count: 64, ..Measurement::default() };
            for (id, feature) in m.features.iter_mut().enumerate() {
                (feature.id, feature.u_px) = (id as u64, f64::from(k));
            }
            view.measurement(&m, MonoNs(0));
        }
        let told = view.snapshot(MonoNs(0), Vec::new());
        let places: usize = told.trails.iter().map(Vec::len).sum();
        assert!(told.trails.len() == 64 && places <= MOST_TRAIL_PLACES + 64, "{places}");
        assert!(told.trails.iter().all(|trail| trail.last() == Some(&[49.0, 0.0])));
        assert_eq!(told.features.len(), 64);
    }
}
