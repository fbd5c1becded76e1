//! How the image Jacobian of an unknown cell is learnt and used: first by a gentle motion, then on the way to the goal, and by the motion again where what is
//! known does not lead on.
//!
//! ```text
//! Feel ──► Learn ──► Approach ──┬─► goal
//!  1 s, 2 mrad  2 s, 20 px      └─► Learn: the error does not fall, or M is too uncertain in the directions that are left
//! ```
//! `Feel` moves each joint by so little that no lens and no lever arm carries a target out of the image, and tells how far the joints may go in `Learn`. A motion
//! that was interrupted, that the arm did not make or that too few frames showed is done again.

use super::learning_motion::{LearningMotion, amplitude, fastest_rad_s};
use super::{CautiousTask, JacobianEstimator, SetPoint};
use crate::geometry::Pose;
use crate::linalg::symmetric_eigen;
use crate::messages::{MAX_FEATURES, Measurement};
use crate::robot::{CameraJacobian, JointLimits};
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::{SMatrix, SVector, Vector2};

/// Amplitude of the first motion, rad or m. Chosen by hand: at half a metre from the target a lens of 800 px shows 2 px of it, at 2 m and with half of that lens half a
/// pixel, some ten times the noise; a lever arm of a metre makes 5 px of it.
const FEEL: f64 = 2e-3;
/// Its duration, and that of the motion of which M is learnt: 25 and 50 frames of a camera at 25 Hz for seven numbers a coordinate. Chosen by hand.
const FEEL_SPAN: SpanNs = SpanNs(1_000_000_000);
const LEARN_SPAN: SpanNs = SpanNs(2_000_000_000);
/// Frames that a motion must have been seen in: twice the seven unknown numbers.
const FRAMES: u32 = 14;
/// Share of their amplitudes that the joints must have moved in the mean: less is an arm that stood or was held. Chosen by hand, and not varied.
const MOVED: f64 = 0.3;
/// How far the image may move in `Learn`, px, with all parts of the motion at their ends at once, which they are not. Chosen by hand: 3 px of each of seven parts, in 50 frames, are
/// some hundred times the noise. With 40 px, and joints that might move faster, two xArm7 of 200 cells ended because a joint did not follow.
const IMAGE_PX: f64 = 20.0;
/// The same as a share of the room to the border of the image, so that the target stays in it.
const ROOM_SHARE: f64 = 0.5;
/// Largest part of a joint's amplitude, rad or m. Chosen by hand.
const MAX_AMPLITUDE: f64 = 0.05;
/// Largest speed of a joint, rad/s or m/s, with all parts at their fastest. Derived: within 0.4 s a joint goes at most two thirds of it, so that one that sticks a while, as light
/// wrists do where they turn back, is not taken for one that does not follow (from 0.02 rad on, `control/safety/arm.rs`). With twice of it 2 of 200 runs ended so.
const MAX_SPEED: f64 = 0.075;
/// Largest part of the camera's motion, rad or shares of the target's distance. Chosen by hand: half of the square of it, by which the image bends, is below half a pixel.
const MAX_MOTION: f64 = 0.03;
/// Motion of the camera by a unit of the joints below which they do not move it: of a redundant arm. Chosen by hand far above rounding and far below any lever arm.
const STILL: f64 = 1e-3;
/// Share of the distance to the end of its range that a joint may go.
const RANGE_SHARE: f64 = 0.5;
/// Time without progress after which the arm learns again. Chosen by hand: under a gain of 2 1/s an error falls to a fiftieth in it.
const PATIENCE: SpanNs = SpanNs(2_000_000_000);
/// Share of the least error so far below which an error is progress. Chosen by hand: noise at a pixel does not reach a fifth, and a gain of 0.2 1/s would within [`PATIENCE`].
const PROGRESS: f64 = 0.8;
/// Share of the error that a step leaves from which on M is too uncertain for the directions that are left, and for how long. Chosen by hand.
const HARDLY: f64 = 0.6;
const HARDLY_FOR: SpanNs = SpanNs(300_000_000);
/// Motions in a row that may bring nothing. Chosen by hand.
const MAX_FUTILE: u32 = 8;

/// What is known of camera and goal beside the run's other settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimationSettings {
    /// Focal lengths of the lens as it is believed, px: the unit of normalized coordinates.
    pub f_px: Vector2<f64>,
    /// Size of the image, px.
    pub size_px: Vector2<f64>,
    /// Feature error below which the goal is reached, px: there the arm does not learn again.
    pub tolerance_px: f64,
}

