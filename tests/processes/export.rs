//! `vservo export`: what other programs get of a recording, read by their own readers, and compared with what was recorded and with the cell.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests
#![allow(non_snake_case)] // monogram notation

use crate::common::{run, vservo};
use crate::record::python;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::process::Command;
use vservo::config::Config;
use vservo::messages::{JointState, Measurement};
use vservo::record::{RUN_FILE, RecordingReader};

fn recorded(file: &str, folder: &Path) -> std::path::PathBuf {
    let path = folder.join("run.mcap");
    run("export", &[file, "--clock", "lockstep", "--record", path.to_str().unwrap()]);
    path
}

fn export(recording: &Path, purpose: &str, out: &Path) -> String {
    let output =
        vservo().arg("export").arg(recording).args(["--for", purpose, "--out"]).arg(out).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The bytes of all messages by topic, in their order.
fn messages(path: &Path) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut reader = RecordingReader::open(File::open(path).unwrap()).unwrap();
    let mut all: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    while let Some(message) = reader.next_message().unwrap() {
        all.entry(message.topic().into()).or_default().push(message.data().to_vec());
    }
    assert_eq!(reader.cut_off(), None);
    all
}

/// A byte that the disk has changed, and a file whose end is gone: what comes before is exported and reported, and a word says that it is not all.
#[test]
fn what_a_damaged_recording_leaves_out_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded("default", folder.path());
    let whole = std::fs::read(&recording).unwrap();
    let (out, page) = (folder.path().join("out"), folder.path().join("page"));
    let mut changed = whole.clone();
    changed[whole.len() / 2] ^= 0x55;
    for (damaged, is_whole) in [(&whole[..], true), (&changed, false), (&whole[..whole.len() / 2], false)] {
        std::fs::write(&recording, damaged).unwrap();
        let told = |arguments: &[&Path]| {
            let output = vservo().args(arguments).output().unwrap();
            assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
            String::from_utf8_lossy(&output.stderr).matches("what follows is left out").count()
        };
        let word = usize::from(!is_whole);
        let purpose = [Path::new("--for"), Path::new("csv"), Path::new("--out"), &out];
        assert_eq!(told(&[&[Path::new("export"), &recording], &purpose[..]].concat()), word);
        assert_eq!(told(&[Path::new("report"), &recording, &page]), word);
        std::fs::remove_dir_all(&out).unwrap();
        std::fs::remove_dir_all(&page).unwrap();
    }
}

#[test]
fn what_was_recorded_is_in_an_export_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded("default", folder.path());
    let before = messages(&recording);
    for (purpose, annotated) in [("foxglove", true), ("ros2", false)] {
        let out = folder.path().join(purpose);
        export(&recording, purpose, &out);
        let after = messages(&out);
        for (topic, messages) in &before {
            assert!(after[topic] == *messages, "{purpose}: {topic}");
        }
        assert_eq!(after.contains_key("/camera/0/annotations"), annotated, "{purpose}");
        let frames = after["/camera/0/frame"].len();
        assert_eq!(after["/camera/0/camera_info"].len(), frames);
        assert_eq!(after["/tf_static"].len(), 1);
        let ticks = after["/control/joint_state"].len();
        assert_eq!(after["/joint_states"].len(), ticks.div_ceil(10), "every tenth tick");
    }
    let onto_itself = vservo()
        .arg("export")
        .arg(&recording)
        .args(["--for", "ros2", "--out"])
        .arg(&recording)
        .output()
        .unwrap();
    assert_eq!(onto_itself.status.code(), Some(2));
    assert!(messages(&recording) == before);
}

/// The official reader: transforms are chained by a program of its own, and the end of a chain is compared with the cell.
const READ: &str = "
import json, sys
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
def times(a, b):
    (p, q), (r, s) = a, b
    x, y, z, w = q
    t = [2 * (y * r[2] - z * r[1]), 2 * (z * r[0] - x * r[2]), 2 * (x * r[1] - y * r[0])]
    turned = [r[0] + w * t[0] + y * t[2] - z * t[1], r[1] + w * t[1] + z * t[0] - x * t[2], r[2] + w * t[2] + x * t[1] - y * t[0]]
    i, j, k, l = s
    return [p[n] + turned[n] for n in range(3)], [w*i + x*l + y*k - z*j, w*j - x*k + y*l + z*i, w*k + x*j - y*i + z*l, w*l - x*i - y*j - z*k]
