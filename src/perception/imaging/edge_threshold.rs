//! Edges by threshold alone, Sect. 10.2.1, as binary images (255 on an edge): where the gradient is great, or the Laplacian small.
//!
//! Such edges are as wide as the blur; [`super::Edges`] thins them.

use super::Plane;
use super::simd::kernel;

/// 255 where the magnitude is greater than `threshold`, in the units of the magnitude; else 0.
pub fn edges_by_magnitude<T: Copy + Default + PartialOrd>(
    magnitude: &Plane<T>,
    threshold: T,
    out: &mut Plane<u8>,
) {
    out.reshape(magnitude.width(), magnitude.height());
    for y in 0..magnitude.height() {
        for (out, &m) in out.row_mut(y).iter_mut().zip(magnitude.row(y)) {
            *out = u8::from(m > threshold).wrapping_neg();
        }
    }
}

/// 255 where the amount of the Laplacian (`4 L`, as [`super::laplacian`] gives it) is less than `threshold` and the magnitude at least
/// `least`: flat areas have no Laplacian either, 0 leaves them in. Planes of two sizes give an empty image.
pub fn edges_by_laplacian(
    laplacian: &Plane<i16>,
    threshold: u16,
    magnitude: &Plane<u16>,
    least: u16,
    out: &mut Plane<u8>,
) {
    if (laplacian.width(), laplacian.height()) != (magnitude.width(), magnitude.height()) {
        out.reshape(0, 0);
        return;
    }
    out.reshape(laplacian.width(), laplacian.height());
    for y in 0..laplacian.height() {
        laplacian_row(laplacian.row(y), threshold, magnitude.row(y), least, out.row_mut(y));
    }
}

kernel!(fn laplacian_row(laplacian: &[i16], threshold: u16, magnitude: &[u16], least: u16, out: &mut [u8]) = laplacian_body);

#[inline(always)]
fn laplacian_body(laplacian: &[i16], threshold: u16, magnitude: &[u16], least: u16, out: &mut [u8]) {
    for ((out, &l), &m) in out.iter_mut().zip(laplacian).zip(magnitude) {
        *out = u8::from((l.unsigned_abs() < threshold) & (m >= least)).wrapping_neg();
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_image::any_image;
    use super::super::{Gradient, Operator, laplacian, magnitude_sum};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn thresholds_are_those_of_the_text(image in any_image(), threshold in 0u16..600, least in 0u16..600) {
            let (mut gradient, mut m, mut l) = (Gradient::default(), Plane::default(), Plane::default());
            gradient.find(&image.view(), Operator::Roberts);
            magnitude_sum(&gradient, &mut m);
            laplacian(&image.view(), &mut l);
            let (mut a, mut b) = (Plane::default(), Plane::default());
            edges_by_magnitude(&m, threshold, &mut a);
            edges_by_laplacian(&l, threshold, &m, least, &mut b);
            let (w, h) = (image.view().width() as i64, image.view().height() as i64);
            prop_assert_eq!((a.as_slice().len(), b.as_slice().len()), ((w * h) as usize, (w * h) as usize));
            for (i, (&a, &b)) in (0..).zip(a.as_slice().iter().zip(b.as_slice())) {
                let at = |dx: i64, dy: i64| image.at(i % w + dx, i / w + dy);
                let g = (at(1, 1) - at(0, 0)).abs() + (at(0, 1) - at(1, 0)).abs();
                let l = at(0, 0) as f64 - 0.25 * (at(0, 1) + at(0, -1) + at(1, 0) + at(-1, 0)) as f64;
                prop_assert_eq!(a == 255, g > i64::from(threshold));
                prop_assert_eq!(b == 255, 4.0 * l.abs() < f64::from(threshold) && g >= i64::from(least));
                prop_assert!((a == 0 || a == 255) && (b == 0 || b == 255));
            }
        }
    }
}
