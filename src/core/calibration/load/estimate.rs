//! What was found of a load, with its uncertainty, and what did not show.

use super::equations::LOAD;
use crate::robot::{Inertia, Robot};
use nalgebra::{DMatrix, Matrix3, SMatrix, SVector, Vector3};

/// Numbers of a joint: Coulomb friction, viscous friction, and inertia of its rotor beyond the file, from which the number follows.
pub(super) const JOINT: usize = 3;
/// Radius of gyration of loads, m, which gives the prior of their moments of inertia. Chosen by hand: a box with sides of 0.25 m has it.
pub(super) const GYRATION_M: f64 = 0.1;
/// Standard deviation of the centre of mass from which on a direction of it counts as not seen, m. Chosen by hand: half of what tools have.
const UNSEEN_M: f64 = 0.05;
/// Share of the prior from which on a moment of inertia counts as not seen. Chosen by hand: the motion has told less than the guess.
const UNSEEN_SHARE: f64 = 0.5;
/// Standard deviations below which a mass may be none. Chosen by hand: one of a thousand by chance.
const NONE: f64 = 3.0;
/// The moments, as they stand in a run file.
const MOMENTS: [(&str, usize, usize); 6] =
    [("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2)];

/// All numbers after the motion: those of the load, and of each joint its friction and rotor, with their covariance.
pub(super) struct LoadPosterior {
    pub(super) load: [f64; LOAD],
    pub(super) joints: Vec<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Standard deviation of the prior of a moment of inertia, kg m^2.
    pub(super) moment_prior_sd: f64,
}

/// What a joint was found to resist with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointFrictionEstimate {
    /// Coulomb friction and its standard deviation, N m or N.
    pub coulomb: [f64; 2],
    /// Viscous friction and its standard deviation, N m s/rad or N s/m.
    pub viscous: [f64; 2],
    /// Inertia beyond the robot file and its standard deviation, kg m^2 or kg.
    pub rotor: [f64; 2],
}

/// A load that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadEstimate {
    /// The whole load, in the flange's frame: what was told of it included. Directions of the centre of mass that are not seen are near to
    /// what was told.
    pub load: Inertia,
    /// Standard deviation of the mass, kg.
    pub mass_sd_kg: f64,
    /// Standard deviation of the centre of mass along each axis, m.
    pub com_sd_m: [f64; 3],
    /// Standard deviation of the moments about the centre of mass xx, yy, zz, xy, xz, yz, kg m^2.
    pub inertia_sd_kg_m2: [f64; 6],
    /// Whether a load shows at all.
    pub is_there: bool,
    /// Whether all moments are seen, and a body can have them.
    pub has_inertia: bool,
    /// What the motion has not shown, in words.
    pub unseen: Vec<String>,
    /// Of each joint.
    pub joints: Vec<JointFrictionEstimate>,
    /// Root mean square of what is left of each joint's torques, as a share of its largest effort.
    pub residual_shares: Vec<f64>,
}

