//! Luma of a JPEG, for the frames of cameras (MJPG): nothing but what a grey image needs is computed.
//!
//! ```text
//! bytes -> header: segments, tables -> coded data without stuffing -> Huffman codes -> coefficients x steps -> cosine
//!                                                                     luma alone; others are passed over    transform
//! ```
//! What cameras send is baseline (T.81): one component, or luma and two chroma in any sampling, with or without restart
//! markers, with Huffman tables or without, for which the standard's are taken then. No other kind is read. Nothing is
//! allocated once the largest image has passed.
//!
//! Images that are damaged or cut short are errors: a decoder for viewers would fill in grey.
//!
//! Why this is our own: `zune-jpeg`, asked for luma in its strict mode, was measured beside it (November 2026, in the same minutes on two
//! busy cores). Images are those of the tests here: grey and the five samplings of chroma. Where one release is wrong, the other one agrees
//! with what is here.
//!
//! ```text
//!                                                           here             zune-jpeg 0.5.15      0.5.16-rc3
//! without restarts, 2400 of up to 149 x 89 px               all right        213 wrong (up to 255  all right
//!                                                                            levels), 111 refused,
//!                                                                            99 panics
//! the same, 72 of VGA and 1280 x 720 px                     all right        5, 2, 4               all right
//! restart markers, 2472 of all these sizes                  all right        26 wrong              63 wrong
//! a scan for each component, 5                              all right        2 wrong               all right
//! no Huffman tables, as many USB cameras send, 100          all right        all refused           all refused
//! cut short, 3000                                           all refused      14 taken as whole     all refused
//! 512 bytes lost in the middle, 9670                        all refused      9572 taken            7191 taken
//! allocations for one image                                 0                15                    27
//! VGA of 37, 44, 58 kB, median, us                          503, 540, 581    612, 688, 813         608, 668, 783
//! ```

mod bits;
mod header;
mod huffman;
mod idct;
mod scan;
mod standard;

use header::Header;
use scan::Scanner;
use thiserror::Error;

/// Why a JPEG gives no image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum JpegError {
    /// The first bytes are not those of a JPEG.
    #[error("it does not begin as a JPEG does")]
    NotJpeg,
    /// The bytes end before the image does.
    #[error("it ends early, in the middle of the image")]
    Truncated,
    /// Something in it cannot be.
    #[error("it is damaged: {0}")]
    Damaged(&'static str),
    /// An image of another size.
    #[error(
        "it is {found_width_px}x{found_height_px} px, not the {width_px}x{height_px} px that were agreed on"
    )]
    Size {
        /// Columns of the image.
        found_width_px: u32,
        /// Rows of the image.
        found_height_px: u32,
        /// Columns wanted.
        width_px: u32,
        /// Rows wanted.
        height_px: u32,
    },
    /// A kind of JPEG that no decoder here reads.
    #[error("it is {0}; only baseline JPEGs of luma and chroma, or of luma alone, are read")]
    Unsupported(&'static str),
}

/// Decoder of JPEGs of one size, with the tables and the buffer that it keeps between them.
pub struct LumaDecoder {
    width: u32,
    height: u32,
    header: Box<Header>,
    scanner: Scanner,
}

impl std::fmt::Debug for LumaDecoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LumaDecoder").field("width", &self.width).field("height", &self.height).finish()
    }
}

impl LumaDecoder {
    /// For images of this size, px.
    #[must_use]
    pub fn new(width_px: u32, height_px: u32) -> Self {
        // A byte a pixel is more than cameras send.
        let coded_bytes = (width_px as usize).saturating_mul(height_px as usize).min(1 << 26);
        Self {
            width: width_px,
            height: height_px,
            header: Box::new(Header::new()),
            scanner: Scanner::new(coded_bytes),
        }
    }

    /// Decodes the luma of `jpeg` into `out`, `width * height` bytes row by row. Bytes behind the end of the image are left alone.
    ///
    /// # Errors
    /// [`JpegError`]; `out` holds nothing of use then.
    pub fn decode(&mut self, jpeg: &[u8], out: &mut [u8]) -> Result<(), JpegError> {
        // SOI and the first byte of the next marker, by the standard ITU-T T.81.
        const START: [u8; 3] = [0xFF, 0xD8, 0xFF];
        if !jpeg.starts_with(&START) {
            return Err(JpegError::NotJpeg);
        }
        *self.header = Header::new();
        let mut at = 2;
        // Luma may have a scan of its own, behind or before those of other components.
        let (scan, behind) = loop {
            let Some(scan) = self.header.read(jpeg, at)? else {
                return Err(JpegError::Damaged("it ends without an image"));
            };
            self.check_size(self.header.width, self.header.height)?;
            if scan.parts.iter().take(scan.count).any(|part| part.component == 0) {
                break (scan, self.scanner.decode(&self.header, &scan, jpeg, out)?);
            }
            at = next_segment(jpeg, scan.data).ok_or(JpegError::Truncated)?;
        };
        match behind {
            // All of the image's data was there to the last bit; some devices leave the end marker out.
            None if scan.count == self.header.count => Ok(()),
            None => Err(JpegError::Truncated),
            Some(at) => self.read_to_end(jpeg, at),
        }
    }

    /// Reads on behind the luma to the end of the image.
    fn read_to_end(&mut self, jpeg: &[u8], mut at: usize) -> Result<(), JpegError> {
        while let Some(scan) = self.header.read(jpeg, at)? {
            at = next_segment(jpeg, scan.data).ok_or(JpegError::Truncated)?;
        }
        Ok(())
    }

    fn check_size(&self, found_width_px: u32, found_height_px: u32) -> Result<(), JpegError> {
        let (width_px, height_px) = (self.width, self.height);
        if (found_width_px, found_height_px) == (width_px, height_px) {
            return Ok(());
        }
        Err(JpegError::Size { found_width_px, found_height_px, width_px, height_px })
    }
}

/// Where the segment behind coded data that begins at `at` begins.
fn next_segment(bytes: &[u8], mut at: usize) -> Option<usize> {
    loop {
        at += bytes.get(at..)?.iter().position(|b| *b == 0xFF)?;
        match bytes.get(at + 1)? {
            0x00 | 0xD0..=0xD7 => at += 2,
            0xFF => at += 1,
            _ => return Some(at),
        }
    }
}

#[cfg(test)]
mod tests;
