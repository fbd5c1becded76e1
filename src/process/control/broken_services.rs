//! Each of control's services fails in turn while the arm moves, behind an external drive: what that drive hears until the end.
//!
//! Control runs on the thread of the test with its real ports, which fail there and nowhere else; drive, camera and vision are
//! played by another thread.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use super::run;
use crate::config::Clock;
use crate::config::Config;
use crate::control::lifecycle::Request;
use crate::ipc::{Channel, Instance, Services, breakage};
use crate::messages::{CameraId, ControlCommand, DriveCommandMsg, DriveStateMsg, Measurement, drive_flag};
use crate::process::{ProcessError, StopFlag, frame_shape};
use crate::rt;
use crate::sim::perfect_measurement;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

/// Joints, as the default arm has them.
const N: usize = 4;
/// An arm this fast is on its way, rad/s or m/s. Chosen by hand: far above what an arm at rest is commanded.
const MOVES: f64 = 0.3;

/// The commands that the drive was given.
#[derive(Default)]
struct Record {
    qd_r: Vec<SVector<f64, N>>,
    last: bool,
}

/// A drive that follows its commands at once, and the camera and vision of the same cell.
struct FakeCell {
    config: Config,
    q: SVector<f64, N>,
    moves: Arc<AtomicBool>,
    record: Record,
}

impl FakeCell {
    fn view(&self, tick: u64, exposure: MonoNs) -> Measurement {
        let robot = self.config.robot.build::<N>().unwrap();
        let X_CO = self.config.camera.mount.X_WC(&robot, &self.q).inv_mul(&self.config.X_WO().unwrap());
        let points_O: Vec<_> = self.config.target.points().iter().map(|point| point.p_O).collect();
        let frame_id = self.config.camera.schedule.frame_at(tick).unwrap_or(tick);
        Measurement { frame_id, ..perfect_measurement(&points_O, &X_CO, exposure).unwrap() }
    }

    fn state(&self, c: &DriveCommandMsg, flags: u32) -> DriveStateMsg {
        let lockstep = self.config.clock == Clock::Lockstep;
        let initial = flags & drive_flag::INITIAL != 0;
        let stamp = if !lockstep {
            rt::now()
        } else if initial {
            c.stamp
        } else {
            c.stamp + TICK
        };
        let tick = if initial { 0 } else { c.tick + 1 };
        let mut m =
            DriveStateMsg { tick, stamp, joints: N as u32, modes: 0b111, flags, ..Default::default() };
        m.q[..N].copy_from_slice(self.q.as_slice());
        m.qd[..N].copy_from_slice(&c.qd_r[..N]);
        m
    }

    /// Obeys to the last command; then, or when nothing comes for ten seconds, gives its record.
    fn play(mut self, place: &Instance) -> Record {
        let services = Services::join(place).unwrap();
        let (commands, wake_listener) = services.drive_command_receiver().unwrap();
        let states = services.drive_state_sender().unwrap();
        let _camera = services.frame_sender(CameraId::FIRST, frame_shape(&self.config)).unwrap();
        let vision = services.measurement_sender(CameraId::FIRST).unwrap();
        // Where nobody listens nothing is sent.
        let _listeners = (services.trace_receiver().unwrap(), services.request_recorder().unwrap());
        let mut asked = None;
        let schedule = self.config.camera.schedule;
        let mut heard = rt::now();
        while !self.record.last && rt::now() - heard < SpanNs(10_000_000_000) {
            wake_listener.wait(Duration::from_millis(5)).unwrap();
            while let Some(c) = commands.receive().unwrap() {
                heard = rt::now();
                self.q = SVector::from_column_slice(&c.q_r[..N]);
                if c.flags & drive_flag::LAST != 0 {
                    self.record.last = true;
                    continue;
                }
                let start = c.flags & drive_flag::START != 0;
                let qd_r = SVector::from_column_slice(&c.qd_r[..N]);
                if !start {
                    self.record.qd_r.push(qd_r);
                }
                let state = self.state(&c, if start { drive_flag::INITIAL } else { 0 });
                states.send(&state).unwrap();
                if schedule.frame_at(state.tick).is_some() {
                    vision.send(&self.view(state.tick, state.stamp)).unwrap();
                }
                if qd_r.amax() > MOVES {
                    self.moves.store(true, Ordering::Relaxed);
                    // What is answered is recorded, whatever the answer is.
                    asked = asked.or_else(|| {
                        let client = services.command_client().ok()?;
                        client.ask(ControlCommand::of(Request::Set as u32)).ok().map(|asked| (asked, client))
                    });
                }
            }
        }
        self.record
    }
}

