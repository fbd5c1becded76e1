//! `vservo watch`: what a browser is told and shown of a run, and that viewers of every kind disturb neither the run nor each other.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{kill, vservo, wait_until};
use crate::serve::Daemon;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A watcher of an instance, and the address that it printed.
pub(crate) struct Watch {
    child: Child,
    pub(crate) address: SocketAddr,
    /// Behind the `?` of that address.
    pub(crate) query: String,
    told: Arc<Mutex<Vec<String>>>,
}

impl Watch {
    pub(crate) fn start(instance: &str, arguments: &[&str]) -> Self {
        let mut command = vservo();
        command.args(["watch", "--port", "0", "--instance", instance]).args(arguments);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let told = Arc::new(Mutex::new(Vec::new()));
        let (sink, stderr) = (Arc::clone(&told), child.stderr.take().unwrap());
        let read = move || {
            BufReader::new(stderr)
                .lines()
                .map_while(Result::ok)
                .for_each(|line| sink.lock().unwrap().push(line))
        };
        std::thread::Builder::new().name("stderr".into()).spawn(read).unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let rest = line.trim().strip_prefix("http://").unwrap_or_else(|| panic!("{line} {told:?}"));
        let (address, query) = rest.split_once('/').unwrap();
        let query = query.trim_start_matches('?').to_owned();
        Self { child, address: address.parse().unwrap(), query, told }
    }

    /// Sends `head` as it is.
    fn send(&self, head: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.write_all(head.as_bytes()).unwrap();
        stream
    }

    fn request(&self, path: &str) -> TcpStream {
        self.send(&format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", self.address))
    }

    /// The status, the headers and the body of an answer.
    fn get(&self, path: &str) -> (String, String, Vec<u8>) {
        answer(self.request(path))
    }

    /// Waits until it has said `word` on stderr.
    pub(crate) fn wait_for(&self, word: &str) {
        wait_until(word, || self.told.lock().unwrap().iter().any(|line| line.contains(word)));
    }

    pub(crate) fn ended(mut self) {
        kill(self.child.id() as i32, "INT");
        let status = self.child.wait().unwrap();
        assert_eq!(status.code(), Some(0), "{:?}", self.told);
    }
}

/// One that a failed test leaves would hold its instance.
impl Drop for Watch {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn answer(mut stream: TcpStream) -> (String, String, Vec<u8>) {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").unwrap_or_else(|| panic!("no head: {bytes:?}"));
    let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
    let status = head.split(' ').nth(1).unwrap().to_owned();
    (status, head, bytes[end + 4..].to_vec())
}

/// A viewer's stream of numbers.
pub(crate) struct Events {
    lines: std::io::Lines<BufReader<TcpStream>>,
    facts: Value,
    errors: Vec<(f64, f64)>,
    pub(crate) events: Vec<String>,
}

impl Events {
    pub(crate) fn of(watch: &Watch) -> Self {
        let stream = watch.request(&format!("/events?{}", watch.query));
        let lines = BufReader::new(stream).lines();
        Self { lines, facts: Value::Null, errors: Vec::new(), events: Vec::new() }
    }

    /// The next message; `None` at the end of the stream.
    fn next(&mut self) -> Option<Value> {
        let mut is_run = false;
        loop {
            let line = self.lines.next()?.ok()?;
            is_run |= line == "event: run";
            let Some(data) = line.strip_prefix("data: ") else { continue };
            let data: Value = serde_json::from_str(data).unwrap();
            if std::mem::take(&mut is_run) {
                (self.facts, self.errors, self.events) = (data, Vec::new(), Vec::new());
                continue;
            }
            for pair in data["errors"].as_array().unwrap() {
                self.errors.push((pair[0].as_f64().unwrap_or(f64::NAN), pair[1].as_f64().unwrap()));
            }
            for pair in data["events"].as_array().unwrap() {
                self.events.push(pair[1].as_str().unwrap().to_owned());
            }
            return Some(data);
        }
    }

