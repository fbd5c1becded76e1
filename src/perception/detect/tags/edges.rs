//! Sub-pixel corners of a tag and their covariance, as the intersections of its four sides.
//!
//! Each side of the black square is measured row by row (column by column where it is nearly horizontal). The sum of grey levels in a window
//! across the side gives the share of the window that is light, and so the position at which the edge crosses the row; the square shape of pixels and
//! a symmetric blur do not shift it. With the mean `mid` and the contrast `C` of paper and ink beside the window of half length `a`:
//!
//! ```text
//!  delta = -(sum I - 2 a mid) / (C g)       g: share of the contrast at the window's ends, 1 for little blur
//! ```
//! A straight line is fitted to the crossings of all rows, and the windows are centred on it, until it does not move. The covariance of the line
//! follows from the scatter of the crossings about it and of the levels, so that it holds for any noise.

use super::quad::{NormalFormLine, Quad, is_sound};
use super::shine::Inside;
use super::side::{SideFit, SideRow, SideScan, TagSide};
use crate::imaging::ImageView;
use nalgebra::Vector2;

/// Half length of a window across the edge, px, from which windows grow by 1.6 up to the greatest where blur asks for it, but never beyond half a
/// cell. Chosen by hand: at a blur of 1 px, the pixel's own included, 2.5 px hold 0.99 of the edge's step, and half of it would hold 0.79; the noise
/// of a row's crossing grows with the root of the window, so that the double is 1.4 times as noisy. 8 px hold 0.85 of a blur of 4 px.
const HALF_PX: f64 = 2.5;
const MIN_HALF_PX: f64 = 1.0;
const MAX_HALF_PX: f64 = 8.0;
/// Below this share of the contrast at the ends windows grow. Chosen by hand: a window of 2.5 px has it at a blur of 1.5 px. With half of it a
/// window of 2.5 px would stay up to a blur of about 2.5 px, where noise counts more than twice; the double exceeds 1, so that all windows would grow.
const ENOUGH_GAIN: f64 = 0.85;
/// Half length of a window under an unknown response, in deviations of the blur. A gamma bends an edge's step, so that it reaches further into the ink than into
/// the paper, and what lies beyond the window is no longer as much on both sides. Measured on 480 images of an own renderer with gammas of 1.8 and 2.2, tags of
/// 60 to 300 px: with none corners lie 0.003 to 0.007 px inward, with 2.5, 3 and 3.6 deviations 0.001, 0 and 0 px; their noise grows by 0, 6 and 20 %.
const BENT_BLURS: f64 = 2.5;
/// Rounds of moving the windows: growing by 1.6 takes the window from 2.5 px to 8 px in three, so that the fourth measures with the longest.
const ROUNDS: usize = 4;
/// A line that moves by less stands, px. Chosen by hand: what is left is what the gain is wrong by of it, and with 3 % of error that is the 0.0012 px
/// that no scatter shows ([`FLOOR_PX`](super::side::FLOOR_PX)); half costs a round more in some tags, the double leaves twice as much.
const STILL_PX: f64 = 0.04;
/// Rows of the first round, which brings the window near. Chosen by hand: the mean of 24 rows has a fifth of their scatter, of half as many 0.29 of
/// it, of twice as many 0.14 for twice the time of that round.
const FIRST_ROWS: usize = 24;
/// Standard deviation of an outline's point, px, for a side that could not be measured. Chosen by hand: between the 0.29 px of outlines through
/// whole pixels and the 0.75 px that their points may be off (`quad::OFF_PX`). A corner beside such a side is stated with 1.6 times as much,
/// and half and double scale that alone.
const ROUGH_PX: f64 = 0.4;
/// The common noise of all sides has the weight of so many rows when the scatter of one side is estimated. Chosen by hand: `n` rows determine a
/// variance with a relative deviation of (2 / n)^0.5, 0.4 for 12; half trusts the scatter of short sides more, the double evens out sides that
/// are really worse than the others.
const SHARED_ROWS: f64 = 12.0;

/// Width of a cell in deviations of the blur below which sides cannot be measured by themselves, since the neighbouring cells contribute to the window. At
/// three deviations, half of it, 1e-3 of a step is left.
pub(super) const SHARP_CELL_BLURS: f64 = 6.0;

/// What is assumed of the camera's response.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Believed {
    /// Levels are proportional to light: a growth is corrected only where it is more likely than none.
    Linear,
    /// The response is unknown: there is some growth.
    Bent,
}

