//! Simulated calibrations with known truth.

use super::*;
use crate::camera_model::{CameraModel, Distortion, Equidistant, Intrinsics, Lens, LensModel};
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::pose::{Loss, PixelCorrespondence, refine_pixels};
use nalgebra::{DVector, Matrix2, Point3, UnitQuaternion, Vector2, Vector3};

const SIZE: (u32, u32) = (640, 480);
const NOISE_PX: f64 = 0.2;
const SQUARE_M: f64 = 0.03;

fn camera(lens: impl Into<Lens>, f: f64) -> CameraModel {
    let i = Intrinsics {
        fx_px: f,
        fy_px: 1.01 * f,
        cx_px: 327.0,
        cy_px: 232.0,
        width_px: SIZE.0,
        height_px: SIZE.1,
    };
    CameraModel::new(i, lens).unwrap()
}

fn bent() -> Distortion {
    Distortion { k1: -0.28, k2: 0.1, p1: 1e-3, p2: -5e-4, k3: 0.0 }
}

/// Poses of a 9x6 board that lies wholly in the image.
fn poses(camera: &CameraModel, count: usize, random: &mut Random) -> Vec<Pose> {
    let mut poses = Vec::new();
    while poses.len() < count {
        let px = Vector2::new(random.between(60.0, 580.0), random.between(50.0, 430.0));
        let ray = camera.normalized_of(&px).push(1.0);
        let (to, tilt) = (random.between(-3.1, 3.1), random.between(0.0, 0.8));
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(to.cos(), to.sin(), 0.0) * tilt)
            * UnitQuaternion::from_scaled_axis(Vector3::z() * random.between(-0.5, 0.5));
        let middle = rotation * Vector3::new(4.0 * SQUARE_M, 2.5 * SQUARE_M, 0.0);
        let X = Pose::from_parts((ray * random.between(0.25, 0.6) - middle).into(), rotation);
        let seen = |id: u32| camera.project(&(X * corner(id))).is_some_and(|px| camera.contains(&px, 3.0));
        if (0..54).all(seen) {
            poses.push(X);
        }
    }
    poses
}

fn corner(id: u32) -> Point3<f64> {
    Point3::new(f64::from(id % 9) * SQUARE_M, f64::from(id / 9) * SQUARE_M, 0.0)
}

fn view(
    camera: &CameraModel,
    X: &Pose,
    noise_px: f64,
    lift: impl Fn(&Point3<f64>) -> f64,
    random: &mut Random,
) -> BoardView {
    let point = |id: u32| {
        let p_O = corner(id);
        let noise = Vector2::new(random.gaussian(), random.gaussian()) * noise_px;
        let px = camera.project(&(X * (p_O + Vector3::z() * lift(&p_O)))).unwrap() + noise;
        BoardPoint { id, p_O, px, covariance_px2: Matrix2::identity() * 0.01 }
    };
    (0..54).map(point).collect()
}

fn views(camera: &CameraModel, poses: &[Pose], random: &mut Random) -> Vec<BoardView> {
    poses.iter().map(|X| view(camera, X, NOISE_PX, |_| 0.0, random)).collect()
}

fn settings(model: LensModel) -> CalibrationSettings {
    CalibrationSettings { drop_untold: false, ..CalibrationSettings::of(model) }
}

fn parameters(camera: &CameraModel) -> Vec<f64> {
    let i = camera.intrinsics();
    let coefficients = camera.lens().coefficients().into_iter().map(|(_, value)| value);
    [i.fx_px, i.fy_px, i.cx_px, i.cy_px].into_iter().chain(coefficients).collect()
}

const TRIALS: u32 = 200;
const DISTANCE_M: f64 = 0.5;
/// Centre, corners, an edge, and somewhere between.
const PIXELS: [[f64; 2]; 7] =
    [[319.5, 239.5], [0.0, 0.0], [639.0, 0.0], [0.0, 479.0], [639.0, 479.0], [0.0, 240.0], [500.0, 100.0]];

