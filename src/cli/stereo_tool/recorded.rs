//! Two views from ONE moving camera: two instants of a recording, with the points that vision measured in both, and where the arm had the camera.

use crate::calibration::JointTrack;
use crate::camera_model::CameraModel;
use crate::config::Config;
use crate::geometry::Pose;
use crate::linalg::symmetric_eigen;
use crate::messages::{JointState, Measurement};
use crate::process::{OpenRecording, ProcessError};
use crate::record::RecordingReader;
use crate::replay::ReplayError;
use crate::robot::Robot;
use crate::scene::SceneMotion;
use crate::stereo::Conjugates;
use crate::time::MonoNs;
use nalgebra::{Matrix3, Point3, SVector, Vector2, Vector3};
use std::io::Read;
use std::path::Path;

/// Points whose spread across a plane is a smaller share of their spread in it count as its points. Derived: places of a target are written with nine digits at least,
/// and spreads are squares.
const FLAT: f64 = 1e-12;

/// What two instants of a run show.
pub(super) struct RecordedViews {
    /// Points of the target that both measurements have.
    pub(super) ids: Vec<u64>,
    /// Normalized by the run file's lens, as vision measured them.
    pub(super) pairs: Vec<Conjugates>,
    pub(super) camera: CameraModel,
    /// Standard deviation of a coordinate as vision stated it, root mean square over the points, px.
    pub(super) sd_px: f64,
    /// Whether the points lie in one plane of the target.
    pub(super) is_plane: bool,
    /// The plane's normal in camera 2 by the measured pose, away from the camera.
    pub(super) normal_2: Option<Vector3<f64>>,
    /// After the recording's first joint state, s.
    pub(super) times_s: [f64; 2],
    pub(super) frames: [u64; 2],
    /// Camera 2 in camera 1 by joints, kinematics and mount; `None` where the recording has no joints, or where the target moved.
    pub(super) X_12: Option<Pose>,
}

/// Whether this file is a recording by its name.
pub(super) fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap"))
}

/// The measurements of the recording at `path` that are nearest to two times.
///
/// # Errors
/// Where the recording cannot be read; and inside, in words, where it has no two such views.
pub(super) fn read(path: &Path, at_s: [f64; 2]) -> Result<Result<RecordedViews, String>, ProcessError> {
    let OpenRecording { reader, config, .. } = OpenRecording::open(path, &[])?;
    let found = crate::dispatch_robot!(config.robot, |robot| views(&config, &robot, reader, at_s))?;
    found.map_err(|cause| ProcessError::Replay { path: path.into(), cause: Box::new(cause) })
}

fn views<R: Read, const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    mut reader: RecordingReader<R>,
    at_s: [f64; 2],
) -> Result<Result<RecordedViews, String>, ReplayError> {
    let topic = format!("/vision/{}/measurement", config.camera.id.0);
    let (mut track, mut zero) = (JointTrack::<N>::default(), None);
    let mut seen: Vec<Measurement> = Vec::new();
    while let Some(message) = reader.next_message()? {
        match message.topic() {
            "/control/joint_state" => {
                let state = message.record::<JointState>()?;
                let joints = |all: &[f64]| SVector::from_fn(|i, _| all.get(i).copied().unwrap_or_default());
                track.push(state.stamp, joints(&state.q), joints(&state.qd));
                zero = zero.or(Some(state.stamp));
            }
            other if other == topic => {
                let measurement: Measurement = message.record()?;
                if measurement.found() && measurement.target_number == 0 {
                    seen.push(measurement);
                }
            }
            _ => {}
        }
    }
    let Some(zero) = zero.or(seen.first().map(|m| m.exposure)) else {
        return Ok(Err("the recording has neither joint states nor measurements".into()));
    };
    Ok(between(config, robot, &track, &seen, zero, at_s))
}

