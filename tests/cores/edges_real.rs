//! Segments and ellipses tracked through real frames; overlays for people with `EDGE_OVERLAYS=FOLDER`. Skipped without ../shared.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use image::{GrayImage, Rgb, RgbImage};
use nalgebra::Vector2;
use std::path::Path;
use vservo::detect::ellipse::{EllipseFinder, EllipseMiss, EllipseSettings};
use vservo::detect::segments::{SegmentFinder, SegmentMiss, SegmentSettings};
use vservo::imaging::ImageView;

fn load(name: &str) -> Option<GrayImage> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("skipped: no ../shared ({name})");
        return None;
    }
    Some(image::open(path).unwrap().to_luma8())
}

fn view(image: &GrayImage) -> ImageView<'_> {
    ImageView::new(image.as_raw(), image.width() as usize, image.height() as usize).unwrap()
}

fn overlay(image: &GrayImage, name: &str, points: impl Iterator<Item = Vector2<f64>>) {
    let Some(folder) = std::env::var_os("EDGE_OVERLAYS") else { return };
    let mut out = RgbImage::from_fn(3 * image.width(), 3 * image.height(), |x, y| {
        Rgb([image.get_pixel(x / 3, y / 3).0[0]; 3])
    });
    for p in points.map(|p| p.map(|v| 3.0 * (v + 0.5))) {
        if p.x >= 0.0 && p.y >= 0.0 && p.x < f64::from(out.width()) && p.y < f64::from(out.height()) {
            out.put_pixel(p.x as u32, p.y as u32, Rgb([255, 0, 0]));
        }
    }
    out.save(Path::new(&folder).join(name)).unwrap();
}

#[test]
fn the_edge_is_tracked_over_all_frames() {
    let mut last = None;
    for i in 1..=8 {
        let Some(image) = load(&format!("visp-line/image.{i:04}.png")) else { return };
        let view = view(&image);
        let mut finder =
            SegmentFinder::new(image.width() as usize, image.height() as usize, SegmentSettings::default());
        let mut found = Vec::new();
        finder.search(&view, &mut found).unwrap();
        // the edge moves by up to 10 px a frame
        let segment = match &last {
            None => found[0],
            Some(last) => finder.track(&view, last, 15.0).unwrap(),
        };
        // from the upper border to the lower, the light on the left: both ways tell the same line
        assert!(segment.length_px() > 320.0 && segment.share > 0.95, "{i}: {segment:?}");
        assert!(found[0].line.distance_px(&segment.midpoint_px()).abs() < 0.1, "{i}");
        assert!(segment.line.normal().x < -0.7 && segment.step_levels > 100.0, "{i}");
        println!("{i}: {:.2?} sd {:.4} px", segment.ends_px, segment.line.sd_px(0.0));
        let [a, b] = segment.ends_px;
        overlay(&image, &format!("line{i}.png"), (0..4000).map(|k| a + (b - a) * (f64::from(k) / 4000.0)));
        // upside down it is not there
        let mut turned = segment;
        turned.ends_px.swap(0, 1);
        assert_eq!(finder.track(&view, &turned, 15.0), Err(SegmentMiss::Lost));
        last = Some(segment);
    }
}

#[test]
fn an_ellipse_that_leaves_the_frame_is_tracked_over_all_frames() {
    let mut last = None;
    for i in 1..=10 {
        let Some(image) = load(&format!("visp-ellipse/image.{i:04}.png")) else { return };
        let view = view(&image);
        let mut finder =
            EllipseFinder::new(image.width() as usize, image.height() as usize, EllipseSettings::default());
        let mut found = Vec::new();
        finder.search(&view, &mut found).unwrap();
        assert_eq!(found.len(), 1, "{i}");
        let tracked = match &last {
            None => found[0],
            Some(last) => finder.track(&view, last, true, 10.0).unwrap(),
        };
        let off = (tracked.fit.ellipse.centre_px - found[0].fit.ellipse.centre_px).norm();
        let (a, b) = tracked.fit.ellipse.axes_px();
        println!(
            "{i}: {:.2?} axes {a:.2} {b:.2} seen {:.2}",
            tracked.fit.ellipse.centre_px.as_slice(),
            tracked.share
        );
        assert!(off < 0.1 && tracked.light && (0.75..0.85).contains(&tracked.share), "{i}");
        assert!((a - 206.5).abs() < 1.0 && (b - 91.1).abs() < 0.5, "{i}: {a} {b}");
        overlay(
            &image,
            &format!("ellipse{i}.png"),
            (0..9000).map(|k| tracked.fit.ellipse.rim(f64::from(k) * 7e-4).0),
        );
        assert_eq!(finder.track(&view, &tracked.fit.ellipse, false, 5.0), Err(EllipseMiss::Hidden));
        last = Some(tracked.fit.ellipse);
    }
}

/// Drawn without grey levels; a bite is missing in the circle.
#[test]
fn drawn_ellipses_are_found() {
    for (name, centre, axes) in [
        ("circle", Vector2::new(155.3, 110.7), (56.9, 56.8)),
        ("ellipse", Vector2::new(146.3, 142.2), (67.9, 35.6)),
    ] {
        let Some(image) = load(&format!("visp-ellipse/{name}.pgm")) else { return };
        let mut found = Vec::new();
        let mut finder =
            EllipseFinder::new(image.width() as usize, image.height() as usize, EllipseSettings::default());
        finder.search(&view(&image), &mut found).unwrap();
        assert_eq!(found.len(), 1, "{name}");
        let e = found[0].fit.ellipse;
        assert!((e.centre_px - centre).norm() < 0.5, "{name} {e:?}");
        assert!((e.axes_px().0 - axes.0).abs() < 0.5 && (e.axes_px().1 - axes.1).abs() < 0.5, "{name} {e:?}");
        overlay(&image, &format!("{name}.png"), (0..9000).map(|k| e.rim(f64::from(k) * 7e-4).0));
    }
}
