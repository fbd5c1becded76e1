//! Pure modules stay pure: they use neither the operating system's modules nor its clocks, files, threads or sockets.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const OS: [&str; 7] = ["cli", "client", "experiment", "ipc", "process", "rt", "source"];
/// Reading files at start is the business of these.
const LOADERS: [&str; 3] = ["config", "input", "robot"];

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// The path of a module: `["servo", "view"]`. The crates below show their modules under the name of the whole.
fn module_path(path: &Path, src: &Path) -> Vec<String> {
    let parts = path.strip_prefix(src).unwrap().with_extension("");
    let crates = usize::from(parts.starts_with("core") || parts.starts_with("perception"));
    let parts = parts.iter().skip(crates).map(|p| p.to_string_lossy().into_owned());
    parts.filter(|p| p != "mod" && p != "lib").collect()
}

fn module_of(path: &Path, src: &Path) -> String {
    module_path(path, src).into_iter().next().unwrap_or("lib".into())
}

/// The code without comments and without the test module at the end; one in a file of its own ends nothing.
fn code(text: &str) -> String {
    let (test, opens) =
        ("#[cfg(test)]\nmod ", |at: usize| text[at..].lines().nth(1).is_some_and(|l| l.ends_with('{')));
    let body = text.match_indices(test).find(|(at, _)| opens(*at)).map_or(text, |(at, _)| &text[..at]);
    body.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

#[test]
fn pure_modules_do_not_touch_the_operating_system() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    files(&src, &mut found);
    assert!(found.len() > 40, "the sources were found");
    let mut violations = Vec::new();
    let mut pure = 0;
    for path in found {
        let module = module_of(&path, &src);
        if OS.contains(&module.as_str()) || module == "lib" {
            continue;
        }
        pure += 1;
        let code = code(&std::fs::read_to_string(&path).unwrap());
        // `use crate::{rt::now, ...}` hides a module from the search for `crate::rt`: one path a line, as everywhere.
        let mut forbidden: Vec<String> = OS.iter().map(|m| format!("crate::{m}")).collect();
        forbidden.push("crate::{".into());
        // The transport is the business of `ipc`; the records that travel derive the mark that lets them.
        let transport =
            if module == "messages" || module == "time" { "iceoryx2::prelude::*" } else { "iceoryx2" };
        forbidden.push(transport.into());
        // Control leaves a trace, which mission and report read; what is planned, and what was recorded, is none of its business.
        if ["control", "drive", "servo", "motion"].contains(&module.as_str()) {
            forbidden.extend(["mission", "report", "calibration"].map(|above| format!("crate::{above}")));
        }
        for word in
            ["std::net", "std::thread", "std::time", "std::process", "rustix", "tracing", "rtrb", "println!"]
        {
            forbidden.push(word.into());
        }
        if !LOADERS.contains(&module.as_str()) {
            forbidden.push("std::fs".into());
        }
        violations.extend(
            forbidden.iter().filter(|w| code.contains(*w)).map(|w| format!("{} uses {w}", path.display())),
        );
    }
    assert!(pure > 30);
    assert!(violations.is_empty(), "{violations:#?}");
}

/// Paths of modules, `["servo", "view"]`, with their code.
fn modules() -> Vec<(Vec<String>, String)> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    files(&src, &mut found);
    let found =
        found.iter().map(|path| (module_path(path, &src), code(&std::fs::read_to_string(path).unwrap())));
    found.filter(|(name, _)| !name.iter().any(|part| part == "tests" || part == "testing")).collect()
}

/// What `text`, which follows `prefix::`, names: `a::{b, c::d}` is a::b and a::c::d.
fn named(prefix: &[String], text: &str, all: &mut Vec<Vec<String>>) {
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).unwrap_or(text.len());
    let (path, rest) = text.split_at(end);
    let parts = path.split("::").filter(|part| !part.is_empty()).map(String::from);
    let whole: Vec<String> = prefix.iter().cloned().chain(parts).collect();
    let Some(group) = rest.strip_prefix('{').filter(|_| path.ends_with("::")) else {
        return all.push(whole);
    };
    let (mut depth, mut from) = (0, 0);
    for (at, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' | ',' if depth == 0 => {
                named(&whole, group[from..at].trim_start(), all);
                from = at + 1;
                if c == '}' {
                    return;
                }
            }
            '}' => depth -= 1,
            _ => {}
        }
    }
}

