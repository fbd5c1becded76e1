//! A recorder's ends of the services. Nothing rings: it is to look often enough for their buffers.

use super::{
    Channel, DRIVE_RECORDER_BUFFER, IpcError, JOINT_STATE_BUFFER, MEASUREMENT_BUFFER, STATUS_RECORDER_BUFFER,
    Services, TRACE_BUFFER, port_error,
};
use crate::ipc::{FrameShape, QuietFrameReceiver, QuietSender, Receiver};
use crate::messages::{
    CameraId, DriveCommandMsg, DriveStateMsg, JointState, Measurement, RequestMsg, Status, TraceMsg,
};
use iceoryx2::prelude::{BackpressureStrategy, ZeroCopySend};
use std::fmt::Debug;

/// Requests that wait for a recorder: it looks a hundred times a second. Derived: eight clients that ask without a pause, each answered within a tick of a millisecond, are 80 in 10 ms.
pub(super) const REQUEST_BUFFER: usize = 128;

impl Services {
    /// A recorder's end of `camera/N/frame`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn frame_recorder(
        &self,
        camera: CameraId,
        shape: FrameShape,
    ) -> Result<QuietFrameReceiver, IpcError> {
        self.quiet_frame_receiver(camera, shape, shape.buffer())
    }

    /// A recorder's end of `control/trace`. Nothing rings: it is to look often enough for its buffer of 1024 ticks.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn trace_receiver(&self) -> Result<Receiver<TraceMsg>, IpcError> {
        self.receiver(Channel::Trace, TRACE_BUFFER, TRACE_BUFFER)
    }

    /// Control's end of `control/request`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn request_sender(&self) -> Result<QuietSender<RequestMsg>, IpcError> {
        self.quiet_sender(Channel::Request, REQUEST_BUFFER)
    }

    /// A recorder's end of `control/request`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn request_recorder(&self) -> Result<Receiver<RequestMsg>, IpcError> {
        self.receiver(Channel::Request, REQUEST_BUFFER, REQUEST_BUFFER)
    }

    /// Control's end of `control/trace`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn trace_sender(&self) -> Result<QuietSender<TraceMsg>, IpcError> {
        self.quiet_sender(Channel::Trace, TRACE_BUFFER)
    }

    /// An end that sends where somebody listens.
    pub(super) fn quiet_sender<T: ZeroCopySend + Debug + Copy>(
        &self,
        service: Channel,
        buffer: usize,
    ) -> Result<QuietSender<T>, IpcError> {
        let made = self.publish_subscribe(service, buffer)?;
        let port = made
            .publisher_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|e| port_error(service, e))?;
        Ok(QuietSender::new(service, made, port))
    }

    /// A recorder's end of `control/status`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn status_recorder(&self) -> Result<Receiver<Status>, IpcError> {
        self.receiver(Channel::Status, STATUS_RECORDER_BUFFER, STATUS_RECORDER_BUFFER)
    }

    /// A recorder's end of `vision/N/measurement`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn measurement_recorder(&self, camera: CameraId) -> Result<Receiver<Measurement>, IpcError> {
        self.receiver(Channel::Measurement(camera), MEASUREMENT_BUFFER, MEASUREMENT_BUFFER)
    }

    /// A recorder's end of `control/joint_state`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn joint_state_recorder(&self) -> Result<Receiver<JointState>, IpcError> {
        self.receiver(Channel::JointState, JOINT_STATE_BUFFER, JOINT_STATE_BUFFER)
    }

    /// A recorder's ends of `drive/command` and `drive/state`.
    ///
    /// # Errors
    /// When a service or a port cannot be made.
    pub fn drive_recorders(&self) -> Result<(Receiver<DriveCommandMsg>, Receiver<DriveStateMsg>), IpcError> {
        let (limit, buffer) = (DRIVE_RECORDER_BUFFER, DRIVE_RECORDER_BUFFER);
        Ok((
            self.receiver(Channel::DriveCommand, limit, buffer)?,
            self.receiver(Channel::DriveState, limit, buffer)?,
        ))
    }
}
