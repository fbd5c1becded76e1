//! Where each value of a configuration stands: file, line and column, or the `--set` argument it came from.

use std::collections::HashMap;
use std::fmt;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// One thing that is wrong, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// `file:line:column`, or `--set key`, or the file alone.
    pub place: String,
    /// Dotted path of the key; empty for the file as a whole.
    pub key: String,
    /// What is wrong and what is allowed.
    pub message: String,
    /// Position in the file, for sorting.
    order: (usize, String),
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

/// Sorts problems into the order of the file.
pub(super) fn sort(problems: &mut [Problem]) {
    problems.sort_by(|a, b| a.order.cmp(&b.order));
}

/// A parsed document that remembers where each key stands.
#[derive(Debug, Clone)]
pub struct Document {
    /// The values.
    pub table: Table,
    name: String,
    places: HashMap<String, Place>,
}

#[derive(Debug, Clone)]
enum Place {
    File { line: usize, column: usize, offset: usize },
    Argument(String),
}

impl Document {
    /// Parses `text`; `name` is the file's name in messages.
    ///
    /// # Errors
    /// All syntax errors that the parser can tell apart.
    pub fn parse(name: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let (root, errors) = DeTable::parse_recoverable(text);
        if !errors.is_empty() {
            let problems = errors.iter().map(|e| {
                let offset = e.span().map_or(0, |s| s.start);
                let (line, column) = line_and_column(text, offset);
                let place = format!("{name}:{line}:{column}");
                let message = format!("not valid TOML: {}", e.message().replace('\n', ", "));
                Problem { place, key: String::new(), message, order: (offset, String::new()) }
            });
            let mut problems: Vec<Problem> = problems.collect();
            sort(&mut problems);
            return Err(problems);
        }
        let mut places = HashMap::new();
        walk("", root.get_ref(), text, &mut places);
        let table = text.parse::<Table>().map_err(|e| vec![Problem::of_file(name, e.to_string())])?;
        Ok(Self { table, name: name.into(), places })
    }

    /// Applies `--set key.path=value`. A value that is not TOML counts as text, so that paths and words need no quotes.
    ///
    /// # Errors
    /// An argument without `=` or with an empty key, or a path that leads through a value that is no table.
    pub fn set(&mut self, argument: &str) -> Result<(), Problem> {
        let wrong = |key: &str, message: &str| Problem {
            place: format!("--set {argument}"),
            key: key.into(),
            message: message.into(),
            order: (usize::MAX, key.into()),
        };
        let Some((key, text)) = argument.split_once('=') else {
            return Err(wrong("", "expected key.path=value, for example servo.gain_1_s=3"));
        };
        let key = key.trim();
        let segments: Vec<&str> = key.split('.').collect();
        if segments.iter().any(|s| s.is_empty()) {
            return Err(wrong(key, "a key is empty; expected key.path=value, for example servo.gain_1_s=3"));
        }
        let value = format!("value = {}", text.trim())
            .parse::<Table>()
            .ok()
            .and_then(|mut t| t.remove("value"))
            .unwrap_or_else(|| Value::String(text.trim().into()));
        let (last, tables) = segments.split_last().unwrap_or((&key, &[]));
        let mut table = &mut self.table;
        for segment in tables {
            let entry = table.entry(*segment).or_insert_with(|| Value::Table(Table::new()));
            let Value::Table(inner) = entry else {
                return Err(wrong(key, &format!("`{segment}` is a value, not a table")));
            };
            table = inner;
        }
        table.insert((*last).into(), value);
        self.places.insert(key.into(), Place::Argument(argument.into()));
        Ok(())
    }

    /// A problem with the value at `key`. Where that key is not written (a default), the nearest table above it.
    #[must_use]
    pub fn problem(&self, key: &str, message: impl Into<String>) -> Problem {
        let mut at = key;
        let place = loop {
            if let Some(place) = self.places.get(at) {
                break Some(place);
            }
            match at.rfind(['.', '[']) {
                Some(end) => at = &at[..end],
                None => break None,
            }
        };
        let (place, offset) = match place {
            Some(Place::File { line, column, offset }) => (format!("{}:{line}:{column}", self.name), *offset),
            Some(Place::Argument(argument)) => (format!("--set {argument}"), usize::MAX),
            None => (self.name.clone(), 0),
        };
        Problem { place, key: key.into(), message: message.into(), order: (offset, key.into()) }
    }

