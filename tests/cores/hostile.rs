//! A hostile drive and hostile measurements: whatever they report, no command passes a limit, none is no number, and every run
//! ends with a reason.
//!
//! `VSERVO_CAMPAIGN=10000 cargo test --release --test cores hostile` runs so many seeds of each; without it some.

#![allow(non_snake_case, clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::plant::{MS, Plant, Report, config, run};
use nalgebra::SVector;
use vservo::config::{Config, assemble};
use vservo::control::lifecycle::Request;
use vservo::control::outcome::Outcome;
use vservo::control::safety::Fault;
use vservo::drive::{CommandMode, DriveCommand, DriveState};
use vservo::geometry::Pose;
use vservo::linalg::Random;
use vservo::messages::{FeaturePoint, MAX_FEATURES, Measurement};
use vservo::mission::LockstepRun;
use vservo::robot::Robot;
use vservo::sim::perfect_measurement;
use vservo::time::MonoNs;

const FILES: [&str; 8] = [
    "default.toml",
    "scara-a.toml",
    "scara-b.toml",
    "scara-c.toml",
    "ur5.toml",
    "ur5-hybrid.toml",
    "panda.toml",
    "pan_tilt.toml",
];
const MODES: [&str; 3] = ["torque", "velocity", "position"];

fn seeds() -> u64 {
    std::env::var("VSERVO_CAMPAIGN").ok().and_then(|n| n.parse().ok()).unwrap_or(160)
}

/// A number of any bits, or one that is only a little wrong.
fn any(random: &mut Random) -> f64 {
    match random.bits() % 8 {
        0 => f64::NAN,
        1 => f64::INFINITY,
        2 => -1e200,
        3 => 1e6,
        4 | 5 => f64::from_bits(random.bits()),
        _ => random.between(-10.0, 10.0),
    }
}

/// A drive that from some tick on, for ever or for a while, reports something else than the truth.
fn mischief<const N: usize>(seed: u64) -> Report<N> {
    let mut random = Random::new(seed);
    let kind = random.bits() % 9;
    let from = (random.bits() % 1200) as i64;
    let until =
        if random.bits().is_multiple_of(2) { i64::MAX } else { from + 1 + (random.bits() % 300) as i64 };
    let joint = (random.bits() % N as u64) as usize;
    let size = 10_f64.powf(random.between(-4.0, 1.0));
    let mut frozen: Option<DriveState<N>> = None;
    let mut queue = std::collections::VecDeque::new();
    Box::new(move |tick, mut state| {
        queue.push_back(state);
        let before = if queue.len() > 40 { queue.pop_front() } else { None };
        if tick < from || tick >= until {
            return state;
        }
        match kind {
            0 => state.q[joint] = any(&mut random),
            1 => state.qd[joint] = any(&mut random),
            2 => {
                state.q = SVector::from_fn(|_, _| any(&mut random));
                state.qd = SVector::from_fn(|_, _| any(&mut random));
            }
            3 => state = *frozen.get_or_insert(state),
            4 => state = before.unwrap_or(state),
            5 => state.q[joint] += size,
            6 => state.q = SVector::from_fn(|i, _| state.q[i] + size.min(1e-3) * random.gaussian()),
            7 => (state.q, state.qd) = (-state.q, -state.qd),
            _ => state.qd[joint] = size * if tick % 2 == 0 { 10.0 } else { -10.0 },
        }
        state
    })
}

