//! Charts as SVG text: panels with axes, curves and symbols, drawn for three widths so that letters stay readable, with colours by class
//! so that light, dark and paper are one drawing.

mod axis;
mod canvas;
mod panel;
mod style;

pub use axis::Axis;
pub use canvas::{Anchor, Area, Canvas, Width, escaped, overlap, text_width, wrapped};
pub use panel::{Panel, Series, Symbol, spans_decades};
pub use style::CHART_STYLE;

use panel::draw_legend;

/// Panels in rows of at most `columns`, fewer where the figure is narrow.
fn figure(panels: &[Panel], columns: usize, width: Width) -> (Canvas, f64) {
    let columns = match width {
        Width::Narrow => 1,
        Width::Medium => columns.min(2),
        Width::Wide => columns,
    };
    let columns = columns.clamp(1, panels.len().max(1));
    let mut canvas = Canvas::new(width, 0.0);
    let gap = 2.0 * canvas.letters();
    let each = (width.units() - gap * (columns as f64 - 1.0)) / columns as f64;
    // One legend for all, where all have the same.
    let keys = panels.first().map(Panel::keys).unwrap_or_default();
    let shared = panels.len() > 1 && panels.iter().all(|p| p.keys() == keys);
    let mut y = 0.0;
    if shared {
        y = draw_legend(&mut canvas, [0.0, y], width.units(), &keys);
        y += 0.5 * canvas.letters();
    }
    for row in panels.chunks(columns) {
        let mut bottom = y;
        for (i, panel) in row.iter().enumerate() {
            let left = i as f64 * (each + gap);
            bottom = f64::max(bottom, panel.draw(&mut canvas, [left, y], each, !shared));
        }
        y = bottom + 0.4 * canvas.letters();
    }
    canvas.set_height(y.max(1.0));
    (canvas, y)
}

/// The SVG text of panels in rows of at most `columns`; `title` is what is read aloud.
#[must_use]
pub fn figure_svg(panels: &[Panel], columns: usize, width: Width, title: &str) -> String {
    figure(panels, columns, width).0.finish(&format!("chart {}", width.class()), title)
}
