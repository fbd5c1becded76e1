//! The few kinds of ports that processes use. A sender with readers notifies them; a reader waits for it at most
//! as long as it says, and then takes everything there is: an event is not a sample.

use super::channel::Channel;
use super::{IpcError, IpcService, PubSub, Spin};
use crate::messages::FrameHeader;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use std::fmt::Debug;
use std::os::fd::BorrowedFd;
use std::time::Duration;

/// What the ports of this thread meet, where a test wants it: a service that fails.
#[cfg(test)]
pub(crate) mod breakage {
    use super::Channel;
    use std::cell::RefCell;

    type Fails = Box<dyn FnMut(Channel) -> bool>;

    thread_local! {
        static FAILS: RefCell<Option<Fails>> = const { RefCell::new(None) };
    }

    /// From now on every use of a port by this thread fails for which `fails` says so.
    pub(crate) fn set(fails: impl FnMut(Channel) -> bool + 'static) {
        FAILS.with_borrow_mut(|f| *f = Some(Box::new(fails)));
    }

    pub(super) fn is_of(service: Channel) -> bool {
        FAILS.with_borrow_mut(|f| f.as_mut().is_some_and(|fails| fails(service)))
    }
}

/// Fails where a test wants it.
#[cfg_attr(not(test), inline(always))]
pub(super) fn works(action: &'static str, service: Channel) -> Result<(), IpcError> {
    #[cfg(test)]
    if breakage::is_of(service) {
        return Err(transfer(action, service, "broken by a test"));
    }
    let _ = (action, service);
    Ok(())
}

/// Wakes readers.
#[derive(Debug)]
pub struct WakeNotifier {
    service: Channel,
    port: Notifier<IpcService>,
}

impl WakeNotifier {
    pub(super) fn new(service: Channel, port: Notifier<IpcService>) -> Self {
        Self { service, port }
    }

    /// Wakes all readers.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn notify(&self) -> Result<(), IpcError> {
        works("waking the readers", self.service)?;
        self.port.notify().map(|_| ()).map_err(|e| transfer("waking the readers", self.service, e))
    }
}

/// Is woken by a [`WakeNotifier`].
#[derive(Debug)]
pub struct WakeListener {
    service: Channel,
    port: Listener<IpcService>,
}

impl WakeListener {
    pub(super) fn new(service: Channel, port: Listener<IpcService>) -> Self {
        Self { service, port }
    }

    /// Waits until it is notified, or for `longest`.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn wait(&self, longest: Duration) -> Result<(), IpcError> {
        works("waiting", self.service)?;
        let is_notified =
            self.is_notified_within(longest).map_err(|e| transfer("waiting", self.service, e))?;
        if is_notified { self.take_notifications() } else { Ok(()) }
    }

    /// The wait of the transport itself leaves its time limit to the socket, where the kernel counts in ticks of its scheduler: 1 ms was 8 ms where those are
    /// 4 ms long. `poll` has a timer of its own, exact to 50 us.
    #[allow(unsafe_code)]
    fn is_notified_within(&self, longest: Duration) -> Result<bool, Errno> {
        // SAFETY: the port keeps its descriptor open as long as it lives, and nobody closes it here.
        let socket = unsafe { BorrowedFd::borrow_raw(self.port.file_descriptor().native_handle()) };
        let longest = Timespec { tv_sec: longest.as_secs() as i64, tv_nsec: longest.subsec_nanos().into() };
        match poll(&mut [PollFd::from_borrowed_fd(socket, PollFlags::IN)], Some(&longest)) {
            Ok(ready) => Ok(ready > 0),
            // A signal ends the wait early; whoever waits looks at its stop flag next.
            Err(Errno::INTR) => Ok(false),
            Err(e) => Err(e),
        }
    }

    fn take_notifications(&self) -> Result<(), IpcError> {
        match self.port.try_wait(|_| {}) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(e) => Err(transfer("waiting", self.service, e)),
        }
    }

    /// Waits until `ready`, or until it is notified, or for `longest`; spins first, as far as `spin` allows.
    ///
    /// # Errors
    /// When the transport fails, or that of `ready`.
    pub fn wait_spinning(
        &self,
        longest: Duration,
        spin: &mut Spin,
        ready: impl FnMut() -> Result<bool, IpcError>,
    ) -> Result<(), IpcError> {
        if !spin.until(ready)? {
            return self.wait(longest);
        }
        // Bells that nobody hears would fill their queue. What is sent meanwhile is found with the rest: messages go
        // out before their notification.
        self.take_notifications()
    }
}

/// Sends records.
#[derive(Debug)]
pub struct Sender<T: ZeroCopySend + Debug + Copy + 'static> {
    service: Channel,
    port: Publisher<IpcService, T, ()>,
    notifier: WakeNotifier,
}

