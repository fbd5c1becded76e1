use super::*;
use crate::camera_model::{Distortion, Intrinsics};
use crate::geometry::{rotation_x, rotation_y, rotation_z};
use crate::target::{DotGrid, FourDots};
use crate::time::SpanNs;
use nalgebra::{Rotation3, Translation3, UnitQuaternion};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

fn camera(width_px: u32, height_px: u32, f: f64, distortion: Distortion) -> CameraModel {
    let (cx_px, cy_px) = (f64::from(width_px) * 0.5 - 0.5, f64::from(height_px) * 0.5 - 0.5);
    CameraModel::new(Intrinsics { fx_px: f, fy_px: f, cx_px, cy_px, width_px, height_px }, distortion)
        .unwrap()
}

/// What the image shows.
struct Shown {
    target: Target,
    occluder: Option<Occluder>,
}

fn square() -> Shown {
    Shown { target: FourDots::default().into(), occluder: None }
}

fn renderer(camera: CameraModel, sensor: SensorModel) -> Renderer {
    Renderer::new(camera, FourDots::default(), SceneLook::default(), sensor).unwrap()
}

fn pose(R: Rotation3<f64>, x: f64, y: f64, z: f64) -> Pose {
    let R = UnitQuaternion::from_rotation_matrix(&R);
    // the square's middle, not its corner, on the optical axis
    Pose::from_parts(Translation3::new(x, y, z), R) * Translation3::new(-0.05, -0.05, 0.0)
}

/// Every pixel as the mean of 16 x 16 rays.
fn brute_force(camera: &CameraModel, Shown { target, occluder }: &Shown, X_CO: &Pose) -> Vec<f64> {
    let look = SceneLook::default();
    let plate = target.plate();
    let inside = |r: Vector2<f64>, low: Vector2<f64>, high: Vector2<f64>| {
        r.x > low.x && r.x < high.x && r.y > low.y && r.y < high.y
    };
    let X_OC = X_CO.inverse();
    let origin = X_OC.translation.vector;
    let mut out = Vec::new();
    for y in 0..camera.intrinsics().height_px {
        for x in 0..camera.intrinsics().width_px {
            let mut sum = 0.0;
            for i in 0..256 {
                let u = f64::from(x) + (f64::from(i % 16) + 0.5) / 16.0 - 0.5;
                let v = f64::from(y) + (f64::from(i / 16) + 0.5) / 16.0 - 0.5;
                let s = camera.normalized_of(&Vector2::new(u, v));
                let d = X_OC.rotation * nalgebra::Vector3::new(s.x, s.y, 1.0);
                // the sheet lies above the side with the dots, where z_O is negative
                let covered = occluder.filter(|o| {
                    let t = (-o.height_m - origin.z) / d.z;
                    let r = (origin + d * t).xy();
                    t > 0.0 && inside(r, o.centre_m - o.size_m / 2.0, o.centre_m + o.size_m / 2.0)
                });
                if let Some(occluder) = covered {
                    sum += occluder.level;
                    continue;
                }
                let t = -origin.z / d.z;
                let r = (origin + d * t).xy();
                let on_plate = t > 0.0 && inside(r, plate.low_m, plate.high_m);
                let in_dot = target.discs().iter().any(|m| (r - m.centre_m).norm() < m.radius_m);
                sum += match (on_plate, in_dot && origin.z < 0.0) {
                    (false, _) => look.background,
                    (true, false) => look.plate,
                    (true, true) => look.dots,
                };
            }
            out.push(sum / 256.0);
        }
    }
    out
}

