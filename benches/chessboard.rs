//! Chessboards, one thread: medians against the goals of the design.

#![allow(clippy::unwrap_used)] // a bench that cannot be set up should say so at once

use divan::Bencher;
use nalgebra::Vector2;
use vservo::detect::chessboard::ChessboardFinder;
use vservo::detect::{Detection, PredictedPoint};
use vservo::imaging::ImageView;
use vservo::imaging::corners::{RingDetector, RingResponse, StructureDetector};

fn main() {
    divan::main();
}

/// A turned 9x6 board with squares of `side` px on grey, its edges blurred over a pixel or so, with a little noise.
fn board(width: usize, height: usize, side: f64) -> Vec<u8> {
    let (s, c) = 0.2f64.sin_cos();
    let mut state = 1u64;
    let wave = |t: f64| {
        let nearest = t.round();
        let sign = if nearest.rem_euclid(2.0) < 0.5 { 1.0 } else { -1.0 };
        sign * ((t - nearest) * side / 1.2).clamp(-1.0, 1.0)
    };
    (0..width * height)
        .map(|i| {
            let (x, y) = ((i % width) as f64 - 0.5 * width as f64, (i / width) as f64 - 0.5 * height as f64);
            let (u, v) = ((c * x + s * y) / side + 4.0, (c * y - s * x) / side + 2.5);
            let on = |m: f64| u > -1.0 - m && u < 9.0 + m && v > -1.0 - m && v < 6.0 + m;
            let level = match (on(0.0), on(0.7)) {
                (true, _) => 120.0 - 80.0 * wave(u) * wave(v),
                (false, true) => 200.0,
                _ => 110.0,
            };
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (level + (state >> 61) as f64 - 3.5) as u8
        })
        .collect()
}

fn search(bencher: Bencher, width: usize, height: usize, side: f64) {
    let pixels = board(width, height, side);
    let image = ImageView::new(&pixels, width, height).unwrap();
    let mut finder = ChessboardFinder::new(9, 6, width, height);
    let mut found = Vec::new();
    finder.search_or_why(&image, &mut found).unwrap();
    assert_eq!(found.len(), 54);
    bencher.bench_local(|| finder.search(&image, &mut found));
}

/// Goal 500 us.
#[divan::bench(args = [15.0, 30.0, 45.0])]
fn search_vga(bencher: Bencher, side: f64) {
    search(bencher, 640, 480, side);
}

/// Squares too small for the half image.
#[divan::bench]
fn search_vga_small_squares(bencher: Bencher) {
    search(bencher, 640, 480, 8.0);
}

#[divan::bench]
fn search_hd(bencher: Bencher) {
    search(bencher, 1920, 1080, 80.0);
}

/// Predictions 2 px off.
#[divan::bench(args = [1.5, 8.0])]
fn track_vga(bencher: Bencher, slack_px: f64) {
    let pixels = board(640, 480, 30.0);
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut finder = ChessboardFinder::new(9, 6, 640, 480);
    let mut found: Vec<Detection> = Vec::new();
    finder.search_or_why(&image, &mut found).unwrap();
    let off = Vector2::new(0.7, -0.7) * slack_px.min(2.0);
    let expected: Vec<_> = found
        .iter()
        .map(|f| PredictedPoint {
            id: f.id,
            px: f.px + off,
            covariance_px2: f.covariance_px2,
            area_px2: f.area_px2,
            slack_px,
            threshold: 120,
        })
        .collect();
    assert!(finder.track(&image, &expected, &mut found) && found.len() == 54);
    bencher.bench_local(|| finder.track(&image, &expected, &mut found));
}

#[divan::bench]
fn ring_response_vga(bencher: Bencher) {
    let pixels = board(640, 480, 30.0);
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut response = RingResponse::with_capacity(640 * 480);
    bencher.bench_local(|| response.compute(&image, 6));
}

#[divan::bench]
fn ring_corners_vga(bencher: Bencher) {
    let pixels = board(640, 480, 30.0);
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut detector = RingDetector::new(640 * 480, 400);
    bencher.bench_local(|| detector.find(&image, 6).len());
}

#[divan::bench]
fn structure_corners_vga(bencher: Bencher) {
    let pixels = board(640, 480, 30.0);
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut detector = StructureDetector::new(640, 480, 400);
    bencher.bench_local(|| detector.find(&image, 30.0).len());
}
