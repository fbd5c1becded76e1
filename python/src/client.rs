//! A client of a running instance: what `vservo ctl` and `vservo do` do.

use crate::beside::beside;
use crate::errors::{NotReached, ProgramFailed, Refused, raised};
use crate::goal::{Goal, fixed, pose, rotation};
use crate::status::Status;
use crate::streams::{JointStates, Measurements, Statuses, Stream, USUAL_TIMEOUT_S};
use crate::velocities::Velocities;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use vservo_cores::client::{Client as Core, ProgramOutcome, RecordStream, RunAnswer, Setting, USUAL_WAIT_S};
use vservo_cores::config::{GoalFile, Program, WaitFor};
use vservo_cores::geometry::Pose;
use vservo_cores::messages::CameraId;
use vservo_cores::process::{ProcessError, StopFlag};

/// connect(instance="default", timeout_s=5.0) -> Client
///
/// A client of the run of this name (`vservo serve --instance NAME`, or `vservo run`), which must be there. `timeout_s` is the longest
/// wait for each answer, s.
#[pyfunction]
#[pyo3(signature = (instance = "default", timeout_s = 5.0))]
pub fn connect(py: Python<'_>, instance: &str, timeout_s: f64) -> PyResult<Client> {
    let find = || Core::connect(instance)?.with_timeout_s(timeout_s);
    Ok(Client { core: py.detach(find).map_err(raised)? })
}

/// A client of a running instance: `connect(instance)` makes one.
///
/// Each request returns the status of the run after it. What the state of the run does not allow raises `Refused`. Calls that wait end with
/// KeyboardInterrupt on Ctrl-C; what was asked for may be done all the same.
#[pyclass(frozen)]
pub struct Client {
    core: Core,
}

/// A goal as Python gives it.
enum Wanted {
    File(PathBuf),
    Taught(GoalFile),
    View(Pose),
}

/// A place for the arm as Python gives it.
#[derive(FromPyObject)]
enum Place<'py> {
    #[pyo3(transparent)]
    Goal(PyRef<'py, Goal>),
    #[pyo3(transparent)]
    File(PathBuf),
    #[pyo3(transparent)]
    Joints(Vec<f64>),
}

/// The status in an answer, or why it was refused.
pub fn answered(answer: RunAnswer) -> PyResult<Status> {
    match &answer.reason {
        Some(reason) => Err(Refused::new_err(format!("{} was refused: {reason}", answer.request))),
        None => Ok(Status::of_answer(&answer)),
    }
}

impl Client {
    /// Does `work` with a client whose waits Ctrl-C ends.
    fn ask<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Core) -> Result<T, ProcessError> + Send,
    ) -> PyResult<T> {
        let interrupted = StopFlag::default();
        let core = self.core.clone().interrupted_by(interrupted.clone());
        beside(py, &interrupted, || work(&core))
    }

    /// The same for a request that can be refused.
    fn request(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Core) -> Result<RunAnswer, ProcessError> + Send,
    ) -> PyResult<Status> {
        answered(self.ask(py, work)?)
    }

    fn stream<T: Send>(
        &self,
        py: Python<'_>,
        timeout_s: f64,
        open: impl FnOnce(&Core) -> Result<RecordStream<T>, ProcessError> + Send,
    ) -> PyResult<Stream<T>> {
        Stream::new(self.ask(py, open)?, timeout_s)
    }
}

#[pymethods]
impl Client {
    /// The name of the instance.
    #[getter]
    fn instance(&self) -> String {
        self.core.instance().to_string()
    }

    /// status() -> Status: how the run stands.
    fn status(&self, py: Python<'_>) -> PyResult<Status> {
        self.request(py, Core::status)
    }

    /// start() -> Status: servo to the goal, and hold it.
    fn start(&self, py: Python<'_>) -> PyResult<Status> {
        self.request(py, Core::start)
    }

