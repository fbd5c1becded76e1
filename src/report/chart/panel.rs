//! Panels: curves and symbols between axes, with a legend beside which nothing is hidden.

use super::axis::Axis;
use super::canvas::{Anchor, Area, Canvas, text_width, wrapped};

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Symbol {
    /// A line through the points.
    Line,
    /// A dashed line: goals, commands.
    Dashed,
    /// Crosses: starts.
    Cross,
    /// Circles: ends, goals.
    Circle,
    /// Bars from the bottom: `x` is the left edge of each, the last point closes the last bar.
    Bars,
    /// A red line: limits.
    Limit,
    /// Bands over the whole height, from one `x` to the next, by pairs.
    Band,
}

/// Points drawn in one way.
#[derive(Debug, Clone)]
pub struct Series {
    pub(super) label: Option<String>,
    pub(super) points: Vec<[f64; 2]>,
    pub(super) symbol: Symbol,
    pub(super) colour: usize,
}

impl Series {
    /// A series in the colour of this number, without a label; points that are no numbers are left out.
    pub fn new(symbol: Symbol, colour: usize, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite());
        Self { label: None, points: points.map(|(x, y)| [x, y]).collect(), symbol, colour }
    }

    /// A line.
    pub fn line(colour: usize, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(Symbol::Line, colour, points)
    }

    /// The same series with a name in the legend.
    #[must_use]
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = Some(label.into());
        self
    }

    fn key(&self) -> Option<(&str, Symbol, usize)> {
        Some((self.label.as_deref()?, self.symbol, self.colour))
    }
}

/// One set of axes.
#[derive(Debug, Clone, Default)]
pub struct Panel {
    title: String,
    x_label: String,
    y_label: String,
    series: Vec<Series>,
    equal: bool,
    log_x: bool,
    log_y: bool,
    y_down: bool,
    x_range: Option<(f64, f64)>,
    y_range: Option<(f64, f64)>,
}

/// Height of a panel's curves over their width.
const SHAPE: f64 = 0.56;
/// Bounds of that height, in letters.
const HEIGHT: (f64, f64) = (8.0, 26.0);
/// Most values beside the y axis.
const MOST_TICKS: usize = 12;
/// Room for a letter's line.
const LINE: f64 = 1.35;

impl Panel {
    /// Axes with their labels (quantity and unit).
    pub fn new(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self { title: title.into(), x_label: x_label.into(), y_label: y_label.into(), ..Self::default() }
    }

    /// With one more series.
    #[must_use]
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Adds a series.
    pub fn push(&mut self, series: Series) {
        self.series.push(series);
    }

    /// The same scale on both axes: paths.
    #[must_use]
    pub fn equal_scales(mut self) -> Self {
        self.equal = true;
        self
    }

    /// A logarithmic x axis.
    #[must_use]
    pub fn log_x(mut self) -> Self {
        self.log_x = true;
        self
    }

    /// A logarithmic y axis: errors that fall exponentially. What is not positive is not drawn.
    #[must_use]
    pub fn log_y(mut self) -> Self {
        self.log_y = true;
        self
    }

    /// A logarithmic y axis where the values span more than two decades.
    #[must_use]
    pub fn log_y_if_wide(mut self) -> Self {
        let of = self.series.iter().filter(|s| s.symbol != Symbol::Band);
        let values = of.flat_map(|s| s.points.iter().map(|p| p[1]));
        self.log_y = spans_decades(values);
        self
    }

    /// A y axis that points down, as rows of an image do.
    #[must_use]
    pub fn y_down(mut self) -> Self {
        self.y_down = true;
        self
    }

    /// An x axis of given ends.
    #[must_use]
    pub fn x_range(mut self, least: f64, greatest: f64) -> Self {
        self.x_range = Some((least, greatest));
        self
    }

    /// A y axis of given ends.
    #[must_use]
    pub fn y_range(mut self, least: f64, greatest: f64) -> Self {
        self.y_range = Some((least, greatest));
        self
    }

    pub(super) fn title(&self) -> &str {
        &self.title
    }

    pub(super) fn series(&self) -> &[Series] {
        &self.series
    }

    pub(super) fn is_equal(&self) -> bool {
        self.equal
    }

    pub(super) fn is_logarithmic(&self) -> bool {
        self.log_y
    }

    /// Whether x is time.
    pub(super) fn is_over_time(&self) -> bool {
        self.x_label.starts_with("t ") || self.x_label.starts_with("t,")
    }

