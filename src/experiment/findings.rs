//! What an experiment gives: files, figures with their captions, and figures of merit. Written in one place.

use super::ExperimentError;
use super::plot::Drawing;
use crate::pipeline::ColourImage;
use crate::report::page::{base64, document, escaped, heading};
use crate::source::encode_png;
use image::ExtendedColorType;
use serde_json::{Map, Value};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The page of an experiment, or of all of them.
pub(super) const PAGE: &str = "index.html";

/// A figure of an experiment.
#[derive(Debug, Clone)]
pub struct Figure {
    /// File name, `*.svg`.
    pub file: String,
    /// What it is, and how it is read.
    pub caption: String,
    /// What it shows, in a sentence.
    pub says: String,
    /// The figure itself.
    pub drawing: Drawing,
}

impl Figure {
    /// The first words of the caption: to its first colon, semicolon or end of a sentence.
    fn title(&self) -> &str {
        let caption = self.caption.as_str();
        // An abbreviation goes on with a number, a sentence with a word.
        let is_end = |(at, _): &(usize, &str)| {
            caption.get(at + 2..).is_some_and(|rest| rest.starts_with(char::is_uppercase))
        };
        let sentence = caption.match_indices(". ").find(is_end).map(|(at, _)| at);
        let end = caption.find([';', ':']).into_iter().chain(sentence).min().unwrap_or(caption.len());
        caption.get(..end).unwrap_or_default().trim_end_matches('.')
    }
}

/// An image of an experiment.
#[derive(Debug, Clone)]
pub struct StepFigure {
    /// File name, `*.png`.
    pub file: String,
    /// What it is.
    pub title: String,
    /// What it shows, in a sentence.
    pub says: String,
    /// Its pixels.
    pub drawn: ColourImage,
}

/// Images in a page are no wider, so that it can be opened; files beside it are whole.
const WIDEST_PX: u32 = 1280;

/// An image as an element of a page, in the page itself.
#[must_use]
pub fn embedded_image(image: &ColourImage, alt: &str) -> String {
    let small = image.thinned(WIDEST_PX);
    match encode_png(&small.rgb, small.width, small.height, ExtendedColorType::Rgb8) {
        Ok(bytes) => {
            format!(
                "<img style=\"max-width:100%;height:auto\" alt=\"{}\" src=\"data:image/png;base64,{}\">",
                escaped(alt),
                base64(&bytes)
            )
        }
        Err(e) => format!("<p class=\"note\">The image cannot be shown: {}</p>", escaped(&e.to_string())),
    }
}

/// All that one experiment gives.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// CSV files: name and text.
    pub tables: Vec<(String, String)>,
    /// Figures in reading order.
    pub figures: Vec<Figure>,
    /// Images in reading order, after the figures.
    pub images: Vec<StepFigure>,
    /// `metrics.json`.
    pub metrics: Map<String, Value>,
    /// A few lines for people.
    pub lines: Vec<String>,
}

impl Findings {
    /// Adds a table.
    pub fn table(&mut self, name: &str, text: String) {
        self.tables.push((format!("{name}.csv"), text));
    }

    /// Adds a figure that says what its curves say.
    pub fn figure(&mut self, name: &str, caption: impl Into<String>, drawing: Drawing) {
        let says = drawing.says();
        self.telling_figure(name, caption, says, drawing);
    }

    /// Adds a figure and what it shows.
    pub fn telling_figure(&mut self, name: &str, caption: impl Into<String>, says: String, drawing: Drawing) {
        self.figures.push(Figure { file: format!("{name}.svg"), caption: caption.into(), says, drawing });
    }

    /// Adds an image.
    pub fn image(&mut self, image: StepFigure) {
        self.images.push(image);
    }

    /// Adds an entry to the metrics. What is not a number becomes `null`.
    pub fn metric(&mut self, name: &str, value: impl serde::Serialize) {
        self.metrics.insert(name.into(), serde_json::to_value(value).unwrap_or(Value::Null));
    }

    /// Writes everything into `folder`, which is made when it does not exist, with a page for the experiment `name`, which is `about`
    /// something; gives the files.
    ///
    /// # Errors
    /// [`ExperimentError::Write`].
    pub fn write(&self, folder: &Path, name: &str, about: &str) -> Result<Vec<PathBuf>, ExperimentError> {
        make_folder(folder)?;
        let mut json = serde_json::to_string_pretty(&self.metrics).unwrap_or_default();
        json.push('\n');
        let tables = self.tables.iter().map(|(name, text)| (name.clone(), text.clone()));
        let figures = self.figures.iter().map(|f| (f.file.clone(), f.drawing.svg(f.title())));
        let others = [("metrics.json".to_owned(), json), (PAGE.to_owned(), self.page(name, about))];
        let mut written = Vec::new();
        for (name, text) in tables.chain(figures).chain(others) {
            let path = folder.join(name);
            write_file(&path, text)?;
            written.push(path);
        }
        for StepFigure { file, drawn, .. } in &self.images {
            let path = folder.join(file);
            let png =
                encode_png(&drawn.rgb, drawn.width, drawn.height, ExtendedColorType::Rgb8).map_err(|e| {
                    ExperimentError::Write { path: path.clone(), cause: std::io::Error::other(e) }
                })?;
            write_file(&path, png)?;
            written.push(path);
        }
        Ok(written)
    }

