//! Outlier rejection: which of the fitted corners belong to the board, by contrast, blur, residual and position.

use super::{Board, EMPTY, Slot, corner_sd_px};
use crate::imaging::corners::CornerFit;
use crate::linalg::Ldlt;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Contrast, residual, blur and stated deviation of a corner compared with the board's medians. Chosen by hand, so wide that light may fall
/// off to a third over the board and blur may double; what lies on a corner is mostly further off. Half the excess over 1 removes
/// corners of boards that are lit from aside, twice of it keeps what lies on corners. The tests `no_wrong_label` and
/// `photographs_with_a_quarter_covered` hold them.
const CONTRAST: std::ops::RangeInclusive<f64> = 0.3..=3.0;
const RESIDUAL_TIMES: f64 = 2.5;
const RESIDUAL_PART: f64 = 0.03;
const BLUR_TIMES: f64 = 2.0;
const SD_TIMES: f64 = 2.5;
const SD_PX: f64 = 0.02;
/// Greatest distance from where the board as a whole has a corner, in squares. Chosen by hand: a lens bends boards less; from half a square
/// on the next corner would be as near.
const BENT: f64 = 0.35;
/// The same from where its neighbours' distances lead, in squares and px. Chosen by hand: extrapolation from two corners of 0.1 px is good to
/// 0.25 px, and what a lens adds over two squares is some hundredths of one. Half removes honest corners under a lens, twice keeps a mark that
/// lies 0.14 squares off.
const OFF: f64 = 0.07;
const OFF_PX: f64 = 0.4;
/// Greatest distance from where the board as a whole has a corner that no neighbours confirm, in squares. Chosen by hand: between both above.
const ALONE: f64 = 0.1;
/// Contrast in that of the neighbours. Chosen by hand: between neighbours light changes less than over the board, and print hardly.
const LIT: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// A few numbers, and their median.
#[derive(Debug, Clone, Copy, Default)]
struct Few {
    values: [f64; 16],
    count: usize,
}

impl Few {
    fn push(&mut self, value: f64) {
        if let Some(slot) = self.values.get_mut(self.count) {
            *slot = value;
            self.count += 1;
        }
    }

    fn median(&mut self) -> Option<f64> {
        let values = self.values.get_mut(..self.count)?;
        values.sort_unstable_by(f64::total_cmp);
        values.get(self.count / 2).copied()
    }
}

impl Board {
    /// Removes fits whose contrast or blur differs from the others': the corner is partly occluded.
    pub(super) fn reject_unlike(&mut self) {
        let Some(contrast) = self.middle_of(|f| f.half_contrast.abs()) else { return };
        let (Some(residual), Some(blur)) =
            (self.middle_of(|f| f.residual_levels), self.middle_of(|f| f.blur_px))
        else {
            return;
        };
        let Some(spread) = self.middle_of(corner_sd_px) else { return };
        for slot in &mut self.slots {
            let alike = |f: &CornerFit| {
                let ratio = f.half_contrast.abs() / contrast;
                CONTRAST.contains(&ratio)
                    && f.residual_levels < RESIDUAL_TIMES * residual + RESIDUAL_PART * f.half_contrast.abs()
                    && f.blur_px < BLUR_TIMES * blur + 0.5
                    && corner_sd_px(f) < SD_TIMES * spread + SD_PX
            };
            if slot.fit.as_ref().is_some_and(|f| !alike(f)) {
                *slot = Slot { tried: true, ..EMPTY };
            }
        }
    }

    /// Removes corners that do not lie where the homography and their neighbours predict them, or whose contrast differs from these: an object on the board
    /// may look like a corner.
    pub(super) fn reject_off(&mut self) {
        for _ in 0..2 {
            let Some(whole) = self.homography() else { return };
            self.residuals.clear();
            for id in 0..self.slots.len() {
                let off = self.slots.get(id).filter(|s| s.fit.is_some()).map(|s| s.px - self.by(&whole, id));
                self.residuals.push(off);
            }
            let mut removed = 0;
            for id in 0..self.slots.len() {
                if !self.fits_in(id, &whole)
                    && let Some(slot) = self.slots.get_mut(id)
                {
                    *slot = Slot { tried: true, ..EMPTY };
                    removed += 1;
                }
            }
            if removed == 0 {
                return;
            }
        }
    }

    /// Image of a corner by a homography, px.
    fn by(&self, whole: &Matrix3<f64>, id: usize) -> Vector2<f64> {
        let (c, r) = self.place(id);
        let v = whole * Vector3::new(c as f64, r as f64, 1.0);
        Vector2::new(v.x, v.y) / v.z
    }

