//! Whether the image moves as the arm's motion should make it, judged over the first motion, and over that of each further start until it was seen to.
//!
//! A camera that is mounted turned about its optical axis, by more than a quarter, or with other axes than the believed one, turns each law away from its goal, and the faster
//! the farther it gets. From the last view before the arm moves, the arm's motion `X` of the believed camera leads to one view, and that of a camera that is turned by `R` to
//! another:
//!
//! ```text
//! X(R) = R^-1 X R
//! ```
//! The same of an image in which left and right, or above and below, are exchanged: there `R` is a reflection.
//! Where one of the latter is seen and the former is not, whatever the depth is, the mount is wrong, unless a camera that is only mounted askew shows it, too ([`strain`]): then the arm moves it a little the
//! other way, without a turn, and the two motions together tell ([`probe`]). Errors of stamps look like none of them, nor does an object that moves: where the
//! features moved while the arm stood, the believed camera may explain the image with that motion going on, too. An object that goes twice as fast as the arm that follows it would look like a camera
//! that is turned by 180 degrees otherwise. Where an arm began to move with its first view nothing is known of that: it pauses then, and what moves before a camera that stands is the object.
//! Once the mount agrees, or where nothing explains what was seen, the [`lens`] is judged.

mod lens;
mod probe;
mod strain;
mod wrong_mount;

use super::{SetPoint, View};
use crate::geometry::Pose;
use crate::time::{MonoNs, SpanNs};
use lens::LensWatch;
use nalgebra::Vector3;
use probe::{MountProbe, MountProbeResult};
use strain::{SeenMotion, is_credible};
pub use wrong_mount::CameraError;
use wrong_mount::wrong_mounts;

/// Displacement of the features from which on they are judged, root mean square, normalized coordinates: a pixel of a lens of 800 px, fifteen times the noise of a dot, which leaves 1 % of its square. Chosen by hand:
/// a camera half a metre before its target has gone 0.6 mm by then.
const JUDGED: f64 = 0.00125;
/// Factor by which the displacement has grown when a wrong mount is seen for the second time, and believed: an object that begins to move and is followed looks like a camera that is turned by 180
/// degrees while the arm has gone half of its way, and not before or after. Computed: what an arm with a lag of first order has gone grows by 1.66 while that explains all but [`EXPLAINED_BY_ERROR`].
const GROWN: f64 = 2.0;
/// Share of [`JUDGED`] up to which the arm has not moved yet since a view, and the least age of that view when it is given up for a newer one. Chosen by hand: a quarter of a pixel within 50 ms is
/// a tenth of the speed at which a camera half a metre before its target is in its first motion.
const STANDS: f64 = 0.25;
const STANDS_FOR: SpanNs = SpanNs(50_000_000);
/// Displacement of the camera below which the image stands however the camera is mounted, m and rad: a third of [`JUDGED`] at 0.4 m. Where it moves by [`JUDGED`] all the same, the object does, and no
/// mount is judged: an object that goes twice as fast as the first motion looks like a camera that is turned by 180 degrees for as long as both last. Chosen by hand.
const STILL_M: f64 = 1e-4;
const STILL: f64 = 2e-4;
/// For how long two views before an arm that pauses must show the same image until its mount is wrong, and the longest pause, after which it is, too. Derived: an object that looks like a wrong mount is about
/// as fast as the first motion, and is displaced by [`JUDGED`] in a fifth of the former at 0.4 m; the latter leaves a camera at 5 Hz two views after an arm that brakes for 0.4 s.
const PAUSED_FOR: SpanNs = SpanNs(100_000_000);
const LONGEST_PAUSE: SpanNs = SpanNs(1_000_000_000);
/// Displacement from which on it is judged no more, in units of [`JUDGED`]. Chosen by hand: by then a contradiction was seen in several frames.
const GIVEN_UP: f64 = 64.0;
/// Share of the square of the displacement that may be left where a camera is believed: another is left by turns of 15 degrees. Chosen by hand: that is what a description may be off by, and still be believed.
const EXPLAINED: f64 = 0.06;
/// The same of a wrong mount: 10 degrees beside the true turn. Chosen by hand, for a lens or a size that is off by a few percent besides.
const EXPLAINED_BY_ERROR: f64 = 0.03;
/// Depths that are tried with the believed camera, as powers of this of the believed one, and how many on either side: from a seventh to seven times. Chosen by hand: a target that is believed a fifth
/// or five times as large as it is moves the image by its turns otherwise than by its translations, which a turned camera explains better than the believed one with the believed depth.
const DEPTH_STEP: f64 = 1.19;
const DEPTHS: i32 = 11;
/// Share of what the believed camera leaves that a turned one may leave. Chosen by hand.
const BETTER: f64 = 0.1;
/// What is known of the mount.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum MountJudgement {
    #[default]
    Open,
    /// The image was seen to move as it should.
    Agrees,
    /// This motion tells nothing more of it.
    GivenUp,
    Wrong(CameraError),
}

