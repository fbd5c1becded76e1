//! A stack of features of several kinds, in memory of fixed size.

use super::{Feature, NormalEquations, TwistSolution};
use nalgebra::SVector;
use thiserror::Error;

/// Why a feature did not enter the stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum StackError {
    /// The rows do not fit.
    #[error(
        "feature stack: {needed} rows do not fit into {capacity}; raise its capacity or use fewer features"
    )]
    Full {
        /// Rows after the push.
        needed: usize,
        /// Rows that fit.
        capacity: usize,
    },
    /// The feature has no interaction matrix where it is, for example a segment without length or a point
    /// behind the camera.
    #[error(
        "feature stack: the feature has no interaction matrix here (no depth or no extent); leave it out"
    )]
    Singular,
}

/// One row of the stacked problem `row V_BC_C = rate`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StackRow {
    /// Row of L_s, for `[v; w]` of the camera.
    pub row: [f64; 6],
    /// Error e_s = s_d - s of this number.
    pub error: f64,
    /// Weight of its squared residual.
    pub weight: f64,
}

/// Up to `CAPACITY` rows of features in any mixture; no heap.
#[derive(Debug, Clone)]
pub struct FeatureStack<const CAPACITY: usize = 32> {
    rows: [StackRow; CAPACITY],
    len: usize,
}

impl<const CAPACITY: usize> Default for FeatureStack<CAPACITY> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const CAPACITY: usize> FeatureStack<CAPACITY> {
    /// An empty stack.
    #[must_use]
    pub const fn new() -> Self {
        Self { rows: [StackRow { row: [0.0; 6], error: 0.0, weight: 0.0 }; CAPACITY], len: 0 }
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// The rows, in the order of entry.
    #[must_use]
    pub fn rows(&self) -> &[StackRow] {
        self.rows.get(..self.len).unwrap_or(&[])
    }

    /// Adds a feature whose wanted value is `desired`, with one weight (1 for none) for its K numbers.
    ///
    /// # Errors
    /// [`StackError::Full`], [`StackError::Singular`]; the stack is then unchanged.
    pub fn push<const K: usize>(
        &mut self,
        feature: &impl Feature<K>,
        desired: &SVector<f64, K>,
        weight: f64,
    ) -> Result<(), StackError> {
        let needed = self.len + K;
        let free =
            self.rows.get_mut(self.len..needed).ok_or(StackError::Full { needed, capacity: CAPACITY })?;
        let L = feature.interaction().ok_or(StackError::Singular)?;
        let e = feature.error(desired);
        for (k, out) in free.iter_mut().enumerate() {
            *out = StackRow { row: std::array::from_fn(|j| L[(k, j)]), error: e[k], weight };
        }
        self.len = needed;
        Ok(())
    }

    /// The normal equations for the rates `gain_1_s` times the errors.
    #[must_use]
    pub fn normal_equations(&self, gain_1_s: f64) -> NormalEquations<6> {
        let mut equations = NormalEquations::new();
        for row in self.rows() {
            equations.add_row(&row.row, gain_1_s * row.error, row.weight);
        }
        equations
    }
}

/// The camera's twist for `s_dot = K_s e_s` in the weighted least-squares sense, (10.89), (10.91), K_s = `gain_1_s` I.
///
/// `damping` >= 0 is added to the diagonal of L^T W L. `None` when the features do not fix all six components.
///
/// ```
/// use nalgebra::Vector2;
/// # use vservo_perception as vservo;
/// use vservo::features::{FeatureStack, PointFeature, solve_twist};
///
/// // Four corners 0.5 m away should look 10 % larger: the camera has to approach.
/// let mut stack = FeatureStack::<8>::new();
/// for s in [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]].map(Vector2::from) {
///     stack.push(&PointFeature { s, z_m: 0.5 }, &(s * 1.1), 1.0)?;
/// }
/// let V_BC_C = solve_twist(&stack, 2.0, 0.0).expect("four corners fix the twist").twist;
/// assert!((V_BC_C.z - 0.1).abs() < 1e-9); // 2/s * 10 % of 0.5 m
/// # Ok::<(), vservo::features::StackError>(())
/// ```
#[must_use]
pub fn solve_twist<const CAPACITY: usize>(
    stack: &FeatureStack<CAPACITY>,
    gain_1_s: f64,
    damping: f64,
) -> Option<TwistSolution<6>> {
    stack.normal_equations(gain_1_s).solve(damping)
}

#[cfg(test)]
mod tests {
    use super::super::{PointFeature, SegmentFeature, planar_columns, point_rows};
    use super::*;
    use nalgebra::{DMatrix, DVector, Vector2, Vector4, Vector6};
    use proptest::prelude::*;

    fn corners() -> [PointFeature; 4] {
        [[-0.1, -0.1], [0.12, -0.1], [0.1, 0.11], [-0.1, 0.1]]
            .map(|s| PointFeature { s: Vector2::from(s), z_m: 0.5 + s[0] })
    }

