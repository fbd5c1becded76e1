//! The object's own motion, estimated from its measured poses by Kalman filters for position and orientation, with the model of constant velocity
//! between measurements and white acceleration.
//!
//! Data flow: [`ObjectMotion::observe`] takes each measured pose `X_WO` with its covariance; [`ObjectMotion::displacement`] and
//! [`ObjectMotion::twist_at`] predict motion between two times; [`ObjectMotion::confidence`] says how far the estimate can be relied on.
//!
//! Everything is expressed in the frame W in which an object without motion of its own would rest. The state of each
//! half is a 3-vector error and its rate; the pose itself lives outside of the covariance, so that orientation needs no
//! angles (error-state filter).
//!
//! Two such filters run side by side. The agile filter has the process noise of the accelerations that the object may have, and therefore a noisy
//! velocity. The quiet filter has hardly any process noise. Its velocity is used as long as the measurements fit it, which the mean of its
//! normalized squared innovations shows (1 for a consistent filter); the part of it that is not significant against its covariance is set
//! to zero, so that an object at rest has no estimated motion. Between both filters the velocity is interpolated by that mean. Where a third one, which
//! estimates the acceleration of the place too, foretells measurements better ([`acceleration`]), that is believed.
//!
//! An object that is put elsewhere between two measurements leaps: it has a new place and the velocity that it had. What would need a velocity of its own beyond 1 m/s is taken for a leap
//! once; where the next measurement is as far off again, it was speed.

mod acceleration;

use crate::geometry::{Pose, Twist};
use crate::time::MonoNs;
use acceleration::AcceleratingPlace;
use nalgebra::{Matrix3, Matrix6, Matrix6x3, Translation3, UnitQuaternion, Vector3};

/// Standard deviation of the speed that an object may have at its first measurement, m/s and rad/s: more than an arm could follow, so that the
/// second measurement decides. Half and twice of it change no unit test.
const FIRST_SPEED: f64 = 1.0;
/// Least standard deviation of a measured place, m, and of a measured orientation, rad: calibration is never perfect. Chosen by hand: half and
/// twice of each change no unit test, which draw their errors by these numbers though.
const MIN_PLACE_SD_M: f64 = 5e-5;
const MIN_ORIENTATION_SD_RAD: f64 = 2e-4;
/// Between measurements farther apart than this the old estimate is worth nothing. Chosen by hand: half and twice change no unit test.
const LONGEST_GAP_S: f64 = 1.0;

/// Share of the accelerations that the quiet filter allows for. Chosen by hand: half and twice of it change no unit test.
const QUIET_SHARE: f64 = 0.03;
/// Number of innovations in the mean by which the quiet filter is judged: a third of a second at 25 Hz. With half of it `an_object_at_rest_is_not_set_in_motion_by_noise`
/// fails, with twice of it no test.
const JUDGED: f64 = 8.0;
/// Mean squared innovations up to which the quiet filter alone is used, and from which on the agile filter alone is. Of a filter that fits, each squared innovation is
/// chi-square / 3 of three degrees of freedom, variance 2 / 3, and the running mean of eight has the standard deviation
/// sqrt(2 / 3 / 15) = 0.21: the first is three of these above 1, the second seven, so that noise alone seldom switches to the agile filter.
/// With half of both the test of an object at rest fails, with twice of both none.
const FITS: (f64, f64) = (1.6, 2.6);
/// Squared speed in units of its covariance, three degrees of freedom: noise up to the first, the 99.5 % quantile of chi-square (12.8),
/// and all of it counts from the second on, which noise reaches once in 700 000 frames.
const SIGNIFICANT: (f64, f64) = (13.0, 30.0);

/// How quickly an object may change its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectDynamics {
    /// Standard deviation of the acceleration, m/s^2.
    pub acceleration_m_s2: f64,
    /// Standard deviation of the angular acceleration, rad/s^2.
    pub acceleration_rad_s2: f64,
    /// Standard deviation of the predicted position at which the arm holds, m; it slows down from half of that on.
    pub largest_sd_m: f64,
}