fn compare(camera: CameraModel, shown: &Shown, X_CO: &Pose) {
    let Shown { target, occluder } = shown;
    let mut r = Renderer::new(camera, target.clone(), SceneLook::default(), SensorModel::ideal()).unwrap();
    r.occlude(*occluder);
    let i = *camera.intrinsics();
    let mut image = vec![0u8; (i.width_px * i.height_px) as usize];
    r.render(&[*X_CO], 0, &mut image);
    let wanted = brute_force(&camera, shown, X_CO);
    let plate = target.plate();
    let sheet = occluder.map(|o| (o.centre_m - o.size_m / 2.0, o.centre_m + o.size_m / 2.0, -o.height_m));
    let corners: Vec<_> = [(plate.low_m, plate.high_m, 0.0)]
        .into_iter()
        .chain(sheet)
        .flat_map(|(low, high, z)| {
            [(low.x, low.y), (low.x, high.y), (high.x, low.y), (high.x, high.y)].map(|(x, y)| (x, y, z))
        })
        .map(|(x, y, z)| camera.project(&(X_CO * nalgebra::Point3::new(x, y, z))))
        .collect();
    let mut off = 0;
    for (k, (&got, &want)) in image.iter().zip(&wanted).enumerate() {
        let error = (f64::from(got) - want).abs();
        let (x, y) = (k % i.width_px as usize, k / i.width_px as usize);
        // 190 levels * ~0.02 (the reference's own sampling error is up to 0.03) and rounding; at the plate's
        // corners coverage is the product of two edges, which is wrong where the corner is acute
        let at_corner = corners.iter().flatten().any(|c| (c - Vector2::new(x as f64, y as f64)).amax() < 2.0);
        assert!(error < if at_corner { 140.0 } else { 60.0 }, "{x} {y}: {got} instead of {want} at {X_CO}");
        off += usize::from(error > 7.0);
    }
    // more rims, more pixels in which two of them meet
    let most = 16 + target.discs().len() / 4;
    assert!(off <= most, "{off} pixels differ at {X_CO}");
}

#[test]
fn image_is_that_of_brute_force() {
    let ideal = camera(160, 120, 150.0, Distortion::default());
    let bent = camera(160, 120, 130.0, Distortion { k1: -0.2, k2: 0.02, p1: 0.002, p2: -0.001, k3: 0.0 });
    for camera in [ideal, bent] {
        for X_CO in [
            pose(Rotation3::identity(), 0.0, 0.0, 0.3),
            pose(rotation_z(0.5) * rotation_x(0.7), 0.02, 0.0, 0.25),
            pose(rotation_z(2.5) * rotation_y(-0.9), 0.0, 0.03, 0.3),
            // partly out of view, very close, dots larger than the image, edges behind the camera, the back
            pose(rotation_z(1.0), 0.15, -0.08, 0.3),
            pose(rotation_z(0.3) * rotation_x(0.2), 0.05, 0.05, 0.02),
            pose(rotation_x(1.4), 0.0, 0.05, 0.06),
            pose(rotation_y(1.5), 0.01, 0.0, 0.08),
            pose(rotation_x(2.8), 0.0, 0.0, 0.3),
            pose(Rotation3::identity(), 0.0, 0.0, -0.3),
        ] {
            compare(camera, &square(), &X_CO);
        }
    }
}

#[test]
fn grids_and_occluders_agree_with_brute_force() {
    let sheet = |x: f64, y: f64, height_m: f64| Occluder {
        centre_m: Vector2::new(x, y),
        size_m: Vector2::new(0.05, 0.08),
        height_m,
        level: 140.0,
        from: SpanNs::ZERO,
        until: SpanNs(1),
    };
    let grid = |columns, rows, pitch_m| Target::from(DotGrid::with_pitch(columns, rows, pitch_m).unwrap());
    let ideal = camera(160, 120, 150.0, Distortion::default());
    let bent = camera(160, 120, 130.0, Distortion { k1: -0.2, k2: 0.02, p1: 0.002, p2: -0.001, k3: 0.0 });
    for (camera, target) in [
        (ideal, FourDots::default().into()),
        (bent, grid(4, 3, 0.03)),
        // more dots than bits in a mask
        (ideal, grid(9, 8, 0.012)),
    ] {
        for occluder in [None, Some(sheet(0.02, 0.03, 0.0)), Some(sheet(0.1, 0.02, 0.05))] {
            let shown = Shown { target: target.clone(), occluder };
            for X_CO in [
                pose(rotation_z(0.5) * rotation_x(0.7), 0.02, 0.0, 0.25),
                pose(rotation_z(2.5) * rotation_y(-0.5), 0.0, 0.03, 0.2),
                pose(rotation_x(0.2), 0.05, -0.02, 0.15),
            ] {
                compare(camera, &shown, &X_CO);
            }
        }
    }
}

/// Dots that are seen so obliquely that they are thinner than a pixel. The closed form for wider dots was wrong there by a third of the contrast.
#[test]
fn thin_dots_are_those_of_brute_force() {
    let bent = camera(96, 64, 80.0, Distortion { k1: -0.2, ..Distortion::default() });
    let R = rotation_z(0.508_748_267_204_759)
        * rotation_y(2.971_047_545_855_746)
        * rotation_x(-1.683_579_476_455_303_6);
    compare(bent, &square(), &pose(R, 0.0, 0.028_875_049_516_836_934, 0.270_377_005_423_554));
}