#[test]
fn neighbours_do_not_go_in_circles() {
    let modules = modules();
    let known: BTreeSet<&[String]> = modules.iter().map(|(name, _)| name.as_slice()).collect();
    // (folder, module in it) -> modules of the same folder that it uses
    let mut uses: BTreeMap<(&[String], &str), BTreeSet<&str>> = BTreeMap::new();
    for (module, code) in &modules {
        let mut paths = Vec::new();
        for (word, base) in [("crate::", 0), ("super::", module.len().saturating_sub(1))] {
            for (at, _) in code.match_indices(word) {
                let before = code[..at].chars().next_back();
                if before.is_none_or(|c| !(c.is_alphanumeric() || c == '_' || c == ':')) {
                    let climbs =
                        code[at + word.len()..].split("super::").take_while(|s| s.is_empty()).count();
                    let base = if word == "super::" { base.saturating_sub(climbs) } else { 0 };
                    let rest = &code[at + word.len() + climbs * "super::".len()..];
                    named(&module[..base], rest, &mut paths);
                }
            }
        }
        for path in paths {
            let other = (0..=path.len()).rev().find_map(|n| known.get(&path[..n])).unwrap();
            let common = module.iter().zip(other.iter()).take_while(|(a, b)| a == b).count();
            if common < module.len() && common < other.len() {
                uses.entry((&module[..common], &module[common])).or_default().insert(&other[common]);
            }
        }
    }
    let edges: usize = uses.values().map(BTreeSet::len).sum();
    assert!(edges > 200, "the paths were understood: {edges}");
    let mut circles = Vec::new();
    for (folder, module) in uses.keys() {
        let (mut reached, mut next) = (BTreeSet::new(), vec![*module]);
        while let Some(m) = next.pop() {
            let further = uses.get(&(*folder, m)).into_iter().flatten();
            next.extend(further.filter(|other| reached.insert(**other)));
        }
        if reached.contains(module) {
            circles.push(format!("{}::{module}", folder.join("::")));
        }
    }
    assert!(circles.is_empty(), "modules that need themselves by way of a neighbour: {circles:?}");
}

/// Names such as `servo/view.rs` in backticks.
#[test]
fn files_that_pages_name_are_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut sources = Vec::new();
    for folder in ["src", "tests", "bin", "benches", "examples", "crates", "python/src"] {
        files(&root.join(folder), &mut sources);
    }
    let mut pages = vec![root.join("ARCHITECTURE.md"), root.join("README.md")];
    pages.extend(std::fs::read_dir(root.join("docs")).unwrap().flatten().map(|entry| entry.path()));
    let (mut named, mut missing) = (0, Vec::new());
    for page in pages.iter().filter(|page| page.extension().is_some_and(|e| e == "md")) {
        let text = std::fs::read_to_string(page).unwrap();
        let quoted = text.split('`').skip(1).step_by(2);
        for name in quoted.filter(|name| name.ends_with(".rs") && name.contains('/') && !name.contains(' ')) {
            named += 1;
            if !name.contains('*')
                && !name.contains("NAME")
                && !sources.iter().any(|path| path.ends_with(name))
            {
                missing.push(format!("{}: {name}", page.display()));
            }
        }
    }
    assert!(named > 50 && missing.is_empty(), "{named} names, not there: {missing:#?}");
}

#[test]
fn files_stay_readable() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    files(&src, &mut found);
    let long: Vec<_> = found
        .iter()
        .filter(|p| std::fs::read_to_string(p).unwrap().lines().count() > 450)
        .map(|p| p.display().to_string())
        .collect();
    assert!(long.is_empty(), "over 450 lines: {long:?}");
}

/// What an audit of the guardian reads: at most 500 lines, without tests, comments and empty ones.
#[test]
fn the_guardian_stays_small() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = vec![src.join("process/guardian.rs")];
    files(&src.join("core/guardian"), &mut found);
    let of = |path: &std::path::PathBuf| {
        let text = std::fs::read_to_string(path).unwrap();
        let code = text.split("#[cfg(test)]").next().unwrap().lines().map(str::trim);
        code.filter(|line| !line.is_empty() && !line.starts_with("//")).count()
    };
    let lines: usize = found.iter().filter(|path| !path.ends_with("tests.rs")).map(of).sum();
    assert!((400..=500).contains(&lines), "{lines} lines in {found:?}");
}

/// What an audit of the real-time thread reads is as much as ARCHITECTURE.md says, to a hundredth.
#[test]
fn the_real_time_path_is_as_long_as_told() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let Ok(output) = std::process::Command::new("python3").arg(root.join("tools/rt_path.py")).output() else {
        return println!("skipped: no python3");
    };
    let listed = String::from_utf8(output.stdout).unwrap();
    let sum = listed.lines().last().expect("the tool tells a sum");
    let counted: f64 = sum.split_whitespace().nth(1).unwrap().parse().unwrap();
    let page = std::fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    let told = page.split_once(" lines of code in ").unwrap().0.rsplit(' ').next().unwrap();
    let told: f64 = told.parse().unwrap();
    assert!((told / counted - 1.0).abs() < 0.01, "ARCHITECTURE.md says {told}, tools/rt_path.py {sum}");
}
