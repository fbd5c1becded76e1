//! The textbook's examples, comparison and statements, and the command line of `vservo experiment`.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers beside the tests
#![allow(non_snake_case)] // X, Y, H, T as in the text

use crate::common::vservo;
use nalgebra::{Rotation2, Vector2, Vector4};
use serde_json::Value;
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_3};
use std::path::Path;
use vservo::experiment::{
    CameraKind, Cell, DelayedLoop, Disturbance, FeatureSource, Findings, LAW_VARIANTS, Metrics, Options,
    RenderedFeatures, SCHEMES, Scheme, SchemeController, StartOutcome, Trajectory, TrajectoryEnd,
    errors_to_bear, find, path_deviation, pure_rotation, run_scheme, runs_of, simulate_at, study,
};
use vservo::servo::{DepthSource, UpdatePolicy};

fn findings(name: &str) -> Findings {
    let options = Options { camera: CameraKind::Ideal, count: 20, progress: &|_| {} };
    find(name).unwrap().run(&options).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().unwrap_or_else(|| panic!("{other} is no number"))],
    }
}

fn assert_close(got: &Value, expected: &[f64], tolerance: f64) {
    let got = numbers(got);
    assert_eq!(got.len(), expected.len());
    let worst = got.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst <= tolerance, "{got:?} {expected:?}");
}

fn run(scheme: Scheme) -> Trajectory {
    let run = run_scheme(&Cell::textbook().unwrap(), scheme, &mut FeatureSource::Ideal).unwrap();
    assert_eq!(run.end, TrajectoryEnd::Finished);
    run
}

fn metrics(scheme: Scheme) -> Metrics {
    Metrics::of(&run(scheme), &Cell::textbook().unwrap().goal().unwrap()).unwrap()
}

#[test]
fn example_10_1_in_closed_form_and_in_print() {
    let m = findings("example-10-1").metrics;
    let r = 0.1 * FRAC_1_SQRT_2;
    let (X, Y) = (r / (0.5 - r), 0.1 / (0.5 - r));
    assert_close(&m["s"], &[0.0, 0.0, X, 0.0, X, Y, 0.0, 0.2], 1e-9);
    assert_close(&m["s"], &[0.0, 0.0, 0.1647, 0.0, 0.1647, 0.2329, 0.0, 0.2], 5e-5);
    // H is [r1 r2 o] up to 1/zeta, |zeta| = 1.5; its sign puts the points in front of the camera.
    let c = FRAC_1_SQRT_2 / 1.5;
    assert_close(&m["H"], &[c, 0.0, 0.0, 0.0, 1.0 / 1.5, 0.0, -c, 0.0, 0.5 / 1.5], 1e-9);
    assert_close(&m["H"], &[0.4714, 0.0, 0.0, 0.0, 0.6667, 0.0, -0.4714, 0.0, 0.3333], 5e-5);
    assert_close(&m["zeta"], &[1.5], 1e-9);
    let (h, o) = (FRAC_1_SQRT_2, 0.0);
    let T = [h, o, h, o, o, 1.0, o, o, -h, o, h, 0.5, o, o, o, 1.0];
    assert_close(&m["T_co"], &T, 1e-9);
    assert_close(&m["T_co_refined"], &T, 1e-9);
}

#[test]
fn example_10_4_converges_in_about_thirty_steps() {
    let m = findings("example-10-4").metrics;
    assert_close(&m["x_final"], &[0.0, 0.0, 0.5, 0.0, FRAC_PI_3 * 0.75, 0.0], 1e-9);
    assert!(m["error_after_30_steps"].as_f64().unwrap() < 0.01);
    // With the printed step the error rises once, then falls by 1 - 160 * 0.001 a step.
    let e = numbers(&m["feature_error"]);
    assert!(e[1] > e[0] && e[2] < e[1]);
    assert!(e[5..60].windows(2).all(|pair| (pair[1] / pair[0] - 0.84).abs() < 0.03));
}

