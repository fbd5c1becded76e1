//! Rendering and vision allocate nothing once they run: tracking, whole-frame search, loss, and the change of the target alike.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests
#![allow(non_snake_case)]

use assert_no_alloc::assert_no_alloc;
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::geometry::Pose;
use vservo::imaging::ImageView;
use vservo::messages::{FrameHeader, measurement_flag};
use vservo::scene::{Renderer, SceneLook, SensorModel};
use vservo::target::{FourDots, TagFamily, Tags};
use vservo::time::MonoNs;
use vservo::vision::{Frame, Prior, TargetSet, Vision, VisionSettings};

#[test]
fn nothing_is_allocated_per_frame() {
    let intrinsics =
        Intrinsics { fx_px: 600.0, fy_px: 600.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
    let camera = CameraModel::new(intrinsics, Distortion { k1: -0.2, ..Distortion::default() }).unwrap();
    let target = FourDots::default();
    let mut renderer = Renderer::new(camera, target, SceneLook::default(), SensorModel::default()).unwrap();
    let mut vision = Vision::new(camera, target, VisionSettings::default());
    let mut image = vec![0; 640 * 480];
    let (mut found, mut tracked) = (0, 0);
    let mut frame = |k: u64, poses: &[Pose]| {
        renderer.render(poses, k, &mut image);
        if k % 10 == 9 {
            // noise without a target: the longest way through the search
            image.iter_mut().enumerate().for_each(|(i, p)| *p = ((i * i) >> 3) as u8);
        }
        let header =
            FrameHeader { frame_id: k, exposure: MonoNs(k as i64 * 40_000_000), ..FrameHeader::default() };
        let view = ImageView::new(&image, 640, 480).unwrap();
        let m = vision.process(&Frame { header, image: view }, &Prior::default());
        found += u32::from(m.found());
        tracked += u32::from(m.flags & measurement_flag::TRACKED != 0);
    };
    let pose =
        |k: u64| Pose::new([-0.05 + 0.001 * k as f64, -0.05, 0.5].into(), [0.2, 0.1, 0.02 * k as f64].into());
    // the first exposure in three parts makes room for the later ones
    frame(0, &[pose(0), pose(0), pose(0)]);
    assert_no_alloc(|| {
        for k in 1..40 {
            frame(k, &[pose(k), pose(k), pose(k)]);
        }
    });
    assert_eq!((found, tracked), (36, 32));
}

#[test]
fn nothing_is_allocated_when_the_target_changes() {
    let lens =
        Intrinsics { fx_px: 600.0, fy_px: 600.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
    let camera = CameraModel::new(lens, Distortion::default()).unwrap();
    let tag = Tags::grid(TagFamily::Tag36h11, 0.06, (1, 1), 0.1, 7).unwrap();
    let X_OT = Pose::new([0.05, -0.1, 0.0].into(), [0.0, 0.0, 0.4].into());
    let (look, dots) = (SceneLook::default(), FourDots::default());
    let renderer = Renderer::new(camera, dots, look, SensorModel::default()).unwrap();
    let tag = tag.into();
    let mut renderer = renderer.with_further_targets([(&tag, X_OT)]);
    let vision = |target| Vision::new(camera, target, VisionSettings::default());
    let mut targets = TargetSet::new(vision(dots.into()), [vision(tag.clone())]);
    let mut image = vec![0; 640 * 480];
    renderer.render(&[Pose::new([-0.05, 0.0, 0.5].into(), [0.1, 0.1, 0.1].into())], 0, &mut image);
    let mut found = Vec::with_capacity(100);
    let mut frame = |k: u64| {
        let header =
            FrameHeader { frame_id: k, exposure: MonoNs(k as i64 * 40_000_000), ..FrameHeader::default() };
        let view = ImageView::new(&image, 640, 480).unwrap();
        // A number that none has changes nothing.
        let wanted = [0, 0, 1, 1, 9][k as usize % 5];
        let m = targets.process(wanted, &Frame { header, image: view }, &Prior::default());
        found.push((m.target_number, m.found(), m.target_lost));
    };
    assert_no_alloc(|| (0..20).for_each(&mut frame));
    assert!(found.iter().enumerate().all(|(k, now)| *now == (u32::from(k % 5 > 1), true, 0)), "{found:?}");
}

/// A search of the whole frame at every second frame, tracking at the others.
#[test]
fn nothing_is_allocated_for_dots_in_space() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("config/dot-cube.toml");
    let config = vservo::config::Config::load(Some(&path), &[]).unwrap();
    let mut renderer = vservo::config::assemble::renderer(&config).unwrap();
    let i = config.camera.model.intrinsics();
    let (width, height) = (i.width_px as usize, i.height_px as usize);
    let mut image = vec![0; width * height];
    renderer.render(&[Pose::new([0.01, 0.0, 0.4].into(), [0.5, 0.2, 0.3].into())], 0, &mut image);
    let vision = |track| {
        let settings = VisionSettings { track, ..config.vision };
        Vision::new(config.camera.model, config.target.clone(), settings)
    };
    let mut both = [vision(false), vision(true)];
    let mut found = 0;
    let mut frame = |k: u64| {
        let header =
            FrameHeader { frame_id: k, exposure: MonoNs(k as i64 * 40_000_000), ..FrameHeader::default() };
        let view = ImageView::new(&image, width, height).unwrap();
        let m = both[k as usize % 2].process(&Frame { header, image: view }, &Prior::default());
        found += u32::from(m.found());
    };
    assert_no_alloc(|| (0..12).for_each(&mut frame));
    assert_eq!(found, 12);
}
