//! The minimum time in which joints can move from rest to rest within their limits. The settling time of a run is compared with it.
//!
//! Each joint accelerates with jerk J, at most with the acceleration A, cruises at its velocity limit V if that is reached, and
//! brakes symmetrically. Accelerating from rest to the speed v takes `t(v) = 2 sqrt(v / J)`, or
//! `v / A + A / J` where A is reached (`v > A^2 / J`), and covers the distance `v t(v) / 2`. The slowest joint determines the time.

use super::motion_limits::MotionLimits;
use nalgebra::SVector;

/// Least time from rest in `from` to rest in `to` (rad or m), s: a lower bound, which no controller within `limits` beats.
#[must_use]
pub fn min_time_s<const N: usize>(
    limits: &MotionLimits<N>,
    from: &SVector<f64, N>,
    to: &SVector<f64, N>,
) -> f64 {
    let joint = |i: usize| {
        one_joint_s((to[i] - from[i]).abs(), limits.velocity[i], limits.acceleration[i], limits.jerk[i])
    };
    (0..N).map(joint).fold(0.0, f64::max)
}

fn one_joint_s(distance: f64, V: f64, A: f64, J: f64) -> f64 {
    let speeding_up_s = |v: f64| if v * J <= A * A { 2.0 * (v / J).sqrt() } else { v / A + A / J };
    let to_full_speed = V * speeding_up_s(V);
    if distance >= to_full_speed {
        return 2.0 * speeding_up_s(V) + (distance - to_full_speed) / V;
    }
    let gentle = (0.5 * distance * J.sqrt()).powf(2.0 / 3.0);
    let peak = if gentle * J <= A * A {
        gentle
    } else {
        0.5 * ((A * A / J).powi(2) + 4.0 * A * distance).sqrt() - 0.5 * A * A / J
    };
    2.0 * speeding_up_s(peak)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Reference;
    use crate::motion::goal_braking::brakeable;
    use crate::servo::Convergence;
    use crate::time::SpanNs;
    use nalgebra::Vector1;
    use proptest::prelude::*;

    proptest! {
        /// The profile that the time was taken from covers the distance.
        #[test]
        fn the_time_covers_the_distance(distance in 1e-3..5.0f64, V in 0.1..3.0f64, A in 1.0..20.0f64, J in 50.0..2000.0f64) {
            let total = one_joint_s(distance, V, A, J);
            // Speeding up takes half of what is not cruising; its jerk is on, off and back as long as A lasts.
            let covered = |half: f64| {
                let t_j = (A / J).min(half / 2.0);
                let v = J * t_j * (half - t_j);
                (v, v * half)
            };
            let (mut low, mut high) = (0.0, total / 2.0);
            for _ in 0..200 {
                let middle = 0.5 * (low + high);
                if covered(middle).0 <= V { low = middle } else { high = middle }
            }
            let (v, moved) = covered(low);
            let cruising = total - 2.0 * low;
            prop_assert!((moved + v * cruising - distance).abs() < 1e-6 * distance, "{moved} {v} {cruising} {distance}");
        }

        /// Nothing within the limits is quicker.
        #[test]
        fn it_is_a_lower_bound(distance in 0.05..3.0f64, A in 2.0..20.0f64, J in 100.0..2000.0f64) {
            let limits = MotionLimits {
                lower: Vector1::new(-10.0),
                upper: Vector1::new(10.0),
                velocity: Vector1::new(3.0),
                acceleration: Vector1::new(A),
                jerk: Vector1::new(J),
            };
            let least = min_time_s(&limits, &Vector1::zeros(), &Vector1::new(0.98 * distance));
            let mut r = Reference::new(limits.clone(), Vector1::zeros());
            let mut tick = 0;
            while r.state().q[0] < 0.99 * distance || r.state().qd[0] > 0.02 * distance {
                let requested_qd = Vector1::new(20.0 * (distance - r.state().q[0]));
                let (cut, _) = brakeable(&requested_qd, &Convergence::at(20.0), r.state(), &limits, 1.0);
                r.advance(&cut, SpanNs::MILLISECOND);
                tick += 1;
            }
            prop_assert!(f64::from(tick) * 1e-3 >= 0.97 * least, "{tick} ms, {least} s");
        }
    }
}
