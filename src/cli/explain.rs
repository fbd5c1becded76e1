//! `vservo explain` and `vservo report`: a run in words and as a page, from its recording.

use super::replay::OpenRecording;
use super::{json, shown};
use crate::explain::explain as explanation_of;
use crate::input::{printable, shell_word};
use crate::process::{NewReport, ProcessError, recorded_report};
use crate::rt::tell;
use clap::Args;
use std::path::PathBuf;

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
    /// The recording of a run
    #[arg(value_name = "RUN.mcap")]
    pub recording: PathBuf,
    /// Folder of the report
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// Tells in words how a run went; the exit code.
pub(super) fn explain(arguments: &ExplainArguments) -> Result<u8, ProcessError> {
    let path = &arguments.run;
    let evidence = if path.is_dir() {
        recorded_report::evidence_of_report(path)?
    } else {
        let OpenRecording { reader, config, .. } = OpenRecording::open(path, &[])?;
        recorded_report::evidence_of_recording(reader, config)
            .map_err(|cause| ProcessError::Replay { path: path.clone(), cause: Box::new(cause) })?
    };
    let explanation = explanation_of(&evidence);
    let text = if arguments.json { json(&explanation) } else { explanation.to_text() };
    Ok(shown(&text, 0))
}

/// Writes the page of a recorded run; the exit code.
pub(super) fn report(arguments: &ReportArguments) -> Result<u8, ProcessError> {
    let path = &arguments.recording;
    let OpenRecording { config, .. } = OpenRecording::open(path, &[])?;
    let report = NewReport::begin(&arguments.folder)?;
    let command = format!("vservo replay {}", shell_word(&path.display().to_string()));
    let page = recorded_report::write_recorded(
        report,
        &config,
        || OpenRecording::reader_of(path),
        path,
        &[command],
    )?;
    tell(format_args!("report: {}", printable(&page.display().to_string())));
    Ok(0)
}
