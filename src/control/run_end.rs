//! How a run ends: what was decided, and that the arm is at rest before the last command.
//!
//! ```text
//! decided (goal, time, request, fault, last frame) ─► the arm brakes within its limits ─► measured arm at rest ─► over
//!                                                                    └─ still moving PATIENCE later: a fault ─► over
//! ```
//! Rest is the measured arm's: over `WINDOW` ticks no joint moves faster than `REST_SPEED`, by its positions and by the
//! mean of its measured velocities, beyond what the noise of the encoders explains. A swinging arm is not at rest.

use crate::control::outcome::{Finish, Outcome};
use crate::control::sightings::Sightings;
use crate::drive::DriveState;
use crate::messages::{ControlState, TargetStatus};
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// An arm slower than this is at rest, rad/s or m/s.
const REST_SPEED: f64 = 0.02;
/// Ticks over which its speed is judged.
const WINDOW: usize = 50;
/// Readings of a noisy encoder that stands lie so many standard deviations apart.
const NOISE_SPREAD: f64 = 6.0;
/// How long an arm whose reference rests may go on moving.
const PATIENCE: SpanNs = SpanNs(2_000_000_000);

/// The end that was decided, and the way there.
#[derive(Debug, Clone)]
pub(crate) struct RunEnd<const N: usize> {
    decided: Option<Finish>,
    /// Since when the reference rests.
    reference_rests: Option<MonoNs>,
    rest: RestWatch<N>,
}

/// What there is to do about the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NextStep {
    /// No end was decided.
    GoOn,
    /// The arm has to come to rest first.
    Brake,
    /// The arm does not come to rest.
    GiveUp,
    /// The run is over.
    Over(Finish),
}

impl<const N: usize> RunEnd<N> {
    pub(crate) fn new() -> Self {
        Self { decided: None, reference_rests: None, rest: RestWatch::default() }
    }

    /// Takes the arm's measured state of a tick.
    pub(crate) fn note(&mut self, state: &DriveState<N>) {
        self.rest.note(state);
    }

    /// Decides how the run ends. The first word counts, but for a fault, which is the last one.
    pub(crate) fn decide(&mut self, finish: Finish) {
        let has_failed = self.decided.is_some_and(|f| f.outcome == Outcome::Fault);
        if self.decided.is_none() || (finish.outcome == Outcome::Fault && !has_failed) {
            self.decided = Some(finish);
        }
    }

    /// What was decided.
    pub(crate) fn decided(&self) -> Option<Finish> {
        self.decided
    }

    /// What is next at `now`. The arm cannot be waited for where it does not move by the loop, or cannot be seen.
    pub(crate) fn next(&mut self, now: MonoNs, reference_rests: bool, waits_for_arm: bool) -> NextStep {
        let Some(finish) = self.decided else { return NextStep::GoOn };
        if !waits_for_arm || (reference_rests && self.rest.is_at_rest()) {
            return NextStep::Over(finish);
        }
        if !reference_rests {
            self.reference_rests = None;
            return NextStep::Brake;
        }
        let since = *self.reference_rests.get_or_insert(now);
        if now - since > PATIENCE { NextStep::GiveUp } else { NextStep::Brake }
    }
}

/// The last joint states, and whether the arm moved in them.
#[derive(Debug, Clone)]
struct RestWatch<const N: usize> {
    q: [SVector<f64, N>; WINDOW],
    qd: [SVector<f64, N>; WINDOW],
    /// Where the next state goes; `None` before the first.
    next: Option<usize>,
}

impl<const N: usize> Default for RestWatch<N> {
    fn default() -> Self {
        Self { q: [SVector::zeros(); WINDOW], qd: [SVector::zeros(); WINDOW], next: None }
    }
}

impl<const N: usize> RestWatch<N> {
    fn note(&mut self, state: &DriveState<N>) {
        // Before the first state the arm is thought to have been as in that one.
        let Some(next) = self.next else {
            (self.q, self.qd, self.next) = ([state.q; WINDOW], [state.qd; WINDOW], Some(1));
            return;
        };
        if let (Some(q), Some(qd)) = (self.q.get_mut(next), self.qd.get_mut(next)) {
            (*q, *qd) = (state.q, state.qd);
        }
        self.next = Some((next + 1) % WINDOW);
    }

