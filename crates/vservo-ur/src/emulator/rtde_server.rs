//! The controller's end of RTDE.

use super::core::Core;
use super::faults::Pieces;
use super::variables::{self, Sink, Source};
use super::{Shared, accept};
use crate::rtde::{Framer, PROTOCOL_VERSION, Package, PackageType, Reader, Writer};
use crate::socket::receive;
use std::collections::VecDeque;
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Longest wait of a thread before it looks whether the emulator ends. Chosen by hand: nobody notices it.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wait for a client that does not read. Chosen by hand: some cycles; then it is dropped, as it would stop the others.
const WRITE: Duration = Duration::from_millis(10);

/// A client, as the cycle and its own thread share it.
pub(super) struct Client {
    stream: TcpStream,
    number: u64,
    started: bool,
    outputs: Vec<Source>,
    output_id: u8,
    /// Sends in every how many cycles.
    every: u64,
    inputs: Vec<Vec<Sink>>,
    gone: bool,
    writer: Writer,
    /// What a slow network has not brought yet.
    queue: VecDeque<Vec<u8>>,
}

/// Takes clients in until the emulator ends.
pub(super) fn serve(shared: &Arc<Shared>, listener: &TcpListener) {
    let mut threads = Vec::new();
    let mut number = 0;
    while let Some(stream) = accept(shared, listener) {
        number += 1;
        let prepared = stream
            .set_nodelay(true)
            .and_then(|()| stream.set_read_timeout(Some(LOOK)))
            .and_then(|()| stream.set_write_timeout(Some(WRITE)))
            .and_then(|()| stream.try_clone());
        let Ok(reader) = prepared else { continue };
        let client = Arc::new(Mutex::new(Client {
            stream,
            number,
            started: false,
            outputs: Vec::new(),
            output_id: 0,
            every: 1,
            inputs: Vec::new(),
            gone: false,
            writer: Writer::default(),
            queue: VecDeque::new(),
        }));
        shared.clients().push(Arc::clone(&client));
        let shared = Arc::clone(shared);
        let thread = std::thread::Builder::new().name("ur-rtde-client".into());
        threads.extend(thread.spawn(move || listen(&shared, &client, reader)).ok());
        threads.retain(|thread| !thread.is_finished());
    }
    for thread in threads {
        let _ = thread.join();
    }
}

/// Sends the data of a cycle to every client, and forgets those that are gone.
pub(super) fn send_all(shared: &Shared, core: &mut Core) {
    let mut clients = shared.clients();
    clients.retain(|client| {
        let mut client = client.lock().unwrap_or_else(PoisonError::into_inner);
        if client.number <= core.faults.reset_before {
            let _ = client.stream.shutdown(std::net::Shutdown::Both);
            return false;
        }
        if !client.gone && client.started && !core.faults.mute && core.cycle.is_multiple_of(client.every) {
            let lost = core.faults.lose_states && !core.cycle.is_multiple_of(3);
            if !lost && client.send(core).is_err() {
                client.gone = true;
            }
        }
        !client.gone
    });
    (core.faults.cut_once, core.faults.unknown_type_once) = (false, false);
}

/// The newest number of a client.
pub(super) fn newest(shared: &Shared) -> u64 {
    let clients = shared.clients();
    clients.iter().map(|c| c.lock().unwrap_or_else(PoisonError::into_inner).number).max().unwrap_or(0)
}

impl Client {
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    fn send(&mut self, core: &Core) -> std::io::Result<()> {
        let writer = self.writer.begin(PackageType::Data).put(&[self.output_id]);
        for source in &self.outputs {
            variables::put(core, *source, writer);
        }
        let mut package = writer.package();
        let taken;
        if core.faults.late_s > 0.0 {
            self.queue.push_back(package.to_vec());
            if (self.queue.len() as u64 * self.every) as f64 <= core.faults.late_s * core.series.rate_hz() {
                return Ok(());
            }
            taken = self.queue.pop_front().unwrap_or_default();
            package = &taken;
        }
        if core.faults.unknown_type_once {
            return self.stream.write_all(&[0, 4, b'?', 0]);
        }
        if core.faults.cut_once {
            return self.stream.write_all(package.get(..package.len() / 2).unwrap_or_default());
        }
        let size = match core.faults.pieces {
            Pieces::Whole => package.len(),
            Pieces::Halves => package.len().div_ceil(2),
            Pieces::Bytes => 1,
        };
        for (i, piece) in package.chunks(size.max(1)).enumerate() {
            if i > 0 && core.faults.pieces == Pieces::Halves {
                // Chosen by hand: so long that the first half is read alone, and less than a cycle.
                std::thread::sleep(Duration::from_micros(700));
            }
            self.stream.write_all(piece)?;
        }
        Ok(())
    }

    fn answer(&mut self, kind: PackageType, payload: &[u8]) {
        let sent = self.stream.write_all(self.writer.begin(kind).put(payload).package());
        self.gone |= sent.is_err();
    }
}

/// Reads what a client sends.
fn listen(shared: &Arc<Shared>, client: &Mutex<Client>, mut stream: TcpStream) {
    let mut framer = Framer::default();
    while !shared.ends.load(Ordering::Relaxed) {
        let Ok(count) = receive(&mut stream, framer.room()) else { break };
        framer.filled(count.unwrap_or(0));
        loop {
            match framer.next() {
                Ok(Some(package)) => obey(shared, client, package),
                Ok(None) => break,
                Err(error) => {
                    shared.core().tell(format!("RTDE: {error}"));
                    client.lock().unwrap_or_else(PoisonError::into_inner).gone = true;
                    return;
                }
            }
        }
        if client.lock().unwrap_or_else(PoisonError::into_inner).gone {
            return;
        }
    }
    client.lock().unwrap_or_else(PoisonError::into_inner).gone = true;
}

