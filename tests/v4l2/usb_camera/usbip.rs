//! The device's side of USB/IP: requests of the kernel come in, answers go out. Numbers are big-endian; a request and an answer
//! have 48 bytes each, with data behind them.

use super::descriptors::Stream;
use super::{Device, Model, State, stream};
use std::fs;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Condvar, Mutex};
use std::thread::{Builder, JoinHandle};

const CONTROLLER: &str = "/sys/devices/platform/vhci_hcd.0";
const SUBMIT: u32 = 1;
const ANSWER: u32 = 3;
const UNLINKED: u32 = 4;
const HIGH_SPEED: u32 = 3;
/// Statuses of a transfer, as negative error numbers.
const OK: i32 = 0;
const STALLED: i32 = -32;
const RESET: i32 = -104;

/// A camera at a port, with its threads; pulled out when it is dropped.
pub struct Plug {
    device: Arc<Device>,
    socket: UnixStream,
    threads: Vec<JoinHandle<()>>,
}

impl Plug {
    /// Connects a camera to the first free port of the virtual controller.
    pub fn connect(model: Model) -> Self {
        let (socket, kernels) = UnixStream::pair().unwrap();
        let device = Arc::new(Device { model, state: Mutex::new(State::default()), changed: Condvar::new() });
        let answers = Arc::new(Answers(Mutex::new(socket.try_clone().unwrap())));
        let requests = socket.try_clone().unwrap();
        let start = |name: &str, work: Box<dyn FnOnce() + Send>| {
            Builder::new().name(name.into()).spawn(work).unwrap()
        };
        let (d, a) = (Arc::clone(&device), Arc::clone(&answers));
        let control = start("usb-control", Box::new(move || serve(&d, &a, requests)));
        let d = Arc::clone(&device);
        let streaming = start("usb-stream", Box::new(move || stream::run(&d, &answers)));
        let port = free_port();
        // Bus 1, device 2, as far as anybody asks.
        let attach = format!("{port} {} {} {HIGH_SPEED}", kernels.as_raw_fd(), 0x1_0002);
        fs::write(format!("{CONTROLLER}/attach"), attach).expect("mods vhci-hcd");
        Self { device, socket, threads: vec![control, streaming] }
    }

    /// What the threads share.
    pub(super) fn device(&self) -> &Device {
        &self.device
    }
}

impl Drop for Plug {
    fn drop(&mut self) {
        let _ = self.socket.shutdown(Shutdown::Both);
        self.device.state().unplugged = true;
        self.device.changed.notify_all();
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

/// A high-speed port with nothing on it: status 4 in a table with one line for each.
fn free_port() -> String {
    let table = fs::read_to_string(format!("{CONTROLLER}/status")).expect("mods vhci-hcd");
    let mut ports = table.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let free = ports.find(|p| p.len() > 2 && p[0] == "hs" && p[2] == "004").expect("a free port");
    free[1].trim_start_matches('0').parse::<u32>().unwrap_or(0).to_string()
}

/// Where answers go; from both threads.
pub(super) struct Answers(Mutex<UnixStream>);

impl Answers {
    /// Ends a transfer: so many bytes were taken or, where `data` is not empty, are given.
    pub(super) fn end(&self, sequence: u32, status: i32, length: usize, data: &[u8]) {
        let words = [ANSWER, sequence, 0, 0, 0, status as u32, length as u32, 0, 0, 0, 0, 0];
        self.send(&words, data);
    }

    fn send(&self, words: &[u32; 12], data: &[u8]) {
        let mut message = Vec::with_capacity(48 + data.len());
        message.extend(words.iter().flat_map(|w| w.to_be_bytes()));
        message.extend_from_slice(data);
        // An error is the kernel's end being closed: the control thread sees it too, and ends.
        let _ = self.0.lock().unwrap().write_all(&message);
    }
}

/// Takes requests until the plug is pulled.
fn serve(device: &Device, answers: &Answers, mut requests: UnixStream) {
    let mut request = [0; 48];
    while requests.read_exact(&mut request).is_ok() {
        let word = |i: usize| u32::from_be_bytes(request[4 * i..4 * i + 4].try_into().unwrap());
        let (sequence, to_host, endpoint, length) = (word(1), word(3) == 1, word(4), word(6) as usize);
        if word(0) != SUBMIT {
            // The kernel no longer wants a transfer.
            let wanted_no_more = word(5);
            let mut state = device.state();
            let before = state.transfers.len();
            state.transfers.retain(|t| *t != wanted_no_more);
            let status = if state.transfers.len() < before { RESET } else { OK };
            drop(state);
            answers.send(&[UNLINKED, sequence, 0, 0, 0, status as u32, 0, 0, 0, 0, 0, 0], &[]);
        } else if endpoint != 0 {
            device.state().transfers.push_back(sequence);
            device.changed.notify_all();
        } else {
            let mut data = vec![0; if to_host { 0 } else { length }];
            if requests.read_exact(&mut data).is_err() {
                break;
            }
            match device.asked(request[40..].try_into().unwrap(), &data) {
                None => answers.end(sequence, STALLED, 0, &[]),
                Some(mut answer) if to_host => {
                    answer.truncate(length);
                    answers.end(sequence, OK, answer.len(), &answer);
                }
                Some(_) => answers.end(sequence, OK, length, &[]),
            }
        }
    }
    device.state().unplugged = true;
    device.changed.notify_all();
}

impl Device {
    /// The answer to a control request with its eight bytes of set-up; `None` for one that is refused.
    fn asked(&self, setup: [u8; 8], data: &[u8]) -> Option<Vec<u8>> {
        const NOTHING: Option<Vec<u8>> = Some(Vec::new());
        let [kind, request, value_low, value_high, interface, unit, ..] = setup;
        let streaming_interface = interface == 1;
        let mut state = self.state();
        match (kind, request) {
            (0x80, 6) => match value_high {
                1 => Some(self.model.device()),
                2 => Some(self.model.configuration()),
                3 => self.model.string(value_low),
                _ => None,
            },
            // Status; set configuration; set interface.
            (0x80..=0x82, 0) => Some(vec![0, 0]),
            (0x00, 9) | (0x01, 11) => NOTHING,
            // Clear the endpoint's halt: that is how a host stops a stream of this kind.
            (0x02, 1) => {
                state.streaming = false;
                NOTHING
            }
            (0x21, 1) if streaming_interface => {
                state.negotiated = Stream::nearest(data);
                if value_high == 2 {
                    state.streaming = true;
                    state.session += 1;
                    self.changed.notify_all();
                }
                NOTHING
            }
            (0xa1, 0x85) if streaming_interface => {
                Some(vec![self.model.probe(&state.negotiated).len() as u8, 0])
            }
            (0xa1, 0x86) if streaming_interface => Some(vec![0b11]),
            (0xa1, 0x81..=0x87) if streaming_interface => Some(self.model.probe(&state.negotiated)),
            // Why the last request was refused: no reason.
            (0xa1, _) if unit == 0 => Some(vec![0]),
            (0x21, 1) => state.controls.set((unit, value_high), data).and(NOTHING),
            (0xa1, _) => state.controls.answer(request, (unit, value_high)),
            _ => None,
        }
    }
}
