//! Huffman codes of a JPEG, and tables that find a symbol by the next 11 bits.
//!
//! A symbol says how many zeros come first (its upper half) and how many bits of a value follow it (its lower half).

use super::JpegError;
use super::bits::Bits;

/// Bits of the look-up table. Chosen by hand: longer codes are rare, and a table of 2^11 entries fits the first-level cache.
const LOOK: u32 = 11;
/// Bits of the longest code, by ITU-T T.81.
const LONGEST: usize = 16;
/// Lengths of codes beyond those that are looked at.
const LONG: usize = LONGEST - LOOK as usize;
/// Most bits of a value: of a difference of means, and of any other coefficient of an 8-bit image (ITU-T T.81, tables F.1 and F.2).
const DC_VALUE_BITS: u8 = 11;
const AC_VALUE_BITS: u8 = 10;
/// What the end of a block adds to the position in it: more than a block has, so that it differs from a run that is too long.
pub(super) const END_OF_BLOCK: usize = 128;

/// A code as a file has it: how many symbols there are with codes of each length, and the symbols.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Code {
    counts: [u8; LONGEST],
    symbols: [u8; 256],
}

impl Code {
    /// Symbols beyond 256 are left out.
    pub(super) const fn new(counts: [u8; LONGEST], symbols: &[u8]) -> Self {
        let mut all = [0; 256];
        let mut i = 0;
        while i < symbols.len() && i < 256 {
            all[i] = symbols[i];
            i += 1;
        }
        Self { counts, symbols: all }
    }

    /// Reads a code from the start of `bytes`; the second value is what is left of them.
    pub(super) fn read(bytes: &[u8]) -> Result<(Self, &[u8]), JpegError> {
        let (counts, rest) =
            bytes.split_first_chunk::<LONGEST>().ok_or(JpegError::Damaged("a Huffman table is cut short"))?;
        let mut next = 0u32;
        for (length, &count) in (1u32..).zip(counts) {
            next = next * 2 + u32::from(count);
            if next > 1 << length {
                return Err(JpegError::Damaged("a Huffman table has more codes than there can be"));
            }
        }
        let symbols: usize = counts.iter().map(|&n| usize::from(n)).sum();
        let (symbols, rest) = rest
            .split_at_checked(symbols)
            .filter(|(symbols, _)| symbols.len() <= 256)
            .ok_or(JpegError::Damaged("a Huffman table is cut short"))?;
        Ok((Self::new(*counts, symbols), rest))
    }

    /// Calls `f(code, its length, symbol)` for each symbol.
    fn each(&self, mut f: impl FnMut(u32, u32, u8)) {
        let mut symbols = self.symbols.iter();
        let mut code = 0;
        for (length, &count) in (1..).zip(&self.counts) {
            for &symbol in symbols.by_ref().take(usize::from(count)) {
                f(code, length, symbol);
                code += 1;
            }
            code *= 2;
        }
    }
}

/// What a code stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TableClass {
    /// Differences of the mean level.
    Dc,
    /// All other coefficients.
    Ac,
}

/// One symbol, packed into a number: the bits of code and value together, bits of the value, steps to the coefficient, bits
/// of the code. 0 is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Entry(u32);

impl Entry {
    const NONE: Self = Self(0);

    fn new(kind: TableClass, symbol: u8, length: u32) -> Self {
        let (run, size) = (symbol >> 4, symbol & 15);
        let steps = match (kind, run, size) {
            (TableClass::Dc, 0, ..=DC_VALUE_BITS) => 0,
            (TableClass::Ac, 0, 0) => END_OF_BLOCK as u32,
            (TableClass::Ac, 15, 0) => 16,
            (TableClass::Ac, _, 1..=AC_VALUE_BITS) => u32::from(run) + 1,
            _ => return Self::NONE, // not in an 8-bit baseline image
        };
        let size = u32::from(size);
        Self(length << 24 | steps << 16 | size << 8 | (length + size))
    }

