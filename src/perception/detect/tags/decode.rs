//! Decoding: the bits of a quadrilateral, read with a model of its own illumination.
//!
//! The levels of paper and ink are modelled by a plane each over the tag, fitted to samples of the white margin and of the black border. A bit is
//! white where the middle of its cell is lighter than the mean of both planes there.

use super::codebook::{Codebook, Reading};
use super::likeness::likeness;
use super::pattern::{CellPattern, MAX_CELLS, Whites};
use super::plane_map::PlaneMap;
use super::quad::Quad;
use super::shine::Inside;
use crate::imaging::{ImageView, MAX_LEVEL};
use crate::target::TagFamily;
use nalgebra::Vector2;

/// Least difference between paper and ink in the middle of the tag, grey levels. Chosen by hand, as much as the finder's threshold asks for at
/// least: half reads tags whose contrast is little more than noise of 2 levels, the double loses tags in deep shadow.
const MIN_CONTRAST: f64 = 10.0;
/// Shares of the samples of the border and of the margin (4 for each cell of a side) that may be nearer to the other colour. Chosen by hand: of the
/// border two samples (of 16h5 one), of the margin four to six, because what stands beside a tag covers its margin more easily. Half allows one
/// sample of the border (of 16h5 none), so that a glint on a corner cell, which two samples read, refuses the tag; the double allows three to five.
const WRONG_BORDER_SHARE: f64 = 0.08;
const WRONG_MARGIN_SHARE: f64 = 0.2;
/// From this share of the margin's samples on at the end of levels the paper counts as clipped. A sample lies between four pixels and is at the
/// end only where all of them are: noise does that in a tenth of the places where it lifts 0.1^(1/4) = 56 % of the pixels there, so that
/// the paper's own level would lie beyond the end. Half asks for 47 %, the double for 67 %.
const CLIPPED_SHARE: f64 = 0.1;
/// Narrower cells are read in their middle alone and sharpened, wider ones as a mean of four places, px. Chosen by hand: at a blur of 1 px each
/// neighbour contributes 2 % of its step to the middle of a cell of 4 px, 16 % to one of half the width, which needs sharpening, and 3e-5
/// to one of twice the width, which does not.
const SHARP_CELL_PX: f64 = 4.0;
/// Share of the Laplacian over the four neighbouring cells that sharpens a narrow cell, as AprilTag 3 does: its default of
/// `decode_sharpening`, with the same kernel.
const SHARPENING: f64 = 0.25;
/// Least mean distance of the bits from their threshold, in half contrasts: what is no tag shows greys. Chosen by hand: levels that are evenly
/// distributed between ink and paper have 0.5, so that this refuses what lies mostly near the threshold; half refuses hardly anything, the
/// double refuses blurred tags.
const MIN_CLEARNESS: f64 = 0.35;

/// Samples of the margin or of the border that lie off their plane alike by so many deviations of chance show a light that is none of a plane. Chosen
/// by hand: noise does it once in 4 000; half doubts one honest tag in 12, with the double, which takes 49 samples, none would be.
const RING_SDS: f64 = 3.5;

/// Why a quadrilateral is no tag of the family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum NoTag {
    /// No black border in a white margin.
    Border,
    /// Neither black nor white inside.
    Unclear,
    /// The bits are no code of the family.
    NoCode,
}

/// A decoded tag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Decoded {
    pub(super) reading: Reading,
    /// Decision margin: mean distance of the bits' levels from their threshold, the smaller mean of white and black bits, grey levels.
    pub(super) margin_levels: f64,
    pub(super) light_level: f64,
    pub(super) dark_level: f64,
    /// Whether the paper is clipped: at the last grey level, so that its true lightness is unknown.
    pub(super) clipped: bool,
    /// Whether the light on the margin or the border is not that of a plane: neighbouring places lie off it more alike than noise would.
    pub(super) uneven: bool,
    /// Colours of the cells inside each side of the quadrilateral.
    pub(super) inside: [Inside; 4],
    /// Colours of all cells.
    pub(super) pattern: CellPattern,
}

/// A plane of grey levels over the tag: level at its centre, and slopes per half side.
#[derive(Debug, Clone, Copy, Default)]
struct LightPlane {
    middle: f64,
    along_x: f64,
    along_y: f64,
}

impl LightPlane {
    fn at(&self, u: f64, v: f64) -> f64 {
        self.middle + self.along_x * u + self.along_y * v
    }
}

/// Bilinearly interpolated grey level at a point (px); beyond the image that of its edge.
#[inline]
pub(super) fn level_at(image: &ImageView<'_>, at: Vector2<f64>) -> f64 {
    // coordinates of frames fit into 32 bits, to which less is converted
    let (x0, y0) = (at.x as u32, at.y as u32);
    let (fx, fy) = (at.x - f64::from(x0), at.y - f64::from(y0));
    if fx >= 0.0
        && fy >= 0.0
        && let Some(four) = image.four(x0 as usize, y0 as usize)
    {
        return between(four, fx, fy);
    }
    level_at_edge(image, at)
}

