//! Rendered images and the vision that looks at them, for the tests of vision.

#![allow(dead_code, unreachable_pub)] // each test binary uses a part
#![allow(non_snake_case)]
#![allow(clippy::unwrap_used)] // helpers of tests

use nalgebra::{Translation3, UnitQuaternion, Vector2, Vector3};
use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
use vservo::geometry::Pose;
use vservo::imaging::ImageView;
use vservo::messages::{FrameHeader, Measurement};
use vservo::scene::{Renderer, SceneLook, SensorModel};
use vservo::target::FourDots;
use vservo::time::MonoNs;
use vservo::vision::{Frame, Prior, Vision, VisionSettings};

pub const WIDTH: usize = 640;
pub const HEIGHT: usize = 480;

pub fn camera(k1: f64) -> CameraModel {
    let intrinsics =
        Intrinsics { fx_px: 600.0, fy_px: 602.0, cx_px: 322.0, cy_px: 238.5, width_px: 640, height_px: 480 };
    CameraModel::new(intrinsics, Distortion { k1, ..Distortion::default() }).unwrap()
}

pub fn noisy(noise_sd_levels: f64, seed: u64) -> SensorModel {
    SensorModel { noise_sd_levels, blur_sd_px: 0.5, vignetting: 0.15, seed }
}

/// The middle of the square at (x, y, z); tilted by `tilt` about the axis at the angle `about` in its plane, after a
/// turn about the optical axis.
pub fn pose(x: f64, y: f64, z: f64, turn: f64, tilt: f64, about: f64) -> Pose {
    let axis = nalgebra::Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
    let R = UnitQuaternion::from_axis_angle(&axis, tilt)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    Pose::from_parts(Translation3::new(x, y, z), R) * Translation3::new(-0.05, -0.05, 0.0)
}

pub struct Bench {
    pub renderer: Renderer,
    pub vision: Vision,
    pub image: Vec<u8>,
    pub frame_id: u64,
}

impl Bench {
    pub fn new(k1: f64, sensor: SensorModel) -> Self {
        let (camera, target) = (camera(k1), FourDots::default());
        Self {
            renderer: Renderer::new(camera, target, SceneLook::default(), sensor).unwrap(),
            vision: Vision::new(camera, target, VisionSettings::default()),
            image: vec![0; WIDTH * HEIGHT],
            frame_id: 0,
        }
    }

    pub fn render(&mut self, X_CO: &Pose) {
        self.frame_id += 1;
        self.renderer.render(&[*X_CO], self.frame_id, &mut self.image);
    }

    pub fn process(&mut self, prior: &Prior) -> Measurement {
        process(&mut self.vision, &self.image, self.frame_id, prior)
    }

    pub fn see(&mut self, X_CO: &Pose) -> Measurement {
        self.render(X_CO);
        self.process(&Prior::default())
    }

    /// A search of the whole frame, whatever was seen before.
    pub fn search(&mut self, X_CO: &Pose) -> Measurement {
        let settings = VisionSettings { track: false, ..VisionSettings::default() };
        self.vision = Vision::new(*self.vision.camera(), self.vision.target().clone(), settings);
        self.see(X_CO)
    }

    /// Offsets of the measured points from the truth, px; of those that were measured.
    pub fn errors(&self, X_CO: &Pose, m: &Measurement) -> Vec<Vector2<f64>> {
        let truth = self.renderer.truth(X_CO);
        m.features().iter().map(|f| Vector2::new(f.u_px, f.v_px) - truth[f.id as usize]).collect()
    }
}

pub fn process(vision: &mut Vision, image: &[u8], frame_id: u64, prior: &Prior) -> Measurement {
    let header = FrameHeader {
        frame_id,
        exposure: MonoNs(frame_id as i64 * 40_000_000),
        width_px: WIDTH as u32,
        height_px: HEIGHT as u32,
        ..FrameHeader::default()
    };
    vision.process(&Frame { header, image: ImageView::new(image, WIDTH, HEIGHT).unwrap() }, prior)
}

pub fn fill(image: &mut [u8], centre: Vector2<f64>, half: f64, level: u8) {
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            if (x as f64 - centre.x).abs() < half && (y as f64 - centre.y).abs() < half {
                image[y * WIDTH + x] = level;
            }
        }
    }
}

pub fn ring(image: &mut [u8], centre: Vector2<f64>, from: f64, to: f64, level: u8) {
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let d = (x as f64 - centre.x).hypot(y as f64 - centre.y);
            if d >= from && d < to {
                image[y * WIDTH + x] = level;
            }
        }
    }
}

/// Repeatable random numbers.
pub struct Random(pub u64);

impl Random {
    /// Uniform in `low..high`.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let bits = (self.0 ^ (self.0 >> 29)).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 11;
        low + (high - low) * bits as f64 / (1u64 << 53) as f64
    }

    /// One of `0..count`.
    pub fn one_of(&mut self, count: usize) -> usize {
        (self.within(0.0, count as f64) as usize).min(count - 1)
    }

    /// A pose with all dots in view, of at least `min_px` of radius in their flat direction, tilted by up to 1 rad.
    pub fn pose(&mut self, renderer: &Renderer, min_px: f64) -> Pose {
        loop {
            let (z, tilt) = (self.within(0.25, 1.4), self.within(0.0, 1.0));
            let (x, y) = (self.within(-0.35, 0.35) * z, self.within(-0.25, 0.25) * z);
            let X_CO = pose(x, y, z, self.within(-3.2, 3.2), tilt, self.within(-3.2, 3.2));
            let margin = 600.0 * 0.015 / z * 1.3 + 6.0;
            if 600.0 * 0.01 / z * tilt.cos() > min_px
                && renderer.truth(&X_CO).iter().all(|px| renderer.camera().contains(px, margin))
            {
                return X_CO;
            }
        }
    }
}

/// A plate with `n` by `n` equal dots, every pixel the mean of nine samples.
pub fn equal_dots(
    camera: &CameraModel,
    X_CO: &Pose,
    n: usize,
    pitch_m: f64,
    radius_m: f64,
    image: &mut [u8],
) {
    let X_OC = X_CO.inverse();
    let (origin, last) = (X_OC.translation.vector, (n - 1) as f64);
    let level = |px: Vector2<f64>| {
        let s = camera.normalized_of(&px);
        let ray = X_OC.rotation * Vector3::new(s.x, s.y, 1.0);
        let r = (origin - ray * (origin.z / ray.z)).xy() / pitch_m;
        let nearest = r.map(|x| x.round().clamp(0.0, last));
        let on_plate = r.iter().all(|x| (-1.0..last + 1.0).contains(x));
        match on_plate {
            _ if (r - nearest).norm() * pitch_m < radius_m => 30.0,
            true => 220.0,
            false => 90.0,
        }
    };
    for (i, p) in image.iter_mut().enumerate() {
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let samples =
            (0..9).map(|k| Vector2::new(x + f64::from(k % 3 - 1) / 3.0, y + f64::from(k / 3 - 1) / 3.0));
        *p = (samples.map(level).sum::<f64>() / 9.0) as u8;
    }
}
