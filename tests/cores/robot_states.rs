//! A robot that stops by itself in front of the control loop: the fault is told as the robot's, in the tick in which it is; the reference goes to the arm; and the
//! fault is left when somebody has asked for it and the robot obeys again, by no other way.

#![allow(clippy::unwrap_used, clippy::panic, non_snake_case)]

use crate::plant::{MS, config};
use nalgebra::SVector;
use std::sync::{Arc, Mutex};
use vservo::config::{Config, assemble};
use vservo::control::lifecycle::{Refusal, Request};
use vservo::control::safety::Fault;
use vservo::control::trace::{Event, Trace};
use vservo::drive::{CommandMode, Drive, DriveCommand, DriveHealth, DriveState, RobotReport, SimulatedDrive};
use vservo::messages::{CommandForm, ControlCommand, ControlState, RobotState};
use vservo::mission::LockstepRun;
use vservo::sim::perfect_measurement;
use vservo::time::MonoNs;

/// What a test says of the robot, and what the robot has heard.
struct Wire {
    state: RobotState,
    is_asked: bool,
    was_reset: u32,
}

/// An arm whose robot closes its brakes while it obeys no commands.
struct Stoppable<const N: usize> {
    arm: SimulatedDrive<N>,
    make: Box<dyn Fn(SVector<f64, N>) -> SimulatedDrive<N> + Send>,
    wire: Arc<Mutex<Wire>>,
    held: Option<SVector<f64, N>>,
}

impl<const N: usize> Drive<N> for Stoppable<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        let state = self.arm.read(now);
        if self.wire.lock().unwrap().state.obeys() {
            if let Some(q) = self.held.take() {
                self.arm = (self.make)(q);
            }
            return self.arm.read(now);
        }
        let q = *self.held.get_or_insert(state.q);
        DriveState { q, qd: SVector::zeros(), truth: None }
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        self.arm.write(command);
    }

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }

    fn health(&self) -> DriveHealth {
        let state = self.wire.lock().unwrap().state;
        DriveHealth { robot: RobotReport { state, code: 7 }, ..DriveHealth::default() }
    }

    fn reset(&mut self) {
        self.wire.lock().unwrap().was_reset += 1;
    }

    fn clear_robot(&mut self, asked: bool) {
        self.wire.lock().unwrap().is_asked = asked;
    }
}

struct Cell {
    run: LockstepRun<6>,
    config: Config,
    wire: Arc<Mutex<Wire>>,
    tick: i64,
}

impl Cell {
    fn new(mode: &str) -> Self {
        Self::with(mode, &[])
    }

    fn with(mode: &str, set: &[&str]) -> Self {
        let mode = format!("drive.mode={mode}");
        let config = config("ur5.toml", &[&["run.serve=true", mode.as_str()], set].concat());
        let robot = config.robot.build::<6>().unwrap();
        let settings = assemble::simulated_settings::<6>(&config).unwrap();
        let own = robot.clone();
        let make = move |q| SimulatedDrive::new(own.clone(), q, settings.clone()).unwrap();
        let wire = Arc::new(Mutex::new(Wire { state: RobotState::Ready, is_asked: false, was_reset: 0 }));
        let q = assemble::q_start::<6>(&config).unwrap();
        let drive = Stoppable { arm: make(q), make: Box::new(make), wire: wire.clone(), held: None };
        let run = assemble::control_loop_with(&config, robot, Box::new(drive)).unwrap();
        Self { run, config, wire, tick: 0 }
    }

    fn says(&self, state: RobotState) {
        self.wire.lock().unwrap().state = state;
    }

    fn is_asked(&self) -> bool {
        self.wire.lock().unwrap().is_asked
    }

    fn tick(&mut self) -> Trace {
        let now = MonoNs(self.tick * MS);
        let js = self.run.sense(self.tick as u64, now);
        let measurement = (self.tick % 40 == 0).then(|| {
            let robot = self.config.robot.build::<6>().unwrap();
            let q = SVector::<f64, 6>::from_column_slice(&js.q[..6]);
            let X_CO = self.config.camera.mount.X_WC(&robot, &q).inv_mul(&self.config.X_WO().unwrap());
            let points: Vec<_> = self.config.target.points().iter().map(|point| point.p_O).collect();
            perfect_measurement(&points, &X_CO, now)
        });
        self.tick += 1;
        self.run.act(now, measurement.flatten().as_ref())
    }

    fn ticks(&mut self, count: i64) -> Trace {
        for _ in 1..count {
            self.tick();
        }
        self.tick()
    }

    /// Until the state is this one.
    fn until(&mut self, state: ControlState) -> Trace {
        for _ in 0..5000 {
            let trace = self.tick();
            if trace.state == state {
                return trace;
            }
        }
        panic!("never {state:?}");
    }

    /// In motion, and then stopped by the robot; the trace of that tick.
    fn stopped(&mut self, state: RobotState) -> Trace {
        self.until(ControlState::Idle);
        self.run.request(Request::Start).unwrap();
        self.ticks(500);
        let fast = self.tick().joint_state.qd.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        assert!(fast > 0.1, "{fast}");
        self.says(state);
        self.tick()
    }
}

