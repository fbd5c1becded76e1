//! The kernels: every luma of a line, written once and widened by the compiler to what the processor offers.

use crate::imaging::simd::has_avx2;

/// How the levels of a line are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pick {
    /// All bytes.
    Copy,
    /// The first byte of each two.
    First,
    /// The second byte of each two.
    Second,
    /// Each two bytes as a little-endian number, shifted right; what does not fit is white.
    Shifted(u32),
    /// The sum of each three bytes, weighted in 256ths.
    Weighted([u16; 3]),
}

/// A kernel, in the width of this processor.
#[derive(Debug, Clone, Copy)]
pub(super) struct LumaKernel {
    pick: Pick,
    #[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
    wide: bool,
}

impl LumaKernel {
    fn new(pick: Pick) -> Self {
        Self { pick, wide: has_avx2() }
    }

    pub(super) fn copy() -> Self {
        Self::new(Pick::Copy)
    }

    pub(super) fn first() -> Self {
        Self::new(Pick::First)
    }

    pub(super) fn second() -> Self {
        Self::new(Pick::Second)
    }

    pub(super) fn shifted(bits: u32) -> Self {
        Self::new(Pick::Shifted(bits))
    }

    pub(super) fn weighted(weights: [u16; 3]) -> Self {
        Self::new(Pick::Weighted(weights))
    }

    /// The kernel that every processor of this architecture has.
    #[cfg(test)]
    pub(super) fn narrow(self) -> Self {
        Self { wide: false, ..self }
    }

    /// Fills `out`, lines of `width` px, from lines that begin `stride` bytes apart. Lines that `raw` lacks are left out.
    pub(super) fn convert(self, raw: &[u8], stride: usize, width: usize, out: &mut [u8]) {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                self.convert_wide(raw, stride, width, out);
            }
            return;
        }
        self.convert_lines(raw, stride, width, out);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn convert_wide(self, raw: &[u8], stride: usize, width: usize, out: &mut [u8]) {
        self.convert_lines(raw, stride, width, out);
    }

    #[inline(always)]
    fn convert_lines(self, raw: &[u8], stride: usize, width: usize, out: &mut [u8]) {
        match self.pick {
            Pick::Copy => each_line(raw, stride, width, width, out, |line, out| {
                if let Some(line) = line.get(..out.len()) {
                    out.copy_from_slice(line);
                }
            }),
            Pick::First => each_pair(raw, stride, width, out, |[first, _]| first),
            Pick::Second => each_pair(raw, stride, width, out, |[_, second]| second),
            Pick::Shifted(2) => each_pair(raw, stride, width, out, |pair| shifted(pair, 2)),
            Pick::Shifted(bits) => each_pair(raw, stride, width, out, |pair| shifted(pair, bits)),
            Pick::Weighted(weights) => each_line(raw, stride, 3 * width, width, out, |line, levels| {
                for (out, colours) in levels.iter_mut().zip(line.as_chunks::<3>().0) {
                    *out = weighted(*colours, weights);
                }
            }),
        }
    }
}

/// Calls `f(line, levels)` for each line; for all of them at once where nothing lies between them.
#[inline(always)]
fn each_line(
    raw: &[u8],
    stride: usize,
    line: usize,
    width: usize,
    out: &mut [u8],
    f: impl Fn(&[u8], &mut [u8]),
) {
    if stride == line {
        return f(raw, out);
    }
    // the last line may lack its padding
    for (line, levels) in raw.chunks(stride.max(1)).zip(out.chunks_exact_mut(width.max(1))) {
        f(line, levels);
    }
}

/// Fills each line from pairs of bytes.
#[inline(always)]
fn each_pair(raw: &[u8], stride: usize, width: usize, out: &mut [u8], level: impl Fn([u8; 2]) -> u8) {
    each_line(raw, stride, 2 * width, width, out, |line, levels| {
        for (out, pair) in levels.iter_mut().zip(line.as_chunks::<2>().0) {
            *out = level(*pair);
        }
    });
}

/// The weighted mean, rounded.
#[inline(always)]
fn weighted(colours: [u8; 3], weights: [u16; 3]) -> u8 {
    let sum: u16 = colours.iter().zip(weights).map(|(c, w)| u16::from(*c) * w).sum();
    (sum.saturating_add(128) >> 8) as u8
}

#[inline(always)]
fn shifted(pair: [u8; 2], bits: u32) -> u8 {
    (u16::from_le_bytes(pair) >> bits).min(255) as u8
}
