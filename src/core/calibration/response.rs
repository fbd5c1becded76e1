//! What the grey levels at the edges of a board's squares tell of the camera's response.
//!
//! Light goes from dark to light over an edge as blur and the pixel's box spread it, alike on both sides whatever the blur's shape: a disc of
//! defocus, a box of motion, a normal distribution. A response bends the levels between, and the edge is steeper on one side than on the
//! other. Of each edge between two corners
//!
//! ```text
//! level(d) = 255 (c + sum_k a_k B_k(d - delta))^(1 / gamma)      d: distance from the line through its corners, px
//! ```
//! with the odd functions `B_k`: an edge that the pixel's box, as it lies across it, and a blur's of `BOXES_PX[k]` have spread, less one half.
//! The middle light `c`, the shape `a` and the place `delta` (prints shrink or grow, lenses bend) are each edge's own, and gamma is common to all.
//! Least squares over the levels of all edges. Gamma's deviation comes from how much the edges of one picture, one direction and one order of
//! dark and light differ from the others': whatever is not alike on both sides, as a lens's coma or shade, bends these in opposite senses.

use super::camera::BoardView;
use crate::camera_model::Response;
use crate::imaging::ImageView;
use nalgebra::{SMatrix, SVector, Vector2};
use std::collections::BTreeMap;

/// Half the widths of the boxes that an edge's blur is put together from, px: every blur with one summit that is alike on both sides is a mixture of boxes.
/// Chosen by hand: the pixel's own box, a half to each side, hides what lies between two of them; the last is what [`MAX_WIDTH_PX`] can hold.
const BOXES_PX: [f64; 9] = [0.15, 0.4, 0.65, 0.9, 1.2, 1.6, 2.1, 2.8, 3.8];
/// What mixtures of these leave of a blur, in shares of the contrast in light. Chosen by hand: a camera that spreads the dark levels makes of it more than
/// noise does, and these pixels then count for less.
const SHAPE_SD: f64 = 0.004;
/// The box that the fit starts from. Chosen by hand: in the middle of them.
const FIRST_BOX: usize = 4;
/// Unknowns of an edge's own: the middle, the share of each box, the place. With gamma they are one more.
const PLACE: usize = BOXES_PX.len() + 1;
const OWN: usize = PLACE + 1;
const ALL: usize = OWN + 1;
/// Fewest pixels of an edge. Chosen by hand: twice its unknowns.
const MIN_PIXELS: usize = 2 * OWN;
/// Variance of a level, as a share of the greatest, before it is known. Derived: one grey level.
const LEVEL_VARIANCE: f64 = 1.5e-5;
/// Least of it. Derived: that of a level's rounding, a twelfth of its square. Pixels whose shape is uncertain count less, and with no bound all of them ever less.
const ROUNDING: f64 = 1.0 / (12.0 * 255.0 * 255.0);
/// Least side of a pixel's box across an edge that runs along it, px. Chosen by hand: its formula divides by it, and no edge tells 0.05 px from nothing.
const THIN_PX: f64 = 0.05;
/// Share of an edge about its middle that is used. Chosen by hand: nearer to its ends the neighbouring squares' blur reaches in.
const LENGTH: f64 = 0.4;
/// Distance from the edge that is used, as a share of the square there, and at most, px. Derived: 6 px are four standard deviations of a blur of
/// 1.5 px, where the profile is within 3e-5 of the contrast of its level; at half of it 2 % would be left.
const WIDTH: f64 = 0.4;
const MAX_WIDTH_PX: f64 = 6.0;
/// Narrower edges hold no level that only one side has, px. Chosen by hand: two deviations of the same blur; half of it is all slope.
const MIN_WIDTH_PX: f64 = 3.0;
/// Range of usable levels. Chosen by hand: a camera clips at 0 and 255, and noise of one or two levels must stay within; a clipped side hides the
/// response.
const DARKEST: f64 = 4.0;
const LIGHTEST: f64 = 250.0;
/// Smallest contrast between the sides, levels. Chosen by hand: with less, noise hides the response's curvature.
const CONTRAST: f64 = 30.0;
/// Edges of one picture that are looked at, evenly spread: more tell gamma no better than paper and lens allow. And of all
/// pictures, chosen by hand: so that many of them take some seconds.
const EDGES_OF_VIEW: usize = 60;
const MAX_EDGES: usize = 600;
/// Fewest edges for a result. Chosen by hand, so that their scatter gives the standard deviation to a sixth (`1 / sqrt(2 * 19)`).
const MIN_EDGES: usize = 20;
/// Steps in which the edges' own unknowns follow a gamma. Chosen by hand: these are linear but for the place, and weights follow them; the slope by gamma is freed of what a
/// last step would still change.
const OWN_STEPS: usize = 3;
/// Most gammas that are tried. Chosen by hand: of 30 sets of pictures with gamma 2.2 none took more than 22.
const TRIALS: usize = 30;
/// Step that ends the fit, in gamma's standard deviations. Chosen by hand: a fiftieth of a deviation is nothing.
const SETTLED: f64 = 0.02;
/// Least share of the information that the slope is taken to fall by. Chosen by hand: a tenth was seen, and a step too far is between two from then on.
const FLATTEST: f64 = 0.05;
/// Longest step of gamma. Chosen by hand: the equations are straight about so far.
const MAX_STEP: f64 = 0.3;
/// Farthest place of an edge from the line through its corners, px. Chosen by hand: prints and lenses move edges by tenths.
const MAX_PLACE_PX: f64 = 1.0;
/// Standard deviation of gamma, in itself, by what the model leaves out: the corners' errors, boxes between those above, levels that a gamma does not quite
/// describe. Measured on images of another renderer (linear, sRGB, gamma 2.2; blurs of 24 kinds).
const MODEL_SD: f64 = 0.03;
/// The same, in what gamma differs from 1 by: the more levels are bent, the more of a shape's misfit is taken for it. Measured on the same images.
const BENT_SD: f64 = 0.1;
/// Edges that fit worse than this many times the median are left out as covered, or not an edge. Chosen by hand: noise alone
/// exceeds it for one of 2000 of the smallest edges (chi-square); a higher bound lets shadows and covers draw gamma.
const OUTLIER: f64 = 3.0;
/// Standard deviations from which on a response is distinguished from none. Chosen by hand: by noise alone a normal deviate exceeds 4 once in 16 000 cases.
const TOLD_SD: f64 = 4.0;
/// Smallest deviation of gamma from 1 that is reported. Measured on images of another renderer: sharp linear ones gave up to 1.24 with support, by which an edge moves
/// by 0.1 standard deviations of its blur.
const NOTICEABLE: f64 = 0.25;
/// Gammas from there on are distrusted, as all below 1 are. Chosen by hand: cameras have 1 to 2.6, and what fits a larger one is no gamma.
const LARGEST: f64 = 3.2;
/// Least support of a response. Measured on images of two other renderers: of 310 linear sets those whose gamma would be told have none (-0.03 and less), of bent ones
/// those that are right have 0.36 and more.
const SUPPORT: f64 = 0.3;
/// Standard deviation of gamma from which on nothing is known. Chosen by hand: a linear response would be within it of gamma 1.2.
const UNKNOWN_SD: f64 = 0.1;

