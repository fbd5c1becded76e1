//! What a run told of its cell: each number with its prior and its uncertainty.

use super::unknowns::{MOUNT, PRIOR, SIZE, STAMPS, UNKNOWNS, mount_of};
use super::views::RunCell;
use crate::camera_model::{CameraModel, Intrinsics};
use crate::geometry::Pose;
use crate::linalg::Ldlt;
use crate::robot::Mount;
use nalgebra::{Matrix3, SMatrix, SVector};
use serde::Serialize;
use std::fmt::Write;
use thiserror::Error;

/// Share of the prior from which on a number counts as not seen. Chosen by hand: the run has not made it twice as certain.
const UNSEEN_SHARE: f64 = 0.5;
/// What of the unknowns belongs to the run file: all but the pose of the target, so that six are left out.
const TOLD: usize = 13;

/// Why nothing was refined.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum RunRefinementError {
    /// Too few views.
    #[error(
        "only {found} views of the target differ, {needed} are needed: the run must see the whole target while the arm moves, and know its pose"
    )]
    TooFewViews {
        /// Views that differ.
        found: usize,
        /// At least.
        needed: usize,
    },
    /// What is refined does not explain the images.
    #[error(
        "the images do not follow the arm ({rms_px:.2} px remain): the target must rest, not even creep or be pushed, and be of the kind that the run file tells, and the arm that of the robot file"
    )]
    Unexplained {
        /// What remains, px.
        rms_px: f64,
    },
    /// The equations have no solution.
    #[error(
        "no lens, mount and size near those of the run file put all points before the camera: correct the run file by hand first"
    )]
    NoFit,
}

/// One number of the run file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RefinedNumber {
    /// Which one.
    pub key: &'static str,
    /// As the run file tells.
    pub told: f64,
    /// As the run has it.
    pub refined: f64,
    /// Standard deviation of what the run file tells, as it is assumed.
    pub prior_sd: f64,
    /// Standard deviation after the run.
    pub sd: f64,
    /// Whether the run has made it at least twice as certain.
    pub is_seen: bool,
    /// Which motion shows more of it.
    pub shown_by: &'static str,
}

/// What a run told.
#[derive(Debug, Clone, Serialize)]
pub struct RunRefinement {
    /// All numbers.
    pub numbers: Vec<RefinedNumber>,
    /// Views that differ and were used, and others that were like the one before.
    pub views: usize,
    /// Views that were like the one before.
    pub repeated: usize,
    /// Distance of the points from where they should be, root mean square, px: by the run file, with the best pose of the target.
    pub rms_before_px: f64,
    /// The same after the refinement.
    pub rms_after_px: f64,
    /// The lens.
    #[serde(skip)]
    pub camera: CameraModel,
    /// The mount.
    #[serde(skip)]
    pub mount: Mount,
    /// What is to be added to the stamps beyond the run file, s.
    pub stamp_change_s: f64,
    /// Factor on the lengths of the target.
    pub size: f64,
    #[serde(skip)]
    unknowns: SVector<f64, TOLD>,
    #[serde(skip)]
    covariance: SMatrix<f64, TOLD, TOLD>,
}

/// Which motion shows what: chosen by hand, as the equations have it.
const DISTANCES: &str = "views of the target from different distances, and tilted by 20 degrees and more";
const ROLL: &str = "turns of the camera about its optical axis by 90 degrees, and tilted views";
const CORNERS: &str = "views with the target near the corners of the image";
const TURNS: &str = "turns of the camera about two axes by 30 degrees and more, with the target in view";
const FAST: &str = "faster motion across the image";
const WAYS: &str = "ways of some decimetres towards the target and across";

impl RunRefinement {
    pub(super) fn new<const N: usize>(
        cell: &RunCell<'_, N>,
        (at, covariance): (&SVector<f64, UNKNOWNS>, &SMatrix<f64, UNKNOWNS, UNKNOWNS>),
        camera: &CameraModel,
        (views, repeated): (usize, usize),
        (rms_before_px, rms_after_px): (f64, f64),
    ) -> Self {
        let places = told_places();
        let unknowns = SVector::from_fn(|i, _| at[places[i]]);
        let covariance_of_told = SMatrix::from_fn(|i, j| covariance[(places[i], places[j])]);
        let mount = mount_of(cell.mount, at);
        Self {
            numbers: numbers(cell, at, covariance, camera),
            views,
            repeated,
            rms_before_px,
            rms_after_px,
            camera: *camera,
            mount,
            stamp_change_s: at[STAMPS],
            size: at[SIZE].exp(),
            unknowns,
            covariance: covariance_of_told,
        }
    }

    /// How far `truth` is from what was found, as chi-square of thirteen numbers: lens, mount, offset of the stamps, s, and size. Of a covariance that holds it
    /// is 13 in the mean.
    #[must_use]
    pub fn chi_square(
        &self,
        told: (&CameraModel, &Mount),
        truth: (&CameraModel, &Mount),
        stamps_s: f64,
        size: f64,
    ) -> Option<f64> {
        let (a, b) = (told.0.intrinsics(), truth.0.intrinsics());
        let aspect = |i: &Intrinsics| (i.fy_px / i.fx_px).ln();
        let xi = log_of(&told.1.pose().inv_mul(truth.1.pose()));
        let f = a.fx_px;
        let mut true_at = SVector::<f64, TOLD>::zeros();
        let lens = [
            (b.fx_px / f).ln(),
            aspect(b) - aspect(a),
            (b.cx_px - a.cx_px) / f,
            (b.cy_px - a.cy_px) / f,
            first_radial(truth.0) - first_radial(told.0),
        ];
        for (k, number) in lens.into_iter().chain(xi).chain([stamps_s, size.ln()]).enumerate() {
            true_at[k] = number;
        }
        let off = self.unknowns - true_at;
        let solved = SVector::<f64, TOLD>::from(Ldlt::of(&self.covariance)?.solve(&off.into()));
        Some(off.dot(&solved))
    }

