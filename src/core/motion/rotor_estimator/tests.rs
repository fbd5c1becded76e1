//! Rotors that are found from motions whose torques come from the arm as it is, and what is no rotor.

use super::*;
use crate::linalg::Random;
use crate::motion::ObserverSettings;
use crate::robot::load;

/// What an arm has that its model does not.
struct TrueArm {
    /// Inertia of rotors, in units of each joint's own inertia.
    rotors: f64,
    friction: f64,
    masses: f64,
    /// Ticks from a command to its effect.
    delay: usize,
    /// Step of its encoders, rad.
    step: f64,
}

fn found<const N: usize>(name: &str, random: &mut Random, truth: &TrueArm, s: f64) -> [SVector<f64, N>; 5] {
    found_in(name, random, truth, (s * 1e3) as usize, |k| (k, false))
}

/// Estimate and its standard deviation, the rotors that are believed, those that are there, and the diagonal of the model's inertia matrix, after `ticks`
/// ticks of control: `at` tells for each the millisecond at which it is, and whether the estimator hears that one was missed.
fn found_in<const N: usize>(
    name: &str,
    random: &mut Random,
    truth: &TrueArm,
    ticks: usize,
    at: impl Fn(usize) -> (usize, bool),
) -> [SVector<f64, N>; 5] {
    let bare: Robot<N> = load(name).unwrap().build().unwrap();
    let q0 = SVector::from_fn(|_, _| random.between(-1.0, 1.0));
    let own = ObserverSettings::free_inertia(&bare, &q0);
    let rotors = own * truth.rotors;
    let scaled = load(name).unwrap().scaled(truth.masses, truth.friction);
    let arm = scaled.build::<N>().unwrap().with_armature(&rotors);
    // Sums of two sines in each joint, with their derivatives.
    let motion = |t: f64| {
        let (a, w) = (|i: usize| 0.05 + 0.005 * i as f64, |i: usize| 12.0 + 0.7 * i as f64);
        [
            SVector::<f64, N>::from_fn(|i, _| q0[i] + a(i) * (1.0 - (w(i) * t).cos())),
            SVector::from_fn(|i, _| a(i) * w(i) * (w(i) * t).sin()),
            SVector::from_fn(|i, _| a(i) * w(i) * w(i) * (w(i) * t).cos()),
        ]
    };
    let acts = |k: usize| {
        let [q, qd, qdd] = motion((k as f64 + 0.5) * 1e-3);
        arm.inverse_dynamics(&q, &qd, &qdd) + arm.friction_torque(&qd)
    };
    let mut estimator = RotorEstimator::new(&bare, &own);
    for (k, is_told) in (0..ticks).map(at) {
        let noise = SVector::from_fn(|i, _| 1e-3 * bare.limits()[i].effort * random.gaussian());
        let tau = acts(k + truth.delay) + noise;
        let robot = bare.clone().with_armature(estimator.believed());
        let inertia = own + estimator.believed();
        let q = motion((k as f64 + 1.0) * 1e-3)[0];
        let q = q.map(|q| if truth.step > 0.0 { (q / truth.step).round() * truth.step } else { q });
        let scale = (&inertia, &SVector::repeat(truth.step));
        if estimator.note((&robot, &SMatrix::zeros()), &tau, Some(&q), scale) {
            estimator.adopt();
        }
        if is_told {
            estimator.skip();
        }
    }
    let estimate = SVector::from_fn(|i, _| estimator.joints[i].theta[1]);
    [
        estimate,
        estimator.variance().map(f64::sqrt),
        *estimator.believed(),
        rotors,
        bare.mass_matrix(&q0).diagonal(),
    ]
}

#[test]
fn rotors_are_found_whatever_friction_and_delay_are() {
    let random = &mut Random::new(4);
    let (mut squares, mut n) = (0.0, 0.0);
    for _ in 0..40 {
        let truth = TrueArm {
            rotors: random.between(0.5, 3.0),
            friction: random.between(0.0, 2.0),
            masses: 1.0,
            delay: (random.between(0.0, 3.0)) as usize,
            step: 0.0,
        };
        let [estimate, sd, believed, rotors, _] = found::<6>("ur5", random, &truth, 1.0);
        for i in 0..6 {
            squares += ((estimate[i] - rotors[i]) / sd[i]).powi(2);
            n += 1.0;
            // Less than a hundredth of the effort at 1 rad/s^2 is within the noise of torques.
            let within = 0.6 * rotors[i]..1.15 * rotors[i];
            let is_small = rotors[i] < 0.01 * 150.0;
            assert!(is_small || within.contains(&believed[i]), "joint {i}: {believed} of {rotors}");
        }
    }
    let mean = squares / n;
    // Errors are stated as large as models may be wrong; this one is wrong in nothing else.
    assert!(mean < 1.0, "the squared errors are {mean} of the stated variances");
}

