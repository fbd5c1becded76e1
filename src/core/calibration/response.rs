//! What the grey levels at the edges of a board's squares tell of the camera's response.
//!
//! Light goes from dark to light over an edge as a blur spreads it, alike on both sides. A response bends the levels between, and the edge
//! is steeper on one side than on the other: of each edge between two corners
//!
//! ```text
//! level(d) = 255 (D + (L - D) Phi((d - delta) / s))^(1 / gamma)        d: distance from the line through its corners, px
//! ```
//! with the light `D` and `L` of its sides, its place `delta` (prints shrink or grow, lenses bend) and its blur `s` its own, and one gamma for
//! all. Least squares over the levels of all edges; gamma's deviation comes from how much the edges differ about it.

use super::camera::BoardView;
use crate::camera_model::Response;
use crate::imaging::ImageView;
use crate::linalg::normal;
use nalgebra::{Matrix4, SVector, Vector2, Vector4};

/// Share of an edge about its middle that is used. Chosen by hand: nearer to its ends the neighbouring squares' blur reaches in.
const LENGTH: f64 = 0.4;
/// Distance from the edge that is used, as a share of the square there, and at most, px. Derived: 6 px are four standard deviations of a blur of
/// 1.5 px, where the profile is within 3e-5 of the contrast of its level; at half of it 2 % would be left.
const WIDTH: f64 = 0.4;
const MAX_WIDTH_PX: f64 = 6.0;
/// Narrower edges hold no level that only one side has, px. Chosen by hand: two deviations of the same blur; half of it is all slope.
const MIN_WIDTH_PX: f64 = 3.0;
/// Fewest pixels of an edge. Chosen by hand: four times its unknowns.
const MIN_PIXELS: usize = 16;
/// Range of usable levels. Chosen by hand: a camera clips at 0 and 255, and noise of one or two levels must stay within; a clipped side hides the
/// response.
const DARKEST: f64 = 4.0;
const LIGHTEST: f64 = 250.0;
/// Smallest contrast between the sides, levels. Chosen by hand: with less, noise hides the response's curvature.
const CONTRAST: f64 = 30.0;
/// Edges of one picture that are looked at, evenly spread: more tell gamma no better than paper and lens allow.
const EDGES_OF_VIEW: usize = 60;
/// Fewest edges for a result. Chosen by hand, so that their scatter gives the standard deviation to a sixth (`1 / sqrt(2 * 19)`).
const MIN_EDGES: usize = 20;
/// Most steps of the fit, and the change of gamma that ends it. Chosen by hand: far below the standard deviations that are reached.
const STEPS: usize = 20;
const SETTLED: f64 = 1e-4;
/// Edges that fit worse than this many times the median are left out as covered, or not an edge. Chosen by hand: noise alone
/// exceeds it for one of 2000 of the smallest edges (chi-square); a higher bound lets shadows and covers draw gamma.
const OUTLIER: f64 = 3.0;
/// Standard deviations from which on a response is distinguished from none, and the smallest deviation of gamma from 1 that is reported. Chosen by hand: by noise
/// alone a normal deviate exceeds 4 once in 16 000 cases, and with 1.1 an edge moves by 0.05 standard deviations of its blur.
const TOLD_SD: f64 = 4.0;
const NOTICEABLE: f64 = 0.1;

/// A gamma with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GammaEstimate {
    /// `level = light^(1 / gamma)`.
    pub gamma: f64,
    /// Of gamma.
    pub sd: f64,
}

impl GammaEstimate {
    /// The estimated response; `None` where it cannot be distinguished from a linear one.
    #[must_use]
    pub fn response(&self) -> Option<Response> {
        let off = (self.gamma - 1.0).abs();
        let told = off > TOLD_SD * self.sd && off > NOTICEABLE && Response::GAMMA.contains(&self.gamma);
        told.then(|| Response::Gamma((100.0 * self.gamma).round() / 100.0))
    }
}

/// One edge: its pixels, and what is known of it.
#[derive(Debug, Clone)]
struct BoardEdge {
    /// Distance from the line, px, towards light, and level, as share of the greatest.
    pixels: Vec<[f64; 2]>,
    /// D, L, delta, s.
    own: Vector4<f64>,
}

/// The edges of boards in any number of pictures of one camera.
#[derive(Debug, Clone, Default)]
pub struct ResponseEvidence {
    edges: Vec<BoardEdge>,
}

impl ResponseEvidence {
    /// Takes the edges of a board with `columns` corners in a row that was found in `image`.
    pub fn add(&mut self, image: &ImageView<'_>, board: &BoardView, columns: u32) {
        let at =
            |id: u32| board.binary_search_by_key(&id, |p| p.id).ok().and_then(|i| board.get(i)).map(|p| p.px);
        let neighbours = board.iter().flat_map(|p| {
            let right = (p.id % columns + 1 < columns).then(|| (p.id + 1, p.id + columns));
            let down = (p.id + columns, p.id + 1);
            right.into_iter().chain([down]).map(move |(along, beside)| (p, along, beside))
        });
        let all: Vec<_> = neighbours
            .filter_map(|(p, along, beside)| Some((p.px, at(along)?, at(beside)? - p.px)))
            .collect();
        let stride = all.len().div_ceil(EDGES_OF_VIEW).max(1);
        self.edges.extend(
            all.iter().step_by(stride).filter_map(|(a, b, beside)| BoardEdge::new(image, *a, *b, beside)),
        );
    }