/// Estimate of an object's pose and twist in W.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectMotion {
    dynamics: ObjectDynamics,
    /// The agile filter.
    estimate: Option<Estimate>,
    quiet: Option<Estimate>,
    /// Mean normalized squared innovation of the quiet filter: place, orientation.
    misfit: [f64; 2],
    /// Of a place that accelerates.
    accelerating: Option<AcceleratingPlace>,
    /// Whether the last measurement was taken for a leap.
    leapt: bool,
    /// The agile filter's pose with the velocity interpolated between both filters.
    believed: Option<Estimate>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Estimate {
    stamp: MonoNs,
    X_WO: Pose,
    v: Vector3<f64>,
    w: Vector3<f64>,
    /// Acceleration of the place, where it is believed.
    a: Vector3<f64>,
    place: Half,
    orientation: Half,
    /// Whether there was more than one measurement, so that a velocity is observable.
    speed_is_seen: bool,
}

/// Covariance of three errors (position or orientation) and their rates, 6 x 6.
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

    /// The three values are measured anew, with covariance `R`, and tell nothing of their rates.
    fn leap(&mut self, R: &Matrix3<f64>) {
        let rates: Matrix3<f64> = self.P.fixed_view::<3, 3>(3, 3).into();
        self.P = Matrix6::zeros();
        self.P.fixed_view_mut::<3, 3>(0, 0).copy_from(R);
        self.P.fixed_view_mut::<3, 3>(3, 3).copy_from(&rates);
    }

    /// The corrections of the three values and of their rates for an innovation with covariance `R`, and its square in units of
    /// what was expected, by degree of freedom.
    fn correct(
        &mut self,
        innovation: &Vector3<f64>,
        R: &Matrix3<f64>,
    ) -> Option<(Vector3<f64>, Vector3<f64>, f64)> {
        let S: Matrix3<f64> = self.P.fixed_view::<3, 3>(0, 0) + R;
        let S_inverse = S.try_inverse()?;
        let square = innovation.dot(&(S_inverse * innovation)) / 3.0;
        let K: Matrix6x3<f64> = self.P.fixed_columns::<3>(0) * S_inverse;
        let mut I_KH = Matrix6::identity();
        let mut left = I_KH.fixed_columns_mut::<3>(0);
        left -= K;
        // Joseph's form stays symmetric and positive.
        self.P = I_KH * self.P * I_KH.transpose() + K * R * K.transpose();
        let x = K * innovation;
        Some((x.fixed_rows::<3>(0).into(), x.fixed_rows::<3>(3).into(), square))
    }

    /// The significant part of a `rate`: 0 where it is within its covariance, all of it where it is far outside.
    fn significant(&self, rate: &Vector3<f64>) -> Vector3<f64> {
        let P: Matrix3<f64> = self.P.fixed_view::<3, 3>(3, 3).into();
        let square = P.try_inverse().map_or(0.0, |inverse| rate.dot(&(inverse * rate)));
        rate * share(square, SIGNIFICANT)
    }
}

/// 0 up to the first of `ends`, 1 from the second on.
fn share(x: f64, ends: (f64, f64)) -> f64 {
    ((x - ends.0) / (ends.1 - ends.0)).clamp(0.0, 1.0)
}

