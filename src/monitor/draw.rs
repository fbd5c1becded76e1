//! The screen of a run: made for 80 columns and 24 rows, with more room for image and error curve in a larger terminal, and less of all in a smaller one.
//!
//! ```text
//! instance, clock, time                                        at the top
//! STATE what it waits for
//! errors, goal
//! image plane: points, goals, trails │ error curve
//!                                    │ joints between their limits
//! latencies
//! deadline to command: histogram
//! cameras
//! robot, restarts                                              where there is something to tell
//! events, the newest below
//! keys, or a question                                          at the bottom
//! ```
//! The numbers here are layout; they were chosen by hand for 80 columns and 24 rows.

use super::plot::DotPlot;
use super::run_view::{Newest, RunView};
use super::screen::{CellStyle, Screen};
use crate::messages::{
    CameraState, ControlState, Measurement, Status, TargetStatus, health_flag, status_flag,
};
use crate::motion::Limit;
use crate::report::histogram::SpanHistogram;
use crate::report::run_page::JointSummary;
use crate::time::MonoNs;

/// Rows above the pictures, and below them without the events.
const HEAD: usize = 3;
const FOOT: usize = 4;
/// Events that a small screen shows.
const FEW_EVENTS: usize = 3;
/// Heights of a bar in a cell, in eighths, as Unicode has them.
const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
/// Upper edges of the histogram's bars, us.
pub(super) const EDGES_US: [f64; 11] =
    [20.0, 50.0, 100.0, 150.0, 200.0, 300.0, 500.0, 750.0, 1000.0, 2000.0, 10_000.0];

/// Draws a run as it is at `now` by the watcher's clock; `asks`: whether a stop is to be confirmed.
#[must_use]
pub fn draw(view: &RunView, now: MonoNs, asks: bool, (columns, rows): (usize, usize)) -> Screen {
    let mut screen = Screen::new(columns, rows);
    head(&mut screen, view, now);
    let joints = view.facts.joints.len();
    // All joints, and a curve of four rows, before events get more than three.
    let room = rows.saturating_sub(HEAD + FOOT + FEW_EVENTS);
    let pictures = room.min((joints + 6).max(12) + room / 3);
    let left = (columns * 2 / 5).min(pictures * 3);
    image_plane(&mut screen, view, HEAD, left, pictures);
    let right = left + 1;
    let curve = pictures.saturating_sub(joints + 2);
    error_curve(&mut screen, view, (HEAD, right), (columns.saturating_sub(right), curve));
    joint_rows(&mut screen, view, (HEAD + curve, right), (columns.saturating_sub(right), pictures - curve));
    let mut row = HEAD + pictures;
    let known = robot_and_restarts(view);
    for line in [Some(latencies(view)), Some(cameras(view, now)), known].into_iter().flatten() {
        screen.text(row, 0, &line.0, line.1);
        row += 1;
    }
    histogram(&mut screen, row, view);
    row += 1;
    let places = rows.saturating_sub(row + 1);
    for (i, (time_s, what)) in view.events.iter().rev().take(places).rev().enumerate() {
        let style = if what.starts_with("fault") { CellStyle::Bad } else { CellStyle::Faint };
        screen.text(row + i, 0, &format!("{time_s:9.3} s  {what}"), style);
    }
    foot(&mut screen, view, asks);
    screen
}

fn head(screen: &mut Screen, view: &RunView, now: MonoNs) {
    let (columns, facts) = (screen.columns(), &view.facts);
    screen.text(0, 0, &" ".repeat(columns), CellStyle::Reverse);
    let clock = if facts.lockstep { "simulated time" } else { "real time" };
    let kind = if facts.serves { "served" } else { "run" };
    let time_s = view.status.map_or(f64::NAN, |newest| newest.record.time_s);
    let text = format!(" vservo monitor   {}   {kind}, {clock}", facts.instance);
    screen.text(0, 0, &text, CellStyle::Reverse);
    let time = format!("{} s ", fixed(time_s, 1));
    screen.text(0, columns.saturating_sub(time.len()), &time, CellStyle::Reverse);
    let state = view.state();
    let (words, is_good) = view.waits_for(now);
    let style = match state {
        Some(ControlState::Fault) => CellStyle::Bad,
        _ if is_good => CellStyle::Good,
        _ => CellStyle::Doubtful,
    };
    let word = state.map_or("unknown", ControlState::as_str).to_uppercase();
    let at = screen.text(1, 0, &word, CellStyle::Bold);
    screen.text(1, at + 2, &words, style);
    let Some(Newest { record: s, .. }) = view.status else { return };
    let mut text = format!("feature error {} px", fixed(s.feature_error_px, 3));
    if s.position_error_m.is_finite() {
        let deg = s.orientation_error_rad.to_degrees();
        text += &format!("   camera {:.2} mm {deg:.3} deg from the goal", s.position_error_m * 1e3);
    }
    text += &format!("   goal {}", s.goal);
    if let Some(name) = view.target_name(s.target_number) {
        text += &format!(" of the target {name}");
    }
    if s.flags & status_flag::DEGRADED != 0 {
        text += "   a part is hidden";
    }
    screen.text(2, 0, &text, CellStyle::Plain);
}

