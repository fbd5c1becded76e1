//! Which lens would explain what a run has seen: focal length, aspect ratio, principal point and first radial coefficient, estimated from the points of some views of a
//! target whose poses are unknown.
//!
//! The pose of each view is eliminated: residuals are those of the pose of least error under a lens, and the derivatives by the lens are differences of them.
//! The description of the lens is a weak prior, so that what the views do not tell stays as described.

use crate::camera_model::{CameraModel, Intrinsics, Lens};
use crate::geometry::Pose;
use crate::pose::{Correspondence3, refine_3d};
use nalgebra::{Matrix5, Point3, Vector2, Vector5};

/// Standard deviations of the prior: of the logarithms of the focal length and of the ratio of its vertical to its horizontal part, of the principal point as a
/// share of the focal length, and of the first radial coefficient. What a description is taken from (a data sheet, the centre of the image, another camera of the kind) is seldom farther off.
/// Chosen by hand: half would draw a focal length that is 30 % wrong towards the description where few views tell.
const PRIOR: Vector5<f64> = Vector5::new(0.3, 0.03, 0.08, 0.08, 0.3);
/// Steps of the differences, in the same units: 0.8 px of a focal length of 800 px, chosen by hand far above the
/// residual error of the poses' iteration and far below what matters.
const STEP: f64 = 1e-3;
/// Iterations at most. Chosen by hand: a start that is 4 deviations of the prior off needs 8 of the longest steps.
const ITERATIONS: usize = 15;
/// Share of the prior's deviations by which one iteration may change the lens. Chosen by hand: less than a third of it keeps targets before the camera.
const LONGEST_STEP: f64 = 0.5;
/// Deviations of the prior beyond which an estimate is no lens: something else leaves the errors. Chosen by hand: no lens is 3 times as long as its description.
const NO_LENS: f64 = 4.0;
/// Standard deviations from which on a difference from the description is told: normal noise exceeds 4 once in 16 000 cases, and what is told must be right. Chosen by hand.
const SURE: f64 = 4.0;
/// Share of the reprojection error that a lens has to leave at most to be the explanation. Chosen by hand: a bent plate looks in part like a lens, too.
const EXPLAINS: f64 = 0.4;

/// Least variance of a point's coordinate, px^2: a hundredth of a pixel, because no finder measures real images better.
const MIN_VARIANCE_PX2: f64 = 1e-4;

/// One view: the points of the target and their images, and the pose that was found with the described lens.
#[derive(Debug, Clone)]
pub struct LensView {
    /// The points in O, m, and their images, px.
    pub points: Vec<(Point3<f64>, Vector2<f64>)>,
    /// A pose near the true one.
    pub X_CO: Pose,
}

/// A number of the lens that the views contradict.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensDifference {
    /// Which one, as in run files.
    pub key: &'static str,
    /// As described.
    pub described: f64,
    /// As the views have it, and its standard deviation.
    pub estimated: f64,
    /// Standard deviation of the estimate.
    pub sd: f64,
}

