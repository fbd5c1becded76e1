//! Corners of a small, blurred or steep tag, by fitting a model of its whole image ([`super::whole_model`]) to the pixels.
//!
//! Where a cell is only a few deviations of the blur wide, no side can be measured by itself, because neighbouring cells contribute to it. But the decoded
//! tag is known completely, and so is its image up to 19 parameters (20 with a gamma): homography, blur, levels, illumination and ground. They
//! are fitted by Gauss-Newton; the noise is estimated from the residuals.

use super::decode::Decoded;
use super::edges::{Believed, Corners};
use super::plane_map::PlaneMap;
use super::pulls::LastStep;
use super::quad::{Quad, is_sound};
use super::side::FLOOR_PX;
use super::whole_model::{
    BLUR, COLUMNS, CONTRAST, COUNT, GAMMA, GROUND, INK, LIGHT, RATIO, RowProducts, TagImage, TagJacobian,
    TagModel, TagPixels, UNKNOWNS, accumulate, field,
};
use crate::imaging::ImageView;
use crate::linalg::{Eight, Ldlt};
use nalgebra::Vector2;

/// Pixels up to so many cells outside of the black square. Chosen by hand: more than half of the margin, which is one cell wide; half would give up
/// much of the outer edge, with the double pixels would lie beyond the margin, where the ground need not be even.
const AROUND_CELLS: f64 = 0.6;
/// Of more pixels than these only some are taken, evenly: a large tag is blurred where it is fitted as a whole, and is known well.
/// Chosen by hand: time is proportional to it and errors fall with its root, so that half costs 1.4 times the error and the double twice the time.
const ENOUGH_PIXELS: f64 = 1200.0;
/// Room for pixels, in eights; the outline of a tag holds a few more than its area says. 2048 pixels are 1200 and what an outline may add; an outline
/// that would hold more is not fitted.
const BLOCKS: usize = 256;
/// Most steps. Chosen by hand: steps converge as squares, so that from half a cell three or four are enough; a tag that needs more does not look as
/// it should. Half gives blurred tags up, the double only takes time for things that are no tags.
const STEPS: usize = 6;
/// Most steps where paper is clipped. Contrast, blur and gamma then begin far off and take 6 to 11 steps to come along a valley (measured on paper at 262 to
/// 600 levels). Half gives a third of such tags up, the double only takes time for things that are no tags.
const CLIPPED_STEPS: usize = 20;
/// A fit of clipped paper has come to rest where the variance of the residuals falls by less than a twentieth in a step: along that valley corners move little although residuals are ten
/// times those at its end. Chosen by hand: steps near the end halve what is left; half and double cost or save a step.
const SETTLED: f64 = 0.95;
/// And where corners move by less than this in it, px. Chosen by hand: a sixth of the errors of such corners.
const CLIPPED_LEFT_PX: f64 = 0.003;
/// Contrasts from which fits of clipped paper start, in what is seen of it. Chosen by hand: from the first all fits arrive with paper up to 600 levels, with the second also those with 850,
/// of which most were given up; half and double of it still would.
const CLIPPED_STARTS: [f64; 2] = [1.0, 2.5];
/// Steps converge as squares: what is left of one is about its square over the blur, and may be so much, px. Chosen by hand: a sixth of the 0.012 px
/// that the best kind of `corners_lie_where_they_are_and_as_surely_as_stated` is allowed; half and double cost or save a step in some tags.
const LEFT_PX: f64 = 0.002;
/// Corners that move farther were not those of this tag, cells. Chosen by hand: beyond half a cell an edge is nearer to the next one; half would refuse
/// blurred tags whose sides gave poor corners, the double allows a fit that has slipped by a cell.
const LOST_CELLS: f64 = 0.7;
/// Residuals beyond so many deviations of those before do not come from the tag: noise has 7e-6 of them, less than one in 100 tags of 1200 pixels, as
/// the normal distribution has it. Half would leave out 2.4 % of the good ones and understate the noise, the double keeps glints.
const GATE: f64 = 4.5;
/// Noise that is assumed of clipped pixels before the first step, levels. Chosen by hand, more than cameras have: such pixels pull softly while the model
/// is off. Half and double only change the way of the fit.
const START_NOISE: f64 = 8.0;
/// Least variance of the blur, a pixel's own square (1/12 px^2) and little more, and the most correlation of both directions. Chosen by hand, so that
/// the covariance stays definite: at a correlation of 1 a blur has no width, and half of 0.9 would not hold a
/// motion of 4 px at a blur of 0.7 px, 0.54, which `stated_covariances_hold_at_all_sizes_and_blurs` has.
const MIN_BLUR_PX2: f64 = 0.09;
const MAX_ASLANT: f64 = 0.9;
/// Least contrast, grey levels: half of what a tag must show to be read (`decode::MIN_CONTRAST`), chosen by hand. Less means that the fit has
/// diverged; half or double refuse such fits later or sooner.
const MIN_CONTRAST: f64 = 5.0;
/// Variance of rounding to whole grey levels, the least that is assumed of residuals.
const ROUNDING: f64 = 1.0 / 12.0;
/// Standard deviation of corners by a blur that is not Gaussian, as share of the blur, for pure motion blur and narrow cells; and its exponential
/// fall with the cells' width in blurs (measured on images of tags that moved by up to 4 px).
const SMEAR_DOUBT: f64 = 0.42;
const SMEAR_FALL: f64 = 1.75;