/// A number with its decimals, or a dash.
fn fixed(x: f64, decimals: usize) -> String {
    if x.is_finite() { format!("{x:.decimals$}") } else { "-".into() }
}

fn image_plane(screen: &mut Screen, view: &RunView, row: usize, columns: usize, rows: usize) {
    let [width, height] = view.facts.image_px;
    if rows < 3 || columns < 8 || !(width > 0.0 && height > 0.0) {
        return;
    }
    let mut plot = DotPlot::new(row + 1, 0, columns, rows - 1);
    let (dots_x, dots_y) = plot.dots();
    // The whole image, and half a dot of it about.
    let scale = ((dots_x - 1.0) / width).min((dots_y - 1.0) / height);
    let at = |[u, v]: [f64; 2]| ((u + 0.5) * scale, (v + 0.5) * scale);
    let corners = [[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]];
    for (i, corner) in corners.iter().enumerate() {
        plot.line(at(*corner), at(corners[(i + 1) % corners.len()]), CellStyle::Faint);
    }
    for trail in view.trails.values() {
        for (a, b) in trail.iter().zip(trail.iter().skip(1)) {
            plot.line(at(*a), at(*b), CellStyle::Faint);
        }
    }
    plot.put(screen);
    // Goals and points are signs, so that they are told from trails without colours.
    let mut sign = |p: [f64; 2], symbol, style| {
        let (x, y) = at(p);
        if x >= 0.0 && y >= 0.0 && x < dots_x && y < dots_y {
            screen.put(row + 1 + y as usize / 4, x as usize / 2, symbol, style);
        }
    };
    view.goal_px.values().for_each(|goal| sign(*goal, 'o', CellStyle::Goal));
    let seen = view.measurement.filter(|newest| newest.record.found());
    for feature in seen.iter().flat_map(|newest| newest.record.features()) {
        sign([feature.u_px, feature.v_px], '+', CellStyle::Good);
    }
    let first = seen.and_then(|newest| newest.record.features().first().copied());
    let place = first.map_or(String::new(), |f| format!("  {}: {:.1} {:.1}", f.id + 1, f.u_px, f.v_px));
    let title: String = format!("+ seen o goal{place}").chars().take(columns).collect();
    screen.text(row, 0, &title, CellStyle::Faint);
}

/// The feature error over the last measurements, on a logarithmic scale.
fn error_curve(
    screen: &mut Screen,
    view: &RunView,
    (row, column): (usize, usize),
    (columns, rows): (usize, usize),
) {
    const LABEL: usize = 8;
    if rows < 2 || columns < LABEL + 8 {
        return;
    }
    screen.text(row, column, "feature error, px, and - the tolerance", CellStyle::Faint);
    let mut plot = DotPlot::new(row + 1, column + LABEL, columns - LABEL, rows - 1);
    let (dots_x, dots_y) = plot.dots();
    let shown: Vec<f64> = {
        let skip = view.errors.len().saturating_sub(dots_x as usize);
        view.errors.iter().skip(skip).map(|(_, px)| *px).collect()
    };
    let tolerance = view.facts.goal_error_px;
    let all = || shown.iter().copied().chain(Some(tolerance)).filter(|x| *x > 0.0);
    let (Some(low), Some(high)) = (all().reduce(f64::min), all().reduce(f64::max)) else { return };
    // Whole decades, one at least.
    let (low, high) = (low.log10().floor(), high.log10().ceil().max(low.log10().floor() + 1.0));
    let y = |x: f64| (high - x.max(f64::MIN_POSITIVE).log10()) / (high - low) * (dots_y - 1.0);
    if tolerance > 0.0 {
        for x in (0..dots_x as usize).step_by(4) {
            plot.dot(x as f64, y(tolerance), CellStyle::Goal);
        }
    }
    for (x, pair) in shown.windows(2).enumerate() {
        plot.line((x as f64, y(pair[0])), ((x + 1) as f64, y(pair[1])), CellStyle::Plain);
    }
    plot.put(screen);
    for (at, decade) in [(row + 1, high), (row + rows - 1, low)] {
        screen.text(at, column, &format!("{:>7}", 10_f64.powf(decade)), CellStyle::Faint);
    }
}

