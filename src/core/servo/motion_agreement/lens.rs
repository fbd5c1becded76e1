//! A small turn of the camera that tells a lens which is not as told from a target that is.
//!
//! A target that moves in the image as if it were twice as near may be half as large as it is told, or seen by a lens that is twice as long. While the camera is moved along, and turned about, its optical axis both
//! look alike. A turn about an axis across it moves all of the image by `f` times its angle, however far the target is: so the arm stands, turns the camera by a third of a degree about its own centre, stands, and
//! turns it back. Both turns have to be explained by one lens: an object that moves by itself does not turn back with the camera.

use super::strain::{CREDIBLE, NOISE, OF_LENS, SeenMotion, explained, told_but_for};
use super::{CameraError, FeatureMotion, JUDGED, SetPoint, Sighting, feature_motion, is_still};
use crate::geometry::Pose;
use crate::servo::first_motion::{REACH_M, WAY_M};
use crate::time::{MonoNs, SpanNs};
use nalgebra::{Vector2, Vector3};

/// Displacement of the features from which on the lens is judged, in units of [`JUDGED`]: what is moved by less is noise to a seventh. Chosen by hand: a lens that is half as long shows half as much.
const SHOWN: f64 = 0.5;
/// Share of the square of the displacement which the believed camera leaves from which on the lens is judged. Chosen by hand: what is less is no reason to compute anything.
const SHOWS: f64 = 0.01;
/// What noise may leave besides. Derived: the noise of a dot of both views in both coordinates is four squares of it; twice as much is left by one view in ten thousand.
const BY_NOISE: f64 = 8.0 * NOISE * NOISE;
/// Factor of the focal length by which one that is wrong is tried, as a logarithm. Chosen by hand: half and twice the length.
const TRIED: f64 = std::f64::consts::LN_2;
/// By how much less strain it has to explain what was seen. Measured, of 100 draws of UR5, Panda and xArm7 each: with 1, 0.5 and 0.25 lenses of half and twice the length are tried in 87, 93 and 94, cameras that are askew
/// by up to 20 degrees, 5 cm and 30 % of the focal length in 3, 7 and 13, and right descriptions in none.
const FALLS: f64 = 0.25;
/// Strain up to which a lens is tried. Chosen by hand: two deviations; a mount that is wrong takes three and more.
const LIKELY: f64 = 4.0;
/// Factor from which on a focal length is wrong, as a logarithm. Chosen by hand: laws have to converge with lenses that are off by 30 %, and to be stopped with those of half and twice the length; between the two.
const WRONG: f64 = 0.47;
/// Factor which that of a wrong one surely exceeds, as a logarithm. Derived: 1.3, up to which laws have to converge.
const ALLOWED: f64 = 0.262;
/// How surely, in standard deviations. Measured: of 400 drawn cells with a lens of twice the length 371 are told, of 4000 whose lens is up to 30 % off none (348 of the former with 3, before only [likely](LIKELY) ones were tried).
const SURE: f64 = 2.5;
/// Angle of the turn, rad. Derived: 4.8 px of a lens of 800 px, half of that of one that is half as long, fifty times the noise of a dot; the flange goes 0.6 mm if it is 0.1 m from the camera.
const TURN: f64 = 0.006;
/// Share of the angle within which the camera has arrived. Chosen by hand: what it has turned is measured.
const ARRIVED: f64 = 0.2;
/// Angular velocity at most, rad/s. Derived: it moves the image as the slow first motion of 0.04 m/s does, at 0.8 m.
const SPEED_RAD_S: f64 = 0.05;
/// Rate at which the camera arrives, 1/s. Chosen by hand: from where it is no longer at its speed it has arrived within 0.2 s.
const RATE_1_S: f64 = 12.0;
/// Longest time, after which nothing is told. Chosen by hand: a camera at 5 Hz has twelve views by then, of which six are needed.
const LONGEST: SpanNs = SpanNs(2_500_000_000);

/// What is known of the lens, once the mount agrees.
#[derive(Debug, Clone, Copy, Default)]
#[allow(clippy::large_enum_variant)] // a box would be allocated within the tick
pub(super) enum LensWatch {
    #[default]
    Open,
    /// The camera is turned a little, and back, to tell.
    Tried(LensProbe),
    /// It may be right, or it is judged no more.
    Over,
    Wrong(CameraError),
}

impl LensWatch {
    /// Takes in a view of a moving arm, whose last one before it moved was `base`.
    pub(super) fn note(&mut self, base: &Sighting, now: Sighting, may_probe: bool, set_point: &SetPoint) {
        match self {
            Self::Tried(probe) => match probe.judge(now, set_point) {
                Some(Some(error)) => *self = Self::Wrong(error),
                Some(None) => *self = Self::Over,
                None => {}
            },
            Self::Open => *self = Self::judged(base, now, may_probe, set_point),
            Self::Over | Self::Wrong(_) => {}
        }
    }

    fn judged(base: &Sighting, now: Sighting, may_probe: bool, set_point: &SetPoint) -> Self {
        let X_CB = now.X_WC.inv_mul(&base.X_WC);
        if X_CB.translation.vector.norm() > WAY_M || X_CB.rotation.angle() > WAY_M / REACH_M {
            return Self::Over;
        }
        let shows = |m: &FeatureMotion| {
            let seen = m.moved.max(m.seen);
            seen > SHOWN * JUDGED && m.left > SHOWS * seen * seen + BY_NOISE
        };
        if !feature_motion(&base.view, &X_CB, &now.view, set_point).is_some_and(|m| shows(&m)) {
            return Self::Open;
        }
        let motion = SeenMotion { base: base.view, X_CB, view: now.view };
        let strain = |focal: f64| {
            explained(&[motion], told_but_for(focal), set_point).map_or(f64::INFINITY, |least| least.strain)
        };
        let by_lens = strain(TRIED).min(strain(-TRIED));
        if by_lens > LIKELY || by_lens + FALLS > strain(0.0) {
            return Self::Open;
        }
        match lens_told(&[motion], set_point) {
            Some(Some(error)) => Self::Wrong(error),
            Some(None) if may_probe => Self::Tried(LensProbe::new(motion, now.exposure)),
            _ => Self::Open,
        }
    }