/// Prior of an unknown gamma: cameras have 1 (industrial ones) or 2.2, as IEC 61966-2-1 has it (webcams, files); mean and standard deviation
/// of both logarithms. Estimates keep within those of 0.5 and 4, because no camera has others.
const USUAL_LOG_GAMMA: f64 = 0.4;
const LOG_GAMMA_SD: f64 = 0.4;
const LOG_GAMMAS: [f64; 2] = [-0.7, 1.4];
/// The logarithm of the light of paper over that of ink. Up to 30 it follows from their levels and the gamma, as for a camera that subtracts no black level; where
/// these tell more, which printed ink does not have, it is fitted, with 30 and a factor of e either way as prior. Chosen by hand: printed ink
/// reflects 3 to 5 % of what paper does; drawn tags have any. Estimates keep within those of 3 and 1000.
const PRINTED_LOG_RATIO: f64 = 3.4;
const LOG_RATIO_SD: f64 = 1.0;
const LOG_RATIOS: [f64; 2] = [1.1, 6.9];

/// Fits tags as a whole. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct WholeMeter {
    pixels: Vec<TagPixels>,
    /// Their derivatives.
    rows: Box<[TagJacobian]>,
}

/// A Gauss-Newton step and its result.
struct FitStep {
    by: [f64; UNKNOWNS],
    /// Variance of the residuals after it, levels^2.
    variance: f64,
    factors: Ldlt<UNKNOWNS>,
}

impl WholeMeter {
    pub(super) fn new() -> Self {
        Self { pixels: Vec::with_capacity(BLOCKS), rows: vec![[Eight::ZERO; COLUMNS]; BLOCKS].into() }
    }

    /// Refines the corners of a tag, starting from those of its sides, and their covariance; `None` where the fit does not converge or the residuals
    /// contradict the model. An unknown gamma is fitted too.
    pub(super) fn refine(
        &mut self,
        image: &ImageView<'_>,
        from: &Corners,
        decoded: &Decoded,
        believed: Believed,
    ) -> Option<Corners> {
        // motion blur may lead to a far too small blur at the sides, from which the fit does not converge, and so may clipping
        let overs: &[f64] = if decoded.clipped { &CLIPPED_STARTS } else { &[1.0] };
        let mut starts = overs.iter().flat_map(|over| [1.0, 2.0].map(|more| (more, over)));
        starts
            .find_map(|(more, over)| self.fit(image, from, decoded, believed, (more * blur_of(from), *over)))
    }

