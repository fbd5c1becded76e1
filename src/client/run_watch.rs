//! Watching a running instance: what its processes send, as [`WatchedRecord`]s. Whoever watches waits for nothing and is waited for by nobody: what is not
//! taken in time is overwritten.

use super::reach;
use crate::config::{Clock, Config};
use crate::ipc::{Instance, IpcError, QuietFrameReceiver, ReceivedFrame, Receiver, Role, Services};
use crate::messages::{CameraHealth, CameraId, Measurement, Status, TraceMsg};
use crate::monitor::{CellFacts, WatchedRecord};
use crate::process::{LeftoversGuard, ProcessError, frame_shape};
use crate::report::run_page::JointSummary;

/// A place among those who read a run's services. The fields are given back in the order in which they stand.
#[derive(Debug)]
pub struct RunWatch {
    status: Receiver<Status>,
    traces: Receiver<TraceMsg>,
    measurements: Receiver<Measurement>,
    health: Vec<(CameraId, Receiver<CameraHealth>)>,
    images: Option<QuietFrameReceiver>,
    services: Services,
    instance: Instance,
    // a run that ended meanwhile could not remove what this had open
    _place: LeftoversGuard,
}

impl RunWatch {
    /// Joins the run of `instance`, whose run file is `config`.
    ///
    /// # Errors
    /// When as many watch it as may, or shared memory is not usable.
    pub fn join(instance: &Instance, config: &Config) -> Result<Self, ProcessError> {
        let place = LeftoversGuard::of(instance);
        let services = Services::join(instance)?;
        // A watcher that was killed holds its places no longer.
        services.remove_dead_peers();
        let crowded = |error| reach::crowded(instance, error);
        let cameras = config.cameras().map(|camera| Ok((camera.id, services.health_view(camera.id)?)));
        Ok(Self {
            status: services.status_view().map_err(crowded)?,
            traces: services.trace_view().map_err(crowded)?,
            measurements: services.measurement_view(config.camera.id).map_err(crowded)?,
            health: cameras.collect::<Result<_, IpcError>>().map_err(crowded)?,
            images: None,
            services,
            instance: instance.clone(),
            _place: place,
        })
    }

    /// The same, to which the images of the first camera come too.
    ///
    /// # Errors
    /// As for [`Self::join`].
    pub fn with_images(mut self, config: &Config) -> Result<Self, ProcessError> {
        let images = self.services.frame_view(config.camera.id, frame_shape(config));
        self.images = Some(images.map_err(|error| reach::crowded(&self.instance, error))?);
        Ok(self)
    }

    /// The newest image since the last look, where images were asked for. It lies in shared memory, and is to be given back soon.
    ///
    /// # Errors
    /// When shared memory fails.
    pub fn image(&self) -> Result<Option<ReceivedFrame>, ProcessError> {
        Ok(self.images.as_ref().map(QuietFrameReceiver::receive).transpose()?.flatten())
    }

    /// Takes everything that came, in the order of each service; of states and of health the newest.
    ///
    /// # Errors
    /// When shared memory fails.
    pub fn take_all(&self, take: &mut dyn FnMut(&WatchedRecord<'_>)) -> Result<(), ProcessError> {
        if let Some(status) = self.status.receive_newest()? {
            take(&WatchedRecord::Status(&status));
        }
        while let Some(tick) = self.traces.receive()? {
            take(&WatchedRecord::Tick(&tick));
        }
        while let Some(measurement) = self.measurements.receive()? {
            take(&WatchedRecord::Measurement(&measurement));
        }
        for (camera, port) in &self.health {
            if let Some(health) = port.receive_newest()? {
                take(&WatchedRecord::Health(*camera, &health));
            }
        }
        Ok(())
    }

    /// Whether control is still there.
    #[must_use]
    pub fn is_there(&self) -> bool {
        self.instance.is_running(Role::Control)
    }
}

impl CellFacts {
    /// What the run file of `instance` tells.
    #[must_use]
    pub fn of(instance: &Instance, config: &Config) -> Self {
        let i = config.camera.model.intrinsics();
        Self {
            instance: instance.to_string(),
            lockstep: config.clock == Clock::Lockstep,
            serves: config.serve,
            has_keys: true,
            joints: config.robot.joints.iter().map(JointSummary::of).collect(),
            image_px: [i.width_px, i.height_px].map(f64::from),
            targets: config.targets().map(|(name, _)| name.to_owned()).collect(),
            goal_error_px: config.goal.feature_error_px,
            hold_s: config.goal.hold.as_s(),
            rate_hz: config.camera.rate_hz,
        }
    }
}
