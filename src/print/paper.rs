//! Papers of printers: whether a sheet fits, and where it lies on one.

use super::{EDGE_MM, FOOT_MM, PrintError, PrintShape, PrintSheet};
use nalgebra::Vector2;

/// A paper; the sheet lies upright or across on it, as it fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paper {
    /// 210 x 297 mm (ISO 216).
    A4,
    /// 215.9 x 279.4 mm, which is 8.5 x 11 inches.
    Letter,
    /// 297 x 420 mm (ISO 216).
    A3,
}

impl Paper {
    /// Its name.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::A4 => "A4",
            Self::Letter => "letter",
            Self::A3 => "A3",
        }
    }

    /// Width and height, upright, mm: by the standards that [`Self`] names.
    #[must_use]
    pub fn size_mm(self) -> [f64; 2] {
        match self {
            Self::A4 => [210.0, 297.0],
            Self::Letter => [215.9, 279.4],
            Self::A3 => [297.0, 420.0],
        }
    }

    /// The smallest usual one, beside letter, on which so much fits; `None` where none is large enough.
    pub(super) fn smallest_for(size_mm: Vector2<f64>) -> Option<Self> {
        [Self::A4, Self::A3].into_iter().find(|paper| paper.turned_for(size_mm).is_some())
    }

    /// Its size, upright or across, as so much fits on it.
    fn turned_for(self, size_mm: Vector2<f64>) -> Option<Vector2<f64>> {
        let [width, height] = self.size_mm();
        let ways = [Vector2::new(width, height), Vector2::new(height, width)];
        ways.into_iter().find(|way| size_mm.x <= way.x && size_mm.y <= way.y)
    }
}

impl PrintSheet {
    /// The same in the middle of a paper.
    pub(super) fn on(mut self, paper: Paper) -> Result<Self, PrintError> {
        let Some(size_mm) = paper.turned_for(self.size_mm) else {
            return Err(self.too_large_for(paper));
        };
        let by = 0.5 * (size_mm - self.size_mm);
        self.dark_plate.iter_mut().flatten().for_each(|corner| *corner += by);
        for shape in &mut self.shapes {
            match shape {
                PrintShape::Circle { centre_mm, .. } => *centre_mm += by,
                PrintShape::Outlines(loops) => loops.iter_mut().flatten().for_each(|corner| *corner += by),
            }
        }
        self.text_mm += by;
        self.bar_mm += by;
        self.size_mm = size_mm;
        Ok(self)
    }

    fn too_large_for(&self, paper: Paper) -> PrintError {
        // The margins and the foot stay as they are, whatever the target's size.
        let beside = Vector2::new(2.0 * EDGE_MM, 2.0 * EDGE_MM + FOOT_MM);
        let plate = self.size_mm - beside;
        let [a, b] = paper.size_mm();
        let share =
            |width: f64, height: f64| f64::min((width - beside.x) / plate.x, (height - beside.y) / plate.y);
        PrintError::NoRoom {
            width_mm: self.size_mm.x,
            height_mm: self.size_mm.y,
            paper,
            percent: (100.0 * f64::max(share(a, b), share(b, a))).floor(),
        }
    }
}
