//! How delay between exposure and use limits the gain of schemes B and D, for the update policies `frame` and `predict`.
//!
//! Vision at 25 Hz, control at 1 kHz. The arm is an ideal positioning device, (10.75), or follows the reference rate
//! with a first-order lag. With the ideal arm, T = 0.04 s and a delay of d frames, `frame` gives
//! `e[k+1] = e[k] - K T e[k-d]`: stable up to K T = 2, 1, 0.618 for d = 0, 1, 2.

use super::cell::project;
use super::outcome::Outcome;
use super::plot::{Mark, Panel, Series, figure};
use super::schemes::{Scheme, set_point};
use super::{Cell, ExperimentError, Options};
use crate::geometry::{Pose, rotation_angle};
use crate::messages::{FeaturePoint, Measurement, TargetStatus};
use crate::servo::{
    Gain, Interaction, Law, Mount, OperationalSpace, OrientationError, ServoSettings, UpdatePolicy,
    VisualServo, Wish, pose_gains_4,
};
use crate::time::MonoNs;
use nalgebra::Vector4;
use serde_json::json;
use std::collections::VecDeque;

/// Delays of the study, ms.
pub const DELAYS_MS: [usize; 3] = [0, 40, 80];
/// Lag of the second kind of arm, s.
const LAG_S: f64 = 0.02;
/// Gains looked at, 1/s.
const GAINS_1_S: (f64, f64) = (0.5, 4000.0);
const TICK_S: f64 = 1e-3;
const TICKS_PER_FRAME: usize = 40;
const TICKS: usize = 8000;
/// Where a run starts, off the goal: rad and m.
const OFFSET: f64 = 5e-3;
const SETTLED: f64 = 0.02;

/// A loop to be studied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loop {
    /// B or D.
    pub scheme: Scheme,
    /// When the law is computed.
    pub update: UpdatePolicy,
    /// From exposure to use, ms.
    pub delay_ms: usize,
    /// Lag of the joints behind their reference rate, s; 0 for the ideal arm.
    pub lag_s: f64,
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

fn measure(cell: &Cell, q: &Vector4<f64>, now: MonoNs) -> Option<Measurement> {
    let X_CO = cell.X_CO(q);
    let s = project(&X_CO)?;
    let mut m = Measurement { exposure: now, feature_count: 4, ..Measurement::default() };
    m.status = TargetStatus::Found as u32;
    for (f, s) in m.features.iter_mut().zip(s) {
        *f = FeaturePoint { x: s.x, y: s.y, ..FeaturePoint::default() };
    }
    m.set_pose(&X_CO);
    Some(m)
}

