//! The head of a request, as RFC 9112 has it: what is asked for, and whether it may be. Whatever else comes is refused with a status and a reason.

use super::foxglove::{PROTOCOLS, SocketRequest};
use std::net::IpAddr;
use tungstenite::handshake::derive_accept_key;

/// Longest head of a request, bytes. Chosen by hand: those of browsers have about 1 kB, and servers usually take 8.
pub(super) const MAX_HEAD: usize = 8192;

/// Why a request is not answered as it was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RequestRefusal {
    /// It is no request of HTTP/1.
    Malformed,
    /// The head did not come whole in time.
    TooSlow,
    /// Nothing came, as where a browser connects in advance.
    Silent,
    /// The head is too long.
    TooLong,
    /// It asks for something to be done.
    Method,
    /// It was sent under the name of another host, as pages of others do that have their name lead here (DNS rebinding).
    Host,
    /// It has no token, or a wrong one.
    Token,
    /// There is nothing of that name.
    Unknown,
    /// As many viewers as may be are there.
    Crowded,
    /// A page of others wants to read along.
    Origin,
    /// It wants a WebSocket that speaks something else.
    Protocol,
}

/// Where pages come from that read along beside those of this machine: the viewer that most use, in its own place. Others are named by the user.
const KNOWN_ORIGINS: [&str; 1] = ["https://app.foxglove.dev"];
/// What programs give that are no pages, and no page can give.
const NO_PAGE: &str = "file://";

impl RequestRefusal {
    /// The status line's part.
    pub(super) fn status(self) -> &'static str {
        match self {
            Self::Malformed | Self::Protocol => "400 Bad Request",
            Self::TooSlow | Self::Silent => "408 Request Timeout",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::Method => "405 Method Not Allowed",
            Self::Host | Self::Token | Self::Origin => "403 Forbidden",
            Self::Unknown => "404 Not Found",
            Self::Crowded => "503 Service Unavailable",
        }
    }

    /// What is wrong, and how it is mended.
    pub(super) fn describe(self) -> &'static str {
        match self {
            Self::Malformed => "this is no request of HTTP/1.1",
            Self::TooSlow | Self::Silent => "the head of the request did not come in time",
            Self::TooLong => "the head of the request has more than 8192 bytes",
            Self::Method => "this page only shows: GET is all that it takes",
            Self::Host => "the request names another host: use the address that `vservo watch` printed",
            Self::Token => "the token is missing or wrong: use the whole address that `vservo watch` printed",
            Self::Unknown => "there is no such page",
            Self::Origin => {
                "a page of another origin wants to read along: name it with `vservo watch --origin` if it may"
            }
            Self::Protocol => {
                "a WebSocket here speaks version 13 and foxglove.websocket.v1 or foxglove.sdk.v1"
            }
            Self::Crowded => "as many viewers as may be are there: close one, or try again",
        }
    }
}

/// What can be asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum WantedPart {
    /// The page.
    Page,
    /// Numbers, as they come.
    Events,
    /// The first image with another number than this.
    Image(u64),
    /// Everything live, through a socket.
    Socket(SocketRequest),
}

/// To whom requests must be addressed.
#[derive(Debug, Clone, Default)]
pub(super) struct ViewerGate {
    /// The token, where one is asked for.
    pub(super) token: Option<String>,
    /// The address that was asked for to listen at.
    pub(super) address: Option<IpAddr>,
    /// Origins of pages that may read along, beside those of this machine and the known ones.
    pub(super) origins: Vec<String>,
}

/// What a head says of a WebSocket.
#[derive(Debug, Default)]
struct SocketHead<'a> {
    upgrade: Option<&'a str>,
    key: Option<&'a str>,
    version: Option<&'a str>,
    protocols: Vec<&'a str>,
    origin: Option<&'a str>,
}

