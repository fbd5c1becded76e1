//! Arms of the run files that move before a target at rest, with noise and stamps that are off by a known time.

use super::*;
use crate::calibration::image_reach;
use crate::config::Config;
use crate::geometry::Pose;
use crate::messages::{FeaturePoint, JointState, Measurement, TargetStatus};
use crate::motion::ExcitationMotion;
use crate::motion::MotionLimits;
use crate::time::{MonoNs, SpanNs};
use nalgebra::{SVector, Vector3};
use std::path::Path;

const DURATION_S: f64 = 8.0;

/// An arm before a target, and how it moves.
struct ArmScene<const N: usize> {
    config: Config,
    robot: Robot<N>,
    q: SVector<f64, N>,
    amplitude: SVector<f64, N>,
}

/// How the camera is wrong.
#[derive(Clone, Copy)]
struct CameraErrors {
    late_s: f64,
    noise_px: f64,
    jitter_s: f64,
    outliers: bool,
    seed: u64,
}

const GOOD: CameraErrors =
    CameraErrors { late_s: 0.0, noise_px: 0.05, jitter_s: 0.0, outliers: false, seed: 1 };

/// Random numbers of unit variance.
struct Noise(u64);

impl Noise {
    fn even(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.even()).sum::<f64>() - 6.0
    }
}

