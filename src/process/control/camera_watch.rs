//! How the camera stands, as it says itself: into the status, the answers, the events, and the reason of a run that ends without it.
//!
//! What the arm does is not decided here: it holds because measurements grow old, whatever the reason.

use crate::config::{Camera, Config, Timing};
use crate::ipc::{IpcError, Receiver, Services};
use crate::messages::{CameraHealth, CameraState, Status};
use crate::rt::now;
use crate::time::MonoNs;

/// The latest health records of the cameras that control uses: of one, or of two.
pub(super) struct CameraWatch {
    cameras: Vec<WatchedCamera>,
}

/// The newest word of a camera that runs by its own clock.
struct WatchedCamera {
    /// What it is called.
    name: &'static str,
    port: Option<Receiver<CameraHealth>>,
    newest: Option<CameraHealth>,
}

impl CameraWatch {
    /// Of the camera of `config`, or of both that it uses; simulated ones have nothing to say.
    pub(super) fn open(services: &Services, config: &Config) -> Result<Self, IpcError> {
        let watched = |name, camera: &Camera| -> Result<WatchedCamera, IpcError> {
            let speaks = camera.source.kind().timing() == Timing::FreeRunning;
            let port = speaks.then(|| services.health_receiver(camera.id)).transpose()?;
            Ok(WatchedCamera { name, port, newest: None })
        };
        let cameras = match (&config.stereo, &config.second_view, config.further_cameras.first()) {
            (Some(_), _, Some(right)) => {
                vec![watched("left camera", &config.camera)?, watched("right camera", right)?]
            }
            (_, Some(_), Some(second)) => {
                vec![watched("first camera", &config.camera)?, watched("second camera", second)?]
            }
            _ => vec![watched("camera", &config.camera)?],
        };
        Ok(Self { cameras })
    }

    /// Takes in new health records; returns an event that is to be reported.
    pub(super) fn look(&mut self) -> Result<Option<String>, IpcError> {
        let mut events = Vec::new();
        for camera in &mut self.cameras {
            events.extend(camera.look()?);
        }
        Ok((!events.is_empty()).then(|| events.join(", ")))
    }

    /// Of two the one that is away counts.
    fn worst(&self) -> Option<&WatchedCamera> {
        let spoken = || self.cameras.iter().filter(|camera| camera.newest.is_some());
        spoken().find(|camera| camera.state().is_away()).or(spoken().next())
    }

    /// A status with what the cameras say.
    pub(super) fn added_to(&self, status: &Status) -> Status {
        let Some(health) = self.worst().and_then(|camera| camera.newest) else { return *status };
        Status { camera_state: health.state, camera_state_s: (now() - health.since).as_s(), ..*status }
    }

    /// Why no frames come, where a camera is away.
    pub(super) fn why_away(&self, now: MonoNs) -> Option<String> {
        let camera = self.worst().filter(|camera| camera.state().is_away())?;
        let lasted_s = (now - camera.newest?.since).as_s();
        Some(format!("the {} is {}, for {lasted_s:.1} s", camera.name, camera.state().as_str()))
    }
}

impl WatchedCamera {
    fn look(&mut self) -> Result<Option<String>, IpcError> {
        let mut event = None;
        while let Some(health) = self.port.as_ref().map_or(Ok(None), Receiver::receive)? {
            event = self.change(&health).or(event);
            self.newest = Some(*health);
        }
        Ok(event)
    }

    fn change(&self, health: &CameraHealth) -> Option<String> {
        let (before, after) = (self.state(), CameraState::from_code(health.state));
        if after == before {
            return None;
        }
        let name = self.name;
        match (before.is_away(), after.is_away()) {
            (_, true) => Some(format!("{name} {}", after.as_str())),
            (true, false) => {
                let away = self.newest.map_or(0.0, |before| (health.since - before.since).as_s());
                Some(format!("{name} {} again, {away:.1} s after it was {}", after.as_str(), before.as_str()))
            }
            (false, false) => None,
        }
    }

    fn state(&self) -> CameraState {
        CameraState::from_code(self.newest.map_or(0, |health| health.state))
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
        let mut watch = WatchedCamera { name: "camera", port: None, newest: None };
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

    fn watch(words: &[Option<CameraHealth>]) -> CameraWatch {
        let names = if words.len() == 1 { &["camera"][..] } else { &["left camera", "right camera"][..] };
        let watched =
            |(name, newest): (&&'static str, &_)| WatchedCamera { name, port: None, newest: *newest };
        CameraWatch { cameras: names.iter().zip(words).map(watched).collect() }
    }

    #[test]
    fn a_camera_that_is_away_is_in_the_status_and_the_reason() {
        let one = watch(&[Some(says(CameraState::Gone, 1_000))]);
        assert_eq!(one.added_to(&Status::default()).camera_state, CameraState::Gone as u32);
        assert_eq!(one.why_away(MonoNs(4_000_000_000)).unwrap(), "the camera is unplugged, for 3.0 s");
        let silent = watch(&[None]);
        assert_eq!((silent.why_away(MonoNs(0)), silent.added_to(&Status::default()).camera_state), (None, 0));
    }

    #[test]
    fn of_a_pair_the_camera_that_is_away_counts() {
        let (streams, gone) = (says(CameraState::Streaming, 500), says(CameraState::Gone, 1_000));
        for (words, name) in [([Some(streams), Some(gone)], "right"), ([Some(gone), Some(streams)], "left")] {
            let pair = watch(&words);
            assert_eq!(pair.added_to(&Status::default()).camera_state, CameraState::Gone as u32);
            let why = pair.why_away(MonoNs(4_000_000_000)).unwrap();
            assert_eq!(why, format!("the {name} camera is unplugged, for 3.0 s"));
        }
        let both = watch(&[Some(streams), Some(streams)]);
        assert_eq!(both.why_away(MonoNs(4_000_000_000)), None);
        assert_eq!(both.added_to(&Status::default()).camera_state, CameraState::Streaming as u32);
    }
}
