//! Motion during the readout of a rolling shutter, as what may be wrong with the pose of one image: by how much its covariance is larger.
//!
//! Rows that are exposed one after the other see a moving target at poses that differ by `xi tau`, with `tau` the row relative to the points' mean as share
//! of the frame's height, and `xi` the motion from the first row to the last. One pose takes most of such a motion for another tilt and distance, so that the
//! reprojection error shows a small part of it. With the whitened errors `y` of the pose of least error, its Jacobian `A` and that of the motion, `B`:
//!
//! ```text
//! xi ~ N(0, s^2 S)                                          S: motions that displace points by 1 px, in each of the six directions
//! M = B' P B,  b = B' P y                                   P: projection onto what the pose leaves
//! log p(y | s) / p(y | 0) = (b' V b - log det(I + s^2 M)) / 2        V = (I / s^2 + M)^-1
//! ```
//! Where the mean of that ratio over scales `s` says that something moved, the covariance of the pose grows by the mean, with these weights, of the motion's
//! covariance and of the square of the displacement of the pose that the motion explains. The pose itself stays that of least error: what looks like a
//! motion may be another lens or a bent plate.

use crate::camera_model::CameraModel;
use crate::detect::Detection;
use crate::geometry::{Pose, skew};
use crate::pose::{Correspondence3, RefinedPose};
use nalgebra::{Cholesky, Matrix2x3, Matrix2x6, Matrix6, Vector6};

/// Scales of motions, px from the first row to the last. Chosen by hand: less than the first is below the noise of the surest points, more than the last is
/// refused as inconsistent or smears the points; steps are so small that the sum over them is an integral.
const SCALES_PX: (f64, f64) = (0.25, 64.0);
const SCALES: usize = 17;
/// Something moved where that is so many times likelier than that nothing did. Derived: of images without motion the mean of this ratio is one, so that
/// at most one in twenty has more (Markov's inequality); of 120 rendered ones none had.
const MOVED: f64 = 20.0;

/// What a motion during the readout does to the pose of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ReadoutMotion {
    /// Likeliest scale, px from the first row to the last.
    pub(super) px: f64,
    /// What is added to the covariance of the pose.
    pub(super) covariance: Matrix6<f64>,
}

