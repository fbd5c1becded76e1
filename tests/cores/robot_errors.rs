//! Bad robot files: every one is refused with its file, its element and what to do about it.

#![allow(non_snake_case, clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // helpers of tests are tests

use vservo::robot::{Robot, RobotError, load};

/// A sound arm of two joints, `base - shoulder - upper - elbow - fore`, with a mesh that is not there.
const GOOD: &str = r#"<robot name="two">
  <link name="base"/>
  <link name="upper">
    <visual><geometry><mesh filename="package://nowhere/upper.dae"/></geometry></visual>
    <inertial><origin xyz="0 0 0.1"/><mass value="2"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial>
  </link>
  <link name="fore">
    <inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
  </link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="2" effort="9"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="0.3 0 0"/><parent link="upper"/><child link="fore"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="9"/></joint>
</robot>"#;

const SHOULDER_LIMIT: &str = r#"<limit lower="-1" upper="1" velocity="2" effort="9"/>"#;
const FORE_INERTIAL: &str = r#"<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>"#;

fn load_text(text: &str, suffix: &str) -> Result<(), RobotError> {
    let file = tempfile::Builder::new().prefix("bad").suffix(suffix).tempfile().unwrap();
    std::fs::write(file.path(), text).unwrap();
    vservo::dispatch_robot!(load(file.path().to_str().unwrap())?, |_robot| ())
}

/// The message of a URDF that differs from the sound one in `from` -> `to`; it must hold `file` and all `parts`.
fn refused(from: &str, to: &str, parts: &[&str]) {
    assert!(GOOD.contains(from), "{from} is not in the sound file");
    refused_text(&GOOD.replacen(from, to, 1), ".urdf", parts);
}

fn refused_text(text: &str, suffix: &str, parts: &[&str]) {
    let message = load_text(text, suffix).expect_err(text).to_string();
    println!("{message}");
    for part in parts.iter().chain(&["bad", suffix]) {
        assert!(message.contains(part), "`{part}` is not in: {message}");
    }
}

#[test]
fn the_sound_file_loads_and_meshes_are_not_looked_for() {
    load_text(GOOD, ".urdf").unwrap();
}

#[test]
fn malformed_xml() {
    refused("</robot>", "", &[".urdf:1:", "robot \"two\" is never closed"]);
    refused(
        "izz=\"0.01\"/></inertial>",
        "izz=\"0.01\"/>",
        &[".urdf:7:", "`</link>` stands where `<inertial>` should be closed"],
    );
    refused(
        "<mass value=\"1\"/>",
        "<mass value=\"heavy\"/>",
        &[".urdf:9:", "link \"fore\"", "`heavy`; it must be a number"],
    );
    refused(
        "type=\"revolute\"",
        "type=\"springy\"",
        &[".urdf:11:", "joint \"shoulder\"", "`springy`; it must be one of revolute"],
    );
    refused("<mass value=\"1\"/>", "", &[".urdf:9:", "link \"fore\"", "`<inertial>` holds no `<mass>`"]);
    refused_text("", ".urdf", &["no `<robot>`"]);
    refused_text("<robot><body/></robot>", ".urdf", &["no <link>"]);
    refused_text("<html><body/></html>", ".urdf", &["`<html>`; a URDF has one, `<robot>`"]);
    refused_text("<html><link/></html>", ".urdf", &["`<html>`"]);
}

#[test]
fn loops() {
    refused(
        "</robot>",
        "<joint name=\"back\" type=\"fixed\"><parent link=\"fore\"/><child link=\"upper\"/></joint></robot>",
        &["joint \"back\"", "loop", "upper"],
    );
    refused(
        "</robot>",
        "<joint name=\"back\" type=\"fixed\"><parent link=\"fore\"/><child link=\"base\"/></joint></robot>",
        &["link \"base\"", "loop"],
    );
}

#[test]
fn links_that_do_not_exist() {
    refused(
        "<child link=\"fore\"/>",
        "<child link=\"hand\"/>",
        &["joint \"elbow\"", "hand", "does not exist"],
    );
}

#[test]
fn several_roots() {
    refused("<link name=\"base\"/>", "<link name=\"base\"/><link name=\"stray\"/>", &["root links", "stray"]);
}

