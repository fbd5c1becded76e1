//! A drive for tests, in a process of its own: the crate's own simulated arm behind the services. It is the test binary
//! itself, started again by `vservo run` as `drive.external.command`, or by hand.

#![allow(dead_code, unreachable_pub)] // each test binary uses a part
#![allow(clippy::unwrap_used)]

use crate::common::{Instance, Run, run, vservo};
use nalgebra::SVector;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use vservo::config::Config;
use vservo::drive::{CommandMode, Drive, DriveCommand, DriveProperties, SimulatedDrive};
use vservo::ipc::{Instance as Place, QuietSender, Sender, Services, StopWord};
use vservo::messages::{DriveCommandMsg, DriveStateMsg, DriveTextMsg, MAX_JOINTS, RobotState, drive_flag};
use vservo::robot::Robot;
use vservo::rt;
use vservo::time::TICK;
use vservo::time::{MonoNs, SpanNs};

/// The arm of the tests.
const N: usize = 4;

/// How a drive misbehaves, and from which tick on: `VSERVO_TEST_DRIVE=what@tick`.
struct Behaviour {
    what: String,
    tick: u64,
}

/// Time without commands after which the arm is braked, as a drive should.
const BRAKES_AFTER: SpanNs = SpanNs(150_000_000);

struct TestDrive {
    drive: SimulatedDrive<N>,
    states: Sender<DriveStateMsg>,
    texts: QuietSender<DriveTextMsg>,
    behaviour: Behaviour,
    sent: u64,
    /// The last command, and when it came; none while the arm is held by its brakes.
    obeyed: Option<(DriveCommandMsg, MonoNs)>,
    /// Whether the arm is braked because no command came.
    braked: bool,
    /// Where the guardian's stop is written, and the reference of the arm that is braked by it.
    word: Option<StopWord>,
    guarded: Option<DriveCommandMsg>,
    config: Config,
    robot_model: Robot<N>,
    /// What the robot is, and how many commands it still takes to clear its error.
    robot: RobotState,
    clears_in: u32,
}

/// What this maker says of a stop.
pub const MAKERS_WORDS: &str = "C153A0: joint 2 has moved farther than its path says";
/// Commands with CLEAR that it takes to clear an error.
const CLEARS_AFTER: u32 = 300;

fn vector(v: &[f64; MAX_JOINTS]) -> SVector<f64, N> {
    SVector::from_column_slice(&v[..N])
}

impl TestDrive {
    fn new(services: &Services, behaviour: Behaviour, config: &Config) -> Self {
        let (texts, states) = (services.drive_text_sender().unwrap(), services.drive_state_sender().unwrap());
        let robot = config.robot.build::<N>().unwrap();
        let q = vservo::config::assemble::q_start(config).unwrap();
        let settings = vservo::config::assemble::simulated_settings(config).unwrap();
        let drive = SimulatedDrive::new(robot, q, settings).unwrap();
        let config = config.clone();
        Self {
            drive,
            states,
            texts,
            behaviour,
            sent: 0,
            obeyed: None,
            braked: false,
            word: None,
            guarded: None,
            robot_model: config.robot.build().unwrap(),
            config,
            robot: RobotState::Ready,
            clears_in: CLEARS_AFTER,
        }
    }

    /// A robot that stops by itself in its first motion, closes its brakes, and obeys nothing until it has cleared its error, which it does when it is asked to.
    fn is_stopped(&mut self, c: &DriveCommandMsg) -> bool {
        let stops = match self.behaviour.what.as_str() {
            "protective_stop" => RobotState::ProtectiveStop,
            "emergency_stop" => RobotState::EmergencyStop,
            _ => return false,
        };
        let is_asked = c.flags & drive_flag::CLEAR != 0;
        if self.robot.obeys() {
            let moves = self.clears_in > 0 && c.qd_r[..N].iter().any(|v| v.abs() > 0.1);
            if moves && !is_asked {
                let q = self.drive.read(c.stamp).q;
                let robot = self.config.robot.build::<N>().unwrap();
                let settings = vservo::config::assemble::simulated_settings(&self.config).unwrap();
                self.drive = SimulatedDrive::new(robot, q, settings).unwrap();
                (self.robot, self.obeyed) = (stops, None);
                self.say(MAKERS_WORDS);
            }
        } else if is_asked && stops == RobotState::ProtectiveStop {
            self.clears_in -= 1;
            if self.clears_in == 0 {
                self.robot = RobotState::Ready;
            }
        }
        !self.robot.obeys()
    }