/// Bilinear interpolation, a share of a pixel to the right and down.
#[inline(always)]
fn between([[a, b], [c, d]]: [[u8; 2]; 2], fx: f64, fy: f64) -> f64 {
    let part = |a: u8, b: u8| f64::from(a) + fx * f64::from(i16::from(b) - i16::from(a));
    let (above, below) = (part(a, b), part(c, d));
    above + fy * (below - above)
}

/// The same at the image's edge and beyond it.
#[cold]
fn level_at_edge(image: &ImageView<'_>, at: Vector2<f64>) -> f64 {
    let inside = |p: f64, size: usize| p.clamp(0.0, size as f64 - 1.0);
    let (x, y) = (inside(at.x, image.width()), inside(at.y, image.height()));
    let (x0, y0) = (x as usize, y as usize);
    let level = |x: usize, y: usize| {
        let row = image.row(y.min(image.height() - 1));
        row.get(x.min(image.width() - 1)).copied().unwrap_or(0)
    };
    let four = [[level(x0, y0), level(x0 + 1, y0)], [level(x0, y0 + 1), level(x0 + 1, y0 + 1)]];
    between(four, x - x0 as f64, y - y0 as f64)
}

/// Decodes the tag whose black border has the corners `quad`, px, correcting at most `max_wrong` bits.
pub(super) fn decode(
    image: &ImageView<'_>,
    quad: &Quad,
    book: &Codebook,
    family: TagFamily,
    max_wrong: u32,
) -> Result<Decoded, NoTag> {
    let cells = family.cells_per_side() as usize;
    let n = cells as f64;
    let map = PlaneMap::of_square(quad, n).ok_or(NoTag::Border)?;
    let level = |column: f64, row: f64| level_at(image, map.at(Vector2::new(column, row)));
    // -1 to 1 over the black square
    let unit = |x: f64| 2.0 * x / n - 1.0;

    let mut border = [(0.0, 0.0, 0.0); 4 * MAX_CELLS];
    let mut margin = [(0.0, 0.0, 0.0); 4 * MAX_CELLS];
    let ring = |places: &mut [(f64, f64, f64)], low: f64, high: f64| {
        let sides = places.chunks_mut(4).take(cells);
        for (i, four) in sides.enumerate() {
            let s = i as f64 + 0.5;
            for (slot, (x, y)) in four.iter_mut().zip([(s, low), (s, high), (low, s), (high, s)]) {
                *slot = (unit(x), unit(y), level(x, y));
            }
        }
    };
    ring(&mut border, 0.5, n - 0.5);
    ring(&mut margin, -0.5, n + 0.5);
    let border = border.get(..4 * cells).unwrap_or(&[]);
    let margin = margin.get(..4 * cells).unwrap_or(&[]);
    let (ink, paper) = (plane(border), plane(margin));
    if !(paper.middle - ink.middle >= MIN_CONTRAST) {
        return Err(NoTag::Border);
    }
    let full = margin.iter().filter(|(_, _, p)| *p >= MAX_LEVEL).count();
    let clipped = full as f64 > CLIPPED_SHARE * margin.len() as f64;
    let half =
        |u: f64, v: f64| (0.5 * (paper.at(u, v) + ink.at(u, v)), 0.5 * (paper.at(u, v) - ink.at(u, v)));
    let wrong = |places: &[(f64, f64, f64)], white: bool| {
        places.iter().filter(|(u, v, p)| (*p > half(*u, *v).0) != white).count() as f64 / places.len() as f64
    };
    if wrong(border, false) > WRONG_BORDER_SHARE || wrong(margin, true) > WRONG_MARGIN_SHARE {
        return Err(NoTag::Border);
    }

    // cells as deviations from their thresholds, in grey levels; black border around them
    let mut values = [[0.0f64; MAX_CELLS]; MAX_CELLS];
    let width_px = side_px(quad) / n;
    for row in 0..cells {
        for column in 0..cells {
            let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
            let (threshold, contrast) = half(unit(x), unit(y));
            let inner = (1..cells - 1).contains(&row) && (1..cells - 1).contains(&column);
            let value = if !inner {
                -contrast
            } else if width_px < SHARP_CELL_PX {
                level(x, y) - threshold
            } else {
                let d = 0.2;
                let around =
                    level(x - d, y - d) + level(x + d, y - d) + level(x - d, y + d) + level(x + d, y + d);
                0.25 * around - threshold
            };
            if let Some(slot) = values.get_mut(row).and_then(|r| r.get_mut(column)) {
                *slot = value;
            }
        }
    }
    let value =
        |column: usize, row: usize| values.get(row).and_then(|r| r.get(column)).copied().unwrap_or(0.0);
    let (mut word, mut clearness) = (0u64, 0.0);
    let (mut whites, mut blacks) = ((0.0, 0.0), (0.0, 0.0));
    for bit in 0..family.bits() {
        let (column, row) = family.place(bit);
        let (column, row) = (column as usize, row as usize);
        let mut v = value(column, row);
        if width_px < SHARP_CELL_PX {
            let around = value(column - 1, row)
                + value(column + 1, row)
                + value(column, row - 1)
                + value(column, row + 1);
            v += SHARPENING * (4.0 * v - around);
        }
        let (_, contrast) = half(unit(column as f64 + 0.5), unit(row as f64 + 0.5));
        clearness += (v.abs() / contrast.max(1.0)).min(1.0);
        let sums = if v > 0.0 { &mut whites } else { &mut blacks };
        *sums = (sums.0 + v.abs(), sums.1 + 1.0);
        word = word << 1 | u64::from(v > 0.0);
    }
    let bits = f64::from(family.bits());
    if clearness / bits < MIN_CLEARNESS {
        return Err(NoTag::Unclear);
    }
    let reading = book.read(word, max_wrong).ok_or(NoTag::NoCode)?;
    let mean = |(sum, count): (f64, f64)| if count > 0.0 { sum / count } else { f64::INFINITY };
    let margin_levels = mean(whites).min(mean(blacks));
    let white = white(family, &reading);
    let inside = inside(&white, cells, &paper, quad);
    let pattern = CellPattern::new(&white, cells);
    Ok(Decoded {
        reading,
        margin_levels,
        light_level: paper.middle,
        dark_level: ink.middle,
        clipped,
        uneven: uneven(border, &ink) || uneven(margin, &paper),
        inside,
        pattern,
    })
}

