use super::*;
use crate::drive::{Drive, DriveCommand, EncoderModel, SimulatedDrive, SimulatedDriveSettings};
use crate::motion::{ActingLimits, MotionLimits, Reference};
use crate::robot::{Friction, Inertia};
use crate::time::MonoNs;
use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;

type ArmSettings<const N: usize> = SimulatedDriveSettings<N>;

fn at_rest<const N: usize>(q: SVector<f64, N>) -> ReferenceState<N> {
    let zero = SVector::zeros();
    ReferenceState { q, qd: zero, qdd: zero, a: zero, limits: ActingLimits::default() }
}

fn robot<const N: usize>(name: &str) -> Robot<N> {
    crate::robot::load(name).unwrap().build().unwrap()
}

fn inverse_dynamics<const N: usize>() -> JointLaw<N> {
    JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0))
}

fn pd<const N: usize>(robot: &Robot<N>, q: &SVector<f64, N>) -> JointLaw<N> {
    JointLaw::PdGravity(PdGravityControl::for_posture(robot, q, 40.0, 1.0))
}

fn observing<const N: usize>(robot: &Robot<N>, q: &SVector<f64, N>) -> ObserverSettings<N> {
    let max_acceleration = ObserverSettings::bound(robot, q);
    ObserverSettings { disturbance_rad_s: 10.0, max_acceleration, ..ObserverSettings::none() }
}

/// The same arm with its friction times `scale`.
fn rubbing<const N: usize>(robot: &Robot<N>, scale: f64) -> Robot<N> {
    let friction =
        robot.friction().map(|f| Friction { viscous: f.viscous * scale, coulomb: f.coulomb * scale });
    robot.clone().with_friction(friction)
}

/// What a tick of [`follow`] was like.
struct Tick<'a, const N: usize> {
    ms: i64,
    /// True position and velocity.
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    reference: &'a ReferenceState<N>,
    control: &'a JointController<N>,
}

fn posture<const N: usize>() -> SVector<f64, N> {
    SVector::from_fn(|i, _| [-0.17, -0.48, -0.2, 1.53, 0.08, 1.8, 0.17][i])
}

