//! Tables of numbers: a row for each region, contour, level and so on.

use crate::input::number;

/// Rows of numbers under names with units. What is not known is NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct StepTable {
    /// What a row tells of: "region", "contour".
    pub of: &'static str,
    /// Names with units, the first one that of the row's own number.
    pub columns: Vec<&'static str>,
    /// Rows, each as long as `columns`.
    pub rows: Vec<Vec<f64>>,
}

impl StepTable {
    /// A table of rows of `N` numbers.
    #[must_use]
    pub fn new<const N: usize>(
        of: &'static str,
        columns: [&'static str; N],
        rows: impl IntoIterator<Item = [f64; N]>,
    ) -> Self {
        Self { of, columns: columns.into(), rows: rows.into_iter().map(Vec::from).collect() }
    }

    /// The numbers of a column; none where there is no such column.
    #[must_use]
    pub fn column(&self, name: &str) -> Vec<f64> {
        let Some(at) = self.columns.iter().position(|c| *c == name) else { return Vec::new() };
        self.rows.iter().filter_map(|row| row.get(at).copied()).collect()
    }

    /// The text of a CSV file: what is not known is an empty cell.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut text = self.columns.join(",") + "\n";
        for row in &self.rows {
            let cells: Vec<_> =
                row.iter().map(|v| if v.is_finite() { number(*v) } else { String::new() }).collect();
            text += &cells.join(",");
            text.push('\n');
        }
        text
    }
}
