//! Reads a recording from its beginning, also one that has no end: what is damaged or cut off is left out from the first incomplete chunk on.

use super::writer::TYPE_KEY;
use super::{CDR_LITTLE_ENDIAN, ImageMessage, RecordingError};
use crate::messages::MessageRecord;
use mcap::McapError;
use mcap::records::{Channel, MessageHeader, Record as McapRecord, SchemaHeader};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::io::Read;

/// Largest record and chunk that are read, bytes, so that a damaged length allocates little. Chosen by hand: 64 times what a recorder gathers
/// for a chunk, which is one frame more than 4 MiB.
const MAX_RECORD: usize = 256 << 20;

/// A message as it stands in the file.
#[derive(Debug, Clone, Copy)]
pub struct RecordedMessage<'a> {
    topic: &'a str,
    type_name: Option<&'a str>,
    channel: Option<&'a Channel>,
    schema: Option<&'a (SchemaHeader, Vec<u8>)>,
    /// Instant that it is about, ns of the run's clock.
    pub stamp_ns: u64,
    /// The sender's number, modulo 2^32.
    pub sequence: u32,
    data: &'a [u8],
}

impl<'a> RecordedMessage<'a> {
    /// Its topic.
    #[must_use]
    pub fn topic(&self) -> &'a str {
        self.topic
    }

    /// The versioned type name of its records; `None` where it carries none.
    #[must_use]
    pub fn type_name(&self) -> Option<&'a str> {
        self.type_name
    }

    /// The name of its definition; `None` where it has none.
    #[must_use]
    pub fn definition(&self) -> Option<&'a str> {
        self.schema.map(|(header, _)| header.name.as_str())
    }

    /// The bytes as they stand in the file.
    #[must_use]
    pub fn data(&self) -> &'a [u8] {
        self.data
    }

    /// The bytes of a record of `length` bytes; `None` where it is none.
    #[must_use]
    pub fn record_bytes(&self, length: usize) -> Option<&'a [u8]> {
        self.data.strip_prefix(&CDR_LITTLE_ENDIAN).filter(|bytes| bytes.len() == length)
    }

    /// What its topic says of itself: encoding and metadata of the messages, and name, encoding and text of their definition.
    pub(super) fn described(&self) -> Option<(&'a Channel, &'a SchemaHeader, &'a [u8])> {
        let (header, text) = self.schema?;
        Some((self.channel?, header, text))
    }

    /// The record in it.
    ///
    /// # Errors
    /// When the topic carries others, or the message is damaged.
    pub fn record<T: MessageRecord>(&self) -> Result<T, RecordingError> {
        let expected = T::LAYOUT.type_name;
        if self.type_name != Some(expected) {
            let found = self.type_name.unwrap_or("no records").to_owned();
            return Err(RecordingError::Version { topic: self.topic.into(), found, expected });
        }
        let record = self.data.strip_prefix(&CDR_LITTLE_ENDIAN).and_then(T::of_bytes);
        record.ok_or_else(|| RecordingError::Message { topic: self.topic.into(), expected })
    }

    /// The image in it.
    ///
    /// # Errors
    /// When it is none.
    pub fn image(&self) -> Result<ImageMessage<'a>, RecordingError> {
        let expected = "image of 8-bit grey";
        ImageMessage::take(self.data)
            .ok_or_else(|| RecordingError::Message { topic: self.topic.into(), expected })
    }
}

/// Reads a recording. Attachments and metadata that stand before the first message are there from the beginning, the others as soon as they are
/// passed.
pub struct RecordingReader<R: Read> {
    input: R,
    mcap: LinearReader,
    channels: BTreeMap<u16, Channel>,
    schemas: BTreeMap<u16, (SchemaHeader, Vec<u8>)>,
    attachments: BTreeMap<String, Vec<u8>>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// The message that comes next.
    next: Option<MessageHeader>,
    data: Vec<u8>,
    end: Option<Option<String>>,
    tell: Option<TellOfCut>,
}

/// Takes why a recording is cut off, once.
type TellOfCut = Box<dyn FnOnce(&str) + Send>;

