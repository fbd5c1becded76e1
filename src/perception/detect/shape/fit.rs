//! Fit of the map from the outline to the image, by the offsets of the edges along the whole outline.
//!
//! ```text
//! map ─► pieces of the outline in the image ─► offset of the edge from each ─► Gauss-Newton over the map's parameters ─► map, again
//! first the strongest step within reach, then the levels about each piece
//! ```
//! Offsets are pixels of the distorted image along each piece's normal; the derivatives contain the lens. Outliers
//! are rejected by Tukey's weights. The weights come from the noise of the pixels; the covariance is scaled by the residuals of the
//! offsets.

use super::chance::{Evidence, surplus};
use super::edge::{EdgeEstimate, MAX_PIXELS, Piece};
use super::outline::{OutlinePart, ShapeOutline};
use super::warp::Warp;
use crate::camera_model::CameraModel;
use crate::imaging::ImageView;
use crate::linalg::Ldlt;
use nalgebra::{SMatrix, SVector, Vector2};

/// Most pieces of an outline. Chosen by hand: [`PIECES`] and two more on each of 150 sides; further ones are not used.
const MAX_PIECES: usize = 512;
/// A piece's length, px, and so many of them at most on an outline; longer pieces where there would be more. Chosen by hand: the offset of 10 px
/// of an edge is known to a hundredth of a pixel; shorter ones make more of the same equations, on longer ones a curve is no parabola.
const PIECE_PX: f64 = 10.0;
const PIECES: f64 = 200.0;
/// Shortest piece, px. Chosen by hand: it has sixteen pixels, eight where there is little room beside it, to which three numbers are fitted; half
/// has too few, twice loses the short sides of small shapes.
const SHORTEST_PX: f64 = 2.5;
/// Blur with the pixel in it: before anything is known, and its bounds, px. Derived: the pixel alone has `1 / sqrt 12` = 0.29, with a usual lens
/// nearly one; the upper bound was chosen by hand, where windows would be 22 px wide.
const BLUR_PX: f64 = 0.9;
const BLURS_PX: (f64, f64) = (0.3, 4.0);
/// Turns at most, and how little the outline moves in the last one, px. Chosen by hand: a tenth of what corners are known to; Gauss-Newton is
/// there in a few turns, and the bound is for what sways.
const MAX_TURNS: usize = 8;
const SETTLED_PX: f64 = 2e-3;
/// Standard deviations from which on an offset has no weight. Derived: Tukey's weights have 95 % of the efficiency of least squares at 4.7.
const CUT: f64 = 5.0;
/// Least step at an edge, levels. Chosen by hand: six deviations of the noise of a usual camera, 2 levels; half lets clutter be edges.
const MIN_STEP: f64 = 12.0;
/// Variance of the rounding to whole levels. Derived: of a number uniform in a unit.
const ROUNDING: f64 = 1.0 / 12.0;
/// After three turns a fit with a smaller share of the outline, or with larger offsets (px, and share of the length), is given up: half
/// and twice of what is accepted in the end. Chosen by hand: the remaining iterations improve a fit by less; nearer to 1 honest fits are given up, farther
/// only costs time.
const HOPELESS_SHARE: f64 = 0.5 * super::SEEN_TRACKED;
const HOPELESS_PX: f64 = 2.0 * super::OFF_PX;
const HOPELESS: f64 = 2.0 * super::OFF;
/// What a search for a piece's step costs, in pixels of a fit. Chosen by hand from what it does: three lines of some forty places, each half of
/// the work of such a pixel. Half or twice changes when a search is given up, nothing else.
const SEARCHED: u64 = 60;
/// A piece counts with its own noise where that exceeds the usual one so many times. Chosen by hand: of 60 pixels a variance is known to a fifth,
/// so that four times is no chance; nearer to 1 each piece would weigh itself by chance.
const NOISIER: f64 = 4.0;