/// Encoders whose steps hide more of an acceleration in ten ticks than these arms have.
#[test]
fn rotors_are_found_behind_coarse_encoders() {
    let (random, mut found_ones) = (&mut Random::new(12), 0);
    for step in [2e-4, 5e-4, 1e-3] {
        for _ in 0..10 {
            let rotors = random.between(1.0, 3.0);
            let truth = TrueArm { rotors, friction: 1.0, masses: 1.0, delay: 1, step };
            let [_, _, believed, rotors, _] = found::<6>("ur5", random, &truth, 1.0);
            // Less than a hundredth of the effort at 1 rad/s^2 is within the noise of torques.
            for i in (0..3).filter(|i| rotors[*i] > 0.01 * 150.0) {
                found_ones += 1;
                let share = believed[i] / rotors[i];
                assert!((0.5..1.15).contains(&share), "{step}, joint {i}: {share} of {}", rotors[i]);
            }
        }
    }
    assert!(found_ones > 30, "{found_ones}");
}

#[test]
fn masses_friction_and_delay_are_hardly_rotors() {
    let random = &mut Random::new(5);
    for _ in 0..40 {
        let truth = TrueArm {
            rotors: 0.0,
            friction: random.between(0.0, 2.0),
            masses: random.between(0.8, 1.2),
            delay: (random.between(0.0, 6.0)) as usize,
            step: 0.0,
        };
        // Links that are a fifth heavier, moved by commands that are 5 ms late, may be taken for rotors with twice as much inertia, and for no more.
        for (believed, own) in [of::<6>("ur5", random, &truth), of::<7>("xarm7", random, &truth)] {
            let share = believed.iter().zip(&own).map(|(r, own)| r / own).fold(0.0, f64::max);
            assert!(share < 0.5, "{believed:?} of {own:?}");
        }
    }
}

/// The rotors that are believed, and the diagonal of the inertia matrix.
fn of<const N: usize>(name: &str, random: &mut Random, truth: &TrueArm) -> (Vec<f64>, Vec<f64>) {
    let [.., believed, _, own] = found::<N>(name, random, truth, 1.0);
    (believed.iter().copied().collect(), own.iter().copied().collect())
}

/// Of every 93 ticks twelve are missed, in which the arm moves on.
#[test]
fn what_happens_over_missed_ticks_is_left_out() {
    let truth = TrueArm { rotors: 1.0, friction: 1.0, masses: 1.0, delay: 0, step: 0.0 };
    let share = |told: bool| {
        let at = |k: usize| (k + 12 * (k / 81), told && k > 0 && k.is_multiple_of(81));
        let [.., believed, rotors, _] = found_in::<6>("ur5", &mut Random::new(6), &truth, 2000, at);
        believed[0] / rotors[0]
    };
    let (told, untold) = (share(true), share(false));
    assert!((0.8..1.05).contains(&told), "{told}");
    assert!(!(0.8..1.05).contains(&untold), "the gaps do harm where they are not left out: {untold}");
}

#[test]
fn a_joint_that_is_stopped_shows_no_rotor() {
    let bare: Robot<6> = load("ur5").unwrap().build().unwrap();
    let q0 = SVector::from_column_slice(&[0.0, -1.2, 1.2, 0.0, 0.5, 0.0]);
    let own = ObserverSettings::free_inertia(&bare, &q0);
    let mut estimator = RotorEstimator::new(&bare, &own);
    // The first joint goes on with 0.5 rad/s until something stops it within 5 ms, against which it pushes more and more.
    let at = |k: i32| {
        let t = f64::from(k - 300).max(0.0) * 1e-3;
        let way = if t < 5e-3 { 0.5 * t - 50.0 * t * t } else { 1.25e-3 };
        let mut q = q0;
        q[0] += f64::from(k.min(300)) * 5e-4 + way;
        q
    };
    for k in 0..600 {
        let mut tau = bare.gravity(&at(k));
        tau[0] += (f64::from(k - 300)).max(0.0) * 0.2;
        if estimator.note((&bare, &SMatrix::zeros()), &tau, Some(&at(k + 1)), (&own, &SVector::zeros())) {
            estimator.adopt();
        }
    }
    assert!(estimator.believed().amax() == 0.0, "{}", estimator.believed());
}

