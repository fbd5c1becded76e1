//! Where in the image corners were seen.

use super::CameraCalibration;
use nalgebra::Vector2;

/// Cells of the image, of its shape of four to three. Chosen, so that a board of usual size covers some in each direction.
const COLUMNS: usize = 12;
const ROWS: usize = 9;
/// An edge of which fewer cells than this share hold corners is not covered. Chosen by hand: a third.
const MIN_SHARE: f64 = 0.34;

/// Whether a cell, by column and row, belongs to an edge.
type Belongs<'a> = &'a dyn Fn(usize, usize) -> bool;

/// Corners by cells of the image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageCoverage {
    /// Corners in each cell, row by row.
    pub counts: Vec<u32>,
    /// Cells in a row.
    pub columns: usize,
}

impl ImageCoverage {
    /// Of the corners that took part.
    #[must_use]
    pub fn of(calibration: &CameraCalibration) -> Self {
        let i = calibration.camera.intrinsics();
        Self::of_pixels((i.width_px, i.height_px), calibration.points_used().map(|p| p.px))
    }

    pub(crate) fn of_pixels((width, height): (u32, u32), pixels: impl Iterator<Item = Vector2<f64>>) -> Self {
        let mut counts = vec![0; COLUMNS * ROWS];
        for px in pixels {
            let cell =
                |x: f64, side: u32, n: usize| ((x + 0.5) / f64::from(side) * n as f64).max(0.0) as usize;
            let (c, r) =
                (cell(px.x, width, COLUMNS).min(COLUMNS - 1), cell(px.y, height, ROWS).min(ROWS - 1));
            if let Some(count) = counts.get_mut(r * COLUMNS + c) {
                *count += 1;
            }
        }
        Self { counts, columns: COLUMNS }
    }

    /// Share of the cells that hold corners.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.share_of(|_, _| true)
    }

    fn share_of(&self, belongs: impl Fn(usize, usize) -> bool) -> f64 {
        let cells =
            self.counts.iter().enumerate().filter(|(i, _)| belongs(i % self.columns, i / self.columns));
        let (all, held) = cells.fold((0u32, 0u32), |(all, held), (_, n)| (all + 1, held + u32::from(*n > 0)));
        f64::from(held) / f64::from(all.max(1))
    }

    /// Edges, and where both of its edges are covered corners, of the image that hold hardly any corners of the board.
    #[must_use]
    pub fn uncovered(&self) -> Vec<&'static str> {
        let (right, bottom) =
            (self.columns.saturating_sub(1), (self.counts.len() / self.columns.max(1)).saturating_sub(1));
        let mut missing = Vec::new();
        let edges: [(&str, Belongs<'_>); 4] = [
            ("left edge", &|c, _| c == 0),
            ("right edge", &|c, _| c == right),
            ("top edge", &|_, r| r == 0),
            ("bottom edge", &|_, r| r == bottom),
        ];
        let bare: Vec<bool> = edges.iter().map(|(_, belongs)| self.share_of(belongs) < MIN_SHARE).collect();
        missing.extend(edges.iter().zip(&bare).filter(|(_, bare)| **bare).map(|((name, _), _)| *name));
        let corners = [
            ("top left corner", 0, 2, (0, 0)),
            ("top right corner", 1, 2, (right, 0)),
            ("bottom left corner", 0, 3, (0, bottom)),
            ("bottom right corner", 1, 3, (right, bottom)),
        ];
        for (name, a, b, (c0, r0)) in corners {
            let told = bare.get(a) == Some(&true) || bare.get(b) == Some(&true);
            // the cell of the corner and its neighbours
            let near = |c: usize, r: usize| c.abs_diff(c0) <= 1 && r.abs_diff(r0) <= 1;
            if !told && self.share_of(near) == 0.0 {
                missing.push(name);
            }
        }
        missing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bare_edges_and_corners_are_named() {
        let all = |keep: &dyn Fn(f64, f64) -> bool| {
            let places =
                (0..64).flat_map(|x| (0..48).map(move |y| (f64::from(x) * 10.0, f64::from(y) * 10.0)));
            let kept = places.filter(|(x, y)| keep(*x, *y)).map(|(x, y)| Vector2::new(x, y));
            ImageCoverage::of_pixels((640, 480), kept)
        };
        assert!(all(&|_, _| true).uncovered().is_empty() && all(&|_, _| true).share() == 1.0);
        assert_eq!(all(&|x, _| x > 100.0).uncovered(), ["left edge"]);
        assert_eq!(all(&|x, y| x < 500.0 || y > 150.0).uncovered(), ["top right corner"]);
        assert_eq!(all(&|_, _| false).uncovered().len(), 4);
        assert_eq!(all(&|x, y| x < 320.0 && y > 60.0).uncovered(), ["right edge", "top edge"]);
    }
}
