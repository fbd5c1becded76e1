//! The place of an object that accelerates smoothly (on a circle, a pendulum, in a curve): a Kalman filter for place, velocity and acceleration, with white jerk between measurements.
//!
//! It stands beside the filters of constant velocity ([`super`]) and is judged by what it foretells: by the mean squares of its innovations and of theirs, over the same measurements. An object at
//! rest or at a constant velocity it foretells worse, because it takes noise for accelerations; one that swings it foretells better, and is then believed.

use super::{JUDGED, share};
use crate::time::MonoNs;
use nalgebra::{Matrix3, Vector3};

/// Standard deviation of the jerk in units of the acceleration that the object may have, 1/s. Derived: an acceleration that turns once in two seconds, as that of a circle at 0.5 Hz, changes at
/// `2 pi 0.5` 1/s; three times that follows one that turns in 0.7 s.
const JERK_1_S: f64 = 10.0;
/// Standard deviation of the acceleration at the first measurement, in the same units. Chosen by hand: a pendulum's may be some times what is told.
const FIRST_ACCELERATION: f64 = 10.0;
/// The mean square of its innovations over that of the constant velocity's from which on it is believed a little, and wholly. Derived: noise alone makes its innovations larger, and the mean of eight
/// squares of three numbers scatters by 0.2 to 0.3 of itself.
const BETTER: (f64, f64) = (0.8, 0.5);

/// Place, velocity and acceleration of an object in W.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AcceleratingPlace {
    stamp: MonoNs,
    /// m, m/s, m/s^2.
    pub(super) p: Vector3<f64>,
    pub(super) v: Vector3<f64>,
    pub(super) a: Vector3<f64>,
    /// Covariance of the three, the same for each axis.
    P: Matrix3<f64>,
    /// Mean squares of the innovations, m^2: of this filter, and of the constant velocity.
    squares: [f64; 2],
}

impl AcceleratingPlace {
    /// An object first seen at `p` (m) at `stamp`, with the variance `r` (m^2) of each axis, a speed of up to `speed_m_s` and accelerations about `acceleration_m_s2`.
    pub(super) fn first(
        stamp: MonoNs,
        p: Vector3<f64>,
        r: f64,
        (speed_m_s, acceleration_m_s2): (f64, f64),
    ) -> Self {
        let a = FIRST_ACCELERATION * acceleration_m_s2;
        let P = Matrix3::from_diagonal(&Vector3::new(r, speed_m_s * speed_m_s, a * a));
        Self { stamp, p, v: Vector3::zeros(), a: Vector3::zeros(), P, squares: [0.0; 2] }
    }

    /// Takes in the place `p` (m) at `stamp` with the variance `r` (m^2) of each axis, of an object that accelerates by about `acceleration_m_s2`, where the constant velocity was wrong by
    /// `innovation` (m); `None` for a leap, which has a new place and tells nothing of velocity and acceleration.
    pub(super) fn observe(
        &mut self,
        stamp: MonoNs,
        (p, r): (&Vector3<f64>, f64),
        acceleration_m_s2: f64,
        innovation: Option<&Vector3<f64>>,
    ) {
        let dt = (stamp - self.stamp).as_s();
        let F = Matrix3::new(1.0, dt, dt * dt / 2.0, 0.0, 1.0, dt, 0.0, 0.0, 1.0);
        let jerk = Vector3::new(dt.powi(3) / 6.0, dt * dt / 2.0, dt) * (JERK_1_S * acceleration_m_s2);
        self.P = F * self.P * F.transpose() + jerk * jerk.transpose();
        self.p += self.v * dt + self.a * (dt * dt / 2.0);
        self.v += self.a * dt;
        self.stamp = stamp;
        let Some(innovation) = innovation else {
            self.p = *p;
            self.P.fill_row(0, 0.0);
            self.P.fill_column(0, 0.0);
            self.P[(0, 0)] = r;
            return;
        };
        let off = p - self.p;
        let K = self.P.column(0) / (self.P[(0, 0)] + r);
        self.p += off * K[0];
        self.v += off * K[1];
        self.a += off * K[2];
        // Joseph's form stays symmetric and positive.
        let mut I_KH = Matrix3::identity();
        let mut first = I_KH.column_mut(0);
        first -= K;
        self.P = I_KH * self.P * I_KH.transpose() + K * K.transpose() * r;
        let both = [off.norm_squared(), innovation.norm_squared()];
        for (mean, square) in self.squares.iter_mut().zip(both) {
            *mean += (square - *mean) / JUDGED;
        }
    }

    /// How far it is believed: 0 to 1.
    pub(super) fn trust(&self) -> f64 {
        let [own, constant] = self.squares;
        if own > 0.0 && constant > 0.0 { 1.0 - share(own / constant, (BETTER.1, BETTER.0)) } else { 0.0 }
    }
}
