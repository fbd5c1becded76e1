//! The two whitened rows of a corner while they are written: derivatives of its pixel, and its error.

use nalgebra::{Matrix2, Matrix2x3, Vector2};

/// Which shared unknowns a row has.
pub(super) struct SharedColumns {
    pub(super) columns: Vec<usize>,
}

/// Two rows that are being written.
pub(super) struct Room<'a, const M: usize> {
    rows: &'a mut [[f64; M]; 2],
    W: &'a Matrix2<f64>,
    at: usize,
}

impl<'a, const M: usize> Room<'a, M> {
    pub(super) fn new(rows: &'a mut [[f64; M]; 2], W: &'a Matrix2<f64>) -> Self {
        Self { rows, W, at: 0 }
    }

    #[inline(always)]
    pub(super) fn push(&mut self, column: &Vector2<f64>) {
        let [first, second] = &mut *self.rows;
        if let (Some(a), Some(b)) = (first.get_mut(self.at), second.get_mut(self.at)) {
            *a = self.W.m11 * column.x + self.W.m12 * column.y;
            *b = self.W.m21 * column.x + self.W.m22 * column.y;
        }
        self.at += 1;
    }

    #[inline(always)]
    pub(super) fn push_three(&mut self, columns: &Matrix2x3<f64>) {
        self.push(&Vector2::new(columns.m11, columns.m21));
        self.push(&Vector2::new(columns.m12, columns.m22));
        self.push(&Vector2::new(columns.m13, columns.m23));
    }
}
