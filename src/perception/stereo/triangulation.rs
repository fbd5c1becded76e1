//! Position of a point from two views, (10.47)-(10.53): linear, parallel, and optimal.
//!
//! The optimal position is that of least reprojection error in both images (normalized units, the same noise in both): the
//! smallest correction of the two points that makes their rays meet, found in two steps that converge to the last digit in
//! practice (Lindstrom, CVPR 2010).

use super::StereoError;
use super::epipolar::{Conjugates, essential_matrix};
use crate::geometry::Pose;
use crate::linalg::Ldlt;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point3, Vector2, Vector3};

/// Sine of the angle between two rays, squared, below which they count as parallel: 1e-8 rad, a point 1e8 base lines away. Derived: the determinant
/// of the two equations is that square, and it rounds to 1e-16.
const PARALLEL: f64 = 1e-16;

/// The least-squares solution of the four linear equations (10.49), (10.50), in frame 1.
///
/// Not optimal: the equations weigh errors by depth. Exact without noise.
///
/// # Errors
/// [`StereoError::NotFinite`] (index 0), [`StereoError::Degenerate`] for parallel rays, [`StereoError::BehindCamera`].
pub fn triangulate_linear(X_12: &Pose, pair: &Conjugates) -> Result<Point3<f64>, StereoError> {
    let R = X_12.rotation.to_rotation_matrix();
    let R = R.matrix();
    let o = R.tr_mul(&X_12.translation.vector);
    let (X1, Y1, X2, Y2) = (pair.s_1.x, pair.s_1.y, pair.s_2.x, pair.s_2.y);
    // r_i of the text are the columns of R.
    let [r1, r2, r3] = [0, 1, 2].map(|i| R.column(i).into_owned());
    let rows = [
        (Vector3::new(1.0, 0.0, -X1), 0.0),
        (Vector3::new(0.0, 1.0, -Y1), 0.0),
        (r1 - r3 * X2, o.x - o.z * X2),
        (r2 - r3 * Y2, o.y - o.z * Y2),
    ];
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for (row, value) in rows {
        normal += row * row.transpose();
        right += row * value;
    }
    if !(normal.iter().chain(right.iter()).all(|x| x.is_finite())) {
        return Err(StereoError::NotFinite { index: 0 });
    }
    let p = Ldlt::of(&normal).ok_or(StereoError::Degenerate)?.solve(&right.into());
    let p = Point3::from(p);
    let in_front = p.z > 0.0 && (X_12.inverse() * p).z > 0.0;
    if in_front { Ok(p) } else { Err(StereoError::BehindCamera) }
}

/// The position (10.51)-(10.53) for parallel and aligned image planes, `R = I`, camera 2 at `[b 0 0]`.
///
/// Where the rows differ, their mean counts. `b_m` may be negative (camera 2 on the other side).
///
/// # Errors
/// [`StereoError::Degenerate`] for no disparity (or NaN), [`StereoError::BehindCamera`] for a negative depth.
pub fn triangulate_parallel(b_m: f64, pair: &Conjugates) -> Result<Point3<f64>, StereoError> {
    let z = b_m / (pair.s_1.x - pair.s_2.x);
    if !z.is_finite() {
        return Err(StereoError::Degenerate);
    }
    if z <= 0.0 {
        return Err(StereoError::BehindCamera);
    }
    Ok(Point3::new(pair.s_1.x * z, 0.5 * (pair.s_1.y + pair.s_2.y) * z, z))
}

/// A triangulated point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangulatedPoint {
    /// Position in frame 1, m.
    pub p_1: Point3<f64>,
    /// Squared size of the correction in both images together, normalized units: chi-square with one degree of freedom over
    /// the variance of a coordinate.
    pub error2: f64,
    /// Covariance of the position for image noise of variance one, normalized units; times the variance it is that of the
    /// position, m^2.
    pub covariance: Matrix3<f64>,
}

/// Two cameras with everything that all points share.
#[derive(Debug, Clone, Copy)]
pub struct Triangulator {
    E: Matrix3<f64>,
    R: Matrix3<f64>,
    o: Vector3<f64>,
}

