//! How far from its goal a run has ended, by all that it has seen, and within which bound.
//!
//! ```text
//! X_DC(u) = X_DO X_CO(q_end; u)^-1        e(u) = (p, axis times angle) of X_DC        u: the unknowns of the fit, with their covariance
//! ```
//! The law has brought the measured pose to the goal; the true one differs as lens, size of the target and stamps differ from their description. What the run has seen
//! tells them in part, and the prior holds the rest: `e` has a mean, and a covariance by the derivative of `e`. The bound is the number that the length of such a random
//! `e` stays below in [`CONFIDENCE`] of all cases.

use super::problem::{RunFit, RunInformation, STEP};
use super::unknowns::{MOUNT, RunUnknowns, SIZE, STAMPS, UNKNOWNS};
use crate::geometry::Pose;
use crate::linalg::{Random, symmetric_eigen};
use nalgebra::{DMatrix, Matrix3, SMatrix, SVector, Vector3, Vector6};
use std::ops::Range;

/// Share of all cases in which the error is within the bound. Chosen by hand, as is usual.
pub const CONFIDENCE: f64 = 0.95;
/// Random errors from which a bound is counted. Chosen by hand: so many tell it to 2 %.
const SAMPLES: usize = 2000;
/// Share by which the bound must fall where a part of the description was known exactly for that part to be named. Chosen by hand: less is not worth a calibration.
const WORTH: f64 = 0.3;

/// A part of the description of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DescribedPart {
    /// Focal lengths, principal point, distortion.
    Lens,
    /// Where the camera sits.
    Mount,
    /// The delay of the camera's stamps.
    Stamps,
    /// Lengths of the target.
    Size,
}

impl DescribedPart {
    const ALL: [Self; 4] = [Self::Lens, Self::Mount, Self::Stamps, Self::Size];

    /// In words.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Lens => "lens",
            Self::Mount => "mount",
            Self::Stamps => "stamps",
            Self::Size => "size of the target",
        }
    }

    fn places(self) -> Range<usize> {
        match self {
            Self::Lens => 0..MOUNT,
            Self::Mount => MOUNT..MOUNT + 6,
            Self::Stamps => STAMPS..STAMPS + 1,
            Self::Size => SIZE..SIZE + 1,
        }
    }
}

/// The camera at the end of a run, against the desired one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndPose {
    /// Most likely distance, m.
    pub position_m: f64,
    /// Most likely angle, rad.
    pub angle_rad: f64,
    /// What the distance stays below in [`CONFIDENCE`] of all cases, m.
    pub position_bound_m: f64,
    /// The same of the angle, rad.
    pub angle_bound_rad: f64,
    /// What remains of the points' errors, root mean square, px.
    pub rms_px: f64,
    /// What would narrow the bound of the distance the most if it was known exactly; `None` where nothing would by much.
    pub narrowed_by: Option<DescribedPart>,
}

impl<const N: usize> RunFit<'_, N> {
    /// The end of the run in the posture `q`, rad or m, where the target should be at `X_DO` in the camera.
    #[must_use]
    pub fn end_pose(&self, (q, X_DO): (&SVector<f64, N>, &Pose)) -> EndPose {
        EndPose::of(self, &|at| error_of(&(X_DO * self.X_CO(q, at).inverse())))
    }
}

/// Position and rotation vector of a displacement.
fn error_of(X_DC: &Pose) -> Vector6<f64> {
    let (p, w) = (X_DC.translation.vector, X_DC.rotation.scaled_axis());
    Vector6::new(p.x, p.y, p.z, w.x, w.y, w.z)
}

impl EndPose {
    fn of<const N: usize>(fit: &RunFit<'_, N>, error: &dyn Fn(&RunUnknowns) -> Vector6<f64>) -> Self {
        let mean = error(&fit.at);
        let G = SMatrix::<f64, 6, UNKNOWNS>::from_columns(&std::array::from_fn::<_, UNKNOWNS, _>(|k| {
            let mut there = fit.at;
            there[k] += STEP;
            (error(&there) - mean) / STEP
        }));
        let halves = |covariance: &RunInformation| {
            let of_error = G * covariance * G.transpose();
            let (p, w) = (of_error.fixed_view::<3, 3>(0, 0), of_error.fixed_view::<3, 3>(3, 3));
            (p.into_owned(), w.into_owned())
        };
        let (of_p, of_w) = halves(&fit.covariance);
        let (p, w) = (mean.fixed_rows::<3>(0).into_owned(), mean.fixed_rows::<3>(3).into_owned());
        let position_bound_m = bound(&p, &of_p);
        let narrowed = DescribedPart::ALL.into_iter().filter_map(|part| {
            let (of_p, _) = halves(&known(&fit.covariance, part.places())?);
            Some((bound(&p, &of_p), part))
        });
        let least = narrowed.min_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            position_m: p.norm(),
            angle_rad: w.norm(),
            position_bound_m,
            angle_bound_rad: bound(&w, &of_w),
            rms_px: fit.rms_px,
            narrowed_by: least.filter(|(m, _)| *m < (1.0 - WORTH) * position_bound_m).map(|(_, part)| part),
        }
    }
}

/// The covariance where the unknowns at `places` were known exactly.
fn known(covariance: &RunInformation, places: Range<usize>) -> Option<RunInformation> {
    let all = DMatrix::from_column_slice(UNKNOWNS, UNKNOWNS, covariance.as_slice());
    let across = all.columns(places.start, places.len());
    let inverse = all.view((places.start, places.start), (places.len(), places.len())).try_inverse()?;
    let left = &all - across * inverse * across.transpose();
    Some(RunInformation::from_column_slice(left.as_slice()))
}

/// What the length of a random vector of this mean and covariance stays below in [`CONFIDENCE`] of all cases.
fn bound(mean: &Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    let Some((values, axes)) = symmetric_eigen(covariance) else { return f64::INFINITY };
    let sds = values.map(|value| value.max(0.0).sqrt());
    let mut random = Random::new(1);
    let mut draw = || {
        let unit = Vector3::from_fn(|_, _| random.gaussian());
        (mean + axes * unit.component_mul(&sds)).norm()
    };
    let mut lengths: Vec<f64> = (0..SAMPLES).map(|_| draw()).collect();
    let place = (CONFIDENCE * SAMPLES as f64) as usize;
    *lengths.select_nth_unstable_by(place, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_is_that_of_tables() {
        // 95 % quantiles: of a normal number's size 1.960, of the length of three 2.795 (chi-square 7.815), of a number about 10 that has a tail to one side 11.645.
        let one = Matrix3::from_diagonal(&Vector3::new(1.0, 0.0, 0.0));
        for (mean, covariance, quantile) in [
            (Vector3::zeros(), one, 1.960),
            (Vector3::zeros(), Matrix3::identity(), 2.795),
            (Vector3::new(10.0, 0.0, 0.0), one, 11.645),
        ] {
            let found = bound(&mean, &covariance);
            assert!((found / quantile - 1.0).abs() < 0.04, "{found} {quantile}");
        }
    }
}
