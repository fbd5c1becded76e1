//! Runs of a UR5 before four points, whose truth is drawn from the prior.

use super::unknowns::{PRIOR, mount_of};
use super::*;
use crate::calibration::lens_check::lens_at;
use crate::camera_model::{CameraModel, Distortion, Intrinsics};
use crate::geometry::{Pose, integrate_body_twist};
use crate::linalg::Random;
use crate::pose::{Correspondence3, refine_3d};
use crate::robot::{Mount, Robot};
use crate::time::MonoNs;
use nalgebra::{Point3, SVector, Vector2, Vector3, Vector5};

const NOISE_PX: f64 = 0.05;

fn camera() -> CameraModel {
    let i =
        Intrinsics { fx_px: 800.0, fy_px: 800.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
    CameraModel::new(i, Distortion { k1: -0.15, ..Distortion::default() }).unwrap()
}

fn arm() -> (Robot<6>, SVector<f64, 6>) {
    let robot = crate::robot::load("ur5").unwrap().build::<6>().unwrap();
    (robot, SVector::from([0.4617, -1.7204, 1.4481, -1.2809, -1.8176, 0.9664]))
}

/// What is true of a cell.
struct TrueCell {
    camera: CameraModel,
    mount: Mount,
    stamps_s: f64,
    size: f64,
}

/// The run of an arm that moves each joint by `amplitude` rad about where the target is half a metre before its camera.
fn run(truth: &TrueCell, told: &Mount, amplitude: f64, random: &mut Random) -> RunViews<6> {
    let (robot, q) = arm();
    let joints = |s: f64| {
        let at = |i: usize| amplitude * ((0.7 + 0.31 * i as f64) * s + i as f64).sin();
        let rate = |i: usize| {
            let w = 0.7 + 0.31 * i as f64;
            amplitude * w * (w * s + i as f64).cos()
        };
        let share = |i: usize| if i < 3 { 0.25 } else { 1.0 };
        (q + SVector::from_fn(|i, _| share(i) * at(i)), SVector::from_fn(|i, _| share(i) * rate(i)))
    };
    let corners = [(-0.06, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)];
    let points = corners.map(|(x, y)| Point3::new(x, y, 0.0));
    let X_WO = told.X_WC(&robot, &q) * Pose::new(Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.4, 0.2, 0.1));
    let mut run = RunViews::default();
    for ms in 0..6000 {
        let (q, qd) = joints(f64::from(ms) * 1e-3);
        run.track.push(MonoNs(i64::from(ms) * 1_000_000), q, qd);
    }
    for frame in 5..145 {
        let s = f64::from(frame) * 0.04;
        let X_CO = truth.mount.X_WC(&robot, &joints(s).0).inv_mul(&X_WO);
        let seen = points.iter().filter_map(|p| {
            let px = truth.camera.project(&(X_CO * Point3::from(p.coords * truth.size)))?;
            let noise = Vector2::new(random.gaussian(), random.gaussian()) * NOISE_PX;
            truth.camera.contains(&px, 0.0).then_some(SeenPoint { p_O: *p, px: px + noise, sd_px: NOISE_PX })
        });
        let points: Vec<_> = seen.collect();
        if points.len() == 4 {
            // Stamps that are late by tau need -tau.
            let stamp = MonoNs(((s - truth.stamps_s) * 1e9) as i64);
            run.note_view(SeenView { stamp, points, X_CO });
        }
    }
    run
}

fn drawn(told: &Mount, random: &mut Random) -> TrueCell {
    loop {
        let mut at = SVector::<f64, 19>::from_fn(|k, _| PRIOR[k] * random.gaussian());
        at.fixed_rows_mut::<6>(11).fill(0.0);
        // Half of the draws that are farther off would turn the target out of view. Some lenses that are drawn are none.
        if let Some(camera) = lens_at(&camera(), &Vector5::from(at.fixed_rows::<5>(0))) {
            return TrueCell { camera, mount: mount_of(told, &at), stamps_s: at[17], size: at[18].exp() };
        }
    }
}

fn mount() -> Mount {
    Mount::EyeInHand { X_EC: Pose::new(Vector3::new(0.02, -0.03, 0.05), Vector3::new(0.1, -0.05, 0.3)) }
}