/// The numbers of the lens by which the `views` contradict the description `camera`, the surest first; empty where no lens explains the errors, or
/// too few views tell. Poses take six of each view's coordinates, so that views of four points have to differ.
#[must_use]
pub fn lens_differences(camera: &CameraModel, views: &[LensView]) -> Vec<LensDifference> {
    let count: usize = views.iter().map(|view| 2 * view.points.len()).sum();
    let freedom = count as f64 - 6.0 * views.len() as f64;
    let mut poses: Vec<Pose> = views.iter().map(|view| view.X_CO).collect();
    let mut lens = Vector5::zeros();
    let Some(before) = residuals(camera, &lens, views, &mut poses) else { return Vec::new() };
    let sum = |r: &[Vector2<f64>]| r.iter().map(Vector2::norm_squared).sum::<f64>();
    let (mut now, mut covariance) = (before.clone(), Matrix5::zeros());
    for _ in 0..ITERATIONS {
        let mut columns = Vec::with_capacity(5);
        for k in 0..5 {
            let mut other = lens;
            other[k] += STEP;
            let Some(there) = residuals(camera, &other, views, &mut poses) else { return Vec::new() };
            columns.push(there.iter().zip(&now).map(|(a, b)| (a - b) / STEP).collect::<Vec<_>>());
        }
        let product =
            |a: &[Vector2<f64>], b: &[Vector2<f64>]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
        let variance = (sum(&now) / freedom.max(1.0)).max(MIN_VARIANCE_PX2);
        let prior = Matrix5::from_diagonal(&PRIOR.map(|sd| 1.0 / (sd * sd)));
        let of = |i: usize| columns.get(i).map_or(&[][..], Vec::as_slice);
        let normal = Matrix5::from_fn(|i, j| product(of(i), of(j))) / variance + prior;
        let right = Vector5::from_fn(|i, _| -product(of(i), &now)) / variance - prior * lens;
        let Some(inverse) = normal.try_inverse() else { return Vec::new() };
        covariance = inverse;
        let step = inverse * right;
        let longest = step.component_div(&PRIOR).amax();
        let step = step * (LONGEST_STEP / longest).min(1.0);
        lens += step;
        let Some(there) = residuals(camera, &lens, views, &mut poses) else { return Vec::new() };
        now = there;
        // a thousandth of the prior's deviations: chosen because no estimate is that sure
        if longest < 1e-3 {
            break;
        }
    }
    let is_lens = lens.component_div(&PRIOR).amax() < NO_LENS;
    // twice as many equations as two numbers need, because fewer fit by chance
    if !(is_lens && freedom >= 8.0 && sum(&now) <= EXPLAINS * EXPLAINS * sum(&before)) {
        return Vec::new();
    }
    let (Some(there), i) = (lens_at(camera, &lens), camera.intrinsics()) else { return Vec::new() };
    let (to, f) = (there.intrinsics(), i.fx_px);
    // of the whole image, as run files have it, where the camera reads a part
    let whole = camera.full_intrinsics();
    let k1 = |of: &CameraModel| of.lens().coefficients().first().map_or(0.0, |(_, value)| *value);
    let aspect = |of: &Intrinsics| of.fy_px / of.fx_px;
    let numbers = [
        ("fx_px", i.fx_px, to.fx_px, to.fx_px),
        ("fy_px / camera.lens.fx_px", aspect(i), aspect(to), aspect(to)),
        ("cx_px", whole.cx_px, whole.cx_px + to.cx_px - i.cx_px, f),
        ("cy_px", whole.cy_px, whole.cy_px + to.cy_px - i.cy_px, f),
        ("k1", k1(camera), k1(&there), 1.0),
    ];
    let mut differences: Vec<(f64, LensDifference)> = (numbers.iter().enumerate())
        .map(|(k, (key, described, estimated, scale))| {
            let sd = covariance[(k, k)].max(0.0).sqrt();
            let difference =
                LensDifference { key, described: *described, estimated: *estimated, sd: sd * scale };
            (lens[k].abs() / sd, difference)
        })
        .filter(|(sds, _)| *sds > SURE)
        .collect();
    differences.sort_by(|a, b| b.0.total_cmp(&a.0));
    differences.into_iter().map(|(_, difference)| difference).collect()
}

/// The described lens, changed by the logarithms of the focal length and of its ratio, the principal point over the focal length, and the first radial coefficient.
pub(super) fn lens_at(camera: &CameraModel, change: &Vector5<f64>) -> Option<CameraModel> {
    let (i, lens) = (camera.intrinsics(), camera.lens());
    let (factor, aspect, f) = (change[0].exp(), change[1].exp(), i.fx_px);
    let intrinsics = Intrinsics {
        fx_px: i.fx_px * factor,
        fy_px: i.fy_px * factor * aspect,
        cx_px: i.cx_px + change[2] * f,
        cy_px: i.cy_px + change[3] * f,
        ..*i
    };
    let told = lens.coefficients();
    let of = |name: &str| told.iter().find(|(key, _)| *key == name).map_or(0.0, |(_, value)| *value);
    let changed = Lens::of(lens.model(), |name| of(name) + if name == "k1" { change[4] } else { 0.0 });
    CameraModel::new(intrinsics, changed).ok()
}

