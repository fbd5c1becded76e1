//! A calibration as a page: one HTML file with its figures in it, which needs nothing else.
//!
//! verdict · parameters · errors of corners · uncertainty over the image · coverage · the next view · pictures

mod figures;

use crate::calibration::camera::{
    CalibrationVerdict, CameraCalibration, CrossValidation, ImageCoverage, NextView, ProjectionUncertainty,
};
use std::fmt::Write;

/// What the page shows of one camera.
#[derive(Debug, Clone)]
pub struct CalibrationPage<'a> {
    /// What the camera is called.
    pub name: &'a str,
    /// Names of the pictures, in the order of the calibration's views.
    pub images: &'a [String],
    /// Why a picture took no part, where it did not.
    pub reasons: Vec<Option<String>>,
    /// The calibration.
    pub calibration: &'a CameraCalibration,
    /// Its uncertainty.
    pub uncertainty: &'a ProjectionUncertainty,
    /// Halves against each other.
    pub halves: Option<&'a CrossValidation>,
    /// Where corners were seen.
    pub coverage: &'a ImageCoverage,
    /// The picture that is missing.
    pub next: Option<&'a NextView>,
    /// All of it in words.
    pub verdict: &'a CalibrationVerdict,
}

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:70em;padding:0 1em;color:#222}\
h1{font-size:1.4em}h2{font-size:1.1em;margin:1.6em 0 .4em}.verdict{font-size:1.15em;padding:.7em 1em;border-left:.4em solid #0072b2;\
background:#eef5fa}.bad{border-color:#d55e00;background:#fdf1ea}.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(26em,1fr));\
gap:1.5em}figure{margin:0}svg{width:100%;height:auto;border:1px solid #bbb;background:#fff}figcaption{font-size:.9em;color:#444}\
table{border-collapse:collapse;font-size:.93em}td,th{padding:.15em .8em;text-align:left;border-bottom:1px solid #ddd}td.n{text-align:right;\
font-variant-numeric:tabular-nums}.bar{display:inline-block;height:.7em;background:#56b4e9}.out{color:#b34700}";

/// A whole page of sections.
#[must_use]
pub fn document(title: &str, sections: &[String]) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width\"><title>{0}</title><style>{STYLE}</style></head>\n<body><h1>{0}</h1>\n{1}</body></html>\n",
        escaped(title),
        sections.concat()
    )
}

/// Text that is no markup.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
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
        figure(
            &mut out,
            &errors.svg,
            &format!("Errors of the corners, drawn {:.0} times as long; red: left out.", errors.scale),
        );
        let caption = format!(
            "Uncertainty of a pixel at {:.3} m: one standard deviation in the worst direction, px; lighter is worse.",
            self.uncertainty.distance_m()
        );
        figure(&mut out, &figures::uncertainty(self.uncertainty, (i.width_px, i.height_px)), &caption);
        let caption =
            format!("Corners seen, in {:.0} % of the cells of the image.", 100.0 * self.coverage.share());
        figure(&mut out, &figures::coverage(self.coverage, self.calibration), &caption);
        if let Some(next) = self.next {
            let caption = format!(
                "The next view (blue) among those there are (grey): {}.",
                next.describe((i.width_px, i.height_px))
            );
            figure(&mut out, &figures::next(next, self.calibration), &caption);
        }
        out += "</div>\n";
        self.pictures(&mut out);
        out += "</section>\n";
        out
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
                " Halves of the pictures differ by {:.3} px over the image, {:.2} times what the noise explains.",
                halves.difference_px, halves.ratio
            );
        }
        if let Some((warp, sd)) = self.calibration.warp_m {
            let [x, y, sx, sy] = [warp.x, warp.y, sd.x, sd.y].map(|m| m * 1e3);
            let _ = writeln!(
                out,
                " The board is bent by {x:.3} &plusmn; {sx:.3} mm along x, {y:.3} &plusmn; {sy:.3} mm along y."
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

    fn pictures(&self, out: &mut String) {
        out.push_str("<h2>Pictures</h2><table><tr><th>picture</th><th>rms, px</th><th></th><th>corners</th><th></th></tr>\n");
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

fn figure(out: &mut String, svg: &str, caption: &str) {
    let _ = writeln!(out, "<figure>{svg}<figcaption>{}</figcaption></figure>", escaped(caption));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_no_markup() {
        let page = document("<script>&\"\u{7}", &["<p>kept</p>".into()]);
        assert!(page.contains("&lt;script&gt;&amp;&quot;\u{fffd}") && page.contains("<p>kept</p>"));
        assert!(
            !page.contains("<script>") && page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n")
        );
    }
}
