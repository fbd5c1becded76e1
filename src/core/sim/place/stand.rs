//! Postures at the goal in which the camera looks in the requested direction, the joints have room to move, and the object is in a place where
//! one can lie.
//!
//! The numbers here were chosen by hand. They only rank proposals: each proposal is checked and tried in a simulated run before it is given,
//! so that a bad score costs a better place, never a wrong one. `tests/processes/place.rs` begins
//! with nothing but a robot's file. How often another choice would find more is not measured.

use super::{Look, PlaceRequest, Search};
use crate::geometry::Pose;
use crate::linalg::Random;
use nalgebra::{Rotation3, SVector, UnitQuaternion, Vector3};

/// Random postures that are tried where the object may lie anywhere; rolls of the camera and random starts for each where its pose is given.
pub(super) const POSTURES: usize = 1500;
const ROLLS: usize = 24;
const STARTS_EACH: usize = 12;
/// Distance of a joint from the ends of its range at the goal, as a share of the range: the minimum, and what scores full.
const MIN_SHARE: f64 = 0.08;
const GOOD_SHARE: f64 = 0.25;
/// Largest error of the requested viewing direction, rad, and that for an arm of fewer than six joints, which cannot choose it.
const TURNED: f64 = 1e-3;
const TURNED_OF_FEW: f64 = 0.7;
/// Postures that differ by less than this in each joint, rad or m, count as the same.
const ALIKE: f64 = 0.5;

/// A posture at the goal, and the object that it looks at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand<const N: usize> {
    pub(super) q: SVector<f64, N>,
    pub(super) X_WO: Pose,
    pub(super) X_DO: Pose,
    score: f64,
}

