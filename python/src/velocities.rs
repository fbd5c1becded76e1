//! Velocities that a program commands: a control law of its own.

use crate::beside::beside;
use crate::client::answered;
use crate::goal::fixed;
use crate::status::Status;
use pyo3::prelude::*;
use vservo_cores::client::{RunAnswer, VelocityStream};
use vservo_cores::process::{ProcessError, StopFlag};

/// Commands velocities: `Client.velocities()` makes one.
///
/// Each holds for the time of the stream; an arm that is sent none for longer brakes and rests (state "held"). `hold` and `stop` of the client end it at once.
#[pyclass(frozen)]
pub struct Velocities {
    pub stream: VelocityStream,
}

impl Velocities {
    fn command(
        &self,
        py: Python<'_>,
        command: impl FnOnce(&VelocityStream) -> Result<RunAnswer, ProcessError> + Send,
    ) -> PyResult<Status> {
        let interrupted = StopFlag::default();
        let stream = self.stream.clone().interrupted_by(interrupted.clone());
        answered(beside(py, &interrupted, || command(&stream))?)
    }
}

#[pymethods]
impl Velocities {
    /// joints(qd) -> Status
    ///
    /// Moves the joints by `qd` (joints,), rad/s or m/s; all of them slower in the same proportion where one would be faster than it may.
    fn joints(&self, py: Python<'_>, qd: Vec<f64>) -> PyResult<Status> {
        self.command(py, move |stream| stream.joints(&qd))
    }

    /// camera(V_C) -> Status
    ///
    /// Moves the camera by the twist `V_C` (6,) in its own frame: along x, y, z, m/s, and about x, y, z, rad/s.
    fn camera(&self, py: Python<'_>, V_C: Vec<f64>) -> PyResult<Status> {
        let V_C = fixed("V_C", &V_C)?;
        self.command(py, move |stream| stream.camera(&V_C))
    }
}