#[test]
fn branches_that_are_not_named() {
    let branch = |kind: &str| {
        format!(
            "<link name=\"side\">{FORE_INERTIAL}</link><joint name=\"side_joint\" type=\"{kind}\"><parent link=\"upper\"/>\
             <child link=\"side\"/>{SHOULDER_LIMIT}</joint></robot>"
        )
    };
    refused("</robot>", &branch("fixed"), &["tip", "branches", "fore, side"]);

    // Named, a fixed branch is welded on; one that moves has no place.
    let folder = tempfile::tempdir().unwrap();
    let toml = folder.path().join("bad.toml");
    let write = |kind: &str, extra: &str| {
        std::fs::write(folder.path().join("two.urdf"), GOOD.replace("</robot>", &branch(kind))).unwrap();
        let text = format!("name = \"two\"\n[urdf]\nfile = \"two.urdf\"\n{extra}");
        std::fs::write(&toml, text).unwrap();
        load(toml.to_str().unwrap()).map_err(|e| e.to_string())
    };
    let welded: Robot<2> = write("fixed", "tip = \"fore\"").unwrap().build().unwrap();
    let held: Robot<2> =
        write("revolute", "tip = \"fore\"\nfixed_joints = { side_joint = 0.0 }").unwrap().build().unwrap();
    let q = nalgebra::Vector2::new(0.4, 0.9);
    assert!((welded.mass_matrix(&q) - held.mass_matrix(&q)).norm() < 1e-14);
    write("fixed", "tip = \"fore\"").unwrap();
    let direct = load(&format!("{}#fore", folder.path().join("two.urdf").display())).unwrap();
    assert_eq!(direct.build::<2>().unwrap().mass_matrix(&q), welded.mass_matrix(&q));
    let message = write("revolute", "tip = \"fore\"").unwrap_err();
    assert!(message.contains("joint \"side_joint\"") && message.contains("fixed_joints"), "{message}");
    let message = write("fixed", "tip = \"hand\"").unwrap_err();
    assert!(message.contains("tip") && message.contains("hand"), "{message}");
    let message = write("fixed", "base = \"fore\"\ntip = \"side\"").unwrap_err();
    assert!(message.contains("not reached"), "{message}");
    let message = write("fixed", "tip = \"fore\"\nfixed_joints = { wrist = 0.0 }").unwrap_err();
    assert!(
        message.contains("bad.toml: urdf.fixed_joints") && message.contains("shoulder, elbow"),
        "{message}"
    );
    let message = write("fixed", "tip = \"fore\"\n[[urdf.joint]]\nname = \"wrist\"").unwrap_err();
    assert!(message.contains("bad.toml") && message.contains("wrist"), "{message}");
}

#[test]
fn inertias() {
    refused(FORE_INERTIAL, "", &["link \"fore\"", "no <inertial>"]);
    refused("<mass value=\"1\"/>", "<mass value=\"0\"/>", &["link \"fore\"", "mass 0 kg"]);
    refused("<mass value=\"1\"/>", "<mass value=\"-1\"/>", &["link \"fore\"", "mass: -1 is out of range"]);
    refused("<mass value=\"1\"/>", "<mass value=\"nan\"/>", &["link \"fore\"", "mass: NaN is out of range"]);
    refused("izz=\"0.01\"", "izz=\"-0.01\"", &["link \"upper\"", "not positive definite"]);
    refused("ixy=\"0\"", "ixy=\"0.03\"", &["link \"upper\"", "not positive definite"]);
    refused("izz=\"0.01\"", "izz=\"0.05\"", &["link \"upper\"", "triangle"]);
}

