//! A camera from points in space that are not in one plane, whose places are known: the end of Sect. 10.5. One image is enough.
//!
//! ```text
//! points and pixels ─► direct linear transformation, RQ ─► joint least squares of lens and pose ─► camera, pose, covariances
//!                      `dlt_camera`                          bundle, a board of any shape in one view
//! ```
//! SI units and radians; errors in px.

use crate::calibration::bundle::{
    BoardObservation, BundleFailure, BundlePoint, BundleProblem, BundleState, Freedom, Optics, adjust,
};
use crate::camera_model::{CameraModel, CameraModelError, Distortion, Intrinsics, LensModel};
use crate::geometry::Pose;
use crate::pose::{Correspondence3, Loss, PoseError, dlt_camera};
use nalgebra::{DMatrix, Matrix2, Matrix6, Point3, Vector2};
use thiserror::Error;

/// A focal length that is known to a smaller share counts as told. Chosen by hand: what works with a worse one is off by more than a tenth of its
/// distances.
const TOLD: f64 = 0.1;
/// Unknowns of a camera and a pose. Derived: focal lengths and principal point are four, a pose has six.
const PINHOLE: usize = 10;

/// Which coefficients of the lens are estimated; the others are zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointLens {
    /// None.
    Pinhole,
    /// k1.
    Radial1,
    /// k1 and k2.
    Radial2,
    /// k1, k2, p1, p2.
    PlumbBob,
}

impl PointLens {
    /// Their number.
    fn count(self) -> usize {
        match self {
            Self::Pinhole => 0,
            Self::Radial1 => 1,
            Self::Radial2 => 2,
            Self::PlumbBob => 4,
        }
    }

    /// Fewest points: more equations than unknowns. With a lens two more, because the linear start has none: of the fewest that the equations
    /// ask for, from one in forty to one in ten random sets led to no minimum or to a false one.
    #[must_use]
    pub fn needed(self) -> usize {
        (PINHOLE + self.count()) / 2 + if self.count() > 0 { 3 } else { 1 }
    }

    fn freedom(self) -> Freedom {
        let order = LensModel::PlumbBob.coefficients();
        let all = Freedom::of(LensModel::PlumbBob);
        order.iter().skip(self.count()).fold(all, |freedom, name| freedom.without(LensModel::PlumbBob, name))
    }
}

/// A point whose place is known, and where it is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointInSpace {
    /// Its place in the object frame, m.
    pub p_O: Point3<f64>,
    /// Where it is seen, px.
    pub px: Vector2<f64>,
    /// Standard deviation of each coordinate of `px`, px; `None` where none is stated: then all are alike, and as the errors have them.
    pub sd_px: Option<f64>,
}

/// Why points in space make no camera.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum SpaceCalibrationError {
    /// Fewer equations than unknowns.
    #[error(
        "calibration: {given} points, at least {needed} are needed for this lens; see more of the object"
    )]
    TooFewPoints {
        /// How many there are.
        given: usize,
        /// How many it takes.
        needed: usize,
    },
    /// A number that is none, or a deviation that is not positive.
    #[error(
        "calibration: point {index}, counted from 0, has a number that is not finite, or a deviation that is not positive"
    )]
    NotFinite {
        /// Which.
        index: usize,
    },
    /// One plane, or another arrangement that many cameras see alike.
    #[error(
        "calibration: the points lie in one plane, or leave the camera open in another way; take points at different depths, or for a plane several images \
         of a board (`vservo calibrate camera`)"
    )]
    Degenerate,
    /// The linear solution has points behind the camera: points and pixels do not belong together.
    #[error(
        "calibration: some points would lie behind the camera; check that each pixel belongs to its point, and that the object frame is right-handed"
    )]
    BehindCamera,
    /// The refinement did not settle.
    #[error(
        "calibration: no convergence in {iterations} iterations; check that each pixel belongs to its point, or take a simpler lens"
    )]
    NotConverged {
        /// Iterations spent.
        iterations: u32,
    },
    /// The camera that fits best is none.
    #[error(
        "calibration: the camera that fits the points best is none: {0}; take points over the whole image, or a simpler lens"
    )]
    Camera(CameraModelError),
}

