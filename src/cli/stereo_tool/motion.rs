//! `vservo stereo motion`: displacement of a camera between two images of points, (10.43)-(10.46), or of a plane, (10.58)-(10.61), and where the points are, (10.47), (10.48); of a
//! recording between two of its instants.

use super::hints::{Hint, chosen, hints};
use super::motion_answer::{
    Fundamental, KinematicMotion, MotionAnswer, PlaneAnswer, PlaneReading, PointMotion, RecordedInstants,
    told,
};
use super::pairs::{PairFile, intrinsic_matrix, normalized_noise};
use super::recorded::{self, is_recording};
use super::structure::add_structure;
use super::{Refused, finite, rows};
use crate::camera_model::CameraModel;
use crate::cli::detect::{calibration, refused};
use crate::cli::pose_tool::numbers_of;
use crate::cli::{MotionMethod, StereoMotionArguments, json, shown};
use crate::geometry::Pose;
use crate::pose::{ConsensusSettings, HomographySolutions, decompose_homography};
use crate::process::ProcessError;
use crate::stereo::{
    Conjugates, DegenerateMotion, RefinedRelativePose, RelativeConsensus, StereoError, degenerate_motion,
    epipoles, essential_5_point, essential_8_point, fundamental_8_point, fundamental_matrix, plane_motion,
    plane_motion_consistent, refine_relative, relative_pose, sampson_error2, turn_beside_plane,
};
use nalgebra::{Matrix3, Vector2};
use std::path::Path;

/// How far the cosine of the angle between two solutions may be from 1 if they are one: 1e-5 rad, a hundred times what a refinement stops at, and less than the error of any pixel. Chosen by hand.
const SAME: f64 = 1e-10;

/// The two rotations of one essential matrix are half a turn apart, rad: a quarter tells them.
const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

/// Shortest base line over the distance of the plane that a homography tells. Chosen by hand: matrices are written with six decimals.
const NO_BASE_LINE: f64 = 5e-6;
/// A camera that moved by less stood, m. Chosen by hand: less than joints' encoders and any image tell.
const STOOD_M: f64 = 1e-4;
const TURNED_ALONE: &str = "the camera turned alone, as far as this shows: there is no base line, and neither its direction nor a plane's normal means anything";

/// An inlier lies within this many standard deviations of its epipolar line. Chosen by hand: a normal deviate exceeds 3 once in 370 cases.
const INLIER_SDS: f64 = 3.0;

pub(super) fn motion(arguments: &StereoMotionArguments) -> Result<u8, ProcessError> {
    match run(arguments) {
        Ok(answer) => Ok(shown(&if arguments.json { json(&answer) } else { told(&answer) }, 0)),
        Err((message, code)) => Ok(refused(&message, code)),
    }
}

fn run(a: &StereoMotionArguments) -> Result<MotionAnswer, Refused> {
    let failed = |e: StereoError| (e.to_string(), 5);
    let hints = hints(a)?;
    if let Some(text) = &a.homography {
        let H = matrix_of(text).map_err(|e| (format!("--homography: {e}"), 2))?;
        let solutions = decompose_homography(&H).map_err(|e| (e.to_string(), 5))?;
        return Ok(of_plane("homography", 0, &H, None, (&chosen(&hints, solutions), false)));
    }
    let path = a.pairs.as_ref().ok_or(("PAIRS.csv or --homography is needed".to_owned(), 2))?;
    if a.baseline_m.is_some_and(|length| !(length > 0.0 && length.is_finite())) {
        return Err(("--baseline-m: a length is greater than 0".into(), 2));
    }
    match (&a.at, is_recording(path)) {
        (Some(at), true) => return of_recording(a, path, at, hints),
        (None, true) => {
            return Err((
                format!("{}: of a recording two instants are taken: --at T1,T2", path.display()),
                2,
            ));
        }
        (Some(_), false) => return Err(("--at: is for a recording, RUN.mcap".into(), 2)),
        (None, false) => {}
    }
    let method = a.method.unwrap_or(MotionMethod::Consensus);
    let file = PairFile::read(path).map_err(|e| (e, 3))?;
    let cameras = cameras(a).map_err(|e| (format!("--camera: {e}"), 3))?;
    let cameras = cameras.as_ref().map(|(one, two)| (one, two));
    if file.in_px && cameras.is_none() {
        if method != MotionMethod::EightPoint {
            let message =
                "points in px without --camera give the fundamental matrix alone: --method eight_point";
            return Err((message.into(), 2));
        }
        let F = fundamental_8_point(&file.pairs).map_err(failed)?;
        return Ok(fundamental_alone(&F, &file.pairs));
    }
    let pairs = file.normalized(cameras).map_err(|e| (e, 3))?;
    let sd = a.sd.map(|sd| match cameras.filter(|_| file.in_px) {
        Some(cameras) => normalized_sd(cameras, &pairs, sd),
        None => sd,
    });
    let mut answer = of_pairs(a, method, (&file.ids, &pairs), sd, cameras, &hints)?;
    if answer.reason.as_deref() != Some(TURNED_ALONE) {
        add_structure(&mut answer, &file.ids, &pairs, a.baseline_m);
    }
    Ok(answer)
}

