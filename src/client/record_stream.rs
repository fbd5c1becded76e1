//! What a run sends, as a stream: its status, its measurements, its joint states. Nobody waits for a reader: one that is slow loses the
//! oldest records, which are counted.
//!
//! ```text
//! service ─► thread `stream`, which owns the port ─► 64 records ahead ─► next
//!            ends when the run has ended, or the stream was dropped
//! ```

use super::{Client, reach};
use crate::ipc::{Instance, IpcError, Receiver, Services};
use crate::messages::{CameraId, JointState, Measurement, Status};
use crate::process::{LeftoversGuard, ProcessError, StopFlag};
use crate::rt::now;
use crate::time::SpanNs;
use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Debug;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

/// Looks for a record lie so far apart: a tick, as joint states come with each.
const LOOK: Duration = Duration::from_millis(1);
/// Records that wait in this process for the reader. Chosen by hand: some looks' worth of joint states; the service keeps a second more of them.
const AHEAD: usize = 64;
/// Looks whether the run is still there lie so far apart. Chosen by hand: people notice nothing of it, and it costs a system call.
const LOOK_FOR_RUN: SpanNs = SpanNs(100_000_000);

/// A kind of record that a run sends.
pub trait Watched: ZeroCopySend + Copy + Debug + Send + 'static {
    /// Its place in the order in which they were sent: a gap is what was lost.
    fn number(&self) -> u64;
    #[doc(hidden)]
    fn open(services: &Services, camera: CameraId) -> Result<Receiver<Self>, IpcError>;
}

impl Watched for Status {
    fn number(&self) -> u64 {
        self.sequence
    }

    fn open(services: &Services, _: CameraId) -> Result<Receiver<Self>, IpcError> {
        services.statuses_view()
    }
}

impl Watched for Measurement {
    fn number(&self) -> u64 {
        self.frames_received
    }

    fn open(services: &Services, camera: CameraId) -> Result<Receiver<Self>, IpcError> {
        services.measurement_view(camera)
    }
}

impl Watched for JointState {
    fn number(&self) -> u64 {
        self.sequence
    }

    fn open(services: &Services, _: CameraId) -> Result<Receiver<Self>, IpcError> {
        services.joint_state_view()
    }
}

/// A stream of records of a run; it ends its part in the run when it is dropped.
#[derive(Debug)]
pub struct RecordStream<T> {
    records: std::sync::mpsc::Receiver<Result<T, ProcessError>>,
    lost: Arc<AtomicU64>,
    closed: StopFlag,
    interrupted: StopFlag,
    instance: Instance,
}

impl<T> Drop for RecordStream<T> {
    fn drop(&mut self) {
        self.closed.request();
    }
}

