//! A sheet as SVG: lengths in mm.

use super::{PrintShape, PrintSheet};
use nalgebra::Vector2;
use std::fmt::Write;

pub(super) fn write(sheet: &PrintSheet) -> String {
    let mut out = String::new();
    let (w, h) = (number(sheet.size_mm.x), number(sheet.size_mm.y));
    // a String takes everything
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\">\n\
         <title>{}</title>\n<rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>",
        sheet.text
    );
    let rectangle = |[low, high]: &[Vector2<f64>; 2]| {
        let size = high - low;
        format!(
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
            number(low.x),
            number(low.y),
            number(size.x),
            number(size.y)
        )
    };
    if let Some(plate) = &sheet.dark_plate {
        let _ = writeln!(out, "{}", rectangle(plate));
    }
    let ink = if sheet.dark_plate.is_some() { "#fff" } else { "#000" };
    let _ = writeln!(out, "<g fill=\"{ink}\" fill-rule=\"evenodd\">");
    for shape in &sheet.shapes {
        let _ = match shape {
            PrintShape::Circle { centre_mm, radius_mm } => writeln!(
                out,
                "<circle cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
                number(centre_mm.x),
                number(centre_mm.y),
                number(*radius_mm)
            ),
            PrintShape::Outlines(loops) => {
                let mut path = String::new();
                for outline in loops {
                    for (i, corner) in outline.iter().enumerate() {
                        let word = if i == 0 { 'M' } else { 'L' };
                        let _ = write!(path, "{word}{} {}", number(corner.x), number(corner.y));
                    }
                    path.push('Z');
                }
                writeln!(out, "<path d=\"{path}\"/>")
            }
        };
    }
    out.push_str("</g>\n");
    for part in sheet.bar() {
        let _ = writeln!(out, "{}", rectangle(&part));
    }
    let _ = writeln!(
        out,
        "<text x=\"{}\" y=\"{}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"{}\">{}</text>\n</svg>",
        number(sheet.text_mm.x),
        number(sheet.text_mm.y),
        number(sheet.text_height_mm / 0.72),
        sheet.text
    );
    out
}

/// To a ten-thousandth of a mm, without trailing zeros.
fn number(mm: f64) -> String {
    let text = format!("{mm:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}
