//! Edges one pixel thin, Sect. 10.2.1: gradient by Sobel, non-maximum suppression across the edge, threshold with hysteresis.
//!
//! A pixel is kept when its magnitude is greater than `low` and, of the three pixels in the direction of its gradient (rounded to
//! 45 degrees), the greatest; it is an edge when a path of kept neighbours leads from it to one above `high`. Beyond the image the
//! magnitude is 0. Everything happens on three rows at a time: no plane is written, and flat areas cost a comparison.
//!
//! Magnitudes are those of the Sobel operator, 8 times the slope per pixel; [`Norm::Euclidean`] in 32nds, rounded.

mod thin;

use super::ImageView;
use thin::RowWindow;

/// No edge.
pub(super) const NONE: u32 = u32::MAX;

/// Which magnitude the thresholds are for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Norm {
    /// `|Δ1| + |Δ2|`: fast, up to 1.41 times greater along the diagonals.
    #[default]
    Sum,
    /// `sqrt(Δ1^2 + Δ2^2)`: the same in all directions.
    Euclidean,
}

/// What counts as an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeThresholds {
    /// An edge has a pixel with a greater magnitude, in units of the Sobel operator.
    pub high: f32,
    /// All of its pixels have.
    pub low: f32,
    /// Magnitude of which?
    pub norm: Norm,
}

impl Default for EdgeThresholds {
    /// A step of 30 grey levels over a blurred edge, and one of 12.
    fn default() -> Self {
        Self { high: 100.0, low: 40.0, norm: Norm::Sum }
    }
}

/// A pixel of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgePixel {
    /// Column, px.
    pub column: u32,
    /// Row, px.
    pub row: u32,
    /// Where the edge crosses this row (where the gradient lies closer to the rows), or this column: column, px.
    pub x_px: f32,
    /// The same: row, px.
    pub y_px: f32,
    /// `Δ1` of the Sobel operator.
    pub dx: i16,
    /// `Δ2`.
    pub dy: i16,
}

/// The edges of an image, in reading order. The buffers are reused.
#[derive(Debug, Clone)]
pub struct Edges {
    pixels: Vec<EdgePixel>,
    around: Vec<Around>,
    kept: Vec<EdgeCandidate>,
    limit: usize,
    overflowed: bool,
    rows: RowWindow,
}

/// The up to eight neighbours of an edge pixel. In reading order those of one row follow each other.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Around {
    /// Bit 0 for the one on the right, then below right, below and on around.
    mask: u8,
    /// The first of those above.
    above: u32,
    /// The first of those below.
    below: u32,
}

impl Around {
    /// Indices of the neighbours of pixel `me`.
    #[inline]
    pub(super) fn indices(self, me: u32) -> impl Iterator<Item = u32> {
        let above = (self.mask & 0b1110_0000).count_ones();
        let below = (self.mask & 0b0000_1110).count_ones();
        let left = u32::from(self.mask & 0b0001_0000 != 0);
        let right = u32::from(self.mask & 1);
        let row = (me - left..me).chain(me + 1..me + 1 + right);
        (self.above..self.above + above).chain(row).chain(self.below..self.below + below)
    }

    #[inline]
    fn tie(&mut self, direction: usize, other: u32) {
        // the first that is told is the first of its row
        if direction > 4 && self.mask & 0b1110_0000 == 0 {
            self.above = other;
        }
        if (1..4).contains(&direction) && self.mask & 0b0000_1110 == 0 {
            self.below = other;
        }
        self.mask |= 1 << direction;
    }
}

/// A pixel that is greatest across its edge, before it is known whether the edge is strong.
#[derive(Debug, Clone, Copy)]
struct EdgeCandidate {
    column: u32,
    row: u32,
    dx: i16,
    dy: i16,
    /// The gradient across the edge before this pixel, here, and behind it.
    across: [f32; 3],
    around: Around,
    /// A pixel that this one hangs together with, nearer to the first of all; of the first itself. Later, the place in the result.
    parent: u32,
    /// Whether the edge that starts here has a pixel above the high threshold.
    strong: bool,
}

impl Edges {
    /// Buffers for at most `limit` edge pixels. Their memory is taken as it is needed first.
    #[must_use]
    pub fn with_limit(limit: usize) -> Self {
        Self {
            pixels: Vec::new(),
            around: Vec::new(),
            kept: Vec::new(),
            limit: limit.min(NONE as usize - 1),
            overflowed: false,
            rows: RowWindow::default(),
        }
    }

    /// The edge pixels found last, row by row.
    #[must_use]
    pub fn pixels(&self) -> &[EdgePixel] {
        &self.pixels
    }

    /// The neighbours of each pixel.
    pub(super) fn around(&self) -> &[Around] {
        &self.around
    }

    /// Whether the last image had more edge pixels than the buffers take (noise, a fine texture): the lower rows are missing.
    #[must_use]
    pub fn overflowed(&self) -> bool {
        self.overflowed
    }

    /// Finds the edges of an image.
    pub fn find(&mut self, image: &ImageView<'_>, thresholds: &EdgeThresholds) {
        self.kept.clear();
        self.overflowed = false;
        let scale = if thresholds.norm == Norm::Sum { 1.0 } else { 32.0 };
        // casts saturate; NaN becomes 0
        let [low, high] = [thresholds.low, thresholds.high].map(|t| (t * scale) as u16);
        let mut rows = std::mem::take(&mut self.rows);
        rows.start(image.width());
        let mut above = 0..0;
        for y in 0..=image.height() {
            rows.push(image, y, thresholds.norm);
            if y == 0 {
                continue;
            }
            rows.thin(low);
            let start = self.kept.len();
            if start + rows.kept().len() > self.limit {
                self.overflowed = true;
                break;
            }
            let mut from = above.start;
            for &x in rows.kept() {
                let Some(pixel) = rows.pixel(x, y as u32 - 1, high) else { continue };
                self.add(pixel, &mut from, above.end, start);
            }
            above = start..self.kept.len();
        }
        self.rows = rows;
        self.keep_strong();
    }

