//! From a task in the camera's frame to the joints: velocities by (10.76), (10.87), (10.90), torques by (10.74), (10.84).
//!
//! Every resolved-velocity law states rows `L V = r` for the camera's twist V; its task holds their 6 x 6 normal equations, so that the k x 6 matrix
//! is never formed. With `V = J qd` the joint velocity solves
//! `(J^T L^T L J) qd = J^T L^T r`. With six joints this is (10.90) after (10.91); with fewer it is the least-squares
//! solution among the motions of which the arm is capable, which for the SCARA and two points is (10.87) itself. Joints beyond a camera on a link
//! have columns of zeros in J: they rest, and the others have the solution of an arm that ends at the camera.
//!
//! Every torque law is a wrench on the camera and a damping of its twist: `u = g + J^T (h - D J qd)`.

use crate::features::NormalEquations;
use crate::linalg::Ldlt;
use crate::robot::CameraJacobian;
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// Conditioning below which directions are damped: the smaller of two squared ratios, the share of a column that the
/// others do not explain, and the smallest column against the largest. It is a ratio of singular values of 1e-5, a hundred times
/// above the rank tolerance of the factors, so that a direction is damped before the factors would be refused.
const WEAKEST_DIRECTION: f64 = 1e-10;
/// Damping at a singularity, as a share of the largest diagonal entry of the normal matrix. Derived: a direction of singular value s answers with
/// `s / (s^2 + lambda)`, at most `1 / (2 sqrt(lambda))`: 500 times the answer of the best observed direction, whatever s is.
const DAMPING: f64 = 1e-6;

/// A desired camera twist `V = [v; w]` in C as normal equations `(L^T W L) V = L^T W r`, for unit gain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwistTask {
    /// `L^T W L`, 6 x 6.
    pub matrix: Matrix6<f64>,
    /// `L^T W r`.
    pub vector: Vector6<f64>,
    /// Norm of the error, on which an adaptive gain depends.
    pub error: f64,
}

impl TwistTask {
    /// The task with the rows that were added to `equations`, and the norm of its error.
    #[must_use]
    pub fn new(equations: &NormalEquations<6>, error: f64) -> Self {
        Self { matrix: equations.matrix(), vector: equations.vector(), error }
    }

    /// The camera twist of (10.89), (10.91) for the gain `gain_1_s`, `[v; w]` in m/s and rad/s; weak directions are
    /// damped. `None` when even that is not finite.
    #[must_use]
    pub fn twist(&self, gain_1_s: f64) -> Option<Vector6<f64>> {
        Some(Vector6::from(solve_damped(&lower(&self.matrix), &self.vector.into())?) * gain_1_s)
    }
}

/// A wrench on the camera and a damping of its twist.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrenchTask {
    /// h, `[f; n]` in N and N m, expressed in C: `J_Ad^T K_P x~` or `J_L^T K_Ps e_s` before the arm's Jacobian.
    pub wrench: Vector6<f64>,
    /// D, 6 x 6: wrench per twist.
    pub damping: Matrix6<f64>,
}

impl WrenchTask {
    /// The damping of the joints by an arm with the Jacobian `J`, `J^T D J` and the diagonal of K_D, N m s/rad or N s/m.
    #[must_use]
    pub fn joint_damping<const N: usize>(
        &self,
        J: &CameraJacobian<N>,
        own: &SVector<f64, N>,
    ) -> SMatrix<f64, N, N> {
        let J = J.matrix();
        J.tr_mul(&(self.damping * J)) + SMatrix::from_diagonal(own)
    }
}

