//! A recording as camera beside the recorded arm: each image is shown when it was taken, by the time since the first state of the arm in the same file.
//!
//! In lockstep, where the run says when a frame is exposed, it is the newest image by then, once more where none has come since. Before the first image the
//! camera shows nothing.

use super::recording::{self, RecordedCamera, RecordedTopic};
use super::{Exposed, Exposure, NextInstant, ScheduledSource, SourceError};
use crate::messages::{CameraId, JointState};
use crate::record::RUN_FILE;
use crate::time::{MonoNs, SpanNs, TICK};
use std::path::Path;
use toml::{Table, Value};

/// An image is of the tick that is nearest to it, as the arm's states are.
const NEAREST: SpanNs = SpanNs(TICK.0 / 2);
/// The level of an image of nothing. Chosen: anything that is the same all over has no contrast.
const NOTHING_LEVEL: u8 = 128;

/// A recorded image.
struct DatedImage {
    /// Its grey levels, row by row.
    grey: Vec<u8>,
    /// The stamp of its message, ns.
    stamp_ns: u64,
}

/// Plays a recording by its stamps. Its images are copied, because each may be shown more than once.
pub(super) struct DatedCamera {
    camera: RecordedCamera,
    pixels: usize,
    /// The image that comes next: decoded before, so that it is known when.
    ahead: Option<DatedImage>,
    /// The stamp of the first state of the arm.
    origin: MonoNs,
    /// What the recorded run had added to the camera's own stamps.
    stamp_offset: SpanNs,
    /// The tick 0 of this run, once a state was seen.
    begin: Option<MonoNs>,
    /// What is shown.
    shown: Option<DatedImage>,
}

impl DatedCamera {
    /// Opens the recording `path`.
    ///
    /// # Errors
    /// As for [`RecordedCamera::open`], and when the recording has no state of the arm.
    pub(super) fn open(path: &Path, wanted: &RecordedTopic<'_>) -> Result<Self, SourceError> {
        let camera = RecordedCamera::open(path, wanted)?;
        let mut reader = recording::open(path)?;
        let text = reader.attachments().get(RUN_FILE).cloned().unwrap_or_default();
        let stamp_offset = stamp_offset(&String::from_utf8_lossy(&text), wanted.camera);
        while let Some(message) = reader.next_message().map_err(|e| recording::recording(path, &e))? {
            if message.topic() == "/control/joint_state" {
                let origin = MonoNs(i64::try_from(message.stamp_ns).unwrap_or(i64::MAX));
                let pixels = wanted.size_px.0 as usize * wanted.size_px.1 as usize;
                let (begin, ahead, shown) = (None, None, None);
                let mut dated = Self { camera, pixels, ahead, origin, stamp_offset, begin, shown };
                dated.ahead = dated.next_image()?;
                return Ok(dated);
            }
        }
        Err(camera.failed("has no /control/joint_state, by which its images could be dated".into()))
    }

    fn next_image(&mut self) -> Result<Option<DatedImage>, SourceError> {
        let mut grey = vec![0; self.pixels];
        let stamp_ns = self.camera.decode_next(&mut grey)?;
        Ok(stamp_ns.map(|stamp_ns| DatedImage { grey, stamp_ns }))
    }

    /// When the image of this stamp was taken, by the clock of this run.
    fn taken(&self, stamp_ns: u64, begin: MonoNs) -> MonoNs {
        let stamp = MonoNs(i64::try_from(stamp_ns).unwrap_or(i64::MAX));
        begin + (stamp - self.stamp_offset - self.origin)
    }
}

/// The offset of the stamps of camera `id` in a run file.
fn stamp_offset(run_file: &str, id: CameraId) -> SpanNs {
    let table: Table = run_file.parse().unwrap_or_default();
    let listed = table.get("cameras").and_then(Value::as_array).and_then(|list| list.get(usize::from(id.0)));
    let camera = listed.or_else(|| table.get("camera"));
    let offset_ms = camera.and_then(|camera| camera.get("stamp_offset_ms")).and_then(Value::as_float);
    SpanNs::from_s(offset_ms.unwrap_or(0.0) * 1e-3)
}