/// The text's two vectors, and two more that the point's image does not feel: together four directions.
#[test]
fn example_10_2_has_four_motions_without_effect() {
    let m = findings("example-10-2").metrics;
    let (s, z) = (numbers(&m["s"]), m["z_m"].as_f64().unwrap());
    let (X, Y) = (s[0], s[1]);
    let printed =
        [[-1.0 / z, 0.0, X / z, X * Y, -(1.0 + X * X), Y], [0.0, -1.0 / z, Y / z, 1.0 + Y * Y, -X * Y, -X]];
    assert_close(&m["L_s"], printed.as_flattened(), 1e-12);
    let basis: Vec<_> =
        m["null_space"].as_array().unwrap().iter().map(|entry| numbers(&entry["v"])).collect();
    assert_eq!(basis[0], [X, Y, 1.0, 0.0, 0.0, 0.0]);
    assert_eq!(basis[1], [0.0, 0.0, 0.0, X, Y, 1.0]);
    for v in &basis {
        for row in printed {
            let moved: f64 = row.iter().zip(v).map(|(l, v)| l * v).sum();
            assert!(moved.abs() < 1e-12, "{v:?}");
        }
    }
    let columns = nalgebra::SMatrix::<f64, 6, 4>::from_fn(|i, j| basis[j][i]);
    assert!((columns.transpose() * columns).determinant() > 1e-3, "independent");
}

/// The note on Example 10.4: several poses show P1, P2 and P3 where they are, and the integration stays with the one that it starts beside.
#[test]
fn example_10_4_with_three_points_has_several_ends() {
    let m = findings("example-10-4").metrics;
    let solutions = m["three_points"].as_array().unwrap();
    assert!((2..=4).contains(&solutions.len()), "{solutions:?}");
    assert_eq!(solutions.iter().filter(|s| s["is_sought"] == true).count(), 1);
    for solution in solutions {
        assert!(solution["distance_from_beside"].as_f64().unwrap() < 1e-6, "{solution}");
        let x = numbers(&solution["x"]);
        let R = nalgebra::Rotation3::from_euler_angles(x[5], x[4], x[3]);
        for ((rx, ry), s) in [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1)].into_iter().zip(0..) {
            let p = R * nalgebra::Point3::new(rx, ry, 0.0) + nalgebra::Vector3::new(x[0], x[1], x[2]);
            let r = 0.1 * FRAC_1_SQRT_2;
            let seen = [[0.0, 0.0], [r / (0.5 - r), 0.0], [r / (0.5 - r), 0.1 / (0.5 - r)]][s];
            assert!((p.x / p.z - seen[0]).abs() < 1e-9 && (p.y / p.z - seen[1]).abs() < 1e-9, "{solution}");
        }
    }
}

/// A regular triangle about the optical axis at sqrt(3) times its circumradius R: all corners at 2 R, or any one of them at R / 2.
#[test]
fn a_triangle_about_the_axis_has_four_poses() {
    let m = findings("example-10-4").metrics;
    let solutions = m["triangle"].as_array().unwrap();
    assert_eq!(solutions.len(), 4, "{solutions:?}");
    assert_eq!(m["three_points"].as_array().unwrap().len(), 2);
    assert_eq!(solutions.iter().filter(|s| s["is_sought"] == true).count(), 1);
    let (r, s) = (numbers(&m["triangle_m"]), numbers(&m["triangle_s"]));
    let mut near = Vec::new();
    for solution in solutions {
        assert!(solution["distance_from_beside"].as_f64().unwrap() < 1e-6, "{solution}");
        let x = numbers(&solution["x"]);
        let R = nalgebra::Rotation3::from_euler_angles(x[5], x[4], x[3]);
        for (i, (r, s)) in r.chunks_exact(2).zip(s.chunks_exact(2)).enumerate() {
            let p = R * nalgebra::Vector3::new(r[0], r[1], 0.0) + nalgebra::Vector3::new(x[0], x[1], x[2]);
            assert!(p.z > 0.0 && (p.x / p.z - s[0]).abs() < 1e-9 && (p.y / p.z - s[1]).abs() < 1e-9);
            assert!((p.norm() - 0.2).abs() < 1e-9 || (p.norm() - 0.05).abs() < 1e-9, "{solution}");
            if p.norm() < 0.1 {
                near.push(i);
            }
        }
    }
    near.sort_unstable();
    assert_eq!(near, [0, 1, 2], "each corner is the near one once");
}

