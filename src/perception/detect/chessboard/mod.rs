//! Chessboards: the inner corners of a board of known size, each with its id, also where only a part of the board is visible.
//!
//! ```text
//! image --halved--> ring corners --links--> lattices --ends, colours, size--> place on the board --fit--> corners with covariance
//! ```
//! Ids are `row x COLUMNS + column` of the inner corners. Rows and columns run so that x (along a row), y (along a column) and the
//! normal away from the camera are right-handed, as in OpenCV; a mirrored board cannot be distinguished from one that is not, and is labelled
//! the same way. The table of `place` says which corner is the first: for 9x6 the one at a dark corner square.
//!
//! A part of a board is accepted when its size, its colours and its visible ends determine its position on the board; otherwise it is refused. Terms: the
//! *ring response* is large where four alternating squares meet; a *link* joins neighbouring corners along an edge; a *lattice* is a set of linked corners with
//! integer coordinates; its *placement* is the quarter turn and shift to columns and rows; an *end* is a side beyond which the board is seen to stop.

mod board;
mod border;
mod lattice;
mod miss;
mod part;
mod place;
mod strongest;
mod track;

pub use miss::ChessboardMiss;

use super::{Detection, PredictedPoint};
use crate::imaging::ImageView;
use crate::imaging::corners::{RingDetector, halve};
use crate::messages::TargetStatus;
use board::{Board, BoardSide, corner_sd_px};
use border::{BoardEnd, Outer};
use lattice::{Links, Placed};
use miss::telling;
use nalgebra::Vector2;
use part::{Affine, trimmed};
use place::{BoardPlacement, LatticeExtent, placements};
use strongest::has_contrast;
use track::Prediction;

/// Least ring response of a corner, grey levels. Chosen by hand: squares 12 levels apart; half lets texture in, twice refuses dim boards.
const MIN_RESPONSE: u8 = 6;
/// Search begins at the first half at most so wide, px. Chosen by hand: a level costs a quarter of the next; at 200 most squares are too small.
const FIRST_WIDTH_PX: usize = 400;
/// Least corners of a part, and one in so many of the board. Chosen by hand: a homography needs four corners, two more can contradict it.
const MIN_CORNERS: usize = 6;
const MIN_PART: usize = 6;
/// A second board with this share of the first one's corners makes the choice ambiguous. Chosen by hand: less lets clutter refuse boards.
const SECOND: f64 = 0.6;
/// Blur before it was measured, px. Chosen by hand: a start of the fit, which estimates it; half or double change how many first corners converge.
const BLUR_PX: f64 = 1.0;
/// Bounds of a board: inner corners along a side. A lattice needs two lines; 60 was chosen by hand: buffers grow with its square.
const SIDE: std::ops::RangeInclusive<usize> = 2..=60;
/// Links that are looked for first, in image widths. Chosen by hand: a 9x6 board across the whole image has squares of a tenth.
const SHORT: f32 = 0.15;
/// Places about a part of a board into which it may grow. Chosen by hand: one would do for a missed rim; six make a larger grid to clear.
const ROOM: i16 = 3;
/// Lattices that a search looks at. Chosen by hand: clutter has a few large enough ones; each takes up to 5 ms, so all of them 160 ms.
const MAX_LATTICES: usize = 32;
/// Contradictory links of a lattice that is still examined: one in so many corners. Chosen by hand: with 24 one bad link refuses a part of 23.
const CONTRADICTIONS: u16 = 12;

/// Finder of one chessboard. Owns all buffers: nothing is allocated after construction and the first frame.
#[derive(Debug, Clone)]
pub struct ChessboardFinder {
    columns: i16,
    rows: i16,
    width: usize,
    height: usize,
    halves: Vec<(Vec<u8>, usize, usize)>,
    detector: RingDetector,
    links: Links,
    order: Vec<(u16, u16)>,
    placed: Vec<Placed>,
    /// Positions of a lattice's corners, rows of [`Self::grid_side`].
    grid: Vec<Option<Placed>>,
    placements: Vec<BoardPlacement>,
    /// A part of a board before its placement is known.
    part: Board,
    board: Board,
    predicted: Board,
    blur_px: f64,
    /// Number of lattices that the search may still examine.
    left: usize,
    /// Why the last search found nothing.
    miss: Option<ChessboardMiss>,
    /// Number of sides of the current lattice at which the end is visible, for both directions.
    ends_seen: [usize; 2],
}

