//! What an external drive tells of itself beside the names of its joints: how often its states come, how long it goes on without a command, by how much the arm is behind its commands, and how
//! quickly its torques may rise.
//!
//! ```text
//! period_ms 2                     from state to state
//! watchdog_ms 100                 without a command for so long it stops the arm
//! lag_ms 38                       the arm is behind its commands by so much: `servo.lead_ms`, where the run file does not say it
//! effort_rate 1000 1000 ...       N m/s or N/s of each joint: control's torques rise no more quickly
//! ```
//! Each line may be left out, and lines that are not known here belong to later versions.

use crate::time::{SpanNs, TICK};
use std::fmt::{self, Write};
use thiserror::Error;

/// The longest period of a drive that control works with. Derived: that of robots with 125 Hz, between two of whose states supervision looks back no further.
const LONGEST_PERIOD: SpanNs = SpanNs(8 * TICK.0);
/// The longest lag that a law is computed ahead for. Chosen by hand: the bound of `servo.lead_ms`.
const LONGEST_LAG: SpanNs = SpanNs(500 * TICK.0);
/// What a lag may differ by from another, as a share. Chosen by hand: a law that looks ahead so much too far goes as well.
const LAG_SHARE: f64 = 0.2;
/// The same at least, ms. Chosen by hand: a period of a drive, and half of one, that nobody tells exactly.
const LAG_MS: f64 = 5.0;
/// Longest time that is read, s. Chosen by hand: more than an hour says nothing else, and a span holds it.
const LONGEST_S: f64 = 3600.0;
/// Commands that a drive must be able to miss before it stops the arm. Chosen by hand: one that comes a tick late stops nothing.
const MAY_MISS: i64 = 2;

/// What a drive tells of itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DriveProperties {
    /// Time from one of its states to the next.
    pub period: Option<SpanNs>,
    /// How long it goes on without a command.
    pub watchdog: Option<SpanNs>,
    /// By how much the arm is behind its commands.
    pub lag: Option<SpanNs>,
    /// How quickly the effort of each joint may rise, N m/s or N/s; empty where that is not told.
    pub effort_rate: Vec<f64>,
}

/// Why a drive cannot be commanded by this control.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DrivePropertiesError {
    /// A line that says nothing.
    #[error(
        "the drive's properties on drive/text have the line `{line}`, which is none: after `period_ms` and `watchdog_ms` comes a number above 0, after `lag_ms` one from 0 on, after `effort_rate` one for each joint"
    )]
    Line {
        /// It.
        line: String,
    },
    /// Its states come too seldom.
    #[error(
        "the drive has a state every {period_ms} ms only: control works with drives of 1 to 8 ms (`period_ms` on drive/text)"
    )]
    Period {
        /// From one to the next, ms.
        period_ms: f64,
    },
    /// Its arm is too far behind.
    #[error(
        "the drive's arm is {lag_ms:.0} ms behind its commands: control works with lags of up to {most_ms:.0} ms (`lag_ms` on drive/text)"
    )]
    Lag {
        /// By how much, ms.
        lag_ms: f64,
        /// The most, ms.
        most_ms: f64,
    },
    /// It has rates for another number of joints.
    #[error(
        "the drive takes torques at the rates of {told} joints, and the robot has {joints} (`effort_rate` on drive/text)"
    )]
    Rates {
        /// Rates that it tells.
        told: usize,
        /// Joints of the robot file.
        joints: usize,
    },
    /// It stops the arm between two commands.
    #[error(
        "the drive stops the arm when no command came for {watchdog_ms} ms, and control sends one each {cycle_ms} ms: one that is late would stop it. Let it wait for {least_ms} ms and more (`watchdog_ms` on drive/text)"
    )]
    Watchdog {
        /// How long it waits, ms.
        watchdog_ms: f64,
        /// Between two commands that it can take, ms.
        cycle_ms: f64,
        /// How long it would have to, ms.
        least_ms: f64,
    },
}

