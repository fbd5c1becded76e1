//! Displacement of a camera from an essential matrix, and its refinement. The base line has length one.

use super::StereoError;
use super::epipolar::{Conjugates, check};
use crate::geometry::{Pose, skew};
use crate::linalg::{Ldlt, damping, symmetric_eigen};
use nalgebra::{Matrix3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector3};

/// So that a start from which nothing converges ends.
const MAX_ITERATIONS: u32 = 60;

/// The four displacements that one essential matrix stands for, base lines of unit length; `None` unless it has two singular
/// values above zero.
#[must_use]
pub fn relative_poses(E: &Matrix3<f64>) -> Option<[Pose; 4]> {
    let E = E / E.norm();
    let (d, V) = symmetric_eigen(&E.tr_mul(&E))?;
    // Of unit norm: a second singular value of 1e-6, six orders above rounding and six below that of an essential matrix, 0.7.
    if !(d.y > 1e-12) {
        return None;
    }
    let (v1, v2) = (V.column(0).into_owned(), V.column(1).into_owned());
    let v3 = v1.cross(&v2);
    let u1 = (E * v1).normalize();
    let u2 = E * v2;
    let u2 = (u2 - u1 * u1.dot(&u2)).normalize();
    let u3 = u1.cross(&u2);
    // E = u1 v1^T + u2 v2^T up to a factor; with a quarter turn about u3, S(u3) R is that.
    let rotation = |sign: f64| {
        let R = (u2 * v1.transpose() - u1 * v2.transpose()) * sign + u3 * v3.transpose();
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(R))
    };
    let (a, b) = (rotation(1.0), rotation(-1.0));
    let pose = |o: Vector3<f64>, q| Pose::from_parts(Translation3::from(o), q);
    Some([pose(u3, a), pose(-u3, a), pose(u3, b), pose(-u3, b)])
}

/// Whether a point lies in front of both cameras, as far as its rays meet.
#[inline]
fn in_front(R: &Matrix3<f64>, o: &Vector3<f64>, pair: &Conjugates) -> bool {
    let (s1, s2) = pair.homogeneous();
    let ray = R * s2;
    let across = s1.cross(&ray);
    o.cross(&ray).dot(&across) > 0.0 && o.cross(&s1).dot(&across) > 0.0
}

/// The displacement of an essential matrix that has most of the points in front of both cameras, and how many.
///
/// # Errors
/// [`StereoError::Degenerate`] for a matrix that is no essential one, [`StereoError::BehindCamera`] when no displacement has
/// any point in front.
pub fn relative_pose(E: &Matrix3<f64>, pairs: &[Conjugates]) -> Result<(Pose, usize), StereoError> {
    let poses = relative_poses(E).ok_or(StereoError::Degenerate)?;
    let mut best = (poses[0], 0);
    for X_12 in poses {
        let (R, o) = (*X_12.rotation.to_rotation_matrix().matrix(), X_12.translation.vector);
        let count = pairs.iter().filter(|pair| in_front(&R, &o, pair)).count();
        if count > best.1 {
            best = (X_12, count);
        }
    }
    if best.1 == 0 { Err(StereoError::BehindCamera) } else { Ok(best) }
}

/// A displacement of least Sampson error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedRelativePose {
    /// Pose of camera 2 in camera 1, base line of unit length.
    pub X_12: Pose,
    /// Root mean square of the Sampson error, normalized units.
    pub rms: f64,
    /// Covariance of the rotation vector of camera 2 (rad, expressed in frame 1) and of the direction of the base line along
    /// [`Self::tangents`] (rad).
    pub covariance: SMatrix<f64, 5, 5>,
    /// Two unit vectors across the base line.
    pub tangents: [Vector3<f64>; 2],
    /// Steps taken.
    pub iterations: u32,
}