/// Both solutions of the homography by the closed form for a plane: the second one turns about another axis, and it too has every point in
/// front of both cameras.
#[test]
fn example_10_5_shows_both_admissible_solutions() {
    let m = findings("example-10-5").metrics;
    let solutions = m["solutions"].as_array().unwrap();
    assert_eq!(solutions.len(), 2, "{solutions:?}");
    assert!(solutions[0]["is_true"] == true && solutions[1]["is_true"] == false);
    assert_eq!(solutions[0]["n_2"], m["decomposition"]["n_2"]);
    let H = nalgebra::Matrix3::from_row_slice(&numbers(&m["H"]));
    let mut seen = Vec::new();
    for solution in solutions {
        let R = nalgebra::Matrix3::from_row_slice(&numbers(&solution["R_12"]));
        let [p, n] = ["displacement_over_d2", "n_2"]
            .map(|key| nalgebra::Vector3::from_row_slice(&numbers(&solution[key])));
        assert!((R * R.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-9);
        assert!((R + p * n.transpose() - H).norm() < 1e-9, "{solution}");
        for s in numbers(&m["s2"]).chunks_exact(2) {
            let p_2 = nalgebra::Vector3::new(s[0], s[1], 1.0);
            let p_2 = p_2 / n.dot(&p_2);
            assert!(p_2.z > 0.0 && (R * p_2 + p).z > 0.0, "{solution}");
        }
        seen.push(n);
    }
    // The plane of the false solution is tilted, by the angle between the true normal and the base line (Malis and Vargas 2007).
    assert!(seen[0].angle(&seen[1]) > 0.5, "{seen:?}");
}

#[test]
fn example_10_5_in_closed_form_and_in_print() {
    let m = findings("example-10-5").metrics;
    let (s, c) = (FRAC_PI_3.sin(), FRAC_PI_3.cos());
    // o_1,2 = o_1 - R_2^1 o_2 with the object 0.5 m and 0.6 m away, over d_2 = 0.6 m.
    let o = [(0.1 * c + 0.1 * s) / 0.6, (0.1 * s - 0.1 * c) / 0.6, (0.5 - 0.6) / 0.6];
    let H = [c, -s, o[0], s, c, o[1], 0.0, 0.0, 1.0 + o[2]];
    assert_close(&m["H"], &H, 1e-9);
    assert_close(&m["H"], &[0.5, -0.8660, 0.2277, 0.8660, 0.5, 0.0610, 0.0, 0.0, 0.8333], 5e-5);
    let printed = [0.3015, -0.5222, 0.1373, 0.5222, 0.3015, 0.0368, 0.0, 0.0, 0.5025];
    assert_close(&m["zeta_H"], &printed, 5.1e-5);
    assert_close(&m["zeta"], &[1.6583], 5e-5);
    assert_close(&m["beta_rad"], &[FRAC_PI_3], 1e-9);
    // The text prints -0.0667 for the third component; h33 - 1 is -0.1667.
    assert_close(&m["displacement_over_d2"], &o, 1e-9);
    assert_close(&m["displacement_over_d2"], &[0.2277, 0.0610, -0.1667], 5e-5);
    assert_close(&m["decomposition"]["displacement_over_d2"], &o, 1e-9);
    assert_close(&m["decomposition"]["n_2"], &[0.0, 0.0, 1.0], 1e-9);
    assert_close(&m["decomposition"]["R_12"], &[c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0], 1e-9);
}

/// Sect. 10.1.1: what one look leaves grows with the error of the description, and what laws that look on the way need does not.
#[test]
fn look_and_move_is_as_accurate_as_its_description() {
    let m = findings("look-and-move").metrics;
    let runs = |scheme: &str, error: &str| -> Vec<Value> {
        let all = m["runs"].as_array().unwrap().iter();
        let of: Vec<_> = all.filter(|r| r["scheme"] == scheme && r["error"] == error).cloned().collect();
        assert!(of.len() >= 4 && of.iter().all(|r| r["converged"] == true), "{of:#?}");
        of
    };
    for error in ["mount turned", "joint 2 off"] {
        let open = runs("look_and_move", error);
        let wrong: Vec<_> = open.iter().filter(|r| r["degrees"].as_f64().unwrap() > 0.0).collect();
        let per_degree =
            |r: &&Value| r["after_one_look_px"].as_f64().unwrap() / r["degrees"].as_f64().unwrap();
        for run in &wrong[1..] {
            assert!((per_degree(run) / per_degree(&wrong[0]) - 1.0).abs() < 0.15, "{run}");
        }
        assert!(wrong.last().unwrap()["motions"].as_u64().unwrap() >= 4, "{open:#?}");
        for scheme in ["position_resolved_velocity", "image_resolved_velocity"] {
            let times = runs(scheme, error);
            let time_s = |r: &Value| r["settling_time_s"].as_f64().unwrap();
            assert!(times.iter().all(|r| (time_s(r) / time_s(&times[0]) - 1.0).abs() < 0.25), "{times:#?}");
        }
    }
}

#[test]
fn problems_10_4_and_10_5_find_the_desired_pose() {
    let (s, c) = (FRAC_PI_3.sin(), FRAC_PI_3.cos());
    let T = [c, s, 0.0, -0.1, -s, c, 0.0, 0.1, 0.0, 0.0, 1.0, 0.6, 0.0, 0.0, 0.0, 1.0];
    for name in ["problem-10-4", "problem-10-5"] {
        let m = findings(name).metrics;
        assert_close(&m["T_co"], &T, 1e-9);
        assert_close(&m["T_co_from_printed_digits"], &T, 2e-3); // four digits of an image 0.17 wide
    }
}

/// `tools/comparison_reference.py` wrote the tables: every 40 ms of an implementation that shares nothing with this one.
#[test]
fn the_comparison_agrees_with_an_independent_implementation() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/comparison");
    for scheme in SCHEMES {
        let text = std::fs::read_to_string(folder.join(format!("{}.csv", scheme.name()))).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some(vservo::experiment::HEADER));
        let run = run(scheme);
        assert_eq!(run.rows.len(), 8001);
        let tolerance = if matches!(scheme, Scheme::A | Scheme::C) { 1e-5 } else { 1e-6 };
        let mut compared = 0;
        for (line, row) in lines.zip(run.rows.iter().step_by(40)) {
            let expected: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
            let s = row.s.iter().flat_map(|s| [s.x, s.y]);
            let got: Vec<f64> = std::iter::once(row.time_s)
                .chain(row.x_c.iter().copied())
                .chain(s)
                .chain(row.q.iter().copied())
                .collect();
            for (a, b) in got.iter().zip(&expected) {
                assert!((a - b).abs() < 0.1 * tolerance, "{} at {} s: {a} {b}", scheme.name(), row.time_s);
            }
            for (a, b) in row.u.iter().zip(&expected[17..]) {
                assert!(
                    (a - b).abs() < tolerance * (1.0 + b.abs()),
                    "{} at {} s: u {a} {b}",
                    scheme.name(),
                    row.time_s
                );
            }
            compared += 1;
        }
        assert_eq!(compared, 201);
    }
}