    /// With START, before the answer.
    fn tell_names(&self) {
        let mut names: Vec<_> = self.config.robot.joints.iter().map(|joint| joint.name.clone()).collect();
        match self.behaviour.what.as_str() {
            "knows_no_names" => return,
            "swapped_names" => names.swap(0, 1),
            "other_names" => names = names.iter().map(|name| format!("{name}_of_another")).collect(),
            "fewer_names" => drop(names.pop()),
            _ => {}
        }
        let mut text = DriveTextMsg::of_joints(&names);
        if self.behaviour.what == "turned_joint" {
            text.signs[1] = -1.0;
        }
        self.texts.send(|| text).unwrap();
    }

    /// Likewise; `slow_torques@200` takes torques that rise from zero to the largest of each joint within 200 ms.
    fn tell_properties(&self) {
        if self.behaviour.what == "slow_torques" {
            let rise_s = self.behaviour.tick as f64 * 1e-3;
            let efforts = self.config.robot.joints.iter().map(|joint| joint.limits.effort);
            let effort_rate = efforts.map(|effort| effort / rise_s).collect();
            let properties = DriveProperties { effort_rate, ..DriveProperties::default() };
            self.texts.send(|| DriveTextMsg::of_properties(&properties.to_string())).unwrap();
        }
    }

    /// What the maker says of the robot, which begins as it does.
    fn say(&self, words: &str) {
        let code = if self.robot.obeys() { 0 } else { 42 };
        self.texts.send(|| DriveTextMsg::of_robot(self.robot, code, words)).unwrap();
    }

    fn misbehaves(&self, what: &str, tick: u64) -> bool {
        self.behaviour.what == what && tick >= self.behaviour.tick
    }

    /// No drive obeys commands of other joints, or numbers that are none.
    fn refuses(&self, c: &DriveCommandMsg) -> bool {
        let finite = c.q_r.iter().chain(&c.qd_r).chain(&c.tau).all(|v| v.is_finite());
        !self.misbehaves("obeys_all", c.tick) && (c.joints as usize != N || !finite)
    }

    /// In the modes velocity and position an arm without commands stands; torques are left as they are.
    fn brake_in_silence(&mut self) {
        let Some((mut c, at)) = self.obeyed else { return };
        let silent = rt::now() - at > BRAKES_AFTER && c.mode != CommandMode::Torque as u32;
        if silent && !self.braked && !self.misbehaves("goes_on", c.tick) {
            c.q_r[..N].copy_from_slice(self.drive.read(rt::now()).q.as_slice());
            c.qd_r = Default::default();
            self.write(&c);
            self.braked = true;
        }
    }

    /// In each cycle: whether the guardian's stop stands, by which the arm is braked within the limits of acceleration, and then held. Before torques the brakes close.
    fn is_stopped_by_guardian(&mut self) -> bool {
        let stands = self.word.as_ref().is_some_and(StopWord::is_stopped_by_guardian);
        if !stands || self.misbehaves("knows_no_guardian", 0) {
            self.guarded = None;
            return false;
        }
        let Some((last, _)) = self.obeyed else { return true };
        let mut c = self.guarded.unwrap_or(last);
        if c.mode == CommandMode::Torque as u32 {
            if self.guarded.is_none() {
                let robot = self.config.robot.build::<N>().unwrap();
                let settings = vservo::config::assemble::simulated_settings(&self.config).unwrap();
                self.drive = SimulatedDrive::new(robot, self.drive.read(rt::now()).q, settings).unwrap();
            }
        } else {
            for i in 0..N {
                let slower = self.config.motion.max_acceleration[i] * TICK.as_s();
                c.qd_r[i] = c.qd_r[i].signum() * (c.qd_r[i].abs() - slower).max(0.0);
                c.q_r[i] += c.qd_r[i] * TICK.as_s();
            }
            self.write(&c);
        }
        self.guarded = Some(c);
        true
    }

