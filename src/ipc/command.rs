//! Requests to control and its answers: the two ends of `control/command`.

use super::channel::Channel;
use super::ports::{transfer, works};
use super::{IpcError, IpcService};
use crate::messages::{ControlAnswer, ControlCommand};
use iceoryx2::active_request::ActiveRequest;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::port::server::Server;

/// Control's end.
#[derive(Debug)]
pub struct CommandServer(Server<IpcService, ControlCommand, (), ControlAnswer, ()>);

/// A command that waits for its answer.
#[derive(Debug)]
pub struct Asked(ActiveRequest<IpcService, ControlCommand, (), ControlAnswer, ()>);

/// A command of this process that waits for its answer.
#[derive(Debug)]
pub struct Pending(PendingResponse<IpcService, ControlCommand, (), ControlAnswer, ()>);

/// The client's end.
#[derive(Debug)]
pub struct CommandClient(Client<IpcService, ControlCommand, (), ControlAnswer, ()>);

impl CommandServer {
    pub(super) fn new(port: Server<IpcService, ControlCommand, (), ControlAnswer, ()>) -> Self {
        Self(port)
    }

    /// The next command; `None` when there is none.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn receive(&self) -> Result<Option<Asked>, IpcError> {
        works("receiving", Channel::Command)?;
        Ok(self.0.receive().map_err(|e| transfer("receiving", Channel::Command, e))?.map(Asked))
    }
}

impl Asked {
    /// What is asked.
    #[must_use]
    pub fn command(&self) -> ControlCommand {
        *self.0.payload()
    }

    /// Answers. Whoever asked may have gone: then nobody hears it.
    pub fn answer(self, answer: &ControlAnswer) {
        let _ = self.0.send_copy(*answer);
    }
}

impl CommandClient {
    pub(super) fn new(port: Client<IpcService, ControlCommand, (), ControlAnswer, ()>) -> Self {
        Self(port)
    }

    /// Asks.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn ask(&self, command: ControlCommand) -> Result<Pending, IpcError> {
        let sent = self.0.send_copy(command).map_err(|e| transfer("sending", Channel::Command, e))?;
        Ok(Pending(sent))
    }
}

impl Pending {
    /// The answer; `None` as long as there is none.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn answer(&self) -> Result<Option<ControlAnswer>, IpcError> {
        let answer = self.0.receive().map_err(|e| transfer("receiving", Channel::Command, e))?;
        Ok(answer.map(|answer| *answer))
    }
}
