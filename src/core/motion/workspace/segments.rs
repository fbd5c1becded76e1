//! Where two straight lines of finite length are nearest to each other.

use nalgebra::Vector3;

/// Squared length below which a line is a point, m^2. Chosen by hand: a length of 1e-8 m, far above rounding.
const POINT_M2: f64 = 1e-16;
/// Share of the product of two squared lengths below which lines are parallel. Chosen by hand: an angle of 1e-6 rad, far below what makes a difference of a tenth of a millimetre.
const PARALLEL: f64 = 1e-12;

/// The shares of `a` and of `b`, each given by its ends, at which they are nearest to each other: 0 is the first end, 1 the second.
///
/// The least of `|a_0 + s u - b_0 - t w|^2` over `0 <= s, t <= 1`: that of the whole lines where it is inside, else on the border.
pub(super) fn nearest_shares(a: &[Vector3<f64>; 2], b: &[Vector3<f64>; 2]) -> [f64; 2] {
    let (u, w, r) = (a[1] - a[0], b[1] - b[0], a[0] - b[0]);
    let (uu, ww, uw) = (u.norm_squared(), w.norm_squared(), u.dot(&w));
    let (ur, wr) = (u.dot(&r), w.dot(&r));
    let share = |up: f64, square: f64| if square > POINT_M2 { (up / square).clamp(0.0, 1.0) } else { 0.0 };
    let determinant = uu * ww - uw * uw;
    let mut s = if determinant > PARALLEL * uu * ww && uu > POINT_M2 && ww > POINT_M2 {
        ((uw * wr - ww * ur) / determinant).clamp(0.0, 1.0)
    } else {
        share(-ur, uu)
    };
    // The best on b for this, and the best on a for that: after a clamp of one, the other is chosen anew.
    let t = share(wr + s * uw, ww);
    s = share(t * uw - ur, uu);
    [s, t]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0..1.0f64).prop_map(Vector3::from)
    }

    proptest! {
        /// No two points of a fine grid on both lines are nearer.
        #[test]
        fn no_other_points_are_nearer(a in prop::array::uniform2(point()), b in prop::array::uniform2(point()), k in 0u8..4) {
            // Also lines that are points, and parallel ones.
            let a = if k == 1 { [a[0], a[0]] } else { a };
            let b = if k == 2 { [b[0], b[0]] } else if k == 3 { [b[0], b[0] + (a[1] - a[0]) * 0.7] } else { b };
            let [s, t] = nearest_shares(&a, &b);
            let found = (a[0].lerp(&a[1], s) - b[0].lerp(&b[1], t)).norm();
            let on = |l: &[Vector3<f64>; 2], s: i32| l[0] + (l[1] - l[0]) * (f64::from(s) / 60.0);
            for s in 0..=60 {
                for t in 0..=60 {
                    let other = (on(&a, s) - on(&b, t)).norm();
                    prop_assert!(found <= other + 1e-9, "{found} {other}");
                }
            }
        }
    }
}
