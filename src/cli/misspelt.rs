//! A word in the place of a command that is none.

use super::Cli;
use crate::config::{SHIPPED_FILES, ShippedFile};
use crate::input::{nearest, printable};
use clap::CommandFactory;
use std::path::Path;

/// What is said where a word stands in the place of a command and is none, nor a run file.
pub(super) fn misspelt(word: Option<&Path>) -> Option<String> {
    let path =
        word.filter(|path| !path.exists() && path.extension().is_none() && path.components().count() == 1)?;
    let word = path.to_str().filter(|word| ShippedFile::find(word).is_none())?;
    let commands = Cli::command();
    let commands = commands.get_subcommands().filter(|c| !c.is_hide_set()).map(clap::Command::get_name);
    let meant = match nearest(word, commands) {
        Some(command) => format!("did you mean `vservo {command}`?"),
        None => match nearest(word, SHIPPED_FILES.iter().map(|file| file.name)) {
            Some(file) => format!("did you mean the run file `{file}`?"),
            None => "`vservo --help` lists commands, `vservo config --list` run files".into(),
        },
    };
    Some(format!("`{}` is no command, no file and no shipped run file: {meant}", printable(word)))
}
