//! Hybrid law, (10.92)-(10.97): orientation from the planar homography between current and desired image, position
//! from one image point and the ratio of its depths. The object's geometry is not needed.
//!
//! Data flow: the selected points of view and set-point give a homography, its decomposition the [`Displacement`] of the camera (rotation `R_CD`,
//! plane normal, ratio of distances); with the point's error it forms the rows of a task, which [`joint_velocity`](super::joint_velocity) solves.
//!
//! Two signs differ from the printed text: `w_r = + T(phi_cd) K_o phi_cd` in (10.92), without which (10.93) does not
//! follow, and `-ln(rho_z)` in e_p, without which it does not fit J_p and J_o.

use super::{
    DepthSource, GainMatrix, OperationalSpace, OrientationError, SetPoint, TwistTask, View, fit_similarity,
};
use crate::features::{NormalEquations, point_rows};
use crate::geometry::rotation_z;
use crate::messages::MAX_FEATURES;
use crate::pose::{Correspondence, decompose_homography_seen, homography};
use nalgebra::{Matrix3, Rotation3, RowVector6, SMatrix, Vector2, Vector3, Vector6};

/// Gains of the hybrid law, 1/s: K_p for the image point and its depth, K_o for the orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HybridGains {
    /// K_p.
    pub K_p: GainMatrix<3>,
    /// K_o, in the order of the orientation error's numbers.
    pub K_o: GainMatrix<3>,
}

/// The camera's displacement from the desired to the current pose, from the homography between both images. Lengths are in units of d_d, the
/// distance of the plane from the desired camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displacement {
    /// Orientation of the desired camera in the current one.
    pub R_CD: Rotation3<f64>,
    /// Unit normal of the plane in the desired frame.
    pub n_D: Vector3<f64>,
    /// d_c / d_d = det H, (10.95).
    pub distance_ratio: f64,
    /// Position of the desired camera in the current one, over d_d.
    pub p_CD_C_over_d: Vector3<f64>,
}

impl Displacement {
    /// From the selected points of `view` and `set_point`. A homography has two decompositions; the one whose normal is nearer to the normal that
    /// the set-point expects is taken. `None` for too few or degenerate points.
    ///
    /// For [`OperationalSpace::Four`] the rotation is about the optical axis and the plane is parallel to the image, as in
    /// Example 10.5, and two points suffice. Otherwise four points are needed, no three of them collinear.
    #[must_use]
    pub fn new(set_point: &SetPoint, view: &View, space: OperationalSpace) -> Option<Self> {
        if view.features().len() != set_point.features().len() {
            return None;
        }
        let pair = |i: usize| Some((*set_point.features().get(i)?, *view.feature(i)?));
        let pairs = set_point.selection().points().filter_map(pair);
        match space {
            OperationalSpace::Four => {
                let fit = fit_similarity(pairs)?;
                Some(Self {
                    R_CD: rotation_z(fit.angle_rad),
                    n_D: Vector3::z(),
                    distance_ratio: 1.0 / fit.scale,
                    p_CD_C_over_d: (fit.offset / fit.scale).push(1.0 / fit.scale - 1.0),
                })
            }
            OperationalSpace::Six | OperationalSpace::Homography => {
                let none = Vector2::zeros();
                let mut seen = [Correspondence { r: none, s: none }; MAX_FEATURES];
                let mut desired = [none; MAX_FEATURES];
                let mut count = 0;
                for (place, (s_d, s)) in seen.iter_mut().zip(&mut desired).zip(pairs) {
                    *place.0 = Correspondence { r: s_d, s };
                    *place.1 = s_d;
                    count += 1;
                }
                let H = homography(seen.get(..count)?).ok()?;
                let readings = decompose_homography_seen(&H, desired.get(..count)?).ok()?;
                let best = readings.nearest_normal(&set_point.n_D());
                // det H of (10.95), by way of the matrix determinant lemma.
                let n_C = best.R_12 * best.n_2;
                let distance_ratio = 1.0 + n_C.dot(&best.p_12_1_over_d2);
                let p_CD_C_over_d = best.p_12_1_over_d2;
                Some(Self { R_CD: best.R_12, n_D: best.n_2, distance_ratio, p_CD_C_over_d })
            }
        }
    }