/// How far `found` is off at [`PIXELS`]: the free pose is here fitted by the pose refinement, to exact pixels.
fn true_errors(truth: &CameraModel, found: &CameraModel, corners: &[Point3<f64>]) -> [Vector2<f64>; 7] {
    let seen: Vec<_> = (corners.iter())
        .map(|p| PixelCorrespondence {
            r: *p,
            px: truth.project(p).unwrap(),
            covariance_px2: Matrix2::identity(),
        })
        .collect();
    let X = refine_pixels(&Pose::identity(), &seen, found, Loss::Squares).unwrap().X_CO;
    PIXELS.map(|px| {
        let px = Vector2::from(px);
        let p = Point3::from(truth.normalized_of(&px).push(1.0) * DISTANCE_M);
        found.project(&(X * p)).unwrap() - px
    })
}

/// What is predicted for pixels against 200 calibrations.
#[test]
fn predicted_uncertainty_is_that_of_200_calibrations() {
    let truth = camera(bent(), 520.0);
    let mut random = Random::new(11);
    let poses = poses(&truth, 12, &mut random);
    let model = LensModel::PlumbBob;
    let settings = CalibrationSettings {
        freedom: crate::calibration::bundle::Freedom::of(model).without(model, "k3"),
        ..settings(model)
    };
    let all_corners: Vec<Point3<f64>> =
        poses.iter().flat_map(|X| (0..54).map(move |id| X * corner(id))).collect();
    let mut scatter = [Matrix2::zeros(); 7];
    let mut predicted = [0.0; 7];
    let (mut chi_square, mut noise, mut ratio) = (0.0, 0.0, 0.0);
    for _ in 0..TRIALS {
        let views = views(&truth, &poses, &mut random);
        let found = calibrate_camera(&views, SIZE, &settings).unwrap();
        assert_eq!(found.views_used(), 12);
        let uncertainty = ProjectionUncertainty::new(&found, DISTANCE_M).unwrap();
        let errors = true_errors(&truth, &found.camera, &all_corners);
        for (((px, off), scatter), predicted) in
            PIXELS.iter().zip(errors).zip(&mut scatter).zip(&mut predicted)
        {
            *scatter += off * off.transpose() / f64::from(TRIALS);
            *predicted += uncertainty.sd_px(&Vector2::from(*px)).powi(2) / f64::from(TRIALS);
        }
        let off: Vec<f64> =
            parameters(&found.camera).iter().zip(parameters(&truth)).map(|(a, b)| a - b).collect();
        let off = DVector::from_column_slice(&off[..8]);
        chi_square += off.dot(&(found.covariance.clone().try_inverse().unwrap() * &off)) / f64::from(TRIALS);
        noise += found.noise_px / f64::from(TRIALS);
        ratio += cross_validation(&views, &found, &uncertainty).unwrap().ratio / f64::from(TRIALS);
    }
    for ((px, scatter), predicted) in PIXELS.iter().zip(&scatter).zip(predicted) {
        let (sd, predicted) = (super::uncertainty::worst_sd(scatter), predicted.sqrt());
        assert!((sd / predicted - 1.0).abs() < 0.2, "{px:?}: {sd} {predicted}");
    }
    // 8 degrees of freedom: standard error 0.28
    assert!((chi_square - 8.0).abs() < 1.0, "{chi_square}");
    assert!((noise - NOISE_PX).abs() < 0.005, "{noise}");
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
}

