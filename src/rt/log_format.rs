//! In which form this process logs, and how much; children log likewise.

use std::str::FromStr;
use std::sync::OnceLock;

/// The variable that says how much.
pub(super) const FILTER: &str = "VSERVO_LOG";
/// The variable that says in which form.
pub(super) const FORMAT: &str = "VSERVO_LOG_FORMAT";
/// How much is logged when nobody says.
pub(super) const USUAL: &str = "vservo=info,error";

/// The form of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One object a line, with a time stamp (UTC, RFC 3339).
    Json,
}

impl FromStr for LogFormat {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, Self::Err> {
        match word {
            "text" => Ok(Self::Text),
            "json" => Ok(Self::Json),
            _ => Err("is neither `text` nor `json`".into()),
        }
    }
}

impl LogFormat {
    fn as_str(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Json => "json",
        }
    }
}

/// In which form this process logs, and how much.
static CHOSEN: OnceLock<(LogFormat, String)> = OnceLock::new();

/// Settles it, once; the form that it is from then on.
pub(super) fn choose(format: LogFormat, filter: Option<String>) -> LogFormat {
    CHOSEN.get_or_init(|| (format, filter.unwrap_or_else(|| USUAL.into()))).0
}

/// The form in which this process logs.
#[must_use]
pub fn log_format() -> LogFormat {
    CHOSEN.get().map_or(LogFormat::Text, |(format, _)| *format)
}

/// The variables that make a child process log as this one does, without a word about what was wrong in its own.
#[must_use]
pub fn log_environment() -> [(&'static str, &'static str); 2] {
    let filter = CHOSEN.get().map_or(USUAL, |(_, filter)| filter.as_str());
    [(FORMAT, log_format().as_str()), (FILTER, filter)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_have_names() {
        for format in [LogFormat::Text, LogFormat::Json] {
            assert_eq!(format.as_str().parse(), Ok(format));
        }
        assert!("xml".parse::<LogFormat>().is_err());
    }
}
