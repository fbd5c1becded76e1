//! The corners of one board by column and row: sub-pixel fits, and predictions of corners that are not fitted yet.

mod check;
mod ends;
mod floor;

pub(super) use ends::BoardSide;

use super::strongest::strongest;
use crate::imaging::ImageView;
use crate::imaging::corners::{CornerFit, CornerFitter, CornerGuess};
use nalgebra::Vector2;

/// A fit may end so far from where it began, in squares. Chosen by hand: a guess extrapolated under perspective and a lens is off by less, and
/// with 0.2 a fit at something else could still end at it.
const REACH: f64 = 0.1;
/// The same at least, px. Derived: the ring's corner, good to some tenths of a pixel, may come from a half or quarter of the image, where these
/// are twice or four times as many.
const MIN_REACH_PX: f64 = 1.5;
/// Relative uncertainty of the blur before the first fits, and of the others' after them. Chosen by hand: from 1 px down to 0.3 px, the pixel's
/// own blur, is one deviation; and over one board focus changes by some tenths. Twice the second lets blur take up what covers a corner.
const BLUR_UNKNOWN: f64 = 0.7;
const BLUR_KNOWN: f64 = 0.2;
/// Largest stated deviation of a corner that is used, px. Chosen by hand: beside corners of 0.02 to 0.05 px (test `corners_are_accurate`) one of
/// 0.6 px weighs nothing, and what states so much is mostly no corner.
const MAX_SD_PX: f64 = 0.6;
/// On squares larger than that the windows do not reach to the next edges, px and blurs. Derived: a window reaches 8 px (`MAX_HALF_PX` of the
/// fit), and a blurred edge three deviations towards it.
const SMALL_PX: f64 = 8.0;
const SMALL_BLURS: f64 = 3.0;
/// Least ring response of a corner that was not detected before, in half contrasts. Chosen by hand: a sharp corner responds with nearly two of them,
/// and blur and small squares take most of that away. At an eighth much more is fitted in vain, at a half small squares are missed.
const RESPONSE_PART: f32 = 0.25;
/// Corners that are fitted before others profit from their blur. Chosen by hand: the median of six bears two that are wrong; three bear one,
/// and twelve are more than a small part has.
const FIRST: usize = 6;

/// A corner of the board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slot {
    /// Position, px; `NaN` where unknown.
    pub(super) px: Vector2<f64>,
    /// Result of the sub-pixel fit.
    pub(super) fit: Option<CornerFit>,
    /// Tried without success.
    tried: bool,
}

const EMPTY: Slot = Slot { px: Vector2::new(f64::NAN, f64::NAN), fit: None, tried: false };

/// All corners of one board. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct Board {
    columns: usize,
    rows: usize,
    /// Whether the square right below a corner is light where column + row is even.
    even_light: bool,
    /// Whether the board has exactly these columns and rows.
    bounded: bool,
    slots: Vec<Slot>,
    fitter: Box<CornerFitter>,
    values: Vec<f64>,
    /// Residual of each corner to the homography of the whole board, px.
    residuals: Vec<Option<Vector2<f64>>>,
}

impl Board {
    /// A board of `columns x rows` inner corners.
    pub(super) fn new(columns: usize, rows: usize) -> Self {
        let count = columns * rows;
        Self {
            columns,
            rows,
            even_light: false,
            bounded: true,
            slots: vec![EMPTY; count],
            fitter: Box::default(),
            values: Vec::with_capacity(count),
            residuals: Vec::with_capacity(count),
        }
    }

    /// A buffer for a part of a board of unknown placement.
    pub(super) fn unbounded(columns: usize, rows: usize) -> Self {
        Self { bounded: false, ..Self::new(columns, rows) }
    }

    /// Removes all corners. `even_light`: whether squares right below corners with an even sum of column and row are light.
    pub(super) fn clear(&mut self, even_light: bool) {
        self.slots.fill(EMPTY);
        self.even_light = even_light;
    }

    /// Sets the position of a corner, px.
    pub(super) fn put(&mut self, column: i16, row: i16, px: Vector2<f64>) {
        if let Some(id) = self.id(i64::from(column), i64::from(row))
            && let Some(slot) = self.slots.get_mut(id)
        {
            *slot = Slot { px, ..EMPTY };
        }
    }

