//! A hand-eye calibration as a page: verdict · where the camera sits · errors view by view · what the robot's poses would have to be off
//! by · where the camera was · views.

use crate::calibration::hand_eye::{HandEyeReport, HeldOutView, ViewResidual};
use crate::report::chart::{Panel, Series, Symbol, figure_svg};
use crate::report::numbers::{counted, significant};
use crate::report::page::{self, escaped, figure};
use nalgebra::{Matrix6, Rotation3, Vector3};
use std::fmt::Write;

/// A view, and how the others predict it.
type ViewRow<'a> = (&'a ViewResidual, Option<&'a HeldOutView>);

/// What is shown.
#[derive(Debug, Clone, Copy)]
pub struct HandEyePage<'a> {
    /// What was found.
    pub report: &'a HandEyeReport,
    /// Images in which nothing was found, and why.
    pub unused: &'a [(String, String)],
    /// How far the mounting lies from others that are known, in words.
    pub gaps: &'a [String],
}

/// The page.
#[must_use]
pub fn hand_eye_page(shown: &HandEyePage) -> String {
    let report = shown.report;
    let views = seen(report);
    let lines = report.verdict.lines().chain(shown.gaps.iter().map(String::as_str));
    let verdict: String = lines.map(|line| escaped(line) + "<br>").collect();
    let sections = [
        format!("<p class=\"verdict\">{verdict}</p>\n"),
        place(report),
        errors(&views),
        corrections(report, &views),
        whereabouts(report),
        table(&views, shown.unused),
    ];
    page::document("Hand-eye calibration", "", &sections)
}

/// The views in their order; those that took part are what was left out one by one.
fn seen(report: &HandEyeReport) -> Vec<ViewRow<'_>> {
    let mut held = report.held_out.iter().flat_map(|held| &held.views);
    let of_others = |view: &ViewResidual| if view.used { held.next().and_then(Option::as_ref) } else { None };
    let others: Vec<_> = report.views.iter().map(of_others).collect();
    report.views.iter().zip(others).collect()
}

/// The pose and what it is good to, along each axis.
fn place(report: &HandEyeReport) -> String {
    let X = report.X_MC();
    let (roll, pitch, yaw) = Rotation3::from(X.rotation).euler_angles();
    let C: &Matrix6<f64> = &report.fit.covariance_X_MC;
    let sd: Vec<f64> = C.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect();
    let mut out = format!(
        "<h2>Where the camera sits</h2><p class=\"says\">{}, in the {}'s frame; the closed forms lie within {} of it.</p>\n",
        report.place.camera_name(),
        report.place.bearer(),
        escaped(&closed_forms(report)),
    );
    out += "<table><tr><th></th><th>x</th><th>y</th><th>z</th></tr>\n";
    let p = X.translation.vector;
    let rows: [(&str, [f64; 3], f64, usize); 4] = [
        ("position, mm", [p.x, p.y, p.z], 1e3, 3),
        ("standard deviation, mm", three(&sd, 0), 1e3, 3),
        ("roll, pitch, yaw, deg", [roll, pitch, yaw], 1f64.to_degrees(), 4),
        ("standard deviation about the axes, deg", three(&sd, 3), 1f64.to_degrees(), 4),
    ];
    for (name, values, scale, digits) in rows {
        let cells: String =
            values.iter().map(|v| format!("<td class=\"n\">{:.digits$}</td>", v * scale)).collect();
        // a String takes everything
        let _ = writeln!(out, "<tr><td>{name}</td>{cells}</tr>");
    }
    let text = report.to_toml();
    let lines: Vec<_> = text.lines().filter(|line| !line.starts_with('#')).map(escaped).collect();
    let _ = writeln!(out, "</table><p>For the run file:</p><pre>{}</pre>", lines.join("\n"));
    out
}

fn three(values: &[f64], from: usize) -> [f64; 3] {
    std::array::from_fn(|i| values.get(from + i).copied().unwrap_or(f64::NAN))
}

