//! What disturbs a simulated arm from outside and from its own motors: torque ripple, and a base that shakes with all that is on it.

use crate::linalg::Random;
use nalgebra::{SVector, Vector3};
use std::f64::consts::TAU;

/// Ripple of the motors' torques.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TorqueRipple {
    /// Amplitude as a share of the effort limit; each joint has its own, half of it to all, by the seed.
    pub share: f64,
    /// Periods in a radian or in a metre of the joint.
    pub per_rad_or_m: f64,
    /// Seed of amplitudes and phases.
    pub seed: u64,
}

impl TorqueRipple {
    /// The torques or forces, N m or N, that motors at `q` (rad or m) have beyond what they are told, for the `effort` limits.
    pub(super) fn torque<const N: usize>(
        &self,
        q: &SVector<f64, N>,
        effort: impl Fn(usize) -> f64,
    ) -> SVector<f64, N> {
        let mut random = Random::new(self.seed);
        SVector::from_fn(|i, _| {
            let (amplitude, phase) = (random.between(0.5, 1.0), random.between(0.0, TAU));
            amplitude * self.share * effort(i) * (TAU * self.per_rad_or_m * q[i] + phase).sin()
        })
    }
}

/// A base that shakes, with target and camera: the arm feels it, and the camera sees nothing of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShakingBase {
    /// Amplitudes of its acceleration along the axes of B, m/s^2.
    pub amplitude_B: Vector3<f64>,
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Seed of the phases.
    pub seed: u64,
}

impl ShakingBase {
    /// Its acceleration after `t` seconds, m/s^2 in B.
    pub(super) fn acceleration(&self, t: f64) -> Vector3<f64> {
        let mut random = Random::new(self.seed);
        self.amplitude_B.map(|amplitude| {
            let phase = random.between(0.0, TAU);
            amplitude * (TAU * self.frequency_hz * t + phase).sin()
        })
    }
}