impl<'a> SocketHead<'a> {
    fn note(&mut self, name: &str, value: &'a str) {
        match name.to_ascii_lowercase().as_str() {
            "upgrade" => self.upgrade = Some(value),
            "sec-websocket-key" => self.key = Some(value),
            "sec-websocket-version" => self.version = Some(value),
            "sec-websocket-protocol" => self.protocols.extend(value.split(',').map(str::trim)),
            "origin" => self.origin = Some(value),
            _ => {}
        }
    }

    fn is_asked_for(&self) -> bool {
        self.upgrade.is_some_and(|upgrade| upgrade.eq_ignore_ascii_case("websocket"))
    }

    /// The socket that is asked for. Whoever sends an origin is a page, which the browser lets connect wherever it wants.
    fn request(&self, gate: &ViewerGate, own: &[Option<IpAddr>]) -> Result<SocketRequest, RequestRefusal> {
        let may_read = |origin: &str| {
            let host = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
            origin == NO_PAGE
                || host.is_some_and(|host| is_own_host(host, own))
                || KNOWN_ORIGINS.contains(&origin)
                || gate.origins.iter().any(|known| known == origin)
        };
        if !self.origin.is_none_or(may_read) {
            return Err(RequestRefusal::Origin);
        }
        let protocol = PROTOCOLS.into_iter().find(|known| self.protocols.contains(known));
        match (self.key, protocol) {
            (Some(key), Some(protocol)) if self.version == Some("13") => {
                Ok(SocketRequest { accept: derive_accept_key(key.as_bytes()), protocol })
            }
            _ => Err(RequestRefusal::Protocol),
        }
    }
}

/// What is wanted by a whole head, which came to the address `local` of this machine.
pub(super) fn wanted(
    head: &[u8],
    gate: &ViewerGate,
    local: Option<IpAddr>,
) -> Result<WantedPart, RequestRefusal> {
    let text = std::str::from_utf8(head).map_err(|_| RequestRefusal::Malformed)?;
    let mut lines = text.split("\r\n");
    let mut words = lines.next().unwrap_or_default().split(' ');
    let (Some(method), Some(target), Some(version), None) =
        (words.next(), words.next(), words.next(), words.next())
    else {
        return Err(RequestRefusal::Malformed);
    };
    let is_token = |word: &str| !word.is_empty() && word.bytes().all(is_token_byte);
    if !is_token(method) || !version.starts_with("HTTP/1.") || !target.starts_with('/') {
        return Err(RequestRefusal::Malformed);
    }
    let (mut host, mut socket) = (None, SocketHead::default());
    for line in lines.take_while(|line| !line.is_empty()) {
        let (name, value) =
            line.split_once(':').filter(|(name, _)| is_token(name)).ok_or(RequestRefusal::Malformed)?;
        // RFC 9112, Sect. 3.2: more than one is malformed
        if name.eq_ignore_ascii_case("host") && host.replace(value.trim()).is_some() {
            return Err(RequestRefusal::Malformed);
        }
        socket.note(name, value.trim());
    }
    // whoever it is for comes first: others are told nothing of what there is
    let own = [gate.address, local];
    if !is_own_host(host.ok_or(RequestRefusal::Malformed)?, &own) {
        return Err(RequestRefusal::Host);
    }
    if method != "GET" {
        return Err(RequestRefusal::Method);
    }
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let value = |key: &str| {
        query.split('&').filter_map(|pair| pair.split_once('=')).find(|(k, _)| *k == key).map(|(_, v)| v)
    };
    if let Some(token) = &gate.token
        && !is_same(value("token").unwrap_or_default().as_bytes(), token.as_bytes())
    {
        return Err(RequestRefusal::Token);
    }
    match path {
        "/" if socket.is_asked_for() => socket.request(gate, &own).map(WantedPart::Socket),
        "/" => Ok(WantedPart::Page),
        "/events" => Ok(WantedPart::Events),
        "/image.png" => Ok(WantedPart::Image(value("after").and_then(|v| v.parse().ok()).unwrap_or(0))),
        _ => Err(RequestRefusal::Unknown),
    }
}

