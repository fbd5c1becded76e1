//! Watching a running instance: what its processes send, as [`WatchedRecord`]s. Whoever watches waits for nothing and is waited for by nobody: what is not
//! taken in time is overwritten.

use super::reach;
use crate::config::{Clock, Config, DriveKind};
use crate::ipc::{
    DriveViews, Instance, IpcError, QuietFrameReceiver, ReceivedFrame, Receiver, Role, Services,
};
use crate::messages::{CameraHealth, CameraId, Measurement, RequestMsg, Status, TraceMsg};
use crate::monitor::{CellFacts, WatchedRecord};
use crate::process::{LeftoversGuard, ProcessError, frame_shape, guardian};
use crate::report::run_page::JointSummary;

/// A place among those who read a run's services. The fields are given back in the order in which they stand.
#[derive(Debug)]
pub struct RunWatch {
    status: Receiver<Status>,
    traces: Receiver<TraceMsg>,
    measurements: Receiver<Measurement>,
    health: Vec<(CameraId, Receiver<CameraHealth>)>,
    requests: Receiver<RequestMsg>,
    /// Commands to an external drive, and its states, once there is a place for who watches.
    drive: Option<DriveViews>,
    images: Option<QuietFrameReceiver>,
    /// How many of the run's own processes read each service of its external drive; `None` without one.
    readers_of_drive: Option<usize>,
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
            requests: services.request_view().map_err(crowded)?,
            drive: None,
            images: None,
            readers_of_drive: (config.drive.kind == DriveKind::External)
                .then(|| 1 + usize::from(guardian::is_wanted(config))),
            services,
            instance: instance.clone(),
            _place: place,
        })
    }

    /// Looks for a place among those who read an external drive, where there is one and none was found yet. Without it the drive's records are not among
    /// those that come.
    ///
    /// # Errors
    /// When shared memory fails.
    pub fn look_for_drive(&mut self) -> Result<(), ProcessError> {
        if let (None, Some(own)) = (&self.drive, self.readers_of_drive) {
            self.drive = self.services.drive_views(own)?;
        }
        Ok(())
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
        // Before the ticks that tell what control made of them.
        if let Some(DriveViews { commands, states, texts }) = &self.drive {
            // Words come before the state that they are about.
            while let Some(text) = texts.receive()? {
                take(&WatchedRecord::DriveText(&text));
            }
            while let Some(command) = commands.receive()? {
                take(&WatchedRecord::DriveCommand(&command));
            }
            while let Some(state) = states.receive()? {
                take(&WatchedRecord::DriveState(&state));
            }
        }
        while let Some(tick) = self.traces.receive()? {
            take(&WatchedRecord::Tick(&tick));
        }
        while let Some(measurement) = self.measurements.receive()? {
            take(&WatchedRecord::Measurement(&measurement));
        }
        while let Some(request) = self.requests.receive()? {
            take(&WatchedRecord::Request(&request));
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
