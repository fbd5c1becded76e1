//! What is looked for, without pixels: points with their places on the object, and what is drawn of them.

mod four_dots;

pub use four_dots::{DotTarget, TargetError};
