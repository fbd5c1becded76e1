//! A public measure of visual servoing: suites of tasks with their starts, seeds and truth as data, and what each law, and each other program that takes part
//! ([`EntrantLink`]), makes of them (`vservo benchmark`).
//!
//! ```text
//! suite (TOML) ─► BenchmarkTask x case x count ─► scenario: what is true, what is believed, a start in view and within reach, its least time
//!                                                      └─► x law or entrant ─► simulated run ─► RunScores ─► BenchmarkResults
//! ```
//! Every score is computed from the truth of the simulation, by the same equations for all; nothing here knows which law runs, or who.

mod draw;
mod entrant;
mod least_time;
mod page;
mod results;
mod score;
mod suite;
mod truth;

pub use draw::{BenchmarkScenario, scenario};
pub use entrant::{ENTRANT_PROTOCOL, EntrantCard, EntrantLink, begin_message};
pub use page::{LawTime, benchmark_page};
pub use results::{BenchmarkResults, LawResult, LawSummary, TaskResult};
pub use score::{Participant, RunScores, run_scenario};
pub use suite::{
    BenchmarkLaw, BenchmarkPlace, BenchmarkScore, BenchmarkSuite, BenchmarkTask, BenchmarkValue,
    BenchmarkValues, SHIPPED_SUITES, checked_names,
};
pub use truth::RunTruth;

use crate::sim::SimError;
use thiserror::Error;

/// Why a suite cannot be run.
#[derive(Debug, Error)]
pub enum BenchmarkError {
    /// It is no suite, or says what nobody can mean.
    #[error("{suite}: {cause}")]
    Suite {
        /// Its name or file.
        suite: String,
        /// What is wrong, and how to mend it.
        cause: String,
    },
    /// An entrant cannot take part.
    #[error("{cause}")]
    Entrant {
        /// Which and why, and how to mend it.
        cause: String,
    },
    /// A run of a task cannot be set up.
    #[error("task `{task}`: {cause}")]
    Task {
        /// Which.
        task: String,
        /// What is wrong, and how to mend it.
        cause: String,
    },
    /// A run cannot be simulated.
    #[error("task `{task}`: {cause}")]
    Run {
        /// Which.
        task: String,
        /// What the simulation says.
        cause: Box<SimError>,
    },
}

impl BenchmarkError {
    fn task(task: &BenchmarkTask, cause: impl ToString) -> Self {
        Self::Task { task: task.name.clone(), cause: cause.to_string() }
    }
}

#[cfg(test)]
mod tests;
