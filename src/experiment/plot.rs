//! Figures as SVG text: panels side by side, curves, dashed goals, crosses and circles for starts and ends.

use super::ExperimentError;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::Color;

/// The drawing library rounds to whole units; it draws this much larger than the figure is shown.
const FINE: u32 = 4;
/// Size of one panel, px.
const PANEL_PX: (u32, u32) = (460 * FINE, 320 * FINE);
/// Curves are thinned to about this many points.
const MOST_POINTS: usize = 800;
/// Okabe and Ito's palette: told apart by colour-blind readers, and in grey.
const PALETTE: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(60, 60, 60),
];

/// Shown pixels in units of the drawing.
const fn px(shown: u32) -> u32 {
    shown * FINE
}

fn font(shown: u32) -> (&'static str, u32) {
    ("sans-serif", px(shown))
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Symbol {
    /// A line through the points.
    Line,
    /// A dashed line: goals.
    Dashed,
    /// Crosses: starts.
    Cross,
    /// Circles: ends.
    Circle,
}

/// Points drawn in one way.
#[derive(Debug, Clone)]
pub struct Series {
    label: Option<String>,
    points: Vec<(f64, f64)>,
    mark: Symbol,
    colour: usize,
}

impl Series {
    /// A series in the colour of this number, without a label.
    pub fn new(mark: Symbol, colour: usize, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        Self { label: None, points, mark, colour }
    }

    /// A line.
    pub fn line(colour: usize, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(Symbol::Line, colour, points)
    }

    /// Its line, and that of a dashed one.
    fn styles(&self) -> (ShapeStyle, ShapeStyle) {
        let colour = PALETTE.get(self.colour % PALETTE.len()).copied().unwrap_or(BLACK);
        (colour.stroke_width(px(2)), colour.stroke_width(px(1)))
    }

    /// The same series with a name in the legend.
    #[must_use]
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = Some(label.into());
        self
    }
}

/// One set of axes.
#[derive(Debug, Clone)]
pub struct Panel {
    title: String,
    x_label: String,
    y_label: String,
    series: Vec<Series>,
    equal: bool,
    log_y: bool,
    y_range: Option<(f64, f64)>,
}

impl Panel {
    /// Axes with their labels (quantity and unit).
    pub fn new(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            series: Vec::new(),
            equal: false,
            log_y: false,
            y_range: None,
        }
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

    /// A logarithmic y axis: errors that fall exponentially. Values must be positive.
    #[must_use]
    pub fn log_y(mut self) -> Self {
        self.log_y = true;
        self
    }

    /// A y axis of given ends.
    #[must_use]
    pub fn y_range(mut self, least: f64, greatest: f64) -> Self {
        self.y_range = Some((least, greatest));
        self
    }

    fn range(&self, of: impl Fn(&(f64, f64)) -> f64) -> (f64, f64) {
        let values = || self.series.iter().flat_map(|s| s.points.iter().map(&of));
        let (least, greatest) =
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        if !(least.is_finite() && greatest.is_finite()) {
            return (0.0, 1.0);
        }
        // Room for a quantity that does not change.
        let middle = 0.5 * (least + greatest);
        let half = (0.5 * (greatest - least)).max(1e-3 * middle.abs()).max(1e-6);
        (middle - half, middle + half)
    }

    fn time_axis(&self) -> bool {
        self.x_label.contains("[s]")
    }

