//! Dots in cells: each has two columns and four rows of them (the patterns of Braille in Unicode, U+2800 to U+28FF), so that dots are about square.

use super::screen::{CellStyle, Screen};

/// The bit of the dot in column x and row y of a cell, as Unicode has them for the dots of Braille.
const BITS: [[u32; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];
/// The pattern without a dot, as Unicode has it.
const BLANK: u32 = 0x2800;

/// A rectangle of cells with dots in it.
pub(super) struct DotPlot {
    row: usize,
    column: usize,
    /// In cells.
    size: (usize, usize),
    cells: Vec<(u32, CellStyle)>,
}

impl DotPlot {
    /// One with its corner at a cell, `columns` wide and `rows` high.
    pub(super) fn new(row: usize, column: usize, columns: usize, rows: usize) -> Self {
        Self { row, column, size: (columns, rows), cells: vec![(0, CellStyle::Plain); columns * rows] }
    }

    /// Its size in dots.
    pub(super) fn dots(&self) -> (f64, f64) {
        ((2 * self.size.0) as f64, (4 * self.size.1) as f64)
    }

    /// A dot at x to the right and y down, counted from the corner; outside there is none. Of two styles in a cell the later one stays.
    pub(super) fn dot(&mut self, x: f64, y: f64, style: CellStyle) {
        let (width, height) = self.dots();
        if !(x >= 0.0 && y >= 0.0 && x < width && y < height) {
            return;
        }
        let (x, y) = (x as usize, y as usize);
        if let Some((bits, with)) = self.cells.get_mut(y / 4 * self.size.0 + x / 2) {
            *bits |= BITS[y % 4][x % 2];
            *with = style;
        }
    }

    /// A line of dots.
    pub(super) fn line(&mut self, from: (f64, f64), to: (f64, f64), style: CellStyle) {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let (width, height) = self.dots();
        // A line that is longer than all the plot is not followed dot by dot.
        let steps = dx.abs().max(dy.abs()).min(width + height).ceil();
        for i in 0..=steps as usize {
            let share = if steps > 0.0 { i as f64 / steps } else { 0.0 };
            self.dot(from.0 + share * dx, from.1 + share * dy, style);
        }
    }

    /// Writes the cells that have dots.
    pub(super) fn put(&self, screen: &mut Screen) {
        for (i, (bits, style)) in self.cells.iter().enumerate().filter(|(_, (bits, _))| *bits > 0) {
            let symbol = char::from_u32(BLANK | bits).unwrap_or(' ');
            screen.put(self.row + i / self.size.0, self.column + i % self.size.0, symbol, *style);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dots_are_where_they_belong() {
        let mut plot = DotPlot::new(1, 1, 2, 1);
        plot.dot(0.0, 0.0, CellStyle::Plain);
        plot.dot(3.0, 3.0, CellStyle::Plain);
        plot.dot(4.0, 0.0, CellStyle::Plain);
        plot.dot(f64::NAN, 0.0, CellStyle::Plain);
        let mut screen = Screen::new(4, 2);
        plot.put(&mut screen);
        assert_eq!(screen.lines(), ["", " \u{2801}\u{2880}"]);
        let mut line = DotPlot::new(0, 0, 1, 1);
        line.line((0.0, 0.0), (0.0, 3.0), CellStyle::Plain);
        line.line((1.0, 0.0), (1.0, 1e9), CellStyle::Plain);
        line.put(&mut screen);
        assert_eq!(screen.lines()[0], "\u{284f}", "no more dots than the plot has");
    }
}
