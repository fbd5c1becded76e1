//! The run for Foxglove and its forks, live: the WebSocket protocol `foxglove.websocket.v1` on the port of the page.
//!
//! ```text
//! records of the run ─► LivePublisher: what `vservo export` derives, and the records ─► ChannelHub ─► a viewer's thread ─► its subscriptions
//! ```
//! Who connects is told every channel with its definition, and is sent what it subscribes to. Nobody can send anything to the run.

mod hub;
mod protocol;
mod publisher;
mod viewer;

pub(super) use hub::ChannelHub;
pub(super) use protocol::{PROTOCOLS, SocketRequest};
pub(super) use publisher::LivePublisher;
pub(super) use viewer::serve_viewer;
