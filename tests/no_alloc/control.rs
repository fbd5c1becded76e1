//! A tick of the control loop allocates nothing: servoing, at its limits, without target, doing what clients ask for, stopping, and in a fault.

#![allow(non_snake_case, clippy::unwrap_used)] // helpers of tests are tests

use assert_no_alloc::assert_no_alloc;
use nalgebra::SVector;
use std::path::Path;
use vservo::config::Config;
use vservo::config::Task;
use vservo::config::assemble;
use vservo::control::lifecycle::Request;
use vservo::drive::{CommandMode, Drive, DriveCommand, DriveState};
use vservo::geometry::Pose;
use vservo::messages::{CommandForm, ControlCommand, ControlState, Measurement, measurement_flag};
use vservo::mission::LockstepRun;
use vservo::robot::Robot;
use vservo::sim::perfect_measurement;
use vservo::time::MonoNs;

const MS: i64 = 1_000_000;

/// What a perfect camera sees; once the target is not wholly before the camera any more, nothing.
fn seen(config: &Config, k: i64, X_CO: &Pose) -> Measurement {
    let points: Vec<_> = config.target.points().iter().map(|point| point.p_O).collect();
    let exposure = MonoNs(k * MS);
    perfect_measurement(&points, X_CO, exposure).unwrap_or(Measurement { exposure, ..Measurement::default() })
}

/// `m` without its pose, and without the first `hidden` features.
fn hide(mut m: Measurement, hidden: usize) -> Measurement {
    m.features.rotate_left(hidden);
    m.feature_count = m.feature_count.saturating_sub(hidden as u32);
    m.flags &= !measurement_flag::POSE;
    m
}

fn run<const N: usize>(config: &Config, robot: &Robot<N>, mut run: LockstepRun<N>) {
    // The mission may allocate; for a plan it does, elsewhere it does not.
    let plans = config.task == Task::CalibrateHandEye;
    for k in 0..2500_i64 {
        let now = MonoNs(k * MS);
        let joint = run.sense(k as u64, now);
        let q = SVector::<f64, N>::from_fn(|i, _| joint.q[i]);
        let X_CO = config.camera.mount.X_WC(robot, &q).inv_mul(&config.X_WO().unwrap());
        let m = match k % 80 {
            0 if k < 700 || plans => Some(seen(config, k, &X_CO)),
            0 => Some(hide(seen(config, k, &X_CO), (k / 80 % 3) as usize)),
            40 if k < 500 => Some(Measurement { exposure: now, ..Measurement::default() }),
            // A view far off: the limits act.
            40 => Some(seen(config, k, &Pose::translation(0.3, -0.2, 0.3))),
            // Of a second camera, until its target is lost.
            20 | 60 if k < 1200 => config.second_view.as_ref().map(|second| {
                let cell = &second.cell;
                let X_CO = cell.camera.mount.X_WC(robot, &q).inv_mul(&cell.X_WO().unwrap());
                Measurement { camera: cell.camera.id.into(), ..seen(cell, k, &X_CO) }
            }),
            _ => None,
        };
        // What clients ask for is planned elsewhere, and obeyed here.
        if let Some((request, command)) = asked(k, config, &q).filter(|_| !plans)
            && let Ok(order) = run.mission.plan(k as u64, request, &command)
        {
            assert_no_alloc(|| {
                let _ = run.control.request_with(request, order.as_ref()); // in a fault it is refused
            });
        }
        if k == 2300 {
            run.stop("the test asks for it");
        }
        if plans {
            let mut trace = assert_no_alloc(|| run.control.act(now, m.as_ref()));
            run.mission.note(&mut trace, m.as_ref());
            while let Some(order) = run.mission.next_order() {
                assert_no_alloc(|| run.control.obey(&order));
            }
        } else {
            assert_no_alloc(|| run.act(now, m.as_ref()));
        }
    }
    assert!(!plans || run.state() == ControlState::Stopped, "{:?}", run.state());
}

/// What a client asks for at tick `k`.
fn asked<const N: usize>(k: i64, config: &Config, q: &SVector<f64, N>) -> Option<(Request, ControlCommand)> {
    let numbers = |request: Request, form, numbers: &[f64]| {
        ControlCommand::with_numbers(request as u32, form, numbers).map(|command| (request, command))
    };
    match k {
        1500 => numbers(Request::Set, CommandForm::Gain, &[1.5]),
        1550 => {
            let X_DO = config.set_point.X_DO()?;
            let (p, r) = (X_DO.translation.vector, X_DO.rotation.coords);
            numbers(Request::Goal, CommandForm::Pose, &[p.x, p.y, p.z + 0.01, r.x, r.y, r.z, r.w])
        }
        1700 => numbers(Request::Goto, CommandForm::Joints, (q * 0.99).as_slice()),
        1750 => numbers(Request::Jog, CommandForm::Joints, &[0.01; N]),
        2200 => Some((Request::Start, ControlCommand::of(Request::Start as u32))),
        _ => None,
    }
}

const MATRIX_OF_FOUR: &str =
    "servo.gain_1_s=[[2, 0.5, 0, 0], [0.5, 2, 0, 0], [0, 0, 1, 0.1], [0, 0, 0.1, 1]]";

/// A table, a box about the arms, and speeds.
const LIMITS_IN_SPACE: [&str; 4] = [
    "workspace.camera_speed_m_s=0.2",
    "workspace.self_collision=true",
    "workspace.planes=[{ point_m = [0.0, 0.0, -0.3], normal = [0.0, 0.0, 1.0] }]",
    "workspace.boxes=[{ min_m = [-2.0, -2.0, -2.0], max_m = [2.0, 2.0, 2.0] }]",
];

