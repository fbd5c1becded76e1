//! Pose and covariance against truth, and what is refused: points without pixels.

use super::*;
use crate::camera_model::{CameraModel, Distortion, Intrinsics};
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::pose::normalized_error;
use nalgebra::{Matrix3, Point3, Vector2};
use proptest::prelude::*;

fn camera(f_px: f64) -> CameraModel {
    let intrinsics =
        Intrinsics { fx_px: f_px, fy_px: f_px, cx_px: 320.0, cy_px: 240.0, width_px: 640, height_px: 480 };
    CameraModel::new(intrinsics, Distortion { k1: -0.15, k2: 0.05, ..Distortion::default() }).unwrap()
}

fn rig() -> StereoRig {
    let X_LR = Pose::new([0.08, 0.002, -0.003].into(), [0.01, -0.12, 0.02].into());
    StereoRig::new(camera(800.0), camera(780.0), X_LR).unwrap()
}

fn X_DO() -> Pose {
    Pose::new([0.0, 0.01, 0.5].into(), [0.1, -0.1, 0.3].into())
}

/// A lump of points, no plane.
fn lump(count: usize, seed: u64) -> Vec<(u32, Point3<f64>)> {
    let mut random = Random::new(seed);
    let mut one = || Point3::from([0.06, 0.06, 0.04].map(|m| random.between(-m, m)));
    (0..count as u32).map(|k| (3 * k + 1, one())).collect()
}

fn found(id: u32, px: Vector2<f64>, sd_px: f64) -> Detection {
    Detection {
        id,
        px,
        sd_px,
        area_px2: 0.0,
        covariance_px2: [0.0; 3],
        dark_level: 30.0,
        plate_level: 220.0,
        disturbance_px: 0.0,
    }
}

/// What both cameras see of points with their object at `X_CO`; the noise of each has its own deviation.
fn seen(
    rig: &StereoRig,
    points: &[(u32, Point3<f64>)],
    X_CO: &Pose,
    sd_px: [f64; 2],
    random: &mut Random,
) -> [Vec<Detection>; 2] {
    let mut lists = [Vec::new(), Vec::new()];
    for (id, p_O) in points {
        let images = rig.project(&(X_CO * p_O)).unwrap();
        for ((list, px), sd) in lists.iter_mut().zip(images).zip(sd_px) {
            let noise = Vector2::new(random.gaussian(), random.gaussian()) * sd;
            list.push(found(*id, px + noise, sd));
        }
    }
    lists
}

/// A view taught from `count` noisy pairs of images.
fn taught(
    rig: &StereoRig,
    points: &[(u32, Point3<f64>)],
    sd_px: [f64; 2],
    random: &mut Random,
) -> TaughtView {
    let [left, right] = seen(rig, points, &X_DO(), sd_px, random);
    let mut space = Vec::new();
    rig.triangulate(&left, &right, &mut space);
    let points: Vec<_> =
        space.iter().map(|p| TaughtPoint { id: p.id, p_D: p.p_L, covariance: p.covariance }).collect();
    TaughtView::new(&points, X_DO()).unwrap()
}

/// Poses as a servo meets them on its way.
fn somewhere(random: &mut Random) -> Pose {
    let [x, y, z] = [0.04, 0.03, 0.12].map(|m| random.between(-m, m));
    let turn = [0.25, 0.25, 0.6].map(|rad| random.between(-rad, rad));
    Pose::new([x, y, 0.55 + z].into(), turn.into())
}

proptest! {
    /// Without noise the pose comes back, whatever the object; nothing of it but the ids is told.
    #[test]
    fn exact_views_give_the_exact_pose(seed in 0..5000_u64, count in 3..20_usize) {
        let (rig, points, mut random) = (rig(), lump(count, seed), Random::new(seed));
        let view = taught(&rig, &points, [1e-7; 2], &mut random);
        let X_CO = somewhere(&mut random);
        let [left, right] = seen(&rig, &points, &X_CO, [1e-7; 2], &mut random);
        let (mut space, mut pairs) = (Vec::new(), Vec::new());
        rig.triangulate(&left, &right, &mut space);
        for (p, (id, p_O)) in space.iter().zip(&points) {
            prop_assert!(p.id == *id && (p.p_L - X_CO * p_O).norm() < 1e-8);
        }
        // three points may lie almost in one line
        let pose = view.pose(&space, &mut pairs).unwrap();
        let gap = (pose.X_CO.to_homogeneous() - X_CO.to_homogeneous()).norm();
        prop_assert!(gap < 1e-4 && pose.freedom == 4 * count - 6, "{gap:e}");
    }

    /// Of lists in which points are missing here and there, those in both come out, once and in order.
    #[test]
    fn points_are_joined_by_id(left in prop::collection::btree_set(0..40_u32, 0..30), right in prop::collection::btree_set(0..40_u32, 0..30)) {
        let rig = rig();
        let at = |id: u32| rig.project(&Point3::new(0.002 * f64::from(id) - 0.04, 0.0, 0.5)).unwrap();
        let list = |ids: &std::collections::BTreeSet<u32>, side: usize| {
            ids.iter().map(|id| found(*id, at(*id)[side], 0.1)).collect::<Vec<_>>()
        };
        let mut space = Vec::new();
        rig.triangulate(&list(&left, 0), &list(&right, 1), &mut space);
        let ids: Vec<_> = space.iter().map(|p| p.id).collect();
        prop_assert_eq!(ids, left.intersection(&right).copied().collect::<Vec<_>>());
    }
}

