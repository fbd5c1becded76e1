//! Which error of the camera's pose a run has ended with, by all that it has seen, and within which bound.
//!
//! The law brings the measured pose to the goal. A lens, a target's size, a mount or a delay of the stamps that is not as described makes the true pose another one, and leaves little
//! or nothing in a single image; over a run the joints tell some of it, because they are metric. So views of the run are kept, with the joints about their exposures, and
//! fitted at its end ([`crate::calibration::from_run`]). A goal that was taught is the same view with whatever lens, and has no such error.

use super::model_error::drop_every_second;
use super::{BelievedCell, DescriptionError};
use crate::calibration::from_run::{
    CONFIDENCE, NEW_PX, RunCell, RunRefinement, RunViews, SeenPoint, SeenView, fit_run, odd_point,
};
use crate::geometry::Pose;
use crate::messages::Measurement;
use crate::robot::JointHistory;
use crate::servo::SetPoint;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// Views that are kept; of more, every second one is dropped. Chosen by hand: they tell a size to a fraction of a percent, and the fit takes a tenth of a second.
const VIEWS: usize = 40;
/// States of the joints that are kept about an exposure. Chosen by hand: stamps are seldom off by more than 75 ms.
const STATES: usize = 7;
/// The time between them. Chosen by hand: a cubic between two of them is true to some microradians at usual jerks.
const STATES_APART: SpanNs = SpanNs(25_000_000);
/// Half of the time over which a velocity is a difference of positions. Chosen by hand: some ticks, in which no arm turns back.
const HALF: SpanNs = SpanNs(3_000_000);
/// Standard deviations from which on a difference from the description is told. Chosen by hand, as of the lens (`calibration/lens_check.rs`): normal noise exceeds 4 once in 16 000 cases.
const SURE: f64 = 4.0;
/// Differences that are told in words. Chosen by hand: a line or two.
const TOLD: usize = 4;

/// A view, and the joints about its exposure.
#[derive(Debug, Clone, Copy)]
struct KeptView<const N: usize> {
    m: Measurement,
    states: [Option<NearState<N>>; STATES],
}

/// Position, rad or m, and velocity of the joints at a time near an exposure.
#[derive(Debug, Clone, Copy)]
struct NearState<const N: usize> {
    time: MonoNs,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
}

/// What a run tells at its end of itself and its description.
#[derive(Debug, Clone, Default)]
pub struct Hindsight {
    /// How near to its goal the run has ended; `None` before its end, of a goal that was taught, where the target or nothing moves, and where nothing explains what was seen.
    pub accuracy: Option<Accuracy>,
    /// The numbers of the description that joints and views contradict, the surest first: of lens, mount, stamps and the size of the target, of which a single image tells little or
    /// nothing.
    pub contradicted: Vec<DescriptionError>,
}

/// The views of a run since its last start. Memory is taken once.
#[derive(Debug, Clone)]
pub(super) struct RunViewLog<const N: usize> {
    history: JointHistory<N>,
    views: Vec<KeptView<N>>,
}

impl<const N: usize> RunViewLog<N> {
    pub(super) fn new() -> Self {
        Self { history: JointHistory::new(), views: Vec::with_capacity(VIEWS) }
    }

    /// What was seen before says nothing of this start: the target may have been moved.
    pub(super) fn begin_anew(&mut self) {
        self.views.clear();
    }

    /// Takes in the joints, rad or m, at `now`; at every tick.
    pub(super) fn note_arm(&mut self, now: MonoNs, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        self.history.push(now, q, qd);
    }

    /// Takes in a measurement that was used. One that looks like the one before tells nothing new, and its errors are the same ones.
    pub(super) fn note(&mut self, m: &Measurement) {
        let is_new = self.views.last().is_none_or(|last| moved_px(&last.m, m) >= NEW_PX);
        if m.pose().is_none() || m.features().len() < 4 || !is_new {
            return;
        }
        if self.views.len() >= VIEWS {
            drop_every_second(&mut self.views);
        }
        let newest = self.history.newest().unwrap_or(m.exposure);
        let states = std::array::from_fn(|k| {
            let time = m.exposure + SpanNs(STATES_APART.0 * (k as i64 - STATES as i64 / 2));
            let (q, before) = (self.history.joints(time)?, self.history.joints(time - HALF)?);
            let after = self.history.joints(time + HALF)?;
            (time <= newest).then(|| NearState { time, q, qd: (after - before) / (2.0 * HALF.as_s()) })
        });
        self.views.push(KeptView { m: *m, states });
    }

