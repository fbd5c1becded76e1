//! The grid of dots: every dot under its own number or not at all, whole and partly hidden, and nothing where there is none.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::rendered::{HEIGHT, Random, WIDTH, camera, noisy, process};
use nalgebra::{Matrix6, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};
use vservo::geometry::Pose;
use vservo::imaging::ImageView;
use vservo::messages::{Measurement, TargetStatus, measurement_flag};
use vservo::scene::{Occluder, Renderer, SceneLook, SensorModel};
use vservo::target::{DotGrid, FourDots, Target};
use vservo::time::SpanNs;
use vservo::vision::{Prior, Vision, VisionSettings};

/// A grid, the image of it, and who looks.
struct Bench {
    target: Target,
    middle: Vector2<f64>,
    width_m: f64,
    renderer: Renderer,
    image: Vec<u8>,
    frame_id: u64,
}

impl Bench {
    fn new(columns: usize, rows: usize, pitch_m: f64, k1: f64, sensor: SensorModel) -> Self {
        let target = Target::from(DotGrid::with_pitch(columns, rows, pitch_m).unwrap());
        let renderer = Renderer::new(camera(k1), target.clone(), SceneLook::default(), sensor).unwrap();
        let middle = Vector2::new((columns - 1) as f64, (rows - 1) as f64) * (0.5 * pitch_m);
        let width_m = columns.max(rows) as f64 * pitch_m;
        Self { target, middle, width_m, renderer, image: vec![0; WIDTH * HEIGHT], frame_id: 0 }
    }

    fn render(&mut self, X_CO: &Pose) {
        self.frame_id += 1;
        self.renderer.render(&[*X_CO], self.frame_id, &mut self.image);
    }

    /// Any pose with all of the grid in view, tilted by up to 0.9 rad about any axis.
    fn pose(&self, random: &mut Random) -> Pose {
        loop {
            let z = self.width_m * random.within(1.1, 3.0);
            let (x, y) = (random.within(-0.35, 0.35) * z, random.within(-0.25, 0.25) * z);
            let about = random.within(-3.2, 3.2);
            let axis = nalgebra::Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
            let R = UnitQuaternion::from_axis_angle(&axis, random.within(0.0, 0.9))
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.within(-3.2, 3.2));
            let X_CO = Pose::from_parts(Translation3::new(x, y, z), R)
                * Translation3::new(-self.middle.x, -self.middle.y, 0.0);
            if self.renderer.truth(&X_CO).iter().all(|px| self.renderer.camera().contains(px, 15.0)) {
                return X_CO;
            }
        }
    }

    fn vision(&self, track: bool) -> Vision {
        let settings = VisionSettings { track, ..VisionSettings::default() };
        Vision::new(*self.renderer.camera(), self.target.clone(), settings)
    }

    /// Greatest distance of a feature from the true place of the dot whose number it bears, px.
    fn worst(&self, X_CO: &Pose, m: &Measurement) -> f64 {
        let truth = self.renderer.truth(X_CO);
        let off =
            |f: &vservo::messages::FeaturePoint| (Vector2::new(f.u_px, f.v_px) - truth[f.id as usize]).norm();
        m.features().iter().map(off).fold(0.0, f64::max)
    }
}

#[test]
fn every_dot_bears_its_own_number_in_any_view() {
    let mut random = Random(11);
    for (columns, rows, pitch_m, k1) in
        [(7, 5, 0.02, 0.0), (4, 3, 0.03, -0.2), (8, 8, 0.015, -0.1), (12, 9, 0.01, 0.0)]
    {
        let mut bench = Bench::new(columns, rows, pitch_m, k1, noisy(2.0, 3));
        let mut vision = bench.vision(false);
        let (mut found, mut worst) = (0, 0.0f64);
        for _ in 0..100 {
            let X_CO = bench.pose(&mut random);
            bench.render(&X_CO);
            let m = process(&mut vision, &bench.image, bench.frame_id, &Prior::default());
            if !m.found() {
                continue;
            }
            found += 1;
            worst = worst.max(bench.worst(&X_CO, &m));
            let off = m.pose().unwrap().inv_mul(&X_CO);
            assert!(off.translation.vector.norm() < 0.01 * X_CO.translation.z, "{columns} x {rows}: {off}");
        }
        println!("{columns} x {rows}: {found} of 100 found, features within {worst:.3} px");
        assert!(found >= 95, "{columns} x {rows}: {found}");
        assert!(worst < 0.3, "{columns} x {rows}: a dot {worst} px from its place");
    }
}

