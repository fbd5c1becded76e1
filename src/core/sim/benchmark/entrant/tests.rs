use super::*;
use crate::linalg::Random;
use crate::servo::{Interaction, SetPoint, View, image_task};
use crate::sim::benchmark::{BenchmarkSuite, Participant, RunScores, RunTruth, run_scenario, scenario};
use crate::sim::system::ConfiguredDrives;
use nalgebra::{Point3, Vector2};
use std::path::Path;

const READY: &str = r#"{"about": "a test", "settings": {"gain_1_s": 2.0}}"#;

fn suite(believed: &str) -> BenchmarkSuite {
    let text = format!(
        "about = \"a test\"\nseed = 5\n\
         [[laws]]\nname = \"D\"\nabout = \"\"\nset = {{}}\n\
         [[tasks]]\nname = \"t\"\nabout = \"\"\nscore = \"settling\"\nfile = \"ur5\"\ncount = 1\nduration_s = 6.0\n\
         start = {{ roll_deg = 30.0, aside_m = 0.05 }}\n{believed}"
    );
    BenchmarkSuite::parse("test.toml", &text, Path::new(".")).unwrap()
}

/// A link to whatever a function says.
struct TestLink<F>(F, Vec<String>);

impl<F: FnMut(&Value) -> Result<String, String>> EntrantLink for TestLink<F> {
    fn exchange(&mut self, line: &str) -> Result<String, String> {
        assert!(!line.contains('\n'), "one line");
        self.1.push(line.to_owned());
        (self.0)(&serde_json::from_str(line).unwrap())
    }

    fn end(&mut self, line: &str) {
        self.1.push(line.to_owned());
    }
}

fn runs(
    suite: &BenchmarkSuite,
    says: impl FnMut(&Value) -> Result<String, String>,
    truth: Option<&mut RunTruth>,
) -> (RunScores, Vec<String>) {
    let s = scenario(suite, suite.places()[0]).unwrap();
    let mut link = TestLink(says, Vec::new());
    let scores =
        run_scenario(suite, &s, Participant::Entrant(&mut link), &mut ConfiguredDrives, truth).unwrap();
    (scores, link.1)
}

fn is_begin(message: &Value) -> bool {
    message["vservo"] == "begin"
}

fn vector<const K: usize>(value: &Value) -> [f64; K] {
    let numbers: Vec<f64> = value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    numbers.try_into().unwrap()
}

/// Image-based servoing by what is in the messages alone.
fn servo(gain_1_s: f64, as_joints: bool) -> impl FnMut(&Value) -> Result<String, String> {
    let mut goal: Option<SetPoint> = None;
    move |message| {
        if is_begin(message) {
            let points: Vec<Point3<f64>> = message["target"]["points"]
                .as_array()
                .unwrap()
                .iter()
                .map(|p| vector::<3>(&p["position_m"]).into())
                .collect();
            let pose = &message["goal"]["pose"];
            let [x, y, z, w] = vector::<4>(&pose["rotation_xyzw"]);
            let turn = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
            let X_DO = Pose::from_parts(vector::<3>(&pose["position_m"]).into(), turn);
            goal = SetPoint::from_pose(&X_DO, &points);
            return Ok(READY.into());
        }
        let features = message["features"].as_array().unwrap().iter();
        let s: Vec<Vector2<f64>> =
            features.map(|f| Vector2::new(f["x"].as_f64().unwrap(), f["y"].as_f64().unwrap())).collect();
        let (goal, view) = (goal.as_ref().unwrap(), View::new(s.into_iter(), None).unwrap());
        let task = image_task(goal, &view, Interaction::TEXTBOOK);
        let V_C = task.unwrap().twist(gain_1_s).unwrap();
        if !as_joints {
            return Ok(json!({ "twist": V_C.as_slice() }).to_string());
        }
        let row = |k: usize| nalgebra::RowVector6::from(vector::<6>(&message["jacobian"][k]));
        let J = nalgebra::Matrix6::from_rows(&std::array::from_fn::<_, 6, _>(row));
        Ok(json!({ "joints": J.try_inverse().map(|inverse| inverse * V_C).unwrap().as_slice() }).to_string())
    }
}

#[test]
fn an_entrant_comes_home_by_twists_and_by_joint_velocities() {
    let suite = suite("");
    for as_joints in [false, true] {
        let mut truth = RunTruth::default();
        let (scores, lines) = runs(&suite, servo(2.0, as_joints), Some(&mut truth));
        assert!(scores.converged && scores.end == "at the goal", "{scores:?}");
        assert!(scores.settling_by_least.is_some_and(|times| times > 0.9), "{scores:?}");
        assert_eq!(lines.last().map(String::as_str), Some(END));
        // a question a frame, and a row a tick beneath two lines
        let frames = scores.duration_s * 25.0;
        assert!((lines.len() as f64 - 2.0 - frames).abs() < 3.0, "{} {frames}", lines.len());
        let rows = truth.to_csv().lines().count() as f64 - 2.0;
        assert!((rows - scores.duration_s * 1e3).abs() < 1.5, "{rows}");
        let (again, _) = runs(&suite, servo(2.0, as_joints), None);
        assert_eq!(again, scores, "the same answers, the same run");
    }
}

