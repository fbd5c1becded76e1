//! The loop of Sect. 10.9: vision and law at 25 Hz, the arm on a 1 ms grid.
//!
//! Torque laws: the torque is held for 0.04 s and the rigid-body model is integrated by Runge-Kutta of fourth order.
//! Resolved-velocity laws: the arm is an ideal positioning device, (10.75), and moves with the held joint velocity.
//! Limits of effort and position do not act here, as in the text.

use super::cell::{Cell, project};
use super::eye::Eye;
use super::trajectory::{End, Row, Trajectory};
use crate::robot::Robot;
use crate::servo::Wish;
use nalgebra::{SVector, Vector2, Vector4};

/// Grid of the trajectories, s.
pub const STEP_S: f64 = 1e-3;
/// Steps from frame to frame: 25 Hz.
pub const STEPS_PER_FRAME: usize = 40;
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
    eye: &mut Eye,
    span_s: f64,
    law: impl FnMut(&LawInput) -> Result<Wish<4>, String>,
) -> Trajectory {
    simulate_at(STEPS_PER_FRAME, cell, name, eye, span_s, law)
}

/// Runs `law` in `cell` for `span_s` with a frame every `steps_per_frame` steps.
///
/// The run breaks off with its reason when a point gets behind the camera, when the law has no answer, or when the
/// motion diverges.
pub fn simulate_at(
    steps_per_frame: usize,
    cell: &Cell,
    name: &str,
    eye: &mut Eye,
    span_s: f64,
    mut law: impl FnMut(&LawInput) -> Result<Wish<4>, String>,
) -> Trajectory {
    let steps = (span_s / STEP_S).round() as usize;
    let mut rows = Vec::with_capacity(steps + 1);
    let (mut q, mut qd) = (cell.q_start, Vector4::zeros());
    let (mut wish, mut q_frame) = (Wish::Velocity(Vector4::zeros()), q);
    let mut stop = None;
    for k in 0..=steps {
        let X_CO = cell.X_CO(&q);
        let Some(s) = project(&X_CO) else {
            stop = Some("a point of the object is no longer in front of the camera".to_string());
            break;
        };
        if k % steps_per_frame == 0 {
            let index = k / steps_per_frame;
            let answer = eye.look(&X_CO, &s, index).and_then(|seen| law(&LawInput { index, q, qd, seen }));
            match answer {
                Ok(new) => (wish, q_frame) = (new, q),
                Err(reason) => {
                    stop = Some(reason);
                    break;
                }
            }
        }
        let u = match wish {
            Wish::Torque(u) | Wish::Velocity(u) => u,
        };
        rows.push(Row { time_s: k as f64 * STEP_S, x_c: cell.camera(&q), s, q, u });
        match wish {
            Wish::Torque(tau) => (q, qd) = rigid_body_step(&cell.arm, &q, &qd, &tau, STEP_S),
            Wish::Velocity(rate) => {
                qd = rate;
                q = q_frame + rate * ((k % steps_per_frame + 1) as f64 * STEP_S);
            }
        }
        // The comparisons also catch NaN.
        if !(q.amax() < FAR && qd.amax() < f64::INFINITY) {
            stop = Some("the motion diverges".to_string());
            break;
        }
    }
    let time_s = rows.last().map_or(0.0, |row: &Row| row.time_s);
    let end = stop.map_or(End::Finished, |reason| End::Stopped { time_s, reason });
    Trajectory { name: name.into(), rows, end }
}

/// One Runge-Kutta step of fourth order under constant torque.
#[must_use]
pub fn rigid_body_step<const N: usize>(
    arm: &Robot<N>,
    q: &SVector<f64, N>,
    qd: &SVector<f64, N>,
    tau: &SVector<f64, N>,
    h: f64,
) -> (SVector<f64, N>, SVector<f64, N>) {
    let acceleration = |q: &SVector<f64, N>, qd: &SVector<f64, N>| arm.forward_dynamics(q, qd, tau);
    let a1 = acceleration(q, qd);
    let qd2 = qd + a1 * (h / 2.0);
    let a2 = acceleration(&(q + qd * (h / 2.0)), &qd2);
    let qd3 = qd + a2 * (h / 2.0);
    let a3 = acceleration(&(q + qd2 * (h / 2.0)), &qd3);
    let qd4 = qd + a3 * h;
    let a4 = acceleration(&(q + qd3 * h), &qd4);
    (q + (qd + qd2 * 2.0 + qd3 * 2.0 + qd4) * (h / 6.0), qd + (a1 + a2 * 2.0 + a3 * 2.0 + a4) * (h / 6.0))
}
