//! Every number of run files and robot files has bounds: set to something huge it is refused by its key, set to something
//! tiny it is refused or does no harm. The keys are taken from the files themselves, so that a new one cannot be forgotten.
//! Of run files that differ little, what an earlier one tried already is tried in every twentieth place; with `VSERVO_CAMPAIGN` in all.

#![allow(non_snake_case, clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use toml::{Table, Value};
use vservo::config::Config;
use vservo::config::assemble::taught_view;
use vservo::control::trace::Trace;
use vservo::sim::{Moment, simulate_system};

/// Long enough for measurements that control uses.
const TICKS: u64 = 45;
/// Numbers that nobody can mean; beyond every bound of every key.
const HUGE: [f64; 2] = [1e308, -1e308];
/// Numbers on which divisions and roots fail.
const TINY: [f64; 3] = [1e-308, -1e-308, 0.0];

/// What every optional key is set to, so that no number is missing from the effective configuration.
const OPTIONAL: &str = "
    camera.name = 'eye'
    camera.roi = { width_px = 640, height_px = 480 }
    camera.v4l2 = { format = 'GREY', input = 0 }
    camera.lens = { cx_px = 319.5, cy_px = 239.5 }
    scene.camera.lens = { model = 'plumb_bob', fx_px = 801.0, fy_px = 801.0, cx_px = 319.0, cy_px = 239.0, k1 = -0.1, k2 = 0.0, p1 = 0.0, \
    p2 = 0.0, k3 = 0.0, k4 = 0.0, k5 = 0.0, k6 = 0.0 }
    scene.camera.mount = { position_m = [0.001, 0.0, 0.0], rotation_rpy_rad = [0.0, 0.0, 0.001] }
    scene.target = { scale = 1.01, side_m = 0.101, radius_m = 0.0101, radius_p1_m = 0.0151, radius_p2_m = 0.0123, margin_m = 0.0301 }
    target.radius_p2_m = 0.0122
    target.dot_grid = { radius_m = 0.006, large_radius_m = 0.0096, margin_m = 0.0225 }
    target.chessboard = { margin_m = 0.01 }
    target.tags = { margin_m = 0.02 }
    target.points = { margin_m = 0.01 }
    target.shape = { semi_axes_m = [0.04, 0.02] }
    scene.arm = { model = 'scara', mass_scale = 1.01, friction_scale = 1.01, q_offset_rad_or_m = [1e-4] }
    servo.adaptive_gain = {}
    servo.points = [1, 2, 3, 4]
    servo.segments = [[1, 2]]
    servo.lead_ms = 10.0
    servo.outline = [1, 2, 3]
    servo.weights = [1.0, 1.0, 1.0, 1.0, 1.0]
    servo.set_point.features = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]
    motion.controller = 'pd_gravity'
    motion.stiffness_n_m_rad_or_n_m = [4000.0]
    motion.damping_n_m_s_rad_or_n_s_m = [400.0]
    motion.velocity_observer_rad_s = 150.0
    motion.encoder_step_rad_or_m = [1e-4]
    workspace = { camera_speed_m_s = 0.5, camera_turn_rad_s = 1.0, flange_speed_m_s = 0.5, tool_m = [0.0, 0.0, 0.05], \
    planes = [{ point_m = [0.0, 0.0, -9.0], normal = [0.0, 0.0, 1.0] }], boxes = [{ min_m = [-9.0, -9.0, -9.0], max_m = [9.0, 9.0, 9.0] }] }
    drive.mode = 'torque'
    drive.simulated.wall = { point_m = [0.0, 0.0, -9.0], normal = [0.0, 0.0, 1.0], stiffness_n_m = 30000.0, damping_n_s_m = 100.0 }
    drive.simulated.push = { force_n = [0.1, 0.0, 0.0], from_s = 0.5, until_s = 0.6 }
    drive.simulated.jam = { joint = 0, from_s = 1000.0 }
    faults = [{ kind = 'delay', from_s = 0.01, duration_s = 0.02, probability = 0.5, delay_ms = 10.0 }, \
    { kind = 'jump', from_s = 0.01, duration_s = 0.02, probability = 0.5, size_px = 2.0 }, { kind = 'corrupt', share = 0.1 }, \
    { kind = 'encoder_offset', size_rad_or_m = 0.001, joint = 0 }]
    safety.guardian_timeout_ms = 100.0
    safety.max_tracking_error_rad_or_m = 0.1
    realtime.cpu = 0
    realtime.spin_us = 50.0
