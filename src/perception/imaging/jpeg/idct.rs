//! Inverse cosine transform of a block of 8 x 8 coefficients, in integers: first along the columns, then along the rows.
//!
//! One dimension of it, with c_k = cos(k pi / 16) sqrt 2 and the factor 1/sqrt 8 left to the end, where it is an eighth:
//! ```text
//! e0,1 = x0 +- x4         r0 = c2 x2 + c6 x6       r1 = c6 x2 - c2 x6
//! E0,3 = e0 +- r0         E1,2 = e1 +- r1          y0..7 = E0 + O0, E1 + O1, E2 + O2, E3 + O3, E3 - O3, ... E0 - O0
//! O0..3 = the four sums of c1, c3, c5, c7 with x1, x3, x5, x7
//! ```
//! The sums of 32 bits cannot overflow, whatever the coefficients are: the c_k of all eight add up to less than 8, times
//! 2^13 and 2^15. Between the passes values saturate at 16 bits; an image's own need 14.
//!
//! Pairs of coefficients that are multiplied together lie together in memory, because processors multiply pairs and add
//! them up in one step. Both kernels give the same bits.

/// Fractional bits of the factors. Derived: C1, the largest, is 1.387, so that 13 fractional bits fit a signed number of 16 bits.
const FACTOR_BITS: u32 = 13;
/// Fractional bits that are kept between the passes. Chosen by hand: the values of an image then need 14 of 16 bits (see above).
const KEPT_BITS: u32 = 3;
/// Shifts after the first and the second pass. Derived: the bits of the factors, less those that are kept, and with them; and the division by 8.
const SHIFT: [u32; 2] = [FACTOR_BITS - KEPT_BITS, FACTOR_BITS + KEPT_BITS + 3];
/// Added before the shifts for rounding: a half, and in the second pass also the grey level of zero, 128.
const BIAS: [i32; 2] = [1 << (SHIFT[0] - 1), (1 << (SHIFT[1] - 1)) + (128 << SHIFT[1])];

/// `sqrt 2 cos(k pi / 16)` in units of 2^-13, from the definition of the DCT in the standard; for k = 4 it is 1.
const C1: i16 = 11363;
const C2: i16 = 10703;
const C3: i16 = 9633;
const C4: i16 = 8192;
const C5: i16 = 6436;
const C6: i16 = 4433;
const C7: i16 = 2260;

/// Factors of a pair, for one result.
const EVEN: [[i16; 2]; 2] = [[C4, C4], [C4, -C4]];
const TURN: [[i16; 2]; 2] = [[C2, C6], [C6, -C2]];
const ODD: [[[i16; 2]; 2]; 4] =
    [[[C1, C3], [C5, C7]], [[C3, -C7], [-C1, -C5]], [[C5, -C1], [C7, C3]], [[C7, -C5], [C3, -C1]]];

/// Pairs of coefficients of a column (of a row) that the same factors multiply, which follows from the symmetry of the cosines.
const PAIRS: [[usize; 2]; 4] = [[0, 4], [2, 6], [1, 3], [5, 7]];
/// The order of columns in memory, chosen so that after the first pass the columns of a pair are four apart.
const COLUMNS: [usize; 8] = [0, 2, 1, 5, 4, 6, 3, 7];

/// A block's coefficients: four pairs of rows, in each the columns in their order, in each column the two of the pair.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub(super) struct Block(pub(super) [i16; 64]);

/// Grey levels of a block, row by row.
pub(super) type Tile = [u8; 64];

/// Row and column of the coefficients, an octal digit each, in the order of the file: zigzag, from the standard (T.81, figure A.6).
#[rustfmt::skip]
const ZIGZAG: [usize; 64] = [
    0o00, 0o01, 0o10, 0o20, 0o11, 0o02, 0o03, 0o12, 0o21, 0o30, 0o40, 0o31, 0o22, 0o13, 0o04, 0o05,
    0o14, 0o23, 0o32, 0o41, 0o50, 0o60, 0o51, 0o42, 0o33, 0o24, 0o15, 0o06, 0o07, 0o16, 0o25, 0o34,
    0o43, 0o52, 0o61, 0o70, 0o71, 0o62, 0o53, 0o44, 0o35, 0o26, 0o17, 0o27, 0o36, 0o45, 0o54, 0o63,
    0o72, 0o73, 0o64, 0o55, 0o46, 0o37, 0o47, 0o56, 0o65, 0o74, 0o75, 0o66, 0o57, 0o67, 0o76, 0o77,
];