/// What the arm does at a tick.
#[allow(clippy::large_enum_variant)] // one at a time, and no memory is taken in a tick
#[derive(Debug, Clone, Copy)]
pub(super) enum LearnerStep<const N: usize> {
    /// Moves as this, rad/s or m/s, to learn.
    Learn(SVector<f64, N>),
    /// Goes to the goal by this task.
    Approach(CautiousTask),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LearningStage {
    Feel,
    Learn,
}

#[derive(Debug, Clone, Copy)]
enum LearnerPhase<const N: usize> {
    /// A motion begins with the next tick.
    Begins(LearningStage),
    Moves {
        stage: LearningStage,
        motion: LearningMotion<N>,
        q_begin: SVector<f64, N>,
        moved: SVector<f64, N>,
        frames: u32,
    },
    Approaches,
}

/// Estimator, phase, and the watch over progress.
#[derive(Debug, Clone)]
pub(super) struct JacobianLearner<const N: usize> {
    settings: EstimationSettings,
    estimator: JacobianEstimator,
    phase: LearnerPhase<N>,
    /// Distance of the outermost point from the border of the image, px.
    room_px: f64,
    /// Root mean square error of the last frame, px.
    error_px: f64,
    /// The least error of this approach, and when it was.
    best: Option<(f64, MonoNs)>,
    /// Since when M has been too uncertain.
    hardly_since: Option<MonoNs>,
    /// Error when the last motion began, px, and motions since it was last halved.
    error_at_motion_px: f64,
    futile: u32,
    /// Whether what is known has not led on, so that it is not trusted at the next motion.
    doubts: bool,
}

impl<const N: usize> JacobianLearner<N> {
    pub(super) fn new(settings: EstimationSettings, points: usize) -> Self {
        Self {
            settings,
            estimator: JacobianEstimator::new(points),
            phase: LearnerPhase::Begins(LearningStage::Feel),
            room_px: 0.0,
            error_px: f64::INFINITY,
            best: None,
            hardly_since: None,
            error_at_motion_px: f64::INFINITY,
            futile: 0,
            doubts: false,
        }
    }

    pub(super) fn estimator(&self) -> &JacobianEstimator {
        &self.estimator
    }

    /// Another goal: progress is measured anew. Of `other` points nothing is known.
    pub(super) fn begin_anew(&mut self, other: bool) {
        (self.best, self.hardly_since, self.futile) = (None, None, 0);
        self.error_at_motion_px = f64::INFINITY;
        if other {
            self.estimator.forget();
            self.phase = LearnerPhase::Begins(LearningStage::Feel);
        }
    }

    /// The arm does not move by the law at this tick: a motion is done again from its beginning.
    pub(super) fn interrupt(&mut self) {
        if let LearnerPhase::Moves { stage, .. } = self.phase {
            self.phase = LearnerPhase::Begins(stage);
        }
        (self.best, self.hardly_since) = (None, None);
    }

    /// Takes in a frame, with the joints at `q` and the camera at `X_WC` at its exposure. Whether it fits.
    pub(super) fn note_frame(
        &mut self,
        m: &Measurement,
        set_point: &SetPoint,
        (q, X_WC): (&SVector<f64, N>, &Pose),
    ) -> bool {
        let f_px = self.settings.f_px;
        let place = |id: u64| set_point.ids().binary_search_by_key(&id, |id| u64::from(*id)).ok();
        let seen = m
            .features()
            .iter()
            .filter_map(|f| Some((place(f.id)?, Vector2::new(f.x, f.y), f.sd_px / f_px.min())));
        let taken = self.estimator.observe(seen, X_WC).taken;
        if !taken {
            return false;
        }
        let size_px = self.settings.size_px;
        let rooms = m.features().iter().filter(|f| place(f.id).is_some());
        self.room_px = rooms
            .map(|f| f.u_px.min(f.v_px).min(size_px.x - 1.0 - f.u_px).min(size_px.y - 1.0 - f.v_px))
            .fold(f64::INFINITY, f64::min);
        if let LearnerPhase::Moves { moved, frames, q_begin, .. } = &mut self.phase {
            *frames += 1;
            *moved = moved.zip_map(&(q - *q_begin), |most, now| f64::max(most, now.abs()));
        }
        self.watch(m.exposure, set_point, X_WC);
        true
    }

    /// Watches the error of a frame on the way to the goal.
    fn watch(&mut self, now: MonoNs, set_point: &SetPoint, X_WC: &Pose) {
        let (mut sum, mut count) = (0.0, 0.0);
        for i in set_point.selection().points().take(MAX_FEATURES) {
            if let (Some(s), Some(s_d)) = (self.estimator.predicted(i, X_WC), set_point.features().get(i)) {
                sum += (s_d - s).component_mul(&self.settings.f_px).norm_squared();
                count += 1.0;
            }
        }
        self.error_px = f64::sqrt(sum / count);
        if !matches!(self.phase, LearnerPhase::Approaches) {
            return;
        }
        if self.error_px <= self.settings.tolerance_px {
            (self.best, self.hardly_since) = (None, None);
            return;
        }
        match self.best {
            Some((best, since)) if self.error_px > PROGRESS * best => {
                if now - since > PATIENCE {
                    self.doubts = true;
                    self.learn_again();
                }
            }
            _ => self.best = Some((self.error_px, now)),
        }
    }