impl Triangulator {
    /// For camera 2 at `X_12` in camera 1.
    ///
    /// # Errors
    /// [`StereoError::BadGuess`] for a pose that is not finite, [`StereoError::Degenerate`] without a base line.
    pub fn new(X_12: &Pose) -> Result<Self, StereoError> {
        let o = X_12.translation.vector;
        let E = essential_matrix(X_12);
        if !E.iter().all(|x| x.is_finite()) {
            return Err(StereoError::BadGuess);
        }
        if o.norm_squared() == 0.0 {
            return Err(StereoError::Degenerate);
        }
        Ok(Self { E, R: *X_12.rotation.to_rotation_matrix().matrix(), o })
    }

    /// The optimal position of a point.
    ///
    /// # Errors
    /// [`StereoError::NotFinite`] (index 0), [`StereoError::Degenerate`] for rays that are parallel (a point at infinity) or
    /// meet in a camera, [`StereoError::BehindCamera`].
    #[inline]
    pub fn point(&self, pair: &Conjugates) -> Result<TriangulatedPoint, StereoError> {
        let corrected = self.corrected(pair);
        let (s1, s2) = corrected.homogeneous();
        let ray = self.R * s2;
        let across = s1.cross(&ray);
        let size = across.norm_squared();
        if !(size > PARALLEL * s1.norm_squared() * ray.norm_squared()) {
            let finite = pair.s_1.iter().chain(pair.s_2.iter()).all(|x| x.is_finite());
            return Err(if finite { StereoError::Degenerate } else { StereoError::NotFinite { index: 0 } });
        }
        // l_1 s~_1 = o + l_2 R s~_2, (10.45), times R s~_2 and times s~_1.
        let over = 1.0 / size;
        let (l1, l2) = (self.o.cross(&ray).dot(&across) * over, self.o.cross(&s1).dot(&across) * over);
        if !(l1 > 0.0 && l2 > 0.0) {
            return Err(StereoError::BehindCamera);
        }
        let error2 = (pair.s_1 - corrected.s_1).norm_squared() + (pair.s_2 - corrected.s_2).norm_squared();
        let covariance = self.covariance(&corrected, l1, l2).ok_or(StereoError::Degenerate)?;
        Ok(TriangulatedPoint { p_1: Point3::from(s1 * l1), error2, covariance })
    }

    /// Covariance of the position of `point`, m^2, where the noise of its images in camera 1 and 2 has these covariances, normalized units: lenses and focal lengths make them unequal.
    #[must_use]
    pub fn covariance_with(&self, point: &TriangulatedPoint, noise: [&Matrix2<f64>; 2]) -> Matrix3<f64> {
        let p_2 = self.R.tr_mul(&(point.p_1.coords - self.o));
        let projection = |p: &Vector3<f64>| Matrix2x3::new(1.0, 0.0, -p.x / p.z, 0.0, 1.0, -p.y / p.z) / p.z;
        let (J_1, J_2) = (projection(&point.p_1.coords), projection(&p_2) * self.R.transpose());
        // The position is C (J_1^T ds_1 + J_2^T ds_2) off, C that of noise of variance one.
        let [noise_1, noise_2] = noise;
        let pull = J_1.tr_mul(&(noise_1 * J_1)) + J_2.tr_mul(&(noise_2 * J_2));
        point.covariance * pull * point.covariance
    }

    /// The nearest pair that meets (10.46).
    #[inline]
    fn corrected(&self, pair: &Conjugates) -> Conjugates {
        let (E, x, y) = (&self.E, &pair.s_1, &pair.s_2);
        let a = Vector2::new(E.m11 * y.x + E.m12 * y.y + E.m13, E.m21 * y.x + E.m22 * y.y + E.m23);
        let b = Vector2::new(E.m11 * x.x + E.m21 * x.y + E.m31, E.m12 * x.x + E.m22 * x.y + E.m32);
        let c = x.x * a.x + x.y * a.y + E.m31 * y.x + E.m32 * y.y + E.m33;
        // The upper left block of E between the two normals.
        let across = Vector2::new(E.m11 * b.x + E.m12 * b.y, E.m21 * b.x + E.m22 * b.y);
        let mixed = a.dot(&across);
        let half = 0.5 * (a.norm_squared() + b.norm_squared());
        let root = (half * half - mixed * c).max(0.0).sqrt();
        if !(half + root > 0.0) {
            return *pair;
        }
        let step = c / (half + root);
        let back = Vector2::new(E.m11 * a.x + E.m21 * a.y, E.m12 * a.x + E.m22 * a.y);
        let (a, b) = (a - across * step, b - back * step);
        let step = step * 2.0 * root / (a.norm_squared() + b.norm_squared());
        if !step.is_finite() {
            return *pair;
        }
        Conjugates { s_1: x - a * step, s_2: y - b * step }
    }

