//! Suites: what a benchmark file says, and that it can be meant.

use super::BenchmarkError;
use crate::config::{Config, ConfigError, Draft, ShippedFile};
use crate::input::{nearest, number};
use crate::linalg::Random;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml::Value;

/// The suites that come with the program: name and text.
pub const SHIPPED_SUITES: [(&str, &str); 2] = [
    ("short", include_str!("../../../../config/benchmark/short.toml")),
    ("full", include_str!("../../../../config/benchmark/full.toml")),
];

/// Most runs of a suite. Chosen by hand: a night of two cores, at some ten runs a second.
const MAX_RUNS: usize = 200_000;
/// Most values of one `each`, cases of one task, and starts of one case. Chosen by hand: above what a page can show.
const MAX_EACH: usize = 64;
const MAX_CASES: usize = 256;
const MAX_COUNT: u32 = 10_000;
/// Longest simulated run, s. Chosen by hand, and the longest that `goal.hold_s` takes: six-joint arms settle within two.
const MAX_DURATION_S: f64 = 60.0;
/// Largest names, letters. Chosen by hand: they stand in tables.
const MAX_NAME: usize = 40;

/// Where a start is, and what is believed wrongly: names with the least and the greatest value that anybody can mean, chosen by hand, each because of what stands
/// above it.
const START: [(&str, (f64, f64)); 5] = [
    // half a turn either way is every rotation about the optical axis
    ("roll_deg", (-180.0, 180.0)),
    // an edge-on target shows nothing
    ("tilt_deg", (-85.0, 85.0)),
    // beyond the reach of every shipped arm
    ("aside_m", (0.0, 2.0)),
    ("ahead_m", (-2.0, 2.0)),
    // half a turn of a joint is no neighbourhood of its end
    ("near_limit_rad_or_m", (1e-3, 3.0)),
];
/// The same of what is believed, chosen likewise.
const BELIEVED: [(&str, (f64, f64)); 5] = [
    // beyond these factors an image shows nothing of the cell that is believed
    ("focal_times", (0.1, 10.0)),
    // half a large image
    ("centre_off_px", (0.0, 1000.0)),
    ("mount_turn_deg", (0.0, 180.0)),
    ("mount_off_m", (0.0, 1.0)),
    // depth follows the size of the target
    ("size_times", (0.05, 20.0)),
];
/// Keys of a run file that are the world's, that all laws are told, and that are the law's own, by how they begin: chosen so that no law changes the world.
const WORLD: [&str; 9] =
    ["scene.", "camera.", "drive.", "robot.", "target.", "tool.", "vision.", "motion.", "faults"];
const ASKED: [&str; 4] = ["goal.", "servo.", "safety.", "vision."];
const LAW: [&str; 2] = ["servo.", "motion."];

/// A value of a task: one, one drawn evenly, or each of a list.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "Value")]
pub enum BenchmarkValue {
    /// This one.
    Fixed(Value),
    /// `{ from = .., to = .. }`: drawn for each start, evenly.
    Between(f64, f64),
    /// `{ each = [..] }`: a case for each.
    Each(Vec<Value>),
}

impl TryFrom<Value> for BenchmarkValue {
    type Error = String;

    fn try_from(value: Value) -> Result<Self, String> {
        let Value::Table(table) = &value else { return Ok(Self::Fixed(value)) };
        let end = |key: &str| table.get(key).and_then(float);
        match (end("from"), end("to"), table.get("each")) {
            (Some(from), Some(to), None) if table.len() == 2 => {
                let is_range = from.is_finite() && to.is_finite() && from <= to;
                let wrong =
                    || format!("{{ from = {from}, to = {to} }} is no range: `from` must not be above `to`");
                is_range.then_some(Self::Between(from, to)).ok_or_else(wrong)
            }
            (None, None, Some(Value::Array(each)))
                if table.len() == 1 && (1..=MAX_EACH).contains(&each.len()) =>
            {
                Ok(Self::Each(each.clone()))
            }
            _ => Err(format!(
                "expected a value, {{ from = LOW, to = HIGH }} or {{ each = [..] }} with 1 to {MAX_EACH} values"
            )),
        }
    }
}