impl<T: ZeroCopySend + Debug + Copy + 'static> Sender<T> {
    pub(super) fn new(service: Channel, port: Publisher<IpcService, T, ()>, notifier: WakeNotifier) -> Self {
        Self { service, port, notifier }
    }

    /// Sends without waking anybody.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn send_quietly(&self, message: &T) -> Result<(), IpcError> {
        works("sending", self.service)?;
        let place = self.port.loan_uninit().map_err(|e| transfer("sending", self.service, e))?;
        place.write_payload(*message).send().map(|_| ()).map_err(|e| transfer("sending", self.service, e))
    }

    /// Wakes the readers, for what was sent or is about to be.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn notify(&self) -> Result<(), IpcError> {
        self.notifier.notify()
    }

    /// Sends, and wakes the readers.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn send(&self, message: &T) -> Result<(), IpcError> {
        self.send_quietly(message)?;
        self.notifier.notify()
    }
}

/// Sends records to their readers without waking them; without a reader no record is made.
#[derive(Debug)]
pub struct QuietSender<T: ZeroCopySend + Debug + Copy + 'static> {
    service: Channel,
    made: PubSub<T>,
    port: Publisher<IpcService, T, ()>,
}

impl<T: ZeroCopySend + Debug + Copy + 'static> QuietSender<T> {
    pub(super) fn new(service: Channel, made: PubSub<T>, port: Publisher<IpcService, T, ()>) -> Self {
        Self { service, made, port }
    }

    /// Whether anybody listens. Makes no system call.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        self.made.dynamic_config().number_of_subscribers() > 0
    }

    /// Sends what `make` gives, where anybody listens.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn send(&self, make: impl FnOnce() -> T) -> Result<(), IpcError> {
        if !self.is_heard() {
            return Ok(());
        }
        works("sending", self.service)?;
        let place = self.port.loan_uninit().map_err(|e| transfer("sending", self.service, e))?;
        place.write_payload(make()).send().map(|_| ()).map_err(|e| transfer("sending", self.service, e))
    }
}

/// Receives records.
#[derive(Debug)]
pub struct Receiver<T: ZeroCopySend + Debug + Copy + 'static> {
    service: Channel,
    port: Subscriber<IpcService, T, ()>,
}

impl<T: ZeroCopySend + Debug + Copy + 'static> Receiver<T> {
    pub(super) fn new(service: Channel, port: Subscriber<IpcService, T, ()>) -> Self {
        Self { service, port }
    }

    /// The next record where it lies in shared memory, oldest first; `None` when there is none. One lies there at a time: it is dropped, or copied, before the next.
    ///
    /// # Errors
    /// When the transport fails, or the record before is still held.
    pub fn receive(&self) -> Result<Option<Received<T>>, IpcError> {
        works("receiving", self.service)?;
        let sample = self.port.receive().map_err(|e| transfer("receiving", self.service, e))?;
        Ok(sample.map(|sample| Received { sample }))
    }

    /// Whether a record waits. Makes no system call.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn is_waiting(&self) -> Result<bool, IpcError> {
        self.port.has_samples().map_err(|e| transfer("receiving", self.service, e))
    }

    /// The newest record; older ones are thrown away.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn receive_newest(&self) -> Result<Option<T>, IpcError> {
        let mut newest = None;
        while let Some(next) = self.receive()? {
            newest = Some(*next); // one at a time lies there
        }
        Ok(newest)
    }
}

/// A record where it lies in shared memory; given back when dropped.
#[derive(Debug)]
pub struct Received<T: ZeroCopySend + Debug + 'static> {
    sample: Sample<IpcService, T, ()>,
}

impl<T: ZeroCopySend + Debug> std::ops::Deref for Received<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.sample.payload()
    }
}

/// Sends frames that were filled where they lie.
#[derive(Debug)]
pub struct FrameSender {
    service: Channel,
    port: Publisher<IpcService, [u8], FrameHeader>,
    notifier: WakeNotifier,
}

impl FrameSender {
    pub(super) fn new(
        service: Channel,
        port: Publisher<IpcService, [u8], FrameHeader>,
        notifier: WakeNotifier,
    ) -> Self {
        Self { service, port, notifier }
    }

    /// Borrows a frame of `bytes` in shared memory, to be filled where it lies.
    ///
    /// # Errors
    /// When the transport fails: as many frames are out as the service's shape allows.
    pub fn borrow(&self, bytes: usize) -> Result<BorrowedFrame, IpcError> {
        let loan =
            self.port.loan_slice_uninit(bytes).map_err(|e| transfer("borrowing a frame", self.service, e))?;
        Ok(BorrowedFrame { sample: zeroed(loan) })
    }

    /// Hands a frame over and wakes the readers.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn send(&self, frame: BorrowedFrame, header: FrameHeader) -> Result<(), IpcError> {
        let mut sample = frame.sample;
        *sample.user_header_mut() = header;
        sample.send().map_err(|e| transfer("sending", self.service, e))?;
        self.notifier.notify()
    }
}

