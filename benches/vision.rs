//! Rendering and detection, one thread: medians against the goals of the design.

#![allow(clippy::unwrap_used)] // a bench that cannot be set up should say so at once

use divan::Bencher;
use nalgebra::{Translation3, UnitQuaternion};
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::geometry::Pose;
use vservo::scene::{Renderer, SceneLook, SensorModel};
use vservo::target::FourDots;

fn main() {
    divan::main();
}

fn camera(width_px: u32, height_px: u32, f: f64, distortion: Distortion) -> CameraModel {
    let (cx_px, cy_px) = (f64::from(width_px) * 0.5 - 0.5, f64::from(height_px) * 0.5 - 0.5);
    CameraModel::new(Intrinsics { fx_px: f, fy_px: f, cx_px, cy_px, width_px, height_px }, distortion)
        .unwrap()
}

fn vga(k1: f64) -> CameraModel {
    camera(640, 480, 600.0, Distortion { k1, ..Distortion::default() })
}

/// The square's middle on the optical axis, a little turned and tilted.
fn pose(z: f64) -> Pose {
    Pose::from_parts(Translation3::new(0.0, 0.0, z), UnitQuaternion::from_euler_angles(0.15, -0.1, 0.4))
        * Translation3::new(-0.05, -0.05, 0.0)
}

fn renderer(camera: CameraModel, blur_sd_px: f64) -> Renderer {
    let sensor = SensorModel { noise_sd_levels: 2.0, blur_sd_px, vignetting: 0.1, seed: 1 };
    Renderer::new(camera, FourDots::default(), SceneLook::default(), sensor).unwrap()
}

mod render {
    use super::*;

    fn run(bencher: Bencher, camera: CameraModel, blur: f64, poses: &[Pose]) {
        let mut renderer = renderer(camera, blur);
        let i = *camera.intrinsics();
        let mut image = vec![0; (i.width_px * i.height_px) as usize];
        let mut frame = 0;
        bencher.bench_local(|| {
            frame += 1;
            renderer.render(poses, frame, &mut image);
        });
    }

    #[divan::bench]
    fn vga_empty(bencher: Bencher) {
        run(bencher, vga(0.0), 0.5, &[]);
    }

    #[divan::bench(args = [0.35, 0.5, 1.0])]
    fn vga_sharp(bencher: Bencher, z: f64) {
        run(bencher, vga(0.0), 0.0, &[pose(z)]);
    }

    #[divan::bench(args = [0.35, 0.5, 1.0])]
    fn vga_blurred(bencher: Bencher, z: f64) {
        run(bencher, vga(0.0), 0.5, &[pose(z)]);
    }

    #[divan::bench(args = [0.35, 0.5, 1.0])]
    fn vga_blurred_distorted(bencher: Bencher, z: f64) {
        run(bencher, vga(-0.2), 0.5, &[pose(z)]);
    }

    #[divan::bench]
    fn vga_motion_blur_5(bencher: Bencher) {
        let poses: Vec<_> = (0..5).map(|i| pose(0.5 + 0.001 * f64::from(i))).collect();
        run(bencher, vga(-0.2), 0.5, &poses);
    }

    #[divan::bench]
    fn hd_distorted(bencher: Bencher) {
        let camera = camera(1920, 1080, 1500.0, Distortion { k1: -0.2, ..Distortion::default() });
        run(bencher, camera, 0.5, &[pose(0.5)]);
    }
}

mod detect {
    use super::*;
    use vservo::detect::{Finder, PredictedPoint};
    use vservo::imaging::{Components, Connectivity, Histogram, ImageView, PairCounter, Runs, Window};
    use vservo::messages::FrameHeader;
    use vservo::time::MonoNs;
    use vservo::vision::{Frame, Prior, Vision, VisionSettings};

    fn image(camera: CameraModel) -> Vec<u8> {
        let i = *camera.intrinsics();
        let mut image = vec![0; (i.width_px * i.height_px) as usize];
        renderer(camera, 0.5).render(&[pose(0.5)], 1, &mut image);
        image
    }