#[test]
fn statements_on_the_camera_paths() {
    let of = SCHEMES.map(|scheme| (scheme, metrics(scheme)));
    for (scheme, m) in &of {
        let (z, path) = (m.z_overshoot_percent, m.camera_path_deviation);
        match scheme {
            Scheme::A => assert!(z < 0.1 && path < 0.1, "no retreat, almost straight: {z} {path}"),
            Scheme::B => assert!(z < 0.1 && path < 1e-3, "no retreat, straight: {z} {path}"),
            Scheme::C => {
                assert!((270.0..276.0).contains(&z) && path > 1.3, "retreats by several times: {z} {path}")
            }
            Scheme::D => assert!((48.0..50.0).contains(&z) && path > 0.45, "retreats by half: {z} {path}"),
            Scheme::Hybrid => assert!(z < 0.1 && path < 0.13, "between B and D: {z} {path}"),
        }
    }
}

#[test]
fn statements_on_the_image_paths() {
    let chosen = |scheme: Scheme| metrics(scheme).image_path_deviation;
    let d = chosen(Scheme::D);
    assert!(d[0] < 0.1 && d[1] < 0.1, "nearly straight: {d:?}");
    let hybrid = chosen(Scheme::Hybrid);
    assert!(hybrid[0] < 0.02, "P1 straight but for the arm's motion between frames: {hybrid:?}");
    let cell = Cell::textbook().unwrap();
    let mut controller = SchemeController::textbook(&cell, Scheme::Hybrid).unwrap();
    let fine =
        simulate_at(1, &cell, "hybrid", &mut FeatureSource::Ideal, 8.0, |frame| controller.control(frame));
    let path: Vec<Vector2<f64>> = fine.rows.iter().map(|row| row.s[0]).collect();
    let deviation = path_deviation(&path, &cell.goal().unwrap().s[0]);
    assert!(deviation < 1e-3, "P1 straight at 1 kHz: {deviation}");
    assert!(hybrid[1] > 0.02, "the others not: {hybrid:?}");
    let b = chosen(Scheme::B);
    assert!(b[1] > d[1] || b[0] > d[0], "{b:?}");
    // With the true depth and a fine step D's paths are straight.
    let exact = pure_rotation(1.0, DepthSource::Known).unwrap();
    for (i, corner) in [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)].into_iter().enumerate() {
        let path: Vec<Vector2<f64>> = exact.rows.iter().map(|row| row.s[i]).collect();
        let goal = Rotation2::new(1.0) * Vector2::new(corner.0, corner.1);
        let deviation = path_deviation(&path, &goal);
        assert!(deviation < 2e-3, "{deviation}");
    }
}