/// By one of the methods, from normalized pairs.
fn of_pairs(
    a: &StereoMotionArguments,
    method: MotionMethod,
    (ids, pairs): (&[u64], &[Conjugates]),
    sd: Option<f64>,
    cameras: Option<(&CameraModel, &CameraModel)>,
    hints: &[Hint],
) -> Result<MotionAnswer, Refused> {
    let failed = |e: StereoError| (e.to_string(), 5);
    if method != MotionMethod::Plane {
        return of_points(method, ids, pairs, sd, cameras).map_err(failed);
    }
    let motion = plane_motion(pairs).map_err(failed)?;
    let mut solutions = chosen(hints, motion.solutions);
    if let Some(path) = &a.third {
        let third = PairFile::read(path).and_then(|f| f.normalized(cameras)).map_err(|e| (e, 3))?;
        let second = plane_motion(&third).map_err(failed)?;
        let (first, _) = plane_motion_consistent(&solutions, &second.solutions);
        solutions = HomographySolutions { first, second: None };
    }
    let turned = turn_beside_plane(pairs, motion.rms).is_some();
    Ok(of_plane("plane", pairs.len(), &motion.H, Some(motion.rms), (&solutions, turned)))
}

/// From two instants of a recording, beside what the joints say.
fn of_recording(
    a: &StereoMotionArguments,
    path: &Path,
    at: &str,
    mut hints: Vec<Hint>,
) -> Result<MotionAnswer, Refused> {
    let at_s = numbers_of::<2>(at).filter(|at| at.iter().all(|s| s.is_finite()));
    let at_s = at_s.ok_or_else(|| (format!("--at {at}: two times in s are expected, T1,T2"), 2))?;
    let views = recorded::read(path, at_s).map_err(|e| (e.to_string(), 3))?.map_err(|e| (e, 5))?;
    let moved = views.X_12.filter(|X_12| X_12.translation.vector.norm() > STOOD_M);
    // What is known besides tells which reading of a plane is true: where the joints have the camera go, or else the plane's normal by the measured pose.
    if hints.is_empty() {
        hints.extend(moved.map(|X_12| Hint::Way(X_12.translation.vector)));
        hints.extend(views.normal_2.map(Hint::Normal));
    }
    let (method, method_reason) = match a.method {
        Some(method) => (method, None),
        None if views.is_plane => {
            (MotionMethod::Plane, Some("the points lie in one plane of the target: by its homography"))
        }
        None if views.pairs.len() < 6 => (MotionMethod::FivePoint, Some("fewer than six points are shared")),
        None => (MotionMethod::Consensus, None),
    };
    let cameras = (&views.camera, &views.camera);
    let sd = normalized_sd(cameras, &views.pairs, a.sd.unwrap_or(views.sd_px));
    let sd = Some(sd).filter(|sd| *sd > 0.0);
    let mut answer = of_pairs(a, method, (&views.ids, &views.pairs), sd, Some(cameras), &hints)?;
    let base_line_m = a.baseline_m.or(moved.map(|X_12| X_12.translation.vector.norm()));
    if answer.reason.as_deref() != Some(TURNED_ALONE) {
        add_structure(&mut answer, &views.ids, &views.pairs, base_line_m);
    }
    let estimate = answer.first_displacement();
    let kinematics = views.X_12.map(|X_12| {
        let (p, q) = (X_12.translation.vector, X_12.rotation.coords);
        let way = estimate.as_ref().map(|X| X.translation.vector).filter(|way| way.norm() > 0.0);
        KinematicMotion {
            position_m: p.into(),
            rotation_xyzw: [q.x, q.y, q.z, q.w],
            base_line_m: p.norm(),
            rotation_off_deg: estimate.as_ref().map(|X| X.rotation.angle_to(&X_12.rotation).to_degrees()),
            direction_off_deg: way.filter(|_| moved.is_some()).map(|way| way.angle(&p).to_degrees()),
        }
    });
    let (times_s, frames) = (views.times_s, views.frames);
    answer.recording = Some(RecordedInstants { times_s, frames, method_reason, kinematics });
    Ok(answer)
}

