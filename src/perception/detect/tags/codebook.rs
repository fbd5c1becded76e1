//! Error-correcting lookup: from the bits that were read to the code of the family with the least Hamming distance.
//!
//! A word is cut into three parts. With at most two bits wrong one part is right: only the codes that share a part with the word
//! are compared, instead of all of them in four turns.

use crate::target::TagFamily;

/// Parts of a word: one more than the bits that may be wrong, so that one of the parts must be right.
const PARTS: usize = 3;

/// The code to which a word was decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Reading {
    /// Which tag.
    pub(super) id: u32,
    /// Quarter turns, counter-clockwise, by which the tag appears rotated in the image.
    pub(super) turns: u32,
    /// Bits that were wrong.
    pub(super) hamming: u32,
}

/// Codes of a family, by the parts of their words.
#[derive(Debug, Clone)]
pub(super) struct Codebook {
    family: TagFamily,
    /// Bits of a part; the last takes what is left.
    part_bits: u32,
    /// For each part: (part of the word, id), ordered by it; and where each value of the part begins.
    entries: [Box<[u16]>; PARTS],
    begins: [Box<[u16]>; PARTS],
}

impl Codebook {
    pub(super) fn new(family: TagFamily) -> Self {
        let part_bits = family.bits().div_ceil(PARTS as u32);
        let empty = || -> [Box<[u16]>; PARTS] { [Box::default(), Box::default(), Box::default()] };
        let mut book = Self { family, part_bits, entries: empty(), begins: empty() };
        for part in 0..PARTS {
            let mut ids: Vec<u16> = (0..family.count() as u16).collect();
            let value =
                |id: u16| family.codes().get(usize::from(id)).map_or(0, |&code| book.part(code, part));
            ids.sort_by_key(|&id| value(id));
            let begins =
                (0..=1usize << part_bits).map(|v| ids.partition_point(|&id| value(id) < v) as u16).collect();
            if let (Some(e), Some(b)) = (book.entries.get_mut(part), book.begins.get_mut(part)) {
                (*e, *b) = (ids.into(), begins);
            }
        }
        book
    }

    fn part(&self, word: u64, part: usize) -> usize {
        (word >> (self.part_bits * part as u32)) as usize & ((1 << self.part_bits) - 1)
    }

    /// The tag that `word` is, with at most `most` (two) bits wrong.
    pub(super) fn read(&self, word: u64, most: u32) -> Option<Reading> {
        let mut best: Option<Reading> = None;
        for turns in 0..4 {
            // what the image shows turned counter-clockwise, upright again
            let upright = self.family.turned(word, 4 - turns);
            for (part, (entries, begins)) in self.entries.iter().zip(&self.begins).enumerate() {
                let value = self.part(upright, part);
                let (Some(&from), Some(&to)) = (begins.get(value), begins.get(value + 1)) else { continue };
                for &id in entries.get(usize::from(from)..usize::from(to)).unwrap_or(&[]) {
                    let Some(code) = self.family.codes().get(usize::from(id)) else { continue };
                    let hamming = (code ^ upright).count_ones();
                    if hamming <= best.map_or(most, |b| b.hamming.saturating_sub(1))
                        && best.is_none_or(|b| hamming < b.hamming)
                    {
                        best = Some(Reading { id: u32::from(id), turns, hamming });
                    }
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// All codes, all turns, by counting.
    fn slow(family: TagFamily, word: u64, most: u32) -> Option<Reading> {
        let all = (0..4).flat_map(|turns| (0..family.count()).map(move |id| (turns, id)));
        all.map(|(turns, id)| {
            let hamming = (family.turned(family.codes()[id as usize], turns) ^ word).count_ones();
            Reading { id, turns, hamming }
        })
        .filter(|r| r.hamming <= most)
        .min_by_key(|r| r.hamming)
    }

    proptest! {
        #[test]
        fn reads_as_by_counting(
            which in 0usize..3, id in any::<prop::sample::Index>(), turns in 0u32..4, flips in prop::collection::vec(0u32..36, 0..4),
        ) {
            let family = TagFamily::ALL[which];
            let id = id.index(family.count() as usize);
            let mut word = family.turned(family.codes()[id], turns);
            for flip in flips {
                word ^= 1 << (flip % family.bits());
            }
            let book = Codebook::new(family);
            for most in 0..=2 {
                let (fast, slow) = (book.read(word, most), slow(family, word, most));
                prop_assert_eq!(fast.map(|r| r.hamming), slow.map(|r| r.hamming));
                if most * 2 < family.distance() {
                    prop_assert_eq!(fast, slow);
                }
            }
        }
    }
}
