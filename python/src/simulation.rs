//! A whole run in simulated time: renderer, vision and control of the library, the arm of the run file or one of Python.

use crate::arrays::matrix;
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use vservo_cores::config::SHIPPED_FILES;
use vservo_cores::config::assemble::AnyDrive;
use vservo_cores::nalgebra::SVector;
use vservo_cores::prelude::{CommandMode, Config, Drive, DriveCommand, DriveState, MonoNs, Robot};
use vservo_cores::sim::{Drives, Moment, SimError, simulate_system, simulate_system_with};

/// Ticks between looks for Ctrl-C.
const TICKS_TO_SIGNALS: usize = 200;

/// What an exception of Python's drive left, until the run has ended.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// The names of the run files that come with the library: run_files() -> list of str
#[pyfunction]
pub fn run_files() -> Vec<&'static str> {
    SHIPPED_FILES.iter().map(|file| file.name).collect()
}

/// A run: arrays over its ticks of 1 ms, and how it ended.
#[pyclass(frozen)]
pub struct Run {
    #[pyo3(get)]
    outcome: String,
    #[pyo3(get)]
    reason: String,
    #[pyo3(get)]
    settling_time_s: Option<f64>,
    #[pyo3(get)]
    state_hash: String,
    joints: usize,
    history: History,
}

/// Columns, row by row.
#[derive(Default)]
struct History {
    time_s: Vec<f64>,
    q: Vec<f64>,
    qd: Vec<f64>,
    tau: Vec<f64>,
    feature_error_px: Vec<f64>,
    position_error_m: Vec<f64>,
    orientation_error_rad: Vec<f64>,
}

#[pymethods]
impl Run {
    /// Time of each tick (n,), s.
    #[getter]
    fn time_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.history.time_s)
    }

    /// True joint positions (n, joints), rad or m.
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, self.joints, &self.history.q)
    }

    /// True joint velocities (n, joints).
    #[getter]
    fn qd<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, self.joints, &self.history.qd)
    }

    /// Commanded torques or forces (n, joints), N m or N; zeros where the drive takes none.
    #[getter]
    fn tau<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, self.joints, &self.history.tau)
    }

    /// True root mean square feature error (n,), px.
    #[getter]
    fn feature_error_px<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.history.feature_error_px)
    }

    /// True distance of the camera from its desired place (n,), m.
    #[getter]
    fn position_error_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.history.position_error_m)
    }

    /// True angle of the camera from its desired orientation (n,), rad.
    #[getter]
    fn orientation_error_rad<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.history.orientation_error_rad)
    }

    fn __repr__(&self) -> String {
        let end_s = self.history.time_s.last().copied().unwrap_or(0.0);
        format!("Run({} after {end_s:.3} s: {})", self.outcome, self.reason)
    }
}