/// Reprojection errors of all views, px, under a changed lens, each at its pose of least error, which `poses` becomes.
fn residuals(
    camera: &CameraModel,
    change: &Vector5<f64>,
    views: &[LensView],
    poses: &mut [Pose],
) -> Option<Vec<Vector2<f64>>> {
    let lens = lens_at(camera, change)?;
    let mut errors = Vec::new();
    for (view, pose) in views.iter().zip(poses) {
        let pairs: Vec<_> =
            view.points.iter().map(|(r, px)| Correspondence3 { r: *r, s: lens.normalized_of(px) }).collect();
        let refined = refine_3d(pose, &pairs, 0.0).ok()?;
        *pose = refined.X_CO;
        for (r, px) in &view.points {
            errors.push(lens.project(&(refined.X_CO * r))? - px);
        }
    }
    Some(errors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Region};
    use crate::linalg::Random;
    use nalgebra::Vector3;

    fn camera(f: f64, cx: f64, k1: f64) -> CameraModel {
        let i = Intrinsics { fx_px: f, fy_px: f, cx_px: cx, cy_px: 239.5, width_px: 640, height_px: 480 };
        CameraModel::new(i, Distortion { k1, ..Distortion::default() }).unwrap()
    }

    /// Views of a square from poses that differ by up to half a radian, through `lens`, with noise, px.
    fn views(lens: &CameraModel, bend_m: f64, noise_px: f64, random: &mut Random) -> Vec<LensView> {
        let mut between = |a: f64, b: f64| a + (b - a) * random.uniform();
        let mut views = Vec::new();
        for _ in 0..16 {
            let turn = Vector3::new(between(-0.5, 0.5), between(-0.5, 0.5), between(-1.0, 1.0));
            let to = Vector3::new(between(-0.05, 0.05), between(-0.05, 0.05), between(0.35, 0.6));
            let X_CO = Pose::new(to, turn) * Pose::translation(-0.05, -0.05, 0.0);
            let corners = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)];
            let points = (corners.iter().enumerate())
                .map(|(k, (x, y))| {
                    let r = Point3::new(*x, *y, 0.0);
                    let bent = Point3::new(*x, *y, if k == 2 { bend_m } else { 0.0 });
                    let noise = Vector2::new(between(-1.7, 1.7), between(-1.7, 1.7)) * noise_px;
                    (r, lens.project(&(X_CO * bent)).unwrap() + noise)
                })
                .collect();
            views.push(LensView { points, X_CO });
        }
        views
    }

    #[test]
    fn a_wrong_focal_length_is_told_within_its_deviation() {
        let mut random = Random::new(3);
        let (mut squares, mut told) = (0.0, 0);
        for k in 0..30 {
            let f = 800.0 * (0.75 + 0.5 * f64::from(k) / 29.0);
            if (f - 800.0f64).abs() < 30.0 {
                continue;
            }
            let seen = views(&camera(f, 319.5, -0.15), 0.0, 0.02, &mut random);
            let differences = lens_differences(&camera(800.0, 319.5, -0.15), &seen);
            let Some(of_f) = differences.iter().find(|d| d.key == "fx_px") else { continue };
            told += 1;
            squares += ((of_f.estimated - f) / of_f.sd).powi(2);
            assert!((of_f.estimated - f).abs() < 5.0 * of_f.sd, "{f}: {of_f:?}");
        }
        assert!(told >= 25, "{told}");
        assert!((0.4..2.0).contains(&(squares / f64::from(told))), "{}", squares / f64::from(told));
    }

    /// A camera that reads a part of its image has its principal point in the run file counted in the whole of it.
    #[test]
    fn the_principal_point_is_that_of_the_whole_image() {
        let mut random = Random::new(7);
        let part = Region { x_px: 200, y_px: 100, width_px: 240, height_px: 280 };
        let described = camera(800.0, 319.5, -0.15).cropped(&part).unwrap();
        let seen = views(&camera(800.0, 355.0, -0.15).cropped(&part).unwrap(), 0.0, 0.02, &mut random);
        let differences = lens_differences(&described, &seen);
        let of_cx = differences.iter().find(|d| d.key == "cx_px").unwrap();
        assert!((of_cx.described - 319.5).abs() < 1e-9, "{of_cx:?}");
        assert!((of_cx.estimated - 355.0).abs() < 5.0 * of_cx.sd, "{of_cx:?}");
    }

    #[test]
    fn a_lens_as_described_and_a_bent_plate_are_no_other_lens() {
        let mut random = Random::new(5);
        let described = camera(800.0, 319.5, -0.15);
        for _ in 0..10 {
            let good = views(&described, 0.0, 0.02, &mut random);
            assert_eq!(lens_differences(&described, &good), []);
            let bent = views(&described, 0.003, 0.02, &mut random);
            assert_eq!(lens_differences(&described, &bent), []);
        }
    }
}
