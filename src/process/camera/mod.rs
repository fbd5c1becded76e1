//! The camera process: frames, straight into shared memory. One loop for sources whose exposures are triggered, one for those
//! that tell when they did.

mod free_running;
mod scheduled;

use super::priority::{self, Rank};
use super::{Membership, ProcessError, StopFlag, frame_shape};
use crate::config::{self, Config};
use crate::ipc::{FrameSender, ImagePorts, Instance, ReceivedImage, Role, Sender, Services};
use crate::messages::{CameraHealth, FrameHeader, ImageHeader, frame_flag};
use crate::rt::now;
use crate::source::external::{ForeignImage, ImageLink};
use crate::source::{self, AnySource, Filled, FreeRunningSource, SourceError};
use crate::time::{MonoNs, SpanNs};
use std::time::Duration;
use tracing::info;

/// Runs the camera of `config` until a stop is requested or the source ends.
///
/// # Errors
/// When the source, shared memory or the instance fails.
pub fn run(config: &Config, instance: &Instance, stop: &StopFlag) -> Result<(), ProcessError> {
    let id = config.camera.id;
    let opened = match &config.camera.source {
        config::Source::External(_) => None,
        _ => Some(source::open(config)?),
    };
    let membership = Membership::join(instance, Role::Camera(id), config)?;
    let services = membership.services();
    match opened {
        Some(AnySource::Scheduled(source)) => {
            // Control begins when it sees who sends frames: from then on no state of the arm may be missed.
            let (arm, wake_listener) = services.joint_state_receiver()?;
            let frames = services.frame_sender(id, frame_shape(config))?;
            services.require_room_for_peers()?;
            priority::take(config, Rank::Camera)?;
            info!(rate_hz = config.camera.rate_hz, "camera runs");
            let camera = scheduled::ScheduledCamera::new(config, &membership, source, frames, arm);
            camera.run(&wake_listener, stop)
        }
        Some(AnySource::FreeRunning(mut source)) => run_free(config, &membership, source.as_mut(), stop),
        None => {
            let link = SharedImages { ports: services.image_ports(id)?, services };
            run_free(config, &membership, source::open_external(config, link).as_mut(), stop)
        }
    }
}

/// Runs a camera that exposes by its own clock.
fn run_free(
    config: &Config,
    membership: &Membership,
    source: &mut dyn FreeRunningSource,
    stop: &StopFlag,
) -> Result<(), ProcessError> {
    let (id, services) = (config.camera.id, membership.services());
    let frames = services.frame_sender(id, frame_shape(config))?;
    let health = services.health_sender(id)?;
    services.require_room_for_peers()?;
    priority::take(config, Rank::Camera)?;
    info!("camera runs by its own clock");
    let mut outlet = SharedMemory { camera: &config.camera, membership, frames, health };
    let patience = free_running::SilenceLimits::with(config.camera.rate_hz, give_up(&config.camera.source));
    free_running::run(source, &mut outlet, patience, stop)
}

/// Images of an external camera, through an instance.
pub struct SharedImages<'a> {
    /// Where they come.
    pub ports: ImagePorts,
    /// The instance.
    pub services: &'a Services,
}

impl ForeignImage for ReceivedImage {
    fn header(&self) -> ImageHeader {
        Self::header(self)
    }

    fn bytes(&self) -> &[u8] {
        Self::bytes(self)
    }
}

impl ImageLink for SharedImages<'_> {
    type Image = ReceivedImage;

    fn wait(&mut self, longest: Duration) -> Result<(), SourceError> {
        Ok(self.ports.wait(longest)?)
    }

    fn receive(&mut self) -> Result<Option<ReceivedImage>, SourceError> {
        Ok(self.ports.receive()?)
    }

    fn has_sender(&mut self) -> bool {
        self.services.remove_dead_peers();
        self.ports.has_sender()
    }

    fn now(&self) -> MonoNs {
        now()
    }
}

/// How long a camera that is known to be away is waited for.
fn give_up(source: &config::Source) -> SpanNs {
    match source {
        config::Source::V4l2(settings) => settings.give_up,
        config::Source::External(program) => program.give_up,
        config::Source::Synthetic { .. } | config::Source::Replay { .. } => SpanNs::ZERO,
    }
}

/// One exposed frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Shot {
    /// Counts exposures from 0.
    frame_id: u64,
    /// The source's own number of it.
    sequence: u64,
    /// Middle of the exposure.
    mid: MonoNs,
    /// Its length.
    span: SpanNs,
    /// Frames lost since the start.
    lost: u64,
    /// Whether no frame follows.
    last: bool,
}

impl Shot {
    /// What travels with its pixels, before it is sent.
    fn header(&self, camera: &config::Camera) -> FrameHeader {
        let i = camera.model.intrinsics();
        FrameHeader {
            frame_id: self.frame_id,
            sequence: self.sequence,
            exposure: camera.stamp(self.mid),
            sent: MonoNs::ZERO,
            exposure_span_ns: self.span.0.max(0).unsigned_abs(),
            lost: self.lost,
            camera: camera.id.into(),
            width_px: i.width_px,
            height_px: i.height_px,
            flags: if self.last { frame_flag::LAST } else { 0 },
        }
    }
}

/// Fills a frame's pixels.
type Fill<'a> = dyn FnMut(&mut [u8]) -> Result<Filled, SourceError> + 'a;

/// Where the frames of a free-running source go.
trait Outlet {
    /// The machine's monotonic clock.
    fn now(&self) -> MonoNs;

    /// The loop has come round.
    fn beat(&mut self);

    /// Hands over `shot`, whose pixels `fill` writes; a damaged one stays here.
    fn publish(&mut self, shot: &Shot, fill: &mut Fill<'_>) -> Result<Filled, ProcessError>;

    /// Says how the camera stands.
    fn tell(&mut self, health: &CameraHealth) -> Result<(), ProcessError>;
}

/// Frames for the other processes.
struct SharedMemory<'a> {
    camera: &'a config::Camera,
    membership: &'a Membership,
    frames: FrameSender,
    health: Sender<CameraHealth>,
}

impl Outlet for SharedMemory<'_> {
    fn now(&self) -> MonoNs {
        now()
    }

    fn beat(&mut self) {
        self.membership.beat();
    }

    fn publish(&mut self, shot: &Shot, fill: &mut Fill<'_>) -> Result<Filled, ProcessError> {
        let header = shot.header(self.camera);
        let mut frame = self.frames.borrow(header.width_px as usize * header.height_px as usize)?;
        let filled = fill(frame.pixels_mut())?;
        if filled == Filled::Image {
            self.frames.send(frame, FrameHeader { sent: now(), ..header })?;
        }
        Ok(filled)
    }

    fn tell(&mut self, health: &CameraHealth) -> Result<(), ProcessError> {
        Ok(self.health.send_quietly(&CameraHealth { camera: self.camera.id.into(), ..*health })?)
    }
}