    proptest! {
        #[test]
        fn mixed_stack_solves_the_weighted_least_squares(
            goal in prop::array::uniform8(-0.2..0.2f64), weights in prop::array::uniform3(0.1..2.0f64)
        ) {
            let [a, b, c, d] = corners();
            let segment = SegmentFeature { s: [a.s, c.s], z_m: [a.z_m, c.z_m] };
            let mut stack = FeatureStack::<8>::new();
            stack.push(&b, &Vector2::new(goal[0], goal[1]), weights[0]).unwrap();
            stack.push(&segment, &Vector4::new(goal[2], goal[3], 0.3 + goal[4], goal[5]), weights[1]).unwrap();
            stack.push(&d, &Vector2::new(goal[6], goal[7]), weights[2]).unwrap();
            prop_assert_eq!(stack.push(&a, &a.s, 1.0), Err(StackError::Full { needed: 10, capacity: 8 }));

            let L = DMatrix::from_fn(8, 6, |i, j| stack.rows()[i].row[j]);
            let e = DVector::from_fn(8, |i, _| 2.0 * stack.rows()[i].error);
            let W = DMatrix::from_diagonal(&DVector::from_fn(8, |i, _| stack.rows()[i].weight));
            let solution = solve_twist(&stack, 2.0, 0.0).unwrap();
            let residual = L.transpose() * &W * (L * solution.twist - e);
            prop_assert!(residual.norm() < 1e-9, "{}", residual.norm());
            prop_assert!(solution.conditioning > 0.0 && solution.conditioning <= 1.0);
            // Damping shortens the twist.
            prop_assert!(solve_twist(&stack, 2.0, 0.1).unwrap().twist.norm() <= solution.twist.norm() + 1e-12);
        }

        #[test]
        fn fast_points_equal_rows(
            points in prop::collection::vec(prop::array::uniform5(-0.5..0.5f64), 3..9), weight in 0.1..3.0f64
        ) {
            let (mut fast, mut slow) = (NormalEquations::<6>::new(), NormalEquations::<6>::new());
            let (mut fast4, mut slow4) = (NormalEquations::<4>::new(), NormalEquations::<4>::new());
            for p in points {
                let (s, z_m, rate) = (Vector2::new(p[0], p[1]), 0.7 + p[2], Vector2::new(p[3], p[4]));
                fast.add_point(&s, z_m, &rate, weight);
                fast4.add_point(&s, z_m, &rate, weight);
                let L = point_rows(&s, z_m);
                slow.add_rows(&L, &rate, weight);
                slow4.add_rows(&planar_columns(&L), &rate, weight);
            }
            prop_assert!((fast.matrix() - slow.matrix()).norm() < 1e-11);
            prop_assert!((fast.vector() - slow.vector()).norm() < 1e-11);
            prop_assert!((fast4.matrix() - slow4.matrix()).norm() < 1e-11);
            prop_assert!((fast4.vector() - slow4.vector()).norm() < 1e-11);
            prop_assert_eq!((fast.rows(), fast4.rows()), (slow.rows(), slow4.rows()));
        }
    }

    #[test]
    fn an_exact_twist_comes_back() {
        let V = Vector6::new(0.1, -0.2, 0.05, 0.3, -0.1, 0.2);
        let mut stack = FeatureStack::<32>::new();
        for point in corners() {
            stack.push(&point, &(point.s + point_rows(&point.s, point.z_m) * V), 1.0).unwrap();
        }
        assert!((solve_twist(&stack, 1.0, 0.0).unwrap().twist - V).norm() < 1e-10);
        stack.clear();
        assert!(stack.rows().is_empty());
    }

    #[test]
    fn two_points_are_too_few_for_six_motions() {
        let mut stack = FeatureStack::<8>::new();
        let V = Vector4::new(0.1, -0.2, 0.05, 0.3);
        for point in &corners()[..2] {
            let rate = planar_columns(&point_rows(&point.s, point.z_m)) * V;
            stack.push(point, &(point.s + rate), 1.0).unwrap();
        }
        assert!(solve_twist(&stack, 1.0, 0.0).is_none());
        assert!(solve_twist(&stack, 1.0, 1e-3).is_some());
    }

    #[test]
    fn points_on_the_singular_cylinder_are_seen() {
        // Three points and the camera's centre on one cylinder whose axis is normal to their plane.
        let angles = [0.4, 2.0, 4.5_f64];
        let mut equations = NormalEquations::<6>::new();
        for a in angles {
            let p = [0.3 * a.cos() + 0.3, 0.3 * a.sin(), 0.8];
            equations.add_point(&Vector2::new(p[0] / p[2], p[1] / p[2]), p[2], &Vector2::new(0.1, 0.2), 1.0);
        }
        assert!(equations.solve(0.0).is_none());
    }

    #[test]
    fn features_without_interaction_and_numbers_that_are_not_finite() {
        let mut stack = FeatureStack::<8>::new();
        let behind = PointFeature { s: Vector2::zeros(), z_m: -0.1 };
        assert_eq!(stack.push(&behind, &Vector2::zeros(), 1.0), Err(StackError::Singular));
        let short = SegmentFeature { s: [Vector2::zeros(); 2], z_m: [1.0; 2] };
        assert_eq!(stack.push(&short, &Vector4::zeros(), 1.0), Err(StackError::Singular));
        for point in corners() {
            stack.push(&point, &Vector2::new(f64::NAN, 0.0), 1.0).unwrap();
        }
        assert!(solve_twist(&stack, 1.0, 0.0).is_none());
    }
}
