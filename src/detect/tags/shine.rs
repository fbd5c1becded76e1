//! What blur carries from one cell into another, for the measuring of a side.
//!
//! Across a side, `x` outward, the levels are steps smoothed by a Gaussian of deviation `s`: the edge itself at 0, the border's inner edge at
//! `-w` where the cell behind it is white, that cell's end at `-2 w`, and the margin's end at `w`. A step's share of a window
//! is an integral of the normal distribution; what does not come from the edge itself is taken off.

use crate::linalg::normal;
use nalgebra::Vector2;

/// What a quadrilateral is known to hold, for the side that is measured: the colours of the first two rows of cells inside the border,
/// along the side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Inside {
    /// White is 1: behind the border, and one further.
    pub(super) white: [[f64; 10]; 2],
    pub(super) cells: usize,
    /// By what share light grows in x and y, per px.
    pub(super) light_per_px: Vector2<f64>,
}

impl Inside {
    /// White behind the border at share `t` of the side, softened by `soft` (share).
    pub(super) fn at(&self, t: f64, soft: f64) -> [f64; 2] {
        self.white.map(|row| {
            let cell = |t: f64| {
                let k = (t * self.cells as f64).max(0.0) as usize;
                row.get(k.min(self.cells.saturating_sub(1))).copied().unwrap_or(0.0)
            };
            0.5 * cell(t) + 0.25 * (cell(t - soft) + cell(t + soft))
        })
    }
}

/// Shares of steps in the windows of a side; lengths along the row, px.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shine {
    /// Of a step at the edge in the sum less what the levels say it should be, per px that it moves.
    pub(super) gain: f64,
    /// Of the edge itself in the window of the ink (and, as much, in that of the paper).
    pub(super) own: f64,
    /// Of a light beginning at `-w`, `-2 w` inward: in sum, dark window, and the difference beside the edge.
    pub(super) inner: [[f64; 3]; 2],
    /// Of what begins at the margin's end: in sum, light window, difference.
    pub(super) outer: [f64; 3],
}

/// Windows of a side along a row, px: half length, and from where to where levels are read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Windows {
    pub(super) half: f64,
    pub(super) near: f64,
    pub(super) far: f64,
    pub(super) cell: f64,
}

impl Shine {
    /// For a blur of `s` px along the row.
    pub(super) fn new(w: &Windows, s: f64) -> Self {
        // integral of the distribution function from u0 to u1, about a step at `at`
        let integral = |at: f64, u0: f64, u1: f64| s * (ramp((u1 - at) / s) - ramp((u0 - at) / s));
        let mean = |at: f64, u0: f64, u1: f64| integral(at, u0, u1) / (u1 - u0);
        // seen from inside, outward and inward are alike: a light from `at` on
        let begins = |at: f64, level: (f64, f64)| {
            [
                integral(at, -w.half, w.half),
                mean(at, level.0, level.1),
                mean(at, 0.0, 1.0) - mean(at, -1.0, 0.0),
            ]
        };
        let level = (w.near, w.far);
        let (first, second) = (begins(w.cell, level), begins(2.0 * w.cell, level));
        Self {
            // the levels beside the window change with the edge, too: what they take is missing
            gain: 2.0 * normal(w.half / s).0
                - 1.0
                - 2.0 * w.half * (normal(w.far / s).0 - normal(w.near / s).0) / (w.far - w.near),
            own: mean(0.0, -w.far, -w.near),
            inner: [first, second],
            outer: first,
        }
    }

    /// Whether anything of other cells enters.
    pub(super) fn matters(&self) -> bool {
        // A thousandth of the contrast in a sum moves an edge by 0.001 px, less than the floor of what is stated (`side::FLOOR_PX`): chosen so that
        // wide cells need no second look; half and double change when that is taken, and corners by less than the floor.
        self.outer.iter().any(|share| share.abs() > 1e-3)
    }
}

/// The blur along the row, px, by which the pixels beside an edge differ by this share of its contrast; `scale` as in [`Shine`].
pub(super) fn blur_of(share: f64) -> f64 {
    let shown = |s: f64| 2.0 * s * (ramp(1.0 / s) - ramp(0.0)) - 1.0;
    let (mut low, mut high) = (0.1, 6.0);
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        if shown(middle) > share { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Integral of the normal distribution function up to `z`.
fn ramp(z: f64) -> f64 {
    let (below, density) = normal(z);
    z * below + density
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_equal_sums_over_a_fine_profile() {
        let w = Windows { half: 1.5, near: 1.2, far: 2.4, cell: 2.5 };
        let s = 0.9;
        let shine = Shine::new(&w, s);
        let fine = 20_000;
        let mean = |at: f64, a: f64, b: f64| {
            let x = |i: i32| a + (f64::from(i) + 0.5) * (b - a) / f64::from(fine);
            (0..fine).map(|i| normal((x(i) - at) / s).0).sum::<f64>() / f64::from(fine)
        };
        assert!((shine.outer[0] - 3.0 * mean(2.5, -1.5, 1.5)).abs() < 1e-5);
        assert!((shine.outer[1] - mean(2.5, 1.2, 2.4)).abs() < 1e-5);
        assert!((shine.own - mean(0.0, -2.4, -1.2)).abs() < 1e-5);
        for s in [0.3, 0.8, 2.0, 4.0] {
            let share = 2.0 * s * (ramp(1.0 / s) - ramp(0.0)) - 1.0;
            assert!((blur_of(share) - s).abs() < 3e-3);
        }
    }
}
