//! A calibration as a page: one HTML file with its figures in it, which needs nothing else.
//!
//! verdict · parameters · errors of corners · uncertainty over the image · coverage · the next view · images
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

mod figures;

use crate::calibration::camera::{
    CalibrationVerdict, CameraCalibration, CrossValidation, ImageCoverage, NextView, ProjectionUncertainty,
};
use crate::report::numbers::significant;
use crate::report::page::{self, escaped};
use nalgebra::Vector2;
use std::fmt::Write;

/// What the page shows of one camera.
#[derive(Debug, Clone)]
pub struct CalibrationPage<'a> {
    /// What the camera is called.
    pub name: &'a str,
    /// Names of the images, in the order of the calibration's views.
    pub images: &'a [String],
    /// Why an image took no part, where it did not.
    pub reasons: Vec<Option<String>>,
    /// The calibration.
    pub calibration: &'a CameraCalibration,
    /// Its uncertainty.
    pub uncertainty: &'a ProjectionUncertainty,
    /// Halves against each other.
    pub halves: Option<&'a CrossValidation>,
    /// Where corners were seen.
    pub coverage: &'a ImageCoverage,
    /// The image that is missing.
    pub next: Option<&'a NextView>,
    /// All of it in words.
    pub verdict: &'a CalibrationVerdict,
}

/// Figures over the image have the image's own ground, which is white whatever the page is.
const STYLE: &str = ".figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,30rem),1fr));gap:1.5rem}\
h3{font-size:1rem;margin:.6rem 0 .1rem}svg.over{width:100%;height:auto;border:1px solid var(--frame);background:#fff}\
.over text{font-family:system-ui,-apple-system,'Segoe UI',sans-serif}\
.bar{display:inline-block;height:.7em;background:var(--c0)}.out{color:var(--c1)}";

/// A whole page of sections.
#[must_use]
pub fn document(title: &str, sections: &[String]) -> String {
    page::document(title, STYLE, sections)
}

