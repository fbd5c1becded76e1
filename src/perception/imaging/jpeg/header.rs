//! The segments of a JPEG before its coded data.

use super::huffman::Code;
use super::{JpegError, standard};

/// Most components of an image that is read here: a luma and two chroma, as JFIF has them (ITU-T T.871).
pub(super) const COMPONENTS: usize = 3;

fn damaged(what: &'static str) -> JpegError {
    JpegError::Damaged(what)
}

/// One component of the image.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FrameComponent {
    pub(super) id: u8,
    /// Blocks of a unit in a row, and rows of them.
    pub(super) across: usize,
    pub(super) down: usize,
    /// Which quantization table.
    pub(super) quantization: usize,
}

/// One component of a scan: which of the image's, and its codes.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ScanComponent {
    pub(super) component: usize,
    pub(super) dc: usize,
    pub(super) ac: usize,
}

/// What a scan holds, and where its coded data begins.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scan {
    pub(super) parts: [ScanComponent; COMPONENTS],
    pub(super) count: usize,
    pub(super) data: usize,
}

/// What the segments up to a scan have said.
pub(super) struct Header {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) components: [FrameComponent; COMPONENTS],
    /// 0 before the frame's segment.
    pub(super) count: usize,
    /// Steps of the coefficients, in the order of the file.
    pub(super) steps: [Option<[u16; 64]>; 4],
    pub(super) dc: [Code; 4],
    pub(super) ac: [Code; 4],
    /// Units between two restart markers; 0 for none.
    pub(super) restart_every: usize,
    rgb: bool,
}

impl Header {
    /// Nothing but the standard Huffman tables.
    pub(super) fn new() -> Self {
        let [dc0, dc1] = standard::DC;
        let [ac0, ac1] = standard::AC;
        Self {
            width: 0,
            height: 0,
            components: [FrameComponent::default(); COMPONENTS],
            count: 0,
            steps: [None; 4],
            dc: [dc0, dc1, dc0, dc1],
            ac: [ac0, ac1, ac0, ac1],
            restart_every: 0,
            rgb: false,
        }
    }

    /// Reads segments from `at` to the next scan, or to the end of the image (`None`).
    pub(super) fn read(&mut self, bytes: &[u8], mut at: usize) -> Result<Option<Scan>, JpegError> {
        loop {
            match bytes.get(at) {
                None => return Err(JpegError::Truncated),
                Some(0xFF) => {}
                Some(_) => return Err(damaged("there is something between its segments")),
            }
            at += 1;
            let marker = *bytes.get(at).ok_or(JpegError::Truncated)?;
            match marker {
                0xFF => continue, // filling
                0xD9 => return Ok(None),
                0xD8 => return Err(damaged("it begins a second time")),
                0x00..=0x01 | 0xD0..=0xD7 => return Err(damaged("coded data where a segment should begin")),
                _ => {}
            }
            let length = bytes.get(at + 1..).and_then(|b| b.first_chunk()).ok_or(JpegError::Truncated)?;
            let length = usize::from(u16::from_be_bytes(*length));
            if length < 2 {
                return Err(damaged("a segment has no length"));
            }
            let body = bytes.get(at + 3..at + 1 + length).ok_or(JpegError::Truncated)?;
            at += 1 + length;
            match marker {
                0xC4 => self.read_codes(body)?,
                0xDB => self.read_steps(body)?,
                0xC0 | 0xC1 => self.read_frame(body)?,
                0xC2..=0xCF => return Err(JpegError::Unsupported("progressive, lossless or arithmetic")),
                0xDC => return Err(JpegError::Unsupported("without a height at its start")),
                0xDD => {
                    let every = body.first_chunk().ok_or(damaged("a restart interval is cut short"))?;
                    self.restart_every = usize::from(u16::from_be_bytes(*every));
                }
                // Adobe's, the last byte of which is the colour transform: 0 is RGB
                0xEE if body.starts_with(b"Adobe") => self.rgb = body.get(11) == Some(&0),
                0xDA => return self.read_scan(body, at).map(Some),
                _ => {}
            }
        }
    }

