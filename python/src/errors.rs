//! Exceptions, with the library's words.

use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyOSError, PyValueError};
use pyo3::prelude::*;
use vservo_cores::process::ProcessError;

create_exception!(
    vservo,
    Error,
    PyException,
    "What a run could not do, in words; all that follow are of this kind."
);
create_exception!(vservo, Refused, Error, "A request that the state of the run does not allow.");
create_exception!(vservo, NotReached, Error, "A wait that ended in vain; says what is there instead.");
create_exception!(vservo, Unreachable, Error, "No run of this name is there, or it does not answer.");
create_exception!(vservo, ProgramFailed, Error, "A program that ended early; says at which step, and why.");

pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("Error", py.get_type::<Error>())?;
    module.add("Refused", py.get_type::<Refused>())?;
    module.add("NotReached", py.get_type::<NotReached>())?;
    module.add("Unreachable", py.get_type::<Unreachable>())?;
    module.add("ProgramFailed", py.get_type::<ProgramFailed>())
}

/// An error of the client.
pub fn raised(error: ProcessError) -> PyErr {
    let words = error.lines().join("\n");
    match error {
        ProcessError::NobodyThere(_)
        | ProcessError::NotYourRun { .. }
        | ProcessError::Crowded { .. }
        | ProcessError::NoAnswer { .. } => Unreachable::new_err(words),
        ProcessError::NoCommand(_)
        | ProcessError::Timeout(_)
        | ProcessError::Config(_)
        | ProcessError::Instance(_) => PyValueError::new_err(words),
        ProcessError::Write { .. } => PyOSError::new_err(words),
        ProcessError::Interrupted => PyKeyboardInterrupt::new_err(words),
        _ => Error::new_err(words),
    }
}