    /// Bits of code and value.
    #[inline(always)]
    pub(super) fn bits(self) -> u32 {
        self.0 & 0xFF
    }

    /// How many coefficients further the value belongs.
    #[inline(always)]
    pub(super) fn steps(self) -> usize {
        (self.0 >> 16 & 0xFF) as usize
    }

    /// The value that follows the code in `window`: bits that begin with 0 count from the least value upwards.
    #[inline(always)]
    pub(super) fn value(self, window: u64) -> i32 {
        let size = self.0 >> 8 & 0xFF;
        let raw = (window << (self.0 >> 24) >> 1 >> (63 - size)) as i32;
        // its sign is as good as random: no branch that would have to be foreseen
        let low = (raw - ((1 << size) >> 1)) >> 31;
        raw + (low & (1 - (1 << size)))
    }
}

/// One symbol with its value, packed into a number: the value, steps to the coefficient, bits of both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct DecodedSymbol(u32);

impl DecodedSymbol {
    pub(super) const NONE: Self = Self(0);

    fn of(entry: Entry, window: u64) -> Self {
        if entry == Entry::NONE || entry.bits() > LOOK {
            return Self::NONE;
        }
        let value = entry.value(window) as i16 as u16;
        Self(u32::from(value) << 16 | (entry.steps() as u32) << 8 | entry.bits())
    }

    /// Bits of code and value.
    #[inline(always)]
    pub(super) fn bits(self) -> u32 {
        self.0 & 0xFF
    }

    /// How many coefficients further the value belongs.
    #[inline(always)]
    pub(super) fn steps(self) -> usize {
        (self.0 >> 8 & 0xFF) as usize
    }

    /// The value.
    #[inline(always)]
    pub(super) fn value(self) -> i32 {
        self.0 as i32 >> 16
    }
}

/// A code, ready to be looked up.
pub(super) struct Table {
    kind: TableClass,
    code: Code,
    lookup: [Entry; 1 << LOOK],
    /// The same where the value lies within the bits too.
    whole: [DecodedSymbol; 1 << LOOK],
    /// For the longest length that is looked up, and each that is not: the first 16 bits behind its codes.
    limits: [u32; LONG + 1],
    /// For each of these: what leads from a code to the place of its symbol.
    firsts: [u32; LONG],
}

impl Table {
    pub(super) fn new(kind: TableClass, code: &Code) -> Box<Self> {
        let mut table = Box::new(Self {
            kind,
            code: *code,
            lookup: [Entry::NONE; 1 << LOOK],
            whole: [DecodedSymbol::NONE; 1 << LOOK],
            limits: [0; LONG + 1],
            firsts: [0; LONG],
        });
        table.fill();
        table
    }

    /// Makes this the table of `code`, which takes time only if it is another one than before: whether it is.
    pub(super) fn set(&mut self, code: &Code) -> bool {
        let is_new = self.code != *code;
        if is_new {
            self.code = *code;
            self.fill();
        }
        is_new
    }

    fn fill(&mut self) {
        let (mut next, mut place) = (0u32, 0u32);
        for (length, &count) in (1..).zip(&self.code.counts) {
            next *= 2;
            if let Some(limit) = self.limits.get_mut((length as usize).wrapping_sub(LOOK as usize)) {
                *limit = (next + u32::from(count)) << (LONGEST as u32 - length);
            }
            if let Some(first) = self.firsts.get_mut((length as usize).wrapping_sub(LOOK as usize + 1)) {
                *first = place.wrapping_sub(next);
            }
            next += u32::from(count);
            place += u32::from(count);
        }
        self.lookup.fill(Entry::NONE);
        let (kind, lookup) = (self.kind, &mut self.lookup);
        self.code.each(|code, length, symbol| {
            if length <= LOOK {
                let from = (code << (LOOK - length)) as usize;
                if let Some(same) = lookup.get_mut(from..from + (1 << (LOOK - length))) {
                    same.fill(Entry::new(kind, symbol, length));
                }
            }
        });
        for ((next, entry), whole) in (0u64..).zip(lookup.iter()).zip(&mut self.whole) {
            *whole = DecodedSymbol::of(*entry, next << (64 - LOOK));
        }
    }

