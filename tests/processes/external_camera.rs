//! Cameras in programs of their own, through `camera/N/image`: every image is used or counted, and what a program does wrong is told.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // a skipped test says so

use crate::common::{Instance, number, run, vservo};
use serde_json::Value;
use std::process::{Command, Output};
use vservo::ipc::Services;
use vservo::messages::{CameraId, ImageHeader};
use vservo::rt;
use vservo::time::{MonoNs, SpanNs};

/// Not a test: a camera of 60 Hz and VGA. `VSERVO_TEST_CAMERA` says what it does wrong: `skip` leaves every tenth number out, `exit` ends
/// after 60 images, `silent` gives 30 and then none, `large` gives other sizes, `late` stamps a second and a half ahead.
#[test]
#[ignore = "the camera of the other tests"]
fn camera_process() {
    let behaviour = std::env::var("VSERVO_TEST_CAMERA").unwrap();
    let instance = std::env::var("VSERVO_INSTANCE").unwrap().parse().unwrap();
    let services = Services::join(&instance).unwrap();
    let images = services.image_sender(CameraId::FIRST, 640 * 480).unwrap();
    let (mut next, grey) = (rt::now(), vec![90_u8; 640 * 480]);
    for k in 0_u64.. {
        next = next + SpanNs(16_666_667);
        rt::sleep_until(next);
        match behaviour.as_str() {
            "skip" if k % 10 == 9 => continue,
            "exit" if k == 60 => return,
            "silent" if k >= 30 => continue,
            _ => {}
        }
        let ahead = if behaviour == "late" { SpanNs(1_500_000_000) } else { SpanNs(0) };
        let header = ImageHeader {
            sequence: k,
            stamp: MonoNs(next.0) + ahead,
            format: u32::from_le_bytes(*b"GREY"),
            width_px: if behaviour == "large" { 320 } else { 640 },
            height_px: 480,
            ..ImageHeader::default()
        };
        images.send(header, &grey).unwrap();
    }
}

fn camera(behaviour: &str) -> Vec<String> {
    let own = std::env::current_exe().unwrap();
    let wrong = format!("VSERVO_TEST_CAMERA={behaviour}");
    let argv =
        ["env", &wrong, own.to_str().unwrap(), "--ignored", "--exact", "external_camera::camera_process"];
    settings(&argv)
}

/// `--set` for an external camera of 60 Hz that this command starts.
fn settings(command: &[&str]) -> Vec<String> {
    [
        "camera.source=external".to_owned(),
        "camera.rate_hz=60".into(),
        format!("camera.external.command={command:?}"),
    ]
    .into_iter()
    .flat_map(|set| ["--set".to_owned(), set])
    .collect()
}

/// `vservo camera check` of that camera.
fn checked(test: &str, settings: &[String]) -> (Output, Value) {
    let instance = Instance::new(test);
    let arguments = ["camera", "check", "--json", "--duration-s", "2", "--instance", &instance.name];
    let output = vservo().args(arguments).args(settings).output().unwrap();
    instance.assert_gone();
    let answer = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output, answer)
}

fn all_wrongs(answer: &Value) -> String {
    answer["wrong"]
        .as_array()
        .unwrap()
        .iter()
        .map(|line| line.as_str().unwrap())
        .collect::<Vec<_>>()
        .join("\n")
}

/// Of 60 images a second none is lost that is not counted: what was used and what was lost are all that the program's numbers tell.
#[test]
fn every_image_at_sixty_hertz_is_used_or_counted() {
    let (output, answer) = checked("cam60", &camera("good"));
    let (frames, lost) = (number(&answer, &["frames"]), number(&answer, &["lost"]));
    let seconds = number(&answer, &["duration_s"]);
    assert!((number(&answer, &["obtained_hz"]) - 60.0).abs() < 0.5, "{answer}");
    assert!((frames + lost - 60.0 * seconds).abs() <= 0.1 * 60.0 * seconds, "{answer}");
    let seen = number(&answer, &["superseded"]);
    assert!(lost <= seen + 1.0, "only images that came together are lost on a busy machine: {answer}");
    assert_eq!(output.status.code(), Some(if lost == 0.0 { 0 } else { 3 }), "{answer}");
}

#[test]
fn what_a_program_leaves_out_is_counted_and_told() {
    let (output, answer) = checked("camskip", &camera("skip"));
    let (frames, lost) = (number(&answer, &["frames"]), number(&answer, &["lost"]));
    let missing = lost - number(&answer, &["superseded"]);
    assert!((missing - (frames + lost) / 10.0).abs() <= 1.5, "every tenth: {answer}");
    assert_eq!(output.status.code(), Some(3));
    assert!(all_wrongs(&answer).contains("missing in the source's own count"), "{answer}");
}

#[test]
fn another_size_and_a_foreign_clock_are_told() {
    let (output, _) = checked("camlarge", &camera("large"));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3));
    assert!(said.contains("320x480 px, the run file says 640x480"), "{said}");
    let (output, answer) = checked("camlate", &camera("late"));
    assert_eq!(output.status.code(), Some(3));
    assert!(all_wrongs(&answer).contains("its stamps cannot be used"), "{answer}");
}

