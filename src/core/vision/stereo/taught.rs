//! The taught view: the points in space at the goal, measured once by the same two cameras in the desired pose.
//!
//! The object's frame O is a convention, since the object is unknown: `X_DO` is its pose in the taught view (D: the left camera there). All
//! points are stored in O, so that by (10.54) the pose `X_CO` of the object in the left camera is the displacement between the taught points and the
//! present ones; at `X_CO = X_DO` the goal is reached.

use super::rig::SpacePoint;
use crate::geometry::Pose;
use crate::linalg::{Ldlt, symmetric_eigen};
use crate::messages::MAX_FEATURES;
use crate::stereo::{MeasuredPair, StereoError, absolute_orientation_weighted};
use nalgebra::{Matrix3, Matrix6, Point3};
use thiserror::Error;

/// Fewest points of a pose: three are enough, since each has all three coordinates.
const LEAST: usize = 3;
/// Least standard deviation of a position, m, so that covariances that are given as zero stay definite.
const FLOOR_M: f64 = 1e-9;
/// Width over length of the points below which they count as collinear, so that the rotation about them would be undetermined. Chosen by
/// hand: 0.1 mm over 0.1 m, the error of a measured point.
const LINE: f64 = 1e-3;

/// A point of the taught view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaughtPoint {
    /// Which point.
    pub id: u32,
    /// Its position in the left camera in the desired pose, m.
    pub p_D: Point3<f64>,
    /// Covariance of `p_D`, m^2.
    pub covariance: Matrix3<f64>,
}

/// Why points cannot serve as a taught view.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TaughtViewError {
    /// Too few of them.
    #[error("has {0} points: three at least fix a pose; teach with more of the object in both images")]
    TooFew(usize),
    /// More than a measurement carries.
    #[error("has {0} points, at most 64 are possible; leave some out")]
    TooMany(usize),
    /// Ids do not rise.
    #[error("point {0} comes twice, or out of order: ids must rise")]
    Order(u32),
    /// A position or covariance that is impossible: not finite, behind the camera, or not positive semi-definite.
    #[error("point {0}: its position must lie before the camera, its covariance be finite and not negative")]
    Number(u32),
    /// All points are collinear.
    #[error("the points lie in one line, which fixes no pose; teach points beside it")]
    InLine,
}

/// A taught point in the object's frame, m and m^2.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Known {
    id: u32,
    p_O: Point3<f64>,
    covariance: Matrix3<f64>,
}

/// The taught view: points by id in the object's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct TaughtView {
    points: Vec<Known>,
    X_DO: Pose,
}

/// Pose of the object with its covariance, and the misfit of the points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectPose {
    /// Pose of O in the left camera.
    pub X_CO: Pose,
    /// Covariance as twist `[v; w]` of O in C, m and rad.
    pub covariance: Matrix6<f64>,
    /// Sum of the squared errors over their variances, of distances between rays and between points: chi-square.
    pub misfit: f64,
    /// Its degrees of freedom: 4 for each point less 6.
    pub freedom: usize,
}