/// Whether bytes may be part of a head: text, and the ends of its lines.
pub(super) fn is_head_byte(byte: u8) -> bool {
    matches!(byte, b'\r' | b'\n' | b'\t' | b' '..=b'~') || byte >= 0x80
}

/// RFC 9110, Sect. 5.6.2.
fn is_token_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&byte)
}

/// Whether a `Host` is this machine by a name that nobody else can give: `localhost`, or an address. Its port may be another one, where a tunnel leads here.
fn is_own_host(host: &str, own: &[Option<IpAddr>]) -> bool {
    let is_port = |port: &str| port.bytes().all(|b| b.is_ascii_digit());
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, "")) => address,
        Some((address, port)) if port.strip_prefix(':').is_some_and(is_port) => address,
        Some(_) => return false,
        None => match host.split_once(':') {
            Some((name, port)) if is_port(port) => name,
            Some(_) => return false,
            None => host,
        },
    };
    if name.eq_ignore_ascii_case("localhost") {
        return true;
    }
    let Ok(address) = name.parse::<IpAddr>() else { return false };
    let address = address.to_canonical();
    let is_loopback = ["127.0.0.1", "::1"].iter().any(|own| own.parse() == Ok(address));
    is_loopback || own.iter().flatten().any(|own| own.to_canonical() == address)
}

