use super::*;
use crate::control::trace::Trace;
use crate::geometry::Pose;
use crate::sim::system::ConfiguredDrives;
use crate::sim::{Moment, simulate_system};
use nalgebra::{SVector, Vector2, Vector3};
use std::ops::ControlFlow::{Break, Continue};
use std::path::Path;

/// A suite of one task, with the lines of it that are given, and two laws.
fn suite(task: &str) -> Result<BenchmarkSuite, BenchmarkError> {
    let text = format!(
        "about = \"a test\"\nseed = 5\n\
         [[laws]]\nname = \"B\"\nabout = \"\"\nset = {{ \"servo.scheme\" = \"position_resolved_velocity\" }}\n\
         [[laws]]\nname = \"D\"\nabout = \"\"\nset = {{}}\n\
         [[tasks]]\nname = \"t\"\nabout = \"\"\nscore = \"settling\"\n{task}\n"
    );
    BenchmarkSuite::parse("test.toml", &text, Path::new("."))
}

const ROLLS: &str = "file = \"ur5\"\ncount = 2\nstart = { roll_deg = { each = [30, 90] }, aside_m = { from = 0.0, to = 0.1 } }";

/// All results of a suite.
fn runs(suite: &BenchmarkSuite) -> BenchmarkResults {
    let scenarios: Vec<_> = suite.places().into_iter().map(|place| scenario(suite, place).unwrap()).collect();
    let of = |s: &BenchmarkScenario| -> Vec<RunScores> {
        (0..suite.laws.len())
            .map(|law| run_scenario(suite, s, Participant::Law(law), &mut ConfiguredDrives, None).unwrap())
            .collect()
    };
    let runs: Vec<_> = scenarios.iter().map(of).collect();
    BenchmarkResults::new(suite, &[], &scenarios, &runs)
}

/// The camera sees the target in every scenario of the shipped suites, and every law of them takes every task: as many starts as a test has time for.
#[test]
fn every_task_of_the_shipped_suites_can_be_flown() {
    for (name, text) in SHIPPED_SUITES {
        let suite = BenchmarkSuite::parse(name, text, Path::new(".")).unwrap();
        let mut places = suite.places();
        if name == "full" {
            places.retain(|place| place.start == 7 && place.case % 4 == 0);
        }
        assert!(places.len() > 20, "{name}");
        for place in places {
            let scenario = scenario(&suite, place).unwrap_or_else(|e| panic!("{name} {place:?}: {e}"));
            for law in 0..suite.laws.len() {
                suite.run_file(&scenario, Some(law)).unwrap_or_else(|e| panic!("{name} {place:?}: {e}"));
            }
        }
    }
    let names = |name: &str| {
        let suite =
            BenchmarkSuite::parse(name, BenchmarkSuite::shipped(name).unwrap(), Path::new(".")).unwrap();
        suite.tasks.into_iter().map(|task| task.name).collect::<Vec<_>>()
    };
    let mut full = names("full");
    full.retain(|name| !["circle", "stop-and-go", "jump"].contains(&name.as_str()));
    assert_eq!(names("short"), full, "the short suite has conveyor and pendulum of the targets that move");
}

/// What is asked of a start is what the camera sees: the angle about the optical axis, the distance of the target's middle.
#[test]
fn starts_are_turned_and_shifted_as_the_task_says() {
    let suite = suite("file = \"ur5\"\ncount = 3\nstart = { roll_deg = 70, ahead_m = 0.1 }").unwrap();
    for place in suite.places() {
        let s = scenario(&suite, place).unwrap();
        let config = suite.run_file(&s, Some(1)).unwrap();
        let view = crate::sim::preflight::Preflight::of(&config).unwrap().start.unwrap();
        let goal = config.set_point.X_DO().unwrap();
        let turn = (view.X_CO * goal.inverse()).rotation.scaled_axis();
        assert!((turn - Vector3::z() * 70f64.to_radians()).norm() < 1e-4, "{turn}");
        assert!((view.X_CO.translation.z - goal.translation.z - 0.1).abs() < 1e-4);
        assert_eq!(scenario(&suite, place).unwrap(), s, "a start is drawn from its numbers alone");
    }
}

