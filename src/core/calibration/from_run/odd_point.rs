//! A point that alone contradicts the description: a mark whose rim is covered for a while, not a lens or a mount.
//!
//! A mark that is seen beside its place pulls at nineteen unknowns, some of which give way. With four marks none of the others says that it is wrong, but without it they say that the rest is as told.

use super::views::{RunCell, RunViews};
use super::{RunRefinement, fit_run};
use nalgebra::Point3;

/// Most points among which an odd one is looked for. Chosen by hand: among more of them one counts little, and Huber's weights leave less of that.
const MOST_POINTS: usize = 8;
/// Standard deviations up to which a number is as told without one of the points. Chosen by hand: three points of four leave a difference of 4 deviations 3.5 of them.
const AS_TOLD: f64 = 3.0;
/// Factor on what a refined description leaves of the other points, up to which the one that is told leaves as little. Chosen by hand: thirteen numbers more take a tenth of the noise of some views, and a lens that
/// is a few percent off leaves several times as much, be its numbers as uncertain as they may.
const AS_LITTLE: f64 = 1.2;

impl<const N: usize> RunViews<N> {
    /// The run as it would be without a point of the target.
    #[must_use]
    pub(crate) fn without(&self, p_O: &Point3<f64>) -> Self {
        let mut run = self.clone();
        run.views.iter_mut().for_each(|view| view.points.retain(|point| point.p_O != *p_O));
        run
    }

    /// The points that were seen in some view.
    fn points_seen(&self) -> Vec<Point3<f64>> {
        let mut points: Vec<Point3<f64>> = Vec::new();
        for point in self.views.iter().flat_map(|view| &view.points) {
            if !points.contains(&point.p_O) {
                points.push(point.p_O);
            }
        }
        points
    }
}

impl RunRefinement {
    /// Whether a number that was seen is off what is told by more than so many of its standard deviations.
    #[must_use]
    pub fn contradicts(&self, sds: f64) -> bool {
        self.numbers.iter().any(|n| n.is_seen && (n.refined - n.told).abs() > sds * n.sd)
    }
}

/// The point of the target without which the run contradicts nothing of the description, where it does so by `sure` standard deviations with all of them; of several such points any.
pub(crate) fn odd_point<const N: usize>(
    cell: &RunCell<'_, N>,
    run: &RunViews<N>,
    sure: f64,
) -> Option<Point3<f64>> {
    let refined = |run: &RunViews<N>| fit_run(cell, run).and_then(|fit| fit.refinement()).ok();
    let points = run.points_seen();
    if points.len() > MOST_POINTS || !refined(run).is_some_and(|all| all.contradicts(sure)) {
        return None;
    }
    let is_odd = |p_O: &Point3<f64>| {
        refined(&run.without(p_O)).is_some_and(|rest| {
            !rest.contradicts(AS_TOLD) && rest.rms_before_px < AS_LITTLE * rest.rms_after_px
        })
    };
    points.into_iter().find(is_odd)
}