#[test]
fn no_tick_allocates() {
    let config_of = |file: &str, set: &[&str]| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
        let set: Vec<String> = set.iter().map(ToString::to_string).collect();
        // Forty of them do not fit on the stack of a test.
        Box::new(Config::load(Some(&path), &set).unwrap())
    };
    for config in [
        config_of("default.toml", &[]),
        config_of("default.toml", &["motion.controller=pd_gravity", "servo.update=frame"]),
        config_of("scara-a.toml", &[]),
        config_of("scara-a.toml", &["servo.pd.damping=joints", "servo.orientation_error=angle_axis"]),
        config_of("scara-b.toml", &["servo.smooth_start_1_s=3"]),
        config_of("scara-c.toml", &["servo.update=tick"]),
        config_of(
            "scara-c.toml",
            &["servo.pd.feature_gain=matrix", "servo.pd.feature_stiffness_nm=[300, 200, 300, 200]"],
        ),
        config_of(
            "scara-d.toml",
            &["servo.segments=[[3, 4]]", "servo.interaction=mean", "servo.depth=known"],
        ),
        config_of("scara-d.toml", &["servo.set_point.kind=taught"]),
        config_of("scara-hybrid.toml", &["servo.depth=initial"]),
        config_of("scara-eye-to-hand.toml", &[]),
        config_of("ur5-b.toml", &[]),
        config_of("scara-b.toml", &[MATRIX_OF_FOUR]),
        config_of("scara-d.toml", &[MATRIX_OF_FOUR]),
        config_of("ur5-hybrid.toml", &["servo.adaptive_gain.at_zero=2"]),
        config_of("panda.toml", &["servo.limit_avoidance_1_s=0.5"]),
        config_of("ur5.toml", &["servo.update=predict"]),
        config_of("ur5.toml", &["drive.mode=velocity", "motion.controller=pass_through"]),
        config_of("panda.toml", &["drive.kind=ideal"]),
        config_of("pan_tilt.toml", &[]),
        config_of("panda.toml", &["motion.controller=operational_space"]),
        config_of("pan_tilt.toml", &["motion.controller=operational_space"]),
        config_of("default.toml", &["run.task=calibrate_latency"]),
        config_of("panda.toml", &["run.task=calibrate_latency"]),
        config_of("ur5.toml", &["run.task=calibrate_hand_eye"]),
        config_of("default.toml", &["servo.object.moves=true"]),
        config_of("ur5.toml", &["servo.return_to_last_seen=true"]),
        config_of("ur5-path.toml", &[]),
        config_of("ur5-two-cameras.toml", &[]),
        config_of("ur5.toml", &LIMITS_IN_SPACE),
        config_of(
            "panda.toml",
            &[&LIMITS_IN_SPACE[..], &["drive.mode=position", "motion.controller=pass_through"]].concat(),
        ),
        config_of("ur5-path.toml", &["servo.scheme=hybrid"]),
        config_of("stereo.toml", &[]),
        config_of("shape-moments.toml", &[]),
        config_of("shape.toml", &["servo.area=area"]),
        config_of("dot-grid.toml", &[]),
    ] {
        vservo::dispatch_robot!(config.robot, |robot| {
            let copy = robot.clone();
            run(&config, &copy, assemble::control_loop(&config, robot).unwrap());
        })
        .unwrap();
    }
}

/// The learner's motions, its filter and the law with what it has learnt.
#[test]
fn learning_the_image_jacobian_allocates_nothing() {
    for file in ["ur5.toml", "dot-grid.toml"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
        let set = ["servo.interaction=estimated", "servo.gain_1_s=2", "servo.set_point.kind=taught"];
        let config = Config::load(Some(&path), &set.map(str::to_owned)).unwrap();
        vservo::dispatch_robot!(config.robot, |robot| {
            let copy = robot.clone();
            learn(&config, &copy, assemble::control_loop(&config, robot).unwrap());
        })
        .unwrap();
    }
}

fn learn<const N: usize>(config: &Config, robot: &Robot<N>, mut run: LockstepRun<N>) {
    let mut moved = 0.0_f64;
    for k in 0..5000_i64 {
        let now = MonoNs(k * MS);
        let joint = run.sense(k as u64, now);
        let q = SVector::<f64, N>::from_fn(|i, _| joint.q[i]);
        moved = moved.max((0..N).map(|i| (q[i] - config.start.q[i]).abs()).fold(0.0, f64::max));
        let X_CO = config.camera.mount.X_WC(robot, &q).inv_mul(&config.X_WO().unwrap());
        let m = (k % 40 == 0).then(|| seen(config, k, &X_CO));
        assert_no_alloc(|| run.act(now, m.as_ref()));
    }
    assert!((1e-3..0.1).contains(&moved), "{moved}: it moves to learn, about where it is");
}

/// A drive that reports nonsense after a while.
struct Broken(u32);

impl<const N: usize> Drive<N> for Broken {
    fn read(&mut self, _now: MonoNs) -> DriveState<N> {
        self.0 += 1;
        let q = SVector::repeat(if self.0 > 100 { f64::NAN } else { 0.5 });
        DriveState { q, qd: SVector::zeros(), truth: None }
    }

    fn write(&mut self, _command: &DriveCommand<N>) {}

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }
}

#[test]
fn no_fault_allocates() {
    let config = Config::load(None, &[]).unwrap();
    vservo::dispatch_robot!(config.robot, |robot| {
        let mut control = assemble::control_loop_with(&config, robot, Box::new(Broken(0))).unwrap();
        let mut finished = false;
        for k in 0..300_i64 {
            let record = assert_no_alloc(|| control.tick(k as u64, MonoNs(k * MS), None));
            finished |= record.finish.is_some();
        }
        assert!(finished, "a drive that reports nonsense ends the run");
    })
    .unwrap();
}
