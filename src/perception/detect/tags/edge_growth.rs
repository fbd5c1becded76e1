//! Growth: by how much light areas appear too large, estimated from a tag's own edges and corrected at its corners.
//!
//! A camera whose levels are not proportional to light (gamma), light that spreads, and ink that shrinks shift every edge towards its dark side by the same
//! distance: the sides of the black square inward, the edges of white cells outward. Relative to the grid that the
//! measured corners span, an edge between two cells then lies off its line by
//!
//! ```text
//! off = delta (1 + u . p') - (a . d) L^2 / 8 + c u . f        u: unit normal of the edge towards its dark side, d: from dark to light
//! ```
//! with the growth `delta` (px), the displacement `p'` of the grid's line where the four sides move outward by 1 px, the relative slope `a` of the
//! illumination (1/px), which shifts the middle of a step of length `L` between the centres of two cells, and the coefficient `c` of the lens's distortion: it
//! displaces a point `x` of the tag (-1 to 1 each way) by `f = x (4/3 - x . x)`, whose mean over each side, where the corners come from, is zero.
//! Least squares over all edges between a black and a white cell give `delta`, `a` and `c`. The corners are then moved outward by the posterior mean of the
//! growth, and its remaining variance is added to their covariance.

use super::decode::{Decoded, level_at};
use super::edges::{Believed, Corners};
use super::pattern::{CellPattern, MAX_CELLS};
use super::plane_map::PlaneMap;
use super::quad::Quad;
use crate::imaging::ImageView;
use nalgebra::{Matrix4, Vector2, Vector4};

/// Least distance between the centres of two cells whose edge is used, in deviations of the blur, so that the cells' levels are their own: at half of it
/// a normal blur has 2e-4 of a step left. Half would leave 4 %, the double would leave out most tags' edges. In a tilted tag the distances of one direction are shorter, and the edges of the other direction are enough.
pub(super) const LEAST_STEP_BLURS: f64 = 7.0;
/// Growth, light in both directions, bow: their number follows from the equation of the head.
const UNKNOWNS: usize = 4;
/// Fewest edges for an estimate: twice the unknowns, so that their scatter can be estimated. A tilted 16h5 has some ten.
const LEAST_EDGES: usize = 2 * UNKNOWNS;
/// Distance, in deviations of an edge, that scan lines across an edge and samples of a cell's level keep from other cells: less than 2e-3
/// of a step is left there. They are a pixel apart, since nearer ones have the same noise, and at most so many.
const CLEAR_BLURS: f64 = 3.0;
const MAX_PLACES: u32 = 6;
/// In cells too narrow for that a level is the mean of four places half of this share of a cell off its middle each way. Chosen by hand: in a cell
/// seven deviations wide 6e-4 of a neighbour's step reach them, with half of it 4e-4, and with the double 1.6e-3, still less than above.
const LEVEL_AROUND: f64 = 0.08;
/// Half of the window across an edge: it holds all of the edge, also one that has grown by [`MOST_BLURS`], because beyond three deviations
/// more hardly anything of a step is left.
const WINDOW_BLURS: f64 = 4.0;
/// Variance of the pixel's own square, 1/12 px^2, and of the bilinear interpolation, at most 1/6 px^2; the latter follows from what a straight line
/// between two pixels does to a step.
const PIXEL_VARIANCE: f64 = 0.25;
/// Edges that lie off by more than so many deviations take no part: something covers them. Noise alone leaves out 0.27 % of the edges, as the
/// normal distribution has it; half would leave out 13 %, and the double would keep edges that are half covered.
const OUTLIER_SD: f64 = 3.0;
/// Of so many cameras that are said to be linear one is not, or its tags' print has grown. With what is usual that asks for a growth of 3 to 3.5
/// deviations, and of a linear camera's tags one in 400 to 2 000 is moved. Chosen by hand: half and double of it move that by 0.2 deviations.
const LINEAR_ODDS: f64 = 10.0;
/// What unknown cameras move edges by, one standard deviation, in deviations of the blur: gammas of 1.2 to 2.4 do by 0.05 to 0.6, as the area
/// under a bent step shows ([`MOST_BLURS`]).
const USUAL_BLURS: f64 = 0.3;
/// A gamma of 2.4 moves the edge of a black without any light by 0.92 deviations of the blur (0.62 where it has a hundredth of the
/// white's, 0.26 where it has a fifth): the area under the bent normal step. What has grown by more is a print or a drawing.
const MOST_BLURS: f64 = 1.0;
/// Edges between cells that scatter by more than so many times what the noise of the sides makes them scatter show more than noise: a light that is none of a
/// plane. Measured: of 490 honest images 2 % had 2.0, none more than 2.7; of 179 with an untrue corner by a shadow half had 3. Half doubts a tenth
/// of the honest ones.
const SCATTERED: f64 = 3.0;
/// Step for the motion of the grid's lines, px: their motion is a rational function of it, of which this keeps the first order. What the second
/// order leaves follows: about the step's share of a side, below 1e-3 of the growth from 14 px on. It doubles with the step.
const STEP_PX: f64 = 0.01;

