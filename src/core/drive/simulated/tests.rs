use super::*;
use crate::drive::{Jam, Push, Wall};
use crate::drive::{ShakingBase, TorqueRipple};
use crate::robot::{Friction, Inertia, load};
use nalgebra::Vector4;

type Settings<const N: usize> = SimulatedDriveSettings<N>;

fn arm<const N: usize>(name: &str) -> Robot<N> {
    load(name).unwrap().build().unwrap()
}

fn at(ms: i64) -> MonoNs {
    MonoNs(ms * 1_000_000)
}

fn posture<const N: usize>() -> SVector<f64, N> {
    SVector::from_fn(|i, _| 0.3 - 0.4 * i as f64)
}

fn command<const N: usize>(
    tau: SVector<f64, N>,
    q_r: SVector<f64, N>,
    qd_r: SVector<f64, N>,
) -> DriveCommand<N> {
    DriveCommand { tau, q_r, qd_r, qdd_r: nalgebra::SVector::zeros() }
}

fn free<const N: usize>() -> DriveCommand<N> {
    command(SVector::zeros(), SVector::zeros(), SVector::zeros())
}

fn energy_is_conserved<const N: usize>(name: &str) {
    let payload = Inertia::point(1.0, Vector3::new(0.02, 0.0, 0.05));
    let settings = Settings { friction: false, substeps: 4, payload, ..Settings::default() };
    let qd = SVector::from_fn(|i, _| 0.3 - 0.1 * i as f64);
    let mut drive = SimulatedDrive::new(arm::<N>(name), posture(), settings).unwrap().with_velocity(qd);
    drive.read(at(0));
    drive.write(&free());
    let before = drive.energy_j();
    let kinetic = drive.robot.kinetic_energy(&drive.q, &drive.qd).max(1.0);
    for ms in 1..=8000 {
        drive.read(at(ms));
        drive.write(&free());
    }
    let scale = before.abs().max(kinetic);
    let drift = (drive.energy_j() - before).abs() / scale;
    assert!(drift <= 1e-8, "{name}: energy drifts by {drift:e}");
    assert!((drive.q - posture::<N>()).amax() > 0.1, "{name} has moved");
}

#[test]
fn energy_is_conserved_without_torque_and_friction() {
    energy_is_conserved::<4>("scara");
    energy_is_conserved::<6>("ur5");
    energy_is_conserved::<7>("panda");
}

#[test]
fn brakes_hold_until_a_command_arrives() {
    let settings = Settings { command_delay_ticks: 3, ..Settings::default() };
    let mut drive = SimulatedDrive::new(arm::<6>("ur5"), posture(), settings).unwrap();
    for ms in 0..10 {
        let state = drive.read(at(ms));
        assert_eq!(
            state.q == posture::<6>(),
            ms <= 6,
            "at {ms} ms: three ticks of brakes, three of delay, and then it falls"
        );
        if ms >= 3 {
            drive.write(&free());
        }
    }
}

#[test]
fn friction_stops_an_arm_and_never_drives_it() {
    // 1 N m of Coulomb friction on the last, lightest links: an explicit step of 1 ms would chatter.
    let robot = arm::<7>("xarm7").with_gravity(Vector3::zeros());
    assert!(robot.friction().iter().all(|f| f.coulomb > 0.0));
    let qd = SVector::from_fn(|i, _| if i % 2 == 0 { 0.8 } else { -0.6 });
    let mut drive = SimulatedDrive::new(robot, posture(), Settings::default()).unwrap().with_velocity(qd);
    drive.read(at(0));
    drive.write(&free());
    let mut energy = drive.energy_j();
    for ms in 1..=3000 {
        drive.read(at(ms));
        let next = drive.energy_j();
        assert!(next <= energy + 1e-9, "at {ms} ms friction drives: {energy} -> {next}");
        energy = next;
    }
    assert!(drive.qd.amax() < 1e-4, "at rest, {}", drive.qd);
}

