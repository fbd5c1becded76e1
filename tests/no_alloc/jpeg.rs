//! A decoder of JPEGs allocates nothing once it has seen an image, also where each image has Huffman tables of its own.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use assert_no_alloc::assert_no_alloc;
use jpeg_encoder::{ColorType, Encoder};
use vservo::imaging::jpeg::LumaDecoder;

const WIDTH: u16 = 160;
const HEIGHT: u16 = 120;

fn jpeg(quality: u8, own_tables: bool) -> Vec<u8> {
    let (width, height) = (usize::from(WIDTH), usize::from(HEIGHT));
    let rgb: Vec<u8> = (0..3 * width * height).map(|i| (i * i / 97 % 251) as u8).collect();
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, quality);
    encoder.set_optimized_huffman_tables(own_tables);
    encoder.encode(&rgb, WIDTH, HEIGHT, ColorType::Rgb).unwrap();
    bytes
}

#[test]
fn tables_that_change_are_filled_in_place() {
    let images = [jpeg(80, false), jpeg(30, true), jpeg(60, true)];
    let mut decoder = LumaDecoder::new(WIDTH.into(), HEIGHT.into());
    let mut out = vec![0; usize::from(WIDTH) * usize::from(HEIGHT)];
    let mut work = || {
        for image in &images {
            assert!(decoder.decode(image, &mut out).is_ok());
        }
    };
    work();
    assert_no_alloc(work);
}
