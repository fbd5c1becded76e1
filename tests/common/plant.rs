//! A control loop before a simulated arm that may misbehave, in this process: what was commanded, and what the arm did.

#![allow(dead_code, unreachable_pub, non_snake_case)] // each test binary uses a part
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use nalgebra::SVector;
use std::path::Path;
use std::sync::{Arc, Mutex};
use vservo::config::{Config, assemble};
use vservo::control::outcome::Finish;
use vservo::control::trace::Event;
use vservo::drive::{CommandMode, Drive, DriveCommand, DriveState, SimulatedDrive};
use vservo::messages::Measurement;
use vservo::mission::LockstepRun;
use vservo::robot::Robot;
use vservo::sim::perfect_measurement;
use vservo::time::MonoNs;

pub const MS: i64 = 1_000_000;

pub fn config(file: &str, set: &[&str]) -> Config {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    // What goes wrong at a given tick shall meet an arm at speed.
    let set: Vec<_> = [&["servo.first_motion_m_s=0"], set].concat().iter().map(ToString::to_string).collect();
    Config::load(Some(&path), &set).unwrap_or_else(|e| panic!("{file}: {e}"))
}

/// What a misbehaving drive makes of the arm's true state at a tick, before it reports it.
pub type Report<const N: usize> = Box<dyn FnMut(i64, DriveState<N>) -> DriveState<N> + Send>;
/// The friction of the arm at a tick, where it changes: torque or force beside that of the robot file, of each joint.
pub type Jam<const N: usize> = Box<dyn FnMut(i64) -> Option<SVector<f64, N>> + Send>;

/// A simulated arm whose joints may jam, and whose reports may be wrong.
pub struct Plant<const N: usize> {
    pub arm: SimulatedDrive<N>,
    robot: Robot<N>,
    config: Config,
    pub report: Report<N>,
    pub jam: Jam<N>,
    tick: i64,
    log: Arc<Mutex<Vec<Tick<N>>>>,
}

/// A tick at the plant.
#[derive(Debug, Clone, Copy)]
pub struct Tick<const N: usize> {
    /// Where the arm was when the command came.
    pub q: SVector<f64, N>,
    pub qd: SVector<f64, N>,
    pub command: DriveCommand<N>,
}

impl<const N: usize> Plant<N> {
    /// The arm of a run file, which starts by `offset` (rad or m) away from where that says.
    pub fn new(config: &Config, robot: &Robot<N>, offset: SVector<f64, N>) -> Self {
        let q = assemble::q_start::<N>(config).unwrap() + offset;
        let settings = assemble::simulated_settings(config).unwrap();
        Self {
            arm: SimulatedDrive::new(robot.clone(), q, settings).unwrap(),
            robot: robot.clone(),
            config: config.clone(),
            report: Box::new(|_, state| state),
            jam: Box::new(|_| None),
            tick: -1,
            log: Arc::default(),
        }
    }

    /// What will be noted at every tick.
    pub fn log(&self) -> Arc<Mutex<Vec<Tick<N>>>> {
        self.log.clone()
    }
}

impl<const N: usize> Drive<N> for Plant<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        self.tick += 1;
        let mut state = self.arm.read(now);
        if let Some(coulomb) = (self.jam)(self.tick) {
            let mut friction = *self.robot.friction();
            friction.iter_mut().zip(coulomb.iter()).for_each(|(f, jam)| f.coulomb += jam);
            let mut settings = assemble::simulated_settings::<N>(&self.config).unwrap();
            settings.arm = Some(self.robot.clone().with_friction(friction));
            let (q, mut qd) = state.truth.unwrap();
            (0..N).filter(|i| coulomb[*i] > 0.0).for_each(|i| qd[i] = 0.0);
            self.arm = SimulatedDrive::new(self.robot.clone(), q, settings).unwrap().with_velocity(qd);
            state = self.arm.read(now);
        }
        (self.report)(self.tick, state)
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        self.arm.write(command);
        let (q, qd) = self.arm.read(MonoNs(self.tick * MS)).truth.unwrap();
        self.log.lock().unwrap().push(Tick { q, qd, command: *command });
    }

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }
}

/// A run that is over.
pub struct Over<const N: usize> {
    pub finish: Option<Finish>,
    pub events: Vec<(i64, Event)>,
    pub ticks: Vec<Tick<N>>,
}

/// Runs `config` with `plant` for at most `ticks`, before a perfect camera whose measurements may be tampered with.
pub fn run<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    plant: Plant<N>,
    ticks: i64,
    see: &mut dyn FnMut(i64, Option<Measurement>) -> Option<Measurement>,
) -> Over<N> {
    let log = plant.log.clone();
    let mut control: LockstepRun<N> =
        assemble::control_loop_with(config, robot.clone(), Box::new(plant)).unwrap();
    let points_O: Vec<_> = config.target.points().iter().map(|point| point.p_O).collect();
    let mut on_its_way = None;
    let mut over = Over { finish: None, events: Vec::new(), ticks: Vec::new() };
    for k in 0..ticks {
        control.sense(k as u64, MonoNs(k * MS));
        let truth = log.lock().unwrap().last().map(|tick: &Tick<N>| tick.q);
        if k % 40 == 0 {
            let q = truth.unwrap_or_else(|| assemble::q_start::<N>(config).unwrap());
            let X_CO = config.camera.mount.X_WC(robot, &q).inv_mul(&config.X_WO().unwrap());
            on_its_way = see(k, perfect_measurement(&points_O, &X_CO, MonoNs(k * MS)));
        }
        let m = if k % 40 == 20 { on_its_way.take() } else { None };
        let trace = control.act(MonoNs(k * MS), m.as_ref());
        over.events.extend(trace.events.iter().map(|event| (k, event)));
        if trace.finish.is_some() {
            over.finish = trace.finish;
            break;
        }
    }
    over.ticks = std::mem::take(&mut *log.lock().unwrap());
    over
}

impl<const N: usize> Over<N> {
    /// Largest share of a limit that the plant's mean acceleration in a tick, and its change, were: whichever joint.
    pub fn shares(&self, acceleration: &[f64], jerk: &[f64]) -> [f64; 2] {
        let speeds: Vec<_> = self.ticks.iter().map(|tick| tick.qd).collect();
        let mut shares = [0.0_f64; 2];
        for i in 0..N {
            for w in speeds.windows(3) {
                let (before, after) = ((w[1][i] - w[0][i]) / 1e-3, (w[2][i] - w[1][i]) / 1e-3);
                shares[0] = shares[0].max(after.abs() / acceleration[i]);
                shares[1] = shares[1].max((after - before).abs() / 1e-3 / jerk[i]);
            }
        }
        shares
    }
}