#[test]
fn implicit_friction_agrees_with_the_model() {
    let friction = [Friction { viscous: 30.0, coulomb: 5.0 }; 4];
    let robot = arm::<4>("scara").with_friction(friction);
    let qd = Vector4::new(0.5, -0.4, 0.2, 0.6);
    let run = |substeps| {
        let settings = Settings { substeps, ..Settings::default() };
        let mut d = SimulatedDrive::new(robot.clone(), posture(), settings).unwrap().with_velocity(qd);
        d.read(at(0));
        d.write(&free());
        d.read(at(10)); // before the first joint comes to rest
        d.qd
    };
    let exact = run(100);
    let (coarse, fine) = ((run(1) - exact).amax(), (run(10) - exact).amax());
    assert!(coarse < 4e-3 && fine < coarse / 5.0, "of first order: {coarse:e} {fine:e}");
    // Over a short time it is the acceleration of the model.
    let mut d = SimulatedDrive::new(robot.clone(), posture(), Settings::default()).unwrap().with_velocity(qd);
    d.read(at(0));
    d.write(&free());
    d.read(MonoNs(1_000));
    let measured = (d.qd - qd) * 1e6;
    let wanted = robot.forward_dynamics(&posture(), &qd, &-robot.friction_torque(&qd));
    assert!((measured - wanted).norm() < 1e-3 * wanted.norm(), "{measured} {wanted}");
}

#[test]
fn static_friction_holds_and_the_stribeck_curve_brakes() {
    let mut friction = [Friction::default(); 6];
    friction[5] = Friction { viscous: 1.0, coulomb: 1.0 };
    let robot = arm::<6>("ur5").with_friction(friction).with_gravity(Vector3::zeros());
    let hard_friction = Some(HardFriction { static_ratio: 1.5, stribeck_speed: 0.05 });
    let settings = Settings { hard_friction, ..Settings::default() };
    let mut drive = SimulatedDrive::new(robot, posture(), settings).unwrap();
    let (mut ms, start) = (0, posture::<6>()[5]);
    let mut push = |drive: &mut SimulatedDrive<6>, tau: f64| {
        for _ in 0..400 {
            drive.read(at(ms));
            let tau = SVector::from_column_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, tau]);
            drive.write(&command(tau, SVector::zeros(), SVector::zeros()));
            ms += 1;
        }
        (drive.q[5] - start, drive.qd[5])
    };
    assert_eq!(push(&mut drive, 1.49), (0.0, 0.0), "held, without any creeping");
    assert!((push(&mut drive, 1.51).1 - 0.51).abs() < 1e-2, "1.51 = 1 + v, far above the Stribeck speed");
    assert!(
        (push(&mut drive, 1.3).1 - 0.3).abs() < 1e-2,
        "it goes on, although that would not have moved it"
    );
    assert_eq!(push(&mut drive, 0.0).1, 0.0, "it stands for good");
}

#[test]
fn hard_friction_never_drives() {
    let robot = arm::<7>("xarm7").with_gravity(Vector3::zeros());
    let qd = SVector::from_fn(|i, _| if i % 2 == 0 { 0.8 } else { -0.6 });
    let hard_friction = Some(HardFriction { static_ratio: 1.2, stribeck_speed: 0.05 });
    let settings = Settings { hard_friction, ..Settings::default() };
    let mut drive = SimulatedDrive::new(robot, posture(), settings).unwrap().with_velocity(qd);
    drive.read(at(0));
    drive.write(&free());
    let mut energy = drive.energy_j();
    for ms in 1..=3000 {
        drive.read(at(ms));
        let next = drive.energy_j();
        assert!(next <= energy + 1e-9, "at {ms} ms friction drives: {energy} -> {next}");
        energy = next;
    }
    assert_eq!(drive.qd.amax(), 0.0, "at rest for good");
}