    /// The same, starting from the variance `around` of the blur, px^2, and `over` times the contrast that is seen.
    fn fit(
        &mut self,
        image: &ImageView<'_>,
        from: &Corners,
        decoded: &Decoded,
        believed: Believed,
        (around, over): (f64, f64),
    ) -> Option<Corners> {
        let [a, b, c, d] = from.px;
        let origin = (0.25 * (a + b + c + d)).map(f64::round);
        let radius = from.px.iter().map(|p| (p - origin).norm()).fold(0.0, f64::max);
        let Decoded { pattern, dark_level: ink, light_level: paper, .. } = decoded;
        let cells = pattern.cells as f64;
        let max_px = LOST_CELLS * radius * std::f64::consts::SQRT_2 / cells;
        let mut quad = from.px;
        let mut tag_image = TagImage {
            back: PlaneMap::of_square(&quad, cells)?.inverse()?,
            origin,
            radius,
            blur: [around, 0.0, around],
            ink: *ink,
            contrast: over * (paper - ink),
            light: [0.0; 2],
            ground: [0.0; 4],
            clipped_noise: None,
            log_gamma: (believed == Believed::Bent).then_some(USUAL_LOG_GAMMA),
            log_ratio: None,
        };
        let mut variance = f64::INFINITY;
        // the same pixels in all steps, because the fit might oscillate otherwise
        let every = (area(&around_tag(&quad, cells)?) / ENOUGH_PIXELS).ceil().clamp(1.0, 1e6) as usize;
        let max_steps = if decoded.clipped { CLIPPED_STEPS } else { STEPS };
        for _ in 0..max_steps {
            if decoded.clipped {
                // before the first step no noise is known
                let noise = if variance.is_finite() { variance.sqrt() } else { START_NOISE };
                tag_image.clipped_noise = Some(noise);
            }
            self.load(image, &around_tag(&quad, cells)?, origin, every)?;
            let model = TagModel::new(&tag_image, pattern, &quad, GATE * GATE * variance)?;
            let mut sums = RowProducts { products: [[0.0; COLUMNS]; COLUMNS], count: 0.0 };
            accumulate(&model, &self.pixels, &mut self.rows, &mut sums);
            let solved = solve(&sums, &tag_image, variance)?;
            let settled = solved.variance > SETTLED * variance;
            variance = solved.variance;
            let fields = quad.map(|p| field((p - origin) / radius));
            let moved = quad_moved(&mut quad, &fields, &solved.by);
            if !(moved < max_px) || !is_sound(&quad) || !add(&mut tag_image, &solved.by) {
                return None;
            }
            tag_image.back = PlaneMap::of_square(&quad, cells)?.inverse()?;
            let at_rest = if decoded.clipped {
                settled && moved < CLIPPED_LEFT_PX
            } else {
                moved * moved < LEFT_PX * around.sqrt()
            };
            if at_rest {
                let inverse = solved.factors.inverse();
                let noise = variance.max(ROUNDING);
                let doubt = FLOOR_PX.powi(2) + smear(&tag_image.blur, from.cell_blurs * from.blur_px);
                let mut covariance_px2 = fields.map(|field| covariance(&field, &inverse, noise, doubt));
                let last = LastStep {
                    pixels: &self.pixels,
                    rows: &self.rows,
                    by: &solved.by,
                    inverse: &inverse,
                    back: &tag_image.back,
                    cells,
                    origin,
                };
                let harm = last.add_pulls(&fields, &mut covariance_px2);
                return Some(Corners { px: quad, covariance_px2, harm, ..*from });
            }
        }
        None
    }

    /// Loads every `every`-th pixel within an outline.
    fn load(
        &mut self,
        image: &ImageView<'_>,
        outline: &Quad,
        origin: Vector2<f64>,
        every: usize,
    ) -> Option<()> {
        let top = outline.iter().map(|p| p.y).fold(f64::INFINITY, f64::min).ceil().max(0.0) as usize;
        let bottom = outline.iter().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max);
        let bottom = bottom.floor().min(image.height() as f64 - 1.0) as usize;
        // rows begin with different offsets, so that columns are sampled evenly
        let shift = (0.38 * every as f64).round().max(1.0) as usize;
        self.pixels.clear();
        let (mut block, mut lane) = (TagPixels::NONE, 0);
        for y in top..=bottom {
            let (from, to) = across(outline, y as f64);
            let to = to.floor().min(image.width() as f64 - 1.0);
            let from = from.ceil().max(0.0);
            if !(to >= from) {
                continue;
            }
            let row = image.row(y).get(from as usize..=to as usize).unwrap_or(&[]);
            let begin = (from as usize + y * shift) % every;
            let begin = (every - begin) % every;
            let (mut x, y) = ((from + begin as f64 - origin.x) as f32, (y as f64 - origin.y) as f32);
            for &level in row.iter().skip(begin).step_by(every) {
                for (eight, value) in [
                    (&mut block.x, x),
                    (&mut block.y, y),
                    (&mut block.level, f32::from(level)),
                    (&mut block.weight, 1.0),
                ] {
                    if let Some(slot) = eight.0.get_mut(lane) {
                        *slot = value;
                    }
                }
                x += every as f32;
                lane += 1;
                if lane == 8 {
                    if self.pixels.len() + 1 >= BLOCKS {
                        return None;
                    }
                    self.pixels.push(block);
                    (block, lane) = (TagPixels::NONE, 0);
                }
            }
        }
        self.pixels.push(block);
        Some(())
    }
}