    /// hold() -> Status: come to rest until the next start.
    fn hold(&self, py: Python<'_>) -> PyResult<Status> {
        self.request(py, Core::hold)
    }

    /// stop() -> Status: come to rest, and be idle; a run that is not served ends by it. Nothing can hold it up; of the status only
    /// `state` is known.
    fn stop(&self, py: Python<'_>) -> PyResult<Status> {
        self.request(py, Core::stop)
    }

    /// shutdown() -> Status: come to rest, and end the run.
    fn shutdown(&self, py: Python<'_>) -> PyResult<Status> {
        self.request(py, Core::shutdown)
    }

    /// reset() -> Status: clear the fault, after its cause was removed.
    fn reset(&self, py: Python<'_>) -> PyResult<Status> {
        self.request(py, Core::reset)
    }

    /// wait(what="converged", timeout_s=30.0) -> Status
    ///
    /// Waits until the goal is reached and held ("converged"), the view is lost ("holding"), there is a fault ("fault"), or control is in a
    /// state ("state=held"). Raises `NotReached` when the time is over, or when it cannot come to that without another request; the
    /// message says what is there instead.
    #[pyo3(signature = (what = "converged", timeout_s = USUAL_WAIT_S))]
    fn wait(&self, py: Python<'_>, what: &str, timeout_s: f64) -> PyResult<Status> {
        let what: WaitFor = what.parse().map_err(PyValueError::new_err)?;
        let end = self.ask(py, move |core| core.wait(what, timeout_s))?;
        match end.status {
            Some(status) if end.is_reached => Ok(Status::of_answer(&status)),
            _ => Err(NotReached::new_err(end.in_vain(what))),
        }
    }

    /// goal(goal=None, *, X_DO=None, position_m=None, rotation_rpy_deg=None, rotation_xyzw=None, target=None) -> Status
    ///
    /// Another goal, now, also while the arm moves: a `Goal`, a file of `vservo teach`, or where the target is in the camera at the goal:
    /// `X_DO` (4, 4), as `Measurement.pose` has it, or `position_m` (3,), m, with roll, pitch, yaw in degrees or a unit quaternion.
    /// `target` names the target that it is of, in `[targets]` of the run file, or "target"; left out: the one that the run has.
    #[pyo3(signature = (goal = None, *, X_DO = None, position_m = None, rotation_rpy_deg = None, rotation_xyzw = None, target = None))]
    #[allow(clippy::too_many_arguments)] // they are keywords in Python
    fn goal(
        &self,
        py: Python<'_>,
        goal: Option<Place<'_>>,
        X_DO: Option<Vec<Vec<f64>>>,
        position_m: Option<Vec<f64>>,
        rotation_rpy_deg: Option<Vec<f64>>,
        rotation_xyzw: Option<Vec<f64>>,
        target: Option<String>,
    ) -> PyResult<Status> {
        let has_rotation = rotation_rpy_deg.is_some() || rotation_xyzw.is_some();
        let wanted = match (goal, X_DO, position_m) {
            (Some(Place::Goal(goal)), None, None) if !has_rotation => Wanted::Taught(goal.file.clone()),
            (Some(Place::File(path)), None, None) if !has_rotation => Wanted::File(path),
            (None, Some(X_DO), None) if !has_rotation => Wanted::View(pose("X_DO", &X_DO)?),
            (None, None, Some(position_m)) => {
                let p: [f64; 3] = fixed("position_m", &position_m)?;
                Wanted::View(Pose::from_parts(p.into(), rotation(rotation_rpy_deg, rotation_xyzw)?))
            }
            _ => {
                return Err(PyValueError::new_err(
                    "needs exactly one of: a Goal or the name of its file, X_DO, position_m (with a rotation or without)",
                ));
            }
        };
        self.request(py, move |core| {
            let core = match &target {
                Some(name) => core.clone().of_target(name)?,
                None => core.clone(),
            };
            match wanted {
                Wanted::Taught(goal) => core.goal(&goal),
                Wanted::File(path) => core.goal_at(&path),
                Wanted::View(X_DO) => core.goal_pose(&X_DO),
            }
        })
    }