impl Loop {
    /// The error (distance in m plus angle in rad) at every tick; it ends early when the run does.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`].
    pub fn run(&self, cell: &Cell, gain_1_s: f64) -> Result<Vec<f64>, ExperimentError> {
        let goal = set_point(&cell.X_DO, self.scheme.selection())?;
        let mount = Mount::EyeInHand { X_EC: Pose::identity() };
        let settings = ServoSettings::new(law(self.scheme, gain_1_s), goal, self.update, mount);
        let mut servo = VisualServo::<4>::new(settings);
        let mut q = cell.joints(&cell.goal()?.x_c)? + Vector4::repeat(OFFSET);
        let mut qd = Vector4::zeros();
        let follow = if self.lag_s > 0.0 { 1.0 - (-TICK_S / self.lag_s).exp() } else { 1.0 };
        let mut under_way = VecDeque::new();
        let mut errors = Vec::with_capacity(TICKS);
        for k in 0..TICKS {
            let now = MonoNs(k as i64 * 1_000_000);
            let X_DC = cell.X_DO * cell.X_CO(&q).inverse();
            let e = X_DC.translation.vector.norm() + rotation_angle(&X_DC.rotation.to_rotation_matrix());
            errors.push(e);
            if !(e < 1.0) {
                break; // far out: unstable
            }
            servo.note_arm(now, &q, &qd);
            if k % TICKS_PER_FRAME == 0 {
                match measure(cell, &q, now) {
                    Some(m) => under_way.push_back((k + self.delay_ms, m)),
                    None => break,
                }
            }
            if let Some((_, m)) = under_way.front().filter(|(due, _)| *due <= k) {
                servo.take(now, m, &cell.arm);
                under_way.pop_front();
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

    /// The gain with the shortest 2 % settling time below `largest`, and that time: 1/s, s.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`].
    pub fn best_settling(&self, cell: &Cell, largest: f64) -> Result<(f64, f64), ExperimentError> {
        let mut best = (f64::NAN, f64::INFINITY);
        for i in 1..=30 {
            let gain = largest * (f64::from(i) / 30.0).powi(2);
            if let Some(settled) = settling_time(&self.run(cell, gain)?)
                && settled < best.1
            {
                best = (gain, settled);
            }
        }
        Ok(best)
    }
}

fn settling_time(errors: &[f64]) -> Option<f64> {
    let band = SETTLED * errors.first()?;
    let inside = errors.iter().rev().take_while(|e| **e <= band).count();
    (errors.len() == TICKS && inside > 0).then(|| (TICKS - inside) as f64 * TICK_S)
}

pub(super) fn gain_delay(options: &Options<'_>) -> Result<Outcome, ExperimentError> {
    let cell = Cell::textbook()?;
    let mut out = Outcome::default();
    let mut table = String::from(
        "arm,scheme,update,delay_ms,largest_stable_gain_1_s,best_gain_1_s,best_settling_time_s\n",
    );
    let mut entries = Vec::new();
    let mut limits = Panel::new("largest stable gain", "delay [ms]", "K [1/s]").log_y();
    let mut best = Panel::new("best settling time", "delay [ms]", "t [s]").log_y();
    let mut responses = Panel::new("scheme D at its best gain, lagged arm", "t [s]", "error [m + rad]");
    let updates = [(UpdatePolicy::Frame, "frame"), (UpdatePolicy::Predict, "predict")];
    for (arm, lag_s) in [("ideal", 0.0), ("lag 20 ms", LAG_S)] {
        for (i, scheme) in [Scheme::B, Scheme::D].into_iter().enumerate() {
            for (j, (update, name)) in updates.into_iter().enumerate() {
                let (mut gains, mut times) = (Vec::new(), Vec::new());
                for (k, delay_ms) in DELAYS_MS.into_iter().enumerate() {
                    (options.progress)(&format!(
                        "{arm} arm, scheme {}, {name}, {delay_ms} ms",
                        scheme.name()
                    ));
                    let studied = Loop { scheme, update, delay_ms, lag_s };
                    let largest = studied.largest_stable_gain(&cell)?;
                    let (gain, settling) = studied.best_settling(&cell, largest)?;
                    table += &format!(
                        "{arm},{},{name},{delay_ms},{largest:.3},{gain:.3},{settling:.3}\n",
                        scheme.name()
                    );
                    out.lines.push(format!(
                        "{arm:9} {:2} {name:8} {delay_ms:2} ms: stable up to {largest:7.1} 1/s{}, best {settling:.3} s at {gain:.1} 1/s",
                        scheme.name(),
                        if largest >= GAINS_1_S.1 { " and beyond" } else { "" },
                    ));
                    entries.push(json!({
                        "arm": arm, "scheme": scheme.name(), "update": name, "delay_ms": delay_ms,
                        "largest_stable_gain_1_s": largest, "stable_in_whole_range": largest >= GAINS_1_S.1, "best_gain_1_s": gain, "best_settling_time_s": settling,
                    }));
                    gains.push((delay_ms as f64, largest));
                    times.push((delay_ms as f64, settling));
                    if lag_s > 0.0 && scheme == Scheme::D {
                        let errors = studied.run(&cell, gain)?;
                        let shown = errors.into_iter().take(1000).enumerate();
                        let mark = if update == UpdatePolicy::Frame { Mark::Dashed } else { Mark::Line };
                        let points = shown.map(|(t, e)| (t as f64 * TICK_S, e));
                        responses.push(Series::new(mark, k, points).label(format!("{name} {delay_ms} ms")));
                    }
                }
                let colour = 2 * i + j;
                let mark = if lag_s > 0.0 { Mark::Line } else { Mark::Dashed };
                let label = format!("{} {name}, {arm}", scheme.name());
                limits.push(Series::new(mark, colour, gains).label(&label));
                best.push(Series::new(mark, colour, times).label(&label));
            }
        }
    }
    out.table("gain-delay", table);
    out.metric("loops", entries);
    out.figure(
        "gain-delay",
        "Largest stable gain and best 2 % settling time against the delay; dashed: ideal arm. Under `predict` the delay \
         of an object at rest does not matter.",
        figure("gain-delay", 3, &[limits, best, responses])?,
    );
    Ok(out)
}
