//! One loop of the study: an arm that obeys at once or lags, vision that is late, lost, wrongly stamped or wrong in depth.

use crate::experiment::cell::{POINTS, project};
use crate::experiment::schemes::Scheme;
use crate::experiment::{Cell, ExperimentError};
use crate::geometry::{Pose, rotation_angle};
use crate::messages::{FeaturePoint, Measurement, TargetStatus};
use crate::scene::{FrameSchedule, Irregularity};
use crate::servo::{
    Gain, Interaction, Law, Mount, OperationalSpace, OrientationError, ServoSettings, SetPoint, UpdatePolicy,
    VisualServo, Wish, pose_gains_4,
};
use crate::time::{MonoNs, SpanNs};
use nalgebra::{Point3, Vector4};
use std::collections::VecDeque;

/// Gains looked at, 1/s.
pub(super) const GAINS_1_S: (f64, f64) = (0.5, 4000.0);
pub(super) const TICK_S: f64 = 1e-3;
const RATE_HZ: f64 = 25.0;
const TICKS: usize = 6000;
/// Where a run starts, off the goal: rad and m.
const OFFSET: f64 = 5e-3;
const SETTLED: f64 = 0.02;

/// What is not as the loop believes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbance {
    /// By how much exposure stamps are late, ms.
    pub stamp_error_ms: i64,
    /// Measured depths, the desired one included, as multiples of the true ones: the target has another size.
    pub depth_scale: f64,
    /// Frames are late by up to this beside the delay, ms.
    pub jitter_ms: usize,
    /// Share of the frames that are lost.
    pub loss: f64,
    /// Of which frames these are.
    pub seed: u64,
}

impl Disturbance {
    /// Everything is as believed.
    pub const NONE: Self = Self { stamp_error_ms: 0, depth_scale: 1.0, jitter_ms: 0, loss: 0.0, seed: 0 };
}

/// A loop to be studied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loop {
    /// B or D.
    pub scheme: Scheme,
    /// When the law is computed.
    pub update: UpdatePolicy,
    /// From exposure to use, ms.
    pub delay_ms: usize,
    /// Lag of the joints behind their reference rate, s; 0 for the ideal arm. `predict` is told of it.
    pub lag_s: f64,
    /// What is wrong.
    pub disturbance: Disturbance,
}

/// The law of scheme B or D with one gain for everything.
fn law(scheme: Scheme, gain_1_s: f64) -> Law {
    let gain = Gain::Constant(gain_1_s);
    match scheme {
        Scheme::A | Scheme::B => Law::PositionVelocity {
            K: pose_gains_4(&[1.0; 4]),
            gain,
            orientation: OrientationError::EulerZyx,
            space: OperationalSpace::Six,
        },
        Scheme::C | Scheme::D | Scheme::Hybrid => {
            Law::ImageVelocity { gain, interaction: Interaction::TEXTBOOK }
        }
    }
}

fn scaled(pose: &Pose, scale: f64) -> Pose {
    let mut scaled = *pose;
    scaled.translation.vector *= scale;
    scaled
}

impl Loop {
    /// The loop with another disturbance.
    #[must_use]
    pub fn disturbed(self, disturbance: Disturbance) -> Self {
        Self { disturbance, ..self }
    }

    fn schedule(&self) -> FrameSchedule {
        let Disturbance { jitter_ms, loss, seed, .. } = self.disturbance;
        let ms = |ms: usize| SpanNs(ms as i64 * 1_000_000);
        FrameSchedule::new(RATE_HZ, ms(self.delay_ms), Irregularity { jitter: ms(jitter_ms), loss, seed })
    }

    fn servo(&self, cell: &Cell, gain_1_s: f64) -> Result<VisualServo<4>, ExperimentError> {
        let scale = self.disturbance.depth_scale;
        let points = POINTS.map(|p| Point3::from(p.coords * scale));
        let goal = SetPoint::from_pose(&scaled(&cell.X_DO, scale), &points)
            .and_then(|goal| goal.with_selection(self.scheme.selection()))
            .ok_or_else(|| ExperimentError::Cell {
                cause: "the desired pose does not show the points".into(),
            })?;
        let mount = Mount::EyeInHand { X_EC: Pose::identity() };
        let mut settings = ServoSettings::new(law(self.scheme, gain_1_s), goal, self.update, mount);
        settings.lead = SpanNs((self.lag_s * 1e9).round() as i64);
        Ok(VisualServo::new(settings))
    }

