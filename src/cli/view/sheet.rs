//! Grey images side by side with what is drawn over them and words below, as PNG or as SVG.
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

use crate::cli::detect::overlay;
use crate::print::{base64, letters};
use crate::source::encode_png;
use image::{ExtendedColorType, GrayImage, Rgb, RgbImage};
use nalgebra::Vector2;
use std::fmt::Write;

/// About the images, px.
const EDGE: u32 = 12;
/// Of a line of words, px, and the size of a cell of its letters.
const LINE: u32 = 18;
const CELL: u32 = 2;
/// Columns from letter to letter.
const ADVANCE: u32 = 6 * CELL;
/// Rows in which words look for a free place.
const NEIGHBOURS: u32 = 24;
/// Corners of a ring.
const CORNERS: u32 = 20;
/// Fewest letters of a line.
const MIN_LETTERS: u32 = 60;

/// What a line or word is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Colour {
    /// A point of the target.
    Point,
    /// What is outside.
    Outside,
    /// The way to the goal.
    Way,
    /// The middle of the image.
    Middle,
    /// The optical axis.
    Axis,
    /// x of the object.
    X,
    /// y of the object.
    Y,
    /// z of the object.
    Z,
    /// Words beside the images.
    Words,
}

impl Colour {
    fn rgb(self) -> Rgb<u8> {
        Rgb(match self {
            Self::Point => [0, 255, 64],
            Self::Outside => [255, 64, 64],
            Self::Way => [255, 176, 0],
            Self::Middle => [128, 128, 255],
            Self::Axis => [255, 64, 255],
            Self::X => [255, 48, 48],
            Self::Y => [48, 200, 48],
            Self::Z => [80, 120, 255],
            Self::Words => [24, 24, 24],
        })
    }

    fn hex(self) -> String {
        let Rgb([r, g, b]) = self.rgb();
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// An image, and what is drawn over it in its pixels.
#[derive(Debug, Clone)]
pub(super) struct ImagePanel {
    title: String,
    image: GrayImage,
    lines: Vec<(Vector2<f64>, Vector2<f64>, Colour)>,
    labels: Vec<(Vector2<f64>, String, Colour)>,
}

impl ImagePanel {
    pub(super) fn new(title: impl Into<String>, image: GrayImage) -> Self {
        Self { title: title.into(), image, lines: Vec::new(), labels: Vec::new() }
    }

    /// A straight line.
    pub(super) fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, colour: Colour) {
        self.lines.push((from, to, colour));
    }

    /// A cross with arms of `arm` px.
    pub(super) fn cross(&mut self, at: Vector2<f64>, arm: f64, colour: Colour) {
        self.line(at - Vector2::x() * arm, at + Vector2::x() * arm, colour);
        self.line(at - Vector2::y() * arm, at + Vector2::y() * arm, colour);
    }

    /// A circle.
    pub(super) fn ring(&mut self, at: Vector2<f64>, radius: f64, colour: Colour) {
        let corner = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS)).sin_cos();
            at + Vector2::new(cos, sin) * radius
        };
        (0..CORNERS).for_each(|i| self.line(corner(i), corner(i + 1), colour));
    }

    /// Words near `at`, beside those that are there.
    pub(super) fn free_label(&mut self, at: Vector2<f64>, text: &str, colour: Colour) {
        let step =
            if at.y > 0.5 * f64::from(self.image.height()) { -f64::from(LINE) } else { f64::from(LINE) };
        let length = |words: &str| f64::from(ADVANCE) * words.chars().count() as f64;
        let covers = |place: &Vector2<f64>| {
            self.labels.iter().any(|(other, words, _)| {
                (other.y - place.y).abs() < f64::from(LINE)
                    && other.x < place.x + length(text)
                    && place.x < other.x + length(words)
            })
        };
        let rows = (0..NEIGHBOURS).map(|row| at + Vector2::y() * (step * f64::from(row)));
        let free = rows.into_iter().find(|place| !covers(place)).unwrap_or(at);
        self.label(free, text, colour);
    }

    /// Words, from their upper left end.
    pub(super) fn label(&mut self, at: Vector2<f64>, text: &str, colour: Colour) {
        self.labels.push((at, text.into(), colour));
    }
}

/// Images side by side, and lines of words below them.
#[derive(Debug, Clone)]
pub(super) struct ImageSheet {
    pub(super) panels: Vec<ImagePanel>,
    pub(super) lines: Vec<String>,
}

impl ImageSheet {
    fn letters_a_line(&self) -> u32 {
        let images: u32 = self.panels.iter().map(|panel| panel.image.width() + EDGE).sum();
        (images.saturating_sub(EDGE) / ADVANCE).max(MIN_LETTERS)
    }

    /// The words, broken where a line is full; what follows is set in.
    fn broken(&self) -> Vec<String> {
        let most = self.letters_a_line() as usize;
        let mut all = Vec::new();
        for line in &self.lines {
            let indent = line.len() - line.trim_start().len();
            let mut now = " ".repeat(indent.saturating_sub(2));
            for word in line.split_whitespace() {
                if now.trim().is_empty() {
                    now += word;
                } else if now.chars().count() + 1 + word.chars().count() <= most {
                    now = now + " " + word;
                } else {
                    all.push(std::mem::replace(&mut now, " ".repeat(7) + word));
                }
            }
            all.push(now);
        }
        all
    }