impl<T> RecordStream<T> {
    /// The next record, oldest first, for which it waits `timeout_s` at most; `None` when none came in that time.
    ///
    /// # Errors
    /// When the run has ended, the wait is interrupted, or shared memory fails.
    pub fn next(&self, timeout_s: f64) -> Result<Option<T>, ProcessError> {
        let until = now() + SpanNs::from_s(timeout_s);
        loop {
            let left = (until - now()).as_s().clamp(0.0, LOOK_FOR_RUN.as_s());
            match self.records.recv_timeout(Duration::from_secs_f64(left)) {
                Ok(record) => return record.map(Some),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(ProcessError::NobodyThere(self.instance.to_string()));
                }
                Err(RecvTimeoutError::Timeout) if self.interrupted.is_requested() => {
                    return Err(ProcessError::Interrupted);
                }
                Err(RecvTimeoutError::Timeout) if now() >= until => return Ok(None),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Records that the run sent since the first one, and that came too early for this reader.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

impl Client {
    /// The status of the run, 50 times a second of its time.
    ///
    /// # Errors
    /// When no run is there, or it has as many readers as can be; so for the others.
    pub fn statuses(&self) -> Result<RecordStream<Status>, ProcessError> {
        self.stream(CameraId::FIRST)
    }

    /// What vision measured in each frame of a camera.
    ///
    /// # Errors
    /// As for [`Self::statuses`].
    pub fn measurements(&self, camera: CameraId) -> Result<RecordStream<Measurement>, ProcessError> {
        self.stream(camera)
    }

    /// The state of the joints in each tick.
    ///
    /// # Errors
    /// As for [`Self::statuses`].
    pub fn joint_states(&self) -> Result<RecordStream<JointState>, ProcessError> {
        self.stream(CameraId::FIRST)
    }

    fn stream<T: Watched>(&self, camera: CameraId) -> Result<RecordStream<T>, ProcessError> {
        reach::find(&self.instance)?;
        let (send, records) = sync_channel(AHEAD);
        let (tell, opened) = sync_channel(1);
        let (lost, closed) = (Arc::new(AtomicU64::new(0)), StopFlag::default());
        let (instance, counter, end) = (self.instance.clone(), Arc::clone(&lost), closed.clone());
        std::thread::Builder::new()
            .name("stream".into())
            .spawn(move || {
                // A run that ends before this cannot remove what this has open. Given back after the port and the services.
                let _place = LeftoversGuard::of(&instance);
                match open(&instance, camera) {
                    Ok((port, _services)) => {
                        let _ = tell.send(Ok(()));
                        pass_on(&instance, &port, &send, &counter, &end);
                    }
                    Err(error) => {
                        let _ = tell.send(Err(reach::crowded(&instance, error)));
                    }
                }
            })
            .map_err(|cause| ProcessError::Start { what: "the thread of a stream", cause })?;
        // What the transport does cannot be told to hurry.
        match opened.recv_timeout(Duration::from_secs_f64(self.timeout_s)) {
            Ok(opened) => opened?,
            Err(RecvTimeoutError::Timeout) => {
                closed.request();
                return Err(ProcessError::NoAnswer {
                    instance: self.instance.to_string(),
                    waited_s: self.timeout_s,
                });
            }
            Err(RecvTimeoutError::Disconnected) => return Err(ProcessError::Panicked("opening a stream")),
        }
        let (interrupted, instance) = (self.interrupted.clone(), self.instance.clone());
        Ok(RecordStream { records, lost, closed, interrupted, instance })
    }
}

fn open<T: Watched>(instance: &Instance, camera: CameraId) -> Result<(Receiver<T>, Services), IpcError> {
    let services = Services::join(instance)?;
    // A reader that was killed holds its place no longer.
    services.remove_dead_peers();
    Ok((T::open(&services, camera)?, services))
}

fn pass_on<T: Watched>(
    instance: &Instance,
    port: &Receiver<T>,
    send: &SyncSender<Result<T, ProcessError>>,
    lost: &AtomicU64,
    closed: &StopFlag,
) {
    let (mut last, mut look_again) = (None, now());
    let mut waiting: Option<Result<T, ProcessError>> = None;
    while !closed.is_requested() {
        let mut is_idle = true;
        if waiting.is_none() {
            let next = port.receive().map(|record| record.map(|record| *record));
            waiting = next.map_err(ProcessError::from).transpose();
            if let Some(Ok(record)) = &waiting {
                let number = record.number();
                // A sender that began anew counts from its beginning.
                let missing = last.map_or(0, |last: u64| number.saturating_sub(last.saturating_add(1)));
                lost.fetch_add(missing, Ordering::Relaxed);
                last = Some(number);
            }
        }
        if let Some(record) = waiting.take() {
            let is_last = record.is_err();
            match send.try_send(record) {
                Ok(()) if is_last => return,
                Ok(()) => is_idle = false,
                Err(TrySendError::Full(record)) => waiting = Some(record),
                Err(TrySendError::Disconnected(_)) => return,
            }
        } else if now() > look_again {
            if reach::find(instance).is_err() {
                return;
            }
            look_again = now() + LOOK_FOR_RUN;
        }
        if is_idle {
            std::thread::sleep(LOOK);
        }
    }
}
