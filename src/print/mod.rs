//! A target on paper, in true size: SVG, PDF, PNG.
//!
//! ```text
//! Target ─► Sheet: plate and marks in mm, below them a line of text and a scale bar ─► svg | pdf | png
//! ```
//! The bar tells whether a printer has kept the size.

mod base64;
mod font;
mod paper;
mod pdf;
mod png;
mod svg;

pub(crate) use base64::base64;
pub(crate) use font::letters;
pub use paper::Paper;

use crate::target::{ClosedOutline, Mark, Tags, Target};
use nalgebra::Vector2;
use thiserror::Error;

/// Free paper about the plate, and below it for text and bar, mm.
const EDGE_MM: f64 = 5.0;
const FOOT_MM: f64 = 14.0;
/// Narrowest sheet. Chosen by hand: the text needs room.
const NARROWEST_MM: f64 = 60.0;
/// Largest sheet of a PDF: 14 400 units of 1/72 inch by the PDF specification (ISO 32000-1, annex C.2), 5080 mm.
const MAX_PDF_MM: f64 = 5000.0;
/// Resolution of a PNG, px/mm. Chosen by hand: 300 px an inch, as print shops ask for; a tenth of a millimetre is then 1.2 px.
const PX_PER_MM: f64 = 300.0 / 25.4;
/// Largest side of a PNG, px. Chosen by hand: 1.4 m at this resolution, and 268 MB of grey levels while it is drawn. Larger sheets must be
/// written as SVG or PDF.
const MAX_PNG_PX: f64 = 16_384.0;
/// Largest distance of a polygon from the curve that it replaces, mm. Chosen by hand: a fortieth of a pixel at 300 px an inch.
const SAG_MM: f64 = 0.002;

/// A sheet that cannot be made.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum PrintError {
    /// The sheet is too large for the format.
    #[error(
        "a sheet of {width_mm:.0} x {height_mm:.0} mm is too large for {format}: at most {largest_mm:.0} mm a side{hint}"
    )]
    TooLarge {
        /// Format.
        format: &'static str,
        /// Width.
        width_mm: f64,
        /// Height.
        height_mm: f64,
        /// What it may be.
        largest_mm: f64,
        /// What else can be done.
        hint: &'static str,
    },
    /// The sheet is larger than the paper.
    #[error(
        "{width_mm:.0} x {height_mm:.0} mm with its margin and the bar do not fit on {}: make the target {percent} % of its size, or take a \
         larger paper",
        paper.as_str()
    )]
    NoRoom {
        /// Width.
        width_mm: f64,
        /// Height.
        height_mm: f64,
        /// The paper.
        paper: Paper,
        /// How large a target fits, rounded down.
        percent: f64,
    },
    /// The encoder failed.
    #[error("the image cannot be encoded")]
    Encoder,
}

/// How a sheet is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Vectors, for browsers and drawing programs.
    Svg,
    /// Vectors, for printers.
    Pdf,
    /// Pixels, 300 to the inch.
    Png,
}

impl Format {
    /// The format that an extension names.
    #[must_use]
    pub fn of_extension(extension: &str) -> Option<Self> {
        match extension.to_ascii_lowercase().as_str() {
            "svg" => Some(Self::Svg),
            "pdf" => Some(Self::Pdf),
            "png" => Some(Self::Png),
            _ => None,
        }
    }
}

/// What is drawn, mm from the upper left corner of the sheet, y down.
#[derive(Debug, Clone, PartialEq)]
struct PrintSheet {
    size_mm: Vector2<f64>,
    /// The plate, where it is dark.
    dark_plate: Option<[Vector2<f64>; 2]>,
    shapes: Vec<PrintShape>,
    text: String,
    /// Lower left end of the text's line, and height of its capitals.
    text_mm: Vector2<f64>,
    text_height_mm: f64,
    /// Left end of the bar, and its length.
    bar_mm: Vector2<f64>,
    bar_length_mm: f64,
}

/// A mark in mm.
#[derive(Debug, Clone, PartialEq)]
enum PrintShape {
    Circle {
        centre_mm: Vector2<f64>,
        radius_mm: f64,
    },
    /// What an odd number of outlines is about.
    Outlines(Vec<ClosedOutline>),
}