    fn read_codes(&mut self, mut body: &[u8]) -> Result<(), JpegError> {
        while let Some((&place, rest)) = body.split_first() {
            let (code, rest) = Code::read(rest)?;
            let codes = match place >> 4 {
                0 => &mut self.dc,
                1 => &mut self.ac,
                _ => return Err(damaged("a Huffman table is of no known class")),
            };
            let place = codes.get_mut(usize::from(place & 15));
            *place.ok_or(damaged("there is a fifth Huffman table"))? = code;
            body = rest;
        }
        Ok(())
    }

    fn read_steps(&mut self, mut body: &[u8]) -> Result<(), JpegError> {
        const SHORT: JpegError = JpegError::Damaged("a quantization table is cut short");
        while let Some((&place, rest)) = body.split_first() {
            let mut steps = [0; 64];
            body = match place >> 4 {
                0 => {
                    let (all, rest) = rest.split_first_chunk::<64>().ok_or(SHORT)?;
                    steps.iter_mut().zip(all).for_each(|(step, b)| *step = u16::from(*b));
                    rest
                }
                1 => {
                    let (all, rest) = rest.split_first_chunk::<128>().ok_or(SHORT)?;
                    let all = all.as_chunks::<2>().0;
                    steps.iter_mut().zip(all).for_each(|(step, b)| *step = u16::from_be_bytes(*b));
                    rest
                }
                _ => return Err(damaged("a quantization table is of no known precision")),
            };
            let place = self.steps.get_mut(usize::from(place & 15));
            *place.ok_or(damaged("there is a fifth quantization table"))? = Some(steps);
        }
        Ok(())
    }

    fn read_frame(&mut self, body: &[u8]) -> Result<(), JpegError> {
        if self.count > 0 {
            return Err(damaged("there are two frames"));
        }
        let Some((&[bits, h1, h0, w1, w0, count], parts)) = body.split_first_chunk::<6>() else {
            return Err(damaged("the frame's segment is cut short"));
        };
        (self.height, self.width) =
            (u32::from(u16::from_be_bytes([h1, h0])), u32::from(u16::from_be_bytes([w1, w0])));
        let (parts, rest) = parts.as_chunks::<3>();
        if parts.len() != usize::from(count) || !rest.is_empty() {
            return Err(damaged("the frame's segment has not the length that it says"));
        }
        if bits != 8 {
            return Err(JpegError::Unsupported("of more than 8 bits"));
        }
        if !matches!(parts.len(), 1 | COMPONENTS) {
            return Err(JpegError::Unsupported("of two or four components"));
        }
        for (component, &[id, sampling, quantization]) in self.components.iter_mut().zip(parts) {
            let (across, down) = (usize::from(sampling >> 4), usize::from(sampling & 15));
            if !(1..=4).contains(&across) || !(1..=4).contains(&down) || quantization > 3 {
                return Err(damaged(
                    "a component has a sampling or a quantization table that there cannot be",
                ));
            }
            *component = FrameComponent { id, across, down, quantization: usize::from(quantization) };
        }
        self.count = parts.len();
        Ok(())
    }

    fn read_scan(&self, body: &[u8], data: usize) -> Result<Scan, JpegError> {
        const WRONG: JpegError = JpegError::Damaged("a scan's segment makes no sense");
        if self.count == 0 {
            return Err(damaged("a scan comes before the frame's segment"));
        }
        if self.rgb && self.count == COMPONENTS {
            return Err(JpegError::Unsupported("of red, green and blue"));
        }
        let (&count, body) = body.split_first().ok_or(WRONG)?;
        let count = usize::from(count);
        let (parts, spectrum) = body.split_at_checked(2 * count).ok_or(WRONG)?;
        if !(1..=self.count).contains(&count) || spectrum != [0, 63, 0] {
            return Err(WRONG);
        }
        let mut scan = Scan { parts: [ScanComponent::default(); COMPONENTS], count, data };
        for (part, &[id, codes]) in scan.parts.iter_mut().zip(parts.as_chunks::<2>().0) {
            let component = self.components.iter().take(self.count).position(|c| c.id == id).ok_or(WRONG)?;
            *part = ScanComponent { component, dc: usize::from(codes >> 4), ac: usize::from(codes & 15) };
            if part.dc > 3 || part.ac > 3 {
                return Err(WRONG);
            }
        }
        Ok(scan)
    }
}
