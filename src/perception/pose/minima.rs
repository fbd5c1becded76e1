//! All local minima of the reprojection error whose value is close to the global minimum.
//!
//! The minima of the object-space error over all rotations, from a grid that leaves none out ([`super::rotation_form`]),
//! are refined on the reprojection error (10.36) and ranked by it.

use super::points::centroid;
use super::refine::{Minimum, PoseState, minimise};
use super::rotation_form::{Axes, RotationCandidate, RotationForm};
use super::{PointSource, PoseError, PoseSolution, p3p};
use crate::geometry::Pose;
use crate::linalg::{F2, symmetric_eigen};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Width over length of a set, below which it counts as collinear: extents are roots of eigenvalues, which round to 1e-16 of the largest,
/// so that ratios below 1e-8 are indistinguishable from zero.
const COLLINEAR: f64 = 1e-7;
/// Thickness over width of a set, below which it counts as planar. Derived: thickness over length rounds to 1e-8 for the same reason, and the
/// width may be a hundredth of the length.
const FLAT: f64 = 1e-6;
/// Starts on the grid of rotations, by which the least error over all rotations is found: `no_minimum_is_lower_than_the_first` is the test of
/// it, against random starts. Chosen by hand: half may miss a basin, twice takes more time in each solution.
const STARTS: usize = 8;
/// Minima that are kept, since each start may have one of its own, and each of the four solutions of three points.
const BASINS: usize = STARTS + 4;
/// Newton's steps on the object-space error end below this, rad: the rest is the refinement's work. Half and twice of it change no unit test.
const LAST_STEP_RAD: f64 = 1e-3;
/// A solution is kept while its rms is at most this many times the least plus [`CLOSE_RMS`]. Chosen by hand: half and twice of either change no
/// unit test.
const CLOSE_FACTOR: f64 = 5.0;
/// About a pixel of a lens of 1000 px, in normalized units: where the points are exact the least rms is rounding, and a factor alone would
/// leave no other solution.
const CLOSE_RMS: f64 = 1e-3;
/// Rotations nearer than this (rad) are one solution: refinements of one minimum end within 1e-7 of each other,
/// `refine`'s last step. Half and twice of it change no unit test.
const SAME_RAD: f64 = 1e-4;
/// A trace of `R_a^T R_b` above this is a rotation by less than 0.01 rad, since it is `1 + 2 cos(angle)`: ten of Newton's last steps, so
/// that one basin is refined once.
const SAME_TRACE: f64 = 3.0 - 1e-4;

/// Up to four poses, the one of least reprojection error first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PnpPoses {
    solutions: [PoseSolution; 4],
    len: usize,
}

impl PnpPoses {
    pub(super) fn none() -> Self {
        Self { solutions: [PoseSolution::none(); 4], len: 0 }
    }

    /// The solutions, one at least, in the order of their reprojection errors.
    #[must_use]
    pub fn as_slice(&self) -> &[PoseSolution] {
        self.solutions.get(..self.len).unwrap_or(&[])
    }

    /// The one of least reprojection error.
    #[must_use]
    pub fn best(&self) -> PoseSolution {
        self.solutions[0]
    }

    /// The solution whose rotation is nearest to that of `X_CO`, for example of the pose one frame before.
    #[must_use]
    pub fn nearest(&self, X_CO: &Pose) -> PoseSolution {
        let mut nearest = self.solutions[0];
        for one in self.as_slice() {
            let angle = |solution: &PoseSolution| solution.X_CO.rotation.angle_to(&X_CO.rotation);
            if angle(one) < angle(&nearest) {
                nearest = *one;
            }
        }
        nearest
    }

    /// Inserts `new` by its error; the worst of more than four is dropped, and of two that are the same the worse.
    pub(super) fn insert(&mut self, new: PoseSolution) {
        let same = |old: &PoseSolution| {
            let way = (old.X_CO.translation.vector - new.X_CO.translation.vector).norm();
            old.X_CO.rotation.angle_to(&new.X_CO.rotation) < SAME_RAD
                && way < SAME_RAD * new.X_CO.translation.vector.norm()
        };
        if self.as_slice().iter().any(same) {
            return;
        }
        let mut at = self.as_slice().iter().take_while(|old| old.rms <= new.rms).count();
        let mut moving = new;
        while let Some(place) = self.solutions.get_mut(at) {
            std::mem::swap(place, &mut moving);
            at += 1;
        }
        self.len = (self.len + 1).min(4);
    }
}

/// Mean, principal axes and size of the object points, and whether they lie in a plane.
pub(super) fn axes<P: PointSource>(points: &[P]) -> Result<(Axes, bool), PoseError> {
    let mean = centroid(points);
    let mut scatter = [[0.0; 3]; 3];
    for point in points {
        let r = point.object();
        let d = [r[0] - mean[0], r[1] - mean[1], r[2] - mean[2]];
        for i in 0..3 {
            for j in 0..=i {
                scatter[i][j] += d[i] * d[j];
            }
        }
    }
    let A = Matrix3::from_fn(|i, j| scatter[i.max(j)][i.min(j)]);
    let size2 = A.trace() / points.len() as f64;
    let (extents, V) = symmetric_eigen(&A).ok_or(PoseError::Degenerate)?;
    if !(extents.y > COLLINEAR * COLLINEAR * extents.x) || !(size2 > 0.0) {
        return Err(PoseError::Degenerate);
    }
    let (x, y) = (V.column(0).into_owned(), V.column(1).into_owned());
    let rows = [x, y, x.cross(&y)].map(|v| [v.x, v.y, v.z]);
    let flat = extents.z.max(0.0) <= FLAT * FLAT * extents.y;
    Ok((Axes { mean, rows, size: size2.sqrt() }, flat))
}

