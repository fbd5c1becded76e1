//! `vservo export`: a recording for other programs.

use super::shown;
use crate::export::{ViewerKind, write_for_viewers, write_tables};
use crate::process::{OpenRecording, ProcessError};
use crate::record::RecordingError;
use clap::{Args, ValueEnum};
use std::fmt::Write as _;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

/// Whom a recording is exported for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFor {
    /// Foxglove: transforms, joint states, calibrations, annotations of the images and a log beside all records
    Foxglove,
    /// ROS 2: the same in the packages that it has
    Ros2,
    /// Rerun, whose `rerun mcap convert` reads it: the same with the images as PNG
    Rerun,
    /// Tables, one a service, with units in their headers
    Csv,
}

/// Arguments of `vservo export`.
#[derive(Debug, Args)]
pub struct ExportArguments {
    /// The recording of a run
    #[arg(value_name = "RUN.mcap")]
    pub recording: PathBuf,
    /// For whom
    #[arg(long = "for", value_enum, value_name = "WHOM")]
    pub purpose: ExportFor,
    /// File to write; with csv a folder
    #[arg(long, value_name = "OUT")]
    pub out: PathBuf,
}

/// Exports a recording; the exit code.
pub(super) fn export(arguments: &ExportArguments) -> Result<u8, ProcessError> {
    let OpenRecording { reader, config, .. } = OpenRecording::open(&arguments.recording, &[])?;
    let out = &arguments.out;
    let unwritten = |cause| ProcessError::Write { path: out.clone(), cause };
    let wrong = |error: RecordingError| match error {
        RecordingError::Io(cause) => unwritten(cause),
        error => ProcessError::Replay { path: arguments.recording.clone(), cause: Box::new(error.into()) },
    };
    let mut text = String::new();
    let kind = match arguments.purpose {
        ExportFor::Csv => {
            std::fs::create_dir_all(out).map_err(unwritten)?;
            let open = |name: &str| Ok(BufWriter::new(File::create(out.join(name))?));
            for table in write_tables(reader, &config, open).map_err(wrong)? {
                // a String takes everything
                let _ = writeln!(text, "{:<32} {:>9} rows", table.file, table.rows);
            }
            return Ok(shown(&text, 0));
        }
        ExportFor::Foxglove => ViewerKind::Foxglove,
        ExportFor::Ros2 => ViewerKind::Ros2,
        ExportFor::Rerun => ViewerKind::Rerun,
    };
    if out.exists() && std::fs::canonicalize(out).ok() == std::fs::canonicalize(&arguments.recording).ok() {
        return Err(ProcessError::NoCommand("--out: is the recording itself; name another file".into()));
    }
    let sink = BufWriter::new(File::create(out).map_err(unwritten)?);
    let written = write_for_viewers(reader, &config, kind, sink);
    if written.is_err() && out.is_file() {
        // Half of it is of no use. Where it stays, the error is told all the same.
        let _ = std::fs::remove_file(out);
    }
    for (topic, count) in written.map_err(wrong)? {
        let _ = writeln!(text, "{topic:<32} {count:>9} messages");
    }
    Ok(shown(&text, 0))
}