/// A coefficient that is there and hardly told is left out of many fits of the fisheyes, and of none of the other lenses, whose images tell it
/// better than that lenses are tame. What that does to pixels is told: never less than happens, and not much more where the coefficient is as
/// large as its neighbours.
#[test]
fn the_error_of_leaving_a_coefficient_out_is_told() {
    let plumb_bob = |k3| camera(Distortion { k3, ..bent() }, 520.0);
    let equidistant = |k3, k4| camera(Equidistant { k1: -0.02, k2: 0.01, k3, k4 }, 400.0);
    // The lens, the noise of its corners in px, and by how much more than happens may be told.
    let cases = [
        (plumb_bob(-0.01), 0.03, 1.2),
        (plumb_bob(0.03), 0.2, 1.3),
        (plumb_bob(0.08), 0.2, 1.2),
        (equidistant(-0.02, 0.01), 0.03, 1.3),
        (equidistant(0.005, 0.0), 0.08, 3.0),
        (equidistant(0.0, 0.002), 0.03, 3.0),
    ];
    let mut left_out = [0; 2];
    for (seed, (truth, noise_px, most)) in (40..).zip(&cases) {
        let mut random = Random::new(seed);
        let poses = poses(truth, 15, &mut random);
        let corners: Vec<Point3<f64>> =
            poses.iter().flat_map(|X| (0..54).map(move |id| X * corner(id))).collect();
        let settings = CalibrationSettings::of(truth.lens().model());
        let (mut happened, mut told, mut dropped) = ([0.0; 7], [0.0; 7], 0);
        for trial in 0..TRIALS {
            let views: Vec<_> =
                poses.iter().map(|X| view(truth, X, *noise_px, |_| 0.0, &mut random)).collect();
            let found = calibrate_camera(&views, SIZE, &settings).unwrap();
            dropped += found.dropped.len();
            let uncertainty = ProjectionUncertainty::new(&found, DISTANCE_M).unwrap();
            if trial == 0 {
                let halves = cross_validation(&views, &found, &uncertainty).unwrap();
                assert!((0.5..2.0).contains(&halves.ratio), "{:?}: {}", truth.lens(), halves.ratio);
                let board: Vec<_> = (0..54).map(corner).collect();
                let next = next_view(&board, &found, &uncertainty).unwrap();
                assert!(next.worst_then_px < next.worst_now_px, "{:?}", truth.lens());
            }
            let errors = true_errors(truth, &found.camera, &corners);
            for (((px, off), happened), told) in PIXELS.iter().zip(errors).zip(&mut happened).zip(&mut told) {
                *happened += off.norm_squared();
                *told += uncertainty.covariance_px2(&Vector2::from(*px)).trace();
            }
        }
        left_out[usize::from(truth.lens().model() == LensModel::Equidistant)] += dropped;
        for ((px, happened), told) in PIXELS.iter().zip(&happened).zip(told) {
            let ratio = (told / happened).sqrt();
            assert!((0.8..*most).contains(&ratio), "{:?} {px:?}: {ratio}", truth.lens());
        }
    }
    assert!(left_out[0] == 0 && left_out[1] > 100, "{left_out:?}");
}

#[test]
fn every_model_finds_its_camera() {
    let fisheye = Equidistant { k1: 0.02, k2: -0.01, k3: 0.004, k4: -0.001 };
    let rational = |name: &str| match name {
        "k1" => 0.3,
        "k4" => 0.55,
        "k5" => 0.05,
        "p1" => 1e-3,
        _ => 0.0,
    };
    let lenses = [
        (Lens::from(bent()), 520.0),
        (Lens::from(fisheye), 275.0),
        (Lens::of(LensModel::RationalPolynomial, rational), 420.0),
    ];
    for (lens, f) in lenses {
        let truth = camera(lens, f);
        let mut random = Random::new(5);
        let poses = poses(&truth, 14, &mut random);
        let exact: Vec<BoardView> =
            poses.iter().map(|X| view(&truth, X, 0.0, |_| 0.0, &mut random)).collect();
        let found = calibrate_camera(&exact, SIZE, &settings(lens.model())).unwrap();
        assert!(found.rms_px < 1e-4, "{:?}: {}", lens.model(), found.rms_px);
        for px in [[10.0, 10.0], [320.0, 240.0], [600.0, 100.0]].map(Vector2::from) {
            let off = found.camera.normalized_of(&px) - truth.normalized_of(&px);
            assert!(off.norm() < 1e-4, "{:?} {px}: {off}", lens.model());
        }
        for (X, fit) in poses.iter().zip(&found.views) {
            assert!((fit.X_CO.unwrap().translation.vector - X.translation.vector).norm() < 1e-4);
        }
        let noisy =
            calibrate_camera(&views(&truth, &poses, &mut random), SIZE, &settings(lens.model())).unwrap();
        // of 756 corners some 40 unknowns take a little
        assert!((noisy.rms_px / (NOISE_PX * 2f64.sqrt()) - 1.0).abs() < 0.12, "{}", noisy.rms_px);
    }
}

