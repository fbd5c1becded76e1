//! What a kernel writes: one value a pixel, in memory that is kept from frame to frame.

/// Values of all pixels of an image, row by row. The memory grows to the largest image seen and stays.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Plane<T> {
    values: Vec<T>,
    width: usize,
    height: usize,
}

impl<T: Copy + Default> Plane<T> {
    /// A plane with memory for images of this size, allocated at once.
    #[must_use]
    pub fn with_size(width: usize, height: usize) -> Self {
        Self { values: vec![T::default(); width.saturating_mul(height)], width, height }
    }

    /// Takes another size. The values are the earlier ones, in no order: the caller must fill the plane. Allocates only when no
    /// image before was as large.
    pub fn reshape(&mut self, width: usize, height: usize) {
        self.values.resize(width.saturating_mul(height), T::default());
        (self.width, self.height) = (width, height);
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

    /// All values, row by row.
    #[must_use]
    pub fn as_slice(&self) -> &[T] {
        &self.values
    }

    /// Row `y`; empty when `y` is outside.
    #[must_use]
    pub fn row(&self, y: usize) -> &[T] {
        if y >= self.height {
            return &[];
        }
        self.values.get(y * self.width..(y + 1) * self.width).unwrap_or(&[])
    }

    /// Row `y` to be written; empty when `y` is outside.
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        if y >= self.height {
            return &mut [];
        }
        self.values.get_mut(y * self.width..(y + 1) * self.width).unwrap_or(&mut [])
    }

    /// The value of pixel `(x, y)`; none outside.
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> Option<T> {
        self.row(y).get(x).copied()
    }
}

impl Plane<u8> {
    /// The plane as image, for further processing; `None` when it is empty.
    #[must_use]
    pub fn view(&self) -> Option<super::ImageView<'_>> {
        super::ImageView::new(&self.values, self.width, self.height).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_where_they_should_be() {
        let mut plane = Plane::<i16>::with_size(3, 2);
        plane.row_mut(1).copy_from_slice(&[4, 5, 6]);
        assert_eq!(plane.as_slice(), &[0, 0, 0, 4, 5, 6]);
        assert_eq!((plane.get(2, 1), plane.get(3, 1), plane.get(0, 2)), (Some(6), None, None));
        assert!(plane.row(2).is_empty() && plane.row_mut(9).is_empty() && plane.row(usize::MAX).is_empty());
        let capacity = plane.values.capacity();
        plane.reshape(2, 2);
        assert_eq!((plane.width(), plane.height(), plane.as_slice().len()), (2, 2, 4));
        plane.reshape(3, 2);
        assert_eq!(plane.values.capacity(), capacity);
        assert!(Plane::<u8>::default().view().is_none());
    }
}
