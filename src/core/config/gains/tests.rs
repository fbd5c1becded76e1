use super::*;
use crate::config::Config;
use std::path::Path;

fn load(file: &str, set: &[&str]) -> Result<Config, String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config").join(file);
    let set: Vec<String> = set.iter().map(ToString::to_string).collect();
    Config::load(Some(&path), &set).map_err(|error| error.to_string())
}

fn law_of(file: &str, set: &[&str]) -> Law {
    load(file, set).unwrap().servo.law
}

/// The three forms of one matrix are one law, in every scheme.
#[test]
fn a_number_a_list_and_a_matrix_say_the_same() {
    let full = |law: &Law, e: [f64; 4]| -> Vec<f64> {
        match law {
            Law::ImageVelocity { K_s, gain, .. } => {
                (0..4).map(|i| K_s.row_times(i, e.into_iter()) * gain.at(0.0)).collect()
            }
            Law::ImageTorque { K_Ps, damping: Damping::Task(K_D), .. } => {
                (0..4).flat_map(|i| [K_Ps, K_D].map(|K| K.row_times(i, e.into_iter()))).collect()
            }
            Law::PositionVelocity { K, gain, .. } => (K.matrix() * gain.at(0.0)).as_slice().to_vec(),
            Law::PositionTorque { K_P, damping: Damping::Task(K_D), .. } => {
                [K_P.matrix().as_slice(), K_D.matrix().as_slice()].concat()
            }
            Law::Hybrid { gains, .. } => {
                [gains.K_p.matrix().as_slice(), gains.K_o.matrix().as_slice()].concat()
            }
            other => panic!("{other:?}"),
        }
    };
    let diagonal = "[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,2]]";
    let three = "[[2,0,0],[0,2,0],[0,0,2]]";
    let matrix = "servo.pd.feature_gain=matrix";
    let pd = ["position_stiffness_n_m", "orientation_stiffness_nm_rad"];
    for (file, keys, more, forms) in [
        ("scara-d.toml", &["servo.gain_1_s"][..], "servo.depth=desired", ["2", "[2,2,2,2]", diagonal]),
        ("scara-b.toml", &["servo.gain_1_s"], "servo.depth=desired", ["2", "[2,2,2,2]", diagonal]),
        ("scara-hybrid.toml", &["servo.gain_1_s"], "servo.depth=desired", ["2", "[2,2,2,2]", diagonal]),
        ("scara-c.toml", &["servo.pd.feature_stiffness_nm"], matrix, ["2", "[2,2,2,2]", diagonal]),
        ("scara-c.toml", &["servo.pd.feature_damping_nms"], matrix, ["2", "[2,2,2,2]", diagonal]),
        (
            "scara-a.toml",
            &pd.map(|key| format!("servo.pd.{key}")).each_ref().map(String::as_str),
            "servo.depth=desired",
            ["2", "[2,2,2]", three],
        ),
    ] {
        let e = [0.3, -0.1, 0.2, 0.7];
        let [one, list, all] = forms.map(|form| {
            let mut set: Vec<String> = keys.iter().map(|key| format!("{key}={form}")).collect();
            set.push(more.into());
            full(&law_of(file, &set.iter().map(String::as_str).collect::<Vec<_>>()), e)
        });
        assert_eq!(one, list, "{file} {keys:?}");
        assert_eq!(one, all, "{file} {keys:?}");
    }
}

/// A matrix of four for B and hybrid: the rotation about the axis is where the orientation error has it.
#[test]
fn four_rows_are_x_y_z_and_the_rotation() {
    let set = "servo.gain_1_s=[[2,0,0,0.5],[0,3,0,0],[0,0,4,0],[0.5,0,0,5]]";
    for (orientation, at) in [("euler_zyx", 3), ("angle_axis", 5)] {
        let law = law_of("scara-b.toml", &[set, &format!("servo.orientation_error={orientation}")]);
        let Law::PositionVelocity { K, .. } = law else { panic!("B") };
        let K = K.matrix();
        assert_eq!(K.diagonal(), Vector6::new(2.0, 3.0, 4.0, 5.0, 5.0, 5.0));
        assert_eq!((K[(0, at)], K[(at, 0)], K[(0, 8 - at)]), (0.5, 0.5, 0.0), "{orientation}");
    }
}