/// Variance of the blur as measured at the sides, px^2.
fn blur_of(from: &Corners) -> f64 {
    from.blur_px.powi(2).max(2.0 * MIN_BLUR_PX2)
}

/// The corners of the black square with some margin, px.
fn around_tag(quad: &Quad, cells: f64) -> Option<Quad> {
    let map = PlaneMap::of_square(quad, cells)?;
    let (low, high) = (-AROUND_CELLS, cells + AROUND_CELLS);
    let outline =
        [(low, low), (high, low), (high, high), (low, high)].map(|(c, r)| map.at(Vector2::new(c, r)));
    is_sound(&outline).then_some(outline)
}

fn area(quad: &Quad) -> f64 {
    let [a, b, c, d] = *quad;
    0.5 * (c - a).perp(&(d - b)).abs()
}

/// The range of x, px, in which row `y` lies within a convex quadrilateral.
fn across(outline: &Quad, y: f64) -> (f64, f64) {
    let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
    let [a, b, c, d] = *outline;
    for (p, q) in [(a, b), (b, c), (c, d), (d, a)] {
        if (p.y - y) * (q.y - y) <= 0.0 && p.y != q.y {
            let x = p.x + (q.x - p.x) * (y - p.y) / (q.y - p.y);
            (from, to) = (from.min(x), to.max(x));
        }
    }
    (from, to)
}

/// The Gauss-Newton step.
fn solve(sums: &RowProducts, at: &TagImage, before: f64) -> Option<FitStep> {
    let free = sums.count - COUNT as f64;
    if !(free > 2.0 * COUNT as f64) {
        return None;
    }
    let squares = *sums.products.get(COUNT)?.get(COUNT)?;
    let variance = (squares / sums.count).min(before).max(ROUNDING);
    let mut matrix = [[0.0; UNKNOWNS]; UNKNOWNS];
    let mut right = [0.0; UNKNOWNS];
    let (last, by_gamma, by_ratio) =
        (sums.products.get(COUNT)?, sums.products.get(GAMMA)?, sums.products.get(RATIO)?);
    let rows = sums.products.get(..COUNT)?.iter().chain([by_gamma, by_ratio]);
    for (to, from) in matrix.iter_mut().zip(rows) {
        to.get_mut(..COUNT)?.copy_from_slice(from.get(..COUNT)?);
        // behind the residuals
        to.get_mut(COUNT..)?.copy_from_slice(from.get(GAMMA..=RATIO)?);
    }
    right.get_mut(..COUNT)?.copy_from_slice(last.get(..COUNT)?);
    // the priors of gamma and ratio enter as further equations; one that is not fitted has no products and stays unchanged
    let priors =
        [(at.log_gamma, USUAL_LOG_GAMMA, LOG_GAMMA_SD), (at.log_ratio, PRINTED_LOG_RATIO, LOG_RATIO_SD)];
    let known = priors.map(|(_, _, sd)| variance / (sd * sd));
    let pulls = priors.map(|(at, usual, sd)| at.map_or(0.0, |at| variance * (usual - at) / (sd * sd)));
    for ((right, products), pull) in right.iter_mut().skip(COUNT).zip([by_gamma, by_ratio]).zip(pulls) {
        *right = products.get(COUNT)? + pull;
    }
    // where cells are wide the ground hardly contributes: its prior is the paper, with the contrast as standard deviation
    let guess = variance / at.contrast.powi(2);
    let damping = std::array::from_fn(|i| match i {
        0..GROUND => 0.0,
        COUNT.. => known[i - COUNT],
        _ => guess,
    });
    let factors = Ldlt::new(&matrix, &damping)?;
    let by = factors.solve(&right);
    let explained: f64 = by.iter().zip(&right).map(|(a, b)| a * b).sum();
    Some(FitStep { by, variance: (squares - explained).max(0.0) / free, factors })
}