/// Compares in a time that tells nothing of where the two differ.
fn is_same(a: &[u8], b: &[u8]) -> bool {
    let differs = a.iter().zip(b).fold(0, |differs, (a, b)| std::hint::black_box(differs | (a ^ b)));
    a.len() == b.len() && differs == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ask(head: &str) -> Result<WantedPart, RequestRefusal> {
        wanted(head.as_bytes(), &ViewerGate::default(), None)
    }

    #[test]
    fn three_paths_are_known_and_nothing_else() {
        let get =
            |path: &str| ask(&format!("GET {path} HTTP/1.1\r\nHost: localhost:8470\r\nX-Other: a:b\r\n\r\n"));
        assert_eq!(get("/"), Ok(WantedPart::Page));
        assert_eq!(get("/?x=1"), Ok(WantedPart::Page));
        assert_eq!(get("/events"), Ok(WantedPart::Events));
        assert_eq!(get("/image.png?after=7"), Ok(WantedPart::Image(7)));
        assert_eq!(get("/image.png?after=-7"), Ok(WantedPart::Image(0)));
        for path in ["/favicon.ico", "/../etc/passwd", "/events/", "//", "/%2e"] {
            assert_eq!(get(path), Err(RequestRefusal::Unknown), "{path}");
        }
        assert_eq!(get("http://localhost/"), Err(RequestRefusal::Malformed));
    }

    #[test]
    fn other_methods_and_what_is_no_request_are_refused() {
        for method in ["POST", "HEAD", "PUT", "DELETE", "OPTIONS", "get"] {
            let head = format!("{method} / HTTP/1.1\r\nHost: localhost\r\n\r\n");
            assert_eq!(ask(&head), Err(RequestRefusal::Method), "{method}");
        }
        let malformed = [
            "",
            "\r\n\r\n",
            "GET /\r\nHost: localhost\r\n\r\n",
            "GET / HTTP/2\r\nHost: localhost\r\n\r\n",
            "GET  / HTTP/1.1\r\nHost: localhost\r\n\r\n",
            "GET / HTTP/1.1\r\n\r\n",
            "GET / HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n",
            "GET / HTTP/1.1\r\nHost localhost\r\n\r\n",
            "GET / HTTP/1.1\r\nHost: localhost\r\n folded\r\n\r\n",
        ];
        for head in malformed {
            assert_eq!(ask(head), Err(RequestRefusal::Malformed), "{head:?}");
        }
    }

    #[test]
    fn names_that_others_can_give_are_no_hosts() {
        let gate = ViewerGate { address: "192.168.1.5".parse().ok(), ..ViewerGate::default() };
        let host = |host: &str| {
            let head = format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n");
            wanted(head.as_bytes(), &gate, "10.0.0.2".parse().ok()).is_ok()
        };
        for own in [
            "localhost",
            "LOCALHOST:1",
            "127.0.0.1:8470",
            "[::1]",
            "[::1]:80",
            "192.168.1.5",
            "10.0.0.2:8470",
        ] {
            assert!(host(own), "{own}");
        }
        for other in [
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.nip.io",
            "192.168.1.6",
            "[::1",
            "[::1]x",
            "",
            "2130706433",
            "127.1",
            "localhost:x",
            "::1",
        ] {
            assert!(!host(other), "{other}");
        }
    }

    #[test]
    fn a_token_is_asked_for_of_every_path() {
        let gate = ViewerGate { token: Some("0123abcd".into()), ..ViewerGate::default() };
        let get = |target: &str| {
            wanted(format!("GET {target} HTTP/1.1\r\nHost: localhost\r\n\r\n").as_bytes(), &gate, None)
        };
        for path in ["/", "/events", "/image.png", "/nothing"] {
            for wrong in
                ["", "?token=", "?token=0123abce", "?token=0123abcd0", "?token=0123abc", "?other=0123abcd"]
            {
                assert_eq!(get(&format!("{path}{wrong}")), Err(RequestRefusal::Token), "{path}{wrong}");
            }
        }
        assert_eq!(get("/events?token=0123abcd"), Ok(WantedPart::Events));
        assert_eq!(get("/image.png?after=3&token=0123abcd"), Ok(WantedPart::Image(3)));
    }

    #[test]
    fn sockets_are_for_programs_and_pages_that_may_read() {
        let socket = |origin: &str, protocols: &str, version: &str| {
            let gate = ViewerGate { origins: vec!["https://viewer.example".into()], ..ViewerGate::default() };
            let origin = if origin.is_empty() { String::new() } else { format!("Origin: {origin}\r\n") };
            let head = format!(
                "GET / HTTP/1.1\r\nHost: localhost:8470\r\nUpgrade: WebSocket\r\nConnection: Upgrade\r\n{origin}\
                 Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: {version}\r\n\
                 Sec-WebSocket-Protocol: {protocols}\r\n\r\n"
            );
            wanted(head.as_bytes(), &gate, None)
        };
        // The key and what it becomes are the example of RFC 6455, Sect. 1.3.
        let accept = "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=".to_owned();
        let [old, new] = PROTOCOLS;
        let granted = |protocol| Ok(WantedPart::Socket(SocketRequest { accept: accept.clone(), protocol }));
        assert_eq!(socket("", old, "13"), granted(old));
        assert_eq!(socket("", &format!("{new}, {old}"), "13"), granted(old));
        assert_eq!(socket("", new, "13"), granted(new));
        for own in ["file://", "http://localhost:8080", "https://127.0.0.1", "http://[::1]:3000"] {
            assert_eq!(socket(own, old, "13"), granted(old), "{own}");
        }
        assert_eq!(socket("https://app.foxglove.dev", old, "13"), granted(old));
        assert_eq!(socket("https://viewer.example", old, "13"), granted(old));
        for other in ["null", "https://evil.example", "https://app.foxglove.dev.evil.example", "localhost"] {
            assert_eq!(socket(other, old, "13"), Err(RequestRefusal::Origin), "{other}");
        }
        assert_eq!(socket("", "graphql-ws", "13"), Err(RequestRefusal::Protocol));
        assert_eq!(socket("", old, "8"), Err(RequestRefusal::Protocol));
    }

    proptest! {
        #[test]
        fn any_bytes_are_answered(head in proptest::collection::vec(any::<u8>(), 0..300)) {
            prop_assert!(wanted(&head, &ViewerGate::default(), None).is_err());
        }
    }
}
