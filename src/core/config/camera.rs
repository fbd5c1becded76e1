//! The camera of a validated run file.

use super::Config;
use super::frame_source::{Source, Timing};
use super::raw::{Clock, DriveKind};
use crate::camera_model::{CameraModel, Region, Response};
use crate::messages::CameraId;
use crate::robot::Mount;
use crate::scene::FrameSchedule;
use crate::time::{MonoNs, SpanNs};

impl Timing {
    /// Why such a source cannot be used under `clock`, and what to do; `None` where it can.
    #[must_use]
    pub fn refusal(self, clock: Clock) -> Option<&'static str> {
        (self == Self::FreeRunning && clock == Clock::Lockstep).then_some(
            "is `lockstep`, where simulated time says when a frame is exposed; this camera.source exposes by its own \
             clock: use `realtime`",
        )
    }
}

impl Config {
    /// All cameras, in the order of their numbers.
    pub fn cameras(&self) -> impl Iterator<Item = &Camera> {
        std::iter::once(&self.camera).chain(&self.further_cameras)
    }

    /// The configuration for the processes of camera `id`: `camera` is that one. `[scene.camera]` describes the true
    /// parameters of the first camera; those of the others are the nominal ones. A second camera that controls the arm has the target and the goal of
    /// its own view. `None` where there is no such camera.
    #[must_use]
    pub fn seen_by(mut self, id: CameraId) -> Option<Self> {
        if let Some(second) = self.second_view.take()
            && second.cell.camera.id == id
        {
            return Some(*second.cell);
        }
        let camera = self.cameras().find(|camera| camera.id == id)?.clone();
        if id != self.camera.id
            && let Some(scene) = &mut self.scene
        {
            (scene.camera, scene.mount) = (camera.model, camera.mount);
        }
        self.further_cameras.clear();
        self.camera = camera;
        Some(self)
    }

    /// Whether a run is to reach something, a goal or the end of a calibration, before it ends by itself.
    #[must_use]
    pub fn awaits_its_end(&self) -> bool {
        !self.serve && self.closes_the_loop()
    }

    /// Whether the loop is closed: there is an arm that obeys, and the images show its motion.
    #[must_use]
    pub fn closes_the_loop(&self) -> bool {
        let obeys = !matches!(self.drive.kind, DriveKind::None | DriveKind::Replay);
        self.camera.source.kind().closes_the_loop() && obeys
    }

    /// Whether an arm moves in this run: one that obeys, or one that was recorded.
    #[must_use]
    pub fn has_an_arm(&self) -> bool {
        self.closes_the_loop() || self.drive.kind == DriveKind::Replay
    }
}

/// The camera.
#[derive(Debug, Clone)]
pub struct Camera {
    /// Its number, which is part of the names of its services.
    pub id: CameraId,
    /// Its name; its number where it has none.
    pub name: String,
    /// Producer of frames.
    pub source: Source,
    /// How its levels depend on light; frames have levels that are proportional to it.
    pub response: Response,
    /// Lens and size of what is read; the whole image and the region of it are in there.
    pub model: CameraModel,
    /// Where it is mounted.
    pub mount: Mount,
    /// Frames per second.
    pub rate_hz: f64,
    /// Length of the exposure.
    pub exposure: SpanNs,
    /// Middle of the exposure to hand-over.
    pub latency: SpanNs,
    /// Which frame is exposed when.
    pub schedule: FrameSchedule,
    /// Offset that is added to every stamp of the camera, from calibration.
    pub stamp_offset: SpanNs,
    /// Error of the stamps of a simulated camera; positive: late.
    pub stamp_error: SpanNs,
}

impl Camera {
    /// Columns and rows of the whole image, px; frames have those of [`Self::roi`], where there is one.
    #[must_use]
    pub fn full_size_px(&self) -> (u32, u32) {
        self.model.full_size_px()
    }

    /// The part of the whole image that is read; `None`: all of it.
    #[must_use]
    pub fn roi(&self) -> Option<Region> {
        let (width_px, height_px) = self.full_size_px();
        Some(*self.model.region()).filter(|region| *region != Region::whole(width_px, height_px))
    }

    /// The stamp of a frame whose exposure has its middle at `mid`: that of the camera, corrected by the calibrated offset.
    #[must_use]
    pub fn stamp(&self, mid: MonoNs) -> MonoNs {
        mid + self.stamp_error + self.stamp_offset
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame_source::SourceKind;
    use super::*;

    #[test]
    fn only_real_time_takes_a_source_that_runs_by_itself() {
        assert!(Timing::FreeRunning.refusal(Clock::Lockstep).unwrap().contains("use `realtime`"));
        assert_eq!(Timing::FreeRunning.refusal(Clock::Realtime), None);
        for clock in [Clock::Realtime, Clock::Lockstep] {
            for kind in [SourceKind::Synthetic, SourceKind::Replay] {
                assert_eq!(kind.timing().refusal(clock), None);
            }
        }
    }

    /// Levels of a simulated camera are proportional to light; who took images says nothing of theirs, also where these are replayed.
    #[test]
    fn images_of_unknown_origin_have_an_unknown_response() {
        let of = |set: &[&str]| {
            let set: Vec<_> = set.iter().map(ToString::to_string).collect();
            crate::config::Config::load(None, &set).unwrap().camera.response
        };
        let replay = ["camera.source=replay", "camera.replay.folder=.", "drive.kind=none"];
        assert_eq!((of(&[]), of(&replay)), (Response::Linear, Response::Unknown));
        assert_eq!(of(&[&replay[..], &["camera.response=linear"]].concat()), Response::Linear);
    }
}
