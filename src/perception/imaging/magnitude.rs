//! Magnitude and direction of a gradient, Sect. 10.2.1: `G = sqrt(Δ1^2 + Δ2^2)`, `G = |Δ1| + |Δ2|`, `θ = Atan2(Δ2, Δ1)`.
//!
//! In the units of the operator; direction in rad, from the first towards the second derivative, that is from x towards y (clockwise
//! as the image is seen) for first differences and Sobel.

use super::simd::kernel;
use super::{Gradient, Plane};

/// `sqrt(Δ1^2 + Δ2^2)`, correctly rounded.
pub fn magnitude(gradient: &Gradient, out: &mut Plane<f32>) {
    each_row(gradient, out, magnitude_row);
}

/// `|Δ1| + |Δ2|`.
pub fn magnitude_sum(gradient: &Gradient, out: &mut Plane<u16>) {
    each_row(gradient, out, sum_row);
}

/// `Atan2(Δ2, Δ1)` in rad, -π..=π, to 5e-7 rad; 0 where both derivatives vanish.
pub fn direction(gradient: &Gradient, out: &mut Plane<f32>) {
    each_row(gradient, out, direction_row);
}

fn each_row<T: Copy + Default>(
    gradient: &Gradient,
    out: &mut Plane<T>,
    kernel: impl Fn(&[i16], &[i16], &mut [T]),
) {
    let (first, second) = (gradient.first(), gradient.second());
    out.reshape(first.width(), first.height());
    for y in 0..first.height() {
        kernel(first.row(y), second.row(y), out.row_mut(y));
    }
}

kernel!(fn magnitude_row(first: &[i16], second: &[i16], out: &mut [f32]) = magnitude_body);
kernel!(pub(super) fn sum_row(first: &[i16], second: &[i16], out: &mut [u16]) = sum_body);
kernel!(fn direction_row(first: &[i16], second: &[i16], out: &mut [f32]) = direction_body);

#[inline(always)]
fn magnitude_body(first: &[i16], second: &[i16], out: &mut [f32]) {
    for ((out, &a), &b) in out.iter_mut().zip(first).zip(second) {
        let (a, b) = (f32::from(a), f32::from(b));
        // exact up to the root: both squares and their sum are below 2^24
        *out = (a * a + b * b).sqrt();
    }
}

#[inline(always)]
fn sum_body(first: &[i16], second: &[i16], out: &mut [u16]) {
    for ((out, &a), &b) in out.iter_mut().zip(first).zip(second) {
        *out = a.unsigned_abs() + b.unsigned_abs();
    }
}

#[inline(always)]
fn direction_body(first: &[i16], second: &[i16], out: &mut [f32]) {
    for ((out, &a), &b) in out.iter_mut().zip(first).zip(second) {
        *out = atan2(f32::from(b), f32::from(a));
    }
}

/// Odd polynomial for the arc tangent of 0..=1. Derived: the one of least greatest error over that interval, 6e-8.
const ATAN: [f32; 8] = [
    0.999_999_34,
    -0.333_298_6,
    0.199_465_66,
    -0.139_086_3,
    0.096_421_95,
    -0.055_912_297,
    0.021_862_935,
    -0.004_054_561,
];

/// Without branches, so that a loop of it can be done side by side.
#[inline(always)]
fn atan2(y: f32, x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, PI};
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ay > ax { (ax, ay) } else { (ay, ax) };
    let t = small / if large > 0.0 { large } else { 1.0 };
    let s = t * t;
    let mut angle = ATAN[7];
    let mut k = 7;
    while k > 0 {
        k -= 1;
        angle = angle * s + ATAN[k];
    }
    angle *= t;
    angle = if ay > ax { FRAC_PI_2 - angle } else { angle };
    angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::super::test_image::any_image;
    use super::super::{ImageView, Operator};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn both_magnitudes_and_the_direction_are_those_of_the_text(image in any_image()) {
            let mut gradient = Gradient::default();
            gradient.find(&image.view(), Operator::Sobel);
            let (mut size, mut sum, mut angle) = (Plane::default(), Plane::default(), Plane::default());
            magnitude(&gradient, &mut size);
            magnitude_sum(&gradient, &mut sum);
            direction(&gradient, &mut angle);
            for (i, (&a, &b)) in gradient.first().as_slice().iter().zip(gradient.second().as_slice()).enumerate() {
                let (a, b) = (f64::from(a), f64::from(b));
                prop_assert_eq!(size.as_slice()[i], a.hypot(b) as f32);
                prop_assert_eq!(f64::from(sum.as_slice()[i]), a.abs() + b.abs());
                prop_assert!((f64::from(angle.as_slice()[i]) - b.atan2(a)).abs() < 5e-7);
            }
        }

        #[test]
        fn kernels_agree_to_the_bit(values in prop::collection::vec((-1020i16..=1020, -1020i16..=1020), 0..80)) {
            let (a, b): (Vec<i16>, Vec<i16>) = values.into_iter().unzip();
            let (mut f, mut g) = (vec![0f32; a.len()], vec![0f32; a.len()]);
            magnitude_row(&a, &b, &mut f);
            magnitude_body(&a, &b, &mut g);
            prop_assert_eq!(&f, &g);
            direction_row(&a, &b, &mut f);
            direction_body(&a, &b, &mut g);
            prop_assert_eq!(&f, &g);
            let (mut f, mut g) = (vec![0u16; a.len()], vec![0u16; a.len()]);
            sum_row(&a, &b, &mut f);
            sum_body(&a, &b, &mut g);
            prop_assert_eq!(f, g);
        }
    }

    #[test]
    fn direction_is_good_over_the_full_turn_and_on_the_axes() {
        for a in (-1020i16..=1020).step_by(3) {
            for b in (-1020i16..=1020).step_by(5) {
                let mut out = [0f32];
                direction_body(&[a], &[b], &mut out);
                let wanted = f64::from(b).atan2(f64::from(a));
                assert!((f64::from(out[0]) - wanted).abs() < 5e-7, "{a} {b}");
            }
        }
    }

    #[test]
    fn a_step_to_the_right_points_along_x() {
        let pixels = [10, 10, 10, 90, 90, 90].repeat(3);
        let mut gradient = Gradient::with_size(6, 3);
        gradient.find(&ImageView::new(&pixels, 6, 3).unwrap(), Operator::Sobel);
        let mut angle = Plane::default();
        direction(&gradient, &mut angle);
        assert_eq!((gradient.first().get(2, 1), angle.get(2, 1)), (Some(320), Some(0.0)));
    }
}
