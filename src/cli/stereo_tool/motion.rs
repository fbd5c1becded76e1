//! `vservo stereo motion`: displacement of a camera between two images of points, (10.43)-(10.46), or of a plane, (10.58)-(10.61).

use super::motion_answer::{Fundamental, MotionAnswer, PlaneAnswer, PlaneReading, PointMotion, told};
use super::pairs::{PairFile, intrinsic_matrix, normalized_noise};
use super::{finite, rows};
use crate::camera_model::CameraModel;
use crate::cli::detect::{calibration, refused};
use crate::cli::pose_tool::numbers_of;
use crate::cli::{MotionMethod, StereoMotionArguments, json, shown};
use crate::geometry::Pose;
use crate::pose::{ConsensusSettings, HomographySolution, HomographySolutions, decompose_homography};
use crate::process::ProcessError;
use crate::stereo::{
    Conjugates, DegenerateMotion, RefinedRelativePose, RelativeConsensus, StereoError, degenerate_motion,
    epipoles, essential_5_point, essential_8_point, fundamental_8_point, fundamental_matrix, plane_motion,
    plane_motion_consistent, refine_relative, relative_pose, sampson_error2, turn_beside_plane,
};
use nalgebra::{Matrix3, Vector2, Vector3};

/// How far the cosine of the angle between two solutions may be from 1 if they are one: 1e-5 rad, a hundred times what a refinement stops at, and less than the error of any pixel. Chosen by hand.
const SAME: f64 = 1e-10;

/// The two rotations of one essential matrix are half a turn apart, rad: a quarter tells them.
const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

/// Shortest base line over the distance of the plane that a homography tells. Chosen by hand: matrices are written with six decimals.
const NO_BASE_LINE: f64 = 5e-6;
const TURNED_ALONE: &str = "the camera turned alone, as far as this shows: there is no base line, and neither its direction nor a plane's normal means anything";

/// How much nearer to a hint the true reading must be than the other, rad. Chosen by hand: a plane's normal is seldom known better than to two degrees.
const TIE: f64 = 0.035;
/// An inlier lies within this many standard deviations of its epipolar line. Chosen by hand: a normal deviate exceeds 3 once in 370 cases.
const INLIER_SDS: f64 = 3.0;

pub(super) fn motion(arguments: &StereoMotionArguments) -> Result<u8, ProcessError> {
    match run(arguments) {
        Ok(answer) => Ok(shown(&if arguments.json { json(&answer) } else { told(&answer) }, 0)),
        Err((message, code)) => Ok(refused(&message, code)),
    }
}

type Refused = (String, u8);

fn run(a: &StereoMotionArguments) -> Result<MotionAnswer, Refused> {
    let failed = |e: StereoError| (e.to_string(), 5);
    if let Some(text) = &a.homography {
        let H = matrix_of(text).map_err(|e| (format!("--homography: {e}"), 2))?;
        let solutions = decompose_homography(&H).map_err(|e| (e.to_string(), 5))?;
        return Ok(of_plane("homography", 0, &H, None, (&chosen(a, solutions)?, false)));
    }
    let path = a.pairs.as_ref().ok_or(("PAIRS.csv or --homography is needed".to_owned(), 2))?;
    let file = PairFile::read(path).map_err(|e| (e, 3))?;
    let cameras = cameras(a).map_err(|e| (format!("--camera: {e}"), 3))?;
    let cameras = cameras.as_ref().map(|(one, two)| (one, two));
    if file.in_px && cameras.is_none() {
        if a.method != MotionMethod::EightPoint {
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
    match a.method {
        MotionMethod::Plane => {
            let motion = plane_motion(&pairs).map_err(failed)?;
            let solutions = chosen(a, motion.solutions)?;
            let solutions = match &a.third {
                None => solutions,
                Some(path) => {
                    let third =
                        PairFile::read(path).and_then(|f| f.normalized(cameras)).map_err(|e| (e, 3))?;
                    let second = plane_motion(&third).map_err(failed)?;
                    let (first, _) = plane_motion_consistent(&solutions, &second.solutions);
                    HomographySolutions { first, second: None }
                }
            };
            let turned = turn_beside_plane(&pairs, motion.rms).is_some();
            Ok(of_plane("plane", pairs.len(), &motion.H, Some(motion.rms), (&solutions, turned)))
        }
        method => of_points(method, &file.ids, &pairs, sd, cameras).map_err(failed),
    }
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

fn vector_of(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: [f64; 3] =
        numbers_of(text).ok_or_else(|| format!("`{text}`: three numbers are expected"))?;
    Ok(Vector3::from(numbers))
}

/// The direction of a hint.
fn direction_of(option: &str, text: &str) -> Result<Vector3<f64>, Refused> {
    let direction = vector_of(text).map_err(|e| (format!("{option}: {e}"), 2))?;
    let usable = direction.iter().all(|x| x.is_finite()) && direction.norm() > 0.0;
    usable.then_some(direction).ok_or_else(|| (format!("{option}: `{text}` has no direction"), 2))
}

/// Whether both readings are as far from a hint, rad, so that it does not tell which is true.
fn is_tie(solutions: &HomographySolutions, apart: impl Fn(&HomographySolution) -> f64) -> bool {
    solutions.second.is_some_and(|second| (apart(&second) - apart(&solutions.first)).abs() < TIE)
}

/// Both readings, or the one that what is known besides tells.
fn chosen(a: &StereoMotionArguments, solutions: HomographySolutions) -> Result<HomographySolutions, Refused> {
    let one = |first: HomographySolution| HomographySolutions { first, second: None };
    if let Some(text) = &a.normal {
        let n_2 = direction_of("--normal", text)?;
        let apart = |s: &HomographySolution| s.n_2.angle(&n_2);
        return Ok(if is_tie(&solutions, apart) { solutions } else { one(solutions.nearest_normal(&n_2)) });
    }
    if let Some(text) = &a.direction {
        let way = direction_of("--direction", text)?;
        let apart = |s: &HomographySolution| s.p_12_1_over_d2.angle(&way);
        return Ok(if is_tie(&solutions, apart) {
            solutions
        } else {
            one(solutions.nearest_direction(&way))
        });
    }
    Ok(solutions)
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
            degenerate =
                degenerate_motion(pairs, solution.rms, sd.unwrap_or(0.0)).map(|of| (of, pairs.to_vec()));
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
