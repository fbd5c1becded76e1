//! Problems of a configuration, with their positions in the file.

use std::fmt;

/// Most problems that are listed, so that they fit a terminal; the others are counted.
const TOLD: usize = 20;

/// One problem, with its position.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// `file:line:column`, or `--set key`, or the file alone.
    pub place: String,
    /// Dotted path of the key; empty for the file as a whole.
    pub key: String,
    /// What is wrong and what is allowed.
    pub message: String,
    /// Position in the file, for sorting.
    pub(super) order: (usize, String),
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.place)?;
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&self.message)
    }
}

impl Problem {
    /// A problem with the file as a whole.
    #[must_use]
    pub fn of_file(name: &str, message: String) -> Self {
        Self { place: name.into(), key: String::new(), message, order: (0, String::new()) }
    }
}

/// The problems of a configuration: the first twenty, and how many more there are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigError {
    /// In the order of the file; never empty.
    pub problems: Vec<Problem>,
    /// Number of further problems.
    pub more: usize,
}

impl ConfigError {
    /// Of all `problems`, and `more` behind them that were only counted.
    pub(super) fn new(mut problems: Vec<Problem>, more: usize) -> Self {
        problems.sort_by(|a, b| a.order.cmp(&b.order));
        let more = more + problems.len().saturating_sub(TOLD);
        problems.truncate(TOLD);
        Self { problems, more }
    }

    /// With one more problem, first of all.
    pub(super) fn beside(mut self, problem: Option<Problem>) -> Self {
        self.problems.splice(0..0, problem);
        self
    }

    /// The message for people, line by line.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let more = (self.more > 0).then(|| {
            let problems = if self.more == 1 { "problem" } else { "problems" };
            format!("and {} more {problems}; mend those above first", self.more)
        });
        self.problems.iter().map(Problem::to_string).chain(more)
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, line) in self.lines().enumerate() {
            if i > 0 {
                writeln!(f)?;
            }
            f.write_str(&line)?;
        }
        Ok(())
    }
}

impl std::error::Error for ConfigError {}

/// The first of `found` in the order of `offset`, as many as are listed, and the number of the others.
pub(super) fn first<T>(mut found: Vec<T>, offset: impl Fn(&T) -> usize) -> (Vec<T>, usize) {
    found.sort_by_key(offset);
    let more = found.len().saturating_sub(TOLD);
    found.truncate(TOLD);
    (found, more)
}
