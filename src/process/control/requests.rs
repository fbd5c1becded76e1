//! What crosses from the companion to the real-time thread, and what comes back, beside measurements and traces.

use crate::control::lifecycle::{Refusal, Request};
use crate::control::order::ControlOrder;
use crate::messages::{ControlCommand, ControlState};
use crate::time::MonoNs;

/// On its way to the loop.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant)] // the ring allocates once
pub(super) enum Asking<const N: usize> {
    /// The mission's.
    Order(ControlOrder<N>),
    /// A client's, which wants an answer.
    Request {
        number: u64,
        request: Request,
        /// What it carries, as the mission has planned it.
        order: Option<ControlOrder<N>>,
    },
}

/// A request of a client, before it was planned.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClientRequest {
    pub(super) number: u64,
    pub(super) request: Request,
    pub(super) command: ControlCommand,
}

/// What the loop says to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Answered {
    pub(super) number: u64,
    pub(super) refusal: Option<Refusal>,
    pub(super) state: ControlState,
    /// The tick at whose begin it took effect.
    pub(super) tick: u64,
    /// Its time.
    pub(super) stamp: MonoNs,
}
