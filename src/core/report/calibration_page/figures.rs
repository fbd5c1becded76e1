//! Figures over the image, SVG in pixels of the image. The numbers here are a layout's, chosen by eye so that figures read well, but for the
//! colours, which are five of the scale Viridis (Smith and van der Walt).

use crate::calibration::camera::{CameraCalibration, ImageCoverage, NextView, ProjectionUncertainty};
use nalgebra::Vector2;
use std::fmt::Write;

/// Cells of the map of uncertainty.
const MAP: (u32, u32) = (40, 30);
/// From dark to light, as the eye sees equal steps.
const COLOURS: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];

/// A figure and what it is stretched by.
pub(super) struct Stretched {
    pub(super) svg: String,
    pub(super) scale: f64,
}

fn open((width, height): (u32, u32)) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"over\" viewBox=\"-0.5 -0.5 {width} {height}\">"
    )
}

fn size(calibration: &CameraCalibration) -> (u32, u32) {
    let i = calibration.camera.intrinsics();
    (i.width_px, i.height_px)
}

/// Line width and size of letters for an image: on a telephone an image is half as wide.
fn pen(size: (u32, u32)) -> (f64, f64) {
    let width = f64::from(size.0);
    (width / 640.0, width / 28.0)
}

/// Errors of corners as lines from where they are seen, away from where they are predicted.
pub(super) fn errors(calibration: &CameraCalibration) -> Stretched {
    let size = size(calibration);
    let (pen, _) = pen(size);
    // the usual error becomes a fiftieth of the image
    let scale = (f64::from(size.0) / 50.0 / calibration.rms_px.max(1e-9)).clamp(1.0, 1e6);
    let scale = 10f64.powf(scale.log10().floor()) * (scale / 10f64.powf(scale.log10().floor())).round();
    let mut svg = open(size);
    for point in calibration.views.iter().flat_map(|v| v.points.iter().map(move |p| (v.unused.is_none(), p)))
    {
        let (in_use, p) = point;
        let end = p.px + p.error_px * scale;
        let end = if (end - p.px).norm() < 0.5 * f64::from(size.0) { end } else { p.px };
        let colour = if in_use && p.used { "#0072b2" } else { "#d55e00" };
        let _ = write!(
            svg,
            "<path d=\"M{:.1} {:.1}L{:.1} {:.1}\" stroke=\"{colour}\" stroke-width=\"{pen:.2}\"/><circle cx=\"{:.1}\" cy=\"{:.1}\" \
             r=\"{:.2}\" fill=\"{colour}\"/>",
            p.px.x,
            p.px.y,
            end.x,
            end.y,
            p.px.x,
            p.px.y,
            1.3 * pen
        );
    }
    svg.push_str("</svg>");
    Stretched { svg, scale }
}