#[test]
fn what_is_no_gain_is_refused_with_place_and_remedy() {
    let c = "servo.pd.feature_gain=matrix";
    for (file, set, words) in [
        (
            "scara-d.toml",
            &["servo.gain_1_s=[1,2,3]"][..],
            "servo.gain_1_s: has 3 entries; the law compares 4 numbers",
        ),
        ("default.toml", &["servo.gain_1_s=[1,2,3]"], "the law compares 8 numbers"),
        ("scara-d.toml", &["servo.gain_1_s=[[1,0],[0,1]]"], "is 2 x 2, needs 4 x 4"),
        ("scara-d.toml", &["servo.gain_1_s=[[1,0],[0,1],[1]]"], "has 3 rows, but row 1 has 2 entries"),
        (
            "scara-d.toml",
            &["servo.gain_1_s=[[1,0.5,0,0],[0.4,1,0,0],[0,0,1,0],[0,0,0,1]]"],
            "not symmetric: 0.5 in row 1, column 2, but 0.4 in row 2, column 1",
        ),
        (
            "scara-d.toml",
            &["servo.gain_1_s=[[1,2,0,0],[2,1,0,0],[0,0,1,0],[0,0,0,1]]"],
            "smallest eigenvalue is -1.0000",
        ),
        (
            "scara-d.toml",
            &["servo.gain_1_s=[[1e9,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"],
            "servo.gain_1_s[0][0]",
        ),
        (
            "scara-d.toml",
            &["servo.gain_1_s=[[1,0.9999,0,0],[0.9999,1,0,0],[0,0,1,0],[0,0,0,1]]"],
            "eigenvalues 0.0001 to 1.9999",
        ),
        ("scara-d.toml", &["servo.gain_1_s=[1,[2]]"], "numbers and lists in one list"),
        ("scara-b.toml", &["servo.gain_1_s=[[1,0,0],[0,1,0],[0,0,1]]"], "is 3 x 3, needs 4 x 4 or 6 x 6"),
        (
            "scara-hybrid.toml",
            &["servo.gain_1_s=[[1,0,0,0.1],[0,1,0,0],[0,0,1,0],[0.1,0,0,1]]"],
            "couples position and orientation",
        ),
        (
            "scara-a.toml",
            &["servo.pd.position_stiffness_n_m=[[1,2,0],[2,1,0],[0,0,1]]"],
            "servo.pd.position_stiffness_n_m: is not positive definite",
        ),
        ("scara-a.toml", &["servo.pd.joint_damping_nms_rad_or_ns_m=[[1]]"], "a list of one for each joint"),
        ("scara-c.toml", &["servo.pd.feature_stiffness_nm=[1,1,1,1]"], "servo.pd.feature_gain = \"matrix\""),
        (
            "scara-c.toml",
            &[c, "servo.pd.feature_damping_nms=[1,1,1,0]"],
            "servo.pd.feature_damping_nms: is not positive definite",
        ),
        ("scara-c.toml", &[c, "servo.weights=[1,2]"], "have no part in a matrix K_Ps"),
    ] {
        let error = load(file, set).expect_err(&format!("{file} {set:?}"));
        assert!(error.contains(words), "{file} {set:?}: {error}");
    }
}

/// A number that no law may have is told also where the law at hand has no use for it.
#[test]
fn gains_of_other_laws_are_looked_at() {
    for file in
        ["scara-a.toml", "scara-b.toml", "scara-c.toml", "scara-d.toml", "scara-hybrid.toml", "default.toml"]
    {
        for set in [
            "servo.pd.feature_damping_nms=1e9",
            "servo.pd.feature_stiffness_nm=[[1e9]]",
            "servo.gain_1_s=1e9",
        ] {
            let error = load(file, &[set]).expect_err(&format!("{file} {set}"));
            assert!(error.contains(set.split('=').next().unwrap()), "{file} {set}: {error}");
        }
        let other = if file == "scara-c.toml" {
            "servo.gain_1_s=[1,2,3,4,5,6,7,8]"
        } else {
            "servo.pd.feature_damping_nms=[1,2]"
        };
        assert!(load(file, &[other]).is_ok(), "{file}: of no use, and right");
    }
}

#[test]
fn weights_that_do_nothing_are_told() {
    let warned = |set: &[&str]| {
        let warnings = load("scara-d.toml", set).unwrap().warnings;
        warnings
            .iter()
            .any(|w| w.to_string().contains("servo.weights") && w.to_string().contains("servo.gain_1_s"))
    };
    assert!(warned(&["servo.weights=[1,2]"]), "two points and four joints");
    assert!(!warned(&["servo.weights=[2,2]"]) && !warned(&["servo.points=[1,2,3]", "servo.weights=[1,2,1]"]));
}
