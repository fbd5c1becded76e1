//! Velocities that a client commands: the arm moves by them and by nothing else, rests soon after the client is silent, keeps its limits whatever is asked
//! for, and servoes under a law of the client's own.

#![allow(non_snake_case, clippy::unwrap_used)] // monogram notation; helpers of tests

use nalgebra::{SVector, Vector3, Vector6};
use std::path::Path;
use vservo::config::{Config, assemble};
use vservo::control::lifecycle::{Refusal, Request};
use vservo::control::trace::Event;
use vservo::geometry::Pose;
use vservo::linalg::Random;
use vservo::messages::{CommandForm, ControlCommand, ControlState};
use vservo::mission::LockstepRun;
use vservo::robot::Robot;
use vservo::time::MonoNs;

const TICK_S: f64 = 1e-3;

/// A served arm that sees nothing.
struct Cell<const N: usize> {
    config: Config,
    robot: Robot<N>,
    run: LockstepRun<N>,
    k: u64,
    asked: u64,
    /// True velocities, and those of the reference, of the last tick.
    qd: SVector<f64, N>,
    qd_r: SVector<f64, N>,
    q: SVector<f64, N>,
    ended_at: Option<u64>,
}

impl<const N: usize> Cell<N> {
    fn new(file: &str, set: &[&str]) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
        let set = ["run.clock=lockstep", "run.serve=true"].iter().chain(set).map(|s| (*s).to_owned());
        let config = Config::load(Some(&path), &set.collect::<Vec<_>>()).unwrap();
        let robot: Robot<N> = config.robot.build().unwrap();
        let run = assemble::control_loop::<N>(&config, robot.clone()).unwrap();
        let zero = SVector::zeros();
        Self { config, robot, run, k: 0, asked: 0, qd: zero, qd_r: zero, q: zero, ended_at: None }
    }

    fn tick(&mut self) {
        let now = MonoNs(self.k as i64 * 1_000_000);
        let state = self.run.sense(self.k, now);
        self.q = SVector::from_fn(|i, _| state.q_true[i]);
        self.qd = SVector::from_fn(|i, _| state.qd_true[i]);
        let trace = self.run.act(now, None);
        assert_eq!(trace.fault, None, "at {}", self.k);
        self.qd_r = SVector::from_fn(|i, _| trace.command.qd_r[i]);
        if trace.events.iter().any(|event| event == Event::VelocityEnded) {
            self.ended_at = Some(self.k);
        }
        self.k += 1;
    }

    fn run_for(&mut self, ticks: u64) {
        (0..ticks).for_each(|_| self.tick());
    }

    fn command(&mut self, form: CommandForm, velocity: &[f64], hold_s: f64) -> Result<(), Refusal> {
        let numbers: Vec<f64> = velocity.iter().copied().chain([hold_s]).collect();
        self.asked += 1;
        let request = Request::Velocity;
        self.run.ask(
            self.asked,
            request,
            &ControlCommand::with_numbers(request as u32, form, &numbers).unwrap(),
        )
    }

    fn camera(&self) -> Pose {
        self.config.camera.mount.X_WC(&self.robot, &self.q)
    }
}