/// Normalized errors of the pose over many draws are chi-square with 6 degrees of freedom, misfits with 4 n - 6; with the noise of the
/// teaching in it.
#[test]
fn covariance_and_misfit_are_chi_square() {
    let rig = rig();
    let mut random = Random::new(11);
    for (count, sd_px, tolerance) in [(4, [0.1, 0.1], 0.05), (16, [0.3, 0.3], 0.05), (9, [0.08, 0.14], 0.12)]
    {
        const DRAWS: u64 = 2000;
        let (mut sum, mut squares, mut misfit, mut covered) = (0.0, 0.0, 0.0, 0);
        for draw in 0..DRAWS {
            let points = lump(count, draw);
            let view = taught(&rig, &points, sd_px, &mut random);
            let X_CO = somewhere(&mut random);
            let [left, right] = seen(&rig, &points, &X_CO, sd_px, &mut random);
            let (mut space, mut pairs) = (Vec::new(), Vec::new());
            rig.triangulate(&left, &right, &mut space);
            let pose = view.pose(&space, &mut pairs).unwrap();
            let error = normalized_error(&pose.X_CO, &pose.covariance, &X_CO).unwrap();
            sum += error;
            squares += error * error;
            covered += u64::from(error < 12.592); // 95 % quantile of chi-square, 6 degrees of freedom
            misfit += pose.misfit / pose.freedom as f64;
        }
        let draws = DRAWS as f64;
        let (mean, variance) = (sum / draws, squares / draws - (sum / draws).powi(2));
        assert!((mean / 6.0 - 1.0).abs() < tolerance, "{count}: {mean}");
        assert!((variance / 12.0 - 1.0).abs() < 4.0 * tolerance, "{count}: {variance}");
        assert!((misfit / draws - 1.0).abs() < tolerance, "{count}: {}", misfit / draws);
        assert!((covered as f64 / draws - 0.95).abs() < 0.25 * tolerance, "{covered}");
    }
}

#[test]
fn views_that_fix_no_pose_are_refused_by_name() {
    let point =
        |id, x: f64, y: f64, z| TaughtPoint { id, p_D: Point3::new(x, y, z), covariance: Matrix3::zeros() };
    let new = |points: &[TaughtPoint]| TaughtView::new(points, X_DO()).unwrap_err();
    let (a, b, c) = (point(0, 0.0, 0.0, 0.5), point(1, 0.1, 0.0, 0.5), point(2, 0.0, 0.1, 0.5));
    assert!(TaughtView::new(&[a, b, c], X_DO()).is_ok());
    assert_eq!(new(&[a, b]), TaughtViewError::TooFew(2));
    assert_eq!(new(&[a, c, b]), TaughtViewError::Order(1));
    assert_eq!(new(&[a, b, b]), TaughtViewError::Order(1));
    assert_eq!(new(&[a, b, point(7, 0.05, 0.0, 0.5)]), TaughtViewError::InLine);
    assert_eq!(new(&[a, b, point(7, 0.0, 0.1, -0.5)]), TaughtViewError::Number(7));
    assert_eq!(new(&[a, b, point(7, f64::NAN, 0.1, 0.5)]), TaughtViewError::Number(7));
    let many: Vec<_> = (0..65).map(|id| point(id, f64::from(id), f64::from(id * id), 1.0)).collect();
    assert_eq!(new(&many), TaughtViewError::TooMany(65));
    let negative = TaughtPoint { covariance: Matrix3::identity() * -1e-6, ..c };
    assert_eq!(new(&[a, b, negative]), TaughtViewError::Number(2));
    assert_eq!(
        StereoRig::new(camera(800.0), camera(800.0), Pose::identity()).unwrap_err(),
        StereoError::Degenerate
    );
}

/// A vision with what the finders found put into its hands.
fn vision(view: TaughtView) -> StereoVision {
    let target: Target = crate::target::FourDots::new(0.1, 0.015, 0.01, 0.03).unwrap().into();
    StereoVision::new(rig(), &target, view, SpanNs(5_000_000))
}

