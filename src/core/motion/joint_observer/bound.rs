//! How far disturbances are learnt.

use nalgebra::SVector;

/// The disturbance `p`, or the one `before` where a joint's is beyond the `most` that the arm can make and grows: of joints about nearly the same axis each torque is the difference of
/// large accelerations, so that one that is cut alone drives the others (a Panda whose first motor was dead came from 0.03 rad/s to 5 in 12 ms).
pub(super) fn within<const N: usize>(
    before: SVector<f64, N>,
    p: SVector<f64, N>,
    most: &SVector<f64, N>,
) -> SVector<f64, N> {
    let grows_beyond = |i: usize| p[i].abs() > most[i] && p[i].abs() > before[i].abs();
    if (0..N).any(grows_beyond) { before } else { p }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn a_disturbance_beyond_its_bound_keeps_its_direction() {
        let (before, most) = (Vector2::new(90.0, -99.0), Vector2::new(200.0, 100.0));
        assert_eq!(within(before, Vector2::new(91.0, -99.9), &most), Vector2::new(91.0, -99.9));
        assert_eq!(within(before, Vector2::new(91.0, -101.0), &most), before);
        // From beyond its bound it comes back.
        let beyond = Vector2::new(90.0, -120.0);
        assert_eq!(within(beyond, Vector2::new(89.0, -119.0), &most), Vector2::new(89.0, -119.0));
    }
}