fn between<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    track: &JointTrack<N>,
    seen: &[Measurement],
    zero: MonoNs,
    at_s: [f64; 2],
) -> Result<RecordedViews, String> {
    let time_s = |m: &Measurement| (m.exposure - zero).as_s();
    let nearest = |at_s: f64| {
        let gap = |m: &Measurement| (time_s(m) - at_s).abs();
        seen.iter().min_by(|a, b| gap(a).total_cmp(&gap(b)))
    };
    let (Some(one), Some(two)) = (nearest(at_s[0]), nearest(at_s[1])) else {
        return Err("vision found the target in no frame of the recording".into());
    };
    if one.frame_id == two.frame_id {
        return Err(format!(
            "both times have the same measurement, that of {:.3} s: choose times that lie further apart, from {:.3} to {:.3} s",
            time_s(one),
            seen.iter().map(time_s).fold(f64::INFINITY, f64::min),
            seen.iter().map(time_s).fold(f64::NEG_INFINITY, f64::max)
        ));
    }
    let (mut ids, mut pairs, mut places, mut variance) = (Vec::new(), Vec::new(), Vec::new(), 0.0);
    for a in one.features() {
        let Some(b) = two.features().iter().find(|b| b.id == a.id) else { continue };
        let Some(point) = config.target.points().iter().find(|p| u64::from(p.id) == a.id) else { continue };
        let (s_1, s_2) = (Vector2::new(a.x, a.y), Vector2::new(b.x, b.y));
        if s_1.iter().chain(s_2.iter()).all(|x| x.is_finite()) {
            ids.push(a.id);
            pairs.push(Conjugates { s_1, s_2 });
            places.push(point.p_O);
            variance += 0.5 * (a.sd_px.powi(2) + b.sd_px.powi(2));
        }
    }
    if ids.len() < 4 {
        return Err(format!("the two views share {} points of the target, at least 4 are needed", ids.len()));
    }
    let normal_O = normal_of(&places);
    let normal_2 = normal_O.zip(two.pose()).zip(places.first()).map(|((n_O, X_CO), p_O)| {
        let n = X_CO.rotation * n_O;
        n * n.dot(&(X_CO * p_O).coords).signum()
    });
    let rests = config.scene.as_ref().is_none_or(|scene| scene.motion == SceneMotion::Still);
    let camera_at = |m: &Measurement| Some(config.camera.mount.X_WC(robot, &track.at(m.exposure, 0.0)?.0));
    let X_12 = camera_at(one).zip(camera_at(two)).filter(|_| rests).map(|(a, b)| a.inv_mul(&b));
    Ok(RecordedViews {
        sd_px: (variance / ids.len() as f64).sqrt(),
        ids,
        pairs,
        camera: config.camera.model,
        is_plane: normal_O.is_some(),
        normal_2,
        times_s: [time_s(one), time_s(two)],
        frames: [one.frame_id, two.frame_id],
        X_12,
    })
}

/// The unit normal of the plane of these points; `None` where they are not of one plane, or of one line.
fn normal_of(points: &[Point3<f64>]) -> Option<Vector3<f64>> {
    let mean = points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / points.len().max(1) as f64;
    let spread = |sum: Matrix3<f64>, p: &Point3<f64>| sum + (p.coords - mean) * (p.coords - mean).transpose();
    let (values, vectors) = symmetric_eigen(&points.iter().fold(Matrix3::zeros(), spread))?;
    let is_plane = values.z <= FLAT * values.x && values.y > FLAT * values.x;
    is_plane.then(|| vectors.column(2).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_has_a_normal_and_a_body_has_none() {
        let flat: Vec<_> = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.2], [0.0, 0.2]]
            .map(|[x, y]| Point3::new(x, y, 0.3 * x - 0.1))
            .into();
        let n = normal_of(&flat).unwrap();
        assert!((n.cross(&Vector3::new(-0.3, 0.0, 1.0).normalize())).norm() < 1e-9, "{n}");
        let mut body = flat.clone();
        body.push(Point3::new(0.05, 0.05, 0.1));
        assert!(normal_of(&body).is_none());
        let line: Vec<_> = (0..4).map(|k| Point3::new(0.1 * f64::from(k), 0.0, 0.0)).collect();
        assert!(normal_of(&line).is_none());
        assert!(is_recording(Path::new("a/run.MCAP")) && !is_recording(Path::new("pairs.csv")));
    }
}
