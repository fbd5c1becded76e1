//! How a panel is drawn: axes with their values, series, legend.
//!
//! The numbers here are a layout's, chosen by eye so that pages read well; `tests/processes/report.rs` looks whether
//! a letter is small, cut off or under another.

use super::super::axis::Axis;
use super::super::canvas::{Anchor, Area, Canvas, text_width, wrapped};
use super::{Panel, Series, Symbol};

/// Height of a panel's curves over their width.
const SHAPE: f64 = 0.56;
/// Bounds of that height, in letters.
const HEIGHT: (f64, f64) = (8.0, 26.0);
/// Most values beside the y axis.
const MAX_TICKS: usize = 12;
/// Room for a letter's line.
const LINE: f64 = 1.35;

/// Colours of the style sheet.
const COLOURS: usize = 7;

impl Panel {
    /// Draws it from (`left`, `top`) in this width; the y at which it ends. `legend`: with one of its own.
    pub(in crate::report::chart) fn draw(
        &self,
        canvas: &mut Canvas,
        [left, top]: [f64; 2],
        width: f64,
        legend: bool,
    ) -> f64 {
        let h = canvas.letters();
        let mut y = top;
        for line in wrapped(&self.title, 1.08 * h, width) {
            y += LINE * h;
            canvas.text("t tb", [left, y], Anchor::Start, &line);
        }
        for line in wrapped(&self.y_label, h, width) {
            y += LINE * h;
            canvas.text("t tm", [left, y], Anchor::Start, &line);
        }
        if legend {
            y = draw_legend(canvas, [left, y], width, &self.keys());
        }
        y += 0.9 * h;
        let (x_axis, y_axis, [x0, x1], height) = self.room([left, left + width], h);
        let area = [x0, y, x1, y + height];
        // What the script of a page needs for its cursor and zoom: where the panel is, and what its axes are.
        let is_readable = self.is_over_time() && !self.log_x;
        if is_readable {
            let ((t0, t1), (low, high)) = (x_axis.ends(), y_axis.ends());
            canvas.open(&over_time(area, [t0, t1], Some(([low, high], self.log_y))));
        }
        self.grid(canvas, &x_axis, &y_axis, area);
        canvas.open("class=\"clip\"><g class=\"data\"");
        for series in &self.series {
            self.draw_series(canvas, series, &x_axis, &y_axis, area);
        }
        canvas.close();
        canvas.close();
        if is_readable {
            canvas.close();
        }
        let foot = area[3] + 1.75 * h;
        let foot = if self.x_label.is_empty() {
            foot
        } else {
            canvas.text("t tm", [area[2], foot + LINE * h], Anchor::End, &self.x_label);
            foot + LINE * h
        };
        foot + 0.6 * h
    }

    /// The axes, from where to where the curves go, and how high, between two edges.
    fn room(&self, [left, right]: [f64; 2], h: f64) -> (Axis, Axis, [f64; 2], f64) {
        let (x_axis, y_axis) = self.axes();
        // How many texts there are depends on the height, which depends on the width that they leave.
        let margin = |axis: &Axis| {
            let texts = (1..=MAX_TICKS).flat_map(|wanted| axis.ticks(wanted));
            texts.map(|t| text_width(&t.1, h)).fold(2.0 * h, f64::max) + 0.7 * h
        };
        let ends = |margin: f64| [left + margin, right - 0.8 * h];
        let [x0, x1] = ends(margin(&y_axis));
        if !self.equal {
            return (x_axis, y_axis, [x0, x1], (SHAPE * (x1 - x0)).clamp(HEIGHT.0 * h, HEIGHT.1 * h));
        }
        let length = |axis: &Axis| axis.ends().1 - axis.ends().0;
        let shape = (length(&y_axis) / length(&x_axis)).clamp(0.45, 1.1);
        let height = (shape * (x1 - x0)).min(46.0 * h);
        let (_, widened) = equal(x_axis, y_axis, (x1 - x0, height));
        // A longer axis may have longer texts.
        let [x0, x1] = ends(margin(&y_axis).max(margin(&widened)));
        let (x_axis, y_axis) = equal(x_axis, y_axis, (x1 - x0, height));
        (x_axis, y_axis, [x0, x1], height)
    }

    fn place(&self, x_axis: &Axis, y_axis: &Axis, area: &Area, p: &[f64; 2]) -> Option<[f64; 2]> {
        let (x, y) = (x_axis.place(p[0])?, y_axis.place(p[1])?);
        let y = if self.y_down { y } else { 1.0 - y };
        Some([area[0] + x * (area[2] - area[0]), area[1] + y * (area[3] - area[1])])
    }

