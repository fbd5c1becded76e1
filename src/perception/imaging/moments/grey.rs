//! Sums weighted with grey levels.

use super::MomentSums;
use crate::imaging::simd::kernel;
use crate::imaging::{ImageView, Window};

/// Pixels whose sums fit the lanes. Derived: the third power of the last index is 29 791, that times 255, added up, below 2^31.
const BLOCK: usize = 32;

/// `x`, `x^2`, `x^3` within a block. Derived: moments up to the third order need these.
const POWERS: [[i16; BLOCK]; 3] = {
    let mut powers = [[0; BLOCK]; 3];
    let mut x = 0;
    while x < BLOCK {
        let v = x as i16;
        (powers[0][x], powers[1][x], powers[2][x]) = (v, v * v, v * v * v);
        x += 1;
    }
    powers
};

impl MomentSums {
    /// Sums over a window, each pixel weighted with its level; what lies beyond the image counts nothing.
    #[must_use]
    pub fn of_grey(image: &ImageView<'_>, window: &Window) -> Self {
        let mut sums = Self::default();
        let x1 = window.x1.min(image.width());
        for y in window.y0..window.y1.min(image.height()) {
            if let Some(pixels) = image.row(y).get(window.x0..x1) {
                sums.add_grey(pixels, window.x0 as u32, y as u32);
            }
        }
        sums
    }

    /// Adds pixels of row `y` from column `x0` on, each weighted with its level.
    pub fn add_grey(&mut self, pixels: &[u8], x0: u32, y: u32) {
        // sums about x0 first: small numbers, exact in 64 bits for rows of up to 2^18 px
        let row = row_sums(pixels);
        let about = Self::of_row(row.map(i128::from), 0);
        *self += about.shifted(x0.into(), y.into());
    }
}

kernel!(
    /// Sums of levels times `1, x, x^2, x^3`, counted from the row's first pixel.
    fn row_sums(pixels: &[u8]) -> [u64; 4] = row_sums_body
);

#[inline(always)]
fn row_sums_body(pixels: &[u8]) -> [u64; 4] {
    let mut row = [0u64; 4];
    let (blocks, rest) = pixels.as_chunks::<BLOCK>();
    let mut at = 0;
    for block in blocks {
        add_block(&mut row, block, at);
        at += BLOCK as u64;
    }
    if !rest.is_empty() {
        let mut last = [0; BLOCK];
        last.iter_mut().zip(rest).for_each(|(a, b)| *a = *b);
        add_block(&mut row, &last, at);
    }
    row
}

/// Adds a block's sums; its first pixel is `at`.
#[inline(always)]
fn add_block(row: &mut [u64; 4], block: &[u8; BLOCK], at: u64) {
    let dot = |w: &[i16; BLOCK]| -> u64 {
        let sum: i32 = block.iter().zip(w).map(|(&p, &w)| i32::from(i16::from(p)) * i32::from(w)).sum();
        sum as u64
    };
    let s0: u64 = block.iter().map(|&p| u64::from(p)).sum();
    let [s1, s2, s3] = [dot(&POWERS[0]), dot(&POWERS[1]), dot(&POWERS[2])];
    let [r0, r1, r2, r3] = row;
    let mul = u64::wrapping_mul;
    *r0 = r0.wrapping_add(s0);
    *r1 = r1.wrapping_add(s1).wrapping_add(mul(at, s0));
    *r2 = r2.wrapping_add(s2).wrapping_add(mul(at, 2 * s1)).wrapping_add(mul(at * at, s0));
    let cube = mul(at, 3 * s2).wrapping_add(mul(at * at, 3 * s1)).wrapping_add(mul(mul(at * at, at), s0));
    *r3 = r3.wrapping_add(s3).wrapping_add(cube);
}