/// A fitted map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fitted<const N: usize, W> {
    pub(super) warp: W,
    /// Covariance of the parameters.
    pub(super) covariance: SMatrix<f64, N, N>,
    /// Share of the outline's length in the image at which an edge was found.
    pub(super) share: f64,
    /// Root mean square of the offsets of the used pieces, px.
    pub(super) rms_px: f64,
    /// Mean of the squared offsets over their variances.
    pub(super) chi2: f64,
    /// Mean levels inside and outside.
    pub(super) levels: [f64; 2],
    /// Deviation of the edge's profile, px.
    pub(super) blur_px: f64,
    /// Length in the image, px.
    pub(super) length_px: f64,
    /// Evidence against an accidental fit.
    pub(super) evidence: Evidence,
}

/// The fit with its buffers, which are reused.
#[derive(Debug, Clone)]
pub(super) struct Fitter {
    pieces: Vec<Piece>,
    edges: Vec<Option<(EdgeEstimate, f64)>>,
    pixels: Vec<[f64; 4]>,
    sorted: Vec<f64>,
    /// Normalized offsets at the start of an estimate.
    rest: Vec<f64>,
    length_px: f64,
    /// Pieces of each part that count.
    told: Vec<u32>,
    /// Number of pixels that were processed since it was set to 0.
    pub(super) work: u64,
}

impl Fitter {
    pub(super) fn new() -> Self {
        Self {
            pieces: Vec::with_capacity(MAX_PIECES),
            edges: Vec::with_capacity(MAX_PIECES),
            pixels: Vec::with_capacity(MAX_PIXELS),
            sorted: Vec::with_capacity(MAX_PIECES),
            rest: Vec::with_capacity(MAX_PIECES),
            length_px: 0.0,
            told: Vec::with_capacity(MAX_PIECES),
            work: 0,
        }
    }

    /// The map near `start`, whose edges lie within `reach_px` of its own; `rise` is 1 where the outside is lighter, else -1.
    pub(super) fn fit<const N: usize, W: Warp<N>>(
        &mut self,
        image: &ImageView<'_>,
        camera: &CameraModel,
        outline: &ShapeOutline,
        start: W,
        reach_px: f64,
        rise: f64,
    ) -> Option<Fitted<N, W>> {
        let mut warp = start;
        for share in [1.0, 0.5, 0.25] {
            self.lay(camera, outline, &warp, BLUR_PX);
            warp = self.approach(image, camera, outline, warp, (share * reach_px).max(2.0), rise)?;
        }
        let mut blur_px = BLUR_PX;
        let mut fitted = None;
        for turn in 0..MAX_TURNS {
            self.lay(camera, outline, &warp, blur_px);
            let (next, moved_px) = self.estimate(image, camera, outline, warp, &mut blur_px, rise)?;
            warp = next.warp;
            fitted = Some(next);
            if turn > 1 && hopeless(&next) {
                return None;
            }
            if turn > 1 && moved_px < SETTLED_PX {
                break;
            }
        }
        fitted
    }

