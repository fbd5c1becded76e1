//! The synthetic camera: renders the image of a camera that is mounted eye-in-hand or eye-to-hand, from the arm's true motion.

use super::{ArmHistory, FrameSchedule, Occluder, Renderer, SceneMotion};
use crate::faults::ImageDamage;
use crate::geometry::Pose;
use crate::messages::JointState;
use crate::robot::Mount;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::Point3;

/// Most sub-exposures of one frame, since each costs a rendering. Chosen: what moves by more than eight pixels in an exposure is drawn in steps.
const MAX_SUB_EXPOSURES: usize = 16;
/// A sub-exposure for so many pixels of motion, so that edges differ by less than the blur of a good lens.
const PX_PER_SUB_EXPOSURE: f64 = 0.5;

/// One exposure that is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposure {
    /// Counts exposures from 0.
    pub frame_id: u64,
    /// Its middle.
    pub mid: MonoNs,
    /// Its length.
    pub span: SpanNs,
}

/// Renders frames.
pub struct SyntheticCamera<const N: usize> {
    history: ArmHistory<N>,
    renderer: Renderer,
    mount: Mount,
    /// Where each target is at the first tick, and how it moves from there; the first one is that of the renderer.
    objects: Vec<(Pose, SceneMotion)>,
    occluders: Vec<Occluder>,
    /// Time of tick 0: what the scene's motion counts from.
    origin: Option<MonoNs>,
    motion_blur: bool,
    views: Vec<Pose>,
    /// Whether any of several targets moves.
    is_in_motion: bool,
    /// The further targets in the frame of the first one at each of the views, where some of the targets move.
    further: Vec<Pose>,
    /// When frames are exposed, and the faults of their images; `None` where they have none.
    damage: Option<(FrameSchedule, ImageDamage)>,
    /// Middle of the last exposure as it is stamped.
    stamped: MonoNs,
}

impl<const N: usize> SyntheticCamera<N> {
    /// A camera at `mount` and the arm of `history`; `objects` are the places of the targets at the first tick in the base or, seen from beside the arm,
    /// on the flange, the renderer's own first, each with its motion.
    #[must_use]
    pub fn new(
        history: ArmHistory<N>,
        renderer: Renderer,
        mount: Mount,
        objects: impl IntoIterator<Item = (Pose, SceneMotion)>,
        occluders: Vec<Occluder>,
        motion_blur: bool,
    ) -> Self {
        let views = Vec::with_capacity(MAX_SUB_EXPOSURES);
        let objects: Vec<_> = objects.into_iter().collect();
        let is_in_motion = objects.iter().any(|(_, motion)| *motion != SceneMotion::Still);
        let further = Vec::with_capacity(MAX_SUB_EXPOSURES * objects.len());
        Self {
            history,
            renderer,
            mount,
            objects,
            occluders,
            origin: None,
            motion_blur,
            views,
            is_in_motion,
            further,
            damage: None,
            stamped: MonoNs::ZERO,
        }
    }

    /// The same with the faults of the frames of `schedule`.
    #[must_use]
    pub fn with_faults(self, schedule: FrameSchedule) -> Self {
        Self { damage: Some((schedule, ImageDamage::new(schedule.faults()))), ..self }
    }

    /// The middle of the last exposure that the camera knows: of a frame that is a duplicate that of the one before.
    #[must_use]
    pub fn stamped(&self) -> MonoNs {
        self.stamped
    }

    /// The target of this number in the camera; the first one, `offset` after the middle of the exposure.
    fn view(&self, number: usize, exposure: &Exposure, offset: SpanNs) -> Pose {
        let time = exposure.mid + offset;
        self.history.X_WC(&self.mount, time).inv_mul(&self.object(number, time))
    }

    /// Where the target of this number is at `time`, in the frame in which it rests.
    fn object(&self, number: usize, time: MonoNs) -> Pose {
        let since = self.since(time);
        self.objects.get(number).map_or_else(Pose::identity, |(X_WO, motion)| motion.object_at(X_WO, since))
    }

    /// Since tick 0.
    fn since(&self, time: MonoNs) -> SpanNs {
        self.origin.map_or(SpanNs(0), |origin| SpanNs((time - origin).0.max(0)))
    }

    /// How far the target moves in the image during the exposure, px; 0 where a part of it is not in front.
    fn motion_px(&self, exposure: &Exposure) -> f64 {
        let half = SpanNs(exposure.span.0 / 2);
        let camera = self.renderer.camera();
        let ends = |number| (self.view(number, exposure, SpanNs(-half.0)), self.view(number, exposure, half));
        let travel = |(before, after): &(Pose, Pose), p_O| {
            Some((camera.project(&(after * p_O))? - camera.project(&(before * p_O))?).norm())
        };
        let first = ends(0);
        let own = self.renderer.target().points().iter().filter_map(|point| travel(&first, point.p_O));
        // Of a target that moves by itself its origin stands for it: it is a few of its sizes away at most.
        let moves = |number: &usize| {
            self.objects.get(*number).is_some_and(|(_, motion)| *motion != SceneMotion::Still)
        };
        let further = (1..self.objects.len())
            .filter(moves)
            .filter_map(|number| travel(&ends(number), Point3::origin()));
        own.chain(further).fold(0.0, f64::max)
    }

    /// Takes a state of the arm that carries the camera, or the target.
    pub fn arm(&mut self, state: &JointState) {
        self.origin = Some(state.stamp - SpanNs(TICK.0.saturating_mul(state.tick as i64)));
        self.history.push(state);
    }

    /// Renders `exposure` into `out`, one byte a pixel, row by row.
    pub fn expose(&mut self, exposure: &Exposure, out: &mut [u8]) {
        let count = if self.motion_blur && exposure.span.0 > 0 {
            ((self.motion_px(exposure) / PX_PER_SUB_EXPOSURE).ceil() as usize).clamp(1, MAX_SUB_EXPOSURES)
        } else {
            1
        };
        self.views.clear();
        self.further.clear();
        for i in 0..count {
            // Middles of equal parts of the exposure.
            let share = (i as f64 + 0.5) / count as f64 - 0.5;
            let offset = SpanNs((share * exposure.span.0 as f64).round() as i64);
            let view = self.view(0, exposure, offset);
            self.views.push(view);
            if self.is_in_motion {
                let X_OW = self.object(0, exposure.mid + offset).inverse();
                for number in 1..self.objects.len() {
                    let X_WT = self.object(number, exposure.mid + offset);
                    self.further.push(X_OW * X_WT);
                }
            }
        }
        let since = self.since(exposure.mid);
        self.renderer.occlude(self.occluders.iter().filter(|occluder| occluder.is_there(since)).copied());
        self.renderer.render_moving(&self.views, &self.further, exposure.frame_id, out);
        self.stamped = exposure.mid;
        if let Some((schedule, damage)) = &mut self.damage {
            let frame = (exposure.frame_id, schedule.exposure(exposure.frame_id));
            let width = self.renderer.camera().intrinsics().width_px as usize;
            self.stamped = damage.apply(frame, exposure.mid, width, out);
        }
    }
}
