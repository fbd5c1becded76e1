//! How well a run file does in simulation, and the search for values with which it does better (`vservo tune`).
//!
//! ```text
//! values ─► run file ─► simulated run ─► TuneFigures ─► cost ─► search: one key after the other, on a logarithmic scale
//!                                                               4 places over its range, then halfway to its neighbours, twice;
//!                                                               then once around the best of all keys
//! ```

mod search;

pub use search::{TuneKey, search};

use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::sim::{Moment, SimError, simulate_system};
use crate::time::MonoNs;
use serde::Serialize;
use std::ops::ControlFlow::Continue;

/// Share of the first error by which a run may go back before it costs. Chosen by hand: more is seen as a swing.
const MOST_OVERSHOOT: f64 = 0.05;
/// Seconds at the end of a run over which its rest is judged. Chosen by hand: longer than ten periods of a camera of 60 Hz, and within the hold.
const REST_S: f64 = 0.2;
/// Cost of a run that does not converge, which must be above that of every one that does, s: longer than any run may be of use.
const FAILED: f64 = 1e6;
/// Factor on the time of a run by which a disturbance may slow it before it counts as failed. Chosen by hand.
const SLOWER: f64 = 2.0;
/// Bisections of a margin: to a 64th of its range. Chosen by hand: a millisecond and a half of delay, and each one more takes a run.
const BISECTIONS: u32 = 6;

/// How well a run did, by the truth that the simulation has.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TuneFigures {
    /// Whether the goal was reached and held.
    pub converged: bool,
    /// When the error of the features came within the goal's tolerance for good, s.
    pub settling_s: Option<f64>,
    /// Greatest rise of that error after it had been lower, as a share of the first one.
    pub overshoot: f64,
    /// Root mean square of that error over the last 0.2 s, px: what noise and friction leave.
    pub rest_px: f64,
}

impl TuneFigures {
    /// What a search makes small, s.
    #[must_use]
    pub fn cost(&self) -> f64 {
        match self.settling_s {
            // Each 5 % of swing beyond what is allowed costs as much as the time itself.
            Some(settling) if self.converged => settling * (self.overshoot / MOST_OVERSHOOT).max(1.0),
            _ => FAILED + self.rest_px.min(FAILED),
        }
    }

    /// Whether a run with a disturbance still does what `undisturbed` did.
    #[must_use]
    pub fn withstands(&self, undisturbed: &Self) -> bool {
        self.converged && self.cost() <= SLOWER * undisturbed.cost()
    }
}

/// Simulates `config`.
///
/// # Errors
/// [`SimError`] when a part of it cannot be built.
pub fn figures(config: &Config) -> Result<TuneFigures, SimError> {
    let mut errors = Vec::new();
    let run = simulate_system(config, &mut |moment| {
        if let Moment::Tick(trace, now) = moment
            && let Some(px) = now.feature_error_px
        {
            errors.push(((trace.time - MonoNs::ZERO).as_s(), px));
        }
        Continue(())
    })?;
    Ok(TuneFigures {
        converged: run.finish.outcome == Outcome::Converged,
        ..judged(&errors, config.goal.feature_error_px)
    })
}

/// The figures of errors over time, s and px.
fn judged(errors: &[(f64, f64)], tolerance_px: f64) -> TuneFigures {
    let (Some((begin, first)), Some((end, last))) = (errors.first(), errors.last()) else {
        return TuneFigures { converged: false, settling_s: None, overshoot: 0.0, rest_px: f64::INFINITY };
    };
    let unsettled = errors.iter().rev().find(|(_, px)| !(*px <= tolerance_px));
    let settled = *last <= tolerance_px;
    let mut lowest = f64::INFINITY;
    let rise = errors.iter().fold(0.0_f64, |rise, (_, px)| {
        lowest = lowest.min(*px);
        rise.max(px - lowest)
    });
    let rest: Vec<f64> = errors.iter().filter(|(at, _)| end - at <= REST_S).map(|(_, px)| px * px).collect();
    TuneFigures {
        converged: settled,
        settling_s: settled.then(|| unsettled.map_or(0.0, |(at, _)| at - begin)),
        overshoot: rise / first.max(f64::MIN_POSITIVE),
        rest_px: (rest.iter().sum::<f64>() / rest.len().max(1) as f64).sqrt(),
    }
}

/// How much of a disturbance a run stands, to a 64th of `most`: the greatest amount up to which `holds` of all that were tried.
pub fn margin(most: f64, holds: &mut dyn FnMut(f64) -> bool) -> f64 {
    if holds(most) {
        return most;
    }
    let (mut good, mut bad) = (0.0, most);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (good + bad);
        if holds(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}

#[cfg(test)]
mod tests {
    use super::*;

    fn falling(swing: f64, rest: f64) -> Vec<(f64, f64)> {
        (0..2000)
            .map(|k| {
                let t = f64::from(k) * 1e-3;
                let swings = if (0.5..0.7).contains(&t) { swing } else { 0.0 };
                (10.0 + t, 100.0 * (-10.0 * t).exp() + swings + rest)
            })
            .collect()
    }

    #[test]
    fn figures_of_a_known_decay() {
        let f = judged(&falling(0.0, 0.0), 1.0);
        // 100 exp(-10 t) = 1 at t = ln(100) / 10
        assert!((f.settling_s.unwrap() - 100.0_f64.ln() / 10.0).abs() < 2e-3, "{f:?}");
        assert!(f.converged && f.overshoot == 0.0 && f.rest_px < 1e-6);
        let f = judged(&falling(20.0, 0.3), 1.0);
        assert!(
            (f.settling_s.unwrap() - 0.699).abs() < 2e-3,
            "the swing comes back out of the tolerance: {f:?}"
        );
        assert!((f.overshoot - 0.2).abs() < 0.01 && (f.rest_px - 0.3).abs() < 1e-3, "{f:?}");
        assert!(f.cost() > 2.0 * f.settling_s.unwrap());
    }

    #[test]
    fn what_does_not_converge_costs_more_than_all_that_does() {
        let f = judged(&falling(0.0, 2.0), 1.0);
        assert!(!f.converged && f.settling_s.is_none() && f.cost() > FAILED);
        assert!(judged(&[], 1.0).cost() > f.cost());
    }

    #[test]
    fn a_margin_is_found_to_a_64th() {
        let mut calls = 0;
        let found = margin(100.0, &mut |x| {
            calls += 1;
            x <= 37.0
        });
        assert!(found <= 37.0 && found > 37.0 - 100.0 / 64.0 && calls <= 7, "{found}");
        assert!((margin(100.0, &mut |_| true) - 100.0).abs() < 1e-12);
        assert!(margin(100.0, &mut |_| false).abs() < 1e-12);
    }
}
