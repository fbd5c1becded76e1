//! Closed loops without vision and drives: every velocity law, both mounts, every update policy.

use super::square;
use crate::geometry::Pose;
use crate::messages::Measurement;
use crate::robot::{Mount, Robot};
use crate::servo::*;
use crate::sim::perfect_measurement;
use crate::time::MonoNs;
use nalgebra::{SVector, Vector3, Vector4, Vector6};
use proptest::prelude::*;

const MS: i64 = 1_000_000;
/// 25 Hz and 20 ms from exposure to use.
const FRAME_TICKS: i64 = 40;
const LATENCY_TICKS: i64 = 20;

/// An arm whose joints move as they are told, and a camera without noise.
struct SimulatedLoop<const N: usize> {
    robot: Robot<N>,
    servo: VisualServo<N>,
    X_WO: Pose,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    tick: i64,
    exposed: Option<Measurement>,
}

impl<const N: usize> SimulatedLoop<N> {
    /// The arm shall come from `q` to `q_d`, where the object lies at `X_DO` in the camera; `moved` places the camera.
    fn new(
        name: &str,
        q: SVector<f64, N>,
        q_d: SVector<f64, N>,
        X_DO: &Pose,
        moved: &Pose,
        hand: bool,
    ) -> Self {
        let robot = crate::robot::load(name).unwrap().build::<N>().unwrap();
        let mount = if hand {
            Mount::EyeInHand { X_EC: *moved }
        } else {
            Mount::EyeToHand { X_BC: robot.forward(&q_d) * moved }
        };
        let X_WO = mount.X_WC(&robot, &q_d) * X_DO;
        let set_point = SetPoint::from_pose(X_DO, &square()).unwrap();
        let law = Law::ImageVelocity {
            K_s: 1.0.into(),
            gain: Gain::Constant(1.0),
            interaction: Interaction::TEXTBOOK,
        };
        let settings = ServoSettings::new(law, UpdatePolicy::Predict, mount);
        let servo = VisualServo::new(settings, set_point);
        Self { robot, servo, X_WO, q, qd: SVector::zeros(), tick: 0, exposed: None }
    }

    fn with(mut self, change: impl FnOnce(&mut ServoSettings)) -> Self {
        let mut settings = self.servo.settings().clone();
        settings.X_WO = vec![self.X_WO];
        change(&mut settings);
        self.servo = VisualServo::new(settings, self.servo.set_point().clone());
        self
    }

    fn X_CO(&self) -> Pose {
        self.servo.settings().mount.X_WC(&self.robot, &self.q).inv_mul(&self.X_WO)
    }

    fn error(&self) -> f64 {
        self.servo.set_point().error_rms_px_at(&self.X_CO(), &nalgebra::Vector2::new(1.0, 1.0))
    }

    fn look(&self) -> Measurement {
        perfect_measurement(&square(), &self.X_CO(), MonoNs(self.tick * MS)).unwrap()
    }

    fn step(&mut self) -> SVector<f64, N> {
        let now = MonoNs(self.tick * MS);
        self.servo.note_arm(now, &self.q, &self.qd);
        if self.tick % FRAME_TICKS == 0 {
            self.exposed = Some(self.look());
        }
        if self.tick % FRAME_TICKS == LATENCY_TICKS
            && let Some(m) = self.exposed.take()
        {
            assert!(self.servo.add_measurement(now, &m, &self.robot).is_used());
        }
        self.qd = match self.servo.law_output(&self.q, &self.qd, &self.robot) {
            Some(LawOutput::Velocity(qd)) => qd,
            Some(LawOutput::Torque(_)) => panic!("a velocity law"),
            None => SVector::zeros(),
        };
        self.q += self.qd * 1e-3;
        self.tick += 1;
        self.qd
    }
}

