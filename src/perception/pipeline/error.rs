//! What can be wrong with steps, and with an image for them.

use super::ValueKind;
use crate::imaging::TooManyPixels;
use thiserror::Error;

/// Why a text is no pipeline.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PipelineError {
    /// Nothing is written, or nothing between two bars.
    #[error("step {number} is empty: steps are separated by `|`, as in `gaussian:1.0 | sobel | magnitude`")]
    Empty {
        /// Which, from 1.
        number: usize,
    },
    /// There is no such step.
    #[error("step {number}: there is no step `{word}`{hint}")]
    Unknown {
        /// Which, from 1.
        number: usize,
        /// What is written.
        word: String,
        /// What may have been meant, or which there are.
        hint: String,
    },
    /// A parameter is missing, too many or out of range.
    #[error("step {number} `{step}`: {problem}; it is written {usage}")]
    Parameter {
        /// Which, from 1.
        number: usize,
        /// What is written.
        step: String,
        /// What is wrong.
        problem: String,
        /// How the step is written.
        usage: &'static str,
    },
    /// A step does not take what the one before it gives.
    #[error(
        "step {number} `{step}` takes {takes}, and {before} gives {given}: {given} is taken by {takers}; {takes} is given by {givers}"
    )]
    Mismatch {
        /// Which, from 1.
        number: usize,
        /// What is written.
        step: Box<str>,
        /// What it takes.
        takes: Box<str>,
        /// The step before, or the file.
        before: Box<str>,
        /// What that gives.
        given: ValueKind,
        /// Steps that take it.
        takers: Box<str>,
        /// Steps that give what this one takes.
        givers: Box<str>,
    },
}

/// Why a step could not be done with this image.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("step {number} `{step}`: {cause}")]
pub struct StepError {
    /// Which, from 1.
    pub number: usize,
    /// The step as it was written.
    pub step: String,
    /// Why.
    pub cause: StepFailure,
}

/// Why a step could not be done.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum StepFailure {
    /// All pixels have one level.
    #[error("all pixels have one grey level: there is no threshold")]
    OneLevel,
    /// The histogram has one mode only.
    #[error("the histogram has fewer than two modes: there is no valley between objects and background")]
    OneMode,
    /// Noise or a fine texture.
    #[error(
        "more than {limit} {what}: noise or texture; filter the image first (gaussian), or raise the threshold"
    )]
    TooMany {
        /// What there is too much of.
        what: &'static str,
        /// As many as are taken.
        limit: usize,
    },
    /// An image that is too large for region merging.
    #[error("{0}: make it smaller first (pyramid)")]
    TooLarge(#[from] TooManyPixels),
    /// The kernel refuses the number.
    #[error("{0}")]
    Refused(String),
}