    fn is_at_rest(&self) -> bool {
        let window_s = WINDOW as f64 * TICK.as_s();
        (0..N).all(|i| {
            let (mut least, mut most, mut sum) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
            for (q, qd) in self.q.iter().zip(&self.qd) {
                (least, most, sum) = (least.min(q[i]), most.max(q[i]), sum + qd[i]);
            }
            let noise = NOISE_SPREAD * self.noise_sd(i);
            most - least <= REST_SPEED * window_s + noise
                && (sum / WINDOW as f64).abs() <= REST_SPEED + noise / window_s
        })
    }

    /// Standard deviation of the noise of joint `i`'s encoder, from the second differences of its positions: those of the
    /// motion of an arm are far smaller, `qdd T^2`.
    fn noise_sd(&self, i: usize) -> f64 {
        let oldest = self.next.unwrap_or(0);
        let q = |k: usize| self.q.get((oldest + k) % WINDOW).map_or(0.0, |q| q[i]);
        let squares: f64 = (2..WINDOW).map(|k| (q(k) - 2.0 * q(k - 1) + q(k - 2)).powi(2)).sum();
        (squares / (6.0 * (WINDOW - 2) as f64)).sqrt()
    }
}

/// The end of a run whose time is over.
pub(crate) fn time_is_up(
    closed_loop: bool,
    state: ControlState,
    has_calibration_motion: bool,
    sightings: &Sightings,
) -> Finish {
    let reason = match (closed_loop, state, sightings.last()) {
        (false, _, _) => {
            return Finish { outcome: Outcome::Finished, reason: "run.duration_s is over" };
        }
        (_, _, None) => "run.duration_s is over: no measurement ever came",
        (_, ControlState::Waiting, Some(m)) => match m.target_status() {
            TargetStatus::NoContrast => "run.duration_s is over: the frames have no contrast",
            TargetStatus::TooFewRegions => {
                "run.duration_s is over: the target was never seen, too few dark regions"
            }
            TargetStatus::Ambiguous => "run.duration_s is over: the target's dots could not be told apart",
            TargetStatus::WrongSize => "run.duration_s is over: frames have another size than the camera's",
            TargetStatus::Inconsistent => {
                "run.duration_s is over: the target's dots never fitted one pose; look for a shadow, glare or something in \
                 front, check [camera.lens] and [target], or allow for more (vision.model_sd_px)"
            }
            TargetStatus::NoMatch => "run.duration_s is over: the target was never found",
            TargetStatus::Found if sightings.is_degraded() => {
                "run.duration_s is over: a part of the target was hidden all the time, and all of it is needed"
            }
            TargetStatus::Found => why_not_used(sightings).unwrap_or(
                "run.duration_s is over: the target was found, but its place too uncertain \
                 (servo.object.max_uncertainty_m)",
            ),
        },
        _ if has_calibration_motion => {
            "run.duration_s is over before the calibration motion was: raise it to 15 or more"
        }
        (_, ControlState::Holding, Some(m)) if m.found() => {
            why_not_used(sightings).unwrap_or("run.duration_s is over: the target was lost")
        }
        (_, ControlState::Holding, Some(m)) if m.target_status() == TargetStatus::Inconsistent => {
            "run.duration_s is over: the target's dots fit no pose any more; look for a shadow, glare or something in front"
        }
        (_, ControlState::Holding, _) => "run.duration_s is over: the target was lost",
        _ => "run.duration_s is over before the goal was reached",
    };
    Finish { outcome: Outcome::NotConverged, reason }
}

