//! A small server of HTTP/1.1: a thread for each connection, which answers one request and ends; one that asks for a WebSocket stays (`foxglove/`). All of it is bounded: connections, the head of a request, and
//! the time in which a head must come and an answer must be taken. A viewer that does not keep to it is dropped with a word, and the others go on.

use super::foxglove::{ChannelHub, serve_viewer};
use super::live::{Live, Sent};
use super::page::PAGE;
use super::request::{MAX_HEAD, RequestRefusal, ViewerGate, WantedPart, is_head_byte, wanted};
use crate::process::ProcessError;
use crate::rt::{now, tell};
use crate::time::{MonoNs, SpanNs};
use std::io::{Error, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Connections at the same time. Chosen by hand: a page has two, one for numbers and one for images.
const MAX_CONNECTIONS: usize = 8;
/// Connections beyond them that are told so; still more are closed without a word. Chosen by hand, so that a flood makes no flood of threads.
const MAX_REFUSED: usize = 8;
/// Time for the whole head of a request. Chosen by hand: a browser sends it at once, and over a bad network within a second.
const HEAD_TIME: SpanNs = SpanNs(5_000_000_000);
/// Time for taking an answer, or a message of many. Chosen by hand: with 1 MB of image, 200 kB/s are enough; what is older than this is no live view any more.
const SEND_TIME: SpanNs = SpanNs(5_000_000_000);
/// Bytes that the kernel holds for a viewer. Chosen by hand: about a second of numbers. With its usual megabytes a viewer that stalls would be noticed only after a
/// minute, and one that is slow would be shown what was half a minute ago.
const SEND_BUFFER: usize = 64 << 10;
/// Longest wait for a new moment: then the last one is sent again, so that a page knows that it is still connected. Chosen by hand, below `SILENT_MS` of the page.
const LONGEST_QUIET: Duration = Duration::from_secs(1);
/// Longest wait for a new image; then the answer is that there is none. Chosen by hand: the slowest cameras in use give one a second.
const LONGEST_IMAGE_WAIT: Duration = Duration::from_secs(1);
/// Time for what a refused client still sends, and its bytes. Chosen by hand: a socket that is closed with unread bytes takes the answer with it.
const DRAIN_TIME: Duration = Duration::from_millis(200);
const DRAIN_BYTES: usize = 64 << 10;
/// Pause after a connection that could not be taken, as when descriptors are scarce. Chosen by hand: ten tries a second load nothing.
const SCARCE: Duration = Duration::from_millis(100);

/// Headers of every answer: nothing is kept, nothing of others is loaded, and no other page may show or read any of it.
const HEADERS: &str = "Connection: close\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\nContent-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
    img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n";

/// Serves viewers from a thread of its own, until this process ends.
pub(super) fn serve(
    listener: TcpListener,
    gate: ViewerGate,
    live: Arc<Live>,
    hub: Arc<ChannelHub>,
) -> Result<(), ProcessError> {
    let (gate, count, refused) = (Arc::new(gate), Arc::default(), Arc::default());
    let work = move || {
        loop {
            let Ok((stream, peer)) = listener.accept() else {
                std::thread::sleep(SCARCE);
                continue;
            };
            let viewed = ViewerPlace::take(&count, MAX_CONNECTIONS);
            let is_viewed = viewed.is_some();
            let Some(place) = viewed.or_else(|| ViewerPlace::take(&refused, MAX_REFUSED)) else { continue };
            let (gate, live, hub) = (Arc::clone(&gate), Arc::clone(&live), Arc::clone(&hub));
            let viewer = move || {
                let result = if is_viewed {
                    answer(&stream, &gate, (&live, &hub))
                } else {
                    refuse(&stream, RequestRefusal::Crowded)
                };
                if let Err(why) = result {
                    tell(format_args!("vservo watch: viewer {peer}: dropped: {why}"));
                }
                drop(place);
            };
            // Where there is no thread for it, the connection closes.
            let _ = std::thread::Builder::new().name("watch-viewer".into()).spawn(viewer);
        }
    };
    std::thread::Builder::new()
        .name("watch-accept".into())
        .spawn(work)
        .map_err(|cause| ProcessError::Start { what: "the thread that serves viewers", cause })?;
    Ok(())
}

/// A place among the connections, given back when dropped.
struct ViewerPlace(Arc<AtomicUsize>);

impl ViewerPlace {
    fn take(count: &Arc<AtomicUsize>, most: usize) -> Option<Self> {
        let more = |count: usize| (count < most).then_some(count + 1);
        count.fetch_update(Ordering::AcqRel, Ordering::Acquire, more).ok()?;
        Some(Self(Arc::clone(count)))
    }
}

impl Drop for ViewerPlace {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Answers one request. `Err`: why the viewer was dropped, for people; one that leaves is not dropped.
fn answer(stream: &TcpStream, gate: &ViewerGate, (live, hub): (&Live, &ChannelHub)) -> Result<(), String> {
    let _ = rustix::net::sockopt::set_socket_send_buffer_size(stream, SEND_BUFFER);
    let local = stream.local_addr().ok().as_ref().map(SocketAddr::ip);
    let head = match read_head(stream) {
        Ok(Some(head)) => head,
        Ok(None) => return Ok(()), // it left
        Err(refused) => return refuse(stream, refused),
    };
    match wanted(&head, gate, local) {
        Ok(WantedPart::Page) => {
            sent(send_all(stream, "200 OK", "text/html; charset=utf-8", "", PAGE.as_bytes()))
        }
        Ok(WantedPart::Image(seen)) => sent(match live.image_after(seen, LONGEST_IMAGE_WAIT) {
            Some(image) => {
                let number = format!("X-Image: {}\r\n", image.number);
                send_all(stream, "200 OK", "image/png", &number, image.png())
            }
            None => send(stream, format!("HTTP/1.1 204 No Content\r\n{HEADERS}\r\n").as_bytes()),
        }),
        Ok(WantedPart::Events) => sent(send_events(stream, live)),
        Ok(WantedPart::Socket(request)) => {
            sent(serve_viewer(stream, &request, hub, Duration::from_nanos(SEND_TIME.0.unsigned_abs())))
        }
        Err(refused) => refuse(stream, refused),
    }
}

/// Sends moments until the viewer leaves, or does not take them.
fn send_events(stream: &TcpStream, live: &Live) -> Result<(), Error> {
    send(stream, format!("HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n{HEADERS}\r\n").as_bytes())?;
    let (mut sent, mut seen) = (Sent::default(), 0);
    loop {
        let (moment, number) = live.moment_after(seen, LONGEST_QUIET);
        seen = number;
        send(stream, moment.events_after(&mut sent).as_bytes())?;
    }
}

/// The head of a request; `None` where the other end left before its end.
fn read_head(mut stream: &TcpStream) -> Result<Option<Vec<u8>>, RequestRefusal> {
    let until = now() + HEAD_TIME;
    let (mut head, mut part) = (Vec::new(), [0; 1024]);
    loop {
        let late = if head.is_empty() { RequestRefusal::Silent } else { RequestRefusal::TooSlow };
        let Some(left) = left(until) else { return Err(late) };
        if stream.set_read_timeout(Some(left)).is_err() {
            return Ok(None);
        }
        let bytes = match stream.read(&mut part) {
            Ok(0) => return Ok(None),
            Ok(count) => part.get(..count).unwrap_or_default(),
            Err(e) if e.kind() == ErrorKind::Interrupted => continue,
            Err(e) if is_late(&e) => return Err(late),
            Err(_) => return Ok(None),
        };
        if !bytes.iter().copied().all(is_head_byte) {
            return Err(RequestRefusal::Malformed);
        }
        // the end may lie across two parts
        let from = head.len().saturating_sub(3);
        head.extend_from_slice(bytes);
        if let Some(at) = head.get(from..).and_then(|tail| tail.windows(4).position(|w| w == b"\r\n\r\n")) {
            head.truncate(from + at + 4);
            return if head.len() > MAX_HEAD { Err(RequestRefusal::TooLong) } else { Ok(Some(head)) };
        }
        if head.len() > MAX_HEAD {
            return Err(RequestRefusal::TooLong);
        }
    }
}

/// Tells what is wrong to the other end, and here, where it has said anything.
fn refuse(mut stream: &TcpStream, refused: RequestRefusal) -> Result<(), String> {
    let text = format!("{}\n", refused.describe());
    let allow = if refused == RequestRefusal::Method { "Allow: GET\r\n" } else { "" };
    let _ = send_all(stream, refused.status(), "text/plain; charset=utf-8", allow, text.as_bytes());
    let _ = stream.shutdown(Shutdown::Write);
    let _ = stream.set_read_timeout(Some(DRAIN_TIME));
    let (mut part, mut drained) = ([0; 1024], 0);
    while let Ok(count @ 1..) = stream.read(&mut part) {
        drained += count;
        if drained > DRAIN_BYTES {
            break;
        }
    }
    if refused == RequestRefusal::Silent { Ok(()) } else { Err(refused.describe().to_owned()) }
}

fn send_all(
    stream: &TcpStream,
    status: &str,
    content: &str,
    headers: &str,
    body: &[u8],
) -> Result<(), Error> {
    let length = body.len();
    let mut bytes = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {content}\r\nContent-Length: {length}\r\n{headers}{HEADERS}\r\n"
    )
    .into_bytes();
    bytes.extend_from_slice(body);
    send(stream, &bytes)
}

/// Sends all of it within [`SEND_TIME`].
fn send(mut stream: &TcpStream, mut bytes: &[u8]) -> Result<(), Error> {
    let until = now() + SEND_TIME;
    while !bytes.is_empty() {
        let Some(left) = left(until) else { return Err(ErrorKind::TimedOut.into()) };
        stream.set_write_timeout(Some(left))?;
        match stream.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// The time until then; none where it is over.
fn left(until: MonoNs) -> Option<Duration> {
    let ns = u64::try_from((until - now()).0).ok().filter(|ns| *ns > 0)?;
    Some(Duration::from_nanos(ns))
}

fn is_late(error: &Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

/// A viewer that did not take what it was sent was dropped; one that left was not.
fn sent(result: Result<(), Error>) -> Result<(), String> {
    match result {
        Err(error) if is_late(&error) => Err("it does not take what it is sent in time".into()),
        _ => Ok(()),
    }
}