fn white(family: TagFamily, reading: &Reading) -> Whites {
    let code = family.codes().get(reading.id as usize).copied().unwrap_or(0);
    let word = family.turned(code, reading.turns);
    let mut white = [[0.0; MAX_CELLS]; MAX_CELLS];
    for bit in 0..family.bits() {
        let (column, row) = family.place(bit);
        if let Some(cell) = white.get_mut(row as usize).and_then(|r| r.get_mut(column as usize)) {
            *cell = f64::from((word >> (family.bits() - 1 - bit) & 1) as u32);
        }
    }
    white
}

/// For each side the colours of the two rows of cells inside the border, and the slope of the light, as a decoded tag tells them.
fn inside(white: &Whites, cells: usize, paper: &LightPlane, quad: &Quad) -> [Inside; 4] {
    let last = cells - 1;
    let growth = growth(paper, quad);
    let mut sides = [Inside { white: [[0.0; MAX_CELLS]; 2], cells, light_per_px: Vector2::zeros() }; 4];
    for (i, (side, growth)) in sides.iter_mut().zip(growth).enumerate() {
        side.light_per_px = growth;
        for (depth, line) in side.white.iter_mut().enumerate() {
            let depth = depth + 1;
            for (k, slot) in line.iter_mut().enumerate().take(cells) {
                let (column, row) = match i {
                    0 => (k, depth),
                    1 => (last - depth, k),
                    2 => (last - k, last - depth),
                    _ => (depth, last - k),
                };
                *slot = white.get(row).and_then(|r| r.get(column)).copied().unwrap_or(0.0);
            }
        }
    }
    sides
}

/// Relative slope of the illumination in x and y at the middle of each side, 1/px.
fn growth(paper: &LightPlane, quad: &Quad) -> [Vector2<f64>; 4] {
    let [a, b, c, d] = *quad;
    // half sides of the tag, as the image shows them
    let (x, y) = (0.25 * (b - a + c - d), 0.25 * (d - a + c - b));
    let gradient =
        Vector2::new(paper.along_x * y.y - paper.along_y * x.y, paper.along_y * x.x - paper.along_x * y.x)
            / x.perp(&y);
    [(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)].map(|(u, v)| gradient / paper.at(u, v).max(1.0))
}

/// Mean length of the sides, px.
pub(super) fn side_px(quad: &Quad) -> f64 {
    let [a, b, c, d] = *quad;
    0.25 * ((b - a).norm() + (c - b).norm() + (d - c).norm() + (a - d).norm())
}

/// Whether the samples of a ring lie off their plane alike: the four sides' samples take turns.
fn uneven(ring: &[(f64, f64, f64)], plane: &LightPlane) -> bool {
    let off = |&(u, v, p): &(f64, f64, f64)| p - plane.at(u, v);
    let squares: f64 = ring.iter().map(|sample| off(sample).powi(2)).sum();
    let steps: f64 = ring.iter().zip(ring.iter().skip(4)).map(|(a, b)| (off(a) - off(b)).powi(2)).sum();
    let n = ring.len() as f64;
    // a plane takes up three degrees of freedom
    let z = likeness(steps / (n - 4.0), squares / (n - 3.0), n);
    z > RING_SDS
}

/// Least squares plane through samples that lie evenly on the four sides of a square about the middle.
fn plane(samples: &[(f64, f64, f64)]) -> LightPlane {
    let (mut n, mut sum, mut uu, mut vv, mut up, mut vp) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for &(u, v, p) in samples {
        n += 1.0;
        sum += p;
        uu += u * u;
        vv += v * v;
        up += u * p;
        vp += v * p;
    }
    if n < 1.0 {
        return LightPlane::default();
    }
    LightPlane { middle: sum / n, along_x: up / uu, along_y: vp / vv }
}