#[test]
fn a_bent_board_is_measured_and_a_flat_one_is_flat() {
    let truth = camera(bent(), 520.0);
    let mut random = Random::new(8);
    let poses = poses(&truth, 15, &mut random);
    let (wx, wy) = (1.5e-3, -0.8e-3);
    let lift = |p: &Point3<f64>| {
        let (x, y) = (p.x / (4.0 * SQUARE_M) - 1.0, p.y / (2.5 * SQUARE_M) - 1.0);
        wx * (1.0 - x * x) + wy * (1.0 - y * y)
    };
    let settings = |warp| CalibrationSettings { warp, ..settings(LensModel::PlumbBob) };
    for (bend, expected) in [(1.0, Vector2::new(wx, wy)), (0.0, Vector2::zeros())] {
        let views: Vec<_> =
            poses.iter().map(|X| view(&truth, X, NOISE_PX, |p| bend * lift(p), &mut random)).collect();
        let with = calibrate_camera(&views, SIZE, &settings(true)).unwrap();
        let (found, sd) = with.warp_m.unwrap();
        assert!(((found - expected).component_div(&sd)).amax() < 4.0, "{found} {expected} {sd}");
        assert!(sd.amax() < 3e-4, "{sd}");
        let without = calibrate_camera(&views, SIZE, &settings(false)).unwrap();
        assert!(without.warp_m.is_none() && (without.rms_px > 1.1 * with.rms_px) == (bend > 0.0));
        let seen = board_bend(&views, &without);
        assert!(board_bend(&views, &with).is_none() && seen.is_some() == (bend > 0.0), "{seen:?}");
        let uncertainty = ProjectionUncertainty::new(&without, 0.5).unwrap();
        let verdict = CalibrationVerdict::new(&without, &uncertainty, None, &ImageCoverage::of(&without));
        let told = verdict.with_bend(seen).to_string();
        assert_eq!(told.contains("--warp"), bend > 0.0, "{told}");
    }
}

/// Half a millimetre is named whatever the images, a flat board never is; seeds other than those of the test above.
#[test]
fn half_a_millimetre_of_bend_is_named() {
    let truth = camera(bent(), 520.0);
    for seed in 300..320 {
        let mut random = Random::new(seed);
        let poses = poses(&truth, 15, &mut random);
        for bend_m in [0.0, 0.5e-3] {
            let lift = |p: &Point3<f64>| bend_m * (1.0 - (p.x / (4.0 * SQUARE_M) - 1.0).powi(2));
            let views: Vec<_> = poses.iter().map(|X| view(&truth, X, NOISE_PX, lift, &mut random)).collect();
            let found = calibrate_camera(&views, SIZE, &CalibrationSettings::default()).unwrap();
            let seen = board_bend(&views, &found);
            assert_eq!(seen.is_some(), bend_m > 0.0, "{seed}: {seen:?}");
            assert!(seen.is_none_or(|b| ((b.bend_m.x - bend_m) / b.sd_m.x).abs() < 4.0), "{seed}: {seen:?}");
        }
    }
}