    /// Adopts a corner that was fitted as part of an unbounded board.
    pub(super) fn take(&mut self, column: i16, row: i16, fit: &CornerFit) {
        if let Some(id) = self.id(i64::from(column), i64::from(row))
            && let Some(slot) = self.slots.get_mut(id)
        {
            *slot = Slot { px: fit.px, fit: Some(*fit), tried: false };
        }
    }

    /// Fits small squares anew, in whose windows the next edges or the surroundings are visible, now that the neighbours' positions are known well.
    pub(super) fn refit_small(&mut self, image: &ImageView<'_>, blur_px: f64) {
        for id in 0..self.slots.len() {
            let Some(fit) = self.slots.get(id).and_then(|s| s.fit) else { continue };
            let Some(steps) = self.steps(id as u32) else { continue };
            let side = steps[0].norm().min(steps[1].norm());
            if side > SMALL_PX + SMALL_BLURS * blur_px {
                continue;
            }
            let again = self.fit_one(image, id, fit.px, steps, (blur_px, BLUR_KNOWN), MIN_REACH_PX);
            if let Some(slot) = self.slots.get_mut(id) {
                *slot = again.map_or(Slot { tried: true, ..EMPTY }, |f| Slot {
                    px: f.px,
                    fit: Some(f),
                    tried: true,
                });
            }
        }
    }

    /// Corners with a fit, ids rising.
    pub(super) fn fitted(&self) -> impl Iterator<Item = (u32, &CornerFit)> {
        (0u32..).zip(&self.slots).filter_map(|(id, s)| s.fit.as_ref().map(|fit| (id, fit)))
    }

    /// Position of a corner, px.
    pub(super) fn px(&self, column: i64, row: i64) -> Option<Vector2<f64>> {
        let px = self.slots.get(self.id(column, row)?)?.px;
        px.x.is_finite().then_some(px)
    }

    fn id(&self, column: i64, row: i64) -> Option<usize> {
        let (c, r) = (usize::try_from(column).ok()?, usize::try_from(row).ok()?);
        (c < self.columns && r < self.rows).then_some(r * self.columns + c)
    }

    fn place(&self, id: usize) -> (i64, i64) {
        ((id % self.columns) as i64, (id / self.columns) as i64)
    }

    /// Displacement to the next corner in a direction, px, from corners nearby.
    fn step(&self, column: i64, row: i64, right: bool) -> Option<Vector2<f64>> {
        let (dx, dy) = if right { (1, 0) } else { (0, 1) };
        // beside the corner, then on the lines next to it, the nearest first
        let (sx, sy) = (dy, dx);
        let lines = self.columns.max(self.rows) as i64;
        for side in (0..lines).flat_map(|k| [k, -k]) {
            let (c, r) = (column + side * sx, row + side * sy);
            let (before, here, after) = (self.px(c - dx, r - dy), self.px(c, r), self.px(c + dx, r + dy));
            match (before, here, after) {
                (Some(a), _, Some(b)) => return Some(0.5 * (b - a)),
                (Some(a), Some(b), _) | (_, Some(a), Some(b)) => return Some(b - a),
                _ => {}
            }
        }
        None
    }

    /// Half the second difference of positions along a direction, px: by how much the step behind a corner exceeds the mean of both; zero where unknown.
    fn change(&self, column: i64, row: i64, right: bool) -> Vector2<f64> {
        let (dx, dy) = if right { (1, 0) } else { (0, 1) };
        for side in [0, 1, -1] {
            let (c, r) = (column + side * dy, row + side * dx);
            if let (Some(a), Some(b), Some(c)) =
                (self.px(c - dx, r - dy), self.px(c, r), self.px(c + dx, r + dy))
            {
                return 0.5 * (a + c) - b;
            }
        }
        Vector2::zeros()
    }

