//! Requests of clients with what became of them, for replay and analysis: `control/request`.

use super::layout::record;
use super::{COMMAND_VALUES, ControlCommand, MAX_FEATURES};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

record! {
    "vservo.Request.v3",
    /// A request of a client and its answer.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct RequestMsg {
        /// Counts the requests, from 0: a gap is a record that was lost on the way.
        pub sequence: u64,
        /// Time of the tick at whose begin it took effect, or before which it was refused.
        pub stamp: MonoNs,
        /// Number of that tick.
        pub tick: u64,
        /// Counts what was asked for, in the order in which it was planned; records come in the order of the answers.
        pub number: u64,
        /// Ticks of which the mission knew when it planned the request.
        pub planned: u64,
        /// Ticks of which the mission knew when it heard the answer of control.
        pub decided: u64,
        /// Code of a `control::lifecycle::Request`.
        pub request: u32,
        /// Which arm.
        pub arm: u32,
        /// Which camera.
        pub camera: u32,
        /// What the numbers are: code of a [`super::CommandForm`]; 0: none.
        pub form: u32,
        /// Entries of `values` in use.
        pub count: u32,
        /// Code of a `control::lifecycle::Refusal`; 0: it was accepted.
        pub refusal: u32,
        /// Code of a [`super::ControlState`]: the state right after it.
        pub state: u32,
        /// Number of the goal after it.
        pub goal: u32,
        /// Of which target a goal is: as in [`ControlCommand::target`].
        pub target: u32,
        /// Zero.
        pub reserved: u32,
        /// With the form [`super::CommandForm::Features`], which point each two values belong to.
        pub ids: [u32; MAX_FEATURES],
        /// The numbers.
        pub values: [f64; COMMAND_VALUES],
    }
}

impl RequestMsg {
    /// What was asked for; what became of it is to be added.
    #[must_use]
    pub fn of(command: &ControlCommand) -> Self {
        let ControlCommand { request, arm, camera, form, count, target, ids, values } = *command;
        Self {
            sequence: 0,
            stamp: MonoNs::ZERO,
            tick: 0,
            number: 0,
            planned: 0,
            decided: 0,
            request,
            arm,
            camera,
            form,
            count,
            refusal: 0,
            state: 0,
            goal: 0,
            target,
            reserved: 0,
            ids,
            values,
        }
    }
}

impl Default for RequestMsg {
    fn default() -> Self {
        Self::of(&ControlCommand::default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    #[allow(unsafe_code)]
    fn the_layout_is_fixed_and_named() {
        assert_eq!((size_of::<RequestMsg>(), align_of::<RequestMsg>()), (1368, 8));
        assert_eq!((offset_of!(RequestMsg, ids), offset_of!(RequestMsg, values)), (88, 344));
        // SAFETY: the name is only read.
        assert_eq!(unsafe { RequestMsg::type_name() }, "vservo.Request.v3");
    }
}
