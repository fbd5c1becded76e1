//! From a document to its tables: what cannot be read is reported and set aside, so that the rest of the file can be checked.
//!
//! Each pass through the document sets aside all unknown keys of a table, or a known key whose value is wrong. There are few
//! tables and few known keys, so the number of passes does not grow with the file.

use super::problem::{Problem, first};
use super::source::Document;
use crate::input::{nearest, number};
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// Longest list that any key takes, so that a hostile one is reported once: the widest, taught points, has 64 entries of some numbers.
const LONGEST_LIST: usize = 256;

/// Reads the tables of a file; adds what is wrong to `problems`. Gives how many unknown keys there are beside those.
pub(super) fn read<T: DeserializeOwned + Default>(
    document: &mut Document,
    problems: &mut Vec<Problem>,
) -> (T, usize) {
    let mut more = set_long_lists_aside(document, problems);
    loop {
        let value = Value::Table(document.table.clone());
        let error = match serde_path_to_error::deserialize::<_, T>(value) {
            Ok(raw) => return (raw, more),
            Err(error) => error,
        };
        let path = error.path().to_string();
        let message = with_short_numbers(error.inner().message().trim());
        if let Some((field, expected)) = unknown_field(&message) {
            let table = if path == "." || path == field { "" } else { path.as_str() };
            let table = table.strip_suffix(&format!(".{field}")).unwrap_or(table);
            if let Some(untold) = set_unknown_aside(document, table, expected, problems) {
                more += untold;
                continue;
            }
        }
        problems.push(document.problem(&path, message));
        if !document.remove(&path) {
            return (T::default(), more); // nothing left to set aside: the problem itself is reported
        }
    }
}

/// The message with a floating point number as people write it.
fn with_short_numbers(message: &str) -> String {
    const FOUND: &str = "invalid type: floating point `";
    let short = message.strip_prefix(FOUND).and_then(|rest| {
        let (value, rest) = rest.split_once('`')?;
        Some(format!("{FOUND}{}`{rest}", number(value.parse().ok()?)))
    });
    short.unwrap_or_else(|| message.to_string())
}

/// The field, and the words behind `expected` in the message.
fn unknown_field(message: &str) -> Option<(&str, &str)> {
    let rest = message.strip_prefix("unknown field `")?;
    rest.rsplit_once("`, expected ") // the last one is serde's, whatever stands in the file
}

/// Takes every key out of `table` (empty: the root) that is not among the `expected` ones, which stand in backticks there.
/// Gives how many there are beside those that were added to `problems`; `None` where there is nothing to take.
fn set_unknown_aside(
    document: &mut Document,
    table: &str,
    expected: &str,
    problems: &mut Vec<Problem>,
) -> Option<usize> {
    let known: Vec<&str> = expected.split('`').skip(1).step_by(2).collect();
    let entries = inner_table(&mut document.table, table)?;
    let mut unknown = Vec::new();
    entries.retain(|key, _| {
        let is_known = known.contains(&key);
        if !is_known {
            unknown.push(key.to_string());
        }
        is_known
    });
    if unknown.is_empty() {
        return None;
    }
    let path = |field: &String| if table.is_empty() { field.clone() } else { format!("{table}.{field}") };
    let (told, more) = first(unknown, |field| document.offset(&path(field)));
    problems.extend(told.iter().map(|field| {
        let meant = meant(field, &known).map_or(String::new(), |key| format!("; did you mean `{key}`?"));
        document.problem(&path(field), format!("unknown field `{field}`, expected {expected}{meant}"))
    }));
    Some(more)
}

/// The key that is most like `field`. People leave units out: `gain` is as much as `gain_1_s`.
fn meant<'a>(field: &str, known: &[&'a str]) -> Option<&'a str> {
    nearest(field, known.iter().copied()).or_else(|| {
        let begins =
            known.iter().flat_map(|key| key.match_indices('_').map(move |(at, _)| (&key[..at], *key)));
        let mut begins: Vec<_> = begins.collect();
        // of several with the same beginning, the one that has least beside it
        begins.sort_by_key(|(begin, key)| key.len() - begin.len());
        let begin = nearest(field, begins.iter().map(|(begin, _)| *begin))?;
        begins.iter().find(|(b, _)| *b == begin).map(|(_, key)| *key)
    })
}

fn inner_table<'a>(root: &'a mut Table, path: &str) -> Option<&'a mut Table> {
    path.split('.')
        .filter(|segment| !segment.is_empty())
        .try_fold(root, |table, segment| table.get_mut(segment)?.as_table_mut())
}

/// Takes out lists that no key could take, before anything walks through them entry by entry.
fn set_long_lists_aside(document: &mut Document, problems: &mut Vec<Problem>) -> usize {
    fn find(table: &Table, prefix: &str, found: &mut Vec<(String, usize)>) {
        for (key, value) in table {
            let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
            match value {
                Value::Table(inner) => find(inner, &path, found),
                Value::Array(list) if list.len() > LONGEST_LIST => found.push((path, list.len())),
                _ => {}
            }
        }
    }
    let mut found = Vec::new();
    find(&document.table, "", &mut found);
    for (path, _) in &found {
        document.remove(path);
    }
    let (told, more) = first(found, |(path, _)| document.offset(path));
    for (path, length) in told {
        problems.push(
            document.problem(&path, format!("has {length} entries, at most {LONGEST_LIST} are allowed")),
        );
    }
    more
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_key_that_was_meant_is_found_without_its_unit() {
        let known = ["gain_1_s", "gain_at_goal_1_s", "calm_gain_1_s", "scheme", "depth_m"];
        for (field, wanted) in [
            ("gainn", Some("gain_1_s")),
            ("gain", Some("gain_1_s")),
            ("schem", Some("scheme")),
            ("gain_1s", Some("gain_1_s")),
            ("depth", Some("depth_m")),
            ("colour", None),
        ] {
            assert_eq!(meant(field, &known), wanted, "{field}");
        }
    }
}
