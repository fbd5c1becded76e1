//! Gradients, edges and the finders on them allocate nothing once they have seen a frame.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use assert_no_alloc::assert_no_alloc;
use vservo::detect::ellipse::{EllipseFinder, EllipseSettings};
use vservo::detect::segments::{SegmentFinder, SegmentSettings};
use vservo::imaging::{
    Chains, DualConic, EdgeThresholds, Edges, Gaussian, Gradient, ImageView, Operator, Plane, Pyramid,
    direction, laplacian, magnitude, magnitude_sum,
};

const WIDTH: usize = 200;
const HEIGHT: usize = 150;

/// A disc and a square that move with `k`.
fn frame(k: u32) -> Vec<u8> {
    let soft = |d: f64| 160.0 / (1.0 + (-2.0 * d).exp());
    (0..WIDTH * HEIGHT)
        .map(|i| {
            let (x, y) = ((i % WIDTH) as f64 - 0.3 * f64::from(k), (i / WIDTH) as f64);
            let disc = (x - 55.0).hypot(y - 70.0) - 30.0;
            let square = (x - 140.0).abs().max((y - 75.0).abs()) - 32.0;
            (40.0 + soft(disc.min(square))) as u8
        })
        .collect()
}

#[test]
fn nothing_is_allocated_per_frame() {
    let frames: Vec<Vec<u8>> = (0..20).map(frame).collect();
    let (mut gradient, mut pyramid, mut filter) =
        (Gradient::default(), Pyramid::new(3), Gaussian::new(1.2).unwrap());
    let (mut a, mut b, mut c, mut d, mut e) =
        (Plane::default(), Plane::default(), Plane::default(), Plane::default(), Plane::default());
    let (mut edges, mut chains, mut dual) =
        (Edges::with_limit(10_000), Chains::default(), DualConic::default());
    let mut ellipses = EllipseFinder::new(WIDTH, HEIGHT, EllipseSettings::default());
    let mut segments = SegmentFinder::new(WIDTH, HEIGHT, SegmentSettings::default());
    let (mut found, mut lines) = (Vec::with_capacity(64), Vec::with_capacity(256));
    let mut run = |pixels: &[u8]| {
        let image = ImageView::new(pixels, WIDTH, HEIGHT).unwrap();
        for operator in [Operator::FirstDifferences, Operator::Roberts, Operator::Sobel] {
            gradient.find(&image, operator);
        }
        magnitude(&gradient, &mut a);
        direction(&gradient, &mut b);
        magnitude_sum(&gradient, &mut c);
        laplacian(&image, &mut d);
        filter.filter(&image, &mut e);
        pyramid.build(&image);
        edges.find(&image, &EdgeThresholds::default());
        chains.link(&edges, 8);
        ellipses.search(&image, &mut found).unwrap();
        let ellipse = found[0].fit.ellipse;
        ellipses.track(&image, &ellipse, false, 3.0).unwrap();
        dual.fit(&image, &ellipse, 3.0, 1.0).unwrap();
        segments.search(&image, &mut lines).unwrap();
        segments.track(&image, &lines[0], 3.0).unwrap();
    };
    // buffers grow to what a frame of this kind takes
    frames.iter().take(3).for_each(|pixels| run(pixels));
    run(&frames[0]);
    assert_no_alloc(|| frames.iter().skip(3).for_each(|pixels| run(pixels)));
}
