//! Pages: one HTML file with its figures in it, which needs nothing else. One style for all of them, light, dark and on paper.
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

mod base64;

pub use crate::report::chart::escaped;
pub use base64::base64;

use crate::report::chart::{CHART_STYLE, Width};

const PAGE_STYLE: &str = "\
*{box-sizing:border-box}html{-webkit-text-size-adjust:100%}\
body{margin:0 auto;max-width:1500px;padding:1rem 1.5rem 3rem;font:16px/1.5 system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif;\
background:var(--paper);color:var(--ink)}\
h1{font-size:1.5rem;line-height:1.25;margin:.6rem 0;overflow-wrap:anywhere}h2{font-size:1.15rem;line-height:1.3;margin:2.4rem 0 .2rem;overflow-wrap:anywhere}\
p{margin:.3rem 0 .8rem;max-width:72rem;overflow-wrap:anywhere}a{color:var(--c0)}figure{margin:0 0 1.5rem}\
figcaption,.note{font-size:.9rem;color:var(--soft);max-width:72rem}.says{font-size:1.02rem}\
.verdict{max-width:none;font-size:1.15rem;padding:.6rem 1rem;border-left:.4rem solid var(--c0);background:var(--busy)}.bad{border-color:var(--c1);background:var(--blind)}\
pre{white-space:pre-wrap;overflow-wrap:anywhere;background:var(--busy);padding:.6rem .8rem;margin:.4rem 0 .8rem;font:.92rem/1.45 ui-monospace,'DejaVu Sans Mono',monospace}\
dl{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,24rem),1fr));gap:.1rem 2rem;margin:.8rem 0}\
dl div{display:grid;grid-template-columns:9.5rem 1fr;gap:.6rem;border-bottom:1px solid var(--faint);padding:.2rem 0}\
dt{color:var(--soft);overflow-wrap:anywhere}dd{margin:0;overflow-wrap:anywhere;font-variant-numeric:tabular-nums}\
ol{padding-left:1.6rem;max-width:72rem}li{overflow-wrap:anywhere}\
svg.chart{width:100%;height:auto;display:none}svg.narrow{display:block}\
@media (min-width:601px){svg.narrow{display:none}svg.medium{display:block}}\
@media (min-width:1051px){svg.medium{display:none}svg.wide{display:block}}\
@media (max-width:600px){body{padding:.6rem 1rem 2rem}dl div{grid-template-columns:9rem 1fr}}\
.images{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,30rem),1fr));gap:1.2rem}.images figure{margin:0}\
.strip{grid-template-columns:repeat(auto-fill,minmax(min(100%,11rem),1fr));gap:.6rem}\
.image{position:relative;line-height:0}.image img{width:100%;height:auto;display:block}.image svg{position:absolute;inset:0;width:100%;height:100%}\
.image path,.image circle{fill:none;stroke:#00e04a;stroke-width:2;vector-effect:non-scaling-stroke}.image .goal{stroke:#ff5ad0;stroke-dasharray:4 3}\
table{border-collapse:collapse;font-size:.93rem;max-width:100%}td,th{padding:.15rem .7rem;text-align:left;border-bottom:1px solid var(--faint);overflow-wrap:anywhere}\
td.n{text-align:right;font-variant-numeric:tabular-nums}details{margin:.6rem 0}summary{cursor:pointer;color:var(--soft)}details:not([open])>pre{display:none}\
.cursor{position:fixed;right:1rem;bottom:1rem;padding:.3rem .7rem;background:var(--paper);border:1px solid var(--frame);font-variant-numeric:tabular-nums}\
.cursor[hidden]{display:none}.chart .cursor-line{stroke:var(--ink);stroke-width:1;pointer-events:none}.chart .cursor-part{fill:var(--busy)}\
.zoomed .tick{display:none}.chart .zoomed .data path{vector-effect:non-scaling-stroke}@media print{.cursor{display:none}}\
@media print{body{max-width:none;padding:0;font-size:11pt}figure,.verdict,dl div{break-inside:avoid}h2{break-after:avoid}\
svg.narrow,svg.wide{display:none!important}svg.medium{display:block!important}}";

/// One cursor and one zoom for all figures over time of a page; it looks nothing up elsewhere.
pub const TIME_CURSOR: &str = concat!("<script>", include_str!("time_cursor.js"), "</script>\n");

/// By which a page of this program is known; near its beginning.
pub const GENERATOR: &str = "<meta name=\"generator\" content=\"vservo\">";

/// A whole page of sections; `style` is what this kind of page has beside the common one.
#[must_use]
pub fn document(title: &str, style: &str, sections: &[String]) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">{GENERATOR}<meta name=\"viewport\" \
         content=\"width=device-width,initial-scale=1\"><link rel=\"icon\" href=\"data:,\"><title>{0}</title>\
         <style>{CHART_STYLE}{PAGE_STYLE}{style}</style></head>\n<body><h1>{0}</h1>\n{1}</body></html>\n",
        escaped(title),
        sections.concat()
    )
}

/// A figure: its title, what it shows in a sentence, and the drawing for each width. `note`: how it is to be read.
#[must_use]
pub fn figure(title: &str, says: &str, note: &str, draw: impl Fn(Width) -> String) -> String {
    let drawings: Vec<String> = Width::ALL.into_iter().map(draw).collect();
    let note =
        if note.is_empty() { String::new() } else { format!("<figcaption>{}</figcaption>", escaped(note)) };
    format!("<figure>{}{}{note}</figure>\n", heading(title, says), drawings.concat())
}

/// The title of a figure, and its sentence.
#[must_use]
pub fn heading(title: &str, says: &str) -> String {
    format!("<h2>{}</h2><p class=\"says\">{}</p>\n", escaped(title), escaped(says))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_no_markup() {
        let page = document("<script>&\"\u{7}", "", &["<p>kept</p>".into()]);
        assert!(page.contains("&lt;script&gt;&amp;&quot;\u{fffd}") && page.contains("<p>kept</p>"));
        assert!(
            !page.contains("<script>") && page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n")
        );
    }

    #[test]
    fn a_figure_is_drawn_for_every_width() {
        let html = figure("T", "a < b", "", |width| format!("[{}]", width.class()));
        assert!(html.contains("[narrow][medium][wide]") && html.contains("a &lt; b"), "{html}");
        assert!(!html.contains("figcaption"));
    }
}