/// The scores of a run, once more from its trace, by other code: forward kinematics of the joint states, lengths by sums of segments.
#[test]
fn scores_are_those_of_the_trace() {
    let suite = suite(ROLLS).unwrap();
    for (place, law) in suite.places().into_iter().zip([0, 1, 1, 0]) {
        let s = scenario(&suite, place).unwrap();
        let scores = run_scenario(&suite, &s, Participant::Law(law), &mut ConfiguredDrives, None).unwrap();
        let config = suite.run_file(&s, Some(law)).unwrap();
        let robot = config.robot.build::<6>().unwrap();
        let goal = *config.set_point.X_DO().unwrap();
        let seen = |X: &Pose| -> Vec<Vector2<f64>> {
            config
                .target
                .points()
                .iter()
                .map(|p| config.camera.model.project(&(X * p.p_O)).unwrap())
                .collect()
        };
        let pose = |trace: &Trace| {
            let q = SVector::<f64, 6>::from_fn(|i, _| trace.joint_state.q[i]);
            config.camera.mount.X_WC(&robot, &q).inv_mul(&config.X_WO().unwrap())
        };
        let (mut poses, mut errors, mut energy) = (Vec::new(), Vec::new(), 0.0);
        simulate_system(&config, &mut |moment| {
            let Moment::Tick(trace, truth) = moment else { return Continue(()) };
            let X = pose(trace);
            let squares: f64 = seen(&X).iter().zip(seen(&goal)).map(|(a, b)| (a - b).norm_squared()).sum();
            let error = (squares / 4.0).sqrt();
            // the mission's own error, of undistorted coordinates, differs by the lens alone
            let of_mission = truth.feature_error_px.unwrap();
            assert!((error - of_mission).abs() < 0.1 * of_mission + 0.01, "{error} {of_mission}");
            for i in 0..6 {
                energy += (trace.command.tau[i] * trace.joint_state.qd[i]).abs() * 1e-3;
            }
            poses.push(X);
            errors.push(error);
            let held = errors.iter().rev().take_while(|e| **e <= 1.0).count();
            if held > 1000 { Break(()) } else { Continue(()) }
        })
        .unwrap();
        let settled = errors.iter().rposition(|e| *e > 1.0).unwrap() + 1;
        assert!(
            scores.converged && (scores.settling_s.unwrap() - settled as f64 * 1e-3).abs() < 1e-9,
            "{scores:?}"
        );
        assert!((scores.energy_j - energy).abs() < 1e-9 * energy);
        // every tick instead of every tenth: the trembling and the corners cost less than a percent
        let (mut arc, mut way_m) = (0.0, 0.0);
        for w in poses[..=settled].windows(2) {
            arc += seen(&w[0]).iter().zip(seen(&w[1])).map(|(a, b)| (b - a).norm()).sum::<f64>();
            way_m += (w[0].inverse().translation.vector - w[1].inverse().translation.vector).norm();
        }
        let straight: f64 =
            seen(&poses[0]).iter().zip(seen(&poses[settled])).map(|(a, b)| (b - a).norm()).sum();
        let straight_m =
            (poses[0].inverse().translation.vector - poses[settled].inverse().translation.vector).norm();
        assert!((scores.image_path_excess.unwrap() - (arc / straight - 1.0)).abs() < 0.01, "{scores:?}");
        assert!(
            (scores.space_path_excess_m.unwrap() - (way_m - straight_m)).abs() < 0.01 * way_m,
            "{scores:?}"
        );
        let border = |u: &Vector2<f64>| (u.x + 0.5).min(639.5 - u.x).min(u.y + 0.5).min(479.5 - u.y);
        let margin = poses.iter().flat_map(&seen).map(|u| border(&u)).fold(f64::INFINITY, f64::min);
        assert!((scores.margin_px - margin).abs() < 1e-9);
        assert!((scores.first_error_px - errors[0]).abs() < 1e-9);
    }
}