/// Corners, and the covariance `[xx, xy, yy]` of each, px^2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Corners {
    pub(super) px: Quad,
    pub(super) covariance_px2: [[f64; 3]; 4],
    /// Blur as measured at the sides, px; 0 where it was not measurable.
    pub(super) blur_px: f64,
    /// Least width of a cell, in deviations of the blur; infinite without blur.
    pub(super) cell_blurs: f64,
    /// Variance of a pixel's level as the sides' scatter tells it, levels^2; 0 where no side was measurable.
    pub(super) noise_levels2: f64,
    /// Whether levels along a side do not differ as noise does, or a side could not be measured.
    pub(super) uneven: bool,
    /// How far what pulls the corners is beyond noise: 0 within it, from 1 on wholly in the covariance ([`super::pulls`]).
    pub(super) harm: f64,
}

impl Corners {
    /// The same corners with the square of what parts them from others, another measurement of the same, added to their covariance.
    pub(super) fn with_difference(mut self, others: &Self) -> Self {
        for ((covariance, px), other) in self.covariance_px2.iter_mut().zip(&self.px).zip(&others.px) {
            let d = px - other;
            let [xx, xy, yy] = covariance;
            (*xx, *xy, *yy) = (*xx + d.x * d.x, *xy + d.x * d.y, *yy + d.y * d.y);
        }
        self
    }

    /// The same corners with a variance of `(blurs * blur)^2` added to each coordinate.
    pub(super) fn doubted(mut self, blurs: f64) -> Self {
        let more = (blurs * self.blur_px).powi(2);
        for [xx, _, yy] in &mut self.covariance_px2 {
            (*xx, *yy) = (*xx + more, *yy + more);
        }
        self
    }
}

/// Measures the sides of tags. Owns its buffer.
#[derive(Debug, Clone)]
pub(super) struct EdgeMeter {
    rows: Vec<SideRow>,
    /// Most rows of a side.
    max_rows: usize,
}

impl EdgeMeter {
    /// For images of at most this size.
    pub(super) fn with_size(width: usize, height: usize) -> Self {
        let max_rows = width.max(height);
        Self { rows: Vec::with_capacity(max_rows), max_rows }
    }

    /// The corners of the black square near `quad` (px), whose sides have `cells` cells. `inside`: the cells inside each side, once they are decoded.
    /// `None` when the corners form no valid quadrilateral.
    pub(super) fn refine(
        &mut self,
        image: &ImageView<'_>,
        quad: &Quad,
        cells: u32,
        inside: Option<&[Inside; 4]>,
        believed: Believed,
    ) -> Option<Corners> {
        let mut sides = [TagSide::default(); 4];
        let mut uneven = false;
        for (i, side) in sides.iter_mut().enumerate() {
            let measured =
                self.side(image, quad, i, f64::from(cells), inside.and_then(|s| s.get(i)), believed);
            uneven |= measured.is_none_or(|(_, uneven)| uneven);
            *side = measured.map(|(side, _)| side).or_else(|| rough(quad, i))?;
        }
        let noise_levels2 = share_noise(&mut sides);
        let mut px = *quad;
        let mut covariance_px2 = [[0.0; 3]; 4];
        for (i, (corner, covariance)) in px.iter_mut().zip(&mut covariance_px2).enumerate() {
            let (before, after) = (sides.get((i + 3) % 4)?, sides.get(i)?);
            *corner = before.line().meet(&after.line())?;
            let (a, b) = (before.normal, after.normal);
            let det2 = a.perp(&b).powi(2);
            let (va, vb) = (before.variance_at(*corner), after.variance_at(*corner));
            // n_a . e = da, n_b . e = db
            *covariance = [
                (b.y * b.y * va + a.y * a.y * vb) / det2,
                -(b.x * b.y * va + a.x * a.y * vb) / det2,
                (b.x * b.x * va + a.x * a.x * vb) / det2,
            ];
        }
        let (blur_px, cell_blurs) = sharpness(&sides);
        let corners = Corners { px, covariance_px2, blur_px, cell_blurs, noise_levels2, uneven, harm: 0.0 };
        is_sound(&px).then_some(corners)
    }

