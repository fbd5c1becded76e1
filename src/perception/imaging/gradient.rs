//! Spatial gradient of the grey levels, Sect. 10.2.1: first differences, Roberts and Sobel operator.
//!
//! `Δ1`, `Δ2` in grey levels, as whole numbers: first differences and Roberts per pixel, Sobel 8 times the slope per pixel. A
//! pixel that an operator looks for outside of the image has the level of the nearest one inside.

use super::simd::kernel;
use super::{ImageView, Plane};

/// How the derivatives are approximated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Operator {
    /// `Δ1 = I(x+1, y) - I(x, y)`, `Δ2 = I(x, y+1) - I(x, y)`.
    FirstDifferences,
    /// Along the diagonals of a 2 x 2 square: `Δ1 = I(x+1, y+1) - I(x, y)`, `Δ2 = I(x, y+1) - I(x+1, y)`.
    Roberts,
    /// Weighted differences over a 3 x 3 square, along columns and rows.
    #[default]
    Sobel,
}

/// Both derivatives of an image. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Gradient {
    first: Plane<i16>,
    second: Plane<i16>,
    columns: SobelColumns,
}

impl Gradient {
    /// Buffers for images of this size, allocated at once.
    #[must_use]
    pub fn with_size(width: usize, height: usize) -> Self {
        Self {
            first: Plane::with_size(width, height),
            second: Plane::with_size(width, height),
            columns: SobelColumns::with_width(width),
        }
    }

    /// Differentiates the image.
    pub fn find(&mut self, image: &ImageView<'_>, operator: Operator) {
        let (width, height) = (image.width(), image.height());
        self.first.reshape(width, height);
        self.second.reshape(width, height);
        for y in 0..height {
            let (here, below) = (image.row(y), image.row((y + 1).min(height - 1)));
            let (first, second) = (self.first.row_mut(y), self.second.row_mut(y));
            match operator {
                Operator::FirstDifferences => first_differences_row(here, below, first, second),
                Operator::Roberts => roberts_row(here, below, first, second),
                Operator::Sobel => {
                    self.columns.row(image.row(y.saturating_sub(1)), here, below, first, second);
                }
            }
        }
    }

    /// `Δ1`: along x, and for Roberts along the falling diagonal.
    #[must_use]
    pub fn first(&self) -> &Plane<i16> {
        &self.first
    }

    /// `Δ2`: along y, and for Roberts along the other diagonal.
    #[must_use]
    pub fn second(&self) -> &Plane<i16> {
        &self.second
    }
}

/// The Sobel operator on one row: sums down the columns, then along the row. With one column of copies on either side.
#[derive(Debug, Clone, Default)]
pub(super) struct SobelColumns {
    sums: Vec<i16>,
    differences: Vec<i16>,
}

impl SobelColumns {
    pub(super) fn with_width(width: usize) -> Self {
        Self { sums: vec![0; width.saturating_add(2)], differences: vec![0; width.saturating_add(2)] }
    }

    /// `Δ1`, `Δ2` of the row `here`; all slices of one length.
    pub(super) fn row(
        &mut self,
        above: &[u8],
        here: &[u8],
        below: &[u8],
        first: &mut [i16],
        second: &mut [i16],
    ) {
        self.sums.resize(here.len() + 2, 0);
        self.differences.resize(here.len() + 2, 0);
        sobel_row(above, here, below, &mut self.sums, &mut self.differences, first, second);
    }
}

kernel!(
    fn sobel_row(
        above: &[u8], here: &[u8], below: &[u8], sums: &mut [i16], differences: &mut [i16], first: &mut [i16],
        second: &mut [i16],
    ) = sobel_row_body
);

#[inline(always)]
fn sobel_row_body(
    above: &[u8],
    here: &[u8],
    below: &[u8],
    sums: &mut [i16],
    differences: &mut [i16],
    first: &mut [i16],
    second: &mut [i16],
) {
    let n = here.len();
    let [s0, s @ .., s1] = sums else { return };
    let [d0, d @ .., d1] = differences else { return };
    for ((((s, d), &a), &h), &b) in s.iter_mut().zip(d.iter_mut()).zip(above).zip(here).zip(below) {
        let (a, h, b) = (i16::from(a), i16::from(h), i16::from(b));
        *s = a + 2 * h + b;
        *d = b - a;
    }
    if let (Some(&a), Some(&b)) = (s.first(), s.last()) {
        (*s0, *s1) = (a, b);
    }
    if let (Some(&a), Some(&b)) = (d.first(), d.last()) {
        (*d0, *d1) = (a, b);
    }
    let (Some(left), Some(right)) = (sums.get(..n), sums.get(2..)) else { return };
    for ((out, &l), &r) in first.iter_mut().zip(left).zip(right) {
        *out = r - l;
    }
    let (Some(left), Some(middle), Some(right)) =
        (differences.get(..n), differences.get(1..), differences.get(2..))
    else {
        return;
    };
    for (((out, &l), &m), &r) in second.iter_mut().zip(left).zip(middle).zip(right) {
        *out = l + 2 * m + r;
    }
}

