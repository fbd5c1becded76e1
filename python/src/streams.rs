//! What a run sends, as iterators. Each ends with the run; a reader that is slow loses the oldest records, which are counted.

use crate::errors::{NotReached, raised};
use crate::measurement::Measurement;
use crate::status::Status;
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};
use vservo_cores::client::RecordStream;
use vservo_cores::messages::{
    JointState as JointRecord, Measurement as Record, Status as StatusRecord, joint_flag,
};
use vservo_cores::process::ProcessError;
use vservo_cores::time::MonoNs;

/// Longest wait for the next record where nothing else is said, s: as long as `vservo ctl` waits for an answer.
pub const USUAL_TIMEOUT_S: f64 = 5.0;

/// Looks for Ctrl-C lie so far apart, s.
const LOOK_FOR_SIGNALS_S: f64 = 0.05;

/// A stream, and how long it waits for the next record.
pub struct Stream<T> {
    watch: Mutex<RecordStream<T>>,
    timeout_s: f64,
}

impl<T: Send> Stream<T> {
    pub fn new(watch: RecordStream<T>, timeout_s: f64) -> PyResult<Self> {
        if !(timeout_s > 0.0 && timeout_s <= 3600.0) {
            return Err(PyValueError::new_err("timeout_s: must be more than 0 and at most 3600"));
        }
        Ok(Self { watch: Mutex::new(watch), timeout_s })
    }

    /// The next record; None when the run has ended.
    fn next(&self, py: Python<'_>) -> PyResult<Option<T>> {
        let mut left_s = self.timeout_s;
        while left_s > 0.0 {
            let step_s = left_s.min(LOOK_FOR_SIGNALS_S);
            let next = py.detach(|| self.watch.lock().unwrap_or_else(PoisonError::into_inner).next(step_s));
            match next {
                Ok(Some(record)) => return Ok(Some(record)),
                Err(ProcessError::NobodyThere(_)) => return Ok(None),
                Err(error) => return Err(raised(error)),
                Ok(None) => py.check_signals()?,
            }
            left_s -= step_s;
        }
        Err(NotReached::new_err(format!("nothing came within {} s (timeout_s)", self.timeout_s)))
    }

    fn lost(&self) -> u64 {
        self.watch.lock().unwrap_or_else(PoisonError::into_inner).lost()
    }
}

fn time_s(stamp: MonoNs) -> f64 {
    (stamp - MonoNs::ZERO).as_s()
}

/// The arm at one tick. Positions in rad or m, velocities in rad/s or m/s, torques in N m, forces in N.
#[pyclass(frozen)]
pub struct JointState {
    record: JointRecord,
}

impl JointState {
    fn of<'py>(&self, py: Python<'py>, all: &[f64]) -> Bound<'py, PyArray1<f64>> {
        let joints = all.len().min(self.record.joints as usize);
        PyArray1::from_slice(py, all.get(..joints).unwrap_or_default())
    }

    fn is_true(&self) -> bool {
        self.record.flags & joint_flag::TRUTH != 0
    }
}

#[pymethods]
impl JointState {
    /// Number of the control tick.
    #[getter]
    fn tick(&self) -> u64 {
        self.record.tick
    }

    /// When the drive was read: the machine's monotonic clock, simulated time in lockstep, s.
    #[getter]
    fn stamp_s(&self) -> f64 {
        time_s(self.record.stamp)
    }

    /// Measured positions (joints,).
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of(py, &self.record.q)
    }

    /// Measured velocities (joints,).
    #[getter]
    fn qd<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of(py, &self.record.qd)
    }

    /// Torques or forces of the tick before (joints,).
    #[getter]
    fn tau<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of(py, &self.record.tau)
    }

    /// Reference positions (joints,).
    #[getter]
    fn q_r<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of(py, &self.record.q_r)
    }

    /// Reference velocities (joints,).
    #[getter]
    fn qd_r<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.of(py, &self.record.qd_r)
    }

    /// True positions of a simulated arm (joints,); None of a real one.
    #[getter]
    fn q_true<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.is_true().then(|| self.of(py, &self.record.q_true))
    }

    /// True velocities of a simulated arm (joints,); None of a real one.
    #[getter]
    fn qd_true<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.is_true().then(|| self.of(py, &self.record.qd_true))
    }

    fn __repr__(&self) -> String {
        format!("JointState(tick {}, {} joints)", self.record.tick, self.record.joints)
    }
}

/// An iterator of what a run sends.
macro_rules! iterator {
    ($(#[$doc:meta])* $name:ident, $record:ty, $item:ty, $of:expr) => {
        $(#[$doc])*
        #[pyclass(frozen)]
        pub struct $name {
            pub stream: Stream<$record>,
        }

        #[pymethods]
        impl $name {
            fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
                this
            }

            fn __next__(&self, py: Python<'_>) -> PyResult<Option<$item>> {
                Ok(self.stream.next(py)?.map($of))
            }

            /// Records that came too early for this reader, since the first one.
            #[getter]
            fn lost(&self) -> u64 {
                self.stream.lost()
            }
        }
    };
}

iterator! {
    /// Iterates over the status of a run, 50 times a second of its time.
    Statuses, StatusRecord, Status, |record| Status::of_record(&record)
}
iterator! {
    /// Iterates over what vision measured in each frame.
    Measurements, Record, Measurement, |record| Measurement { record }
}
iterator! {
    /// Iterates over the arm at each tick.
    JointStates, JointRecord, JointState, |record| JointState { record }
}