    /// The page of an experiment.
    fn page(&self, name: &str, about: &str) -> String {
        let mut sections =
            vec![format!("<p class=\"verdict\">{}</p>\n{}", escaped(about), lines(&self.lines))];
        let figures = self
            .figures
            .iter()
            .map(|figure| figure.drawing.html(figure.title(), &figure.says, &figure.caption));
        sections.extend(figures);
        sections.extend(self.images.iter().map(|p| {
            let image = embedded_image(&p.drawn, &p.title);
            format!("<figure>{}{image}</figure>\n", heading(&p.title, &p.says))
        }));
        let mut files = heading("Data", "The figures are drawn from these files, and are files themselves.");
        files += "<p>";
        let tables = self.tables.iter().map(|(name, _)| name.as_str());
        let figures = self.figures.iter().map(|f| f.file.as_str());
        let images = self.images.iter().map(|p| p.file.as_str());
        for file in tables.chain(["metrics.json"]).chain(figures).chain(images) {
            let _ = write!(files, "<a href=\"{0}\">{0}</a> ", escaped(file)); // a String takes everything
        }
        sections.push(files + "</p>\n");
        document(&format!("vservo experiment: {name}"), "", &sections)
    }
}

fn lines(lines: &[String]) -> String {
    if lines.is_empty() { String::new() } else { format!("<pre>{}</pre>\n", escaped_lines(lines)) }
}

/// Lines stay lines.
fn escaped_lines(lines: &[String]) -> String {
    lines.iter().map(|line| escaped(line)).collect::<Vec<_>>().join("\n")
}

/// Makes `folder` and those above it.
///
/// # Errors
/// [`ExperimentError::Write`].
pub(super) fn make_folder(folder: &Path) -> Result<(), ExperimentError> {
    std::fs::create_dir_all(folder).map_err(|cause| ExperimentError::Write { path: folder.into(), cause })
}

/// Writes a file, whole or not at all.
///
/// # Errors
/// [`ExperimentError::Write`].
pub(super) fn write_file(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), ExperimentError> {
    crate::rt::write_file(path, contents).map_err(|cause| ExperimentError::Write { path: path.into(), cause })
}

/// The page that leads to those of `all`.
#[must_use]
pub(super) fn index_page(all: &[(&'static str, &'static str, Findings)]) -> String {
    let sections: Vec<String> = all
        .iter()
        .map(|(name, about, findings)| {
            let count = findings.figures.len() + findings.images.len();
            let figures = if count == 1 { "its figure".to_owned() } else { format!("its {count} figures") };
            format!(
                "<section id=\"{name}\"><h2><a href=\"{name}/{PAGE}\">{name}</a></h2><p>{}</p>{}<p><a href=\"{name}/{PAGE}\">{figures} and \
                 data</a></p></section>\n",
                escaped(about),
                lines(&findings.lines)
            )
        })
        .collect();
    document("vservo experiments", "", &sections)
}

#[cfg(test)]
mod tests {
    use super::super::plot::{Panel, Series, figure};
    use super::*;

    #[test]
    fn numbers_that_are_none_become_null() {
        let mut findings = Findings::default();
        findings.metric("x", f64::NAN);
        assert_eq!(serde_json::to_string(&findings.metrics).unwrap(), "{\"x\":null}");
    }

    #[test]
    fn titles_end_where_the_first_thought_does() {
        let title = |caption: &str| {
            let figure = Figure {
                file: String::new(),
                caption: caption.into(),
                says: String::new(),
                drawing: Drawing::default(),
            };
            figure.title().to_owned()
        };
        assert_eq!(title("Paths (Figs. 10.26). The z axis: down"), "Paths (Figs. 10.26)");
        assert_eq!(title("One; two. Three"), "One");
        assert_eq!(title("Whole."), "Whole");
    }

    #[test]
    fn a_page_shows_every_figure_and_the_index_leads_to_it() {
        let mut findings = Findings::default();
        let panel =
            Panel::new("p", "t [s]", "x [m]").with(Series::line(0, [(0.0, 1.0), (2.0, 3.0)]).label("x"));
        findings.figure("paths", "a < b; more", figure(1, [panel]));
        findings.table("A", String::new());
        findings.lines = vec!["one".into(), "two & three".into()];
        let html = findings.page("one", "about");
        for text in [
            "href=\"paths.svg\"",
            "<h2>a &lt; b</h2>",
            "P at the end: x 3.00 m.",
            "href=\"A.csv\"",
            "one\ntwo &amp; three",
        ] {
            assert!(html.contains(text), "{text} in {html}");
        }
        let index = index_page(&[("one", "about", findings)]);
        for text in ["href=\"one/index.html\"", "its figure and", "two &amp; three"] {
            assert!(index.contains(text), "{text}");
        }
    }
}
