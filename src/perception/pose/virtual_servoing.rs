//! Pose by virtual visual servoing, Sect. 10.3.3, from points, line segments, or both: (10.40)-(10.42).
//!
//! A virtual camera moves from a first guess so that its features approach the measured ones. `x = [p_CO_C; phi]` as in
//! [`super::algorithmic`], with m = 6, or m = 4 where object and image plane are parallel, (10.33).

use super::PoseError;
use super::algorithmic::{AlgorithmicStep, euler_zyx_rotation, pose_rate};
use crate::features::{
    Feature, NormalEquations, PointFeature, SegmentFeature, image_jacobian, planar_columns,
};
use crate::geometry::rotation_z;
use nalgebra::{Point3, Rotation3, SMatrix, SVector, Vector2, Vector3, Vector4, Vector6};

/// A measured feature of a known object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ObjectFeature {
    /// A point.
    Point {
        /// Its position in the object frame, m.
        r_O: Point3<f64>,
        /// Its measured image, normalized.
        s: Vector2<f64>,
    },
    /// A line segment with distinguishable ends.
    Segment {
        /// Its ends in the object frame, m.
        ends_O: [Point3<f64>; 2],
        /// Measured `[x y L alpha]` of (10.28), normalized and rad.
        s: Vector4<f64>,
    },
}

/// When the motion of the virtual camera ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VirtualServoing {
    /// K_s = gain I, 1/s.
    pub gain_1_s: f64,
    /// Euler step, s; a product with the gain below 1 keeps the way short and nearly straight, 1 is Gauss and Newton's.
    pub dt_s: f64,
    /// The norm of e_s, (10.36), that counts as converged.
    pub tolerance: f64,
    /// It also ends where a step lowers the norm by less than this share: at the least error that noise leaves.
    pub stall: f64,
    /// Most steps.
    pub max_steps: u32,
}

impl Default for VirtualServoing {
    /// The textbook's gain and step (Example 10.4).
    fn default() -> Self {
        Self { gain_1_s: 160.0, dt_s: 1e-3, tolerance: 1e-12, stall: 1e-9, max_steps: 1000 }
    }
}

/// Final pose of the virtual camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VirtualPose<const M: usize> {
    /// The estimate of x.
    pub x: SVector<f64, M>,
    /// Norm of e_s there, normalized units.
    pub error: f64,
    /// Euler steps taken.
    pub steps: u32,
}

/// One Euler step of (10.41), (10.42) for m = 6, from features in any mixture.
///
/// # Errors
/// [`PoseError::TooFewPoints`] for fewer than six numbers (three points), [`PoseError::NotFinite`] (index of the feature),
/// [`PoseError::BehindCamera`] for the estimate, [`PoseError::Degenerate`] where the features do not fix the pose, a segment
/// has no length, or the middle Euler angle is at +-pi/2.
pub fn virtual_step(
    x: &Vector6<f64>,
    features: &[ObjectFeature],
    gain_1_s: f64,
    dt_s: f64,
) -> Result<AlgorithmicStep<6>, PoseError> {
    let phi = Vector3::new(x[3], x[4], x[5]);
    let (V, error) = relative_twist(&euler_zyx_rotation(&phi), x, features, gain_1_s, |J| *J, |J| *J)?;
    Ok(AlgorithmicStep { x: x + pose_rate(&phi, &V)? * dt_s, error })
}

/// One Euler step for m = 4, (10.33), from features in any mixture: four numbers, two points or one segment, at least.
///
/// # Errors
/// As [`virtual_step`].
pub fn virtual_step_4(
    x: &Vector4<f64>,
    features: &[ObjectFeature],
    gain_1_s: f64,
    dt_s: f64,
) -> Result<AlgorithmicStep<4>, PoseError> {
    let R = rotation_z(x[3]);
    let (rate, error) = relative_twist(&R, x, features, gain_1_s, planar_columns, planar_columns)?;
    Ok(AlgorithmicStep { x: x + rate * dt_s, error })
}

