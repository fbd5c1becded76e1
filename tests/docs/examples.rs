//! The programs in examples/ do what their heads say. `cargo test` builds them.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests

use std::path::PathBuf;
use std::process::Command;

/// What an example says; it must succeed.
fn said(name: &str) -> String {
    let tests: PathBuf = std::env::current_exe().unwrap().parent().unwrap().into();
    let program = tests.with_file_name("examples").join(name);
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(&program).current_dir(folder.path()).output();
    let output = output.unwrap_or_else(|e| panic!("{}: {e}; `cargo test` builds it", program.display()));
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The number before the word.
fn number_before(text: &str, word: &str) -> f64 {
    let before = &text[..text.find(word).unwrap_or_else(|| panic!("no `{word}` in {text}"))];
    before.split_whitespace().last().unwrap().parse().unwrap()
}

#[test]
fn a_law_from_four_points_comes_home() {
    assert!(number_before(&said("law"), " mm and") < 1.0);
}

#[test]
fn a_pose_from_an_image_is_that_which_was_rendered() {
    assert!(number_before(&said("pose"), " mm and") < 1.0);
}

#[test]
fn a_drive_of_ones_own_converges() {
    let said = said("own_drive");
    assert!(said.starts_with("converged") && number_before(&said, " mm from") < 0.5, "{said}");
}