/// Lets an arm follow a reference whose joints go to and fro for 2 s and then rest for 1 s.
fn follow<const N: usize>(
    robot: &Robot<N>,
    mut control: JointController<N>,
    arm: ArmSettings<N>,
    see: &mut dyn FnMut(&Tick<'_, N>),
) {
    let q = posture();
    let limits = MotionLimits {
        lower: SVector::repeat(-6.0),
        upper: SVector::repeat(6.0),
        velocity: SVector::repeat(1.0),
        acceleration: SVector::repeat(10.0),
        jerk: SVector::repeat(500.0),
    };
    let mut reference = Reference::new(limits, q);
    let mut drive = SimulatedDrive::new(robot.clone(), q, arm).unwrap();
    for ms in 0..3000 {
        let state = drive.read(MonoNs(ms * 1_000_000));
        let t = ms as f64 * 1e-3;
        let speed = if ms < 2000 { 0.4 * (2.0 * std::f64::consts::PI * t).sin() } else { 0.0 };
        let before = *reference.state();
        let after = *reference.advance(&SVector::repeat(speed), TICK);
        let now = ReferenceState { q: before.q, qd: before.qd, ..after };
        let (q, qd) = control.observe(robot, &state.q, &state.qd);
        let torque = control.torque(robot, &q, &qd, &now);
        drive.write(&DriveCommand { tau: torque.tau, q_r: after.q, qd_r: after.qd, qdd_r: after.a });
        let (q, qd) = state.truth.unwrap();
        see(&Tick { ms, q, qd, reference: &now, control: &control });
    }
}

/// Largest distances from the reference: on the way, and in the last 0.2 s, where it rests.
fn distances<const N: usize>(
    robot: &Robot<N>,
    control: JointController<N>,
    arm: ArmSettings<N>,
) -> (f64, f64) {
    let (mut moving, mut resting) = (0.0_f64, 0.0_f64);
    follow(robot, control, arm, &mut |tick| {
        let e = (tick.reference.q - tick.q).amax();
        moving = moving.max(e);
        if tick.ms >= 2800 {
            resting = resting.max(e);
        }
    });
    (moving, resting)
}

proptest! {
    /// The closed loop of inverse dynamics: `qdd = qdd_r + K_D e' + K_P e`, whatever the posture and the speed.
    #[test]
    fn inverse_dynamics_makes_double_integrators(
        q in prop::array::uniform6(-1.5..1.5f64), qd in prop::array::uniform6(-0.5..0.5f64)
    ) {
        let (robot, q, qd) = (robot::<6>("ur5"), Vector6::from(q), Vector6::from(qd));
        let law = JointLaw::InverseDynamics(InverseDynamicsControl::new(20.0, 0.7));
        let tau = JointController::new(law, ObserverSettings::none())
            .torque(&robot, &q, &qd, &at_rest(q.add_scalar(1e-3))).tau;
        let mut drive = SimulatedDrive::new(robot, q, ArmSettings::default()).unwrap().with_velocity(qd);
        drive.read(MonoNs(0));
        drive.write(&DriveCommand { tau, q_r: q, qd_r: qd, qdd_r: Vector6::zeros() });
        let qdd = (drive.read(MonoNs(1_000_000)).qd - qd) * 1e3;
        let wanted = Vector6::repeat(400.0 * 1e-3) - qd * 28.0;
        prop_assert!((qdd - wanted).amax() < 1e-4 * (1.0 + wanted.amax()), "{qdd} {wanted}");
    }

    /// PD with gravity compensation brings a still arm to its reference without a lasting error.
    #[test]
    fn pd_holds_the_reference_against_gravity(q in prop::array::uniform6(-1.5..1.5f64)) {
        let (robot, q) = (robot::<6>("ur5"), Vector6::from(q));
        let law = JointLaw::PdGravity(PdGravityControl::for_posture(&robot, &q, 20.0, 1.0));
        let mut control = JointController::new(law, ObserverSettings::none());
        let reference = at_rest(q.add_scalar(0.01));
        let (mut at, mut v) = (q, Vector6::zeros());
        for _ in 0..4000 {
            let tau = control.torque(&robot, &at, &v, &reference).tau;
            v += robot.forward_dynamics(&at, &v, &tau) * 1e-3;
            at += v * 1e-3;
        }
        prop_assert!((at - reference.q).amax() < 1e-4, "{}", at - reference.q);
    }
}

#[test]
fn effort_limits_cut_and_tell_the_joint() {
    let robot = robot::<6>("ur5");
    let q = Vector6::new(0.0, -1.0, 1.0, 0.0, 0.0, 0.0);
    let far = at_rest(q + Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 100.0));
    let control =
        PdGravityControl { stiffness: Vector6::repeat(50.0), damping: Vector6::repeat(1.0), rate_1_s: 40.0 };
    let mut pd = JointController::new(JointLaw::PdGravity(control), ObserverSettings::none());
    let torque = pd.torque(&robot, &q, &Vector6::zeros(), &far);
    assert_eq!(torque.saturated, 0b10_0000);
    assert_eq!(torque.tau[5], robot.limits()[5].effort);
    let mut through = JointController::new(JointLaw::PassThrough, ObserverSettings::none());
    let torque = through.torque(&robot, &q, &Vector6::zeros(), &far);
    assert_eq!((torque.tau, torque.saturated), (Vector6::zeros(), 0));
}

/// PD control needs the torques for the acceleration of the reference too: without them the arm lags behind it, and the more the faster it
/// turns.
#[test]
fn every_law_follows_a_reference_that_accelerates() {
    let robot = robot::<7>("panda");
    for law in [inverse_dynamics(), pd(&robot, &posture())] {
        let (moving, resting) =
            distances(&robot, JointController::new(law, ObserverSettings::none()), ArmSettings::default());
        assert!(moving < 2e-4 && resting < 1e-6, "{law:?}: {moving:e} on the way, {resting:e} at rest");
    }
}

/// Hardly anything is learnt of an arm that agrees with its model, and it moves as it does without an observer.
#[test]
fn an_exact_model_leaves_nothing_to_learn() {
    let robot = robot::<7>("xarm7");
    for law in [inverse_dynamics(), pd(&robot, &posture())] {
        let mut way = Vec::new();
        let plain = JointController::new(law, ObserverSettings::none());
        follow(&robot, plain, ArmSettings::default(), &mut |tick| way.push(tick.q));
        let (mut off, mut learnt) = (0.0_f64, 0.0_f64);
        let mut next = way.iter();
        let observing = JointController::new(law, observing(&robot, &posture()));
        follow(&robot, observing, ArmSettings::default(), &mut |tick| {
            off = off.max((tick.q - next.next().unwrap()).amax());
            let (p, t) = tick.control.disturbance();
            learnt = learnt.max(p.amax()).max(t.amax());
        });
        // what is learnt at a reversal of a joint is forgotten while it moves on
        assert!(off < 2e-5 && learnt < 0.1, "{law:?}: {off:e} rad apart, {learnt:e} learnt");
    }
}