    /// The first message of which `is` is true.
    pub(crate) fn until(&mut self, is: impl Fn(&Value, &Self) -> bool) -> Value {
        loop {
            let message = self.next().expect("the stream goes on");
            if is(&message, self) {
                return message;
            }
        }
    }
}

#[test]
fn a_browser_is_shown_state_errors_joints_and_image() {
    let daemon = Daemon::start("watch", &["--set", "servo.gain_1_s=0.5"]);
    let watch = Watch::start(&daemon.instance.name, &[]);
    assert_eq!(watch.address.ip().to_string(), "127.0.0.1");
    assert!(watch.query.is_empty(), "no token where nobody else can look");
    let (status, head, page) = watch.get("/");
    assert_eq!(status, "200", "{head}");
    assert!(head.contains("Content-Security-Policy: default-src 'none'"), "{head}");
    assert!(String::from_utf8(page).unwrap().ends_with("</html>\n"), "whole");

    let mut events = Events::of(&watch);
    let idle = events.until(|m, _| m["now"]["state"] == "idle" && !m["now"]["feature_error_px"].is_null());
    assert_eq!(idle["now"]["waits_for"], "waits for a start");
    assert_eq!(events.facts["instance"], daemon.instance.name.as_str());
    assert_eq!((&events.facts["serves"], &events.facts["lockstep"]), (&true.into(), &false.into()));
    let told = daemon.ctl("status").1;
    let shown = events.until(|m, _| m["now"]["goal_points"].as_array().is_some_and(|goal| !goal.is_empty()));
    let px = |value: &Value| value["feature_error_px"].as_f64().unwrap();
    assert!((px(&told) - px(&shown["now"])).abs() < 1.0, "what others are told");
    let joints = shown["now"]["joints"].as_array().unwrap();
    assert_eq!(joints.len(), told["q_rad_or_m"].as_array().unwrap().len());
    assert_eq!(shown["now"]["features"].as_array().unwrap().len(), 4);
    let now = events.until(|m, _| m["now"]["processes"].as_array().is_some_and(|p| p.len() >= 5));
    let roles: Vec<&str> =
        now["now"]["processes"].as_array().unwrap().iter().map(|p| p["role"].as_str().unwrap()).collect();
    assert_eq!(roles, ["serve", "camera", "vision", "control", "watch"]);

    daemon.accepts("start");
    let moves = events.until(|m, seen| m["now"]["state"] == "servoing" && seen.errors.len() > 20);
    assert!(moves["now"]["stages"]["vision_ms"].as_f64().unwrap() > 0.0, "{moves}");
    assert!(moves["now"]["ticks"]["counts"].as_array().unwrap().iter().any(|count| count.as_u64() > Some(0)));
    events.until(|_, seen| seen.events.iter().any(|what| what == "idle -> servoing"));
    let times: Vec<f64> = events.errors.iter().map(|(time_s, _)| *time_s).filter(|t| t.is_finite()).collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "each error once: {times:?}");

