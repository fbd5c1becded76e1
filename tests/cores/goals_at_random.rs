//! Goals, postures, small motions, gains, holds and starts come at random moments, while the arm moves and while it stands: neither the reference nor the
//! simulated arm ever steps, and the last goal is reached.

#![allow(non_snake_case, clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use nalgebra::SVector;
use std::path::Path;
use vservo::config::{Config, assemble};
use vservo::control::lifecycle::Request;
use vservo::linalg::Random;
use vservo::messages::{CommandForm, ControlCommand, ControlState, Measurement};
use vservo::motion::MotionLimits;
use vservo::robot::Robot;
use vservo::sim::perfect_measurement;
use vservo::time::MonoNs;

const DT_S: f64 = 1e-3;
/// Ticks with requests.
const RANDOM_TICKS: u64 = 12_000;

/// What a perfect camera measures from an arm in `q`.
fn seen<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    q: &SVector<f64, N>,
    k: u64,
) -> Option<Measurement> {
    let X_CO = config.camera.mount.X_WC(robot, q).inv_mul(&config.X_WO()?);
    let points_O: Vec<_> = config.target.points().iter().map(|point| point.p_O).collect();
    perfect_measurement(&points_O, &X_CO, MonoNs(k as i64 * 1_000_000))
}

/// The largest share of each limit that a motion has used: velocity, acceleration, jerk.
#[derive(Debug, Default, Clone, Copy)]
struct Used([f64; 3]);

/// Differences of the velocity over a tick, and of those.
struct Steps<const N: usize> {
    before: Option<(SVector<f64, N>, SVector<f64, N>)>,
    used: Used,
}

impl<const N: usize> Steps<N> {
    fn new() -> Self {
        Self { before: None, used: Used::default() }
    }

    fn note(&mut self, qd: SVector<f64, N>, limits: &MotionLimits<N>) {
        let (last, a_last) = self.before.unwrap_or((qd, SVector::zeros()));
        let a = (qd - last) / DT_S;
        let j = (a - a_last) / DT_S;
        for i in 0..N {
            let shares = [qd[i] / limits.velocity[i], a[i] / limits.acceleration[i], j[i] / limits.jerk[i]];
            for (used, share) in self.used.0.iter_mut().zip(shares) {
                *used = used.max(share.abs());
            }
        }
        self.before = Some((qd, a));
    }
}

/// A request that a client may make, whatever sense it makes.
fn drawn<const N: usize>(
    random: &mut Random,
    config: &Config,
    q: &SVector<f64, N>,
) -> (Request, ControlCommand) {
    let numbers = |request: Request, form, numbers: &[f64]| {
        (request, ControlCommand::with_numbers(request as u32, form, numbers).unwrap())
    };
    let plain = |request: Request| (request, ControlCommand::of(request as u32));
    match random.between(0.0, 10.0) as u32 {
        0..3 => {
            let X_DO = config.set_point.X_DO().unwrap();
            let p = X_DO.translation.vector.map(|x| x + random.between(-0.06, 0.06));
            // An arm of four joints turns its camera about the axis of that alone.
            let tilt = if N < 6 { 0.0 } else { 0.2 };
            let turned = nalgebra::UnitQuaternion::from_scaled_axis(nalgebra::Vector3::new(
                random.between(-tilt, tilt),
                random.between(-tilt, tilt),
                random.between(-0.2, 0.2),
            ));
            let r = (turned * X_DO.rotation).coords;
            numbers(Request::Goal, CommandForm::Pose, &[p.x, p.y, p.z, r.x, r.y, r.z, r.w])
        }
        3 => {
            let there: Vec<_> = q.iter().map(|q| q + random.between(-0.3, 0.3)).collect();
            numbers(Request::Goto, CommandForm::Joints, &there)
        }
        4 => {
            let by: Vec<_> = (0..N).map(|_| random.between(-0.15, 0.15)).collect();
            numbers(Request::Jog, CommandForm::Joints, &by)
        }
        5 => {
            let by: Vec<_> = (0..6).map(|_| random.between(-0.02, 0.02)).collect();
            numbers(Request::Jog, CommandForm::CameraMotion, &by)
        }
        6 => numbers(Request::Set, CommandForm::Gain, &[random.between(0.5, 8.0)]),
        7 => plain(Request::Hold),
        _ => plain(Request::Start),
    }
}