    /// The gamma of all edges together; `None` where these are too few.
    #[must_use]
    pub fn gamma(&self) -> Option<GammaEstimate> {
        let (first, misfits) = fit(&mut self.edges.clone(), 1.0)?;
        let mut sorted = misfits.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let most = OUTLIER * sorted.get(sorted.len() / 2)?;
        let good = self.edges.iter().zip(misfits).filter(|(_, misfit)| *misfit <= most);
        let mut kept: Vec<BoardEdge> = good.map(|(edge, _)| edge.clone()).collect();
        fit(&mut kept, first.gamma).map(|(estimate, _)| estimate)
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
        if dark > light {
            (dark, light) = (light, dark);
            pixels.iter_mut().for_each(|[d, _]| *d = -*d);
        }
        let usable = dark >= DARKEST && light <= LIGHTEST && light - dark >= CONTRAST;
        if !usable || pixels.len() < MIN_PIXELS {
            return None;
        }
        pixels.iter_mut().for_each(|[_, level]| *level /= 255.0);
        Some(Self { pixels, own: Vector4::new(dark / 255.0, light / 255.0, 0.0, 1.0) })
    }

    /// Sum of squares, and the normal equations of its own unknowns and gamma.
    fn equations(&self, gamma: f64) -> (f64, SVector<f64, 5>, [SVector<f64, 5>; 5]) {
        let [dark, light, place, blur] = self.own.into();
        let (mut squares, mut right, mut information) =
            (0.0, SVector::zeros(), [SVector::<f64, 5>::zeros(); 5]);
        for [d, level] in &self.pixels {
            let z = (d - place) / blur;
            let (above, density) = normal(z);
            // Otherwise the power of a negative level would not be a number. The bounds of a step below were chosen by hand: they keep a fit
            // that starts far off from leaving the range of levels.
            let m = (dark + (light - dark) * above).max(1e-4);
            let told = m.powf(1.0 / gamma);
            let by_light = told / (gamma * m);
            let slope = -(light - dark) * density / blur;
            let row = SVector::from([
                by_light * (1.0 - above),
                by_light * above,
                by_light * slope,
                by_light * slope * z,
                -told * m.ln() / (gamma * gamma),
            ]);
            let rest = level - told;
            squares += rest * rest;
            right += row * rest;
            information.iter_mut().zip(row.iter()).for_each(|(n, r)| *n += row * *r);
        }
        (squares, right, information)
    }
}

/// Gauss-Newton from a gamma on; what each edge leaves, as variance of a level.
fn fit(edges: &mut [BoardEdge], start: f64) -> Option<(GammaEstimate, Vec<f64>)> {
    if edges.len() < MIN_EDGES {
        return None;
    }
    // sides as light, from the levels that they are first
    for edge in edges.iter_mut() {
        edge.own[0] = edge.own[0].powf(start);
        edge.own[1] = edge.own[1].powf(start);
    }
    let mut gamma = start;
    let mut misfits = vec![0.0; edges.len()];
    for step in 0..STEPS {
        let (mut information, mut slope, mut slopes) = (0.0, 0.0, 0.0);
        let mut moves = Vec::with_capacity(edges.len());
        for (edge, misfit) in edges.iter().zip(&mut misfits) {
            let (squares, right, N) = edge.equations(gamma);
            *misfit = squares / (edge.pixels.len() - 5) as f64;
            let own = Matrix4::from_fn(|i, j| N[i][j]).try_inverse();
            let cross = Vector4::from_fn(|i, _| N[i][4]);
            let Some(own) = own else {
                moves.push((Vector4::zeros(), Vector4::zeros()));
                continue;
            };
            let (by_own, by_gamma) = (own * right.fixed_rows::<4>(0), own * cross);
            let (h, b) = (N[4][4] - cross.dot(&by_gamma), right[4] - cross.dot(&by_own));
            information += h;
            slope += b;
            slopes += b * b;
            moves.push((by_own, by_gamma));
        }
        if !(information > 0.0) {
            return None;
        }
        // chosen by hand: a first step from far off must not leap beyond 1; the later ones are small
        let change = (slope / information).clamp(-0.3, 0.3);
        for (edge, (by_own, by_gamma)) in edges.iter_mut().zip(moves) {
            let moved = edge.own + by_own - by_gamma * change;
            // sides that stay sides, places within reach, blurs that are some
            edge.own = Vector4::new(
                // light is above 0, of which no power of gamma would have a slope
                moved[0].clamp(1e-4, 2.0),
                // as above: must have a slope
                moved[1].clamp(1e-4, 2.0),
                moved[2].clamp(-2.0, 2.0),
                // less than the pixel's own 0.29 px must be noise
                moved[3].clamp(0.5 * edge.own[3], 2.0 * edge.own[3]).clamp(0.2, MAX_WIDTH_PX),
            );
        }
        gamma = (gamma + change).clamp(*Response::GAMMA.start(), *Response::GAMMA.end());
        if step > 2 && change.abs() < SETTLED {
            // what the edges differ by, not what the noise of their pixels lets expect: prints and blurs are not quite normal
            return Some((GammaEstimate { gamma, sd: slopes.sqrt() / information }, misfits));
        }
    }
    None
}
