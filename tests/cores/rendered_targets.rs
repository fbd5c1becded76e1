//! Chessboards and tags against the renderer's truth: random views through a lens, with noise, blur, texture around.

#![allow(non_snake_case, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use nalgebra::{Translation3, UnitQuaternion, Vector2};
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::detect::{Detection, Finder};
use vservo::geometry::{Pose, rotation_x, rotation_y, rotation_z};
use vservo::imaging::ImageView;
use vservo::linalg::Random;
use vservo::scene::{Backdrop, Renderer, SceneLook, SensorModel};
use vservo::target::{Chessboard, TagFamily, Tags, Target};
use vservo::vision::{Vision, VisionSettings};

pub(crate) const SIZE: (usize, usize) = (640, 480);

pub(crate) fn camera() -> CameraModel {
    let intrinsics = Intrinsics {
        fx_px: 800.0,
        fy_px: 800.0,
        cx_px: 319.5,
        cy_px: 239.5,
        width_px: SIZE.0 as u32,
        height_px: SIZE.1 as u32,
    };
    CameraModel::new(intrinsics, Distortion { k1: -0.15, k2: 0.05, ..Distortion::default() }).unwrap()
}

/// A view of the middle of the target, turned and tilted.
pub(crate) fn view(target: &Target, z_m: f64, random: &mut Random) -> Pose {
    let plate = target.plate();
    let middle = (plate.low_m + plate.high_m) / 2.0;
    let mut within = |most: f64| most * (2.0 * random.uniform() - 1.0);
    let R = rotation_z(within(3.1)) * rotation_y(within(0.5)) * rotation_x(within(0.5));
    let place = Translation3::new(within(0.02), within(0.02), z_m);
    Pose::from_parts(place, UnitQuaternion::from_rotation_matrix(&R))
        * Translation3::new(-middle.x, -middle.y, 0.0)
}

struct Outcome {
    rms_px: f64,
    bias_px: f64,
    /// Mean normalized error squared of a coordinate.
    nees: f64,
    pose_rms: f64,
}

fn campaign(target: &Target, z_m: f64, sensor: SensorModel, views: u32) -> Outcome {
    let backdrop = Backdrop { texture_levels: 20.0, clutter: 10, ..Backdrop::default() };
    let mut renderer = Renderer::new(camera(), target.clone(), SceneLook::default(), sensor)
        .unwrap()
        .with_backdrop(backdrop)
        .unwrap();
    let mut finder = Finder::new(camera(), target);
    let mut vision = Vision::new(camera(), target.clone(), VisionSettings::default());
    let mut random = Random::new(7);
    let (mut squares, mut outward, mut normalized, mut count, mut pose) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let mut image = vec![0u8; SIZE.0 * SIZE.1];
    let mut found: Vec<Detection> = Vec::new();
    for n in 0..views {
        let X_CO = view(target, z_m, &mut random);
        renderer.render(&[X_CO], u64::from(n), &mut image);
        let truth = renderer.truth(&X_CO);
        let middle = truth.iter().sum::<Vector2<f64>>() / truth.len() as f64;
        let image = ImageView::new(&image, SIZE.0, SIZE.1).unwrap();
        finder.search(&image, &mut found).unwrap_or_else(|e| panic!("{e:?} at {X_CO}"));
        // a tag is whole or not there: those that reach to the border are not asked for
        let whole = |ids: &[Vector2<f64>]| {
            ids.iter().all(|px| px.x > 15.0 && px.x < 624.0 && px.y > 15.0 && px.y < 464.0)
        };
        let wanted: usize = if matches!(target, Target::Tags(_)) {
            truth.chunks(4).filter(|corners| whole(corners)).map(<[_]>::len).sum()
        } else {
            truth.len()
        };
        assert!(found.len() >= wanted, "{} of {wanted} at {X_CO}", found.len());
        for point in &found {
            let true_px = truth[point.id as usize];
            let error = point.px - finder.bias_px(point.id, &X_CO) - true_px;
            assert!(error.norm() < 1.0, "point {} is {error} off at {X_CO}", point.id);
            squares += error.norm_squared() / 2.0;
            outward += error.dot(&(true_px - middle).normalize());
            normalized += error.norm_squared() / (2.0 * point.sd_px * point.sd_px);
            count += 1.0;
        }
        let still = vision.process_image(&image).unwrap();
        assert!(still.consistent, "{X_CO}: {}", still.rms_px);
        let off = still.pose.unwrap().X_CO.inv_mul(&X_CO);
        pose += (off.translation.vector.norm() / z_m).powi(2);
    }
    Outcome {
        rms_px: (squares / count).sqrt(),
        bias_px: outward / count,
        nees: normalized / count,
        pose_rms: (pose / f64::from(views)).sqrt(),
    }
}

pub(crate) fn board() -> Target {
    Chessboard::with_squares(9, 6, 0.02).unwrap().into()
}

pub(crate) fn tags() -> Target {
    Tags::grid(TagFamily::Tag36h11, 0.06, (2, 2), 0.08, 3).unwrap().into()
}

#[test]
fn corners_lie_where_the_renderer_puts_them() {
    for (name, target, z_m, goal_px) in [("chessboard", board(), 0.4, 0.015), ("tags", tags(), 0.4, 0.015)] {
        for (label, sensor) in [
            ("usual", SensorModel::default()),
            ("noise-free", SensorModel { noise_sd_levels: 0.0, vignetting: 0.0, ..SensorModel::default() }),
            ("blurred", SensorModel { blur_sd_px: 1.0, vignetting: 0.0, ..SensorModel::default() }),
        ] {
            let o = campaign(&target, z_m, sensor, 40);
            println!(
                "{name} {label}: {:.4} px, outward {:.4} px, nees {:.2}, pose {:.6} of the distance",
                o.rms_px, o.bias_px, o.nees, o.pose_rms
            );
            assert!(o.rms_px < goal_px, "{name} {label}: {} px", o.rms_px);
        }
    }
}