/// Where each coefficient of the file lies in a [`Block`]: its row's pair and which of the two it is, its column's lane.
pub(super) static PLACES: [u8; 64] = {
    let mut places = [0; 64];
    let mut at = 0;
    while at < 64 {
        let mut k = 0;
        while ZIGZAG[k] != 8 * PAIRS[at / 16][at % 2] + COLUMNS[at / 2 % 8] {
            k += 1;
        }
        places[k] = at as u8;
        at += 1;
    }
    places
};

/// Grey level of a block with nothing but its mean, the same as by the transform.
#[inline(always)]
pub(super) fn flat(mean: i16) -> u8 {
    (((i32::from(mean) + 4) >> 3) + 128).clamp(0, 255) as u8
}

/// Kernel for every processor: lane by lane, so that compilers find the lanes.
#[cfg_attr(target_arch = "x86_64", allow(dead_code))]
#[inline(always)]
pub(super) fn portable(block: &Block) -> Tile {
    let first = pass(&block.0, 0);
    // the next pass goes along the rows: lanes are rows now
    let mut turned = [0i16; 64];
    for (pair, group) in PAIRS.iter().zip(turned.as_chunks_mut::<16>().0) {
        for (row, lane) in group.as_chunks_mut::<2>().0.iter_mut().enumerate() {
            for (out, &column) in lane.iter_mut().zip(pair) {
                let at = COLUMNS.iter().position(|c| *c == column).unwrap_or(0);
                *out = first[row][at].clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16;
            }
        }
    }
    let second = pass(&turned, 1);
    let mut tile = [0; 64];
    for (row, out) in tile.as_chunks_mut::<8>().0.iter_mut().enumerate() {
        for (level, column) in out.iter_mut().zip(&second) {
            *level = column[row].clamp(0, 255) as u8;
        }
    }
    tile
}

/// One pass over eight lanes: `[y0, .. y7]`, each of eight lanes.
#[inline(always)]
fn pass(block: &[i16; 64], which: usize) -> [[i32; 8]; 8] {
    let (bias, shift) = (BIAS[which & 1], SHIFT[which & 1]);
    let mut out = [[0; 8]; 8];
    for lane in 0..8 {
        let pair = |p: usize| [i32::from(block[p * 16 + lane * 2]), i32::from(block[p * 16 + lane * 2 + 1])];
        let sum = |x: [i32; 2], f: [i16; 2]| x[0] * i32::from(f[0]) + x[1] * i32::from(f[1]);
        let (x04, x26, x13, x57) = (pair(0), pair(1), pair(2), pair(3));
        let e = EVEN.map(|f| sum(x04, f) + bias);
        let r = TURN.map(|f| sum(x26, f));
        let E = [e[0] + r[0], e[1] + r[1], e[1] - r[1], e[0] - r[0]];
        let O = ODD.map(|f| sum(x13, f[0]) + sum(x57, f[1]));
        for i in 0..4 {
            out[i][lane] = (E[i] + O[i]) >> shift;
            out[7 - i][lane] = (E[i] - O[i]) >> shift;
        }
    }
    out
}

/// The kernel for AVX2: eight lanes in a register, products of pairs in one instruction.
#[cfg(target_arch = "x86_64")]
pub(super) mod x86 {
    use super::{BIAS, Block, EVEN, ODD, SHIFT, TURN, Tile};
    use std::arch::x86_64::{
        __m128i, __m256i, _mm_storeu_si128, _mm256_add_epi32, _mm256_castsi256_si128,
        _mm256_extracti128_si256, _mm256_loadu_si256, _mm256_madd_epi16, _mm256_packs_epi32,
        _mm256_packus_epi16, _mm256_permute4x64_epi64, _mm256_set1_epi32, _mm256_setr_epi8,
        _mm256_shuffle_epi8, _mm256_srai_epi32, _mm256_sub_epi32, _mm256_unpackhi_epi32,
        _mm256_unpackhi_epi64, _mm256_unpacklo_epi32, _mm256_unpacklo_epi64,
    };

