//! `vservo stereo triangulate`: positions from conjugate points, (10.47)-(10.53).

use super::pairs::{PairFile, Rig, normalized_noise};
use crate::camera_model::CameraModel;
use crate::cli::detect::refused;
use crate::cli::{StereoTriangulateArguments, TriangulationMethod, json, shown};
use crate::geometry::Pose;
use crate::process::ProcessError;
use crate::stereo::{
    Conjugates, Rectification, StereoError, Triangulator, triangulate_linear, triangulate_parallel,
};
use nalgebra::{Matrix2, Matrix3, Point3, Vector2};
use serde::Serialize;

#[derive(Serialize)]
struct Place {
    id: u64,
    /// In camera 1.
    position_m: Option<[f64; 3]>,
    /// By rows, m^2: for the stated deviation; of the optimal method alone.
    covariance: Option<Vec<f64>>,
    /// How far both points lie from where the position is seen: root mean square, normalized units.
    rms: Option<f64>,
    reason: Option<String>,
}

pub(super) fn triangulate(arguments: &StereoTriangulateArguments) -> Result<u8, ProcessError> {
    let places = match run(arguments) {
        Ok(places) => places,
        Err(message) => return Ok(refused(&message, 3)),
    };
    let found = places.iter().filter(|p| p.position_m.is_some()).count();
    let text = if arguments.json { json(&serde_json::json!({ "points": places })) } else { csv(&places) };
    Ok(shown(&text, if found == 0 { 5 } else { 0 }))
}

fn run(arguments: &StereoTriangulateArguments) -> Result<Vec<Place>, String> {
    let rig = Rig::read(&arguments.pair)?;
    let file = PairFile::read(&arguments.pairs)?;
    let pairs = file.normalized(Some((&rig.camera_1, &rig.camera_2)))?;
    let told = |e: StereoError| e.to_string();
    let triangulator = Triangulator::new(&rig.X_12).map_err(told)?;
    let rectified = Rectification::new(&rig.camera_1, &rig.camera_2, &rig.X_12);
    let noise = |camera: &CameraModel, s: &Vector2<f64>| {
        let sd = arguments.sd?;
        if file.in_px { normalized_noise(camera, s, sd) } else { Some(Matrix2::identity() * (sd * sd)) }
    };
    let solve = |pair: &Conjugates| -> Result<(Point3<f64>, Option<Matrix3<f64>>), String> {
        match arguments.method {
            TriangulationMethod::Optimal => {
                let point = triangulator.point(pair).map_err(told)?;
                let noise = noise(&rig.camera_1, &pair.s_1).zip(noise(&rig.camera_2, &pair.s_2));
                let covariance = noise.map(|(a, b)| triangulator.covariance_with(&point, [&a, &b]));
                Ok((point.p_1, covariance))
            }
            TriangulationMethod::Linear => Ok((triangulate_linear(&rig.X_12, pair).map_err(told)?, None)),
            TriangulationMethod::Parallel => {
                let r = rectified.as_ref().map_err(|e| e.to_string())?;
                let beyond = || "the point lies beyond the horizon of the rectified images".to_owned();
                let parallel = Conjugates {
                    s_1: r.rectified_1(&pair.s_1).ok_or_else(beyond)?,
                    s_2: r.rectified_2(&pair.s_2).ok_or_else(beyond)?,
                };
                let p_R = triangulate_parallel(r.baseline_m, &parallel).map_err(told)?;
                Ok((r.R_R1.inverse() * p_R, None))
            }
        }
    };
    let place = |(id, pair): (&u64, &Conjugates)| match solve(pair) {
        Ok((p, covariance)) => Place {
            id: *id,
            position_m: Some(p.coords.into()),
            covariance: covariance.map(|c| c.iter().copied().collect()),
            rms: Some(reprojection(&rig.X_12, &p, pair)),
            reason: None,
        },
        Err(reason) => Place { id: *id, position_m: None, covariance: None, rms: None, reason: Some(reason) },
    };
    Ok(file.ids.iter().zip(&pairs).map(place).collect())
}

fn reprojection(X_12: &Pose, p_1: &Point3<f64>, pair: &Conjugates) -> f64 {
    let p_2 = X_12.inverse() * p_1;
    let seen = |p: &Point3<f64>| p.xy() / p.z;
    let error2 = (seen(p_1).coords - pair.s_1).norm_squared() + (seen(&p_2).coords - pair.s_2).norm_squared();
    (0.5 * error2).sqrt()
}

fn csv(places: &[Place]) -> String {
    let mut text = String::from("id,x_m,y_m,z_m,sd_x_m,sd_y_m,sd_z_m,rms,reason\n");
    for p in places {
        let cell = |v: Option<f64>| v.map_or_else(String::new, |v| format!("{v:.9}"));
        let [x, y, z] = [0, 1, 2].map(|i| cell(p.position_m.map(|p| p[i])));
        let sd = |i: usize| {
            let variance = p.covariance.as_ref().and_then(|c| c.get(4 * i)).copied();
            variance.map_or_else(String::new, |v| format!("{:.3e}", v.sqrt()))
        };
        let rms = p.rms.map_or_else(String::new, |rms| format!("{rms:.3e}"));
        let reason = p.reason.as_deref().map(crate::report::csv_table::csv_cell).unwrap_or_default();
        text += &format!("{},{x},{y},{z},{},{},{},{rms},{reason}\n", p.id, sd(0), sd(1), sd(2));
    }
    text
}
