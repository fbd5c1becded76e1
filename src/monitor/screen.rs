//! Cells of a terminal, and the characters that make one screen of another.
//!
//! The sequences are those of the standard ECMA-48 (CUP, SGR, ED), which every terminal of today understands.

use std::fmt::Write;

/// How a cell looks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum CellStyle {
    /// As the terminal writes.
    #[default]
    Plain,
    /// Less than the rest.
    Faint,
    /// More than the rest.
    Bold,
    /// As it should be.
    Good,
    /// Not as it should be.
    Doubtful,
    /// Wrong.
    Bad,
    /// Turned round, for titles and questions.
    Reverse,
    /// Where something is to be.
    Goal,
}

impl CellStyle {
    /// The parameters of SGR.
    fn sgr(self) -> &'static str {
        match self {
            Self::Plain => "0",
            Self::Faint => "0;2",
            Self::Bold => "0;1",
            Self::Good => "0;32",
            Self::Doubtful => "0;33",
            Self::Bad => "0;1;31",
            Self::Reverse => "0;7",
            Self::Goal => "0;36",
        }
    }
}

/// One cell.
type StyledChar = (char, CellStyle);

const EMPTY: StyledChar = (' ', CellStyle::Plain);

/// What stands in the cells of a terminal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Screen {
    columns: usize,
    rows: usize,
    cells: Vec<StyledChar>,
}

impl Screen {
    /// An empty one.
    #[must_use]
    pub fn new(columns: usize, rows: usize) -> Self {
        Self { columns, rows, cells: vec![EMPTY; columns * rows] }
    }

    /// Its width in cells.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Its height in cells.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Writes one character; outside nothing is written, and what is no visible character is shown as `?`.
    pub fn put(&mut self, row: usize, column: usize, symbol: char, style: CellStyle) {
        if column < self.columns
            && let Some(cell) = self.cells.get_mut(row * self.columns + column)
        {
            *cell = (if symbol.is_control() { '?' } else { symbol }, style);
        }
    }

    /// Writes `text` from a cell on, as far as the row goes; the column behind it.
    pub fn text(&mut self, row: usize, column: usize, text: &str, style: CellStyle) -> usize {
        let mut at = column;
        for symbol in text.chars() {
            self.put(row, at, symbol, style);
            at += 1;
        }
        at
    }

    /// The rows as text, without the spaces at their ends.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        let row = |cells: &[StyledChar]| cells.iter().map(|(symbol, _)| *symbol).collect::<String>();
        self.cells.chunks(self.columns.max(1)).map(|cells| row(cells).trim_end().to_owned()).collect()
    }

    /// The characters that make this screen of `before`; of an unknown one, or of one of another size, without it.
    #[must_use]
    pub fn changes(&self, before: Option<&Self>) -> String {
        let before = before.filter(|b| (b.columns, b.rows) == (self.columns, self.rows));
        let mut text = if before.is_none() { "\x1b[0m\x1b[2J".to_owned() } else { String::new() };
        // where the terminal's cursor is, and how it writes
        let (mut cursor, mut style) = (None, None);
        for (i, cell) in self.cells.iter().enumerate() {
            if before.map_or(EMPTY, |b| b.cells.get(i).copied().unwrap_or(EMPTY)) == *cell {
                continue;
            }
            let (row, column) = (i / self.columns, i % self.columns);
            // a String takes everything
            if cursor != Some(i) || column == 0 {
                let _ = write!(text, "\x1b[{};{}H", row + 1, column + 1);
            }
            if style != Some(cell.1) {
                let _ = write!(text, "\x1b[{}m", cell.1.sgr());
            }
            text.push(cell.0);
            (cursor, style) = (Some(i + 1), Some(cell.1));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_changed_is_written() {
        let mut a = Screen::new(10, 3);
        a.text(0, 0, "error 12", CellStyle::Plain);
        let first = a.changes(None);
        assert_eq!(first, "\x1b[0m\x1b[2J\x1b[1;1H\x1b[0merror\x1b[1;7H12");
        let mut b = a.clone();
        assert_eq!(b.changes(Some(&a)), "");
        b.text(0, 6, "13", CellStyle::Bad);
        b.text(2, 9, "xyz", CellStyle::Bad);
        assert_eq!(b.changes(Some(&a)), "\x1b[1;7H\x1b[0;1;31m13\x1b[3;10Hx");
        assert_eq!(b.lines(), ["error 13", "", "         x"]);
        assert!(b.changes(Some(&Screen::new(9, 3))).starts_with("\x1b[0m\x1b[2J"), "a size of its own");
    }

    #[test]
    fn nothing_that_is_shown_can_command_the_terminal() {
        let mut a = Screen::new(8, 1);
        a.text(0, 0, "\x1b[2Jx\u{9b}", CellStyle::Plain);
        a.put(9, 0, 'y', CellStyle::Plain);
        assert_eq!(a.lines(), ["?[2Jx?"]);
    }
}