";

fn shipped(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file)
}

/// The place of a number: keys and list entries from the root on.
type Place = Vec<Step>;

#[derive(Debug, Clone, PartialEq)]
enum Step {
    Key(String),
    Entry(usize),
}

fn numbers(value: &Value, place: &mut Place, found: &mut Vec<Place>) {
    let mut within = |step: Step, inner: &Value| {
        place.push(step);
        numbers(inner, place, found);
        place.pop();
    };
    match value {
        Value::Table(table) => table.iter().for_each(|(key, inner)| within(Step::Key(key.clone()), inner)),
        Value::Array(list) => list.iter().enumerate().for_each(|(i, inner)| within(Step::Entry(i), inner)),
        Value::Integer(_) | Value::Float(_) => found.push(place.clone()),
        _ => {}
    }
}

fn all_numbers(table: &Table) -> Vec<Place> {
    let mut found = Vec::new();
    numbers(&Value::Table(table.clone()), &mut Vec::new(), &mut found);
    found
}

fn at<'a>(mut value: &'a mut Value, place: &[Step]) -> &'a mut Value {
    for step in place {
        value = match step {
            Step::Key(key) => &mut value[key.as_str()],
            Step::Entry(i) => &mut value[*i],
        };
    }
    value
}

/// The table with another number at `place`; whole numbers stay whole as far as they can.
fn with(table: &Table, place: &[Step], number: f64) -> Table {
    let mut value = Value::Table(table.clone());
    let old = at(&mut value, place);
    let whole = old.is_integer() && (number == 0.0 || number.abs() < 1e-300);
    *old = if whole { Value::Integer(0) } else { Value::Float(number) };
    match value {
        Value::Table(table) => table,
        _ => unreachable!(),
    }
}

fn written(place: &[Step]) -> String {
    let mut text = String::new();
    for step in place {
        match step {
            Step::Key(key) if text.is_empty() => text += key,
            Step::Key(key) => text += &format!(".{key}"),
            Step::Entry(i) => text += &format!("[{i}]"),
        }
    }
    text
}

/// The last key of a place, without list entries.
fn last_key(place: &[Step]) -> &str {
    place.iter().rev().find_map(|s| if let Step::Key(key) = s { Some(key.as_str()) } else { None }).unwrap()
}

fn parse(table: &Table, folder: &Path) -> Result<Config, String> {
    Config::parse("run.toml", &table.to_string(), folder, &[]).map_err(|e| e.to_string())
}

/// Runs the first ticks of a configuration in this process; every command must be finite.
fn run(config: &Config) -> Result<(), String> {
    let mut wrong = Ok(());
    let mut config = config.clone();
    // of images of a simulated pair: once, for the vision and for the law
    if let Ok(view) = taught_view(&config) {
        config.stereo.as_mut().unwrap().taught = Some(view);
    }
    simulate_system(&config, &mut |moment| {
        let Moment::Tick(Trace { joint_state, .. }, _) = moment else { return ControlFlow::Continue(()) };
        let commanded = joint_state.tau.iter().chain(&joint_state.q_r).chain(&joint_state.qd_r);
        if !commanded.clone().all(|x| x.is_finite()) {
            wrong = Err(format!("tick {}: {:?}", joint_state.tick, commanded.collect::<Vec<_>>()));
        }
        if wrong.is_ok() && joint_state.tick + 1 < TICKS {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    })
    .map_err(|e| e.to_string())?;
    wrong
}

/// The effective configuration of a run file, with small images so that many runs are quick.
fn effective(file: &str, extra: &str) -> Table {
    let text = std::fs::read_to_string(shipped(file)).unwrap();
    let mut table: Table = text.parse().unwrap();
    merge(&mut table, extra.parse().unwrap());
    let config = parse(&table, shipped(file).parent().unwrap()).unwrap();
    config.to_toml().unwrap().parse().unwrap()
}

fn merge(table: &mut Table, other: Table) {
    for (key, value) in other {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(value)) => merge(inner, value),
            (_, value) => drop(table.insert(key, value)),
        }
    }
}

