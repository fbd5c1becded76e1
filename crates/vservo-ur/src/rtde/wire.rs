//! Bytes: what a package is made of, read without panics and written without surprises.

use crate::{JOINTS, Joints};
use thiserror::Error;

/// What a package is, as its third byte says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PackageType {
    /// `V`: the protocol version is asked for, or accepted.
    ProtocolVersion,
    /// `v`: the version of the controller's software.
    ControlVersion,
    /// `M`: a message in words.
    Text,
    /// `U`: values of a recipe.
    Data,
    /// `O`: what the controller is to send.
    SetupOutputs,
    /// `I`: what the client is to send.
    SetupInputs,
    /// `S`: data may flow.
    Start,
    /// `P`: data shall stop.
    Pause,
}

impl PackageType {
    const ALL: [(u8, Self); 8] = [
        (b'V', Self::ProtocolVersion),
        (b'v', Self::ControlVersion),
        (b'M', Self::Text),
        (b'U', Self::Data),
        (b'O', Self::SetupOutputs),
        (b'I', Self::SetupInputs),
        (b'S', Self::Start),
        (b'P', Self::Pause),
    ];

    /// The type of a byte; none of one that the protocol does not know.
    #[must_use]
    pub fn of(byte: u8) -> Option<Self> {
        Self::ALL.iter().find(|(code, _)| *code == byte).map(|(_, kind)| *kind)
    }

    /// Its byte.
    #[must_use]
    pub fn byte(self) -> u8 {
        Self::ALL.iter().find(|(_, kind)| *kind == self).map_or(0, |(code, _)| *code)
    }
}

/// A package that is not what the protocol says.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum WireError {
    /// A header's size is smaller than the header.
    #[error("a package of {size} bytes, where the header alone has 3")]
    Size {
        /// The size that it states.
        size: u16,
    },
    /// The type's byte is none of the protocol.
    #[error("a package of the unknown type {byte:#04x}")]
    Type {
        /// That byte.
        byte: u8,
    },
    /// The payload ends before its last field.
    #[error("a payload ends within `{field}`")]
    Short {
        /// The field.
        field: &'static str,
    },
    /// The payload goes on behind its last field.
    #[error("{count} bytes too many behind `{field}`")]
    Long {
        /// How many.
        count: usize,
        /// The last field.
        field: &'static str,
    },
    /// A value's type is none of the protocol.
    #[error("the type `{name}` of `{variable}` is unknown")]
    ValueType {
        /// The variable.
        variable: String,
        /// Its type, as the other end says.
        name: String,
    },
    /// The answer tells of another number of variables than were asked for.
    #[error("{got} types for {asked} variables")]
    Count {
        /// Variables that were asked for.
        asked: usize,
        /// Types that came.
        got: usize,
    },
}

/// Reads a payload from its front.
#[derive(Debug, Clone)]
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// A reader of these bytes.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// What is left.
    #[must_use]
    pub fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.0)
    }

    /// The next `N` bytes.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn bytes<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], WireError> {
        let (head, tail) = self.0.split_first_chunk::<N>().ok_or(WireError::Short { field })?;
        self.0 = tail;
        Ok(*head)
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn take(&mut self, count: usize, field: &'static str) -> Result<&'a [u8], WireError> {
        let (head, tail) = self.0.split_at_checked(count).ok_or(WireError::Short { field })?;
        self.0 = tail;
        Ok(head)
    }

    /// An unsigned byte.
    ///
    /// # Errors
    /// When nothing is left.
    pub fn u8(&mut self, field: &'static str) -> Result<u8, WireError> {
        Ok(self.bytes::<1>(field)?[0])
    }

    /// An unsigned number of two bytes.
    ///
    /// # Errors
    /// When fewer are left.
    pub fn u16(&mut self, field: &'static str) -> Result<u16, WireError> {
        Ok(u16::from_be_bytes(self.bytes(field)?))
    }

    /// An unsigned number of four bytes.
    ///
    /// # Errors
    /// When fewer are left.
    pub fn u32(&mut self, field: &'static str) -> Result<u32, WireError> {
        Ok(u32::from_be_bytes(self.bytes(field)?))
    }

    /// A signed number of four bytes.
    ///
    /// # Errors
    /// When fewer are left.
    pub fn i32(&mut self, field: &'static str) -> Result<i32, WireError> {
        Ok(i32::from_be_bytes(self.bytes(field)?))
    }

    /// A number of eight bytes with a point.
    ///
    /// # Errors
    /// When fewer are left.
    pub fn f64(&mut self, field: &'static str) -> Result<f64, WireError> {
        Ok(f64::from_be_bytes(self.bytes(field)?))
    }

    /// Six of them.
    ///
    /// # Errors
    /// When fewer are left.
    pub fn joints(&mut self, field: &'static str) -> Result<Joints, WireError> {
        let mut joints = [0.0; JOINTS];
        for joint in &mut joints {
            *joint = self.f64(field)?;
        }
        Ok(joints)
    }

    /// That nothing is left.
    ///
    /// # Errors
    /// When something is.
    pub fn end(&self, field: &'static str) -> Result<(), WireError> {
        if self.0.is_empty() { Ok(()) } else { Err(WireError::Long { count: self.0.len(), field }) }
    }
}

/// Writes one package into a buffer that is used again and again.
#[derive(Debug, Clone, Default)]
pub struct Writer(Vec<u8>);

impl Writer {
    /// A writer whose buffer holds packages up to `bytes` without growing.
    #[must_use]
    pub fn with_capacity(bytes: usize) -> Self {
        Self(Vec::with_capacity(bytes))
    }

    /// Begins a package.
    pub fn begin(&mut self, kind: PackageType) -> &mut Self {
        self.0.clear();
        self.0.extend([0, 0, kind.byte()]);
        self
    }

    /// Adds bytes.
    pub fn put(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self
    }

    /// Adds values of the joints.
    pub fn joints(&mut self, joints: &Joints) -> &mut Self {
        for joint in joints {
            self.put(&joint.to_be_bytes());
        }
        self
    }

    /// The package, with its size. One that is larger than the protocol can say is cut to an empty one.
    #[must_use]
    pub fn package(&mut self) -> &[u8] {
        let Ok(size) = u16::try_from(self.0.len()) else {
            self.0.truncate(3);
            return self.package();
        };
        for (to, from) in self.0.iter_mut().zip(size.to_be_bytes()) {
            *to = from;
        }
        &self.0
    }
}
