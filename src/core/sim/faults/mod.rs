//! Faults as a tool: every kind of `[[faults]]` against laws and arms, each run judged by how it ends and by what the arm itself did (`vservo faults`).
//!
//! ```text
//! FaultCase x law x arm x seed ─► run file with [[faults]] ─► simulated run ─► FaultRun: end, reason, speed, acceleration and jerk of the true arm ─► FaultTable
//! ```
//! An end is right where the run converges at the true goal, or where it ends by a fault, at rest, that docs/safety.md has for what is wrong; a run that is blind for
//! good is right where it holds until its time is over.

mod cases;
mod table;

pub use cases::{CAMPAIGN_ARMS, CAMPAIGN_LAWS, CampaignArm, FAULT_CASES, FaultCase, RightEnds};
pub use table::FaultTable;

use crate::config::{Config, ConfigError};
use crate::control::outcome::Outcome;
use crate::control::safety::Fault;
use crate::control::trace::Trace;
use crate::messages::{ControlState, JointState};
use crate::sim::{Moment, SimError, SystemRun, simulate_system};
use crate::time::TICK;
use serde::Serialize;
use std::ops::ControlFlow::Continue;
use std::path::Path;
use thiserror::Error;

/// Longest simulated run, s. Chosen by hand: undisturbed runs of the three arms are over within 3 s, faults within 1.5 s.
const DURATION_S: f64 = 12.0;
/// True feature error from which on a run that counts as converged is at the wrong place, px. Chosen by hand: twenty times the tolerance of the shipped files.
const AT_THE_GOAL_PX: f64 = 1.0;
/// Speed of the true arm up to which it rests, rad/s or m/s. Chosen by hand: twice the speed of `control/safety/rest.rs`, for what was measured may be old.
const REST: f64 = 0.04;

/// Why a run of a campaign cannot be made.
#[derive(Debug, Error)]
pub enum CampaignError {
    /// Its run file is refused.
    #[error("{what}: {cause}")]
    RunFile {
        /// Which run.
        what: String,
        /// What is wrong with it.
        cause: ConfigError,
    },
    /// It cannot be simulated.
    #[error("{what}: {cause}")]
    Simulation {
        /// Which run.
        what: String,
        /// What the simulation says.
        cause: Box<SimError>,
    },
}

/// One run to be made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultJob {
    /// What is put wrong.
    pub case: &'static FaultCase,
    /// Name and settings of the law.
    pub law: &'static (&'static str, &'static [&'static str]),
    /// The arm.
    pub arm: &'static CampaignArm,
    /// Seed of the run.
    pub seed: u64,
}

/// All runs of cases, laws and arms whose names are asked for (all where none is), with `seeds` seeds each.
#[must_use]
pub fn jobs(cases: &[String], laws: &[String], arms: &[String], seeds: u64) -> Vec<FaultJob> {
    let asked = |names: &[String], name: &str| names.is_empty() || names.iter().any(|n| n == name);
    let mut all = Vec::new();
    for case in FAULT_CASES.iter().filter(|case| asked(cases, case.name)) {
        for law in CAMPAIGN_LAWS.iter().filter(|law| asked(laws, law.0)) {
            for arm in CAMPAIGN_ARMS.iter().filter(|arm| asked(arms, arm.name)) {
                all.extend((1..=seeds).map(|seed| FaultJob { case, law, arm, seed }));
            }
        }
    }
    all
}

/// How one run went.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultRun {
    /// What was put wrong.
    pub case: &'static str,
    /// Under which law.
    pub law: &'static str,
    /// Which arm.
    pub arm: &'static str,
    /// By which seed.
    pub seed: u64,
    /// How it ended.
    pub outcome: Outcome,
    /// Why, for people.
    pub reason: &'static str,
    /// Whether that is right.
    pub is_right: bool,
    /// How long it was, s.
    pub time_s: f64,
    /// How long it held for want of measurements, or went back to where it saw the target, s.
    pub held_s: f64,
    /// Fastest true speed of a joint by its limit.
    pub speed_by_limit: f64,
    /// Greatest true acceleration of a joint, of differences of its speed over a tick, by its limit.
    pub acceleration_by_limit: f64,
    /// Greatest true jerk of a joint, of differences of that, by its limit.
    pub jerk_by_limit: f64,
    /// Greatest torque (force) that a drive was told, by the joint's effort; nothing is told to one that has a servo of its own.
    pub torque_by_limit: f64,
    /// How far a true joint was beyond an end of its range, rad or m.
    pub beyond_range: f64,
    /// Greatest acceleration of the joint reference by its limit: what control itself asks for.
    pub commanded_by_limit: f64,
    /// Whether all states and commands were numbers.
    pub is_finite: bool,
    /// Fastest true speed of a joint at the end, rad/s or m/s.
    pub last_speed: f64,
    /// Whether the true arm rested at the end.
    pub is_at_rest: bool,
    /// True feature error at the end, px.
    pub final_error_px: Option<f64>,
    /// Over every joint state, hexadecimal.
    pub state_hash: String,
}

