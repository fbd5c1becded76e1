//! What was sent lately, in memory: small recordings of half a second each, of which the oldest go; and the file that is made of them.
//!
//! Each block is a recording of its own, with its own definitions, so that any of them may go. Frames, which are most of the bytes, are kept apart from everything else, for as long as their room lasts.

use super::taps::ServiceTap;
use super::{RecordedFile, take_all};
use crate::process::ProcessError;
use crate::record::{CopiedTopic, RecordingReader, RecordingWriter};
use crate::time::{MonoNs, SpanNs};
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{BufWriter, Cursor};
use std::path::Path;
use std::sync::Arc;

/// A recording of half a second.
#[derive(Debug)]
pub(super) struct KeptBlock {
    began: MonoNs,
    bytes: Vec<u8>,
}

/// Some services and what they sent lately.
pub(super) struct KeptServices {
    taps: Vec<Box<dyn ServiceTap<Vec<u8>>>>,
    writer: RecordingWriter<Vec<u8>>,
    began: MonoNs,
    blocks: KeptBlocks,
}

impl KeptServices {
    /// Keeps what `taps` take for `longest`, in at most `room` bytes.
    pub(super) fn new(
        mut taps: Vec<Box<dyn ServiceTap<Vec<u8>>>>,
        (longest, room): (SpanNs, usize),
        time: MonoNs,
    ) -> Result<Self, ProcessError> {
        let writer = begin(&mut taps)?;
        let blocks = KeptBlocks { longest, room, ..KeptBlocks::default() };
        Ok(Self { taps, writer, began: time, blocks })
    }

    /// Takes what there is; whether there was anything.
    pub(super) fn take_all(&mut self) -> Result<bool, ProcessError> {
        take_all(&mut self.taps, &mut self.writer)
    }

    /// Its services.
    pub(super) fn taps(&self) -> &[Box<dyn ServiceTap<Vec<u8>>>] {
        &self.taps
    }

    /// Ends the block at `time`, and begins the next one.
    pub(super) fn end_block(&mut self, time: MonoNs) -> Result<(), ProcessError> {
        let next = begin(&mut self.taps)?;
        let whole = std::mem::replace(&mut self.writer, next);
        let began = std::mem::replace(&mut self.began, time);
        if whole.waiting_bytes() > 0 {
            self.blocks.keep(KeptBlock { began, bytes: whole.finish(&BTreeMap::new())? });
        }
        Ok(())
    }

    /// The blocks that are kept, the oldest first.
    pub(super) fn kept(&self) -> impl Iterator<Item = &Arc<KeptBlock>> {
        self.blocks.blocks.iter()
    }
}

fn begin(taps: &mut [Box<dyn ServiceTap<Vec<u8>>>]) -> Result<RecordingWriter<Vec<u8>>, ProcessError> {
    let mut writer = RecordingWriter::new(Vec::new(), &BTreeMap::new())?;
    taps.iter_mut().try_for_each(|tap| tap.begin(&mut writer))?;
    Ok(writer)
}

/// Blocks of which the oldest go.
#[derive(Debug, Default)]
struct KeptBlocks {
    blocks: VecDeque<Arc<KeptBlock>>,
    bytes: usize,
    longest: SpanNs,
    room: usize,
}

impl KeptBlocks {
    /// Keeps the newest block, and lets those go that are too old, or for which there is no room.
    fn keep(&mut self, block: KeptBlock) {
        let oldest = block.began - self.longest;
        self.bytes += block.bytes.len();
        self.blocks.push_back(Arc::new(block));
        // One goes when the next one is old enough.
        while let (Some(first), Some(next)) = (self.blocks.front(), self.blocks.get(1))
            && (next.began < oldest || self.bytes > self.room)
        {
            self.bytes -= first.bytes.len();
            self.blocks.pop_front();
        }
    }
}

/// Writes a recording of `blocks` into the file at `path`, with `files` and what it is `about`, and at the end how many messages of each topic there are, and `end`. What lies there meanwhile ends in `.part`.
pub(super) fn write(
    path: &Path,
    about: &BTreeMap<String, String>,
    files: &[RecordedFile],
    mut blocks: Vec<Arc<KeptBlock>>,
    end: BTreeMap<String, String>,
) -> Result<(), ProcessError> {
    blocks.sort_by_key(|block| block.began);
    let part = path.with_added_extension("part");
    let failed = |cause| ProcessError::Write { path: path.into(), cause };
    let file = File::create(&part).map_err(failed)?;
    let written = recording_of(BufWriter::new(&file), about, files, &blocks, end)
        .and_then(|()| file.sync_all().map_err(failed))
        .and_then(|()| std::fs::rename(&part, path).map_err(failed));
    if written.is_err() {
        let _ = std::fs::remove_file(&part); // what is half a recording is none
    }
    written
}

fn recording_of(
    sink: impl std::io::Write,
    about: &BTreeMap<String, String>,
    files: &[RecordedFile],
    blocks: &[Arc<KeptBlock>],
    mut end: BTreeMap<String, String>,
) -> Result<(), ProcessError> {
    let mut writer = RecordingWriter::new(sink, about)?;
    for RecordedFile { name, media_type, data } in files {
        writer.attach(name, media_type, data)?;
    }
    let mut topics = BTreeMap::<String, (CopiedTopic, u64)>::new();
    for block in blocks {
        let mut reader = RecordingReader::open(Cursor::new(&block.bytes))?;
        while let Some(message) = reader.next_message()? {
            let (topic, count) = match topics.get_mut(message.topic()) {
                Some(known) => known,
                None => {
                    let new = (writer.add_copied(&message)?, 0);
                    topics.entry(message.topic().to_owned()).or_insert(new)
                }
            };
            *count += 1;
            writer.write_copied(*topic, message.sequence.into(), message.stamp_ns, message.data())?;
        }
        writer.end_chunk()?;
    }
    let counts = topics.into_iter().map(|(topic, (_, count))| (recorded_key(&topic), count.to_string()));
    end.extend(counts);
    writer.finish(&end)?;
    Ok(())
}

/// The key of how many messages of `topic` were recorded.
fn recorded_key(topic: &str) -> String {
    format!("{}: recorded", topic.trim_start_matches('/'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(longest_ms: i64, room: usize, blocks: i64) -> Vec<i64> {
        let ms = |ms: i64| SpanNs(ms * 1_000_000);
        let mut kept = KeptBlocks { longest: ms(longest_ms), room, ..KeptBlocks::default() };
        for k in 0..blocks {
            // Blocks are a little longer than they should be.
            kept.keep(KeptBlock { began: MonoNs(0) + ms(510 * k), bytes: vec![0; 10] });
        }
        assert_eq!(kept.bytes, 10 * kept.blocks.len());
        kept.blocks.iter().map(|block| block.began.0 / 510_000_000).collect()
    }

    #[test]
    fn what_is_kept_is_as_long_as_asked_for_and_fits() {
        assert_eq!(
            kept(1000, 1000, 20),
            [17, 18, 19],
            "the oldest one began more than a second before the newest"
        );
        assert_eq!(kept(1000, 20, 20), [18, 19]);
        assert_eq!(kept(1000, 5, 20), [19], "the newest one stays");
        assert_eq!(kept(60_000, 1000, 3), [0, 1, 2]);
    }
}
