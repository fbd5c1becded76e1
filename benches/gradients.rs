//! Gradients, filters, edges and the finders of segments and ellipses, one thread, VGA: medians against the goals of the design.

#![allow(clippy::unwrap_used)] // a bench that cannot be set up should say so at once

use divan::Bencher;
use nalgebra::Vector2;
use vservo::detect::ellipse::{EllipseFinder, EllipseSettings};
use vservo::detect::segments::{SegmentFinder, SegmentSettings};
use vservo::imaging::{
    Chains, EdgeThresholds, Edges, Gaussian, Gradient, ImageView, Norm, Operator, Plane, Pyramid, direction,
    laplacian, magnitude, magnitude_sum,
};
use vservo::linalg::Random;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

fn main() {
    divan::main();
}

/// 24 soft dark discs on a light ground, noise of 2 grey levels.
fn discs() -> Vec<u8> {
    let mut random = Random::new(1);
    (0..WIDTH * HEIGHT)
        .map(|i| {
            let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            let (u, v) = ((x / 106.7).fract() - 0.5, (y / 120.0).fract() - 0.5);
            let d = (u * 106.7).hypot(v * 120.0) - 30.0;
            (40.0 + 160.0 / (1.0 + (-2.0 * d).exp()) + 2.0 * random.gaussian()).round() as u8
        })
        .collect()
}

/// Edges everywhere: the worst that a frame shows that is no noise.
fn texture() -> Vec<u8> {
    let wave = |i: usize| {
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        128.0
            + 50.0 * (0.45 * x + 3.0 * (0.05 * y).sin()).sin()
            + 50.0 * (0.4 * y + 2.0 * (0.07 * x).cos()).sin()
    };
    (0..WIDTH * HEIGHT).map(|i| wave(i) as u8).collect()
}

fn with(bencher: Bencher, pixels: &[u8], mut run: impl FnMut(&ImageView<'_>)) {
    let image = ImageView::new(pixels, WIDTH, HEIGHT).unwrap();
    run(&image);
    bencher.bench_local(|| run(&image));
}

/// Goal for Sobel 40 us.
#[divan::bench(args = [Operator::FirstDifferences, Operator::Roberts, Operator::Sobel])]
fn gradient(bencher: Bencher, operator: Operator) {
    let mut gradient = Gradient::default();
    with(bencher, &discs(), |image| gradient.find(image, operator));
}

#[divan::bench(args = ["magnitude", "sum", "direction"])]
fn of_gradient(bencher: Bencher, what: &str) {
    let pixels = discs();
    let mut gradient = Gradient::default();
    gradient.find(&ImageView::new(&pixels, WIDTH, HEIGHT).unwrap(), Operator::Sobel);
    let (mut out, mut sum) = (Plane::default(), Plane::default());
    bencher.bench_local(|| match what {
        "magnitude" => magnitude(&gradient, &mut out),
        "sum" => magnitude_sum(&gradient, &mut sum),
        _ => direction(&gradient, &mut out),
    });
}

#[divan::bench]
fn laplacian_vga(bencher: Bencher) {
    let mut out = Plane::default();
    with(bencher, &discs(), |image| laplacian(image, &mut out));
}

#[divan::bench(args = [0.8, 1.0, 2.0])]
fn gaussian(bencher: Bencher, sigma_px: f64) {
    let (mut filter, mut out) = (Gaussian::new(sigma_px).unwrap(), Plane::default());
    with(bencher, &discs(), |image| filter.filter(image, &mut out));
}

#[divan::bench(args = [1, 3])]
fn pyramid(bencher: Bencher, levels: usize) {
    let mut pyramid = Pyramid::new(levels);
    with(bencher, &discs(), |image| pyramid.build(image));
}

mod edges {
    use super::*;

    fn find(bencher: Bencher, pixels: &[u8], norm: Norm) {
        let mut edges = Edges::with_limit(WIDTH * HEIGHT);
        let thresholds = EdgeThresholds { low: 50.0, high: 150.0, norm };
        with(bencher, pixels, |image| edges.find(image, &thresholds));
        assert!(!edges.pixels().is_empty());
    }

    #[divan::bench(args = [Norm::Sum, Norm::Euclidean])]
    fn of_discs(bencher: Bencher, norm: Norm) {
        find(bencher, &discs(), norm);
    }

    #[divan::bench(args = [Norm::Sum, Norm::Euclidean])]
    fn of_texture(bencher: Bencher, norm: Norm) {
        find(bencher, &texture(), norm);
    }

    #[divan::bench(args = [true, false])]
    fn chains(bencher: Bencher, few: bool) {
        let (mut edges, mut chains) = (Edges::with_limit(WIDTH * HEIGHT), Chains::default());
        let pixels = if few { discs() } else { texture() };
        edges.find(&ImageView::new(&pixels, WIDTH, HEIGHT).unwrap(), &EdgeThresholds::default());
        bencher.bench_local(|| chains.link(&edges, 8));
    }
}

mod find {
    use super::*;

    #[divan::bench]
    fn ellipses_24(bencher: Bencher) {
        let mut finder = EllipseFinder::new(WIDTH, HEIGHT, EllipseSettings::default());
        let mut found = Vec::new();
        with(bencher, &discs(), |image| finder.search(image, &mut found).unwrap());
        assert_eq!(found.len(), 24);
    }

    #[divan::bench]
    fn track_ellipse(bencher: Bencher) {
        let mut finder = EllipseFinder::new(WIDTH, HEIGHT, EllipseSettings::default());
        let (pixels, mut found) = (discs(), Vec::new());
        let image = ImageView::new(&pixels, WIDTH, HEIGHT).unwrap();
        finder.search(&image, &mut found).unwrap();
        let known = found[0].fit.ellipse;
        bencher.bench_local(|| finder.track(&image, &known, false, 5.0).unwrap());
    }

    /// A square of 200 px.
    fn square() -> Vec<u8> {
        let mut random = Random::new(2);
        (0..WIDTH * HEIGHT)
            .map(|i| {
                let p = Vector2::new((i % WIDTH) as f64 - 320.0, (i / WIDTH) as f64 - 240.0);
                let d = 100.0 - (0.96 * p.x + 0.28 * p.y).abs().max((0.96 * p.y - 0.28 * p.x).abs());
                (40.0 + 160.0 / (1.0 + (-2.0 * d).exp()) + 2.0 * random.gaussian()).round() as u8
            })
            .collect()
    }

    #[divan::bench]
    fn segments_4(bencher: Bencher) {
        let mut finder = SegmentFinder::new(WIDTH, HEIGHT, SegmentSettings::default());
        let mut found = Vec::new();
        with(bencher, &square(), |image| finder.search(image, &mut found).unwrap());
        assert_eq!(found.len(), 4);
    }

    #[divan::bench]
    fn track_segment(bencher: Bencher) {
        let mut finder = SegmentFinder::new(WIDTH, HEIGHT, SegmentSettings::default());
        let (pixels, mut found) = (square(), Vec::new());
        let image = ImageView::new(&pixels, WIDTH, HEIGHT).unwrap();
        finder.search(&image, &mut found).unwrap();
        let known = found[0];
        bencher.bench_local(|| finder.track(&image, &known, 5.0).unwrap());
    }
}