kernel!(fn first_differences_row(here: &[u8], below: &[u8], first: &mut [i16], second: &mut [i16]) = first_differences_body);

#[inline(always)]
fn first_differences_body(here: &[u8], below: &[u8], first: &mut [i16], second: &mut [i16]) {
    for ((out, &h), &b) in second.iter_mut().zip(here).zip(below) {
        *out = i16::from(b) - i16::from(h);
    }
    for ((out, &h), &right) in first.iter_mut().zip(here).zip(here.get(1..).unwrap_or(&[])) {
        *out = i16::from(right) - i16::from(h);
    }
    if let Some(last) = first.last_mut() {
        *last = 0;
    }
}

kernel!(fn roberts_row(here: &[u8], below: &[u8], first: &mut [i16], second: &mut [i16]) = roberts_body);

#[inline(always)]
fn roberts_body(here: &[u8], below: &[u8], first: &mut [i16], second: &mut [i16]) {
    let (right, below_right) = (here.get(1..).unwrap_or(&[]), below.get(1..).unwrap_or(&[]));
    for ((out, &h), &d) in first.iter_mut().zip(here).zip(below_right) {
        *out = i16::from(d) - i16::from(h);
    }
    for ((out, &b), &r) in second.iter_mut().zip(below).zip(right) {
        *out = i16::from(b) - i16::from(r);
    }
    if let (Some(f), Some(s), Some(&h), Some(&b)) =
        (first.last_mut(), second.last_mut(), here.last(), below.last())
    {
        *f = i16::from(b) - i16::from(h);
        *s = *f;
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_image::{TestImage, any_image};
    use super::*;
    use proptest::prelude::*;

    /// The operators as the text writes them.
    fn by_definition(i: &TestImage, operator: Operator, x: i64, y: i64) -> (i64, i64) {
        let at = |dx: i64, dy: i64| i.at(x + dx, y + dy);
        match operator {
            Operator::FirstDifferences => (at(1, 0) - at(0, 0), at(0, 1) - at(0, 0)),
            Operator::Roberts => (at(1, 1) - at(0, 0), at(0, 1) - at(1, 0)),
            Operator::Sobel => (
                at(1, -1) + 2 * at(1, 0) + at(1, 1) - (at(-1, -1) + 2 * at(-1, 0) + at(-1, 1)),
                at(-1, 1) + 2 * at(0, 1) + at(1, 1) - (at(-1, -1) + 2 * at(0, -1) + at(1, -1)),
            ),
        }
    }

    proptest! {
        #[test]
        fn operators_are_those_of_the_text(image in any_image(), before in any_image()) {
            let mut gradient = Gradient::default();
            let view = image.view();
            for operator in [Operator::FirstDifferences, Operator::Roberts, Operator::Sobel] {
                gradient.find(&before.view(), operator); // what an earlier image leaves behind does not matter
                gradient.find(&view, operator);
                for y in 0..view.height() {
                    for x in 0..view.width() {
                        let wanted = by_definition(&image, operator, x as i64, y as i64);
                        let (a, b) = (gradient.first().get(x, y).unwrap(), gradient.second().get(x, y).unwrap());
                        prop_assert_eq!((i64::from(a), i64::from(b)), wanted, "{:?} {} {}", operator, x, y);
                    }
                }
            }
        }

        /// The widest instructions and those of every processor.
        #[test]
        fn kernels_agree(image in any_image()) {
            let view = image.view();
            let (here, below) = (view.row(0), view.row(view.height() - 1));
            let n = here.len();
            let new = || (vec![0i16; n], vec![0i16; n]);
            let ((mut a, mut b), (mut c, mut d)) = (new(), new());
            first_differences_row(here, below, &mut a, &mut b);
            first_differences_body(here, below, &mut c, &mut d);
            prop_assert_eq!((&a, &b), (&c, &d));
            roberts_row(here, below, &mut a, &mut b);
            roberts_body(here, below, &mut c, &mut d);
            prop_assert_eq!((&a, &b), (&c, &d));
            let (mut s, mut t) = (vec![0; n + 2], vec![0; n + 2]);
            sobel_row(here, below, here, &mut s, &mut t, &mut a, &mut b);
            sobel_row_body(here, below, here, &mut s, &mut t, &mut c, &mut d);
            prop_assert_eq!((a, b), (c, d));
        }
    }
}
