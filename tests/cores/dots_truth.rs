//! Dots against images of a renderer that shares nothing with the project's own: how many views are found, how true centres are, and
//! whether stated deviations are honest. `VSERVO_CAMPAIGN=n` looks at `n` times as many views.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::supersampled::{Dice, Scene};
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, Unit, UnitQuaternion, Vector3, Vector6};
use std::collections::BTreeMap;
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::detect::{Detection, DotFinder, Finder, PredictedPoint};
use vservo::imaging::ImageView;
use vservo::messages::{FrameHeader, TargetStatus, measurement_flag};
use vservo::rt::now;
use vservo::target::{FourDots, Target};
use vservo::time::MonoNs;
use vservo::vision::{Frame, Prior, Vision, VisionSettings};

/// How many times as many views as by default.
pub(crate) fn campaign() -> usize {
    std::env::var("VSERVO_CAMPAIGN").ok().and_then(|n| n.parse().ok()).unwrap_or(1)
}

pub(crate) fn camera(scene: &Scene) -> CameraModel {
    let intrinsics = Intrinsics {
        fx_px: scene.f_px,
        fy_px: scene.f_px,
        cx_px: scene.centre_px.x,
        cy_px: scene.centre_px.y,
        width_px: scene.width as u32,
        height_px: scene.height as u32,
    };
    CameraModel::new(intrinsics, Distortion { k1: scene.k1, ..Distortion::default() }).unwrap()
}

/// The square's middle at a place given in widths of view, of dots of `radius` px, tilted, turned.
fn pose(dice: &mut Dice, radius: f64, tilt: f64, away: f64) -> Isometry3<f64> {
    let z = 600.0 * 0.01 / radius;
    let about = dice.within(-3.2, 3.2);
    let axis = Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
    let R = UnitQuaternion::from_axis_angle(&axis, tilt)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), dice.within(-3.2, 3.2));
    let (x, y) = (dice.within(-away, away) * z, dice.within(-0.75 * away, 0.75 * away) * z);
    Isometry3::from_parts(Translation3::new(x, y, z), R) * Translation3::new(-0.05, -0.05, 0.0)
}

/// Any view: radius 4 to 56 px, tilt to 70 degrees, contrast 40 to 200, backgrounds of any level, plain and textured.
fn any_view(dice: &mut Dice) -> Scene {
    loop {
        let radius = dice.within(4f64.ln(), 37f64.ln()).exp();
        let tilt = dice.within(0.0, 70f64.to_radians());
        let mut scene = Scene::of_four_dots(pose(dice, radius, tilt, 0.5));
        scene.k1 = if dice.unit() < 0.5 { 0.0 } else { -0.2 };
        let flattest = scene.discs.iter().map(|(c, _)| {
            let ray = (scene.X_CO * Point3::new(c.x, c.y, 0.0)).coords.normalize();
            (scene.X_CO.rotation * Vector3::z()).dot(&ray)
        });
        if !scene.in_view(2.0) || flattest.fold(1.0, f64::min) < 70f64.to_radians().cos() {
            continue;
        }
        let contrast = dice.within(40.0, 200.0);
        scene.dot_level = dice.within(5.0, 250.0 - contrast);
        scene.plate_level = scene.dot_level + contrast;
        scene.background_level = dice.within(5.0, 250.0);
        scene.noise_levels = dice.within(0.0, 4.0);
        scene.blur_px = dice.within(0.3, 1.2);
        scene.vignetting = dice.within(0.0, 0.3);
        scene.gradient = (dice.within(1.0, 1.5), dice.within(-3.2, 3.2));
        if dice.unit() < 0.3 {
            scene.texture = (dice.within(5.0, 60.0), dice.within(1.5, 20.0));
        }
        scene.seed = (dice.unit() * 1e15) as u64;
        return scene;
    }
}