/// From which values, by place, the numbers of earlier tables were changed, and how many tables there were.
#[derive(Default)]
struct Tried {
    values: BTreeMap<String, BTreeSet<String>>,
    tables: usize,
}

/// Sets every number of `table` to huge and tiny ones; `load` makes a configuration of the changed table.
fn every_number(
    table: &Table,
    label: &str,
    load: &dyn Fn(&Table) -> Result<Config, String>,
    tried: &mut Tried,
) -> usize {
    run(&load(table).unwrap()).unwrap();
    let places = all_numbers(table);
    let all = std::env::var_os("VSERVO_CAMPAIGN").is_some();
    let mut wrong = Vec::new();
    for (k, place) in places.iter().enumerate() {
        let key = written(place);
        if key == "run.seed" {
            continue; // any whole number is a seed
        }
        let value = at(&mut Value::Table(table.clone()), place).to_string();
        let is_new = tried.values.entry(key.clone()).or_default().insert(value);
        // Other places in every table, so that each comes again in some of them.
        if !is_new && !all && !(k + tried.tables).is_multiple_of(20) {
            continue;
        }
        for number in HUGE {
            match load(&with(table, place, number)) {
                Ok(_) => wrong.push(format!("{label}: {key} = {number:e} is accepted")),
                Err(message) if message.contains(last_key(place)) && !message.contains("00000000000000") => {}
                Err(message) => wrong.push(format!("{label}: {key} = {number:e}: {message}")),
            }
        }
        for number in TINY {
            match load(&with(table, place, number)) {
                Ok(config) => {
                    if let Err(what) = run(&config) {
                        wrong.push(format!("{label}: {key} = {number:e}: {what}"));
                    }
                }
                Err(message) => {
                    let named = message.contains(last_key(place)) || of_the_whole(&message);
                    if !named {
                        wrong.push(format!("{label}: {key} = {number:e}: {message}"));
                    }
                }
            }
        }
    }
    tried.tables += 1;
    assert!(wrong.is_empty(), "{} of {}:\n{}", wrong.len(), places.len(), wrong.join("\n"));
    places.len()
}

/// Refusals of small numbers that only the whole can tell: a target out of view, a link without a possible inertia.
fn of_the_whole(message: &str) -> bool {
    [
        // of run files
        "point ",
        "target: ",
        "is tilted",
        "no pose of the target",
        "needs servo.desired",
        "longer than a frame",
        "robot.q_start_rad_or_m[",
        "of [workspace]",
        // of pairs of cameras
        "says where this camera sits",
        "both cameras sit in one place",
        // of robots
        "B(q)",
        "positive definite",
        "triangle",
        "a positive mass",
        "reversed",
        "axis is zero",
    ]
    .iter()
    .any(|words| message.contains(words))
}

