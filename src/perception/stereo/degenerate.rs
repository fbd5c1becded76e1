//! Pairs of which one essential matrix is no answer: points of one plane, which two displacements explain alike, and a camera that turned alone, which has no base line.
//!
//! Such pairs leave the equations (10.46) of more than one matrix without error, and the one that is found states a covariance as small as any. They show
//! in simpler models that explain them as well: the homography of a plane, a rotation.

use super::epipolar::Conjugates;
use super::plane_motion::plane_motion;
use super::relative_pose::{RefinedRelativePose, refine_relative};
use crate::geometry::Pose;
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};

/// How much larger than the error of the displacement, root mean square, that of a simpler model may be to explain pairs as well. Derived: with noise alone the error of a homography is 1.4
/// times as large, since a pair has two numbers instead of one, that of a rotation, of which both images have noise, twice; half as much again.
const AS_WELL_BY_PLANE: f64 = 2.0;
const AS_WELL_BY_TURN: f64 = 3.0;
/// The error of a homography with noise alone over that of a displacement. Derived: as above.
const BY_PLANE: f64 = std::f64::consts::SQRT_2;
/// Errors below this are none, normalized units: rounding of exact images.
const EXACT: f64 = 1e-9;

/// What the pairs are.
#[derive(Debug, Clone, PartialEq)]
pub enum DegenerateMotion {
    /// Images of points in one plane, with the displacements that explain them alike, the better first.
    Plane(Vec<RefinedRelativePose>),
    /// Images of a camera that turned alone: its pose has a rotation, and no base line that these pairs show.
    Turn(UnitQuaternion<f64>),
}

/// Whether pairs that a displacement explains with the error `rms` (normalized units) are of one plane, or of a camera that turned alone; `None` where neither explains them.
///
/// `sd`: standard deviation of each image coordinate, normalized units; it scales the covariances only.
#[must_use]
pub fn degenerate_motion(pairs: &[Conjugates], rms: f64, sd: f64) -> Option<DegenerateMotion> {
    if let Some(turn) = turn_alone(pairs, AS_WELL_BY_TURN * rms * freedom(pairs.len(), 5.0, 1.0)) {
        return Some(DegenerateMotion::Turn(turn));
    }
    let plane = plane_motion(pairs).ok().filter(|plane| plane.rms <= AS_WELL_BY_PLANE * rms + EXACT)?;
    let readings = [Some(plane.solutions.first), plane.solutions.second].into_iter().flatten();
    let refined = readings.filter_map(|reading| {
        let turn = UnitQuaternion::from_rotation_matrix(&reading.R_12);
        let X_12 = Pose::from_parts(Translation3::from(reading.p_12_1_over_d2), turn);
        refine_relative(&X_12, pairs, sd).ok()
    });
    let mut refined: Vec<_> = refined.collect();
    refined.sort_by(|a, b| a.rms.total_cmp(&b.rms));
    (!refined.is_empty()).then_some(DegenerateMotion::Plane(refined))
}

/// The rotation of a camera that turned alone, as far as pairs show of which a homography leaves the error `rms`, root mean square, normalized units; `None` where a turn explains them less well.
#[must_use]
pub fn turn_beside_plane(pairs: &[Conjugates], rms: f64) -> Option<UnitQuaternion<f64>> {
    turn_alone(pairs, AS_WELL_BY_TURN / BY_PLANE * rms * freedom(pairs.len(), 8.0, 2.0))
}

/// The rotation that explains `pairs` with at most this error.
fn turn_alone(pairs: &[Conjugates], most: f64) -> Option<UnitQuaternion<f64>> {
    let R_12 = turn_of(pairs)?;
    (turn_error(&R_12, pairs) <= most + EXACT).then(|| UnitQuaternion::from_matrix(&R_12))
}

/// By how much a model with so many `numbers`, of which a pair has `each` equations, takes more of the error of `pairs` than the three numbers of a rotation do.
fn freedom(pairs: usize, numbers: f64, each: f64) -> f64 {
    let n = pairs as f64;
    f64::sqrt((2.0 * n - 3.0) / (2.0 * n) / (1.0 - numbers / (each * n).max(numbers + 1.0)))
}

