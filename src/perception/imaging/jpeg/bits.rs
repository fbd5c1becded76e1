//! Coded data without its stuffing, and its bits.

/// Zeros behind the data, so that the last bits are read like all others.
const BEYOND: usize = 8;

/// What ended a piece of coded data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SegmentEnd {
    /// A restart marker, by its number 0..=7.
    Restart(u8),
    /// Another marker, which begins at this byte.
    Marker(usize),
    /// The end of the bytes.
    Bytes,
}

/// Coded data up to the next marker: the byte 0 behind each 0xFF is taken out. The buffer is reused.
#[derive(Default)]
pub(super) struct Coded {
    bytes: Vec<u8>,
}

impl Coded {
    pub(super) fn with_capacity(bytes: usize) -> Self {
        Self { bytes: Vec::with_capacity(bytes + BEYOND) }
    }

    /// Takes in `bytes` from `from` to the next marker. Returns where the next piece begins, and what ended this one.
    pub(super) fn take(&mut self, bytes: &[u8], from: usize) -> (usize, SegmentEnd) {
        self.bytes.clear();
        self.bytes.reserve(bytes.len().saturating_sub(from) + BEYOND);
        let mut at = from;
        let end = loop {
            let rest = bytes.get(at..).unwrap_or(&[]);
            let Some(plain) = find_ff(rest) else {
                self.bytes.extend_from_slice(rest);
                break (bytes.len(), SegmentEnd::Bytes);
            };
            self.bytes.extend_from_slice(rest.get(..plain).unwrap_or(&[]));
            at += plain;
            // any number of 0xFF may stand before the byte that tells
            let behind = bytes.get(at..).unwrap_or(&[]);
            let Some(fill) = behind.iter().position(|b| *b != 0xFF) else {
                break (bytes.len(), SegmentEnd::Bytes);
            };
            match behind.get(fill) {
                Some(0) => {
                    self.bytes.push(0xFF);
                    at += fill + 1;
                }
                Some(marker @ 0xD0..=0xD7) => break (at + fill + 1, SegmentEnd::Restart(marker & 7)),
                _ => break (at, SegmentEnd::Marker(at)),
            }
        };
        self.bytes.extend_from_slice(&[0; BEYOND]);
        end
    }

    /// The bits taken in last.
    pub(super) fn bits(&self) -> Bits<'_> {
        Bits { bytes: &self.bytes, at: 0, window: 0, count: 0 }
    }
}

/// Where the first byte 0xFF is: pieces without one, then the bytes of the piece that has it.
#[inline(always)]
fn find_ff(bytes: &[u8]) -> Option<usize> {
    let (pieces, _) = bytes.as_chunks::<32>();
    let plain = |piece: &&[u8; 32]| piece.iter().fold(0, |any, b| any | u8::from(*b == 0xFF)) == 0;
    let from = 32 * pieces.iter().take_while(plain).count();
    bytes.get(from..)?.iter().position(|b| *b == 0xFF).map(|found| from + found)
}

/// A reader of bits, the first one uppermost. Behind the end there are zeros without end.
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    window: u64,
    /// Bits of the window that are counted as read from the bytes, 0..=63.
    count: u32,
}

impl Bits<'_> {
    /// The bits that come next: all 64 are right directly after [`Self::refill`], later at least as many as are left of its 56.
    #[inline(always)]
    pub(super) fn window(&self) -> u64 {
        self.window
    }

    /// Makes sure of at least 56 bits.
    #[inline(always)]
    pub(super) fn refill(&mut self) {
        if let Some(next) = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<8>()) {
            self.window |= u64::from_be_bytes(*next) >> self.count;
        } else {
            self.window |= last_bytes(self.bytes, self.at) >> self.count;
        }
        self.at += (63 - self.count) as usize >> 3;
        self.count |= 56;
    }

    /// Goes on by `bits`, together at most 56 between two refills.
    #[inline(always)]
    pub(super) fn skip(&mut self, bits: u32) {
        self.window <<= bits;
        self.count -= bits;
    }

    /// Whether what was read is all there was: not more, and behind it at most the rest of a byte, and zeros, with which some
    /// devices fill up.
    pub(super) fn used_up(&self) -> Result<(), LengthMismatch> {
        let read = (self.at * 8).saturating_sub(self.count as usize);
        let there = self.bytes.len().saturating_sub(BEYOND);
        match self.bytes.get(read.div_ceil(8)..there) {
            None => Err(LengthMismatch::Missing),
            Some(rest) if rest.iter().all(|b| *b == 0) => Ok(()),
            Some(_) => Err(LengthMismatch::Left),
        }
    }
}

/// The bytes from `at` on, of which there are less than eight, and zeros behind them.
#[cold]
#[inline(never)]
fn last_bytes(bytes: &[u8], at: usize) -> u64 {
    let mut last = [0; 8];
    last.iter_mut().zip(bytes.get(at..).unwrap_or(&[])).for_each(|(a, b)| *a = *b);
    u64::from_be_bytes(last)
}

/// Coded data that does not fit the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LengthMismatch {
    /// There is less than the image needs.
    Missing,
    /// There is more.
    Left,
}