/// The pose for a rotation of the principal axes and the position of the mean.
pub(super) fn pose_of_axes(axes: &Axes, R: &Matrix3<f64>, p: &Vector3<f64>) -> Pose {
    let rows = Matrix3::from_fn(|i, j| axes.rows[i][j]);
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(R * rows));
    let q = UnitQuaternion::new_normalize(q.into_inner());
    Pose::from_parts(Translation3::from(p - q * Vector3::from(axes.mean)), q)
}

/// All minima of the object-space error, refined.
pub(super) fn everywhere<P: PointSource>(
    points: &[P],
    axes: &Axes,
    flat: bool,
) -> Result<PnpPoses, PoseError> {
    let form = RotationForm::new(points, axes).ok_or(PoseError::Degenerate)?;
    let mut basins = Basins { form: &form, found: [None; BASINS], least: f64::INFINITY };
    // The solutions of three points are exact without noise, and close with some.
    for triple in triples(points) {
        if let Ok(poses) = p3p(&triple) {
            for X_CO in poses.as_slice() {
                basins.add(columns_of(axes, X_CO));
            }
        }
    }
    let (starts, len) = form.starts::<STARTS>();
    for start in starts.iter().take(len) {
        basins.add(RotationForm::start(*start));
    }
    let center = centroid(points);
    let mut all = PnpPoses::none();
    let mut reason = PoseError::BehindCamera;
    // The object-space error is not the reprojection error: twice the bound, so that none is lost before it is refined.
    let most = 2.0 * (CLOSE_FACTOR * basins.least.sqrt() + CLOSE_RMS * (points.len() as f64).sqrt());
    for candidate in basins.found.iter().flatten().filter(|candidate| candidate.value.sqrt() <= most) {
        match refined(points, axes, &form, candidate, &center) {
            Ok(end) => {
                all.insert(PoseSolution { X_CO: end.state.pose(&center), rms: end.normal.rms(points.len()) })
            }
            Err(other) => reason = other,
        }
    }
    if all.len == 0 {
        return Err(reason);
    }
    let most = CLOSE_FACTOR * all.best().rms + CLOSE_RMS;
    all.len = all.as_slice().iter().take_while(|solution| flat || solution.rms <= most).count();
    Ok(all)
}

/// Minima of the object-space error in front of the camera, each once.
struct Basins<'a> {
    form: &'a RotationForm,
    found: [Option<RotationCandidate>; BASINS],
    /// Least value so far, over the depth squared.
    least: f64,
}

impl Basins<'_> {
    /// The minimum below `columns`.
    #[inline]
    fn add(&mut self, columns: [f64; 9]) {
        let mut found = self.form.descend(columns, LAST_STEP_RAD);
        let mut depth = self.form.position(&found.columns)[2];
        if depth < 0.0 {
            // A plane turned by half a turn about its normal, on the other side of the camera, has the same error, and a
            // set with some thickness nearly the same.
            for x in found.columns.iter_mut().take(6) {
                *x = -*x;
            }
            found = self.form.descend(found.columns, LAST_STEP_RAD);
            depth = self.form.position(&found.columns)[2];
        }
        if !(depth > 0.0) {
            return;
        }
        // Over the depth squared it is the reprojection error's, nearly.
        found.value = found.value.max(0.0) / (depth * depth);
        let same = |other: &RotationCandidate| {
            let trace: f64 = other.columns.iter().zip(&found.columns).map(|(a, b)| a * b).sum();
            trace > SAME_TRACE
        };
        if self.found.iter().flatten().any(same) {
            return;
        }
        self.least = self.least.min(found.value);
        if let Some(free) = self.found.iter_mut().find(|place| place.is_none()) {
            *free = Some(found);
        }
    }
}

/// The rotation of the principal axes in the camera, column by column.
fn columns_of(axes: &Axes, X_CO: &Pose) -> [f64; 9] {
    let rows = axes.rows.map(|row| X_CO.rotation * Vector3::from(row));
    let [[a, b, c], [d, e, f], [g, h, i]] = rows.map(|v| [v.x, v.y, v.z]);
    [a, b, c, d, e, f, g, h, i]
}

/// A wide triangle of the points.
fn triples<P: PointSource>(points: &[P]) -> impl Iterator<Item = [P; 3]> {
    let at = |p: &P| Vector3::from(p.object());
    let farthest =
        |size: &dyn Fn(&P) -> f64| points.iter().copied().max_by(|a, b| size(a).total_cmp(&size(b)));
    let center = Vector3::from(centroid(points));
    let a = farthest(&|p| (at(p) - center).norm_squared());
    let b = a.and_then(|a| farthest(&|p| (at(p) - at(&a)).norm_squared()));
    let c = a.zip(b).and_then(|(a, b)| {
        let side = at(&b) - at(&a);
        farthest(&|p| (at(p) - at(&a)).cross(&side).norm_squared())
    });
    a.zip(b).zip(c).map(|((a, b), c)| [a, b, c]).into_iter()
}

fn refined<P: PointSource>(
    points: &[P],
    axes: &Axes,
    form: &RotationForm,
    candidate: &RotationCandidate,
    center: &[f64; 3],
) -> Result<Minimum, PoseError> {
    let R = Matrix3::from_column_slice(&candidate.columns);
    let X = pose_of_axes(axes, &R, &(Vector3::from(form.position(&candidate.columns)) * axes.size));
    minimise::<F2, _>(PoseState::at(&X, center).ok_or(PoseError::Degenerate)?, points, center)
}
