use super::*;
use std::collections::VecDeque;

const MODEL: Friction = Friction { viscous: 2.0, coulomb: 1.0 };
const INERTIA: f64 = 1.4e-4;

/// What became of a joint that was probed and then asked to go with 0.1 rad/s.
#[derive(Debug)]
struct Pushed {
    /// The largest acceleration, rad/s^2.
    hardest: f64,
    /// The last speed, rad/s.
    v: f64,
    share: f64,
    /// When it was probed, ticks.
    ready: i32,
}

/// A joint of `inertia` with `scale` times the model's friction, which changes its sign within `width` (rad/s), under `load` (N m); its
/// commands are `delay` ticks late.
fn pushed(inertia: f64, scale: f64, width: f64, load: f64, delay: usize) -> Pushed {
    let h = 1e-3;
    let (mut v, mut away, mut hardest, mut ready) = (0.0, 0.0, 0.0_f64, -1);
    let mut confirmed = ConfirmedFriction::<1>::new(&SVector::repeat(INERTIA));
    let mut late = VecDeque::from(vec![0.0; delay]);
    for tick in 0..1500 {
        let probing = confirmed.probe(true);
        if !probing && ready < 0 {
            ready = tick;
        }
        let moving = if probing { 0.0 } else { 0.1 * (f64::from(tick - ready) * h).min(1.0) };
        let wanted =
            moving + if probing { confirmed.probe_velocity(&SVector::repeat(-away))[0] } else { 0.0 };
        let torque = confirmed.share()[0] * MODEL.torque(wanted);
        let u = 80.0 * (wanted - v);
        late.push_back(INERTIA * u + torque);
        let tau = late.pop_front().unwrap_or(0.0) + load;
        // Implicit in the friction, by halving: the joint comes to its speed within microseconds.
        let balance = |next: f64| {
            let coulomb = scale * MODEL.coulomb * (next / width).tanh();
            inertia * (next - v) / h + coulomb + scale * MODEL.viscous * next - tau
        };
        let (mut low, mut high) = (-50.0, 50.0);
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if balance(middle) < 0.0 { low = middle } else { high = middle }
        }
        let next = 0.5 * (low + high);
        hardest = hardest.max((next - v).abs() / h);
        let response = FrictionResponse {
            torque,
            excess: (next - v) / h - u,
            inertia: INERTIA,
            requested: wanted,
            speed: 0.5 * (v + next),
            rests: probing,
            noise: (0.0, 0.0),
        };
        confirmed.note(0, &MODEL, &response);
        away += h * response.speed;
        v = next;
    }
    Pushed { hardest, v, share: confirmed.share()[0], ready }
}

#[test]
fn friction_that_is_not_there_accelerates_no_joint() {
    for ratio in [1.0, 3.0, 20.0] {
        for delay in [0, 1, 2] {
            let end = pushed(ratio * INERTIA, 0.0, 1e-3, 0.0, delay);
            assert!(end.hardest < 10.0, "{ratio} {delay}: {end:?}");
            assert!((end.v - 0.1).abs() < 0.05 && end.share < 0.1 * ratio, "{ratio} {delay}: {end:?}");
        }
    }
}

#[test]
fn smooth_friction_is_measured_before_the_arm_moves() {
    for scale in [0.3, 0.5, 0.8, 1.0, 1.3, 2.0] {
        for delay in [0, 1, 2] {
            let end = pushed(INERTIA, scale, 1e-3, 0.0, delay);
            assert!((end.share - scale).abs() < 0.02 * scale, "{scale} {delay}: {end:?}");
            assert!(end.hardest < 5.0 && end.ready < 200, "{scale} {delay}: {end:?}");
        }
    }
}

/// Friction that changes its sign at once: the joint jerks loose.
#[test]
fn hard_friction_is_found_without_a_large_leap() {
    for scale in [0.3, 0.5, 0.8, 1.0, 1.3, 2.0] {
        for delay in [0, 1, 2] {
            let end = pushed(INERTIA, scale, 1e-9, 0.0, delay);
            assert!((end.share - scale).abs() < 0.05 * scale, "{scale} {delay}: {end:?}");
            assert!(end.hardest < 25.0 && (end.v - 0.1).abs() < 0.02, "{scale} {delay}: {end:?}");
        }
    }
}

#[test]
fn under_a_payload_that_is_not_found_the_model_is_believed() {
    for load in [-0.5, 0.1, 0.8] {
        let end = pushed(INERTIA, 1.0, 1e-3, load, 0);
        assert!(end.share == 1.0 && end.ready as u32 <= (WAITS + 1) * REST_TICKS, "{load}: {end:?}");
    }
}

#[test]
fn a_model_without_friction_or_inertia_is_not_probed() {
    assert!(!ConfirmedFriction::<1>::new(&SVector::zeros()).probe(true));
    let rest = FrictionResponse {
        torque: 0.0,
        excess: 0.0,
        inertia: 1.0,
        requested: 0.0,
        speed: 0.0,
        rests: true,
        noise: (0.0, 0.0),
    };
    for model in [Friction::default(), Friction { viscous: 1.0, coulomb: 1.9 }] {
        let mut confirmed = ConfirmedFriction::<1>::new(&SVector::repeat(1.0));
        confirmed.note(0, &model, &rest);
        assert_eq!((confirmed.probe(true), confirmed.share()[0]), (false, 1.0));
    }
}
