//! Free shapes against an independent renderer: random views, tilted to 60 degrees, of any contrast and blur; clutter; anything.

#![allow(clippy::unwrap_used, clippy::print_stdout)]
#![allow(non_snake_case)]

use crate::supersampled::{Dice, Scene};
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::detect::shape::{ShapeFinder, ShapeMiss};
use vservo::detect::{Detection, PredictedPoint};
use vservo::imaging::ImageView;
use vservo::target::Shape;

const ARROW: [[f64; 2]; 7] = [
    [-0.05, -0.012],
    [0.01, -0.012],
    [0.01, -0.03],
    [0.05, 0.0],
    [0.01, 0.03],
    [0.01, 0.012],
    [-0.05, 0.012],
];
const PENTAGON: [[f64; 2]; 5] = [[0.0, 0.0], [0.08, -0.02], [0.12, 0.05], [0.06, 0.11], [-0.02, 0.07]];
const HEXAGON: [[f64; 2]; 6] =
    [[0.0, 0.0], [0.1, 0.0], [0.14, 0.05], [0.1, 0.12], [0.02, 0.11], [-0.03, 0.05]];
const L: [[f64; 2]; 6] =
    [[-0.04, -0.05], [0.03, -0.05], [0.03, -0.02], [-0.01, -0.02], [-0.01, 0.05], [-0.04, 0.05]];

fn corners(of: &[[f64; 2]]) -> Vec<Vector2<f64>> {
    of.iter().map(|c| Vector2::from(*c)).collect()
}

fn shape(of: &[[f64; 2]]) -> Shape {
    Shape::polygon(&corners(of), 0.03).unwrap()
}

fn camera(scene: &Scene) -> CameraModel {
    let i = Intrinsics {
        fx_px: scene.f_px,
        fy_px: scene.f_px,
        cx_px: scene.centre_px.x,
        cy_px: scene.centre_px.y,
        width_px: scene.width as u32,
        height_px: scene.height as u32,
    };
    CameraModel::new(i, Distortion { k1: scene.k1, ..Distortion::default() }).unwrap()
}

fn looking(tilt: f64, about: f64, roll: f64, place: Vector3<f64>) -> Isometry3<f64> {
    let axis = nalgebra::Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
    let R = Rotation3::from_axis_angle(&axis, tilt) * Rotation3::from_axis_angle(&Vector3::z_axis(), roll);
    Isometry3::from_parts(Translation3::from(place), UnitQuaternion::from_rotation_matrix(&R))
}

/// The shape in a random view, wholly in the image.
fn view(of: &[[f64; 2]], dice: &mut Dice, tilt: f64) -> Scene {
    loop {
        let z = dice.within(0.25, 0.9);
        let place = Vector3::new(dice.within(-0.35, 0.35) * z, dice.within(-0.25, 0.25) * z, z);
        let X_CO = looking(dice.within(0.0, tilt), dice.within(0.0, 6.3), dice.within(0.0, 6.3), place);
        let mut scene = Scene::of_four_dots(X_CO);
        scene.discs.clear();
        scene.outlines = vec![corners(of)];
        let plate = shape(of).plate();
        scene.plate_m = [plate.low_m, plate.high_m];
        scene.k1 = dice.within(-0.15, 0.1);
        let contrast = dice.within(40.0, 200.0);
        scene.dot_level = dice.within(10.0, 240.0 - contrast);
        scene.plate_level = scene.dot_level + contrast;
        scene.background_level = dice.within(20.0, 220.0);
        scene.blur_px = dice.within(0.5, 2.0);
        scene.noise_levels = 2.0;
        scene.seed = (dice.unit() * 1e9) as u64;
        let inside = scene.outlines[0].iter().all(|c| {
            let px = scene.project(c);
            px.x > 8.0 && px.y > 8.0 && px.x < 631.0 && px.y < 471.0
        });
        if inside {
            return scene;
        }
    }
}

#[derive(Default)]
struct Sums {
    views: f64,
    found: f64,
    points: f64,
    squares: f64,
    chi2: f64,
    greatest: f64,
}