    /// What y is counted in: what stands in brackets, or behind the last comma; nothing for a plain number.
    pub(super) fn unit(&self) -> &str {
        let label = self.y_label.as_str();
        let unit = match (label.rsplit_once('['), label.rsplit_once(',')) {
            (Some((_, unit)), _) => unit.trim_end_matches(']'),
            (None, Some((_, unit))) => unit.trim(),
            (None, None) => "",
        };
        if unit == "-" { "" } else { unit }
    }

    /// All x (0) or y (1) of what is drawn.
    pub(super) fn values(&self, i: usize) -> impl Iterator<Item = f64> {
        let of = self.series.iter().filter(|s| s.symbol != Symbol::Band);
        of.flat_map(move |s| s.points.iter().filter_map(move |p| p.get(i).copied()))
    }

    pub(super) fn set_range(&mut self, i: usize, ends: (f64, f64)) {
        if i == 0 {
            self.x_range = Some(ends);
        } else {
            self.y_range = Some(ends);
        }
    }

    /// What the legend says, in its order.
    pub(super) fn keys(&self) -> Vec<(&str, Symbol, usize)> {
        let mut keys: Vec<_> = Vec::new();
        for key in self.series.iter().filter_map(Series::key) {
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
        keys
    }

    fn axes(&self) -> (Axis, Axis) {
        let places = |i: usize, bands: bool| {
            let of = self.series.iter().filter(move |s| bands || s.symbol != Symbol::Band);
            of.flat_map(move |s| s.points.iter().map(move |p| p[i]))
        };
        let x = match self.x_range {
            Some((low, high)) if self.log_x => Axis::logarithmic(low, high),
            Some((low, high)) => Axis::linear(low, high),
            None => {
                let axis = Axis::of(places(0, false), self.log_x);
                // Time begins at the edge.
                if self.is_over_time() || self.has_bars() { axis } else { axis.widened(0.06) }
            }
        };
        let y = match self.y_range {
            Some((low, high)) if self.log_y => Axis::logarithmic(low, high),
            Some((low, high)) => Axis::linear(low, high),
            None if self.has_bars() => {
                let axis = Axis::of(places(1, false).chain([if self.log_y { 0.7 } else { 0.0 }]), self.log_y);
                let (low, high) = axis.ends();
                if self.log_y { axis } else { Axis::linear(low, high + 0.06 * (high - low)) }
            }
            None => Axis::of(places(1, false), self.log_y).widened(0.06),
        };
        (x, y)
    }

    fn has_bars(&self) -> bool {
        self.series.iter().any(|s| s.symbol == Symbol::Bars)
    }

    /// Draws it from (`left`, `top`) in this width; the y at which it ends. `legend`: with one of its own.
    pub(super) fn draw(&self, canvas: &mut Canvas, [left, top]: [f64; 2], width: f64, legend: bool) -> f64 {
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
        self.grid(canvas, &x_axis, &y_axis, area);
        for series in &self.series {
            self.draw_series(canvas, series, &x_axis, &y_axis, area);
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
            let texts = (1..=MOST_TICKS).flat_map(|wanted| axis.ticks(wanted));
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
            canvas.path("grid", [[x, area[1]], [x, area[3]]]);
            let half = 0.5 * text_width(&text, h);
            // The one beside another that is too near is left out, not squeezed in.
            if x - half > free && x - half >= 0.0 && x + half <= area[2] + 0.8 * h {
                canvas.text("t", [x, area[3] + 1.65 * h], Anchor::Middle, &text);
                free = x + half + 0.5 * h;
            }
        }
        let mut last: Option<f64> = None;
        for (value, text) in y_axis.ticks((((area[3] - area[1]) / (2.6 * h)) as usize).min(MOST_TICKS)) {
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

/// Colours of the style sheet.
pub(super) const COLOURS: usize = 7;

/// Whether positive values span more than two decades.
#[must_use]
pub fn spans_decades(values: impl Iterator<Item = f64>) -> bool {
    let (mut low, mut high, mut all) = (f64::INFINITY, 0.0_f64, true);
    for v in values {
        all &= v > 0.0;
        (low, high) = (low.min(v), high.max(v));
    }
    all && high > 100.0 * low
}

/// The legend below `top`, in as many lines as it needs; where it ends.
pub(super) fn draw_legend(
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
fn equal(x: Axis, y: Axis, (w, h): (f64, f64)) -> (Axis, Axis) {
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
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
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

#[cfg(test)]
mod tests;
