//! `vservo pose`: the pose of an object from the image of its points, Sect. 10.3, by each of the chapter's ways, with all solutions.

pub(super) mod points;
mod solve;

use super::detect::{calibration, refused};
use super::{PoseArguments, PoseMethod, json, shown};
use crate::calibration::hand_eye::{camera_in_base, camera_in_effector};
use crate::geometry::{Pose, unit_quaternion};
use crate::pose::{chained_covariance, object_in_base, object_in_effector};
use crate::process::ProcessError;
use nalgebra::{Matrix6, Translation3};
use points::Points;
use serde::Serialize;
use solve::Solution;

/// Likelihood ratio below which another solution may be the true one. Chosen by hand: an error rate of 1 % with equal priors; ratios that `detect` and
/// vision call ambiguous lie well below.
const SURE_RATIO: f64 = 100.0;
/// How many times worse than stated points may fit before that is said. Derived: honest deviations exceed it less than once in 1000 cases with six degrees of freedom, less often with more; with the two of four points once in 55.
const MISFIT: f64 = 2.0;

#[derive(Serialize)]
struct PoseAnswer {
    method: &'static str,
    points: usize,
    /// Most likely first.
    solutions: Vec<SolutionOut>,
    ambiguous: bool,
    reason: Option<String>,
}

/// Lengths in m, angles in rad; covariances are those of twists `[v; w]` of the object relative to the frame, expressed in it, by rows.
#[derive(Serialize)]
struct SolutionOut {
    position_m: [f64; 3],
    rotation_xyzw: [f64; 4],
    rms: f64,
    /// How many times less likely than the first.
    likelihood_ratio: f64,
    steps: Option<u32>,
    /// The pose of least squares that lies nearest, weighted with the stated deviations.
    refined: Option<Refined>,
    #[serde(skip_serializing_if = "Option::is_none")]
    object_in_base: Option<BeyondCamera>,
    #[serde(skip_serializing_if = "Option::is_none")]
    object_in_effector: Option<BeyondCamera>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_in_base: Option<PlaceOf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_in_effector: Option<PlaceOf>,
}

#[derive(Serialize)]
struct Refined {
    #[serde(flatten)]
    place: PlaceOf,
    rms: f64,
    chi_square: Option<f64>,
    /// `null` where no deviation is stated.
    covariance: Option<Vec<f64>>,
    position_sd_m: Option<[f64; 3]>,
    rotation_sd_rad: Option<[f64; 3]>,
}

#[derive(Serialize, Clone, Copy)]
struct PlaceOf {
    position_m: [f64; 3],
    rotation_xyzw: [f64; 4],
}

#[derive(Serialize)]
struct BeyondCamera {
    #[serde(flatten)]
    place: PlaceOf,
    covariance: Option<Vec<f64>>,
}

impl From<&Pose> for PlaceOf {
    fn from(pose: &Pose) -> Self {
        let q = pose.rotation.coords;
        Self { position_m: pose.translation.vector.into(), rotation_xyzw: [q.x, q.y, q.z, q.w] }
    }
}

/// Solves and tells; the exit code.
pub(super) fn pose(arguments: &PoseArguments) -> Result<u8, ProcessError> {
    let frames = match KnownFrames::of(arguments) {
        Ok(frames) => frames,
        Err(e) => return Ok(refused(&e, 2)),
    };
    let camera = match arguments.camera.as_deref().map(calibration).transpose() {
        Ok(camera) => camera,
        Err(e) => return Ok(refused(&format!("--camera: {e}"), 3)),
    };
    let points = match Points::read(&arguments.points, camera, arguments.sd) {
        Ok(points) => points,
        Err(e) => return Ok(refused(&e, 3)),
    };
    let solutions = match solve::solve(&points, arguments) {
        Ok(solutions) => solutions,
        Err(e) => return Ok(refused(&e, 5)),
    };
    let answer = answer(arguments.method, &points, &solutions, &frames);
    Ok(shown(&if arguments.json { json(&answer) } else { told(&answer) }, 0))
}

/// Poses that are known beside what is seen.
struct KnownFrames {
    X_BC: Option<Pose>,
    X_EC: Option<Pose>,
    X_BO: Option<Pose>,
    X_BE: Option<Pose>,
}

impl KnownFrames {
    fn of(a: &PoseArguments) -> Result<Self, String> {
        let read = |name: &str, text: &Option<String>| {
            text.as_deref().map(pose_of).transpose().map_err(|e| format!("--{name}: {e}"))
        };
        Ok(Self {
            X_BC: read("camera-in-base", &a.camera_in_base)?,
            X_EC: read("camera-in-effector", &a.camera_in_effector)?,
            X_BO: read("object-in-base", &a.object_in_base)?,
            X_BE: read("effector-in-base", &a.effector_in_base)?,
        })
    }
}

