//! Similarity transformation between two sets of points by least squares, for m = 4, (10.33): where object and image plane are parallel, the image
//! of a plane is a similar figure.

use nalgebra::Vector2;

/// `s = scale R2(angle) r + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Similarity {
    /// Ratio of lengths, positive.
    pub(super) scale: f64,
    /// Rotation, rad, in (-pi, pi].
    pub(super) angle_rad: f64,
    /// Image of the point r = 0.
    pub(super) offset: Vector2<f64>,
}

/// The similarity that takes the points `r` to the points `s` with the least sum of squared distances.
///
/// `None` for fewer than two different points, or where something is not finite.
pub(super) fn fit_similarity(
    pairs: impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + Clone,
) -> Option<Similarity> {
    let (mut r_mean, mut s_mean, mut count) = (Vector2::zeros(), Vector2::zeros(), 0.0);
    for (r, s) in pairs.clone() {
        r_mean += r;
        s_mean += s;
        count += 1.0;
    }
    if count < 2.0 {
        return None;
    }
    r_mean /= count;
    s_mean /= count;
    let (mut a, mut b, mut size) = (0.0, 0.0, 0.0);
    for (r, s) in pairs {
        let (r, s) = (r - r_mean, s - s_mean);
        a += r.dot(&s);
        b += r.perp(&s);
        size += r.norm_squared();
    }
    let (a, b) = (a / size, b / size);
    let scale = a.hypot(b);
    let offset = Vector2::new(s_mean.x - a * r_mean.x + b * r_mean.y, s_mean.y - b * r_mean.x - a * r_mean.y);
    let good = scale > 0.0 && scale.is_finite() && offset.x.is_finite() && offset.y.is_finite();
    good.then(|| Similarity { scale, angle_rad: b.atan2(a), offset })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_similarity_comes_back_and_noise_is_met_best(
            scale in 0.1..5.0f64, angle in -3.1..3.1f64, x in -1.0..1.0f64, y in -1.0..1.0f64,
            noise in prop::array::uniform8(-0.01..0.01f64), step in prop::array::uniform4(-1e-3..1e-3f64)
        ) {
            let r = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.02, 0.1]].map(Vector2::from);
            let map = |f: &Similarity, r: &Vector2<f64>| {
                let (sin, cos) = f.angle_rad.sin_cos();
                Vector2::new(cos * r.x - sin * r.y, sin * r.x + cos * r.y) * f.scale + f.offset
            };
            let truth = Similarity { scale, angle_rad: angle, offset: Vector2::new(x, y) };
            let exact = fit_similarity(r.iter().map(|r| (*r, map(&truth, r)))).unwrap();
            prop_assert!((exact.scale - scale).abs() < 1e-12 && (exact.angle_rad - angle).abs() < 1e-12);
            prop_assert!((exact.offset - truth.offset).norm() < 1e-12);
            let s: Vec<_> = (0..4).map(|i| map(&truth, &r[i]) + Vector2::new(noise[2 * i], noise[2 * i + 1])).collect();
            let best = fit_similarity(r.iter().copied().zip(s.iter().copied())).unwrap();
            let sum = |f: &Similarity| r.iter().zip(&s).map(|(r, s)| (map(f, r) - s).norm_squared()).sum::<f64>();
            let beside = Similarity {
                scale: best.scale * (1.0 + step[0]), angle_rad: best.angle_rad + step[1],
                offset: best.offset + Vector2::new(step[2], step[3]),
            };
            prop_assert!(sum(&best) <= sum(&beside) + 1e-15);
        }
    }

    #[test]
    fn one_point_or_the_same_twice_is_too_little() {
        let p = (Vector2::new(0.1, 0.2), Vector2::new(0.3, 0.4));
        assert!(fit_similarity([p].into_iter()).is_none());
        assert!(fit_similarity([p, p].into_iter()).is_none());
    }
}