impl CalibrationPage<'_> {
    /// The section of this camera.
    #[must_use]
    pub fn section(&self) -> String {
        let class = if self.verdict.is_usable() { "verdict" } else { "verdict bad" };
        let mut out = format!(
            "<section><h2>{}</h2><p class=\"{class}\">{}</p>\n",
            escaped(self.name),
            escaped(&self.verdict.to_string())
        );
        self.parameters(&mut out);
        let i = self.calibration.camera.intrinsics();
        out += "<div class=\"figures\">\n";
        let errors = figures::errors(self.calibration);
        let says = format!(
            "The corners lie {:.3} px (root mean square) from where they are predicted; left out: {}.",
            self.calibration.rms_px,
            self.left_out()
        );
        let note = format!("Errors are drawn {:.0} times as long; red: left out.", errors.scale);
        figure(&mut out, "Errors of the corners", &says, &errors.svg, &note);
        let at = |share: f64| {
            let px = Vector2::new(share * f64::from(i.width_px), share * f64::from(i.height_px));
            significant(self.uncertainty.sd_px(&px), 2)
        };
        let says = format!(
            "At {:.3} m the fit by itself is good to {} px in the middle of the image, and to {} px in its first corner.",
            self.uncertainty.distance_m(),
            at(0.5),
            at(0.0)
        );
        let map = figures::uncertainty(self.uncertainty, (i.width_px, i.height_px));
        let note = "One standard deviation in the worst direction, px; lighter is worse.";
        figure(&mut out, "Uncertainty of a pixel", &says, &map, note);
        let says =
            format!("Corners were seen in {:.0} % of the cells of the image.", 100.0 * self.coverage.share());
        figure(&mut out, "Coverage", &says, &figures::coverage(self.coverage, self.calibration), "");
        if let Some(next) = self.next {
            let says = format!("What would help most: {}.", next.describe((i.width_px, i.height_px)));
            let drawn = figures::next(next, self.calibration);
            figure(
                &mut out,
                "The next view",
                &says,
                &drawn,
                "Blue: the next view; grey: the corners there are.",
            );
        }
        out += "</div>\n";
        self.images(&mut out);
        out += "</section>\n";
        out
    }

    /// Corners of the used images that were left out.
    fn left_out(&self) -> u64 {
        let used = self.calibration.views.iter().filter(|view| view.unused.is_none());
        used.flat_map(|view| &view.points).filter(|point| !point.used).count() as u64
    }

    fn parameters(&self, out: &mut String) {
        let i = self.calibration.camera.intrinsics();
        let own = [("fx_px", i.fx_px), ("fy_px", i.fy_px), ("cx_px", i.cx_px), ("cy_px", i.cy_px)];
        let lens = self.calibration.camera.lens();
        out.push_str("<table><tr><th>parameter</th><th>value</th><th>standard deviation</th></tr>\n");
        for (name, value) in own.into_iter().chain(lens.coefficients()) {
            let sd = self.calibration.deviations().find(|(own, _)| *own == name);
            let sd = sd.map_or_else(|| "fixed".into(), |(_, sd)| format!("{sd:.6}"));
            // a String takes everything
            let _ = writeln!(
                out,
                "<tr><td>{name}</td><td class=\"n\">{value:.6}</td><td class=\"n\">{sd}</td></tr>"
            );
        }
        let _ = writeln!(
            out,
            "</table><p>{}x{} px, {}; rms {:.4} px, noise of a coordinate {:.4} px.",
            i.width_px,
            i.height_px,
            lens.model().name(),
            self.calibration.rms_px,
            self.calibration.noise_px
        );
        if let Some(halves) = self.halves {
            let _ = writeln!(
                out,
                " Halves of the images differ by {:.3} px over the image, {:.2} times what the noise explains.",
                halves.difference_px, halves.ratio
            );
        }
        if let Some((warp, sd)) = self.calibration.warp_m {
            let [x, y, sx, sy] = [warp.x, warp.y, sd.x, sd.y].map(|m| m * 1e3);
            let _ = writeln!(
                out,
                " The board is bent by {x:.3} ± {sx:.3} mm along x, {y:.3} ± {sy:.3} mm along y."
            );
        }
        for d in &self.calibration.dropped {
            let why = if d.sd.is_some() {
                "is not told from zero"
            } else {
                "would fold the lens inside the image, or is not told at all,"
            };
            let _ = writeln!(out, " {} ({:.4}) {why} and is left out.", d.name, d.value);
        }
        out.push_str("</p>\n");
    }

    fn images(&self, out: &mut String) {
        out.push_str("<h2>Images</h2><table><tr><th>image</th><th>rms, px</th><th></th><th>corners</th><th></th></tr>\n");
        let views = self.calibration.views.iter().zip(self.images).zip(&self.reasons);
        let most = self.calibration.views.iter().filter_map(|v| v.rms_px).fold(1e-9, f64::max);
        for ((fit, name), reason) in views {
            let rms = fit.rms_px.map_or_else(|| "-".into(), |rms| format!("{rms:.3}"));
            let width = 10.0 * fit.rms_px.unwrap_or(0.0) / most;
            let left_out = fit.points.iter().filter(|p| !p.used).count();
            let word = match reason {
                Some(reason) => format!("not used: {}", escaped(reason)),
                None if left_out > 0 => format!("{left_out} left out"),
                None => String::new(),
            };
            let _ = writeln!(
                out,
                "<tr><td>{}</td><td class=\"n\">{rms}</td><td><span class=\"bar\" style=\"width:{width:.2}em\"></span></td>\
                 <td class=\"n\">{}</td><td class=\"out\">{word}</td></tr>",
                escaped(name),
                fit.points.len()
            );
        }
        out.push_str("</table>\n");
    }
}

fn figure(out: &mut String, title: &str, says: &str, svg: &str, note: &str) {
    let (title, says, note) = (escaped(title), escaped(says), escaped(note));
    // a String takes everything
    let _ = writeln!(
        out,
        "<figure><h3>{title}</h3><p class=\"says\">{says}</p>{svg}<figcaption>{note}</figcaption></figure>"
    );
}