    /// Inverse of the sum of `J^T J` over both images, J the derivative of the projections.
    #[inline]
    fn covariance(&self, pair: &Conjugates, z1: f64, z2: f64) -> Option<Matrix3<f64>> {
        // Rows (1 0 -X) / z and (0 1 -Y) / z; those of camera 2 turned to frame 1.
        let block = |s: &Vector2<f64>, z: f64| {
            let w = 1.0 / (z * z);
            [w, -s.x * w, -s.y * w, (s.x * s.x + s.y * s.y) * w]
        };
        let ([a, ax, ay, aw], [b, bx, by, bw]) = (block(&pair.s_1, z1), block(&pair.s_2, z2));
        let inner = Matrix3::new(b, 0.0, bx, 0.0, b, by, bx, by, bw);
        let mut normal = self.R * inner * self.R.transpose();
        normal.m11 += a;
        normal.m22 += a;
        normal.m13 += ax;
        normal.m31 += ax;
        normal.m23 += ay;
        normal.m32 += ay;
        normal.m33 += aw;
        Some(Matrix3::from(Ldlt::of(&normal)?.inverse()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, noisy, scene};
    use super::*;
    use crate::linalg::Random;
    use proptest::prelude::*;

    fn reprojection2(X_12: &Pose, p: &Point3<f64>, pair: &Conjugates) -> f64 {
        let q = X_12.inverse() * p;
        (p.xy().coords / p.z - pair.s_1).norm_squared() + (q.xy().coords / q.z - pair.s_2).norm_squared()
    }

    /// Positions of noisy images whose noise is unequal in both cameras and directions: squared errors by the stated covariance are chi-square with three degrees of freedom.
    #[test]
    fn unequal_noise_is_in_the_covariance() {
        let X = camera_pose();
        let both = Triangulator::new(&X).unwrap();
        let mut random = Random::new(31);
        let roots = [Matrix2::new(2e-4, 0.0, 1e-4, 1e-4), Matrix2::new(1.5e-3, 2e-4, 0.0, 8e-4)];
        let noise = roots.map(|root| root * root.transpose());
        let (mut chi_square, mut alike) = (0.0, 0.0);
        let all = scene(&X, 2000, 5);
        for (pair, p) in &all {
            let mut off = |root: &Matrix2<f64>| root * Vector2::new(random.gaussian(), random.gaussian());
            let seen = Conjugates { s_1: pair.s_1 + off(&roots[0]), s_2: pair.s_2 + off(&roots[1]) };
            let found = both.point(&seen).unwrap();
            let d = found.p_1 - p;
            let C = both.covariance_with(&found, [&noise[0], &noise[1]]);
            chi_square += d.dot(&(C.try_inverse().unwrap() * d)) / all.len() as f64;
            let one = Matrix2::identity();
            let equal = both.covariance_with(&found, [&one, &one]);
            alike = f64::max(alike, (equal - found.covariance).norm() / found.covariance.norm());
        }
        assert!((chi_square - 3.0).abs() < 0.3, "{chi_square}");
        assert!(alike < 0.05, "{alike}: of noise of variance one it is that of the point");
    }

    #[test]
    fn exact_points_come_back() {
        let X = camera_pose();
        let both = Triangulator::new(&X).unwrap();
        for (pair, p) in scene(&X, 50, 7) {
            assert!((triangulate_linear(&X, &pair).unwrap() - p).norm() < 1e-12);
            let found = both.point(&pair).unwrap();
            assert!((found.p_1 - p).norm() < 1e-12 && found.error2 < 1e-28);
        }
    }

    proptest! {
        #[test]
        fn no_other_position_has_a_smaller_error(seed in 0..10_000_u64, noise_px in 0.0..5.0f64) {
            let X = camera_pose();
            let all = scene(&X, 1, seed);
            let pair = noisy(&all, noise_px / 800.0, &mut Random::new(seed))[0];
            let found = Triangulator::new(&X).unwrap().point(&pair).unwrap();
            let least = reprojection2(&X, &found.p_1, &pair);
            prop_assert!((least - found.error2).abs() < 1e-12 + 1e-6 * least, "{least:e} {:e}", found.error2);
            // Newton's method by differences, from the position found, gains nothing.
            for k in 0..3 {
                for h in [1e-4, -1e-4] {
                    let mut p = found.p_1;
                    p[k] += h;
                    prop_assert!(reprojection2(&X, &p, &pair) >= least * (1.0 - 1e-9));
                }
            }
        }

        #[test]
        fn parallel_cameras_agree_with_the_general_ones(
            x in -0.3..0.3f64, y in -0.3..0.3f64, z in 0.5..3.0f64, b in 0.05..0.4f64
        ) {
            let X = Pose::translation(b, 0.0, 0.0);
            let pair = Conjugates { s_1: Vector2::new(x, y), s_2: Vector2::new(x - b / z, y) };
            let p = triangulate_parallel(b, &pair).unwrap();
            prop_assert!((p - Point3::new(x * z, y * z, z)).norm() < 1e-12);
            prop_assert!((triangulate_linear(&X, &pair).unwrap() - p).norm() < 1e-9);
            prop_assert!((Triangulator::new(&X).unwrap().point(&pair).unwrap().p_1 - p).norm() < 1e-9);
        }
    }

    #[test]
    fn covariances_are_honest_and_errors_those_of_the_optimum() {
        let X = camera_pose();
        let both = Triangulator::new(&X).unwrap();
        let sd = 0.5 / 800.0;
        let mut random = Random::new(3);
        let (mut normalized, mut error, mut count) = (0.0, 0.0, 0.0);
        for seed in 0..1000 {
            let all = scene(&X, 1, seed);
            let pair = noisy(&all, sd, &mut random)[0];
            let found = both.point(&pair).unwrap();
            let d = found.p_1 - all[0].1;
            let solved = Ldlt::of(&found.covariance).unwrap().solve(&d.into());
            normalized += d.dot(&Vector3::from(solved)) / (sd * sd);
            error += found.error2 / (sd * sd);
            count += 1.0;
        }
        // Chi-square with three degrees of freedom, and with one.
        assert!((normalized / count - 3.0).abs() < 0.25, "{}", normalized / count);
        assert!((error / count - 1.0).abs() < 0.15, "{}", error / count);
    }

    #[test]
    fn bad_input_is_refused() {
        let X = camera_pose();
        let both = Triangulator::new(&X).unwrap();
        assert_eq!(Triangulator::new(&Pose::identity()).err(), Some(StereoError::Degenerate));
        assert_eq!(
            Triangulator::new(&Pose::translation(f64::NAN, 0.0, 0.0)).err(),
            Some(StereoError::BadGuess)
        );
        let nan = Conjugates { s_1: Vector2::new(f64::NAN, 0.0), s_2: Vector2::zeros() };
        assert_eq!(both.point(&nan).err(), Some(StereoError::NotFinite { index: 0 }));
        assert_eq!(triangulate_linear(&X, &nan), Err(StereoError::NotFinite { index: 0 }));
        let side = Triangulator::new(&Pose::translation(0.1, 0.0, 0.0)).unwrap();
        let far = Conjugates { s_1: Vector2::new(0.1, 0.0), s_2: Vector2::new(0.1, 0.0) };
        assert_eq!(side.point(&far).err(), Some(StereoError::Degenerate));
        let behind = Conjugates { s_1: Vector2::new(0.1, 0.0), s_2: Vector2::new(0.2, 0.0) };
        assert_eq!(side.point(&behind).err(), Some(StereoError::BehindCamera));
        assert_eq!(triangulate_parallel(0.1, &behind), Err(StereoError::BehindCamera));
        assert_eq!(triangulate_parallel(0.1, &far), Err(StereoError::Degenerate));
        assert_eq!(
            triangulate_linear(&Pose::translation(0.1, 0.0, 0.0), &behind),
            Err(StereoError::BehindCamera)
        );
    }
}
