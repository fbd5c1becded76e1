//! The object's own motion, estimated from its measured poses: a Kalman filter with constant velocity between
//! measurements and white acceleration, for place and orientation.
//!
//! Everything is expressed in the frame W in which an object without motion of its own would rest. The state of each
//! half is a 3-vector error and its rate; the pose itself lives outside of the covariance, so that orientation needs no
//! angles (error-state filter).

use crate::geometry::{Pose, Twist};
use crate::time::MonoNs;
use nalgebra::{Matrix3, Matrix6, Matrix6x3, Translation3, UnitQuaternion, Vector3};

/// Standard deviation of the speed that an object may have when it is first seen, m/s and rad/s.
const FIRST_SPEED: f64 = 1.0;
/// Least standard deviation of a measured place, m, and of a measured orientation, rad: calibration is never perfect.
const LEAST_PLACE_SD_M: f64 = 5e-5;
const LEAST_ORIENTATION_SD_RAD: f64 = 2e-4;
/// Between measurements farther apart than this the old estimate is worth nothing.
const LONGEST_GAP_S: f64 = 1.0;

/// How quickly an object may change its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectDynamics {
    /// Standard deviation of the acceleration, m/s^2.
    pub acceleration_m_s2: f64,
    /// Standard deviation of the angular acceleration, rad/s^2.
    pub acceleration_rad_s2: f64,
    /// Standard deviation of the place at which the arm holds, m; it slows down from half of that on.
    pub largest_sd_m: f64,
}

/// Estimate of an object's pose and twist in W.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectMotion {
    dynamics: ObjectDynamics,
    estimate: Option<Estimate>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Estimate {
    stamp: MonoNs,
    X_WO: Pose,
    v: Vector3<f64>,
    w: Vector3<f64>,
    place: Half,
    orientation: Half,
    /// Whether more than one measurement told of the speed.
    speed_is_seen: bool,
}

/// Covariance of three errors and their rates.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Half {
    P: Matrix6<f64>,
}

impl Half {
    fn first(R: &Matrix3<f64>) -> Self {
        let mut P = Matrix6::identity() * (FIRST_SPEED * FIRST_SPEED);
        P.fixed_view_mut::<3, 3>(0, 0).copy_from(R);
        Self { P }
    }

    /// `P = F P F^T + Q` over `dt` seconds.
    fn predict(&mut self, dt: f64, acceleration: f64) {
        let mut F = Matrix6::identity();
        F.fixed_view_mut::<3, 3>(0, 3).fill_diagonal(dt);
        let q = acceleration * acceleration;
        let mut Q = Matrix6::zeros();
        Q.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(q * dt.powi(4) / 4.0);
        Q.fixed_view_mut::<3, 3>(0, 3).fill_diagonal(q * dt.powi(3) / 2.0);
        Q.fixed_view_mut::<3, 3>(3, 0).fill_diagonal(q * dt.powi(3) / 2.0);
        Q.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(q * dt * dt);
        self.P = F * self.P * F.transpose() + Q;
    }

    /// The corrections of the three values and of their rates for an innovation with covariance `R`.
    fn correct(
        &mut self,
        innovation: &Vector3<f64>,
        R: &Matrix3<f64>,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let S: Matrix3<f64> = self.P.fixed_view::<3, 3>(0, 0) + R;
        let K: Matrix6x3<f64> = self.P.fixed_columns::<3>(0) * S.try_inverse()?;
        let mut I_KH = Matrix6::identity();
        let mut left = I_KH.fixed_columns_mut::<3>(0);
        left -= K;
        // Joseph's form stays symmetric and positive.
        self.P = I_KH * self.P * I_KH.transpose() + K * R * K.transpose();
        let x = K * innovation;
        Some((x.fixed_rows::<3>(0).into(), x.fixed_rows::<3>(3).into()))
    }
}

impl ObjectMotion {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(dynamics: ObjectDynamics) -> Self {
        Self { dynamics, estimate: None }
    }