/// The torque of (10.74), (10.84), `u = g + J^T (h - D J qd) - K_D qd`, N m or N.
///
/// `joint_damping`: the diagonal of K_D for damping on qd, zero with damping in the task space.
#[must_use]
pub fn joint_torque<const N: usize>(
    task: &WrenchTask,
    joint_damping: &SVector<f64, N>,
    J: &CameraJacobian<N>,
    qd: &SVector<f64, N>,
    gravity: &SVector<f64, N>,
) -> Option<SVector<f64, N>> {
    let J = J.matrix();
    let wrench = task.wrench - task.damping * (J * qd);
    let tau = gravity + J.tr_mul(&wrench) - joint_damping.component_mul(qd);
    tau.iter().all(|x| x.is_finite()).then_some(tau)
}

/// The joint velocity of (10.76), (10.87) or (10.90), (10.91) with the gain `gain_1_s`, rad/s or m/s.
///
/// Near a singularity of the features or of the arm the weak directions are damped, so that the velocity stays bounded.
/// `None` when even that has no finite solution.
#[must_use]
pub fn joint_velocity<const N: usize>(
    task: &TwistTask,
    gain_1_s: f64,
    J: &CameraJacobian<N>,
) -> Option<SVector<f64, N>> {
    unit_joint_velocity(task, J).map(|qd| qd * gain_1_s)
}

fn unit_joint_velocity<const N: usize>(task: &TwistTask, J: &CameraJacobian<N>) -> Option<SVector<f64, N>> {
    let J_C = J.matrix();
    if J.moving_joints() > 6 {
        return redundant_joint_velocity(task, J_C);
    }
    let AJ = task.matrix * J_C;
    let b = J_C.tr_mul(&task.vector);
    let mut matrix = [[0.0; N]; N];
    for (i, row) in matrix.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate().take(i + 1) {
            *entry = J_C.column(i).dot(&AJ.column(j));
        }
    }
    // Joints that do not move the camera rest, and do not count as directions that are to be damped.
    let largest = matrix.iter().enumerate().filter_map(|(i, row)| row.get(i)).copied().fold(0.0, f64::max);
    for (i, row) in matrix.iter_mut().enumerate() {
        if let (Some(entry), false) = (row.get_mut(i), J.is_moved_by(i)) {
            *entry = largest;
        }
    }
    solve_damped(&matrix, &b.into()).map(SVector::from)
}

/// More joints that move the camera than the task needs: the camera twist of (10.91), and the smallest joint velocity that gives it.
fn redundant_joint_velocity<const N: usize>(
    task: &TwistTask,
    J_C: &SMatrix<f64, 6, N>,
) -> Option<SVector<f64, N>> {
    let V = solve_damped(&lower(&task.matrix), &task.vector.into())?;
    let y = solve_damped(&lower(&(J_C * J_C.transpose())), &V)?;
    Some(J_C.tr_mul(&Vector6::from(y)))
}

fn lower(m: &Matrix6<f64>) -> [[f64; 6]; 6] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// Solves with the lower triangle of a symmetric matrix; the nearer it is to singular, the more it is damped.
fn solve_damped<const M: usize>(matrix: &[[f64; M]; M], b: &[f64; M]) -> Option<[f64; M]> {
    let x = damped_factors(matrix)?.solve(b);
    x.iter().all(|x| x.is_finite()).then_some(x)
}

/// The factors for that.
pub(super) fn damped_factors<const M: usize>(matrix: &[[f64; M]; M]) -> Option<Ldlt<M>> {
    let diagonal = || matrix.iter().enumerate().filter_map(|(i, row)| row.get(i));
    let largest = diagonal().copied().fold(0.0, f64::max);
    let scale = diagonal().copied().fold(f64::INFINITY, f64::min) / largest;
    let plain = Ldlt::new(matrix, &[0.0; M]);
    let conditioning = plain.as_ref().map_or(0.0, Ldlt::min_ratio).min(scale);
    match plain {
        Some(factors) if conditioning >= WEAKEST_DIRECTION => Some(factors),
        _ => {
            let distance = 1.0 - conditioning.max(0.0) / WEAKEST_DIRECTION;
            Ldlt::new(matrix, &[DAMPING * largest * distance * distance; M])
        }
    }
}