/// A program that has stopped, or was never there, is told as that.
#[test]
fn a_camera_that_stops_is_told_with_what_is_lost() {
    let (output, answer) = checked("camexit", &camera("exit"));
    assert_eq!(output.status.code(), Some(3), "{answer}");
    assert!(all_wrongs(&answer).contains("it has stopped: it is unplugged"), "{answer}");
    assert!(number(&answer, &["lost"]) > 10.0 && number(&answer, &["silent"]) > 10.0, "{answer}");
    let (output, _) = checked("camfalse", &settings(&["false"]));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(5), "{said}");
    assert!(said.contains("`false` ended with exit status: 1 before it gave an image"), "{said}");
    let output = vservo().args(["camera", "check", "ur5"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("set it to \"external\" or") && !said.contains("--device"), "{said}");
}

/// A run whose camera program ends, ends; one whose program is silent ends after `give_up_s`, and says why.
#[test]
fn death_and_silence_end_a_run() {
    for (behaviour, code, words) in
        [("exit", 4, "the camera program process ended"), ("silent", 4, "the camera is stalled")]
    {
        let set = camera(behaviour);
        let mut arguments: Vec<&str> = set.iter().map(String::as_str).collect();
        arguments.extend([
            "--clock",
            "realtime",
            "--set",
            "camera.external.give_up_s=1",
            "--set",
            "run.duration_s=30",
        ]);
        let run = run(&format!("cam{behaviour}"), &arguments);
        let text = run.text();
        assert_eq!(run.output.status.code(), Some(code), "{text}");
        assert!(
            text.contains(words) || run.summary["reason"].to_string().contains(words),
            "{text} {}",
            run.summary
        );
    }
}

/// The sample in Python, where its packages are.
#[test]
fn the_python_sample_loses_nothing_uncounted() {
    let python = std::env::var("VSERVO_PYTHON").unwrap_or_else(|_| "python3".into());
    let output = Command::new(&python).args(["-c", "import numpy, iceoryx2"]).output();
    if !output.is_ok_and(|o| o.status.success()) {
        println!("skipped: {python} has no numpy and iceoryx2");
        return;
    }
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/camera/external_camera.py");
    let (_, answer) = checked("campython", &settings(&[&python, sample, "synthetic"]));
    let (frames, lost) = (number(&answer, &["frames"]), number(&answer, &["lost"]));
    assert!((number(&answer, &["obtained_hz"]) - 60.0).abs() < 0.5, "{answer}");
    assert!((frames + lost - 60.0 * number(&answer, &["duration_s"])).abs() <= 12.0, "{answer}");
}

/// Whether `python` can import `modules`.
fn imports(python: &str, modules: &str) -> bool {
    let output = Command::new(python).args(["-c", &format!("import {modules}")]).output();
    let has = output.is_ok_and(|output| output.status.success());
    if !has {
        println!("skipped: {python} cannot import {modules}");
    }
    has
}

/// The sample for GStreamer, where its packages are, with a camera that GStreamer makes.
#[test]
fn the_gstreamer_sample_has_stamps_and_counts() {
    let python = std::env::var("VSERVO_GST_PYTHON").unwrap_or_else(|_| "python3".into());
    if !imports(
        &python,
        "numpy, iceoryx2, gi; gi.require_version('Gst', '1.0'); from gi.repository import Gst; Gst.init(None); assert Gst.ElementFactory.find('videotestsrc')",
    ) {
        assert!(std::env::var_os("VSERVO_REQUIRE_GST").is_none(), "GStreamer is required here");
        return;
    }
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/camera/gstreamer_camera.py");
    let source = "videotestsrc is-live=true ! video/x-raw,width=640,height=480,framerate=60/1";
    let (_, answer) = checked("camgst", &settings(&[&python, sample, source]));
    assert!((number(&answer, &["obtained_hz"]) - 60.0).abs() < 0.5, "{answer}");
    // Where other work holds it up images are lost; each that comes has its time.
    assert!(number(&answer, &["frames"]) > 10.0 && number(&answer, &["undated"]) == 0.0, "{answer}");
}

/// What the sample for ROS 2 makes of messages, which need no ROS here.
#[test]
fn the_ros_sample_knows_steps_and_stamps() {
    let python = std::env::var("VSERVO_PYTHON").unwrap_or_else(|_| "python3".into());
    if !imports(&python, "numpy, iceoryx2") {
        return;
    }
    let text = "import sys, time; sys.path.insert(0, 'examples/camera')\n\
                import ros2_camera as r\n\
                from types import SimpleNamespace as N\n\
                m = N(encoding='bgr8', is_bigendian=0, height=2, width=2, step=8, data=bytes(range(16)))\n\
                pixels, letters = r.image_of(m)\n\
                assert (pixels.tolist(), letters) == ([[[0, 1, 2], [3, 4, 5]], [[8, 9, 10], [11, 12, 13]]], 'BGR3')\n\
                m = N(encoding='mono8', is_bigendian=0, height=1, width=3, step=4, data=bytes(4))\n\
                assert r.image_of(m)[0].shape == (1, 3)\n\
                now = time.time_ns()\n\
                assert abs(time.monotonic_ns() - r.exposed(N(sec=now // 10**9, nanosec=now % 10**9))) < 10**9\n\
                assert r.exposed(N(sec=0, nanosec=0)) == 0\n";
    let output = Command::new(&python)
        .args(["-c", text])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
