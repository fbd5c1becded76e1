//! Scenes in layers against rays: each pixel as the mean over many places in it, each computed from the definition of the scene.

use crate::camera_model::{CameraModel, Distortion, Intrinsics};
use crate::geometry::{Pose, rotation_x, rotation_y, rotation_z};
use crate::scene::{Backdrop, Bystander, Occluder, Renderer, SceneLook, SensorModel};
use crate::target::{Chessboard, FourDots, Mark, Plate, Shape, TagFamily, Tags, Target};
use crate::time::SpanNs;
use nalgebra::{Rotation2, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};

const WIDTH: usize = 80;
const HEIGHT: usize = 60;
/// Places along the side of a pixel.
const RAYS: u32 = 24;

fn camera(bent: bool) -> CameraModel {
    let distortion = if bent {
        Distortion { k1: -0.25, k2: 0.03, p1: 0.002, p2: -0.001, k3: 0.0 }
    } else {
        Distortion::default()
    };
    let (width_px, height_px) = (WIDTH as u32, HEIGHT as u32);
    let intrinsics = Intrinsics { fx_px: 75.0, fy_px: 74.0, cx_px: 39.0, cy_px: 30.2, width_px, height_px };
    CameraModel::new(intrinsics, distortion).unwrap()
}

/// The middle of a plate at `(x, y, z)`, turned.
fn pose(plate: &Plate, R: Rotation3<f64>, [x, y, z]: [f64; 3]) -> Pose {
    let middle = (plate.low_m + plate.high_m) / 2.0;
    Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_rotation_matrix(&R))
        * Translation3::new(-middle.x, -middle.y, 0.0)
}

fn within(r: &Vector2<f64>, low: &Vector2<f64>, high: &Vector2<f64>) -> bool {
    r.x > low.x && r.x < high.x && r.y > low.y && r.y < high.y
}

fn covers(mark: &Mark, r: &Vector2<f64>) -> bool {
    match mark {
        Mark::Disc(disc) => (r - disc.centre_m).norm() < disc.radius_m,
        Mark::Ellipse { centre_m, semi_axes_m: [a, b], turn_rad } => {
            let own = Rotation2::new(-turn_rad) * (r - centre_m);
            (own.x / a).powi(2) + (own.y / b).powi(2) < 1.0
        }
        Mark::Polygon(loops) => {
            let sides = loops.iter().flat_map(|l| l.iter().zip(l.iter().cycle().skip(1)));
            let crossed = sides.filter(|(a, b)| {
                (a.y > r.y) != (b.y > r.y) && r.x < a.x + (b.x - a.x) * (r.y - a.y) / (b.y - a.y)
            });
            crossed.count() % 2 == 1
        }
    }
}

/// What of a target is seen at a place in its plane.
fn shown(target: &Target, marks: &[Mark], front: bool, r: &Vector2<f64>) -> Option<f64> {
    let (plate, look) = (target.plate(), SceneLook::default());
    let (light, dark) = if plate.light { (look.plate, look.dots) } else { (look.dots, look.plate) };
    within(r, &plate.low_m, &plate.high_m)
        .then(|| if front && marks.iter().any(|mark| covers(mark, r)) { dark } else { light })
}

struct LayeredScene {
    target: Target,
    bystanders: Vec<Bystander>,
    occluders: Vec<Occluder>,
}

