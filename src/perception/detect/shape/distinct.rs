//! Whether the corners of an outline are distinguishable in any view.
//!
//! Under perspective not only symmetric outlines are ambiguous: any quadrilateral can be the image of any other, with any corner
//! first. Each corner in turn is taken for the first one, and a homography is sought that maps all others to the next ones.

use crate::pose::{Correspondence, homography};
use crate::target::{Mark, Shape, TargetError};
use nalgebra::{Vector2, Vector3};

/// Fewest corners: since a homography takes any four to any four, the fifth is the first that tells.
const FEWEST: usize = 5;
/// Corners nearer than this share of the size to where they would be for another first one are alike. Chosen by hand: of a shape 50 px large 1.5 px,
/// which edges distinguish easily, but a blurred or partly hidden outline does not.
const ALIKE: f64 = 0.03;

impl Shape {
    /// Checks that a finder can distinguish the shape's points in any view.
    ///
    /// # Errors
    /// [`TargetError`] that says why not: an ellipse, too few corners, a symmetry, or an outline whose tilted view equals one of a symmetry.
    pub fn check_distinct(&self) -> Result<(), TargetError> {
        if !matches!(self.mark(), Mark::Polygon(_)) {
            return Err(TargetError::OutlineEllipse);
        }
        let turns = self.symmetry().turns;
        if turns > 1 {
            return Err(TargetError::OutlineSymmetric { turns });
        }
        let points: Vec<Vector2<f64>> = self.points().iter().map(|p| p.p_O.coords.xy()).collect();
        let count = points.len();
        if count < FEWEST {
            return Err(TargetError::OutlineSimple { count });
        }
        let centre = self.centroid_m();
        let size = points.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max);
        for to in 1..count {
            let onto = points.iter().cycle().skip(to);
            let pairs: Vec<_> =
                points.iter().zip(onto).map(|(r, s)| Correspondence { r: *r, s: *s }).collect();
            let Ok(H) = homography(&pairs) else { continue };
            let off = |pair: &Correspondence| {
                let p = H * Vector3::new(pair.r.x, pair.r.y, 1.0);
                (p.xy() / p.z - pair.s).norm()
            };
            let greatest = pairs.iter().map(off).fold(0.0, f64::max) / size;
            if greatest < ALIKE {
                let off_percent = (greatest * 1e3).round() / 10.0;
                return Err(TargetError::OutlineAlike { to, off_percent });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(corners: &[[f64; 2]]) -> Result<(), TargetError> {
        let corners: Vec<_> = corners.iter().map(|c| Vector2::from(*c)).collect();
        Shape::polygon(&corners, 0.01).unwrap().check_distinct()
    }

    #[test]
    fn what_cannot_be_told_apart_is_refused() {
        assert_eq!(
            Shape::ellipse([0.2, 0.1], 0.0, 0.1).unwrap().check_distinct(),
            Err(TargetError::OutlineEllipse)
        );
        let cross = [
            [1.0, 0.0],
            [2.0, 0.0],
            [2.0, 1.0],
            [3.0, 1.0],
            [3.0, 2.0],
            [2.0, 2.0],
            [2.0, 3.0],
            [1.0, 3.0],
            [1.0, 2.0],
            [0.0, 2.0],
            [0.0, 1.0],
            [1.0, 1.0],
        ];
        assert_eq!(of(&cross), Err(TargetError::OutlineSymmetric { turns: 4 }));
        let any = [[0.0, 0.0], [3.0, 0.2], [2.5, 2.0], [0.5, 1.0]];
        assert_eq!(of(&any), Err(TargetError::OutlineSimple { count: 4 }));
        // a regular pentagon seen aslant
        let pentagon: Vec<_> = (0..5)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 5.0).sin_cos();
                let w = 1.0 + 0.2 * cos + 0.1 * sin;
                [cos / w, 0.6 * sin / w]
            })
            .collect();
        assert!(matches!(of(&pentagon), Err(TargetError::OutlineAlike { to: 1, .. })));
    }

    #[test]
    fn arrows_and_ls_are_distinct() {
        let l = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]];
        assert_eq!(of(&l), Ok(()));
        let arrow = [[0.0, 1.0], [4.0, 1.0], [4.0, 0.0], [6.0, 2.0], [4.0, 4.0], [4.0, 3.0], [0.0, 3.0]];
        assert_eq!(of(&arrow), Ok(()));
    }
}
