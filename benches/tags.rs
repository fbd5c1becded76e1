//! Tags in a frame, one thread. Peers are measured beside the project: AprilTag's C library through its Python package, on the same images.

#![allow(clippy::unwrap_used)] // a bench that cannot be set up should say so at once

#[path = "../tests/tag_scene/mod.rs"]
mod tag_scene;

use divan::Bencher;
use tag_scene::{Canvas, Dice, Look, Map};
use vservo::detect::tags::{PredictedTag, TagDetection, TagFinder};
use vservo::imaging::ImageView;
use vservo::target::TagFamily;

fn main() {
    divan::main();
}

/// VGA with 12 tags of 36h11, 60 px long, tilted; with or without polygons around them.
fn image(clutter: usize) -> Vec<u8> {
    let (mut dice, look) = (Dice(1), Look { samples: 6, ..Look::default() });
    let mut canvas = Canvas::new(640, 480, look.ground);
    canvas.clutter(clutter, &mut dice);
    for i in 0..12 {
        let (u, v) = (90.0 + 150.0 * f64::from(i % 4), 90.0 + 150.0 * f64::from(i / 4));
        let map = Map::view(8.0, u, v, 60.0, 0.4 * f64::from(i), 0.5, f64::from(i), 600.0, (320.0, 240.0));
        canvas.draw(TagFamily::Tag36h11, i, &map, &look, &mut dice);
    }
    canvas.expose(&look, &mut dice)
}

#[divan::bench(args = [0, 200])]
fn search_vga(bencher: Bencher, clutter: usize) {
    let pixels = image(clutter);
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut finder = TagFinder::new(TagFamily::Tag36h11, 640, 480);
    let mut found: Vec<TagDetection> = Vec::with_capacity(64);
    bencher.bench_local(|| finder.search(&image, &mut found));
}

#[divan::bench]
fn track_one_vga(bencher: Bencher) {
    let pixels = image(0);
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut finder = TagFinder::new(TagFamily::Tag36h11, 640, 480);
    let mut found: Vec<TagDetection> = Vec::with_capacity(64);
    finder.search(&image, &mut found).unwrap();
    let expected = [PredictedTag { id: found[5].id, corners_px: found[5].corners_px, slack_px: 5.0 }];
    bencher.bench_local(|| finder.track(&image, &expected, &mut found));
}

#[divan::bench]
fn search_vga_noise(bencher: Bencher) {
    let (mut dice, look) = (Dice(2), Look { noise: 40.0, ..Look::default() });
    let pixels = Canvas::new(640, 480, look.ground).expose(&look, &mut dice);
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut finder = TagFinder::new(TagFamily::Tag36h11, 640, 480);
    let mut found: Vec<TagDetection> = Vec::with_capacity(64);
    bencher.bench_local(|| finder.search(&image, &mut found));
}