/// A number, whole or not.
pub(super) fn float(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}

impl BenchmarkValue {
    /// All that it names: the ends of a range.
    fn named(&self) -> Vec<Value> {
        match self {
            Self::Fixed(value) => vec![value.clone()],
            Self::Between(from, to) => vec![Value::Float(*from), Value::Float(*to)],
            Self::Each(values) => values.clone(),
        }
    }
}

/// Values by their names.
pub type BenchmarkValues = BTreeMap<String, BenchmarkValue>;

/// By what laws are compared that bring equally many starts home.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BenchmarkScore {
    /// By the share alone.
    Converged,
    /// Settling time.
    Settling,
    /// Path excess in the image.
    ImagePath,
    /// Path excess in space.
    SpacePath,
    /// Least image margin.
    Margin,
    /// Final error.
    FinalError,
    /// Energy.
    Energy,
}

/// A law that takes part.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkLaw {
    /// What it is called.
    pub name: String,
    /// What it is.
    pub about: String,
    /// Its `--set` values.
    pub set: BTreeMap<String, Value>,
}

/// A task.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkTask {
    /// What it is called.
    pub name: String,
    /// What it asks.
    pub about: String,
    /// Shipped run file, or one beside the suite's file, from which it starts.
    pub file: String,
    /// Starts of each case.
    pub count: u32,
    /// By what laws are compared.
    pub score: BenchmarkScore,
    /// Latest end of a run, s.
    #[serde(default = "usual_duration_s")]
    pub duration_s: f64,
    /// At the goal is who is this near in the image, px, true root mean square over the points,
    #[serde(default = "usual_tolerance_px")]
    pub tolerance_px: f64,
    /// and stays so for this long, s.
    #[serde(default = "usual_hold_s")]
    pub hold_s: f64,
    /// Where the camera starts, against the goal; empty: as the run file says.
    #[serde(default)]
    pub start: BenchmarkValues,
    /// Keys of the run file that are true, and known.
    #[serde(default)]
    pub world: BenchmarkValues,
    /// What is believed wrongly; the goal is then one that was shown.
    #[serde(default)]
    pub believed: BenchmarkValues,
    /// Keys of the run file that every law is told.
    #[serde(default)]
    pub asked: BenchmarkValues,
}

// Chosen by hand: ten times what velocity laws take on the shipped arms; ten times the noise of four dots there and more; the time in which the default gain
// near the goal, 2 1/s, lets an error fall to a seventh.
fn usual_duration_s() -> f64 {
    12.0
}
fn usual_tolerance_px() -> f64 {
    1.0
}
fn usual_hold_s() -> f64 {
    1.0
}

/// A suite of tasks, and the laws that take part.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkSuite {
    /// What it is.
    pub about: String,
    /// Of every random number.
    pub seed: u64,
    /// The laws.
    pub laws: Vec<BenchmarkLaw>,
    /// The tasks.
    pub tasks: Vec<BenchmarkTask>,
    /// Name or file, for messages.
    #[serde(skip)]
    pub name: String,
    /// From where run files are named.
    #[serde(skip)]
    pub folder: PathBuf,
}

/// One start of one case of a task, by their numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BenchmarkPlace {
    /// Which task.
    pub task: usize,
    /// Which of its cases.
    pub case: usize,
    /// Which start.
    pub start: u32,
}