    fn draw<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        let (width, _) = area.dim_in_pixel();
        let (area, side) = area.split_horizontally(width - self.legend_width());
        self.legend(&side)?;
        let (mut x, mut y) = (self.range(|p| p.0), self.range(|p| p.1));
        if !self.time_axis() {
            x = widened(x);
        }
        let mut builder = ChartBuilder::on(&area);
        builder
            .caption(&self.title, font(17))
            .margin(px(8))
            .margin_right(px(18))
            .x_label_area_size(px(42))
            .y_label_area_size(px(64));
        if self.log_y {
            // Decades, so that the axis has ticks.
            let (low, high) = (y.0.max(1e-16).log10().floor(), y.1.max(1e-15).log10().ceil());
            let range = (10f64.powf(low)..10f64.powf(high.max(low + 1.0))).log_scale();
            let mut chart = builder.build_cartesian_2d(x.0..x.1, range)?;
            self.mesh(&mut chart, &|v| format!("{v:.0e}"))?;
            return self.fill(&mut chart);
        }
        y = self.y_range.unwrap_or_else(|| widened(y));
        if self.equal {
            (x, y) = equal(x, y, area.dim_in_pixel());
        }
        let mut chart = builder.build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        self.mesh(&mut chart, &short)?;
        self.fill(&mut chart)
    }

    fn mesh<DB, Y>(
        &self,
        chart: &mut ChartContext<'_, DB, Cartesian2d<plotters::coord::types::RangedCoordf64, Y>>,
        format_y: &dyn Fn(&f64) -> String,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>>
    where
        DB: DrawingBackend,
        Y: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
    {
        chart
            .configure_mesh()
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_labels(6)
            .y_labels(6)
            .x_label_formatter(&short)
            .y_label_formatter(format_y)
            .axis_desc_style(font(14))
            .label_style(font(12))
            .bold_line_style(BLACK.mix(0.12).stroke_width(FINE))
            .axis_style(BLACK.mix(0.7).stroke_width(FINE))
            .set_all_tick_mark_size(px(4))
            .light_line_style(TRANSPARENT)
            .draw()
    }

    fn fill<DB, Y>(
        &self,
        chart: &mut ChartContext<'_, DB, Cartesian2d<plotters::coord::types::RangedCoordf64, Y>>,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>>
    where
        DB: DrawingBackend,
        Y: Ranged<ValueType = f64>,
    {
        for series in &self.series {
            let (style, thin) = series.styles();
            let points = || thinned(&series.points);
            match series.mark {
                Symbol::Line => chart.draw_series(LineSeries::new(points(), style))?,
                Symbol::Dashed => chart.draw_series(DashedLineSeries::new(points(), px(6), px(4), thin))?,
                Symbol::Cross => chart.draw_series(points().map(|p| Cross::new(p, px(5), style)))?,
                Symbol::Circle => chart.draw_series(points().map(|p| Circle::new(p, px(5), style)))?,
            };
        }
        Ok(())
    }

    /// Width of the legend at the right, in units of the drawing; beside the curves, so that it hides none.
    fn legend_width(&self) -> u32 {
        let longest = self.series.iter().filter_map(|s| s.label.as_ref()).map(|l| l.chars().count()).max();
        longest.map_or(0, |count| px(30 + 7 * count as u32))
    }

    fn legend<DB: DrawingBackend>(
        &self,
        side: &DrawingArea<DB, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        let labelled = self.series.iter().filter_map(|s| s.label.as_ref().map(|label| (s, label)));
        for (i, (series, label)) in labelled.enumerate() {
            let at = |x: u32, y: u32| (px(x) as i32, (px(44 + 18 * i as u32 + y)) as i32);
            let (style, thin) = series.styles();
            match series.mark {
                Symbol::Line => side.draw(&PathElement::new(vec![at(0, 0), at(18, 0)], style))?,
                Symbol::Dashed => {
                    side.draw(&PathElement::new(vec![at(0, 0), at(7, 0)], thin))?;
                    side.draw(&PathElement::new(vec![at(11, 0), at(18, 0)], thin))?;
                }
                Symbol::Cross => side.draw(&Cross::new(at(9, 0), px(4), style))?,
                Symbol::Circle => side.draw(&Circle::new(at(9, 0), px(4), style))?,
            }
            let (x, y) = at(24, 0);
            side.draw(&Text::new(label.as_str(), (x, y - px(6) as i32), font(12).into_font()))?;
        }
        Ok(())
    }
}

fn short(v: &f64) -> String {
    let v = if v.abs() < 1e-12 { 0.0 } else { *v };
    let text = format!("{v:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

fn widened((least, greatest): (f64, f64)) -> (f64, f64) {
    let margin = 0.06 * (greatest - least);
    (least - margin, greatest + margin)
}

/// Widens the shorter axis until both have the same scale in an area of this size.
fn equal(x: (f64, f64), y: (f64, f64), (w, h): (u32, u32)) -> ((f64, f64), (f64, f64)) {
    let (w, h) = (f64::from(w.saturating_sub(px(90)).max(1)), f64::from(h.saturating_sub(px(82)).max(1)));
    let scale = ((x.1 - x.0) / w).max((y.1 - y.0) / h);
    let about = |(a, b): (f64, f64), size: f64| {
        let middle = 0.5 * (a + b);
        (middle - 0.5 * scale * size, middle + 0.5 * scale * size)
    };
    (about(x, w), about(y, h))
}

/// Every so many points, and the last.
fn thinned(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> + Clone + '_ {
    let stride = (points.len() / MOST_POINTS).max(1);
    let last = points.len().saturating_sub(1);
    points.iter().enumerate().filter(move |(i, _)| i % stride == 0 || *i == last).map(|(_, p)| *p)
}

/// A figure of `panels` in rows of `columns`, as SVG text.
///
/// # Errors
/// [`ExperimentError::Draw`].
pub fn figure(name: &str, columns: usize, panels: &[Panel]) -> Result<String, ExperimentError> {
    let fail = |cause: String| ExperimentError::Draw { figure: name.into(), cause };
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let size = (PANEL_PX.0 * columns as u32, PANEL_PX.1 * rows as u32);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).map_err(|e| fail(e.to_string()))?;
        for (area, panel) in root.split_evenly((rows, columns)).iter().zip(panels) {
            panel.draw(area).map_err(|e| fail(e.to_string()))?;
        }
        root.present().map_err(|e| fail(e.to_string()))?;
    }
    let drawn = format!("width=\"{}\" height=\"{}\"", size.0, size.1);
    let shown = format!("width=\"{}\" height=\"{}\"", size.0 / FINE, size.1 / FINE);
    Ok(svg.replacen(&drawn, &shown, 1))
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
        let svg = figure("f", 2, &[panel, log, empty]).unwrap();
        for text in ["title", "t [s]", "x [m]", "name", "goal", "</svg>"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN"));
        assert!(svg.contains("width=\"920\" height=\"640\""));
    }

    #[test]
    fn equal_scales_are_equal() {
        let (x, y) = equal((0.0, 1.0), (0.0, 3.0), (px(90) + 400, px(82) + 200));
        assert!(((x.1 - x.0) / 400.0 - (y.1 - y.0) / 200.0).abs() < 1e-12);
        assert!((y.1 - y.0 - 3.0).abs() < 1e-12);
    }

    #[test]
    fn numbers_on_axes() {
        assert_eq!(
            ["0.5", "2", "0", "-0.05"],
            [0.5, 2.0, -1e-17, -0.05].map(|v| short(&v)).each_ref().map(String::as_str)
        );
    }
}