#[test]
fn limits() {
    let limit = |to: &str, parts: &[&str]| {
        refused(SHOULDER_LIMIT, to, &[&["joint \"shoulder\""], parts].concat());
    };
    limit(r#"<limit lower="1" upper="-1" velocity="2" effort="9"/>"#, &["reversed"]);
    limit(r#"<limit velocity="2" effort="9"/>"#, &["`<limit>` has no `lower`"]);
    limit(r#"<limit lower="0" velocity="2" effort="9"/>"#, &["`<limit>` has no `upper`"]);
    limit(r#"<limit lower="-1" upper="1" velocity="2"/>"#, &["`<limit>` has no `effort`"]);
    limit(r#"<limit lower="-1" upper="1" effort="9"/>"#, &["`<limit>` has no `velocity`"]);
    limit(r#"<limit lower="-1" upper="1" velocity="2" effort="0"/>"#, &["effort limit is 0"]);
    limit("", &["needs position limits"]);
    limit(r#"<limit lower="-1" upper="1" velocity="0" effort="9"/>"#, &["velocity limit is 0"]);
    limit(r#"<limit lower="-1" upper="1" velocity="2" effort="-9"/>"#, &["limit effort: -9 is out of range"]);
}

/// A rail without limits cannot turn without end.
#[test]
fn a_sliding_joint_is_not_told_to_turn() {
    let text = GOOD.replacen("type=\"revolute\"", "type=\"prismatic\"", 1).replacen(SHOULDER_LIMIT, "", 1);
    let message = load_text(&text, ".urdf").unwrap_err().to_string();
    assert!(message.contains("a prismatic joint needs position limits"), "{message}");
    assert!(!message.contains("continuous"), "{message}");
    refused(SHOULDER_LIMIT, "", &["a revolute joint needs position limits; use type continuous"]);
}

/// `#TIP` before a gripper: its joints are held where they are nearest to zero, and weigh on the arm.
#[test]
fn a_gripper_behind_the_tip_is_held() {
    let finger = |name: &str, joint: &str, rest: &str| {
        format!(
            "<link name=\"{name}\">{FORE_INERTIAL}</link><joint name=\"{name}_joint\" {joint}><parent link=\"fore\"/>\
             <child link=\"{name}\"/><axis xyz=\"0 0 1\"/>{rest}</joint>"
        )
    };
    let limit = |lower: f64, upper: f64| {
        format!("<limit lower=\"{lower}\" upper=\"{upper}\" velocity=\"1\" effort=\"1\"/>")
    };
    let arm = |fingers: String| {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("two.urdf");
        std::fs::write(&file, GOOD.replace("</robot>", &(fingers + "</robot>"))).unwrap();
        load(&format!("{}#fore", file.display())).unwrap().build::<2>().unwrap()
    };
    let q = nalgebra::Vector2::new(0.4, 0.9);
    let at = |z: f64| {
        let place = format!("<origin xyz=\"0 0 {z}\"/>");
        arm(finger("a", "type=\"fixed\"", &place)).mass_matrix(&q)
    };
    let sliding = |lower, upper| arm(finger("a", "type=\"prismatic\"", &limit(lower, upper))).mass_matrix(&q);
    assert_eq!(sliding(-0.1, 0.1), at(0.0));
    assert!((sliding(0.2, 0.3) - at(0.2)).norm() < 1e-14);
    assert!((sliding(0.2, 0.3) - at(0.0)).norm() > 1e-3, "the place counts");
    let mimic = "<mimic joint=\"a_joint\"/>".to_owned() + &limit(-0.1, 0.1);
    let two =
        finger("a", "type=\"prismatic\"", &limit(-0.1, 0.1)) + &finger("b", "type=\"revolute\"", &mimic);
    let two_fixed = finger("a", "type=\"fixed\"", "") + &finger("b", "type=\"fixed\"", "");
    assert_eq!(arm(two).mass_matrix(&q), arm(two_fixed).mass_matrix(&q));

    // A joint that moves beside the chain has no place that the arm could know: the message shows how to give it one.
    let text = GOOD.replace("</robot>", &(finger("a", "type=\"revolute\"", &limit(-1.0, 1.0)) + "</robot>"));
    let text = text.replace("<parent link=\"fore\"/>", "<parent link=\"upper\"/>");
    let file = tempfile::Builder::new().suffix(".urdf").tempfile().unwrap();
    std::fs::write(file.path(), text).unwrap();
    let message = load(&format!("{}#fore", file.path().display())).unwrap_err().to_string();
    assert!(message.contains("a robot file in TOML") && message.contains("fixed_joints = {"), "{message}");
    assert!(message.contains("joint \"a_joint\": moves beside"), "{message}");
}

/// A mimic stands where the joint that it copies stands, times its multiplier, beyond its offset, also through another mimic; wherever the user or zero
/// puts that one.
#[test]
fn a_mimic_behind_the_tip_keeps_its_ratio_and_offset() {
    let link = |name: &str, joint: &str, rest: &str| {
        format!(
            "<link name=\"{name}\">{FORE_INERTIAL}</link><joint name=\"{name}_joint\" {joint}><parent link=\"fore\"/>\
             <child link=\"{name}\"/><axis xyz=\"0 0 1\"/>{rest}</joint>"
        )
    };
    let limit = "<limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/>";
    let mimic = |of: &str, ratio: f64, offset: f64| {
        format!("<mimic joint=\"{of}_joint\" multiplier=\"{ratio}\" offset=\"{offset}\"/>{limit}")
    };
    let slides = "type=\"prismatic\"";
    let arm = |fingers: String, held: &str| {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("two.urdf"), GOOD.replace("</robot>", &(fingers + "</robot>")))
            .unwrap();
        let toml = folder.path().join("two.toml");
        let text = format!("name = \"two\"\n[urdf]\nfile = \"two.urdf\"\ntip = \"fore\"\n{held}");
        std::fs::write(&toml, text).unwrap();
        load(&toml.display().to_string()).unwrap().build::<2>().unwrap()
    };
    let q = nalgebra::Vector2::new(0.4, 0.9);
    for (held, at) in [("", 0.0), ("fixed_joints = { a_joint = 0.3 }", 0.3)] {
        let mimics = link("a", slides, limit)
            + &link("b", slides, &mimic("a", -2.0, 0.1))
            + &link("c", slides, &mimic("b", 0.5, 0.2));
        let place = |z: f64| format!("<origin xyz=\"0 0 {z}\"/>");
        // By hand: b = -2 a + 0.1, c = 0.5 b + 0.2.
        let b = -2.0 * at + 0.1;
        let fixed = link("a", "type=\"fixed\"", &place(at))
            + &link("b", "type=\"fixed\"", &place(b))
            + &link("c", "type=\"fixed\"", &place(0.5 * b + 0.2));
        let (found, wanted) = (arm(mimics, held), arm(fixed, ""));
        assert!((found.mass_matrix(&q) - wanted.mass_matrix(&q)).norm() < 1e-12, "{held}");
        assert!((found.gravity(&q) - wanted.gravity(&q)).norm() < 1e-12, "{held}");
    }
    let ring = link("a", slides, &mimic("b", 1.0, 0.0)) + &link("b", slides, &mimic("a", 1.0, 0.0));
    let file = tempfile::Builder::new().suffix(".urdf").tempfile().unwrap();
    std::fs::write(file.path(), GOOD.replace("</robot>", &(ring + "</robot>"))).unwrap();
    let message = load(&format!("{}#fore", file.path().display())).unwrap_err().to_string();
    assert!(
        message.contains("joint \"a_joint\"") && message.contains("mimic of joint `b_joint`"),
        "{message}"
    );
}

/// All joints beside the chain are named at once, with a file that holds them and is read.
#[test]
fn joints_beside_the_chain_are_named_with_what_holds_them() {
    let beside = |name: &str, parent: &str| {
        format!(
            "<link name=\"{name}\">{FORE_INERTIAL}</link><joint name=\"{name}_joint\" type=\"continuous\"><parent link=\"{parent}\"/>\
             <child link=\"{name}\"/></joint>"
        )
    };
    let text = GOOD.replace(
        "</robot>",
        &(beside("a", "upper")
            + &beside("b", "a")
            + &beside("c", "upper")
            + &beside("hand", "fore")
            + "</robot>"),
    );
    let folder = tempfile::tempdir().unwrap();
    let urdf = folder.path().join("two.urdf");
    std::fs::write(&urdf, text).unwrap();
    let message = load(&format!("{}#fore", urdf.display())).unwrap_err().to_string();
    assert!(message.contains("3 joints: move beside the chain"), "{message}");
    assert!(
        ["a", "b", "c"].iter().all(|name| message.contains(&format!("\"{name}_joint\" = 0.0"))),
        "{message}"
    );
    assert!(!message.contains("hand_joint"), "what hangs on the tip is held: {message}");
    let lines: Vec<_> = message.split('`').filter(|part| part.contains(" = ")).collect();
    let toml = lines.join("\n");
    let file = folder.path().join("held.toml");
    std::fs::write(&file, &toml).unwrap();
    let arm = load(&file.display().to_string()).unwrap_or_else(|e| panic!("{e}\n{toml}"));
    assert_eq!(arm.joint_count(), 2);
}

/// What exporters write for "none" is read, and told.
#[test]
fn limits_that_no_joint_has_are_none() {
    let loaded = |from: &str, to: &str| {
        let file = tempfile::Builder::new().suffix(".urdf").tempfile().unwrap();
        assert!(GOOD.contains(from));
        std::fs::write(file.path(), GOOD.replacen(from, to, 1)).unwrap();
        load(&file.path().display().to_string()).unwrap()
    };
    let fast = loaded(SHOULDER_LIMIT, "<limit lower=\"-1\" upper=\"1\" velocity=\"10000\" effort=\"9\"/>");
    assert_eq!((fast.joints[0].limits.velocity, fast.notes.len()), (1e3, 1));
    assert!(fast.notes[0].contains("limit velocity 10000 is taken as no limit"), "{}", fast.notes[0]);
    let endless =
        loaded(SHOULDER_LIMIT, "<limit lower=\"-1e16\" upper=\"1e16\" velocity=\"2\" effort=\"9\"/>");
    assert_eq!(endless.joints[0].kind, vservo::robot::JointKind::Continuous);
    assert!(
        endless.joints[0].limits.upper == f64::INFINITY && endless.notes[0].contains("turns without end")
    );
    assert_eq!(loaded(SHOULDER_LIMIT, SHOULDER_LIMIT).notes, Vec::<String>::new());
    let colour = "<material name=\"grey\"><texture/></material></robot>";
    assert_eq!(loaded("</robot>", colour).joint_count(), 2);
    refused(
        SHOULDER_LIMIT,
        "<limit lower=\"-1\" upper=\"1\" velocity=\"nan\" effort=\"9\"/>",
        &["limit velocity"],
    );
}

/// What is welded to the base does not move: its inertia is nobody's business, whatever it is.
#[test]
fn links_on_the_base_may_have_any_inertia() {
    let sound: Robot<2> = load_from(GOOD);
    let bad = "<inertial><mass value=\"-1\"/><inertia ixx=\"nan\" ixy=\"0\" ixz=\"0\" iyy=\"-1\" iyz=\"0\" izz=\"1e308\"/></inertial>";
    let text = GOOD.replace(
        "<link name=\"base\"/>",
        &format!("<link name=\"base\">{bad}</link><link name=\"foot\">{bad}</link>"),
    );
    let weld =
        "<joint name=\"weld\" type=\"fixed\"><parent link=\"base\"/><child link=\"foot\"/></joint></robot>";
    let arm: Robot<2> = load_from(&format!("{}#fore", text.replace("</robot>", weld)));
    let q = nalgebra::Vector2::new(0.4, 0.9);
    assert_eq!(arm.mass_matrix(&q), sound.mass_matrix(&q));
}

fn load_from(text: &str) -> Robot<2> {
    let (text, tip) = text.rsplit_once('#').map_or((text, ""), |(text, _)| (text, "#fore"));
    let file = tempfile::Builder::new().suffix(".urdf").tempfile().unwrap();
    std::fs::write(file.path(), text).unwrap();
    load(&format!("{}{tip}", file.path().display())).unwrap().build().unwrap()
}

/// Whatever is wrong with a tag, the words of the parsers behind stay inside.
#[test]
fn no_words_of_the_parsers() {
    for (from, to) in [
        ("<mass value=\"1\"/>", "<mass/>"),
        ("<mass value=\"1\"/>", "<mass value=\"\"/>"),
        ("<mass value=\"1\"/>", "<mass value=\"1\"/><mass value=\"1\"/>"),
        ("<mass value=\"1\"/>", "<mass><value><x/></value></mass>"),
        ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0\"/>"),
        ("<axis xyz=\"0 0 1\"/>", "<axis/>"),
        ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 1\"/><axis xyz=\"0 0 1\"/>"),
        ("<parent link=\"base\"/>", ""),
        ("<parent link=\"base\"/>", "<parent/>"),
        ("<child link=\"upper\"/>", "<child>upper</child>"),
        ("<link name=\"base\"/>", "<link/>"),
        ("name=\"shoulder\" ", ""),
        ("name=\"shoulder\" type=\"revolute\"", "name=\"shoulder\""),
        (SHOULDER_LIMIT, "<limit lower=\"x\" upper=\"1\" velocity=\"2\" effort=\"9\"/>"),
        (SHOULDER_LIMIT, "<limit lower=\"-1\" upper=\"1\" effort=\"9\"/>"),
        (SHOULDER_LIMIT, "<dynamics damping=\"much\"/>"),
        ("<mesh filename=\"package://nowhere/upper.dae\"/>", "<mesh/>"),
        ("<mesh filename=\"package://nowhere/upper.dae\"/>", "<ball/>"),
        ("<geometry>", "<geometry>text &nonsense; "),
        ("<robot name=\"two\">", "<robot name=\"two\" version=\"1.2\"><link name=\"x\" name=\"y\"/>"),
        ("<robot name=\"two\">", "<robot name=\"two\"><joint name=\"x\"/>"),
        ("effort=\"9\"", "effort=9"),
    ] {
        assert!(GOOD.contains(from), "{from}");
        let message = load_text(&GOOD.replacen(from, to, 1), ".urdf").expect_err(to).to_string();
        println!("{message}");
        for word in [
            "custom",
            "field",
            "XmlEvent",
            "Expected token",
            "Syntax",
            "invalid float",
            "Parse",
            "Error",
            "ParseFloat",
        ] {
            assert!(!message.contains(word), "{to}: `{word}` in: {message}");
        }
    }
}

#[test]
fn joints() {
    refused("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", &["joint \"shoulder\"", "axis is zero"]);
    refused("name=\"elbow\"", "name=\"shoulder\"", &["joint \"shoulder\"", "twice"]);
    refused("<link name=\"fore\">", "<link name=\"upper\">", &["link \"upper\"", "twice"]);
    refused("<axis xyz=\"0 1 0\"/>", "<mimic joint=\"shoulder\"/>", &["joint \"elbow\"", "mimic"]);
    refused("\"elbow\" type=\"revolute\"", "\"elbow\" type=\"floating\"", &["joint \"elbow\"", "floating"]);
    refused("\"elbow\" type=\"revolute\"", "\"elbow\" type=\"fixed\"", &["1 moving joints", "2 to 7"]);
}

#[test]
fn too_many_joints() {
    let mut text = String::from("<robot name=\"eight\"><link name=\"l0\"/>");
    for i in 1..=8 {
        text += &format!(
            "<link name=\"l{i}\">{FORE_INERTIAL}</link><joint name=\"j{i}\" type=\"continuous\"><parent link=\"l{}\"/>\
             <child link=\"l{i}\"/></joint>",
            i - 1
        );
    }
    refused_text(&(text + "</robot>"), ".urdf", &["8 moving joints"]);
}

#[test]
fn tables() {
    let good = include_str!("../../config/robot/scara.toml");
    load_text(good, ".toml").unwrap();
    let refused = |from: &str, to: &str, parts: &[&str]| {
        assert!(good.contains(from), "{from}");
        refused_text(&good.replacen(from, to, 1), ".toml", parts);
    };
    refused("a_m = 1.0", "a_m = \"long\"", &[".toml:18:7: dh.joint[0].a_m: invalid type", "expected"]);
    refused("a_m = 1.0", "length_m = 1.0", &["dh.joint[0]", "length_m"]);
    refused("effort_n_m = 2000.0", "effort_n = 2000.0", &["joint \"joint_1\"", "effort_n", "effort_n_m"]);
    refused("velocity_rad_s = 5.0, ", "", &["joint \"joint_1\"", "velocity_rad_s", "missing"]);
    refused("type = \"revolute\"", "type = \"continuous\"", &["joint \"joint_1\"", "continuous"]);
    refused("lower_m = -0.5", "lower_m = 5.0", &["joint \"joint_3\"", "reversed"]);
    refused(
        "inertia_kg_m2 = 0.01",
        "inertia_kg_m2 = -0.01",
        &["joint \"joint_1\"", "motor.inertia_kg_m2: -0.01"],
    );
    refused("zz = 10.0", "zz = nan", &["link \"link of joint_1\"", "inertia_kg_m2.zz: NaN"]);
    // The last link idealised to nothing: joint 4 would move nothing.
    refused("zz = 1.0", "zz = 0.0", &["B(q)"]);
    refused("idealised = true", "idealised = false", &["link \"link of joint_3\"", "not positive definite"]);
    refused("[dh]\n", "[dh]\nconvention = ", &[]);
    refused("convention = \"standard\"", "convention = \"other\"", &["dh.convention", "other"]);
    refused_text("name = \"none\"\n", ".toml", &["exactly one of [dh] and [urdf]"]);
}

#[test]
fn names_and_paths() {
    let message = load("robbie").unwrap_err().to_string();
    assert!(message.contains("robbie") && message.contains("scara, ur5, panda"), "{message}");
    let message = load("no/such/robot.urdf").unwrap_err().to_string();
    assert!(message.contains("no/such/robot.urdf"), "{message}");
    let message = load("scara").unwrap().build::<6>().unwrap_err().to_string();
    assert!(message.contains("4 joints") && message.contains('6'), "{message}");
}
