//! RTDE, protocol version 2: packages of a size, a type and a payload, all big endian.
//!
//! ```text
//! client                                        controller
//! V 0002 ─────────────────────────────────────► V 01                   protocol version
//! v ──────────────────────────────────────────► v major minor bugfix build
//! O rate, "timestamp,actual_q,..." ───────────► O recipe, "DOUBLE,VECTOR6D,..."
//! I "input_int_register_24,..." ──────────────► I recipe, "INT32,..." (IN_USE: somebody else writes it)
//! S ──────────────────────────────────────────► S 01, and from then on U recipe, values, at the rate
//! U recipe, values ───────────────────────────► registers of the program
//! ```

mod client;
mod frame;
mod recipe;
mod types;
mod wire;

pub(crate) use client::nanoseconds;
pub use client::{RtdeClient, RtdeSettings};
pub use frame::{Framer, Package};
pub use recipe::{Recipe, SetupReply};
pub use types::DataType;
pub use wire::{PackageType, Reader, WireError, Writer};

/// The protocol version that is spoken.
pub const PROTOCOL_VERSION: u16 = 2;
/// The port, by the maker's documentation.
pub const PORT: u16 = 30_004;