fn laws() -> [Law; 7] {
    let gain = Gain::Constant(2.0);
    let K = PoseGains::repeat(1.0);
    let gains = HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(1.0).into() };
    let space = OperationalSpace::Six;
    let image =
        |at, depth| Law::ImageVelocity { K_s: 1.0.into(), gain, interaction: Interaction { at, depth } };
    [
        Law::PositionVelocity {
            K,
            gain,
            orientation: OrientationError::EulerZyx,
            space,
            weights: TwistWeights::Unit,
        },
        Law::PositionVelocity {
            K,
            gain,
            orientation: OrientationError::AngleAxis,
            space,
            weights: TwistWeights::Unit,
        },
        image(InteractionAt::Current, DepthSource::Desired),
        image(InteractionAt::Mean, DepthSource::Estimated),
        image(InteractionAt::Desired, DepthSource::Known),
        Law::Hybrid {
            gains,
            gain,
            orientation: OrientationError::EulerZyx,
            space,
            depth: DepthSource::Desired,
        },
        Law::Hybrid {
            gains,
            gain,
            orientation: OrientationError::AngleAxis,
            space,
            depth: DepthSource::Constant(0.5),
        },
    ]
}

const POLICIES: [UpdatePolicy; 3] = [UpdatePolicy::Frame, UpdatePolicy::Tick, UpdatePolicy::Predict];