/// Runs one draw; what reference and arm used of their limits, and how many requests were accepted.
fn run<const N: usize>(file: &str, seed: u64) -> (Used, Used, usize) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let set = ["run.clock=lockstep".to_owned(), "run.serve=true".to_owned()];
    let config = Config::load(Some(&path), &set).unwrap();
    let robot: Robot<N> = config.robot.build().unwrap();
    let limits = assemble::motion_limits(&config, &robot).unwrap();
    let mut run = assemble::control_loop::<N>(&config, robot.clone()).unwrap();
    let mut random = Random::new(seed);
    let (mut reference, mut arm) = (Steps::new(), Steps::new());
    let (mut accepted, mut number, mut next) = (0, 0, 1);
    let mut goal = run.mission.goal().id;
    let mut k = 0;
    loop {
        let now = MonoNs(k as i64 * 1_000_000);
        let state = run.sense(k, now);
        let q = SVector::<f64, N>::from_fn(|i, _| state.q[i]);
        if k < RANDOM_TICKS && k == next {
            number += 1;
            next += 1 + random.between(0.0, 400.0) as u64;
            let (request, command) = drawn(&mut random, &config, &q);
            accepted += usize::from(run.ask(number, request, &command).is_ok());
            let id = run.mission.goal().id;
            goal = goal.max(id);
        } else if k >= RANDOM_TICKS && k % 500 == 0 {
            // From whatever state: to the last goal.
            number += 1;
            let _ = run.ask(number, Request::Start, &ControlCommand::of(Request::Start as u32));
        }
        let m = (k % 40 == 0).then(|| seen(&config, &robot, &q, k)).flatten();
        let trace = run.act(now, m.as_ref());
        assert_eq!(trace.fault, None, "{file} {seed} at {k}");
        reference.note(SVector::from_fn(|i, _| trace.command.qd_r[i]), &limits);
        arm.note(SVector::from_fn(|i, _| state.qd_true[i]), &limits);
        k += 1;
        if k > RANDOM_TICKS && run.mission.at_goal_s() > 0.0 {
            break;
        }
        assert!(
            k < RANDOM_TICKS + 20_000,
            "{file} {seed}: {:?} {}",
            trace.state,
            run.mission.feature_error_px()
        );
    }
    assert_eq!(run.state(), ControlState::Servoing);
    assert_eq!(run.mission.goal().id, goal);
    (reference.used, arm.used, accepted)
}

#[test]
fn goals_at_random_times_never_make_the_arm_step() {
    let worst = |runs: &[(Used, Used, usize)], which: fn(&(Used, Used, usize)) -> Used| {
        let max = |i: usize| runs.iter().map(|run| which(run).0[i]).fold(0.0, f64::max);
        [max(0), max(1), max(2)]
    };
    let mut runs = Vec::new();
    for seed in 1..=4 {
        runs.push(run::<6>("ur5.toml", seed));
        runs.push(run::<6>("ur5-b.toml", seed));
        runs.push(run::<4>("scara-hybrid.toml", seed));
    }
    let (reference, arm) = (worst(&runs, |run| run.0), worst(&runs, |run| run.1));
    let accepted: usize = runs.iter().map(|run| run.2).sum();
    println!("{accepted} requests accepted; shares of limits: reference {reference:.4?}, arm {arm:.4?}");
    assert!(accepted > 300, "{accepted}");
    assert!(reference.iter().all(|share| *share <= 1.0 + 1e-6), "{reference:?}");
    assert!(reference[2] > 0.9, "the limits were used: {reference:?}");
    // The simulated arm has friction, and leaves its reference for moments: measured 1.00, 1.75 and 2.57 of its limits. Bounds against a step, which
    // would be some hundred times as much.
    assert!(arm[0] <= 1.02 && arm[1] <= 2.0 && arm[2] <= 3.0, "{arm:?}");
}
