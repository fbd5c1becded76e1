//! Displacement of a camera from two images of an unknown plane, (10.58)-(10.61), at the least error in both images.
//!
//! The linear homography ([`crate::pose::homography`]) is refined on its first-order (Sampson) error: the distance of
//! `s_1 - H s_2` in units of its own covariance, which has noise of both images in it. Then it is decomposed
//! ([`crate::pose::decompose_homography_seen`]). Which of the two solutions is true the images alone do not tell: a third view,
//! the normal of the frame before, or one known roughly does.

use super::StereoError;
use super::epipolar::{Conjugates, check};
use crate::linalg::{Ldlt, damping};
use crate::pose::{
    Correspondence, HomographySolution, HomographySolutions, decompose_homography_seen, homography,
};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, SVector, Vector2};

/// So that a start from which nothing converges ends; what does takes a handful of steps from the linear solution.
const MAX_ITERATIONS: u32 = 30;

/// The homography of a plane between two views, and what it says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneMotion {
    /// H of (10.58), `p_1 = H p_2`, up to a factor.
    pub H: Matrix3<f64>,
    /// Its readings (10.59); lengths in units of the plane's distance from camera 2.
    pub solutions: HomographySolutions,
    /// Root mean square of the first-order error of a pair, normalized units.
    pub rms: f64,
}

/// Both displacements that four or more pairs on a plane allow.
///
/// # Errors
/// [`StereoError::TooFewPoints`], [`StereoError::NotFinite`], [`StereoError::Degenerate`] for collinear points,
/// [`StereoError::BehindCamera`] when no reading has all points in front of camera 2.
pub fn plane_motion(pairs: &[Conjugates]) -> Result<PlaneMotion, StereoError> {
    check(pairs, 4)?;
    // On the heap: as many as there are pairs.
    let points: Vec<_> = pairs.iter().map(|p| Correspondence { r: p.s_2, s: p.s_1 }).collect();
    let H = refined(homography(&points)?, pairs);
    let seen: Vec<Vector2<f64>> = pairs.iter().map(|p| p.s_2).collect();
    let solutions = decompose_homography_seen(&H, &seen)?;
    let rms = (PlaneEquations::of(&H, pairs).cost / pairs.len() as f64).sqrt();
    Ok(PlaneMotion { H, solutions, rms })
}

/// The readings of two homographies of the same plane, from view 2 to two others, whose normals in view 2 agree best.
///
/// The false readings of two different displacements have different normals; the true ones have one.
#[must_use]
pub fn plane_motion_consistent(
    first: &HomographySolutions,
    second: &HomographySolutions,
) -> (HomographySolution, HomographySolution) {
    let mut best = (first.first, second.first);
    for a in [Some(first.first), first.second].into_iter().flatten() {
        for b in [Some(second.first), second.second].into_iter().flatten() {
            if a.n_2.dot(&b.n_2) > best.0.n_2.dot(&best.1.n_2) {
                best = (a, b);
            }
        }
    }
    best
}

/// Gauss and Newton on the first-order error, the factor of H held by one more equation.
fn refined(start: Matrix3<f64>, pairs: &[Conjugates]) -> Matrix3<f64> {
    let mut H = start / start.norm();
    let mut here = PlaneEquations::of(&H, pairs);
    let mut damping = 0.0;
    for _ in 0..MAX_ITERATIONS {
        let h = SVector::<f64, 9>::from_column_slice(H.as_slice());
        let scale = here.normal.trace();
        let normal = here.normal + h * h.transpose() * scale;
        let diagonal = std::array::from_fn(|i| damping * normal[(i, i)]);
        let Some(factors) = Ldlt::new(&normal.data.0, &diagonal) else { break };
        let step = SVector::<f64, 9>::from(factors.solve(&here.right.into()));
        let next = H + Matrix3::from_column_slice(step.as_slice());
        let next = next / next.norm();
        let sums = PlaneEquations::of(&next, pairs);
        if sums.cost <= here.cost {
            (H, here) = (next, sums);
            damping = damping::eased(damping);
        } else {
            damping = damping::raised(damping, damping::FIRST);
        }
        // H has unit norm, so that a step of 1e-10 is 1e-7 px; and what no step bends downwards even with a damping of 1e6 is a minimum to rounding.
        if step.norm() < 1e-10 || damping > 1e6 {
            break;
        }
    }
    H
}

/// Normal equations of the first-order error, weights held.
struct PlaneEquations {
    normal: SMatrix<f64, 9, 9>,
    right: SVector<f64, 9>,
    cost: f64,
}

