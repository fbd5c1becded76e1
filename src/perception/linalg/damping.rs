//! How strongly the steps of Levenberg and Marquardt's least squares are damped, as a share of the normal matrix' diagonal.
//!
//! None at first: near a good start a plain step of Gauss and Newton is best. The factors are chosen by hand, about
//! Marquardt's ten; a success undoes more than a failure, so that the steps end undamped.

/// The damping of the first step that failed. Chosen by hand: Marquardt's first guess was 0.01; a thousandth shortens
/// what is hardly determined and leaves the rest, and each failure takes eight times as much.
pub const FIRST: f64 = 1e-3;
/// Below this a step is one of Gauss and Newton's, and its end quadratic again, because the damping is then none at all.
const NONE_BELOW: f64 = 1e-6;

/// After a step that served.
pub fn eased(damping: f64) -> f64 {
    if damping > NONE_BELOW { 0.1 * damping } else { 0.0 }
}

/// After a step that did not; `first` where there was no damping.
pub fn raised(damping: f64, first: f64) -> f64 {
    (8.0 * damping).max(first)
}