#[test]
fn what_is_left_of_a_hidden_grid_bears_the_right_numbers() {
    let mut random = Random(12);
    let mut bench = Bench::new(7, 5, 0.02, -0.1, noisy(2.0, 3));
    let mut vision = bench.vision(false);
    let (mut found, mut enough, mut partial) = (0, 0, 0);
    for _ in 0..400 {
        let X_CO = bench.pose(&mut random);
        let centre_m = Vector2::new(random.within(-0.02, 0.14), random.within(-0.02, 0.1));
        let size_m = Vector2::new(random.within(0.01, 0.12), random.within(0.01, 0.1));
        let level = random.within(20.0, 230.0);
        let occluder =
            Occluder { centre_m, size_m, height_m: 0.0, level, from: SpanNs::ZERO, until: SpanNs(1) };
        bench.renderer.occlude(Some(occluder));
        bench.render(&X_CO);
        let m = process(&mut vision, &bench.image, bench.frame_id, &Prior::default());
        // dots that nothing touches
        let clear = bench.target.discs().iter().filter(|mark| {
            let gap = (mark.centre_m - centre_m).abs() - size_m / 2.0;
            gap.x.max(gap.y) > mark.radius_m + 0.002
        });
        let clear = clear.count();
        enough += usize::from(clear >= 20);
        if m.found() {
            found += usize::from(clear >= 20);
            partial += usize::from(m.flags & measurement_flag::PARTIAL != 0);
            let worst = bench.worst(&X_CO, &m);
            assert!(worst < 1.0, "a dot {worst} px from its place, {clear} clear, {occluder:?}");
        }
    }
    println!("hidden in part: {found} of {enough} with 20 and more clear dots found, {partial} in part");
    assert!(partial > 150 && found as f64 >= 0.93 * enough as f64, "{found} of {enough}, {partial}");
}

/// Squared errors of poses over their stated covariances: mean 6 where these are true.
#[test]
fn the_stated_covariance_of_a_pose_is_true() {
    let mut random = Random(13);
    let mut bench = Bench::new(7, 5, 0.02, 0.0, SensorModel { vignetting: 0.0, ..noisy(4.0, 3) });
    let mut vision = bench.vision(false);
    let (mut sum, mut count) = (0.0, 0.0);
    for _ in 0..150 {
        let X_CO = bench.pose(&mut random);
        bench.render(&X_CO);
        let m = process(&mut vision, &bench.image, bench.frame_id, &Prior::default());
        let (true, Some(found)) = (m.found(), m.pose()) else { continue };
        let turn = (X_CO.rotation * found.rotation.inverse()).scaled_axis();
        let move_m = X_CO.translation.vector - found.translation.vector;
        let e = Vector6::new(move_m.x, move_m.y, move_m.z, turn.x, turn.y, turn.z);
        let covariance = Matrix6::from_row_slice(&m.pose_covariance);
        sum += e.dot(&(covariance.try_inverse().unwrap() * e));
        count += 1.0;
    }
    let mean = sum / count / 6.0;
    println!("mean squared error over its covariance, of 6 numbers: {mean:.2}");
    assert!((0.3..3.0).contains(&mean), "{mean}");
}

