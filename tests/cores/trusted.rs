//! Images in which something lies on a part of a target, by a renderer of the tests' own: what is told of them is honest. The harms are
//! put on the light, before it becomes bytes. `VSERVO_CAMPAIGN=n` looks at `n` times as many images, `VSERVO_SEED=n` at others.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::dots_truth::{camera, campaign};
use crate::rendered_targets::{SIZE, board, camera as lens, tags, view as any_view};
use crate::supersampled::{Dice, Scene};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector2, Vector3, Vector6};
use vservo::camera_model::{CameraModel, Distortion, Response};
use vservo::geometry::Pose;
use vservo::imaging::ImageView;
use vservo::linalg::Random;
use vservo::scene::{Renderer, SceneLook, SensorModel};
use vservo::target::{DotGrid, FourDots, TagFamily, Tags, Target};
use vservo::vision::{Vision, VisionSettings};

/// What `vservo detect` allows for.
const SETTINGS: VisionSettings = VisionSettings {
    model_sd_px: 0.2,
    track: false,
    slack_px: 3.0,
    ambiguity_sds: 3.0,
    pose: vservo::vision::PoseApproach::Both,
    lens_is_known: true,
    response: Response::Linear,
};

/// Of the draws.
fn seed(usual: u64) -> u64 {
    std::env::var("VSERVO_SEED").ok().and_then(|n| n.parse().ok()).unwrap_or(usual)
}

#[derive(Debug, Clone, Copy)]
enum Harm {
    None,
    /// A part of a dot is painted over in the plate's colour.
    Cover,
    /// A bright spot on a dot's rim.
    Glare,
    /// A shadow with a soft edge across a dot.
    Shadow,
}

fn view(dice: &mut Dice) -> Scene {
    loop {
        let radius = dice.within(6f64.ln(), 35f64.ln()).exp();
        let about = dice.within(-3.2, 3.2);
        let axis = Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
        let R = UnitQuaternion::from_axis_angle(&axis, dice.within(0.0, 1.0))
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), dice.within(-3.2, 3.2));
        let z = 600.0 * 0.01 / radius;
        let place = Translation3::new(dice.within(-0.3, 0.3) * z, dice.within(-0.2, 0.2) * z, z);
        let mut scene =
            Scene::of_four_dots(Isometry3::from_parts(place, R) * Translation3::new(-0.05, -0.05, 0.0));
        scene.noise_levels = dice.within(0.3, 3.0);
        scene.blur_px = dice.within(0.4, 1.1);
        scene.vignetting = dice.within(0.0, 0.2);
        scene.seed = (dice.unit() * 1e15) as u64;
        if scene.in_view(6.0) {
            return scene;
        }
    }
}

/// The image with something on one of the dots.
fn harmed(kind: Harm, dice: &mut Dice, scene: &Scene) -> Vec<u8> {
    let mut pixels = scene.render();
    let (c, radius_m) = scene.discs[(dice.unit() * 4.0) as usize % 4];
    let (sin, cos) = dice.within(-3.2, 3.2).sin_cos();
    let out = Vector2::new(cos, sin);
    let (rim, centre) = (scene.project(&(c + out * radius_m)), scene.project(&c));
    let (radius, toward) = ((rim - centre).norm(), (rim - centre).normalize());
    let (amount, spot) = (dice.within(0.15, 0.7), dice.within(0.2, 0.6));
    let (gain, soft) = (dice.within(0.4, 0.85), dice.within(0.3, 2.0));
    for (i, byte) in pixels.iter_mut().enumerate() {
        let d = Vector2::new((i % scene.width) as f64, (i / scene.width) as f64);
        let level = f64::from(*byte);
        let new = match kind {
            Harm::None => level,
            Harm::Cover => {
                // beyond a chord, `amount` of the radius from the rim
                let depth = (d - rim).dot(&toward) + amount * radius;
                let share = 1.0 / (1.0 + (-2.0 * depth / scene.blur_px).exp());
                let near = (d - centre).norm() < 1.4 * radius;
                if near { level + (scene.plate_level - level).max(0.0) * share } else { level }
            }
            Harm::Glare => {
                level + 255.0 * (-0.5 * ((d - rim).norm() / (spot * radius).max(2.0)).powi(4)).exp()
            }
            Harm::Shadow => {
                let across = (d - centre).dot(&toward) / (soft * radius);
                level * (gain + (1.0 - gain) / (1.0 + (-4.0 * across).exp()))
            }
        };
        *byte = new.round().clamp(0.0, 255.0) as u8;
    }
    pixels
}

/// What was told of many images.
#[derive(Debug, Default)]
struct Told {
    unseen: u32,
    refused: u32,
    found: u32,
    /// Found, with points measured by the rest of their rims.
    by_rim: u32,
    /// Found, with a point off by more than a tenth of a pixel.
    off: u32,
    /// Of these, and of poses: those whose stated uncertainty does not cover the error.
    untrue: Vec<String>,
    /// Sum of squares of normalized errors of poses over their degrees of freedom.
    nees: f64,
    max_mm: f64,
    /// The most standard deviations that a point, and the greatest normalized error that a pose was off.
    worst: [f64; 2],
}