    /// Takes a pose `X_WO` measured at `stamp`, with the covariance of its twist `[v; w]` expressed in W (m, rad).
    ///
    /// A stamp that is not newer than the last one, or a pose that is not finite, is left out; after a long gap the
    /// filter starts anew.
    pub fn observe(&mut self, stamp: MonoNs, X_WO: &Pose, covariance: &Matrix6<f64>) {
        let finite = X_WO.to_homogeneous().iter().chain(covariance.iter()).all(|x| x.is_finite());
        if !finite {
            return;
        }
        let floor = |R: Matrix3<f64>, sd: f64| R + Matrix3::identity() * (sd * sd);
        let R_place = floor(covariance.fixed_view::<3, 3>(0, 0).into(), LEAST_PLACE_SD_M);
        let R_orientation = floor(covariance.fixed_view::<3, 3>(3, 3).into(), LEAST_ORIENTATION_SD_RAD);
        match &mut self.estimate {
            Some(e) if stamp <= e.stamp => {}
            Some(e) if (stamp - e.stamp).as_s() <= LONGEST_GAP_S => {
                e.update(stamp, X_WO, &R_place, &R_orientation, self.dynamics);
            }
            _ => {
                self.estimate = Some(Estimate {
                    stamp,
                    X_WO: *X_WO,
                    v: Vector3::zeros(),
                    w: Vector3::zeros(),
                    place: Half::first(&R_place),
                    orientation: Half::first(&R_orientation),
                    speed_is_seen: false,
                });
            }
        }
    }

    /// The object's displacement in W from `from` to `to`: it brings where the object's points were to where they will be.
    #[must_use]
    pub fn displacement(&self, from: MonoNs, to: MonoNs) -> Pose {
        self.estimate.as_ref().map_or_else(Pose::identity, |e| e.at(to) * e.at(from).inverse())
    }

    /// The object's twist in W, taken at the place `p_W`: that of a point which moves as if it were fixed to the object.
    #[must_use]
    pub fn twist_at(&self, time: MonoNs, p_W: &Vector3<f64>) -> Twist {
        let Some(e) = &self.estimate else { return Twist::zeros() };
        let v = e.v + e.w.cross(&(p_W - e.at(time).translation.vector));
        Twist::new(v.x, v.y, v.z, e.w.x, e.w.y, e.w.z)
    }

    /// Share of the wished velocity that the estimate of the place at `time` justifies: 1 for a good one, 0 where its
    /// standard deviation has reached the largest one, and before a second measurement has told of the speed.
    #[must_use]
    pub fn confidence(&self, time: MonoNs) -> f64 {
        if !self.estimate.is_some_and(|e| e.speed_is_seen) {
            return 0.0;
        }
        (2.0 - 2.0 * self.place_sd_m(time) / self.dynamics.largest_sd_m).clamp(0.0, 1.0)
    }

    /// Standard deviation of the place that the object is believed to have at `time`, m, the mean of the three axes;
    /// infinite before the first measurement. It grows with the time since the last one.
    #[must_use]
    pub fn place_sd_m(&self, time: MonoNs) -> f64 {
        self.estimate.as_ref().map_or(f64::INFINITY, |e| {
            let (dt, P) = ((time - e.stamp).as_s(), &e.place.P);
            let trace = |i: usize, j: usize| (0..3).map(|k| P[(i + k, j + k)]).sum::<f64>() / 3.0;
            let own = self.dynamics.acceleration_m_s2 * dt * dt / 2.0;
            (trace(0, 0) + 2.0 * dt * trace(0, 3) + dt * dt * trace(3, 3) + own * own).max(0.0).sqrt()
        })
    }

    /// Standard deviation of the speed estimate, m/s; infinite before the first measurement.
    #[must_use]
    pub fn speed_sd_m_s(&self) -> f64 {
        self.estimate.as_ref().map_or(f64::INFINITY, |e| {
            let P = &e.place.P;
            ((P[(3, 3)] + P[(4, 4)] + P[(5, 5)]) / 3.0).sqrt()
        })
    }
}

impl Estimate {
    fn at(&self, time: MonoNs) -> Pose {
        let dt = (time - self.stamp).as_s();
        Pose::from_parts(
            Translation3::from(self.X_WO.translation.vector + self.v * dt),
            UnitQuaternion::from_scaled_axis(self.w * dt) * self.X_WO.rotation,
        )
    }

