//! Coded grids of dots among other things, in images of a renderer that shares nothing with the project's own: how many of any views
//! are found. `VSERVO_CAMPAIGN=n` looks at `n` times as many, `VSERVO_SEED=n` at others.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::dots_truth::{camera, campaign};
use crate::supersampled::{Clutter, Dice, Scene};
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector2, Vector3};
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::detect::Finder;
use vservo::imaging::ImageView;
use vservo::rt::now;
use vservo::target::{DotGrid, Target};

/// Any view of a grid: tilt to 60 degrees, light, noise and blur of any kind.
fn any_grid(dice: &mut Dice, grid: &DotGrid, (low_px, high_px): (f64, f64)) -> Scene {
    let pitch_m = grid.pitch_m();
    let middle = Vector2::new((grid.columns() - 1) as f64, (grid.rows() - 1) as f64) * (0.5 * pitch_m);
    loop {
        let z = 600.0 * pitch_m / dice.within(low_px.ln(), high_px.ln()).exp();
        let tilt = dice.within(0.0, 60f64.to_radians());
        let axis = Unit::new_normalize({
            let (sin, cos) = dice.within(-3.2, 3.2).sin_cos();
            Vector3::new(cos, sin, 0.0)
        });
        let R = UnitQuaternion::from_axis_angle(&axis, tilt)
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), dice.within(-3.2, 3.2));
        let (x, y) = (dice.within(-0.4, 0.4) * z, dice.within(-0.3, 0.3) * z);
        let X_CO = Isometry3::from_parts(Translation3::new(x, y, z), R)
            * Translation3::new(-middle.x, -middle.y, 0.0);
        let plate = grid.plate();
        let mut scene = Scene {
            discs: grid.discs().iter().map(|disc| (disc.centre_m, disc.radius_m)).collect(),
            plate_m: [plate.low_m, plate.high_m],
            k1: if dice.unit() < 0.5 { 0.0 } else { -0.2 },
            ..Scene::of_four_dots(X_CO)
        };
        let flattest = scene.discs.iter().map(|(c, _)| {
            let ray = (scene.X_CO * Point3::new(c.x, c.y, 0.0)).coords.normalize();
            (scene.X_CO.rotation * Vector3::z()).dot(&ray)
        });
        if !scene.in_view(4.0) || flattest.fold(1.0, f64::min) < 60f64.to_radians().cos() {
            continue;
        }
        let contrast = dice.within(40.0, 200.0);
        scene.dot_level = dice.within(5.0, 250.0 - contrast);
        scene.plate_level = scene.dot_level + contrast;
        scene.background_level = dice.within(5.0, 250.0);
        scene.noise_levels = dice.within(0.0, 4.0);
        scene.blur_px = dice.within(0.3, 1.0);
        scene.vignetting = dice.within(0.0, 0.3);
        scene.gradient = (dice.within(1.0, 1.5), dice.within(-3.2, 3.2));
        scene.seed = (dice.unit() * 1e15) as u64;
        return scene;
    }
}

/// What lies around a grid: nothing, discs, a mottled ground.
#[derive(Debug, Clone, Copy)]
enum Around {
    Nothing,
    Discs(usize),
    /// So many discs of the sizes of the grid's own dots.
    OwnSizes(usize),
    Mottle(f64),
}

/// Shares of found views of one kind; a wrong number, or a dot off its place, is no share but the end.
fn grids_found(around: Around, seed: u64, count: usize, (low_px, high_px): (f64, f64)) -> usize {
    let mut dice = Dice(seed);
    let grid = DotGrid::with_pitch(7, 5, 0.02).unwrap();
    let target = Target::from(grid.clone());
    let (mut found, mut times_us) = (0, Vec::new());
    for k in 0..count {
        let mut scene = any_grid(&mut dice, &grid, (low_px, high_px));
        match around {
            Around::Nothing => {}
            Around::Discs(n) => {
                scene.clutter = Clutter::discs(&mut dice, n, (3.0, 9.0), [scene.width, scene.height])
            }
            Around::OwnSizes(n) => {
                let pitch_px = 600.0 * grid.pitch_m() / scene.X_CO.translation.z;
                let radii = (DotGrid::RADIUS * pitch_px, DotGrid::LARGE_RADIUS * pitch_px);
                scene.clutter = Clutter::discs(&mut dice, n, radii, [scene.width, scene.height])
            }
            Around::Mottle(share) => {
                let grain_px = dice.within(2.0, 5.0);
                scene.clutter = Clutter::mottle(&mut dice, share, grain_px);
            }
        }
        if !scene.clutter.is_empty() {
            scene.background_level = dice.within(120.0, 250.0);
            scene.clutter.level = dice.within(5.0, 80.0);
        }
        let pixels = scene.render();
        let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
        let mut finder = Finder::new(camera(&scene), &target);
        let mut dots = Vec::new();
        let result = finder.search(&image, &mut dots);
        let start = now();
        assert_eq!(finder.search(&image, &mut dots), result);
        times_us.push((now() - start).0 / 1000);
        let truth = scene.truth();
        for dot in &dots {
            let error = dot.px - finder.bias_px(dot.id, &scene.X_CO) - truth[dot.id as usize];
            assert!(error.norm() < 2.0, "{around:?}, view {k}: dot {} off by {error}", dot.id);
        }
        found += usize::from(dots.len() >= grid.min_to_find());
        if dots.len() < grid.min_to_find() {
            println!("missed: view {k}, {result:?}, {:?}", scene.X_CO);
        }
    }
    times_us.sort_unstable();
    println!(
        "{around:?}, pitch {low_px} to {high_px} px: {found} of {count}, search {} us p50, {} max",
        times_us[count / 2],
        times_us[count - 1]
    );
    found
}

