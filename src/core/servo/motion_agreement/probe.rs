//! A small motion that tells a camera which is mounted askew from one whose mount is wrong.
//!
//! While the arm moves along one straight screw, a turn of 20 degrees, a lever arm and a lens that are not as told move the image as a camera does that is turned by a quarter. Without a turn of the camera they do
//! not: a translation `t` in the plane of the image is seen along `E^-1 t`, within 20 degrees of where it should be, and along `R^-1 t` by a camera whose mount is wrong. So the camera is moved back about where
//! it came from, by as much as moves the image by two pixels, and the description has to explain both motions by one error ([`strain`]). Back, since that does not take the arm farther from where it began,
//! and since the target was in view there.

use super::strain::{SeenMotion, is_credible};
use super::wrong_mount::{CameraError, WrongMount};
use super::{JUDGED, SetPoint, Sighting, View, feature_motion};
use crate::geometry::Pose;
use crate::servo::first_motion::REACH_M;
use crate::time::{MonoNs, SpanNs};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Displacement of the features from which on the motion is judged, root mean square, normalized. Measured: half of it told all of 72 drawn wrong mounts from all that were askew, with noise of 0.05 px.
const PROBED: f64 = 2.0 * JUDGED;
/// Factor on the way that leads there, since lens and depth may be off. Chosen by hand: a depth that is off by half.
const FARTHER: f64 = 1.5;
/// Longest way, m. Derived: that of a target at 2.5 m.
const LONGEST_WAY_M: f64 = 0.01;
/// Speed of the camera, m/s, where the first motion is not slower still. Derived: the default of `servo.first_motion_m_s`.
const SPEED_M_S: f64 = 0.04;
/// Longest time, after which the mount is wrong as it was believed to be before. Chosen by hand: an arm that needs a second to turn back leaves a camera at 5 Hz five views.
const LONGEST: SpanNs = SpanNs(2_000_000_000);
/// Directions that are tried, in a whole turn. Chosen by hand: one is always within 22 degrees of the best.
const DIRECTIONS: u8 = 8;
/// Step by which they are compared, m. Chosen by hand: what a target at 0.4 m is judged by.
const STEP_M: f64 = 1e-3;
/// Share of what the best direction tells that another one has to tell. Chosen by hand: about an axis across the optical one it is the next direction beside the best.
const AS_TELLING: f64 = 0.8;
/// Least share of the camera's motion that is along the asked direction. Chosen by hand: 37 degrees beside it.
const AS_ASKED: f64 = 0.8;
/// Share of the square of the displacement, as seen or as it should be, that a wrong mount may leave. Measured: drawn ones left up to 0.26 of what was seen, those with other axes 0.65, which is less of what should be, and askew ones
/// 1.1 and more; a measurement that leaps is neither.
const LEFT_BY_ERROR: f64 = 0.6;

/// What such a motion has told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MountProbeResult {
    /// The camera is mounted askew, so that the laws find their goals.
    Askew,
    /// It is as it was believed to be: an object that moves by itself would not have turned back with the camera.
    Wrong,
    /// Nothing: the arm could not move so, or what it saw is explained by neither.
    Unknown,
}

/// A motion that is under way.
#[derive(Debug, Clone, Copy)]
pub(super) struct MountProbe {
    mount: WrongMount,
    error: CameraError,
    /// The motion after which nobody can tell.
    first: SeenMotion,
    /// Where the camera was at its begin, and the exposure at its end.
    X_WB: Pose,
    since: MonoNs,
    /// Unit vector of the motion in the frame in which the object rests, and its length, m.
    direction_W: Vector3<f64>,
    way_m: f64,
    /// Where along the direction the camera has turned back, m.
    turned_at_m: f64,
    /// The view that is nearest to there.
    from: Option<Sighting>,
    /// What the last view has told.
    told: Option<MountProbeResult>,
}

