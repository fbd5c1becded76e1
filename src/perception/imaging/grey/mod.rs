//! Pixels as a camera delivers them -> 8-bit grey, row by row without padding.
//!
//! | format | bytes of a line | grey level |
//! |---|---|---|
//! | `GREY` | w | the byte |
//! | `Y10`, `Y12` | 2 w, little-endian, the value in the lower 10 or 12 bits | the upper 8 of them; larger values are white |
//! | `Y16` | 2 w, little-endian | the upper byte |
//! | `YUYV`, `UYVY` | 2 w, w even | each first, each second byte |
//! | `NV12` | w, then the chroma plane | the byte of the first plane |
//! | `BGR3`, `RGB3` | 3 w | 0.299 red + 0.587 green + 0.114 blue (ITU-R BT.601), in 256ths |
//! | `MJPG` | a JPEG a frame | its luma ([`jpeg`](super::jpeg)) |
//!
//! Levels are left as they are: where a device has video levels (black 16, white 235), as most with YUYV and NV12 have, the
//! image has them too. Thresholds are taken from the image itself, so that this costs contrast and nothing else.

mod luma;

use super::jpeg::{JpegError, LumaDecoder};
use luma::LumaKernel;
use thiserror::Error;

/// How a camera lays out its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// A byte a pixel.
    Grey,
    /// 10 bits in 16.
    Y10,
    /// 12 bits in 16.
    Y12,
    /// 16 bits.
    Y16,
    /// Luma, and by turns the two chroma.
    Yuyv,
    /// By turns the two chroma, and luma.
    Uyvy,
    /// A plane of luma, then one of chroma pairs for every 2 x 2 pixels.
    Nv12,
    /// Blue, green, red: a byte each.
    Bgr3,
    /// Red, green, blue: a byte each.
    Rgb3,
    /// A JPEG a frame.
    Mjpg,
}

impl PixelFormat {
    /// All of them, from the cheapest way to grey to the dearest.
    pub const ALL: [Self; 10] = [
        Self::Grey,
        Self::Nv12,
        Self::Yuyv,
        Self::Uyvy,
        Self::Y16,
        Self::Y12,
        Self::Y10,
        Self::Bgr3,
        Self::Rgb3,
        Self::Mjpg,
    ];

    /// The four letters by which Video4Linux knows it.
    #[must_use]
    pub fn fourcc(self) -> [u8; 4] {
        *match self {
            Self::Grey => b"GREY",
            Self::Y10 => b"Y10 ",
            Self::Y12 => b"Y12 ",
            Self::Y16 => b"Y16 ",
            Self::Yuyv => b"YUYV",
            Self::Uyvy => b"UYVY",
            Self::Nv12 => b"NV12",
            Self::Bgr3 => b"BGR3",
            Self::Rgb3 => b"RGB3",
            Self::Mjpg => b"MJPG",
        }
    }

    /// The format of these four letters; `JPEG` is `MJPG` too.
    #[must_use]
    pub fn from_fourcc(fourcc: [u8; 4]) -> Option<Self> {
        let fourcc = if &fourcc == b"JPEG" { *b"MJPG" } else { fourcc };
        Self::ALL.into_iter().find(|format| format.fourcc() == fourcc)
    }

    /// Least bytes of a line of luma; 0 for `MJPG`, which has no lines.
    #[must_use]
    pub fn min_stride_bytes(self, width_px: u32) -> usize {
        let width = width_px as usize;
        match self {
            Self::Grey | Self::Nv12 => width,
            Self::Y10 | Self::Y12 | Self::Y16 => width.saturating_mul(2),
            // two pixels share their chroma
            Self::Yuyv | Self::Uyvy => width.div_ceil(2).saturating_mul(4),
            Self::Bgr3 | Self::Rgb3 => width.saturating_mul(3),
            Self::Mjpg => 0,
        }
    }

    /// Least bytes of a whole frame with lines of `stride_bytes`, the last of which may lack its padding: with its chroma
    /// plane for `NV12`; for `MJPG` those of the smallest JPEG there is.
    #[must_use]
    pub fn min_payload_bytes(self, width_px: u32, height_px: u32, stride_bytes: usize) -> usize {
        let rows = height_px as usize;
        match self {
            Self::Mjpg => SMALLEST_JPEG_BYTES,
            Self::Nv12 => self.lines(width_px, rows.saturating_add(rows.div_ceil(2)), stride_bytes),
            _ => self.lines(width_px, rows, stride_bytes),
        }
    }

    fn lines(self, width_px: u32, rows: usize, stride_bytes: usize) -> usize {
        let Some(padded) = rows.checked_sub(1) else { return 0 };
        padded.saturating_mul(stride_bytes).saturating_add(self.min_stride_bytes(width_px))
    }
}

