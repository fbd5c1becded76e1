//! Exposure stamps that are wrong: what is used, what is refused, and what the summary says of it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::{Run, run};

fn with_stamps_off_by(error_ms: i64) -> Run {
    let error = format!("camera.synthetic.stamp_error_ms={error_ms}");
    run("stamps", &["--clock", "lockstep", "--duration-s", "6", "--set", &error])
}

fn count(run: &Run, what: &str) -> u64 {
    run.summary["intake"][what].as_u64().unwrap_or_else(|| panic!("{what}: {}", run.text()))
}

fn told_of_the_future(run: &Run) -> bool {
    let events = run.summary["safety"]["events"].as_array().unwrap();
    events.iter().filter(|e| e["event"].as_str().unwrap().contains("lies in the future")).count() == 1
}

#[test]
fn right_stamps_are_all_used() {
    let r = with_stamps_off_by(0);
    assert_eq!(count(&r, "used"), r.summary["measurements"].as_u64().unwrap(), "{}", r.text());
    assert!(!told_of_the_future(&r) && !r.text().contains("stamps "), "{}", r.text());
}

/// 20 ms from exposure to use, stamps 45 ms late: 25 ms in the future, within the bound of 50 ms.
#[test]
fn stamps_from_the_near_future_are_used_and_told() {
    let r = with_stamps_off_by(45);
    assert_eq!(r.summary["outcome"], "converged", "{}", r.text());
    assert!(count(&r, "used_from_future") > 30 && count(&r, "refused_from_future") == 0, "{}", r.text());
    assert!(told_of_the_future(&r) && r.text().contains("used from the future"), "{}", r.text());
}

#[test]
fn stamps_from_the_far_future_are_refused_with_the_reason() {
    let r = with_stamps_off_by(90);
    assert_eq!((count(&r, "used"), count(&r, "used_from_future")), (0, 0), "{}", r.text());
    assert!(count(&r, "refused_from_future") > 50 && told_of_the_future(&r), "{}", r.text());
    assert_eq!(r.summary["outcome"], "not_converged");
    assert!(r.text().contains("set camera.stamp_offset_ms"), "{}", r.text());
}