#[test]
fn rotors_make_a_joint_heavier_by_as_much() {
    let accelerated = |rotor: f64| {
        let rotor_inertia = Vector4::new(rotor, 0.0, 0.0, 0.0);
        let settings = Settings { rotor_inertia, friction: false, ..Settings::default() };
        let drive = SimulatedDrive::new(arm::<4>("scara"), Vector4::zeros(), settings).unwrap();
        drive.robot.mass_matrix(&Vector4::zeros())
    };
    let difference = accelerated(3.0) - accelerated(0.0);
    assert!((difference[(0, 0)] - 3.0).abs() < 1e-12 && difference.norm() < 3.0 + 1e-12, "{difference}");
}

#[test]
fn torques_are_cut_at_the_effort_limits() {
    let run = |tau: f64, effort_limits| {
        let settings = Settings { effort_limits, ..Settings::default() };
        let mut d = SimulatedDrive::new(arm::<4>("scara"), posture(), settings).unwrap();
        d.read(at(0));
        d.write(&command(Vector4::new(tau, 0.0, 0.0, 0.0), Vector4::zeros(), Vector4::zeros()));
        d.read(at(10)).qd[0]
    };
    let limit = arm::<4>("scara").limits()[0].effort;
    assert_eq!(run(3.0 * limit, true), run(limit, true));
    assert!(run(3.0 * limit, false) > 2.0 * run(limit, false));
}

/// Follows a ramp for 2 s and rests: the distance from the reference while moving and at rest.
fn follow(mode: CommandMode, payload_kg: f64) -> (f64, f64) {
    let payload = Inertia::point(payload_kg, Vector3::new(0.0, 0.0, 0.05));
    let settings = Settings { mode, payload, ..Settings::default() };
    let q = SVector::<f64, 6>::from_column_slice(&[0.0, -1.2, 1.4, -0.3, 0.5, 0.2]);
    let mut drive = SimulatedDrive::new(arm("ur5"), q, settings).unwrap();
    let mut q_r = q;
    let (mut moving, mut resting) = (0.0_f64, 0.0);
    for ms in 0..5000 {
        let state = drive.read(at(ms));
        let error = (state.q - q_r).amax();
        if ms < 2000 {
            moving = moving.max(error);
        }
        resting = error;
        let speed = if ms < 2000 { 0.2 * (ms as f64 * 1e-3 * std::f64::consts::PI / 2.0).sin() } else { 0.0 };
        let qd_r = SVector::from_element(speed);
        q_r += qd_r * 1e-3;
        drive.write(&command(SVector::zeros(), q_r, qd_r));
    }
    (moving, resting)
}

#[test]
fn the_inner_servo_tracks_under_an_unknown_load() {
    for payload_kg in [0.0, 1.0] {
        let (moving, resting) = follow(CommandMode::Position, payload_kg);
        assert!(moving < 1e-3 && resting < 1e-9, "position, {payload_kg} kg: {moving} {resting}");
        // Nothing draws a velocity loop back to the position it lost while it took up the load, but nothing drifts.
        let (moving, resting) = follow(CommandMode::Velocity, payload_kg);
        assert!(moving < 3e-3 && resting < 3e-3, "velocity, {payload_kg} kg: {moving} {resting}");
    }
}

#[test]
fn a_drive_with_its_own_loop_holds_its_load_from_the_first() {
    for mode in [CommandMode::Velocity, CommandMode::Position] {
        let payload = Inertia::point(3.0, Vector3::new(0.05, 0.02, 0.1));
        let settings = Settings { mode, payload, ..Settings::default() };
        let q = SVector::<f64, 6>::from_column_slice(&[0.0, -1.2, 1.4, -0.3, 0.5, 0.2]);
        let mut drive = SimulatedDrive::new(arm("ur5"), q, settings).unwrap();
        drive.read(at(0));
        for ms in 1..200 {
            drive.write(&command(SVector::zeros(), q, SVector::zeros()));
            let state = drive.read(at(ms));
            assert!((state.q - q).amax() < 1e-7, "{mode}, {ms} ms: {}", state.q - q);
        }
    }
}

