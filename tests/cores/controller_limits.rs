//! Whatever the camera sees and wherever the arm starts: the controller stays within every limit and within numbers;
//! near singular postures and ends of ranges it slows down and says so.

#![allow(non_snake_case, clippy::unwrap_used)] // helpers of tests are tests

use nalgebra::SVector;
use proptest::prelude::*;
use std::path::Path;
use vservo::config::Config;
use vservo::config::assemble;
use vservo::control::behaviour::{ArmModel, Behaviour, Servoing};
use vservo::control::controller::{Controller, ControllerSettings};
use vservo::control::lifecycle::{Request, State};
use vservo::control::safety::{Fault, MeasurementWatch};
use vservo::control::trace::Trace;
use vservo::drive::{CommandMode, Drive, DriveCommand, DriveState};
use vservo::geometry::Pose;
use vservo::messages::{ControlState, JointState, Measurement};
use vservo::mission::LockstepRun;
use vservo::motion::{
    InverseDynamicsControl, JointController, JointLaw, Limit, MotionLimits, ObserverSettings,
};
use vservo::report::statistics::RunStatistics;
use vservo::robot::{Mount, Robot, load};
use vservo::servo::{
    DepthSource, Gain, Interaction, InteractionAt, Law, ServoSettings, SetPoint, UpdatePolicy, VisualServo,
};
use vservo::sim::perfect_measurement;
use vservo::target::FourDots;
use vservo::time::{MonoNs, SpanNs};

const MS: i64 = 1_000_000;
const DT_S: f64 = 1e-3;

fn robot<const N: usize>(name: &str) -> Robot<N> {
    load(name).unwrap().build().unwrap()
}

/// A controller that was started, of an arm in `q`.
fn started<const N: usize>(
    name: &str,
    update: UpdatePolicy,
    gain_1_s: f64,
    q: SVector<f64, N>,
) -> Controller<N> {
    let robot = robot::<N>(name);
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0, 0.0, 0.3].into());
    let set_point = SetPoint::from_pose(&goal, &FourDots::default().points_O()).unwrap();
    let law = Law::ImageVelocity {
        K_s: 1.0.into(),
        gain: Gain::Constant(gain_1_s),
        interaction: Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated },
    };
    let mount = Mount::EyeInHand { X_EC: Pose::translation(0.0, 0.0, 0.05) };
    let limits = MotionLimits::of(&robot, SVector::repeat(10.0), SVector::repeat(500.0));
    let servo = VisualServo::new(ServoSettings::new(law, update, mount), set_point);
    let watch = MeasurementWatch::new(SpanNs(200 * MS), 0.75);
    let joint_control = JointController::new(
        JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0)),
        ObserverSettings::none(),
    );
    let arm = ArmModel { robot, limits };
    let settings = ControllerSettings::new(arm, joint_control, CommandMode::Torque, q);
    let mut controller = Controller::new(settings, servo, Behaviour::Servoing(Servoing::new(watch)));
    controller.request(Request::Start).unwrap();
    controller
}

/// A measurement of a target at `X_CO`; `None` where a dot is not in front of the camera.
fn seen(k: i64, X_CO: &Pose) -> Option<Measurement> {
    perfect_measurement(&FourDots::default().points_O(), X_CO, MonoNs(k * MS))
}

#[derive(Debug, Clone)]
struct Wild {
    start: Vec<f64>,
    views: Vec<([f64; 3], [f64; 3])>,
    gain_1_s: f64,
    predict: bool,
}

fn wild() -> impl Strategy<Value = Wild> {
    let view = (prop::array::uniform3(-0.4..0.4f64), prop::array::uniform3(-2.0..2.0f64));
    (prop::collection::vec(0.0..1.0f64, 7), prop::collection::vec(view, 1..8), 0.5..20.0f64, any::<bool>())
        .prop_map(|(start, views, gain_1_s, predict)| Wild { start, views, gain_1_s, predict })
}

