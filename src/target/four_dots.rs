//! The target of Fig. 10.6: four dark dots at the corners of a square on a light plate.
//!
//! ```text
//!   P1 (0,0)   P2 (a,0)     --> x_o       z_o points away from the camera that looks at the plate,
//!     (O)        o          |             so that it sees x_o to the right and y_o down.
//!                           v y_o         P1 is the larger dot: it tells the corners apart.
//!      o         o
//!   P4 (0,a)   P3 (a,a)     a = 0.1 m
//! ```

use super::{Mark, Plate, TargetPoint};
use nalgebra::{Point3, Vector2};
use thiserror::Error;

/// A target that cannot be built, or whose corners cannot be told apart.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TargetError {
    /// A length is not a positive, finite number.
    #[error("target: {name} is {value_m} m; give a length greater than zero")]
    Length {
        /// Which length.
        name: &'static str,
        /// Its value.
        value_m: f64,
    },
    /// P1 must be larger than the other dots by a fifth, or identity is lost in noise.
    #[error(
        "target: P1's radius {first_radius_m} m must be at least 1.2 times the other radius {radius_m} m, \
         else the corners cannot be told apart"
    )]
    Radii {
        /// Radius of P1.
        first_radius_m: f64,
        /// Radius of the others.
        radius_m: f64,
    },
    /// Neighbouring dots touch.
    #[error(
        "target: dots of {first_radius_m} m and {radius_m} m touch on a side of {side_m} m; make them smaller"
    )]
    Overlap {
        /// Side of the square.
        side_m: f64,
        /// Radius of P1.
        first_radius_m: f64,
        /// Radius of the others.
        radius_m: f64,
    },
    /// Neighbouring dots of a grid touch.
    #[error(
        "target: dots of {radius_m} m and {mark_radius_m} m touch at a pitch of {pitch_m} m; make them smaller"
    )]
    Pitch {
        /// Distance of neighbours.
        pitch_m: f64,
        /// Radius of the small dots.
        radius_m: f64,
        /// Radius of the large dots.
        mark_radius_m: f64,
    },
    /// A grid is too small to be told apart, or too large.
    #[error("target: {columns} x {rows} dots; give 3 to 32 columns and rows")]
    Count {
        /// Dots in a row.
        columns: usize,
        /// Dots in a column.
        rows: usize,
    },
    /// P1 reaches over the plate's edge.
    #[error("target: the plate's margin {margin_m} m must exceed P1's radius {first_radius_m} m")]
    Margin {
        /// Margin around the square.
        margin_m: f64,
        /// Radius of P1.
        first_radius_m: f64,
    },
}

impl TargetError {
    /// The first of some lengths, m, that is not positive and finite.
    pub(super) fn if_not_positive(lengths: [(&'static str, f64); 4]) -> Result<(), Self> {
        let wrong = lengths.into_iter().find(|(_, m)| !(*m > 0.0 && m.is_finite()));
        wrong.map_or(Ok(()), |(name, value_m)| Err(Self::Length { name, value_m }))
    }
}

/// The plate with its four dots, in the object frame (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FourDots {
    side_m: f64,
    first_radius_m: f64,
    radius_m: f64,
    margin_m: f64,
    points: [TargetPoint; 4],
    marks: [Mark; 4],
}

impl Default for FourDots {
    /// The textbook's square of 0.1 m; radii 15 mm and 10 mm, margin 30 mm.
    fn default() -> Self {
        Self::of(0.1, 0.015, 0.010, 0.030)
    }
}

impl FourDots {
    /// A target of another size, in m: side of the square between dot centres, radius of P1, radius of the
    /// other dots, and the plate's margin around the square.
    ///
    /// # Errors
    /// [`TargetError`] when lengths are not positive, or dots touch each other or the plate's edge, or P1 is
    /// not clearly the largest.
    pub fn new(side_m: f64, first_radius_m: f64, radius_m: f64, margin_m: f64) -> Result<Self, TargetError> {
        TargetError::if_not_positive([
            ("side_m", side_m),
            ("first_radius_m", first_radius_m),
            ("radius_m", radius_m),
            ("margin_m", margin_m),
        ])?;
        if first_radius_m < 1.2 * radius_m {
            return Err(TargetError::Radii { first_radius_m, radius_m });
        }
        if first_radius_m + radius_m >= side_m {
            return Err(TargetError::Overlap { side_m, first_radius_m, radius_m });
        }
        if first_radius_m >= margin_m {
            return Err(TargetError::Margin { margin_m, first_radius_m });
        }
        Ok(Self::of(side_m, first_radius_m, radius_m, margin_m))
    }

    fn of(side_m: f64, first_radius_m: f64, radius_m: f64, margin_m: f64) -> Self {
        let a = side_m;
        let places = [(0, 0.0, 0.0), (1, a, 0.0), (2, a, a), (3, 0.0, a)];
        let points = places.map(|(id, x, y)| TargetPoint { id, p_O: Point3::new(x, y, 0.0) });
        let marks = points.map(|point| Mark {
            centre_m: point.p_O.coords.xy(),
            radius_m: if point.id == 0 { first_radius_m } else { radius_m },
        });
        Self { side_m, first_radius_m, radius_m, margin_m, points, marks }
    }

    /// The dot centres P1..P4, ids 0 to 3.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        &self.points
    }

    /// The dots.
    #[must_use]
    pub fn marks(&self) -> &[Mark] {
        &self.marks
    }

    /// The plate.
    #[must_use]
    pub fn plate(&self) -> Plate {
        let (low, high) = (-self.margin_m, self.side_m + self.margin_m);
        Plate { low_m: Vector2::new(low, low), high_m: Vector2::new(high, high) }
    }

    /// Side of the square between dot centres, m.
    #[must_use]
    pub fn side_m(&self) -> f64 {
        self.side_m
    }

    /// Plate margin around the square, m.
    #[must_use]
    pub fn margin_m(&self) -> f64 {
        self.margin_m
    }

    /// Radii of P1..P4, m.
    #[must_use]
    pub fn radii_m(&self) -> [f64; 4] {
        [self.first_radius_m, self.radius_m, self.radius_m, self.radius_m]
    }

    /// Dot centres P1..P4 in the object frame, m.
    #[must_use]
    pub fn points_O(&self) -> [Point3<f64>; 4] {
        self.points.map(|point| point.p_O)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_is_valid_and_the_textbooks_square() {
        let t = FourDots::default();
        assert_eq!(FourDots::new(0.1, 0.015, 0.010, 0.030), Ok(t));
        assert_eq!(t.points_O()[2], Point3::new(0.1, 0.1, 0.0));
        assert_eq!(t.radii_m()[0], 0.015);
    }

    #[test]
    fn impossible_targets_are_refused() {
        assert!(matches!(
            FourDots::new(0.0, 0.015, 0.01, 0.03),
            Err(TargetError::Length { name: "side_m", .. })
        ));
        assert!(matches!(FourDots::new(0.1, f64::NAN, 0.01, 0.03), Err(TargetError::Length { .. })));
        assert!(matches!(FourDots::new(0.1, 0.011, 0.01, 0.03), Err(TargetError::Radii { .. })));
        assert!(matches!(FourDots::new(0.1, 0.07, 0.04, 0.08), Err(TargetError::Overlap { .. })));
        assert!(matches!(FourDots::new(0.1, 0.03, 0.01, 0.02), Err(TargetError::Margin { .. })));
    }
}