impl ObjectMotion {
    /// An estimator without measurements.
    #[must_use]
    pub fn new(dynamics: ObjectDynamics) -> Self {
        Self {
            dynamics,
            estimate: None,
            quiet: None,
            misfit: [1.0; 2],
            accelerating: None,
            leapt: false,
            believed: None,
        }
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
        let R_place = floor(covariance.fixed_view::<3, 3>(0, 0).into(), MIN_PLACE_SD_M);
        let R_orientation = floor(covariance.fixed_view::<3, 3>(3, 3).into(), MIN_ORIENTATION_SD_RAD);
        match &mut self.estimate {
            Some(e) if stamp <= e.stamp => {}
            Some(e) if (stamp - e.stamp).as_s() <= LONGEST_GAP_S => {
                let p = X_WO.translation.vector;
                let innovation = p - e.at(stamp).translation.vector;
                self.leapt = !self.leapt && e.leaps(stamp, &innovation, &R_place);
                let leaps = self.leapt;
                if let Some(place) = &mut self.accelerating {
                    let (seen, acceleration) = ((&p, R_place.trace() / 3.0), self.dynamics.acceleration_m_s2);
                    place.observe(stamp, seen, acceleration, Some(&innovation).filter(|_| !leaps));
                }
                let covariances = (&R_place, &R_orientation);
                e.update(stamp, X_WO, covariances, self.dynamics, leaps);
                let agile = *e;
                if let Some(quiet) = &mut self.quiet {
                    let squares = quiet.update(stamp, X_WO, covariances, self.dynamics.quiet(), leaps);
                    for (misfit, square) in self.misfit.iter_mut().zip(squares) {
                        let Some(square) = square else { continue };
                        *misfit += (square.min(JUDGED * FITS.1) - *misfit) / JUDGED;
                    }
                }
                self.believe(agile);
            }
            _ => {
                let first = Some(Estimate {
                    stamp,
                    X_WO: *X_WO,
                    v: Vector3::zeros(),
                    w: Vector3::zeros(),
                    a: Vector3::zeros(),
                    place: Half::first(&R_place),
                    orientation: Half::first(&R_orientation),
                    speed_is_seen: false,
                });
                (self.estimate, self.quiet, self.believed) = (first, first, first);
                (self.misfit, self.leapt) = ([1.0; 2], false);
                self.accelerating = Some(AcceleratingPlace::first(
                    stamp,
                    X_WO.translation.vector,
                    R_place.trace() / 3.0,
                    (FIRST_SPEED, self.dynamics.acceleration_m_s2),
                ));
            }
        }
    }

    /// Interpolates the velocity between the quiet filter, as far as it fits, and the agile one; a quiet filter that does not fit at all is
    /// initialized anew from the agile one.
    fn believe(&mut self, agile: Estimate) {
        let Some(quiet) = &mut self.quiet else { return };
        let mut believed = agile;
        let [place, orientation] = self.misfit.map(|misfit| share(misfit, FITS));
        let misfits = place > 0.0;
        let at_rest = (quiet.place.significant(&quiet.v), quiet.orientation.significant(&quiet.w));
        believed.v = at_rest.0 + (agile.v - at_rest.0) * place;
        believed.w = at_rest.1 + (agile.w - at_rest.1) * orientation;
        if place >= 1.0 {
            (quiet.v, quiet.place) = (agile.v, agile.place);
            quiet.X_WO.translation = agile.X_WO.translation;
        }
        if orientation >= 1.0 {
            (quiet.w, quiet.orientation) = (agile.w, agile.orientation);
            quiet.X_WO.rotation = agile.X_WO.rotation;
        }
        // What fits a quiet motion is not set in motion by a third filter.
        if let Some(place) = self.accelerating.filter(|_| misfits) {
            let trust = place.trust();
            believed.X_WO.translation.vector += (place.p - believed.X_WO.translation.vector) * trust;
            believed.v += (place.v - believed.v) * trust;
            believed.a = place.a * trust;
        }
        self.believed = Some(believed);
    }

    /// Predicted displacement of the object in W from time `from` to `to`: the transformation that maps old positions of its points to new ones.
    #[must_use]
    pub fn displacement(&self, from: MonoNs, to: MonoNs) -> Pose {
        self.believed.as_ref().map_or_else(Pose::identity, |e| e.at(to) * e.at(from).inverse())
    }

