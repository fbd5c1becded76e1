//! From a stream of bytes to messages, whatever the pieces are in which it comes.

use super::{HEADER_SIZE, Reader, RequestKind, WireError};

/// Largest message that is believed, bytes. Chosen by hand: a robot's model is a text of some ten thousand.
const LARGEST: u32 = 4 << 20;
/// Room that is there from the begin, bytes. Chosen by hand: replies have 13, so that none of them allocates.
const ROOM: usize = 4096;

/// A message, its payload still in the framer's buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message<'a> {
    /// What is asked for or replied to.
    pub kind: RequestKind,
    /// The number of the request.
    pub number: u32,
    /// Everything behind the header.
    pub payload: &'a [u8],
}

/// Holds what has come and is no whole message yet. It grows for large ones alone.
#[derive(Debug)]
pub struct Framer {
    buffer: Vec<u8>,
    start: usize,
    end: usize,
}

impl Default for Framer {
    fn default() -> Self {
        Self { buffer: vec![0; ROOM], start: 0, end: 0 }
    }
}

impl Framer {
    /// Room for what comes next, which is never empty as long as messages are taken before more is asked for.
    pub fn room(&mut self) -> &mut [u8] {
        self.buffer.copy_within(self.start..self.end, 0);
        (self.start, self.end) = (0, self.end - self.start);
        if let Some(size) = self.size() {
            let whole = (size.min(LARGEST) as usize).max(ROOM);
            if self.buffer.len() < whole {
                self.buffer.resize(whole, 0);
            }
        }
        self.buffer.get_mut(self.end..).unwrap_or_default()
    }

    /// That so many bytes of the room have been filled.
    pub fn filled(&mut self, count: usize) {
        self.end = (self.end + count).min(self.buffer.len());
    }

    fn size(&self) -> Option<u32> {
        let bytes = self.buffer.get(self.start..self.end)?.get(8..HEADER_SIZE)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    }

    /// The next whole message; none as long as one is incomplete.
    ///
    /// # Errors
    /// When what has come is no message.
    pub fn message(&mut self) -> Result<Option<Message<'_>>, WireError> {
        let Some(size) = self.size() else { return Ok(None) };
        if size < HEADER_SIZE as u32 || size > LARGEST {
            return Err(WireError::Size { size });
        }
        let end = self.start + size as usize;
        if end > self.end {
            return Ok(None);
        }
        let bytes = self.buffer.get(self.start..end).unwrap_or_default();
        self.start = end;
        let mut reader = Reader::new(bytes);
        let kind = RequestKind::of(reader.u32("command")?)?;
        let number = reader.u32("number")?;
        reader.u32("size")?;
        Ok(Some(Message { kind, number, payload: reader.rest() }))
    }
}