/// The standard deviation of a normalized coordinate, root mean square over all points and both cameras, whose lenses and focal lengths make it differ.
fn normalized_sd(cameras: (&CameraModel, &CameraModel), pairs: &[Conjugates], sd_px: f64) -> f64 {
    let variance = |camera: &CameraModel, s: &Vector2<f64>| {
        normalized_noise(camera, s, sd_px).map_or(f64::NAN, |noise| 0.5 * noise.trace())
    };
    let all = pairs.iter().map(|p| 0.5 * (variance(cameras.0, &p.s_1) + variance(cameras.1, &p.s_2)));
    let (sum, count) =
        all.filter(|v| v.is_finite()).fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    f64::sqrt(sum / f64::max(count, 1.0))
}

fn cameras(a: &StereoMotionArguments) -> Result<Option<(CameraModel, CameraModel)>, String> {
    let first = a.camera.as_deref().map(calibration).transpose()?;
    let second = a.camera_2.as_deref().map(calibration).transpose()?;
    Ok(first.map(|first| (first, second.unwrap_or(first))))
}

fn matrix_of(text: &str) -> Result<Matrix3<f64>, String> {
    let numbers: [f64; 9] =
        numbers_of(text).ok_or_else(|| format!("`{text}`: nine numbers by rows are expected"))?;
    Ok(Matrix3::from_row_slice(&numbers))
}

fn of_plane(
    method: &'static str,
    pairs: usize,
    H: &Matrix3<f64>,
    rms: Option<f64>,
    (solutions, turned): (&HomographySolutions, bool),
) -> MotionAnswer {
    let turned = turned || solutions.first.p_12_1_over_d2.norm() <= NO_BASE_LINE;
    let both = [Some(solutions.first), solutions.second.filter(|_| !turned)];
    let readings: Vec<_> = both
        .into_iter()
        .flatten()
        .map(|s| PlaneReading {
            rotation: rows(s.R_12.matrix()),
            position_over_distance: s.p_12_1_over_d2.into(),
            normal_2: (!turned).then_some(s.n_2.into()),
            structure: None,
        })
        .collect();
    let ambiguous = turned || readings.len() > 1;
    let reason = match turned {
        true => Some(TURNED_ALONE.to_owned()),
        false => ambiguous.then(|| {
            "two images of a plane have two readings: a third view (--third), the plane's normal (--normal) or the way (--direction) tells"
                .to_owned()
        }),
    };
    let plane = PlaneAnswer { homography: rows(H), rms, readings };
    MotionAnswer {
        method,
        pairs,
        solutions: Vec::new(),
        plane: Some(plane),
        fundamental: None,
        ambiguous,
        reason,
        recording: None,
    }
}

fn fundamental_alone(F: &Matrix3<f64>, pairs: &[Conjugates]) -> MotionAnswer {
    let both = epipoles(F);
    let fundamental = Fundamental {
        matrix: rows(F),
        epipole_1_px: both.as_ref().and_then(|e| finite(&e.0)),
        epipole_2_px: both.as_ref().and_then(|e| finite(&e.1)),
        rms_px: rms(F, pairs),
    };
    MotionAnswer {
        method: MotionMethod::EightPoint.word(),
        pairs: pairs.len(),
        solutions: Vec::new(),
        plane: None,
        fundamental: Some(fundamental),
        ambiguous: false,
        reason: Some("without --camera there is no essential matrix and no displacement".into()),
        recording: None,
    }
}