/// Checks every command against the limits, by itself: differences of what came out of the gate, whatever the drive obeys. The arm
/// started within its range.
fn judge<const N: usize>(what: &str, commands: &[DriveCommand<N>], config: &Config, robot: &Robot<N>) {
    let (a_max, j_max) = (&config.motion.max_acceleration, &config.motion.max_jerk);
    let places_positions = config.drive.mode != CommandMode::Velocity;
    let mut a_before = SVector::<f64, N>::zeros();
    for (k, c) in commands.iter().enumerate() {
        for (i, limit) in robot.limits().iter().enumerate() {
            let at = || format!("{what}, tick {k}, joint {i}: {c:?}");
            assert!(c.tau[i].abs() <= limit.effort, "{}", at());
            assert!(c.q_r[i] >= limit.lower - 1e-5 && c.q_r[i] <= limit.upper + 1e-5, "{}", at());
            assert!(c.qd_r[i].abs() <= limit.velocity * (1.0 + 1e-5), "{}", at());
            let Some(before) = k.checked_sub(1).and_then(|k| commands.get(k)) else { continue };
            // From nothing to all in 10 ms, motion.effort_rise_ms: a tenth in a tick.
            let rise = (c.tau[i] - before.tau[i]).abs();
            assert!(rise <= 0.1 * limit.effort * (1.0 + 1e-9), "{}: {rise}", at());
            let a = (c.qd_r[i] - before.qd_r[i]) / 1e-3;
            assert!(a.abs() <= a_max[i] * (1.0 + 1e-4), "{} {a}", at());
            // Of means over a tick in which the acceleration changes evenly.
            let jerk = (a - a_before[i]) / 1e-3;
            assert!(jerk.abs() <= 1.51 * j_max[i], "{} {jerk}", at());
            a_before[i] = a;
            if places_positions {
                let way = c.q_r[i] - before.q_r[i] - 0.5e-3 * (c.qd_r[i] + before.qd_r[i]);
                assert!(way.abs() < 1e-6, "{}: {way} beside the velocity", at());
            }
        }
    }
}

fn one<const N: usize>(config: &Config, robot: &Robot<N>, what: &str, seed: u64, see: bool) {
    let mut plant = Plant::new(config, robot, SVector::zeros());
    if !see {
        plant.report = mischief(seed);
    }
    let mut random = Random::new(seed ^ 0x5eed);
    let mut last = None;
    let over = run(config, robot, plant, 12_000, &mut |k, m| {
        if see { tampered(&mut random, &mut last, k, m) } else { m }
    });
    let commands: Vec<_> = over.ticks.iter().map(|tick| tick.command).collect();
    judge(what, &commands, config, robot);
    let finish = over.finish.unwrap_or_else(|| panic!("{what}: does not end, {:?}", over.events));
    assert!(!finish.reason.is_empty());
    if !see && finish.outcome != Outcome::Fault {
        // What was not told did no harm; a velocity that is wrong at every other tick makes an arm tremble.
        let last = over.ticks.last().unwrap().qd.amax();
        assert!(last < 0.2, "{what}: {last} {finish:?}");
    }
}

/// A measurement that is not what a camera saw.
fn tampered(
    random: &mut Random,
    last: &mut Option<Measurement>,
    k: i64,
    m: Option<Measurement>,
) -> Option<Measurement> {
    let mut m = m?;
    match random.bits() % 14 {
        0 => m.features[(random.bits() % 4) as usize].x = any(random),
        1 => {
            for f in &mut m.features {
                *f = FeaturePoint { id: random.bits() % 8, x: any(random), y: any(random), ..*f };
            }
        }
        2 => m.feature_count = random.bits() as u32,
        3 => m.feature_count = (random.bits() % (2 * MAX_FEATURES as u64)) as u32,
        4 => m.status = random.bits() as u32,
        5 => m.flags = random.bits() as u32,
        6 => m.exposure = MonoNs(random.bits() as i64),
        7 => m.exposure = MonoNs([i64::MIN, i64::MAX, 0, k * MS + 1][(random.bits() % 4) as usize]),
        8 => m.pose = std::array::from_fn(|_| any(random)),
        9 => m.pose[(random.bits() % 7) as usize] = any(random),
        10 => m.pose_covariance = std::array::from_fn(|_| any(random)),
        11 => return None,
        12 => return *last,
        _ => {}
    }
    *last = Some(m);
    Some(m)
}

fn campaign(see: bool) {
    for seed in 0..seeds() {
        let file = FILES[(seed % FILES.len() as u64) as usize];
        let mode = MODES[(seed / FILES.len() as u64 % 3) as usize];
        // Laws that output torques need a drive that obeys them.
        let mode = if file == "scara-a.toml" || file == "scara-c.toml" { "torque" } else { mode };
        let mut set = vec![format!("drive.mode={mode}"), "run.duration_s=4.0".into()];
        if mode != "torque" {
            set.push("motion.controller=pass_through".into());
        }
        let set: Vec<_> = set.iter().map(String::as_str).collect();
        let config = config(file, &set);
        let what = format!("{file} {mode} seed {seed}");
        vservo::dispatch_robot!(config.robot, |robot| one(&config, &robot, &what, seed, see)).unwrap();
    }
}