/// A camera from points in space, and how good it is.
#[derive(Debug, Clone)]
pub struct SpaceCalibration {
    /// The camera.
    pub camera: CameraModel,
    /// The object in the camera.
    pub X_CO: Pose,
    /// Which parameters were estimated.
    pub freedom: Freedom,
    /// Their covariance, in the order of [`Freedom::names`].
    pub covariance: DMatrix<f64>,
    /// Covariance of the error `[v; w]` of `X_CO`: the position is off by `v`, m, the rotation by `exp(w)` from the left, rad; along the axes of C.
    pub covariance_X_CO: Matrix6<f64>,
    /// Seen minus predicted, px, in the order of the points.
    pub errors_px: Vec<Vector2<f64>>,
    /// Root mean square of their lengths, px.
    pub rms_px: f64,
    /// Sum of squared errors in standard deviations, where these are stated of all points.
    pub chi_square: Option<f64>,
    /// Equations less unknowns.
    pub degrees_of_freedom: usize,
}

impl SpaceCalibration {
    /// Names and standard deviations of the parameters that were estimated.
    pub fn deviations(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let names = self.freedom.names(LensModel::PlumbBob);
        names.into_iter().enumerate().map(|(i, name)| (name, self.covariance[(i, i)].max(0.0).sqrt()))
    }

    /// To which share of itself the less certain of the focal lengths is known.
    #[must_use]
    pub fn focal_share(&self) -> f64 {
        let i = self.camera.intrinsics();
        let of = |at: usize, f_px: f64| self.covariance[(at, at)].max(0.0).sqrt() / f_px;
        of(0, i.fx_px).max(of(1, i.fy_px))
    }

    /// Whether the points tell the camera.
    #[must_use]
    pub fn is_told(&self) -> bool {
        self.focal_share() < TOLD
    }
}

