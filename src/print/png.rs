//! A sheet as PNG, 300 pixels to the inch, with soft edges where they do not fall on pixels.

use super::{PX_PER_MM, PrintError, PrintShape, PrintSheet, font};
use crate::scene::{BorderSegment, Ink, PixelKernel};
use crate::target::{Disc, Mark};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use nalgebra::Vector2;

pub(super) fn write(sheet: &PrintSheet) -> Result<Vec<u8>, PrintError> {
    let (width, height) =
        ((sheet.size_mm.x * PX_PER_MM).round() as usize, (sheet.size_mm.y * PX_PER_MM).round() as usize);
    let mut layers = vec![];
    if let Some([low, high]) = &sheet.dark_plate {
        layers.push((0.0, edges(&rectangle(low, high))));
    }
    let ink = if sheet.dark_plate.is_some() { 255.0 } else { 0.0 };
    let mut marks = Vec::new();
    for shape in &sheet.shapes {
        match shape {
            PrintShape::Circle { centre_mm, radius_mm } => {
                let disc = Mark::Disc(Disc { centre_m: *centre_mm, radius_m: *radius_mm });
                disc.loops(0.002).iter().for_each(|outline| marks.extend(edges(outline)));
            }
            PrintShape::Outlines(loops) => loops.iter().for_each(|outline| marks.extend(edges(outline))),
        }
    }
    layers.push((ink, marks));
    let mut foot = Vec::new();
    for [low, high] in sheet.bar().into_iter().chain(font::cells(sheet)) {
        foot.extend(edges(&rectangle(&low, &high)));
    }
    // one over the other: the ticks cross the line
    layers.push((0.0, foot));

    let kernel = PixelKernel::new(0.0);
    let mut row_ink = Ink::new(width, &kernel);
    for (_, edges) in &mut layers {
        edges.sort_unstable_by(|a, b| a.top().total_cmp(&b.top()));
    }
    let mut active: Vec<(usize, Vec<BorderSegment>)> = layers.iter().map(|_| (0, Vec::new())).collect();
    let mut levels = vec![0u16; width];
    let mut pixels = vec![0u8; width * height];
    for (y, out) in pixels.chunks_exact_mut(width.max(1)).enumerate() {
        levels.fill(255 << 7);
        for ((level, edges), (next, active)) in layers.iter().zip(&mut active) {
            while let Some(edge) = edges.get(*next).filter(|edge| edge.top() < y as f64 + 1.0) {
                active.push(*edge);
                *next += 1;
            }
            active.retain(|edge| edge.bottom() > y as f64 - 1.0);
            for edge in active.iter() {
                row_ink.add(edge, y as f64, &kernel);
            }
            row_ink.paint(1.0, level * 128.0, &mut levels);
        }
        for (out, level) in out.iter_mut().zip(&levels) {
            *out = ((level + 64) >> 7) as u8;
        }
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&pixels, width as u32, height as u32, ExtendedColorType::L8)
        .map_err(|_| PrintError::Encoder)?;
    with_resolution(&bytes).ok_or(PrintError::Encoder)
}

fn rectangle(low: &Vector2<f64>, high: &Vector2<f64>) -> [Vector2<f64>; 4] {
    [*low, Vector2::new(high.x, low.y), *high, Vector2::new(low.x, high.y)]
}

/// Sides of an outline in pixels, whose centres are whole numbers.
fn edges(outline: &[Vector2<f64>]) -> Vec<BorderSegment> {
    let px = |mm: &Vector2<f64>| [mm.x * PX_PER_MM - 0.5, mm.y * PX_PER_MM - 0.5];
    let next = outline.iter().cycle().skip(1);
    outline.iter().zip(next).map(|(from, to)| BorderSegment { from: px(from), to: px(to) }).collect()
}

/// The same file with a chunk `pHYs` behind its header: pixels per metre.
fn with_resolution(png: &[u8]) -> Option<Vec<u8>> {
    // Signature and IHDR chunk (12 bytes around 13 of data) of the PNG specification.
    const HEADER_END: usize = 8 + 25;
    let per_m = ((PX_PER_MM * 1e3).round() as u32).to_be_bytes();
    let mut chunk = b"pHYs".to_vec();
    chunk.extend(per_m);
    chunk.extend(per_m);
    chunk.push(1);
    let sum = checksum(&chunk);
    let mut out = png.get(..HEADER_END)?.to_vec();
    out.extend(9u32.to_be_bytes());
    out.extend(chunk);
    out.extend(sum.to_be_bytes());
    out.extend(png.get(HEADER_END..)?);
    Some(out)
}

/// CRC-32 as PNG has it.
fn checksum(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
    })
}
