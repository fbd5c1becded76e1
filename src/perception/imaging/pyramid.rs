//! Images of half the size each, against aliasing filtered with the binomial kernel (1 4 6 4 1) / 16 along both axes.
//!
//! Pixel `(x, y)` of a level lies on pixel `(2 x, 2 y)` of the one below: `u_0 = 2^level u`, without an offset. Pixels outside of the image
//! have the level of the nearest one inside.

use super::simd::kernel;
use super::{ImageView, Plane};

/// The smaller images. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Pyramid {
    levels: Vec<Plane<u8>>,
    columns: Vec<u16>,
}

impl Pyramid {
    /// A pyramid of `count` images below the given one, at most 16. Memory is taken at the first image.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self { levels: vec![Plane::default(); count.min(16)], columns: Vec::new() }
    }

    /// Fills all levels. Of an image of `n` columns the next has `n / 2`, rounded up; one of 1 x 1 px is followed by its copies.
    pub fn build(&mut self, image: &ImageView<'_>) {
        let mut above: Option<&Plane<u8>> = None;
        for level in &mut self.levels {
            match above {
                None => halve(image, &mut self.columns, level),
                Some(plane) => {
                    if let Some(view) = plane.view() {
                        halve(&view, &mut self.columns, level);
                    }
                }
            }
            above = Some(level);
        }
    }

    /// The image that is `2^level` times smaller, from 1 on; `None` for others and before the first [`Self::build`].
    #[must_use]
    pub fn level(&self, level: usize) -> Option<ImageView<'_>> {
        self.levels.get(level.checked_sub(1)?)?.view()
    }

    /// Number of levels.
    #[must_use]
    pub fn count(&self) -> usize {
        self.levels.len()
    }
}

/// One level from the one below.
fn halve(image: &ImageView<'_>, columns: &mut Vec<u16>, out: &mut Plane<u8>) {
    let (width, height) = (image.width(), image.height());
    out.reshape(width.div_ceil(2), height.div_ceil(2));
    // two copies before, and behind two or three: the last pixel of an even width has one neighbour more
    columns.resize(width + 5, 0);
    for y in 0..out.height() {
        let row = |d: usize| image.row((2 * y + d).saturating_sub(2).min(height - 1));
        let Some(middle) = columns.get_mut(2..2 + width) else { return };
        column_sums([row(0), row(1), row(2), row(3), row(4)], middle);
        let (Some(&first), Some(&last)) = (middle.first(), middle.last()) else { return };
        columns.get_mut(..2).unwrap_or(&mut []).fill(first);
        columns.get_mut(2 + width..).unwrap_or(&mut []).fill(last);
        halve_row(columns, out.row_mut(y));
    }
}

kernel!(fn column_sums(rows: [&[u8]; 5], sums: &mut [u16]) = column_sums_body);
kernel!(fn halve_row(columns: &[u16], out: &mut [u8]) = halve_row_body);

#[inline(always)]
fn column_sums_body(rows: [&[u8]; 5], sums: &mut [u16]) {
    let [a, b, c, d, e] = rows;
    for (((((s, &a), &b), &c), &d), &e) in sums.iter_mut().zip(a).zip(b).zip(c).zip(d).zip(e) {
        let [a, b, c, d, e] = [a, b, c, d, e].map(u16::from);
        *s = a + e + 4 * (b + d) + 6 * c;
    }
}

#[inline(always)]
fn halve_row_body(columns: &[u16], out: &mut [u8]) {
    let (pairs, next) = (columns.as_chunks::<2>().0, columns.get(2..).unwrap_or(&[]).as_chunks::<2>().0);
    let last = columns.get(4..).unwrap_or(&[]).iter().step_by(2);
    for (((out, &[a, b]), &[c, d]), &e) in out.iter_mut().zip(pairs).zip(next).zip(last) {
        // at most 16 * 16 * 255 + 128
        *out = ((a + e + 4 * (b + d) + 6 * c + 128) >> 8) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_image::any_image;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn each_level_is_the_one_below_filtered_and_sampled(image in any_image()) {
            let mut pyramid = Pyramid::new(3);
            prop_assert!(pyramid.level(1).is_none());
            pyramid.build(&image.view());
            let view = image.view();
            let (mut width, mut height) = (view.width(), view.height());
            let mut before: Vec<i64> =
                (0..width * height).map(|i| image.at((i % width) as i64, (i / width) as i64)).collect();
            let binomial = [1, 4, 6, 4, 1];
            for level in 1..=3 {
                let got = pyramid.level(level).unwrap();
                prop_assert_eq!((got.width(), got.height()), (width.div_ceil(2), height.div_ceil(2)));
                let mut next = Vec::new();
                for y in 0..got.height() {
                    for x in 0..got.width() {
                        let mut sum = 0;
                        for (j, wj) in (0..).zip(binomial) {
                            for (i, wi) in (0..).zip(binomial) {
                                let u = (2 * x + i).saturating_sub(2).min(width - 1);
                                let v = (2 * y + j).saturating_sub(2).min(height - 1);
                                sum += wi * wj * before[v * width + u];
                            }
                        }
                        next.push((sum + 128) / 256);
                        prop_assert_eq!(i64::from(got.row(y)[x]), (sum + 128) / 256);
                    }
                }
                (before, width, height) = (next, got.width(), got.height());
            }
        }

        #[test]
        fn kernels_agree(values in prop::collection::vec(any::<u8>(), 0..150)) {
            let (mut s, mut t) = (vec![0; values.len()], vec![0; values.len()]);
            column_sums([&values; 5], &mut s);
            column_sums_body([&values; 5], &mut t);
            prop_assert_eq!(&s, &t);
            let (mut o, mut p) = (vec![0; s.len() / 2], vec![0; s.len() / 2]);
            halve_row(&s, &mut o);
            halve_row_body(&s, &mut p);
            prop_assert_eq!(o, p);
        }
    }
}
