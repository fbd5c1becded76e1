use super::*;
use crate::time::SpanNs;

const FRAME: SpanNs = SpanNs(40_000_000);
const DYNAMICS: ObjectDynamics =
    ObjectDynamics { acceleration_m_s2: 0.5, acceleration_rad_s2: 1.0, largest_sd_m: 0.05 };

fn moving(v: &Vector3<f64>, w: &Vector3<f64>, t: f64) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(w * t);
    Pose::from_parts(Translation3::from(Vector3::new(1.0, 0.5, 0.2) + v * t), turn)
}

fn noise(k: u64, sd: f64) -> Vector3<f64> {
    // Irwin-Hall of twelve even numbers: nearly Gaussian, and the same at every run.
    let random = |i: u64| xxhash_rust::xxh3::xxh3_64_with_seed(&i.to_le_bytes(), k) as f64 / u64::MAX as f64;
    Vector3::from_fn(|i, _| ((0..12).map(|j| random(12 * i as u64 + j)).sum::<f64>() - 6.0) * sd)
}

/// The pose that was truly there, and its twist.
#[derive(Clone, Copy)]
struct TrueMotion {
    X_WO: Pose,
    v: Vector3<f64>,
    w: Vector3<f64>,
}

impl TrueMotion {
    /// Moves on for one frame under constant accelerations.
    fn advance(&mut self, a: &Vector3<f64>, b: &Vector3<f64>) {
        let dt = FRAME.as_s();
        self.X_WO.translation.vector += self.v * dt + a * (dt * dt / 2.0);
        let turn = UnitQuaternion::from_scaled_axis(self.w * dt + b * (dt * dt / 2.0));
        self.X_WO.rotation = turn * self.X_WO.rotation;
        (self.v, self.w) = (self.v + a * dt, self.w + b * dt);
    }

    /// As a camera with errors of these standard deviations, m and rad, sees it.
    fn seen(&self, k: u64, place_sd_m: f64, orientation_sd_rad: f64) -> Pose {
        let mut X = self.X_WO;
        X.translation.vector += noise(4 * k, place_sd_m);
        X.rotation = UnitQuaternion::from_scaled_axis(noise(4 * k + 1, orientation_sd_rad)) * X.rotation;
        X
    }

    /// Errors of an estimate in units of its own standard deviations, squared: place and speed, orientation and rate.
    /// For an honest filter each is 6 in the mean, by the chi-square distribution of six degrees of freedom.
    fn normalized_errors_squared(&self, motion: &ObjectMotion) -> [f64; 2] {
        let e = motion.estimate.unwrap();
        let normalized = |value: Vector3<f64>, rate: Vector3<f64>, half: &Half| {
            let x = nalgebra::Vector6::new(value.x, value.y, value.z, rate.x, rate.y, rate.z);
            x.dot(&(half.P.try_inverse().unwrap() * x))
        };
        let off = self.X_WO.translation.vector - e.X_WO.translation.vector;
        let turn = (self.X_WO.rotation * e.X_WO.rotation.inverse()).scaled_axis();
        [normalized(off, self.v - e.v, &e.place), normalized(turn, self.w - e.w, &e.orientation)]
    }
}

const RUNS: u64 = 1000;

fn observed(acceleration: f64, seed: u64, sd: f64, frames: u64) -> (TrueMotion, ObjectMotion) {
    let mut motion = ObjectMotion::new(DYNAMICS);
    let mut truth = TrueMotion {
        X_WO: Pose::new(Vector3::new(1.0, 0.5, 0.2), Vector3::new(0.3, -0.2, 1.0)),
        v: noise(seed, 0.2),
        w: noise(seed + 1, 0.3),
    };
    let R = Matrix6::from_diagonal(&nalgebra::Vector6::repeat(sd * sd));
    // What the filter takes for the least error of a calibration is an error like any other.
    let (place_sd, orientation_sd) = (sd.hypot(MIN_PLACE_SD_M), sd.hypot(MIN_ORIENTATION_SD_RAD));
    for k in 0..frames {
        let id = seed * 1000 + k;
        motion.observe(MonoNs(k as i64 * FRAME.0), &truth.seen(id, place_sd, orientation_sd), &R);
        if k + 1 < frames {
            let a = noise(4 * id + 2, acceleration * DYNAMICS.acceleration_m_s2);
            let b = noise(4 * id + 3, acceleration * DYNAMICS.acceleration_rad_s2);
            truth.advance(&a, &b);
        }
    }
    (truth, motion)
}