/// The values of `each` in a case, by table and name.
pub(super) type BenchmarkCase = BTreeMap<(&'static str, String), Value>;

impl BenchmarkTask {
    fn tables(&self) -> [(&'static str, &BenchmarkValues); 4] {
        [("start", &self.start), ("world", &self.world), ("believed", &self.believed), ("asked", &self.asked)]
    }

    /// Every combination of the values of `each`.
    pub(super) fn cases(&self) -> Vec<BenchmarkCase> {
        let mut cases = vec![BenchmarkCase::new()];
        for (table, spreads) in self.tables() {
            for (name, spread) in spreads {
                let BenchmarkValue::Each(values) = spread else { continue };
                let with = |case: &BenchmarkCase, value: &Value| {
                    let mut case = case.clone();
                    case.insert((table, name.clone()), value.clone());
                    case
                };
                cases = cases
                    .iter()
                    .flat_map(|case| values.iter().map(|v| with(case, v)).collect::<Vec<_>>())
                    .collect();
            }
        }
        cases
    }

    /// The values of one table in `case`; ranges are drawn.
    pub(super) fn drawn(
        &self,
        table: &'static str,
        case: &BenchmarkCase,
        random: &mut Random,
    ) -> BTreeMap<String, Value> {
        let spreads = self.tables().into_iter().find(|(name, _)| *name == table).map(|(_, spreads)| spreads);
        let value = |(name, spread): (&String, &BenchmarkValue)| {
            let value = match spread {
                BenchmarkValue::Fixed(value) => value.clone(),
                BenchmarkValue::Between(from, to) => Value::Float(random.between(*from, *to)),
                BenchmarkValue::Each(_) => case.get(&(table, name.clone()))?.clone(),
            };
            Some((name.clone(), value))
        };
        spreads.into_iter().flatten().filter_map(value).collect()
    }

    fn check(&self) -> Result<(), String> {
        let within = |what: &str, value: f64, low: f64, high: f64| {
            let good = value >= low && value <= high;
            good.then_some(()).ok_or_else(|| {
                format!("{what} = {}: must be {} to {}", number(value), number(low), number(high))
            })
        };
        within("count", f64::from(self.count), 1.0, f64::from(MAX_COUNT))?;
        within("duration_s", self.duration_s, 0.1, MAX_DURATION_S)?;
        // finer than the rounding of an image, coarser than an image is wide
        within("tolerance_px", self.tolerance_px, 1e-3, 1e3)?;
        within("hold_s", self.hold_s, 0.0, self.duration_s)?;
        for (table, spreads, known) in [("start", &self.start, START), ("believed", &self.believed, BELIEVED)]
        {
            for (name, spread) in spreads {
                let Some((_, (low, high))) = known.iter().find(|(known, _)| known == name) else {
                    let meant = nearest(name, known.iter().map(|(name, _)| *name));
                    let all = known.map(|(name, _)| name).join(", ");
                    let meant = meant.map_or(String::new(), |meant| format!("; did you mean `{meant}`?"));
                    return Err(format!("{table}.{name}: there is no such value, but {all}{meant}"));
                };
                for value in spread.named() {
                    let value =
                        float(&value).ok_or_else(|| format!("{table}.{name}: {value} is no number"))?;
                    within(&format!("{table}.{name}"), value, *low, *high)?;
                }
            }
        }
        keys("world", self.world.keys(), &WORLD)?;
        keys("asked", self.asked.keys(), &ASKED)?;
        let cases: usize = self.tables().iter().flat_map(|(_, spreads)| spreads.values()).fold(
            1,
            |n, spread| match spread {
                BenchmarkValue::Each(values) => n.saturating_mul(values.len()),
                _ => n,
            },
        );
        within("cases", cases as f64, 1.0, MAX_CASES as f64)
    }
}

/// Whether the keys are of those that may stand in this table.
fn keys<'a>(table: &str, keys: impl Iterator<Item = &'a String>, begin: &[&str]) -> Result<(), String> {
    for key in keys {
        if !begin.iter().any(|begin| key.starts_with(begin)) {
            return Err(format!(
                "{table}: `{key}` is none of its keys, which begin with {}",
                begin.join(", ")
            ));
        }
    }
    Ok(())
}

/// `key=value` for each, as `--set` takes them.
pub(super) fn settings<'a>(values: impl IntoIterator<Item = (&'a String, &'a Value)>) -> Vec<String> {
    values.into_iter().map(|(key, value)| format!("{key}={value}")).collect()
}

