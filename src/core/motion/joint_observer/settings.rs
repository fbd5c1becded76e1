//! What the observer of the joints is made of.

use crate::linalg::Ldlt;
use crate::robot::Robot;
use nalgebra::SVector;

/// Settings of the observer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObserverSettings<const N: usize> {
    /// Rate at which a disturbance is estimated, rad/s; 0 switches the estimation off.
    pub disturbance_rad_s: f64,
    /// Bandwidth of the velocity observer, rad/s; 0: velocities are taken as they are measured.
    pub velocity_rad_s: f64,
    /// Step of each encoder, with its noise, rad or m.
    pub encoder_step: SVector<f64, N>,
    /// The part of that which is noise: within it a position says little, but their mean says more.
    pub encoder_noise: SVector<f64, N>,
    /// Largest disturbance of each joint, rad/s^2 or m/s^2.
    pub max_acceleration: SVector<f64, N>,
    /// Inertia of each joint while the others are free, about, kg m^2 or kg.
    pub inertia: SVector<f64, N>,
}

impl<const N: usize> ObserverSettings<N> {
    /// The largest disturbance of each joint that the arm can compensate: the acceleration of each by the effort limits of all joints
    /// together, in the posture `q`.
    #[must_use]
    pub fn bound(robot: &Robot<N>, q: &SVector<f64, N>) -> SVector<f64, N> {
        let effort = robot.limits().map(|limit| limit.effort);
        Ldlt::of(&robot.mass_matrix(q)).map_or(SVector::zeros(), |factors| {
            let inverse = factors.inverse();
            SVector::from_fn(|i, _| inverse[i].iter().zip(&effort).map(|(x, effort)| x.abs() * effort).sum())
        })
    }

    /// The inertia of each joint while the others are free, in the posture `q`.
    #[must_use]
    pub fn free_inertia(robot: &Robot<N>, q: &SVector<f64, N>) -> SVector<f64, N> {
        Ldlt::of(&robot.mass_matrix(q)).map_or(SVector::zeros(), |factors| {
            let inverse = factors.inverse();
            SVector::from_fn(|i, _| inverse[i][i].recip())
        })
    }

    /// No disturbance, velocities as they are measured.
    #[must_use]
    pub fn none() -> Self {
        let zero = SVector::zeros();
        Self {
            disturbance_rad_s: 0.0,
            velocity_rad_s: 0.0,
            encoder_step: zero,
            encoder_noise: zero,
            max_acceleration: zero,
            inertia: zero,
        }
    }
}
