//! Gaussian filter: the two passes of a separable kernel in 16-bit fixed point.
//!
//! `w_k ~ exp(-k^2 / (2 sigma^2))`, `|k| <= ceil(3 sigma)`, in units of 2^-16 and of sum 1. Levels carry 7 fractional bits between the
//! passes. Each product is cut to these, and half a unit a product is given back at the start, so that the sum is off by less than
//! half a level at any width. Pixels outside of the image have the level of the nearest one inside.

use super::simd::kernel;
use super::{ImageView, Plane};
use thiserror::Error;

#[cfg(target_arch = "x86_64")]
mod x86;

/// Greatest standard deviation, px: beyond, filter a smaller image of the pyramid. Chosen by hand: 61 taps a side; time grows with them.
const MAX_SIGMA_PX: f64 = 20.0;
/// Fractional bits between the passes. Derived: the sum of two levels with them, 2 * 255 * 2^7 = 65 280, fits 16 bits.
const FRACTION: u32 = 7;

/// The standard deviation asked for is none.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("a Gaussian filter of {sigma_px} px: expected 0 to {MAX_SIGMA_PX} px")]
pub struct GaussianError {
    /// What was asked for, px.
    pub sigma_px: f64,
}

/// A filter of one width. The buffers are reused.
#[derive(Debug, Clone)]
pub struct Gaussian {
    /// `w_0, w_1, ...` in 2^-16; one that is left of a kernel without width is no filter.
    weights: Vec<u16>,
    columns: Vec<u16>,
    sums: Vec<u16>,
}

impl Gaussian {
    /// A filter of standard deviation `sigma_px`.
    ///
    /// # Errors
    /// [`GaussianError`] when it is not within 0 and 20 px.
    pub fn new(sigma_px: f64) -> Result<Self, GaussianError> {
        if !(0.0..=MAX_SIGMA_PX).contains(&sigma_px) {
            return Err(GaussianError { sigma_px });
        }
        let radius = (3.0 * sigma_px).ceil() as usize;
        let gaussian = |k: usize| if k == 0 { 1.0 } else { (-0.5 * (k as f64 / sigma_px).powi(2)).exp() };
        let sum = 1.0 + 2.0 * (1..=radius).map(gaussian).sum::<f64>();
        let mut weights = vec![0u16; radius + 1];
        let mut left = 1u32 << 16;
        for (k, w) in weights.iter_mut().enumerate().skip(1) {
            *w = (65536.0 * gaussian(k) / sum).round() as u16;
            left -= 2 * u32::from(*w);
        }
        // what rounding left over goes to the middle; all of it there is a filter without effect
        match (u16::try_from(left), weights.first_mut()) {
            (Ok(left), Some(middle)) => *middle = left,
            _ => weights.clear(),
        }
        Ok(Self { weights, columns: Vec::new(), sums: Vec::new() })
    }

    /// Pixels on either side that enter.
    #[must_use]
    pub fn radius_px(&self) -> usize {
        self.weights.len().saturating_sub(1)
    }

    /// Filters the image into `out`.
    pub fn filter(&mut self, image: &ImageView<'_>, out: &mut Plane<u8>) {
        let (width, height) = (image.width(), image.height());
        out.reshape(width, height);
        let Some((&middle, sides)) = self.weights.split_first() else {
            (0..height).for_each(|y| out.row_mut(y).copy_from_slice(image.row(y)));
            return;
        };
        let radius = sides.len();
        self.columns.resize(width + 2 * radius, 0);
        self.sums.resize(width, 0);
        for y in 0..height {
            let Some(columns) = self.columns.get_mut(radius..radius + width) else { return };
            columns_of(image, y, middle, sides, columns);
            let (Some(&first), Some(&last)) = (columns.first(), columns.last()) else { return };
            let (before, rest) = self.columns.split_at_mut(radius);
            before.fill(first);
            rest.get_mut(width..).unwrap_or(&mut []).fill(last);
            row_of(&self.columns, middle, sides, &mut self.sums, out.row_mut(y));
        }
    }
}

/// Half a unit for each product that is cut.
fn given_back(sides: &[u16]) -> u16 {
    (sides.len() as u16).div_ceil(2)
}

