//! Lockstep runs of the real processes: they converge, and they repeat to the last bit.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{BusyCores, Instance, Lines, Run, assert_accurate, kill, number, run, vservo};
use std::process::Stdio;

fn lockstep(test: &str, extra: &[&str]) -> Run {
    run(test, &[&["--clock", "lockstep"], extra].concat())
}

#[test]
fn the_default_run_converges_and_tells_everything() {
    let r = lockstep("default", &[]);
    assert_accurate(&r);
    let s = &r.summary;
    assert_eq!(s["clock"], "lockstep");
    assert_eq!(s["scheme"], "image_resolved_velocity");
    assert_eq!(s["safety"]["state"], "converged");
    assert_eq!(s["frames_dropped"], 0);
    assert_eq!(s["target_lost"], 0);
    assert_eq!(s["missed_deadlines"], 0);
    assert_eq!(s["safety"]["events"].as_array().unwrap().len(), 0, "{s}");
    assert_eq!(
        number(s, &["latency_us", "exposure_to_command", "max"]),
        20_000.0,
        "latency is exact in lockstep"
    );
    let ticks = number(s, &["ticks"]);
    assert!((number(s, &["duration_s"]) - ticks * 1e-3).abs() < 1e-9);
    // No arm with these limits is there before 0.69 s; see examples/settling.rs.
    assert!((0.6..1.04).contains(&number(s, &["settling_time_s"])), "{s}");
    let out = String::from_utf8_lossy(&r.output.stdout);
    assert!(out.contains("outcome       converged"), "{out}");
}

#[test]
fn runs_repeat_to_the_last_bit_also_side_by_side() {
    let runs: Vec<_> = (0..4)
        .map(|_| {
            std::thread::Builder::new()
                .name("run".into())
                .spawn(|| lockstep("repeat", &["--duration-s", "1.5"]).summary)
                .unwrap()
        })
        .collect();
    let summaries: Vec<_> = runs.into_iter().map(|t| t.join().unwrap()).collect();
    let hash = summaries[0]["state_hash"].as_str().unwrap();
    assert_eq!(hash.len(), 32);
    assert!(summaries.iter().all(|s| s["state_hash"] == hash), "{summaries:?}");
    assert_eq!(summaries[0]["outcome"], "not_converged");

    let other_noise = lockstep("repeat", &["--duration-s", "1.5", "--seed", "2"]).summary;
    assert_ne!(other_noise["state_hash"], hash, "the hash sees the noise");
}

#[test]
fn every_update_policy_repeats_on_busy_cores() {
    let mut hashes = Vec::new();
    for irregular in [false, true] {
        for update in ["frame", "tick", "predict"] {
            let update = format!("servo.update={update}");
            let mut arguments = vec!["--duration-s", "1.5", "--set", &update];
            if irregular {
                arguments.extend(["--set", "camera.synthetic.latency_jitter_ms=35"]);
                arguments.extend(["--set", "camera.synthetic.frame_loss=0.15"]);
            }
            let hash =
                || lockstep("policies", &arguments).summary["state_hash"].as_str().unwrap().to_string();
            let (quiet, again) = (hash(), hash());
            let busy = {
                let _busy = BusyCores::start();
                hash()
            };
            assert_eq!([&again, &busy], [&quiet, &quiet], "{arguments:?}");
            hashes.push(quiet);
        }
    }
    let mut different = hashes.clone();
    different.sort_unstable();
    different.dedup();
    assert_eq!(
        different.len(),
        hashes.len(),
        "each policy and each camera moves the arm differently: {hashes:?}"
    );
}

#[test]
fn time_over_before_the_goal_is_exit_code_5() {
    let r = lockstep("short", &["--duration-s", "0.3"]);
    assert_eq!(r.output.status.code(), Some(5));
    assert_eq!(r.summary["outcome"], "not_converged");
    // From then on the arm brakes, which takes a while: its acceleration is at most 10 rad/s2.
    let duration_s = number(&r.summary, &["duration_s"]);
    assert!((0.301..1.0).contains(&duration_s), "{}", r.summary);
}

#[test]
fn every_update_policy_drive_and_depth_converges() {
    for set in [
        ["servo.update=frame", "drive.kind=simulated"],
        ["servo.update=predict", "servo.depth=estimated"],
        ["servo.update=tick", "drive.kind=ideal"],
        ["servo.update=frame", "drive.kind=ideal"],
        ["servo.depth=estimated", "drive.simulated.substeps=2"],
    ] {
        assert_accurate(&lockstep("policy", &["--set", set[0], "--set", set[1]]));
    }
}

