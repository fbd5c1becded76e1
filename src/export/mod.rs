//! A recording for other programs (`vservo export`): with the messages that viewers know by themselves beside the records ([`write_for_viewers`]), or as tables
//! ([`write_tables`]).

mod cdr;
mod definitions;
mod derived;
mod derived_message;
mod scene;
mod tables;
mod viewers;

pub use derived::DerivedMessages;
pub use derived_message::DerivedMessage;
pub use tables::{ExportedTable, write_tables};
pub use viewers::{ViewerKind, write_for_viewers};
