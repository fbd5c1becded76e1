//! The effective gain of a resolved-velocity law: reduced near the goal and for an arm that oscillates, raised where the law uses predicted views.

use super::covariance::stated_px2;
use super::{ServoGoal, ServoSettings, View, VisualServo};
use crate::messages::{FeaturePoint, Measurement, measurement_flag};
use crate::servo::{InteractionAt, Law};
use nalgebra::Vector2;

/// Feature error at which the gain has fallen half-way to `gain_at_goal_1_s`, root mean square, normalized: a pixel of a lens of 800 px, below which
/// noise and encoder steps dominate the error. Chosen by hand; no unit test of servo has such a gain.
const GAIN_AT_GOAL_ERROR: f64 = 1.25e-3;
/// The same as so many times what vision states that the points scatter by, where that is more. Chosen by hand: at an error of that noise alone a tenth of the gain above
/// `gain_at_goal_1_s` is left, and from nine times the noise on nine tenths of it.
const GAIN_AT_NOISE: f64 = 3.0;
/// Rate below which the gain is not reduced for an oscillating arm, 1/s. Chosen by hand: half and twice of it change no unit test.
const SLOW_1_S: f64 = 1.0;
/// Product of gain and age above which the gain is not raised to match a held law. Derived: up to here the series of [`as_quick_as_held`] is exact to 0.5 %; its
/// equation has no real solution beyond 1 / e = 0.37, from where on the held law swings.
const MAX_HELD: f64 = 0.2;

impl<const N: usize> VisualServo<N> {
    /// Sets the gain of the law, 1/s, as `servo.gain_1_s` does with one number. Returns whether it did: not where the law has several or an adaptive one.
    pub fn set_gain(&mut self, gain_1_s: f64) -> bool {
        self.settings.law.set_gain(gain_1_s)
    }

    /// Has scheme D go by another interaction matrix: by the current one in place of the mean, and by the mean in place of any other. Returns which one it went by; `None` of other laws and of learnt Jacobians.
    pub(crate) fn take_other_interaction(&mut self) -> Option<InteractionAt> {
        let Law::ImageVelocity { interaction, .. } = &mut self.settings.law else { return None };
        let other = match interaction.at {
            InteractionAt::Mean => InteractionAt::Current,
            InteractionAt::Current | InteractionAt::Desired => InteractionAt::Mean,
            InteractionAt::Estimated => return None,
        };
        Some(std::mem::replace(&mut interaction.at, other))
    }

    /// Has scheme D go by the interaction matrix `at`.
    pub(crate) fn set_interaction(&mut self, at: InteractionAt) {
        if let Law::ImageVelocity { interaction, .. } = &mut self.settings.law {
            interaction.at = at;
        }
    }
}

impl ServoSettings {
    /// Factor on a law's rate `rate_1_s`: the part above [`SLOW_1_S`] is multiplied by the reduced share of the gain of an oscillating arm, and near the
    /// goal, where the error of `view` is about a pixel, the rate falls towards `gain_at_goal_1_s`.
    pub(super) fn gain_at(&self, pursuit: ServoGoal<'_>, rate_1_s: f64, view: &View) -> f64 {
        let slower = if rate_1_s > SLOW_1_S { pursuit.gain_share.max(SLOW_1_S / rate_1_s) } else { 1.0 };
        let error = || pursuit.goal.error_rms_px(view, &Vector2::repeat(1.0));
        slower * self.reduced_near_goal((pursuit.gain_share, pursuit.noise), rate_1_s * slower, error)
    }

    /// The same near a goal from which the features are `error` away, root mean square, normalized; for a share of the gain, and the noise of the points
    /// ([`noise_of`]).
    pub(super) fn reduced_near_goal(
        &self,
        (gain_share, noise): (f64, f64),
        rate_1_s: f64,
        error: impl Fn() -> f64,
    ) -> f64 {
        let at_goal_1_s = self.gain_at_goal_1_s * gain_share;
        if !(rate_1_s > at_goal_1_s) {
            return 1.0;
        }
        let error = error();
        let near = GAIN_AT_GOAL_ERROR.max(GAIN_AT_NOISE * noise);
        let far = error * error / (error * error + near * near);
        // Without an error the gain is not reduced.
        let far = if far.is_nan() { 1.0 } else { far };
        (at_goal_1_s + (rate_1_s - at_goal_1_s) * far) / rate_1_s
    }
}

/// What vision states that the points of a measurement scatter by, root mean square over both coordinates together, normalized; 0 where lens or target are not as they are described,
/// because what that moves points by stays, and where the measurement does not tell.
pub(super) fn noise_of(m: &Measurement) -> f64 {
    let count = m.features().len() as f64;
    if m.flags & measurement_flag::MODEL_ERROR != 0 || count < 2.0 {
        return 0.0;
    }
    let px = |f: &FeaturePoint| Vector2::new(f.u_px, f.v_px);
    let normalized = |f: &FeaturePoint| Vector2::new(f.x, f.y);
    let spread = |of: &dyn Fn(&FeaturePoint) -> Vector2<f64>| {
        let mean = m.features().iter().map(of).sum::<Vector2<f64>>() / count;
        m.features().iter().map(|f| (of(f) - mean).norm_squared()).sum::<f64>()
    };
    // The lens' scale where the target is.
    let noise = (stated_px2(m) * spread(&normalized) / spread(&px)).sqrt();
    if noise.is_finite() { noise } else { 0.0 }
}

/// Factor x by which the error falls faster than `exp(-lambda t)` under a held law of gain lambda whose errors have the age T, since an older error is
/// larger: `e' = -lambda e(t - T)` falls with the rate `s = lambda x`, `x = exp(x lambda T)`, here as its series. Beyond
/// [`MAX_HELD`] held laws begin to oscillate, and the gain is raised less and less.
pub(super) fn as_quick_as_held(lambda_T: f64) -> f64 {
    let r = lambda_T.clamp(0.0, MAX_HELD);
    let x = 1.0 + r * (1.0 + r * (1.5 + r * (8.0 / 3.0 + r * 125.0 / 24.0)));
    if lambda_T > r { (x * r / lambda_T).max(1.0) } else { x }
}