    fn size(&self, lines: usize) -> (u32, u32) {
        let height = self.panels.iter().map(|panel| panel.image.height()).max().unwrap_or(0);
        let width = self.letters_a_line() * ADVANCE + 2 * EDGE;
        (width, EDGE + LINE + height + EDGE + LINE * lines as u32 + EDGE)
    }

    /// Left column and upper row of each image.
    fn places(&self) -> impl Iterator<Item = (&ImagePanel, u32, u32)> {
        let mut x = EDGE;
        self.panels.iter().map(move |panel| {
            let at = x;
            x += panel.image.width() + EDGE;
            (panel, at, EDGE + LINE)
        })
    }

    fn foot(&self) -> u32 {
        EDGE + LINE + self.panels.iter().map(|panel| panel.image.height()).max().unwrap_or(0) + EDGE
    }

    /// The file's bytes; `None` where they cannot be made.
    pub(super) fn png(&self) -> Option<Vec<u8>> {
        let words = self.broken();
        let (width, height) = self.size(words.len());
        let mut out = RgbImage::from_pixel(width, height, Rgb([244; 3]));
        for (panel, x, y) in self.places() {
            let mut drawn = RgbImage::from_fn(panel.image.width(), panel.image.height(), |x, y| {
                let [level] = panel.image.get_pixel(x, y).0;
                Rgb([level; 3])
            });
            for (from, to, colour) in &panel.lines {
                overlay::line(&mut drawn, *from, *to, colour.rgb());
            }
            for (at, text, colour) in &panel.labels {
                write(&mut drawn, at + Vector2::repeat(1.0), text, Rgb([0; 3]));
                write(&mut drawn, *at, text, colour.rgb());
            }
            image::imageops::replace(&mut out, &drawn, i64::from(x), i64::from(y));
            let title = Vector2::new(f64::from(x), f64::from(EDGE - 4));
            write(&mut out, title, &panel.title, Colour::Words.rgb());
        }
        let rows = (self.foot()..).step_by(LINE as usize);
        for (line, y) in words.iter().zip(rows) {
            write(&mut out, Vector2::new(f64::from(EDGE), f64::from(y)), line, Colour::Words.rgb());
        }
        encode_png(out.as_raw(), width, height, ExtendedColorType::Rgb8).ok()
    }

    /// The same with the images as they are and everything else as lines and letters.
    pub(super) fn svg(&self) -> Option<Vec<u8>> {
        let words = self.broken();
        let (width, height) = self.size(words.len());
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"monospace\" font-size=\"15\">\n<title>vservo view</title>\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#f4f4f4\"/>\n"
        );
        for (panel, x, y) in self.places() {
            let (w, h) = panel.image.dimensions();
            let image = base64(&encode_png(panel.image.as_raw(), w, h, ExtendedColorType::L8).ok()?);
            // a String takes everything
            let _ = writeln!(out, "<text x=\"{x}\" y=\"{}\">{}</text>", y - 5, escaped(&panel.title));
            // pixels' centres are whole numbers
            let _ = writeln!(
                out,
                "<svg x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" viewBox=\"-0.5 -0.5 {w} {h}\">\n<image x=\"-0.5\" y=\"-0.5\" \
                 width=\"{w}\" height=\"{h}\" href=\"data:image/png;base64,{image}\"/>"
            );
            for (from, to, colour) in &panel.lines {
                let _ = writeln!(
                    out,
                    "<path d=\"M{:.2} {:.2}L{:.2} {:.2}\" stroke=\"{}\"/>",
                    from.x,
                    from.y,
                    to.x,
                    to.y,
                    colour.hex()
                );
            }
            for (at, text, colour) in &panel.labels {
                let _ = writeln!(
                    out,
                    "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"{}\" stroke=\"#000\" stroke-width=\"3\" paint-order=\"stroke\">{}</text>",
                    at.x,
                    at.y + 14.0,
                    colour.hex(),
                    escaped(text)
                );
            }
            out += "</svg>\n";
        }
        for (line, y) in words.iter().zip((self.foot() + 14..).step_by(LINE as usize)) {
            let _ =
                writeln!(out, "<text x=\"{EDGE}\" y=\"{y}\" xml:space=\"preserve\">{}</text>", escaped(line));
        }
        out += "</svg>\n";
        Some(out.into_bytes())
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Writes `text` from its upper left end, in letters of [`CELL`] px a cell.
fn write(out: &mut RgbImage, at: Vector2<f64>, text: &str, colour: Rgb<u8>) {
    for (x, y) in letters(text) {
        for row in 0..CELL {
            let from = at + Vector2::new(f64::from(x * CELL), f64::from(y * CELL + row));
            overlay::line(out, from, from + Vector2::new(f64::from(CELL - 1), 0.0), colour);
        }
    }
}