#[test]
fn what_is_refined_is_within_its_covariance() {
    let mut random = Random::new(11);
    let (robot, _) = arm();
    let (told, lens) = (mount(), camera());
    let (mut sum, mut draws) = (0.0, 0.0);
    for _ in 0..24 {
        let truth = drawn(&told, &mut random);
        let run = run(&truth, &told, 0.3, &mut random);
        let cell = RunCell { robot: &robot, mount: &told, camera: &lens };
        let found = fit_run(&cell, &run).and_then(|fit| fit.refinement()).unwrap();
        let chi = found
            .chi_square((&lens, &told), (&truth.camera, &truth.mount), truth.stamps_s, truth.size)
            .unwrap();
        // A chi-square with 13 degrees of freedom exceeds 42 in one of 15 000 cases.
        assert!(chi < 42.0, "{chi}: {}", found.to_text());
        assert!(found.rms_after_px < 0.12, "{}", found.to_text());
        assert!(found.numbers.iter().any(|n| n.is_seen));
        (sum, draws) = (sum + chi, draws + 1.0);
    }
    // The mean of 24 such numbers is 13 +- 1.
    assert!((9.0..17.0).contains(&(sum / draws)), "{}", sum / draws);
}

/// Where the run has ended, a law would have brought the pose that is measured by the told lens and size to the goal: the true error is that between the two.
#[test]
fn the_true_error_at_the_end_is_within_its_bound() {
    let mut random = Random::new(23);
    let (robot, q) = arm();
    let (told, lens) = (mount(), camera());
    let cell = RunCell { robot: &robot, mount: &told, camera: &lens };
    let (mut within, mut draws, mut bounds) = ([0, 0], 0, Vec::new());
    for k in 0..48 {
        let right = k % 4 == 0;
        let truth = if right {
            TrueCell { camera: lens, mount: told, stamps_s: 0.0, size: 1.0 }
        } else {
            drawn(&told, &mut random)
        };
        let mut run = run(&truth, &told, 0.15, &mut random);
        run.views.truncate(30);
        let last = run.views.last().unwrap().clone();
        let pairs: Vec<_> =
            last.points.iter().map(|p| Correspondence3 { r: p.p_O, s: lens.normalized_of(&p.px) }).collect();
        let X_DO = refine_3d(&last.X_CO, &pairs, 0.0).unwrap().X_CO;
        let at_end = run.track.at(last.stamp, truth.stamps_s).unwrap().0;
        let end = fit_run(&cell, &run).unwrap().end_pose((&at_end, &X_DO));
        let off = X_DO * last.X_CO.inverse();
        within[0] += u32::from(off.translation.vector.norm() <= end.position_bound_m);
        within[1] += u32::from(off.rotation.angle() <= end.angle_bound_rad);
        draws += 1;
        if right {
            bounds.push(end.position_bound_m);
        }
    }
    // Of 48 at 95 % fewer than 42 are within once in fifty times.
    assert!(within.iter().all(|n| *n >= 42), "{within:?} of {draws}");
    // Half a metre before the target a prior alone of 10 % of the focal length and 5 % of the size would be 110 mm.
    bounds.sort_by(f64::total_cmp);
    assert!(bounds[bounds.len() / 2] < 0.02, "{bounds:?}");
    let empty = RunViews::default();
    let nothing = fit_run(&cell, &empty).map(|fit| fit.end_pose((&q, &Pose::identity())));
    assert!(matches!(nothing, Err(RunRefinementError::TooFewViews { .. })), "{nothing:?}");
}

#[test]
fn a_wide_motion_shows_all_and_a_small_coarse_one_does_not() {
    let mut random = Random::new(5);
    let (robot, _) = arm();
    let (told, lens) = (mount(), camera());
    let truth = TrueCell { camera: lens, mount: told, stamps_s: 0.0, size: 1.0 };
    let cell = RunCell { robot: &robot, mount: &told, camera: &lens };
    let mut seen = |amplitude: f64, sd_px: f64| {
        let mut run = run(&truth, &told, amplitude, &mut random);
        run.views.iter_mut().flat_map(|view| &mut view.points).for_each(|point| point.sd_px = sd_px);
        let found = fit_run(&cell, &run).and_then(|fit| fit.refinement()).unwrap();
        (found.numbers.iter().filter(|n| n.is_seen).count(), found.to_text())
    };
    let (wide, text) = seen(0.3, NOISE_PX);
    assert!(wide >= 11, "{text}");
    // Forty times the noise is stated: every standard deviation grows until the prior stops it.
    let (small, text) = seen(0.02, 2.0);
    assert!(small < wide && text.contains("not seen by this run: "), "{text}");
}