    // The image is the camera's, and it shows where the points are: dark dots on a light plate.
    let mut last = 0;
    for _ in 0..3 {
        let mut image = (String::new(), String::new(), Vec::new());
        wait_until("an image", || {
            image = watch.get(&format!("/image.png?after={last}"));
            image.0 == "200"
        });
        let number = image.1.lines().find_map(|line| line.strip_prefix("X-Image: ")).unwrap();
        assert_ne!(number.parse::<u64>().unwrap(), last, "another one");
        last = number.parse().unwrap();
        let grey = image::load_from_memory_with_format(&image.2, image::ImageFormat::Png).unwrap().to_luma8();
        let size: Vec<f64> =
            events.facts["image_px"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        assert_eq!([f64::from(grey.width()), f64::from(grey.height())], size[..]);
        let levels = grey.pixels().map(|p| p.0[0]);
        assert!(levels.clone().max().unwrap() - levels.min().unwrap() > 50, "no empty image");
    }
    watch.ended();
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// A viewer that reads as fast as it can, whatever the test does meanwhile: its newest message, and how many feature errors it was sent.
fn good_viewer(watch: &Watch) -> Arc<Mutex<(Value, usize)>> {
    let mut events = Events::of(watch);
    let seen = Arc::new(Mutex::new((Value::Null, 0)));
    let sink = Arc::clone(&seen);
    let read = move || {
        while let Some(message) = events.next() {
            *sink.lock().unwrap() = (message, events.errors.len());
        }
    };
    std::thread::Builder::new().name("viewer".into()).spawn(read).unwrap();
    seen
}

/// One that stalls, one that is slow, garbage, a head that does not come, and more than there are places: another goes on, and so does the run.
#[test]
fn viewers_that_stall_or_babble_are_dropped_and_others_go_on() {
    let daemon = Daemon::start("watch-bad", &["--set", "servo.gain_1_s=0.5"]);
    let watch = Watch::start(&daemon.instance.name, &[]);
    let good = good_viewer(&watch);
    let now = |key: &str| good.lock().unwrap().0["now"][key].clone();
    wait_until("the state", || now("state") == "idle");
    let stalled = watch.request("/events");
    let mut slow = watch.request("/events");
    let read = move || {
        let mut part = [0; 1024];
        while let Ok(1..) = slow.read(&mut part) {
            std::thread::sleep(Duration::from_secs(1)); // 1 kB/s is what it is
        }
    };
    std::thread::Builder::new().name("slow".into()).spawn(read).unwrap();
    let silent = TcpStream::connect(watch.address).unwrap();

    // Those that were refused may still have places for a moment, for want of which others are turned away.
    let told = |sent: &str| {
        let mut code = String::new();
        wait_until("a place to be free", || {
            code = answer(watch.send(sent)).0.to_string();
            code != "503"
        });
        code
    };
    assert_eq!(told("\u{1}\u{2}\u{3} garbage"), "400");
    assert_eq!(told("GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n"), "403");
    assert_eq!(told("GET /\r\n\r\n"), "400");
    assert_eq!(told("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"), "405");
    assert_eq!(told("GET /nothing HTTP/1.1\r\nHost: localhost\r\n\r\n"), "404");
    assert_eq!(told(&format!("GET / HTTP/1.1\r\nX: {}", "x".repeat(8192))), "431");
    assert_eq!(answer(silent).0, "408", "a head that does not come");
    // Asked for until there are none.
    let mut places = Vec::new();
    wait_until("all places to be taken", || {
        places.push(watch.request("/events"));
        watch.get("/").0 == "503"
    });
    drop(places);
    wait_until("a place to be free again", || watch.get("/").0 == "200");

    let before = good.lock().unwrap().1;
    daemon.accepts("start");
    wait_until("the run to go on", || now("state") == "servoing" && good.lock().unwrap().1 > before + 20);
    wait_until("both that do not take what they are sent to be told of", || {
        let told = watch.told.lock().unwrap();
        told.iter().filter(|line| line.contains("does not take what it is sent")).count() == 2
    });
    drop(stalled);
    let time_s = now("time_s").as_f64();
    wait_until("the other to go on", || now("time_s").as_f64() > time_s);
    assert_eq!(daemon.state(), "servoing");
    watch.ended();
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn it_waits_for_a_run_tells_its_end_and_shows_the_next() {
    let daemon = Daemon::start("watch-next", &["--clock", "lockstep"]);
    let name = daemon.instance.name.clone();
    let nobody = Watch::start(&format!("{}-n", &name[..name.len().min(16)]), &[]);
    assert!(Events::of(&nobody).next().unwrap()["word"].as_str().unwrap().contains("waits for one"));
    assert_eq!(nobody.get("/image.png").0, "204", "there is none");
    nobody.ended();

    let watch = Watch::start(&name, &[]);
    let mut events = Events::of(&watch);
    events.until(|m, _| m["now"]["state"] == "idle");
    assert_eq!(events.facts["lockstep"], true);
    daemon.accepts("shutdown");
    let end = events.until(|m, _| m["now"]["ended"] == true);
    assert!(end["now"]["waits_for"].as_str().unwrap().contains("waits for the next run"), "{end}");
    assert_eq!(end["now"]["outcome"], "stopped", "{end}");
    let Daemon { instance, mut process } = daemon;
    assert!(process.wait().unwrap().success());
    wait_until("shared memory to be clean", || instance.leftovers().is_empty());

    // The next one is told apart by its clock.
    let mut next = vservo();
    next.args(["serve", "--instance", &name]).stdout(Stdio::null()).stderr(Stdio::null());
    let mut next = next.spawn().unwrap();
    let seen = events.until(|m, seen| m["now"]["ended"] == false && seen.facts["lockstep"] == false);
    assert!(seen["now"]["outcome"].is_null(), "{seen}");
    kill(next.id() as i32, "INT");
    next.wait().unwrap();
    events.until(|m, _| m["now"]["ended"] == true);
    watch.ended();
    instance.assert_gone();
}

#[test]
fn who_listens_elsewhere_asks_for_its_token() {
    let name = "watch-nobody";
    let watch = Watch::start(name, &["--listen", "127.0.0.2"]);
    let token = watch.query.strip_prefix("token=").expect("a token is printed").to_owned();
    assert!(token.len() == 32 && watch.address.ip().to_string() == "127.0.0.2", "{token}");
    for path in ["/", "/events", "/image.png", "/?token=", "/?token=0123456789abcdef0123456789abcdef"] {
        let (status, head, body) = watch.get(path);
        assert_eq!(status, "403", "{path}: {head}");
        assert!(String::from_utf8_lossy(&body).contains("token"), "{path}");
    }
    assert_eq!(watch.get(&format!("/?token={token}")).0, "200");
    assert!(Events::of(&watch).next().unwrap()["word"].as_str().unwrap().contains(name));
    let other = Watch::start(name, &["--listen", "127.0.0.2"]);
    assert_ne!(other.query, watch.query, "each has its own");
    assert!(!watch.told.lock().unwrap().iter().any(|line| line.contains(&token)), "it is no log's business");
    // A port that is taken.
    let port = watch.address.port().to_string();
    let output = vservo().args(["watch", "--listen", "127.0.0.2", "--port", &port]).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{told}");
    assert!(told.contains("cannot listen at 127.0.0.2") && told.contains("--port"), "{told}");
    for watch in [watch, other] {
        watch.ended();
    }
}

/// A watcher that hangs or is killed changes nothing of a run.
#[test]
fn a_watcher_that_hangs_or_dies_disturbs_no_run() {
    let daemon = Daemon::start("watch-hang", &["--clock", "lockstep"]);
    let hanging = Watch::start(&daemon.instance.name, &[]);
    hanging.wait_for("is shown");
    kill(hanging.child.id() as i32, "STOP");
    let mut dead = Watch::start(&daemon.instance.name, &[]);
    dead.wait_for("is shown");
    kill(dead.child.id() as i32, "KILL");
    dead.child.wait().unwrap();
    daemon.accepts("start");
    wait_until("the goal to be reached", || daemon.ctl("status").1["at_goal"] == true);
    kill(hanging.child.id() as i32, "CONT");
    let mut events = Events::of(&hanging);
    events.until(|m, _| m["now"]["state"] == "servoing");
    daemon.accepts("shutdown");
    events.until(|m, _| m["now"]["ended"] == true);
    hanging.ended();
    assert_eq!(daemon.ended().0, Some(0));
}
