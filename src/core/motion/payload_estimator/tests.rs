//! The torques of payloads against virtual work by finite differences, and what is found of payloads from motions with friction and masses that
//! differ from the model.

use super::*;
use crate::linalg::Random;
use crate::robot::load;

/// A motion: sums of two sines in each joint, with its derivatives.
fn motion<const N: usize>(q0: &SVector<f64, N>, t: f64) -> [SVector<f64, N>; 3] {
    let (a, w) = (|i: usize| 0.3 + 0.05 * i as f64, |i: usize| 1.0 + 0.4 * i as f64);
    [
        SVector::from_fn(|i, _| q0[i] + a(i) * (1.0 - (w(i) * t).cos())),
        SVector::from_fn(|i, _| a(i) * w(i) * (w(i) * t).sin()),
        SVector::from_fn(|i, _| a(i) * w(i) * w(i) * (w(i) * t).cos()),
    ]
}

fn arm<const N: usize>(name: &str) -> Robot<N> {
    load(name).unwrap().build().unwrap()
}

fn posture<const N: usize>(random: &mut Random) -> SVector<f64, N> {
    SVector::from_fn(|_, _| random.between(-1.5, 1.5))
}

/// The torques of a point of `mass` kg at `com_E` in the [`motion`] at `t`, by virtual work: the force `m (a - g)` on it times the derivative of
/// its position by each joint, where positions come from forward kinematics alone and derivatives are differences.
fn torques_by_virtual_work<const N: usize>(
    arm: &Robot<N>,
    q0: &SVector<f64, N>,
    t: f64,
    mass: f64,
    com_E: &Vector3<f64>,
) -> SVector<f64, N> {
    let at = |q: &SVector<f64, N>| arm.forward(q) * nalgebra::Point3::from(*com_E);
    let [q, _, _] = motion(q0, t);
    let h = 1e-4;
    let [before, after] = [t - h, t + h].map(|t| at(&motion(q0, t)[0]));
    let a = (before.coords - at(&q).coords * 2.0 + after.coords) / (h * h);
    let force = (a - Vector3::new(0.0, 0.0, -9.81)) * mass;
    SVector::from_fn(|i, _| {
        let mut step = SVector::<f64, N>::zeros();
        step[i] = 1e-5;
        (at(&(q + step)) - at(&(q - step))).dot(&force) / 2e-5
    })
}

#[test]
fn a_payload_has_the_torques_of_virtual_work() {
    let random = &mut Random::new(1);
    for _ in 0..20 {
        let (bare, q0) = (arm::<6>("ur5"), posture(random));
        let com_E = Vector3::from_fn(|_, _| random.between(-0.2, 0.2));
        let [q, qd, qdd] = motion(&q0, 0.7);
        let carrying = bare.clone().with_payload(3.0, &com_E);
        let more = carrying.inverse_dynamics(&q, &qd, &qdd) - bare.inverse_dynamics(&q, &qd, &qdd);
        let off = (more - torques_by_virtual_work(&bare, &q0, 0.7, 3.0, &com_E)).amax();
        assert!(off < 1e-4, "{off}");
    }
}

#[test]
fn derivatives_by_a_payload_have_the_torques_of_a_light_one() {
    let random = &mut Random::new(2);
    for _ in 0..20 {
        let (bare, q0) = (arm::<7>("xarm7"), posture(random));
        let [q, qd, qdd] = motion(&q0, 0.4);
        let derivatives = bare.payload_derivatives().map(|arm| arm.inverse_dynamics(&q, &qd, &qdd));
        // First order in the distance from the flange: a centre of mass that is near enough.
        let com_E = Vector3::from_fn(|_, _| random.between(-1e-4, 1e-4));
        let torques = torques_by_virtual_work(&bare, &q0, 0.4, 1.0, &com_E);
        let linear =
            derivatives[0] + derivatives[1] * com_E.x + derivatives[2] * com_E.y + derivatives[3] * com_E.z;
        assert!((torques - linear).amax() < 1e-4, "{torques} {linear}");
    }
}

/// What is found in `s` seconds of motion of an arm that carries `mass` kg at `com_E`, has `friction` times the friction of its model, and links that are `mass_scale` times as heavy.
fn found<const N: usize>(
    name: &str,
    random: &mut Random,
    load: (f64, Vector3<f64>),
    truth: (f64, f64),
    s: f64,
) -> Option<(f64, Vector3<f64>)> {
    found_behind::<N>(name, random, load, truth, s, |_| true).map(|found| (found.mass, found.com))
}