impl BenchmarkSuite {
    /// The shipped suite of this name.
    #[must_use]
    pub fn shipped(name: &str) -> Option<&'static str> {
        SHIPPED_SUITES.iter().find(|(shipped, _)| *shipped == name).map(|(_, text)| *text)
    }

    /// Reads a suite from its text; run files that it names and that do not come with the program are looked for in `folder`.
    ///
    /// # Errors
    /// [`BenchmarkError::Suite`] where it says what nobody can mean.
    pub fn parse(name: &str, text: &str, folder: &Path) -> Result<Self, BenchmarkError> {
        let wrong = |cause: String| BenchmarkError::Suite { suite: name.into(), cause };
        let suite: Self = toml::from_str(text).map_err(|e| wrong(e.to_string().trim_end().to_owned()))?;
        let suite = Self { name: name.into(), folder: folder.into(), ..suite };
        suite.check().map_err(wrong)?;
        Ok(suite)
    }

    fn check(&self) -> Result<(), String> {
        if self.laws.is_empty() || self.tasks.is_empty() {
            return Err(
                "a suite needs [[laws]] and [[tasks]]: `vservo benchmark --print short` shows one".into()
            );
        }
        names("law", self.laws.iter().map(|law| &law.name))?;
        names("task", self.tasks.iter().map(|task| &task.name))?;
        for law in &self.laws {
            keys("set", law.set.keys(), &LAW).map_err(|cause| format!("law `{}`: {cause}", law.name))?;
        }
        for task in &self.tasks {
            task.check().map_err(|cause| format!("task `{}`: {cause}", task.name))?;
        }
        let runs = self.places().len().saturating_mul(self.laws.len());
        if runs > MAX_RUNS {
            return Err(format!(
                "{runs} runs are more than {MAX_RUNS}: lower `count`, or leave out values of `each`"
            ));
        }
        Ok(())
    }

    /// The suite with the laws of these names alone.
    ///
    /// # Errors
    /// [`BenchmarkError::Suite`] where it has none of a name.
    pub fn with_laws(self, wanted: &[String]) -> Result<Self, BenchmarkError> {
        let known: Vec<&str> = self.laws.iter().map(|law| law.name.as_str()).collect();
        if let Some(name) = wanted.iter().find(|name| !known.contains(&name.as_str())) {
            let cause = format!("there is no law `{name}`; choose of {}", known.join(", "));
            return Err(BenchmarkError::Suite { suite: self.name, cause });
        }
        let laws =
            self.laws.into_iter().filter(|law| wanted.is_empty() || wanted.contains(&law.name)).collect();
        Ok(Self { laws, ..self })
    }

    /// Every start of every case of every task, in order.
    #[must_use]
    pub fn places(&self) -> Vec<BenchmarkPlace> {
        let of_task = |(task, entry): (usize, &BenchmarkTask)| {
            let (cases, count) = (entry.cases().len(), entry.count);
            (0..cases).flat_map(move |case| (0..count).map(move |start| BenchmarkPlace { task, case, start }))
        };
        self.tasks.iter().enumerate().flat_map(of_task).collect()
    }

    /// The run file of `task` with `set`, whatever is seen at its start where `views` is false.
    pub(super) fn config(
        &self,
        task: &BenchmarkTask,
        set: &[String],
        views: bool,
    ) -> Result<Config, ConfigError> {
        let draft = match ShippedFile::find(&task.file) {
            Some(shipped) => Draft::parse(shipped.name, shipped.text, Path::new("."), set)?,
            None => Draft::load(Some(&self.folder.join(&task.file)), set)?,
        };
        if views { draft.validate() } else { draft.validate_whatever_is_seen() }
    }
}

/// Whether the names of laws and entrants can stand beside each other.
///
/// # Errors
/// Which cannot, and why.
pub fn checked_names<'a>(all: impl Iterator<Item = &'a String>) -> Result<(), String> {
    names("law or entrant", all)
}

/// Names stand in tables and in answers to `--law`: of each kind once, and short words.
fn names<'a>(what: &str, all: impl Iterator<Item = &'a String>) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for name in all {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || name.len() > MAX_NAME || !name.chars().all(good) {
            return Err(format!("{what} `{name}`: a name is of 1 to {MAX_NAME} letters, digits, - and _"));
        }
        if !seen.insert(name) {
            return Err(format!("{what} `{name}`: stands there twice"));
        }
    }
    Ok(())
}