/// Moves the corners by a step. Returns the largest displacement, px.
fn quad_moved(quad: &mut Quad, fields: &[[Vector2<f64>; 8]; 4], by: &[f64; UNKNOWNS]) -> f64 {
    let mut most = 0.0f64;
    for (p, field) in quad.iter_mut().zip(fields) {
        let d: Vector2<f64> = field.iter().zip(by).map(|(f, by)| f * *by).sum();
        *p += d;
        // NaN must not count as a small step
        most = if d.norm() <= most { most } else { d.norm() };
    }
    most
}

/// Adds a step to all parameters but the homography. Returns whether the contrast is still that of a tag.
fn add(tag_image: &mut TagImage, by: &[f64; UNKNOWNS]) -> bool {
    let mut to = [0.0; UNKNOWNS];
    to.copy_from_slice(by);
    for (value, by) in tag_image.blur.iter_mut().zip(to.iter().skip(BLUR)) {
        *value += by;
    }
    let [xx, xy, yy] = tag_image.blur;
    let (xx, yy) = (xx.max(MIN_BLUR_PX2), yy.max(MIN_BLUR_PX2));
    let bound = MAX_ASLANT * (xx * yy).sqrt();
    tag_image.blur = [xx, xy.clamp(-bound, bound), yy];
    tag_image.ink += to[INK];
    tag_image.contrast += to[CONTRAST];
    for (value, by) in tag_image.light.iter_mut().zip(to.iter().skip(LIGHT)) {
        *value += by;
    }
    for (value, by) in tag_image.ground.iter_mut().zip(to.iter().skip(GROUND)) {
        *value += by;
    }
    let [least, most] = LOG_GAMMAS;
    tag_image.log_gamma = tag_image.log_gamma.map(|log| (log + to[COUNT]).clamp(least, most));
    let told = tag_image.log_gamma.map_or(0.0, |log| tag_image.told_log_ratio(log));
    let [least, most] = LOG_RATIOS;
    tag_image.log_ratio = (told > PRINTED_LOG_RATIO)
        .then(|| (tag_image.log_ratio.unwrap_or(PRINTED_LOG_RATIO) + to[COUNT + 1]).clamp(least, most));
    tag_image.contrast > MIN_CONTRAST
}

/// Variance of corners, px^2, by a blur that is not Gaussian: motion blur has an even profile, and is recognized by an anisotropic covariance. `cell`: width
/// of a cell, px.
fn smear(blur: &[f64; 3], cell: f64) -> f64 {
    let [xx, xy, yy] = *blur;
    let (mean, apart) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    let long = mean + apart;
    // the profile of a motion-blurred step deviates from a Gaussian one by the square of the motion's share in the variance
    let share = 2.0 * apart / long;
    long * (SMEAR_DOUBT * share * share * (-SMEAR_FALL * cell / long.sqrt()).exp()).powi(2)
}

/// Covariance `[xx, xy, yy]`, px^2, of a point that the homography's parameters displace by `field`.
fn covariance(
    field: &[Vector2<f64>; 8],
    inverse: &[[f64; UNKNOWNS]; UNKNOWNS],
    noise: f64,
    doubt: f64,
) -> [f64; 3] {
    let mut out = [doubt, 0.0, doubt];
    for (row, a) in inverse.iter().zip(field) {
        for (v, b) in row.iter().zip(field) {
            let v = v * noise;
            out[0] += a.x * v * b.x;
            out[1] += a.x * v * b.y;
            out[2] += a.y * v * b.y;
        }
    }
    out
}
