//! By how much light areas look too large: found by a tag's own edges, and taken off its corners.
//!
//! A camera that bends its levels (gamma), light that spreads, and ink that shrinks move every edge towards its dark side by the same
//! way. The sides of the black square are moved inward, the edges of white cells outward. Between the lines of a grid that is laid into the
//! corners as they were measured, an edge inside the tag then lies off its line by
//!
//! ```text
//! off = delta (1 + u . p') - (a . d) L^2 / 8 + c u . f        u: unit normal of the edge towards its dark side, d: from dark to light
//! ```
//! with the growth `delta`, the motion `p'` of the grid's line where the four sides move out by 1 px, the share `a` by which the light
//! grows per px, which moves the middle of a step of length `L` between the middles of two cells, and the bow `c` of a lens: it moves a place `x`
//! of the tag, from -1 to 1 each way, by `f = x (4/3 - x . x)`, which is nothing in the mean of each side, where the corners come from.
//! Least squares over all edges between a black and a white cell give `delta`, `a` and `c`.

use super::decode::level_at;
use super::edges::{Corners, SHARP_CELL_BLURS};
use super::pattern::{CellPattern, MAX_CELLS};
use super::plane_map::PlaneMap;
use super::quad::Quad;
use crate::imaging::ImageView;
use nalgebra::{Matrix4, Vector2, Vector4};

/// Steps between the middles of cells take part from so many deviations of the blur on: at half of it a normal blur still shows 2e-4
/// of a step. Of a tag that is seen aslant those of one direction are shorter, and the others tell enough.
const LEAST_STEP_BLURS: f64 = 7.0;
/// Corners that were fitted to the whole tag, because its cells are narrower than their sides need, have not moved by just that. Tuned on
/// the test's own views: by gammas of 1.4 to 2.4, with this share the stated deviations of such tags hold.
const DOUBT_OF_FITTED: f64 = 0.35;
/// Growth, light in both directions, bow.
const UNKNOWNS: usize = 4;
/// Fewest edges of which something is learnt: twice the unknowns. A 16h5 that is seen aslant has some ten.
const LEAST_EDGES: usize = 2 * UNKNOWNS;
/// Each edge is looked at along so many lines across it, by shares of a cell from its middle.
const LINES: [f64; 3] = [-0.15, 0.0, 0.15];
/// A level is the mean of places so far about the middle of a cell, shares of it.
const LEVEL_AROUND: f64 = 0.08;
/// Edges that lie off by more than so many deviations take no part: something covers them.
const OUTLIER_SD: f64 = 3.0;
/// A growth below so many deviations is none: a linear camera has none, and its corners stay as exact as they are. One in 16 000
/// of its tags is moved.
const TOLD_SD: f64 = 4.0;
/// A gamma of 2.4 moves the edge of a black without any light by 0.92 deviations of the blur (0.62 where it has a hundredth of the
/// white's, 0.26 where it has a fifth): the area under the bent normal step. What has grown by more is a print or a drawing.
const MOST_BLURS: f64 = 1.0;
/// Step for the motion of the grid's lines, px: their motion is a rational function of it, of which this keeps the first order.
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

/// The corners, with what light areas have grown by taken off where it is told from none.
pub(super) fn corrected(image: &ImageView<'_>, corners: Corners, pattern: &CellPattern) -> Corners {
    let Some(outward) = outward(&corners.px) else { return corners };
    let Some((growth_px, variance)) = growth(image, &corners, &outward, pattern) else { return corners };
    // In this form what is no number is none.
    if !(growth_px * growth_px > TOLD_SD * TOLD_SD * variance
        && growth_px.abs() <= corners.blur_px * MOST_BLURS)
    {
        return corners;
    }
    let doubt = if corners.cell_blurs < SHARP_CELL_BLURS { DOUBT_OF_FITTED * growth_px } else { 0.0 };
    let variance = variance + doubt * doubt;
    let mut moved = corners;
    for ((corner, covariance), by) in moved.px.iter_mut().zip(&mut moved.covariance_px2).zip(&outward) {
        *corner += by * growth_px;
        let [xx, xy, yy] = covariance;
        (*xx, *xy, *yy) =
            (*xx + variance * by.x * by.x, *xy + variance * by.x * by.y, *yy + variance * by.y * by.y);
    }
    moved
}

/// How each corner moves where all four sides move out by 1 px.
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
        if !(det.abs() > 1e-3) {
            return None;
        }
        *by = Vector2::new(b.y - a.y, a.x - b.x) / det;
    }
    Some(out)
}