parents, out = {}, {'log': [], 'types': {}}
with open(sys.argv[1], 'rb') as file:
    for schema, channel, message, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(log_time_order=False):
        out['types'][channel.topic] = schema.name
        if channel.topic in ('/tf', '/tf_static'):
            for t in m.transforms:
                p, q = t.transform.translation, t.transform.rotation
                parents[t.child_frame_id] = (t.header.frame_id, ([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]))
        elif channel.topic == '/rosout':
            out['log'].append([m.level, m.name, m.msg])
        elif channel.topic == '/joint_states':
            out['joints'] = [list(m.name), list(m.position), list(m.velocity), list(m.effort)]
        elif channel.topic == '/camera/0/camera_info':
            out['camera'] = [m.width, m.height, m.distortion_model, list(m.d), list(m.k), m.header.frame_id]
        elif channel.topic == '/camera/0/annotations':
            out['circles'] = [[c.position.x, c.position.y] for c in m.circles]
            out['lines'] = [len(p.points) for p in m.points]
            out['texts'] = [t.text for t in m.texts]
chain, frame = ([0, 0, 0], [0, 0, 0, 1]), 'target'
while frame in parents:
    parent, pose = parents[frame]
    chain, frame = times(pose, chain), parent
out['root'], out['target'], out['parents'] = frame, chain, {child: parent for child, (parent, _) in parents.items()}
print(json.dumps(out))
";

#[test]
fn the_official_reader_finds_the_cell_in_an_export() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded("ur5", folder.path());
    let out = folder.path().join("foxglove.mcap");
    export(&recording, "foxglove", &out);
    let output = Command::new(python).args(["-c", READ]).arg(&out).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut reader = RecordingReader::open(File::open(&recording).unwrap()).unwrap();
    let text = String::from_utf8(reader.attachments()[RUN_FILE].clone()).unwrap();
    let config = Config::parse("recorded", &text, Path::new("/"), &[]).unwrap();
    let (mut measurement, mut states) = (None, Vec::new());
    while let Some(message) = reader.next_message().unwrap() {
        match message.topic() {
            "/vision/0/measurement" => measurement = Some(message.record::<Measurement>().unwrap()),
            "/control/joint_state" => states.push(message.record::<JointState>().unwrap()),
            _ => {}
        }
    }
    // Base, links, flange, camera, target: where the scene has the object. The arm stands at the end, so that the last of each belong together.
    assert_eq!(read["root"], "base", "{read}");
    let number = |value: &Value| value.as_f64().unwrap();
    let X_WO = config.X_WO().unwrap();
    for (i, wanted) in X_WO.translation.vector.iter().enumerate() {
        let found = number(&read["target"][0][i]);
        assert!((found - wanted).abs() < 2e-3, "{found}, not {wanted}: {read}");
    }
    let q: Vec<f64> = (0..4).map(|i| number(&read["target"][1][i])).collect();
    let along: f64 = q.iter().zip(X_WO.rotation.coords.iter()).map(|(a, b)| a * b).sum();
    assert!(along.abs() > 0.999_99, "{q:?}, not {}", X_WO.rotation);
    assert_eq!(read["parents"]["goal"], "target");
    // Joints, camera and points are the recorded ones.
    let state = states.iter().rev().find(|state| state.tick % 10 == 0).unwrap();
    for i in 0..6 {
        assert_eq!(read["joints"][0][i], config.robot.joints[i].name.as_str());
        // as JSON is read here, to the last digit but one
        for (at, wanted) in [(1, state.q[i]), (3, state.tau[i])] {
            assert!(
                (number(&read["joints"][at][i]) - wanted).abs() <= 1e-14 * wanted.abs().max(1e-3),
                "{read}"
            );
        }
    }
    let i = config.camera.model.intrinsics();
    let camera = &read["camera"];
    assert_eq!((camera[0].as_u64(), camera[1].as_u64()), (Some(640), Some(480)));
    assert_eq!((number(&camera[4][0]), number(&camera[4][5])), (i.fx_px, i.cy_px));
    assert_eq!(camera[5], "camera_0");
    let m = measurement.unwrap();
    let circles = read["circles"].as_array().unwrap();
    assert_eq!((circles.len(), read["texts"].as_array().unwrap().len()), (8, 4), "{read}");
    for (feature, circle) in m.features().iter().zip(circles) {
        let off = (number(&circle[0]) - feature.u_px).hypot(number(&circle[1]) - feature.v_px);
        assert!(off < 1e-9, "{off} px: {read}");
    }
    // A run that has converged ends with each point on its goal.
    for (seen, goal) in circles.iter().zip(&circles[4..]) {
        let off = (number(&seen[0]) - number(&goal[0])).hypot(number(&seen[1]) - number(&goal[1]));
        assert!(off < 0.2, "{off} px: {read}");
    }
    assert_eq!(read["lines"][0], 8);
    let log = read["log"].as_array().unwrap();
    assert!(log.iter().any(|line| line[1] == "control" && line[2] == "state: servoing"), "{log:?}");
    for (topic, kind) in
        [("/tf", "tf2_msgs/msg/TFMessage"), ("/camera/0/annotations", "foxglove_msgs/msg/ImageAnnotations")]
    {
        assert_eq!(read["types"][topic], kind);
    }
}

