//! Position of each value of a configuration: file, line and column, or the `--set` argument it came from.

use super::problem::{ConfigError, Problem, first};
use std::collections::HashMap;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// Most parts that a key of `--set` may have, so that no depth can overflow the stack: far more than any key has.
const DEEPEST_KEY: usize = 16;
/// Entries of a list whose positions are remembered; for later ones that of the list is reported. Chosen by hand, above the lists of run files.
const PLACED_ENTRIES: usize = 64;

/// A parsed document that remembers where each key stands.
#[derive(Debug, Clone)]
pub struct Document {
    /// The values.
    pub table: Table,
    name: String,
    lines: LineIndex,
    places: HashMap<String, ValueOrigin>,
}

#[derive(Debug, Clone)]
enum ValueOrigin {
    File { offset: usize },
    Argument(String),
}

/// Whether the key `place` lies below `key`.
fn is_below(place: &str, key: &str) -> bool {
    place.strip_prefix(key).is_some_and(|rest| rest.starts_with(['.', '[']))
}

/// The value at a part of a key, with a place in a list as in `cameras[1]`; an empty table where nothing is written.
fn at_segment<'a>(table: &'a mut Table, segment: &str) -> Result<&'a mut Value, String> {
    let Some((name, place)) = segment.split_once('[') else {
        return Ok(table.entry(segment).or_insert_with(|| Value::Table(Table::new())));
    };
    let place = place.strip_suffix(']').and_then(|place| place.parse::<usize>().ok());
    let place =
        place.ok_or_else(|| format!("`{segment}` names no place; write one as in cameras[1].id=4"))?;
    let Some(Value::Array(list)) = table.get_mut(name) else {
        return Err(format!("`{name}` is no list in this run file"));
    };
    let count = list.len();
    list.get_mut(place).ok_or_else(|| format!("`{name}` has {count} entries, counted from 0"))
}

impl Document {
    /// Parses `text`; `name` is the file's name in messages.
    ///
    /// # Errors
    /// The syntax errors that the parser can distinguish.
    pub fn parse(name: &str, text: &str) -> Result<Self, ConfigError> {
        let lines = LineIndex::new(text);
        let (root, errors) = DeTable::parse_recoverable(text);
        if !errors.is_empty() {
            let offset = |e: &toml::de::Error| e.span().map_or(0, |s| s.start);
            let (errors, more) = first(errors, offset);
            let problems = errors.iter().map(|e| {
                let place = format!("{name}:{}", lines.place(offset(e)));
                let message = format!("not valid TOML: {}", e.message().replace('\n', ", "));
                Problem { place, key: String::new(), message, order: (offset(e), String::new()) }
            });
            return Err(ConfigError::new(problems.collect(), more));
        }
        let mut places = HashMap::new();
        walk("", root.get_ref(), &mut places);
        let whole = |e: toml::de::Error| ConfigError::new(vec![Problem::of_file(name, e.to_string())], 0);
        let table = text.parse::<Table>().map_err(whole)?;
        Ok(Self { table, name: name.into(), lines, places })
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
        if segments.len() > DEEPEST_KEY {
            return Err(wrong("", &format!("a key has at most {DEEPEST_KEY} parts")));
        }
        let value = format!("value = {}", text.trim())
            .parse::<Table>()
            .ok()
            .and_then(|mut t| t.remove("value"))
            .unwrap_or_else(|| Value::String(text.trim().into()));
        let (last, tables) = segments.split_last().unwrap_or((&key, &[]));
        let mut table = &mut self.table;
        for segment in tables {
            let inner = at_segment(table, segment).map_err(|message| wrong(key, &message))?;
            let Value::Table(inner) = inner else {
                return Err(wrong(key, &format!("`{segment}` is a value, not a table")));
            };
            table = inner;
        }
        *at_segment(table, last).map_err(|message| wrong(key, &message))? = value;
        // What the file had below this key is gone.
        self.places.retain(|place, _| !is_below(place, key));
        self.places.insert(key.into(), ValueOrigin::Argument(argument.into()));
        Ok(())
    }

    /// Renames the value at `table.old` to `new`. Returns the warning about it. A file with both keeps both, of which one is unknown; an
    /// argument counts.
    pub fn rename(&mut self, table: &str, old: &str, new: &str) -> Option<Problem> {
        let counts = self.is_argument(&format!("{table}.{old}"));
        let Some(Value::Table(entries)) = self.table.get_mut(table) else { return None };
        if entries.contains_key(new) && !counts {
            return None;
        }
        let value = entries.remove(old)?;
        entries.insert(new.into(), value);
        let message =
            format!("this key is called {table}.{new} now; the old name goes with the next version");
        let problem = self.problem(&format!("{table}.{old}"), message);
        if let Some(place) = self.places.remove(&format!("{table}.{old}")) {
            self.places.insert(format!("{table}.{new}"), place);
        }
        Some(problem)
    }

