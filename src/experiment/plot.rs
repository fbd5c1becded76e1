//! Figures as SVG text: panels side by side, curves, dashed goals, crosses and circles for starts and ends.

use super::ExperimentError;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::Color;

/// The drawing library rounds to whole units; it draws this much larger than the figure is shown.
const FINE: u32 = 4;
/// Size of one panel, px.
const PANEL_PX: (u32, u32) = (420 * FINE, 320 * FINE);
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
pub enum Mark {
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
    mark: Mark,
    colour: usize,
}

impl Series {
    /// A series in the colour of this number, without a label.
    pub fn new(mark: Mark, colour: usize, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        Self { label: None, points, mark, colour }
    }

    /// A line.
    pub fn line(colour: usize, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(Mark::Line, colour, points)
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

    /// Where a legend hides least.
    fn emptiest_corner(&self, x: (f64, f64), share_y: &dyn Fn(f64) -> f64) -> SeriesLabelPosition {
        let mut hidden = [0; 4];
        let mut cover = |(px, py): (f64, f64), weight: usize| {
            let (u, v) = ((px - x.0) / (x.1 - x.0), share_y(py));
            let (left, right, low, high) = (u < 0.35, u > 0.65, v < 0.4, v > 0.6);
            for (count, inside) in
                hidden.iter_mut().zip([right && high, right && low, left && high, left && low])
            {
                *count += if inside { weight } else { 0 };
            }
        };
        for series in &self.series {
            match (series.mark, series.points.as_slice()) {
                (Mark::Cross | Mark::Circle, points) => points.iter().for_each(|p| cover(*p, 60)),
                // a goal: two points, a line between them
                (Mark::Dashed, [a, b]) => (0..=20).for_each(|i| {
                    let share = f64::from(i) / 20.0;
                    cover((a.0 + (b.0 - a.0) * share, a.1 + (b.1 - a.1) * share), 10);
                }),
                (_, points) => thinned(points).for_each(|p| cover(p, 1)),
            }
        }
        let corners = [
            SeriesLabelPosition::UpperRight,
            SeriesLabelPosition::LowerRight,
            SeriesLabelPosition::UpperLeft,
            SeriesLabelPosition::LowerLeft,
        ];
        let best = corners.into_iter().zip(hidden).min_by_key(|(_, hidden)| *hidden);
        best.map_or(SeriesLabelPosition::UpperRight, |(corner, _)| corner)
    }

    fn time_axis(&self) -> bool {
        self.x_label.contains("[s]")
    }

    fn draw<'a, DB: DrawingBackend + 'a>(
        &self,
        area: &DrawingArea<DB, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        let (mut x, mut y) = (self.range(|p| p.0), self.range(|p| p.1));
        if !self.time_axis() {
            x = widened(x);
        }
        let mut builder = ChartBuilder::on(area);
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
            let share_y = |y: f64| (y.log10() - low) / (high.max(low + 1.0) - low);
            return self.fill(&mut chart, x, &share_y);
        }
        y = self.y_range.unwrap_or_else(|| widened(y));
        if self.equal {
            (x, y) = equal(x, y, area.dim_in_pixel());
        }
        let mut chart = builder.build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        self.mesh(&mut chart, &short)?;
        self.fill(&mut chart, x, &|v: f64| (v - y.0) / (y.1 - y.0))
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

    fn fill<'a, DB, Y>(
        &self,
        chart: &mut ChartContext<'a, DB, Cartesian2d<plotters::coord::types::RangedCoordf64, Y>>,
        x: (f64, f64),
        share_y: &dyn Fn(f64) -> f64,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>>
    where
        DB: DrawingBackend + 'a,
        Y: Ranged<ValueType = f64>,
    {
        for series in &self.series {
            let colour = PALETTE.get(series.colour % PALETTE.len()).copied().unwrap_or(BLACK);
            let style = colour.stroke_width(px(2));
            let points = || thinned(&series.points);
            let drawn = match series.mark {
                Mark::Line => chart.draw_series(LineSeries::new(points(), style))?,
                Mark::Dashed => chart.draw_series(DashedLineSeries::new(
                    points(),
                    px(6),
                    px(4),
                    colour.stroke_width(px(1)),
                ))?,
                Mark::Cross => chart.draw_series(points().map(|p| Cross::new(p, px(5), style)))?,
                Mark::Circle => chart.draw_series(points().map(|p| Circle::new(p, px(5), style)))?,
            };
            let Some(label) = &series.label else { continue };
            let mark = series.mark;
            let end = move |x: i32| x + px(16) as i32;
            drawn.label(label).legend(move |(x, y)| match mark {
                Mark::Line => PathElement::new(vec![(x, y), (end(x), y)], style).into_dyn(),
                Mark::Dashed => {
                    let dash = plotters::element::DashedPathElement::new(
                        [(x, y), (end(x), y)],
                        px(4),
                        px(3),
                        colour.stroke_width(px(1)),
                    );
                    dash.into_dyn()
                }
                Mark::Cross => Cross::new((x + px(8) as i32, y), px(4), style).into_dyn(),
                Mark::Circle => Circle::new((x + px(8) as i32, y), px(4), style).into_dyn(),
            });
        }
        if self.series.iter().any(|s| s.label.is_some()) {
            let corner = self.emptiest_corner(x, share_y);
            chart
                .configure_series_labels()
                .position(corner)
                .margin(px(6))
                .legend_area_size(px(24))
                .background_style(WHITE.mix(0.85))
                .border_style(BLACK.mix(0.3).stroke_width(FINE))
                .label_font(font(12))
                .draw()?;
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
            .with(Series::new(Mark::Cross, 1, [(0.0, f64::NAN)]))
            .with(Series::new(Mark::Dashed, 8, [(0.0, 1.0), (9.0, 1.0)]).label("goal"));
        let log = Panel::new("error", "n", "e").log_y().with(Series::line(0, [(0.0, 1.0), (1.0, 1e-9)]));
        let empty = Panel::new("nothing", "X", "Y").equal_scales();
        let svg = figure("f", 2, &[panel, log, empty]).unwrap();
        for text in ["title", "t [s]", "x [m]", "name", "goal", "</svg>"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN"));
        assert!(svg.contains("width=\"840\" height=\"640\""));
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
