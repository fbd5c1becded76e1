//! `vservo config`: the run files that come with the program.

use super::shown;
use crate::config::{SHIPPED_FILES, ShippedFile};
use crate::input::{nearest, printable};
use crate::process::ProcessError;

/// Prints one of them, or tells which there are; the exit code.
pub(super) fn shipped_file(name: Option<&str>, list: bool) -> Result<u8, ProcessError> {
    if list {
        let longest = SHIPPED_FILES.iter().map(|file| file.name.len()).max().unwrap_or(0);
        let lines = SHIPPED_FILES.iter().map(|file| format!("{:longest$}  {}\n", file.name, file.about()));
        return Ok(shown(&lines.collect::<String>(), 0));
    }
    let name = name.unwrap_or("default");
    if let Some(file) = ShippedFile::find(name.strip_suffix(".toml").unwrap_or(name)) {
        return Ok(shown(file.text, 0));
    }
    let meant = nearest(name, SHIPPED_FILES.iter().map(|file| file.name));
    let hint = meant.map_or("see `vservo config --list`".into(), |meant| format!("did you mean `{meant}`?"));
    Err(ProcessError::NoCommand(format!("no run file `{}` comes with the program: {hint}", printable(name))))
}