impl PlaneEquations {
    fn of(H: &Matrix3<f64>, pairs: &[Conjugates]) -> Self {
        let mut sums = Self { normal: SMatrix::zeros(), right: SVector::zeros(), cost: 0.0 };
        for pair in pairs {
            let s2 = pair.s_2.push(1.0);
            let q = H * s2;
            let over = 1.0 / q.z;
            let s: Vector2<f64> = q.xy() * over;
            // Derivative of the projection by q, and by s_2 through H.
            let by_q = Matrix2x3::new(over, 0.0, -s.x * over, 0.0, over, -s.y * over);
            let by_s: Matrix2<f64> = by_q * H.fixed_columns::<2>(0);
            let spread = Matrix2::identity() + by_s * by_s.transpose();
            let Some(information) = spread.try_inverse() else {
                sums.cost = f64::INFINITY;
                return sums;
            };
            let e = pair.s_1 - s;
            sums.cost += e.dot(&(information * e));
            // vec(H) column by column: d q = sum of s2[k] e_i.
            let mut J = SMatrix::<f64, 2, 9>::zeros();
            for k in 0..3 {
                J.fixed_columns_mut::<3>(3 * k).copy_from(&(by_q * s2[k]));
            }
            let weighted = J.transpose() * information;
            sums.normal += weighted * J;
            sums.right += weighted * e;
        }
        if sums.cost.is_nan() {
            sums.cost = f64::INFINITY;
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::linalg::Random;
    use nalgebra::{Point3, Vector3};

    /// A plane 1 m ahead of camera 2 with normal n, seen from both cameras.
    fn plane(X_12: &Pose, n: &Vector3<f64>, count: usize, sd: f64, random: &mut Random) -> Vec<Conjugates> {
        let mut all = Vec::new();
        while all.len() < count {
            let s_2 = Vector2::new(random.between(-0.35, 0.35), random.between(-0.25, 0.25));
            let z = 1.0 / n.dot(&s_2.push(1.0));
            let p1 = X_12 * Point3::from(s_2.push(1.0) * z);
            let s_1 = p1.xy().coords / p1.z;
            if p1.z > 0.1 && z > 0.0 && s_1.x.abs() < 0.6 && s_1.y.abs() < 0.5 {
                let mut noise = || Vector2::new(random.gaussian(), random.gaussian()) * sd;
                let (a, b) = (noise(), noise());
                all.push(Conjugates { s_1: s_1 + a, s_2: s_2 + b });
            }
        }
        all
    }

    fn errors_deg(s: &HomographySolution, X: &Pose, n: &Vector3<f64>) -> [f64; 3] {
        let between = |a: &Vector3<f64>, b: &Vector3<f64>| a.angle(b).to_degrees();
        [
            s.R_12.angle_to(&X.rotation.to_rotation_matrix()).to_degrees(),
            between(&s.p_12_1_over_d2, &X.translation.vector),
            between(&s.n_2, n),
        ]
    }

    #[test]
    fn exact_images_give_the_truth_and_the_third_view_tells() {
        let mut random = Random::new(1);
        let n = Vector3::new(0.3, -0.2, 1.0).normalize();
        let (X, Y) = (
            Pose::new([0.3, 0.1, 0.05].into(), [0.1, -0.2, 0.3].into()),
            Pose::new([-0.2, 0.2, -0.1].into(), [-0.1, 0.2, 0.1].into()),
        );
        let (a, b) = (
            plane_motion(&plane(&X, &n, 12, 0.0, &mut random)).unwrap(),
            plane_motion(&plane(&Y, &n, 12, 0.0, &mut random)).unwrap(),
        );
        let (a, b) = (a, plane_motion_consistent(&a.solutions, &b.solutions));
        assert!(errors_deg(&b.0, &X, &n).iter().all(|e| *e < 1e-5), "{:?}", errors_deg(&b.0, &X, &n));
        assert!(errors_deg(&b.1, &Y, &n).iter().all(|e| *e < 1e-5));
        assert!((b.0.p_12_1_over_d2 - X.translation.vector).norm() < 1e-9 && a.rms < 1e-12);
        assert_eq!(a.solutions.nearest_direction(&X.translation.vector), b.0);
        assert_eq!(a.solutions.nearest_normal(&n), b.0);
    }

    #[test]
    fn errors_at_half_a_pixel_are_those_of_the_goal() {
        // 64 points, 0.5 px at f = 800 in both images.
        let mut random = Random::new(7);
        let mut all: [Vec<f64>; 3] = Default::default();
        for _ in 0..1000 {
            let mut vector = |size: f64| Vector3::from([(); 3].map(|()| random.between(-size, size)));
            let n = (Vector3::z() + vector(0.5)).normalize();
            let X = Pose::new(vector(1.0).normalize() * 0.3, vector(0.2));
            let pairs = plane(&X, &n, 64, 0.5 / 800.0, &mut random);
            let s = plane_motion(&pairs).unwrap().solutions.nearest_normal(&n);
            for (values, error) in all.iter_mut().zip(errors_deg(&s, &X, &n)) {
                values.push(error);
            }
        }
        let medians = all.each_mut().map(|values| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        });
        assert!(medians[0] < 0.50 && medians[1] < 2.4 && medians[2] < 1.9, "{medians:?}");
    }

    #[test]
    fn refinement_beats_the_linear_solution() {
        let mut random = Random::new(3);
        let n = Vector3::new(0.1, -0.2, 1.0).normalize();
        let X = Pose::new([0.3, 0.1, 0.05].into(), [0.1, -0.2, 0.3].into());
        for _ in 0..50 {
            let pairs = plane(&X, &n, 20, 1e-3, &mut random);
            let points: Vec<_> = pairs.iter().map(|p| Correspondence { r: p.s_2, s: p.s_1 }).collect();
            let linear = homography(&points).unwrap();
            let end = plane_motion(&pairs).unwrap();
            let least = PlaneEquations::of(&end.H, &pairs).cost;
            assert!(least <= PlaneEquations::of(&(linear / linear.norm()), &pairs).cost);
        }
    }

    #[test]
    fn bad_input_is_refused() {
        let pair = Conjugates { s_1: Vector2::new(0.1, 0.2), s_2: Vector2::new(0.0, 0.1) };
        assert_eq!(plane_motion(&[pair; 3]).err(), Some(StereoError::TooFewPoints { needed: 4, given: 3 }));
        assert_eq!(plane_motion(&[pair; 6]).err(), Some(StereoError::Degenerate));
        let nan = Conjugates { s_1: Vector2::new(f64::NAN, 0.0), ..pair };
        assert_eq!(plane_motion(&[pair, pair, pair, nan]).err(), Some(StereoError::NotFinite { index: 3 }));
    }
}
