//! A borrowed grey image: rows of bytes in memory that somebody else owns (usually a shared-memory sample).

use thiserror::Error;

/// The buffer does not hold `width x height` bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("a {width}x{height} image needs {needed} bytes, the buffer holds {len}")]
pub struct ImageSizeError {
    /// Columns asked for, px.
    pub width: usize,
    /// Rows asked for, px.
    pub height: usize,
    /// Bytes that such an image takes.
    pub needed: usize,
    /// Bytes in the buffer.
    pub len: usize,
}

/// An 8-bit grey image without padding between rows. Pixel centres lie on integer coordinates.
#[derive(Debug, Clone, Copy)]
pub struct ImageView<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
}

impl<'a> ImageView<'a> {
    /// Borrows `pixels` as `width x height` image.
    ///
    /// # Errors
    /// [`ImageSizeError`] when the buffer's length is not `width * height`, or when either is zero.
    pub fn new(pixels: &'a [u8], width: usize, height: usize) -> Result<Self, ImageSizeError> {
        let needed = width.saturating_mul(height);
        if needed == 0 || pixels.len() != needed {
            return Err(ImageSizeError { width, height, needed, len: pixels.len() });
        }
        Ok(Self { pixels, width, height })
    }

    /// Columns, px.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows, px.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    #[must_use]
    pub fn pixels(&self) -> &'a [u8] {
        self.pixels
    }

    /// Row `y`; empty when `y` is outside the image.
    #[must_use]
    pub fn row(&self, y: usize) -> &'a [u8] {
        self.pixels.get(y * self.width..(y + 1) * self.width).unwrap_or(&[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_is_checked() {
        assert!(ImageView::new(&[0; 12], 4, 3).is_ok());
        assert_eq!(ImageView::new(&[0; 11], 4, 3).unwrap_err().needed, 12);
        assert!(ImageView::new(&[], 0, 0).is_err());
        assert_eq!(ImageView::new(&[1, 2, 3, 4], 2, 2).unwrap().row(1), &[3, 4]);
        assert!(ImageView::new(&[1, 2, 3, 4], 2, 2).unwrap().row(2).is_empty());
    }
}