    fn update(
        &mut self,
        stamp: MonoNs,
        measured: &Pose,
        R_place: &Matrix3<f64>,
        R_orientation: &Matrix3<f64>,
        dynamics: ObjectDynamics,
    ) {
        let dt = (stamp - self.stamp).as_s();
        let predicted = self.at(stamp);
        self.place.predict(dt, dynamics.acceleration_m_s2);
        self.orientation.predict(dt, dynamics.acceleration_rad_s2);
        let off = measured.translation.vector - predicted.translation.vector;
        let turn = (measured.rotation * predicted.rotation.inverse()).scaled_axis();
        (self.stamp, self.X_WO) = (stamp, predicted);
        self.speed_is_seen = true;
        if let Some((p, v)) = self.place.correct(&off, R_place) {
            self.X_WO.translation.vector += p;
            self.v += v;
        }
        if let Some((angle, w)) = self.orientation.correct(&turn, R_orientation) {
            self.X_WO.rotation = UnitQuaternion::from_scaled_axis(angle) * self.X_WO.rotation;
            self.w += w;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::SpanNs;
    use proptest::prelude::*;

    const FRAME: SpanNs = SpanNs(40_000_000);
    const DYNAMICS: ObjectDynamics =
        ObjectDynamics { acceleration_m_s2: 0.5, acceleration_rad_s2: 1.0, largest_sd_m: 0.05 };

    fn moving(v: &Vector3<f64>, w: &Vector3<f64>, t: f64) -> Pose {
        let turn = UnitQuaternion::from_scaled_axis(w * t);
        Pose::from_parts(Translation3::from(Vector3::new(1.0, 0.5, 0.2) + v * t), turn)
    }

    fn noise(k: u64, sd: f64) -> Vector3<f64> {
        // Irwin-Hall of twelve even numbers: nearly Gaussian, and the same at every run.
        let random =
            |i: u64| xxhash_rust::xxh3::xxh3_64_with_seed(&i.to_le_bytes(), k) as f64 / u64::MAX as f64;
        Vector3::from_fn(|i, _| ((0..12).map(|j| random(12 * i as u64 + j)).sum::<f64>() - 6.0) * sd)
    }

    proptest! {
        #[test]
        fn a_steady_motion_is_learnt_and_carried_on(
            v in prop::array::uniform3(-0.3..0.3f64), w in prop::array::uniform3(-0.5..0.5f64), sd_m in 1e-6..1e-3f64
        ) {
            let (v, w) = (Vector3::from(v), Vector3::from(w));
            let mut motion = ObjectMotion::new(DYNAMICS);
            let R = Matrix6::from_diagonal(&nalgebra::Vector6::repeat(sd_m * sd_m));
            let mut now = MonoNs(1_000_000_000);
            for k in 0..50 {
                let mut X = moving(&v, &w, k as f64 * 0.04);
                X.translation.vector += noise(k, sd_m);
                X.rotation = UnitQuaternion::from_scaled_axis(noise(k + 1000, sd_m)) * X.rotation;
                motion.observe(now, &X, &R);
                now = now + FRAME;
            }
            let last = now - FRAME;
            let wanted = moving(&v, &w, 49.0 * 0.04 + 0.06) * moving(&v, &w, 49.0 * 0.04).inverse();
            let got = motion.displacement(last, last + SpanNs(60_000_000));
            // Worst of three axes at the filter's own uncertainty over 60 ms.
            let allowed = 0.06 * 5.0 * motion.speed_sd_m_s() + 1e-4;
            prop_assert!((got.translation.vector - wanted.translation.vector).norm() < 3.0 * allowed, "{got} {wanted}");
            let V = motion.twist_at(last, &moving(&v, &w, 49.0 * 0.04).translation.vector);
            prop_assert!((V.fixed_rows::<3>(0) - v).norm() < 6.0 * motion.speed_sd_m_s() + 2e-3, "{V} {v}");
        }
    }

    #[test]
    fn an_object_at_rest_is_not_set_in_motion_by_noise() {
        let mut motion = ObjectMotion::new(ObjectDynamics {
            acceleration_m_s2: 0.05,
            acceleration_rad_s2: 0.1,
            ..DYNAMICS
        });
        let R = Matrix6::from_diagonal(&nalgebra::Vector6::repeat(1e-8));
        for k in 0..100 {
            let mut X = Pose::identity();
            X.translation.vector += noise(k, 1e-4);
            motion.observe(MonoNs(k as i64 * FRAME.0), &X, &R);
        }
        let V = motion.twist_at(MonoNs(99 * FRAME.0), &Vector3::zeros());
        assert!(V.fixed_rows::<3>(0).norm() < 5e-3, "{V}");
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
    fn confidence_comes_with_the_second_measurement_and_goes_with_time() {
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
}