proptest! {
    // The poses are always the same, so that only a change of the code can make it fail.
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(10), ..ProptestConfig::with_cases(24) })]
    #[test]
    fn any_pose_is_rendered_right(
        a in -3.1..3.1f64, b in -3.1..3.1f64, c in -3.1..3.1f64,
        x in -0.2..0.2f64, y in -0.2..0.2f64, z in -0.1..0.3f64, bent in any::<bool>(),
    ) {
        let k1 = if bent { -0.2 } else { 0.0 };
        let camera = camera(96, 64, 80.0, Distortion { k1, ..Distortion::default() });
        let X_CO = pose(rotation_z(a) * rotation_y(b) * rotation_x(c), x, y, z);
        // Seen along its plane the plate is thinner than a pixel: two edges in one, which the product does not give.
        let middle = (X_CO * nalgebra::Point3::new(0.05, 0.05, 0.0)).coords;
        let normal = X_CO.rotation * nalgebra::Vector3::z();
        prop_assume!(middle.normalize().dot(&normal).abs() > 0.2);
        // Past the angle at which r (1 + k1 r^2) turns back the bent lens has no image. A plate that reaches beyond it, out of
        // the frame, may have its edge wrong by a third of a pixel inside: a known limit of the renderer.
        let (low, high) = (FourDots::default().plate().low_m.x, FourDots::default().plate().high_m.x);
        let past_the_turn = [(low, low), (low, high), (high, high), (high, low)].into_iter().any(|(px, py)| {
            let p = X_CO * nalgebra::Point3::new(px, py, 0.0);
            bent && p.z > 0.0 && (p.x.powi(2) + p.y.powi(2)) / p.z.powi(2) > 1.0 / (3.0 * 0.2)
        });
        prop_assume!(!past_the_turn);
        compare(camera, &square(), &X_CO);
    }

    #[test]
    fn wild_poses_never_panic(
        p in prop::array::uniform3(prop::num::f64::ANY), w in prop::array::uniform3(-10.0..10.0f64),
    ) {
        let mut r = renderer(camera(64, 48, 60.0, Distortion { k1: -0.2, ..Distortion::default() }), SensorModel::default());
        let mut image = vec![0; 64 * 48];
        r.render(&[Pose::new(p.into(), w.into()), Pose::identity()], 0, &mut image);
    }
}

#[test]
fn the_mean_is_that_of_a_division() {
    for count in 1..=64usize {
        let mean = Mean::of(count);
        let divided = |sum: u32| ((sum + count as u32 / 2) / count as u32) as u16;
        let most = count as u32 * u32::from(fixed(255.0));
        for sum in (0..=most).step_by(1 + most as usize / 5_000).chain([most]) {
            assert_eq!(mean.rounded(sum), divided(sum), "{sum} of {count}");
        }
        for level in (0..u32::from(fixed(255.0))).step_by(97) {
            for sum in (count as u32 * level).saturating_sub(2)..=count as u32 * level + 2 {
                assert_eq!(mean.rounded(sum), divided(sum), "{sum} of {count}");
            }
        }
    }
}

#[test]
fn same_input_same_bytes() {
    let camera = camera(320, 240, 300.0, Distortion { k1: -0.1, ..Distortion::default() });
    let sensor = SensorModel { noise_sd_levels: 3.0, ..SensorModel::default() };
    let (mut one, mut two) = (renderer(camera, sensor), renderer(camera, sensor));
    let poses = [pose(rotation_z(0.4), 0.0, 0.0, 0.5), pose(rotation_z(0.41), 0.001, 0.0, 0.5)];
    let (mut a, mut b) = (vec![0; 320 * 240], vec![0; 320 * 240]);
    one.render(&poses, 5, &mut a);
    // other work in between must leave no trace
    two.render(&[pose(rotation_x(0.5), 0.1, 0.0, 0.2)], 4, &mut b);
    two.render(&poses, 5, &mut b);
    assert_eq!(a, b);
    two.render(&poses, 6, &mut b);
    assert_ne!(a, b);
}

