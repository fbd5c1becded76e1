//! Stand-in until the conversions come.

/// A pixel format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// 8 bits.
    Grey,
    /// 10 bits.
    Y10,
    /// 12 bits.
    Y12,
    /// 16 bits.
    Y16,
    /// YUYV.
    Yuyv,
    /// UYVY.
    Uyvy,
    /// NV12.
    Nv12,
    /// JPEG.
    Mjpg,
}

/// It is not grey.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("not grey")]
pub struct NotGrey;

/// Converter.
#[derive(Debug)]
pub struct ToGrey {
    format: PixelFormat,
    width: usize,
}

impl ToGrey {
    /// For pictures of one shape.
    #[must_use]
    pub fn new(format: PixelFormat, width_px: u32, _height_px: u32) -> Self {
        Self { format, width: width_px as usize }
    }

    /// Converts.
    ///
    /// # Errors
    /// Never.
    pub fn convert(&mut self, raw: &[u8], stride_bytes: usize, out: &mut [u8]) -> Result<(), NotGrey> {
        for (row, out) in raw.chunks(stride_bytes.max(1)).zip(out.chunks_exact_mut(self.width)) {
            match self.format {
                PixelFormat::Yuyv => out.iter_mut().zip(row.iter().step_by(2)).for_each(|(o, i)| *o = *i),
                _ => out.iter_mut().zip(row).for_each(|(o, i)| *o = *i),
            }
        }
        Ok(())
    }
}
