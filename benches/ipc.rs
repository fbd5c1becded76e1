//! Hand-over of a VGA frame, from the stamp before sending to the receiving thread awake with the frame: through our
//! ports, and through bare iceoryx2 ports that do the same, in alternating slices of one run.
//!
//! `cargo bench --bench ipc -- [ROUNDS]`, 2000 by default.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, missing_docs)]

use iceoryx2::prelude::*;
use std::sync::mpsc;
use std::time::Duration;
use vservo::config::RealtimeRequest;
use vservo::ipc::{FrameShape, Instance, Services};
use vservo::messages::{CameraId, FrameHeader};
use vservo::report::histogram::SpanHistogram;
use vservo::rt::{Awake, now, prepare_thread, sleep_until};
use vservo::time::{MonoNs, SpanNs};

const BYTES: usize = 640 * 480;
const PAUSE: SpanNs = SpanNs(1_000_000);
const SLICES: usize = 4;

fn main() {
    let rounds = std::env::args().skip(1).find_map(|a| a.parse::<usize>().ok()).unwrap_or(2000);
    let instance: Instance = format!("bench-ipc-{}", std::process::id()).parse().unwrap();
    let (mut ours, mut bare) = (SpanHistogram::default(), SpanHistogram::default());
    let _ = prepare_thread(&on_core(0, 40));
    let _awake = Awake::keep();
    for _ in 0..SLICES {
        run(&instance, rounds / SLICES, &mut ours, through_our_ports, receive_through_our_ports);
        run(&instance, rounds / SLICES, &mut bare, through_bare_ports, receive_through_bare_ports);
    }
    instance.remove_leftovers(None);
    let (o, b) = (ours.quantiles_us(), bare.quantiles_us());
    for (name, own, peer) in [("p50", o.p50, b.p50), ("p99", o.p99, b.p99), ("p99.9", o.p999, b.p999)] {
        println!("  {name:<6} ours {own:8.1} us   bare iceoryx2 {peer:8.1} us   ratio {:.2}", own / peer);
    }
}

/// Sender and receiver keep a core of their own: wherever the scheduler puts them else decides over the result.
fn on_core(core: u32, priority: u32) -> RealtimeRequest {
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get() as u32);
    RealtimeRequest { priority, cpu: Some(core % cores), lock_memory: false }
}

type Stamps = mpsc::Sender<SpanNs>;

/// One slice: a receiver on a FIFO thread, a sender on this one.
fn run(
    instance: &Instance,
    rounds: usize,
    histogram: &mut SpanHistogram,
    send: fn(&Instance, usize),
    receive: fn(&Instance, usize, &mpsc::Sender<()>, &Stamps),
) {
    let ((ready, is_ready), (stamps, spans)) = (mpsc::channel(), mpsc::channel());
    let place = instance.clone();
    let receiver = std::thread::Builder::new()
        .name("receiver".into())
        .spawn(move || {
            let _ = prepare_thread(&on_core(1, 50));
            receive(&place, rounds, &ready, &stamps);
        })
        .unwrap();
    is_ready.recv().unwrap();
    send(instance, rounds);
    receiver.join().unwrap();
    spans.iter().for_each(|span| histogram.record(span));
}

fn shape() -> FrameShape {
    FrameShape { bytes: BYTES, in_flight: 1, recorded: 1, held_back: 1 }
}

fn paced(rounds: usize, mut send: impl FnMut()) {
    let start = now() + PAUSE;
    for k in 0..rounds {
        sleep_until(start + SpanNs(PAUSE.0 * k as i64));
        send();
    }
}

fn through_our_ports(instance: &Instance, rounds: usize) {
    let services = Services::join(instance).unwrap();
    let sender = services.frame_sender(CameraId::FIRST, shape()).unwrap();
    paced(rounds, || {
        let mut frame = sender.borrow(BYTES).unwrap();
        frame.pixels_mut()[0] = 1;
        sender.send(frame, FrameHeader { sent: now(), ..FrameHeader::default() }).unwrap();
    });
    std::thread::sleep(Duration::from_millis(50));
}

fn receive_through_our_ports(instance: &Instance, rounds: usize, ready: &mpsc::Sender<()>, stamps: &Stamps) {
    let services = Services::join(instance).unwrap();
    let receiver = services.frame_receiver(CameraId::FIRST, shape()).unwrap();
    ready.send(()).unwrap();
    let mut idle = 0;
    for _ in 0..10 * rounds {
        while let Some(frame) = receiver.receive().unwrap() {
            stamps.send(now() - frame.header().sent).unwrap();
            idle = 0;
        }
        let before = now();
        receiver.wait(Duration::from_millis(20)).unwrap();
        idle += u32::from(now() - before > SpanNs(19_000_000));
        if idle > 2 {
            return;
        }
    }
}

fn node(instance: &Instance) -> Node<ipc::Service> {
    let config = instance.transport_config().unwrap();
    NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .unwrap()
}

type BareFrames = iceoryx2::service::port_factory::publish_subscribe::PortFactory<ipc::Service, [u8], u64>;

fn bare_frames(node: &Node<ipc::Service>, name: &ServiceName) -> BareFrames {
    node.service_builder(name)
        .publish_subscribe::<[u8]>()
        .user_header::<u64>()
        .enable_safe_overflow(true)
        .subscriber_max_buffer_size(1)
        .open_or_create()
        .unwrap()
}

fn through_bare_ports(instance: &Instance, rounds: usize) {
    let node = node(instance);
    let name = "bare/frame".try_into().unwrap();
    let service = bare_frames(&node, &name);
    let publisher = service.publisher_builder().initial_max_slice_len(BYTES).create().unwrap();
    let notifier =
        node.service_builder(&name).event().open_or_create().unwrap().notifier_builder().create().unwrap();
    paced(rounds, || {
        let mut sample = publisher.loan_slice_uninit(BYTES).unwrap();
        sample.payload_mut()[0].write(1);
        // SAFETY: the memory came zeroed from the kernel or holds an older frame; any byte is a valid u8.
        #[allow(unsafe_code)]
        let mut sample = unsafe { sample.assume_init() };
        *sample.user_header_mut() = now().0.unsigned_abs();
        sample.send().unwrap();
        notifier.notify().unwrap();
    });
    std::thread::sleep(Duration::from_millis(50));
}

fn receive_through_bare_ports(instance: &Instance, rounds: usize, ready: &mpsc::Sender<()>, stamps: &Stamps) {
    let node = node(instance);
    let name = "bare/frame".try_into().unwrap();
    let service = bare_frames(&node, &name);
    let subscriber = service.subscriber_builder().buffer_size(1).create().unwrap();
    let listener =
        node.service_builder(&name).event().open_or_create().unwrap().listener_builder().create().unwrap();
    ready.send(()).unwrap();
    let mut idle = 0;
    for _ in 0..10 * rounds {
        while let Some(sample) = subscriber.receive().unwrap() {
            stamps.send(now() - MonoNs(sample.user_header().cast_signed())).unwrap();
            idle = 0;
        }
        let before = now();
        listener.timed_wait(|_| {}, Duration::from_millis(20)).unwrap();
        idle += u32::from(now() - before > SpanNs(19_000_000));
        if idle > 2 {
            return;
        }
    }
}