    /// Appends a pixel of the row that starts at `start` and ties it to its neighbours. `from` moves along the row above.
    #[inline]
    fn add(&mut self, pixel: EdgeCandidate, from: &mut usize, above_end: usize, start: usize) {
        let me = self.kept.len();
        self.kept.push(EdgeCandidate { parent: me as u32, ..pixel });
        let column = |edges: &Self, i: usize| edges.kept.get(i).map_or(0, |p| p.column);
        if me > start && column(self, me - 1) + 1 == pixel.column {
            self.tie(me, me - 1, 4);
        }
        while *from < above_end && column(self, *from) + 1 < pixel.column {
            *from += 1;
        }
        for other in *from..(*from + 3).min(above_end) {
            match i64::from(pixel.column) - i64::from(column(self, other)) {
                1 => self.tie(me, other, 5),
                0 => self.tie(me, other, 6),
                -1 => self.tie(me, other, 7),
                _ => break,
            }
        }
    }

    /// Makes two pixels neighbours: `other` lies in `direction` of `me`.
    #[inline]
    fn tie(&mut self, me: usize, other: usize, direction: usize) {
        let (mut a, mut b) = (0, 0);
        if let Some(kept) = self.kept.get_mut(me) {
            kept.around.tie(direction, other as u32);
            a = kept.parent;
        }
        if let Some(kept) = self.kept.get_mut(other) {
            kept.around.tie((direction + 4) % 8, me as u32);
            b = kept.parent;
        }
        if a == b {
            return;
        }
        (a, b) = (self.first_of(a), self.first_of(b));
        let (first, second) = (a.min(b), a.max(b));
        let mut strong = false;
        if let Some(kept) = self.kept.get_mut(second as usize) {
            kept.parent = first;
            strong = kept.strong;
        }
        if let Some(kept) = self.kept.get_mut(first as usize) {
            kept.strong |= strong;
        }
        if let Some(kept) = self.kept.get_mut(me) {
            kept.parent = first;
        }
    }

    /// The first pixel of the edge that a pixel belongs to.
    fn first_of(&mut self, mut i: u32) -> u32 {
        while let Some(parent) = self.kept.get(i as usize).map(|k| k.parent)
            && parent != i
        {
            // every second step leads to the parent's parent from now on
            let next = self.kept.get(parent as usize).map_or(parent, |k| k.parent);
            if let Some(kept) = self.kept.get_mut(i as usize) {
                kept.parent = next;
            }
            i = next;
        }
        i
    }

    /// The result: the edges that have a strong pixel.
    fn keep_strong(&mut self) {
        for i in 0..self.kept.len() {
            let first = self.first_of(i as u32) as usize;
            let strong = self.kept.get(first).is_some_and(|k| k.strong);
            if let Some(kept) = self.kept.get_mut(i) {
                kept.strong = strong;
            }
        }
        let mut count = 0;
        for kept in &mut self.kept {
            kept.parent = if kept.strong { count } else { NONE };
            count += u32::from(kept.strong);
        }
        self.pixels.clear();
        self.around.clear();
        self.pixels.extend(self.kept.iter().filter(|k| k.strong).map(EdgeCandidate::place));
        // all neighbours of a pixel stay with it
        let place = |i: u32| self.kept.get(i as usize).map_or(0, |k| k.parent);
        let moved = |a: Around| Around { mask: a.mask, above: place(a.above), below: place(a.below) };
        self.around.extend(self.kept.iter().filter(|k| k.strong).map(|k| moved(k.around)));
    }
}

impl EdgeCandidate {
    /// With its place to a fraction of a pixel. Across the edge the gradient is a bell, its logarithm a parabola, with the vertex where
    /// the edge is.
    #[inline]
    fn place(&self) -> EdgePixel {
        let [p, m, n] = self.across;
        let (bend, lean) = if p > 0.0 && n > 0.0 {
            let [p, m, n] = [p, m, n].map(log2);
            (2.0 * m - p - n, n - p)
        } else {
            (2.0 * m - p - n, n - p)
        };
        let shift = if bend > 0.0 { (0.5 * lean / bend).clamp(-1.0, 1.0) } else { 0.0 };
        let (x, y) = (self.column as f32, self.row as f32);
        let along_row = self.dx.unsigned_abs() >= self.dy.unsigned_abs();
        let (x_px, y_px) = if along_row { (x + shift, y) } else { (x, y + shift) };
        EdgePixel { column: self.column, row: self.row, x_px, y_px, dx: self.dx, dy: self.dy }
    }
}

/// Logarithm of a positive normal number, to 1e-4.
#[inline(always)]
fn log2(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let t = f32::from_bits(bits & 0x7f_ffff | 0x3f80_0000) - 1.0;
    // of 1 + t, exact at both ends
    let poly = t * (1.441917 + t * (-0.709096 + t * (0.415606 + t * (-0.193576 + t * 0.045149))));
    exponent as f32 + poly
}

#[cfg(test)]
mod tests;