/// Objects that accelerate as the filter believes: its covariance is then that of its errors, neither more nor less.
#[test]
fn the_stated_uncertainty_is_that_of_the_errors() {
    for sd in [1e-5, 1e-4, 1e-3] {
        for frames in [3, 10, 50] {
            let (mut place, mut orientation, mut speed) = (0.0, 0.0, 0.0);
            for seed in 0..RUNS {
                let (truth, motion) = observed(1.0, seed, sd, frames);
                let [a, b] = truth.normalized_errors_squared(&motion);
                let off = (motion.estimate.unwrap().v - truth.v) / motion.speed_sd_m_s();
                place += a / RUNS as f64;
                orientation += b / RUNS as f64;
                speed += off.norm_squared() / 3.0 / RUNS as f64;
            }
            // The mean of a thousand has a standard deviation of sqrt(2 * 6 / 1000) = 0.11; that of the speed 0.03.
            assert!((place - 6.0).abs() < 0.5, "place, {sd}, {frames} frames: {place}");
            assert!((orientation - 6.0).abs() < 0.5, "orientation, {sd}, {frames} frames: {orientation}");
            assert!((speed - 1.0).abs() < 0.13, "speed, {sd}, {frames} frames: {speed}");
        }
    }
}

/// No linear filter does better: its speed has the standard deviation of the steady alpha-beta filter, whose gains follow
/// from the tracking index `a dt^2 / r` in closed form (Kalata).
#[test]
fn the_speed_is_as_certain_as_it_can_be() {
    let dt = FRAME.as_s();
    for sd in [1e-5, 1e-4, 1e-3] {
        let r = f64::hypot(sd, MIN_PLACE_SD_M);
        let index = DYNAMICS.acceleration_m_s2 * dt * dt / r;
        let root = (4.0 + index - (8.0 * index + index * index).sqrt()) / 4.0;
        let alpha = 1.0 - root * root;
        let beta = 2.0 * (2.0 - alpha) - 4.0 * root;
        let variance = beta * (alpha - beta / 2.0) / (1.0 - alpha) * (r / dt).powi(2);
        let stated = observed(1.0, 1, sd, 50).1.speed_sd_m_s();
        assert!((stated / variance.sqrt() - 1.0).abs() < 1e-3, "{sd}: {stated}, at best {}", variance.sqrt());
    }
}

/// Objects that do not accelerate, carried on for 60 ms: within what the filter states, and better in the mean, because
/// it allows for accelerations that do not come.
#[test]
fn a_steady_motion_is_learnt_and_carried_on() {
    for sd in [1e-5, 1e-4, 1e-3] {
        let mut mean = 0.0;
        for seed in 0..RUNS {
            let (mut truth, motion) = observed(0.0, seed, sd, 50);
            let last = motion.estimate.unwrap().stamp;
            let (ahead, seen) = (last + SpanNs(60_000_000), truth.X_WO);
            truth.X_WO.translation.vector += truth.v * 0.06;
            truth.X_WO.rotation = UnitQuaternion::from_scaled_axis(truth.w * 0.06) * seen.rotation;
            let carried = motion.displacement(last, ahead) * seen;
            // Where the object was is given here: what is left is the error of the speed, over 60 ms.
            let off = carried.translation.vector - truth.X_WO.translation.vector;
            let stated = 0.06 * motion.speed_sd_m_s();
            assert!(off.norm() < 3.5 * stated, "{sd}, {seed}: {} of {stated} m", off.norm());
            mean += off.norm_squared() / 3.0 / stated.powi(2) / RUNS as f64;
            let P = &motion.estimate.unwrap().orientation.P;
            let stated = 0.06 * ((P[(3, 3)] + P[(4, 4)] + P[(5, 5)]) / 3.0).sqrt();
            let off = carried.rotation.angle_to(&truth.X_WO.rotation);
            assert!(off < 3.5 * stated, "{sd}, {seed}: {off} of {stated} rad");
        }
        assert!(mean < 0.3, "{sd}: {mean}"); // the agile filter alone has 0.2 to 0.6
    }
}