    #[inline]
    #[target_feature(enable = "avx2")]
    fn factors(pair: [i16; 2]) -> __m256i {
        _mm256_set1_epi32(i32::from(pair[1]) << 16 | i32::from(pair[0] as u16))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn pass<const SHIFT_BITS: i32>(x: [__m256i; 4], bias: i32) -> [__m256i; 8] {
        let [x04, x26, x13, x57] = x;
        let bias = _mm256_set1_epi32(bias);
        let e0 = _mm256_add_epi32(_mm256_madd_epi16(x04, factors(EVEN[0])), bias);
        let e1 = _mm256_add_epi32(_mm256_madd_epi16(x04, factors(EVEN[1])), bias);
        let r0 = _mm256_madd_epi16(x26, factors(TURN[0]));
        let r1 = _mm256_madd_epi16(x26, factors(TURN[1]));
        let even = [
            _mm256_add_epi32(e0, r0),
            _mm256_add_epi32(e1, r1),
            _mm256_sub_epi32(e1, r1),
            _mm256_sub_epi32(e0, r0),
        ];
        let mut out = [bias; 8];
        for i in 0..4 {
            let odd = _mm256_add_epi32(
                _mm256_madd_epi16(x13, factors(ODD[i][0])),
                _mm256_madd_epi16(x57, factors(ODD[i][1])),
            );
            out[i] = _mm256_srai_epi32::<SHIFT_BITS>(_mm256_add_epi32(even[i], odd));
            out[7 - i] = _mm256_srai_epi32::<SHIFT_BITS>(_mm256_sub_epi32(even[i], odd));
        }
        out
    }

    /// Rows `row` and `row + 4`, each as four pairs of columns that the second pass multiplies together.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn paired(row: __m256i, row_4: __m256i) -> __m256i {
        // lanes 0..4 of both rows, then lanes 4..8 of both -> all lanes of one row, then of the other
        let rows = _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packs_epi32(row, row_4));
        #[rustfmt::skip]
        let weave = _mm256_setr_epi8(
            0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15,
            0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15,
        );
        _mm256_shuffle_epi8(rows, weave)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub(in super::super) fn avx2(block: &Block) -> Tile {
        let group = |g: usize| {
            // SAFETY: the block holds four groups of 16 coefficients; `g & 3` is one of them.
            #[allow(unsafe_code)]
            unsafe {
                _mm256_loadu_si256(block.0.as_ptr().cast::<__m256i>().add(g & 3))
            }
        };
        let y = pass::<{ SHIFT[0] as i32 }>([group(0), group(1), group(2), group(3)], BIAS[0]);
        let rows = [paired(y[0], y[4]), paired(y[1], y[5]), paired(y[2], y[6]), paired(y[3], y[7])];
        // pairs of columns in a row -> rows of a pair of columns, in each half of the registers
        let (a, b) = (_mm256_unpacklo_epi32(rows[0], rows[1]), _mm256_unpacklo_epi32(rows[2], rows[3]));
        let (c, d) = (_mm256_unpackhi_epi32(rows[0], rows[1]), _mm256_unpackhi_epi32(rows[2], rows[3]));
        let turned = [
            _mm256_unpacklo_epi64(a, b),
            _mm256_unpackhi_epi64(a, b),
            _mm256_unpacklo_epi64(c, d),
            _mm256_unpackhi_epi64(c, d),
        ];
        let z = pass::<{ SHIFT[1] as i32 }>(turned, BIAS[1]);
        // rows 0..4 of four columns, then rows 4..8 of them -> row after row
        #[rustfmt::skip]
        let turn = _mm256_setr_epi8(
            0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15,
            0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15,
        );
        let four = |z0, z1, z2, z3| {
            _mm256_shuffle_epi8(
                _mm256_packus_epi16(_mm256_packs_epi32(z0, z1), _mm256_packs_epi32(z2, z3)),
                turn,
            )
        };
        let (left, right) = (four(z[0], z[1], z[2], z[3]), four(z[4], z[5], z[6], z[7]));
        let (rows_0145, rows_2367) = (_mm256_unpacklo_epi32(left, right), _mm256_unpackhi_epi32(left, right));
        let mut tile = [0; 64];
        let parts = [
            _mm256_castsi256_si128(rows_0145),
            _mm256_castsi256_si128(rows_2367),
            _mm256_extracti128_si256::<1>(rows_0145),
            _mm256_extracti128_si256::<1>(rows_2367),
        ];
        for (out, part) in tile.as_chunks_mut::<16>().0.iter_mut().zip(parts) {
            // SAFETY: `out` holds the 16 bytes that are written.
            #[allow(unsafe_code)]
            unsafe {
                _mm_storeu_si128(out.as_mut_ptr().cast::<__m128i>(), part);
            }
        }
        tile
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_1_SQRT_2, PI};