    /// A line of the plant's own record in `VSERVO_TEST_PLANT`: time, ns; whether it brakes by itself; the true speed of the fastest joint, and the commanded one.
    fn record(&mut self) {
        let Some(path) = std::env::var_os("VSERVO_TEST_PLANT") else { return };
        use std::io::Write;
        let fastest = |v: &[f64]| v.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let state = self.drive.read(rt::now());
        let speed = fastest(state.truth.map_or(state.qd, |(_, qd)| qd).as_slice());
        let asked = self.obeyed.map_or(0.0, |(c, _)| fastest(&c.qd_r[..N]));
        let mut log = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
        writeln!(log, "{} {} {speed} {asked}", rt::now().0, u8::from(self.guarded.is_some())).unwrap();
    }

    /// What this robot adds to commanded torques that do not contain it.
    fn own_torques(&mut self, c: &DriveCommandMsg) -> SVector<f64, N> {
        let mut own = SVector::zeros();
        let whole = drive_flag::GRAVITY | drive_flag::FRICTION;
        if c.mode != CommandMode::Torque as u32 || c.flags & whole == whole {
            return own;
        }
        let state = self.drive.read(c.stamp);
        if c.flags & drive_flag::GRAVITY == 0 {
            own += self.robot_model.gravity(&state.q);
        }
        if c.flags & drive_flag::FRICTION == 0 {
            own += self.robot_model.friction_torque(&state.qd);
        }
        own
    }

    fn write(&mut self, c: &DriveCommandMsg) {
        let tau = vector(&c.tau) + self.own_torques(c);
        let (q_r, qd_r, qdd_r) = (vector(&c.q_r), vector(&c.qd_r), vector(&c.qdd_r));
        self.drive.write(&DriveCommand { tau, q_r, qd_r, qdd_r });
    }

    fn obey(&mut self, c: &DriveCommandMsg) {
        if self.is_stopped(c) || self.refuses(c) || self.guarded.is_some() {
            return;
        }
        (self.obeyed, self.braked) = (Some((*c, rt::now())), false);
        if let Some(path) = std::env::var_os("VSERVO_TEST_LOG") {
            use std::io::Write;
            let fastest = c.qd_r[..N].iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            let mut log = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
            writeln!(log, "{fastest}").unwrap();
        }
        if let Some(path) = std::env::var_os("VSERVO_TEST_TORQUES") {
            use std::io::Write;
            let mut log = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
            writeln!(log, "{}", c.tau[..N].iter().map(f64::to_string).collect::<Vec<_>>().join(" ")).unwrap();
        }
        self.write(c);
    }

    fn send(&mut self, tick: u64, stamp: MonoNs, flags: u32) {
        let state = self.drive.read(stamp);
        if self.misbehaves("silent", tick) {
            return;
        }
        let tick = if self.misbehaves("wrong_tick", tick) { tick + 1 } else { tick };
        let mut m = DriveStateMsg {
            tick,
            sequence: self.sent,
            stamp,
            joints: N as u32,
            modes: 0b111,
            flags,
            robot_state: self.robot as u32,
            robot_code: if self.robot.obeys() { 0 } else { 42 },
            ..Default::default()
        };
        m.q[..N].copy_from_slice(state.q.as_slice());
        m.qd[..N].copy_from_slice(state.qd.as_slice());
        if let (Some((q, qd)), false) = (state.truth, self.misbehaves("no_truth", tick)) {
            m.flags |= drive_flag::TRUTH;
            m.q_true[..N].copy_from_slice(q.as_slice());
            m.qd_true[..N].copy_from_slice(qd.as_slice());
        }
        match self.behaviour.what.as_str() {
            "position_only" => m.modes = CommandMode::Position.bit(),
            "three_joints" => m.joints = 3,
            "endless_speed" => m.qd[0] = f64::INFINITY,
            "absurd_speed" => m.qd[0] = 100.0,
            "absurd_place" => m.q[0] = 1e200,
            "time_of_day" => m.stamp = m.stamp + SpanNs(1_700_000_000_000_000_000),
            "swapped" => {
                m.q.swap(0, 1);
                m.qd.swap(0, 1);
            }
            "no_velocity" => m.qd = Default::default(),
            "knows_no_states" => m.robot_state = 0,
            "unknown_state" => m.robot_state = 99,
            _ => {}
        }
        self.states.send(&m).unwrap();
        self.sent += 1;
    }
}