/// 295 of 300 above a pitch of 11 px, whatever lies around; of few views one may be missed. What is tuned was tuned on the seeds 100 to 153.
#[test]
fn grids_are_found_whatever_lies_around() {
    let seed = std::env::var("VSERVO_SEED").ok().and_then(|n| n.parse().ok()).unwrap_or(7000);
    let count = 8 * campaign();
    let around =
        [Around::Nothing, Around::Discs(40), Around::Discs(200), Around::OwnSizes(200), Around::Mottle(0.05)];
    let found = (seed..).zip(around).map(|(seed, around)| grids_found(around, seed, count, (11.0, 60.0)));
    let (found, all) = (found.sum::<usize>(), around.len() * count);
    assert!(all - found <= (5 * all / 300).max(1), "{found} of {all}");
}

/// Discs in disorder, and in order with sizes drawn by dice: neither is the grid.
#[test]
fn dots_that_are_no_grid_are_none() {
    let mut dice = Dice(7100);
    let target = Target::from(DotGrid::with_pitch(7, 5, 0.02).unwrap());
    let mut times_us = Vec::new();
    for k in 0..16 * campaign() {
        let mut scene = Scene::of_four_dots(Isometry3::translation(0.0, 0.0, 0.5));
        (scene.width, scene.height) = (640, 480);
        scene.discs.clear();
        scene.plate_m = [Vector2::new(9.0, 9.0), Vector2::new(9.1, 9.1)];
        scene.background_level = dice.within(150.0, 250.0);
        scene.clutter = if k % 2 == 0 {
            let count = dice.within(30.0, 600.0) as usize;
            Clutter::discs(&mut dice, count, (2.0, 12.0), [scene.width, scene.height])
        } else {
            let pitch = dice.within(15.0, 50.0);
            let radii = [DotGrid::RADIUS * pitch, DotGrid::LARGE_RADIUS * pitch];
            Clutter::lattice(&mut dice, pitch, radii, [scene.width, scene.height])
        };
        scene.clutter.level = dice.within(5.0, 100.0);
        scene.seed = k as u64;
        let pixels = scene.render();
        let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
        let mut finder = Finder::new(camera(&scene), &target);
        let mut dots = Vec::new();
        let start = now();
        let result = finder.search(&image, &mut dots);
        times_us.push((now() - start).0 / 1000);
        assert!(result.is_err() && dots.is_empty(), "image {k}: {} dots", dots.len());
    }
    times_us.sort_unstable();
    println!("no grid: search {} us p50, {} max", times_us[times_us.len() / 2], times_us[times_us.len() - 1]);
}

/// Photographs, of which none shows this grid: chessboards, tags, other dots, things.
#[test]
fn photographs_hold_no_coded_grid() {
    let Ok(sets) = std::path::Path::new("../shared/data").read_dir() else {
        println!("skipped: no ../shared");
        return;
    };
    let target = Target::from(DotGrid::with_pitch(7, 5, 0.02).unwrap());
    let files = sets.flatten().filter_map(|set| set.path().read_dir().ok()).flatten().flatten();
    let (mut count, mut longest_us) = (0, 0);
    for file in files {
        let Ok(image) = image::open(file.path()) else { continue };
        let image = image.into_luma8();
        let (width_px, height_px) = image.dimensions();
        let (f_px, cx_px, cy_px) =
            (f64::from(width_px), 0.5 * f64::from(width_px), 0.5 * f64::from(height_px));
        let intrinsics = Intrinsics { fx_px: f_px, fy_px: f_px, cx_px, cy_px, width_px, height_px };
        let camera = CameraModel::new(intrinsics, Distortion::default()).unwrap();
        let view = ImageView::new(image.as_raw(), width_px as usize, height_px as usize).unwrap();
        let start = now();
        let result = Finder::new(camera, &target).search(&view, &mut Vec::new());
        longest_us = longest_us.max((now() - start).0 / 1000);
        assert!(result.is_err(), "{}", file.path().display());
        count += 1;
    }
    println!("{count} photographs, the longest search {longest_us} us");
    assert!(count > 80, "{count} photographs");
}