    /// The transform as it is defined (T.81, A.3.3), in f64; `x[v][u]`.
    fn definition(x: &[[i16; 8]; 8]) -> [[f64; 8]; 8] {
        let scale = |k: usize| if k == 0 { FRAC_1_SQRT_2 } else { 1.0 };
        let wave = |at: usize, k: usize| ((2 * at + 1) as f64 * k as f64 * PI / 16.0).cos();
        let mut out = [[0.0; 8]; 8];
        for (row, line) in out.iter_mut().enumerate() {
            for (column, level) in line.iter_mut().enumerate() {
                for (v, coefficients) in x.iter().enumerate() {
                    for (u, &c) in coefficients.iter().enumerate() {
                        *level += 0.25 * scale(u) * scale(v) * f64::from(c) * wave(column, u) * wave(row, v);
                    }
                }
                *level = (*level + 128.0).clamp(0.0, 255.0);
            }
        }
        out
    }

    /// T.81, figure A.6, by rows.
    #[rustfmt::skip]
    const ORDER: [[usize; 8]; 8] = [
        [ 0,  1,  5,  6, 14, 15, 27, 28], [ 2,  4,  7, 13, 16, 26, 29, 42],
        [ 3,  8, 12, 17, 25, 30, 41, 43], [ 9, 11, 18, 24, 31, 40, 44, 53],
        [10, 19, 23, 32, 39, 45, 52, 54], [20, 22, 33, 38, 46, 51, 55, 60],
        [21, 34, 37, 47, 50, 56, 59, 61], [35, 36, 48, 49, 57, 58, 62, 63],
    ];

    fn block_of(x: &[[i16; 8]; 8]) -> Block {
        let mut block = Block([0; 64]);
        for (line, order) in x.iter().zip(&ORDER) {
            for (&c, &k) in line.iter().zip(order) {
                block.0[usize::from(PLACES[k])] = c;
            }
        }
        block
    }

    fn same_in_all_kernels(block: &Block) -> Tile {
        let tile = portable(block);
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the feature was just detected.
            #[allow(unsafe_code)]
            let wide = unsafe { x86::avx2(block) };
            assert_eq!(wide, tile);
        }
        tile
    }

    #[test]
    fn every_coefficient_has_a_place_of_its_own() {
        let mut places = PLACES;
        places.sort_unstable();
        assert!((0..64).eq(places));
    }

    #[test]
    fn a_mean_alone_is_flat() {
        for mean in (i16::MIN..=i16::MAX).step_by(7) {
            let mut block = Block([0; 64]);
            block.0[usize::from(PLACES[0])] = mean;
            assert_eq!(same_in_all_kernels(&block), [flat(mean); 64], "{mean}");
        }
    }

    proptest! {
        /// Coefficients of true images: those of random levels, by the transform's transpose, and of a few waves.
        #[test]
        fn is_the_cosine_transform(
            seed in prop::collection::vec((0usize..64, -180i16..180), 0..12),
            mean in -1000i16..1000,
        ) {
            let mut x = [[0; 8]; 8];
            for (at, c) in seed {
                x[at / 8][at % 8] = c;
            }
            x[0][0] = mean;
            let tile = same_in_all_kernels(&block_of(&x));
            for (level, wanted) in tile.iter().zip(definition(&x).as_flattened()) {
                prop_assert!((f64::from(*level) - wanted).abs() < 0.6, "{level} instead of {wanted}");
            }
        }

        #[test]
        fn kernels_agree_on_anything(x in prop::collection::vec(any::<i16>(), 64)) {
            same_in_all_kernels(&Block(*x.first_chunk().unwrap()));
        }
    }
}