impl TaughtView {
    /// A view of points that were measured in the desired pose, ids rising; `X_DO` is the pose of the object's frame by convention.
    ///
    /// # Errors
    /// [`TaughtViewError`].
    pub fn new(points: &[TaughtPoint], X_DO: Pose) -> Result<Self, TaughtViewError> {
        if points.len() < LEAST {
            return Err(TaughtViewError::TooFew(points.len()));
        }
        if points.len() > MAX_FEATURES {
            return Err(TaughtViewError::TooMany(points.len()));
        }
        let mut before = None;
        for point in points {
            if before.is_some_and(|before| point.id <= before) {
                return Err(TaughtViewError::Order(point.id));
            }
            before = Some(point.id);
            let eigen = symmetric_eigen(&point.covariance).map(|(values, _)| values);
            let is_good = point.p_D.iter().all(|x| x.is_finite())
                && point.p_D.z > 0.0
                // A singular covariance may have an eigenvalue below zero, which must be no more than rounding, m^2.
                && eigen.is_some_and(|values| values.iter().all(|x| x.is_finite() && *x >= -1e-12));
            if !is_good {
                return Err(TaughtViewError::Number(point.id));
            }
        }
        let count = points.len() as f64;
        let mean = points.iter().map(|p| p.p_D.coords).sum::<nalgebra::Vector3<f64>>() / count;
        let scatter: Matrix3<f64> =
            points.iter().map(|p| p.p_D.coords - mean).map(|d| d * d.transpose()).sum();
        let (extents, _) = symmetric_eigen(&scatter).ok_or(TaughtViewError::InLine)?;
        if !(extents.y > LINE * LINE * extents.x) {
            return Err(TaughtViewError::InLine);
        }
        let (X_OD, floor) = (X_DO.inverse(), Matrix3::identity() * (FLOOR_M * FLOOR_M));
        let R = *X_OD.rotation.to_rotation_matrix().matrix();
        let in_O = |p: &TaughtPoint| Known {
            id: p.id,
            p_O: X_OD * p.p_D,
            covariance: R * p.covariance * R.transpose() + floor,
        };
        Ok(Self { points: points.iter().map(in_O).collect(), X_DO })
    }

    /// Ids and positions of the points in the object's frame, m.
    pub fn points_O(&self) -> impl Iterator<Item = (u32, Point3<f64>)> + Clone {
        self.points.iter().map(|p| (p.id, p.p_O))
    }

    /// How many points it has.
    #[must_use]
    pub fn count(&self) -> usize {
        self.points.len()
    }

    /// Pose of the object's frame in the desired camera, by convention.
    #[must_use]
    pub fn X_DO(&self) -> &Pose {
        &self.X_DO
    }

    /// The taught point of this id, in O.
    fn point(&self, id: u32) -> Option<&Known> {
        self.points.binary_search_by_key(&id, |p| p.id).ok().and_then(|i| self.points.get(i))
    }

    /// Position of the point in the object's frame, m.
    #[must_use]
    pub fn p_O(&self, id: u32) -> Option<Point3<f64>> {
        self.point(id).map(|p| p.p_O)
    }

    /// The maximum-likelihood pose of the object for the triangulated points of the present pair; `pairs` is a buffer. Points that were not taught
    /// are ignored.
    ///
    /// # Errors
    /// [`StereoError::TooFewPoints`] for less than three, [`StereoError::Degenerate`] for collinear points,
    /// [`StereoError::NotConverged`].
    pub fn pose(
        &self,
        seen: &[SpacePoint],
        pairs: &mut Vec<MeasuredPair>,
    ) -> Result<ObjectPose, StereoError> {
        pairs.clear();
        let mut misfit = 0.0;
        for now in seen {
            let Some(then) = self.point(now.id) else { continue };
            misfit += now.misfit;
            pairs.push(MeasuredPair {
                p: now.p_L,
                p_prime: then.p_O,
                covariance: now.covariance,
                covariance_prime: then.covariance,
            });
        }
        let (found, covariance) = absolute_orientation_weighted(pairs)?;
        for pair in pairs.iter() {
            misfit += mismatch(&found.X, pair).ok_or(StereoError::BadGuess)?;
        }
        Ok(ObjectPose { X_CO: found.X, covariance, misfit, freedom: 4 * pairs.len() - 6 })
    }
}

/// Squared error of a pair over its variance.
pub(super) fn mismatch(X: &Pose, pair: &MeasuredPair) -> Option<f64> {
    let R = *X.rotation.to_rotation_matrix().matrix();
    let C = pair.covariance + R * pair.covariance_prime * R.transpose();
    let e = pair.p - X * pair.p_prime;
    let solved = Ldlt::of(&C)?.solve(&e.into());
    Some(e.dot(&nalgebra::Vector3::from(solved)))
}