impl LoadEstimate {
    pub(super) fn new<const N: usize>(
        at: &LoadPosterior,
        robot: &Robot<N>,
        residual_shares: Vec<f64>,
    ) -> Self {
        let covariance: SMatrix<f64, LOAD, LOAD> = at.covariance.fixed_view::<LOAD, LOAD>(0, 0).into_owned();
        let mass = at.load[0];
        let mass_sd_kg = covariance[(0, 0)].sqrt();
        let is_there = mass > NONE * mass_sd_kg;
        let h = Vector3::new(at.load[1], at.load[2], at.load[3]);
        let com = if is_there { h / mass } else { Vector3::zeros() };
        // c = h / m
        let mut of_com = SMatrix::<f64, 3, LOAD>::zeros();
        for k in 0..3 {
            (of_com[(k, 0)], of_com[(k, k + 1)]) = (-com[k] / mass, 1.0 / mass);
        }
        let com_covariance: Matrix3<f64> = of_com * covariance * of_com.transpose();
        let [xx, yy, zz, xy, xz, yz] = std::array::from_fn(|k| at.load[4 + k]);
        let about_origin = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let body = Inertia { mass, com, about_com: about_origin - crate::robot::parallel_axis(mass, &com) };
        let inertia_sd_kg_m2 = MOMENTS.map(|(_, i, j)| moment_sd(&covariance, &com, (i, j)));
        let seen_sd = UNSEEN_SHARE * at.moment_prior_sd;
        let mut unseen = Vec::new();
        if is_there {
            unseen.extend(unseen_directions(&com_covariance, robot));
            let dark: Vec<_> = MOMENTS
                .iter()
                .zip(&inertia_sd_kg_m2)
                .filter(|((_, i, j), sd)| **sd > if i == j { seen_sd } else { 0.5 * seen_sd })
                .map(|((name, ..), _)| *name)
                .collect();
            if !dark.is_empty() {
                unseen.push(format!(
                    "moments of inertia {}: beside friction and rotors the motion tells them no better than the guess that a load of this mass has a \
                     radius of gyration of {GYRATION_M} m; larger motion.max_acceleration_rad_s2_or_m_s2, and armature_kg_m2 in the robot file, show more",
                    dark.join(", ")
                ));
            }
        }
        let possible = body.check_load().is_ok();
        let has_inertia = is_there && possible && !unseen.iter().any(|words| words.starts_with("moments"));
        if is_there && !possible && !unseen.iter().any(|words| words.starts_with("moments")) {
            unseen.push("moments of inertia: those found are within their uncertainty of what a body can have, and not among it".into());
        }
        let joints = (0..N).map(|i| of_joint(at, i)).collect();
        Self {
            load: body,
            mass_sd_kg,
            com_sd_m: std::array::from_fn(|k| com_covariance[(k, k)].sqrt()),
            inertia_sd_kg_m2,
            is_there,
            has_inertia,
            unseen,
            joints,
            residual_shares,
        }
    }
}

/// Standard deviation of the moment of row `i` and column `j` about the centre of mass: `I_com = I - (c . h 1 - c h^T)`.
fn moment_sd(covariance: &SMatrix<f64, LOAD, LOAD>, com: &Vector3<f64>, (i, j): (usize, usize)) -> f64 {
    let mut by = SVector::<f64, LOAD>::zeros();
    let one = if i == j { 1.0 } else { 0.0 };
    // d(h.h / m) = 2 c . dh - c.c dm,   d(h_i h_j / m) = c_i dh_j + c_j dh_i - c_i c_j dm
    by[0] = one * com.norm_squared() - com[i] * com[j];
    for k in 0..3 {
        by[1 + k] -= one * 2.0 * com[k];
    }
    by[1 + j] += com[i];
    by[1 + i] += com[j];
    if let Some(k) = MOMENTS.iter().position(|(_, a, b)| (*a, *b) == (i, j)) {
        by[4 + k] = 1.0;
    }
    (covariance * by).dot(&by).max(0.0).sqrt()
}

/// The directions of the centre of mass that the motion has not shown.
fn unseen_directions<const N: usize>(covariance: &Matrix3<f64>, robot: &Robot<N>) -> Vec<String> {
    let Some((variances, axes)) = crate::linalg::symmetric_eigen(covariance) else { return Vec::new() };
    let dark = (0..3).filter(|k| variances[*k].max(0.0).sqrt() > UNSEEN_M);
    let words = dark.map(|k| {
        let a = axes.column(k);
        let along = robot.gravity_vector().norm() == 0.0;
        let help =
            if along { "gravity is zero" } else { "start where the last joints can turn it across gravity" };
        format!(
            "centre of mass along [{:.2}, {:.2}, {:.2}] of the flange: {:.0} mm uncertain; {help}",
            a[0],
            a[1],
            a[2],
            variances[k].sqrt() * 1e3
        )
    });
    words.collect()
}

fn of_joint(at: &LoadPosterior, i: usize) -> JointFrictionEstimate {
    let number = |k: usize| {
        let place = JOINT * i + k;
        let variance = at.covariance.get((LOAD + place, LOAD + place)).copied().unwrap_or_default();
        [at.joints.get(place).copied().unwrap_or_default(), variance.sqrt()]
    };
    JointFrictionEstimate { coulomb: number(0), viscous: number(1), rotor: number(2) }
}