    fn grid(&self, canvas: &mut Canvas, x_axis: &Axis, y_axis: &Axis, area: Area) {
        let h = canvas.letters();
        canvas.rectangle("frame", area);
        let wanted = ((area[2] - area[0]) / (5.2 * h)) as usize;
        let mut free = f64::NEG_INFINITY;
        for (value, text) in x_axis.ticks(wanted.clamp(1, 8)) {
            let Some(share) = x_axis.place(value).filter(|s| (-1e-3..=1.001).contains(s)) else { continue };
            let x = area[0] + share * (area[2] - area[0]);
            canvas.path("grid tick", [[x, area[1]], [x, area[3]]]);
            let half = 0.5 * text_width(&text, h);
            // The one beside another that is too near is left out, not squeezed in.
            if x - half > free && x - half >= 0.0 && x + half <= area[2] + 0.8 * h {
                canvas.text("t tick", [x, area[3] + 1.65 * h], Anchor::Middle, &text);
                free = x + half + 0.5 * h;
            }
        }
        let mut last: Option<f64> = None;
        for (value, text) in y_axis.ticks((((area[3] - area[1]) / (2.6 * h)) as usize).min(MAX_TICKS)) {
            let Some(share) = y_axis.place(value).filter(|s| (-1e-3..=1.001).contains(s)) else { continue };
            let share = if self.y_down { share } else { 1.0 - share };
            let y = area[1] + share * (area[3] - area[1]);
            canvas.path("grid", [[area[0], y], [area[2], y]]);
            if last.is_none_or(|last| (last - y).abs() > 1.35 * h) {
                canvas.text("t", [area[0] - 0.45 * h, y + 0.35 * h], Anchor::End, &text);
                last = Some(y);
            }
        }
    }

    fn draw_series(&self, canvas: &mut Canvas, series: &Series, x_axis: &Axis, y_axis: &Axis, area: Area) {
        let colour = series.colour % COLOURS;
        let place = |p: &[f64; 2]| self.place(x_axis, y_axis, &area, p);
        let inside = |p: &[f64; 2]| {
            p[0] >= area[0] - 1.0 && p[0] <= area[2] + 1.0 && p[1] >= area[1] - 1.0 && p[1] <= area[3] + 1.0
        };
        match series.symbol {
            Symbol::Line | Symbol::Dashed | Symbol::Limit => {
                let class = match series.symbol {
                    Symbol::Limit => "limit".to_owned(),
                    Symbol::Dashed => format!("c{colour} line dash"),
                    _ => format!("c{colour} line"),
                };
                let points: Vec<_> = series.points.iter().filter_map(place).collect();
                for piece in points.split(|p| !inside(p)).filter(|piece| !piece.is_empty()) {
                    canvas.path(&class, thinned(piece));
                }
            }
            Symbol::Cross | Symbol::Circle => {
                let r = 0.34 * canvas.letters();
                for [x, y] in series.points.iter().filter_map(place).filter(inside) {
                    if series.symbol == Symbol::Circle {
                        canvas.circle(&format!("c{colour} mark"), [x, y], r);
                    } else {
                        canvas.path(&format!("c{colour} mark"), [[x - r, y - r], [x + r, y + r]]);
                        canvas.path(&format!("c{colour} mark"), [[x - r, y + r], [x + r, y - r]]);
                    }
                }
            }
            Symbol::Bars => {
                for (from, to) in series.points.iter().zip(series.points.iter().skip(1)) {
                    if from[1] > 0.0
                        && let (Some([x0, y0]), Some([x1, _])) = (place(from), place(&[to[0], from[1]]))
                    {
                        let x1 = (x1 - 0.6).max(x0 + 0.8);
                        canvas.rectangle(
                            &format!("f{colour}"),
                            [x0.max(area[0]), y0, x1.min(area[2]), area[3]],
                        );
                    }
                }
            }
            Symbol::Band => {
                for pair in series.points.chunks_exact(2) {
                    let at = |p: &[f64; 2]| {
                        x_axis.place(p[0]).map(|s| area[0] + s.clamp(0.0, 1.0) * (area[2] - area[0]))
                    };
                    if let [from, to] = pair
                        && let (Some(x0), Some(x1)) = (at(from), at(to))
                    {
                        canvas.rectangle(&format!("b{colour}"), [x0, area[1], x1.max(x0 + 1.0), area[3]]);
                    }
                }
            }
        }
    }
}

