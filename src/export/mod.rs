//! A recording for other programs (`vservo export`): with the messages that viewers know by themselves beside the records ([`write_for_viewers`]), or as tables
//! ([`write_tables`]); and the records themselves for programs in other languages ([`layouts`]).

mod cdr;
mod definitions;
mod derived;
mod derived_message;
mod layouts;
mod scene;
mod tables;
mod viewers;

pub use derived::DerivedMessages;
pub use derived_message::DerivedMessage;
pub use layouts::{LayoutLanguage, layouts};
pub use tables::{ExportedTable, write_tables};
pub use viewers::{ViewerKind, write_for_viewers};