#[test]
fn each_stop_of_a_robot_is_its_own_fault_in_its_tick() {
    for mode in ["torque", "velocity", "position"] {
        for (state, fault) in [
            (RobotState::ProtectiveStop, Fault::RobotProtectiveStop),
            (RobotState::EmergencyStop, Fault::RobotEmergencyStop),
            (RobotState::Off, Fault::RobotOff),
            (RobotState::Braked, Fault::RobotOff),
            (RobotState::Fault, Fault::RobotError),
            (RobotState::Halted, Fault::RobotHalted),
        ] {
            let mut cell = Cell::new(mode);
            let trace = cell.stopped(state);
            assert_eq!((trace.state, trace.fault), (ControlState::Fault, Some(fault)), "{mode}");
            assert!(trace.events.iter().any(|event| event == Event::Fault(fault)), "{mode}");
            assert_eq!(cell.run.request(Request::Start), Err(Refusal::InFault));
            let trace = cell.ticks(3000);
            assert_eq!(
                (trace.state, trace.fault),
                (ControlState::Fault, Some(fault)),
                "{mode}: and stays it"
            );
            let js = trace.joint_state;
            for i in 0..6 {
                let (off, speed) = ((js.q_r[i] - js.q[i]).abs(), js.qd_r[i].abs());
                assert!(off < 2e-3 && speed < 1e-3, "{mode} {state:?}: {off} rad and {speed} rad/s");
            }
            assert!(!cell.is_asked(), "nobody has asked it to clear anything");
        }
    }
}

#[test]
fn a_reset_waits_for_the_robot_and_moves_nothing() {
    for mode in ["torque", "velocity", "position"] {
        let mut cell = Cell::new(mode);
        cell.stopped(RobotState::ProtectiveStop);
        cell.ticks(2000);
        cell.run.request(Request::Reset).unwrap();
        let trace = cell.ticks(8000);
        assert_eq!((trace.state, trace.clears, cell.is_asked()), (ControlState::Fault, true, true), "{mode}");
        assert_eq!(cell.run.request(Request::Start), Err(Refusal::InFault));
        cell.says(RobotState::Ready);
        let trace = cell.tick();
        assert_eq!((trace.state, trace.fault, trace.clears), (ControlState::Idle, None, false), "{mode}");
        assert!(trace.events.iter().any(|event| event == Event::RobotReady));
        assert!(!cell.is_asked());
        let q = trace.joint_state.q;
        let trace = cell.ticks(1000);
        assert_eq!(trace.state, ControlState::Idle);
        for (now, then) in trace.joint_state.q.iter().zip(&q) {
            // Under torques it gives way by some milliradians when its brakes open.
            assert!((now - then).abs() < 1e-2, "{mode}: {now} {then}");
        }
        assert!(cell.wire.lock().unwrap().was_reset > 0, "{mode}: the fault of its states is forgotten too");
        cell.run.request(Request::Start).unwrap();
        cell.until(ControlState::Servoing);
        let trace = cell.ticks(6000);
        assert_eq!((trace.state, trace.fault), (ControlState::Servoing, None), "{mode}");
        assert!(cell.run.mission.feature_error_px() < 0.1, "{mode}: it is at its goal");
    }
}

#[test]
fn what_must_be_done_at_the_robot_is_refused_and_then_not() {
    for (state, refusal) in [
        (RobotState::EmergencyStop, Refusal::RobotEmergencyStop),
        (RobotState::Off, Refusal::RobotOff),
        (RobotState::Braked, Refusal::RobotOff),
        (RobotState::Enabling, Refusal::RobotOff),
        (RobotState::Fault, Refusal::RobotFault),
    ] {
        let mut cell = Cell::new("position");
        cell.stopped(state);
        assert_eq!(cell.run.request(Request::Reset), Err(Refusal::StillMoving), "the arm has yet to rest");
        cell.ticks(2000);
        assert_eq!(cell.run.request(Request::Reset), Err(refusal));
        assert!(!cell.tick().clears && !cell.is_asked());
        // Somebody has seen to it, and what obeys commands there has to start again.
        cell.says(RobotState::Halted);
        cell.tick();
        cell.run.request(Request::Reset).unwrap();
        assert!(cell.tick().clears && cell.is_asked());
        cell.says(RobotState::Ready);
        assert_eq!(cell.tick().state, ControlState::Idle);
    }
}

/// A robot that is ready by itself leaves no fault: whoever is responsible says so.
#[test]
fn a_fault_stays_although_the_robot_is_ready_again() {
    let mut cell = Cell::new("position");
    cell.stopped(RobotState::ProtectiveStop);
    cell.ticks(2000);
    cell.says(RobotState::Ready);
    let trace = cell.ticks(1000);
    assert_eq!((trace.state, trace.fault), (ControlState::Fault, Some(Fault::RobotProtectiveStop)));
    cell.run.request(Request::Reset).unwrap();
    assert_eq!(cell.tick().state, ControlState::Idle, "there is nothing to wait for");
    assert!(!cell.is_asked());
}