#[test]
fn odd_rates_latencies_sizes_and_lenses_converge() {
    for set in [
        ["camera.rate_hz=30", "camera.latency_ms=0"],
        ["camera.rate_hz=200", "camera.latency_ms=33.3"],
        ["camera.rate_hz=7", "camera.latency_ms=120"],
        ["camera.width_px=960", "camera.height_px=640"],
        ["camera.lens.k1=0.1", "camera.lens.p1=0.002"],
        ["camera.synthetic.noise_sd_levels=6", "camera.synthetic.blur_sd_px=1.5"],
        ["vision.track=false", "camera.exposure_ms=20"],
    ] {
        let timeout = "safety.measurement_timeout_ms=600";
        assert_accurate(&lockstep("odd", &["--set", set[0], "--set", set[1], "--set", timeout]));
    }
}

#[test]
fn a_thousand_frames_a_second_repeat_too() {
    let fast = || {
        lockstep(
            "khz",
            &["--duration-s", "0.2", "--set", "camera.rate_hz=1000", "--set", "camera.exposure_ms=0.5"],
        )
    };
    let (a, b) = (fast().summary, fast().summary);
    let frames = number(&a, &["ticks"]) - 20.0;
    assert!(frames > 180.0, "{a}");
    assert_eq!(number(&a, &["measurements"]), frames, "a frame a tick, less the latency of 20: {a}");
    assert_eq!(a["state_hash"], b["state_hash"]);
}

#[test]
fn an_irregular_camera_repeats_and_converges() {
    let irregular = || {
        lockstep(
            "irregular",
            &["--set", "camera.synthetic.latency_jitter_ms=35", "--set", "camera.synthetic.frame_loss=0.15"],
        )
    };
    let (a, b) = (irregular(), irregular());
    assert_accurate(&a);
    assert_eq!(a.summary["state_hash"], b.summary["state_hash"]);
    let latency = |q| number(&a.summary, &["latency_us", "exposure_to_command", q]);
    assert!(latency("max") > 40_000.0 && latency("max") <= 55_000.0, "{}", a.summary);
    let frames = number(&a.summary, &["frames"]);
    let exposures = number(&a.summary, &["duration_s"]) * 25.0;
    assert!(frames < 0.95 * exposures && frames > 0.7 * exposures, "{frames} of {exposures}");
    assert_eq!(a.summary["frames_dropped"], 0, "the camera lost them, vision did not");
}

/// A control process by hand that is left alone says so, again and again, and who is missing.
#[test]
fn missing_peers_are_named() {
    let instance = Instance::new("alone");
    let mut control = vservo()
        .args(["control", "--instance", &instance.name, "--set", "run.clock=lockstep"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut control);
    lines.wait_for("camera and vision have not joined");
    let mut vision = vservo()
        .args(["vision", "--instance", &instance.name, "--set", "run.clock=lockstep"])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    lines.wait_for("the camera has not joined");
    for child in [&control, &vision] {
        kill(child.id() as i32, "INT");
    }
    control.wait().unwrap();
    vision.wait().unwrap();
    instance.assert_gone();
}

/// Who comes second with another camera, target or clock is refused, and told what differs; what one process alone needs may differ.
#[test]
fn processes_of_unlike_run_files_are_refused() {
    let instance = Instance::new("unlike");
    let lockstep = ["--set", "run.clock=lockstep"];
    let mut control = vservo()
        .args(["control", "--instance", &instance.name])
        .args(lockstep)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut control);
    lines.wait_for("camera and vision have not joined");
    let join = |role: &str, set: &[&str]| {
        let mut command = vservo();
        command.args([role, "--instance", &instance.name]).args(set.iter().flat_map(|set| ["--set", set]));
        command
    };
    for (role, set, said) in [
        ("vision", "camera.rate_hz=50", "camera.rate_hz is 25.0 in its control process and 50.0 here"),
        (
            "camera",
            "camera.lens.fx_px=790",
            "camera.lens.fx_px is 800.0 in its control process and 790.0 here",
        ),
        (
            "vision",
            "target.kind=tags",
            "target.kind is \"four_dots\" in its control process and \"tags\" here",
        ),
    ] {
        let output = join(role, &["run.clock=lockstep", set]).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(3), "{text}");
        assert!(text.contains(said) && text.contains("the same run file"), "{text}");
    }
    let clock = join("camera", &["run.clock=realtime"]).output().unwrap();
    let text = String::from_utf8_lossy(&clock.stderr).into_owned();
    assert!(clock.status.code() == Some(3) && text.contains("run.clock is \"lockstep\""), "{text}");
    let own = ["run.clock=lockstep", "camera.synthetic.noise_sd_levels=1", "run.seed=9"];
    let mut camera = join("camera", &own).stderr(Stdio::null()).spawn().unwrap();
    lines.wait_for("vision has not joined");
    for child in [&control, &camera] {
        kill(child.id() as i32, "INT");
    }
    control.wait().unwrap();
    camera.wait().unwrap();
    instance.assert_gone();
}