/// The rotation of camera 2 in camera 1 that brings the rays of the images together best.
fn turn_of(pairs: &[Conjugates]) -> Option<Matrix3<f64>> {
    let mut sum = Matrix3::zeros();
    for pair in pairs {
        let (s1, s2) = pair.homogeneous();
        sum += s1.normalize() * s2.normalize().transpose();
    }
    let svd = sum.svd(true, true);
    let (U, V_t) = (svd.u?, svd.v_t?);
    let mirrored = (U * V_t).determinant();
    Some(U * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirrored.signum())) * V_t)
}

/// Root mean square distance of the images from where a rotation has them, normalized units.
fn turn_error(R_12: &Matrix3<f64>, pairs: &[Conjugates]) -> f64 {
    let square = |pair: &Conjugates| {
        let (_, s2) = pair.homogeneous();
        let p = R_12 * s2;
        if p.z > 0.0 { (p.xy() / p.z - pair.s_1).norm_squared() } else { f64::INFINITY }
    };
    (pairs.iter().map(square).sum::<f64>() / pairs.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, noisy, scene};
    use super::super::{essential_8_point, relative_pose};
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Point3;

    const SD: f64 = 0.3 / 800.0;

    fn rms_of(pairs: &[Conjugates]) -> f64 {
        let found = essential_8_point(pairs).and_then(|E| relative_pose(&E, pairs));
        found.and_then(|(X_12, _)| refine_relative(&X_12, pairs, SD)).unwrap().rms
    }

    /// Images of 40 points of a tilted plane.
    fn plane(X_12: &Pose, random: &mut Random) -> Vec<Conjugates> {
        let one = || {
            let (x, y) = (random.between(-0.6, 0.6), random.between(-0.4, 0.4));
            let p = Point3::new(x, y, 2.0 + 0.4 * x - 0.3 * y);
            let q = X_12.inverse() * p;
            (Conjugates { s_1: p.xy().coords / p.z, s_2: q.xy().coords / q.z }, p)
        };
        let scene: Vec<_> = std::iter::repeat_with(one).take(40).collect();
        noisy(&scene, SD, random)
    }

    #[test]
    fn points_of_a_plane_have_two_displacements() {
        let mut random = Random::new(3);
        for seed in 0..20 {
            let way = [random.between(-1.0, 1.0), random.between(-1.0, 1.0), random.between(-1.0, 1.0)];
            let way = Vector3::from(way).normalize() * 0.5;
            let X_12 = Pose::new(way, camera_pose().rotation.scaled_axis());
            let pairs = plane(&X_12, &mut random);
            let Some(DegenerateMotion::Plane(found)) = degenerate_motion(&pairs, rms_of(&pairs), SD) else {
                panic!("{seed}: a plane");
            };
            let direction = X_12.translation.vector.normalize();
            let off = found.iter().map(|f| f.X_12.translation.vector.cross(&direction).norm());
            let nearest = off.fold(f64::INFINITY, f64::min);
            // The false reading is off by half a radian and more; the true one by what noise makes of a short way.
            assert!(nearest < 0.3, "{seed}: {nearest} of {}", found.len());
        }
    }

    #[test]
    fn a_camera_that_turned_alone_has_no_base_line() {
        let mut random = Random::new(5);
        for seed in 0..10 {
            let turn = camera_pose().rotation;
            let pairs =
                noisy(&scene(&Pose::from_parts(Translation3::identity(), turn), 40, seed), SD, &mut random);
            let rms = rms_of(&pairs);
            let Some(DegenerateMotion::Turn(found)) = degenerate_motion(&pairs, rms, SD) else {
                panic!("{seed}: a turn");
            };
            assert!(found.angle_to(&turn) < 1e-3, "{seed}");
        }
    }

    #[test]
    fn points_in_space_before_a_moved_camera_have_one_displacement() {
        let mut random = Random::new(7);
        for seed in 0..50 {
            let pairs = noisy(&scene(&camera_pose(), 20, seed), SD, &mut random);
            assert_eq!(degenerate_motion(&pairs, rms_of(&pairs), SD), None, "{seed}");
        }
    }
}
