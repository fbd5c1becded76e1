//! Mass, centre of mass and moments of inertia of a rigid body, in one of its frames.

use super::error::Defect;
use crate::geometry::Pose;
use crate::linalg::symmetric_eigen;
use nalgebra::{Matrix3, Vector3};

/// The inertia of a rigid body, expressed in a frame fixed to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertia {
    /// Mass in kg.
    pub mass: f64,
    /// Centre of mass in m.
    pub com: Vector3<f64>,
    /// Moments about the centre of mass in kg m^2.
    pub about_com: Matrix3<f64>,
}

impl Inertia {
    /// No body at all.
    pub const ZERO: Self = Self { mass: 0.0, com: Vector3::new(0.0, 0.0, 0.0), about_com: ZERO3 };

    /// A point mass (kg) at `com` (m).
    #[must_use]
    pub fn point(mass: f64, com: Vector3<f64>) -> Self {
        Self { mass, com, about_com: ZERO3 }
    }

    /// The same body expressed in frame A, from its data in frame B.
    #[must_use]
    pub fn in_frame(&self, X_AB: &Pose) -> Self {
        let R = X_AB.rotation.to_rotation_matrix();
        Self {
            mass: self.mass,
            com: R * self.com + X_AB.translation.vector,
            about_com: R.matrix() * self.about_com * R.matrix().transpose(),
        }
    }

    /// The moments about the frame's origin, kg m^2.
    #[must_use]
    pub fn about_origin(&self) -> Matrix3<f64> {
        self.about_com + parallel_axis(self.mass, &self.com)
    }

    /// This body and `other`, both in one frame, welded together.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        // Two massless bodies have no centre of mass: any point serves.
        let com = if mass > 0.0 { (self.com * self.mass + other.com * other.mass) / mass } else { self.com };
        let about_com = self.about_com
            + other.about_com
            + parallel_axis(self.mass, &(self.com - com))
            + parallel_axis(other.mass, &(other.com - com));
        Self { mass, com, about_com }
    }

    /// Whether a real body can have this inertia: positive mass, positive principal moments, none of which exceeds
    /// the sum of the other two.
    ///
    /// # Errors
    /// The [`Defect`] that a file's reader reports with its file and element.
    pub fn check(&self) -> Result<(), Defect> {
        self.check_part()?;
        if self.mass == 0.0 {
            return Err(Defect::Mass { mass_kg: 0.0 });
        }
        let [large, middle, small] = self.principal_moments()?;
        if small <= 0.0 {
            return Err(Defect::NotPositiveDefinite { min_kg_m2: small });
        }
        triangle([large, middle, small])
    }

    /// Whether this can be a load: as [`Self::check_part`], and no principal moment exceeds the sum of the other two. Point masses, rods and
    /// no load at all pass.
    ///
    /// # Errors
    /// As [`Self::check`].
    pub fn check_load(&self) -> Result<(), Defect> {
        self.check_part()?;
        triangle(self.principal_moments()?)
    }

    /// Whether this can be a part of a real body: as [`Self::check`], but point masses and frames without mass pass.
    ///
    /// # Errors
    /// As [`Self::check`].
    pub fn check_part(&self) -> Result<(), Defect> {
        let finite = self.mass.is_finite()
            && self.com.iter().all(|x| x.is_finite())
            && self.about_com.iter().all(|x| x.is_finite());
        if !finite {
            return Err(Defect::NotFinite);
        }
        if self.mass < 0.0 || (self.mass == 0.0 && self.about_com != ZERO3) {
            return Err(Defect::Mass { mass_kg: self.mass });
        }
        let [large, _, small] = self.principal_moments()?;
        // A few units in the last place may come from the eigenvalues themselves, by rounding, and more from digits of the file.
        if small < -1e-12 * large.abs() {
            return Err(Defect::NotPositiveDefinite { min_kg_m2: small });
        }
        Ok(())
    }

    /// In decreasing order, kg m^2.
    fn principal_moments(&self) -> Result<[f64; 3], Defect> {
        let (moments, _) = symmetric_eigen(&self.about_com).ok_or(Defect::NotFinite)?;
        Ok(moments.into())
    }
}

