//! Drives in C and C++: the header compiles, and the skeleton of a drive keeps its contract, brings the arm home and stops as a robot does. The skeleton is built by
//! `.ci/run`, which names it in `VSERVO_CPP_DRIVE`; without it those tests say `skipped`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests; why one was skipped, and what was measured

use crate::common::{assert_accurate, kill, number, run, vservo, wait_until};
use crate::drive_check::{checked, rules, undisturbed};
use crate::serve::Daemon;
use std::fs;
use std::path::Path;
use std::process::Command;

/// The joints of config/robot/ur5.urdf.
const NAMES: [&str; 6] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];

/// The program with its arguments.
fn skeleton() -> Option<Vec<String>> {
    let Some(program) = std::env::var("VSERVO_CPP_DRIVE").ok() else {
        println!("skipped: no VSERVO_CPP_DRIVE");
        return None;
    };
    Some(std::iter::once(program).chain(NAMES.map(String::from)).collect())
}

/// Arguments of a run before it. A loaded machine may keep the drive waiting, which is nothing to these tests.
fn arguments(command: &[String], mode: &str) -> Vec<String> {
    let set = [
        "drive.kind=external",
        &format!("drive.mode={mode}"),
        &format!("drive.external.command={command:?}"),
        "safety.drive_timeout_ms=1000",
    ];
    std::iter::once("ur5").chain(set.into_iter().flat_map(|set| ["--set", set])).map(String::from).collect()
}

fn borrowed(arguments: &[String]) -> Vec<&str> {
    arguments.iter().map(String::as_str).collect()
}

/// Every function is named, so that the compiler sees each declaration used, in both languages.
#[test]
fn the_header_for_drives_compiles_in_c_and_in_cpp() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let layouts = vservo().args(["layouts", "--lang", "c"]).output().unwrap();
    fs::write(folder.path().join("vservo.h"), layouts.stdout).unwrap();
    let used = "#include \"vservo_drive.h\"\n\
        int main(void) {\n\
        vservo_drive *drive = vservo_drive_open(NULL);\n\
        const char *const names[] = {\"a\", \"b\"}; const double signs[] = {1.0, -1.0};\n\
        vservo_DriveCommand command; vservo_DriveState state; state.joints = 2;\n\
        vservo_drive_sleep_until_ns(vservo_drive_now_ns());\n\
        if (!drive) return vservo_drive_leave_reason(NULL, vservo_drive_last_error()) == VSERVO_DRIVE_ERROR_ARGUMENT;\n\
        if (vservo_drive_wait(drive, 1000000) == 1 && vservo_drive_receive(drive, &command) == 1\n\
            && vservo_drive_is_valid_command(&command, 2) && !vservo_drive_is_stopped_by_guardian(drive))\n\
            vservo_drive_send_joint_names(drive, names, 2, signs, NULL);\n\
        vservo_drive_send_properties(drive, 1000000, 100000000, 0, signs, 2);\n\
        vservo_drive_send_robot_text(drive, VSERVO_ROBOT_STATE_READY, 0, vservo_drive_config_path(drive));\n\
        return vservo_drive_send(drive, &state) + vservo_drive_close(drive); }\n";
    let (c, cpp) = (folder.path().join("used.c"), folder.path().join("used.cpp"));
    fs::write(&c, used).unwrap();
    fs::write(&cpp, used).unwrap();
    let sample = root.join("examples/cpp_drive/skeleton_drive.cpp");
    for (compiler, file, standard) in [
        ("cc", &c, "-std=c11"),
        ("c++", &cpp, "-std=c++11"),
        ("c++", &cpp, "-std=c++17"),
        ("c++", &sample, "-std=c++11"),
        ("c++", &sample, "-std=c++17"),
    ] {
        let output = Command::new(compiler)
            .args(["-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", standard, "-I"])
            .arg(folder.path())
            .arg("-I")
            .arg(root.join("crates/vservo-drive-c/include"))
            .arg(file)
            .output();
        match output {
            Ok(output) => assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr)),
            Err(_) => println!("skipped: no {compiler}"),
        }
    }
}