/// A view, when it was exposed, and where the camera was then.
#[derive(Debug, Clone, Copy)]
struct Sighting {
    exposure: MonoNs,
    view: View,
    X_WC: Pose,
}

impl Sighting {
    /// Without the depths of a pose nothing can be foretold from what is left of a target.
    fn foretells(&self) -> bool {
        self.view.X_CO().is_some() || !self.view.is_partial()
    }
}

/// What was seen while the arm stood.
#[derive(Debug, Clone, Copy)]
struct Standing {
    /// The last view before the arm moved.
    last: Sighting,
    /// One between [`STANDS_FOR`] and twice that before the last; the first one before there is such a one.
    before: Sighting,
    /// The one that takes the place of `before`.
    next: Sighting,
}

/// An arm that waits to see whether the object moves by itself.
#[derive(Debug, Clone, Copy)]
struct Pause {
    /// How the mount is wrong otherwise.
    error: CameraError,
    /// The exposure of the view after which it pauses.
    since: MonoNs,
    /// The first view from where the arm stands.
    first: Option<Sighting>,
}

/// Compares the first motion of the image with that of the arm.
#[derive(Debug, Clone, Default)]
pub(super) struct MotionAgreement {
    /// Whether the arm stands while it is to ([`Self::pauses`]).
    may_pause: bool,
    pause: Option<Pause>,
    /// Whether the arm moves as it is to ([`Self::probe_velocity`]).
    may_probe: bool,
    probe: Option<MountProbe>,
    /// Whether the law moves the arm.
    moves: bool,
    standing: Option<Standing>,
    /// What was seen once, and the displacement at that time.
    suspicion: Option<(CameraError, f64)>,
    judgement: MountJudgement,
    lens: LensWatch,
}

impl MotionAgreement {
    /// A comparison for an arm that `may_pause` and make motions of its own: one whose law gives velocities.
    pub(super) fn new(may_pause: bool) -> Self {
        Self { may_pause, may_probe: may_pause, ..Self::default() }
    }

    /// The same for an arm that goes by another law, too.
    pub(super) fn without_probes(self) -> Self {
        Self { may_probe: false, ..self }
    }

    /// The same before anything was seen.
    pub(super) fn anew(&self) -> Self {
        Self { may_pause: self.may_pause, may_probe: self.may_probe, ..Self::default() }
    }

    /// Whether the arm is to stand, so that the motion of the object is seen.
    pub(super) fn pauses(&self) -> bool {
        self.pause.is_some()
    }

    /// Whether the arm is to move as it is told here, to try the mount.
    pub(super) fn probes(&self) -> bool {
        self.probe.is_some()
    }

    /// The same to try the lens.
    pub(super) fn tries_lens(&self) -> bool {
        self.lens.probes()
    }