    /// A side, and whether the levels along it do not differ as noise does.
    fn side(
        &mut self,
        image: &ImageView<'_>,
        quad: &Quad,
        i: usize,
        cells: f64,
        inside: Option<&Inside>,
        believed: Believed,
    ) -> Option<(TagSide, bool)> {
        let corner = |k: usize| quad.get((i + k) % 4).copied().unwrap_or_default();
        let (mut a, mut b) = (corner(0), corner(1));
        let length = (b - a).norm();
        // width of a cell across this side, at the narrower end of the tag
        let depth = (corner(3) - a)
            .perp(&((b - a) / length))
            .abs()
            .min((corner(2) - b).perp(&((b - a) / length)).abs());
        let cell = depth / cells;
        let max_half = (0.5 * cell).clamp(MIN_HALF_PX, MAX_HALF_PX);
        let mut half = HALF_PX.min(max_half);
        let neighbours = [(corner(3), corner(0)), (corner(1), corner(2))].map(|(p, q)| {
            let along = (q - p).normalize();
            let normal = Vector2::new(along.y, -along.x);
            NormalFormLine { normal, offset: normal.dot(&p) }
        });
        let mut blur = 0.0;
        let mut last: Option<SideFit> = None;
        for round in 0..ROUNDS {
            let along = (b - a) / (b - a).norm();
            // outward: the corners go clockwise on the screen
            let normal = Vector2::new(along.y, -along.x);
            let line = NormalFormLine { normal, offset: normal.dot(&a) };
            let scan = SideScan { image, line, half, cell, neighbours, length, blur, from: a, to: b, inside };
            let along_y = scan.read(&mut self.rows, if round == 0 { FIRST_ROWS } else { self.max_rows });
            let fit = scan.fit(along_y, &mut self.rows)?;
            let SideFit { side, gain, shift, blur: seen, .. } = fit;
            let sharper = seen - blur;
            blur = seen;
            let move_to = |p: Vector2<f64>| p - side.normal * (side.normal.dot(&p) - side.offset);
            (a, b) = (move_to(a), move_to(b));
            last = Some(fit);
            let bent = if believed == Believed::Bent { (BENT_BLURS * blur).min(max_half) } else { 0.0 };
            if half < bent {
                half = bent;
            } else if gain < ENOUGH_GAIN && half < max_half {
                half = (1.6 * half).min(max_half);
                // A blur that is a tenth of a pixel off moves the gain of windows that are long enough by about 3 % at most; chosen by
                // hand with `STILL_PX`: half costs rounds, the double leaves twice as much.
            } else if shift < STILL_PX && sharper < 0.1 && round > 0 {
                break;
            }
        }
        last.map(|fit| (fit.side, fit.uneven(&self.rows)))
    }
}

/// Root mean square blur of the sides, px, and the least width of a cell in deviations of the blur.
fn sharpness(sides: &[TagSide; 4]) -> (f64, f64) {
    let (mut sum, mut count, mut least) = (0.0, 0.0, f64::INFINITY);
    for side in sides.iter().filter(|s| s.blur > 0.0) {
        sum += side.blur * side.blur;
        count += 1.0;
        least = side.cell.min(least);
    }
    if count > 0.0 { ((sum / count).sqrt(), least / (sum / count).sqrt()) } else { (0.0, f64::INFINITY) }
}

/// Shrinks the variance of each side towards the noise that all sides have in common: few rows give a poor estimate of it.
/// Returns that noise, as the variance of a pixel's level.
fn share_noise(sides: &mut [TagSide; 4]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for side in sides.iter().filter(|s| s.per_noise > 0.0) {
        sum += (side.n - 2.0) * side.variance / side.per_noise;
        count += side.n - 2.0;
    }
    if count > 0.0 {
        for side in sides.iter_mut().filter(|s| s.per_noise > 0.0) {
            let (own, shared) = (side.n - 2.0, side.per_noise * sum / count);
            side.variance = (own * side.variance + SHARED_ROWS * shared) / (own + SHARED_ROWS);
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

/// The side of the outline, for one that cannot be measured because its margin is too narrow or occluded.
fn rough(quad: &Quad, i: usize) -> Option<TagSide> {
    let (a, b) = (*quad.get(i)?, *quad.get((i + 1) % 4)?);
    let along = (b - a).try_normalize(1e-9)?;
    let normal = Vector2::new(along.y, -along.x);
    let along_y = normal.x.abs() >= normal.y.abs();
    let (middle, length) =
        if along_y { (0.5 * (a.y + b.y), b.y - a.y) } else { (0.5 * (a.x + b.x), b.x - a.x) };
    // as if two points, a quarter of the side from its ends, had been measured
    let (n, ss) = (2.0, 0.125 * length * length);
    Some(TagSide {
        normal,
        offset: normal.dot(&a),
        along_y,
        middle,
        n,
        ss,
        variance: ROUGH_PX * ROUGH_PX,
        common: 0.0,
        per_noise: 0.0,
        blur: 0.0,
        cell: 0.0,
    })
}
