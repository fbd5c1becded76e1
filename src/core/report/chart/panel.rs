//! Panels: curves and symbols between axes, with a legend beside which nothing is hidden.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::axis::Axis;

mod draw;

pub(super) use draw::draw_legend;
pub(in crate::report) use draw::over_time;

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
}

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

#[cfg(test)]
mod tests;