#[test]
fn statements_on_time_constants() {
    // B: x~' = -K x~ with K = diag(1, 1, 1, 2), here sampled: 2 % after ln 50 / K.
    let m = metrics(Scheme::B).settling_time_s;
    assert!(
        (m.position.unwrap() - 3.91).abs() < 0.15 && (m.orientation.unwrap() - 1.96).abs() < 0.15,
        "{m:?}"
    );
    // D: one second for the features.
    let m = metrics(Scheme::D).settling_time_s;
    assert!((m.features.unwrap() - 3.91).abs() < 0.3, "{m:?}");
    // Hybrid: phi' = -2 phi, which is (10.93) and takes the sign of (10.92) as corrected.
    let m = metrics(Scheme::Hybrid).settling_time_s;
    assert!((m.orientation.unwrap() - 1.96).abs() < 0.15, "{m:?}");
    let errors = metrics(Scheme::Hybrid).final_errors;
    assert!(errors.position_m < 1e-4 && errors.orientation_rad < 1e-6, "{errors:?}");
}

/// e_p' + r K_p e_p = -(1 - r) J_o w for an estimate of z_d that is r times the true one.
#[test]
fn delay_limits_the_gain_under_frame_and_not_under_predict() {
    let cell = Cell::textbook().unwrap();
    for scheme in [Scheme::B, Scheme::D] {
        // e[k+1] = e[k] - K T e[k-d]: K T = 2 sin(pi / (4 d + 2)).
        for (d, delay_ms) in [(0.0, 0), (1.0, 40), (2.0, 80)] {
            let theory = 2.0 * (std::f64::consts::PI / (4.0 * d + 2.0)).sin() / 0.04;
            let (update, disturbance) = (UpdatePolicy::Frame, Disturbance::NONE);
            let frame = DelayedLoop { scheme, update, delay_ms, lag_s: 0.0, disturbance };
            let limit = frame.largest_stable_gain(&cell).unwrap();
            assert!((limit / theory - 1.0).abs() < 0.03, "{} {delay_ms} ms: {limit} {theory}", scheme.name());
            let predict = DelayedLoop { update: UpdatePolicy::Predict, ..frame };
            assert!(predict.is_stable(&cell, 10.0 * limit).unwrap(), "{} {delay_ms} ms", scheme.name());
        }
    }
}