    /// Half the second difference of corners along a direction, px: about the corner, or, at the board's rim and beside what is hidden, next to
    /// it. Nothing where no three corners follow each other.
    fn half_difference(&self, column: i64, row: i64, right: bool) -> Vector2<f64> {
        let (dx, dy) = if right { (1, 0) } else { (0, 1) };
        let about = [0, 1, -1].into_iter().flat_map(|side| [0, 1, -1].map(|on| (on, side)));
        let mut of = about.filter_map(|(on, side)| {
            let (c, r) = (column + on * dx + side * dy, row + on * dy + side * dx);
            let (a, b, c) = (self.px(c - dx, r - dy)?, self.px(c, r)?, self.px(c + dx, r + dy)?);
            Some(0.5 * (a + c) - b)
        });
        of.next().unwrap_or_default()
    }

    /// Position of each fitted corner, corrected for the curvature of its edges by the lens, px, ids rising.
    pub(super) fn unbent(&self) -> impl Iterator<Item = Vector2<f64>> {
        self.fitted().map(|(id, fit)| {
            let (c, r) = self.place(id as usize);
            let halves = [self.half_difference(c, r, true), self.half_difference(c, r, false)];
            self.steps(id).map_or(fit.px, |steps| fit.unbent(steps, halves))
        })
    }

    /// Fits all corners that have a position, and those that can be predicted from them, until none is added. Returns their number.
    pub(super) fn fit(&mut self, image: &ImageView<'_>, blur_px: f64) -> usize {
        self.fit_known(image, blur_px);
        for _ in 0..self.columns + self.rows {
            if self.extend(image) == 0 {
                break;
            }
            self.fit_known(image, blur_px);
        }
        self.check()
    }

    /// Fits corners with a position and without a fit.
    fn fit_known(&mut self, image: &ImageView<'_>, blur_px: f64) {
        let mut blur = self.middle_of(|f| f.blur_px);
        // those that failed are fitted once more, with the blur of the others
        let passes = if blur.is_some() { 1 } else { 2 };
        for _ in 0..passes {
            for id in 0..self.slots.len() {
                let Some(slot) = self.slots.get(id).copied() else { continue };
                if slot.fit.is_some() || !slot.px.x.is_finite() {
                    continue;
                }
                let (c, r) = self.place(id);
                let (Some(right), Some(down)) = (self.step(c, r, true), self.step(c, r, false)) else {
                    continue;
                };
                let side = right.norm().min(down.norm());
                let reach_px = (REACH * side).max(MIN_REACH_PX);
                let known = blur.map_or((blur_px, BLUR_UNKNOWN), |b| (b, BLUR_KNOWN));
                let fit = self.fit_one(image, id, slot.px, [right, down], known, reach_px);
                if let Some(slot) = self.slots.get_mut(id)
                    && let Some(fit) = fit
                {
                    (slot.px, slot.fit) = (fit.px, Some(fit));
                    if blur.is_none() && self.fitted().take(FIRST).count() == FIRST {
                        blur = self.middle_of(|f| f.blur_px);
                    }
                }
            }
            blur = blur.or_else(|| self.middle_of(|f| f.blur_px));
        }
        for slot in self.slots.iter_mut().filter(|s| s.fit.is_none() && s.px.x.is_finite()) {
            (slot.px, slot.tried) = (Vector2::repeat(f64::NAN), true);
        }
    }

    /// Fits one corner about `px`; `blur` with its relative uncertainty. `None` where the colours are not the board's or the fit is poor.
    fn fit_one(
        &mut self,
        image: &ImageView<'_>,
        id: usize,
        px: Vector2<f64>,
        steps_px: [Vector2<f64>; 2],
        (blur_px, blur_spread): (f64, f64),
        reach_px: f64,
    ) -> Option<CornerFit> {
        let (c, r) = self.place(id);
        let goes_on = if self.bounded {
            [c > 0, c + 1 < self.columns as i64, r > 0, r + 1 < self.rows as i64]
        } else {
            [true; 4]
        };
        let changes_px = [self.change(c, r, true), self.change(c, r, false)];
        let guess = CornerGuess { px, steps_px, changes_px, blur_px, blur_spread, goes_on };
        let fit = self.fitter.fit(image, &guess, reach_px)?;
        let light = ((c + r) % 2 == 0) == self.even_light;
        ((fit.half_contrast > 0.0) == light && corner_sd_px(&fit) < MAX_SD_PX).then_some(fit)
    }