/// Colour of a share from 0 to 1.
fn colour(share: f64) -> String {
    let at = share.clamp(0.0, 1.0) * (COLOURS.len() - 1) as f64;
    let i = (at as usize).min(COLOURS.len() - 2);
    let (a, b) =
        (COLOURS.get(i).copied().unwrap_or_default(), COLOURS.get(i + 1).copied().unwrap_or_default());
    let mix = |k: usize| {
        let (a, b) = (a.get(k).copied().unwrap_or(0.0), b.get(k).copied().unwrap_or(0.0));
        (a + (b - a) * (at - i as f64)).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

/// The map of uncertainty, with its values at nine places.
pub(super) fn uncertainty(uncertainty: &ProjectionUncertainty, size: (u32, u32)) -> String {
    let (width, height) = (f64::from(size.0), f64::from(size.1));
    let (columns, rows) = MAP;
    let (w, h) = (width / f64::from(columns), height / f64::from(rows));
    let cells = (0..rows).flat_map(|j| (0..columns).map(move |i| (f64::from(i), f64::from(j))));
    let values: Vec<_> = cells
        .map(|(i, j)| {
            let px = Vector2::new((i + 0.5) * w - 0.5, (j + 0.5) * h - 0.5);
            (i, j, uncertainty.sd_px(&px).clamp(1e-6, 1e6))
        })
        .collect();
    let (low, high) = values.iter().fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v.2), h.max(v.2)));
    let span = (high / low).ln().max(1e-9);
    let mut svg = open(size);
    for (i, j, value) in &values {
        let _ = write!(
            svg,
            "<rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{}\"/>",
            i * w - 0.5,
            j * h - 0.5,
            w * 1.02,
            h * 1.02,
            colour((value / low).ln() / span)
        );
    }
    let (pen, letters) = pen(size);
    for (x, y) in [0.06, 0.5, 0.94].into_iter().flat_map(|y| [0.06, 0.5, 0.94].map(|x| (x, y))) {
        let px = Vector2::new(x * (width - 1.0), y * (height - 1.0));
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"{letters:.1}\" text-anchor=\"middle\" fill=\"#fff\" stroke=\"#000\" \
             stroke-width=\"{:.2}\" paint-order=\"stroke\">{:.2}</text>",
            px.x,
            px.y + 0.35 * letters,
            3.0 * pen,
            uncertainty.sd_px(&px)
        );
    }
    svg.push_str("</svg>");
    svg
}

/// Cells by their number of corners, and the corners.
pub(super) fn coverage(coverage: &ImageCoverage, calibration: &CameraCalibration) -> String {
    let size = size(calibration);
    let (pen, _) = pen(size);
    let (columns, rows) = (coverage.columns.max(1), (coverage.counts.len() / coverage.columns.max(1)).max(1));
    let (w, h) = (f64::from(size.0) / columns as f64, f64::from(size.1) / rows as f64);
    let most = f64::from(coverage.counts.iter().copied().max().unwrap_or(1).max(1));
    let mut svg = open(size);
    for (i, count) in coverage.counts.iter().enumerate() {
        let (x, y) = ((i % columns) as f64 * w - 0.5, (i / columns) as f64 * h - 0.5);
        let fill = match count {
            0 => "#f7d9c9".into(),
            n => {
                let level = (235.0 - 130.0 * (f64::from(*n) / most).sqrt()) as u8;
                format!("#{level:02x}{:02x}ff", level.saturating_add(12))
            }
        };
        let _ = write!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"{fill}\" stroke=\"#fff\" stroke-width=\"{pen:.2}\"/>"
        );
    }
    for p in calibration.points_used() {
        let _ = write!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.2}\" fill=\"#222\"/>",
            p.px.x,
            p.px.y,
            1.1 * pen
        );
    }
    svg.push_str("</svg>");
    svg
}

/// The next view over those there are.
pub(super) fn next(next: &NextView, calibration: &CameraCalibration) -> String {
    let size = size(calibration);
    let (pen, letters) = pen(size);
    let mut svg = open(size);
    let dots = |svg: &mut String, px: &mut dyn Iterator<Item = Vector2<f64>>, r: f64, colour: &str| {
        for px in px {
            let _ =
                write!(svg, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{r:.2}\" fill=\"{colour}\"/>", px.x, px.y);
        }
    };
    dots(&mut svg, &mut calibration.points_used().map(|p| p.px), 1.2 * pen, "#bbb");
    let path =
        next.corners_px.iter().map(|px| format!("{:.1} {:.1}", px.x, px.y)).collect::<Vec<_>>().join("L");
    let _ = write!(
        svg,
        "<path d=\"M{path}\" fill=\"none\" stroke=\"#0072b2\" stroke-width=\"{:.2}\" opacity=\".45\"/>",
        pen
    );
    dots(&mut svg, &mut next.corners_px.iter().copied(), 2.6 * pen, "#0072b2");
    if let Some(first) = next.corners_px.first() {
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"{letters:.1}\" fill=\"#0072b2\">first corner</text>",
            first.x + 4.0 * pen,
            first.y - 4.0 * pen
        );
    }
    svg.push_str("</svg>");
    svg
}