/// The figures that the study is judged by, at both delays and with both arms.
#[test]
fn predict_settles_sooner_and_tolerates_wrong_inputs() {
    let cell = Cell::textbook().unwrap();
    for (lag_s, delay_ms) in [(0.0, 40), (0.0, 80), (0.02, 40), (0.02, 80)] {
        let found = study(&cell, Scheme::D, lag_s, delay_ms).unwrap();
        assert!(found.speed_up >= 2.5, "{lag_s} s, {delay_ms} ms: {found:?}");
        assert!(found.irregular_speed_up >= 0.8 * found.speed_up, "{lag_s} s, {delay_ms} ms: {found:?}");
        let (update, scheme) = (UpdatePolicy::Predict, Scheme::D);
        for disturbance in errors_to_bear() {
            let wrong = DelayedLoop { scheme, update, delay_ms, lag_s, disturbance };
            assert!(wrong.is_stable(&cell, found.predict.gain_1_s).unwrap(), "{disturbance:?}");
        }
    }
}

#[test]
fn random_starts_end_with_a_reason() {
    // Of sixty starts: home, out of the image, out of sight. The rest of C is on its way.
    for (variant, home, left, lost) in [
        ("A", 58, 2, 0),
        ("B", 44, 16, 0),
        ("C", 0, 0, 0),
        ("D", 47, 10, 3),
        ("D-true-depth", 60, 0, 0),
        ("hybrid", 60, 0, 0),
        ("C-preconditioned", 60, 0, 0),
        ("A-guarded", 60, 0, 0),
        ("B-guarded", 60, 0, 0),
        ("C-guarded", 60, 0, 0),
        ("D-guarded", 60, 0, 0),
        ("hybrid-guarded", 60, 0, 0),
    ] {
        let variant = LAW_VARIANTS.iter().find(|f| f.name == variant).unwrap();
        let runs = runs_of(variant, 60).unwrap();
        let count = |outcome| runs.iter().filter(|f| f.outcome == outcome).count() as i32;
        let got = [StartOutcome::Converged, StartOutcome::LeftImage, StartOutcome::TargetLost].map(count);
        // One may lie on the edge of an image, where the last bit of another machine decides.
        let near = got.iter().zip([home, left, lost]).all(|(got, expected)| (got - expected).abs() <= 1);
        assert!(near, "{}: {got:?}, expected {:?}", variant.name, [home, left, lost]);
        let mut image: Vec<f64> = runs.iter().map(|f| f.last_error_px / f.first_error_px).collect();
        image.sort_by(f64::total_cmp);
        let (quarter, median, worst) = (image[15], image[30], image[59]);
        if variant.name == "C" {
            // The transposed Jacobian is as slow as the square's image is ill-conditioned: nobody is home after 120 s, but
            // the image is on its way there from every start. What is left of its error lies in the directions that hardly
            // move; with half of the stiffness it would be 3 % more.
            assert_eq!(
                count(StartOutcome::TooSlow) + count(StartOutcome::ImageOnly),
                60,
                "none stands, none leaves"
            );
            assert!(worst < 0.5, "C: error left in the image {worst} at worst");
            let obtained = [quarter / 0.01083, median / 0.03745];
            assert!(obtained.iter().all(|r| (r - 1.0).abs() < 0.01), "C: error left {quarter} {median}");
        } else {
            assert_eq!(got.iter().sum::<i32>(), 60, "{}: none diverges, none stands elsewhere", variant.name);
            assert!(median < 0.005, "{}: error left in the image {median}", variant.name);
        }
        // Other shares of the work for each core: every start is its own.
        for (a, b) in runs_of(variant, 7).unwrap().iter().zip(&runs) {
            assert_eq!((a.outcome, a.time_s), (b.outcome, b.time_s), "the same on every run");
        }
    }
}