    /// Fits a corner at its prediction and stores it. Returns whether there is one.
    pub(super) fn follow(
        &mut self,
        image: &ImageView<'_>,
        id: u32,
        px: Vector2<f64>,
        steps_px: [Vector2<f64>; 2],
        blur_px: f64,
        reach_px: f64,
    ) -> bool {
        let fit = self.fit_one(image, id as usize, px, steps_px, (blur_px, BLUR_KNOWN), reach_px);
        if let (Some(slot), Some(fit)) = (self.slots.get_mut(id as usize), fit) {
            *slot = Slot { px: fit.px, fit: Some(fit), tried: true };
            return true;
        }
        false
    }

    /// Removes corners that do not belong to the board. Returns how many are left.
    pub(super) fn check(&mut self) -> usize {
        self.reject_unlike();
        self.reject_off();
        self.fitted().count()
    }

    /// Blur of the board, px: the median over its corners.
    pub(super) fn blur_px(&mut self) -> Option<f64> {
        self.middle_of(|f| f.blur_px)
    }

    /// Columns and rows of a corner.
    pub(super) fn column_and_row(&self, id: u32) -> Option<(i64, i64)> {
        ((id as usize) < self.slots.len()).then(|| self.place(id as usize))
    }

    /// Predicts positions of corners without one from two on a line. Returns how many.
    fn extend(&mut self, image: &ImageView<'_>) -> usize {
        let contrast = self.middle_of(|f| f.half_contrast.abs()).unwrap_or(0.0);
        let mut added = 0;
        for id in 0..self.slots.len() {
            if self.slots.get(id).is_none_or(|s| s.px.x.is_finite() || s.tried) {
                continue;
            }
            let (c, r) = self.place(id);
            let mut sum = Vector2::zeros();
            let mut n = 0.0;
            for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
                let fitted = |k: i64| {
                    let id = self.id(c + k * dx, r + k * dy)?;
                    self.slots.get(id)?.fit.map(|f| f.px)
                };
                match (fitted(1), fitted(2), fitted(3)) {
                    // constant second difference
                    (Some(a), Some(b), Some(c)) => {
                        sum += 3.0 * a - 3.0 * b + c;
                        n += 1.0;
                    }
                    (Some(a), Some(b), None) => {
                        sum += 2.0 * a - b;
                        n += 1.0;
                    }
                    _ => {}
                }
            }
            let Some(slot) = self.slots.get_mut(id).filter(|_| n > 0.0) else { continue };
            slot.tried = true;
            // where there is nothing like a corner, a fit would take long to fail
            let radius = MIN_REACH_PX + 0.6;
            if strongest(image, sum / n, radius, RESPONSE_PART * contrast as f32).is_some() {
                slot.px = sum / n;
                added += 1;
            }
        }
        added
    }

    /// Median over the fitted corners.
    fn middle_of(&mut self, value: impl Fn(&CornerFit) -> f64) -> Option<f64> {
        self.values.clear();
        self.values.extend(self.slots.iter().filter_map(|s| s.fit.as_ref().map(&value)));
        if self.values.len() < FIRST.min(self.slots.len()) {
            return None;
        }
        let middle = self.values.len() / 2;
        let (_, median, _) = self.values.select_nth_unstable_by(middle, f64::total_cmp);
        Some(*median)
    }

    /// Displacements to the next column and row of each fitted corner, px: from its neighbours, or where these are missing from the whole board.
    pub(super) fn all_steps(&self) -> impl Iterator<Item = [Vector2<f64>; 2]> {
        let whole = self.homography();
        self.fitted().map(move |(id, _)| {
            let by_whole = || whole.map(|w| self.homography_steps(&w, id as usize));
            self.steps(id).or_else(by_whole).unwrap_or([Vector2::zeros(); 2])
        })
    }

    /// Steps to the neighbours of a corner, px.
    pub(super) fn steps(&self, id: u32) -> Option<[Vector2<f64>; 2]> {
        let (c, r) = self.place(id as usize);
        Some([self.step(c, r, true)?, self.step(c, r, false)?])
    }
}

/// Standard deviation of a coordinate, px.
pub(super) fn corner_sd_px(fit: &CornerFit) -> f64 {
    let [xx, _, yy] = fit.covariance_px2;
    (0.5 * (xx + yy)).sqrt()
}