fn campaign(of: &[[f64; 2]], views: u32, seed: u64, change: impl Fn(&mut Scene)) -> Sums {
    let mut dice = Dice(seed);
    let mut sums = Sums::default();
    for k in 0..views {
        let mut scene = view(of, &mut dice, 1.05);
        change(&mut scene);
        let pixels = scene.render();
        let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
        let mut finder = ShapeFinder::new(camera(&scene), &shape(of));
        let mut found = Vec::new();
        sums.views += 1.0;
        if let Err(why) = finder.search_or_why(&image, &mut found) {
            println!(
                "  view {k}: {why}; contrast {:.0}, blur {:.1}, z {:.2}",
                scene.plate_level - scene.dot_level,
                scene.blur_px,
                scene.X_CO.translation.z
            );
            save(k, &pixels, &scene);
            continue;
        }
        sums.found += 1.0;
        let mut chi = 0.0;
        for (point, (id, [xx, xy, yy])) in found.iter().zip(finder.covariances_px2()) {
            assert_eq!(point.id, *id);
            let off = point.px - scene.project(&scene.outlines[0][point.id as usize]);
            let C = nalgebra::Matrix2::new(*xx, *xy, *xy, *yy);
            sums.points += 1.0;
            sums.squares += off.norm_squared();
            sums.greatest = sums.greatest.max(off.norm());
            chi += 0.5 * off.dot(&(C.try_inverse().unwrap() * off));
        }
        sums.chi2 += chi;
        if std::env::var("SHAPE_VERBOSE").is_ok() {
            println!(
                "  view {k}: chi2 {:.2} blur {:.2}/{:.2} contrast {:.0} z {:.2} sigma {:.4}",
                chi / found.len() as f64,
                finder.blur_px().unwrap(),
                scene.blur_px,
                scene.plate_level - scene.dot_level,
                scene.X_CO.translation.z,
                found[0].sd_px
            );
        }
        assert_eq!(found.len(), of.len());
        assert!(sums.greatest < 3.0, "view {k}: a corner is off by {} px", sums.greatest);
    }
    sums
}

fn save(k: u32, pixels: &[u8], scene: &Scene) {
    if let Ok(folder) = std::env::var("SHAPE_MISSES") {
        let mut bytes = format!("P5 {} {} 255\n", scene.width, scene.height).into_bytes();
        bytes.extend_from_slice(pixels);
        let _ = std::fs::write(format!("{folder}/miss{k}.pgm"), bytes);
    }
}

#[test]
fn random_views_are_found_where_they_are() {
    for (name, of, seed) in [
        ("arrow", &ARROW[..], 7),
        ("L", &L[..], 8),
        ("pentagon", &PENTAGON[..], 9),
        ("hexagon", &HEXAGON[..], 10),
    ] {
        let s = campaign(of, 20, seed, |_| {});
        let (rms_px, chi2) = ((s.squares / s.points).sqrt(), s.chi2 / s.points);
        let (found, views) = (s.found, s.views);
        println!(
            "{name}: {found} of {views} found; {rms_px:.4} px, at most {:.3}, chi-square {chi2:.2}",
            s.greatest
        );
        assert!(found >= 0.95 * views, "{name}: {found} of {views}");
        assert!((0.7..1.4).contains(&chi2), "{name}: chi-square {chi2}");
    }
}

/// Small ovals, as letters have them, fit the sides of a pentagon or a hexagon, and not their corners.
#[test]
fn small_ovals_are_no_polygons() {
    let mut dice = Dice(12);
    for k in 0..150 {
        let mut scene = view(&HEXAGON, &mut dice, 1.0);
        let (radius_m, z) = (0.02, scene.X_CO.translation.z);
        // 7 to 18 px about the middle of the view
        let scale = dice.within(7.0, 18.0) * z / (600.0 * radius_m);
        scene.outlines.clear();
        scene.discs = vec![(Vector2::new(0.05, 0.06), radius_m * scale)];
        scene.plate_m = [Vector2::new(-0.2, -0.2), Vector2::new(0.3, 0.3)];
        let pixels = scene.render();
        for of in [&PENTAGON[..], &HEXAGON[..]] {
            assert!(search(&scene, &pixels, &shape(of)).is_err(), "view {k}");
        }
    }
}

fn image(of: &[[f64; 2]], X_CO: Isometry3<f64>) -> Scene {
    let mut scene = Scene::of_four_dots(X_CO);
    scene.discs.clear();
    scene.outlines = vec![corners(of)];
    let plate = shape(of).plate();
    scene.plate_m = [plate.low_m, plate.high_m];
    scene
}

fn search(scene: &Scene, pixels: &[u8], shape: &Shape) -> Result<Vec<Detection>, ShapeMiss> {
    let mut found = Vec::new();
    let image = ImageView::new(pixels, scene.width, scene.height).unwrap();
    ShapeFinder::new(camera(scene), shape).search_or_why(&image, &mut found).map(|()| found)
}