#[test]
fn an_object_at_rest_is_not_set_in_motion_by_noise() {
    let R = Matrix6::from_diagonal(&nalgebra::Vector6::repeat(1e-8));
    let (mut moved, mut largest) = (0, 0.0_f64);
    for seed in 0..200 {
        let mut motion = ObjectMotion::new(DYNAMICS);
        for k in 0..100 {
            let mut X = Pose::identity();
            X.translation.vector += noise(seed * 200 + 2 * k, 1e-4);
            X.rotation = UnitQuaternion::from_scaled_axis(noise(seed * 200 + 2 * k + 1, 1e-4));
            motion.observe(MonoNs(k as i64 * FRAME.0), &X, &R);
            let V = motion.twist_at(MonoNs(k as i64 * FRAME.0), &Vector3::zeros());
            if k >= 20 {
                moved += u32::from(V != Twist::zeros());
                largest = largest.max(V.norm());
            }
        }
    }
    assert!(moved < 200 * 80 / 50, "in {moved} of {} frames", 200 * 80);
    assert!(largest < 5e-3, "{largest} m/s and rad/s");
}

/// One that starts to move is followed after a few frames, and rests again when it stands.
#[test]
fn a_start_and_a_stop_are_noticed() {
    let mut motion = ObjectMotion::new(DYNAMICS);
    let R = Matrix6::from_diagonal(&nalgebra::Vector6::repeat(1e-8));
    let mut x = 0.0;
    for k in 0..150_u64 {
        let speed = if (50..100).contains(&k) { 0.1 } else { 0.0 };
        let mut X = Pose::translation(x, 0.0, 0.0);
        X.translation.vector += noise(k, 1e-4);
        motion.observe(MonoNs(k as i64 * FRAME.0), &X, &R);
        x += speed * FRAME.as_s();
        let v = motion.twist_at(MonoNs(k as i64 * FRAME.0), &Vector3::zeros()).x;
        if (60..100).contains(&k) {
            assert!((v - 0.1).abs() < 0.02, "{k}: {v}");
        } else if (30..=50).contains(&k) || k > 125 {
            assert!(v.abs() < 3e-3, "{k}: {v}");
        }
    }
}

/// An object that is put elsewhere is at its new place at once, keeps its velocity, and is not set in motion; what is as far off again was quick.
#[test]
fn a_leap_is_a_new_place_and_no_speed() {
    let R = Matrix6::from_diagonal(&nalgebra::Vector6::repeat(1e-8));
    for speed in [0.0, 0.1] {
        let mut motion = ObjectMotion::new(DYNAMICS);
        for k in 0..60_u64 {
            let leapt = if k < 40 { 0.0 } else { 0.07 };
            let mut X = Pose::translation(speed * k as f64 * FRAME.as_s() + leapt, 0.0, 0.0);
            X.translation.vector += noise(k, 1e-4);
            let now = MonoNs(k as i64 * FRAME.0);
            motion.observe(now, &X, &R);
            if k >= 30 {
                let v = motion.twist_at(now, &Vector3::zeros()).x;
                assert!((v - speed).abs() < 0.02, "{speed}, frame {k}: {v} m/s");
                assert!(motion.confidence(now) > 0.9, "{speed}, frame {k}");
            }
        }
    }
    let mut motion = ObjectMotion::new(DYNAMICS);
    for k in 0..20_i64 {
        let X = Pose::translation(0.08 * (k - 9).max(0) as f64, 0.0, 0.0);
        motion.observe(MonoNs(k * FRAME.0), &X, &R);
    }
    let v = motion.twist_at(MonoNs(19 * FRAME.0), &Vector3::zeros()).x;
    assert!((v - 2.0).abs() < 0.1, "{v} m/s");
}

