//! Two cameras on rendered images against the truth: poses, their covariance, views taught from files, and no allocation on the way.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests
#![allow(non_snake_case)]

use crate::common::vservo;
use assert_no_alloc::assert_no_alloc;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use vservo::config::{Config, Source, assemble};
use vservo::control::outcome::Outcome;
use vservo::geometry::Pose;
use vservo::imaging::ImageView;
use vservo::linalg::Random;
use vservo::messages::{FrameHeader, Measurement, TargetStatus};
use vservo::pose::normalized_error;
use vservo::scene::Renderer;
use vservo::sim::simulate_system;
use vservo::time::{MonoNs, SpanNs};
use vservo::vision::{Frame, Side, StereoVision};

const SIZE: (usize, usize) = (640, 480);

fn file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config/stereo.toml")
}

fn load(set: &[&str]) -> Config {
    let set: Vec<String> = set.iter().map(ToString::to_string).collect();
    Config::load(Some(&file()), &set).unwrap()
}

/// The pair of the run file before its object, without an arm.
struct Eyes {
    renderers: [Renderer; 2],
    X_LR: Pose,
    pixels: [Vec<u8>; 2],
}

impl Eyes {
    fn of(config: &Config) -> Self {
        let scene = config.scene.as_ref().unwrap();
        let renderer = |camera: &vservo::config::Camera| {
            let Source::Synthetic { look, sensor, .. } = &camera.source else { panic!("{camera:?}") };
            Renderer::new(camera.model, scene.target.clone(), *look, *sensor).unwrap()
        };
        let pixels = || vec![0; SIZE.0 * SIZE.1];
        Self {
            renderers: [renderer(&config.camera), renderer(&config.further_cameras[0])],
            X_LR: *config.stereo.as_ref().unwrap().rig.X_LR(),
            pixels: [pixels(), pixels()],
        }
    }

    /// Both images of an object at `X_CO` in the left camera.
    fn look(&mut self, X_CO: &Pose, k: u64) {
        self.renderers[0].render(&[*X_CO], k, &mut self.pixels[0]);
        self.renderers[1].render(&[self.X_LR.inv_mul(X_CO)], k, &mut self.pixels[1]);
    }

    fn measured(&self, vision: &mut StereoVision, k: u64) -> Measurement {
        let header =
            FrameHeader { frame_id: k, exposure: MonoNs(k as i64 * 40_000_000), ..FrameHeader::default() };
        for (side, pixels) in [Side::Left, Side::Right].into_iter().zip(&self.pixels) {
            let image = ImageView::new(pixels, SIZE.0, SIZE.1).unwrap();
            vision.look(side, &Frame { header, image });
        }
        vision.next_measurement().unwrap().measurement
    }
}

/// Poses about the desired one, as far off as a run begins.
fn somewhere(X_DO: &Pose, random: &mut Random) -> Pose {
    let [x, y, z] = [0.03, 0.03, 0.08].map(|m| random.between(-m, m));
    let turn = [0.2, 0.2, 0.6].map(|rad| random.between(-rad, rad));
    // about the middle of the object
    let middle = Pose::translation(0.03, 0.03, 0.0);
    Pose::translation(x, y, z) * X_DO * middle * Pose::new(Default::default(), turn.into()) * middle.inverse()
}

/// Poses of rendered images against the truth: as exact as they say, near the goal and far from it.
#[test]
fn rendered_poses_are_as_exact_as_they_say() {
    let config = load(&[]);
    let (mut eyes, mut vision) = (Eyes::of(&config), assemble::stereo_vision(&config).unwrap());
    let (X_DO, mut random) = (config.stereo.as_ref().unwrap().X_DO, Random::new(4));
    const VIEWS: u64 = 150;
    let mut errors = Vec::new();
    let mut worst_m: f64 = 0.0;
    for k in 0..VIEWS {
        let X_CO = somewhere(&X_DO, &mut random);
        eyes.look(&X_CO, k);
        let m = eyes.measured(&mut vision, k);
        assert_eq!(m.target_status(), TargetStatus::Found, "{k}");
        let pose = m.pose().unwrap();
        let covariance = nalgebra::Matrix6::from_row_slice(&m.pose_covariance);
        errors.push(normalized_error(&pose, &covariance, &X_CO).unwrap() / 6.0);
        worst_m = worst_m.max((pose.translation.vector - X_CO.translation.vector).norm());
    }
    errors.sort_by(f64::total_cmp);
    let (mean, median) = (errors.iter().sum::<f64>() / VIEWS as f64, errors[VIEWS as usize / 2]);
    // Offsets of lens and perspective are in `vision.model_sd_px` of the run file: docs/stereo.md.
    assert!((0.2..1.6).contains(&median) && (0.2..2.0).contains(&mean), "{median} {mean}");
    assert!(worst_m < 0.2e-3, "{worst_m} {median} {mean}");
}

