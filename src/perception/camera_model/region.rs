//! A rectangle of pixels.

use std::fmt::{Display, Formatter};

/// A part of an image, px.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x_px: u32,
    /// First row.
    pub y_px: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
}

impl Region {
    /// All of an image.
    #[must_use]
    pub fn whole(width_px: u32, height_px: u32) -> Self {
        Self { x_px: 0, y_px: 0, width_px, height_px }
    }

    /// Whether it has pixels, and all of them lie in an image of this size.
    #[must_use]
    pub fn lies_in(&self, width_px: u32, height_px: u32) -> bool {
        let fits = |from: u32, length: u32, side: u32| {
            length > 0 && from.checked_add(length).is_some_and(|to| to <= side)
        };
        fits(self.x_px, self.width_px, width_px) && fits(self.y_px, self.height_px, height_px)
    }
}

impl Display for Region {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{} px at ({}, {})", self.width_px, self.height_px, self.x_px, self.y_px)
    }
}
