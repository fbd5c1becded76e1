//! What the mission wants of control: it says what is to be reached, control decides how, and alone stops and comes to rest.

use super::lifecycle::Request;
use crate::motion::ExcitationMotion;
use crate::servo::SetPoint;
use nalgebra::SVector;

/// One order. It takes effect before the next tick; one that cannot be obeyed changes nothing.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant)] // it crosses a ring to the real-time thread, which allocates and frees nothing
pub enum ControlOrder<const N: usize> {
    /// What a client could ask for too.
    Request(Request),
    /// From now on these features are the goal. It ends a lesson.
    Goal(SetPoint),
    /// One more posture to go to, rad or m.
    Waypoint(SVector<f64, N>),
    /// The motion by which to calibrate.
    Excite(ExcitationMotion<N>),
    /// The arm moves about its goal and gets no nearer: from now on it goes there, and learns, more slowly.
    ReduceGain,
    /// What was slowed down learns at its full rate again.
    RestoreGain,
    /// Bring the arm to rest, and tick no more.
    End,
}