impl<R: Read> RecordingReader<R> {
    /// Opens a recording.
    ///
    /// # Errors
    /// When it cannot be read, or is none.
    pub fn open(input: R) -> Result<Self, RecordingError> {
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD);
        let mut reader = Self {
            input,
            mcap: LinearReader::new_with_options(options),
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            attachments: BTreeMap::new(),
            metadata: BTreeMap::new(),
            next: None,
            data: Vec::new(),
            end: None,
            tell: None,
        };
        reader.advance()?;
        if reader.channels.is_empty() && reader.metadata.is_empty() {
            return Err(RecordingError::Format(McapError::BadMagic));
        }
        Ok(reader)
    }

    /// The same reader, which calls `tell` with the reason of [`Self::cut_off`] as soon as it comes there; whoever reads on does not see otherwise that something is missing.
    #[must_use]
    pub fn telling_of_cut(mut self, tell: impl FnOnce(&str) + Send + 'static) -> Self {
        self.tell = Some(Box::new(tell));
        self.tell_of_cut();
        self
    }

    fn tell_of_cut(&mut self) {
        if let Some(why) = self.end.as_ref().and_then(Option::as_ref)
            && let Some(tell) = self.tell.take()
        {
            tell(why);
        }
    }

    /// The attachments so far, by their names.
    #[must_use]
    pub fn attachments(&self) -> &BTreeMap<String, Vec<u8>> {
        &self.attachments
    }

    /// The metadata so far, by their names.
    #[must_use]
    pub fn metadata(&self) -> &BTreeMap<String, BTreeMap<String, String>> {
        &self.metadata
    }

    /// The topics so far, with the names of their definitions.
    pub fn topics(&self) -> impl Iterator<Item = (&str, &str)> {
        let name =
            |channel: &Channel| self.schemas.get(&channel.schema_id).map(|(header, _)| header.name.as_str());
        self.channels.values().filter_map(move |channel| Some((channel.topic.as_str(), name(channel)?)))
    }

    /// At the end, why the file has none of its own: it is cut off or damaged there.
    #[must_use]
    pub fn cut_off(&self) -> Option<&str> {
        self.end.as_ref()?.as_deref()
    }

    /// The next message; `None` at the end, also at one where the file is cut off.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage<'_>>, RecordingError> {
        if self.next.is_none() {
            self.advance()?;
        }
        let Some(header) = self.next.take() else { return Ok(None) };
        let channel = self.channels.get(&header.channel_id);
        Ok(Some(RecordedMessage {
            topic: channel.map_or("", |channel| &channel.topic),
            type_name: channel.and_then(|c| c.metadata.get(TYPE_KEY)).map(String::as_str),
            channel,
            schema: channel.and_then(|c| self.schemas.get(&c.schema_id)),
            stamp_ns: header.log_time,
            sequence: header.sequence,
            data: &self.data,
        }))
    }

    /// Reads on to the next message, or to the end.
    fn advance(&mut self) -> Result<(), RecordingError> {
        while self.next.is_none() && self.end.is_none() {
            match self.mcap.next_event() {
                None => self.end = Some(None),
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    let count = self.input.read(self.mcap.insert(wanted))?;
                    self.mcap.notify_read(count);
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    match mcap::parse_record(opcode, data) {
                        Ok(McapRecord::Message { header, data }) => {
                            self.data.clear();
                            self.data.extend_from_slice(&data);
                            self.next = Some(header);
                        }
                        Ok(McapRecord::Schema { header, data }) => {
                            self.schemas.insert(header.id, (header, data.into_owned()));
                        }
                        Ok(McapRecord::Channel(channel)) => {
                            self.channels.insert(channel.id, channel);
                        }
                        Ok(McapRecord::Attachment { header, data, .. }) => {
                            self.attachments.insert(header.name, data.into_owned());
                        }
                        Ok(McapRecord::Metadata(facts)) => {
                            self.metadata.insert(facts.name, facts.metadata);
                        }
                        Ok(_) => {}
                        Err(error) => self.end = Some(Some(error.to_string())),
                    }
                }
                Some(Err(error)) => self.end = Some(Some(error.to_string())),
            }
        }
        self.tell_of_cut();
        Ok(())
    }
}
