//! Least squares by accumulated normal equations: `v = (L^T W L)^-1 L^T W K e`, (10.89), (10.91).
//!
//! Rows of the interaction matrix go in one by one; the k x M matrix itself is never formed. M = 6 is the whole
//! camera twist `[v; w]`, M = 4 the part `[v_x v_y v_z w_z]` that a SCARA arm can move.

#![allow(clippy::needless_range_loop)] // matrix indices read better

use super::PointRows;
use crate::linalg::Ldlt;
use nalgebra::{SMatrix, SVector, Vector2};

/// The accumulated `L^T W L` and `L^T W K e`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalEquations<const M: usize> {
    /// Lower triangle of L^T W L.
    matrix: [[f64; M]; M],
    vector: [f64; M],
    rows: usize,
}

/// A least-squares twist and how well the features fixed it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwistSolution<const M: usize> {
    /// The twist, m/s and rad/s when the right-hand side is a rate.
    pub twist: SVector<f64, M>,
    /// The least fraction, in (0, 1], of a column of the weighted and damped L that the other columns before it do
    /// not explain (squared). Free of units; near zero the features barely fix some motion.
    pub conditioning: f64,
}

impl<const M: usize> Default for NormalEquations<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const M: usize> NormalEquations<M> {
    /// No rows yet.
    #[must_use]
    #[inline(always)]
    pub const fn new() -> Self {
        Self { matrix: [[0.0; M]; M], vector: [0.0; M], rows: 0 }
    }

    /// Rows added so far.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Adds one row `row * v = rate` with the weight `weight` (of the squared residual).
    #[inline(always)]
    pub fn add_row(&mut self, row: &[f64; M], rate: f64, weight: f64) {
        for i in 0..M {
            let weighted = weight * row[i];
            self.vector[i] += weighted * rate;
            for j in 0..=i {
                self.matrix[i][j] += weighted * row[j];
            }
        }
        self.rows += 1;
    }

    /// Adds K rows of one feature with one weight.
    #[inline(always)]
    pub fn add_rows<const K: usize>(&mut self, L: &SMatrix<f64, K, M>, rate: &SVector<f64, K>, weight: f64) {
        for k in 0..K {
            let row = std::array::from_fn(|j| L[(k, j)]);
            self.add_row(&row, rate[k], weight);
        }
    }

    /// Solves for the twist of least `sum weight (row v - rate)^2 + damping |v|^2`.
    ///
    /// `damping` >= 0 adds to the diagonal of L^T W L. `None` when the rows do not fix all M components (fewer than M
    /// independent rows), or something is not finite.
    #[must_use]
    #[inline(always)]
    pub fn solve(&self, damping: f64) -> Option<TwistSolution<M>> {
        let factors = Ldlt::new(&self.matrix, &[damping; M])?;
        let twist = factors.solve(&self.vector);
        let finite = twist.iter().all(|x| x.is_finite());
        finite.then(|| TwistSolution { twist: SVector::from(twist), conditioning: factors.min_ratio() })
    }

    /// The whole matrix L^T W L.
    #[must_use]
    pub fn matrix(&self) -> SMatrix<f64, M, M> {
        SMatrix::from_fn(|i, j| self.matrix[i.max(j)][i.min(j)])
    }

    /// The vector L^T W K e.
    #[must_use]
    pub fn vector(&self) -> SVector<f64, M> {
        SVector::from(self.vector)
    }
}

impl NormalEquations<6> {
    /// Adds the two rows (10.27) of a point at `s` (normalized) and depth `z_m`, without their zeros.
    #[inline(always)]
    pub fn add_point(&mut self, s: &Vector2<f64>, z_m: f64, rate: &Vector2<f64>, weight: f64) {
        let PointRows { d, x, y } = PointRows::interaction([s.x, s.y], 1.0 / z_m);
        let wd = weight * d;
        self.matrix[0][0] += wd * d;
        self.matrix[1][1] += wd * d;
        self.vector[0] += wd * rate.x;
        self.vector[1] += wd * rate.y;
        for i in 0..4 {
            let (wx, wy) = (weight * x[i], weight * y[i]);
            self.matrix[2 + i][0] += wd * x[i];
            self.matrix[2 + i][1] += wd * y[i];
            self.vector[2 + i] += wx * rate.x + wy * rate.y;
            for j in 0..=i {
                self.matrix[2 + i][2 + j] += wx * x[j] + wy * y[j];
            }
        }
        self.rows += 2;
    }
}

impl NormalEquations<4> {
    /// Adds the rows of a point for the motions `[v_x v_y v_z w_z]`.
    #[inline(always)]
    pub fn add_point(&mut self, s: &Vector2<f64>, z_m: f64, rate: &Vector2<f64>, weight: f64) {
        let PointRows { d, x: [x_z, .., x_wz], y: [y_z, .., y_wz] } =
            PointRows::interaction([s.x, s.y], 1.0 / z_m);
        self.add_row(&[d, 0.0, x_z, x_wz], rate.x, weight);
        self.add_row(&[0.0, d, y_z, y_wz], rate.y, weight);
    }
}