fn joint_rows(
    screen: &mut Screen,
    view: &RunView,
    (row, column): (usize, usize),
    (columns, rows): (usize, usize),
) {
    let Some(trace) = &view.trace else { return };
    let bar = columns.saturating_sub(36).clamp(8, 40);
    if rows > 0 {
        let title =
            format!("{:<9}{:<width$}  position   speed effort", "joint", "lower .. upper", width = bar);
        screen.text(row, column, &title, CellStyle::Faint);
    }
    for (i, joint) in view.facts.joints.iter().enumerate().take(rows.saturating_sub(1)) {
        let at = |values: &[f64]| values.get(i).copied().unwrap_or(f64::NAN);
        let held = |limit: Limit| {
            trace.limits.get(limit as usize).is_some_and(|m| m.checked_shr(i as u32).unwrap_or(0) & 1 == 1)
        };
        let acting = Limit::ALL.iter().any(|limit| held(*limit));
        let style = if acting { CellStyle::Doubtful } else { CellStyle::Plain };
        let name: String = joint.name.chars().rev().take(8).collect::<Vec<_>>().into_iter().rev().collect();
        let row = row + 1 + i;
        screen.text(row, column, &name, CellStyle::Faint);
        screen.text(row, column + 9, &joint_bar(joint, at(&trace.q), bar), style);
        let (value, unit) =
            if joint.slides { (at(&trace.q) * 1e3, "mm ") } else { (at(&trace.q).to_degrees(), "deg") };
        let share = |x: f64, limit: f64| {
            let percent = 100.0 * x.abs() / limit;
            if percent.is_finite() { format!("{:>3.0} %", percent.min(999.0)) } else { "    -".into() }
        };
        let text = format!(
            "{value:>9.2} {unit} {} {}{}",
            share(at(&trace.qd), joint.velocity),
            share(at(&trace.tau), joint.effort),
            if acting { " !" } else { "" }
        );
        screen.text(row, column + 9 + bar, &text, style);
    }
}

/// Where a joint is between its limits.
fn joint_bar(joint: &JointSummary, q: f64, columns: usize) -> String {
    let inner = columns.saturating_sub(2);
    let share = (q - joint.lower) / (joint.upper - joint.lower);
    if !share.is_finite() {
        // A continuous joint has no limits.
        return " ".repeat(columns);
    }
    let place = (share.clamp(0.0, 1.0) * (inner.saturating_sub(1)) as f64).round() as usize;
    let inside: String = (0..inner).map(|i| if i == place { '#' } else { '-' }).collect();
    format!("[{inside}]")
}

type StyledLine = (String, CellStyle);

fn latencies(view: &RunView) -> StyledLine {
    let Some(Newest { record: s, .. }) = view.status else { return Default::default() };
    let ms = |us: f64| fixed(us * 1e-3, 1);
    let quantile = |q| ms(view.latencies.quantile_ns(q) as f64 * 1e-3);
    let mut text =
        format!("latency ms: exposure {}, wait {}", ms(s.exposure_to_frame_us), ms(s.frame_to_vision_us));
    text += &format!(", vision {}, control {}", ms(s.vision_us), ms(s.measurement_to_command_us));
    text += &format!("; p50 {} p99 {} max {}", quantile(0.5), quantile(0.99), quantile(1.0));
    (text, CellStyle::Plain)
}