/// So many numbers with commas between them; `None` where there are others, or a word that is none.
pub(super) fn numbers_of<const M: usize>(text: &str) -> Option<[f64; M]> {
    let words: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    words?.try_into().ok()
}

/// `x,y,z,qx,qy,qz,qw`: m, and a quaternion.
pub(super) fn pose_of(text: &str) -> Result<Pose, String> {
    let problem =
        || format!("`{text}` is no pose: seven numbers x,y,z,qx,qy,qz,qw are expected (m, and a quaternion)");
    let [x, y, z, qx, qy, qz, qw] = numbers_of(text).ok_or_else(problem)?;
    let rotation = unit_quaternion([qx, qy, qz, qw]).ok_or_else(|| {
        let norm = [qx, qy, qz, qw].iter().map(|q| q * q).sum::<f64>().sqrt();
        format!("`{text}` is no pose: the quaternion qx,qy,qz,qw has length {norm:.4}, and that of a rotation has 1; the real part stands last")
    })?;
    let pose = Pose::from_parts(Translation3::new(x, y, z), rotation);
    pose.to_homogeneous().iter().all(|v| v.is_finite()).then_some(pose).ok_or_else(problem)
}

fn answer(method: PoseMethod, points: &Points, solutions: &[Solution], frames: &KnownFrames) -> PoseAnswer {
    // where nothing could be refined, the method's own pose tells it: at most more than it could be
    let chi = |s: &Solution| s.refined.as_ref().map_or(s.chi_square, |r| r.chi_square);
    let least = solutions.iter().map(chi).fold(f64::INFINITY, f64::min);
    // where no deviation is stated, the misfit of the best tells it: chi-square per degree of freedom is 1
    let freedom = (2 * points.pixels.len()).saturating_sub(6) as f64;
    // an exact fit has no misfit, and must not divide by it
    let growth = if points.stated { 1.0 } else { (least / freedom.max(1.0)).max(1e-18) };
    // `exp(710)` is beyond the largest number, and would be infinite
    let ratio = |s: &Solution| (0.5 * (chi(s) - least) / growth).min(700.0).exp();
    let out = |s: &Solution| solution_out(s, points, frames, ratio(s));
    let mut told: Vec<_> = solutions.iter().map(out).collect();
    let key = |s: &SolutionOut| s.likelihood_ratio;
    told.sort_by(|a, b| key(a).total_cmp(&key(b)).then(a.rms.total_cmp(&b.rms)));
    let second = told.get(1).map(key);
    let ambiguous = second.is_some_and(|ratio| ratio < SURE_RATIO);
    let why = second.filter(|_| ambiguous).map(|ratio| {
        if points.distinct() < 4 {
            format!(
                "{} poses explain three points equally well (likelihood ratio {ratio:.1}): see a fourth point, or know the pose of before",
                told.len()
            )
        } else {
            format!(
                "the second pose is only {ratio:.1} times less likely: the view is too far or too frontal to tell them apart; use the pose of before"
            )
        }
    });
    let reasons: Vec<_> = why.into_iter().chain(misfit(points, least, freedom)).collect();
    let reason = (!reasons.is_empty()).then(|| reasons.join("; and "));
    PoseAnswer { method: method.word(), points: points.pixels.len(), solutions: told, ambiguous, reason }
}

/// What is said of points that fit the best pose worse than their stated deviation lets them.
fn misfit(points: &Points, chi_square: f64, freedom: f64) -> Option<String> {
    let times = (chi_square / freedom).sqrt();
    (points.stated && freedom > 0.0 && times.is_finite() && times > MISFIT).then(|| {
        format!("the points fit {times:.1} times worse than is stated of them: one of them is wrong, or the stated covariances are too small by the square of that")
    })
}