#[test]
fn every_number_of_a_run_file() {
    let folder = shipped("");
    let load = |table: &Table| parse(table, &folder);
    let quick = "goal.hold_s = 0.01\n";
    let mut tried = Tried::default();
    for (file, extra) in [
        ("default.toml", OPTIONAL),
        ("default.toml", quick),
        (
            "default.toml",
            "target.kind = 'dot_grid'\ntarget.dot_grid.pitch_m = 0.015\nscene.occluder = { until_s = 1.0, center_m = [0.03, 0.03] }\n",
        ),
        (
            "default.toml",
            "drive.mode = 'velocity'\nservo.smooth_start_1_s = 3.0\nservo.limit_avoidance_1_s = 0.1\n",
        ),
        ("default.toml", "servo.object.moves = true\nscene.motion.kind = 'pendulum'\n"),
        (
            "default.toml",
            "servo.adaptive_gain = {}\nservo.depth = 'constant'\nservo.set_point.kind = 'taught'\n",
        ),
        (
            "default.toml",
            "scene.motion.kind = 'conveyor'\ncamera.synthetic = { latency_jitter_ms = 3.0, frame_loss = 0.1 }\n",
        ),
        (
            "default.toml",
            "drive.simulated = { encoder_step_rad_or_m = [1e-5], encoder_noise_sd_rad_or_m = [1e-5], payload_kg = 1.0, \
             substeps = 2, command_delay_ticks = 1 }\n",
        ),
        (
            "default.toml",
            "scene.backdrop = { texture_levels = 20.0, clutter = 5 }\nscene.occluders = [{ until_s = 1.0, center_m = [0.2, 0.2] }]\n\
             scene.bystanders = [{ target = 'dots:4x3:0.01' }]\n",
        ),
        (
            "default.toml",
            "target.kind = 'tags'\ntarget.tags.places = [{ id = 3, position_m = [0.03, 0.03] }]\ntarget.tags.size_m = 0.08\n",
        ),
        ("scara-a.toml", ""),
        ("scara-a.toml", "servo.pd.damping = 'joints'\n"),
        ("scara-b.toml", ""),
        ("scara-c.toml", ""),
        ("scara-hybrid.toml", ""),
        ("scara-eye-to-hand.toml", ""),
        ("ur5-path.toml", ""),
        ("dot-cube.toml", ""),
        ("ur5.toml", "motion.controller = 'pd_gravity'\n"),
        ("panda.toml", ""),
        ("stereo.toml", ""),
    ] {
        let table = effective(file, extra);
        let count = every_number(
            &table,
            &format!("{file} {}", extra.trim().lines().next().unwrap_or("-")),
            &load,
            &mut tried,
        );
        assert!(count > 100, "{count} numbers");
    }
}

/// The optional keys above are all that there are: what the reader of each table expects stands in the effective file.
#[test]
fn no_optional_key_is_forgotten() {
    fn tables(table: &Table, path: &str, found: &mut Vec<(String, BTreeSet<String>)>) {
        found.push((path.into(), table.keys().cloned().collect()));
        for (key, value) in table {
            if let Value::Table(inner) = value {
                tables(inner, &if path.is_empty() { key.clone() } else { format!("{path}.{key}") }, found);
            }
        }
    }
    let mut found = Vec::new();
    tables(&effective("default.toml", OPTIONAL), "", &mut found);
    assert!(found.len() > 20, "{}", found.len());
    for (path, written) in found {
        let set = format!("{path}{}nonsense=1", if path.is_empty() { "" } else { "." });
        let error = Config::load(None, &[set]).unwrap_err().to_string();
        let expected = error.split_once(", expected ").unwrap().1;
        let mut expected: BTreeSet<String> =
            expected.split('`').skip(1).step_by(2).map(String::from).collect();
        if path == "camera.v4l2" {
            expected.remove("controls"); // whose names are the device's
        }
        if path == "camera.lens" || path == "servo.set_point" {
            expected.remove("file"); // which stands for others
        }
        expected.remove("cameras"); // a list of what [camera] is, which is there
        expected.remove("second_view"); // of two cameras: tables that are there, and a weight (config/second_view/tests.rs)
        for named in ["goals", "postures", "targets", "objects"] {
            expected.remove(named); // whose names are the user's: config/named_goal.rs, config/targets.rs
        }
        for word in [("camera.replay", "topic"), ("camera.mount", "link"), ("scene.camera.mount", "link")] {
            if path == word.0 {
                expected.remove(word.1);
            }
        }
        expected.remove("stereo"); // which two cameras have: stereo.toml above
        for form in ["rotation_rpy_deg", "rotation_xyzw", "rotation_vector_rad", "matrix"] {
            expected.remove(form); // of which position_m and rotation_rpy_rad are made: config/pose_forms/tests.rs
        }
        for list in ["occluders", "bystanders", "places", "poses"] {
            expected.remove(list); // of tables, in which every_number_of_a_run_file sets each number
        }
        if path == "scene.object" {
            expected.remove("motion"); // of a further target: config/targets.rs
        }
        if path == "target.points" {
            expected.remove("tags"); // likewise
            expected.remove("faces"); // likewise, of dot-cube.toml
        }
        assert_eq!(written, expected, "[{path}]");
    }
}

