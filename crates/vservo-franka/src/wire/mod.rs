//! What goes over the wire in version 10 of the interface: packed, little-endian, as the maker's headers lay it out.
//!
//! ```text
//! TCP 1337   header (command u32, number u32, size u32: header and payload) · payload        requests, replies
//! UDP        RobotState, 1377 bytes, from the robot; RobotCommand, 371 bytes, to it          1 kHz
//! ```
//! A reply has the command and the number of its request; its payload begins with a status of one byte. `Move` is replied to twice: when the motion has
//! begun, and when it has ended. Nothing here allocates but the texts of robot models.

mod command;
mod frame;
mod request;
mod state;

pub use command::{ROBOT_COMMAND_SIZE, RobotCommand};
pub use frame::{Framer, Message};
pub(crate) use request::LONGEST as LONGEST_REQUEST;
pub use request::{
    CollisionBehavior, Load, MoveController, MoveGenerator, MoveStatus, Request, RequestKind,
    encode_connect_reply, encode_reply, read_request,
};
pub use state::{ERRORS, RIGID, ROBOT_STATE_SIZE, RobotState};

use thiserror::Error;

/// The version of the interface that this crate speaks.
pub const VERSION: u16 = 10;
/// The port of the controller.
pub const PORT: u16 = 1337;
/// Bytes of a header.
pub const HEADER_SIZE: usize = 12;

/// Bytes that are no message.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum WireError {
    /// A size that no message has.
    #[error("a message of {size} bytes")]
    Size {
        /// What the header says.
        size: u32,
    },
    /// A command that nobody knows.
    #[error("the unknown command {number}")]
    UnknownCommand {
        /// Its number.
        number: u32,
    },
    /// A message that ends too early.
    #[error("a message that ends before its {what}")]
    Short {
        /// What is missing.
        what: &'static str,
    },
    /// A value that is none of those that there are.
    #[error("{what} {value}")]
    Value {
        /// What it should be.
        what: &'static str,
        /// What it is.
        value: u32,
    },
}

/// Reads values one after another.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    /// From the begin.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// The next bytes.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn take<const K: usize>(&mut self, what: &'static str) -> Result<[u8; K], WireError> {
        let (taken, rest) = self.bytes.split_first_chunk::<K>().ok_or(WireError::Short { what })?;
        self.bytes = rest;
        Ok(*taken)
    }

    /// The next byte.
    ///
    /// # Errors
    /// When there is none.
    pub fn u8(&mut self, what: &'static str) -> Result<u8, WireError> {
        self.take::<1>(what).map(|[byte]| byte)
    }

    /// The next number.
    ///
    /// # Errors
    /// When there are too few bytes.
    pub fn u32(&mut self, what: &'static str) -> Result<u32, WireError> {
        self.take(what).map(u32::from_le_bytes)
    }

    /// The next numbers.
    ///
    /// # Errors
    /// When there are too few bytes.
    pub fn f64s<const K: usize>(&mut self, what: &'static str) -> Result<[f64; K], WireError> {
        let mut values = [0.0; K];
        for value in &mut values {
            *value = f64::from_le_bytes(self.take(what)?);
        }
        Ok(values)
    }

    /// The next numbers of single precision.
    ///
    /// # Errors
    /// When there are too few bytes.
    pub fn f32s<const K: usize>(&mut self, what: &'static str) -> Result<[f64; K], WireError> {
        let mut values = [0.0; K];
        for value in &mut values {
            *value = f64::from(f32::from_le_bytes(self.take(what)?));
        }
        Ok(values)
    }

    /// All that is left.
    #[must_use]
    pub fn rest(&self) -> &'a [u8] {
        self.bytes
    }
}

/// Writes values one after another into room that is there.
pub(crate) struct Writer<'a> {
    room: &'a mut [u8],
    at: usize,
}

impl<'a> Writer<'a> {
    pub(crate) fn new(room: &'a mut [u8]) -> Self {
        Self { room, at: 0 }
    }

    /// What does not fit is left out: the room is as large as its layout says.
    pub(crate) fn put(&mut self, bytes: &[u8]) {
        if let Some(to) = self.room.get_mut(self.at..self.at + bytes.len()) {
            to.copy_from_slice(bytes);
        }
        self.at += bytes.len();
    }

    pub(crate) fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.put(&value.to_le_bytes());
        }
    }

    pub(crate) fn f32s(&mut self, values: &[f64]) {
        for value in values {
            self.put(&(*value as f32).to_le_bytes());
        }
    }

    /// Where the next value goes.
    pub(crate) fn place(&self) -> usize {
        self.at
    }
}
