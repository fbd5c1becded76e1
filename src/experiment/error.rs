//! Why an experiment gave nothing.

use crate::sim::SimError;
use std::path::PathBuf;
use thiserror::Error;

/// Failure of `vservo experiment`.
#[derive(Debug, Error)]
pub enum ExperimentError {
    /// There is no experiment of this name.
    #[error("experiment: there is no `{name}`; choose one of all, {names}")]
    Unknown {
        /// The name given.
        name: String,
        /// Those that exist.
        names: String,
    },
    /// The folder or a file in it cannot be written.
    #[error("{path}: cannot be written: {cause}; choose another --out or free some space", path = path.display())]
    Write {
        /// Folder or file.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// A step of a computation has no answer where the textbook has one.
    #[error("experiment {experiment}: {cause}")]
    Computation {
        /// Which experiment.
        experiment: &'static str,
        /// What went wrong.
        cause: String,
    },
    /// A run has no rows.
    #[error("internal error: the run of scheme {scheme} is empty")]
    Empty {
        /// Whose run.
        scheme: String,
    },
    /// `--camera rendered` is asked of an experiment that knows only projected points.
    #[error(
        "experiment {experiment} works on projected points only; leave `--camera rendered` out, or use it with {with}"
    )]
    IdealOnly {
        /// Which experiment.
        experiment: &'static str,
        /// Those that can.
        with: String,
    },
    /// A run of the whole system cannot be simulated.
    #[error("experiment: {0}")]
    System(#[from] SimError),
    /// A part of the simulated cell cannot be built.
    #[error("experiment: the simulated cell cannot be built: {cause}")]
    Cell {
        /// What the part says.
        cause: String,
    },
    /// A worker thread cannot be started, or it panicked.
    #[error("internal error: worker thread: {cause}")]
    Worker {
        /// What happened.
        cause: String,
    },
}

impl ExperimentError {
    /// Exit code of the command line: 2 usage, 3 output, 1 the rest.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Unknown { .. } | Self::IdealOnly { .. } => 2,
            Self::Write { .. } => 3,
            Self::Computation { .. }
            | Self::Empty { .. }
            | Self::System(_)
            | Self::Cell { .. }
            | Self::Worker { .. } => 1,
        }
    }
}
