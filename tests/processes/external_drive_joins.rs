//! How an external drive comes to a run: of another version, never, late, or without an answer. Each is told in words
//! that help, and in time.

#![allow(clippy::unwrap_used)]

use crate::common::{Instance, number, run, vservo, wait_until};
use crate::drive::{command, drive_by_hand, program};
use iceoryx2::prelude::ZeroCopySend;
use std::process::Stdio;
use std::time::Duration;
use vservo::ipc::Instance as Place;

/// States of a later version of this program, and a command that has grown without a new name.
#[repr(C)]
#[derive(Debug, Clone, Copy, ZeroCopySend)]
#[type_name("vservo.DriveState.v4")]
struct LaterState {
    tick: u64,
    q: [f64; 50],
}

#[repr(C)]
#[derive(Debug, Clone, Copy, ZeroCopySend)]
#[type_name("vservo.DriveCommand.v3")]
struct GrownCommand {
    tick: u64,
    q_r: [f64; 40],
}

/// Not a test: a drive of another version, which makes its services if it comes first, and else tries to open them.
#[test]
#[ignore = "the drive of the other tests"]
fn drive_of_another_version() {
    use iceoryx2::prelude::*;
    let place: Place = std::env::var("VSERVO_INSTANCE").unwrap().parse().unwrap();
    let config = place.transport_config().unwrap();
    place.check_place().unwrap();
    let node = NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .unwrap();
    let (state, command) = ("drive/state".try_into().unwrap(), "drive/command".try_into().unwrap());
    loop {
        let states = node.service_builder(&state).publish_subscribe::<LaterState>().open_or_create();
        let commands = node.service_builder(&command).publish_subscribe::<GrownCommand>().open_or_create();
        let _ports = (
            states.as_ref().map(|s| s.publisher_builder().create().unwrap()),
            commands.as_ref().map(|c| c.subscriber_builder().create().unwrap()),
        );
        // Kept as long as it is there at all.
        let wait = if states.is_ok() { Duration::from_secs(600) } else { Duration::from_millis(10) };
        std::thread::sleep(wait);
    }
}

#[test]
fn an_earlier_drive_of_another_version_is_refused() {
    let instance = Instance::new("firstother");
    let mut drive = drive_by_hand(&instance, "external_drive_joins::drive_of_another_version");
    let services = format!("/dev/shm/vservo-{}/services", instance.name);
    wait_until("the drive's services", || {
        std::fs::read_dir(&services).is_ok_and(|entries| entries.count() >= 2)
    });
    let output = vservo()
        .args(["run", "--clock", "lockstep", "--instance", &instance.name, "--set", "drive.kind=external"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    drive.kill().unwrap();
    drive.wait().unwrap();
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(text.contains("service `drive/state` carries vservo.DriveState.v4 of 408 bytes"), "{text}");
    assert!(text.contains("expects vservo.DriveState.v3 of 328 bytes"), "{text}");
    instance.name.parse::<Place>().unwrap().remove_leftovers(None);
    instance.assert_gone();
}

/// By hand there is no end to the wait; but it is told, with what is there and what is expected.
#[test]
fn a_later_drive_must_have_the_right_version() {
    let instance = Instance::new("laterother");
    let mut child = vservo()
        .args(["run", "--clock", "lockstep", "--instance", &instance.name, "--set", "drive.kind=external"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = crate::common::Lines::of(&mut child);
    lines.wait_for("waiting for the external drive");
    let mut wrong = drive_by_hand(&instance, "external_drive_joins::drive_of_another_version");
    let line = lines.wait_for("yet there is `processes-");
    assert!(line.contains(&format!("(process {})", wrong.id())), "{line}");
    assert!(line.contains("drive/state` carries vservo.DriveState.v3 of 328 bytes"), "{line}");
    assert!(line.contains("drive/command` vservo.DriveCommand.v3 of 264 bytes"), "{line}");
    wrong.kill().unwrap();
    wrong.wait().unwrap();
    let line = lines.wait_for("no other program has joined");
    assert!(line.contains("still waiting for the external drive"), "{line}");
    let mut drive = drive_by_hand(&instance, "drive::drive_process");
    lines.drain();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));
    drive.wait().unwrap();
    instance.assert_gone();
}

#[test]
fn a_program_that_never_becomes_a_drive_ends_the_run() {
    let own = std::env::current_exe().unwrap();
    let version = ["--ignored", "--exact", "external_drive_joins::drive_of_another_version"];
    let other = program(&[&[own.to_str().unwrap()], &version[..]].concat());
    let mute = command("mute");
    // The other version may also be there between control's two services: then it has made the command's.
    for (command, words) in [
        ("drive.external.command=[\"sleep\", \"600\"]", &["no other program has joined this instance"][..]),
        (&other, &["DriveState.v3 of 328 bytes", "expects vservo.DriveCommand.v3 of 264 bytes"]),
        (&mute, &["it is there, but does not answer START"]),
    ] {
        for clock in ["lockstep", "realtime"] {
            let external = ["--set", "drive.kind=external", "--set", command, "--clock", clock];
            let r = run("never", &[&external[..], &["--set", "drive.external.connect_timeout_s=3"]].concat());
            assert_eq!(r.output.status.code(), Some(3), "{}", r.text());
            assert!(words.iter().any(|w| r.text().contains(w)), "{words:?}: {}", r.text());
            // 3 s of looking every 2 ms were 0.6 s.
            let used_s = number(&r.summary, &["processes", "control", "cpu_s"]);
            assert!(used_s < 0.3, "{command}: {used_s} s of a core");
        }
    }
}
