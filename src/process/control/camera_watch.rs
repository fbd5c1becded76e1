//! How the camera stands, as it says itself: into the status, the answers, the events, and the reason of a run that ends without it.
//!
//! What the arm does is not decided here: it holds because measurements grow old, whatever the reason.

use crate::config::{Camera, Timing};
use crate::ipc::{IpcError, Receiver, Services};
use crate::messages::{CameraHealth, CameraState, Status};
use crate::rt::now;
use crate::time::MonoNs;

/// The newest word of a camera that runs by its own clock.
pub(super) struct CameraWatch {
    port: Option<Receiver<CameraHealth>>,
    newest: Option<CameraHealth>,
}

impl CameraWatch {
    /// Of a camera; simulated ones have nothing to say.
    pub(super) fn open(services: &Services, camera: &Camera) -> Result<Self, IpcError> {
        let speaks = camera.source.kind().timing() == Timing::FreeRunning;
        let port = speaks.then(|| services.health_receiver(camera.id)).transpose()?;
        Ok(Self { port, newest: None })
    }

    /// Takes in what has come; an event where there is one to be told.
    pub(super) fn look(&mut self) -> Result<Option<String>, IpcError> {
        let mut event = None;
        while let Some(health) = self.port.as_ref().map_or(Ok(None), Receiver::receive)? {
            event = self.change(&health).or(event);
            self.newest = Some(health);
        }
        Ok(event)
    }

    fn change(&self, health: &CameraHealth) -> Option<String> {
        let (before, after) = (self.state(), CameraState::from_code(health.state));
        if after == before {
            return None;
        }
        match (before.is_away(), after.is_away()) {
            (_, true) => Some(format!("camera {}", after.as_str())),
            (true, false) => {
                let away = self.newest.map_or(0.0, |before| (health.since - before.since).as_s());
                Some(format!("camera {} again, {away:.1} s after it was {}", after.as_str(), before.as_str()))
            }
            (false, false) => None,
        }
    }

    fn state(&self) -> CameraState {
        CameraState::from_code(self.newest.map_or(0, |health| health.state))
    }

    /// A status with what the camera says.
    pub(super) fn added_to(&self, status: &Status) -> Status {
        let Some(health) = &self.newest else { return *status };
        Status { camera_state: health.state, camera_state_s: (now() - health.since).as_s(), ..*status }
    }

    /// Why no frames come, where the camera is away.
    pub(super) fn why_away(&self, now: MonoNs) -> Option<String> {
        let health = self.newest.filter(|_| self.state().is_away())?;
        Some(format!("the camera is {}, for {:.1} s", self.state().as_str(), (now - health.since).as_s()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn says(state: CameraState, since_ms: i64) -> CameraHealth {
        CameraHealth { state: state as u32, since: MonoNs(since_ms * 1_000_000), ..CameraHealth::default() }
    }

    #[test]
    fn going_and_coming_back_are_events_and_a_start_is_none() {
        let mut watch = CameraWatch { port: None, newest: None };
        let mut events = Vec::new();
        for health in [
            says(CameraState::Starting, 0),
            says(CameraState::Streaming, 500),
            says(CameraState::Gone, 2_000),
            says(CameraState::Gone, 2_000),
            says(CameraState::Streaming, 5_200),
        ] {
            events.extend(watch.change(&health));
            watch.newest = Some(health);
        }
        assert_eq!(events, ["camera unplugged", "camera streaming again, 3.2 s after it was unplugged"]);
    }

    #[test]
    fn a_camera_that_is_away_is_in_the_status_and_the_reason() {
        let watch = CameraWatch { port: None, newest: Some(says(CameraState::Gone, 1_000)) };
        assert_eq!(watch.added_to(&Status::default()).camera_state, CameraState::Gone as u32);
        assert_eq!(watch.why_away(MonoNs(4_000_000_000)).unwrap(), "the camera is unplugged, for 3.0 s");
        let silent = CameraWatch { port: None, newest: None };
        assert_eq!((silent.why_away(MonoNs(0)), silent.added_to(&Status::default()).camera_state), (None, 0));
    }
}
