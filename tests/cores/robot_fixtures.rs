//! Kinematics and dynamics against Pinocchio and MuJoCo, over random states of shipped robots and random chains.
//!
//! tools/robot_fixtures.py made the tables in fixtures/robot/ and says what their columns are.

#![allow(non_snake_case, clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use nalgebra::{Rotation3, SMatrix, SVector};
use vservo::dispatch_robot;
use vservo::linalg::Random;
use vservo::robot::{Robot, SHIPPED, load};

/// Largest deviation, relative to the largest entry of the quantity in that state; 1e-12 is what there is.
const TOLERANCE: f64 = 1e-11;

fn vector<const N: usize>(random: &mut Random, bound: f64) -> SVector<f64, N> {
    SVector::from_fn(|_, _| (2.0 * random.uniform() - 1.0) * bound)
}

fn table(name: &str) -> Vec<f64> {
    let path = format!("{}/tests/fixtures/robot/{name}.f64", env!("CARGO_MANIFEST_DIR"));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{path}: {e}"));
    bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
}

/// The largest relative deviation of every quantity over all rows of the table.
fn compare<const N: usize>(robot: &Robot<N>, table: &[f64], states: usize) -> [f64; 6] {
    let columns = 12 + 6 * N + N + N * (N + 1) / 2 + N;
    assert_eq!(table.len(), columns * states, "{}: rows in the table", robot.name());
    let mut worst = [0.0f64; 6];
    let mut random = Random::new(1); // as in the script
    for row in table.chunks_exact(columns) {
        let [q, qd, qdd, tau]: [SVector<f64, N>; 4] =
            [3.0, 2.0, 5.0, 20.0].map(|bound| vector(&mut random, bound));
        let (X, J) = (robot.forward(&q), robot.jacobian(&q));
        let R = Rotation3::from(X.rotation);
        let B = robot.mass_matrix(&q);
        let lower: Vec<f64> = (0..N).flat_map(|i| (0..=i).map(move |j| (i, j))).map(|ij| B[ij]).collect();
        let ours: [Vec<f64>; 6] = [
            X.translation.vector.as_slice().to_vec(),
            R.matrix().transpose().as_slice().to_vec(),
            row_major(&J),
            robot.inverse_dynamics(&q, &qd, &qdd).as_slice().to_vec(),
            lower,
            robot.forward_dynamics(&q, &qd, &tau).as_slice().to_vec(),
        ];
        let mut rest = row;
        for (worst, ours) in worst.iter_mut().zip(&ours) {
            let (theirs, behind) = rest.split_at(ours.len());
            rest = behind;
            let scale = theirs.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            for (a, b) in ours.iter().zip(theirs) {
                *worst = worst.max((a - b).abs() / scale);
                assert!(a.is_finite(), "{}: {a}", robot.name());
            }
        }
        // The same quantity by its other entry point.
        let g = robot.gravity(&q);
        assert!(
            (robot.inverse_dynamics(&q, &SVector::zeros(), &SVector::zeros()) - g).amax()
                < 1e-11 * g.amax().max(1.0)
        );
    }
    worst
}

fn row_major<const N: usize>(J: &SMatrix<f64, 6, N>) -> Vec<f64> {
    J.transpose().as_slice().to_vec()
}

fn check(robot: &str, name: &str, library: &str, states: usize) {
    let table = table(&format!("{name}.{library}"));
    let description = load(robot).unwrap();
    let worst = dispatch_robot!(description, |robot| compare(&robot, &table, states)).unwrap();
    let text = worst.map(|x| format!("{x:.1e}")).join(" ");
    println!("{name} {library}: p R J tau B qdd {text}");
    assert!(worst.iter().all(|&x| x < TOLERANCE), "{name} {library}: p R J tau B qdd {text}");
}

#[test]
fn shipped_robots_agree_with_pinocchio() {
    for name in SHIPPED {
        check(name, name, "pin", 1000);
    }
}

#[test]
fn shipped_robots_agree_with_mujoco() {
    for name in SHIPPED {
        check(name, name, "mujoco", 100);
    }
}

#[test]
fn random_chains_agree_with_both() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/robot");
    for n in 2..=7 {
        // The chains have fixed branches, so the tip has to be named: a run-time TOML beside the URDF does it.
        let toml = format!(
            "name = \"chain_{n}\"\n[urdf]\nfile = \"{folder}/chain_{n}.urdf\"\nbase = \"base\"\ntip = \"tip\"\n"
        );
        let file = tempfile::Builder::new().suffix(".toml").tempfile().unwrap();
        std::fs::write(file.path(), toml).unwrap();
        let path = file.path().to_str().unwrap();
        check(path, &format!("chain_{n}"), "pin", 100);
        check(path, &format!("chain_{n}"), "mujoco", 20);
    }
}

#[test]
fn motors_gears_and_a_leaning_base_agree_with_both() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/robot/chain_5_motors.toml");
    check(path, "chain_5_motors", "pin", 100);
    check(path, "chain_5_motors", "mujoco", 20);
}