fn file(vision: &mut StereoVision, lists: &[Vec<Detection>; 2]) -> StereoMeasurement {
    let header = FrameHeader { frame_id: 4, exposure: MonoNs(1_000), ..FrameHeader::default() };
    for (side, found) in [Side::Left, Side::Right].into_iter().zip(lists) {
        let detections = CameraDetections { header, found: found.clone(), miss: None };
        vision.pairing.file(side, header.exposure, detections);
    }
    vision.next_measurement().unwrap()
}

#[test]
fn a_measurement_carries_pose_covariance_and_the_left_features() {
    let (rig, points, mut random) = (rig(), lump(12, 3), Random::new(5));
    let view = taught(&rig, &points, [0.05; 2], &mut random);
    let X_CO = somewhere(&mut random);
    let mut vision = vision(view);
    let mut lists = seen(&rig, &points, &X_CO, [0.05; 2], &mut random);
    let m = file(&mut vision, &lists).measurement;
    assert!(m.found() && m.flags & measurement_flag::PARTIAL == 0 && m.frame_id == 4);
    let pose = m.pose().unwrap();
    assert!((pose.translation.vector - X_CO.translation.vector).norm() < 1e-3);
    assert!(pose.rotation.angle_to(&X_CO.rotation) < 5e-3);
    assert_eq!(
        m.features().iter().map(|f| f.id as u32).collect::<Vec<_>>(),
        points.iter().map(|p| p.0).collect::<Vec<_>>()
    );
    for (f, (_, p_O)) in m.features().iter().zip(&points) {
        let p = X_CO * p_O;
        assert!((f.x - p.x / p.z).abs() < 1e-3 && (f.sd_px - 0.05).abs() < 0.01);
    }
    assert!(m.reprojection_rms_px < 0.3);
    // one point that is somewhere else in the right image goes, and the rest stays
    lists[1][5].px.y += 8.0;
    lists[0].remove(2);
    let m = file(&mut vision, &lists).measurement;
    assert!(m.found() && m.flags & measurement_flag::PARTIAL != 0);
    assert_eq!(m.feature_count, 10);
    assert!(m.features().iter().all(|f| f.id as u32 != points[5].0 && f.id as u32 != points[2].0));
    // an object that was bent since is not believed
    for (k, found) in lists[1].iter_mut().enumerate() {
        found.px.x += if k % 2 == 0 { 3.0 } else { -3.0 };
    }
    let m = file(&mut vision, &lists).measurement;
    assert_eq!((m.target_status(), m.pose()), (TargetStatus::Inconsistent, None));
    // and of two points nothing is said
    lists.iter_mut().for_each(|list| list.truncate(2));
    let m = file(&mut vision, &lists).measurement;
    assert_eq!((m.target_status(), m.target_lost), (TargetStatus::TooFewShared, 1));
}

#[test]
fn a_blind_camera_and_a_missing_frame_have_their_names() {
    let (rig, points, mut random) = (rig(), lump(6, 3), Random::new(5));
    let mut vision = vision(taught(&rig, &points, [0.05; 2], &mut random));
    let grey = vec![90; 640 * 480];
    let image = ImageView::new(&grey, 640, 480).unwrap();
    let header = |frame_id: u64, ms: i64| FrameHeader {
        frame_id,
        exposure: MonoNs(ms * 1_000_000),
        ..FrameHeader::default()
    };
    vision.look(Side::Left, &Frame { header: header(0, 0), image });
    assert!(vision.next_measurement().is_none(), "its mate is on its way");
    vision.look(Side::Right, &Frame { header: header(0, 2), image });
    let none = vision.next_measurement().unwrap();
    assert_eq!((none.measurement.target_status(), none.blind), (TargetStatus::NoContrast, Some(Side::Left)));
    vision.look(Side::Left, &Frame { header: header(1, 40), image });
    vision.give_up(Side::Left, MonoNs(40_000_000));
    let none = vision.next_measurement().unwrap();
    assert_eq!((none.measurement.target_status(), none.blind), (TargetStatus::NoPair, Some(Side::Right)));
    assert_eq!((none.measurement.frame_id, none.measurement.exposure), (1, MonoNs(40_000_000)));
    let small = ImageView::new(&grey[..320 * 480], 320, 480).unwrap();
    vision.look(Side::Left, &Frame { header: header(2, 80), image: small });
    vision.look_past(Side::Right, header(2, 80));
    let none = vision.next_measurement().unwrap();
    assert_eq!((none.measurement.target_status(), none.blind), (TargetStatus::WrongSize, Some(Side::Left)));
}