    /// Predicted twist of the object in W, m/s and rad/s, with the point `p_W` (m) of the moving body as reference point.
    #[must_use]
    pub fn twist_at(&self, time: MonoNs, p_W: &Vector3<f64>) -> Twist {
        let Some(e) = &self.believed else { return Twist::zeros() };
        let v = e.v + e.a * (time - e.stamp).as_s() + e.w.cross(&(p_W - e.at(time).translation.vector));
        Twist::new(v.x, v.y, v.z, e.w.x, e.w.y, e.w.z)
    }

    /// Factor in 0..=1 for the requested velocity, by the standard deviation of the position at `time`: 1 for a good estimate, 0 where the deviation
    /// has reached [`ObjectDynamics::largest_sd_m`], and before a second measurement.
    #[must_use]
    pub fn confidence(&self, time: MonoNs) -> f64 {
        if !self.estimate.is_some_and(|e| e.speed_is_seen) {
            return 0.0;
        }
        (2.0 - 2.0 * self.place_sd_m(time) / self.dynamics.largest_sd_m).clamp(0.0, 1.0)
    }

    /// Standard deviation of the object's predicted position at `time`, m, the mean of the three axes;
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

impl ObjectDynamics {
    fn quiet(&self) -> Self {
        Self {
            acceleration_m_s2: QUIET_SHARE * self.acceleration_m_s2,
            acceleration_rad_s2: QUIET_SHARE * self.acceleration_rad_s2,
            ..*self
        }
    }
}

impl Estimate {
    fn at(&self, time: MonoNs) -> Pose {
        let dt = (time - self.stamp).as_s();
        Pose::from_parts(
            Translation3::from(self.X_WO.translation.vector + self.v * dt + self.a * (dt * dt / 2.0)),
            UnitQuaternion::from_scaled_axis(self.w * dt) * self.X_WO.rotation,
        )
    }

    /// Whether a place that was measured at `stamp` with the covariance `R_place`, and lies off the predicted one by `innovation` (m), is that of an object that was put elsewhere: no speed that it may
    /// have leads there, nor noise.
    fn leaps(&self, stamp: MonoNs, innovation: &Vector3<f64>, R_place: &Matrix3<f64>) -> bool {
        let is_far = innovation.norm() > FIRST_SPEED * (stamp - self.stamp).as_s();
        let square = || R_place.try_inverse().map_or(0.0, |inverse| innovation.dot(&(inverse * innovation)));
        self.speed_is_seen && is_far && square() > SIGNIFICANT.1
    }

    /// Corrects the filter by a measured pose with the covariances of place and orientation, or moves it there where the place `leaps`. Returns the squared innovations of position and orientation
    /// as [`Half::correct`] gives them, of a leap none.
    fn update(
        &mut self,
        stamp: MonoNs,
        measured: &Pose,
        (R_place, R_orientation): (&Matrix3<f64>, &Matrix3<f64>),
        dynamics: ObjectDynamics,
        leaps: bool,
    ) -> [Option<f64>; 2] {
        let dt = (stamp - self.stamp).as_s();
        let predicted = self.at(stamp);
        self.place.predict(dt, dynamics.acceleration_m_s2);
        self.orientation.predict(dt, dynamics.acceleration_rad_s2);
        let off = measured.translation.vector - predicted.translation.vector;
        let turn = (measured.rotation * predicted.rotation.inverse()).scaled_axis();
        (self.stamp, self.X_WO) = (stamp, predicted);
        self.speed_is_seen = true;
        let mut squares = [None; 2];
        if leaps {
            self.X_WO.translation = measured.translation;
            self.place.leap(R_place);
        } else if let Some((p, v, square)) = self.place.correct(&off, R_place) {
            self.X_WO.translation.vector += p;
            self.v += v;
            squares[0] = Some(square);
        }
        if let Some((angle, w, square)) = self.orientation.correct(&turn, R_orientation) {
            self.X_WO.rotation = UnitQuaternion::from_scaled_axis(angle) * self.X_WO.rotation;
            self.w += w;
            squares[1] = Some(square);
        }
        squares
    }
}

#[cfg(test)]
mod tests;