    /// Takes in which share of the error the next step leaves, at `now`.
    pub(super) fn note_share_left(&mut self, now: MonoNs, share: f64) {
        if !(share > HARDLY && self.error_px > self.settings.tolerance_px) {
            self.hardly_since = None;
        } else if now - *self.hardly_since.get_or_insert(now) > HARDLY_FOR {
            self.learn_again();
        }
    }

    fn learn_again(&mut self) {
        (self.best, self.hardly_since) = (None, None);
        if self.error_px < 0.5 * self.error_at_motion_px {
            (self.futile, self.error_at_motion_px) = (0, self.error_px);
        }
        if self.futile < MAX_FUTILE {
            self.futile += 1;
            self.phase = LearnerPhase::Begins(LearningStage::Learn);
        }
    }

    /// What the arm does at this tick, with the joints at `q` within `limits`, and the camera at `X_WC` with the Jacobian `J`. `None` before a frame came.
    pub(super) fn step(
        &mut self,
        (q, limits): (&SVector<f64, N>, &[JointLimits; N]),
        (X_WC, J): (&Pose, &CameraJacobian<N>),
        set_point: &SetPoint,
    ) -> Option<LearnerStep<N>> {
        if let LearnerPhase::Begins(stage) = self.phase {
            let motion = match stage {
                LearningStage::Feel => {
                    LearningMotion::new(within(SMatrix::identity() * FEEL, q, limits), FEEL_SPAN)
                }
                LearningStage::Learn => {
                    LearningMotion::new(within(self.parts(J, set_point, X_WC), q, limits), LEARN_SPAN)
                }
            };
            self.estimator.hold_anchor(std::mem::take(&mut self.doubts));
            let moved = SVector::zeros();
            self.phase = LearnerPhase::Moves { stage, motion, q_begin: *q, moved, frames: 0 };
        }
        if let LearnerPhase::Moves { stage, motion, moved, frames, .. } = &mut self.phase {
            if !motion.is_over() {
                return Some(LearnerStep::Learn(motion.advance(TICK)));
            }
            let has_moved = moved.sum() >= MOVED * motion.amplitude().sum();
            if !has_moved || *frames < FRAMES {
                self.phase = LearnerPhase::Begins(*stage);
                return self.step((q, limits), (X_WC, J), set_point);
            }
            if *stage == LearningStage::Feel {
                self.phase = LearnerPhase::Begins(LearningStage::Learn);
                return self.step((q, limits), (X_WC, J), set_point);
            }
            self.estimator.release_anchor();
            self.phase = LearnerPhase::Approaches;
        }
        self.estimator.task(set_point, X_WC).map(LearnerStep::Approach)
    }

    /// The parts of the motion `Learn`: the principal directions of the cautious normal matrix in the joints, each as far as the image moves or may move by it. So the
    /// directions in which the image hardly moves, and which decide on the last pixel, are shown as well as others.
    fn parts(&self, J: &CameraJacobian<N>, set_point: &SetPoint, X_WC: &Pose) -> SMatrix<f64, N, N> {
        let Some(task) = self.estimator.task(set_point, X_WC) else { return SMatrix::identity() * FEEL };
        let all_px = IMAGE_PX.min(ROOM_SHARE * self.room_px).max(0.0);
        let points = set_point.selection().points().count() as f64;
        let part = all_px / N as f64 / self.settings.f_px.max() * points.sqrt();
        let matrix = J.matrix().tr_mul(&(task.task.matrix * J.matrix()));
        let Some((squares, directions)) = symmetric_eigen(&matrix) else { return SMatrix::identity() * FEEL };
        let parts = SMatrix::<f64, N, N>::from_fn(|i, slow| {
            // the far ones, of small squares, are the slow ones
            let k = N - 1 - slow;
            let direction = directions.column(k);
            let motion = self.estimator.motion(&(J.matrix() * direction));
            // What moves the joints and not the camera shows nothing.
            if !(motion > STILL) {
                return 0.0;
            }
            let far = (part / squares[k].max(0.0).sqrt()).min(MAX_MOTION / motion);
            direction[i] * far.min(MAX_AMPLITUDE / direction.amax())
        });
        let speed =
            |i: usize| (0..N).map(|k| parts[(i, k)].abs() * fastest_rad_s(k, LEARN_SPAN)).sum::<f64>();
        let fastest = (0..N).map(speed).fold(0.0, f64::max);
        if fastest > MAX_SPEED { parts * (MAX_SPEED / fastest) } else { parts }
    }
}

/// Parts that keep each joint well within its range.
fn within<const N: usize>(
    parts: SMatrix<f64, N, N>,
    q: &SVector<f64, N>,
    limits: &[JointLimits; N],
) -> SMatrix<f64, N, N> {
    let amplitude = amplitude(&parts);
    let rows = SVector::<f64, N>::from_fn(|i, _| {
        let room = limits.get(i).map_or(0.0, |limit| (q[i] - limit.lower).min(limit.upper - q[i]));
        let share = (RANGE_SHARE * room / amplitude[i]).clamp(0.0, 1.0);
        if share.is_nan() { 0.0 } else { share }
    });
    SMatrix::from_diagonal(&rows) * parts
}