/// Standard deviations of a point, and the square of a pose's normalized error (six degrees of freedom), from which on what is told is
/// untrue. Errors scaled by a misfit of two degrees of freedom have long tails: no chi-square.
const MAX_SDS: f64 = 6.0;
const MAX_SQUARE: f64 = 120.0;

impl Told {
    fn take(
        &mut self,
        vision: &mut Vision,
        image: &ImageView<'_>,
        X_CO: &Isometry3<f64>,
        truth: &[Vector2<f64>],
        k: usize,
    ) {
        let Ok(still) = vision.process_image(image) else {
            self.unseen += 1;
            return;
        };
        if !still.consistent {
            self.refused += 1;
            return;
        }
        self.found += 1;
        self.by_rim += u32::from(!still.harmed.is_empty());
        let (mut px, mut sigmas) = (0.0f64, 0.0f64);
        for (seen, found) in still.px.iter().zip(still.found) {
            let Some(truth) = truth.get(found.id as usize) else { continue };
            let off = (seen - truth).norm();
            px = px.max(off);
            sigmas = sigmas.max(off / found.sd_px / still.growth.points.sqrt());
        }
        self.off += u32::from(px > 0.1);
        let pose = still.pose.unwrap();
        // the covariance is that of position and left rotation, in the camera's frame
        let moved = pose.X_CO.translation.vector - X_CO.translation.vector;
        let turned = (pose.X_CO.rotation * X_CO.rotation.inverse()).scaled_axis();
        let error = Vector6::new(moved.x, moved.y, moved.z, turned.x, turned.y, turned.z);
        let square = (error.transpose() * pose.covariance.try_inverse().unwrap() * error)[0];
        self.nees += square / 6.0;
        self.worst = [self.worst[0].max(sigmas), self.worst[1].max(square.sqrt())];
        self.max_mm = self.max_mm.max(1000.0 * moved.norm());
        if sigmas > MAX_SDS || square > MAX_SQUARE {
            self.untrue.push(format!("{k}: {px:.2} px, {sigmas:.0} sd; pose {square:.0}"));
        }
    }

    fn tell(&self, name: &str) {
        let Self { unseen, refused, found, by_rim, off, untrue, nees, max_mm, worst } = self;
        let nees = nees / f64::from(*found);
        println!(
            "{name}: {found} found ({by_rim} by rims, {off} off), {refused} refused, {unseen} unseen; NEES {nees:.2}, {max_mm:.2} mm at most; point, pose {worst:.1?} sd at most; {} untrue {untrue:?}",
            untrue.len()
        );
    }
}

#[test]
fn what_is_told_of_harmed_dots_is_true() {
    let mut dice = Dice(seed(5));
    let target = Target::from(FourDots::default());
    for kind in [Harm::None, Harm::Cover, Harm::Glare, Harm::Shadow] {
        let mut told = Told::default();
        for k in 0..60 * campaign() {
            let scene = view(&mut dice);
            let pixels = harmed(kind, &mut dice, &scene);
            let image = ImageView::new(&pixels, scene.width, scene.height).unwrap();
            let mut vision = Vision::new(camera(&scene), target.clone(), SETTINGS);
            told.take(&mut vision, &image, &scene.X_CO, &scene.truth(), k);
        }
        told.tell(&format!("{kind:?}"));
        let all = told.found + told.refused + told.unseen;
        assert!(told.untrue.len() as u32 * 50 <= told.found, "{kind:?}");
        if matches!(kind, Harm::None) {
            assert!(told.found == all && told.by_rim == 0 && told.untrue.is_empty());
        } else {
            // a rim that is seen in part is enough for most
            assert!(2 * told.by_rim >= all, "{kind:?}: {} of {all} by their rims", told.by_rim);
        }
    }
}

/// An image whose rows are exposed one after the other while the target moves by up to so many pixels.
fn rolling(renderer: &mut Renderer, X_CO: &Pose, smear_px: f64, random: &mut Random, k: u64) -> Vec<u8> {
    const ROWS: usize = 8;
    let z = X_CO.translation.z;
    let V = Vector6::from_fn(|i, _| {
        (2.0 * random.uniform() - 1.0) * smear_px / 800.0 * if i < 3 { z } else { 1.0 }
    });
    let mut image = vec![0u8; SIZE.0 * SIZE.1];
    let mut whole = image.clone();
    for (band, rows) in image.chunks_mut(ROWS * SIZE.0).enumerate() {
        let t = (band * ROWS) as f64 / SIZE.1 as f64 - 0.5;
        let moved = Pose::new(V.fixed_rows::<3>(0) * t, V.fixed_rows::<3>(3) * t) * X_CO;
        let from = band * ROWS * SIZE.0;
        // as far as it is needed: rows above are the same with and without those below
        let seen = &mut whole[..from + rows.len()];
        renderer.render(&[moved], k, seen);
        rows.copy_from_slice(&seen[from..]);
    }
    image
}