impl<const N: usize> ArmScene<N> {
    fn of(file: &str) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config").join(file);
        let config = Config::load(Some(&path), &[]).unwrap();
        let robot = config.robot.build::<N>().unwrap();
        let q = crate::config::assemble::q_start::<N>(&config).unwrap();
        let mut scene = Self { config, robot, q, amplitude: SVector::zeros() };
        let seen = scene.seen(&q, MonoNs(0), &mut |_| 0.0);
        let camera = &scene.config.camera;
        let limits = limits(&scene.robot);
        let points = scene.config.target.points().iter().map(|point| point.p_O).collect::<Vec<_>>();
        let reach =
            image_reach(&scene.robot, &camera.mount, &camera.model, &points, &limits, &q, &seen).unwrap();
        scene.amplitude = *ExcitationMotion::new(&q, &reach, &limits).amplitude();
        scene
    }

    /// A motion from rest to rest, not that of [`ExcitationMotion`].
    fn joints(&self, t: f64) -> (SVector<f64, N>, SVector<f64, N>) {
        let t = t.clamp(0.0, DURATION_S);
        let (w, w_dot) = {
            let a = std::f64::consts::PI / DURATION_S;
            ((a * t).sin().powi(2), a * (2.0 * a * t).sin())
        };
        let rate = |i: usize| std::f64::consts::TAU * (2.6 + i as f64) / DURATION_S;
        let q = SVector::from_fn(|i, _| self.amplitude[i] * w * (0.5 - 0.5 * (rate(i) * t).cos()));
        let qd = SVector::from_fn(|i, _| {
            let (sin, cos) = (rate(i) * t).sin_cos();
            self.amplitude[i] * (w_dot * (0.5 - 0.5 * cos) + w * 0.5 * rate(i) * sin)
        });
        (self.q + q, qd)
    }

    fn seen(
        &self,
        q: &SVector<f64, N>,
        exposure: MonoNs,
        noise: &mut impl FnMut(usize) -> f64,
    ) -> Measurement {
        let camera = &self.config.camera;
        let X_CO = camera.mount.X_WC(&self.robot, q).inv_mul(&self.config.X_WO().unwrap());
        let points = self.config.target.points().iter().map(|point| point.p_O).collect::<Vec<_>>();
        let mut m = Measurement { exposure, feature_count: points.len() as u32, ..Measurement::default() };
        m.status = TargetStatus::Found as u32;
        for (i, (f, p_O)) in m.features.iter_mut().zip(points).enumerate() {
            let p = X_CO * p_O;
            let px = camera.model.project(&p).unwrap();
            let i_px = camera.model.intrinsics();
            let (dx, dy) = (noise(2 * i) / i_px.fx_px, noise(2 * i + 1) / i_px.fy_px);
            let (x, y) = (p.x / p.z + dx, p.y / p.z + dy);
            *f = FeaturePoint { id: i as u64, u_px: px.x, v_px: px.y, x, y, sd_px: 0.05 };
        }
        m.set_pose(&X_CO);
        m
    }

    fn recording(&self, errors: CameraErrors) -> Recording<N> {
        let mut recording = Recording::default();
        let mut noise = Noise(errors.seed);
        for _ in 0..10 {
            noise.even();
        }
        for frame in 0..200 {
            let t = frame as f64 * 0.04;
            let stamp_s = t + errors.late_s + errors.jitter_s * noise.normal();
            let stamp = MonoNs(SpanNs::from_s(stamp_s).0);
            let off = if errors.outliers && frame % 17 == 3 { 20.0 } else { 0.0 };
            let m = self.seen(&self.joints(t).0, stamp, &mut |_| errors.noise_px * noise.normal() + off);
            recording.note_measurement(&m);
        }
        for k in 0..=(DURATION_S * 1e3) as i64 + 100 {
            let (q, qd) = self.joints(k as f64 * 1e-3);
            let mut state = JointState { stamp: MonoNs(k * 1_000_000), ..JointState::default() };
            for i in 0..N {
                (state.q[i], state.qd[i]) = (q[i], qd[i]);
            }
            recording.note_state(&state);
        }
        recording
    }

    fn cell_with<R>(&self, mount: &Mount, use_cell: impl FnOnce(&KnownCell<'_, N>) -> R) -> R {
        let i = self.config.camera.model.intrinsics();
        let points = self.config.target.points().iter().map(|point| point.p_O).collect::<Vec<_>>();
        use_cell(&KnownCell {
            robot: &self.robot,
            mount,
            f_px: Vector2::new(i.fx_px, i.fy_px),
            points: &points,
        })
    }

    fn found(&self, recording: &Recording<N>) -> Result<StampOffset, LatencyError> {
        self.cell_with(&self.config.camera.mount, |cell| stamp_offset(cell, recording))
    }

    fn check(&self) {
        for late_ms in [-40.0, -7.3, 0.0, 12.6, 40.0] {
            let found = self.found(&self.recording(CameraErrors { late_s: late_ms * 1e-3, ..GOOD })).unwrap();
            let off_ms = found.offset_s * 1e3 + late_ms;
            assert!(off_ms.abs() < 0.2, "{late_ms}: {off_ms} ms {found:?}");
            assert!(found.sd_s < 1e-4 && off_ms.abs() < 5e3 * found.sd_s, "{late_ms}: {off_ms} ms {found:?}");
            assert!((found.rms_after_px / (0.05 * 2f64.sqrt()) - 1.0).abs() < 0.05, "{found:?}");
            assert!(found.rms_before_px >= found.rms_after_px && found.frames == 200, "{found:?}");
        }
    }

    /// A hand-eye pose that is 5 mm and 1 degree off.
    fn check_with_wrong_mount(&self, direction: [f64; 6]) {
        let [x, y, z, i, j, k] = direction;
        let (p, r) = (Vector3::new(x, y, z).normalize() * 0.005, Vector3::new(i, j, k).normalize());
        let off = Pose::new(p, r * 1f64.to_radians());
        let mount = self.config.camera.mount;
        let mount = mount.with_pose(mount.pose() * off);
        let recording = self.recording(CameraErrors { late_s: 0.01, ..GOOD });
        let found = self.cell_with(&mount, |cell| stamp_offset(cell, &recording)).unwrap();
        assert!((found.offset_s + 0.01).abs() < 5e-4, "{found:?}");
    }
}

fn limits<const N: usize>(robot: &Robot<N>) -> MotionLimits<N> {
    MotionLimits {
        lower: SVector::from_fn(|i, _| robot.limits()[i].lower),
        upper: SVector::from_fn(|i, _| robot.limits()[i].upper),
        velocity: SVector::from_fn(|i, _| robot.limits()[i].velocity),
        acceleration: SVector::repeat(10.0),
        jerk: SVector::repeat(500.0),
    }
}

#[test]
fn offsets_of_every_kind_of_cell_are_found() {
    ArmScene::<4>::of("default.toml").check();
    ArmScene::<6>::of("ur5.toml").check();
    ArmScene::<7>::of("panda.toml").check();
    ArmScene::<2>::of("pan_tilt.toml").check();
    ArmScene::<4>::of("scara-eye-to-hand.toml").check();
}