    /// Whether the camera is to turn as it is told here.
    pub(super) fn probes(&self) -> bool {
        matches!(self, Self::Tried(_))
    }

    /// The angular velocity that a camera at `X_WC` is to have in its own frame, rad/s, without a way; `None` where it is to move as its law says.
    pub(super) fn angular_velocity_C(&self, X_WC: &Pose) -> Option<Vector3<f64>> {
        match self {
            Self::Tried(probe) => Some(probe.angular_velocity_C(X_WC)),
            _ => None,
        }
    }

    /// Judges no more, unless it is wrong.
    pub(super) fn end(&mut self) {
        if !matches!(self, Self::Wrong(_)) {
            *self = Self::Over;
        }
    }

    /// The law does not move the arm any more, whose mount agrees: a turn that is under way tells nothing.
    pub(super) fn interrupt(&mut self) {
        if self.probes() {
            *self = Self::Over;
        }
    }

    /// How the lens is wrong.
    pub(super) fn error(&self) -> Option<CameraError> {
        match self {
            Self::Wrong(error) => Some(*error),
            _ => None,
        }
    }
}

/// A turn there and back that is under way.
#[derive(Debug, Clone, Copy)]
pub(super) struct LensProbe {
    /// The motion after which nobody can tell.
    first: SeenMotion,
    since: MonoNs,
    /// Unit vector about which the camera turns, in its own frame.
    axis_C: Vector3<f64>,
    /// The last view, and those of the camera that stood, before and after the turn.
    last: Option<Sighting>,
    before: Option<Sighting>,
    turned: Option<Sighting>,
}

impl LensProbe {
    /// A probe after the motion `first`, which ended with a view exposed at `since`.
    pub(super) fn new(first: SeenMotion, since: MonoNs) -> Self {
        let features = || first.view.seen().map(|(_, s)| s);
        let centre = features().sum::<Vector2<f64>>() / features().count().max(1) as f64;
        // The way of the image is towards its middle: s' = (-w_y, w_x) there.
        let axis_C = Vector3::new(-centre.y, centre.x, 0.0).try_normalize(1e-6).unwrap_or(Vector3::x());
        Self { first, since, axis_C, last: None, before: None, turned: None }
    }

    /// The angle by which a camera at `X_WC` has turned, rad.
    fn angle(&self, X_WC: &Pose) -> f64 {
        self.before.map_or(0.0, |before| before.X_WC.inv_mul(X_WC).rotation.scaled_axis().dot(&self.axis_C))
    }

    /// The angular velocity that a camera at `X_WC` is to have in its own frame, rad/s; without a way.
    pub(super) fn angular_velocity_C(&self, X_WC: &Pose) -> Vector3<f64> {
        let to = match (self.before, self.turned) {
            (None, _) => return Vector3::zeros(),
            (_, None) => TURN,
            _ => 0.0,
        };
        let rate = RATE_1_S * (to - self.angle(X_WC));
        self.axis_C * rate.clamp(-SPEED_RAD_S, SPEED_RAD_S)
    }

    /// Takes in a view; at the end, whether the lens is wrong.
    pub(super) fn judge(&mut self, now: Sighting, set_point: &SetPoint) -> Option<Option<CameraError>> {
        if now.exposure - self.since > LONGEST {
            return Some(None);
        }
        let last = self.last.replace(now);
        if !last.is_some_and(|last| is_still(&now.X_WC.inv_mul(&last.X_WC))) || !now.foretells() {
            return None;
        }
        let angle = self.angle(&now.X_WC);
        match (self.before, self.turned) {
            (None, _) => self.before = Some(now),
            (_, None) if (angle - TURN).abs() < ARRIVED * TURN => self.turned = Some(now),
            (Some(before), Some(turned)) if angle.abs() < ARRIVED * TURN => {
                return Some(self.told_by_turns(&before, &turned, &now, set_point));
            }
            _ => {}
        }
        None
    }

    fn told_by_turns(
        &self,
        before: &Sighting,
        turned: &Sighting,
        back: &Sighting,
        set_point: &SetPoint,
    ) -> Option<CameraError> {
        let motion = |from: &Sighting, to: &Sighting| SeenMotion {
            base: from.view,
            X_CB: to.X_WC.inv_mul(&from.X_WC),
            view: to.view,
        };
        lens_told(&[self.first, motion(before, turned), motion(turned, back)], set_point)?
    }
}

/// What these motions tell of the lens: how it is wrong, or that it may be right; `None` where no lens explains them.
fn lens_told(motions: &[SeenMotion], set_point: &SetPoint) -> Option<Option<CameraError>> {
    let least = explained(motions, OF_LENS, set_point).filter(|least| least.strain < CREDIBLE)?;
    let (focal, surely) = (least.focal, SURE * least.focal_sd + ALLOWED);
    let wrong = if focal > 0.0 { CameraError::LongerLens } else { CameraError::ShorterLens };
    Some((focal.abs() > WRONG.max(surely)).then_some(wrong))
}

#[cfg(test)]
mod tests;
