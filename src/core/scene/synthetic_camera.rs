//! The synthetic camera: renders the image of a camera that is mounted eye-in-hand or eye-to-hand, from the arm's true motion.

use super::{ArmHistory, FrameSchedule, Occluder, Renderer, SceneMotion};
use crate::faults::ImageDamage;
use crate::geometry::Pose;
use crate::messages::JointState;
use crate::robot::Mount;
use crate::time::{MonoNs, SpanNs, TICK};

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
    X_WO: Pose,
    motion: SceneMotion,
    occluders: Vec<Occluder>,
    /// Time of tick 0: what the scene's motion counts from.
    origin: Option<MonoNs>,
    motion_blur: bool,
    views: Vec<Pose>,
    /// When frames are exposed, and the faults of their images; `None` where they have none.
    damage: Option<(FrameSchedule, ImageDamage)>,
    /// Middle of the last exposure as it is stamped.
    stamped: MonoNs,
}

impl<const N: usize> SyntheticCamera<N> {
    /// A camera at `mount` and the arm of `history`; the target rests at `X_WO` in the base or, seen from beside the arm,
    /// on the flange.
    #[must_use]
    pub fn new(
        history: ArmHistory<N>,
        renderer: Renderer,
        mount: Mount,
        X_WO: Pose,
        motion: SceneMotion,
        occluders: Vec<Occluder>,
        motion_blur: bool,
    ) -> Self {
        let views = Vec::with_capacity(MAX_SUB_EXPOSURES);
        Self {
            history,
            renderer,
            mount,
            X_WO,
            motion,
            occluders,
            origin: None,
            motion_blur,
            views,
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

    fn view(&self, exposure: &Exposure, offset: SpanNs) -> Pose {
        let time = exposure.mid + offset;
        let since = self.since(time);
        self.history.X_WC(&self.mount, time).inv_mul(&self.motion.object_at(&self.X_WO, since))
    }

    /// Since tick 0.
    fn since(&self, time: MonoNs) -> SpanNs {
        self.origin.map_or(SpanNs(0), |origin| SpanNs((time - origin).0.max(0)))
    }

    /// How far the target moves in the image during the exposure, px; 0 where a part of it is not in front.
    fn motion_px(&self, exposure: &Exposure) -> f64 {
        let half = SpanNs(exposure.span.0 / 2);
        let (before, after) = (self.view(exposure, SpanNs(-half.0)), self.view(exposure, half));
        let camera = self.renderer.camera();
        let travel = |p_O| Some((camera.project(&(after * p_O))? - camera.project(&(before * p_O))?).norm());
        self.renderer.target().points().iter().filter_map(|point| travel(point.p_O)).fold(0.0, f64::max)
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
        for i in 0..count {
            // Middles of equal parts of the exposure.
            let share = (i as f64 + 0.5) / count as f64 - 0.5;
            let offset = SpanNs((share * exposure.span.0 as f64).round() as i64);
            let view = self.view(exposure, offset);
            self.views.push(view);
        }
        let since = self.since(exposure.mid);
        self.renderer.occlude(self.occluders.iter().filter(|occluder| occluder.is_there(since)).copied());
        self.renderer.render(&self.views, exposure.frame_id, out);
        self.stamped = exposure.mid;
        if let Some((schedule, damage)) = &mut self.damage {
            let frame = (exposure.frame_id, schedule.exposure(exposure.frame_id));
            let width = self.renderer.camera().intrinsics().width_px as usize;
            self.stamped = damage.apply(frame, exposure.mid, width, out);
        }
    }
}