/// Steps of (10.41), (10.42) from `x` until the features agree or the error stalls, m = 6.
///
/// # Errors
/// As [`virtual_step`], and [`PoseError::NotConverged`].
pub fn virtual_servoing(
    x: &Vector6<f64>,
    features: &[ObjectFeature],
    settings: &VirtualServoing,
) -> Result<VirtualPose<6>, PoseError> {
    settle(x, settings, |x| virtual_step(x, features, settings.gain_1_s, settings.dt_s))
}

/// As [`virtual_servoing`] for m = 4.
///
/// # Errors
/// As [`virtual_servoing`].
pub fn virtual_servoing_4(
    x: &Vector4<f64>,
    features: &[ObjectFeature],
    settings: &VirtualServoing,
) -> Result<VirtualPose<4>, PoseError> {
    settle(x, settings, |x| virtual_step_4(x, features, settings.gain_1_s, settings.dt_s))
}

fn settle<const M: usize>(
    x: &SVector<f64, M>,
    settings: &VirtualServoing,
    step: impl Fn(&SVector<f64, M>) -> Result<AlgorithmicStep<M>, PoseError>,
) -> Result<VirtualPose<M>, PoseError> {
    let (mut x, mut before) = (*x, f64::INFINITY);
    for steps in 0..=settings.max_steps {
        let next = step(&x)?;
        // A first step may be too long and raise the error once: only a small change is an end.
        let stalled = (before - next.error).abs() <= settings.stall * next.error;
        if next.error <= settings.tolerance || stalled {
            return Ok(VirtualPose { x, error: next.error, steps });
        }
        (x, before) = (next.x, next.error);
    }
    Err(PoseError::NotConverged { iterations: settings.max_steps })
}

/// The least-squares twist of O relative to C for the desired rates K_s e_s.
fn relative_twist<const M: usize>(
    R_CO: &Rotation3<f64>,
    x: &SVector<f64, M>,
    features: &[ObjectFeature],
    gain_1_s: f64,
    two: impl Fn(&SMatrix<f64, 2, 6>) -> SMatrix<f64, 2, M>,
    four: impl Fn(&SMatrix<f64, 4, 6>) -> SMatrix<f64, 4, M>,
) -> Result<(SVector<f64, M>, f64), PoseError> {
    let p = Vector3::new(x[0], x[1], x[2]);
    let mut equations = NormalEquations::<M>::new();
    let mut error2 = 0.0;
    let place = |r_O: &Point3<f64>| {
        let r = R_CO * r_O.coords + p;
        if r.z > 0.0 { Ok((r.xy() / r.z, r.z)) } else { Err(PoseError::BehindCamera) }
    };
    for (index, feature) in features.iter().enumerate() {
        if !feature.is_finite() {
            return Err(PoseError::NotFinite { index });
        }
        match feature {
            ObjectFeature::Point { r_O, s } => {
                let (seen, z_m) = place(r_O)?;
                let point = PointFeature { s: seen, z_m };
                let L = point.interaction().ok_or(PoseError::BehindCamera)?;
                let e = point.error(s);
                error2 += e.norm_squared();
                equations.add_rows(&two(&image_jacobian(&L, &p)), &(e * gain_1_s), 1.0);
            }
            ObjectFeature::Segment { ends_O, s } => {
                let ([(a, za), (b, zb)], s) = ([place(&ends_O[0])?, place(&ends_O[1])?], s);
                let segment = SegmentFeature { s: [a, b], z_m: [za, zb] };
                let L = segment.interaction().ok_or(PoseError::Degenerate)?;
                let e = segment.error(s);
                error2 += e.norm_squared();
                equations.add_rows(&four(&image_jacobian(&L, &p)), &(e * gain_1_s), 1.0);
            }
        }
    }
    if equations.rows() < M {
        return Err(PoseError::TooFewPoints { needed: M / 2, given: equations.rows() / 2 });
    }
    let solution = equations.solve(0.0).ok_or(PoseError::Degenerate)?;
    Ok((solution.twist, error2.sqrt()))
}

