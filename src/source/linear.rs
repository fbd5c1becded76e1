//! A source whose levels are made proportional to light before anybody sees them.

use super::{
    Captured, Exposed, Exposure, Filled, FreeRunningSource, NextInstant, ScheduledSource, SourceError,
    SourceHealth,
};
use crate::camera_model::LevelTable;
use crate::messages::JointState;
use crate::time::MonoNs;
use std::time::Duration;

/// A source and what makes its levels linear.
pub(super) struct Linearized<S: ?Sized> {
    pub(super) table: LevelTable,
    pub(super) source: Box<S>,
}

impl ScheduledSource for Linearized<dyn ScheduledSource> {
    fn arm(&mut self, state: &JointState) {
        self.source.arm(state);
    }

    fn expose(&mut self, exposure: &Exposure, out: &mut [u8]) -> Result<Exposed, SourceError> {
        let exposed = self.source.expose(exposure, out)?;
        if exposed == Exposed::Image {
            self.table.apply(out);
        }
        Ok(exposed)
    }

    fn is_known_ahead(&self) -> bool {
        self.source.is_known_ahead()
    }

    fn next_instant(&self) -> NextInstant {
        self.source.next_instant()
    }

    fn stamped(&self, exposure: &Exposure) -> MonoNs {
        self.source.stamped(exposure)
    }
}

impl<S: FreeRunningSource + ?Sized> FreeRunningSource for Linearized<S> {
    fn wait(&mut self, longest: Duration) -> Result<Option<Captured>, SourceError> {
        self.source.wait(longest)
    }

    fn fill(&mut self, out: &mut [u8]) -> Result<Filled, SourceError> {
        let filled = self.source.fill(out)?;
        if filled == Filled::Image {
            self.table.apply(out);
        }
        Ok(filled)
    }

    fn health(&self) -> SourceHealth {
        self.source.health()
    }
}
