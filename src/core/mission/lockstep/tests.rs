//! How runs end whose arm is not seen, or was pushed: at rest, or with words for it.

use super::*;
use crate::config::{Config, assemble};
use crate::control::controller::Rest;
use crate::control::outcome::Outcome;
use crate::control::trace::Event;
use crate::drive::{CommandMode, Drive, DriveCommand, DriveState, SimulatedDrive};
use crate::sim::{Moment, perfect_measurement, simulate_system};
use crate::time::TICK;
use nalgebra::SVector;
use std::ops::ControlFlow;

/// A UR5 whose states a test may spoil, by the tick.
struct Spoilt {
    arm: SimulatedDrive<6>,
    tick: u64,
    spoil: fn(u64, &mut DriveState<6>),
}

impl Drive<6> for Spoilt {
    fn read(&mut self, now: MonoNs) -> DriveState<6> {
        let mut state = self.arm.read(now);
        (self.spoil)(self.tick, &mut state);
        self.tick += 1;
        state
    }

    fn write(&mut self, command: &DriveCommand<6>) {
        self.arm.write(command);
    }

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }
}

/// How such a run ended: its faults as events, with their ticks, how often an arm in a fault was told to move on, and the ticks for which the arm was told to stand at last.
struct SpoiltEnd {
    run: LockstepRun<6>,
    faults: Vec<(u64, Fault)>,
    moved_on: usize,
    stood: u64,
}

fn run_spoilt(set: &[&str], spoil: fn(u64, &mut DriveState<6>), shut_down_at: Option<u64>) -> SpoiltEnd {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/ur5.toml");
    let set: Vec<_> = set.iter().map(ToString::to_string).collect();
    let config = Config::load(Some(&path), &set).unwrap();
    let robot = config.robot.build::<6>().unwrap();
    let points: Vec<_> = config.target.points().iter().map(|point| point.p_O).collect();
    let q = assemble::q_start::<6>(&config).unwrap();
    let arm = SimulatedDrive::new(robot.clone(), q, assemble::simulated_settings(&config).unwrap()).unwrap();
    let drive = Box::new(Spoilt { arm, tick: 0, spoil });
    let mut run = assemble::control_loop_with(&config, robot.clone(), drive).unwrap();
    let (mut faults, mut moved_on, mut stood) = (Vec::new(), 0, 0);
    if config.serve {
        run.request(Request::Start).unwrap();
    }
    for tick in 0..20_000 {
        let now = MonoNs(tick as i64 * TICK.0);
        let state = run.sense(tick, now);
        let q = SVector::from_fn(|i, _| state.q[i]);
        let seen = tick.is_multiple_of(40) && state.q.iter().all(|q| q.is_finite());
        let measurement = seen
            .then(|| config.camera.mount.X_WC(&robot, &q).inv_mul(&config.X_WO().unwrap()))
            .and_then(|X_CO| perfect_measurement(&points, &X_CO, now));
        if shut_down_at == Some(tick) {
            run.request(Request::Shutdown).unwrap();
        }
        let trace = run.act(now, measurement.as_ref());
        faults.extend(trace.events.iter().filter_map(|event| match event {
            Event::Fault(fault) => Some((tick, fault)),
            _ => None,
        }));
        moved_on += trace.events.iter().filter(|event| *event == Event::StillMoves).count();
        stood = if trace.command.qd_r.iter().all(|qd| qd.abs() < 1e-3) { stood + 1 } else { 0 };
        if trace.over {
            return SpoiltEnd { run, faults, moved_on, stood };
        }
    }
    panic!("it never ends");
}

fn no_number(tick: u64, state: &mut DriveState<6>) {
    if tick >= 300 {
        state.q[2] = f64::NAN;
    }
}

fn absurdly_fast(tick: u64, state: &mut DriveState<6>) {
    if tick >= 300 {
        state.qd[5] = 1e3;
    }
}

#[test]
fn an_arm_that_is_not_seen_to_stand_is_braked_on_and_told() {
    for mode in ["drive.mode=torque", "drive.mode=velocity"] {
        for (spoil, first) in [
            (no_number as fn(u64, &mut DriveState<6>), Fault::DriveStateNotFinite),
            (absurdly_fast, Fault::DriveStateImplausible),
        ] {
            let end = run_spoilt(&[mode], spoil, None);
            let told: Vec<_> = end.faults.iter().map(|(_, fault)| *fault).collect();
            assert_eq!(told, [first, Fault::RestUnknown], "{mode}");
            let least = if mode.ends_with("torque") { 1 } else { 200 };
            assert!(end.stood >= least, "{mode}: told to stand for {} ms", end.stood);
            let finish = end.run.mission.finish().unwrap();
            assert_eq!((finish.outcome, finish.reason), (Outcome::Fault, first.describe()), "{mode}");
            let unknown = end.run.control.unknown_joint().unwrap();
            assert!(unknown.known.abs() < 3.0, "{mode}: {unknown:?}");
            if first == Fault::DriveStateImplausible {
                let words = unknown.in_words(&["", "", "", "", "", "wrist_3"]);
                assert!(
                    words.contains("whether joint \"wrist_3\" stood: its last known velocity was"),
                    "{words}"
                );
                assert!(words.ends_with("rad/s, and the drive says 1000.00 rad/s"), "{words}");
            }
        }
    }
}