/// A table that names every number a DH file may hold, on an arm in front of which the default target lies.
fn arm_of_rows() -> Table {
    let text = std::fs::read_to_string(shipped("robot/scara.toml")).unwrap();
    let mut table: Table = text.parse().unwrap();
    table.insert(
        "tool".into(),
        Value::Table("position_m = [0.0, 0.0, 0.0]\nrpy_rad = [0.0, 0.0, 0.0]".parse().unwrap()),
    );
    for (i, joint) in table["dh"]["joint"].as_array_mut().unwrap().iter_mut().enumerate() {
        let sliding = joint["type"].as_str() == Some("prismatic");
        let joint = joint.as_table_mut().unwrap();
        for key in ["a_m", "alpha_rad", "d_m", "theta_rad"] {
            joint.entry(key).or_insert(Value::Float(0.0));
        }
        let (friction, armature) = if sliding {
            ("viscous_n_s_m = 1.0\ncoulomb_n = 1.0", "armature_kg")
        } else {
            ("viscous_n_m_s_rad = 1.0\ncoulomb_n_m = 1.0", "armature_kg_m2")
        };
        joint.insert("friction".into(), Value::Table(friction.parse().unwrap()));
        joint.insert(armature.into(), Value::Float(0.1));
        let motor = "mass_kg = 1.0\ninertia_kg_m2 = 0.001\ngear_ratio = 50.0";
        joint.insert("motor".into(), Value::Table(motor.parse().unwrap()));
        let inertia = joint["link"]["inertia_kg_m2"].as_table_mut().unwrap();
        for key in ["xy", "xz", "yz"] {
            inertia.insert(key.into(), Value::Float(0.0));
        }
        joint["link"]
            .as_table_mut()
            .unwrap()
            .entry("com_m")
            .or_insert(Value::Array(vec![Value::Float(0.0); 3]));
        joint["name"] = Value::String(format!("j{i}"));
    }
    table
}

#[test]
fn every_number_of_a_robot_in_rows() {
    let folder = tempfile::tempdir().unwrap();
    let load = |table: &Table| {
        std::fs::write(folder.path().join("arm.toml"), table.to_string()).unwrap();
        parse(&"robot.model = 'arm.toml'".parse().unwrap(), folder.path())
    };
    for convention in ["standard", "modified"] {
        let mut table = arm_of_rows();
        if convention == "modified" {
            // The same arm: each row's a belongs to the next one.
            table["dh"]["convention"] = Value::String(convention.into());
            let mut before = Value::Float(0.0);
            for joint in table["dh"]["joint"].as_array_mut().unwrap() {
                std::mem::swap(&mut joint.as_table_mut().unwrap()["a_m"], &mut before);
            }
        }
        let count = every_number(&table, convention, &load, &mut Tried::default());
        assert!(count > 100, "{count} numbers");
    }
    // Nothing is left out of the table above.
    let text =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/core/robot/dh.rs")).unwrap();
    let known: BTreeSet<String> =
        all_numbers(&arm_of_rows()).iter().map(|p| last_key(p).to_owned()).collect();
    for line in text
        .lines()
        .filter(|l| l.contains(": f64,") || l.contains(": Option<f64>,") || l.contains(": [f64; 3],"))
    {
        let field = line.trim().split(':').next().unwrap().trim_start_matches("pub(super) ");
        if field.ends_with(char::is_alphanumeric) && !field.contains(' ') {
            assert!(known.contains(field), "{field} of dh.rs is not tried");
        }
    }
}