#[test]
fn bad_images_and_corners_are_named_and_do_no_harm() {
    let truth = camera(bent(), 520.0);
    let mut random = Random::new(21);
    let poses = poses(&truth, 12, &mut random);
    let clean = views(&truth, &poses, &mut random);
    let mut spoilt = clean.clone();
    // the wrong way round, a swinging board, two bad corners, a few corners only, nothing, a NaN
    let px: Vec<_> = spoilt[0].iter().map(|p| p.px).collect();
    spoilt[0].iter_mut().zip(px.iter().rev()).for_each(|(p, px)| p.px = *px);
    spoilt[0].swap(3, 9);
    spoilt[1].iter_mut().enumerate().for_each(|(i, p)| p.px.x += if i % 2 == 0 { 4.0 } else { -4.0 });
    spoilt[2][7].px.x += 9.0;
    spoilt[2][30].px.y -= 6.0;
    spoilt[3].truncate(5);
    spoilt.push(Vec::new());
    spoilt.push(clean[5].clone());
    spoilt[13][4].px.x = f64::NAN;
    let found = calibrate_camera(&spoilt, SIZE, &settings(LensModel::PlumbBob)).unwrap();
    let why: Vec<_> = found.views.iter().map(|v| v.unused).collect();
    assert!(matches!(why[1], Some(Unused::Worse { .. } | Unused::MostCorners)), "{why:?}");
    assert_eq!(why[2], None);
    assert_eq!(found.views[2].points.iter().filter(|p| !p.used).map(|p| p.id).collect::<Vec<_>>(), [7, 30]);
    assert_eq!(why[3], Some(Unused::TooFewPoints { given: 5 }));
    assert_eq!(why[12], Some(Unused::TooFewPoints { given: 0 }));
    assert_eq!(why[13], Some(Unused::NotFinite { index: 4 }));
    assert!(why[4..12].iter().all(Option::is_none), "{why:?}");
    for why in why.iter().flatten() {
        assert!(why.to_string().len() > 20);
    }
    let off = (found.camera.intrinsics().fx_px - truth.intrinsics().fx_px).abs();
    let sd = found.deviations().find(|(name, _)| *name == "fx_px").unwrap().1;
    assert!(off < 4.0 * sd && found.rms_px < 0.31, "{off} {sd} {}", found.rms_px);
}

#[test]
fn what_cannot_be_calibrated_is_refused() {
    let truth = camera(bent(), 520.0);
    let mut random = Random::new(2);
    let settings = settings(LensModel::PlumbBob);
    let none = calibrate_camera(&[], SIZE, &settings).unwrap_err();
    assert!(matches!(none, CameraCalibrationError::TooFewViews { usable: 0, .. }));
    // facing the camera, all at one distance: focal length and distance are one
    let flat: Vec<_> = (0..6)
        .map(|i| {
            let X = Pose::translation(-0.12 + 0.01 * f64::from(i), -0.08, 0.5);
            view(&truth, &X, NOISE_PX, |_| 0.0, &mut random)
        })
        .collect();
    match calibrate_camera(&flat, SIZE, &settings) {
        Err(_) => {}
        Ok(found) => {
            let uncertainty = ProjectionUncertainty::new(&found, 0.5).unwrap();
            let coverage = ImageCoverage::of(&found);
            let verdict = CalibrationVerdict::new(&found, &uncertainty, None, &coverage);
            let sd = found.deviations().next().unwrap().1;
            assert!(sd > 0.05 * found.camera.intrinsics().fx_px || !verdict.is_usable(), "{sd} {verdict}");
        }
    }
    let bad = CalibrationSettings { model_sd_px: 0.0, ..settings };
    assert!(matches!(calibrate_camera(&flat, SIZE, &bad), Err(CameraCalibrationError::Setting { .. })));
    let bad = CalibrationSettings { outlier_sd: f64::NAN, ..settings };
    assert!(matches!(calibrate_camera(&flat, SIZE, &bad), Err(CameraCalibrationError::Setting { .. })));
}

