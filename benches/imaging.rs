//! Thresholds, regions, contours and moments of VGA frames, one thread: medians against the goals of the design.
//!
//! Three scenes: 24 discs, 200 blobs, textured clutter.

#![allow(clippy::unwrap_used)] // a bench that cannot be set up should say so at once

use divan::Bencher;
use vservo::imaging::{
    Components, Connectivity, Contours, ImageView, LocalMean, LocalThreshold, MomentSums, Nesting,
    PairCounter, Plane, Polarity, Polygons, Runs, Segmentation, Uniformity, Window,
};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const THRESHOLD: u8 = 120;
const RUNS: usize = 200_000;
const POINTS: usize = 600_000;
const SCENES: [&str; 3] = ["24 discs", "200 blobs", "texture"];

fn main() {
    divan::main();
}

/// Uniform in -1..1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// Dark discs on a light ground with soft edges, or a sum of waves in many directions; a little noise.
fn scene(name: &str) -> Vec<u8> {
    let mut random = Random(3);
    let (columns, rows, radius) = if name == SCENES[0] { (6, 4, 22.0) } else { (20, 10, 7.5) };
    let (dx, dy) = (WIDTH as f64 / f64::from(columns), HEIGHT as f64 / f64::from(rows));
    let waves: Vec<[f64; 3]> = (0..40)
        .map(|_| [0.35 * random.next(), 0.35 * random.next(), std::f64::consts::PI * random.next()])
        .collect();
    let mut pixels = Vec::with_capacity(WIDTH * HEIGHT);
    for i in 0..WIDTH * HEIGHT {
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let level = if name == SCENES[2] {
            125.0 + 10.0 * waves.iter().map(|[u, v, phase]| (u * x + v * y + phase).sin()).sum::<f64>()
        } else {
            let (u, v) = ((x / dx).fract() * dx - dx / 2.0, (y / dy).fract() * dy - dy / 2.0);
            120.0 + (u.hypot(v) - radius).clamp(-1.0, 1.0) * 80.0
        };
        pixels.push((level + 4.0 * random.next()).round().clamp(0.0, 255.0) as u8);
    }
    pixels
}