impl ChessboardFinder {
    /// A finder for boards of `columns x rows` inner corners (each 2 to 60; others are clamped) in frames of the given size.
    #[must_use]
    pub fn new(columns: usize, rows: usize, width_px: usize, height_px: usize) -> Self {
        let (columns, rows) =
            (columns.clamp(*SIDE.start(), *SIDE.end()), rows.clamp(*SIDE.start(), *SIDE.end()));
        let count = columns * rows;
        let limit = (2 * count + 150).max(400);
        let mut halves = Vec::new();
        let (mut width, mut height) = (width_px, height_px);
        while width > FIRST_WIDTH_PX && height > 60 {
            (width, height) = (width / 2, height / 2);
            halves.push((Vec::with_capacity(width * height), width, height));
        }
        let side = columns.max(rows) + 2 * ROOM as usize;
        Self {
            columns: columns as i16,
            rows: rows as i16,
            width: width_px,
            height: height_px,
            halves,
            detector: RingDetector::new(width_px.saturating_mul(height_px), limit),
            links: Links::new(limit),
            order: Vec::with_capacity(limit),
            placed: Vec::with_capacity(limit.max(side * side)),
            grid: vec![None; side * side],
            placements: Vec::with_capacity(4 * count),
            part: Board::unbounded(side, side),
            board: Board::new(columns, rows),
            predicted: Board::new(columns, rows),
            blur_px: BLUR_PX,
            left: 0,
            miss: None,
            ends_seen: [0; 2],
        }
    }

