//! Orders of the mission to control. The mission states what is to be reached; control decides how, and control alone brings the arm to rest.

use super::behaviour::CommandedMotion;
use super::lifecycle::Request;
use crate::motion::ExcitationMotion;
use crate::servo::SetPoint;
use crate::time::SpanNs;
use nalgebra::SVector;

/// One order. It takes effect before the next tick; an order that is not possible in the present state is ignored.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant)] // it crosses a ring to the real-time thread, which allocates and frees nothing
pub enum ControlOrder<const N: usize> {
    /// A request, as a client could make it too.
    Request(Request),
    /// Sets the goal, which ends the state `Teaching`.
    Goal(SetPoint),
    /// Appends a waypoint, rad or m.
    Waypoint(SVector<f64, N>),
    /// Moves to a posture, rad or m, in the state `Moving`.
    Posture(SVector<f64, N>),
    /// Moves by a velocity for a time, in the state `Moving`.
    Velocity(CommandedMotion<N>, SpanNs),
    /// Sets the gain of the law, 1/s.
    Gain(f64),
    /// Sets the excitation motion of a calibration.
    Excite(ExcitationMotion<N>),
    /// Sets the motion that somebody else commands, or that there is none.
    Command(Option<CommandedMotion<N>>),
    /// Reduces the gain and the estimation rate, for an arm that oscillates about its goal.
    ReduceGain,
    /// Has the law go another way, for an arm that comes no nearer to a goal that is far.
    TryAnotherWay,
    /// Restores the full estimation rate.
    RestoreGain,
    /// Brings the arm to rest and ends the loop.
    End,
}
