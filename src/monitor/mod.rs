//! A running instance in a terminal (`vservo monitor`) or a browser (`vservo watch`): messages -> [`RunView`] -> [`Screen`] of cells -> the characters
//! that change it, or [`RunSnapshot`] -> JSON for the page.
//!
//! All of it is pure. What subscribes to the services is `client::RunWatch`, what speaks to the terminal `rt::Terminal`, and to browsers `cli/watch/`.
//! ```text
//! Status, TraceMsg, Measurement, CameraHealth ─► RunView ─► draw ─► Screen ─► Screen::changes ─► terminal
//!                                                    └─► snapshot ─► RunSnapshot ─► JSON
//! keys ─► MonitorKeys ─► MonitorOrder ─► client
//! ```

mod draw;
mod keys;
mod plot;
mod robot_row;
mod run_view;
mod screen;
mod snapshot;

pub use draw::draw;
pub use keys::{MonitorKeys, MonitorOrder};
pub use robot_row::RobotRow;
pub use run_view::{CellFacts, RunView, WatchedRecord};
pub use screen::{CellStyle, Screen};
pub use snapshot::{DeadlineTimes, HealthRow, JointRow, ProcessRow, RunFacts, RunSnapshot, StageTimes};