    /// Divides the outline into pieces by their length in the image.
    fn lay<const N: usize, W: Warp<N>>(
        &mut self,
        camera: &CameraModel,
        outline: &ShapeOutline,
        warp: &W,
        blur_px: f64,
    ) {
        self.pieces.clear();
        let px = |s: f64| camera.pixel_of(&warp.at(&outline.at(s).0));
        let length_px = |part: &OutlinePart, steps: u32| {
            let at = |i: u32| px(part.from + (part.to - part.from) * f64::from(i) / f64::from(steps));
            (0..steps).map(|i| (at(i + 1) - at(i)).norm()).sum::<f64>()
        };
        let steps = |part: &OutlinePart| if part.closed { 48 } else { 4 };
        self.length_px = outline.parts.iter().map(|p| length_px(p, steps(p))).sum();
        let target_px = PIECE_PX.max(self.length_px / PIECES);
        // the blur rounds what lies within this of a corner
        let corner_px = 2.5 * blur_px;
        let width_px = (2.5 * blur_px + 1.0).max(2.0);
        for (place, part) in outline.parts.iter().enumerate() {
            let whole_px = length_px(part, steps(part));
            let span = part.to - part.from;
            // otherwise it is impossible for an image, since it must pass through the camera's plane
            if !(whole_px > 0.0 && whole_px < 1e6) {
                continue;
            }
            let (from, to, free_px) = if part.closed {
                (part.from, part.to, whole_px)
            } else {
                // perspective: each end by its own scale
                let tenth = 0.1 * span;
                let scale = |a: f64, b: f64| (px(b) - px(a)).norm() / tenth;
                let first = corner_px / scale(part.from, part.from + tenth);
                let last = corner_px / scale(part.to - tenth, part.to);
                (part.from + first, part.to - last, whole_px - 2.0 * corner_px)
            };
            if !(to > from && free_px >= SHORTEST_PX) {
                continue;
            }
            // a side's direction takes two pieces
            let least = if free_px >= 2.0 * SHORTEST_PX { 2.0 } else { 1.0 };
            let count = (free_px / target_px).round().max(least) as usize;
            for k in 0..count {
                let at = |i: usize| from + (to - from) * i as f64 / count as f64;
                if self.pieces.len() < MAX_PIECES {
                    let piece = piece(camera, outline, warp, (at(k), at(k + 1)), place, width_px);
                    self.pieces.extend(piece);
                }
            }
        }
    }

    /// One step towards the strongest edges.
    fn approach<const N: usize, W: Warp<N>>(
        &mut self,
        image: &ImageView<'_>,
        camera: &CameraModel,
        outline: &ShapeOutline,
        warp: W,
        reach_px: f64,
        rise: f64,
    ) -> Option<W> {
        self.edges.clear();
        for piece in &self.pieces {
            let offset = piece.search(image, reach_px, rise, MIN_STEP);
            self.work += SEARCHED;
            self.edges.push(offset.map(|offset_px| {
                let edge = EdgeEstimate {
                    offset_px,
                    unit_variance: 0.0,
                    levels: [0.0; 2],
                    noise: 0.0,
                    blur: [0.0; 2],
                };
                // half a pixel, and less for short pieces
                (edge, 0.25 * PIECE_PX / piece.length_px.max(1.0))
            }));
        }
        let step = self.solve(camera, outline, &warp)?;
        let next = W::of(warp.parameters() + step.step);
        next.is_plausible(1.0).then_some(next)
    }