impl MountProbe {
    /// A probe from the end of the motion `first`, where the camera was at `now`, of a suspected mount, which is told as an error. `None` where no motion tells anything.
    pub(super) fn new(
        (mount, error): (WrongMount, CameraError),
        first: SeenMotion,
        now: &Sighting,
        set_point: &SetPoint,
    ) -> Option<Self> {
        // The way from the base to the camera, in its own frame.
        let gone = -first.X_CB.translation.vector;
        let all = || directions().filter_map(|d| Some((d, told_by(&first.view, &d, &mount, set_point)?)));
        let most = all().map(|(_, (tells, _))| tells).fold(0.0, f64::max);
        let (direction, (_, moved)) = all()
            .filter(|(_, (tells, _))| *tells >= AS_TELLING * most)
            .min_by(|(a, _), (b, _)| a.dot(&gone).total_cmp(&b.dot(&gone)))?;
        Some(Self {
            mount,
            error,
            first,
            X_WB: now.X_WC * first.X_CB,
            since: now.exposure,
            direction_W: now.X_WC.rotation * direction,
            way_m: (FARTHER * PROBED * STEP_M / moved).min(LONGEST_WAY_M),
            turned_at_m: f64::INFINITY,
            from: None,
            told: None,
        })
    }

    /// How the mount is wrong, if it is.
    pub(super) fn error(&self) -> CameraError {
        self.error
    }

    /// The velocity of a camera at `X_WC`, m/s.
    pub(super) fn velocity(&mut self, X_WC: &Pose) -> Vector3<f64> {
        let at_m = self.along(X_WC);
        self.turned_at_m = self.turned_at_m.min(at_m);
        if at_m - self.turned_at_m < self.way_m { self.direction_W * SPEED_M_S } else { Vector3::zeros() }
    }

    fn along(&self, X_WC: &Pose) -> f64 {
        X_WC.translation.vector.dot(&self.direction_W)
    }

    /// Takes in a view, and tells when two in a row say the same: one alone may be of a measurement that leaps.
    pub(super) fn judge(&mut self, now: Sighting, set_point: &SetPoint) -> Option<MountProbeResult> {
        if now.exposure - self.since > LONGEST {
            return Some(MountProbeResult::Unknown);
        }
        // What is seen before the camera turns back says nothing new.
        let from = match self.from {
            Some(from) if self.along(&from.X_WC) <= self.along(&now.X_WC) => from,
            _ => {
                self.from = now.foretells().then_some(now);
                return None;
            }
        };
        let told = self.told_by_motion(&from, &now, set_point);
        let before = std::mem::replace(&mut self.told, told);
        told.filter(|told| before == Some(*told))
    }

    /// What the motion between two views tells, together with the first one.
    fn told_by_motion(
        &self,
        from: &Sighting,
        now: &Sighting,
        set_point: &SetPoint,
    ) -> Option<MountProbeResult> {
        let way_m = self.along(&now.X_WC) - self.along(&from.X_WC);
        let X_CB = now.X_WC.inv_mul(&from.X_WC);
        let motion_m = X_CB.translation.vector.norm().hypot(X_CB.rotation.angle() * REACH_M);
        let second = SeenMotion { base: from.view, X_CB, view: now.view };
        let extent = second.extent(set_point)?;
        if extent < PROBED || way_m < AS_ASKED * motion_m {
            return None;
        }
        // From before the first motion to now: without it a view that leaps would stand for where the camera turned back.
        let since_base =
            SeenMotion { base: self.first.base, X_CB: now.X_WC.inv_mul(&self.X_WB), view: now.view };
        if is_credible(&[self.first, second, since_base], set_point) {
            return Some(MountProbeResult::Askew);
        }
        let motion = feature_motion(&second.base, &self.mount.motion(&X_CB), &second.view, set_point)?;
        (motion.left < LEFT_BY_ERROR * extent * extent).then_some(MountProbeResult::Wrong)
    }
}

/// Directions in the plane of the image.
fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..DIRECTIONS).map(|k| {
        let (sin, cos) = (TAU * f64::from(k) / f64::from(DIRECTIONS)).sin_cos();
        Vector3::new(cos, sin, 0.0)
    })
}

/// How far apart the believed camera and one with another `mount` see the features of a view after a [`STEP_M`] in a direction, as a share of their motion; and how far they should move, root mean square.
fn told_by(
    view: &View,
    direction: &Vector3<f64>,
    mount: &WrongMount,
    set_point: &SetPoint,
) -> Option<(f64, f64)> {
    let X = Pose::new(-direction * STEP_M, Vector3::zeros());
    let believed = view.predicted_at(&X, set_point)?;
    // What is seen by the other one, beside what should be.
    let motion = feature_motion(view, &mount.motion(&X), &believed, set_point)?;
    let tells = motion.left.sqrt() / motion.moved.max(motion.seen);
    (motion.seen > 0.0).then_some((tells, motion.seen))
}

#[cfg(test)]
pub(super) mod tests;