fn converges<const N: usize>(make: impl Fn() -> SimulatedLoop<N>) -> Result<(), TestCaseError> {
    for law in laws() {
        for update in POLICIES {
            let mut run = make().with(|s| (s.law, s.update) = (law.clone(), update));
            let start = run.error();
            for _ in 0..8000 {
                run.step();
            }
            prop_assert!(run.error() < 1e-4 * start + 1e-9, "{law:?} {update:?}: {start} -> {}", run.error());
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    #[test]
    fn six_joints_converge(
        dq in prop::array::uniform6(-0.12..0.12f64), tilt in prop::array::uniform3(-0.3..0.3f64), hand in any::<bool>()
    ) {
        let q_d = Vector6::new(0.46, -1.72, 1.45, -1.28, -1.82, 0.97);
        let X_DO = Pose::new([-0.05, -0.05, 0.5].into(), tilt.into());
        // A tilted goal tells the two readings of a homography apart.
        prop_assume!(Vector3::from(tilt).xy().norm() > 0.1);
        let moved = Pose::new([0.02, -0.03, 0.05].into(), [0.1, -0.2, 0.4].into());
        converges(|| SimulatedLoop::new("ur5", q_d + Vector6::from(dq), q_d, &X_DO, &moved, hand))?;
    }

    #[test]
    fn four_joints_converge(dq in prop::array::uniform4(-0.15..0.15f64), hand in any::<bool>()) {
        let q_d = Vector4::new(0.1, 1.5, 0.4, -0.7);
        let X_DO = Pose::new([-0.05, -0.04, 0.6].into(), [0.2, 0.1, -0.5].into());
        let moved = Pose::new([0.02, -0.03, 0.05].into(), [0.0, 0.1, 0.4].into());
        converges(|| SimulatedLoop::new("scara", q_d + Vector4::from(dq), q_d, &X_DO, &moved, hand))?;
    }
}

fn scara() -> SimulatedLoop<4> {
    let q_d = Vector4::new(0.1, 1.5, 0.4, -0.7);
    let q = q_d + Vector4::new(0.08, -0.1, 0.1, 0.3);
    let X_DO = Pose::new([-0.05, -0.04, 0.6].into(), [0.0, 0.0, -0.5].into());
    SimulatedLoop::new("scara", q, q_d, &X_DO, &Pose::identity(), true)
}

#[test]
fn a_smooth_start_has_no_jump_and_ends_as_well() {
    let mut smooth = scara().with(|s| s.smooth_start_1_s = Some(4.0));
    let (mut last, mut largest_change) = (Vector4::zeros(), 0.0_f64);
    for _ in 0..8000 {
        let qd = smooth.step();
        largest_change = largest_change.max((qd - last).norm());
        last = qd;
    }
    assert!(smooth.error() < 1e-3, "{}", smooth.error());
    let mut plain = scara();
    let first = (0..=LATENCY_TICKS).map(|_| plain.step()).last().unwrap();
    assert!(largest_change < 0.02 * first.norm(), "{largest_change} {first}");
    // After a hold the start is smooth again.
    smooth.q += Vector4::new(0.1, 0.1, 0.0, 0.1);
    smooth.servo.restart();
    smooth.tick = (smooth.tick / FRAME_TICKS + 1) * FRAME_TICKS;
    assert!(smooth.step().norm() < 1e-3);
}

#[test]
fn an_adaptive_gain_ends_faster() {
    let settled = |gain| {
        let interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };
        let mut run = scara().with(|s| s.law = Law::ImageVelocity { K_s: 1.0.into(), gain, interaction });
        (0..20_000).find(|_| run.step() != Vector4::zeros() && run.error() < 1e-5).unwrap()
    };
    let adaptive = Gain::Adaptive { at_zero_1_s: 4.0, at_infinity_1_s: 1.0, slope_1_s: 20.0 };
    assert!(settled(adaptive) * 2 < settled(Gain::Constant(1.0)));
}

#[test]
fn a_new_goal_is_sought_also_by_what_was_measured_before() {
    let mut run = scara();
    for _ in 0..100 {
        run.step();
    }
    let elsewhere = Pose::translation(0.02, 0.0, 0.0) * run.X_CO();
    let goal = SetPoint::from_pose(&elsewhere, run.servo.set_point().points()).unwrap();
    let (robot, q) = (run.robot.clone(), run.q);
    let wish = |run: &mut SimulatedLoop<4>| run.servo.law_output(&q, &Vector4::zeros(), &robot).unwrap();
    let before = wish(&mut run);
    run.servo.set_goal(goal);
    assert_ne!(wish(&mut run), before, "without another measurement");
    for _ in 0..10_000 {
        run.step();
    }
    assert!(run.error() < 1e-4);
    assert!((run.X_CO().translation.vector - elsewhere.translation.vector).norm() < 1e-4);
}

#[test]
fn joints_leave_their_limits_where_the_task_lets_them() {
    let q_d = SVector::<f64, 7>::from([-0.16, -0.52, -0.14, -2.11, 0.09, 1.79, 2.4]);
    let X_DO = Pose::new([-0.05, -0.05, 0.4].into(), [0.0, 0.0, 0.3].into());
    let start = || SimulatedLoop::new("panda", q_d, q_d, &X_DO, &Pose::identity(), true);
    let end = |mut run: SimulatedLoop<7>| {
        for _ in 0..6000 {
            run.step();
        }
        assert!(run.error() < 1e-4, "the camera stays: {}", run.error());
        run.q[6]
    };
    let free = end(start().with(|s| s.limit_avoidance_1_s = Some(1.0)));
    assert!(free < end(start()) - 0.02, "{free}");
}

/// Without an arm the law speaks to whoever holds the camera: obeyed, that brings it to its goal.
#[test]
fn a_hand_that_obeys_the_camera_request_reaches_the_goal() {
    let law_of_a_hand = |law: &Law| {
        !matches!(law, Law::ImageVelocity { interaction: Interaction { depth: DepthSource::Known, .. }, .. })
    };
    for law in laws().into_iter().filter(law_of_a_hand) {
        let SimulatedLoop { servo, robot, q, .. } = scara();
        let settings = ServoSettings { law: law.clone(), X_WO: Vec::new(), ..servo.settings().clone() };
        let mut servo = VisualServo::new(settings, servo.set_point().clone());
        assert_eq!(servo.camera_law_output(), None, "nothing was seen");
        let mut X_CO = Pose::new([-0.05, 0.08, 0.75].into(), [0.1, -0.15, -0.6].into());
        let error = |X_CO: &Pose, servo: &VisualServo<4>| {
            servo.set_point().error_rms_px_at(X_CO, &nalgebra::Vector2::new(1.0, 1.0))
        };
        let start = error(&X_CO, &servo);
        for frame in 1..300 {
            let now = MonoNs(frame * FRAME_TICKS * MS);
            servo.note_arm(now, &q, &Vector4::zeros());
            let seen = perfect_measurement(&square(), &X_CO, now).unwrap();
            assert!(servo.add_measurement(now, &seen, &robot).is_used());
            let step = servo.camera_law_output().unwrap() * (FRAME_TICKS as f64 * 1e-3);
            let moved = Pose::new(step.fixed_rows::<3>(0).into(), step.fixed_rows::<3>(3).into());
            X_CO = moved.inv_mul(&X_CO);
        }
        assert!(error(&X_CO, &servo) < 1e-4 * start, "{law:?}: {start} -> {}", error(&X_CO, &servo));
    }
}