/// Shows the controller views that have nothing to do with its motion, then stops it.
fn stays_within_limits<const N: usize>(name: &str, wild: &Wild) -> Result<(), TestCaseError> {
    let update = if wild.predict { UpdatePolicy::Predict } else { UpdatePolicy::Tick };
    let robot = robot::<N>(name);
    let start = SVector::<f64, N>::from_fn(|i, _| {
        let l = &robot.limits()[i];
        l.lower.max(-6.0) + wild.start[i] * (l.upper.min(6.0) - l.lower.max(-6.0))
    });
    let efforts = SVector::<f64, N>::from_fn(|i, _| robot.limits()[i].effort);
    let mut controller = started::<N>(name, update, wild.gain_1_s, start);
    let limits = controller.arm().limits.clone();
    let (mut q, mut qd, mut qdd) = (start, SVector::<f64, N>::zeros(), SVector::<f64, N>::zeros());
    for k in 0..1600_i64 {
        let m = if k % 30 == 0 {
            let (p, r) = wild.views[(k / 30) as usize % wild.views.len()];
            seen(k, &Pose::new([p[0], p[1], 0.6 + p[2]].into(), r.into()))
        } else {
            None
        };
        if k == 600 {
            controller.request(Request::Stop).unwrap();
        }
        let out = controller.step(MonoNs(k * MS), &DriveState { q, qd, truth: None }, m.as_ref());
        let c = &out.command;
        let values = c.q_r.iter().chain(&c.qd_r).chain(&c.tau).chain(&out.requested_qd);
        prop_assert!(values.into_iter().all(|x| x.is_finite()), "{name} {k}: {out:?}");
        let qdd_now = (c.qd_r - qd) / DT_S;
        for i in 0..N {
            prop_assert!(
                c.q_r[i] >= limits.lower[i] - 1e-9 && c.q_r[i] <= limits.upper[i] + 1e-9,
                "{name} {k} joint {i}: {}",
                c.q_r
            );
            prop_assert!(c.qd_r[i].abs() <= limits.velocity[i] * (1.0 + 1e-9), "{name} {k}: {}", c.qd_r);
            prop_assert!(qdd_now[i].abs() <= limits.acceleration[i] * (1.0 + 1e-6), "{name} {k}: {qdd_now}");
            prop_assert!(
                (qdd_now[i] - qdd[i]).abs() <= limits.jerk[i] * DT_S * (1.0 + 1e-6) + 1e-8,
                "{name} {k}"
            );
            prop_assert!(c.tau[i].abs() <= efforts[i]);
        }
        (q, qd, qdd) = (c.q_r, c.qd_r, qdd_now);
    }
    prop_assert!(qd.amax() < 1e-6, "{name} does not come to rest: {qd}");
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn ur5_stays_within_its_limits(wild in wild()) {
        stays_within_limits::<6>("ur5", &wild)?;
    }

    #[test]
    fn panda_stays_within_its_limits(wild in wild()) {
        stays_within_limits::<7>("panda", &wild)?;
    }

    #[test]
    fn scara_stays_within_its_limits(wild in wild()) {
        stays_within_limits::<4>("scara", &wild)?;
    }

    #[test]
    fn the_pan_tilt_head_stays_within_its_limits(wild in wild()) {
        stays_within_limits::<2>("pan_tilt", &wild)?;
    }
}

/// An arm that reports `wrong` from the fourth state on.
struct Wrong {
    right: DriveState<4>,
    wrong: DriveState<4>,
    reads: u32,
}

impl Drive<4> for Wrong {
    fn read(&mut self, _now: MonoNs) -> DriveState<4> {
        self.reads += 1;
        if self.reads > 3 { self.wrong } else { self.right }
    }

    fn write(&mut self, _command: &DriveCommand<4>) {}

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }
}

/// Six ticks of a loop whose arm then is at `value` with a joint, or has that velocity.
fn stepped_on(law: &str, joint: usize, moving: bool, value: f64) -> Vec<Trace> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(law);
    let config = Config::load(Some(&file), &[]).unwrap();
    let robot = config.robot.build::<4>().unwrap();
    let q: SVector<f64, 4> = assemble::q_start(&config).unwrap();
    let X_CO = config.camera.mount.X_WC(&robot, &q).inv_mul(&config.X_WO().unwrap());
    let right = DriveState { q, qd: SVector::zeros(), truth: None };
    let mut wrong = right;
    (if moving { &mut wrong.qd } else { &mut wrong.q })[joint] = value;
    let drive = Box::new(Wrong { right, wrong, reads: 0 });
    let mut control = assemble::control_loop_with(&config, robot, drive).unwrap();
    (0..6)
        .map(|k| control.tick(k as u64, MonoNs(k * MS), if k == 0 { seen(0, &X_CO) } else { None }.as_ref()))
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever finite state a drive reports, no command is NaN; and what no arm does is a fault of the drive.
    #[test]
    fn absurd_states_of_a_drive_are_a_fault_and_make_no_nan(
        joint in 0..4usize, moving in any::<bool>(), negative in any::<bool>(), exponent in 0.0..308.0f64,
        law in prop::sample::select(vec!["scara-a.toml", "scara-b.toml", "scara-c.toml", "scara-d.toml"])
    ) {
        let value = 10_f64.powf(exponent) * if negative { -1.0 } else { 1.0 };
        for (k, trace) in stepped_on(law, joint, moving, value).iter().enumerate() {
            let c = &trace.command;
            let finite = c.q_r.iter().chain(&c.qd_r).chain(&c.tau).all(|x| x.is_finite());
            prop_assert!(finite, "{law} {k} {value}: {trace:?}");
            // The fastest joint has 8 rad/s; no joint leaps by 0.1 rad in a tick.
            let absurd = value.abs() > 80.0 || !moving;
            if k < 3 {
                prop_assert_eq!(trace.fault, None);
            } else if absurd {
                prop_assert_eq!(trace.fault, Some(Fault::DriveStateImplausible), "{} {}", law, value);
            }
        }
    }
}

