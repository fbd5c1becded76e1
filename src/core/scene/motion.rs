//! How the object of a simulated scene moves by itself.

use crate::geometry::{Pose, Twist};
use crate::time::SpanNs;
use nalgebra::{Translation3, UnitQuaternion, UnitVector3, Vector3};
use std::f64::consts::TAU;

/// How long the speed on a circle rises from zero, s. Chosen by hand: shorter than the arm's own start, and without the step of the velocity that no shaft makes.
const RISE_S: f64 = 1.0;

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
    /// On a circle that begins at its place: `c - R(axis, theta(t)) r`, with `c = p + r`. The angular speed rises from zero to
    /// `2 pi f` in the first second, as `3 s^2 - 2 s^3`, and stays.
    Circle {
        /// From the object's first place to the circle's centre, in B, m.
        radius_m: Vector3<f64>,
        /// Axis in B about which the object goes, at right angles to the radius.
        axis: UnitVector3<f64>,
        /// Turns per second.
        frequency_hz: f64,
    },
    /// By turns with constant velocity and at rest, beginning with the motion at the first tick; the velocity steps.
    StopAndGo {
        /// Velocity in B while it moves, m/s.
        velocity_m_s: Vector3<f64>,
        /// How long it moves.
        moving: SpanNs,
        /// How long it rests after each motion.
        resting: SpanNs,
    },
    /// At rest, but for one leap to another place.
    Jump {
        /// Displacement in B, m.
        displacement_m: Vector3<f64>,
        /// When, after the first tick.
        at: SpanNs,
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
            Self::Circle { radius_m, axis, frequency_hz } => {
                radius_m - turned(radius_m, axis, *frequency_hz, t)
            }
            Self::StopAndGo { velocity_m_s, moving, resting } => {
                let (motions, since_s) = motions_before(t, moving.as_s(), resting.as_s());
                velocity_m_s * (motions * moving.as_s() + since_s.min(moving.as_s()))
            }
            Self::Jump { displacement_m, at } if time >= *at => *displacement_m,
            Self::Jump { .. } => return *X_BO,
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
            Self::Circle { radius_m, axis, frequency_hz } => {
                let part = (t / RISE_S).clamp(0.0, 1.0);
                let w = TAU * frequency_hz * part * part * (3.0 - 2.0 * part);
                -axis.cross(&turned(radius_m, axis, *frequency_hz, t)) * w
            }
            Self::StopAndGo { velocity_m_s, moving, resting } => {
                let (_, since_s) = motions_before(t, moving.as_s(), resting.as_s());
                if (0.0..moving.as_s()).contains(&since_s) { *velocity_m_s } else { Vector3::zeros() }
            }
            // The leap itself takes no time: it has no velocity.
            Self::Jump { .. } => Vector3::zeros(),
        };
        Twist::new(v.x, v.y, v.z, 0.0, 0.0, 0.0)
    }
}

/// The radius (m) about the axis by the angle of a circle at `t` seconds.
fn turned(radius_m: &Vector3<f64>, axis: &UnitVector3<f64>, frequency_hz: f64, t: f64) -> Vector3<f64> {
    let part = (t / RISE_S).clamp(0.0, 1.0);
    let rise_s = RISE_S * part.powi(3) * (1.0 - part / 2.0);
    let angle = TAU * frequency_hz * (rise_s + (t - RISE_S).max(0.0));
    UnitQuaternion::from_axis_angle(axis, angle) * radius_m
}

/// How many motions began and ended before `t`, and the seconds since the present one began.
fn motions_before(t: f64, moving_s: f64, resting_s: f64) -> (f64, f64) {
    let motions = (t / (moving_s + resting_s)).floor().max(0.0);
    (motions, t - motions * (moving_s + resting_s))
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
                SceneMotion::Circle {
                    radius_m: a.cross(&Vector3::z()),
                    axis: Vector3::z_axis(),
                    frequency_hz,
                },
                SceneMotion::StopAndGo {
                    velocity_m_s: a,
                    moving: SpanNs::from_s(0.7),
                    resting: SpanNs::from_s(0.4),
                },
                SceneMotion::Jump { displacement_m: a, at: SpanNs::from_s(3.0) },
            ] {
                let at = |s: f64| motion.object_at(&X_BO, SpanNs::from_s(s)).translation.vector;
                let h = 1e-4;
                let steps = match motion {
                    SceneMotion::StopAndGo { .. } => vec![t % 1.1, t % 1.1 - 0.7, t % 1.1 - 1.1],
                    SceneMotion::Jump { .. } => vec![t - 3.0],
                    _ => vec![],
                };
                if t < h || steps.iter().any(|step| step.abs() < 2.0 * h) {
                    continue; // not smooth here
                }
                let difference = (at(t + h) - at(t - h)) / (2.0 * h);
                let v = motion.twist_at(SpanNs::from_s(t)).fixed_rows::<3>(0).into_owned();
                prop_assert!((difference - v).norm() < 1e-4, "{motion:?} {difference} {v}");
                prop_assert_eq!(motion.object_at(&X_BO, SpanNs(0)), X_BO);
            }
        }
    }

    #[test]
    fn a_circle_begins_at_rest_and_keeps_its_radius() {
        let X_BO = Pose::translation(1.0, 1.0, 1.0);
        let motion = SceneMotion::Circle {
            radius_m: Vector3::new(0.0, 0.1, 0.0),
            axis: Vector3::z_axis(),
            frequency_hz: 0.5,
        };
        assert_eq!(motion.twist_at(SpanNs(0)).norm(), 0.0);
        for t in [0.0, 0.3, 1.0, 1.7, 12.3] {
            let place = motion.object_at(&X_BO, SpanNs::from_s(t)).translation.vector;
            assert!(((place - Vector3::new(1.0, 1.1, 1.0)).norm() - 0.1).abs() < 1e-12, "{t} {place}");
        }
        assert!((motion.twist_at(SpanNs::from_s(2.0)).norm() - 0.1 * TAU * 0.5).abs() < 1e-12);
    }

    #[test]
    fn stop_and_go_adds_up_and_a_jump_stays() {
        let X_BO = Pose::identity();
        let v = Vector3::new(0.1, 0.0, 0.0);
        let (moving, resting) = (SpanNs::from_s(1.0), SpanNs::from_s(0.5));
        let motion = SceneMotion::StopAndGo { velocity_m_s: v, moving, resting };
        for (t, m) in [(0.0, 0.0), (0.5, 0.05), (1.2, 0.1), (1.5, 0.1), (2.0, 0.15), (2.75, 0.2), (30.0, 2.0)]
        {
            let x = motion.object_at(&X_BO, SpanNs::from_s(t)).translation.x;
            assert!((x - m).abs() < 1e-9, "{t} s: {x} m");
        }
        let motion = SceneMotion::Jump { displacement_m: v, at: SpanNs::from_s(2.0) };
        let x = |t| motion.object_at(&X_BO, SpanNs(t)).translation.x;
        assert_eq!([x(0), x(1_999_999_999), x(2_000_000_000), x(9_000_000_000)], [0.0, 0.0, 0.1, 0.1]);
    }
}
