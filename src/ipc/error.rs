//! What can fail between processes.

use super::{InstanceError, Scarcity};
use thiserror::Error;

/// A shared-memory operation failed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum IpcError {
    /// The instance's place is not usable.
    #[error(transparent)]
    Place(#[from] InstanceError),
    /// Something has run out.
    #[error("{action} failed: {scarcity} (the transport says: {cause})")]
    Scarce {
        /// What was tried.
        action: String,
        /// What has run out.
        scarcity: Scarcity,
        /// The transport's word for it.
        cause: String,
    },
    /// A service carries records of another type.
    #[error(
        "service `{service}` carries {found}, this program expects {expected}: the process that made it is of another \
         version; build both from the same source"
    )]
    Type {
        /// The service.
        service: String,
        /// What it carries.
        found: String,
        /// What it should.
        expected: String,
    },
    /// The process could not join the instance.
    #[error(
        "cannot join instance `{instance}` in shared memory: {cause}; is /dev/shm writable and not full?"
    )]
    Node {
        /// The instance.
        instance: String,
        /// The transport's word for it.
        cause: String,
    },
    /// A service could not be opened or created.
    #[error(
        "cannot open service `{service}`: {cause}; do all processes of this instance run the same version with the \
         same configuration?"
    )]
    Service {
        /// Its name.
        service: String,
        /// The transport's word for it.
        cause: String,
    },
    /// A port could not be created: as a rule because another process has taken the service's last one.
    #[error("cannot attach to service `{service}`: {cause}; does another process of this role run already?")]
    Port {
        /// The service's name.
        service: String,
        /// The transport's word for it.
        cause: String,
    },
    /// A message could not be sent, received or waited for.
    #[error("{action} on `{service}` failed: {cause}")]
    Transfer {
        /// What was tried.
        action: &'static str,
        /// The service's name.
        service: String,
        /// The transport's word for it.
        cause: String,
    },
}

impl IpcError {
    /// Whether as many programs as can be have joined: one of them may leave in a moment.
    #[must_use]
    pub fn is_crowded(&self) -> bool {
        match self {
            Self::Service { cause, .. } | Self::Port { cause, .. } => cause.contains("Exceeds"),
            _ => false,
        }
    }

    /// Whether who makes it has not done so yet, or is about to.
    #[must_use]
    pub fn is_too_early(&self) -> bool {
        match self {
            Self::Service { cause, .. } => ["DoesNotExist", "HangsInCreation", "IsMarkedForDestruction"]
                .iter()
                .any(|e| cause.contains(e)),
            _ => false,
        }
    }

    /// The operation that failed, with the resource that is exhausted, where one is.
    pub(super) fn scarce_or(action: impl FnOnce() -> String, cause: &str, otherwise: Self) -> Self {
        match Scarcity::found() {
            Some(scarcity) => Self::Scarce { action: action(), scarcity, cause: cause.into() },
            None => otherwise,
        }
    }
}
