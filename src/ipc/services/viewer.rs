//! A view's ends of the services: of a run that is watched. They get what others get, and one place of each service is left free, so that however many
//! watch, a recorder still finds one.

use super::drive::TEXT_BUFFER;
use super::recorder::REQUEST_BUFFER;
use super::{
    Channel, DRIVE_RECORDER_BUFFER, HEALTH_BUFFER, IpcError, JOINT_STATE_BUFFER, MEASUREMENT_BUFFER,
    STATUS_RECORDER_BUFFER, Services, TRACE_BUFFER, port_error,
};
use crate::ipc::frame_shape::MAX_READERS;
use crate::ipc::{FrameShape, QuietFrameReceiver, Receiver};
use crate::messages::{
    CameraHealth, CameraId, DriveCommandMsg, DriveStateMsg, DriveTextMsg, JointState, Measurement,
    RequestMsg, Status, TraceMsg,
};
use iceoryx2::prelude::{PortFactory, ZeroCopySend};
use std::fmt::Debug;

/// Measurements that wait for a view. Chosen by hand: more than half a second of any camera that the tests know, and views look twenty times a second.
const VIEW_BUFFER: usize = 64;

/// A view's ends of the services of an external drive.
#[derive(Debug)]
pub struct DriveViews {
    /// That of `drive/command`.
    pub commands: Receiver<DriveCommandMsg>,
    /// That of `drive/state`.
    pub states: Receiver<DriveStateMsg>,
    /// That of `drive/text`.
    pub texts: Receiver<DriveTextMsg>,
}

impl Services {
    /// A view's end of `control/status`: the newest only.
    ///
    /// # Errors
    /// When the service or the port cannot be made, or as many read it as may; so for all that follow.
    pub fn status_view(&self) -> Result<Receiver<Status>, IpcError> {
        self.view(Channel::Status, STATUS_RECORDER_BUFFER, 1)
    }

    /// The same with those before it, for half a second.
    ///
    /// # Errors
    /// As for [`Self::status_view`].
    pub fn statuses_view(&self) -> Result<Receiver<Status>, IpcError> {
        self.view(Channel::Status, STATUS_RECORDER_BUFFER, STATUS_RECORDER_BUFFER)
    }

    /// A view's end of `control/joint_state`, of which it may lag behind by 1024 ticks.
    ///
    /// # Errors
    /// As for [`Self::status_view`].
    pub fn joint_state_view(&self) -> Result<Receiver<JointState>, IpcError> {
        self.view(Channel::JointState, JOINT_STATE_BUFFER, JOINT_STATE_BUFFER)
    }

    /// A view's end of `control/trace`, of which it may lag behind by 1024 ticks.
    ///
    /// # Errors
    /// As for [`Self::status_view`].
    pub fn trace_view(&self) -> Result<Receiver<TraceMsg>, IpcError> {
        self.view(Channel::Trace, TRACE_BUFFER, TRACE_BUFFER)
    }

    /// A view's end of `vision/N/measurement`.
    ///
    /// # Errors
    /// As for [`Self::status_view`].
    pub fn measurement_view(&self, camera: CameraId) -> Result<Receiver<Measurement>, IpcError> {
        self.view(Channel::Measurement(camera), MEASUREMENT_BUFFER, VIEW_BUFFER)
    }

    /// A view's end of `camera/N/health`.
    ///
    /// # Errors
    /// As for [`Self::status_view`].
    pub fn health_view(&self, camera: CameraId) -> Result<Receiver<CameraHealth>, IpcError> {
        self.view(Channel::Health(camera), HEALTH_BUFFER, HEALTH_BUFFER)
    }

    /// A view's end of `control/request`.
    ///
    /// # Errors
    /// As for [`Self::status_view`].
    pub fn request_view(&self) -> Result<Receiver<RequestMsg>, IpcError> {
        self.view(Channel::Request, REQUEST_BUFFER, REQUEST_BUFFER)
    }

    /// A view's ends of `drive/command`, `drive/state` and `drive/text`; `None` where it would leave no place to a recorder, and until `own` of the run's processes have
    /// theirs, which nobody who watches may take.
    ///
    /// # Errors
    /// When a service or a port cannot be made.
    pub fn drive_views(&self, own: usize) -> Result<Option<DriveViews>, IpcError> {
        let (limit, commands, states) = (DRIVE_RECORDER_BUFFER, Channel::DriveCommand, Channel::DriveState);
        let readers = [
            self.publish_subscribe::<DriveCommandMsg>(commands, limit)?
                .dynamic_config()
                .number_of_subscribers(),
            self.publish_subscribe::<DriveStateMsg>(states, limit)?.dynamic_config().number_of_subscribers(),
        ];
        let texts = self.publish_subscribe::<DriveTextMsg>(Channel::DriveText, TEXT_BUFFER)?;
        let texts = texts.dynamic_config().number_of_subscribers();
        let (most, places) = (readers[0].max(readers[1]).max(texts), RECORDERS);
        if readers.iter().any(|count| *count < own) || most + places >= MAX_READERS {
            return Ok(None);
        }
        Ok(Some(DriveViews {
            commands: self.receiver(commands, limit, limit)?,
            states: self.receiver(states, limit, limit)?,
            texts: self.receiver(Channel::DriveText, TEXT_BUFFER, TEXT_BUFFER)?,
        }))
    }

    /// A view's end of `camera/N/frame`: the newest only.
    ///
    /// # Errors
    /// As for [`Self::status_view`].
    pub fn frame_view(&self, camera: CameraId, shape: FrameShape) -> Result<QuietFrameReceiver, IpcError> {
        let readers = self.frames(camera, shape)?.dynamic_config().number_of_subscribers();
        leave_a_place(Channel::Frame(camera), readers)?;
        self.quiet_frame_receiver(camera, shape, 1)
    }

    fn view<T: ZeroCopySend + Debug + Copy>(
        &self,
        service: Channel,
        limit: usize,
        buffer: usize,
    ) -> Result<Receiver<T>, IpcError> {
        let readers = self.publish_subscribe::<T>(service, limit)?.dynamic_config().number_of_subscribers();
        leave_a_place(service, readers)?;
        self.receiver(service, limit, buffer)
    }
}

/// Places that who watches leaves: a recorder and a black box may come.
const RECORDERS: usize = 2;

/// Refuses where `readers` would leave no place to a recorder.
fn leave_a_place(service: Channel, readers: usize) -> Result<(), IpcError> {
    if readers + RECORDERS < MAX_READERS {
        return Ok(());
    }
    let why = format!("ExceedsMaxSupportedSubscribers: {readers} read it, and a place is left to a recorder");
    Err(port_error(service, why))
}