    /// rho_z = z_c / z_d, (10.94), of a point with the current feature `s` and the desired one `s_d`, normalized. `None` where it is not positive.
    #[must_use]
    pub fn depth_ratio(&self, s: &Vector2<f64>, s_d: &Vector2<f64>) -> Option<f64> {
        let n_C = self.R_CD * self.n_D;
        let rho = self.distance_ratio * self.n_D.dot(&s_d.push(1.0)) / n_C.dot(&s.push(1.0));
        (rho > 0.0 && rho < f64::INFINITY).then_some(rho)
    }
}

/// `[J_p J_o]` of (10.96), 3 x 6: the two rows of the point `s` (normalized) at depth `z_m`, and the row of `ln z_c`.
#[inline]
fn extended_rows(s: &Vector2<f64>, z_m: f64) -> SMatrix<f64, 3, 6> {
    let L = point_rows(s, z_m);
    let depth = RowVector6::new(0.0, 0.0, -1.0 / z_m, -s.y, s.x, 0.0);
    SMatrix::from_rows(&[L.row(0).into_owned(), L.row(1).into_owned(), depth])
}

/// J_p of (10.96), 3 x 3, for the point `s` (normalized) at depth `z_m`, m.
#[must_use]
pub fn J_p(s: &Vector2<f64>, z_m: f64) -> Matrix3<f64> {
    extended_rows(s, z_m).fixed_columns::<3>(0).into_owned()
}

/// J_o of (10.96), 3 x 3, for the point `s` (normalized).
#[must_use]
pub fn J_o(s: &Vector2<f64>) -> Matrix3<f64> {
    extended_rows(s, 1.0).fixed_columns::<3>(3).into_owned()
}

/// The rows `J_p v + J_o w = K_p e_p` and `w = T K_o phi_cd` as a task for the camera's twist `[v; w]` in C; solved for the twist they are
/// (10.92) and (10.97). e_p is the error of the first selected point that is not hidden.
///
/// z_c of J_p is `rho_z z_d`. Where z_d is not known a [`DepthSource::Constant`] takes its place: the translation is then too fast or too
/// slow by the ratio of both, and the goal stays the same. With [`DepthSource::Known`] z_c is the true one, and with [`DepthSource::Initial`] it keeps
/// the value that the pose of the first measurement gave, so that this ratio is `z_c(0) / z_c`. The other choices take z_d from the set-point: then the
/// law needs no pose of the object.
///
/// `None` when there is no homography, the view is of other features or the orientation error has no rate.
#[must_use]
pub fn hybrid_task(
    set_point: &SetPoint,
    view: &View,
    gains: &HybridGains,
    orientation: OrientationError,
    (space, depth): (OperationalSpace, DepthSource),
) -> Option<TwistTask> {
    let displacement = Displacement::new(set_point, view, space)?;
    let i = set_point.selection().points().find(|i| view.feature(*i).is_some())?;
    let (s, s_d, z_d) = (view.feature(i)?, set_point.features().get(i)?, set_point.depths_m().get(i)?);
    let rho = displacement.depth_ratio(s, s_d)?;
    let e_p = Vector3::new(s_d.x - s.x, s_d.y - s.y, -rho.ln());
    let phi = orientation.of(&displacement.R_CD);
    let w = orientation.rate(&phi, &displacement.R_CD)? * gains.K_o.times(&phi);
    let rate = gains.K_p.times(&e_p);
    let known = || -> Option<f64> { Some((view.X_CO_known()? * set_point.points().get(i)?).z) };
    let initial = || -> Option<f64> { Some(view.initial_depths()?.depth_m(set_point.points().get(i)?)) };
    let z_c = match depth {
        DepthSource::Constant(z_d) => z_d * rho,
        DepthSource::Known => known().filter(|z| *z > 0.0).unwrap_or(z_d * rho),
        DepthSource::Initial => initial().filter(|z| *z > 0.0).unwrap_or(z_d * rho),
        DepthSource::Desired | DepthSource::Estimated => z_d * rho,
    };
    let rows = extended_rows(s, z_c);
    let mut equations = NormalEquations::<6>::new();
    for k in 0..3 {
        let row = std::array::from_fn(|j| rows[(k, j)]);
        equations.add_row(&row, rate[k], 1.0);
        let mut row = [0.0; 6];
        row[3 + k] = 1.0;
        equations.add_row(&row, w[k], 1.0);
    }
    let error = Vector6::new(e_p.x, e_p.y, e_p.z, phi.x, phi.y, phi.z).norm();
    Some(TwistTask::new(&equations, error))
}
