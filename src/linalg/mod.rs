//! Linear algebra of fixed sizes that stays on the stack: factorisation, eigenvectors, two numbers at a time; and random
//! numbers.

mod lanes;
mod ldlt;
mod random;
mod symmetric_eigen;

#[cfg(test)]
pub(crate) use lanes::Portable;
pub(crate) use lanes::{F2, Lanes};
pub(crate) use ldlt::Ldlt;
pub use random::Random;
pub(crate) use symmetric_eigen::symmetric_eigen;
