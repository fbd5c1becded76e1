//! The live channels of `vservo watch`, as a program that speaks Foxglove's protocol sees them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests, and a skip is told

use crate::common::wait_until;
use crate::record::python;
use crate::serve::Daemon;
use crate::watch::Watch;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::net::TcpStream;
use std::process::Command;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// A viewer, what it was told of channels, and the messages that it was sent, by topic.
pub(crate) struct Viewer {
    socket: WebSocket<TcpStream>,
    name: String,
    channels: BTreeMap<String, Value>,
    subscribed: BTreeMap<u32, String>,
    messages: BTreeMap<String, Vec<(u64, Vec<u8>)>>,
    warnings: Vec<String>,
}

fn connect(watch: &Watch, headers: &[(&'static str, &str)]) -> Result<WebSocket<TcpStream>, String> {
    let query = if watch.query.is_empty() { String::new() } else { format!("?{}", watch.query) };
    let mut request = format!("ws://{}/{query}", watch.address).into_client_request().unwrap();
    for (name, value) in headers {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    let stream = TcpStream::connect(watch.address).unwrap();
    let (socket, answer) = tungstenite::client(request, stream).map_err(|error| error.to_string())?;
    assert_eq!(answer.headers()["sec-websocket-protocol"], "foxglove.websocket.v1");
    Ok(socket)
}

impl Viewer {
    pub(crate) fn of(watch: &Watch) -> Self {
        let socket = connect(watch, &[("Sec-WebSocket-Protocol", "foxglove.websocket.v1")]).unwrap();
        Self {
            socket,
            name: String::new(),
            channels: BTreeMap::new(),
            subscribed: BTreeMap::new(),
            messages: BTreeMap::new(),
            warnings: Vec::new(),
        }
    }

    fn send(&mut self, value: &Value) {
        self.socket.send(Message::Text(value.to_string().into())).unwrap();
    }

    fn read(&mut self) {
        match self.socket.read().unwrap() {
            Message::Text(text) => self.told(&serde_json::from_str(&text).unwrap()),
            Message::Binary(data) => {
                assert_eq!(data[0], 1, "a message of a channel");
                let id = u32::from_le_bytes(data[1..5].try_into().unwrap());
                let stamp = u64::from_le_bytes(data[5..13].try_into().unwrap());
                let topic = self.subscribed.get(&id).expect("nothing but what was subscribed to").clone();
                self.messages.entry(topic).or_default().push((stamp, data[13..].to_vec()));
            }
            _ => {}
        }
    }

    fn told(&mut self, told: &Value) {
        match told["op"].as_str().unwrap() {
            "serverInfo" => self.name = told["name"].as_str().unwrap().to_owned(),
            "advertise" => {
                for channel in told["channels"].as_array().unwrap() {
                    self.channels.insert(channel["topic"].as_str().unwrap().to_owned(), channel.clone());
                }
            }
            "unadvertise" => {
                let gone = told["channelIds"].as_array().unwrap();
                self.channels.retain(|_, channel| !gone.contains(&channel["id"]));
            }
            "status" => self.warnings.push(told["message"].as_str().unwrap().to_owned()),
            other => panic!("{other}"),
        }
    }

    pub(crate) fn until(&mut self, what: &str, is: impl Fn(&Self) -> bool) {
        for _ in 0..100_000 {
            if is(self) {
                return;
            }
            self.read();
        }
        panic!("{what}: {:?}", self.channels.keys());
    }

    pub(crate) fn subscribe(&mut self, topic: &str) {
        self.until(topic, |viewer| viewer.channels.contains_key(topic));
        let id = 100 + self.subscribed.len() as u32;
        let channel = &self.channels[topic]["id"];
        let wish = json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] });
        self.subscribed.insert(id, topic.to_owned());
        self.send(&wish);
    }

    pub(crate) fn count(&self, topic: &str) -> usize {
        self.messages.get(topic).map_or(0, Vec::len)
    }
}

#[test]
fn a_program_that_speaks_the_protocol_is_sent_what_it_asks_for() {
    let daemon = Daemon::start("foxglove", &["--set", "servo.gain_1_s=0.5"]);
    let watch = Watch::start(&daemon.instance.name, &[]);
    let mut viewer = Viewer::of(&watch);
    viewer.until("the run", |viewer| viewer.name.ends_with(&daemon.instance.name));
    let topics = ["/control/trace", "/camera/0/frame", "/tf", "/joint_states", "/camera/0/annotations"];
    topics.iter().for_each(|topic| viewer.subscribe(topic));
    viewer.until("some of each", |viewer| topics.iter().all(|topic| viewer.count(topic) > 2));
    // Who comes later is told the transforms that hold for the whole run.
    let mut late = Viewer::of(&watch);
    late.subscribe("/tf_static");
    late.until("the mount", |viewer| viewer.count("/tf_static") == 1);
    let image = &viewer.messages["/camera/0/frame"][0].1;
    assert!(image.len() > 640 * 480 && image.len() < 640 * 480 + 100, "{}", image.len());
    let stamps: Vec<u64> = viewer.messages["/control/trace"].iter().map(|(stamp, _)| *stamp).collect();
    assert!(stamps.windows(2).all(|pair| pair[0] < pair[1]), "in order, each once");

    // What is no wish of a watcher is refused in words, and nothing comes of it.
    viewer.send(&json!({ "op": "setParameters", "parameters": [] }));
    viewer.socket.send(Message::Text("nothing".into())).unwrap();
    viewer.socket.send(Message::Binary(vec![1, 0, 0, 0, 0].into())).unwrap();
    viewer.until("words", |viewer| viewer.warnings.len() >= 2);
    let ids: Vec<u32> = viewer.subscribed.keys().copied().collect();
    viewer.send(&json!({ "op": "unsubscribe", "subscriptionIds": ids }));
    viewer.socket.close(None).unwrap();
    drop(viewer);

    // A page of others may not read along.
    let evil = [("Sec-WebSocket-Protocol", "foxglove.websocket.v1"), ("Origin", "https://evil.example")];
    assert!(connect(&watch, &evil).unwrap_err().contains("403"));
    late.subscribe("/rosout");
    late.subscribe("/control/request");
    // Wishes are heard in their order: who is sent states is sent requests too.
    late.subscribe("/control/status");
    late.until("a state", |viewer| viewer.count("/control/status") > 0);
    daemon.accepts("start");
    late.until("the start", |viewer| viewer.count("/control/request") == 1);
    wait_until("servoing", || daemon.state() != "idle");
    daemon.accepts("shutdown");
    watch.wait_for("waits for one");
    watch.ended();
    assert_eq!(daemon.ended().0, Some(0));
}