/// The displacement of least squared Sampson error near `X_12`, five pairs at least. The length of its base line is ignored.
///
/// `sd`: standard deviation of each image coordinate, normalized units; it scales the covariance only.
///
/// # Errors
/// [`StereoError::TooFewPoints`], [`StereoError::NotFinite`], [`StereoError::BadGuess`] for a start without base line or a
/// noise that cannot be, [`StereoError::Degenerate`], [`StereoError::NotConverged`].
pub fn refine_relative(
    X_12: &Pose,
    pairs: &[Conjugates],
    sd: f64,
) -> Result<RefinedRelativePose, StereoError> {
    check(pairs, 5)?;
    let o = X_12.translation.vector;
    let usable = o.norm() > 0.0
        && o.norm().is_finite()
        && X_12.rotation.coords.iter().all(|x| x.is_finite())
        && sd >= 0.0
        && sd.is_finite();
    if !usable {
        return Err(StereoError::BadGuess);
    }
    let mut state = EssentialState { R: *X_12.rotation.to_rotation_matrix().matrix(), o: o.normalize() };
    let mut here = state.sums(pairs);
    let mut damping = 0.0;
    for iterations in 1..=MAX_ITERATIONS {
        let diagonal = std::array::from_fn(|i| damping * here.normal[i][i]);
        let factors = Ldlt::new(&here.normal, &diagonal).ok_or(StereoError::Degenerate)?;
        let step = factors.solve(&here.right);
        let promised: f64 = step.iter().zip(&here.right).map(|(d, g)| d * g).sum();
        // A step that is damped much is short by force, so that it proves nothing.
        let last = damping < 1.0
            // Chosen by hand: 1e-9 rad, squared, or a promise by which the pose would move 1e-6 of its standard deviation.
            && (step.iter().map(|x| x * x).sum::<f64>() < 1e-18 || promised < 1e-12 * here.cost);
        let candidate = state.moved(&step);
        let next = candidate.sums(pairs);
        if next.cost <= here.cost {
            (state, here) = (candidate, next);
            damping = damping::eased(damping);
        } else if !last {
            damping = damping::raised(damping, damping::FIRST);
            continue;
        }
        if last || here.cost == 0.0 {
            let inverse = Ldlt::new(&here.normal, &[0.0; 5]).ok_or(StereoError::Degenerate)?.inverse();
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(state.R));
            let q = UnitQuaternion::new_normalize(q.into_inner());
            return Ok(RefinedRelativePose {
                X_12: Pose::from_parts(Translation3::from(state.o), q),
                rms: (here.cost / pairs.len() as f64).sqrt(),
                covariance: SMatrix::from(inverse) * (sd * sd),
                tangents: state.tangents(),
                iterations,
            });
        }
    }
    Err(StereoError::NotConverged { iterations: MAX_ITERATIONS })
}

#[derive(Clone, Copy)]
struct EssentialState {
    R: Matrix3<f64>,
    /// Unit vector.
    o: Vector3<f64>,
}

/// Normal equations.
struct EssentialEquations {
    normal: [[f64; 5]; 5],
    right: [f64; 5],
    cost: f64,
}

impl EssentialState {
    /// Two unit vectors across the base line.
    fn tangents(&self) -> [Vector3<f64>; 2] {
        let least = self.o.iamin();
        let mut axis = Vector3::zeros();
        axis[least] = 1.0;
        let a = self.o.cross(&axis).normalize();
        [a, self.o.cross(&a)]
    }