/// An edge between two cells.
#[derive(Debug, Clone, Copy, Default)]
struct CellEdge {
    /// What a unit of each unknown moves it by, px.
    by: Vector4<f64>,
    /// How far it lies towards its dark side, px.
    off_px: f64,
}

/// Most edges: two directions of neighbours within the largest family.
const MOST_EDGES: usize = 2 * MAX_CELLS * (MAX_CELLS - 1);

/// The corners, corrected for the growth as [`moved`] tells; and whether the edges scatter more than the sides' noise lets them.
pub(super) fn corrected(
    image: &ImageView<'_>,
    corners: &Corners,
    decoded: &Decoded,
    believed: Believed,
) -> (Option<Corners>, bool) {
    let mut scattered = false;
    (moved(image, corners, decoded, believed, &mut scattered), scattered)
}

/// The corners, corrected for the growth: for the posterior mean from the edges and the prior ([`USUAL_BLURS`]), whose variance is added to their
/// covariance. `None` where the response is assumed linear and no growth is significant.
fn moved(
    image: &ImageView<'_>,
    corners: &Corners,
    decoded: &Decoded,
    believed: Believed,
    scattered: &mut bool,
) -> Option<Corners> {
    let outward = outward(&corners.px)?;
    let usual = (USUAL_BLURS * corners.blur_px).powi(2);
    let contrast = decoded.light_level - decoded.dark_level;
    // a window's mean has the variance of a pixel over its length, which is twice its half, and the position is that mean times the length
    let per_edge = 2.0 * corners.noise_levels2 / (contrast * contrast);
    let measured = growth(image, corners, &outward, &decoded.pattern)
        .map(|(growth_px, variance, of_edge)| {
            *scattered = per_edge > 0.0 && of_edge > SCATTERED * per_edge;
            (growth_px, variance)
        })
        // In this form what is no number is none.
        .filter(|(growth_px, variance)| {
            growth_px.abs() <= corners.blur_px * MOST_BLURS && variance.is_finite()
        });
    let (growth_px, variance) = match measured {
        Some((growth_px, variance)) => {
            let share = usual / (usual + variance);
            // log odds of some growth against none, before and after it was measured
            let evidence = growth_px.powi(2) * share / variance - (usual / variance).ln_1p();
            if believed == Believed::Linear && !(evidence > 2.0 * LINEAR_ODDS.ln()) {
                return None;
            }
            (share * growth_px, share * variance)
        }
        None if believed == Believed::Linear => return None,
        None => (0.0, usual),
    };
    let mut moved = *corners;
    for ((corner, covariance), by) in moved.px.iter_mut().zip(&mut moved.covariance_px2).zip(&outward) {
        *corner += by * growth_px;
        let [xx, xy, yy] = covariance;
        (*xx, *xy, *yy) =
            (*xx + variance * by.x * by.x, *xy + variance * by.x * by.y, *yy + variance * by.y * by.y);
    }
    Some(moved)
}

/// Displacement of each corner where all four sides move outward by 1 px.
fn outward(quad: &Quad) -> Option<Quad> {
    let corner = |i: usize| quad.get(i % 4).copied().unwrap_or_default();
    let mut out = *quad;
    for (i, by) in out.iter_mut().enumerate() {
        let normal = |from: Vector2<f64>, to: Vector2<f64>| {
            let along = (to - from).try_normalize(1e-9)?;
            Some(Vector2::new(along.y, -along.x))
        };
        let (a, b) = (normal(corner(i + 3), corner(i))?, normal(corner(i), corner(i + 1))?);
        let det = a.perp(&b);
        // Sine of the angle of a corner: sound quadrilaterals have 0.26 (`quad::MIN_SINE`), so that only what is no number fails here.
        if !(det.abs() > 1e-3) {
            return None;
        }
        *by = Vector2::new(b.y - a.y, a.x - b.x) / det;
    }
    Some(out)
}

