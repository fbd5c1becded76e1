//! Which dots are the target: none where there is none, no choice between two, and no good view lost.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::rendered::{Bench, HEIGHT, Random, WIDTH, camera, equal_dots, pose};
use nalgebra::{Translation3, Unit, UnitQuaternion, Vector2, Vector3};
use std::path::Path;
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::detect::{Detection, DotFinder, Finder, PredictedPoint};
use vservo::geometry::Pose;
use vservo::imaging::ImageView;
use vservo::messages::TargetStatus;
use vservo::scene::{Renderer, SceneLook, SensorModel};
use vservo::target::FourDots;

fn search(camera: CameraModel, image: &[u8]) -> Result<Vec<Detection>, TargetStatus> {
    let i = camera.intrinsics();
    let view = ImageView::new(image, i.width_px as usize, i.height_px as usize).unwrap();
    let mut found = Vec::new();
    Finder::new(camera, &FourDots::default().into()).search(&view, &mut found).map(|()| found)
}

#[test]
fn grids_of_equal_dots_hold_no_target() {
    let camera = camera(0.0);
    let (mut random, mut noise) = (Random(5), Random(9));
    let mut image = vec![0; WIDTH * HEIGHT];
    let mut wrong = Vec::new();
    for n in 3..=7 {
        for k in 0..16 {
            // spacing and size of the target's dots, and others
            let pitch_m = [0.1, 0.05][k % 2];
            let radius_m = pitch_m * [0.1, 0.15, 0.25, 0.35][k / 2 % 4];
            let middle_m = 0.5 * pitch_m * (n - 1) as f64;
            let z = random.within(1.1, 3.0) * pitch_m * (n + 1) as f64 * 1.3;
            let axis = Vector3::new(random.within(-1.0, 1.0), random.within(-1.0, 1.0), 0.0);
            let R = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), random.within(0.0, 1.0))
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.within(0.0, 1.5));
            let X_CO = Pose::from_parts(Translation3::new(0.0, 0.0, z), R)
                * Translation3::new(-middle_m, -middle_m, 0.0);
            equal_dots(&camera, &X_CO, n, pitch_m, radius_m, &mut image);
            image.iter_mut().for_each(|p| *p = (f64::from(*p) + noise.within(-3.0, 3.0)) as u8);
            if let Ok(dots) = search(camera, &image) {
                wrong.push(format!(
                    "{n}x{n} grid {k}: {:?}",
                    dots.iter().map(|d| (d.px.x, d.px.y)).collect::<Vec<_>>()
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{} of 80: {wrong:#?}", wrong.len());
}

#[test]
fn two_targets_of_any_size_are_ambiguous() {
    let mut random = Random(4);
    let sensor = SensorModel { noise_sd_levels: 2.0, blur_sd_px: 0.5, vignetting: 0.1, seed: 3 };
    let mut bench = Bench::new(0.0, sensor);
    let camera = *bench.renderer.camera();
    let mut half = |bench: &Bench, side: f64| loop {
        let z = random.within(0.4, 1.3);
        let (x, y) = (side * 0.27 * z, random.within(-0.2, 0.2) * z);
        let (turn, tilt, about) =
            (random.within(-3.2, 3.2), random.within(0.0, 0.9), random.within(-3.2, 3.2));
        let X_CO = pose(x, y, z, turn, tilt, about);
        let truth = bench.renderer.truth(&X_CO);
        if truth.iter().all(|p| (p.x - 320.0) * side > 30.0 && camera.contains(p, 30.0)) {
            return X_CO;
        }
    };
    for k in 0..100 {
        let (left, right) = (half(&bench, -1.0), half(&bench, 1.0));
        bench.render(&left);
        let image = bench.image.clone();
        bench.render(&right);
        for (row, left) in bench.image.chunks_exact_mut(WIDTH).zip(image.chunks_exact(WIDTH)) {
            row[..WIDTH / 2].copy_from_slice(&left[..WIDTH / 2]);
        }
        assert_eq!(
            search(camera, &bench.image).err(),
            Some(TargetStatus::Ambiguous),
            "pair {k}: {left} {right}"
        );
    }
}

/// Small, flat, blurred and noisy ones too.
#[test]
fn views_of_the_target_are_found() {
    let mut random = Random(2);
    let (mut found, mut count) = (0, 0);
    for k in 0..8 {
        let sensor = SensorModel {
            noise_sd_levels: [1.0, 3.0, 8.0, 3.0][k % 4],
            blur_sd_px: [0.3, 0.5, 1.0, 1.5][k / 2],
            vignetting: 0.15,
            seed: k as u64,
        };
        let mut bench = Bench::new([0.0, -0.2][k % 2], sensor);
        let camera = *bench.renderer.camera();
        for _ in 0..50 {
            let X_CO = random.pose(&bench.renderer, 1.8);
            bench.render(&X_CO);
            count += 1;
            if let Ok(dots) = search(camera, &bench.image) {
                found += 1;
                for (dot, truth) in dots.iter().zip(bench.renderer.truth(&X_CO)) {
                    assert!((dot.px - truth).norm() < 3.0, "a corner taken for another at {X_CO}");
                }
            }
        }
    }
    println!("{found} of {count} found");
    assert!(100 * found >= 99 * count, "{found} of {count}");
}

/// A plate whose P2 has a size of its own is not seen in a mirror; the textbook's is taken for itself there.
#[test]
fn a_chiral_target_is_told_from_its_mirror_image() {
    let camera = camera(0.0);
    let textbook = FourDots::default();
    let chiral = textbook.with_second_radius((0.015f64 * 0.010).sqrt()).unwrap();
    let mut random = Random(11);
    let (mut seen, mut reflected, mut taken, mut count) = (0, 0, 0, 0);
    for k in 0..100 {
        let sensor = SensorModel { noise_sd_levels: 3.0, blur_sd_px: 0.6, vignetting: 0.15, seed: k };
        for target in [textbook, chiral] {
            let mut renderer = Renderer::new(camera, target, SceneLook::default(), sensor).unwrap();
            let X_CO = random.pose(&renderer, 3.0);
            let mut image = vec![0; WIDTH * HEIGHT];
            renderer.render(&[X_CO], k, &mut image);
            let look = |image: &[u8]| {
                let view = ImageView::new(image, WIDTH, HEIGHT).unwrap();
                let mut found = Vec::new();
                Finder::new(camera, &target.into()).search(&view, &mut found).is_ok().then_some(found)
            };
            let there = look(&image);
            for (dot, truth) in there.iter().flatten().zip(renderer.truth(&X_CO)) {
                assert!((dot.px - truth).norm() < 3.0, "a corner taken for another at {X_CO}");
            }
            image.chunks_mut(WIDTH).for_each(<[u8]>::reverse);
            let mirrored = look(&image).is_some();
            if target == chiral {
                (seen, taken) = (seen + usize::from(there.is_some()), taken + usize::from(mirrored));
                count += 1;
            } else {
                reflected += usize::from(mirrored);
            }
        }
    }
    println!(
        "{seen} of {count} seen, {taken} mirror images taken for the target; of the textbook's {reflected}"
    );
    assert!(seen >= count - 1 && taken == 0 && reflected >= count - 5, "{seen} {taken} {reflected}");
}

/// Photographs without a target: chessboards, tags, grids of dots, landscapes.
#[test]
fn photographs_hold_no_target() {
    let data = Path::new("../shared/data");
    let Ok(sets) = data.read_dir() else {
        println!("skipped: no ../shared");
        return;
    };
    let mut files: Vec<_> =
        sets.flatten().filter_map(|set| set.path().read_dir().ok()).flatten().flatten().collect();
    files.sort_by_key(std::fs::DirEntry::path);
    let (mut count, mut found) = (0, Vec::new());
    for file in files {
        let Ok(image) = image::open(file.path()) else { continue };
        let image = image.into_luma8();
        let (width_px, height_px) = image.dimensions();
        for (focal, k1) in [(0.84, 0.0), (0.84, -0.2), (0.6, 0.0), (1.5, 0.0)] {
            let f_px = focal * f64::from(width_px);
            let (cx_px, cy_px) = (0.5 * f64::from(width_px), 0.5 * f64::from(height_px));
            let intrinsics = Intrinsics { fx_px: f_px, fy_px: f_px, cx_px, cy_px, width_px, height_px };
            let distortion = Distortion { k1, ..Distortion::default() };
            let Ok(camera) = CameraModel::new(intrinsics, distortion) else { continue };
            count += 1;
            if search(camera, image.as_raw()).is_ok() {
                found.push(format!("{} at f = {f_px} px, k1 = {k1}", file.path().display()));
            }
        }
    }
    println!("{} of {count} searches found something: {found:#?}", found.len());
    assert!(count > 100, "{count} photographs in {}", data.display());
    assert!(found.is_empty(), "{found:#?}");
}

/// Follows dots of which nothing is known from frame to frame; their places, or `None` where one is lost.
fn followed(
    size: (u32, u32),
    light: bool,
    starts: &[[f64; 2]],
    frames: impl Iterator<Item = Vec<u8>>,
) -> Option<Vec<Vec<Vector2<f64>>>> {
    let (width_px, height_px) = size;
    let intrinsics = Intrinsics {
        fx_px: 500.0,
        fy_px: 500.0,
        cx_px: 0.5 * f64::from(width_px),
        cy_px: 0.5 * f64::from(height_px),
        width_px,
        height_px,
    };
    let camera = CameraModel::new(intrinsics, Distortion::default()).unwrap();
    let mut finder = DotFinder::of_any(camera, starts.len(), light);
    let mut found = Vec::new();
    let start = |(id, px): (u32, &[f64; 2])| PredictedPoint {
        id,
        px: Vector2::from(*px),
        covariance_px2: [16.0, 0.0, 16.0],
        area_px2: 200.0,
        slack_px: 12.0,
        threshold: 150,
    };
    let mut expected: Vec<_> = (0..).zip(starts).map(start).collect();
    let mut places = Vec::new();
    for pixels in frames {
        let view = ImageView::new(&pixels, width_px as usize, height_px as usize).unwrap();
        if !finder.track(&view, &expected, &mut found) || found.len() != starts.len() {
            return None;
        }
        for (dot, expected) in found.iter().zip(&mut expected) {
            assert_eq!(dot.id, expected.id);
            (expected.px, expected.covariance_px2, expected.area_px2) =
                (dot.px, dot.covariance_px2, dot.area_px2);
        }
        places.push(found.iter().map(|dot| dot.px).collect());
    }
    Some(places)
}

/// Four dots pass each other at a few pixels: each keeps its name.
#[test]
fn dots_of_no_known_target_keep_their_names() {
    let place = |id: usize, k: f64| match id {
        0 => [60.0 + 8.0 * k, 60.0],
        1 => [260.0 - 8.0 * k, 81.0],
        2 => [60.0 + 4.0 * k, 180.0 - 3.0 * k],
        _ => [250.0, 200.0 - 2.0 * k],
    };
    let image = |k: f64| {
        (0..320 * 240)
            .map(|i| {
                let (x, y) = (f64::from(i % 320), f64::from(i / 320));
                let nearest = (0..4).map(|id| (x - place(id, k)[0]).hypot(y - place(id, k)[1]));
                let d = nearest.fold(f64::INFINITY, f64::min) - 8.0;
                (130.0 - 90.0 * d.clamp(-1.0, 1.0)) as u8
            })
            .collect()
    };
    let starts: Vec<_> = (0..4).map(|id| place(id, 0.0)).collect();
    let frames = (0..24).map(|k| image(f64::from(k)));
    let places = followed((320, 240), true, &starts, frames).unwrap();
    for (k, dots) in places.iter().enumerate() {
        for (id, px) in dots.iter().enumerate() {
            let off = (px - Vector2::from(place(id, k as f64))).norm();
            assert!(off < 0.1, "dot {id} in frame {k}: {off} px");
        }
    }
    // one dot is not two
    let twice = [starts[0], [starts[0][0] + 5.0, starts[0][1]]];
    assert!(followed((320, 240), true, &twice, std::iter::once(image(0.0))).is_none());
}

/// A real sequence with motion blur and clutter, its four dots named clockwise from the upper left one.
#[test]
fn photographed_dots_are_followed_over_all_frames() {
    let folder = Path::new("../shared/data/visp-four-dots");
    if !folder.is_dir() {
        println!("skipped: no ../shared");
        return;
    }
    let frame = |n: u32| image::open(folder.join(format!("image.{n:04}.png"))).unwrap().into_luma8();
    let starts = [[85.0, 179.0], [216.0, 167.0], [243.0, 247.0], [93.0, 266.0]];
    let frames = (1..=30).map(|n| frame(n).into_raw());
    let places = followed(frame(1).dimensions(), true, &starts, frames).unwrap();
    assert_eq!(places.len(), 30);
    // the plate hardly turns: left stays left, and above above
    for dots in places {
        let [a, b, c, d] = dots[..] else { unreachable!() };
        assert!(b.x - a.x > 100.0 && c.x - d.x > 100.0 && d.y - a.y > 60.0 && c.y - b.y > 60.0);
    }
}