    fn moved(&self, step: &[f64; 5]) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        let [a, b] = self.tangents();
        let o = (self.o + a * step[3] + b * step[4]).normalize();
        Self { R: turn.to_rotation_matrix() * self.R, o }
    }

    /// The derivative of `c / sqrt(D)`, c the constraint's residual and D the sum of the squares of its gradient.
    fn sums(&self, pairs: &[Conjugates]) -> EssentialEquations {
        let S = skew(&self.o);
        let E = S * self.R;
        let [a, b] = self.tangents();
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let derivatives: [Matrix3<f64>; 5] = [
            S * skew(&axes[0]) * self.R,
            S * skew(&axes[1]) * self.R,
            S * skew(&axes[2]) * self.R,
            skew(&a) * self.R,
            skew(&b) * self.R,
        ];
        let mut sums = EssentialEquations { normal: [[0.0; 5]; 5], right: [0.0; 5], cost: 0.0 };
        for pair in pairs {
            let (s1, s2) = pair.homogeneous();
            let (l1, l2) = (E * s2, E.tr_mul(&s1));
            let D = l1.x * l1.x + l1.y * l1.y + l2.x * l2.x + l2.y * l2.y;
            let over = 1.0 / D.sqrt();
            let r = s1.dot(&l1) * over;
            if !r.is_finite() {
                continue; // both points on their epipoles: such a pair says nothing
            }
            let J: [f64; 5] = std::array::from_fn(|k| {
                let (d1, d2) = (derivatives[k] * s2, derivatives[k].tr_mul(&s1));
                let half = l1.x * d1.x + l1.y * d1.y + l2.x * d2.x + l2.y * d2.y;
                (s1.dot(&d1) - r * half * over) * over
            });
            sums.cost += r * r;
            for i in 0..5 {
                sums.right[i] -= J[i] * r;
                for j in 0..=i {
                    sums.normal[i][j] += J[i] * J[j];
                }
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, noisy, scene};
    use super::super::{essential_8_point, essential_matrix};
    use super::*;
    use crate::linalg::Random;

    fn gap(a: &Pose, b: &Pose) -> f64 {
        a.rotation.angle_to(&b.rotation)
            + a.translation.vector.normalize().cross(&b.translation.vector.normalize()).norm()
    }

    #[test]
    fn four_poses_of_one_matrix() {
        let X = camera_pose();
        let E = essential_matrix(&X);
        let poses = relative_poses(&E).unwrap();
        for P in &poses {
            let F = essential_matrix(P) * E.norm() / 2.0_f64.sqrt();
            assert!((F - E).norm().min((F + E).norm()) < 1e-12);
        }
        assert!(
            poses.iter().any(|P| gap(P, &X) < 1e-9 && P.translation.vector.dot(&X.translation.vector) > 0.0)
        );
        let pairs: Vec<_> = scene(&X, 10, 3).iter().map(|p| p.0).collect();
        let (P, count) = relative_pose(&-E, &pairs).unwrap();
        assert!(gap(&P, &X) < 1e-9 && P.translation.vector.dot(&X.translation.vector) > 0.0 && count == 10);
        assert!(relative_poses(&Matrix3::zeros()).is_none());
        assert_eq!(
            relative_pose(&Matrix3::from_element(1.0), &pairs).map(|_| ()),
            Err(StereoError::Degenerate)
        );
    }

    #[test]
    fn refinement_reaches_the_least_error_with_an_honest_covariance() {
        let X = camera_pose();
        let sd = 0.5 / 800.0;
        let mut random = Random::new(6);
        let (mut normalized, count) = (0.0, 400);
        for seed in 0..count {
            let pairs = noisy(&scene(&X, 30, seed), sd, &mut random);
            let start = relative_pose(&essential_8_point(&pairs).unwrap(), &pairs).unwrap().0;
            let end = refine_relative(&start, &pairs, sd).unwrap();
            let again = refine_relative(&X, &pairs, sd).unwrap();
            assert!(gap(&end.X_12, &again.X_12) < 1e-5 && end.rms <= again.rms * (1.0 + 1e-9));
            let w = (X.rotation * end.X_12.rotation.inverse()).scaled_axis();
            let d = X.translation.vector.normalize() - end.X_12.translation.vector;
            let [a, b] = end.tangents;
            let d = nalgebra::SVector::<f64, 5>::new(w.x, w.y, w.z, d.dot(&a), d.dot(&b));
            let solved = Ldlt::of(&end.covariance).unwrap().solve(&d.into());
            normalized += d.dot(&nalgebra::SVector::<f64, 5>::from(solved)) / count as f64;
        }
        assert!((normalized - 5.0).abs() < 0.6, "{normalized}");
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let X = camera_pose();
        let pairs = noisy(&scene(&X, 8, 1), 1e-3, &mut Random::new(1));
        let state = EssentialState {
            R: *X.rotation.to_rotation_matrix().matrix(),
            o: X.translation.vector.normalize(),
        };
        let right = state.sums(&pairs).right;
        for i in 0..5 {
            let mut step = [0.0; 5];
            step[i] = 1e-6;
            let slope = (state.moved(&step).sums(&pairs).cost
                - state.moved(&step.map(|x| -x)).sums(&pairs).cost)
                / 2e-6;
            assert!((slope + 2.0 * right[i]).abs() < 1e-6 * (1.0 + slope.abs()), "{i}: {slope} {}", right[i]);
        }
    }

    #[test]
    fn bad_input_is_refused() {
        let pairs: Vec<_> = scene(&camera_pose(), 6, 3).iter().map(|p| p.0).collect();
        let run = |X: &Pose, n: usize, sd| refine_relative(X, &pairs[..n], sd).map(|_| ());
        assert_eq!(run(&camera_pose(), 4, 0.0), Err(StereoError::TooFewPoints { needed: 5, given: 4 }));
        assert_eq!(run(&Pose::identity(), 6, 0.0), Err(StereoError::BadGuess));
        assert_eq!(run(&camera_pose(), 6, f64::NAN), Err(StereoError::BadGuess));
    }
}