/// Friction, masses and load that the model does not know.
#[test]
fn what_the_model_does_not_know_is_learnt() {
    let robot = robot::<7>("xarm7");
    let payload = Inertia::point(3.0, Vector3::new(0.02, -0.02, 0.05));
    for law in [inverse_dynamics(), pd(&robot, &posture())] {
        for scale in [0.7, 1.0, 1.3] {
            let arm = || ArmSettings { arm: Some(rubbing(&robot, scale)), payload, ..ArmSettings::default() };
            let (_, without) = distances(&robot, JointController::new(law, ObserverSettings::none()), arm());
            let (moving, resting) =
                distances(&robot, JointController::new(law, observing(&robot, &posture())), arm());
            assert!(moving < 0.04, "{law:?}, friction x {scale}: {moving}");
            assert!(
                resting < 3e-3 && resting < 0.1 * without,
                "{law:?}, friction x {scale}: {resting} {without}"
            );
        }
    }
}

/// Encoders with steps: the arm neither oscillates nor drifts away.
#[test]
fn encoder_steps_do_not_shake_the_arm() {
    for step in [2e-4, 5e-4] {
        let robot = robot::<6>("ur5");
        let encoder =
            EncoderModel { step: SVector::repeat(step), velocity_filter_hz: 100.0, ..EncoderModel::exact() };
        let observer = ObserverSettings {
            velocity_rad_s: 400.0,
            encoder_step: encoder.step,
            encoder_noise: SVector::zeros(),
            ..observing(&robot, &posture())
        };
        let (mut before, mut squares, mut off) = (SVector::zeros(), 0.0, 0.0_f64);
        let control = JointController::new(inverse_dynamics(), observer);
        follow(&robot, control, ArmSettings { encoder, ..ArmSettings::default() }, &mut |tick| {
            if tick.ms >= 2500 {
                squares += ((tick.qd - before) * 1e3).norm_squared() / (6.0 * 500.0);
                off = off.max((tick.q - tick.reference.q).amax());
            }
            before = tick.qd;
        });
        let rms = squares.sqrt();
        assert!(rms < 0.1, "steps of {step}: {rms} rad/s2");
        assert!(off < 2.0 * step, "steps of {step}: {off} rad off");
    }
}

/// The gate holds the torque back that is asked for: the arm stands, and what it lags behind is no disturbance.
#[test]
fn torque_that_the_gate_cuts_leaves_nothing_to_learn() {
    let robot = robot::<6>("ur5");
    let q = posture();
    let learnt = |tells: bool| {
        let mut control = JointController::new(inverse_dynamics(), observing(&robot, &q));
        let (zero, held) = (Vector6::zeros(), robot.gravity(&q));
        for _ in 0..20 {
            let (at, v) = control.observe(&robot, &q, &zero);
            control.torque(&robot, &at, &v, &at_rest(q.add_scalar(0.02)));
            if tells {
                control.note_given(&robot, &at, &held);
            }
        }
        control.observe(&robot, &q, &zero);
        let (p, t) = control.disturbance();
        (robot.mass_matrix(&q) * p + t).amax()
    };
    let (told, untold) = (learnt(true), learnt(false));
    assert!(told < 0.01 * untold && untold > 1.0, "{told} and {untold} N m");
}

/// The brake by joint carries a joint whose encoder says nothing as it was, whatever is believed of it since; the other joints are braked.
#[test]
fn a_joint_without_reading_is_carried_and_nothing_else() {
    let robot = robot::<7>("panda");
    let q = posture();
    let mut control = JointController::new(inverse_dynamics(), observing(&robot, &q));
    control.soften(true);
    control.distrust([false, true, false, false, false, false, false]);
    control.brake_by_joint(&q);
    let weight = robot.gravity(&q);
    control.observe(&robot, &q, &SVector::zeros());
    for speed in [0.0, 0.5, -40.0] {
        // The others turn at 0.2 rad/s; of the second joint something absurd is believed.
        let mut believed = q;
        believed[1] += 0.03 * speed;
        let mut qd = SVector::repeat(0.2);
        qd[1] = speed;
        let tau = control.torque(&robot, &believed, &qd, &at_rest(believed)).tau;
        assert!((tau[1] - weight[1]).abs() < 1e-9, "{speed}: {} and not {}", tau[1], weight[1]);
        assert!((0..7).filter(|i| *i != 1).all(|i| tau[i] < weight[i]), "{speed}: {tau} {weight}");
        let (_, believed_qd, believed_qdd) = control.expected_motion().unwrap();
        assert_eq!((believed_qd[1], believed_qdd[1]), (0.0, 0.0));
        assert!(believed_qdd[0] != 0.0, "of the others it is known what their brakes do");
        control.observe(&robot, &believed, &qd);
    }
}
