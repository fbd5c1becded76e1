//! Coded data of a scan -> grey levels: the luma blocks are decoded and transformed, those of the other components passed over.

use super::bits::{Bits, Coded, LengthMismatch, SegmentEnd};
use super::header::{COMPONENTS, Header, Scan};
use super::huffman::{DecodedSymbol, END_OF_BLOCK, SkipTable, Table, TableClass};
use super::idct::{self, Block, PLACES, Tile};
use super::{JpegError, standard};

const BAD_CODE: JpegError = JpegError::Damaged("a code in its data does not exist");

/// Tables and buffers that a scan needs; they are kept from image to image.
pub(super) struct Scanner {
    coded: Coded,
    luma_dc: Box<Table>,
    luma_ac: Box<Table>,
    others: [Other; COMPONENTS - 1],
}

/// The codes of a component that is passed over.
struct Other {
    dc: Box<Table>,
    ac: Box<SkipTable>,
}

impl Other {
    fn new() -> Self {
        Self { dc: Table::new(TableClass::Dc, &standard::DC[1]), ac: SkipTable::new(&standard::AC[1]) }
    }
}

/// What comes in a unit of a scan, one after the other.
#[derive(Debug, Clone, Copy)]
enum McuPart {
    /// Blocks of luma: in a row, and rows.
    Luma { across: usize, down: usize },
    /// Blocks of another component, with the codes of this place.
    Other { blocks: usize, codes: usize },
}

/// The units of a scan, and what is in each.
struct McuLayout {
    parts: [McuPart; COMPONENTS],
    count: usize,
    units_across: usize,
    units_down: usize,
    restart_every: usize,
}

/// Of a coefficient, in the order of the file: by how much it is multiplied, and where it lies in a [`Block`].
#[derive(Clone, Copy)]
struct Dequantizer {
    step: u16,
    place: u16,
}

/// Where the grey levels go.
struct GreyOutput<'a> {
    out: &'a mut [u8],
    width: usize,
    height: usize,
}

impl Scanner {
    /// With room for images of that many coded bytes.
    pub(super) fn new(coded_bytes: usize) -> Self {
        Self {
            coded: Coded::with_capacity(coded_bytes),
            luma_dc: Table::new(TableClass::Dc, &standard::DC[0]),
            luma_ac: Table::new(TableClass::Ac, &standard::AC[0]),
            others: [Other::new(), Other::new()],
        }
    }

    /// Decodes the luma of `scan` into `out`, `header.width * header.height` bytes. Returns where the next segment begins;
    /// `None` where the bytes end with the scan.
    pub(super) fn decode(
        &mut self,
        header: &Header,
        scan: &Scan,
        bytes: &[u8],
        out: &mut [u8],
    ) -> Result<Option<usize>, JpegError> {
        let layout = self.prepare(header, scan)?;
        let luma = header.components[0].quantization;
        let steps = header.steps.get(luma).copied().flatten();
        let steps = steps.ok_or(JpegError::Damaged("the luma's quantization table is missing"))?;
        let steps = std::array::from_fn(|k| Dequantizer { step: steps[k], place: PLACES[k].into() });
        let mut image = GreyOutput { out, width: header.width as usize, height: header.height as usize };
        #[cfg(target_arch = "x86_64")]
        if crate::imaging::simd::has_avx2() {
            // SAFETY: the processor has AVX2, BMI1 and BMI2.
            #[allow(unsafe_code)]
            return unsafe { self.run_wide(&layout, &steps, bytes, scan.data, &mut image) };
        }
        self.run(&layout, &steps, bytes, scan.data, &mut image, idct::portable)
    }

