//! The normal equations in their bordered block form, and how they are solved.

use super::problem::{BundleProblem, BundleState};
use super::rows::SharedColumns;
use crate::linalg::Ldlt;
use crate::pose::Loss;
use nalgebra::{Cholesky, DMatrix, DVector, Matrix6, Matrix6xX, Vector6};

/// Unknowns of a row beside its shared ones: the twist of the board, 6, and the error, from which the 7 follows.
const POSE_AND_ERROR: usize = 7;
/// Entries of a row: parameters of the camera, its pose, the warp, the board's pose, the error; rounded up, so that rows are whole registers.
const WIDEST: usize = 28;
/// The same where that is enough, since the products go with the square: a third of them are left.
const USUAL: usize = 16;
/// A shared unknown that keeps so small a share of its information beside the others is not determined by the images: the rest is a difference that
/// rounds to 1e-16, so that three digits of a larger one are its own.
const UNTOLD: f64 = 1e-13;

/// What one view adds.
#[derive(Debug, Clone)]
struct ViewBlock {
    V: Matrix6<f64>,
    /// 6 x shared.
    W: Matrix6xX<f64>,
    h: Vector6<f64>,
}

/// Normal equations `J^T J step = J^T e` at a state, without damping.
#[derive(Debug, Clone)]
pub(crate) struct BundleSums {
    U: DMatrix<f64>,
    g: DVector<f64>,
    blocks: Vec<ViewBlock>,
    /// Sum of the loss, which is minimised.
    pub(crate) loss: f64,
    /// Sum of the squared whitened errors.
    pub(crate) chi_square: f64,
}

/// A step and what it promises.
pub(super) struct BundleStep {
    pub(super) shared: Vec<f64>,
    pub(super) poses: Vec<[f64; 6]>,
    /// Step times gradient: twice the fall of the loss that a quadratic would have.
    pub(super) promise: f64,
}

impl BundleSums {
    /// At `state`. `None` where a corner would lie behind a camera, or anything is not finite.
    pub(crate) fn at(problem: &BundleProblem, state: &BundleState, loss: Loss) -> Option<Self> {
        let n = problem.shared();
        let mut sums = Self {
            U: DMatrix::zeros(n, n),
            g: DVector::zeros(n),
            blocks: Vec::with_capacity(problem.views.len()),
            loss: 0.0,
            chi_square: 0.0,
        };
        let borders: Vec<SharedColumns> = (0..problem.freedom.len()).map(|j| problem.border(j)).collect();
        for (view, observations) in problem.views.iter().enumerate() {
            let mut block = ViewBlock { V: Matrix6::zeros(), W: Matrix6xX::zeros(n), h: Vector6::zeros() };
            for observation in observations {
                let border = borders.get(observation.camera)?;
                let width = border.columns.len() + POSE_AND_ERROR;
                let at = (view, observation.camera);
                if width <= USUAL {
                    sums.add::<USUAL>(problem, state, loss, at, &observation.points, border, &mut block)?;
                } else {
                    sums.add::<WIDEST>(problem, state, loss, at, &observation.points, border, &mut block)?;
                }
            }
            sums.blocks.push(block);
        }
        sums.loss.is_finite().then_some(sums)
    }

    #[allow(clippy::too_many_arguments)] // one loop, cut out to be made for two widths
    fn add<const M: usize>(
        &mut self,
        problem: &BundleProblem,
        state: &BundleState,
        loss: Loss,
        (view, camera): (usize, usize),
        points: &[super::BundlePoint],
        border: &SharedColumns,
        block: &mut ViewBlock,
    ) -> Option<()> {
        let frames = state.frames(camera, view)?;
        let own = border.columns.len();
        let mut squares = [[0.0; M]; M];
        let mut rows = [[0.0; M]; 2];
        for point in points {
            let k2 = state.rows(problem, &frames, point, &mut rows)?;
            let (rho, weight) = loss.at(k2);
            self.loss += rho;
            self.chi_square += k2;
            let [first, second] = &rows;
            for (i, sums) in squares.iter_mut().enumerate() {
                // the upper triangle alone, from a multiple of four: whole registers
                let from = i & !3;
                let of = |row: &[f64; M]| row.get(i).map_or(0.0, |a| a * weight);
                let (a, b) = (of(first), of(second));
                let (Some(sums), Some(first), Some(second)) =
                    (sums.get_mut(from..), first.get(from..), second.get(from..))
                else {
                    continue;
                };
                for ((sum, x), y) in sums.iter_mut().zip(first).zip(second) {
                    *sum += a * x + b * y;
                }
            }
        }
        let entry = |i: usize, j: usize| {
            squares.get(i.min(j)).and_then(|row| row.get(i.max(j))).copied().unwrap_or(0.0)
        };
        for (i, &a) in border.columns.iter().enumerate() {
            for (j, &b) in border.columns.iter().enumerate() {
                self.U[(a, b)] += entry(i, j);
            }
            for k in 0..6 {
                block.W[(k, a)] += entry(own + k, i);
            }
            self.g[a] += entry(i, own + 6);
        }
        for k in 0..6 {
            for l in 0..6 {
                block.V[(k, l)] += entry(own + k, own + l);
            }
            block.h[k] += entry(own + k, own + 6);
        }
        Some(())
    }

