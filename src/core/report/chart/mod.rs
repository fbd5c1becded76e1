//! Charts as SVG text: panels with axes, curves and symbols, drawn for three widths so that letters stay readable, with colours by class
//! so that light, dark and paper are one drawing.

mod axis;
mod canvas;
mod panel;
mod says;
mod style;

pub use axis::Axis;
pub use canvas::{Anchor, Area, Canvas, Width, escaped, overlap, text_width, wrapped};
pub use panel::{Panel, Series, Symbol, spans_decades};
pub use says::panels_say;
pub use style::CHART_STYLE;

use panel::draw_legend;
pub(super) use panel::over_time;

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

/// The same as a file of its own, drawn for a screen: its style is in it, so that it is light or dark as who looks at it likes.
#[must_use]
pub fn standalone_svg(panels: &[Panel], columns: usize, title: &str) -> String {
    figure(panels, columns, Width::Wide).0.finish_alone(title)
}

/// Gives all panels the same axes, wide enough for each: so that they can be compared.
pub fn same_axes(panels: &mut [Panel]) {
    for i in 0..2 {
        let values = || panels.iter().flat_map(|p| p.values(i));
        let ends = values()
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if !(ends.0 <= ends.1) {
            continue;
        }
        let margin = 0.05 * (ends.1 - ends.0);
        for panel in panels.iter_mut() {
            // Time begins at the edge, and a logarithm has room of its own.
            let margin =
                if (i == 0 && panel.is_over_time()) || panel.is_logarithmic() { 0.0 } else { margin };
            panel.set_range(i, (ends.0 - margin, ends.1 + margin));
        }
    }
}