/// `delta` and its variance, px^2.
fn growth(
    image: &ImageView<'_>,
    corners: &Corners,
    outward: &Quad,
    pattern: &CellPattern,
) -> Option<(f64, f64)> {
    let cells = pattern.cells as f64;
    let map = PlaneMap::of_square(&corners.px, cells)?;
    let mut grown = corners.px;
    for (corner, by) in grown.iter_mut().zip(outward) {
        *corner += by * STEP_PX;
    }
    let grown = PlaneMap::of_square(&grown, cells)?;
    let mut edges = [CellEdge::default(); MOST_EDGES];
    let mut count = 0;
    for (row, column, across) in pairs(pattern.cells) {
        let white = |column: usize, row: usize| pattern.bits_at(column as i32, row as i32) & 1 == 1;
        let (from, to) = ((column, row), if across { (column + 1, row) } else { (column, row + 1) });
        if white(from.0, from.1) == white(to.0, to.1) {
            continue;
        }
        let (dark, light) = if white(from.0, from.1) { (to, from) } else { (from, to) };
        let min_px = LEAST_STEP_BLURS * corners.blur_px;
        if let (Some(edge), Some(slot)) =
            (edge(image, (&map, &grown), (dark, light), (cells, min_px)), edges.get_mut(count))
        {
            *slot = edge;
            count += 1;
        }
    }
    let edges = edges.get(..count)?;
    let (solution, _, variance) = least_squares(edges, |_| true)?;
    let most = OUTLIER_SD * OUTLIER_SD * variance;
    let (solution, information, variance) =
        least_squares(edges, |e| (e.off_px - e.by.dot(&solution)).powi(2) <= most)?;
    // The corners' own errors move the grid: those of its four sides are independent.
    let corner = corners.covariance_px2.iter().map(|[xx, _, yy]| 0.5 * (xx + yy)).sum::<f64>() / 4.0;
    Some((solution.x, information.x * variance + 0.25 * corner))
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

/// The edge between two neighbours, by the area under the levels from the middle of one to that of the other.
fn edge(
    image: &ImageView<'_>,
    (map, grown): (&PlaneMap, &PlaneMap),
    (dark, light): ((usize, usize), (usize, usize)),
    (cells, min_px): (f64, f64),
) -> Option<CellEdge> {
    let middle = |(column, row): (usize, usize)| Vector2::new(column as f64 + 0.5, row as f64 + 0.5);
    let (from, to) = (middle(dark), middle(light));
    let along = Vector2::new(to.y - from.y, to.x - from.x);
    let (start, end) = (map.at(from), map.at(to));
    let length = (end - start).norm();
    let d = (end - start) / length;
    let at = 0.5 * (from + to);
    let border = map.at(at + along * 0.5) - map.at(at - along * 0.5);
    let normal = Vector2::new(border.y, -border.x).try_normalize(1e-9)?;
    let towards_dark = if normal.dot(&d) > 0.0 { -normal } else { normal };
    let square = towards_dark.dot(&d).abs();
    if !(length * square >= min_px) {
        return None;
    }
    let level = |p: Vector2<f64>| level_at(image, map.at(p));
    let of_cell = |p: Vector2<f64>| {
        let around = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        0.25 * around.iter().map(|(x, y)| level(p + Vector2::new(*x, *y) * LEVEL_AROUND)).sum::<f64>()
    };
    let (ink, paper) = (of_cell(from), of_cell(to));
    if !(paper - ink >= 5.0) {
        return None;
    }
    let steps = (1.25 * length).ceil().clamp(4.0, 64.0);
    let (mut bright, mut line_at) = (0.0, 0.0);
    for lateral in LINES {
        let shift = along * lateral;
        let (a, b) = (map.at(from + shift), map.at(to + shift));
        let way = b - a;
        let mut sum = 0.0;
        for k in 0..steps as u32 {
            sum += level_at(image, a + way * ((f64::from(k) + 0.5) / steps));
        }
        bright += (sum / steps - ink) / (paper - ink);
        // where the grid's line crosses the way
        line_at += (map.at(at + shift) - a).dot(&way) / way.norm_squared();
    }
    let (bright, line_at) = (bright / LINES.len() as f64, line_at / LINES.len() as f64);
    // From the dark cell to the light one: bright is the share behind the edge.
    let off_px = (line_at - (1.0 - bright)) * length;
    let motion = (grown.at(at) - map.at(at)) / STEP_PX;
    // in cells: half of the tag is 1
    let x = at * (2.0 / cells) - Vector2::repeat(1.0);
    let bow = (map.at(at + x * ((4.0 / 3.0 - x.norm_squared()) * STEP_PX)) - map.at(at)) / STEP_PX;
    let lit = -length * length / 8.0 * square;
    Some(CellEdge {
        by: Vector4::new(1.0 + towards_dark.dot(&motion), lit * d.x, lit * d.y, towards_dark.dot(&bow)),
        off_px: off_px * square,
    })
}

/// The unknowns, the diagonal of their inverse information, and the variance of an edge.
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