/// How far the closed forms lie from the refinement.
fn closed_forms(report: &HandEyeReport) -> String {
    let X = report.X_MC();
    let gaps = report.closed_forms.iter().map(|form| {
        let other = &form.X_MC;
        let mm = (other.translation.vector - X.translation.vector).norm() * 1e3;
        (mm, other.rotation.angle_to(&X.rotation).to_degrees())
    });
    let most = gaps.fold((0.0, 0.0), |a: (f64, f64), b| (a.0.max(b.0), a.1.max(b.1)));
    format!("{} mm and {} deg", significant(most.0, 2), significant(most.1, 2))
}

/// Points over the numbers of views, from one on.
fn by_view<'a>(
    views: &'a [ViewRow<'a>],
    value: impl Fn(&ViewRow<'a>) -> Option<f64> + 'a,
) -> impl Iterator<Item = (f64, f64)> + 'a {
    views.iter().enumerate().filter_map(move |(i, view)| Some((i as f64 + 1.0, value(view)?)))
}

/// The numbers of views, with half a view beside the first and the last.
fn numbered(panel: Panel, views: &[ViewRow]) -> Panel {
    panel.x_range(0.5, views.len() as f64 + 0.5)
}

fn greatest(values: impl Iterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    values.max_by(|a, b| a.1.total_cmp(&b.1))
}

fn errors(views: &[ViewRow]) -> String {
    const TITLE: &str = "Corners, view by view";
    let stated = |v: &ViewRow| v.0.rms_px;
    let corrected = |v: &ViewRow| v.0.rms_corrected_px;
    let held = |v: &ViewRow| v.1.map(|held| held.rms_px);
    let panel = numbered(Panel::new("", "view", "error of the corners, px"), views)
        .with(
            Series::new(Symbol::Circle, 0, by_view(views, stated))
                .label("with the robot's poses as they are"),
        )
        .with(
            Series::new(Symbol::Circle, 2, by_view(views, corrected)).label("with small corrections of them"),
        )
        .with(Series::new(Symbol::Cross, 1, by_view(views, held)).label("predicted by the other views"))
        .log_y_if_wide();
    let mut says = String::from("No view was left to look at.");
    if let Some((number, px)) = greatest(by_view(views, stated)) {
        says = format!(
            "With the robot's poses as they are, corners lie up to {} px off, in view {number}",
            significant(px, 2)
        );
        if let Some((number, px)) = greatest(by_view(views, held)) {
            says += &format!("; the others predict view {number} worst, to {} px", significant(px, 2));
        }
        says += ".";
    }
    let note = "Root mean square over a view's corners. Where crosses lie far above circles, that view alone decides something: take more like it.";
    figure(TITLE, &says, note, |width| figure_svg(std::slice::from_ref(&panel), 1, width, TITLE))
}

fn corrections(report: &HandEyeReport, views: &[ViewRow]) -> String {
    const TITLE: &str = "What the robot's poses would have to be off by";
    let mm = |v: &ViewRow| v.0.correction_m.map(|m| m * 1e3);
    let deg = |v: &ViewRow| v.0.correction_rad.map(f64::to_degrees);
    // the length of three coordinates of equal deviation
    let stated_mm = report.robot_stated.translation_m * 1e3 * 3f64.sqrt();
    let stated_deg = report.robot_stated.rotation_rad.to_degrees() * 3f64.sqrt();
    let ends = (0.5, views.len() as f64 + 0.5);
    let panel = |title: &str, unit: &str, points: Vec<(f64, f64)>, stated: f64| {
        numbered(Panel::new(title, "view", unit), views)
            .with(Series::new(Symbol::Circle, 0, points).label("a view"))
            .with(
                Series::new(Symbol::Limit, 0, [(ends.0, stated), (ends.1, stated)])
                    .label("usual, by what is stated"),
            )
    };
    let panels = [
        panel("Position", "mm", by_view(views, mm).collect(), stated_mm),
        panel("Rotation", "deg", by_view(views, deg).collect(), stated_deg),
    ];
    let beyond = by_view(views, mm).filter(|(_, mm)| *mm > 2.0 * stated_mm).count();
    let says = match greatest(by_view(views, mm)) {
        None => "Nothing was corrected.".to_owned(),
        Some((number, mm)) => format!(
            "At most {} mm, in view {number}; {} more than twice as far as the stated {} mm along an axis would have it.",
            significant(mm, 2),
            counted(beyond as u64, "view") + if beyond == 1 { " is" } else { " are" },
            significant(report.robot_stated.translation_m * 1e3, 2)
        ),
    };
    figure(TITLE, &says, "", |width| figure_svg(&panels, 2, width, TITLE))
}

