//! Linear algebra of fixed sizes that stays on the stack: products, factorisation, eigenvectors, two and eight numbers at a time; and
//! random numbers.

mod cubic;
pub mod damping;
mod eight;
mod eight_words;
mod lanes;
mod ldlt;
mod normal;
pub mod products3;
mod random;
pub(crate) mod sampling;
mod symmetric_eigen;

pub(crate) use cubic::cubic_roots;
pub(crate) use eight::Eight;
pub(crate) use eight_words::EightWords;
#[cfg(test)]
pub(crate) use lanes::Portable;
pub(crate) use lanes::{F2, Lanes, Number};
pub use ldlt::Ldlt;
pub use normal::normal;
pub use random::Random;
pub use symmetric_eigen::symmetric_eigen;