/// Decodes the messages of a run by the definitions that come with them.
const CLIENT: &str = "
import json, sys, struct, time
from websockets.sync.client import connect
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
wanted = set(sys.argv[2].split(','))
channels, decoders, seen = {}, {}, {}
factory, end = DecoderFactory(), time.monotonic() + 60
with connect(sys.argv[1], subprotocols=['foxglove.sdk.v1', 'foxglove.websocket.v1'], max_size=None) as socket:
    while set(seen) != wanted and time.monotonic() < end:
        message = socket.recv(timeout=30)
        if isinstance(message, str):
            told = json.loads(message)
            for channel in told.get('channels', []):
                channels[channel['id']] = channel
                schema = Schema(id=channel['id'] + 1, name=channel['schemaName'], encoding=channel['schemaEncoding'], data=channel['schema'].encode())
                decoders[channel['id']] = factory.decoder_for(channel['encoding'], schema)
                if channel['topic'] in wanted:
                    socket.send(json.dumps({'op': 'subscribe', 'subscriptions': [{'id': channel['id'], 'channelId': channel['id']}]}))
        else:
            op, id, stamp = struct.unpack_from('<BIQ', message)
            seen[channels[id]['topic']] = decoders[id](message[13:])
joints, tf, image = seen['/joint_states'], seen['/tf'], seen['/camera/0/frame']
print(json.dumps({
    'topics': sorted(seen), 'q': list(joints.position), 'names': list(joints.name), 'frames': [t.child_frame_id for t in tf.transforms],
    'size': [image.width, image.height, len(image.data)], 'fixed': [t.child_frame_id for t in seen['/tf_static'].transforms],
    'trace_q': list(seen['/control/trace'].q), 'k': list(seen['/camera/0/camera_info'].k), 'circles': len(seen['/camera/0/annotations'].circles),
    'scene': [[e.frame_id, len(e.spheres), len(e.cylinders), sum(len(l.points) for l in e.lines)] for e in seen['/scene'].entities]}))
";

#[test]
fn the_official_decoder_reads_the_live_channels() {
    let Some(python) = python() else { return };
    let has_client =
        Command::new(&python).args(["-c", "import websockets"]).output().unwrap().status.success();
    assert!(has_client || std::env::var_os("VSERVO_REQUIRE_MCAP").is_none(), "no websockets");
    if !has_client {
        println!("skipped: {} has no websockets", python.display());
        return;
    }
    let daemon = Daemon::start("foxpy", &[]);
    let watch = Watch::start(&daemon.instance.name, &[]);
    watch.wait_for("is shown");
    let topics = "/joint_states,/tf,/tf_static,/camera/0/frame,/camera/0/camera_info,/camera/0/annotations,/control/trace,/control/status,/vision/0/measurement,/scene";
    let output = Command::new(python)
        .args(["-c", CLIENT, &format!("ws://{}", watch.address), topics])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let seen: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(seen["topics"].as_array().unwrap().len(), 10, "{seen}");
    let told = daemon.ctl("status").1;
    let q =
        |value: &Value| value.as_array().unwrap().iter().map(|q| q.as_f64().unwrap()).collect::<Vec<f64>>();
    let (told, joints, trace) = (q(&told["q_rad_or_m"]), q(&seen["q"]), q(&seen["trace_q"]));
    assert_eq!(joints.len(), told.len());
    assert!(
        joints.iter().zip(&told).all(|(a, b)| (a - b).abs() < 1e-3),
        "an arm that stands: {joints:?} {told:?}"
    );
    assert!(trace.iter().zip(&told).all(|(a, b)| (a - b).abs() < 1e-3), "{trace:?}");
    assert_eq!(seen["size"], json!([640, 480, 640 * 480]));
    assert_eq!(seen["circles"], 8, "four points, and where they are to be");
    assert!(seen["fixed"].as_array().unwrap().contains(&json!("camera_0")), "{seen}");
    let entities = seen["scene"].as_array().unwrap();
    assert!(
        entities.contains(&json!(["target", 4, 0, 0])) && entities.contains(&json!(["camera_0", 0, 0, 16])),
        "{seen}"
    );
    assert!(entities.iter().filter(|entity| entity[2] == 1).count() >= 2, "links: {seen}");
    assert!(seen["k"][0].as_f64().unwrap() > 100.0);
    watch.ended();
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}