impl DriveProperties {
    /// Of the text of a message.
    ///
    /// # Errors
    /// [`DrivePropertiesError::Line`].
    pub fn parse(text: &str) -> Result<Self, DrivePropertiesError> {
        let mut told = Self::default();
        for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
            let wrong = || DrivePropertiesError::Line { line: line.chars().take(80).collect() };
            let (key, values) = line.split_once(' ').unwrap_or((line, ""));
            let numbers = || {
                let parsed: Result<Vec<f64>, _> = values.split_whitespace().map(str::parse).collect();
                parsed
                    .ok()
                    .filter(|v| !v.is_empty() && v.iter().all(|v| v.is_finite() && *v > 0.0))
                    .ok_or_else(wrong)
            };
            let span = || match numbers()?.as_slice() {
                [ms] => Ok(SpanNs::from_s((ms * 1e-3).min(LONGEST_S))),
                _ => Err(wrong()),
            };
            match key {
                "period_ms" => told.period = Some(span()?),
                "watchdog_ms" => told.watchdog = Some(span()?),
                "lag_ms" => {
                    told.lag = Some(if values.trim().parse() == Ok(0.0) { SpanNs::ZERO } else { span()? })
                }
                "effort_rate" => told.effort_rate = numbers()?,
                _ => {}
            }
        }
        Ok(told)
    }

    /// Whether a lag is nearly the one that is told, or none is.
    #[must_use]
    pub fn agrees_with_lag(&self, ms: f64) -> bool {
        let told_ms = self.lag.map(|lag| lag.as_s() * 1e3);
        told_ms.is_none_or(|told_ms| (ms - told_ms).abs() <= (LAG_SHARE * told_ms).max(LAG_MS))
    }

    /// That control can command such a drive of so many joints.
    ///
    /// # Errors
    /// When its states come too seldom, it stops the arm between two commands, or its rates are of other joints.
    pub fn check(&self, joints: usize) -> Result<(), DrivePropertiesError> {
        if !self.effort_rate.is_empty() && self.effort_rate.len() != joints {
            return Err(DrivePropertiesError::Rates { told: self.effort_rate.len(), joints });
        }
        let ms = |span: SpanNs| span.as_s() * 1e3;
        let period = self.period.unwrap_or(TICK);
        // A span is whole nanoseconds, and a drive tells a rounded number.
        if period.0 > LONGEST_PERIOD.0 + LONGEST_PERIOD.0 / 50 {
            return Err(DrivePropertiesError::Period { period_ms: ms(period) });
        }
        if let Some(lag) = self.lag.filter(|lag| *lag > LONGEST_LAG) {
            return Err(DrivePropertiesError::Lag { lag_ms: ms(lag), most_ms: ms(LONGEST_LAG) });
        }
        let cycle = SpanNs(period.0.max(TICK.0));
        let least = SpanNs((MAY_MISS + 1) * cycle.0);
        match self.watchdog {
            Some(watchdog) if watchdog < least => Err(DrivePropertiesError::Watchdog {
                watchdog_ms: ms(watchdog),
                cycle_ms: ms(cycle),
                least_ms: ms(least),
            }),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for DriveProperties {
    /// The text of a message.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = String::new();
        for (key, span) in [("period_ms", self.period), ("watchdog_ms", self.watchdog), ("lag_ms", self.lag)]
        {
            if let Some(span) = span {
                writeln!(text, "{key} {}", span.as_s() * 1e3)?;
            }
        }
        if !self.effort_rate.is_empty() {
            let rates: Vec<_> = self.effort_rate.iter().map(ToString::to_string).collect();
            writeln!(text, "effort_rate {}", rates.join(" "))?;
        }
        f.write_str(text.trim_end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn told(text: &str) -> Result<(), DrivePropertiesError> {
        DriveProperties::parse(text)?.check(2)
    }

    #[test]
    fn drives_that_stop_between_two_commands_are_refused() {
        assert_eq!(told(""), Ok(()));
        assert_eq!(told("period_ms 8\nwatchdog_ms 100\n"), Ok(()));
        assert_eq!(told("period_ms 2\nwatchdog_ms 6\nlater 7 x\n"), Ok(()));
        let words = told("watchdog_ms 1.5").unwrap_err().to_string();
        assert!(words.contains("no command came for 1.5 ms") && words.contains("3 ms and more"), "{words}");
        assert!(told("period_ms 4\nwatchdog_ms 8").is_err(), "two of its own cycles");
        let words = told("period_ms 20").unwrap_err().to_string();
        assert!(words.contains("every 20 ms"), "{words}");
        assert_eq!(told("lag_ms 0"), Ok(()));
        let words = told("lag_ms 700").unwrap_err().to_string();
        assert!(words.contains("700 ms behind") && words.contains("up to 500 ms"), "{words}");
        for line in [
            "lag_ms -1",
            "lag_ms",
            "period_ms",
            "period_ms x",
            "period_ms -1",
            "watchdog_ms 1 2",
            "effort_rate 0",
            "watchdog_ms nan",
        ] {
            assert!(matches!(told(line), Err(DrivePropertiesError::Line { .. })), "{line}");
        }
    }

    #[test]
    fn rates_are_those_of_every_joint() {
        assert_eq!(told("effort_rate 1000 1000"), Ok(()));
        let words = told("effort_rate 1000").unwrap_err().to_string();
        assert!(words.contains("of 1 joints") && words.contains("has 2"), "{words}");
    }

    proptest! {
        #[test]
        fn what_is_told_comes_back(period in 1_i64..9_000, watchdog in 1_i64..900_000, lag in 0_i64..500_000, rates in prop::collection::vec(1.0..1e6, 0..7)) {
            let us = |us: i64| Some(SpanNs(us * 1000));
            let told = DriveProperties { period: us(period), watchdog: us(watchdog), lag: us(lag), effort_rate: rates };
            let back = DriveProperties::parse(&told.to_string()).unwrap();
            prop_assert_eq!(&back.effort_rate, &told.effort_rate);
            for (a, b) in [(back.period, told.period), (back.watchdog, told.watchdog), (back.lag, told.lag)] {
                prop_assert!((a.unwrap().0 - b.unwrap().0).abs() <= 1);
            }
        }

        #[test]
        fn whatever_is_told_is_read_or_refused(text in ".{0,200}") {
            let _ = told(&text);
        }
    }
}