#[test]
fn what_is_seen_before_is_tracked_also_half_hidden() {
    let X_CO = looking(0.4, 1.0, 2.0, Vector3::new(0.02, -0.01, 0.4));
    let scene = image(&L, X_CO);
    let mut pixels = scene.render();
    let truth: Vec<_> = scene.outlines[0].iter().map(|c| scene.project(c)).collect();
    let expected: Vec<_> = (0..)
        .zip(&truth)
        .map(|(id, px)| PredictedPoint {
            id,
            px: px + Vector2::new(5.0, -4.0),
            covariance_px2: [0.0; 3],
            area_px2: 0.0,
            slack_px: 7.0,
            threshold: 100,
        })
        .collect();
    let mut finder = ShapeFinder::new(camera(&scene), &shape(&L));
    let mut found = Vec::new();
    // a band over a corner
    for hidden in [false, true] {
        if hidden {
            let (x, y) = (truth[1].x as usize, truth[1].y as usize);
            for row in y - 12..y + 12 {
                pixels[row * 640 + x - 12..row * 640 + x + 12].fill(90);
            }
        }
        let image = ImageView::new(&pixels, 640, 480).unwrap();
        assert!(finder.track(&image, &expected, &mut found));
        let worst = found.iter().map(|f| (f.px - truth[f.id as usize]).norm()).fold(0.0, f64::max);
        println!("hidden {hidden}: {worst:.4} px");
        assert!(found.len() == 6 && worst < if hidden { 0.25 } else { 0.12 }, "{worst}");
    }
    // somewhere else it is not
    let elsewhere: Vec<_> =
        expected.iter().map(|e| PredictedPoint { px: e.px + Vector2::new(90.0, 60.0), ..*e }).collect();
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    assert!(!finder.track(&image, &elsewhere, &mut found) && found.is_empty());
}

#[test]
fn light_on_dark_mirrored_two_and_others() {
    let X_CO = looking(0.3, 0.5, 1.0, Vector3::new(0.02, -0.01, 0.4));
    let scene = image(&L, X_CO);
    let pixels = scene.render();
    assert_eq!(search(&scene, &pixels, &shape(&L)).unwrap().len(), 6);
    assert!(search(&scene, &pixels, &shape(&ARROW)).is_err());
    let inverted: Vec<u8> = pixels.iter().map(|p| 255 - p).collect();
    assert!(search(&scene, &inverted, &shape(&L)).is_err());
    assert_eq!(search(&scene, &inverted, &shape(&L).light_on_dark(true)).unwrap().len(), 6);
    let mirrored = L.map(|[x, y]| [-x, y]);
    assert!(search(&scene, &pixels, &shape(&mirrored)).is_err());
    // twice the same in one image
    let mut two = image(&L, looking(0.0, 0.0, 0.0, Vector3::new(0.0, 0.0, 0.5)));
    two.outlines = [-0.1, 0.1].map(|x| corners(&L.map(|[a, b]| [a + x, b]))).into();
    two.plate_m = [Vector2::new(-0.2, -0.1), Vector2::new(0.2, 0.1)];
    assert_eq!(search(&two, &two.render(), &shape(&L)), Err(ShapeMiss::Several));
}

#[test]
fn clutter_is_no_shape() {
    let mut dice = Dice(5);
    for k in 0..6 {
        let mut scene = image(
            &L,
            looking(dice.within(0.0, 0.6), dice.within(0.0, 6.0), 0.3, Vector3::new(0.0, 0.0, 0.5)),
        );
        scene.texture = (40.0, dice.within(3.0, 30.0));
        // random polygons with as many corners
        scene.outlines = (0..12)
            .map(|i| {
                let middle = Vector2::new(f64::from(i % 4) - 1.5, f64::from(i / 4) - 1.0) * 0.09;
                let mut turns: Vec<f64> = (0..6).map(|_| dice.within(0.0, std::f64::consts::TAU)).collect();
                turns.sort_by(f64::total_cmp);
                let radii: Vec<f64> = turns.iter().map(|_| dice.within(0.012, 0.04)).collect();
                turns.iter().zip(radii).map(|(t, r)| middle + Vector2::new(t.cos(), t.sin()) * r).collect()
            })
            .collect();
        scene.plate_m = [Vector2::new(-0.2, -0.15), Vector2::new(0.2, 0.15)];
        let pixels = scene.render();
        for of in [shape(&L), shape(&ARROW)] {
            let found = search(&scene, &pixels, &of);
            assert!(found.is_err(), "{k}: {found:?}");
        }
    }
}

