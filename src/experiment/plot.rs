//! Figures of experiments: panels in rows, as a file of their own and in a page.

pub use crate::report::chart::{Panel, Series, Symbol};

use crate::report::chart::{figure_svg, panels_say, standalone_svg};
use crate::report::page;

/// Panels in rows of so many.
#[derive(Debug, Clone, Default)]
pub struct Drawing {
    columns: usize,
    panels: Vec<Panel>,
}

/// A figure of `panels` in rows of `columns`.
#[must_use]
pub fn figure(columns: usize, panels: impl Into<Vec<Panel>>) -> Drawing {
    Drawing { columns, panels: panels.into() }
}

impl Drawing {
    /// The text of an SVG file, light or dark as who looks at it likes.
    #[must_use]
    pub fn svg(&self, title: &str) -> String {
        standalone_svg(&self.panels, self.columns, title)
    }

    /// What it shows, taken from its curves.
    #[must_use]
    pub fn says(&self) -> String {
        panels_say(&self.panels)
    }

    /// The figure in a page.
    #[must_use]
    pub fn html(&self, title: &str, says: &str, note: &str) -> String {
        page::figure(title, says, note, |width| figure_svg(&self.panels, self.columns, width, title))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_has_its_labels_and_survives_bad_numbers() {
        let panel = Panel::new("title", "t [s]", "x [m]")
            .with(Series::line(0, (0..5000).map(|i| (f64::from(i), 0.5))).label("name"))
            .with(Series::new(Symbol::Cross, 1, [(0.0, f64::NAN)]))
            .with(Series::new(Symbol::Dashed, 8, [(0.0, 1.0), (9.0, 1.0)]).label("goal"));
        let log = Panel::new("error", "n", "e").log_y().with(Series::line(0, [(0.0, 1.0), (1.0, 1e-9)]));
        let empty = Panel::new("nothing", "X", "Y").equal_scales();
        let svg = figure(2, [panel, log, empty]).svg("f");
        for text in ["title", "t [s]", "x [m]", "name", "goal", "</svg>", "prefers-color-scheme"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(svg.starts_with("<svg") && !svg.contains("NaN"));
    }
}
