//! What can fail between processes.

use thiserror::Error;

/// A shared-memory operation failed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum IpcError {
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
        service: &'static str,
        /// The transport's word for it.
        cause: String,
    },
}
