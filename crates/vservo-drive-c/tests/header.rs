//! The header, which is written by hand, against the functions and codes of the library.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use std::collections::BTreeMap;
use vservo_drive::ErrorCode;

const HEADER: &str = include_str!("../include/vservo_drive.h");
const SOURCE: &str = include_str!("../src/lib.rs");

/// A type of the source as the header writes it.
fn in_c(rust: &str) -> &str {
    match rust {
        "*mut DriveHandle" => "vservo_drive *",
        "*const DriveHandle" => "const vservo_drive *",
        "*mut DriveCommandMsg" => "vservo_DriveCommand *",
        "*const DriveCommandMsg" => "const vservo_DriveCommand *",
        "*const DriveStateMsg" => "const vservo_DriveState *",
        "*const *const c_char" => "const char *const *",
        "*const c_char" => "const char *",
        "*const f64" => "const double *",
        "i32" => "int32_t",
        "u32" => "uint32_t",
        "i64" => "int64_t",
        other => panic!("no type of the header: {other}"),
    }
}

/// What both write without regard to spaces.
fn squeezed(text: &str) -> String {
    text.split_whitespace().collect()
}

/// `name` with its prototype, as C writes it, of every function that is exported.
fn exported() -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for part in SOURCE.split("#[unsafe(no_mangle)]").skip(1) {
        let (_, part) = part.split_once("extern \"C\" fn ").unwrap();
        let (name, part) = part.split_once('(').unwrap();
        let (arguments, part) = part.split_once(')').unwrap();
        let result =
            part.split('{').next().unwrap().trim().strip_prefix("-> ").map_or("void", |r| in_c(r.trim()));
        let arguments = arguments.split(',').map(str::trim).filter(|argument| !argument.is_empty());
        let arguments: Vec<_> = arguments
            .map(|argument| argument.split_once(": ").unwrap())
            .map(|(name, kind)| format!("{} {name}", in_c(kind)))
            .collect();
        let arguments = if arguments.is_empty() { "void".into() } else { arguments.join(", ") };
        found.insert(name.to_owned(), squeezed(&format!("{result} {name}({arguments});")));
    }
    found
}

/// The header without its comments.
fn declared() -> String {
    let mut parts = HEADER.split("/*");
    let first = parts.next().unwrap().to_owned();
    parts.fold(first, |text, part| text + part.split_once("*/").unwrap().1)
}

#[test]
fn every_function_stands_in_the_header_with_its_types() {
    let (exported, declared) = (exported(), squeezed(&declared()));
    assert!(exported.len() > 10, "the functions were found: {exported:?}");
    for prototype in exported.values() {
        assert!(declared.contains(prototype), "not in the header: {prototype}");
    }
}

#[test]
fn the_header_declares_nothing_that_is_not_exported() {
    let declared = declared();
    let exported = exported();
    let words = declared.split(|c: char| !(c.is_alphanumeric() || c == '_'));
    let functions: Vec<_> = words.filter(|word| word.starts_with("vservo_drive_")).collect();
    assert!(functions.len() > 10);
    for name in functions {
        // Defined in the header itself.
        assert!(exported.contains_key(name) || name == "vservo_drive_open", "{name}");
    }
}

#[test]
fn codes_are_those_of_the_header() {
    for (name, code) in [
        ("ARGUMENT", ErrorCode::Argument),
        ("VALUE", ErrorCode::Value),
        ("TRANSPORT", ErrorCode::Transport),
        ("THREAD", ErrorCode::Thread),
        ("INTERNAL", ErrorCode::Internal),
    ] {
        assert!(HEADER.contains(&format!("VSERVO_DRIVE_ERROR_{name} = {}", code as i32)), "{name}");
    }
    assert_eq!(HEADER.matches("VSERVO_DRIVE_ERROR_").count(), 5);
}
