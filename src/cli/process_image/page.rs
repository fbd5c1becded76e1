//! The page of a pipeline: each step with its image, its numbers and the first rows of its table; one file that needs nothing else.

use super::{short, stem};
use crate::experiment::embedded_image;
use crate::pipeline::{ColourImage, StepOutcome, StepTable};
use crate::report::chart::{Panel, Series, Symbol, figure_svg};
use crate::report::page::{document, escaped, figure};
use image::GrayImage;

/// Rows of a table in the page, chosen by hand for readers; the file beside it has all.
const ROWS: usize = 40;

/// Layout, chosen by eye.
const STYLE: &str = ".step img{max-width:100%;height:auto;image-rendering:pixelated;border:1px solid var(--frame)}\
.rows{overflow-x:auto}";

/// The whole page.
pub(super) fn page(name: &str, steps: &str, image: &GrayImage, outcomes: &[StepOutcome]) -> String {
    let (width, height) = image.dimensions();
    let mut sections = vec![format!(
        "<pre>vservo process {} --steps &quot;{}&quot;</pre>\n<figure class=\"step\">{}<figcaption>{width} x {height} px</figcaption></figure>\n",
        escaped(name),
        escaped(steps),
        embedded_image(&grey(image), "the image")
    )];
    sections.extend((1..).zip(outcomes).map(|(number, outcome)| section(number, outcome)));
    document(&format!("Image processing of {name}"), STYLE, &sections)
}

fn section(number: usize, outcome: &StepOutcome) -> String {
    let title = format!("{number}. {}", outcome.step);
    let facts: Vec<_> = outcome.facts.iter().map(|(name, v)| format!("{name} {}", short(*v))).collect();
    let says = format!("Gives {}: {}.", outcome.kind, facts.join(", "));
    let stem = stem(number, outcome);
    let levels = outcome.table.as_ref().filter(|table| table.of == "level");
    let mut html = match levels {
        Some(levels) => {
            let panels = [histogram_panel(levels, &outcome.facts)];
            let note = "Share of the pixels at each grey level.";
            figure(&title, &says, note, |width| figure_svg(&panels, 1, width, &title))
        }
        None => format!(
            "<figure class=\"step\"><h2>{}</h2><p class=\"says\">{}</p>{}<figcaption><a href=\"{stem}.png\">{stem}.png</a></figcaption></figure>\n",
            escaped(&title),
            escaped(&says),
            embedded_image(&outcome.drawn, &title)
        ),
    };
    if let Some(table) = outcome.table.as_ref().filter(|table| !table.rows.is_empty()) {
        html += &rows(table, &stem);
    }
    html
}

/// The histogram with its thresholds.
fn histogram_panel(levels: &StepTable, facts: &[(&'static str, f64)]) -> Panel {
    let shares: Vec<_> = levels.column("level").into_iter().zip(levels.column("share")).collect();
    let most = shares.iter().fold(0.0f64, |m, s| m.max(s.1));
    let end = shares.last().map(|_| (256.0, 0.0));
    let mut panel = Panel::new("", "grey level", "share of the pixels").with(Series::new(
        Symbol::Bars,
        0,
        shares.iter().copied().chain(end),
    ));
    for (fact, colour, label) in [("otsu_threshold", 1, "Otsu"), ("valley_threshold", 2, "valley")] {
        if let Some((_, level)) = facts.iter().find(|(name, _)| *name == fact) {
            let at = level + 0.5; // the level itself still belongs to the dark side
            panel.push(Series::new(Symbol::Dashed, colour, [(at, 0.0), (at, most)]).label(label));
        }
    }
    panel
}

fn rows(table: &StepTable, stem: &str) -> String {
    let heads = table.columns.iter().map(|name| format!("<th>{}</th>", escaped(name)));
    let mut html = format!("<div class=\"rows\"><table><tr>{}</tr>\n", heads.collect::<String>());
    for row in table.rows.iter().take(ROWS) {
        let cells = row.iter().map(|v| format!("<td class=\"n\">{}</td>", short(*v)));
        html += &format!("<tr>{}</tr>\n", cells.collect::<String>());
    }
    let count = table.rows.len();
    let more =
        if count > ROWS { format!("The first {ROWS} of {count} rows; all in ") } else { String::new() };
    html + &format!("</table></div><p class=\"note\">{more}<a href=\"{stem}.csv\">{stem}.csv</a></p>\n")
}

fn grey(image: &GrayImage) -> ColourImage {
    let rgb = image.as_raw().iter().flat_map(|level| [*level; 3]).collect();
    ColourImage { width: image.width(), height: image.height(), rgb }
}