#[test]
fn a_wait_for_the_robot_ends_by_time_stop_and_faults() {
    let begun = || {
        let mut cell = Cell::new("position");
        cell.stopped(RobotState::ProtectiveStop);
        cell.ticks(2000);
        cell.run.request(Request::Reset).unwrap();
        assert!(cell.tick().clears);
        cell
    };
    let assert_over = |mut cell: Cell, how: &str| {
        let trace = cell.tick();
        assert_eq!((trace.state, trace.clears), (ControlState::Fault, false), "{how}");
        assert_eq!(trace.fault, Some(Fault::RobotProtectiveStop), "{how}: the first one is kept");
        cell.tick();
        assert!(!cell.is_asked(), "{how}");
        // Ready after all: too late for that wish.
        cell.says(RobotState::Ready);
        assert_eq!(cell.ticks(10).state, ControlState::Fault, "{how}");
        cell.run.request(Request::Reset).unwrap();
        assert_eq!(cell.tick().state, ControlState::Idle, "{how}");
    };
    let mut cell = begun();
    assert!(cell.ticks(14_900).clears);
    cell.ticks(200);
    assert_over(cell, "time");
    let mut cell = begun();
    cell.run.request(Request::Stop).unwrap();
    assert_over(cell, "stop");
    let mut cell = begun();
    cell.run.fail(Fault::StopLatched);
    assert_over(cell, "a latched stop");
    let cell = begun();
    cell.says(RobotState::EmergencyStop);
    assert_over(cell, "an emergency stop");
    // Latched in the very tick in which the robot is ready: the stop comes first.
    let mut cell = begun();
    cell.run.fail(Fault::StopLatched);
    cell.says(RobotState::Ready);
    assert_over(cell, "a latched stop and a ready robot");
}

/// In reduced mode the arm moves with the share of its velocity limits that the run file says, to which it comes within the half second that safety systems wait, and within its other limits; servoing, and on its way to a posture.
#[test]
fn an_arm_in_reduced_mode_is_slow_within_half_a_second() {
    let share = 0.05;
    for mode in ["torque", "velocity", "position"] {
        let mut cell = Cell::with(mode, &["safety.reduced_speed_share=0.05"]);
        let robot = cell.config.robot.build::<6>().unwrap();
        let limits = assemble::motion_limits::<6>(&cell.config, &robot).unwrap();
        let most =
            |qd: &[f64]| qd.iter().zip(&limits.velocity).map(|(v, max)| v.abs() / max).fold(0.0, f64::max);
        let mut before: Option<SVector<f64, 6>> = None;
        let mut step = |cell: &mut Cell, ticks: i64, within: f64| {
            let mut fast = 0.0;
            for _ in 0..ticks {
                let trace = cell.tick();
                assert_eq!(trace.fault, None, "{mode}");
                let qd = SVector::<f64, 6>::from_column_slice(&trace.joint_state.qd_r[..6]);
                fast = most(&trace.joint_state.qd[..6]);
                assert!(fast <= within, "{mode}: {fast} of the limit");
                if let Some(before) = before.replace(qd) {
                    let rise = (qd - before) / 1e-3;
                    for i in 0..6 {
                        assert!(rise[i].abs() <= 1.01 * limits.acceleration[i], "{mode}: {}", rise[i]);
                    }
                }
            }
            fast
        };
        cell.until(ControlState::Idle);
        cell.run.request(Request::Start).unwrap();
        let fast = step(&mut cell, 500, 1.0);
        assert!(fast > 2.0 * share, "{mode}: {fast}");
        cell.says(RobotState::Reduced);
        step(&mut cell, 500, 1.0);
        step(&mut cell, 600, 1.05 * share + 2e-3);
        // Somebody lets it be quick again, and it comes to its goal.
        cell.says(RobotState::Moving);
        cell.ticks(6000);
        let mut q_r = SVector::<f64, 6>::from_column_slice(&cell.tick().joint_state.q_r[..6]);
        // To a posture: reduced on the way, on which it does not turn back.
        let goal = q_r + SVector::from([0.8, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let goto =
            ControlCommand::with_numbers(Request::Goto as u32, CommandForm::Joints, goal.as_slice()).unwrap();
        cell.run.ask(1, Request::Goto, &goto).unwrap();
        let (mut reduced, mut fastest) = (false, 0.0_f64);
        for _ in 0..40_000 {
            let trace = cell.tick();
            let now = SVector::<f64, 6>::from_column_slice(&trace.joint_state.q_r[..6]);
            fastest = fastest.max(most(&trace.joint_state.qd[..6]));
            if !reduced && now[0] > goal[0] - 0.5 {
                reduced = true;
                cell.says(RobotState::Reduced);
            }
            assert!(!reduced || now[0] - q_r[0] > -1e-5, "{mode}: turns back by {}", q_r[0] - now[0]);
            q_r = now;
            if trace.state == ControlState::Held {
                break;
            }
        }
        assert!(fastest > 2.0 * share, "{mode}: {fastest}");
        assert!(reduced && (q_r - goal).amax() < 1e-3, "{mode}: {}", (q_r - goal).amax());
    }
}
