//! Measurement of one side of a tag: the position at which it crosses each pixel row (or column), and the straight line through these positions.
//!
//! Data flow: [`SideScan::read`] sums the grey levels of each row in a window across the side and reads the levels of paper and ink beside it;
//! [`SideScan::fit`] subtracts the contribution of other cells ([`Shine`]), turns the sums into positions and fits the line. The caller moves the
//! window onto the line and repeats.

use super::level_sums::LevelSums;
use super::quad::NormalFormLine;
use super::shine::{Inside, Shine, Windows, blur_of};
use crate::imaging::ImageView;
use nalgebra::Vector2;

/// Distance from the window, and length, of the windows in which the levels of paper and ink are read, px.
pub(super) const GAP_PX: f64 = 0.5;
pub(super) const LEVEL_PX: f64 = 2.0;
/// Least share of the contrast at the ends of a window. Chosen by hand: the shortest window, 1 px to each side, has it at a blur of 1.5 px. A gain that is
/// really less moves the line by too little in each round, so that it comes to rest late or not at all; half doubles the noise that
/// such rows may have, the double lets lines of narrow cells creep.
pub(super) const MIN_GAIN: f64 = 0.35;
/// Fewest rows of a side: a line takes two, and so many more are needed for its scatter. Half leaves no scatter at all; with the double sides of less
/// than 8 rows would come from the outline, which is worse.
pub(super) const MIN_ROWS: usize = 4;
/// What no scatter shows, px: levels are rounded, sides are not quite straight. Chosen by hand: half and double scale what is stated of a
/// corner without any noise; with the noise of 2 levels that tests have errors are ten times as large.
pub(super) const FLOOR_PX: f64 = 0.0012;
/// Rows of which levels differ from the side's by this share of the contrast are left out: something lies there. Chosen by hand: levels are means of
/// 2 px, so that a noise of a quarter of the contrast scatters them by 0.18 of it and keeps 95 % of the rows; half would keep two thirds,
/// and the double keeps rows that are half covered.
const LEVEL_SHARE: f64 = 0.35;
/// Rows keep so many deviations of the blur away from the neighbouring sides: beyond lies 7e-4 of their step, as the normal distribution has it. Half
/// would let 5 % of it in, the double costs small tags most of their rows.
const CLEAR_BLURS: f64 = 3.2;
/// Standard deviation of the correction for neighbouring cells: `DOUBT` times the blur, falling exponentially with the cell's width in blurs (measured
/// on images of 2 to 15 px a cell, blur 0.3 to 2 px).
const DOUBT: f64 = 1.2;
const DOUBT_FALL: f64 = 1.1;
/// Relative standard deviation of the correction for uneven illumination. In addition it is unknown whether the illumination varies before the blur (on
/// the object) or behind it (in the lens). Chosen by hand: half and double scale this part of what is stated, and nothing else.
const GROWTH_DOUBT: f64 = 0.1;

/// A measured side: its line with the covariance.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TagSide {
    /// Unit normal, and offset of the line, px.
    pub(super) normal: Vector2<f64>,
    pub(super) offset: f64,
    /// Whether rows (along y) or columns were measured.
    pub(super) along_y: bool,
    /// Mean coordinate of the used rows, px; their number; their sum of squares about the mean, px^2.
    pub(super) middle: f64,
    pub(super) n: f64,
    pub(super) ss: f64,
    /// Variance of the position in one row, px^2 along the row.
    pub(super) variance: f64,
    /// Variance of the offset of the whole line that all rows have in common, px^2.
    pub(super) common: f64,
    /// Factor from the variance of a pixel's level to `variance`, (px/level)^2; 0 where the side was not measured.
    pub(super) per_noise: f64,
    /// Blur across the side, px; 0 where it was not measured.
    pub(super) blur: f64,
    /// Width of a cell across the side, px.
    pub(super) cell: f64,
}

impl TagSide {
    pub(super) fn line(&self) -> NormalFormLine {
        NormalFormLine { normal: self.normal, offset: self.offset }
    }

    /// Variance of the line's position across itself at the point `p`, px^2.
    pub(super) fn variance_at(&self, p: Vector2<f64>) -> f64 {
        let (s, across) = if self.along_y { (p.y, self.normal.x) } else { (p.x, self.normal.y) };
        let lever = if self.ss > 0.0 { (s - self.middle).powi(2) / self.ss } else { 0.0 };
        across * across * self.variance * (1.0 / self.n + lever) + self.common + FLOOR_PX * FLOOR_PX
    }
}

