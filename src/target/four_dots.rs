//! The target of Fig. 10.6: four dark dots at the corners of a square on a light plate.
//!
//! ```text
//!   P1 (0,0)   P2 (a,0)     --> x_o       z_o points away from the camera that looks at the plate,
//!     (O)        o          |             so that it sees x_o to the right and y_o down.
//!                           v y_o         P1 is the larger dot: it tells the corners apart.
//!      o         o
//!   P4 (0,a)   P3 (a,a)     a = 0.1 m
//! ```

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
    /// P1 reaches over the plate's edge.
    #[error("target: the plate's margin {margin_m} m must exceed P1's radius {first_radius_m} m")]
    Margin {
        /// Margin around the square.
        margin_m: f64,
        /// Radius of P1.
        first_radius_m: f64,
    },
}

/// The plate with its four dots, in the object frame (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DotTarget {
    side_m: f64,
    first_radius_m: f64,
    radius_m: f64,
    margin_m: f64,
}

impl Default for DotTarget {
    /// The textbook's square of 0.1 m; radii 15 mm and 10 mm, margin 30 mm.
    fn default() -> Self {
        Self { side_m: 0.1, first_radius_m: 0.015, radius_m: 0.010, margin_m: 0.030 }
    }
}

impl DotTarget {
    /// A target of another size, in m: side of the square between dot centres, radius of P1, radius of the
    /// other dots, and the plate's margin around the square.
    ///
    /// # Errors
    /// [`TargetError`] when lengths are not positive, or dots touch each other or the plate's edge, or P1 is
    /// not clearly the largest.
    pub fn new(side_m: f64, first_radius_m: f64, radius_m: f64, margin_m: f64) -> Result<Self, TargetError> {
        for (name, value_m) in [
            ("side_m", side_m),
            ("first_radius_m", first_radius_m),
            ("radius_m", radius_m),
            ("margin_m", margin_m),
        ] {
            if !value_m.is_finite() || value_m <= 0.0 {
                return Err(TargetError::Length { name, value_m });
            }
        }
        if first_radius_m < 1.2 * radius_m {
            return Err(TargetError::Radii { first_radius_m, radius_m });
        }
        if first_radius_m + radius_m >= side_m {
            return Err(TargetError::Overlap { side_m, first_radius_m, radius_m });
        }
        if first_radius_m >= margin_m {
            return Err(TargetError::Margin { margin_m, first_radius_m });
        }
        Ok(Self { side_m, first_radius_m, radius_m, margin_m })
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

    /// Dot centres P1..P4 in the object plane (x_o, y_o), m.
    #[must_use]
    pub fn points(&self) -> [Vector2<f64>; 4] {
        let a = self.side_m;
        [Vector2::new(0.0, 0.0), Vector2::new(a, 0.0), Vector2::new(a, a), Vector2::new(0.0, a)]
    }

    /// Dot centres P1..P4 in the object frame, m.
    #[must_use]
    pub fn points_O(&self) -> [Point3<f64>; 4] {
        self.points().map(|r| Point3::new(r.x, r.y, 0.0))
    }

    /// Least and greatest coordinate of the plate along x_o and y_o alike, m.
    #[must_use]
    pub fn plate_range_m(&self) -> (f64, f64) {
        (-self.margin_m, self.side_m + self.margin_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_is_valid_and_the_textbooks_square() {
        let t = DotTarget::default();
        assert_eq!(DotTarget::new(0.1, 0.015, 0.010, 0.030), Ok(t));
        assert_eq!(t.points_O()[2], Point3::new(0.1, 0.1, 0.0));
        assert_eq!(t.radii_m()[0], 0.015);
    }

    #[test]
    fn impossible_targets_are_refused() {
        assert!(matches!(
            DotTarget::new(0.0, 0.015, 0.01, 0.03),
            Err(TargetError::Length { name: "side_m", .. })
        ));
        assert!(matches!(DotTarget::new(0.1, f64::NAN, 0.01, 0.03), Err(TargetError::Length { .. })));
        assert!(matches!(DotTarget::new(0.1, 0.011, 0.01, 0.03), Err(TargetError::Radii { .. })));
        assert!(matches!(DotTarget::new(0.1, 0.07, 0.04, 0.08), Err(TargetError::Overlap { .. })));
        assert!(matches!(DotTarget::new(0.1, 0.03, 0.01, 0.02), Err(TargetError::Margin { .. })));
    }
}