/// What the commands keep to, the arm keeps to: a servo that lags and catches up would accelerate by 13.5 % more.
#[test]
fn the_inner_servo_accelerates_as_its_commands_do() {
    for mode in [CommandMode::Velocity, CommandMode::Position] {
        for substeps in [1, 4] {
            let settings = Settings { mode, substeps, ..Settings::default() };
            let q = SVector::<f64, 6>::from_column_slice(&[0.0, -1.2, 1.4, -0.3, 0.5, 0.2]);
            let mut drive = SimulatedDrive::new(arm("ur5"), q, settings).unwrap();
            let (mut q_r, mut qd_r, mut a_r) = (q, SVector::<f64, 6>::zeros(), 0.0);
            let (mut qd, mut a) = (SVector::<f64, 6>::zeros(), SVector::<f64, 6>::zeros());
            let (mut most, mut max_jerk) = (0.0_f64, 0.0_f64);
            drive.read(at(0));
            for ms in 1..600_i32 {
                // Jerk 500, acceleration 10.
                let j = [(1, 21, 500.0), (41, 61, -500.0), (301, 321, -500.0), (341, 361, 500.0)];
                let j = j.iter().find(|(from, to, _)| (*from..*to).contains(&ms)).map_or(0.0, |(_, _, j)| *j);
                let before = qd_r;
                qd_r = before.add_scalar((a_r + 0.5e-3 * j) * 1e-3);
                q_r += (before + qd_r) * 0.5e-3;
                a_r += j * 1e-3;
                drive.write(&command(SVector::zeros(), q_r, qd_r));
                let state = drive.read(at(ms.into()));
                let acceleration = (state.qd - qd) * 1e3;
                most = most.max(acceleration.amax());
                max_jerk = max_jerk.max(((acceleration - a) * 1e3_f64).amax());
                (qd, a) = (state.qd, acceleration);
                assert!((state.q - q_r).amax() < 1e-5, "{mode}, {ms} ms: {}", state.q - q_r);
            }
            assert!(most < 1.005 * 10.0 && max_jerk < 1.02 * 500.0, "{mode}, {substeps}: {most} {max_jerk}");
        }
    }
}

#[test]
fn bad_settings_are_refused() {
    let make = |settings| SimulatedDrive::new(arm::<4>("scara"), posture(), settings).map(|_| ());
    assert_eq!(make(Settings { substeps: 0, ..Settings::default() }), Err(SimulatedDriveError::NoSubsteps));
    let delay = Settings { command_delay_ticks: 51, ..Settings::default() };
    assert_eq!(make(delay), Err(SimulatedDriveError::Delay(51)));
}

#[test]
fn a_wall_holds_the_flange_and_a_push_moves_it() {
    let robot = arm::<6>("ur5").with_gravity(Vector3::zeros());
    let q = SVector::<f64, 6>::from_column_slice(&[0.4, -1.4, 1.3, -1.0, -1.5, 0.3]);
    let start = robot.forward(&q).translation.vector;
    let direction = Vector3::new(0.6, 0.0, 0.8);
    let push = Some(Push { force_B: direction * 20.0, during_s: (0.0, 10.0) });
    let normal_B = nalgebra::Unit::new_normalize(-direction);
    let wall = Some(Wall { point_B: start + direction * 0.05, normal_B, stiffness: 3e4, damping: 300.0 });
    let ends = |surroundings| {
        let friction = [Friction { viscous: 8.0, coulomb: 0.0 }; 6];
        let settings = Settings { surroundings, ..Settings::default() };
        let mut drive = SimulatedDrive::new(robot.clone().with_friction(friction), q, settings).unwrap();
        for ms in 0..2500 {
            drive.read(at(ms));
            drive.write(&free());
        }
        (robot.forward(&drive.q).translation.vector - start).dot(&direction)
    };
    assert_eq!(ends(Surroundings::default()), 0.0);
    assert!(ends(Surroundings { push, ..Surroundings::default() }) > 0.1, "pushed away");
    // The spring gives way by the force over its stiffness.
    let depth = ends(Surroundings { push, wall, jam: None }) - 0.05;
    assert!((depth - 20.0 / 3e4).abs() < 2e-4, "{depth}");
}