    /// One Gauss-Newton step by the fits of all pieces, with its statistics. Returns the displacement of the outline, px.
    fn estimate<const N: usize, W: Warp<N>>(
        &mut self,
        image: &ImageView<'_>,
        camera: &CameraModel,
        outline: &ShapeOutline,
        warp: W,
        blur_px: &mut f64,
        rise: f64,
    ) -> Option<(Fitted<N, W>, f64)> {
        self.edges.clear();
        self.sorted.clear();
        let blur = *blur_px;
        for piece in &self.pieces {
            let edge = piece.fit(image, blur, &mut self.pixels).filter(|edge| {
                let step = rise * (edge.levels[1] - edge.levels[0]);
                // further away the pixels of the window would not show the whole step
                step >= MIN_STEP && edge.offset_px.abs() < 3.0 * blur + 0.5
            });
            self.work += self.pixels.len() as u64;
            self.sorted.extend(edge.map(|edge| edge.noise));
            self.edges.push(edge.map(|edge| (edge, 0.0)));
        }
        let usual = median(&mut self.sorted)?.max(ROUNDING);
        let (mut curvature, mut slope) = (0.0, 0.0);
        for (edge, variance) in self.edges.iter_mut().flatten() {
            let noise = if edge.noise > NOISIER * usual { edge.noise } else { usual };
            *variance = noise * edge.unit_variance;
            if noise == usual {
                curvature += edge.blur[0];
                slope += edge.blur[1];
            }
        }
        let Solved { step, normal, used, squares, chi2, weights } = self.solve(camera, outline, &warp)?;
        let next = W::of(warp.parameters() + step);
        if !next.is_plausible(1.0) {
            return None;
        }
        if curvature > 0.0 {
            let most = 0.5 * blur;
            *blur_px = (blur + (slope / curvature).clamp(-most, most)).clamp(BLURS_PX.0, BLURS_PX.1);
        }
        let (mut edge_px, mut all_px, mut moved_px) = (0.0, 0.0, 0.0f64);
        let mut levels = [0.0; 2];
        self.told.clear();
        self.told.resize(outline.parts.len(), 0);
        let mut variance_px2 = 0.0;
        for ((piece, edge), weight) in self.pieces.iter().zip(&self.edges).zip(&self.rest) {
            all_px += piece.length_px;
            if let Some((edge, variance)) = edge.filter(|_| *weight > 0.0) {
                edge_px += piece.length_px;
                variance_px2 += variance / used;
                if let Some(count) = self.told.get_mut(piece.part) {
                    *count += 1;
                }
                levels = [0, 1].map(|i| levels[i] + piece.length_px * edge.levels[i]);
            }
            let u = outline.at(piece.arc).0;
            moved_px = moved_px.max((camera.pixel_of(&next.at(&u)) - piece.middle).norm());
        }
        let free = used - N as f64;
        // few offsets do not determine their own deviation: a prior counts as so many more with the stated one. Chosen by hand, as many as the map has parameters
        const PRIOR: f64 = 8.0;
        // mean weights below a tenth would be of offsets that are all but left out
        let scale = (chi2 + PRIOR) / (free.max(0.0) + PRIOR) / weights.max(0.1);
        let inverse = SMatrix::<f64, N, N>::from(Ldlt::of(&normal)?.inverse());
        let classes = outline.parts.iter().map(|part| part.class);
        let (numbers, surplus) = surplus(self.told.iter().copied().zip(classes), N);
        let fitted = Fitted {
            warp: next,
            covariance: inverse * scale,
            share: edge_px / all_px.max(f64::MIN_POSITIVE),
            rms_px: (squares / used.max(1.0)).sqrt(),
            chi2: chi2 / free.max(1.0),
            levels: levels.map(|sum| sum / edge_px.max(f64::MIN_POSITIVE)),
            blur_px: blur,
            length_px: self.length_px,
            evidence: Evidence::new(surplus, numbers, used, chi2, variance_px2),
        };
        Some((fitted, moved_px))
    }