impl ScheduledSource for DatedCamera {
    fn arm(&mut self, state: &JointState) {
        let since = SpanNs(TICK.0.saturating_mul(i64::try_from(state.tick).unwrap_or(i64::MAX)));
        self.begin.get_or_insert(state.stamp - since);
    }

    fn expose(&mut self, exposure: &Exposure, out: &mut [u8]) -> Result<Exposed, SourceError> {
        if let Some(begin) = self.begin {
            let is_there = |camera: &Self| {
                let ahead = camera.ahead.as_ref();
                ahead.is_some_and(|image| camera.taken(image.stamp_ns, begin) <= exposure.mid + NEAREST)
            };
            while is_there(self) {
                let next = self.next_image()?;
                self.shown = std::mem::replace(&mut self.ahead, next);
            }
        }
        match &self.shown {
            Some(image) if image.grey.len() == out.len() => out.copy_from_slice(&image.grey),
            _ => out.fill(NOTHING_LEVEL),
        }
        // The arm goes on after the last image.
        Ok(Exposed::Image)
    }

    fn next_instant(&self) -> NextInstant {
        match (self.begin, &self.ahead) {
            (None, _) => NextInstant::Any,
            (Some(begin), Some(image)) => NextInstant::At(self.taken(image.stamp_ns, begin)),
            (Some(_), None) => NextInstant::Never,
        }
    }

    fn stamped(&self, exposure: &Exposure) -> MonoNs {
        match (&self.shown, self.begin) {
            (Some(image), Some(begin)) => self.taken(image.stamp_ns, begin),
            _ => exposure.mid,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::FrameHeader;
    use crate::record::RecordingWriter;
    use std::collections::BTreeMap;

    const MS: i64 = 1_000_000;

    /// A recording whose arm has its first state at 9 s, and whose frames come so many ms after it; each shows its number.
    fn recorded(frames_ms: &[i64], run_file: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let mut writer = RecordingWriter::new(file.as_file_mut(), &BTreeMap::new()).unwrap();
        writer.attach(RUN_FILE, "application/toml", run_file.as_bytes()).unwrap();
        let states = writer.add_records::<JointState>("/control/joint_state").unwrap();
        let images = writer.add_images("/camera/0/frame", "camera").unwrap();
        let origin = 9_000 * MS;
        writer.write(states, 0, MonoNs(origin), &JointState::default()).unwrap();
        for (k, ms) in (1..).zip(frames_ms) {
            let exposure = MonoNs(origin + ms * MS);
            let header = FrameHeader { exposure, width_px: 4, height_px: 2, ..FrameHeader::default() };
            writer.write_image(&images, &header, &[k; 8]).unwrap();
        }
        writer.finish(&BTreeMap::new()).unwrap();
        file
    }

    fn wanted() -> RecordedTopic<'static> {
        RecordedTopic { topic: None, camera: CameraId::FIRST, size_px: (4, 2), repeat: false, strict: false }
    }

    #[test]
    fn images_are_shown_when_they_were_taken() {
        let file = recorded(&[30, 75, 120], "[camera]\nstamp_offset_ms = 5.0\n");
        let mut camera = DatedCamera::open(file.path(), &wanted()).unwrap();
        assert_eq!(camera.next_instant(), NextInstant::Any, "no state of the arm has come yet");
        // The run's tick 0 was at 500 ms of its clock.
        let state = JointState { tick: 3, stamp: MonoNs(503 * MS), ..JointState::default() };
        camera.arm(&state);
        assert_eq!(camera.next_instant(), NextInstant::At(MonoNs(525 * MS)));
        let mut out = [0; 8];
        let mut shown = |camera: &mut DatedCamera, ms: i64| {
            let exposure = Exposure { frame_id: 0, mid: MonoNs(ms * MS), span: SpanNs(0) };
            assert_eq!(camera.expose(&exposure, &mut out).unwrap(), Exposed::Image);
            (out[0], camera.stamped(&exposure).0 / MS)
        };
        let seen: Vec<_> =
            [500, 540, 560, 580, 700, 900].map(|ms| shown(&mut camera, ms)).into_iter().collect();
        assert_eq!(seen, [(128, 500), (1, 525), (1, 525), (2, 570), (3, 615), (3, 615)]);
        assert_eq!(camera.next_instant(), NextInstant::Never);
    }
}