    /// The velocity, m/s, and the angular velocity, rad/s, that a camera at `X_WC` is to have in its own frame in place of what the law gives it.
    pub(super) fn probe_twist_C(&mut self, X_WC: &Pose) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let turn_C = self.lens.angular_velocity_C(X_WC).map(|turn_C| (Vector3::zeros(), turn_C));
        let way_C = |probe: &mut MountProbe| X_WC.rotation.inverse_transform_vector(&probe.velocity(X_WC));
        self.probe.as_mut().map(|probe| (way_C(probe), Vector3::zeros())).or(turn_C)
    }

    /// The arm cannot turn the camera as it is told here.
    pub(super) fn cannot_turn(&mut self) {
        self.lens.end();
    }

    /// The law moves the arm from now on.
    pub(super) fn begin(&mut self) {
        self.moves = true;
    }

    /// The law does not move the arm: what is not settled is judged anew when it does, since the object may be put elsewhere meanwhile. Returns whether it is not settled.
    pub(super) fn interrupt(&mut self) -> bool {
        if self.judgement == MountJudgement::Agrees && self.error().is_none() {
            self.lens.interrupt();
            return false;
        }
        self.lens = LensWatch::default();
        (self.moves, self.suspicion, self.judgement) = (false, None, MountJudgement::Open);
        (self.pause, self.probe) = (None, None);
        true
    }

    /// Takes in a view measured at `exposure`, with the pose of the camera at that time in the frame in which the object rests.
    pub(super) fn note(&mut self, exposure: MonoNs, view: &View, X_WC: &Pose, set_point: &SetPoint) {
        let now = Sighting { exposure, view: *view, X_WC: *X_WC };
        let judges_mount = !self.is_judged() && !self.lens.probes();
        let is_open = judges_mount && self.judge_mount(now, set_point);
        // Where nothing explains what was seen the lens may do so.
        let may_be_lens = is_open || self.lens.probes() || self.judgement == MountJudgement::Agrees;
        if let (true, true, Some(standing)) = (may_be_lens, self.moves, &self.standing) {
            self.lens.note(&standing.last, now, self.may_probe, set_point);
        }
    }

    /// Judges the mount, and returns whether neither the believed camera nor one whose mount is wrong explains what was seen.
    fn judge_mount(&mut self, now: Sighting, set_point: &SetPoint) -> bool {
        let Sighting { exposure, view, X_WC } = now;
        let foretells = now.foretells();
        if let Some(pause) = &mut self.pause {
            if let Some(judgement) = pause.judge(now, set_point) {
                (self.judgement, self.pause) = (judgement, None);
            }
            return false;
        }
        if let Some(probe) = &mut self.probe {
            let error = probe.error();
            if let Some(result) = probe.judge(now, set_point) {
                self.probe = None;
                match result {
                    MountProbeResult::Askew => self.judgement = MountJudgement::Agrees,
                    MountProbeResult::Wrong => self.judgement = MountJudgement::Wrong(error),
                    MountProbeResult::Unknown => self.accuse(error, exposure),
                }
            }
            return false;
        }
        let standing = match &mut self.standing {
            Some(standing) if self.moves => *standing,
            standing => {
                if foretells {
                    Standing::note(standing, now);
                }
                return false;
            }
        };
        let Sighting { exposure: since, view: base, X_WC: X_WB } = standing.last;
        let X_CB = X_WC.inv_mul(&X_WB);
        let Some(FeatureMotion { moved, seen, left }) = feature_motion(&base, &X_CB, &view, set_point) else {
            return false;
        };
        if is_still(&X_CB) && seen > JUDGED {
            self.judgement = MountJudgement::GivenUp;
            return false;
        }
        if moved < STANDS * JUDGED {
            if foretells && exposure - since >= STANDS_FOR {
                Standing::note(&mut self.standing, now);
            }
            return false;
        }
        let object = standing.motion_until(exposure);
        if moved.max(seen) < JUDGED || seen < STANDS * JUDGED {
            self.give_up(moved);
            return true;
        }
        let is_explained = |left: f64| left < EXPLAINED * seen * seen;
        // Mostly the believed camera explains all.
        if is_explained(left) {
            self.judgement = MountJudgement::Agrees;
            return false;
        }
        // Translations count by their share of the depth.
        let of_depth = |k: i32| {
            let mut X_CB = X_CB;
            X_CB.translation.vector *= DEPTH_STEP.powi(k);
            let Some(predicted) = base.predicted_at(&X_CB, set_point) else { return left };
            let resting = OwnMotion { before: &base, times: 0.0 };
            let explained = [resting, object.unwrap_or(resting)]
                .map(|object| feature_motion_beside(&base, &predicted, &view, object));
            explained.into_iter().flatten().map(|motion| motion.left).fold(left, f64::min)
        };
        let left = (-DEPTHS..=DEPTHS).map(of_depth).fold(left, f64::min);
        let least = wrong_mounts().filter_map(|(mount, error)| {
            let motion = feature_motion(&base, &mount.motion(&X_CB), &view, set_point)?;
            Some((motion.left, mount, error))
        });
        let best = least.min_by(|(a, ..), (b, ..)| a.total_cmp(b));
        let most = (BETTER * left).min(EXPLAINED_BY_ERROR * seen * seen);
        let sure = best.filter(|(turned, ..)| *turned < most);
        let seen_now = sure.and_then(|(_, mount, error)| Some((mount, error?)));
        match (self.suspicion, seen_now) {
            (Some((before, at)), Some((mount, error))) if before == error => {
                if moved >= GROWN * at {
                    let first = SeenMotion { base, X_CB, view };
                    let may_be_askew = self.may_probe && is_credible(&[first], set_point);
                    let suspect = (mount, error);
                    self.probe =
                        may_be_askew.then(|| MountProbe::new(suspect, first, &now, set_point)).flatten();
                    if self.probe.is_none() {
                        self.accuse(error, exposure);
                    }
                    return false;
                }
            }
            // A view that nothing explains, as by a measurement that leaps, says nothing of what was seen before it.
            (Some(_), None) if !is_explained(left) => {}
            (_, seen_now) => self.suspicion = seen_now.map(|(_, error)| (error, moved)),
        }
        if seen_now.is_none() && is_explained(left) {
            self.judgement = MountJudgement::Agrees;
        } else {
            self.give_up(moved);
        }
        self.suspicion.is_none() && seen_now.is_none()
    }

    /// The mount is wrong, unless it is the object that moves: where nothing is known of that after a view at `exposure`, the arm pauses.
    fn accuse(&mut self, error: CameraError, exposure: MonoNs) {
        let knows_nothing = self.standing.is_some_and(|standing| standing.shows_no_motion());
        if self.may_pause && knows_nothing {
            self.pause = Some(Pause { error, since: exposure, first: None });
        } else {
            self.judgement = MountJudgement::Wrong(error);
        }
    }

    /// Judges no more, once the features should have moved far.
    fn give_up(&mut self, moved: f64) {
        if moved > GIVEN_UP * JUDGED {
            self.judgement = MountJudgement::GivenUp;
        }
    }

    /// How the camera's mount or lens is wrong; `None` where it is not, and before that is judged.
    pub(super) fn error(&self) -> Option<CameraError> {
        match self.judgement {
            MountJudgement::Wrong(error) => Some(error),
            _ => self.lens.error(),
        }
    }

    /// Whether the image was seen to move as the arm's motion should make it, or it is judged no more.
    pub(super) fn is_judged(&self) -> bool {
        self.judgement != MountJudgement::Open
    }
}

