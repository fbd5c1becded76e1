//! `camera/N/image`: images that another program gives to the camera process, which alone takes them.

use super::channel::Channel;
use super::ports::{WakeListener, WakeNotifier, transfer, works};
use super::{IpcError, IpcService, PubSub};
use crate::messages::ImageHeader;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use std::time::Duration;

/// The camera's end.
#[derive(Debug)]
pub struct ImagePorts {
    service: Channel,
    made: PubSub<[u8], ImageHeader>,
    port: Subscriber<IpcService, [u8], ImageHeader>,
    listener: WakeListener,
}

impl ImagePorts {
    pub(super) fn new(
        service: Channel,
        made: PubSub<[u8], ImageHeader>,
        port: Subscriber<IpcService, [u8], ImageHeader>,
        listener: WakeListener,
    ) -> Self {
        Self { service, made, port, listener }
    }

    /// Waits until an image may be there, or for `longest`.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn wait(&self, longest: Duration) -> Result<(), IpcError> {
        self.listener.wait(longest)
    }

    /// The oldest waiting image; the service keeps a few, and drops older ones.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn receive(&self) -> Result<Option<ReceivedImage>, IpcError> {
        works("receiving", self.service)?;
        let sample = self.port.receive().map_err(|e| transfer("receiving", self.service, e))?;
        Ok(sample.map(|sample| ReceivedImage { sample }))
    }

    /// Whether a program is there that may send.
    #[must_use]
    pub fn has_sender(&self) -> bool {
        self.made.dynamic_config().number_of_publishers() > 0
    }
}

/// An image where it lies in shared memory; given back when dropped.
#[derive(Debug)]
pub struct ReceivedImage {
    sample: Sample<IpcService, [u8], ImageHeader>,
}

impl ReceivedImage {
    /// What its program says of it; a copy, which that program cannot change any more.
    #[must_use]
    pub fn header(&self) -> ImageHeader {
        *self.sample.user_header()
    }

    /// Its bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.sample.payload()
    }
}

/// The program's end.
#[derive(Debug)]
pub struct ImageSender {
    service: Channel,
    port: Publisher<IpcService, [u8], ImageHeader>,
    notifier: WakeNotifier,
}

impl ImageSender {
    pub(super) fn new(
        service: Channel,
        port: Publisher<IpcService, [u8], ImageHeader>,
        notifier: WakeNotifier,
    ) -> Self {
        Self { service, port, notifier }
    }

    /// Copies an image into shared memory, hands it over and wakes the camera process.
    ///
    /// # Errors
    /// When the transport fails, or the image has more bytes than was said at the beginning.
    pub fn send(&self, header: ImageHeader, bytes: &[u8]) -> Result<(), IpcError> {
        let failed = |e: &dyn std::fmt::Debug| transfer("sending", self.service, e);
        let loan = self.port.loan_slice_uninit(bytes.len()).map_err(|e| failed(&e))?;
        let mut sample = loan.write_from_slice(bytes);
        *sample.user_header_mut() = header;
        sample.send().map_err(|e| failed(&e))?;
        self.notifier.notify()
    }
}