fn expected(dots: &[Detection]) -> Vec<PredictedPoint> {
    let expected = |dot: &Detection| PredictedPoint {
        id: dot.id,
        px: dot.px,
        covariance_px2: dot.covariance_px2,
        area_px2: dot.area_px2,
        slack_px: 3.0,
        threshold: (0.5 * (dot.dark_level + dot.plate_level)).clamp(0.0, 255.0) as u8,
    };
    dots.iter().map(expected).collect()
}

#[test]
fn any_view_is_found_and_tracking_agrees() {
    let mut dice = Dice(11);
    let target = Target::from(FourDots::default());
    let (count, mut found) = (100 * campaign(), 0);
    let mut misses: BTreeMap<String, usize> = BTreeMap::new();
    let (mut square, mut dots, mut greatest) = (0.0, 0.0, 0.0f64);
    let mut times_us = Vec::new();
    for k in 0..count {
        let scene = any_view(&mut dice);
        let pixels = scene.render();
        let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
        let mut finder = Finder::new(camera(&scene), &target);
        let (mut searched, mut tracked) = (Vec::new(), Vec::new());
        // the second search is timed: the first touches the finder's memory
        let result = finder.search(&image, &mut searched);
        let start = now();
        assert_eq!(finder.search(&image, &mut searched), result);
        times_us.push((now() - start).0 / 1000);
        if let Err(status) = result {
            *misses.entry(format!("{status:?}")).or_default() += 1;
            let clear = scene.plate_level - scene.dot_level > 80.0 || scene.noise_levels < 2.0;
            assert!(status != TargetStatus::NoContrast || !clear, "there is contrast in view {k}");
            continue;
        }
        found += 1;
        for (dot, truth) in searched.iter().zip(scene.truth()) {
            let error = dot.px - finder.bias_px(dot.id, &scene.X_CO) - truth;
            assert!(error.norm() < 2.0, "view {k}: dot {} off by {error}", dot.id);
        }
        assert!(finder.track(&image, &expected(&searched), &mut tracked), "view {k}");
        for (a, b) in searched.iter().zip(&tracked) {
            square += (a.px - b.px).norm_squared();
            greatest = greatest.max((a.px - b.px).norm());
            dots += 1.0;
        }
    }
    let apart = f64::sqrt(square / dots);
    times_us.sort_unstable();
    let [p50, p90, p99] = [50, 90, 99].map(|percent| times_us[count * percent / 100]);
    println!("search {p50} us p50, {p90} p90, {p99} p99");
    println!(
        "{found} of {count} found, misses {misses:?}; tracking off by {apart:.5} px rms, {greatest:.4} at most"
    );
    assert!(found * 200 >= count * 197, "{found} of {count}: {misses:?}");
    assert!(apart < 0.005 && greatest < 0.05, "{apart} {greatest}");
}

/// Conditions of images.
#[derive(Debug, Clone, Copy)]
struct Cell {
    radius: f64,
    contrast: f64,
    noise: f64,
    blur: f64,
    vignetting: f64,
    gradient: f64,
}

impl Cell {
    /// Other views and other noise in every cell.
    fn seed(&self) -> u64 {
        let numbers = [self.radius, self.contrast, self.noise, self.blur, self.vignetting, self.gradient];
        numbers
            .iter()
            .fold(1, |seed, x| (seed ^ x.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29))
    }
}

