//! Thresholds, regions, contours and moments allocate nothing once they have seen an image of the size.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use assert_no_alloc::assert_no_alloc;
use vservo::imaging::{
    Components, Connectivity, Contours, ImageView, LocalMean, LocalThreshold, MomentSums, Nesting,
    PairCounter, Plane, Polarity, Polygons, Runs, Segmentation, Uniformity, Window,
};

const WIDTH: usize = 200;
const HEIGHT: usize = 150;

#[test]
fn regions_allocate_nothing_after_the_first_image() {
    // light and dark patches with noise in them
    let mut state = 7u64;
    let pixels: Vec<u8> = (0..WIDTH * HEIGHT)
        .map(|i| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let patch = (i % WIDTH / 20 + i / WIDTH / 15).is_multiple_of(2);
            (state >> 59) as u8 + if patch { 180 } else { 60 }
        })
        .collect();
    let image = ImageView::new(&pixels, WIDTH, HEIGHT).unwrap();
    let window = Window::whole(&image);
    let limit = WIDTH * HEIGHT;
    let (mut counter, mut runs) = (PairCounter::default(), Runs::with_limit(limit));
    let (mut components, mut nesting) = (Components::with_limit(limit), Nesting::with_limit(limit));
    let (mut contours, mut polygons) = (Contours::with_limits(limit, 4 * limit), Polygons::with_limit(limit));
    let (mut local, mut mean) = (LocalThreshold::with_size(WIDTH, HEIGHT), LocalMean::new(7, -4));
    let mut segmentation = Segmentation::with_limit(limit);
    let (mut labels, mut sums) = (Plane::with_size(WIDTH, HEIGHT), Vec::new());
    let mut work = || {
        let histogram = counter.count(&image);
        let threshold = histogram.otsu().unwrap().threshold;
        assert!(histogram.valley(Polarity::Dark, 0.02).is_some());
        for polarity in [Polarity::Dark, Polarity::Light] {
            local.set(&image, 30, threshold);
            runs.binarize_local(&image, &mut local, polarity);
            runs.binarize_mean(&image, &mut mean, polarity);
            runs.binarize(&image, &window, threshold, polarity);
            components.find(&runs, &window, Connectivity::Four);
            components.label_image(&runs, WIDTH, HEIGHT, &mut labels);
            components.grey_sums(&image, &runs, &mut sums);
            nesting.find(&runs, Connectivity::Four);
            contours.find(&runs, Connectivity::Eight);
            for contour in contours.as_slice() {
                let points = contours.points(contour);
                assert!(!polygons.closed(points, 1.0).is_empty());
                assert!(MomentSums::of_border(points).m00 != 0);
            }
        }
        segmentation.find(&image, Uniformity::Range(40), 4).unwrap();
        assert!(!segmentation.as_slice().is_empty());
    };
    work();
    assert_no_alloc(work);
}