/// The camera that saw `points` in an image of `size` columns and rows, and where they are in it.
///
/// # Errors
/// [`SpaceCalibrationError`].
pub fn calibrate_in_space(
    points: &[PointInSpace],
    size: (u32, u32),
    lens: PointLens,
) -> Result<SpaceCalibration, SpaceCalibrationError> {
    if points.len() < lens.needed() {
        return Err(SpaceCalibrationError::TooFewPoints { given: points.len(), needed: lens.needed() });
    }
    let good = |p: &PointInSpace| {
        let finite = p.p_O.iter().chain(p.px.iter()).all(|x| x.is_finite());
        finite && p.sd_px.is_none_or(|sd| sd > 0.0 && sd.is_finite())
    };
    if let Some(index) = points.iter().position(|p| !good(p)) {
        return Err(SpaceCalibrationError::NotFinite { index });
    }
    let pairs: Vec<_> = points.iter().map(|p| Correspondence3 { r: p.p_O, s: p.px }).collect();
    let start = dlt_camera(&pairs).map_err(|e| match e {
        PoseError::BehindCamera => SpaceCalibrationError::BehindCamera,
        _ => SpaceCalibrationError::Degenerate,
    })?;
    let intrinsics = Intrinsics {
        fx_px: start.Omega.m11,
        fy_px: start.Omega.m22,
        cx_px: start.Omega.m13,
        cy_px: start.Omega.m23,
        width_px: size.0,
        height_px: size.1,
    };
    let stated = points.iter().all(|p| p.sd_px.is_some());
    let bundle_point = |p: &PointInSpace| BundlePoint {
        r: p.p_O.coords,
        lift: Vector2::zeros(),
        px: p.px,
        whitening: Matrix2::identity() / p.sd_px.filter(|_| stated).unwrap_or(1.0),
    };
    let observed = BoardObservation { camera: 0, points: points.iter().map(bundle_point).collect() };
    let problem =
        BundleProblem { freedom: vec![lens.freedom()], warp: false, views: vec![vec![observed.clone()]] };
    let state = BundleState {
        optics: vec![Optics { intrinsics, lens: Distortion::default().into() }],
        X_j0: Vec::new(),
        warp_m: Vector2::zeros(),
        poses: vec![start.X_CO],
    };
    let end = adjust(&problem, state, Loss::Squares).map_err(|e| match e {
        BundleFailure::BadStart => SpaceCalibrationError::BehindCamera,
        BundleFailure::Degenerate => SpaceCalibrationError::Degenerate,
        BundleFailure::NotConverged { iterations } => SpaceCalibrationError::NotConverged { iterations },
    })?;
    let (Some(optics), Some(X_CO)) = (end.state.optics.first(), end.state.poses.first()) else {
        return Err(SpaceCalibrationError::Degenerate);
    };
    let camera = CameraModel::new(optics.intrinsics, optics.lens).map_err(SpaceCalibrationError::Camera)?;
    let seen = |p: &BundlePoint| end.state.image(0, 0, p).map(|image| p.px - image.px);
    let errors_px: Option<Vec<Vector2<f64>>> = observed.points.iter().map(seen).collect();
    let errors_px = errors_px.ok_or(SpaceCalibrationError::BehindCamera)?;
    let degrees_of_freedom = problem.degrees_of_freedom();
    let factor = if stated { 1.0 } else { end.sums.chi_square / degrees_of_freedom.max(1) as f64 };
    let covariance = end.sums.covariance().ok_or(SpaceCalibrationError::Degenerate)?;
    let of_pose = end.sums.pose_covariance(0, &covariance).ok_or(SpaceCalibrationError::Degenerate)?;
    let squares: f64 = errors_px.iter().map(Vector2::norm_squared).sum();
    Ok(SpaceCalibration {
        camera,
        X_CO: *X_CO,
        freedom: lens.freedom(),
        covariance: covariance * factor,
        covariance_X_CO: of_pose * factor,
        rms_px: (squares / errors_px.len() as f64).sqrt(),
        errors_px,
        chi_square: stated.then_some(end.sums.chi_square),
        degrees_of_freedom,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::{Ldlt, Random};
    use nalgebra::{DVector, Vector3, Vector6};

    /// What is true, and points in the image of it.
    struct SeenTruth {
        camera: CameraModel,
        X_CO: Pose,
        points: Vec<PointInSpace>,
    }

    fn truth(random: &mut Random, count: usize, lens: Distortion, sd_px: f64) -> SeenTruth {
        let f = random.between(500.0, 1200.0);
        let intrinsics = Intrinsics {
            fx_px: f,
            fy_px: f * random.between(0.95, 1.05),
            cx_px: random.between(300.0, 340.0),
            cy_px: random.between(220.0, 260.0),
            width_px: 640,
            height_px: 480,
        };
        let camera = CameraModel::new(intrinsics, lens).unwrap();
        let turn = Vector3::from_fn(|_, _| random.between(-1.5, 1.5));
        let near = Vector3::new(random.between(-0.05, 0.05), random.between(-0.05, 0.05), 1.0);
        let X_CO = Pose::new(near, turn);
        let mut points = Vec::new();
        while points.len() < count {
            let z = random.between(0.7, 1.3);
            let px = Vector2::new(random.between(10.0, 630.0), random.between(10.0, 470.0));
            let p_C = Point3::from(camera.normalized_of(&px).push(1.0) * z);
            let Some(image) = camera.project(&p_C) else { continue };
            let noise = Vector2::new(random.gaussian(), random.gaussian()) * sd_px;
            let sd_px = if sd_px > 0.0 { sd_px } else { 0.1 };
            points.push(PointInSpace { p_O: X_CO.inverse() * p_C, px: image + noise, sd_px: Some(sd_px) });
        }
        SeenTruth { camera, X_CO, points }
    }

    fn values(camera: &CameraModel, freedom: &Freedom) -> DVector<f64> {
        let i = camera.intrinsics();
        let all = [("fx_px", i.fx_px), ("fy_px", i.fy_px), ("cx_px", i.cx_px), ("cy_px", i.cy_px)];
        let all: Vec<_> = all.into_iter().chain(camera.lens().coefficients()).collect();
        let names = freedom.names(LensModel::PlumbBob);
        DVector::from_iterator(
            names.len(),
            names.iter().map(|name| all.iter().find(|(own, _)| own == name).unwrap().1),
        )
    }

    #[test]
    fn random_cameras_come_back_without_noise() {
        let k = |k1: f64, k2: f64, p1: f64, p2: f64| Distortion { k1, k2, p1, p2, k3: 0.0 };
        let lenses = [
            (PointLens::Pinhole, k(0.0, 0.0, 0.0, 0.0)),
            (PointLens::Radial1, k(-0.15, 0.0, 0.0, 0.0)),
            (PointLens::Radial2, k(-0.2, 0.08, 0.0, 0.0)),
            (PointLens::PlumbBob, k(-0.2, 0.05, 1e-3, -5e-4)),
        ];
        let mut random = Random::new(8);
        for (lens, distortion) in lenses {
            for round in 0..50 {
                let count = lens.needed() + 2 + round % 20;
                let truth = truth(&mut random, count, distortion, 0.0);
                let found = calibrate_in_space(&truth.points, (640, 480), lens).unwrap();
                let (a, b) = (values(&found.camera, &found.freedom), values(&truth.camera, &found.freedom));
                let worst = (a - &b).component_div(&b.map(|x| x.abs().max(1.0))).amax();
                assert!(worst < 1e-6, "{lens:?} {count}: {worst:e}");
                let off = (found.X_CO.to_homogeneous() - truth.X_CO.to_homogeneous()).norm();
                assert!(off < 1e-6 && found.rms_px < 1e-6, "{lens:?} {count}: {off:e}");
                assert_eq!(found.deviations().count(), 4 + lens.count());
            }
        }
    }

    /// Errors of camera and pose by their covariances: chi-square has its mean, with deviations that are stated and with those that the errors have.
    #[test]
    fn covariances_of_points_in_space_are_honest() {
        for (lens, count) in [(PointLens::Pinhole, 25), (PointLens::Radial1, 60)] {
            let mut random = Random::new(21);
            let draws = 300;
            let (mut of_camera, mut of_pose, mut of_fit) = (0.0, 0.0, 0.0);
            for _ in 0..draws {
                let truth = truth(&mut random, count, Distortion::default(), 0.2);
                let found = calibrate_in_space(&truth.points, (640, 480), lens).unwrap();
                let e = values(&found.camera, &found.freedom) - values(&truth.camera, &found.freedom);
                let freedom = e.len() as f64;
                of_camera += e.dot(&(found.covariance.clone().try_inverse().unwrap() * &e)) / freedom;
                let v = found.X_CO.translation.vector - truth.X_CO.translation.vector;
                let w = (found.X_CO.rotation * truth.X_CO.rotation.inverse()).scaled_axis();
                let d = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
                let solved = Vector6::from(Ldlt::of(&found.covariance_X_CO).unwrap().solve(&d.into()));
                of_pose += d.dot(&solved) / 6.0;
                of_fit += found.chi_square.unwrap() / found.degrees_of_freedom as f64;
            }
            let means = [of_camera, of_pose, of_fit].map(|sum| sum / f64::from(draws));
            assert!(means.iter().all(|mean| (0.8..1.25).contains(mean)), "{lens:?}: {means:?}");
        }
    }

    #[test]
    fn deviations_that_nobody_states_are_those_of_the_errors() {
        let mut random = Random::new(3);
        let mut ratio = 0.0;
        for _ in 0..100 {
            let mut truth = truth(&mut random, 40, Distortion::default(), 0.3);
            let stated = calibrate_in_space(&truth.points, (640, 480), PointLens::Pinhole).unwrap();
            truth.points.iter_mut().for_each(|p| p.sd_px = None);
            let own = calibrate_in_space(&truth.points, (640, 480), PointLens::Pinhole).unwrap();
            ratio += own.covariance[(0, 0)] / stated.covariance[(0, 0)] / 100.0;
            assert!(own.chi_square.is_none() && own.is_told());
        }
        assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    }

    #[test]
    fn what_is_no_set_of_points_is_refused() {
        let mut random = Random::new(5);
        let SeenTruth { X_CO, points, .. } = truth(&mut random, 12, Distortion::default(), 0.0);
        let run = |points: &[PointInSpace]| calibrate_in_space(points, (640, 480), PointLens::Pinhole).err();
        assert_eq!(run(&points[..5]), Some(SpaceCalibrationError::TooFewPoints { given: 5, needed: 6 }));
        let six = calibrate_in_space(&points[..6], (640, 480), PointLens::Radial2).err();
        assert_eq!(six, Some(SpaceCalibrationError::TooFewPoints { given: 6, needed: 9 }));
        let mut bad = points.clone();
        bad[4].px.y = f64::INFINITY;
        assert_eq!(run(&bad), Some(SpaceCalibrationError::NotFinite { index: 4 }));
        bad[4] = PointInSpace { sd_px: Some(0.0), ..points[4] };
        assert_eq!(run(&bad), Some(SpaceCalibrationError::NotFinite { index: 4 }));
        // of the plane one metre ahead, which any pixel of a camera without a lens shows alike
        let flat = points.iter().map(|p| {
            let p_C = X_CO * p.p_O;
            PointInSpace { p_O: X_CO.inverse() * (p_C / p_C.z), ..*p }
        });
        assert_eq!(run(&flat.collect::<Vec<_>>()), Some(SpaceCalibrationError::Degenerate));
        // pixels of a mirrored object
        let mirrored: Vec<_> =
            points.iter().map(|p| PointInSpace { p_O: (-p.p_O.coords).into(), ..*p }).collect();
        assert!(run(&mirrored).is_some(), "a mirrored object has no camera in front of it");
    }
}
