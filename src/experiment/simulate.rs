//! The loop of Sect. 10.9: vision and law at 25 Hz, the arm on a 1 ms grid.
//!
//! Torque laws: the torque is held for 0.04 s and the rigid-body model is integrated by Runge-Kutta of fourth order.
//! Resolved-velocity laws: the arm is an ideal positioning device, (10.75), and moves with the held joint velocity.
//! Limits of effort and position do not act here, as in the text.
//!
//! The numbers here are the textbook's, where it has any, and else chosen settings of the simulation.

use super::cell::{Cell, project};
use super::feature_source::FeatureSource;
use super::trajectory::{Trajectory, TrajectoryEnd, TrajectoryRow};
use crate::geometry::Pose;
use crate::servo::LawOutput;
use crate::sim::{ClosedLoop, frame_every, run};
use nalgebra::{Vector2, Vector4};
use std::ops::ControlFlow::{self, Break, Continue};

/// Grid of the trajectories, s.
pub const STEP_S: f64 = 1e-3;
/// Steps from frame to frame: 25 Hz.
pub const STEPS_PER_FRAME: u32 = 40;
/// Length of the textbook's runs, s.
pub const SPAN_S: f64 = 8.0;

/// Farther than this (rad, m) a run counts as diverged.
const FAR: f64 = 1e3;

/// What a law is given at each frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawInput {
    /// Number of the frame, from 0.
    pub index: usize,
    /// Joint positions at the exposure, rad and m.
    pub q: Vector4<f64>,
    /// Joint velocities there.
    pub qd: Vector4<f64>,
    /// What the camera measured of P1 ... P4, normalized.
    pub seen: [Vector2<f64>; 4],
}

/// Runs `law` in `cell` for `span_s` with a frame every [`STEPS_PER_FRAME`] steps.
///
/// As [`simulate_at`].
pub fn simulate(
    cell: &Cell,
    name: &str,
    source: &mut FeatureSource,
    span_s: f64,
    law: impl FnMut(&LawInput) -> Result<LawOutput<4>, String>,
) -> Trajectory {
    simulate_at(STEPS_PER_FRAME, cell, name, source, span_s, law)
}

/// Runs `law` in `cell` for `span_s` with a frame every `steps_per_frame` steps.
///
/// The run breaks off with its reason when a point gets behind the camera, when the law has no answer, or when the
/// motion diverges.
pub fn simulate_at(
    steps_per_frame: u32,
    cell: &Cell,
    name: &str,
    source: &mut FeatureSource,
    span_s: f64,
    law: impl FnMut(&LawInput) -> Result<LawOutput<4>, String>,
) -> Trajectory {
    let steps = (span_s / STEP_S).round() as u64;
    let mut textbook = Textbook {
        cell,
        source,
        law,
        steps,
        q: cell.q_start,
        qd: Vector4::zeros(),
        X_CO: cell.X_DO,
        s: [Vector2::zeros(); 4],
        law_output: LawOutput::Velocity(Vector4::zeros()),
        at_frame: (0, cell.q_start),
        rows: Vec::with_capacity(steps as usize + 1),
    };
    let stop = run(&frame_every(steps_per_frame), &mut textbook);
    let rows = textbook.rows;
    let time_s = rows.last().map_or(0.0, |row: &TrajectoryRow| row.time_s);
    let end = stop.map_or(TrajectoryEnd::Finished, |reason| TrajectoryEnd::Stopped { time_s, reason });
    Trajectory { name: name.into(), rows, end }
}

/// The loop of the text; it ends with the reason why it broke off, if it did.
struct Textbook<'a, F> {
    cell: &'a Cell,
    source: &'a mut FeatureSource,
    law: F,
    steps: u64,
    q: Vector4<f64>,
    qd: Vector4<f64>,
    /// The object in the camera at this step, and its points there.
    X_CO: Pose,
    s: [Vector2<f64>; 4],
    law_output: LawOutput<4>,
    /// The step of the last frame, and the joint positions there.
    at_frame: (u64, Vector4<f64>),
    rows: Vec<TrajectoryRow>,
}

impl<F: FnMut(&LawInput) -> Result<LawOutput<4>, String>> ClosedLoop for Textbook<'_, F> {
    type Observation = LawInput;
    type Outcome = Option<String>;

    fn sense(&mut self, _: u64) -> ControlFlow<Self::Outcome> {
        self.X_CO = self.cell.X_CO(&self.q);
        let Some(s) = project(&self.X_CO) else {
            return Break(Some("a point of the object is no longer in front of the camera".to_string()));
        };
        self.s = s;
        Continue(())
    }

    fn see(&mut self, _: u64, frame_id: u64) -> ControlFlow<Self::Outcome, LawInput> {
        let index = frame_id as usize;
        match self.source.look(&self.X_CO, &self.s, index) {
            Ok(seen) => Continue(LawInput { index, q: self.q, qd: self.qd, seen }),
            Err(reason) => Break(Some(reason)),
        }
    }

    fn act(&mut self, step: u64, seen: Option<LawInput>) -> ControlFlow<Self::Outcome> {
        if let Some(input) = seen {
            match (self.law)(&input) {
                Ok(law_output) => (self.law_output, self.at_frame) = (law_output, (step, self.q)),
                Err(reason) => return Break(Some(reason)),
            }
        }
        let (LawOutput::Torque(u) | LawOutput::Velocity(u)) = self.law_output;
        let (time_s, x_c) = (step as f64 * STEP_S, self.cell.camera(&self.q));
        self.rows.push(TrajectoryRow { time_s, x_c, s: self.s, q: self.q, u });
        match self.law_output {
            LawOutput::Torque(tau) => {
                (self.q, self.qd) = self.cell.arm.integrate(&self.q, &self.qd, &tau, STEP_S)
            }
            LawOutput::Velocity(rate) => {
                let (frame, q) = self.at_frame;
                self.qd = rate;
                self.q = q + rate * ((step - frame + 1) as f64 * STEP_S);
            }
        }
        // The comparisons also catch NaN.
        if !(self.q.amax() < FAR && self.qd.amax() < f64::INFINITY) {
            return Break(Some("the motion diverges".to_string()));
        }
        if step == self.steps { Break(None) } else { Continue(()) }
    }
}