/// In steady state nothing is allocated: found, alone and lost alike.
#[test]
fn nothing_is_allocated_per_pair() {
    let config = load(&[]);
    let (mut eyes, mut vision) = (Eyes::of(&config), assemble::stereo_vision(&config).unwrap());
    let X_DO = config.stereo.as_ref().unwrap().X_DO;
    let (mut found, mut alone) = (0, 0);
    let mut frame = |k: u64, eyes: &mut Eyes| {
        let header =
            FrameHeader { frame_id: k, exposure: MonoNs(k as i64 * 40_000_000), ..FrameHeader::default() };
        for (side, pixels) in [Side::Left, Side::Right].into_iter().zip(&mut eyes.pixels) {
            if k % 7 == 3 && side == Side::Right {
                continue;
            }
            if k % 7 == 5 {
                pixels.iter_mut().enumerate().for_each(|(i, p)| *p = ((i * i) >> 3) as u8);
            }
            let image = ImageView::new(pixels, SIZE.0, SIZE.1).unwrap();
            vision.look(side, &Frame { header, image });
        }
        vision.give_up(Side::Left, header.exposure);
        while let Some(seen) = vision.next_measurement() {
            found += u32::from(seen.measurement.found());
            alone += u32::from(seen.measurement.target_status() == TargetStatus::NoPair);
        }
    };
    for k in 0..35 {
        eyes.look(&(Pose::translation(0.001 * (k % 20) as f64, 0.0, 0.0) * X_DO), k);
        if k < 7 {
            frame(k, &mut eyes);
        } else {
            assert_no_alloc(|| frame(k, &mut eyes));
        }
    }
    assert_eq!((found, alone), (25, 5));
}

/// Images of both cameras in the desired pose, `vservo teach-view`, and a run with its file.
#[test]
fn a_view_is_taught_from_images() {
    let config = load(&[]);
    let mut eyes = Eyes::of(&config);
    let X_DO = config.stereo.as_ref().unwrap().X_DO;
    let folder = tempfile::tempdir().unwrap();
    let mut images = Vec::new();
    for k in 0..3 {
        eyes.look(&X_DO, k);
        for (side, pixels) in ["left", "right"].iter().zip(&eyes.pixels) {
            let path = folder.path().join(format!("{side}{k}.png"));
            image::save_buffer(&path, pixels, SIZE.0 as u32, SIZE.1 as u32, image::ColorType::L8).unwrap();
            images.push(path);
        }
    }
    let view = folder.path().join("view.toml");
    let output =
        vservo().arg("teach-view").arg(file()).args(&images).arg("--out").arg(&view).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let set = format!("stereo.taught_file={}", view.display());
    let taught = load(&[&set]);
    assert_eq!(taught.effective.stereo.as_ref().unwrap().points.len(), 16);
    let run = simulate_system(&taught, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(run.finish.outcome, Outcome::Converged, "{}", run.finish.reason);
    assert!(run.errors.position_error_m.unwrap() < 0.5e-3);
    // what does not serve is told
    let refused = |images: &[PathBuf], code: i32, words: &str| {
        let output = vservo().arg("teach-view").arg(file()).args(images).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(code) && text.contains(words), "{:?} {text}", output.status);
    };
    refused(&images[..3], 2, "pairs are needed");
    let blank = folder.path().join("blank.png");
    let grey = vec![90; SIZE.0 * SIZE.1];
    image::save_buffer(&blank, &grey, SIZE.0 as u32, SIZE.1 as u32, image::ColorType::L8).unwrap();
    refused(&[images[0].clone(), blank], 3, "the right camera does not see the target");
    let small = folder.path().join("small.png");
    image::save_buffer(&small, &grey[..320 * 480], 320, 480, image::ColorType::L8).unwrap();
    refused(&[images[0].clone(), small], 3, "small.png");
    refused(&[images[0].clone(), folder.path().join("none.png")], 3, "none.png");
}

/// A stamp error within the tolerance is a pair all the same; the left stamp counts.
#[test]
fn a_small_difference_of_stamps_is_a_pair() {
    let config = load(&[]);
    let (mut eyes, mut vision) = (Eyes::of(&config), assemble::stereo_vision(&config).unwrap());
    eyes.look(&config.stereo.as_ref().unwrap().X_DO.clone(), 1);
    for (side, pixels, late) in [(Side::Left, &eyes.pixels[0], 0), (Side::Right, &eyes.pixels[1], 1_900_000)]
    {
        let header = FrameHeader { exposure: MonoNs(5_000_000) + SpanNs(late), ..FrameHeader::default() };
        vision.look(side, &Frame { header, image: ImageView::new(pixels, SIZE.0, SIZE.1).unwrap() });
    }
    let m = vision.next_measurement().unwrap().measurement;
    assert!(m.found() && m.exposure == MonoNs(5_000_000));
    assert_eq!(vision.counts().pairs, 1);
}