impl ObjectFeature {
    fn is_finite(&self) -> bool {
        match self {
            Self::Point { r_O, s } => r_O.iter().chain(s.iter()).all(|x| x.is_finite()),
            Self::Segment { ends_O: [a, b], s } => {
                a.iter().chain(b.iter()).chain(s.iter()).all(|x| x.is_finite())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::algorithmic::{algorithmic_step, algorithmic_step_4, algorithmic_step_segment};
    use super::super::testing::{SQUARE, gap, gauss, see_3d};
    use super::*;
    use crate::features::segment_features;
    use crate::geometry::Pose;
    use nalgebra::{Translation3, UnitQuaternion};
    use std::f64::consts::FRAC_PI_4;

    fn pose(x: &Vector6<f64>) -> Pose {
        let R = euler_zyx_rotation(&Vector3::new(x[3], x[4], x[5]));
        Pose::from_parts(Translation3::new(x[0], x[1], x[2]), UnitQuaternion::from_rotation_matrix(&R))
    }

    /// Corners 0 and 1 as points, the sides 1-2 and 2-3 as segments: twelve numbers.
    fn mixed(X: &Pose, noise: impl FnMut() -> f64) -> Vec<ObjectFeature> {
        let object: Vec<_> = SQUARE.iter().map(|r| [r[0], r[1], 0.0]).collect();
        let seen = see_3d(X, &object, noise);
        let point = |i: usize| ObjectFeature::Point { r_O: seen[i].r, s: seen[i].s };
        let segment = |i: usize, j: usize| ObjectFeature::Segment {
            ends_O: [seen[i].r, seen[j].r],
            s: segment_features(&[seen[i].s, seen[j].s]),
        };
        vec![point(0), point(1), segment(1, 2), segment(2, 3)]
    }

    #[test]
    fn example_10_4_from_points_segments_and_both() {
        let truth = Vector6::new(0.0, 0.0, 0.5, 0.0, FRAC_PI_4, 0.0);
        let start = Vector6::new(0.0, 0.0, 0.58, 0.0, 0.7, 0.0);
        let all = mixed(&pose(&truth), || 0.0);
        for features in [&all[..], &all[1..]] {
            let end = virtual_servoing(&start, features, &VirtualServoing::default()).unwrap();
            assert!((end.x - truth).norm() < 1e-9, "{end:?}");
        }
        // Three points: as many numbers as unknowns.
        let object = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0]];
        let near = truth + Vector6::repeat(0.003);
        let seen = see_3d(&pose(&truth), &object, || 0.0);
        let points: Vec<_> = seen.iter().map(|p| ObjectFeature::Point { r_O: p.r, s: p.s }).collect();
        let end = virtual_servoing(&near, &points, &VirtualServoing::default()).unwrap();
        assert!((end.x - truth).norm() < 1e-9 && end.steps > 50, "{end:?}");
        let longer = VirtualServoing { dt_s: 0.3, gain_1_s: 1.0, ..VirtualServoing::default() };
        assert!(virtual_servoing(&near, &points, &longer).unwrap().steps < end.steps);
        assert_eq!(
            virtual_servoing(&near, &points, &VirtualServoing { max_steps: 3, ..longer }).map(|_| ()),
            Err(PoseError::NotConverged { iterations: 3 })
        );
    }

    #[test]
    fn steps_are_those_of_the_plain_kinds() {
        let truth = Vector6::new(0.02, -0.01, 0.5, 0.3, 0.4, -0.2);
        let x = truth + Vector6::repeat(0.03);
        let object: Vec<_> = SQUARE.iter().map(|r| [r[0], r[1], 0.0]).collect();
        let seen = see_3d(&pose(&truth), &object, || 0.0);
        let points: Vec<_> = seen.iter().map(|p| ObjectFeature::Point { r_O: p.r, s: p.s }).collect();
        let (a, b) = (
            virtual_step(&x, &points, 160.0, 1e-3).unwrap(),
            algorithmic_step(&x, &seen, 160.0, 1e-3).unwrap(),
        );
        assert!((a.x - b.x).norm() < 1e-10 && (a.error - b.error).abs() < 1e-12);
        let x4 = Vector4::new(0.01, 0.02, 0.5, 0.4);
        let a = virtual_step_4(&x4, &points[..2], 160.0, 1e-3).unwrap();
        let b = algorithmic_step_4(&x4, &seen[..2], 160.0, 1e-3).unwrap();
        assert!((a.x - b.x).norm() < 1e-10);
        let ends_O = [seen[0].r, seen[1].r];
        let s = segment_features(&[seen[0].s, seen[1].s]);
        let a = virtual_step_4(&x4, &[ObjectFeature::Segment { ends_O, s }], 160.0, 1e-3).unwrap();
        let b = algorithmic_step_segment(&x4, &ends_O, &s, 160.0, 1e-3).unwrap();
        assert!((a.x - b.x).norm() < 1e-9);
    }

    #[test]
    fn noise_ends_at_the_least_error() {
        let truth = Vector6::new(0.0, 0.0, 0.5, 0.1, 0.6, -0.2);
        let mut noise = gauss(3);
        let features = mixed(&pose(&truth), || 3e-4 * noise());
        let end = virtual_servoing(&(truth * 0.97), &features, &VirtualServoing::default()).unwrap();
        assert!(gap(&pose(&end.x), &pose(&truth)) < 0.02 && end.error > 1e-5);
        let d = Vector6::repeat(1e-4);
        let at = |x: &Vector6<f64>| virtual_step(x, &features, 1.0, 0.0).unwrap().error;
        assert!(at(&end.x) < at(&(end.x + d)) && at(&end.x) < at(&(end.x - d)));
    }

    #[test]
    fn four_degrees_of_freedom_from_a_point_and_a_segment() {
        let truth = Vector4::new(0.03, -0.02, 0.45, 0.7);
        let X = Pose::from_parts(
            Translation3::new(truth.x, truth.y, truth.z),
            UnitQuaternion::from_rotation_matrix(&rotation_z(truth.w)),
        );
        let all = mixed(&X, || 0.0);
        let end =
            virtual_servoing_4(&Vector4::new(0.0, 0.0, 0.5, 0.5), &all[1..3], &VirtualServoing::default());
        assert!((end.unwrap().x - truth).norm() < 1e-9);
    }

    #[test]
    fn bad_input_is_refused() {
        let x = Vector6::new(0.0, 0.0, 0.5, 0.0, 0.3, 0.0);
        let features = mixed(&pose(&x), || 0.0);
        assert_eq!(
            virtual_step(&x, &features[..2], 1.0, 1.0).map(|_| ()),
            Err(PoseError::TooFewPoints { needed: 3, given: 2 })
        );
        let mut bad = features.clone();
        bad[2] = ObjectFeature::Point { r_O: Point3::origin(), s: Vector2::new(f64::NAN, 0.0) };
        assert_eq!(virtual_step(&x, &bad, 1.0, 1.0).map(|_| ()), Err(PoseError::NotFinite { index: 2 }));
        let behind = Vector6::new(0.0, 0.0, -0.5, 0.0, 0.3, 0.0);
        assert_eq!(virtual_step(&behind, &features, 1.0, 1.0).map(|_| ()), Err(PoseError::BehindCamera));
        bad[2] = ObjectFeature::Segment { ends_O: [Point3::origin(); 2], s: Vector4::zeros() };
        assert_eq!(virtual_step(&x, &bad, 1.0, 1.0).map(|_| ()), Err(PoseError::Degenerate));
    }
}
