//! How the object of a simulated scene moves by itself.

use crate::geometry::{Pose, Twist};
use crate::time::SpanNs;
use nalgebra::{Translation3, Vector3};
use std::f64::consts::TAU;

/// Motion of the object's origin; its orientation stays.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum SceneMotion {
    /// At rest.
    #[default]
    Still,
    /// Constant velocity in B, m/s, from the first tick on.
    Conveyor {
        /// Velocity.
        velocity_m_s: Vector3<f64>,
    },
    /// Oscillates about its place: `amplitude sin(2 pi f t)`.
    Pendulum {
        /// Largest displacement in B, m.
        amplitude_m: Vector3<f64>,
        /// Oscillations per second.
        frequency_hz: f64,
    },
}

impl SceneMotion {
    /// Where the object is at `time` after the first tick, given `X_BO` at the first tick.
    #[must_use]
    pub fn object_at(&self, X_BO: &Pose, time: SpanNs) -> Pose {
        let t = time.as_s();
        let shift = match self {
            Self::Still => return *X_BO,
            Self::Conveyor { velocity_m_s } => velocity_m_s * t,
            Self::Pendulum { amplitude_m, frequency_hz } => amplitude_m * (TAU * frequency_hz * t).sin(),
        };
        Pose::from_parts(Translation3::from(X_BO.translation.vector + shift), X_BO.rotation)
    }

    /// The object's twist in B at that time, m/s and rad/s.
    #[must_use]
    pub fn twist_at(&self, time: SpanNs) -> Twist {
        let t = time.as_s();
        let v = match self {
            Self::Still => Vector3::zeros(),
            Self::Conveyor { velocity_m_s } => *velocity_m_s,
            Self::Pendulum { amplitude_m, frequency_hz } => {
                amplitude_m * (TAU * frequency_hz * (TAU * frequency_hz * t).cos())
            }
        };
        Twist::new(v.x, v.y, v.z, 0.0, 0.0, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_twist_is_the_derivative_of_the_place(
            a in prop::array::uniform3(-1.0..1.0f64), frequency_hz in 0.05..2.0f64, t in 0.0..20.0f64
        ) {
            let X_BO = Pose::new([1.0, 1.0, 1.0].into(), [0.1, 0.2, 0.7].into());
            let a = Vector3::from(a);
            for motion in [
                SceneMotion::Still,
                SceneMotion::Conveyor { velocity_m_s: a },
                SceneMotion::Pendulum { amplitude_m: a, frequency_hz },
            ] {
                let at = |s: f64| motion.object_at(&X_BO, SpanNs::from_s(s)).translation.vector;
                let h = 1e-4;
                let difference = (at(t + h) - at(t - h)) / (2.0 * h);
                let v = motion.twist_at(SpanNs::from_s(t)).fixed_rows::<3>(0).into_owned();
                prop_assert!((difference - v).norm() < 1e-4, "{motion:?} {difference} {v}");
                prop_assert_eq!(motion.object_at(&X_BO, SpanNs(0)), X_BO);
            }
        }
    }
}