struct Outcome {
    events: Vec<String>,
    limits: u32,
    last: JointState,
    fastest_late: f64,
}

/// A run of a run file with a perfect camera that looks everywhere, in this process.
fn perfect_run(file: Option<&str>, set: &[&str], seconds: i64) -> Outcome {
    let path = file.map(|f| Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(f));
    let set: Vec<String> = set.iter().map(ToString::to_string).collect();
    let config = Config::load(path.as_deref(), &set).unwrap();
    vservo::dispatch_robot!(config.robot, |robot| {
        let copy = robot.clone();
        perfect_loop(&config, &copy, assemble::control_loop(&config, robot).unwrap(), seconds)
    })
    .unwrap()
}

fn perfect_loop<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    mut control: LockstepRun<N>,
    seconds: i64,
) -> Outcome {
    let mut outcome =
        Outcome { events: Vec::new(), limits: 0, last: JointState::default(), fastest_late: 0.0 };
    let mut statistics = RunStatistics::new(Vec::new());
    for k in 0..seconds * 1000 {
        let now = MonoNs(k * MS);
        let state = control.sense(k as u64, now);
        let q = SVector::<f64, N>::from_fn(|i, _| state.q_true[i]);
        let within = q.zip_map(&SVector::from_fn(|i, _| robot.limits()[i].lower), f64::max);
        let within = within.zip_map(&SVector::from_fn(|i, _| robot.limits()[i].upper), f64::min);
        assert!((within - q).amax() < 1e-6, "{k}: {q}");
        let X_CO = config.camera.mount.X_WC(robot, &q).inv_mul(&config.X_WO().unwrap());
        let m = if k % 40 == 0 { seen(k, &X_CO) } else { None };
        let trace = control.act(now, m.as_ref());
        statistics.note(&trace);
        let finish = trace.finish;
        if let Some(status) = trace.status {
            outcome.limits |= status.limits;
            assert_ne!(status.state, ControlState::Fault as u32, "{k}");
        }
        if k > (seconds - 1) * 1000 {
            outcome.fastest_late = state.qd_true.iter().fold(outcome.fastest_late, |m, v| m.max(v.abs()));
        }
        outcome.last = state;
        assert!(finish.is_none(), "{finish:?}");
    }
    outcome.events = statistics.safety_report(control.state()).events.into_iter().map(|e| e.event).collect();
    outcome
}

/// The goal lies beyond the arm's reach: it stretches, slows down and says why.
#[test]
fn an_arm_that_cannot_reach_stretches_slowly_and_says_so() {
    let set =
        ["scene.object.position_m=[0.95, 0.15, -0.1]", "camera.lens.fx_px=150", "camera.lens.fy_px=150"];
    let out = perfect_run(Some("ur5.toml"), &set, 20);
    assert!(out.events.iter().any(|e| e.contains("singular")), "{:?}", out.events);
    assert_ne!(out.limits & Limit::Singularity.bit(), 0);
    assert!(out.fastest_late < 0.06, "{} rad/s", out.fastest_late);
}

/// The goal lies behind the end of the third joint's range.
#[test]
fn a_joint_stops_at_the_end_of_its_range_and_says_so() {
    let set = ["scene.object.position_m=[1.0, 1.0, 2.9]"];
    let out = perfect_run(None, &set, 15);
    let told = out.events.iter().any(|e| e == "the end of the range holds back joint 3 for 1 s now");
    assert!(told, "{:?} {:?}", out.events, out.last);
    assert_ne!(out.limits & Limit::Position.bit(), 0);
    assert!(out.last.q_true[2] > 2.0 - 1e-6, "{:?}", out.last.q_true);
    assert!(out.fastest_late < 1e-6, "{}", out.fastest_late);
}

