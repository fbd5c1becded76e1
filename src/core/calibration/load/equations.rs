//! The equations of motion of a recording, one for each joint that moves and each instant.

use super::recording::LoadRecording;
use super::smoothing::{HALF, SmoothingKernel};
use crate::robot::{Inertia, Robot};
use nalgebra::{SVector, Vector3};

/// Ticks between two instants. Chosen by hand: a third of what the kernel spans to one side, so that nothing is lost between them.
pub(super) const EVERY: usize = 10;
/// A joint whose mean velocity before and after an instant is less, or of two signs, rad/s or m/s, may stick: its torque says nothing then. Chosen by hand: beyond
/// ten times the speed over which smooth friction changes its sign, and where usual Stribeck curves have come down.
const MOVES: f64 = 0.03;
/// Numbers of a load: mass, kg, first moment, kg m, and moments of inertia xx, yy, zz, xy, xz, yz, kg m^2, about the flange's origin: the number follows from them.
pub(super) const LOAD: usize = 10;

/// One joint at one instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointEquation {
    /// Which instant: neighbours differ by one.
    pub(super) instant: usize,
    pub(super) joint: usize,
    /// Torque beyond that of the arm without load, friction and rotors that no file tells, N m or N.
    pub(super) torque: f64,
    /// What of it each unit of the load's numbers explains.
    pub(super) load: [f64; LOAD],
    /// Velocity and acceleration of the joint.
    pub(super) qd: f64,
    pub(super) qdd: f64,
}

/// All equations of `recording`, of the arm `robot` that carries `tool`, which counts as a part of the load.
pub(super) fn equations<const N: usize>(
    robot: &Robot<N>,
    tool: &Inertia,
    recording: &LoadRecording<N>,
) -> Vec<JointEquation> {
    let kernel = SmoothingKernel::new();
    let derivatives = robot.load_derivatives();
    let told = load_numbers(tool);
    let measured = recording.is_measured();
    let mut all = Vec::new();
    for instant in 0..recording.len() / EVERY {
        let ticks = recording.around(instant * EVERY, HALF);
        let Some(state) = ticks.and_then(|ticks| kernel.at(ticks, measured)) else { continue };
        let moves = |i: &usize| state.before[*i].abs().min(state.after[*i].abs()) > MOVES;
        let moving = (0..N).filter(|i| state.before[*i] * state.after[*i] > 0.0 && moves(i));
        let model = robot.inverse_dynamics(&state.q, &state.qd, &state.qdd);
        let columns: [SVector<f64, N>; LOAD] =
            std::array::from_fn(|k| derivatives[k].inverse_dynamics(&state.q, &state.qd, &state.qdd));
        for joint in moving {
            let load = std::array::from_fn(|k| columns[k][joint]);
            let carried: f64 = told.iter().zip(&load).map(|(told, column)| told * column).sum();
            let torque = state.tau[joint] - model[joint] + carried;
            let (qd, qdd) = (state.qd[joint], state.qdd[joint]);
            if torque.is_finite() && qd.is_finite() && qdd.is_finite() {
                all.push(JointEquation { instant, joint, torque, load, qd, qdd });
            }
        }
    }
    all
}

/// The ten numbers of a body in the flange's frame.
pub(super) fn load_numbers(body: &Inertia) -> [f64; LOAD] {
    let (h, I): (Vector3<f64>, _) = (body.com * body.mass, body.about_origin());
    [body.mass, h.x, h.y, h.z, I.m11, I.m22, I.m33, I.m12, I.m13, I.m23]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// The columns are the derivatives of the inverse dynamics by the ten numbers, which are linear in them.
    #[test]
    fn the_torques_of_a_load_are_linear_in_its_ten_numbers() {
        let robot = crate::robot::load("panda").unwrap().build::<7>().unwrap();
        let body = Inertia {
            mass: 2.0,
            com: Vector3::new(0.03, -0.04, 0.08),
            about_com: Matrix3::new(0.02, 0.001, -0.002, 0.001, 0.03, 0.003, -0.002, 0.003, 0.015),
        };
        let vector = |seed: f64| SVector::<f64, 7>::from_fn(|i, _| (seed * (i as f64 + 1.3)).sin());
        let (q, qd, qdd) = (vector(1.0), vector(2.1), vector(3.7) * 5.0);
        let loaded = robot.clone().with_load(&body).inverse_dynamics(&q, &qd, &qdd);
        let difference = loaded - robot.inverse_dynamics(&q, &qd, &qdd);
        let columns = robot.load_derivatives().map(|arm| arm.inverse_dynamics(&q, &qd, &qdd));
        let sum: SVector<f64, 7> = columns.iter().zip(load_numbers(&body)).map(|(c, x)| c * x).sum();
        assert!((sum - difference).amax() < 1e-9, "{sum} {difference}");
        assert!(columns.iter().all(|column| column.amax() > 1e-3));
    }
}
