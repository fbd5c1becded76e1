//! How a run stands.

use numpy::PyArray1;
use pyo3::prelude::*;
use vservo_cores::client::RunAnswer;
use vservo_cores::messages::{CameraState, ControlState, Status as Record, TargetStatus};

/// How a run stands. What is unknown is None.
#[pyclass(frozen)]
pub struct Status {
    /// What control does: "idle", "waiting", "servoing", "holding", "returning", "moving", "held", "teaching", "stopping", "fault" ...
    #[pyo3(get)]
    state: &'static str,
    /// The fault in words; in a stream always None: there the state alone tells it.
    #[pyo3(get)]
    fault: Option<&'static str>,
    /// "found", or why the last frame gave no measurement.
    #[pyo3(get)]
    target: Option<&'static str>,
    /// The state of a real camera.
    #[pyo3(get)]
    camera: Option<&'static str>,
    /// Number of the control tick.
    #[pyo3(get)]
    tick: Option<u64>,
    /// Time since the first tick, s.
    #[pyo3(get)]
    time_s: Option<f64>,
    /// Number of the goal: 0 is that of the run file, each new one has the next number.
    #[pyo3(get)]
    goal: Option<u32>,
    /// Number of the target that the goal is of: 0 is `[target]` of the run file, as in `Client.targets()`.
    #[pyo3(get)]
    target_number: Option<u32>,
    /// For how long the goal has been reached and held, s; None where it is not.
    #[pyo3(get)]
    at_goal_s: Option<f64>,
    /// The stability condition of scheme D at the goal of the run file, unstable at 0 or less; None for other laws.
    #[pyo3(get)]
    stability: Option<f64>,
    /// Root mean square feature error, px.
    #[pyo3(get)]
    feature_error_px: Option<f64>,
    /// Distance of the camera from its desired position, m.
    #[pyo3(get)]
    position_error_m: Option<f64>,
    /// Angle of the camera from its desired orientation, rad.
    #[pyo3(get)]
    orientation_error_rad: Option<f64>,
    q: Option<Vec<f64>>,
    qd: Option<Vec<f64>>,
}

impl Status {
    pub fn of_answer(a: &RunAnswer) -> Self {
        let is_known = a.tick.is_some();
        Self {
            state: a.state,
            fault: a.fault,
            target: a.target,
            camera: a.camera,
            tick: a.tick,
            time_s: a.time_s,
            goal: a.goal,
            target_number: a.target_number,
            at_goal_s: a.at_goal_s,
            stability: a.stability,
            feature_error_px: a.feature_error_px,
            position_error_m: a.position_error_m,
            orientation_error_rad: a.orientation_error_rad,
            q: is_known.then(|| a.q_rad_or_m.clone()),
            qd: is_known.then(|| a.qd_rad_s_or_m_s.clone()),
        }
    }

    pub fn of_record(s: &Record) -> Self {
        let known = |x: f64| Some(x).filter(|x| x.is_finite());
        let camera = CameraState::from_code(s.camera_state);
        Self {
            state: ControlState::from_code(s.state).as_str(),
            fault: None,
            target: Some(TargetStatus::from_code(s.target).as_str()),
            camera: (camera != CameraState::Unknown).then(|| camera.as_str()),
            tick: Some(s.tick),
            time_s: Some(s.time_s),
            goal: Some(s.goal),
            target_number: Some(s.target_number),
            at_goal_s: known(s.at_goal_s),
            stability: known(s.stability),
            feature_error_px: known(s.feature_error_px),
            position_error_m: known(s.position_error_m),
            orientation_error_rad: known(s.orientation_error_rad),
            q: None,
            qd: None,
        }
    }
}

#[pymethods]
impl Status {
    /// Whether the goal is reached and held.
    #[getter]
    fn at_goal(&self) -> bool {
        self.at_goal_s.is_some()
    }

    /// Measured joint positions (joints,), rad or m; None in a stream, where `joint_states()` has them.
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.q.as_ref().map(|q| PyArray1::from_slice(py, q))
    }

    /// Measured joint velocities (joints,), rad/s or m/s; None in a stream.
    #[getter]
    fn qd<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.qd.as_ref().map(|qd| PyArray1::from_slice(py, qd))
    }

    fn __repr__(&self) -> String {
        let px = self.feature_error_px.map_or(String::new(), |px| format!(", {px:.3} px"));
        format!("Status({}{}{px})", self.state, if self.at_goal() { ", at the goal" } else { "" })
    }
}
