//! From a stream of bytes to packages, whatever the pieces are in which it comes.

use super::wire::{PackageType, WireError};

/// Bytes of a header: a size of two and a type of one, as the protocol says.
const HEADER: usize = 3;
/// The largest package: what a size of two bytes can say, as the protocol does.
const LARGEST: usize = 65_535;

/// A package, its payload still in the framer's buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Package<'a> {
    /// What it is.
    pub kind: PackageType,
    /// Everything behind the header.
    pub payload: &'a [u8],
}

/// Holds what has come and is no whole package yet; allocates once.
#[derive(Debug)]
pub struct Framer {
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
}

impl Default for Framer {
    fn default() -> Self {
        // Twice the largest, so that behind the begin of one package another one has room.
        Self { buffer: vec![0; 2 * LARGEST].into(), start: 0, end: 0 }
    }
}

impl Framer {
    /// Room for what comes next; never empty, as long as packages are taken before more is asked for.
    pub fn room(&mut self) -> &mut [u8] {
        if self.start == self.end {
            (self.start, self.end) = (0, 0);
        } else if self.buffer.len() - self.end < LARGEST {
            self.buffer.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
        }
        self.buffer.get_mut(self.end..).unwrap_or_default()
    }

    /// That so many bytes of the room have been filled.
    pub fn filled(&mut self, count: usize) {
        self.end = (self.end + count).min(self.buffer.len());
    }

    /// Takes bytes in; how many there was room for.
    pub fn push(&mut self, bytes: &[u8]) -> usize {
        let room = self.room();
        let count = room.len().min(bytes.len());
        for (to, from) in room.iter_mut().zip(bytes) {
            *to = *from;
        }
        self.filled(count);
        count
    }

    /// The next whole package; none as long as it has not come whole.
    ///
    /// # Errors
    /// When the stream is no stream of packages: nothing behind that can be trusted.
    #[allow(clippy::should_implement_trait)] // it lends from its buffer
    pub fn next(&mut self) -> Result<Option<Package<'_>>, WireError> {
        let waiting = self.buffer.get(self.start..self.end).unwrap_or_default();
        let Some(([high, low, byte], _)) = waiting.split_first_chunk::<HEADER>() else { return Ok(None) };
        let size = u16::from_be_bytes([*high, *low]);
        if usize::from(size) < HEADER {
            return Err(WireError::Size { size });
        }
        let kind = PackageType::of(*byte).ok_or(WireError::Type { byte: *byte })?;
        let start = self.start;
        let end = start + usize::from(size);
        if end > self.end {
            return Ok(None);
        }
        self.start = end;
        Ok(Some(Package { kind, payload: self.buffer.get(start + HEADER..end).unwrap_or_default() }))
    }

    /// Whether bytes wait that are no whole package.
    #[must_use]
    pub fn holds_a_part(&self) -> bool {
        self.start < self.end
    }
}
