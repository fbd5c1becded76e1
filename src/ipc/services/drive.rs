//! The ends of the services of an external drive.

use super::{Channel, DRIVE_BUFFER, DRIVE_RECORDER_BUFFER, IpcError, Services};
use crate::ipc::{DrivePresence, QuietSender, Receiver, Sender, WakeListener};
use crate::messages::{DriveCommandMsg, DriveStateMsg, DriveTextMsg};

/// Texts of an external drive that wait for their reader. Chosen by hand: there are some in a run, and control reads them in every tick.
pub(super) const TEXT_BUFFER: usize = 16;

impl Services {
    /// Control's end of `drive/command`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn drive_command_sender(&self) -> Result<Sender<DriveCommandMsg>, IpcError> {
        self.sender(Channel::DriveCommand, DRIVE_RECORDER_BUFFER)
    }

    /// An external drive's end of `drive/command`, and the waker that rings with it. To be made before that of
    /// `drive/state`: with both, the drive counts as present.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn drive_command_receiver(&self) -> Result<(Receiver<DriveCommandMsg>, WakeListener), IpcError> {
        let receiver = self.receiver(Channel::DriveCommand, DRIVE_RECORDER_BUFFER, DRIVE_BUFFER)?;
        Ok((receiver, self.wake_listener(Channel::DriveCommand)?))
    }

    /// An external drive's end of `drive/state`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn drive_state_sender(&self) -> Result<Sender<DriveStateMsg>, IpcError> {
        self.sender(Channel::DriveState, DRIVE_RECORDER_BUFFER)
    }

    /// Control's end of `drive/state`, and the waker that rings with it.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn drive_state_receiver(&self) -> Result<(Receiver<DriveStateMsg>, WakeListener), IpcError> {
        let receiver = self.receiver(Channel::DriveState, DRIVE_RECORDER_BUFFER, DRIVE_BUFFER)?;
        Ok((receiver, self.wake_listener(Channel::DriveState)?))
    }

    /// The look-out for an external drive.
    ///
    /// # Errors
    /// When a service cannot be opened.
    pub fn drive_presence(&self) -> Result<DrivePresence, IpcError> {
        let states = self.publish_subscribe::<DriveStateMsg>(Channel::DriveState, DRIVE_RECORDER_BUFFER)?;
        let commands =
            self.publish_subscribe::<DriveCommandMsg>(Channel::DriveCommand, DRIVE_RECORDER_BUFFER)?;
        Ok(DrivePresence::new(states, commands, self.node.config().clone()))
    }

    /// An external drive's end of `drive/text`. Nothing rings: a state follows that does.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn drive_text_sender(&self) -> Result<QuietSender<DriveTextMsg>, IpcError> {
        self.quiet_sender(Channel::DriveText, TEXT_BUFFER)
    }

    /// The end of `drive/text` of control, and of a recorder.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn drive_text_receiver(&self) -> Result<Receiver<DriveTextMsg>, IpcError> {
        self.receiver(Channel::DriveText, TEXT_BUFFER, TEXT_BUFFER)
    }
}