#[test]
fn old_odd_and_missing_measurements_do_no_harm() {
    let mut motion = ObjectMotion::new(DYNAMICS);
    assert_eq!(motion.displacement(MonoNs(0), MonoNs(1_000_000)), Pose::identity());
    assert_eq!(motion.twist_at(MonoNs(0), &Vector3::zeros()), Twist::zeros());
    assert_eq!(motion.speed_sd_m_s(), f64::INFINITY);
    let R = Matrix6::identity() * 1e-8;
    let at = |x: f64| Pose::translation(x, 0.0, 0.0);
    motion.observe(MonoNs(100), &at(0.0), &R);
    let before = motion;
    motion.observe(MonoNs(100), &at(5.0), &R);
    motion.observe(MonoNs(50), &at(5.0), &R);
    motion.observe(MonoNs(200), &at(f64::NAN), &R);
    assert_eq!(motion, before);
    motion.observe(MonoNs(10_000_000_000), &at(5.0), &R);
    let V = motion.twist_at(MonoNs(10_000_000_000), &Vector3::zeros());
    assert_eq!(V, Twist::zeros(), "a jump after a long gap is a new start, not a speed");
}

#[test]
fn confidence_starts_at_two_measurements_and_decays() {
    let mut motion = ObjectMotion::new(DYNAMICS);
    let R = Matrix6::identity() * 1e-8;
    let v = Vector3::new(0.1, 0.0, 0.0);
    let at = |k: i64| MonoNs(k * FRAME.0);
    assert_eq!(motion.confidence(at(0)), 0.0);
    motion.observe(at(0), &moving(&v, &Vector3::zeros(), 0.0), &R);
    assert_eq!(motion.confidence(at(0)), 0.0, "nothing is known of the speed");
    for k in 1..20 {
        motion.observe(at(k), &moving(&v, &Vector3::zeros(), k as f64 * 0.04), &R);
    }
    let sd = |ms: i64| motion.place_sd_m(at(19) + SpanNs(ms * 1_000_000));
    let confidence = |ms: i64| motion.confidence(at(19) + SpanNs(ms * 1_000_000));
    assert!(sd(0) < 2e-4 && sd(100) > sd(50) && sd(50) > sd(0));
    // An acceleration of one standard deviation moves it by a t^2 / 2, a little more with the speed's own doubt.
    assert!(sd(400) > 0.04 && sd(400) < 0.06, "{}", sd(400));
    assert_eq!((confidence(0), confidence(100), confidence(600)), (1.0, 1.0, 0.0));
    assert!(confidence(350) > 0.0 && confidence(350) < 1.0, "{}", confidence(350));
}

/// Circles and pendulums, with the noise of a target that is near (0.03 mm), carried on for 60 ms: the errors are less than half of what a constant velocity between measurements leaves.
#[test]
fn an_acceleration_that_lasts_is_carried_on() {
    use std::f64::consts::TAU;
    for (radius_m, hz, is_circle) in
        [(0.1, 0.5, true), (0.05, 0.5, false), (0.07, 0.4, true), (0.1, 0.3, false), (0.03, 0.7, true)]
    {
        let at = |t: f64| {
            let turn = TAU * hz * t;
            let aside = if is_circle { radius_m * turn.cos() } else { 0.0 };
            Vector3::new(radius_m * turn.sin(), aside, 0.3)
        };
        let dynamics = ObjectDynamics { acceleration_m_s2: 0.3, ..DYNAMICS };
        let (mut with, mut without, mut motion) = (0.0, 0.0, ObjectMotion::new(dynamics));
        let R = Matrix6::from_diagonal(&nalgebra::Vector6::repeat(9e-10));
        for k in 0..250_u64 {
            let (stamp, t) = (MonoNs(k as i64 * FRAME.0), 0.04 * k as f64);
            let mut X = Pose::identity();
            X.translation.vector = at(t) + noise(7000 + k, 3e-5);
            motion.observe(stamp, &X, &R);
            if k >= 50 {
                let (ahead, moved) = (stamp + SpanNs(60_000_000), at(t + 0.06) - at(t));
                let agile = motion.estimate.unwrap();
                let straight = agile.at(ahead).translation.vector - agile.at(stamp).translation.vector;
                let foretold = motion.displacement(stamp, ahead).translation.vector;
                with += (foretold - moved).norm_squared();
                without += (straight - moved).norm_squared();
            }
        }
        let (with, without) = ((with / 200.0_f64).sqrt(), (without / 200.0_f64).sqrt());
        assert!(with < 0.5 * without, "{radius_m} m, {hz} Hz: {with} m, {without} m at a constant velocity");
    }
}