    /// The symbol that comes next with its value, where both lie within the bits that are looked at; else [`DecodedSymbol::NONE`].
    #[inline(always)]
    pub(super) fn whole(&self, bits: &Bits<'_>) -> DecodedSymbol {
        self.whole[(bits.window() >> (64 - LOOK)) as usize]
    }

    /// The symbol that comes next; `None` when there is none with these bits.
    #[inline(always)]
    pub(super) fn next(&self, bits: &Bits<'_>) -> Option<Entry> {
        let entry = self.lookup[(bits.window() >> (64 - LOOK)) as usize];
        if entry != Entry::NONE { Some(entry) } else { self.long(bits.window()) }
    }

    /// A code of more bits than are looked at. Codes of one length are consecutive numbers, and all of them, filled up with
    /// zeros, are smaller than those of the next length: the limits that are not above the next 16 bits give the length.
    #[inline(never)]
    fn long(&self, window: u64) -> Option<Entry> {
        let next = (window >> 48) as u32;
        let longer: u32 = self.limits.iter().map(|limit| u32::from(next >= *limit)).sum();
        let length = LOOK + longer;
        let first = self.firsts.get((longer as usize).wrapping_sub(1))?;
        let at = (next >> (LONGEST as u32 - length)).wrapping_add(*first);
        let entry = Entry::new(self.kind, *self.code.symbols.get(at as usize)?, length);
        (entry != Entry::NONE).then_some(entry)
    }
}

/// A code of coefficients that are skipped: finds several symbols at once, which is worth 4 to 7 % of a colour image's time.
pub(super) struct SkipTable {
    single: Box<Table>,
    lookup: [Skip; 1 << LOOK],
}

/// Some symbols in a row: all their bits, the steps in the block, and whether the block ends with them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Skip {
    pub(super) bits: u8,
    pub(super) steps: u8,
    pub(super) end: bool,
}

impl SkipTable {
    pub(super) fn new(code: &Code) -> Box<Self> {
        let none = Skip { bits: 0, steps: 0, end: false };
        let mut table =
            Box::new(Self { single: Table::new(TableClass::Ac, code), lookup: [none; 1 << LOOK] });
        table.fill();
        table
    }

    /// See [`Table::set`].
    pub(super) fn set(&mut self, code: &Code) {
        if self.single.set(code) {
            self.fill();
        }
    }

    fn fill(&mut self) {
        for (bits, skip) in (0..).zip(&mut self.lookup) {
            *skip = Skip { bits: 0, steps: 0, end: false };
            // Only what is told by these bits alone; a value may reach beyond them.
            while u32::from(skip.bits) < LOOK {
                let at = (bits << skip.bits) & ((1 << LOOK) - 1);
                let entry = self.single.lookup.get(at as usize).copied().unwrap_or(Entry::NONE);
                let length = entry.0 >> 24;
                if entry == Entry::NONE || u32::from(skip.bits) + length > LOOK {
                    break;
                }
                skip.bits += entry.bits() as u8;
                if entry.steps() == END_OF_BLOCK {
                    skip.end = true;
                    break;
                }
                skip.steps += entry.steps() as u8;
            }
        }
    }

    /// The symbol that comes next, by itself.
    #[inline(always)]
    pub(super) fn single(&self, bits: &Bits<'_>) -> Option<Entry> {
        self.single.next(bits)
    }

    /// The symbols that come next; none of them (`bits` is 0) where the first is too long or not valid.
    #[inline(always)]
    pub(super) fn next(&self, bits: &Bits<'_>) -> Skip {
        self.lookup[(bits.window() >> (64 - LOOK)) as usize]
    }
}
