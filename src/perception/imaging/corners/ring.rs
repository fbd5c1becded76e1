//! Ring response: how much a pixel looks like the corner where four squares of a chessboard meet.
//!
//! On a ring of 16 samples `I_k` about the pixel (radius 5 px) opposite samples are equal there and samples a quarter of a turn
//! apart differ; on an edge opposite samples differ; on a stripe the ring's mean is not that of its middle:
//!
//! ```text
//! a_k = (I_k + I_k+8) / 2
//! R   = mean_k |a_k - a_k+4|  -  mean_k |I_k - I_k+8|  -  2 |mean of the ring - mean of the middle|      >= 0
//! ```
//! in grey levels: about the contrast of the squares at a corner, 0 nearly everywhere else. (Bennett and Lasenby's ChESS, in
//! 8-bit arithmetic: all means are halved step by step.)

use super::lane::{Lane, PortableBytes};
use crate::imaging::ImageView;
use crate::imaging::simd::has_avx2;

/// Radius of the ring, px, as the paper has it; within this distance from the image's border there is no response.
pub const RING_RADIUS_PX: usize = 5;

/// The ring's samples `[x, y]` relative to its centre, px, by rising angle from x to y, as the paper has them.
pub const RING: [[i8; 2]; 16] = [
    [5, 0],
    [5, 2],
    [3, 3],
    [2, 5],
    [0, 5],
    [-2, 5],
    [-3, 3],
    [-5, 2],
    [-5, 0],
    [-5, -2],
    [-3, -3],
    [-2, -5],
    [0, -5],
    [2, -5],
    [3, -3],
    [5, -2],
];

/// Rows that the ring touches.
const ROWS: usize = 2 * RING_RADIUS_PX + 1;

/// The response of each pixel. Owns its buffer.
#[derive(Debug, Clone)]
pub struct RingResponse {
    values: Vec<u8>,
    width: usize,
    height: usize,
    #[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
    wide: bool,
}

impl RingResponse {
    /// A buffer for images of up to `pixels` pixels, allocated at once; larger ones make it grow.
    #[must_use]
    pub fn with_capacity(pixels: usize) -> Self {
        Self { values: Vec::with_capacity(pixels), width: 0, height: 0, wide: has_avx2() }
    }

    /// Responses of row `y`, grey levels; empty outside of the image.
    #[must_use]
    pub fn row(&self, y: usize) -> &[u8] {
        self.values.get(y * self.width..(y + 1) * self.width).unwrap_or(&[])
    }

    /// Columns and rows of the image, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Response of one pixel, grey levels; 0 outside of the image.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> u8 {
        self.row(y).get(x).copied().unwrap_or(0)
    }

    /// Computes all responses. Those that are at most `least` may be given as 0.
    pub fn compute(&mut self, image: &ImageView<'_>, least: u8) {
        (self.width, self.height) = (image.width(), image.height());
        let size = self.width * self.height;
        if self.values.len() != size {
            self.values.clear();
            self.values.resize(size, 0);
        }
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                self.compute_avx2(image, least);
            }
            return;
        }
        #[cfg(target_arch = "x86_64")]
        self.compute_with::<super::lane::x86::Sse2Bytes>(image, least);
        #[cfg(not(target_arch = "x86_64"))]
        self.compute_with::<PortableBytes<16>>(image, least);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn compute_avx2(&mut self, image: &ImageView<'_>, least: u8) {
        self.compute_with::<super::lane::x86::Avx2>(image, least);
    }

    #[inline(always)]
    fn compute_with<L: Lane>(&mut self, image: &ImageView<'_>, least: u8) {
        let (width, margin) = (self.width, RING_RADIUS_PX);
        for (y, out) in self.values.chunks_exact_mut(width.max(1)).enumerate() {
            if y < margin || y + margin >= self.height || width < ROWS {
                out.fill(0);
                continue;
            }
            let mut rows: [&[u8]; ROWS] = [&[]; ROWS];
            for (i, row) in rows.iter_mut().enumerate() {
                *row = image.row(y + i - margin);
            }
            let inner = width - 2 * margin;
            if let Some(out) = out.get_mut(..margin) {
                out.fill(0);
            }
            if let Some(out) = out.get_mut(width - margin..) {
                out.fill(0);
            }
            let Some(out) = out.get_mut(margin..width - margin) else { continue };
            if inner >= L::COUNT {
                let mut x = 0;
                while x + L::COUNT <= inner {
                    row_part::<L>(&rows, width, x, out, least);
                    x += L::COUNT;
                }
                if x < inner {
                    row_part::<L>(&rows, width, inner - L::COUNT, out, least);
                }
            } else {
                for x in 0..inner {
                    row_part::<PortableBytes<1>>(&rows, width, x, out, least);
                }
            }
        }
    }
}

