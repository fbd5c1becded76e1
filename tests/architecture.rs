//! Pure modules stay pure: they use neither the operating system's modules nor its clocks, files, threads or sockets.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use std::path::{Path, PathBuf};

const OS: [&str; 6] = ["cli", "experiment", "ipc", "process", "rt", "source"];
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

fn module_of(path: &Path, src: &Path) -> String {
    let first = path.strip_prefix(src).unwrap().components().next().unwrap();
    first.as_os_str().to_string_lossy().trim_end_matches(".rs").to_string()
}

/// The code without comments and without the test module at the end.
fn code(text: &str) -> String {
    let body = text.split("#[cfg(test)]\nmod ").next().unwrap_or(text);
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
        // Control leaves a trace, which the report reads.
        if ["control", "drive", "servo", "motion"].contains(&module.as_str()) {
            forbidden.push("crate::report".into());
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