/// Every number within quotation marks of a URDF, on the UR5 in front of its target; the ones of shapes are not looked at.
#[test]
fn every_number_of_a_urdf() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(shipped("robot/ur5.urdf")).unwrap();
    let robot = std::fs::read_to_string(shipped("robot/ur5.toml")).unwrap();
    let mut run_file: Table = std::fs::read_to_string(shipped("ur5.toml")).unwrap().parse().unwrap();
    run_file["robot"]["model"] = Value::String("arm.toml".into());
    let load = |urdf: &str| {
        std::fs::write(folder.path().join("ur5.urdf"), urdf).unwrap();
        std::fs::write(folder.path().join("arm.toml"), &robot).unwrap();
        parse(&run_file, folder.path())
    };
    let sound = load(&text).unwrap();
    run(&sound).unwrap();
    let mut tried = 0;
    let mut wrong = Vec::new();
    // From quotation mark to quotation mark: every second part is an attribute's value.
    let parts: Vec<&str> = text.split('"').collect();
    for (i, part) in parts.iter().enumerate().skip(1).step_by(2) {
        let words: Vec<&str> = part.split_whitespace().collect();
        if words.is_empty() || words.iter().any(|w| w.parse::<f64>().is_err()) {
            continue;
        }
        let attribute = parts[i - 1].trim_end_matches('=').split_whitespace().last().unwrap();
        for j in 0..words.len() {
            for number in HUGE.into_iter().chain(TINY) {
                let mut words: Vec<String> = words.iter().map(|w| w.to_string()).collect();
                words[j] = format!("{number:e}");
                let value = words.join(" ");
                let mut parts = parts.clone();
                parts[i] = &value;
                tried += 1;
                let label = format!("part {i} {attribute}=\"{value}\"");
                match load(&parts.join("\"")) {
                    // What is no part of the arm, beside or before its base, may be anything.
                    // A limit that no joint has is none, which is told.
                    Ok(config)
                        if number.abs() > 1.0
                            && config.robot != sound.robot
                            && !["effort", "velocity", "lower", "upper"].contains(&attribute) =>
                    {
                        wrong.push(format!("{label} is accepted"));
                    }
                    Ok(config) => wrong.extend(run(&config).err().map(|what| format!("{label}: {what}"))),
                    Err(e) if e.contains(attribute) || (attribute == "value" && e.contains("mass")) => {}
                    Err(e) if number.abs() < 1.0 && of_the_whole(&e) => {}
                    Err(e) => wrong.push(format!("{label}: {e}")),
                }
            }
        }
    }
    assert!(tried > 500, "{tried}");
    assert!(wrong.is_empty(), "{} of {tried}:\n{}", wrong.len(), wrong.join("\n"));
}

/// What URDF has no place for stands in the TOML file beside it.
#[test]
fn every_number_beside_a_urdf() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(shipped("robot/panda.urdf"), folder.path().join("panda.urdf")).unwrap();
    let text = std::fs::read_to_string(shipped("robot/panda.toml")).unwrap();
    let mut table: Table = text.parse().unwrap();
    let more = "gravity_m_s2 = [0.0, 0.0, -9.81]\n[tool]\nposition_m = [0.0, 0.0, 0.0]\nrpy_rad = [0.0, 0.0, 0.0]\n\
                [[urdf.joint]]\nname = \"panda_joint1\"\narmature_kg_m2 = 0.01\n\
                motor = { mass_kg = 1.0, inertia_kg_m2 = 1e-4, gear_ratio = 100.0 }\n";
    merge(&mut table, more.parse().unwrap());
    let mut run_file: Table = std::fs::read_to_string(shipped("panda.toml")).unwrap().parse().unwrap();
    run_file["robot"]["model"] = Value::String("arm.toml".into());
    let load = |table: &Table| {
        std::fs::write(folder.path().join("arm.toml"), table.to_string()).unwrap();
        parse(&run_file, folder.path())
    };
    assert!(every_number(&table, "beside", &load, &mut Tried::default()) >= 15);
}

/// `check` and `run` have one set of bounds: what `check` takes can be built, at both ends of every range.
#[test]
fn what_passes_the_check_can_be_run_at_both_ends_of_every_range() {
    let folder = shipped("");
    let table = effective("default.toml", "");
    let mut tried = 0;
    for place in all_numbers(&table) {
        let key = written(&place);
        let Err(message) = parse(&with(&table, &place, 1e308), &folder) else { continue };
        let Some((_, allowed)) = message.split_once("allowed is ") else { continue };
        for end in allowed.lines().next().unwrap().split(" to ") {
            let end: f64 = end.parse().unwrap();
            let mut changed = Value::Table(table.clone());
            let old = at(&mut changed, &place);
            *old = if old.is_integer() { Value::Integer(end as i64) } else { Value::Float(end) };
            if let Ok(config) = parse(changed.as_table().unwrap(), &folder) {
                tried += 1;
                run(&config).unwrap_or_else(|what| panic!("{key} = {end}: {what}"));
            }
        }
    }
    assert!(tried > 100, "{tried}");
}