impl FaultJob {
    /// The changes to the shipped run file.
    #[must_use]
    pub fn settings(&self) -> Vec<String> {
        let mut set: Vec<String> = self.law.1.iter().map(ToString::to_string).collect();
        set.extend(self.arm.set.iter().map(ToString::to_string));
        let entry = self.case.entry(self.seed, self.arm.joints);
        if !entry.is_empty() {
            set.push(format!("faults=[{{{entry}}}]"));
        }
        set
    }

    /// The command that runs it once more, with processes.
    #[must_use]
    pub fn command(&self) -> String {
        // Single quotes are the shell's.
        let set: String =
            self.settings().iter().map(|set| format!(" --set '{}'", set.replace('\'', "\""))).collect();
        format!(
            "vservo run {} --clock lockstep --seed {} --duration-s {DURATION_S}{set}",
            self.arm.file, self.seed
        )
    }

    /// Flies it.
    ///
    /// # Errors
    /// [`CampaignError`].
    pub fn run(&self) -> Result<FaultRun, CampaignError> {
        let what = || format!("{} under {} on {}", self.case.name, self.law.0, self.arm.name);
        let mut set = self.settings();
        set.push("run.clock=lockstep".into());
        set.push(format!("run.duration_s={DURATION_S}"));
        set.push(format!("run.seed={}", self.seed));
        let config = Config::load(Some(Path::new(self.arm.file)), &set)
            .map_err(|cause| CampaignError::RunFile { what: what(), cause })?;
        let mut plant = PlantWatch::of(&config);
        let run = simulate_system(&config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                plant.note(trace);
            }
            Continue(())
        });
        let run = run.map_err(|cause| CampaignError::Simulation { what: what(), cause: Box::new(cause) })?;
        Ok(self.judged(&run, &plant))
    }

    fn judged(&self, run: &SystemRun, plant: &PlantWatch) -> FaultRun {
        let error_px = run.errors.feature_error_px;
        let is_there = error_px.is_some_and(|px| px <= AT_THE_GOAL_PX);
        let is_at_rest = plant.last_speed <= REST;
        let ends = &self.case.ends;
        let is_right = (is_at_rest || plant.worst[0] <= ends.moves_within)
            && match run.finish.outcome {
                Outcome::Converged => is_there && !ends.only_holds,
                Outcome::NotConverged => ends.only_holds && plant.ended_holding,
                Outcome::Fault => plant.fault.is_some_and(|fault| ends.faults.contains(&fault)),
                Outcome::Finished | Outcome::Stopped => false,
            };
        FaultRun {
            case: self.case.name,
            law: self.law.0,
            arm: self.arm.name,
            seed: self.seed,
            outcome: run.finish.outcome,
            reason: run.finish.reason,
            is_right,
            time_s: plant.ticks as f64 * TICK.as_s(),
            held_s: plant.held as f64 * TICK.as_s(),
            speed_by_limit: plant.worst[0],
            acceleration_by_limit: plant.worst[1],
            jerk_by_limit: plant.worst[2],
            torque_by_limit: plant.torque,
            beyond_range: plant.beyond_range,
            commanded_by_limit: plant.commanded,
            is_finite: plant.is_finite,
            last_speed: plant.last_speed,
            is_at_rest,
            final_error_px: error_px,
            state_hash: run.state_hash.clone(),
        }
    }
}

/// Watches the true arm of a run, against the limits of its run file.
struct PlantWatch {
    /// Speed, acceleration and jerk of each joint that are allowed.
    limits: [Vec<f64>; 3],
    /// Speed and acceleration of the tick before.
    before: [Vec<f64>; 2],
    reference: Vec<f64>,
    worst: [f64; 3],
    /// Ends of each joint's range, and its effort.
    ranges: Vec<[f64; 3]>,
    torque: f64,
    beyond_range: f64,
    commanded: f64,
    is_finite: bool,
    last_speed: f64,
    fault: Option<Fault>,
    ended_holding: bool,
    ticks: u64,
    held: u64,
}

