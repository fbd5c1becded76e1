//! Servo law and controller step; medians by divan, tails over single calls at the end. Goals of the design: servo law
//! for 4 / 16 points 0.16 / 0.31 us, whole step with 6 joints and 4 points p50 3 us, p99 5 us.

#![allow(non_snake_case, clippy::unwrap_used)] // a bench that cannot be set up should say so at once

use divan::{Bencher, black_box};
use nalgebra::{Matrix6, Point3, SVector, Vector2, Vector3, Vector6};
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::control::behaviour::{ArmModel, Behaviour, Servoing};
use vservo::control::controller::{ControlOutput, Controller, ControllerSettings};
use vservo::control::lifecycle::Request;
use vservo::control::safety::MeasurementWatch;
use vservo::drive::{CommandMode, DriveState};
use vservo::geometry::Pose;
use vservo::messages::{MAX_JOINTS, Measurement};
use vservo::motion::{
    HalfSpace, InverseDynamicsControl, JointController, JointLaw, MotionLimits, ObserverSettings, Reference,
    Workspace, WorkspaceSettings, damp_singularity,
};
use vservo::robot::{CameraJacobian, ExpressedIn, Mount, load};
use vservo::servo::{
    DepthSource, Gain, Interaction, InteractionAt, Law, ServoSettings, SetPoint, UpdatePolicy, View,
    VisibilityGuard, VisualServo, image_task, joint_velocity,
};
use vservo::sim::perfect_measurement;
use vservo::time::{MonoNs, SpanNs};

const MS: i64 = 1_000_000;
const ESTIMATED: Interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };

fn main() {
    divan::main();
    tails();
}

fn points(count: usize) -> Vec<Point3<f64>> {
    let side = (count as f64).sqrt().round() as usize;
    let at = |i: usize| 0.1 * i as f64 / (side - 1) as f64;
    (0..count).map(|i| Point3::new(at(i % side), at(i / side), 0.0)).collect()
}

fn goal() -> Pose {
    Pose::new([-0.05, -0.05, 0.4].into(), [0.0, 0.0, 0.3].into())
}

fn X_EC() -> Pose {
    Pose::translation(0.0, 0.0, 0.05)
}

fn view(X_CO: &Pose, points: &[Point3<f64>]) -> View {
    let s: Vec<_> = points.iter().map(|p| X_CO * p).map(|p| Vector2::new(p.x / p.z, p.y / p.z)).collect();
    View::new(s.into_iter(), Some(*X_CO)).unwrap()
}

/// Task and camera twist, six free directions.
#[divan::bench(args = [4, 16])]
fn servo_law(bencher: Bencher, count: usize) {
    let points = points(count);
    let set_point = SetPoint::from_pose(&goal(), &points).unwrap();
    let near = Pose::new([0.02, -0.01, 0.05].into(), [0.1, -0.1, 0.2].into()) * goal();
    let view = view(&near, &points);
    let J = CameraJacobian::of_moving_camera(Matrix6::identity());
    bencher.bench_local(|| {
        let task = image_task(black_box(&set_point), black_box(&view), ESTIMATED).unwrap();
        joint_velocity(&task, 1.0, black_box(&J))
    });
}

/// A controller in steady servoing: a measurement every 40 ticks.
struct Running<const N: usize> {
    controller: Controller<N>,
    limits: MotionLimits<N>,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    X_BO: Pose,
    tick: i64,
}

impl<const N: usize> Running<N> {
    fn new(name: &str, q: SVector<f64, N>, update: UpdatePolicy) -> Self {
        Self::within(name, q, update, None)
    }