#[test]
fn a_run_at_rest_and_another_arm_are_refused() {
    let mut random = Random::new(3);
    let (robot, _) = arm();
    let (told, lens) = (mount(), camera());
    let truth = TrueCell { camera: lens, mount: told, stamps_s: 0.0, size: 1.0 };
    let cell = RunCell { robot: &robot, mount: &told, camera: &lens };
    let rests = fit_run(&cell, &run(&truth, &told, 0.0, &mut random)).and_then(|fit| fit.refinement());
    assert!(matches!(rests, Err(RunRefinementError::TooFewViews { .. })), "{rests:?}");
    let mut moved = run(&truth, &told, 0.3, &mut random);
    let count = moved.views.len();
    for (i, view) in moved.views.iter_mut().enumerate() {
        view.points.iter_mut().for_each(|p| p.px.x += 200.0 * (i as f64 / count as f64 * 9.0).sin());
    }
    let moved = fit_run(&cell, &moved).and_then(|fit| fit.refinement());
    assert!(matches!(moved, Err(RunRefinementError::Unexplained { .. })), "{moved:?}");
}

/// A target that was pushed by a millimetre on the way, by a centimetre or by a hair: what lens, mount and size are then said to be is no nearer to the truth than it is said to be.
#[test]
fn a_target_that_was_pushed_is_no_certainty() {
    let mut random = Random::new(9);
    let (robot, _) = arm();
    let (told, lens) = (mount(), camera());
    let truth = TrueCell { camera: lens, mount: told, stamps_s: 0.0, size: 1.0 };
    let cell = RunCell { robot: &robot, mount: &told, camera: &lens };
    let mut refused = 0;
    for push_px in [0.3, 1.0, 3.0, 20.0] {
        for amplitude in [0.1, 0.3] {
            let mut pushed = run(&truth, &told, amplitude, &mut random);
            let half = pushed.views.len() / 2;
            pushed
                .views
                .iter_mut()
                .skip(half)
                .flat_map(|view| &mut view.points)
                .for_each(|p| p.px.x += push_px);
            let Ok(found) = fit_run(&cell, &pushed).and_then(|fit| fit.refinement()) else {
                refused += 1;
                continue;
            };
            for number in &found.numbers {
                let sds = (number.refined - number.told).abs() / number.sd;
                assert!(sds < 5.0, "{push_px} px, {amplitude}: {} is off by {sds:.1} sd", number.key);
            }
        }
    }
    assert!(refused >= 2, "what is far beyond what points state is refused: {refused}");
}

#[test]
fn twists_are_found_again() {
    let mut random = Random::new(2);
    for angle in [0.0, 1e-8, 0.3, 2.0] {
        let w = Vector3::new(random.gaussian(), random.gaussian(), random.gaussian()).normalize() * angle;
        let xi = crate::geometry::Twist::new(0.1, -0.2, 0.3, w.x, w.y, w.z);
        let X = integrate_body_twist(&Pose::identity(), &xi, 1.0);
        let found = SVector::<f64, 6>::from(refinement::log_of(&X));
        assert!((found - xi).amax() < 1e-9, "{found} {xi}");
    }
}

/// A mark whose rim is covered for a while, of a cell that is as told: all numbers are as told without it, and only without it. A lens or a mount that is another one stays so without any mark.
#[test]
fn a_mark_that_is_covered_in_part_is_no_lens() {
    let mut random = Random::new(37);
    let (robot, _) = arm();
    let (told, lens) = (mount(), camera());
    let cell = RunCell { robot: &robot, mount: &told, camera: &lens };
    let (mut contradicted, mut found, mut lens_kept) = (0, 0, 0);
    for k in 0..20 {
        let exact = TrueCell { camera: lens, mount: told, stamps_s: 0.0, size: 1.0 };
        let mut covered = run(&exact, &told, 0.15, &mut random);
        covered.views.truncate(30);
        assert_eq!(odd_point(&cell, &covered, 4.0), None, "nothing is covered");
        let odd = covered.views[0].points[k % 4].p_O;
        for point in covered.views[4..22].iter_mut().flat_map(|view| &mut view.points) {
            if point.p_O == odd {
                point.px += Vector2::new(0.7, -0.4);
            }
        }
        let all = fit_run(&cell, &covered).and_then(|fit| fit.refinement()).unwrap();
        contradicted += u32::from(all.contradicts(4.0));
        found += u32::from(odd_point(&cell, &covered, 4.0) == Some(odd));
        let longer = lens_at(&lens, &Vector5::new(0.05, 0.0, 0.0, 0.0, 0.0)).unwrap();
        let mut other = run(&TrueCell { camera: longer, ..exact }, &told, 0.15, &mut random);
        other.views.truncate(30);
        lens_kept += u32::from(odd_point(&cell, &other, 4.0).is_none());
    }
    // Where all points contradict nothing there is nothing to look for.
    assert!(contradicted >= 8 && found + 2 >= contradicted, "{found} of {contradicted}");
    assert!(lens_kept >= 18, "{lens_kept} of 20");
}