/// The growth `delta`, px, its variance, px^2, and the variance of an edge of unit weight as all edges scatter; `None` with too few edges.
fn growth(
    image: &ImageView<'_>,
    corners: &Corners,
    outward: &Quad,
    pattern: &CellPattern,
) -> Option<(f64, f64, f64)> {
    let cells = pattern.cells as f64;
    let mut grown = corners.px;
    for (corner, by) in grown.iter_mut().zip(outward) {
        *corner += by * STEP_PX;
    }
    let scan = GrowthScan {
        image,
        map: PlaneMap::of_square(&corners.px, cells)?,
        grown: PlaneMap::of_square(&grown, cells)?,
        cells,
        blur_px: (corners.blur_px.powi(2) + PIXEL_VARIANCE).sqrt(),
        least_step_px: LEAST_STEP_BLURS * corners.blur_px,
    };
    let middle = |column: usize, row: usize| Vector2::new(column as f64 + 0.5, row as f64 + 0.5);
    let mut levels = [[0.0; MAX_CELLS]; MAX_CELLS];
    for (row, levels) in levels.iter_mut().enumerate().take(pattern.cells) {
        for (column, level) in levels.iter_mut().enumerate().take(pattern.cells) {
            *level = scan.of_cell(middle(column, row));
        }
    }
    let mut edges = [CellEdge::default(); MOST_EDGES];
    let mut count = 0;
    for (row, column, across) in pairs(pattern.cells) {
        let (from, to) = ((column, row), if across { (column + 1, row) } else { (column, row + 1) });
        let of = |(column, row): (usize, usize)| {
            let level = levels.get(row).and_then(|row| row.get(column)).copied().unwrap_or(0.0);
            (pattern.bits_at(column as i32, row as i32) & 1 == 1, (middle(column, row), level))
        };
        let ((white, from), (other_white, to)) = (of(from), of(to));
        if white == other_white {
            continue;
        }
        let (dark, light) = if white { (to, from) } else { (from, to) };
        if let (Some(edge), Some(slot)) = (scan.edge(dark, light), edges.get_mut(count)) {
            *slot = edge;
            count += 1;
        }
    }
    let edges = edges.get(..count)?;
    let (solution, _, of_edge) = least_squares(edges, |_| true)?;
    let most = OUTLIER_SD * OUTLIER_SD * of_edge;
    let (solution, information, variance) =
        least_squares(edges, |e| (e.off_px - e.by.dot(&solution)).powi(2) <= most)?;
    // The corners' own errors move the grid: those of its four sides are independent.
    let corner = corners.covariance_px2.iter().map(|[xx, _, yy]| 0.5 * (xx + yy)).sum::<f64>() / 4.0;
    Some((solution.x, information.x * variance + 0.25 * corner, of_edge))
}

/// Cells with their right and lower neighbours.
fn pairs(cells: usize) -> impl Iterator<Item = (usize, usize, bool)> {
    let all = (0..cells).flat_map(move |row| (0..cells).map(move |column| (row, column)));
    all.flat_map(move |(row, column)| {
        [(true, column + 1 < cells), (false, row + 1 < cells)]
            .into_iter()
            .filter_map(move |(across, is_there)| is_there.then_some((row, column, across)))
    })
}

/// What the edges of one tag are measured with.
struct GrowthScan<'a> {
    image: &'a ImageView<'a>,
    map: PlaneMap,
    /// The same where the four sides have moved out by [`STEP_PX`].
    grown: PlaneMap,
    cells: f64,
    /// Deviation of an edge, blur, pixels and what is put between them, px.
    blur_px: f64,
    least_step_px: f64,
}