/// Requests the stop when dropped: a player that fails must not leave control waiting for it.
struct EndsTheRun(StopFlag);

impl Drop for EndsTheRun {
    fn drop(&mut self) {
        self.0.request();
    }
}

/// A run in which `service` fails from when the arm moves, `uses` times; how it ended, and what the drive heard.
fn broken(service: Channel, clock: &str, uses: u32) -> (Result<(), ProcessError>, Record) {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let name = format!("broken-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    let place: Instance = name.parse().unwrap();
    let sets = [
        "drive.kind=external",
        "drive.mode=velocity",
        "realtime.policy=off",
        "run.duration_s=2",
        "servo.first_motion_m_s=0", // the picture of this cell stands still
        "drive.external.answer_timeout_s=1",
    ];
    let clock = format!("run.clock={clock}");
    let sets: Vec<_> = sets.into_iter().map(String::from).chain([clock]).collect();
    let config = Config::load(None, &sets).unwrap();
    let moves = Arc::new(AtomicBool::new(false));
    let q = crate::config::assemble::q_start::<N>(&config).unwrap();
    let cell = FakeCell { config: config.clone(), q, moves: moves.clone(), record: Record::default() };
    let there = place.clone();
    let stop = StopFlag::default();
    let ends = EndsTheRun(stop.clone());
    let player = move || {
        let _ends = ends;
        // Control removes what an earlier run left: whoever joins while it does so has nothing to join.
        while there.open_stop_word().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        cell.play(&there)
    };
    let player = std::thread::Builder::new().name("cell".into()).spawn(player).unwrap();
    let mut left = uses;
    breakage::set(move |used| {
        let fails = used == service && left > 0 && moves.load(Ordering::Relaxed);
        left -= u32::from(fails);
        fails
    });
    let end = run(&config, &place, &stop, None).map(|_| ());
    let record = player.join().unwrap();
    place.remove_leftovers(None);
    (end, record)
}

#[test]
fn an_arm_is_braked_to_the_end_whatever_service_fails() {
    let for_good = u32::MAX;
    for clock in ["realtime", "lockstep"] {
        for (service, uses) in [
            (Channel::Measurement(CameraId::FIRST), for_good),
            (Channel::JointState, for_good),
            (Channel::Trace, for_good),
            (Channel::Status, for_good),
            (Channel::Request, for_good),
            (Channel::DriveState, for_good),
            (Channel::DriveText, for_good),
            (Channel::DriveCommand, 1), // for good, nothing could reach the drive
        ] {
            let (end, record) = broken(service, clock, uses);
            let told = end.expect_err("a run cannot go on without it").to_string();
            assert!(told.contains(&service.to_string()), "{clock} {service}: {told}");
            let fastest = record.qd_r.iter().map(|qd| qd.amax()).fold(0.0, f64::max);
            assert!(fastest > MOVES, "{clock} {service}: the arm moved");
            let at_the_end = record.qd_r.last().unwrap().amax();
            assert!(record.last, "{clock} {service}");
            // A simulator that is not heard, or has not heard, is told that nothing follows; no time passes in which it could brake.
            let may_brake =
                clock == "realtime" || !matches!(service, Channel::DriveState | Channel::DriveCommand);
            // at rest, as braking must end: far below what a moving arm has
            assert!(!may_brake || at_the_end < 1e-3, "{clock} {service}: {at_the_end}");
        }
    }
}

#[test]
fn requests_that_cannot_be_taken_end_no_run() {
    for clock in ["realtime", "lockstep"] {
        let (end, record) = broken(Channel::Command, clock, u32::MAX);
        end.unwrap_or_else(|e| panic!("{clock}: {e}"));
        // at rest, as braking must end
        assert!(record.last && record.qd_r.last().unwrap().amax() < 1e-3, "{clock}");
    }
}