#[test]
fn a_joint_that_jams_stands_from_then_on() {
    let settings = Settings {
        friction: false,
        surroundings: Surroundings { jam: Some(Jam { joint: 1, from_s: 0.1 }), ..Surroundings::default() },
        ..Settings::default()
    };
    let qd = Vector4::new(0.5, 0.4, 0.0, 0.3);
    let mut drive = SimulatedDrive::new(arm::<4>("scara"), posture(), settings).unwrap().with_velocity(qd);
    let mut places = Vec::new();
    for ms in 0..300 {
        drive.read(at(ms));
        let tau = drive.robot.gravity(&drive.q);
        drive.write(&command(tau, SVector::zeros(), SVector::zeros()));
        places.push(drive.q);
    }
    assert!(places[99][1] - places[0][1] > 0.03, "it moved before");
    assert!((places[299][1] - places[102][1]).abs() < 1e-5, "it stands");
    assert!((places[299] - places[102]).amax() > 0.05, "the others move on");
}

/// Springs between motors and links: at rest they carry gravity, and stiff ones make the rigid arm whose rotors are on the diagonal of B.
#[test]
fn elastic_joints_sag_under_gravity_and_stiff_ones_are_rigid() {
    let robot = arm::<6>("ur5");
    let settings = |wind_up| Settings { friction: false, wind_up, ..Settings::default() };
    let mut soft = SimulatedDrive::new(robot.clone(), posture(), settings(Some(3e-3))).unwrap();
    let state = soft.read(at(0));
    let (q, _) = state.truth.unwrap();
    assert_eq!(state.q, posture::<6>(), "encoders are on the motors");
    let stiffness = SVector::<f64, 6>::from_fn(|i, _| robot.limits()[i].effort / 3e-3);
    let carried = stiffness.component_mul(&(state.q - q));
    assert!((carried - robot.gravity(&q)).amax() < 1e-9 && (state.q - q).amax() > 1e-4, "{carried}");
    // Held by the torques of gravity, it stays there.
    for ms in 1..200 {
        soft.write(&command(robot.gravity(&q), SVector::zeros(), SVector::zeros()));
        soft.read(at(ms));
    }
    assert!((soft.q - q).amax() < 1e-7, "{}", soft.q - q);
    // The likely rotors by hand: 0.02 s times effort over speed.
    let rotors =
        SVector::<f64, 6>::from_fn(|i, _| 0.02 * robot.limits()[i].effort / robot.limits()[i].velocity);
    let mut stiff = SimulatedDrive::new(robot.clone(), posture(), settings(Some(1e-5))).unwrap();
    let rigid = Settings { rotor_inertia: rotors, ..settings(None) };
    let mut rigid = SimulatedDrive::new(robot.clone(), posture(), rigid).unwrap();
    let tau = robot.gravity(&posture()) + SVector::from_fn(|i, _| if i % 2 == 0 { 3.0 } else { -2.0 });
    for ms in 0..300 {
        for drive in [&mut stiff, &mut rigid] {
            drive.read(at(ms));
            drive.write(&command(tau, SVector::zeros(), SVector::zeros()));
        }
    }
    let (way, off) = ((rigid.q - posture::<6>()).amax(), (stiff.q - rigid.q).amax());
    assert!(way > 0.05 && off < 0.01 * way, "{off} of {way}");
}