/// No law is quicker than the limits allow, whatever posture it ends in. At the goal is who has a share e of the way d left, and brakes there from a
/// speed from which it comes to rest within 2 e d: with the jerk J that takes at most (12 e d / J)^(1/3).
#[test]
fn nothing_settles_before_the_least_time() {
    let xarm = "file = \"xarm7\"\ncount = 3\nstart = { roll_deg = { from = -40.0, to = 40.0 }, aside_m = { from = 0.02, to = 0.08 }, ahead_m = 0.1 }";
    for task in [ROLLS, xarm] {
        for task in &runs(&suite(task).unwrap()).tasks {
            for law in &task.laws {
                for (run, s) in law.runs.iter().zip(&task.scenarios) {
                    let (settling, least) = (run.settling_s.unwrap(), s.least_time_s.unwrap());
                    // the widest way of a joint is a quarter turn, the jerk 500 rad/s3
                    let last_s = (12.0 * task.tolerance_px / run.first_error_px * 1.6 / 500.0).cbrt();
                    assert!(
                        least > 0.2 && last_s < 0.1 && settling + last_s >= least,
                        "{}: {settling} {least}",
                        law.law
                    );
                }
            }
        }
    }
}

/// A goal that was shown is the true one, whatever is believed of the lens.
#[test]
fn wrong_beliefs_leave_truth_and_goal_as_they_are() {
    let believed = "believed = { focal_times = 0.8, centre_off_px = 30, mount_turn_deg = 8, mount_off_m = 0.02, size_times = 2.0 }";
    let with = |lines: &str| {
        suite(&format!("file = \"ur5\"\ncount = 1\nstart = {{ roll_deg = 20 }}\n{lines}")).unwrap()
    };
    let (right, wrong) = (with(""), with(believed));
    let [a, b] = [&right, &wrong].map(|suite| {
        let s = scenario(suite, suite.places()[0]).unwrap();
        suite.run_file(&s, Some(1)).unwrap()
    });
    let (x, y) = (a.scene.as_ref().unwrap(), b.scene.as_ref().unwrap());
    assert_eq!((x.camera, x.X_WO), (y.camera, y.X_WO));
    assert!((x.mount.pose().to_homogeneous() - y.mount.pose().to_homogeneous()).norm() < 1e-12);
    assert_eq!(x.target.points(), y.target.points());
    assert!((b.camera.model.intrinsics().fx_px - 640.0).abs() < 1e-9 && a.camera.model != b.camera.model);
    let of = |config: &crate::config::Config| -> Vec<Vector2<f64>> {
        config.set_point.features().iter().map(|s| config.camera.model.pixel_of(s)).collect()
    };
    for (u, v) in of(&a).iter().zip(of(&b)) {
        assert!((u - v).norm() < 1e-6, "{u} {v}: the same pixels");
    }
}