#[test]
fn a_tracked_grid_goes_on_half_hidden_and_comes_back_whole() {
    let mut bench = Bench::new(7, 5, 0.02, -0.1, noisy(2.0, 3));
    let mut vision = bench.vision(true);
    let hidden = Occluder {
        centre_m: Vector2::new(0.12, 0.04),
        size_m: Vector2::new(0.11, 0.2),
        height_m: 0.0,
        level: 60.0,
        from: SpanNs::ZERO,
        until: SpanNs(1),
    };
    for k in 0..60 {
        let t = f64::from(k) * 0.01;
        let X_CO = Pose::new([-0.06 + 0.1 * t, -0.04, 0.35 + 0.1 * t].into(), [0.3 * t, 0.2, t].into());
        let covered = (10..40).contains(&k);
        bench.renderer.occlude(covered.then_some(hidden));
        bench.render(&X_CO);
        let m = process(&mut vision, &bench.image, bench.frame_id, &Prior::default());
        assert!(m.found(), "frame {k}: {:?}", m.target_status());
        assert!(bench.worst(&X_CO, &m) < 0.5, "frame {k}");
        let count = m.features().len();
        assert!(if covered { (15..=22).contains(&count) } else { count == 35 }, "frame {k}: {count}");
    }
}

#[test]
fn nothing_is_found_where_there_is_none() {
    let mut random = Random(14);
    let mut bench = Bench::new(7, 5, 0.02, 0.0, noisy(2.0, 3));
    let look_for = |target: Target| {
        Vision::new(camera(0.0), target, VisionSettings { track: false, ..VisionSettings::default() })
    };
    let grid = |columns, rows| Target::from(DotGrid::with_pitch(columns, rows, 0.02).unwrap());
    let mut others = [
        look_for(grid(8, 6)),
        look_for(grid(4, 4)),
        look_for(Target::from(FourDots::default())),
        look_for(grid(5, 7)),
    ];
    for _ in 0..20 {
        let X_CO = bench.pose(&mut random);
        bench.render(&X_CO);
        for (i, vision) in others.iter_mut().enumerate() {
            let m = process(vision, &bench.image, bench.frame_id, &Prior::default());
            assert!(!m.found(), "number {i} found in a grid of 7 x 5 at {X_CO}");
        }
    }
    // equal dots, however many
    for n in [5, 6, 9] {
        for _ in 0..12 {
            let X_CO = bench.pose(&mut random);
            let radius_m = random.within(0.002, 0.0075);
            crate::rendered::equal_dots(&camera(0.0), &X_CO, n, 0.02, radius_m, &mut bench.image);
            for vision in [&mut bench.vision(false), &mut others[0]] {
                let m = process(vision, &bench.image, 1, &Prior::default());
                assert!(m.target_status() != TargetStatus::Found, "{n} x {n} dots of {radius_m} m at {X_CO}");
            }
        }
    }
}

/// The left half of one view and the right half of another.
#[test]
fn a_grid_that_is_there_twice_is_ambiguous() {
    let mut random = Random(16);
    let mut bench = Bench::new(7, 5, 0.02, 0.0, noisy(2.0, 3));
    let mut vision = bench.vision(false);
    for _ in 0..40 {
        let mut half = |x: f64| {
            let z = random.within(0.5, 0.7);
            let about = random.within(-3.2, 3.2);
            let axis = nalgebra::Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
            let R = UnitQuaternion::from_axis_angle(&axis, random.within(0.0, 0.6))
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.within(-3.2, 3.2));
            let X_CO = Pose::from_parts(Translation3::new(x * z, random.within(-0.1, 0.1) * z, z), R)
                * Translation3::new(-bench.middle.x, -bench.middle.y, 0.0);
            bench.render(&X_CO);
            bench.image.clone()
        };
        let (mut image, right) = (half(-0.2), half(0.2));
        assert!(process(&mut vision, &image, 1, &Prior::default()).found());
        for (row, other) in image.chunks_mut(WIDTH).zip(right.chunks(WIDTH)) {
            row[WIDTH / 2..].copy_from_slice(&other[WIDTH / 2..]);
        }
        let m = process(&mut vision, &image, 1, &Prior::default());
        assert_eq!(m.target_status(), TargetStatus::Ambiguous);
    }
}