const ZERO3: Matrix3<f64> = Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);

/// Relative excess over the triangle inequality that rounding of published data explains.
const TRIANGLE_SLACK: f64 = 1e-3;

/// The triangle inequality of principal moments in decreasing order, kg m^2. Published inertias are rounded to a few digits: thin bodies may miss
/// equality by that much.
fn triangle([large, middle, small]: [f64; 3]) -> Result<(), Defect> {
    if large > (small + middle) * (1.0 + TRIANGLE_SLACK) {
        return Err(Defect::Triangle { moments_kg_m2: [small, middle, large] });
    }
    Ok(())
}

/// `m (|r|^2 1 - r r^T)`.
pub(crate) fn parallel_axis(mass: f64, r: &Vector3<f64>) -> Matrix3<f64> {
    (Matrix3::identity() * r.norm_squared() - r * r.transpose()) * mass
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn body() -> impl Strategy<Value = Inertia> {
        (0.1..5.0f64, prop::array::uniform3(-1.0..1.0f64), prop::array::uniform9(-1.0..1.0f64)).prop_map(
            |(mass, com, a)| {
                // Any positive definite second-moment matrix D gives a physical inertia tr(D) 1 - D.
                let A = Matrix3::from_row_slice(&a);
                let D = A * A.transpose() + Matrix3::identity() * 0.01;
                let about_com = Matrix3::identity() * D.trace() - D;
                Inertia { mass, com: Vector3::from_row_slice(&com), about_com }
            },
        )
    }

    proptest! {
        #[test]
        fn physical_bodies_pass_and_stay_physical(a in body(), b in body(), v in prop::array::uniform6(-1.0..1.0f64)) {
            let X = Pose::new(Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]));
            prop_assert_eq!(a.check(), Ok(()));
            prop_assert_eq!(a.in_frame(&X).plus(&b).check(), Ok(()));
        }

        #[test]
        fn welding_adds_moments_about_the_origin(a in body(), b in body()) {
            let sum = a.about_origin() + b.about_origin();
            prop_assert!((a.plus(&b).about_origin() - sum).norm() < 1e-11);
        }
    }

    #[test]
    fn loads_may_be_points_and_rods_but_not_impossible() {
        let with = |mass, x, y, z| Inertia {
            mass,
            com: Vector3::zeros(),
            about_com: Matrix3::from_diagonal(&Vector3::new(x, y, z)),
        };
        for good in [with(0.0, 0.0, 0.0, 0.0), with(1.0, 0.0, 0.0, 0.0), with(1.0, 0.1, 0.1, 0.0)] {
            assert_eq!(good.check_load(), Ok(()));
        }
        assert!(matches!(with(1.0, 0.3, 0.1, 0.1).check_load(), Err(Defect::Triangle { .. })));
        assert!(matches!(with(0.0, 0.1, 0.1, 0.1).check_load(), Err(Defect::Mass { .. })));
    }

    #[test]
    fn impossible_bodies_are_named() {
        let with = |mass, x, y, z| Inertia {
            mass,
            com: Vector3::zeros(),
            about_com: Matrix3::from_diagonal(&Vector3::new(x, y, z)),
        };
        assert!(matches!(with(0.0, 1.0, 1.0, 1.0).check(), Err(Defect::Mass { .. })));
        assert!(matches!(with(1.0, 1.0, 1.0, -1.0).check(), Err(Defect::NotPositiveDefinite { .. })));
        assert!(matches!(with(1.0, 1.0, 1.0, 2.1).check(), Err(Defect::Triangle { .. })));
        assert!(matches!(with(1.0, f64::NAN, 1.0, 1.0).check(), Err(Defect::NotFinite)));
    }
}
