//! From a camera's buffer to grey, one thread: medians against the goals of the design.

#![allow(clippy::unwrap_used)] // a bench that cannot be set up should say so at once

use divan::Bencher;
use vservo::imaging::grey::{PixelFormat, ToGrey};

fn main() {
    divan::main();
}

fn lines(bencher: Bencher, format: PixelFormat, width: u32, height: u32) {
    let stride = format.min_stride_bytes(width);
    let raw = vec![100; format.min_payload_bytes(width, height, stride)];
    let mut out = vec![0; (width * height) as usize];
    let mut grey = ToGrey::new(format, width, height);
    bencher.bench_local(|| grey.convert(&raw, stride, &mut out).unwrap());
}

#[divan::bench]
fn grey_vga(bencher: Bencher) {
    lines(bencher, PixelFormat::Grey, 640, 480);
}

/// Goal 15 us.
#[divan::bench]
fn yuyv_vga(bencher: Bencher) {
    lines(bencher, PixelFormat::Yuyv, 640, 480);
}

#[divan::bench]
fn uyvy_vga(bencher: Bencher) {
    lines(bencher, PixelFormat::Uyvy, 640, 480);
}

#[divan::bench]
fn y10_vga(bencher: Bencher) {
    lines(bencher, PixelFormat::Y10, 640, 480);
}

/// Goal 120 us.
#[divan::bench]
fn yuyv_full_hd(bencher: Bencher) {
    lines(bencher, PixelFormat::Yuyv, 1920, 1080);
}

/// Structures of all sizes with amplitudes like those of natural scenes, some sharp edges, and noise of a sensor; as RGB.
fn scene(width: usize, height: usize) -> Vec<u8> {
    let hash = |x: usize, y: usize, octave: usize| {
        let mut h = (x * 73_856_093) ^ (y * 19_349_663) ^ (octave * 83_492_791);
        h = (h ^ (h >> 13)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        ((h >> 40) & 0xFFFF) as f64 / 65536.0 - 0.5
    };
    let smooth = |x: usize, y: usize, octave: usize| {
        let size = 1 << octave;
        let (i, j) = (x / size, y / size);
        let (a, b) = ((x % size) as f64 / size as f64, (y % size) as f64 / size as f64);
        let top = hash(i, j, octave) * (1.0 - a) + hash(i + 1, j, octave) * a;
        let bottom = hash(i, j + 1, octave) * (1.0 - a) + hash(i + 1, j + 1, octave) * a;
        top * (1.0 - b) + bottom * b
    };
    let mut rgb = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let ground: f64 = (2..8).map(|o| 7.0 * f64::from(1 << o).sqrt() * smooth(x, y, o)).sum();
            let edge = if (x / 80 + y / 60) % 2 == 0 { 30.0 } else { -20.0 };
            let grey = 120.0 + ground + edge + 8.0 * hash(x, y, 0);
            let colour = 60.0 * smooth(x, y, 6);
            for level in [grey + colour, grey, grey - colour] {
                rgb.push(level.clamp(0.0, 255.0) as u8);
            }
        }
    }
    rgb
}

fn jpeg(rgb: &[u8], width: u16, height: u16, quality: u8) -> Vec<u8> {
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
    let mut jpeg = Vec::new();
    let mut encoder = Encoder::new(&mut jpeg, quality);
    encoder.set_sampling_factor(SamplingFactor::R_4_2_2);
    encoder.encode(rgb, width, height, ColorType::Rgb).unwrap();
    jpeg
}

/// Goal 400 us at 30 to 60 KB, which quality 80 to 90 gives here.
#[divan::bench(args = [80, 85, 90])]
fn mjpg_vga(bencher: Bencher, quality: u8) {
    let jpeg = jpeg(&scene(640, 480), 640, 480, quality);
    assert!((25_000..75_000).contains(&jpeg.len()), "{} bytes", jpeg.len());
    let mut out = vec![0; 640 * 480];
    let mut grey = ToGrey::new(PixelFormat::Mjpg, 640, 480);
    bencher.bench_local(|| grey.convert(&jpeg, 0, &mut out).unwrap());
}

/// The same by the decoder that reads image files, for comparison.
#[divan::bench(args = [85])]
fn mjpg_vga_by_library(bencher: Bencher, quality: u8) {
    use zune_jpeg::zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
    let jpeg = jpeg(&scene(640, 480), 640, 480, quality);
    let mut out = vec![0; 640 * 480];
    bencher.bench_local(|| {
        let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::Luma);
        zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(&jpeg), options).decode_into(&mut out).unwrap();
    });
}