/// A gamma with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GammaEstimate {
    /// `level = light^(1 / gamma)`.
    pub gamma: f64,
    /// Of gamma, with what the model leaves out.
    pub sd: f64,
    /// By how much the squared errors fall from a linear response to this one, in what so well known a gamma lets expect.
    pub support: f64,
}

impl GammaEstimate {
    /// The estimated response; `None` where it cannot be distinguished from a linear one, or is none that a camera has.
    #[must_use]
    pub fn response(&self) -> Option<Response> {
        let told = self.gamma - 1.0 > TOLD_SD * self.sd && self.gamma - 1.0 > NOTICEABLE;
        let told = told && self.gamma < LARGEST && self.support > SUPPORT;
        told.then(|| Response::Gamma((100.0 * self.gamma).round() / 100.0))
    }

    /// Whether levels are proportional to light, as far as edges tell.
    #[must_use]
    pub fn is_linear(&self) -> bool {
        let off = (self.gamma - 1.0).abs();
        self.response().is_none() && off < NOTICEABLE.max(TOLD_SD * self.sd) && self.sd < UNKNOWN_SD
    }
}

/// One edge: its pixels, and what is known of it.
#[derive(Debug, Clone)]
struct BoardEdge {
    /// Distance from the line, px, towards light, and level, as share of the greatest.
    pixels: Vec<[f64; 2]>,
    /// Levels of its sides, dark first.
    sides: [f64; 2],
    /// Half of a pixel's sides, across the edge, px.
    half_px: [f64; 2],
    /// Edges with equal numbers have the picture, the direction and the order of dark and light in common.
    kin: usize,
    /// c, a, delta.
    own: SVector<f64, OWN>,
}

