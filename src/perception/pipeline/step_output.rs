//! What a step gives: a value for the next one, numbers, a table, and a drawing of its own.

use super::colour_image::ColourImage;
use super::table::StepTable;
use super::value::StepValue;

/// Modes of the histogram rise above their valleys by this share of the greatest, as [`Histogram::valley`] names it for a start. Chosen by hand:
/// half lets ripples of noise be modes, twice loses an object that covers little of the image.
pub(super) const MIN_PROMINENCE: f64 = 0.02;

/// What a step gave.
pub(super) struct StepOutput {
    pub(super) value: StepValue,
    pub(super) facts: Vec<(&'static str, f64)>,
    pub(super) table: Option<StepTable>,
    /// Of a step whose result is not its value.
    pub(super) drawn: Option<ColourImage>,
}

impl StepOutput {
    pub(super) fn new(value: StepValue, facts: impl Into<Vec<(&'static str, f64)>>) -> Self {
        Self { value, facts: facts.into(), table: None, drawn: None }
    }

    pub(super) fn with_table(self, table: StepTable) -> Self {
        Self { table: Some(table), ..self }
    }

    pub(super) fn with_drawn(self, drawn: ColourImage) -> Self {
        Self { drawn: Some(drawn), ..self }
    }
}
