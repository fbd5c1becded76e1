//! One word for one thing: type names, and the names of tests.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Every Rust file below `folder` of the project with its text.
fn sources(folder: &str) -> Vec<(PathBuf, String)> {
    let (root, mut found, mut folders) = (Path::new(env!("CARGO_MANIFEST_DIR")), Vec::new(), Vec::new());
    folders.push(root.join(folder));
    while let Some(folder) = folders.pop() {
        for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                found.push((path.strip_prefix(root).unwrap().to_owned(), text));
            }
        }
    }
    found.sort();
    found
}

fn indent(line: &str) -> usize {
    line.len() - line.trim_start().len()
}

/// Whether line `at` stands in a block that an `impl` or a `trait` opens: a `type` there is an associated one.
fn is_associated(lines: &[&str], at: usize) -> bool {
    let outer = |line: &&&str| !line.trim().is_empty() && indent(line) < indent(lines[at]);
    let opening = |line: &&str| !["{", "where"].contains(&line.trim());
    let opens = lines[..at].iter().rev().filter(outer).copied().find(opening);
    opens.is_some_and(|line| line.split([' ', '<']).any(|word| word == "impl" || word == "trait"))
}

/// The name of the type that a line defines.
fn defined_type(line: &str) -> Option<(&str, &str)> {
    let line = line.trim_start();
    let line = match line.strip_prefix("pub(") {
        Some(rest) => rest.split_once(") ")?.1,
        None => line.strip_prefix("pub ").unwrap_or(line),
    };
    let mut words = line.split(|c: char| !(c.is_alphanumeric() || c == '_'));
    let (keyword, name) = (words.next()?, words.next()?);
    let defines = ["struct", "enum", "trait", "union", "type"].contains(&keyword);
    (defines && name.starts_with(char::is_uppercase)).then_some((keyword, name))
}

#[test]
fn no_type_name_appears_twice() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (path, text) in sources("src") {
        let lines: Vec<&str> = text.lines().collect();
        for (at, line) in lines.iter().enumerate() {
            if let Some((keyword, name)) = defined_type(line)
                && !(keyword == "type" && is_associated(&lines, at))
            {
                places.entry(name.into()).or_default().push(format!("{}:{}", path.display(), at + 1));
            }
        }
    }
    assert!(places.len() > 1000, "the types were found: {}", places.len());
    places.retain(|_, at| at.len() > 1);
    assert!(places.is_empty(), "one word, one thing: {places:#?}");
}

/// The property, in words that fit a line of a test's report.
#[test]
fn test_names_have_at_most_60_letters() {
    let (mut count, mut long) = (0, Vec::new());
    for (path, text) in ["src", "tests"].iter().flat_map(|folder| sources(folder)) {
        let mut is_test = false;
        for line in text.lines().map(str::trim_start) {
            is_test |= line == "#[test]";
            if let Some(rest) = line.strip_prefix("fn ").filter(|_| is_test) {
                let name = rest.split(['(', '<']).next().unwrap_or(rest);
                count += 1;
                is_test = false;
                if name.len() > 60 {
                    long.push(format!("{}: {name}, {}", path.display(), name.len()));
                }
            }
        }
    }
    assert!(count > 1000, "the tests were found: {count}");
    assert!(long.is_empty(), "over 60 letters: {long:#?}");
}
