//! The methods, each with all of its solutions.

use super::numbers_of;
use super::points::Points;
use crate::cli::{PoseArguments, PoseMethod};
use crate::geometry::{Pose, rotation_z};
use crate::pose::{
    Loss, ObjectFeature, PoseError, RefinedPixelPose, VirtualServoing, dlt_pose, euler_zyx_rotation, p3p,
    planar_pose, pnp, refine_pixels, virtual_servoing, virtual_servoing_4,
};
use nalgebra::{Translation3, UnitQuaternion, Vector3, Vector4, Vector6};

/// One pose.
pub(super) struct Solution {
    /// As the method has it.
    pub(super) X_CO: Pose,
    /// Its reprojection error, px.
    pub(super) rms_px: f64,
    /// The squares of its errors over their variances.
    pub(super) chi_square: f64,
    /// Steps of an iteration.
    pub(super) steps: Option<u32>,
    /// The nearest minimum of the squared errors over their variances.
    pub(super) refined: Option<RefinedPixelPose>,
}

/// All solutions of the method, or why there is none.
pub(super) fn solve(points: &Points, arguments: &PoseArguments) -> Result<Vec<Solution>, String> {
    let told = |e: PoseError| e.to_string();
    let poses: Vec<(Pose, Option<u32>)> = match arguments.method {
        PoseMethod::Planar => {
            let solved = planar_pose(&points.planar()?).map_err(told)?;
            let both = [Some(solved.best), solved.other];
            both.into_iter().flatten().map(|s| (s.X_CO, None)).collect()
        }
        PoseMethod::Dlt => vec![(dlt_pose(&points.spatial()).map_err(told)?, None)],
        PoseMethod::P3p => {
            let three = points.spatial().try_into().map_err(|all: Vec<_>| {
                format!("`p3p` takes three points, not {}; `pnp` takes more", all.len())
            })?;
            p3p(&three).map_err(told)?.as_slice().iter().map(|X| (*X, None)).collect()
        }
        PoseMethod::Pnp => {
            pnp(&points.spatial()).map_err(told)?.as_slice().iter().map(|s| (s.X_CO, None)).collect()
        }
        PoseMethod::VirtualServoing => vec![servoed(points, arguments)?],
    };
    if poses.is_empty() {
        return Err("no pose explains these points: none has all of them in front of the camera".into());
    }
    Ok(poses
        .into_iter()
        .map(|(X_CO, steps)| Solution {
            X_CO,
            rms_px: rms_px(&X_CO, points),
            chi_square: chi_square(&X_CO, points),
            steps,
            refined: refine_pixels(&X_CO, &points.pixels, &points.camera, Loss::Squares).ok(),
        })
        .collect())
}

/// (10.40)-(10.42) from the start that was given, or from in front of the points.
fn servoed(points: &Points, arguments: &PoseArguments) -> Result<(Pose, Option<u32>), String> {
    let spatial = points.spatial();
    let features: Vec<_> = spatial.iter().map(|p| ObjectFeature::Point { r_O: p.r, s: p.s }).collect();
    let start = match arguments.start.as_deref() {
        Some(text) => start_of(text).map_err(|e| format!("--start: {e}"))?,
        None => in_front(points),
    };
    let settings = VirtualServoing { max_steps: arguments.max_steps, ..VirtualServoing::default() };
    let told = |e: PoseError| format!("{e} (virtual servoing came from --start {start:?})");
    if arguments.parallel {
        let x = Vector4::new(start[0], start[1], start[2], start[3]);
        let end = virtual_servoing_4(&x, &features, &settings).map_err(told)?;
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation_z(end.x[3]));
        return Ok((Pose::from_parts(Translation3::from(end.x.xyz()), rotation), Some(end.steps)));
    }
    let end = virtual_servoing(&Vector6::from(start), &features, &settings).map_err(told)?;
    let phi = Vector3::new(end.x[3], end.x[4], end.x[5]);
    let rotation = UnitQuaternion::from_rotation_matrix(&euler_zyx_rotation(&phi));
    let position = Vector3::new(end.x[0], end.x[1], end.x[2]);
    Ok((Pose::from_parts(Translation3::from(position), rotation), Some(end.steps)))
}

/// Six numbers, as `x` of (10.33) has them.
fn start_of(text: &str) -> Result<[f64; 6], String> {
    numbers_of(text).ok_or_else(|| {
        format!(
            "`{text}`: six numbers x,y,z,phi_z,phi_y,phi_x are expected (m, and the angles of Rz Ry Rx, rad)"
        )
    })
}

/// Without rotation, at the depth at which the object is as large as it looks, its middle where it is seen.
fn in_front(points: &Points) -> [f64; 6] {
    let spatial = points.spatial();
    let n = spatial.len().max(1) as f64;
    let middle_r = spatial.iter().fold(Vector3::zeros(), |sum, p| sum + p.r.coords / n);
    let middle_s = spatial.iter().fold(nalgebra::Vector2::zeros(), |sum, p| sum + p.s / n);
    let spread_r: f64 = spatial.iter().map(|p| (p.r.coords - middle_r).norm_squared()).sum();
    let spread_s: f64 = spatial.iter().map(|p| (p.s - middle_s).norm_squared()).sum();
    // Bounds of a start only, chosen by hand: otherwise points that coincide would start at infinity.
    let z = (spread_r / spread_s.max(1e-18)).sqrt().clamp(1e-3, 1e6);
    [z * middle_s.x - middle_r.x, z * middle_s.y - middle_r.y, z - middle_r.z, 0.0, 0.0, 0.0]
}

/// The squared distances between where points are seen and where the pose has them, over their variances; infinite where one is not seen at all.
fn chi_square(X_CO: &Pose, points: &Points) -> f64 {
    let terms = points.pixels.iter().map(|p| match points.camera.project(&(X_CO * p.r)) {
        Some(px) => (px - p.px).component_div(&p.covariance_px2.diagonal().map(f64::sqrt)).norm_squared(),
        None => f64::INFINITY,
    });
    terms.sum()
}

/// Root mean square distance between where points are seen and where the pose has them, px; NaN where one is not seen at all.
pub(super) fn rms_px(X_CO: &Pose, points: &Points) -> f64 {
    let error2 = points
        .pixels
        .iter()
        .map(|p| points.camera.project(&(X_CO * p.r)).map_or(f64::NAN, |px| (px - p.px).norm_squared()));
    (error2.sum::<f64>() / points.pixels.len().max(1) as f64).sqrt()
}