fn brute_force(camera: &CameraModel, scene: &LayeredScene, X_CO: &Pose) -> Vec<f64> {
    let X_OC = X_CO.inverse();
    let origin = X_OC.translation.vector;
    let front = origin.z < 0.0;
    let marks = scene.target.marks();
    let others: Vec<_> = scene.bystanders.iter().map(|b| (b, b.target.marks())).collect();
    let level = |u: f64, v: f64| {
        let s = camera.normalized_of(&Vector2::new(u, v));
        let d = X_OC.rotation * Vector3::new(s.x, s.y, 1.0);
        for occluder in scene.occluders.iter().rev() {
            let t = (-occluder.height_m - origin.z) / d.z;
            let r = (origin + d * t).xy();
            let half = occluder.size_m / 2.0;
            if t > 0.0 && within(&r, &(occluder.centre_m - half), &(occluder.centre_m + half)) {
                return occluder.level;
            }
        }
        let t = -origin.z / d.z;
        if t <= 0.0 {
            return SceneLook::default().background;
        }
        let r = (origin + d * t).xy();
        if let Some(level) = shown(&scene.target, &marks, front, &r) {
            return level;
        }
        for (bystander, marks) in others.iter().rev() {
            let own = Rotation2::new(-bystander.turn_rad) * (r - bystander.position_m);
            if let Some(level) = shown(&bystander.target, marks, front, &own) {
                return level;
            }
        }
        SceneLook::default().background
    };
    let mut out = Vec::new();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            // far from all edges every place is the same
            let few = (0..16).map(|i| {
                level(x as f64 + f64::from(i % 4) / 3.0 - 0.5, y as f64 + f64::from(i / 4) / 3.0 - 0.5)
            });
            let (low, high) = few.fold((f64::INFINITY, 0.0f64), |(low, high), l| (low.min(l), high.max(l)));
            if low == high {
                out.push(low);
                continue;
            }
            let mut sum = 0.0;
            for i in 0..RAYS * RAYS {
                let (a, b) = (i % RAYS, i / RAYS);
                // in each cell at another place, so that no edge runs along the cells
                let of = |a: u32, b: u32| {
                    (f64::from(a) + (0.618_034 * f64::from(b) + 0.3).fract()) / f64::from(RAYS) - 0.5
                };
                sum += level(x as f64 + of(a, b), y as f64 + of(b, a));
            }
            out.push(sum / f64::from(RAYS * RAYS));
        }
    }
    out
}

/// The greatest difference, grey levels, and how many pixels differ by more than 2.
fn compare(bent: bool, scene: &LayeredScene, X_CO: &Pose) -> (f64, usize) {
    let camera = camera(bent);
    let mut renderer =
        Renderer::new(camera, scene.target.clone(), SceneLook::default(), SensorModel::ideal())
            .unwrap()
            .with_bystanders(&scene.bystanders);
    renderer.occlude(scene.occluders.iter().copied());
    let mut image = vec![0u8; WIDTH * HEIGHT];
    renderer.render(&[*X_CO], 0, &mut image);
    let wanted = brute_force(&camera, scene, X_CO);
    let errors = image.iter().zip(&wanted).map(|(got, want)| (f64::from(*got) - want).abs());
    (errors.clone().fold(0.0, f64::max), errors.filter(|e| *e > 2.0).count())
}

fn targets() -> Vec<Target> {
    let flag = [[0.0, 0.0], [0.1, 0.01], [0.06, 0.04], [0.09, 0.08], [0.0, 0.05]].map(Vector2::from);
    vec![
        Chessboard::with_squares(6, 4, 0.02).unwrap().into(),
        Tags::one(TagFamily::Tag36h11, 0.1, 3).unwrap().into(),
        Tags::grid(TagFamily::Tag16h5, 0.04, (2, 2), 0.06, 5).unwrap().into(),
        Shape::polygon(&flag, 0.02).unwrap().into(),
        Shape::ellipse([0.05, 0.025], 0.6, 0.02).unwrap().into(),
    ]
}

#[test]
fn every_pixel_of_every_target_is_right() {
    for target in targets() {
        for (bent, R, place) in [
            (false, rotation_z(0.4) * rotation_x(0.6), [0.01, 0.0, 0.2]),
            (true, rotation_z(2.4) * rotation_y(-0.8), [0.0, 0.02, 0.17]),
            // partly out of view, and beside the camera
            (true, rotation_z(0.02), [0.06, -0.05, 0.12]),
            (false, rotation_x(1.3), [0.0, 0.02, 0.05]),
            // from behind
            (true, rotation_y(2.9), [0.0, 0.0, 0.2]),
        ] {
            let X_CO = pose(&target.plate(), R, place);
            let scene = LayeredScene { target: target.clone(), bystanders: vec![], occluders: vec![] };
            let (greatest, off) = compare(bent, &scene, &X_CO);
            // rays are off by up to one of their 24 along an edge, 3.3 levels at a contrast of 190, and half a level is rounding
            assert!(greatest < 4.5 && off < 60, "{greatest}, {off}: {target:?} {bent} {X_CO}");
        }
    }
}