    fn hd() -> CameraModel {
        camera(1920, 1080, 1500.0, Distortion { k1: -0.2, ..Distortion::default() })
    }

    fn run(bencher: Bencher, camera: CameraModel, track: bool) {
        let pixels = image(camera);
        let i = *camera.intrinsics();
        let mut vision =
            Vision::new(camera, FourDots::default(), VisionSettings { track, ..VisionSettings::default() });
        let image = ImageView::new(&pixels, i.width_px as usize, i.height_px as usize).unwrap();
        let mut frame_id = 0;
        let mut next = || {
            frame_id += 1;
            let header =
                FrameHeader { frame_id, exposure: MonoNs(frame_id as i64), ..FrameHeader::default() };
            vision.process(&Frame { header, image }, &Prior::default())
        };
        assert!(next().found());
        bencher.bench_local(next);
    }

    /// Goal 60 us.
    #[divan::bench]
    fn whole_vga(bencher: Bencher) {
        run(bencher, vga(-0.2), false);
    }

    /// Goal 450 us.
    #[divan::bench]
    fn whole_hd(bencher: Bencher) {
        run(bencher, hd(), false);
    }

    /// Goal 10 us, with pose, covariance and features.
    #[divan::bench]
    fn track_vga(bencher: Bencher) {
        run(bencher, vga(-0.2), true);
    }

    /// Goal 10 us, like the peer's: windows to centroids, without a pose.
    #[divan::bench]
    fn track_vga_dots_only(bencher: Bencher) {
        let camera = vga(-0.2);
        let pixels = image(camera);
        let image = ImageView::new(&pixels, 640, 480).unwrap();
        let mut finder = Finder::new(camera, &FourDots::default().into());
        let mut found = Vec::new();
        finder.search(&image, &mut found).unwrap();
        let expected: Vec<_> = found
            .iter()
            .map(|dot| PredictedPoint {
                id: dot.id,
                px: dot.px,
                covariance_px2: dot.covariance_px2,
                area_px2: dot.area_px2,
                slack_px: 3.0,
                threshold: 125,
            })
            .collect();
        assert!(finder.track(&image, &expected, &mut found));
        bencher.bench_local(|| finder.track(&image, &expected, &mut found));
    }

    #[divan::bench]
    fn track_hd(bencher: Bencher) {
        run(bencher, hd(), true);
    }

    /// Goal 45 us.
    #[divan::bench]
    fn otsu_vga(bencher: Bencher) {
        let pixels = image(vga(0.0));
        let image = ImageView::new(&pixels, 640, 480).unwrap();
        let mut counter = PairCounter::default();
        bencher.bench_local(|| counter.count(&image).otsu());
    }

    #[divan::bench]
    fn otsu_vga_without_buffer(bencher: Bencher) {
        let pixels = image(vga(0.0));
        let image = ImageView::new(&pixels, 640, 480).unwrap();
        bencher.bench_local(|| Histogram::of(&image).otsu());
    }

    /// Goal 150 us, binarisation included.
    #[divan::bench]
    fn components_vga(bencher: Bencher) {
        let pixels = image(vga(0.0));
        let image = ImageView::new(&pixels, 640, 480).unwrap();
        let (mut runs, mut components) = (Runs::with_limit(20_000), Components::with_limit(20_000));
        let window = Window::whole(&image);
        bencher.bench_local(|| {
            runs.find(&image, &window, 150);
            components.find(&runs, &window, Connectivity::Eight);
            components.as_slice().len()
        });
    }

    #[divan::bench]
    fn runs_vga(bencher: Bencher) {
        let pixels = image(vga(0.0));
        let image = ImageView::new(&pixels, 640, 480).unwrap();
        let mut runs = Runs::with_limit(20_000);
        let window = Window::whole(&image);
        bencher.bench_local(|| {
            runs.find(&image, &window, 150);
            runs.as_slice().len()
        });
    }
}