    /// What the views tell of a run that ended before `goal` with joints at `q`, rad or m, where that is known. Nothing where nothing explains the views.
    pub(super) fn hindsight(
        &self,
        believed: &BelievedCell<N>,
        goal: &SetPoint,
        q: Option<&SVector<f64, N>>,
    ) -> Hindsight {
        let mut run = self.run_views(goal);
        let cell = RunCell { robot: &believed.robot, mount: &believed.mount, camera: &believed.camera };
        // A mark whose rim was covered for a while is no lens and no mount.
        if let Some(odd) = odd_point(&cell, &run, SURE) {
            run = run.without(&odd);
        }
        let Ok(fit) = fit_run(&cell, &run) else { return Hindsight::default() };
        let accuracy = |at: (&SVector<f64, N>, &Pose)| {
            let end = fit.end_pose(at);
            Accuracy {
                confidence: CONFIDENCE,
                position_error_m: end.position_m,
                orientation_error_rad: end.angle_rad,
                position_bound_m: end.position_bound_m,
                orientation_bound_rad: end.angle_bound_rad,
                views: run.views.len(),
                rms_px: end.rms_px,
                narrowed_by: end.narrowed_by.map(|part| part.as_str().to_owned()),
            }
        };
        let contradicted = fit.refinement().map_or_else(|_| Vec::new(), |refined| differences(&refined));
        Hindsight { accuracy: q.zip(goal.X_DO().filter(|_| goal.is_of_pose())).map(accuracy), contradicted }
    }

    fn run_views(&self, goal: &SetPoint) -> RunViews<N> {
        let mut run = RunViews::default();
        for KeptView { m, states } in &self.views {
            states.iter().flatten().for_each(|state| run.track.push(state.time, state.q, state.qd));
            let points = m.features().iter().filter_map(|f| {
                let place = goal.ids().iter().position(|id| u64::from(*id) == f.id)?;
                Some(SeenPoint::of(m, f, *goal.points().get(place)?))
            });
            let points: Vec<_> = points.collect();
            if let Some(X_CO) = m.pose().filter(|_| points.len() >= 4) {
                run.views.push(SeenView { stamp: m.exposure, points, X_CO });
            }
        }
        run
    }
}

/// Farthest that a point of both has moved, px; infinite where they share none.
fn moved_px(a: &Measurement, b: &Measurement) -> f64 {
    let shared = a.features().iter().filter_map(|f| {
        let g = b.features().iter().find(|g| g.id == f.id)?;
        Some((f.u_px - g.u_px).hypot(f.v_px - g.v_px))
    });
    shared.reduce(f64::max).unwrap_or(f64::INFINITY)
}

/// What the run contradicts of the description, the surest first.
fn differences(refined: &RunRefinement) -> Vec<DescriptionError> {
    let sds = |told: f64, found: f64, sd: f64| (found - told).abs() / sd;
    let seen = refined.numbers.iter().filter(|n| n.is_seen && sds(n.told, n.refined, n.sd) > SURE);
    let mut all: Vec<DescriptionError> = seen
        .map(|n| DescriptionError {
            key: n.key.to_owned(),
            described: n.told,
            estimated: n.refined,
            sd: n.sd,
        })
        .collect();
    let by = |d: &DescriptionError| sds(d.described, d.estimated, d.sd);
    all.sort_by(|a, b| by(b).total_cmp(&by(a)));
    all
}

/// How near to its goal the camera has come, by all that a run has seen, and within which bound it is; without the arm's own errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Share of all cases in which the true errors are within the bounds, each by itself.
    pub confidence: f64,
    /// Most likely distance of the camera from its desired place, m.
    pub position_error_m: f64,
    /// Most likely angle of the camera from its desired orientation, rad.
    pub orientation_error_rad: f64,
    /// Bound of that distance, m.
    pub position_bound_m: f64,
    /// Bound of that angle, rad.
    pub orientation_bound_rad: f64,
    /// Views from which that is known.
    pub views: usize,
    /// What remains of the points' errors, root mean square, px.
    pub rms_px: f64,
    /// The part of the description whose exact knowledge would narrow the bound of the distance the most; `null` where none would by a third.
    pub narrowed_by: Option<String>,
}

impl Accuracy {
    /// The line of the summary.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "with {:.0} % certainty within {:.3} mm and {:.4} deg of the goal, by {} views (most likely {:.3} mm, {:.4} deg)",
            self.confidence * 100.0,
            self.position_bound_m * 1e3,
            self.orientation_bound_rad.to_degrees(),
            self.views,
            self.position_error_m * 1e3,
            self.orientation_error_rad.to_degrees()
        );
        if let Some(part) = &self.narrowed_by {
            let _ = write!(text, "; the least certain is the {part}");
        }
        text
    }
}

/// The line of the summary about numbers of the description that a run contradicts; `None` where it contradicts none.
#[must_use]
pub fn contradicted_text(differences: &[DescriptionError]) -> Option<String> {
    let of = |d: &DescriptionError| {
        // Chosen by hand: pixels and degrees to a tenth, metres and factors to four digits.
        let digits = if d.sd < 0.1 { 4 } else { 1 };
        let DescriptionError { key, described, estimated, sd } = d;
        format!("{key} looks like {estimated:.digits$} +- {sd:.digits$} (told {described:.digits$})")
    };
    let told: Vec<_> = differences.iter().take(TOLD).map(of).collect();
    let more = match differences.len() {
        0 => return None,
        n if n > TOLD => format!("; {} more in the summary's JSON", n - TOLD),
        _ => String::new(),
    };
    Some(format!("{}{more}: `vservo calibrate from` a recording or report refines them", told.join("; ")))
}