    fn within(
        name: &str,
        q: SVector<f64, N>,
        update: UpdatePolicy,
        space: Option<WorkspaceSettings>,
    ) -> Self {
        let robot = load(name).unwrap().build::<N>().unwrap();
        let X_EC = X_EC();
        let near = Pose::new([0.02, -0.01, 0.05].into(), [0.05, -0.05, 0.2].into()) * goal();
        let X_BO = robot.forward(&q) * X_EC * near;
        let limits = MotionLimits::of(&robot, SVector::repeat(10.0), SVector::repeat(500.0));
        let set_point = SetPoint::from_pose(&goal(), &points(4)).unwrap();
        let law = Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction: ESTIMATED };
        let mount = Mount::EyeInHand { X_EC };
        let lens = Intrinsics {
            fx_px: 800.0,
            fy_px: 800.0,
            cx_px: 319.5,
            cy_px: 239.5,
            width_px: 640,
            height_px: 480,
        };
        let distortion = Distortion { k1: -0.15, k2: 0.05, ..Distortion::default() };
        let guard = VisibilityGuard {
            camera: CameraModel::new(lens, distortion).unwrap(),
            margin_px: 10.0,
            mark_radius_m: 0.015,
            rate_1_s: 5.0,
            acceleration: [10.0; MAX_JOINTS],
        };
        let servo = ServoSettings { visibility: Some(guard), ..ServoSettings::new(law, update, mount) };
        let servo = VisualServo::new(servo, set_point);
        let watch = MeasurementWatch::new(SpanNs(200 * MS), 0.75);
        let observer = ObserverSettings {
            disturbance_rad_s: 10.0,
            velocity_rad_s: 150.0,
            encoder_step: SVector::repeat(1e-5),
            encoder_noise: SVector::zeros(),
            max_acceleration: ObserverSettings::bound(&robot, &q),
            inertia: ObserverSettings::free_inertia(&robot, &q),
        };
        let joint_control =
            JointController::new(JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0)), observer);
        let arm = ArmModel { robot, limits: limits.clone() };
        let settings = ControllerSettings {
            space,
            ..ControllerSettings::new(arm, joint_control, CommandMode::Torque, q)
        };
        let mut controller = Controller::new(settings, servo, Behaviour::Servoing(Servoing::new(watch)));
        controller.request(Request::Start).unwrap();
        Self { controller, limits, q, qd: SVector::zeros(), X_BO, tick: 0 }
    }

    /// The measurement of this tick, where there is one.
    fn look(&self) -> Option<Measurement> {
        if self.tick % 40 != 0 {
            return None;
        }
        let X_WC = self.controller.arm().robot.forward(&self.q) * X_EC();
        let X_CO = X_WC.inv_mul(&self.X_BO);
        perfect_measurement(&points(4), &X_CO, MonoNs(self.tick * MS))
    }

    fn step(&mut self, m: Option<&Measurement>) -> ControlOutput<N> {
        let state = DriveState { q: self.q, qd: self.qd, truth: None };
        self.controller.step(MonoNs(self.tick * MS), black_box(&state), black_box(m))
    }

    /// The arm is its model: one that did anything else would be braked, and the bench would measure braking.
    fn apply(&mut self, out: &ControlOutput<N>) {
        assert!(out.fault.is_none(), "{:?} at tick {}", out.fault, self.tick);
        let h = 1e-3;
        let qdd = self.controller.arm().robot.forward_dynamics(&self.q, &self.qd, &out.command.tau);
        self.q += self.qd * h + qdd * (0.5 * h * h);
        self.qd += qdd * h;
        self.tick += 1;
    }
}

fn ur5(update: UpdatePolicy) -> Running<6> {
    Running::new("ur5", UR5, update)
}

/// A box of two metres and a table `below_m` under the camera of [`ur5`], for all links, with a speed of the camera.
fn space(below_m: f64, self_collision: bool) -> WorkspaceSettings {
    let camera = load("ur5").unwrap().build::<6>().unwrap().forward(&UR5) * X_EC();
    let side = |normal: Vector3<f64>, offset_m| HalfSpace { name: String::new(), normal, offset_m };
    let mut sides = vec![side(Vector3::z(), camera.translation.z - 0.04 - 0.01 - below_m)];
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        sides.extend([side(axis, -2.0), side(-axis, -2.0)]);
    }
    WorkspaceSettings {
        camera_speed_m_s: 0.25,
        camera_turn_rad_s: f64::INFINITY,
        flange_speed_m_s: f64::INFINITY,
        margin_m: 0.01,
        sides,
        link_radius_m: vec![0.06; 6],
        camera: Some((X_EC().translation.vector, 0.04)),
        tool: None,
        self_collision,
    }
}

const UR5: Vector6<f64> = Vector6::new(0.46, -1.72, 1.45, -1.28, -1.82, 0.97);