impl GrowthScan<'_> {
    fn level(&self, at: Vector2<f64>) -> f64 {
        level_at(self.image, self.map.at(at))
    }

    /// Half width, as share of the cell, of the region about the centre of a cell of `width_px` that is free of its neighbours; and how many samples a
    /// pixel apart fit into it.
    fn clear(&self, width_px: f64) -> (f64, u32) {
        let reach = (0.5 - CLEAR_BLURS * self.blur_px / width_px).clamp(0.0, 0.4);
        (reach, ((2.0 * reach * width_px) as u32 + 1).min(MAX_PLACES))
    }

    /// Mean grey level about the centre of a cell.
    fn of_cell(&self, middle: Vector2<f64>) -> f64 {
        let half = Vector2::new(0.5, 0.5);
        let (a, b) = (self.map.at(middle - half), self.map.at(middle + half));
        let (c, d) =
            (self.map.at(middle + Vector2::new(0.5, -0.5)), self.map.at(middle + Vector2::new(-0.5, 0.5)));
        // the narrower way through a cell
        let (p, q) = (0.5 * (b - a + c - d), 0.5 * (b - a - c + d));
        let area = p.perp(&q).abs();
        let (reach, places) = self.clear(area / p.norm().max(q.norm()));
        let places = places.max(2);
        let reach = reach.max(LEVEL_AROUND);
        let share = |k: u32| reach * ((2.0 * f64::from(k) + 1.0) / f64::from(places) - 1.0);
        let mut sum = 0.0;
        for (i, k) in (0..places).flat_map(|i| (0..places).map(move |k| (i, k))) {
            sum += self.level(middle + Vector2::new(share(i), share(k)));
        }
        sum / f64::from(places * places)
    }

    /// Position of the edge between two neighbouring cells, given their centres and levels, from the mean level in a window across it.
    fn edge(&self, (from, ink): (Vector2<f64>, f64), (to, paper): (Vector2<f64>, f64)) -> Option<CellEdge> {
        let map = &self.map;
        let along = Vector2::new(to.y - from.y, to.x - from.x);
        let (start, end) = (map.at(from), map.at(to));
        let length = (end - start).norm();
        let d = (end - start) / length;
        let at = 0.5 * (from + to);
        let border = map.at(at + along * 0.5) - map.at(at - along * 0.5);
        let normal = Vector2::new(border.y, -border.x).try_normalize(1e-9)?;
        let towards_dark = if normal.dot(&d) > 0.0 { -normal } else { normal };
        let square = towards_dark.dot(&d).abs();
        // The area under the edge is divided by this difference, levels, which must be more than its noise. Chosen by hand: a tag whose contrast
        // is 10 at least has no step of half as much in its middle, and the double would leave out all edges of the faintest tags.
        if !(length * square >= self.least_step_px && paper - ink >= 5.0) {
            return None;
        }
        // half of the window, share of the way from middle to middle
        let half = (WINDOW_BLURS * self.blur_px / (length * square)).min(0.5);
        // Five samples for each four pixels of the window, so that no pixel is left out; at least 4 and at most 64, which bounds the loop and is
        // enough for windows of 51 px. Half as many in a long window would skip pixels and give their noise away.
        let steps = (2.5 * half * length).ceil().clamp(4.0, 64.0);
        let (reach, lines) = self.clear(border.norm() * square);
        let (mut bright, mut line_at) = (0.0, 0.0);
        for line in 0..lines {
            let shift = along * (reach * ((2.0 * f64::from(line) + 1.0) / f64::from(lines) - 1.0));
            let (a, b) = (map.at(from + shift), map.at(to + shift));
            let way = b - a;
            let mut sum = 0.0;
            let (first, step) = (a + way * (0.5 - half + half / steps), way * (2.0 * half / steps));
            for k in 0..steps as u32 {
                sum += level_at(self.image, first + step * f64::from(k));
            }
            bright += (sum / steps - ink) / (paper - ink);
            // where the grid's line crosses the way
            line_at += (map.at(at + shift) - a).dot(&way) / way.norm_squared();
        }
        let (bright, line_at) = (bright / f64::from(lines), line_at / f64::from(lines));
        // From the dark cell to the light one: bright is the share behind the edge.
        let off_px = (line_at - (0.5 - half) - 2.0 * half * (1.0 - bright)) * length;
        let motion = (self.grown.at(at) - map.at(at)) / STEP_PX;
        // in cells: half of the tag is 1
        let x = at * (2.0 / self.cells) - Vector2::repeat(1.0);
        let bow = (map.at(at + x * ((4.0 / 3.0 - x.norm_squared()) * STEP_PX)) - map.at(at)) / STEP_PX;
        let lit = -0.5 * half * (1.0 - half) * length * length * square;
        let by = Vector4::new(1.0 + towards_dark.dot(&motion), lit * d.x, lit * d.y, towards_dark.dot(&bow));
        // an area of many pixels is noisier, the mean of many lines less
        let weight = (f64::from(lines) / (half * length)).sqrt() / square;
        Some(CellEdge { by: by * weight, off_px: off_px * square * weight })
    }
}

/// Solution, diagonal of the inverse of the normal matrix, and variance of an edge of unit weight.
fn least_squares(
    edges: &[CellEdge],
    used: impl Fn(&CellEdge) -> bool,
) -> Option<(Vector4<f64>, Vector4<f64>, f64)> {
    let (mut A, mut b, mut count) = (Matrix4::zeros(), Vector4::zeros(), 0);
    for edge in edges.iter().filter(|e| used(e)) {
        A += edge.by * edge.by.transpose();
        b += edge.by * edge.off_px;
        count += 1;
    }
    if count < LEAST_EDGES {
        return None;
    }
    let inverse = A.try_inverse()?;
    let solution = inverse * b;
    let squares = edges.iter().filter(|e| used(e)).map(|e| (e.off_px - e.by.dot(&solution)).powi(2));
    Some((solution, inverse.diagonal(), squares.sum::<f64>() / (count - UNKNOWNS) as f64))
}
