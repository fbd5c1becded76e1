//! Gains and delay in the whole system: rendered images, the arm's dynamics and limits.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::{run, vservo};

/// Time to 2 % of the first feature error with 80 ms from exposure to use, s; `None` for a run that does not converge.
fn settling_time_s(update: &str, gain_1_s: f64) -> Option<f64> {
    let update = format!("servo.update={update}");
    let gain = format!("servo.gain_1_s={gain_1_s}");
    // What the prediction does, and not what keeps the target in the image.
    let set =
        ["camera.latency_ms=80", "servo.interaction=current", "servo.visibility.guard=false", &update, &gain];
    let mut args = vec!["--clock", "lockstep", "--duration-s", "8"];
    for value in set {
        args.extend(["--set", value]);
    }
    let r = run("gains", &args);
    assert_ne!(r.summary["outcome"], "fault", "{}", r.text());
    (r.summary["outcome"] == "converged").then(|| r.summary["settling_time_s"].as_f64().unwrap())
}

/// Under `predict` the arm's limits bound the gain no more: it brakes in time for the goal, and settles sooner than with
/// any gain under `frame`.
#[test]
fn predict_bears_any_gain_where_frame_does_not() {
    let best_of_frame = [2.0, 3.0, 4.0, 5.0, 6.0, 8.0]
        .into_iter()
        .filter_map(|g| settling_time_s("frame", g))
        .fold(9.0, f64::min);
    assert!((1.0..1.35).contains(&best_of_frame), "{best_of_frame} s; 1.16 s is obtained");
    for gain in [8.0, 20.0, 100.0] {
        let predicted = settling_time_s("predict", gain).unwrap_or_else(|| panic!("gain {gain}"));
        assert!(predicted < 0.85 * best_of_frame, "gain {gain}: {predicted} s, frame {best_of_frame} s");
    }
    assert_eq!(settling_time_s("frame", 40.0), None, "a held law cannot bear that");
}

/// What control believes of the age of an image is what its stamp says: how much more it stands does not depend on when images come. A stamp that lay in the future would be used as if it were now.
#[test]
fn the_delay_that_tune_tells_is_none_of_the_stamps() {
    let margin_ms = |latency_ms: f64| {
        let latency = format!("camera.latency_ms={latency_ms:?}");
        let tune = ["tune", "ur5", "servo.gain_1_s=14.0..15.0", "--sweep", "2", "--json", "--set", &latency];
        let output = vservo().args(tune).output().unwrap();
        let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        answer["proposals"][0]["delay_margin_ms"].as_f64().unwrap()
    };
    let [early, late] = [20.0, 40.0].map(margin_ms);
    assert!((early - late).abs() < 0.1 * late, "{early} {late} ms");
}