    /// targets() -> list[str]: names of the targets of the run file; the first one is "target", that of `[target]`.
    fn targets(&self) -> Vec<String> {
        self.core.targets().into_iter().map(|target| target.name).collect()
    }

    /// look_for(target) -> Status
    ///
    /// Another target from now on, with the last goal that it had; before the first one that is `servo.desired` of the run file.
    fn look_for(&self, py: Python<'_>, target: String) -> PyResult<Status> {
        self.request(py, move |core| core.look_for(&target))
    }

    /// teach(save=None, timeout_s=30.0) -> Goal
    ///
    /// Brings the arm to rest, makes the view the goal, and returns it, with the posture; `save` writes it into a file too.
    #[pyo3(signature = (save = None, timeout_s = USUAL_WAIT_S))]
    fn teach(&self, py: Python<'_>, save: Option<PathBuf>, timeout_s: f64) -> PyResult<Goal> {
        let file = self.ask(py, move |core| core.taught(timeout_s))?;
        let file = file.map_err(|why| NotReached::new_err(format!("the goal was not taught: {why}")))?;
        let goal = Goal { file };
        save.map_or(Ok(()), |path| goal.save(path))?;
        Ok(goal)
    }

    /// goto(place) -> Status
    ///
    /// Begins to move the arm to a posture: joint positions (joints,), rad or m, a `Goal` that was taught, or its file. It holds it there:
    /// `wait("state=held")`. It looks at no obstacles.
    fn goto(&self, py: Python<'_>, place: Place<'_>) -> PyResult<Status> {
        match place {
            Place::File(path) => self.request(py, move |core| core.goto_at(&path)),
            Place::Joints(q) => self.request(py, move |core| core.goto(&q)),
            Place::Goal(goal) => {
                let q = goal.file.q_rad_or_m.clone();
                if q.is_empty() {
                    return Err(PyValueError::new_err(
                        "the goal has no posture: `teach` returns one with it",
                    ));
                }
                self.request(py, move |core| core.goto(&q))
            }
        }
    }

    /// jog(dq=None, *, position_m=None, rotation_rpy_deg=None) -> Status
    ///
    /// Begins to move the arm by a little, and holds it there: each joint by `dq` (joints,), up to 0.2 rad or 0.05 m, or the camera in its
    /// own frame by `position_m` (3,) and roll, pitch, yaw (3,).
    #[pyo3(signature = (dq = None, *, position_m = None, rotation_rpy_deg = None))]
    fn jog(
        &self,
        py: Python<'_>,
        dq: Option<Vec<f64>>,
        position_m: Option<Vec<f64>>,
        rotation_rpy_deg: Option<Vec<f64>>,
    ) -> PyResult<Status> {
        match (dq, position_m.is_some() || rotation_rpy_deg.is_some()) {
            (Some(dq), false) => self.request(py, move |core| core.jog_joints(&dq)),
            (None, true) => {
                let p: [f64; 3] = fixed("position_m", &position_m.unwrap_or_else(|| vec![0.0; 3]))?;
                let r = rotation(rotation_rpy_deg, None)?.scaled_axis();
                self.request(py, move |core| core.jog_camera(&p.into(), &r))
            }
            _ => Err(PyValueError::new_err("needs either dq, or position_m and rotation_rpy_deg")),
        }
    }

    /// velocities(hold_s=0.1) -> Velocities
    ///
    /// Commands velocities from now on, each of which holds for `hold_s`, 0.01 to 1 s; an arm that is sent none for longer brakes and rests. The first takes the
    /// arm over from what it does, as `goto` does.
    #[pyo3(signature = (hold_s = 0.1))]
    fn velocities(&self, py: Python<'_>, hold_s: f64) -> PyResult<Velocities> {
        Ok(Velocities { stream: self.ask(py, move |core| core.velocities(hold_s))? })
    }