/// Friction acts on the motors: a joint that is pushed with less than it stands, and the arm comes to rest without being driven.
#[test]
fn friction_of_elastic_joints_holds_the_motors() {
    let robot = arm::<7>("xarm7").with_gravity(Vector3::zeros());
    let hard = HardFriction { static_ratio: 1.2, stribeck_speed: 0.05 };
    for hard_friction in [None, Some(hard)] {
        let settings = Settings { hard_friction, wind_up: Some(2e-3), ..Settings::default() };
        let mut drive = SimulatedDrive::new(robot.clone(), posture(), settings).unwrap();
        for ms in 0..300 {
            drive.read(at(ms));
            drive.write(&command(SVector::repeat(0.5), SVector::zeros(), SVector::zeros()));
        }
        let moved = (drive.read(at(300)).q - posture::<7>()).amax();
        // Smooth friction of 1 N m creeps under half of that with 0.55 mrad/s, hard friction not at all.
        assert!(moved < if hard_friction.is_none() { 3e-4 } else { 1e-9 }, "{hard_friction:?}: {moved}");
        assert!((drive.q - drive.motors().0).amax() < 1e-4, "friction carries it, and not the springs");
    }
}

/// The ripple by its definition: within its amplitude, of the period that is asked for, and each joint's own.
#[test]
fn torque_ripple_has_its_amplitude_and_period() {
    let ripple = TorqueRipple { share: 0.01, per_rad_or_m: 30.0, seed: 4 };
    let at = |x: f64| ripple.torque::<6>(&SVector::repeat(x), |_| 100.0);
    let places = (0..3000).map(|k| at(f64::from(k) * 1e-4));
    let most = places.fold(SVector::<f64, 6>::zeros(), |most, t| most.sup(&t.abs()));
    assert!(most.max() <= 1.0 && most.min() >= 0.5 - 1e-3, "{most}");
    assert!((at(0.2) - at(0.2 + 1.0 / 30.0)).amax() < 1e-9 && (at(0.2) - at(0.2 + 0.5 / 30.0)).amax() > 0.1);
    assert_ne!(most[0], most[1]);
    // It acts on the arm: what is held by gravity's torque moves.
    let robot = arm::<6>("ur5");
    let settings = Settings { friction: false, ripple: Some(ripple), ..Settings::default() };
    let mut drive = SimulatedDrive::new(robot.clone(), posture(), settings).unwrap();
    drive.read(MonoNs(0));
    drive.write(&command(robot.gravity(&posture()), SVector::zeros(), SVector::zeros()));
    let qdd = drive.read(MonoNs(10_000)).qd / 1e-5;
    let wanted = robot.forward_dynamics(
        &posture(),
        &SVector::zeros(),
        &(robot.gravity(&posture()) + ripple.torque(&posture(), |i| robot.limits()[i].effort)),
    );
    assert!((qdd - wanted).norm() < 1e-3 * wanted.norm(), "{qdd} {wanted}");
}

/// A base that accelerates is felt as gravity that changes, at every instant.
#[test]
fn a_shaking_base_is_felt_as_gravity() {
    let robot = arm::<6>("ur5");
    let base = ShakingBase { amplitude_B: Vector3::new(1.0, 0.5, 0.0), frequency_hz: 7.0, seed: 3 };
    let settings = Settings { friction: false, base: Some(base), substeps: 4, ..Settings::default() };
    let mut drive = SimulatedDrive::new(robot.clone(), posture(), settings).unwrap();
    let (mut q, mut qd) = (posture::<6>(), SVector::<f64, 6>::zeros());
    let g = robot.gravity_vector();
    for ms in 0..200 {
        drive.read(at(ms));
        drive.write(&command(robot.gravity(&posture()), SVector::zeros(), SVector::zeros()));
        // The same by small steps of this test's own.
        for k in 0..10 {
            let t = 1e-3 * ms as f64 + 1e-4 * (f64::from(k) + 0.5);
            let arm = robot.clone().with_gravity(g - base.acceleration(t));
            qd += arm.forward_dynamics(&q, &qd, &robot.gravity(&posture())) * 1e-4;
            q += qd * 1e-4;
        }
    }
    let (moved, off) = ((q - posture::<6>()).amax(), (drive.read(at(200)).q - q).amax());
    assert!(moved > 1e-3 && off < 0.02 * moved, "{off} of {moved}");
    assert!((0..300).all(|k| base.acceleration(f64::from(k) * 1e-3).z == 0.0));
}