fn rms(E: &Matrix3<f64>, pairs: &[Conjugates]) -> f64 {
    (pairs.iter().map(|pair| sampson_error2(E, pair)).sum::<f64>() / pairs.len().max(1) as f64).sqrt()
}

fn of_points(
    method: MotionMethod,
    ids: &[u64],
    pairs: &[Conjugates],
    sd: Option<f64>,
    cameras: Option<(&CameraModel, &CameraModel)>,
) -> Result<MotionAnswer, StereoError> {
    let one =
        |E: &Matrix3<f64>, X_12: Pose, in_front: usize| point_motion(E, &X_12, in_front, pairs, cameras);
    let mut solutions = Vec::new();
    let mut degenerate = None;
    match method {
        MotionMethod::FivePoint => {
            let first: &[Conjugates; 5] =
                pairs.first_chunk().ok_or(StereoError::TooFewPoints { needed: 5, given: pairs.len() })?;
            for E in essential_5_point(first)?.as_slice() {
                let Ok((X_12, in_front)) = relative_pose(E, pairs) else { continue };
                // Further pairs tell which of the solutions is true, and where it is: with errors, five alone are far off.
                let further = (pairs.len() > first.len()).then_some(pairs);
                let solution = match further.and_then(|all| refined(&X_12, all, sd)) {
                    Some((refined, in_front)) => refined_motion(&refined, in_front, pairs, cameras, sd),
                    None => one(E, X_12, in_front),
                };
                if !solutions.iter().any(|known| is_same(known, &solution)) {
                    solutions.push(solution);
                }
            }
            solutions.sort_by(better);
            let best = solutions.first().filter(|_| pairs.len() > first.len());
            degenerate = best
                .and_then(|best| degenerate_motion(pairs, best.rms, sd.unwrap_or(0.0)))
                .map(|of| (of, pairs.to_vec()));
            solutions.truncate(if degenerate.is_some() { 1 } else { solutions.len() });
        }
        MotionMethod::EightPoint => {
            let E = essential_8_point(pairs)?;
            let (X_12, in_front) = relative_pose(&E, pairs)?;
            let solution = match refined(&X_12, pairs, sd) {
                Some((refined, in_front)) => refined_motion(&refined, in_front, pairs, cameras, sd),
                None => one(&E, X_12, in_front),
            };
            // Of points in one plane the linear equations have many solutions, and the one that comes may have any error.
            let least = plane_motion(pairs).map_or(f64::INFINITY, |plane| plane.rms).min(solution.rms);
            degenerate = degenerate_motion(pairs, least, sd.unwrap_or(0.0)).map(|of| (of, pairs.to_vec()));
            solutions.push(solution);
        }
        MotionMethod::Consensus => {
            let settings = ConsensusSettings::default();
            let threshold = sd.map_or(settings.threshold, |sd| INLIER_SDS * sd);
            let mut consensus = RelativeConsensus::with_capacity(pairs.len());
            let settings = ConsensusSettings { threshold, ..settings };
            let found = consensus.search(pairs, &settings, sd.unwrap_or(0.0))?;
            let agree: Vec<_> =
                pairs.iter().zip(consensus.inliers()).filter(|(_, is)| **is).map(|(p, _)| *p).collect();
            let best = refined(&found.refined.X_12, &agree, sd).ok_or(StereoError::BehindCamera)?;
            let mut solution = refined_motion(&best.0, best.1, &agree, cameras, sd);
            let inliers = ids.iter().zip(consensus.inliers()).filter(|(_, is)| **is).map(|(id, _)| *id);
            solution.inliers = Some(inliers.collect());
            degenerate = degenerate_motion(&agree, solution.rms, sd.unwrap_or(0.0)).map(|of| (of, agree));
            solutions.push(solution);
        }
        MotionMethod::Plane => {}
    }
    if solutions.is_empty() {
        return Err(StereoError::BehindCamera);
    }
    let mut no_base_line = false;
    match degenerate {
        // Both readings of the plane in place of the one that was found, with what agreed.
        Some((DegenerateMotion::Plane(readings), agree)) => {
            let inliers = solutions.pop().and_then(|found| found.inliers);
            solutions.extend(readings.iter().map(|reading| PointMotion {
                inliers: inliers.clone(),
                ..refined_motion(reading, agree.len(), &agree, cameras, sd)
            }));
        }
        Some((DegenerateMotion::Turn(turn), _)) => {
            for found in &mut solutions {
                found.rotation_xyzw = turn.coords.into();
                (found.covariance, found.tangents) = (None, None);
            }
            no_base_line = true;
        }
        None => {}
    }
    solutions.sort_by(better);
    let equal = |s: &PointMotion| {
        solutions.first().is_some_and(|best| s.in_front == best.in_front && s.rms <= 2.0 * best.rms + 1e-9)
    };
    let count = solutions.iter().filter(|s| equal(s)).count();
    let ambiguous = count > 1 || no_base_line;
    let reason = if no_base_line {
        Some(TURNED_ALONE.to_owned())
    } else {
        ambiguous.then(|| {
            format!(
                "{count} displacements explain these pairs equally well: give more than five, not of one plane"
            )
        })
    };
    let method = method.word();
    Ok(MotionAnswer {
        method,
        pairs: pairs.len(),
        solutions,
        plane: None,
        fundamental: None,
        ambiguous,
        reason,
        recording: None,
    })
}

