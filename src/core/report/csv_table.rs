//! A CSV file as columns: what a report is made of is what people find beside it.

use std::collections::BTreeMap;

/// Columns by name. A cell that is no number is NaN as a number; every cell has its word.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CsvTable {
    names: Vec<String>,
    columns: Vec<Column>,
    rows: usize,
}

#[derive(Debug, Clone, Default, PartialEq)]
struct Column {
    numbers: Vec<f64>,
    /// Row and word of cells that are no numbers; most columns have none.
    words: BTreeMap<usize, String>,
}

impl CsvTable {
    /// Reads a text whose first line names the columns. Cells may stand in quotes, `""` in them being one; lines have no more columns
    /// than the first, and what is missing is empty.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let mut lines = text.lines();
        let names: Vec<String> = lines.next().map(|line| cells(line).collect()).unwrap_or_default();
        let mut columns = vec![Column::default(); names.len()];
        let mut rows = 0;
        for line in lines.filter(|line| !line.is_empty()) {
            let mut cells = cells(line);
            for column in &mut columns {
                let cell = cells.next().unwrap_or_default();
                let number = cell.parse::<f64>().unwrap_or(f64::NAN);
                if number.is_nan() && !cell.is_empty() {
                    column.words.insert(rows, cell);
                }
                column.numbers.push(number);
            }
            rows += 1;
        }
        Self { names, columns, rows }
    }

    /// Rows without the first line.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The names of the columns.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    fn column(&self, name: &str) -> Option<&Column> {
        self.names.iter().position(|n| n == name).and_then(|i| self.columns.get(i))
    }

    /// The numbers of a column; empty where there is no such column.
    #[must_use]
    pub fn numbers(&self, name: &str) -> &[f64] {
        self.column(name).map_or(&[], |column| &column.numbers)
    }

    /// A number; NaN where there is none.
    #[must_use]
    pub fn number(&self, name: &str, row: usize) -> f64 {
        self.numbers(name).get(row).copied().unwrap_or(f64::NAN)
    }

    /// What stands in a cell that is no number; empty where it is one.
    #[must_use]
    pub fn word(&self, name: &str, row: usize) -> &str {
        self.column(name).and_then(|column| column.words.get(&row)).map_or("", String::as_str)
    }

    /// The rows in which a column has this number; all where there is no such column.
    #[must_use]
    pub fn rows_of(&self, name: &str, number: f64) -> Self {
        let Some(column) = self.column(name) else { return self.clone() };
        self.rows_where(|row| column.numbers.get(row) == Some(&number))
    }

    /// The rows that `keep` keeps.
    #[must_use]
    pub fn rows_where(&self, keep: impl Fn(usize) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.rows).filter(|row| keep(*row)).collect();
        let of = |column: &Column| Column {
            numbers: kept.iter().filter_map(|row| column.numbers.get(*row).copied()).collect(),
            words: (0..)
                .zip(&kept)
                .filter_map(|(at, row)| Some((at, column.words.get(row)?.clone())))
                .collect(),
        };
        Self { names: self.names.clone(), columns: self.columns.iter().map(of).collect(), rows: kept.len() }
    }

    /// Two columns as points, without those that are no numbers.
    #[must_use]
    pub fn points(&self, x: &str, y: &str) -> Vec<[f64; 2]> {
        let pairs = self.numbers(x).iter().zip(self.numbers(y)).map(|(x, y)| [*x, *y]);
        pairs.filter(|p| p.iter().all(|v| v.is_finite())).collect()
    }
}

fn cells(line: &str) -> impl Iterator<Item = String> + '_ {
    let mut rest = Some(line);
    std::iter::from_fn(move || {
        let text = rest?;
        let Some(quoted) = text.strip_prefix('"') else {
            let (cell, after) = match text.split_once(',') {
                Some((cell, after)) => (cell, Some(after)),
                None => (text, None),
            };
            rest = after;
            return Some(cell.to_owned());
        };
        let mut cell = String::new();
        let mut letters = quoted.char_indices().peekable();
        let mut end = quoted.len();
        while let Some((at, c)) = letters.next() {
            match (c, letters.peek()) {
                ('"', Some((_, '"'))) => {
                    letters.next();
                    cell.push('"');
                }
                ('"', _) => {
                    end = at + 1;
                    break;
                }
                (c, _) => cell.push(c),
            }
        }
        rest = quoted.get(end..).and_then(|after| after.strip_prefix(','));
        Some(cell)
    })
}

/// A cell as [`CsvTable::parse`] reads it, in one line.
#[must_use]
pub fn csv_cell(text: &str) -> String {
    let line = text.replace(['\n', '\r'], " ");
    if line.contains([',', '"']) { format!("\"{}\"", line.replace('"', "\"\"")) } else { line }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn numbers_words_and_gaps() {
        let table = CsvTable::parse("a,b,c\n1,\"x, \"\"y\"\"\",\n-2.5e-3,,nan\n7\n");
        assert_eq!((table.rows(), table.names().len()), (3, 3));
        assert_eq!(table.numbers("a"), [1.0, -2.5e-3, 7.0]);
        assert_eq!((table.word("b", 0), table.word("b", 1), table.word("b", 9)), ("x, \"y\"", "", ""));
        assert!(table.number("c", 1).is_nan() && table.number("d", 0).is_nan());
        assert_eq!(table.points("a", "c"), Vec::<[f64; 2]>::new());
        assert_eq!(CsvTable::parse("").rows(), 0);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(cells in prop::collection::vec("[a-z,\" ]{1,12}", 1..6)) {
            let line: Vec<_> = cells.iter().map(|cell| csv_cell(cell)).collect();
            let head: Vec<_> = (0..cells.len()).map(|i| format!("c{i}")).collect();
            let table = CsvTable::parse(&format!("{}\n{}\n", head.join(","), line.join(",")));
            for (name, cell) in head.iter().zip(&cells) {
                // words like inf are numbers
                prop_assert!(table.word(name, 0) == cell || cell.parse::<f64>().is_ok(), "{line:?}");
            }
        }

        #[test]
        fn rows_of_a_number_keep_their_cells(numbers in proptest::collection::vec(0u8..3, 0..20)) {
            let lines: String = numbers.iter().enumerate().map(|(i, n)| format!("{n},{i},w{i}\n")).collect();
            let table = CsvTable::parse(&format!("n,i,w\n{lines}"));
            let kept = table.rows_of("n", 1.0);
            let wanted: Vec<usize> = (0..numbers.len()).filter(|i| numbers[*i] == 1).collect();
            prop_assert_eq!(kept.rows(), wanted.len());
            for (row, i) in wanted.iter().enumerate() {
                let found = (kept.number("i", row), kept.word("w", row).to_owned());
                prop_assert_eq!(found, (*i as f64, format!("w{i}")));
            }
            prop_assert_eq!(table.rows_of("absent", 1.0).rows(), table.rows());
        }

        #[test]
        fn no_text_is_too_strange(text in ".{0,200}") {
            let table = CsvTable::parse(&text);
            prop_assert!(table.columns.iter().all(|c| c.numbers.len() == table.rows()));
        }
    }
}