impl PrintSheet {
    fn of(target: &Target) -> Self {
        let plate = target.plate();
        let plate_mm = (plate.high_m - plate.low_m) * 1e3;
        let width = (plate_mm.x + 2.0 * EDGE_MM).max(NARROWEST_MM);
        let left = 0.5 * (width - plate_mm.x);
        let place = |m: &Vector2<f64>| (m - plate.low_m) * 1e3 + Vector2::new(left, EDGE_MM);
        let shape = |mark: Mark| match mark {
            Mark::Disc(disc) => {
                PrintShape::Circle { centre_mm: place(&disc.centre_m), radius_mm: disc.radius_m * 1e3 }
            }
            mark => {
                let loops = mark.loops(SAG_MM * 1e-3);
                PrintShape::Outlines(loops.iter().map(|l| l.iter().map(&place).collect()).collect())
            }
        };
        let bottom = EDGE_MM + plate_mm.y;
        // as long as there is room for, of lengths that a ruler shows
        let room = width - 2.0 * EDGE_MM;
        let bar_length_mm = [500.0, 200.0, 100.0].into_iter().find(|mm| *mm <= room).unwrap_or(50.0);
        let text = format!("{}; the bar is {bar_length_mm} mm: print at 100 %", describe(target));
        // The letters' advance is 6/7 = 0.86 of their height, which follows from the font. 2.5 mm are read easily.
        let text_height_mm = (room / (0.86 * text.chars().count() as f64)).min(2.5);
        Self {
            size_mm: Vector2::new(width, bottom + EDGE_MM + FOOT_MM),
            dark_plate: (!plate.light).then(|| [place(&plate.low_m), place(&plate.high_m)]),
            shapes: target.marks().into_iter().map(shape).collect(),
            text,
            text_mm: Vector2::new(EDGE_MM, bottom + EDGE_MM + 3.0),
            text_height_mm,
            bar_mm: Vector2::new(EDGE_MM, bottom + EDGE_MM + 8.0),
            bar_length_mm,
        }
    }

    /// Rectangles of the scale bar, by their corners: a line with a tick at each end and at each tenth.
    fn bar(&self) -> Vec<[Vector2<f64>; 2]> {
        let at = |x: f64, y: f64| self.bar_mm + Vector2::new(x, y);
        let line = [at(0.0, -0.1), at(self.bar_length_mm, 0.1)];
        let tick = |i: u32| {
            let (x, height) =
                (f64::from(i) * 0.1 * self.bar_length_mm, if i.is_multiple_of(5) { 2.5 } else { 1.2 });
            // outer edges of the end ticks are the length
            let (from, to) = match i {
                0 => (0.0, 0.2),
                10 => (-0.2, 0.0),
                _ => (-0.1, 0.1),
            };
            [at(x + from, -height), at(x + to, 0.1)]
        };
        std::iter::once(line).chain((0..=10).map(tick)).collect()
    }
}

/// What a target is, in one line of plain letters.
#[must_use]
pub fn describe(target: &Target) -> String {
    let mm = |m: f64| (m * 1e6).round() / 1e3;
    let plate = target.plate();
    let size = plate.high_m - plate.low_m;
    let what = match target {
        Target::FourDots(t) => format!("four dots, side {} mm", mm(t.side_m())),
        Target::DotGrid(t) => format!("dots {} x {}, pitch {} mm", t.columns(), t.rows(), mm(t.pitch_m())),
        Target::DotBody(t) => format!("body with {} dots", t.points().len()),
        Target::Chessboard(t) => {
            format!(
                "chessboard {} x {} inner corners, squares {} mm",
                t.columns(),
                t.rows(),
                mm(t.square_m())
            )
        }
        Target::Tags(t) => format!("{}, size {} mm", tags(t), mm(t.size_m())),
        Target::Shape(_) => "shape".into(),
    };
    format!("vservo {what}; plate {} x {} mm", mm(size.x), mm(size.y))
}

fn tags(target: &Tags) -> String {
    match target.tags() {
        [one] => format!("tag {} id {}", target.family(), one.id),
        [first, .., last] => format!("tags {} ids {} to {}", target.family(), first.id, last.id),
        [] => String::new(),
    }
}

/// The smallest of A4 and A3 on which a target fits, in words.
#[must_use]
pub fn paper_in_words(target: &Target) -> String {
    Paper::smallest_for(PrintSheet::of(target).size_mm)
        .map_or("is larger than A3: print it on a plotter".into(), |paper| {
            format!("fits on {}", paper.as_str())
        })
}

/// The bytes of a file with the target in true size, in the middle of a paper or on a sheet as large as it is.
///
/// # Errors
/// [`PrintError`]: the target is too large for the format, or for the paper.
pub fn print(target: &Target, format: Format, paper: Option<Paper>) -> Result<Vec<u8>, PrintError> {
    let sheet = PrintSheet::of(target);
    let sheet = match paper {
        Some(paper) => sheet.on(paper)?,
        None => sheet,
    };
    let refuse = |name: &'static str, largest_mm: f64, hint: &'static str| {
        let (width_mm, height_mm) = (sheet.size_mm.x, sheet.size_mm.y);
        if width_mm.max(height_mm) > largest_mm {
            return Err(PrintError::TooLarge { format: name, width_mm, height_mm, largest_mm, hint });
        }
        Ok(())
    };
    match format {
        Format::Svg => Ok(svg::write(&sheet).into_bytes()),
        Format::Pdf => {
            refuse("PDF", MAX_PDF_MM, "; take SVG")?;
            Ok(pdf::write(&sheet))
        }
        Format::Png => {
            refuse("PNG", MAX_PNG_PX / PX_PER_MM, "; take SVG or PDF")?;
            png::write(&sheet)
        }
    }
}

#[cfg(test)]
mod tests;
