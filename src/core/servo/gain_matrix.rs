//! Gain matrices: symmetric and positive definite, diagonal or full.
//!
//! Matrices over a pose error have a fixed size and are stored in the law. Matrices over image features have one row for each number of the
//! feature error, which depends on the selection of a run file: they are allocated once, shared, and only read in a tick.

use nalgebra::{DMatrix, SMatrix, SVector};
use std::sync::Arc;

/// How far two entries that mirror each other may differ, and how small an eigenvalue may be, as a share of the largest entry. Chosen: what a file
/// with ten digits leaves.
const PRECISION: f64 = 1e-9;

/// Why a matrix is no gain matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoGainMatrix {
    /// It is not square, or has an entry that is not finite.
    NoMatrix,
    /// It is not symmetric: row and column, from 0, of the first entry that differs from its mirrored one.
    Asymmetric(usize, usize),
    /// It is not positive definite: its smallest eigenvalue.
    NotPositive(f64),
}

/// A gain matrix `K` (`M` x `M`) over the `M` numbers of a pose error. Units are those of the law that holds it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GainMatrix<const M: usize> {
    entries: GainEntries<M>,
    largest: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum GainEntries<const M: usize> {
    Diagonal(SVector<f64, M>),
    Full(SMatrix<f64, M, M>),
}

impl<const M: usize> From<SVector<f64, M>> for GainMatrix<M> {
    /// The diagonal matrix of these gains.
    fn from(diagonal: SVector<f64, M>) -> Self {
        Self {
            entries: GainEntries::Diagonal(diagonal),
            largest: diagonal.iter().copied().fold(0.0, f64::max),
        }
    }
}

impl<const M: usize> GainMatrix<M> {
    /// `gain` times the identity.
    #[must_use]
    pub fn repeat(gain: f64) -> Self {
        SVector::<f64, M>::repeat(gain).into()
    }

    /// Whether it is a number times the identity.
    #[must_use]
    pub fn is_uniform(&self) -> bool {
        *self == Self::repeat(self.largest)
    }

    /// The zero matrix.
    #[must_use]
    pub fn zeros() -> Self {
        Self::repeat(0.0)
    }

    /// A full matrix.
    ///
    /// # Errors
    /// [`NoGainMatrix`] when it is not symmetric and positive definite.
    pub fn full(K: SMatrix<f64, M, M>) -> Result<Self, NoGainMatrix> {
        let [_, largest] = eigenvalue_range(&DMatrix::from_column_slice(M, M, K.as_slice()))?;
        Ok(Self { entries: GainEntries::Full(K), largest })
    }

    /// The product `K x`.
    #[must_use]
    pub fn times(&self, x: &SVector<f64, M>) -> SVector<f64, M> {
        match &self.entries {
            GainEntries::Diagonal(k) => k.component_mul(x),
            GainEntries::Full(K) => K * x,
        }
    }

    /// The matrix `K`, `M` x `M`.
    #[must_use]
    pub fn matrix(&self) -> SMatrix<f64, M, M> {
        match &self.entries {
            GainEntries::Diagonal(k) => SMatrix::from_diagonal(k),
            GainEntries::Full(K) => *K,
        }
    }

    /// The largest eigenvalue: the gain of the error that falls fastest.
    #[must_use]
    pub fn largest(&self) -> f64 {
        self.largest
    }

    /// Largest rate, 1/s, at which an error falls that this stiffness reduces against the damping `K_D`, that is, the largest eigenvalue of
    /// `K_D^-1 K`; of full matrices their sum, which is not less. Zero where nothing damps.
    #[must_use]
    pub fn rate_against(&self, K_D: &Self) -> f64 {
        let rate_1_s = match (&self.entries, &K_D.entries) {
            (GainEntries::Diagonal(k), GainEntries::Diagonal(d)) => k.component_div(d).max(),
            _ => K_D.matrix().try_inverse().map_or(0.0, |inverse| (inverse * self.matrix()).trace()),
        };
        if rate_1_s.is_finite() { rate_1_s } else { 0.0 }
    }
}

