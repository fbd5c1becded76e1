//! How far an arm is from a singular posture: singular values, manipulability, condition number.

use super::model::Robot;
use nalgebra::{SMatrix, SVector};

/// Sweeps of plane rotations; each one squares what is left off the diagonal, so six or seven reach the last digit.
const SWEEPS: usize = 30;

/// The singular values of `J` in decreasing order; the first `min(M, N)` of them, zeros behind.
///
/// One-sided Jacobi rotations: small singular values keep their relative accuracy, which those of `J^T J` do not.
#[must_use]
pub fn singular_values<const M: usize, const N: usize>(J: &SMatrix<f64, M, N>) -> SVector<f64, N> {
    let mut A = *J;
    for _ in 0..SWEEPS {
        let mut turned = false;
        for i in 0..N {
            for j in i + 1..N {
                let (ci, cj) = (A.column(i).into_owned(), A.column(j).into_owned());
                let (alpha, beta, gamma) = (ci.norm_squared(), cj.norm_squared(), ci.dot(&cj));
                if gamma.abs() <= f64::EPSILON * (alpha * beta).sqrt() || gamma.is_nan() {
                    continue;
                }
                turned = true;
                let zeta = (beta - alpha) / (2.0 * gamma);
                let t = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
                let cos = 1.0 / t.hypot(1.0);
                let sin = cos * t;
                A.set_column(i, &(ci * cos - cj * sin));
                A.set_column(j, &(ci * sin + cj * cos));
            }
        }
        if !turned {
            break;
        }
    }
    let mut values = SVector::<f64, N>::from_fn(|i, _| A.column(i).norm());
    values.as_mut_slice().sort_unstable_by(|a, b| b.total_cmp(a));
    for value in values.iter_mut().skip(M) {
        *value = 0.0;
    }
    values
}

impl<const N: usize> Robot<N> {
    /// Yoshikawa's manipulability: the product of the `min(6, N)` singular values of the flange's Jacobian.
    ///
    /// Metres and radians are mixed, as usual: compare postures of one arm, not arms.
    #[must_use]
    pub fn manipulability(&self, q: &SVector<f64, N>) -> f64 {
        singular_values(&self.jacobian(q)).iter().take(N.min(6)).product()
    }

    /// Greatest over least of those singular values; infinite in a singular posture.
    #[must_use]
    pub fn condition_number(&self, q: &SVector<f64, N>) -> f64 {
        let values = singular_values(&self.jacobian(q));
        let least = values.iter().take(N.min(6)).next_back().copied().unwrap_or(0.0);
        if least > 0.0 { values[0] / least } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check<const M: usize, const N: usize>(
        entries: &[f64],
        reference: &[f64],
    ) -> Result<(), TestCaseError> {
        let ours = singular_values(&SMatrix::<f64, M, N>::from_column_slice(&entries[..M * N]));
        for (a, b) in ours.iter().take(M.min(N)).zip(reference) {
            prop_assert!((a - b).abs() < 1e-12 * reference[0].max(1.0), "{ours} {reference:?}");
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn agrees_with_the_general_decomposition(a in prop::collection::vec(-2.0..2.0f64, 42)) {
            let of = |m: usize, n: usize| {
                nalgebra::DMatrix::from_column_slice(m, n, &a[..m * n]).singular_values().as_slice().to_vec()
            };
            check::<6, 7>(&a, &of(6, 7))?;
            check::<6, 6>(&a, &of(6, 6))?;
            check::<6, 4>(&a, &of(6, 4))?;
            check::<6, 2>(&a, &of(6, 2))?;
        }
    }

    #[test]
    fn a_repeated_column_is_seen() {
        let J = SMatrix::<f64, 6, 3>::from_fn(|i, j| if j == 2 { i as f64 } else { (i * i) as f64 - 3.0 });
        let values = singular_values(&J);
        assert!(values[2] < 1e-14 * values[0], "{values}");
        assert!(values[1] > 0.1);
    }
}
