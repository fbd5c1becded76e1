//! Every service of an instance, with its limits, in one place: the process that comes first creates it, the others
//! open it, and all must ask for the same.

mod drive;
mod image;
mod recorder;
mod viewer;

pub use viewer::DriveViews;

use super::caretaker::Caretaker;
use super::channel::Channel;
use super::command::{CommandClient, CommandServer};
use super::frame_shape::{FrameShape, MAX_READERS, readers};
use super::ports::{
    FrameReceiver, FrameSender, QuietFrameReceiver, Receiver, Sender, WakeListener, WakeNotifier,
};
use super::presence::{PeerPresence, type_of, type_of_service};
use super::{Instance, InstanceError, IpcError, Node, PubSub};
use crate::messages::{
    CameraHealth, CameraId, ControlAnswer, ControlCommand, FrameHeader, JointState, Measurement, Status,
};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use std::fmt::Debug;

/// Processes that may open a service. Chosen by hand, as the transport needs a number: a run has at most eight of its own, others are clients.
const MAX_NODES: usize = 16;
/// Clients that may wait for an answer of control at the same time. Chosen by hand; others wait for a free slot.
pub const MAX_CLIENTS: usize = 8;
/// Ticks of joint state that a reader may lag behind, because the camera looks back by its exposure and its latency, which is 500 ms at most.
const JOINT_STATE_BUFFER: usize = 1024;
/// Ticks that a recorder may lag behind: a second, so that a write to a slow disk loses none. Chosen by hand: twice takes 2.6 MB more.
const TRACE_BUFFER: usize = 1024;
/// Measurements in flight in lockstep, where none must be lost; more than any latency at any rate.
const MEASUREMENT_BUFFER: usize = 1024;
/// Changes of a camera's health that wait for their reader. Chosen by hand: they come a few times a second at most, and are read every tick.
const HEALTH_BUFFER: usize = 16;
/// Commands and states of an external drive that wait for their reader: 64 ticks. Chosen by hand: a reader that lags more must have stopped.
const DRIVE_BUFFER: usize = 64;
/// The same for a recorder: a second, as traces have it.
const DRIVE_RECORDER_BUFFER: usize = 1024;
/// States of a run that wait for a recorder: a second at 50 Hz, as traces have it, with some to spare; views take the newest alone.
const STATUS_RECORDER_BUFFER: usize = 64;

type EventService = iceoryx2::service::port_factory::event::PortFactory<ipc::Service>;
type CommandService = iceoryx2::service::port_factory::request_response::PortFactory<
    ipc::Service,
    ControlCommand,
    (),
    ControlAnswer,
    (),
>;

/// A process's membership in an instance. Its ports belong to the thread that made them.
#[derive(Debug)]
pub struct Services {
    node: Node,
    instance: Instance,
    /// Goes after the node, which may meet half-made segments while it leaves.
    _caretaker: Caretaker,
}

