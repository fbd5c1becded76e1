//! The target changes between two goals: nothing that was measured of the old one says anything about the new one. From where each of them was last seen
//! whole is kept, so that the arm can go back there when it is looked for again.

use super::VisualServo;
use crate::servo::first_motion::FirstMotion;
use crate::servo::{MeasurementVerdict, ObjectMotion};
use nalgebra::{Point3, SVector, Vector3};

/// Most targets of a run. Chosen by hand: each takes the memory of a finder, a few megabytes for a VGA camera, and a cell has a part, a place and a bin.
pub const MAX_TARGETS: usize = 16;
/// A posture that is farther than this from an earlier one, rad or m, shows the image elsewhere. Chosen by hand: 0.6 m before a target it is 12 mm, 16 px of a
/// lens with 800 px. With half of it a target may be cut off by the image's border again when the arm has come back to within a milliradian; the double only
/// makes the way longer.
const ELSEWHERE: f64 = 0.02;
/// An arm that moves by less than this from one view to the next, rad or m, rests. Chosen by hand: at 25 Hz a few hundredths of a radian in a second.
const RESTS: f64 = 1e-3;
/// Views of an arm at rest after which it stays where it is when the target is lost: it had it in view there for as long. Chosen by hand: a fifth of a second at 25 Hz.
const RESTING_VIEWS: u32 = 5;
/// So many measurements of another target that none of it was used of say that it is out of view. Chosen by hand: a single frame may be lost to a passing
/// shadow, and three are 120 ms at 25 Hz, in which the arm brakes anyway.
pub(super) const MISSES: u32 = 3;

/// The middle of `points`, m.
pub(super) fn centre(points: &[Point3<f64>]) -> Point3<f64> {
    let sum: Vector3<f64> = points.iter().map(|p| p.coords).sum();
    Point3::from(sum / points.len().max(1) as f64)
}

/// From where a target was seen whole, rad or m.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenWhole<const N: usize> {
    newest: SVector<f64, N>,
    /// How many views in a row, the newest included, were taken by an arm that hardly moved.
    resting: u32,
    /// A posture near the newest one, and one at which the arm was before, at least [`ELSEWHERE`] from it: where the newest is at the border of the view,
    /// that lies within.
    near: SVector<f64, N>,
    within: SVector<f64, N>,
    /// The first one since the law began: from there another way may be tried.
    first: Option<SVector<f64, N>>,
    /// The middle of the target then, in the frame W in which it rests, m; `None` without a pose.
    place: Option<Point3<f64>>,
}

impl<const N: usize> SeenWhole<N> {
    fn at(q: SVector<f64, N>) -> Self {
        Self { newest: q, resting: 1, near: q, within: q, first: None, place: None }
    }

    fn note(&mut self, q: SVector<f64, N>, place: Option<Point3<f64>>) {
        self.place = place;
        self.first.get_or_insert(q);
        let rests = (q - self.newest).amax() < RESTS;
        self.resting = if rests { self.resting.saturating_add(1) } else { 1 };
        self.newest = q;
        if (q - self.near).amax() > ELSEWHERE {
            (self.within, self.near) = (self.near, q);
        }
    }
}

impl<const N: usize> VisualServo<N> {
    /// Forgets all that was seen: view, depths, and the motion of the object. What is kept concerns the arm and the camera: the joint history, whether the image
    /// was seen to move as the mount says, and from where each target was seen.
    pub(super) fn forget_target(&mut self) {
        (self.last, self.whole, self.initial) = (None, None, None);
        (self.held, self.start, self.drift, self.fresh) = (None, None, None, false);
        self.sought = Some(0);
        self.object = self.settings.object.map(ObjectMotion::new);
        if self.agreement.interrupt() {
            (self.agreement, self.first_motion) = (self.agreement.anew(), FirstMotion::default());
        }
    }

    /// Takes in what became of a measurement of the goal's target.
    pub(super) fn note_sought(&mut self, verdict: MeasurementVerdict) {
        self.sought = self.sought.filter(|_| !verdict.is_used()).map(|misses| misses.saturating_add(1));
    }

    /// Whether a goal of another target was set, of which no measurement was used yet, or none since it is looked for again.
    #[must_use]
    pub fn looks_for_another(&self) -> bool {
        self.sought.is_some()
    }

    /// The goal's target is looked for as after its goal was set, until a measurement of it is used.
    pub fn look_for_it_again(&mut self) {
        self.sought.get_or_insert(0);
    }

    /// Whether the newest measurement says that such a target is out of view, and it was never seen whole: nobody knows where it is.
    #[must_use]
    pub fn knows_no_place(&self) -> bool {
        self.sought.is_some_and(|misses| misses >= MISSES) && self.posture_seen_whole().is_none()
    }

    /// From where the goal's target was seen whole, rad or m: where the arm rested when it lost it, or else a posture shortly before the last one, at which the target may have been at the
    /// image's border.
    pub(super) fn posture_seen_whole(&self) -> Option<SVector<f64, N>> {
        let seen = self.q_whole.get(self.goal.target() as usize)?.as_ref()?;
        let stays = seen.resting >= RESTING_VIEWS && !self.looks_for_another();
        Some(if stays { seen.newest } else { seen.within })
    }

    /// From where the goal's target was first seen whole since the law began, rad or m.
    pub(super) fn posture_first_seen_whole(&self) -> Option<SVector<f64, N>> {
        self.q_whole.get(self.goal.target() as usize)?.as_ref()?.first
    }

    /// The law begins from where the arm is.
    pub(crate) fn begin_here(&mut self) {
        self.q_whole.iter_mut().flatten().for_each(|seen| seen.first = None);
    }

    /// Where the middle of the goal's target was when it was last seen whole, in the frame W in which it rests, m, and a posture from which it was seen, rad or m.
    pub(crate) fn seen_place(&self) -> Option<(Point3<f64>, SVector<f64, N>)> {
        let seen = self.q_whole.get(self.goal.target() as usize)?.as_ref()?;
        Some((seen.place?, seen.within))
    }

    /// The goal's target was seen whole from the posture `q`, rad or m, its middle at `place` in W, m.
    pub(super) fn seen_whole_at(&mut self, q: &SVector<f64, N>, place: Option<Point3<f64>>) {
        if let Some(seen) = self.q_whole.get_mut(self.goal.target() as usize) {
            seen.get_or_insert_with(|| SeenWhole::at(*q)).note(*q, place);
        }
    }
}