/// Responses `x..x + COUNT` of a row, counted from the first pixel that has a whole ring.
#[inline(always)]
fn row_part<L: Lane>(rows: &[&[u8]; ROWS], width: usize, x: usize, out: &mut [u8], least: u8) {
    // one test here spares one at each load
    if rows.iter().any(|row| row.len() != width) || x + 2 * RING_RADIUS_PX + L::COUNT > width {
        return;
    }
    let at = |dx: i8, dy: i8| {
        let middle = RING_RADIUS_PX as i8;
        let (row, from) = ((middle + dy) as usize, x + (middle + dx) as usize);
        L::load(rows.get(row).and_then(|r| r.get(from..from + L::COUNT)).unwrap_or(&[]))
    };
    let Some(out) = out.get_mut(x..x + L::COUNT) else { return };
    let sample = |k: usize| RING.get(k).map_or(L::splat(0), |&[dx, dy]| at(dx, dy));
    let mut a = [L::splat(0); 8];
    let mut d = [L::splat(0); 8];
    for (k, (a, d)) in a.iter_mut().zip(&mut d).enumerate() {
        let (p, q) = (sample(k), sample(k + 8));
        (*a, *d) = (p.average(q), p.distance(q));
    }
    let [a0, a1, a2, a3, a4, a5, a6, a7] = a;
    let (s0, s1, s2, s3) = (a0.distance(a4), a1.distance(a5), a2.distance(a6), a3.distance(a7));
    let crossing = s0.average(s2).average(s1.average(s3));
    // nearly everywhere this alone decides
    if !crossing.minus(L::splat(least)).any() {
        L::splat(0).store(out);
        return;
    }
    let [d0, d1, d2, d3, d4, d5, d6, d7] = d;
    let edge = d0.average(d4).average(d2.average(d6)).average(d1.average(d5).average(d3.average(d7)));
    let ring = a0.average(a4).average(a2.average(a6)).average(a1.average(a5).average(a3.average(a7)));
    // not the pixel itself: at a sharp corner between pixels it is of one colour
    let middle = at(-1, 0).average(at(1, 0)).average(at(0, -1).average(at(0, 1)));
    let stripe = ring.distance(middle);
    crossing.minus(edge).minus(stripe).minus(stripe).store(out);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The definition in real numbers.
    fn slow(image: &ImageView<'_>, x: usize, y: usize) -> f64 {
        let at = |dx: i8, dy: i8| {
            f64::from(image.row((y as isize + dy as isize) as usize)[(x as isize + dx as isize) as usize])
        };
        let i: Vec<f64> = RING.iter().map(|&[dx, dy]| at(dx, dy)).collect();
        let (mut crossing, mut edge) = (0.0, 0.0);
        for k in 0..4 {
            crossing += (i[k] + i[k + 8] - i[k + 4] - i[k + 12]).abs() / 8.0;
        }
        for k in 0..8 {
            edge += (i[k] - i[k + 8]).abs() / 8.0;
        }
        let ring = i.iter().sum::<f64>() / 16.0;
        let middle = (at(-1, 0) + at(1, 0) + at(0, -1) + at(0, 1)) / 4.0;
        (crossing - edge - 2.0 * (ring - middle).abs()).max(0.0)
    }

    proptest! {
        #[test]
        fn kernels_agree(width in 1usize..90, height in 1usize..16, seed in any::<u64>(), bits in 0u32..8) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8 >> bits << bits
            }).collect();
            let image = ImageView::new(&pixels, width, height).unwrap();
            let mut response = RingResponse::with_capacity(0);
            response.compute(&image, 0);
            let best = response.values.clone();
            response.wide = false;
            response.values.fill(7);
            response.compute(&image, 0);
            prop_assert_eq!(&best, &response.values);
            response.values.fill(7);
            response.compute_with::<PortableBytes<16>>(&image, 0);
            prop_assert_eq!(&best, &response.values);
            for y in 0..height {
                for x in 0..width {
                    let inside = x >= 5 && y >= 5 && x + 5 < width && y + 5 < height;
                    let wanted = if inside { slow(&image, x, y) } else { 0.0 };
                    // each of the halvings rounds by a half at most
                    prop_assert!((f64::from(response.at(x, y)) - wanted).abs() < 6.0, "{} {}", response.at(x, y), wanted);
                }
            }
        }
    }

    #[test]
    fn corner_edge_stripe_and_disc() {
        let mut pixels = vec![0u8; 40 * 40];
        let mut response = RingResponse::with_capacity(1600);
        let mut at_middle = |light: &dyn Fn(f64, f64) -> bool| {
            for (i, p) in pixels.iter_mut().enumerate() {
                let (x, y) = ((i % 40) as f64 - 20.0, (i / 40) as f64 - 20.0);
                *p = if light(x, y) { 200 } else { 40 };
            }
            response.compute(&ImageView::new(&pixels, 40, 40).unwrap(), 4);
            response.at(20, 20)
        };
        assert!(at_middle(&|x, y| (x > 0.0) == (y > 0.0)) > 40);
        assert_eq!(at_middle(&|x, _| x > 0.0), 0);
        assert_eq!(at_middle(&|x, _| x.abs() < 3.0), 0);
        assert_eq!(at_middle(&|x, y| x.hypot(y) < 3.0), 0);
        assert_eq!(at_middle(&|_, _| true), 0);
    }
}
