//! A sheet as PDF.

use super::{PrintShape, PrintSheet};
use nalgebra::Vector2;
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str};

/// The unit of the PDF specification is 1/72 inch.
const POINTS_PER_MM: f32 = 72.0 / 25.4;
/// Handles of a quarter of a circle, in radii. Derived: `4/3 (sqrt 2 - 1)`, with which the middle of the curve lies on the circle.
const HANDLE: f64 = 0.552_284_75;

pub(super) fn write(sheet: &PrintSheet) -> Vec<u8> {
    let [catalog, pages, page, font, content] = [1, 2, 3, 4, 5].map(Ref::new);
    let (w, h) = (sheet.size_mm.x as f32 * POINTS_PER_MM, sheet.size_mm.y as f32 * POINTS_PER_MM);
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(pages);
    pdf.pages(pages).kids([page]).count(1);
    let mut sheet_page = pdf.page(page);
    sheet_page.parent(pages).media_box(Rect::new(0.0, 0.0, w, h)).contents(content);
    sheet_page.resources().fonts().pair(Name(b"F"), font);
    sheet_page.finish();
    pdf.type1_font(font).base_font(Name(b"Helvetica"));

    let mut draw = Content::new();
    draw.save_state();
    // mm from the upper left corner, y down
    draw.transform([POINTS_PER_MM, 0.0, 0.0, -POINTS_PER_MM, 0.0, h]);
    let rectangle = |draw: &mut Content, [low, high]: &[Vector2<f64>; 2]| {
        let size = high - low;
        draw.rect(low.x as f32, low.y as f32, size.x as f32, size.y as f32);
    };
    draw.set_fill_gray(0.0);
    if let Some(plate) = &sheet.dark_plate {
        rectangle(&mut draw, plate);
        draw.fill_nonzero();
        draw.set_fill_gray(1.0);
    }
    for shape in &sheet.shapes {
        match shape {
            PrintShape::Circle { centre_mm, radius_mm } => circle(&mut draw, centre_mm, *radius_mm),
            PrintShape::Outlines(loops) => {
                for outline in loops {
                    for (i, corner) in outline.iter().enumerate() {
                        let (x, y) = (corner.x as f32, corner.y as f32);
                        if i == 0 {
                            draw.move_to(x, y);
                        } else {
                            draw.line_to(x, y);
                        }
                    }
                    draw.close_path();
                }
            }
        }
        draw.fill_even_odd();
    }
    draw.set_fill_gray(0.0);
    for part in sheet.bar() {
        rectangle(&mut draw, &part);
    }
    draw.fill_nonzero();
    draw.restore_state();
    let text = sheet.text_mm.map(|mm| mm as f32 * POINTS_PER_MM);
    draw.begin_text();
    draw.set_font(Name(b"F"), sheet.text_height_mm as f32 / 0.72 * POINTS_PER_MM);
    draw.next_line(text.x, h - text.y);
    draw.show(Str(sheet.text.as_bytes()));
    draw.end_text();
    pdf.stream(content, &draw.finish());
    pdf.finish()
}

/// Four cubic curves: a circle within 0.03 % of its radius.
fn circle(draw: &mut Content, centre: &Vector2<f64>, radius: f64) {
    let at = |x: f64, y: f64| ((centre.x + x * radius) as f32, (centre.y + y * radius) as f32);
    let (x, y) = at(1.0, 0.0);
    draw.move_to(x, y);
    for [c, s] in [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] {
        // from the direction (c, s) to the one a quarter further, (-s, c)
        let (x1, y1) = at(c - HANDLE * s, s + HANDLE * c);
        let (x2, y2) = at(HANDLE * c - s, HANDLE * s + c);
        let (x3, y3) = at(-s, c);
        draw.cubic_to(x1, y1, x2, y2, x3, y3);
    }
    draw.close_path();
}