    /// Gauss-Newton step for the offsets, with weights from the residuals of the step before. Leaves the weights in `rest`.
    fn solve<const N: usize, W: Warp<N>>(
        &mut self,
        camera: &CameraModel,
        outline: &ShapeOutline,
        warp: &W,
    ) -> Option<Solved<N>> {
        self.rest.clear();
        self.rest.resize(self.edges.len(), 1.0);
        let mut solved = None;
        for turn in 0..5 {
            let (mut normal, mut right) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
            for ((piece, edge), weight) in self.pieces.iter().zip(&self.edges).zip(&self.rest) {
                let Some((edge, variance)) = edge else { continue };
                let row = derivative(camera, outline, warp, piece);
                let w = weight / variance;
                normal += row * row.transpose() * w;
                right += row * (edge.offset_px * w);
            }
            let step = SVector::<f64, N>::from(Ldlt::of(&normal)?.solve(&right.data.0[0]));
            // what is left, over its deviation
            self.sorted.clear();
            let (mut used, mut squares, mut chi2, mut weights) = (0.0, 0.0, 0.0, 0.0);
            for (i, (piece, edge)) in self.pieces.iter().zip(&self.edges).enumerate() {
                let Some(slot) = self.rest.get_mut(i) else { break };
                let Some((edge, variance)) = edge else {
                    *slot = 0.0;
                    continue;
                };
                let left = edge.offset_px - derivative(camera, outline, warp, piece).dot(&step);
                if *slot > 0.0 {
                    used += 1.0;
                    squares += left * left;
                    chi2 += *slot * left * left / variance;
                    weights += *slot;
                }
                *slot = left.abs() / variance.sqrt();
                self.sorted.push(*slot);
            }
            let spread = (1.4826 * median(&mut self.sorted)?).max(1.0);
            let weight = |z: f64| {
                let share = z / (CUT * spread);
                if share < 1.0 { (1.0 - share * share).powi(2) } else { 0.0 }
            };
            for (slot, edge) in self.rest.iter_mut().zip(&self.edges) {
                *slot = if edge.is_some() { weight(*slot) } else { 0.0 };
            }
            let weights = weights / f64::max(used, 1.0);
            if turn > 0 {
                solved = Some(Solved { step, normal, used, squares, chi2, weights });
            }
        }
        solved
    }
}

/// Whether further iterations, which move edges by hundredths of a pixel, cannot make a fit acceptable.
fn hopeless<const N: usize, W>(fitted: &Fitted<N, W>) -> bool {
    fitted.share < HOPELESS_SHARE || fitted.rms_px > HOPELESS_PX + HOPELESS * fitted.length_px
}

struct Solved<const N: usize> {
    step: SVector<f64, N>,
    normal: SMatrix<f64, N, N>,
    /// Offsets that count, their sum of squares, px^2, and over their variances, and the mean of their weights.
    used: f64,
    squares: f64,
    chi2: f64,
    weights: f64,
}

/// Derivative of the offset of a piece by the map's parameters.
fn derivative<const N: usize, W: Warp<N>>(
    camera: &CameraModel,
    outline: &ShapeOutline,
    warp: &W,
    piece: &Piece,
) -> SVector<f64, N> {
    let u = outline.at(piece.arc).0;
    let lens = camera.pixel_jacobian(&warp.at(&u));
    (piece.outward.transpose() * lens * warp.derivative(&u)).transpose()
}

/// A piece of the outline between two arc lengths; `None` where it has no extent, or no room beside it.
fn piece<const N: usize, W: Warp<N>>(
    camera: &CameraModel,
    outline: &ShapeOutline,
    warp: &W,
    (from, to): (f64, f64),
    part: usize,
    width_px: f64,
) -> Option<Piece> {
    let px = |u: &Vector2<f64>| camera.pixel_of(&warp.at(u));
    let arc = 0.5 * (from + to);
    let (u, direction) = outline.at(arc);
    let (a, b, middle) = (px(&outline.at(from).0), px(&outline.at(to).0), px(&u));
    let chord = b - a;
    let length_px = chord.norm();
    // a direction needs a pixel; no piece of any image is longer than the other
    if !(length_px > 1.0 && length_px < 1e4) {
        return None;
    }
    let along = chord / length_px;
    let outward = Vector2::new(along.y, -along.x);
    let small = 1e-3;
    let beside = px(&(u + Vector2::new(direction.y, -direction.x) * small));
    let scale = (beside - middle).dot(&outward) / small;
    let room_px = outline.room(from, to).map(|room| room * scale.max(0.0));
    let width_px = room_px.map(|room| width_px.min(0.5 * room));
    // chosen by hand: one pixel beside the edge on either side, at any angle; with less a level would be the blur's
    (width_px[0] > 1.2 && width_px[1] > 1.2).then_some(Piece {
        arc,
        part,
        middle,
        along,
        outward,
        length_px,
        sag_px: (middle - 0.5 * (a + b)).dot(&outward),
        width_px,
        room_px,
    })
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