    /// Searches the whole frame: fills `found` with the detected corners, ids rising.
    ///
    /// # Errors
    /// The status that says why there is no board; [`Self::search_or_why`] tells more. `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Detection>) -> Result<(), TargetStatus> {
        self.miss = self.search_or_why(image, found).err();
        self.miss.map_or(Ok(()), |miss| Err(miss.into()))
    }

    /// Why the last [`Self::search`] found nothing; `None` where it found a board.
    pub(in crate::detect) fn miss(&self) -> Option<ChessboardMiss> {
        self.miss
    }

    /// As [`Self::search`].
    ///
    /// # Errors
    /// Why there is no board. `found` is then empty.
    pub fn search_or_why(
        &mut self,
        image: &ImageView<'_>,
        found: &mut Vec<Detection>,
    ) -> Result<(), ChessboardMiss> {
        found.clear();
        if (image.width(), image.height()) != (self.width, self.height) {
            return Err(ChessboardMiss::WrongSize);
        }
        self.left = MAX_LATTICES;
        let mut halves = std::mem::take(&mut self.halves);
        let result = self.search_levels(image, &mut halves);
        self.halves = halves;
        result?;
        self.report(found);
        Ok(())
    }

    /// Tracks the corners in windows about their predictions (ids rising): fills `found` with those that were detected. Returns whether they are enough
    /// for the board; `found` is empty when not. Predictions that may be off by more than 0.6 squares are not tracked.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &[PredictedPoint],
        found: &mut Vec<Detection>,
    ) -> bool {
        found.clear();
        self.predicted.clear(false);
        self.board.clear(false);
        for e in expected {
            if let Some((c, r)) = self.predicted.column_and_row(e.id) {
                self.predicted.put(c as i16, r as i16, e.px);
            }
        }
        let predictions = expected.iter().map(|e| Prediction { id: e.id, px: e.px, slack_px: e.slack_px });
        track::track(image, predictions, &self.predicted, &mut self.board, self.blur_px);
        if self.board.check() < 4 {
            return false;
        }
        self.report(found);
        true
    }

    /// Covariance `[xx, xy, yy]` of the position of each corner of the last frame, px^2, ids rising.
    pub fn covariances_px2(&self) -> impl Iterator<Item = (u32, [f64; 3])> {
        self.board.fitted().map(|(id, fit)| (id, fit.covariance_px2))
    }

    /// Blur of the board in the last frame with a board: standard deviation, the pixel's own included, px.
    #[must_use]
    pub fn blur_px(&self) -> f64 {
        self.blur_px
    }

    fn report(&mut self, found: &mut Vec<Detection>) {
        if let Some(blur) = self.board.blur_px() {
            self.blur_px = blur;
        }
        let places = self.board.all_steps().zip(self.board.unbent());
        for ((id, fit), ([a, b], px)) in self.board.fitted().zip(places) {
            let spread = (a * a.transpose() + b * b.transpose()) / 12.0;
            found.push(Detection {
                id,
                px,
                sd_px: corner_sd_px(fit),
                area_px2: (a.x * b.y - a.y * b.x).abs(),
                covariance_px2: [spread.m11, spread.m12, spread.m22],
                dark_level: fit.middle_level - fit.half_contrast.abs(),
                plate_level: fit.middle_level + fit.half_contrast.abs(),
                disturbance_px: 0.0,
            });
        }
    }

    /// Searches the image pyramid from its smallest level to the image itself, until a board is found.
    fn search_levels(
        &mut self,
        image: &ImageView<'_>,
        halves: &mut [(Vec<u8>, usize, usize)],
    ) -> Result<(), ChessboardMiss> {
        for i in 0..halves.len() {
            let (finer, rest) = halves.split_at_mut(i);
            let Some((out, ..)) = rest.first_mut() else { break };
            match finer.last() {
                None => halve(image, out),
                Some((pixels, width, height)) => match ImageView::new(pixels, *width, *height) {
                    Ok(view) => halve(&view, out),
                    Err(_) => break,
                },
            };
        }
        let mut why = ChessboardMiss::NoCorners;
        for (i, (pixels, width, height)) in halves.iter().enumerate().rev() {
            let Ok(view) = ImageView::new(pixels, *width, *height) else { continue };
            let scale = f64::from(2u32.pow(i as u32 + 1));
            match self.search_level(image, &view, scale) {
                Ok(()) => return Ok(()),
                Err(miss) => why = telling(why, miss),
            }
        }
        self.search_level(image, image, 1.0).map_err(|miss| match telling(why, miss) {
            ChessboardMiss::NoCorners if !has_contrast(image, MIN_RESPONSE) => ChessboardMiss::NoContrast,
            miss => miss,
        })
    }

    /// Searches one level, a pixel of which is `scale` pixels of the image.
    fn search_level(
        &mut self,
        image: &ImageView<'_>,
        level: &ImageView<'_>,
        scale: f64,
    ) -> Result<(), ChessboardMiss> {
        let corners = self.detector.find(level, MIN_RESPONSE);
        if corners.is_empty() {
            return Err(ChessboardMiss::NoCorners);
        }
        let count = usize::from(self.columns.unsigned_abs()) * usize::from(self.rows.unsigned_abs());
        let least = (count / MIN_PART).max(MIN_CORNERS).min(count);
        // short links are tried first: it takes less time, and squares are rarely larger
        for longest_px in [SHORT * level.width() as f32, f32::INFINITY] {
            self.links.find(level, corners, longest_px);
            self.order.clear();
            let sized = (0u16..).zip(self.links.components());
            let good =
                sized.filter(|(_, (n, against))| usize::from(*n) >= least && *against * CONTRADICTIONS <= *n);
            self.order.extend(good.map(|(i, (n, _))| (*n, i)));
            if !self.order.is_empty() {
                break;
            }
        }
        self.order.sort_unstable_by(|a, b| b.cmp(a));
        let mut why = ChessboardMiss::TooFewCorners;
        let order = std::mem::take(&mut self.order);
        let mut first: Option<usize> = None;
        for &(n, component) in &order {
            if self.left == 0 {
                why = ChessboardMiss::GivenUp;
                break;
            }
            self.left -= 1;
            if let Some(first) = first {
                if f64::from(n) < SECOND * first as f64 {
                    break;
                }
                self.links.component(component, &mut self.placed);
                if self.elsewhere(scale) && self.place(image, scale).is_ok() {
                    self.order = order;
                    return Err(ChessboardMiss::Several);
                }
                continue;
            }
            self.links.component(component, &mut self.placed);
            match self.place(image, scale) {
                Ok(placement) => {
                    self.board.clear(false);
                    let side = self.grid_side() as u32;
                    for (id, fit) in self.part.fitted() {
                        let [column, row] = placement.corner([(id % side) as i16, (id / side) as i16]);
                        self.board.take(column, row, fit);
                    }
                    let blur = self.part.blur_px().unwrap_or(BLUR_PX);
                    let fitted = self.board.fit(image, blur);
                    self.board.refit_small(image, blur);
                    let beyond = self.board.beyond(image);
                    let ends = fitted == count && beyond.iter().all(|side| *side == BoardSide::End);
                    if fitted < least {
                        why = telling(why, ChessboardMiss::TooFewCorners);
                    } else if beyond.contains(&BoardSide::More)
                        || self.board.goes_on_behind(image)
                        || (!ends && self.board.is_part_of_floor(self.detector.corners(), scale))
                    {
                        why = telling(why, ChessboardMiss::TooLarge);
                    } else if !beyond.contains(&BoardSide::End) || !self.is_bounded(fitted == count) {
                        // it may go on outside the image, or under what covers a part of it
                        why = telling(why, ChessboardMiss::NoBorder);
                    } else {
                        first = Some(usize::from(n));
                    }
                }
                Err(miss) => why = telling(why, miss),
            }
        }
        self.order = order;
        first.map(|_| ()).ok_or(why)
    }

    /// Whether the visible ends bound the board: one in each direction, or, where all of its corners are detected and the image's border
    /// cuts its squares, both in one direction. A tiled floor has as much only where it ends too, with all the rest hidden.
    fn is_bounded(&self, whole: bool) -> bool {
        self.ends_seen.iter().all(|n| *n > 0) || (whole && self.ends_seen.contains(&2))
    }

    /// Whether the current lattice lies outside of the board that was fitted.
    fn elsewhere(&self, scale: f64) -> bool {
        let mut sum = Vector2::zeros();
        for placed in &self.placed {
            sum += Vector2::from(placed.px.map(|p| (f64::from(p) + 0.5) * scale - 0.5));
        }
        let middle = sum / self.placed.len().max(1) as f64;
        // inside the outline when on the same side of all its edges
        let (c, r) = (f64::from(self.columns), f64::from(self.rows));
        let outline = [(-1.0, -1.0), (c, -1.0), (c, r), (-1.0, r)].map(|(x, y)| self.board.anywhere(x, y));
        let mut sides = (0, 0);
        for i in 0..4 {
            let (Some(Some(a)), Some(Some(b))) = (outline.get(i), outline.get((i + 1) % 4)) else {
                return true;
            };
            let (e, d) = (b - a, middle - a);
            *(if e.x * d.y - e.y * d.x > 0.0 { &mut sides.0 } else { &mut sides.1 }) += 1;
        }
        sides.0 != 4 && sides.1 != 4
    }

    /// The placement of the current lattice on the board. Fits its corners into [`Self::part`], whose lattice coordinates it refers to.
    fn place(&mut self, image: &ImageView<'_>, scale: f64) -> Result<BoardPlacement, ChessboardMiss> {
        let (low, high) = trimmed(&mut self.placed, self.columns, self.rows);
        let most = self.columns.max(self.rows);
        if high[0] - low[0] >= most || high[1] - low[1] >= most {
            return Err(ChessboardMiss::TooLarge);
        }
        let Some(any) = self.placed.first() else { return Err(ChessboardMiss::TooFewCorners) };
        let from = [low[0] - ROOM, low[1] - ROOM];
        let even_light = any.light == ((any.at[0] - from[0] + any.at[1] - from[1]) % 2 == 0);
        self.part.clear(even_light);
        for placed in &self.placed {
            let px = placed.px.map(|p| (f64::from(p) + 0.5) * scale - 0.5);
            self.part.put(placed.at[0] - from[0], placed.at[1] - from[1], px.into());
        }
        self.part.fit(image, if scale > 1.5 { BLUR_PX } else { 0.8 * BLUR_PX }); // 1 or 2 and more, since levels are halves
        // only what was fitted counts from here on
        let side = self.grid_side();
        self.placed.clear();
        for (id, fit) in self.part.fitted() {
            let at = [(id as usize % side) as i16, (id as usize / side) as i16];
            let px = [fit.px.x as f32, fit.px.y as f32];
            let contrast = 2.0 * fit.half_contrast.abs() as f32;
            self.placed.push(Placed { at, px, light: fit.half_contrast > 0.0, contrast });
        }
        let (low, high) = trimmed(&mut self.placed, self.columns, self.rows);
        if high[0] == low[0] || high[1] == low[1] {
            return Err(ChessboardMiss::TooFewCorners);
        }
        self.grid.fill(None);
        for placed in &self.placed {
            let at = placed.at[1] as usize * side + placed.at[0] as usize;
            if let Some(cell) = self.grid.get_mut(at) {
                *cell = Some(*placed);
            }
        }
        let mut seen = [BoardEnd::Unseen; 4];
        for (i, end) in (0u8..).zip(&mut seen) {
            let stops = border::stops(image, self.outer(low, high, i));
            *end = if stops { BoardEnd::Seen } else { border::end(image, self.outer(low, high, i)) };
        }
        self.ends_seen =
            [0, 2].map(|i| seen.iter().skip(i).take(2).filter(|e| **e != BoardEnd::Unseen).count());
        let mut extent = LatticeExtent { low, high, ends: seen.map(|e| e == BoardEnd::Seen), even_light };
        for axis in 0..2 {
            let span = high[axis] - low[axis] + 1;
            let both = seen[2 * axis] != BoardEnd::Unseen && seen[2 * axis + 1] != BoardEnd::Unseen;
            if both && (span == self.columns || span == self.rows) {
                (extent.ends[2 * axis], extent.ends[2 * axis + 1]) = (true, true);
            }
        }
        placements(&extent, self.columns, self.rows, &mut self.placements)?;
        let affine = Affine::of(&self.placed);
        let first = |p: &BoardPlacement| affine.corner_zero(p);
        self.placements
            .iter()
            .copied()
            .min_by(|a, b| first(a).total_cmp(&first(b)))
            .ok_or(ChessboardMiss::NoMatch)
    }

    fn grid_side(&self) -> usize {
        usize::from(self.columns.max(self.rows).unsigned_abs()) + 2 * ROOM as usize
    }

    /// The outer squares along a side of the lattice: 0 and 1 below and above in the first direction, 2 and 3 in the second.
    fn outer(&self, low: [i16; 2], high: [i16; 2], side: u8) -> impl Iterator<Item = Outer> {
        let across = usize::from(side / 2);
        let along = 1 - across;
        let (rim, inwards) = if side.is_multiple_of(2) { (low[across], 1) } else { (high[across], -1) };
        let row = self.grid_side() as i16;
        let cell = move |across_at: i16, along_at: i16| {
            let mut at = [0; 2];
            (at[across], at[along]) = (across_at, along_at);
            let at = at[1] * row + at[0];
            usize::try_from(at).ok().and_then(|at| self.grid.get(at).copied().flatten())
        };
        let px = |p: Placed| Vector2::from(p.px.map(f64::from));
        (low[along]..high[along]).filter_map(move |at| {
            let pair = |line: i16| Some([cell(line, at)?, cell(line, at + 1)?]);
            let both @ [a, _] = pair(rim)?;
            Some(Outer {
                rim: both.map(px),
                inner: pair(rim + inwards)?.map(px),
                third: pair(rim + 2 * inwards).map(|pair| pair.map(px)),
                light: a.light != side.is_multiple_of(2),
            })
        })
    }
}

#[cfg(test)]
mod tests;