    /// The step for a damping relative to the diagonal. `None` when the equations are singular.
    pub(super) fn step(&self, damping: f64) -> Option<BundleStep> {
        let mut S = self.U.clone();
        for i in 0..S.nrows() {
            S[(i, i)] += damping * self.U[(i, i)];
        }
        let mut rhs = self.g.clone();
        let mut factors = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let (factor, Y) = eliminate(block, damping, &mut S)?;
            let y = Vector6::from(factor.solve(&block.h.into()));
            rhs -= block.W.tr_mul(&y);
            factors.push((Y, y));
        }
        let shared = scaled_cholesky(&S, &self.U)?.solve(rhs);
        let mut promise = shared.dot(&self.g);
        let poses = (self.blocks.iter().zip(factors))
            .map(|(block, (Y, y))| {
                let twist: Vector6<f64> = y - Y * &shared;
                promise += twist.dot(&block.h);
                twist.into()
            })
            .collect();
        promise.is_finite().then(|| BundleStep { shared: shared.as_slice().to_vec(), poses, promise })
    }

    /// Information of the shared unknowns, the poses being free: `U - sum W_i^T V_i^-1 W_i`.
    pub(crate) fn information(&self) -> Option<DMatrix<f64>> {
        let mut S = self.U.clone();
        for block in &self.blocks {
            eliminate(block, 0.0, &mut S)?;
        }
        Some(S)
    }

    /// Covariance of the shared unknowns. `None` where the images do not tell them.
    pub(crate) fn covariance(&self) -> Option<DMatrix<f64>> {
        Some(scaled_cholesky(&self.information()?, &self.U)?.inverse())
    }
}

impl BundleSums {
    /// Covariance of the twist of a view's pose, where `shared` is that of the shared unknowns. `None` where the view alone fixes no pose.
    pub(crate) fn pose_covariance(&self, view: usize, shared: &DMatrix<f64>) -> Option<Matrix6<f64>> {
        let block = self.blocks.get(view)?;
        let alone = Matrix6::from(Ldlt::new(&block.V.data.0, &[0.0; 6])?.inverse());
        let pull = alone * &block.W;
        Some(alone + &pull * shared * pull.transpose())
    }
}

/// The inverse of an information, `None` where it is singular.
pub(crate) fn covariance_of(information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(scaled_cholesky(information, information)?.inverse())
}

/// Takes a view's pose out of the shared equations.
fn eliminate(block: &ViewBlock, damping: f64, S: &mut DMatrix<f64>) -> Option<(Ldlt<6>, Matrix6xX<f64>)> {
    let diagonal = std::array::from_fn(|i| damping * block.V[(i, i)]);
    let factor = Ldlt::new(&block.V.data.0, &diagonal)?;
    let mut Y = block.W.clone();
    for mut column in Y.column_iter_mut() {
        let solved = factor.solve(&std::array::from_fn(|i| column[i]));
        column.copy_from_slice(&solved);
    }
    S.gemm_tr(-1.0, &block.W, &Y, 1.0);
    Some((factor, Y))
}

/// A factorisation that does not depend on units.
struct Scaled {
    factor: Cholesky<f64, nalgebra::Dyn>,
    scale: DVector<f64>,
}

/// `None` when some unknown has, beside the others, no information of its own: less than [`UNTOLD`] of that in `U`.
fn scaled_cholesky(S: &DMatrix<f64>, U: &DMatrix<f64>) -> Option<Scaled> {
    let scale = U.diagonal().map(|x| 1.0 / x.sqrt());
    if !scale.iter().all(|x| x.is_finite()) {
        return None;
    }
    let mut A = S.clone();
    for j in 0..A.ncols() {
        for i in 0..A.nrows() {
            A[(i, j)] *= scale[i] * scale[j];
        }
    }
    let factor = Cholesky::new(A)?;
    let told = factor.l_dirty().diagonal().iter().all(|x| x * x > UNTOLD);
    told.then_some(Scaled { factor, scale })
}

impl Scaled {
    fn solve(&self, mut b: DVector<f64>) -> DVector<f64> {
        b.component_mul_assign(&self.scale);
        self.factor.solve_mut(&mut b);
        b.component_mul(&self.scale)
    }

    fn inverse(&self) -> DMatrix<f64> {
        let mut inverse = self.factor.inverse();
        for j in 0..inverse.ncols() {
            for i in 0..inverse.nrows() {
                inverse[(i, j)] *= self.scale[i] * self.scale[j];
            }
        }
        inverse
    }
}
