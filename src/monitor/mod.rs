//! A running instance in a terminal (`vservo monitor`): messages -> [`RunView`] -> [`Screen`] of cells -> the characters that change it.
//!
//! All of it is pure. What subscribes to the services is `client::RunWatch`, and what speaks to the terminal `rt::Terminal`.
//! ```text
//! Status, TraceMsg, Measurement, CameraHealth ─► RunView ─► draw ─► Screen ─► Screen::changes ─► terminal
//! keys ─► MonitorKeys ─► MonitorOrder ─► client
//! ```

mod draw;
mod keys;
mod plot;
mod run_view;
mod screen;

pub use draw::draw;
pub use keys::{MonitorKeys, MonitorOrder};
pub use run_view::{CellFacts, RunView};
pub use screen::{CellStyle, Screen};
