//! Cross-talk: the contribution of neighbouring cells, by blur, to the window in which a side is measured.
//!
//! Across a side, with `x` outward and cells of width `w`, the levels are steps smoothed by a Gaussian of deviation `s`: the side itself at 0, the border's
//! inner edge at `-w` where the cell behind it is white, that cell's end at `-2 w`, and the margin's end at `w`. The contribution of
//! a step to a window is an integral of the normal distribution; those of all steps but the side itself are subtracted.

use crate::linalg::normal;
use nalgebra::Vector2;

/// The cells inside one side of a decoded tag: the colours of the first two rows of cells inside the border, along the side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Inside {
    /// 1 for white: the row next to the border, and the one behind it.
    pub(super) white: [[f64; 10]; 2],
    pub(super) cells: usize,
    /// Relative slope of the illumination in x and y, 1/px.
    pub(super) light_per_px: Vector2<f64>,
}

impl Inside {
    /// Share of white in both rows at the position `t` (0 to 1) along the side, smoothed over `soft` (share of the side) each way.
    pub(super) fn at(&self, t: f64, soft: f64) -> [f64; 2] {
        let last = self.cells.saturating_sub(1);
        let places =
            [t, t - soft, t + soft].map(|t| ((t * self.cells as f64).max(0.0) as u32 as usize).min(last));
        self.white.map(|row| {
            let [here, before, behind] = places.map(|k| row.get(k).copied().unwrap_or(0.0));
            0.5 * here + 0.25 * (before + behind)
        })
    }
}

/// Contributions of unit steps to the windows of a side; lengths along the row, px.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shine {
    /// Change of the window's sum, less what the levels beside it predict, per px by which the side moves.
    pub(super) gain: f64,
    /// Of the side itself to the mean level of the ink window, and as much to that of the paper.
    pub(super) own: f64,
    /// Of steps to white at `-w` and `-2 w`: to the window's sum, the dark level, and the difference of the pixels beside the side.
    pub(super) inner: [[f64; 3]; 2],
    /// Of a step at the margin's end: to the window's sum, the light level, and the difference.
    pub(super) outer: [f64; 3],
}

/// Windows of a side along a row, px: half length of the sum, range of the level windows, and width of a cell.
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
        // by symmetry the same holds inward and outward: a step to white at `at`
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
            // the levels beside the window change with the side's position too, which reduces the gain
            gain: 2.0 * normal(w.half / s).0
                - 1.0
                - 2.0 * w.half * (normal(w.far / s).0 - normal(w.near / s).0) / (w.far - w.near),
            own: mean(0.0, -w.far, -w.near),
            inner: [first, second],
            outer: first,
        }
    }

    /// Whether the contribution of other cells is not negligible.
    pub(super) fn matters(&self) -> bool {
        // A thousandth of the contrast in a sum moves an edge by 0.001 px, less than the floor of what is stated (`side::FLOOR_PX`): chosen so that
        // wide cells need no second pass; half and double change when that is done, and corners by less than the floor.
        self.outer.iter().any(|share| share.abs() > 1e-3)
    }
}

/// The blur along the row, px, for which the pixels on both sides of an edge differ by `share` of its contrast, by bisection from 0.1 to 6 px.
pub(super) fn blur_of(share: f64) -> f64 {
    let of_zero = ramp(0.0);
    let shown = |s: f64| 2.0 * s * (ramp(1.0 / s) - of_zero) - 1.0;
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