/// The camera, its mount and the target of the messages are those that are believed, and no number of them is the true one.
#[test]
fn an_entrant_is_told_what_is_believed() {
    let believed = "believed = { focal_times = 0.75, size_times = 2.0, mount_off_m = 0.03 }";
    let suite = suite(believed);
    let mut begin = Value::Null;
    let see = |message: &Value| {
        if is_begin(message) {
            begin = message.clone();
            return Ok(READY.into());
        }
        Ok("null".into())
    };
    let (scores, _) = runs(&suite, see, None);
    assert!(!scores.converged && scores.end == "not there in time", "{scores:?}");
    assert!((scores.final_error_px - scores.first_error_px).abs() < 0.5, "the arm rests: {scores:?}");
    let s = scenario(&suite, suite.places()[0]).unwrap();
    let config = suite.run_file(&s, None).unwrap();
    let scene = config.scene.as_ref().unwrap();
    let fx_px = begin["camera"]["fx_px"].as_f64().unwrap();
    assert!((fx_px / scene.camera.full_intrinsics().fx_px - 0.75).abs() < 1e-12, "{fx_px}");
    let Mount::EyeInHand { X_EC } = scene.mount else { panic!("in the hand") };
    let told: [f64; 3] = vector(&begin["camera"]["mount_pose"]["position_m"]);
    assert!(((X_EC.translation.vector - nalgebra::Vector3::from(told)).norm() - 0.03).abs() < 1e-9);
    let first: [f64; 3] = vector(&begin["target"]["points"][0]["position_m"]);
    assert!((Point3::from(first).coords / 2.0 - scene.target.points()[0].p_O.coords).norm() < 1e-9);
    for truth in ["scene", "q_true", "X_WO", "truth"] {
        assert!(!begin.to_string().contains(truth), "{truth}");
    }
}

#[test]
fn what_is_no_answer_ends_the_run_and_is_told() {
    let suite = suite("");
    for (says, words) in [
        ("", "the entrant answers ``: {\"twist\""),
        ("moin", "answers `moin`"),
        ("{\"twist\": [NaN, 0, 0, 0, 0, 0]}", "[NaN"),
        ("{\"twist\": [1e400, 0, 0, 0, 0, 0]}", "[1e400"),
        ("{\"twist\": [0, 0, 0, 0, 0]}", "a twist has 6 numbers, not 5"),
        ("{\"twist\": [0, 0, 0, 0, 0, 1e9]}", "1000000000 is beyond 1000 m/s or rad/s"),
        ("{\"joints\": [0, 0, 0]}", "the arm has 6 joints, not 3"),
        ("{\"joints\": [0, 0, 0, 0, 0, 0], \"twist\": [0, 0, 0, 0, 0, 0]}", "or null is expected"),
        ("{\"torque\": [0, 0, 0, 0, 0, 0]}", "unknown field `torque`"),
        ("{}", "or null is expected"),
    ] {
        let mut answers = 0;
        let see = |message: &Value| {
            answers += 1;
            Ok(if is_begin(message) { READY } else { says }.into())
        };
        let (scores, _) = runs(&suite, see, None);
        assert!(!scores.converged && scores.end.contains(words), "{says}: {}", scores.end);
        assert_eq!(answers, 2, "nobody is asked again");
    }
    let (scores, lines) = runs(&suite, |_| Err("ended".into()), None);
    assert!(!scores.converged && scores.end == "the entrant ended" && lines.len() == 1, "{scores:?}");
    assert!(scores.first_error_px > 10.0 && scores.margin_px.is_finite(), "{scores:?}");
}

#[test]
fn words_of_an_entrant_are_checked() {
    let card = EntrantCard::parse(READY).unwrap();
    assert_eq!((card.about.as_str(), card.settings_in_words().as_str()), ("a test", "gain_1_s = 2.0"));
    let long = format!("{{\"about\": \"{}\"}}", "x".repeat(201));
    for (line, words) in [
        ("null", "answers the task with `null`"),
        ("{}", "missing field `about`"),
        (r#"{"about": "x", "gain": 3}"#, "unknown field `gain`"),
        (&long, "says 201 letters of itself"),
    ] {
        let told = EntrantCard::parse(line).unwrap_err();
        assert!(told.contains(words), "{line}: {told}");
    }
}

/// A frame is the one that was measured: the dots' pixels in it are dark where the features are.
#[test]
fn frames_are_those_that_were_measured() {
    let suite = suite("");
    let mut looked = 0;
    let see = |message: &Value| {
        if is_begin(message) {
            return Ok(r#"{"about": "looks", "frames": true}"#.into());
        }
        let pixels = decoded(message["frame"].as_str().unwrap());
        assert_eq!(pixels.len(), 640 * 480);
        for f in message["features"].as_array().unwrap() {
            let at = |key: &str| f[key].as_f64().unwrap().round() as usize;
            assert!(pixels[at("v_px") * 640 + at("u_px")] < 100, "a dot is dark in its middle");
        }
        looked += 1;
        let mut random = Random::new(looked);
        let twist: [f64; 6] = std::array::from_fn(|_| random.between(-0.05, 0.05));
        Ok(if looked < 20 { json!({ "twist": twist }).to_string() } else { "enough".into() })
    };
    runs(&suite, see, None);
    assert_eq!(looked, 20);
}

fn decoded(text: &str) -> Vec<u8> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let bits: Vec<u8> = text.bytes().filter(|c| *c != b'=').map(value).collect();
    let bytes = bits.chunks(4).flat_map(|group| {
        let all = (0..4).fold(0_u32, |all, i| all << 6 | u32::from(group.get(i).copied().unwrap_or(0)));
        all.to_be_bytes()[1..group.len()].to_vec()
    });
    bytes.collect()
}