/// Root mean square of coordinates' errors, px; mean squared errors over what is stated, of features and of poses.
fn look(cell: &Cell, count: usize, seed: u64) -> (f64, f64, f64) {
    let mut dice = Dice(seed);
    let (mut square, mut normalized, mut n) = (0.0, 0.0, 0.0);
    let (mut poses, mut pose_count) = (0.0, 0.0);
    for _ in 0..count {
        let mut scene = loop {
            let tilt = dice.within(0.3, 0.8);
            let scene = Scene::of_four_dots(pose(&mut dice, cell.radius, tilt, 0.3));
            if scene.in_view(6.0 + 2.0 * cell.blur) {
                break scene;
            }
        };
        scene.plate_level = scene.dot_level + cell.contrast;
        // where light fades the brightest part is bright
        let bright = if cell.gradient > 2.0 { 1.25 } else { 1.0 };
        (scene.plate_level, scene.dot_level) = (scene.plate_level * bright, scene.dot_level * bright);
        (scene.noise_levels, scene.blur_px, scene.vignetting) = (cell.noise, cell.blur, cell.vignetting);
        scene.gradient = (cell.gradient, dice.within(-3.2, 3.2));
        scene.seed = (dice.unit() * 1e15) as u64;
        let pixels = scene.render();
        let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
        let camera = camera(&scene);
        let mut finder = Finder::new(camera, &FourDots::default().into());
        let mut dots = Vec::new();
        assert_eq!(finder.search(&image, &mut dots), Ok(()), "{cell:?}");
        for (dot, truth) in dots.iter().zip(scene.truth()) {
            let error = dot.px - finder.bias_px(dot.id, &scene.X_CO) - truth;
            square += error.norm_squared() / 2.0;
            normalized += error.norm_squared() / 2.0 / dot.sd_px.powi(2);
            n += 1.0;
        }
        let settings = VisionSettings { track: false, ..VisionSettings::default() };
        let mut vision = Vision::new(camera, FourDots::default(), settings);
        let header = FrameHeader { frame_id: 1, exposure: MonoNs(1), ..FrameHeader::default() };
        let m = vision.process(&Frame { header, image }, &Prior::default());
        if let Some(got) = m.pose().filter(|_| m.flags & measurement_flag::AMBIGUOUS == 0) {
            let v = got.translation.vector - scene.X_CO.translation.vector;
            let w = (got.rotation * scene.X_CO.rotation.inverse()).scaled_axis();
            let e = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
            let P = Matrix6::from_row_slice(&m.pose_covariance);
            poses += e.dot(&(P.try_inverse().unwrap() * e)) / 6.0;
            pose_count += 1.0;
        }
    }
    (f64::sqrt(square / n), normalized / n, poses / pose_count)
}

#[test]
fn centres_are_true_in_any_light() {
    let count = 6 * campaign();
    for noise in [2.0, 0.0] {
        for (vignetting, gradient) in [(0.0, 1.0), (0.1, 1.0), (0.3, 1.0), (0.0, 3.0)] {
            for (radius, limit) in [(5.0, 0.010), (10.0, 0.007), (25.0, 0.005)] {
                let cell = Cell { radius, contrast: 160.0, noise, blur: 0.5, vignetting, gradient };
                let (rms, normalized, _) = look(&cell, count, cell.seed());
                println!("{cell:?}: {rms:.4} px rms, {normalized:.2} of the stated variance");
                let limit = if noise > 0.0 { limit } else { 0.003 };
                assert!(rms < limit, "{cell:?}: {rms} px");
            }
        }
    }
}

/// Squared errors over what is stated are 0.8 to 1.25 in every cell, as far as chance lets few views tell; and 1 over all cells.
#[test]
fn stated_deviations_are_honest() {
    let count = 8 * campaign();
    // four deviations of a mean of squares, of eight coordinates a view
    let chance = 4.0 * (2.0 / (8.0 * count as f64)).sqrt();
    let (mut sum, mut cells) = (0.0, 0.0);
    for contrast in [50.0, 160.0] {
        for noise in [1.0, 3.0] {
            for blur in [0.3, 0.4, 0.8, 1.5] {
                for radius in [5.0, 10.0, 25.0] {
                    let cell = Cell { radius, contrast, noise, blur, vignetting: 0.1, gradient: 1.2 };
                    let (rms, features, poses) = look(&cell, count, cell.seed());
                    println!(
                        "{cell:?}: {rms:.4} px rms, squared over stated: {features:.2}, pose {poses:.2}"
                    );
                    let honest = 0.8 * (1.0 - chance)..1.25 * (1.0 + chance);
                    assert!(honest.contains(&features), "{cell:?}: {features}");
                    sum += features;
                    cells += 1.0;
                }
            }
        }
    }
    let mean: f64 = sum / cells;
    println!("mean over {cells} cells: {mean:.3}");
    assert!((0.9..1.1).contains(&mean), "{mean}");
}