/// The edges of boards in any number of pictures of one camera.
#[derive(Debug, Clone, Default)]
pub struct ResponseEvidence {
    edges: Vec<BoardEdge>,
    views: usize,
}

impl ResponseEvidence {
    /// Takes the edges of a board with `columns` corners in a row that was found in `image`.
    pub fn add(&mut self, image: &ImageView<'_>, board: &BoardView, columns: u32) {
        let at =
            |id: u32| board.binary_search_by_key(&id, |p| p.id).ok().and_then(|i| board.get(i)).map(|p| p.px);
        let neighbours = board.iter().flat_map(|p| {
            let right = (p.id % columns + 1 < columns).then(|| (p.id + 1, p.id + columns, 0));
            let down = (p.id + columns, p.id + 1, 1);
            right.into_iter().chain([down]).map(move |(along, beside, axis)| (p, along, beside, axis))
        });
        let all: Vec<_> = neighbours
            .filter_map(|(p, along, beside, axis)| Some((p.px, at(along)?, at(beside)? - p.px, axis)))
            .collect();
        let stride = all.len().div_ceil(EDGES_OF_VIEW).max(1);
        let first = 4 * self.views;
        let some = all.iter().step_by(stride);
        self.edges.extend(some.filter_map(|(a, b, beside, axis)| {
            let edge = BoardEdge::new(image, *a, *b, beside)?;
            Some(BoardEdge { kin: first + 2 * axis + edge.kin, ..edge })
        }));
        self.views += 1;
    }

    /// The gamma of all edges together; `None` where these are too few, or tell none.
    #[must_use]
    pub fn gamma(&self) -> Option<GammaEstimate> {
        let stride = self.edges.len().div_ceil(MAX_EDGES).max(1);
        let mut edges: Vec<BoardEdge> = self.edges.iter().step_by(stride).cloned().collect();
        edges.iter_mut().for_each(|edge| edge.begin(1.0));
        let first = fit(&mut edges, 1.0)?;
        let most = OUTLIER * median(&first.misfits)?;
        let mut each = first.misfits.iter().zip(&first.gains);
        let mut gain = 0.0;
        edges.retain(|_| {
            let good = each.next().filter(|(misfit, _)| **misfit <= most);
            gain += good.map_or(0.0, |(_, gain)| *gain);
            good.is_some()
        });
        let last = fit(&mut edges, first.gamma)?;
        let support = gain / ((last.gamma - 1.0).powi(2) * last.information);
        Some(GammaEstimate { gamma: last.gamma, sd: last.sd, support })
    }
}

impl BoardEdge {
    /// Between corners `a` and `b`; the next corner beside it is `beside` away.
    fn new(image: &ImageView<'_>, a: Vector2<f64>, b: Vector2<f64>, beside: &Vector2<f64>) -> Option<Self> {
        let along = (b - a).try_normalize(1e-9)?;
        let across = Vector2::new(-along.y, along.x);
        let width = (WIDTH * beside.dot(&across).abs()).min(MAX_WIDTH_PX);
        let half = 0.5 * LENGTH * (b - a).norm();
        if width < MIN_WIDTH_PX {
            return None;
        }
        let middle = 0.5 * (a + b);
        let reach = half + width;
        let inside = |v: f64, size: usize| v - reach >= 0.0 && v + reach <= size as f64 - 1.0;
        if !(inside(middle.x, image.width()) && inside(middle.y, image.height())) {
            return None;
        }
        let mut pixels = Vec::new();
        for y in (middle.y - reach).ceil() as usize..=(middle.y + reach) as usize {
            for x in (middle.x - reach).ceil() as usize..=(middle.x + reach) as usize {
                let p = Vector2::new(x as f64, y as f64) - middle;
                let d = p.dot(&across);
                if p.dot(&along).abs() <= half && d.abs() <= width {
                    pixels.push([d, f64::from(*image.row(y).get(x)?)]);
                }
            }
        }
        let side = |sign: f64| {
            let beyond = pixels.iter().filter(|[d, _]| sign * d > 0.5 * width).map(|[_, level]| *level);
            let (sum, count) = beyond.fold((0.0, 0.0), |(s, n), level| (s + level, n + 1.0));
            if count > 0.0 { sum / count } else { f64::NAN }
        };
        let (mut dark, mut light) = (side(-1.0), side(1.0));
        let turned = dark > light;
        if turned {
            (dark, light) = (light, dark);
            pixels.iter_mut().for_each(|[d, _]| *d = -*d);
        }
        let usable = dark >= DARKEST && light <= LIGHTEST && light - dark >= CONTRAST;
        if !usable || pixels.len() < MIN_PIXELS {
            return None;
        }
        pixels.iter_mut().for_each(|[_, level]| *level /= 255.0);
        Some(Self {
            pixels,
            sides: [dark / 255.0, light / 255.0],
            half_px: [0.5 * across.x.abs().max(THIN_PX), 0.5 * across.y.abs().max(THIN_PX)],
            kin: usize::from(turned),
            own: SVector::zeros(),
        })
    }