fn histogram(screen: &mut Screen, row: usize, view: &RunView) {
    let times: &SpanHistogram = &view.tick_times;
    let missed = view.status.map_or(0, |newest| newest.record.missed_deadlines);
    if times.count() == 0 {
        let text = if view.facts.lockstep { "ticks have no deadline in simulated time" } else { "" };
        screen.text(row, 0, text, CellStyle::Faint);
        return;
    }
    let counts = tick_counts(times);
    let quantile = |q| times.quantile_ns(q) as f64 * 1e-3;
    let text = format!(
        "deadline to command us: p50 {:.0} p99 {:.0} max {:.0} ",
        quantile(0.5),
        quantile(0.99),
        quantile(1.0)
    );
    let mut at = screen.text(row, 0, &text, CellStyle::Plain);
    let most = (counts.iter().copied().max().unwrap_or(1).max(1) as f64).ln_1p();
    for count in counts {
        // logarithmic, so that single late ticks are seen; what is there is a bar at least
        let eighths = ((count as f64).ln_1p() / most * 8.0).ceil() as usize;
        screen.put(row, at, BARS[eighths.min(8)], CellStyle::Plain);
        at += 1;
    }
    let style = if missed > 0 { CellStyle::Doubtful } else { CellStyle::Plain };
    screen.text(row, at, &format!("  {missed} missed"), style);
}

/// Ticks up to each of [`EDGES_US`], and above the last.
pub(super) fn tick_counts(times: &SpanHistogram) -> [u64; EDGES_US.len() + 1] {
    let mut counts = [0; EDGES_US.len() + 1];
    for (edge_us, count) in times.buckets_us() {
        // a bucket belongs where its upper edge lies
        counts[EDGES_US.iter().position(|edge| edge_us <= *edge).unwrap_or(EDGES_US.len())] += count;
    }
    counts
}

fn cameras(view: &RunView, now: MonoNs) -> StyledLine {
    let Some(Newest { record: s, .. }) = view.status else { return Default::default() };
    let Status { frames, frames_dropped, target_lost, .. } = s;
    let m: Option<Measurement> = view.measurement.map(|newest| newest.record);
    let mut text =
        format!("camera  {frames} frames, {frames_dropped} skipped, target lost {target_lost} times");
    let mut style = CellStyle::Plain;
    if let Some(m) = m {
        let status = m.target_status();
        text += &format!("  reprojection {} px", fixed(m.reprojection_rms_px, 2));
        if status != TargetStatus::Found {
            (text, style) = (format!("{text}  {}", status.as_str()), CellStyle::Doubtful);
        }
    }
    for (number, health) in &view.health {
        let state = CameraState::from_code(health.state);
        text = format!(
            "camera {number}: {} {} Hz, {} lost",
            state.as_str(),
            fixed(health.rate_hz, 1),
            health.lost
        ) + &text[if text.starts_with("camera ") { "camera".len() } else { 0 }..];
        for (flag, word) in [
            (health_flag::STAMPS_DOUBTED, ", stamps doubted"),
            (health_flag::RATE_MISSED, ", other rate than asked"),
        ] {
            if health.flags & flag != 0 {
                text += word;
                style = CellStyle::Doubtful;
            }
        }
        if state.is_away() {
            style = CellStyle::Bad;
        }
    }
    if let Some(for_s) = view.blind_for_s(now).filter(|_| view.ended.is_none()) {
        return (
            format!("camera  no measurement for {for_s:.1} s; {}", text.trim_start_matches("camera")),
            CellStyle::Bad,
        );
    }
    (text, style)
}

/// What the robot is beside its joints, and how often processes were started anew; `None` where neither is known of.
fn robot_and_restarts(view: &RunView) -> Option<StyledLine> {
    let robot = view.robot_row();
    let [camera, vision] = view.restarts();
    let anew = (camera + vision > 0).then(|| format!("started anew: camera {camera}, vision {vision} times"));
    let style = match (robot.as_ref().is_none_or(|row| row.obeys), &anew) {
        (false, _) => CellStyle::Bad,
        (true, Some(_)) => CellStyle::Doubtful,
        (true, None) => CellStyle::Plain,
    };
    let robot = robot.map(|row| format!("robot  {}", row.words));
    let words: Vec<_> = robot.into_iter().chain(anew).collect();
    (!words.is_empty()).then(|| (words.join("   "), style))
}

fn foot(screen: &mut Screen, view: &RunView, asks: bool) {
    let Some(row) = screen.rows().checked_sub(1) else { return };
    screen.text(row, 0, &" ".repeat(screen.columns()), CellStyle::Plain);
    if asks {
        let ends = if view.facts.serves { "" } else { ", which ends this run" };
        screen.text(row, 0, &format!("Stop the arm{ends}? y: yes, any other key: no"), CellStyle::Reverse);
        return;
    }
    let at = screen.text(row, 0, "s start  h hold  x stop  t teach  r reset  q quit", CellStyle::Faint);
    screen.text(row, at + 3, &view.word, CellStyle::Bold);
}

#[cfg(test)]
mod tests;
