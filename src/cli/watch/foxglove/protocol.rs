//! The messages of the protocol: text as JSON in either direction, and channels' messages in binary
//! (<https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>).

use serde::{Deserialize, Serialize};

/// The names under which clients ask for it, the older first, which forks speak too; of what both say, the same is used here.
pub(crate) const PROTOCOLS: [&str; 2] = ["foxglove.websocket.v1", "foxglove.sdk.v1"];
/// A message of a channel, as the protocol numbers what is binary.
const MESSAGE_DATA: u8 = 1;

/// What a client asks for that wants a WebSocket.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SocketRequest {
    /// What proves that the request was understood (RFC 6455, Sect. 4.2.2).
    pub(crate) accept: String,
    /// One of [`PROTOCOLS`].
    pub(crate) protocol: &'static str,
}

/// What viewers can subscribe to.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ViewerChannel {
    pub(super) id: u32,
    pub(super) topic: String,
    pub(super) encoding: &'static str,
    pub(super) schema_name: String,
    pub(super) schema: String,
    pub(super) schema_encoding: &'static str,
}

/// What is told to a viewer as text.
#[derive(Debug, Serialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(super) enum ServerText<'a> {
    /// Who serves.
    #[serde(rename_all = "camelCase")]
    ServerInfo { name: &'a str, capabilities: [&'static str; 0], session_id: &'a str },
    /// Channels that are there now.
    Advertise { channels: Vec<&'a ViewerChannel> },
    /// Channels that are gone.
    #[serde(rename_all = "camelCase")]
    Unadvertise { channel_ids: &'a [u32] },
    /// Something for the user to read.
    Status { level: u8, message: &'a str },
}

impl ServerText<'_> {
    /// As it is sent.
    pub(super) fn to_json(&self) -> String {
        // nothing of it can fail
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// A wish to be sent the messages of a channel, under a number of the viewer's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Subscription {
    pub(super) id: u32,
    pub(super) channel_id: u32,
}

/// What a viewer asks for.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(super) enum ViewerText {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    /// Anything else: what could change something, and is not offered.
    #[serde(other)]
    Other,
}

impl ViewerText {
    /// What `text` asks for; `None` where it is no message of the protocol.
    pub(super) fn read(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }
}

/// A message of a channel for the subscription `id`, about the instant `stamp_ns`.
pub(super) fn message_data(id: u32, stamp_ns: u64, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(data.len() + 13); // the head: one byte, four and eight
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&id.to_le_bytes());
    bytes.extend_from_slice(&stamp_ns.to_le_bytes());
    bytes.extend_from_slice(data);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_those_of_the_specification() {
        let info = ServerText::ServerInfo { name: "vservo", capabilities: [], session_id: "3" }.to_json();
        assert_eq!(info, r#"{"op":"serverInfo","name":"vservo","capabilities":[],"sessionId":"3"}"#);
        let channel = ViewerChannel {
            id: 7,
            topic: "/tf".into(),
            encoding: "cdr",
            schema_name: "tf2_msgs/msg/TFMessage".into(),
            schema: "x".into(),
            schema_encoding: "ros2msg",
        };
        let told = ServerText::Advertise { channels: vec![&channel] }.to_json();
        let wanted = r#"{"op":"advertise","channels":[{"id":7,"topic":"/tf","encoding":"cdr","schemaName":"tf2_msgs/msg/TFMessage","schema":"x","schemaEncoding":"ros2msg"}]}"#;
        assert_eq!(told, wanted);
        assert_eq!(
            ServerText::Unadvertise { channel_ids: &[7] }.to_json(),
            r#"{"op":"unadvertise","channelIds":[7]}"#
        );
        assert_eq!(message_data(1, 2, b"ab"), [1, 1, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, b'a', b'b']);
        let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":0,"channelId":7}]}"#;
        let subscriptions = vec![Subscription { id: 0, channel_id: 7 }];
        assert_eq!(ViewerText::read(subscribe), Some(ViewerText::Subscribe { subscriptions }));
        let leave = r#"{"op":"unsubscribe","subscriptionIds":[0]}"#;
        assert_eq!(ViewerText::read(leave), Some(ViewerText::Unsubscribe { subscription_ids: vec![0] }));
        assert_eq!(ViewerText::read(r#"{"op":"setParameters","parameters":[]}"#), Some(ViewerText::Other));
        for none in
            ["", "{}", "[]", "null", r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":7}]}"#]
        {
            assert_eq!(ViewerText::read(none), None, "{none}");
        }
    }
}
