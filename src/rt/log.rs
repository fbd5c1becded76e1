//! What the processes log, where it goes, and in which form: lines for people, or one JSON object each for programs.
//!
//! `VSERVO_LOG` says how much (`info`, `warn`, `vservo::process=debug,error`), `--log-format` or `VSERVO_LOG_FORMAT` how.

use super::output::{Lines, tell};
use std::io::{IsTerminal, stderr};
use std::str::FromStr;
use std::sync::OnceLock;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// How much.
const FILTER: &str = "VSERVO_LOG";
/// In which form.
const FORMAT: &str = "VSERVO_LOG_FORMAT";
const USUAL: &str = "vservo=info,error";
const LEVELS: &str = "off, error, warn, info, debug or trace";

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

/// Starts logging, in the form that was asked for on the command line, or else by the environment. What is wrong with the latter is
/// told, and left out.
pub fn start_logging(asked: Option<LogFormat>) {
    let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    let by_environment = variable(FORMAT).map(|word| word.parse::<LogFormat>());
    let format = asked.unwrap_or_else(|| by_environment.clone().and_then(Result::ok).unwrap_or_default());
    let given = variable(FILTER);
    let filter = given.as_deref().map(filter);
    let good = given.filter(|_| matches!(filter, Some(Ok(_))));
    let _ = CHOSEN.set((format, good.unwrap_or_else(|| USUAL.into())));
    let usual = || Targets::from_str(USUAL).unwrap_or_default();
    let targets = filter.clone().and_then(Result::ok).unwrap_or_else(usual);
    let registry = tracing_subscriber::registry().with(targets);
    // its word about a line that could not be written would panic where stderr is gone
    let lines = tracing_subscriber::fmt::layer().with_writer(|| Lines).log_internal_errors(false);
    match format {
        LogFormat::Json => registry.with(lines.json()).init(),
        LogFormat::Text => registry.with(lines.with_ansi(stderr().is_terminal()).without_time()).init(),
    }
    if let Some(Err(wrong)) = filter {
        tell(format_args!("vservo: warning: {FILTER}: {wrong}: logs as {USUAL}"));
    }
    if let (None, Some(Err(wrong))) = (asked, by_environment) {
        tell(format_args!("vservo: warning: {FORMAT}: {wrong}: logs as text"));
    }
}

/// A line that is told, as an object like those of the log.
pub(super) fn object(message: &str) -> String {
    let mut timestamp = String::new();
    // of a clock that gives none, none
    let _ = SystemTime.format_time(&mut Writer::new(&mut timestamp));
    let level = if message.contains("warning:") { "WARN" } else { "INFO" };
    let fields = serde_json::json!({ "message": message });
    let told =
        serde_json::json!({ "timestamp": timestamp, "level": level, "fields": fields, "target": "vservo" });
    format!("{told}\n")
}

/// What a list of levels and `target=level` lets through; `Err` says what is none.
fn filter(text: &str) -> Result<Targets, String> {
    for part in text.split(',').map(str::trim) {
        let level = part.rsplit_once('=').map_or(part, |(_, level)| level);
        if LevelFilter::from_str(level).is_err() {
            let form = if level == "json" { "; for JSON there is --log-format json" } else { "" };
            let shown: String = level.chars().take(40).collect();
            return Err(format!("`{}` is no level ({LEVELS}){form}", shown.escape_default()));
        }
    }
    Targets::from_str(text).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_are_levels_and_what_is_none_is_told() {
        for good in ["warn", "vservo=debug,error", "vservo::process=trace, off", "INFO"] {
            assert!(filter(good).is_ok(), "{good}");
        }
        let wrong = filter("json").unwrap_err();
        assert!(wrong.contains("--log-format json"), "{wrong}");
        for bad in ["loud", "vservo=", "vservo=info,,", "a=b=c"] {
            assert!(filter(bad).unwrap_err().contains("is no level"), "{bad}");
        }
    }

    #[test]
    fn a_line_that_is_told_is_an_object_with_a_time() {
        let told: serde_json::Value = serde_json::from_str(&object("vservo: warning: \"x\"\n\u{7}")).unwrap();
        assert_eq!(told["fields"]["message"], "vservo: warning: \"x\"\n\u{7}");
        assert_eq!(told["level"], "WARN");
        assert!(told["timestamp"].as_str().is_some_and(|t| t.ends_with('Z') && t.contains('T')), "{told}");
    }

    #[test]
    fn forms_have_names() {
        for format in [LogFormat::Text, LogFormat::Json] {
            assert_eq!(format.as_str().parse(), Ok(format));
        }
        assert!("xml".parse::<LogFormat>().is_err());
    }
}