impl Pause {
    /// Takes in a view of an arm that pauses, and judges when it is known whether the object moves.
    fn judge(&mut self, now: Sighting, set_point: &SetPoint) -> Option<MountJudgement> {
        let is_wrong = Some(MountJudgement::Wrong(self.error));
        if now.exposure - self.since > LONGEST_PAUSE {
            return is_wrong;
        }
        let Some(first) = self.first.filter(|first| is_still(&now.X_WC.inv_mul(&first.X_WC))) else {
            self.first = Some(now);
            return None;
        };
        let motion = feature_motion(&first.view, &Pose::identity(), &now.view, set_point)?;
        if motion.seen > JUDGED {
            return Some(MountJudgement::GivenUp);
        }
        is_wrong.filter(|_| now.exposure - first.exposure >= PAUSED_FOR)
    }
}

impl Standing {
    /// Takes in a view before the arm moves.
    fn note(standing: &mut Option<Standing>, now: Sighting) {
        *standing = Some(match *standing {
            None => Standing { last: now, before: now, next: now },
            Some(Standing { before, next, .. })
                if before.exposure == next.exposure || now.exposure - next.exposure >= STANDS_FOR =>
            {
                Standing { last: now, before: next, next: now }
            }
            Some(standing) => Standing { last: now, ..standing },
        });
    }