    /// set(what, value) -> Status
    ///
    /// Changes a value in the running loop: "gain" (1/s), "tolerance" (px) or "hold" (s), within the bounds of the run file.
    fn set(&self, py: Python<'_>, what: &str, value: f64) -> PyResult<Status> {
        let setting = match what {
            "gain" => Setting::Gain,
            "tolerance" => Setting::Tolerance,
            "hold" => Setting::Hold,
            _ => return Err(PyValueError::new_err(format!("`{what}`: there are gain, tolerance and hold"))),
        };
        self.request(py, move |core| core.set(setting, value))
    }

    /// run(program, tell=None)
    ///
    /// Does the steps of a program (`vservo do`), and returns when all are done. `tell(line)` hears of each step and each change of the
    /// state. Raises `ProgramFailed` when it ended early; ValueError, before anything moves, when the file is wrong. Ctrl-C holds the arm.
    #[pyo3(signature = (program, tell = None))]
    fn run(&self, py: Python<'_>, program: PathBuf, tell: Option<Py<PyAny>>) -> PyResult<()> {
        let interrupted = StopFlag::default();
        let core = self.core.clone().interrupted_by(interrupted.clone());
        let exception: Mutex<Option<PyErr>> = Mutex::new(None);
        let end = beside(py, &interrupted, || {
            let program = Program::load(&program, core.named_places())?;
            core.run_program(&program, &mut |line| {
                let Some(tell) = &tell else { return };
                // An exception of it ends the program, and comes out below.
                if let Err(error) = Python::attach(|py| tell.call1(py, (line,))) {
                    interrupted.request();
                    exception.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                }
            })
        });
        if let Some(error) = exception.into_inner().unwrap_or_else(PoisonError::into_inner) {
            return Err(error);
        }
        let end = end?;
        match end.outcome {
            ProgramOutcome::Done => Ok(()),
            ProgramOutcome::Fault => Err(("fault", end)),
            ProgramOutcome::Failed => Err(("failed", end)),
            ProgramOutcome::Stopped => Err(("stopped", end)),
        }
        .map_err(|(word, end)| ProgramFailed::new_err(format!("{word} at {}: {}", end.step, end.reason)))
    }

    /// statuses(timeout_s=5.0) -> iterator of Status, 50 times a second of the run's time; ends with the run.
    ///
    /// It raises `NotReached` when nothing comes within `timeout_s`; so do the others.
    #[pyo3(signature = (timeout_s = USUAL_TIMEOUT_S))]
    fn statuses(&self, py: Python<'_>, timeout_s: f64) -> PyResult<Statuses> {
        Ok(Statuses { stream: self.stream(py, timeout_s, Core::statuses)? })
    }

    /// measurements(camera=0, timeout_s=5.0) -> iterator of Measurement, one of each frame of this camera; ends with the run.
    #[pyo3(signature = (camera = 0, timeout_s = USUAL_TIMEOUT_S))]
    fn measurements(&self, py: Python<'_>, camera: u8, timeout_s: f64) -> PyResult<Measurements> {
        Ok(Measurements {
            stream: self.stream(py, timeout_s, move |core| core.measurements(CameraId(camera)))?,
        })
    }

    /// joint_states(timeout_s=5.0) -> iterator of JointState, one of each tick of a millisecond; ends with the run.
    #[pyo3(signature = (timeout_s = USUAL_TIMEOUT_S))]
    fn joint_states(&self, py: Python<'_>, timeout_s: f64) -> PyResult<JointStates> {
        Ok(JointStates { stream: self.stream(py, timeout_s, Core::joint_states)? })
    }

    fn __repr__(&self) -> String {
        format!("Client({})", self.core.instance())
    }
}