fn whereabouts(report: &HandEyeReport) -> String {
    const TITLE: &str = "Where the camera was, as the board sees it";
    let fit = &report.fit;
    let board = fit.X_WO.inverse();
    let at: Vec<Vector3<f64>> =
        fit.arm.iter().map(|X_BE| (board * report.place.X_WM(X_BE) * fit.X_MC).translation.vector).collect();
    let points = |x: usize, y: usize| -> Vec<(f64, f64)> {
        at.iter().filter_map(|p| Some((p.get(x).copied()?, p.get(y).copied()?))).collect()
    };
    let panel = |title: &str, (x, nx): (usize, &str), (y, ny): (usize, &str)| {
        Panel::new(title, format!("{nx}, m"), format!("{ny}, m"))
            .equal_scales()
            .with(Series::new(Symbol::Circle, 0, points(x, y)).label("camera"))
            .with(Series::new(Symbol::Cross, 1, [(0.0, 0.0)]).label("O"))
    };
    let panels = [
        panel("From above the board", (0, "x of O"), (1, "y of O")),
        panel("From its side", (0, "x of O"), (2, "z of O")),
    ];
    let span = |i: usize| {
        let of = || at.iter().filter_map(move |p| p.get(i).copied());
        of().fold(f64::NEG_INFINITY, f64::max) - of().fold(f64::INFINITY, f64::min)
    };
    let says = if at.is_empty() {
        "No view took part.".to_owned()
    } else if let Some(spread) = &report.spread {
        let across_deg = spread.across_rad.to_degrees();
        format!(
            "The camera moved over {} by {} by {} m, and turned by {} deg about axes other than the one it turned about most: the more, \
             the surer its position along that one.",
            significant(span(0), 2),
            significant(span(1), 2),
            significant(span(2), 2),
            significant(across_deg, 2)
        )
    } else {
        "One view took part, of a board whose pose was known.".to_owned()
    };
    figure(TITLE, &says, "Views that took part, with the corrected poses of the robot.", |width| {
        figure_svg(&panels, 2, width, TITLE)
    })
}

fn table(views: &[ViewRow], unused: &[(String, String)]) -> String {
    let mut out = String::from(
        "<h2>Views</h2><table><tr><th></th><th>view</th><th>error, px</th><th>predicted, px</th><th>correction, mm</th><th></th></tr>\n",
    );
    let cell = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| significant(v, 3));
    for (i, (view, held)) in views.iter().enumerate() {
        let _ = writeln!(
            out,
            "<tr><td class=\"n\">{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td>{}</td></tr>",
            i + 1,
            escaped(&view.name),
            cell(view.rms_px),
            cell(held.map(|held| held.rms_px)),
            cell(view.correction_m.map(|m| m * 1e3)),
            escaped(view.reason.as_deref().unwrap_or_default())
        );
    }
    for (name, reason) in unused {
        let _ = writeln!(
            out,
            "<tr><td></td><td>{}</td><td class=\"n\">-</td><td class=\"n\">-</td><td class=\"n\">-</td><td>left out: {}</td></tr>",
            escaped(name),
            escaped(reason)
        );
    }
    out + "</table>\n"
}
