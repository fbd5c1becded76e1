//! What is asked of control where an arm comes no nearer to its goal: another way while it is far, a lower gain about the goal.

use super::residual::is_at_its_end;
use super::{Mission, RunTask};
use crate::control::order::ControlOrder;
use crate::motion::ActingLimits;
use crate::servo::Law;

/// The gain is reduced for an arm whose error does not fall and is more than so many times the goal's tolerance. Chosen by hand: nearer to
/// the goal the arm is given time, because noise alone may keep the error about the tolerance.
const SWINGS_FROM: f64 = 1.5;
/// Error from which on another interaction matrix is another way for an arm that moves on and comes no nearer, px. Chosen by hand: nearer to the goal all of them are alike, and what keeps an arm there is
/// something else.
const FAR_PX: f64 = 20.0;
/// The same for an arm that stands, such as one with a joint at the end of its range a whole turn away from where it could reach its goal, px. Chosen by hand: of 27 starts that the current matrix did not bring home
/// one stood at 20 px.
const FAR_AT_REST_PX: f64 = 5.0;

impl<const N: usize> Mission<N> {
    /// Has a law that comes no nearer to a goal that is far go another way, reduces the gain for an arm that oscillates about its goal, and restores it for one that then sticks before the goal.
    pub(super) fn adapt_law(&mut self, limits: &ActingLimits) {
        let goal_px = self.goal.tolerance_px;
        // A motion that was planned has no goal that it could come nearer to.
        let has_gain = matches!(self.task, RunTask::Servo);
        if self.end.decided().is_some() || !has_gain {
            return;
        }
        if is_at_its_end(limits) && self.goes_wrong_way() {
            self.way_asked = true;
            self.orders.push_back(ControlOrder::TryAnotherWay);
        } else if self.residual.constant_px(goal_px).is_some() {
            if std::mem::take(&mut self.is_reduced) {
                self.orders.push_back(ControlOrder::RestoreGain);
                self.residual.begin_anew();
            }
        } else if self.residual.is_no_nearer(SWINGS_FROM * goal_px) {
            // Control tells whether it can. Of traces that come all at once each would ask.
            if !self.orders.contains(&ControlOrder::ReduceGain) {
                self.orders.push_back(ControlOrder::ReduceGain);
            }
        }
    }

    /// Whether scheme D, before an object that rests, is far from its goal and comes no nearer, for the first time. Of an arm that is not at its end, that has other reasons than the way.
    fn goes_wrong_way(&self) -> bool {
        let may = !self.way_asked && !self.plan.follows && matches!(self.plan.law, Law::ImageVelocity { .. });
        let at_least = self.goal.tolerance_px;
        may && (self.residual.constant_px(FAR_AT_REST_PX.max(at_least)).is_some()
            || self.residual.is_no_nearer(FAR_PX.max(at_least)))
    }
}