impl ReadoutMotion {
    /// Of the points `pairs`, detected as `dots`, at the pose of least error; `None` where nothing says that something moved.
    pub(super) fn of(
        pose: &RefinedPose,
        pairs: &[Correspondence3],
        dots: &[Detection],
        camera: &CameraModel,
    ) -> Option<Self> {
        let i = camera.intrinsics();
        let focal_px = (i.fx_px * i.fy_px).sqrt();
        let count = dots.len() as f64;
        let sd = (dots.iter().map(|dot| dot.sd_px * dot.sd_px).sum::<f64>() / count).sqrt() / focal_px;
        let middle = dots.iter().map(|dot| dot.px.y).sum::<f64>() / count;
        let scale_m = pose.X_CO.translation.vector.norm() / focal_px;
        let turn = 1.0 / focal_px;
        let unit = Vector6::new(scale_m, scale_m, scale_m, turn, turn, turn);
        let (mut AA, mut AB, mut BB) = (Matrix6::zeros(), Matrix6::zeros(), Matrix6::zeros());
        let (mut Ay, mut By) = (Vector6::zeros(), Vector6::zeros());
        for (pair, dot) in pairs.iter().zip(dots) {
            let (predicted, rows) = point_rows(&pose.X_CO, pair)?;
            let (y, A) = ((pair.s - predicted) / sd, rows / sd);
            let tau = (dot.px.y - middle) / f64::from(i.height_px);
            let B = A * Matrix6::from_diagonal(&unit) * tau;
            AA += A.transpose() * A;
            AB += A.transpose() * B;
            BB += B.transpose() * B;
            Ay += A.transpose() * y;
            By += B.transpose() * y;
        }
        let of_pose = Cholesky::new(AA)?;
        // by how much the pose of least error moves with each unit of motion: it takes up the opposite
        let taken = of_pose.solve(&AB);
        let M = symmetric(&(BB - AB.transpose() * taken));
        let b = By - taken.transpose() * Ay;
        let (mut weights, mut sum, mut greatest, mut px) = (0.0, Matrix6::zeros(), f64::NEG_INFINITY, 0.0);
        for k in 0..SCALES {
            let (from, to) = SCALES_PX;
            let s = from * (to / from).powf(k as f64 / (SCALES - 1) as f64);
            let factor = Cholesky::new(Matrix6::identity() / (s * s) + M)?;
            let xi = factor.solve(&b);
            // det(I + s^2 M) = s^12 det(I / s^2 + M)
            let log_ratio = 0.5 * b.dot(&xi) - 6.0 * s.ln() - factor.l_dirty().diagonal().map(f64::ln).sum();
            let displaced = taken * xi;
            let covariance = taken * factor.inverse() * taken.transpose() + displaced * displaced.transpose();
            // relative to the greatest so far, because the ratio of a gross motion is beyond any number
            if log_ratio > greatest {
                let less = (greatest - log_ratio).exp();
                (weights, sum) = (weights * less + 1.0, sum * less + covariance);
                (greatest, px) = (log_ratio, s);
            } else {
                let weight = (log_ratio - greatest).exp();
                (weights, sum) = (weights + weight, sum + covariance * weight);
            }
        }
        // no number is no motion
        let moved = greatest + (weights / SCALES as f64).ln() > MOVED.ln();
        moved.then(|| Self { px, covariance: symmetric(&(sum / weights)) })
    }
}

/// Where a point is seen, and how a twist `[v; w]` of the object, expressed in the camera, moves it; `None` behind the camera.
fn point_rows(X_CO: &Pose, pair: &Correspondence3) -> Option<(nalgebra::Vector2<f64>, Matrix2x6<f64>)> {
    let arm = X_CO.rotation * pair.r.coords;
    let p = arm + X_CO.translation.vector;
    if !(p.z > 0.0) {
        return None;
    }
    let s = p.xy() / p.z;
    let by_position = Matrix2x3::new(1.0, 0.0, -s.x, 0.0, 1.0, -s.y) / p.z;
    let mut rows = Matrix2x6::zeros();
    rows.fixed_columns_mut::<3>(0).copy_from(&by_position);
    rows.fixed_columns_mut::<3>(3).copy_from(&(by_position * -skew(&arm)));
    Some((s, rows))
}