    /// Whether there is but one view, so that nothing is known of the object's motion.
    fn shows_no_motion(&self) -> bool {
        self.last.exposure == self.before.exposure
    }

    /// The motion of the object that was seen in the last two views, if it goes on until `exposure`; `None` where the camera moved between them, and where there are no two.
    fn motion_until(&self, exposure: MonoNs) -> Option<OwnMotion<'_>> {
        let span = self.last.exposure - self.before.exposure;
        let times = (exposure - self.last.exposure).as_s() / span.as_s();
        (span > SpanNs::ZERO && is_still(&self.last.X_WC.inv_mul(&self.before.X_WC)))
            .then_some(OwnMotion { before: &self.before.view, times })
    }
}

/// The motion of an object: so many times that from `before` to the last view before the arm moved.
#[derive(Clone, Copy)]
struct OwnMotion<'a> {
    before: &'a View,
    times: f64,
}

/// Whether an image stands where the camera goes by `X_CB`.
fn is_still(X_CB: &Pose) -> bool {
    X_CB.translation.vector.norm() < STILL_M && X_CB.rotation.angle() < STILL
}

/// How the features have moved since another view: mean squares over them, normalized coordinates.
struct FeatureMotion {
    /// How far the camera's motion should have moved them, and how far they have; root mean squares.
    moved: f64,
    seen: f64,
    /// Mean square of the difference.
    left: f64,
}

/// The motion from `base` to `view` beside the one that a camera makes that goes by `X_CB`; `None` without common features.
fn feature_motion(base: &View, X_CB: &Pose, view: &View, set_point: &SetPoint) -> Option<FeatureMotion> {
    let resting = OwnMotion { before: base, times: 0.0 };
    feature_motion_beside(base, &base.predicted_at(X_CB, set_point)?, view, resting)
}

/// The motion from `base` to `view` beside that to `predicted`, and what the object adds to the latter by its own motion.
fn feature_motion_beside(
    base: &View,
    predicted: &View,
    view: &View,
    object: OwnMotion<'_>,
) -> Option<FeatureMotion> {
    let (mut moved, mut seen, mut left, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (i, s) in view.seen() {
        if let (Some(at), Some(there), Some(before)) =
            (base.feature(i), predicted.feature(i), object.before.feature(i))
        {
            moved += (there - at).norm_squared();
            seen += (s - at).norm_squared();
            left += (s - there - (at - before) * object.times).norm_squared();
            count += 1.0;
        }
    }
    (count > 0.0).then(|| FeatureMotion {
        moved: (moved / count).sqrt(),
        seen: (seen / count).sqrt(),
        left: left / count,
    })
}

#[cfg(test)]
mod tests;