#[test]
fn problems_10_8_to_10_11_beside_the_points() {
    for (name, scheme) in
        [("problem-10-8", "A"), ("problem-10-9", "B"), ("problem-10-10", "C"), ("problem-10-11", "D")]
    {
        let m = findings(name).metrics;
        let (segment, points) = (&m[&format!("{scheme}-segment")], &m[scheme]);
        assert_eq!(segment["end"], "finished");
        let [z, of_points] =
            [segment, points].map(|metrics| metrics["z_overshoot_percent"].as_f64().unwrap());
        // The segment's length holds the camera's height under B and D; under a torque law it lags behind the angle.
        match scheme {
            "C" => assert!((90.0..95.0).contains(&z) && of_points > 270.0, "{name}: {z} {of_points}"),
            "D" => assert!(z < 0.1 && of_points > 45.0, "{name}: {z} {of_points}"),
            _ => assert!(z < 0.1 && (z - of_points).abs() < 1e-4, "{name}: {z} {of_points}"),
        }
        if matches!(scheme, "A" | "B") {
            // The same law on the same pose: only the way of estimating it differs.
            let settled = |m: &Value| m["settling_time_s"]["position"].as_f64().unwrap();
            assert!((settled(segment) - settled(points)).abs() < 0.002);
        } else {
            // Obtained: 0.15 mm and 0.06 mm; the points alone end 20 mm and 0.1 mm off after these eight seconds.
            assert!(segment["final_errors"]["position_m"].as_f64().unwrap() < 0.3e-3, "{segment}");
        }
    }
}

#[test]
fn rendered_images_bring_the_same_runs() {
    let cell = Cell::textbook().unwrap();
    let goal = cell.goal().unwrap();
    for scheme in [Scheme::B, Scheme::D, Scheme::Hybrid] {
        let mut source = FeatureSource::Rendered(Box::new(RenderedFeatures::new(1).unwrap()));
        let rendered = run_scheme(&cell, scheme, &mut source).unwrap();
        assert_eq!(rendered.end, TrajectoryEnd::Finished);
        let errors = Metrics::of(&rendered, &goal).unwrap().final_errors;
        assert!(errors.position_m < 0.25e-3 && errors.orientation_rad < 0.5e-3, "{errors:?}");
        let apart = rendered.rows.iter().zip(run(scheme).rows).map(|(a, b)| (a.x_c - b.x_c).norm());
        let apart = apart.fold(0.0, f64::max);
        assert!(apart < 0.1e-3, "{}: {apart}", scheme.name()); // 0.03e-3 m and rad are obtained
    }
}

#[test]
fn a_target_out_of_sight_ends_a_run_with_its_reason() {
    let mut cell = Cell::textbook().unwrap();
    cell.q_start += Vector4::new(0.6, 0.0, 0.0, 0.0);
    let mut source = FeatureSource::Rendered(Box::new(RenderedFeatures::new(1).unwrap()));
    let run = run_scheme(&cell, Scheme::D, &mut source).unwrap();
    assert!(
        matches!(&run.end, TrajectoryEnd::Stopped { reason, .. } if reason.contains("no target")),
        "{:?}",
        run.end
    );
}

#[test]
fn the_command_line_writes_tables_figures_and_metrics() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("deep/comparison");
    let run = vservo().args(["experiment", "comparison", "--out"]).arg(&out).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert!(String::from_utf8_lossy(&run.stderr).contains("scheme hybrid"), "progress on stderr");
    for name in ["A", "B", "C", "D", "hybrid"] {
        let text = std::fs::read_to_string(out.join(format!("{name}.csv"))).unwrap();
        assert_eq!(text.lines().next(), Some(vservo::experiment::HEADER));
        assert_eq!(text.lines().count(), 8002);
        assert!(text.lines().nth(1).unwrap().starts_with("0.000,1.0000000000,1.0000000000,0.5000000000,"));
        assert!(out.join(format!("{name}-pose.svg")).exists());
    }
    let metrics: Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("metrics.json")).unwrap()).unwrap();
    assert!(metrics["D"]["z_overshoot_percent"].as_f64().unwrap() > 45.0);
}

