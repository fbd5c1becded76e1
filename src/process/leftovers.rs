//! What a process leaves of an instance is removed when it leaves, if nobody else is there.

use crate::ipc::Instance;

/// Removes the instance's leftovers when dropped.
#[derive(Debug)]
pub(crate) struct LeftoversGuard(Instance);

impl LeftoversGuard {
    pub(crate) fn of(instance: &Instance) -> Self {
        Self(instance.clone())
    }
}

impl Drop for LeftoversGuard {
    fn drop(&mut self) {
        self.0.remove_leftovers(None);
    }
}
