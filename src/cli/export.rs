//! `vservo export`: a recording for other programs.

use super::shown;
use crate::export::{ViewerKind, write_for_viewers, write_tables};
use crate::input::{printable, used};
use crate::process::{OpenRecording, ProcessError};
use crate::record::RecordingError;
use crate::rt::tell;
use clap::{Args, ValueEnum};
use std::fmt::Write as _;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

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

/// The names of the tables in a folder.
fn tables_in(folder: &Path) -> impl Iterator<Item = String> {
    let names = std::fs::read_dir(folder).into_iter().flatten().flatten();
    names.filter_map(|entry| entry.file_name().into_string().ok()).filter(|name| name.ends_with(".csv"))
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
            let tables = write_tables(reader, &config, open).map_err(wrong)?;
            for table in &tables {
                // a String takes everything
                let _ = writeln!(text, "{:<32} {:>9} rows", table.file, table.rows);
            }
            for other in tables_in(out).filter(|name| tables.iter().all(|table| table.file != *name)) {
                let place = out.join(&other);
                tell(format_args!(
                    "vservo: warning: {} is not of this recording, and was there before",
                    printable(&place.display().to_string())
                ));
            }
            return Ok(shown(&text, 0));
        }
        ExportFor::Foxglove => ViewerKind::Foxglove,
        ExportFor::Ros2 => ViewerKind::Ros2,
        ExportFor::Rerun => ViewerKind::Rerun,
    };
    // By whatever name.
    if std::fs::metadata(out).is_ok_and(|found| used::is_used(&found)) {
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