fn solution_out(s: &Solution, points: &Points, frames: &KnownFrames, ratio: f64) -> SolutionOut {
    let covariance = s.refined.as_ref().filter(|_| points.stated).map(|r| r.covariance);
    // the refined pose is what counts beyond the camera; where there is none, the method's own
    let X_CO = s.refined.as_ref().map_or(s.X_CO, |r| r.X_CO);
    let beyond = |X: &Pose, whole: Pose| BeyondCamera {
        place: (&whole).into(),
        covariance: covariance
            .map(|own| chained_covariance(X, &Matrix6::zeros(), &X_CO, &own).iter().copied().collect()),
    };
    let sd = |at: usize| covariance.map(|c| [0, 1, 2].map(|i| c[(at + i, at + i)].sqrt()));
    let PlaceOf { position_m, rotation_xyzw } = (&s.X_CO).into();
    SolutionOut {
        position_m,
        rotation_xyzw,
        rms: s.rms_px * points.unit,
        likelihood_ratio: ratio,
        steps: s.steps,
        refined: s.refined.as_ref().map(|r| Refined {
            place: (&r.X_CO).into(),
            rms: solve::rms_px(&r.X_CO, points) * points.unit,
            chi_square: points.stated.then_some(r.chi_square),
            // symmetric: by rows is by columns
            covariance: covariance.map(|c| c.iter().copied().collect()),
            position_sd_m: sd(0),
            rotation_sd_rad: sd(3),
        }),
        object_in_base: frames.X_BC.map(|X| beyond(&X, object_in_base(&X, &X_CO))),
        object_in_effector: frames.X_EC.map(|X| beyond(&X, object_in_effector(&X, &X_CO))),
        camera_in_base: frames.X_BO.map(|X_BO| (&camera_in_base(&X_BO, &X_CO)).into()),
        camera_in_effector: frames
            .X_BO
            .zip(frames.X_BE)
            .map(|(X_BO, X_BE)| (&camera_in_effector(&(X_BE.inverse() * X_BO), &X_CO)).into()),
    }
}

/// For people.
fn told(answer: &PoseAnswer) -> String {
    let mut text = format!(
        "{}: {} of {} points{}\n",
        answer.method,
        crate::report::numbers::counted(answer.solutions.len() as u64, "solution"),
        answer.points,
        answer.reason.as_ref().map_or_else(String::new, |reason| {
            format!("; {}{reason}", if answer.ambiguous { "ambiguous: " } else { "" })
        })
    );
    for (i, s) in (1..).zip(&answer.solutions) {
        let place = |p: &[f64; 3], q: &[f64; 4]| {
            format!(
                "at ({:.5}, {:.5}, {:.5}) m, rotation ({:.5}, {:.5}, {:.5}, {:.5})",
                p[0], p[1], p[2], q[0], q[1], q[2], q[3]
            )
        };
        text += &format!("{i}: {}, rms {:.3e}", place(&s.position_m, &s.rotation_xyzw), s.rms);
        if let Some(steps) = s.steps {
            text += &format!(", {steps} steps");
        }
        if s.likelihood_ratio > 1.0 {
            text += &format!(", {:.3e} times less likely", s.likelihood_ratio);
        }
        text.push('\n');
        if let Some(r) = &s.refined {
            text += &format!(
                "   refined {}, rms {:.3e}\n",
                place(&r.place.position_m, &r.place.rotation_xyzw),
                r.rms
            );
            if let (Some(p), Some(w)) = (r.position_sd_m, r.rotation_sd_rad) {
                let [a, b, c] = w.map(f64::to_degrees);
                text += &format!(
                    "   sd ({:.2e}, {:.2e}, {:.2e}) m, ({a:.3}, {b:.3}, {c:.3}) degrees\n",
                    p[0], p[1], p[2]
                );
            }
        }
        let beyond = [
            ("object in the base", s.object_in_base.as_ref().map(|b| b.place)),
            ("object in the end-effector", s.object_in_effector.as_ref().map(|b| b.place)),
            ("camera in the base", s.camera_in_base),
            ("camera in the end-effector", s.camera_in_effector),
        ];
        for (what, p) in beyond.into_iter().filter_map(|(what, p)| Some((what, p?))) {
            text += &format!("   {what} {}\n", place(&p.position_m, &p.rotation_xyzw));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_that_is_no_number_is_refused() {
        assert!(pose_of("0,0,1..5,0.3,0,0,0,1").is_err());
        assert!(pose_of("0,0,0.3,0,0,0,1,").is_err());
        assert_eq!(numbers_of::<3>(" 1, 2,3 "), Some([1.0, 2.0, 3.0]));
        assert_eq!(numbers_of::<3>("1,2"), None);
    }

    #[test]
    fn a_quaternion_of_another_length_is_no_pose() {
        let told = |q: &str| pose_of(&format!("0.1,0.2,0.3,{q}"));
        assert_eq!(told("0,0,0.707,0.707").map(|X| X.translation.vector.x), Ok(0.1), "three decimals");
        assert!(told("0,0,0,2").unwrap_err().contains("has length 2.0000"));
        assert!(told("0,0,0,0").is_err() && told("0,0,0,inf").is_err() && told("0,0,1").is_err());
    }
}
