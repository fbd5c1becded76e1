//! A process's place in an instance, from the lock of its role to the removal of what the last one leaves.

use super::error::Disagreements;
use super::{LeftoversGuard, ProcessError};
use crate::config::Config;
use crate::ipc::{Heartbeat, Instance, Role, RoleLock, Services};
use crate::time::SpanNs;
use std::time::Duration;

/// A process that has just taken its role needs microseconds to wipe what a dead one said in its place: who disagrees is asked once more after this. Chosen by hand, long for
/// that even on a busy machine.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// A held role and the connection to shared memory. The fields are given back in the order in which they stand:
/// first the connection, then the role, and then, by the last process, the instance's directory itself.
#[derive(Debug)]
pub struct Membership {
    services: Services,
    heartbeat: Option<Heartbeat>,
    _lock: RoleLock,
    _place: LeftoversGuard,
}

impl Membership {
    /// Takes `role`, removes what a dead run left, and joins.
    ///
    /// # Errors
    /// When the role is taken, shared memory is not usable, or a process of the instance was started with another camera, target, robot or
    /// clock.
    pub fn join(instance: &Instance, role: Role, config: &Config) -> Result<Self, ProcessError> {
        let lock = instance.lock(role)?;
        let agreement = config.agreement();
        lock.state(&agreement);
        let mut disagreements = instance.disagreements(role, &agreement);
        if !disagreements.is_empty() {
            std::thread::sleep(LOOK_AGAIN);
            disagreements = instance.disagreements(role, &agreement);
        }
        if !disagreements.is_empty() {
            return Err(ProcessError::Disagree {
                instance: instance.to_string(),
                disagreements: Disagreements(disagreements),
            });
        }
        let place = LeftoversGuard::of(instance);
        instance.remove_leftovers(Some(role));
        let services = Services::join(instance)?;
        services.remove_dead_peers();
        Ok(Self { services, heartbeat: lock.heartbeat(), _lock: lock, _place: place })
    }

    /// The main loop of this process has come round: the supervisor takes it for alive.
    pub fn beat(&self) {
        if let Some(heartbeat) = &self.heartbeat {
            heartbeat.beat();
        }
    }

    /// Beats while `work` is done, for `longest` at most.
    pub fn beat_during<T>(&self, longest: SpanNs, work: impl FnOnce() -> T) -> T {
        match &self.heartbeat {
            Some(heartbeat) => heartbeat.beat_during(longest, work),
            None => work(),
        }
    }

    /// Lets the other processes know how far this one has come.
    pub fn tell_progress(&self, count: u64) {
        if let Some(heartbeat) = &self.heartbeat {
            heartbeat.tell_progress(count);
        }
    }

    /// The connection.
    #[must_use]
    pub fn services(&self) -> &Services {
        &self.services
    }
}
