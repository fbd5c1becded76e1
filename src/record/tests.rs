//! Recordings that come back as they were written, also from files that are cut off or damaged.

use super::*;
use crate::messages::{FrameHeader, JointState, Measurement, TraceMsg};
use crate::time::MonoNs;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::io::Write;
use std::sync::{Arc, Mutex};

/// A sink that notes its length at each flush.
#[derive(Clone, Default)]
struct Sink(Arc<Mutex<(Vec<u8>, Vec<usize>)>>);

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().0.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        let (bytes, flushed) = &mut *self.0.lock().unwrap();
        flushed.push(bytes.len());
        Ok(())
    }
}

fn state(k: u64) -> JointState {
    JointState {
        tick: k,
        sequence: k,
        stamp: MonoNs(k as i64 * 1_000_000),
        q: [k as f64 * 0.1; 7],
        ..JointState::default()
    }
}

/// A recording of so many states by chunks, with its bytes and the lengths after each chunk.
fn recorded(chunks: &[u64]) -> (Vec<u8>, Vec<usize>) {
    let sink = Sink::default();
    let mut writer = RecordingWriter::new(sink.clone(), &BTreeMap::from([("a".into(), "b".into())])).unwrap();
    writer.attach(RUN_FILE, "application/toml", b"[run]").unwrap();
    let topic = writer.add_records::<JointState>("/control/joint_state").unwrap();
    writer.end_chunk().unwrap();
    let mut next = 0;
    for count in chunks {
        for k in next..next + count {
            writer.write(topic, k, state(k).stamp, &state(k)).unwrap();
        }
        next += count;
        writer.end_chunk().unwrap();
    }
    writer.finish(&BTreeMap::from([("lost".into(), "0".into())])).unwrap();
    let shared = sink.0.lock().unwrap();
    (shared.0.clone(), shared.1.clone())
}

/// The states in a file, and whether it is cut off.
fn read(bytes: &[u8]) -> Result<(Vec<JointState>, bool), RecordingError> {
    let mut reader = RecordingReader::open(bytes)?;
    let mut states = Vec::new();
    while let Some(message) = reader.next_message()? {
        assert_eq!(message.topic(), "/control/joint_state");
        states.push(message.record::<JointState>()?);
        assert_eq!(message.stamp_ns, states.last().unwrap().stamp.0 as u64);
    }
    Ok((states, reader.cut_off().is_some()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_file_that_is_cut_off_has_every_chunk_that_was_flushed(
        chunks in proptest::collection::vec(0_u64..40, 1..6), cut in 0.0..1.0_f64,
    ) {
        let (bytes, flushed) = recorded(&chunks);
        let (whole, is_cut) = read(&bytes).unwrap();
        prop_assert!(!is_cut);
        prop_assert_eq!(whole, (0..chunks.iter().sum()).map(state).collect::<Vec<_>>());
        let end = flushed[0] + ((bytes.len() - 1 - flushed[0]) as f64 * cut) as usize;
        let (states, is_cut) = read(&bytes[..end]).unwrap();
        prop_assert!(is_cut);
        let complete = flushed[1..].iter().take_while(|length| **length <= end).count().min(chunks.len());
        let least: u64 = chunks[..complete].iter().sum();
        prop_assert!(states.len() as u64 >= least, "{} of {least}", states.len());
        prop_assert_eq!(&states, &(0..states.len() as u64).map(state).collect::<Vec<_>>());
    }

    /// A flipped bit costs at most what comes after it; what is read is never something else.
    #[test]
    fn damage_is_never_read_as_something_else(at in 0.0..1.0_f64, bit in 0_u32..8) {
        let (mut bytes, flushed) = recorded(&[30, 30, 30]);
        let chunks = flushed[0]..flushed[3];
        let at = chunks.start + ((chunks.len() - 1) as f64 * at) as usize;
        bytes[at] ^= 1 << bit;
        if let Ok((states, _)) = read(&bytes) {
            let of_sums: Vec<_> = states.iter().map(|s| s.tick).collect();
            for (s, k) in states.iter().zip(of_sums) {
                prop_assert_eq!(*s, state(k));
            }
        }
    }

    #[test]
    fn other_files_are_no_recordings(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(RecordingReader::open(&bytes[..]).is_err());
    }
}

#[test]
fn files_facts_and_images_come_back() {
    let mut writer =
        RecordingWriter::new(Vec::new(), &BTreeMap::from([("clock".into(), "lockstep".into())])).unwrap();
    writer.attach(RUN_FILE, "application/toml", b"[run]").unwrap();
    let images = writer.add_images("/camera/0/frame", "camera_0").unwrap();
    let measurements = writer.add_records::<Measurement>("/vision/0/measurement").unwrap();
    let header = FrameHeader {
        frame_id: 3,
        exposure: MonoNs(2_500_000_000),
        width_px: 3,
        height_px: 2,
        ..FrameHeader::default()
    };
    writer.write_image(&images, &header, &[1, 2, 3, 4, 5, 6]).unwrap();
    let measurement = Measurement { frame_id: 3, pose: [0.5; 7], ..Measurement::default() };
    writer.write(measurements, 0, header.exposure, &measurement).unwrap();
    let bytes = writer.finish(&BTreeMap::from([("lost".into(), "0".into())])).unwrap();
    let mut reader = RecordingReader::open(&bytes[..]).unwrap();
    assert_eq!(reader.attachments()[RUN_FILE], b"[run]");
    assert_eq!(reader.metadata()[ABOUT]["clock"], "lockstep");
    let message = reader.next_message().unwrap().unwrap();
    assert_eq!(message.image().unwrap(), ImageMessage::new(&header, &[1, 2, 3, 4, 5, 6]));
    assert!(matches!(message.record::<TraceMsg>(), Err(RecordingError::Version { .. })));
    let message = reader.next_message().unwrap().unwrap();
    assert_eq!((message.record::<Measurement>().unwrap(), message.sequence), (measurement, 0));
    let error = message.record::<TraceMsg>().unwrap_err().to_string();
    assert!(error.contains("carries vservo.Measurement.v4, this program knows vservo.Trace.v5"), "{error}");
    assert!(message.image().is_err());
    assert!(reader.next_message().unwrap().is_none() && reader.cut_off().is_none());
    assert_eq!(reader.metadata()[END]["lost"], "0");
}
