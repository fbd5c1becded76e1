//! The target of Fig. 10.6: four dark dots at the corners of a square on a light plate.
//!
//! ```text
//!   P1 (0,0)   P2 (a,0)     --> x_o       z_o points away from the camera that looks at the plate,
//!     (O)        o          |             so that it sees x_o to the right and y_o down.
//!                           v y_o         P1 is the larger dot: it tells the corners apart.
//!      o         o
//!   P4 (0,a)   P3 (a,a)     a = 0.1 m
//! ```
//! Its mirror image about the diagonal through P1 looks the same: behind a mirror, or in an image that a camera mirrors, it is taken
//! for what it is not. With a P2 of a size between those of P1 and of the others it is chiral, and only seen as it is.

use super::{Disc, Plate, Symmetry, TargetError, TargetPoint};
use nalgebra::{Point3, Vector2};

/// Smallest ratio of radii that can be distinguished. Chosen by hand: radii that are measured
/// to 5 % each are then still in the right order.
const MIN_RATIO: f64 = 1.2;

/// The plate with its four dots, in the object frame (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FourDots {
    side_m: f64,
    radii_m: [f64; 4],
    margin_m: f64,
    points: [TargetPoint; 4],
    discs: [Disc; 4],
    light_on_dark: bool,
}

impl Default for FourDots {
    /// The textbook's square of 0.1 m; radii 15 mm and 10 mm, margin 30 mm.
    fn default() -> Self {
        Self::of(0.1, [0.015, 0.010, 0.010, 0.010], 0.030)
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
        if first_radius_m < MIN_RATIO * radius_m {
            return Err(TargetError::Radii { first_radius_m, radius_m });
        }
        if first_radius_m + radius_m >= side_m {
            return Err(TargetError::Overlap { side_m, first_radius_m, radius_m });
        }
        if first_radius_m >= margin_m {
            return Err(TargetError::Margin { margin_m, first_radius_m });
        }
        Ok(Self::of(side_m, [first_radius_m, radius_m, radius_m, radius_m], margin_m))
    }

    /// The same target with a P2 of its own size, which tells it from its mirror image.
    ///
    /// # Errors
    /// [`TargetError`] when it is no length, or P2 is not clearly smaller than P1 and larger than P3 and P4.
    pub fn with_second_radius(self, second_radius_m: f64) -> Result<Self, TargetError> {
        TargetError::if_not_positive([("second_radius_m", second_radius_m)])?;
        let [first_radius_m, _, radius_m, _] = self.radii_m;
        // written so that what is tried as the geometric mean passes
        let clear = |large: f64, small: f64| large >= MIN_RATIO * small * (1.0 - 1e-9);
        if !(clear(first_radius_m, second_radius_m) && clear(second_radius_m, radius_m)) {
            return Err(TargetError::SecondRadius { first_radius_m, second_radius_m, radius_m });
        }
        if first_radius_m + second_radius_m >= self.side_m {
            let (side_m, radius_m) = (self.side_m, second_radius_m);
            return Err(TargetError::Overlap { side_m, first_radius_m, radius_m });
        }
        let radii_m = [first_radius_m, second_radius_m, radius_m, radius_m];
        Ok(Self { light_on_dark: self.light_on_dark, ..Self::of(self.side_m, radii_m, self.margin_m) })
    }

    fn of(side_m: f64, radii_m: [f64; 4], margin_m: f64) -> Self {
        let a = side_m;
        let places = [(0, 0.0, 0.0), (1, a, 0.0), (2, a, a), (3, 0.0, a)];
        let points = places.map(|(id, x, y)| TargetPoint { id, p_O: Point3::new(x, y, 0.0) });
        let mut discs = points.map(|point| Disc { centre_m: point.p_O.coords.xy(), radius_m: 0.0 });
        for (disc, radius_m) in discs.iter_mut().zip(radii_m) {
            disc.radius_m = radius_m;
        }
        Self { side_m, radii_m, margin_m, points, discs, light_on_dark: false }
    }

    /// The dot centres P1..P4, ids 0 to 3.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        &self.points
    }

    /// The same target with light dots on a dark plate, or not.
    #[must_use]
    pub fn light_on_dark(self, light_on_dark: bool) -> Self {
        Self { light_on_dark, ..self }
    }

    /// The dots.
    #[must_use]
    pub fn discs(&self) -> &[Disc] {
        &self.discs
    }

    /// Which turns and mirror images of the target look like it: the diagonal through P1 mirrors it, where P2 and P4 are alike.
    #[must_use]
    pub fn symmetry(&self) -> Symmetry {
        let [_, second, _, fourth] = self.radii_m;
        Symmetry { turns: 1, mirrored: second == fourth }
    }

    /// The plate.
    #[must_use]
    pub fn plate(&self) -> Plate {
        let (low, high) = (-self.margin_m, self.side_m + self.margin_m);
        Plate { low_m: Vector2::new(low, low), high_m: Vector2::new(high, high), light: !self.light_on_dark }
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
        self.radii_m
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
        let t = FourDots::default();
        for wrong in [0.0125 / 1.3, 0.0105, 0.014, 0.015, 0.02, 1e300] {
            assert!(matches!(t.with_second_radius(wrong), Err(TargetError::SecondRadius { .. })), "{wrong}");
        }
        assert!(matches!(t.with_second_radius(f64::NAN), Err(TargetError::Length { .. })));
    }

    #[test]
    fn a_second_size_makes_it_chiral() {
        let t = FourDots::default();
        assert!(t.symmetry().mirrored);
        let t = t.light_on_dark(true).with_second_radius(0.01225).unwrap();
        assert!(!t.symmetry().mirrored && !t.plate().light);
        assert_eq!(t.radii_m(), [0.015, 0.01225, 0.010, 0.010]);
    }
}