/// Measurements of one row.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SideRow {
    /// Number of the row (or column), px.
    s: f64,
    /// Sum of levels over the window, level px.
    sum: f64,
    pub(super) light: f64,
    pub(super) dark: f64,
    /// Difference of the levels at the window's ends, light - dark, where the cells inside are not known.
    ends: f64,
    /// Difference of the pixels beside the edge, light - dark, where they are known.
    near: f64,
    /// Level beyond the margin, once it was looked at.
    beyond: f64,
    /// Share of white in the cell inside the border, and in the next one, once they were looked at.
    white: [f64; 2],
    pub(super) used: bool,
    /// How far the side lies from the window's middle along the row, px, once it is fitted.
    delta: f64,
}

/// Regression line `a + b (s - mean_s)` of a value over the rows, with the variance about it.
#[derive(Debug, Clone, Copy, Default)]
struct Trend {
    a: f64,
    b: f64,
    mean_s: f64,
    n: f64,
    ss: f64,
    variance: f64,
}

impl Trend {
    fn of(rows: &[SideRow], value: impl Fn(&SideRow) -> f64) -> Self {
        // sums relative to the first row, so that little is lost in their differences
        let mut used = rows.iter().filter(|r| r.used);
        let Some((s0, v0)) = used.next().map(|r| (r.s, value(r))) else { return Self::default() };
        let (mut n, mut s, mut v, mut ss, mut sv, mut vv) = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for row in used {
            let (ds, dv) = (row.s - s0, value(row) - v0);
            n += 1.0;
            s += ds;
            v += dv;
            ss += ds * ds;
            sv += ds * dv;
            vv += dv * dv;
        }
        let (mean_s, a) = (s0 + s / n, v0 + v / n);
        (ss, sv, vv) = (ss - s * s / n, sv - s * v / n, vv - v * v / n);
        let b = if ss > 0.0 { sv / ss } else { 0.0 };
        let variance = if n > 2.0 { ((vv - b * sv) / (n - 2.0)).max(0.0) } else { 0.0 };
        Self { a, b, mean_s, n, ss, variance }
    }

    fn at(&self, s: f64) -> f64 {
        self.a + self.b * (s - self.mean_s)
    }
}

/// Result of one measurement of a side.
#[derive(Debug, Clone, Copy)]
pub(super) struct SideFit {
    pub(super) side: TagSide,
    /// Gain: share of the contrast at the window's ends.
    pub(super) gain: f64,
    /// How far the line has moved, px.
    pub(super) shift: f64,
    /// Blur across the side, px; 0 where it was not measured.
    pub(super) blur: f64,
    /// Variances of the rows' levels of paper and ink about their trends along the side, levels^2.
    pub(super) level_variances: [f64; 2],
}

/// One measurement of one side.
pub(super) struct SideScan<'a> {
    pub(super) image: &'a ImageView<'a>,
    pub(super) line: NormalFormLine,
    /// Half length of the window across the side, width of a cell, length of the side, px.
    pub(super) half: f64,
    pub(super) cell: f64,
    pub(super) length: f64,
    /// Blur across the side from the measurement before, px.
    pub(super) blur: f64,
    /// The two neighbouring sides, normals outward.
    pub(super) neighbours: [NormalFormLine; 2],
    /// The side's ends.
    pub(super) from: Vector2<f64>,
    pub(super) to: Vector2<f64>,
    pub(super) inside: Option<&'a Inside>,
}

