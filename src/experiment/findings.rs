//! What an experiment gives: files, figures with their captions, and figures of merit. Written in one place.

use super::ExperimentError;
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// A figure of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// File name, `*.svg`.
    pub file: String,
    /// What it shows, for the index page.
    pub caption: String,
    /// The SVG text.
    pub svg: String,
}

/// All that one experiment gives.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Findings {
    /// CSV files: name and text.
    pub tables: Vec<(String, String)>,
    /// Figures in reading order.
    pub figures: Vec<Figure>,
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

    /// Adds a figure.
    pub fn figure(&mut self, name: &str, caption: impl Into<String>, svg: String) {
        self.figures.push(Figure { file: format!("{name}.svg"), caption: caption.into(), svg });
    }

    /// Adds an entry to the metrics. What is not a number becomes `null`.
    pub fn metric(&mut self, name: &str, value: impl serde::Serialize) {
        self.metrics.insert(name.into(), serde_json::to_value(value).unwrap_or(Value::Null));
    }

    /// Writes everything into `folder`, which is made when it does not exist; gives the files.
    ///
    /// # Errors
    /// [`ExperimentError::Write`].
    pub fn write(&self, folder: &Path) -> Result<Vec<PathBuf>, ExperimentError> {
        make_folder(folder)?;
        let mut json = serde_json::to_string_pretty(&self.metrics).unwrap_or_default();
        json.push('\n');
        let tables = self.tables.iter().map(|(name, text)| (name.as_str(), text.as_str()));
        let figures = self.figures.iter().map(|f| (f.file.as_str(), f.svg.as_str()));
        let mut written = Vec::new();
        for (name, text) in tables.chain(figures).chain([("metrics.json", json.as_str())]) {
            let path = folder.join(name);
            write_file(&path, text)?;
            written.push(path);
        }
        Ok(written)
    }
}

/// Makes `folder` and those above it.
///
/// # Errors
/// [`ExperimentError::Write`].
pub(super) fn make_folder(folder: &Path) -> Result<(), ExperimentError> {
    std::fs::create_dir_all(folder).map_err(|cause| ExperimentError::Write { path: folder.into(), cause })
}

/// Writes a text file, whole or not at all.
///
/// # Errors
/// [`ExperimentError::Write`].
pub(super) fn write_file(path: &Path, text: &str) -> Result<(), ExperimentError> {
    crate::rt::write_file(path, text).map_err(|cause| ExperimentError::Write { path: path.into(), cause })
}

/// The page that shows every figure of `all`.
#[must_use]
pub(super) fn index_page(all: &[(&'static str, &'static str, Findings)]) -> String {
    let escape = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let mut html = String::from(concat!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n",
        "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>vservo experiments</title>\n",
        "<style>\nbody{font:16px/1.5 sans-serif;max-width:90rem;margin:2rem auto;padding:0 1rem;color:#222}\n",
        "figure{margin:1.5rem 0}figcaption{color:#444;max-width:60rem}img{max-width:100%}\n",
        "pre{background:#f6f6f4;padding:.8rem;overflow-x:auto}nav a{margin-right:1rem}\n</style>\n</head>\n<body>\n",
        "<h1>Experiments</h1>\n<nav>\n",
    ));
    for (name, _, _) in all {
        html += &format!("<a href=\"#{name}\">{name}</a>\n");
    }
    html += "</nav>\n";
    for (name, about, findings) in all {
        html += &format!("<section id=\"{name}\">\n<h2>{name}</h2>\n<p>{}</p>\n", escape(about));
        if !findings.lines.is_empty() {
            html += &format!("<pre>{}</pre>\n", escape(&findings.lines.join("\n")));
        }
        for figure in &findings.figures {
            let caption = escape(&figure.caption);
            html += &format!(
                "<figure><img src=\"{name}/{}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>\n",
                figure.file
            );
        }
        html += "<p>Files: ";
        for (file, _) in &findings.tables {
            html += &format!("<a href=\"{name}/{file}\">{file}</a> ");
        }
        html += &format!("<a href=\"{name}/metrics.json\">metrics.json</a></p>\n</section>\n");
    }
    html += "</body>\n</html>\n";
    html
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_none_become_null() {
        let mut findings = Findings::default();
        findings.metric("x", f64::NAN);
        assert_eq!(serde_json::to_string(&findings.metrics).unwrap(), "{\"x\":null}");
    }

    #[test]
    fn the_index_shows_every_figure() {
        let mut findings = Findings::default();
        findings.figure("paths", "a < b", "<svg/>".into());
        findings.table("A", String::new());
        let html = index_page(&[("one", "about", findings)]);
        for text in ["src=\"one/paths.svg\"", "a &lt; b", "href=\"one/A.csv\"", "href=\"#one\""] {
            assert!(html.contains(text), "{text}");
        }
    }
}