/// The weights of ITU-R BT.601, 2.5.1, in 256ths, which sum up to 256: what JPEG and YUV cameras have as luma, and OpenCV as grey.
const BLUE_GREEN_RED: [u16; 3] = [29, 150, 77];
const RED_GREEN_BLUE: [u16; 3] = [77, 150, 29];

/// Start, a quantization table, frame, scan, a byte and the end: the segments' lengths of ITU-T T.81.
const SMALLEST_JPEG_BYTES: usize = 2 + 69 + 13 + 10 + 1 + 2;

/// Why a payload became no grey image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum NotGrey {
    /// The place for the image has not one byte a pixel.
    #[error("the image has {len} bytes of memory, {width_px}x{height_px} px need {needed}")]
    OutLength {
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
        /// Bytes that the image takes.
        needed: usize,
        /// Bytes that it got.
        len: usize,
    },
    /// Lines are shorter than the image is wide.
    #[error("lines are {stride_bytes} bytes apart, {needed} bytes of each are needed")]
    Stride {
        /// From one line to the next, bytes.
        stride_bytes: usize,
        /// Bytes of a line.
        needed: usize,
    },
    /// The payload ends before the image does.
    #[error("the frame has {len} bytes, an image of its format and size has {needed}")]
    Short {
        /// Bytes of the payload.
        len: usize,
        /// Bytes that an image takes.
        needed: usize,
    },
    /// The frame is a JPEG that cannot be used.
    #[error("the frame's JPEG cannot be used: {0}")]
    Jpeg(#[from] JpegError),
}

/// Makes frames of one format and size grey.
#[derive(Debug)]
pub struct ToGrey {
    format: PixelFormat,
    width: u32,
    height: u32,
    way: GreyDecoder,
}

#[derive(Debug)]
enum GreyDecoder {
    Lines(LumaKernel),
    Jpeg(Box<LumaDecoder>),
}

impl ToGrey {
    /// For frames of this format and size, px. Allocates what a decoder keeps from frame to frame.
    #[must_use]
    pub fn new(format: PixelFormat, width_px: u32, height_px: u32) -> Self {
        let way = match format {
            PixelFormat::Grey | PixelFormat::Nv12 => GreyDecoder::Lines(LumaKernel::copy()),
            PixelFormat::Y10 => GreyDecoder::Lines(LumaKernel::shifted(2)),
            PixelFormat::Y12 => GreyDecoder::Lines(LumaKernel::shifted(4)),
            PixelFormat::Y16 | PixelFormat::Uyvy => GreyDecoder::Lines(LumaKernel::second()),
            PixelFormat::Yuyv => GreyDecoder::Lines(LumaKernel::first()),
            PixelFormat::Bgr3 => GreyDecoder::Lines(LumaKernel::weighted(BLUE_GREEN_RED)),
            PixelFormat::Rgb3 => GreyDecoder::Lines(LumaKernel::weighted(RED_GREEN_BLUE)),
            PixelFormat::Mjpg => GreyDecoder::Jpeg(Box::new(LumaDecoder::new(width_px, height_px))),
        };
        Self { format, width: width_px, height: height_px, way }
    }

    /// Makes a frame grey. `raw` is its payload, which may be longer than the image, and of `NV12` the first plane alone;
    /// `stride_bytes` is from one line to the next (ignored for `MJPG`); `out` takes `width * height` bytes, row by row.
    ///
    /// Allocates nothing, but for a JPEG that has more bytes than any before and than the image has pixels, or that is not a
    /// baseline one.
    ///
    /// # Errors
    /// [`NotGrey`]; `out` holds nothing of use then.
    pub fn convert(&mut self, raw: &[u8], stride_bytes: usize, out: &mut [u8]) -> Result<(), NotGrey> {
        let (width_px, height_px) = (self.width, self.height);
        let needed = (width_px as usize).saturating_mul(height_px as usize);
        if out.len() != needed {
            return Err(NotGrey::OutLength { width_px, height_px, needed, len: out.len() });
        }
        if out.is_empty() {
            return Ok(());
        }
        let kernel = match &mut self.way {
            GreyDecoder::Jpeg(decoder) => return Ok(decoder.decode(raw, out)?),
            GreyDecoder::Lines(kernel) => kernel,
        };
        // Of a part of a wider frame that ends with a pixel of a pair, the other one is not needed.
        let line = match self.format {
            PixelFormat::Yuyv | PixelFormat::Uyvy => (width_px as usize).saturating_mul(2),
            _ => self.format.min_stride_bytes(width_px),
        };
        if stride_bytes < line {
            return Err(NotGrey::Stride { stride_bytes, needed: line });
        }
        let needed = (height_px as usize - 1).saturating_mul(stride_bytes).saturating_add(line);
        if raw.len() < needed {
            return Err(NotGrey::Short { len: raw.len(), needed });
        }
        kernel.convert(raw, stride_bytes, width_px as usize, out);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