/// The same behind a drive that has a new state in the ticks that `is_new` tells.
fn found_behind<const N: usize>(
    name: &str,
    random: &mut Random,
    (mass, com_E): (f64, Vector3<f64>),
    (friction, mass_scale): (f64, f64),
    s: f64,
    is_new: impl Fn(u32) -> bool,
) -> Option<PayloadFound> {
    let bare = arm::<N>(name);
    let description = load(name).unwrap().scaled(mass_scale, friction);
    let truth = description.build::<N>().unwrap().with_payload(mass, &com_E);
    let q0 = posture(random);
    let mut estimator = PayloadEstimator::new(bare);
    let mut state = (q0, SVector::zeros());
    for k in 0..(s * 1e3) as u32 {
        let is_new = is_new(k);
        if is_new {
            let [q, qd, _] = motion(&q0, f64::from(k + 1) * 1e-3);
            state = (q, qd);
        }
        let [q_mid, qd_mid, qdd_mid] = motion(&q0, (f64::from(k) + 0.5) * 1e-3);
        let tau = truth.inverse_dynamics(&q_mid, &qd_mid, &qdd_mid) + truth.friction_torque(&qd_mid);
        let joints = JointTick { q: state.0, qd: state.1, is_new, noise: SVector::zeros() };
        if estimator.note(&tau, &joints) {
            estimator.adopt();
        }
    }
    estimator.payload()
}

#[test]
fn a_payload_is_found_behind_slower_drives() {
    let load = (3.0, Vector3::new(0.02, -0.03, 0.05));
    for period in [2, 3, 8] {
        let random = &mut Random::new(7);
        let is_new = |k: u32| k.is_multiple_of(period);
        let found = found_behind::<6>("ur5", random, load, (1.0, 1.0), 3.0, is_new);
        let mass = found.map_or(0.0, |found| found.mass);
        assert!((mass - 3.0).abs() < 0.1, "{mass} kg with a state every {period} ms");
    }
}

#[test]
fn mass_and_centre_are_as_sure_as_they_are_told() {
    let random = &mut Random::new(8);
    let (mut squares, mut n) = (0.0, 0.0);
    for _ in 0..30 {
        let mass = random.between(1.5, 3.5);
        let com_E = Vector3::from_fn(|_, _| random.between(-0.05, 0.05)) + Vector3::z() * 0.05;
        let friction = random.between(0.0, 2.0);
        let payload = found_behind::<7>("xarm7", random, (mass, com_E), (friction, 1.0), 1.5, |_| true);
        let Some(PayloadFound { mass: m, mass_sd, com, com_sd }) = payload else { continue };
        assert!(
            (m - mass).abs() < 3.0 * mass_sd,
            "{m} +- {mass_sd} for {mass} kg under {friction} of the friction"
        );
        squares += ((com - com_E).component_div(&com_sd)).norm_squared() / 3.0;
        n += 1.0;
    }
    assert!(n > 20.0 && squares / n < 1.5, "{squares} of the stated variances in {n}");
}

#[test]
fn a_payload_is_found_in_motion_whatever_friction_is() {
    let random = &mut Random::new(3);
    let mut missed = 0;
    for friction in [0.0, 0.5, 1.0, 1.5, 2.0] {
        for _ in 0..6 {
            let mass = random.between(1.7, 3.5);
            let com_E = Vector3::from_fn(|_, _| random.between(-0.05, 0.05)) + Vector3::z() * 0.05;
            let payload = found::<7>("xarm7", random, (mass, com_E), (friction, 1.0), 3.0);
            missed += u32::from(payload.is_none());
            let Some((m, _)) = payload else { continue };
            assert!(
                (m - mass).abs() < 0.2 + 0.15 * mass,
                "{m} for {mass} kg under {friction} of the friction"
            );
        }
    }
    // Where an arm hangs down, or moves about the vertical, its joints hardly feel a payload beside their friction.
    assert!(missed <= 6, "{missed} of 30 are not found");
}

#[test]
fn the_centre_of_mass_is_found_where_the_model_is_right() {
    let random = &mut Random::new(4);
    for _ in 0..10 {
        let com_E = Vector3::from_fn(|_, _| random.between(-0.1, 0.1));
        let (m, c) = found::<6>("ur5", random, (4.0, com_E), (1.0, 1.0), 6.0).unwrap();
        assert!((m - 4.0).abs() < 0.1 && (c - com_E).norm() < 0.03, "{m} kg at {c:.3} instead of {com_E:.3}");
    }
}

#[test]
fn an_arm_that_carries_nothing_is_left_as_it_is() {
    let random = &mut Random::new(5);
    for friction in [0.5, 1.0, 1.3, 2.0] {
        for _ in 0..6 {
            let nothing = (0.0, Vector3::zeros());
            assert_eq!(found::<6>("ur5", random, nothing, (friction, 1.0), 5.0), None, "{friction}");
            let mass =
                found::<7>("xarm7", random, nothing, (friction, 1.0), 5.0).map_or(0.0, |(mass, _)| mass);
            // Twice the friction where once is believed may look like a light payload.
            assert!(mass <= if friction < 1.5 { 0.0 } else { 0.5 }, "{mass} kg at {friction}");
        }
    }
}

#[test]
fn links_that_are_heavier_than_modelled_are_no_heavy_payload() {
    let random = &mut Random::new(6);
    for scale in [0.8, 0.9, 1.1, 1.2] {
        for _ in 0..6 {
            let found = found::<6>("ur5", random, (0.0, Vector3::zeros()), (1.0, scale), 5.0);
            let mass = found.map_or(0.0, |(mass, _)| mass);
            // 3.5 kg of the links lie beyond the elbow.
            assert!(mass < 1.5, "{mass} kg at {scale} times the masses");
        }
    }
}