impl PlantWatch {
    fn of(config: &Config) -> Self {
        let speeds: Vec<f64> = config.robot.joints.iter().map(|joint| joint.limits.velocity).collect();
        let zeros = vec![0.0; speeds.len()];
        Self {
            limits: [speeds, config.motion.max_acceleration.clone(), config.motion.max_jerk.clone()],
            before: [zeros.clone(), zeros.clone()],
            reference: zeros,
            worst: [0.0; 3],
            ranges: config
                .robot
                .joints
                .iter()
                .map(|joint| &joint.limits)
                .map(|l| [l.lower, l.upper, l.effort])
                .collect(),
            torque: 0.0,
            beyond_range: 0.0,
            commanded: 0.0,
            is_finite: true,
            last_speed: 0.0,
            fault: None,
            ended_holding: false,
            ticks: 0,
            held: 0,
        }
    }

    fn note(&mut self, trace: &Trace) {
        let JointState { q, qd, tau, q_r, qd_r, q_true, qd_true, .. } = &trace.joint_state;
        self.is_finite &=
            [q, qd, tau, q_r, qd_r, q_true, qd_true].into_iter().flatten().all(|x| x.is_finite());
        let by = |x: f64, limits: &[f64], i: usize| x.abs() / limits.get(i).copied().unwrap_or(f64::INFINITY);
        self.last_speed = 0.0;
        let joints = self.limits[0].len();
        for (i, speed) in qd_true.iter().copied().take(joints).enumerate() {
            let acceleration = (speed - self.before[0][i]) / TICK.as_s();
            let jerk = (acceleration - self.before[1][i]) / TICK.as_s();
            let all = [speed, acceleration, jerk];
            for ((worst, x), limits) in self.worst.iter_mut().zip(all).zip(&self.limits) {
                *worst = worst.max(by(x, limits, i));
            }
            (self.before[0][i], self.before[1][i]) = (speed, acceleration);
            self.last_speed = self.last_speed.max(speed.abs());
            if let Some([lower, upper, effort]) = self.ranges.get(i) {
                self.torque = self.torque.max(trace.command.tau[i].abs() / effort);
                self.beyond_range = self.beyond_range.max(lower - q_true[i]).max(q_true[i] - upper);
            }
            let asked = (trace.command.qd_r[i] - self.reference[i]) / TICK.as_s();
            self.commanded = self.commanded.max(by(asked, &self.limits[1], i));
            self.reference[i] = trace.command.qd_r[i];
        }
        self.fault = trace.fault.or(self.fault);
        if !matches!(trace.state, ControlState::Stopping | ControlState::Stopped) {
            // On its way back to where the target was seen it rests as well, where it cannot come nearer.
            self.ended_holding = matches!(trace.state, ControlState::Holding | ControlState::Returning);
        }
        self.held += u64::from(matches!(trace.state, ControlState::Holding | ControlState::Returning));
        self.ticks += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_arm_has_the_joints_that_faults_are_drawn_for() {
        for arm in &CAMPAIGN_ARMS {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../config/{}.toml", arm.file));
            let config = Config::load(Some(&path), &[]).unwrap();
            assert_eq!(config.robot.joints.len(), arm.joints, "{}", arm.name);
        }
    }

    #[test]
    fn seeds_draw_other_times_and_joints_and_commands_can_be_run() {
        let case = FAULT_CASES.iter().find(|case| case.name == "encoder-freeze").unwrap();
        let entries: std::collections::BTreeSet<String> = (1..=100).map(|seed| case.entry(seed, 7)).collect();
        assert!(entries.len() > 95, "{entries:?}");
        assert!((0..7).all(|joint| entries.iter().any(|entry| entry.ends_with(&format!("joint={joint}")))));
        let jobs = jobs(&["encoder-freeze".into()], &[], &["ur5".into()], 1);
        assert!(jobs.iter().all(|job| job.command().matches('\'').count() % 2 == 0));
        assert!(jobs.iter().all(|job| job.command().contains("kind=\"encoder_freeze\"")));
    }

    /// What a seed draws is a run file that is taken, so that no campaign ends in its midst.
    #[test]
    fn what_seeds_draw_can_be_run() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/ur5.toml");
        for job in jobs(&[], &["B".into()], &["ur5".into()], 30) {
            let config = Config::load(Some(&path), &job.settings());
            assert!(config.is_ok(), "{}: {:?}", job.case.name, config.err());
        }
    }
}
