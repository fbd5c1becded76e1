//! A borrowed grey image: rows of bytes in memory of another owner (usually a shared-memory sample).

use super::Window;
use thiserror::Error;

/// What grey levels end at: where an image shows it, there may have been more light.
pub const MAX_LEVEL: f64 = 255.0;

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

/// An 8-bit grey image, possibly with other bytes between its rows. Pixel centres lie on integer coordinates.
#[derive(Debug, Clone, Copy)]
pub struct ImageView<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    /// Bytes from the start of a row to that of the next, at least `width`.
    stride: usize,
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
        Ok(Self { pixels, width, height, stride: width })
    }

    /// Borrows `pixels` as image of which each row starts `stride` bytes behind the one above.
    ///
    /// # Errors
    /// [`ImageSizeError`] when rows overlap, the buffer ends before the last row does, or either size is zero.
    pub fn with_stride(
        pixels: &'a [u8],
        width: usize,
        height: usize,
        stride: usize,
    ) -> Result<Self, ImageSizeError> {
        let needed = stride.saturating_mul(height.saturating_sub(1)).saturating_add(width);
        if width == 0 || height == 0 || stride < width || pixels.len() < needed {
            return Err(ImageSizeError { width, height, needed, len: pixels.len() });
        }
        Ok(Self { pixels: pixels.get(..needed).unwrap_or(&[]), width, height, stride })
    }

    /// The part of the image within the window, without a copy: its pixel (0, 0) is the window's corner. `None` where the window
    /// is empty or reaches beyond the image.
    #[must_use]
    pub fn part(&self, window: &Window) -> Option<Self> {
        let Window { x0, y0, x1, y1 } = *window;
        if x1 > self.width || y1 > self.height || x0 >= x1 || y0 >= y1 {
            return None;
        }
        let pixels = self.pixels.get(y0 * self.stride + x0..(y1 - 1) * self.stride + x1)?;
        Some(Self { pixels, width: x1 - x0, height: y1 - y0, stride: self.stride })
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

    /// All pixels, row by row, with what lies between the rows.
    #[must_use]
    pub fn pixels(&self) -> &'a [u8] {
        self.pixels
    }

    /// All pixels and nothing else, in order, in the fewest pieces: one where rows follow each other without a gap, else the rows.
    pub fn pieces(&self) -> impl Iterator<Item = &'a [u8]> {
        let (size, count) =
            if self.stride == self.width { (self.pixels.len(), 1) } else { (self.width, self.height) };
        let Self { pixels, stride, .. } = *self;
        (0..count).map(move |i| pixels.get(i * stride..i * stride + size).unwrap_or(&[]))
    }

    /// The three by three pixels whose first is at column `x` and row `y`, by rows; `None` where they reach beyond the image.
    #[must_use]
    #[inline]
    pub fn square(&self, x: usize, y: usize) -> Option<[&'a [u8; 3]; 3]> {
        if x + 3 > self.width || y + 3 > self.height {
            return None;
        }
        let part = self.pixels.get(y * self.stride + x..)?;
        let row = |i: usize| part.get(i * self.stride..)?.first_chunk();
        Some([row(0)?, row(1)?, row(2)?])
    }

    /// The two by two pixels whose first is at column `x` and row `y`, by rows; `None` where they reach beyond the image.
    #[must_use]
    #[inline]
    pub fn four(&self, x: usize, y: usize) -> Option<[[u8; 2]; 2]> {
        if x + 2 > self.width || y + 2 > self.height {
            return None;
        }
        let part = self.pixels.get(y * self.stride + x..)?;
        Some([*part.first_chunk()?, *part.get(self.stride..)?.first_chunk()?])
    }

    /// Pixels of column `x` from row `y` on; none outside the image.
    #[inline]
    pub fn column_from(&self, x: usize, y: usize) -> impl Iterator<Item = u8> + use<'a> {
        let from = if x < self.width && y < self.height { y * self.stride + x } else { self.pixels.len() };
        self.pixels.get(from..).unwrap_or(&[]).iter().step_by(self.stride).copied()
    }

    /// Row `y`; empty when `y` is outside the image.
    #[must_use]
    pub fn row(&self, y: usize) -> &'a [u8] {
        if y >= self.height {
            return &[];
        }
        let start = y * self.stride;
        self.pixels.get(start..start + self.width).unwrap_or(&[])
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
    #[test]
    fn rows_of_parts_are_those_of_the_whole() {
        let bytes: Vec<u8> = (0..35).collect();
        let image = ImageView::with_stride(&bytes, 5, 5, 7).unwrap();
        assert_eq!(image.row(2), &[14, 15, 16, 17, 18]);
        assert!(image.row(5).is_empty());
        let pieces: Vec<&[u8]> = image.pieces().collect();
        assert_eq!(pieces, (0..5).map(|y| image.row(y)).collect::<Vec<_>>());
        assert_eq!(ImageView::new(&bytes, 7, 5).unwrap().pieces().collect::<Vec<_>>(), [&bytes[..]]);
        assert_eq!(image.square(2, 1), Some([&[9, 10, 11], &[16, 17, 18], &[23, 24, 25]]));
        assert!(image.square(2, 2).is_some() && image.square(3, 2).is_none() && image.square(2, 3).is_none());
        assert_eq!(image.four(3, 1), Some([[10, 11], [17, 18]]));
        assert!(image.four(4, 1).is_none() && image.four(3, 4).is_none());
        assert_eq!(image.column_from(4, 2).collect::<Vec<_>>(), [18, 25, 32]);
        assert_eq!(image.column_from(5, 2).count() + image.column_from(4, 5).count(), 0);
        let part = image.part(&Window { x0: 1, y0: 1, x1: 4, y1: 3 }).unwrap();
        assert_eq!((part.width(), part.height()), (3, 2));
        assert_eq!((part.row(0), part.row(1)), (&[8, 9, 10][..], &[15, 16, 17][..]));
        assert!(part.row(2).is_empty());
        assert!(image.part(&Window { x0: 1, y0: 1, x1: 6, y1: 3 }).is_none());
        assert!(image.part(&Window { x0: 3, y0: 1, x1: 3, y1: 3 }).is_none());
        assert!(ImageView::with_stride(&bytes, 5, 5, 4).is_err());
        assert!(ImageView::with_stride(&bytes, 5, 6, 7).is_err());
        assert!(ImageView::with_stride(&bytes, 0, 5, 7).is_err());
        assert!(ImageView::with_stride(&[0; 3], usize::MAX, usize::MAX, usize::MAX).is_err());
        // the last row needs no padding behind it
        assert!(ImageView::with_stride(&bytes[..33], 5, 5, 7).is_ok());
    }
}