#[test]
fn what_lies_beside_and_before_the_target_is_right() {
    let sheet = |x: f64, y: f64, height_m: f64, level: f64| Occluder {
        centre_m: Vector2::new(x, y),
        size_m: Vector2::new(0.05, 0.03),
        height_m,
        level,
        from: SpanNs::ZERO,
        until: SpanNs(1),
    };
    let bystander = |target: Target, x: f64, y: f64, turn_rad: f64| Bystander {
        target,
        position_m: Vector2::new(x, y),
        turn_rad,
    };
    let board = || Target::from(Chessboard::with_squares(4, 3, 0.02).unwrap());
    let tag = || Target::from(Tags::one(TagFamily::Tag16h5, 0.05, 1).unwrap());
    let light_dots = FourDots::default().light_on_dark(true);
    for target in [board(), light_dots.into(), tag()] {
        let scene = LayeredScene {
            bystanders: vec![bystander(tag(), 0.14, 0.02, 0.3), bystander(board(), -0.05, 0.12, -0.6)],
            occluders: vec![sheet(0.03, 0.03, 0.02, 140.0), sheet(0.05, 0.02, 0.04, 60.0)],
            target,
        };
        for bent in [false, true] {
            let X_CO = pose(&scene.target.plate(), rotation_z(0.3) * rotation_x(0.4), [-0.02, 0.0, 0.25]);
            let (greatest, off) = compare(bent, &scene, &X_CO);
            // where two layers meet within a pixel it is their mixture: where a sheet's edge crosses the plate's
            assert!(greatest < 60.0 && off < 80, "{greatest}, {off}");
        }
    }
}

#[test]
fn dots_are_the_same_by_both_ways() {
    let scene =
        |bystanders| LayeredScene { target: FourDots::default().into(), bystanders, occluders: vec![] };
    // far out of view: the scene is drawn in layers
    let far =
        Bystander { target: FourDots::default().into(), position_m: Vector2::new(50.0, 0.0), turn_rad: 0.0 };
    for bent in [false, true] {
        let X_CO = pose(&FourDots::default().plate(), rotation_z(0.4) * rotation_x(0.6), [0.01, 0.0, 0.3]);
        let camera = camera(bent);
        let images = [vec![], vec![far.clone()]].map(|bystanders| {
            let scene = scene(bystanders);
            let sensor = SensorModel { blur_sd_px: 0.6, ..SensorModel::ideal() };
            let mut renderer = Renderer::new(camera, scene.target, SceneLook::default(), sensor)
                .unwrap()
                .with_bystanders(&scene.bystanders);
            let mut image = vec![0u8; WIDTH * HEIGHT];
            renderer.render(&[X_CO, X_CO], 0, &mut image);
            image
        });
        let [dots, layers] = &images;
        let errors = dots.iter().zip(layers).map(|(a, b)| a.abs_diff(*b));
        // small dots of 2 px under this blur: `SceneView` approximates the blur of a bent edge by that of a straight one
        assert!(errors.clone().max().unwrap() < 12, "{:?}", errors.max());
    }
}

#[test]
fn backdrops_fill_the_background_alone_or_are_refused() {
    let board = Chessboard::with_squares(6, 4, 0.02).unwrap();
    let X_CO = pose(&board.plate(), rotation_z(0.4) * rotation_x(0.6), [0.0, 0.0, 0.25]);
    let image = |backdrop: Backdrop| {
        let mut renderer =
            Renderer::new(camera(true), board.clone(), SceneLook::default(), SensorModel::ideal())
                .unwrap()
                .with_backdrop(backdrop)
                .unwrap();
        let mut image = vec![0u8; WIDTH * HEIGHT];
        renderer.render(&[X_CO], 0, &mut image);
        image
    };
    let backdrop = Backdrop { texture_levels: 60.0, clutter: 30, seed: 3, ..Backdrop::default() };
    let (plain, one, two) = (image(Backdrop::default()), image(backdrop), image(backdrop));
    assert_eq!(one, two);
    assert_ne!(one, image(Backdrop { seed: 4, ..backdrop }));
    let background: Vec<_> =
        plain.iter().zip(&one).filter(|(p, _)| **p == 90).map(|(_, b)| f64::from(*b)).collect();
    let differ = plain.iter().zip(&one).filter(|(p, b)| **p != 90 && p.abs_diff(**b) > 1);
    // but for the plate's rim, where the background shines through
    assert!(differ.count() < 200);
    let mean = background.iter().sum::<f64>() / background.len() as f64;
    let sd = (background.iter().map(|b| (b - mean).powi(2)).sum::<f64>() / background.len() as f64).sqrt();
    assert!(sd > 5.0, "{sd}");
    let refused = |backdrop: Backdrop| {
        let made = Renderer::new(camera(false), board.clone(), SceneLook::default(), SensorModel::ideal());
        made.unwrap().with_backdrop(backdrop).is_err()
    };
    assert!(refused(Backdrop { texture_levels: f64::NAN, ..backdrop }));
    assert!(refused(Backdrop { texture_size_m: 0.0, ..backdrop }));
    assert!(refused(Backdrop { clutter: 1_000_000, ..backdrop }));
}
