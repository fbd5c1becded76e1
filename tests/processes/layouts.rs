//! `vservo layouts`: what it prints is taken by compilers and interpreters of other languages, and says what this program is built from.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::vservo;
use serde_json::Value;
use std::fs;
use std::mem::{offset_of, size_of};
use std::path::Path;
use std::process::Command;
use vservo::messages::{ControlAnswer, DriveStateMsg, TraceMsg};

fn layouts(lang: &str) -> String {
    let output = vservo().args(["layouts", "--lang", lang]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Whether `program` takes the arguments; `None` where it is not installed.
fn taken(program: &str, arguments: &[&str], folder: &Path) -> Option<()> {
    let output = Command::new(program).args(arguments).current_dir(folder).output().ok()?;
    assert!(output.status.success(), "{program}: {}", String::from_utf8_lossy(&output.stderr));
    Some(())
}

#[test]
fn the_header_compiles_in_c_and_in_cpp() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("vservo.h"), layouts("c")).unwrap();
    let used = "#include \"vservo.h\"\n#include \"vservo.h\"\n\
        int main(void) { vservo_DriveState state; state.flags = VSERVO_DRIVE_FLAG_INITIAL; state.robot_state = VSERVO_ROBOT_STATE_READY;\n\
        return VSERVO_SERVICE_DRIVE_STATE[0] != 'd' || state.flags != 4 || VSERVO_DRIVE_STATE_TYPE[0] != 'v'; }\n";
    for (compiler, file, standard) in [("cc", "used.c", "-std=c11"), ("c++", "used.cpp", "-std=c++17")] {
        fs::write(folder.path().join(file), used).unwrap();
        let strict = ["-Wall", "-Wextra", "-Werror", "-pedantic", standard, file, "-o", "used"];
        if taken(compiler, &strict, folder.path()).is_some() {
            taken(folder.path().join("used").to_str().unwrap(), &[], folder.path()).unwrap();
        }
    }
}

/// A wrong offset ends the import, and this test.
#[test]
fn the_module_beside_the_sample_is_what_is_printed() {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/mujoco/vservo_layouts.py");
    let printed = layouts("python");
    assert!(
        fs::read_to_string(&shipped).unwrap() == printed,
        "made anew by `vservo layouts --lang python`: {}",
        shipped.display()
    );
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("vservo_layouts.py"), printed).unwrap();
    let used = "import vservo_layouts as v; s = v.DriveState(flags=v.DriveFlag.INITIAL, robot_state=v.RobotState.READY); \
        assert s.flags & v.DriveFlag.INITIAL and not s.flags & v.DriveFlag.LAST and len(s.q) == v.MAX_JOINTS";
    let _ = taken("python3", &["-c", used], folder.path());
}

#[test]
fn the_places_of_fields_are_those_of_the_program() {
    let document: Value = serde_json::from_str(&layouts("json")).unwrap();
    let place = |record: &str, field: &str| {
        let records = document["records"].as_array().unwrap();
        let record = records.iter().find(|r| r["name"] == record).unwrap();
        let field = record["fields"].as_array().unwrap().iter().find(|f| f["name"] == field).unwrap();
        (record["bytes"].as_u64().unwrap() as usize, field["offset"].as_u64().unwrap() as usize)
    };
    assert_eq!(
        place("DriveState", "q_true"),
        (size_of::<DriveStateMsg>(), offset_of!(DriveStateMsg, q_true))
    );
    assert_eq!(place("Trace", "tau"), (size_of::<TraceMsg>(), offset_of!(TraceMsg, tau)));
    assert_eq!(
        place("ControlAnswer", "state"),
        (size_of::<ControlAnswer>(), offset_of!(ControlAnswer, state))
    );
    assert!(document["services"].as_array().unwrap().iter().any(|s| s["name"] == "drive/text"));
}