/// In the run files' own range nothing is slowed down for long.
#[test]
fn an_easy_run_has_no_events() {
    let out = perfect_run(Some("panda.toml"), &["goal.feature_error_px=0.00001", "goal.hold_s=60"], 5);
    assert!(out.events.is_empty(), "{:?}", out.events);
    assert_eq!(out.limits & (Limit::Singularity.bit() | Limit::Position.bit()), 0);
}

/// The target vanishes on the way: the arm slows down while the last view grows old, then holds, then goes on.
#[test]
fn an_old_view_slows_the_arm_down_before_it_holds() {
    let robot = robot::<4>("scara");
    let mut q = SVector::<f64, 4>::new(0.2, 1.2, 0.5, -0.6);
    let X_BO = robot.forward(&q) * Pose::new([0.25, 0.05, 0.7].into(), [0.0, 0.0, 0.1].into());
    let mut qd = SVector::<f64, 4>::zeros();
    let mut controller = started::<4>("scara", UpdatePolicy::Predict, 2.0, q);
    let mut speed = Vec::new();
    for k in 0..1000_i64 {
        let visible = k <= 400 || k >= 800;
        let X_CO = (robot.forward(&q) * Pose::translation(0.0, 0.0, 0.05)).inv_mul(&X_BO);
        let m = if k % 40 == 0 && visible { seen(k, &X_CO) } else { None };
        let out = controller.step(MonoNs(k * MS), &DriveState { q, qd, truth: None }, m.as_ref());
        let slowed = out.limits.joints(Limit::View) != 0;
        if k != 550 && k != 600 {
            assert_eq!(slowed, (551..600).contains(&k), "{k}: the last view is from 400 ms");
            let held = (601..800).contains(&k);
            assert_eq!(out.state, if held { State::Holding } else { State::Servoing }, "{k}");
        }
        (q, qd) = (out.command.q_r, out.command.qd_r);
        speed.push(qd.amax());
    }
    assert!(speed[550] > 0.3, "well under way: {}", speed[550]);
    assert!(speed[590] < 0.6 * speed[550], "{} {}", speed[550], speed[590]);
    assert!(speed[799] < 1e-9 && speed[999] > 0.02, "{} {}", speed[799], speed[999]);
}

/// An arm whose gain went down because it moved about its goal has all of it again when it is started anew, as it is when the run is
/// told to stop and to start, or after a fault that is reset.
#[test]
fn a_start_gives_back_the_gain_that_was_reduced() {
    let q = SVector::<f64, 6>::from([0.0, -1.4, 1.6, -1.8, -1.57, 0.0]);
    let mut controller = started("ur5", UpdatePolicy::Predict, 3.0, q);
    let (mut k, mut state) = (0, DriveState { q, qd: SVector::zeros(), truth: None });
    let mut until = |controller: &mut Controller<6>, wanted: State| {
        for _ in 0..2000 {
            let m = (k % 30 == 0).then(|| seen(k, &Pose::translation(0.0, 0.0, 0.5)).unwrap());
            let out = controller.step(MonoNs(k * MS), &state, m.as_ref());
            state = DriveState { q: out.command.q_r, qd: out.command.qd_r, truth: None };
            k += 1;
            if out.state == wanted {
                return;
            }
        }
        panic!("never {wanted:?}");
    };
    let reductions =
        |controller: &mut Controller<6>| (0..100).take_while(|_| controller.reduce_gain()).count();
    until(&mut controller, State::Servoing);
    let at_first = reductions(&mut controller);
    assert!((1..100).contains(&at_first), "{at_first}");
    assert_eq!(reductions(&mut controller), 0, "it is at its floor");
    controller.request(Request::Stop).unwrap();
    until(&mut controller, State::Idle);
    controller.request(Request::Start).unwrap();
    until(&mut controller, State::Servoing);
    assert_eq!(reductions(&mut controller), at_first);
    controller.fail(Fault::PeersSilent);
    until(&mut controller, State::Fault);
    controller.request(Request::Reset).unwrap();
    controller.request(Request::Start).unwrap();
    until(&mut controller, State::Servoing);
    assert_eq!(reductions(&mut controller), at_first);
}
