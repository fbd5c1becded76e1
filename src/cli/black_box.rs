//! Which black box a daemon has: the option, the variable of the environment, and where it is by default.

use crate::process::recorder::BlackBoxSettings;
use crate::time::SpanNs;
use clap::Args;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// How long a black box may keep, s. Chosen by hand: what is shorter than a chunk holds nothing, and an hour is for a recording.
const LAST_S: std::ops::RangeInclusive<f64> = 1.0..=3600.0;

/// Options of a daemon's black box.
#[derive(Debug, Args)]
pub struct BlackBoxArguments {
    /// Folder for what was sent before each fault, in a folder NAME of its own; `off`: nothing is kept. By default in the state folder of the user, or of the service
    #[arg(long, value_name = "DIR|off", env = "VSERVO_BLACK_BOX")]
    pub black_box: Option<PathBuf>,
    /// How much is kept, in memory
    #[arg(long, value_name = "60s", default_value = "60s", value_parser = last)]
    pub black_box_last: SpanNs,
}

impl BlackBoxArguments {
    /// The black box that is asked for; none where it is off or there is no place for it. Beside a `recording` of all there is none unless one is named.
    pub(super) fn settings(&self, recording: Option<&Path>) -> Option<BlackBoxSettings> {
        let folder = match &self.black_box {
            Some(off) if off.as_os_str() == "off" => return None,
            Some(folder) => folder.clone(),
            None if recording.is_some() => return None,
            None => default_folder(|name| std::env::var_os(name))?,
        };
        Some(BlackBoxSettings { last: self.black_box_last, folder, writes_at_stop: false })
    }
}

/// Where `variable` says that states are kept: of a service of systemd, else of the user.
fn default_folder(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let absolute = |name: &str| variable(name).map(PathBuf::from).filter(|path| path.is_absolute());
    // Of several the first one, as systemd writes them.
    let of_service = variable("STATE_DIRECTORY")
        .and_then(|all| Some(std::env::split_paths(&all).next()?.join("black-box")));
    let of_user = || absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")));
    of_service.filter(|path| path.is_absolute()).or_else(|| Some(of_user()?.join("vservo/black-box")))
}

/// A time such as `60s`, `1.5min`, `500ms` or `60`, which is seconds.
pub(super) fn last(text: &str) -> Result<SpanNs, String> {
    let units = [("min", 60.0), ("ms", 1e-3), ("s", 1.0), ("", 1.0)];
    let number =
        units.iter().find_map(|(unit, s)| Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * s));
    match number.filter(|s| LAST_S.contains(s)) {
        Some(s) => Ok(SpanNs::from_s(s)),
        None => Err(format!(
            "a time of {} s to {} s is needed, such as 60s or 2min",
            LAST_S.start(),
            LAST_S.end()
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_units_and_bounds() {
        for (text, s) in [("60s", 60.0), ("60", 60.0), ("1.5min", 90.0), ("2 min", 120.0), ("1500ms", 1.5)] {
            assert_eq!(last(text), Ok(SpanNs::from_s(s)), "{text}");
        }
        for text in ["", "0s", "-5s", "2h", "NaN", "inf", "61min", "60 seconds"] {
            assert!(last(text).unwrap_err().contains("60s"), "{text}");
        }
    }

    #[test]
    fn the_folder_is_that_of_the_service_or_of_the_user() {
        let of = |all: &[(&str, &str)]| {
            default_folder(|name| all.iter().find(|(n, _)| *n == name).map(|(_, value)| value.into()))
        };
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[("HOME", "/h")]), Some("/h/.local/state/vservo/black-box".into()));
        assert_eq!(of(&[("HOME", "/h"), ("XDG_STATE_HOME", "/x")]), Some("/x/vservo/black-box".into()));
        assert_eq!(of(&[("XDG_STATE_HOME", "relative")]), None);
        let service = [("HOME", "/h"), ("STATE_DIRECTORY", "/var/lib/vservo:/var/lib/other")];
        assert_eq!(of(&service), Some("/var/lib/vservo/black-box".into()));
    }
}