impl SideScan<'_> {
    /// Range in which levels are read, beyond the window and within the cell, px across the side.
    fn level_window(&self) -> (f64, f64) {
        let near = (self.half + GAP_PX).min((0.5 * self.cell - 0.5).max(0.5 * self.half));
        (near, (near + LEVEL_PX).min((0.7 * self.cell).max(near + 1.0)))
    }

    /// Fills `rows` with at most `most` evenly spaced rows. Returns whether these are rows (true) or columns.
    pub(super) fn read(&self, rows: &mut Vec<SideRow>, most: usize) -> bool {
        rows.clear();
        let (a, b) = (self.from, self.to);
        let normal = self.line.normal;
        let along_y = normal.x.abs() >= normal.y.abs();
        let (across, other) = if along_y { (normal.x, normal.y) } else { (normal.y, normal.x) };
        let (from, to) = if along_y { (a.y.min(b.y), a.y.max(b.y)) } else { (a.x.min(b.x), a.x.max(b.x)) };
        let size = if along_y { self.image.height() } else { self.image.width() } as f64;
        let (from, to) = (from.ceil().max(0.0), to.floor().min(size - 1.0));
        if !(to >= from) {
            return along_y;
        }
        let per = 1.0 / across.abs();
        let sign = across.signum();
        let (near, far) = self.level_window();
        // the windows along the row
        let (half, near, far) = (self.half * per, near * per, far * per);
        let per_level = 1.0 / (far - near);
        // beyond the neighbouring sides it is white, which blur carries into the window. 1.5 px keep the window's own pixels clear where there is no blur; 0.3 of the
        // side at most, so that 40 % of it is left (chosen by hand: half lets more blur in, the double would leave no row)
        let clear = (self.half + 0.5).max(CLEAR_BLURS * self.blur).clamp(1.5, (0.3 * self.length).max(1.5));
        let reach = far;
        let limit = if along_y { self.image.width() } else { self.image.height() } as f64 - 1.0;
        let (from, to) = (from as usize, to as usize);
        let mut sums = LevelSums::new(self.image);
        for k in (from..=to).step_by((to - from) / most.max(1) + 1) {
            let s = k as f64;
            let c = (self.line.offset - other * s) / across;
            if !(c - reach > 0.5 && c + reach < limit - 0.5) {
                continue;
            }
            // away from the neighbouring sides, with both ends
            let inside = [c - sign * half, c].iter().all(|&x| {
                let p = if along_y { Vector2::new(x, s) } else { Vector2::new(s, x) };
                self.neighbours.iter().all(|n| n.offset - n.normal.dot(&p) >= clear)
            });
            if !inside {
                continue;
            }
            let reach = far.max(half + 0.5);
            sums.take((k, along_y), (c - reach, c + reach));
            // levels outward from the line, up to `u`; their mean from one to the other
            let up_to = |u: f64| sign * sums.up_to(c + sign * u);
            let light = (up_to(far) - up_to(near)) * per_level;
            let dark = (up_to(-near) - up_to(-far)) * per_level;
            let (mut ends, mut beside) = (0.0, 0.0);
            if self.inside.is_some() {
                beside = up_to(1.0) - 2.0 * up_to(0.0) + up_to(-1.0);
            } else {
                ends = (up_to(half + 0.5) - up_to(half - 0.5)) - (up_to(-half + 0.5) - up_to(-half - 0.5));
            }
            rows.push(SideRow {
                s,
                sum: up_to(half) - up_to(-half),
                light,
                dark,
                ends,
                near: beside,
                beyond: light,
                white: [0.0; 2],
                used: light > dark,
                delta: 0.0,
            });
        }
        along_y
    }

    /// Reads what blur may carry into the windows of the rows: the cells inside, and the level beyond the margin.
    fn look_around(&self, along_y: bool, rows: &mut [SideRow]) {
        let Some(inside) = self.inside else { return };
        let normal = self.line.normal;
        let (across, other) = if along_y { (normal.x, normal.y) } else { (normal.y, normal.x) };
        let (per, sign) = (1.0 / across.abs(), across.signum());
        // behind the margin, which is one cell wide, and not as far as a next tag may be; chosen by hand
        let out = (1.3 * self.cell * per, (1.3 * self.cell + 1.5) * per);
        let limit = if along_y { self.image.width() } else { self.image.height() } as f64 - 1.0;
        let mut sums = LevelSums::new(self.image);
        for row in rows {
            let c = (self.line.offset - other * row.s) / across;
            let p = if along_y { Vector2::new(c, row.s) } else { Vector2::new(row.s, c) };
            row.white = inside.at((p - self.from).norm() / self.length, 0.7 / self.length);
            if c - out.1 > 0.5 && c + out.1 < limit - 0.5 {
                let (a, b) = (c + sign * out.0, c + sign * out.1);
                sums.take((row.s as u32 as usize, along_y), (a.min(b), a.max(b)));
                row.beyond = sign * (sums.up_to(b) - sums.up_to(a)) / (out.1 - out.0);
            }
        }
    }

    /// Fits the line to the rows, without outliers. `None` with too few rows or too little contrast.
    pub(super) fn fit(&self, along_y: bool, rows: &mut [SideRow]) -> Option<SideFit> {
        let normal = self.line.normal;
        let (across, other) = if along_y { (normal.x, normal.y) } else { (normal.y, normal.x) };
        let (sign, window) = (across.signum(), 2.0 * self.half / across.abs());
        let (mut light, mut dark) = (Trend::of(rows, |r| r.light), Trend::of(rows, |r| r.dark));
        let mut all_fit = true;
        for row in rows.iter_mut().filter(|r| r.used) {
            let most = LEVEL_SHARE * (light.at(row.s) - dark.at(row.s));
            row.used =
                (row.light - light.at(row.s)).abs() <= most && (row.dark - dark.at(row.s)).abs() <= most;
            all_fit &= row.used;
        }
        if !all_fit {
            (light, dark) = (Trend::of(rows, |r| r.light), Trend::of(rows, |r| r.dark));
        }
        let mut contrast = light.a - dark.a;
        // Levels: chosen by hand, half of what a tag's middle must have, because light may be uneven over the tag; the double loses the side in shadow.
        if (light.n as usize) < MIN_ROWS || !(contrast >= 5.0) {
            return None;
        }
        let gain;
        let mut blur_px = 0.0;
        if self.inside.is_some() {
            let per = 1.0 / across.abs();
            let (near, far) = self.level_window();
            let windows =
                Windows { half: self.half * per, near: near * per, far: far * per, cell: self.cell * per };
            let blur = blur_of(Trend::of(rows, |r| r.near).a / contrast);
            blur_px = blur;
            let mut shine = Shine::new(&windows, blur);
            if shine.matters() {
                self.look_around(along_y, rows);
                // contrast and blur once more without the contribution of other cells. Of the contrast the level windows show `1 - 2 own`; noise
                // grows as it is divided by this, by 3.3 at most. Chosen by hand: half allows twice the noise, the double understates narrow cells
                let full = contrast / (1.0 - 2.0 * shine.own).max(0.3);
                let beside = Trend::of(rows, |r| r.near + shine.total(r, full, 2)).a;
                let (l, d) = (
                    Trend::of(rows, |r| r.light - shine.outside(r, full, 1)).a,
                    Trend::of(rows, |r| r.dark - shine.within(r, full, 1)).a,
                );
                // bounds as above, so that noise does not grow
                let full = (l - d) / (1.0 - 2.0 * shine.own).max(0.3);
                blur_px = blur_of(beside / full);
                shine = Shine::new(&windows, blur_px);
                // bounds as above, so that noise does not grow
                let full = (l - d) / (1.0 - 2.0 * shine.own).max(0.3);
                for row in rows.iter_mut() {
                    let (within, outside) = (shine.within(row, full, 0), shine.outside(row, full, 0));
                    let level = (shine.within(row, full, 1), shine.outside(row, full, 1));
                    row.sum -= within + outside;
                    row.dark -= level.0;
                    row.light -= level.1;
                }
                (light, dark) = (Trend::of(rows, |r| r.light), Trend::of(rows, |r| r.dark));
            }
            // bounds as above, so that noise does not grow
            contrast = ((light.a - dark.a) / (1.0 - 2.0 * shine.own).max(0.3)).max(5.0);
            gain = shine.gain.clamp(MIN_GAIN, 1.0);
        } else {
            gain = (Trend::of(rows, |r| r.ends).a / contrast).clamp(MIN_GAIN, 1.0);
        }
        let own = contrast / (light.a - dark.a).max(1.0);
        // with uneven illumination the levels, which are read farther out than the window reaches, differ from those within it
        let (near, far) = self.level_window();
        let blur = blur_px * across.abs();
        // the effect of a unit slope on the window's sum, as the mean of both cases: illumination that varies before the blur, and behind it.
        // Less blur than 0.1 px would divide by nothing
        let z = self.half / blur.max(0.1);
        let lit = 0.5 * self.half * self.half * gain
            + self.half * blur * (-0.5 * z * z).exp() * 0.398_942_280_401_432_7;
        let light_per_px =
            self.inside.map_or(0.0, |i| if along_y { i.light_per_px.x } else { i.light_per_px.y });
        let growth = light_per_px * (lit - 0.5 * self.half * (near + far)) / (gain * across * across);
        // a quarter of the side's contrast at least, so that rows of deep shadow do not divide by nothing; chosen by hand
        let least = 0.25 * contrast;
        let per_sum = |r: &SideRow| sign / ((own * (light.at(r.s) - dark.at(r.s))).max(least) * gain);
        for row in rows.iter_mut() {
            let (l, d) = (light.at(row.s), dark.at(row.s));
            row.delta = growth - (row.sum - 0.5 * window * (l + d)) * per_sum(row);
        }
        let mut trend = Trend::of(rows, |r| r.delta);
        // Beyond three deviations lie 0.27 % of normal errors, so that hardly any good row is lost; 0.1 px at least, because where nothing but
        // rounding scatters the rows of a bowed side would otherwise be left out. Chosen by hand: half and double change which rows those are.
        let most = (3.0 * trend.variance.sqrt()).max(0.1);
        let mut all_fit = true;
        for row in rows.iter_mut().filter(|r| r.used) {
            row.used = (row.delta - trend.at(row.s)).abs() <= most;
            all_fit &= row.used;
        }
        if !all_fit {
            trend = Trend::of(rows, |r| r.delta);
        }
        if (trend.n as usize) < MIN_ROWS {
            return None;
        }
        // with each row's own levels instead of the side's: the same line, but a scatter that contains that of the levels
        let scatter = Trend::of(rows, |r| {
            let apart = r.light - light.at(r.s) + r.dark - dark.at(r.s);
            r.delta + 0.5 * window * apart * per_sum(r)
        });
        // the line so far is `c = (offset - other s) / across`; the measured one is `c + delta`
        let slope = -other / across + trend.b;
        let crossing = (self.line.offset - other * trend.mean_s) / across + trend.a;
        let shift = (trend.a.abs() + trend.b.abs() * (trend.ss / trend.n).sqrt()) * across.abs();
        let n = Vector2::new(sign, -sign * slope).normalize();
        let normal = if along_y { n } else { Vector2::new(n.y, n.x) };
        let at =
            if along_y { Vector2::new(crossing, trend.mean_s) } else { Vector2::new(trend.mean_s, crossing) };
        let side = TagSide {
            normal,
            offset: normal.dot(&at),
            along_y,
            middle: trend.mean_s,
            n: trend.n,
            ss: trend.ss,
            variance: scatter.variance.max(trend.variance),
            // no blur is as good as one of 0.1 px, since nothing of either reaches another cell
            common: (DOUBT * blur * (-DOUBT_FALL * self.cell / blur.max(0.1)).exp()).powi(2)
                + (GROWTH_DOUBT * growth * across).powi(2)
                + (0.5 * light_per_px / across * blur * blur).powi(2),
            per_noise: window / (contrast * gain).powi(2),
            blur,
            cell: self.cell,
        };
        (shift < 2.0 * self.half).then_some(SideFit {
            side,
            gain,
            shift,
            blur,
            level_variances: [light.variance, dark.variance],
        })
    }
}

impl Shine {
    /// Contribution of the cells within the border to the sum, dark level or difference (`what` 0 to 2) of a row.
    fn within(&self, row: &SideRow, contrast: f64, what: usize) -> f64 {
        let share = |i: usize| self.inner.get(i).and_then(|s| s.get(what)).copied().unwrap_or(0.0);
        contrast * (row.white[0] * share(0) + (row.white[1] - row.white[0]) * share(1))
    }

    /// Contribution of the ground beyond the margin to the sum, light level or difference.
    fn outside(&self, row: &SideRow, contrast: f64, what: usize) -> f64 {
        // a noisy level must not give more than a full step
        let step = (row.beyond - row.light).clamp(-contrast, contrast);
        step * self.outer.get(what).copied().unwrap_or(0.0)
    }

    /// Both contributions together, as what they take from the difference beside the edge.
    fn total(&self, row: &SideRow, contrast: f64, what: usize) -> f64 {
        self.within(row, contrast, what) - self.outside(row, contrast, what)
    }
}