/// Not a test: the drive's process, which `vservo run` starts.
#[test]
#[ignore = "the drive of the other tests"]
fn drive_process() {
    let place: Place = std::env::var("VSERVO_INSTANCE").unwrap().parse().unwrap();
    let config = Config::load(Some(Path::new(&std::env::var("VSERVO_CONFIG").unwrap())), &[]).unwrap();
    let behaviour = std::env::var("VSERVO_TEST_DRIVE").unwrap_or_default();
    let (what, tick) = behaviour.split_once('@').unwrap_or((&behaviour, "0"));
    let behaviour = Behaviour { what: what.into(), tick: tick.parse().unwrap() };
    serve(&place, &config, behaviour);
    place.remove_leftovers(None);
}

fn serve(place: &Place, config: &Config, behaviour: Behaviour) {
    let services = Services::join(place).unwrap();
    let (commands, listener) = services.drive_command_receiver().unwrap();
    if behaviour.what == "mute" {
        let _states = services.drive_state_sender().unwrap();
        std::thread::sleep(Duration::from_secs(600));
    }
    let mut drive = TestDrive::new(&services, behaviour, config);
    let mut by_the_clock = false;
    let (mut next, mut count) = (rt::now(), 0);
    loop {
        while let Some(c) = commands.receive().unwrap() {
            if c.flags & drive_flag::LAST != 0 || drive.misbehaves("leave", c.tick) {
                return;
            }
            if c.flags & drive_flag::START != 0 {
                assert_eq!(c.q_r[..N], config.start.q[..]);
                drive.word = place.open_stop_word().unwrap();
                drive.tell_names();
                drive.tell_properties();
                by_the_clock = c.flags & drive_flag::LOCKSTEP == 0;
                next = rt::now();
                drive.send(0, if by_the_clock { next } else { c.stamp }, drive_flag::INITIAL);
                continue;
            }
            drive.obey(&c);
            if !by_the_clock {
                drive.send(c.tick + 1, c.stamp + TICK, 0);
            }
        }
        if by_the_clock {
            if !drive.is_stopped_by_guardian() {
                drive.brake_in_silence();
            }
            next = next.max(rt::now() - SpanNs(10 * TICK.0)) + TICK;
            rt::sleep_until(next);
            count += 1;
            drive.send(count, rt::now(), 0);
            drive.record();
        } else {
            listener.wait(Duration::from_millis(50)).unwrap();
        }
    }
}

/// Of an emulated robot, where priorities can be had: a real one has a computer of its own, so that what else this one does keeps no state back.
pub const ROBOT_PRIORITY: u32 = 85;

/// `drive.external.command=[...]` that starts this binary as a drive which behaves so.
pub fn command(behaviour: &str) -> String {
    let own = std::env::current_exe().unwrap();
    let argv =
        ["env", &format!("VSERVO_TEST_DRIVE={behaviour}"), own.to_str().unwrap(), "--ignored", "--exact"];
    program(&[&argv[..], &["drive::drive_process"]].concat())
}

/// `drive.external.command=[...]` of this program with its arguments.
pub fn program(argv: &[&str]) -> String {
    format!("drive.external.command={argv:?}")
}

/// A run with its drive, still under way; `log` as [`command`]'s drive writes it.
pub fn start_run(instance: &Instance, arguments: &[&str], log: Option<&Path>) -> Child {
    vservo()
        .envs(log.map(|path| ("VSERVO_TEST_LOG", path)))
        .args(["run", "--instance", &instance.name])
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

pub fn external(test: &str, behaviour: &str, extra: &[&str]) -> Run {
    run(test, &[&["--set", "drive.kind=external", "--set", &command(behaviour)], extra].concat())
}

/// The drive alone, under the name of an instance; `drive` is the name of its test.
pub fn drive_by_hand(instance: &Instance, drive: &str) -> Child {
    let config = format!("/dev/shm/vservo-{}/config.toml", instance.name);
    Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", drive])
        .envs([("VSERVO_INSTANCE", &instance.name), ("VSERVO_CONFIG", &config)])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}