/// A frame on its way from borrowing to sending; given back unsent when dropped.
#[derive(Debug)]
pub struct BorrowedFrame {
    sample: iceoryx2::sample_mut::SampleMut<IpcService, [u8], FrameHeader>,
}

impl BorrowedFrame {
    /// Where the pixels go.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        self.sample.payload_mut()
    }
}

/// Declares a loaned frame initialised.
///
/// The segment comes from the kernel as zeroes and holds older frames later on: for bytes every content is valid.
#[allow(unsafe_code)]
fn zeroed(
    loan: iceoryx2::sample_mut_uninit::SampleMutUninit<IpcService, [std::mem::MaybeUninit<u8>], FrameHeader>,
) -> iceoryx2::sample_mut::SampleMut<IpcService, [u8], FrameHeader> {
    // SAFETY: shared memory that the kernel zeroed or that an earlier frame was written to is initialised memory, and
    // every bit pattern is a valid `u8`.
    unsafe { loan.assume_init() }
}

/// A frame where it lies in shared memory; given back when dropped.
#[derive(Debug)]
pub struct ReceivedFrame {
    sample: Sample<IpcService, [u8], FrameHeader>,
}

impl ReceivedFrame {
    /// Stamps and shape.
    #[must_use]
    pub fn header(&self) -> FrameHeader {
        *self.sample.user_header()
    }

    /// The pixels.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        self.sample.payload()
    }
}

/// Receives frames, woken by each.
#[derive(Debug)]
pub struct FrameReceiver {
    frames: QuietFrameReceiver,
    listener: WakeListener,
}

impl FrameReceiver {
    pub(super) fn new(frames: QuietFrameReceiver, listener: WakeListener) -> Self {
        Self { frames, listener }
    }

    /// Waits until a frame may be there, or for `longest`.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn wait(&self, longest: Duration) -> Result<(), IpcError> {
        self.listener.wait(longest)
    }

    /// The oldest waiting frame; the service keeps as many as its shape says, and drops older ones.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn receive(&self) -> Result<Option<ReceivedFrame>, IpcError> {
        self.frames.receive()
    }
}

/// Receives frames; nothing rings.
#[derive(Debug)]
pub struct QuietFrameReceiver {
    service: Channel,
    port: Subscriber<IpcService, [u8], FrameHeader>,
}

impl QuietFrameReceiver {
    pub(super) fn new(service: Channel, port: Subscriber<IpcService, [u8], FrameHeader>) -> Self {
        Self { service, port }
    }

    /// The oldest waiting frame.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn receive(&self) -> Result<Option<ReceivedFrame>, IpcError> {
        let sample = self.port.receive().map_err(|e| transfer("receiving", self.service, e))?;
        Ok(sample.map(|sample| ReceivedFrame { sample }))
    }
}

pub(super) fn transfer(action: &'static str, service: Channel, cause: impl Debug) -> IpcError {
    let cause = format!("{cause:?}");
    let otherwise = IpcError::Transfer { action, service: service.to_string(), cause: cause.clone() };
    IpcError::scarce_or(|| format!("{action} on `{service}`"), &cause, otherwise)
}

#[cfg(test)]
mod tests {
    use crate::ipc::{Instance, Services};
    use crate::messages::DriveCommandMsg;
    use crate::rt::now;
    use crate::time::SpanNs;
    use std::time::Duration;

    /// A loaded machine may wake late, but not each time: what the kernel rounds up, it rounds up always.
    #[test]
    fn waits_end_when_they_should_and_with_a_message_at_once() {
        let instance: Instance = format!("wait-{}", std::process::id()).parse().unwrap();
        let services = Services::join(&instance).unwrap();
        let (commands, listener) = services.drive_command_receiver().unwrap();
        let sender = services.drive_command_sender().unwrap();
        let shortest = |longest: Duration, wake: bool| {
            let waits = (0..50).map(|_| {
                if wake {
                    sender.send(&DriveCommandMsg::default()).unwrap();
                }
                let began = now();
                listener.wait(longest).unwrap();
                let took = now() - began;
                assert_eq!(commands.receive().unwrap().is_some(), wake);
                took
            });
            waits.min().unwrap()
        };
        for us in [200, 1000, 3000] {
            let took = shortest(Duration::from_micros(us), false);
            let us = us as i64;
            assert!((SpanNs(us * 1000)..SpanNs((us + 900) * 1000)).contains(&took), "{us} us: {took:?}");
        }
        assert!(shortest(Duration::ZERO, false) < SpanNs(1_000_000));
        assert!(shortest(Duration::from_secs(5), true) < SpanNs(1_000_000));
        drop((commands, listener, sender, services));
        instance.remove_leftovers(None);
    }
}