/// The displacement of least error near a start, from which most points lie in front of both cameras, and how many; `None` where there is none. The error is the same for the
/// opposite base line and for the turned camera, to which a refinement may come.
fn refined(start: &Pose, pairs: &[Conjugates], sd: Option<f64>) -> Option<(RefinedRelativePose, usize)> {
    let refine = |start: &Pose| refine_relative(start, pairs, sd.unwrap_or(0.0)).ok();
    let found = refine(start)?;
    let (X_12, in_front) = relative_pose(&crate::stereo::essential_matrix(&found.X_12), pairs).ok()?;
    let turn = X_12.rotation.angle_to(&found.X_12.rotation);
    let is_it = turn < QUARTER && X_12.translation.vector.dot(&found.X_12.translation.vector) > 0.0;
    Some((if is_it { found } else { refine(&X_12)? }, in_front))
}

/// The order of solutions: most points in front, then the least error.
fn better(a: &PointMotion, b: &PointMotion) -> std::cmp::Ordering {
    b.in_front.cmp(&a.in_front).then(a.rms.total_cmp(&b.rms))
}

/// Whether two solutions are one, to which both starts led.
fn is_same(a: &PointMotion, b: &PointMotion) -> bool {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    1.0 - dot(&a.rotation_xyzw, &b.rotation_xyzw).abs() < SAME && 1.0 - dot(&a.direction, &b.direction) < SAME
}

fn point_motion(
    E: &Matrix3<f64>,
    X_12: &Pose,
    in_front: usize,
    pairs: &[Conjugates],
    cameras: Option<(&CameraModel, &CameraModel)>,
) -> PointMotion {
    let both = epipoles(E);
    let fundamental = cameras.and_then(|(one, two)| {
        fundamental_matrix(E, &intrinsic_matrix(one), &intrinsic_matrix(two)).map(|F| rows(&(F / F.norm())))
    });
    let q = X_12.rotation.coords;
    PointMotion {
        essential: rows(E),
        fundamental,
        epipole_1: both.as_ref().and_then(|e| finite(&e.0)),
        epipole_2: both.as_ref().and_then(|e| finite(&e.1)),
        rotation_xyzw: [q.x, q.y, q.z, q.w],
        direction: X_12.translation.vector.into(),
        in_front,
        rms: rms(E, pairs),
        inliers: None,
        covariance: None,
        tangents: None,
        structure: None,
    }
}

fn refined_motion(
    refined: &RefinedRelativePose,
    in_front: usize,
    pairs: &[Conjugates],
    cameras: Option<(&CameraModel, &CameraModel)>,
    sd: Option<f64>,
) -> PointMotion {
    let E = crate::stereo::essential_matrix(&refined.X_12);
    PointMotion {
        // symmetric: by rows is by columns
        covariance: sd.map(|_| refined.covariance.iter().copied().collect()),
        tangents: Some(refined.tangents.map(Into::into)),
        ..point_motion(&E, &refined.X_12, in_front, pairs, cameras)
    }
}
