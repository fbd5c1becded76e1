//! `vservo man`: manual pages of all commands, for packages.
#![allow(rustdoc::broken_intra_doc_links)] // the words of commands have brackets

use super::{Cli, lost};
use crate::process::ProcessError;
use clap::{Args, CommandFactory};
use std::path::PathBuf;

/// Arguments of `vservo man`.
#[derive(Debug, Args)]
pub struct ManArguments {
    /// Folder to write them into, such as /usr/local/share/man/man1; it is made where it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Writes `vservo.1` and a page for each command that is not hidden.
pub(super) fn write_pages(arguments: &ManArguments) -> Result<u8, ProcessError> {
    let written = std::fs::create_dir_all(&arguments.out)
        .and_then(|()| clap_mangen::generate_to(Cli::command(), &arguments.out));
    Ok(written.map_or_else(|cause| lost(&arguments.out, cause, 0), |()| 0))
}