/// A served run: a camera at 500 Hz before a target that swings and leaps, views that are lost and come back while the arm brakes,
/// requests at random moments, faults that are reset, and sometimes a hostile drive or a joint that
/// jams. Every command of it.
fn turmoil<const N: usize>(config: &Config, robot: &Robot<N>, seed: u64) -> Vec<DriveCommand<N>> {
    let mut random = Random::new(seed);
    let mut plant = Plant::new(config, robot, SVector::zeros());
    match random.bits() % 4 {
        0 => plant.report = mischief(seed),
        1 => {
            let (joint, from) = ((random.bits() % N as u64) as usize, (random.bits() % 2000) as i64);
            let stuck = SVector::from_fn(|i, _| if i == joint { 1e5 } else { 0.0 });
            plant.jam = Box::new(move |tick| match tick - from {
                0 => Some(stuck),
                900 => Some(SVector::zeros()),
                _ => None,
            });
        }
        _ => {}
    }
    let wild_views = random.bits().is_multiple_of(2);
    let log = plant.log();
    let mut control: LockstepRun<N> =
        assemble::control_loop_with(config, robot.clone(), Box::new(plant)).unwrap();
    let points_O: Vec<_> = config.target.points().iter().map(|point| point.p_O).collect();
    let (mut last, mut on_its_way) = (None, None);
    let (mut lost_until, mut offset) = (0, SVector::<f64, 3>::zeros());
    let swing = random.between(1.0, 12.0);
    for k in 0..5000_i64 {
        control.sense(k as u64, MonoNs(k * MS));
        if random.bits().is_multiple_of(400) {
            lost_until = k + (random.bits() % 400) as i64;
            offset = SVector::from_fn(|_, _| random.between(-0.06, 0.06));
        }
        let request = match random.bits() % 1500 {
            0 => Some(Request::Hold),
            1 => Some(Request::Stop),
            2..8 => Some(Request::Start),
            8..14 => Some(Request::Reset),
            14 => {
                control.fail(Fault::DeadlinesMissed);
                None
            }
            _ => None,
        };
        if let Some(request) = request.or((k == 0).then_some(Request::Start)) {
            let _ = control.request(request); // refused or not
        }
        let m = on_its_way.take();
        if k % 2 == 0 {
            let q = log.lock().unwrap().last().map(|tick| tick.q);
            let q = q.unwrap_or_else(|| assemble::q_start::<N>(config).unwrap());
            let X_CW = config.camera.mount.X_WC(robot, &q).inverse();
            let p = offset * (swing * k as f64 * 1e-3).sin();
            let X_CO = X_CW * Pose::translation(p.x, p.y, p.z) * config.X_WO().unwrap();
            on_its_way = perfect_measurement(&points_O, &X_CO, MonoNs(k * MS)).filter(|_| k >= lost_until);
            if wild_views && random.bits().is_multiple_of(20) {
                on_its_way = tampered(&mut random, &mut last, k, on_its_way);
            }
        }
        if control.act(MonoNs(k * MS), m.as_ref()).finish.is_some() {
            break;
        }
    }
    let ticks = log.lock().unwrap();
    ticks.iter().map(|tick| tick.command).collect()
}

/// Nothing steps the reference: not a view that comes back while the arm brakes, no fault, no request, no law that outputs torques.
#[test]
fn no_sequence_of_inputs_makes_the_gate_output_jump() {
    for seed in 0..seeds() {
        let file = FILES[(seed % FILES.len() as u64) as usize];
        // More than half of them where the reference could be put elsewhere: before a drive that obeys torques.
        let mode =
            ["torque", "velocity", "torque", "position", "torque"][(seed / FILES.len() as u64 % 5) as usize];
        let pushes = file == "scara-a.toml" || file == "scara-c.toml";
        let mode = if pushes { "torque" } else { mode };
        let mut set = vec![format!("drive.mode={mode}"), "run.serve=true".into()];
        if mode != "torque" {
            set.push("motion.controller=pass_through".into());
        }
        if !pushes && seed.is_multiple_of(3) {
            set.push("servo.object.moves=true".into());
        }
        let set: Vec<_> = set.iter().map(String::as_str).collect();
        let config = config(file, &set);
        let what = format!("{file} {mode} seed {seed}");
        vservo::dispatch_robot!(config.robot, |robot| {
            judge(&what, &turmoil(&config, &robot, seed), &config, &robot);
        })
        .unwrap();
    }
}

#[test]
fn a_hostile_drive_gets_commands_within_limits_only() {
    campaign(false);
}

#[test]
fn hostile_measurements_give_commands_within_limits_only() {
    campaign(true);
}