/// A page without the bytes of its pictures, which may spell anything.
fn without_pictures(page: &str) -> String {
    let mut parts = page.split("data:image/png;base64,");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |told, part| told + part.split_once('"').map_or("", |(_, rest)| rest))
}

#[test]
fn figures_of_the_second_section_are_those_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let run = vservo().args(["experiment", "figures-10-2", "--out"]).arg(folder.path()).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let metrics: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("metrics.json")).unwrap()).unwrap();
    let number = |name: &str| metrics[name].as_f64().unwrap();
    // the lighter object is painted at 125 and the ground at 205, a little darker towards the corners
    assert!((number("object_mode_level") - 125.0).abs() < 8.0, "{metrics}");
    assert!((number("background_mode_level") - 205.0).abs() < 8.0, "{metrics}");
    assert!((135.0..195.0).contains(&number("threshold_level")), "{metrics}");
    assert!(number("centroid_error_px") < 0.1 && number("alpha_error_rad").abs() < 2e-3, "{metrics}");
    for name in ["figure-10-1", "figure-10-2", "figure-10-3-roberts", "figure-10-3-sobel", "figure-10-4"] {
        let picture = image::open(folder.path().join(format!("{name}.png"))).unwrap();
        assert_eq!((picture.width(), picture.height()), (640, 480), "{name}");
    }
    let binary = image::open(folder.path().join("figure-10-2.png")).unwrap().into_luma8();
    // the dark object covers 0.0064 m^2 of the plane, the lighter one 0.0045: 6.6 and 4.6 % of what the camera sees at 0.45 m
    let share = binary.pixels().filter(|p| p.0[0] > 0).count() as f64 / (640.0 * 480.0);
    assert!((0.07..0.16).contains(&share), "{share}");
}

#[test]
fn all_writes_an_index_with_every_figure() {
    let folder = tempfile::tempdir().unwrap();
    let run =
        vservo().args(["experiment", "all", "--count", "10", "--out"]).arg(folder.path()).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let index = std::fs::read_to_string(folder.path().join("index.html")).unwrap();
    let mut figures = 0;
    let drawing = |word: &str, page: &str| page.matches(word).count();
    for experiment in vservo::experiment::EXPERIMENTS {
        let own = folder.path().join(experiment.name);
        assert!(own.join("metrics.json").exists());
        assert!(index.contains(&format!("href=\"{}/index.html\"", experiment.name)));
        let page = std::fs::read_to_string(own.join("index.html")).unwrap();
        assert!(!page.contains("<p class=\"says\"></p>"), "each figure says something: {}", experiment.name);
        assert!(!without_pictures(&page).contains("NaN"), "{}", experiment.name);
        let before = figures;
        for entry in std::fs::read_dir(&own).unwrap().flatten() {
            let file = entry.file_name().into_string().unwrap();
            if file.ends_with(".svg") {
                figures += 1;
                assert!(page.contains(&format!("href=\"{file}\"")), "{file}");
                let svg = std::fs::read_to_string(entry.path()).unwrap();
                assert!(svg.starts_with("<svg") && !svg.contains("NaN") && !svg.contains("inf\""), "{file}");
            }
        }
        assert_eq!(drawing("class=\"chart wide\"", &page), figures - before, "every figure is in the page");
    }
    assert!(figures > 30, "{figures}");
}

#[test]
fn wrong_names_and_places_are_told_from_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let run = vservo().args(["experiment", "nonsense", "--out"]).arg(folder.path()).output().unwrap();
    assert_eq!(run.status.code(), Some(2));
    let text = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(text.contains("comparison") && text.contains("problem-10-11") && text.contains("all"), "{text}");
    let file = folder.path().join("file");
    std::fs::write(&file, "in the way").unwrap();
    let run = vservo().args(["experiment", "example-10-1", "--out"]).arg(file.join("x")).output().unwrap();
    assert_eq!(run.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&run.stderr).contains("cannot be written"));
    let run = vservo()
        .args(["experiment", "example-10-1", "--camera", "rendered", "--out"])
        .arg(folder.path())
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&run.stderr).contains("comparison"));
}