    /// A problem with the value at `key`. Where that key is not written (a default), the nearest table above it.
    #[must_use]
    pub fn problem(&self, key: &str, message: impl Into<String>) -> Problem {
        // A table that the file does not have, of which an argument sets a key.
        let set_below = || {
            let mut below = self.places.iter().filter(|(place, _)| is_below(place, key));
            below.next().filter(|(_, origin)| matches!(origin, ValueOrigin::Argument(_)))
        };
        let mut at = key;
        let place = loop {
            let own = self.places.get(at);
            if let Some(place) = own.or_else(|| set_below().map(|(_, place)| place)) {
                break Some(place);
            }
            match at.rfind(['.', '[']) {
                Some(end) => at = &at[..end],
                None => break None,
            }
        };
        let (place, offset) = match place {
            Some(ValueOrigin::File { offset }) => {
                (format!("{}:{}", self.name, self.lines.place(*offset)), *offset)
            }
            Some(ValueOrigin::Argument(argument)) => (format!("--set {argument}"), usize::MAX),
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
                    // A wrong entry of a list invalidates the list: all of it is removed.
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

    /// The value at `key`, with places of lists as in `cameras[1].mount`, where it is written.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&Value> {
        let mut at: Option<&Value> = None;
        for segment in key.split('.') {
            let (name, place) = segment.split_once('[').map_or((segment, None), |(n, p)| (n, Some(p)));
            let table = at.map_or(Some(&self.table), Value::as_table)?;
            let value = table.get(name)?;
            at = Some(match place {
                Some(place) => value.as_array()?.get(place.strip_suffix(']')?.parse::<usize>().ok()?)?,
                None => value,
            });
        }
        at
    }

    /// Where the value at `key` stands in the order of problems.
    pub(super) fn offset(&self, key: &str) -> usize {
        match self.places.get(key) {
            Some(ValueOrigin::File { offset }) => *offset,
            Some(ValueOrigin::Argument(_)) => usize::MAX,
            None => 0,
        }
    }

    /// Whether a `--set` argument gave the value at `key`.
    #[must_use]
    pub fn is_argument(&self, key: &str) -> bool {
        matches!(self.places.get(key), Some(ValueOrigin::Argument(_)))
    }
}

fn walk(prefix: &str, table: &DeTable<'_>, places: &mut HashMap<String, ValueOrigin>) {
    for (key, value) in table {
        let path =
            if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
        places.insert(path.clone(), ValueOrigin::File { offset: key.span().start });
        walk_value(&path, value, places);
    }
}

fn walk_value(path: &str, value: &Spanned<DeValue<'_>>, places: &mut HashMap<String, ValueOrigin>) {
    match value.get_ref() {
        DeValue::Table(inner) => walk(path, inner, places),
        DeValue::Array(entries) => {
            for (i, entry) in entries.iter().enumerate().take(PLACED_ENTRIES) {
                let path = format!("{path}[{i}]");
                places.insert(path.clone(), ValueOrigin::File { offset: entry.span().start });
                walk_value(&path, entry, places);
            }
        }
        _ => {}
    }
}

/// A text with the beginnings of its lines, so that no place is counted from the text's beginning.
#[derive(Debug, Clone)]
struct LineIndex {
    text: String,
    starts: Vec<usize>,
}

impl LineIndex {
    fn new(text: &str) -> Self {
        let starts = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        Self { text: text.into(), starts }
    }

    /// `line:column`, both from 1, of a byte offset; columns count characters.
    fn place(&self, offset: usize) -> String {
        let line = self.starts.partition_point(|start| *start <= offset);
        let start = self.starts.get(line.wrapping_sub(1)).copied().unwrap_or(0);
        let before = self.text.get(start..offset).unwrap_or("");
        format!("{line}:{}", before.chars().count() + 1)
    }
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
    fn entries_of_lists_are_set() {
        let text = "q = [1, 2]\n[[cameras]]\nid = 0\n[[cameras]]\nid = 1\nlens.fx_px = 5\n";
        let mut d = Document::parse("a.toml", text).unwrap();
        d.set("cameras[1].lens.fx_px=7.5").unwrap();
        d.set("cameras[0].mount.kind=fixed").unwrap();
        d.set("q[1]=9").unwrap();
        assert_eq!(d.get("cameras[1].lens.fx_px").unwrap().as_float(), Some(7.5));
        assert_eq!(d.get("cameras[1].id").unwrap().as_integer(), Some(1));
        assert_eq!(d.get("cameras[0].mount.kind").unwrap().as_str(), Some("fixed"));
        assert_eq!(d.table["q"].to_string(), "[1, 9]");
        assert!(d.is_argument("cameras[1].lens.fx_px") && !d.is_argument("cameras[1].id"));
        for (bad, why) in [
            ("cameras[2].id=1", "has 2 entries"),
            ("cameras[x].id=1", "names no place"),
            ("q[0].x=1", "is a value"),
            ("camera[0].id=1", "no list"),
        ] {
            assert!(d.set(bad).unwrap_err().message.contains(why), "{bad}");
        }
        assert!(d.get("camera").is_none());
    }

    #[test]
    fn what_an_argument_sets_is_told_of_the_argument() {
        let mut d = Document::parse("a.toml", "[run]\nseed = 3\nlist = [1, 2]\n[scene]\na = 1\n").unwrap();
        d.set("run.list=[7, 8]").unwrap();
        d.set("scene.tool.mass_kg=2").unwrap();
        assert_eq!(
            d.problem("run.list[1]", "no").place,
            "--set run.list=[7, 8]",
            "of a list that the file had"
        );
        assert_eq!(
            d.problem("scene.tool", "no").place,
            "--set scene.tool.mass_kg=2",
            "of a table that it has not"
        );
        assert_eq!(d.problem("scene.a", "no").place, "a.toml:5:1");
        assert_eq!(d.problem("scene.b", "no").place, "a.toml:4:2");
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
        let problems = Document::parse("a.toml", "a = \nb = 1\nc = [1\n").unwrap_err().problems;
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