/// Without the asymmetry of rounding.
fn symmetric(A: &Matrix6<f64>) -> Matrix6<f64> {
    (A + A.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};
    use crate::linalg::Random;
    use crate::pose::refine_3d;
    use crate::vision::Growth;
    use nalgebra::{Point3, Vector2, Vector3};

    const SD_PX: f64 = 0.01;

    fn camera() -> CameraModel {
        let lens = Intrinsics {
            fx_px: 600.0,
            fy_px: 600.0,
            cx_px: 319.5,
            cy_px: 239.5,
            width_px: 640,
            height_px: 480,
        };
        CameraModel::new(lens, Distortion::default()).unwrap()
    }

    /// 7 x 5 points, seen while they move by some `motion_px` from the first row to the last: the pose of least error, what is told of the motion, and
    /// the squared error over the covariance at the best instant, with the motion and without.
    fn seen(random: &mut Random, motion_px: f64) -> (Option<ReadoutMotion>, [f64; 2]) {
        let camera = camera();
        let mut within = |low: f64, high: f64| low + (high - low) * random.uniform();
        let tilt = within(0.0, 0.9);
        let about = within(-3.1, 3.1);
        let axis = Vector3::new(about.cos(), about.sin(), 0.0);
        let z = within(0.4, 0.9);
        let X_CO = Pose::translation(within(-0.1, 0.1), within(-0.08, 0.08), z)
            * Pose::rotation(axis * tilt)
            * Pose::rotation(Vector3::z() * within(-3.1, 3.1));
        let mut direction = |size: f64| {
            let v = Vector3::from_fn(|_, _| random.gaussian());
            v * (size / v.norm())
        };
        let (v, w) = (direction(motion_px * z / 600.0), direction(0.5 * motion_px / 600.0));
        let at = |tau: f64| {
            let mut X = X_CO;
            X.translation.vector += v * tau;
            X.rotation = Pose::rotation(w * tau).rotation * X.rotation;
            X
        };
        let (mut pairs, mut dots) = (Vec::new(), Vec::new());
        for k in 0..35 {
            let r = Point3::new(0.03 * f64::from(k % 7 - 3), 0.03 * f64::from(k / 7 - 2), 0.0);
            // the row at which the point is seen decides when that is
            let mut px = camera.project(&(X_CO * r)).unwrap();
            for _ in 0..20 {
                px = camera.project(&(at((px.y - 239.5) / 480.0) * r)).unwrap();
            }
            px += Vector2::from_fn(|_, _| SD_PX * random.gaussian());
            pairs.push(Correspondence3 { r, s: camera.normalized_of(&px) });
            dots.push(Detection {
                id: k as u32,
                px,
                sd_px: SD_PX,
                area_px2: 0.0,
                covariance_px2: [0.0; 3],
                dark_level: 30.0,
                plate_level: 190.0,
                disturbance_px: 0.0,
            });
        }
        let pose = refine_3d(&X_CO, &pairs, SD_PX / 600.0).unwrap();
        let motion = ReadoutMotion::of(&pose, &pairs, &dots, &camera);
        let square = |covariance: &Matrix6<f64>| {
            let inverse = covariance.try_inverse().unwrap();
            let rows = dots.iter().map(|dot| dot.px.y);
            let (low, high) = (rows.clone().fold(480.0, f64::min), rows.fold(0.0, f64::max));
            let of = |k: i32| {
                let truth = at((low + (high - low) * f64::from(k) / 60.0 - 239.5) / 480.0);
                let e_v = pose.X_CO.translation.vector - truth.translation.vector;
                let e_w = (pose.X_CO.rotation * truth.rotation.inverse()).scaled_axis();
                let e = Vector6::new(e_v.x, e_v.y, e_v.z, e_w.x, e_w.y, e_w.z);
                e.dot(&(inverse * e)) / 6.0
            };
            (0..=60).map(of).fold(f64::INFINITY, f64::min)
        };
        let growth = Growth::of(35, 35.0 * (600.0 * pose.rms / SD_PX).powi(2));
        let without = pose.covariance * growth.pose;
        let with = without + motion.map_or(Matrix6::zeros(), |motion| motion.covariance);
        (motion, [square(&with), square(&without)])
    }

    #[test]
    fn of_what_stands_still_nothing_is_told() {
        let mut random = Random::new(3);
        let told = (0..500).filter(|_| seen(&mut random, 0.0).0.is_some()).count();
        assert!(told <= 10, "{told} of 500");
    }

    #[test]
    fn what_moves_during_the_readout_is_in_the_covariance() {
        let mut random = Random::new(4);
        for motion_px in [1.0, 4.0, 12.0] {
            let (mut told, mut beyond, mut before) = (0, 0, 0);
            for _ in 0..200 {
                let (motion, [with, without]) = seen(&mut random, motion_px);
                if let Some(motion) = motion {
                    assert!(motion.px > 0.02 * motion_px && motion.px < 20.0 * motion_px, "{}", motion.px);
                    told += 1;
                }
                beyond += usize::from(with > 4.0);
                before += usize::from(without > 4.0);
            }
            assert!(before >= 40 && beyond <= 30 && told >= 170, "{motion_px} px: {told} {beyond} {before}");
        }
    }
}