    fn measure(&self, cell: &Cell, q: &Vector4<f64>, now: MonoNs) -> Option<Measurement> {
        let X_CO = cell.X_CO(q);
        let s = project(&X_CO)?;
        let exposure = now + SpanNs(self.disturbance.stamp_error_ms * 1_000_000);
        let mut m = Measurement { exposure, feature_count: 4, ..Measurement::default() };
        m.status = TargetStatus::Found as u32;
        for (f, s) in m.features.iter_mut().zip(s) {
            *f = FeaturePoint { x: s.x, y: s.y, ..FeaturePoint::default() };
        }
        m.set_pose(&scaled(&X_CO, self.disturbance.depth_scale));
        Some(m)
    }

    /// The error (distance in m plus angle in rad) at every tick; it ends early when the run does.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`].
    pub fn run(&self, cell: &Cell, gain_1_s: f64) -> Result<Vec<f64>, ExperimentError> {
        let schedule = self.schedule();
        let mut servo = self.servo(cell, gain_1_s)?;
        let mut q = cell.joints(&cell.goal()?.x_c)? + Vector4::repeat(OFFSET);
        let mut qd = Vector4::zeros();
        let follow = if self.lag_s > 0.0 { 1.0 - (-TICK_S / self.lag_s).exp() } else { 1.0 };
        let mut under_way = VecDeque::new();
        let mut errors = Vec::with_capacity(TICKS);
        for k in 0..TICKS as u64 {
            let now = MonoNs(k as i64 * 1_000_000);
            let X_DC = cell.X_DO * cell.X_CO(&q).inverse();
            let e = X_DC.translation.vector.norm() + rotation_angle(&X_DC.rotation.to_rotation_matrix());
            errors.push(e);
            if !(e < 1.0) {
                break; // far out: unstable
            }
            servo.note_arm(now, &q, &qd);
            if let Some(frame) = schedule.frame_at(k).filter(|id| !schedule.is_lost(*id)) {
                match self.measure(cell, &q, now) {
                    Some(m) => under_way.push_back((schedule.usable_tick(frame), m)),
                    None => break,
                }
            }
            while let Some((_, m)) = under_way.pop_front_if(|(due, _)| *due <= k) {
                servo.take(now, &m, &cell.arm);
            }
            let reference = match servo.wish(&q, &qd, &cell.arm) {
                Some(Wish::Velocity(reference)) => reference,
                Some(Wish::Torque(_)) | None => Vector4::zeros(),
            };
            qd += (reference - qd) * follow;
            q += qd * TICK_S;
        }
        Ok(errors)
    }

    /// Whether errors die out at this gain.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`].
    pub fn is_stable(&self, cell: &Cell, gain_1_s: f64) -> Result<bool, ExperimentError> {
        let errors = self.run(cell, gain_1_s)?;
        let greatest = |part: &[f64]| part.iter().copied().fold(0.0, f64::max);
        let quarter = TICKS / 4;
        Ok(errors.len() == TICKS
            && match (errors.get(..quarter), errors.get(TICKS - quarter..)) {
                (Some(first), Some(last)) => greatest(last) < 0.5 * greatest(first),
                _ => false,
            })
    }

    /// The largest stable gain, 1/s, to half a percent.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`].
    pub fn largest_stable_gain(&self, cell: &Cell) -> Result<f64, ExperimentError> {
        let (mut stable, mut unstable) = GAINS_1_S;
        if self.is_stable(cell, unstable)? {
            return Ok(unstable);
        }
        while unstable / stable > 1.005 {
            let middle = (stable * unstable).sqrt();
            if self.is_stable(cell, middle)? { stable = middle } else { unstable = middle }
        }
        Ok(stable)
    }

    /// The 2 % settling time at this gain, s; `None` where it does not settle.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`].
    pub fn settling_time(&self, cell: &Cell, gain_1_s: f64) -> Result<Option<f64>, ExperimentError> {
        Ok(settling_time(&self.run(cell, gain_1_s)?))
    }
}

fn settling_time(errors: &[f64]) -> Option<f64> {
    let band = SETTLED * errors.first()?;
    let inside = errors.iter().rev().take_while(|e| **e <= band).count();
    (errors.len() == TICKS && inside > 0).then(|| (TICKS - inside) as f64 * TICK_S)
}
