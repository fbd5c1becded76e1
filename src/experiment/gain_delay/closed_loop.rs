//! One loop of the study: an arm that obeys at once or lags, vision that is late, lost, wrongly stamped or wrong in depth.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

use crate::experiment::cell::POINTS;
use crate::experiment::schemes::Scheme;
use crate::experiment::{Cell, ExperimentError};
use crate::geometry::{Pose, rotation_angle};
use crate::messages::Measurement;
use crate::robot::Mount;
use crate::scene::{FrameSchedule, Irregularity};
use crate::servo::{
    Gain, Interaction, Law, LawOutput, OperationalSpace, OrientationError, ServoSettings, SetPoint,
    TwistWeights, UpdatePolicy, VisualServo, pose_gains_4,
};
use crate::sim::{self, ClosedLoop, perfect_measurement};
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::{Point3, Vector4};
use std::ops::ControlFlow::{self, Break, Continue};

/// Gains looked at, 1/s.
pub(super) const GAINS_1_S: (f64, f64) = (0.5, 4000.0);
pub(super) const TICK_S: f64 = 1e-3;
const RATE_HZ: f64 = 25.0;
const TICKS: usize = 6000;
/// Where a run starts, off the goal: rad and m.
const OFFSET: f64 = 5e-3;
/// Band about the goal, as a share of the first error, for the settling times: the usual 2 % of textbooks on control.
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
pub struct DelayedLoop {
    /// B or D.
    pub scheme: Scheme,
    /// When the law is computed.
    pub update: UpdatePolicy,
    /// From exposure to use, ms.
    pub delay_ms: usize,
    /// Lag of the joints behind their reference rate, s; 0 for the ideal arm. `predict` compensates it.
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
            weights: TwistWeights::Unit,
        },
        Scheme::C | Scheme::D | Scheme::Hybrid => {
            Law::ImageVelocity { K_s: 1.0.into(), gain, interaction: Interaction::TEXTBOOK }
        }
    }
}

fn scaled(pose: &Pose, scale: f64) -> Pose {
    let mut scaled = *pose;
    scaled.translation.vector *= scale;
    scaled
}

impl DelayedLoop {
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
        let mut settings = ServoSettings::new(law(self.scheme, gain_1_s), self.update, mount);
        settings.lead = SpanNs((self.lag_s * 1e9).round() as i64);
        Ok(VisualServo::new(settings, goal))
    }

    /// The error (distance in m plus angle in rad) at every tick; it ends early when the run does.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`].
    pub fn run(&self, cell: &Cell, gain_1_s: f64) -> Result<Vec<f64>, ExperimentError> {
        let mut at_work = AtWork {
            cell,
            disturbance: self.disturbance,
            servo: self.servo(cell, gain_1_s)?,
            q: cell.joints(&cell.goal()?.x_c)? + Vector4::repeat(OFFSET),
            qd: Vector4::zeros(),
            follow: if self.lag_s > 0.0 { 1.0 - (-TICK_S / self.lag_s).exp() } else { 1.0 },
            errors: Vec::with_capacity(TICKS),
        };
        sim::run(&self.schedule(), &mut at_work);
        Ok(at_work.errors)
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

/// The loop while it runs, until it is far out.
struct AtWork<'a> {
    cell: &'a Cell,
    disturbance: Disturbance,
    servo: VisualServo<4>,
    q: Vector4<f64>,
    qd: Vector4<f64>,
    /// Share of the way to its reference rate that a joint goes in a tick.
    follow: f64,
    errors: Vec<f64>,
}

fn time(tick: u64) -> MonoNs {
    MonoNs(TICK.0 * tick as i64)
}

impl ClosedLoop for AtWork<'_> {
    type Observation = Measurement;
    type Outcome = ();

    fn sense(&mut self, tick: u64) -> ControlFlow<()> {
        let X_DC = self.cell.X_DO * self.cell.X_CO(&self.q).inverse();
        let e = X_DC.translation.vector.norm() + rotation_angle(&X_DC.rotation.to_rotation_matrix());
        self.errors.push(e);
        self.servo.note_arm(time(tick), &self.q, &self.qd);
        // Far out is unstable; the comparison also catches NaN.
        if e < 1.0 { Continue(()) } else { Break(()) }
    }

    fn see(&mut self, tick: u64, _: u64) -> ControlFlow<(), Measurement> {
        let Disturbance { stamp_error_ms, depth_scale, .. } = self.disturbance;
        let exposure = time(tick) + SpanNs(stamp_error_ms * 1_000_000);
        let X_CO = self.cell.X_CO(&self.q);
        let Some(mut m) = perfect_measurement(&POINTS, &X_CO, exposure) else { return Break(()) };
        m.set_pose(&scaled(&X_CO, depth_scale));
        Continue(m)
    }

    fn act(&mut self, tick: u64, seen: Option<Measurement>) -> ControlFlow<()> {
        if let Some(m) = seen {
            self.servo.add_measurement(time(tick), &m, &self.cell.arm);
        }
        let reference = match self.servo.law_output(&self.q, &self.qd, &self.cell.arm) {
            Some(LawOutput::Velocity(reference)) => reference,
            Some(LawOutput::Torque(_)) | None => Vector4::zeros(),
        };
        self.qd += (reference - self.qd) * self.follow;
        self.q += self.qd * TICK_S;
        if self.errors.len() == TICKS { Break(()) } else { Continue(()) }
    }
}

fn settling_time(errors: &[f64]) -> Option<f64> {
    let band = SETTLED * errors.first()?;
    let inside = errors.iter().rev().take_while(|e| **e <= band).count();
    (errors.len() == TICKS && inside > 0).then(|| (TICKS - inside) as f64 * TICK_S)
}