/// The target is found, and yet nothing could be done about it: what most measurements were refused for, where they were.
fn why_not_used(sightings: &Sightings) -> Option<&'static str> {
    let intake = sightings.intake();
    let reasons = [
        (
            intake.refused_features,
            "run.duration_s is over: measurements carry other features than the set-point: camera, vision and control need the \
             same run file",
        ),
        (
            intake.refused_too_few,
            "run.duration_s is over: too much of the target was hidden for the law to go on",
        ),
        (
            intake.refused_pose,
            "run.duration_s is over: measurements carry poses that no object before a camera has: see to the vision process",
        ),
        (
            intake.refused_from_future,
            "run.duration_s is over: exposure stamps lie too far in the future to be used; set camera.stamp_offset_ms",
        ),
        (
            intake.refused_too_old,
            "run.duration_s is over: exposures are too old to be used; check camera.latency_ms and \
             camera.stamp_offset_ms",
        ),
    ];
    reasons
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .max_by_key(|(count, _)| *count)
        .map(|(_, reason)| reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::safety::Fault;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    const MS: i64 = 1_000_000;
    const DONE: Finish = Finish { outcome: Outcome::Stopped, reason: "asked for" };

    fn state(q: f64, qd: f64) -> DriveState<2> {
        DriveState { q: Vector2::new(q, 0.5), qd: Vector2::new(qd, 0.0), truth: None }
    }

    #[test]
    fn a_fault_is_the_last_word() {
        let mut end = RunEnd::<2>::new();
        end.decide(DONE);
        end.decide(Finish { outcome: Outcome::Converged, reason: "too late" });
        assert_eq!(end.decided(), Some(DONE));
        end.decide(Finish::fault(Fault::TrackingError));
        end.decide(Finish::fault(Fault::DeadlinesMissed));
        assert_eq!(end.decided(), Some(Finish::fault(Fault::TrackingError)));
    }

    #[test]
    fn an_arm_at_rest_ends_the_run_at_once_and_a_moving_one_when_it_has_come_to_rest() {
        let mut end = RunEnd::new();
        assert_eq!(end.next(MonoNs(0), true, true), NextStep::GoOn);
        end.decide(DONE);
        end.note(&state(0.1, 0.0));
        assert_eq!(end.next(MonoNs(0), true, true), NextStep::Over(DONE));
        let mut over_after = None;
        for k in 0..500 {
            // Moves at 0.3 rad/s for 100 ticks, then stands.
            let q = 0.1 + 0.3e-3 * f64::from(k.min(100));
            end.note(&state(q, if k < 100 { 0.3 } else { 0.0 }));
            let rests = k >= 100;
            let step = end.next(MonoNs(i64::from(k) * MS), rests, true);
            if k > 2 && step == NextStep::Over(DONE) {
                over_after.get_or_insert(k);
            } else if k > 2 {
                assert!(over_after.is_none());
                assert_eq!(step, NextStep::Brake);
            }
        }
        let over_after = over_after.unwrap();
        assert!((100..=100 + WINDOW as i32).contains(&over_after), "{over_after}");
    }

    #[test]
    fn steps_and_noise_of_encoders_are_no_motion() {
        let mut end = RunEnd::new();
        end.decide(DONE);
        for k in 0..WINDOW * 2 {
            let flips = k % 2 == 0;
            end.note(&state(if flips { 0.0 } else { 5e-4 }, if flips { 0.2 } else { -0.2 }));
        }
        assert_eq!(end.next(MonoNs(0), true, true), NextStep::Over(DONE));
    }

    #[test]
    fn a_noisy_encoder_does_not_hide_a_motion_nor_make_one() {
        for (speed, rests) in [(0.0, true), (0.1, false)] {
            let mut random = Random::new(7);
            let mut end = RunEnd::new();
            end.decide(DONE);
            for k in 0..WINDOW * 4 {
                let noise = 1e-3 * random.gaussian();
                end.note(&state(speed * 1e-3 * k as f64 + noise, speed + 300.0 * noise));
            }
            let step = end.next(MonoNs(0), true, true);
            assert_eq!(step == NextStep::Over(DONE), rests, "{speed}: {step:?}");
        }
    }

    #[test]
    fn an_arm_that_swings_or_reports_a_velocity_is_not_at_rest_and_is_given_up_after_a_while() {
        for moving in [|t: f64| (0.01 * (30.0 * t).sin(), 0.0), |_| (0.0, 0.3)] {
            let mut end = RunEnd::new();
            end.decide(DONE);
            let mut begin = None;
            for k in 0..=2100 {
                let (q, qd) = moving(f64::from(k) * 1e-3);
                end.note(&state(q, qd));
                let step = end.next(MonoNs(i64::from(k) * MS), true, true);
                if step == NextStep::Brake {
                    begin.get_or_insert(k);
                }
                if let Some(begin) = begin {
                    let over = k - begin > 2000;
                    assert_eq!(
                        step,
                        if over { NextStep::GiveUp } else { NextStep::Brake },
                        "{k} since {begin}"
                    );
                }
            }
            assert!(begin.is_some_and(|k| k < WINDOW as i32), "{begin:?}");
            assert_eq!(end.next(MonoNs(0), false, false), NextStep::Over(DONE), "an arm that cannot be seen");
        }
    }
}
