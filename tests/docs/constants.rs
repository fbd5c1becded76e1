//! Numbers in the code say where they come from.

#![allow(clippy::print_stdout)] // why a test was skipped

use std::path::Path;

/// Numbers of src/ without a comment that says where they come from. It only falls: who gives reasons lowers it.
const WITHOUT_ORIGIN: usize = 0;

#[test]
fn no_more_numbers_are_without_an_origin() {
    let tool = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/constants.py");
    let Ok(output) = std::process::Command::new("python3").arg(tool).output() else {
        return println!("skipped: no python3");
    };
    let listed = String::from_utf8(output.stdout).unwrap();
    let sum = listed.lines().last().expect("the tool tells a sum");
    let counted: usize = sum.split_whitespace().next().unwrap().parse().unwrap();
    assert!(
        counted == WITHOUT_ORIGIN,
        "{counted} numbers say not where they come from, {WITHOUT_ORIGIN} did: `tools/constants.py FOLDER` lists them\n{listed}"
    );
}