impl Services {
    /// Joins `instance`.
    ///
    /// # Errors
    /// When the name is refused or shared memory is not usable.
    pub fn join(instance: &Instance) -> Result<Self, IpcError> {
        let failed = |cause: String| {
            let action = || format!("joining instance `{instance}`");
            let node = IpcError::Node { instance: instance.to_string(), cause: cause.clone() };
            IpcError::scarce_or(action, &cause, node)
        };
        let config = instance.transport_config().map_err(|e: InstanceError| failed(e.to_string()))?;
        // Before, so that nothing foreign is opened; after, for what came in between.
        instance.check_place()?;
        let caretaker = instance.take_care().map_err(|e| failed(e.to_string()))?;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| failed(e.to_string()))?;
        instance.check_place()?;
        Ok(Self { node, instance: instance.clone(), _caretaker: caretaker })
    }

    /// The camera's end of `camera/N/frame`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn frame_sender(&self, camera: CameraId, shape: FrameShape) -> Result<FrameSender, IpcError> {
        let service = Channel::Frame(camera);
        let port = self
            .frames(camera, shape)?
            .publisher_builder()
            .initial_max_slice_len(shape.bytes)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(shape.held_back)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|e| port_error(service, e))?;
        Ok(FrameSender::new(service, port, self.notifier(service)?))
    }

    /// Vision's end of `camera/N/frame`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn frame_receiver(&self, camera: CameraId, shape: FrameShape) -> Result<FrameReceiver, IpcError> {
        let frames = self.quiet_frame_receiver(camera, shape, shape.in_flight)?;
        Ok(FrameReceiver::new(frames, self.wake_listener(Channel::Frame(camera))?))
    }

    fn quiet_frame_receiver(
        &self,
        camera: CameraId,
        shape: FrameShape,
        buffer: usize,
    ) -> Result<QuietFrameReceiver, IpcError> {
        let service = Channel::Frame(camera);
        let port = self
            .frames(camera, shape)?
            .subscriber_builder()
            .buffer_size(buffer)
            .create()
            .map_err(|e| port_error(service, e))?;
        Ok(QuietFrameReceiver::new(service, port))
    }

    /// A real camera's end of `camera/N/health`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn health_sender(&self, camera: CameraId) -> Result<Sender<CameraHealth>, IpcError> {
        self.sender(Channel::Health(camera), HEALTH_BUFFER)
    }

    /// Control's end of `camera/N/health`. Nothing rings.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn health_receiver(&self, camera: CameraId) -> Result<Receiver<CameraHealth>, IpcError> {
        self.receiver(Channel::Health(camera), HEALTH_BUFFER, HEALTH_BUFFER)
    }

    /// Vision's end of `vision/N/measurement`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn measurement_sender(&self, camera: CameraId) -> Result<Sender<Measurement>, IpcError> {
        self.sender(Channel::Measurement(camera), MEASUREMENT_BUFFER)
    }

    /// Control's end of `vision/N/measurement`, and the waker that rings with it.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn measurement_receiver(
        &self,
        camera: CameraId,
    ) -> Result<(Receiver<Measurement>, WakeListener), IpcError> {
        let service = Channel::Measurement(camera);
        let receiver = self.receiver(service, MEASUREMENT_BUFFER, MEASUREMENT_BUFFER)?;
        Ok((receiver, self.wake_listener(service)?))
    }

    /// Control's end of `control/joint_state`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn joint_state_sender(&self) -> Result<Sender<JointState>, IpcError> {
        self.sender(Channel::JointState, JOINT_STATE_BUFFER)
    }

    /// The camera's end of `control/joint_state`, and the waker that rings with it.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn joint_state_receiver(&self) -> Result<(Receiver<JointState>, WakeListener), IpcError> {
        let receiver = self.receiver(Channel::JointState, JOINT_STATE_BUFFER, JOINT_STATE_BUFFER)?;
        Ok((receiver, self.wake_listener(Channel::JointState)?))
    }

    /// Control's end of `control/status`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn status_sender(&self) -> Result<Sender<Status>, IpcError> {
        self.sender(Channel::Status, STATUS_RECORDER_BUFFER)
    }

    /// A view's end of `control/status`: the newest only.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn status_receiver(&self) -> Result<Receiver<Status>, IpcError> {
        self.receiver(Channel::Status, STATUS_RECORDER_BUFFER, 1)
    }

    /// Control's end of `control/command`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn command_server(&self) -> Result<CommandServer, IpcError> {
        let port = self.commands(true)?.server_builder().create();
        Ok(CommandServer::new(port.map_err(|e| port_error(Channel::Command, e))?))
    }

    /// The client's end of `control/command`. Control alone makes the service: one that a client made and gave up again
    /// while control came to it would be another one than the next client's.
    ///
    /// # Errors
    /// When the service is not there, or the port cannot be made.
    pub fn command_client(&self) -> Result<CommandClient, IpcError> {
        let port = self.commands(false)?.client_builder().create();
        Ok(CommandClient::new(port.map_err(|e| port_error(Channel::Command, e))?))
    }

    /// The look-out for these cameras, for the vision process of the first of them, and for that of the camera `second_vision` beside it.
    ///
    /// # Errors
    /// When a service cannot be opened.
    pub fn peer_presence(
        &self,
        first: (CameraId, FrameShape),
        further: &[(CameraId, FrameShape)],
        second_vision: Option<CameraId>,
    ) -> Result<PeerPresence, IpcError> {
        let frames = std::iter::once(&first).chain(further).map(|(id, shape)| self.frames(*id, *shape));
        let frames = frames.collect::<Result<_, _>>()?;
        let visions = std::iter::once(first.0).chain(second_vision);
        let measurements =
            visions.map(|id| self.publish_subscribe(Channel::Measurement(id), MEASUREMENT_BUFFER));
        Ok(PeerPresence::new(frames, measurements.collect::<Result<_, _>>()?))
    }

    /// Refuses to go on where there is too little left for the connections to the other processes. The transport makes
    /// them while it sends and receives, and says nothing when it cannot: a message would be waited for in vain.
    ///
    /// # Errors
    /// [`InstanceError::Scarce`].
    pub fn require_room_for_peers(&self) -> Result<(), IpcError> {
        Ok(self.instance.require_room()?)
    }

    /// Frees what killed processes held in this instance's services.
    pub fn remove_dead_peers(&self) {
        let _ = self.node.try_cleanup_dead_nodes();
    }

    fn frames(&self, camera: CameraId, shape: FrameShape) -> Result<PubSub<[u8], FrameHeader>, IpcError> {
        let service = Channel::Frame(camera);
        self.node
            .service_builder(&name(service)?)
            .publish_subscribe::<[u8]>()
            .user_header::<FrameHeader>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(shape.buffer())
            .subscriber_max_borrowed_samples(1)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(MAX_READERS)
            .max_nodes(MAX_NODES)
            .open_or_create()
            .map_err(|e| service_error(service, e))
    }

    fn commands(&self, make: bool) -> Result<CommandService, IpcError> {
        let builder = self
            .node
            .service_builder(&name(Channel::Command)?)
            .request_response::<ControlCommand, ControlAnswer>()
            .max_servers(1)
            .max_clients(MAX_CLIENTS)
            .max_active_requests_per_client(1)
            .max_response_buffer_size(1)
            .max_nodes(MAX_NODES);
        if make {
            builder.open_or_create().map_err(|e| service_error(Channel::Command, e))
        } else {
            builder.open().map_err(|e| service_error(Channel::Command, e))
        }
    }

    fn publish_subscribe<T: ZeroCopySend + Debug>(
        &self,
        service: Channel,
        buffer: usize,
    ) -> Result<PubSub<T>, IpcError> {
        self.node
            .service_builder(&name(service)?)
            .publish_subscribe::<T>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(buffer)
            .subscriber_max_borrowed_samples(1)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(readers(service))
            .max_nodes(MAX_NODES)
            .open_or_create()
            .map_err(|e| self.open_error::<T>(service, e))
    }

    /// Why a service could not be opened; where its records are of another type, which.
    fn open_error<T: ZeroCopySend>(
        &self,
        service: Channel,
        cause: PublishSubscribeOpenOrCreateError,
    ) -> IpcError {
        use PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError as Open;
        if !matches!(cause, Open(PublishSubscribeOpenError::IncompatibleTypes)) {
            return service_error(service, cause);
        }
        let found = name(service).ok().and_then(|name| type_of_service(&name, self.node.config()));
        let found = found.unwrap_or_else(|| "records of another type".into());
        IpcError::Type { service: service.to_string(), found, expected: type_of::<T>() }
    }

    fn sender<T: ZeroCopySend + Debug + Copy>(
        &self,
        service: Channel,
        buffer: usize,
    ) -> Result<Sender<T>, IpcError> {
        let port = self
            .publish_subscribe::<T>(service, buffer)?
            .publisher_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|e| port_error(service, e))?;
        Ok(Sender::new(service, port, self.notifier(service)?))
    }

    fn receiver<T: ZeroCopySend + Debug + Copy>(
        &self,
        service: Channel,
        limit: usize,
        buffer: usize,
    ) -> Result<Receiver<T>, IpcError> {
        let port = self
            .publish_subscribe::<T>(service, limit)?
            .subscriber_builder()
            .buffer_size(buffer)
            .create()
            .map_err(|e| port_error(service, e))?;
        Ok(Receiver::new(service, port))
    }

    fn notifier(&self, service: Channel) -> Result<WakeNotifier, IpcError> {
        let port: Notifier<ipc::Service> =
            self.event(service)?.notifier_builder().create().map_err(|e| port_error(service, e))?;
        Ok(WakeNotifier::new(service, port))
    }

    fn wake_listener(&self, service: Channel) -> Result<WakeListener, IpcError> {
        let port: Listener<ipc::Service> =
            self.event(service)?.listener_builder().create().map_err(|e| port_error(service, e))?;
        Ok(WakeListener::new(service, port))
    }

    fn event(&self, service: Channel) -> Result<EventService, IpcError> {
        self.node
            .service_builder(&name(service)?)
            .event()
            .max_notifiers(1)
            .max_listeners(MAX_READERS)
            .max_nodes(MAX_NODES)
            .open_or_create()
            .map_err(|e| service_error(service, e))
    }

    /// The instance that was joined.
    #[must_use]
    pub fn instance(&self) -> &Instance {
        &self.instance
    }
}

fn name(service: Channel) -> Result<ServiceName, IpcError> {
    service.to_string().as_str().try_into().map_err(|e| service_error(service, e))
}

fn service_error(service: Channel, cause: impl Debug) -> IpcError {
    let cause = format!("{cause:?}");
    let otherwise = IpcError::Service { service: service.to_string(), cause: cause.clone() };
    IpcError::scarce_or(|| format!("opening service `{service}`"), &cause, otherwise)
}

fn port_error(service: Channel, cause: impl Debug) -> IpcError {
    let cause = format!("{cause:?}");
    let otherwise = IpcError::Port { service: service.to_string(), cause: cause.clone() };
    IpcError::scarce_or(|| format!("attaching to service `{service}`"), &cause, otherwise)
}