/// A gain matrix over the stacked feature error `e_s` (k numbers): K_s, K_Ps or K_Ds of the laws C and D.
#[derive(Debug, Clone, PartialEq)]
pub enum FeatureMatrix {
    /// k I, for any number of them.
    Scalar(f64),
    /// One gain for each of them, or all entries of a matrix.
    Entries(FeatureEntries),
}

/// The entries of a [`FeatureMatrix`].
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureEntries {
    /// The diagonal, or row by row.
    entries: Arc<[f64]>,
    numbers: usize,
    largest: f64,
}

impl From<f64> for FeatureMatrix {
    fn from(gain: f64) -> Self {
        Self::Scalar(gain)
    }
}

impl FeatureMatrix {
    /// A diagonal matrix.
    ///
    /// # Errors
    /// [`NoGainMatrix`] when one of `gains` is not positive, or there are none.
    pub fn diagonal(gains: &[f64]) -> Result<Self, NoGainMatrix> {
        let smallest = gains.iter().copied().fold(f64::INFINITY, f64::min);
        if gains.is_empty() || !gains.iter().all(|k| k.is_finite()) {
            return Err(NoGainMatrix::NoMatrix);
        }
        if smallest <= 0.0 {
            return Err(NoGainMatrix::NotPositive(smallest));
        }
        let largest = gains.iter().copied().fold(0.0, f64::max);
        Ok(Self::Entries(FeatureEntries { entries: gains.into(), numbers: gains.len(), largest }))
    }

    /// A full matrix.
    ///
    /// # Errors
    /// [`NoGainMatrix`] when it is not symmetric and positive definite.
    pub fn full(K: &DMatrix<f64>) -> Result<Self, NoGainMatrix> {
        let [_, largest] = eigenvalue_range(K)?;
        // symmetric: columns are rows
        Ok(Self::Entries(FeatureEntries { entries: K.as_slice().into(), numbers: K.nrows(), largest }))
    }

    /// Whether its size fits an error of `numbers` numbers; a scalar fits all.
    #[must_use]
    pub fn fits(&self, numbers: usize) -> bool {
        match self {
            Self::Scalar(_) => true,
            Self::Entries(own) => own.numbers == numbers,
        }
    }

    /// The largest eigenvalue: the gain of the error that falls fastest.
    #[must_use]
    pub fn largest(&self) -> f64 {
        match self {
            Self::Scalar(gain) => *gain,
            Self::Entries(own) => own.largest,
        }
    }

    /// Element `i` of the product `K x`; 0 for rows beyond the matrix.
    #[must_use]
    pub fn row_times(&self, i: usize, x: impl Iterator<Item = f64> + Clone) -> f64 {
        let nth = |x: &mut dyn Iterator<Item = f64>| x.nth(i).unwrap_or_default();
        match self {
            Self::Scalar(gain) => gain * nth(&mut x.clone()),
            Self::Entries(own) if own.is_diagonal() => {
                own.entries.get(i).copied().unwrap_or_default() * nth(&mut x.clone())
            }
            Self::Entries(own) => {
                let row = own.entries.chunks_exact(own.numbers).nth(i).unwrap_or(&[]);
                row.iter().zip(x).map(|(k, x)| k * x).sum()
            }
        }
    }
}

impl FeatureEntries {
    fn is_diagonal(&self) -> bool {
        // a single number is both
        self.entries.len() == self.numbers
    }
}

