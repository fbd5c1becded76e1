//! Both ends of `camera/N/image`.

use super::{Channel, IpcError, MAX_NODES, Services, name, port_error, service_error};
use crate::ipc::PubSub;
use crate::ipc::image_ports::{ImagePorts, ImageSender};
use crate::messages::{CameraId, ImageHeader};
use iceoryx2::prelude::{AllocationStrategy, BackpressureStrategy};

/// Images that wait for the camera process, which takes the newest. Chosen by hand, as many as buffers of a V4L2 camera: it is held up by one
/// conversion at most, and a gap in the numbers tells of those that were dropped.
const IMAGE_BUFFER: usize = 4;
/// The newest image, which is held while it is looked for a newer one.
const MOST_HELD: usize = 2;

impl Services {
    /// The camera process's end of `camera/N/image`.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn image_ports(&self, camera: CameraId) -> Result<ImagePorts, IpcError> {
        let service = Channel::Image(camera);
        let made = self.images(camera)?;
        let port = made
            .subscriber_builder()
            .buffer_size(IMAGE_BUFFER)
            .create()
            .map_err(|e| port_error(service, e))?;
        Ok(ImagePorts::new(service, made, port, self.wake_listener(service)?))
    }

    /// The end of the program that gives images of at most `bytes` bytes.
    ///
    /// # Errors
    /// When the service or the port cannot be made.
    pub fn image_sender(&self, camera: CameraId, bytes: usize) -> Result<ImageSender, IpcError> {
        let service = Channel::Image(camera);
        let port = self
            .images(camera)?
            .publisher_builder()
            .initial_max_slice_len(bytes)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|e| port_error(service, e))?;
        Ok(ImageSender::new(service, port, self.notifier(service)?))
    }

    fn images(&self, camera: CameraId) -> Result<PubSub<[u8], ImageHeader>, IpcError> {
        let service = Channel::Image(camera);
        self.node
            .service_builder(&name(service)?)
            .publish_subscribe::<[u8]>()
            .user_header::<ImageHeader>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(IMAGE_BUFFER)
            .subscriber_max_borrowed_samples(MOST_HELD)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(1)
            .max_nodes(MAX_NODES)
            .open_or_create()
            .map_err(|e| service_error(service, e))
    }
}