    /// Sets the tables for a scan, and says what is in its units.
    fn prepare(&mut self, header: &Header, scan: &Scan) -> Result<McuLayout, JpegError> {
        let parts = scan.parts.get(..scan.count).unwrap_or(&[]);
        let components = header.components.get(..header.count).unwrap_or(&[]);
        let largest =
            |of: fn(&super::header::FrameComponent) -> usize| components.iter().map(of).max().unwrap_or(1);
        let (across, down) = (largest(|c| c.across), largest(|c| c.down));
        let luma = header.components[0];
        if (luma.across, luma.down) != (across, down) {
            return Err(JpegError::Unsupported("of luma with less than its full resolution"));
        }
        // A component alone comes block by block, without regard to its sampling.
        let alone = parts.len() == 1;
        let (across, down) = if alone { (1, 1) } else { (across, down) };
        let mut layout = McuLayout {
            parts: [McuPart::Other { blocks: 0, codes: 0 }; COMPONENTS],
            count: parts.len(),
            units_across: (header.width as usize).div_ceil(8 * across),
            units_down: (header.height as usize).div_ceil(8 * down),
            restart_every: header.restart_every,
        };
        let mut codes = 0;
        for (out, part) in layout.parts.iter_mut().zip(parts) {
            let no_table = JpegError::Damaged("a Huffman table is missing");
            let dc = header.dc.get(part.dc).ok_or(no_table)?;
            let ac = header.ac.get(part.ac).ok_or(no_table)?;
            if part.component == 0 {
                self.luma_dc.set(dc);
                self.luma_ac.set(ac);
                *out = McuPart::Luma { across, down };
            } else if let (Some(other), Some(component)) =
                (self.others.get_mut(codes), components.get(part.component))
            {
                other.dc.set(dc);
                other.ac.set(ac);
                *out = McuPart::Other { blocks: component.across * component.down, codes };
                codes += 1;
            }
        }
        let lumas = layout.parts.iter().filter(|part| matches!(part, McuPart::Luma { .. })).count();
        if lumas != 1 {
            return Err(JpegError::Damaged("a scan has the same component twice"));
        }
        Ok(layout)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2")]
    fn run_wide(
        &mut self,
        layout: &McuLayout,
        steps: &[Dequantizer; 64],
        bytes: &[u8],
        from: usize,
        image: &mut GreyOutput<'_>,
    ) -> Result<Option<usize>, JpegError> {
        self.run(layout, steps, bytes, from, image, |block| idct::x86::avx2(block))
    }

    #[inline(always)]
    fn run(
        &mut self,
        layout: &McuLayout,
        steps: &[Dequantizer; 64],
        bytes: &[u8],
        from: usize,
        image: &mut GreyOutput<'_>,
        transform: impl Fn(&Block) -> Tile,
    ) -> Result<Option<usize>, JpegError> {
        let units = layout.units_across * layout.units_down;
        let piece = if layout.restart_every == 0 { units } else { layout.restart_every };
        let (mut unit, mut at, mut restarts) = (0, from, 0u8);
        loop {
            let (next, end) = self.coded.take(bytes, at);
            let until = units.min(unit + piece);
            let mut bits = self.coded.bits();
            let (mut x, mut y) = (unit % layout.units_across, unit / layout.units_across);
            let mut mean = 0;
            while unit < until {
                for part in layout.parts.iter().take(layout.count) {
                    match *part {
                        McuPart::Luma { across, down } => {
                            for row in 0..down {
                                for column in 0..across {
                                    let (x, y) = (x * across + column, y * down + row);
                                    let tile = self.luma_block(&mut bits, steps, &mut mean, &transform)?;
                                    image.put(&tile, 8 * x, 8 * y);
                                }
                            }
                        }
                        McuPart::Other { blocks, codes } => {
                            let other = &self.others[codes & 1];
                            for _ in 0..blocks {
                                other.pass_over(&mut bits)?;
                            }
                        }
                    }
                }
                unit += 1;
                x += 1;
                if x == layout.units_across {
                    (x, y) = (0, y + 1);
                }
            }
            match (bits.used_up(), end) {
                (Err(LengthMismatch::Missing), SegmentEnd::Bytes) => return Err(JpegError::Truncated),
                (Err(LengthMismatch::Missing), _) => return Err(JpegError::Damaged("data is missing")),
                (Err(LengthMismatch::Left), _) => {
                    return Err(JpegError::Damaged("there is more data than image"));
                }
                (Ok(()), SegmentEnd::Restart(number)) if unit < units && number == restarts & 7 => {
                    restarts = restarts.wrapping_add(1);
                    at = next;
                }
                (Ok(()), SegmentEnd::Marker(at)) if unit == units => return Ok(Some(at)),
                (Ok(()), SegmentEnd::Bytes) if unit == units => return Ok(None),
                (Ok(()), SegmentEnd::Bytes) => return Err(JpegError::Truncated),
                _ => return Err(JpegError::Damaged("a restart marker is missing or out of turn")),
            }
        }
    }

    /// The next block of luma. `mean` is the mean level, before quantization, of the one before.
    #[inline(always)]
    fn luma_block(
        &self,
        bits: &mut Bits<'_>,
        steps: &[Dequantizer; 64],
        mean: &mut i32,
        transform: &impl Fn(&Block) -> Tile,
    ) -> Result<Tile, JpegError> {
        let mut block = Block([0; 64]);
        bits.refill();
        let entry = self.luma_dc.next(bits).ok_or(BAD_CODE)?;
        *mean = mean.wrapping_add(entry.value(bits.window()));
        bits.skip(entry.bits());
        // Damaged files can have any values: what is too large for a coefficient wraps around.
        let scaled = mean.wrapping_mul(i32::from(steps[0].step)) as i16;
        block.0[usize::from(steps[0].place & 63)] = scaled;
        let mut k = 0;
        let mut plain = true;
        // Two symbols, each of at most 26 bits, between refills.
        let mut is_full = false;
        while k < 63 {
            if !is_full {
                bits.refill();
            }
            is_full = !is_full;
            let whole = self.luma_ac.whole(bits);
            let value = if whole != DecodedSymbol::NONE {
                bits.skip(whole.bits());
                k += whole.steps();
                whole.value()
            } else {
                let entry = self.luma_ac.next(bits).ok_or(BAD_CODE)?;
                let value = entry.value(bits.window());
                bits.skip(entry.bits());
                k += entry.steps();
                value
            };
            if k > 63 {
                end_of_block(k)?;
                break;
            }
            let Dequantizer { step, place } = steps[k & 63];
            block.0[usize::from(place & 63)] = value.wrapping_mul(i32::from(step)) as i16;
            plain = false;
        }
        Ok(if plain { [idct::flat(scaled); 64] } else { transform(&block) })
    }
}

/// A block ended at `k`: by its code, or because a run of zeros was longer than it?
#[inline(always)]
fn end_of_block(k: usize) -> Result<(), JpegError> {
    if k >= END_OF_BLOCK { Ok(()) } else { Err(JpegError::Damaged("a block has too many coefficients")) }
}

impl Other {
    /// Passes over the next block.
    #[inline(always)]
    fn pass_over(&self, bits: &mut Bits<'_>) -> Result<(), JpegError> {
        bits.refill();
        bits.skip(self.dc.next(bits).ok_or(BAD_CODE)?.bits());
        let mut k = 0;
        while k < 63 {
            bits.refill();
            let some = self.ac.next(bits);
            let steps = usize::from(some.steps);
            // What reaches to the last coefficient may belong to the next block: then symbol by symbol.
            if some.bits > 0 && k + steps < 63 {
                bits.skip(u32::from(some.bits));
                k += steps;
                if some.end {
                    break;
                }
            } else {
                let entry = self.ac.single(bits).ok_or(BAD_CODE)?;
                bits.skip(entry.bits());
                k += entry.steps();
                if k > 63 {
                    end_of_block(k)?;
                }
            }
        }
        Ok(())
    }
}

impl GreyOutput<'_> {
    /// Puts a block at column `x`, row `y`; what lies outside of the image is left out.
    #[inline(always)]
    fn put(&mut self, tile: &Tile, x: usize, y: usize) {
        let (width, height) = (self.width, self.height);
        let rows = tile.as_chunks::<8>().0.iter().zip(y..height);
        for (levels, y) in rows {
            let row = self.out.get_mut(y * width + x..(y + 1) * width).unwrap_or(&mut []);
            if let Some(row) = row.first_chunk_mut::<8>() {
                *row = *levels;
            } else {
                row.iter_mut().zip(levels).for_each(|(out, level)| *out = *level);
            }
        }
    }
}