/// Attributes of the group of a panel over time: its area, from when to when, from which value to which, and whether that axis is logarithmic.
pub(in crate::report) fn over_time(
    [x0, y0, x1, y1]: Area,
    [t0, t1]: [f64; 2],
    values: Option<([f64; 2], bool)>,
) -> String {
    let mut text =
        format!("class=\"panel\" data-at=\"{x0:.1} {y0:.1} {x1:.1} {y1:.1}\" data-t=\"{t0} {t1}\"");
    if let Some(([low, high], log)) = values {
        text += &format!(" data-v=\"{low} {high} {}\"", u8::from(log));
    }
    text
}

/// The legend below `top`, in as many lines as it needs; where it ends.
pub(in crate::report::chart) fn draw_legend(
    canvas: &mut Canvas,
    [left, top]: [f64; 2],
    width: f64,
    keys: &[(&str, Symbol, usize)],
) -> f64 {
    let h = canvas.letters();
    let (mut x, mut y) = (left, top);
    for (i, (label, symbol, colour)) in keys.iter().enumerate() {
        let needed = 1.9 * h + text_width(label, h);
        if i == 0 || x + needed > left + width {
            (x, y) = (left, y + LINE * h);
        }
        let (middle, colour) = (y - 0.35 * h, colour % COLOURS);
        match symbol {
            Symbol::Line => canvas.path(&format!("c{colour} line"), [[x, middle], [x + 1.4 * h, middle]]),
            Symbol::Dashed => {
                canvas.path(&format!("c{colour} line dash"), [[x, middle], [x + 1.4 * h, middle]])
            }
            Symbol::Limit => canvas.path("limit", [[x, middle], [x + 1.4 * h, middle]]),
            Symbol::Circle => canvas.circle(&format!("c{colour} mark"), [x + 0.7 * h, middle], 0.32 * h),
            Symbol::Cross => {
                let (x, r) = (x + 0.7 * h, 0.3 * h);
                canvas.path(&format!("c{colour} mark"), [[x - r, middle - r], [x + r, middle + r]]);
                canvas.path(&format!("c{colour} mark"), [[x - r, middle + r], [x + r, middle - r]]);
            }
            Symbol::Bars => {
                canvas.rectangle(&format!("f{colour}"), [x, middle - 0.4 * h, x + 1.3 * h, middle + 0.4 * h])
            }
            Symbol::Band => canvas
                .rectangle(&format!("b{colour}"), [x, middle - 0.45 * h, x + 1.3 * h, middle + 0.45 * h]),
        }
        canvas.text("t", [x + 1.8 * h, y], Anchor::Start, label);
        x += needed + 1.2 * h;
    }
    y
}

/// Widens the shorter axis until both have the same scale in an area of this size.
pub(super) fn equal(x: Axis, y: Axis, (w, h): (f64, f64)) -> (Axis, Axis) {
    let length = |axis: &Axis| axis.ends().1 - axis.ends().0;
    let scale = (length(&x) / w).max(length(&y) / h);
    let about = |axis: Axis, size: f64| {
        let middle = 0.5 * (axis.ends().0 + axis.ends().1);
        Axis::linear(middle - 0.5 * scale * size, middle + 0.5 * scale * size)
    };
    (about(x, w), about(y, h))
}

/// Of points that rise in x, in each column of a unit the first, least, greatest and last: what is drawn looks the same. Other paths
/// lose the points that lie within half a unit of the one before.
pub(super) fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let rises = points.windows(2).all(|w| matches!(w, [a, b] if b[0] >= a[0]));
    if !rises {
        let mut kept: Vec<[f64; 2]> = Vec::new();
        let last = points.len().saturating_sub(1);
        for (i, p) in points.iter().enumerate() {
            let far = kept.last().is_none_or(|k| (p[0] - k[0]).abs().max((p[1] - k[1]).abs()) > 0.5);
            if far || i == last {
                kept.push(*p);
            }
        }
        return kept;
    }
    let mut kept = Vec::new();
    for column in points.chunk_by(|a, b| a[0].floor() == b[0].floor()) {
        let by_y = |a: &&[f64; 2], b: &&[f64; 2]| a[1].total_cmp(&b[1]);
        let (Some(first), Some(last)) = (column.first(), column.last()) else { continue };
        let (low, high) = (column.iter().min_by(by_y), column.iter().max_by(by_y));
        let mut four: Vec<_> = [Some(first), low, high, Some(last)].into_iter().flatten().collect();
        four.sort_by(|a, b| a[0].total_cmp(&b[0]));
        four.dedup();
        kept.extend(four.into_iter().copied());
    }
    kept
}