    /// Takes the value at `key` out of the document, so that the rest of it can be read; false when it is not there.
    pub fn remove(&mut self, key: &str) -> bool {
        fn take(value: &mut Value, segments: &[&str]) -> bool {
            match (segments, value) {
                ([last], Value::Table(t)) => t.remove(*last).is_some(),
                ([first, rest @ ..], Value::Table(t)) => {
                    // A wrong entry of a list spoils the list: the whole of it goes.
                    let (name, is_entry) = first.split_once('[').map_or((*first, false), |(n, _)| (n, true));
                    if is_entry {
                        return t.remove(name).is_some();
                    }
                    t.get_mut(name).is_some_and(|inner| take(inner, rest))
                }
                _ => false,
            }
        }
        let mut segments: Vec<&str> = key.split('.').collect();
        if let Some(last) = segments.last_mut() {
            *last = last.split('[').next().unwrap_or(last);
        }
        let mut root = Value::Table(std::mem::take(&mut self.table));
        let removed = take(&mut root, &segments);
        if let Value::Table(table) = root {
            self.table = table;
        }
        removed
    }

    /// Whether a `--set` argument gave the value at `key`.
    #[must_use]
    pub fn is_argument(&self, key: &str) -> bool {
        matches!(self.places.get(key), Some(Place::Argument(_)))
    }
}

fn walk(prefix: &str, table: &DeTable<'_>, text: &str, places: &mut HashMap<String, Place>) {
    for (key, value) in table {
        let path =
            if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
        remember(path.clone(), key.span().start, text, places);
        walk_value(&path, value, text, places);
    }
}

fn walk_value(path: &str, value: &Spanned<DeValue<'_>>, text: &str, places: &mut HashMap<String, Place>) {
    match value.get_ref() {
        DeValue::Table(inner) => walk(path, inner, text, places),
        DeValue::Array(entries) => {
            for (i, entry) in entries.iter().enumerate() {
                let path = format!("{path}[{i}]");
                remember(path.clone(), entry.span().start, text, places);
                walk_value(&path, entry, text, places);
            }
        }
        _ => {}
    }
}

fn remember(path: String, offset: usize, text: &str, places: &mut HashMap<String, Place>) {
    let (line, column) = line_and_column(text, offset);
    places.insert(path, Place::File { line, column, offset });
}

/// Line and column, both from 1, of a byte offset; columns count characters.
fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = text.get(..offset).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |i| i + 1);
    (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_has_its_place() {
        let d = Document::parse("a.toml", "[run]\nseed = 3\n[x]\nlist = [1,\n  2]\n").unwrap();
        assert_eq!(d.problem("run.seed", "no").to_string(), "a.toml:2:1: run.seed: no");
        assert_eq!(d.problem("x.list[1]", "no").place, "a.toml:5:3");
        assert_eq!(d.problem("run.clock", "no").place, "a.toml:1:2", "a default points to its table");
        assert_eq!(d.problem("goal.hold_s", "no").place, "a.toml");
    }

    #[test]
    fn set_overrides_and_creates() {
        let mut d = Document::parse("a.toml", "[run]\nseed = 3\n").unwrap();
        d.set("run.seed=4").unwrap();
        d.set("servo.update = frame").unwrap();
        d.set("camera.lens.fx_px=7.5").unwrap();
        assert_eq!(d.table["run"]["seed"].as_integer(), Some(4));
        assert_eq!(d.table["servo"]["update"].as_str(), Some("frame"));
        assert_eq!(d.table["camera"]["lens"]["fx_px"].as_float(), Some(7.5));
        assert_eq!(d.problem("run.seed", "no").place, "--set run.seed=4");
    }

    #[test]
    fn bad_set_arguments_are_explained() {
        let mut d = Document::parse("a.toml", "[run]\nseed = 3\n").unwrap();
        for bad in ["run.seed", "=3", "run..seed=3", "run.seed.x=3"] {
            assert!(d.set(bad).unwrap_err().place.starts_with("--set"), "{bad}");
        }
    }

    #[test]
    fn syntax_errors_are_all_found() {
        let problems = Document::parse("a.toml", "a = \nb = 1\nc = [1\n").unwrap_err();
        assert!(problems.len() >= 2, "{problems:?}");
        assert!(problems[0].place.starts_with("a.toml:1:"));
    }

    #[test]
    fn removing_a_list_entry_removes_the_list() {
        let mut d = Document::parse("a.toml", "[x]\nlist = [1, 'two']\nkeep = 1\n").unwrap();
        assert!(d.remove("x.list[1]"));
        assert!(d.table["x"].get("list").is_none());
        assert!(d.table["x"].get("keep").is_some());
        assert!(!d.remove("x.absent"));
    }
}