#[test]
fn absurd_suites_are_refused_in_words() {
    let told = |task: &str| {
        let outcome = suite(task).and_then(|suite| {
            scenario(&suite, suite.places()[0]).and_then(|s| suite.run_file(&s, Some(0)).map(drop))
        });
        outcome.map_or_else(|e| e.to_string(), |()| "accepted".into())
    };
    let head = "file = \"ur5\"\ncount = 1\n";
    for (lines, word) in [
        ("file = \"ur5\"\ncount = 0", "count = 0: must be 1 to 10000"),
        ("file = \"ur5\"\ncount = 99999999999", "count"),
        ("file = \"r2d2\"\ncount = 1", "r2d2"),
        (&format!("{head}start = {{ role_deg = 3 }}"), "did you mean `roll_deg`"),
        (&format!("{head}start = {{ roll_deg = 1e9 }}"), "must be -180 to 180"),
        (&format!("{head}start = {{ roll_deg = nan }}"), "must be -180 to 180"),
        (&format!("{head}start = {{ roll_deg = {{ from = 3, to = 1 }} }}"), "is no range"),
        (&format!("{head}start = {{ roll_deg = {{ each = [] }} }}"), "with 1 to 64 values"),
        (&format!("{head}start = {{ tilt_deg = \"much\" }}"), "is no number"),
        (&format!("{head}start = {{ aside_m = 1.9, ahead_m = -0.3 }}"), "is in view and within reach"),
        (&format!("{head}believed = {{ focal_times = 0.0 }}"), "must be 0.1 to 10"),
        (&format!("{head}believed = {{ \"camera.lens.fx_px\" = 3.0 }}"), "there is no such value"),
        (&format!("{head}world = {{ \"servo.gain_1_s\" = 3.0 }}"), "is none of its keys"),
        (&format!("{head}world = {{ \"scene.moon\" = 3.0 }}"), "scene.moon"),
        (&format!("{head}world = {{ \"camera.rate_hz\" = 1e30 }}"), "camera.rate_hz"),
        (&format!("{head}asked = {{ \"scene.plate_level\" = 3.0 }}"), "is none of its keys"),
        (&format!("{head}tolerance_px = -1.0"), "tolerance_px"),
        (&format!("{head}duration_s = 1e12"), "duration_s"),
        (&format!("{head}colour = 3"), "unknown field `colour`"),
        (
            "file = \"pan_tilt\"\ncount = 1\nworld = { \"scene.object.position_m\" = [9.0, 0.0, 0.0] }",
            "cannot reach the goal",
        ),
    ] {
        let message = told(lines);
        assert!(message.contains(word), "{lines}: {message}");
    }
    let many = format!(
        "{head}start = {{ roll_deg = {{ each = {0:?} }}, tilt_deg = {{ each = {0:?} }} }}",
        [1.0; 64]
    );
    assert!(told(&many).contains("cases = 4096: must be 1 to 256"), "{}", told(&many));
    let parse = |text: &str| BenchmarkSuite::parse("x", text, Path::new(".")).unwrap_err().to_string();
    assert!(parse("about = \"\"\nseed = 1\nlaws = []\ntasks = []").contains("needs [[laws]] and [[tasks]]"));
    assert!(parse("[[[").contains("x: TOML parse error"));
    let twice = BenchmarkSuite::shipped("short").unwrap().replace("name = \"B\"", "name = \"A\"");
    assert!(parse(&twice).contains("law `A`: stands there twice"));
    let odd = BenchmarkSuite::shipped("short").unwrap().replace("name = \"B\"", "name = \"../B\"");
    assert!(parse(&odd).contains("a name is of 1 to 40 letters"));
    let unknown = suite(ROLLS).unwrap().with_laws(&["E".into()]).unwrap_err().to_string();
    assert!(unknown.contains("no law `E`; choose of B, D"), "{unknown}");
}

#[test]
fn who_brings_more_starts_home_is_better() {
    let results =
        runs(&suite("file = \"ur5\"\ncount = 1\nstart = { roll_deg = { each = [10, 20] } }").unwrap());
    let (task, text) = (&results.tasks[0], results.to_text());
    assert_eq!((results.runs(), task.laws[0].summary.converged), (4, 2));
    assert!(
        !task.best.is_empty() && results.losses.is_empty() && text.contains("B: 2 of 2, 1 of 1"),
        "{text}"
    );
    let page =
        benchmark_page(&results, &[LawTime { law: "B".into(), step_us: Some(2.5), round_trip: false }]);
    for part in ["class=\"verdict\"", "2.50", "start.roll_deg", "Nowhere: every law"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(
        !page.contains("http://")
            || page.matches("http://").count() == page.matches("http://www.w3.org").count()
    );
}
