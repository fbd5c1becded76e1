//! A part of a board: its bounds without spurious rows and columns, and an affine map for the position of the rest.

use super::lattice::Placed;
use super::place::BoardPlacement;
use nalgebra::{Matrix2, Vector2};

/// A rim is left out below this share of the line behind it; where the lattice is larger than the board, below that. Chosen by hand: chance adds
/// one or two corners, a third of a short side; a rim of a board of which more is hidden is found again when the board grows. Where one rim must
/// go, one with as many corners as the line behind it is a floor's, which is refused (test `thin_rims_are_left_out`).
const THIN: f64 = 0.35;
const THIN_OVER: f64 = 0.7;
/// The affine map of least squares from lattice coordinates to pixels.
pub(super) struct Affine {
    matrix: Matrix2<f64>,
    mean_at: Vector2<f64>,
    mean: Vector2<f64>,
}

impl Affine {
    /// Of these corners.
    pub(super) fn of(placed: &[Placed]) -> Self {
        let n = placed.len().max(1) as f64;
        let (mut mean_at, mut mean) = (Vector2::zeros(), Vector2::zeros());
        for p in placed {
            mean_at += Vector2::from(p.at.map(f64::from)) / n;
            mean += Vector2::from(p.px.map(f64::from)) / n;
        }
        let (mut square, mut product) = (Matrix2::zeros(), Matrix2::zeros());
        for p in placed {
            let d = Vector2::from(p.at.map(f64::from)) - mean_at;
            square += d * d.transpose();
            product += (Vector2::from(p.px.map(f64::from)) - mean) * d.transpose();
        }
        let matrix = square.try_inverse().map_or_else(Matrix2::zeros, |s| product * s);
        Self { matrix, mean_at, mean }
    }

    /// x + y of the board's corner 0 under a placement, px.
    pub(super) fn corner_zero(&self, placement: &BoardPlacement) -> f64 {
        let at = Vector2::from(placement.at([0, 0]).map(f64::from));
        let px = self.mean + self.matrix * (at - self.mean_at);
        px.x + px.y
    }
}

/// Removes rims with far fewer corners than the line behind them, which may be spurious or at the board's edge, and of a
/// lattice that is too large the thinnest rims. Returns the remaining bounds.
pub(super) fn trimmed(placed: &mut Vec<Placed>, columns: i16, rows: i16) -> ([i16; 2], [i16; 2]) {
    loop {
        let (mut low, mut high) = ([i16::MAX; 2], [i16::MIN; 2]);
        for p in placed.iter() {
            for ((low, high), at) in low.iter_mut().zip(&mut high).zip(p.at) {
                (*low, *high) = ((*low).min(at), (*high).max(at));
            }
        }
        if placed.is_empty() {
            return ([0; 2], [0; 2]);
        }
        let span = [high[0] - low[0] + 1, high[1] - low[1] + 1];
        let fits = span[0].min(span[1]) <= columns.min(rows) && span[0].max(span[1]) <= columns.max(rows);
        // the thinnest rim: its share of the line behind it
        let mut thinnest = (f64::INFINITY, 0, 0);
        for axis in 0..2usize {
            for (rim, inner) in [(low[axis], low[axis] + 1), (high[axis], high[axis] - 1)] {
                let on = |line: i16| placed.iter().filter(|p| p.at[axis] == line).count() as f64;
                let share = on(rim) / on(inner).max(1.0);
                if span[axis] > 2 && share < thinnest.0 {
                    thinnest = (share, axis, rim);
                }
            }
        }
        let (share, axis, rim) = thinnest;
        if !(share < THIN || (!fits && share < THIN_OVER)) {
            return (low, high);
        }
        placed.retain(|p| p.at[axis] != rim);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(u: i16, v: i16) -> Placed {
        Placed {
            at: [u, v],
            px: [f32::from(u) * 9.0 + 3.0, f32::from(v) * 8.0],
            light: (u + v) % 2 == 0,
            contrast: 90.0,
        }
    }

    #[test]
    fn thin_rims_are_left_out() {
        let board = || (0..9).flat_map(|u| (0..6).map(move |v| placed(u, v))).collect::<Vec<_>>();
        let mut whole = board();
        assert_eq!(trimmed(&mut whole, 9, 6), ([0, 0], [8, 5]));
        assert_eq!(whole.len(), 54);
        // one beside it
        let mut more = board();
        more.push(placed(9, 2));
        assert_eq!(trimmed(&mut more, 11, 8), ([0, 0], [8, 5]));
        // half a column too many, on a board without room for it
        let mut over = board();
        over.extend((0..3).map(|v| placed(-1, v)));
        assert_eq!(trimmed(&mut over, 9, 6), ([0, 0], [8, 5]));
        let mut over = board();
        over.extend((0..6).map(|v| placed(-1, v)));
        assert_eq!(trimmed(&mut over, 9, 6), ([-1, 0], [8, 5]));
        assert_eq!(trimmed(&mut Vec::new(), 9, 6), ([0, 0], [0, 0]));
    }

    #[test]
    fn corner_zero_by_the_affine_map() {
        let corners: Vec<Placed> = (2..7).flat_map(|u| (1..4).map(move |v| placed(u, v))).collect();
        let affine = Affine::of(&corners);
        let placement = BoardPlacement { turn: 0, shift: [1, -2] };
        // the board's corner 0 is place (-1, 2)
        assert!((affine.corner_zero(&placement) - (-9.0 + 3.0 + 16.0)).abs() < 1e-4);
    }
}