/// simulate(config=None, settings=(), drive=None) -> Run
///
/// Runs a run file (a path, or a name of `run_files()`; the default where it is left out) in simulated time, as `vservo run --clock
/// lockstep` does, to the last bit. `settings` are changes such as "servo.gain_1_s=4".
///
/// `drive` is an arm of one's own: an object with `read(time_s) -> (q, qd)` and `write(tau, q_r, qd_r)`, called in turns once a
/// millisecond; lists or arrays of as many numbers as the arm has joints. What it is told by goes by `drive.mode`. An exception of
/// it ends the run, and comes out here.
#[pyfunction]
#[pyo3(signature = (config = None, settings = Vec::new(), drive = None))]
pub fn simulate(
    py: Python<'_>,
    config: Option<PathBuf>,
    settings: Vec<String>,
    drive: Option<Py<PyAny>>,
) -> PyResult<Run> {
    let config =
        Config::load(config.as_deref(), &settings).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let joints = config.robot.joint_count();
    let (history, raised) = (RefCell::new(History::default()), Raised::default());
    let mut watch = |moment: &Moment<'_>| {
        let Moment::Tick(trace, errors) = moment else { return ControlFlow::Continue(()) };
        let mut history = history.borrow_mut();
        let state = &trace.joint_state;
        history.time_s.push((trace.time - MonoNs::ZERO).as_s());
        history.q.extend(state.q_true.iter().take(joints));
        history.qd.extend(state.qd_true.iter().take(joints));
        history.tau.extend(trace.command.tau.iter().take(joints));
        history.feature_error_px.push(errors.feature_error_px.unwrap_or(f64::NAN));
        history.position_error_m.push(errors.position_error_m.unwrap_or(f64::NAN));
        history.orientation_error_rad.push(errors.orientation_error_rad.unwrap_or(f64::NAN));
        if history.time_s.len().is_multiple_of(TICKS_TO_SIGNALS)
            && let Err(interrupt) = py.check_signals()
        {
            raise(&raised, interrupt);
        }
        if is_raised(&raised) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let run = match drive {
        None => simulate_system(&config, &mut watch),
        Some(object) => {
            let mut drives = OfPython { object, raised: Arc::clone(&raised) };
            simulate_system_with(&config, &mut drives, &mut watch)
        }
    };
    if let Some(error) = raised.lock().ok().and_then(|mut raised| raised.take()) {
        return Err(error);
    }
    let run = run.map_err(|e: SimError| PyValueError::new_err(e.to_string()))?;
    Ok(Run {
        outcome: run.finish.outcome.as_str().into(),
        reason: run.finish.reason.into(),
        settling_time_s: run.settling_time_s,
        state_hash: run.state_hash,
        joints,
        history: history.into_inner(),
    })
}

/// Keeps the first exception.
fn raise(raised: &Raised, error: PyErr) {
    if let Ok(mut raised) = raised.lock() {
        raised.get_or_insert(error);
    }
}

fn is_raised(raised: &Raised) -> bool {
    raised.lock().is_ok_and(|raised| raised.is_some())
}

/// Makes drives of a Python object.
struct OfPython {
    object: Py<PyAny>,
    raised: Raised,
}

impl Drives for OfPython {
    fn drive<const N: usize>(&mut self, config: &Config, _robot: &Robot<N>) -> Result<AnyDrive<N>, SimError> {
        let q = SVector::from_iterator(config.start.q.iter().copied().chain(std::iter::repeat(0.0)));
        let state = DriveState { q, qd: SVector::zeros(), truth: None };
        let object = Python::attach(|py| self.object.clone_ref(py));
        Ok(Box::new(PythonDrive { object, raised: Arc::clone(&self.raised), state }))
    }
}

struct PythonDrive<const N: usize> {
    object: Py<PyAny>,
    raised: Raised,
    state: DriveState<N>,
}

impl<const N: usize> PythonDrive<N> {
    fn state_at(&self, now: MonoNs) -> PyResult<DriveState<N>> {
        let time_s = (now - MonoNs::ZERO).as_s();
        let (q, qd): (Vec<f64>, Vec<f64>) =
            Python::attach(|py| self.object.bind(py).call_method1("read", (time_s,))?.extract())?;
        if (q.len(), qd.len()) != (N, N) {
            let message = format!(
                "drive.read: gave {} positions and {} velocities, the arm has {N} joints",
                q.len(),
                qd.len()
            );
            return Err(PyValueError::new_err(message));
        }
        let (q, qd) = (SVector::from_vec(q), SVector::from_vec(qd));
        Ok(DriveState { q, qd, truth: Some((q, qd)) })
    }
}

impl<const N: usize> Drive<N> for PythonDrive<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        if !is_raised(&self.raised) {
            match self.state_at(now) {
                Ok(state) => self.state = state,
                Err(error) => raise(&self.raised, error),
            }
        }
        self.state
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        if is_raised(&self.raised) {
            return;
        }
        let told = Python::attach(|py| {
            let array = |v: &SVector<f64, N>| PyArray1::from_slice(py, v.as_slice());
            let told = (array(&command.tau), array(&command.q_r), array(&command.qd_r));
            self.object.bind(py).call_method1("write", told).map(drop)
        });
        if let Err(error) = told {
            raise(&self.raised, error);
        }
    }

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }
}