/// The twist of a camera that went from `before` to `after` in a time, in its own frame, m/s and rad/s.
fn twist_between(before: &Pose, after: &Pose, time_s: f64) -> Vector6<f64> {
    let step = before.inv_mul(after);
    let (v, w) = (step.translation.vector / time_s, step.rotation.scaled_axis() / time_s);
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

#[test]
fn the_camera_moves_by_the_twist_that_was_asked_for() {
    for mode in ["torque", "velocity", "position"] {
        let mut cell = Cell::<6>::new("ur5.toml", &[&format!("drive.mode=\"{mode}\"")]);
        cell.run_for(20);
        for V_C in [[0.04, -0.03, 0.02, 0.0, 0.0, 0.0], [0.0, 0.02, 0.0, 0.1, -0.15, 0.2]] {
            for _ in 0..5 {
                cell.command(CommandForm::CameraTwist, &V_C, 0.1).unwrap();
                cell.run_for(80);
            }
            let before = cell.camera();
            cell.run_for(10);
            let seen = twist_between(&before, &cell.camera(), 10.0 * TICK_S);
            // What friction and lag of the simulated arm leave of it.
            assert!((seen - Vector6::from(V_C)).norm() < 4e-3, "{mode}: {seen} {V_C:?}");
        }
    }
}

#[test]
fn an_arm_whose_client_is_silent_rests_and_is_held() {
    let mut cell = Cell::<6>::new("ur5.toml", &[]);
    cell.run_for(20);
    let qd = [0.3, -0.2, 0.25, 0.1, -0.3, 0.4];
    let begun = cell.k;
    let from = cell.q;
    cell.command(CommandForm::JointVelocity, &qd, 0.2).unwrap();
    cell.run_for(150);
    assert!((cell.qd - Vector6::from(qd)).amax() < 0.02, "{}", cell.qd);
    cell.run_for(300);
    // 0.2 s, and to brake from 0.4 rad/s at 10 rad/s2 and 500 rad/s3.
    let ended = cell.ended_at.unwrap() - begun;
    assert!((200..=290).contains(&ended), "{ended}");
    assert_eq!(cell.run.state(), ControlState::Held);
    assert!(cell.qd.amax() < 2e-3, "{}", cell.qd);
    // It brakes as it began, so that the way is that of the velocity over its time.
    assert!((cell.q - from - Vector6::from(qd) * 0.2).amax() < 3e-3, "{}", cell.q - from);
}

#[test]
fn what_is_too_fast_keeps_its_direction() {
    let mut cell = Cell::<6>::new("ur5.toml", &[]);
    cell.run_for(20);
    let limit = assemble::motion_limits(&cell.config, &cell.robot).unwrap().velocity;
    let qd = Vector6::new(12.0, -6.0, 3.0, 0.0, 1.5, 9.0);
    cell.command(CommandForm::JointVelocity, qd.as_slice(), 1.0).unwrap();
    cell.run_for(450);
    let excess = qd.zip_map(&limit, |qd, limit| qd.abs() / limit).max();
    assert!(excess > 2.0, "the test asks for too little");
    assert!((cell.qd_r - qd / excess).amax() < 1e-3, "{} {}", cell.qd_r, qd / excess);
}

#[test]
fn limits_hold_whatever_is_commanded_and_whenever() {
    let mut random = Random::new(41);
    for (file, mode) in [("ur5.toml", "torque"), ("ur5.toml", "velocity"), ("ur5-b.toml", "position")] {
        let mut cell = Cell::<6>::new(file, &[&format!("drive.mode=\"{mode}\"")]);
        let limits = assemble::motion_limits(&cell.config, &cell.robot).unwrap();
        let (mut next, mut used) = (20, [0.0_f64; 3]);
        let (mut last, mut a_last) = (Vector6::zeros(), Vector6::zeros());
        while cell.k < 8000 {
            if cell.k == next {
                next += random.between(1.0, 200.0) as u64;
                let v: Vec<f64> = (0..6).map(|_| random.between(-4.0, 4.0)).collect();
                let hold_s = random.between(0.01, 0.3);
                let (form, v) = match random.between(0.0, 3.0) as u32 {
                    0 => (CommandForm::JointVelocity, v),
                    1 => (CommandForm::CameraTwist, v),
                    _ => (CommandForm::CameraTwist, v.iter().map(|v| v * 0.05).collect()),
                };
                cell.command(form, &v, hold_s).unwrap();
            }
            cell.tick();
            let a = (cell.qd_r - last) / TICK_S;
            let j = (a - a_last) / TICK_S;
            for i in 0..6 {
                let shares =
                    [cell.qd_r[i] / limits.velocity[i], a[i] / limits.acceleration[i], j[i] / limits.jerk[i]];
                used.iter_mut().zip(shares).for_each(|(used, share)| *used = used.max(share.abs()));
            }
            (last, a_last) = (cell.qd_r, a);
            assert!(cell.robot.outside_limits(&cell.q).is_none(), "{file} {mode} {}", cell.q);
        }
        assert!(used.iter().all(|share| *share <= 1.0 + 1e-6), "{file} {mode}: {used:?}");
        assert!(used[1] > 0.9 && used[2] > 0.9, "the limits were used: {used:?}");
        cell.run_for(1500);
        assert_eq!(cell.run.state(), ControlState::Held);
        assert!(cell.qd.amax() < 5e-3, "{}", cell.qd);
    }
}

#[test]
fn numbers_that_are_no_velocity_are_refused() {
    let mut cell = Cell::<6>::new("ur5.toml", &[]);
    cell.run_for(20);
    let six = [0.1; 6];
    for (form, velocity, hold_s) in [
        (CommandForm::JointVelocity, &six[..5], 0.1),
        (CommandForm::CameraTwist, &six[..4], 0.1),
        (CommandForm::JointVelocity, &[][..], 0.1),
        (CommandForm::Joints, &six, 0.1),
        (CommandForm::JointVelocity, &six, 0.0),
        (CommandForm::JointVelocity, &six, -1.0),
        (CommandForm::JointVelocity, &six, 1.5),
        (CommandForm::JointVelocity, &six, f64::NAN),
        (CommandForm::CameraTwist, &[0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0], 0.1),
        (CommandForm::CameraTwist, &[0.0, 1e6, 0.0, 0.0, 0.0, 0.0], 0.1),
        (CommandForm::JointVelocity, &[f64::INFINITY; 6], 0.1),
    ] {
        let answer = cell.command(form, velocity, hold_s);
        assert_eq!(answer, Err(Refusal::WrongNumbers), "{form:?} {velocity:?} {hold_s}");
        cell.tick();
    }
    cell.run_for(50);
    assert_eq!((cell.run.state(), cell.qd.amax() < 1e-6), (ControlState::Idle, true));
    let mut dry = Cell::<6>::new("ur5.toml", &["drive.kind=\"none\"", "run.serve=false"]);
    dry.run_for(20);
    assert_eq!(dry.command(CommandForm::JointVelocity, &six, 0.1), Err(Refusal::NoArm));
}

/// A position-based law of twenty lines, as a user writes it: at 25 Hz, from the pose of the target in the camera.
#[test]
fn a_law_of_the_clients_own_reaches_its_goal() {
    let mut cell = Cell::<6>::new("ur5.toml", &[]);
    cell.run_for(20);
    let X_WO = cell.config.X_WO().unwrap();
    let X_DO = cell.config.set_point.X_DO().copied().unwrap();
    let error = |cell: &Cell<6>| {
        let X_CD = cell.camera().inv_mul(&X_WO) * X_DO.inverse();
        (X_CD.translation.vector, X_CD.rotation.scaled_axis())
    };
    let far = error(&cell).0.norm();
    for _ in 0..100 {
        let (p, r): (Vector3<f64>, Vector3<f64>) = error(&cell);
        let V_C = [p.x, p.y, p.z, r.x, r.y, r.z].map(|x| 2.0 * x);
        cell.command(CommandForm::CameraTwist, &V_C, 0.1).unwrap();
        cell.run_for(40);
    }
    let (p, r) = error(&cell);
    assert!(far > 0.05 && p.norm() < 1e-3 && r.norm() < 2e-3, "{far}: {p} {r}");
}
