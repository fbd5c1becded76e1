//! Image processing of Sect. 10.2 as a chain of steps, written as text: `gaussian:1.0 | sobel | magnitude | threshold:60`.
//!
//! ```text
//! text --Pipeline::parse--> steps, of which each takes what the one before gives --Pipeline::run--> StepOutcome of each step
//! ```
//! - A *step* is one word of [`STEPS`] with its parameters, separated by colons.
//! - A *kind* ([`ValueKind`]) is what a step takes and gives: an image, a gradient, a field, a binary image, regions, contours, edges,
//!   chains, or shapes. A step that does not take what the one before it gives is refused before anything is computed, with the steps
//!   that would.
//! - A *measuring* step (`histogram`, `moments`, `axes`) hands on what it was given; its result is a [`StepTable`].
//!
//! The steps compute nothing themselves: each calls the kernel of [`crate::imaging`] or the finder of [`crate::detect`] that the
//! program uses everywhere. Positions are pixels of the image, pixel centres integers, x along columns and y down rows.
//!
//! ```
//! # use vservo_perception as vservo;
//! use vservo::imaging::ImageView;
//! use vservo::pipeline::Pipeline;
//! let mut pixels = [200u8; 64];
//! pixels[18..22].fill(20); // four dark pixels in row 2
//! let image = ImageView::new(&pixels, 8, 8)?;
//! let outcomes = Pipeline::parse("threshold:100 | regions | moments")?.run(&image)?;
//! let moments = outcomes[2].table.as_ref().ok_or("no table")?;
//! assert_eq!(moments.column("m00"), [4.0]);
//! assert_eq!((moments.column("x_px"), moments.column("y_px")), (vec![3.5], vec![2.0]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod apply;
mod colour_image;
mod error;
mod measure;
mod outline;
mod parse;
mod step;
mod step_output;
mod table;
mod value;

pub use colour_image::{ColourImage, segment_pixels};
pub use error::{PipelineError, StepError, StepFailure};
pub use step::{STEPS, StepInfo};
pub use table::StepTable;
pub use value::ValueKind;

use crate::imaging::ImageView;
use step::PipelineStep;
use value::StepValue;

/// Steps that fit each other.
#[derive(Debug, Clone)]
pub struct Pipeline {
    steps: Vec<(String, PipelineStep)>,
}

/// What one step gave.
#[derive(Debug, Clone)]
pub struct StepOutcome {
    /// The step as it was written, without the space around it.
    pub step: String,
    /// What it gives to the next.
    pub kind: ValueKind,
    /// Single numbers, by name with unit.
    pub facts: Vec<(&'static str, f64)>,
    /// Numbers of each region, contour, level and so on.
    pub table: Option<StepTable>,
    /// What it gives, to be looked at.
    pub drawn: ColourImage,
}

impl Pipeline {
    /// Reads steps, separated by `|`, and looks whether each takes what the one before it gives; the first is given an image.
    ///
    /// # Errors
    /// [`PipelineError`] of the first step that is wrong: no such step, a parameter out of its range, or one that does not fit.
    pub fn parse(text: &str) -> Result<Self, PipelineError> {
        parse::parse(text).map(|steps| Self { steps })
    }

    /// Does all steps, in order, and tells what each gave.
    ///
    /// # Errors
    /// [`StepError`] of the first step that cannot be done with this image.
    pub fn run(&self, image: &ImageView<'_>) -> Result<Vec<StepOutcome>, StepError> {
        let mut value = StepValue::image(image);
        let mut outcomes = Vec::with_capacity(self.steps.len());
        for (i, (text, step)) in self.steps.iter().enumerate() {
            let failed = |cause| StepError { number: i + 1, step: text.clone(), cause };
            let done = step.apply(value).map_err(failed)?;
            outcomes.push(StepOutcome {
                step: text.clone(),
                kind: done.value.kind(),
                drawn: done.drawn.unwrap_or_else(|| ColourImage::of(&done.value)),
                facts: done.facts,
                table: done.table,
            });
            value = done.value;
        }
        Ok(outcomes)
    }
}

#[cfg(test)]
mod tests;
