//! What the processes log, where it goes, and in which form: lines for people, or one JSON object each for programs.
//!
//! `VSERVO_LOG` says how much (`info`, `warn`, `vservo::process=debug,error`), `--log-format` or `VSERVO_LOG_FORMAT` how.
//!
//! At the level `debug` there is a span around each part of a run: `run`, `frame`, `measurement`, `request`, `stage` of a calibration. A line tells when one
//! ends, and how long it was busy and idle. The real-time thread has none.

use super::log_format::{FILTER, FORMAT, LogFormat, USUAL, choose};
use super::output::{StderrLines, tell};
use std::io::{IsTerminal, stderr};
use std::str::FromStr;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::format::{FmtSpan, Format};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

const LEVELS: &str = "off, error, warn, info, debug or trace";

/// Starts logging, in the form that was asked for on the command line, or else by the environment. What is wrong with the latter is
/// reported, and left out.
pub fn start_logging(asked: Option<LogFormat>) {
    let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    let by_environment = variable(FORMAT).map(|word| word.parse::<LogFormat>());
    let format = asked.unwrap_or_else(|| by_environment.clone().and_then(Result::ok).unwrap_or_default());
    let given = variable(FILTER);
    let filter = given.as_deref().map(filter);
    let good = given.filter(|_| matches!(filter, Some(Ok(_))));
    let format = choose(format, good);
    let usual = || Targets::from_str(USUAL).unwrap_or_default();
    let targets = filter.clone().and_then(Result::ok).unwrap_or_else(usual);
    let registry = tracing_subscriber::registry().with(targets);
    // its word about a line that could not be written would panic where stderr is gone
    let lines = tracing_subscriber::fmt::layer().with_writer(|| StderrLines).log_internal_errors(false);
    // spans are of the level debug
    let lines = lines.with_span_events(FmtSpan::CLOSE);
    match format {
        LogFormat::Json => registry.with(lines.json().with_thread_names(true)).init(),
        LogFormat::Text => {
            // the layer's own `without_time` would leave out how long spans took too
            let lines = lines.event_format(Format::default().without_time());
            registry.with(lines.with_ansi(stderr().is_terminal())).init();
        }
    }
    if let Some(Err(wrong)) = filter {
        tell(format_args!("vservo: warning: {FILTER}: {wrong}: logs as {USUAL}"));
    }
    if let (None, Some(Err(wrong))) = (asked, by_environment) {
        tell(format_args!("vservo: warning: {FORMAT}: {wrong}: logs as text"));
    }
}

/// What a list of levels and `target=level` lets through; `Err` says what is none.
fn filter(text: &str) -> Result<Targets, String> {
    for part in text.split(',').map(str::trim) {
        let level = part.rsplit_once('=').map_or(part, |(_, level)| level);
        if level.is_empty() || LevelFilter::from_str(level).is_err() {
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
}
