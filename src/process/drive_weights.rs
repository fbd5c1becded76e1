//! Torques of control for robots that hold their own weight.

use super::ProcessError;
use super::drive_robot::joints;
use crate::config::Config;
use crate::ipc::Instance;
use crate::messages::{DriveCommandMsg, drive_flag};
use crate::robot::Robot;
use nalgebra::SVector;

/// What the run's robot file and its `[tool]` weigh; nothing before a run in mode torque has begun.
#[derive(Default)]
pub(super) struct Weights<const N: usize>(Option<Box<Robot<N>>>);

impl<const N: usize> Weights<N> {
    /// Those of the run, from the file that control itself has, which the supervisor has written.
    pub(super) fn of_run(instance: &Instance) -> Result<Self, ProcessError> {
        let config = Config::load(Some(&instance.config_path()), &[])?;
        Ok(Self(Some(Box::new(config.robot.build()?))))
    }

    /// The torques of a command less the weight at `q`, rad, as far as they contain it, N m. Not finite where no run in mode torque has begun: such are obeyed nowhere.
    pub(super) fn without(&self, message: &DriveCommandMsg, q: &[f64; N]) -> [f64; N] {
        let tau: [f64; N] = joints(&message.tau);
        if message.flags & drive_flag::GRAVITY == 0 {
            return tau;
        }
        let Some(model) = &self.0 else { return [f64::NAN; N] };
        let weights = model.gravity(&SVector::from(*q));
        std::array::from_fn(|i| tau[i] - weights[i])
    }
}