fn obey(shared: &Shared, client: &Mutex<Client>, package: Package<'_>) {
    // In this order everywhere: first the core.
    let mut core = shared.core();
    let mut client = client.lock().unwrap_or_else(PoisonError::into_inner);
    let mut reader = Reader::new(package.payload);
    match package.kind {
        PackageType::ProtocolVersion => {
            let right = reader.u16("version") == Ok(PROTOCOL_VERSION) && !core.faults.wrong_protocol;
            client.answer(package.kind, &[u8::from(right)]);
        }
        PackageType::ControlVersion => {
            let v = core.version;
            let numbers = [v.major, v.minor, v.bugfix, v.build].map(u32::to_be_bytes);
            client.answer(package.kind, &numbers.concat());
        }
        PackageType::SetupOutputs if !core.faults.silent_setup => {
            set_up_outputs(&mut core, &mut client, reader)
        }
        PackageType::SetupInputs if !core.faults.silent_setup => {
            set_up_inputs(shared, &mut core, &mut client, reader)
        }
        PackageType::Start => {
            client.started = !client.outputs.is_empty();
            let started = u8::from(client.started);
            client.answer(package.kind, &[started]);
        }
        PackageType::Pause => {
            client.started = false;
            client.answer(package.kind, &[1]);
        }
        PackageType::Data => take_data(&mut core, &client, reader),
        PackageType::SetupOutputs | PackageType::SetupInputs | PackageType::Text => {}
    }
}

fn set_up_outputs(core: &mut Core, client: &mut Client, mut reader: Reader<'_>) {
    let Ok(rate_hz) = reader.f64("rate") else { return };
    let names = String::from_utf8_lossy(reader.rest()).into_owned();
    let found: Vec<_> = each(&names).map(variables::output).collect();
    let known = |source: &Option<(_, Source)>| source.filter(|_| !core.faults.unknown_variables);
    let words: Vec<_> = found.iter().map(|f| known(f).map_or("NOT_FOUND", |(kind, _)| kind.name())).collect();
    let complete = tell_unknown(core, &names, &words);
    client.output_id = u8::from(complete);
    client.outputs =
        if complete { found.iter().flatten().map(|(_, source)| *source).collect() } else { Vec::new() };
    let full = core.series.rate_hz();
    client.every = if rate_hz > 0.0 { (full / rate_hz).round().max(1.0) as u64 } else { 1 };
    let payload = [&[client.output_id], words.join(",").as_bytes()].concat();
    client.answer(PackageType::SetupOutputs, &payload);
}

fn set_up_inputs(shared: &Shared, core: &mut Core, client: &mut Client, mut reader: Reader<'_>) {
    let names = String::from_utf8_lossy(reader.rest()).into_owned();
    let found: Vec<_> = each(&names).map(variables::input).collect();
    let taken = |sink: Sink| core.faults.registers_in_use || shared.is_taken(client.number, sink);
    let words: Vec<_> = found
        .iter()
        .map(|f| match f {
            None => "NOT_FOUND",
            Some((_, sink @ (Sink::Int(_) | Sink::Double(_)))) if taken(*sink) => "IN_USE",
            Some((kind, _)) => kind.name(),
        })
        .collect();
    let complete = tell_unknown(core, &names, &words);
    let mut id = 0;
    if complete {
        let sinks: Vec<Sink> = found.iter().flatten().map(|(_, sink)| *sink).collect();
        shared.take(client.number, &sinks);
        client.inputs.push(sinks);
        id = client.inputs.len() as u8;
    }
    let payload = [&[id], words.join(",").as_bytes()].concat();
    client.answer(PackageType::SetupInputs, &payload);
}

/// The names of a list; a comma behind the last one, as `ur_rtde` writes it, is none.
fn each(names: &str) -> impl Iterator<Item = &str> {
    names.split(',').map(str::trim).filter(|name| !name.is_empty())
}

/// Whether all variables are there; tells which are not.
fn tell_unknown(core: &mut Core, names: &str, words: &[&str]) -> bool {
    let refused = |word: &str| matches!(word, "NOT_FOUND" | "IN_USE");
    for (name, word) in each(names).zip(words).filter(|(_, word)| refused(word)) {
        core.tell(format!("RTDE: `{name}` is asked for: {word}"));
    }
    !words.iter().any(|word| refused(word))
}

/// Values go to the registers, those of a package together.
fn take_data(core: &mut Core, client: &Client, mut reader: Reader<'_>) {
    let Ok(id) = reader.u8("recipe") else { return };
    let Some(sinks) = usize::from(id).checked_sub(1).and_then(|i| client.inputs.get(i)) else {
        return core.tell(format!("RTDE: values of the unknown recipe {id}"));
    };
    let values = reader.rest();
    if values.len() != sinks.iter().map(|sink| sink.size()).sum::<usize>() {
        return core.tell("RTDE: values that are more or less than their recipe has");
    }
    let (mut reader, mut slides) = (Reader::new(values), false);
    for sink in sinks {
        let read = match *sink {
            Sink::Int(i) => reader.i32("int").map(|v| core.coming.ints[i] = v),
            Sink::Double(i) => reader.f64("double").map(|v| core.coming.doubles[i] = v),
            Sink::SliderMask => reader.u32("mask").map(|v| slides = v != 0),
            Sink::Slider => reader.f64("slider").map(|v| {
                if slides {
                    core.slider = v.clamp(0.0, 1.0);
                }
            }),
            Sink::Nothing(kind) => reader.take(kind.size(), "value").map(drop),
        };
        if read.is_err() {
            return;
        }
    }
}