/// The smallest and the largest eigenvalue of a symmetric and positive definite matrix.
///
/// # Errors
/// [`NoGainMatrix`] when it is none.
pub fn eigenvalue_range(K: &DMatrix<f64>) -> Result<[f64; 2], NoGainMatrix> {
    if !K.is_square() || K.is_empty() || !K.iter().all(|k| k.is_finite()) {
        return Err(NoGainMatrix::NoMatrix);
    }
    let scale = K.amax();
    for i in 0..K.nrows() {
        for j in 0..i {
            if (K[(i, j)] - K[(j, i)]).abs() > PRECISION * scale {
                return Err(NoGainMatrix::Asymmetric(j, i));
            }
        }
    }
    let values = K.symmetric_eigenvalues();
    let smallest = values.min();
    if smallest > PRECISION * scale {
        Ok([smallest, values.max()])
    } else {
        Err(NoGainMatrix::NotPositive(smallest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    /// The rate is that of the quickest part of `K_D y' = -K y`: exact for diagonals, and not less for full matrices.
    #[test]
    fn the_rate_of_a_stiffness_is_that_of_its_quickest_part() {
        let diagonal = |a: f64, b: f64| GainMatrix::from(SVector::<f64, 2>::new(a, b));
        assert_eq!(diagonal(300.0, 30.0).rate_against(&diagonal(150.0, 2.0)), 15.0);
        assert_eq!(diagonal(300.0, 30.0).rate_against(&GainMatrix::zeros()), 0.0);
        let (K, D) =
            (SMatrix::<f64, 2, 2>::new(4.0, 1.0, 1.0, 3.0), SMatrix::<f64, 2, 2>::new(2.0, 0.5, 0.5, 1.0));
        // det(K - rate D) = 1.75 rate^2 - 9 rate + 11
        let quickest = (9.0 + f64::sqrt(81.0 - 77.0)) / 3.5;
        let rate = GainMatrix::full(K).unwrap().rate_against(&GainMatrix::full(D).unwrap());
        assert!(rate >= quickest && rate < 2.0 * quickest, "{rate} {quickest}");
    }

    #[test]
    fn what_is_no_gain_matrix_is_told() {
        let of = |a: f64, b: f64, c: f64, d: f64| GainMatrix::full(Matrix2::new(a, b, c, d));
        assert_eq!(of(2.0, 0.5, 0.4, 1.0).unwrap_err(), NoGainMatrix::Asymmetric(0, 1));
        assert_eq!(of(f64::NAN, 0.5, 0.5, 1.0).unwrap_err(), NoGainMatrix::NoMatrix);
        let Err(NoGainMatrix::NotPositive(smallest)) = of(1.0, 2.0, 2.0, 1.0) else { panic!("indefinite") };
        assert!((smallest + 1.0).abs() < 1e-12);
        assert!(matches!(of(1.0, 1.0, 1.0, 1.0), Err(NoGainMatrix::NotPositive(_))), "semi-definite");
        let K = of(2.0, 1.0, 1.0, 2.0).unwrap();
        assert!((K.largest() - 3.0).abs() < 1e-12);
        assert_eq!(K.times(&Vector2::new(1.0, -1.0)), Vector2::new(1.0, -1.0));
        assert_eq!(FeatureMatrix::diagonal(&[1.0, 0.0]).unwrap_err(), NoGainMatrix::NotPositive(0.0));
        assert_eq!(FeatureMatrix::full(&DMatrix::zeros(2, 3)).unwrap_err(), NoGainMatrix::NoMatrix);
    }

    #[test]
    fn forms_of_one_matrix_are_one() {
        let x = [0.3, -0.2, 0.7];
        let list = [2.0, 5.0, 0.5];
        let diagonal = FeatureMatrix::diagonal(&list).unwrap();
        let full = FeatureMatrix::full(&DMatrix::from_diagonal(&list.to_vec().into())).unwrap();
        for i in 0..3 {
            let wanted = list[i] * x[i];
            assert_eq!(diagonal.row_times(i, x.into_iter()), wanted);
            assert_eq!(full.row_times(i, x.into_iter()), wanted);
            assert_eq!(FeatureMatrix::from(4.0).row_times(i, x.into_iter()), 4.0 * x[i]);
        }
        assert_eq!((diagonal.largest(), full.largest()), (5.0, 5.0));
        assert!(full.fits(3) && !full.fits(4) && FeatureMatrix::Scalar(1.0).fits(9));
    }
}