impl<const N: usize> Search<'_, N> {
    /// The best stands, the best one first.
    pub(super) fn stands(&self, request: &PlaceRequest, X_DO: &Pose) -> Vec<Stand<N>> {
        let look = request.look.unwrap_or(Look::Down);
        let mut found = match request.object {
            Some((p_WO, R_WO)) => self.about(&p_WO, R_WO, look, X_DO),
            None => self.anywhere(look, X_DO),
        };
        if found.is_empty() && request.look.is_none() && request.object.is_none() {
            found = self.anywhere(Look::Any, X_DO);
        }
        let dexterity = |stand: &Stand<N>| self.posture().dexterity(&stand.q);
        let best = found.iter().map(dexterity).fold(0.0, f64::max);
        for stand in &mut found {
            // half of what the best one has is good enough
            stand.score *= (dexterity(stand) / (0.5 * best)).min(1.0);
        }
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut distinct: Vec<Stand<N>> = Vec::new();
        // The worst of these factors together make 1e-3.
        for stand in found.into_iter().filter(|stand| stand.score > 1e-3) {
            if distinct.len() < 64 && distinct.iter().all(|other| (other.q - stand.q).amax() > ALIKE) {
                distinct.push(stand);
            }
        }
        distinct
    }

    /// Postures anywhere, with the object where the camera then looks.
    fn anywhere(&self, look: Look, X_DO: &Pose) -> Vec<Stand<N>> {
        let search = self.posture();
        let mut random = Random::new(11);
        let reach_m = self.reach_m();
        let mut found = Vec::new();
        for _ in 0..POSTURES {
            let mut q = search.anywhere(&mut random);
            let X_WC = search.X_WC(&q);
            if let Some(axis) = self.wanted_axis(look, &q) {
                // the least turn that makes it look there
                let turn = Rotation3::rotation_between(&(X_WC.rotation * Vector3::z()), &axis);
                let turn =
                    turn.unwrap_or_else(|| Rotation3::from_scaled_axis(Vector3::x() * std::f64::consts::PI));
                if N >= 6 {
                    let rotation = UnitQuaternion::from_rotation_matrix(&turn) * X_WC.rotation;
                    q = search.towards_within(&q, &Pose::from_parts(X_WC.translation, rotation), 60);
                }
                let off = (search.X_WC(&q).rotation * Vector3::z()).angle(&axis);
                if off > if N >= 6 { TURNED } else { TURNED_OF_FEW } {
                    continue;
                }
            }
            // as it will be written: whole ten thousandths
            let q = q.map(|q| (q * 1e4).round() * 1e-4);
            let X_WO = search.X_WC(&q) * X_DO;
            let score = self.room(&q) * self.place_score(&q, &X_WO, look, reach_m);
            if score > 0.0 {
                found.push(Stand { q, X_WO, X_DO: *X_DO, score });
            }
        }
        found
    }

    /// Postures that see an object at `p_WO` from all sides of its normal.
    fn about(
        &self,
        p_WO: &Vector3<f64>,
        R_WO: Option<UnitQuaternion<f64>>,
        look: Look,
        X_DO: &Pose,
    ) -> Vec<Stand<N>> {
        let search = self.posture();
        let mut random = Random::new(12);
        let rotation = R_WO.unwrap_or_else(|| {
            let level = (p_WO - self.down * self.down.dot(p_WO)).try_normalize(1e-9);
            let z = match look {
                Look::Level => level.unwrap_or(Vector3::x()),
                Look::Up => -self.down,
                Look::Down | Look::Any => self.down,
            };
            let side = if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
            let y = z.cross(&side).normalize();
            let basis = nalgebra::Matrix3::from_columns(&[y.cross(&z), y, z]);
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(basis))
        });
        let X_WO = Pose::from_parts((*p_WO).into(), rotation);
        let plate = self.config.target.plate();
        let middle = (plate.low_m + plate.high_m) * 0.5;
        let to_middle = Pose::translation(middle.x, middle.y, 0.0);
        let mut found = Vec::new();
        for roll in 0..ROLLS {
            let angle = std::f64::consts::TAU * roll as f64 / ROLLS as f64;
            // turned about the middle of the target, which stays where it is
            let turn = Pose::rotation(Vector3::z() * angle);
            let X_DO = X_DO * to_middle * turn * to_middle.inverse();
            let X_WD = X_WO * X_DO.inverse();
            for _ in 0..STARTS_EACH {
                let q = search.towards(&search.anywhere(&mut random), &X_WD);
                let off = search.X_WC(&q).inv_mul(&X_WD);
                let score = self.room(&q);
                if off.translation.vector.norm() < 1e-7 && off.rotation.angle() < 1e-7 && score > 0.0 {
                    found.push(Stand { q, X_WO, X_DO, score });
                }
            }
        }
        found
    }

    /// The direction in W in which the camera is to look; `None` where it does not matter.
    fn wanted_axis(&self, look: Look, q: &SVector<f64, N>) -> Option<Vector3<f64>> {
        let X_BE = self.arm.forward(q);
        let outwards = |p: Vector3<f64>| (p - self.down * self.down.dot(&p)).try_normalize(1e-3);
        let in_base = match look {
            Look::Down => self.down,
            Look::Up => -self.down,
            Look::Level => outwards(X_BE.translation.vector)?,
            Look::Any => return None,
        };
        // one beside the arm looks where it looks
        self.mount().is_on_arm().then_some(in_base)
    }

    /// How little the joints are turned, 0.6 to 1: of many postures with the same view people take the straight one.
    fn ease(&self, q: &SVector<f64, N>) -> f64 {
        let turned = |(limit, q): (&crate::robot::JointLimits, &f64)| {
            let middle = 0.5 * (limit.lower + limit.upper);
            (q - if middle.is_finite() { middle } else { 0.0 }).powi(2)
        };
        let sum: f64 = self.arm.limits().iter().zip(q.iter()).map(turned).sum();
        0.6 + 0.4 * (-sum / (1.2 * N as f64)).exp()
    }

    /// How far the camera gets from the base, m.
    fn reach_m(&self) -> f64 {
        let search = self.posture();
        let mut random = Random::new(13);
        let far = |_| self.arm.forward(&search.anywhere(&mut random)).translation.vector.norm();
        (0..400).map(far).fold(0.1, f64::max)
    }

    /// How much room the joints have: 0 for too little, or where a limit in space is too near, 1 for enough.
    pub(super) fn room(&self, q: &SVector<f64, N>) -> f64 {
        if self.space.as_ref().is_some_and(|space| !space.keeps_margin(q)) {
            return 0.0;
        }
        let share = |(limit, q): (&crate::robot::JointLimits, &f64)| {
            let range = limit.upper - limit.lower;
            if range.is_finite() { (q - limit.lower).min(limit.upper - q) / range } else { 1.0 }
        };
        let least = self.arm.limits().iter().zip(q.iter()).map(share).fold(1.0, f64::min);
        if least < MIN_SHARE { 0.0 } else { (least / GOOD_SHARE).min(1.0) }
    }

    /// Score of a place for the object, 0 to 1. Lengths are shares of the reach.
    fn place_score(&self, q: &SVector<f64, N>, X_WO: &Pose, look: Look, reach_m: f64) -> f64 {
        let X_BE = self.arm.forward(q);
        if !self.mount().is_on_arm() {
            // held by the hand: near to it
            return 1.0 / (1.0 + (X_WO.translation.vector.norm() / (0.1 * reach_m)).powi(2));
        }
        let (camera, object) = (self.posture().X_WC(q).translation.vector, X_WO.translation.vector);
        let up = -self.down;
        let aside = |p: &Vector3<f64>| (p - up * up.dot(p)).norm() / reach_m;
        let height = |p: &Vector3<f64>| up.dot(p) / reach_m;
        let gaussian = |x: f64, wanted: f64, width: f64| (-((x - wanted) / width).powi(2)).exp();
        // neither in the base nor at the end of its reach, not far below the base's foot, not behind
        let apart = if aside(&object) < 0.15 { 0.1 } else { 1.0 };
        let reach = gaussian(aside(&camera), 0.5, 0.3).max(0.05);
        let low = if height(&object) < -0.3 { 0.3 } else { 1.0 };
        let high = gaussian(height(&camera), 0.35, 0.5).max(0.05);
        let front = X_BE.translation.x / X_BE.translation.vector.norm().max(1e-9);
        // the arm is not between the camera and what it looks at
        let sight = (object - camera).normalize();
        let outwards = if look == Look::Down { 0.0 } else { sight.dot(&camera.normalize()) };
        apart * reach * low * high * (0.6 + 0.4 * front) * (0.75 + 0.25 * outwards) * self.ease(q)
    }
}
