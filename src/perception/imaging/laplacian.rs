//! Laplacian of the grey levels, Sect. 10.2.1: `L = I - (I(x, y+1) + I(x, y-1) + I(x+1, y) + I(x-1, y)) / 4`.
//!
//! In quarters of a grey level, so that it is a whole number: `4 L`, in -1020..=1020. Greater than 0 on the light side of an edge, less
//! on the dark one. Neighbours outside of the image have the level of the nearest pixel inside.

use super::simd::kernel;
use super::{ImageView, Plane};

/// `4 L` of all pixels.
pub fn laplacian(image: &ImageView<'_>, out: &mut Plane<i16>) {
    let (width, height) = (image.width(), image.height());
    out.reshape(width, height);
    for y in 0..height {
        let (above, below) = (image.row(y.saturating_sub(1)), image.row((y + 1).min(height - 1)));
        laplacian_row(above, image.row(y), below, out.row_mut(y));
    }
}

kernel!(fn laplacian_row(above: &[u8], here: &[u8], below: &[u8], out: &mut [i16]) = laplacian_body);

#[inline(always)]
fn laplacian_body(above: &[u8], here: &[u8], below: &[u8], out: &mut [i16]) {
    let (&[first, .., last], n) = (here, here.len()) else {
        // a single column is its own neighbour
        for (((out, &a), &h), &b) in out.iter_mut().zip(above).zip(here).zip(below) {
            *out = 2 * i16::from(h) - i16::from(a) - i16::from(b);
        }
        return;
    };
    let vertical = |a: u8, h: u8, b: u8| 4 * i16::from(h) - i16::from(a) - i16::from(b);
    for (((out, &a), &h), &b) in out.iter_mut().zip(above).zip(here).zip(below) {
        *out = vertical(a, h, b);
    }
    let (left, right) = (here.get(..n - 2).unwrap_or(&[]), here.get(2..).unwrap_or(&[]));
    let inner = out.get_mut(1..n - 1).unwrap_or(&mut []);
    for ((out, &l), &r) in inner.iter_mut().zip(left).zip(right) {
        *out -= i16::from(l) + i16::from(r);
    }
    if let ([o0, .., o1], Some(&second), Some(&before)) = (out, here.get(1), here.get(n - 2)) {
        *o0 -= i16::from(first) + i16::from(second);
        *o1 -= i16::from(last) + i16::from(before);
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_image::any_image;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn laplacian_is_that_of_the_text(image in any_image()) {
            let (view, mut out) = (image.view(), Plane::default());
            laplacian(&view, &mut out);
            for y in 0..view.height() as i64 {
                for x in 0..view.width() as i64 {
                    let four = [(0, 1), (0, -1), (1, 0), (-1, 0)];
                    let wanted = 4 * image.at(x, y) - four.iter().map(|(i, j)| image.at(x + i, y + j)).sum::<i64>();
                    prop_assert_eq!(i64::from(out.get(x as usize, y as usize).unwrap()), wanted);
                }
                let row = view.row(y as usize);
                let (mut a, mut b) = (vec![0; row.len()], vec![0; row.len()]);
                laplacian_row(view.row(0), row, row, &mut a);
                laplacian_body(view.row(0), row, row, &mut b);
                prop_assert_eq!(a, b);
            }
        }
    }
}