/// Sums over the columns about row `y`.
fn columns_of(image: &ImageView<'_>, y: usize, middle: u16, sides: &[u16], columns: &mut [u16]) {
    #[cfg(target_arch = "x86_64")]
    if x86::columns(image, y, middle, sides, columns) {
        return;
    }
    let last = image.height().saturating_sub(1);
    middle_row(image.row(y), middle, given_back(sides), columns);
    for (k, &weight) in (1..).zip(sides) {
        add_rows(image.row(y.saturating_sub(k)), image.row((y + k).min(last)), weight, columns);
    }
}

/// Levels of a row from its `columns`, which begin and end with as many more as `sides` has; `sums` has room for a row.
fn row_of(columns: &[u16], middle: u16, sides: &[u16], sums: &mut [u16], out: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    if x86::row(columns, middle, sides, out) {
        return;
    }
    let radius = sides.len();
    middle_sums(columns.get(radius..).unwrap_or(&[]), middle, given_back(sides), sums);
    for (k, &weight) in (1..).zip(sides) {
        if let (Some(left), Some(right)) = (columns.get(radius - k..), columns.get(radius + k..)) {
            add_sums(left, right, weight, sums);
        }
    }
    round_row(sums, out);
}

kernel!(fn middle_row(pixels: &[u8], weight: u16, start: u16, sums: &mut [u16]) = middle_row_body);
kernel!(fn add_rows(above: &[u8], below: &[u8], weight: u16, sums: &mut [u16]) = add_rows_body);
kernel!(fn middle_sums(columns: &[u16], weight: u16, start: u16, sums: &mut [u16]) = middle_sums_body);
kernel!(fn add_sums(left: &[u16], right: &[u16], weight: u16, sums: &mut [u16]) = add_sums_body);
kernel!(fn round_row(sums: &[u16], out: &mut [u8]) = round_row_body);

/// The upper half of the product.
#[inline(always)]
fn high(a: u16, b: u16) -> u16 {
    ((u32::from(a) * u32::from(b)) >> 16) as u16
}

#[inline(always)]
fn middle_row_body(pixels: &[u8], weight: u16, start: u16, sums: &mut [u16]) {
    for (s, &p) in sums.iter_mut().zip(pixels) {
        *s = start + high(u16::from(p) << FRACTION, weight);
    }
}

#[inline(always)]
fn add_rows_body(above: &[u8], below: &[u8], weight: u16, sums: &mut [u16]) {
    for ((s, &a), &b) in sums.iter_mut().zip(above).zip(below) {
        *s += high((u16::from(a) + u16::from(b)) << FRACTION, weight);
    }
}

#[inline(always)]
fn middle_sums_body(columns: &[u16], weight: u16, start: u16, sums: &mut [u16]) {
    for (s, &c) in sums.iter_mut().zip(columns) {
        *s = start + high(c, weight);
    }
}

#[inline(always)]
fn add_sums_body(left: &[u16], right: &[u16], weight: u16, sums: &mut [u16]) {
    for ((s, &l), &r) in sums.iter_mut().zip(left).zip(right) {
        *s += high(l + r, weight);
    }
}