/// What an arm is believed to have of rotors, which has `rotors` times its joints' own inertia of them and carries 3 kg that its model has from `known_from` on, after a second: what control
/// believes, what is sure, and what there is. A state comes every `period` ticks.
fn laden(random: &mut Random, rotors: f64, known_from: usize, period: usize) -> [SVector<f64, 6>; 3] {
    let bare: Robot<6> = load("ur5").unwrap().build().unwrap();
    let (mass, com_E) = (3.0, nalgebra::Vector3::new(0.02, -0.01, 0.05));
    let load = Vector4::new(mass, mass * com_E.x, mass * com_E.y, mass * com_E.z);
    let carrying = bare.clone().with_payload(mass, &com_E);
    let q0 = SVector::from_fn(|_, _| random.between(-1.0, 1.0));
    let own = ObserverSettings::free_inertia(&bare, &q0);
    let rotors = own * rotors;
    let arm = carrying.clone().with_armature(&rotors);
    let motion = |t: f64| {
        let (a, w) = (|i: usize| 0.05 + 0.005 * i as f64, |i: usize| 12.0 + 0.7 * i as f64);
        [
            SVector::<f64, 6>::from_fn(|i, _| q0[i] + a(i) * (1.0 - (w(i) * t).cos())),
            SVector::from_fn(|i, _| a(i) * w(i) * (w(i) * t).sin()),
            SVector::from_fn(|i, _| a(i) * w(i) * w(i) * (w(i) * t).cos()),
        ]
    };
    let derivatives = bare.payload_derivatives();
    let mut estimator = RotorEstimator::new(&bare, &own);
    for k in 0..1000 {
        let [q, qd, qdd] = motion((k as f64 + 0.5) * 1e-3);
        let tau = arm.inverse_dynamics(&q, &qd, &qdd) + arm.friction_torque(&qd);
        if k == known_from {
            estimator.payload_changed(&load);
        }
        let model = if k < known_from { &bare } else { &carrying };
        let robot = model.clone().with_armature(estimator.believed());
        let mut Y = SMatrix::<f64, 6, 4>::zeros();
        for (j, derivative) in derivatives.iter().enumerate() {
            Y.set_column(j, &derivative.inverse_dynamics(&q, &qd, &qdd));
        }
        let q = motion((k as f64 + 1.0) * 1e-3)[0];
        let q = (k + 1).is_multiple_of(period).then_some(&q);
        let inertia = own + estimator.believed();
        if estimator.note((&robot, &Y), &tau, q, (&inertia, &SVector::zeros())) {
            estimator.adopt();
        }
    }
    let mean = if known_from < 1000 { Vector4::zeros() } else { load };
    let sd = Vector4::new(0.2, 0.03, 0.03, 0.03);
    let covariance = Matrix4::from_diagonal(&sd.component_mul(&sd));
    let payload = UnmodelledPayload { mean, covariance, inertia_sd: 0.0 };
    let [sure, _] = estimator.sure(&payload, &(own + estimator.believed()));
    [*estimator.believed(), sure, rotors]
}

#[test]
fn what_a_payload_takes_is_no_rotor() {
    let random = &mut Random::new(8);
    for _ in 0..10 {
        let [believed, sure, _] = laden(random, 0.0, 1000, 1);
        assert!(
            believed.amax() > 0.1,
            "without the payload the joints are heavier than their model: {believed}"
        );
        assert_eq!(sure.amax(), 0.0, "{sure}");
        let [believed, sure, _] = laden(random, 0.0, 400, 1);
        assert!(believed.amax() < 0.05, "it is taken out of them: {believed}");
        assert_eq!(sure.amax(), 0.0, "{sure}");
    }
}

#[test]
fn rotors_are_found_beside_a_payload_and_behind_slower_drives() {
    let random = &mut Random::new(9);
    for (known_from, period) in [(1000, 1), (400, 1), (400, 2), (400, 3), (0, 8)] {
        for _ in 0..5 {
            let [_, sure, rotors] = laden(random, 2.0, known_from, period);
            let within = |i: usize| (0.7 * rotors[i]..1.3 * rotors[i]).contains(&sure[i]);
            let told: Vec<usize> = (0..6).filter(|i| sure[*i] > 0.0).collect();
            // Of light joints it is not sure, because the payload is not.
            assert!(told.len() > 1, "{known_from}, {period} ms: {sure} of {rotors}");
            assert!(told.iter().all(|i| within(*i)), "{known_from}, {period} ms: {sure} of {rotors}");
        }
    }
}