    /// Where a fit with a gamma starts.
    fn begin(&mut self, gamma: f64) {
        let [dark, light] = self.sides.map(|level| level.powf(gamma));
        self.own.fill(0.0);
        (self.own[0], self.own[FIRST_BOX]) = (0.5 * (dark + light), light - dark);
    }

    /// Moves its own unknowns.
    fn follow(&mut self, by: &SVector<f64, OWN>) {
        self.own += by;
        self.own[PLACE] = self.own[PLACE].clamp(-MAX_PLACE_PX, MAX_PLACE_PX);
    }

    /// Sums of weighted squares and of squares, and the normal equations of its own unknowns and gamma, for levels of this variance.
    fn equations(&self, gamma: f64, variance: f64) -> (f64, f64, SVector<f64, ALL>, SMatrix<f64, ALL, ALL>) {
        let [dark, light] = self.sides.map(|level| level.powf(gamma));
        let (mut weighted, mut squares) = (0.0, 0.0);
        let (mut right, mut information) = (SVector::zeros(), SMatrix::zeros());
        for [d, level] in &self.pixels {
            let mut row = SVector::<f64, ALL>::zeros();
            row[0] = 1.0;
            let mut m = self.own[0];
            for (k, blur) in BOXES_PX.iter().enumerate() {
                let (below, density) = spread(d - self.own[PLACE], *blur, self.half_px);
                let a = self.own[1 + k];
                m += a * (below - 0.5);
                row[1 + k] = below - 0.5;
                row[PLACE] -= a * density;
            }
            // chosen by hand: otherwise the power of a light below 0, which a shape can have on its way, would not be a number
            m = m.max(1e-4);
            let told = m.powf(1.0 / gamma);
            let by_light = told / (gamma * m);
            row *= by_light;
            row[OWN] = -told * m.ln() / (gamma * gamma);
            let rest = level - told;
            let weight = variance / (variance + (SHAPE_SD * (light - dark) * by_light).powi(2));
            weighted += weight * rest * rest;
            squares += rest * rest;
            right += row * (weight * rest);
            information += row * row.transpose() * weight;
        }
        // what a shape has of each box is of the order of the contrast: else what an edge does not tell would have no bounds
        let known = variance / (light - dark).powi(2);
        for k in 1..PLACE {
            information[(k, k)] += known;
            right[k] -= known * self.own[k];
        }
        (weighted, squares, right, information)
    }
}

/// An edge through 0 that three boxes of these half widths spread: what of it lies below `d`, and its density there.
fn spread(d: f64, blur: f64, [p, q]: [f64; 2]) -> (f64, f64) {
    let (mut above, mut density) = (0.0, 0.0);
    for (sign, x) in [(1.0, p + q), (-1.0, p - q), (-1.0, q - p), (1.0, -p - q)] {
        let (left, right) = ((d + x + blur).max(0.0), (d + x - blur).max(0.0));
        density += sign * (left * left - right * right);
        above += sign * (left * left * left - right * right * right);
    }
    let scale = 1.0 / (16.0 * blur * p * q);
    (above * scale / 3.0, density * scale)
}

fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// A gamma that was fitted.
struct GammaFit {
    gamma: f64,
    sd: f64,
    /// Half the second derivative of the squared errors by gamma.
    information: f64,
    /// What each edge leaves, as variance of a level.
    misfits: Vec<f64>,
    /// By how much its squared errors have fallen from the first gamma on.
    gains: Vec<f64>,
}

/// All edges at a gamma.
struct Slope {
    /// Of half the squared errors, downwards by gamma, each edge's own unknowns following it.
    slope: f64,
    /// Its derivative, as far as weights stay as they are.
    information: f64,
    /// Standard deviation of gamma.
    sd: f64,
    /// Of a level.
    variance: f64,
    misfits: Vec<f64>,
    squares: Vec<f64>,
    /// How each edge's own unknowns follow gamma.
    by_gamma: Vec<SVector<f64, OWN>>,
}