/// A Python whose rerun can convert files, if there is one.
fn rerun() -> Option<std::path::PathBuf> {
    let python = std::env::var_os("VSERVO_PYTHON").unwrap_or_else(|| "python3".into());
    let output = Command::new(&python).args(["-m", "rerun", "mcap", "--help"]).output();
    if output.as_ref().is_ok_and(|o| o.status.success()) {
        return Some(python.into());
    }
    assert!(std::env::var_os("VSERVO_REQUIRE_RERUN").is_none(), "{}: {output:?}", python.display());
    println!("skipped: {} has no rerun-sdk", python.display());
    None
}

/// What rerun takes for what is told by its own program: the names of its archetypes by topic.
#[test]
fn rerun_knows_images_arm_camera_and_log_by_itself() {
    let Some(python) = rerun() else { return };
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded("ur5", folder.path());
    let (out, converted) = (folder.path().join("rerun.mcap"), folder.path().join("run.rrd"));
    let told = export(&recording, "rerun", &out);
    assert!(told.contains("/camera/0/frame ") && !told.contains("annotations"), "{told}");
    // Its settings, and what it writes down of its use, are not those of whoever runs the test.
    let of_rerun = |arguments: &[&std::ffi::OsStr]| {
        let mut command = Command::new(&python);
        command
            .args(["-m", "rerun"])
            .args(arguments)
            .env("HOME", folder.path())
            .env("XDG_CONFIG_HOME", folder.path());
        let output = command.env("NO_COLOR", "1").output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    of_rerun(&["mcap".as_ref(), "convert".as_ref(), out.as_os_str(), "-o".as_ref(), converted.as_os_str()]);
    let chunks = of_rerun(&["rrd".as_ref(), "print".as_ref(), converted.as_os_str()]);
    for (topic, archetype) in [
        ("/camera/0/frame", "EncodedImage:blob"),
        ("/camera/0/camera_info", "Pinhole:image_from_camera"),
        ("/tf", "Transform3D:translation"),
        ("/tf_static", "Transform3D:translation"),
        ("/joint_states/position", "Scalars:scalars"),
        ("/rosout", "TextLog:text"),
        ("/control/trace", "vservo.msg.Trace:message"),
    ] {
        let of_topic = format!(" - {topic} - ");
        let is_there = chunks.lines().any(|line| line.contains(&of_topic) && line.contains(archetype));
        assert!(is_there, "{topic} has no {archetype}: {chunks}");
    }
    assert!(!chunks.contains("DepthImage"), "a grey image is no depth: {chunks}");
}

#[test]
fn tables_have_units_and_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded("default", folder.path());
    let out = folder.path().join("tables");
    let told = export(&recording, "csv", &out);
    let mut reader = RecordingReader::open(File::open(&recording).unwrap()).unwrap();
    let mut states = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if message.topic() == "/control/joint_state" {
            states.push(message.record::<JointState>().unwrap());
        }
    }
    let text = std::fs::read_to_string(out.join("control_joint_state.csv")).unwrap();
    let mut lines = text.lines();
    let names: Vec<_> = lines.next().unwrap().split(',').collect();
    let column =
        |name: &str| names.iter().position(|n| *n == name).unwrap_or_else(|| panic!("{name}: {names:?}"));
    let (stamp, turns, slides, force) =
        (column("stamp_ns"), column("q_1_rad"), column("q_3_m"), column("tau_3_n"));
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), states.len());
    for (row, state) in rows.iter().zip(&states) {
        assert_eq!(row[stamp].parse::<i64>().unwrap(), state.stamp.0);
        for (at, value) in [(turns, state.q[0]), (slides, state.q[2]), (force, state.tau[2])] {
            assert_eq!(row[at].parse::<f64>().unwrap().to_bits(), value.to_bits());
        }
    }
    let measurements = std::fs::read_to_string(out.join("vision_0_measurement.csv")).unwrap();
    assert!(measurements.starts_with("frame_id,exposure_ns,") && measurements.contains("features_4_v_px"));
    assert!(!measurements.contains("features_5_"), "the target has four points");
    assert!(told.contains("control_trace.csv") && !told.contains("frame.csv"), "{told}");
}