#[test]
fn a_drive_in_cpp_breaks_no_rule_in_velocity_and_position() {
    let Some(command) = skeleton() else { return };
    let program = [
        &["ur5", "--set", "drive.kind=external", "--set", "drive.mode=velocity", "--"][..],
        &borrowed(&command),
    ]
    .concat();
    let (output, answer) = undisturbed(|| checked(&crate::common::Instance::new("cppcheck"), &program));
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(rules(&answer, "broken").is_empty(), "{answer:#}\n{told}");
    let ok = rules(&answer, "ok");
    for rule in [
        "answer",
        "every_start",
        "joint_names",
        "properties",
        "modes",
        "robot_state",
        "sequence",
        "tick",
        "clock",
        "rising",
        "order",
        "sign",
        "stays",
        "last_rest",
        "last_exit",
        "silence",
        "silence_told",
        "refuses_joints",
        "refuses_numbers",
    ] {
        assert!(ok.contains(&rule.to_owned()), "{rule}: {answer:#}\n{told}");
    }
    let moved = |mode: &str| {
        let rules = answer["rules"].as_array().unwrap();
        rules.iter().any(|rule| rule["rule"] == "order" && rule["mode"] == mode && rule["verdict"] == "ok")
    };
    assert!(moved("velocity") && moved("position"), "{answer:#}");
    println!("{} rules ok, {} broken", ok.len(), answer["broken"]);
}

#[test]
fn a_drive_in_cpp_brings_the_arm_home() {
    let Some(command) = skeleton() else { return };
    for mode in ["velocity", "position"] {
        let home = run("cpphome", &borrowed(&arguments(&command, mode)));
        assert_accurate(&home);
        println!("{mode}: settled in {:.3} s", number(&home.summary, &["settling_time_s"]));
    }
}

/// The process of this program in this instance.
fn process_of(program: &str, instance: &str) -> Option<i32> {
    let wanted = format!("VSERVO_INSTANCE={instance}");
    std::fs::read_dir("/proc").unwrap().flatten().find_map(|entry| {
        let pid = entry.file_name().to_string_lossy().parse::<i32>().ok()?;
        let own = |file: &str| fs::read(entry.path().join(file)).unwrap_or_default();
        let is_program = own("cmdline").split(|b| *b == 0).next() == Some(program.as_bytes());
        let is_ours = own("environ").split(|b| *b == 0).any(|part| part == wanted.as_bytes());
        (is_program && is_ours).then_some(pid)
    })
}

/// The robot of the sample stops by itself at a signal: a fault in its words, which a reset has cleared, and then the arm comes home.
#[test]
fn a_stop_of_the_robot_behind_cpp_is_told_and_cleared() {
    let Some(command) = skeleton() else { return };
    let daemon = Daemon::start("cppstop", &borrowed(&arguments(&command, "velocity")));
    let status = |key: &str| daemon.ctl("status").1[key].as_str().unwrap_or_default().to_owned();
    wait_until("a robot that is ready", || status("robot_state") == "ready");
    let mut process = None;
    wait_until("the drive", || {
        process = process_of(&command[0], &daemon.instance.name);
        process.is_some()
    });
    daemon.accepts("start");
    kill(process.unwrap(), "USR1");
    daemon.wait_for("fault");
    assert_eq!(status("robot_state"), "protective_stop");
    assert!(status("robot_text").contains("stopped by SIGUSR1"), "{}", status("robot_text"));
    wait_until("a reset that is taken", || daemon.ctl("reset").0 == Some(0));
    daemon.wait_for("idle");
    assert_eq!((status("robot_state"), status("robot_text")), ("ready".into(), String::new()));
    daemon.accepts("start");
    let wait = ["ctl", "wait", "converged", "--timeout-s", "120", "--instance", &daemon.instance.name];
    let wait = vservo().args(wait).output().unwrap();
    assert_eq!(wait.status.code(), Some(0), "{wait:?}");
    daemon.accepts("shutdown");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
}