#[test]
fn a_state_that_comes_back_tells_whether_the_arm_stands() {
    let spoil: fn(u64, &mut DriveState<6>) = |tick, state| {
        if (300..550).contains(&tick) {
            state.q[2] = f64::NAN;
        }
    };
    let end = run_spoilt(&["drive.mode=velocity"], spoil, None);
    assert_eq!(end.faults.len(), 1, "{:?}", end.faults);
    assert_eq!((end.run.control.unknown_joint(), end.run.control.controller().rest()), (None, Rest::AtRest));
}

/// A served run goes on in its fault, and says that the arm, a joint of which creeps, should stand and does not.
#[test]
fn a_served_arm_that_moves_on_in_its_fault_is_told() {
    let creeps: fn(u64, &mut DriveState<6>) = |tick, state| {
        let since = tick.saturating_sub(300) as f64;
        (state.q[5], state.qd[5]) =
            (state.q[5] + 1e-4 * since, state.qd[5] + if since > 0.0 { 0.1 } else { 0.0 });
    };
    for (serve, moved_on) in [("run.serve=true", 1), ("run.serve=false", 0)] {
        let end = run_spoilt(&["drive.mode=velocity", serve], creeps, Some(12_000));
        assert_eq!(end.moved_on, moved_on, "{serve}");
        let last = end.faults.last().map(|(_, fault)| *fault);
        assert_eq!((end.faults.len(), last), (2, Some(Fault::NotAtRest)), "{serve}: {:?}", end.faults);
    }
}

/// A served run does not end by a fault, and a shutdown is no orderly one where nobody knows.
#[test]
fn a_shutdown_of_an_arm_that_nobody_sees_ends_as_a_fault() {
    let end = run_spoilt(&["drive.mode=velocity", "run.serve=true"], no_number, Some(5000));
    assert_eq!(end.faults.last(), Some(&(5000, Fault::RestUnknown)));
    assert_eq!(end.run.mission.finish().unwrap().outcome, Outcome::Fault);
}

/// A push that makes a joint too fast, whether or not it is told as a contact before, and ones that fling a wrist to ten times its limit and more: at the end of each run the arm stands.
#[test]
fn an_arm_that_a_push_has_made_too_fast_comes_to_rest() {
    let mut fastest = 0.0_f64;
    for (arm, force, from_s, until_s) in [
        ("panda", "[84,-80,31]", 0.4, 0.9),
        ("panda", "[-302.9,40.1,-170.6]", 0.45, 0.95),
        ("panda", "[-59.3,4.9,-80.3]", 0.58, 0.88),
        ("xarm7", "[284.2,-102.0,177.0]", 0.31, 0.81),
    ] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../config/{arm}.toml"));
        let push = format!("drive.simulated.push={{force_n={force},from_s={from_s},until_s={until_s}}}");
        let set = ["drive.mode=torque", "servo.scheme=position_pd", "safety.contact=stop", &push];
        let config = Config::load(Some(&path), &set.map(str::to_owned)).unwrap();
        let (mut fault, mut last) = (None, f64::NAN);
        simulate_system(&config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                fault = fault.or(trace.fault);
                last = trace.joint_state.qd_true.iter().fold(0.0, |most: f64, qd| most.max(qd.abs()));
                fastest = fastest.max(last);
            }
            ControlFlow::Continue(())
        })
        .unwrap();
        assert!(matches!(fault, Some(Fault::TooFast | Fault::Contact)), "{arm} {force}: {fault:?}");
        assert!(last < 0.02, "{arm} {force}: {last} rad/s");
    }
    assert!(fastest > 30.0, "none was flung: {fastest} rad/s");
}