    /// All of it in words, a line each.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{} views that differ ({} more were like the one before); points are off by {:.3} px, after the refinement by {:.3} px\n",
            self.views, self.repeated, self.rms_before_px, self.rms_after_px
        );
        for n in &self.numbers {
            let _ = write!(
                text,
                "{:<44} {:>11.5} -> {:>11.5} +- {:.5} (before +- {:.5})",
                n.key, n.told, n.refined, n.sd, n.prior_sd
            );
            if !n.is_seen {
                let _ = write!(text, "  not seen by this run: {} would show it", n.shown_by);
            }
            text.push('\n');
        }
        text
    }
}

/// Where the numbers of the run file stand among the unknowns.
fn told_places() -> [usize; TOLD] {
    std::array::from_fn(|i| match i {
        0..11 => i,
        11 => STAMPS,
        _ => SIZE,
    })
}

/// The twist `[v; w]` by which a body moves in unit time from the identity to `X`.
pub(super) fn log_of(X: &Pose) -> [f64; 6] {
    let w = X.rotation.scaled_axis();
    let p = X.translation.vector;
    let angle = w.norm();
    let half = 0.5 * angle;
    // V^-1 follows from the exponential: 1 - [w]/2 + (1 - (a/2) cot(a/2)) [w]^2 / a^2, whose last factor tends to 1/12
    let bend = if angle < 1e-6 { 1.0 / 12.0 } else { (1.0 - half / half.tan()) / (angle * angle) };
    let v = p - w.cross(&p) * 0.5 + w.cross(&w.cross(&p)) * bend;
    [v.x, v.y, v.z, w.x, w.y, w.z]
}

fn first_radial(camera: &CameraModel) -> f64 {
    camera.lens().coefficients().iter().find(|(name, _)| *name == "k1").map_or(0.0, |(_, value)| *value)
}

fn numbers<const N: usize>(
    cell: &RunCell<'_, N>,
    at: &SVector<f64, UNKNOWNS>,
    covariance: &SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    camera: &CameraModel,
) -> Vec<RefinedNumber> {
    let (told, refined) = (cell.camera.full_intrinsics(), camera.full_intrinsics());
    let f = told.fx_px;
    let sd = |k: usize| covariance[(k, k)].max(0.0).sqrt();
    let of_fy = (covariance[(0, 0)] + 2.0 * covariance[(0, 1)] + covariance[(1, 1)]).max(0.0).sqrt();
    let fy_prior = PRIOR[0].hypot(PRIOR[1]);
    let mut all = Vec::with_capacity(TOLD);
    let mut add = |key, told: f64, refined: f64, prior_sd: f64, sd: f64, shown_by| {
        let is_seen = sd < UNSEEN_SHARE * prior_sd;
        all.push(RefinedNumber { key, told, refined, prior_sd, sd, is_seen, shown_by });
    };
    add("camera.lens.fx_px", told.fx_px, refined.fx_px, f * PRIOR[0], refined.fx_px * sd(0), DISTANCES);
    add("camera.lens.fy_px", told.fy_px, refined.fy_px, f * fy_prior, refined.fy_px * of_fy, DISTANCES);
    add("camera.lens.cx_px", told.cx_px, refined.cx_px, f * PRIOR[2], f * sd(2), ROLL);
    add("camera.lens.cy_px", told.cy_px, refined.cy_px, f * PRIOR[3], f * sd(3), ROLL);
    add("camera.lens.k1", first_radial(cell.camera), first_radial(camera), PRIOR[4], sd(4), CORNERS);
    let (X, Y) = (*cell.mount.pose(), *mount_of(cell.mount, at).pose());
    // The prior is the same in all directions, so that it is that of the axes of the frame that bears the camera, too.
    let R = X.rotation.to_rotation_matrix();
    let v: Matrix3<f64> = covariance.fixed_view::<3, 3>(MOUNT, MOUNT).into_owned();
    let position = R.matrix() * v * R.matrix().transpose();
    let keys = ["camera.mount.position_m x", "camera.mount.position_m y", "camera.mount.position_m z"];
    for (k, key) in keys.into_iter().enumerate() {
        let (a, b) = (X.translation.vector[k], Y.translation.vector[k]);
        add(key, a, b, PRIOR[MOUNT], position[(k, k)].max(0.0).sqrt(), TURNS);
    }
    let keys = [
        "camera.mount turned about the camera's x, deg",
        "camera.mount turned about the camera's y, deg",
        "camera.mount turned about the camera's z, deg",
    ];
    for (k, key) in keys.into_iter().enumerate() {
        let k = MOUNT + 3 + k;
        add(key, 0.0, at[k].to_degrees(), PRIOR[k].to_degrees(), sd(k).to_degrees(), TURNS);
    }
    add("camera.stamp_offset_ms, change", 0.0, at[STAMPS] * 1e3, PRIOR[STAMPS] * 1e3, sd(STAMPS) * 1e3, FAST);
    let size = at[SIZE].exp();
    add("size of the target, factor", 1.0, size, PRIOR[SIZE], size * sd(SIZE), WAYS);
    all
}