/// A plate that is lighter than levels go shows no noise and no light, and the rims have both all the same: up to 85 levels are cut off.
#[test]
fn deviations_on_clipped_plates_are_honest() {
    let count = 16 * campaign();
    let chance = 4.0 * (2.0 / (8.0 * count as f64)).sqrt();
    let (mut sum, mut cells) = (0.0, 0.0);
    for contrast in [219.0, 228.0, 240.0, 255.0, 285.0, 310.0] {
        for (noise, radius, blur, gradient) in
            [(1.5, 20.0, 0.8, 1.0), (3.0, 9.0, 0.8, 1.0), (1.5, 14.0, 0.6, 1.0), (2.0, 17.0, 1.0, 1.3)]
        {
            let cell = Cell { radius, contrast, noise, blur, vignetting: 0.0, gradient };
            let (rms, features, _) = look(&cell, count, cell.seed());
            println!("{cell:?}: {rms:.4} px rms, squared over stated: {features:.2}");
            let honest = 0.8 * (1.0 - chance)..1.25 * (1.0 + chance);
            assert!(honest.contains(&features), "{cell:?}: {features}");
            assert!(rms < 0.008, "{cell:?}: {rms} px");
            sum += features;
            cells += 1.0;
        }
    }
    let mean: f64 = sum / cells;
    println!("mean over {cells} cells: {mean:.3}");
    assert!((0.8..1.25).contains(&mean), "{mean}");
}

/// Light dots on a dark plate are found by who looks for them, as well as dark ones; glare on a dot does not hide it.
#[test]
fn light_dots_and_glare() {
    let mut dice = Dice(5);
    for k in 0..12 {
        let (radius, tilt) = (dice.within(8.0, 25.0), dice.within(0.0, 0.8));
        let mut scene = loop {
            let scene = Scene::of_four_dots(pose(&mut dice, radius, tilt, 0.3));
            if scene.in_view(8.0) {
                break scene;
            }
        };
        scene.vignetting = 0.1;
        let camera = camera(&scene);
        let target = Target::from(FourDots::default());
        let mut dots = Vec::new();
        let error = |finder: &DotFinder, scene: &Scene, dots: &[Detection]| {
            let errors = dots
                .iter()
                .zip(scene.truth())
                .map(|(dot, truth)| (dot.px - finder.bias_px(dot.id, &scene.X_CO) - truth).norm());
            errors.fold(0.0, f64::max)
        };

        (scene.dot_level, scene.plate_level, scene.background_level) = (200.0, 40.0, 120.0);
        let pixels = scene.render();
        let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
        let mut finder = DotFinder::new(camera, &target, true);
        assert_eq!(finder.search(&image, &mut dots), Ok(()), "view {k}");
        assert!(error(&finder, &scene, &dots) < 0.03, "view {k}: {}", error(&finder, &scene, &dots));
        assert!(finder.track(&image, &expected(&dots), &mut Vec::new()), "view {k}");
        let status = DotFinder::new(camera, &target, false).search(&image, &mut dots);
        assert!(matches!(status, Err(TargetStatus::TooFewRegions | TargetStatus::NoMatch)), "{status:?}");

        (scene.dot_level, scene.plate_level) = (30.0, 190.0);
        let mut pixels = scene.render();
        let at = scene.truth()[k % 4];
        for (i, p) in pixels.iter_mut().enumerate() {
            let (x, y) = ((i % scene.width) as f64, (i / scene.width) as f64);
            if (x - at.x).hypot(y - at.y) < 0.25 * radius * tilt.cos() {
                *p = 250;
            }
        }
        let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
        let mut finder = DotFinder::new(camera, &target, false);
        assert_eq!(finder.search(&image, &mut dots), Ok(()), "glare in view {k}");
        assert!(error(&finder, &scene, &dots) < 0.1, "glare in view {k}: {}", error(&finder, &scene, &dots));
    }
}