/// An arm with a load that nobody told and that is not learnt yet, which a push of a tenth of a second stops: it is held in the end, and sinks by no more than until it is learnt.
#[test]
fn an_untold_load_is_held_after_a_contact() {
    for (arm, payload_kg, force_n, from_s) in [
        ("ur5", 0.5, 50, 0.6),
        ("ur5", 1.0, 150, 0.6),
        ("panda", 0.5, 80, 0.6),
        ("panda", 3.0, 150, 0.6),
        ("scara-b", 1.0, 150, 0.8),
        ("scara-b", 2.0, 150, 0.8),
    ] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../config/{arm}.toml"));
        let until_s = from_s + 0.1;
        let set = [
            format!("drive.simulated.payload_kg={payload_kg}"),
            format!(
                "drive.simulated.push={{force_n=[{force_n}.0,0.0,0.0],from_s={from_s},until_s={until_s}}}"
            ),
            "run.duration_s=12".to_owned(),
        ];
        let config = Config::load(Some(&path), &set).unwrap();
        let (mut fault, mut last, mut let_go, mut at) = (None, f64::NAN, None, None);
        simulate_system(&config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                fault = fault.or(trace.fault);
                let js = &trace.joint_state;
                if fault.is_some() && js.stamp.0 as f64 * 1e-9 > until_s + 0.3 {
                    let_go.get_or_insert(js.q_true);
                }
                at = Some(js.q_true);
                last = js.qd_true.iter().fold(0.0, |most: f64, qd| most.max(qd.abs()));
            }
            ControlFlow::Continue(())
        })
        .unwrap();
        let sunk = let_go.zip(at).map_or(0.0, |(from, to)| {
            from.iter().zip(to).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
        });
        assert_eq!(fault, Some(Fault::Contact), "{arm} {payload_kg} kg, {force_n} N");
        assert!(last < 0.02, "{arm} {payload_kg} kg, {force_n} N: {last} rad/s or m/s");
        assert!(sunk < 0.4, "{arm} {payload_kg} kg, {force_n} N: {sunk} rad or m");
    }
}

/// A run of a shipped file, with these keys changed, converges.
fn converges(file: &str, set: &[String]) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../config/{file}.toml"));
    let config = Config::load(Some(&path), set).unwrap();
    let end = simulate_system(&config, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(end.finish.outcome, Outcome::Converged, "{file} {set:?}: {}", end.finish.reason);
}

/// With less jerk a torque law is slower, and comes to its goal. Other jerks and accelerations than its constants were chosen with.
#[test]
fn a_low_jerk_makes_a_torque_law_slow_and_not_loose() {
    for (arm, scheme) in [
        ("scara-a", "position_pd"),
        ("scara-c", "image_pd"),
        ("xarm7", "position_pd"),
        ("panda", "position_pd"),
    ] {
        for (jerk, acceleration) in [(8.0, 8.0), (15.0, 10.0), (30.0, 5.0), (75.0, 20.0)] {
            let set = [
                format!("motion.max_jerk_rad_s3_or_m_s3=[{jerk:.1}]"),
                format!("motion.max_acceleration_rad_s2_or_m_s2=[{acceleration:.1}]"),
                format!("servo.scheme={scheme}"),
                "drive.mode=torque".to_owned(),
            ];
            converges(arm, &set);
        }
    }
}

/// States that a drive sends once more as if they were new, while the arm is fast.
#[test]
fn states_that_come_twice_are_no_fault_of_the_arm() {
    for (arm, mode) in [
        ("ur5", "velocity"),
        ("ur5", "position"),
        ("panda", "velocity"),
        ("xarm7", "position"),
        ("ur5", "torque"),
    ] {
        for (probability, from_s, seed) in [(0.3, 0.0, 1), (0.3, 0.2, 2), (0.5, 0.1, 3)] {
            let stale =
                format!("kind='stale_state',from_s={from_s:.2},duration_s=0.3,probability={probability}");
            let set =
                [format!("drive.mode={mode}"), format!("run.seed={seed}"), format!("faults=[{{{stale}}}]")];
            converges(arm, &set);
        }
    }
}

/// A law of torques pulls for a while against a load that is being learnt, and the joint stands: it is not jammed.
#[test]
fn a_load_that_is_being_learnt_jams_no_joint() {
    for payload in 2..=12 {
        converges("scara-c", &[format!("drive.simulated.payload_kg={}", 0.25 * f64::from(payload))]);
    }
}

/// An xArm7 whose efforts do not suffice, in the posture of this start, for the accelerations of its run file: it fell 0.1 rad behind its reference within half a second.
#[test]
fn an_arm_whose_efforts_do_not_suffice_keeps_up() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/xarm7.toml");
    let set = [
        "servo.scheme=hybrid",
        "robot.q_start_rad_or_m=[-0.148609087,-1.62270927,0.1943068,2.82036509,-0.264384212,2.68206468,-0.73000879]",
        "scene.object.position_m=[0.350247521,0.0945229047,0.557401726]",
        "scene.object.rotation_rpy_rad=[-2.56228998,-0.762409824,-0.388309683]",
        "servo.desired.position_m=[-0.048454825,-0.035976852,0.45903332]",
        "servo.desired.rotation_rpy_rad=[0.105874415,-0.173426634,0.227933436]",
    ];
    let config = Config::load(Some(&path), &set.map(str::to_owned)).unwrap();
    let run = simulate_system(&config, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(run.finish.outcome, Outcome::Converged, "{:?}", run.finish);
}
