//! `vservo explain` and `vservo report`: a run in words and as a page, from its recording.

use super::{json, shown};
use crate::explain::{RunEvidence, explain as explanation_of};
use crate::input::{printable, shell_word};
use crate::process::{NewReport, OpenRecording, ProcessError, recorded_report};
use crate::rt::tell;
use clap::Args;
use std::path::{Path, PathBuf};

/// Arguments of `vservo explain`.
#[derive(Debug, Args)]
pub struct ExplainArguments {
    /// The recording of a run, or the folder of its report
    #[arg(value_name = "RUN.mcap|DIR")]
    pub run: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `vservo report`.
#[derive(Debug, Args)]
pub struct ReportArguments {
    /// The recording of a run, or two to see them side by side; last the folder of the report
    #[arg(value_name = "RUN.mcap [OTHER.mcap] DIR", num_args = 2..=3, required = true)]
    pub paths: Vec<PathBuf>,
}

/// Tells in words how a run went; the exit code.
pub(super) fn explain(arguments: &ExplainArguments) -> Result<u8, ProcessError> {
    let path = &arguments.run;
    let evidence = if path.is_dir() { recorded_report::evidence_of_report(path)? } else { named(path)?.1 };
    let explanation = explanation_of(&evidence);
    let text = if arguments.json { json(&explanation) } else { explanation.to_text() };
    Ok(shown(&text, 0))
}

/// Writes the page of a recorded run, or of two; the exit code.
pub(super) fn report(arguments: &ReportArguments) -> Result<u8, ProcessError> {
    let page = match arguments.paths.as_slice() {
        [a, b, folder] => {
            let report = NewReport::begin(folder)?;
            recorded_report::write_compared(report, [named(a)?, named(b)?])?
        }
        [path, folder] => {
            let OpenRecording { reader, config, .. } = OpenRecording::open(path, &[])?;
            let again = OpenRecording::reader_of(path)
                .map_err(|cause| ProcessError::Replay { path: path.into(), cause: Box::new(cause) })?;
            let report = NewReport::begin(folder)?;
            let command = format!("vservo replay {}", shell_word(&path.display().to_string()));
            recorded_report::write_recorded(report, &config, [reader, again], path, &[command])?
        }
        // as many as its arguments say
        _ => return Ok(2),
    };
    tell(format_args!("report: {}", printable(&page.display().to_string())));
    Ok(0)
}

/// What a recorded run left, under the name of its file.
fn named(path: &Path) -> Result<(String, RunEvidence), ProcessError> {
    let OpenRecording { reader, config, .. } = OpenRecording::open(path, &[])?;
    let evidence = recorded_report::evidence_of_recording(reader, config)
        .map_err(|cause| ProcessError::Replay { path: path.into(), cause: Box::new(cause) })?;
    Ok((path.display().to_string(), evidence))
}