impl Slope {
    /// With the edges' own unknowns a step further; `None` where levels are no numbers.
    fn of(edges: &mut [BoardEdge], gamma: f64, variance: f64) -> Option<Self> {
        let (mut information, mut slope, mut each) = (0.0, 0.0, 0.0);
        let mut kin = BTreeMap::<usize, f64>::new();
        let (mut misfits, mut all_squares, mut all_by_gamma) = (Vec::new(), Vec::new(), Vec::new());
        for edge in edges {
            let (weighted, squares, right, N) = edge.equations(gamma, variance);
            misfits.push(weighted / (edge.pixels.len() - OWN) as f64);
            all_squares.push(squares);
            let cross = N.fixed_view::<OWN, 1>(0, OWN).into_owned();
            // fails only where a level is no number
            let own = N.fixed_view::<OWN, OWN>(0, 0).into_owned().cholesky()?;
            let by_own = own.solve(&right.fixed_rows::<OWN>(0).into_owned());
            let by_gamma = own.solve(&cross);
            let b = right[OWN] - cross.dot(&by_own);
            information += N[(OWN, OWN)] - cross.dot(&by_gamma);
            slope += b;
            each += b * b;
            *kin.entry(edge.kin).or_default() += b;
            all_by_gamma.push(by_gamma);
            edge.follow(&by_own);
        }
        let variance = median(&misfits)?.max(ROUNDING);
        let groups = kin.len() as f64;
        let groups = kin.values().map(|b| b * b).sum::<f64>() * groups / (groups - 1.0);
        // what the edges and their groups differ by, and not less than what the noise of their pixels lets expect
        let scatter = groups.max(each).max(variance * information).sqrt() / information;
        let sd = scatter.hypot(MODEL_SD * gamma).hypot(BENT_SD * (gamma - 1.0));
        let known = information > 0.0 && sd.is_finite();
        let (squares, by_gamma) = (all_squares, all_by_gamma);
        known.then_some(Self { slope, information, sd, variance, misfits, squares, by_gamma })
    }
}

/// The gamma at which the slope is 0, from one on, and from what the edges' own unknowns are: steps of Gauss and Newton until it lies between two that were tried, then false position.
/// Weights and shapes follow gamma, by which the slope falls some times slower than the information says: such steps alone would crawl.
fn fit(edges: &mut [BoardEdge], start: f64) -> Option<GammaFit> {
    if edges.len() < MIN_EDGES {
        return None;
    }
    let (mut gamma, mut variance) = (start, LEVEL_VARIANCE);
    let mut first = None;
    // where the slope leads up from, and down from, with it
    let mut ends: [Option<[f64; 2]>; 2] = [None; 2];
    let mut before = None;
    let mut trial = 0;
    loop {
        for _ in 0..OWN_STEPS {
            variance = Slope::of(edges, gamma, variance)?.variance;
        }
        let at = Slope::of(edges, gamma, variance)?;
        variance = at.variance;
        let first: &Vec<f64> = first.get_or_insert_with(|| at.squares.clone());
        let side = usize::from(at.slope < 0.0);
        // twice on one side: the other end draws less, else it would stay for ever
        if let Some(other) = ends[1 - side].as_mut().filter(|_| before == Some(side)) {
            other[1] *= 0.5;
        }
        before = Some(side);
        let last = ends[side].replace([gamma, at.slope]);
        let next = match ends {
            [Some([low, up]), Some([high, down])] => low + (high - low) * up / (up - down),
            _ => {
                let falls = last.map_or(at.information, |[g, slope]| (slope - at.slope) / (gamma - g));
                gamma
                    + (at.slope / falls.clamp(FLATTEST * at.information, at.information))
                        .clamp(-MAX_STEP, MAX_STEP)
            }
        };
        let next = next.clamp(*Response::GAMMA.start(), *Response::GAMMA.end());
        trial += 1;
        let change = next - gamma;
        if change.abs() < SETTLED * at.sd || trial == TRIALS {
            let gains = first.iter().zip(&at.squares).map(|(first, last)| first - last).collect();
            // what is left to go is told: next to nothing but for a last trial
            let sd = at.sd.hypot(change);
            return Some(GammaFit { gamma, sd, information: at.information, misfits: at.misfits, gains });
        }
        for (edge, by_gamma) in edges.iter_mut().zip(&at.by_gamma) {
            edge.follow(&(-by_gamma * change));
        }
        gamma = next;
    }
}

#[cfg(test)]
mod tests;