fn panda(update: UpdatePolicy) -> Running<7> {
    Running::new("panda", SVector::from([-0.16, -0.52, -0.14, -2.11, 0.09, 1.79, 0.21]), update)
}

fn scara(update: UpdatePolicy) -> Running<4> {
    Running::new("scara", SVector::from([0.0, 1.57, 0.5, -0.79]), update)
}

/// The reference of 7 joints; free, and pressed against the ends of its ranges.
#[divan::bench(args = [0.05, 5.0])]
fn reference_7_joints(bencher: Bencher, speed: f64) {
    let panda = panda(UpdatePolicy::Tick);
    let mut reference = Reference::new(panda.limits.clone(), panda.q);
    let mut tick = 0.0;
    bencher.bench_local(|| {
        tick += 1e-3;
        let requested_qd = SVector::<f64, 7>::from_fn(|i, _| speed * (1.0 + 0.1 * f64::sin(tick + i as f64)));
        *reference.advance(black_box(&requested_qd), SpanNs::MILLISECOND)
    });
}

/// The reference of 6 joints that moves to and fro within limits in space: a table that is far, one that the camera comes to, and the same with the arm before itself; `none`: without them.
#[divan::bench(args = ["none", "far", "near", "near_and_itself"])]
fn reference_6_joints_in_space(bencher: Bencher, which: &str) {
    let ur5 = ur5(UpdatePolicy::Tick);
    let mut reference = Reference::new(ur5.limits.clone(), ur5.q);
    if which != "none" {
        let settings = space(if which == "far" { 0.5 } else { 0.02 }, which == "near_and_itself");
        reference = reference.within(Workspace::new(ur5.controller.arm().robot.clone(), settings));
    }
    let mut tick = 0.0;
    bencher.bench_local(|| {
        tick += 1e-3;
        let requested_qd = Vector6::from_fn(|i, _| 0.2 * f64::sin(tick + 0.3 * i as f64));
        *reference.advance(black_box(&requested_qd), SpanNs::MILLISECOND)
    });
}

#[divan::bench]
fn damp_singularity_6_joints(bencher: Bencher) {
    let ur5 = ur5(UpdatePolicy::Tick);
    let robot = ur5.controller.arm().robot.clone();
    let X_EC = Pose::translation(0.0, 0.0, 0.05);
    let J_C = robot.jacobian_of_frame(&ur5.q, &X_EC, ExpressedIn::Moving);
    let requested_qd = Vector6::repeat(0.1);
    bencher.bench_local(|| {
        damp_singularity(
            black_box(&robot),
            &ur5.q,
            black_box(&J_C),
            black_box(&requested_qd),
            &Vector6::zeros(),
        )
    });
}

/// Single steps, timed one by one: p50 and p99 are what a control cycle sees. The clock's own cost is in them.
#[allow(clippy::disallowed_methods, clippy::print_stdout)] // a bench measures time and prints it
fn tails() {
    fn measure<const N: usize>(name: &str, mut running: Running<N>) {
        let mut seeing = Vec::new();
        let mut ns: Vec<u128> = (0..60_000)
            .map(|_| {
                let m = running.look();
                let start = std::time::Instant::now();
                let out = running.step(m.as_ref());
                let took = start.elapsed().as_nanos();
                running.apply(&out);
                seeing.extend(m.map(|_| took));
                took
            })
            .collect();
        ns.sort_unstable();
        seeing.sort_unstable();
        let with_measurement = seeing[seeing.len() / 2] as f64 / 1e3;
        let at = |share: f64| ns[((ns.len() - 1) as f64 * share) as usize] as f64 / 1e3;
        println!(
            "step {name:6} p50 {:6.2} us  p99 {:6.2} us  p99.9 {:6.2} us  with a measurement p50 {with_measurement:6.2} us",
            at(0.5),
            at(0.99),
            at(0.999)
        );
    }
    measure("scara", scara(UpdatePolicy::Predict));
    measure("ur5", ur5(UpdatePolicy::Predict));
    measure("panda", panda(UpdatePolicy::Predict));
    let within = |below_m| Running::within("ur5", UR5, UpdatePolicy::Predict, Some(space(below_m, false)));
    measure("ur5 in space, far", within(0.5));
    measure("ur5 in space, near", within(0.02));
}