/// Calls `work` with the scene's image, its whole window and its dark runs.
fn with_runs(name: &str, work: impl FnOnce(&ImageView<'_>, &Window, &mut Runs)) {
    let pixels = scene(name);
    let image = ImageView::new(&pixels, WIDTH, HEIGHT).unwrap();
    let window = Window::whole(&image);
    let mut runs = Runs::with_limit(RUNS);
    runs.find(&image, &window, THRESHOLD);
    work(&image, &window, &mut runs);
}

/// Goal 40 us.
#[divan::bench(args = SCENES)]
fn otsu(bencher: Bencher, name: &str) {
    with_runs(name, |image, _, _| {
        let mut counter = PairCounter::default();
        bencher.bench_local(|| counter.count(image).otsu());
    });
}

#[divan::bench(args = SCENES)]
fn valley_of_a_histogram(bencher: Bencher, name: &str) {
    with_runs(name, |image, _, _| {
        let histogram = PairCounter::default().count(image);
        bencher.bench_local(|| divan::black_box(&histogram).valley(Polarity::Dark, 0.02));
    });
}

#[divan::bench(args = [Polarity::Dark, Polarity::Light])]
fn binarize(bencher: Bencher, polarity: Polarity) {
    with_runs(SCENES[0], |image, window, runs| {
        bencher.bench_local(|| runs.binarize(image, window, THRESHOLD, polarity));
    });
}

#[divan::bench(args = SCENES)]
fn binarize_by_local_extremes(bencher: Bencher, name: &str) {
    with_runs(name, |image, _, runs| {
        let mut local = LocalThreshold::with_size(WIDTH, HEIGHT);
        bencher.bench_local(|| {
            local.set(image, 30, THRESHOLD);
            runs.find_local(image, &mut local);
        });
    });
}

#[divan::bench(args = SCENES)]
fn binarize_by_local_mean(bencher: Bencher, name: &str) {
    with_runs(name, |image, _, runs| {
        let mut mean = LocalMean::new(15, -8);
        bencher.bench_local(|| runs.binarize_mean(image, &mut mean, Polarity::Dark));
    });
}

/// Goal 16 us for 24 discs, binarization and moments to third order included.
#[divan::bench(args = SCENES)]
fn components(bencher: Bencher, name: &str) {
    with_runs(name, |image, window, runs| {
        let mut components = Components::with_limit(RUNS);
        bencher.bench_local(|| {
            runs.find(image, window, THRESHOLD);
            components.find(runs, window, Connectivity::Eight);
            components.as_slice().len()
        });
    });
}

#[divan::bench(args = SCENES)]
fn nesting_of_runs(bencher: Bencher, name: &str) {
    with_runs(name, |_, _, runs| {
        let mut nesting = Nesting::with_limit(RUNS);
        bencher.bench_local(|| nesting.find(runs, Connectivity::Eight));
    });
}

#[divan::bench(args = SCENES)]
fn label_image(bencher: Bencher, name: &str) {
    with_runs(name, |_, window, runs| {
        let (mut components, mut labels) = (Components::with_limit(RUNS), Plane::with_size(WIDTH, HEIGHT));
        components.find(runs, window, Connectivity::Eight);
        bencher.bench_local(|| components.label_image(runs, WIDTH, HEIGHT, &mut labels));
    });
}

/// Goal 30 us for 24 discs, binarization included.
#[divan::bench(args = SCENES)]
fn contours(bencher: Bencher, name: &str) {
    with_runs(name, |image, window, runs| {
        let mut contours = Contours::with_limits(RUNS, POINTS);
        bencher.bench_local(|| {
            runs.find(image, window, THRESHOLD);
            contours.find(runs, Connectivity::Eight);
            contours.as_slice().len()
        });
    });
}

#[divan::bench(args = SCENES)]
fn polygons_of_contours(bencher: Bencher, name: &str) {
    with_runs(name, |_, _, runs| {
        let (mut contours, mut polygons) =
            (Contours::with_limits(RUNS, POINTS), Polygons::with_limit(POINTS));
        contours.find(runs, Connectivity::Eight);
        bencher.bench_local(|| {
            let list = contours.as_slice().iter();
            list.map(|c| polygons.closed(contours.points(c), 1.5).len()).sum::<usize>()
        });
    });
}

#[divan::bench(args = SCENES)]
fn moments_of_borders(bencher: Bencher, name: &str) {
    with_runs(name, |_, _, runs| {
        let mut contours = Contours::with_limits(RUNS, POINTS);
        contours.find(runs, Connectivity::Eight);
        bencher.bench_local(|| {
            let list = contours.as_slice().iter();
            list.map(|c| MomentSums::of_border(contours.points(c)).m00).sum::<i128>()
        });
    });
}

#[divan::bench]
fn grey_moments_of_the_whole_image(bencher: Bencher) {
    with_runs(SCENES[0], |image, window, _| bencher.bench_local(|| MomentSums::of_grey(image, window)));
}

#[divan::bench(args = SCENES)]
fn grey_moments_of_components(bencher: Bencher, name: &str) {
    with_runs(name, |image, window, runs| {
        let (mut components, mut sums) = (Components::with_limit(RUNS), Vec::new());
        components.find(runs, window, Connectivity::Eight);
        bencher.bench_local(|| components.grey_sums(image, runs, &mut sums));
    });
}

#[divan::bench(args = SCENES, sample_count = 20, sample_size = 1)]
fn region_merging(bencher: Bencher, name: &str) {
    with_runs(name, |image, _, _| {
        let mut segmentation = Segmentation::with_limit(WIDTH * HEIGHT);
        bencher.bench_local(|| segmentation.find(image, Uniformity::Range(30), 20));
    });
}