#[inline(always)]
fn round_row_body(sums: &[u16], out: &mut [u8]) {
    for (o, &s) in out.iter_mut().zip(sums) {
        *o = ((s + (1 << (FRACTION - 1))) >> FRACTION).min(255) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_image::any_image;
    use super::*;
    use proptest::prelude::*;

    /// The kernel in fixed point, by its definition, all 2 r + 1 products in both directions, with other code for everything.
    fn weights(sigma: f64) -> Vec<i64> {
        let radius = (3.0 * sigma).ceil() as i64;
        let gaussian: Vec<f64> = (-radius..=radius)
            .map(|k| if k == 0 { 1.0 } else { (-0.5 * (k as f64 / sigma).powi(2)).exp() })
            .collect();
        let sum: f64 = gaussian[radius as usize] + 2.0 * gaussian[radius as usize + 1..].iter().sum::<f64>();
        let mut w: Vec<i64> = gaussian.iter().map(|b| (65536.0 * b / sum).round() as i64).collect();
        w[radius as usize] += 65536 - w.iter().sum::<i64>();
        w
    }

    proptest! {
        #[test]
        fn filter_is_the_convolution(image in any_image(), sigma in 0.0..6.0f64) {
            let (view, mut out) = (image.view(), Plane::default());
            Gaussian::new(sigma).unwrap().filter(&view, &mut out);
            let w = weights(sigma);
            let radius = w.len() as i64 / 2;
            for y in 0..view.height() as i64 {
                for x in 0..view.width() as i64 {
                    let mut exact = 0;
                    for (j, &wj) in (-radius..=radius).zip(&w) {
                        for (i, &wi) in (-radius..=radius).zip(&w) {
                            exact += wj * wi * image.at(x + i, y + j);
                        }
                    }
                    let exact = exact as f64 / 65536f64.powi(2);
                    let got = f64::from(out.get(x as usize, y as usize).unwrap());
                    // rounding, and the fractions that are cut
                    prop_assert!((got - exact).abs() <= 0.5 + (radius + 3) as f64 / 128.0, "{} {}", got, exact);
                }
            }
        }

        /// To the bit: the same sums, one pixel at a time.
        #[test]
        fn filter_equals_its_scalar_form(image in any_image(), sigma in 0.2..4.0f64) {
            let (view, mut out) = (image.view(), Plane::default());
            Gaussian::new(sigma).unwrap().filter(&view, &mut out);
            let w = weights(sigma);
            let radius = w.len() / 2;
            if w[radius] > 65535 {
                return Ok(());
            }
            let r = radius as i64;
            let fold = |at: &dyn Fn(i64) -> i64| {
                (1..=r).fold((r + 1) / 2 + ((at(0) * w[radius]) >> 16), |s, k| {
                    s + (((at(-k) + at(k)) * w[radius + k as usize]) >> 16)
                })
            };
            for y in 0..view.height() as i64 {
                for x in 0..view.width() as i64 {
                    let last = view.width() as i64 - 1;
                    let column = |i: i64| fold(&|k| image.at((x + i).clamp(0, last), y + k) << 7);
                    let wanted = ((fold(&column) + 64) >> 7).min(255);
                    prop_assert_eq!(i64::from(out.get(x as usize, y as usize).unwrap()), wanted);
                }
            }
        }

        #[test]
        fn kernels_agree(a in prop::collection::vec((any::<u8>(), any::<u8>(), 0u16..32000), 0..70), w in 0u16..32768) {
            let p: Vec<u8> = a.iter().map(|v| v.0).collect();
            let q: Vec<u8> = a.iter().map(|v| v.1).collect();
            let c: Vec<u16> = a.iter().map(|v| v.2).collect();
            let (mut s, mut t) = (c.clone(), c.clone());
            middle_row(&p, w, 3, &mut s);
            middle_row_body(&p, w, 3, &mut t);
            prop_assert_eq!(&s, &t);
            add_rows(&p, &q, w, &mut s);
            add_rows_body(&p, &q, w, &mut t);
            prop_assert_eq!(&s, &t);
            middle_sums(&c, w, 3, &mut s);
            middle_sums_body(&c, w, 3, &mut t);
            add_sums(&c, &c, w, &mut s);
            add_sums_body(&c, &c, w, &mut t);
            prop_assert_eq!(&s, &t);
            let (mut o, mut r) = (p.clone(), p);
            round_row(&s, &mut o);
            round_row_body(&s, &mut r);
            prop_assert_eq!(o, r);
        }
    }

    #[test]
    fn what_is_flat_stays_and_bounds_are_kept() {
        for sigma in [0.0, 0.05, 0.5, 1.0, 3.3, 10.0, 20.0] {
            let mut filter = Gaussian::new(sigma).unwrap();
            let mut out = Plane::default();
            for level in [0, 1, 77, 128, 254, 255] {
                let pixels = [level; 40 * 3];
                filter.filter(&ImageView::new(&pixels, 40, 3).unwrap(), &mut out);
                assert!(out.as_slice().iter().all(|&p| p == level), "{sigma} {level} {:?}", out.get(5, 1));
            }
        }
        for sigma in [-1.0, f64::NAN, f64::INFINITY, 20.1] {
            assert!(Gaussian::new(sigma).is_err());
        }
    }
}