/// Many regions that are much like the shape: the search ends with a word, after a bounded number of fits.
#[test]
fn too_many_regions_are_given_up() {
    let (width, height) = (640, 480);
    let mut dice = Dice(19);
    let mut pixels = vec![210u8; width * height];
    // levels in between, so that many thresholds show other ones
    for cell in 0..16 * 12 {
        let (x0, y0, level) = (cell % 16 * 40 + 4, cell / 16 * 40 + 4, dice.within(10.0, 190.0) as u8);
        for i in 0..32 * 32 {
            let (x, y) = (i % 32, i / 32);
            // an L with a bite
            if (x < 12 || y < 13) && !(x > 22 && y < 4) && !(x < 5 && y > 26) {
                pixels[(y0 + y) * width + x0 + x] = level;
            }
        }
    }
    let scene = Scene { width, height, ..Scene::of_four_dots(Isometry3::identity()) };
    assert_eq!(search(&scene, &pixels, &shape(&L)).unwrap_err(), ShapeMiss::GivenUp);
}

#[test]
fn of_an_ellipse_the_centre_and_the_axes_are_told() {
    let mut scene = Scene::of_four_dots(looking(0.0, 0.0, 0.0, Vector3::new(0.013, -0.021, 0.5)));
    let (a, b) = (0.05, 0.03);
    scene.discs.clear();
    scene.outlines = vec![
        (0..400)
            .map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 400.0).sin_cos();
                Vector2::new(a * cos, b * sin)
            })
            .collect(),
    ];
    scene.plate_m = [Vector2::new(-0.08, -0.06), Vector2::new(0.08, 0.06)];
    let pixels = scene.render();
    let image = ImageView::new(&pixels, 640, 480).unwrap();
    let mut finder = ShapeFinder::new(camera(&scene), &Shape::ellipse([a, b], 0.0, 0.03).unwrap());
    let mut found = Vec::new();
    finder.search_or_why(&image, &mut found).unwrap();
    let centre = scene.project(&Vector2::zeros());
    assert!(found.len() == 1 && (found[0].px - centre).norm() < 0.02, "{found:?} {centre}");
    let seen = finder.ellipse().unwrap();
    println!("{seen:?} {}", found[0].sd_px);
    assert!((seen.semi_axes_px[0] - 60.0).abs() < 0.05 && (seen.semi_axes_px[1] - 36.0).abs() < 0.05);
    assert!(seen.turn_rad.abs() < 0.002);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn no_image_makes_the_finder_panic(
        width in 1u32..140, height in 1u32..120, seed in any::<u64>(), grain in 1usize..20, levels in 1u64..255
    ) {
        let mut dice = Dice(seed);
        let table: Vec<u8> = (0..4096).map(|_| (dice.unit() * (levels + 1) as f64) as u8).collect();
        let (w, h) = (width as usize, height as usize);
        let pixels: Vec<u8> = (0..w * h).map(|i| table[(i / w / grain * 64 + i % w / grain) % 4096]).collect();
        let i = Intrinsics { fx_px: 100.0, fy_px: 90.0, cx_px: 30.0, cy_px: 40.0, width_px: width, height_px: height };
        let camera = CameraModel::new(i, Distortion::default()).unwrap();
        let image = ImageView::new(&pixels, w, h).unwrap();
        for of in [shape(&L), shape(&ARROW).light_on_dark(true), Shape::ellipse([0.1, 0.05], 0.0, 0.01).unwrap()] {
            let mut finder = ShapeFinder::new(camera, &of);
            let mut found = Vec::new();
            if finder.search(&image, &mut found).is_err() {
                prop_assert!(found.is_empty());
            }
            let expected: Vec<_> = of.points().iter().map(|p| PredictedPoint {
                id: p.id,
                px: Vector2::new(dice.within(-50.0, 200.0), dice.within(-50.0, 200.0)),
                covariance_px2: [1.0; 3],
                area_px2: 10.0,
                slack_px: dice.within(0.0, 50.0),
                threshold: 100,
            }).collect();
            finder.track(&image, &expected, &mut found);
        }
        let other = ImageView::new(&[0], 1, 1).unwrap();
        let mut finder = ShapeFinder::new(camera, &shape(&L));
        if (w, h) != (1, 1) {
            prop_assert_eq!(finder.search_or_why(&other, &mut Vec::new()), Err(ShapeMiss::WrongSize));
        }
    }
}