    /// Whether a corner, if there is one, has the residual and the contrast of those about it.
    fn fits_in(&self, id: usize, whole: &Matrix3<f64>) -> bool {
        let residual = |id: usize| self.residuals.get(id).copied().flatten();
        let contrast = |id: usize| self.slots.get(id)?.fit.map(|f| f.half_contrast.abs());
        let (Some(own), Some(light)) = (residual(id), contrast(id)) else { return true };
        let [right, down] = self.homography_steps(whole, id);
        let side = right.norm().min(down.norm());
        // lenses bend boards, though not by a third of a square
        if !(own.norm() < BENT * side) {
            return false;
        }
        let (c, r) = self.place(id);
        let at = |dc: i64, dr: i64| residual(self.id(c + dc, r + dr)?);
        // straight on from two on one side, or half-way between both sides; contrasts of those next to it
        let (mut x, mut y, mut lights) = (Few::default(), Few::default(), Few::default());
        for (dc, dr) in [(1, 0), (0, 1), (1, 1), (1, -1), (-1, 0), (0, -1), (-1, -1), (-1, 1)] {
            let Some(one) = at(dc, dr) else { continue };
            if let Some(l) = self.id(c + dc, r + dr).and_then(contrast) {
                lights.push(l);
            }
            let between = at(-dc, -dr).map(|other| 0.5 * (one + other));
            for told in [between, at(2 * dc, 2 * dr).map(|two| 2.0 * one - two)].into_iter().flatten() {
                x.push(told.x);
                y.push(told.y);
            }
        }
        let (near, told_by) = (OFF * side + OFF_PX, x.count);
        if lights.median().is_some_and(|l| !LIT.contains(&(light / l))) {
            return false;
        }
        match (x.median(), y.median()) {
            // of one or two any may be the one that is wrong
            (Some(x), Some(y)) if told_by > 2 => (own - Vector2::new(x, y)).norm() < near,
            _ => own.norm() < ALONE * side + OFF_PX,
        }
    }

    /// To the next corners in both directions by the board as a whole, px.
    pub(super) fn homography_steps(&self, whole: &Matrix3<f64>, id: usize) -> [Vector2<f64>; 2] {
        let (c, r) = self.place(id);
        let (v, here) = (whole * Vector3::new(c as f64, r as f64, 1.0), self.by(whole, id));
        [0, 1].map(|axis| {
            let d = whole.column(axis);
            (Vector2::new(d[0], d[1]) - here * d[2]) / v.z
        })
    }

    /// Least-squares homography from columns and rows to pixels. `None` with less than four corners or on a line.
    pub(super) fn homography(&self) -> Option<Matrix3<f64>> {
        let (mut n, mut mean) = (0.0, Vector2::zeros());
        for slot in self.slots.iter().filter(|s| s.fit.is_some()) {
            mean += slot.px;
            n += 1.0;
        }
        // a homography has eight parameters: it needs four corners
        if n < 4.0 {
            return None;
        }
        mean /= n;
        let scale = 100.0;
        // twice: the second time the equations are weighed by the denominator
        let mut h = [0.0; 8];
        for _ in 0..2 {
            // moments of columns and rows, weighed by 1, by both coordinates in the image, and by their squares' sum
            let mut moments = [[0.0; 6]; 4];
            for (id, slot) in self.slots.iter().enumerate().filter(|(_, s)| s.fit.is_some()) {
                let (c, r) = self.place(id);
                let (x, y) = (c as f64 - 0.5 * self.columns as f64, r as f64 - 0.5 * self.rows as f64);
                let p = (slot.px - mean) / scale;
                let w2 = (h[6] * x + h[7] * y + 1.0).powi(-2);
                let weights = [w2, w2 * p.x, w2 * p.y, w2 * p.norm_squared()];
                for (moments, weight) in moments.iter_mut().zip(weights) {
                    for (moment, value) in moments.iter_mut().zip([x * x, x * y, y * y, x, y, 1.0]) {
                        *moment += weight * value;
                    }
                }
            }
            let [[xx, xy, yy, x, y, n], p, q, r] = moments;
            let [a, b, c] = [[xx, xy, x], [xy, yy, y], [x, y, n]];
            // of the symmetric matrix the lower triangle
            let matrix = [
                [a[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                [b[0], b[1], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                [c[0], c[1], c[2], 0.0, 0.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, a[0], 0.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, b[0], b[1], 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, c[0], c[1], c[2], 0.0, 0.0],
                [-p[0], -p[1], -p[3], -q[0], -q[1], -q[3], r[0], 0.0],
                [-p[1], -p[2], -p[4], -q[1], -q[2], -q[4], r[1], r[2]],
            ];
            let right = [p[3], p[4], p[5], q[3], q[4], q[5], -r[3], -r[4]];
            h = Ldlt::new(&matrix, &[0.0; 8])?.solve(&right);
        }
        let centred = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
        let to = Matrix3::new(scale, 0.0, mean.x, 0.0, scale, mean.y, 0.0, 0.0, 1.0);
        let (mx, my) = (0.5 * self.columns as f64, 0.5 * self.rows as f64);
        let from = Matrix3::new(1.0, 0.0, -mx, 0.0, 1.0, -my, 0.0, 0.0, 1.0);
        Some(to * centred * from)
    }

    /// Position of a corner of the board, visible or not, px.
    pub(in super::super) fn anywhere(&self, column: f64, row: f64) -> Option<Vector2<f64>> {
        let v = self.homography()? * Vector3::new(column, row, 1.0);
        // else it lies at infinity: z is 1 in the board's middle
        (v.z.abs() > 1e-9).then(|| Vector2::new(v.x, v.y) / v.z)
    }
}