#[test]
fn wide_and_narrow_give_the_same_bytes() {
    let sensor = SensorModel { noise_sd_levels: 2.0, ..SensorModel::default() };
    for distortion in [Distortion::default(), Distortion { k1: -0.2, k2: 0.05, ..Distortion::default() }] {
        let mut wide = renderer(camera(161, 120, 150.0, distortion), sensor);
        let mut narrow = wide.clone();
        narrow.wide = false;
        let poses =
            [0.0, 0.1, 0.2].map(|a| pose(rotation_z(0.4 + a) * rotation_x(a), 0.02 * a, 0.0, 0.25 + a));
        for (id, poses) in [&poses[..1], &poses[..2], &poses[..]].into_iter().enumerate() {
            let (mut a, mut b) = (vec![0; 161 * 120], vec![1; 161 * 120]);
            wide.render(poses, id as u64, &mut a);
            narrow.render(poses, id as u64, &mut b);
            assert!(a == b, "{} poses, {distortion:?}", poses.len());
        }
    }
}

#[test]
fn motion_blur_is_the_mean_of_the_parts() {
    let camera = camera(160, 120, 150.0, Distortion::default());
    let mut r = renderer(camera, SensorModel::ideal());
    let poses = [pose(Rotation3::identity(), 0.0, 0.0, 0.3), pose(rotation_z(0.3), 0.05, 0.0, 0.3)];
    let mut blurred = vec![0u8; 160 * 120];
    r.render(&poses, 0, &mut blurred);
    let parts = poses.map(|X_CO| {
        let mut image = vec![0u8; 160 * 120];
        r.render(&[X_CO], 0, &mut image);
        image
    });
    for ((&m, &a), &b) in blurred.iter().zip(&parts[0]).zip(&parts[1]) {
        assert!((f64::from(m) - 0.5 * (f64::from(a) + f64::from(b))).abs() <= 1.0);
    }
    // no pose: an empty scene, short buffer: no panic
    r.render(&[], 0, &mut blurred[..159]);
    r.render(&[], 0, &mut blurred);
    assert!(blurred.iter().all(|&p| p == 90));
}

#[test]
fn nonsense_is_refused() {
    let camera_vga = camera(640, 480, 600.0, Distortion::default());
    let look = SceneLook { plate: 300.0, ..SceneLook::default() };
    assert!(Renderer::new(camera_vga, FourDots::default(), look, SensorModel::default()).is_err());
    let sensor = SensorModel { noise_sd_levels: f64::NAN, ..SensorModel::default() };
    assert!(Renderer::new(camera_vga, FourDots::default(), SceneLook::default(), sensor).is_err());
    let huge = camera(5000, 100, 600.0, Distortion::default());
    assert!(Renderer::new(huge, FourDots::default(), SceneLook::default(), SensorModel::default()).is_err());
}

#[test]
fn further_targets_are_drawn_where_they_have_moved_to() {
    let camera = camera(96, 72, 90.0, Distortion::default());
    let (further, look): (Target, _) = (FourDots::default().into(), SceneLook::default());
    let still = |X_OT| {
        let one = Renderer::new(camera, FourDots::default(), look, SensorModel::ideal()).unwrap();
        one.with_further_targets([(&further, X_OT)])
    };
    let at = |x: f64| Pose::from_parts(Translation3::new(x, 0.12, 0.0), UnitQuaternion::identity());
    let X_CO = pose(rotation_z(0.2), 0.0, -0.04, 0.5);
    let mut moving = still(at(0.0));
    let mut image = |X_CO: &[Pose], X_OT: &[Pose]| {
        let mut out = vec![0; 96 * 72];
        moving.render_moving(X_CO, X_OT, 0, &mut out);
        out
    };
    let of_still = |x| {
        let mut out = vec![0; 96 * 72];
        still(at(x)).render(&[X_CO], 0, &mut out);
        out
    };
    assert_eq!(image(&[X_CO], &[at(0.03)]), of_still(0.03));
    assert_eq!(image(&[X_CO], &[at(-0.04)]), of_still(-0.04));
    assert_ne!(of_still(0.03), of_still(-0.04));
    // Two halves of an exposure, each with its place: the mean of both images.
    let both = image(&[X_CO, X_CO], &[at(0.03), at(-0.04)]);
    let (a, b) = (of_still(0.03), of_still(-0.04));
    let off = both
        .iter()
        .zip(a.iter().zip(&b))
        .map(|(m, (a, b))| (f64::from(*m) - 0.5 * (f64::from(*a) + f64::from(*b))).abs());
    assert!(off.fold(0.0, f64::max) <= 1.0, "but for rounding");
}