#[test]
fn the_standard_deviation_is_honest() {
    let scene = ArmScene::<4>::of("default.toml");
    // Noise of the points, and stamps that vary from frame to frame: these move all points of a frame together.
    for jitter_s in [0.0, 1e-3] {
        let seeds = 60;
        let squares = (0..seeds).map(|seed| {
            let found = scene.found(&scene.recording(CameraErrors { jitter_s, seed, ..GOOD })).unwrap();
            (found.offset_s / found.sd_s).powi(2)
        });
        let mean = squares.sum::<f64>() / seeds as f64;
        assert!((0.6..1.6).contains(&mean), "jitter {jitter_s}: {mean}");
    }
}

#[test]
fn a_wrong_hand_eye_pose_is_not_taken_for_a_delay() {
    for direction in
        [[1.0, 1.0, 1.0, 1.0, 1.0, 1.0], [1.0, -1.0, 0.2, -0.3, 1.0, 0.1], [-0.1, 0.3, 1.0, 1.0, -1.0, 2.0]]
    {
        ArmScene::<4>::of("default.toml").check_with_wrong_mount(direction);
        ArmScene::<6>::of("ur5.toml").check_with_wrong_mount(direction);
        ArmScene::<4>::of("scara-eye-to-hand.toml").check_with_wrong_mount(direction);
    }
}

#[test]
fn frames_that_are_off_do_not_spoil_it() {
    let scene = ArmScene::<6>::of("ur5.toml");
    let found =
        scene.found(&scene.recording(CameraErrors { late_s: -0.02, outliers: true, ..GOOD })).unwrap();
    assert!((found.offset_s - 0.02).abs() < 2e-4, "{found:?}");
}

#[test]
fn features_without_sd_and_frames_without_pose_are_used() {
    let scene = ArmScene::<4>::of("default.toml");
    let mut recording = scene.recording(CameraErrors { late_s: 0.015, ..GOOD });
    let whole = recording.observations.clone();
    for observation in recording.observations.iter_mut().skip(1) {
        observation.X_CO = None;
    }
    assert!((scene.found(&recording).unwrap().offset_s + 0.015).abs() < 2e-4);
    recording.observations = whole.iter().map(|s| s.with_sd_px(0.0)).collect();
    assert!((scene.found(&recording).unwrap().offset_s + 0.015).abs() < 2e-4);
}

#[test]
fn what_cannot_be_found_is_told() {
    let mut scene = ArmScene::<4>::of("default.toml");
    let error = |scene: &ArmScene<4>, recording: &Recording<4>| scene.found(recording).unwrap_err();
    let good = scene.recording(GOOD);

    let few = Recording { observations: good.observations[..10].to_vec(), ..good.clone() };
    assert_eq!(error(&scene, &few), LatencyError::TooFewFrames { found: 10, needed: MIN_FRAMES });
    let blind = Recording { track: super::super::JointTrack::default(), ..good.clone() };
    assert!(matches!(error(&scene, &blind), LatencyError::TooFewFrames { .. }));

    let mut without_pose = good.clone();
    without_pose.observations.iter_mut().for_each(|s| s.X_CO = None);
    assert_eq!(error(&scene, &without_pose), LatencyError::NoPose);

    for late_s in [0.4, -0.4] {
        let far = scene.recording(CameraErrors { late_s, ..GOOD });
        assert!(matches!(error(&scene, &far), LatencyError::OutOfRange { .. }), "{:?}", scene.found(&far));
    }

    // The joints of another motion than the camera saw.
    let amplitude = scene.amplitude;
    scene.amplitude = SVector::from_fn(|i, _| amplitude[(i + 1) % 4] * if i == 2 { 0.0 } else { -1.0 });
    let other = Recording { observations: good.observations.clone(), ..scene.recording(GOOD) };
    let found = error(&scene, &other);
    assert!(
        matches!(found, LatencyError::NotFollowing { .. } | LatencyError::OutOfRange { .. }),
        "{found:?}"
    );

    scene.amplitude = SVector::zeros();
    let standing = scene.recording(GOOD);
    assert!(matches!(error(&scene, &standing), LatencyError::TooLittleMotion { .. }));

    scene.amplitude = amplitude * 0.2;
    let faint = scene.recording(CameraErrors { noise_px: 0.5, ..GOOD });
    let found = error(&scene, &faint);
    assert!(matches!(found, LatencyError::Uncertain { .. } | LatencyError::NotFollowing { .. }), "{found:?}");
}