/// A grid as printed for calibrations: its dots tell no turn, so that they are numbered as the image stands. Held against the scene.
#[test]
fn equal_dots_are_found_whole_and_numbered_upright() {
    let mut random = Random(15);
    let bench = Bench::new(7, 7, 0.02, 0.0, noisy(0.0, 1));
    let camera = camera(0.0);
    let mut image = vec![0; WIDTH * HEIGHT];
    let (mut count, mut seen, mut worst) = (0, 0, 0.0f64);
    for n in [4usize, 6, 7] {
        let settings = VisionSettings { track: false, ..VisionSettings::default() };
        let mut vision = Vision::new(camera, Target::from(DotGrid::equal(n, n, 0.02).unwrap()), settings);
        let mut one_more =
            Vision::new(camera, Target::from(DotGrid::equal(n + 1, n, 0.02).unwrap()), settings);
        for _ in 0..12 {
            let X_CO = bench.pose(&mut random);
            let radius_m = random.within(0.003, 0.0065);
            crate::rendered::equal_dots(&camera, &X_CO, n, 0.02, radius_m, &mut image);
            let place = |column: usize, row: usize| {
                let p = X_CO * nalgebra::Point3::new(column as f64 * 0.02, row as f64 * 0.02, 0.0);
                camera.project(&p).unwrap()
            };
            count += 1;
            assert!(!process(&mut one_more, &image, 1, &Prior::default()).found(), "{n} at {X_CO}");
            let m = process(&mut vision, &image, 1, &Prior::default());
            if !m.found() {
                continue;
            }
            seen += 1;
            assert_eq!(m.features().len(), n * n);
            let px = |id: usize| Vector2::new(m.features()[id].u_px, m.features()[id].v_px);
            let (right, below) = (px(n - 1) - px(0), px(n * (n - 1)) - px(0));
            assert!(right.normalize().x + below.normalize().y > 0.5, "{n} at {X_CO}");
            assert!(right.perp(&below) > 0.0, "a mirror image: {n} at {X_CO}");
            // one of the four turns is the scene
            let last = n - 1;
            let off = |turn: usize| {
                let turned = |id: usize| match (turn, id % n, id / n) {
                    (0, x, y) => place(x, y),
                    (1, x, y) => place(last - y, x),
                    (2, x, y) => place(last - x, last - y),
                    (_, x, y) => place(y, last - x),
                };
                (0..n * n).map(|id| (px(id) - turned(id)).norm()).fold(0.0, f64::max)
            };
            let least = (0..4).map(off).fold(f64::INFINITY, f64::min);
            worst = worst.max(least);
            // without one dot there is no grid
            let hidden = place(n / 2, 1);
            let plate = image[..].iter().copied().max().unwrap();
            let reach =
                1.2 * (place(1, 0) - place(0, 0)).norm().max((place(0, 1) - place(0, 0)).norm()) / 2.0;
            for (i, pixel) in image.iter_mut().enumerate() {
                let d = Vector2::new((i % WIDTH) as f64, (i / WIDTH) as f64) - hidden;
                if d.norm() < reach && *pixel < plate {
                    *pixel = plate;
                }
            }
            assert!(!process(&mut vision, &image, 1, &Prior::default()).found(), "{n} at {X_CO}");
        }
    }
    println!("{seen} of {count} found, every dot within {worst:.3} px");
    assert!(seen * 20 >= count * 19 && worst < 0.3, "{seen} of {count}, {worst} px");
}

/// All dots of photographed grids.
#[test]
fn photographed_grids_are_found_whole() {
    let folder = std::path::Path::new("../shared/data/visp-dot-grid");
    if !folder.is_dir() {
        println!("skipped: no ../shared");
        return;
    }
    for name in ["grid36-01.pgm", "grid36-03.pgm"] {
        let image = image::open(folder.join(name)).unwrap().into_luma8();
        let settings = VisionSettings { track: false, ..VisionSettings::default() };
        let mut vision =
            Vision::new(camera(0.0), Target::from(DotGrid::equal(6, 6, 0.03).unwrap()), settings);
        let view = ImageView::new(image.as_raw(), image.width() as usize, image.height() as usize).unwrap();
        let still = vision.points_of(&view).unwrap();
        assert_eq!(still.found.len(), 36, "{name}");
    }
}