/// The next view is taken, and the uncertainty falls to what was promised; an image at random does less.
#[test]
fn the_next_view_does_what_it_promises() {
    let truth = camera(bent(), 520.0);
    let mut random = Random::new(31);
    // the left of the image is not covered
    let crowded: Vec<Pose> =
        poses(&truth, 60, &mut random).into_iter().filter(|X| (X * corner(0)).x > -0.03).take(7).collect();
    let mut all = views(&truth, &crowded, &mut random);
    let model = LensModel::PlumbBob;
    let settings =
        CalibrationSettings { freedom: settings(model).freedom.without(model, "k3"), ..settings(model) };
    let of = |views: &[BoardView]| {
        let found = calibrate_camera(views, SIZE, &settings).unwrap();
        let uncertainty = ProjectionUncertainty::new(&found, 0.5).unwrap();
        (found, uncertainty)
    };
    let (found, uncertainty) = of(&all);
    let verdict = CalibrationVerdict::new(&found, &uncertainty, None, &ImageCoverage::of(&found));
    assert!(verdict.uncovered.contains(&"left edge"), "{verdict}");
    let board: Vec<_> = (0..54).map(corner).collect();
    let next = next_view(&board, &found, &uncertainty).unwrap();
    assert!(next.worst_then_px < 0.8 * next.worst_now_px);
    assert!((next.worst_now_px / uncertainty.worst_px(1.0) - 1.0).abs() < 0.05);
    let another = poses(&truth, 1, &mut random);
    let mut with_another = all.clone();
    with_another.extend(views(&truth, &another, &mut random));
    all.push(view(&truth, &next.X_CO, NOISE_PX, |_| 0.0, &mut random));
    let (then, other) = (of(&all).1.worst_px(1.0), of(&with_another).1.worst_px(1.0));
    assert!((then / next.worst_then_px - 1.0).abs() < 0.25 && then < other);
}

/// Whatever is given ends, in an answer or an error; a single image too.
#[test]
fn nonsense_ends() {
    let mut random = Random::new(77);
    let truth = camera(bent(), 520.0);
    let poses = poses(&truth, 3, &mut random);
    for round in 0..60u32 {
        let mut all: Vec<BoardView> =
            poses.iter().map(|X| view(&truth, X, NOISE_PX, |_| 0.0, &mut random)).collect();
        for (i, view) in all.iter_mut().enumerate() {
            for p in view.iter_mut() {
                match (round + i as u32) % 6 {
                    0 => p.px = Vector2::new(random.between(0.0, 640.0), random.between(0.0, 480.0)),
                    1 => p.px.y = 100.0,
                    2 => p.p_O = Point3::new(0.1, 0.2, 0.0),
                    3 => p.px *= random.between(0.0, 1e5),
                    4 => p.p_O.x *= 1e9,
                    _ => {}
                }
            }
            view.truncate(1 + (random.uniform() * 54.0) as usize);
        }
        let model = LensModel::ALL[round as usize % 3];
        let settings = CalibrationSettings { warp: round % 2 == 0, ..CalibrationSettings::of(model) };
        if let Ok(found) = calibrate_camera(&all, SIZE, &settings) {
            assert!(found.rms_px.is_finite());
            if let Some(uncertainty) = ProjectionUncertainty::new(&found, 0.5) {
                let halves = cross_validation(&all, &found, &uncertainty);
                let verdict = CalibrationVerdict::new(
                    &found,
                    &uncertainty,
                    halves.as_ref(),
                    &ImageCoverage::of(&found),
                );
                assert!(verdict.to_string().len() > 10);
                let _ = next_view(&[corner(0), corner(8), corner(53)], &found, &uncertainty);
            }
        }
    }
    let one = vec![view(&truth, &poses[0], NOISE_PX, |_| 0.0, &mut random)];
    // too much for one image is said; less of it can be had
    if let Err(error) = calibrate_camera(&one, SIZE, &CalibrationSettings::default()) {
        assert!(error.to_string().contains("images"), "{error}");
    }
    let model = LensModel::PlumbBob;
    let mut few = settings(model);
    for name in ["k2", "p1", "p2", "k3"] {
        few.freedom = few.freedom.without(model, name);
    }
    (few.freedom.fixed_center, few.freedom.fixed_aspect) = (true, true);
    let found = calibrate_camera(&one, SIZE, &few).unwrap();
    let uncertainty = ProjectionUncertainty::new(&found, 0.5).unwrap();
    let verdict = CalibrationVerdict::new(&found, &uncertainty, None, &ImageCoverage::of(&found));
    assert!(verdict.to_string().contains("; 1 image is few"), "{verdict}");
}