/// A grey disc over one of the target's points, a few pixels in size.
fn spotted(image: &mut [u8], truth: &[Vector2<f64>], random: &mut Random) {
    let point = truth[(random.uniform() * truth.len() as f64) as usize % truth.len()];
    let (radius, level) = (3.0 + 6.0 * random.uniform(), (255.0 * random.uniform()) as u8);
    let at = point + Vector2::new(random.gaussian(), random.gaussian()) * radius;
    for (i, byte) in image.iter_mut().enumerate() {
        let d = Vector2::new((i % SIZE.0) as f64, (i / SIZE.0) as f64) - at;
        if d.norm() < radius {
            *byte = level;
        }
    }
}

/// A shadow with a soft edge across one of the target's points, or a highlight near it, a few pixels to tens of them in size.
fn lit(image: &mut [u8], harm: &str, truth: &[Vector2<f64>], random: &mut Random) {
    let mut within = |low: f64, high: f64| low + (high - low) * random.uniform();
    let point = truth[within(0.0, truth.len() as f64) as usize % truth.len()];
    let (sin, cos) = within(-3.2, 3.2).sin_cos();
    let (gain, soft, size) = (within(0.4, 0.85), within(1.5, 30.0), within(3.0, 15.0));
    let at = point
        + Vector2::new(within(-1.0, 1.0), within(-1.0, 1.0)) * if harm == "shadow" { soft } else { size };
    for (i, byte) in image.iter_mut().enumerate() {
        let d = Vector2::new((i % SIZE.0) as f64, (i / SIZE.0) as f64) - at;
        let level = f64::from(*byte);
        let new = if harm == "shadow" {
            let across = (d.x * cos + d.y * sin) / soft;
            level * (gain + (1.0 - gain) / (1.0 + (-2.0 * across).exp()))
        } else {
            level + 255.0 * (-0.5 * (d.norm() / size).powi(4)).exp()
        };
        *byte = new.round().clamp(0.0, 255.0) as u8;
    }
}

/// What is covered in part, and what is smooth over the image: rows that are exposed one after the other, a lens that is not the one of
/// the calibration.
#[test]
fn what_is_told_of_boards_grids_and_tags_is_true() {
    let mut untrue = Vec::new();
    let tag = Tags::one(TagFamily::Tag36h11, 0.1, 5).unwrap();
    let grid = DotGrid::with_pitch(7, 5, 0.03).unwrap();
    for (name, target) in
        [("chessboard", board()), ("tags", tags()), ("one tag", tag.into()), ("grid", grid.into())]
    {
        let (lens, mut random) = (lens(), Random::new(seed(9)));
        let mut renderer =
            Renderer::new(lens, target.clone(), SceneLook::default(), SensorModel::default()).unwrap();
        let mut vision = Vision::new(lens, target.clone(), SETTINGS);
        for harm in ["none", "spot", "shadow", "highlight", "rolling shutter", "another lens"] {
            let mut told = Told::default();
            for k in 0..20 * campaign() {
                let X_CO = any_view(&target, 0.4, &mut random);
                let mut truth = renderer.truth(&X_CO);
                let image = match harm {
                    "rolling shutter" => {
                        // each point was there when its row was exposed: it is the pose that is none
                        truth.clear();
                        rolling(&mut renderer, &X_CO, 4.0, &mut random, k as u64)
                    }
                    _ => {
                        let mut image = vec![0u8; SIZE.0 * SIZE.1];
                        renderer.render(&[X_CO], k as u64, &mut image);
                        match harm {
                            "spot" => spotted(&mut image, &truth, &mut random),
                            "shadow" | "highlight" => lit(&mut image, harm, &truth, &mut random),
                            _ => {}
                        }
                        image
                    }
                };
                let image = ImageView::new(&image, SIZE.0, SIZE.1).unwrap();
                if harm == "another lens" {
                    let i = *lens.intrinsics();
                    let other = Distortion {
                        k1: -0.15 + 0.03 * random.gaussian(),
                        k2: 0.05,
                        ..Distortion::default()
                    };
                    let mut vision =
                        Vision::new(CameraModel::new(i, other).unwrap(), target.clone(), SETTINGS);
                    told.take(&mut vision, &image, &X_CO, &truth, k);
                } else {
                    told.take(&mut vision, &image, &X_CO, &truth, k);
                }
            }
            told.tell(&format!("{name}, {harm}"));
            // what a lens does to the four corners of one tag a pose takes up nearly whole: the image cannot tell
            let hidden = (name, harm) == ("one tag", "another lens");
            if told.untrue.len() as u32 * 8 > told.found && !hidden {
                untrue.push(format!("{name}, {harm}: {:?}", told.untrue));
            }
        }
    }
    assert!(untrue.is_empty(), "{untrue:#?}");
}
